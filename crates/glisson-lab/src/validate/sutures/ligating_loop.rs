//! A ligating loop around a stump: put over its end, drawn tight, tied off, let go.

use glisson::math::DVec3;
use glisson::scene::{Scene, build_world};
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};
use std::path::Path;
use std::sync::Arc;

/// Over the stump until then, drawn until then, tied off, away, end [s].
const OVER_S: f64 = 0.2;
const DRAWN_S: f64 = 0.6;
const TIED_S: f64 = 0.9;
const AWAY_S: f64 = 1.0;
const END_S: f64 = 2.5;
/// The pull is the mean of its readings from this time until it is tied off [s].
const STILL_S: f64 = 0.8;
/// The height at which the loop is put; the stump is cut 8 mm above it.
const HEIGHT_M: f64 = 0.03;

/// What came of one model.
#[derive(Default)]
pub(super) struct Ligature {
    /// Length of the thread around the stump [mm], from when it is tied off on.
    pub(super) girth: Vec<[f64; 2]>,
    /// Its length around the stump as that was at rest [mm].
    pub(super) girth_at_rest_mm: f64,
    pub(super) tied_mm: f64,
    pub(super) end_mm: f64,
    /// Pull of the thread before it is tied off [N].
    pub(super) tension_n: f64,
    /// Greatest force on the hand [N].
    pub(super) most_felt_n: f64,
    pub(super) fastest_mm_per_s: f64,
    /// Blood when the stump is cut beyond it [ml/min].
    pub(super) bleeding_ml_per_min: f64,
}

fn scene(model: &str, step_ms: f64) -> String {
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{step_ms} ms\"\n[organ]\n\
         tube = {{ path = [[\"0 mm\", \"0 mm\", \"0 mm\"], [\"0 mm\", \"0 mm\", \"48 mm\"]], radii = [[\"6 mm\"], [\"6 mm\"]] }}\n\
         edge = \"4 mm\"\nyoung_modulus = \"5 kPa\"\npoisson_ratio = 0.45\ndensity = \"1060 kg/m3\"\nmodel = \"{model}\"\n\
         law = \"stable_neo_hooke\"\ndamping = \"20 1/s\"\n\
         [[organ.vessel]]\npath = [[\"0 mm\", \"0 mm\", \"0 mm\"], [\"0 mm\", \"0 mm\", \"48 mm\"]]\nradius = \"1.5 mm\"\n\
         [[organ.fixed]]\nbox = {{ min = [\"-9 mm\", \"-9 mm\", \"-9 mm\"], max = [\"9 mm\", \"9 mm\", \"4 mm\"] }}\n\
         [[tool]]\nkind = \"loop\"\ntip_radius = \"2 mm\"\nloop_diameter = \"30 mm\"\n\
         home_tip = [\"0 mm\", \"-15 mm\", \"70 mm\"]\nhome_shaft = [0, -1, 0]\n"
    )
}

fn input(world: &World, time_s: f64) -> StepInput {
    let ramp = |from_s: f64, to_s: f64| ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    let mut input = StepInput::of(&[world.tools()[0].home]);
    let tool = &mut input.tools[0];
    let away = ramp(AWAY_S, AWAY_S + 0.2);
    tool.tip_in_world_m +=
        DVec3::new(0.0, 7e-3 * ramp(OVER_S, DRAWN_S) - 0.05 * away, -0.04 * ramp(0.0, OVER_S));
    tool.jaw_opening = 1.0 - ramp(OVER_S, DRAWN_S);
    tool.trigger = if (TIED_S..TIED_S + 0.05).contains(&time_s) { 1.0 } else { 0.0 };
    input
}

pub(super) fn run(model: &str, step_ms: f64) -> anyhow::Result<Ligature> {
    let scene = Scene::parse(&scene(model, step_ms))?;
    let mut world = build_world(&scene, Path::new(""), Arc::new(Sequential))?.0;
    let dt_s = scene.world.time_step_s;
    let mut ligature = Ligature::default();
    let n_steps = (END_S / dt_s).round() as usize;
    let shown = (0.02 / dt_s).round().max(1.0) as usize;
    let (mut sum_n, mut n_sum) = (0.0, 0.0);
    for step in 1..=n_steps {
        let time_s = step as f64 * dt_s;
        let asked = input(&world, time_s);
        let report = world.step(&asked);
        world.cut_with_tools();
        ligature.most_felt_n = ligature.most_felt_n.max(report.tools[0].force_on_tool_n.length());
        if (STILL_S..TIED_S).contains(&time_s) {
            (sum_n, n_sum) = (sum_n + world.loop_tension_n(0), n_sum + 1.0);
        }
        if step % shown == 0
            && let Some([now_m, rest_m]) = world.tied_girths_m().next()
        {
            ligature.girth.push([time_s, 1e3 * now_m]);
            ligature.girth_at_rest_mm = 1e3 * rest_m;
        }
    }
    ligature.tension_n = sum_n / n_sum;
    if let [first, .., last] = ligature.girth[..] {
        (ligature.tied_mm, ligature.end_mm) = (first[1], last[1]);
    }
    let speeds = world.state().velocities_m_per_s.iter().map(|v| 1e3 * v.length());
    ligature.fastest_mm_per_s = speeds.fold(0.0, f64::max);
    // Cut off beyond it.
    let (topology, rest_m) = (world.organ().body().topology(), &world.organ().mesh().positions_m);
    let is_beyond = |tet: &glisson::mesh::TetId| {
        topology.tet_nodes(*tet).iter().map(|node| rest_m[node.index()].z).sum::<f64>()
            > 4.0 * (HEIGHT_M + 8e-3)
    };
    let tets = topology.live_tets().filter(is_beyond).collect();
    world.edit(&glisson::mesh::edit::MeshEdit::Remove { tets })?;
    let m3_per_s = world.vessels().map_or(f64::NAN, glisson::world::vessels::Vessels::bleeding_m3_per_s);
    ligature.bleeding_ml_per_min = 60e6 * m3_per_s;
    Ok(ligature)
}
