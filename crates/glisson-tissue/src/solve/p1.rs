//! The linear (P1) tetrahedron: shape gradients and stiffness tensors.
//!
//! Displacement u(x) = sum_j L_j(x) u_j with L_j(x) = alpha_j . x + beta_j, so grad u = sum_j u_j (x) alpha_j
//! is constant. Hooke's energy of a tetrahedron is W = 1/2 sum_jk u_j^T B^jk u_k with (seed `003`, eq. 1.9)
//!
//! B^jk = V [ lambda alpha_j (x) alpha_k + mu (alpha_k (x) alpha_j + (alpha_j . alpha_k) Id) ].
//!
//! Erratum: the report prints B without the volume V; its eq. 1.10 (a force) needs it. The force that
//! balances the deformation is f_j = sum_k B^jk u_k; the tissue pulls on its node with the opposite.

use super::SolveError;
use glisson_mesh::math::{DMat3, DVec3, outer, tetrahedron_volume_m3};
use glisson_mesh::mesh::{TetId, TetMesh};

/// Local node pairs of a tetrahedron's six edges, in the order of [`TetStiffness::edge`].
pub const LOCAL_EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// A tetrahedron is flat below this share of its longest edge cubed (a regular one has 0.118): its gradients
/// would carry fewer than four digits.
const LEAST_VOLUME_SHARE: f64 = 1e-12;

/// Gradients of the four shape functions of a tetrahedron, and its volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct P1Gradients {
    /// alpha_j [1/m], j = 0..4.
    pub alpha_per_m: [DVec3; 4],
    /// Volume [m3], positive.
    pub volume_m3: f64,
}

impl P1Gradients {
    /// Gradients at the corners `p_m`, in either orientation.
    ///
    /// alpha_j is the normal of the opposite face over six times the signed volume, each from its own face, so
    /// that a permutation of the corners permutes the gradients.
    pub fn new(p_m: [DVec3; 4]) -> Self {
        let six_v = 6.0 * tetrahedron_volume_m3(p_m);
        let [a, b, c, d] = p_m;
        let alpha_per_m = [
            (c - b).cross(d - b) / -six_v,
            (c - a).cross(d - a) / six_v,
            (b - a).cross(d - a) / -six_v,
            (b - a).cross(c - a) / six_v,
        ];
        Self { alpha_per_m, volume_m3: six_v.abs() / 6.0 }
    }

    /// Gradients of a tetrahedron of a mesh that is known to be sound, with the volume of its material.
    pub fn in_mesh(mesh: &TetMesh, tet: TetId) -> Self {
        let whole = Self::new(mesh.corners_m(tet));
        Self { volume_m3: whole.volume_m3 * mesh.share(tet), ..whole }
    }

    /// Gradients of a tetrahedron of a mesh, with the volume of its material.
    ///
    /// # Errors
    /// [`SolveError::Volume`] when it is flat or inverted.
    pub fn of_tet(mesh: &TetMesh, tet: TetId) -> Result<Self, SolveError> {
        let p_m = mesh.corners_m(tet);
        let volume_m3 = tetrahedron_volume_m3(p_m);
        let longest_m =
            LOCAL_EDGES.iter().map(|&[a, b]| p_m[a].distance(p_m[b])).fold(0.0, |m: f64, l| m.max(l));
        let least_m3 = LEAST_VOLUME_SHARE * longest_m * longest_m * longest_m;
        if volume_m3 > least_m3 {
            Ok(Self::in_mesh(mesh, tet))
        } else {
            Err(SolveError::Volume { tet, volume_m3, least_m3 })
        }
    }

    /// The ten stiffness tensors for lambda and mu [Pa].
    pub fn stiffness(&self, lambda_pa: f64, mu_pa: f64) -> TetStiffness {
        let tensor = |j: usize, k: usize| {
            let (a, b) = (self.alpha_per_m[j], self.alpha_per_m[k]);
            let shear = outer(b, a) + DMat3::from_diagonal(DVec3::splat(a.dot(b)));
            (outer(a, b) * lambda_pa + shear * mu_pa) * self.volume_m3
        };
        TetStiffness {
            vertex: [tensor(0, 0), tensor(1, 1), tensor(2, 2), tensor(3, 3)],
            edge: LOCAL_EDGES.map(|[j, k]| tensor(j, k)),
        }
    }
}

/// The ten stiffness tensors [N/m] of a tetrahedron; B^kj is the transpose of B^jk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TetStiffness {
    /// B^jj of each corner.
    pub vertex: [DMat3; 4],
    /// B^jk of each of [`LOCAL_EDGES`].
    pub edge: [DMat3; 6],
}

impl TetStiffness {
    /// Adds multiples of the identity [N/m] to the tensors of the corners and edges.
    pub fn add_multiples(&mut self, (vertex, edge): ([f64; 4], [f64; 6])) {
        let scaled = |s: f64| DMat3::from_diagonal(DVec3::splat(s));
        self.vertex.iter_mut().zip(vertex).for_each(|(b, s)| *b += scaled(s));
        self.edge.iter_mut().zip(edge).for_each(|(b, s)| *b += scaled(s));
    }

    /// Upper bound of the highest squared circular frequency [1/s2] of the tetrahedron with a mass at each
    /// corner: of the largest eigenvalue of M^-1 K, at most 2.8 % above it.
    ///
    /// With A = M^-1/2 K M^-1/2, the trace of A^64 is the sum of the eigenvalues' 64th powers, so its 64th root
    /// lies between the largest and 6^(1/64) = 1.028 times the largest (six of the twelve are zero: rigid
    /// motions). A is squared five times, scaled by its trace each time so that nothing overflows.
    pub fn squared_frequency_bound_per_s2(&self, corner_mass_kg: [f64; 4]) -> f64 {
        let scale = corner_mass_kg.map(|m| 1.0 / m.sqrt());
        let mut a = [[0.0; 12]; 12];
        for j in 0..4 {
            put(&mut a, j, j, self.vertex[j] * (scale[j] * scale[j]));
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            let scaled = self.edge[e] * (scale[j] * scale[k]);
            put(&mut a, j, k, scaled);
            put(&mut a, k, j, scaled.transpose());
        }
        // largest = product of the scales, each to the power 1/2^(squarings before it).
        let mut log_bound = 0.0;
        let mut root = 1.0;
        for _ in 0..SQUARINGS {
            let trace: f64 = (0..12).map(|i| a[i][i]).sum();
            if trace <= 0.0 {
                return 0.0;
            }
            log_bound += root * libm::log(trace);
            root *= 0.5;
            let per_square = 1.0 / (trace * trace);
            let mut squared = [[0.0; 12]; 12];
            for i in 0..12 {
                for k in 0..12 {
                    let factor = a[i][k] * per_square;
                    for j in 0..12 {
                        squared[i][j] += factor * a[k][j];
                    }
                }
            }
            a = squared;
        }
        // trace(A^(2^(n+1))) is the squared Frobenius norm of the last square: one power of two for free.
        let frobenius: f64 = a.iter().flatten().map(|x| x * x).sum();
        libm::exp(log_bound + 0.5 * root * libm::log(frobenius))
    }
}

const SQUARINGS: usize = 5;

fn put(a: &mut [[f64; 12]; 12], j: usize, k: usize, block: DMat3) {
    for r in 0..3 {
        for c in 0..3 {
            a[3 * j + r][3 * k + c] = block.col(c)[r];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    fn random_tet(random: &mut SeededRandom) -> [DVec3; 4] {
        loop {
            let p = std::array::from_fn(|_| {
                DVec3::new(random.uniform(), random.uniform(), random.uniform()) * 0.02 + 0.1
            });
            if tetrahedron_volume_m3(p).abs() > 1e-8 {
                return p;
            }
        }
    }

    fn check_gradients(p: [DVec3; 4]) {
        let g = P1Gradients::new(p);
        let size = g.alpha_per_m.iter().map(|a| a.length()).fold(0.0, f64::max);
        assert!(g.alpha_per_m.iter().sum::<DVec3>().length() <= 1e-12 * size);
        for j in 0..4 {
            for k in 1..4 {
                let delta = f64::from(u8::from(j == k)) - f64::from(u8::from(j == 0));
                assert!((g.alpha_per_m[j].dot(p[k] - p[0]) - delta).abs() < 1e-12, "j {j} k {k}");
            }
        }
    }

    #[test]
    fn gradients_are_dual_to_the_edges_in_all_24_orders() {
        let mut random = SeededRandom::new(1);
        for _ in 0..20 {
            let p = random_tet(&mut random);
            let reference = P1Gradients::new(p);
            for order in permutations() {
                let q = order.map(|i| p[i]);
                check_gradients(q);
                let g = P1Gradients::new(q);
                assert!((g.volume_m3 - reference.volume_m3).abs() <= 1e-13 * reference.volume_m3);
                for (j, &i) in order.iter().enumerate() {
                    let difference = (g.alpha_per_m[j] - reference.alpha_per_m[i]).length();
                    assert!(difference <= 1e-11 * reference.alpha_per_m[i].length());
                }
            }
        }
    }

    fn permutations() -> Vec<[usize; 4]> {
        let mut all = Vec::new();
        for a in 0..4 {
            for b in 0..4 {
                for c in 0..4 {
                    for d in 0..4 {
                        let mut sorted = [a, b, c, d];
                        sorted.sort_unstable();
                        if sorted == [0, 1, 2, 3] {
                            all.push([a, b, c, d]);
                        }
                    }
                }
            }
        }
        assert_eq!(all.len(), 24);
        all
    }

    /// Energy from the strain itself: the tensors must give the same.
    #[test]
    fn tensors_give_the_energy_of_the_strain() {
        let mut random = SeededRandom::new(2);
        let (lambda, mu) = (31034.0, 3448.0);
        for _ in 0..20 {
            let p = random_tet(&mut random);
            let g = P1Gradients::new(p);
            let k = g.stiffness(lambda, mu);
            let u: [DVec3; 4] =
                std::array::from_fn(|_| DVec3::new(random.normal(), random.normal(), random.normal()) * 1e-3);
            let grad: DMat3 = (0..4).map(|j| outer(u[j], g.alpha_per_m[j])).fold(DMat3::ZERO, |s, m| s + m);
            let strain = (grad + grad.transpose()) * 0.5;
            let trace = strain.col(0).x + strain.col(1).y + strain.col(2).z;
            let square: f64 = (0..3).map(|c| strain.col(c).length_squared()).sum();
            let expected = g.volume_m3 * (0.5 * lambda * trace * trace + mu * square);
            let mut energy: f64 = (0..4).map(|j| 0.5 * u[j].dot(k.vertex[j] * u[j])).sum();
            for (e, [a, b]) in LOCAL_EDGES.into_iter().enumerate() {
                energy += u[a].dot(k.edge[e] * u[b]);
            }
            assert!((energy - expected).abs() <= 1e-12 * expected, "{energy} {expected}");
        }
    }

    #[test]
    fn a_translation_costs_nothing() {
        let mut random = SeededRandom::new(3);
        let k = P1Gradients::new(random_tet(&mut random)).stiffness(1000.0, 700.0);
        let row0 = k.vertex[0] + k.edge[0] + k.edge[1] + k.edge[2];
        assert!(row0.abs_diff_eq(DMat3::ZERO, 1e-10 * k.vertex[0].col(0).length()));
    }

    #[test]
    fn the_eigenvalue_bound_is_above_and_near() {
        let mut random = SeededRandom::new(4);
        for _ in 0..20 {
            let k = P1Gradients::new(random_tet(&mut random)).stiffness(31034.0, 3448.0);
            let bound = k.squared_frequency_bound_per_s2([1.0; 4]);
            // Power iteration: a lower bound that converges to the largest eigenvalue.
            let mut x: [DVec3; 4] =
                std::array::from_fn(|_| DVec3::new(random.normal(), random.normal(), random.normal()));
            let mut largest = 0.0;
            for _ in 0..400 {
                let norm = x.iter().map(|v| v.length_squared()).sum::<f64>().sqrt();
                let unit = x.map(|v| v / norm);
                let mut y: [DVec3; 4] = std::array::from_fn(|j| k.vertex[j] * unit[j]);
                for (e, [a, b]) in LOCAL_EDGES.into_iter().enumerate() {
                    y[a] += k.edge[e] * unit[b];
                    y[b] += k.edge[e].transpose() * unit[a];
                }
                largest = (0..4).map(|j| unit[j].dot(y[j])).sum();
                x = y;
            }
            assert!(bound >= largest * (1.0 - 1e-12), "{bound} {largest}");
            assert!(bound <= largest * 1.03, "{bound} {largest}");
        }
    }
}
