//! Lines on tissue that are to be cut along: straight, through points, or a circle.

use super::super::reader::{SceneError, Section};
use crate::math::DVec3;
use std::f64::consts::TAU;

/// A line on tissue at rest: straight from each point to the next.
#[derive(Clone, Debug, PartialEq)]
pub struct LineSource {
    /// Its points, two at least [m].
    pub points_m: Vec<DVec3>,
    /// Whether it goes on from the last point to the first.
    pub is_closed: bool,
}

const POINTS: &str = "points = [[\"0 mm\", \"-50 mm\", \"0 mm\"], [\"30 mm\", \"-50 mm\", \"0 mm\"]]";
/// Points of a line at most.
const MOST_POINTS: usize = 1000;
/// Points of a line are at least so far apart [m]: nobody cuts finer.
const LEAST_APART_M: f64 = 1e-6;
/// Chords of a circle: with 72 none is further than a thousandth of the radius from it. A choice.
const CHORDS: usize = 72;

/// `circle`, `points` with `closed`, or `from` and `to`.
pub(super) fn read_line(table: &mut Section<'_>) -> Result<LineSource, SceneError> {
    if let Some(circle) = table.section("circle")? {
        return read_circle(circle);
    }
    let Some(points_m) = table.points("points", POINTS)? else {
        let (from_m, to_m) = read_ends(table)?;
        return Ok(LineSource { points_m: vec![from_m, to_m], is_closed: false });
    };
    let is_closed = table.flag("closed")?.unwrap_or(false);
    let least = if is_closed { 3 } else { 2 };
    let is_near = |a: &DVec3, b: &DVec3| a.distance(*b) < LEAST_APART_M;
    let is_closed_twice =
        is_closed && points_m.first().zip(points_m.last()).is_some_and(|(a, b)| is_near(a, b));
    let is_still = points_m.windows(2).any(|pair| is_near(&pair[0], &pair[1]));
    if !(least..=MOST_POINTS).contains(&points_m.len()) || is_still || is_closed_twice {
        let found = format!("a line of {} points", points_m.len());
        let allowed = format!(
            "{least} to {MOST_POINTS} points, each apart from the one before; closed = true leads back to the first"
        );
        return Err(table.wrong_table("points", found, allowed));
    }
    Ok(LineSource { points_m, is_closed })
}

fn read_circle(mut circle: Section<'_>) -> Result<LineSource, SceneError> {
    let center_m = circle.required_point("center", "center = [\"0 mm\", \"0 mm\", \"2 mm\"]")?;
    let radius_m = circle.required_length("radius", "radius = \"25 mm\"")?;
    let normal = circle.direction("normal")?.ok_or_else(|| circle.missing("normal", "normal = [0, 0, 1]"))?;
    circle.finish()?;
    let (across, beside) = normal.any_orthonormal_pair();
    let at = |nth: usize| {
        let angle_rad = TAU * nth as f64 / CHORDS as f64;
        center_m + radius_m * (libm::cos(angle_rad) * across + libm::sin(angle_rad) * beside)
    };
    Ok(LineSource { points_m: (0..CHORDS).map(at).collect(), is_closed: true })
}

/// `from` and `to`, two places.
pub(super) fn read_ends(table: &mut Section<'_>) -> Result<(DVec3, DVec3), SceneError> {
    let from_m = table.required_point("from", "from = [\"0 mm\", \"-50 mm\", \"0 mm\"]")?;
    let to_m = table.required_point("to", "to = [\"30 mm\", \"-50 mm\", \"0 mm\"]")?;
    if from_m.distance(to_m) < LEAST_APART_M {
        return Err(table.wrong_table("to", "where the line begins".into(), "another place".into()));
    }
    Ok((from_m, to_m))
}
