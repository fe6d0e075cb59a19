//! An organ that touches itself in a scene: two lobes driven together, and a piece that is cut loose and falls on the rest, with
//! the scene's key `[contact] self` and without.

use super::{Experiment, Outcome};
use crate::bench::thread_cpu_ns;
use glisson::contact::crossing;
use glisson::contact::response::self_contact::{SelfContactParams, SelfContactResponse};
use glisson::material::LinearElastic;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::box_mesh::cells_of_five;
use glisson::mesh::edit::MeshEdit;
use glisson::mesh::{TetId, TetMesh};
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{Load, LoadTime, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};
use std::fmt::Write as _;

const OWN: &str = "requirement";
const CELL_M: f64 = 8e-3;
const MOST_CROSSING_M: f64 = 0.5e-3;
const FRICTION: f64 = 0.2;
const STIFFNESS_N_PER_M: f64 = 100.0;

struct Setting {
    kind: ModelKind,
    time_step_s: f64,
    name: &'static str,
    response: Option<SelfContactResponse>,
}

fn settings() -> Vec<Setting> {
    let mut all = Vec::new();
    for (kind, time_step_s) in
        [(ModelKind::TensorMass, 5e-4), (ModelKind::Explicit, 5e-4), (ModelKind::Implicit, 2e-3)]
    {
        for (name, response) in [
            ("none", None),
            ("geometric", Some(SelfContactParams::geometric(FRICTION))),
            ("penalty", Some(SelfContactParams::penalty(STIFFNESS_N_PER_M, FRICTION))),
        ] {
            all.push(Setting { kind, time_step_s, name, response });
        }
    }
    all
}

/// The parts of a body, by the place at rest.
type Part = dyn Fn(DVec3) -> Option<bool>;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    lobes(&mut outcome)?;
    falling_piece(&mut outcome)?;
    Ok(outcome)
}

fn world(
    setting: &Setting,
    mesh: TetMesh,
    gravity_m_per_s2: DVec3,
    loads: Vec<Load>,
) -> anyhow::Result<World> {
    let home = ToolInput::at(DVec3::splat(1.0), DVec3::Z);
    let mut spec = WorldSpec::new("folds", setting.time_step_s, Tool::probe("ball", 5e-3, home));
    let bottom = Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, 1e-6) };
    spec.supports = vec![Support::all_axes(Region::Box(bottom))];
    spec.gravity_m_per_s2 = gravity_m_per_s2;
    spec.loads = loads;
    spec.self_contact = setting.response.map(|response| SelfContactParams {
        margin_m: SelfContactParams::default_margin_m(setting.time_step_s),
        response,
    });
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0)?;
    let mut body = OrganBody::new(mesh, material, setting.time_step_s);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 10.0, stiffness_s: 0.0 };
    body.gravity_m_per_s2 = gravity_m_per_s2;
    body.is_imaged_under_gravity = false;
    let model = build_model(&body, setting.kind)?;
    Ok(World::new(spec, body.mesh, model, setting.kind)?)
}

/// Deepest node of one part inside the tetrahedra of the other [m], either way.
fn crossing_m(world: &World, part: &Part) -> f64 {
    let organ = world.organ();
    crossing::crossing_m(organ.mesh(), organ.live_tetrahedra(), world.state().positions_m, part)
}

/// What a run gave.
struct Run {
    crossing_m: f64,
    n_contacts: u32,
    step_ms: f64,
}

fn run(world: &mut World, setting: &Setting, time_s: f64, part: &Part) -> Run {
    let idle = StepInput::of(&[world.tools()[0].home]);
    let looks = (0.01 / setting.time_step_s).round() as usize;
    let n_steps = (time_s / setting.time_step_s).round() as usize;
    let mut found = Run { crossing_m: 0.0, n_contacts: 0, step_ms: 0.0 };
    for step in 0..n_steps {
        let start_ns = thread_cpu_ns();
        let report = world.step(&idle);
        found.step_ms += 1e-6 * (thread_cpu_ns() - start_ns) as f64 / n_steps as f64;
        found.n_contacts = found.n_contacts.max(report.self_contact.n_contacts);
        if step % looks == 0 {
            found.crossing_m = found.crossing_m.max(crossing_m(world, part));
        }
    }
    found
}

fn lobes(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut notes = String::from(
        "### Two lobes driven together\n\nLobes of 24 mm with a slot of 8 mm between them (5 kPa, 8 mm edges), pressed together by 0.05 N each \
         from one moment on, for 0.3 s. Crossing: the deepest node of one inside the other on the way.\n\n\
         | model | step [ms] | response | crossing [mm] | contacts at most | processor time of a step [ms] |\n|---|---|---|---|---|---|\n",
    );
    let part = |rest_m: DVec3| {
        let place = rest_m / CELL_M;
        (place.z > 1.1 && !(3.1..3.9).contains(&place.x)).then_some(place.x > 3.5)
    };
    for setting in settings() {
        let mesh = cells_of_five([7, 2, 6], CELL_M, |[x, _, z]| x != 3 || z == 0);
        let press = |from: f64, to: f64, force_n: f64| Load {
            region: Region::Box(Aabb {
                min_m: DVec3::new(from, -0.1, 2.9) * CELL_M,
                max_m: DVec3::new(to, 10.0, 10.0) * CELL_M,
            }),
            force_n: DVec3::new(force_n, 0.0, 0.0),
            time: LoadTime::Always,
        };
        let loads = vec![press(-0.1, 0.1, 0.05), press(6.9, 7.1, -0.05)];
        let mut world = world(&setting, mesh, DVec3::ZERO, loads)?;
        let found = run(&mut world, &setting, 0.3, &part);
        let Setting { kind, time_step_s, name, response } = &setting;
        writeln!(
            notes,
            "| {kind} | {} | {name} | {:.3} | {} | {:.3} |",
            1e3 * time_step_s,
            1e3 * found.crossing_m,
            found.n_contacts,
            found.step_ms
        )?;
        let what = format!("lobes, {kind}, {name}: crossing [m]");
        outcome.experiments.push(match response {
            // Shows that without contact there is something to prevent.
            None => Experiment::within(&what, OWN, found.crossing_m, [4e-3, 0.1]),
            Some(_) => Experiment::at_most(&what, OWN, found.crossing_m, MOST_CROSSING_M),
        });
    }
    outcome.notes += &notes;
    Ok(())
}

fn falling_piece(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut notes = String::from(
        "\n### A piece cut loose\n\nA block of 24 mm on one of 56 mm; the layer of 3.2 mm between them is taken out. After 0.5 s: how far the piece came \
         down (the gap, and what both sag), how far it went aside, and the deepest crossing on the way.\n\n\
         | model | response | down [mm] | aside [mm] | crossing [mm] | contacts at most | processor time of a step [ms] |\n|---|---|---|---|---|---|---|\n",
    );
    let part = |rest_m: DVec3| Some(rest_m.z > 3.2 * CELL_M);
    for setting in settings().into_iter().filter(|s| s.kind != ModelKind::TensorMass) {
        // Springs act a step late: the piece comes down at 0.25 m/s.
        let setting = Setting { time_step_s: setting.time_step_s.min(1e-3), ..setting };
        let is_middle = |x: usize| (2..5).contains(&x);
        let mut mesh = cells_of_five([7, 7, 5], CELL_M, |[x, y, z]| z < 3 || is_middle(x) && is_middle(y));
        for p in mesh.positions_m.iter_mut().filter(|p| p.z > 3.5 * CELL_M) {
            p.z -= 0.6 * CELL_M;
        }
        let height_m = |t: usize| {
            mesh.tetrahedra[t].iter().map(|n| mesh.positions_m[n.index()].z).sum::<f64>() / (4.0 * CELL_M)
        };
        let tets = (0..mesh.tetrahedra.len()).filter(|t| height_m(*t) > 3.0 && height_m(*t) < 3.4);
        let tets = tets.map(TetId::from_index).collect();
        let mut world = world(&setting, mesh, DVec3::new(0.0, 0.0, -9.81), Vec::new())?;
        world.edit(&MeshEdit::Remove { tets })?;
        let found = run(&mut world, &setting, 0.5, &part);
        let (rest_m, now_m) = (&world.organ().mesh().positions_m, world.state().positions_m);
        let nodes: Vec<usize> = (0..rest_m.len()).filter(|n| part(rest_m[*n]) == Some(true)).collect();
        let moved_m = nodes.iter().map(|&n| now_m[n] - rest_m[n]).sum::<DVec3>() / nodes.len() as f64;
        let Setting { kind, name, response, .. } = &setting;
        writeln!(
            notes,
            "| {kind} | {name} | {:.2} | {:.3} | {:.3} | {} | {:.3} |",
            -1e3 * moved_m.z,
            1e3 * moved_m.truncate().length(),
            1e3 * found.crossing_m,
            found.n_contacts,
            found.step_ms
        )?;
        let what = format!("piece, {kind}, {name}: way down [m]");
        let range_m = if response.is_some() { [3.2e-3, 4.5e-3] } else { [0.1, 10.0] };
        outcome.experiments.push(Experiment::within(&what, OWN, -moved_m.z, range_m));
        if response.is_some() {
            let what = format!("piece, {kind}, {name}: crossing [m]");
            outcome.experiments.push(Experiment::at_most(&what, OWN, found.crossing_m, MOST_CROSSING_M));
        }
    }
    outcome.notes += &notes;
    Ok(())
}
