//! External forces: how far along its normal a vertex is from the data.
//!
//! A force is a signed length [m] along the outward normal, so data never move vertices along the surface
//! (H. Delingette 1999, doi 10.1023/A:1008157432188); none where no data are within reach.

use super::error::SimplexError;
use crate::image::filter::gaussian;
use crate::image::resample::VoxelBox;
use crate::image::{Volume, VoxelGrid};
use crate::math::DVec3;
use crate::surface::TriMesh;
use crate::surface::box_tree::BoxTree;

/// Steps of the search along the normal, in smallest spacings.
const SEARCH_STEP_SPACINGS: f64 = 0.4;

/// How far smoothing may shift the border, in largest spacings: the steps of slices are half a spacing deep.
const LARGEST_SHIFT_SPACINGS: f64 = 0.75;

/// What a mesh is drawn to.
pub enum Attraction<'a> {
    /// The border of a binary volume.
    Mask(&'a MaskBorder),
    /// The closest point of a surface.
    Surface(&'a SurfaceBorder),
    /// The steepest place of an image.
    Gradient(&'a GradientBorder<'a>),
}

impl Attraction<'_> {
    /// Signed length [m] along `normal` from `point_m` to the data; none beyond their reach.
    pub fn offset_m(&self, point_m: DVec3, normal: DVec3) -> Option<f64> {
        match self {
            Self::Mask(border) => border.offset_m(point_m, normal),
            Self::Surface(border) => border.offset_m(point_m, normal),
            Self::Gradient(border) => border.offset_m(point_m, normal),
        }
    }
}

/// A binary volume's border with sub-voxel places: where the smoothed mask is 1/2.
///
/// Parts and gaps thinner than the smoothing vanish from the smoothed mask. Where its border is not within
/// [`LARGEST_SHIFT_SPACINGS`] of that of the mask itself, linear between voxel centres, the latter counts.
pub struct MaskBorder {
    smooth: Volume<f32>,
    sharp: Volume<f32>,
    reach_m: f64,
}

impl MaskBorder {
    /// The border of `mask` (one value a voxel of `grid`), smoothed by a Gaussian of `smoothing_m`, searched
    /// within `reach_m`.
    ///
    /// # Errors
    /// [`SimplexError::Parameter`] for a mask of the wrong length or without voxels, or a negative length.
    pub fn new(
        grid: &VoxelGrid,
        mask: &[bool],
        smoothing_m: f64,
        reach_m: f64,
    ) -> Result<Self, SimplexError> {
        let wrong = |name, found, allowed| Err(SimplexError::Parameter { name, found, allowed });
        if mask.len() != grid.n_voxels() {
            return wrong("number of mask values", mask.len() as f64, "one for each voxel of the grid");
        }
        if !(smoothing_m >= 0.0 && smoothing_m.is_finite()) {
            return wrong("smoothing of the mask [m]", smoothing_m, "at least 0, finite");
        }
        if !(reach_m > 0.0 && reach_m.is_finite()) {
            return wrong("reach of the external force [m]", reach_m, "positive and finite");
        }
        let Some(part) = VoxelBox::around(grid, mask, 0.0) else {
            return wrong("voxels of the mask", 0.0, "at least 1");
        };
        // As many empty layers around the mask's box as the Gaussian reaches, outside the grid too.
        let margin = [0, 1, 2].map(|a| (4.0 * smoothing_m / grid.spacing_m[a]).ceil() as usize + 2);
        let dims = [0, 1, 2].map(|a| part.dims[a] + 2 * margin[a]);
        let corner = [0, 1, 2].map(|a| part.first[a] as f64 - margin[a] as f64);
        let cut = VoxelGrid { dims, origin_m: grid.position_m(DVec3::from_array(corner)), ..grid.clone() };
        let mut values = vec![0f32; cut.n_voxels()];
        let solid: Vec<f32> = part.cut(grid, mask).into_iter().map(|m| f32::from(u8::from(m))).collect();
        VoxelBox { first: margin, dims: part.dims }.paste(&cut, &solid, &mut values);
        let smooth = Volume { values: gaussian(&cut, &values, smoothing_m), grid: cut.clone() };
        Ok(Self { smooth, sharp: Volume { grid: cut, values }, reach_m })
    }

    /// As [`Attraction::offset_m`]: the nearest place where the mask ends in the direction of the normal.
    pub fn offset_m(&self, point_m: DVec3, normal: DVec3) -> Option<f64> {
        let sharp_m = falling_crossing_m(&self.sharp, point_m, normal, self.reach_m)?;
        let shift_m = LARGEST_SHIFT_SPACINGS * self.sharp.grid.spacing_m.max_element();
        let near_m = point_m + sharp_m * normal;
        let smooth_m = falling_crossing_m(&self.smooth, near_m, normal, shift_m);
        Some(sharp_m + smooth_m.unwrap_or(0.0))
    }
}

/// A surface to follow.
pub struct SurfaceBorder {
    mesh: TriMesh,
    tree: BoxTree,
    reach_m: f64,
}

impl SurfaceBorder {
    /// The triangles of `mesh`, to be followed within `reach_m`.
    pub fn new(mesh: TriMesh, reach_m: f64) -> Self {
        Self { tree: BoxTree::of_triangles(&mesh), mesh, reach_m }
    }

    /// Distance [m] from a point to the surface, if it is within reach.
    pub fn distance_m(&self, point_m: DVec3) -> Option<f64> {
        self.tree.closest(&self.mesh, point_m, self.reach_m).map(|(_, _, distance_m)| distance_m)
    }

    /// As [`Attraction::offset_m`]: the way to the closest point, seen along the normal.
    pub fn offset_m(&self, point_m: DVec3, normal: DVec3) -> Option<f64> {
        self.tree.closest(&self.mesh, point_m, self.reach_m).map(|(_, at_m, _)| (at_m - point_m).dot(normal))
    }
}

/// Which side of an edge in an image is the organ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgePolarity {
    /// The organ is brighter than what is around it.
    BrightInside,
    /// The organ is darker.
    DarkInside,
    /// Any edge.
    Either,
}

/// The steepest place of an image along the normal.
pub struct GradientBorder<'a> {
    /// The image; smooth it first if it is noisy.
    pub image: &'a Volume<f32>,
    /// How far to look on either side [m].
    pub reach_m: f64,
    /// Which edges count.
    pub polarity: EdgePolarity,
    /// Smallest slope that is an edge [image values per m].
    pub least_slope_per_m: f64,
}

impl GradientBorder<'_> {
    /// As [`Attraction::offset_m`]: the place of the steepest slope, refined by a parabola through the slopes
    /// beside it. None when no slope is steep enough.
    pub fn offset_m(&self, point_m: DVec3, normal: DVec3) -> Option<f64> {
        let step_m = 0.5 * self.image.grid.spacing_m.min_element();
        let n_steps = (self.reach_m / step_m).ceil() as i64;
        let value = |i: i64| self.image.value_at(point_m + (i as f64 * step_m) * normal);
        // Over two voxels: within one the values are linear and the slope has no peak.
        let slope = |i: i64| {
            let rise = (value(i + 2) - value(i - 2)) / (4.0 * step_m);
            match self.polarity {
                EdgePolarity::BrightInside => -rise,
                EdgePolarity::DarkInside => rise,
                EdgePolarity::Either => rise.abs(),
            }
        };
        let mut best = (0, self.least_slope_per_m.max(f64::MIN_POSITIVE));
        let mut found = false;
        // Nearer places first: they win over equally steep ones.
        for i in (0..=n_steps).flat_map(|i| [i, -i]) {
            let s = slope(i);
            if s > best.1 || (!found && s >= best.1) {
                best = (i, s);
                found = true;
            }
        }
        if !found {
            return None;
        }
        let (before, at, after) = (slope(best.0 - 1), best.1, slope(best.0 + 1));
        let bend = before - 2.0 * at + after;
        let shift = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        Some((best.0 as f64 + shift) * step_m)
    }
}

/// Signed length [m] along `normal` to the nearest place where the volume falls through 1/2 in its direction.
fn falling_crossing_m(volume: &Volume<f32>, point_m: DVec3, normal: DVec3, reach_m: f64) -> Option<f64> {
    let step_m = SEARCH_STEP_SPACINGS * volume.grid.spacing_m.min_element();
    let n_steps = (reach_m / step_m).ceil() as usize;
    let excess = |t_m: f64| volume.value_at(point_m + t_m * normal) - 0.5;
    let crossing = |from_m: f64, from: f64, to_m: f64, to: f64| {
        (from >= 0.0 && to < 0.0).then(|| refine(&excess, [from_m, to_m], [from, to]))
    };
    let here = excess(0.0);
    let (mut above, mut below) = (here, here);
    for i in 0..n_steps {
        let [near_m, far_m] = [i as f64 * step_m, (i + 1) as f64 * step_m];
        let (next_above, next_below) = (excess(far_m), excess(-far_m));
        let up = crossing(near_m, above, far_m, next_above);
        let down = crossing(-far_m, next_below, -near_m, below);
        match (up, down) {
            (Some(up), Some(down)) => return Some(if up <= -down { up } else { down }),
            (Some(at_m), None) | (None, Some(at_m)) => return Some(at_m),
            (None, None) => {}
        }
        (above, below) = (next_above, next_below);
    }
    None
}

/// Zero of a function between two places where it is positive and negative: secants kept within the bracket.
fn refine(excess: &impl Fn(f64) -> f64, mut at: [f64; 2], mut value: [f64; 2]) -> f64 {
    let mut middle = at[0];
    for _ in 0..3 {
        middle = at[0] + (at[1] - at[0]) * value[0] / (value[0] - value[1]);
        let there = excess(middle);
        let side = usize::from(there < 0.0);
        at[side] = middle;
        value[side] = there;
        if there.abs() < 1e-4 {
            break;
        }
    }
    middle
}
