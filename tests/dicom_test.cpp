#include <itkGDCMImageIO.h>
#include <itkMetaDataObject.h>

#include "image_files.hpp"
#include "image_io/image_io.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

using namespace testing_files;
namespace fs = std::filesystem;

constexpr const char* series_a = "1.2.826.0.1.3680043.2.1125.1";
constexpr const char* series_b = "1.2.826.0.1.3680043.2.1125.2";

/// DICOM positions are texts of at most 16 characters.
constexpr double position_tolerance_mm = 1e-3;

class DicomTest : public TemporaryFolder {
 protected:
  static Grid right_handed_grid() {
    Grid grid = oblique_grid();
    for (int i = 0; i < 3; ++i) grid.direction[i][2] = -grid.direction[i][2];
    return grid;
  }
  static Image ct() {
    Image image(right_handed_grid());
    for (std::size_t i = 0; i < image.data.size(); ++i) image.data[i] = float(int(i) * 7 - 1000);
    return image;
  }
  /// One slice of ct() as a file, moved by `shift` [mm]; int16.
  void write_slice(const std::string& name, int k, const std::string& series = series_a,
                   const Vec3d& shift = {}) const {
    const Image image = ct();
    const Vec3d origin = image.grid.point(0, 0, k) + shift;
    const auto io = itk::GDCMImageIO::New();
    io->KeepOriginalUIDOn();
    io->SetNumberOfDimensions(3);
    itk::ImageIORegion everything(3);
    for (int i = 0; i < 3; ++i) {
      const auto axis = unsigned(i);
      const auto size = itk::SizeValueType(i < 2 ? image.grid.size[axis] : 1);
      io->SetDimensions(axis, size);
      everything.SetSize(axis, size);
      io->SetSpacing(axis, image.grid.spacing[i]);
      io->SetOrigin(axis, origin[i]);
      const Mat3d& d = image.grid.direction;
      io->SetDirection(axis, std::vector<double>{d[0][i], d[1][i], d[2][i]});
    }
    io->SetIORegion(everything);
    io->SetPixelType(itk::IOPixelEnum::SCALAR);
    io->SetNumberOfComponents(1);
    io->SetComponentType(itk::IOComponentEnum::SHORT);
    auto& tags = io->GetMetaDataDictionary();
    const auto tag = [&](const char* key, const std::string& value) {
      itk::EncapsulateMetaData<std::string>(tags, key, value);
    };
    tag("0008|0060", "CT");
    tag("0008|103e", "THORAX");
    tag("0020|000d", "1.2.826.0.1.3680043.2.1125.9");
    tag("0020|000e", series);
    tag("0008|0018", concatenate(series, ".", k + 1));
    tag("0020|0052", "1.2.826.0.1.3680043.2.1125.8");
    tag("0028|1052", "-1024");
    tag("0028|1053", "1");
    const auto first = image.data.begin() + long(image.grid.offset(0, 0, k));
    const std::vector<short> values(first, first + image.grid.size[0] * image.grid.size[1]);
    io->SetFileName(file(name).string());
    io->Write(values.data());
  }
  void expect_refused(const std::vector<std::string>& parts) const {
    expect_failure(Failure::input, parts, [&] { read_image(folder(), "moving image"); });
  }
};

TEST_F(DicomTest, SlicesAreOrderedByPositionNotByName) {
  for (int k = 0; k < 4; ++k) write_slice(concatenate("slice", (k * 3 + 2) % 4, ".dcm"), k);
  file("notes.txt", "not DICOM");
  const Image image = read_image(folder(), "moving image");
  EXPECT_EQ(image.data, ct().data);
  const Grid expected = right_handed_grid();
  ASSERT_EQ(image.grid.size, expected.size);
  for (const Vec3d& index : {Vec3d{0, 0, 0}, {6, 4, 0}, {6, 4, 3}})
    EXPECT_NEAR(norm(image.grid.point(index) - expected.point(index)), 0, position_tolerance_mm);
}

TEST_F(DicomTest, SeveralSeriesAreListed) {
  for (int k = 0; k < 4; ++k) write_slice(concatenate("a", k, ".dcm"), k, series_a);
  for (int k = 0; k < 3; ++k) write_slice(concatenate("b", k, ".dcm"), k, series_b);
  expect_refused({"2 DICOM series", "4 files CT 'THORAX'", "3 files", "a0.dcm", "b0.dcm", "folder of their own"});
}

TEST_F(DicomTest, MissingRepeatedAndTiltedSlices) {
  for (int k : {0, 1, 3}) write_slice(concatenate("a", k, ".dcm"), k);
  expect_refused({"off a regular grid", "missing"});
  write_slice("a2.dcm", 2, series_a, {0.3, 0, 0});
  expect_refused({"off a regular grid"});
  write_slice("a2.dcm", 2);
  EXPECT_NO_THROW(read_image(folder(), "moving image"));
  write_slice("again.dcm", 2);
  expect_refused({"repeated"});
}

TEST_F(DicomTest, OneSliceIsNoVolume) {
  write_slice("a.dcm", 0);
  expect_refused({"one slice only"});
}

TEST_F(DicomTest, RescaledSpacedAndNestedAsWritten) {
  for (int z = 0; z < 3; ++z) file(concatenate(z), dicom_bytes({z * 4, z == 1, z == 2, "2", "-1024"}));
  const Image image = read_image(folder(), "moving image");
  ASSERT_EQ(image.grid.size, (std::array<int, 3>{8, 6, 3}));
  EXPECT_EQ(image.grid.spacing, (Vec3d{0.7, 0.5, 4}));  // DICOM names the distance of rows first
  EXPECT_EQ(image.grid.origin, (Vec3d{10, 20, 0}));
  EXPECT_EQ(image.at(3, 2, 1), 2 * (10 * 19 + 4) - 1024);
}

TEST_F(DicomTest, CutOffSliceIsRefusedWhereverItEnds) {
  for (const DicomContent& content : {DicomContent{4}, DicomContent{4, true}, DicomContent{4, false, true}}) {
    for (int z : {0, 8, 12}) file(concatenate(z), dicom_bytes({z}));
    const std::string bytes = dicom_bytes(content);
    for (std::size_t size = 0; size < bytes.size(); ++size) {
      file("4", bytes.substr(0, size));
      expect_refused({"moving image"});
    }
    file("4", bytes);
    EXPECT_EQ(read_image(folder(), "moving image").grid.size[2], 4);
    file("4", bytes.substr(0, bytes.size() - 2));
    expect_refused({"4: the file is cut off"});
  }
}

}  // namespace
}  // namespace mtled
