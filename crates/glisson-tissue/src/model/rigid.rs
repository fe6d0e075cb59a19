//! A rigid body: its nodes go where a motion puts them, whatever pushes.
//!
//! The motion takes a point X of the rest shape to
//!
//! x(t) = c + R(t) (X - c) + d(t),
//!
//! with a pivot c, a rotation R and a displacement d that depend on time alone; both are those of rest at t = 0. Velocities are
//! those of the step just made, (x(t) - x(t - h))/h. The time since the start is the body's whole state.

use super::{Constraints, DeformableModel, ModelReport, ModelState, ModelUndo, StepAnswer, TopologyRefusal};
use glisson_mesh::math::{DQuat, DVec3, rotation_between};
use glisson_mesh::mesh::TetMesh;
use glisson_mesh::mesh::edit::TopologyChange;
use std::f64::consts::{PI, TAU};

/// A pose on the path of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPose {
    /// When [s].
    pub time_s: f64,
    /// Displacement of the pivot from its place at rest [m].
    pub displacement_m: DVec3,
    /// Rotation about the pivot.
    pub rotation: DQuat,
}

/// How a rigid body moves.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum RigidMotion {
    /// It stays.
    #[default]
    Fixed,
    /// From rest at t = 0 through poses, which ascend in time: places linearly, rotations by the shortest way; it stays at the
    /// last one.
    Path {
        /// What it turns about [m].
        pivot_m: DVec3,
        /// The poses.
        poses: Vec<PathPose>,
    },
    /// To and fro as tissue under a breathing diaphragm: d(t) = a (1 - cos^(2n)(pi t/T)) along a direction, which stays longer
    /// at rest (end of exhalation) the larger n is (Lujan, Larsen, Balter and Ten Haken 1999, "A method for incorporating organ motion due to breathing
    /// into 3D dose calculations", Medical Physics).
    Breathing {
        /// Unit vector.
        direction: DVec3,
        /// The largest displacement a [m].
        amplitude_m: f64,
        /// T [s].
        period_s: f64,
        /// n, at least 1.
        sharpness: u32,
    },
}

impl RigidMotion {
    /// Pivot, displacement and rotation at a time.
    fn pose(&self, time_s: f64) -> (DVec3, DVec3, DQuat) {
        match self {
            Self::Fixed => (DVec3::ZERO, DVec3::ZERO, DQuat::IDENTITY),
            Self::Path { pivot_m, poses } => {
                let mut before =
                    PathPose { time_s: 0.0, displacement_m: DVec3::ZERO, rotation: DQuat::IDENTITY };
                for pose in poses {
                    if time_s < pose.time_s {
                        let share = (time_s - before.time_s) / (pose.time_s - before.time_s);
                        let displacement_m = before.displacement_m.lerp(pose.displacement_m, share);
                        return (
                            *pivot_m,
                            displacement_m,
                            rotation_between(before.rotation, pose.rotation, share),
                        );
                    }
                    before = *pose;
                }
                (*pivot_m, before.displacement_m, before.rotation)
            }
            &Self::Breathing { direction, amplitude_m, period_s, sharpness } => {
                let phase = (time_s / period_s).fract();
                let square = libm::cos(PI * phase) * libm::cos(PI * phase);
                let share = 1.0 - (0..sharpness).fold(1.0, |power, _| power * square);
                (DVec3::ZERO, direction * (amplitude_m * share), DQuat::IDENTITY)
            }
        }
    }

    /// The greatest speed of a point so far from the pivot [m/s]: what a step of contact has to bear.
    pub fn greatest_speed_m_per_s(&self, reach_m: f64) -> f64 {
        match self {
            Self::Fixed => 0.0,
            Self::Path { poses, .. } => {
                let start = PathPose { time_s: 0.0, displacement_m: DVec3::ZERO, rotation: DQuat::IDENTITY };
                let befores = std::iter::once(&start).chain(poses);
                let speed = |(before, after): (&PathPose, &PathPose)| {
                    let way_m = before.displacement_m.distance(after.displacement_m)
                        + reach_m * before.rotation.angle_between(after.rotation);
                    way_m / (after.time_s - before.time_s)
                };
                befores.zip(poses).map(speed).fold(0.0, f64::max)
            }
            // |d'| is at most a n pi/T: the square of a cosine has the slope pi/T at most, its n-th power n times that.
            Self::Breathing { amplitude_m, period_s, sharpness, .. } => {
                0.5 * amplitude_m.abs() * f64::from(*sharpness) * TAU / period_s
            }
        }
    }
}

/// The model of a rigid body.
#[derive(Clone)]
pub struct RigidBody {
    motion: RigidMotion,
    rest_m: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    /// Time since the start [s]; none of a body that stays.
    clock_s: Vec<f64>,
    n_ignored: u32,
    forces_n: Vec<DVec3>,
}

impl RigidBody {
    /// A body with these nodes at rest.
    pub fn new(rest_m: Vec<DVec3>, motion: RigidMotion) -> Self {
        let n = rest_m.len();
        let clock_s = if motion == RigidMotion::Fixed { Vec::new() } else { vec![0.0] };
        Self {
            motion,
            positions_m: rest_m.clone(),
            rest_m,
            velocities_m_per_s: vec![DVec3::ZERO; n],
            clock_s,
            n_ignored: 0,
            forces_n: Vec::with_capacity(n),
        }
    }

    /// Whether it has a clock.
    pub fn moves(&self) -> bool {
        !self.clock_s.is_empty()
    }

    fn set_clock(&mut self, time_s: f64) {
        if let Some(clock_s) = self.clock_s.first_mut() {
            *clock_s = time_s;
            self.place();
        }
        self.velocities_m_per_s.fill(DVec3::ZERO);
    }

    fn place(&mut self) {
        let Some(&time_s) = self.clock_s.first() else { return };
        let (pivot_m, displacement_m, rotation) = self.motion.pose(time_s);
        for (position_m, rest_m) in self.positions_m.iter_mut().zip(&self.rest_m) {
            *position_m = pivot_m + rotation * (*rest_m - pivot_m) + displacement_m;
        }
    }
}

impl DeformableModel for RigidBody {
    fn apply(&mut self, constraints: &Constraints) {
        self.n_ignored = constraints.displacements.len() as u32;
        self.forces_n.clear();
        self.forces_n.resize(constraints.displacements.len(), DVec3::ZERO);
    }

    fn step(&mut self, dt_s: f64) {
        let Some(clock_s) = self.clock_s.first_mut() else { return };
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return;
        }
        *clock_s += dt_s;
        for (velocity_m_per_s, before_m) in self.velocities_m_per_s.iter_mut().zip(&self.positions_m) {
            *velocity_m_per_s = -*before_m;
        }
        self.place();
        for (velocity_m_per_s, now_m) in self.velocities_m_per_s.iter_mut().zip(&self.positions_m) {
            *velocity_m_per_s = (*velocity_m_per_s + *now_m) / dt_s;
        }
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        numbers.extend_from_slice(&self.clock_s);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.forces_n
    }

    /// Back to the start: where it is depends on time alone.
    fn take_over(&mut self, _positions_m: &[DVec3]) {
        self.set_clock(0.0);
    }

    fn clocks_s(&self) -> &[f64] {
        &self.clock_s
    }

    fn take_over_in_motion(&mut self, state: &ModelState<'_>, clocks_s: &[f64]) {
        self.set_clock(clocks_s.first().copied().unwrap_or(0.0));
        if state.velocities_m_per_s.len() == self.velocities_m_per_s.len() && self.moves() {
            self.velocities_m_per_s.copy_from_slice(state.velocities_m_per_s);
        }
    }

    fn set_gravity(&mut self, _gravity_m_per_s2: DVec3) {}

    fn report(&self) -> ModelReport {
        ModelReport { n_parts: 1, n_ignored_constraints: self.n_ignored, ..ModelReport::default() }
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        let mut copy = self.clone();
        copy.forces_n.reserve(self.rest_m.len());
        Box::new(copy)
    }

    /// No force moves it, which is an answer.
    fn step_answer(&self) -> StepAnswer {
        StepAnswer::NodeByNode
    }

    fn topology_refusal(&self) -> Option<TopologyRefusal> {
        Some(TopologyRefusal::Frozen {
            model: "rigid",
            reason: "a rigid body cannot be cut; make it an organ",
        })
    }

    fn save_for_undo(&self, _change: &TopologyChange, undo: &mut ModelUndo) {
        undo.numbers.extend_from_slice(&self.clock_s);
        undo.velocities_m_per_s.extend_from_slice(&self.velocities_m_per_s);
    }

    fn undo(&mut self, undo: &ModelUndo) {
        self.set_clock(undo.numbers.first().copied().unwrap_or(0.0));
        self.velocities_m_per_s.copy_from_slice(&undo.velocities_m_per_s);
    }

    fn topology_changed(&mut self, _mesh: &TetMesh, _change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.topology_refusal().map_or(Ok(()), Err)
    }
}
