//! Closed polygons on a slice: area, even spacing, self-crossings.

use crate::math::DVec2;

/// A closed outline on a slice. The last point is joined to the first.
#[derive(Clone, Debug, PartialEq)]
pub struct SliceContour {
    /// The slice k it lies on.
    pub slice: usize,
    /// Its corners [m], measured from the centre of pixel (0, 0) along i and j. As a correction by hand, a
    /// contour without points says that the organ is not in the slice.
    pub points_m: Vec<DVec2>,
}

/// Area inside a polygon [m2]; positive when it turns from i to j.
pub fn signed_area_m2(points_m: &[DVec2]) -> f64 {
    let Some(&last) = points_m.last() else { return 0.0 };
    let mut before = last;
    let mut twice = 0.0;
    for &point in points_m {
        twice += before.perp_dot(point);
        before = point;
    }
    0.5 * twice
}

/// Length of a closed polygon [m].
pub fn perimeter_m(points_m: &[DVec2]) -> f64 {
    (0..points_m.len()).map(|p| points_m[p].distance(points_m[(p + 1) % points_m.len()])).sum()
}

/// The polygon with corners evenly spaced along it, as near to `step_m` as a whole number of them allows, and
/// at least 6.
pub fn resampled(points_m: &[DVec2], step_m: f64) -> Vec<DVec2> {
    let length_m = perimeter_m(points_m);
    if points_m.len() < 3 || length_m <= 0.0 {
        return points_m.to_vec();
    }
    let n = ((length_m / step_m).round() as usize).max(6);
    let mut result = Vec::with_capacity(n);
    let (mut segment, mut passed_m) = (0, 0.0);
    for q in 0..n {
        let wanted_m = length_m * q as f64 / n as f64;
        loop {
            let (a, b) = (points_m[segment], points_m[(segment + 1) % points_m.len()]);
            let part_m = a.distance(b);
            if passed_m + part_m >= wanted_m || segment + 1 == points_m.len() {
                let share = if part_m > 0.0 { ((wanted_m - passed_m) / part_m).min(1.0) } else { 0.0 };
                result.push(a.lerp(b, share));
                break;
            }
            passed_m += part_m;
            segment += 1;
        }
    }
    result
}

/// Whether two sides that are not neighbours cross, of one polygon or of two.
pub fn any_crossing(polygons: &[Vec<DVec2>]) -> bool {
    struct Side {
        polygon: usize,
        place: usize,
        ends: [DVec2; 2],
    }
    let mut sides: Vec<Side> = Vec::new();
    for (polygon, points) in polygons.iter().enumerate() {
        for place in 0..points.len() {
            sides.push(Side { polygon, place, ends: [points[place], points[(place + 1) % points.len()]] });
        }
    }
    let low = |s: &Side| s.ends[0].x.min(s.ends[1].x);
    sides.sort_by(|a, b| low(a).total_cmp(&low(b)));
    for (at, a) in sides.iter().enumerate() {
        let right = a.ends[0].x.max(a.ends[1].x);
        for b in sides[at + 1..].iter().take_while(|b| low(b) <= right) {
            let n = polygons[a.polygon].len();
            let apart = a.place.abs_diff(b.place);
            let neighbours = a.polygon == b.polygon && (apart <= 1 || apart + 1 == n);
            if !neighbours && cross(a.ends, b.ends) {
                return true;
            }
        }
    }
    false
}

fn cross(a: [DVec2; 2], b: [DVec2; 2]) -> bool {
    let side = |s: [DVec2; 2], p: DVec2| (s[1] - s[0]).perp_dot(p - s[0]) > 0.0;
    side(a, b[0]) != side(a, b[1]) && side(b, a[0]) != side(b, a[1])
}
