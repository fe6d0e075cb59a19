//! The haptic loop and its meters.

use super::*;
use glisson::haptics::{DeviceLimits, HapticDevice, Touch};
use glisson::math::{DMat3, DVec3};
use std::sync::Mutex;

/// Moves 10 um a tick along x; notes what it is told; faults at some ticks.
struct Scripted {
    n_reads: u64,
    faults: fn(u64) -> Option<DeviceFault>,
    forces: Arc<Mutex<Vec<DVec3>>>,
}

impl HapticDevice for Scripted {
    fn limits(&self) -> DeviceLimits {
        DeviceLimits {
            force_n: 10.0,
            torque_n_m: 0.0,
            force_rate_n_per_s: 1e9,
            stiffness_n_per_m: 1e4,
            damping_n_s_per_m: 10.0,
            resolution_m: 1e-6,
            rate_hz: 1_000.0,
            ..DeviceLimits::NONE
        }
    }

    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        self.n_reads += 1;
        if let Some(fault) = (self.faults)(self.n_reads) {
            return Err(fault);
        }
        let not_finite = if self.n_reads == 7 { f64::NAN } else { 0.0 };
        Ok(DeviceState {
            position_m: DVec3::new(1e-5 * self.n_reads as f64, not_finite, 0.0),
            velocity_m_per_s: DVec3::X * 1e-2,
            orientation: None,
            jaw_opening: 0.0,
            buttons: 0,
        })
    }

    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        // A test's lock, with room made before.
        let mut forces = self.forces.lock().unwrap();
        if forces.len() < forces.capacity() {
            forces.push(command.force_n);
        }
        Ok(())
    }
}

/// Turned and rolled.
fn scripted_home() -> ToolInput {
    ToolInput { roll_rad: 0.4, ..ToolInput::at(DVec3::Y, DVec3::new(0.6, 0.0, 0.8)) }
}

/// Whether the instrument is turned as at its home.
fn is_turned_as_home(pose: &ToolInput) -> bool {
    let home = scripted_home();
    pose.shaft_in_world.abs_diff_eq(home.shaft_in_world, 1e-12)
        && (pose.roll_rad - home.roll_rad).abs() < 1e-12
}

fn scripted(faults: fn(u64) -> Option<DeviceFault>) -> (HeldTool, ToolLink, Arc<Mutex<Vec<DVec3>>>) {
    let forces = Arc::new(Mutex::new(Vec::with_capacity(100_000)));
    let device = Scripted { n_reads: 0, faults, forces: Arc::clone(&forces) };
    let home = scripted_home();
    let device = OpenDevice {
        device: Box::new(device),
        name: "scripted".into(),
        world_from_device: glam::DQuat::IDENTITY,
        has_clutch: false,
        stands: None,
        page: None,
    };
    let (held, link) = join(device, 0, home);
    (held, link, forces)
}

#[test]
fn late_ticks_serve_and_miss_as_many_deadlines_as_passed() {
    let of = |late: u64| served_and_missed(late, 100);
    assert_eq!([0, 99, 100, 200].map(of), [(1, 0), (1, 0), (2, 0), (3, 0)]);
    // 250 late: the deadlines before it are 250, 150 and 50 late.
    assert_eq!([201, 250, 300, 301, 3_000].map(of), [(3, 1), (3, 1), (4, 1), (4, 2), (31, 28)]);
}

#[test]
fn motion_goes_to_the_simulation_and_the_force_of_its_model_to_the_device() {
    let (mut held, mut link, forces) = scripted(|n| (n == 7).then(|| DeviceFault::Lost("away".into())));
    held.tick(1e-3, None);
    let motion = link.motions.get();
    assert!(motion.is_held && motion.pose.tip_in_world_m == DVec3::Y, "{motion:?}");
    // The device does not tell where it points.
    assert!(is_turned_as_home(&motion.pose), "{motion:?}");
    let model = HapticModel {
        touch: Touch::Grasp,
        tip_m: DVec3::Y,
        stiffness_n_per_m: DMat3::from_diagonal(DVec3::splat(300.0)),
        hold_n: f64::INFINITY,
        ..HapticModel::default()
    };
    for _ in 0..300 {
        link.models.publish(PublishedModel { model, made_ns: now_ns() });
        held.tick(1e-3, None);
    }
    let motion = link.motions.get();
    assert!(motion.is_held && motion.pose.tip_in_world_m.x > 1e-3, "{motion:?}");
    assert!(is_turned_as_home(&motion.pose), "{motion:?}");
    let forces = forces.lock().unwrap();
    // Held at its first place, it pulls back.
    assert!(forces[0] == DVec3::ZERO && forces[forces.len() - 1].x < -0.1, "{:?}", forces.last());
    assert_eq!(link.statuses.get_new(), Some(DeviceStatus::Works));
}

#[test]
fn a_lost_device_leaves_its_tool_and_one_that_failed_is_left_alone() {
    let (mut held, mut link, forces) = scripted(|n| match n {
        3..5 => Some(DeviceFault::Lost("unplugged".into())),
        10 => Some(DeviceFault::Failed("broken".into())),
        _ => None,
    });
    let mut seen = Vec::new();
    for _ in 0..14 {
        held.tick(1e-3, None);
        seen.extend(link.statuses.get_new());
        let pose = link.motions.get().pose;
        assert!(pose.is_finite() && is_turned_as_home(&pose), "{pose:?}");
    }
    let lost = |text: &'static str| DeviceStatus::Lost(text.into());
    let expected = [
        DeviceStatus::Works,
        lost("unplugged"),
        DeviceStatus::Works,
        lost("it sends numbers that are not finite"),
        DeviceStatus::Works,
        DeviceStatus::Failed("broken".into()),
    ];
    assert_eq!(seen, expected);
    assert!(!link.motions.get().is_held);
    // Also while it was lost it was told what to do; after the end it was left alone.
    assert_eq!(forces.lock().unwrap().len(), 10);
}

#[test]
fn ticks_allocate_nothing_also_while_a_device_is_lost() {
    let (mut held, mut link, _forces) =
        scripted(|n| (n >= 50).then(|| DeviceFault::Lost("unplugged".into())));
    let meters = Meters::default();
    let counted = allocation_counter::measure(|| {
        for _ in 0..100 {
            link.models.publish(PublishedModel::default());
            held.tick(1e-3, Some(&meters));
        }
    });
    assert_eq!(counted.count_total, 0);
    // Of 49 answers the seventh is no number.
    assert_eq!(meters.report().motion_to_force.n, 48);
}

/// As fast as a loop may be, and half as fast.
#[test]
fn the_loop_keeps_its_rate_measures_itself_and_lets_the_hand_go_slowly() {
    for rate_hz in [2_000.0, *RATES_HZ.end()] {
        let (held, mut link, forces) = scripted(|_| None);
        let settings = HapticSettings { rate_hz, ..HapticSettings::default() };
        let haptics = HapticLoop::start(vec![held], settings, Arc::default()).unwrap();
        let push = HapticModel {
            touch: Touch::Grasp,
            tip_m: DVec3::Y,
            force_n: DVec3::Y,
            hold_n: f64::INFINITY,
            ..HapticModel::default()
        };
        // A busy machine leaves ticks out, and ramps take their number of ticks.
        for round in 0..1_000 {
            link.models.publish(PublishedModel { model: push, made_ns: now_ns() });
            std::thread::sleep(std::time::Duration::from_millis(10));
            if round >= 40 && forces.lock().unwrap().last().is_some_and(|force| force.y > 0.5) {
                break;
            }
        }
        let report = haptics.meters().report();
        let n_before = forces.lock().unwrap().len();
        drop(haptics);
        assert!(report.rate_hz > 200.0 && report.rate_hz < 1.05 * rate_hz, "{report:?}");
        assert!(
            report.n_deadlines > 100 && report.jitter.n > 100 && report.scheduling.is_some(),
            "{report:?}"
        );
        let json = report.to_json();
        assert!((json["period_us"].as_f64().unwrap() - 1e6 / rate_hz).abs() < 1e-9, "{json}");
        for field in ["jitter_us", "motion_to_force_us", "local_model_age_ms", "tick_us"] {
            assert!(json[field]["p999"].as_f64().unwrap() >= json[field]["p50"].as_f64().unwrap(), "{json}");
        }
        let text = report.to_text();
        let budget = format!("% of {:.0} us", 1e6 / rate_hz);
        for part in [budget.as_str(), "deadlines missed", "below ", "from the local model", "never got"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let forces = forces.lock().unwrap();
        assert!(forces.len() < forces.capacity(), "the test's list is too short");
        assert!(n_before < forces.len() && forces[n_before - 1].y > 0.5, "{:?}", forces[n_before - 1]);
        assert_eq!(*forces.last().unwrap(), DVec3::ZERO);
        let changes = forces.windows(2).map(|pair| pair[0].distance(pair[1]));
        let greatest_n = changes.fold(0.0, f64::max);
        // Far below the 0.5 N and more that were there; tests without a clock are stricter.
        assert!(greatest_n < 0.25, "{greatest_n}");
    }
}

#[test]
fn the_histogram_in_the_report_adds_up() {
    let meters = Meters::default();
    for (ns, n) in [(20, 50), (700, 30), (1_500, 15), (90_000, 5)] {
        (0..n).for_each(|_| meters.jitter.record(ns));
    }
    let text = meters.report().jitter_text();
    assert_eq!(text, "below 1.0 us 80.000 %, 2.0 us 15.000 %, 131 us 5.000 %");
    assert_eq!(Meters::default().report().jitter_text(), "nothing counted yet");
}

#[test]
fn choices_reach_the_law() {
    let forces = ForceChoices {
        estimate: glisson::haptics::ForceEstimate::Hold,
        control: glisson::haptics::EnergyControl::ObserveOnly,
        ..ForceChoices::default()
    };
    let (mut held, mut link, told) = scripted(|_| None);
    held.settings = HapticSettings { forces, ..HapticSettings::default() };
    // A force that is not where its stiffness would have it: held, it stays; from the local model it grows.
    let model = HapticModel {
        touch: Touch::Grasp,
        tip_m: DVec3::Y,
        force_n: DVec3::X * 0.5,
        stiffness_n_per_m: DMat3::from_diagonal(DVec3::splat(300.0)),
        hold_n: f64::INFINITY,
        ..HapticModel::default()
    };
    for _ in 0..800 {
        link.models.publish(PublishedModel { model, made_ns: now_ns() });
        held.tick(1e-3, None);
    }
    let last_n = *told.lock().unwrap().last().unwrap();
    assert!(last_n.distance(DVec3::X * 0.5) < 1e-9, "{last_n}");
    let limits = held.device.device.limits();
    let law = held.law.as_ref().unwrap();
    assert!((law.gains().stiffness_n_per_m - 0.6 * limits.stiffness_n_per_m).abs() < 1e-9);
}

#[test]
fn a_rate_that_no_loop_keeps_is_refused() {
    for rate_hz in [0.0, 50.0, 5_000.0, f64::NAN] {
        let settings = HapticSettings { rate_hz, ..HapticSettings::default() };
        let error = HapticLoop::start(Vec::new(), settings, Arc::default()).err().unwrap();
        assert!(error.to_string().contains("allowed: 100 to 4000 Hz"), "{error}");
    }
}
