//! The mechanics of a body: all stiffness numbers, how they are accumulated, evaluated and taken out again.

use super::adaptive::{Adaptivity, Bound, NonlinearPart, edge_bounds, tet_bound, triangle_bounds};
use super::forces::{Entities, Everywhere, NonlinearStiffness};
use super::incompressibility::VolumePenalty;
use super::numbers::{
    EdgeStiffness, LOCAL_TRIANGLES, MeshTriangles, Summed, TetScalars, TriangleStiffness, VertexStiffness,
    ascending,
};
use crate::material::{SQUEEZED_J, squeeze_guard_pa};
use crate::model::explicit::{LiveTets, Padded, Quarantine, keep, renumbered, unpadded};
use crate::model::tensor_mass::VertexEdgeTensors;
use crate::model::tet_law::{TetLaw, TetShape, stressed_stiffness};
use crate::model::topology_update::{TopologyUpdate, blend_tets};
use crate::solve::{LOCAL_EDGES, P1Gradients, RestStress, SolveError};
use glisson_mesh::math::{DMat3, DVec3, is_inverted, outer, tetrahedron_volume_m3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// What resists; changed by edits only.
#[derive(Clone, Debug)]
pub(super) struct Body {
    pub(super) volume_penalty_pa: f64,
    pub(super) rest_m: Vec<DVec3>,
    node_is_live: Vec<bool>,
    pub(super) tets: LiveTets,
    pub(super) laws: Vec<TetLaw>,
    /// One a tetrahedron, or none.
    pub(super) rest_stress_pa: Vec<RestStress>,
    /// Shape vectors and volumes at rest.
    pub(super) gradients: Vec<P1Gradients>,
    pub(super) linear: VertexEdgeTensors,
    pub(super) nonlinear: NonlinearStiffness,
    /// Bounds of the non-linear force at each node.
    pub(super) bounds: Vec<Bound>,
}

impl Body {
    /// Sums the numbers of all tetrahedra, in their order.
    ///
    /// # Errors
    /// [`SolveError`] for an unusable mesh.
    pub(super) fn accumulate(
        mesh: &TetMesh,
        laws: Vec<TetLaw>,
        volume_penalty_pa: f64,
        rest_stress_pa: &[RestStress],
    ) -> Result<Self, SolveError> {
        let linear = VertexEdgeTensors::accumulate(mesh, |tet, g| {
            stressed_stiffness(&laws[tet.index()], g, rest_stress_pa.get(tet.index()))
        })?;
        let (n_nodes, n_tets) = (mesh.positions_m.len(), mesh.tetrahedra.len());
        let triangles = MeshTriangles::of_mesh(mesh);
        let mut body = Self {
            volume_penalty_pa,
            rest_m: mesh.positions_m.clone(),
            node_is_live: vec![false; n_nodes],
            tets: LiveTets::of_mesh(mesh),
            laws,
            rest_stress_pa: rest_stress_pa.to_vec(),
            gradients: (0..n_tets)
                .map(|t| P1Gradients::of_tet(mesh, TetId::from_index(t)))
                .collect::<Result<_, _>>()?,
            nonlinear: NonlinearStiffness {
                vertex: vec![VertexStiffness::default(); n_nodes],
                edge: vec![EdgeStiffness::default(); linear.mesh_edges().nodes.len()],
                triangle: vec![TriangleStiffness::default(); triangles.nodes.len()],
                tet: vec![TetScalars::default(); n_tets],
                triangles,
            },
            linear,
            bounds: Vec::new(),
        };
        for t in 0..n_tets {
            body.add_nonlinear(t);
        }
        body.bounds = body.summed_bounds();
        Ok(body)
    }

    /// Adds the non-linear numbers of a tetrahedron; the bounds stay.
    fn add_nonlinear(&mut self, t: usize) {
        let shape = TetShape::new(self.laws[t], &self.gradients[t]);
        let nodes = self.tets.nodes[t];
        for (corner, node) in nodes.into_iter().enumerate() {
            self.node_is_live[node.index()] = true;
            self.nonlinear.vertex[node.index()].add(&shape.of_vertex(corner), 1.0);
        }
        for (local, edge) in LOCAL_EDGES.into_iter().zip(self.linear.mesh_edges().of_tet[t]) {
            self.nonlinear.edge[edge as usize].add(&shape.of_edge(ascending(local, &nodes)), 1.0);
        }
        for (local, triangle) in LOCAL_TRIANGLES.into_iter().zip(self.nonlinear.triangles.of_tet[t]) {
            let numbers = shape.of_triangle(ascending(local, &nodes));
            self.nonlinear.triangle[triangle as usize].add(&numbers, 1.0);
        }
        self.nonlinear.tet[t] = shape.of_tet();
    }

    /// Room for what an edit brings in; new and moved nodes are at their places afterwards, and the tetrahedra at them
    /// have their shapes.
    pub(super) fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        let n_before = self.rest_m.len();
        for node in change.moved_nodes.iter().filter(|node| node.index() < n_before) {
            self.rest_m[node.index()] = mesh.positions_m[node.index()];
        }
        self.rest_m.extend_from_slice(&mesh.positions_m[n_before..growth.n_nodes]);
        self.node_is_live.resize(growth.n_nodes, false);
        self.bounds.resize(growth.n_nodes, Bound::default());
        growth.take_over(&mut self.laws);
        blend_tets(&mut self.rest_stress_pa, change);
        let nothing = P1Gradients { alpha_per_m: [DVec3::ZERO; 4], volume_m3: 0.0 };
        self.gradients.resize(growth.n_tets, nothing);
        for tet in growth.attached() {
            self.gradients[tet.index()] = P1Gradients::in_mesh(mesh, tet);
        }
        let nonlinear = &mut self.nonlinear;
        nonlinear.vertex.resize(growth.n_nodes, VertexStiffness::default());
        nonlinear.tet.resize(growth.n_tets, TetScalars::default());
        self.linear.grow(&self.tets, growth).spread(&mut nonlinear.edge, EdgeStiffness::default());
        let insertions = nonlinear.triangles.grow(&self.tets, &growth.added);
        insertions.spread(&mut nonlinear.triangle, TriangleStiffness::default());
    }

    /// Adds a tetrahedron that is in no sum.
    pub(super) fn add_tet(&mut self, t: usize) {
        let nodes = self.tets.nodes[t];
        let stiffness = stressed_stiffness(&self.laws[t], &self.gradients[t], self.rest_stress_pa.get(t));
        self.linear.add_tet(t, nodes, &stiffness);
        for triangle in self.nonlinear.triangles.of_tet[t] {
            self.nonlinear.triangles.tets[triangle as usize] += 1;
        }
        self.exchange_bounds(t, -1.0);
        self.add_nonlinear(t);
        self.exchange_bounds(t, 1.0);
    }

    /// Adds the shares of a tetrahedron's edges, its triangles and itself to the bounds of their nodes.
    fn exchange_bounds(&mut self, t: usize, sign: f64) {
        let nodes = self.tets.nodes[t];
        let (nonlinear, bounds) = (&self.nonlinear, &mut self.bounds);
        let mut add = |node: NodeId, share: Bound| bounds[node.index()].add(share, sign);
        for (local, edge) in LOCAL_EDGES.into_iter().zip(self.linear.mesh_edges().of_tet[t]) {
            let shares = edge_bounds(&nonlinear.edge[edge as usize]);
            ascending(local, &nodes).into_iter().zip(shares).for_each(|(i, share)| add(nodes[i], share));
        }
        for (local, triangle) in LOCAL_TRIANGLES.into_iter().zip(nonlinear.triangles.of_tet[t]) {
            let shares = triangle_bounds(&nonlinear.triangle[triangle as usize]);
            ascending(local, &nodes).into_iter().zip(shares).for_each(|(i, share)| add(nodes[i], share));
        }
        nodes.into_iter().for_each(|node| add(node, tet_bound(&nonlinear.tet[t])));
    }

    fn summed_bounds(&self) -> Vec<Bound> {
        let mut bounds = vec![Bound::default(); self.rest_m.len()];
        let mut add = |n: NodeId, share: Bound| bounds[n.index()].add(share, 1.0);
        let (entities, nonlinear) = (self.entities(), &self.nonlinear);
        for (nodes, edge) in entities.edge_nodes.iter().zip(&nonlinear.edge) {
            nodes.iter().zip(edge_bounds(edge)).for_each(|(&n, share)| add(n, share));
        }
        for (nodes, triangle) in nonlinear.triangles.nodes.iter().zip(&nonlinear.triangle) {
            nodes.iter().zip(triangle_bounds(triangle)).for_each(|(&n, share)| add(n, share));
        }
        for (nodes, tet) in entities.tet_nodes.iter().zip(&nonlinear.tet) {
            nodes.iter().for_each(|&n| add(n, tet_bound(tet)));
        }
        bounds
    }

    pub(super) fn entities(&self) -> Entities<'_> {
        Entities { edge_nodes: &self.linear.mesh_edges().nodes, tet_nodes: &self.tets.nodes }
    }

    fn penalty(&self) -> Option<VolumePenalty<'_>> {
        (self.volume_penalty_pa > 0.0).then_some(VolumePenalty {
            gamma_pa: self.volume_penalty_pa,
            rest_m: &self.rest_m,
            gradients: &self.gradients,
            tets: &self.tets,
        })
    }

    /// Adds the forces that balance the displacements: the linear ones, then the non-linear part where it is
    /// wanted, then the penalty, which is never left out.
    pub(super) fn add_forces(&self, adaptivity: &mut Adaptivity, u: &[Padded], force: &mut [Padded]) {
        let entities = self.entities();
        self.linear.add_forces(u, force);
        let live_edges = entities.edge_nodes.iter().enumerate().filter(|(e, _)| self.linear.is_live_edge(*e));
        adaptivity.select(
            u,
            &self.node_is_live,
            &self.bounds,
            live_edges.map(|(_, nodes)| nodes.map(NodeId::index)),
        );
        if adaptivity.part == NonlinearPart::Everywhere {
            self.nonlinear.add_forces(&entities, &Everywhere, u, force);
        } else if adaptivity.report.n_nonlinear > 0 {
            self.nonlinear.add_forces(&entities, &adaptivity.is_nonlinear.as_slice(), u, force);
        }
        if let Some(penalty) = self.penalty() {
            penalty.add_forces(&entities, u, force);
        }
    }

    /// Volume of a tetrahedron at rest [m3], of which its material may be a share.
    pub(super) fn whole_m3(&self, t: usize) -> f64 {
        self.gradients[t].volume_m3 / self.tets.share(t)
    }

    /// Adds what keeps squeezed tetrahedra from being flat ([`squeeze_guard_pa`]), and counts the inverted ones: their law would rest
    /// in the mirror image.
    pub(super) fn guard_squeezed(&self, u: &[Padded], force: &mut [Padded]) -> Quarantine {
        let mut quarantine = Quarantine::default();
        for (t, nodes) in self.tets.iter() {
            let corners_m = nodes.map(|n| self.rest_m[n.index()] + unpadded(&u[n.index()]));
            let (volume_m3, gradients) = (tetrahedron_volume_m3(corners_m), &self.gradients[t]);
            if volume_m3 >= SQUEEZED_J * self.whole_m3(t) {
                continue;
            }
            if is_inverted(volume_m3) {
                quarantine.add(t);
            }
            let gradient = nodes
                .iter()
                .zip(gradients.alpha_per_m)
                .fold(DMat3::IDENTITY, |f, (n, alpha)| f + outer(unpadded(&u[n.index()]), alpha));
            let TetLaw { lambda_pa, mu_pa, .. } = self.laws[t];
            let guard_pa = squeeze_guard_pa(&gradient, lambda_pa, mu_pa).unwrap_or(DMat3::ZERO);
            for (node, alpha) in nodes.iter().zip(gradients.alpha_per_m) {
                let f = guard_pa * alpha * gradients.volume_m3;
                let at = &mut force[node.index()];
                at[0] += f.x;
                at[1] += f.y;
                at[2] += f.z;
            }
        }
        quarantine
    }

    /// Elastic energy of the body with every tetrahedron strained by 1 [J].
    pub(super) fn full_strain_energy_j(&self) -> f64 {
        let density = |law: &TetLaw| {
            0.5 * law.lambda_pa.abs() + law.mu_pa + law.kappa_pa.max(0.0) + self.volume_penalty_pa
        };
        self.laws.iter().zip(&self.gradients).map(|(law, g)| density(law) * g.volume_m3).sum()
    }

    /// Elastic energy [J] of the full model, the penalty's included, without what constant forces of the stress at
    /// rest add.
    pub(super) fn energy_j(&self, u: &[Padded]) -> f64 {
        let entities = self.entities();
        self.linear.energy_j(u, u)
            + self.nonlinear.energy_j(&entities, u)
            + self.penalty().map_or(0.0, |penalty| penalty.energy_j(&entities, u))
    }

    /// Takes one live tetrahedron out; `stays`: whether each of its nodes still has a tetrahedron. What is left
    /// without one becomes exactly zero. Allocates nothing.
    pub(super) fn remove_tet(&mut self, t: usize, stays: [bool; 4]) {
        let nodes = self.tets.nodes[t];
        // The numbers that were added in the beginning, to the last bit: same gradients, same law.
        let (law, gradients) = (self.laws[t], &self.gradients[t]);
        let shape = TetShape::new(law, gradients);
        let stiffness = stressed_stiffness(&law, gradients, self.rest_stress_pa.get(t));
        self.linear.subtract_tet(t, nodes, &stiffness, stays);
        let (nonlinear, bounds) = (&mut self.nonlinear, &mut self.bounds);
        for (corner, node) in nodes.into_iter().enumerate() {
            self.node_is_live[node.index()] = stays[corner];
            subtract(&mut nonlinear.vertex[node.index()], &shape.of_vertex(corner), stays[corner]);
        }
        for (local, edge) in LOCAL_EDGES.into_iter().zip(self.linear.mesh_edges().of_tet[t]) {
            let (local, edge) = (ascending(local, &nodes), edge as usize);
            let numbers = &mut nonlinear.edge[edge];
            let before = edge_bounds(numbers);
            subtract(numbers, &shape.of_edge(local), self.linear.is_live_edge(edge));
            let after = edge_bounds(numbers);
            exchange(bounds, local.map(|i| nodes[i]), before, after);
        }
        for (local, triangle) in LOCAL_TRIANGLES.into_iter().zip(nonlinear.triangles.of_tet[t]) {
            let (local, triangle) = (ascending(local, &nodes), triangle as usize);
            nonlinear.triangles.tets[triangle] -= 1;
            let numbers = &mut nonlinear.triangle[triangle];
            let before = triangle_bounds(numbers);
            subtract(numbers, &shape.of_triangle(local), nonlinear.triangles.tets[triangle] > 0);
            let after = triangle_bounds(numbers);
            exchange(bounds, local.map(|i| nodes[i]), before, after);
        }
        exchange(bounds, nodes, [tet_bound(&nonlinear.tet[t]); 4], [Bound::default(); 4]);
        nonlinear.tet[t] = TetScalars::default();
        for (node, stays) in nodes.into_iter().zip(stays) {
            if !stays {
                bounds[node.index()] = Bound::default();
            }
        }
    }

    /// Drops what is dead; the order of the rest stays.
    pub(super) fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        let new_node = |n: NodeId| new_ids[n.index()].expect("what is live has live nodes");
        let live_tets = &self.tets.is_live;
        keep(&mut self.rest_m, &stays);
        keep(&mut self.node_is_live, &stays);
        keep(&mut self.bounds, &stays);
        keep(&mut self.nonlinear.vertex, &stays);
        keep(&mut self.nonlinear.edge, &self.linear.live_edges());
        self.linear.compact(new_ids, live_tets);

        let triangles = &mut self.nonlinear.triangles;
        let live_triangles: Vec<bool> = triangles.tets.iter().map(|&n| n > 0).collect();
        let new_triangle = renumbered(&live_triangles);
        keep(&mut triangles.nodes, &live_triangles);
        keep(&mut triangles.tets, &live_triangles);
        keep(&mut self.nonlinear.triangle, &live_triangles);
        keep(&mut triangles.of_tet, live_tets);
        triangles.nodes.iter_mut().flatten().for_each(|n| *n = new_node(*n));
        triangles.of_tet.iter_mut().flatten().for_each(|t| *t = new_triangle[*t as usize]);

        keep(&mut self.nonlinear.tet, live_tets);
        keep(&mut self.laws, live_tets);
        keep(&mut self.gradients, live_tets);
        if !self.rest_stress_pa.is_empty() {
            keep(&mut self.rest_stress_pa, live_tets);
        }
    }
}

/// Takes `what` out of `from`; nothing is left of an entity without a tetrahedron.
fn subtract<T: Summed>(from: &mut T, what: &T, stays: bool) {
    if stays {
        from.add(what, -1.0);
    } else {
        *from = T::default();
    }
}

/// Replaces the shares of an entity in the bounds of its nodes.
fn exchange<const N: usize>(bounds: &mut [Bound], nodes: [NodeId; N], before: [Bound; N], after: [Bound; N]) {
    for (i, node) in nodes.into_iter().enumerate() {
        bounds[node.index()].add(before[i], -1.0);
        bounds[node.index()].add(after[i], 1.0);
    }
}
