#pragma once

namespace mtled {

/// Material law of a body: the structs of these names in core/material.hpp.
enum class MaterialModel { neo_hookean, mooney_rivlin, yeoh, ogden, transversely_isotropic };
inline constexpr int number_of_material_models = 5;

/// Parameters of a model beyond the shear and the bulk modulus.
constexpr int further_parameters(MaterialModel model) {
  constexpr int count[number_of_material_models] = {0, 1, 2, 1, 4};
  return count[int(model)];
}

/// How many of these, the first ones, are moduli [kPa].
constexpr int further_moduli(MaterialModel model) {
  constexpr int count[number_of_material_models] = {0, 1, 2, 0, 1};
  return count[int(model)];
}

/// One term of a Prony series: after a step of strain the share alpha of the instantaneous stress decays as exp(-t / tau).
struct PronyTerm {
  double alpha = 0;             ///< of the isochoric stress, in [0, 1)
  double alpha_volumetric = 0;  ///< of the volumetric stress, in [0, 1)
  double tau = 1;               ///< relaxation time > 0 [s]
};

}  // namespace mtled
