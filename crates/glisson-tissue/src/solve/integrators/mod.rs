//! Time integration of nodes that move by accelerations a(x, v) and a damping -d_i v_i of each node.
//!
//! All schemes of seed `000` s. 2.4 (S. Chendeb 2007, NNT 2007ENMP1614) but the implicit Euler step, with its
//! misprints put right, and central differences (seed `003` eq. 3.3). With step h:
//!
//! | scheme | step | order |
//! |---|---|---|
//! | central differences | v+ = ((1/h - d/2) v- + a(x, v-)) / (1/h + d/2), x += h v+; v- and v+ stand between the steps | 2 |
//! | semi-implicit Euler | v += h (a - d v), x += h v | 1 |
//! | Runge-Kutta 2 | the midpoint rule | 2 |
//! | Runge-Kutta 4 | x0 + (k1 + 2 k2 + 2 k3 + k4)/6; the seed prints x0 + k4 | 4 |
//! | backward differences 1 | x' = (x0 - x1)/h, x'' = (x0 - 2 x1 + x2)/h^2 | 1 |
//! | backward differences 2 | x' = (3 x0 - 4 x1 + x2)/(2 h), where the seed prints another sign and 1/h; x'' = (9 x0 - 24 x1 + 22 x2 - 8 x3 + x4)/(4 h^2) | 2 |
//!
//! x_s is the position s steps ago, x0 the wanted one. The backward differences are solved by Banach's fixed
//! point (seed `000` eq. 2.9): x0 is put into a(x, v) until it repeats. The damping d is linear and of one node,
//! so that central and backward differences take it implicitly, in closed form.
//! Central differences have order 2 as long as a does not depend on v, else 1.
//!
//! [`Scheme`] tells where to use which; [`Scheme::stable_step_s`] gives the longest stable step.

mod stability;

pub use stability::ModeBounds;

use glisson_mesh::math::DVec3;

/// A time integration scheme.
///
/// - [`Scheme::SemiImplicitEuler`]: the usual choice for soft bodies with contacts; one evaluation per step.
/// - [`Scheme::CentralDifferences`]: the same cost and step, order 2, and damping takes nothing from the step.
/// - [`Scheme::RungeKutta4`]: smooth motions to many digits; per evaluation its step is a third.
/// - [`Scheme::RungeKutta2`]: amplifies undamped oscillations; for comparison.
/// - [`Scheme::BackwardDifferences1`], [`Scheme::BackwardDifferences2`]: damp oscillations by themselves. The fixed
///   point asks for a step about as short as the explicit ones, and for several evaluations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// Central differences in leapfrog form.
    CentralDifferences,
    /// Velocities first, then positions with the new velocities.
    SemiImplicitEuler,
    /// Midpoint rule.
    RungeKutta2,
    /// The classical four stages.
    RungeKutta4,
    /// Backward differences of order 1 by fixed point.
    BackwardDifferences1,
    /// Backward differences of order 2 by fixed point.
    BackwardDifferences2,
}

impl Scheme {
    /// All schemes, in the order of the module's table.
    pub const ALL: [Self; 6] = [
        Self::CentralDifferences,
        Self::SemiImplicitEuler,
        Self::RungeKutta2,
        Self::RungeKutta4,
        Self::BackwardDifferences1,
        Self::BackwardDifferences2,
    ];

    /// Name for scenes and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::CentralDifferences => "central_differences",
            Self::SemiImplicitEuler => "semi_implicit_euler",
            Self::RungeKutta2 => "runge_kutta_2",
            Self::RungeKutta4 => "runge_kutta_4",
            Self::BackwardDifferences1 => "backward_differences_1",
            Self::BackwardDifferences2 => "backward_differences_2",
        }
    }

    /// Order of convergence of the positions.
    pub fn order(self) -> u32 {
        match self {
            Self::SemiImplicitEuler | Self::BackwardDifferences1 => 1,
            Self::CentralDifferences | Self::RungeKutta2 | Self::BackwardDifferences2 => 2,
            Self::RungeKutta4 => 4,
        }
    }

    /// Whether a step evaluates the accelerations once, at the positions that it starts from.
    pub fn evaluates_once(self) -> bool {
        matches!(self, Self::CentralDifferences | Self::SemiImplicitEuler)
    }

    /// Weights of x0, x1, ... in h x' and h^2 x'' of the backward differences.
    fn backward_weights(self) -> Option<BackwardWeights> {
        match self {
            Self::BackwardDifferences1 => {
                Some(BackwardWeights { first: &[1.0, -1.0], second: &[1.0, -2.0, 1.0] })
            }
            Self::BackwardDifferences2 => {
                Some(BackwardWeights { first: &[1.5, -2.0, 0.5], second: &[2.25, -6.0, 5.5, -2.0, 0.25] })
            }
            _ => None,
        }
    }

    /// Number of positions before the present one that the scheme needs.
    fn n_past(self) -> usize {
        self.backward_weights().map_or(0, |w| w.second.len() - 2)
    }
}

#[derive(Clone, Copy, Debug)]
struct BackwardWeights {
    first: &'static [f64],
    second: &'static [f64],
}

/// The equations of motion of the nodes.
pub trait EquationsOfMotion {
    /// Overwrites `accelerations_m_per_s2` with a(x, v) of every node, without [`Motion::damping_per_s`]. Values
    /// of nodes that do not move freely are not used.
    fn accelerations_into(
        &mut self,
        positions_m: &[DVec3],
        velocities_m_per_s: &[DVec3],
        accelerations_m_per_s2: &mut [DVec3],
    );
}

/// The state that a step changes, one entry per node.
#[derive(Debug)]
pub struct Motion<'a> {
    /// Positions [m].
    pub positions_m: &'a mut [DVec3],
    /// Velocities [m/s]; of central differences after the first step: half a step ago.
    pub velocities_m_per_s: &'a mut [DVec3],
    /// Whether the node moves freely. The others are where the caller put them for the end of the step, with the
    /// velocity that brought them there; a step leaves both.
    pub moves: &'a [bool],
    /// Damping over mass d_i [1/s].
    pub damping_per_s: &'a [f64],
}

/// When the fixed-point iteration of an implicit step ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedPoint {
    /// The largest change of a coordinate in the last iteration [m].
    pub tolerance_m: f64,
    /// Iterations after which the last iterate is taken as it is.
    pub most_iterations: u32,
}

impl Default for FixedPoint {
    /// A millionth of a micrometre; at half the largest step for which the iteration contracts, 60 iterations
    /// gain 18 digits.
    fn default() -> Self {
        Self { tolerance_m: 1e-12, most_iterations: 60 }
    }
}

/// Report on the effort of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effort {
    /// Evaluations of the accelerations.
    pub evaluations: u32,
    /// Whether an implicit step ended without meeting [`FixedPoint::tolerance_m`].
    pub missed_fixed_point: bool,
}

/// A scheme with its memory and scratch arrays.
#[derive(Clone, Debug)]
pub struct Integrator {
    scheme: Scheme,
    fixed_point: FixedPoint,
    n_nodes: usize,
    /// x1 of the coming step is the present position; x2, x3, ... stand here, node by node within each age. The
    /// last number is the step [s] that they hold for; zero before the first.
    past: Vec<f64>,
    known: Vec<DVec3>,
    stage_positions_m: Vec<DVec3>,
    stage_velocities_m_per_s: Vec<DVec3>,
    stages: Vec<DVec3>,
}

impl Integrator {
    /// An integrator without a past for so many nodes.
    pub fn new(scheme: Scheme, fixed_point: FixedPoint, n_nodes: usize) -> Self {
        let mut integrator = Self {
            scheme,
            fixed_point,
            n_nodes: 0,
            past: Vec::new(),
            known: Vec::new(),
            stage_positions_m: Vec::new(),
            stage_velocities_m_per_s: Vec::new(),
            stages: Vec::new(),
        };
        integrator.resize(n_nodes);
        integrator
    }

    /// Resets the integrator for another number of nodes: the next step starts from positions and velocities alone.
    pub fn resize(&mut self, n_nodes: usize) {
        self.n_nodes = n_nodes;
        self.past = vec![0.0; 3 * n_nodes * self.scheme.n_past() + 1];
        let needs_stages = !self.scheme.evaluates_once();
        let n_stage = if needs_stages { n_nodes } else { 0 };
        self.known = vec![DVec3::ZERO; if self.scheme.n_past() > 0 { 2 * n_nodes } else { 0 }];
        self.stage_positions_m = vec![DVec3::ZERO; n_stage];
        self.stage_velocities_m_per_s = vec![DVec3::ZERO; n_stage];
        // The present accelerations; the Runge-Kutta schemes also sum up velocities and accelerations.
        self.stages = vec![DVec3::ZERO; if needs_stages { 3 * n_nodes } else { n_nodes }];
    }

    /// Forgets the past: the next step starts from positions and velocities alone. Allocates nothing.
    pub fn restart(&mut self) {
        self.past.fill(0.0);
    }

    /// The scheme.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// State that the next step depends on besides positions and velocities.
    pub fn history(&self) -> &[f64] {
        &self.past
    }

    /// Restores a [`Integrator::history`] of the same scheme and number of nodes.
    ///
    /// # Panics
    /// When the length differs.
    pub fn set_history(&mut self, history: &[f64]) {
        self.past.copy_from_slice(history);
    }

    /// Advances by `h_s`. Allocates nothing.
    ///
    /// # Panics
    /// When an array of `motion` has another length than the integrator's number of nodes.
    pub fn step(
        &mut self,
        equations: &mut impl EquationsOfMotion,
        motion: &mut Motion<'_>,
        h_s: f64,
    ) -> Effort {
        let n = self.n_nodes;
        let lengths = [motion.positions_m.len(), motion.velocities_m_per_s.len(), motion.moves.len()];
        assert!(lengths == [n; 3] && motion.damping_per_s.len() == n, "one entry a node");
        match self.scheme {
            Scheme::CentralDifferences => self.central_differences(equations, motion, h_s),
            Scheme::SemiImplicitEuler => self.semi_implicit_euler(equations, motion, h_s),
            Scheme::RungeKutta2 => self.runge_kutta(equations, motion, h_s, &MIDPOINT),
            Scheme::RungeKutta4 => self.runge_kutta(equations, motion, h_s, &CLASSICAL),
            Scheme::BackwardDifferences1 | Scheme::BackwardDifferences2 => {
                self.backward_differences(equations, motion, h_s)
            }
        }
    }

    fn central_differences(
        &mut self,
        equations: &mut impl EquationsOfMotion,
        motion: &mut Motion<'_>,
        h_s: f64,
    ) -> Effort {
        let a = &mut self.stages;
        equations.accelerations_into(motion.positions_m, motion.velocities_m_per_s, a);
        let is_first = self.past[0] == 0.0;
        self.past[0] = h_s;
        for i in 0..self.n_nodes {
            if !motion.moves[i] {
                continue;
            }
            let (v, d) = (motion.velocities_m_per_s[i], motion.damping_per_s[i]);
            let v = if is_first {
                v + 0.5 * h_s * (a[i] - d * v)
            } else {
                ((1.0 / h_s - 0.5 * d) * v + a[i]) / (1.0 / h_s + 0.5 * d)
            };
            motion.velocities_m_per_s[i] = v;
            motion.positions_m[i] += h_s * v;
        }
        Effort { evaluations: 1, missed_fixed_point: false }
    }

    fn semi_implicit_euler(
        &mut self,
        equations: &mut impl EquationsOfMotion,
        motion: &mut Motion<'_>,
        h_s: f64,
    ) -> Effort {
        let a = &mut self.stages;
        equations.accelerations_into(motion.positions_m, motion.velocities_m_per_s, a);
        for i in 0..self.n_nodes {
            if motion.moves[i] {
                let v = motion.velocities_m_per_s[i];
                let v = v + h_s * (a[i] - motion.damping_per_s[i] * v);
                motion.velocities_m_per_s[i] = v;
                motion.positions_m[i] += h_s * v;
            }
        }
        Effort { evaluations: 1, missed_fixed_point: false }
    }

    fn runge_kutta(
        &mut self,
        equations: &mut impl EquationsOfMotion,
        motion: &mut Motion<'_>,
        h_s: f64,
        stages: &[Stage],
    ) -> Effort {
        let n = self.n_nodes;
        let (a, sums) = self.stages.split_at_mut(n);
        let (velocity_sum, acceleration_sum) = sums.split_at_mut(n);
        let (x, v) = (&mut self.stage_positions_m, &mut self.stage_velocities_m_per_s);
        x.copy_from_slice(motion.positions_m);
        v.copy_from_slice(motion.velocities_m_per_s);
        velocity_sum.fill(DVec3::ZERO);
        acceleration_sum.fill(DVec3::ZERO);
        for stage in stages {
            equations.accelerations_into(x, v, a);
            for i in 0..n {
                if motion.moves[i] {
                    let a = a[i] - motion.damping_per_s[i] * v[i];
                    velocity_sum[i] += stage.weight * v[i];
                    acceleration_sum[i] += stage.weight * a;
                    x[i] = motion.positions_m[i] + stage.reach_of_next * h_s * v[i];
                    v[i] = motion.velocities_m_per_s[i] + stage.reach_of_next * h_s * a;
                }
            }
        }
        for i in 0..n {
            if motion.moves[i] {
                motion.positions_m[i] += h_s * velocity_sum[i];
                motion.velocities_m_per_s[i] += h_s * acceleration_sum[i];
            }
        }
        Effort { evaluations: stages.len() as u32, missed_fixed_point: false }
    }

    /// With the past in known_v = sum alpha_s x_s and known_a = sum beta_s x_s (s from 1), the iteration is
    /// x0 = (a(x0, v0) - known_a/h^2 - d known_v/h) / (beta_0/h^2 + d alpha_0/h), v0 = (alpha_0 x0 + known_v)/h.
    fn backward_differences(
        &mut self,
        equations: &mut impl EquationsOfMotion,
        motion: &mut Motion<'_>,
        h_s: f64,
    ) -> Effort {
        let weights = self.scheme.backward_weights().expect("called for backward differences only");
        let mut evaluations = 0;
        if self.past.last() != Some(&h_s) {
            equations.accelerations_into(
                motion.positions_m,
                motion.velocities_m_per_s,
                &mut self.stages[..self.n_nodes],
            );
            evaluations += 1;
            self.imagine_past(motion, h_s);
        }
        self.sum_up_past(weights, motion, h_s);
        let mut missed_fixed_point = true;
        for _ in 0..self.fixed_point.most_iterations {
            let a = &mut self.stages[..self.n_nodes];
            equations.accelerations_into(&self.stage_positions_m, &self.stage_velocities_m_per_s, a);
            evaluations += 1;
            if self.iterate(weights, motion, h_s) <= self.fixed_point.tolerance_m {
                missed_fixed_point = false;
                break;
            }
        }
        self.remember(motion, h_s);
        motion.positions_m.copy_from_slice(&self.stage_positions_m);
        motion.velocities_m_per_s.copy_from_slice(&self.stage_velocities_m_per_s);
        Effort { evaluations, missed_fixed_point }
    }

    /// Overwrites known_v and known_a, and makes free flight the first guess.
    fn sum_up_past(&mut self, weights: BackwardWeights, motion: &Motion<'_>, h_s: f64) {
        let n = self.n_nodes;
        let (known_v, known_a) = self.known.split_at_mut(n);
        for i in 0..n {
            let now = motion.positions_m[i];
            known_v[i] = weights.first[1] * now;
            known_a[i] = weights.second[1] * now;
            for s in 2..weights.second.len() {
                let earlier = past_position(&self.past, n, s - 2, i);
                known_a[i] += weights.second[s] * earlier;
                if let Some(&alpha) = weights.first.get(s) {
                    known_v[i] += alpha * earlier;
                }
            }
            let v = motion.velocities_m_per_s[i];
            self.stage_velocities_m_per_s[i] = v;
            self.stage_positions_m[i] = if motion.moves[i] { now + h_s * v } else { now };
        }
    }

    /// One iteration of the fixed point with the accelerations in `stages`; the largest change of a position [m].
    fn iterate(&mut self, weights: BackwardWeights, motion: &Motion<'_>, h_s: f64) -> f64 {
        let n = self.n_nodes;
        let (known_v, known_a) = self.known.split_at(n);
        let (x, v) = (&mut self.stage_positions_m, &mut self.stage_velocities_m_per_s);
        let a = &self.stages[..n];
        let mut change_m: f64 = 0.0;
        for i in 0..n {
            if !motion.moves[i] {
                continue;
            }
            let d = motion.damping_per_s[i];
            let right = a[i] - known_a[i] / (h_s * h_s) - d / h_s * known_v[i];
            let next = right / (weights.second[0] / (h_s * h_s) + d * weights.first[0] / h_s);
            change_m = change_m.max((next - x[i]).abs().max_element());
            x[i] = next;
            v[i] = (weights.first[0] * next + known_v[i]) / h_s;
        }
        change_m
    }

    /// Shifts the past by one step.
    fn remember(&mut self, motion: &Motion<'_>, h_s: f64) {
        let n = self.n_nodes;
        for s in (1..self.scheme.n_past()).rev() {
            self.past.copy_within(3 * n * (s - 1)..3 * n * s, 3 * n * s);
        }
        for i in 0..n {
            let before = if motion.moves[i] {
                motion.positions_m[i]
            } else {
                motion.positions_m[i] - h_s * motion.velocities_m_per_s[i]
            };
            set_past_position(&mut self.past, n, 0, i, before);
        }
    }

    /// Fills a past consistent with position, velocity and acceleration (in `stages`): x - s h v + (s h)^2/2 a.
    fn imagine_past(&mut self, motion: &Motion<'_>, h_s: f64) {
        let n = self.n_nodes;
        for s in 0..self.scheme.n_past() {
            let back_s = (s + 1) as f64 * h_s;
            for i in 0..n {
                let (x, v) = (motion.positions_m[i], motion.velocities_m_per_s[i]);
                let a =
                    if motion.moves[i] { self.stages[i] - motion.damping_per_s[i] * v } else { DVec3::ZERO };
                let earlier = x - back_s * v + 0.5 * back_s * back_s * a;
                set_past_position(&mut self.past, n, s, i, earlier);
            }
        }
        let last = self.past.len() - 1;
        self.past[last] = h_s;
    }
}

fn past_position(past: &[f64], n_nodes: usize, age: usize, node: usize) -> DVec3 {
    let at = 3 * (age * n_nodes + node);
    DVec3::new(past[at], past[at + 1], past[at + 2])
}

fn set_past_position(past: &mut [f64], n_nodes: usize, age: usize, node: usize, position_m: DVec3) {
    let at = 3 * (age * n_nodes + node);
    past[at..at + 3].copy_from_slice(&position_m.to_array());
}

/// A stage of a Runge-Kutta scheme in which each stage starts from the one before it.
#[derive(Clone, Copy, Debug)]
struct Stage {
    /// Share of this stage's slope in the step.
    weight: f64,
    /// Distance along its slope to the next stage, in steps.
    reach_of_next: f64,
}

const MIDPOINT: [Stage; 2] =
    [Stage { weight: 0.0, reach_of_next: 0.5 }, Stage { weight: 1.0, reach_of_next: 0.0 }];

const CLASSICAL: [Stage; 4] = [
    Stage { weight: 1.0 / 6.0, reach_of_next: 0.5 },
    Stage { weight: 1.0 / 3.0, reach_of_next: 0.5 },
    Stage { weight: 1.0 / 3.0, reach_of_next: 1.0 },
    Stage { weight: 1.0 / 6.0, reach_of_next: 0.0 },
];
