//! Scenes whose instruments follow a script, as `glisson run` makes them.

use anyhow::Context;
use glam::DVec3;
use glisson::scene::Scene;
use glisson_runtime::{OpenScene, Simulation};
use std::fmt::Write as _;
use std::path::Path as FilePath;

/// Steps shorter than this [s] are not tried.
const SHORTEST_STEP_S: f64 = 1e-5;

/// Writes the scene text of an instrument with its path, point by point at a given speed.
pub(crate) struct Path {
    text: String,
    time_s: f64,
    last_m: DVec3,
}

impl Path {
    /// An instrument `tool` (scene lines) that begins at `home_m`; `handle` points from its tip towards its handle.
    pub(crate) fn new(tool: &str, home_m: DVec3, handle: DVec3) -> Self {
        let text = format!(
            "[[tool]]\n{tool}home_tip = {}\nhome_shaft = [{}, {}, {}]\n",
            place(home_m),
            handle.x,
            handle.y,
            handle.z
        );
        let mut path = Self { text, time_s: 0.0, last_m: home_m };
        path.point(0.0, home_m, "");
        path
    }

    /// It is at a place so long after the last one; `more` scene lines of this point.
    pub(crate) fn point(&mut self, wait_s: f64, tip_m: DVec3, more: &str) {
        self.time_s += wait_s;
        self.last_m = tip_m;
        // Writing to a text does not fail.
        let _ = write!(
            self.text,
            "[[tool.path]]\ntime = \"{:.6} s\"\ntip = {}\n{more}",
            self.time_s,
            place(tip_m)
        );
    }

    /// When the last point is [s].
    pub(crate) fn time_s(&self) -> f64 {
        self.time_s
    }

    /// It stays where it is until then [s].
    pub(crate) fn wait_until(&mut self, time_s: f64) {
        if time_s > self.time_s {
            self.point(time_s - self.time_s, self.last_m, "");
        }
    }

    /// It goes to a place.
    pub(crate) fn go(&mut self, tip_m: DVec3, speed_m_per_s: f64, more: &str) {
        let way_m = self.last_m.distance(tip_m);
        self.point((way_m / speed_m_per_s).max(1e-3), tip_m, more);
    }

    /// The text, and when the path ends [s].
    pub(crate) fn done(self) -> (String, f64) {
        (self.text, self.time_s)
    }
}

/// A place in scene text.
fn place(p_m: DVec3) -> String {
    format!("[\"{:.6} m\", \"{:.6} m\", \"{:.6} m\"]", p_m.x, p_m.y, p_m.z)
}

/// A scene with the longest round time step that its model takes.
pub(crate) struct LongestStep {
    pub(crate) simulation: Simulation,
    pub(crate) scene: Scene,
    pub(crate) step_s: f64,
}

/// Opens the scene that `text` writes for a time step, in a folder with what it names; from `step_s` on downwards.
///
/// # Errors
/// When it cannot be opened with any step.
pub(crate) fn open_with_longest_step(
    folder: &FilePath,
    n_threads: usize,
    mut step_s: f64,
    text: &dyn Fn(f64) -> String,
) -> anyhow::Result<LongestStep> {
    let path = folder.join("scene.toml");
    loop {
        std::fs::write(&path, text(step_s)).with_context(|| format!("{}: cannot write", path.display()))?;
        let source = OpenScene { n_threads, ..OpenScene::read(&path)? };
        let scene = source.scene.clone();
        match Simulation::open(source, None) {
            Ok(simulation) => return Ok(LongestStep { simulation, scene, step_s }),
            Err(error) if step_s <= SHORTEST_STEP_S || !is_step_too_long(&error) => return Err(error),
            Err(_) => step_s = next_shorter_s(step_s),
        }
    }
}

/// The next shorter of round steps, at most a third shorter.
fn next_shorter_s(step_s: f64) -> f64 {
    const ROUND: [f64; 9] = [0.75, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.125, 0.1];
    // A hair above, so that rounding does not give the same one again.
    let decade_s = 10_f64.powf((step_s * (1.0 - 1e-9)).log10().ceil());
    let shorter = ROUND.into_iter().map(|share| share * decade_s).find(|&s| s < step_s * (1.0 - 1e-9));
    shorter.unwrap_or(0.1 * decade_s)
}

fn is_step_too_long(error: &anyhow::Error) -> bool {
    format!("{error:#}").contains("is above the stable one")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shorter_steps_are_round_and_never_the_same_again() {
        let mut step_s = 1e-3;
        let mut found_us = Vec::new();
        while step_s > 1e-4 {
            let shorter_s = next_shorter_s(step_s);
            assert!(shorter_s < step_s && shorter_s > 0.66 * step_s, "{step_s} {shorter_s}");
            found_us.push((shorter_s * 1e7).round() / 10.0);
            step_s = shorter_s;
        }
        assert_eq!(found_us, [750.0, 500.0, 400.0, 300.0, 250.0, 200.0, 150.0, 125.0, 100.0]);
        assert!((next_shorter_s(0.6e-3) - 0.5e-3).abs() < 1e-12);
    }
}
