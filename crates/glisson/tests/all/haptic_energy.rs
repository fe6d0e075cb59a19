//! The energy tank and the haptic law against hands and simulations that do whatever draws most.

use glam::DQuat;
use glisson::haptics::passivity::{EnergyControl, EnergyTank, TankSettings};
use glisson::haptics::{
    DeviceLimits, DeviceState, ForceCommand, ForceEstimate, HandPath, HandSettings, HapticDevice, HapticLaw,
    HapticModel, LawSettings, SimulatedDevice, SimulatedDeviceSettings, Touch,
};
use glisson::math::{DMat3, DVec3, SeededRandom, outer};
use proptest::prelude::*;

const TICK_S: f64 = 1e-3;

const LIMITS: DeviceLimits = DeviceLimits {
    force_n: 3.3,
    torque_n_m: 0.0,
    force_rate_n_per_s: 2000.0,
    stiffness_n_per_m: 1200.0,
    damping_n_s_per_m: 0.6,
    resolution_m: 5.5e-5,
    rate_hz: 1000.0,
    ..DeviceLimits::NONE
};

fn any_vector(random: &mut SeededRandom, size: f64) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()) * size
}

/// A hand that goes where the force on it pushes it, as quickly as the tank reckons with, or back, or anywhere.
struct Adversary {
    random: SeededRandom,
    place_m: DVec3,
    step_m: DVec3,
    greed: f64,
    steadiness: f64,
    direction: DVec3,
}

impl Adversary {
    fn new(seed: u64, greed: f64, steadiness: f64) -> Self {
        let random = SeededRandom::new(seed);
        let zero = DVec3::ZERO;
        Self { random, place_m: zero, step_m: zero, greed, steadiness, direction: DVec3::X }
    }

    fn moves(&mut self, pushed_n: DVec3, change_m: f64) {
        if self.random.uniform() > self.steadiness {
            self.direction = any_vector(&mut self.random, 1.0).normalize_or_zero();
        }
        let greedy = self.random.uniform() < self.greed;
        let wanted = if greedy { pushed_n.normalize_or_zero() } else { self.direction };
        self.step_m += wanted * change_m;
        // No quicker than 1 m/s.
        self.step_m = self.step_m.clamp_length_max(1e-3);
        self.place_m += self.step_m;
    }

    fn told_m(&self, resolution_m: f64) -> DVec3 {
        if resolution_m > 0.0 { (self.place_m / resolution_m).round() * resolution_m } else { self.place_m }
    }
}

struct Bout {
    seed: u64,
    greed: f64,
    steadiness: f64,
    delay: usize,
    /// Ticks of it that the tank does not know of.
    untold: usize,
    rate_n_per_s: f64,
    resolution_m: f64,
    reserve_j: f64,
    control: EnergyControl,
}

/// Least energy [J] over the bound in 3000 ticks of any wanted forces, counted here.
fn margin_of(bout: &Bout) -> f64 {
    // Half of the delay the device tells, half is told of it.
    let limits = DeviceLimits {
        force_rate_n_per_s: bout.rate_n_per_s,
        resolution_m: bout.resolution_m,
        loop_delay_ticks: (bout.delay - bout.untold) / 2,
        ..LIMITS
    };
    let settings = TankSettings {
        reserve_j: bout.reserve_j,
        loop_delay_ticks: bout.delay - bout.untold - limits.loop_delay_ticks,
        ..TankSettings::default()
    };
    let mut tank = EnergyTank::new(&settings, &limits, bout.control);
    let mut hand = Adversary::new(bout.seed, bout.greed, bout.steadiness);
    let mut random = SeededRandom::new(!bout.seed);
    let mut commands = vec![DVec3::ZERO; bout.delay + 1];
    let mut energy_j = 0.0;
    let mut least_j = 0.0_f64;
    let mut wanted_n = DVec3::ZERO;
    let mut before_m = hand.told_m(limits.resolution_m);
    for tick in 0..3000 {
        if random.uniform() < 0.01 {
            wanted_n = any_vector(&mut random, 3.0);
        }
        // Half the time the simulation is with the hand, and pushes where it goes.
        let pushes_on = tick / 500 % 2 == 1;
        let force_n = if pushes_on { hand.step_m.normalize_or_zero() * 5.0 } else { wanted_n };
        let wanted = ForceCommand { force_n, ..ForceCommand::default() };
        let before_n = tank.previous().force_n;
        let (command, _) = tank.admit(&wanted, DVec3::ZERO, TICK_S);
        assert!(command.force_n.length() <= limits.force_n * (1.0 + 1e-12));
        assert!((command.force_n - before_n).length() <= limits.force_rate_n_per_s * TICK_S * (1.0 + 1e-9));
        commands.push(command.force_n);
        let acting_n = commands[commands.len() - 1 - bout.delay];
        hand.moves(acting_n, settings.acceleration_m_per_s2 * TICK_S * TICK_S);
        let now_m = hand.told_m(limits.resolution_m);
        energy_j -= acting_n.dot(now_m - before_m);
        tank.observe(now_m - before_m, DVec3::ZERO, 0.0, TICK_S);
        before_m = now_m;
        least_j = least_j.min(energy_j);
        assert!(bout.untold > 0 || (energy_j - tank.observed_j()).abs() < 1e-9, "tick {tick}");
    }
    least_j - tank.bound_j()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn no_hand_and_no_simulation_draw_more_than_the_reserve(
        seed in any::<u64>(),
        greed in 0.0..1.0_f64,
        steadiness in 0.5..1.0_f64,
        delay in 0_usize..12,
        rate_n_per_s in prop_oneof![20.0..5000.0_f64, Just(f64::INFINITY)],
        resolution_m in prop_oneof![Just(0.0), 1e-6..2e-4_f64],
        reserve_j in 1e-4..0.05_f64,
    ) {
        let control = EnergyControl::Tank;
        let untold = 0;
        let bout = Bout { seed, greed, steadiness, delay, untold, rate_n_per_s, resolution_m, reserve_j, control };
        let margin_j = margin_of(&bout);
        prop_assert!(margin_j >= -1e-9, "{margin_j}");
    }
}

#[test]
fn without_control_the_same_hand_draws_as_much_as_it_likes() {
    let bout = Bout {
        seed: 4,
        greed: 0.9,
        steadiness: 0.9,
        delay: 0,
        untold: 0,
        rate_n_per_s: 2000.0,
        resolution_m: 0.0,
        reserve_j: 0.01,
        control: EnergyControl::ObserveOnly,
    };
    assert!(margin_of(&bout) < -1.0);
    assert!(margin_of(&Bout { control: EnergyControl::Tank, ..bout }) >= 0.0);
}

/// A device behind a thread or a line, two ticks late: the bound holds when its limits say so.
#[test]
fn a_late_device_keeps_the_bound_when_its_delay_is_told() {
    let bout = |seed: u64, untold: usize| Bout {
        seed,
        greed: 0.9,
        steadiness: 0.9,
        delay: 2,
        untold,
        rate_n_per_s: 2000.0,
        resolution_m: 0.0,
        reserve_j: 0.01,
        control: EnergyControl::Tank,
    };
    let margins_j: Vec<[f64; 2]> =
        (0..8).map(|seed| [margin_of(&bout(seed, 0)), margin_of(&bout(seed, 2))]).collect();
    assert!(margins_j.iter().all(|[told_j, _]| *told_j >= -1e-9), "{margins_j:?}");
    assert!(margins_j.iter().any(|[_, untold_j]| *untold_j < -1e-5), "{margins_j:?}");
}

/// What a device says of its delay is in its own ticks; the law counts those of its loop.
#[test]
fn a_law_counts_a_devices_delay_in_ticks_of_its_loop() {
    for (told, rate_hz, loop_hz, counted) in
        [(2, 1000.0, 1000.0, 2), (2, 1000.0, 4000.0, 8), (2, 1000.0, 300.0, 1), (0, 1000.0, 2000.0, 0)]
    {
        let law = |loop_delay_ticks: usize, rate_hz: f64| {
            let limits = DeviceLimits { loop_delay_ticks, rate_hz, ..LIMITS };
            HapticLaw::new(&LawSettings { period_s: 1.0 / loop_hz, ..LawSettings::default() }, &limits)
        };
        // The same law as for a device of the loop's own rate, but for what it remembers of the limits.
        assert_eq!(law(told, rate_hz).loop_delay_ticks(), counted);
        assert_eq!(law(counted, loop_hz).loop_delay_ticks(), counted);
    }
}

/// Jaws pay for their way as the handle for its: whatever is wanted and however they move.
#[test]
fn the_jaws_force_pays_for_their_way() {
    let limits = DeviceLimits { jaw_force_n: 10.0, jaw_travel_m: 0.02, ..LIMITS };
    let mut tank = EnergyTank::new(&TankSettings::default(), &limits, EnergyControl::Tank);
    let mut random = SeededRandom::new(12);
    let (mut energy_j, mut step_m, mut before_n) = (0.0, 0.0_f64, 0.0_f64);
    for _ in 0..4000 {
        let wanted =
            ForceCommand { jaw_force_n: random.normal() * 5.0 + step_m * 1e5, ..ForceCommand::default() };
        let (command, _) = tank.admit(&wanted, DVec3::ZERO, TICK_S);
        let most_n = limits.force_rate_n_per_s * TICK_S * 10.0 / 3.3;
        assert!((command.jaw_force_n - before_n).abs() <= most_n * (1.0 + 1e-9));
        before_n = command.jaw_force_n;
        step_m = (step_m + command.jaw_force_n.signum() * 50.0 * TICK_S * TICK_S).clamp(-1e-3, 1e-3);
        energy_j -= command.jaw_force_n * step_m;
        tank.observe_with_jaws(DVec3::ZERO, DVec3::ZERO, step_m, 0.0, TICK_S);
        assert!((energy_j - tank.observed_j()).abs() < 1e-12);
        assert!(energy_j >= tank.bound_j() - 1e-12, "{energy_j}");
    }
    assert!(energy_j < 0.5 * tank.bound_j(), "the hand did draw: {energy_j}");
}

#[test]
fn torque_pays_for_turns_like_force_for_ways() {
    let limits = DeviceLimits { torque_n_m: 0.1, ..LIMITS };
    let mut tank = EnergyTank::new(&TankSettings::default(), &limits, EnergyControl::Tank);
    let mut random = SeededRandom::new(8);
    let (mut energy_j, mut turn) = (0.0, DVec3::ZERO);
    for _ in 0..3000 {
        let wanted = ForceCommand {
            torque_n_m: any_vector(&mut random, 0.1) + turn * 50.0,
            ..ForceCommand::default()
        };
        let (command, _) = tank.admit(&wanted, DVec3::ZERO, TICK_S);
        turn = (turn + command.torque_n_m.normalize_or_zero() * 5e-4).clamp_length_max(1e-2);
        energy_j -= command.torque_n_m.dot(turn);
        tank.observe(DVec3::ZERO, turn, 0.0, TICK_S);
        assert!(energy_j >= tank.bound_j() - 1e-12);
    }
    assert!(energy_j < 0.5 * tank.bound_j(), "the hand did draw: {energy_j}");
}

/// A hand that jerks away more quickly than the tank reckons with overdraws it; moving about fills it again.
#[test]
fn an_overdrawn_tank_comes_back() {
    let mut tank = EnergyTank::new(&TankSettings::default(), &LIMITS, EnergyControl::Tank);
    let mut place_m: f64 = 0.0;
    let mut tick = |tank: &mut EnergyTank, step_m: f64| {
        let force_n = DVec3::X * 3.3;
        let resisting_n = DVec3::X * (-0.2 * step_m / TICK_S);
        let wanted = ForceCommand { force_n: force_n + resisting_n, ..ForceCommand::default() };
        let (command, _) = tank.admit(&wanted, resisting_n, TICK_S);
        place_m += step_m;
        tank.observe(DVec3::X * step_m, DVec3::ZERO, 0.0, TICK_S);
        command.force_n.x
    };
    tick(&mut tank, 0.0);
    tick(&mut tank, 0.0);
    tick(&mut tank, 9e-3);
    assert!(tank.level_j() < 0.0);
    assert!(tank.observed_j() > tank.bound_j() - 0.03, "one tick at 9 m/s and 3.3 N");
    for _ in 0..3 {
        tick(&mut tank, 0.0);
    }
    assert!(tick(&mut tank, 0.0).abs() < 1e-12, "an overdrawn tank gives nothing");
    for i in 0..4000 {
        tick(&mut tank, 3e-4 * (f64::from(i) * 0.01).sin());
    }
    assert!(tank.level_j() > 0.0, "{}", tank.level_j());
}

/// What the law counts is what the actuator did, with delays that the law knows of.
#[test]
fn observed_energy_is_what_the_actuator_took() {
    for (position_latency_ticks, force_latency_ticks) in [(0, 0), (2, 3)] {
        let settings = SimulatedDeviceSettings {
            position_latency_ticks,
            force_latency_ticks,
            ..SimulatedDeviceSettings::ideal()
        };
        let path =
            HandPath::Swing { center_m: DVec3::ZERO, amplitude_m: DVec3::Z * -8e-3, frequency_hz: 1.5 };
        let mut device = SimulatedDevice::new(&settings, &HandSettings::default(), path, 2);
        assert_eq!(device.limits().loop_delay_ticks, position_latency_ticks + force_latency_ticks);
        let mut law = HapticLaw::new(&LawSettings::default(), &device.limits());
        let model = spring(300.0);
        let mut truth_j = Vec::new();
        for tick in 0..2000 {
            let state = device.read().unwrap();
            truth_j.push(device.port_energy_j());
            let out = law.tick(&state, &model, 0.0, TICK_S);
            // At this tick the law sees where the handle was some ticks ago.
            let seen = truth_j[truth_j.len() - 1 - position_latency_ticks.min(tick)];
            assert!((out.report.observed_energy_j - seen).abs() < 1e-12, "{tick}");
            device.write(&out.command).unwrap();
        }
        assert!(truth_j.iter().any(|j| *j > 1e-3));
    }
}

/// Tissue below the plane z = 0.
fn spring(stiffness_n_per_m: f64) -> HapticModel {
    HapticModel {
        step: 1,
        period_s: 0.03,
        touch: Touch::Free,
        stiffness_n_per_m: DMat3::IDENTITY * stiffness_n_per_m,
        normal: DVec3::Z,
        ..HapticModel::default()
    }
}

fn any_model(random: &mut SeededRandom, step: u64) -> HapticModel {
    let n = any_vector(random, 1.0).normalize_or(DVec3::Z);
    let size = random.uniform_in(0.0, 5000.0);
    let mut model = HapticModel {
        step,
        time_s: step as f64 * 0.03,
        period_s: 0.03,
        touch: [Touch::Free, Touch::Contact, Touch::Grasp][(random.next_u64() % 3) as usize],
        tip_m: any_vector(random, 5e-3),
        force_n: any_vector(random, 3.0),
        stiffness_n_per_m: outer(n, n) * size + DMat3::IDENTITY * random.uniform_in(0.0, 500.0),
        normal: n,
        gap_m: random.normal() * 5e-3,
        surface_velocity_m_per_s: any_vector(random, 0.1),
        friction_coefficient: random.uniform(),
        ..HapticModel::default()
    };
    match random.next_u64() % 20 {
        0 => model.force_n.x = f64::NAN,
        1 => model.stiffness_n_per_m.y_axis.z = f64::INFINITY,
        2 => model.force_n *= 1e9,
        _ => {}
    }
    model
}

/// A simulation that publishes anything at any time, buttons, and a hand that moves anyhow.
#[test]
fn a_simulation_gone_mad_stays_within_limits_and_bound() {
    for seed in 0..40 {
        let mut random = SeededRandom::new(seed);
        let estimate = ForceEstimate::ALL[seed as usize % ForceEstimate::ALL.len()];
        let mut law = HapticLaw::new(&LawSettings { estimate, ..LawSettings::default() }, &LIMITS);
        let mut hand = Adversary::new(seed, 0.7, 0.97);
        let mut model = HapticModel::default();
        let mut age_s = 0.0;
        for step in 0..2000 {
            let position_m = hand.told_m(LIMITS.resolution_m);
            let state = DeviceState {
                position_m,
                velocity_m_per_s: hand.step_m / TICK_S,
                orientation: Some(DQuat::IDENTITY),
                jaw_opening: 0.5,
                buttons: u32::from(step % 700 > 650) * 2,
            };
            age_s += TICK_S;
            if random.uniform() < 0.03 {
                (model, age_s) = (any_model(&mut random, step), 0.0);
            }
            let out = law.tick(&state, &model, age_s, TICK_S);
            assert!(out.command.force_n.length() <= LIMITS.force_n * (1.0 + 1e-12), "{seed} {step}");
            assert!(out.tool.is_finite());
            let least_j = law.energy_bound_j() - 1e-9;
            assert!(law.observed_energy_j() >= least_j, "{seed} {step} {}", law.observed_energy_j());
            hand.moves(out.command.force_n, 50.0 * TICK_S * TICK_S);
        }
    }
}
