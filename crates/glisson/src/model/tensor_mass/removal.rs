//! Cutting by removal: the tetrahedron's tensors and masses are subtracted where they were added.

use super::{TensorMass, TopologyRefusal, edge_starts, padded_columns};
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId};
use crate::solve::{LOCAL_EDGES, P1Gradients};

impl TensorMass {
    /// Follows removals, which allocate nothing, and compactions, which do.
    pub(super) fn follow(&mut self, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        if !(change.tets.added.ids().is_empty()
            && change.nodes.added.ids().is_empty()
            && change.moved_nodes.is_empty())
        {
            return Err(TopologyRefusal::Frozen {
                model: "tensor_mass",
                reason: "it follows removals of tetrahedra and compactions; build it anew on a mesh with new or moved \
                         nodes",
            });
        }
        assert_eq!(change.tets.n_before, self.tet_nodes.len(), "the model missed a change of the mesh");
        assert_eq!(change.nodes.n_before, self.rest_m.len(), "the model missed a change of the mesh");
        for &tet in &change.tets.removed {
            if self.tet_is_live[tet.index()] {
                self.remove_tet(tet);
            }
        }
        if !change.nodes.new_ids.is_empty() || !change.tets.new_ids.is_empty() {
            self.compact(change);
        }
        Ok(())
    }

    /// Drops dead entities; the order of the others stays. Constraints are dropped with their node numbers.
    fn compact(&mut self, change: &TopologyChange) {
        let stays: Vec<bool> = change.nodes.new_ids.iter().map(Option::is_some).collect();
        let new_node = |n: NodeId| change.nodes.new_ids[n.index()].expect("what is live has live nodes");
        let h_s = self.last_step_s();
        let n_before = self.rest_m.len();
        let mut motion: Vec<_> = self.motion[..2 * n_before].to_vec();
        let stays_twice: Vec<bool> = stays.iter().chain(&stays).copied().collect();
        keep(&mut motion, &stays_twice);
        motion.push([0.0; 4]);
        self.motion = motion;
        keep(&mut self.rest_m, &stays);
        keep(&mut self.is_fixed, &stays);
        keep(&mut self.vertex_tensor, &stays);
        keep(&mut self.vertex_tets, &stays);
        keep(&mut self.mass_kg, &stays);
        keep(&mut self.inverse_mass_per_kg, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        keep(&mut self.force_n, &stays);
        self.set_last_step_s(h_s);

        let live_edges: Vec<bool> = self.edge_tets.iter().map(|&n| n > 0).collect();
        let mut n_edges = 0;
        let new_edge: Vec<u32> = live_edges
            .iter()
            .map(|&live| {
                n_edges += u32::from(live);
                n_edges.wrapping_sub(1)
            })
            .collect();
        keep(&mut self.edges.nodes, &live_edges);
        keep(&mut self.edge_tensor, &live_edges);
        keep(&mut self.edge_tets, &live_edges);
        for nodes in &mut self.edges.nodes {
            *nodes = nodes.map(new_node);
        }
        self.edge_start = edge_starts(&self.edges, self.rest_m.len());
        let live_tets = std::mem::take(&mut self.tet_is_live);
        keep(&mut self.tet_nodes, &live_tets);
        keep(&mut self.edges.of_tet, &live_tets);
        for nodes in &mut self.tet_nodes {
            *nodes = nodes.map(new_node);
        }
        for edge in self.edges.of_tet.iter_mut().flatten() {
            *edge = new_edge[*edge as usize];
        }
        self.tet_is_live = vec![true; self.tet_nodes.len()];
        self.held.clear();
        self.outer_forces.clear();
        self.constraint_forces_n.clear();
    }

    /// Takes one live tetrahedron out. What is left without a tetrahedron becomes exactly zero; a node left
    /// alone stays where it is.
    pub(super) fn remove_tet(&mut self, tet: TetId) {
        let t = tet.index();
        self.tet_is_live[t] = false;
        self.is_cut = true;
        let nodes = self.tet_nodes[t];
        // The rest positions are those of the build, so these are the numbers that were added then.
        let gradients = P1Gradients::new(nodes.map(|n| self.rest_m[n.index()]));
        let stiffness = gradients.stiffness(self.material.lambda_pa(), self.material.mu_pa());
        let share_kg = self.material.density_kg_per_m3() * gradients.volume_m3 / 4.0;
        let n_nodes = self.rest_m.len();
        for (corner, node) in nodes.into_iter().enumerate() {
            let n = node.index();
            self.vertex_tets[n] -= 1;
            if self.vertex_tets[n] == 0 {
                self.vertex_tensor[n] = [[0.0; 4]; 3];
                self.mass_kg[n] = 0.0;
                self.motion[n_nodes + n] = self.motion[n];
            } else {
                subtract(&mut self.vertex_tensor[n], padded_columns(stiffness.vertex[corner]));
                self.mass_kg[n] -= share_kg;
            }
            self.update_inverse_mass(n);
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            let edge = self.edges.of_tet[t][e] as usize;
            self.edge_tets[edge] -= 1;
            if self.edge_tets[edge] == 0 {
                self.edge_tensor[edge] = [[0.0; 4]; 3];
            } else {
                let b = stiffness.edge[e];
                let along = if nodes[j] < nodes[k] { b } else { b.transpose() };
                subtract(&mut self.edge_tensor[edge], padded_columns(along));
            }
        }
        // A held node that lost its last tetrahedron has nothing to pull on.
        let inverse_mass_per_kg = &self.inverse_mass_per_kg;
        self.held.retain(|held| inverse_mass_per_kg[held.node as usize] > 0.0);
        self.outer_forces.retain(|(node, _)| inverse_mass_per_kg[*node as usize] > 0.0);
    }
}

fn keep<T>(values: &mut Vec<T>, stays: &[bool]) {
    let mut flags = stays.iter();
    values.retain(|_| *flags.next().expect("one flag a value"));
}

fn subtract(from: &mut [[f64; 4]; 3], what: [[f64; 4]; 3]) {
    for (from, what) in from.as_flattened_mut().iter_mut().zip(what.as_flattened()) {
        *from -= what;
    }
}
