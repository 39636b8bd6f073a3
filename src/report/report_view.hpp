#pragma once
#include <map>
#include <utility>
#include <vector>

#include "report/view.hpp"

namespace mtled {

/// How grey values are stored and shown.
struct GreyScale {
  ByteRange range;
  std::string unit;  ///< empty where it is unknown
  struct NamedWindow {
    std::string name;
    double low, high;
  };
  std::vector<NamedWindow> windows;  ///< the first is shown at first
};
/// CT (see display_window()): HU, windows for soft tissue, lung and bone; otherwise all but the darkest and brightest 0.2 %.
GreyScale grey_scale_of(const Image& image);

/// Numbers in colour.
struct ColorScale {
  std::string id, name, unit;
  ByteRange range;
  bool diverging = false;  ///< around `middle`
  double middle = 0;
  bool open_end = false;    ///< larger values share the last colour
  bool open_start = false;  ///< smaller values share the first colour
};

/// Collects what the viewer of a report shows: volumes on grids of the space of the fixed and of the moving image. The
/// description of its JSON is in docs/report.md.
class ReportView {
 public:
  /// `scale`: of all grey images.
  explicit ReportView(GreyScale scale = {}) : scale_(std::move(scale)) {}
  void add_space(const std::string& space, const Grid& view) { views_[space] = view; }
  const Grid& view(const std::string& space) const { return views_.at(space); }
  void add_image(const std::string& id, const std::string& name, const std::string& space, const Image& image);
  /// `lowest`: voxels that get the lowest value, whatever is beside them; may be null.
  void add_numbers(const ColorScale& scale, const std::string& space, const Image& values, const Mask* lowest = nullptr);
  /// Edge voxels of up to eight images in the space of the fixed one.
  void add_edges(const std::string& id, const Mask& edges);
  /// v(y) in the space of the fixed image [mm].
  void set_arrows(const VectorImage& displacement, const Mask& known);
  /// Packs all pictures, several at a time.
  Json json() const;

 private:
  struct Volume {
    Json description;
    ByteVolume bytes;
    bool exact;  ///< without loss
  };
  GreyScale scale_;
  std::map<std::string, Grid> views_;
  std::vector<Volume> volumes_;
  Json arrows_, edge_bits_ = Json::object();
  ByteVolume edges_;
};

/// |v| [mm] where it is known, NaN elsewhere.
Image magnitude(const VectorImage& field, const Mask& known);
/// Adds |v|, arrows, and det J (volume in the moving over volume in the fixed image) of the map fixed -> moving; `ratio`:
/// its volume_ratio().
void add_field(ReportView& view, const VectorImage& displacement, const Mask& known, const Image& ratio);

}  // namespace mtled
