//! Mass-spring-damper (seed `000` ch. 2): a spring and a damper on every edge of the tetrahedra.
//!
//! A link of length l, rest length l0 and direction n pulls its nodes together with k (l - l0) + c n.(v_b - v_a);
//! beside that, each node is slowed by gamma v (the damping over mass of the body is another such term, in
//! proportion to mass). The stiffness is the three-dimensional form of Van Gelder's (A. Van Gelder 1998,
//! doi 10.1080/10867651.1998.10487490; seed `000` eq. 2.7):
//!
//! k = E sum V_e / l0^2 over the tetrahedra at the edge.
//!
//! It has no Poisson's ratio (what comes out is near 1/4) and resists no change of volume: a platform for tests and
//! a thing to compare with, not a model of tissue (seed `000` s. 2.3.5). Links know no inverted tetrahedron, and their
//! forces are finite in every shape: nothing is put in quarantine. They rest in the mirror image too, from which a stand-in
//! beside them brings tetrahedra back. A stress at rest is a further constant tension per
//! length of the links, exactly F S0 of the tetrahedra; it balances the weight of volume-weighted masses.

use super::explicit::{
    Cuttable, ExplicitBody, ExplicitDynamics, ExplicitError, Integration, InternalForces, LiveEdges,
    LiveTets, RestTensions, check_body, check_number, follow, keep,
};
use super::local_model::{self, ElementStiffness, LocalBody, LocalElements, LocalFrame};
use super::topology_update::{TopologyUpdate, blend_tets};
use super::{
    DeformableModel, DynamicBody, ModelError, ModelRow, OrganBody, Rayleigh, RestStress, TopologyRefusal,
};
use crate::material::{LawChoice, StableNeoHooke};
use crate::model::explicit::{Mover, Quarantine, StandIn, StandIns};
use crate::solve::{MeshEdges, P1Gradients};
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

pub(super) const ROW: ModelRow =
    ModelRow::explicit("mass_spring", "masses and springs on the edges: explicit dynamics", &[], make);

fn make(body: &OrganBody, _: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let params = MassSpringParams {
        body: body.dynamic(),
        young_modulus_pa: body.material.young_modulus_pa(),
        masses: NodalMasses::VolumeWeighted,
        link_damping_n_s_per_m: 0.0,
        node_damping_n_s_per_m: 0.0,
        integration: body.integration(),
    };
    Ok(Box::new(MassSpring::build(&params).map_err(ModelError::of_numbers)?))
}

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
    /// The body, its supports, loads and damping over inertia.
    pub body: DynamicBody<'a>,
    /// Young's modulus E of the stiffness formula [Pa].
    pub young_modulus_pa: f64,
    /// How the mass is divided.
    pub masses: NodalMasses,
    /// Damper of each link [N s/m].
    pub link_damping_n_s_per_m: f64,
    /// Damper gamma between each node and the ground [N s/m].
    pub node_damping_n_s_per_m: f64,
    /// Time integration.
    pub integration: Integration,
}

#[derive(Clone, Debug)]
struct Springs {
    edges: LiveEdges,
    rest_tensions: RestTensions,
    rest_m: Vec<f64>,
    stiffness_n_per_m: Vec<f64>,
    link_damping_n_s_per_m: f64,
    node_damping_n_s_per_m: f64,
    tets: LiveTets,
    stand_ins: StandIns,
}

/// What tetrahedra that are inside out do beside their springs, which rest in the mirror image too.
fn stand_in(young_modulus_pa: f64) -> Result<StableNeoHooke, ExplicitError> {
    let lame_pa = STAND_IN_SHARE * young_modulus_pa;
    StableNeoHooke::new(lame_pa, lame_pa).map_err(|_| ExplicitError::Parameter {
        what: "Young's modulus [Pa]",
        found: young_modulus_pa,
        allowed: "a finite number above 0",
    })
}

/// Lame's coefficients of the stand-in over Young's modulus: half of those of the springs, whose Poisson's ratio is near 1/4, so
/// that a step which is made for the springs bears both.
const STAND_IN_SHARE: f64 = 0.2;

impl InternalForces for Springs {
    fn add_forces(&mut self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3], force_n: &mut [DVec3]) {
        for (e, &[a, b]) in self.edges.edges.nodes.iter().enumerate() {
            let (a, b) = (a.index(), b.index());
            let along_m = positions_m[b] - positions_m[a];
            let squared_m2 = along_m.length_squared();
            // Two nodes in one place have no direction to push in.
            if self.edges.tets[e] == 0 || squared_m2 == 0.0 {
                continue;
            }
            let length_m = squared_m2.sqrt();
            let approach = along_m.dot(velocities_m_per_s[b] - velocities_m_per_s[a]) / squared_m2;
            let elastic =
                self.stiffness_n_per_m[e] * (1.0 - self.rest_m[e] / length_m) + self.rest_tensions.on_edge(e);
            let pull_n = (elastic + self.link_damping_n_s_per_m * approach) * along_m;
            force_n[a] += pull_n;
            force_n[b] -= pull_n;
        }
        if self.node_damping_n_s_per_m > 0.0 {
            for (force, v) in force_n.iter_mut().zip(velocities_m_per_s) {
                *force -= self.node_damping_n_s_per_m * *v;
            }
        }
        self.stand_ins.add_forces(positions_m, force_n);
    }

    fn quarantine(&mut self, positions_m: &[DVec3], rest_m: &[DVec3]) -> Quarantine {
        self.stand_ins.find(&self.tets, positions_m, rest_m, |_| ());
        // The springs count as ever: nothing is left out.
        Quarantine::default()
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
    /// One a tetrahedron, or none.
    rest_stress_pa: Vec<RestStress>,
    /// For [`NodalMasses::Equal`].
    total_kg: f64,
    /// Scratch, two entries a node: stiffness and damping at it.
    at_node: Vec<[f64; 2]>,
}

impl MassSpring {
    /// Adds up stiffnesses and masses. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`ExplicitError`]: an unusable mesh, a step above the stable one, an impossible parameter.
    pub fn build(params: &MassSpringParams<'_>) -> Result<Self, ExplicitError> {
        let MassSpringParams { body, young_modulus_pa, masses, .. } = *params;
        if !(young_modulus_pa.is_finite() && young_modulus_pa > 0.0) {
            let (what, allowed) = ("Young's modulus [Pa]", "a finite number above 0");
            return Err(ExplicitError::Parameter { what, found: young_modulus_pa, allowed });
        }
        check_number("damping of a link [N s/m]", params.link_damping_n_s_per_m, 0.0)?;
        check_number("damping of a node [N s/m]", params.node_damping_n_s_per_m, 0.0)?;
        check_body(&body)?;
        let mesh = body.mesh;
        let edges = MeshEdges::of_mesh(mesh)?;
        let rest_m: Vec<f64> = edges
            .nodes
            .iter()
            .map(|&[a, b]| mesh.positions_m[a.index()].distance(mesh.positions_m[b.index()]))
            .collect();
        let mut stiffness_n_per_m = vec![0.0; edges.nodes.len()];
        let mut gradients = Vec::with_capacity(mesh.tetrahedra.len());
        let mut total_kg = 0.0;
        for (t, of_tet) in edges.of_tet.iter().enumerate() {
            let of_rest = P1Gradients::of_tet(mesh, TetId::from_index(t))?;
            total_kg += body.density_kg_per_m3 * of_rest.volume_m3;
            for edge in of_tet {
                let e = *edge as usize;
                stiffness_n_per_m[e] += young_modulus_pa * of_rest.volume_m3 / (rest_m[e] * rest_m[e]);
            }
            gradients.push(of_rest);
        }
        let rest_tensions = RestTensions::new(&edges, gradients.into_iter(), body.rest_stress_pa);
        // Every link stretched or shortened by its length.
        let strained_j = stiffness_n_per_m.iter().zip(&rest_m).map(|(k, l)| 0.5 * k * l * l).sum();
        let mut model = Self {
            young_modulus_pa,
            density_kg_per_m3: body.density_kg_per_m3,
            masses,
            body: ExplicitBody::new(&body, &params.integration, None, strained_j)?,
            springs: Springs {
                edges: LiveEdges::new(edges),
                rest_tensions,
                rest_m,
                stiffness_n_per_m,
                link_damping_n_s_per_m: params.link_damping_n_s_per_m,
                node_damping_n_s_per_m: params.node_damping_n_s_per_m,
                stand_ins: StandIns::new(StandIn::Stable(stand_in(young_modulus_pa)?), mesh.tetrahedra.len()),
                tets: LiveTets::of_mesh(mesh),
            },
            rest_stress_pa: body.rest_stress_pa.to_vec(),
            total_kg,
            at_node: vec![[0.0; 2]; mesh.positions_m.len()],
        };
        let [frequency_rad_per_s, viscosity_per_s] = model.update_masses();
        model.body.masses_changed();
        model.body.set_bounds(frequency_rad_per_s, viscosity_per_s);
        model.body.check_step()?;
        Ok(model)
    }

    /// Equal masses are divided anew. Bounds of frequency [rad/s] and viscous damping over mass [1/s] follow from the
    /// springs at each node: by Gershgorin's circles of M^-1 K, whose row at node i has blocks k n n^T of norm k or
    /// less, omega^2 <= 2 (sum of k at i)/m_i. It holds as long as no link is shorter than half its rest length.
    fn update_masses(&mut self) -> [f64; 2] {
        if self.masses == NodalMasses::Equal {
            let n_live = self.body.node_tets().iter().filter(|n| **n > 0).count().max(1);
            for n in 0..self.body.n_nodes() {
                let live = self.body.node_tets()[n] > 0;
                self.body.masses_kg_mut()[n] = if live { self.total_kg / n_live as f64 } else { 0.0 };
            }
        }
        self.at_node.fill([0.0; 2]);
        let springs = &self.springs;
        for (e, edge) in springs.edges.edges.nodes.iter().enumerate() {
            for node in edge {
                if springs.edges.tets[e] > 0 {
                    let stiffness = springs.stiffness_n_per_m[e] + springs.rest_tensions.on_edge(e).abs();
                    self.at_node[node.index()][0] += 2.0 * stiffness;
                    self.at_node[node.index()][1] += 2.0 * springs.link_damping_n_s_per_m;
                }
            }
        }
        let (mut squared, mut rate) = (0.0_f64, 0.0_f64);
        for ([k, c], &m) in self.at_node.iter().zip(self.body.masses_kg()) {
            if m > 0.0 {
                squared = squared.max(k / m);
                rate = rate.max((c + springs.node_damping_n_s_per_m) / m);
            }
        }
        [squared.sqrt(), rate]
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
        self.body.masses_kg()
    }

    /// Live links (lower node first, ascending) with their stiffness [N/m].
    pub fn springs_n_per_m(&self) -> impl Iterator<Item = ([NodeId; 2], f64)> + '_ {
        let live = self.springs.edges.tets.iter().map(|&n| n > 0);
        let springs = self
            .springs
            .edges
            .edges
            .nodes
            .iter()
            .copied()
            .zip(self.springs.stiffness_n_per_m.iter().copied());
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

    /// Holds a node where it is from now on: pre-stress, with nodes moved before.
    pub fn fix_in_place(&mut self, node: NodeId) {
        self.body.fix_in_place(node);
    }

    /// Overwrites `force_n` with what the links exert on each node at these positions and velocities.
    pub fn internal_forces_into(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        force_n: &mut [DVec3],
    ) {
        force_n.fill(DVec3::ZERO);
        self.springs.stand_ins.clear();
        self.springs.add_forces(positions_m, velocities_m_per_s, force_n);
    }

    /// Elastic and kinetic energy now [J], without gravity.
    pub fn energy_j(&self) -> f64 {
        let x = self.body.positions_m();
        let mut energy_j = self.body.kinetic_energy_j();
        for (e, &[a, b]) in self.springs.edges.edges.nodes.iter().enumerate() {
            let stretch_m = x[a.index()].distance(x[b.index()]) - self.springs.rest_m[e];
            energy_j += 0.5 * self.springs.stiffness_n_per_m[e] * stretch_m * stretch_m;
        }
        let rest_m2 = |e: usize| self.springs.rest_m[e] * self.springs.rest_m[e];
        energy_j + self.springs.rest_tensions.energy_j(&self.springs.edges.edges.nodes, x, rest_m2)
    }
}

impl MassSpring {
    fn gradients(&self, t: usize) -> P1Gradients {
        self.springs.tets.gradients(t, self.body.rest_m())
    }
}

impl Cuttable for MassSpring {
    const NAME: &'static str = ROW.name;

    fn tets(&self) -> &LiveTets {
        &self.springs.tets
    }

    fn tets_mut(&mut self) -> &mut LiveTets {
        &mut self.springs.tets
    }

    fn rest_m(&self) -> &[DVec3] {
        self.body.rest_m()
    }

    fn remove_tet(&mut self, t: usize) {
        let nodes = self.springs.tets.nodes[t];
        // The rest positions are those from when it was added, so these are the numbers that were added then.
        let volume_m3 = self.gradients(t).volume_m3;
        self.total_kg -= self.density_kg_per_m3 * volume_m3;
        self.body.remove_tet(nodes, volume_m3);
        let springs = &mut self.springs;
        for (local, edge) in springs.edges.edges.of_tet[t].into_iter().enumerate() {
            let e = edge as usize;
            let stays = springs.edges.take_tet(e);
            springs.rest_tensions.remove(t, local, e, stays);
            if stays {
                let squared_m2 = springs.rest_m[e] * springs.rest_m[e];
                springs.stiffness_n_per_m[e] -= self.young_modulus_pa * volume_m3 / squared_m2;
            } else {
                springs.stiffness_n_per_m[e] = 0.0;
            }
        }
    }

    fn after_removals(&mut self) {
        let [frequency_rad_per_s, viscosity_per_s] = self.update_masses();
        let at_node = &self.at_node;
        self.body.set_bounds_after_removals(
            frequency_rad_per_s,
            viscosity_per_s,
            |nodes, allowed_rad_per_s| {
                for (n, [k, _]) in at_node.iter().enumerate() {
                    nodes.at_least(n, k / (allowed_rad_per_s * allowed_rad_per_s));
                }
            },
        );
    }

    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        self.body.grow(mesh, change, growth);
        self.at_node.resize(growth.n_nodes, [0.0; 2]);
        blend_tets(&mut self.rest_stress_pa, change);
        let springs = &mut self.springs;
        springs.stand_ins.make_room(growth.n_tets);
        let insertions = springs.edges.grow(&springs.tets, &growth.added);
        insertions.spread(&mut springs.rest_m, 0.0);
        insertions.spread(&mut springs.stiffness_n_per_m, 0.0);
        springs.rest_tensions.grow(&insertions, growth.n_tets);
        let has_new_place = growth.has_new_place();
        for (rest_m, nodes) in springs.rest_m.iter_mut().zip(&springs.edges.edges.nodes) {
            if *rest_m == 0.0 || nodes.iter().any(|n| has_new_place[n.index()]) {
                let [a, b] = nodes.map(|n| mesh.positions_m[n.index()]);
                *rest_m = a.distance(b);
            }
        }
    }

    fn add_tet(&mut self, t: usize) {
        let (nodes, gradients) = (self.springs.tets.nodes[t], self.gradients(t));
        let volume_m3 = gradients.volume_m3;
        self.total_kg += self.density_kg_per_m3 * volume_m3;
        self.body.add_tet(t, nodes, volume_m3, None);
        let springs = &mut self.springs;
        springs.edges.add_tet(t);
        for edge in springs.edges.edges.of_tet[t] {
            let e = edge as usize;
            let squared_m2 = springs.rest_m[e] * springs.rest_m[e];
            springs.stiffness_n_per_m[e] += self.young_modulus_pa * volume_m3 / squared_m2;
        }
        if let Some(&stress_pa) = self.rest_stress_pa.get(t) {
            springs.rest_tensions.add_tet(t, &springs.edges.edges.of_tet[t], &gradients, stress_pa);
        }
    }

    fn after_growth(&mut self) {
        self.after_removals();
    }

    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        let live_tets = &self.springs.tets.is_live;
        if !self.rest_stress_pa.is_empty() {
            keep(&mut self.rest_stress_pa, live_tets);
        }
        let live_edges = self.springs.edges.compact(new_ids, live_tets);
        keep(&mut self.springs.rest_m, &live_edges);
        keep(&mut self.springs.stiffness_n_per_m, &live_edges);
        self.springs.rest_tensions.compact(&live_edges, live_tets);
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        keep(&mut self.at_node, &stays);
        self.body.compact(new_ids, live_tets);
    }
}

impl LocalBody for MassSpring {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Edges(&self.springs.edges.edges.nodes)
    }

    fn is_live(&self, element: usize) -> bool {
        self.springs.edges.tets[element] > 0
    }

    /// Along the link k l0/l and across it the tension per length, with its damper.
    fn stiffness(&self, element: usize, period_s: f64) -> ElementStiffness {
        let springs = &self.springs;
        let [a, b] = springs.edges.edges.nodes[element].map(|n| self.body.positions_m()[n.index()]);
        let (along_m, k) = (b - a, springs.stiffness_n_per_m[element]);
        let length_m = along_m.length();
        if length_m == 0.0 {
            return [[DMat3::ZERO; 4]; 4];
        }
        let direction = along_m / length_m;
        let slack = springs.rest_m[element] / length_m;
        let across = k * (1.0 - slack) + springs.rest_tensions.on_edge(element);
        let along = k * slack + springs.link_damping_n_s_per_m / period_s;
        let tensor = DMat3::from_diagonal(DVec3::splat(across)) + outer(direction, direction) * along;
        local_model::of_edge(tensor)
    }

    fn frame(&self) -> &dyn LocalFrame {
        &self.body
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.body.state().velocities_m_per_s[n]
    }

    fn damping(&self) -> Rayleigh {
        // The ground's dampers are as good as a damping of the mass where masses are alike; elsewhere near to it.
        let Rayleigh { mass_per_s, stiffness_s } = self.body.frame().damping;
        let ground_per_s = self.springs.node_damping_n_s_per_m * self.body.n_nodes() as f64 / self.total_kg;
        Rayleigh { mass_per_s: mass_per_s + ground_per_s, stiffness_s }
    }
}

impl ExplicitDynamics for MassSpring {
    type Mover = ExplicitBody;

    fn mover(&self) -> &ExplicitBody {
        &self.body
    }

    fn mover_mut(&mut self) -> &mut ExplicitBody {
        &mut self.body
    }

    fn advance(&mut self, dt_s: f64) {
        self.body.step(dt_s, &mut self.springs);
    }

    fn follow_change(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        follow(self, mesh, change)
    }
}
