#pragma once
#include <cstdint>

namespace mtled {

constexpr int glyph_width = 10, glyph_height = 17;  ///< [pixels] of one character cell

/// Rows of a printable ASCII character from the top, the leftmost pixel in bit 9; a question mark for any other character.
const std::uint16_t* glyph(char character);

}  // namespace mtled
