//! Between contours and pixels: the pixels inside closed polygons, and the outlines of a set of pixels.

use super::plane::Plane;
use super::polygon::signed_area_m2;
use crate::image::filter::{self, Connectivity};
use crate::image::resample::VoxelBox;
use crate::math::DVec2;

/// For each pixel whether its centre is inside one of the polygons.
///
/// A row of centres is cut by the sides that begin at or above it and end below it (half-open, so that a corner on
/// the row counts once); a centre is inside when the sides at or left of it wind around it more often forwards
/// than backwards, each polygon taken in its positive direction. Overlapping polygons are united, and a loop
/// that a self-crossing turned inside out is left out. Polygons that share a side share no pixel and leave none
/// out.
pub fn rasterised<P: AsRef<[DVec2]>>(plane: &Plane, polygons: &[P]) -> Vec<bool> {
    let [n_i, n_j] = plane.dims;
    // For each row the places where it is cut [pixels along i], with the direction.
    let mut cuts: Vec<Vec<(f64, i32)>> = vec![Vec::new(); n_j];
    for polygon in polygons {
        let points: Vec<DVec2> = polygon.as_ref().iter().map(|&p| p / plane.spacing_m).collect();
        let sense = if signed_area_m2(&points) >= 0.0 { 1 } else { -1 };
        for p in 0..points.len() {
            let (a, b) = (points[p], points[(p + 1) % points.len()]);
            // The same expression for both directions of a side, so that polygons that share it agree.
            let (upper, lower, step) = if a.y <= b.y { (a, b, -sense) } else { (b, a, sense) };
            let rows = upper.y.ceil().max(0.0) as usize..(lower.y.ceil().max(0.0) as usize).min(n_j);
            for j in rows {
                let share = (j as f64 - upper.y) / (lower.y - upper.y);
                cuts[j].push((upper.x + share * (lower.x - upper.x), step));
            }
        }
    }
    let mut mask = vec![false; plane.n_pixels()];
    for (row, cuts) in mask.chunks_mut(n_i.max(1)).zip(&mut cuts) {
        cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut winding = 0;
        for pair in 0..cuts.len() {
            winding += cuts[pair].1;
            if winding > 0 {
                let end = cuts.get(pair + 1).map_or(n_i as f64, |c| c.0);
                let range = cuts[pair].0.ceil().max(0.0) as usize..(end.ceil().max(0.0) as usize).min(n_i);
                if range.start < range.end {
                    row[range].fill(true);
                }
            }
        }
    }
    mask
}

/// Outer outlines of the pieces of a mask whose pixels share edges, in the positive direction; holes are passed
/// over. The corners lie halfway between a pixel inside and its neighbour outside.
pub fn outlines(plane: &Plane, mask: &[bool]) -> Vec<Vec<DVec2>> {
    let whole = plane.grid();
    let Some(part) = VoxelBox::around(&whole, mask, whole.spacing_m.max_element()) else { return Vec::new() };
    let near = part.grid(&whole);
    let [n_i, n_j, _] = near.dims;
    let low = [part.first[0] as isize, part.first[1] as isize];
    let mask = part.cut(&whole, mask);
    let found = filter::components(&near, &mask, Connectivity::Faces);
    let mut is_traced = vec![false; found.sizes.len()];
    let mut result = Vec::new();
    for first in 0..mask.len() {
        let piece = found.piece[first];
        if piece == 0 || is_traced[piece as usize - 1] {
            continue;
        }
        is_traced[piece as usize - 1] = true;
        let is_inside = |i: isize, j: isize| {
            let (i, j) = (i - low[0], j - low[1]);
            (0..n_i as isize).contains(&i)
                && (0..n_j as isize).contains(&j)
                && found.piece[i as usize + n_i * j as usize] == piece
        };
        let corner = [(first % n_i) as isize + low[0], (first / n_i) as isize + low[1]];
        result.push(outline(plane, corner, is_inside));
    }
    result
}

/// Walks around a piece along the edges of its pixels, the piece at the left hand (towards +j when walking along
/// +i). `first` is the piece's first pixel in the order of the data.
fn outline(plane: &Plane, first: [isize; 2], is_inside: impl Fn(isize, isize) -> bool) -> Vec<DVec2> {
    /// Steps along +i, +j, -i, -j.
    const STEPS: [[isize; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    // Corner (a, b) is the upper left corner of pixel (a, b). Walking along `direction` from it, the pixels
    // ahead at the left and at the right:
    let ahead = |[a, b]: [isize; 2], direction: usize| match direction {
        0 => ([a, b], [a, b - 1]),
        1 => ([a - 1, b], [a, b]),
        2 => ([a - 1, b - 1], [a - 1, b]),
        _ => ([a, b - 1], [a - 1, b - 1]),
    };
    let (mut corner, mut direction) = (first, 0);
    let mut points = Vec::new();
    loop {
        let ([i, j], [out_i, out_j]) = ahead(corner, direction);
        let middle = DVec2::new((i + out_i) as f64, (j + out_j) as f64) * 0.5;
        points.push(middle * plane.spacing_m);
        corner = [corner[0] + STEPS[direction][0], corner[1] + STEPS[direction][1]];
        let (left, right) = ahead(corner, direction);
        // Left first: pixels that touch at a corner only are not joined.
        direction = if !is_inside(left[0], left[1]) {
            (direction + 1) % 4
        } else if is_inside(right[0], right[1]) {
            (direction + 3) % 4
        } else {
            direction
        };
        if corner == first && direction == 0 {
            return points;
        }
    }
}
