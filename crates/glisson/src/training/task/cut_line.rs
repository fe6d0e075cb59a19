//! How well tissue was cut along a line: which share of it, and how far beside.

use crate::math::{DVec3, closest_point_barycentric};
use crate::record::snapshot::DisplayTopology;
use crate::scene::LineSource;
use crate::world::World;
use std::collections::BTreeMap;

/// A cut counts for the line where it is no further beside it than this many times what is allowed: what is further away is another
/// cut. A choice.
const FAR: f64 = 4.0;

/// A line on the tissue at rest, straight from point to point.
#[derive(Clone, Debug)]
pub(super) struct CutLine {
    pieces: Vec<Straight>,
    is_closed: bool,
    length_m: f64,
    within_m: f64,
    /// The body that it is on.
    body: u8,
}

/// A straight piece of a line, seen along the normal of the surface at its middle.
#[derive(Clone, Copy, Debug)]
struct Straight {
    from_m: DVec3,
    /// Where it begins on the whole line [m].
    begins_m: f64,
    length_m: f64,
    along: DVec3,
    /// Unit vector beside it, in the surface, and normal of that.
    beside: DVec3,
    normal: DVec3,
}

/// Where a point is at a line.
#[derive(Clone, Copy, Debug)]
struct AtLine {
    piece: usize,
    /// How far along the whole line [m]: before 0 or beyond its length where an open line ends.
    along_m: f64,
    /// How far beside it [m].
    off_m: f64,
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
    /// The line through these places.
    pub(super) fn new(line: &LineSource, within_m: f64, world: &World) -> Self {
        let surface = world.display_topology();
        let n = line.points_m.len();
        let n_pieces = if line.is_closed { n } else { n - 1 };
        let (mut pieces, mut length_m, mut on_body) = (Vec::with_capacity(n_pieces), 0.0, 0);
        for nth in 0..n_pieces {
            let [from_m, to_m] = [line.points_m[nth], line.points_m[(nth + 1) % n]];
            let (normal, body) = surface_near((from_m + to_m) * 0.5, &surface);
            let piece = Straight::new(from_m, to_m, length_m, normal);
            length_m += piece.length_m;
            pieces.push(piece);
            if nth == 0 {
                on_body = body;
            }
        }
        Self { pieces, is_closed: line.is_closed, length_m, within_m, body: on_body }
    }

    /// Where a point is, by the nearest piece.
    fn place(&self, p_m: DVec3) -> AtLine {
        let last = self.pieces.len() - 1;
        let at = |(nth, piece): (usize, &Straight)| {
            let from_m = p_m - piece.from_m;
            let along_m = from_m.dot(piece.along);
            // An open line goes straight on beyond its ends: what is there is not beside it.
            let least_m = if nth == 0 && !self.is_closed { f64::NEG_INFINITY } else { 0.0 };
            let most_m = if nth == last && !self.is_closed { f64::INFINITY } else { piece.length_m };
            let on_piece_m = along_m.clamp(least_m, most_m);
            let off_m = libm::hypot(along_m - on_piece_m, from_m.dot(piece.beside));
            AtLine { piece: nth, along_m: piece.begins_m + on_piece_m, off_m }
        };
        let places = self.pieces.iter().enumerate().map(at);
        places.min_by(|a, b| a.off_m.total_cmp(&b.off_m)).expect("a line has a piece at least")
    }

    /// How well the tissue is cut along it.
    pub(super) fn quality(&self, surface: &DisplayTopology) -> CutQuality {
        let place = |vertex: u32| self.place(surface.rest_positions_m[vertex as usize]);
        let (mut covered, mut greatest_m) = (Vec::new(), 0.0_f64);
        let (mut sum_m2, mut length_m) = (0.0, 0.0);
        for ([a, b], outward) in rim(surface) {
            if surface.body_of[a as usize] != self.body {
                continue;
            }
            let (a, b) = (place(a), place(b));
            // Not the other side of an organ that was cut through, and no other organ.
            if outward.dot(self.pieces[a.piece].normal) <= 0.0 {
                continue;
            }
            let off_m = a.off_m.max(b.off_m);
            if off_m > FAR * self.within_m {
                continue;
            }
            for (from_m, to_m) in self.stretches(a.along_m, b.along_m) {
                greatest_m = greatest_m.max(off_m);
                sum_m2 += 0.5 * (a.off_m + b.off_m) * (to_m - from_m);
                length_m += to_m - from_m;
                if off_m <= self.within_m {
                    covered.push((from_m, to_m));
                }
            }
        }
        CutQuality {
            share: length_of_union_m(covered) / self.length_m,
            errors_m: (length_m > 0.0).then(|| [sum_m2 / length_m, greatest_m]),
        }
    }

    /// What lies between two places along the line: of a closed line the shorter way, which may lead over its beginning.
    fn stretches(&self, a_m: f64, b_m: f64) -> impl Iterator<Item = (f64, f64)> {
        let (from_m, to_m) = (a_m.min(b_m), a_m.max(b_m));
        let is_over_beginning = self.is_closed && to_m - from_m > 0.5 * self.length_m;
        let both = if is_over_beginning {
            [(0.0, from_m), (to_m, self.length_m)]
        } else {
            [(from_m.max(0.0), to_m.min(self.length_m)), (0.0, 0.0)]
        };
        both.into_iter().filter(|(from_m, to_m)| to_m > from_m)
    }
}

impl Straight {
    fn new(from_m: DVec3, to_m: DVec3, begins_m: f64, normal: DVec3) -> Self {
        let along = (to_m - from_m).normalize();
        let beside = normal.cross(along).normalize_or(along.any_orthonormal_vector());
        let length_m = from_m.distance(to_m);
        Self { from_m, begins_m, length_m, along, beside, normal: along.cross(beside) }
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
        let along = |y: f64, normal: DVec3, within_m: f64, body: u8| {
            let piece = Straight::new(DVec3::new(0.0, y, 0.0), DVec3::new(10.0, y, 0.0), 0.0, normal);
            CutLine { pieces: vec![piece], is_closed: false, length_m: 10.0, within_m, body }
        };
        let line = |y: f64, within_m: f64| along(y, DVec3::Z, within_m, 0);
        let quality = line(1.0, 0.15).quality(&surface);
        assert!((quality.share - 0.6).abs() < 1e-12, "{quality:?}");
        let [mean_m, greatest_m] = quality.errors_m.unwrap();
        assert!((greatest_m - 0.1).abs() < 1e-12 && (mean_m - 0.05).abs() < 1e-12);
        assert_eq!(line(1.0, 0.05).quality(&surface).share, 0.0, "each edge has an end 0.1 beside");
        assert_eq!(line(-3.0, 0.15).quality(&surface), CutQuality::default(), "another cut");
        let other = along(1.0, DVec3::Z, 0.15, 1);
        assert_eq!(other.quality(&surface), CutQuality::default(), "another body");
        let behind = along(1.0, DVec3::NEG_Z, 0.15, 0);
        assert_eq!(behind.quality(&surface), CutQuality::default(), "the other side");
        surface.is_cut.fill(false);
        assert_eq!(line(1.0, 0.15).quality(&surface), CutQuality::default());
    }
    /// A ring of squares between radii 1 and 2, and one of cuts within; the rim between is a polygon of 24 corners.
    #[test]
    fn a_closed_line_is_covered_over_its_beginning_too() {
        let n = 24;
        let at = |radius: f64, nth: u32| {
            let angle_rad = std::f64::consts::TAU * f64::from(nth) / f64::from(n);
            DVec3::new(radius * angle_rad.cos(), radius * angle_rad.sin(), 0.0)
        };
        let mut surface = DisplayTopology {
            version: 0,
            nodes: Vec::new(),
            rest_positions_m: (0..3 * n).map(|k| at(f64::from(k / n) * 0.5 + 0.5, k % n)).collect(),
            triangles: Vec::new(),
            is_cut: Vec::new(),
            body_of: vec![0; 3 * n as usize],
        };
        for ring in 0..2 {
            for nth in 0..n {
                let [a, b] = [nth, (nth + 1) % n].map(|k| ring * n + k);
                surface.triangles.extend([[a, a + n, b + n], [a, b + n, b]]);
                surface.is_cut.extend([ring == 0; 2]);
            }
        }
        // The circle at radius 1, begun between two corners of the rim.
        let circle = |radius: f64, within_m: f64| {
            let at = |nth: u32| {
                let angle_rad = std::f64::consts::TAU * (f64::from(nth) + 0.5) / 72.0;
                DVec3::new(radius * angle_rad.cos(), radius * angle_rad.sin(), 0.0)
            };
            let (mut pieces, mut length_m) = (Vec::new(), 0.0);
            for nth in 0..72 {
                pieces.push(Straight::new(at(nth), at((nth + 1) % 72), length_m, DVec3::Z));
                length_m += pieces[nth as usize].length_m;
            }
            CutLine { pieces, is_closed: true, length_m, within_m, body: 0 }
        };
        let quality = circle(1.0, 0.02).quality(&surface);
        assert!((quality.share - 1.0).abs() < 1e-9, "{quality:?}");
        assert!(quality.errors_m.unwrap()[1] < 1e-2, "{quality:?}");
        let [mean_m, greatest_m] = circle(1.1, 0.15).quality(&surface).errors_m.unwrap();
        assert!((mean_m - 0.1).abs() < 2e-3 && (greatest_m - 0.1).abs() < 2e-3);
        // A quarter of it is not cut.
        surface.is_cut[..2 * n as usize / 4].fill(false);
        let share = circle(1.0, 0.02).quality(&surface).share;
        assert!((share - 0.75).abs() < 1e-2, "{share}");
    }
}
