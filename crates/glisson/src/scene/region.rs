//! Regions: some nodes, or tetrahedra, of an organ.

use super::reader::{SceneError, Section};
use crate::math::Aabb;
use crate::units::Dimension;
use crate::world::spec::Region;

/// `box`, `ball` or `furthest`; one of them has to be there.
pub(super) fn read_region(section: &mut Section<'_>) -> Result<Region, SceneError> {
    let bounds = section.section("box")?;
    let ball = section.section("ball")?;
    let furthest = section.section("furthest")?;
    match (bounds, ball, furthest) {
        (Some(mut bounds), None, None) => {
            let min_m = bounds.required_point("min", "min = [\"-5 mm\", \"-5 mm\", \"0 mm\"]")?;
            let max_m = bounds.required_point("max", "max = [\"5 mm\", \"5 mm\", \"9 mm\"]")?;
            bounds.finish()?;
            Ok(Region::Box(Aabb { min_m, max_m }))
        }
        (None, Some(mut ball), None) => {
            let center_m = ball.required_point("center", "center = [\"0 mm\", \"0 mm\", \"9 mm\"]")?;
            let radius_m = ball
                .positive("radius", Dimension::Length)?
                .ok_or_else(|| ball.missing("radius", "radius = \"20 mm\""))?;
            ball.finish()?;
            Ok(Region::Ball { center_m, radius_m })
        }
        (None, None, Some(mut furthest)) => {
            let direction = furthest
                .direction("direction")?
                .ok_or_else(|| furthest.missing("direction", "direction = [0, 0, -1]"))?;
            let (fraction, at) = furthest
                .number("fraction")?
                .ok_or_else(|| furthest.missing("fraction", "fraction = 0.05"))?;
            if !(fraction > 0.0 && fraction < 1.0) {
                return Err(furthest.wrong_value(at, "fraction", fraction.to_string(), "between 0 and 1"));
            }
            furthest.finish()?;
            Ok(Region::Furthest { direction, fraction })
        }
        _ => {
            let example = "exactly one of box = { min, max }, ball = { center, radius }, furthest = { direction, fraction }";
            Err(section.missing("box, ball or furthest", example))
        }
    }
}
