#pragma once
#include <string>

#include "imaging/figures.hpp"

namespace mtled {

/// Each part in [0, 255].
struct Color {
  unsigned char red = 0, green = 0, blue = 0;
};
constexpr Color black{0, 0, 0}, white{255, 255, 255};

/// Part of a picture, in pixels from its top left corner.
struct Rectangle {
  int left = 0, top = 0, width = 0, height = 0;
};

Picture blank_picture(int width, int height, Color background);
/// Sets one pixel; pixels outside the picture are ignored, here and below.
void set_pixel(Picture& picture, int x, int y, Color color);
void fill(Picture& picture, const Rectangle& area, Color color);
/// A straight line with round ends, `thickness` pixels wide.
void draw_line(Picture& picture, double x0, double y0, double x1, double y1, int thickness, Color color);
/// Copies `tile` to where its top left corner is at (left, top).
void paste(Picture& picture, const Picture& tile, int left, int top);
/// Mean of 2 x 2 pixels: the last step of drawing smooth lines at twice the resolution.
Picture halved(const Picture& picture);

int text_width(const std::string& text);
/// One line of ASCII text whose top left corner is at (left, top).
void draw_text(Picture& picture, int left, int top, const std::string& text, Color color);
/// The same with a black rim, to be read on any image.
void draw_text_on_image(Picture& picture, int left, int top, const std::string& text);

/// A perceptually uniform colour map (viridis of Matplotlib, by S. van der Walt and N. Smith, CC0); `t` in [0, 1].
Color viridis(double t);
/// weight * over + (1 - weight) * under.
Color blend(Color under, Color over, double weight);

}  // namespace mtled
