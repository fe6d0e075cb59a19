//! All live tetrahedra: forces and tangent products of their law, of added stress, and of inverted ones.
//!
//! The stress is P = factor * P_elastic(F) + F S. S is the stress at rest plus the viscous memory, and `factor` is the
//! share of the elastic stress in this step ([`super::relaxation`]). Both are constant during a step, so that a potential
//! exists.
//!
//! Quarantine: a tetrahedron in which the law has no energy (an inverted one for a law with ln J), and all that share a node
//! with it, follow for one step the stable neo-Hookean law of the same stiffness at rest. This law is finite and restoring
//! for every F; the neighbours take part so that none of them blocks the way back. While a body recovers, the same applies
//! to tetrahedra that are still far from their shape at rest. Where these are many, it applies to the whole body until none
//! is left: the energy barrier of the law itself would preserve a tangle.

use std::borrow::Cow;

use fearless_simd::Level;

use super::evaluation::{Evaluation, On};
use super::general::{General, stiffness_of};
use super::lanes::{Group, LANES, SYMMETRIC, Shape, SymmetricLanes};
use super::law::ImplicitLaw;
use super::neo_hooke::NeoHooke;
use super::shares::Shares;
use super::stable_neo_hooke::Stable;
use super::{RestStress, VolumeResistance};
use crate::material::{Material, StableNeoHooke};
use crate::model::bounded_vec::BoundedVec;
use crate::solve::{P1Gradients, SolveError, TetStiffness};
use crate::workers::Workers;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// A recovering tetrahedron follows its own law again above this volume ratio ...
const RETURN_RATIO: f64 = 0.6;
/// ... and below this |F|^2, which is 3 at rest. A tangle whose tetrahedra are all upright is stretched more.
const RETURN_SQUARES: f64 = 4.5;
/// When one in so many tetrahedra is in trouble, the body counts as tangled.
const TANGLE: usize = 20;
/// An inverted F: a law with an energy there has no barrier.
const MIRROR: DMat3 = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));

/// Which tetrahedra follow the stand-in law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Recovery {
    /// None of them.
    None = 0,
    /// Those in trouble and their neighbours.
    Around = 1,
    /// All.
    Whole = 2,
}

#[derive(Clone)]
enum OwnLaw {
    NeoHooke(NeoHooke),
    Stable(Stable),
    General(General),
}

/// A tetrahedron that follows the stand-in law during this step.
#[derive(Clone, Debug)]
struct Stray {
    /// Number among the live tetrahedra.
    live: u32,
    /// F at the last evaluation.
    f: DMat3,
}

/// All live tetrahedra and the state of their tangent.
#[derive(Clone)]
pub(super) struct Elements {
    level: Level,
    shape: Shape,
    shares: Shares,
    /// Numbers in the mesh of the live tetrahedra.
    tets: Vec<TetId>,
    own: OwnLaw,
    /// One, or one per live tetrahedron.
    stand_ins: Vec<StableNeoHooke>,
    factor: f64,
    /// Whether the last evaluation found a tetrahedron inside out.
    has_inverted: bool,
    /// Stress at rest [Pa]; empty for none.
    rest_pa: Vec<SymmetricLanes>,
    /// The stress at rest without its negative eigenvalues [Pa], for the preconditioner.
    tensile_rest_pa: Vec<DMat3>,
    node_volume_m3: Vec<f64>,
    strays: BoundedVec<Stray>,
    // Scratch of the quarantine.
    is_bad: Vec<bool>,
    meets_bad: Vec<bool>,
}

/// Parameters of [`Elements::new`]; lists have the mesh's tetrahedra.
pub(super) struct ElementsParams<'a> {
    pub(super) mesh: &'a TetMesh,
    pub(super) live: &'a [bool],
    pub(super) law: &'a ImplicitLaw,
    /// One, or one per tetrahedron.
    pub(super) stand_ins: &'a [StableNeoHooke],
    pub(super) volume: VolumeResistance,
    /// One per tetrahedron, or none.
    pub(super) rest_stress_pa: &'a [RestStress],
    /// Whether [`Elements::set_viscous`] will be used.
    pub(super) is_viscous: bool,
    /// Elements of the same mesh: tetrahedra of the same number are the same.
    pub(super) known: Option<&'a Elements>,
}

/// The values of the live tetrahedra, of a list with one value or one per tetrahedron.
fn of_live<'a, T: Clone>(list: &'a [T], tets: &[TetId]) -> Cow<'a, [T]> {
    if list.len() == 1 {
        Cow::Borrowed(list)
    } else {
        Cow::Owned(tets.iter().map(|t| list[t.index()].clone()).collect())
    }
}

/// The tetrahedra in groups of eight, and a quarter of the volumes around each node [m3]. Gradients of those that are `known` are
/// taken from there.
fn groups_of(
    mesh: &TetMesh,
    tets: &[TetId],
    known: Option<&Elements>,
) -> Result<(Vec<Group>, Vec<f64>), SolveError> {
    let mut node_volume_m3 = vec![0.0; mesh.positions_m.len()];
    let mut groups = Vec::with_capacity(tets.len().div_ceil(LANES));
    // Both lists ascend.
    let mut before = known.map_or(&[][..], |elements| &elements.tets).iter().enumerate().peekable();
    for part in tets.chunks(LANES) {
        let mut group = Group {
            nodes: [[0; LANES]; 4],
            gradient_per_m: [[0.0; LANES]; 9],
            volume_m3: [0.0; LANES],
            left_out: 0,
        };
        for (lane, tet) in part.iter().enumerate() {
            while before.next_if(|(_, known)| *known < tet).is_some() {}
            let (alpha_per_m, volume_m3) = match before.next_if(|(_, known)| *known == tet).zip(known) {
                Some(((t, _), elements)) => {
                    let (_, alpha_per_m, volume_m3) = elements.tetrahedron(t);
                    (alpha_per_m, volume_m3)
                }
                None => {
                    let gradients = P1Gradients::of_tet(mesh, *tet)?;
                    let [_, a, b, c] = gradients.alpha_per_m;
                    ([a, b, c], gradients.volume_m3)
                }
            };
            let nodes = mesh.tetrahedra[tet.index()];
            for k in 0..4 {
                group.nodes[k][lane] = nodes[k].0;
            }
            for k in 0..3 {
                for i in 0..3 {
                    group.gradient_per_m[3 * k + i][lane] = alpha_per_m[k][i];
                }
            }
            group.volume_m3[lane] = volume_m3;
            for node in nodes {
                node_volume_m3[node.index()] += 0.25 * volume_m3;
            }
        }
        // Lanes beyond the end repeat the last tetrahedron with volume zero.
        for lane in part.len()..LANES {
            group.nodes.iter_mut().for_each(|of_lane| of_lane[lane] = of_lane[part.len() - 1]);
            group.gradient_per_m.iter_mut().for_each(|of_lane| of_lane[lane] = of_lane[part.len() - 1]);
        }
        groups.push(group);
    }
    Ok((groups, node_volume_m3))
}

/// The stress at rest [Pa] in groups of eight, and its parts without negative eigenvalues; empty lists for none.
fn rest_stresses(tets: &[TetId], of_tet_pa: &[RestStress]) -> (Vec<SymmetricLanes>, Vec<DMat3>) {
    let (mut rest_pa, mut tensile_pa) = (Vec::new(), Vec::new());
    if !of_tet_pa.is_empty() {
        rest_pa = vec![[[0.0; LANES]; 6]; tets.len().div_ceil(LANES)];
        for (t, tet) in tets.iter().enumerate() {
            let s = of_tet_pa[tet.index()];
            for k in 0..6 {
                rest_pa[t / LANES][k][t % LANES] = s[k];
            }
            tensile_pa.push(super::projected::without_negative_eigenvalues(symmetric(&s)));
        }
    }
    (rest_pa, tensile_pa)
}

impl Elements {
    pub(super) fn new(params: &ElementsParams<'_>) -> Result<Self, SolveError> {
        let ElementsParams { mesh, live, law, stand_ins, volume, rest_stress_pa, is_viscous, known } =
            *params;
        let n_nodes = mesh.positions_m.len();
        let tets: Vec<TetId> =
            (0..mesh.tetrahedra.len()).filter(|&t| live[t]).map(TetId::from_index).collect();
        let (groups, node_volume_m3) = groups_of(mesh, &tets, known)?;
        let n_groups = groups.len();
        let own = match law {
            ImplicitLaw::NeoHookeLog(law) => {
                OwnLaw::NeoHooke(NeoHooke::new(vec![*law], volume, n_groups, &node_volume_m3))
            }
            ImplicitLaw::NeoHookeLogOfEach(laws) => {
                let laws = of_live(laws, &tets).into_owned();
                OwnLaw::NeoHooke(NeoHooke::new(laws, volume, n_groups, &node_volume_m3))
            }
            ImplicitLaw::StableNeoHooke(law) => OwnLaw::Stable(Stable::new(vec![*law], n_groups)),
            ImplicitLaw::StableNeoHookeOfEach(laws) => {
                OwnLaw::Stable(Stable::new(of_live(laws, &tets).into_owned(), n_groups))
            }
            ImplicitLaw::General(laws) => {
                OwnLaw::General(General::new(of_live(laws, &tets).into_owned(), n_groups))
            }
        };
        let (rest_pa, tensile_rest_pa) = rest_stresses(&tets, rest_stress_pa);
        let added_pa = if is_viscous && rest_pa.is_empty() {
            vec![[[0.0; LANES]; 6]; n_groups]
        } else {
            rest_pa.clone()
        };
        Ok(Self {
            level: Level::new(),
            shares: Shares::new(&groups, n_nodes),
            shape: Shape { groups, added_pa },
            own,
            stand_ins: of_live(stand_ins, &tets).into_owned(),
            factor: 1.0,
            has_inverted: false,
            rest_pa,
            tensile_rest_pa,
            node_volume_m3,
            strays: BoundedVec::with_capacity(tets.len()),
            is_bad: vec![false; tets.len()],
            meets_bad: vec![false; n_nodes],
            tets,
        })
    }

    /// A quarter of the tetrahedra's volumes around each node [m3]: its share of the body.
    pub(super) fn node_volume_m3(&self) -> &[f64] {
        &self.node_volume_m3
    }

    /// Numbers in the mesh of the live tetrahedra.
    pub(super) fn tets(&self) -> &[TetId] {
        &self.tets
    }

    /// Nodes, gradients alpha_1..alpha_3 [1/m] and volume [m3] of live tetrahedron number `t`.
    pub(super) fn tetrahedron(&self, t: usize) -> ([NodeId; 4], [DVec3; 3], f64) {
        let (group, lane) = (&self.shape.groups[t / LANES], t % LANES);
        let row = |k: usize, i: usize| group.gradient_per_m[3 * k + i][lane];
        let alpha = [0, 1, 2].map(|k| DVec3::new(row(k, 0), row(k, 1), row(k, 2)));
        ([0, 1, 2, 3].map(|k| NodeId(group.nodes[k][lane])), alpha, group.volume_m3[lane])
    }

    /// grad of a vector at the nodes, in live tetrahedron number `t`.
    fn gradient(&self, t: usize, vector: &[DVec3]) -> DMat3 {
        let (nodes, alpha, _) = self.tetrahedron(t);
        let v = nodes.map(|n| vector[n.index()]);
        outer(v[1] - v[0], alpha[0]) + outer(v[2] - v[0], alpha[1]) + outer(v[3] - v[0], alpha[2])
    }

    /// Sets this step's viscous factor and the added stress: for each live tetrahedron the one at rest plus `remembered_pa`.
    pub(super) fn set_viscous(&mut self, factor: f64, remembered_pa: impl Fn(TetId) -> DMat3) {
        self.factor = factor;
        for (t, &tet) in self.tets.iter().enumerate() {
            let s = remembered_pa(tet);
            let (g, lane) = (t / LANES, t % LANES);
            for (k, x) in components(&s).into_iter().enumerate() {
                let rest_pa = self.rest_pa.get(g).map_or(0.0, |rest| rest[k][lane]);
                self.shape.added_pa[g][k][lane] = rest_pa + x;
            }
        }
    }

    /// Share of the elastic stress in this step.
    pub(super) fn factor(&self) -> f64 {
        self.factor
    }

    /// Overwrites `force_n` with the forces that balance the deformation, and keeps the tangent there.
    pub(super) fn evaluate(
        &mut self,
        workers: &dyn Workers,
        displacement_m: &[DVec3],
        force_n: &mut [DVec3],
    ) -> Evaluation {
        let Self { level, shape, factor, shares, .. } = self;
        let on = On { level: *level, shape, factor: *factor, workers };
        let mut found = match &mut self.own {
            OwnLaw::NeoHooke(own) => own.evaluate(&on, shares, displacement_m, force_n),
            OwnLaw::Stable(own) => own.evaluate(&on, shares, displacement_m, force_n),
            OwnLaw::General(own) => own.evaluate(&on, shares, displacement_m, force_n),
        };
        self.has_inverted = found.has_inverted;
        for s in 0..self.strays.len() {
            let t = self.strays[s].live as usize;
            let f = DMat3::IDENTITY + self.gradient(t, displacement_m);
            self.strays[s].f = f;
            let law = self.stand_in(t);
            let added = self.added_pa(t);
            let turned = f * added;
            let stress = law.first_piola_pa(&f) * self.factor + turned;
            let turned_energy = 0.5 * (trace_of_product(&turned, &f) - trace(&added));
            let volume_m3 = self.tetrahedron(t).2;
            found.energy_j += volume_m3 * (self.factor * law.energy_density_j_per_m3(&f) + turned_energy);
            self.add_forces(t, &stress, force_n);
        }
        found
    }

    /// Whether the last evaluation found a tetrahedron inside out that its law may not bring back.
    pub(super) fn needs_stand_in(&self) -> bool {
        let OwnLaw::General(own) = &self.own else { return false };
        self.has_inverted && !self.tets.is_empty() && !own.law(0).returns_from_inversion()
    }

    /// Overwrites `force_n` with K d, K being the tangent of the last evaluation.
    pub(super) fn tangent_product(
        &mut self,
        workers: &dyn Workers,
        direction_m: &[DVec3],
        force_n: &mut [DVec3],
    ) {
        let Self { level, shape, factor, shares, .. } = self;
        let on = On { level: *level, shape, factor: *factor, workers };
        match &mut self.own {
            OwnLaw::NeoHooke(own) => own.tangent_product(&on, shares, direction_m, force_n),
            OwnLaw::Stable(own) => own.tangent_product(&on, shares, direction_m, force_n),
            OwnLaw::General(own) => own.tangent_product(&on, shares, direction_m, force_n),
        }
        for stray in self.strays.iter() {
            let t = stray.live as usize;
            let df = self.gradient(t, direction_m);
            let law = self.stand_in(t);
            let dp = law.first_piola_differential_pa(&stray.f, &df) * self.factor + df * self.added_pa(t);
            self.add_forces(t, &dp, force_n);
        }
    }

    /// Finds the tetrahedra in which the law has no energy and, when the body is recovering already, those far from rest. They
    /// and their neighbours follow the stand-in law until the next call. Returns their number and the first tetrahedron in
    /// trouble.
    pub(super) fn quarantine(&mut self, displacement_m: &[DVec3], before: Recovery) -> (u32, Option<TetId>) {
        self.strays.clear();
        for group in &mut self.shape.groups {
            group.left_out = 0;
        }
        let (mut n_bad, mut first_bad, mut first_invalid) = (0, None, None);
        for t in 0..self.tets.len() {
            let f = DMat3::IDENTITY + self.gradient(t, displacement_m);
            let (is_valid, bars) = match &self.own {
                OwnLaw::NeoHooke(own) => (own.is_valid_at(&f), true),
                OwnLaw::Stable(own) => (own.is_valid_at(t, &f), false),
                OwnLaw::General(own) => (own.is_valid_at(t, &f), !own.is_valid_at(t, &MIRROR)),
            };
            self.is_bad[t] = !is_valid || (bars && is_far_from_rest(&f));
            if self.is_bad[t] {
                n_bad += 1;
                first_bad = first_bad.or(Some(self.tets[t]));
            }
            if !is_valid {
                first_invalid = first_invalid.or(Some(self.tets[t]));
            }
        }
        if n_bad == 0 || (first_invalid.is_none() && before == Recovery::None) {
            return (0, None);
        }
        self.meets_bad.fill(before == Recovery::Whole || n_bad * TANGLE > self.tets.len());
        for t in 0..self.tets.len() {
            if self.is_bad[t] {
                for node in self.tetrahedron(t).0 {
                    self.meets_bad[node.index()] = true;
                }
            }
        }
        for t in 0..self.tets.len() {
            if self.tetrahedron(t).0.iter().any(|n| self.meets_bad[n.index()]) {
                self.strays.push(Stray { live: t as u32, f: DMat3::IDENTITY });
                // Lanes beyond the end repeat the last tetrahedron.
                let lanes = if t + 1 == self.tets.len() { 0xff << (t % LANES) } else { 1 << (t % LANES) };
                self.shape.groups[t / LANES].left_out |= lanes as u8;
            }
        }
        (self.strays.len() as u32, first_invalid.or(first_bad))
    }

    /// Which tetrahedra follow the stand-in law.
    pub(super) fn recovery(&self) -> Recovery {
        if self.strays.is_empty() {
            Recovery::None
        } else if self.strays.len() == self.tets.len() {
            Recovery::Whole
        } else {
            Recovery::Around
        }
    }

    /// Overwrites one flag per live tetrahedron: whether it follows the stand-in law.
    pub(super) fn strays_into(&self, follows_stand_in: &mut [bool]) {
        follows_stand_in.fill(false);
        for stray in self.strays.iter() {
            follows_stand_in[stray.live as usize] = true;
        }
    }

    /// Elastic second Piola-Kirchhoff stress [Pa], F^-1 P, of live tetrahedron number `t` at the displacements of
    /// the last evaluation; none in quarantine.
    pub(super) fn second_piola_pa(&self, t: usize, displacement_m: &[DVec3]) -> Option<DMat3> {
        let group = &self.shape.groups[t / LANES];
        if !group.has_stress(t % LANES) {
            return None;
        }
        let f = DMat3::IDENTITY + self.gradient(t, displacement_m);
        let stress_pa = match &self.own {
            OwnLaw::NeoHooke(own) => own.second_piola_pa(t, group, self.factor, &f),
            OwnLaw::Stable(own) => f.inverse() * own.law(t).first_piola_pa(&f),
            OwnLaw::General(own) => f.inverse() * own.law(t).first_piola_pa(&f),
        };
        // The result must be symmetric to the bit.
        Some(symmetric(&components(&stress_pa))).filter(DMat3::is_finite)
    }

    /// Stiffness without negative eigenvalues of live tetrahedron number `t` at F, times its volume; the elastic
    /// part times `per_elastic`, that of the stress at rest times `per_rest`.
    pub(super) fn projected_stiffness(
        &self,
        t: usize,
        f: DMat3,
        follows_stand_in: bool,
        [per_elastic, per_rest]: [f64; 2],
    ) -> TetStiffness {
        let (_, alpha, volume_m3) = self.tetrahedron(t);
        let mut stiffness = match &self.own {
            _ if follows_stand_in => {
                stiffness_of(&self.stand_in(t).projected_tangent_pa(&f), alpha, per_elastic * volume_m3)
            }
            OwnLaw::NeoHooke(own) => own.projected_stiffness(t, f, alpha, per_elastic * volume_m3),
            OwnLaw::Stable(own) => own.projected_stiffness(t, f, alpha, per_elastic * volume_m3),
            OwnLaw::General(own) => {
                stiffness_of(&own.law(t).projected_tangent_pa(&f), alpha, per_elastic * volume_m3)
            }
        };
        if let Some(rest_pa) = self.tensile_rest_pa.get(t) {
            let all = [-(alpha[0] + alpha[1] + alpha[2]), alpha[0], alpha[1], alpha[2]];
            let scalar = |j: usize, k: usize| {
                DMat3::from_diagonal(DVec3::splat(all[j].dot(*rest_pa * all[k]) * per_rest * volume_m3))
            };
            for j in 0..4 {
                stiffness.vertex[j] += scalar(j, j);
            }
            for (edge, [j, k]) in stiffness.edge.iter_mut().zip(crate::solve::LOCAL_EDGES) {
                *edge += scalar(j, k);
            }
        }
        stiffness
    }

    /// Work of [`Elements::projected_stiffness`] [ns], see [`crate::solve::Factorization::work_ns`].
    pub(super) fn projection_work_ns(&self) -> u64 {
        match &self.own {
            OwnLaw::NeoHooke(_) | OwnLaw::Stable(_) => 1_000,
            OwnLaw::General(_) => 1_500,
        }
    }

    fn stand_in(&self, t: usize) -> &StableNeoHooke {
        &self.stand_ins[if self.stand_ins.len() == 1 { 0 } else { t }]
    }

    fn added_pa(&self, t: usize) -> DMat3 {
        let lanes = self.shape.added_pa.get(t / LANES);
        lanes.map_or(DMat3::ZERO, |lanes| symmetric(&std::array::from_fn(|k| lanes[k][t % LANES])))
    }

    fn add_forces(&self, t: usize, stress_pa: &DMat3, force_n: &mut [DVec3]) {
        let (nodes, alpha, volume_m3) = self.tetrahedron(t);
        for k in 0..3 {
            let share_n = *stress_pa * alpha[k] * volume_m3;
            force_n[nodes[k + 1].index()] += share_n;
            force_n[nodes[0].index()] -= share_n;
        }
    }
}

fn is_far_from_rest(f: &DMat3) -> bool {
    f.determinant() < RETURN_RATIO || trace_of_product(f, f) > RETURN_SQUARES
}

/// Matrix of xx, yy, zz, xy, xz, yz.
fn symmetric(s: &RestStress) -> DMat3 {
    DMat3::from_cols_array_2d(&SYMMETRIC.map(|row| row.map(|k| s[k])))
}

/// xx, yy, zz, xy, xz, yz of the symmetric part.
pub(super) fn components(m: &DMat3) -> RestStress {
    let mean = |r: usize, c: usize| 0.5 * (m.col(c)[r] + m.col(r)[c]);
    [mean(0, 0), mean(1, 1), mean(2, 2), mean(0, 1), mean(0, 2), mean(1, 2)]
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

/// a : b
fn trace_of_product(a: &DMat3, b: &DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

#[cfg(test)]
#[path = "elements_tests.rs"]
mod tests;
