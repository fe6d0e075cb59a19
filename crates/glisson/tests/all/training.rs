//! Metrics, gestures and moments of sessions whose numbers are known: constructed ones, and one of a world.

use glisson::math::DVec3;
use glisson::scene::{Scene, build_world};
use glisson::tool::ToolInput;
use glisson::training::gestures::{GestureKind, gestures};
use glisson::training::metrics::{METRICS, Measured, measure};
use glisson::training::moments::{Fault, moments};
use glisson::training::trace::{ToolTrace, Trace, TraceRecorder};
use glisson::workers::Sequential;
use std::f64::consts::PI;
use std::path::Path;

/// 100 samples a second.
const PERIOD_S: f64 = 0.01;

/// An instrument that goes nowhere and touches nothing for `n` samples.
fn resting(name: &str, n: usize) -> ToolTrace {
    ToolTrace {
        name: name.into(),
        kind: "grasper",
        is_endoscope: false,
        is_seen: Vec::new(),
        poses: vec![ToolInput::at(DVec3::new(0.0, -0.1, 0.0), DVec3::NEG_Y); n],
        mean_force_n: vec![0.0; n],
        peak_force_n: vec![0.0; n],
        touches: vec![false; n],
        n_held_nodes: vec![0; n],
        touched_at_rest_m: vec![None; n],
    }
}

fn quiet(n: usize) -> Trace {
    Trace {
        period_s: PERIOD_S,
        tools: vec![resting("left", n), resting("right", n)],
        blood_lost_m3: vec![0.0; n],
        bleeding_m3_per_s: vec![0.0; n],
        removed_m3: vec![0.0; n],
        cut_area_m2: vec![0.0; n],
        surface_strain: vec![0.0; n],
        overstrained_m2: vec![0.0; n],
        n_clashing: vec![0; n],
        is_edited: vec![false; n],
    }
}

fn value(trace: &Trace, name: &str, tool: Option<usize>) -> Option<f64> {
    assert!(METRICS.iter().any(|metric| metric.name == name), "no metric {name}");
    let values = measure(&Measured::new(trace, 1.75));
    values.into_iter().find(|v| v.metric.name == name && v.tool == tool).map(|v| v.value)
}

/// 5 s: the left hand goes 40 mm along its shaft in the second second and presses with 2 N for half a second; the right hand goes a
/// quarter of a circle of 100 mm around a pivot in the third, and its jaws hold tissue from then on until it slips.
fn worked() -> Trace {
    let n = 501;
    let mut trace = quiet(n);
    let [left, right] = &mut trace.tools[..] else { unreachable!() };
    for at in 0..n {
        let done = ((at as f64 - 100.0) / 100.0).clamp(0.0, 1.0);
        left.poses[at].tip_in_world_m.y = -0.1 + 0.04 * done;
        let angle = PI / 2.0 * ((at as f64 - 200.0) / 100.0).clamp(0.0, 1.0);
        let out = DVec3::new(angle.sin(), -angle.cos(), 0.0);
        right.poses[at] = ToolInput { jaw_opening: 0.1, ..ToolInput::at(out * 0.1, -out) };
        if (210..260).contains(&at) {
            (left.touches[at], left.mean_force_n[at], left.peak_force_n[at]) = (true, 1.0, 2.0);
        }
        if (300..400).contains(&at) {
            (right.n_held_nodes[at], right.touches[at]) = (6, true);
            right.mean_force_n[at] = 0.5;
            right.peak_force_n[at] = 0.5;
        }
        trace.blood_lost_m3[at] = 1e-8 * (at as f64 - 450.0).max(0.0);
        trace.bleeding_m3_per_s[at] = if at >= 450 { 1e-6 } else { 0.0 };
        trace.removed_m3[at] = if at >= 480 { 2e-6 } else { 0.0 };
        trace.cut_area_m2[at] = if at >= 480 { 3e-4 } else { 0.0 };
        (trace.surface_strain[at], trace.overstrained_m2[at]) =
            if at == 405 { (0.6, 2e-4) } else { (0.1, 0.0) };
        trace.n_clashing[at] = u32::from((420..440).contains(&at));
    }
    trace
}

#[test]
fn metrics_of_a_constructed_session_are_those_computed_by_hand() {
    let trace = worked();
    let arc_m = 100.0 * 0.2 * (PI / 400.0).sin();
    let (left, right) = (Some(0), Some(1));
    for (name, tool, expected) in [
        ("time", None, 5.0),
        ("path_length", left, 0.04),
        ("path_length", right, arc_m),
        ("depth_path", left, 0.04),
        ("depth_path", right, 0.0),
        ("angular_path", left, 0.0),
        ("angular_path", right, PI / 2.0),
        ("movements", left, 1.0),
        ("movements", right, 1.0),
        ("economy", left, 1.0),
        // The last hundredth of the quarter ends with a touch.
        ("economy", right, (99.0 * PI / 400.0).sin() / (99.0 * (PI / 400.0).sin())),
        // Of 500 intervals 100 move, and 50 more end with a touch; of the right hand 99 more, because one moves, too.
        ("idle_time", left, 3.5),
        ("idle_time", right, 3.01),
        ("hand_balance", None, 0.04 / arc_m),
        ("mean_force", left, 1.0),
        ("mean_force", right, 0.5),
        ("peak_force", left, 2.0),
        ("time_over_threshold", left, 0.5),
        ("time_over_threshold", right, 0.0),
        ("slips", left, 0.0),
        ("slips", right, 1.0),
        ("grasps", right, 1.0),
        ("clash_time", None, 0.2),
        ("surface_strain", None, 0.6),
        ("overstrained_area", None, 2e-4),
        ("blood_lost", None, 5e-7),
        ("volume_removed", None, 2e-6),
        ("cut_area", None, 3e-4),
    ] {
        let found = value(&trace, name, tool).unwrap_or(f64::NAN);
        assert!((found - expected).abs() <= 1e-9 * expected.abs().max(1e-3), "{name} {tool:?}: {found}");
    }
    // A constant speed: the spectrum of a rectangle, and hardly any jerk.
    assert!(value(&trace, "smoothness_sparc", left).unwrap() < -1.0);
    assert_eq!(value(&trace, "smoothness_ldlj", left).map(f64::is_finite), Some(true));
}

#[test]
fn a_session_without_motion_has_no_smoothness_and_no_faults() {
    let trace = quiet(300);
    for name in ["smoothness_sparc", "smoothness_ldlj", "economy", "hand_balance"] {
        assert_eq!(value(&trace, name, Some(0)), None, "{name}");
    }
    assert_eq!(value(&trace, "mean_force", Some(0)), None);
    assert_eq!(value(&trace, "idle_time", Some(0)), Some(2.99));
    assert!(moments(&trace, 1.75).is_empty());
    assert!(measure(&Measured::new(&quiet(0), 1.75)).iter().all(|v| v.value.is_finite()));
    assert!(measure(&Measured::new(&quiet(1), 1.75)).iter().all(|v| v.value.is_finite()));
}

#[test]
fn amplitude_and_duration_change_what_they_should() {
    let (trace, mut larger, mut slower) = (worked(), worked(), worked());
    for tool in &mut larger.tools {
        tool.poses.iter_mut().for_each(|pose| pose.tip_in_world_m *= 2.0);
    }
    slower.period_s *= 2.0;
    for tool in [Some(0), Some(1)] {
        let of = |trace: &Trace, name: &str| value(trace, name, tool).unwrap();
        for (name, by) in [("path_length", 2.0), ("depth_path", 2.0), ("angular_path", 1.0), ("economy", 1.0)]
        {
            assert!((of(&larger, name) - by * of(&trace, name)).abs() < 1e-12, "{name}");
            assert!((of(&slower, name) - of(&trace, name)).abs() < 1e-12, "{name}");
        }
        for name in ["smoothness_sparc", "smoothness_ldlj"] {
            assert!((of(&larger, name) - of(&trace, name)).abs() < 1e-9, "{name}");
        }
        let ldlj = "smoothness_ldlj";
        assert!((of(&slower, ldlj) - of(&trace, ldlj)).abs() < 1e-9);
    }
}

#[test]
fn each_fault_is_found_once_where_it_is() {
    let found = moments(&worked(), 1.75);
    let seen: Vec<_> = found.iter().map(|m| (m.fault, m.tool, m.from_s, m.to_s)).collect();
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
    let expected = [
        (Fault::ForceAboveThreshold, Some(0), 2.1, 2.6),
        (Fault::Slip, Some(1), 4.0, 4.01),
        (Fault::Clash, None, 4.2, 4.4),
        (Fault::Bleeding, None, 4.5, 4.51),
    ];
    assert_eq!(seen.len(), expected.len(), "{found:?}");
    for (seen, expected) in seen.iter().zip(expected) {
        assert_eq!((seen.0, seen.1), (expected.0, expected.1));
        assert!(near(seen.2, expected.2) && near(seen.3, expected.3), "{seen:?}");
    }
    assert!(found[0].detail.contains("left: up to 2.00 N, threshold 1.75 N"), "{}", found[0].detail);
    // With a higher threshold the force is none, and jaws that open let go.
    assert_eq!(moments(&worked(), 2.5).len(), 3);
    let mut released = worked();
    released.tools[1].poses[400..].iter_mut().for_each(|pose| pose.jaw_opening = 0.5);
    assert!(moments(&released, 2.5).iter().all(|m| m.fault != Fault::Slip));
    // So do jaws that open slowly; and what an edit takes away has not slipped.
    let mut slowly = worked();
    for at in 350..501 {
        slowly.tools[1].poses[at].jaw_opening = 0.1 + 5e-4 * (at as f64 - 350.0);
    }
    assert!(moments(&slowly, 2.5).iter().all(|m| m.fault != Fault::Slip));
    let mut cut_away = worked();
    cut_away.is_edited[400] = true;
    assert!(moments(&cut_away, 2.5).iter().all(|m| m.fault != Fault::Slip));
}

#[test]
fn gestures_follow_each_other_without_gaps() {
    let mut trace = worked();
    // The held tissue is drawn away in its last 60 samples, and something twitches for a moment.
    for at in 340..501 {
        trace.tools[1].poses[at].tip_in_world_m.z += 1e-3 * (at as f64 - 340.0).min(60.0);
    }
    trace.tools[0].touches[50] = true;
    let of = |tool: usize| {
        let found = gestures(&trace, &trace.tools[tool]);
        assert!(found.windows(2).all(|pair| pair[0].to == pair[1].from && pair[0].kind != pair[1].kind));
        assert_eq!((found[0].from, found.last().map(|g| g.to)), (0, Some(501)));
        found.into_iter().map(|gesture| (gesture.kind, gesture.from)).collect::<Vec<_>>()
    };
    use GestureKind::{Grasp, Move, Pull, Push, Rest};
    assert_eq!(of(0), [(Rest, 0), (Move, 101), (Push, 210), (Rest, 260)]);
    // The last bit of its way, after it has slipped, is too short for a gesture.
    assert_eq!(of(1), [(Rest, 0), (Move, 201), (Grasp, 300), (Pull, 346), (Rest, 401)]);
}

const PRESSED: &str = r#"
glisson_scene = 1
[simulation]
time_step = "2 ms"
[organ]
box = { min = ["-5 cm", "0 cm", "-5 cm"], max = ["5 cm", "4 cm", "5 cm"] }
edge = "12 mm"
tissue = "liver"
model = "precomputed"
[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.2 }
[tool]
name = "probe"
tip_radius = "5 mm"
home_tip = ["0 mm", "-30 mm", "0 mm"]
home_shaft = [0, -1, 0]
[[tool.path]]
time = "0.5 s"
tip = ["0 mm", "1 mm", "0 mm"]
[[tool.path]]
time = "1 s"
tip = ["0 mm", "-20 mm", "0 mm"]
"#;

#[test]
fn the_trace_of_a_world_is_what_its_steps_report() {
    let scene = Scene::parse(PRESSED).unwrap();
    let (mut world, _) = build_world(&scene, Path::new(""), std::sync::Arc::new(Sequential)).unwrap();
    let mut recorder = TraceRecorder::new(&world);
    let (mut peak_n, mut samples) = (0.0_f64, 0);
    for step in 1..=500 {
        let report = world.step(&scene.input_at(step as f64 * 2e-3));
        peak_n = peak_n.max(report.tools[0].force_on_tool_n.length());
        samples += usize::from(recorder.after_step(&world));
    }
    let trace = recorder.trace();
    assert_eq!((samples, trace.n_samples(), trace.period_s), (100, 101, 0.01));
    assert!(peak_n > 0.05, "{peak_n}");
    assert_eq!(value(trace, "peak_force", Some(0)), Some(peak_n));
    assert!((value(trace, "time", None).unwrap() - 1.0).abs() < 1e-12);
    // Down and up again, along the shaft; the hand gives way by less than a millimetre.
    let way_m = value(trace, "path_length", Some(0)).unwrap();
    assert!((way_m - 0.052).abs() < 2e-3, "{way_m}");
    assert!((value(trace, "depth_path", Some(0)).unwrap() - way_m).abs() < 1e-3);
    let touched: Vec<DVec3> = trace.tools[0].touched_at_rest_m.iter().copied().flatten().collect();
    assert!(!touched.is_empty() && touched.iter().all(|p| p.length() < 8e-3), "{touched:?}");
    assert_eq!(trace.tools[0].touched_at_rest_m.last(), Some(&None));
}
