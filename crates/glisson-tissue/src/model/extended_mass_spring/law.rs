//! Laws as functions of the six squared edge lengths of a tetrahedron.
//!
//! With the shape gradients g_a of the rest shape, C = F^T F is linear in the squared lengths L_e of the edges
//! e = (a, b) (from C = sum x_a.x_b g_a g_b^T and sum g_a = 0):
//!
//! C = sum_e L_e C_e,   C_e = -(g_a g_b^T + g_b g_a^T)/2.
//!
//! This is the C_i = B^T G_i B of the thesis (seed `000` s. 3.3) without a node that is told apart, so that every
//! order of the nodes gives the same numbers up to rounding. A law gives each edge its tension per length
//!
//! s_e = 2 V0 dW/dL_e,   force on a: s_e (x_b - x_a), on b the opposite.

use crate::solve::{LOCAL_EDGES, P1Gradients};
use glisson_mesh::math::tetrahedron_volume_m3;

/// A hyperelastic law for [`super::ExtendedMassSpring`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeLaw {
    /// St Venant-Kirchhoff: W = lambda/2 (tr E)^2 + mu tr(E^2) (seed `000` eq. 3.16, 3.63). Valid for large
    /// rotations and strains up to some 30 %; softens under compression, with a limit point at 42 %.
    StVenantKirchhoff,
    /// Neo-Hooke with logarithms: W = mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2 (Bonet and Wood 2008,
    /// Nonlinear Continuum Mechanics for Finite Element Analysis, eq. 6.28, doi 10.1017/CBO9780511755446).
    /// Squared lengths give J^2 only: a mirrored tetrahedron has the energy of its image.
    NeoHooke,
}

impl EdgeLaw {
    /// All laws.
    pub const ALL: [Self; 2] = [Self::StVenantKirchhoff, Self::NeoHooke];

    /// Name for scenes and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::StVenantKirchhoff => "st_venant_kirchhoff",
            Self::NeoHooke => "neo_hooke",
        }
    }
}

/// Lame's coefficients [Pa].
#[derive(Clone, Copy, Debug)]
pub(super) struct Lame {
    pub(super) lambda_pa: f64,
    pub(super) mu_pa: f64,
}

/// A law's numbers for one tetrahedron.
pub(super) trait EdgeEnergy: Copy {
    /// For a tetrahedron at rest with squared edge lengths `rest_m2`.
    fn new(gradients: &P1Gradients, rest_m2: [f64; 6], lame: Lame) -> Self;

    /// What a removed tetrahedron leaves: no energy, no tension.
    fn nothing() -> Self;

    /// s_e [N/m] for squared lengths that grew by `growth_m2` since rest.
    fn tension_n_per_m(&self, growth_m2: [f64; 6]) -> [f64; 6];

    /// Elastic energy [J].
    fn energy_j(&self, growth_m2: [f64; 6]) -> f64;

    /// Its numbers, for comparison with those of a model built anew.
    fn numbers(&self) -> Vec<f64>;
}

/// g_a.g_b [1/m2] of the shape gradients.
fn gram_per_m2(gradients: &P1Gradients) -> [[f64; 4]; 4] {
    let g = &gradients.alpha_per_m;
    std::array::from_fn(|a| std::array::from_fn(|b| g[a].dot(g[b])))
}

/// With D = L - L_rest, tr E = VTr.D/2 and tr E^2 = D.MTr D/4, where VTr_e = tr C_e = -g_a.g_b and
/// MTr_ef = tr(C_e C_f); so W = D.MW D with MW = lambda/8 VTr VTr^T + mu/4 MTr. (The seed's eq. 3.49 and 3.64 print
/// further linear terms, which vanish, and 3.67 lacks a factor 2 V0 and the sign.) s_e = 4 V0 (MW D)_e.
#[derive(Clone, Copy, Debug)]
pub(super) struct StVenantKirchhoffTet {
    /// 4 V0 MW [N/m3], symmetric.
    stiffness_n_per_m3: [[f64; 6]; 6],
}

impl EdgeEnergy for StVenantKirchhoffTet {
    fn new(gradients: &P1Gradients, _: [f64; 6], lame: Lame) -> Self {
        let h = gram_per_m2(gradients);
        let scale = 4.0 * gradients.volume_m3;
        let stiffness_n_per_m3 = std::array::from_fn(|e| {
            std::array::from_fn(|f| {
                let ([a, b], [c, d]) = (LOCAL_EDGES[e], LOCAL_EDGES[f]);
                let both_traces = h[a][b] * h[c][d];
                let trace_of_product = 0.5 * (h[a][c] * h[b][d] + h[a][d] * h[b][c]);
                scale * (0.125 * lame.lambda_pa * both_traces + 0.25 * lame.mu_pa * trace_of_product)
            })
        });
        Self { stiffness_n_per_m3 }
    }

    fn nothing() -> Self {
        Self { stiffness_n_per_m3: [[0.0; 6]; 6] }
    }

    #[inline]
    fn tension_n_per_m(&self, growth_m2: [f64; 6]) -> [f64; 6] {
        let mut tension = [0.0; 6];
        // Row by row of a symmetric matrix: six lanes at once.
        for (row, growth) in self.stiffness_n_per_m3.iter().zip(growth_m2) {
            for e in 0..6 {
                tension[e] += row[e] * growth;
            }
        }
        tension
    }

    fn energy_j(&self, growth_m2: [f64; 6]) -> f64 {
        let tension = self.tension_n_per_m(growth_m2);
        0.25 * tension.iter().zip(growth_m2).map(|(s, d)| s * d).sum::<f64>()
    }

    fn numbers(&self) -> Vec<f64> {
        self.stiffness_n_per_m3.as_flattened().to_vec()
    }
}

/// J^2 is the squared volume over that of rest, and 288 V^2 is the Cayley-Menger determinant of the squared
/// lengths; here by the Gram matrix G of the three edges at node 0, G_ij = (L_0i + L_0j - L_ij)/2, det G = 36 V^2.
/// s_e = 2 V0 (mu/2 tr C_e + (lambda ln J - mu)/2 d ln det G/dL_e).
#[derive(Clone, Copy, Debug)]
pub(super) struct NeoHookeTet {
    volume_m3: f64,
    rest_m2: [f64; 6],
    rest_determinant_m6: f64,
    /// V0 mu tr C_e [N/m].
    isochoric_n_per_m: [f64; 6],
    lambda_j: f64,
    mu_j: f64,
}

/// J^2 below which the logarithm is taken as of this number: a flat tetrahedron keeps finite forces.
const LEAST_SQUARED_RATIO: f64 = 1e-12;

impl NeoHookeTet {
    /// ln J and d ln det G/dL_e [1/m2].
    fn logarithm(&self, growth_m2: [f64; 6]) -> (f64, [f64; 6]) {
        let l: [f64; 6] = std::array::from_fn(|e| self.rest_m2[e] + growth_m2[e]);
        let (adjugate, determinant) = gram_adjugate(&l);
        let least = LEAST_SQUARED_RATIO * self.rest_determinant_m6;
        let determinant = determinant.max(least);
        let ln_j = 0.5 * libm::log(determinant / self.rest_determinant_m6);
        let [a11, a22, a33, a12, a13, a23] = adjugate;
        let derivative =
            [a11 + a12 + a13, a22 + a12 + a23, a33 + a13 + a23, -a12, -a13, -a23].map(|d| d / determinant);
        (ln_j, derivative)
    }
}

/// Adjugate (11, 22, 33, 12, 13, 23) and determinant of the Gram matrix of the edges 01, 02, 03.
fn gram_adjugate(l: &[f64; 6]) -> ([f64; 6], f64) {
    let [g11, g22, g33] = [l[0], l[1], l[2]];
    let g12 = 0.5 * (l[0] + l[1] - l[3]);
    let g13 = 0.5 * (l[0] + l[2] - l[4]);
    let g23 = 0.5 * (l[1] + l[2] - l[5]);
    let adjugate = [
        g22 * g33 - g23 * g23,
        g11 * g33 - g13 * g13,
        g11 * g22 - g12 * g12,
        g13 * g23 - g12 * g33,
        g12 * g23 - g13 * g22,
        g12 * g13 - g11 * g23,
    ];
    (adjugate, g11 * adjugate[0] + g12 * adjugate[3] + g13 * adjugate[4])
}

impl EdgeEnergy for NeoHookeTet {
    fn new(gradients: &P1Gradients, rest_m2: [f64; 6], lame: Lame) -> Self {
        let h = gram_per_m2(gradients);
        let volume_m3 = gradients.volume_m3;
        Self {
            volume_m3,
            rest_m2,
            rest_determinant_m6: gram_adjugate(&rest_m2).1,
            isochoric_n_per_m: LOCAL_EDGES.map(|[a, b]| -volume_m3 * lame.mu_pa * h[a][b]),
            lambda_j: volume_m3 * lame.lambda_pa,
            mu_j: volume_m3 * lame.mu_pa,
        }
    }

    fn nothing() -> Self {
        Self {
            volume_m3: 0.0,
            // A right-angled corner, so that the logarithm is that of a proper tetrahedron.
            rest_m2: [1.0, 1.0, 1.0, 2.0, 2.0, 2.0],
            rest_determinant_m6: 1.0,
            isochoric_n_per_m: [0.0; 6],
            lambda_j: 0.0,
            mu_j: 0.0,
        }
    }

    #[inline]
    fn tension_n_per_m(&self, growth_m2: [f64; 6]) -> [f64; 6] {
        let (ln_j, derivative) = self.logarithm(growth_m2);
        let factor = self.lambda_j * ln_j - self.mu_j;
        std::array::from_fn(|e| self.isochoric_n_per_m[e] + factor * derivative[e])
    }

    fn energy_j(&self, growth_m2: [f64; 6]) -> f64 {
        let (ln_j, _) = self.logarithm(growth_m2);
        // tr C - 3 = sum tr C_e (L_e - L_rest).
        let isochoric: f64 = self.isochoric_n_per_m.iter().zip(growth_m2).map(|(s, d)| 0.5 * s * d).sum();
        isochoric - self.mu_j * ln_j + 0.5 * self.lambda_j * ln_j * ln_j
    }

    fn numbers(&self) -> Vec<f64> {
        let mut numbers = vec![self.volume_m3, self.lambda_j, self.mu_j];
        numbers.extend(self.isochoric_n_per_m);
        numbers
    }
}

/// Whether four corners stand mirrored or flat.
pub(super) fn is_inverted(corners_m: [glisson_mesh::math::DVec3; 4]) -> bool {
    glisson_mesh::math::is_inverted(tetrahedron_volume_m3(corners_m))
}
