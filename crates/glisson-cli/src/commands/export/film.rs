//! A session as a film.

use super::{Replayed, replayed};
use crate::commands::output::{check_extension, make_folder_of};
use crate::commands::progress::with_bar;
use crate::commands::replay::Source;
use anyhow::{Context, ensure};
use glisson::record::session::Session;
use glisson_view::film::encoder::{Encoder, FFMPEG};
use glisson_view::film::frames::FrameClock;
use glisson_view::film::view::{FilmCamera, FilmView};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Edges of a film [pixels]: less shows nothing, more is no size of a film. Both are even, as its colours need.
const EDGES: std::ops::RangeInclusive<usize> = 64..=4096;
/// Speeds that show something.
const SPEEDS: std::ops::RangeInclusive<f64> = 0.01..=100.0;

/// What is asked of the film.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Of the film; --from and --to of moments, too")]
pub(super) struct FilmOptions {
    /// Width and height in pixels, both even
    #[arg(long, value_name = "WIDTHxHEIGHT", conflicts_with_all = ["html", "pvd", "usda"], default_value = "1280x720", value_parser = size)]
    size: [usize; 2],
    /// Frames a second
    #[arg(long, value_name = "HZ", conflicts_with_all = ["html", "pvd", "usda"], default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=60))]
    fps: u32,
    /// From where it is taken
    #[arg(long, value_enum, conflicts_with_all = ["html", "pvd", "usda"], default_value_t = From::Outside)]
    view: From,
    /// So many times as fast as the session
    #[arg(long, value_name = "TIMES", conflicts_with_all = ["html", "pvd", "usda"], default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Where in the session it begins, in seconds
    #[arg(long, value_name = "S", conflicts_with = "html", default_value_t = 0.0, value_parser = seconds)]
    from: f64,
    /// Where in the session it ends, in seconds; with the session if not given
    #[arg(long, value_name = "S", conflicts_with = "html", value_parser = seconds)]
    to: Option<f64>,
    /// The program that encodes it, where it is not on the PATH
    #[arg(long, value_name = "PROGRAM", conflicts_with_all = ["html", "pvd", "usda"], default_value = FFMPEG)]
    ffmpeg: PathBuf,
}

impl FilmOptions {
    /// Where in the session it begins and ends [s].
    pub(super) fn span_s(&self) -> [f64; 2] {
        [self.from, self.to.unwrap_or(f64::INFINITY)]
    }
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum From {
    /// The whole organ from outside
    Outside,
    /// Through the endoscope of the scene
    Endoscope,
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let wrong = || format!("\"{text}\" is no size; allowed: two even numbers of {EDGES:?}, as 1280x720");
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    let edge = |text: &str| text.parse().ok().filter(|edge| EDGES.contains(edge) && edge % 2 == 0);
    edge(width).zip(edge(height)).map(|(width, height)| [width, height]).ok_or_else(wrong)
}

fn speed(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|x| SPEEDS.contains(x));
    found.ok_or_else(|| format!("\"{text}\" is not in {SPEEDS:?}"))
}

fn seconds(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|x: &f64| x.is_finite() && *x >= 0.0);
    found.ok_or_else(|| format!("\"{text}\" is no time in seconds, 0 or later"))
}

pub(super) fn export(source: &Source, mp4: &Path, options: &FilmOptions) -> anyhow::Result<()> {
    check_extension(mp4, &["mp4"])?;
    let [from_s, to_s] = options.span_s();
    ensure!(from_s < to_s, "the film ends at {to_s} s, before it begins: --from {from_s} s");
    let session = source.read()?;
    make_folder_of(mp4)?;
    let encoder = Encoder::start(&options.ffmpeg, mp4, options.size, options.fps)?;
    let filmed = with_bar("filming", || film(&session, source.folder(), encoder, options))?;
    let Filmed { n_frames, drawing, replay, end_s } = filmed;
    println!("replay           {replay}");
    let rate_hz = f64::from(options.fps);
    println!("frames           {n_frames} ({rate_hz} a second, {:.1} s)", n_frames as f64 / rate_hz);
    println!("of the session   {:.1} s to {:.1} s of {end_s:.1} s", options.from, to_s.min(end_s));
    println!("drawing          {:.0} ms a frame", 1e3 * drawing.as_secs_f64() / n_frames as f64);
    let n_bytes = std::fs::metadata(mp4).with_context(|| mp4.display().to_string())?.len();
    println!("size             {:.2} MB", n_bytes as f64 / 1e6);
    println!("written          {}", mp4.display());
    Ok(())
}

struct Filmed {
    n_frames: u64,
    /// Time that it took to draw them.
    drawing: Duration,
    replay: &'static str,
    end_s: f64,
}

/// Replays the session, and hands its pictures to the encoder.
fn film(
    session: &Session,
    folder: &Path,
    mut encoder: Encoder,
    options: &FilmOptions,
) -> anyhow::Result<Filmed> {
    let view = match options.view {
        From::Outside => FilmView::Outside,
        From::Endoscope => FilmView::Endoscope,
    };
    let mut clock = FrameClock::new(options.span_s(), options.speed, f64::from(options.fps));
    let (mut camera, mut drawing, mut end_s) = (None, Duration::ZERO, 0.0);
    let Replayed { words: replay, .. } = replayed(session, folder, |simulation, _| {
        let world = simulation.world();
        if camera.is_none() {
            camera = Some(FilmCamera::new(simulation, view, options.size)?);
        }
        end_s = world.time_s();
        let due = clock.due(end_s);
        if due > 0
            && let Some(camera) = &mut camera
        {
            let begin = Instant::now();
            let picture = camera.picture(world)?;
            drawing += begin.elapsed();
            (0..due).try_for_each(|_| encoder.add(&picture))?;
        }
        Ok(())
    })?;
    let n_frames = clock.n_frames();
    ensure!(n_frames > 0, "the session ends at {end_s} s, before the film begins: --from {} s", options.from);
    encoder.finish()?;
    Ok(Filmed { n_frames, drawing, replay, end_s })
}
