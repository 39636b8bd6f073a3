#include "report/encode.hpp"

#include <png.h>

#include <cstdio>  // before jpeglib.h, which needs FILE
#include <jpeglib.h>

#include <algorithm>
#include <cstdlib>
#include <memory>

#include "core/error.hpp"

namespace mtled {
namespace {

std::string address(const char* type, std::span<const std::uint8_t> bytes) { return std::string("data:image/") + type + ";base64," + base64(bytes); }

std::string png_of(int width, int height, png_uint_32 format, const std::uint8_t* pixels) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = png_uint_32(width);
  image.height = png_uint_32(height);
  image.format = format;
  std::vector<std::uint8_t> bytes(PNG_IMAGE_PNG_SIZE_MAX(image));
  png_alloc_size_t size = bytes.size();
  if (!png_image_write_to_memory(&image, bytes.data(), &size, 0, pixels, 0, nullptr)) fail(Failure::output, "a picture of the report cannot be packed as PNG: ", image.message);
  return address("png", {bytes.data(), size});
}

[[noreturn]] void fail_with_message(j_common_ptr compressor) {
  char text[JMSG_LENGTH_MAX];
  compressor->err->format_message(compressor, text);
  fail(Failure::output, "a picture of the report cannot be packed as JPEG: ", text);
}

}  // namespace

std::string base64(std::span<const std::uint8_t> bytes) {
  constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t b = 0; b < bytes.size(); b += 3) {
    const std::size_t there = std::min<std::size_t>(3, bytes.size() - b);
    unsigned group = 0;
    for (std::size_t n = 0; n < 3; ++n) group = group << 8 | (n < there ? bytes[b + n] : 0u);
    for (std::size_t n = 0; n < 4; ++n) text += n <= there ? digits[group >> (18 - 6 * n) & 63] : '=';
  }
  return text;
}

std::string png_address(const GreyPicture& picture) { return png_of(picture.width, picture.height, PNG_FORMAT_GRAY, picture.grey.data()); }
std::string png_address(const Picture& picture) { return png_of(picture.width, picture.height, PNG_FORMAT_RGB, picture.rgb.data()); }

std::string jpeg_address(const GreyPicture& picture, int quality) {
  jpeg_compress_struct compressor;
  jpeg_error_mgr errors;
  compressor.err = jpeg_std_error(&errors);
  errors.error_exit = fail_with_message;
  jpeg_create_compress(&compressor);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  const auto release = [&](jpeg_compress_struct* c) { jpeg_destroy_compress(c), std::free(bytes); };
  const std::unique_ptr<jpeg_compress_struct, decltype(release)> guard(&compressor, release);
  jpeg_mem_dest(&compressor, &bytes, &size);
  compressor.image_width = JDIMENSION(picture.width);
  compressor.image_height = JDIMENSION(picture.height);
  compressor.input_components = 1;
  compressor.in_color_space = JCS_GRAYSCALE;
  jpeg_set_defaults(&compressor);
  jpeg_set_quality(&compressor, quality, TRUE);
  jpeg_start_compress(&compressor, TRUE);
  while (compressor.next_scanline < compressor.image_height) {
    JSAMPROW row = const_cast<JSAMPROW>(picture.grey.data() + std::size_t(compressor.next_scanline) * std::size_t(picture.width));
    jpeg_write_scanlines(&compressor, &row, 1);
  }
  jpeg_finish_compress(&compressor);
  return address("jpeg", {bytes, size});
}

}  // namespace mtled
