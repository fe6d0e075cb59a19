//! `glisson demo --task resection`: two hands take a tumour out of the liver. One holds the tissue over it and pulls, the
//! other burns a cone around and beneath it with a hook; an assistant sets clips on what bleeds; then the piece is lifted out.
//!
//! The plan comes from the image's tumour: a cone about the line from the nearest point of the surface to the tumour's
//! middle, with its tip beneath it. The hook goes around it on ever deeper circles and leans, so that its straight shaft
//! lies in what it has burnt already: under a flat bottom it would have to go through the piece. What a hook burns is as
//! thick as the tetrahedra that it touches, so the mesh is made finer along its way beforehand. Now and then it rests
//! while the vessels that it opened are closed.

use super::clips::ClipApplier;
use super::scenery::Files;
use super::specimen::{Specimen, Tumour, holds};
use crate::picture::{
    Arrow, Camera, Caption, CaptionPlace, Instrument, Look, Picture, PictureScene, ShadedSurface, View,
};
use crate::runtime::replay::{self, read_session};
use crate::runtime::{OpenScene, Simulation};
use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::image::nifti::read_label_map;
use glisson::math::DVec3;
use glisson::mesh::edit::EditableMesh;
use glisson::mesh::files::{read_mesh, write_mesh};
use glisson::mesh::refine::{FineRegion, refine};
use glisson::mesh::topology::{Topology, surface_of};
use glisson::mesh::{TetId, TetMesh};
use glisson::record::hash::StateHash;
use glisson::surface::normals::{NormalWeight, vertex_normals};
use glisson::tool::ToolInput;
use glisson::world::World;
use serde_json::json;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

const PICTURE_SIZE: [usize; 2] = [1280, 800];
const TIP_RADIUS_M: f64 = 3e-3;
/// Healthy tissue between the tumour and the hook's way [m]: a choice. What is left of it is much less: by the hook's tip, by the
/// size of the tetrahedra that it burns, and by how far the piece, soft and nearly free, gives way before the tools.
const MARGIN_M: f64 = 17e-3;
/// Half the angle of the cone [rad]: a choice; a narrower one is deeper, a wider one takes more of the surface.
const LEAN_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
/// Distance between two circles [m], below the width of what the hook burns.
const LEVEL_M: f64 = 6e-3;
/// How fast the hook is led [m/s].
const SPEED_M_PER_S: f64 = 0.2;
/// Points on a circle.
const CORNERS: usize = 24;
/// Circles that may lie above the surface at the entry, where the organ rises beside it.
const CIRCLES_ABOVE: usize = 4;
/// After so many circles the hook rests: a choice. A vessel that is closed earlier is often cut again nearer to its root.
const CIRCLES_TO_LOOK: usize = 5;
/// Longest edge of the tetrahedra on the hook's way [m], and how far around it: choices.
const FINE_EDGE_M: f64 = 14e-3;
const FINE_RADIUS_M: f64 = 6e-3;
/// Edges that one edit divides.
const MOST_SPLITS: usize = 1_000;
/// A hook that feels more than this [N] for so long [s] is stuck, and the script stops: choices, well above the 3 N at which
/// liver gives way to its tip and beyond the time of a jerk.
const STUCK_N: f64 = 10.0;
const STUCK_S: f64 = 0.25;
/// How far the piece is lifted in the end [m].
const LIFT_M: f64 = 0.06;

/// The instruments, as the scene has them.
const GRASPER: usize = 0;
const HOOK: usize = 1;
const CLIP_APPLIER: usize = 2;
/// The clip applier waits so far above the surface, and comes from so far above it to each vessel [m].
const CLIPS_HOME_M: f64 = 0.08;
const CLIPS_ABOVE_M: f64 = 0.02;

/// Where the hands go.
struct Plan {
    tumour: Tumour,
    entry_m: DVec3,
    /// From the tumour out of the liver.
    out: DVec3,
    depth_m: f64,
    /// How far the circles lie below the surface [m], the first ones first: those that meet the organ.
    circles_m: Vec<f64>,
}

impl Plan {
    fn new(files: &Files, mesh: &TetMesh) -> anyhow::Result<Self> {
        let tumour = Tumour::of(&read_label_map(&files.labels)?)?;
        let (surface, _) = surface_of(&Topology::build(mesh)?, mesh);
        let normals = vertex_normals(&surface, NormalWeight::Area);
        let nearest = surface
            .positions_m
            .iter()
            .zip(&normals)
            // From behind no instrument comes.
            .filter(|(_, normal)| normal.y < 0.3)
            .min_by(|a, b| a.0.distance(tumour.center_m).total_cmp(&b.0.distance(tumour.center_m)))
            .context("the liver has no surface")?;
        let entry_m = *nearest.0;
        let out = (entry_m - tumour.center_m).try_normalize().unwrap_or(*nearest.1);
        let depth_m = entry_m.distance(tumour.center_m);
        let mut plan = Self { tumour, entry_m, out, depth_m, circles_m: Vec::new() };
        plan.circles_m = plan.circles_in(mesh);
        Ok(plan)
    }

    fn across(&self) -> [DVec3; 2] {
        let first = self.out.any_orthonormal_vector();
        [first, self.out.cross(first)]
    }

    /// How deep the tip of the cone lies: it touches a ball around the tumour, with the margin.
    fn tip_of_cone_m(&self) -> f64 {
        self.depth_m + (self.tumour.radius_m + MARGIN_M) / LEAN_RAD.sin()
    }

    /// The circles that meet the organ, and one more above and below.
    fn circles_in(&self, mesh: &TetMesh) -> Vec<f64> {
        let bottom_m = self.tip_of_cone_m();
        let n = (bottom_m / LEVEL_M).ceil() as usize + CIRCLES_ABOVE;
        let below_m = |circle: usize| (LEVEL_M * (circle as f64 - CIRCLES_ABOVE as f64)).min(bottom_m);
        let meets = |circle: usize| {
            let mut places_m = (0..CORNERS).map(|corner| {
                let angle = std::f64::consts::TAU * corner as f64 / CORNERS as f64;
                self.on_cone(below_m(circle), angle, 0.0).tip_in_world_m
            });
            places_m
                .any(|p| (0..mesh.tetrahedra.len()).any(|t| holds(mesh.corners_m(TetId::from_index(t)), p)))
        };
        let first = (0..=n).find(|&circle| meets(circle)).unwrap_or(0);
        let last = (0..=n).rev().find(|&circle| meets(circle)).unwrap_or(n);
        (first.saturating_sub(1)..=(last + 1).min(n)).map(below_m).collect()
    }

    /// The hook on the cone, `below_m` under the surface, drawn back along its shaft by `back_m`.
    fn on_cone(&self, below_m: f64, angle: f64, back_m: f64) -> ToolInput {
        let [u, v] = self.across();
        let aside = u * angle.cos() + v * angle.sin();
        let radius_m = (self.tip_of_cone_m() - below_m) * LEAN_RAD.tan();
        let shaft = self.out * LEAN_RAD.cos() + aside * LEAN_RAD.sin();
        ToolInput::at(self.entry_m - self.out * below_m + aside * radius_m + shaft * back_m, shaft)
    }

    /// Finer tetrahedra around the hook's way.
    fn finer(&self, mesh: TetMesh) -> anyhow::Result<TetMesh> {
        let mut body = EditableMesh::new(mesh)?;
        let bottom_m = self.tip_of_cone_m();
        let n_levels = (bottom_m / FINE_RADIUS_M).ceil() as usize + 1;
        for level in 0..=n_levels {
            let below_m = (FINE_RADIUS_M * (level as f64 - 1.0)).min(bottom_m);
            let around_m = std::f64::consts::TAU * (bottom_m - below_m) * LEAN_RAD.tan();
            let n = (around_m / FINE_RADIUS_M).ceil().max(1.0) as usize;
            for i in 0..n {
                let pose = self.on_cone(below_m, std::f64::consts::TAU * i as f64 / n as f64, 0.0);
                let region = FineRegion {
                    center_m: pose.tip_in_world_m,
                    radius_m: FINE_RADIUS_M,
                    edge_m: FINE_EDGE_M,
                };
                while let Some(edit) = refine(&body, &region, MOST_SPLITS) {
                    body.apply(&edit)?;
                }
            }
        }
        Ok(body.live_mesh())
    }

    /// Where the clip applier sets a clip on a vessel that bleeds at `end_m`, and whence it comes: along the cone, in what is
    /// burnt already.
    fn to_clip(&self, end_m: DVec3) -> [ToolInput; 2] {
        let [u, v] = self.across();
        let from_entry_m = end_m - self.entry_m;
        let below_m = (-from_entry_m.dot(self.out)).clamp(0.0, self.tip_of_cone_m());
        let angle = from_entry_m.dot(v).atan2(from_entry_m.dot(u));
        let back_m = (below_m + CLIPS_ABOVE_M) / LEAN_RAD.cos();
        [self.on_cone(below_m, angle, back_m), self.on_cone(below_m, angle, 0.0)]
    }

    /// The hook's way: time [s], pose; and when it rests so that vessels can be clipped [s].
    fn hook(&self) -> (Vec<(f64, ToolInput)>, Vec<f64>) {
        let bottom_m = self.circles_m.last().copied().unwrap_or(0.0);
        let above_m = self.circles_m.first().copied().unwrap_or(0.0) - LEVEL_M;
        let mut way: Vec<(f64, ToolInput)> = vec![(1.0, self.on_cone(above_m, 0.0, 0.03))];
        let mut to = |pose: ToolInput, trigger: f64| {
            let (time_s, last) = way[way.len() - 1];
            let way_m = pose.tip_in_world_m.distance(last.tip_in_world_m);
            let there_s = time_s + (way_m / SPEED_M_PER_S).max(1e-3);
            way.push((there_s, ToolInput { trigger, ..pose }));
            there_s
        };
        let mut looks_s = Vec::new();
        for (circle, &below_m) in self.circles_m.iter().enumerate() {
            for corner in 0..=CORNERS {
                let angle = std::f64::consts::TAU * corner as f64 / CORNERS as f64;
                let there_s = to(self.on_cone(below_m, angle, 0.0), 1.0);
                if corner == CORNERS && (circle + 1).is_multiple_of(CIRCLES_TO_LOOK) {
                    looks_s.push(there_s);
                }
            }
        }
        // Out along its shaft, burning what is in the way.
        let out_m = bottom_m / LEAN_RAD.cos();
        to(self.on_cone(bottom_m, 0.0, out_m + 0.03), 1.0);
        looks_s.push(to(self.on_cone(bottom_m, 0.0, out_m + 0.06), 0.0));
        (way, looks_s)
    }

    /// The grasper's way: time [s], tip [m], opening of the jaws.
    fn grasper(&self, end_s: f64) -> Vec<(f64, DVec3, f64)> {
        let above = |out_m: f64| self.entry_m + self.out * out_m;
        vec![
            (0.3, above(0.03), 1.0),
            (0.6, above(-4e-3), 1.0),
            (0.8, above(-4e-3), 0.0),
            (1.0, above(0.0), 0.0),
            (0.7 * end_s, above(4e-3), 0.0),
            (end_s, above(4e-3), 0.0),
            (end_s + 1.0, above(LIFT_M), 0.0),
        ]
    }
}

fn quoted_mm(point_m: DVec3) -> String {
    let [x, y, z] = (point_m * 1e3).to_array();
    format!("[\"{x:.3} mm\", \"{y:.3} mm\", \"{z:.3} mm\"]")
}

/// The scene's file.
pub(crate) fn scene_file(files: &Files) -> PathBuf {
    files.folder.join("resection.toml")
}

/// The mesh that is finer on the hook's way.
fn fine_mesh_file(files: &Files) -> PathBuf {
    files.folder.join("resection.vtu")
}

/// Writes the finer mesh and the scene with both hands' ways.
pub(crate) fn write_scene(files: &Files) -> anyhow::Result<()> {
    let (mesh, _) = read_mesh(&files.mesh)?;
    let plan = Plan::new(files, &mesh)?;
    let n_before = mesh.positions_m.len();
    let fine = plan.finer(mesh)?;
    // The new nodes lie in front: of all of them fewer are held behind.
    let held = 0.1 * n_before as f64 / fine.positions_m.len() as f64;
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
         [[organ.fixed]]\nfurthest = {{ direction = [0.0, 1.0, 0.4], fraction = {held:.5} }}\n\n\
         # The assisting hand holds the tissue over the tumour.\n\
         [[tool]]\nname = \"grasper\"\nkind = \"grasper\"\ntip_radius = \"2.5 mm\"\nclosing_force = \"10 N\"\nfriction = 0.8\n\
         home_tip = {}\nhome_shaft = {}\nhome_jaw = 1.0\n",
        name(&mesh_file),
        quoted_mm(grasper_home_m),
        direction(plan.out + 0.2 * u),
    );
    for (time_s, tip_m, jaw) in plan.grasper(end_s) {
        write!(text, "\n[[tool.path]]\ntime = \"{time_s:.4} s\"\ntip = {}\njaw = {jaw}\n", quoted_mm(tip_m))?;
    }
    write!(
        text,
        "\n# The operating hand burns around it.\n\
         [[tool]]\nname = \"hook\"\nkind = \"hook\"\ntip_radius = \"{} mm\"\ncut_force = \"1 mN\"\ncut_time = \"4 ms\"\n\
         home_tip = {}\nhome_shaft = {}\n",
        TIP_RADIUS_M * 1e3,
        quoted_mm(plan.entry_m + plan.out * 0.1 + u * 0.05),
        direction(plan.out),
    )?;
    for (time_s, pose) in hook {
        write!(
            text,
            "\n[[tool.path]]\ntime = \"{time_s:.4} s\"\ntip = {}\nshaft = {}\ntrigger = {}\n",
            quoted_mm(pose.tip_in_world_m),
            direction(pose.shaft_in_world),
            pose.trigger
        )?;
    }
    write!(
        text,
        "\n# An assistant closes vessels with it.\n\
         [[tool]]\nname = \"clip applier\"\nkind = \"grasper\"\ntip_radius = \"2 mm\"\njaw_length = \"10 mm\"\n\
         home_tip = {}\nhome_shaft = {}\n",
        quoted_mm(plan.entry_m + plan.out * CLIPS_HOME_M - u * 0.05),
        direction(plan.out - 0.3 * u),
    )?;
    let file = scene_file(files);
    write_atomically(&file, |out| out.write_all(text.as_bytes()))
        .with_context(|| format!("{}: cannot write", file.display()))
}

fn direction(d: DVec3) -> String {
    format!("[{:.6}, {:.6}, {:.6}]", d.x, d.y, d.z)
}

/// A clip.
#[derive(Clone, Copy, Debug, serde::Serialize)]
struct Clip {
    time_s: f64,
    /// Blood that the whole organ lost before and after [ml/min].
    before_ml_per_min: f64,
    after_ml_per_min: f64,
}

/// What was seen on the way.
#[derive(Clone, Debug, Default)]
struct Course {
    steps: u64,
    greatest_n: [f64; 2],
    held_steps: u64,
    clips: Vec<Clip>,
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

/// Blood that the organ loses now [ml/min].
fn bleeding_ml_per_min(world: &World) -> f64 {
    world.vessels().map_or(0.0, |vessels| 60e6 * vessels.bleeding_m3_per_s())
}

/// Leads the instruments along the script of the scene, which waits while vessels are clipped.
fn follow_script(
    files: &Files,
    plan: &Plan,
    scene: &glisson::scene::Scene,
    simulation: &mut Simulation,
) -> anyhow::Result<Course> {
    let end_s = scene.end_of_paths_s().context("the scene has paths")?;
    let time_step_s = simulation.world().spec().time_step_s;
    let script_steps = (end_s / time_step_s).ceil() as u64;
    let shots = [(0.0, "before"), (0.3, "burning"), (0.8, "beneath"), (1.0, "lifted")];
    let mut shots =
        shots.iter().map(|(share, name)| ((share * script_steps as f64) as u64, *name)).peekable();
    let mut looks = plan.hook().1.into_iter().chain([end_s]).peekable();
    let mut applier = ClipApplier::new(simulation.world().tools()[CLIP_APPLIER].home);
    let (mut course, mut stuck_s, mut script_step, mut is_looking) = (Course::default(), 0.0, 0_u64, false);
    let shoot = |name: &str, world: &World, pictures: &mut Vec<PathBuf>| {
        let file = files.folder.join(format!("resection_{}_{name}.png", pictures.len() + 1));
        picture(&file, world, plan, name)?;
        pictures.push(file);
        anyhow::Ok(())
    };
    let progress = indicatif::ProgressBar::new(script_steps);
    loop {
        if let Some((_, name)) = shots.next_if(|(at, _)| *at <= script_step) {
            shoot(name, simulation.world(), &mut course.pictures)?;
        }
        let script_s = script_step as f64 * time_step_s;
        is_looking |= looks.next_if(|look_s| *look_s <= script_s).is_some();
        if is_looking && !applier.is_busy() {
            // What bleeds most comes first; a clip on one vessel may close others.
            let ends = simulation.world().snapshot().bleeding.ends;
            let worst = ends.iter().max_by(|a, b| a.rate_m3_per_s.total_cmp(&b.rate_m3_per_s));
            match worst {
                Some(end) => applier.send(plan.to_clip(end.position_m)),
                None => {
                    applier.go_home();
                    is_looking = false;
                }
            }
        }
        let waits = applier.is_busy();
        if !waits && script_step == script_steps {
            break;
        }
        script_step += u64::from(!waits);
        let mut input = scene.input_at(script_step as f64 * time_step_s);
        if waits {
            input.tools[HOOK].trigger = 0.0;
        }
        let (pose, clips) = applier.advance(time_step_s);
        input.tools[CLIP_APPLIER] = pose;
        let report = simulation.advance(&input)?;
        course.steps += 1;
        course.greatest_ml_per_min = course.greatest_ml_per_min.max(bleeding_ml_per_min(simulation.world()));
        if clips {
            if course.clips.is_empty() {
                shoot("clipping", simulation.world(), &mut course.pictures)?;
            }
            let before_ml_per_min = bleeding_ml_per_min(simulation.world());
            simulation.clip_vessel(CLIP_APPLIER)?;
            let after_ml_per_min = bleeding_ml_per_min(simulation.world());
            let time_s = simulation.world().snapshot().time_s;
            if after_ml_per_min < before_ml_per_min {
                course.clips.push(Clip { time_s, before_ml_per_min, after_ml_per_min });
            } else {
                // Out of reach, of which a notice tells: until the next look.
                applier.go_home();
                is_looking = false;
            }
        }
        for (greatest, tool) in course.greatest_n.iter_mut().zip(&report.tools) {
            *greatest = greatest.max(tool.force_on_tool_n.length());
        }
        course.held_steps += u64::from(report.tools[GRASPER].n_held_nodes > 0);
        let hook_n = report.tools[HOOK].force_on_tool_n.length();
        stuck_s = if hook_n > STUCK_N { stuck_s + time_step_s } else { 0.0 };
        ensure!(
            stuck_s < STUCK_S,
            "the hook is stuck at {script_s:.2} s: {hook_n:.1} N for {STUCK_S} s, and tissue gives way at some 3 N; the script stops",
        );
        if script_step.is_multiple_of(500) {
            progress.set_position(script_step);
        }
    }
    progress.finish_and_clear();
    Ok(course)
}

/// Runs the operation without a window, takes pictures, replays it, and writes `resection.md` and `resection.json`.
pub(crate) fn operate(files: &Files) -> anyhow::Result<Resection> {
    let (coarse, _) = read_mesh(&files.mesh)?;
    let plan = Plan::new(files, &coarse)?;
    let source = OpenScene::read(&scene_file(files))?;
    let scene = source.scene.clone();
    let session_file = files.folder.join("resection.jsonl");
    let mut simulation = Simulation::open(source, Some(&session_file))?;
    let whole = simulation.world().organ().mesh().clone();
    let time_step_s = simulation.world().spec().time_step_s;
    let course = follow_script(files, &plan, &scene, &mut simulation)?;
    let specimen = Specimen::of(simulation.world(), &whole, &plan.tumour)?;
    let world = simulation.world();
    let (lost_ml, open_ends) = world.vessels().map_or((0.0, 0), |v| (1e6 * v.lost_m3(), v.open_ends().len()));
    let (burnt_ml, end_ml_per_min) = (1e6 * world.removed_volume_m3(), bleeding_ml_per_min(world));
    let n_removed = whole.tetrahedra.len() - world.organ().body().topology().live_counts().tets;
    let (notices, n_torn) = (simulation.notices().to_vec(), simulation.n_torn());
    let state_hash = simulation.finish()?;
    let session = read_session(&session_file)?;
    let replayed = replay::replay(&session, &files.folder, |_| Ok(()))?;
    ensure!(
        replayed.state_hash == state_hash && replayed.first_difference.is_none(),
        "the replay differs from the recording"
    );
    let Course { steps, greatest_n, held_steps, clips, greatest_ml_per_min, pictures } = course;
    let specimen_ml = 1e6 * specimen.volume_m3;
    let report = json!({
        "steps": steps, "simulated_s": steps as f64 * time_step_s, "tetrahedra": whole.tetrahedra.len(),
        "tetrahedra_removed": n_removed, "tetrahedra_torn": n_torn, "burnt_ml": burnt_ml,
        "pieces": specimen.n_pieces, "specimen_ml": specimen_ml,
        "specimen_is_free": specimen.is_free, "tumour_in_specimen": specimen.tumour_share,
        "tumour_radius_m": plan.tumour.radius_m, "least_margin_m": specimen.margin_m,
        "blood_lost_ml": lost_ml, "open_vessel_ends": open_ends, "clips": clips,
        "greatest_bleeding_ml_per_min": greatest_ml_per_min, "bleeding_at_the_end_ml_per_min": end_ml_per_min,
        "greatest_force_grasper_n": greatest_n[GRASPER], "greatest_force_hook_n": greatest_n[HOOK],
        "steps_held_by_grasper": held_steps, "notices": notices,
        "state_hash": state_hash.to_string(), "replayed_state_hash": replayed.state_hash.to_string(),
    });
    let json_text = serde_json::to_string_pretty(&report)? + "\n";
    let mut text = String::from(
        "# A tumour is taken out of the liver with two hands\n\nThe grasper holds the tissue over the tumour and pulls; the hook burns a cone \
         around and beneath it; now and then an assistant sets clips on what bleeds; then the piece is lifted out.\n\n",
    );
    for file in &pictures {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        writeln!(text, "![{name}]({name})")?;
    }
    text += "\n| what | value |\n|---|---|\n";
    for (what, value) in [
        ("steps", format!("{steps} of {} ms, {} tetrahedra", time_step_s * 1e3, whole.tetrahedra.len())),
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
        ("clips", format!("{}, {open_ends} vessels open at the end", clips.len())),
        ("greatest forces", format!("grasper {:.2} N, hook {:.2} N", greatest_n[GRASPER], greatest_n[HOOK])),
        ("state hash, also of the replay", format!("`{state_hash}`")),
    ] {
        writeln!(text, "| {what} | {value} |")?;
    }
    for (name, contents) in [("resection.json", &json_text), ("resection.md", &text)] {
        let file = files.folder.join(name);
        write_atomically(&file, |out| out.write_all(contents.as_bytes()))
            .with_context(|| format!("{}: cannot write", file.display()))?;
    }
    println!("{text}");
    let tumour_in_specimen = if specimen.is_free { specimen.tumour_share } else { 0.0 };
    Ok(Resection { state_hash, tumour_in_specimen, margin_m: specimen.margin_m })
}

fn instrument(pose: &ToolInput, world: &World, tool: usize) -> Instrument {
    let spec = &world.tools()[tool];
    Instrument {
        tip_m: pose.tip_in_world_m,
        handle_m: pose.tip_in_world_m + pose.shaft_in_world * spec.shaft_length_m,
        tip_radius_m: spec.tip_radius_m,
        shaft_radius_m: spec.shaft_radius_m,
    }
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
        instruments: snapshot
            .tools
            .iter()
            .enumerate()
            .map(|(i, tool)| instrument(&tool.pose, world, i))
            .collect(),
        // What bleeds.
        arrows: snapshot.bleeding.ends.iter().map(|end| drop_of_blood(end.position_m, plan.out)).collect(),
        captions: vec![Caption { text, place: CaptionPlace::BottomLeft }],
        size: PICTURE_SIZE,
    };
    Picture::render(&scene)?.write_png(file)
}
