#include <gtest/gtest.h>
#include <png.h>

#include <cstdio>
#include <jpeglib.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "core/error.hpp"
#include "imaging/warp.hpp"
#include "report/encode.hpp"
#include "report/node_cloud.hpp"
#include "report/page.hpp"
#include "report/report_view.hpp"
#include "report/verdict.hpp"

namespace mtled {
namespace {

constexpr double rounding = 1e-9;  ///< of numbers below 1000 in double precision
constexpr float nan_value = std::numeric_limits<float>::quiet_NaN();

std::string text_of(const std::string& bytes) { return base64({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}); }

std::vector<std::uint8_t> decoded(const std::string& text) {
  const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::vector<std::uint8_t> bytes;
  unsigned group = 0, bits = 0;
  for (const char c : text) {
    if (c == '=') break;
    group = group << 6 | unsigned(digits.find(c)), bits += 6;
    if (bits >= 8) bits -= 8, bytes.push_back(std::uint8_t(group >> bits & 255));
  }
  return bytes;
}

/// The picture of a `data:` address.
GreyPicture picture_of(const std::string& address) {
  const std::size_t comma = address.find(',');
  const std::vector<std::uint8_t> bytes = decoded(address.substr(comma + 1));
  GreyPicture picture;
  if (address.starts_with("data:image/png;base64,")) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    EXPECT_TRUE(png_image_begin_read_from_memory(&image, bytes.data(), bytes.size()));
    EXPECT_EQ(image.format, png_uint_32(PNG_FORMAT_GRAY));
    picture = {int(image.width), int(image.height), std::vector<std::uint8_t>(PNG_IMAGE_SIZE(image))};
    EXPECT_TRUE(png_image_finish_read(&image, nullptr, picture.grey.data(), 0, nullptr));
    return picture;
  }
  EXPECT_TRUE(address.starts_with("data:image/jpeg;base64,"));
  jpeg_decompress_struct reader;
  jpeg_error_mgr errors;
  reader.err = jpeg_std_error(&errors);
  jpeg_create_decompress(&reader);
  jpeg_mem_src(&reader, bytes.data(), bytes.size());
  jpeg_read_header(&reader, TRUE);
  EXPECT_EQ(reader.num_components, 1);
  jpeg_start_decompress(&reader);
  picture = {int(reader.output_width), int(reader.output_height), std::vector<std::uint8_t>(std::size_t(reader.output_width) * reader.output_height)};
  while (reader.output_scanline < reader.output_height) {
    JSAMPROW row = &picture.grey[std::size_t(reader.output_scanline) * reader.output_width];
    jpeg_read_scanlines(&reader, &row, 1);
  }
  jpeg_finish_decompress(&reader);
  jpeg_destroy_decompress(&reader);
  return picture;
}

/// Byte of voxel (i, j, k) in a mosaic, found as the page finds it.
int byte_at(const Json& mosaic, int i, int j, int k) {
  const GreyPicture picture = picture_of(mosaic["picture"]);
  const int columns = mosaic["columns"], x = k % columns * mosaic["tile"][0].get<int>() + i, y = k / columns * mosaic["tile"][1].get<int>() + j;
  return picture.grey[std::size_t(y) * std::size_t(picture.width) + std::size_t(x)];
}

Grid grid_of(std::array<int, 3> size, const Vec3d& spacing = {1, 1, 1}, const Vec3d& origin = {}) {
  Grid grid;
  grid.size = size, grid.spacing = spacing, grid.origin = origin;
  return grid;
}

TEST(Base64, OfTheExamplesOfItsStandard) {
  EXPECT_EQ(text_of(""), "");
  EXPECT_EQ(text_of("f"), "Zg==");
  EXPECT_EQ(text_of("fo"), "Zm8=");
  EXPECT_EQ(text_of("foo"), "Zm9v");
  EXPECT_EQ(text_of("foob"), "Zm9vYg==");
  EXPECT_EQ(text_of("fooba"), "Zm9vYmE=");
  EXPECT_EQ(text_of("foobar"), "Zm9vYmFy");
  EXPECT_EQ(text_of("\xff\xfe\xfd"), "//79");
}

TEST(Pictures, PngIsExactAndJpegNearlySo) {
  GreyPicture picture{40, 24, {}};
  for (int y = 0; y < 24; ++y)
    for (int x = 0; x < 40; ++x) picture.grey.push_back(std::uint8_t(4 * x + 3 * y));
  const GreyPicture png = picture_of(png_address(picture)), jpeg = picture_of(jpeg_address(picture, 90));
  EXPECT_EQ(png.width, 40);
  EXPECT_EQ(png.grey, picture.grey);
  ASSERT_EQ(jpeg.grey.size(), picture.grey.size());
  int largest = 0;
  for (std::size_t p = 0; p < picture.grey.size(); ++p) largest = std::max(largest, std::abs(int(jpeg.grey[p]) - int(picture.grey[p])));
  EXPECT_LE(largest, 4);  // levels; a ramp has little for JPEG to lose
}

TEST(ViewGrid, CoversAnImageWithCubes) {
  const Grid image = grid_of({20, 10, 5}, {1, 2, 4}, {-3, 5, 7});
  const Grid view = view_grid(image, 1000000);
  EXPECT_EQ(view.size, (std::array<int, 3>{20, 20, 20}));
  EXPECT_EQ(view.spacing, (Vec3d{1, 1, 1}));
  EXPECT_EQ(view.origin, (Vec3d{-3, 4.5, 5.5}));  // the corners coincide
  const Grid coarse = view_grid(image, 1000);
  EXPECT_EQ(coarse.size, (std::array<int, 3>{10, 10, 10}));
  EXPECT_EQ(view_grid(image, 999).size, (std::array<int, 3>{9, 9, 9}));
  EXPECT_EQ(coarse.spacing.x, coarse.spacing.z);
}

TEST(ViewGrid, IsAlongTheBodyWhateverTheDirectionOfTheImage) {
  Grid image = grid_of({10, 20, 30});
  image.direction = Mat3d{{{0, 0, -1}, {1, 0, 0}, {0, -1, 0}}};  // i to the back, j to the feet, k to the right
  image.origin = {50, 60, 70};
  const Grid view = view_grid(image, 1000000);
  EXPECT_EQ(view.size, (std::array<int, 3>{30, 10, 20}));
  EXPECT_EQ(view.origin, (Vec3d{21, 60, 51}));
  Image values(image);
  values.at(3, 4, 5) = 1;  // at (50-5, 60+3, 70-4)
  const ByteVolume bytes = grey_bytes(values, view, {0, 1});
  EXPECT_EQ(bytes.at(45 - 21, 3, 66 - 51), 255);
  EXPECT_EQ(std::count(bytes.data.begin(), bytes.data.end(), 255), 1);
}

TEST(ViewGrid, OfAMaskWithAMarginInsideTheImage) {
  const Grid image = grid_of({20, 20, 20});
  Mask mask(image);
  mask.at(5, 6, 18) = 1;
  const Grid view = view_grid(image, 1000000, &mask, 2);
  EXPECT_EQ(view.size, (std::array<int, 3>{5, 5, 4}));
  EXPECT_EQ(view.origin, (Vec3d{3, 4, 16}));
  EXPECT_THROW(view_grid(image, 1000, std::make_unique<Mask>(image).get()), Error);
}

TEST(GreyBytes, AreMeansOfFinerVoxels) {
  Image image(grid_of({4, 4, 4}));
  for (std::size_t v = 0; v < image.data.size(); ++v) image.data[v] = float(v % 2 == 0 ? 100 : 300);
  Grid view = grid_of({2, 2, 2}, {2, 2, 2}, {0.5, 0.5, 0.5});
  const ByteVolume bytes = grey_bytes(image, view, {0, 510});
  for (const std::uint8_t b : bytes.data) EXPECT_EQ(b, 100);  // 200 of 510
  view.origin.x = 10;
  EXPECT_EQ(grey_bytes(image, view, {0, 510}).data[0], 0);
}

TEST(ScalarBytes, KeepZeroForWhatIsNotKnown) {
  Image image(grid_of({4, 1, 1}));
  image.data = {nan_value, 2, 4, 9};
  EXPECT_EQ(scalar_bytes(image, grid_of({5, 1, 1}), {2, 6}).data, (std::vector<std::uint8_t>{0, 1, 128, 255, 0}));
}

TEST(EdgeBits, FallOnCoarseVoxelsThatHoldThemAndFineOnesWithin) {
  Mask edges(grid_of({6, 6, 6}));
  edges.at(4, 0, 0) = 1;
  ByteVolume coarse(grid_of({2, 2, 2}, {3, 3, 3}, {1, 1, 1})), fine(grid_of({12, 12, 12}, {0.5, 0.5, 0.5}, {-0.25, -0.25, -0.25}));
  set_bits(coarse, edges, 4);
  EXPECT_EQ(coarse.data, (std::vector<std::uint8_t>{0, 4, 0, 0, 0, 0, 0, 0}));
  set_bits(coarse, edges, 1);
  EXPECT_EQ(coarse.data[1], 5);
  set_bits(fine, edges, 1);
  EXPECT_EQ(std::count(fine.data.begin(), fine.data.end(), 1), 8);
  EXPECT_EQ(fine.at(8, 1, 1), 1);
}

TEST(Mosaic, HoldsEverySliceInTilesOfWholeBlocks) {
  ByteVolume volume(grid_of({5, 9, 7}));
  for (std::size_t v = 0; v < volume.data.size(); ++v) volume.data[v] = std::uint8_t(v % 251);
  const Json mosaic = mosaic_as_png(volume);
  EXPECT_EQ(mosaic["tile"], (Json{8, 16}));
  for (const auto& [i, j, k] : {std::array{0, 0, 0}, std::array{4, 8, 6}, std::array{2, 3, 5}}) EXPECT_EQ(byte_at(mosaic, i, j, k), volume.at(i, j, k));
}

TEST(CoarseVectors, AreUnknownOutsideTheMask) {
  VectorImage field(grid_of({8, 8, 8}), Vec3f{1.5f, -20, 300});
  Mask known(field.grid, 1);
  for (int k = 0; k < 8; ++k)
    for (int j = 0; j < 8; ++j)
      for (int i = 0; i < 4; ++i) known.at(i, j, k) = 0;
  const Json j = coarse_vectors(field, known, field.grid, 8);
  EXPECT_EQ(j["size"], (Json{2, 2, 2}));
  const std::vector<std::uint8_t> bytes = decoded(j["data"]);
  ASSERT_EQ(bytes.size(), 48u);
  const auto value = [&](std::size_t n) { return std::int16_t(std::uint16_t(bytes[2 * n] | bytes[2 * n + 1] << 8)); };
  EXPECT_EQ(value(0), -32768);
  const double scale = j["scale_mm"];
  EXPECT_NEAR(value(3) * scale, 1.5, scale / 2);
  EXPECT_NEAR(value(4) * scale, -20, scale / 2);
  EXPECT_NEAR(value(5) * scale, 300, scale / 2);
}

TEST(ReportView, ShowsAFieldWithItsFolds) {
  const Grid grid = grid_of({16, 8, 8});
  VectorImage field(grid);
  for (int k = 0; k < 8; ++k)
    for (int j = 0; j < 8; ++j)
      for (int i = 0; i < 16; ++i) field.at(i, j, k) = {i < 8 ? 0.5f * float(i) : 4 - 1.5f * float(i - 8), 0, 0};  // det J 1.5, then -0.5
  ReportView view;
  view.add_space("fixed", view_grid(grid, 1000000));
  add_field(view, field, Mask(grid, 1), volume_ratio(field, Mask(grid, 1)));
  const Json j = view.json();
  const Json& ratio = j["volumes"][1];
  EXPECT_EQ(ratio["id"], "jacobian");
  EXPECT_LT(ratio["low"].get<double>(), 0);
  const auto value = [&](int i) { return ratio["low"].get<double>() + (byte_at(ratio["mosaic"], i, 4, 4) - 1) / 254.0 * (ratio["high"].get<double>() - ratio["low"].get<double>()); };
  EXPECT_NEAR(value(3), 1.5, 0.01);
  EXPECT_LT(value(12), 0);
  const Json& size = j["volumes"][0];
  EXPECT_EQ(size["high"].get<double>(), 6.5);
  EXPECT_EQ(byte_at(size["mosaic"], 15, 0, 0), 255);
  EXPECT_EQ(j["arrows"]["space"], "fixed");
  EXPECT_FALSE(ratio["open_start"].get<bool>());
  EXPECT_EQ(ratio["high"].get<double>(), 2) << "as far as colours around 1 reach that begin at 0";
}

/// The volume ratio of a field that stretches one half of a box along x by `gradient`.
Json ratio_of(float gradient) {
  const Grid grid = grid_of({16, 8, 8});
  VectorImage field(grid);
  for (int k = 0; k < 8; ++k)
    for (int j = 0; j < 8; ++j)
      for (int i = 8; i < 16; ++i) field.at(i, j, k) = {gradient * float(i - 8), 0, 0};
  ReportView view;
  view.add_space("fixed", view_grid(grid, 1000000));
  add_field(view, field, Mask(grid, 1), volume_ratio(field, Mask(grid, 1)));
  return view.json()["volumes"][1];
}

TEST(ReportView, StoresNoFoldsWhereNothingFolds) {
  const Json mild = ratio_of(-0.3f), nearly = ratio_of(-0.9995f);
  EXPECT_TRUE(mild["open_start"].get<bool>());
  EXPECT_EQ(mild["low"].get<double>(), 0.5);
  EXPECT_EQ(mild["high"].get<double>(), 1.5);
  EXPECT_EQ(byte_at(nearly["mosaic"], 13, 4, 4), 1);
  EXPECT_GT(nearly["low"].get<double>(), 0) << "a ratio of 0.0005 must not be shown as a fold";
  EXPECT_LT(ratio_of(-1.0005f)["low"].get<double>(), 0);
}

TEST(ReportView, KeepsEdgesOfSeveralImagesApart) {
  const Grid grid = grid_of({8, 8, 8});
  Mask a(grid), b(grid);
  a.at(1, 1, 1) = b.at(1, 1, 1) = b.at(2, 1, 1) = 1;
  ReportView view;
  view.add_space("fixed", grid);
  view.add_edges("fixed", a);
  view.add_edges("after", b);
  const Json edges = view.json()["volumes"][0];
  EXPECT_EQ(edges["bits"], (Json{{"1", "fixed"}, {"2", "after"}}));
  EXPECT_EQ(byte_at(edges["mosaic"], 1, 1, 1), 3);
  EXPECT_EQ(byte_at(edges["mosaic"], 2, 1, 1), 2);
}

TEST(GreyScale, HasWindowsOfCtForCtOnly) {
  Image ct(grid_of({10, 10, 10}), 40);
  ct.data[0] = -1000, ct.data[1] = 800;
  EXPECT_EQ(grey_scale_of(ct).unit, "HU");
  EXPECT_EQ(grey_scale_of(ct).windows.size(), 4u);
  Image mr(grid_of({10, 10, 10}));
  for (std::size_t v = 0; v < mr.data.size(); ++v) mr.data[v] = float(v);
  const GreyScale scale = grey_scale_of(mr);
  EXPECT_EQ(scale.unit, "");
  EXPECT_NEAR(scale.range.high, 997.002, rounding);
}

TEST(NodeCloud, KeepsAllOfAFewNodes) {
  const Json j = node_cloud({{0, 0, 0}, {10, 20, 30}}, {{1, 0, 0}, {0, 2, 0}}, {2.5f, 60}, {0, 1300}, 100);
  EXPECT_EQ(j["shown"], 2);
  const auto rest = decoded(j["rest"]);
  const double scale = j["scale_mm"];
  EXPECT_EQ(j["origin_mm"], (Json{5.0, 10.0, 15.0}));
  EXPECT_NEAR(std::int16_t(std::uint16_t(rest[6] | rest[7] << 8)) * scale, 5, scale / 2);
  EXPECT_EQ(j["labels"], (Json{1300}));
  EXPECT_EQ(decoded(j["label"]), (std::vector<std::uint8_t>{0, 1}));
  EXPECT_EQ(decoded(j["scalars"][0]["data"]), (std::vector<std::uint8_t>{128, 255}));
}

TEST(NodeCloud, KeepsNumbersOfLabelsApart) {
  constexpr std::size_t count = 300;
  std::vector<float> label(count);
  for (std::size_t n = 0; n < count; ++n) label[n] = float(10 * (count - n));
  const std::vector<float> kpa(count);
  const Json j = node_cloud(std::vector<Vec3d>(count), std::vector<Vec3d>(count), kpa, label, count);
  const auto bytes = decoded(j["label"]);
  ASSERT_EQ(j["labels"].size(), 255u);
  for (std::size_t n = 0; n < count; ++n) {
    if (n < count - 255) EXPECT_EQ(bytes[n], 0) << n;
    else EXPECT_EQ(j["labels"][bytes[n] - 1u].get<float>(), label[n]) << n;
  }
  EXPECT_TRUE(node_cloud({{0, 0, 0}}, {{0, 0, 0}}, {1}, {0})["labels"].empty());
}

TEST(NodeCloud, ChoosesEvenlyAndAlwaysTheSame) {
  std::vector<Vec3d> nodes;
  for (int n = 0; n < 20000; ++n) nodes.push_back({double(n), 0, 0});
  const std::vector<Vec3d> u(nodes.size());
  const std::vector<float> zero(nodes.size());
  const Json j = node_cloud(nodes, u, zero, zero, 2000);
  EXPECT_EQ(j["shown"], 2000);
  EXPECT_EQ(j.dump(), node_cloud(nodes, u, zero, zero, 2000).dump());
  const auto rest = decoded(j["rest"]);
  int lower = 0;
  for (std::size_t n = 0; n < 2000; ++n) lower += std::int16_t(std::uint16_t(rest[6 * n] | rest[6 * n + 1] << 8)) < 0;
  EXPECT_NEAR(lower, 1000, 5 * std::sqrt(500.0));  // five standard deviations of a fair choice
  EXPECT_THROW(node_cloud(nodes, {}, zero, zero), Error);
}

Json good_facts() {
  return Json::parse(R"({"candidates": [{"id": "before"}, {"id": "rigid"}, {"id": "mtled"}],
    "edges": {"before": {"within_two_voxels_all_edges": 0.80}, "rigid": {"within_two_voxels_all_edges": 0.90}, "mtled": {"within_two_voxels_all_edges": 0.97}},
    "landmarks": {"before": {"mean_mm": 10}, "rigid": {"mean_mm": 5}, "mtled": {"mean_mm": 0.2}},
    "labels": {"before": [{"dice": 0.4}, {"dice": null}], "mtled": [{"dice": 0.9}, {"dice": 0.8}]},
    "jacobian": {"folded_voxels": 0, "min": 0.5, "max": 1.5}, "motions": [{"label": 3, "rms_deviation_mm": 0.1}], "warnings": [],
    "solver": {"converged": true, "error_estimate_mm": 0.01, "steps": 300}})");
}

const Json* item(const Json& verdict, const std::string& label) {
  for (const Json& i : verdict["items"])
    if (i["label"] == label) return &i;
  return nullptr;
}

TEST(Verdict, OfARegistrationThatIsBetterEverywhere) {
  const Json v = verdict_of(good_facts());
  EXPECT_EQ(v["level"], "good");
  const Json* edges = item(v, "Edges within two voxels");
  ASSERT_TRUE(edges);
  EXPECT_EQ((*edges)["value"], "97.0 %");
  EXPECT_EQ((*edges)["compared"], "80.0 % before, 90.0 % rigid");
  EXPECT_EQ((*item(v, "Label overlap, mean Dice"))["value"], "0.850");
  EXPECT_FALSE(item(v, "Warnings"));
}

TEST(Verdict, SaysWhatIsWorseThanRigidOrThanNothing) {
  Json facts = good_facts();
  facts["landmarks"]["mtled"]["mean_mm"] = 7;
  Json v = verdict_of(facts);
  EXPECT_EQ(v["level"], "check");
  EXPECT_EQ((*item(v, "Landmark error, mean"))["detail"], "Worse than: rigid.");
  facts["landmarks"]["mtled"]["mean_mm"] = 12;
  v = verdict_of(facts);
  EXPECT_EQ(v["level"], "bad");
  EXPECT_EQ((*item(v, "Landmark error, mean"))["detail"], "Worse than doing nothing.");
  EXPECT_NE(v["headline"].get<std::string>().find("12.00 mm"), std::string::npos);
}

TEST(Verdict, OfFoldsMissedMotionsWarningsAndDirection) {
  Json facts = good_facts();
  facts["jacobian"]["folded_voxels"] = 3;
  EXPECT_EQ(verdict_of(facts)["level"], "bad");
  facts = good_facts();
  facts["motions"][0]["rms_deviation_mm"] = 0.6;
  EXPECT_EQ(verdict_of(facts)["level"], "check");
  EXPECT_EQ((*item(verdict_of(facts), "Bones off their motions"))["compared"], "rms of the worst label, 3");
  facts = good_facts();
  facts["warnings"].push_back("label 3 matches poorly");
  EXPECT_EQ(verdict_of(facts)["level"], "check");
  facts = good_facts();
  facts["direction"] = {{"reversed_fits_better", true}};
  EXPECT_EQ(verdict_of(facts)["level"], "bad");
}

TEST(Verdict, KnowsNothingWithoutAnythingMeasured) {
  const Json v = verdict_of(Json::parse(R"({"candidates": []})"));
  EXPECT_EQ(v["level"], "check");
  EXPECT_TRUE(v["items"].empty());
  const Json empty_edges = verdict_of(Json::parse(R"({"candidates": [{"id": "after"}], "edges": {"after": {"within_two_voxels_all_edges": null}}})"));
  EXPECT_TRUE(empty_edges["items"].empty());
}

TEST(Page, KeepsDataInsideItsElement) {
  const std::string text = json_for_html({{"name", "</script><!-- <b>"}, {"odd", "\xff"}});
  EXPECT_EQ(text.find('<'), std::string::npos);
  EXPECT_EQ(Json::parse(text)["name"], "</script><!-- <b>");
  const std::string page = report_page({{"version", 1}});
  EXPECT_NE(page.find(R"({"version":1})"), std::string::npos);
  for (const char* marker : {"/*STYLE*/", "/*SCRIPT*/", "/*DATA*/"}) EXPECT_EQ(page.find(marker), std::string::npos) << marker;
  for (const std::string scheme : {"http://", "https://"})  // nothing is fetched: names of XML are no addresses
    for (std::size_t at = page.find(scheme); at != std::string::npos; at = page.find(scheme, at + 1)) EXPECT_EQ(page.substr(at, 18), "http://www.w3.org/") << page.substr(at, 60);
}

}  // namespace
}  // namespace mtled
