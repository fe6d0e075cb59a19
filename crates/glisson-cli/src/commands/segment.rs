//! `glisson segment`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use glisson::image::contours::{ContourParams, SliceContour, segment_by_contours};
use glisson::image::files::write_label_map;
use glisson::image::labels::{Parts, check_clear_of_border, dice, hausdorff_95_m, mask_volume_m3};
use glisson::image::segment::{
    SeededParams, Seeds, SegmentParams, Segmentation, bare_band, segment, segment_with_seeds,
};
use glisson::image::{LabelMap, Volume, VoxelGrid};
use glisson::math::DVec3;
use serde_json::json;

use super::image_input::read_with_notes;
use super::output::make_folder_of;
use super::progress::with_bar;
use super::slice_contours;

/// Find the liver, or the organ at a point, in a CT volume.
///
/// Takes the intensity band around a seed and the connected region there, cuts thin bridges to other organs, fills
/// vessels and lesions, and ends with a geodesic active contour: the surface of least area that is drawn to edges.
/// Without a seed it starts deep in the thickest parenchyma on the patient's right. Where something is missing, add a
/// seed in it; where something is too much, add one with `--outside-mm`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson segment out/phantom/ct.nii.gz -o out/liver.nii.gz
  glisson segment out/phantom/ct.nii.gz -o out/liver.nii.gz --truth out/phantom/labels.nii.gz
  glisson segment ct.nii.gz --seed-mm=-80,-10,20 --seed-mm=30,-60,10 --outside-mm=60,0,15 -o out/liver.nii.gz
  glisson segment ct.nii.gz --seed-voxel 60,70,80 --method region -o out/liver.nii.gz")]
pub(crate) struct Args {
    /// CT volume in Hounsfield units (a DICOM folder, .nii, .nii.gz, .nrrd, .mha, .mhd or .inr)
    ct: PathBuf,
    /// Which DICOM series of a folder, by its place in the list of `glisson import --list`
    #[arg(long, value_name = "N")]
    series: Option<usize>,
    /// Label map to write (.nii, .nii.gz, .nrrd, .seg.nrrd or .mha): 1 is the organ
    #[arg(short, long, default_value = "out/labels.nii.gz")]
    output: PathBuf,
    /// How the organ is found
    #[arg(long, value_enum, default_value_t)]
    method: Method,
    /// A point inside the organ: x,y,z in mm in the patient frame (LPS: +x left, +y posterior, +z superior); may be
    /// given again, the first in the main part
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    seed_mm: Vec<String>,
    /// A voxel inside the organ: i,j,k from 0; may be given again
    #[arg(long, value_name = "I,J,K", conflicts_with = "seed_mm")]
    seed_voxel: Vec<String>,
    /// A point in tissue that must not be taken; may be given again
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    outside_mm: Vec<String>,
    /// A voxel in tissue that must not be taken; may be given again
    #[arg(long, value_name = "I,J,K", conflicts_with = "outside_mm")]
    outside_voxel: Vec<String>,
    /// Contours drawn by hand, of `--method contours`: they replace what would be found in their slices, and the slices
    /// beside them start from them (JSON, as `--contours-out` writes it)
    #[arg(long, value_name = "FILE")]
    corrections: Option<PathBuf>,
    /// Write the contours found by `--method contours` (JSON)
    #[arg(long, value_name = "FILE")]
    contours_out: Option<PathBuf>,
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

/// Ways to find an organ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// Seeds inside and outside, ending with a geodesic active contour
    #[default]
    Geodesic,
    /// The region around one seed, smoothed by opening and closing
    Region,
    /// Deformable contours, slice by slice, which can be corrected by hand
    Contours,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    check_options(args)?;
    let corrections = args.corrections.as_deref().map(slice_contours::read).transpose()?.unwrap_or_default();
    let ct = read_with_notes(&args.ct, args.series)?.volume();
    let truth = args.truth.as_deref().map(|path| read_truth(args, path, &ct)).transpose()?;
    let seeds = Seeds {
        inside_m: points_m(&ct.grid, ["--seed-mm", "--seed-voxel"], [&args.seed_mm, &args.seed_voxel])?,
        outside_m: points_m(
            &ct.grid,
            ["--outside-mm", "--outside-voxel"],
            [&args.outside_mm, &args.outside_voxel],
        )?,
    };
    let found = with_bar("segmenting", || found(args, &ct, &seeds, corrections))
        .with_context(|| args.ct.display().to_string())?;

    let labels = found.mask.iter().map(|&inside| u16::from(inside)).collect();
    let map =
        LabelMap { grid: ct.grid.clone(), labels, names: vec![(1, args.name.clone())], colours: Vec::new() };
    make_folder_of(&args.output)?;
    write_label_map(&args.output, &map)?;
    let overlap = truth.map(|truth| Overlap {
        dice: dice(&found.mask, &truth),
        hausdorff_95_m: hausdorff_95_m(&ct.grid, &found.mask, &truth),
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
                "hausdorff_95_m": overlap.as_ref().and_then(|o| o.hausdorff_95_m),
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
    /// 95 % of the border voxels of either are at most so far from those of the other [m].
    hausdorff_95_m: Option<f64>,
    /// Of the plain method to compare with.
    bare_band_dice: f64,
}

fn report(args: &Args, ct: &Volume<f32>, found: &Segmentation, overlap: Option<&Overlap>) {
    let seed_mm = found.seed_m * 1e3;
    let origin = if args.seed_mm.is_empty() && args.seed_voxel.is_empty() { "automatic" } else { "given" };
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
        if let Some(far_m) = overlap.hausdorff_95_m {
            println!("border {:.2} mm from the true one at most (95 % of both)", 1e3 * far_m);
        }
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

/// Refuses options that the method does not take.
fn check_options(args: &Args) -> anyhow::Result<()> {
    let n_seeds = args.seed_mm.len() + args.seed_voxel.len();
    ensure!(
        args.method == Method::Contours || (args.corrections.is_none() && args.contours_out.is_none()),
        "--corrections and --contours-out are for --method contours"
    );
    ensure!(
        args.method == Method::Geodesic || (args.outside_mm.is_empty() && args.outside_voxel.is_empty()),
        "seeds outside the organ are for --method geodesic"
    );
    ensure!(
        args.method != Method::Region || n_seeds <= 1,
        "--method region takes one seed, {n_seeds} are given"
    );
    Ok(())
}

/// What the method asked for finds.
fn found(
    args: &Args,
    ct: &Volume<f32>,
    seeds: &Seeds,
    corrections: Vec<SliceContour>,
) -> anyhow::Result<Segmentation> {
    match args.method {
        Method::Geodesic => Ok(segment_with_seeds(ct, seeds, &SeededParams::default())?),
        Method::Region => {
            let seed_m = seeds.inside_m.first().copied();
            Ok(segment(ct, &SegmentParams { seed_m, ..SegmentParams::default() })?)
        }
        Method::Contours => by_contours(args, ct, seeds, corrections),
    }
}

fn by_contours(
    args: &Args,
    ct: &Volume<f32>,
    seeds: &Seeds,
    corrections: Vec<SliceContour>,
) -> anyhow::Result<Segmentation> {
    let params = ContourParams { seeds_m: seeds.inside_m.clone(), corrections, ..ContourParams::default() };
    let found = segment_by_contours(ct, &params)?;
    let restless = &found.report.slices_not_at_rest;
    if !restless.is_empty() {
        eprintln!(
            "note: contours did not come to rest in slices {restless:?}: look at them (--contours-out, --corrections)"
        );
    }
    if let Some(path) = &args.contours_out {
        slice_contours::write(path, &found.contours)?;
        eprintln!("contours written to {}", path.display());
    }
    Ok(Segmentation {
        mask: found.mask,
        seed_m: found.seeds_m[0],
        level_hu: found.level.level_hu,
        noise_hu: found.level.noise_hu,
        band_hu: found.level.band_hu,
        repair: found.report.repair,
    })
}

/// Points given in millimetres or as voxels, by the options of these names.
fn points_m(grid: &VoxelGrid, names: [&str; 2], given: [&[String]; 2]) -> anyhow::Result<Vec<DVec3>> {
    let mut points_m = Vec::new();
    for text in given[0] {
        points_m.push(three_numbers(names[0], text)? * 1e-3);
    }
    for text in given[1] {
        let voxel = three_numbers(names[1], text)?;
        for axis in 0..3 {
            let last = grid.dims[axis] - 1;
            if !(0.0..=last as f64).contains(&voxel[axis]) {
                bail!("{} {text}: {} is outside 0 to {last} of axis {axis}", names[1], voxel[axis]);
            }
        }
        points_m.push(grid.position_m(voxel));
    }
    Ok(points_m)
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
