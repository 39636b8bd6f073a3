#include "imaging/drawing.hpp"

#include <algorithm>
#include <cmath>

#include "imaging/font.hpp"

namespace mtled {
namespace {

std::size_t byte_offset(const Picture& picture, int x, int y) {
  return 3 * (std::size_t(y) * std::size_t(picture.width) + std::size_t(x));
}

}  // namespace

Picture blank_picture(int width, int height, Color background) {
  Picture picture{width, height, std::vector<unsigned char>(3 * std::size_t(width) * std::size_t(height))};
  fill(picture, {0, 0, width, height}, background);
  return picture;
}

void set_pixel(Picture& picture, int x, int y, Color color) {
  if (x < 0 || y < 0 || x >= picture.width || y >= picture.height) return;
  unsigned char* pixel = &picture.rgb[byte_offset(picture, x, y)];
  pixel[0] = color.red;
  pixel[1] = color.green;
  pixel[2] = color.blue;
}

void fill(Picture& picture, const Rectangle& area, Color color) {
  for (int y = area.top; y < area.top + area.height; ++y)
    for (int x = area.left; x < area.left + area.width; ++x) set_pixel(picture, x, y, color);
}

void draw_line(Picture& picture, double x0, double y0, double x1, double y1, int thickness, Color color) {
  const int steps = 1 + int(std::ceil(std::max(std::abs(x1 - x0), std::abs(y1 - y0))));
  const double radius = 0.5 * thickness;
  for (int i = 0; i <= steps; ++i) {
    const double x = x0 + (x1 - x0) * i / steps, y = y0 + (y1 - y0) * i / steps;  // pixel (a, b) covers [a, a + 1] x [b, b + 1]
    for (int b = int(std::floor(y - radius)); b <= int(y + radius); ++b)
      for (int a = int(std::floor(x - radius)); a <= int(x + radius); ++a)
        if (std::hypot(a + 0.5 - x, b + 0.5 - y) <= std::max(radius, 0.75)) set_pixel(picture, a, b, color);
  }
}

void paste(Picture& picture, const Picture& tile, int left, int top) {
  for (int y = 0; y < tile.height; ++y)
    for (int x = 0; x < tile.width; ++x) {
      const unsigned char* pixel = &tile.rgb[byte_offset(tile, x, y)];
      set_pixel(picture, left + x, top + y, {pixel[0], pixel[1], pixel[2]});
    }
}

Picture halved(const Picture& picture) {
  Picture half = blank_picture(picture.width / 2, picture.height / 2, black);
  for (int y = 0; y < half.height; ++y)
    for (int x = 0; x < half.width; ++x)
      for (int c = 0; c < 3; ++c) {
        const std::size_t upper = byte_offset(picture, 2 * x, 2 * y) + std::size_t(c);
        const std::size_t lower = byte_offset(picture, 2 * x, 2 * y + 1) + std::size_t(c);
        const int sum = picture.rgb[upper] + picture.rgb[upper + 3] + picture.rgb[lower] + picture.rgb[lower + 3];
        half.rgb[byte_offset(half, x, y) + std::size_t(c)] = static_cast<unsigned char>((sum + 2) / 4);
      }
  return half;
}

int text_width(const std::string& text) { return int(text.size()) * glyph_width; }

void draw_text(Picture& picture, int left, int top, const std::string& text, Color color) {
  for (const char character : text) {
    const std::uint16_t* rows = glyph(character);
    for (int y = 0; y < glyph_height; ++y)
      for (int x = 0; x < glyph_width; ++x)
        if (rows[y] >> (glyph_width - 1 - x) & 1) set_pixel(picture, left + x, top + y, color);
    left += glyph_width;
  }
}

void draw_text_on_image(Picture& picture, int left, int top, const std::string& text) {
  for (int y = -1; y <= 1; ++y)
    for (int x = -1; x <= 1; ++x) draw_text(picture, left + x, top + y, text, black);
  draw_text(picture, left, top, text, white);
}

Color viridis(double t) {
  constexpr Color anchors[] = {{68, 1, 84},    {71, 44, 122}, {59, 81, 139},  {44, 113, 142}, {33, 144, 141},
                               {39, 173, 129}, {92, 200, 99}, {170, 220, 50}, {253, 231, 37}};
  constexpr int intervals = int(std::size(anchors)) - 1;
  const double position = std::clamp(t, 0.0, 1.0) * intervals;
  const int low = std::min(int(position), intervals - 1);
  return blend(anchors[low], anchors[low + 1], position - low);
}

Color blend(Color under, Color over, double weight) {
  const auto mix = [weight](unsigned char a, unsigned char b) {
    return static_cast<unsigned char>(std::lround(weight * b + (1 - weight) * a));
  };
  return {mix(under.red, over.red), mix(under.green, over.green), mix(under.blue, over.blue)};
}

}  // namespace mtled
