//! `glisson demo --task resection`: two hands take a tumour out of the liver. One holds the tissue over it and pulls, the
//! other burns a cone around and beneath it with a hook; an assistant sets clips on what bleeds; then the piece is lifted out.
//!
//! The plan ([`super::plan`]) comes from the image's tumour. The same script ([`super::script`]) leads the instruments here and
//! in the viewer.

use super::plan::{Plan, TIP_RADIUS_M};
use super::scenery::Files;
use super::script::{GRASPER, HOOK, Operation};
use super::specimen::Specimen;
use crate::text_file::write_text;
use anyhow::{Context, ensure};
use glisson::math::DVec3;
use glisson::mesh::files::{read_mesh, write_mesh};
use glisson::model::StateHash;
use glisson::tool::ToolInput;
use glisson::world::World;
use glisson_picture::{
    Arrow, Camera, Caption, CaptionPlace, Instrument, Look, Picture, PictureScene, ShadedSurface, View,
};
use glisson_runtime::replay::{self, read_session};
use glisson_runtime::script::{Clip, bleeding_ml_per_min};
use glisson_runtime::{OpenScene, Simulation};
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const PICTURE_SIZE: [usize; 2] = [1280, 800];
/// A hook that feels more than this [N] for so long [s] is stuck, and the script stops: choices, well above the 3 N at which
/// liver gives way to its tip and beyond the time of a jerk.
const STUCK_N: f64 = 10.0;
const STUCK_S: f64 = 0.25;
/// The clip applier waits so far above the surface [m].
const CLIPS_HOME_M: f64 = 0.08;

fn quoted_mm(point_m: DVec3) -> String {
    let [x, y, z] = (point_m * 1e3).to_array();
    format!("[\"{x:.3} mm\", \"{y:.3} mm\", \"{z:.3} mm\"]")
}

/// The scene's file.
pub(crate) fn scene_file(files: &Files) -> PathBuf {
    files.folder.join("resection.toml")
}

fn session_file(files: &Files) -> PathBuf {
    files.folder.join("resection.jsonl")
}

/// The mesh that is finer on the hook's way.
fn fine_mesh_file(files: &Files) -> PathBuf {
    files.folder.join("resection.vtu")
}

/// Adds the hook with its way: times [s] and poses.
fn write_hook(text: &mut String, plan: &Plan, way: &[(f64, ToolInput)]) -> std::fmt::Result {
    let [u, _] = plan.across();
    write!(
        text,
        "\n# The operating hand burns around it.\n\
         [[tool]]\nname = \"hook\"\nkind = \"hook\"\ntip_radius = \"{} mm\"\ncut_force = \"1 mN\"\ncut_time = \"4 ms\"\n\
         home_tip = {}\nhome_shaft = {}\n",
        TIP_RADIUS_M * 1e3,
        quoted_mm(plan.entry_m + plan.out * 0.1 + u * 0.05),
        direction(plan.out),
    )?;
    for (time_s, pose) in way {
        write!(
            text,
            "\n[[tool.path]]\ntime = \"{time_s:.4} s\"\ntip = {}\nshaft = {}\ntrigger = {}\n",
            quoted_mm(pose.tip_in_world_m),
            direction(pose.shaft_in_world),
            pose.trigger
        )?;
    }
    Ok(())
}

/// Writes the finer mesh and the scene with both hands' ways.
pub(crate) fn write_scene(files: &Files) -> anyhow::Result<()> {
    let (mesh, _) = read_mesh(&files.mesh)?;
    let plan = Plan::new(files, &mesh)?;
    let n_before = mesh.positions_m.len();
    let fine = plan.finer(mesh)?;
    // As many as a tenth of the coarse mesh's.
    let (held_direction, held_fraction) = plan.held(&fine, 0.1 * n_before as f64);
    let mesh_file = fine_mesh_file(files);
    write_mesh(&mesh_file, &fine)?;
    println!(
        "\nfiner mesh on the hook's way: {} tetrahedra, in {}",
        fine.tetrahedra.len(),
        mesh_file.display()
    );
    let name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let ((hook, _), grasper_home_m) = (plan.hook(), plan.entry_m + plan.out * 0.08);
    let end_s = hook.last().map_or(0.0, |point| point.0);
    let [u, _] = plan.across();
    let mut text = format!(
        "# Written by `glisson demo --task resection`. Positions are in the patient frame (LPS).\n\
         glisson_scene = 1\nname = \"Resection of a tumour from a synthetic patient's liver\"\n\n\
         [simulation]\ntime_step = \"0.2 ms\"\n\n\
         [organ]\nmesh = \"{}\"\ntissue = \"liver\"\nmodel = \"explicit\"\nlaw = \"stable_neo_hooke\"\ndamping = \"20 1/s\"\n\
         vessels = \"vessels.csv\"\ntearing = true\n\n\
         [[organ.fixed]]\nfurthest = {{ direction = {}, fraction = {held_fraction:.5} }}\n\n\
         # The script knows where its instruments are; hands that give way lag behind it.\n\
         [hand]\ntouch = \"imposed\"\n\n\
         # The assisting hand holds the tissue over the tumour.\n\
         [[tool]]\nname = \"grasper\"\nkind = \"grasper\"\ntip_radius = \"2.5 mm\"\nclosing_force = \"10 N\"\nfriction = 0.8\n\
         home_tip = {}\nhome_shaft = {}\nhome_jaw = 1.0\n",
        name(&mesh_file),
        direction(held_direction),
        quoted_mm(grasper_home_m),
        direction(plan.out + 0.2 * u),
    );
    for (time_s, tip_m, jaw) in plan.grasper(end_s) {
        write!(text, "\n[[tool.path]]\ntime = \"{time_s:.4} s\"\ntip = {}\njaw = {jaw}\n", quoted_mm(tip_m))?;
    }
    write_hook(&mut text, &plan, &hook)?;
    write!(
        text,
        "\n# An assistant closes vessels with it.\n\
         [[tool]]\nname = \"clip applier\"\nkind = \"grasper\"\ntip_radius = \"2 mm\"\njaw_length = \"10 mm\"\n\
         home_tip = {}\nhome_shaft = {}\n",
        quoted_mm(plan.entry_m + plan.out * CLIPS_HOME_M - u * 0.05),
        direction(plan.out - 0.3 * u),
    )?;
    write_text(&scene_file(files), &text)
}

fn direction(d: DVec3) -> String {
    format!("[{:.6}, {:.6}, {:.6}]", d.x, d.y, d.z)
}

/// What was seen on the way.
#[derive(Clone, Debug, Default)]
struct Course {
    steps: u64,
    greatest_n: [f64; 2],
    held_steps: u64,
    clips_pictured: bool,
    greatest_ml_per_min: f64,
    pictures: Vec<PathBuf>,
}

/// What came of the operation.
pub(crate) struct Resection {
    pub(crate) state_hash: StateHash,
    /// Share of the tumour in the piece that was lifted; 0 if that is not free.
    pub(crate) tumour_in_specimen: f64,
    /// Least distance of the cut from the tumour [m].
    pub(crate) margin_m: f64,
}

/// The simulation of the scene, led through the operation; records into `resection.jsonl`.
pub(crate) fn begin(files: &Files) -> anyhow::Result<Simulation> {
    let (coarse, _) = read_mesh(&files.mesh)?;
    let source = OpenScene::read(&scene_file(files))?;
    let scene = source.scene.clone();
    let mut simulation = Simulation::open(source, Some(&session_file(files)))?;
    let operation = Operation::new(Plan::new(files, &coarse)?, scene, simulation.world())?;
    simulation.follow_script(Box::new(operation));
    Ok(simulation)
}

/// Leads the instruments to the end of the script.
fn follow_script(files: &Files, plan: &Plan, simulation: &mut Simulation) -> anyhow::Result<Course> {
    let time_step_s = simulation.world().spec().time_step_s;
    let shots = [(0.0, "before"), (0.3, "burning"), (0.8, "beneath"), (1.0, "lifted")];
    let mut shots = shots.into_iter().peekable();
    let (mut course, mut stuck_s) = (Course::default(), 0.0);
    let shoot = |name: &str, world: &World, pictures: &mut Vec<PathBuf>| {
        let file = files.folder.join(format!("resection_{}_{name}.png", pictures.len() + 1));
        picture(&file, world, plan, name)?;
        pictures.push(file);
        anyhow::Ok(())
    };
    let progress = indicatif::ProgressBar::new(100);
    while !simulation.script_is_over() {
        if let Some((_, name)) = shots.next_if(|(share, _)| *share <= simulation.script_progress()) {
            shoot(name, simulation.world(), &mut course.pictures)?;
        }
        if !course.clips_pictured && simulation.is_about_to_clip() {
            course.clips_pictured = true;
            shoot("clipping", simulation.world(), &mut course.pictures)?;
        }
        let input = simulation.scripted_input().context("the script goes on")?;
        let report = simulation.advance(&input)?;
        course.steps += 1;
        course.greatest_ml_per_min = course.greatest_ml_per_min.max(bleeding_ml_per_min(simulation.world()));
        for (greatest, tool) in course.greatest_n.iter_mut().zip(&report.tools) {
            *greatest = greatest.max(tool.force_on_tool_n.length());
        }
        course.held_steps += u64::from(report.tools[GRASPER].n_held_nodes > 0);
        let hook_n = report.tools[HOOK].force_on_tool_n.length();
        stuck_s = if hook_n > STUCK_N { stuck_s + time_step_s } else { 0.0 };
        ensure!(
            stuck_s < STUCK_S,
            "the hook is stuck after {:.2} s: {hook_n:.1} N for {STUCK_S} s, and tissue gives way at some 3 N; the script stops",
            course.steps as f64 * time_step_s
        );
        if course.steps.is_multiple_of(500) {
            progress.set_position((100.0 * simulation.script_progress()) as u64);
        }
    }
    for (_, name) in shots {
        shoot(name, simulation.world(), &mut course.pictures)?;
    }
    progress.finish_and_clear();
    Ok(course)
}

/// What came of the operation, in numbers.
struct Account {
    course: Course,
    specimen: Specimen,
    tumour_radius_m: f64,
    time_step_s: f64,
    n_tets: usize,
    n_removed: usize,
    n_torn: usize,
    burnt_ml: f64,
    lost_ml: f64,
    end_ml_per_min: f64,
    open_ends: usize,
    clips: Vec<Clip>,
    notices: Vec<String>,
    /// Of the operation and of its replay.
    state_hash: StateHash,
}

impl Account {
    fn specimen_ml(&self) -> f64 {
        1e6 * self.specimen.volume_m3
    }

    fn to_json(&self) -> serde_json::Value {
        json!({
            "steps": self.course.steps, "simulated_s": self.course.steps as f64 * self.time_step_s, "tetrahedra": self.n_tets,
            "tetrahedra_removed": self.n_removed, "tetrahedra_torn": self.n_torn, "burnt_ml": self.burnt_ml,
            "pieces": self.specimen.n_pieces, "specimen_ml": self.specimen_ml(),
            "specimen_is_free": self.specimen.is_free, "tumour_in_specimen": self.specimen.tumour_share,
            "tumour_radius_m": self.tumour_radius_m, "least_margin_m": self.specimen.margin_m,
            "blood_lost_ml": self.lost_ml, "open_vessel_ends": self.open_ends, "clips": self.clips,
            "greatest_bleeding_ml_per_min": self.course.greatest_ml_per_min, "bleeding_at_the_end_ml_per_min": self.end_ml_per_min,
            "greatest_force_grasper_n": self.course.greatest_n[GRASPER], "greatest_force_hook_n": self.course.greatest_n[HOOK],
            "steps_held_by_grasper": self.course.held_steps, "notices": self.notices,
            "state_hash": self.state_hash.to_string(), "replayed_state_hash": self.state_hash.to_string(),
        })
    }

    fn to_markdown(&self) -> Result<String, std::fmt::Error> {
        let specimen_ml = self.specimen_ml();
        let Self { time_step_s, n_tets, n_removed, n_torn, burnt_ml, .. } = self;
        let Self { lost_ml, end_ml_per_min, open_ends, state_hash, specimen, .. } = self;
        let Course { steps, greatest_n, greatest_ml_per_min, pictures, .. } = &self.course;
        let mut text = String::from(
            "# A tumour is taken out of the liver with two hands\n\nThe grasper holds the tissue over the tumour and pulls; the hook burns a cone \
             around and beneath it; now and then an assistant sets clips on what bleeds; then the piece is lifted out.\n\n",
        );
        for file in pictures {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            writeln!(text, "![{name}]({name})")?;
        }
        text += "\n| what | value |\n|---|---|\n";
        for (what, value) in [
            ("steps", format!("{steps} of {} ms, {} tetrahedra", time_step_s * 1e3, n_tets)),
            (
                "tissue burnt away or torn",
                format!("{n_removed} tetrahedra, {burnt_ml:.1} ml; {n_torn} of them torn"),
            ),
            ("pieces of the organ", specimen.n_pieces.to_string()),
            (
                "piece with the tumour",
                format!("{specimen_ml:.1} ml, {}", if specimen.is_free { "free" } else { "still held" }),
            ),
            ("of the tumour in it", format!("{:.1} %", 100.0 * specimen.tumour_share)),
            ("least distance of the cut from the tumour", format!("{:.1} mm", 1e3 * specimen.margin_m)),
            (
                "blood lost",
                format!(
                    "{lost_ml:.1} ml; at most {greatest_ml_per_min:.0} ml/min, {end_ml_per_min:.0} at the end"
                ),
            ),
            ("clips", format!("{}, {open_ends} vessels open at the end", self.clips.len())),
            (
                "greatest forces",
                format!("grasper {:.2} N, hook {:.2} N", greatest_n[GRASPER], greatest_n[HOOK]),
            ),
            ("state hash, also of the replay", format!("`{state_hash}`")),
        ] {
            writeln!(text, "| {what} | {value} |")?;
        }
        Ok(text)
    }
}

/// Runs the operation without a window, takes pictures, replays it, and writes `resection.md` and `resection.json`.
pub(crate) fn operate(files: &Files) -> anyhow::Result<Resection> {
    let (coarse, _) = read_mesh(&files.mesh)?;
    let plan = Plan::new(files, &coarse)?;
    let mut simulation = begin(files)?;
    let n_tets = simulation.world().organ().mesh().tetrahedra.len();
    let course = follow_script(files, &plan, &mut simulation)?;
    let specimen = Specimen::of(simulation.world(), &plan.tumour)?;
    let world = simulation.world();
    let (lost_ml, open_ends) = world.vessels().map_or((0.0, 0), |v| (1e6 * v.lost_m3(), v.open_ends().len()));
    let account = Account {
        course,
        specimen,
        tumour_radius_m: plan.tumour.radius_m,
        time_step_s: world.spec().time_step_s,
        n_tets,
        n_removed: n_tets - world.organ().body().topology().live_counts().tets,
        n_torn: simulation.n_torn(),
        burnt_ml: 1e6 * world.removed_volume_m3(),
        lost_ml,
        end_ml_per_min: bleeding_ml_per_min(world),
        open_ends,
        clips: simulation.scripted_clips().to_vec(),
        notices: simulation.notices().iter().map(|notice| notice.text.clone()).collect(),
        state_hash: simulation.finish()?,
    };
    let session = read_session(&session_file(files))?;
    let replayed = replay::replay(&session, &files.folder, |_| Ok(()))?;
    ensure!(
        replayed.state_hash == account.state_hash && replayed.first_difference.is_none(),
        "the replay differs from the recording"
    );
    let json_text = serde_json::to_string_pretty(&account.to_json())? + "\n";
    let text = account.to_markdown()?;
    for (name, contents) in [("resection.json", &json_text), ("resection.md", &text)] {
        write_text(&files.folder.join(name), contents)?;
    }
    println!("{text}");
    let Account { specimen, state_hash, .. } = account;
    let tumour_in_specimen = if specimen.is_free { specimen.tumour_share } else { 0.0 };
    Ok(Resection { state_hash, tumour_in_specimen, margin_m: specimen.margin_m })
}

/// A red arrow out of the tissue, larger than life.
fn drop_of_blood(end_m: DVec3, out: DVec3) -> Arrow {
    Arrow { from_m: end_m, to_m: end_m + out * 0.012, radius_m: 1.5e-3, colour: [170, 0, 10] }
}

fn picture(file: &Path, world: &World, plan: &Plan, title: &str) -> anyhow::Result<()> {
    let (topology, snapshot) = (world.display_topology(), world.snapshot());
    let azimuth_rad = 0.5 - plan.out.x.atan2(-plan.out.y).clamp(-1.2, 1.2);
    let view = View { azimuth_rad, elevation_rad: 0.5 };
    let text = format!(
        "Resection, {title}   t = {:.1} s   {} of {} tetrahedra are left",
        snapshot.time_s,
        world.organ().body().topology().live_counts().tets,
        world.organ().mesh().tetrahedra.len()
    );
    let scene = PictureScene {
        camera: Camera::framing_points(&snapshot.positions_m, PICTURE_SIZE, view),
        surfaces: vec![ShadedSurface {
            positions_m: snapshot.positions_m,
            triangles: topology.triangles,
            rest_positions_m: topology.rest_positions_m,
            look: Look::Liver,
        }],
        instruments: Instrument::all(world.tools(), &snapshot.tools),
        // What bleeds.
        arrows: snapshot.bleeding.ends.iter().map(|end| drop_of_blood(end.position_m, plan.out)).collect(),
        captions: vec![Caption { text, place: CaptionPlace::BottomLeft }],
        size: PICTURE_SIZE,
    };
    Picture::render(&scene)?.write_png(file)
}
