//! The lattice cell that gives the wanted number of tetrahedra.

use super::cell_size::{CellSize, FinePlaces};
use super::error::OrganMeshError;
use super::field::ShareField;
use super::labelling::Labelling;
use super::params::{MAX_ORGAN_TETRAHEDRA, MIN_ORGAN_TETRAHEDRA, OrganSize};
use super::regions::RegionGrid;
use crate::mesh::stuffing::TETRAHEDRON_OVER_CELL;
use crate::progress::tell;

/// The search for the cell stops at this relative difference of the number of tetrahedra.
const COUNT_GOAL: f64 = 0.02;

/// Part of all work that the trials take at most.
pub(super) const SHARE_OF_TRIALS: f64 = 0.3;

/// Cells tried at most.
const MOST_TRIALS: usize = 10;

/// The number of tetrahedra falls with this power of the cell: between 2, thin organs, and 3, thick ones.
const COUNT_POWER: f64 = 2.8;

/// The smallest power that is reckoned with where cells are finer in places.
const SMALLEST_COUNT_POWER: f64 = 0.7;

/// A labelled lattice of the wanted size.
pub(super) struct Sized {
    pub(super) cell_m: f64,
    pub(super) labelling: Labelling,
}

/// The labelled lattice for `size`.
///
/// # Errors
/// A size that makes no sense, too many tetrahedra, an organ without a lattice node.
pub(super) fn sized(
    regions: &RegionGrid,
    size: OrganSize,
    places: &FinePlaces,
) -> Result<Sized, OrganMeshError> {
    match size {
        OrganSize::CellM(cell_m) => {
            let longest_m =
                regions.grid().bounds_m().size_m().max_element() + regions.grid().spacing_m.max_element();
            if !(cell_m > 0.0 && cell_m <= longest_m) {
                return Err(OrganMeshError::BadParameter {
                    what: "the lattice cell",
                    found: format!("{} mm", 1e3 * cell_m),
                    allowed: format!("more than 0 to {:.1} mm for these organs", 1e3 * longest_m),
                });
            }
            let (labelling, _) = labelled(regions, cell_m, places)?;
            check_each_has_nodes(regions, &labelling, cell_m)?;
            Ok(Sized { cell_m, labelling })
        }
        OrganSize::Tetrahedra(wanted) => {
            if !(MIN_ORGAN_TETRAHEDRA..=MAX_ORGAN_TETRAHEDRA).contains(&wanted) {
                return Err(OrganMeshError::BadParameter {
                    what: "the wanted number of tetrahedra",
                    found: wanted.to_string(),
                    allowed: format!("{MIN_ORGAN_TETRAHEDRA} to {MAX_ORGAN_TETRAHEDRA}"),
                });
            }
            with_count(regions, wanted as f64, places)
        }
    }
}

/// The cell with which the number of tetrahedra is nearest to `wanted`, among those tried.
fn with_count(regions: &RegionGrid, wanted: f64, places: &FinePlaces) -> Result<Sized, OrganMeshError> {
    // Borders add tetrahedra: begin with cells that are somewhat too large.
    let mut cell_m = 1.3 * libm::cbrt(total_m3(regions) / TETRAHEDRON_OVER_CELL / wanted);
    let mut best: Option<(f64, Sized)> = None;
    let mut trial_before: Option<(f64, f64)> = None;
    for trial in 0..MOST_TRIALS {
        tell(SHARE_OF_TRIALS * trial as f64 / MOST_TRIALS as f64);
        let (labelling, n_tets) = match labelled(regions, cell_m, places) {
            Ok(labelled) => labelled,
            // A trial went beyond what is allowed on the way to a number that is.
            Err(_) if best.is_some() => break,
            Err(error) => return Err(error),
        };
        let ratio = (n_tets as f64 / wanted).max(1e-3);
        let off = libm::log(ratio).abs();
        if best.as_ref().is_none_or(|(least, _)| off < *least) {
            best = Some((off, Sized { cell_m, labelling }));
        }
        if off < COUNT_GOAL {
            break;
        }
        let power = match trial_before {
            // Fine places do not follow the largest cells: the number changes less with these.
            Some(before) if !CellSize::new(cell_m, places).is_even() => {
                power_between(before, (cell_m, ratio))
            }
            _ => COUNT_POWER,
        };
        trial_before = Some((cell_m, ratio));
        cell_m *= libm::pow(ratio, 1.0 / power);
    }
    let (_, found) = best.expect("the first trial is kept or an error");
    check_each_has_nodes(regions, &found.labelling, found.cell_m)?;
    Ok(found)
}

/// With which power of the cell the number of tetrahedra falls, from two trials of cell and number.
fn power_between((cell_a, n_a): (f64, f64), (cell_b, n_b): (f64, f64)) -> f64 {
    let power = -libm::log(n_b / n_a) / libm::log(cell_b / cell_a);
    if power.is_finite() { power.clamp(SMALLEST_COUNT_POWER, COUNT_POWER) } else { COUNT_POWER }
}

fn total_m3(regions: &RegionGrid) -> f64 {
    regions.volumes_m3().iter().sum()
}

/// Labels a lattice of this cell, unless it would have too many tetrahedra; and how many it will have.
fn labelled(
    regions: &RegionGrid,
    cell_m: f64,
    places: &FinePlaces,
) -> Result<(Labelling, usize), OrganMeshError> {
    let volume_m3 = total_m3(regions);
    let cell_m3 = cell_m * cell_m * cell_m;
    let check = |n_tets: f64| {
        if n_tets <= MAX_ORGAN_TETRAHEDRA as f64 {
            return Ok(());
        }
        Err(OrganMeshError::TooMany {
            cell_mm: 1e3 * cell_m,
            volume_ml: 1e6 * volume_m3,
            estimated: n_tets as u64,
            allowed: MAX_ORGAN_TETRAHEDRA,
            least_cell_mm: 1e3 * cell_m * libm::cbrt(n_tets / MAX_ORGAN_TETRAHEDRA as f64),
        })
    };
    check(volume_m3 / (TETRAHEDRON_OVER_CELL * cell_m3))?;
    let size = CellSize::new(cell_m, places);
    let labelling = Labelling::new(regions, &ShareField::new(regions, size), &size)?;
    let n_tets = labelling.n_tets();
    check(n_tets as f64)?;
    Ok((labelling, n_tets))
}

/// Refuses a lattice in which an organ has no node.
fn check_each_has_nodes(
    regions: &RegionGrid,
    labelling: &Labelling,
    cell_m: f64,
) -> Result<(), OrganMeshError> {
    let n_nodes = labelling.n_nodes_of_regions(regions.n_regions());
    let Some(region) = (1..n_nodes.len()).find(|&region| n_nodes[region] == 0) else { return Ok(()) };
    let region = u16::try_from(region).expect("regions are fewer than labels");
    let n_voxels = regions.n_voxels(region);
    Err(OrganMeshError::Vanished {
        label: regions.label(region),
        n_voxels,
        volume_ml: 1e6 * n_voxels as f64 * regions.grid().voxel_volume_m3(),
        cell_mm: 1e3 * cell_m,
    })
}
