//! The synthetic patient, its segmentation and its mesh, at full size.

use super::{Experiment, Outcome};
use glisson::image::labels::{Parts, dice, mask_volume_m3};
use glisson::image::phantom::{PhantomParams, generate as generate_phantom};
use glisson::image::segment::{SegmentParams, bare_band, segment};
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::surface::extract::{SurfaceParams, surface_of_mask};

const OWN: &str = "requirement: synthetic portal-phase CT, 1.5 mm voxels, noise 20 HU";
const STUFFING: &str = "Labelle and Shewchuk 2007, doi 10.1145/1276377.1276448";

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let phantom = generate_phantom(&PhantomParams::default());
    let truth = phantom.labels.mask(&phantom.labels.select("liver", Parts::Included)?);
    let grid = &phantom.labels.grid;
    let volume_m3 = mask_volume_m3(grid, &truth);
    let found = segment(&phantom.ct, &SegmentParams::default())?;
    let bare = bare_band(&phantom.ct, found.band_hu);
    let (surface, _) = surface_of_mask(grid, &truth, &SurfaceParams::default())?;
    let size = WantedSize::Tetrahedra(6300);
    let (_, report) = generate(&surface, &MeshParams { size, volume_m3: Some(volume_m3) })?;
    let quality = report.quality;
    let volume_error = (quality.volume_m3 / volume_m3 - 1.0).abs();
    let euler = quality.surface_euler_characteristic as f64;
    Ok(Outcome::from(vec![
        Experiment::within("phantom: liver volume [l]", OWN, volume_m3 * 1e3, [1.2, 1.8]),
        Experiment::within(
            "segmentation: Dice with the true liver",
            OWN,
            dice(&truth, &found.mask),
            [0.95, 1.0],
        ),
        Experiment::within(
            "bare intensity band: Dice with the true liver",
            OWN,
            dice(&truth, &bare),
            [0.0, 0.93],
        ),
        Experiment::within(
            "mesh: tetrahedra for 6300 wanted",
            OWN,
            quality.tetrahedra as f64,
            [5985.0, 6615.0],
        ),
        Experiment::within(
            "mesh: smallest dihedral angle [degrees]",
            STUFFING,
            quality.min_dihedral_deg,
            [10.0, 70.6],
        ),
        Experiment::within(
            "mesh: largest dihedral angle [degrees]",
            STUFFING,
            quality.max_dihedral_deg,
            [70.5, 165.0],
        ),
        Experiment::at_most("mesh: volume against the label map, relative", OWN, volume_error, 0.01),
        Experiment::within("mesh: Euler characteristic of the surface", OWN, euler, [2.0, 2.0]),
    ]))
}
