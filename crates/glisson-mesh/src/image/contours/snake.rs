//! Deformable contours in a slice.
//!
//! A contour is a closed polygon x_p with evenly spaced points. In a step, with L the second difference along the polygon,
//!
//! x' = (1 - a L + b L L)^-1 (x + f),
//!
//! a the elasticity, b the bending stiffness, both for one step (Kass, Witkin and Terzopoulos 1988, "Snakes: Active Contour
//! Models", doi 10.1007/BF00133570, with the step taken in). As the points are evenly spaced,
//! the matrix is circulant, and its inverse is a convolution around the polygon: it is taken exactly.
//!
//! The force f along the outward normal is the one of
//! - an edge, if a probe along the normal passes one within reach at which the image is more like the organ
//!   inside than outside: a share of the distance to the nearest;
//! - else a balloon (Cohen 1991, "On Active Contour Models and Balloons", doi 10.1016/1049-9660(91)90028-N): outwards where
//!   the image is at the organ's level, fading to nothing at the limits of its band, inwards beyond.
//!
//! Where contours cross, themselves or others, they are drawn as pixels and outlined again: so they split and
//! merge, and what they enclose is inside.

use rayon::prelude::*;

use super::edges::{Edge, SliceEdges};
use super::level::OrganLevel;
use super::params::ContourParams;
use super::plane::Plane;
use super::polygon::{any_crossing, resampled};
use super::raster::{outlines, rasterised};
use crate::image::segment::statistics::median;
use crate::math::DVec2;

/// Least points of a contour that a thread takes at a time.
const POINTS_A_TASK: usize = 64;
/// Of the difference to the organ's level at a border, the share that its blur may leave 3 mm inside. What lies
/// beyond a thin wall of another tissue shows more.
const INSIDE_SHARE: f32 = 0.4;
/// Steps between two looks for crossings and for rest.
const STEPS_A_ROUND: usize = 8;
/// Change of the number of pixels inside in a round below which the contours no longer travel.
const TRAVEL_SHARE: f64 = 0.01;
/// What steps are shortened by after a round without travel, so that points that swing over a border settle. All
/// forces are shortened alike: where they balance does not change.
const DAMPING: f64 = 0.6;
/// Length of the steps of contours at rest, as a share of the first.
const REST_STEP: f64 = 0.1;

/// What contours are drawn to in a slice.
#[derive(Clone, Copy, Debug)]
pub(super) struct SliceImage<'a> {
    pub(super) plane: &'a Plane,
    /// The denoised image [HU].
    pub(super) smooth: &'a [f32],
    pub(super) edges: &'a SliceEdges,
    pub(super) level: &'a OrganLevel,
    /// [`stiffness_kernel`] of the contours.
    pub(super) kernel: &'a [f64],
}

/// Contours that came to rest.
#[derive(Clone, Debug, Default)]
pub(super) struct Settled {
    /// The contours, none of which is small or filled with another tissue.
    pub(super) polygons: Vec<Vec<DVec2>>,
    /// The pixels inside.
    pub(super) mask: Vec<bool>,
    /// Steps taken.
    pub(super) n_steps: usize,
    /// Whether they rest; else they ran out of steps.
    pub(super) at_rest: bool,
}

/// Moves contours until they rest, starting from `start`.
pub(super) fn settle(image: &SliceImage<'_>, start: Vec<Vec<DVec2>>, params: &ContourParams) -> Settled {
    let count = |mask: &[bool]| mask.iter().filter(|&&m| m).count();
    let mut polygons = start;
    let mut n_before = count(&rasterised(image.plane, &polygons));
    let mut found = Settled::default();
    let mut length = 1.0;
    while found.n_steps < params.max_steps && !polygons.is_empty() {
        for _ in 0..STEPS_A_ROUND {
            for polygon in &mut polygons {
                *polygon =
                    moved(image, &resampled(polygon, params.point_distance_m), image.kernel, length, params);
            }
        }
        found.n_steps += STEPS_A_ROUND;
        let mut mask = rasterised(image.plane, &polygons);
        if any_crossing(&polygons) {
            polygons = outlines(image.plane, &mask);
            mask = rasterised(image.plane, &polygons);
        }
        polygons.retain(|polygon| holds_organ(image, polygon, params));
        let n_now = count(&mask);
        if n_now.abs_diff(n_before) as f64 <= TRAVEL_SHARE * n_now as f64 {
            length *= DAMPING;
        }
        n_before = n_now;
        if length < REST_STEP {
            found.at_rest = true;
            break;
        }
    }
    found.mask = rasterised(image.plane, &polygons);
    found.polygons = polygons;
    found
}

/// Whether a contour is large enough and the median inside is in the organ's band.
fn holds_organ(image: &SliceImage<'_>, polygon: &[DVec2], params: &ContourParams) -> bool {
    let inside = rasterised(image.plane, &[polygon]);
    let mut values: Vec<f32> = (0..inside.len()).filter(|&p| inside[p]).map(|p| image.smooth[p]).collect();
    let area_m2 = values.len() as f64 * image.plane.pixel_area_m2();
    area_m2 >= params.least_area_m2 && median(&mut values).is_some_and(|m| image.level.holds(m as f32))
}

/// The polygon after a share `length` of one step.
fn moved(
    image: &SliceImage<'_>,
    points: &[DVec2],
    kernel: &[f64],
    length: f64,
    params: &ContourParams,
) -> Vec<DVec2> {
    let n = points.len();
    let pushed: Vec<DVec2> = (0..n)
        .into_par_iter()
        .with_min_len(POINTS_A_TASK)
        .map(|p| {
            let along = points[(p + 1) % n] - points[(p + n - 1) % n];
            // Polygons run in the positive direction: the outside is at the right hand.
            let outward = DVec2::new(along.y, -along.x).normalize_or_zero();
            points[p] + outward * force_m(image, points[p], outward, params)
        })
        .collect();
    let last = DVec2::new((image.plane.dims[0] - 1) as f64, (image.plane.dims[1] - 1) as f64);
    (0..n)
        .map(|p| {
            let mut sum = kernel[0] * pushed[p];
            for (offset, &weight) in kernel.iter().enumerate().skip(1) {
                sum += weight * (pushed[(p + offset) % n] + pushed[(p + n * kernel.len() - offset) % n]);
            }
            points[p].lerp(sum, length).clamp(DVec2::ZERO, last * image.plane.spacing_m)
        })
        .collect()
}

/// How far the image pushes a point along its outward normal in a step [m].
fn force_m(image: &SliceImage<'_>, place_m: DVec2, outward: DVec2, params: &ContourParams) -> f64 {
    let level = image.level.level_hu as f32;
    let half_width = image.level.half_width_hu() as f32;
    let half_contrast = (0.5 * (image.level.level_hu - image.level.fat_hu)) as f32;
    let distance_hu = |place_m: DVec2| (image.plane.sample(image.smooth, place_m) - level).abs();
    // The sides of a border are looked at beyond its blur.
    let aside_m = image.plane.spacing_m.max_element().max(3e-3);
    let bounds_organ = |edge: &Edge| {
        if edge.to_brighter.dot(outward).abs() < 0.5 {
            return false;
        }
        let inside = distance_hu(edge.place_m - outward * aside_m);
        let outside = distance_hu(edge.place_m + outward * aside_m);
        // At a border the image is halfway to the neighbour; on a ripple within the organ it is not.
        let at_edge = distance_hu(edge.place_m);
        // Against lung too the organ's side must look like the organ, not like the muscle between them.
        let contrast = at_edge.min(half_contrast);
        let is_organ = inside <= half_width.max(INSIDE_SHARE * contrast);
        is_organ && inside < at_edge && at_edge > 0.75 * half_width && outside > half_width
    };
    let reach_m = params.edge_reach_m;
    match image.edges.nearest_along(image.plane, place_m, outward, reach_m, bounds_organ) {
        Some(distance_m) => {
            (params.edge_strength * distance_m).clamp(-params.balloon_step_m, params.balloon_step_m)
        }
        None => {
            let inside = 2.0 * (1.0 - distance_hu(place_m) / half_width);
            params.balloon_step_m * f64::from(inside.clamp(-1.0, 1.0))
        }
    }
}

/// Weights at offsets 0, 1, 2, ... of the inverse of 1 - a L + b L L on a long polygon. Wrapped around a shorter
/// one, they are its inverse.
pub(super) fn stiffness_kernel(elasticity: f64, bending: f64) -> Vec<f64> {
    /// Points of the long polygon; the weights that wrap around it are below the rounding.
    const N: usize = 512;
    /// Weights below this share of the first are left out.
    const LEAST: f64 = 1e-10;
    let inverse: Vec<f64> = (0..N)
        .map(|m| {
            let second = 2.0 - 2.0 * libm::cos(std::f64::consts::TAU * m as f64 / N as f64);
            1.0 / (1.0 + elasticity * second + bending * second * second)
        })
        .collect();
    let mut kernel: Vec<f64> = (0..N / 2)
        .map(|o| {
            let phase = |m: usize| std::f64::consts::TAU * ((m * o) % N) as f64 / N as f64;
            inverse.iter().enumerate().map(|(m, v)| v * libm::cos(phase(m))).sum::<f64>() / N as f64
        })
        .collect();
    let n = kernel.iter().rposition(|w| w.abs() > LEAST * kernel[0]).map_or(1, |last| last + 1);
    kernel.truncate(n);
    kernel
}
