//! The scripted palpation: runs the scene, keeps force and time, takes pictures, replays the session.

use super::scenery::Files;
use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::math::DVec3;
use glisson::model::StateHash;
use glisson::world::World;
use glisson_picture::{
    Arrow, Camera, Caption, CaptionPlace, Instrument, Look, Picture, PictureScene, ShadedSurface, View,
};
use glisson_runtime::replay::{self, read_session};
use glisson_runtime::{OpenScene, Simulation};
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

const PICTURE_SIZE: [usize; 2] = [1280, 800];
/// From the front [degrees].
const FRONT: f64 = 0.0;
/// How far above the horizontal the eye is [degrees].
const ELEVATION_DEG: f64 = 20.0;

/// A picture of a push, from the side: from the front the force points into the eye.
struct Shot {
    file: &'static str,
    title: &'static str,
    /// From the front towards the patient's right.
    azimuth_deg: f64,
}

/// One for each push, in the order of the scene's path.
const SHOTS: [Shot; 2] = [
    Shot { file: "2_push_right_lobe.png", title: "Right lobe", azimuth_deg: 50.0 },
    Shot { file: "3_push_left_lobe.png", title: "Left lobe", azimuth_deg: -50.0 },
];
/// Length of a force arrow [m/N].
const ARROW_M_PER_N: f64 = 0.06;

/// State of one step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) time_s: f64,
    pub(crate) force_n: DVec3,
    /// How far the touched point is from where it was at rest [m]; 0 without contact.
    pub(crate) indentation_m: f64,
}

/// What the palpation showed.
pub(crate) struct Palpation {
    pub(crate) samples: Vec<Sample>,
    pub(crate) pictures: Vec<PathBuf>,
    /// Times [s] and forces [N] of the pictures of a push.
    pub(crate) pictured: Vec<[f64; 2]>,
    pub(crate) model: &'static str,
    pub(crate) material: String,
    pub(crate) steps: u64,
    pub(crate) elapsed_s: f64,
    pub(crate) state_hash: StateHash,
    pub(crate) replayed_hash: StateHash,
}

impl Palpation {
    /// Greatest force [N].
    pub(crate) fn greatest_force_n(&self) -> f64 {
        self.samples.iter().map(|s| s.force_n.length()).fold(0.0, f64::max)
    }
}

/// Runs the scene's path to its end.
pub(crate) fn palpate(files: &Files) -> anyhow::Result<Palpation> {
    let source = OpenScene::read(&files.scene)?;
    let scene = source.scene.clone();
    let path = &scene.paths[0];
    let end_s = scene.end_of_paths_s().context("the demo's scene has a path")?;
    let mut simulation = Simulation::open(source, Some(&files.session))?;
    let time_step_s = simulation.world().spec().time_step_s;
    let mut pictures = vec![picture(&files.folder.join("1_rest.png"), simulation.world(), FRONT, "At rest")?];
    let steps = (end_s / time_step_s).round() as u64;
    let mut samples = Vec::with_capacity(steps as usize);
    // Every push is pictured at the end of its hold: the third of its four points of the path.
    let moments: Vec<(u64, &Shot)> = path
        .chunks(4)
        .zip(&SHOTS)
        .filter_map(|(push, shot)| Some(((push.get(2)?.time_s / time_step_s).round() as u64, shot)))
        .collect();
    let start = Instant::now();
    let (mut drawing_s, mut pictured) = (0.0, Vec::new());
    for step in 1..=steps {
        let report = simulation.advance(&scene.input_at(step as f64 * time_step_s))?;
        samples.push(Sample {
            time_s: step as f64 * time_step_s,
            force_n: report.tools[0].force_on_tool_n,
            indentation_m: indentation_m(simulation.world()),
        });
        if let Some((_, shot)) = moments.iter().find(|m| m.0 == step) {
            let (world, name) = (simulation.world(), shot.title);
            ensure!(report.in_contact(), "the probe does not touch the liver when it should push ({name})");
            let before = Instant::now();
            pictures.push(picture(&files.folder.join(shot.file), world, shot.azimuth_deg, name)?);
            pictured.push([step as f64 * time_step_s, report.tools[0].force_on_tool_n.length()]);
            drawing_s += before.elapsed().as_secs_f64();
        }
    }
    let elapsed_s = start.elapsed().as_secs_f64() - drawing_s;
    let model = simulation.world().model_kind().name();
    let material = simulation.body().material_text.clone();
    let state_hash = simulation.finish()?;
    let session = read_session(&files.session)?;
    let replayed = replay::replay(&session, &files.folder, |_| Ok(()))?;
    ensure!(
        replayed.state_hash == state_hash && replayed.first_difference.is_none(),
        "the replay differs from the recording"
    );
    write_csv(files, &samples)?;
    Ok(Palpation {
        samples,
        pictures,
        pictured,
        model,
        material,
        steps,
        elapsed_s,
        state_hash,
        replayed_hash: replayed.state_hash,
    })
}

fn indentation_m(world: &World) -> f64 {
    let Some(contact) = world.snapshot().tools[0].contacts[0] else { return 0.0 };
    let rest_m: DVec3 =
        (0..3).map(|v| world.organ().mesh().positions_m[contact.nodes[v].index()] * contact.weights[v]).sum();
    contact.point_m.distance(rest_m)
}

fn write_csv(files: &Files, samples: &[Sample]) -> anyhow::Result<()> {
    write_atomically(&files.force_csv, |out| {
        writeln!(out, "time_s,force_x_n,force_y_n,force_z_n,indentation_m")?;
        for s in samples {
            let f = s.force_n;
            writeln!(out, "{},{},{},{},{}", s.time_s, f.x, f.y, f.z, s.indentation_m)?;
        }
        Ok(())
    })
    .with_context(|| format!("{}: cannot write", files.force_csv.display()))
}

fn camera(world: &World, azimuth_deg: f64) -> Camera {
    let view = View { azimuth_rad: azimuth_deg.to_radians(), elevation_rad: ELEVATION_DEG.to_radians() };
    Camera::framing_points(&world.snapshot().positions_m, PICTURE_SIZE, view)
}

fn picture(path: &std::path::Path, world: &World, azimuth_deg: f64, title: &str) -> anyhow::Result<PathBuf> {
    let topology = world.display_topology();
    let snapshot = world.snapshot();
    let force_n = snapshot.tools[0].force_n;
    let arrows = snapshot.tools[0].contacts[0].map(|contact| Arrow {
        from_m: contact.point_m,
        to_m: contact.point_m + force_n * ARROW_M_PER_N,
        radius_m: 1.5e-3,
        colour: [255, 210, 60],
    });
    let text = format!(
        "{title}   t = {:.2} s   force on the probe {:.2} N   {}, {} tetrahedra",
        snapshot.time_s,
        force_n.length(),
        world.model_kind(),
        world.organ().mesh().tetrahedra.len()
    );
    let scene = PictureScene {
        surfaces: vec![ShadedSurface {
            positions_m: snapshot.positions_m,
            triangles: topology.triangles,
            rest_positions_m: topology.rest_positions_m,
            look: Look::Liver,
        }],
        instruments: Instrument::all(world.tools(), &snapshot.tools),
        arrows: arrows.into_iter().collect(),
        captions: vec![Caption { text, place: CaptionPlace::BottomLeft }],
        camera: camera(world, azimuth_deg),
        size: PICTURE_SIZE,
    };
    Picture::render(&scene)?.write_png(path)?;
    Ok(path.to_path_buf())
}
