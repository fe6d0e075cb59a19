//! How well tissue was cut along a line: which share of it, and how far beside.

use crate::math::{DVec3, closest_point_barycentric};
use crate::record::snapshot::DisplayTopology;
use crate::world::World;
use std::collections::BTreeMap;

/// A cut counts for the line where it is no further beside it than this many times what is allowed: what is further away is another
/// cut. A choice.
const FAR: f64 = 4.0;

/// A straight line on the tissue at rest, seen along the normal of the surface at its middle.
#[derive(Clone, Debug)]
pub(super) struct CutLine {
    from_m: DVec3,
    along: DVec3,
    length_m: f64,
    /// Unit vector beside it, in the surface, and normal of that.
    beside: DVec3,
    normal: DVec3,
    within_m: f64,
    /// The body that it is on.
    body: u8,
}

/// How well a line was cut.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CutQuality {
    /// Share of the line beside which the tissue is cut, near enough.
    pub share: f64,
    /// Mean and greatest distance of the cut's edge from the line, beside it in the surface [m]; none where nothing is cut.
    pub errors_m: Option<[f64; 2]>,
}

impl CutLine {
    /// The line between two places.
    pub(super) fn new(from_m: DVec3, to_m: DVec3, within_m: f64, world: &World) -> Self {
        let along = (to_m - from_m).normalize();
        let (normal, body) = surface_near((from_m + to_m) * 0.5, &world.display_topology());
        let beside = normal.cross(along).normalize_or(along.any_orthonormal_vector());
        let normal = along.cross(beside);
        Self { from_m, along, length_m: from_m.distance(to_m), beside, normal, within_m, body }
    }

    /// How well the tissue is cut along it.
    pub(super) fn quality(&self, surface: &DisplayTopology) -> CutQuality {
        let place = |vertex: u32| {
            let from = surface.rest_positions_m[vertex as usize] - self.from_m;
            (from.dot(self.along), from.dot(self.beside).abs())
        };
        let (mut covered, mut greatest_m) = (Vec::new(), 0.0_f64);
        let (mut sum_m2, mut length_m) = (0.0, 0.0);
        for ([a, b], outward) in rim(surface) {
            // Not the other side of an organ that was cut through, and no other organ.
            if outward.dot(self.normal) <= 0.0 || surface.body_of[a as usize] != self.body {
                continue;
            }
            let ((a_m, a_off_m), (b_m, b_off_m)) = (place(a), place(b));
            let (from_m, to_m) = (a_m.min(b_m).max(0.0), a_m.max(b_m).min(self.length_m));
            let off_m = a_off_m.max(b_off_m);
            if to_m <= from_m || off_m > FAR * self.within_m {
                continue;
            }
            greatest_m = greatest_m.max(off_m);
            sum_m2 += 0.5 * (a_off_m + b_off_m) * (to_m - from_m);
            length_m += to_m - from_m;
            if off_m <= self.within_m {
                covered.push((from_m, to_m));
            }
        }
        CutQuality {
            share: length_of_union_m(covered) / self.length_m,
            errors_m: (length_m > 0.0).then(|| [sum_m2 / length_m, greatest_m]),
        }
    }
}

/// Edges of the surface between a face of a cut and the organ's own skin, with the normal of the skin.
fn rim(surface: &DisplayTopology) -> impl Iterator<Item = ([u32; 2], DVec3)> {
    let mut sides: BTreeMap<[u32; 2], [Option<usize>; 2]> = BTreeMap::new();
    for (number, (triangle, is_cut)) in surface.triangles.iter().zip(&surface.is_cut).enumerate() {
        for i in 0..3 {
            let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
            sides.entry([a.min(b), a.max(b)]).or_default()[usize::from(*is_cut)] = Some(number);
        }
    }
    sides.into_iter().filter_map(|(edge, [skin, cut])| {
        cut?;
        Some((edge, normal_of(&surface.triangles[skin?], surface)))
    })
}

fn length_of_union_m(mut stretches_m: Vec<(f64, f64)>) -> f64 {
    stretches_m.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut length_m, mut end_m) = (0.0, 0.0_f64);
    for (from_m, to_m) in stretches_m {
        length_m += (to_m - from_m.max(end_m)).max(0.0);
        end_m = end_m.max(to_m);
    }
    length_m
}

fn corners_m(triangle: &[u32; 3], surface: &DisplayTopology) -> [DVec3; 3] {
    triangle.map(|vertex| surface.rest_positions_m[vertex as usize])
}

/// Outward unit normal of a triangle at rest.
fn normal_of(triangle: &[u32; 3], surface: &DisplayTopology) -> DVec3 {
    let [a, b, c] = corners_m(triangle, surface);
    (b - a).cross(c - a).normalize_or(DVec3::Z)
}

/// Normal of the surface at rest nearest to a place, and its body.
fn surface_near(p_m: DVec3, surface: &DisplayTopology) -> (DVec3, u8) {
    let away_m = |triangle: &[u32; 3]| {
        let corners_m = corners_m(triangle, surface);
        let weights = closest_point_barycentric(p_m, corners_m);
        corners_m
            .into_iter()
            .zip(weights)
            .map(|(corner, weight)| corner * weight)
            .sum::<DVec3>()
            .distance(p_m)
    };
    let nearest = surface.triangles.iter().min_by(|a, b| away_m(a).total_cmp(&away_m(b)));
    nearest.map_or((DVec3::Z, 0), |triangle| {
        (normal_of(triangle, surface), surface.body_of[triangle[0] as usize])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_union_counts_nothing_twice() {
        assert_eq!(length_of_union_m(vec![(3.0, 4.0), (0.0, 1.0), (0.5, 2.0), (0.6, 0.7)]), 3.0);
        assert_eq!(length_of_union_m(Vec::new()), 0.0);
    }

    /// A strip of two rows of squares in the plane z = 0, of which what lies on a cut is the upper row.
    #[test]
    fn the_rim_of_a_cut_covers_the_line_beside_which_it_runs() {
        let at = |i: u32, j: u32| DVec3::new(f64::from(i), f64::from(j) + 0.1 * f64::from(i % 2), 0.0);
        let mut surface = DisplayTopology {
            version: 0,
            nodes: Vec::new(),
            rest_positions_m: (0..33).map(|n| at(n % 11, n / 11)).collect(),
            triangles: Vec::new(),
            is_cut: Vec::new(),
            body_of: vec![0; 33],
        };
        for j in 0..2 {
            for i in 0..10 {
                let a = j * 11 + i;
                surface.triangles.extend([[a, a + 1, a + 12], [a, a + 12, a + 11]]);
                surface.is_cut.extend([j == 1 && i < 6; 2]);
            }
        }
        let line = |y: f64, within_m: f64| CutLine {
            from_m: DVec3::new(0.0, y, 0.0),
            along: DVec3::X,
            length_m: 10.0,
            beside: DVec3::Y,
            normal: DVec3::Z,
            within_m,
            body: 0,
        };
        let quality = line(1.0, 0.15).quality(&surface);
        assert!((quality.share - 0.6).abs() < 1e-12, "{quality:?}");
        let [mean_m, greatest_m] = quality.errors_m.unwrap();
        assert!((greatest_m - 0.1).abs() < 1e-12 && (mean_m - 0.05).abs() < 1e-12);
        assert_eq!(line(1.0, 0.05).quality(&surface).share, 0.0, "each edge has an end 0.1 beside");
        assert_eq!(line(-3.0, 0.15).quality(&surface), CutQuality::default(), "another cut");
        let other = CutLine { body: 1, ..line(1.0, 0.15) };
        assert_eq!(other.quality(&surface), CutQuality::default(), "another body");
        let behind = CutLine { normal: DVec3::NEG_Z, ..line(1.0, 0.15) };
        assert_eq!(behind.quality(&surface), CutQuality::default(), "the other side");
        surface.is_cut.fill(false);
        assert_eq!(line(1.0, 0.15).quality(&surface), CutQuality::default());
    }
}
