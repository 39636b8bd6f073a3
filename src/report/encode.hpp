#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "imaging/figures.hpp"

namespace mtled {

/// A grey picture, row-major, one byte a pixel.
struct GreyPicture {
  int width = 0, height = 0;
  std::vector<std::uint8_t> grey;
};

/// Text of bytes (RFC 4648).
std::string base64(std::span<const std::uint8_t> bytes);
/// Pictures as `data:` addresses for a page (RFC 2397), PNG without loss or JPEG with `quality` from 1 to 100. Errors of
/// the libraries (no memory) are thrown.
std::string png_address(const GreyPicture& picture);
std::string png_address(const Picture& picture);
std::string jpeg_address(const GreyPicture& picture, int quality);

}  // namespace mtled
