#pragma once
#include <memory>
#include <vector>

#include "core/approximation.hpp"
#include "core/springs.hpp"

namespace mtled {

/// Elements between the nodes of a cloud; an element's number is its row, from 0.
struct Elements {
  int corners = 8;        ///< 8: hexahedra, numbered around one face and then around the opposite one, as in VTK; 4: tetrahedra
  std::vector<int> node;  ///< [size() * corners] node numbers
  std::size_t size() const { return node.size() / std::size_t(corners); }
};

/// Finite elements with one integration point each, at the centre: what meshless solutions are compared with (Miller,
/// Joldes, Lance, Wittek 2007).
///  - Hexahedra: trilinear values. Gradients are the means over the element (Flanagan & Belytschko 1981), with which linear
///    fields are in equilibrium on distorted meshes too; they do not see the hourglass modes, which need springs.
///  - Tetrahedra: linear. They lock where the material is nearly incompressible, unless pressure is averaged at the nodes
///    (core/nodal_pressure.hpp).
/// On a lattice every element must be a cell of it, so that elements share stencils.
class FiniteElements : public Approximation {
 public:
  /// Keeps a reference to `cloud`. Input errors, with the number of the element: a node that does not exist, an element
  /// that is flat or inside out, elements that overlap, an element that is no cell of the lattice, a node without element.
  FiniteElements(const Cloud& cloud, Elements elements, bool average_pressure = false);
  ~FiniteElements() override;

  /// Values at x, and the gradients of the element that holds x. False outside the elements.
  bool at(const Vec3d& x, ShapeFunctions& shapes, int* enlargements = nullptr) const override;
  bool touches(const Vec3d& x) const override;
  int reach() const override { return 1; }
  bool averages_pressure() const override { return average_pressure_; }

  std::size_t size() const { return centre_.size(); }
  const std::vector<Vec3d>& centres() const { return centre_; }   ///< [size()] integration points [mm]
  const std::vector<double>& volumes() const { return volume_; }  ///< [size()] [mm^3]

  /// Stabilisation of hexahedra: for the four hourglass patterns h_a (Flanagan & Belytschko 1981),
  ///   gamma_Ia = h_Ia - grad N_I . sum_J x_J h_Ja,  stiffness kappa volume (k + 4/3 mu) sum_I |grad N_I|^2 / 8.
  /// gamma_a . u is zero for every linear field. `points`: the material, one point per element; `kappa`: 0.02 is usual
  /// where nu = 0.49.
  Springs hourglass_springs(double kappa, const IntegrationPoints& points) const;

 private:
  struct Search;
  void measure(std::size_t e);
  void require_lattice_cell(std::size_t e) const;
  /// How far x is outside element e, in its natural coordinates (0: inside), and the corners' values there.
  double outside(std::size_t e, const Vec3d& x, double* value) const;
  /// Element that holds x, or -1, and its corners' values at x.
  int element_at(const Vec3d& x, double* value) const;
  const Vec3d& corner(std::size_t e, int c) const { return cloud().nodes[std::size_t(elements_.node[e * std::size_t(elements_.corners) + std::size_t(c)])]; }

  Elements elements_;
  bool average_pressure_;
  std::vector<Vec3d> centre_;
  std::vector<double> volume_, radius_;  ///< radius of the ball about the centre that holds the element [mm]
  std::vector<Vec3d> gradient_;          ///< [size() * corners] [1/mm]
  std::unique_ptr<Search> search_;
};

}  // namespace mtled
