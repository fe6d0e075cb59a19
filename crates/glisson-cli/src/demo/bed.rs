//! A liver on its bed: several bodies, gravity, and a picture of them.

use anyhow::Context;
use glisson::math::Aabb;
use glisson::world::World;
use glisson_lab::bed::write_liver_on_bed;
use glisson_picture::{Camera, Caption, CaptionPlace, Picture, PictureScene, View, looks_of, shown_of};
use glisson_runtime::{OpenScene, Simulation};
use std::path::{Path, PathBuf};

const PICTURE_SIZE: [usize; 2] = [1280, 800];
/// How long it lies without a window [s].
const SECONDS: f64 = 5.0;

/// Writes the scene; answers with its file.
pub(crate) fn write_scene(folder: &Path, n_tets: usize) -> anyhow::Result<PathBuf> {
    write_liver_on_bed(folder, n_tets).context("the scene of a liver on its bed")
}

/// The scene for a window.
pub(crate) fn open(scene: &Path) -> anyhow::Result<Simulation> {
    Simulation::open(OpenScene::read(scene)?, None)
}

/// Lets it lie, and writes a picture of the bodies.
pub(crate) fn lie(scene: &Path) -> anyhow::Result<()> {
    let source = OpenScene::read(scene)?;
    let (dt_s, input) = (source.scene.world.time_step_s, source.scene.input_at(0.0));
    let mut simulation = Simulation::open(source, None)?;
    let start_m = simulation.world().state().positions_m.to_vec();
    let mut deepest_m = 0.0_f64;
    for _ in 0..(SECONDS / dt_s).round() as usize {
        deepest_m = deepest_m.max(simulation.advance(&input)?.self_contact.penetration_m);
    }
    let world = simulation.world();
    let ways_m = start_m.iter().zip(world.state().positions_m).map(|(a, b)| a.distance(*b));
    println!("furthest way     {:.3} mm in {SECONDS} s", 1e3 * ways_m.fold(0.0, f64::max));
    println!("deepest overlap  {:.3} mm, before it was undone", 1e3 * deepest_m);
    let file = scene.with_extension("png");
    picture(&file, world)?;
    println!("state hash       {}\nwritten to {}", simulation.finish()?, file.display());
    Ok(())
}

fn picture(file: &Path, world: &World) -> anyhow::Result<()> {
    let topology = world.display_topology();
    let snapshot = world.snapshot();
    let bounds = Aabb::of_points(&snapshot.positions_m);
    let text = format!(
        "A liver on its bed, {} bodies, {:.0} mm wide   t = {:.1} s",
        world.spec().bodies.len(),
        1e3 * bounds.size_m().x,
        snapshot.time_s
    );
    let view = View { azimuth_rad: 0.6, elevation_rad: 0.35 };
    let scene = PictureScene {
        camera: Camera::framing_points(&snapshot.positions_m, PICTURE_SIZE, view),
        surfaces: shown_of(&topology, &snapshot, &looks_of(world.spec(), "")).0,
        instruments: Vec::new(),
        arrows: Vec::new(),
        captions: vec![Caption { text, place: CaptionPlace::BottomLeft }],
        size: PICTURE_SIZE,
    };
    Picture::render(&scene)?.write_png(file)
}
