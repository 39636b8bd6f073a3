#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/motion.hpp"
#include "imaging/free_form_deformation.hpp"

namespace mtled {

/// The registrations by intensity alone that mechanics is compared with: Mattes mutual information (see
/// mutual_information.hpp), maximised by L-BFGS-B (vnl) on a pyramid of resolutions. They find where a point of the fixed
/// image was in the moving one, fixed -> moving. The same bits for any number of threads.
struct BaselineOptions {
  int bins = 50;
  std::size_t samples = 100000;      ///< drawn anew for every resolution
  std::uint64_t seed = 1;
  int levels = 3;
  double finest_spacing_mm = 2;      ///< voxels of the last level, doubled for each before it; Gaussian smoothing by half of that, none on the last
  int evaluations = 100;             ///< of the mutual information on one level, at most
};

/// What happened on one resolution.
struct BaselineLevel {
  double spacing_mm = 0;                  ///< wanted; finer than the image's it has no effect
  double overlap = 0;                     ///< fraction of the samples that lie in the moving image at first; these count
  double before = 0, after = 0;           ///< mutual information [nat]
  int evaluations = 0;
  double seconds = 0;
};

/// `best`: the start among the three that leads to the largest mutual information times overlap on the coarsest level.
enum class RigidStart { best, moments, geometry, identity };
const char* name_of(RigidStart start);

struct RigidBaseline {
  RigidMotion fixed_to_moving;            ///< about the middle of the fixed image
  RigidStart start = RigidStart::best;    ///< the one that was taken
  std::vector<BaselineLevel> levels;
};
/// Rigid registration. Starts: the centres of intensity on each other, the middles of the images, or as the headers say.
/// With a mask (on any grid) only its inside is compared. Input errors: a constant image, fewer than 4 voxels along an
/// axis, no overlap.
RigidBaseline register_rigid_baseline(const Image& moving, const Image& fixed, const Mask* fixed_mask, RigidStart start, const BaselineOptions& options);

struct FreeFormBaseline {
  FreeFormDeformation deformation;        ///< y -> y + b(y) in the fixed image, before the rigid motion
  std::vector<BaselineLevel> levels;
};
/// B-spline registration after `start`: y -> start(y + f(y) b(y)) with the coefficients of b unknown. f: `freedom`, on any
/// grid, linearly interpolated, 0 outside; 1 everywhere if it is not given. Nothing keeps it from folding. Input errors as above.
FreeFormBaseline register_free_form_baseline(const Image& moving, const Image& fixed, const Mask* fixed_mask, const RigidMotion& start,
                                             const std::array<int, 3>& mesh, const Image* freedom, const BaselineOptions& options);

/// 0 where `still` is 1, rising smoothly to 1 over `width_mm` around that.
Image freedom_outside(const Mask& still, double width_mm);

/// First y -> y + b(y), then z -> z + v(z), all on one grid: b(y) + v(y + b(y)), linear between voxels; v(y) where b(y) is 0
/// or leads out of the grid.
VectorImage compose(const VectorImage& v, const VectorImage& b);
/// The same after b was reduced so that nothing folds: where b does, or the composition does in the `body` although v does
/// not, b is halved there, less and less up to `width_mm` around, until that is so nowhere. `reductions`: how often. It ends:
/// b only shrinks, and without it there is v alone.
VectorImage compose_without_folds(const VectorImage& v, VectorImage& b, const Mask& body, double width_mm, int& reductions);

}  // namespace mtled
