//! A ball that slides over tissue: the forces along the surface over those across it are the coefficient of friction.
//!
//! A ball of a hand that gives way is pressed in at a place, drawn along the undeformed skin at a steady speed, drawn back, and
//! lifted where it went in. Read over the second half of its way: of all its contact points the forces across their normals over
//! those along them. Coulomb's law holds at every point that slides, so their sums keep it too, on every shape. And over the whole
//! motion, a closed path that begins and ends away from tissue at rest, the hand takes no work out of the tissue.

use super::blocks::{SIZE_M, block};
use super::press::ReadyOrgan;
use super::selection::Selection;
use super::skin::Skin;
use crate::bodies::{filled, liver_surface};
use crate::validate::{Experiment, Outcome};
use anyhow::Context;
use glisson::image::phantom::PhantomParams;
use glisson::material::LinearElastic;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::TetMesh;
use glisson::record::snapshot::{ContactPoints, Snapshot};
use glisson::tool::{Grip, Tool, ToolInput};
use glisson::world::spec::Region;
use glisson::world::{StepInput, World};

const REQUIREMENT: &str = "requirement; Coulomb's law of friction";
const COEFFICIENTS: [f64; 4] = [0.0, 0.05, 0.3, 0.6];
/// How far the ratio may be from the coefficient: a share of it.
const WITHIN: f64 = 0.03;
/// Frictionless: the ratio at most.
const FRICTIONLESS: f64 = 1e-9;
/// What the hand may take out of the tissue, as a share of the work of pressing the ball in: the steps' own error. A choice.
const GAINED: f64 = 0.01;
/// The ball goes down, along and up so fast [m/s]: slow beside shear waves in the tissue. A choice.
const SPEED_M_PER_S: f64 = 0.02;
/// Where it begins above the skin, and how far it goes along [m].
const ABOVE_M: f64 = 2e-3;
const WAY_M: f64 = 0.03;
/// After the ball has left, the tissue has so long to come to rest [s].
const REST_S: f64 = 0.5;
const SIZE: usize = 6_300;

/// What is slid on, and how deep.
struct Ground {
    name: &'static str,
    mesh: TetMesh,
    material: LinearElastic,
    held: Region,
    /// Start of the way, outside; unit vectors into the tissue and along the way.
    from_m: DVec3,
    inwards: DVec3,
    along: DVec3,
    ball_m: f64,
    depth_m: f64,
}

impl Ground {
    /// Flat tissue that gives way little, and the same deeply pressed.
    fn of_block(name: &'static str, n_tets: usize, ball_m: f64, depth_m: f64) -> anyhow::Result<Self> {
        Ok(Self {
            name,
            mesh: block(n_tets)?,
            material: Tissue::by_name("liver")?.linear_elastic()?,
            held: Region::Box(Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, 1e-6) }),
            from_m: DVec3::new(0.5 * (SIZE_M.x - WAY_M), 0.5 * SIZE_M.y + 1.3e-3, 2.0 * SIZE_M.z),
            inwards: DVec3::NEG_Z,
            along: DVec3::new(1.0, 0.17, 0.0).normalize(),
            ball_m,
            depth_m,
        })
    }

    /// A synthetic patient's liver, from its front.
    fn of_liver(name: &'static str, n_tets: usize, seed: u64) -> anyhow::Result<Self> {
        let surface = liver_surface(&PhantomParams { seed, ..PhantomParams::default() })?;
        let bounds_m = Aabb::of_points(&surface.0.positions_m);
        let mut held_m = bounds_m;
        held_m.min_m.y = bounds_m.max_m.y - 0.15 * (bounds_m.max_m.y - bounds_m.min_m.y);
        let middle_m = 0.5 * (bounds_m.min_m + bounds_m.max_m);
        Ok(Self {
            name,
            mesh: filled(&surface, n_tets)?,
            material: Tissue::by_name("liver")?.linear_elastic()?,
            held: Region::Box(held_m),
            from_m: DVec3::new(middle_m.x - 0.5 * WAY_M, bounds_m.min_m.y - 0.1, middle_m.z),
            inwards: DVec3::Y,
            along: DVec3::new(1.0, 0.0, 0.21).normalize(),
            ball_m: 5e-3,
            depth_m: 3e-3,
        })
    }

    fn all(n_tets: usize) -> anyhow::Result<[Self; 3]> {
        Ok([
            Self::of_block("flat", n_tets, 5e-3, 2e-3)?,
            Self::of_liver("curved", n_tets, 51)?,
            Self::of_block("deforming", n_tets, 10e-3, 10e-3)?,
        ])
    }
}

/// What was felt on a way.
#[derive(Clone, Copy, Debug)]
struct Slid {
    /// Of all points: forces across normals over those along them.
    ratio: f64,
    /// Mean force on the ball against its way, and out of the tissue [N].
    against_n: f64,
    out_n: f64,
    /// Work of the hand until the ball is pressed in, and over the whole motion [J].
    press_j: f64,
    work_j: f64,
}

impl Slid {
    /// What the hand took out of the tissue, as a share of the work of pressing in.
    fn gained(&self) -> f64 {
        let gained = -self.work_j / self.press_j;
        // No work of pressing in is no measure, and what is no number is no pass.
        if self.press_j > 0.0 && gained.is_finite() { gained.max(0.0) } else { f64::INFINITY }
    }
}

/// What is read on the way.
struct Reading {
    snapshot: Snapshot,
    points: ContactPoints,
    n: usize,
    across_n: f64,
    normal_n: f64,
    against_n: f64,
    out_n: f64,
    work_j: f64,
    tip_m: DVec3,
}

impl Reading {
    fn of(world: &World, tip_m: DVec3) -> Self {
        let (snapshot, points) = (world.snapshot(), ContactPoints::default());
        let [across_n, normal_n, against_n, out_n, work_j] = [0.0; 5];
        Self { snapshot, points, n: 0, across_n, normal_n, against_n, out_n, work_j, tip_m }
    }

    /// Makes a step, and reads its forces where it is a steady one.
    fn step(&mut self, world: &mut World, input: &StepInput, steady_on: Option<&Ground>) {
        let force_n = world.step(input).tools[0].force_on_tool_n;
        world.snapshot_into(&mut self.snapshot);
        let tip_m = self.snapshot.tools[0].pose.tip_in_world_m;
        self.work_j -= force_n.dot(tip_m - self.tip_m);
        self.tip_m = tip_m;
        let Some(ground) = steady_on else { return };
        world.contact_points_into(&mut self.points);
        for point in &self.points.points {
            let normal_n = point.force_n.dot(point.normal);
            self.normal_n += normal_n.abs();
            self.across_n += (point.force_n - point.normal * normal_n).length();
        }
        self.n += 1;
        self.against_n -= force_n.dot(ground.along);
        self.out_n -= force_n.dot(ground.inwards);
    }
}

/// Draws a ball with a coefficient of friction over a ground.
fn slide(ground: &Ground, organ: &ReadyOrgan, skin: &Skin, friction: f64) -> anyhow::Result<Slid> {
    let Ground { inwards, along, ball_m, .. } = *ground;
    let centre_m = |way_m: f64, depth_m: f64| -> anyhow::Result<DVec3> {
        let from_m = ground.from_m + along * way_m;
        let skin_m = skin.first_m(from_m, inwards).context("the way leaves the tissue")?;
        Ok(skin_m + inwards * (depth_m - ball_m))
    };
    let home = ToolInput::at(ground.from_m - inwards * 0.1, -inwards);
    let tool = Tool {
        grip: Grip { friction_coefficient: friction, is_sticky: false },
        shaft_radius_m: 0.25 * ball_m,
        ..Tool::probe("ball", ball_m, home)
    };
    let mut world = organ.world(tool)?;
    let input = |centre_m: DVec3| StepInput::of(&[ToolInput::at(centre_m, -inwards)]);
    let step_s = world.spec().time_step_s;
    let steps = |way_m: f64| (way_m / (SPEED_M_PER_S * step_s)).ceil() as usize;
    let start_m = centre_m(0.0, -ABOVE_M)?;
    world.step(&input(start_m).placed());
    let mut read = Reading::of(&world, start_m);
    let down_m = ABOVE_M + ground.depth_m;
    for step in 1..=steps(down_m) {
        let share = step as f64 / steps(down_m) as f64;
        read.step(&mut world, &input(centre_m(0.0, -ABOVE_M + share * down_m)?), None);
    }
    let press_j = read.work_j;
    for step in 1..=steps(WAY_M) {
        let share = step as f64 / steps(WAY_M) as f64;
        let is_steady = share > 0.5;
        read.step(&mut world, &input(centre_m(share * WAY_M, ground.depth_m)?), is_steady.then_some(ground));
    }
    for step in (0..steps(WAY_M)).rev() {
        let share = step as f64 / steps(WAY_M) as f64;
        read.step(&mut world, &input(centre_m(share * WAY_M, ground.depth_m)?), None);
    }
    for step in 1..=steps(2.0 * down_m) {
        let share = step as f64 / steps(2.0 * down_m) as f64;
        read.step(&mut world, &input(centre_m(0.0, ground.depth_m - share * 2.0 * down_m)?), None);
    }
    for _ in 0..(REST_S / step_s) as usize {
        read.step(&mut world, &input(centre_m(0.0, -ABOVE_M - down_m)?), None);
    }
    let n = read.n as f64;
    Ok(Slid {
        ratio: read.across_n / read.normal_n,
        against_n: read.against_n / n,
        out_n: read.out_n / n,
        press_j,
        work_j: read.work_j,
    })
}

/// One way of one model.
struct Case {
    model: &'static str,
    ground: &'static str,
    n_tets: usize,
    friction: f64,
    slid: Slid,
}

impl Case {
    const HEAD: &'static str = "| model | ground | tetrahedra | mu | across over normal | off | against the way [N] | out of the tissue [N] | work of pressing in [mJ] | work [mJ] | |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n";

    fn is_near(&self) -> bool {
        (self.slid.ratio - self.friction).abs() <= (WITHIN * self.friction).max(FRICTIONLESS)
    }

    /// Neither ratio nor work is so when it is no number.
    fn holds(&self) -> bool {
        self.is_near() && self.slid.gained() <= GAINED
    }

    fn row(&self) -> String {
        let Self { model, ground, n_tets, friction, slid } = self;
        let Slid { ratio, against_n, out_n, press_j, work_j } = slid;
        let off =
            if *friction > 0.0 { format!("{:+.1} %", 100.0 * (ratio / friction - 1.0)) } else { "-".into() };
        format!(
            "| {model} | {ground} | {n_tets} | {friction} | {ratio:.4} | {off} | {against_n:.4} | {out_n:.4} | {:.3} | {:.3} | {} |\n",
            press_j * 1e3,
            work_j * 1e3,
            if self.holds() { "pass" } else { "FAIL" },
        )
    }
}

/// Runs the selection's models and sizes; `tell` hears of each way as it is done.
fn run(selection: &Selection, tell: &mut dyn FnMut(&Case)) -> anyhow::Result<Vec<Case>> {
    let subjects = selection.subjects()?;
    let mut cases = Vec::new();
    let sizes = if selection.sizes.is_empty() { &[SIZE][..] } else { &selection.sizes };
    for &size in sizes {
        for ground in Ground::all(size)? {
            let skin = Skin::of(&ground.mesh)?;
            for subject in subjects.iter().filter(|subject| selection.wants(subject, size)) {
                let organ = ReadyOrgan::new(&ground.mesh, ground.material, ground.held, subject)
                    .with_context(|| format!("{} on {} tissue", subject.kind, ground.name))?;
                for friction in COEFFICIENTS {
                    let case = Case {
                        model: subject.kind.name(),
                        ground: ground.name,
                        n_tets: ground.mesh.tetrahedra.len(),
                        friction,
                        slid: slide(&ground, &organ, &skin, friction)?,
                    };
                    tell(&case);
                    cases.push(case);
                }
            }
        }
    }
    Ok(cases)
}

/// Runs the selection's models and sizes and writes a line a way as soon as it is done.
///
/// # Errors
/// For an unknown model, and what cannot be set up.
pub(super) fn write(selection: &Selection, write: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    write(Case::HEAD);
    run(selection, &mut |case| write(&case.row()))?;
    Ok(())
}

/// Every model on every ground with every coefficient.
pub(crate) fn sliding_experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    outcome.notes += Case::HEAD;
    for case in run(&Selection::default(), &mut |_| {})? {
        let Case { model, ground, friction, slid, .. } = &case;
        outcome.notes += &case.row();
        let name = format!("{model}, {ground}, mu {friction}: force across over force along the normals");
        outcome.experiments.push(if *friction > 0.0 {
            Experiment::near(&name, REQUIREMENT, slid.ratio, *friction, WITHIN)
        } else {
            Experiment::at_most(&name, REQUIREMENT, slid.ratio, FRICTIONLESS)
        });
        let name =
            format!("{model}, {ground}, mu {friction}: work taken out of the tissue, of that of pressing in");
        outcome.experiments.push(Experiment::at_most(&name, REQUIREMENT, slid.gained(), GAINED));
    }
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_of_a_sliding_ball_is_its_coefficient_against_its_way() {
        let ground = Ground::of_block("flat", 2_000, 5e-3, 2e-3).unwrap();
        let skin = Skin::of(&ground.mesh).unwrap();
        let selection =
            Selection { models: vec!["explicit".into(), "implicit".into()], ..Selection::default() };
        for subject in selection.subjects().unwrap() {
            let organ = ReadyOrgan::new(&ground.mesh, ground.material, ground.held, &subject).unwrap();
            let slid = slide(&ground, &organ, &skin, 0.3).unwrap();
            assert!((slid.ratio / 0.3 - 1.0).abs() < WITHIN, "{}: {slid:?}", subject.kind);
            // The way is flat, so that it is the whole force against it.
            assert!((slid.against_n / slid.out_n / 0.3 - 1.0).abs() < WITHIN, "{}: {slid:?}", subject.kind);
            assert!(slid.gained() == 0.0, "{}: {slid:?}", subject.kind);
        }
    }
}
