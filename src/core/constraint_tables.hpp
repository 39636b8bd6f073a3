#pragma once
#include <vector>

namespace mtled {

/// The constraints of one displacement component as plain data, for backends that impose them themselves:
///   u_B = inverse (load value - Phi_BF u_F),  f_F -= Phi_BF^T inverse^T f_B.
struct ConstraintTable {
  std::vector<int> slot;             ///< [n] of u_B
  std::vector<double> value;         ///< [n] [mm]
  std::vector<int> begin{0}, free_slot;  ///< Phi_BF by rows: [n + 1], [entries]
  std::vector<double> free_value;
  std::vector<double> inverse;       ///< [n * n] of Phi_BB, row-major; empty where it is the identity and Phi_BF zero
};

}  // namespace mtled
