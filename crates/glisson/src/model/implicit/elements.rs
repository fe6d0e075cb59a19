//! Forces and tangent products of the ln J neo-Hooke tetrahedra, eight at a time.
//!
//! With F = I + sum_k (u_k - u_0) (x) alpha_k (k = 1, 2, 3), Q = F^-T and J = det F, the energy density is
//!
//! W = mu/2 (|F|^2 - 3) - mu ln J + U(J),   U(J) = lambda/2 (ln J)^2,   p = U'(J) = lambda ln J / J,
//!
//! the first Piola-Kirchhoff stress P = mu (F - Q) + p J Q, and its differential
//!
//! dP = mu dF + (mu - p J) Q dF^T Q + p J (Q : dF) Q + dp J Q.
//!
//! Each tetrahedron by itself has dp = U''(J) J (Q : dF), so that the two last terms add up to
//! lambda (Q : dF) Q. With node-averaged pressure (Bonet and Burton 1998, doi
//! 10.1002/(SICI)1099-0887(199805)14:5<437::AID-CNM162>3.0.CO;2-W) U acts on the volume ratio of each node,
//! J_a = sum over its tetrahedra of J V/4 over the sum of V/4, and p is the mean over the four nodes.
//!
//! Displacements enter, not positions: at rest F = I, J = 1 and all forces are zero to the bit. Lanes only add
//! and multiply, without fused operations, so that every instruction set gives the same bits.

use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};

use crate::math::DVec3;
use crate::mesh::{NodeId, TetMesh};
use crate::solve::{P1Gradients, SolveError};

const LANES: usize = 8;
type Lanes = [f64; LANES];
type Matrix<S> = [[f64x8<S>; 3]; 3];

/// Where the volume change is resisted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VolumeResistance {
    /// In each tetrahedron: stiff, locks when nearly incompressible.
    #[default]
    Element,
    /// In the volume of all tetrahedra around each node: does not lock.
    NodeAveraged,
}

/// Eight tetrahedra: nodes, gradients alpha_1..alpha_3 (component i of alpha_k in row 3 (k-1) + i), volumes.
#[derive(Clone, Debug)]
struct Group {
    nodes: [[u32; LANES]; 4],
    gradient_per_m: [Lanes; 9],
    volume_m3: Lanes,
}

/// What the tangent of eight tetrahedra needs.
#[derive(Clone, Debug)]
struct GroupTangent {
    /// Q by rows.
    q: [Lanes; 9],
    /// mu - p J.
    turning_pa: Lanes,
    /// Factor of (Q : dF) Q: lambda, or p J with node-averaged pressure.
    swelling_pa: Lanes,
    volume_ratio: Lanes,
}

const NO_TANGENT: GroupTangent = GroupTangent {
    q: [[0.0; LANES]; 9],
    turning_pa: [0.0; LANES],
    swelling_pa: [0.0; LANES],
    volume_ratio: [1.0; LANES],
};

/// What one evaluation says besides the forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evaluation {
    /// Elastic energy [J]; meaningless when inverted.
    pub(super) energy_j: f64,
    /// Smallest volume ratio of any tetrahedron; NaN counts as inverted.
    pub(super) least_volume_ratio: f64,
}

impl Evaluation {
    /// Whether all volumes are positive and all numbers finite.
    pub(super) fn is_usable(&self) -> bool {
        self.least_volume_ratio > LEAST_VOLUME_RATIO && self.energy_j.is_finite()
    }
}

/// A tetrahedron counts as inverted below this share of its volume: ln J is still harmless here.
const LEAST_VOLUME_RATIO: f64 = 1e-6;

/// All live tetrahedra and the state of their tangent.
#[derive(Clone, Debug)]
pub(super) struct Elements {
    level: Level,
    lambda_pa: f64,
    mu_pa: f64,
    volume: VolumeResistance,
    groups: Vec<Group>,
    tangents: Vec<GroupTangent>,
    /// A quarter of the volumes around each node [m3], and scratch of the node-averaged pressure.
    node_volume_m3: Vec<f64>,
    node_sum: Vec<f64>,
    node_pressure_pa: Vec<f64>,
    /// U''(J_a) / V_a of each node.
    node_bulk: Vec<f64>,
}

impl Elements {
    /// The tetrahedra `live` of the mesh at rest.
    pub(super) fn new(
        mesh: &TetMesh,
        live: &[bool],
        [lambda_pa, mu_pa]: [f64; 2],
        volume: VolumeResistance,
    ) -> Result<Self, SolveError> {
        let n_nodes = mesh.positions_m.len();
        let tets: Vec<usize> = (0..mesh.tetrahedra.len()).filter(|&t| live[t]).collect();
        let mut node_volume_m3 = vec![0.0; n_nodes];
        let mut groups = Vec::with_capacity(tets.len().div_ceil(LANES));
        for part in tets.chunks(LANES) {
            let mut group =
                Group { nodes: [[0; LANES]; 4], gradient_per_m: [[0.0; LANES]; 9], volume_m3: [0.0; LANES] };
            for lane in 0..LANES {
                // Lanes beyond the end repeat the last tetrahedron with volume zero.
                let tet = crate::mesh::TetId::from_index(part[lane.min(part.len() - 1)]);
                let gradients = P1Gradients::of_tet(mesh, tet)?;
                let nodes = mesh.tetrahedra[tet.index()];
                for k in 0..4 {
                    group.nodes[k][lane] = nodes[k].0;
                }
                for k in 0..3 {
                    for i in 0..3 {
                        group.gradient_per_m[3 * k + i][lane] = gradients.alpha_per_m[k + 1][i];
                    }
                }
                if lane < part.len() {
                    group.volume_m3[lane] = gradients.volume_m3;
                    for node in nodes {
                        node_volume_m3[node.index()] += 0.25 * gradients.volume_m3;
                    }
                }
            }
            groups.push(group);
        }
        Ok(Self {
            level: Level::new(),
            lambda_pa,
            mu_pa,
            volume,
            tangents: vec![NO_TANGENT; groups.len()],
            groups,
            node_volume_m3,
            node_sum: vec![0.0; n_nodes],
            node_pressure_pa: vec![0.0; n_nodes],
            node_bulk: vec![0.0; n_nodes],
        })
    }

    /// A quarter of the tetrahedra's volumes around each node [m3]: its share of the body.
    pub(super) fn node_volume_m3(&self) -> &[f64] {
        &self.node_volume_m3
    }

    /// Every tetrahedron's nodes, gradients alpha_1..alpha_3 [1/m] and volume [m3].
    pub(super) fn tetrahedra(&self) -> impl Iterator<Item = ([NodeId; 4], [DVec3; 3], f64)> + '_ {
        self.groups.iter().flat_map(|g| {
            (0..LANES).filter(|&l| g.volume_m3[l] > 0.0).map(move |l| {
                let row = |k: usize, i: usize| g.gradient_per_m[3 * k + i][l];
                let alpha = [0, 1, 2].map(|k| DVec3::new(row(k, 0), row(k, 1), row(k, 2)));
                ([0, 1, 2, 3].map(|k| NodeId(g.nodes[k][l])), alpha, g.volume_m3[l])
            })
        })
    }

    /// Overwrites `force_n` with the forces that balance the deformation, and keeps the tangent there.
    pub(super) fn evaluate(&mut self, displacement_m: &[DVec3], force_n: &mut [DVec3]) -> Evaluation {
        force_n.fill(DVec3::ZERO);
        let level = self.level;
        match self.volume {
            VolumeResistance::Element => {
                dispatch!(level, simd => evaluate::<_, false>(simd, self, displacement_m, force_n))
            }
            VolumeResistance::NodeAveraged => {
                let least = dispatch!(level, simd => sum_node_volumes(simd, self, displacement_m));
                if least <= LEAST_VOLUME_RATIO || !least.is_finite() {
                    return Evaluation { energy_j: f64::NAN, least_volume_ratio: least };
                }
                let swelling_j = self.update_node_pressures();
                let mut found =
                    dispatch!(level, simd => evaluate::<_, true>(simd, self, displacement_m, force_n));
                found.energy_j += swelling_j;
                found
            }
        }
    }

    /// Overwrites `force_n` with K d, K being the tangent of the last evaluation.
    pub(super) fn tangent_product(&mut self, direction_m: &[DVec3], force_n: &mut [DVec3]) {
        force_n.fill(DVec3::ZERO);
        let level = self.level;
        match self.volume {
            VolumeResistance::Element => {
                dispatch!(level, simd => product::<_, false>(simd, self, direction_m, force_n));
            }
            VolumeResistance::NodeAveraged => {
                dispatch!(level, simd => sum_node_swelling(simd, self, direction_m));
                for (sum, bulk) in self.node_sum.iter_mut().zip(&self.node_bulk) {
                    *sum *= bulk;
                }
                dispatch!(level, simd => product::<_, true>(simd, self, direction_m, force_n));
            }
        }
    }

    /// Pressures and their slopes from the nodes' volumes; the energy of all volume changes [J].
    fn update_node_pressures(&mut self) -> f64 {
        let mut energy_j = 0.0;
        for n in 0..self.node_sum.len() {
            let volume_m3 = self.node_volume_m3[n];
            if volume_m3 > 0.0 {
                let ratio = self.node_sum[n] / volume_m3;
                let log = libm::log(ratio);
                energy_j += 0.5 * self.lambda_pa * log * log * volume_m3;
                self.node_pressure_pa[n] = self.lambda_pa * log / ratio;
                self.node_bulk[n] = self.lambda_pa * (1.0 - log) / (ratio * ratio * volume_m3);
            }
        }
        energy_j
    }
}

#[inline(always)]
fn load<S: Simd>(simd: S, lanes: &Lanes) -> f64x8<S> {
    f64x8::from_slice(simd, lanes)
}

#[inline(always)]
fn load_matrix<S: Simd>(simd: S, rows: &[Lanes; 9]) -> Matrix<S> {
    let mut matrix = [[f64x8::splat(simd, 0.0); 3]; 3];
    for r in 0..3 {
        for c in 0..3 {
            matrix[r][c] = load(simd, &rows[3 * r + c]);
        }
    }
    matrix
}

/// Gradient sum_k (x_k - x_0) (x) alpha_k of a vector at the nodes, by rows.
#[inline(always)]
fn gradient<S: Simd>(simd: S, group: &Group, alpha: &Matrix<S>, x: &[DVec3]) -> Matrix<S> {
    let mut corner = [[[0.0; LANES]; 3]; 4];
    for k in 0..4 {
        for lane in 0..LANES {
            let v = &x[group.nodes[k][lane] as usize];
            corner[k][0][lane] = v.x;
            corner[k][1][lane] = v.y;
            corner[k][2][lane] = v.z;
        }
    }
    let mut result = [[f64x8::splat(simd, 0.0); 3]; 3];
    for i in 0..3 {
        let origin = load(simd, &corner[0][i]);
        let d0 = load(simd, &corner[1][i]) - origin;
        let d1 = load(simd, &corner[2][i]) - origin;
        let d2 = load(simd, &corner[3][i]) - origin;
        for j in 0..3 {
            result[i][j] = d0 * alpha[0][j] + d1 * alpha[1][j] + d2 * alpha[2][j];
        }
    }
    result
}

/// F = I + H, its cofactor matrix, and J.
#[inline(always)]
fn deformation<S: Simd>(h: &Matrix<S>) -> (Matrix<S>, Matrix<S>, f64x8<S>) {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] += 1.0;
    }
    let mut cofactor = f;
    for i in 0..3 {
        let (a, b) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (c, d) = ((j + 1) % 3, (j + 2) % 3);
            cofactor[i][j] = f[a][c] * f[b][d] - f[a][d] * f[b][c];
        }
    }
    let j = f[0][0] * cofactor[0][0] + f[0][1] * cofactor[0][1] + f[0][2] * cofactor[0][2];
    (f, cofactor, j)
}

/// Adds V P alpha_k to the nodes k = 1, 2, 3 and the opposite sum to node 0, lane after lane.
#[inline(always)]
fn scatter<S: Simd>(
    group: &Group,
    alpha: &Matrix<S>,
    stress_times_volume: &Matrix<S>,
    force_n: &mut [DVec3],
) {
    let p = stress_times_volume;
    let mut share = [[[0.0; LANES]; 3]; 4];
    for i in 0..3 {
        let f1 = p[i][0] * alpha[0][0] + p[i][1] * alpha[0][1] + p[i][2] * alpha[0][2];
        let f2 = p[i][0] * alpha[1][0] + p[i][1] * alpha[1][1] + p[i][2] * alpha[1][2];
        let f3 = p[i][0] * alpha[2][0] + p[i][1] * alpha[2][1] + p[i][2] * alpha[2][2];
        (-(f1 + f2 + f3)).store_slice(&mut share[0][i]);
        f1.store_slice(&mut share[1][i]);
        f2.store_slice(&mut share[2][i]);
        f3.store_slice(&mut share[3][i]);
    }
    for lane in 0..LANES {
        for k in 0..4 {
            let f = &mut force_n[group.nodes[k][lane] as usize];
            f.x += share[k][0][lane];
            f.y += share[k][1][lane];
            f.z += share[k][2][lane];
        }
    }
}

/// Sum of a node value over the four corners of each lane.
#[inline(always)]
fn corner_sum<S: Simd>(simd: S, group: &Group, of_node: &[f64]) -> f64x8<S> {
    let mut sum = [0.0; LANES];
    for k in 0..4 {
        for lane in 0..LANES {
            sum[lane] += of_node[group.nodes[k][lane] as usize];
        }
    }
    load(simd, &sum)
}

#[inline(always)]
fn evaluate<S: Simd, const AVERAGED: bool>(
    simd: S,
    elements: &mut Elements,
    displacement_m: &[DVec3],
    force_n: &mut [DVec3],
) -> Evaluation {
    let (mu, lambda) = (elements.mu_pa, elements.lambda_pa);
    let mut energy = f64x8::splat(simd, 0.0);
    let mut least = f64x8::splat(simd, f64::INFINITY);
    for (group, tangent) in elements.groups.iter().zip(&mut elements.tangents) {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let h = gradient(simd, group, &alpha, displacement_m);
        let (f, cofactor, j) = deformation(&h);
        least = least.min(j);
        let inverse = f64x8::splat(simd, 1.0) / j;
        let mut lanes = [0.0; LANES];
        j.store_slice(&mut lanes);
        let mut log = [0.0; LANES];
        for lane in 0..LANES {
            log[lane] = libm::log(lanes[lane]);
        }
        let log = load(simd, &log);
        // |F|^2 - 3 = 2 tr H + |H|^2 keeps its digits near rest.
        let mut stretch = (h[0][0] + h[1][1] + h[2][2]) * 2.0;
        for row in &h {
            for x in row {
                stretch += *x * *x;
            }
        }
        let mut density = stretch * (0.5 * mu) - log * mu;
        let p_j = if AVERAGED {
            corner_sum(simd, group, &elements.node_pressure_pa) * 0.25 * j
        } else {
            density += log * log * (0.5 * lambda);
            log * lambda
        };
        let volume = load(simd, &group.volume_m3);
        energy += density * volume;
        let turning = f64x8::splat(simd, mu) - p_j;
        turning.store_slice(&mut tangent.turning_pa);
        if AVERAGED {
            p_j.store_slice(&mut tangent.swelling_pa);
            tangent.volume_ratio = lanes;
        } else {
            tangent.swelling_pa = [lambda; LANES];
        }
        let mut stress = f;
        for r in 0..3 {
            for c in 0..3 {
                let q = cofactor[r][c] * inverse;
                q.store_slice(&mut tangent.q[3 * r + c]);
                stress[r][c] = (f[r][c] * mu - q * turning) * volume;
            }
        }
        scatter(group, &alpha, &stress, force_n);
    }
    let (mut energy_lanes, mut least_lanes) = ([0.0; LANES], [0.0; LANES]);
    energy.store_slice(&mut energy_lanes);
    least.store_slice(&mut least_lanes);
    Evaluation {
        energy_j: energy_lanes.iter().sum(),
        least_volume_ratio: least_lanes.into_iter().fold(f64::INFINITY, f64::min),
    }
}

/// dP for dF = sum_k (d_k - d_0) (x) alpha_k; the sum over nodes of dp is ready in `node_sum` when averaged.
#[inline(always)]
fn product<S: Simd, const AVERAGED: bool>(
    simd: S,
    elements: &mut Elements,
    direction_m: &[DVec3],
    force_n: &mut [DVec3],
) {
    let mu = elements.mu_pa;
    for (group, tangent) in elements.groups.iter().zip(&elements.tangents) {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let df = gradient(simd, group, &alpha, direction_m);
        let q = load_matrix(simd, &tangent.q);
        // T = dF^T Q; its trace is Q : dF.
        let mut t = df;
        for r in 0..3 {
            for c in 0..3 {
                t[r][c] = df[0][r] * q[0][c] + df[1][r] * q[1][c] + df[2][r] * q[2][c];
            }
        }
        let trace = t[0][0] + t[1][1] + t[2][2];
        let mut swelling = trace * load(simd, &tangent.swelling_pa);
        if AVERAGED {
            let dp = corner_sum(simd, group, &elements.node_sum) * 0.25;
            swelling += dp * load(simd, &tangent.volume_ratio);
        }
        let turning = load(simd, &tangent.turning_pa);
        let volume = load(simd, &group.volume_m3);
        let mut stress = df;
        for r in 0..3 {
            for c in 0..3 {
                let turned = q[r][0] * t[0][c] + q[r][1] * t[1][c] + q[r][2] * t[2][c];
                stress[r][c] = (df[r][c] * mu + turned * turning + q[r][c] * swelling) * volume;
            }
        }
        scatter(group, &alpha, &stress, force_n);
    }
}

/// Sums J V/4 at the nodes; the smallest J.
#[inline(always)]
fn sum_node_volumes<S: Simd>(simd: S, elements: &mut Elements, displacement_m: &[DVec3]) -> f64 {
    let Elements { groups, node_sum, .. } = elements;
    node_sum.fill(0.0);
    let mut least = f64x8::splat(simd, f64::INFINITY);
    for group in groups.iter() {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let h = gradient(simd, group, &alpha, displacement_m);
        let (_, _, j) = deformation(&h);
        least = least.min(j);
        add_to_corners(group, j * load(simd, &group.volume_m3) * 0.25, node_sum);
    }
    let mut lanes = [0.0; LANES];
    least.store_slice(&mut lanes);
    lanes.into_iter().fold(f64::INFINITY, f64::min)
}

/// Sums J (Q : dF) V/4, the change of volume, at the nodes.
#[inline(always)]
fn sum_node_swelling<S: Simd>(simd: S, elements: &mut Elements, direction_m: &[DVec3]) {
    let Elements { groups, tangents, node_sum, .. } = elements;
    node_sum.fill(0.0);
    for (group, tangent) in groups.iter().zip(tangents.iter()) {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let df = gradient(simd, group, &alpha, direction_m);
        let q = load_matrix(simd, &tangent.q);
        let mut trace = f64x8::splat(simd, 0.0);
        for r in 0..3 {
            for c in 0..3 {
                trace += q[r][c] * df[r][c];
            }
        }
        let ratio = load(simd, &tangent.volume_ratio);
        add_to_corners(group, trace * ratio * load(simd, &group.volume_m3) * 0.25, node_sum);
    }
}

#[inline(always)]
fn add_to_corners<S: Simd>(group: &Group, value: f64x8<S>, of_node: &mut [f64]) {
    let mut lanes = [0.0; LANES];
    value.store_slice(&mut lanes);
    for lane in 0..LANES {
        for k in 0..4 {
            of_node[group.nodes[k][lane] as usize] += lanes[lane];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;
    use crate::mesh::NodeId;

    /// Forces are the slope of the energy, and the tangent product that of the forces, for both volume terms.
    #[test]
    fn forces_and_tangent_are_derivatives() {
        let mut random = SeededRandom::new(8);
        let mut mesh = TetMesh::default();
        for i in 0..8 {
            let corner = DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2));
            let shift = DVec3::new(random.normal(), random.normal(), random.normal()) * 0.05;
            mesh.positions_m.push(corner + shift);
        }
        mesh.tetrahedra =
            [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
                .map(|t| t.map(NodeId))
                .to_vec();
        let mut vectors = |scale: f64| -> Vec<DVec3> {
            (0..8).map(|_| DVec3::new(random.normal(), random.normal(), random.normal()) * scale).collect()
        };
        let (u, d) = (vectors(0.05), vectors(1.0));
        for volume in [VolumeResistance::Element, VolumeResistance::NodeAveraged] {
            let mut elements = Elements::new(&mesh, &[true; 6], [9000.0, 1000.0], volume).unwrap();
            let step = 1e-6;
            let moved = |s: f64| -> Vec<DVec3> { u.iter().zip(&d).map(|(u, d)| *u + *d * s).collect() };
            let mut forces = [vec![DVec3::ZERO; 8], vec![DVec3::ZERO; 8], vec![DVec3::ZERO; 8]];
            let above = elements.evaluate(&moved(step), &mut forces[0]);
            let below = elements.evaluate(&moved(-step), &mut forces[1]);
            assert!(elements.evaluate(&u, &mut forces[2]).is_usable());
            let work: f64 = forces[2].iter().zip(&d).map(|(f, d)| f.dot(*d)).sum();
            let slope = (above.energy_j - below.energy_j) / (2.0 * step);
            assert!((work - slope).abs() <= 1e-6 * work.abs(), "{volume:?}: {work} {slope}");
            let mut product = vec![DVec3::ZERO; 8];
            elements.tangent_product(&d, &mut product);
            let size = product.iter().map(|f| f.length()).fold(0.0, f64::max);
            for n in 0..8 {
                let slope = (forces[0][n] - forces[1][n]) / (2.0 * step);
                assert!((product[n] - slope).length() <= 1e-6 * size, "{volume:?}: {} {slope}", product[n]);
            }
            // Forces balance each other.
            assert!(forces[2].iter().sum::<DVec3>().length() <= 1e-12 * size);
        }
    }
}
