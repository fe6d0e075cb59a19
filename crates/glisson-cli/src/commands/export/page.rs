//! A session as a page that plays it.

use super::scene_page::simulator_of;
use super::{Replayed, replayed};
use crate::commands::output::{check_extension, make_folder_of};
use crate::commands::progress::with_bar;
use crate::commands::replay::Source;
use crate::text_file::write_text;
use anyhow::{Context, ensure};
use glisson::record::session::{Session, SessionEvent};
use glisson::record::snapshot::ContactPoints;
use glisson::training::task::TaskRecord;
use glisson::world::World;
use glisson_runtime::{Simulation, replay};
use glisson_view::recording::page::{page_with, recordings_in, with_simulator};
use glisson_view::recording::read::RecordingReader;
use glisson_view::recording::write::{About, Recording, RecordingSettings, RecordingWriter, TimedNote};
use std::path::{Path, PathBuf};

const DEFAULT_RATE_HZ: u8 = 30;
const DEFAULT_PRECISION_MM: f64 = 0.05;

/// What is asked of the page.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Of the HTML file; --rate of moments, too")]
pub(super) struct PageOptions {
    /// Another session, which is played beside it
    #[arg(long, value_name = "SESSION", conflicts_with_all = ["mp4", "pvd", "usda"])]
    beside: Option<PathBuf>,
    /// Frames, or moments, a second of simulated time
    #[arg(long, value_name = "HZ", conflicts_with = "mp4", default_value_t = DEFAULT_RATE_HZ, value_parser = clap::value_parser!(u8).range(1..=60))]
    pub(super) rate: u8,
    /// Positions are written as whole numbers of this, 0.001 to 1 mm; coordinates are off by half of it at most
    #[arg(long, value_name = "MM", conflicts_with_all = ["mp4", "pvd", "usda"], default_value_t = DEFAULT_PRECISION_MM, value_parser = precision_mm)]
    precision_mm: f64,
    /// Put the simulation itself in the page, which then goes on from any moment at a press of a key; some 4 MB more
    #[arg(long, conflicts_with_all = ["beside", "mp4", "pvd", "usda"])]
    take_over: bool,
    /// Read the written file again, and all of its frames
    #[arg(long, conflicts_with_all = ["mp4", "pvd", "usda"])]
    check: bool,
}

impl PageOptions {
    /// Whether nothing is asked of the page of a session.
    pub(super) fn is_usual(&self) -> bool {
        let Self { beside, rate, precision_mm, take_over, check } = self;
        let is_of_one = beside.is_none() && !take_over && !check;
        is_of_one && *rate == DEFAULT_RATE_HZ && *precision_mm == DEFAULT_PRECISION_MM
    }
}

fn precision_mm(text: &str) -> Result<f64, String> {
    let found: f64 = text.parse().map_err(|_| format!("\"{text}\" is no number"))?;
    if (0.001..=1.0).contains(&found) { Ok(found) } else { Err(format!("{found} is not in 0.001..=1")) }
}

/// That the program has the page which plays recordings.
pub(crate) fn require_page() -> anyhow::Result<()> {
    let has_page = page_with(&[]).is_some();
    ensure!(has_page, "this program was built without its pages; `cargo xtask demo` builds it with them");
    Ok(())
}

/// Writes a session as a page, with the settings that [`Args`] has when none are given.
pub(crate) fn write_page(session: &Path, folder: &Path, html: &Path) -> anyhow::Result<()> {
    write_text(html, &page_of(session, folder)?)
}

/// A session as a page, with the settings that [`Args`] has when none are given.
pub(crate) fn page_of(session: &Path, folder: &Path) -> anyhow::Result<String> {
    require_page()?;
    let session = replay::read_session(session)?;
    let settings =
        RecordingSettings { rate_hz: f64::from(DEFAULT_RATE_HZ), step_m: 1e-3 * DEFAULT_PRECISION_MM };
    let Exported { recording, .. } = with_bar("replaying", || record(&session, folder, settings, None))?;
    page_with(&[&recording.bytes]).context("the program's page is gone")
}

pub(super) fn export(source: &Source, html: &Path, options: &PageOptions) -> anyhow::Result<()> {
    check_extension(html, &["html", "htm"])?;
    require_page()?;
    let beside = options.beside.as_deref().map(|session| source.beside(session));
    let sources: Vec<&Source> = std::iter::once(source).chain(&beside).collect();
    let sessions = sources.iter().map(|source| source.read()).collect::<anyhow::Result<Vec<Session>>>()?;
    let simulator = options.take_over.then(|| simulator_of(source, &sessions[0])).transpose()?;
    let settings =
        RecordingSettings { rate_hz: f64::from(options.rate), step_m: 1e-3 * options.precision_mm };
    let is_pair = sources.len() > 1;
    let all = sources
        .iter()
        .zip(&sessions)
        .map(|(source, session)| {
            let name = source.name();
            let name = is_pair.then_some(name.as_str());
            with_bar("replaying", || record(session, source.folder(), settings, name))
                .with_context(|| source.session().display().to_string())
        })
        .collect::<anyhow::Result<Vec<Exported>>>()?;
    let bytes: Vec<&[u8]> = all.iter().map(|one| one.recording.bytes.as_slice()).collect();
    let page = page_with(&bytes);
    let page = match &simulator {
        Some(simulator) => page.and_then(|page| with_simulator(page, simulator)),
        None => page,
    };
    let page = page.context("the program's page is gone")?;
    make_folder_of(html)?;
    write_text(html, &page)?;
    for (source, one) in sources.iter().zip(&all) {
        if is_pair {
            println!("session          {}", source.session().display());
        }
        tell(one, options);
    }
    println!("size             {:.2} MB", page.len() as f64 / 1e6);
    if options.check {
        println!("checked          {} frames read back", frames_in(html)?);
    }
    println!("written          {}", html.display());
    Ok(())
}

/// What became of a session.
fn tell(Exported { recording, task, replay }: &Exported, options: &PageOptions) {
    println!("replay           {replay}");
    println!(
        "frames           {} ({} a second, {:.1} s)",
        recording.n_frames, options.rate, recording.duration_s
    );
    println!(
        "surface          {} vertices at most, changed {} times",
        recording.most_vertices, recording.n_changes
    );
    println!("largest error    {:.4} mm in a coordinate", 1e3 * recording.largest_error_m);
    let minutes = recording.duration_s / 60.0;
    if minutes > 0.0 {
        // Base64 has four letters for three bytes.
        let a_minute_mb = recording.bytes.len() as f64 * 4.0 / 3.0 / 1e6 / minutes;
        println!("recording        {a_minute_mb:.2} MB a minute");
    }
    if let Some(task) = task {
        println!("moments          {} that went wrong", task.result().moments.len());
    }
}

struct Exported {
    recording: Recording,
    task: Option<TaskRecord>,
    /// How far it is known that the replay made the bits of the recording.
    replay: &'static str,
}

/// Replays the session, and writes down what is displayed.
fn record(
    session: &Session,
    folder: &Path,
    settings: RecordingSettings,
    name: Option<&str>,
) -> anyhow::Result<Exported> {
    let mut sampler = Sampler {
        writer: RecordingWriter::new(settings),
        contacts: ContactPoints::default(),
        settings,
        next: 0,
        greeted: None,
    };
    let mut notes = Notes::of(session);
    let Replayed { words: replay, report } = replayed(session, folder, |simulation, is_last| {
        notes.see(simulation.world());
        sampler.see(simulation, is_last)
    })?;
    let result = report.task.as_ref().map(TaskRecord::result);
    let about = About { name, task: result.as_ref(), notes: &notes.timed };
    Ok(Exported { recording: sampler.writer.finish(&about), task: report.task, replay })
}

/// What who watched the session kept, with the times of its steps.
struct Notes<'a> {
    to_come: std::slice::Iter<'a, SessionEvent>,
    timed: Vec<TimedNote>,
}

impl<'a> Notes<'a> {
    fn of(session: &'a Session) -> Self {
        Self { to_come: session.events.iter(), timed: Vec::new() }
    }

    /// After a step.
    fn see(&mut self, world: &World) {
        while let Some(event) =
            self.to_come.as_slice().first().filter(|event| event.step() <= world.steps_made())
        {
            if let SessionEvent::Note { note, .. } = event {
                self.timed.push(TimedNote { time_s: world.time_s(), note: note.clone() });
            }
            self.to_come.next();
        }
    }
}

/// Takes a frame of the first step, and of the first one in each period after it.
struct Sampler {
    writer: RecordingWriter,
    contacts: ContactPoints,
    settings: RecordingSettings,
    /// Period of the next frame.
    next: u64,
    /// Model of the scene when it was last said what that is.
    greeted: Option<&'static str>,
}

impl Sampler {
    fn see(&mut self, simulation: &Simulation, is_last: bool) -> anyhow::Result<()> {
        let world = simulation.world();
        let time_s = world.time_s();
        // Of a step that ends with a period, rounding must not make one within it.
        let period = (time_s * self.settings.rate_hz + 1e-6).floor() as u64;
        if self.greeted.is_some() && period < self.next && !is_last {
            return Ok(());
        }
        self.next = period + 1;
        let model = world.model_kind().name();
        if self.greeted != Some(model) {
            self.writer.greet(simulation);
            self.greeted = Some(model);
        }
        world.contact_points_into(&mut self.contacts);
        Ok(self.writer.add(&world.snapshot(), &self.contacts, || world.display_topology())?)
    }
}

/// Reads all frames of a written file.
fn frames_in(path: &Path) -> anyhow::Result<usize> {
    let what = || format!("{}: cannot be read back", path.display());
    let page = std::fs::read_to_string(path).with_context(what)?;
    let all = recordings_in(&page);
    ensure!(!all.is_empty(), "{}: it has no recording", what());
    let mut n_frames = 0;
    for bytes in &all {
        let recording = RecordingReader::new(bytes).with_context(what)?;
        recording.each_frame(|_| ()).with_context(what)?;
        n_frames += recording.n_frames();
    }
    Ok(n_frames)
}
