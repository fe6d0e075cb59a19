//! What the segmentation by contours is told.

use super::polygon::SliceContour;
use crate::math::DVec3;

/// How edges are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EdgeMethod {
    /// Canny's detector in each slice, with a Gaussian of this deviation [m].
    Canny {
        /// Standard deviation of the Gaussian [m].
        sigma_m: f64,
    },
    /// Deriche's recursive filter in the volume. In the first and last slice of the image it finds only edges that stand
    /// upright: contours rest where the organ's band ends there.
    Deriche {
        /// Distance over which the kernels fall by exp(-1) [m].
        decay_length_m: f64,
    },
}

/// How an organ is followed from slice to slice. Lengths in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct ContourParams {
    /// Points inside the organ [m], LPS; the first gives its level. Empty takes
    /// [`guess_seed`](crate::image::segment::guess_seed).
    pub seeds_m: Vec<DVec3>,
    /// Contours drawn by hand. They replace what would be found in their slices, and the neighbours are found from them.
    pub corrections: Vec<SliceContour>,
    /// How edges are found.
    pub edges: EdgeMethod,
    /// Lower and higher threshold of the edges, in deviations of the gradient's noise.
    pub edge_thresholds: [f64; 2],
    /// Standard deviation of the Gaussian that denoises.
    pub denoise_m: f64,
    /// Radius around the seed in which level and noise are measured.
    pub statistics_radius_m: f64,
    /// Half width of the organ's band, in deviations of the denoised image.
    pub band_width: f64,
    /// Smallest and largest half width of the band [HU].
    pub band_limits_hu: [f64; 2],
    /// Distance of the points along a contour.
    pub point_distance_m: f64,
    /// How far a contour looks for an edge to both sides.
    pub edge_reach_m: f64,
    /// Share of the distance to the edge that a point moves in a step.
    pub edge_strength: f64,
    /// How far the balloon moves a point in a step, at most.
    pub balloon_step_m: f64,
    /// Resistance to stretching, per step.
    pub elasticity: f64,
    /// Resistance to bending, per step.
    pub bending: f64,
    /// Most steps in a slice.
    pub max_steps: usize,
    /// How far a contour is shrunk before the next slice starts from it.
    pub shrink_m: f64,
    /// Least area of a contour [m2].
    pub least_area_m2: f64,
    /// Radius of the ball that closes vessels and lesions that reach the surface.
    pub close_radius_m: f64,
    /// Radius of the last opening and closing.
    pub smooth_radius_m: f64,
}

impl Default for ContourParams {
    fn default() -> Self {
        Self {
            seeds_m: Vec::new(),
            corrections: Vec::new(),
            edges: EdgeMethod::Canny { sigma_m: 1e-3 },
            edge_thresholds: [3.0, 5.0],
            denoise_m: 1.5e-3,
            statistics_radius_m: 10e-3,
            band_width: 3.0,
            band_limits_hu: [15.0, 25.0],
            point_distance_m: 1.5e-3,
            edge_reach_m: 6e-3,
            edge_strength: 0.5,
            balloon_step_m: 0.75e-3,
            elasticity: 0.2,
            bending: 0.5,
            max_steps: 400,
            shrink_m: 2e-3,
            least_area_m2: 60e-6,
            close_radius_m: 8e-3,
            smooth_radius_m: 3e-3,
        }
    }
}
