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
//! A stress at rest F S0 is a constant tension per length of the edges, added first. An inverted tetrahedron is left out
//! of the forces until it is upright again: squared lengths do not tell it from its mirror image, in which it would
//! stay. With logarithms the forces grow without bound as a tetrahedron becomes flat, beyond what the step of the rest
//! shape is stable for: such a body may not come back from a shape with many inverted tetrahedra.
//!
//! Removing a tetrahedron takes its tensions, its share of the edges' viscosity and its masses out.

mod law;
mod tuning;
pub(super) mod row;

pub use law::EdgeLaw;
pub use tuning::tuned_damping_per_s;

use self::law::{EdgeEnergy, Lame, NeoHookeTet, StVenantKirchhoffTet, is_inverted};
use super::explicit::{
    Cuttable, ExplicitBody, ExplicitDynamics, ExplicitError, Integration, InternalForces, LiveEdges,
    LiveTets, Quarantine, RestTensions, Stability, StandIn, StandIns, StiffTet, check_body, check_number,
    follow, keep,
};
use super::local_model::{self, ElementStiffness, LocalBody, LocalElements, LocalFrame, TangentLaw};
use super::tet_law::TetLaw;
use super::topology_update::{TopologyUpdate, blend_tets};
use super::{DynamicBody, RestStress, TopologyRefusal};
use crate::material::{GuardedStVenantKirchhoff, LinearElastic, NeoHookeLog};
use crate::model::explicit::Mover;
use crate::solve::{LOCAL_EDGES, MeshEdges, P1Gradients};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// What an extended mass-spring model is made from.
#[derive(Clone, Copy, Debug)]
pub struct ExtendedMassSpringParams<'a> {
    /// The body, its supports, loads and damping over inertia.
    pub body: DynamicBody<'a>,
    /// The law.
    pub law: EdgeLaw,
    /// Its Lame coefficients; the density is the body's.
    pub material: &'a LinearElastic,
    /// Viscosity c [kg/(m3 s)] (1e-3 g/(mm3 s) is 1000): relative motion decays at the rate 4 c/rho.
    pub viscosity_kg_per_m3_s: f64,
    /// Time integration.
    pub integration: Integration,
}

/// The tetrahedra, by law: chosen outside the loop over them.
#[derive(Clone, Debug)]
enum Elements {
    StVenantKirchhoff(Vec<StVenantKirchhoffTet>),
    NeoHooke(Vec<NeoHookeTet>),
}

impl Elements {
    /// The tetrahedra of a mesh at rest, of which these are the gradients.
    fn at_rest(law: EdgeLaw, material: &LinearElastic, mesh: &TetMesh, gradients: &[P1Gradients]) -> Self {
        let lame = Lame { lambda_pa: material.lambda_pa(), mu_pa: material.mu_pa() };
        let rests = mesh.tetrahedra.iter().map(|&nodes| rest_squares_m2(&mesh.positions_m, nodes));
        let with_rests = gradients.iter().zip(rests);
        match law {
            EdgeLaw::StVenantKirchhoff => Self::StVenantKirchhoff(
                with_rests.map(|(g, rest)| StVenantKirchhoffTet::new(g, rest, lame)).collect(),
            ),
            EdgeLaw::NeoHooke => {
                Self::NeoHooke(with_rests.map(|(g, rest)| NeoHookeTet::new(g, rest, lame)).collect())
            }
        }
    }
}

/// The links of the body.
#[derive(Clone, Debug)]
struct Links {
    edges: LiveEdges,
    tets: LiveTets,
    rest_m2: Vec<f64>,
    rest_tensions: RestTensions,
    /// Sum of c V0/4 [N s/m].
    viscosity_n_s_per_m: Vec<f64>,
    elements: Elements,
    /// Tetrahedra that exert no force in the part of the step under way, and how many they are.
    is_left_out: Vec<bool>,
    n_left_out: u32,
    /// What these do instead.
    stand_ins: StandIns,
    // Scratch, an entry an edge.
    growth_m2: Vec<f64>,
    tension_n_per_m: Vec<f64>,
}

impl Links {
    fn measure(&mut self, positions_m: &[DVec3]) {
        for ((growth, &[a, b]), rest) in
            self.growth_m2.iter_mut().zip(&self.edges.edges.nodes).zip(&self.rest_m2)
        {
            *growth = (positions_m[b.index()] - positions_m[a.index()]).length_squared() - rest;
        }
    }

    fn energy_j(&mut self, positions_m: &[DVec3]) -> f64 {
        fn sum<E: EdgeEnergy>(elements: &[E], of_tet: &[[u32; 6]], growth: &[f64]) -> f64 {
            let of = |(element, edges): (&E, &[u32; 6])| element.energy_j(edges.map(|e| growth[e as usize]));
            elements.iter().zip(of_tet).map(of).sum()
        }
        self.measure(positions_m);
        let edges = &self.edges.edges;
        let of_rest_j = self.rest_tensions.energy_j(&edges.nodes, positions_m, |e| self.rest_m2[e]);
        let elastic_j = match &self.elements {
            Elements::StVenantKirchhoff(elements) => sum(elements, &edges.of_tet, &self.growth_m2),
            Elements::NeoHooke(elements) => sum(elements, &edges.of_tet, &self.growth_m2),
        };
        elastic_j + of_rest_j
    }

    /// Overwrites the tension of every edge, without the tetrahedra that are left out.
    fn update_tensions(&mut self) {
        fn sum<E: EdgeEnergy>(elements: &[E], links: &LiveEdges, growth: &[f64], tension: &mut [f64]) {
            for (element, edges) in elements.iter().zip(&links.edges.of_tet) {
                add(element.tension_n_per_m(edges.map(|e| growth[e as usize])), edges, tension);
            }
        }
        fn sum_of<E: EdgeEnergy>(elements: &[E], links: &Links, tension: &mut [f64]) {
            for (t, (element, edges)) in elements.iter().zip(&links.edges.edges.of_tet).enumerate() {
                if links.is_left_out[t] {
                    let of_rest = links.rest_tensions.of_tet(t).map(|s| -s);
                    add(of_rest, edges, tension);
                } else {
                    let growth = edges.map(|e| links.growth_m2[e as usize]);
                    add(element.tension_n_per_m(growth), edges, tension);
                }
            }
        }
        fn add(tensions: [f64; 6], edges: &[u32; 6], tension: &mut [f64]) {
            for (s, &e) in tensions.iter().zip(edges) {
                tension[e as usize] += s;
            }
        }
        let mut tension = std::mem::take(&mut self.tension_n_per_m);
        self.rest_tensions.write_into(&mut tension);
        let (links, growth) = (&self.edges, &self.growth_m2);
        match (&self.elements, self.n_left_out) {
            (Elements::StVenantKirchhoff(elements), 0) => sum(elements, links, growth, &mut tension),
            (Elements::NeoHooke(elements), 0) => sum(elements, links, growth, &mut tension),
            (Elements::StVenantKirchhoff(elements), _) => sum_of(elements, self, &mut tension),
            (Elements::NeoHooke(elements), _) => sum_of(elements, self, &mut tension),
        }
        self.tension_n_per_m = tension;
    }
}

impl InternalForces for Links {
    fn add_forces(&mut self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3], force_n: &mut [DVec3]) {
        self.measure(positions_m);
        self.update_tensions();
        for (e, &[a, b]) in self.edges.edges.nodes.iter().enumerate() {
            let (a, b) = (a.index(), b.index());
            let pull_n = self.tension_n_per_m[e] * (positions_m[b] - positions_m[a])
                + self.viscosity_n_s_per_m[e] * (velocities_m_per_s[b] - velocities_m_per_s[a]);
            force_n[a] += pull_n;
            force_n[b] -= pull_n;
        }
        self.stand_ins.add_forces(positions_m, force_n);
    }

    fn quarantine(&mut self, positions_m: &[DVec3], rest_m: &[DVec3]) -> Quarantine {
        let Self { is_left_out, n_left_out, stand_ins, tets, .. } = self;
        if *n_left_out > 0 {
            is_left_out.fill(false);
        }
        let quarantine = stand_ins.find(tets, positions_m, rest_m, |t| is_left_out[t] = true);
        *n_left_out = quarantine.n_tets;
        quarantine
    }
}

/// One organ of tetrahedra that pull along their edges.
#[derive(Clone, Debug)]
pub struct ExtendedMassSpring {
    law: EdgeLaw,
    material: LinearElastic,
    /// One a tetrahedron, or none.
    rest_stress_pa: Vec<RestStress>,
    viscosity_kg_per_m3_s: f64,
    density_kg_per_m3: f64,
    body: ExplicitBody,
    links: Links,
    /// Highest frequency at rest after any removals [rad/s].
    frequency_after_cuts_rad_per_s: f64,
}

fn rest_squares_m2(mesh_positions_m: &[DVec3], nodes: [NodeId; 4]) -> [f64; 6] {
    let p = nodes.map(|n| mesh_positions_m[n.index()]);
    LOCAL_EDGES.map(|[a, b]| (p[b] - p[a]).length_squared())
}

/// What tetrahedra follow that the law would not bring back.
fn stand_in(law: EdgeLaw, material: &LinearElastic) -> StandIn {
    match law {
        EdgeLaw::StVenantKirchhoff => {
            StandIn::Guarded(GuardedStVenantKirchhoff::of_lame(material.lambda_pa(), material.mu_pa()))
        }
        EdgeLaw::NeoHooke => StandIn::Continued(material.into()),
    }
}

/// A tetrahedron's share in the stable step.
fn stiff_tet(
    material: &LinearElastic,
    gradients: &P1Gradients,
    rest_stress_pa: Option<&RestStress>,
) -> StiffTet {
    let mut at_rest = gradients.stiffness(material.lambda_pa(), material.mu_pa());
    if let Some(&stress_pa) = rest_stress_pa {
        at_rest.add_multiples(gradients.stress_stiffness_n_per_m(stress_pa));
    }
    StiffTet { at_rest, stiffening: 1.0 }
}

impl ExtendedMassSpring {
    /// Prepares every tetrahedron. The mesh must be compact: every tetrahedron of it counts as live.
    ///
    /// # Errors
    /// [`ExplicitError`]: an unusable mesh, a step above the stable one, an impossible parameter.
    pub fn build(params: &ExtendedMassSpringParams<'_>) -> Result<Self, ExplicitError> {
        let ExtendedMassSpringParams { body, law, material, viscosity_kg_per_m3_s, integration } = *params;
        check_number("viscosity [kg/(m3 s)]", viscosity_kg_per_m3_s, 0.0)?;
        check_body(&body)?;
        let mesh = body.mesh;
        let edges = MeshEdges::of_mesh(mesh)?;
        // At rest both laws have the stiffness of linear elasticity.
        let stability = Stability::of_stiffness(mesh, body.density_kg_per_m3, |tet, gradients| {
            stiff_tet(material, gradients, body.rest_stress_pa.get(tet.index()))
        })?;
        let step = stability.step;
        let n_edges = edges.nodes.len();
        let mut viscosity_n_s_per_m = vec![0.0; n_edges];
        let mut gradients = Vec::with_capacity(mesh.tetrahedra.len());
        for (t, of_tet) in edges.of_tet.iter().enumerate() {
            let of_rest = P1Gradients::of_tet(mesh, TetId::from_index(t))?;
            for edge in of_tet {
                viscosity_n_s_per_m[*edge as usize] += viscosity_kg_per_m3_s * of_rest.volume_m3 / 4.0;
            }
            gradients.push(of_rest);
        }
        let elements = Elements::at_rest(law, material, mesh, &gradients);
        let rest_m2 = edges
            .nodes
            .iter()
            .map(|&[a, b]| (mesh.positions_m[b.index()] - mesh.positions_m[a.index()]).length_squared())
            .collect();
        let strained_j = 0.5 * (material.lambda_pa() + 2.0 * material.mu_pa()) * mesh.volume_m3();
        let mut model = Self {
            law,
            material: *material,
            rest_stress_pa: body.rest_stress_pa.to_vec(),
            viscosity_kg_per_m3_s,
            density_kg_per_m3: body.density_kg_per_m3,
            body: ExplicitBody::new(&body, &integration, Some(stability), strained_j)?,
            links: Links {
                rest_tensions: RestTensions::new(&edges, gradients.into_iter(), body.rest_stress_pa),
                edges: LiveEdges::new(edges),
                tets: LiveTets::of_mesh(mesh),
                rest_m2,
                viscosity_n_s_per_m,
                elements,
                is_left_out: vec![false; mesh.tetrahedra.len()],
                stand_ins: StandIns::new(stand_in(law, material), mesh.tetrahedra.len()),
                n_left_out: 0,
                growth_m2: vec![0.0; n_edges],
                tension_n_per_m: vec![0.0; n_edges],
            },
            frequency_after_cuts_rad_per_s: 2.0 / step.after_cuts_s,
        };
        model.body.set_bounds(2.0 / step.step_s, model.viscous_rate_per_s());
        model.body.check_step()?;
        Ok(model)
    }

    /// Relative motion within a tetrahedron decays at c V0/(rho V0/4); the whole is at most that.
    fn viscous_rate_per_s(&self) -> f64 {
        4.0 * self.viscosity_kg_per_m3_s / self.density_kg_per_m3
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
        self.body.masses_kg()
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

    /// Overwrites `force_n` with what the links exert on each node at these positions and velocities, without
    /// quarantine.
    pub fn internal_forces_into(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        force_n: &mut [DVec3],
    ) {
        force_n.fill(DVec3::ZERO);
        self.links.n_left_out = 0;
        self.links.is_left_out.fill(false);
        self.links.stand_ins.clear();
        self.links.add_forces(positions_m, velocities_m_per_s, force_n);
    }

    /// Elastic energy at these positions [J].
    pub fn elastic_energy_j(&mut self, positions_m: &[DVec3]) -> f64 {
        self.links.energy_j(positions_m)
    }

    /// Elastic and kinetic energy now [J], without gravity.
    pub fn energy_j(&mut self) -> f64 {
        self.links.energy_j(self.body.positions_m()) + self.body.kinetic_energy_j()
    }

    /// How many live tetrahedra stand inverted or flat.
    pub fn n_inverted(&self) -> usize {
        let corners_m = |nodes: &[NodeId; 4]| nodes.map(|n| self.body.positions_m()[n.index()]);
        self.links.tets.iter().filter(|(_, nodes)| is_inverted(corners_m(nodes))).count()
    }

    /// All numbers that a removal changes: masses, then each edge with its viscosity, then each live tetrahedron's.
    /// For comparison with a model built anew; dead edges and tetrahedra are left out, dead nodes are zeros.
    pub fn mechanics(&self) -> [Vec<f64>; 3] {
        let live_edges = self.links.edges.is_live();
        let viscosity = self.links.viscosity_n_s_per_m.iter().zip(live_edges);
        let live_tets = self.links.tets.iter().map(|(t, _)| t);
        let elements: Vec<f64> = match &self.links.elements {
            Elements::StVenantKirchhoff(elements) => live_tets.flat_map(|t| elements[t].numbers()).collect(),
            Elements::NeoHooke(elements) => live_tets.flat_map(|t| elements[t].numbers()).collect(),
        };
        [
            self.body.masses_kg().to_vec(),
            viscosity.filter(|(_, live)| *live).map(|(c, _)| *c).collect(),
            elements,
        ]
    }
}

impl Cuttable for ExtendedMassSpring {
    const NAME: &'static str = "extended_mass_spring";

    fn tets(&self) -> &LiveTets {
        &self.links.tets
    }

    fn tets_mut(&mut self) -> &mut LiveTets {
        &mut self.links.tets
    }

    fn rest_m(&self) -> &[DVec3] {
        self.body.rest_m()
    }

    fn remove_tet(&mut self, t: usize) {
        let links = &mut self.links;
        let nodes = links.tets.nodes[t];
        match &mut links.elements {
            Elements::StVenantKirchhoff(elements) => elements[t] = EdgeEnergy::nothing(),
            Elements::NeoHooke(elements) => elements[t] = EdgeEnergy::nothing(),
        }
        // The rest positions are those from when it was added, so these are the numbers that were added then.
        let volume_m3 = links.tets.gradients(t, self.body.rest_m()).volume_m3;
        self.body.remove_tet(nodes, volume_m3);
        links.n_left_out -= u32::from(std::mem::take(&mut links.is_left_out[t]));
        for (local, edge) in links.edges.edges.of_tet[t].into_iter().enumerate() {
            let e = edge as usize;
            let stays = links.edges.take_tet(e);
            links.rest_tensions.remove(t, local, e, stays);
            if stays {
                links.viscosity_n_s_per_m[e] -= self.viscosity_kg_per_m3_s * volume_m3 / 4.0;
            } else {
                links.viscosity_n_s_per_m[e] = 0.0;
            }
        }
    }

    fn after_removals(&mut self) {
        let (frequency_rad_per_s, viscosity_per_s) =
            (self.frequency_after_cuts_rad_per_s, self.viscous_rate_per_s());
        let tets = &self.links.tets;
        self.body.set_bounds_after_removals(
            frequency_rad_per_s,
            viscosity_per_s,
            |nodes, allowed_rad_per_s| {
                nodes.scale_tets(allowed_rad_per_s, tets);
            },
        );
    }

    fn grow(&mut self, mesh: &TetMesh, change: &TopologyChange, growth: &TopologyUpdate) {
        self.body.grow(mesh, change, growth);
        blend_tets(&mut self.rest_stress_pa, change);
        let links = &mut self.links;
        links.is_left_out.resize(growth.n_tets, false);
        links.stand_ins.make_room(growth.n_tets);
        let insertions = links.edges.grow(&links.tets, &growth.added);
        insertions.spread(&mut links.rest_m2, 0.0);
        insertions.spread(&mut links.viscosity_n_s_per_m, 0.0);
        insertions.spread(&mut links.growth_m2, 0.0);
        insertions.spread(&mut links.tension_n_per_m, 0.0);
        links.rest_tensions.grow(&insertions, growth.n_tets);
        match &mut links.elements {
            Elements::StVenantKirchhoff(elements) => elements.resize(growth.n_tets, EdgeEnergy::nothing()),
            Elements::NeoHooke(elements) => elements.resize(growth.n_tets, EdgeEnergy::nothing()),
        }
        let has_new_place = growth.has_new_place();
        for (rest_m2, nodes) in links.rest_m2.iter_mut().zip(&links.edges.edges.nodes) {
            if *rest_m2 == 0.0 || nodes.iter().any(|n| has_new_place[n.index()]) {
                let [a, b] = nodes.map(|n| mesh.positions_m[n.index()]);
                *rest_m2 = (b - a).length_squared();
            }
        }
    }

    fn add_tet(&mut self, t: usize) {
        let links = &mut self.links;
        let nodes = links.tets.nodes[t];
        let gradients = links.tets.gradients(t, self.body.rest_m());
        let rest_m2 = rest_squares_m2(self.body.rest_m(), nodes);
        let lame = Lame { lambda_pa: self.material.lambda_pa(), mu_pa: self.material.mu_pa() };
        match &mut links.elements {
            Elements::StVenantKirchhoff(elements) => {
                elements[t] = StVenantKirchhoffTet::new(&gradients, rest_m2, lame);
            }
            Elements::NeoHooke(elements) => elements[t] = NeoHookeTet::new(&gradients, rest_m2, lame),
        }
        links.edges.add_tet(t);
        let edges = links.edges.edges.of_tet[t];
        for edge in edges {
            links.viscosity_n_s_per_m[edge as usize] +=
                self.viscosity_kg_per_m3_s * gradients.volume_m3 / 4.0;
        }
        let rest_stress_pa = self.rest_stress_pa.get(t);
        if let Some(&stress_pa) = rest_stress_pa {
            links.rest_tensions.add_tet(t, &edges, &gradients, stress_pa);
        }
        let stiff = stiff_tet(&self.material, &gradients, rest_stress_pa);
        self.body.add_tet(t, nodes, gradients.volume_m3, Some(&stiff));
    }

    fn after_growth(&mut self) {
        let highest_rad_per_s = self.body.highest_tet_rad_per_s(&self.links.tets.is_live);
        if highest_rad_per_s > 0.0 {
            self.frequency_after_cuts_rad_per_s = highest_rad_per_s;
        }
        self.after_removals();
    }

    fn compact(&mut self, new_ids: &[Option<NodeId>]) {
        let links = &mut self.links;
        let live_tets = &links.tets.is_live;
        let live_edges = links.edges.compact(new_ids, live_tets);
        keep(&mut links.rest_m2, &live_edges);
        keep(&mut links.viscosity_n_s_per_m, &live_edges);
        keep(&mut links.growth_m2, &live_edges);
        keep(&mut links.tension_n_per_m, &live_edges);
        links.rest_tensions.compact(&live_edges, live_tets);
        keep(&mut links.is_left_out, live_tets);
        if !self.rest_stress_pa.is_empty() {
            keep(&mut self.rest_stress_pa, live_tets);
        }
        match &mut links.elements {
            Elements::StVenantKirchhoff(elements) => keep(elements, live_tets),
            Elements::NeoHooke(elements) => keep(elements, live_tets),
        }
        self.body.compact(new_ids, live_tets);
    }
}

impl LocalBody for ExtendedMassSpring {
    fn elements(&self) -> LocalElements<'_> {
        LocalElements::Tets(&self.links.tets.nodes)
    }

    fn is_live(&self, element: usize) -> bool {
        self.links.tets.is_live[element]
    }

    /// The tangent of the law with the same energy, or of what stands in for it, and the viscosity of its edges.
    fn stiffness(&self, element: usize, period_s: f64) -> ElementStiffness {
        let nodes = self.links.tets.nodes[element];
        let rest_m = nodes.map(|n| self.body.rest_m()[n.index()]);
        let gradients = self.links.tets.gradients(element, self.body.rest_m());
        let at_m = nodes.map(|n| self.body.positions_m()[n.index()]);
        let u_m = std::array::from_fn(|k| at_m[k] - rest_m[k]);
        let neo_hooke = NeoHookeLog::from(&self.material);
        let stand_in = self.links.stand_ins.stand_in();
        let law = match self.law {
            _ if stand_in.takes(nodes, self.body.positions_m(), self.body.rest_m()) => {
                TangentLaw::Any(stand_in.law())
            }
            EdgeLaw::StVenantKirchhoff => TangentLaw::Kirchhoff(TetLaw::isotropic(&self.material)),
            EdgeLaw::NeoHooke => TangentLaw::Any(&neo_hooke),
        };
        let rest_stress_pa = self.rest_stress_pa.get(element);
        let mut stiffness = local_model::tet_tangent(&gradients, u_m, &law, rest_stress_pa);
        let viscosity = self.viscosity_kg_per_m3_s * gradients.volume_m3 / 4.0 / period_s;
        for (j, row) in stiffness.iter_mut().enumerate() {
            for (k, block) in row.iter_mut().enumerate() {
                let share = if j == k { 3.0 } else { -1.0 };
                *block += DMat3::from_diagonal(DVec3::splat(share * viscosity));
            }
        }
        stiffness
    }

    fn frame(&self) -> &dyn LocalFrame {
        &self.body
    }

    fn velocity_m_per_s(&self, n: usize) -> DVec3 {
        self.body.state().velocities_m_per_s[n]
    }
}

impl ExplicitDynamics for ExtendedMassSpring {
    type Mover = ExplicitBody;

    fn mover(&self) -> &ExplicitBody {
        &self.body
    }

    fn mover_mut(&mut self) -> &mut ExplicitBody {
        &mut self.body
    }

    fn advance(&mut self, dt_s: f64) {
        self.body.step(dt_s, &mut self.links);
    }

    fn follow_change(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        follow(self, mesh, change)
    }
}
