//! The haptic law and the simulated device: forces without jumps, what is felt at rest, clutch, delays.

use glam::DQuat;
use glisson::haptics::passivity::EnergyControl;
use glisson::haptics::{
    AxesModel, DeviceLimits, DeviceMapping, DeviceState, ForceCommand, HandPath, HandSettings, HapticDevice,
    HapticLaw, HapticModel, LawSettings, LawTick, SimulatedDevice, SimulatedDeviceSettings, Touch,
};
use glisson::math::{DMat3, DVec3};

const TICK_S: f64 = 1e-3;
/// Issue 6: no force jump above this in a tick beyond what stiffness and motion explain [N].
const MOST_JUMP_N: f64 = 0.05;

const LIMITS: DeviceLimits = DeviceLimits {
    force_n: 8.0,
    torque_n_m: 0.0,
    force_rate_n_per_s: 5000.0,
    stiffness_n_per_m: 1200.0,
    damping_n_s_per_m: 0.6,
    resolution_m: 0.0,
    rate_hz: 1000.0,
    ..DeviceLimits::NONE
};

fn at(position_m: DVec3) -> DeviceState {
    DeviceState {
        position_m,
        velocity_m_per_s: DVec3::ZERO,
        orientation: Some(DQuat::IDENTITY),
        jaw_opening: 0.0,
        buttons: 0,
    }
}

/// Tissue below the plane z = 0 that was touched 5 mm deep.
fn spring(step: u64, stiffness_n_per_m: f64) -> HapticModel {
    HapticModel {
        step,
        period_s: 0.03,
        touch: Touch::Contact,
        tip_m: DVec3::Z * -5e-3,
        force_n: DVec3::Z * (5e-3 * stiffness_n_per_m),
        stiffness_n_per_m: DMat3::IDENTITY * stiffness_n_per_m,
        normal: DVec3::Z,
        gap_m: -5e-3,
        ..HapticModel::default()
    }
}

/// A run whose commands are checked for jumps.
struct Smooth {
    law: HapticLaw,
    last_n: DVec3,
    greatest_n: f64,
}

impl Smooth {
    fn new(settings: &LawSettings) -> Self {
        Self { law: HapticLaw::new(settings, &LIMITS), last_n: DVec3::ZERO, greatest_n: 0.0 }
    }

    fn note(&mut self, out: LawTick) -> LawTick {
        self.greatest_n = self.greatest_n.max((out.command.force_n - self.last_n).length());
        self.last_n = out.command.force_n;
        out
    }

    /// The handle rests 10 mm deep.
    fn rest(&mut self, n_ticks: usize, model: &HapticModel, age_s: f64) -> LawTick {
        (0..n_ticks)
            .map(|_| {
                let out = self.law.tick(&at(DVec3::Z * -1e-2), model, age_s, TICK_S);
                self.note(out)
            })
            .last()
            .expect("at least one tick")
    }

    fn lost(&mut self, n_ticks: usize) {
        for _ in 0..n_ticks {
            let out = self.law.lost(TICK_S);
            assert!(out.report.is_lost);
            self.note(out);
        }
    }
}

/// Coupling and tissue in series, 10 mm pressed together.
fn series_n(stiffness_n_per_m: f64) -> f64 {
    let coupling = 0.6 * LIMITS.stiffness_n_per_m;
    1e-2 * coupling * stiffness_n_per_m / (coupling + stiffness_n_per_m)
}

#[test]
fn start_reconnect_standstill_and_rupture_come_without_jumps() {
    let mut run = Smooth::new(&LawSettings::default());
    let model = spring(1, 400.0);
    let out = run.rest(1500, &model, 0.01);
    assert!((out.command.force_n.z - series_n(400.0)).abs() < 1e-3, "{}", out.command.force_n);
    for n_lost in [1, 30, 400] {
        run.lost(n_lost);
        let left_n = run.last_n.z;
        assert!(n_lost < 200 || left_n == 0.0, "{n_lost}: {left_n}");
        let out = run.rest(1, &model, 0.01);
        assert_eq!(out.report.is_restart, n_lost >= 200, "{n_lost}");
        let out = run.rest(1500, &model, 0.01);
        assert!((out.command.force_n.z - series_n(400.0)).abs() < 1e-3, "{n_lost}: {}", out.command.force_n);
    }
    let out = run.rest(300, &model, 0.3);
    assert!(out.report.is_stale && out.command.force_n == DVec3::ZERO);
    run.rest(1500, &spring(2, 400.0), 0.01);
    let before_n = run.last_n.z;
    let torn = HapticModel { step: 3, ..HapticModel::default() };
    let out = run.rest(19, &torn, 0.01);
    assert!(out.command.force_n.z > 0.5 * before_n, "a rupture is spread over 20 ms at least");
    let out = run.rest(300, &torn, 0.01);
    assert!(out.command.force_n.length() < 1e-12, "and all of it comes");
    assert!(run.greatest_n <= MOST_JUMP_N, "{}", run.greatest_n);
}

/// What a hand feels is the change from one write to the next, however much later the second one comes.
#[test]
fn a_late_tick_changes_the_force_no_more_than_one_in_time() {
    let model = spring(1, 400.0);
    let torn = HapticModel { step: 2, ..HapticModel::default() };
    let place = at(DVec3::Z * -1e-2);
    let late_s = 0.1;
    let mut run = Smooth::new(&LawSettings { period_s: TICK_S, ..LawSettings::default() });
    // The first one of all.
    let out = run.law.tick(&place, &model, 0.01, late_s);
    run.note(out);
    run.rest(1500, &model, 0.01);
    // The device away and back, the simulation standing still and going on, a rupture.
    let out = run.law.lost(late_s);
    run.note(out);
    for (model, age_s) in [(&model, 0.01), (&model, 0.3), (&model, 0.01), (&torn, 0.01)] {
        let out = run.law.tick(&place, model, age_s, late_s);
        run.note(out);
        run.rest(30, model, age_s);
    }
    assert!(run.greatest_n <= MOST_JUMP_N, "{}", run.greatest_n);
    let out = run.rest(500, &torn, 0.01);
    assert!(out.command.force_n.length() < 1e-12);
}

#[test]
fn a_law_that_lets_go_takes_the_force_back_along_its_ramp() {
    let model = spring(1, 400.0);
    let mut run = Smooth::new(&LawSettings::default());
    let held_n = run.rest(1500, &model, 0.01).command.force_n.z;
    assert!(!run.law.has_let_go());
    run.law.let_go();
    let n_ticks = (run.law.ramp_s() / TICK_S).ceil() as usize;
    let out = run.rest(n_ticks / 2, &model, 0.01);
    assert!((out.command.force_n.z - 0.5 * held_n).abs() < 0.02 * held_n, "{}", out.command.force_n);
    assert!(!run.law.has_let_go());
    let out = run.rest(n_ticks / 2 + 2, &model, 0.01);
    assert!(run.law.has_let_go() && out.command.force_n == DVec3::ZERO);
    assert_eq!(run.rest(100, &model, 0.01).command.force_n, DVec3::ZERO, "it does not come back");
    assert!(run.greatest_n <= MOST_JUMP_N, "{}", run.greatest_n);
}

/// Without power it pushes with nothing, whatever the law has asked it for: it comes back at nothing.
#[test]
fn a_device_that_took_no_command_begins_at_nothing() {
    let model = spring(1, 400.0);
    for n_lost in [0, 1, 40] {
        let mut run = Smooth::new(&LawSettings::default());
        run.rest(1500, &model, 0.01);
        for _ in 0..n_lost {
            run.law.lost(TICK_S);
            run.law.not_taken();
        }
        run.law.not_taken();
        assert!(n_lost == 0 || run.law.lost(TICK_S).command.force_n == DVec3::ZERO);
        run.last_n = DVec3::ZERO;
        assert!(run.rest(1, &model, 0.01).report.is_restart);
        let out = run.rest(1500, &model, 0.01);
        assert!((out.command.force_n.z - series_n(400.0)).abs() < 1e-3, "{n_lost}: {}", out.command.force_n);
        assert!(run.greatest_n <= MOST_JUMP_N, "{n_lost}: {}", run.greatest_n);
    }
}

#[test]
fn a_model_that_is_no_number_counts_as_no_tissue() {
    let mut run = Smooth::new(&LawSettings::default());
    run.rest(1500, &spring(1, 400.0), 0.01);
    let broken = HapticModel { force_n: DVec3::NAN, step: 2, ..spring(2, 400.0) };
    let out = run.rest(300, &broken, 0.01);
    assert!(out.command.force_n.length() < 1e-12 && run.greatest_n <= MOST_JUMP_N);
    let out = run.law.tick(&at(DVec3::NAN), &broken, 0.0, TICK_S);
    assert!(out.report.is_lost && out.tool.is_finite());
    let out = run.rest(1, &spring(3, 400.0), f64::NAN);
    assert!(out.report.is_stale);
}

#[test]
fn the_clutch_lets_force_fade_and_the_tool_stay() {
    let mut run = Smooth::new(&LawSettings::default());
    let model = spring(1, 400.0);
    let held = run.rest(1500, &model, 0.01).tool.tip_in_world_m;
    let mut place_m = DVec3::Z * -1e-2;
    let mut out = None;
    for _ in 0..400 {
        place_m += DVec3::new(1e-5, 0.0, 2e-5);
        let moved = run.law.tick(&DeviceState { buttons: 2, ..at(place_m) }, &model, 0.01, TICK_S);
        out = Some(run.note(moved));
    }
    let out = out.expect("it ran");
    assert!(out.report.is_clutched && out.command.force_n == DVec3::ZERO);
    let stayed_m = (out.tool.tip_in_world_m - held).length();
    assert!(stayed_m < 3e-5, "no more than the step with which the button was pressed: {stayed_m}");
    for _ in 0..400 {
        let still = run.law.tick(&at(place_m), &model, 0.01, TICK_S);
        run.note(still);
    }
    assert!((run.last_n.z - series_n(400.0)).abs() < 1e-2, "{}", run.last_n);
    assert!(run.greatest_n <= MOST_JUMP_N, "{}", run.greatest_n);
}

#[test]
fn a_handle_that_is_put_elsewhere_begins_anew() {
    let mut run = Smooth::new(&LawSettings::default());
    let model = spring(1, 400.0);
    run.rest(1500, &model, 0.01);
    let out = run.law.tick(&at(DVec3::Z * 0.1), &model, 0.01, TICK_S);
    assert!(out.report.is_restart && out.command.force_n.length() < 1e-9);
    let energy_j = run.law.observed_energy_j();
    run.law.place(DVec3::X, DVec3::Y);
    let out = run.law.tick(&at(DVec3::X), &model, 0.01, TICK_S);
    assert!(out.report.is_restart);
    assert!((out.tool.tip_in_world_m - DVec3::Y).length() < 1e-12);
    assert_eq!(run.law.observed_energy_j(), energy_j);
}

#[test]
fn a_device_that_tells_no_orientation_leaves_the_instrument_turned_as_it_was_put() {
    let [put, told] = [
        DQuat::from_rotation_arc(DVec3::Z, DVec3::new(0.6, 0.0, 0.8)),
        DQuat::from_rotation_arc(DVec3::Z, DVec3::new(0.0, 1.0, 0.0)),
    ];
    let world_from_device = DQuat::from_rotation_x(0.3);
    let mapping = DeviceMapping { world_from_handle: put, world_from_device, ..DeviceMapping::default() };
    let mut law = HapticLaw::new(&LawSettings { mapping, ..LawSettings::default() }, &LIMITS);
    let silent = DeviceState { orientation: None, ..at(DVec3::ZERO) };
    let model = HapticModel::default();
    let points = |out: &LawTick, along: DQuat| out.tool.shaft_in_world.distance(along * DVec3::Z) < 1e-12;
    for tick in 0..20 {
        let out = law.tick(&silent, &model, 0.01, TICK_S);
        assert!(points(&out, put) && out.report.is_restart == (tick == 0), "{out:?}");
    }
    assert!(points(&law.lost(TICK_S), put));
    assert!(!law.tick(&silent, &model, 0.01, TICK_S).report.is_restart);
    // The hand did no work by being heard for the first time: it begins anew.
    let device = DeviceState { orientation: Some(told), ..silent };
    for tick in 0..3 {
        let out = law.tick(&device, &model, 0.01, TICK_S);
        assert!(points(&out, world_from_device * told) && out.report.is_restart == (tick == 0), "{out:?}");
    }
    let out = law.tick(&silent, &model, 0.01, TICK_S);
    assert!(points(&out, put) && out.report.is_restart);
}

/// Half the motion, three times the force: against a rigid body the handle still feels the coupling's own stiffness.
#[test]
fn scaled_motion_and_force_keep_the_coupling_within_the_device() {
    let mapping = DeviceMapping { motion_scale: 0.5, force_scale: 3.0, ..DeviceMapping::default() };
    let mut law = HapticLaw::new(&LawSettings { mapping, ..LawSettings::default() }, &LIMITS);
    let rigid = HapticModel {
        stiffness_n_per_m: DMat3::IDENTITY * 1e7,
        tip_m: DVec3::ZERO,
        force_n: DVec3::Z * 1e-6,
        ..spring(1, 1.0)
    };
    let mut force_n = 0.0;
    for tick in 0..3000 {
        let z_m = -5e-3 * (f64::from(tick) / 1000.0).min(1.0);
        force_n = law.tick(&at(DVec3::Z * z_m), &rigid, 0.01, TICK_S).command.force_n.z;
    }
    let felt_n_per_m = force_n / 5e-3;
    assert!((felt_n_per_m - 0.6 * LIMITS.stiffness_n_per_m).abs() < 1.0, "{felt_n_per_m}");
}

#[test]
fn in_free_space_there_is_no_force_and_the_tool_is_at_the_handle() {
    let mut law = HapticLaw::new(&LawSettings::default(), &LIMITS);
    for tick in 0..500 {
        let place_m = DVec3::new(0.05, 0.02, -0.03) * (f64::from(tick) * 0.01).sin();
        let out = law.tick(&at(place_m), &HapticModel::default(), 0.0, TICK_S);
        assert_eq!(out.command.force_n, DVec3::ZERO);
        assert!((out.tool.tip_in_world_m - place_m).length() < 1e-12);
    }
}

#[test]
fn a_tick_allocates_nothing() {
    let mut device = SimulatedDevice::new(
        &SimulatedDeviceSettings { noise_m: 1e-5, ..SimulatedDeviceSettings::default() },
        &HandSettings::default(),
        HandPath::Swing { center_m: DVec3::Z * -2e-3, amplitude_m: DVec3::Z * 6e-3, frequency_hz: 3.0 },
        1,
    );
    let mut law = HapticLaw::new(&LawSettings::default(), &device.limits());
    let model = spring(1, 400.0);
    let count = allocation_counter::measure(|| {
        for _ in 0..1000 {
            let state = device.read().expect("it always answers");
            let out = law.tick(&state, &model, 0.01, TICK_S);
            device.write(&out.command).expect("it always takes");
            law.lost(TICK_S);
        }
    });
    assert_eq!(count.count_total, 0);
}

fn settled(device: &mut SimulatedDevice, force_n: DVec3, n_ticks: usize) -> DVec3 {
    for _ in 0..n_ticks {
        device.write(&ForceCommand { force_n, ..ForceCommand::default() }).unwrap();
    }
    device.handle_m()
}

#[test]
fn a_pushed_handle_comes_to_rest_where_grip_and_arm_hold_it() {
    let hand = HandSettings::default();
    let rest = HandPath::Rest(DVec3::ONE);
    let mut device = SimulatedDevice::new(&SimulatedDeviceSettings::ideal(), &hand, rest, 1);
    let force_n = DVec3::new(1.0, -2.0, 0.5);
    let found_m = settled(&mut device, force_n, 3000) - DVec3::ONE;
    let yields = 1.0 / hand.grip_stiffness_n_per_m + 1.0 / hand.arm_stiffness_n_per_m;
    assert!((found_m - force_n * yields).length() < 1e-9, "{found_m}");
    assert!((device.port_energy_j() + force_n.length_squared() * yields).abs() < 1e-9, "work of a force");
    let stronger_m = settled(&mut device, DVec3::X * 99.0, 3000) - DVec3::ONE;
    assert!((stronger_m.x - 3.3 * yields).abs() < 1e-9, "the actuator's limit");
    let mut device = SimulatedDevice::new(
        &SimulatedDeviceSettings { friction_n: 0.2, ..SimulatedDeviceSettings::ideal() },
        &hand,
        rest,
        1,
    );
    assert_eq!(settled(&mut device, DVec3::X * 0.19, 100), DVec3::ONE, "less than friction moves nothing");
}

/// Undamped between two walls: the handle swings as two masses on springs do.
#[test]
fn the_simulated_masses_swing_at_their_frequency() {
    let hand = HandSettings {
        mass_kg: 1e6,
        grip_stiffness_n_per_m: 800.0,
        grip_damping_n_s_per_m: 0.0,
        arm_stiffness_n_per_m: 0.0,
        arm_damping_n_s_per_m: 0.0,
    };
    let settings = SimulatedDeviceSettings { damping_n_s_per_m: 0.0, ..SimulatedDeviceSettings::ideal() };
    let mut device = SimulatedDevice::new(&settings, &hand, HandPath::Rest(DVec3::ZERO), 1);
    settled(&mut device, DVec3::X * 3.0, 1);
    let mut crossings = Vec::new();
    let mut before_m = device.handle_m().x;
    for _ in 0..5000 {
        let now_m = settled(&mut device, DVec3::ZERO, 1).x;
        if before_m < 0.0 && now_m >= 0.0 {
            crossings.push(device.time_s() - TICK_S * now_m / (now_m - before_m));
        }
        before_m = now_m;
    }
    let period_s = (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64;
    let expected_s = std::f64::consts::TAU * (settings.mass_kg / 800.0).sqrt();
    assert!((period_s / expected_s - 1.0).abs() < 1e-4, "{period_s} {expected_s}");
}

#[test]
fn positions_and_forces_come_as_late_as_set_and_the_same_twice() {
    let settings = SimulatedDeviceSettings {
        position_latency_ticks: 4,
        force_latency_ticks: 3,
        noise_m: 2e-5,
        ..SimulatedDeviceSettings::default()
    };
    let run = |seed: u64| {
        let path =
            HandPath::Reach { from_m: DVec3::ZERO, to_m: DVec3::X * 0.05, start_s: 0.0, duration_s: 0.2 };
        let mut device = SimulatedDevice::new(&settings, &HandSettings::default(), path, seed);
        let mut told = Vec::new();
        let mut true_m = vec![device.handle_m()];
        for tick in 0..300 {
            told.push(device.read().unwrap().position_m);
            let force_n = DVec3::Y * f64::from(tick % 50) * 0.01;
            device.write(&ForceCommand { force_n, ..ForceCommand::default() }).unwrap();
            true_m.push(device.handle_m());
            let late = f64::from((tick - 3).max(0) % 50) * 0.01;
            assert!((device.actuator_n().y - late).abs() < 1e-15, "{tick}");
        }
        for tick in 10..300 {
            let off_m = (told[tick] - true_m[tick - 4]).length();
            assert!(off_m < 6.0 * 2e-5 * 3.0_f64.sqrt() + 5.5e-5, "{tick}: {off_m}");
        }
        told
    };
    assert_eq!(run(7), run(7));
    assert_ne!(run(7), run(8));
}

/// With control or without, a passive tissue feels the same: the tank stands aside.
#[test]
fn control_changes_nothing_where_nothing_is_wrong() {
    let run = |control: EnergyControl| {
        let path =
            HandPath::Swing { center_m: DVec3::ZERO, amplitude_m: DVec3::Z * -8e-3, frequency_hz: 1.5 };
        let mut device =
            SimulatedDevice::new(&SimulatedDeviceSettings::default(), &HandSettings::default(), path, 2);
        let mut law = HapticLaw::new(&LawSettings { control, ..LawSettings::default() }, &device.limits());
        let model = HapticModel { touch: Touch::Free, tip_m: DVec3::ZERO, gap_m: 0.0, ..spring(1, 400.0) };
        (0..3000)
            .map(|_| {
                let state = device.read().unwrap();
                let out = law.tick(&state, &model, 0.01, TICK_S);
                device.write(&out.command).unwrap();
                out.command.force_n
            })
            .collect::<Vec<_>>()
    };
    let forces = run(EnergyControl::Tank);
    assert_eq!(forces, run(EnergyControl::ObserveOnly));
    assert!(forces.iter().any(|f| f.z > 0.5));
}

/// What turns the instrument and opens its jaws comes to the handle along its own axis and over its own way, without a jump,
/// and goes when the tissue does.
#[test]
fn twist_and_jaws_are_felt_at_the_handle() {
    let limits = DeviceLimits { torque_n_m: 0.2, jaw_force_n: 10.0, jaw_travel_m: 0.02, ..LIMITS };
    let axes = AxesModel {
        twist_n_m: 0.03,
        roll_rad: 0.0,
        twist_stiffness_n_m_per_rad: 0.05,
        jaw_j: 0.02,
        jaw_opening: 0.1,
        jaw_stiffness_j: 0.05,
    };
    let held = HapticModel { step: 1, touch: Touch::Grasp, axes, ..HapticModel::default() };
    let mapping = DeviceMapping { force_scale: 2.0, motion_scale: 0.5, ..DeviceMapping::default() };
    // Energy at the handle is that at the tip times force scale over motion scale.
    let scale = 4.0;
    let settings = LawSettings { mapping, period_s: TICK_S, ..LawSettings::default() };
    let mut law = HapticLaw::new(&settings, &limits);
    let orientation = DQuat::from_rotation_arc(DVec3::Z, DVec3::new(0.6, 0.0, 0.8));
    let device =
        |jaw_opening: f64| DeviceState { orientation: Some(orientation), jaw_opening, ..at(DVec3::ZERO) };
    let mut last = ForceCommand::default();
    let mut tick = |model: &HapticModel, jaw_opening: f64| {
        let command = law.tick(&device(jaw_opening), model, 0.01, TICK_S).command;
        assert!((command.jaw_force_n - last.jaw_force_n).abs() <= scale * 0.04 + 0.12, "{command:?}");
        last = command;
        command
    };
    // The turn of this orientation against the tool's frame is not known here: it is the one that the first tick tells.
    let mut probe = HapticLaw::new(&settings, &limits);
    let roll_rad = probe.tick(&device(0.1), &held, 0.01, TICK_S).tool.roll_rad;
    let held = HapticModel { axes: AxesModel { roll_rad, ..axes }, ..held };
    let mut felt = ForceCommand::default();
    for _ in 0..600 {
        felt = tick(&held, 0.1);
    }
    assert!((felt.jaw_force_n - scale * 0.02 / 0.02).abs() < 1e-9, "{felt:?}");
    let wanted_n_m = orientation * DVec3::Z * (scale * 0.03);
    assert!(felt.torque_n_m.distance(wanted_n_m) < 1e-9, "{felt:?}");
    // Closing on is harder, by the stiffness.
    for i in 0..100 {
        felt = tick(&held, 0.1 - 0.05 * f64::from(i + 1) / 100.0);
    }
    assert!((felt.jaw_force_n - scale * 0.0225 / 0.02).abs() < 0.01, "{felt:?}");
    for _ in 0..300 {
        felt = tick(&HapticModel { step: 2, ..HapticModel::default() }, 0.05);
    }
    assert_eq!((felt.jaw_force_n, felt.torque_n_m), (0.0, DVec3::ZERO));
    // A device without jaws and torque feels none of it.
    let mut plain = HapticLaw::new(&settings, &LIMITS);
    for _ in 0..300 {
        felt = plain.tick(&device(0.1), &held, 0.01, TICK_S).command;
    }
    assert_eq!((felt.jaw_force_n, felt.torque_n_m), (0.0, DVec3::ZERO));
}
