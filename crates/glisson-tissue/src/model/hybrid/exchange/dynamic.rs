//! All tensor-mass zones as one body: neighbours among them are merged (seed `003` s. 4.3.2.1).
//!
//! Their nodes move by central differences (eq. 3.3) with lumped masses and damping of the mass; the nodes around
//! them, which belong to pre-computed zones, do not move during a sweep.
//!
//! The tensors are linear. The forces by which they exceed those of non-linear (St Venant-Kirchhoff) tetrahedra are
//! added as loads, on the nodes that move here and on the frontier nodes of pre-computed zones.

use super::ExchangeCount;
use super::zone::{Lists, Shared};
use crate::model::hybrid::kirchhoff::KirchhoffTet;
use crate::model::tet_law::TetLaw;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId};

/// Most nodes of the tensor-mass zones whose displacement can be imposed at once.
const MAX_IMPOSED: usize = 1024;

#[derive(Clone, Copy, Debug)]
pub(super) struct Imposed {
    place: u32,
    moving: u32,
    target_m: DVec3,
    start_m: DVec3,
    reaction_n: DVec3,
}

/// How a step is divided.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parts {
    /// Step [s].
    pub(super) h_s: f64,
    /// Parts to advance now.
    pub(super) n_now: u64,
    /// Parts of the whole step that are done; imposed displacements are reached over the whole step.
    pub(super) n_gone: u64,
    /// Parts of the whole step.
    pub(super) n_all: u64,
}

/// Damping, and relaxation of the interface.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rates {
    /// d of C = d M [1/s].
    pub(super) damping_per_s: f64,
    /// Share of the interface's change that is taken over in one sweep.
    pub(super) relaxation: f64,
}

#[derive(Debug, Default)]
pub(super) struct DynamicZones {
    /// Nodes that move, ascending.
    pub(super) nodes: Vec<NodeId>,
    /// Whether each node is in no pre-computed zone.
    pub(super) is_owner: Vec<bool>,
    pub(super) mass_kg: Vec<f64>,
    /// B^pj of each moving node p and all nodes j that are not fixed, itself first.
    pub(super) rows: Lists<(u32, DMat3)>,
    /// Nodes of pre-computed zones next to the moving ones.
    pub(super) interface: Vec<NodeId>,
    /// Live tetrahedra of non-linear zones, ascending, and their law.
    pub(super) kirchhoff: Vec<(TetId, [NodeId; 4], KirchhoffTet)>,
    pub(super) law: Option<TetLaw>,
    /// Inverted tetrahedra in the last part.
    pub(super) n_inverted: u32,
    pub(super) first_inverted: Option<TetId>,
    /// Largest stable step [s].
    pub(super) stable_step_s: f64,
    pub(super) rates: Rates,
    pub(super) outer_n: Vec<DVec3>,
    pub(super) imposed: Vec<Imposed>,
    pub(super) force_n: Vec<DVec3>,
    pub(super) count: ExchangeCount,
}

impl Clone for DynamicZones {
    fn clone(&self) -> Self {
        let mut copy = Self {
            nodes: self.nodes.clone(),
            is_owner: self.is_owner.clone(),
            mass_kg: self.mass_kg.clone(),
            rows: self.rows.clone(),
            interface: self.interface.clone(),
            kirchhoff: self.kirchhoff.clone(),
            outer_n: self.outer_n.clone(),
            imposed: Vec::with_capacity(MAX_IMPOSED),
            force_n: self.force_n.clone(),
            ..*self
        };
        copy.imposed.extend_from_slice(&self.imposed);
        copy
    }
}

impl DynamicZones {
    /// Reserves capacity for the constraints and forces of the nodes.
    pub(super) fn make_room(&mut self) {
        self.outer_n = vec![DVec3::ZERO; self.nodes.len()];
        self.force_n = vec![DVec3::ZERO; self.nodes.len()];
        self.imposed = Vec::with_capacity(MAX_IMPOSED);
    }

    pub(super) fn moving_of(&self, node: NodeId) -> Option<u32> {
        self.nodes.binary_search(&node).ok().map(|i| i as u32)
    }

    pub(super) fn clear_constraints(&mut self) {
        self.outer_n.fill(DVec3::ZERO);
        self.imposed.clear();
    }

    pub(super) fn add_outer_force(&mut self, moving: u32, force_n: DVec3) {
        self.outer_n[moving as usize] += force_n;
    }

    /// Whether there was room.
    pub(super) fn impose(&mut self, place: u32, moving: u32, target_m: DVec3) -> bool {
        let has_room = self.imposed.len() < MAX_IMPOSED;
        if has_room {
            let zero = DVec3::ZERO;
            self.imposed.push(Imposed { place, moving, target_m, start_m: zero, reaction_n: zero });
        }
        has_room
    }

    /// Place among the constraints and force [N] of each imposed displacement, at the last part.
    pub(super) fn reactions_n(&self) -> impl Iterator<Item = (u32, DVec3)> + '_ {
        self.imposed.iter().map(|imposed| (imposed.place, imposed.reaction_n))
    }

    /// Number of parts that a sweep of `dt_s` needs.
    pub(super) fn parts_of(&self, dt_s: f64) -> u64 {
        if self.nodes.is_empty() && self.kirchhoff.is_empty() {
            return 0;
        }
        // The factor is the safety margin of the explicit models' own steps.
        (dt_s / (0.999 * self.stable_step_s)).ceil().clamp(1.0, 1e6) as u64
    }

    /// Moves the held nodes to their positions after a share of the step.
    fn hold(&self, share: f64, view_m: &mut [DVec3]) {
        for imposed in &self.imposed {
            view_m[self.nodes[imposed.moving as usize].index()] =
                if share == 1.0 { imposed.target_m } else { imposed.start_m.lerp(imposed.target_m, share) };
        }
    }

    /// Overwrites the force by which linear elasticity exceeds the non-linear one at each node of a non-linear zone.
    fn find_surplus(&mut self, view_m: &[DVec3], surplus_n: &mut [DVec3]) {
        let Some(law) = &self.law else { return };
        (self.n_inverted, self.first_inverted) = (0, None);
        for (_, nodes, _) in &self.kirchhoff {
            nodes.iter().for_each(|n| surplus_n[n.index()] = DVec3::ZERO);
        }
        for (t, nodes, tet) in &self.kirchhoff {
            let (f, is_inverted) = tet.linear_surplus_n(law, nodes.map(|n| view_m[n.index()]));
            nodes.iter().zip(f).for_each(|(n, f)| surplus_n[n.index()] += f);
            if is_inverted {
                self.n_inverted += 1;
                self.first_inverted = self.first_inverted.or(Some(*t));
            }
        }
    }

    /// Updates the interface nodes and advances by `parts`.
    pub(super) fn advance(&mut self, shared: &mut Shared, velocity_m_per_s: &mut [DVec3], parts: Parts) {
        let Shared { displacement_m, dynamic_view_m: view_m, surplus_n, pull_m_per_s2, .. } = shared;
        for node in &self.interface {
            let n = node.index();
            // Exact for full relaxation, so that both views of a node are the same number.
            view_m[n] = if self.rates.relaxation == 1.0 {
                displacement_m[n]
            } else {
                view_m[n].lerp(displacement_m[n], self.rates.relaxation)
            };
        }
        if parts.n_gone == 0 {
            for imposed in &mut self.imposed {
                imposed.start_m = view_m[self.nodes[imposed.moving as usize].index()];
            }
        }
        let d = self.rates.damping_per_s;
        let (of_velocity, of_acceleration) = (1.0 / parts.h_s - 0.5 * d, 1.0 / (1.0 / parts.h_s + 0.5 * d));
        let duration_s = parts.n_all as f64 * parts.h_s;
        for part in 1..=parts.n_now {
            // Held nodes move first; the others respond to their new positions.
            let share = (parts.n_gone + part) as f64 / parts.n_all as f64;
            self.hold(share, view_m);
            self.find_surplus(view_m, surplus_n);
            for (i, force_n) in self.force_n.iter_mut().enumerate() {
                *force_n = self.outer_n[i] + *pull_m_per_s2 * self.mass_kg[i];
                for &(j, b) in self.rows.get(i) {
                    *force_n -= b * view_m[j as usize];
                }
                *force_n += surplus_n.get(self.nodes[i].index()).copied().unwrap_or(DVec3::ZERO);
            }
            for (i, node) in self.nodes.iter().enumerate() {
                let n = node.index();
                let a = self.force_n[i] / self.mass_kg[i];
                velocity_m_per_s[n] = (velocity_m_per_s[n] * of_velocity + a) * of_acceleration;
                view_m[n] += velocity_m_per_s[n] * parts.h_s;
            }
            self.hold(share, view_m);
            for imposed in &mut self.imposed {
                let i = imposed.moving as usize;
                imposed.reaction_n = -self.force_n[i];
                velocity_m_per_s[self.nodes[i].index()] = (imposed.target_m - imposed.start_m) / duration_s;
            }
            self.count.dynamic_products += self.rows.n_items() as u64;
        }
        self.find_surplus(view_m, surplus_n);
        for (node, _) in self.nodes.iter().zip(&self.is_owner).filter(|(_, is)| **is) {
            displacement_m[node.index()] = view_m[node.index()];
        }
    }
}
