//! A session as moments that other programs read: a `.pvd` list with fields, a USD scene.

use super::{Replayed, replayed};
use crate::commands::output::{check_extension, make_folder_of};
use crate::commands::progress::with_bar;
use crate::commands::replay::Source;
use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson_runtime::Simulation;
use glisson_view::film::frames::FrameClock;
use glisson_view::recording::series::Series;
use glisson_view::recording::usd::UsdWriter;
use std::io;
use std::path::Path;

/// Which moments of a session.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moments {
    /// How many a second of simulated time.
    pub(super) rate_hz: f64,
    /// From when to when [s].
    pub(super) span_s: [f64; 2],
}

impl Moments {
    /// Refuses what holds no moment.
    fn check(self) -> anyhow::Result<()> {
        let [from_s, to_s] = self.span_s;
        ensure!(from_s < to_s, "the moments end at {to_s} s, before they begin: --from {from_s} s");
        Ok(())
    }

    /// Replays the session, and has `see` look at each of the moments, which are numbered from 0; a step that is longer than the time
    /// between two is one moment, the last of those in it. Answers what came of the replay, and how many were seen.
    fn each(
        self,
        source: &Source,
        mut see: impl FnMut(u64, &Simulation) -> anyhow::Result<()>,
    ) -> anyhow::Result<(&'static str, u64)> {
        self.check()?;
        let session = source.read()?;
        let mut clock = FrameClock::new(self.span_s, 1.0, self.rate_hz);
        let (mut end_s, mut n_seen) = (0.0, 0);
        let Replayed { words, .. } = with_bar("writing", || {
            replayed(&session, source.folder(), |simulation, _| {
                end_s = simulation.world().time_s();
                if clock.due(end_s) == 0 {
                    return Ok(());
                }
                n_seen += 1;
                see(clock.n_frames() - 1, simulation)
            })
        })?;
        let [from_s, _] = self.span_s;
        ensure!(n_seen > 0, "the session ends at {end_s} s, before the moments begin: --from {from_s} s");
        Ok((words, n_seen))
    }
}

pub(super) fn export_pvd(source: &Source, pvd: &Path, moments: Moments) -> anyhow::Result<()> {
    check_extension(pvd, &["pvd"])?;
    moments.check()?;
    make_folder_of(pvd)?;
    let mut series = Series::new(pvd)?;
    let (replay, _) = moments.each(source, |_, simulation| series.add(simulation))?;
    series.finish()?;
    println!("replay           {replay}");
    println!("moments          {} ({} a second)", series.len(), moments.rate_hz);
    println!("fields           displacement_m, velocity_m_per_s, strain, stress_pa, body; places in mm");
    println!("written          {}", pvd.display());
    Ok(())
}

pub(super) fn export_usda(source: &Source, usda: &Path, moments: Moments) -> anyhow::Result<()> {
    check_extension(usda, &["usda"])?;
    make_folder_of(usda)?;
    let mut replay = None;
    let written = write_atomically(usda, |out| {
        let mut writer = UsdWriter::new(out, moments.rate_hz);
        let made = moments.each(source, |frame, simulation| Ok(writer.add(frame, simulation.world())?));
        replay = Some(made.map_err(io::Error::other)?);
        writer.finish().map(|_| ())
    });
    written.with_context(|| usda.display().to_string())?;
    let (replay, n_frames) = replay.context("the replay ended without a word")?;
    let n_bytes = std::fs::metadata(usda).with_context(|| usda.display().to_string())?.len();
    println!("replay           {replay}");
    println!("frames           {n_frames} ({} a second)", moments.rate_hz);
    println!("size             {:.2} MB", n_bytes as f64 / 1e6);
    println!("written          {}", usda.display());
    Ok(())
}
