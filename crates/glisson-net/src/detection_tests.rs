//! Detection between two ends of a link: what is felt while a simulation stalls, surfaces that change, who joins late.

use super::bridge::HapticsScene;
use super::link::{Link, Role};
use super::tests::{HapticsEnd, SimulationEnd, bad_links, identity, soon};
use glisson::haptics::{HapticModel, Touch};
use glisson::math::DVec3;
use glisson::mesh::{NodeId, TetMesh};
use glisson::tool::{Tool, ToolInput};
use glisson::world::detection::SurfaceList;
use glisson_runtime::elsewhere::Nearby;
use glisson_runtime::haptic_loop::{Meters, PublishedModel};
use glisson_runtime::realtime::now_ns;
use std::sync::Arc;
use std::time::Duration;

const RADIUS_M: f64 = 5e-3;
const STIFFNESS_N_PER_M: f64 = 100.0;

fn home() -> ToolInput {
    ToolInput::at(DVec3::new(0.01, 0.01, 0.1), DVec3::Z)
}

/// A tetrahedron whose top is at 40 mm above (10 mm, 10 mm).
fn body() -> TetMesh {
    let positions_m = vec![DVec3::ZERO, DVec3::X * 0.06, DVec3::Y * 0.06, DVec3::Z * 0.06];
    TetMesh {
        positions_m,
        tetrahedra: vec![[NodeId(0), NodeId(1), NodeId(2), NodeId(3)]],
        ..TetMesh::default()
    }
}

fn scene() -> HapticsScene {
    HapticsScene {
        tools: vec![Tool::probe("hand", RADIUS_M, home())],
        surface: Some(SurfaceList::of_mesh(&body()).unwrap()),
        stiffness_n_per_m: vec![STIFFNESS_N_PER_M],
        meters: None,
    }
}

fn haptics(link: Link) -> HapticsEnd {
    HapticsEnd::with(link, identity(Role::Haptics, 1), scene())
}

/// A simulation that has this surface and takes another step.
fn publish(simulation: &mut SimulationEnd, step: u64, whole: &Arc<SurfaceList>, touch: Touch) {
    simulation.tool.nearby.as_mut().unwrap().publish(Nearby::of(whole));
    let model = HapticModel { step, touch, ..HapticModel::default() };
    simulation.tool.models.publish(PublishedModel { model, made_ns: now_ns() });
}

fn height_m(step: u32) -> f64 {
    // 5 mm a millisecond, as far as 20 mm.
    (0.1 - 5e-3 * f64::from(step)).max(0.02)
}

fn at_height(z_m: f64) -> ToolInput {
    ToolInput { tip_in_world_m: DVec3::new(0.01, 0.01, z_m), ..home() }
}

#[test]
fn a_tip_at_5_m_per_s_is_felt_at_once_while_the_simulation_stalls() {
    let (at_haptics, at_simulation) = bad_links();
    let mut haptics = haptics(at_haptics);
    let mut simulation = SimulationEnd::start(at_simulation, identity(Role::Simulation, 1));
    let whole = Arc::new(SurfaceList::of_mesh(&body()).unwrap());
    publish(&mut simulation, 1, &whole, Touch::Free);
    soon("the first model and a look", || {
        haptics.hold(at_height(0.1));
        haptics.models.get().model.step == 1 && simulation.tool.motions.get().detected.is_some()
    });
    // From here on the simulation says nothing.
    let n_ticks = 17;
    for tick in 0..n_ticks {
        haptics.hold(at_height(height_m(tick)));
        std::thread::sleep(Duration::from_millis(1));
    }
    let tip_m = at_height(height_m(n_ticks)).tip_in_world_m;
    haptics.hold(at_height(height_m(n_ticks)));
    let plane = DVec3::ONE.normalize();
    soon("a force without the simulation", || haptics.models.get().model.force_at(tip_m, 0.0) != DVec3::ZERO);
    let felt = haptics.models.get().model;
    // The plane x + y + z = 60 mm, as deep as the ball is in it; the stiffness is the scene's.
    let depth_m = (0.06 / 3.0_f64.sqrt() + RADIUS_M) - tip_m.dot(plane);
    let expected_n = plane * (STIFFNESS_N_PER_M * depth_m);
    let found_n = felt.force_at(tip_m, 0.0);
    assert!(found_n.distance(expected_n) < 1e-3 * expected_n.length(), "{found_n} for {expected_n}");
    // It began where the ball touched: nothing jumped.
    assert!(felt.force_at(felt.tip_m, 0.0).length() < 1e-3, "{felt:?}");
    soon("the touch at the simulation", || {
        simulation.tool.motions.get().detected.is_some_and(|detected| !detected.is_free())
    });
    let detected = simulation.tool.motions.get().detected.unwrap();
    assert!(detected.surface_version == 1 && detected.touches[0].unwrap().normal.distance(plane) < 1e-6);

    // The simulation goes on, takes it, and lets go later: then nothing is left of it.
    publish(&mut simulation, 2, &whole, Touch::Contact);
    soon("the simulation's own", || haptics.models.get().model.touch == Touch::Contact);
    publish(&mut simulation, 3, &whole, Touch::Free);
    soon("the end", || {
        haptics.hold(at_height(height_m(n_ticks)));
        let felt = haptics.models.get().model;
        felt.step == 3 && felt.force_at(tip_m, 0.0) == DVec3::ZERO
    });
    soon("its end at the simulation", || {
        haptics.hold(at_height(height_m(n_ticks)));
        simulation.tool.motions.get().detected.is_some_and(|d| d.is_free())
    });
    let report = haptics.detection.report();
    assert!(
        report.n_felt_first == 1 && report.n_looks > 3 && report.greatest_force_alone_n > 1.0,
        "{report:?}"
    );
}

#[test]
fn a_touch_that_the_simulation_refuses_is_felt_no_longer() {
    let (at_haptics, at_simulation) = bad_links();
    let mut haptics = haptics(at_haptics);
    let mut simulation = SimulationEnd::start(at_simulation, identity(Role::Simulation, 1));
    let whole = Arc::new(SurfaceList::of_mesh(&body()).unwrap());
    haptics.hold(at_height(0.1));
    publish(&mut simulation, 1, &whole, Touch::Free);
    soon("the first model", || haptics.models.get().model.step == 1);
    let tip_m = at_height(0.04).tip_in_world_m;
    soon("a look", || {
        haptics.hold(at_height(0.07));
        simulation.tool.motions.get().detected.is_some()
    });
    haptics.hold(at_height(0.04));
    soon("the touch", || haptics.models.get().model.force_at(tip_m, 0.0) != DVec3::ZERO);
    let mut step = 1;
    soon("its end", || {
        step += 1;
        publish(&mut simulation, step, &whole, Touch::Free);
        haptics.models.get().model.force_at(tip_m, 0.0) == DVec3::ZERO
    });
}

#[test]
fn after_a_cut_and_for_a_late_joiner_detection_goes_on_over_the_new_surface() {
    let (at_haptics, at_simulation) = bad_links();
    let mut haptics = haptics(at_haptics);
    let mut simulation = SimulationEnd::start(at_simulation, identity(Role::Simulation, 1));
    // Much larger than what fits into a message, 20 mm higher, and as it would be after many cuts.
    let n = 2_000;
    let mut cut = SurfaceList { version: 17, ..SurfaceList::default() };
    for i in 0..n {
        let x_m = 1e-4 * f64::from(i) - 0.05;
        cut.nodes.push((NodeId(2 * i), DVec3::new(x_m, -0.1, 0.08)));
        cut.nodes.push((NodeId(2 * i + 1), DVec3::new(x_m, 0.1, 0.08)));
        if i > 0 {
            let [a, b, c, d] = [2 * i - 2, 2 * i - 1, 2 * i, 2 * i + 1].map(NodeId);
            let number = cut.triangles.len() as u32;
            cut.triangles.push((glisson::mesh::TriangleId(number), [a, c, b]));
            cut.triangles.push((glisson::mesh::TriangleId(number + 1), [c, d, b]));
        }
    }
    let (whole, cut) = (Arc::new(SurfaceList::of_mesh(&body()).unwrap()), Arc::new(cut));
    publish(&mut simulation, 1, &whole, Touch::Free);
    let version =
        |simulation: &mut SimulationEnd| simulation.tool.motions.get().detected.map(|d| d.surface_version);
    soon("detection on the first surface", || {
        haptics.hold(at_height(0.1));
        version(&mut simulation) == Some(1)
    });
    publish(&mut simulation, 2, &cut, Touch::Free);
    soon("no detection on another surface than the simulation's", || {
        haptics.hold(at_height(0.1));
        version(&mut simulation) != Some(1)
    });
    let finds = |haptics: &mut HapticsEnd, simulation: &mut SimulationEnd| {
        soon("detection on the new surface", || {
            haptics.hold(at_height(0.1));
            version(simulation) == Some(17)
        });
        haptics.hold(at_height(0.083));
        soon("a touch of the new surface", || {
            let detected = simulation.tool.motions.get().detected;
            detected
                .and_then(|detected| detected.touches[0])
                .is_some_and(|touch| touch.normal.distance(DVec3::Z) < 1e-6)
        });
    };
    finds(&mut haptics, &mut simulation);
    drop((haptics, simulation));

    let (at_haptics, at_simulation) = bad_links();
    let mut simulation = SimulationEnd::start(at_simulation, identity(Role::Simulation, 1));
    publish(&mut simulation, 3, &cut, Touch::Free);
    let mut late = self::haptics(at_haptics);
    finds(&mut late, &mut simulation);
    assert_eq!(late.detection.report().n_surfaces, 1);
}

#[test]
fn the_haptic_loops_figures_reach_the_simulation_and_go_with_the_link() {
    let (at_haptics, at_simulation) = bad_links();
    let meters = Arc::new(Meters::default());
    let scene = HapticsScene { meters: Some(Arc::clone(&meters)), ..scene() };
    let haptics = HapticsEnd::with(at_haptics, identity(Role::Haptics, 1), scene);
    let simulation = SimulationEnd::start(at_simulation, identity(Role::Simulation, 1));
    soon("the figures", || simulation.figures.report().is_some());
    let (found, own) = (simulation.figures.report().unwrap(), meters.report());
    assert_eq!((found.settings.rate_hz, found.n_deadlines), (own.settings.rate_hz, own.n_deadlines));
    assert!(found.to_json()["jitter_us"]["p99"].is_number(), "{}", found.to_json());
    drop(haptics);
    soon("no figures of a machine that is away", || simulation.figures.report().is_none());
}
