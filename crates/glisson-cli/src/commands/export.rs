//! `glisson export`.

mod page;
mod scene_page;
mod film;
mod moments;

pub(crate) use page::page_of;
pub(super) use page::{require_page, write_page};

use super::replay::{Source, same_bits};
use anyhow::{Context, anyhow, ensure};
use glisson::progress::tell;
use glisson::record::session::{Session, SessionEvent};
use glisson_runtime::Simulation;
use glisson_runtime::replay::{self, ReplayReport};
use moments::Moments;
use std::path::{Path, PathBuf};

/// Write a recorded session as one HTML file that plays in a browser, without a server and without a network, as a film, or for other
/// programs; or a scene as one HTML file that simulates it.
///
/// A session is replayed, and refused when the replay does not make the bits of the recording (docs/replay.md); of one that was recorded
/// in a browser it is said that they differ. A scene is a TOML file, or the name of a task (docs/local.md).
#[derive(Debug, clap::Args)]
#[command(
    group = clap::ArgGroup::new("what").args(["html", "mp4", "pvd", "usda"]).required(true),
    after_help = "Examples:\n  glisson export line_cut --html line_cut.html                     a task, simulated in the page\n  \
    glisson export out/tasks/palpation.jsonl --html palpation.html\n  \
    glisson export session.jsonl --html session.html --rate 60 --precision-mm 0.01\n  \
    glisson export mine.jsonl --beside experts.jsonl --html both.html\n  \
    glisson export session.jsonl --take-over --html session.html     plays, and simulates on from any moment\n  \
    glisson export out/tasks/palpation.jsonl --mp4 palpation.mp4 --view endoscope --from 2 --to 8\n  \
    glisson export session.jsonl --pvd session.pvd --rate 10         for ParaView: stress, strain, displacement at each moment\n  \
    glisson export session.jsonl --usda session.usda                 for Blender, Omniverse and others"
)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,
    /// The page to write
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// The film to write; ffmpeg encodes it
    #[arg(long, value_name = "FILE")]
    mp4: Option<PathBuf>,
    /// The list of moments to write, for ParaView, PyVista and meshio; their files go to a folder beside it
    #[arg(long, value_name = "FILE")]
    pvd: Option<PathBuf>,
    /// The USD scene to write, as text
    #[arg(long, value_name = "FILE")]
    usda: Option<PathBuf>,
    #[command(flatten)]
    page: page::PageOptions,
    #[command(flatten)]
    film: film::FilmOptions,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let moments = || Moments { rate_hz: f64::from(args.page.rate), span_s: args.film.span_s() };
    if let Some(scene) = scene_page::scene_of(&args.source)? {
        let html =
            args.html.as_ref().context("a scene can be written as --html; record it first for the others")?;
        ensure!(
            args.page.is_usual(),
            "--beside, --rate, --precision-mm, --take-over and --check are for sessions; this is a scene"
        );
        scene_page::export(&args.source, &scene, html)
    } else if let Some(html) = &args.html {
        page::export(&args.source, html, &args.page)
    } else if let Some(mp4) = &args.mp4 {
        film::export(&args.source, mp4, &args.film)
    } else if let Some(pvd) = &args.pvd {
        moments::export_pvd(&args.source, pvd, moments())
    } else if let Some(usda) = &args.usda {
        moments::export_usda(&args.source, usda, moments())
    } else {
        Err(anyhow!("nothing to write; give --html, --mp4, --pvd or --usda"))
    }
}

/// A session that was replayed.
struct Replayed {
    /// How far it is known that the replay made the bits of the recording.
    words: &'static str,
    report: ReplayReport,
}

/// Replays a session; `see` gets each step, and whether it is the last one. Tells how far it is.
fn replayed(
    session: &Session,
    folder: &Path,
    mut see: impl FnMut(&Simulation, bool) -> anyhow::Result<()>,
) -> anyhow::Result<Replayed> {
    let n_steps = session.events.last().map_or(0, SessionEvent::step);
    ensure!(n_steps > 0, "the session has no step: there is nothing to show");
    let report = replay::replay(session, folder, |simulation| {
        let step = simulation.world().steps_made();
        tell(step as f64 / n_steps as f64);
        see(simulation, step == n_steps)
    })?;
    let words = same_bits(&report).map_err(|error| anyhow!("nothing is exported: {error}"))?;
    Ok(Replayed { words, report })
}
