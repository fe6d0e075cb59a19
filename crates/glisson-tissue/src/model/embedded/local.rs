//! Local models of the cut mesh, from those of the copies.

use super::Embedded;
use crate::model::{LocalModel, LocalWork};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;
use glisson_mesh::mesh::embedding::Tie;

impl Embedded {
    /// C = W C W^T. Nodes that one copy carries have no mass of their own: what the momentum of the copies does in the period is part
    /// of the drift, and [`LocalModel::mass_kg`] is zero.
    pub(super) fn carry_local_model(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        out.start(patch, period_s, &self.positions_m);
        self.patch.clear();
        let ties = self.embedding.ties();
        for node in &out.nodes {
            for (of, _) in ties[node.index()].iter() {
                if !self.patch.contains(&of) && self.patch.len() < LocalModel::MOST_NODES {
                    self.patch.push(of);
                }
            }
        }
        let is_same = self.patch.len() == out.nodes.len()
            && out.nodes.iter().all(|node| ties[node.index()].single().is_some());
        let Self { model, patch: copied, local, .. } = self;
        model.local_model_into(copied, period_s, work, local);
        out.n_rings = local.n_rings;
        out.is_inertial = local.is_inertial;
        out.missed_tolerance = local.missed_tolerance;
        if is_same {
            // Each node is one of the copies' own.
            out.force_n.copy_from_slice(&local.force_n);
            out.compliance_m_per_n.copy_from_slice(&local.compliance_m_per_n);
            out.mass_kg.copy_from_slice(&local.mass_kg);
            out.drift_m.copy_from_slice(&local.drift_m);
            out.changed_n.copy_from_slice(&local.changed_n);
            return;
        }
        if work.tells_drift() && period_s > 0.0 {
            self.add_momentum(period_s);
        }
        self.spread(out);
    }

    /// Adds to the drift what the change of momentum over the last step does in the next one.
    fn add_momentum(&mut self, period_s: f64) {
        let velocities_m_per_s = self.model.state().velocities_m_per_s;
        if velocities_m_per_s.is_empty() {
            return;
        }
        let local = &mut self.local;
        for j in 0..local.nodes.len() {
            let n = local.nodes[j].index();
            let change_m_per_s = velocities_m_per_s[n] - self.before_m_per_s[n];
            let force_n = change_m_per_s * (local.mass_kg[j] / period_s);
            for i in 0..local.nodes.len() {
                let move_m = local.tensor_m_per_n(i, j) * force_n;
                local.drift_m[i] += move_m;
            }
        }
    }

    fn spread(&mut self, out: &mut LocalModel) {
        let Self { embedding, carried, patch, local, columns, .. } = self;
        let ties = embedding.ties();
        let place = |node: NodeId| patch.iter().position(|known| *known == node);
        let known = |tie: &Tie| -> [(usize, f64); 4] {
            let mut places = [(0, 0.0); 4];
            for (slot, (node, weight)) in places.iter_mut().zip(tie.iter()) {
                *slot = place(node).map_or((0, 0.0), |at| (at, weight));
            }
            places
        };
        let (n, n_copied) = (out.nodes.len(), local.nodes.len());
        columns.clear();
        for node in &out.nodes {
            let parts = known(&ties[node.index()]);
            for i in 0..n_copied {
                let of_parts = parts.iter().filter(|(_, weight)| *weight != 0.0);
                columns.push(of_parts.map(|&(j, weight)| local.tensor_m_per_n(i, j) * weight).sum::<DMat3>());
            }
        }
        for i in 0..n {
            let node = out.nodes[i];
            let parts = known(&ties[node.index()]);
            let parts = parts.iter().filter(|(_, weight)| *weight != 0.0);
            for j in 0..n {
                let tensor = parts.clone().map(|&(k, weight)| columns[j * n_copied + k] * weight).sum();
                out.set_tensor(i, j, tensor);
            }
            out.drift_m[i] = parts.map(|&(k, weight)| local.drift_m[k] * weight).sum::<DVec3>();
            out.force_n[i] = carried.applied_n(node);
        }
    }
}
