#include "image_io/image_io.hpp"

#include <itkDisplacementFieldTransform.h>
#include <itkHDF5TransformIO.h>
#include <itkPNGImageIO.h>
#include <itkTransformFactoryBase.h>
#include <sys/resource.h>

#include <csignal>

#include "image_files.hpp"
#include "io/input.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

using namespace testing_files;
namespace fs = std::filesystem;

/// NIfTI keeps the geometry in float32: 1e-7 of 800 mm.
constexpr double geometry_tolerance_mm = 2e-4;

void expect_same_place(const Grid& a, const Grid& b) {
  EXPECT_EQ(a.size, b.size);
  for (const Vec3d& index : {Vec3d{0, 0, 0}, {6, 0, 0}, {0, 4, 0}, {0, 0, 3}}) {
    EXPECT_NEAR(norm(a.point(index) - b.point(index)), 0, geometry_tolerance_mm);
    EXPECT_NEAR(norm(a.index(b.point(index)) - index), 0, geometry_tolerance_mm);
  }
}

template <class T>
Volume<T> numbered(T step) {
  Volume<T> volume(oblique_grid());
  for (std::size_t i = 0; i < volume.data.size(); ++i) volume.data[i] = T(T(i) * step);
  return volume;
}

class ImageFormat : public TemporaryFolder, public testing::WithParamInterface<const char*> {
 protected:
  fs::path image() const { return file(std::string("image") + GetParam()); }
};
INSTANTIATE_TEST_SUITE_P(Formats, ImageFormat, testing::Values(".nii", ".nii.gz", ".nrrd", ".mha"));

TEST_P(ImageFormat, IntensitiesRoundTrip) {
  const Image written = numbered(-1.25f);
  write_image(image(), written);
  const Image read = read_image(image(), "image");
  EXPECT_EQ(read.data, written.data);
  expect_same_place(read.grid, written.grid);
  EXPECT_EQ(entries(), 1);
}

TEST_P(ImageFormat, LabelsRoundTrip) {
  const LabelImage written = numbered<std::uint16_t>(470);  // up to 65330
  write_labels(image(), written);
  const LabelImage read = read_labels(image(), "labels");
  EXPECT_EQ(read.data, written.data);
  expect_same_place(read.grid, written.grid);
}

TEST_P(ImageFormat, MaskIsWhereTheLabelIsNotZero) {
  Mask written(oblique_grid());
  written.data[17] = 1;
  write_mask(image(), written);
  EXPECT_EQ(read_mask(image(), "mask").data, written.data);
  LabelImage labels(oblique_grid());
  labels.data[17] = 256;
  write_labels(image(), labels);
  EXPECT_EQ(read_mask(image(), "mask").data, written.data);
}

TEST_P(ImageFormat, IntensitiesOfAnotherTypeAreConverted) {
  const LabelImage written = numbered<std::uint16_t>(470);
  write_labels(image(), written);
  const Image read = read_image(image(), "image");
  for (std::size_t i = 0; i < read.data.size(); ++i) EXPECT_EQ(read.data[i], float(written.data[i]));
}

TEST_P(ImageFormat, FullDiskIsAnErrorAndLeavesTheOldFile) {
  file(std::string("image") + GetParam(), "old");
  Grid grid;
  grid.size = {50, 50, 50};
  Image noise(grid);
  unsigned state = 1;
  for (float& value : noise.data) value = float((state = state * 1664525u + 1013904223u) >> 8);
  const auto before = std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit{};
  getrlimit(RLIMIT_FSIZE, &limit);
  const rlimit small{65536, limit.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  expect_failure(Failure::output, {"writing", GetParam(), "free space"}, [&] { write_image(image(), noise); });
  setrlimit(RLIMIT_FSIZE, &limit);
  std::signal(SIGXFSZ, before);
  EXPECT_EQ(read_file(image()), "old");
  EXPECT_EQ(entries(), 1);
}

class FieldFormat : public ImageFormat {};
INSTANTIATE_TEST_SUITE_P(Formats, FieldFormat, testing::Values(".nrrd", ".mha"));

VectorImage some_field() {
  VectorImage field(oblique_grid());
  for (std::size_t i = 0; i < field.data.size(); ++i) field.data[i] = {float(i), -0.5f * float(i), 7};
  return field;
}

TEST_P(FieldFormat, VectorsRoundTripWithoutTurning) {
  write_vector_image(image(), some_field());
  const VectorImage read = read_vector_image(image(), "field");
  EXPECT_EQ(read.data, some_field().data);
  expect_same_place(read.grid, some_field().grid);
}

using Orientation = TemporaryFolder;

Vec3d point_of_bright_voxel(const Image& image) {
  const std::size_t at = std::size_t(std::find(image.data.begin(), image.data.end(), 100.f) - image.data.begin());
  const int nx = image.grid.size[0], ny = image.grid.size[1];
  return image.grid.point(int(at) % nx, int(at) / nx % ny, int(at) / nx / ny);
}

TEST_F(Orientation, NiftiSformIsRightAnteriorSuperior) {
  NiftiContent content;
  content.bright = 2 + 3 * (1 + 4 * 3);  // index (2, 1, 3): RAS (14, 23, 42)
  const Image image = read_image(file("a.nii", nifti_bytes(content)), "image");
  EXPECT_NEAR(norm(point_of_bright_voxel(image) - Vec3d{-14, -23, 42}), 0, 1e-6);
}

TEST_F(Orientation, NiftiSformWithSwappedAndFlippedAxes) {
  NiftiContent content;
  const float swapped[3][4] = {{0, 0, -4, 50}, {2, 0, 0, -60}, {0, -3, 0, 70}};
  std::memcpy(content.sform, swapped, sizeof swapped);
  content.bright = 2 + 3 * (1 + 4 * 3);  // RAS (50 - 12, -60 + 4, 70 - 3)
  const Image image = read_image(file("a.nii", nifti_bytes(content)), "image");
  EXPECT_NEAR(norm(point_of_bright_voxel(image) - Vec3d{-38, 56, 67}), 0, 1e-6);
}

TEST_F(Orientation, NiftiQuaternionWithFlippedThirdAxis) {
  NiftiContent content;
  content.q_code = 1, content.s_code = 0, content.q_factor = -1;
  content.quaternion[2] = float(std::sqrt(0.5));  // a quarter turn about z: i -> +y, j -> -x
  content.q_offset[0] = 5, content.q_offset[1] = 6, content.q_offset[2] = 7;
  content.bright = 2 + 3 * (1 + 4 * 3);  // RAS (5 - 3, 6 + 4, 7 - 12)
  const Image image = read_image(file("a.nii", nifti_bytes(content)), "image");
  EXPECT_NEAR(norm(point_of_bright_voxel(image) - Vec3d{-2, -10, -5}), 0, 1e-5);
}

TEST_F(Orientation, WrittenNiftiHoldsTheAffineInRightAnteriorSuperior) {
  const Grid grid = oblique_grid();
  write_image(file("a.nii"), Image(grid));
  const std::string bytes = read_file(file("a.nii"));
  float offset[3];
  std::memcpy(offset, &bytes[268], sizeof offset);
  EXPECT_NEAR(offset[0], -grid.origin.x, geometry_tolerance_mm);
  EXPECT_NEAR(offset[1], -grid.origin.y, geometry_tolerance_mm);
  EXPECT_NEAR(offset[2], grid.origin.z, geometry_tolerance_mm);
}

TEST_F(Orientation, NrrdSpaces) {
  std::vector<std::int16_t> voxels(3 * 4 * 5);
  voxels[2 + 3 * (1 + 4 * 3)] = 100;
  const auto nrrd = [&](const std::string& space) {
    return "NRRD0004\ntype: short\ndimension: 3\nspace: " + space +
           "\nsizes: 3 4 5\nspace directions: (0,2,0) (3,0,0) (0,0,-4)\n"
           "space origin: (10,20,30)\nkinds: domain domain domain\nendian: little\nencoding: raw\n\n" +
           raw_bytes(voxels);
  };
  const Image lps = read_image(file("lps.nrrd", nrrd("left-posterior-superior")), "image");
  EXPECT_NEAR(norm(point_of_bright_voxel(lps) - Vec3d{13, 24, 18}), 0, 1e-9);
  const Image ras = read_image(file("ras.nrrd", nrrd("right-anterior-superior")), "image");
  EXPECT_NEAR(norm(point_of_bright_voxel(ras) - Vec3d{-13, -24, 18}), 0, 1e-9);
}

TEST_F(Orientation, MetaImageRowsAreAxes) {
  std::vector<std::int16_t> voxels(3 * 4 * 5);
  voxels[2 + 3 * (1 + 4 * 3)] = 100;
  const std::string header =
      "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
      "TransformMatrix = 0 1 0 0 0 -1 -1 0 0\nOffset = 10 20 30\nCenterOfRotation = 0 0 0\nElementSpacing = 2 3 4\n"
      "DimSize = 3 4 5\nElementType = MET_SHORT\n";
  file("a.raw", raw_bytes(voxels));
  for (const fs::path& path : {file("a.mha", header + "ElementDataFile = LOCAL\n" + raw_bytes(voxels)),
                               file("a.mhd", header + "ElementDataFile = a.raw\n")}) {
    const Image image = read_image(path, "image");  // i -> +y, j -> -z, k -> -x
    EXPECT_NEAR(norm(point_of_bright_voxel(image) - Vec3d{10 - 12, 20 + 4, 30 - 3}), 0, 1e-9);
  }
}

using ImageOutput = TemporaryFolder;

TEST_F(ImageOutput, TransformMovesPointsByTheField) {
  write_displacement_transform(file("t.h5"), some_field());
  itk::TransformFactoryBase::RegisterDefaultTransforms();
  const auto reader = itk::HDF5TransformIOTemplate<double>::New();
  reader->SetFileName(file("t.h5").string());
  reader->Read();
  ASSERT_EQ(reader->GetReadTransformList().size(), 1u);
  const auto* transform =
      dynamic_cast<itk::DisplacementFieldTransform<double, 3>*>(reader->GetReadTransformList().front().GetPointer());
  ASSERT_NE(transform, nullptr);
  const VectorImage field = some_field();
  const Vec3d x = field.grid.point(3, 2, 1);
  const auto y = transform->TransformPoint(itk::Point<double, 3>{{x.x, x.y, x.z}});
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(y[unsigned(i)] - x[i], field.at(3, 2, 1)[i], 1e-6);
}

TEST_F(ImageOutput, PictureIsRowMajorRgb) {
  const Picture picture{3, 2, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 255, 254, 253}};
  write_png(file("p.png"), picture);
  const auto reader = itk::PNGImageIO::New();
  reader->SetFileName(file("p.png").string());
  reader->ReadImageInformation();
  ASSERT_EQ(reader->GetDimensions(0), 3u);
  ASSERT_EQ(reader->GetDimensions(1), 2u);
  std::vector<unsigned char> rgb(18);
  reader->Read(rgb.data());
  EXPECT_EQ(rgb, picture.rgb);
}

TEST_F(ImageOutput, UnsupportedNamesAndFoldersAreErrors) {
  const Image image(oblique_grid());
  for (const char* name : {"a.mhd", "a.nhdr", "a.jpg", "a"})
    expect_failure(Failure::output, {name, "not supported", ".nii, .nii.gz, .nrrd, .mha"},
                   [&] { write_image(file(name), image); });
  expect_failure(Failure::output, {".nrrd, .mha"}, [&] { write_vector_image(file("a.nii.gz"), some_field()); });
  expect_failure(Failure::output, {".h5"}, [&] { write_displacement_transform(file("a.tfm"), some_field()); });
  expect_failure(Failure::output, {".png"}, [&] { write_png(file("a.jpg"), {}); });
  expect_failure(Failure::output, {"there is no folder"}, [&] { write_image(file("no") / "a.nrrd", image); });
  EXPECT_EQ(entries(), 0);
}

}  // namespace
}  // namespace mtled
