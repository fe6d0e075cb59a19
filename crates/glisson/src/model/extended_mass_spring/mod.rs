//! The extended mass-spring model ("masse-liaison etendue", seed `000` ch. 3): forces along the edges from the
//! squared edge lengths of each tetrahedron.
//!
//! A tetrahedron of a hyperelastic law W(L) gives each of its edges e = (a, b) a tension per length
//! s_e = 2 V0 dW/dL_e ([`law`]); the force on a is s_e (x_b - x_a). Tensions are scalars, so they are summed on
//! the edges of the mesh first: a step takes (1) the squared length of every edge, (2) six tensions of every
//! tetrahedron, (3) the force of every edge. Neither rest positions nor displacements enter.
//!
//! Viscosity (Kelvin-Voigt, seed `000` s. 3.6): the tetrahedron slows its nodes relative to its centroid,
//! f_i = -c V0 (v_i - v_G) = c V0/4 sum_j (v_j - v_i), which is again a sum over edges. It keeps momentum; a rigid
//! rotation is slowed too.
//!
//! Removing a tetrahedron takes its tensions, its share of the edges' viscosity and its masses out.

mod law;
mod tuning;

pub use law::EdgeLaw;
pub use tuning::tuned_damping_per_s;

use self::law::{EdgeEnergy, Lame, NeoHookeTet, StVenantKirchhoffTet, is_inverted};
use super::explicit_body::{Dynamics, ExplicitBody, ExplicitBodyError, InternalForces, check_number, keep};
use super::tensor_mass::TensorMass;
use super::{Constraints, DeformableModel, ModelState, TopologyRefusal};
use crate::material::LinearElastic;
use crate::math::DVec3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::solve::{LOCAL_EDGES, MeshEdges, P1Gradients};

/// What an extended mass-spring model is made from.
#[derive(Clone, Copy, Debug)]
pub struct ExtendedMassSpringParams<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// The law.
    pub law: EdgeLaw,
    /// Its Lame coefficients, and the density that makes the masses.
    pub material: &'a LinearElastic,
    /// Viscosity c [kg/(m3 s)] (1e-3 g/(mm3 s) is 1000): relative motion decays at the rate 4 c/rho.
    pub viscosity_kg_per_m3_s: f64,
    /// Supports, time integration, damping, gravity.
    pub dynamics: Dynamics<'a>,
}

/// The tetrahedra, by law: chosen outside the loop over them.
#[derive(Clone, Debug)]
enum Elements {
    StVenantKirchhoff(Vec<StVenantKirchhoffTet>),
    NeoHooke(Vec<NeoHookeTet>),
}

/// The links of the body.
#[derive(Clone, Debug)]
struct Links {
    edges: MeshEdges,
    edge_tets: Vec<u32>,
    rest_m2: Vec<f64>,
    /// Sum of c V0/4 [N s/m].
    viscosity_n_s_per_m: Vec<f64>,
    elements: Elements,
    // Scratch, an entry an edge.
    growth_m2: Vec<f64>,
    tension_n_per_m: Vec<f64>,
}

impl Links {
    fn measure(&mut self, positions_m: &[DVec3]) {
        for ((growth, &[a, b]), rest) in self.growth_m2.iter_mut().zip(&self.edges.nodes).zip(&self.rest_m2) {
            *growth = (positions_m[b.index()] - positions_m[a.index()]).length_squared() - rest;
        }
    }

    fn energy_j(&mut self, positions_m: &[DVec3]) -> f64 {
        fn sum<E: EdgeEnergy>(elements: &[E], of_tet: &[[u32; 6]], growth: &[f64]) -> f64 {
            let of = |(element, edges): (&E, &[u32; 6])| element.energy_j(edges.map(|e| growth[e as usize]));
            elements.iter().zip(of_tet).map(of).sum()
        }
        self.measure(positions_m);
        match &self.elements {
            Elements::StVenantKirchhoff(elements) => sum(elements, &self.edges.of_tet, &self.growth_m2),
            Elements::NeoHooke(elements) => sum(elements, &self.edges.of_tet, &self.growth_m2),
        }
    }
}

fn add_tensions<E: EdgeEnergy>(
    elements: &[E],
    of_tet: &[[u32; 6]],
    growth_m2: &[f64],
    tension_n_per_m: &mut [f64],
) {
    for (element, edges) in elements.iter().zip(of_tet) {
        let tension = element.tension_n_per_m(edges.map(|e| growth_m2[e as usize]));
        for (s, &e) in tension.iter().zip(edges) {
            tension_n_per_m[e as usize] += s;
        }
    }
}

impl InternalForces for Links {
    fn add_forces(&mut self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3], force_n: &mut [DVec3]) {
        self.measure(positions_m);
        self.tension_n_per_m.fill(0.0);
        let (of_tet, growth, tension) = (&self.edges.of_tet, &self.growth_m2, &mut self.tension_n_per_m);
        match &self.elements {
            Elements::StVenantKirchhoff(elements) => add_tensions(elements, of_tet, growth, tension),
            Elements::NeoHooke(elements) => add_tensions(elements, of_tet, growth, tension),
        }
        for (e, &[a, b]) in self.edges.nodes.iter().enumerate() {
            let (a, b) = (a.index(), b.index());
            let pull_n = self.tension_n_per_m[e] * (positions_m[b] - positions_m[a])
                + self.viscosity_n_s_per_m[e] * (velocities_m_per_s[b] - velocities_m_per_s[a]);
            force_n[a] += pull_n;
            force_n[b] -= pull_n;
        }
    }
}

/// One organ of tetrahedra that pull along their edges.
#[derive(Clone, Debug)]
pub struct ExtendedMassSpring {
    law: EdgeLaw,
    material: LinearElastic,
    viscosity_kg_per_m3_s: f64,
    body: ExplicitBody,
    links: Links,
    tet_nodes: Vec<[NodeId; 4]>,
    tet_is_live: Vec<bool>,
    vertex_tets: Vec<u32>,
    /// Highest frequency at rest after any removals [rad/s].
    frequency_after_cuts_rad_per_s: f64,
}

fn rest_squares_m2(mesh_positions_m: &[DVec3], nodes: [NodeId; 4]) -> [f64; 6] {
    let p = nodes.map(|n| mesh_positions_m[n.index()]);
    LOCAL_EDGES.map(|[a, b]| (p[b] - p[a]).length_squared())
}

impl ExtendedMassSpring {
    /// Prepares every tetrahedron. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`ExplicitBodyError`]: an unusable mesh, a step above the stable one, an impossible parameter.
    pub fn build(params: &ExtendedMassSpringParams<'_>) -> Result<Self, ExplicitBodyError> {
        let ExtendedMassSpringParams { mesh, law, material, viscosity_kg_per_m3_s, dynamics } = *params;
        check_number("viscosity [kg/(m3 s)]", viscosity_kg_per_m3_s, 0.0)?;
        let edges = MeshEdges::of_mesh(mesh)?;
        // At rest both laws have the stiffness of linear elasticity.
        let stable = TensorMass::stable_step(mesh, material)?;
        let (n_nodes, n_edges) = (mesh.positions_m.len(), edges.nodes.len());
        let mut mass_kg = vec![0.0; n_nodes];
        let mut vertex_tets = vec![0; n_nodes];
        let mut edge_tets = vec![0; n_edges];
        let mut viscosity_n_s_per_m = vec![0.0; n_edges];
        let mut gradients = Vec::with_capacity(mesh.tetrahedra.len());
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let of_tet = P1Gradients::of_tet(mesh, TetId::from_index(t))?;
            let share_kg = material.density_kg_per_m3() * of_tet.volume_m3 / 4.0;
            for node in nodes {
                mass_kg[node.index()] += share_kg;
                vertex_tets[node.index()] += 1;
            }
            for edge in edges.of_tet[t] {
                edge_tets[edge as usize] += 1;
                viscosity_n_s_per_m[edge as usize] += viscosity_kg_per_m3_s * of_tet.volume_m3 / 4.0;
            }
            gradients.push(of_tet);
        }
        let lame = Lame { lambda_pa: material.lambda_pa(), mu_pa: material.mu_pa() };
        let rests = mesh.tetrahedra.iter().map(|&nodes| rest_squares_m2(&mesh.positions_m, nodes));
        let with_rests = gradients.iter().zip(rests);
        let elements = match law {
            EdgeLaw::StVenantKirchhoff => Elements::StVenantKirchhoff(
                with_rests.map(|(g, rest)| StVenantKirchhoffTet::new(g, rest, lame)).collect(),
            ),
            EdgeLaw::NeoHooke => {
                Elements::NeoHooke(with_rests.map(|(g, rest)| NeoHookeTet::new(g, rest, lame)).collect())
            }
        };
        let rest_m2 = edges
            .nodes
            .iter()
            .map(|&[a, b]| (mesh.positions_m[b.index()] - mesh.positions_m[a.index()]).length_squared())
            .collect();
        let mut model = Self {
            law,
            material: *material,
            viscosity_kg_per_m3_s,
            body: ExplicitBody::new(&mesh.positions_m, mass_kg, &dynamics)?,
            links: Links {
                edges,
                edge_tets,
                rest_m2,
                viscosity_n_s_per_m,
                elements,
                growth_m2: vec![0.0; n_edges],
                tension_n_per_m: vec![0.0; n_edges],
            },
            tet_nodes: mesh.tetrahedra.clone(),
            tet_is_live: vec![true; mesh.tetrahedra.len()],
            vertex_tets,
            frequency_after_cuts_rad_per_s: 2.0 / stable.after_cuts_s,
        };
        model.body.set_bounds(2.0 / stable.step_s, model.viscous_rate_per_s());
        model.body.check_step()?;
        Ok(model)
    }

    /// Relative motion within a tetrahedron decays at c V0/(rho V0/4); the whole is at most that.
    fn viscous_rate_per_s(&self) -> f64 {
        4.0 * self.viscosity_kg_per_m3_s / self.material.density_kg_per_m3()
    }

    /// The law.
    pub fn law(&self) -> EdgeLaw {
        self.law
    }

    /// Largest step [s] for which the scheme is proven stable about the rest shape now.
    pub fn stable_step_s(&self) -> f64 {
        self.body.stable_step_s()
    }

    /// Largest internal step [s]; a longer [`DeformableModel::step`] is divided into equal parts.
    pub fn time_step_s(&self) -> f64 {
        self.body.time_step_s()
    }

    /// Into how many equal parts a step of `dt_s` is divided now.
    pub fn parts_of_step(&self, dt_s: f64) -> u64 {
        self.body.parts_of_step(dt_s)
    }

    /// Mass [kg] of each node; zero without a tetrahedron.
    pub fn masses_kg(&self) -> &[f64] {
        &self.body.mass_kg
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
        self.links.add_forces(positions_m, velocities_m_per_s, force_n);
    }

    /// Elastic energy at these positions [J].
    pub fn elastic_energy_j(&mut self, positions_m: &[DVec3]) -> f64 {
        self.links.energy_j(positions_m)
    }

    /// Elastic and kinetic energy now [J], without gravity.
    pub fn energy_j(&mut self) -> f64 {
        self.links.energy_j(&self.body.positions_m) + self.body.kinetic_energy_j()
    }

    /// How many live tetrahedra stand inverted or flat.
    pub fn n_inverted(&self) -> usize {
        let corners_m = |nodes: [NodeId; 4]| nodes.map(|n| self.body.positions_m[n.index()]);
        let live = self.tet_nodes.iter().zip(&self.tet_is_live).filter(|(_, live)| **live);
        live.filter(|(nodes, _)| is_inverted(corners_m(**nodes))).count()
    }

    /// All numbers that a removal changes: masses, then each edge with its viscosity, then each live tetrahedron's.
    /// For comparison with a model built anew; dead edges and tetrahedra are left out, dead nodes are zeros.
    pub fn mechanics(&self) -> [Vec<f64>; 3] {
        let live_edges = self.links.edge_tets.iter().map(|&n| n > 0);
        let viscosity = self.links.viscosity_n_s_per_m.iter().zip(live_edges);
        let live_tets = (0..self.tet_nodes.len()).filter(|&t| self.tet_is_live[t]);
        let elements: Vec<f64> = match &self.links.elements {
            Elements::StVenantKirchhoff(elements) => live_tets.flat_map(|t| elements[t].numbers()).collect(),
            Elements::NeoHooke(elements) => live_tets.flat_map(|t| elements[t].numbers()).collect(),
        };
        [self.body.mass_kg.clone(), viscosity.filter(|(_, live)| *live).map(|(c, _)| *c).collect(), elements]
    }

    fn remove_tet(&mut self, tet: TetId) {
        let t = tet.index();
        self.tet_is_live[t] = false;
        let nodes = self.tet_nodes[t];
        match &mut self.links.elements {
            Elements::StVenantKirchhoff(elements) => elements[t] = EdgeEnergy::nothing(),
            Elements::NeoHooke(elements) => elements[t] = EdgeEnergy::nothing(),
        }
        // The rest positions are those of the build, so these are the numbers that were added then.
        let volume_m3 = P1Gradients::new(nodes.map(|n| self.body.rest_m[n.index()])).volume_m3;
        for node in nodes {
            let n = node.index();
            self.vertex_tets[n] -= 1;
            if self.vertex_tets[n] == 0 {
                self.body.mass_kg[n] = 0.0;
            } else {
                self.body.mass_kg[n] -= self.material.density_kg_per_m3() * volume_m3 / 4.0;
            }
        }
        for edge in self.links.edges.of_tet[t] {
            let e = edge as usize;
            self.links.edge_tets[e] -= 1;
            if self.links.edge_tets[e] == 0 {
                self.links.viscosity_n_s_per_m[e] = 0.0;
            } else {
                self.links.viscosity_n_s_per_m[e] -= self.viscosity_kg_per_m3_s * volume_m3 / 4.0;
            }
        }
    }

    fn compact(&mut self, change: &TopologyChange) {
        let live_edges: Vec<bool> = self.links.edge_tets.iter().map(|&n| n > 0).collect();
        compact_edges(&mut self.links.edges, &live_edges, &self.tet_is_live, change);
        let links = &mut self.links;
        keep(&mut links.edge_tets, &live_edges);
        keep(&mut links.rest_m2, &live_edges);
        keep(&mut links.viscosity_n_s_per_m, &live_edges);
        keep(&mut links.growth_m2, &live_edges);
        keep(&mut links.tension_n_per_m, &live_edges);
        match &mut links.elements {
            Elements::StVenantKirchhoff(elements) => keep(elements, &self.tet_is_live),
            Elements::NeoHooke(elements) => keep(elements, &self.tet_is_live),
        }
        compact_tets(&mut self.tet_nodes, &mut self.tet_is_live, change);
        let stays: Vec<bool> = change.nodes.new_ids.iter().map(Option::is_some).collect();
        keep(&mut self.vertex_tets, &stays);
        self.body.compact(change);
    }
}

/// Whether a change is one that models of removable tetrahedra follow.
///
/// # Errors
/// [`TopologyRefusal::Frozen`] for new or moved nodes and new tetrahedra.
pub(super) fn check_removal_only(
    change: &TopologyChange,
    model: &'static str,
) -> Result<(), TopologyRefusal> {
    let nothing_new = change.tets.added.ids().is_empty() && change.nodes.added.ids().is_empty();
    if nothing_new && change.moved_nodes.is_empty() {
        return Ok(());
    }
    let reason =
        "it follows removals of tetrahedra and compactions; build it anew on a mesh with new or moved nodes";
    Err(TopologyRefusal::Frozen { model, reason })
}

/// Drops edges and tetrahedra that are not live, and renumbers; the order of the others stays.
pub(super) fn compact_edges(
    edges: &mut MeshEdges,
    live_edges: &[bool],
    live_tets: &[bool],
    change: &TopologyChange,
) {
    let mut n_edges = 0u32;
    let new_edge: Vec<u32> = live_edges
        .iter()
        .map(|&live| {
            n_edges += u32::from(live);
            n_edges.wrapping_sub(1)
        })
        .collect();
    keep(&mut edges.nodes, live_edges);
    for node in edges.nodes.iter_mut().flatten() {
        *node = change.nodes.new_ids[node.index()].expect("what is live has live nodes");
    }
    keep(&mut edges.of_tet, live_tets);
    for edge in edges.of_tet.iter_mut().flatten() {
        *edge = new_edge[*edge as usize];
    }
}

/// Drops dead tetrahedra and renumbers the nodes of the others.
pub(super) fn compact_tets(
    tet_nodes: &mut Vec<[NodeId; 4]>,
    tet_is_live: &mut Vec<bool>,
    change: &TopologyChange,
) {
    keep(tet_nodes, tet_is_live);
    for node in tet_nodes.iter_mut().flatten() {
        *node = change.nodes.new_ids[node.index()].expect("what is live has live nodes");
    }
    *tet_is_live = vec![true; tet_nodes.len()];
}

impl DeformableModel for ExtendedMassSpring {
    fn apply(&mut self, constraints: &Constraints) {
        self.body.apply(constraints);
    }

    /// Advances by `dt_s` in the fewest equal parts not longer than the time step and the stable step.
    fn step(&mut self, dt_s: f64) {
        self.body.step(dt_s, &mut self.links);
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
        check_removal_only(change, "extended_mass_spring")?;
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
            self.body.masses_changed();
            self.body.set_bounds(self.frequency_after_cuts_rad_per_s, self.viscous_rate_per_s());
        }
        if change.is_renumbering() {
            self.compact(change);
        }
        Ok(())
    }
}
