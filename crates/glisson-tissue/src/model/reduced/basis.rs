//! The reduced basis: lowest free vibrations, responses to given loads, and their static modal derivatives.
//!
//! Vibrations come from subspace iteration with K^-1 M (Bathe, Finite Element Procedures, 2nd edition 2014, s. 11.6) and
//! lumped masses. The derivative of mode i along mode j tells how the linear response changes when the body is already
//! deformed: K psi_ij = -f_2(phi_i, phi_j), with f_2 the symmetric bilinear form of the quadratic part of the forces
//! (Idelsohn and Cardona 1985, Computer Methods in Applied Mechanics and Engineering 49; Barbic and James 2005,
//! doi 10.1145/1073204.1073300, s. 3.2). For the derivatives, vibration i is scaled by lambda_1/lambda_i (as in s. 3.2),
//! and the response to a load to the elastic energy of the first vibration (a choice). The principal directions of the
//! derivatives in the mass metric are kept. All modes are then mass-orthonormal and diagonalize K. Of more than
//! [`Reduced::MAX_DERIVATIVES`] pairs, those whose scaled energies have the largest product are used.

use super::Reduced;
use super::dense::{dot, eigen_symmetric};
use crate::material::LinearElastic;
use crate::solve::{Factorization, FreeSystem, MeshEdges, P1Gradients, StiffnessTensors};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom, outer};
use glisson_mesh::mesh::TetMesh;

/// A held body with its factored stiffness.
pub(super) struct HeldBody<'a> {
    pub(super) mesh: &'a TetMesh,
    pub(super) material: &'a LinearElastic,
    pub(super) edges: MeshEdges,
    pub(super) tensors: StiffnessTensors,
    pub(super) gradients: Vec<P1Gradients>,
    pub(super) system: FreeSystem,
    pub(super) factor: Factorization,
    /// Mass of each node [kg].
    pub(super) mass_kg: Vec<f64>,
}

/// Modes by columns over the free components, and their squared circular frequencies.
pub(super) struct Modes {
    pub(super) vectors: Vec<f64>,
    pub(super) squared_frequency_per_s2: Vec<f64>,
}

/// Extra vectors in the subspace iteration: the wanted ones converge faster.
const N_GUARDS: usize = 8;
const MOST_ITERATIONS: usize = 40;
/// Relative change of the wanted eigenvalues that ends the iteration: accurate enough for a basis.
const ENOUGH: f64 = 1e-6;
/// A vector with less than this share left after projection is a combination of the others.
const LEAST_SHARE: f64 = 1e-8;

impl HeldBody<'_> {
    fn free_masses(&self) -> Vec<f64> {
        let of_node: Vec<DVec3> = self.mass_kg.iter().map(|m| DVec3::splat(*m)).collect();
        let mut free = vec![0.0; self.system.n_free()];
        self.system.gather_into(&of_node, &mut free);
        free
    }

    /// A vector over the free components as displacements of all nodes.
    pub(super) fn of_nodes(&self, free: &[f64]) -> Vec<DVec3> {
        let mut of_node = vec![DVec3::ZERO; self.mesh.positions_m.len()];
        self.system.add_scattered(free, &mut of_node);
        of_node
    }

    fn stiffness_times(&self, free: &[f64]) -> Vec<f64> {
        let mut force = vec![DVec3::ZERO; self.mesh.positions_m.len()];
        self.tensors.force_into(&self.edges, &self.of_nodes(free), &mut force);
        let mut product = vec![0.0; free.len()];
        self.system.gather_into(&force, &mut product);
        product
    }

    /// Multiplies columns over the free components by K^-1, in place.
    pub(super) fn solve(&self, columns: &mut [f64]) {
        let n_columns = columns.len() / self.system.n_free();
        self.factor.solve_in_place(columns, n_columns, &mut self.factor.scratch(n_columns));
    }

    /// K^-1 of a force on each node.
    pub(super) fn answer_to(&self, force: &[DVec3]) -> Vec<f64> {
        let mut free = vec![0.0; self.system.n_free()];
        self.system.gather_into(force, &mut free);
        self.solve(&mut free);
        free
    }

    /// The basis of `n_modes` vibrations, the responses to `loads`, and their derivatives, up to `n_reduced` vectors; fewer
    /// where these are linearly dependent.
    pub(super) fn basis(&self, n_modes: usize, loads: &[Vec<DVec3>], n_reduced: usize) -> Modes {
        let n = self.system.n_free();
        let mass = self.free_masses();
        let vibrations = self.ritz(&mass, &self.vibrations(&mass, n_modes));
        let lowest = vibrations.squared_frequency_per_s2[0];
        let (mut linear, mut generators) = (vibrations.vectors.clone(), vibrations.vectors);
        let mut energies = Vec::new();
        for (column, squared) in generators.chunks_exact_mut(n).zip(&vibrations.squared_frequency_per_s2) {
            column.iter_mut().for_each(|x| *x *= lowest / squared);
            energies.push(lowest * lowest / squared);
        }
        for load in loads {
            let answer = self.answer_to(load);
            let energy = dot(&answer, &self.stiffness_times(&answer));
            if energy > 0.0 && energy.is_finite() {
                linear.extend(&answer);
                let scale = (lowest / energy).sqrt();
                generators.extend(answer.iter().map(|x| scale * x));
                energies.push(lowest);
            }
        }
        let mut all = orthonormal(&linear, n, &mass, 0);
        all.truncate(n * n_reduced);
        let n_linear = all.len() / n;
        let pairs = strongest_pairs(&energies, Reduced::MAX_DERIVATIVES);
        let derivatives = self.derivatives(&generators, &pairs);
        all.extend(principal(&all, derivatives, n, &mass, n_reduced - n_linear));
        self.ritz(&mass, &orthonormal(&all, n, &mass, n_linear))
    }

    /// Lowest vibrations, mass-orthonormal columns.
    fn vibrations(&self, mass: &[f64], n_modes: usize) -> Vec<f64> {
        let n = self.system.n_free();
        let n_carried = (n_modes + N_GUARDS).min(n);
        let mut random = SeededRandom::new(1);
        let mut x: Vec<f64> = (0..n * n_carried).map(|_| random.normal()).collect();
        let mut before = vec![f64::INFINITY; n_modes];
        for _ in 0..MOST_ITERATIONS {
            x.chunks_exact_mut(n).for_each(|c| c.iter_mut().zip(mass).for_each(|(x, m)| *x *= m));
            self.solve(&mut x);
            let modes = self.ritz(mass, &orthonormal(&x, n, mass, 0));
            x = modes.vectors;
            let now = &modes.squared_frequency_per_s2[..n_modes.min(modes.squared_frequency_per_s2.len())];
            let has_settled =
                now.iter().zip(&before).all(|(now, before)| (now - before).abs() <= ENOUGH * now);
            before = now.to_vec();
            if has_settled {
                break;
            }
        }
        x.truncate(n * n_modes);
        x
    }

    /// Rotates mass-orthonormal columns so that they diagonalize K, lowest frequency first.
    fn ritz(&self, mass: &[f64], columns: &[f64]) -> Modes {
        let n = mass.len();
        let r = columns.len() / n;
        let mut projected = vec![0.0; r * r];
        for (j, column) in columns.chunks_exact(n).enumerate() {
            let product = self.stiffness_times(column);
            for (i, other) in columns.chunks_exact(n).enumerate() {
                projected[j * r + i] = dot(other, &product);
            }
        }
        let symmetric = (0..r * r).map(|at| 0.5 * (projected[at] + projected[at % r * r + at / r])).collect();
        let (squared_frequency_per_s2, rotation) = eigen_symmetric(symmetric, r);
        let mut vectors = vec![0.0; n * r];
        for (target, weights) in vectors.chunks_exact_mut(n).zip(rotation.chunks_exact(r)) {
            for (column, w) in columns.chunks_exact(n).zip(weights) {
                target.iter_mut().zip(column).for_each(|(t, c)| *t += w * c);
            }
        }
        Modes { vectors, squared_frequency_per_s2 }
    }

    /// Derivatives psi_ij of pairs of columns that are scaled already.
    fn derivatives(&self, generators: &[f64], pairs: &[[usize; 2]]) -> Vec<f64> {
        let n = self.system.n_free();
        let fields: Vec<Vec<DVec3>> = generators.chunks_exact(n).map(|g| self.of_nodes(g)).collect();
        let mut columns = vec![0.0; n * pairs.len()];
        let mut force = vec![DVec3::ZERO; self.mesh.positions_m.len()];
        for (column, &[i, j]) in columns.chunks_exact_mut(n).zip(pairs) {
            self.quadratic_force_into([&fields[i], &fields[j]], &mut force);
            force.iter_mut().for_each(|f| *f = -*f);
            self.system.gather_into(&force, column);
        }
        self.solve(&mut columns);
        columns
    }

    /// The bilinear form f_2: with H = grad u, the quadratic part of P = F S(E) is S(1/2 H^T H) + H S(sym H).
    fn quadratic_force_into(&self, [u, v]: [&[DVec3]; 2], force: &mut [DVec3]) {
        let (lambda, mu) = (self.material.lambda_pa(), self.material.mu_pa());
        let stress = |m: DMat3| {
            // S of the symmetric part of m.
            let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
            DMat3::from_diagonal(DVec3::splat(lambda * trace)) + (m + m.transpose()) * mu
        };
        force.fill(DVec3::ZERO);
        for (nodes, g) in self.mesh.tetrahedra.iter().zip(&self.gradients) {
            let gradient = |u: &[DVec3]| {
                let parts = nodes.iter().zip(&g.alpha_per_m);
                parts.fold(DMat3::ZERO, |h, (node, alpha)| h + outer(u[node.index()], *alpha))
            };
            let (a, b) = (gradient(u), gradient(v));
            let piola = (stress(a.transpose() * b) + a * stress(b) + b * stress(a)) * (0.5 * g.volume_m3);
            for (node, alpha) in nodes.iter().zip(&g.alpha_per_m) {
                force[node.index()] += piola * *alpha;
            }
        }
    }
}

/// Pairs i <= j, row by row; at most `most`, those with the largest product of energies, earlier ones first.
fn strongest_pairs(energies: &[f64], most: usize) -> Vec<[usize; 2]> {
    let n = energies.len();
    let mut pairs: Vec<[usize; 2]> = (0..n).flat_map(|i| (i..n).map(move |j| [i, j])).collect();
    if pairs.len() > most {
        let strength = |&[i, j]: &[usize; 2]| energies[i] * energies[j];
        // Stable: equal ones stay in order.
        pairs.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
        pairs.truncate(most);
        pairs.sort_unstable();
    }
    pairs
}

/// Mass-orthonormal columns with the same span, by Gram-Schmidt applied twice; the first `n_kept` are so already.
fn orthonormal(columns: &[f64], n: usize, mass: &[f64], n_kept: usize) -> Vec<f64> {
    let mut done = columns[..n * n_kept].to_vec();
    let mut weighted = vec![0.0; n];
    for column in columns[n * n_kept..].chunks_exact(n) {
        let mut x = column.to_vec();
        let mut norm = |x: &[f64]| {
            weighted.iter_mut().zip(x).zip(mass).for_each(|((w, x), m)| *w = x * m);
            dot(&weighted, x).sqrt()
        };
        let before = norm(&x);
        for _ in 0..2 {
            remove(&done, n, mass, &mut x);
        }
        let after = norm(&x);
        if after > LEAST_SHARE * before {
            x.iter_mut().for_each(|x| *x /= after);
            done.extend(x);
        }
    }
    done
}

/// Subtracts the components of `x` along mass-orthonormal columns.
fn remove(columns: &[f64], n: usize, mass: &[f64], x: &mut [f64]) {
    let mut weighted = vec![0.0; n];
    for column in columns.chunks_exact(n) {
        weighted.iter_mut().zip(column).zip(mass).for_each(|((w, c), m)| *w = c * m);
        let part = dot(&weighted, x);
        x.iter_mut().zip(column).for_each(|(x, c)| *x -= part * c);
    }
}

/// Up to `n_wanted` principal directions, in the mass metric, of the parts of `candidates` orthogonal to `done`.
fn principal(done: &[f64], mut candidates: Vec<f64>, n: usize, mass: &[f64], n_wanted: usize) -> Vec<f64> {
    let n_candidates = candidates.len() / n;
    candidates.chunks_exact_mut(n).for_each(|x| remove(done, n, mass, x));
    let mut gram = vec![0.0; n_candidates * n_candidates];
    let mut weighted = vec![0.0; n];
    for (j, a) in candidates.chunks_exact(n).enumerate() {
        weighted.iter_mut().zip(a).zip(mass).for_each(|((w, a), m)| *w = a * m);
        for (i, b) in candidates.chunks_exact(n).enumerate().skip(j) {
            let product = dot(&weighted, b);
            gram[j * n_candidates + i] = product;
            gram[i * n_candidates + j] = product;
        }
    }
    let (values, vectors) = eigen_symmetric(gram, n_candidates);
    let largest = values.last().copied().unwrap_or(0.0);
    let mut kept = Vec::new();
    for k in (0..n_candidates)
        .rev()
        .take(n_wanted)
        .take_while(|&k| values[k] > LEAST_SHARE * LEAST_SHARE * largest)
    {
        let mut direction = vec![0.0; n];
        for (column, w) in candidates.chunks_exact(n).zip(&vectors[k * n_candidates..]) {
            direction.iter_mut().zip(column).for_each(|(d, c)| *d += w / values[k].sqrt() * c);
        }
        kept.extend(direction);
    }
    kept
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::material::StVenantKirchhoff;
    use crate::solve::{BoundaryConditions, ElasticBody};
    use glisson_mesh::mesh::box_mesh::box_of_five;
    use glisson_mesh::mesh::{NodeId, TetId};

    pub(in super::super) fn with_body(check: impl Fn(&HeldBody<'_>)) {
        let mesh = box_of_five([2, 2, 3], DVec3::new(0.05, 0.04, 0.09));
        let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
        let edges = MeshEdges::of_mesh(&mesh).unwrap();
        let tensors = StiffnessTensors::assemble(&mesh, &edges, &material).unwrap();
        let nodes = (0..mesh.positions_m.len()).map(NodeId::from_index);
        let fixed: Vec<NodeId> = nodes.filter(|n| mesh.positions_m[n.index()].z < 1e-9).collect();
        let system = FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(&fixed)).unwrap();
        let tets = (0..mesh.tetrahedra.len()).map(TetId::from_index);
        let gradients = tets.map(|t| P1Gradients::of_tet(&mesh, t).unwrap()).collect();
        let mass_kg = (0..mesh.positions_m.len()).map(|n| 1e-3 + 1e-5 * n as f64).collect();
        let factor = system.factorize().unwrap();
        let (mesh, material) = (&mesh, &material);
        check(&HeldBody { mesh, material, edges, tensors, gradients, system, factor, mass_kg });
    }

    pub(in super::super) fn random_field(body: &HeldBody<'_>, seed: u64) -> Vec<DVec3> {
        let mut random = SeededRandom::new(seed);
        let mut draw = || DVec3::new(random.normal(), random.normal(), random.normal());
        body.mesh.positions_m.iter().map(|_| draw()).collect()
    }

    /// f_2(u, u) is half the second derivative of the forces at rest; the bilinear form follows by polarization.
    #[test]
    fn the_quadratic_force_is_that_of_the_law() {
        with_body(|body| {
            let laws = [StVenantKirchhoff::from(body.material)];
            let elastic = ElasticBody::new(body.mesh, &body.edges, &laws).unwrap();
            let (u, v) = (random_field(body, 1), random_field(body, 2));
            let n = u.len();
            let even = |field: &dyn Fn(usize) -> DVec3| -> Vec<DVec3> {
                let h = 1e-3;
                let at = |sign: f64| {
                    let mut force = vec![DVec3::ZERO; n];
                    let moved: Vec<DVec3> = (0..n).map(|i| field(i) * (sign * h)).collect();
                    elastic.force_into(&moved, &mut force);
                    force
                };
                // Linear and cubic parts are odd.
                at(1.0).iter().zip(at(-1.0)).map(|(a, b)| (*a + b) / (2.0 * h * h)).collect()
            };
            let (sum, difference) = (even(&|i| u[i] + v[i]), even(&|i| u[i] - v[i]));
            let mut found = vec![DVec3::ZERO; n];
            body.quadratic_force_into([&u, &v], &mut found);
            let largest = found.iter().map(|f| f.length()).fold(0.0, f64::max);
            for i in 0..n {
                let expected = (sum[i] - difference[i]) / 4.0;
                assert!((found[i] - expected).length() < 1e-8 * largest, "{} {expected}", found[i]);
            }
        });
    }

    #[test]
    fn the_strongest_pairs_are_kept_in_order() {
        assert_eq!(strongest_pairs(&[3.0, 1.0], 3), [[0, 0], [0, 1], [1, 1]]);
        // Products 9, 3, 6, 1, 2, 4.
        assert_eq!(strongest_pairs(&[3.0, 1.0, 2.0], 4), [[0, 0], [0, 1], [0, 2], [2, 2]]);
        assert_eq!(strongest_pairs(&[1.0; 3], 2), [[0, 0], [0, 1]]);
        let falling: Vec<f64> = (1..=Reduced::MAX_REDUCED).map(|i| 1.0 / (i * i) as f64).collect();
        let pairs = strongest_pairs(&falling, Reduced::MAX_DERIVATIVES);
        assert_eq!(pairs.len(), Reduced::MAX_DERIVATIVES);
        // All 30 default ones pass: the bits of small bases do not depend on the limit.
        assert_eq!(strongest_pairs(&falling[..30], Reduced::MAX_DERIVATIVES).len(), 465);
        assert!(strongest_pairs(&[], 5).is_empty());
    }

    #[test]
    fn the_basis_is_mass_orthonormal_and_diagonalizes_the_stiffness() {
        with_body(|body| {
            let n = body.system.n_free();
            let load = random_field(body, 3);
            let modes = body.basis(4, std::slice::from_ref(&load), 14);
            assert_eq!(modes.squared_frequency_per_s2.len(), 14);
            let mass = body.free_masses();
            for (i, a) in modes.vectors.chunks_exact(n).enumerate() {
                let product = body.stiffness_times(a);
                for (j, b) in modes.vectors.chunks_exact(n).enumerate() {
                    let masses: f64 = a.iter().zip(b).zip(&mass).map(|((a, b), m)| a * b * m).sum();
                    let is_same = f64::from(u8::from(i == j));
                    assert!((masses - is_same).abs() < 1e-11, "{i} {j} {masses}");
                    let expected = is_same * modes.squared_frequency_per_s2[i];
                    let largest = modes.squared_frequency_per_s2[13];
                    assert!((dot(b, &product) - expected).abs() < 1e-10 * largest);
                }
            }
            // The lowest one is a vibration: K v = omega^2 M v.
            let lowest = &modes.vectors[..n];
            let (product, squared) = (body.stiffness_times(lowest), modes.squared_frequency_per_s2[0]);
            for i in 0..n {
                assert!((product[i] - squared * mass[i] * lowest[i]).abs() < 1e-3 * squared * mass[i].sqrt());
            }
            // The answer to the load lies in the span.
            let answer = body.answer_to(&load);
            let mut rest = answer.clone();
            remove(&modes.vectors, n, &mass, &mut rest);
            assert!(dot(&rest, &rest) < 1e-16 * dot(&answer, &answer));
        });
    }
}
