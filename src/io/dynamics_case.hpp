#pragma once
#include <filesystem>

#include "core/dynamics.hpp"

namespace mtled {

class TomlSection;

/// [loads]: gravity_mm_s2, forces (x,y,z,fx,fy,fz and optional set), pressure (x,y,z,ax,ay,az,pressure_kpa and optional
/// set). Files are relative to `folder`.
Loads read_loads(TomlSection& section, const std::filesystem::path& folder);
/// [dynamics]: duration_s, time_step_s or safety, damping_per_s, output_every_s, histories (set,time_s,factor),
/// interpolation.
DynamicsOptions read_dynamics(TomlSection& section, const std::filesystem::path& folder);

}  // namespace mtled
