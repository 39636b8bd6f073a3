#include <zlib.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

#include "image_files.hpp"
#include "image_io/image_io.hpp"
#include "image_io/stored_bytes.hpp"
#include "io/input.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

using namespace testing_files;
namespace fs = std::filesystem;

class ImageChecks : public TemporaryFolder {
 protected:
  void expect_refused(const fs::path& path, const std::vector<std::string>& parts) const {
    std::vector<std::string> all{"reading fixed image", path.string()};
    all.insert(all.end(), parts.begin(), parts.end());
    expect_failure(Failure::input, all, [&] { read_image(path, "fixed image"); });
  }
};

TEST_F(ImageChecks, WhatIsNotAnImageFile) {
  expect_refused(file("missing.nii.gz"), {"no such file"});
  expect_refused(file("a.jpg", "x"), {"not supported", ".nii.gz", "DICOM"});
  expect_refused(file("a.dcm", "x"), {"give the folder"});
  expect_refused(folder(), {"no DICOM images"});
  for (const char* name : {"a.nii", "a.nii.gz", "a.nrrd", "a.mha"}) {
    expect_refused(file(name, ""), {});
    expect_refused(file(name, "this is a text and not an image"), {});
  }
  expect_failure(Failure::input, {"folder", "intensity"}, [&] { read_labels(folder(), "labels"); });
}

class TruncatedImage : public ImageChecks, public testing::WithParamInterface<const char*> {};
INSTANTIATE_TEST_SUITE_P(Formats, TruncatedImage, testing::Values(".nii", ".nii.gz", ".nrrd", ".mha"));

TEST_P(TruncatedImage, IsRefusedWhereverItEnds) {
  Image noise(oblique_grid());
  unsigned state = 1;
  for (float& value : noise.data) value = float((state = state * 1664525u + 1013904223u) >> 8);
  const fs::path whole = file(std::string("whole") + GetParam());
  write_image(whole, noise);
  const std::string bytes = read_file(whole);
  EXPECT_EQ(read_image(whole, "image").data, noise.data);
  const std::size_t trailer = 32;  // of gzip, zlib or the last voxels
  for (std::size_t size = 1; size + trailer < bytes.size(); size += 1 + bytes.size() / 40)
    expect_refused(file(std::string("cut") + GetParam(), bytes.substr(0, size)), {});
  expect_refused(file(std::string("cut") + GetParam(), bytes.substr(0, bytes.size() - trailer)), {";"});
}

TEST_F(ImageChecks, PlainMetaImageCutByOneByte) {
  const std::string header =
      "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = ";
  EXPECT_NO_THROW(read_image(file("a.mha", header + "LOCAL\n12345678"), "image"));
  expect_refused(file("a.mha", header + "LOCAL\n1234567"), {"cut off", "7 of 8 bytes"});
  file("a.raw", "1234567");
  expect_refused(file("a.mhd", header + "a.raw\n"), {"cut off", "7 of 8 bytes"});
  expect_refused(file("b.mhd", header + "b.raw\n"), {"b.raw", "missing"});
  expect_refused(file("c.mhd", header + "LIST\na.raw\n"), {"several files"});
}

TEST_F(ImageChecks, DamagedCompressedNifti) {
  write_image(file("a.nii.gz"), Image(oblique_grid(), 3.f));
  std::string bytes = read_file(file("a.nii.gz"));
  bytes[bytes.size() / 2] = char(~bytes[bytes.size() / 2]);
  expect_refused(file("a.nii.gz", bytes), {"damaged"});
}

TEST_F(ImageChecks, NiftiOfEitherByteOrder) {
  NiftiContent content;
  content.big_endian = true;
  content.bright = 7;
  const Image image = read_image(file("a.nii", nifti_bytes(content)), "image");
  EXPECT_EQ(image.data[7], 100);
  EXPECT_EQ(image.grid.size, (std::array<int, 3>{3, 4, 5}));
  EXPECT_EQ(image.grid.spacing, (Vec3d{2, 3, 4}));
  expect_refused(file("a.nii", nifti_bytes(content).substr(0, 400)), {"cut off", "48 of 120 bytes"});
}

TEST_F(ImageChecks, NiftiWithSizesThatItCannotHold) {
  std::string bytes = nifti_bytes({});
  const auto set_sizes = [&](std::initializer_list<std::int16_t> sizes) {
    const auto dimensions = std::int16_t(sizes.size());
    std::memcpy(&bytes[40], &dimensions, 2), std::memcpy(&bytes[42], sizes.begin(), 2 * sizes.size());
  };
  set_sizes({32767, 32767, 32767});  // 70 TB: whoever asked for the memory would be told that there is not enough
  expect_refused(file("a.nii", bytes), {"cut off", "120 of 70362301923326 bytes", "copy or download it again"});
  gzip(file("a.nii"), file("packed.nii.gz"));
  expect_refused(file("packed.nii.gz"), {"cut off", "70362301923326 bytes of voxels", "copy or download it again"});
  set_sizes({32767, 32767, 32767, 32767, 32767, 32767, 32767});
  expect_refused(file("a.nii", bytes), {"header is damaged", "copy or download it again"});
}

TEST_F(ImageChecks, NiftiPackedAsTightlyAsDeflateCan) {
  NiftiContent content;
  content.size = {400, 400, 50};
  const std::string bytes = nifti_bytes(content);
  const fs::path tight = file("tight.nii.gz");
  const gzFile packed = gzopen(tight.c_str(), "wb9");
  ASSERT_EQ(gzwrite(packed, bytes.data(), unsigned(bytes.size())), int(bytes.size()));
  ASSERT_EQ(gzclose(packed), Z_OK);
  EXPECT_LT(fs::file_size(tight), bytes.size() / 1000);
  EXPECT_EQ(read_image(tight, "image").data[0], 100);
}

TEST_F(ImageChecks, NiftiOfTheSecondVersion) {
  std::string bytes = nifti_bytes({});
  bytes[0] = 28, bytes[1] = 2;  // the header's size, 540
  expect_refused(file("a.nii", bytes), {"NIfTI-2", "convert"});
}

TEST_F(ImageChecks, PlainNiftiBesideThePackedOne) {
  write_image(file("a.nii.gz"), Image(oblique_grid(), 1.f));
  write_image(file("a.nii"), Image(oblique_grid(), 2.f));
  expect_refused(file("a.nii.gz"), {"a.nii", "lies beside it"});
  EXPECT_EQ(read_image(file("a.nii"), "image").data[0], 2.f);
}

TEST_F(ImageChecks, Dimensions) {
  NiftiContent content;
  content.size = {3, 4, 5, 1};
  EXPECT_EQ(read_image(file("a.nii", nifti_bytes(content)), "image").grid.size, (std::array<int, 3>{3, 4, 5}));
  content.size = {3, 4, 5, 2};
  expect_refused(file("a.nii", nifti_bytes(content)), {"not a 3-D image", "3 x 4 x 5 x 2"});
  content.size = {3, 4};
  expect_refused(file("a.nii", nifti_bytes(content)), {"not a 3-D image", "3 x 4"});
}

TEST_F(ImageChecks, RescaleSlopeOfNifti) {
  NiftiContent content;
  content.slope = 0.5f, content.intercept = -7;
  const Image image = read_image(file("a.nii", nifti_bytes(content)), "image");
  EXPECT_EQ(image.data[0], 43);
  EXPECT_EQ(image.data[1], -7);
}

TEST_F(ImageChecks, NiftiThatTheLibraryWouldMisread) {
  NiftiContent field;
  field.size = {3, 4, 5, 1, 3};
  field.intent = 1006;
  expect_refused(file("a.nii", nifti_bytes(field)), {"1006", "convert"});
  expect_failure(Failure::input, {"1006"}, [&] { read_vector_image(file("a.nii"), "field"); });
  field.intent = 1007;
  expect_refused(file("a.nii", nifti_bytes(field)), {"3 values per voxel"});
  EXPECT_EQ(read_vector_image(file("a.nii"), "field").data[0], (Vec3f{100, 0, 0}));
  NiftiContent in_microns;
  in_microns.units = 3;
  expect_refused(file("a.nii", nifti_bytes(in_microns)), {"not in mm"});
}

TEST_F(ImageChecks, ComponentCounts) {
  write_vector_image(file("v.nrrd"), VectorImage(oblique_grid()));
  expect_refused(file("v.nrrd"), {"3 values per voxel", "one number"});
  write_image(file("s.mha"), Image(oblique_grid()));
  expect_failure(Failure::input, {"1 value(s) per voxel"}, [&] { read_vector_image(file("s.mha"), "field"); });
}

TEST_F(ImageChecks, NotANumberAndInfinity) {
  Image image(oblique_grid());
  image.at(2, 3, 1) = std::numeric_limits<float>::quiet_NaN();
  image.at(0, 0, 3) = std::numeric_limits<float>::infinity();
  write_image(file("a.nrrd"), image);
  expect_refused(file("a.nrrd"), {"2 voxels", "(2, 3, 1)"});
  VectorImage field(oblique_grid());
  field.at(1, 0, 0).z = std::numeric_limits<float>::quiet_NaN();
  write_vector_image(file("v.mha"), field);
  expect_failure(Failure::input, {"1 voxel is", "(1, 0, 0)"}, [&] { read_vector_image(file("v.mha"), "field"); });
}

TEST_F(ImageChecks, ShearedAxes) {
  NiftiContent content;
  content.sform[0][1] = 0.5;
  expect_refused(file("a.nii", nifti_bytes(content)), {"orthonormal"});
  const std::string voxels(8 * 2, '\0');
  const auto nrrd = [&](const std::string& directions) {
    return "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 2 2 2\nspace directions: " +
           directions + "\nspace origin: (0,0,0)\nkinds: domain domain domain\nendian: little\nencoding: raw\n\n" +
           voxels;
  };
  expect_refused(file("a.nrrd", nrrd("(1,0,0) (0.01,1,0) (0,0,1)")), {"right angles"});
  const Grid grid = read_image(file("b.nrrd", nrrd("(1,0,0) (0.00005,1,0) (0,0,1)")), "image").grid;
  EXPECT_NEAR(grid.direction[0][0] * grid.direction[0][1] + grid.direction[1][0] * grid.direction[1][1], 0, 1e-8);
  const std::string header = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\n";
  expect_refused(file("a.mha", header + "TransformMatrix = 1 0 0 0.1 1 0 0 0 1\nElementDataFile = LOCAL\n12345678"),
                 {"right angles"});
}

TEST_F(ImageChecks, LabelsAreWholeNumbersInRange) {
  const auto refused = [&](float value, const std::string& shown) {
    Image image(oblique_grid());
    image.data[5] = value;
    write_image(file("l.nrrd"), image);
    expect_failure(Failure::input, {"reading vertebrae", shown, "0 to 65535"},
                   [&] { read_labels(file("l.nrrd"), "vertebrae"); });
    expect_failure(Failure::input, {shown}, [&] { read_mask(file("l.nrrd"), "mask"); });
  };
  refused(1.5f, "1.5");
  refused(-1.f, "-1");
  refused(65536.f, "65536");
  refused(std::numeric_limits<float>::quiet_NaN(), "nan");
  Image image(oblique_grid());
  image.data[5] = 65535;
  write_image(file("l.nrrd"), image);
  EXPECT_EQ(read_labels(file("l.nrrd"), "vertebrae").data[5], 65535);
}

}  // namespace
}  // namespace mtled
