//! The simulation loop of `glisson serve`: keeps pace with the clock, takes commands, publishes what is displayed.

use crate::effort::{EffortControl, Load};
use crate::elsewhere::NearbyMaker;
use crate::haptic_loop::{DeviceStatus, PublishedModel, ToolLink};
use crate::pace::{FRAME, Pace, PaceMeter, StepMeters, StepTimes};
use crate::published::{Lateness, Published};
use crate::realtime::now_ns;
use crate::shown::Shown;
use crate::simulation::{Broken, Simulation, Turn, panic_text};
use glisson::haptics::InsertedInstrument;
use glisson::math::DVec3;
use glisson::model::LevelOfDetail;
use glisson::model::StateHash;
use glisson::model::kind::ModelKind;
use glisson::record::note::Note;
use glisson::tool::external_detection::ExternalDetection;
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::StepInput;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// What a viewer asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// An instrument should be here.
    Tool {
        /// Its number.
        tool: usize,
        /// Where.
        pose: ToolInput,
    },
    /// Time stands still, or goes on.
    Pause(bool),
    /// Simulated time over wall time from now on, above 0 and up to 1.
    Speed(f64),
    /// One step, then a pause.
    SingleStep,
    /// Everything back to rest.
    Reset,
    /// Another model should take over.
    Model(ModelKind),
    /// The table is tilted: gravity from now on [m/s2].
    Gravity(DVec3),
    /// A number of the scene is turned.
    Turn(Turn),
    /// What the tip of an instrument touches is cut away.
    Cut {
        /// Its number.
        tool: usize,
    },
    /// The mesh is made finer around an instrument's tip.
    Refine {
        /// Which one, from 0.
        tool: usize,
    },
    /// An instrument sets a clip on the vessel nearest to its tip.
    Clip {
        /// Its number.
        tool: usize,
    },
    /// The last cut is undone.
    Undo,
    /// An event of the task comes.
    TaskEvent {
        /// Its number, from 0.
        number: u32,
    },
    /// Something is to be kept in the session.
    Note(Note),
    /// A viewer came, who looks from now on.
    Viewed,
    /// The program ends.
    Stop,
}

/// The simulation stands still for a while again and again: what the haptic loop must not feel.
#[derive(Clone, Debug)]
pub struct Stalls {
    /// From the beginning of one to the next.
    pub every: Duration,
    /// How long each takes, working all the time.
    pub length: Duration,
    /// Whether one is on, for whoever wants to know what happens meanwhile.
    pub is_on: Arc<AtomicBool>,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ended {
    /// Hash of the world's state at the end.
    pub state_hash: StateHash,
    /// Steps made.
    pub steps: u64,
    /// Stalls that were made.
    pub n_stalls: u64,
    /// What they took together.
    pub stalled: Duration,
    /// How far the simulation fell behind.
    pub lateness: Lateness,
    /// How long steps took.
    pub times: StepTimes,
}

/// How often what was recorded is handed to the system: half of what a crash may lose.
const KEEP_EVERY: Duration = Duration::from_millis(500);
/// A simulation that fell further behind than this drops the lag instead of running after it.
const MAX_LAG: Duration = Duration::from_millis(100);
/// Steps from an order to the moment another model takes over: half a second at 1 ms.
const SWAP_DELAY_STEPS: u64 = 500;

/// Until the next models for the haptic loop pass so many times the time that the last ones took: the models of a large organ
/// take as long as several of its steps ...
const PUBLISHING_PAUSE: u64 = 4;
/// ... but no more than this [ns], what their stiffness is for. Choices.
const LONGEST_PAUSE_NS: u64 = 33_000_000;

/// How the pointer's jumps become a hand's motion: the tip follows its target with this time constant [s] ...
const FOLLOW_TIME_S: f64 = 0.02;
/// ... and no faster than this [m/s].
const MAX_TIP_SPEED_M_PER_S: f64 = 1.0;

/// A target further away than this was not reached by moving the hand: the tool is put there [m].
/// Viewers move a tool that stays in the hand by at most 10 mm a message (`docs/protocol.md`); several messages can
/// wait while the tip follows.
pub(crate) const JUMP_M: f64 = 0.03;

/// Where the tool is one time step after `now` on its way to `target`.
pub(crate) fn approach(now: ToolInput, target: ToolInput, dt_s: f64) -> ToolInput {
    let share = 1.0 - (-dt_s / FOLLOW_TIME_S).exp();
    let motion = (target.tip_in_world_m - now.tip_in_world_m) * share;
    let shaft = now.shaft_in_world.lerp(target.shaft_in_world, share);
    let toward = |now: f64, target: f64| now + (target - now) * share;
    ToolInput {
        tip_in_world_m: now.tip_in_world_m + motion.clamp_length_max(MAX_TIP_SPEED_M_PER_S * dt_s),
        shaft_in_world: shaft.normalize_or(target.shaft_in_world),
        roll_rad: toward(now.roll_rad, target.roll_rad),
        jaw_opening: toward(now.jaw_opening, target.jaw_opening),
        // A switch, not a motion.
        trigger: target.trigger,
    }
}

struct Live {
    simulation: Simulation,
    tools: Vec<ToolInput>,
    targets: Vec<ToolInput>,
    /// Instruments in the hand of a device.
    links: Vec<ToolLink>,
    /// What was found elsewhere for each of them.
    detected: [Option<ExternalDetection>; MAX_TOOLS],
    elsewhere: NearbyMaker,
    /// When the last models were published, and how long that took [ns].
    published_ns: u64,
    publishing_ns: u64,
    paused: bool,
    /// Simulated time over wall time.
    speed: f64,
    dt_s: f64,
}

/// Where the instruments are when nobody holds them.
fn homes(simulation: &Simulation) -> Vec<ToolInput> {
    simulation.world().tools().iter().map(|tool| tool.home).collect()
}

impl Live {
    /// Simulated time of a step, which may be turned.
    fn step(&self) -> Duration {
        Duration::from_secs_f64(self.dt_s)
    }

    /// Where the devices have their instruments, and what the user should know about them.
    fn read_devices(&mut self) {
        for link in &mut self.links {
            let motion = link.motions.get();
            self.detected[link.tool] = motion.detected.filter(|_| motion.is_held);
            if motion.is_held && motion.pose.is_finite() {
                // A hand moves as it moves: nothing is smoothed.
                self.targets[link.tool] = motion.pose;
                let jumps =
                    self.tools[link.tool].tip_in_world_m.distance(motion.pose.tip_in_world_m) > JUMP_M;
                if !jumps {
                    self.tools[link.tool] = motion.pose;
                }
            }
            match link.statuses.get_new() {
                Some(DeviceStatus::Lost(why)) => {
                    self.simulation.tell(format!("the device {} was lost: {why}", link.device_name));
                }
                Some(DeviceStatus::Failed(why)) => {
                    self.simulation.tell(format!("the device {} failed: {why}", link.device_name));
                }
                Some(DeviceStatus::WorksWith(InsertedInstrument { name, serial })) => {
                    let device = &link.device_name;
                    self.simulation
                        .tell_news(format!("the device {device} works; in it: {name}, number {serial}"));
                }
                Some(DeviceStatus::Works) => {
                    self.simulation.tell_news(format!("the device {} works", link.device_name));
                }
                Some(DeviceStatus::Waiting) | None => {}
            }
        }
    }

    fn publish_models(&mut self) {
        let begun_ns = now_ns();
        let pause_ns = (PUBLISHING_PAUSE * self.publishing_ns).min(LONGEST_PAUSE_NS);
        if self.links.is_empty() || begun_ns - self.published_ns < pause_ns {
            return;
        }
        let n_elsewhere = self.links.iter().filter(|link| link.nearby.is_some()).count();
        for link in &mut self.links {
            // Before the model, whose arrival wakes the one who sends both.
            if let Some(nearby) = &mut link.nearby {
                nearby.publish(self.elsewhere.at(&self.simulation, link.tool, n_elsewhere));
            }
            let model = self.simulation.haptic_model(link.tool);
            link.models.publish(PublishedModel { model, made_ns: now_ns() });
        }
        self.published_ns = now_ns();
        self.publishing_ns = self.published_ns - begun_ns;
    }

    fn advance(&mut self) -> anyhow::Result<()> {
        self.read_devices();
        let mut placed = [false; MAX_TOOLS];
        for (i, placed) in placed.iter_mut().enumerate().take(self.tools.len()) {
            let (tool, target) = (&mut self.tools[i], &mut self.targets[i]);
            if let Some(pose) = self.simulation.scripted_pose(i) {
                (*tool, *target) = (pose, pose);
                continue;
            }
            *placed = tool.tip_in_world_m.distance(target.tip_in_world_m) > JUMP_M;
            *tool = if *placed { *target } else { approach(*tool, *target, self.dt_s) };
        }
        let detected = self.detected;
        self.simulation.advance(&StepInput { placed, detected, ..StepInput::of(&self.tools) })?;
        self.dt_s = self.simulation.world().spec().time_step_s;
        self.publish_models();
        Ok(())
    }

    fn choose_level_of_detail(&mut self, effort: LevelOfDetail, load: Load) -> anyhow::Result<()> {
        let before = self.simulation.world().effort();
        let matters = self.simulation.set_level_of_detail(effort)?;
        let (name, is_less) = (effort.name(), effort < before);
        if matters && is_less {
            // What was meant to happen then: no fault of anybody.
            self.simulation.tell_news(format!("the simulation is late: it computes with {name} effort now"));
        } else if matters {
            self.simulation
                .tell_news(format!("the simulation keeps pace again: it computes with {name} effort"));
        } else if is_less && before == LevelOfDetail::Full {
            self.simulation.tell_slow_time(load.real_time_factor);
        } else if effort == LevelOfDetail::Full {
            self.simulation.tell_news("the simulation keeps pace again".to_owned());
        }
        Ok(())
    }

    /// Slow motion, where nothing depends on the time that passes for a person. What it does to the instruments is recorded with their
    /// poses.
    fn take_speed(&mut self, speed: f64) {
        if self.simulation.task().is_some() {
            self.simulation
                .tell("a task is done in real time: slow motion would change what is measured".to_owned());
        } else if !self.links.is_empty() {
            self.simulation
                .tell("slow motion: a device holds an instrument, whose forces are for real time".to_owned());
        } else {
            self.speed = speed;
        }
    }

    /// Answers whether the display has to be refreshed at once.
    fn obey(&mut self, command: Command) -> anyhow::Result<bool> {
        match command {
            Command::Tool { tool, .. } if self.links.iter().any(|link| link.tool == tool) => {
                let device = self.links.iter().find(|link| link.tool == tool).map(|l| l.device_name.clone());
                let device = device.unwrap_or_default();
                self.simulation.tell(format!("instrument {tool} is in the hand of the device {device}"));
            }
            Command::Tool { tool, pose } => match self.targets.get_mut(tool) {
                Some(target) => {
                    *target = pose;
                    self.simulation.take_from_script(tool);
                }
                None => self.simulation.refuse_tool(tool),
            },
            Command::Pause(paused) => {
                self.paused = paused;
                return Ok(true);
            }
            Command::Speed(speed) => self.take_speed(speed),
            Command::SingleStep => {
                self.paused = true;
                self.advance()?;
                return Ok(true);
            }
            Command::Reset => {
                self.simulation.reset()?;
                self.tools = homes(&self.simulation);
                self.targets.clone_from(&self.tools);
                return Ok(true);
            }
            Command::Model(kind) => {
                let at_step = self.simulation.world().steps_made() + SWAP_DELAY_STEPS;
                self.simulation.order_model(kind, at_step)?;
            }
            Command::Cut { tool } if tool < self.tools.len() => {
                self.simulation.cut_at_tip(tool)?;
                return Ok(true);
            }
            Command::Cut { tool } => self.simulation.refuse_tool(tool),
            Command::Clip { tool } => {
                self.simulation.clip_vessel(tool)?;
                return Ok(true);
            }
            Command::Refine { tool } => {
                self.simulation.refine_around(tool)?;
                return Ok(true);
            }
            Command::Undo => {
                self.simulation.undo_edit()?;
                return Ok(true);
            }
            Command::TaskEvent { number } => {
                self.simulation.let_event_come(number)?;
                return Ok(true);
            }
            Command::Gravity(gravity_m_per_s2) => self.simulation.set_gravity(gravity_m_per_s2)?,
            Command::Turn(turn) => {
                self.simulation.turn(turn, None)?;
                return Ok(true);
            }
            Command::Note(note) => {
                self.simulation.note(note);
                return Ok(true);
            }
            Command::Viewed => self.simulation.show_begins(),
            Command::Stop => {}
        }
        Ok(false)
    }
}

/// Runs until [`Command::Stop`] or until all senders are gone, then ends the recording. The instruments of `links` are
/// moved by devices. A simulation that broke stands still from then on: its session is kept, displays are told, and the
/// loop goes on until it is stopped.
///
/// # Errors
/// What stopped the simulation; the recording up to there is kept. [`Broken`] at the end of one that broke.
pub fn run(
    simulation: Simulation,
    commands: &Receiver<Command>,
    shown: Shown,
    links: Vec<ToolLink>,
    stalls: Option<&Stalls>,
) -> anyhow::Result<Ended> {
    let mut timed = Timed::start(simulation, shown, links, stalls);
    loop {
        match commands.recv_timeout(timed.wait()) {
            Ok(Command::Stop) | Err(RecvTimeoutError::Disconnected) => return timed.end(),
            Ok(command) => timed.obey(command)?,
            Err(RecvTimeoutError::Timeout) => {}
        }
        timed.stall();
        timed.turn()?;
    }
}

/// A live simulation whose turns its owner makes, on the owner's thread: for a browser's page, which has one for it.
pub struct Turns(Timed<'static>);

impl Turns {
    /// As [`run`], without devices.
    pub fn start(simulation: Simulation) -> Self {
        let shown = Shown::alone(&simulation);
        Self(Timed::start(simulation, shown, Vec::new(), None))
    }

    /// What displays show.
    pub fn shown(&self) -> &Arc<Published> {
        &self.0.shown.latest
    }

    /// Does what a viewer asks for; [`Command::Stop`] is nothing to it.
    ///
    /// # Errors
    /// As [`run`].
    pub fn obey(&mut self, command: Command) -> anyhow::Result<()> {
        self.0.obey(command)
    }

    /// Steps until the clock is reached or a frame is due. Answers how long there is nothing to do then.
    ///
    /// # Errors
    /// As [`run`].
    pub fn turn(&mut self) -> anyhow::Result<Duration> {
        self.0.turn().map(|()| self.0.wait())
    }

    /// From here on a crash of the program loses nothing of what was recorded before.
    pub fn keep_session(&mut self) {
        self.0.live.simulation.keep_session();
    }
}

/// The simulation against the clock.
struct Timed<'a> {
    live: Live,
    shown: Shown,
    meters: Arc<StepMeters>,
    pace: PaceMeter,
    control: EffortControl,
    lateness: Lateness,
    simulated_until: Instant,
    next_frame: Instant,
    next_keeping: Instant,
    last_shown: Option<Instant>,
    wants_refresh: bool,
    stalls: Option<&'a Stalls>,
    next_stall: Option<Instant>,
    n_stalls: u64,
    stalled: Duration,
}

impl<'a> Timed<'a> {
    fn start(simulation: Simulation, shown: Shown, links: Vec<ToolLink>, stalls: Option<&'a Stalls>) -> Self {
        let dt_s = simulation.world().spec().time_step_s;
        // Those of a session that goes on are where they were.
        let world = simulation.world();
        let tools: Vec<ToolInput> = (0..world.tools().len()).map(|tool| world.tool_pose(tool)).collect();
        let paused = simulation.is_resumed();
        let live = Live {
            simulation,
            targets: tools.clone(),
            tools,
            links,
            detected: [None; MAX_TOOLS],
            elsewhere: NearbyMaker::default(),
            published_ns: 0,
            publishing_ns: 0,
            paused,
            speed: 1.0,
            dt_s,
        };
        let now = Instant::now();
        Self {
            live,
            meters: Arc::clone(&shown.latest.meters),
            shown,
            pace: PaceMeter::new(now),
            control: EffortControl::default(),
            lateness: Lateness::default(),
            simulated_until: now,
            next_frame: now,
            next_keeping: now + KEEP_EVERY,
            last_shown: None,
            wants_refresh: false,
            stalls,
            next_stall: stalls.map(|stalls| now + stalls.every),
            n_stalls: 0,
            stalled: Duration::ZERO,
        }
    }

    fn obey(&mut self, command: Command) -> anyhow::Result<()> {
        self.unless_broken(|timed| {
            timed.wants_refresh |= timed.live.obey(command)?;
            Ok(())
        })
    }

    fn turn(&mut self) -> anyhow::Result<()> {
        self.unless_broken(Self::keep_pace)?;
        self.unless_broken(Self::show)?;
        self.unless_broken(Self::keep_session)
    }

    /// How long there is nothing to do.
    fn wait(&self) -> Duration {
        if self.live.paused {
            return FRAME;
        }
        self.simulated_until.min(self.next_frame).saturating_duration_since(Instant::now())
    }

    /// Does something with the simulation; nothing with one that broke, whose end displays are told.
    fn unless_broken(&mut self, act: impl FnOnce(&mut Self) -> anyhow::Result<()>) -> anyhow::Result<()> {
        if self.live.simulation.broken().is_some() {
            return Ok(());
        }
        // Showing a world reads it, too: what is wrong with it may come up there.
        let done = match catch_unwind(AssertUnwindSafe(|| act(self))) {
            Ok(done) => done,
            Err(panic) => Err(self.live.simulation.break_off(panic_text(panic.as_ref())).into()),
        };
        match done {
            Err(error) if error.is::<Broken>() => {
                self.live.paused = true;
                self.shown.show_broken(&self.live.simulation, self.pace.pace);
                Ok(())
            }
            done => done,
        }
    }

    /// Stands still where that was asked for and is due.
    fn stall(&mut self) {
        let (Some(stalls), Some(begin)) = (self.stalls, self.next_stall) else { return };
        if Instant::now() < begin {
            return;
        }
        stalls.is_on.store(true, Ordering::Relaxed);
        let begun = Instant::now();
        while begun.elapsed() < stalls.length {
            std::hint::spin_loop();
        }
        stalls.is_on.store(false, Ordering::Relaxed);
        self.stalled += begun.elapsed();
        self.n_stalls += 1;
        self.next_stall = Some(begin + stalls.every);
    }

    /// Steps until the clock is reached or a frame is due.
    fn keep_pace(&mut self) -> anyhow::Result<()> {
        let now = Instant::now();
        if self.live.paused {
            self.simulated_until = now;
            self.pace.restart();
            return Ok(());
        }
        let lag = now.saturating_duration_since(self.simulated_until);
        if lag > MAX_LAG {
            self.lateness.n_given_up += 1;
            self.lateness.left_out_s += lag.as_secs_f64();
            self.simulated_until = now;
        }
        let mut steps = 0;
        while self.simulated_until <= Instant::now()
            && Instant::now() < self.next_frame.max(now + self.live.step())
        {
            let begun = Instant::now();
            self.live.advance()?;
            self.meters.count_step(begun.elapsed());
            self.meters.set_budget(self.live.step());
            self.simulated_until += self.live.step().div_f64(self.live.speed);
            steps += 1;
        }
        if let Some(load) = self.pace.count(steps, now.elapsed(), self.live.dt_s)
            // Slow motion is not late.
            && let load = (Load { real_time_factor: load.real_time_factor / self.live.speed, ..load })
            && let Some(effort) = self.control.look(load)
        {
            self.live.choose_level_of_detail(effort, load)?;
        }
        Ok(())
    }

    /// Publishes the state where a frame is due or a command changed something.
    fn show(&mut self) -> anyhow::Result<()> {
        let lacks = self.live.paused && self.shown.lacks_what_is_watched();
        let wants_refresh = std::mem::take(&mut self.wants_refresh) || lacks;
        if !wants_refresh && (self.live.paused || Instant::now() < self.next_frame) {
            return Ok(());
        }
        self.next_frame = Instant::now() + FRAME;
        let slow_motion = Some(self.live.speed).filter(|speed| *speed < 1.0);
        let pace = Pace { paused: self.live.paused, slow_motion, ..self.pace.pace };
        self.shown.show(&self.live.simulation, pace, self.lateness);
        // A pause is no interval of a display.
        let shown = Instant::now();
        if let Some(before) = self.last_shown.replace(shown).filter(|_| !self.live.paused) {
            self.meters.count_frame(shown - before);
        }
        self.last_shown = self.last_shown.filter(|_| !self.live.paused);
        Ok(())
    }

    /// Beside the steps: a crash of the program loses what happened since.
    fn keep_session(&mut self) -> anyhow::Result<()> {
        let now = Instant::now();
        if now >= self.next_keeping {
            self.next_keeping = now + KEEP_EVERY;
            self.live.simulation.keep_session();
        }
        Ok(())
    }

    fn end(mut self) -> anyhow::Result<Ended> {
        if let Some(last) = self.shown.latest.with_task_broken_off(&self.live.simulation) {
            self.shown.latest = Arc::new(last);
            self.shown.publish();
        }
        let steps = self.live.simulation.world().steps_made();
        let state_hash = self.live.simulation.finish()?;
        let Self { n_stalls, stalled, lateness, meters, .. } = self;
        Ok(Ended { state_hash, steps, n_stalls, stalled, lateness, times: meters.times() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::watch;

    #[test]
    fn the_tip_reaches_its_target_and_never_exceeds_its_speed() {
        let at = |x: f64| ToolInput::at(DVec3::new(x, 0.0, 0.0), DVec3::Y);
        let (mut tool, target) = (at(0.0), at(0.1));
        for _ in 0..1000 {
            let next = approach(tool, target, 1e-3);
            let moved = next.tip_in_world_m.distance(tool.tip_in_world_m);
            assert!(moved <= MAX_TIP_SPEED_M_PER_S * 1e-3 * (1.0 + 1e-12));
            tool = next;
        }
        assert!(tool.tip_in_world_m.distance(target.tip_in_world_m) < 1e-9);
    }

    const MESH: &str = "5 2\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n60 60 60\n0 1 2 3\n1 4 2 3\n";
    const SCENE: &str = "glisson_scene = 1\n[organ]\nmesh = \"body.tet\"\nyoung_modulus = \"5 kPa\"\n\
        poisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\ndamping = \"30 1/s\"\n\
        [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.6 }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n";

    #[test]
    fn a_pause_is_shown_whatever_is_asked_before_the_next_turn() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("body.tet"), MESH).unwrap();
        let scene = SCENE.replace("[organ]\n", "[organ]\nmodel = \"precomputed\"\n");
        std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
        let source = crate::OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let mut turns = Turns::start(Simulation::open(source, None).unwrap());
        turns.turn().unwrap();
        turns.obey(Command::Pause(true)).unwrap();
        let pose = ToolInput::at(DVec3::new(0.04, 0.04, 0.08), DVec3::Z);
        turns.obey(Command::Tool { tool: 0, pose }).unwrap();
        turns.turn().unwrap();
        assert!(turns.shown().pace.paused);
    }

    /// Runs in a computer that has three quarters of its time for something else, while an instrument presses on the body,
    /// until a viewer is told `notice`; answers what was told, how it ended and the recording.
    fn overloaded(model: &str, notice: &str) -> (Vec<String>, LevelOfDetail, Ended, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("body.tet"), MESH).unwrap();
        let scene = SCENE.replace("[organ]\n", &format!("[organ]\nmodel = \"{model}\"\n"));
        std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
        let source = crate::OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
        let (shown, mut published) = Shown::start(&simulation).unwrap();
        let (commands, commands_out) = std::sync::mpsc::channel();
        let (every, length) = (Duration::from_millis(200), Duration::from_millis(150));
        let stalls = Stalls { every, length, is_on: Arc::default() };
        let thread = std::thread::spawn(move || {
            run(simulation, &commands_out, shown, Vec::new(), Some(&stalls)).unwrap()
        });
        let begin = Instant::now();
        let mut latest = Arc::clone(&published.borrow_and_update());
        let mut n_said = 0_u32;
        while !latest.notices.iter().any(|told| told.text.contains(notice)) {
            assert!(begin.elapsed() < Duration::from_secs(60), "{model}: {:?}", latest.notices);
            let depth_m = 0.05 * (0.2 * f64::from(n_said)).sin().abs();
            let pose = ToolInput::at(DVec3::new(0.04, 0.04, 0.09 - depth_m), DVec3::Z);
            commands.send(Command::Tool { tool: 0, pose }).unwrap();
            n_said += 1;
            std::thread::sleep(Duration::from_millis(20));
            latest = Arc::clone(&published.borrow_and_update());
        }
        commands.send(Command::Stop).unwrap();
        let ended = thread.join().unwrap();
        (latest.notices.iter().map(|told| told.text.clone()).collect(), latest.effort, ended, folder)
    }

    /// Replays a recording; with `dropped` lines left out.
    fn replayed(folder: &std::path::Path, dropped: &str) -> (Option<u64>, StateHash) {
        let text = std::fs::read_to_string(folder.join("session.jsonl")).unwrap();
        let kept = text.lines().filter(|line| dropped.is_empty() || !line.contains(dropped));
        let session = glisson::record::session::parse_session(&kept.collect::<Vec<_>>().join("\n")).unwrap();
        let report = crate::replay::replay(&session, folder, |_| Ok(())).unwrap();
        (report.first_difference, report.state_hash)
    }

    #[test]
    fn an_overloaded_simulation_computes_less_says_so_and_replays_to_the_same_bits() {
        let (told, effort, ended, folder) = overloaded("implicit", "with least effort now");
        assert!(
            told.iter().any(|notice| notice.contains("is late") && notice.contains("reduced")),
            "{told:?}"
        );
        assert_eq!(effort, LevelOfDetail::Least);
        assert!(ended.n_stalls > 2 && ended.lateness.n_given_up > 0, "{ended:?}");
        assert!(ended.stalled >= Duration::from_millis(150) * ended.n_stalls as u32, "{ended:?}");
        let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
        assert_eq!(text.matches("\"effort\"").count(), 2 * 2, "{}", text.len());
        assert_eq!(replayed(folder.path(), ""), (None, ended.state_hash));
    }

    /// Does `what` with a running simulation that is recorded; answers what was published last, how it ended and the recording.
    fn live(
        scene: &str,
        what: impl FnOnce(&std::sync::mpsc::Sender<Command>, &mut watch::Receiver<Arc<Published>>),
    ) -> (Arc<Published>, Ended, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("body.tet"), MESH).unwrap();
        std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
        let source = crate::OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
        let (shown, mut published) = Shown::start(&simulation).unwrap();
        let (commands, commands_out) = std::sync::mpsc::channel();
        let thread =
            std::thread::spawn(move || run(simulation, &commands_out, shown, Vec::new(), None).unwrap());
        what(&commands, &mut published);
        let latest = Arc::clone(&published.borrow());
        commands.send(Command::Stop).unwrap();
        (latest, thread.join().unwrap(), folder)
    }

    fn when(
        published: &mut watch::Receiver<Arc<Published>>,
        is_so: impl Fn(&Published) -> bool,
    ) -> Arc<Published> {
        let begin = Instant::now();
        loop {
            let latest = Arc::clone(&published.borrow_and_update());
            if is_so(&latest) {
                return latest;
            }
            assert!(begin.elapsed() < Duration::from_secs(60), "{:?} {:?}", latest.pace, latest.notices);
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    #[test]
    fn slow_motion_passes_time_slowly_is_not_late_and_replays_to_the_same_bits() {
        let scene = SCENE.replace("[organ]\n", "[organ]\nmodel = \"implicit\"\n");
        let (latest, ended, folder) = live(&scene, |commands, published| {
            commands.send(Command::Speed(0.1)).unwrap();
            let pose = ToolInput::at(DVec3::new(0.04, 0.04, 0.07), DVec3::Z);
            commands.send(Command::Tool { tool: 0, pose }).unwrap();
            let is_slow =
                |now: &Published| now.pace.slow_motion == Some(0.1) && now.pace.real_time_factor < 0.2;
            let slow = when(published, |now| is_slow(now) && now.pace.real_time_factor > 0.0);
            assert_eq!(slow.effort, LevelOfDetail::Full);
            // Looks that would have found it late.
            std::thread::sleep(Duration::from_millis(1500));
            assert!(is_slow(&published.borrow()), "{:?}", published.borrow().pace);
        });
        assert_eq!((latest.effort, latest.notices.len()), (LevelOfDetail::Full, 0));
        assert_eq!(replayed(folder.path(), ""), (None, ended.state_hash));
    }

    #[test]
    fn a_task_is_done_in_real_time() {
        let task = "[task]\ntitle = \"t\"\n[[task.stage]]\ntitle = \"touch\"\ntouch = {}\n[organ]\nmodel = \"implicit\"\n";
        let (latest, ..) = live(&SCENE.replace("[organ]\n", task), |commands, published| {
            commands.send(Command::Speed(0.1)).unwrap();
            when(published, |now| now.notices.iter().any(|told| told.text.contains("real time")));
        });
        assert_eq!(latest.pace.slow_motion, None);
    }

    #[test]
    fn a_model_with_nothing_to_leave_out_says_how_fast_time_passes() {
        let (told, _, ended, folder) = overloaded("explicit", "cannot compute less: time passes at 0.");
        assert_eq!(told.len(), 1, "{told:?}");
        assert_eq!(replayed(folder.path(), ""), (None, ended.state_hash));
    }
}
