//! Replays a session and says whether it made the same bits; goes on with one that was cut off, or from any step of one.

use crate::account::Account;
use crate::{OpenScene, Simulation, Turn};
use anyhow::{Context, anyhow, bail, ensure};
use glisson::math::Arithmetic;
use glisson::mesh::refine::FineRegion;
use glisson::model::StateHash;
use glisson::progress::{part, tell};
use glisson::record::session::{SESSION_VERSION, Session, SessionEvent, parse_session};
use glisson::scene::Scene;
use glisson::training::task::{TaskRecord, TaskRun};
use glisson::world::StepInput;
use std::path::Path;

/// Steps from one word of how far it is to the next.
const STEPS_OF_NEWS: u64 = 100;
/// What is told of the making of a scene before its session is replayed: a choice.
const SHARE_OF_MAKING: f64 = 0.3;

/// What a replay found.
pub struct ReplayReport {
    /// Steps made.
    pub steps: u64,
    /// Hash of the state at the end.
    pub state_hash: StateHash,
    /// Hash that the recording ended with; none when it was cut off before.
    pub recorded_hash: Option<StateHash>,
    /// First check-point whose hash differs.
    pub first_difference: Option<u64>,
    /// Check-points compared.
    pub checkpoints: u64,
    /// The recording's, where it is another than here: then bits may differ.
    pub other_arithmetic: Option<Arithmetic>,
    /// What the session did to the organ.
    pub account: Account,
    /// What was written down of the scene's task, if it has one.
    pub task: Option<TaskRecord>,
}

/// Reads a session file.
pub fn read_session(path: &Path) -> anyhow::Result<Session> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("{}: cannot read the session", path.display()))?;
    parse_session(&text).map_err(|e| anyhow!("{}: {e}", path.display()))
}

/// The simulation of the session's scene, with the mesh of the recording.
fn open_recorded(session: &Session, folder: &Path, n_threads: usize) -> anyhow::Result<Simulation> {
    let scene = Scene::parse_recorded(&session.header)
        .map_err(|e| anyhow!("the scene in the session's header: {e}"))?;
    let origin = "the session's scene".to_string();
    let source = OpenScene { scene, folder: folder.to_path_buf(), origin, n_threads };
    let mut simulation = Simulation::open(source, None).map_err(|e| {
        let folder = folder.display();
        anyhow!(
            "{e:#}; the scene's files are looked for from {folder}/ on; give the right folder with --folder"
        )
    })?;
    simulation.leave_orders_to_the_session();
    let found = simulation.mesh_hash();
    if found != session.header.mesh_hash {
        bail!(
            "the mesh is not the one of the recording: BLAKE3 {found}, recorded {}; give the right folder with --folder",
            session.header.mesh_hash
        );
    }
    Ok(simulation)
}

/// How a replay compares with the recording.
#[derive(Default)]
struct Compared {
    recorded_hash: Option<StateHash>,
    first_difference: Option<u64>,
    checkpoints: u64,
}

/// Replays `session` with the scene's files in `folder`; `after_step` sees the simulation after every step.
pub fn replay(
    session: &Session,
    folder: &Path,
    after_step: impl FnMut(&Simulation) -> anyhow::Result<()>,
) -> anyhow::Result<ReplayReport> {
    let mut simulation = open_recorded(session, folder, 1)?;
    let recorded = session.header.arithmetic;
    let other_arithmetic = (recorded != Arithmetic::here()).then_some(recorded);
    let Compared { recorded_hash, first_difference, checkpoints } =
        follow(session, last_step(session), &mut simulation, after_step)?;
    Ok(ReplayReport {
        other_arithmetic,
        steps: simulation.world().steps_made(),
        state_hash: simulation.world().state_hash(),
        recorded_hash,
        first_difference,
        checkpoints,
        account: Account::of(simulation.world()),
        task: simulation.task().map(TaskRun::record),
    })
}

/// A session that was cut off, live again: replayed to its last moment, where it stands still at first. It is recorded in `record`
/// from its beginning. Tells how far it is ([`glisson::progress`]).
///
/// # Errors
/// When it was not cut off, or when the replay does not make its bits: then it would go on from somewhere else.
pub fn resume(
    session: &Session,
    folder: &Path,
    record: &Path,
    n_threads: usize,
) -> anyhow::Result<Simulation> {
    ensure!(session.cut_off, "the session was not cut off: it has an end");
    check_version(session)?;
    let (recorded, here) = (session.header.arithmetic, Arithmetic::here());
    ensure!(
        recorded == here,
        "the session was recorded in {} arithmetic and cannot be gone on with in {} arithmetic",
        recorded.name(),
        here.name()
    );
    let mut simulation = open_recorded(session, folder, n_threads)?;
    let n_steps = last_step(session);
    let compared = follow(session, n_steps, &mut simulation, |simulation| tell_of(simulation, n_steps))?;
    if let Some(step) = compared.first_difference {
        bail!(
            "the session cannot be gone on with: replayed by this program it differs from the check-point of step {step} on"
        );
    }
    simulation.go_on(session, folder, record)?;
    Ok(simulation)
}

/// A session from its step `at_step` on, live: as it was right after that step, where it stands still at first, and recorded in `record`
/// from its beginning, as if nothing had come after. In another arithmetic than the recording's it is there with other bits. Tells how
/// far it is ([`glisson::progress`]).
///
/// # Errors
/// A session of an older version, or without that step; when its scene cannot be made, or has another mesh.
pub fn take_over(
    session: &Session,
    at_step: u64,
    folder: &Path,
    record: &Path,
) -> anyhow::Result<Simulation> {
    check_version(session)?;
    let last = last_step(session);
    ensure!(at_step <= last, "step {at_step} was asked for; the session has {last}");
    let mut taken = session.clone();
    taken.header.arithmetic = Arithmetic::here();
    taken.events.retain(|event| match event {
        // They are of the recording's bits.
        SessionEvent::Checkpoint { .. } | SessionEvent::End { .. } => false,
        _ => event.step() < at_step || event.step() == at_step && came_with_its_step(event),
    });
    let mut simulation = part(0.0, SHARE_OF_MAKING, || open_recorded(session, folder, 1))?;
    part(SHARE_OF_MAKING, 1.0, || {
        follow(&taken, at_step, &mut simulation, |simulation| tell_of(simulation, at_step))
    })?;
    simulation.go_on(&taken, folder, record)?;
    Ok(simulation)
}

fn last_step(session: &Session) -> u64 {
    session.events.last().map_or(0, SessionEvent::step)
}

/// Whether the step itself brought what a session says of it: what somebody did came after it.
fn came_with_its_step(event: &SessionEvent) -> bool {
    matches!(
        event,
        SessionEvent::TearVessel { .. } | SessionEvent::Gravity { .. } | SessionEvent::Note { .. }
    )
}

/// That the session can be gone on with by this program.
///
/// # Errors
/// One of an older version.
pub fn check_version(session: &Session) -> anyhow::Result<()> {
    ensure!(
        session.header.version == SESSION_VERSION,
        "the session has version {} and cannot be gone on with; this program writes version {SESSION_VERSION}. \
         `glisson replay` replays it",
        session.header.version
    );
    Ok(())
}

/// Tells now and then how far a replay of `n_steps` is.
fn tell_of(simulation: &Simulation, n_steps: u64) -> anyhow::Result<()> {
    let step = simulation.world().steps_made();
    if step.is_multiple_of(STEPS_OF_NEWS) {
        tell(step as f64 / n_steps.max(1) as f64);
    }
    Ok(())
}

/// Makes the session's steps, and those after its last event up to `n_steps`.
fn follow(
    session: &Session,
    n_steps: u64,
    simulation: &mut Simulation,
    mut after_step: impl FnMut(&Simulation) -> anyhow::Result<()>,
) -> anyhow::Result<Compared> {
    let homes: Vec<_> = simulation.world().tools().iter().map(|tool| tool.home).collect();
    let mut input = StepInput::of(&homes);
    let mut compared = Compared::default();
    for event in &session.events {
        while simulation.world().steps_made() < event.step() {
            simulation.advance(&input)?;
            after_step(simulation)?;
        }
        match *event {
            SessionEvent::Input { ref tools, n_substeps, ref placed, ref detected, .. } => {
                ensure!(
                    tools.len() == homes.len(),
                    "step {}: the session has {} instruments, its scene {}",
                    event.step(),
                    tools.len(),
                    homes.len()
                );
                input = StepInput::of(tools).divided(n_substeps);
                placed.iter().for_each(|&tool| input.placed[usize::from(tool)] = true);
                input.detected[..detected.len()].copy_from_slice(detected);
            }
            SessionEvent::UndoEdit { .. } => simulation.undo_edit()?,
            SessionEvent::Clip { tool, .. } => simulation.clip_vessel(usize::from(tool))?,
            SessionEvent::TearVessel { near_m, .. } => simulation.tear_vessel(near_m)?,
            SessionEvent::TaskEvent { number, .. } => simulation.let_event_come(number)?,
            SessionEvent::Refine { center_m, radius_m, edge_m, .. } => {
                simulation.refine(FineRegion { center_m, radius_m, edge_m })?;
            }
            SessionEvent::Effort { effort, .. } => drop(simulation.set_level_of_detail(effort)?),
            SessionEvent::Reset { .. } => simulation.reset()?,
            SessionEvent::Gravity { gravity_m_per_s2, .. } => simulation.set_gravity(gravity_m_per_s2)?,
            SessionEvent::Remove { ref tets, .. } => simulation.remove_tetrahedra(tets.clone())?,
            SessionEvent::QueueModelSwap { at_step, model, .. } => simulation.order_model(model, at_step)?,
            SessionEvent::Turn { at_step, body, parameter, value, .. } => {
                let turn = Turn { body: usize::from(body), parameter, value };
                simulation.turn(turn, Some(at_step))?;
            }
            // For who looks at the session.
            SessionEvent::Note { .. } => {}
            SessionEvent::Checkpoint { step, state_hash } => {
                compared.checkpoints += 1;
                if simulation.world().state_hash() != state_hash {
                    compared.first_difference.get_or_insert(step);
                }
            }
            SessionEvent::End { state_hash, .. } => compared.recorded_hash = Some(state_hash),
        }
    }
    while simulation.world().steps_made() < n_steps {
        simulation.advance(&input)?;
        after_step(simulation)?;
    }
    Ok(compared)
}
