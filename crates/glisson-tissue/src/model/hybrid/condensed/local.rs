//! What a patch of pre-computed and dynamic nodes does for a haptic loop.
//!
//! With T the static compliance of the patch's pre-computed nodes, the dynamic nodes held, H^T how they follow the
//! patch's nodes between the zones, and C_d the compliance of the patch's dynamic nodes over the period:
//!
//! C = [T 0; 0 0] + [H^T; 1] C_d [H 1],
//!
//! symmetric, and positive because T and C_d are.

use super::dynamic::DynamicPart;
use super::step::{columns_of, compliance};
use super::{CondensedHybrid, Place};
use crate::material::LinearElastic;
use crate::model::local_model::{
    ElementStiffness, LocalBody, LocalElements, LocalFrame, TangentLaw, compute, tet_tangent,
};
use crate::model::{LocalModel, LocalWork, RestStress};
use crate::solve::P1Gradients;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;

/// The dynamic zones and the tetrahedra around them.
struct DynamicTissue<'a> {
    part: &'a DynamicPart,
    material: &'a LinearElastic,
    /// One a tetrahedron of the mesh, or none.
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
        let gradients = P1Gradients::new(mesh.tetrahedra[element].map(|n| mesh.positions_m[n.index()]));
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
        let Self {
            interface, zones, row, local, dynamic, place, loads, held, material, rest_stress_pa, ..
        } = self;
        let place_of = |node: NodeId| match place[node.index()] {
            // Without columns.
            Place::Own { zone, own } if own as usize >= zones[zone as usize].n_loadable => Place::Nowhere,
            place => place,
        };
        let is_static = |place: Place| matches!(place, Place::Own { .. } | Place::Condensed(_));
        local.start(&[], period_s, &[]);
        if let Some(part) = dynamic {
            let mut locals = [NodeId(0); LocalModel::MOST_NODES];
            let mut n_locals = 0;
            for node in &out.nodes {
                if let Place::Dynamic(l) = place_of(*node) {
                    locals[n_locals] = NodeId(l);
                    n_locals += 1;
                }
            }
            local.start(&locals[..n_locals], period_s, &part.mesh().positions_m);
            compute(&DynamicTissue { part, material, rest_stress_pa }, work, local);
        }
        out.n_rings = local.n_rings;
        out.is_inertial = local.is_inertial;
        out.missed_tolerance = local.missed_tolerance;
        let holds_frontier = interface.nodes.len() > interface.n_condensed;
        if holds_frontier && out.n_rings.is_none() && out.nodes.iter().any(|n| is_static(place_of(*n))) {
            out.n_rings = Some(0);
        }

        let n_p = 3 * interface.n_condensed;
        // H^T: how a node of the patch follows one of the local model's.
        let follows = |of: Place, l: usize| -> DMat3 {
            match of {
                Place::Dynamic(n) if NodeId(n) == local.nodes[l] => DMat3::IDENTITY,
                Place::Dynamic(_) | Place::Nowhere => DMat3::ZERO,
                of => {
                    let at = dynamic.as_ref().and_then(|part| part.frontier_place(local.nodes[l]));
                    let (columns, first) = columns_of(interface, of);
                    at.map_or(DMat3::ZERO, |at| {
                        let pull = |d: usize| {
                            DVec3::from_slice(&columns.column(first + d)[n_p + 3 * at..n_p + 3 * at + 3])
                        };
                        // The columns tell the force on the dynamic node: their transpose is the way.
                        DMat3::from_cols(pull(0), pull(1), pull(2)).transpose()
                    })
                }
            }
        };
        let mut half = [DMat3::ZERO; LocalModel::MOST_NODES];
        for j in 0..out.nodes.len() {
            let by = place_of(out.nodes[j]);
            out.force_n[j] = match by {
                Place::Dynamic(n) => {
                    let at = local.nodes.iter().position(|l| *l == NodeId(n));
                    at.map_or(DVec3::ZERO, |at| local.force_n[at])
                }
                by => {
                    let of_loads = loads.iter().filter(|load| load.place == by).map(|load| load.force_n);
                    let of_tools = held.iter().filter(|held| held.place == by).map(|held| held.force_n);
                    of_loads.chain(of_tools).sum()
                }
            };
            // C_d [H 1] of this node.
            half[..local.nodes.len()].fill(DMat3::ZERO);
            for k in 0..local.nodes.len() {
                let pull = follows(by, k).transpose();
                if pull != DMat3::ZERO {
                    for (l, half) in half.iter_mut().enumerate().take(local.nodes.len()) {
                        *half += local.tensor_m_per_n(l, k) * pull;
                    }
                }
            }
            for i in 0..out.nodes.len() {
                let of = place_of(out.nodes[i]);
                let mut tensor = DMat3::ZERO;
                if is_static(of) && is_static(by) {
                    tensor = compliance(interface, zones, row, of, by);
                }
                for (l, half) in half.iter().enumerate().take(local.nodes.len()) {
                    tensor += follows(of, l) * *half;
                }
                out.set_tensor(i, j, tensor);
            }
        }
        out.symmetrize();
    }
}
