//! The simulated board in a closed loop with a world: the trocar's pose drives a tool, the tissue's force goes back.

use super::{EXACT, OWN, PROTOTYPE, figure, line, tilted};
use crate::bench::body::StandardBody;
use crate::validate::{Experiment, Outcome};
use anyhow::{Context, anyhow};
use glam::DVec3;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::statics::{efforts, felt};
use glisson::haptics::trocar::teleoperation::{End, Teleoperation};
use glisson::haptics::trocar::{
    Arrangement, AxisEfforts, InstrumentTag, InstrumentType, MOST_TROCARS, Mapping, Placement, TrocarJoints,
    TrocarProfile, Wrench,
};
use glisson::haptics::{DeviceFault, ForceCommand, HapticDevice};
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{Region, Support, WorldSpec};
use glisson::world::{StepInput, World};
use glisson_runtime::devices::trocar_board::{
    BoardSettings, SimulatedBoard, SimulatedLine, TcpLine, TrocarDevice, connect, serve_board, simulated,
};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

pub(super) const TICK_S: f64 = 1e-3;
/// Tetrahedra of the organ that several trocars and a led one palpate: a tenth of a second to pre-compute.
const N_TETRAHEDRA: usize = 2_000;
/// From the organ's highest place to the first trocar, and where that place is [m].
const ABOVE_M: f64 = 0.1;
const TOP_M: f64 = 0.06;
pub(super) const TIP_RADIUS_M: f64 = 5e-3;

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<()> {
    four_trocars(outcome)?;
    instruments(outcome)?;
    remote_palpation(outcome)?;
    over_tcp(outcome)
}

/// The ellipsoid of the benchmarks, as soft as a liver, and a probe in each trocar above it.
fn world(placements: &[Placement], homes: &[TrocarJoints], step_s: f64) -> anyhow::Result<World> {
    let body = StandardBody::shared(N_TETRAHEDRA)?;
    let model = Precomputed::build(&PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.fixed_nodes,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })?;
    let tools: Vec<Tool> = placements
        .iter()
        .zip(homes)
        .map(|(placement, home)| Tool {
            trocar_m: Some(placement.pivot_in_world_m),
            ..Tool::probe("probe", TIP_RADIUS_M, placement.tool_input(home))
        })
        .collect();
    let lowest = body.fixed_nodes.iter().map(|n| body.mesh.positions_m[n.index()].z);
    let highest_held_m = lowest.fold(f64::NEG_INFINITY, f64::max);
    let bounds =
        glisson::math::Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, highest_held_m + 1e-9) };
    let mut spec = WorldSpec::new("ellipsoid", step_s, tools[0].clone());
    spec.tools = tools;
    spec.supports = vec![Support::all_axes(Region::Box(bounds))];
    Ok(World::new(spec, body.mesh.clone(), Box::new(model), ModelKind::Precomputed)?)
}

/// A trocar in a hand, over its board's bytes.
pub(super) struct Station {
    pub(super) device: TrocarDevice<SimulatedLine>,
    pub(super) placement: Placement,
    pub(super) force_in_world_n: DVec3,
}

#[allow(clippy::needless_pass_by_value, reason = "map_err passes it so")]
pub(super) fn fault(fault: DeviceFault) -> anyhow::Error {
    anyhow!("the simulated board: {fault:?}")
}

impl Station {
    pub(super) fn new(placement: Placement, start: &TrocarJoints, mapping: Mapping) -> anyhow::Result<Self> {
        let settings = BoardSettings { mapping, ..BoardSettings::new(TrocarProfile::built()) };
        let mut device = simulated(settings, 61);
        device.line_mut().board.mechanism = Mechanism::new(settings.profile, *start);
        anyhow::ensure!(device.greet()?, "the simulated board answers at once");
        Ok(Self { device, placement, force_in_world_n: DVec3::ZERO })
    }

    pub(super) fn hand(&mut self, target: TrocarJoints) {
        self.device.line_mut().board.mechanism.hand_target = Some(target);
    }

    /// Reads the device: the tool that it stands for.
    pub(super) fn read(&mut self) -> anyhow::Result<ToolInput> {
        self.device.read().map_err(fault)?;
        let reading = self.device.reading()?;
        Ok(self.placement.tool_input(&reading.joints))
    }

    /// Gives the device the force of the tissue.
    pub(super) fn write(&mut self, force_in_world_n: DVec3) -> anyhow::Result<()> {
        self.force_in_world_n = force_in_world_n;
        let force_n = self.placement.world_from_device.transpose() * force_in_world_n;
        self.device.write(&ForceCommand { force_n, ..ForceCommand::default() }).map_err(fault)
    }

    pub(super) fn mechanism(&mut self) -> &Mechanism {
        &self.device.line_mut().board.mechanism
    }

    /// What the hand holds against, as a force at the tip in the world [N].
    pub(super) fn on_hand_n(&mut self) -> DVec3 {
        let world_from_device = self.placement.world_from_device;
        let mechanism = self.mechanism();
        let efforts = AxisEfforts::from_array(mechanism.hand_efforts().map(|effort| -effort));
        world_from_device * felt(&mechanism.joints, &efforts).force_n
    }
}

/// The tip at `share` of its way in: from 10 mm above the organ to 15 mm deep, if the hand did not yield.
fn pressed(tilt_rad: [f64; 2], share: f64) -> TrocarJoints {
    let joints = tilted(tilt_rad);
    // Where the axis meets the ellipsoid of half axes 15, 10 and 6 cm, seen from above its middle.
    let d = joints.direction();
    let half = DVec3::new(0.15, 0.10, TOP_M);
    let (o, v) = (DVec3::new(0.0, 0.0, TOP_M + ABOVE_M) / half, DVec3::new(d.x, d.y, -d.z) / half);
    let (a, b, c) = (v.dot(v), o.dot(v), o.dot(o) - 1.0);
    let surface_m = (-b - (b * b - a * c).max(0.0).sqrt()) / a;
    TrocarJoints { insertion_m: surface_m - TIP_RADIUS_M - 0.01 + 0.025 * share, ..joints }
}

fn above() -> Placement {
    Placement::facing(DVec3::new(0.0, 0.0, TOP_M + ABOVE_M), DVec3::NEG_Z)
}

/// Four hands at once, their trocars 100 mm apart.
fn four_trocars(outcome: &mut Outcome) -> anyhow::Result<()> {
    let profile = TrocarProfile::built();
    let first = above();
    let corner_m = first.to_world_m(DVec3::new(-0.05, -0.05, 0.0));
    let corner = Placement { pivot_in_world_m: corner_m, ..first };
    let stand = Arrangement::adjacent(profile, corner, MOST_TROCARS)?;
    let inserted = |insertion_m: f64| TrocarJoints { insertion_m, ..TrocarJoints::default() };
    let start = inserted(ABOVE_M - TIP_RADIUS_M);
    let mut stations = Vec::new();
    for placement in stand.placements() {
        stations.push(Station::new(*placement, &start, Mapping::VirtualWork)?);
    }
    let mut world = world(stand.placements(), &[start; MOST_TROCARS], TICK_S)?;
    for k in 0..1500 {
        let share = (f64::from(k) * TICK_S).min(1.0);
        let mut tools = Vec::with_capacity(MOST_TROCARS);
        for station in &mut stations {
            station.hand(inserted(start.insertion_m + 0.035 * share));
            tools.push(station.read()?);
        }
        let report = world.step(&StepInput::of(&tools));
        for (station, tool) in stations.iter_mut().zip(&report.tools) {
            station.write(tool.force_on_tool_n)?;
        }
    }
    let (mut worst, mut least_n) = (0.0_f64, f64::INFINITY);
    for station in &mut stations {
        let tissue_n = station.force_in_world_n;
        least_n = least_n.min(tissue_n.length());
        worst = worst.max(station.on_hand_n().distance(tissue_n) / tissue_n.length().max(1e-9));
    }
    let clearance_m = stand.clearance_m([0, 1], [&start, &start], 0.25);
    outcome.experiments.extend([
        Experiment::near(
            "four trocars on one organ: between the axes of two of them [m]",
            PROTOTYPE,
            clearance_m,
            0.1,
            1e-9,
        ),
        Experiment::within(
            "the same: least force of the tissue on one of the four [N]",
            OWN,
            least_n,
            [0.1, 5.0],
        ),
        Experiment::at_most(
            "the same: force on the hand less that of the tissue, worst, relative",
            OWN,
            worst,
            0.02,
        ),
    ]);
    Ok(())
}

/// All instruments, one after the other.
fn instruments(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut device = simulated(BoardSettings::new(TrocarProfile::built()), 62);
    anyhow::ensure!(device.greet()?, "the simulated board answers at once");
    let mut n_identified = 0_u32;
    for (instrument, serial) in InstrumentType::ALL.into_iter().zip(1..) {
        device.line_mut().board.change_instrument(None);
        let missing = device.read().is_err() && device.instrument().is_none();
        let tag = InstrumentTag { instrument, serial };
        device.line_mut().board.change_instrument(Some(tag));
        // Pushed in through O, its insertion is known; turned and closed by the hand, the rest.
        let is_known = (0..2000).any(|_| device.read().is_ok());
        n_identified += u32::from(missing && is_known && device.instrument() == Some(tag));
    }
    // A tag that cannot be read, and an instrument that the scene does not have.
    let settings = BoardSettings { tool_kind: Some("probe"), ..BoardSettings::new(TrocarProfile::built()) };
    let mut of_a_scene = simulated(settings, 64);
    anyhow::ensure!(of_a_scene.greet()?, "the simulated board answers at once");
    let fits = of_a_scene.read().is_ok();
    of_a_scene.line_mut().board.smear_tag(true);
    let is_unreadable = of_a_scene.read().is_err();
    of_a_scene.line_mut().board.smear_tag(false);
    let other = InstrumentTag { instrument: InstrumentType::Scissors, serial: 2 };
    of_a_scene.line_mut().board.hold_instrument(other);
    let is_refused = of_a_scene.read().is_err() && of_a_scene.check_instrument().is_err();
    // The stop button: nothing is read, nothing pushes.
    device.line_mut().board.press_stop(true);
    let stopped = device.read().is_err();
    device.write(&ForceCommand { force_n: DVec3::ONE, ..ForceCommand::default() }).map_err(fault)?;
    let board: &SimulatedBoard = &device.line_mut().board;
    let rests = board.motor_efforts() == AxisEfforts::default() && board.last_refusal().is_none();
    outcome.experiments.extend([
        Experiment::near(
            "instruments that were missed, inserted, and identified by their tags",
            "s. 5.3.1: about ten",
            f64::from(n_identified),
            InstrumentType::ALL.len() as f64,
            0.0,
        ),
        Experiment::at_most(
            "an unreadable tag, or an instrument that the scene does not have, is not refused",
            OWN,
            f64::from(u8::from(!(fits && is_unreadable && is_refused))),
            0.0,
        ),
        Experiment::at_most(
            "motors that run while the stop is pressed",
            OWN,
            f64::from(u8::from(!(stopped && rests))),
            0.0,
        ),
    ]);
    Ok(())
}

/// Two trocars that are coupled; the second one's instrument palpates.
struct Teleoperated {
    leader: Station,
    follower: Station,
    link: Teleoperation,
    world: World,
}

impl Teleoperated {
    fn new(start: &TrocarJoints) -> anyhow::Result<Self> {
        let leader = Station::new(above(), start, Mapping::VirtualWork)?;
        let mut follower = Station::new(above(), start, Mapping::VirtualWork)?;
        follower.device.line_mut().board.mechanism.hand_target = None;
        let world = world(&[follower.placement], &[*start], TICK_S)?;
        let link = Teleoperation::couple(TrocarProfile::built(), [start, start], 1.0);
        Ok(Self { leader, follower, link, world })
    }

    /// Insertion of leader and follower [mm], then the force of the tissue and the one on the leader's hand, along the
    /// instrument [N], after a tick with the leader's hand there.
    fn tick(&mut self, target: TrocarJoints) -> anyhow::Result<[f64; 4]> {
        let Self { leader, follower, link, world } = self;
        leader.hand(target);
        leader.read()?;
        let tool = follower.read()?;
        let report = world.step(&StepInput::of(&[tool]));
        let force_in_world_n = report.tools[0].force_on_tool_n;
        let at = |station: &Station| -> anyhow::Result<End> {
            let reading = station.device.reading()?;
            Ok(End { joints: reading.joints, rates: reading.rates })
        };
        let exchange = link.tick(&at(leader)?, &at(follower)?);
        leader.device.write_efforts(&exchange.leader).map_err(fault)?;
        follower.device.write_efforts(&exchange.follower).map_err(fault)?;
        // The remote tissue acts on the remote instrument itself.
        let contact = follower.placement.contact(tool.tip_in_world_m, force_in_world_n);
        let joints = follower.mechanism().joints;
        let outside = efforts(Mapping::VirtualWork, &joints, &Wrench::of(&[contact]), 0.0);
        follower.device.line_mut().board.outside = outside;
        let inward = -tool.shaft_in_world;
        let (tissue_n, hand_n) = (-force_in_world_n.dot(inward), -leader.on_hand_n().dot(inward));
        let [lead_mm, follow_mm] =
            [leader, follower].map(|station| 1e3 * station.mechanism().joints.insertion_m);
        Ok([lead_mm, follow_mm, tissue_n, hand_n])
    }
}

/// The leader's pose drives a second trocar, whose instrument palpates; its forces come back.
fn remote_palpation(outcome: &mut Outcome) -> anyhow::Result<()> {
    let tilt_rad = [0.0, 0.2];
    let mut pair = Teleoperated::new(&pressed(tilt_rad, 0.0))?;
    let mut rows = Vec::new();
    let (mut mean_tissue_n, mut mean_hand_n, n_mean) = (0.0, 0.0, 500);
    let n_ticks = 3000;
    for k in 0..n_ticks {
        let t = f64::from(k) * TICK_S;
        let [lead_mm, follow_mm, tissue_n, hand_n] = pair.tick(pressed(tilt_rad, (0.5 * t).min(1.0)))?;
        if k >= n_ticks - n_mean {
            mean_tissue_n += tissue_n / f64::from(n_mean);
            mean_hand_n += hand_n / f64::from(n_mean);
        }
        rows.push([t, lead_mm, follow_mm, tissue_n, hand_n]);
    }
    outcome.experiments.extend([
        Experiment::within(
            "teleoperation: force of the remote tissue [N]",
            "s. 5.5",
            mean_tissue_n,
            [0.3, 5.0],
        ),
        Experiment::near(
            "teleoperation: force on the leader's hand, mean over half a second [N]",
            "the remote tissue's",
            mean_hand_n,
            mean_tissue_n,
            0.05,
        ),
    ]);
    let column = |i: usize| -> Vec<[f64; 2]> { rows.iter().step_by(6).map(|row| [row[0], row[i]]).collect() };
    outcome.figures.push(figure(
        "active_trocar_teleoperation.svg",
        "A trocar leads a second one, which palpates: the force of the remote tissue and the one on the leader's hand.",
        ["Teleoperation with two active trocars", "time [s]", "force along the instrument [N]"],
        vec![line("leader's hand", column(4)), line("remote tissue", column(3))],
    ));
    let lag_mm = rows.last().map_or(f64::NAN, |row| row[1] - row[2]);
    outcome.notes += &format!(
        "\nTeleoperation: the follower stays {lag_mm:.2} mm behind the leader where the tissue pushes with {mean_tissue_n:.2} N, \
         as a coupling of 1500 N/m does.\n"
    );
    Ok(())
}

/// A board behind a socket of this machine: the same bytes, with the board's own clock.
fn over_tcp(outcome: &mut Outcome) -> anyhow::Result<()> {
    let listener = TcpListener::bind("127.0.0.1:0").context("a port of this machine")?;
    let address = listener.local_addr()?.to_string();
    let stop = Arc::new(AtomicBool::new(false));
    let served = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || -> anyhow::Result<()> {
            let profile = TrocarProfile::built();
            let start = TrocarJoints { insertion_m: 0.1, ..TrocarJoints::default() };
            let tag = InstrumentTag { instrument: InstrumentType::PalpationProbe, serial: 1 };
            let mut board = SimulatedBoard::new(Mechanism::new(profile, start), tag, 63).homed();
            Ok(serve_board(TcpLine::new(listener.accept()?.0)?, &mut board, &stop)?)
        }
    });
    let mut device = connect(&address, BoardSettings::new(TrocarProfile::built()))?;
    // The board has its own clock: on a busy machine it ticks slower, so what counts is where it comes to rest.
    let rest_m = 0.1 - 1.0 / 400.0;
    let until = Instant::now() + PATIENCE;
    let push = ForceCommand { force_n: DVec3::NEG_Z, ..ForceCommand::default() };
    let mut off_m = f64::INFINITY;
    while off_m > MOST_OFF_M && Instant::now() < until {
        if let Ok(state) = device.read() {
            off_m = (state.position_m.length() - rest_m).abs();
            device.write(&push).map_err(fault)?;
        }
        std::thread::sleep(Duration::from_micros(500));
    }
    let report = device.report();
    stop.store(true, Ordering::Relaxed);
    served.join().map_err(|_| anyhow!("the board's thread panicked"))??;
    outcome.experiments.extend([
        Experiment::at_most(
            "board behind a socket: 1 N pushes a hand of 400 N/m back by 2.5 mm: off by [m]",
            EXACT,
            off_m,
            MOST_OFF_M,
        ),
        Experiment::at_most(
            "board behind a socket: frames lost or refused",
            OWN,
            (report.n_lost + report.n_refused + report.n_refused_by_board) as f64,
            0.0,
        ),
    ]);
    let identity = device.identity().context("a board that was greeted")?;
    outcome.notes += &format!(
        "\nOver the socket it took {} states of a board that promised {} a second.\n",
        report.n_states, identity.rate_hz
    );
    Ok(())
}

/// A step of the encoder and half of one [m].
const MOST_OFF_M: f64 = 1.5e-4;
/// How long a hand may take to come to rest on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(20);
