//! St Venant-Kirchhoff forces in reduced coordinates: a cubic polynomial with pre-computed coefficients.
//!
//! With u = sum_i q_i phi_i the strain is E = sum_i q_i e_i + 1/2 sum_ij q_i q_j g_ij, where H_i = grad phi_i,
//! e_i = sym H_i and g_ij = sym(H_i^T H_j), all constant in a tetrahedron. The energy 1/2 c(E, E) is a polynomial of
//! degree four (c: the material's bilinear form times the volume, summed), so with symmetric coefficients
//!
//! f_i = omega_i^2 q_i + S_ijk q_j q_k + T_ijkl q_j q_k q_l,   df_i/dq_j = omega_i^2 d_ij + 2 S_ijk q_k + 3 T_ijkl q_k q_l,
//! S_ijk = 1/2 (c(e_i, g_jk) + c(e_j, g_ik) + c(e_k, g_ij)),   T_ijkl = 1/6 (c(g_ij, g_kl) + c(g_ik, g_jl) + c(g_il, g_jk))
//!
//! (Barbic and James 2005, doi 10.1145/1073204.1073300, s. 4, there by the coefficients of each force; here S q and
//! T q q are kept as one symmetric matrix, which gives forces and stiffness at once).

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::basis::HeldBody;
use super::dense::dot;
use glisson_mesh::math::{DMat3, DVec3, outer};

/// The coefficients.
#[derive(Clone, Debug)]
pub(super) struct ReducedForces {
    r: usize,
    pub(super) squared_frequency_per_s2: Vec<f64>,
    /// S_ijk: pairs i <= j, then k.
    quadratic: Vec<f64>,
    /// T_ijkl: upper triangle over pairs i <= j and k <= l, row by row; the columns' factor 2 for k < l is in the products.
    cubic: Vec<f64>,
}

/// Energy, forces and stiffness at one point, and intermediate results.
#[derive(Clone, Debug)]
pub(super) struct ReducedState {
    /// Elastic energy [J].
    pub(super) energy_j: f64,
    /// f.
    pub(super) force: Vec<f64>,
    /// df/dq by columns, symmetric.
    pub(super) stiffness: Vec<f64>,
    products: Vec<f64>,
    of_cubic: Vec<f64>,
}

/// Tetrahedra in one block of the products of strains.
const TETS_IN_BLOCK: usize = 128;
/// Components of a symmetric tensor: xx, yy, zz, xy, xz, yz.
const N_COMPONENTS: usize = 6;

fn n_pairs(r: usize) -> usize {
    r * (r + 1) / 2
}

/// Place of a pair among those with i <= j.
fn pair(r: usize, i: usize, j: usize) -> usize {
    let (i, j) = (i.min(j), i.max(j));
    i * r - i * (i + 1) / 2 + j
}

impl ReducedForces {
    /// The coefficients of modes given as displacements of the nodes.
    pub(super) fn project(
        body: &HeldBody<'_>,
        modes: &[Vec<DVec3>],
        squared_frequency_per_s2: Vec<f64>,
    ) -> Self {
        let r = modes.len();
        let n_rows = r + n_pairs(r);
        let gram = strain_products(body, modes);
        let linear_with = |i: usize, j: usize, k: usize| gram[(r + pair(r, j, k)) * n_rows + i];
        let with = |a: usize, b: usize| gram[(r + a) * n_rows + r + b];
        let mut quadratic = Vec::with_capacity(n_pairs(r) * r);
        let mut cubic = Vec::with_capacity(n_pairs(n_pairs(r)));
        for i in 0..r {
            for j in i..r {
                for k in 0..r {
                    quadratic
                        .push(0.5 * (linear_with(i, j, k) + linear_with(j, i, k) + linear_with(k, i, j)));
                }
                for k in i..r {
                    for l in k..r {
                        if pair(r, k, l) >= pair(r, i, j) {
                            let sum = with(pair(r, i, j), pair(r, k, l))
                                + with(pair(r, i, k), pair(r, j, l))
                                + with(pair(r, i, l), pair(r, j, k));
                            cubic.push(sum / 6.0);
                        }
                    }
                }
            }
        }
        Self { r, squared_frequency_per_s2, quadratic, cubic }
    }

    /// Memory for [`ReducedForces::evaluate`].
    pub(super) fn state(&self) -> ReducedState {
        let n = n_pairs(self.r);
        ReducedState {
            energy_j: 0.0,
            force: vec![0.0; self.r],
            stiffness: vec![0.0; self.r * self.r],
            products: vec![0.0; n],
            of_cubic: vec![0.0; n],
        }
    }

    /// Energy, forces and stiffness at `q`.
    pub(super) fn evaluate(&self, q: &[f64], state: &mut ReducedState) {
        let (r, n) = (self.r, n_pairs(self.r));
        let ReducedState { energy_j, force, stiffness, products, of_cubic } = state;
        let mut at = 0;
        for k in 0..r {
            for l in k..r {
                products[at] = if k == l { 1.0 } else { 2.0 } * q[k] * q[l];
                at += 1;
            }
        }
        of_cubic.fill(0.0);
        let mut rows = &self.cubic[..];
        for a in 0..n {
            let (row, rest) = rows.split_at(n - a);
            rows = rest;
            let of_row = products[a];
            of_cubic[a] += row[0] * of_row + dot(&row[1..], &products[a + 1..]);
            of_cubic[a + 1..].iter_mut().zip(&row[1..]).for_each(|(y, t)| *y += t * of_row);
        }
        force.iter_mut().zip(&self.squared_frequency_per_s2).zip(q).for_each(|((f, w), q)| *f = w * q);
        *energy_j = 0.5 * dot(force, q);
        let mut at = 0;
        for i in 0..r {
            for j in i..r {
                let (square, cube) = (dot(&self.quadratic[at * r..(at + 1) * r], q), of_cubic[at]);
                *energy_j += products[at] * (square / 3.0 + cube / 4.0);
                at += 1;
                let entry = 2.0 * square + 3.0 * cube;
                stiffness[i * r + j] = entry;
                stiffness[j * r + i] = entry;
                force[i] += (square + cube) * q[j];
                if i != j {
                    force[j] += (square + cube) * q[i];
                }
            }
            stiffness[i * r + i] += self.squared_frequency_per_s2[i];
        }
    }
}

/// c of every two of the e_i and g_jk, as one matrix by columns.
fn strain_products(body: &HeldBody<'_>, modes: &[Vec<DVec3>]) -> Vec<f64> {
    let r = modes.len();
    let n_rows = r + n_pairs(r);
    let (lambda, mu) = (body.material.lambda_pa(), body.material.mu_pa());
    let mut gram = vec![0.0; n_rows * n_rows];
    let mut strains = vec![0.0; n_rows * N_COMPONENTS * TETS_IN_BLOCK];
    let mut stresses = strains.clone();
    let tets: Vec<usize> = (0..body.mesh.tetrahedra.len()).collect();
    for block in tets.chunks(TETS_IN_BLOCK) {
        let n_columns = N_COMPONENTS * block.len();
        for (place, &t) in block.iter().enumerate() {
            let (nodes, g) = (&body.mesh.tetrahedra[t], &body.gradients[t]);
            let gradients: Vec<DMat3> = modes
                .iter()
                .map(|mode| {
                    let parts = nodes.iter().zip(&g.alpha_per_m);
                    parts.fold(DMat3::ZERO, |h, (node, alpha)| h + outer(mode[node.index()], *alpha))
                })
                .collect();
            let mut put = |row: usize, m: DMat3| {
                let e = [
                    m.x_axis.x,
                    m.y_axis.y,
                    m.z_axis.z,
                    0.5 * (m.x_axis.y + m.y_axis.x),
                    0.5 * (m.x_axis.z + m.z_axis.x),
                    0.5 * (m.y_axis.z + m.z_axis.y),
                ];
                let pressure = lambda * (e[0] + e[1] + e[2]);
                for (c, e) in e.into_iter().enumerate() {
                    // Entries off the diagonal count twice in a product of tensors.
                    let stress = if c < 3 { pressure + 2.0 * mu * e } else { 4.0 * mu * e };
                    let at = (N_COMPONENTS * place + c) * n_rows + row;
                    strains[at] = e;
                    stresses[at] = stress * g.volume_m3;
                }
            };
            let mut row = r;
            for i in 0..r {
                put(i, gradients[i]);
                let transposed = gradients[i].transpose();
                for j in i..r {
                    put(row, transposed * gradients[j]);
                    row += 1;
                }
            }
        }
        let used = n_rows * n_columns;
        let (left, right) = (&strains[..used], &stresses[..used]);
        matmul(
            MatMut::from_column_major_slice_mut(&mut gram, n_rows, n_rows),
            Accum::Add,
            MatRef::from_column_major_slice(left, n_rows, n_columns),
            MatRef::from_column_major_slice(right, n_rows, n_columns).transpose(),
            1.0,
            Par::Seq,
        );
    }
    gram
}

#[cfg(test)]
mod tests {
    use super::super::basis::tests::{random_field, with_body};
    use super::*;
    use crate::material::StVenantKirchhoff;
    use crate::solve::ElasticBody;
    use glisson_mesh::math::SeededRandom;

    /// Checks against the forces of the law itself, projected on the modes, and the stiffness by differences.
    #[test]
    fn the_polynomial_is_the_law_in_reduced_coordinates() {
        with_body(|body| {
            let laws = [StVenantKirchhoff::from(body.material)];
            let elastic = ElasticBody::new(body.mesh, &body.edges, &laws).unwrap();
            let r = 6;
            // Any fields serve: nothing here needs them to be modes, but the linear part is diagonal for modes only.
            let basis = body.basis(3, &[], r);
            let n = body.system.n_free();
            let modes: Vec<Vec<DVec3>> = basis.vectors.chunks_exact(n).map(|v| body.of_nodes(v)).collect();
            let forces = ReducedForces::project(body, &modes, basis.squared_frequency_per_s2.clone());
            let mut random = SeededRandom::new(9);
            let noise = random_field(body, 4);
            let mut full = noise.clone();
            let energy_j = std::cell::Cell::new(0.0);
            let projected = |q: &[f64], full: &mut Vec<DVec3>| -> Vec<f64> {
                let moved: Vec<DVec3> = (0..full.len())
                    .map(|n| modes.iter().zip(q).fold(DVec3::ZERO, |u, (mode, q)| u + mode[n] * *q))
                    .collect();
                elastic.force_into(&moved, full);
                energy_j.set(elastic.energy_j(&moved));
                modes.iter().map(|mode| mode.iter().zip(&*full).map(|(u, f)| u.dot(*f)).sum()).collect()
            };
            for size in [1e-6, 3e-3, 2e-2] {
                let q: Vec<f64> = (0..r).map(|_| size * random.normal()).collect();
                let mut state = forces.state();
                forces.evaluate(&q, &mut state);
                let expected = projected(&q, &mut full);
                let largest = expected.iter().fold(0.0, |m: f64, f| m.max(f.abs()));
                for (found, expected) in state.force.iter().zip(&expected) {
                    assert!((found - expected).abs() < 1e-10 * largest, "{found} {expected}");
                }
                assert!((state.energy_j - energy_j.get()).abs() < 1e-10 * energy_j.get());
                let stiffness = state.stiffness.clone();
                let stiffest = stiffness.iter().fold(0.0, |m: f64, k| m.max(k.abs()));
                for j in 0..r {
                    let h = 1e-6 * size;
                    let at = |sign: f64, state: &mut ReducedState| {
                        let mut moved = q.clone();
                        moved[j] += sign * h;
                        forces.evaluate(&moved, state);
                        state.force.clone()
                    };
                    let (above, below) = (at(1.0, &mut state), at(-1.0, &mut state));
                    for i in 0..r {
                        let slope = (above[i] - below[i]) / (2.0 * h);
                        let found = stiffness[j * r + i];
                        assert!((found - slope).abs() < 1e-7 * stiffest, "{i} {j}: {found} {slope}");
                    }
                }
            }
        });
    }
}
