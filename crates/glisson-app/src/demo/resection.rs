//! `glisson demo --task resection`: two hands take a tumour out of the liver. One holds the tissue over it and pulls, the
//! other burns a cone around and beneath it with a hook; then the piece is lifted out.
//!
//! The plan comes from the image's tumour: a cone about the line from the nearest point of the surface to the tumour's
//! middle, with its tip beneath it. The hook goes around it on ever deeper circles and leans, so that its straight shaft
//! lies in what it has burnt already: under a flat bottom it would have to go through the piece.

use super::scenery::Files;
use crate::picture::{
    Camera, Caption, CaptionPlace, Instrument, Look, Picture, PictureScene, ShadedSurface, View,
};
use crate::runtime::replay::{self, read_session};
use crate::runtime::{OpenScene, Simulation};
use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::image::LabelMap;
use glisson::image::labels::Parts;
use glisson::image::nifti::read_label_map;
use glisson::math::DVec3;
use glisson::mesh::TetId;
use glisson::mesh::files::read_mesh;
use glisson::mesh::topology::{Through, Topology, surface_of};
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
/// Healthy tissue that is taken with the tumour [m]: a choice.
const MARGIN_M: f64 = 12e-3;
/// Half the angle of the cone [rad]: a choice; a narrower one is deeper, a wider one takes more of the surface.
const LEAN_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
/// Distance between two circles [m], below the width of what the hook burns.
const LEVEL_M: f64 = 5e-3;
/// How fast the hook is led [m/s].
const SPEED_M_PER_S: f64 = 0.2;
/// Points on a circle.
const CORNERS: usize = 24;
/// A hook that feels more than this [N] for so long [s] is stuck, and the script stops: choices, well above the 3 N at which
/// liver gives way to its tip and beyond the time of a jerk.
const STUCK_N: f64 = 10.0;
const STUCK_S: f64 = 0.25;
/// How far the piece is lifted in the end [m].
const LIFT_M: f64 = 0.06;

/// A ball in the patient.
#[derive(Clone, Copy, Debug)]
struct Ball {
    center_m: DVec3,
    radius_m: f64,
}

/// The tumour in the image: its middle, and the ball of the same volume.
fn tumour(labels: &LabelMap) -> anyhow::Result<Ball> {
    let mask = labels.mask(&labels.select("liver_tumour", Parts::Included)?);
    let inside = mask.iter().enumerate().filter(|(_, inside)| **inside);
    let (sum, n) = inside.fold((DVec3::ZERO, 0.0), |(sum, n), (index, _)| {
        let [i, j, k] = labels.grid.voxel(index);
        (sum + labels.grid.position_m(DVec3::new(i as f64, j as f64, k as f64)), n + 1.0)
    });
    ensure!(n > 0.0, "the label map has no voxel of the tumour");
    let volume_m3 = n * labels.grid.voxel_volume_m3();
    Ok(Ball { center_m: sum / n, radius_m: (volume_m3 * 0.75 / std::f64::consts::PI).cbrt() })
}

/// Where the hands go.
struct Plan {
    tumour: Ball,
    entry_m: DVec3,
    /// From the tumour out of the liver.
    out: DVec3,
    depth_m: f64,
}

impl Plan {
    fn new(files: &Files) -> anyhow::Result<Self> {
        let tumour = tumour(&read_label_map(&files.labels)?)?;
        let (mesh, _) = read_mesh(&files.mesh)?;
        let (surface, _) = surface_of(&Topology::build(&mesh)?, &mesh);
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
        Ok(Self { tumour, entry_m, out, depth_m: entry_m.distance(tumour.center_m) })
    }

    fn across(&self) -> [DVec3; 2] {
        let first = self.out.any_orthonormal_vector();
        [first, self.out.cross(first)]
    }

    /// How deep the tip of the cone lies: it touches a ball around the tumour, with the margin.
    fn tip_of_cone_m(&self) -> f64 {
        self.depth_m + (self.tumour.radius_m + MARGIN_M) / LEAN_RAD.sin()
    }

    /// The hook on the cone, `below_m` under the surface, drawn back along its shaft by `back_m`.
    fn on_cone(&self, below_m: f64, angle: f64, back_m: f64) -> ToolInput {
        let [u, v] = self.across();
        let aside = u * angle.cos() + v * angle.sin();
        let radius_m = (self.tip_of_cone_m() - below_m) * LEAN_RAD.tan();
        let shaft = self.out * LEAN_RAD.cos() + aside * LEAN_RAD.sin();
        ToolInput::at(self.entry_m - self.out * below_m + aside * radius_m + shaft * back_m, shaft)
    }

    /// The hook's way: time [s], pose.
    fn hook(&self) -> Vec<(f64, ToolInput)> {
        let bottom_m = self.tip_of_cone_m();
        let above_m = -3.0 * LEVEL_M;
        let mut way: Vec<(f64, ToolInput)> = vec![(1.0, self.on_cone(above_m, 0.0, 0.03))];
        let mut to = |pose: ToolInput, trigger: f64| {
            let (time_s, last) = way[way.len() - 1];
            let way_m = pose.tip_in_world_m.distance(last.tip_in_world_m);
            way.push((time_s + (way_m / SPEED_M_PER_S).max(1e-3), ToolInput { trigger, ..pose }));
        };
        // A little above the surface first: where it bulges.
        let n_levels = (bottom_m / LEVEL_M).ceil() as usize + 2;
        for level in 0..=n_levels {
            let below_m = (LEVEL_M * (level as f64 - 2.0)).min(bottom_m);
            for corner in 0..=CORNERS {
                let angle = std::f64::consts::TAU * corner as f64 / CORNERS as f64;
                to(self.on_cone(below_m, angle, 0.0), 1.0);
            }
        }
        // Out along its shaft, burning what is in the way.
        let out_m = bottom_m / LEAN_RAD.cos();
        to(self.on_cone(bottom_m, 0.0, out_m + 0.03), 1.0);
        to(self.on_cone(bottom_m, 0.0, out_m + 0.06), 0.0);
        way
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

/// Writes the scene with both hands' ways.
pub(crate) fn write_scene(files: &Files) -> anyhow::Result<()> {
    let plan = Plan::new(files)?;
    let name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let (hook, grasper_home_m) = (plan.hook(), plan.entry_m + plan.out * 0.08);
    let end_s = hook.last().map_or(0.0, |point| point.0);
    let [u, _] = plan.across();
    let mut text = format!(
        "# Written by `glisson demo --task resection`. Positions are in the patient frame (LPS).\n\
         glisson_scene = 1\nname = \"Resection of a tumour from a synthetic patient's liver\"\n\n\
         [simulation]\ntime_step = \"0.2 ms\"\n\n\
         [organ]\nmesh = \"{}\"\ntissue = \"liver\"\nmodel = \"explicit\"\nlaw = \"stable_neo_hooke\"\ndamping = \"20 1/s\"\n\
         vessels = \"vessels.csv\"\ntearing = true\n\n\
         [[organ.fixed]]\nfurthest = {{ direction = [0.0, 1.0, 0.4], fraction = 0.1 }}\n\n\
         # The assisting hand holds the tissue over the tumour.\n\
         [[tool]]\nname = \"grasper\"\nkind = \"grasper\"\ntip_radius = \"2.5 mm\"\nclosing_force = \"10 N\"\nfriction = 0.8\n\
         home_tip = {}\nhome_shaft = {}\nhome_jaw = 1.0\n",
        name(&files.mesh),
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
    let file = scene_file(files);
    write_atomically(&file, |out| out.write_all(text.as_bytes()))
        .with_context(|| format!("{}: cannot write", file.display()))
}

fn direction(d: DVec3) -> String {
    format!("[{:.6}, {:.6}, {:.6}]", d.x, d.y, d.z)
}

/// What is left where.
struct Outcome {
    n_removed: usize,
    burnt_ml: f64,
    specimen_ml: f64,
    /// Whether it hangs together with nothing that is held.
    is_free: bool,
    /// Share of the tumour's tetrahedra that are in the specimen.
    tumour_in_specimen: f64,
    /// Nearest the burnt tissue came to the tumour's ball, at rest [m].
    margin_m: f64,
    pieces: usize,
}

fn outcome(world: &World, tumour: Ball) -> Outcome {
    let body = world.organ().body();
    let topology = body.topology();
    let middle = |tet: TetId| body.mesh().corners_m(tet).into_iter().sum::<DVec3>() / 4.0;
    let pieces = topology.pieces(Through::Faces);
    let core = |tet: &TetId| middle(*tet).distance(tumour.center_m) < tumour.radius_m;
    let in_tumour: Vec<TetId> = topology.live_tets().filter(core).collect();
    let n_tumour = (0..topology.n_tets()).map(TetId::from_index).filter(core).count();
    // The piece that holds most of the tumour.
    let mut counts = vec![0usize; pieces.count()];
    for tet in &in_tumour {
        counts[pieces.of_tet[tet.index()] as usize] += 1;
    }
    let specimen = counts.iter().enumerate().max_by_key(|(_, n)| **n).map_or(0, |(piece, _)| piece);
    // A piece that something holds is the organ itself.
    let is_held = |t: TetId| topology.tet_nodes(t).into_iter().any(|node| world.organ().is_fixed(node));
    let is_free = !topology.live_tets().any(|t| pieces.of_tet[t.index()] as usize == specimen && is_held(t));
    let volume_ml = |is_in: &dyn Fn(TetId) -> bool| {
        1e6 * (0..topology.n_tets())
            .map(TetId::from_index)
            .filter(|&t| is_in(t))
            .map(|t| body.mesh().tet_volume_m3(t))
            .sum::<f64>()
    };
    let burnt = |t: TetId| !topology.is_live_tet(t);
    let margin_m = (0..topology.n_tets())
        .map(TetId::from_index)
        .filter(|&t| burnt(t))
        .flat_map(|t| body.mesh().corners_m(t))
        .map(|corner_m| corner_m.distance(tumour.center_m) - tumour.radius_m)
        .fold(f64::INFINITY, f64::min);
    Outcome {
        n_removed: (0..topology.n_tets()).map(TetId::from_index).filter(|&t| burnt(t)).count(),
        burnt_ml: volume_ml(&burnt),
        specimen_ml: volume_ml(&|t| topology.is_live_tet(t) && pieces.of_tet[t.index()] as usize == specimen),
        is_free,
        tumour_in_specimen: counts.get(specimen).copied().unwrap_or(0) as f64 / n_tumour.max(1) as f64,
        margin_m,
        pieces: pieces.count(),
    }
}

/// What came of the operation.
pub(crate) struct Resection {
    pub(crate) state_hash: StateHash,
    /// Share of the tumour in the piece that was lifted; 0 if that is not free.
    pub(crate) tumour_in_specimen: f64,
}

/// Runs the operation without a window, takes pictures, replays it, and writes `resection.md` and `resection.json`.
pub(crate) fn operate(files: &Files) -> anyhow::Result<Resection> {
    let plan = Plan::new(files)?;
    let source = OpenScene::read(&scene_file(files))?;
    let scene = source.scene.clone();
    let session_file = files.folder.join("resection.jsonl");
    let end_s = scene.end_of_paths_s().context("the scene has paths")?;
    let mut simulation = Simulation::open(source, Some(&session_file))?;
    let time_step_s = simulation.world().spec().time_step_s;
    let steps = (end_s / time_step_s).ceil() as u64;
    let shots = [(0.0, "before"), (0.3, "burning"), (0.8, "beneath"), (1.0, "lifted")];
    let mut moments = shots.iter().map(|(share, name)| ((share * steps as f64) as u64, *name)).peekable();
    let mut pictures = Vec::new();
    let (mut greatest_n, mut held_steps, mut stuck_s) = ([0.0_f64; 2], 0u64, 0.0);
    let progress = indicatif::ProgressBar::new(steps);
    for step in 0..=steps {
        if let Some((_, name)) = moments.next_if(|(at, _)| *at <= step) {
            let file = files.folder.join(format!("resection_{}_{name}.png", pictures.len() + 1));
            picture(&file, simulation.world(), &plan, name)?;
            pictures.push(file);
        }
        if step == steps {
            break;
        }
        let report = simulation.advance(&scene.input_at((step + 1) as f64 * time_step_s))?;
        for (greatest, tool) in greatest_n.iter_mut().zip(&report.tools) {
            *greatest = greatest.max(tool.force_on_tool_n.length());
        }
        held_steps += u64::from(report.tools[0].n_held_nodes > 0);
        let hook_n = report.tools[1].force_on_tool_n.length();
        stuck_s = if hook_n > STUCK_N { stuck_s + time_step_s } else { 0.0 };
        ensure!(
            stuck_s < STUCK_S,
            "the hook is stuck at {:.2} s: {hook_n:.1} N for {STUCK_S} s, and tissue gives way at some 3 N; the script stops",
            step as f64 * time_step_s
        );
        if step % 500 == 0 {
            progress.set_position(step);
        }
    }
    progress.finish_and_clear();
    let outcome = outcome(simulation.world(), plan.tumour);
    let vessels = simulation.world().vessels();
    let (lost_ml, open_ends) = vessels.map_or((0.0, 0), |v| (1e6 * v.lost_m3(), v.open_ends().len()));
    let (notices, n_torn) = (simulation.notices().to_vec(), simulation.n_torn());
    let state_hash = simulation.finish()?;
    let session = read_session(&session_file)?;
    let replayed = replay::replay(&session, &files.folder, |_| Ok(()))?;
    ensure!(
        replayed.state_hash == state_hash && replayed.first_difference.is_none(),
        "the replay differs from the recording"
    );
    let report = json!({
        "steps": steps, "simulated_s": end_s,
        "tetrahedra_removed": outcome.n_removed, "tetrahedra_torn": n_torn, "burnt_ml": outcome.burnt_ml,
        "pieces": outcome.pieces, "specimen_ml": outcome.specimen_ml,
        "specimen_is_free": outcome.is_free, "tumour_in_specimen": outcome.tumour_in_specimen, "least_margin_m": outcome.margin_m,
        "blood_lost_ml": lost_ml, "open_vessel_ends": open_ends,
        "greatest_force_grasper_n": greatest_n[0], "greatest_force_hook_n": greatest_n[1],
        "steps_held_by_grasper": held_steps, "notices": notices,
        "state_hash": state_hash.to_string(), "replayed_state_hash": replayed.state_hash.to_string(),
    });
    let json_text = serde_json::to_string_pretty(&report)? + "\n";
    let mut text = String::from(
        "# A tumour is taken out of the liver with two hands\n\nThe grasper holds the tissue over the tumour and pulls; the hook burns a cone \
         around and beneath it; then the piece is lifted out.\n\n",
    );
    for file in &pictures {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        writeln!(text, "![{name}]({name})")?;
    }
    text += "\n| what | value |\n|---|---|\n";
    for (what, value) in [
        ("steps", format!("{steps} of {} ms", time_step_s * 1e3)),
        (
            "tissue burnt away or torn",
            format!("{} tetrahedra, {:.1} ml; {n_torn} of them torn", outcome.n_removed, outcome.burnt_ml),
        ),
        ("pieces of the organ", outcome.pieces.to_string()),
        (
            "piece with the tumour",
            format!("{:.1} ml, {}", outcome.specimen_ml, if outcome.is_free { "free" } else { "still held" }),
        ),
        ("of the tumour in it", format!("{:.0} %", 100.0 * outcome.tumour_in_specimen)),
        ("least distance of burnt tissue from the tumour", format!("{:.1} mm", 1e3 * outcome.margin_m)),
        ("blood lost", format!("{lost_ml:.1} ml from {open_ends} open vessels")),
        ("greatest forces", format!("grasper {:.2} N, hook {:.2} N", greatest_n[0], greatest_n[1])),
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
    let tumour_in_specimen = if outcome.is_free { outcome.tumour_in_specimen } else { 0.0 };
    Ok(Resection { state_hash, tumour_in_specimen })
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
        arrows: Vec::new(),
        captions: vec![Caption { text, place: CaptionPlace::BottomLeft }],
        size: PICTURE_SIZE,
    };
    Picture::render(&scene)?.write_png(file)
}
