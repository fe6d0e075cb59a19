//! Mass-spring-damper (seed `000` ch. 2): a spring and a damper on every edge of the tetrahedra.
//!
//! A link of length l, rest length l0 and direction n pulls its nodes together with k (l - l0) + c n.(v_b - v_a);
//! beside that, each node is slowed by gamma v (the damping over mass of [`Dynamics`] is another such term, in
//! proportion to mass). The stiffness is the three-dimensional form of Van Gelder's (A. Van Gelder 1998,
//! doi 10.1080/10867651.1998.10487490; seed `000` eq. 2.7):
//!
//! k = E sum V_e / l0^2 over the tetrahedra at the edge.
//!
//! It has no Poisson's ratio (what comes out is near 1/4) and resists no change of volume: a platform for tests and
//! a thing to compare with, not a model of tissue (seed `000` s. 2.3.5).

use super::explicit_body::{Dynamics, ExplicitBody, ExplicitBodyError, InternalForces, check_number, keep};
use super::extended_mass_spring::{check_removal_only, compact_edges, compact_tets};
use super::{Constraints, DeformableModel, ModelState, TopologyRefusal};
use crate::math::DVec3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::{MeshEdges, P1Gradients};

/// How a body's mass is divided among its nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodalMasses {
    /// A quarter of each tetrahedron's mass to each of its corners (seed `000` eq. 2.5).
    VolumeWeighted,
    /// The same for every node: what the thesis compares with. Where nodes stand close, matter is too dense.
    Equal,
}

/// What a mass-spring model is made from.
#[derive(Clone, Copy, Debug)]
pub struct MassSpringParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Young's modulus E of the stiffness formula [Pa].
    pub young_modulus_pa: f64,
    /// Density [kg/m3].
    pub density_kg_per_m3: f64,
    /// How the mass is divided.
    pub masses: NodalMasses,
    /// Damper of each link [N s/m].
    pub link_damping_n_s_per_m: f64,
    /// Damper gamma between each node and the ground [N s/m].
    pub node_damping_n_s_per_m: f64,
    /// Supports, time integration, damping over mass, gravity.
    pub dynamics: Dynamics<'a>,
}

#[derive(Clone, Debug)]
struct Springs {
    edges: MeshEdges,
    edge_tets: Vec<u32>,
    rest_m: Vec<f64>,
    stiffness_n_per_m: Vec<f64>,
    link_damping_n_s_per_m: f64,
    node_damping_n_s_per_m: f64,
}

impl InternalForces for Springs {
    fn add_forces(&mut self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3], force_n: &mut [DVec3]) {
        for (e, &[a, b]) in self.edges.nodes.iter().enumerate() {
            let (a, b) = (a.index(), b.index());
            let along_m = positions_m[b] - positions_m[a];
            let squared_m2 = along_m.length_squared();
            // Two nodes in one place have no direction to push in.
            if self.edge_tets[e] == 0 || squared_m2 == 0.0 {
                continue;
            }
            let length_m = squared_m2.sqrt();
            let approach = along_m.dot(velocities_m_per_s[b] - velocities_m_per_s[a]) / squared_m2;
            let elastic = self.stiffness_n_per_m[e] * (1.0 - self.rest_m[e] / length_m);
            let pull_n = (elastic + self.link_damping_n_s_per_m * approach) * along_m;
            force_n[a] += pull_n;
            force_n[b] -= pull_n;
        }
        if self.node_damping_n_s_per_m > 0.0 {
            for (force, v) in force_n.iter_mut().zip(velocities_m_per_s) {
                *force -= self.node_damping_n_s_per_m * *v;
            }
        }
    }
}

/// One organ of springs and dampers.
#[derive(Clone, Debug)]
pub struct MassSpring {
    young_modulus_pa: f64,
    density_kg_per_m3: f64,
    masses: NodalMasses,
    body: ExplicitBody,
    springs: Springs,
    tet_nodes: Vec<[NodeId; 4]>,
    tet_is_live: Vec<bool>,
    vertex_tets: Vec<u32>,
    /// For [`NodalMasses::Equal`].
    total_kg: f64,
    /// Scratch, two entries a node: stiffness and damping at it.
    at_node: Vec<[f64; 2]>,
}

impl MassSpring {
    /// Adds up stiffnesses and masses. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`ExplicitBodyError`]: an unusable mesh, a step above the stable one, an impossible parameter.
    pub fn build(params: &MassSpringParams<'_>) -> Result<Self, ExplicitBodyError> {
        let MassSpringParams { mesh, young_modulus_pa, density_kg_per_m3, masses, dynamics, .. } = *params;
        for (what, found) in
            [("Young's modulus [Pa]", young_modulus_pa), ("density [kg/m3]", density_kg_per_m3)]
        {
            if !(found.is_finite() && found > 0.0) {
                let allowed = "a finite number above 0";
                return Err(ExplicitBodyError::Parameter { what, found, allowed });
            }
        }
        check_number("damping of a link [N s/m]", params.link_damping_n_s_per_m, 0.0)?;
        check_number("damping of a node [N s/m]", params.node_damping_n_s_per_m, 0.0)?;
        let edges = MeshEdges::of_mesh(mesh)?;
        let (n_nodes, n_edges) = (mesh.positions_m.len(), edges.nodes.len());
        let rest_m: Vec<f64> = edges
            .nodes
            .iter()
            .map(|&[a, b]| mesh.positions_m[a.index()].distance(mesh.positions_m[b.index()]))
            .collect();
        let mut stiffness_n_per_m = vec![0.0; n_edges];
        let mut edge_tets = vec![0; n_edges];
        let mut vertex_tets = vec![0; n_nodes];
        let mut mass_kg = vec![0.0; n_nodes];
        let mut total_kg = 0.0;
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let volume_m3 = P1Gradients::of_tet(mesh, TetId::from_index(t))?.volume_m3;
            total_kg += density_kg_per_m3 * volume_m3;
            for edge in edges.of_tet[t] {
                let e = edge as usize;
                edge_tets[e] += 1;
                stiffness_n_per_m[e] += young_modulus_pa * volume_m3 / (rest_m[e] * rest_m[e]);
            }
            for node in nodes {
                vertex_tets[node.index()] += 1;
                mass_kg[node.index()] += density_kg_per_m3 * volume_m3 / 4.0;
            }
        }
        let mut model = Self {
            young_modulus_pa,
            density_kg_per_m3,
            masses,
            body: ExplicitBody::new(&mesh.positions_m, mass_kg, &dynamics)?,
            springs: Springs {
                edges,
                edge_tets,
                rest_m,
                stiffness_n_per_m,
                link_damping_n_s_per_m: params.link_damping_n_s_per_m,
                node_damping_n_s_per_m: params.node_damping_n_s_per_m,
            },
            tet_nodes: mesh.tetrahedra.clone(),
            tet_is_live: vec![true; mesh.tetrahedra.len()],
            vertex_tets,
            total_kg,
            at_node: vec![[0.0; 2]; n_nodes],
        };
        model.update_masses_and_bounds();
        model.body.check_step()?;
        Ok(model)
    }

    /// Equal masses are divided anew; the bounds follow from the springs at each node: by Gershgorin's circles of
    /// M^-1 K, whose row at node i has blocks k n n^T of norm k or less, omega^2 <= 2 (sum of k at i)/m_i.
    /// It holds as long as no link is shorter than half its rest length.
    fn update_masses_and_bounds(&mut self) {
        if self.masses == NodalMasses::Equal {
            let n_live = self.vertex_tets.iter().filter(|n| **n > 0).count().max(1);
            for (m, n_tets) in self.body.mass_kg.iter_mut().zip(&self.vertex_tets) {
                *m = if *n_tets > 0 { self.total_kg / n_live as f64 } else { 0.0 };
            }
        }
        self.body.masses_changed();
        self.at_node.fill([0.0; 2]);
        for (e, edge) in self.springs.edges.nodes.iter().enumerate() {
            for node in edge {
                if self.springs.edge_tets[e] > 0 {
                    self.at_node[node.index()][0] += 2.0 * self.springs.stiffness_n_per_m[e];
                    self.at_node[node.index()][1] += 2.0 * self.springs.link_damping_n_s_per_m;
                }
            }
        }
        let (mut squared, mut rate) = (0.0_f64, 0.0_f64);
        for ([k, c], &m) in self.at_node.iter().zip(&self.body.mass_kg) {
            if m > 0.0 {
                squared = squared.max(k / m);
                rate = rate.max((c + self.springs.node_damping_n_s_per_m) / m);
            }
        }
        self.body.set_bounds(squared.sqrt(), rate);
    }

    /// Largest step [s] for which the scheme is stable now, unless a link shrinks to half its length.
    pub fn stable_step_s(&self) -> f64 {
        self.body.stable_step_s()
    }

    /// Largest internal step [s]; a longer [`DeformableModel::step`] is divided into equal parts.
    pub fn time_step_s(&self) -> f64 {
        self.body.time_step_s()
    }

    /// Mass [kg] of each node; zero without a tetrahedron.
    pub fn masses_kg(&self) -> &[f64] {
        &self.body.mass_kg
    }

    /// Live links (lower node first, ascending) with their stiffness [N/m].
    pub fn springs_n_per_m(&self) -> impl Iterator<Item = ([NodeId; 2], f64)> + '_ {
        let live = self.springs.edge_tets.iter().map(|&n| n > 0);
        let springs =
            self.springs.edges.nodes.iter().copied().zip(self.springs.stiffness_n_per_m.iter().copied());
        springs.zip(live).filter(|(_, live)| *live).map(|(spring, _)| spring)
    }

    /// Constraints of the last [`DeformableModel::apply`] that were left out.
    pub fn ignored_constraints(&self) -> usize {
        self.body.ignored_constraints()
    }

    /// Implicit steps since set-up that ended before their fixed point was found.
    pub fn missed_fixed_points(&self) -> u64 {
        self.body.missed_fixed_points()
    }

    /// Sets the velocities of nodes that move freely [m/s].
    pub fn set_velocities(&mut self, velocities_m_per_s: &[DVec3]) {
        self.body.set_velocities(velocities_m_per_s);
    }

    /// Overwrites `force_n` with what the links exert on each node at these positions and velocities.
    pub fn internal_forces_into(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        force_n: &mut [DVec3],
    ) {
        force_n.fill(DVec3::ZERO);
        self.springs.add_forces(positions_m, velocities_m_per_s, force_n);
    }

    /// Elastic and kinetic energy now [J], without gravity.
    pub fn energy_j(&self) -> f64 {
        let x = &self.body.positions_m;
        let mut energy_j = self.body.kinetic_energy_j();
        for (e, &[a, b]) in self.springs.edges.nodes.iter().enumerate() {
            let stretch_m = x[a.index()].distance(x[b.index()]) - self.springs.rest_m[e];
            energy_j += 0.5 * self.springs.stiffness_n_per_m[e] * stretch_m * stretch_m;
        }
        energy_j
    }

    fn remove_tet(&mut self, tet: TetId) {
        let t = tet.index();
        self.tet_is_live[t] = false;
        let nodes = self.tet_nodes[t];
        // The rest positions are those of the build, so these are the numbers that were added then.
        let volume_m3 = P1Gradients::new(nodes.map(|n| self.body.rest_m[n.index()])).volume_m3;
        self.total_kg -= self.density_kg_per_m3 * volume_m3;
        for node in nodes {
            let n = node.index();
            self.vertex_tets[n] -= 1;
            if self.vertex_tets[n] == 0 {
                self.body.mass_kg[n] = 0.0;
            } else {
                self.body.mass_kg[n] -= self.density_kg_per_m3 * volume_m3 / 4.0;
            }
        }
        for edge in self.springs.edges.of_tet[t] {
            let e = edge as usize;
            self.springs.edge_tets[e] -= 1;
            if self.springs.edge_tets[e] == 0 {
                self.springs.stiffness_n_per_m[e] = 0.0;
            } else {
                let squared_m2 = self.springs.rest_m[e] * self.springs.rest_m[e];
                self.springs.stiffness_n_per_m[e] -= self.young_modulus_pa * volume_m3 / squared_m2;
            }
        }
    }

    fn compact(&mut self, change: &TopologyChange) {
        let live_edges: Vec<bool> = self.springs.edge_tets.iter().map(|&n| n > 0).collect();
        compact_edges(&mut self.springs.edges, &live_edges, &self.tet_is_live, change);
        keep(&mut self.springs.edge_tets, &live_edges);
        keep(&mut self.springs.rest_m, &live_edges);
        keep(&mut self.springs.stiffness_n_per_m, &live_edges);
        compact_tets(&mut self.tet_nodes, &mut self.tet_is_live, change);
        let stays: Vec<bool> = change.nodes.new_ids.iter().map(Option::is_some).collect();
        keep(&mut self.vertex_tets, &stays);
        keep(&mut self.at_node, &stays);
        self.body.compact(change);
    }
}

impl DeformableModel for MassSpring {
    fn apply(&mut self, constraints: &Constraints) {
        self.body.apply(constraints);
    }

    /// Advances by `dt_s` in the fewest equal parts not longer than the time step and the stable step.
    fn step(&mut self, dt_s: f64) {
        self.body.step(dt_s, &mut self.springs);
    }

    fn state(&self) -> ModelState<'_> {
        self.body.state()
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        self.body.constraint_forces_n()
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.body.take_over(positions_m);
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    fn topology_changed(&mut self, _: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        check_removal_only(change, "mass_spring")?;
        assert_eq!(change.tets.n_before, self.tet_nodes.len(), "the model missed a change of the mesh");
        assert_eq!(change.nodes.n_before, self.body.rest_m.len(), "the model missed a change of the mesh");
        let mut is_cut = false;
        for &tet in &change.tets.removed {
            if self.tet_is_live[tet.index()] {
                self.remove_tet(tet);
                is_cut = true;
            }
        }
        if is_cut {
            self.update_masses_and_bounds();
        }
        if change.is_renumbering() {
            self.compact(change);
        }
        Ok(())
    }
}
