#pragma once
#include <string>

#include "imaging/drawing.hpp"
#include "imaging/font.hpp"
#include "imaging/slices.hpp"

namespace mtled {

constexpr int picture_width = 1500;  ///< [pixels] text is then about 6.5 pt high on a page 180 mm wide
constexpr int margin = 12, gap = 8;  ///< [pixels] around the picture, between panels
constexpr int line_height = glyph_height + 9;

/// Axial, coronal and sagittal slice through the middle of an image, side by side at one scale.
struct Layout {
  Grid slices[3];
  int left[3]{};       ///< [pixels] of every panel
  int row_height = 0;  ///< [pixels]
  double pixel_mm = 1;
};
Layout arrange(const Grid& image, int width);

/// The image on a slice (linear); NaN where it does not reach.
Image on_slice(const Image& image, const Grid& slice);
/// The slice in grey; black where it is NaN.
Picture grey_picture(const Image& slice, const Window& window);
/// Names of the planes above the panels.
void draw_column_names(Picture& picture, const Layout& layout, int top);
/// Puts the slice of a plane (0, 1, 2) in its place, with the letters of the patient's sides and, on the first, a
/// scale.
void paste_panel(Picture& picture, const Layout& layout, int plane, int top, Picture panel);

/// The largest of 1, 2 and 5 times a power of ten that is at most `value`.
double round_number_below(double value);
/// Shortest decimal text of a round number.
std::string number(double value);

}  // namespace mtled
