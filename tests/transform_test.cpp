#include <itkAffineTransform.h>
#include <itkCompositeTransform.h>
#include <itkEuler2DTransform.h>
#include <itkEuler3DTransform.h>
#include <itkHDF5TransformIO.h>
#include <itkTranslationTransform.h>
#include <itkTxtTransformIO.h>

#include <limits>

#include "image_files.hpp"
#include "image_io/image_io.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

class ReadTransform : public TemporaryFolder {};

constexpr double rounding_mm = 1e-9;  ///< of matrices that text and HDF5 files keep in double precision
const std::vector<Vec3d> places{{0, 0, 0}, {10, -20, 30}, {-7.5, 3, 81}};

template <class Io>
void write(const std::filesystem::path& path, const std::vector<const itk::TransformBaseTemplate<double>*>& transforms) {
  const auto io = Io::New();
  typename Io::ConstTransformListType list;
  for (const auto* t : transforms) list.push_back(t);
  io->SetFileName(path.string());
  io->SetTransformList(list);
  io->Write();
}
using Text = itk::TxtTransformIOTemplate<double>;
using Hdf5 = itk::HDF5TransformIOTemplate<double>;

template <class Expected>
void expect_map(const DisplacementFunction& u, const Expected& expected, double tolerance) {
  for (const Vec3d& y : places) {
    Vec3d v;
    ASSERT_TRUE(u(y, v));
    EXPECT_LT(norm(y + v - expected(y)), tolerance) << y.x << " " << y.y << " " << y.z;
  }
}

itk::Euler3DTransform<double>::Pointer turn() {
  const auto t = itk::Euler3DTransform<double>::New();
  const double centre[] = {5, 6, 7}, shift[] = {1, -2, 3};
  t->SetCenter(centre);
  t->SetRotation(0, 0, 0.3);
  t->SetTranslation(shift);
  return t;
}
Vec3d turned(const Vec3d& y) { return RigidMotion{{5, 6, 7}, rotation_matrix({0, 0, 0.3}), {1, -2, 3}}.apply(y); }

TEST_F(ReadTransform, RotationsFromTextAndHdf5) {
  const auto t = turn();
  write<Text>(file("a.tfm"), {t});
  write<Hdf5>(file("a.h5"), {t});
  for (const char* name : {"a.tfm", "a.h5"}) expect_map(read_transform(file(name), "transform"), turned, rounding_mm);
}

TEST_F(ReadTransform, TextWrittenByHand) {
  const auto path = file("shift.txt", "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters: 1 0 0 0 2 0 0 0 1 4 5 6\nFixedParameters: 0 0 0\n");
  expect_map(read_transform(path, "transform"), [](const Vec3d& y) { return Vec3d{y.x + 4, 2 * y.y + 5, y.z + 6}; }, rounding_mm);
}

TEST_F(ReadTransform, CompositeAppliesTheLastFirst) {
  const auto shift = itk::TranslationTransform<double, 3>::New();
  const double by[] = {100, 0, 0};
  shift->SetOffset(by);
  const auto composite = itk::CompositeTransform<double, 3>::New();
  composite->AddTransform(turn());
  composite->AddTransform(shift);
  write<Hdf5>(file("c.h5"), {composite});
  write<Text>(file("c.tfm"), {composite});
  for (const char* name : {"c.h5", "c.tfm"}) expect_map(read_transform(file(name), "transform"), [](const Vec3d& y) { return turned(y + Vec3d{100, 0, 0}); }, rounding_mm);
}

TEST_F(ReadTransform, DisplacementFieldsOfEveryFormatAgreeAndEndAtTheirGrid) {
  VectorImage field(testing_files::oblique_grid());
  for (std::size_t v = 0; v < field.data.size(); ++v) field.data[v] = {float(v % 3), 0.25f * float(v % 5), -1.5f};
  write_vector_image(file("f.nrrd"), field);
  write_vector_image(file("f.mha"), field);
  write_displacement_transform(file("f.h5"), field);
  const Vec3d inside = field.grid.point(Vec3d{2.3, 1.6, 0.4}), outside = field.grid.point(Vec3d{-0.7, 1, 1});
  Vec3d expected;
  ASSERT_TRUE(linear_value(field, inside, expected));
  for (const char* name : {"f.nrrd", "f.mha", "f.h5"}) {
    const DisplacementFunction u = read_transform(file(name), "transform");
    Vec3d v;
    ASSERT_TRUE(u(inside, v)) << name;
    EXPECT_LT(norm(v - expected), rounding_mm * 1000) << name;  // the grid of a file may be stored in text
    EXPECT_FALSE(u(outside, v)) << name;
  }
}

TEST_F(ReadTransform, RefusesWithAReason) {
  const auto refused = [&](const std::filesystem::path& path, const std::vector<std::string>& parts) {
    expect_failure(Failure::input, parts, [&] { read_transform(path, "transform"); });
  };
  refused(file("no.h5"), {"reading transform", "no.h5", "no such file"});
  refused(folder(), {"folder"});
  refused(file("a.json", "{}"), {"not supported", ".h5", ".nrrd"});
  refused(file("bad.h5", "not HDF5"), {"damaged"});
  refused(file("bad.tfm", "#Insight Transform File V1.0\nTransform: Wobble_double_3_3\nParameters: 1\n"), {"bad.tfm"});
  const auto t = turn();
  write<Text>(file("two.tfm"), {t, t});
  refused(file("two.tfm"), {"2 transforms", "composite"});
  const auto flat = itk::Euler2DTransform<double>::New();
  write<Text>(file("flat.tfm"), {flat});
  refused(file("flat.tfm"), {"3-D"});
  write_displacement_transform(file("cut.h5"), VectorImage(testing_files::oblique_grid()));
  std::filesystem::resize_file(file("cut.h5"), std::filesystem::file_size(file("cut.h5")) / 2);
  refused(file("cut.h5"), {"cut.h5", "cut off"});
  VectorImage unbounded(testing_files::oblique_grid());
  unbounded.at(3, 2, 1).y = std::numeric_limits<float>::infinity();
  write_displacement_transform(file("inf.h5"), unbounded);
  refused(file("inf.h5"), {"(3, 2, 1)"});
  refused(file("bad.mat", "one matrix of many rows and columns"), {"damaged", ".tfm"});
  refused(file("empty.mat", ""), {"damaged"});
  refused(file("TransformParameters.0.txt", "(Transform \"EulerTransform\")\n"), {"elastix", "transformix"});
}

}  // namespace
}  // namespace mtled
