//! One biquadratic rectangle of an axisymmetric body of any law: forces and tangent.
//!
//! Nine nodes, 3 x 3 Gauss points, weight 2 pi r. With displacements u (radial) and w (axial) the deformation gradient in the
//! axes (r, theta, z) is F = [[1 + u_r, 0, u_z], [0, 1 + u/r, 0], [w_r, 0, 1 + w_z]]; r and z are places at rest.
//! Biquadratic displacements do not lock at a Poisson's ratio of 0.45 (shown by refinement, not assumed).

use glisson::material::Material;
use glisson::math::DMat3;
use std::f64::consts::TAU;

/// Gauss points and weights on [-1, 1].
const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// Unknowns of a rectangle: radial and axial displacement of each of nine nodes, those along the radius first.
pub(super) const N_UNKNOWNS: usize = 18;

/// Entries of F that are not zero: rr, zr, tt, rz, zz, by their numbers in glam's order.
const ENTRIES: [usize; 5] = [0, 2, 4, 6, 8];

/// Which second derivative of the energy is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TangentKind {
    Exact,
    /// Of each Gauss point the nearest positive semi-definite one: always a way down.
    Projected,
}

/// What a rectangle adds to the whole.
pub(super) struct Answer {
    /// Derivative of the energy by each unknown.
    pub(super) forces: [f64; N_UNKNOWNS],
    /// Second derivatives.
    pub(super) tangent: [[f64; N_UNKNOWNS]; N_UNKNOWNS],
}

/// A rectangle at rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rectangle {
    /// Its borders along the radius and along the axis.
    pub(super) r: [f64; 2],
    pub(super) z: [f64; 2],
}

/// Values and derivatives of the three quadratic shape functions.
fn shape(x: f64) -> [(f64, f64); 3] {
    [(0.5 * x * (x - 1.0), x - 0.5), (1.0 - x * x, -2.0 * x), (0.5 * x * (x + 1.0), x + 0.5)]
}

/// Changes of F's five entries by each unknown.
type Gradients = [[f64; 5]; N_UNKNOWNS];

impl Rectangle {
    /// The Gauss points: weight and gradients.
    fn points(self) -> impl Iterator<Item = (f64, Gradients)> {
        let (half_r, half_z) = (0.5 * (self.r[1] - self.r[0]), 0.5 * (self.z[1] - self.z[0]));
        GAUSS.into_iter().flat_map(move |x| GAUSS.map(|y| (x, y))).map(move |((x, wx), (y, wy))| {
            let radius = self.r[0] + half_r * (1.0 + x);
            let weight = wx * wy * half_r * half_z.abs() * TAU * radius;
            let (along, up) = (shape(x), shape(y));
            let mut gradients = [[0.0; 5]; N_UNKNOWNS];
            for k in 0..9 {
                let ((f, df), (g, dg)) = (along[k % 3], up[k / 3]);
                let (dr, dz) = (df * g / half_r, f * dg / half_z);
                gradients[2 * k] = [dr, 0.0, f * g / radius, dz, 0.0];
                gradients[2 * k + 1] = [0.0, dr, 0.0, 0.0, dz];
            }
            (weight, gradients)
        })
    }

    /// Forces and tangent.
    pub(super) fn answer(
        self,
        law: &dyn Material,
        unknowns: &[f64; N_UNKNOWNS],
        kind: TangentKind,
    ) -> Answer {
        let mut answer = Answer { forces: [0.0; N_UNKNOWNS], tangent: [[0.0; N_UNKNOWNS]; N_UNKNOWNS] };
        for (weight, gradients) in self.points() {
            let f = deformation(&gradients, unknowns);
            let stress = law.first_piola_pa(&f).to_cols_array();
            let tangent = match kind {
                TangentKind::Exact => law.tangent_pa(&f),
                TangentKind::Projected => law.projected_tangent_pa(&f),
            };
            for (a, of_a) in gradients.iter().enumerate() {
                let mut stress_change = [0.0; 5];
                for (entry, number) in ENTRIES.into_iter().enumerate() {
                    answer.forces[a] += weight * stress[number] * of_a[entry];
                    for (other, by) in ENTRIES.into_iter().enumerate() {
                        stress_change[other] += weight * of_a[entry] * tangent[number][by];
                    }
                }
                for (b, of_b) in gradients.iter().enumerate() {
                    let pairs = stress_change.iter().zip(of_b);
                    answer.tangent[a][b] += pairs.map(|(s, g)| s * g).sum::<f64>();
                }
            }
        }
        answer
    }
}

fn deformation(gradients: &Gradients, unknowns: &[f64; N_UNKNOWNS]) -> DMat3 {
    let mut f = DMat3::IDENTITY.to_cols_array();
    for (of_unknown, u) in gradients.iter().zip(unknowns) {
        for (entry, number) in ENTRIES.into_iter().enumerate() {
            f[number] += of_unknown[entry] * u;
        }
    }
    DMat3::from_cols_array(&f)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::material::{LinearElastic, StableNeoHooke};

    const RECTANGLE: Rectangle = Rectangle { r: [0.3, 0.7], z: [-0.5, -0.2] };

    /// Displacements without symmetry, strains of about a half.
    fn unknowns() -> [f64; N_UNKNOWNS] {
        std::array::from_fn(|k| 0.06 * (1.7 * k as f64 + 0.3).sin())
    }

    fn energy(law: &dyn Material, unknowns: &[f64; N_UNKNOWNS]) -> f64 {
        let at_point = |(weight, gradients): (f64, Gradients)| {
            weight * law.energy_density_j_per_m3(&deformation(&gradients, unknowns))
        };
        RECTANGLE.points().map(at_point).sum()
    }

    #[test]
    fn forces_and_tangent_are_the_derivatives_of_the_energy() {
        let linear = LinearElastic::from_young_poisson(1.0, 0.45, 1.0).unwrap();
        let stable = StableNeoHooke::from(&linear);
        for law in [&linear as &dyn Material, &stable] {
            let at = unknowns();
            let here = RECTANGLE.answer(law, &at, TangentKind::Exact);
            for k in 0..N_UNKNOWNS {
                let step = 1e-5;
                let moved = |by: f64| {
                    let mut there = at;
                    there[k] += by;
                    (energy(law, &there), RECTANGLE.answer(law, &there, TangentKind::Exact))
                };
                let ((above, up), (below, down)) = (moved(step), moved(-step));
                let slope = (above - below) / (2.0 * step);
                assert!((slope - here.forces[k]).abs() < 1e-8, "{k}: {slope} {}", here.forces[k]);
                for l in 0..N_UNKNOWNS {
                    let slope = (up.forces[l] - down.forces[l]) / (2.0 * step);
                    assert!((slope - here.tangent[k][l]).abs() < 1e-7, "{k} {l}: {slope}");
                }
            }
        }
    }
}
