//! A body moved by one of the schemes of [`crate::solve::integrators`].
//!
//! A model gives the forces of its links ([`InternalForces`]). Node i has the weight of its mass m_i and an inertia,
//! which is m_i or, with [`Inertia::Unit`], the same for every node (seed `003` s. 3.4); then only states at rest are
//! physical.
//!
//! Held nodes move evenly to where they are held. The force on them is the one that balances link forces, weight
//! and outer forces at the last evaluation of the scheme, without the held node's own inertia.
//!
//! The part b K of Rayleigh's damping comes from the link forces at x + b v, with the velocity that the scheme evaluates
//! them with. A mode then has the further damping over mass b omega^2, which the bounds of the schemes count as
//! viscosity.

use super::cuttable::LiveTets;
use super::dynamics::Mover;
use super::frame::{Frame, Quarantine, Sliding};
use super::mass_shares::StiffTet;
use super::stable::{MARGIN, Stability};
use super::{ExplicitError, keep};
use crate::model::local_model::LocalFrame;
use crate::model::topology_update::TopologyUpdate;
use crate::model::{
    Attachment, Constraints, Correction, DynamicBody, ModelReport, ModelState, NodalForce, Rayleigh,
};
use crate::solve::integrators::{EquationsOfMotion, FixedPoint, Integrator, ModeBounds, Motion, Scheme};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// What resists the acceleration of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inertia {
    /// Its mass.
    Mass,
    /// The same for every node, the mean mass: better conditioned, and only states at rest are physical.
    Unit,
}

/// How a body's motion is integrated in time.
#[derive(Clone, Copy, Debug)]
pub struct Integration {
    /// The time integration.
    pub scheme: Scheme,
    /// When an implicit step is found.
    pub fixed_point: FixedPoint,
    /// What resists acceleration.
    pub inertia: Inertia,
    /// How many times its value at rest the highest frequency may become under deformation, at least 1; it
    /// divides the stable step.
    pub frequency_reserve: f64,
}

impl Default for Integration {
    /// Semi-implicit Euler with true masses.
    fn default() -> Self {
        Self {
            scheme: Scheme::SemiImplicitEuler,
            fixed_point: FixedPoint::default(),
            inertia: Inertia::Mass,
            frequency_reserve: 1.0,
        }
    }
}

/// Checks a number that must be finite and at least `least`.
pub(in crate::model) fn check_number(
    what: &'static str,
    found: f64,
    least: f64,
) -> Result<(), ExplicitError> {
    if found.is_finite() && found >= least {
        return Ok(());
    }
    let allowed = if least == 0.0 { "a finite number from 0" } else { "a finite number from 1" };
    Err(ExplicitError::Parameter { what, found, allowed })
}

/// The forces between the nodes of a body.
pub(in crate::model) trait InternalForces {
    /// Adds the force [N] that the links exert on each node.
    fn add_forces(&mut self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3], force_n: &mut [DVec3]);

    /// Chooses, at the begin of a part, the tetrahedra that exert other forces in it than their own.
    fn quarantine(&mut self, positions_m: &[DVec3], rest_m: &[DVec3]) -> Quarantine;
}

/// Nodes in motion.
#[derive(Clone, Debug)]
pub(in crate::model) struct ExplicitBody {
    frame: Frame,
    integrator: Integrator,
    inertia: Inertia,
    frequency_reserve: f64,
    /// How many times the mean mass the inertia of every node is, with [`Inertia::Unit`].
    unit_factor: f64,

    inertia_kg: Vec<f64>,
    /// Takes load and is not held.
    moves: Vec<bool>,
    node_damping_per_s: Vec<f64>,

    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    // Scratch.
    force_n: Vec<DVec3>,
    before_m: Vec<DVec3>,
    ahead_m: Vec<DVec3>,
    missed_fixed_points: u64,
}

impl ExplicitBody {
    /// Nodes at rest. `full_strain_energy_j`: elastic energy with every link or tetrahedron strained by 1;
    /// `stability`: of models whose tetrahedra have frequencies.
    pub(in crate::model) fn new(
        body: &DynamicBody<'_>,
        integration: &Integration,
        stability: Option<Stability>,
        full_strain_energy_j: f64,
    ) -> Result<Self, ExplicitError> {
        check_number("frequency reserve", integration.frequency_reserve, 1.0)?;
        let mut frame = Frame::new(body, full_strain_energy_j)?;
        if let Some(stability) = stability {
            frame.keep_frequencies(stability);
        }
        let n_nodes = frame.n_nodes();
        let n_ahead = if body.damping.stiffness_s > 0.0 { n_nodes } else { 0 };
        let mut body = Self {
            integrator: Integrator::new(integration.scheme, integration.fixed_point, n_nodes),
            inertia: integration.inertia,
            frequency_reserve: integration.frequency_reserve,
            unit_factor: 1.0,
            inertia_kg: vec![0.0; n_nodes],
            moves: vec![false; n_nodes],
            node_damping_per_s: vec![body.damping.mass_per_s; n_nodes],
            positions_m: frame.rest_m.clone(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            force_n: vec![DVec3::ZERO; n_nodes],
            before_m: vec![DVec3::ZERO; n_nodes],
            ahead_m: vec![DVec3::ZERO; n_ahead],
            missed_fixed_points: 0,
            frame,
        };
        body.masses_changed();
        Ok(body)
    }

    /// Bounds of the body's modes when the links alone have, with the true masses, at most this frequency and
    /// viscous damping over mass.
    fn mode_bounds(&self, frequency_rad_per_s: f64, viscosity_per_s: f64) -> ModeBounds {
        // x^T K x <= omega^2 x^T M x <= omega^2 (largest m_i/inertia_i) x^T I x.
        let lightness = if self.inertia == Inertia::Mass {
            1.0
        } else {
            let ratio = |n: usize| self.frame.inertia_kg(n) / self.inertia_kg[n];
            let live = (0..self.inertia_kg.len()).filter(|&n| self.inertia_kg[n] > 0.0);
            live.map(ratio).fold(0.0, f64::max)
        };
        let links_per_s2 = (frequency_rad_per_s * frequency_rad_per_s)
            * lightness
            * (self.frequency_reserve * self.frequency_reserve);
        let all_per_s2 =
            links_per_s2 + self.frame.attachment_squared_frequency_per_s2(|n| self.inertia_kg[n]);
        ModeBounds {
            highest_frequency_rad_per_s: all_per_s2.sqrt(),
            damping_per_s: [self.frame.damping.mass_per_s; 2],
            viscosity_per_s: viscosity_per_s * lightness + self.frame.damping.stiffness_s * links_per_s2,
        }
    }

    /// Takes over the highest frequency and viscous damping of the links.
    pub(in crate::model) fn set_bounds(&mut self, frequency_rad_per_s: f64, viscosity_per_s: f64) {
        let bounds = self.mode_bounds(frequency_rad_per_s, viscosity_per_s);
        self.frame.stable_step_s = self.integrator.scheme().stable_step_s(&bounds);
    }

    /// Takes over bounds after removals. Where the most parts would not suffice, nodes become heavier: `scale` is
    /// told the largest frequency [rad/s] that the links may have by themselves and sees to it.
    pub(in crate::model) fn set_bounds_after_removals(
        &mut self,
        frequency_rad_per_s: f64,
        viscosity_per_s: f64,
        scale: impl FnOnce(&mut HeavierNodes<'_>, f64),
    ) {
        self.frame.let_loose_nodes_go();
        self.frame.forget_scaling();
        self.unit_factor = 1.0;
        self.masses_changed();
        self.set_bounds(frequency_rad_per_s, viscosity_per_s);
        let least_s = self.frame.least_stable_step_s();
        if self.frame.stable_step_s >= least_s {
            return;
        }
        let scheme = self.integrator.scheme();
        let bounds = self.mode_bounds(frequency_rad_per_s, viscosity_per_s);
        let step_s = |factor: f64| {
            let highest = bounds.highest_frequency_rad_per_s * factor;
            // Damping of links shrinks with their squared frequency, or faster.
            let viscosity_per_s = bounds.viscosity_per_s * factor * factor;
            scheme.stable_step_s(&ModeBounds {
                highest_frequency_rad_per_s: highest,
                viscosity_per_s,
                ..bounds
            })
        };
        let mut factor = 1.0;
        while step_s(factor) < least_s && factor > LEAST_FACTOR {
            factor *= OVERSHOOT * (step_s(factor) / least_s).clamp(0.5, 1.0);
        }
        if self.inertia == Inertia::Unit {
            self.unit_factor = 1.0 / (factor * factor);
            self.frame.note_all_scaled();
        } else {
            let allowed = bounds.highest_frequency_rad_per_s * factor;
            let of_links_per_s2 = self.frame.scale_attached(allowed * allowed);
            let allowed_rad_per_s = of_links_per_s2.sqrt() / self.frequency_reserve;
            scale(&mut HeavierNodes { frame: &mut self.frame }, allowed_rad_per_s);
        }
        self.masses_changed();
        self.frame.stable_step_s = least_s;
    }

    /// Refuses a step above the stable one.
    pub(in crate::model) fn check_step(&self) -> Result<(), ExplicitError> {
        if self.frame.time_step_s <= self.frame.stable_step_s {
            return Ok(());
        }
        Err(ExplicitError::UnstableScheme {
            scheme: self.integrator.scheme().name(),
            found_s: self.frame.time_step_s,
            allowed_s: self.frame.stable_step_s,
        })
    }

    pub(in crate::model) fn stable_step_s(&self) -> f64 {
        self.frame.stable_step_s
    }

    pub(in crate::model) fn time_step_s(&self) -> f64 {
        self.frame.time_step_s
    }

    pub(in crate::model) fn frame(&self) -> &Frame {
        &self.frame
    }

    pub(in crate::model) fn n_nodes(&self) -> usize {
        self.frame.n_nodes()
    }

    pub(in crate::model) fn rest_m(&self) -> &[DVec3] {
        &self.frame.rest_m
    }

    pub(in crate::model) fn masses_kg(&self) -> &[f64] {
        &self.frame.mass_kg
    }

    /// Divides the mass anew; [`ExplicitBody::masses_changed`] has to follow.
    pub(in crate::model) fn masses_kg_mut(&mut self) -> &mut [f64] {
        &mut self.frame.mass_kg
    }

    /// Live tetrahedra at each node.
    pub(in crate::model) fn node_tets(&self) -> &[u32] {
        &self.frame.node_tets
    }

    pub(in crate::model) fn positions_m(&self) -> &[DVec3] {
        &self.positions_m
    }

    pub(in crate::model) fn ignored_constraints(&self) -> usize {
        self.frame.ignored_constraints()
    }

    pub(in crate::model) fn missed_fixed_points(&self) -> u64 {
        self.missed_fixed_points
    }

    pub(in crate::model) fn parts_of_step(&self, dt_s: f64) -> u64 {
        self.frame.parts_of_step(dt_s)
    }

    /// Makes inertias and flags follow the masses.
    pub(in crate::model) fn masses_changed(&mut self) {
        let masses_kg = &self.frame.mass_kg;
        let n_live = masses_kg.iter().filter(|m| **m > 0.0).count().max(1);
        let unit_kg = self.unit_factor * masses_kg.iter().sum::<f64>() / n_live as f64;
        for i in 0..masses_kg.len() {
            let live = self.frame.node_tets[i] > 0;
            self.inertia_kg[i] = match self.inertia {
                _ if !live => 0.0,
                Inertia::Mass => self.frame.inertia_kg(i),
                Inertia::Unit => unit_kg,
            };
            if !live {
                self.velocities_m_per_s[i] = DVec3::ZERO;
            }
        }
        self.update_moves();
    }

    fn update_moves(&mut self) {
        for (n, moves) in self.moves.iter_mut().enumerate() {
            *moves = self.frame.takes_load(n);
        }
        for held in self.frame.held.iter() {
            self.moves[held.node as usize] = false;
        }
    }

    /// Holds a node where it is from now on.
    pub(in crate::model) fn fix_in_place(&mut self, node: NodeId) {
        if self.frame.fix(node) {
            self.velocities_m_per_s[node.index()] = DVec3::ZERO;
            self.update_moves();
        }
    }

    /// Advances by `dt_s` in the fewest equal parts that are not longer than the time step and the stable step.
    pub(in crate::model) fn step(&mut self, dt_s: f64, forces: &mut impl InternalForces) {
        let Some((n_parts, h_s)) = self.frame.begin_step(dt_s) else { return };
        for held in self.frame.held.iter_mut() {
            held.start_m = self.positions_m[held.node as usize] - self.frame.rest_m[held.node as usize];
        }
        let mut last_kinetic_j = self.free_kinetic_j();
        for part in 1..=n_parts {
            self.before_m.copy_from_slice(&self.positions_m);
            for held in self.frame.held.iter() {
                let n = held.node as usize;
                let at_m = self.frame.rest_m[n] + held.at_m(part, n_parts);
                self.velocities_m_per_s[n] = (at_m - self.positions_m[n]) / h_s;
                self.positions_m[n] = at_m;
            }
            self.frame.note_quarantine(forces.quarantine(&self.positions_m, &self.frame.rest_m));
            let mut equations = Newton {
                forces,
                force_n: &mut self.force_n,
                ahead_m: &mut self.ahead_m,
                stiffness_s: self.frame.damping.stiffness_s,
                outer_forces: &self.frame.outer_forces,
                attachments: &self.frame.attachments,
                sliding: &self.frame.sliding,
                mass_kg: &self.frame.mass_kg,
                inertia_kg: &self.inertia_kg,
                gravity_m_per_s2: self.frame.gravity_m_per_s2,
            };
            let mut motion = Motion {
                positions_m: &mut self.positions_m,
                velocities_m_per_s: &mut self.velocities_m_per_s,
                moves: &self.moves,
                damping_per_s: &self.node_damping_per_s,
            };
            let effort = self.integrator.step(&mut equations, &mut motion, h_s);
            if effort.missed_fixed_point {
                self.missed_fixed_points += 1;
                self.frame.note_missed_tolerance();
            }
            for at in 0..self.frame.held.len() {
                let held = self.frame.held[at];
                let force_n = held.on_tool_n(-self.force_n[held.node as usize]);
                self.frame.constraint_forces_n[held.place as usize] = force_n;
            }
            if let Some(furthest_m) = self.frame.furthest_m(h_s) {
                self.limit_ways(furthest_m, h_s);
            }
            let mut kinetic_j = self.free_kinetic_j();
            if !self.frame.is_plain_growth(last_kinetic_j, kinetic_j) {
                kinetic_j = self.put_right(last_kinetic_j);
            }
            last_kinetic_j = kinetic_j;
        }
    }

    /// No node goes further in a part than that.
    #[cold]
    fn limit_ways(&mut self, furthest_m: f64, h_s: f64) {
        let mut is_any = false;
        for n in (0..self.moves.len()).filter(|&n| self.moves[n]) {
            let way_m = self.positions_m[n] - self.before_m[n];
            if way_m.length_squared() > furthest_m * furthest_m {
                self.positions_m[n] = self.before_m[n] + way_m.clamp_length_max(furthest_m);
                self.velocities_m_per_s[n] = self.velocities_m_per_s[n].clamp_length_max(furthest_m / h_s);
                is_any = true;
            }
        }
        if is_any {
            self.integrator.restart();
            self.frame.note_limited_energy();
        }
    }

    fn free_kinetic_j(&self) -> f64 {
        let free = (0..self.moves.len()).filter(|&n| self.moves[n]);
        free.map(|n| 0.5 * self.inertia_kg[n] * self.velocities_m_per_s[n].length_squared()).sum()
    }

    /// What a part may have gone wrong with: places that are no numbers, and energy from nowhere.
    #[cold]
    fn put_right(&mut self, last_kinetic_j: f64) -> f64 {
        let mut n_recovered = 0;
        for n in 0..self.moves.len() {
            let (x, v) = (self.positions_m[n], self.velocities_m_per_s[n]);
            let energy_j = self.inertia_kg[n] * v.length_squared();
            if !(x.is_finite() && v.is_finite() && energy_j.is_finite()) {
                self.positions_m[n] = self.before_m[n];
                self.velocities_m_per_s[n] = DVec3::ZERO;
                self.frame.note_recovered_node();
                n_recovered += 1;
            }
        }
        let free_j = self.free_kinetic_j();
        let (before, now) = (&self.before_m, &self.positions_m);
        let work_j = self.frame.outside_work_j(|n| before[n], |n| now[n] - before[n]);
        let limited = self.frame.limited_kinetic_j(last_kinetic_j, free_j, work_j);
        if let Some(allowed_j) = limited {
            let slower = (allowed_j / free_j).sqrt();
            for n in (0..self.moves.len()).filter(|&n| self.moves[n]) {
                self.velocities_m_per_s[n] *= slower;
                self.positions_m[n] = self.before_m[n].lerp(self.positions_m[n], slower);
            }
        }
        // Earlier positions of multi-step schemes do not fit any more.
        if limited.is_some() || n_recovered > 0 {
            self.integrator.restart();
        }
        limited.unwrap_or(free_j)
    }

    /// Sets the velocities of nodes that move freely [m/s].
    pub(in crate::model) fn set_velocities(&mut self, velocities_m_per_s: &[DVec3]) {
        for (n, &v) in velocities_m_per_s.iter().enumerate() {
            if self.moves[n] {
                self.velocities_m_per_s[n] = v;
            }
        }
        for slides in &self.frame.sliding {
            for axis in (0..3).filter(|&axis| slides.supported[axis]) {
                self.velocities_m_per_s[slides.node as usize][axis] = 0.0;
            }
        }
        self.integrator.restart();
    }

    /// Kinetic energy 1/2 sum inertia v^2 [J].
    pub(in crate::model) fn kinetic_energy_j(&self) -> f64 {
        let of_node = |(m, v): (&f64, &DVec3)| 0.5 * m * v.length_squared();
        self.inertia_kg.iter().zip(&self.velocities_m_per_s).map(of_node).sum()
    }

    /// Takes the masses of one tetrahedron out; [`ExplicitBody::masses_changed`] has to follow.
    pub(in crate::model) fn remove_tet(&mut self, nodes: [NodeId; 4], volume_m3: f64) {
        self.frame.remove_tet(nodes, volume_m3);
    }

    /// Adds the masses of one tetrahedron; [`ExplicitBody::masses_changed`] has to follow. `stiff`: of models whose
    /// tetrahedra have frequencies.
    pub(in crate::model) fn add_tet(
        &mut self,
        t: usize,
        nodes: [NodeId; 4],
        volume_m3: f64,
        stiff: Option<&StiffTet>,
    ) {
        let corner_kg = 0.25 * self.frame.density_kg_per_m3() * volume_m3;
        let of_tet = stiff.map_or(0.0, |stiff| stiff.squared_frequency_per_s2([corner_kg; 4]));
        self.frame.add_tet(t, nodes, volume_m3, of_tet);
    }

    /// Room for what an edit brings in; new and moved nodes are at their places afterwards. A scheme of several steps
    /// begins anew: earlier positions do not fit any more.
    pub(in crate::model) fn grow(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        growth: &TopologyUpdate,
    ) {
        let n_nodes = growth.n_nodes;
        let displaced: Vec<DVec3> =
            self.positions_m.iter().zip(&self.frame.rest_m).map(|(x, rest)| *x - *rest).collect();
        self.frame.grow(mesh, change, growth);
        let supports = |n: usize| self.frame.supports(n);
        let places = growth.displacements_m(|n| displaced[n], supports);
        let velocities = growth.velocities(|n| self.velocities_m_per_s[n], supports);
        self.inertia_kg.resize(n_nodes, 0.0);
        self.moves.resize(n_nodes, false);
        self.node_damping_per_s.resize(n_nodes, self.frame.damping.mass_per_s);
        self.positions_m.resize(n_nodes, DVec3::ZERO);
        self.velocities_m_per_s.resize(n_nodes, DVec3::ZERO);
        self.force_n.resize(n_nodes, DVec3::ZERO);
        self.before_m.resize(n_nodes, DVec3::ZERO);
        if self.frame.damping.stiffness_s > 0.0 {
            self.ahead_m.resize(n_nodes, DVec3::ZERO);
        }
        places.into_iter().for_each(|(n, u_m)| self.positions_m[n] = self.frame.rest_m[n] + u_m);
        velocities.into_iter().for_each(|(n, v)| self.velocities_m_per_s[n] = v);
        self.integrator.resize(n_nodes);
    }

    /// Highest frequency of a live tetrahedron by itself [rad/s]: a bound of the whole after any cuts.
    pub(in crate::model) fn highest_tet_rad_per_s(&self, is_live: &[bool]) -> f64 {
        self.frame.highest_tet_per_s2(is_live).sqrt() / MARGIN
    }

    /// Drops dead nodes after a compaction. Constraints are dropped with their node numbers.
    pub(in crate::model) fn compact(&mut self, new_ids: &[Option<NodeId>], live_tets: &[bool]) {
        let stays: Vec<bool> = new_ids.iter().map(Option::is_some).collect();
        self.frame.compact(new_ids, live_tets);
        keep(&mut self.inertia_kg, &stays);
        keep(&mut self.moves, &stays);
        keep(&mut self.node_damping_per_s, &stays);
        keep(&mut self.positions_m, &stays);
        keep(&mut self.velocities_m_per_s, &stays);
        keep(&mut self.force_n, &stays);
        keep(&mut self.before_m, &stays);
        if !self.ahead_m.is_empty() {
            keep(&mut self.ahead_m, &stays);
        }
        self.update_moves();
        let history = self.integrator.history().to_vec();
        let n_before = stays.len();
        self.integrator.resize(self.frame.n_nodes());
        // History: ages of three numbers a node, and one number at the end.
        let mut kept: Vec<f64> = history[..history.len() - 1]
            .chunks_exact(3)
            .enumerate()
            .filter(|(at, _)| stays[at % n_before])
            .flat_map(|(_, xyz)| xyz.iter().copied())
            .collect();
        kept.extend(history.last());
        self.integrator.set_history(&kept);
    }
}

impl Mover for ExplicitBody {
    fn apply(&mut self, constraints: &Constraints) {
        self.frame.apply(constraints);
        // A node that is let go keeps its velocity.
        self.update_moves();
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        numbers.extend_from_slice(self.integrator.history());
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.frame.constraint_forces_n
    }

    /// Starts at standstill; fixed nodes stay where they are, those whose place is no number where they rest.
    fn take_over(&mut self, positions_m: &[DVec3]) {
        assert_eq!(positions_m.len(), self.n_nodes(), "one position a node");
        for (n, &position_m) in positions_m.iter().enumerate() {
            if !self.frame.is_fixed[n] {
                let rest_m = self.frame.rest_m[n];
                let mut at_m = if position_m.is_finite() { position_m } else { rest_m };
                if let Ok(at) = self.frame.sliding.binary_search_by_key(&(n as u32), |s| s.node) {
                    let supported = self.frame.sliding[at].supported;
                    for axis in (0..3).filter(|&axis| supported[axis]) {
                        at_m[axis] = self.positions_m[n][axis];
                    }
                }
                self.positions_m[n] = at_m;
            }
        }
        self.velocities_m_per_s.fill(DVec3::ZERO);
        self.frame.constraint_forces_n.fill(DVec3::ZERO);
        self.integrator.restart();
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.frame.set_gravity(gravity_m_per_s2);
    }

    fn report(&self) -> ModelReport {
        self.frame.report(self.kinetic_energy_j())
    }

    /// Displacement of a node for a unit force along each axis in a step [m/N].
    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3 {
        let n = node.index();
        if n >= self.n_nodes() || !self.moves[n] || self.inertia_kg[n] <= 0.0 {
            return DVec3::ZERO;
        }
        let free = self.frame.free_axes(n).map(|is_free| f64::from(u8::from(is_free)));
        DVec3::from_array(free) * (dt_s * dt_s / self.inertia_kg[n])
    }

    /// What further forces would have done in the last step.
    fn correct(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        for force in forces {
            let n = force.node.index();
            let move_m = self.node_answer_m_per_n(force.node, dt_s) * force.force_n;
            if move_m != DVec3::ZERO && move_m.is_finite() {
                self.positions_m[n] += move_m;
                if correction == Correction::Motion {
                    self.velocities_m_per_s[n] += move_m / dt_s;
                }
            }
        }
    }
}

/// No frequency is brought down by more than this factor: damping alone may ask for a shorter step.
const LEAST_FACTOR: f64 = 1e-6;

/// Ends the search for the allowed frequency in a few rounds.
const OVERSHOOT: f64 = 0.99;

/// What a model may do to keep the step of its body stable.
pub(in crate::model) struct HeavierNodes<'a> {
    frame: &'a mut Frame,
}

impl HeavierNodes<'_> {
    /// Makes tetrahedra so heavy that none alone is above this frequency.
    pub(in crate::model) fn scale_tets(&mut self, allowed_rad_per_s: f64, tets: &LiveTets) {
        self.frame.scale_tets(allowed_rad_per_s * allowed_rad_per_s, tets);
    }

    /// Makes a node at least as heavy as this.
    pub(in crate::model) fn at_least(&mut self, n: usize, inertia_kg: f64) {
        let missing_kg = inertia_kg - self.frame.inertia_kg(n);
        self.frame.add_inertia(n, missing_kg);
    }
}

/// a = (link forces + outer forces)/inertia + (mass/inertia) gravity, zero along supports. `force_n` keeps the sum of
/// the forces.
struct Newton<'a, F> {
    forces: &'a mut F,
    force_n: &'a mut [DVec3],
    ahead_m: &'a mut [DVec3],
    stiffness_s: f64,
    outer_forces: &'a [(u32, DVec3)],
    attachments: &'a [Attachment],
    sliding: &'a [Sliding],
    mass_kg: &'a [f64],
    inertia_kg: &'a [f64],
    gravity_m_per_s2: DVec3,
}

impl<F: InternalForces> EquationsOfMotion for Newton<'_, F> {
    fn accelerations_into(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        accelerations_m_per_s2: &mut [DVec3],
    ) {
        for (force, mass_kg) in self.force_n.iter_mut().zip(self.mass_kg) {
            *force = *mass_kg * self.gravity_m_per_s2;
        }
        for &(n, force_n) in self.outer_forces {
            self.force_n[n as usize] += force_n;
        }
        for ligament in self.attachments {
            let n = ligament.node.index();
            self.force_n[n] += ligament.force_n(positions_m[n]);
        }
        if self.ahead_m.is_empty() {
            self.forces.add_forces(positions_m, velocities_m_per_s, self.force_n);
        } else {
            for ((ahead, x), v) in self.ahead_m.iter_mut().zip(positions_m).zip(velocities_m_per_s) {
                *ahead = *x + self.stiffness_s * *v;
            }
            self.forces.add_forces(self.ahead_m, velocities_m_per_s, self.force_n);
        }
        for slides in self.sliding {
            for axis in (0..3).filter(|&axis| slides.supported[axis]) {
                self.force_n[slides.node as usize][axis] = 0.0;
            }
        }
        for n in 0..self.force_n.len() {
            let inertia_kg = self.inertia_kg[n];
            accelerations_m_per_s2[n] =
                if inertia_kg > 0.0 { self.force_n[n] / inertia_kg } else { DVec3::ZERO };
        }
    }
}

impl LocalFrame for ExplicitBody {
    /// What the scheme accelerates at a node, zero without a tetrahedron.
    fn inertia_kg(&self, n: usize) -> f64 {
        self.inertia_kg[n]
    }

    fn free_axes(&self, n: usize) -> [bool; 3] {
        self.frame.free_axes(n)
    }

    fn is_held(&self, n: usize) -> bool {
        self.frame.is_held(n)
    }

    fn load_on_n(&self, n: usize) -> DVec3 {
        self.frame.load_on_n(n)
    }

    fn damping(&self) -> Rayleigh {
        self.frame.damping
    }
}
