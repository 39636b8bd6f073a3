#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "core/dynamics.hpp"
#include "io/json.hpp"

namespace mtled {

/// Writes the outputs of a dynamic run as they come, so that a run that fails later leaves what it has reached:
/// motion_NNNNNN.vtu per output (numbered from 0: displacement and velocity of the field at the nodes, prescribed),
/// motion.pvd (their times), history.csv (energies, reactions) and probe_history.csv (only with probes).
class DynamicsWriter {
 public:
  /// Keeps references to all but the directory.
  DynamicsWriter(std::filesystem::path directory, const Approximation& field, const Constraints& constraints, const std::vector<Vec3d>& probes)
      : directory_(std::move(directory)), field_(&field), constraints_(&constraints), probes_(&probes) {}
  void write(const DynamicsFrame& frame);

 private:
  std::filesystem::path directory_;
  const Approximation* field_;
  const Constraints* constraints_;
  const std::vector<Vec3d>* probes_;
  std::string collection_, history_, probe_rows_;
  int count_ = 0;
};

/// The solver's part of summary.json for a dynamic run.
Json summary_of(const DynamicsResult& result);

}  // namespace mtled
