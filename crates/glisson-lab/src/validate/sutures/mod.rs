//! A stitch through the two sides of a groove in a block: two graspers pull its ends up until the groove is shut, clips tie it where
//! it comes out, the graspers let go. And a ligating loop around a stump.

mod ligating_loop;

use self::ligating_loop::Ligature;
use super::{Claim, Figure, Outcome, check_all, series};
use crate::scratch::ScratchFolder;
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::cells_of_five;
use glisson::mesh::files::write_mesh;
use glisson::scene::{Scene, build_world};
use glisson::suture::nearest_to_itself_m;
use glisson::workers::Sequential;
use glisson::world::{StepInput, World};
use glisson_report::plot::{LinePlot, SeriesStyle};
use std::fmt::Write as _;
use std::sync::Arc;

const OWN: &str = "requirement";
/// The block is 60 x 40 x 20 mm, the groove 4 mm wide and 12 mm deep across its middle.
const CELL_M: f64 = 4e-3;
/// How far the graspers pull to shut it, and to leave it a little open: sides that do not touch each other show how still a thread is.
const UP_M: f64 = 6e-3;
const UP_OPEN_M: f64 = 4e-3;
/// Pulled until then, still until then, clips set at that time, let go, end [s].
const PULLED_S: f64 = 1.0;
const STILL_S: f64 = 1.3;
const CLIPPED_S: f64 = 1.6;
const LET_GO_S: f64 = 1.9;
const END_S: f64 = 2.6;
/// From a hole to the middle of its clip [m].
const CLIP_BEYOND_M: f64 = 1.2e-3;

/// What came of one model.
#[derive(Default)]
struct Stitch {
    groove: Vec<[f64; 2]>,
    tension: Vec<[f64; 2]>,
    shut_mm: f64,
    tension_n: f64,
    /// Of all forces of the thread on tissue and hands, over those on the hands.
    off_balance: f64,
    fastest_mm_per_s: f64,
    nearest_radii: f64,
    tied_mm: f64,
    n_clips: usize,
}

fn block() -> TetMesh {
    cells_of_five([15, 10, 5], CELL_M, |[i, _, k]| !(i == 7 && k >= 2))
}

fn scene(model: &str, step_ms: f64, touches: bool) -> String {
    let contact = if touches { "[contact]\nself = true\n" } else { "" };
    let tool = |kind: &str, x_mm: f64, z_mm: f64, jaw: u32| {
        format!(
            "[[tool]]\nkind = \"{kind}\"\ntip_radius = \"1.5 mm\"\nclosing_force = \"8 N\"\nfriction = 0.6\n\
             home_tip = [\"{x_mm} mm\", \"20 mm\", \"{z_mm} mm\"]\nhome_shaft = [0, 0, 1]\nhome_jaw = {jaw}\n"
        )
    };
    let point = |[x, z]: [i32; 2]| format!("[\"{x} mm\", \"20 mm\", \"{z} mm\"]");
    let path = [[46, 40], [40, 22], [38, 14], [22, 14], [20, 22], [14, 40]].map(point).join(", ");
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{step_ms} ms\"\n[organ]\nmesh = \"block.vtu\"\nyoung_modulus = \"5 kPa\"\n\
         poisson_ratio = 0.45\ndensity = \"1060 kg/m3\"\nmodel = \"{model}\"\nlaw = \"stable_neo_hooke\"\ndamping = \"20 1/s\"\n\
         [[organ.fixed]]\nbox = {{ min = [\"-1 mm\", \"-1 mm\", \"-1 mm\"], max = [\"61 mm\", \"41 mm\", \"0.1 mm\"] }}\n\
         {contact}[[suture]]\nsize = \"3-0\"\npath = [{path}]\n{}{}{}{}",
        tool("grasper", 46.0, 40.0, 0),
        tool("grasper", 14.0, 40.0, 0),
        tool("clipper", 54.0, 95.0, 1),
        tool("clipper", 6.0, 95.0, 1)
    )
}

/// Where the instruments are at a time; clippers go to where the thread comes out.
fn input(world: &World, time_s: f64, most_up_m: f64) -> StepInput {
    let homes: Vec<_> = world.tools().iter().map(|tool| tool.home).collect();
    let mut input = StepInput::of(&homes);
    let up_m = most_up_m * (time_s / PULLED_S).min(1.0);
    let lets_go = ((time_s - LET_GO_S) / 0.1).clamp(0.0, 1.0);
    for tool in &mut input.tools[..2] {
        tool.tip_in_world_m.z += up_m;
        tool.jaw_opening = lets_go;
    }
    let suture = &world.sutures()[0];
    let holes_m: Vec<f64> = suture.holes_m().collect();
    let [Some(first_m), Some(last_m)] = [holes_m.first(), holes_m.last()] else { return input };
    for (tool, along_m) in input.tools[2..].iter_mut().zip([first_m - CLIP_BEYOND_M, last_m + CLIP_BEYOND_M])
    {
        if (STILL_S..LET_GO_S).contains(&time_s) {
            tool.tip_in_world_m = suture.rod().place_at(along_m).point_m(&suture.rod().positions_m);
        }
        tool.jaw_opening = (1.0 - (time_s - CLIPPED_S) / 0.1).clamp(0.0, 1.0);
    }
    input
}

fn run(model: &str, step_ms: f64, (up_m, touches): (f64, bool)) -> anyhow::Result<Stitch> {
    let (folder, mesh) = (ScratchFolder::new()?, block());
    write_mesh(&folder.path().join("block.vtu"), &mesh)?;
    let scene = Scene::parse(&scene(model, step_ms, touches))?;
    let mut world = build_world(&scene, folder.path(), Arc::new(Sequential))?.0;
    let dt_s = scene.world.time_step_s;
    let nearest = |x_m: f64| {
        let away_m = |i: &usize| mesh.positions_m[*i].distance(DVec3::new(x_m, 0.02, 0.02));
        (0..mesh.positions_m.len()).min_by(|a, b| away_m(a).total_cmp(&away_m(b))).unwrap_or(0)
    };
    let sides = [nearest(0.028), nearest(0.032)];
    let mut stitch = Stitch { nearest_radii: f64::INFINITY, ..Stitch::default() };
    let n_steps = (END_S / dt_s).round() as usize;
    let shown = (0.02 / dt_s).round().max(1.0) as usize;
    for step in 1..=n_steps {
        let time_s = step as f64 * dt_s;
        world.step(&input(&world, time_s, up_m));
        let (suture, positions_m) = (&world.sutures()[0], world.state().positions_m);
        let groove_mm = 1e3 * (positions_m[sides[1]].x - positions_m[sides[0]].x);
        let rod = suture.rod();
        let tension_n = rod.tension_n(rod.n_nodes() / 2);
        if step % shown == 0 {
            stitch.groove.push([time_s, groove_mm]);
            stitch.tension.push([time_s, 1e3 * tension_n]);
            let near_m = nearest_to_itself_m(rod).map_or(f64::INFINITY, |near| near.0);
            stitch.nearest_radii = stitch.nearest_radii.min(near_m / rod.radius_m());
        }
        if step == ((STILL_S - 0.05) / dt_s).round() as usize {
            (stitch.shut_mm, stitch.tension_n) = (groove_mm.abs(), tension_n);
            let on_tissue_n: DVec3 = suture.forces().iter().map(|force| force.force_n).sum();
            let on_tools_n = suture.force_on_tool_n(0) + suture.force_on_tool_n(1);
            stitch.off_balance = (on_tissue_n + on_tools_n).length() / on_tools_n.length();
            let all = rod.velocities_m_per_s.iter().chain(world.state().velocities_m_per_s);
            stitch.fastest_mm_per_s = 1e3 * all.map(|v| v.length()).fold(0.0, f64::max);
        }
        stitch.tied_mm = groove_mm;
        stitch.n_clips = suture.clips_m().count();
    }
    Ok(stitch)
}

/// With two models.
struct Measured {
    implicit: Stitch,
    explicit: Stitch,
    /// The groove left a little open.
    open: [Stitch; 2],
    /// A loop around a stump, implicit and explicit.
    loops: [Ligature; 2],
}

impl Measured {
    /// The greater one of the two loops'.
    fn of_loops(&self, of: impl Fn(&Ligature) -> f64) -> f64 {
        self.loops.iter().map(of).fold(f64::MIN, f64::max)
    }
}

const CLAIMS: &[Claim<'static, Measured>] = &[
    Claim::at_most(
        "a stitch pulls a groove of 4 mm shut, implicit: width [mm]",
        OWN,
        |m| m.implicit.shut_mm,
        1.0,
    ),
    Claim::at_most("the same, explicit: width [mm]", OWN, |m| m.explicit.shut_mm, 1.0),
    Claim::near(
        "pull of the thread in explicit over that in implicit",
        OWN,
        |m| m.explicit.tension_n / m.implicit.tension_n,
        [1.0, 0.1],
    ),
    Claim::at_most(
        "forces of the thread on tissue and hands add up to nothing, over those on the hands",
        OWN,
        |m| m.implicit.off_balance.max(m.explicit.off_balance),
        0.02,
    ),
    Claim::at_most(
        "thread and tissue rest when the hands do, the groove still open, fastest node [mm/s]",
        OWN,
        |m| m.open[0].fastest_mm_per_s.max(m.open[1].fastest_mm_per_s),
        5.0,
    ),
    Claim::within(
        "the thread never passes through itself: nearest middle lines [radii]",
        OWN,
        |m| m.implicit.nearest_radii.min(m.explicit.nearest_radii),
        [1.0, f64::INFINITY],
    ),
    Claim::near(
        "clips on both strands",
        OWN,
        |m| (m.implicit.n_clips + m.explicit.n_clips) as f64,
        [4.0, 0.0],
    ),
    Claim::at_most(
        "tied by them and let go: width [mm]",
        OWN,
        |m| m.implicit.tied_mm.max(m.explicit.tied_mm),
        1.0,
    ),
    Claim::at_most(
        "a loop closes a stump of 12 mm: its girth there over that at rest, implicit and explicit",
        OWN,
        |m| m.of_loops(|l| l.tied_mm / l.girth_at_rest_mm),
        0.85,
    ),
    Claim::near(
        "pull of the loop's thread in explicit over that in implicit",
        OWN,
        |m| m.loops[1].tension_n / m.loops[0].tension_n,
        [1.0, 0.1],
    ),
    Claim::at_most(
        "tied off and let go it stays: change of its girth in 1.5 s [%]",
        OWN,
        |m| m.of_loops(|l| 100.0 * (l.end_mm / l.tied_mm - 1.0).abs()),
        3.0,
    ),
    Claim::at_most(
        "the hand feels no more than twice the greatest pull of the thread of 2 N [N]",
        OWN,
        |m| m.of_loops(|l| l.most_felt_n),
        4.0,
    ),
    Claim::at_most(
        "at the end all rests, fastest node [mm/s]",
        OWN,
        |m| m.of_loops(|l| l.fastest_mm_per_s),
        10.0,
    ),
    Claim::at_most(
        "a vessel through the stump does not bleed when it is cut beyond the loop [ml/min]",
        OWN,
        |m| m.of_loops(|l| l.bleeding_ml_per_min),
        0.0,
    ),
];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let both = |how| Ok::<_, anyhow::Error>([run("implicit", 5.0, how)?, run("explicit", 0.15, how)?]);
    let [implicit, explicit] = both((UP_M, true))?;
    let loops = [ligating_loop::run("implicit", 5.0)?, ligating_loop::run("explicit", 0.08)?];
    let measured = Measured { implicit, explicit, open: both((UP_OPEN_M, false))?, loops };
    let plot = |title: &str, y: &str, of: fn(&Stitch) -> &Vec<[f64; 2]>| LinePlot {
        title: title.into(),
        x_label: "time [s]".into(),
        y_label: y.into(),
        series: vec![
            series("implicit, 5 ms", of(&measured.implicit).clone(), SeriesStyle::Line),
            series("explicit, 0.15 ms", of(&measured.explicit).clone(), SeriesStyle::Line),
        ],
        size: [640, 400],
    };
    let mut notes = String::from(
        "\n### A stitch\n\n| model | shut to [mm] | pull [mN] | fastest node then [mm/s] | tied to [mm] |\n|---|---|---|---|---|\n",
    );
    for (name, stitch) in [("implicit", &measured.implicit), ("explicit", &measured.explicit)] {
        let Stitch { shut_mm, tension_n, fastest_mm_per_s, tied_mm, .. } = stitch;
        writeln!(
            notes,
            "| {name} | {shut_mm:.2} | {:.0} | {fastest_mm_per_s:.1} | {tied_mm:.2} |",
            1e3 * tension_n
        )?;
    }
    notes.push_str(
        "\n### A ligating loop\n\n| model | girth at rest [mm] | tied [mm] | pull [mN] | 1.5 s later [mm] | fastest node then [mm/s] |\n|---|---|---|---|---|---|\n",
    );
    let of_loops = || ["implicit, 5 ms", "explicit, 0.08 ms"].into_iter().zip(&measured.loops);
    for (name, of_loop) in of_loops() {
        let Ligature { girth_at_rest_mm, tied_mm, tension_n, end_mm, fastest_mm_per_s, .. } = of_loop;
        writeln!(
            notes,
            "| {name} | {girth_at_rest_mm:.1} | {tied_mm:.1} | {:.0} | {end_mm:.1} | {fastest_mm_per_s:.1} |",
            1e3 * tension_n
        )?;
    }
    let girths = |(name, of_loop): (&str, &Ligature)| series(name, of_loop.girth.clone(), SeriesStyle::Line);
    let figures = vec![
        Figure {
            file: "sutures_groove.svg",
            caption: "Width of the groove: pulled for 1 s, clips at 1.6 s, graspers let go at 1.9 s.".into(),
            plot: plot("A groove pulled shut and tied", "width [mm]", |stitch| &stitch.groove),
        },
        Figure {
            file: "sutures_tension.svg",
            caption: "Pull of the thread between the sides of the groove.".into(),
            plot: plot("The thread between its sides", "pull [mN]", |stitch| &stitch.tension),
        },
        Figure {
            file: "sutures_loop.svg",
            caption: "Length of a loop around a stump that was tied off at 0.9 s; the instrument leaves from 1 s on.".into(),
            plot: LinePlot {
                title: "A loop tied off".into(),
                x_label: "time [s]".into(),
                y_label: "girth [mm]".into(),
                series: of_loops().map(girths).collect(),
                size: [640, 400],
            },
        },
    ];
    Ok(Outcome { experiments: check_all(CLAIMS, &measured), figures, notes })
}
