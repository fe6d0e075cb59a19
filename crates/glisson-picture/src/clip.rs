//! Clips on vessels: a closed U of wire across each, around the duct where the vessel runs in a thin one, else about as wide as the
//! vessel; as on the page (`web/src/clip_marks.ts`).

use super::geometry::ShadedSurface;
use super::look::Look;
use glam::DVec3;
use glisson::record::snapshot::ClipSnapshot;
use std::f64::consts::PI;

const WIRE_RADIUS_M: f64 = 0.7e-3;
/// It is pressed into the tissue by this part of its thickness.
const PRESSED: f64 = 0.3;
/// Tissue around a vessel is a duct where it ends within so many radii of the vessel, and so much more [m]: a choice.
const DUCT_RADII: f64 = 2.0;
const DUCT_MORE_M: f64 = 4e-3;
/// Between a superellipse, as straight as legs are, and an ellipse (1).
const ROUND: f64 = 0.72;
/// Half the angle that is left open between the ends of the legs [rad].
const GAP_RAD: f64 = 0.16;
const PLACES: u32 = 28;
/// Rays go past the edges of meshes that lie straight, where rounding lets them through between two triangles.
const ASIDE: DVec3 = DVec3::new(0.0131, 0.0077, 0.0101);

/// A clip around the tissue of these triangles.
pub(super) fn clip(clip: &ClipSnapshot, positions_m: &[DVec3], triangles: &[[u32; 3]]) -> ShadedSurface {
    let (along, legs) = (clip.along, clip.legs);
    let side = legs.cross(along);
    let most_m = (1.0 + DUCT_RADII) * clip.radius_m + DUCT_MORE_M;
    let found = [side, -side, legs, -legs]
        .map(|way| tissue_end_m(clip.position_m, way, most_m, positions_m, triangles));
    // Of a duct both sides end.
    let is_duct = found[0].is_some() && found[1].is_some();
    let [right_m, left_m, bend_m, ends_m] = found.map(|end_m| {
        let tissue_m = end_m.filter(|_| is_duct).unwrap_or(0.0);
        tissue_m.max(clip.radius_m) + (1.0 - PRESSED) * WIRE_RADIUS_M
    });
    let power = |x: f64| x.signum() * x.abs().powf(ROUND);
    let place = |i: u32| {
        let share = f64::from(i) / f64::from(PLACES - 1);
        let turn = GAP_RAD - 0.5 * PI + 2.0 * (PI - GAP_RAD) * share;
        let (x, y) = (power(turn.cos()), power(turn.sin()));
        let aside_m = x * if x > 0.0 { right_m } else { left_m };
        clip.position_m + side * aside_m + legs * (y * if y > 0.0 { bend_m } else { ends_m })
    };
    ShadedSurface::wire(&(0..PLACES).map(place).collect::<Vec<_>>(), WIRE_RADIUS_M, Look::Metal)
}

/// How far the tissue reaches from a place in a direction; none where it does not end within `most_m` (Moller and Trumbore 1997, doi
/// 10.1080/10867651.1997.10487468).
fn tissue_end_m(
    from_m: DVec3,
    way: DVec3,
    most_m: f64,
    positions_m: &[DVec3],
    triangles: &[[u32; 3]],
) -> Option<f64> {
    let way = (way + ASIDE).normalize();
    let meets_m = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|vertex| positions_m[vertex as usize]);
        let (ab, ac, out) = (b - a, c - a, from_m - a);
        let (p, q) = (way.cross(ac), out.cross(ab));
        let of_all = 1.0 / ab.dot(p);
        let (u, v) = (out.dot(p) * of_all, way.dot(q) * of_all);
        let away_m = ac.dot(q) * of_all;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && away_m > 0.0 && away_m <= most_m).then_some(away_m)
    };
    triangles.iter().filter_map(meets_m).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box around the origin with these half sides.
    fn duct(half_m: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let sign = |bit: u32| if bit == 0 { -1.0 } else { 1.0 };
        let corner = |i: u32| half_m * DVec3::new(sign(i & 1), sign(i & 2), sign(i & 4));
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let halves = faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
        ((0..8).map(corner).collect(), halves.collect())
    }

    fn half_sizes_m(half_m: DVec3) -> [f64; 2] {
        let (positions_m, triangles) = duct(half_m);
        let set = ClipSnapshot { position_m: DVec3::ZERO, along: DVec3::X, legs: DVec3::Y, radius_m: 1e-3 };
        let wire = clip(&set, &positions_m, &triangles);
        assert!(wire.positions_m.iter().all(|p| p.x.abs() < 1.1 * WIRE_RADIUS_M));
        let size_m = |of: fn(&DVec3) -> f64| wire.positions_m.iter().map(of).fold(0.0, f64::max);
        [size_m(|p| p.y), size_m(|p| p.z)]
    }

    #[test]
    fn it_goes_around_a_duct_and_lies_on_a_vessel_in_an_organ() {
        let [y_m, z_m] = half_sizes_m(DVec3::new(0.05, 2e-3, 3e-3));
        assert!(
            (y_m - 2e-3).abs() < 2.0 * WIRE_RADIUS_M && (z_m - 3e-3).abs() < 2.0 * WIRE_RADIUS_M,
            "{y_m} {z_m}"
        );
        let [y_m, z_m] = half_sizes_m(DVec3::splat(0.05));
        assert!(y_m < 3e-3 && z_m < 3e-3, "{y_m} {z_m}");
    }
}
