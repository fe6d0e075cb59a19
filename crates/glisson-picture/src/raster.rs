//! Z-buffered triangles: which triangle each sample of the picture sees.
//!
//! Corners are snapped to sixteenths of a sample and edges are compared in integers with a fill rule
//! (an edge belongs to the triangle that runs along it upwards, or to the right), so that triangles that share an
//! edge leave no gap and cover no sample twice (Pineda 1988, doi 10.1145/54852.378457). What is compared
//! is 1 / depth, which is linear in the picture. Ties go to the earlier triangle.

use glam::Vec3;
use rayon::prelude::*;

use super::camera::{Camera, Projection};
use super::geometry::Facets;

/// Samples along each edge of a pixel.
const SAMPLES: usize = 3;
/// Rows of samples that are drawn together: fixed, so that the picture does not depend on the threads.
const BAND_ROWS: usize = 48;
/// Snapping grid: parts of a sample.
const SUBSAMPLES: i64 = 16;
/// From a sample's corner to its middle, in parts of a sample.
const HALF_SAMPLE: i64 = SUBSAMPLES / 2;
/// Coordinates beyond this many samples are cut off, so that products of two stay below 2^63.
const MAX_COORDINATE: f32 = 1e6;
/// No triangle.
const NONE: u32 = u32::MAX;
/// Samples of one surface belong together when their depths differ by less than this part.
const SAME_DEPTH: f32 = 0.02;

/// A triangle in sample coordinates; `nearness` grows towards the viewer and is linear in the picture.
#[derive(Clone, Copy, Debug)]
struct ScreenTriangle {
    corners: [[f32; 2]; 3],
    nearness: [f32; 3],
    index: u32,
}

/// Triangle and nearness of every sample of some rows.
#[derive(Debug)]
struct Band {
    width: usize,
    first_row: usize,
    n_rows: usize,
    nearness: Vec<f32>,
    triangle: Vec<u32>,
}

/// Twice the area of the triangle of three points, positive when they turn one way.
#[inline]
fn cross(a: [i64; 2], b: [i64; 2], p: [i64; 2]) -> i64 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

/// The samples of a row that a triangle covers.
struct Covered {
    first: i64,
    last: i64,
    /// Values of the three edges at the leftmost sample that was looked at.
    at_left: [i64; 3],
}

/// What the triangle of `corner` covers of a row between two samples; `None` for nothing.
#[inline]
fn covered(corner: &[[i64; 2]; 3], row: i64, [left, right]: [i64; 2]) -> Option<Covered> {
    let start = [left * SUBSAMPLES + HALF_SAMPLE, row * SUBSAMPLES + HALF_SAMPLE];
    let (mut first, mut last) = (left, right);
    let mut at_left = [0i64; 3];
    for edge in 0..3 {
        // Edge `edge` is opposite to corner `edge`.
        let (a, b) = (corner[(edge + 1) % 3], corner[(edge + 2) % 3]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let value = cross(a, b, start);
        at_left[edge] = value;
        let owned = dy < 0 || (dy == 0 && dx > 0);
        let least = i64::from(!owned);
        let step = -dy * SUBSAMPLES;
        // value + step * k >= least
        if step > 0 {
            let k = (least - value + step - 1).div_euclid(step);
            first = first.max(left + k);
        } else if step < 0 {
            let k = (value - least).div_euclid(-step);
            last = last.min(left + k);
        } else if value < least {
            last = first - 1;
        }
    }
    (first <= last).then_some(Covered { first, last, at_left })
}

impl Band {
    fn draw(&mut self, triangle: &ScreenTriangle) {
        let snap = |c: f32| (c.clamp(-MAX_COORDINATE, MAX_COORDINATE) * SUBSAMPLES as f32).round() as i64;
        let mut corner = triangle.corners.map(|[x, y]| [snap(x), snap(y)]);
        let mut near = triangle.nearness.map(f64::from);
        let mut area = cross(corner[0], corner[1], corner[2]);
        if area == 0 {
            return;
        }
        if area < 0 {
            corner.swap(1, 2);
            near.swap(1, 2);
            area = -area;
        }
        let half = HALF_SAMPLE;
        let sample_at_or_after = |c: i64| (c - half + SUBSAMPLES - 1).div_euclid(SUBSAMPLES);
        let span = |axis: usize| {
            let [a, b, c] = corner.map(|p| p[axis]);
            (sample_at_or_after(a.min(b).min(c)), (a.max(b).max(c) - half).div_euclid(SUBSAMPLES))
        };
        let ((left, right), (top, bottom)) = (span(0), span(1));
        let (left, right) = (left.max(0), right.min(self.width as i64 - 1));
        let top = top.max(self.first_row as i64);
        let bottom = bottom.min((self.first_row + self.n_rows) as i64 - 1);
        if left > right {
            return;
        }
        for row in top..=bottom {
            let Some(Covered { first, last, at_left }) = covered(&corner, row, [left, right]) else {
                continue;
            };
            let share = |edge: usize| at_left[edge] as f64 / area as f64;
            let step_of = |edge: usize| {
                (corner[(edge + 1) % 3][1] - corner[(edge + 2) % 3][1]) as f64 * SUBSAMPLES as f64
                    / area as f64
            };
            let at_start: f64 = (0..3).map(|e| share(e) * near[e]).sum();
            let step: f64 = (0..3).map(|e| step_of(e) * near[e]).sum();
            let row_start = (row as usize - self.first_row) * self.width;
            let places = row_start + first as usize..=row_start + last as usize;
            let mut k = (first - left) as f64;
            for (near, index) in self.nearness[places.clone()].iter_mut().zip(&mut self.triangle[places]) {
                let here = (at_start + k * step) as f32;
                if here > *near {
                    *near = here;
                    *index = triangle.index;
                }
                k += 1.0;
            }
        }
    }
}

/// Bands of a picture of `width` x `height` samples with `triangles` drawn, handed to `finish`; answers
/// in the order of the bands.
fn draw_bands<T: Send>(
    triangles: &[ScreenTriangle],
    [width, height]: [usize; 2],
    finish: impl Fn(Band) -> T + Sync,
) -> Vec<T> {
    let n_bands = height.div_ceil(BAND_ROWS);
    let mut of_band: Vec<Vec<u32>> = vec![Vec::new(); n_bands];
    for (place, triangle) in triangles.iter().enumerate() {
        let rows = triangle.corners.map(|c| c[1]);
        let top = rows.iter().fold(f32::INFINITY, |a, &b| a.min(b));
        let bottom = rows.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        if bottom < 0.0 || top > height as f32 {
            continue;
        }
        let first = top.max(0.0) as usize / BAND_ROWS;
        let last = (bottom as usize / BAND_ROWS).min(n_bands - 1);
        let place = u32::try_from(place).expect("a picture has fewer than 2^32 triangles");
        (first..=last).for_each(|band| of_band[band].push(place));
    }
    of_band
        .par_iter()
        .enumerate()
        .map(|(index, places)| {
            let first_row = index * BAND_ROWS;
            let n_rows = BAND_ROWS.min(height - first_row);
            let mut band = Band {
                width,
                first_row,
                n_rows,
                nearness: vec![f32::NEG_INFINITY; width * n_rows],
                triangle: vec![NONE; width * n_rows],
            };
            for &place in places {
                band.draw(&triangles[place as usize]);
            }
            finish(band)
        })
        .collect()
}

/// What of one surface a pixel sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fragment {
    /// A triangle of it: that of the sample nearest to the pixel's middle.
    pub(super) triangle: u32,
    /// Share of the pixel's samples.
    pub(super) coverage: f32,
    /// Mean place of those samples [pixels].
    pub(super) place: [f32; 2],
}

/// Fragments of every pixel, the nearest surface first.
#[derive(Debug)]
pub(super) struct Samples {
    pub(super) size: [usize; 2],
    /// `fragments[starts[p]..starts[p + 1]]` belong to pixel `p`.
    starts: Vec<u32>,
    fragments: Vec<Fragment>,
}

impl Samples {
    /// What `camera` sees of `facets` in a picture of `size` pixels.
    pub(super) fn of_view(facets: &Facets, camera: &Camera, size: [usize; 2]) -> Self {
        let triangles = screen_triangles(facets, Projection::new(camera, size), SAMPLES);
        let bands = draw_bands(&triangles, size.map(|edge| edge * SAMPLES), |band| resolve(&band, facets));
        let mut samples = Self { size, starts: vec![0], fragments: Vec::new() };
        for (counts, fragments) in bands {
            for count in counts {
                let last = samples.starts[samples.starts.len() - 1];
                samples.starts.push(last + u32::from(count));
            }
            samples.fragments.extend(fragments);
        }
        samples
    }

    /// Fragments of pixel `index`, counted along the rows.
    pub(super) fn of_pixel(&self, index: usize) -> &[Fragment] {
        &self.fragments[self.starts[index] as usize..self.starts[index + 1] as usize]
    }
}

/// Depth along the view [m] and part of `facets` at the middle of each pixel, row by row; none where nothing is seen.
pub(super) fn depths_and_parts(
    facets: &Facets,
    camera: &Camera,
    size: [usize; 2],
) -> Vec<Option<(f32, u32)>> {
    let triangles = screen_triangles(facets, Projection::new(camera, size), 1);
    let of_band = |band: Band| {
        let seen = |(triangle, nearness): (&u32, &f32)| {
            (*triangle != NONE).then(|| (1.0 / nearness, facets.part_of[*triangle as usize]))
        };
        band.triangle.iter().zip(&band.nearness).map(seen).collect::<Vec<_>>()
    };
    draw_bands(&triangles, size, of_band).concat()
}

/// Groups the samples of each pixel of a band by surface: counts per pixel, then the fragments.
fn resolve(band: &Band, facets: &Facets) -> (Vec<u8>, Vec<Fragment>) {
    // From the middle outwards, so that the first sample of a group is its most central one.
    const ORDER: [usize; SAMPLES * SAMPLES] = [4, 1, 3, 5, 7, 0, 2, 6, 8];
    struct Group {
        fragment: Fragment,
        part: u32,
        nearness: f32,
        n: f32,
    }
    let width = band.width / SAMPLES;
    let (mut counts, mut fragments) = (Vec::new(), Vec::new());
    let mut groups: Vec<Group> = Vec::new();
    for row in 0..band.n_rows / SAMPLES {
        for column in 0..width {
            groups.clear();
            for sample in ORDER {
                let (dx, dy) = (sample % SAMPLES, sample / SAMPLES);
                let (x, y) = (column * SAMPLES + dx, row * SAMPLES + dy);
                let triangle = band.triangle[y * band.width + x];
                if triangle == NONE {
                    continue;
                }
                let nearness = band.nearness[y * band.width + x];
                let part = facets.part_of[triangle as usize];
                let place =
                    [(x as f32 + 0.5) / SAMPLES as f32, ((band.first_row + y) as f32 + 0.5) / SAMPLES as f32];
                let same = |g: &&mut Group| {
                    g.part == part && (g.nearness - nearness).abs() < SAME_DEPTH * g.nearness
                };
                if let Some(group) = groups.iter_mut().find(same) {
                    group.n += 1.0;
                    group.fragment.place[0] += place[0];
                    group.fragment.place[1] += place[1];
                } else {
                    let fragment = Fragment { triangle, coverage: 0.0, place };
                    groups.push(Group { fragment, part, nearness, n: 1.0 });
                }
            }
            // Stable: equal nearness keeps the order above.
            groups.sort_by(|a, b| b.nearness.total_cmp(&a.nearness));
            counts.push(u8::try_from(groups.len()).expect("a pixel has at most nine groups"));
            fragments.extend(groups.iter().map(|g| Fragment {
                coverage: g.n / (SAMPLES * SAMPLES) as f32,
                place: g.fragment.place.map(|c| c / g.n),
                ..g.fragment
            }));
        }
    }
    (counts, fragments)
}

/// Triangles as the camera sees them with so many samples along a pixel's edge, cut at the near plane.
fn screen_triangles(facets: &Facets, projection: Projection, n_samples: usize) -> Vec<ScreenTriangle> {
    let in_camera: Vec<Vec3> = facets.positions.iter().map(|&p| projection.to_camera(p)).collect();
    // 1 / depth is below 1 / near; this much more puts overlays in front of everything else.
    let overlay_lift = 2.0 / projection.near_m;
    let mut triangles = Vec::with_capacity(facets.triangles.len());
    for (index, triangle) in facets.triangles.iter().enumerate() {
        let corners = triangle.map(|v| in_camera[v as usize]);
        let lift = if facets.parts[facets.part_of[index] as usize].overlay { overlay_lift } else { 0.0 };
        let (polygon, n) = cut_at_depth(corners, projection.near_m);
        for c in 2..n {
            let piece = [polygon[0], polygon[c - 1], polygon[c]];
            triangles.push(ScreenTriangle {
                corners: piece.map(|p| projection.to_pixels(p).map(|c| c * n_samples as f32)),
                nearness: piece.map(|p| 1.0 / p.z + lift),
                index: u32::try_from(index).expect("a picture has fewer than 2^32 triangles"),
            });
        }
    }
    triangles
}

/// The part of a triangle with `z >= near`: a polygon of up to four corners.
fn cut_at_depth(corners: [Vec3; 3], near: f32) -> ([Vec3; 4], usize) {
    let (mut polygon, mut n) = ([Vec3::ZERO; 4], 0);
    for c in 0..3 {
        let (a, b) = (corners[c], corners[(c + 1) % 3]);
        if a.z >= near {
            polygon[n] = a;
            n += 1;
        }
        if (a.z >= near) != (b.z >= near) {
            polygon[n] = a.lerp(b, (near - a.z) / (b.z - a.z));
            polygon[n].z = near;
            n += 1;
        }
    }
    (polygon, n)
}

/// How near to a far light the scene is, seen from the light.
#[derive(Debug)]
pub(super) struct ShadowMap {
    edge_texels: usize,
    /// Columns: directions across and along the light; `towards` points to it.
    across: Vec3,
    along: Vec3,
    towards: Vec3,
    corner: [f32; 2],
    texels_per_m: f32,
    nearness: Vec<f32>,
}

impl ShadowMap {
    /// Of large pictures; small ones take so many texels a pixel, so that the map costs no more than they do.
    const MOST_TEXELS: usize = 1536;
    const TEXELS_PER_PIXEL: usize = 4;
    const LEAST_TEXELS: usize = 256;

    /// Shadows of a light in direction `towards`, over the scene's organs, for a picture of `size` pixels.
    pub(super) fn new(facets: &Facets, towards: Vec3, size: [usize; 2]) -> Self {
        let across = towards.any_orthonormal_vector();
        let along = towards.cross(across);
        let (low, high) = facets.organ_bounds.unwrap_or((Vec3::ZERO, Vec3::ZERO));
        let (center, radius) = (0.5 * (low + high), (0.5 * (high - low).length() * 1.02).max(1e-6));
        let wanted = Self::TEXELS_PER_PIXEL * size[0].max(size[1]);
        let edge_texels = wanted.clamp(Self::LEAST_TEXELS, Self::MOST_TEXELS);
        let texels_per_m = edge_texels as f32 / (2.0 * radius);
        let corner = [center.dot(across) - radius, center.dot(along) - radius];
        let mut map =
            Self { edge_texels, across, along, towards, corner, texels_per_m, nearness: Vec::new() };
        let triangles: Vec<ScreenTriangle> = (0..facets.triangles.len())
            .filter(|&t| facets.parts[facets.part_of[t] as usize].casts_shadow)
            .map(|t| {
                let corners = facets.triangles[t].map(|v| facets.positions[v as usize]);
                ScreenTriangle {
                    corners: corners.map(|p| map.texel(p)),
                    nearness: corners.map(|p| p.dot(towards)),
                    index: 0,
                }
            })
            .collect();
        map.nearness = draw_bands(&triangles, [edge_texels; 2], |band| band.nearness).concat();
        map
    }

    fn texel(&self, p: Vec3) -> [f32; 2] {
        [
            (p.dot(self.across) - self.corner[0]) * self.texels_per_m,
            (p.dot(self.along) - self.corner[1]) * self.texels_per_m,
        ]
    }

    /// Share of the light that reaches `position`, whose surface normal is `normal`: softened over a few
    /// texels.
    pub(super) fn lit_share(&self, position: Vec3, normal: Vec3) -> f32 {
        const REACH: i32 = 3;
        const SPREAD_TEXELS: f32 = 1.5;
        let texel_m = 1.0 / self.texels_per_m;
        // Lifted off the surface, so that it does not shade itself where the map is coarser than it.
        let lifted = position + normal * (6.0 * texel_m) + self.towards * (3.0 * texel_m);
        let [x, y] = self.texel(lifted);
        let nearness = lifted.dot(self.towards);
        let (mut lit, mut total) = (0.0, 0.0);
        for j in -REACH..=REACH {
            for i in -REACH..=REACH {
                let weight = (1 + REACH - i.abs()) as f32 * (1 + REACH - j.abs()) as f32;
                let (u, v) = (x + i as f32 * SPREAD_TEXELS, y + j as f32 * SPREAD_TEXELS);
                let edge = self.edge_texels as f32;
                let inside = u >= 0.0 && v >= 0.0 && u < edge && v < edge;
                let open = !inside || self.nearness[u as usize + self.edge_texels * v as usize] <= nearness;
                lit += if open { weight } else { 0.0 };
                total += weight;
            }
        }
        lit / total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn screen(corners: [[f32; 2]; 3], nearness: f32, index: u32) -> ScreenTriangle {
        ScreenTriangle { corners, nearness: [nearness; 3], index }
    }

    #[test]
    fn triangles_that_share_edges_cover_each_sample_once() {
        // A fan around a point in a 60 x 60 field: every sample is covered by exactly one triangle.
        // Edges run through sample middles.
        let center = [23.5, 31.5];
        let rim = [[0.0, 0.0], [60.0, 0.0], [60.0, 60.0], [0.0, 60.0], [0.0, 31.5]];
        let mut covered = vec![0; 3600];
        for i in 0..rim.len() {
            let triangle = screen([center, rim[i], rim[(i + 1) % rim.len()]], 1.0, 0);
            let bands = draw_bands(&[triangle], [60, 60], |band| band.triangle);
            for (count, triangle) in covered.iter_mut().zip(bands.concat()) {
                *count += usize::from(triangle != NONE);
            }
        }
        assert!(covered.iter().all(|&n| n == 1));
    }

    #[test]
    fn the_nearer_triangle_wins_whatever_the_order() {
        let shape = [[-5.0, -5.0], [80.0, -5.0], [-5.0, 80.0]];
        for order in [[0, 1], [1, 0]] {
            let triangles = order.map(|i| screen(shape, [1.0, 2.0][i], i as u32));
            let seen = draw_bands(&triangles, [20, 20], |band| band.triangle).concat();
            assert!(seen.iter().all(|&t| t == 1));
        }
    }

    #[test]
    fn nearness_is_linear_across_a_triangle() {
        let triangle = ScreenTriangle {
            corners: [[0.0, 0.0], [64.0, 0.0], [0.0, 64.0]],
            nearness: [1.0, 65.0, 129.0],
            index: 0,
        };
        let near = draw_bands(&[triangle], [64, 64], |band| band.nearness).concat();
        for (x, y) in [(0, 0), (10, 3), (2, 50)] {
            let expected = 1.0 + (x as f32 + 0.5) + 2.0 * (y as f32 + 0.5);
            assert!((near[x + 64 * y] - expected).abs() < 1e-4);
        }
    }

    #[test]
    fn a_triangle_through_the_near_plane_is_cut() {
        let behind = [Vec3::new(0.0, 0.0, 2.0), Vec3::new(1.0, 0.0, 2.0), Vec3::new(0.0, 1.0, -1.0)];
        let (polygon, n) = cut_at_depth(behind, 1.0);
        assert_eq!(n, 4);
        assert!(polygon.iter().all(|p| p.z >= 1.0));
        assert_eq!(cut_at_depth(behind.map(|p| -p), 3.0).1, 0);
    }
}
