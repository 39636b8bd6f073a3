#pragma once
#include "core/cloud.hpp"
#include "core/error.hpp"
#include "core/material.hpp"

namespace mtled {

/// Shear modulus, bulk modulus, and the further parameters of point p.
inline double material_parameter(const IntegrationPoints& points, std::size_t p, int i) {
  if (i == 0) return points.shear_modulus[p];
  if (i == 1) return points.bulk_modulus[p];
  return points.further[p * std::size_t(further_parameters(points.model)) + std::size_t(i - 2)];
}

/// Material of one kind at point p.
template <template <class> class Material, class T>
Material<T> material_at(const IntegrationPoints& points, std::size_t p) {
  T parameters[parameter_count<Material>];
  for (int i = 0; i < parameter_count<Material>; ++i) parameters[i] = T(material_parameter(points, p, i));
  return material_of<Material>(parameters);
}

/// Calls use(material) with the material of point p in T, whatever the model of the body.
template <class T, class Use>
auto with_material(const IntegrationPoints& points, std::size_t p, Use&& use) {
  switch (points.model) {
    case MaterialModel::neo_hookean: return use(material_at<NeoHookean, T>(points, p));
    case MaterialModel::mooney_rivlin: return use(material_at<MooneyRivlin, T>(points, p));
    case MaterialModel::yeoh: return use(material_at<Yeoh, T>(points, p));
    case MaterialModel::ogden: return use(material_at<Ogden, T>(points, p));
    case MaterialModel::transversely_isotropic: return use(material_at<TransverselyIsotropic, T>(points, p));
  }
  fail(Failure::internal, "unknown material model");
}

}  // namespace mtled
