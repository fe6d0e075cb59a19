//! A liver on its bed: at rest from the first step, and again after it was pushed.

use glisson::math::DVec3;
use glisson::scene::{Scene, build_world};
use glisson::workers::{Sequential, SharedWorkers};
use glisson::world::{StepInput, World};
use glisson_lab::bed::write_liver_on_bed;
use glisson_runtime::workers::WorkerTeam;
use std::path::Path;
use std::sync::Arc;

const N_TETS: usize = 6_300;

fn open(scene: &Path, workers: SharedWorkers) -> World {
    let text = std::fs::read_to_string(scene).unwrap();
    build_world(&Scene::parse(&text).unwrap(), scene.parent().unwrap(), workers).unwrap().0
}

fn furthest_m(world: &World, from_m: &[DVec3]) -> f64 {
    world.state().positions_m.iter().zip(from_m).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

#[test]
fn a_liver_lies_still_on_its_bed_and_comes_back_when_it_was_pushed() {
    let folder = tempfile::tempdir().unwrap();
    let scene = write_liver_on_bed(folder.path(), N_TETS).unwrap();
    let mut world = open(&scene, Arc::new(Sequential));
    let mut other = open(&scene, Arc::new(WorkerTeam::new(2).unwrap()));
    let rest_m = world.state().positions_m.to_vec();
    let home = world.tools()[0].home;
    for _ in 0..100 {
        let report = world.step(&StepInput::of(&[home]));
        other.step(&StepInput::of(&[home]));
        assert!(report.self_contact.penetration_m < 1e-6, "{report:?}");
    }
    assert!(furthest_m(&world, &rest_m) < 1e-6, "{}", furthest_m(&world, &rest_m));
    // A second down, 2 cm into the liver, a second up.
    let mut deepest_m = 0.0_f64;
    let saved = other.save();
    for step in 0..200 {
        let way = 1.0 - (f64::from(step) / 100.0 - 1.0).abs();
        let mut tool = home;
        tool.tip_in_world_m.y += way * 0.08;
        let report = world.step(&StepInput::of(&[tool]));
        deepest_m = deepest_m.max(report.self_contact.penetration_m);
        if step < 120 {
            other.step(&StepInput::of(&[tool]));
        }
    }
    assert!(deepest_m < 0.5e-3, "{deepest_m} m between bodies");
    for _ in 0..100 {
        world.step(&StepInput::of(&[home]));
    }
    let off_m = furthest_m(&world, &rest_m);
    assert!(off_m < 1e-3, "{off_m} m from the shape at rest");
    // Back to before the push, in mid-contact: the same bits again.
    other.restore(&saved);
    let mut third = open(&scene, Arc::new(Sequential));
    third.restore(&saved);
    for _ in 0..20 {
        other.step(&StepInput::of(&[home]));
        third.step(&StepInput::of(&[home]));
    }
    assert_eq!(other.state_hash(), third.state_hash());
}
