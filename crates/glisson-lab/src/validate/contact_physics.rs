//! Contact by constraints: friction on an incline, stacks at rest, energy of a bounce.
//!
//! Blocks of 10 cm, ln J neo-Hookean with E = 20 kPa, nu = 0.45, 1000 kg/m3, under 1 g; phantom livers of 5 kPa under 0.2 g.
//! What needs a minute of simulated time is coarse (320 and 1,080 tetrahedra a block, 600 a liver); the acceleration is
//! measured on a block of 5,000 tetrahedra as well. Two livers of 6,300 tetrahedra are a group of their own, which is slow.

use super::{Experiment, Figure, Outcome};
use crate::bodies::liver;
use glisson::contact::bodies::{BodyParams, CollidingBodies, ContactParams, Obstacle};
use glisson::contact::broad_phase::BroadPhaseKind;
use glisson::contact::self_collision::{PairSearch, PairSearchParams};
use glisson::material::{LinearElastic, Material, NeoHookeLog};
use glisson::math::{DMat3, DVec3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::mesh::{TetId, TetMesh};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{DeformableModel, DynamicBody, Rayleigh};
use glisson_report::plot::{LinePlot, Series, SeriesStyle};
use std::fmt::Write as _;

const OWN: &str = "requirement";

const SIDE_M: f64 = 0.1;
const DENSITY_KG_PER_M3: f64 = 1000.0;
const BLOCK_PA: f64 = 20e3;
const LIVER_PA: f64 = 5e3;
const POISSON_RATIO: f64 = 0.45;
const G: f64 = 9.81;
const FRICTION: f64 = 0.5;
/// Time in which gravity comes on [s].
const RAMP_S: f64 = 2.0;
const MINUTE_S: f64 = 60.0;
/// Damping of the stiffness [s]: some per cent of the critical one for the slowest vibration of a block.
const STIFFNESS_DAMPING_S: f64 = 2e-4;
/// Where bodies begin: a hair above the distance that they keep.
const LIFT_M: f64 = 1.01e-4;
/// Step of the implicit bodies [s].
const IMPLICIT_STEP_S: f64 = 5e-3;
/// Mass damping of the livers, and one that leaves them to rock for longer [1/s]: choices.
const LIVER_DAMPING_PER_S: f64 = 2.0;
const LITTLE_DAMPING_PER_S: f64 = 0.5;

const TABLE: &str = "| scene | tetrahedra a body | step [ms] | steps | sweeps a step | contacts | deepest penetration [mm] |\n|---|---|---|---|---|---|---|\n";

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome { notes: String::from(TABLE), ..Outcome::default() };
    incline(&mut outcome)?;
    blocks(&mut outcome)?;
    livers(&mut outcome)?;
    bounce(&mut outcome)?;
    Ok(outcome)
}

/// Two livers at full size: some minutes.
pub(super) fn full_size_experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome { notes: String::from(TABLE), ..Outcome::default() };
    let on_top = Pair {
        name: "two livers of 6,300 tetrahedra, one on top",
        n_tets: 6_300,
        offset_m: DVec3::new(0.0, 0.0, 0.12),
        drops: true,
        settling_s: 15.0,
        damping_per_s: LIVER_DAMPING_PER_S,
        // It rolls off the other's dome until it leans on the support as well.
        share_of_weight: [0.02, 1.02],
    };
    pair_of_livers(&on_top, &mut outcome)?;
    Ok(outcome)
}

/// Bodies with their meshes.
struct Scene {
    name: String,
    meshes: Vec<TetMesh>,
    world: CollidingBodies,
    step_s: f64,
    n_steps: u64,
    n_sweeps: u64,
    penetration_m: f64,
}

/// What a body is made of.
#[derive(Clone, Copy)]
struct Matter {
    young_modulus_pa: f64,
    damping: Rayleigh,
    is_implicit: bool,
}

const BLOCK: Matter = Matter {
    young_modulus_pa: BLOCK_PA,
    damping: Rayleigh { mass_per_s: 0.0, stiffness_s: STIFFNESS_DAMPING_S },
    is_implicit: false,
};

impl Matter {
    fn material(self) -> anyhow::Result<LinearElastic> {
        Ok(LinearElastic::from_young_poisson(self.young_modulus_pa, POISSON_RATIO, DENSITY_KG_PER_M3)?)
    }

    /// The model and the longest step [s] that it makes at once.
    fn model(self, mesh: &TetMesh) -> anyhow::Result<(Box<dyn DeformableModel>, f64)> {
        let body = DynamicBody { damping: self.damping, ..DynamicBody::new(mesh, DENSITY_KG_PER_M3) };
        if self.is_implicit {
            let law = ImplicitLaw::neo_hooke(&self.material()?);
            let body = DynamicBody { time_step_s: IMPLICIT_STEP_S, ..body };
            let model = ImplicitEuler::build(&ImplicitParams::new(body, &law))?;
            return Ok((Box::new(model), IMPLICIT_STEP_S));
        }
        let materials = [self.material()?];
        let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, &materials);
        let step_s = 0.9 * ExplicitKernel::stable_step(&params)?.step_s;
        let body = DynamicBody { time_step_s: step_s, ..body };
        let model = ExplicitKernel::build(&ExplicitKernelParams { body, ..params })?;
        Ok((Box::new(model), step_s))
    }
}

impl Scene {
    /// `parts`: steps of the explicit models for one of contact.
    fn new(
        name: &str,
        meshes: Vec<TetMesh>,
        matter: Matter,
        friction: f64,
        parts: f64,
    ) -> anyhow::Result<Self> {
        let mut step_s = f64::INFINITY;
        let mut bodies = Vec::new();
        for mesh in &meshes {
            let (model, longest_s) = matter.model(mesh)?;
            step_s = step_s.min(longest_s);
            let (surface, nodes) = surface_of(&Topology::build(mesh)?, mesh);
            bodies.push(BodyParams { model, surface, nodes, friction });
        }
        let support = vec![Obstacle::half_space(DVec3::ZERO, DVec3::Z, friction)];
        let world = CollidingBodies::new(bodies, support, &ContactParams::default())?;
        let step_s = if matter.is_implicit { step_s } else { parts * step_s };
        let name = name.to_string();
        Ok(Self { name, meshes, world, step_s, n_steps: 0, n_sweeps: 0, penetration_m: 0.0 })
    }

    fn step(&mut self) {
        self.world.step(self.step_s);
        let report = self.world.report();
        self.n_steps += 1;
        self.n_sweeps += u64::from(report.n_sweeps);
        self.penetration_m = self.penetration_m.max(report.penetration_m);
    }

    fn run(&mut self, time_s: f64) {
        for _ in 0..(time_s / self.step_s).round() as usize {
            self.step();
        }
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        for body in 0..self.world.n_bodies() {
            self.world.model_mut(body).set_gravity(gravity_m_per_s2);
        }
    }

    /// Gravity comes on smoothly.
    fn load(&mut self, gravity_m_per_s2: DVec3) {
        let n = (RAMP_S / self.step_s).ceil() as usize;
        for i in 1..=n {
            let s = i as f64 / n as f64;
            self.set_gravity(gravity_m_per_s2 * (s * s * (3.0 - 2.0 * s)));
            self.step();
        }
    }

    fn mass_kg(&self, body: usize) -> f64 {
        DENSITY_KG_PER_M3 * self.meshes[body].volume_m3()
    }

    /// Mean over the body's mass of a value of its nodes.
    fn mean(&self, body: usize, of_node: impl Fn(usize) -> DVec3) -> DVec3 {
        let mesh = &self.meshes[body];
        let of_tet = |(t, nodes): (usize, &[glisson::mesh::NodeId; 4])| {
            nodes.iter().map(|n| of_node(n.index())).sum::<DVec3>()
                * (0.25 * mesh.tet_volume_m3(TetId::from_index(t)))
        };
        mesh.tetrahedra.iter().enumerate().map(of_tet).sum::<DVec3>() / mesh.volume_m3()
    }

    fn center_m(&self, body: usize) -> DVec3 {
        self.mean(body, |n| self.world.model(body).state().positions_m[n])
    }

    fn velocity_m_per_s(&self, body: usize) -> DVec3 {
        self.mean(body, |n| self.world.model(body).state().velocities_m_per_s[n])
    }

    /// Centres over the next `time_s`, averaged, which takes the last small vibrations out.
    fn mean_centers_m(&mut self, time_s: f64) -> Vec<DVec3> {
        let n = (time_s / self.step_s).round() as usize;
        let mut sums = vec![DVec3::ZERO; self.world.n_bodies()];
        for _ in 0..n {
            self.step();
            for (body, sum) in sums.iter_mut().enumerate() {
                *sum += self.center_m(body) / n as f64;
            }
        }
        sums
    }

    /// How far centres go in a minute, from one window of `window_s` to the next [m]: the most of all bodies.
    fn drift_in_a_minute_m(&mut self, window_s: f64) -> f64 {
        let before_m = self.mean_centers_m(window_s);
        self.run(MINUTE_S - window_s);
        let after_m = self.mean_centers_m(window_s);
        before_m.iter().zip(&after_m).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    }

    /// Pairs of triangles of different bodies that meet now: another measure of penetration.
    fn n_meeting(&self) -> anyhow::Result<usize> {
        let (mut positions_m, mut triangles, mut body_of) = (Vec::new(), Vec::new(), Vec::new());
        for (body, mesh) in self.meshes.iter().enumerate() {
            let (surface, nodes) = surface_of(&Topology::build(mesh)?, mesh);
            let first = positions_m.len() as u32;
            let now_m = self.world.model(body).state().positions_m;
            positions_m.extend(nodes.iter().map(|n| now_m[n.index()]));
            triangles.extend(surface.triangles.iter().map(|t| t.map(|v| v + first)));
            body_of.resize(triangles.len(), body as u32);
        }
        let params = PairSearchParams {
            kind: BroadPhaseKind::Hierarchy,
            self_collision: false,
            margin_m: 0.0,
            pair_capacity: 1 << 16,
        };
        let mut search = PairSearch::new(&params, &positions_m, &triangles, &body_of);
        search.update(&positions_m);
        let mut found = Vec::with_capacity(1 << 16);
        search.meeting_into(&mut found);
        Ok(found.len())
    }

    fn note(&self, outcome: &mut Outcome) {
        let report = self.world.report();
        let of_meshes: Vec<String> = self.meshes.iter().map(|m| m.tetrahedra.len().to_string()).collect();
        let _ = writeln!(
            outcome.notes,
            "| {} | {} | {:.3} | {} | {:.1} | {} | {:.3} |",
            self.name,
            of_meshes.join(" and "),
            self.step_s * 1e3,
            self.n_steps,
            self.n_sweeps as f64 / self.n_steps as f64,
            report.n_contacts,
            self.penetration_m * 1e3,
        );
    }
}

fn block(cells: usize, corner_m: DVec3) -> TetMesh {
    let mut mesh = box_of_five([cells; 3], DVec3::splat(SIDE_M));
    mesh.positions_m.iter_mut().for_each(|p| *p += corner_m);
    mesh
}

/// Gravity in the frame of a support that is tilted by `tilt_rad`.
fn gravity(tilt_rad: f64) -> DVec3 {
    DVec3::new(tilt_rad.sin(), 0.0, -tilt_rad.cos()) * G
}

/// A block on an incline, below and above the angle of friction.
fn incline(outcome: &mut Outcome) -> anyhow::Result<()> {
    let sticking = (0.98 * FRICTION).atan();
    for (cells, matter, kind) in
        [(6, BLOCK, "explicit"), (4, Matter { is_implicit: true, ..BLOCK }, "implicit")]
    {
        let mesh = block(cells, DVec3::Z * LIFT_M);
        let name = format!("incline, sticks, {kind}");
        let mut scene = Scene::new(&name, vec![mesh], matter, FRICTION, 2.0)?;
        scene.load(gravity(sticking));
        // The vibrations of the ramp are part of the first seconds.
        scene.run(1.0);
        let creep_m = scene.drift_in_a_minute_m(1.0);
        scene.note(outcome);
        outcome.experiments.push(Experiment::at_most(
            &format!("incline at 0.98 of the angle of friction, {kind}: creep in 60 s [mm]"),
            OWN,
            creep_m * 1e3,
            0.1,
        ));
    }
    let sliding = (1.02 * FRICTION).atan();
    let expected = G * (sliding.sin() - FRICTION * sliding.cos());
    let implicit = Matter { is_implicit: true, ..BLOCK };
    for (cells, matter, kind) in [(10, BLOCK, "explicit"), (4, implicit, "implicit")] {
        let name = format!("incline, slides, {kind}");
        let mut scene = Scene::new(&name, vec![block(cells, DVec3::Z * LIFT_M)], matter, FRICTION, 2.0)?;
        scene.load(gravity(sliding));
        scene.run(0.5);
        let speed = |scene: &mut Scene| {
            let n = (0.5 / scene.step_s).round() as usize;
            let mut sum = 0.0;
            for _ in 0..n {
                scene.step();
                sum += scene.velocity_m_per_s(0).x / n as f64;
            }
            sum
        };
        let (before, after) = (speed(&mut scene), speed(&mut scene));
        let apart_s = (0.5 / scene.step_s).round() * scene.step_s;
        scene.note(outcome);
        outcome.experiments.push(Experiment::near(
            &format!(
                "incline at 1.02 of it, {kind}, {} tetrahedra: acceleration [m/s2]",
                scene.meshes[0].tetrahedra.len()
            ),
            "g (sin a - mu cos a)",
            (after - before) / apart_s,
            expected,
            0.05,
        ));
    }
    Ok(())
}

/// Two blocks, one on the other.
fn blocks(outcome: &mut Outcome) -> anyhow::Result<()> {
    let stack =
        |cells: usize| [0.0, 1.0].map(|b| block(cells, DVec3::Z * (LIFT_M + b * (SIDE_M + LIFT_M)))).to_vec();
    for (cells, time_s) in [(4, MINUTE_S), (10, 3.5)] {
        let mut scene = Scene::new("stacked blocks", stack(cells), BLOCK, FRICTION, 2.0)?;
        let n_tets = scene.meshes[0].tetrahedra.len();
        scene.load(gravity(0.0));
        scene.run(0.5);
        if time_s == MINUTE_S {
            let drift_m = scene.drift_in_a_minute_m(1.0);
            outcome.experiments.push(Experiment::at_most(
                "stacked blocks: drift in 60 s [mm]",
                OWN,
                drift_m * 1e3,
                0.1,
            ));
        } else {
            scene.run(time_s - RAMP_S - 0.5);
        }
        scene.note(outcome);
        outcome.experiments.push(Experiment::at_most(
            &format!("stacked blocks of {n_tets} tetrahedra: deepest penetration [mm]"),
            OWN,
            scene.penetration_m * 1e3,
            0.5,
        ));
        outcome.experiments.push(Experiment::at_most(
            &format!("stacked blocks of {n_tets} tetrahedra: pairs of triangles that meet"),
            "exact triangle test",
            scene.n_meeting()? as f64,
            0.0,
        ));
        let mut on_support_n = 0.0;
        let n = (0.5 / scene.step_s).round() as usize;
        for _ in 0..n {
            scene.step();
            on_support_n -= scene.world.force_on_n(2).z / n as f64;
        }
        outcome.experiments.push(Experiment::near(
            &format!("stacked blocks of {n_tets} tetrahedra: force on the support [N]"),
            "weight",
            on_support_n,
            2.0 * scene.mass_kg(0) * G,
            0.01,
        ));
    }
    Ok(())
}

/// One phantom liver flat on the support, another that leans on it or lies on top.
struct Pair {
    name: &'static str,
    n_tets: usize,
    /// Where the second one begins [m].
    offset_m: DVec3,
    /// Whether it begins lower, as low as it touches nothing.
    drops: bool,
    /// Before the drift counts [s].
    settling_s: f64,
    /// Mass damping [1/s].
    damping_per_s: f64,
    /// Of the force between them.
    share_of_weight: [f64; 2],
}

/// The one on top rocks on the other before it lies still: slowly, because the mass damping is more than that motion's
/// critical one.
fn livers(outcome: &mut Outcome) -> anyhow::Result<()> {
    let leaning = Pair {
        name: "two livers, one leaning",
        n_tets: 600,
        offset_m: DVec3::new(0.0, 0.14, 0.05),
        drops: false,
        settling_s: 8.0,
        damping_per_s: LIVER_DAMPING_PER_S,
        share_of_weight: [0.02, 1.0],
    };
    let on_top = Pair {
        name: "two livers, one on top",
        offset_m: DVec3::new(0.0, 0.0, 0.086),
        settling_s: 15.0,
        share_of_weight: [0.98, 1.02],
        ..leaning
    };
    let little_damping = Pair {
        name: "two livers, one leaning, mass damping 0.5 instead of 2 1/s",
        settling_s: 15.0,
        damping_per_s: LITTLE_DAMPING_PER_S,
        ..leaning
    };
    for pair in [&leaning, &on_top, &little_damping] {
        pair_of_livers(pair, outcome)?;
    }
    Ok(())
}

impl Pair {
    /// Both livers, the second one at `offset_m` from the first.
    fn at(&self, liver: &TetMesh, offset_m: DVec3) -> anyhow::Result<Scene> {
        let low_m = liver.positions_m.iter().fold(DVec3::INFINITY, |a, b| a.min(*b));
        let high_m = liver.positions_m.iter().fold(DVec3::NEG_INFINITY, |a, b| a.max(*b));
        // On its back: its longest sides lie down.
        let placed = |offset_m: DVec3| {
            let mut mesh = liver.clone();
            for p in &mut mesh.positions_m {
                *p = DVec3::new(p.x - low_m.x, high_m.z - p.z, p.y - low_m.y + LIFT_M) + offset_m;
            }
            mesh
        };
        let matter = Matter {
            young_modulus_pa: LIVER_PA,
            damping: Rayleigh { mass_per_s: self.damping_per_s, stiffness_s: STIFFNESS_DAMPING_S },
            is_implicit: false,
        };
        Scene::new(self.name, vec![placed(DVec3::ZERO), placed(offset_m)], matter, FRICTION, 2.0)
    }

    /// Both livers where they begin.
    fn scene(&self) -> anyhow::Result<Scene> {
        let liver = liver(self.n_tets)?;
        if !self.drops {
            return self.at(&liver, self.offset_m);
        }
        // By millimetres down to the first that meets the other, and one back.
        let mut offset_m = self.offset_m;
        while self.at(&liver, offset_m - DVec3::Z * 1e-3)?.n_meeting()? == 0 {
            offset_m.z -= 1e-3;
        }
        self.at(&liver, offset_m)
    }
}

fn pair_of_livers(pair: &Pair, outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut scene = pair.scene()?;
    scene.load(DVec3::Z * -0.2 * G);
    scene.run(pair.settling_s);
    let drift_m = scene.drift_in_a_minute_m(0.5);
    scene.note(outcome);
    let between_n: DVec3 = scene
        .world
        .contacts()
        .filter(|c| c.partners.iter().all(|p| *p < 2))
        .map(|c| if c.partners[0] == 1 { c.force_n } else { -c.force_n })
        .sum();
    let weight_n = scene.mass_kg(1) * 0.2 * G;
    let n_meeting = scene.n_meeting()?;
    let name = pair.name;
    // Within the penetration that is allowed, surfaces may cross; told, and no requirement.
    outcome.notes += &format!("\n{name}: {n_meeting} pairs of triangles meet at the end.\n");
    let meeting = name.contains("leaning").then_some(("pairs of triangles that meet", n_meeting as f64, 0.0));
    let penetration_mm = scene.penetration_m * 1e3;
    let limits = [("drift in 60 s [mm]", drift_m * 1e3, 0.1)].into_iter().chain(meeting).chain([(
        "deepest penetration, the fall included [mm]",
        penetration_mm,
        0.5,
    )]);
    let ranges = [
        ("what carries the second one over its weight", scene.world.force_on_n(1).z / weight_n, [0.98, 1.02]),
        ("force between them over the weight of one", between_n.length() / weight_n, pair.share_of_weight),
    ];
    let of_scene = |what: &str| format!("{name}: {what}");
    outcome
        .experiments
        .extend(limits.map(|(what, found, limit)| Experiment::at_most(&of_scene(what), OWN, found, limit)));
    outcome
        .experiments
        .extend(ranges.map(|(what, found, range)| Experiment::within(&of_scene(what), OWN, found, range)));
    Ok(())
}

/// Energy of deformation and weight [J].
fn potential_j(mesh: &TetMesh, law: &NeoHookeLog, positions_m: &[DVec3]) -> f64 {
    let mut energy_j = 0.0;
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let sides = |list: &[DVec3]| {
            let x = nodes.map(|n| list[n.index()]);
            (DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0]), 0.25 * (x[0] + x[1] + x[2] + x[3]).z)
        };
        let ((now, height_m), (rest, _)) = (sides(positions_m), sides(&mesh.positions_m));
        let density = law.energy_density_j_per_m3(&(now * rest.inverse()));
        energy_j += (density + DENSITY_KG_PER_M3 * G * height_m) * mesh.tet_volume_m3(TetId::from_index(t));
    }
    energy_j
}

/// A block that falls 2 cm onto a support without friction, undamped.
fn bounce(outcome: &mut Outcome) -> anyhow::Result<()> {
    const DROP_M: f64 = 0.02;
    let mut series = Vec::new();
    for (is_implicit, name) in [(false, "explicit"), (true, "implicit")] {
        let matter = Matter { damping: Rayleigh::default(), is_implicit, ..BLOCK };
        let law = NeoHookeLog::from(&matter.material()?);
        let mesh = block(4, DVec3::Z * (LIFT_M + DROP_M));
        let mut scene = Scene::new(&format!("bounce, {name}"), vec![mesh.clone()], matter, 0.0, 1.0)?;
        scene.set_gravity(gravity(0.0));
        let potential = |scene: &Scene| potential_j(&mesh, &law, scene.world.model(0).state().positions_m);
        let start_j = potential(&scene);
        let fall_j = scene.mass_kg(0) * G * DROP_M;
        let (mut earlier_j, mut least_j, mut growth_j) = (start_j, start_j, 0.0_f64);
        let mut points = Vec::new();
        for i in 0..(1.5 / scene.step_s) as usize {
            scene.step();
            let now_j = potential(&scene);
            // Velocities of central differences are those of half a step ago.
            let between_j = if is_implicit { now_j } else { 0.5 * (now_j + earlier_j) };
            earlier_j = now_j;
            let energy_j = between_j + scene.world.model(0).report().kinetic_energy_j;
            growth_j = growth_j.max(energy_j - least_j);
            least_j = least_j.min(energy_j);
            points.push([i as f64 * scene.step_s, (energy_j - start_j) / fall_j]);
        }
        scene.note(outcome);
        outcome.experiments.push(Experiment::at_most(
            &format!("bounce without friction, {name}: growth of the energy over that of the fall"),
            OWN,
            growth_j / fall_j,
            0.01,
        ));
        series.push(Series { name: name.into(), points, style: SeriesStyle::Line });
    }
    outcome.figures.push(Figure {
        file: "contact_physics_bounce.svg",
        caption: "Energy of an undamped block that falls 2 cm onto a support without friction: impacts take some, none comes back."
            .into(),
        plot: LinePlot {
            title: "A bounce".into(),
            x_label: "time [s]".into(),
            y_label: "energy beyond that at the start, over that of the fall".into(),
            series,
            size: [960, 540],
        },
    });
    Ok(())
}
