//! The local model of a patch of pre-computed and dynamic nodes, for a haptic loop.
//!
//! Let T be the static compliance of the patch's pre-computed nodes while the dynamic nodes are held, H^T how they
//! follow the patch's dynamic nodes on the frontier, and C_d the compliance of the patch's dynamic nodes over the
//! period:
//!
//! C = [T 0; 0 0] + [H^T; 1] C_d [H 1],
//!
//! C is symmetric, and positive because T and C_d are.

use super::dynamic::DynamicPart;
use super::interface::Interface;
use super::step::{columns_of, compliance};
use super::zone::PrecomputedZone;
use super::{CondensedHybrid, Place};
use crate::material::LinearElastic;
use crate::model::explicit::Mover;
use crate::model::local_model::{
    ElementStiffness, LocalBody, LocalElements, LocalFrame, TangentLaw, compute, tet_tangent,
};
use crate::model::{LocalModel, LocalWork, RestStress};
use crate::solve::P1Gradients;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId};

/// The dynamic zones and the tetrahedra around them.
struct DynamicTissue<'a> {
    part: &'a DynamicPart,
    material: &'a LinearElastic,
    /// One per tetrahedron of the mesh, or none.
    rest_stress_pa: &'a [RestStress],
}

impl LocalBody for DynamicTissue<'_> {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Tets(&self.part.mesh().tetrahedra)
    }

    fn is_live(&self, element: usize) -> bool {
        self.part.is_live(element)
    }

    fn stiffness(&self, element: usize, _: f64) -> ElementStiffness {
        let mesh = self.part.mesh();
        let gradients = P1Gradients::in_mesh(mesh, TetId::from_index(element));
        if let Some(law) = self.part.kirchhoff_law(element) {
            let u_m = mesh.tetrahedra[element].map(|n| self.part.displacement_m(n.index()));
            let rest_stress_pa = self.rest_stress_pa.get(self.part.tet_of_mesh(element));
            return tet_tangent(&gradients, u_m, &TangentLaw::Kirchhoff(law), rest_stress_pa);
        }
        let law = TangentLaw::Linear { lambda_pa: self.material.lambda_pa(), mu_pa: self.material.mu_pa() };
        tet_tangent(&gradients, [DVec3::ZERO; 4], &law, None)
    }

    fn frame(&self) -> &dyn LocalFrame {
        self.part.motion.frame()
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.part.motion.state().velocities_m_per_s[n]
    }
}

/// What the compliance of a patch is computed from.
struct Patch<'a> {
    interface: &'a Interface,
    zones: &'a [PrecomputedZone],
    dynamic: Option<&'a DynamicPart>,
    place: &'a [Place],
    /// The local model of the patch's dynamic nodes, in the dynamic part's numbering.
    local: &'a LocalModel,
}

impl Patch<'_> {
    /// What a node belongs to; nodes of pre-computed zones without columns belong to nothing.
    fn place_of(&self, node: NodeId) -> Place {
        match self.place[node.index()] {
            Place::Own { zone, own } if own as usize >= self.zones[zone as usize].n_loadable => {
                Place::Nowhere
            }
            place => place,
        }
    }

    /// H^T: how a node of the patch follows one of the local model's.
    fn follows(&self, of: Place, l: usize) -> DMat3 {
        match of {
            Place::Dynamic(n) if NodeId(n) == self.local.nodes[l] => DMat3::IDENTITY,
            Place::Dynamic(_) | Place::Nowhere => DMat3::ZERO,
            of => {
                let n_p = 3 * self.interface.n_condensed;
                let at = self.dynamic.and_then(|part| part.frontier_place(self.local.nodes[l]));
                let (columns, first) = columns_of(self.interface, of);
                at.map_or(DMat3::ZERO, |at| {
                    let pull = |d: usize| {
                        DVec3::from_slice(&columns.column(first + d)[n_p + 3 * at..n_p + 3 * at + 3])
                    };
                    // The columns are the force on the dynamic node; the transpose is the displacement that follows it.
                    DMat3::from_cols(pull(0), pull(1), pull(2)).transpose()
                })
            }
        }
    }

    /// Overwrites `half` with C_d [H 1] of a node.
    fn half_into(&self, by: Place, half: &mut [DMat3]) {
        half.fill(DMat3::ZERO);
        for k in 0..half.len() {
            let pull = self.follows(by, k).transpose();
            if pull != DMat3::ZERO {
                for (l, half) in half.iter_mut().enumerate() {
                    *half += self.local.tensor_m_per_n(l, k) * pull;
                }
            }
        }
    }

    /// Fills the compliance and the drift of the patch's nodes. `row`: scratch for a row over p.
    fn fill_compliance(&self, row: &mut [f64], out: &mut LocalModel) {
        let mut half = [DMat3::ZERO; LocalModel::MOST_NODES];
        let half = &mut half[..self.local.nodes.len()];
        for j in 0..out.nodes.len() {
            let by = self.place_of(out.nodes[j]);
            let drifts_m = self.local.drift_m.iter().enumerate();
            out.drift_m[j] = drifts_m.map(|(l, drift_m)| self.follows(by, l) * *drift_m).sum();
            self.half_into(by, half);
            for i in 0..out.nodes.len() {
                let of = self.place_of(out.nodes[i]);
                let mut tensor = DMat3::ZERO;
                if is_static(of) && is_static(by) {
                    tensor = compliance(self.interface, self.zones, row, of, by);
                }
                for (l, half) in half.iter().enumerate() {
                    tensor += self.follows(of, l) * *half;
                }
                out.set_tensor(i, j, tensor);
            }
        }
    }
}

/// Whether the node responds statically.
fn is_static(place: Place) -> bool {
    matches!(place, Place::Own { .. } | Place::Condensed(_))
}

impl CondensedHybrid {
    pub(super) fn fill_local_model(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        out.start(patch, period_s, &self.positions_m);
        self.fill_dynamic_local_model(&out.nodes, period_s, work);
        let Self { interface, zones, row, local, dynamic, place, loads, held, .. } = self;
        let patch = Patch { interface, zones, dynamic: dynamic.as_ref(), place, local };
        out.n_rings = local.n_rings;
        out.is_inertial = local.is_inertial;
        out.missed_tolerance = local.missed_tolerance;
        let holds_frontier = interface.nodes.len() > interface.n_condensed;
        if holds_frontier && out.n_rings.is_none() && out.nodes.iter().any(|n| is_static(patch.place_of(*n)))
        {
            out.n_rings = Some(0);
        }
        for j in 0..out.nodes.len() {
            out.force_n[j] = match patch.place_of(out.nodes[j]) {
                Place::Dynamic(n) => {
                    let at = local.nodes.iter().position(|l| *l == NodeId(n));
                    out.mass_kg[j] = at.map_or(0.0, |at| local.mass_kg[at]);
                    out.changed_n[j] = at.and_then(|at| local.changed_n[at]);
                    at.map_or(DVec3::ZERO, |at| local.force_n[at])
                }
                by => {
                    let of_loads = loads.iter().filter(|load| load.place == by).map(|load| load.force_n);
                    let of_tools = held.iter().filter(|held| held.place == by).map(|held| held.force_n);
                    of_loads.chain(of_tools).sum()
                }
            };
        }
        patch.fill_compliance(row, out);
        out.symmetrize();
    }

    /// Fills the local model of the dynamic nodes of a patch, in the dynamic part's numbering.
    fn fill_dynamic_local_model(&mut self, patch: &[NodeId], period_s: f64, work: &mut LocalWork) {
        let Self { local, dynamic, place, material, rest_stress_pa, .. } = self;
        local.start(&[], period_s, &[]);
        let Some(part) = dynamic else { return };
        let mut locals = [NodeId(0); LocalModel::MOST_NODES];
        let mut n_locals = 0;
        for node in patch {
            if let Place::Dynamic(l) = place[node.index()] {
                locals[n_locals] = NodeId(l);
                n_locals += 1;
            }
        }
        local.start(&locals[..n_locals], period_s, &part.mesh().positions_m);
        compute(&DynamicTissue { part, material, rest_stress_pa }, work, local);
    }
}
