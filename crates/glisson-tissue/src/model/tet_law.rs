//! The law of a tetrahedron, and its stiffness numbers B, C and D.
//!
//! With the shape gradients alpha_j, u(x) = sum_j u_j L_j(x) and E = e + n, where
//! e = 1/2 sum_j (u_j alpha_j^T + alpha_j u_j^T) and n = 1/2 sum_jk (u_j . u_k) alpha_j alpha_k^T, the energy
//! V [ lambda/2 (tr E)^2 + mu tr E^2 + kappa (a . E a)^2 ] is a polynomial of the nodes' displacements
//! (seed `002`, eq. 8):
//!
//! W = 1/2 sum u_j . B_jk u_k + sum (u_j . C_jkl)(u_k . u_l) + sum D_jklm (u_j . u_k)(u_l . u_m), with
//!
//! B_jk = V [ lambda alpha_j (x) alpha_k + mu (alpha_k (x) alpha_j + (alpha_j . alpha_k) Id) + 2 kappa s_j s_k a (x) a ]
//! C_jkl = V [ lambda/2 alpha_j (alpha_k . alpha_l) + mu/2 (alpha_l (alpha_j . alpha_k) + alpha_k (alpha_j . alpha_l))
//!             + kappa s_j s_k s_l a ]
//! D_jklm = V [ lambda/8 (alpha_j . alpha_k)(alpha_l . alpha_m) + mu/4 (alpha_j . alpha_m)(alpha_k . alpha_l)
//!              + kappa/4 s_j s_k s_l s_m ]
//!
//! s_j = a . alpha_j; kappa = (lambda_L - lambda)/2 + mu_L - mu stiffens along the fibre direction a.
//! Differences from the report: it leaves the volume V out; its B is half of ours, which is the one of
//! [`crate::solve::P1Gradients::stiffness`], so that the linear force is B u and not 2 B u.

use crate::material::LinearElastic;
use crate::solve::{LOCAL_EDGES, P1Gradients, RestStress, TetStiffness};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::TetId;

/// How far the length of a fibre's direction may be from 1.
const UNIT_LENGTH_TOLERANCE: f64 = 1e-6;

/// Why fibres cannot be followed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FibreError {
    /// A fibre's direction or moduli.
    #[error("the fibre of tetrahedron {tet}: {what} is {found}; allowed: {allowed}")]
    Impossible {
        /// Which tetrahedron.
        tet: TetId,
        /// Which quantity, with its unit.
        what: &'static str,
        /// What was given.
        found: f64,
        /// What may be given.
        allowed: &'static str,
    },
    /// Fibres are given for another number of tetrahedra.
    #[error("there are {n_fibres} fibres for {n_tets} tetrahedra; allowed: none, or one for each")]
    Count {
        /// How many were given.
        n_fibres: usize,
        /// How many tetrahedra there are.
        n_tets: usize,
    },
}

/// What makes a tetrahedron stiffer (or softer) along one direction: transverse isotropy (seed `002`, eq. 7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fibre {
    /// Lame's lambda along the fibre [Pa].
    pub lambda_along_pa: f64,
    /// Lame's mu along the fibre [Pa].
    pub mu_along_pa: f64,
    /// Direction of the fibre in the rest shape, of length 1.
    pub direction: DVec3,
}

/// The moduli of one tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TetLaw {
    /// lambda [Pa].
    pub lambda_pa: f64,
    /// mu [Pa].
    pub mu_pa: f64,
    /// kappa = (lambda_L - lambda)/2 + mu_L - mu [Pa]; zero where there is no fibre.
    pub kappa_pa: f64,
    /// Fibre direction a, of length 1.
    pub direction: DVec3,
}

impl TetLaw {
    /// An isotropic tetrahedron.
    pub fn isotropic(material: &LinearElastic) -> Self {
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        Self { lambda_pa, mu_pa, kappa_pa: 0.0, direction: DVec3::X }
    }

    /// A tetrahedron with a fibre.
    ///
    /// # Errors
    /// [`FibreError::Impossible`] unless the direction has length 1 and the moduli make the energy of
    /// every small strain positive: kappa > -E/2.
    pub fn with_fibre(material: &LinearElastic, fibre: &Fibre, tet: TetId) -> Result<Self, FibreError> {
        let refuse = |what, found, allowed| Err(FibreError::Impossible { tet, what, found, allowed });
        let length = fibre.direction.length();
        if !(length.is_finite() && (length - 1.0).abs() <= UNIT_LENGTH_TOLERANCE) {
            return refuse("length of the direction", length, "1");
        }
        let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
        let kappa_pa = 0.5 * (fibre.lambda_along_pa - lambda_pa) + fibre.mu_along_pa - mu_pa;
        if !(kappa_pa.is_finite() && kappa_pa > -0.5 * material.young_modulus_pa()) {
            let allowed = "a finite number above -E/2, half of Young's modulus";
            return refuse("(lambda_L - lambda)/2 + mu_L - mu [Pa]", kappa_pa, allowed);
        }
        Ok(Self { lambda_pa, mu_pa, kappa_pa, direction: fibre.direction / length })
    }

    /// Second Piola-Kirchhoff stress S = lambda tr(E) Id + 2 mu E + 2 kappa (a . E a) a a^T [Pa].
    pub fn stress_pa(&self, strain: DMat3) -> DMat3 {
        let a = self.direction;
        let trace = strain.col(0).x + strain.col(1).y + strain.col(2).z;
        DMat3::from_diagonal(DVec3::splat(self.lambda_pa * trace))
            + strain * (2.0 * self.mu_pa)
            + outer(a, a) * (2.0 * self.kappa_pa * a.dot(strain * a))
    }

    /// Energy density lambda/2 (tr E)^2 + mu tr(E^2) + kappa (a . E a)^2 [J/m3].
    pub fn energy_density_j_per_m3(&self, strain: DMat3) -> f64 {
        let trace = strain.col(0).x + strain.col(1).y + strain.col(2).z;
        let square: f64 = (0..3).map(|c| strain.col(c).length_squared()).sum();
        let along = self.direction.dot(strain * self.direction);
        0.5 * self.lambda_pa * trace * trace + self.mu_pa * square + self.kappa_pa * along * along
    }

    /// Bound of a tetrahedron's highest squared frequency over the one at rest, while all principal stretches
    /// stay within `[1/s, s]`, with the incompressibility penalty gamma.
    ///
    /// The tangent of the stress part is (Id (x) F) K (Id (x) F^T) for the K at rest, so at most s^2 times it. The
    /// stress stiffens by at most the largest eigenvalue of S, (s^2 - 1)/2 (3 |lambda| + 2 mu + 2 max(kappa, 0))
    /// (or -kappa from compressed soft fibres), times the scalar Laplacian L, whose largest eigenvalue is at most
    /// that of K over min(lambda + 2 mu, its like along the fibre). The penalty gamma V |theta|^3 with
    /// |theta| <= t = s^3 - 1 adds 18 gamma t s^4 + 6 gamma t^2 s of L.
    pub(in crate::model) fn stiffening(&self, largest_stretch: f64, gamma_pa: f64) -> f64 {
        let s = largest_stretch;
        let square = s * s;
        let theta = square * s - 1.0;
        let stress_pa = 0.5
            * (square - 1.0)
            * (3.0 * self.lambda_pa.abs() + 2.0 * self.mu_pa + 2.0 * self.kappa_pa.max(0.0));
        let soft_fibre_pa = (-self.kappa_pa).max(0.0) * (1.0 - 1.0 / square);
        let penalty_pa = gamma_pa * (18.0 * theta * square * square + 6.0 * theta * theta * s);
        let wave_pa = (self.lambda_pa + 2.0 * self.mu_pa + 2.0 * self.kappa_pa.min(0.0)).max(self.mu_pa);
        square + (stress_pa + soft_fibre_pa + penalty_pa) / wave_pa
    }
}

/// A tetrahedron at rest with its law: the source of all its stiffness numbers. Indices are local nodes.
pub(in crate::model) struct TetShape {
    law: TetLaw,
    volume_m3: f64,
    alpha_per_m: [DVec3; 4],
    /// alpha_j . alpha_k [1/m2].
    dot: [[f64; 4]; 4],
    /// a . alpha_j [1/m].
    along: [f64; 4],
}

impl TetShape {
    pub(in crate::model) fn new(law: TetLaw, gradients: &P1Gradients) -> Self {
        let alpha = gradients.alpha_per_m;
        Self {
            law,
            volume_m3: gradients.volume_m3,
            alpha_per_m: alpha,
            dot: std::array::from_fn(|j| std::array::from_fn(|k| alpha[j].dot(alpha[k]))),
            along: std::array::from_fn(|j| law.direction.dot(alpha[j])),
        }
    }

    /// C_jkl [N/m2].
    pub(in crate::model) fn c(&self, j: usize, k: usize, l: usize) -> DVec3 {
        let (alpha, g, s) = (&self.alpha_per_m, &self.dot, &self.along);
        let volumetric = alpha[j] * (0.5 * self.law.lambda_pa * g[k][l]);
        let shear = (alpha[l] * g[j][k] + alpha[k] * g[j][l]) * (0.5 * self.law.mu_pa);
        let fibre = self.law.direction * (self.law.kappa_pa * s[j] * (s[k] * s[l]));
        (volumetric + shear + fibre) * self.volume_m3
    }

    /// D_jklm [N/m3].
    pub(in crate::model) fn d(&self, j: usize, k: usize, l: usize, m: usize) -> f64 {
        let (g, s) = (&self.dot, &self.along);
        let volumetric = 0.125 * self.law.lambda_pa * (g[j][k] * g[l][m]);
        let shear = 0.25 * self.law.mu_pa * (g[j][m] * g[k][l]);
        let fibre = 0.25 * self.law.kappa_pa * ((s[j] * s[k]) * (s[l] * s[m]));
        (volumetric + shear + fibre) * self.volume_m3
    }
}

/// The tensors B of a tetrahedron [N/m] with a stress at rest S0: S = S_elastic + S0 adds (alpha_j . S0 alpha_k) V Id
/// (and constant forces, which are kept elsewhere).
pub(in crate::model) fn stressed_stiffness(
    law: &TetLaw,
    gradients: &P1Gradients,
    rest_stress_pa: Option<&RestStress>,
) -> TetStiffness {
    let mut stiffness = linear_stiffness(law, gradients);
    if let Some(&stress_pa) = rest_stress_pa {
        stiffness.add_multiples(gradients.stress_stiffness_n_per_m(stress_pa));
    }
    stiffness
}

/// The tensors B of a tetrahedron [N/m].
pub(in crate::model) fn linear_stiffness(law: &TetLaw, gradients: &P1Gradients) -> TetStiffness {
    let mut stiffness = gradients.stiffness(law.lambda_pa, law.mu_pa);
    if law.kappa_pa != 0.0 {
        let a = law.direction;
        let along = gradients.alpha_per_m.map(|alpha| a.dot(alpha));
        let fibre = |j: usize, k: usize| {
            outer(a, a) * (2.0 * law.kappa_pa * gradients.volume_m3 * along[j] * along[k])
        };
        for j in 0..4 {
            stiffness.vertex[j] += fibre(j, j);
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            stiffness.edge[e] += fibre(j, k);
        }
    }
    stiffness
}
