#pragma once
#include <numbers>
#include <ostream>

#include "core/motion.hpp"
#include "scenes.hpp"

/// Problems whose slowest mode is hard to see: small increments while much is missing.
namespace mtled::scenes {

using KeptCells = std::function<bool(const std::array<int, 3>&)>;

/// Where everything follows a turn of one end, equilibrium is a rigid motion of the whole body, known exactly.
struct SlowScene : Scene {
  std::optional<RigidMotion> rigid;
};

/// Body of the kept cells of `box` whose lower end is turned by `degrees` about its middle; the other end is held or free.
struct SlowBody {
  Box box;
  KeptCells kept = every_cell;
  ModulusField modulus = uniform(1);
  double degrees = 10;
  bool upper_end_held = false;
  bool jittered = false;

  RigidMotion motion() const {
    Vec3d turn{}, middle{box.length(0) / 2, box.length(1) / 2, box.length(2) / 2};
    turn.x = degrees * std::numbers::pi / 180;
    middle.z = 0;
    return {middle, rotation_matrix(turn), {}};
  }
  SlowScene scene() const {
    SlowScene scene;
    scene.cloud = jittered ? jittered_box(box) : on_lattice(cell_corners(box, kept), box.spacing);
    const RigidMotion turn = motion();
    prescribe(scene.cloud, scene.constraints, "lower", below(2, 0), [=](const Vec3d& x) { return turn.displacement(x); });
    if (upper_end_held) prescribe(scene.cloud, scene.constraints, "upper", above(2, box.length(2)), nowhere);
    const ShapeEvaluator evaluator = scene.evaluator();
    scene.points = box_points(box, modulus, 0.49, usual_ratio, [&](const std::array<int, 3>& cell) {
      return !kept(cell) ? CellKind::absent : !jittered && evaluator.coupled(cell) ? CellKind::coupled : CellKind::free;
    });
    if (!upper_end_held) scene.rigid = turn;
    return scene;
  }
};

/// A wide body on a thin column of prescribed nodes near one side, whose upper half bends: the body swings after it.
inline SlowScene body_on_a_spine() {
  constexpr double degree = std::numbers::pi / 180;
  const Box box{{16, 12, 12}, 10};
  SlowScene scene;
  scene.cloud = lattice_box(box);
  const auto spine = [](const Vec3d& x) { return std::abs(x.x - 25) < 6 && std::abs(x.y - 65) < 6; };
  const RigidMotion upper{{25, 65, 60}, rotation_matrix({8 * degree, 10 * degree, 0}), {0, 0, 0}};
  prescribe(scene.cloud, scene.constraints, "lower", [=](const Vec3d& x) { return spine(x) && x.z < 51; }, nowhere);
  prescribe(scene.cloud, scene.constraints, "upper", [=](const Vec3d& x) { return spine(x) && x.z > 69; }, [=](const Vec3d& x) { return upper.displacement(x); });
  scene.points = coupled_box_points(box, scene.cloud, scene.constraints, uniform(1));
  return scene;
}
inline SlowScene soft_pocket() {
  SlowBody body{{{8, 8, 16}, 10}};
  body.modulus = [](const Vec3d& x) { return norm(x - Vec3d{45, 40, 80}) < 28 ? 0.02 : 2.0; };
  body.upper_end_held = true;
  return body.scene();
}
inline SlowScene stiff_inclusion() {
  SlowBody body{{{8, 8, 16}, 10}};
  body.modulus = [](const Vec3d& x) { return norm(x - Vec3d{45, 40, 90}) < 28 ? 100.0 : 1.0; };
  return body.scene();
}
inline SlowScene long_beam() {
  SlowBody body{{{4, 4, 40}, 10}};
  body.degrees = 20;
  return body.scene();
}
inline SlowScene long_jittered_beam() {
  SlowBody body{{{4, 4, 30}, 10}};
  body.degrees = 15;
  body.jittered = true;
  return body.scene();
}
inline SlowScene two_bodies_and_a_bridge() {
  SlowBody body{{{8, 8, 20}, 10}};
  body.kept = [](const std::array<int, 3>& c) { return c[2] < 8 || c[2] >= 12 || (c[0] >= 5 && c[0] < 7 && c[1] >= 3 && c[1] < 5); };
  return body.scene();
}
inline SlowScene layers() {
  SlowBody body{{{6, 6, 24}, 10}};
  body.modulus = [](const Vec3d& x) { return int(x.z / 40) % 2 ? 0.1 : 10.0; };
  return body.scene();
}

struct SlowProblem {
  const char* name;
  SlowScene (*make)();
};
inline std::ostream& operator<<(std::ostream& out, const SlowProblem& p) { return out << p.name; }
inline const SlowProblem slow_problems[] = {{"BodyOnASpine", body_on_a_spine}, {"SoftPocket", soft_pocket}, {"StiffInclusion", stiff_inclusion},
                                            {"LongBeam", long_beam}, {"LongJitteredBeam", long_jittered_beam},
                                            {"TwoBodiesAndABridge", two_bodies_and_a_bridge}, {"Layers", layers}};

}  // namespace mtled::scenes
