//! The simulated board palpates the synthetic patient's liver: non-linear tissue (neo-Hookean, explicit, 6,300 tetrahedra)
//! under a tip, first with the tissue's force straight to the device, then through the whole haptic law.

use super::closed_loop::{Station, TICK_S, TIP_RADIUS_M};
use super::law_loop::{Loop, PRESS_S, TICKS_PER_STEP};
use super::{OWN, PROTOTYPE, dashed, figure, line, tilted};
use crate::bench::thread_cpu_ns;
use crate::bodies::liver;
use crate::validate::haptic_force::{N_TETS, front_m, world};
use crate::validate::{Experiment, Figure, Outcome};
use glam::DVec3;
use glisson::haptics::trocar::{Mapping, N_AXES, Placement, TrocarJoints, TrocarProfile};
use glisson::mesh::TetMesh;
use glisson::tool::Tool;
use glisson::world::StepInput;

/// From the trocar to the place that is touched [m].
const ABOVE_M: f64 = 0.1;
/// From where the tip comes, and how deep the hand wants it [m].
const LEAD_M: f64 = 0.01;
const DEPTH_M: f64 = 0.01;
const UPRIGHT: [f64; 2] = [0.0, 0.0];
const TILTED: [f64; 2] = [0.35, -0.5];

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<()> {
    let patient = Patient::new()?;
    palpation(&patient, outcome)?;
    through_the_law(&patient, outcome)
}

struct Patient {
    mesh: TetMesh,
    /// The liver's foremost place: -y is the patient's front.
    front_m: DVec3,
}

impl Patient {
    fn new() -> anyhow::Result<Self> {
        let mesh = liver(N_TETS)?;
        Ok(Self { front_m: front_m(&mesh)?, mesh })
    }

    /// A trocar in front whose instrument, tilted so, points to the foremost place.
    fn before(&self, tilt_rad: [f64; 2]) -> Placement {
        let axes = Placement::facing(DVec3::ZERO, DVec3::Y);
        let way_m = axes.to_world_m(tilted(tilt_rad).direction() * ABOVE_M);
        Placement { pivot_in_world_m: self.front_m - way_m, ..axes }
    }
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

impl Palpated {
    /// Force on the hand less that of the tissue at the end, relative.
    fn off(&self) -> f64 {
        self.hand_n.distance(self.tissue_n) / self.tissue_n.length()
    }

    /// A column of the rows over time, every fourth.
    fn column(&self, i: usize) -> Vec<[f64; 2]> {
        self.rows.iter().step_by(4).map(|row| [row[0], row[i]]).collect()
    }

    /// Which motors are at their limit at the end, in words.
    fn at_limit(&self) -> String {
        let names = ["pitch", "roll", "insertion", "self-rotation", "jaw"];
        let at_limit: Vec<&str> =
            names.into_iter().zip(self.limited).filter(|(_, is)| *is).map(|(name, _)| name).collect();
        if at_limit.is_empty() {
            "no motor at its limit".into()
        } else {
            format!("at their limit: {}", at_limit.join(", "))
        }
    }
}

/// Presses in and holds as long.
fn palpate(patient: &Patient, tilt_rad: [f64; 2], mapping: Mapping, time_s: f64) -> anyhow::Result<Palpated> {
    let start = pressed(tilt_rad, 0.0);
    let mut station = Station::new(patient.before(tilt_rad), &start, mapping)?;
    let (mut world, n_parts) = world(&patient.mesh, probe(&station.placement, &start), TICK_S)?;
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

/// Palpations by virtual work and by the equations of the thesis.
struct Palpations {
    straight: Palpated,
    aslant: Palpated,
    /// As `aslant`, and shorter.
    again: Palpated,
    published_straight: Palpated,
    published_aslant: Palpated,
}

impl Palpations {
    fn of(patient: &Patient) -> anyhow::Result<Self> {
        let whole = |tilt_rad: [f64; 2], mapping| palpate(patient, tilt_rad, mapping, 2.0 * PRESS_S);
        Ok(Self {
            straight: whole(UPRIGHT, Mapping::VirtualWork)?,
            aslant: whole(TILTED, Mapping::VirtualWork)?,
            again: palpate(patient, TILTED, Mapping::VirtualWork, 0.7 * PRESS_S)?,
            published_straight: whole(UPRIGHT, Mapping::Thesis)?,
            published_aslant: whole(TILTED, Mapping::Thesis)?,
        })
    }

    fn experiments(&self) -> [Experiment; 5] {
        let is_same = self.again.bits.iter().zip(&self.aslant.bits).all(|(a, b)| a == b);
        [
            Experiment::within(
                "palpation of the liver through the board's bytes, 10 mm wanted: force of the tissue [N]",
                "6,300 neo-Hookean tetrahedra, 5 kPa; a hand of 400 N/m",
                self.straight.tissue_n.length(),
                [0.3, 5.0],
            ),
            Experiment::at_most(
                "the same, upright, virtual work: force on the hand less that of the tissue, relative",
                OWN,
                self.straight.off(),
                0.01,
            ),
            Experiment::at_most(
                "the same at pitch 20, roll -29 degrees, virtual work, relative",
                OWN,
                self.aslant.off(),
                0.01,
            ),
            Experiment::at_most(
                "the same, upright, equations of the thesis, relative",
                PROTOTYPE,
                self.published_straight.off(),
                0.01,
            ),
            Experiment::at_most(
                "the same palpation twice: motions with other bits",
                OWN,
                f64::from(u8::from(!is_same)),
                0.0,
            ),
        ]
    }

    fn figures(&self) -> [Figure; 2] {
        let (aslant, published) = (&self.aslant, &self.published_aslant);
        [
            figure(
                "active_trocar_palpation.svg",
                "The simulated board palpates the liver at pitch 20, roll -29 degrees: the force of the tissue, and what the hand \
                 holds against, along and across the instrument.",
                ["Palpation of a liver through the active trocar's board", "time [s]", "force [N]"],
                vec![
                    line("along: hand", aslant.column(4)),
                    line("along: tissue", aslant.column(3)),
                    line("across: hand", aslant.column(6)),
                    line("across: tissue", aslant.column(5)),
                    line("across: hand, eq. 5.6", published.column(6)),
                ],
            ),
            figure(
                "active_trocar_insertion.svg",
                "The same palpation: where the hand wants the tip, and where the force lets it go.",
                ["Insertion during palpation", "time [s]", "insertion [mm]"],
                vec![dashed("wanted", aslant.column(1)), line("got", aslant.column(2))],
            ),
        ]
    }
}

fn palpation(patient: &Patient, outcome: &mut Outcome) -> anyhow::Result<()> {
    let palpations = Palpations::of(patient)?;
    outcome.experiments.extend(palpations.experiments());
    outcome.figures.extend(palpations.figures());
    let Palpations { aslant, published_aslant, .. } = &palpations;
    outcome.notes += &format!(
        "\nPalpation of the liver at pitch 20, roll -29 degrees by the equations of the thesis: the force on the hand is {:.0} % off \
         that of the tissue ({}). {:.0} bytes a tick; driver and simulated board take {:.1} us of processor time a tick.\n",
        100.0 * published_aslant.off(),
        published_aslant.at_limit(),
        aslant.bytes_per_tick,
        1e-3 * aslant.cpu_ns_per_tick,
    );
    Ok(())
}

/// The palpation through the whole haptic law: the world steps fifty times a second, the board a thousand times.
fn through_the_law(patient: &Patient, outcome: &mut Outcome) -> anyhow::Result<()> {
    let start = pressed(TILTED, 0.0);
    let station = Station::new(patient.before(TILTED), &start, Mapping::VirtualWork)?;
    let step_s = TICK_S * f64::from(TICKS_PER_STEP);
    let (mut world, n_parts) = world(&patient.mesh, probe(&station.placement, &start), step_s)?;
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
