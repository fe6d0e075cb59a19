//! Turns a voxel set into one ball: one piece, no cavity, no tunnel, and well-composed, so that its surface
//! is a closed manifold of Euler number 2.
//!
//! A voxel is *simple* when flipping it changes no piece, cavity or tunnel: its six-connected foreground
//! neighbours are one piece within the 18-neighbourhood, and its background neighbours one piece within the
//! 26-neighbourhood (G. Bertrand and G. Malandain, "A new characterization of three-dimensional simple
//! points", Pattern Recognition Letters 15, 1994, doi 10.1016/0167-8655(94)90046-9). A set is *well-composed*
//! when no two voxels of it, or of its complement, touch only by an edge or a corner (L. Latecki, "3D
//! well-composed pictures", Graphical Models and Image Processing 59, 1997, doi 10.1006/gmip.1997.0422); then
//! every block of 2 x 2 x 2 voxels is cut by one disc, and a dual surface is a manifold.
//!
//! Both properties survive if only simple voxels are flipped whose eight blocks stay well-composed. So:
//! * from outside, a simple ball around the set is shrunk towards it, the voxels farthest from it first; what
//!   cannot be taken away closes each tunnel by a membrane at its narrowest place, which is then thickened
//!   where the tunnel is narrow;
//! * from inside, the deepest voxel is grown towards the border of the set, the deepest voxels first; what
//!   cannot be added cuts each handle at its thinnest place.
//!
//! The first is preferred; where a membrane is large it is opened again and the second cuts the handle.
//! The order of ties is that of insertion, so the result depends on the input alone.

mod enclosure;
mod propagation;

use self::enclosure::enclosing_ball;
pub(crate) use self::propagation::well_composed_blocks;
use self::propagation::{Crop, Direction, Pieces, chamfer_distances, euler_contributions, propagate};
use super::VoxelGrid;

/// What [`repair_to_ball`] did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopologyRepair {
    /// Voxels of the mask before.
    pub voxels_before: usize,
    /// Pieces (connected by faces, edges or corners) smaller than the largest, taken away.
    pub pieces_removed: usize,
    /// Enclosed holes filled.
    pub cavities_filled: usize,
    /// Tunnels closed by added voxels.
    pub tunnels_filled: usize,
    /// Tunnels opened to the outside by cutting the handle around them.
    pub tunnels_cut: usize,
    /// Voxels that the mask gained.
    pub voxels_added: usize,
    /// Voxels that the mask lost, those of smaller pieces included.
    pub voxels_removed: usize,
    /// Euler number of the surface of the mask as given (edge and corner contacts count as joined).
    pub euler_characteristic_before: i64,
    /// Euler number of the surface of the repaired mask: 2.
    pub euler_characteristic: i64,
}

/// Why a mask cannot be repaired.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TopologyError {
    /// The mask's length is not that of its grid.
    #[error("mask has {found} values, its grid of {dims:?} voxels needs {needed}")]
    WrongLength {
        /// Values in the mask.
        found: usize,
        /// Voxels of the grid.
        needed: usize,
        /// The grid's dimensions.
        dims: [usize; 3],
    },
    /// A spacing is zero, negative or not finite.
    #[error("voxel spacing along axis {axis} is {found_m} m; it must be positive and finite")]
    WrongSpacing {
        /// 0, 1 or 2.
        axis: usize,
        /// The spacing found [m].
        found_m: f64,
    },
    /// No voxel is set.
    #[error("the mask is empty: no voxel carries the label")]
    Empty,
    /// The mask's box is too large for 32-bit places.
    #[error("the mask's box of {dims:?} voxels has more than {limit} voxels; crop or resample it")]
    TooLarge {
        /// Dimensions of the box with its border.
        dims: [usize; 3],
        /// Largest allowed number of voxels.
        limit: usize,
    },
}

/// Membranes of more voxels than these are opened again and their handles cut, if that changes less.
const MEMBRANE_LIMITS: [usize; 3] = [400, 40, 0];
/// A removed voxel counts as much as this many added ones when repairs are compared: filling is preferred.
const COST_OF_REMOVAL: usize = 2;
/// Below this share of the voxels changed, filling alone is taken without looking for something better.
const CHEAP_SHARE: f64 = 2e-4;
/// Tunnels narrower than twice this are filled for a length of [`PLUG_LENGTH_MM`], not just closed by a
/// membrane of one voxel, which a coarser mesh would pierce.
const PLUG_RADIUS_MM: f64 = 3.0;
/// How far a plug reaches from its membrane to each side.
const PLUG_LENGTH_MM: f64 = 4.0;

/// Euler characteristic of the solid made of the closed voxels of `mask` (corner minus edge plus face minus
/// voxel count): pieces - tunnels + cavities, where voxels that share an edge or a corner are joined. The
/// surface of a well-composed set has twice this Euler number.
///
/// # Errors
/// [`TopologyError::WrongLength`], [`TopologyError::WrongSpacing`], [`TopologyError::TooLarge`].
pub fn solid_euler_characteristic(grid: &VoxelGrid, mask: &[bool]) -> Result<i64, TopologyError> {
    match Crop::of_mask(grid, mask) {
        Ok(crop) => Ok(crop.euler_characteristic()),
        Err(TopologyError::Empty) => Ok(0),
        Err(error) => Err(error),
    }
}

/// Whether no two voxels of `mask`, or of its complement, touch only by an edge or a corner.
///
/// # Errors
/// [`TopologyError::WrongLength`], [`TopologyError::WrongSpacing`], [`TopologyError::TooLarge`].
pub fn is_well_composed(grid: &VoxelGrid, mask: &[bool]) -> Result<bool, TopologyError> {
    match Crop::of_mask(grid, mask) {
        Ok(crop) => Ok(crop.is_well_composed()),
        Err(TopologyError::Empty) => Ok(true),
        Err(error) => Err(error),
    }
}

/// Changes `mask` (`grid.n_voxels()` values, i fastest) as little as it can so that it becomes one
/// well-composed ball, and says what was changed. Voxels outside the mask's bounding box never change.
///
/// # Errors
/// [`TopologyError`]; then `mask` is untouched.
pub fn repair_to_ball(grid: &VoxelGrid, mask: &mut [bool]) -> Result<TopologyRepair, TopologyError> {
    let mut crop = Crop::of_mask(grid, mask)?;
    let mut report = TopologyRepair {
        voxels_before: crop.count(),
        euler_characteristic_before: 2 * crop.euler_characteristic(),
        ..Default::default()
    };
    report.pieces_removed = crop.keep_largest_piece();
    report.cavities_filled = crop.fill_cavities();
    // One piece without cavity: Euler characteristic = 1 - tunnels.
    let tunnels = |crop: &Crop| usize::try_from(1 - crop.euler_characteristic()).unwrap_or(0);
    let n_tunnels = tunnels(&crop);
    if n_tunnels > 0 || !crop.is_well_composed() {
        let given = crop.clone();
        let filled = shrunk_enclosure(&given);
        let mut best = Candidate { cost: cost(&given, &filled), n_left: 0, result: filled.clone() };
        if best.cost as f64 > CHEAP_SHARE * given.count() as f64 {
            let added = Pieces::of(&additions(&given, &filled), 1, true);
            for limit in MEMBRANE_LIMITS {
                let Some(mut partly) = with_small_additions(&given, &added, limit) else { continue };
                partly.fill_cavities();
                let result = grown_from_deepest(&partly);
                let cost = cost(&given, &result);
                if cost < best.cost {
                    best = Candidate { cost, n_left: tunnels(&partly), result };
                }
            }
        }
        crop = best.result;
        plug_tunnels(&given, &mut crop);
        report.tunnels_cut = best.n_left.min(n_tunnels);
        report.tunnels_filled = n_tunnels - report.tunnels_cut;
    }
    report.euler_characteristic = 2 * crop.euler_characteristic();
    (report.voxels_added, report.voxels_removed) = crop.write_to(grid, mask);
    Ok(report)
}

/// One way to repair.
struct Candidate {
    cost: usize,
    /// Tunnels that were not filled but cut open.
    n_left: usize,
    result: Crop,
}

/// Voxels changed, removals weighted.
fn cost(given: &Crop, result: &Crop) -> usize {
    given
        .cells
        .iter()
        .zip(&result.cells)
        .map(|(&before, &after)| match (before, after) {
            (0, 1) => 1,
            (1, 0) => COST_OF_REMOVAL,
            _ => 0,
        })
        .sum()
}

/// The smallest ball around `given` that shrinking a simple one reaches.
fn shrunk_enclosure(given: &Crop) -> Crop {
    let mut ball = enclosing_ball(given);
    let outside_distance = chamfer_distances(given, |cell| cell == 1);
    let removable: Vec<u8> = given.cells.iter().map(|&c| 1 - c).collect();
    propagate(&mut ball, &removable, &outside_distance, Direction::Shrink);
    ball
}

/// The largest ball inside `given` that growing its deepest voxel reaches.
fn grown_from_deepest(given: &Crop) -> Crop {
    let depth = chamfer_distances(given, |cell| cell == 0);
    let mut ball = given.emptied();
    let deepest = (0..depth.len()).max_by_key(|&i| (depth[i], usize::MAX - i));
    ball.cells[deepest.expect("a crop has voxels")] = 1;
    propagate(&mut ball, &given.cells, &depth, Direction::Grow);
    ball
}

/// `given` with those of the pieces `added` that have at most `limit` voxels; none when that is all of them.
fn with_small_additions(given: &Crop, added: &Pieces, limit: usize) -> Option<Crop> {
    let is_small = |piece: u32| added.sizes[piece as usize] <= limit;
    if added.sizes.iter().all(|&size| size <= limit) {
        return None;
    }
    let mut result = given.clone();
    for run in added.runs.iter().filter(|run| is_small(run.piece)) {
        result.cells[run.places()].fill(1);
    }
    Some(result)
}

/// Thickens the membranes that `ball` added to `given`, where the tunnel is narrow. Additions that join mere
/// edge or corner contacts stay as they are.
fn plug_tunnels(given: &Crop, ball: &mut Crop) {
    let added = Pieces::of(&additions(given, ball), 1, true);
    // Taking a membrane out again opens its tunnels: the Euler characteristic falls.
    let mut opened = ball.clone();
    let contributions = euler_contributions();
    let mut change_of_piece = vec![0i64; added.sizes.len()];
    for run in &added.runs {
        for index in run.places() {
            change_of_piece[run.piece as usize] += opened.clear_and_count_euler(index, &contributions);
        }
    }
    let mut membranes: Vec<Vec<usize>> = vec![Vec::new(); added.sizes.len()];
    for run in added.runs.iter().filter(|run| change_of_piece[run.piece as usize] < 0) {
        membranes[run.piece as usize].extend(run.places());
    }
    membranes.retain(|places| !places.is_empty());
    // What a plug depends on is no farther than its own length and the closing's two radii.
    let reach = given.chamfer_units(PLUG_LENGTH_MM) + 2 * given.chamfer_units(PLUG_RADIUS_MM);
    for (bounds, places) in joined_boxes(given, membranes, reach) {
        let mut membrane = given.emptied();
        for place in places {
            membrane.cells[place] = 1;
        }
        let mut part = ball.part(bounds);
        plug(&given.part(bounds), &membrane.part(bounds), &mut part);
        ball.set_part(bounds[0], &part);
    }
}

/// First and last voxel of boxes with the places in them, the boxes of `membranes` grown by `reach` chamfer
/// units; those that overlap are one.
fn joined_boxes(crop: &Crop, membranes: Vec<Vec<usize>>, reach: u32) -> Vec<([[usize; 3]; 2], Vec<usize>)> {
    let mut apart: Vec<([[usize; 3]; 2], Vec<usize>)> = Vec::new();
    for places in membranes {
        let mut grown = (crop.box_around(places.iter().copied(), reach), places);
        let overlap = |a: [[usize; 3]; 2], b: [[usize; 3]; 2]| {
            (0..3).all(|axis| a[0][axis] <= b[1][axis] && b[0][axis] <= a[1][axis])
        };
        while let Some(at) = apart.iter().position(|(bounds, _)| overlap(*bounds, grown.0)) {
            let (bounds, places) = apart.swap_remove(at);
            for axis in 0..3 {
                grown.0[0][axis] = grown.0[0][axis].min(bounds[0][axis]);
                grown.0[1][axis] = grown.0[1][axis].max(bounds[1][axis]);
            }
            grown.1.extend(places);
        }
        apart.push(grown);
    }
    apart
}

/// Thickens `membrane` in `ball` where `given` is narrow around it.
fn plug(given: &Crop, membrane: &Crop, ball: &mut Crop) {
    let closed = given.closing(PLUG_RADIUS_MM);
    let from_membrane = chamfer_distances(membrane, |cell| cell == 1);
    let reach = membrane.chamfer_units(PLUG_LENGTH_MM);
    let candidates: Vec<u8> = (0..closed.cells.len())
        .map(|i| u8::from(closed.cells[i] == 1 && given.cells[i] == 0 && from_membrane[i] <= reach))
        .collect();
    let nearness: Vec<u32> = from_membrane.iter().map(|&d| reach.saturating_sub(d)).collect();
    propagate(ball, &candidates, &nearness, Direction::Grow);
}

/// The voxels that `after` has and `before` has not.
fn additions(before: &Crop, after: &Crop) -> Crop {
    let mut added = before.emptied();
    for (cell, (&b, &a)) in added.cells.iter_mut().zip(before.cells.iter().zip(&after.cells)) {
        *cell = u8::from(b == 0 && a == 1);
    }
    added
}
