//! An instrument as a CRTK device: its state (`operating_state`, `state_command`) and what its clients make it do.
//!
//! States and their transitions: Collaborative Robotics Toolkit, "Robot API: status" (collaborative-robotics/documentation).
//! FAULT does not occur: an instrument of the simulation has no power to lose.

use super::orders::{Order, StateCommand};
use glisson::math::{DMat3, DVec3};
use glisson::tool::ToolInput;
use glisson::tool::pose::ToolFrame;
use std::f64::consts::TAU;

/// A tip that should be further away than this from where it is was not ordered by a hand that follows it [m]; a choice,
/// under the 30 mm beyond which the simulation would put it there without a path.
const FARTHEST_SERVO_M: f64 = 0.025;
/// Farthest goal of `move_cp` [m]: a choice, more than an abdomen.
const FARTHEST_MOVE_M: f64 = 0.5;
/// How fast the tip goes and the shaft turns on the way to a goal; a choice, slow for a hand.
const MOVE_SPEED_M_PER_S: f64 = 0.05;
const TURN_SPEED_RAD_PER_S: f64 = 1.0;

/// CRTK's meta-states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// Nobody moves it this way.
    Disabled,
    /// It follows orders.
    Enabled,
    /// It stays where it is until `resume`: a client asked for it, or somebody else has control.
    Paused,
}

impl State {
    /// CRTK's name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Disabled => "DISABLED",
            Self::Enabled => "ENABLED",
            Self::Paused => "PAUSED",
        }
    }

    /// What becomes of it: CRTK's table; none where the command is not valid.
    fn after(self, command: StateCommand) -> Option<Self> {
        use StateCommand::{Disable, Enable, Home, Pause, Resume, Unhome};
        match (self, command) {
            (Self::Disabled | Self::Enabled, Enable) | (Self::Paused, Resume) => Some(Self::Enabled),
            (_, Disable) => Some(Self::Disabled),
            (Self::Enabled | Self::Paused, Pause) => Some(Self::Paused),
            (Self::Enabled, Home) | (_, Unhome) => Some(self),
            (Self::Paused, Enable)
            | (Self::Disabled, Pause)
            | (Self::Disabled | Self::Enabled, Resume)
            | (Self::Disabled | Self::Paused, Home) => None,
        }
    }
}

/// Why an order is not followed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub(super) enum Refusal {
    #[error("the instrument is {}; `enable` or `resume` it first", .0.name())]
    NotEnabled(State),
    #[error("{command:?} is not valid while the instrument is {}", state.name())]
    Transition { state: State, command: StateCommand },
    #[error("a viewer has control; it gives it back with its button or by leaving")]
    NoControl,
    #[error("the simulation is paused")]
    SimulationPaused,
    #[error("the goal is {distance_mm:.1} mm away from the tip; at most {most_mm:.0} mm")]
    Far { distance_mm: f64, most_mm: f64 },
}

fn far(distance_m: f64, most_m: f64) -> Result<(), Refusal> {
    let refusal = Refusal::Far { distance_mm: distance_m * 1e3, most_mm: most_m * 1e3 };
    if distance_m <= most_m { Ok(()) } else { Err(refusal) }
}

/// A motion that is under way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Motion {
    from: ToolInput,
    to: ToolInput,
    length_s: f64,
    passed_s: f64,
    is_homing: bool,
}

/// What surrounds an instrument when an order comes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Situation {
    /// Where the instrument is.
    pub(super) measured: ToolInput,
    /// Whether its clients may move it now: nobody else has control.
    pub(super) has_control: bool,
    pub(super) simulation_is_paused: bool,
}

/// One instrument.
#[derive(Clone, Debug)]
pub(super) struct Device {
    home: ToolInput,
    greatest_opening_rad: f64,
    state: State,
    is_homed: bool,
    /// Where it was ordered to be; none when it was not since it was enabled.
    setpoint: Option<ToolInput>,
    motion: Option<Motion>,
}

impl Device {
    /// `greatest_opening_rad`: of its jaws, 0 for none.
    pub(super) fn new(home: ToolInput, greatest_opening_rad: f64) -> Self {
        // It needs no homing: CRTK then has it homed from the start.
        Self {
            home,
            greatest_opening_rad,
            state: State::Disabled,
            is_homed: true,
            setpoint: None,
            motion: None,
        }
    }

    /// Somebody else moves it: CRTK's PAUSED, from which nobody may resume it.
    pub(super) fn held_elsewhere(self) -> Self {
        Self { state: State::Paused, ..self }
    }

    pub(super) fn state(&self) -> State {
        self.state
    }

    pub(super) fn is_homed(&self) -> bool {
        self.is_homed
    }

    /// A motion is under way (`move_cp`, `home`); servo commands never make it busy.
    pub(super) fn is_busy(&self) -> bool {
        self.motion.is_some()
    }

    /// Where it was ordered to be, else where it is.
    pub(super) fn setpoint(&self, measured: ToolInput) -> ToolInput {
        self.setpoint.unwrap_or(measured)
    }

    /// Follows an order; the answer is where the instrument should be now, if that changes.
    ///
    /// # Errors
    /// Why it is not followed.
    pub(super) fn obey(&mut self, order: Order, now: &Situation) -> Result<Option<ToolInput>, Refusal> {
        if let Order::State(command) = order {
            return self.change(command, now).map(|()| None);
        }
        self.may_move(now)?;
        let last = self.setpoint(now.measured);
        match order {
            Order::State(_) => Ok(None),
            Order::Servo { tip_in_world_m, world_from_tool } => {
                far(tip_in_world_m.distance(now.measured.tip_in_world_m), FARTHEST_SERVO_M)?;
                self.motion = None;
                Ok(Some(self.go_to(posed(last, tip_in_world_m, world_from_tool))))
            }
            Order::Move { tip_in_world_m, world_from_tool } => {
                far(tip_in_world_m.distance(now.measured.tip_in_world_m), FARTHEST_MOVE_M)?;
                self.start(now.measured, posed(last, tip_in_world_m, world_from_tool), false);
                Ok(None)
            }
            Order::ServoJaw { opening_rad } => {
                let jaw_opening = if self.greatest_opening_rad > 0.0 {
                    (opening_rad / self.greatest_opening_rad).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                if let Some(motion) = &mut self.motion {
                    (motion.from.jaw_opening, motion.to.jaw_opening) = (jaw_opening, jaw_opening);
                }
                Ok(Some(self.go_to(ToolInput { jaw_opening, ..last })))
            }
        }
    }

    fn may_move(&self, now: &Situation) -> Result<(), Refusal> {
        match self.state {
            State::Enabled if !now.has_control => Err(Refusal::NoControl),
            State::Enabled if now.simulation_is_paused => Err(Refusal::SimulationPaused),
            State::Enabled => Ok(()),
            state => Err(Refusal::NotEnabled(state)),
        }
    }

    fn change(&mut self, command: StateCommand, now: &Situation) -> Result<(), Refusal> {
        let needs_control =
            matches!(command, StateCommand::Enable | StateCommand::Resume | StateCommand::Home);
        let refusal = Refusal::Transition { state: self.state, command };
        let next = self.state.after(command).ok_or(refusal)?;
        if needs_control && !now.has_control {
            return Err(Refusal::NoControl);
        }
        if next != self.state {
            // It stays where it is: nothing that was ordered before counts.
            (self.setpoint, self.motion) = (None, None);
        }
        self.state = next;
        match command {
            StateCommand::Home => self.start(now.measured, self.home, true),
            StateCommand::Unhome => self.is_homed = false,
            _ => {}
        }
        Ok(())
    }

    fn go_to(&mut self, pose: ToolInput) -> ToolInput {
        *self.setpoint.insert(pose)
    }

    fn start(&mut self, from: ToolInput, to: ToolInput, is_homing: bool) {
        let tip_s = from.tip_in_world_m.distance(to.tip_in_world_m) / MOVE_SPEED_M_PER_S;
        let turn_rad = from.shaft_in_world.angle_between(to.shaft_in_world);
        let turn_s = turn_rad.max((to.roll_rad - from.roll_rad).abs()) / TURN_SPEED_RAD_PER_S;
        let length_s = if tip_s.max(turn_s).is_finite() { tip_s.max(turn_s) } else { 0.0 };
        self.motion = Some(Motion { from, to, length_s, passed_s: 0.0, is_homing });
    }

    /// `passed_s` later; the answer is where the instrument should be now, if that changes.
    pub(super) fn tick(&mut self, passed_s: f64, now: &Situation) -> Option<ToolInput> {
        if self.state == State::Enabled && !now.has_control {
            // Pre-empted: CRTK's PAUSED.
            self.state = State::Paused;
            (self.setpoint, self.motion) = (None, None);
        }
        let motion = self.motion.as_mut().filter(|_| !now.simulation_is_paused)?;
        motion.passed_s += passed_s;
        let share = if motion.length_s > 0.0 { (motion.passed_s / motion.length_s).min(1.0) } else { 1.0 };
        let pose = if share < 1.0 { between(&motion.from, &motion.to, share) } else { motion.to };
        if share >= 1.0 {
            self.is_homed |= motion.is_homing;
            self.motion = None;
        }
        Some(self.go_to(pose))
    }
}

/// At `share` of the way: the tip on a straight line, the shaft by the shortest turn as long as there is one.
fn between(from: &ToolInput, to: &ToolInput, share: f64) -> ToolInput {
    let toward = |from: f64, to: f64| from + (to - from) * share;
    ToolInput {
        tip_in_world_m: from.tip_in_world_m.lerp(to.tip_in_world_m, share),
        shaft_in_world: from.shaft_in_world.slerp(to.shaft_in_world, share).normalize_or(to.shaft_in_world),
        roll_rad: toward(from.roll_rad, to.roll_rad),
        jaw_opening: toward(from.jaw_opening, to.jaw_opening),
        trigger: to.trigger,
    }
}

/// `last` with another place and turn; its roll changes by at most half a turn.
fn posed(last: ToolInput, tip_in_world_m: DVec3, world_from_tool: DMat3) -> ToolInput {
    let shaft_in_world = world_from_tool.z_axis.normalize_or(last.shaft_in_world);
    let unrolled = ToolFrame::of(&ToolInput::at(tip_in_world_m, shaft_in_world)).world_from_tool;
    let x_axis = unrolled.transpose() * world_from_tool.x_axis;
    let roll_rad = x_axis.y.atan2(x_axis.x);
    let turns = ((last.roll_rad - roll_rad) / TAU).round();
    ToolInput { tip_in_world_m, shaft_in_world, roll_rad: roll_rad + TAU * turns, ..last }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::SeededRandom;

    fn free(measured: ToolInput) -> Situation {
        Situation { measured, has_control: true, simulation_is_paused: false }
    }

    fn home() -> ToolInput {
        ToolInput::at(DVec3::new(0.0, 0.0, 0.1), DVec3::Z)
    }

    fn to_tip(z_m: f64) -> ToolInput {
        ToolInput { tip_in_world_m: DVec3::Z * z_m, ..home() }
    }

    fn device(state: State) -> Device {
        Device { state, ..Device::new(home(), 1.0) }
    }

    fn turn(pose: ToolInput) -> DMat3 {
        ToolFrame::of(&pose).world_from_tool
    }

    fn servo(pose: ToolInput) -> Order {
        Order::Servo { tip_in_world_m: pose.tip_in_world_m, world_from_tool: turn(pose) }
    }

    fn move_to(pose: ToolInput) -> Order {
        Order::Move { tip_in_world_m: pose.tip_in_world_m, world_from_tool: turn(pose) }
    }

    /// Row by row as CRTK has it; `None`: not valid, and the state stays.
    #[test]
    fn states_change_as_crtk_has_it() {
        use State::{Disabled, Enabled, Paused};
        use StateCommand::{Disable, Enable, Pause, Resume};
        let table = [
            (Disabled, [Some(Enabled), Some(Disabled), None, None]),
            (Enabled, [Some(Enabled), Some(Disabled), Some(Paused), None]),
            (Paused, [None, Some(Disabled), Some(Paused), Some(Enabled)]),
        ];
        for (state, row) in table {
            for (command, expected) in [Enable, Disable, Pause, Resume].into_iter().zip(row) {
                let mut device = device(state);
                let answer = device.obey(Order::State(command), &free(home()));
                assert_eq!(answer.is_ok(), expected.is_some(), "{state:?} {command:?}");
                assert_eq!(device.state(), expected.unwrap_or(state), "{state:?} {command:?}");
            }
        }
    }

    #[test]
    fn poses_of_clients_are_poses_of_tools() {
        let mut random = SeededRandom::new(7);
        for _ in 0..200 {
            let shaft = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
            let roll_rad = random.uniform_in(-9.0, 9.0);
            let pose = ToolInput { roll_rad, jaw_opening: 0.5, ..ToolInput::at(DVec3::ONE, shaft) };
            // From a roll nearby the same one comes back, however often the tool was turned about.
            let last = ToolInput { roll_rad: roll_rad + random.uniform_in(-3.0, 3.0), ..pose };
            let back = posed(last, pose.tip_in_world_m, turn(pose));
            assert!(back.shaft_in_world.distance(shaft) < 1e-12 && (back.roll_rad - roll_rad).abs() < 1e-9);
            assert_eq!((back.tip_in_world_m, back.jaw_opening), (pose.tip_in_world_m, 0.5));
        }
    }

    #[test]
    fn only_an_enabled_instrument_follows_and_only_near_where_it_is() {
        let near = to_tip(0.11);
        for state in [State::Disabled, State::Paused] {
            let refused = device(state).obey(servo(near), &free(home()));
            assert_eq!(refused, Err(Refusal::NotEnabled(state)));
        }
        let mut enabled = device(State::Enabled);
        assert_eq!(enabled.setpoint(home()), home());
        let reached = enabled.obey(servo(near), &free(home())).unwrap().unwrap();
        assert!(reached.tip_in_world_m.distance(near.tip_in_world_m) < 1e-15);
        assert!(!enabled.is_busy() && enabled.setpoint(home()) == reached);
        let refusal = enabled.obey(servo(to_tip(0.2)), &free(home())).unwrap_err().to_string();
        assert_eq!(refusal, "the goal is 100.0 mm away from the tip; at most 25 mm");
        assert!(enabled.obey(servo(to_tip(f64::NAN)), &free(home())).is_err());
        let paused = Situation { simulation_is_paused: true, ..free(home()) };
        assert_eq!(enabled.obey(servo(near), &paused), Err(Refusal::SimulationPaused));
    }

    #[test]
    fn the_jaw_is_ordered_apart_and_stays_within_what_it_can() {
        let mut enabled = Device { state: State::Enabled, ..Device::new(home(), 0.8) };
        let jaw = |enabled: &mut Device, opening_rad| {
            enabled.obey(Order::ServoJaw { opening_rad }, &free(home())).unwrap().unwrap().jaw_opening
        };
        assert_eq!([0.4, 2.0, -1.0].map(|angle| jaw(&mut enabled, angle)), [0.5, 1.0, 0.0]);
        assert_eq!(jaw(&mut enabled, 0.2), 0.25);
        // A later pose keeps it.
        let posed = enabled.obey(servo(to_tip(0.11)), &free(home())).unwrap().unwrap();
        assert_eq!(posed.jaw_opening, 0.25);
    }

    #[test]
    fn a_motion_is_busy_keeps_its_speed_and_ends_at_its_goal() {
        let mut enabled = device(State::Enabled);
        let goal = ToolInput { roll_rad: 0.5, ..to_tip(0.2) };
        assert_eq!(enabled.obey(move_to(goal), &free(home())), Ok(None));
        assert!(enabled.is_busy());
        let (mut last, mut n_ticks) = (home(), 0);
        while enabled.is_busy() {
            let frozen = Situation { simulation_is_paused: true, ..free(last) };
            assert_eq!(enabled.tick(0.01, &frozen), None);
            let next = enabled.tick(0.01, &free(last)).unwrap();
            let step_m = next.tip_in_world_m.distance(last.tip_in_world_m);
            assert!(step_m <= 0.01 * MOVE_SPEED_M_PER_S + 1e-12, "{step_m}");
            (last, n_ticks) = (next, n_ticks + 1);
        }
        assert!(
            last.tip_in_world_m.distance(goal.tip_in_world_m) < 1e-12 && (last.roll_rad - 0.5).abs() < 1e-9
        );
        // 100 mm at 50 mm/s.
        assert!((199..=201).contains(&n_ticks), "{n_ticks}");
        assert_eq!(enabled.tick(0.01, &free(last)), None);
        assert!(enabled.obey(move_to(to_tip(1.0)), &free(home())).is_err());
    }

    #[test]
    fn homing_is_a_motion_and_a_pause_ends_motions() {
        let mut enabled = device(State::Enabled);
        let away = free(to_tip(0.11));
        enabled.obey(Order::State(StateCommand::Unhome), &away).unwrap();
        assert!(!enabled.is_homed());
        enabled.obey(Order::State(StateCommand::Home), &away).unwrap();
        enabled.tick(0.01, &away);
        assert!(enabled.is_busy() && !enabled.is_homed());
        enabled.obey(Order::State(StateCommand::Pause), &away).unwrap();
        assert!(!enabled.is_busy() && enabled.tick(0.01, &away).is_none());
        assert!(enabled.obey(Order::State(StateCommand::Home), &away).is_err());
        enabled.obey(Order::State(StateCommand::Resume), &away).unwrap();
        enabled.obey(Order::State(StateCommand::Home), &away).unwrap();
        let last = (0..100).filter_map(|_| enabled.tick(0.01, &away)).last().unwrap();
        assert!(enabled.is_homed() && !enabled.is_busy() && last == home());
    }

    #[test]
    fn who_takes_control_pauses_the_instrument_until_it_is_resumed() {
        let mut enabled = device(State::Enabled);
        enabled.obey(move_to(to_tip(0.15)), &free(home())).unwrap();
        let taken = Situation { has_control: false, ..free(home()) };
        assert_eq!(enabled.tick(0.01, &taken), None);
        assert_eq!((enabled.state(), enabled.is_busy()), (State::Paused, false));
        assert_eq!(enabled.obey(Order::State(StateCommand::Resume), &taken), Err(Refusal::NoControl));
        enabled.obey(Order::State(StateCommand::Resume), &free(home())).unwrap();
        assert_eq!(enabled.tick(0.01, &free(home())), None);
        let disabled = device(State::Disabled).obey(Order::State(StateCommand::Enable), &taken);
        assert_eq!(disabled, Err(Refusal::NoControl));
    }
}
