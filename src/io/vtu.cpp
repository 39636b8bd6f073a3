#include <bit>
#include <cstdint>
#include <ostream>
#include <span>

#include "core/error.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr unsigned char vtk_vertex = 1;  // VTK's number of the cell that is one point

std::string escaped(const std::string& text) {
  std::string xml;
  for (const char c : text) switch (c) {
      case '&':
        xml += "&amp;";
        break;
      case '<':
        xml += "&lt;";
        break;
      case '"':
        xml += "&quot;";
        break;
      default:
        xml += c;
    }
  return xml;
}

/// Writes the XML declarations of arrays first, remembering the arrays, and then their bytes: each with its count of
/// bytes (uint64) in front, at the offset that its declaration gives.
class AppendedArrays {
 public:
  explicit AppendedArrays(std::ostream& stream) : stream_(stream) {}
  template <class T>
  void declare(const char* type, const std::string& name, int components, std::span<const T> values) {
    stream_ << "        <DataArray type=\"" << type << "\" Name=\"" << escaped(name) << "\" NumberOfComponents=\""
            << components << "\" format=\"appended\" offset=\"" << offset_ << "\"/>\n";
    arrays_.push_back(std::as_bytes(values));
    offset_ += sizeof(std::uint64_t) + values.size_bytes();
  }
  void write() const {
    stream_ << "  <AppendedData encoding=\"raw\">\n_";
    for (const auto& bytes : arrays_) {
      const std::uint64_t count = bytes.size();
      stream_.write(reinterpret_cast<const char*>(&count), sizeof count);
      stream_.write(reinterpret_cast<const char*>(bytes.data()), std::streamsize(count));
    }
    stream_ << "\n  </AppendedData>\n";
  }

 private:
  std::ostream& stream_;
  std::uint64_t offset_ = 0;
  std::vector<std::span<const std::byte>> arrays_;
};

}  // namespace

void write_vtu(const std::filesystem::path& path, const std::vector<Vec3d>& points,
               const std::vector<PointData>& data) {
  const std::size_t count = points.size();
  for (const PointData& array : data)
    if (array.components < 1 || array.values.size() != count * std::size_t(array.components))
      fail(Failure::internal, "the array '", array.name, "' does not fit ", count, " points");
  std::vector<float> positions;
  positions.reserve(3 * count);
  for (const Vec3d& p : points) positions.insert(positions.end(), {float(p.x), float(p.y), float(p.z)});
  std::vector<std::int64_t> indices(count), ends(count);
  for (std::size_t i = 0; i < count; ++i) indices[i] = std::int64_t(i), ends[i] = std::int64_t(i + 1);
  const std::vector<unsigned char> types(count, vtk_vertex);

  write_stream(path, [&](std::ostream& stream) {
    AppendedArrays arrays(stream);
    stream << "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\""
           << (std::endian::native == std::endian::little ? "LittleEndian" : "BigEndian")
           << "\" header_type=\"UInt64\">\n  <UnstructuredGrid>\n    <Piece NumberOfPoints=\"" << count
           << "\" NumberOfCells=\"" << count << "\">\n      <Points>\n";
    arrays.declare<float>("Float32", "Points", 3, positions);
    stream << "      </Points>\n      <Cells>\n";
    arrays.declare<std::int64_t>("Int64", "connectivity", 1, indices);
    arrays.declare<std::int64_t>("Int64", "offsets", 1, ends);
    arrays.declare<unsigned char>("UInt8", "types", 1, types);
    stream << "      </Cells>\n      <PointData>\n";
    for (const PointData& array : data) arrays.declare<float>("Float32", array.name, array.components, array.values);
    stream << "      </PointData>\n    </Piece>\n  </UnstructuredGrid>\n";
    arrays.write();
    stream << "</VTKFile>\n";
  });
}

}  // namespace mtled
