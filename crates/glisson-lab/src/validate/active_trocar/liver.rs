//! The simulated board palpates the synthetic patient's liver: non-linear tissue (neo-Hookean, explicit, 6,300 tetrahedra)
//! under a tip; a block under tip and shaft together; jaws that close.

use super::closed_loop::{Station, TICK_S, TIP_RADIUS_M, fault};
use super::{OWN, PROTOTYPE, THESIS, dashed, figure, line};
use crate::bench::thread_cpu_ns;
use crate::bodies::liver;
use crate::validate::{Experiment, Outcome};
use anyhow::Context;
use glam::{DQuat, DVec3};
use glisson::haptics::trocar::statics::efforts;
use glisson::haptics::trocar::{
    AxisEfforts, ContactForce, Mapping, N_AXES, Placement, TrocarJoints, TrocarProfile, Wrench,
};
use glisson::haptics::{
    AxesModel, DeviceMapping, ForceCommand, HapticDevice, HapticLaw, HapticModel, LawSettings, Touch,
};
use glisson::material::LinearElastic;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::kind::ModelKind;
use glisson::model::{DynamicBody, Rayleigh};
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Tool, ToolInput};
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

/// As in the group `haptic_force`: St Venant-Kirchhoff tissue would collapse under a tip.
const N_TETS: usize = 6_300;
const YOUNG_MODULUS_PA: f64 = 5e3;
const POISSON_RATIO: f64 = 0.45;
const DENSITY_KG_PER_M3: f64 = 1060.0;
const DAMPING_PER_S: f64 = 60.0;
/// From the trocar to the place that is touched [m].
const ABOVE_M: f64 = 0.1;
/// From where the tip comes, and how deep the hand wants it [m].
const LEAD_M: f64 = 0.01;
const DEPTH_M: f64 = 0.01;
/// How long the hand presses in; as long it holds [s].
const PRESS_S: f64 = 0.5;
const TICKS_PER_STEP: u32 = 20;
const TILTED: [f64; 2] = [0.35, -0.5];

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<()> {
    let patient = Patient::new()?;
    palpation(&patient, outcome)?;
    through_the_law(&patient, outcome)?;
    tip_and_shaft(outcome)?;
    jaws(outcome)
}

struct Patient {
    mesh: TetMesh,
    /// The liver's foremost place: -y is the patient's front.
    front_m: DVec3,
}

impl Patient {
    fn new() -> anyhow::Result<Self> {
        let mesh = liver(N_TETS)?;
        let front = mesh.positions_m.iter().copied().min_by(|a, b| a.y.total_cmp(&b.y));
        Ok(Self { front_m: front.context("a liver has nodes")?, mesh })
    }

    /// A world of this liver, held at its back, and into how many parts a step is divided.
    fn world(&self, tool: Tool, step_s: f64) -> anyhow::Result<(World, u32)> {
        let supports = vec![Support::all_axes(Region::Furthest { direction: DVec3::Y, fraction: 0.2 })];
        let fixed = fixed_nodes(&supports, &self.mesh.positions_m);
        let body = DynamicBody {
            fixed: &fixed,
            damping: Rayleigh::of_mass(DAMPING_PER_S),
            ..DynamicBody::new(&self.mesh, DENSITY_KG_PER_M3)
        };
        let materials =
            &[LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?];
        let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, materials);
        let parts_of_tick = (TICK_S / (0.7 * ExplicitKernel::stable_step(&params)?.step_s)).ceil();
        let body = DynamicBody { time_step_s: TICK_S / parts_of_tick, ..body };
        let model = Box::new(ExplicitKernel::build(&ExplicitKernelParams { body, ..params })?);
        let mut spec = WorldSpec::new("liver", step_s, tool);
        spec.supports = supports;
        let n_parts = (parts_of_tick * step_s / TICK_S).round() as u32;
        Ok((World::new(spec, self.mesh.clone(), model, ModelKind::Explicit)?, n_parts))
    }

    /// A trocar in front whose instrument, tilted so, points to the foremost place.
    fn before(&self, tilt_rad: [f64; 2]) -> Placement {
        let axes = Placement::facing(DVec3::ZERO, DVec3::Y);
        let way_m = axes.to_world_m(tilted(tilt_rad).direction() * ABOVE_M);
        Placement { pivot_in_world_m: self.front_m - way_m, ..axes }
    }
}

fn tilted([pitch_rad, roll_rad]: [f64; 2]) -> TrocarJoints {
    TrocarJoints { pitch_rad, roll_rad, ..TrocarJoints::default() }
}

/// The tip at `share` of its way in, if the hand did not yield and the liver were flat there.
fn pressed(tilt_rad: [f64; 2], share: f64) -> TrocarJoints {
    let joints = tilted(tilt_rad);
    let touching_m = ABOVE_M - TIP_RADIUS_M / joints.direction().z;
    TrocarJoints { insertion_m: touching_m - LEAD_M + (LEAD_M + DEPTH_M) * share, ..joints }
}

/// A probe in that trocar; without a shaft, so that all of the force is the tip's.
fn probe(placement: &Placement, start: &TrocarJoints) -> Tool {
    Tool {
        trocar_m: Some(placement.pivot_in_world_m),
        shaft_length_m: 0.0,
        ..Tool::probe("probe", TIP_RADIUS_M, placement.tool_input(start))
    }
}

/// What a palpation showed.
struct Palpated {
    /// Time [s], insertion wanted by the hand and got [mm], then forces [N]: of the tissue and on the hand along the
    /// instrument, the same across it.
    rows: Vec<[f64; 7]>,
    /// At the end, in the world [N].
    tissue_n: DVec3,
    hand_n: DVec3,
    /// Motions tick by tick.
    bits: Vec<[u64; N_AXES]>,
    bytes_per_tick: f64,
    cpu_ns_per_tick: f64,
    limited: [bool; N_AXES],
}

/// Presses in and holds.
fn palpate(patient: &Patient, tilt_rad: [f64; 2], mapping: Mapping, time_s: f64) -> anyhow::Result<Palpated> {
    let start = pressed(tilt_rad, 0.0);
    let mut station = Station::new(patient.before(tilt_rad), &start, mapping)?;
    let (mut world, n_parts) = patient.world(probe(&station.placement, &start), TICK_S)?;
    let (mut rows, mut bits, mut cpu_ns) = (Vec::new(), Vec::new(), 0);
    let n_ticks = (time_s / TICK_S).round() as u32;
    for k in 0..n_ticks {
        let t = f64::from(k) * TICK_S;
        let target = pressed(tilt_rad, (t / PRESS_S).min(1.0));
        station.hand(target);
        let started = thread_cpu_ns();
        let tool = station.read()?;
        cpu_ns += thread_cpu_ns() - started;
        let report = world.step(&StepInput::of(&[tool]).divided(n_parts));
        let force_n = report.tools[0].force_on_tool_n;
        let started = thread_cpu_ns();
        station.write(force_n)?;
        cpu_ns += thread_cpu_ns() - started;
        let inward = -tool.shaft_in_world;
        let on_hand_n = station.on_hand_n();
        let joints = station.mechanism().joints;
        let along = |n: DVec3| -n.dot(inward);
        let across = |n: DVec3| n.reject_from(inward).length();
        rows.push([
            t,
            1e3 * target.insertion_m,
            1e3 * joints.insertion_m,
            along(force_n),
            along(on_hand_n),
            across(force_n),
            across(on_hand_n),
        ]);
        bits.push(joints.to_array().map(f64::to_bits));
    }
    let wanted = station.device.commanded().to_array();
    let limits = TrocarProfile::built().limits.to_array();
    Ok(Palpated {
        rows,
        tissue_n: station.force_in_world_n,
        hand_n: station.on_hand_n(),
        bits,
        bytes_per_tick: station.device.line_mut().n_bytes as f64 / f64::from(n_ticks),
        cpu_ns_per_tick: cpu_ns as f64 / f64::from(n_ticks),
        limited: std::array::from_fn(|i| wanted[i].abs() >= limits[i] * (1.0 - 1e-12)),
    })
}

fn palpation(patient: &Patient, outcome: &mut Outcome) -> anyhow::Result<()> {
    let whole = |tilt_rad: [f64; 2], mapping| palpate(patient, tilt_rad, mapping, 2.0 * PRESS_S);
    let upright = [0.0, 0.0];
    let straight = whole(upright, Mapping::VirtualWork)?;
    let aslant = whole(TILTED, Mapping::VirtualWork)?;
    let again = palpate(patient, TILTED, Mapping::VirtualWork, 0.7 * PRESS_S)?;
    let published = [whole(upright, Mapping::Thesis)?, whole(TILTED, Mapping::Thesis)?];
    let off = |found: &Palpated| found.hand_n.distance(found.tissue_n) / found.tissue_n.length();
    let is_same = again.bits.iter().zip(&aslant.bits).all(|(a, b)| a == b);
    outcome.experiments.extend([
        Experiment::within(
            "palpation of the liver through the board's bytes, 10 mm wanted: force of the tissue [N]",
            "6,300 neo-Hookean tetrahedra, 5 kPa; a hand of 400 N/m",
            straight.tissue_n.length(),
            [0.3, 5.0],
        ),
        Experiment::at_most(
            "the same, upright, virtual work: force on the hand less that of the tissue, relative",
            OWN,
            off(&straight),
            0.01,
        ),
        Experiment::at_most(
            "the same at pitch 20, roll -29 degrees, virtual work, relative",
            OWN,
            off(&aslant),
            0.01,
        ),
        Experiment::at_most(
            "the same, upright, equations of the thesis, relative",
            PROTOTYPE,
            off(&published[0]),
            0.01,
        ),
        Experiment::at_most(
            "the same palpation twice: motions with other bits",
            OWN,
            f64::from(u8::from(!is_same)),
            0.0,
        ),
    ]);
    let column = |found: &Palpated, i: usize| -> Vec<[f64; 2]> {
        found.rows.iter().step_by(4).map(|row| [row[0], row[i]]).collect()
    };
    outcome.figures.push(figure(
        "active_trocar_palpation.svg",
        "The simulated board palpates the liver at pitch 20, roll -29 degrees: the force of the tissue, and what the hand \
         holds against, along and across the instrument.",
        ["Palpation of a liver through the active trocar's board", "time [s]", "force [N]"],
        vec![
            line("along: hand", column(&aslant, 4)),
            line("along: tissue", column(&aslant, 3)),
            line("across: hand", column(&aslant, 6)),
            line("across: tissue", column(&aslant, 5)),
            line("across: hand, eq. 5.6", column(&published[1], 6)),
        ],
    ));
    outcome.figures.push(figure(
        "active_trocar_insertion.svg",
        "The same palpation: where the hand wants the tip, and where the force lets it go.",
        ["Insertion during palpation", "time [s]", "insertion [mm]"],
        vec![dashed("wanted", column(&aslant, 1)), line("got", column(&aslant, 2))],
    ));
    let names = ["pitch", "roll", "insertion", "self-rotation", "jaw"];
    let at_limit: Vec<&str> =
        names.into_iter().zip(published[1].limited).filter(|(_, is)| *is).map(|(name, _)| name).collect();
    outcome.notes += &format!(
        "\nPalpation of the liver at pitch 20, roll -29 degrees by the equations of the thesis: the force on the hand is {:.0} % off \
         that of the tissue ({}). {:.0} bytes a tick; driver and simulated board take {:.1} us of processor time a tick.\n",
        100.0 * off(&published[1]),
        if at_limit.is_empty() {
            "no motor at its limit".into()
        } else {
            format!("at their limit: {}", at_limit.join(", "))
        },
        aslant.bytes_per_tick,
        1e-3 * aslant.cpu_ns_per_tick,
    );
    Ok(())
}

/// The law of a loop at 1 kHz for a device that stands there.
fn law_of(station: &Station) -> HapticLaw {
    let mapping = DeviceMapping {
        world_from_device: DQuat::from_mat3(&station.placement.world_from_device),
        device_origin_m: DVec3::ZERO,
        world_origin_m: station.placement.pivot_in_world_m,
        clutch_button: None,
        trigger_button: None,
        ..DeviceMapping::default()
    };
    let settings = LawSettings { mapping, period_s: TICK_S, ..LawSettings::default() };
    HapticLaw::new(&settings, &station.device.limits())
}

/// A loop of board, law and a simulation that steps fifty times a second.
struct Loop {
    station: Station,
    law: HapticLaw,
    model: HapticModel,
    least_energy_j: f64,
}

impl Loop {
    fn new(station: Station) -> Self {
        let law = law_of(&station);
        Self { station, law, model: HapticModel::default(), least_energy_j: f64::INFINITY }
    }

    /// Tick `k`, with the hand there; every twentieth ends with a step, for which `simulate` takes the tool and publishes.
    fn tick(
        &mut self,
        k: u32,
        target: TrocarJoints,
        simulate: &mut dyn FnMut(&ToolInput) -> HapticModel,
    ) -> anyhow::Result<()> {
        self.station.hand(target);
        let state = self.station.device.read().map_err(fault)?;
        let age_s = f64::from(k % TICKS_PER_STEP) * TICK_S;
        let tick = self.law.tick(&state, &self.model, age_s, TICK_S);
        self.station.device.write(&tick.command).map_err(fault)?;
        if (k + 1).is_multiple_of(TICKS_PER_STEP) {
            self.model = simulate(&tick.tool);
        }
        self.least_energy_j = self.least_energy_j.min(tick.report.observed_energy_j);
        Ok(())
    }

    fn bound_row(&self, what: &str) -> Experiment {
        let below_j = (self.law.energy_bound_j() - self.least_energy_j).max(0.0);
        Experiment::at_most(
            &format!("{what}: how far the observed energy goes below its bound [J]"),
            "haptics::HapticLaw",
            below_j,
            0.0,
        )
    }
}

/// The palpation through the whole haptic law: the world steps fifty times a second, the board a thousand times.
fn through_the_law(patient: &Patient, outcome: &mut Outcome) -> anyhow::Result<()> {
    let start = pressed(TILTED, 0.0);
    let station = Station::new(patient.before(TILTED), &start, Mapping::VirtualWork)?;
    let step_s = TICK_S * f64::from(TICKS_PER_STEP);
    let (mut world, n_parts) = patient.world(probe(&station.placement, &start), step_s)?;
    let mut run = Loop::new(station);
    let (mut tissue_n, mut hand_n, mut n) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for k in 0..1500_u32 {
        let target = pressed(TILTED, (f64::from(k) * TICK_S / PRESS_S).min(1.0));
        run.tick(k, target, &mut |tool| {
            world.step(&StepInput::of(&[*tool]).divided(n_parts));
            world.haptic_model(0)
        })?;
        if k >= 1000 {
            tissue_n += world.report().tools[0].force_on_tool_n;
            hand_n += run.station.on_hand_n();
            n += 1.0;
        }
    }
    outcome.experiments.extend([
        Experiment::at_most(
            "the same through the haptic law, the world at 50 Hz: mean force on the hand less that of the tissue, relative",
            OWN,
            hand_n.distance(tissue_n) / tissue_n.length(),
            0.05,
        ),
        Experiment::within("the same: mean force of the tissue [N]", OWN, tissue_n.length() / n, [0.3, 5.0]),
        run.bound_row("the same"),
    ]);
    Ok(())
}

/// A block of tissue, and a rod of that length that comes from a trocar beside it, as high as its top [m]: first this far above
/// it, then pressed in so deep, it meets the edge with its shaft and the top with its tip.
const BLOCK_M: f64 = 0.1;
const ROD_M: f64 = 0.12;
const BESIDE_M: f64 = 0.03;
const ROD_LEAD_M: f64 = 0.02;
const ROD_DEPTH_M: f64 = 5e-4;
const ROD_RADIUS_M: f64 = 3e-3;

/// The block under that rod, which slides without friction.
fn block(placement: &Placement, start: &TrocarJoints, step_s: f64) -> anyhow::Result<World> {
    let mesh = box_of_five([6; 3], DVec3::splat(BLOCK_M));
    let grip = Grip { friction_coefficient: 0.0, is_sticky: false };
    let rod = Tool {
        trocar_m: Some(placement.pivot_in_world_m),
        shaft_radius_m: 2e-3,
        grip,
        ..Tool::probe("rod", ROD_RADIUS_M, placement.tool_input(start))
    };
    let mut spec = WorldSpec::new("block", step_s, rod);
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 1.0 / 7.0 };
    spec.supports = vec![Support::all_axes(table)];
    let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, 0.4, 1000.0)?;
    let mut body = OrganBody::new(mesh, material, step_s);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    let model = build_model(&body, ModelKind::Precomputed)?;
    Ok(World::new(spec, body.mesh, model, ModelKind::Precomputed)?)
}

/// A rod that is pressed onto a block with tip and shaft: the motors exert what the sum of both contacts asks for.
fn tip_and_shaft(outcome: &mut Outcome) -> anyhow::Result<()> {
    let pivot_m = DVec3::new(-BESIDE_M, 0.47 * BLOCK_M, BLOCK_M);
    let placement = Placement::facing(pivot_m, DVec3::X);
    // The tip below the trocar by so much [m].
    let leaning = |down_m: f64| {
        let along_m = (ROD_M * ROD_M - down_m * down_m).sqrt();
        let d = placement.world_from_device.transpose() * DVec3::new(along_m, 0.0, -down_m);
        TrocarJoints { insertion_m: ROD_M, ..tilted([-(d.y / d.z).atan(), (d.x / d.z).atan()]) }
    };
    let start = leaning(-ROD_LEAD_M);
    let station = Station::new(placement, &start, Mapping::VirtualWork)?;
    let mut world = block(&placement, &start, TICK_S * f64::from(TICKS_PER_STEP))?;
    let mut run = Loop::new(station);
    let (mut wanted, mut got, mut at_tip) = ([0.0; N_AXES], [0.0; N_AXES], [0.0; N_AXES]);
    let (mut n_both, mut n) = (0, 0);
    let mut forces_n = [0.0; 2];
    let add = |sum: &mut [f64; N_AXES], efforts: AxisEfforts| {
        sum.iter_mut().zip(efforts.to_array()).for_each(|(sum, x)| *sum += x);
    };
    for k in 0..1200_u32 {
        let share = (f64::from(k) * TICK_S / PRESS_S).min(1.0);
        let target = leaning((ROD_LEAD_M + ROD_DEPTH_M) * share - ROD_LEAD_M);
        run.tick(k, target, &mut |tool| {
            world.step(&StepInput::of(&[*tool]));
            world.haptic_model(0)
        })?;
        if k < 900 || !(k + 1).is_multiple_of(TICKS_PER_STEP) {
            continue;
        }
        n += 1;
        let contacts = world.snapshot().tools[0].contacts;
        let (Some(tip), Some(shaft)) = (contacts[0], contacts[2]) else { continue };
        n_both += 1;
        let parts = run.model.parts;
        let real = [(tip, parts[0]), (shaft, parts[1])]
            .map(|(contact, part)| placement.contact(contact.point_m, part.force_n));
        let joints = run.station.device.reading()?.joints;
        let tip_m = joints.pose().tip_m;
        let summed = real.map(|contact| ContactForce { point_m: tip_m, ..contact });
        let asked =
            |contacts: &[ContactForce]| efforts(Mapping::VirtualWork, &joints, &Wrench::of(contacts), 0.0);
        add(&mut wanted, asked(&real));
        add(&mut at_tip, asked(&summed));
        add(&mut got, run.station.device.commanded());
        forces_n.iter_mut().zip(real).for_each(|(sum, contact)| *sum += contact.force_n.length());
    }
    let tilt_off =
        |of: &[f64; N_AXES]| (of[0] - wanted[0]).hypot(of[1] - wanted[1]) / wanted[0].hypot(wanted[1]);
    let count = f64::from(n);
    outcome.experiments.extend([
        Experiment::near(
            "a rod across a block: share of steps with tip and shaft in contact",
            OWN,
            f64::from(n_both) / count,
            1.0,
            0.0,
        ),
        Experiment::at_most(
            "the same through World, law and board: torques of pitch and roll less those of the sum of both contacts, relative",
            THESIS,
            tilt_off(&got),
            0.03,
        ),
        Experiment::at_most(
            "the same: force along the instrument less that of both contacts, over the forces",
            THESIS,
            (got[2] - wanted[2]).abs() / (forces_n[0] + forces_n[1]),
            0.03,
        ),
        Experiment::within(
            "the same: torques if both forces acted at the tip, off, relative",
            "requirement: the test can fail",
            tilt_off(&at_tip),
            [0.05, 2.0],
        ),
        run.bound_row("the same"),
    ]);
    outcome.notes += &format!(
        "\nA rod across a block touches with its tip ({:.2} N) and its shaft ({:.2} N), {:.0} mm from the trocar: {:.1} mN m about it, \
         {:.1} mN m if both acted at the tip.\n",
        forces_n[0] / count,
        forces_n[1] / count,
        1e3 * ROD_M,
        1e3 * wanted[0].hypot(wanted[1]) / count,
        1e3 * at_tip[0].hypot(at_tip[1]) / count,
    );
    Ok(())
}

/// What jaws are squeezed by: nothing above this opening, a straight line below it [J for the whole way].
const SLACK: f64 = 0.35;
const SQUEEZE_J: f64 = 0.3;
const CLOSED_TO: f64 = 0.05;

/// Jaws that close on something: the handle is held open by the jaw motor, and gives no energy.
fn jaws(outcome: &mut Outcome) -> anyhow::Result<()> {
    let start = TrocarJoints { insertion_m: ABOVE_M, jaw_opening: 0.5, ..TrocarJoints::default() };
    let placement = Placement::facing(DVec3::ZERO, DVec3::Y);
    let mut run = Loop::new(Station::new(placement, &start, Mapping::VirtualWork)?);
    let mut jump_n = 0.0_f64;
    let mut last_n = 0.0;
    for k in 0..2000_u32 {
        let share = (f64::from(k) * TICK_S / PRESS_S).min(1.0);
        let target = TrocarJoints { jaw_opening: 0.5 + (CLOSED_TO - 0.5) * share, ..start };
        run.tick(k, target, &mut |tool| {
            let is_squeezed = tool.jaw_opening < SLACK;
            let axes = AxesModel {
                jaw_j: SQUEEZE_J * (SLACK - tool.jaw_opening).max(0.0),
                jaw_opening: tool.jaw_opening,
                jaw_stiffness_j: if is_squeezed { SQUEEZE_J } else { 0.0 },
                roll_rad: tool.roll_rad,
                ..AxesModel::default()
            };
            let touch = if is_squeezed { Touch::Grasp } else { Touch::Free };
            HapticModel {
                step: u64::from(k),
                touch,
                tip_m: tool.tip_in_world_m,
                gap_m: 1.0,
                axes,
                ..HapticModel::default()
            }
        })?;
        let jaw_n = run.station.device.commanded().jaw_n;
        jump_n = jump_n.max((jaw_n - last_n).abs());
        last_n = jaw_n;
    }
    let mechanism = run.station.mechanism();
    let hand_n = -mechanism.hand_efforts()[4];
    let found = mechanism.joints.jaw_opening;
    // The hand's spring against what is squeezed, both over the handle's way.
    let travel_m = mechanism.profile.jaw_travel_m;
    let hand_n_per_m = mechanism.motions[4].hand_stiffness;
    let (hand_j, squeeze_j) = (hand_n_per_m * travel_m * travel_m, SQUEEZE_J);
    let opening = (hand_j * CLOSED_TO + squeeze_j * SLACK) / (hand_j + squeeze_j);
    let exact_n = squeeze_j * (SLACK - opening) / travel_m;
    outcome.experiments.extend([
        Experiment::near(
            "jaws that close on something soft: force of the jaw motor [N]",
            "the balance of two springs",
            last_n,
            exact_n,
            0.02 * exact_n,
        ),
        Experiment::near(
            "the same: what the hand holds against [N]",
            "the same",
            hand_n,
            exact_n,
            0.02 * exact_n,
        ),
        Experiment::near("the same: opening of the jaws", "the same", found, opening, 0.005),
        Experiment::at_most(
            "the same: largest change of the force in a tick [N]",
            "0.04 N, and what the jaws' motion explains",
            jump_n,
            0.06,
        ),
        run.bound_row("the same"),
    ]);
    let command = ForceCommand { jaw_force_n: 100.0, ..ForceCommand::default() };
    run.station.device.write(&command).map_err(fault)?;
    outcome.experiments.push(Experiment::near(
        "100 N asked of the jaw motor: given [N]",
        "the profile's limit",
        run.station.device.commanded().jaw_n,
        TrocarProfile::built().limits.jaw_n,
        1e-12,
    ));
    Ok(())
}
