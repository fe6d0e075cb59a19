//! One run of the haptic loop: a simulated device with a hand, the law, and a simulation that steps more slowly and hears and
//! speaks late.

use glisson::haptics::{
    EnergyControl, ForceEstimate, HandPath, HandSettings, HapticDevice, HapticLaw, HapticModel, LawSettings,
    SimulatedDevice, SimulatedDeviceSettings, Touch,
};
use glisson::math::{DVec3, outer};
use glisson::tool::ToolInput;
use std::collections::VecDeque;

/// Haptic ticks a second.
pub(super) const TICKS_PER_S: f64 = 1000.0;
/// The handle comes from this height above the surface ...
const ABOVE_M: f64 = 5e-3;
/// ... wants to be this deep ...
const DEPTH_M: f64 = 10e-3;
/// ... within this time [s], after a moment without ...
const REACH_S: f64 = 0.5;
const START_S: f64 = 0.3;
/// ... slides along the surface in this time, if it does ...
const SLIDE_FROM_S: f64 = 0.9;
const SLIDE_S: f64 = 1.2;
/// ... rests until then ...
const LEAVE_S: f64 = 3.3;
/// ... and goes back.
const END_S: f64 = 4.2;
/// The hand has wanted to rest for long when it is looked at whether it does.
const REST_FROM_S: f64 = 2.5;

/// Of wet tissue. The simulation's own force has no drag, which would only take energy from the hand.
const FRICTION: f64 = 0.05;

/// What a run is of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    pub(super) device: SimulatedDeviceSettings,
    pub(super) hand: HandSettings,
    pub(super) estimate: ForceEstimate,
    pub(super) control: EnergyControl,
    /// From the tool to the simulation and back to the haptic loop [s], half each.
    pub(super) delay_s: f64,
    /// Steps of the simulation a second.
    pub(super) rate_hz: f64,
    /// Height of the surface [m].
    pub(super) surface_m: f64,
    /// How far the hand slides along the surface before it rests [m].
    pub(super) slide_m: f64,
}

/// What came out of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Run {
    /// Least energy that the law observed [J].
    pub(super) least_j: f64,
    /// Least energy that the actuator in truth had taken [J].
    pub(super) least_true_j: f64,
    /// From the lowest to the highest place of the handle while the hand wants to rest [m].
    pub(super) swing_m: f64,
    /// The same in the last fifth of that time: whether it dies away.
    pub(super) late_swing_m: f64,
    /// Most energy that the hand got while it wanted to rest [J].
    pub(super) given_at_rest_j: f64,
    /// Greatest acceleration of the handle [m/s2].
    pub(super) acceleration_m_per_s2: f64,
    /// Largest force on the hand [N].
    pub(super) force_n: f64,
    /// Tick by tick: height over the surface [m], force on the hand [N], observed energy [J].
    pub(super) heights_m: Vec<f64>,
    pub(super) forces_n: Vec<f64>,
    pub(super) energies_j: Vec<f64>,
}

/// Runs it: `simulate` takes the tool and the time [s] since the last step, and publishes.
pub(super) fn run(case: &Case, simulate: &mut dyn FnMut(&ToolInput, f64) -> HapticModel) -> Run {
    let way = Way::of(case);
    let mut device = SimulatedDevice::new(&case.device, &case.hand, way.down(), 1);
    let settings = LawSettings { estimate: case.estimate, control: case.control, ..LawSettings::default() };
    let mut law = HapticLaw::new(&settings, &device.limits());
    let tick_s = 1.0 / TICKS_PER_S;
    let mut far = FarSimulation::new(case, ToolInput::at(way.above_m, DVec3::Z));
    let mut out = Run::default();
    let mut velocity = DVec3::ZERO;
    for tick in 0..(END_S * TICKS_PER_S) as usize {
        if let Some(path) = way.begins_at(tick) {
            device.set_path(path);
        }
        far.tick(tick, simulate);
        let Ok(state) = device.read() else { continue };
        let answer = law.tick(&state, &far.latest, (tick - far.made) as f64 * tick_s, tick_s);
        far.tools.pop_front();
        far.tools.push_back(answer.tool);
        if device.write(&answer.command).is_err() {
            continue;
        }
        let height_m = device.handle_m().z - case.surface_m;
        out.acceleration_m_per_s2 =
            out.acceleration_m_per_s2.max((device.handle_m_per_s() - velocity).length() / tick_s);
        velocity = device.handle_m_per_s();
        out.least_j = out.least_j.min(law.observed_energy_j());
        out.least_true_j = out.least_true_j.min(device.port_energy_j());
        out.force_n = out.force_n.max(answer.command.force_n.length());
        out.heights_m.push(height_m);
        out.forces_n.push(answer.command.force_n.z);
        out.energies_j.push(law.observed_energy_j());
    }
    out.look_at_rest();
    out
}

/// Where the hand goes.
struct Way {
    above_m: DVec3,
    deep_m: DVec3,
    side_m: DVec3,
}

impl Way {
    fn of(case: &Case) -> Self {
        Self {
            above_m: DVec3::Z * (case.surface_m + ABOVE_M),
            deep_m: DVec3::Z * (case.surface_m - DEPTH_M),
            side_m: DVec3::X * case.slide_m,
        }
    }

    fn down(&self) -> HandPath {
        HandPath::Reach { from_m: self.above_m, to_m: self.deep_m, start_s: START_S, duration_s: REACH_S }
    }

    /// The path that begins at this tick, if one does.
    fn begins_at(&self, tick: usize) -> Option<HandPath> {
        let Self { above_m, deep_m, side_m } = *self;
        let is_at = |time_s: f64| tick == (time_s * TICKS_PER_S) as usize;
        if side_m.x > 0.0 && is_at(SLIDE_FROM_S) {
            return Some(HandPath::Reach {
                from_m: deep_m,
                to_m: deep_m + side_m,
                start_s: SLIDE_FROM_S,
                duration_s: SLIDE_S,
            });
        }
        is_at(LEAVE_S).then_some(HandPath::Reach {
            from_m: deep_m + side_m,
            to_m: above_m + side_m,
            start_s: LEAVE_S,
            duration_s: REACH_S,
        })
    }
}

/// The simulation at the other end of the delay.
struct FarSimulation {
    period_s: f64,
    /// Ticks that a tool or a model takes.
    one_way: usize,
    n_steps: u32,
    /// Tools on their way; the first has arrived.
    tools: VecDeque<ToolInput>,
    /// Models on their way: when they were made, when they arrive.
    on_their_way: VecDeque<(usize, usize, HapticModel)>,
    /// What has arrived here last, and when it was made.
    latest: HapticModel,
    made: usize,
}

impl FarSimulation {
    fn new(case: &Case, tool: ToolInput) -> Self {
        let one_way = (0.5 * case.delay_s * TICKS_PER_S).round() as usize;
        Self {
            period_s: 1.0 / case.rate_hz,
            one_way,
            n_steps: 0,
            tools: std::iter::repeat_n(tool, one_way + 1).collect(),
            on_their_way: VecDeque::new(),
            latest: HapticModel::default(),
            made: 0,
        }
    }

    /// Steps when it is time, and receives what arrives.
    fn tick(&mut self, tick: usize, simulate: &mut dyn FnMut(&ToolInput, f64) -> HapticModel) {
        let tick_s = 1.0 / TICKS_PER_S;
        if tick as f64 * tick_s >= f64::from(self.n_steps) * self.period_s {
            self.n_steps += 1;
            let model = simulate(&self.tools[0], self.period_s);
            self.on_their_way.push_back((tick, tick + self.one_way, model));
        }
        while self.on_their_way.front().is_some_and(|(_, arrives, _)| *arrives <= tick) {
            if let Some((made_at, _, model)) = self.on_their_way.pop_front() {
                (self.latest, self.made) = (model, made_at);
            }
        }
    }
}

impl Run {
    /// Whether the handle and its energy came to rest where the hand wants to rest.
    fn look_at_rest(&mut self) {
        let (rest, leave) = ((REST_FROM_S * TICKS_PER_S) as usize, (LEAVE_S * TICKS_PER_S) as usize);
        self.swing_m = width(&self.heights_m[rest..leave]);
        self.late_swing_m = width(&self.heights_m[leave - (leave - rest) / 5..leave]);
        let mut most_j = f64::NEG_INFINITY;
        for energy_j in &self.energies_j[rest..leave] {
            most_j = most_j.max(*energy_j);
            self.given_at_rest_j = self.given_at_rest_j.max(most_j - energy_j);
        }
    }
}

/// From the least to the greatest.
fn width(values: &[f64]) -> f64 {
    let ends =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
    ends.1 - ends.0
}

/// Tissue as a mass between two springs: the tool presses one, the other stands on the ground beside a damper.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpringMass {
    spring_n_per_m: f64,
    mass_kg: f64,
    damping_n_s_per_m: f64,
    place_m: f64,
    speed_m_per_s: f64,
    step: u64,
    time_s: f64,
}

impl SpringMass {
    /// At rest it yields like a spring of that stiffness [N/m]. 20 g are a few cubic centimetres that move with the tip; a tenth
    /// of critical damping leaves most of the ringing: choices.
    pub(super) fn new(stiffness_n_per_m: f64) -> Self {
        let (mass_kg, spring_n_per_m) = (0.02, 2.0 * stiffness_n_per_m);
        let critical = 2.0 * (mass_kg * 2.0 * spring_n_per_m).sqrt();
        Self {
            spring_n_per_m,
            mass_kg,
            damping_n_s_per_m: 0.1 * critical,
            place_m: 0.0,
            speed_m_per_s: 0.0,
            step: 0,
            time_s: 0.0,
        }
    }

    /// The tool is over another place, where the tissue yields like a spring of that stiffness [N/m].
    pub(super) fn yields(&mut self, stiffness_n_per_m: f64) {
        self.spring_n_per_m = 2.0 * stiffness_n_per_m;
    }

    /// One step of backward Euler with the tool there, and what is published after it: force and its slope over that step.
    pub(super) fn step(&mut self, tool: &ToolInput, period_s: f64) -> HapticModel {
        let tip_m = tool.tip_in_world_m;
        let inertia = self.mass_kg / (period_s * period_s);
        let damper = self.damping_n_s_per_m / period_s;
        let own = inertia + damper + self.spring_n_per_m;
        let known_n = inertia * (self.place_m + period_s * self.speed_m_per_s) + damper * self.place_m;
        let touched_m = (known_n + self.spring_n_per_m * tip_m.z) / (own + self.spring_n_per_m);
        let touches = touched_m > tip_m.z;
        let place_m = if touches { touched_m } else { known_n / own };
        self.speed_m_per_s = (place_m - self.place_m) / period_s;
        self.place_m = place_m;
        self.step += 1;
        self.time_s += period_s;
        let slope = self.spring_n_per_m * own / (own + self.spring_n_per_m);
        let pressed_m = if touches { place_m - tip_m.z } else { 0.0 };
        HapticModel {
            step: self.step,
            time_s: self.time_s,
            period_s,
            touch: if touches { Touch::Contact } else { Touch::Free },
            tip_m,
            force_n: DVec3::Z * (self.spring_n_per_m * pressed_m),
            stiffness_n_per_m: outer(DVec3::Z, DVec3::Z) * slope,
            surface_m: DVec3::Z * place_m,
            normal: DVec3::Z,
            gap_m: tip_m.z - place_m,
            surface_velocity_m_per_s: DVec3::Z * self.speed_m_per_s,
            friction_coefficient: FRICTION,
            ..HapticModel::default()
        }
    }
}
