//! The local model of a touched patch, for a haptic loop: the tangent of the reduced equilibrium.

use super::Reduced;
use super::dense::dot;
use crate::model::LocalModel;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;

/// There is room for a patch's components in Newton's method.
const _: () = assert!(LocalModel::MOST_NODES <= Reduced::MAX_IMPOSED);

impl Reduced {
    pub(super) fn fill_local_model(&mut self, patch: &[NodeId], period_s: f64, out: &mut LocalModel) {
        out.start(patch, period_s, &self.positions_m);
        let Self { constants, newton, forces, imposed, constraint_forces_n, .. } = self;
        let (n, r, s) = (out.nodes.len(), newton.q.len(), constants.rows.len());
        let nodes = &out.nodes;
        let half = newton.half_solve(&constants.forces, 3 * n, |component, column| {
            match constants.loadable_index(nodes[component / 3]) {
                Some(loaded) => {
                    let modes = constants.modes_at(loaded, component % 3);
                    column.iter_mut().zip(modes).for_each(|(to, v)| *to = v);
                }
                None => column.fill(0.0),
            }
        });
        let half_of = |component: usize| &half[r * component..r * (component + 1)];
        for j in 0..n {
            let Some(by) = constants.loadable_index(out.nodes[j]) else { continue };
            let of_forces = forces.iter().filter(|(loaded, _)| *loaded == by).map(|(_, force_n)| *force_n);
            let of_tools = imposed.iter().filter(|(_, loaded, _)| *loaded == by);
            let of_tools =
                of_tools.filter_map(|(place, ..)| constraint_forces_n.get(*place as usize).copied());
            out.force_n[j] = of_forces.chain(of_tools).sum();
            let remainder = constants.remainder(by);
            for i in 0..n {
                let Some(of) = constants.loadable_index(out.nodes[i]) else { continue };
                let column = |d: usize| {
                    let entry = |a: usize| {
                        let of_modes = dot(half_of(3 * i + a), half_of(3 * j + d));
                        of_modes + remainder[(3 * d + a) * s + of as usize]
                    };
                    DVec3::new(entry(0), entry(1), entry(2))
                };
                out.set_tensor(i, j, DMat3::from_cols(column(0), column(1), column(2)));
            }
        }
        out.symmetrize();
    }
}
