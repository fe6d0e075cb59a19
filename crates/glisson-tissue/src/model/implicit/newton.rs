//! One step: Newton's method, conjugate gradients, line search.

use super::elements::{Elements, Recovery};
use super::lagged::{Lagged, Slice};
use super::lagged_state::{LaggedState, NodeTerms};
use super::params::Preconditioner;
use super::successor::Successor;
use super::{FactorAge, ImplicitEuler, VolumeResistance};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::TetId;

/// How a step ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImplicitStatus {
    /// The residual is below the tolerance and every held node is at its target.
    #[default]
    Converged,
    /// The residual stayed above the tolerance, or rounding hid any further progress.
    NotConverged,
    /// Held nodes could not reach their targets without a tetrahedron in which the law has no energy.
    HeldNodesStopped,
    /// The shape at the start has no finite energy under any law (its numbers are too large): the body does not move until it
    /// gets another shape.
    Unusable,
}

/// Report on a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImplicitReport {
    /// How it ended.
    pub status: ImplicitStatus,
    /// Residual over applied, inertial and holding forces at the end.
    pub residual_share: f64,
    /// Newton iterations.
    pub newton_iterations: u32,
    /// Conjugate gradient iterations of all of them.
    pub cg_iterations: u32,
    /// Factors that came to serve.
    pub n_factors: u32,
    /// Whether a factor is being made over several steps at the end.
    pub factor_is_pending: bool,
    /// Share of their displacement that the held nodes moved.
    pub held_share: f64,
    /// Tetrahedra that followed the stable neo-Hookean law: those in which the law had no energy at the start, and their
    /// neighbours.
    pub n_quarantined_tets: u32,
    /// The first in which it had none.
    pub first_quarantined: Option<TetId>,
}

/// Buffers of a step.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    pub(super) residual_n: Vec<DVec3>,
    pub(super) product_n: Vec<DVec3>,
    pub(super) ligament_n: Vec<DVec3>,
    pub(super) start_m: Vec<DVec3>,
    ballistic_m: Vec<DVec3>,
    start_force_n: Vec<DVec3>,
    pub(super) force_n: Vec<DVec3>,
    direction_m: Vec<DVec3>,
    /// Displacements before a line search; unused between steps, when others use it as scratch.
    pub(super) before_m: Vec<DVec3>,
    /// The end of a step while another one is tried.
    pub(super) end_m: Vec<DVec3>,
    right_n: Vec<DVec3>,
    search_m: Vec<DVec3>,
    scaled_m: Vec<DVec3>,
}

impl Scratch {
    pub(super) fn new(n_nodes: usize) -> Self {
        let zero = || vec![DVec3::ZERO; n_nodes];
        Self {
            residual_n: zero(),
            product_n: zero(),
            ligament_n: zero(),
            start_m: zero(),
            ballistic_m: zero(),
            start_force_n: zero(),
            force_n: zero(),
            direction_m: zero(),
            before_m: zero(),
            end_m: zero(),
            right_n: zero(),
            search_m: zero(),
            scaled_m: zero(),
        }
    }
}

/// Constants of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepFactors {
    /// 1/h^2
    pub(super) inertia: f64,
    /// alpha/h
    pub(super) mass_damping: f64,
    /// beta/h
    pub(super) stiffness_damping: f64,
}

impl StepFactors {
    /// Whether a factor made at a state serves for a step of this length.
    fn fit(&self, state: &LaggedState) -> bool {
        let ratio = (self.inertia + self.mass_damping) / state.per_mass;
        ratio < MASS_RATIO && ratio > 1.0 / MASS_RATIO
    }
}

/// The present state, for a factor.
struct Here<'a> {
    displacement_m: &'a [DVec3],
    is_held: &'a [bool],
    elements: &'a Elements,
    factors: StepFactors,
}

impl Here<'_> {
    fn write_into(&self, state: &mut LaggedState) {
        state.displacement_m.copy_from_slice(self.displacement_m);
        state.held.copy_from_slice(self.is_held);
        self.elements.strays_into(&mut state.strays);
        state.per_mass = self.factors.inertia + self.factors.mass_damping;
        state.per_stiffness = 1.0 + self.factors.stiffness_damping;
        state.viscous_share = self.elements.factor();
    }
}

/// State of the minimisation at one displacement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Balance {
    /// Norm of the residual over the free nodes [N].
    residual_n: f64,
    /// Norms of applied, inertial and holding forces, added [N].
    scale_n: f64,
    /// Incremental potential [J].
    pub(super) potential_j: f64,
    /// Energy of the tissue, of ligaments and of springs [J].
    pub(super) stored_j: f64,
    /// Work of gravity and outer forces since the start [J].
    pub(super) work_j: f64,
    /// Sizes of the potential's parts, added [J]: what it is rounded by.
    size_j: f64,
}

/// The kind of shape a step starts from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Start {
    Upright,
    /// With an inverted tetrahedron.
    Inverted,
    /// No energy.
    Unusable,
}

/// Where the search for a step's end may begin.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Guess {
    /// The first that was usable.
    First,
    /// Motion goes on.
    Inertial,
    /// Nothing moves.
    Still,
}

enum Direction {
    Found,
    /// The exact tangent has negative curvature here, or the factor is too old.
    NeedsFactor,
}

pub(super) const MOST_NEWTON_ITERATIONS: u32 = 40;
const MOST_CG_ITERATIONS: u32 = 60;
/// A first guess whose residual is more than this share of all forces is compared with others: a choice.
const POOR_GUESS: f64 = 0.03;
const MOST_HALVINGS: u32 = 14;
/// Conjugate gradients stop at this share of the residual they start from ...
const FORCING: f64 = 0.02;
/// ... or at this share of the residual at which the step ends.
const FINAL_SHARE: f64 = 0.4;
/// Potentials nearer to each other than this share of their parts are equal.
const ROUNDING: f64 = 1e-13;
/// Sufficient decrease (Armijo 1966, doi 10.2140/pjm.1966.16.1).
const ARMIJO: f64 = 1e-4;
/// Extra iterations that cost about as much as a factor with its projected tangent.
const EXCESS_FOR_REFRESH: u32 = 48;
/// A factor made for another step length is used while its mass term is within this ratio.
const MASS_RATIO: f64 = 3.0;

impl ImplicitEuler {
    /// Advances by one step of `h_s`.
    pub(super) fn advance(&mut self, h_s: f64) {
        let mut factors = StepFactors {
            inertia: 1.0 / (h_s * h_s),
            mass_damping: self.damping.mass_per_s / h_s,
            stiffness_damping: self.damping.stiffness_s / h_s,
        };
        self.step_report = ImplicitReport { held_share: 1.0, ..ImplicitReport::default() };
        self.energy_was_limited = false;
        if self.lagged.is_none() {
            return;
        }
        self.scratch.start_m.copy_from_slice(&self.displacement_m);
        self.quarantine();
        if let Some(relaxation) = &mut self.relaxation {
            relaxation.begin(h_s, &mut self.elements);
        }
        let start = self.start(h_s);
        if start == Start::Inverted {
            factors.stiffness_damping = 0.0;
        }
        if start == Start::Unusable {
            self.step_report.status = ImplicitStatus::Unusable;
            self.velocities_m_per_s.fill(DVec3::ZERO);
            self.earlier_velocities_m_per_s.fill(DVec3::ZERO);
            return;
        }
        if self.step_report.n_quarantined_tets > 0 {
            self.refresh_here(factors);
            self.return_from_fallback(factors);
        } else {
            self.refresh_if_due(factors);
        }
        let energy_j = self.first_guess(h_s);
        let energy_j = self.better_guess(factors, energy_j);
        let end = self.minimise(factors, energy_j);
        let limit = self.keep_to_energy(factors, end);
        if let Some(relaxation) = &mut self.relaxation {
            relaxation.end(&self.elements, &self.displacement_m);
        }

        std::mem::swap(&mut self.velocities_m_per_s, &mut self.earlier_velocities_m_per_s);
        for n in 0..self.n_nodes() {
            self.velocities_m_per_s[n] = (self.displacement_m[n] - self.scratch.start_m[n]) / h_s;
        }
        if let Some(limit) = limit {
            self.limit_motion(limit);
        }
        let damping = factors.stiffness_damping;
        for held in self.held.iter() {
            let n = held.node as usize;
            let elastic_n =
                self.scratch.force_n[n] * (1.0 + damping) - self.scratch.start_force_n[n] * damping;
            let outer_n = self.gravity_m_per_s2 * self.mass_kg[n] + self.outer_n[n];
            self.constraint_forces_n[held.place as usize] =
                (elastic_n - outer_n - self.scratch.ligament_n[n]) * self.free_axes[n];
        }
        self.note_age();
        let is_pending = |lagged: &Lagged| lagged.pending().is_some();
        self.step_report.factor_is_pending =
            self.successor.is_some() || self.lagged.as_ref().is_some_and(is_pending);
        self.is_suspect |= self.elements.needs_stand_in();
    }

    /// Looks for tetrahedra in which the law has no energy, where there can be any: steps do not produce them.
    fn quarantine(&mut self) {
        if self.is_suspect || self.elements.recovery() != Recovery::None {
            self.is_suspect = false;
            let (n, first) = self.elements.quarantine(&self.displacement_m, self.elements.recovery());
            self.step_report.n_quarantined_tets = n;
            self.step_report.first_quarantined = first;
        }
    }

    /// Computes the inertial positions, and the forces before the step where damping needs them.
    fn start(&mut self, h_s: f64) -> Start {
        for n in 0..self.n_nodes() {
            let start_m = self.scratch.start_m[n];
            self.scratch.ballistic_m[n] = start_m + self.velocities_m_per_s[n] * h_s * self.mask[n];
        }
        if self.damping.stiffness_s == 0.0 {
            return Start::Upright;
        }
        let found = self.elements.evaluate(
            self.workers.as_ref(),
            &self.scratch.start_m,
            &mut self.scratch.start_force_n,
        );
        if !found.is_usable() {
            Start::Unusable
        } else if found.has_inverted || self.elements.recovery() != Recovery::None {
            Start::Inverted
        } else {
            Start::Upright
        }
    }

    /// Sets displacements and forces to the first usable of: motion with the last acceleration, inertial
    /// motion, no motion. Returns the elastic energy.
    fn first_guess(&mut self, h_s: f64) -> f64 {
        for n in 0..self.n_nodes() {
            let change = self.velocities_m_per_s[n] - self.earlier_velocities_m_per_s[n];
            self.displacement_m[n] = self.scratch.ballistic_m[n] + change * h_s * self.mask[n];
        }
        let found =
            self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n);
        if found.is_usable() {
            return found.energy_j;
        }
        self.displacement_m.copy_from_slice(&self.scratch.ballistic_m);
        let found =
            self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n);
        if found.is_usable() {
            return found.energy_j;
        }
        self.displacement_m.copy_from_slice(&self.scratch.start_m);
        self.elements
            .evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n)
            .energy_j
    }

    /// In a cut body some elements have little material, and hang by little: hardly anything damps their motion. Where the first guess is far
    /// from balance there, takes the one of least potential: it, inertial motion, or no motion. Sets forces and returns the elastic energy.
    fn better_guess(&mut self, factors: StepFactors, energy_j: f64) -> f64 {
        let is_cut = self.mesh.shares.iter().any(|share| *share < 1.0);
        // Averaged over nodes, volume and strain have no exact tangent: steps that go on as the last did come to balance over several.
        if !is_cut || self.volume != VolumeResistance::Element {
            return energy_j;
        }
        let first = self.balance(factors, energy_j);
        if !first.potential_j.is_finite() || first.residual_n <= POOR_GUESS * first.scale_n {
            return energy_j;
        }
        self.scratch.end_m.copy_from_slice(&self.displacement_m);
        // Another one has to be better by more than rounding.
        let (mut best, mut least_j) = (Guess::First, first.potential_j - ROUNDING * first.size_j);
        let mut energy_j = energy_j;
        for guess in [Guess::Inertial, Guess::Still] {
            let potential_j;
            (potential_j, energy_j) = self.try_guess(guess, factors);
            if potential_j < least_j {
                (best, least_j) = (guess, potential_j);
            }
        }
        if best == Guess::Still { energy_j } else { self.try_guess(best, factors).1 }
    }

    /// Sets displacements and forces to those of a guess; answers its incremental potential and its elastic energy [J].
    fn try_guess(&mut self, guess: Guess, factors: StepFactors) -> (f64, f64) {
        self.displacement_m.copy_from_slice(match guess {
            Guess::First => &self.scratch.end_m,
            Guess::Inertial => &self.scratch.ballistic_m,
            Guess::Still => &self.scratch.start_m,
        });
        let found =
            self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n);
        let potential_j = self.balance(factors, found.energy_j).potential_j;
        (if found.is_usable() { potential_j } else { f64::INFINITY }, found.energy_j)
    }

    /// Newton's iteration from the present displacements, whose forces are known.
    pub(super) fn minimise(&mut self, factors: StepFactors, energy_j: f64) -> Balance {
        let mut balance = self.balance(factors, energy_j);
        if !balance.potential_j.is_finite() {
            self.step_report.status = ImplicitStatus::Unusable;
            self.displacement_m.copy_from_slice(&self.scratch.start_m);
            return balance;
        }
        let n_before = self.step_report.newton_iterations;
        loop {
            let pending = self.held.iter().any(|h| self.displacement_m[h.node as usize] != h.target_m);
            let limit_n = self.tolerance * balance.scale_n + self.least_force_n;
            self.step_report.residual_share =
                if balance.scale_n > self.least_force_n { balance.residual_n / balance.scale_n } else { 0.0 };
            if !pending && balance.residual_n <= limit_n {
                self.step_report.status = ImplicitStatus::Converged;
                return balance;
            }
            let n_iterations = self.step_report.newton_iterations - n_before;
            // Held nodes always reach their targets; what is missing is the response of the tissue.
            if n_iterations == MOST_NEWTON_ITERATIONS || !pending && n_iterations >= self.most_iterations {
                self.stop(pending);
                return balance;
            }
            self.step_report.newton_iterations += 1;
            self.prepare_right_side(factors, pending);
            let stop_n = FINAL_SHARE * limit_n;
            if matches!(self.iterate(factors, stop_n), Direction::NeedsFactor) {
                self.refresh_here(factors);
                self.solve_directly(factors);
            }
            if let Some(next) = self.search_line(factors, balance, pending) {
                balance = next;
                continue;
            }
            // The direction did not serve: the projected tangent of this state gives a better one.
            self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n);
            self.refresh_here(factors);
            self.prepare_right_side(factors, pending);
            self.solve_directly(factors);
            let Some(next) = self.search_line(factors, balance, pending) else {
                let found = self.elements.evaluate(
                    self.workers.as_ref(),
                    &self.displacement_m,
                    &mut self.scratch.force_n,
                );
                let end = self.balance(factors, found.energy_j);
                self.stop(pending);
                return end;
            };
            balance = next;
        }
    }

    fn stop(&mut self, pending: bool) {
        self.step_report.status =
            if pending { ImplicitStatus::HeldNodesStopped } else { ImplicitStatus::NotConverged };
        let (mut gone_m, mut way_m) = (0.0, 0.0);
        for held in self.held.iter() {
            let start_m = self.scratch.start_m[held.node as usize];
            gone_m += start_m.distance(self.displacement_m[held.node as usize]);
            way_m += start_m.distance(held.target_m);
        }
        self.step_report.held_share = if way_m > 0.0 { gone_m / way_m } else { 1.0 };
    }

    /// Residual at every node and its norms, from the forces of the last evaluation.
    pub(super) fn balance(&mut self, factors: StepFactors, energy_j: f64) -> Balance {
        let StepFactors { inertia, mass_damping, stiffness_damping } = factors;
        let s = &mut self.scratch;
        self.steadying.start(&mut s.ligament_n);
        let mut ligaments_j = if self.ligaments.is_empty() {
            0.0
        } else {
            self.ligaments.pull_into(&self.mesh.positions_m, &self.displacement_m, &mut s.ligament_n)
        };
        if !self.steadying.is_empty() {
            let (rest_m, moved_m) = (&self.mesh.positions_m, &self.displacement_m);
            ligaments_j += self.steadying.add_pull(rest_m, moved_m, &mut s.ligament_n);
        }
        let (mut residual, mut applied, mut inertial, mut holding) = (0.0, 0.0, 0.0, 0.0);
        let mut potential_j = (1.0 + stiffness_damping) * energy_j + ligaments_j;
        let (mut work_j, mut size_j) = (0.0, potential_j.abs());
        for n in 0..self.displacement_m.len() {
            let u = self.displacement_m[n];
            let m = self.mass_kg[n];
            let outer_n = self.gravity_m_per_s2 * m + self.outer_n[n];
            let (off_m, way_m) = (u - s.ballistic_m[n], u - s.start_m[n]);
            let inertia_n = off_m * (m * inertia);
            let damping_n = way_m * (m * mass_damping);
            let mut elastic_n = s.force_n[n];
            if stiffness_damping > 0.0 {
                elastic_n = elastic_n * (1.0 + stiffness_damping) - s.start_force_n[n] * stiffness_damping;
                potential_j -= stiffness_damping * s.start_force_n[n].dot(way_m);
            }
            let r = inertia_n + damping_n + elastic_n - outer_n - s.ligament_n[n];
            s.residual_n[n] = r;
            if self.is_held[n] {
                holding += (r * self.free_axes[n]).length_squared();
            } else if self.moves[n] {
                residual += (r * self.mask[n]).length_squared();
                applied += ((outer_n - self.rest_load_n[n]) * self.mask[n]).length_squared();
                inertial += inertia_n.length_squared();
                let (motion_j, outer_j) =
                    (0.5 * (inertia_n.dot(off_m) + damping_n.dot(way_m)), outer_n.dot(way_m));
                potential_j += motion_j - outer_j;
                size_j += motion_j + outer_j.abs();
                work_j += outer_j;
            }
        }
        Balance {
            residual_n: residual.sqrt(),
            scale_n: applied.sqrt() + inertial.sqrt() + holding.sqrt(),
            potential_j,
            stored_j: energy_j + ligaments_j,
            work_j,
            size_j,
        }
    }

    /// Computes the right-hand side of the free nodes (minus the residual, minus the tangent times the remaining displacement
    /// of the held nodes), and the held part of the direction.
    fn prepare_right_side(&mut self, factors: StepFactors, pending: bool) {
        let s = &mut self.scratch;
        s.direction_m.fill(DVec3::ZERO);
        for held in self.held.iter() {
            let n = held.node as usize;
            s.direction_m[n] = held.target_m - self.displacement_m[n];
        }
        if pending {
            self.elements.tangent_product(self.workers.as_ref(), &s.direction_m, &mut s.product_n);
        }
        let stiffness = if pending { 1.0 + factors.stiffness_damping } else { 0.0 };
        for n in 0..s.right_n.len() {
            let held_n = if pending { s.product_n[n] * stiffness } else { DVec3::ZERO };
            s.right_n[n] = (-s.residual_n[n] - held_n) * self.mask[n];
        }
    }

    /// Preconditioned conjugate gradients (Hestenes and Stiefel 1952, doi 10.6028/jres.049.044) for the free
    /// part of the direction.
    fn iterate(&mut self, factors: StepFactors, stop_n: f64) -> Direction {
        let lagged = self.lagged.as_mut().expect("a body with tetrahedra has a factor");
        let (s, workers) = (&mut self.scratch, self.workers.as_ref());
        let per_mass = factors.inertia + factors.mass_damping;
        let per_stiffness = 1.0 + factors.stiffness_damping;
        let first = norm(&s.right_n);
        let stop_n = stop_n.max(FORCING * first);
        let mut remaining = first;
        let mut product = 0.0;
        let first_is_whole = lagged.leaves_no_net_force();
        for k in 0..MOST_CG_ITERATIONS {
            if remaining <= stop_n {
                return Direction::Found;
            }
            lagged.apply_into(workers, &s.right_n, &mut s.scaled_m);
            for (z, mask) in s.scaled_m.iter_mut().zip(&self.mask) {
                *z *= *mask;
            }
            let new_product = dot(&s.right_n, &s.scaled_m);
            let begins = k == 0 || k == 1 && first_is_whole;
            let beta = if begins { 0.0 } else { new_product / product };
            product = new_product;
            for (p, z) in s.search_m.iter_mut().zip(&s.scaled_m) {
                *p = if begins { *z } else { *z + *p * beta };
            }
            self.elements.tangent_product(workers, &s.search_m, &mut s.product_n);
            for n in 0..s.product_n.len() {
                s.product_n[n] =
                    s.product_n[n] * per_stiffness + s.search_m[n] * (self.mass_kg[n] * per_mass);
            }
            self.ligaments.add_product(&s.search_m, &mut s.product_n);
            self.steadying.add_product(&s.search_m, &mut s.product_n);
            let mut curvature = 0.0;
            for n in 0..s.product_n.len() {
                s.product_n[n] *= self.mask[n];
                curvature += s.product_n[n].dot(s.search_m[n]);
            }
            self.step_report.cg_iterations += 1;
            if !(curvature > 0.0 && product > 0.0) {
                return if k == 0 { Direction::NeedsFactor } else { Direction::Found };
            }
            let length = if k == 0 && first_is_whole { 1.0 } else { product / curvature };
            let mut square = 0.0;
            for n in 0..s.right_n.len() {
                s.direction_m[n] += s.search_m[n] * length;
                s.right_n[n] -= s.product_n[n] * length;
                square += s.right_n[n].length_squared();
            }
            remaining = square.sqrt();
        }
        // Far from the state of the factor: a factor at this state is cheaper than further iterations.
        self.prepare_right_side(factors, !self.held.is_empty());
        Direction::NeedsFactor
    }

    /// The free part of the direction from the projected tangent of the last factor itself.
    fn solve_directly(&mut self, factors: StepFactors) {
        let is_solved = |model: &mut Self| {
            let lagged = model.lagged.as_mut().expect("a body with tetrahedra has a factor");
            lagged.solve_into(
                model.workers.as_ref(),
                &model.scratch.right_n,
                &mut model.scratch.scaled_m,
                FORCING,
            )
        };
        if !is_solved(self) {
            self.fall_back(self.state_here(factors));
            is_solved(self);
        }
        let s = &mut self.scratch;
        for n in 0..self.is_held.len() {
            if !self.is_held[n] {
                s.direction_m[n] = s.scaled_m[n] * self.mask[n];
            }
        }
    }

    /// Where two grids do not solve, as for flattened tetrahedra many times stiffer than the others, a sparse factor does. It
    /// serves until two grids have been made anew over the next steps.
    pub(super) fn fall_back(&mut self, state: LaggedState) {
        if self.factor_by(Preconditioner::Factor, state).is_ok() {
            self.successor = Some(Successor::default());
            self.has_fallen_back = true;
            self.step_report.n_factors += 1;
        }
    }

    /// Moves along the direction as far as the law allows all tetrahedra and the potential, or the residual, decreases. While
    /// held nodes have not reached their targets only the law counts. `None` when no length serves: only the forces changed
    /// then.
    fn search_line(&mut self, factors: StepFactors, from: Balance, pending: bool) -> Option<Balance> {
        self.scratch.before_m.copy_from_slice(&self.displacement_m);
        let slope: f64 = dot(&self.scratch.residual_n, &self.scratch.direction_m);
        let mut length = 1.0;
        for _ in 0..=MOST_HALVINGS {
            for n in 0..self.displacement_m.len() {
                self.displacement_m[n] = self.scratch.before_m[n] + self.scratch.direction_m[n] * length;
            }
            if length == 1.0 {
                for held in self.held.iter() {
                    self.displacement_m[held.node as usize] = held.target_m;
                }
            }
            let found = self.elements.evaluate(
                self.workers.as_ref(),
                &self.displacement_m,
                &mut self.scratch.force_n,
            );
            if found.is_usable() {
                let next = self.balance(factors, found.energy_j);
                let falls = next.potential_j <= from.potential_j + ARMIJO * length * slope.min(0.0);
                // Near the minimum rounding hides a fall.
                let rounding_j = self.least_energy_j + ROUNDING * (from.size_j + next.size_j);
                let is_level = next.potential_j <= from.potential_j + rounding_j;
                if pending || falls || is_level && next.residual_n < from.residual_n {
                    return Some(next);
                }
            }
            length *= 0.5;
        }
        self.displacement_m.copy_from_slice(&self.scratch.before_m);
        self.elements.evaluate(self.workers.as_ref(), &self.displacement_m, &mut self.scratch.force_n);
        self.balance(factors, from.potential_j);
        None
    }

    /// Recomputes the factor at once when the step length changed, and in slices, one a step, when the iterations since it was
    /// made have cost as much.
    fn refresh_if_due(&mut self, factors: StepFactors) {
        let lagged = self.lagged.as_mut().expect("a body with tetrahedra has a factor");
        if !factors.fit(&lagged.state) {
            self.refresh_here(factors);
            self.return_from_fallback(factors);
            return;
        }
        if self.successor.is_some() {
            self.go_on_with_successor(factors);
            return;
        }
        if lagged.pending().is_some_and(|pending| !factors.fit(&pending.state)) {
            lagged.drop_pending();
        }
        if lagged.pending().is_none() {
            if self.age.excess_iterations < EXCESS_FOR_REFRESH {
                return;
            }
            let here = Here {
                displacement_m: &self.displacement_m,
                is_held: &self.is_held,
                elements: &self.elements,
                factors,
            };
            here.write_into(lagged.order());
        }
        let nodes =
            NodeTerms { rest_m: &self.mesh.positions_m, mass_kg: &self.mass_kg, ligaments: &self.ligaments };
        match lagged.advance(&self.elements, nodes) {
            Slice::Underway => {}
            Slice::Serves => self.note_factor(),
            Slice::Failed => self.age = FactorAge::default(),
        }
    }

    /// The next stage of the factor of an edited mesh.
    fn go_on_with_successor(&mut self, factors: StepFactors) {
        let Some(mut successor) = self.successor.take() else { return };
        let free_axes = self.axes_that_move();
        let edited = self.edited(&free_axes);
        match successor.advance(&edited, || self.state_here(factors)) {
            Some(lagged) => {
                self.lagged = Some(*lagged);
                self.has_fallen_back = false;
                self.note_factor();
            }
            None => self.successor = Some(successor),
        }
    }

    /// What a factor made now depends on.
    fn state_here(&self, factors: StepFactors) -> LaggedState {
        let mut state = LaggedState::of_size(self.n_nodes(), self.elements.tets().len());
        let here = Here {
            displacement_m: &self.displacement_m,
            is_held: &self.is_held,
            elements: &self.elements,
            factors,
        };
        here.write_into(&mut state);
        state
    }

    /// Recomputes the factor at the present displacements, at once.
    fn refresh_here(&mut self, factors: StepFactors) {
        if self.successor.is_some() && !self.has_fallen_back {
            let state = self.state_here(factors);
            if self.factor_at_once(state).is_ok() {
                self.step_report.n_factors += 1;
            }
            return;
        }
        let lagged = self.lagged.as_mut().expect("a body with tetrahedra has a factor");
        let here = Here {
            displacement_m: &self.displacement_m,
            is_held: &self.is_held,
            elements: &self.elements,
            factors,
        };
        here.write_into(&mut lagged.state);
        let nodes =
            NodeTerms { rest_m: &self.mesh.positions_m, mass_kg: &self.mass_kg, ligaments: &self.ligaments };
        let is_made = lagged.refresh(&self.elements, nodes);
        let is_direct = lagged.direct().is_some();
        self.note_factor();
        if !is_made && !is_direct {
            self.fall_back(self.state_here(factors));
        }
    }

    /// Goes on with the two grids that take the fallback's place, in steps that began with a factor at once.
    fn return_from_fallback(&mut self, factors: StepFactors) {
        if self.has_fallen_back {
            self.go_on_with_successor(factors);
        }
    }

    /// Another factor serves from now on.
    fn note_factor(&mut self) {
        self.factor_version += 1;
        self.age = FactorAge::default();
        self.step_report.n_factors += 1;
    }

    fn note_age(&mut self) {
        let iterations = self.step_report.cg_iterations;
        if self.age.n_steps == 0 {
            self.age.first_iterations = iterations;
        } else {
            self.age.excess_iterations += iterations.saturating_sub(self.age.first_iterations);
        }
        self.age.n_steps = self.age.n_steps.saturating_add(1);
    }
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn norm(a: &[DVec3]) -> f64 {
    a.iter().map(|v| v.length_squared()).sum::<f64>().sqrt()
}
