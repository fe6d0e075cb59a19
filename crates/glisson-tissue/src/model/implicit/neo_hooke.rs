//! The ln J neo-Hooke law, eight tetrahedra at a time.
//!
//! With Q = F^-T and J = det F, the energy density is
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
//! With node-averaged strain, of the rest of W only the share s stays in the tetrahedra; 1 - s of it acts on the
//! mean F of each node, F_a = sum of F V/4 over the sum of V/4, and a tetrahedron takes the mean of its nodes'
//! stresses P_a = (1 - s) mu (F_a - F_a^-T). The linear limit is [`crate::solve::NodeAveraging::STRAIN`].

use fearless_simd::{Simd, dispatch, f64x8, prelude::*};

use super::VolumeResistance;
use super::evaluation::{Evaluation, On};
use super::lanes::{
    Group, LANES, Lanes, Matrix, Moduli, Shape, SymmetricLanes, add_to_corners, add_turned, added_density,
    corner_mean, corner_mean_matrix, deformation, gradient, load, load_matrix, of_tet, scale, stretch,
};
use super::projected::projected_stiffness;
use super::shares::{Allowed, Share, Shares, scatter};
use crate::material::NeoHookeLog;
use crate::solve::{NodeAveraging, TetStiffness};
use glisson_mesh::math::{DMat3, DVec3};

/// Data of the tangent of eight tetrahedra.
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

/// A tetrahedron counts as inverted below this volume ratio: ln J is still finite and moderate here.
pub(super) const LEAST_VOLUME_RATIO: f64 = 1e-6;
/// lambda over mu of nu = 0.4.
const SOFTENED_LAMBDA_OVER_MU: f64 = 4.0;

/// Law and tangent of all tetrahedra.
#[derive(Clone, Debug)]
pub(super) struct NeoHooke {
    /// One, or one per live tetrahedron; one alone where anything is averaged.
    laws: Vec<NeoHookeLog>,
    /// Their lambda and mu.
    lame: Moduli,
    volume: VolumeResistance,
    tangents: Vec<GroupTangent>,
    /// A quarter of the volumes around each node [m3], and scratch of the node-averaged pressure.
    node_volume_m3: Vec<f64>,
    node_sum: Vec<f64>,
    node_pressure_pa: Vec<f64>,
    /// U''(J_a) / V_a of each node.
    node_bulk: Vec<f64>,
    /// Share of the shear that stays in the tetrahedra.
    element_shear: f64,
    /// Empty unless strain is averaged.
    node_shear: Vec<NodeShear>,
}

/// The averaged strain of a node; matrices by rows.
#[derive(Clone, Copy, Debug)]
struct NodeShear {
    /// Sum of V/4 times a gradient [m3].
    sum: [f64; 9],
    /// F_a^-T.
    q: DMat3,
    /// P_a or its differential [Pa].
    stress_pa: [f64; 9],
}

/// What is averaged, as a constant for the kernels.
const IN_ELEMENTS: u8 = 0;
const PRESSURE: u8 = 1;
const STRAIN: u8 = 2;

impl NeoHooke {
    pub(super) fn new(
        laws: Vec<NeoHookeLog>,
        volume: VolumeResistance,
        n_groups: usize,
        node_volume_m3: &[f64],
    ) -> Self {
        let n_nodes = node_volume_m3.len();
        let lame_pa: Vec<[f64; 2]> = laws.iter().map(|law| [law.lambda_pa(), law.mu_pa()]).collect();
        Self {
            laws,
            lame: Moduli::new(&lame_pa),
            volume,
            tangents: vec![NO_TANGENT; n_groups],
            node_volume_m3: node_volume_m3.to_vec(),
            node_sum: vec![0.0; n_nodes],
            node_pressure_pa: vec![0.0; n_nodes],
            node_bulk: vec![0.0; n_nodes],
            element_shear: match volume {
                VolumeResistance::NodeAveragedStrain => NodeAveraging::STRAIN.element_shear,
                VolumeResistance::Element | VolumeResistance::NodeAveraged => 1.0,
            },
            node_shear: match volume {
                VolumeResistance::NodeAveragedStrain => {
                    vec![NodeShear { sum: [0.0; 9], q: DMat3::IDENTITY, stress_pa: [0.0; 9] }; n_nodes]
                }
                VolumeResistance::Element | VolumeResistance::NodeAveraged => Vec::new(),
            },
        }
    }

    /// Overwrites `force_n` with the forces [N] of `factor` times the law; keeps the tangent.
    pub(super) fn evaluate(
        &mut self,
        on: &On<'_>,
        shares: &mut Shares,
        displacement_m: &[DVec3],
        force_n: &mut [DVec3],
    ) -> Evaluation {
        let [lambda, mu] = self.averaged_pa().map(|x| on.factor * x);
        let scaled = Scaled { factor: on.factor, shear: self.element_shear };
        let mut averaged_j = 0.0;
        if self.volume != VolumeResistance::Element {
            let least = dispatch!(on.level, simd => sum_node_volumes(simd, self, on.shape, displacement_m));
            if least <= LEAST_VOLUME_RATIO || !least.is_finite() {
                force_n.fill(DVec3::ZERO);
                return Evaluation { energy_j: f64::NAN, is_upright: false, has_inverted: false };
            }
            averaged_j += self.update_node_pressures(lambda);
        }
        if self.volume == VolumeResistance::NodeAveragedStrain {
            dispatch!(on.level, simd => sum_node_gradients(simd, self, on.shape, displacement_m));
            averaged_j += self.update_node_shear((1.0 - self.element_shear) * mu);
        }
        let Self { lame, tangents, volume, node_pressure_pa, node_shear, .. } = self;
        let of_nodes = OfNodes { scalar: node_pressure_pa, shear: node_shear };
        let mut found = shares.evaluate(on.workers, tangents, force_n, |groups, tangents, share| {
            let scaled = (lame.stretch(groups.clone()), scaled);
            let groups = on.shape.stretch(groups);
            match volume {
                VolumeResistance::Element => {
                    dispatch!(on.level, simd => evaluate::<_, IN_ELEMENTS>(simd, tangents, (groups, of_nodes), scaled, displacement_m, share))
                }
                VolumeResistance::NodeAveraged => {
                    dispatch!(on.level, simd => evaluate::<_, PRESSURE>(simd, tangents, (groups, of_nodes), scaled, displacement_m, share))
                }
                VolumeResistance::NodeAveragedStrain => {
                    dispatch!(on.level, simd => evaluate::<_, STRAIN>(simd, tangents, (groups, of_nodes), scaled, displacement_m, share))
                }
            }
        });
        found.energy_j += averaged_j;
        found
    }

    /// Overwrites `force_n` with K d, K being the tangent of the last evaluation with the same factor.
    pub(super) fn tangent_product(
        &mut self,
        on: &On<'_>,
        shares: &mut Shares,
        direction_m: &[DVec3],
        force_n: &mut [DVec3],
    ) {
        let scaled = Scaled { factor: on.factor, shear: self.element_shear };
        if self.volume != VolumeResistance::Element {
            dispatch!(on.level, simd => sum_node_swelling(simd, self, on.shape, direction_m));
            for (sum, bulk) in self.node_sum.iter_mut().zip(&self.node_bulk) {
                *sum *= bulk;
            }
        }
        if self.volume == VolumeResistance::NodeAveragedStrain {
            dispatch!(on.level, simd => sum_node_gradients(simd, self, on.shape, direction_m));
            let mu = on.factor * self.averaged_pa()[1];
            self.update_node_shear_change(mu - self.element_shear * mu);
        }
        let of_nodes = OfNodes { scalar: &self.node_sum, shear: &self.node_shear };
        shares.sum(on.workers, force_n, |groups, share| {
            let tangents = &self.tangents[groups.clone()];
            let scaled = (self.lame.stretch(groups.clone()), scaled);
            let groups = on.shape.stretch(groups);
            match self.volume {
                VolumeResistance::Element => {
                    dispatch!(on.level, simd => product::<_, IN_ELEMENTS>(simd, tangents, (groups, of_nodes), scaled, direction_m, share));
                }
                VolumeResistance::NodeAveraged => {
                    dispatch!(on.level, simd => product::<_, PRESSURE>(simd, tangents, (groups, of_nodes), scaled, direction_m, share));
                }
                VolumeResistance::NodeAveragedStrain => {
                    dispatch!(on.level, simd => product::<_, STRAIN>(simd, tangents, (groups, of_nodes), scaled, direction_m, share));
                }
            }
        });
    }

    /// Whether the law has an energy there.
    pub(super) fn is_valid_at(&self, f: &DMat3) -> bool {
        f.determinant() > LEAST_VOLUME_RATIO
    }

    /// lambda and mu [Pa] of what is averaged over nodes; where each tetrahedron has a law of its own nothing is.
    fn averaged_pa(&self) -> [f64; 2] {
        self.laws.first().map_or([0.0; 2], |law| [law.lambda_pa(), law.mu_pa()])
    }

    /// Second Piola-Kirchhoff stress [Pa] of live tetrahedron number `t`, which is in `group`, S = mu (I - C^-1) + p J C^-1, at the
    /// pressures of the last evaluation, which was made with `factor`. Not for averaged strain.
    pub(super) fn second_piola_pa(&self, t: usize, group: &Group, factor: f64, f: &DMat3) -> DMat3 {
        let (law, lane) = (of_tet(&self.laws, t), t % LANES);
        let inverse = f.inverse();
        let inverse_c = inverse * inverse.transpose();
        let j = f.determinant();
        let p_j = match self.volume {
            VolumeResistance::Element => law.lambda_pa() * libm::log(j),
            VolumeResistance::NodeAveraged | VolumeResistance::NodeAveragedStrain => {
                let sum: f64 = (0..4).map(|k| self.node_pressure_pa[group.nodes[k][lane] as usize]).sum();
                0.25 * sum * j / factor
            }
        };
        DMat3::from_diagonal(DVec3::splat(law.mu_pa())) + inverse_c * (p_j - law.mu_pa())
    }

    /// Projected stiffness for the preconditioner. Node-averaged pressure is softer than that of single tetrahedra, so a smaller
    /// lambda approximates it better.
    pub(super) fn projected_stiffness(
        &self,
        t: usize,
        f: DMat3,
        alpha_per_m: [DVec3; 3],
        volume_m3: f64,
    ) -> TetStiffness {
        let law = of_tet(&self.laws, t);
        let (lambda_pa, mu_pa) = (law.lambda_pa(), law.mu_pa());
        let lambda_pa = match self.volume {
            VolumeResistance::Element => lambda_pa,
            VolumeResistance::NodeAveraged | VolumeResistance::NodeAveragedStrain => {
                lambda_pa.min(SOFTENED_LAMBDA_OVER_MU * mu_pa)
            }
        };
        projected_stiffness(f, alpha_per_m, volume_m3, [lambda_pa, mu_pa])
    }

    /// Updates the nodes' pressures and their slopes from the volumes; returns the energy of all volume changes [J].
    fn update_node_pressures(&mut self, lambda_pa: f64) -> f64 {
        let mut energy_j = 0.0;
        for n in 0..self.node_sum.len() {
            let volume_m3 = self.node_volume_m3[n];
            if volume_m3 > 0.0 {
                let ratio = self.node_sum[n] / volume_m3;
                let log = libm::log(ratio);
                energy_j += 0.5 * lambda_pa * log * log * volume_m3;
                self.node_pressure_pa[n] = lambda_pa * log / ratio;
                self.node_bulk[n] = lambda_pa * (1.0 - log) / (ratio * ratio * volume_m3);
            }
        }
        energy_j
    }
}

impl NeoHooke {
    /// Updates the stresses of the nodes' mean deformation from the summed gradients; returns its energy [J], not finite where
    /// a mean is inverted.
    fn update_node_shear(&mut self, mu_pa: f64) -> f64 {
        let mut energy_j = 0.0;
        for (node, &volume_m3) in self.node_shear.iter_mut().zip(&self.node_volume_m3) {
            if volume_m3 == 0.0 {
                continue;
            }
            let h = matrix_by_rows(&node.sum) * (1.0 / volume_m3);
            let f = DMat3::IDENTITY + h;
            node.q = f.inverse().transpose();
            node.stress_pa = rows(&((f - node.q) * mu_pa));
            let square: f64 = h.to_cols_array().into_iter().map(|x| x * x).sum();
            let stretch = 2.0 * (h.x_axis.x + h.y_axis.y + h.z_axis.z) + square;
            energy_j += volume_m3 * mu_pa * (0.5 * stretch - libm::log(f.determinant()));
        }
        energy_j
    }

    /// Updates the change of these stresses from the summed gradients of a direction.
    fn update_node_shear_change(&mut self, mu_pa: f64) {
        for (node, &volume_m3) in self.node_shear.iter_mut().zip(&self.node_volume_m3) {
            if volume_m3 > 0.0 {
                let df = matrix_by_rows(&node.sum) * (1.0 / volume_m3);
                node.stress_pa = rows(&((df + node.q * df.transpose() * node.q) * mu_pa));
            }
        }
    }
}

fn matrix_by_rows(rows: &[f64; 9]) -> DMat3 {
    DMat3::from_cols_array(rows).transpose()
}

fn rows(matrix: &DMat3) -> [f64; 9] {
    matrix.transpose().to_cols_array()
}

/// What Lame's coefficients are multiplied with.
#[derive(Clone, Copy)]
struct Scaled {
    /// The viscous factor, of both.
    factor: f64,
    /// The share of the shear that stays in the tetrahedra, of mu.
    shear: f64,
}

impl Scaled {
    /// lambda and mu [Pa] of a group.
    #[inline(always)]
    fn of<S: Simd>(self, simd: S, [lambda, mu]: &[Lanes; 2]) -> [f64x8<S>; 2] {
        [load(simd, lambda) * self.factor, load(simd, mu) * self.factor * self.shear]
    }
}

/// What nodes tell their tetrahedra: pressures or their changes, and averaged stresses.
#[derive(Clone, Copy)]
struct OfNodes<'a> {
    scalar: &'a [f64],
    shear: &'a [NodeShear],
}

#[inline(always)]
fn evaluate<'a, S: Simd, const AVERAGED: u8>(
    simd: S,
    tangents: &mut [GroupTangent],
    (groups, of_nodes): (impl Iterator<Item = (&'a Group, Option<&'a SymmetricLanes>)>, OfNodes<'a>),
    (lame_pa, scaled): (impl Iterator<Item = &'a [Lanes; 2]>, Scaled),
    displacement_m: &[DVec3],
    share: &mut Share,
) -> Allowed {
    let mut least = f64x8::splat(simd, f64::INFINITY);
    let mut energy = f64x8::splat(simd, 0.0);
    for (((group, added_pa), tangent), lame_pa) in groups.zip(tangents).zip(lame_pa) {
        let [lambda, mu] = scaled.of(simd, lame_pa);
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let h = gradient(simd, group, &alpha, displacement_m);
        let (f, cofactor, j) = deformation(&h);
        least = least.min(j);
        let inverse = f64x8::splat(simd, 1.0) / j;
        let mut lanes = [0.0; LANES];
        j.store_slice(&mut lanes);
        let log = logarithm(simd, &lanes);
        let mut density = stretch(&h) * (mu * 0.5) - log * mu;
        let p_j = if AVERAGED != IN_ELEMENTS {
            corner_mean(simd, group, of_nodes.scalar) * j
        } else {
            density += log * log * (lambda * 0.5);
            log * lambda
        };
        let volume = load(simd, &group.volume_m3);
        if let Some(added_pa) = added_pa {
            density += added_density(simd, &h, added_pa);
        }
        energy += density * volume;
        let turning = mu - p_j;
        turning.store_slice(&mut tangent.turning_pa);
        if AVERAGED != IN_ELEMENTS {
            p_j.store_slice(&mut tangent.swelling_pa);
            tangent.volume_ratio = lanes;
        } else {
            lambda.store_slice(&mut tangent.swelling_pa);
        }
        let mut stress = f;
        for r in 0..3 {
            for c in 0..3 {
                let q = cofactor[r][c] * inverse;
                q.store_slice(&mut tangent.q[3 * r + c]);
                stress[r][c] = f[r][c] * mu - q * turning;
            }
        }
        if AVERAGED == STRAIN {
            add_node_shear(simd, group, of_nodes.shear, &mut stress);
        }
        if let Some(added_pa) = added_pa {
            add_turned(simd, group, &f, added_pa, &mut stress);
        }
        scale(&mut stress, volume);
        scatter(group, &alpha, &stress, share);
    }
    energy.store_slice(&mut share.energy_j);
    let mut lanes = [0.0; LANES];
    least.store_slice(&mut lanes);
    Allowed { is_upright: lanes.into_iter().all(|j| j > LEAST_VOLUME_RATIO), has_inverted: false }
}

/// ln of each lane.
#[inline(always)]
fn logarithm<S: Simd>(simd: S, lanes: &Lanes) -> f64x8<S> {
    let mut log = [0.0; LANES];
    for lane in 0..LANES {
        log[lane] = libm::log(lanes[lane]);
    }
    load(simd, &log)
}

/// dP for dF = sum_k (d_k - d_0) (x) alpha_k; the sum over nodes of dp is ready when averaged.
#[inline(always)]
fn product<'a, S: Simd, const AVERAGED: u8>(
    simd: S,
    tangents: &[GroupTangent],
    (groups, of_nodes): (impl Iterator<Item = (&'a Group, Option<&'a SymmetricLanes>)>, OfNodes<'a>),
    (lame_pa, scaled): (impl Iterator<Item = &'a [Lanes; 2]>, Scaled),
    direction_m: &[DVec3],
    share: &mut Share,
) {
    for (((group, added_pa), tangent), lame_pa) in groups.zip(tangents).zip(lame_pa) {
        let [_, mu] = scaled.of(simd, lame_pa);
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
        if AVERAGED != IN_ELEMENTS {
            let dp = corner_mean(simd, group, of_nodes.scalar);
            swelling += dp * load(simd, &tangent.volume_ratio);
        }
        let turning = load(simd, &tangent.turning_pa);
        let volume = load(simd, &group.volume_m3);
        let mut stress = df;
        for r in 0..3 {
            for c in 0..3 {
                let turned = q[r][0] * t[0][c] + q[r][1] * t[1][c] + q[r][2] * t[2][c];
                stress[r][c] = df[r][c] * mu + turned * turning + q[r][c] * swelling;
            }
        }
        if AVERAGED == STRAIN {
            add_node_shear(simd, group, of_nodes.shear, &mut stress);
        }
        if let Some(added_pa) = added_pa {
            add_turned(simd, group, &df, added_pa, &mut stress);
        }
        scale(&mut stress, volume);
        scatter(group, &alpha, &stress, share);
    }
}

/// Sums J V/4 at the nodes; returns the smallest J.
#[inline(always)]
fn sum_node_volumes<S: Simd>(simd: S, law: &mut NeoHooke, shape: &Shape, displacement_m: &[DVec3]) -> f64 {
    let node_sum = &mut law.node_sum;
    node_sum.fill(0.0);
    let mut least = f64x8::splat(simd, f64::INFINITY);
    for group in shape.groups.iter() {
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
fn sum_node_swelling<S: Simd>(simd: S, law: &mut NeoHooke, shape: &Shape, direction_m: &[DVec3]) {
    let NeoHooke { tangents, node_sum, .. } = law;
    node_sum.fill(0.0);
    for (group, tangent) in shape.groups.iter().zip(tangents.iter()) {
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

/// Sums V/4 times the gradient of a vector at the nodes.
#[inline(always)]
fn sum_node_gradients<S: Simd>(simd: S, law: &mut NeoHooke, shape: &Shape, vector: &[DVec3]) {
    for node in &mut law.node_shear {
        node.sum = [0.0; 9];
    }
    for group in &shape.groups {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let h = gradient(simd, group, &alpha, vector);
        let quarter = load(simd, &group.volume_m3) * 0.25;
        let mut lanes = [[0.0; LANES]; 9];
        for r in 0..3 {
            for c in 0..3 {
                (h[r][c] * quarter).store_slice(&mut lanes[3 * r + c]);
            }
        }
        for lane in 0..LANES {
            for k in 0..4 {
                let sum = &mut law.node_shear[group.nodes[k][lane] as usize].sum;
                for (sum, values) in sum.iter_mut().zip(&lanes) {
                    *sum += values[lane];
                }
            }
        }
    }
}

#[inline(always)]
fn add_node_shear<S: Simd>(simd: S, group: &Group, nodes: &[NodeShear], stress: &mut Matrix<S>) {
    let mean = corner_mean_matrix(simd, group, |n| &nodes[n].stress_pa);
    for r in 0..3 {
        for c in 0..3 {
            stress[r][c] += mean[r][c];
        }
    }
}
