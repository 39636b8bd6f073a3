#include "imaging/figures.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "core/motion.hpp"
#include "imaging/drawing.hpp"
#include "imaging/slices.hpp"
#include "imaging/some_values.hpp"

namespace mtled {
namespace {

constexpr double half_x = 60, half_y = 50, half_z = 60;  ///< [mm] half extent of the test image
constexpr int margin = 12, gap = 8, heading = 26;        ///< [pixels] of the figures' layout
constexpr double pixel_mm = 340.0 / (1500 - 2 * margin - 2 * gap);
const Vec3d middle_of_body{10, -20, 300};

/// Axes i, j, k along LPS; centred on middle_of_body.
Grid plain_grid() {
  Grid grid;
  grid.size = {60, 50, 40};
  grid.spacing = {2, 2, 3};
  grid.origin = middle_of_body + Vec3d{1 - half_x, 1 - half_y, 1.5 - half_z};
  return grid;
}

/// The same voxels, stored as coronal slices from the back with i upwards and j to the right of the patient.
Grid coronal_grid() {
  Grid grid;
  grid.size = {40, 60, 50};
  grid.spacing = {3, 2, 2};
  grid.direction = Mat3d{{{0, -1, 0}, {0, 0, -1}, {1, 0, 0}}};
  grid.origin = middle_of_body + Vec3d{half_x - 1, half_y - 1, 1.5 - half_z};
  return grid;
}

template <class F>
Image image_of(const Grid& grid, const F& value) {
  Image image(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) image.at(i, j, k) = float(value(grid.point(i, j, k) - middle_of_body));
  return image;
}

/// CT-like: air in one corner, soft tissue, and bone to the patient's left, in front and at the head.
double marked(const Vec3d& p) {
  if (p.x < -0.8 * half_x && p.y > 0.8 * half_y && p.z < -0.8 * half_z) return -1000;
  const bool left = p.x > 0.5 * half_x && std::abs(p.y) < 15 && std::abs(p.z) < 15;
  const bool front = p.y < -0.5 * half_y && std::abs(p.x) < 15 && std::abs(p.z) < 15;
  const bool head = p.z > 0.5 * half_z && std::abs(p.x) < 15 && std::abs(p.y) < 15;
  return left || front || head ? 1000 : 40;
}

struct Pixel {
  int red, green, blue;
  bool white() const { return red > 250 && green > 250 && blue > 250; }
  bool grey() const { return red == green && green == blue && red > 100 && red < 150; }
  bool colored() const { return std::abs(red - green) > 60 || std::abs(green - blue) > 60; }
};

Pixel pixel(const Picture& picture, int x, int y) {
  const unsigned char* p = &picture.rgb[3 * std::size_t(y * picture.width + x)];
  return {p[0], p[1], p[2]};
}

struct Panel {
  double left, width, height;
};
/// Where the panels of an overlay of the test image lie.
Panel panel(int column) {
  const double x = 2 * half_x / pixel_mm, y = 2 * half_y / pixel_mm, z = 2 * half_z / pixel_mm;
  if (column == 0) return {margin, x, y};
  if (column == 1) return {margin + x + gap, x, z};
  return {margin + 2 * (x + gap), y, z};
}

/// Pixel of the first row at a fraction of a panel's width and height.
Pixel in_panel(const Picture& picture, int column, double across, double down) {
  const Panel p = panel(column);
  return pixel(picture, int(p.left + across * p.width), int(margin + 2 * heading + down * p.height));
}

TEST(OverlayFigure, ShowsTheHeadUpTheFrontUpAndThePatientsLeftOnTheRight) {
  for (const Grid& grid : {plain_grid(), coronal_grid()}) {
    const Image image = image_of(grid, marked), flat = image_of(grid, [](const Vec3d&) { return 40; });
    const Picture picture = overlay_figure(image, {{"flat", &flat}});
    // axial: left marker on the right, front marker up
    EXPECT_TRUE(in_panel(picture, 0, 0.88, 0.53).white());
    EXPECT_TRUE(in_panel(picture, 0, 0.12, 0.53).grey());
    EXPECT_TRUE(in_panel(picture, 0, 0.53, 0.15).white());
    EXPECT_TRUE(in_panel(picture, 0, 0.53, 0.85).grey());
    // coronal: left marker on the right, head marker up
    EXPECT_TRUE(in_panel(picture, 1, 0.88, 0.53).white());
    EXPECT_TRUE(in_panel(picture, 1, 0.12, 0.53).grey());
    EXPECT_TRUE(in_panel(picture, 1, 0.53, 0.15).white());
    EXPECT_TRUE(in_panel(picture, 1, 0.53, 0.85).grey());
    // sagittal: front marker on the left, head marker up
    EXPECT_TRUE(in_panel(picture, 2, 0.15, 0.53).white());
    EXPECT_TRUE(in_panel(picture, 2, 0.85, 0.53).grey());
    EXPECT_TRUE(in_panel(picture, 2, 0.53, 0.15).white());
    EXPECT_TRUE(in_panel(picture, 2, 0.53, 0.85).grey());
  }
}

TEST(OverlayFigure, DoesNotDependOnTheStorageOrder) {
  const Image a = image_of(plain_grid(), marked), b = image_of(coronal_grid(), marked);
  EXPECT_TRUE(overlay_figure(a, {{"same", &a}}).rgb == overlay_figure(b, {{"same", &b}}).rgb);
}

TEST(OverlayFigure, HasARowPerCandidate) {
  const Image image = image_of(plain_grid(), marked);
  const Picture one = overlay_figure(image, {{"before", &image}});
  const Picture two = overlay_figure(image, {{"before", &image}, {"after", &image}});
  EXPECT_EQ(one.width, 1500);
  EXPECT_EQ(one.rgb.size(), std::size_t(3) * one.width * one.height);
  EXPECT_EQ(two.height - one.height, heading + int(std::lround(2 * half_z / pixel_mm)) + gap);
  EXPECT_THROW(overlay_figure(image, {}), Error);
}

TEST(OverlayFigure, DrawsTheCandidatesEdgesWhereTheyAre) {
  const Image fixed = image_of(plain_grid(), [](const Vec3d&) { return 40; });
  const auto ball_on_the_left = [](const Vec3d& p) { return norm(p - Vec3d{20, 0, 0}) < 25 ? 200 : -900; };
  const Image candidate = image_of(plain_grid(), ball_on_the_left);
  const Picture picture = overlay_figure(fixed, {{"ball on the left", &candidate}});
  double sum_x = 0, sum_y = 0, largest_error = 0;
  int count = 0;
  const Panel axial = panel(0);
  for (int y = 0; y < int(axial.height); ++y)
    for (int x = 0; x < int(axial.width); ++x) {
      if (!pixel(picture, margin + x, margin + 2 * heading + y).colored()) continue;
      const double left = (x + 0.5) * pixel_mm - half_x, back = (y + 0.5) * pixel_mm - half_y;
      sum_x += left, sum_y += back, ++count;
      largest_error = std::max(largest_error, std::abs(std::hypot(left - 20, back) - 25));
    }
  ASSERT_GT(count, 300);
  EXPECT_NEAR(sum_x / count, 20, 0.5);
  EXPECT_NEAR(sum_y / count, 0, 0.5);
  EXPECT_LT(largest_error, 2);  // one voxel of the candidate
}

TEST(OverlayFigure, AcceptsACandidateOnAnotherGridThatDoesNotReachEverywhere) {
  const Image fixed = image_of(plain_grid(), marked);
  Grid small = plain_grid();
  small.size = {20, 20, 20};
  const Image candidate = image_of(small, marked);
  const Picture picture = overlay_figure(fixed, {{"small", &candidate}});
  const Panel axial = panel(0);
  for (int y = 0; y < int(axial.height); ++y)  // the candidate's border is no edge
    for (int x = 0; x < int(axial.width); ++x)
      EXPECT_FALSE(pixel(picture, margin + x, margin + 2 * heading + y).colored());
}

TEST(DisplacementFigure, ColoursTheCoveredPartOnly) {
  const Image moving = image_of(plain_grid(), marked);
  VectorImage displacement(moving.grid, Vec3f{3, 4, 0});
  Mask covered(moving.grid);
  for (int k = 0; k < 40; ++k)
    for (int j = 0; j < 50; ++j)
      for (int i = 30; i < 60; ++i) covered.at(i, j, k) = 1;
  const Picture picture = displacement_figure(moving, displacement, covered);
  EXPECT_EQ(picture.width, 1500);
  const double mm = 340.0 / (1500 - 114 - 2 * margin - 2 * gap);
  const int y = margin + heading + int(0.7 * 2 * half_y / mm), width = int(2 * half_x / mm);
  EXPECT_TRUE(pixel(picture, margin + int(0.75 * width), y).colored());
  EXPECT_TRUE(pixel(picture, margin + int(0.25 * width), y).grey());
}

TEST(DisplacementFigure, OfNoDisplacementIsDrawn) {
  const Image moving = image_of(plain_grid(), marked);
  const Picture picture = displacement_figure(moving, VectorImage(moving.grid), Mask(moving.grid, 1));
  EXPECT_GT(picture.height, 100);
}

constexpr int plot_left = 112, plot_width = 1352, plot_height = 220;  ///< [pixels] of the panels of the convergence figure
bool curve(const Pixel& p) { return p.blue > p.red + 60; }
bool tolerance_line(const Pixel& p) { return p.red > p.blue + 60; }

/// Pixel of a panel (0, 1, 2 from the top) at a fraction of its width and height, the latter from below.
Pixel in_plot(const Picture& picture, int plot, double across, double up) {
  const int top = margin + heading + plot * (heading + plot_height + gap);
  return pixel(picture, plot_left + int(across * plot_width), top + int((1 - up) * plot_height));
}

TEST(ConvergenceFigure, DrawsWhatIsKnownAndTheTolerance) {
  const double none = std::nan("");
  // Error: none at first and between steps 300 and 500. Energy: only at steps 0, 500 and 1000.
  std::vector<HistoryEntry> history;
  for (int step = 0; step <= 1000; step += 10)
    history.push_back({step, step < 100 || (step > 300 && step < 500) ? none : 0.5, 0.1, step < 500 ? 0.75 : 0.95, step % 500 ? none : 2000.0 - step});
  const Picture picture = convergence_figure(history, 0.05);
  EXPECT_EQ(picture.width, 1500);
  const double error = 1 + std::log10(0.5) / 2, tolerance = 1 + std::log10(0.05) / 2;  // from 0.01 to 1 mm
  for (const double across : {0.15, 0.25, 0.55, 0.95}) EXPECT_TRUE(curve(in_plot(picture, 0, across, error))) << across;
  for (const double across : {0.05, 0.35, 0.45}) EXPECT_FALSE(curve(in_plot(picture, 0, across, error))) << across;
  EXPECT_FALSE(curve(in_plot(picture, 0, 0.25, error - 0.05)));
  int dashes = 0, pixels = 0;
  for (double across = 0.3; across < 0.9; across += 0.001, ++pixels) dashes += tolerance_line(in_plot(picture, 0, across, tolerance));
  EXPECT_NEAR(double(dashes) / pixels, 0.5, 0.15) << "dashed, so that it is known without colour";
  // Rate from 0.7 to 1, energy from 800 to 2000 mN mm; the energy's line bridges the steps without a value.
  EXPECT_TRUE(curve(in_plot(picture, 1, 0.25, 0.05 / 0.3)));
  EXPECT_TRUE(curve(in_plot(picture, 1, 0.75, 0.25 / 0.3)));
  EXPECT_TRUE(curve(in_plot(picture, 2, 0.75, 450.0 / 1200)));
  EXPECT_TRUE(curve(in_plot(picture, 2, 0.25, 950.0 / 1200)));
}

TEST(ConvergenceFigure, OfAShortOrConstantHistoryIsDrawn) {
  const double none = std::nan("");
  EXPECT_THROW(convergence_figure({}, 0.05), Error);
  EXPECT_GT(convergence_figure({{1, none, 0, 0.7, 0}}, 0.05).height, 500);
  EXPECT_GT(convergence_figure({{1, 0, 0, 1, none}, {11, 0, 0, 1, none}}, 1).height, 500);
}

TEST(FieldDifferenceFigure, ShowsWherePointsDifferHowManyAndHowMuchTheyMove) {
  const Image moving = image_of(plain_grid(), marked);
  // Half of the body differs by 1 mm where the reference moves it by 10 mm, the other half, to the left, by 2 mm at 20 mm.
  const auto left = [](const Vec3d& x) { return x.x > middle_of_body.x; };
  const auto reference = [&](const Vec3d& x, Vec3d& u) { return u = {0, 0, left(x) ? 20.0 : 10.0}, true; };
  const auto u = [&](const Vec3d& x, Vec3d& v) { return v = {0, 0, left(x) ? 22.0 : 11.0}, true; };
  const FieldDifference d = compare_displacements(u, reference, moving.grid);
  EXPECT_EQ(d.median, 1.5);
  const Picture picture = field_difference_figure(moving, [&](const Grid& slice) { return difference_on_slice(u, reference, slice); }, d, "difference");
  EXPECT_EQ(picture.width, 1500);
  const double mm = 340.0 / (1500 - 114 - 2 * margin - 2 * gap);
  const int y = margin + heading + int(0.7 * 2 * half_y / mm), width = int(2 * half_x / mm);
  const Pixel far = pixel(picture, margin + int(0.75 * width), y), near = pixel(picture, margin + int(0.25 * width), y);
  EXPECT_GT(far.green - far.blue, near.green - near.blue) << "2 mm is nearer to the yellow end of the colours than 1 mm";
  // The distribution up to 2.2 mm: 50 % of the points at 1 mm, nothing in between.
  constexpr int share_left = 112, share_width = 618, share_height = 330;
  const int top = margin + heading + int(std::lround(2 * half_z / mm)) + margin + heading;
  const auto shares = [&](double difference, double percent) {
    Pixel found{255, 255, 255};
    for (int dy = -2; dy <= 2; ++dy)
      if (const Pixel p = pixel(picture, share_left + int(difference / 2.2 * share_width), top + int((1 - percent / 100) * share_height) + dy); curve(p)) found = p;
    return curve(found);
  };
  EXPECT_TRUE(shares(1.2, 50));
  EXPECT_TRUE(shares(1.8, 50));
  EXPECT_FALSE(shares(1.2, 70));
  EXPECT_FALSE(shares(0.5, 50));
}

TEST(FieldDifferenceFigure, OfEqualFieldsIsDrawn) {
  const Image moving = image_of(plain_grid(), marked);
  const auto rest = [](const Vec3d&, Vec3d& u) { return u = {}, true; };
  const FieldDifference d = compare_displacements(rest, rest, moving.grid);
  EXPECT_GT(field_difference_figure(moving, [&](const Grid& slice) { return difference_on_slice(rest, rest, slice); }, d, "difference").height, 500);
}

TEST(Drawing, LinesJoinTheirEndsAndAreAsWideAsAsked) {
  Picture picture = blank_picture(60, 40, white);
  draw_line(picture, 10, 5, 50, 35, 4, black);
  for (const double t : {0.0, 0.3, 0.5, 1.0}) EXPECT_EQ(pixel(picture, int(10 + 40 * t), int(5 + 30 * t)).red, 0) << t;
  const auto ink = std::count(picture.rgb.begin(), picture.rgb.end(), 0) / 3;
  EXPECT_NEAR(double(ink), 4 * 50 + 4 * 3.14, 0.1 * 212) << "length times width and two half discs";
  draw_line(picture, -20, 20, 100, 20, 3, black);  // what lies outside is ignored
}

TEST(Slices, HaveSquarePixelsAndFollowThePlaneThroughAPoint) {
  Grid grid = plain_grid();
  grid.direction = rotation_matrix({0.2, 0.1, 0.4});
  const Vec3d through = middle(grid) + Vec3d{1, 2, 3};
  for (const Plane plane : {Plane::axial, Plane::coronal, Plane::sagittal}) {
    const Grid slice = slice_grid(grid, through, plane, 0.7);
    EXPECT_EQ(slice.size[2], 1);
    EXPECT_NEAR(slice.index(through).z, 0, 1e-9);
    const Grid fine = refined(slice, 2);
    EXPECT_NEAR(norm(fine.point(Vec3d{-0.5, -0.5, 0}) - slice.point(Vec3d{-0.5, -0.5, 0})), 0, 1e-9);
    EXPECT_EQ(fine.size[0], 2 * slice.size[0]);
  }
}

TEST(DisplayWindow, IsSoftTissueForCtAndPercentilesOtherwise) {
  Image image(plain_grid(), -1000);
  image.data[0] = 500;
  EXPECT_EQ(display_window(image).low, -160);
  EXPECT_EQ(display_window(image).high, 240);
  for (std::size_t v = 0; v < image.data.size(); ++v)  // like MR, skull-stripped
    image.data[v] = v < 60000 ? 0 : float(100 + v % 101);
  EXPECT_NEAR(display_window(image).low, 101, 1);
  EXPECT_NEAR(display_window(image).high, 198, 1);
  std::fill(image.data.begin(), image.data.end(), 7);
  EXPECT_LT(display_window(image).low, display_window(image).high);
}

TEST(SomeValues, AreOfAllColumnsOfALargeImage) {
  Grid grid;
  grid.size = {40, 100, 1975};  // 200000 values of it would be every 40th
  Image image(grid);
  for (std::size_t v = 0; v < image.data.size(); ++v) image.data[v] = v % 40 == 7 ? NAN : float(v % 40);
  const std::vector<float> values = some_values(image);
  EXPECT_LE(values.size(), 200000u);
  const double per_column = double(image.data.size()) / 41 / 40;  // every 41st is taken
  for (int i = 0; i < 40; ++i) EXPECT_NEAR(std::count(values.begin(), values.end(), float(i)), i == 7 ? 0 : per_column, 1) << i;
}

TEST(DisplayWindow, OfALargeImageWithFewBrightVoxelsShowsThem) {
  Grid grid;
  grid.size = {101, 100, 100};
  Image image(grid, 2);
  image.data[1] = 7;  // not among those that are taken
  EXPECT_EQ(display_window(image).low, 2);
  EXPECT_EQ(display_window(image).high, 7);
}

TEST(Drawing, TextLeavesInkOfItsColorAndUnknownCharactersAreMarked) {
  Picture picture = blank_picture(200, 30, white), mark = picture;
  draw_text(picture, 3, 3, "5 mm", black);
  EXPECT_NE(std::count(picture.rgb.begin(), picture.rgb.end(), 0), 0);
  Picture unknown = mark;
  draw_text(mark, 0, 0, "?", black);
  draw_text(unknown, 0, 0, "\n", black);
  EXPECT_TRUE(mark.rgb == unknown.rgb);
  draw_text(picture, 190, 25, "beyond the border", black);  // ignored, not written
}

}  // namespace
}  // namespace mtled
