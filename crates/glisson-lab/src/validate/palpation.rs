//! A stiff nodule under the surface of an organ, felt with a flat tip on a force-feedback device.
//!
//! A block 60 mm deep, bonded to its base; a ball of 20 mm of twice the stiffness, its top 2 mm under the surface; a tip of
//! 5 mm radius that the tissue under it sticks to. A quarter of the block in tetrahedra, held along its two planes of
//! symmetry. The organ is a body of ln J neo-Hookean tissue, stepped at 30 Hz of its time: explicit in many parts for a tip
//! 1 mm deep, implicit for one 5 mm deep. The models that it publishes go to the force law, and its commands to a simulated
//! device whose hand goes on until the tip is so deep: what is compared is the command to the device, at the same depth of the tip. The static solution is Newton's method on the same
//! law and mesh, which shares no step, damping, contact, force law or device with it; the axisymmetric one is linear, frictionless
//! and on rectangles.

use super::indentation::axisymmetric::{Layer, Nodule};
use super::indentation::block::{Grading, quarter_block};
use super::{Claim, Figure, Outcome, check_all, series};
use anyhow::{Context, anyhow};
use glisson::haptics::{
    HandPath, HandSettings, HapticDevice, HapticLaw, HapticModel, LawSettings, PatchStiffness,
    SimulatedDevice, SimulatedDeviceSettings, Touch,
};
use glisson::material::{LinearElastic, NeoHookeLog};
use glisson::math::{DMat3, DVec3, outer};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams, SharedLaw};
use glisson::model::kernel::KernelLaw;
use glisson::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, LocalModel, LocalWork,
    Rayleigh,
};
use glisson::solve::{BoundaryConditions, NonlinearProblem, NonlinearSettings, solve_nonlinear};
use glisson_report::plot::{LinePlot, SeriesStyle};
use std::fmt::Write as _;
use std::sync::Arc;

const ISSUE: &str = "requirement; axisymmetric finite elements give 28 %";
const OWN: &str = "own static solution, same law and mesh (Newton's method)";

/// Liver-like tissue: the ratio of forces depends on Poisson's ratio alone.
const YOUNG_MODULUS_PA: f64 = 5e3;
const POISSON_RATIO: f64 = 0.45;
const DENSITY_KG_PER_M3: f64 = 1060.0;
const NODULE: Nodule = Nodule { radius_m: 10e-3, depth_m: 12e-3, stiffness: 2.0 };
const TIP_RADIUS_M: f64 = 5e-3;
const ORGAN_DEPTH_M: f64 = 60e-3;
/// Shallow, where the tissue is linear, of the explicit body.
const SHALLOW: Press = Press { depth_m: 1e-3, speed_m_per_s: 0.005, duration_s: 0.9 };
/// Deep, of the implicit one: at the sharp rim of the tip the explicit body's tetrahedra turn inside out.
const DEEP: Press = Press { depth_m: 5e-3, speed_m_per_s: 0.02, duration_s: 1.1 };
/// The hand moves by what the tip lacks in this time [s].
const FOLLOW_S: f64 = 0.08;
/// How near the tip has to come to its depth, as a share of it.
const DEPTH_TOLERANCE: f64 = 0.002;
const STEP_S: f64 = 1.0 / 30.0;
const TICK_S: f64 = 1e-3;
/// Share of the stable step: the block is compressed, its elements become thinner.
const STEP_SHARE: f64 = 0.5;
/// Brings the block to rest within a few steps [1/s].
const DAMPING_PER_S: f64 = 30.0;
/// Rings of tetrahedra around the tip that count in the published stiffness, and how well it is solved.
const MOST_RINGS: u32 = 5;
const TOLERANCE: f64 = 1e-3;
/// Points within a tetrahedron along each axis that tell how much of it is nodule.
const SAMPLES: usize = 6;

/// What a hand does: it goes so deep, no faster than that, until it and the tissue have come to rest.
struct Press {
    depth_m: f64,
    speed_m_per_s: f64,
    duration_s: f64,
}

/// The block with or without nodule.
struct Organ {
    mesh: TetMesh,
    /// How many times stiffer each tetrahedron is.
    stiffness: Vec<f64>,
    /// Nodes under the tip, ascending.
    tip: Vec<NodeId>,
    fixed: Vec<FixedNode>,
}

impl Organ {
    fn new(nodule: Option<&Nodule>) -> Self {
        let mm = |list: &[f64]| list.iter().map(|x| x * 1e-3).collect();
        let grading = Grading {
            radii_m: mm(&[0.0, 1.7, 3.4, 5.0, 6.5, 8.5, 11.0, 14.0, 19.0, 27.0, 40.0, 60.0, 90.0]),
            depths_m: mm(&[0.0, 1.0, 2.0, 3.5, 5.5, 8.0, 11.0, 14.0, 18.0, 22.0, 29.0, 40.0, 60.0]),
            fine_m: 1.7e-3,
            round_m: 14e-3,
        };
        let mesh = quarter_block(&grading);
        let stiffness = (0..mesh.tetrahedra.len())
            .map(|t| nodule.map_or(1.0, |n| mean_stiffness(n, mesh.corners_m(TetId::from_index(t)))))
            .collect();
        let mut tip = Vec::new();
        let mut fixed = Vec::new();
        for (n, p) in mesh.positions_m.iter().enumerate() {
            let node = NodeId::from_index(n);
            let axes = if p.z <= -ORGAN_DEPTH_M { [true; 3] } else { [p.x == 0.0, p.y == 0.0, false] };
            if axes != [false; 3] {
                fixed.push(FixedNode { node, axes });
            }
            if p.z == 0.0 && p.x.hypot(p.y) <= TIP_RADIUS_M * (1.0 + 1e-9) {
                tip.push(node);
            }
        }
        Self { mesh, stiffness, tip, fixed }
    }

    fn materials(&self) -> anyhow::Result<Vec<LinearElastic>> {
        let of = |times: &f64| -> anyhow::Result<LinearElastic> {
            let young_pa = YOUNG_MODULUS_PA * times;
            Ok(LinearElastic::from_young_poisson(young_pa, POISSON_RATIO, DENSITY_KG_PER_M3)?)
        };
        self.stiffness.iter().map(of).collect()
    }

    /// Force on the tip [N], four quarters of it.
    fn static_force_n(&self, depth_m: f64) -> anyhow::Result<f64> {
        let mut conditions = BoundaryConditions::new();
        for held in &self.fixed {
            for axis in (0..3).filter(|axis| held.axes[*axis]) {
                conditions.impose(held.node, axis, 0.0);
            }
        }
        for node in &self.tip {
            conditions.impose_node(*node, DVec3::Z * -depth_m);
        }
        let laws = &self.materials()?.iter().map(NeoHookeLog::from).collect::<Vec<_>>()[..];
        let nodal_force_n = &vec![DVec3::ZERO; self.mesh.positions_m.len()][..];
        let settings = NonlinearSettings::default();
        let conditions = &conditions;
        let problem = NonlinearProblem { mesh: &self.mesh, laws, conditions, nodal_force_n, settings };
        let solution = solve_nonlinear(&problem).context("the static solution")?;
        Ok(-4.0 * self.tip.iter().map(|n| solution.reaction_n[n.index()].z).sum::<f64>())
    }

    /// The explicit body, and how many of its steps make one of the simulation.
    fn explicit(&self) -> anyhow::Result<(Box<dyn DeformableModel>, usize)> {
        let materials = &self.materials()?[..];
        let body = DynamicBody {
            fixed: &self.fixed,
            damping: Rayleigh::of_mass(DAMPING_PER_S),
            ..DynamicBody::new(&self.mesh, DENSITY_KG_PER_M3)
        };
        let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, materials);
        let n_parts = (STEP_S / (STEP_SHARE * ExplicitKernel::stable_step(&params)?.step_s)).ceil();
        let body = DynamicBody { time_step_s: STEP_S / n_parts, ..body };
        let model = ExplicitKernel::build(&ExplicitKernelParams { body, ..params })?;
        Ok((Box::new(model), n_parts as usize))
    }

    /// The implicit one, whose step is the simulation's.
    fn implicit(&self) -> anyhow::Result<(Box<dyn DeformableModel>, usize)> {
        let laws = self.materials()?.iter().map(|m| Arc::new(NeoHookeLog::from(m)) as SharedLaw).collect();
        let body = DynamicBody {
            fixed: &self.fixed,
            damping: Rayleigh::of_mass(DAMPING_PER_S),
            time_step_s: STEP_S,
            ..DynamicBody::new(&self.mesh, DENSITY_KG_PER_M3)
        };
        let model = ImplicitEuler::build(&ImplicitParams::new(body, &ImplicitLaw::General(laws)))?;
        Ok((Box::new(model), 1))
    }

    /// A hand with the device presses until the tip is so deep, and stays.
    fn palpate(
        &self,
        (mut model, n_parts): (Box<dyn DeformableModel>, usize),
        press: &Press,
    ) -> anyhow::Result<Palpation> {
        let mut publisher = Publisher::new(self.mesh.positions_m.len());
        // Places that are rounded to 55 um would be a twentieth of the depth.
        let mut wanted_m = DVec3::ZERO;
        let path = HandPath::Rest(wanted_m);
        let mut device =
            SimulatedDevice::new(&SimulatedDeviceSettings::ideal(), &HandSettings::default(), path, 1);
        let mut law = HapticLaw::new(&LawSettings::default(), &device.limits());
        let mut felt = Palpation::default();
        let mut latest = HapticModel::default();
        let (mut tip_m, mut n_steps) = (DVec3::ZERO, 0_u64);
        for tick in 0..(press.duration_s / TICK_S).round() as u64 {
            let time_s = tick as f64 * TICK_S;
            if time_s >= n_steps as f64 * STEP_S {
                n_steps += 1;
                // By symmetry the tip stays on the axis.
                let tip_m = DVec3::Z * tip_m.z;
                latest = publisher.step((&mut *model, n_parts), &self.tip, tip_m, n_steps);
            }
            let age_s = time_s + STEP_S - n_steps as f64 * STEP_S;
            let state = device.read().map_err(|fault| anyhow!("the simulated device: {fault:?}"))?;
            let answer = law.tick(&state, &latest, age_s, TICK_S);
            device.write(&answer.command).map_err(|fault| anyhow!("the simulated device: {fault:?}"))?;
            tip_m = answer.tool.tip_in_world_m;
            let lacking_m = -press.depth_m - tip_m.z;
            let most_m = press.speed_m_per_s * TICK_S;
            wanted_m.z += (lacking_m * TICK_S / FOLLOW_S).clamp(-most_m, most_m);
            device.set_path(HandPath::Rest(wanted_m));
            (felt.at_rest_n, felt.depth_m) = (answer.command.force_n.z, -tip_m.z);
            felt.curve.push([1e3 * time_s, felt.at_rest_n]);
        }
        Ok(felt)
    }
}

/// What a hand felt.
#[derive(Clone, Debug, Default)]
struct Palpation {
    /// Command to the device at the end [N], and how deep the tip is then [m].
    at_rest_n: f64,
    depth_m: f64,
    /// Time [ms] and command [N].
    curve: Vec<[f64; 2]>,
}

/// Steps a body whose tip nodes follow the hand, and tells what a haptic loop needs.
struct Publisher {
    work: LocalWork,
    local: LocalModel,
    patch: PatchStiffness,
}

impl Publisher {
    fn new(n_nodes: usize) -> Self {
        Self {
            // As a world does: what is published at rest is the body's force, whatever the stiffness.
            work: LocalWork::with_room_for(n_nodes).estimating(MOST_RINGS, TOLERANCE),
            local: LocalModel::new(),
            patch: PatchStiffness::new(),
        }
    }

    /// The model makes the step in so many parts.
    fn step(
        &mut self,
        (model, n_parts): (&mut dyn DeformableModel, usize),
        tip: &[NodeId],
        tip_m: DVec3,
        step: u64,
    ) -> HapticModel {
        let displacement = |node: &NodeId| ImposedDisplacement { node: *node, displacement_m: tip_m };
        let displacements = tip.iter().map(displacement).collect();
        model.apply(&Constraints { displacements, forces: Vec::new() });
        for _ in 0..n_parts {
            model.step(STEP_S / n_parts as f64);
        }
        let on_tissue_n: DVec3 = model.constraint_forces_n().iter().sum();
        model.local_model_into(tip, STEP_S, &mut self.work, &mut self.local);
        self.patch.solve(&self.local, |_| DMat3::IDENTITY);
        let stiffness_n_per_m = self.patch.stiffness_n_per_m(|_| true).z_axis.z;
        // Of four quarters; what they bear along the surface is in balance.
        HapticModel {
            step,
            time_s: step as f64 * STEP_S,
            period_s: STEP_S,
            touch: Touch::Contact,
            tip_m,
            force_n: DVec3::Z * (-4.0 * on_tissue_n.z),
            stiffness_n_per_m: outer(DVec3::Z, DVec3::Z) * (4.0 * stiffness_n_per_m),
            normal: DVec3::Z,
            ..HapticModel::default()
        }
    }
}

/// Mean over a tetrahedron of how many times stiffer it is.
fn mean_stiffness(nodule: &Nodule, corners_m: [DVec3; 4]) -> f64 {
    let (mut sum, mut n_points) = (0.0, 0.0);
    for i in 0..SAMPLES {
        for j in 0..SAMPLES - i {
            for k in 0..SAMPLES - i - j {
                let share = |n: usize| (n as f64 + 0.25) / SAMPLES as f64;
                let (a, b, c) = (share(i), share(j), share(k));
                let [p, q, r, s] = corners_m;
                let point_m = p * a + q * b + r * c + s * (1.0 - a - b - c);
                sum += nodule.stiffness_at(point_m.x.hypot(point_m.y), -point_m.z);
                n_points += 1.0;
            }
        }
    }
    sum / n_points
}

/// How much more force the nodule takes, linear, axisymmetric and frictionless.
fn axisymmetric_rise() -> anyhow::Result<f64> {
    let steps = |n: usize, from_m: f64, to_m: f64| {
        (1..=n).map(move |k| from_m + (to_m - from_m) * k as f64 / n as f64)
    };
    let mut radii_m = vec![0.0];
    radii_m.extend(steps(20, 0.0, TIP_RADIUS_M));
    radii_m.extend(steps(30, TIP_RADIUS_M, 15e-3));
    radii_m.extend(steps(20, 15e-3, 100e-3));
    let mut depths_m = vec![0.0];
    depths_m.extend(steps(50, 0.0, 24e-3));
    depths_m.extend(steps(20, 24e-3, ORGAN_DEPTH_M));
    let force_n = |nodule: Option<Nodule>| -> anyhow::Result<f64> {
        let layer = Layer {
            radii_m: radii_m.clone(),
            depths_m: depths_m.clone(),
            young_modulus_pa: YOUNG_MODULUS_PA,
            poisson_ratio: POISSON_RATIO,
            nodule,
        };
        layer.upper_side(TIP_RADIUS_M)?.flat_punch_n(TIP_RADIUS_M, 1e-3)
    };
    Ok(force_n(Some(NODULE))? / force_n(None)? - 1.0)
}

/// One organ under one press.
struct Trial {
    has_nodule: bool,
    is_deep: bool,
    felt: Palpation,
    static_n: f64,
    wanted_m: f64,
}

impl Trial {
    fn new(organ: &Organ, has_nodule: bool, is_deep: bool) -> anyhow::Result<Self> {
        let press = if is_deep { &DEEP } else { &SHALLOW };
        let felt = organ.palpate(if is_deep { organ.implicit()? } else { organ.explicit()? }, press)?;
        let static_n = organ.static_force_n(press.depth_m)?;
        Ok(Self { has_nodule, is_deep, felt, static_n, wanted_m: press.depth_m })
    }

    fn name(&self) -> &'static str {
        if self.has_nodule { "with" } else { "without" }
    }
}

/// What the experiments judge.
struct Measured {
    trials: Vec<Trial>,
    axisymmetric_rise: f64,
}

impl Measured {
    /// How much more force the device commands over the nodule.
    fn rise(&self, is_deep: bool) -> f64 {
        let force_n = |has_nodule: bool| {
            let found = self.trials.iter().find(|t| t.has_nodule == has_nodule && t.is_deep == is_deep);
            found.map_or(f64::NAN, |t| t.felt.at_rest_n)
        };
        force_n(true) / force_n(false) - 1.0
    }

    /// From the static solution, the worse of two.
    fn worst_off(&self, is_deep: bool) -> f64 {
        let trials = self.trials.iter().filter(|t| t.is_deep == is_deep);
        trials.map(|t| (t.felt.at_rest_n / t.static_n - 1.0).abs()).fold(0.0, f64::max)
    }

    fn worst_depth(&self) -> f64 {
        self.trials.iter().map(|t| (t.felt.depth_m / t.wanted_m - 1.0).abs()).fold(0.0, f64::max)
    }
}

const CLAIMS: &[Claim<'_, Measured>] = &[
    Claim::within(
        "nodule of 20 mm, twice as stiff, 2 mm under the surface, flat tip of 5 mm: greater command to the device at 1 mm",
        ISSUE,
        |m| m.rise(false),
        [0.2, 0.4],
    ),
    Claim::within(
        "the same at 5 mm, implicit body: greater command to the device",
        ISSUE,
        |m| m.rise(true),
        [0.2, 0.6],
    ),
    Claim::at_most(
        "command to the device against the static solution at 1 mm, relative, the worse of two",
        OWN,
        |m| m.worst_off(false),
        0.05,
    ),
    Claim::at_most("the same at 5 mm, implicit body", OWN, |m| m.worst_off(true), 0.01),
    Claim::at_most(
        "depth of the tip against what the hand wants, relative, the worst of four",
        "equal depths",
        Measured::worst_depth,
        DEPTH_TOLERANCE,
    ),
    Claim::near(
        "the rise by the own axisymmetric solution, linear and without friction",
        ISSUE,
        |m| m.axisymmetric_rise,
        [0.28, 0.05],
    ),
];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let organs = [Organ::new(None), Organ::new(Some(&NODULE))];
    let mut trials = Vec::new();
    for (organ, has_nodule) in organs.iter().zip([false, true]) {
        for is_deep in [false, true] {
            trials.push(Trial::new(organ, has_nodule, is_deep)?);
        }
    }
    let notes = notes(&organs[0], &trials)?;
    let measured = Measured { trials, axisymmetric_rise: axisymmetric_rise()? };
    let experiments = check_all(CLAIMS, &measured);
    Ok(Outcome { experiments, figures: vec![figure(measured.trials)], notes })
}

fn notes(organ: &Organ, trials: &[Trial]) -> anyhow::Result<String> {
    let mut notes = format!(
        "{} tetrahedra in a quarter of the block, {} nodes under the quarter of the tip; E = {YOUNG_MODULUS_PA} Pa, nu = {POISSON_RATIO}.\n\n\
         | depth of the tip [mm] | nodule | command to the device [mN] | static solution [mN] |\n|---|---|---|---|\n",
        organ.mesh.tetrahedra.len(),
        organ.tip.len(),
    );
    for trial in trials {
        writeln!(
            notes,
            "| {:.3} | {} | {:.2} | {:.2} |",
            1e3 * trial.felt.depth_m,
            trial.name(),
            1e3 * trial.felt.at_rest_n,
            1e3 * trial.static_n
        )?;
    }
    Ok(notes)
}

fn figure(trials: Vec<Trial>) -> Figure {
    let shallow = trials.into_iter().filter(|trial| !trial.is_deep);
    let curve =
        |trial: Trial| series(&format!("{} nodule", trial.name()), trial.felt.curve, SeriesStyle::Line);
    let plot = LinePlot {
        title: "Palpation of a nodule at 1 mm".into(),
        x_label: "time [ms]".into(),
        y_label: "command to the device [N]".into(),
        series: shallow.map(curve).collect(),
        size: [720, 420],
    };
    let caption =
        "Command to the device as a hand presses a flat tip in by 1 mm, over tissue with and without a nodule.".into();
    Figure { file: "palpation_force.svg", caption, plot }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_half_in_the_nodule_is_half_stiffer() {
        let at = |z_mm: f64| {
            let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * 1e-4 + DVec3::Z * (z_mm * 1e-3);
            [corner(-1.0, -1.0, 0.0), corner(2.0, 0.0, 0.0), corner(0.0, 2.0, 0.0), corner(0.0, 0.0, 1.0)]
        };
        assert_eq!(mean_stiffness(&NODULE, at(-12.0)), 2.0);
        assert_eq!(mean_stiffness(&NODULE, at(-1.5)), 1.0);
        let half = mean_stiffness(&NODULE, at(-2.03));
        assert!((1.2..1.9).contains(&half), "{half}");
    }
}
