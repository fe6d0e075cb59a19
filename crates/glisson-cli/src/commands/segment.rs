//! `glisson segment`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use glisson::image::files::write_label_map;
use glisson::image::labels::{Parts, check_clear_of_border, dice, mask_volume_m3};
use glisson::image::segment::{SegmentParams, Segmentation, bare_band, segment};
use glisson::image::{LabelMap, Volume, VoxelGrid};
use glisson::math::DVec3;
use serde_json::json;

use super::image_input::read_with_notes;
use super::output::make_folder_of;

/// Find the liver in a CT volume.
///
/// Denoises, takes the intensity band around a seed, the connected region there, cuts thin bridges to other
/// organs, closes vessels and lesions, fills holes and tunnels, and keeps the largest piece.
/// Without a seed it starts deep in the thickest parenchyma on the patient's right.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson segment out/phantom/ct.nii.gz -o out/liver.nii.gz
  glisson segment out/phantom/ct.nii.gz -o out/liver.nii.gz --truth out/phantom/labels.nii.gz
  glisson segment ct.nii.gz --seed-mm=-80,-10,20 -o out/liver.nii.gz
  glisson segment ct.nii.gz --seed-voxel 60,70,80 -o out/liver.nii.gz")]
pub(crate) struct Args {
    /// CT volume in Hounsfield units (a DICOM folder, .nii, .nii.gz, .nrrd, .mha, .mhd or .inr)
    ct: PathBuf,
    /// Which DICOM series of a folder, by its place in the list of `glisson import --list`
    #[arg(long, value_name = "N")]
    series: Option<usize>,
    /// Label map to write (.nii, .nii.gz, .nrrd, .seg.nrrd or .mha): 1 is the organ
    #[arg(short, long, default_value = "out/labels.nii.gz")]
    output: PathBuf,
    /// A point inside the organ: x,y,z in mm in the patient frame (LPS: +x left, +y posterior, +z superior)
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "seed_voxel")]
    seed_mm: Option<String>,
    /// A voxel inside the organ: i,j,k from 0
    #[arg(long, value_name = "I,J,K")]
    seed_voxel: Option<String>,
    /// Name of the organ in the label map written
    #[arg(long, default_value = "liver")]
    name: String,
    /// True label map to compare with (Dice)
    #[arg(long)]
    truth: Option<PathBuf>,
    /// Which label of the true map, by name or number
    #[arg(long, default_value = "liver", value_name = "NAME_OR_NUMBER", requires = "truth")]
    label: String,
    /// Compare without the vessels and tumours inside the true organ
    #[arg(long, requires = "truth")]
    without_parts: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let ct = read_with_notes(&args.ct, args.series)?.volume();
    let truth = args.truth.as_deref().map(|path| read_truth(args, path, &ct)).transpose()?;
    let params = SegmentParams { seed_m: seed_m(args, &ct.grid)?, ..SegmentParams::default() };
    let progress = indicatif::ProgressBar::new_spinner().with_message("segmenting");
    progress.enable_steady_tick(std::time::Duration::from_millis(200));
    let found = segment(&ct, &params).with_context(|| args.ct.display().to_string())?;
    progress.finish_and_clear();

    let labels = found.mask.iter().map(|&inside| u16::from(inside)).collect();
    let map =
        LabelMap { grid: ct.grid.clone(), labels, names: vec![(1, args.name.clone())], colours: Vec::new() };
    make_folder_of(&args.output)?;
    write_label_map(&args.output, &map)?;
    let overlap = truth.map(|truth| Overlap {
        dice: dice(&found.mask, &truth),
        bare_band_dice: dice(&bare_band(&ct, found.band_hu), &truth),
    });
    if args.json {
        println!(
            "{}",
            json!({
                "seed_m": found.seed_m.to_array(),
                "band_hu": found.band_hu,
                "volume_m3": mask_volume_m3(&ct.grid, &found.mask),
                "dice": overlap.as_ref().map(|o| o.dice),
                "bare_band_dice": overlap.as_ref().map(|o| o.bare_band_dice),
            })
        );
    } else {
        report(args, &ct, &found, overlap.as_ref());
    }
    Ok(())
}

/// Agreement with a true label map.
struct Overlap {
    dice: f64,
    /// Of the plain method to compare with.
    bare_band_dice: f64,
}

fn report(args: &Args, ct: &Volume<f32>, found: &Segmentation, overlap: Option<&Overlap>) {
    let seed_mm = found.seed_m * 1e3;
    let origin = if args.seed_mm.is_some() || args.seed_voxel.is_some() { "given" } else { "automatic" };
    println!("labels {}", args.output.display());
    println!("seed   {:.1}, {:.1}, {:.1} mm LPS ({origin})", seed_mm.x, seed_mm.y, seed_mm.z);
    println!(
        "band   {:.0} to {:.0} HU (level {:.0} HU, noise {:.0} HU)",
        found.band_hu[0], found.band_hu[1], found.level_hu, found.noise_hu
    );
    println!("volume {:.0} ml", mask_volume_m3(&ct.grid, &found.mask) * 1e6);
    println!(
        "repair {} tunnels filled, {} cut, {} cavities filled, {} voxels added, {} removed",
        found.repair.tunnels_filled,
        found.repair.tunnels_cut,
        found.repair.cavities_filled,
        found.repair.voxels_added,
        found.repair.voxels_removed
    );
    if let Err(cut_off) = check_clear_of_border(&ct.grid, &found.mask) {
        println!("note   {cut_off}");
    }
    if let Some(overlap) = overlap {
        println!("Dice   {:.4}", overlap.dice);
        println!("Dice   {:.4} of the bare band + largest piece", overlap.bare_band_dice);
    }
}

fn read_truth(args: &Args, path: &Path, ct: &Volume<f32>) -> anyhow::Result<Vec<bool>> {
    let map = read_with_notes(path, None)?.label_map()?;
    ensure!(
        map.grid.dims == ct.grid.dims,
        "{} has {:?} voxels, {} has {:?}: the two must be on the same grid",
        path.display(),
        map.grid.dims,
        args.ct.display(),
        ct.grid.dims
    );
    let far_m = map.grid.corner_distance_m(&ct.grid);
    ensure!(
        far_m < 0.1 * ct.grid.spacing_m.min_element(),
        "{} lies elsewhere in the patient than {} ({:.2} mm apart at the corners, 0 allowed)",
        path.display(),
        args.ct.display(),
        far_m * 1e3
    );
    let parts = if args.without_parts { Parts::Excluded } else { Parts::Included };
    let organ = map.select(&args.label, parts).with_context(|| path.display().to_string())?;
    Ok(map.mask(&organ))
}

fn seed_m(args: &Args, grid: &VoxelGrid) -> anyhow::Result<Option<DVec3>> {
    if let Some(text) = &args.seed_mm {
        return Ok(Some(three_numbers("--seed-mm", text)? * 1e-3));
    }
    let Some(text) = &args.seed_voxel else { return Ok(None) };
    let voxel = three_numbers("--seed-voxel", text)?;
    for axis in 0..3 {
        let last = grid.dims[axis] - 1;
        if !(0.0..=last as f64).contains(&voxel[axis]) {
            bail!("--seed-voxel {text}: {} is outside 0 to {last} of axis {axis}", voxel[axis]);
        }
    }
    Ok(Some(grid.position_m(voxel)))
}

fn three_numbers(option: &str, text: &str) -> anyhow::Result<DVec3> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().ok().filter(|v| v.is_finite()))
        .collect::<Option<_>>()
        .with_context(|| format!("{option} {text}: three numbers with commas expected, e.g. -80,-10,20"))?;
    ensure!(numbers.len() == 3, "{option} {text}: 3 numbers expected, {} found", numbers.len());
    Ok(DVec3::new(numbers[0], numbers[1], numbers[2]))
}
