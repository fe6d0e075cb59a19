//! `glisson import`.

mod anonymize;
mod slices;

use std::path::{Path, PathBuf};

use anyhow::ensure;
use glisson::image::files::{
    ImageFormat, StoredImage, format_of_name, image_extensions, read_slices, series_in, write_label_map,
    write_volume,
};
use glisson::image::{LabelMap, VoxelGrid};
use glisson::math::DVec3;
use serde_json::json;

use super::image_input::read;
use super::output::make_folder_of;

/// Say what an image is, and write it in another format.
///
/// Reads a DICOM folder or file (also DICOM-SEG), NIfTI, NRRD (also .seg.nrrd), MetaImage, INRIMAGE, or a folder of
/// masks with one organ a file; with --spacing-mm also a folder of pictures, one a slice. Prints where the image lies in the patient, its voxels and its values; of a label map
/// the organs with their volumes. Nothing that tells who the patient is is printed or written.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson import scans/abdomen
  glisson import scans/abdomen --series 2 -o out/ct.nii.gz
  glisson import segmentation.seg.nrrd --json
  glisson import scans/abdomen --anonymize out/abdomen
  glisson import visible_human --spacing-mm 0.33,0.33,1 --head-first -o out/body.nii.gz
  glisson import totalsegmentator_output -o out/labels.nii.gz")]
pub(crate) struct Args {
    /// Image: a file, or a folder of DICOM slices or of masks
    input: PathBuf,
    /// Which DICOM series of a folder, by its place in the list that is printed when there are several
    #[arg(long, value_name = "N")]
    series: Option<usize>,
    /// List the DICOM series of a folder and stop
    #[arg(long, conflicts_with_all = ["series", "output"])]
    list: bool,
    /// Write the image (.nii, .nii.gz, .nrrd, .seg.nrrd or .mha)
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Write copies of the DICOM files that do not tell who the patient is into a new folder: of all series, or of the one
    /// chosen
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["output", "list", "labels"])]
    anonymize: Option<PathBuf>,
    #[command(flatten)]
    slices: slices::SliceArgs,
    /// Take the numbers for labels (or, with `false`, for values) whatever they look like
    #[arg(long, value_name = "true|false")]
    labels: Option<bool>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.list {
        return list_series(args);
    }
    if let Some(output) = &args.anonymize {
        return anonymize::run(&args.input, args.series, output, args.json);
    }
    if let Some(output) = &args.output {
        let is_written = format_of_name(output).is_some_and(ImageFormat::is_written);
        let allowed = image_extensions(ImageFormat::is_written).join(", .");
        ensure!(is_written, "{}: the name must end in one of .{allowed}", output.display());
    }
    let mut image = match args.slices.options() {
        Some(options) => read_slices(&args.input, &options)?,
        None => read(&args.input, args.series)?,
    };
    let (contents, guess) = Contents::of(&image, args.labels)?;
    image.notes.extend(guess);
    if let Some(output) = &args.output {
        make_folder_of(output)?;
        match &contents {
            Contents::Labels(map) => write_label_map(output, map)?,
            Contents::Values { .. } => write_volume(output, &image.volume())?,
        }
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&as_json(args, &image, &contents))?);
    } else {
        print(args, &image, &contents);
    }
    Ok(())
}

fn list_series(args: &Args) -> anyhow::Result<()> {
    let series = series_in(&args.input)?;
    if args.json {
        let list: Vec<_> = series
            .iter()
            .map(|s| json!({"modality": s.modality, "number": s.number, "description": s.description, "files": s.n_files}))
            .collect();
        println!("{}", serde_json::to_string_pretty(&list)?);
        return Ok(());
    }
    for (n, summary) in series.iter().enumerate() {
        println!("{}: {summary}", n + 1);
    }
    Ok(())
}

/// What an image holds.
enum Contents {
    Labels(LabelMap),
    Values { least: f32, most: f32, mean: f64 },
}

impl Contents {
    /// Labels where the file names some or says that it is a segmentation, or where all numbers are whole and few; then
    /// also a note that it is a guess.
    fn of(image: &StoredImage, asked: Option<bool>) -> anyhow::Result<(Self, Option<String>)> {
        if asked.unwrap_or_else(|| image.is_of_labels()) {
            return Ok((Self::Labels(image.label_map()?), None));
        }
        if let Some(map) = image.likely_labels().filter(|_| asked.is_none()) {
            let note =
                "taken for labels, because its numbers are whole and few; if they are values: --labels false";
            return Ok((Self::Labels(map), Some(note.into())));
        }
        let values = image.volume().values;
        let least = values.iter().copied().fold(f32::INFINITY, f32::min);
        let most = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len().max(1) as f64;
        Ok((Self::Values { least, most, mean }, None))
    }
}

/// A label, what the file calls it, its volume [m3], and how many of its voxels lie at the border of the image.
struct Organ {
    label: u16,
    name: Option<String>,
    volume_m3: f64,
    n_at_border: usize,
}

fn organs_of(map: &LabelMap) -> Vec<Organ> {
    let mut n_voxels = vec![[0usize; 2]; 1 << 16];
    for (index, &label) in map.labels.iter().enumerate().filter(|(_, label)| **label != 0) {
        let voxel = map.grid.voxel(index);
        let is_at_border = (0..3).any(|a| voxel[a] == 0 || voxel[a] + 1 == map.grid.dims[a]);
        let [n, n_at_border] = &mut n_voxels[usize::from(label)];
        *n += 1;
        *n_at_border += usize::from(is_at_border);
    }
    let present = (1..=u16::MAX).filter(|&label| n_voxels[usize::from(label)][0] > 0);
    present
        .map(|label| {
            let [n, n_at_border] = n_voxels[usize::from(label)];
            let name = map.name_of(label).map(String::from);
            Organ { label, name, volume_m3: n as f64 * map.grid.voxel_volume_m3(), n_at_border }
        })
        .collect()
}

/// The side of the patient to which a voxel axis points, e.g. `left`, with its angle to it where that is not zero.
fn direction(axis: DVec3) -> String {
    let parts =
        [(axis.x, "left", "right"), (axis.y, "posterior", "anterior"), (axis.z, "superior", "inferior")];
    let (size, positive, negative) =
        parts.into_iter().fold(parts[0], |best, part| if part.0.abs() > best.0.abs() { part } else { best });
    let name = if size > 0.0 { positive } else { negative };
    let angle_deg = size.abs().min(1.0).acos().to_degrees();
    if angle_deg < 0.05 { name.to_owned() } else { format!("{name} ({angle_deg:.1} degrees off)") }
}

fn corners_mm(grid: &VoxelGrid) -> [[f64; 3]; 2] {
    let bounds = grid.bounds_m();
    [bounds.min_m, bounds.max_m].map(|corner| (corner * 1e3).to_array().map(|x| (10.0 * x).round() / 10.0))
}

fn print(args: &Args, image: &StoredImage, contents: &Contents) {
    let (grid, modality) = (&image.grid, image.modality.as_deref());
    let [x, y, z] = grid.dims;
    let size_mm = (grid.spacing_m * 1e3).to_array();
    println!("format     {}{}", image.format, modality.map_or(String::new(), |m| format!(", {m}")));
    println!("voxels     {x} x {y} x {z} of {:.3} x {:.3} x {:.3} mm", size_mm[0], size_mm[1], size_mm[2]);
    let axes = [0, 1, 2].map(|axis| direction(grid.axes.col(axis)));
    println!("axes       i to {}, j to {}, k to {}", axes[0], axes[1], axes[2]);
    let [low, high] = corners_mm(grid);
    println!("covers     {low:?} to {high:?} mm (LPS: +x left, +y posterior, +z superior)");
    match contents {
        Contents::Values { least, most, mean } => println!("values     {least} to {most}, mean {mean:.1}"),
        Contents::Labels(map) => {
            let organs = organs_of(map);
            println!("labels     {}", organs.len());
            for organ in organs {
                let name = organ.name.unwrap_or_else(|| "(no name)".into());
                let cut = if organ.n_at_border > 0 { ", cut off at the border of the image" } else { "" };
                println!("  {:>5}    {name}: {:.2} ml{cut}", organ.label, 1e6 * organ.volume_m3);
            }
        }
    }
    for note in &image.notes {
        println!("note       {note}");
    }
    if let Some(output) = &args.output {
        println!("written    {}", output.display());
        println!("next       {}", next_command(output, contents));
    }
}

/// The command that goes on with what was written.
fn next_command(output: &Path, contents: &Contents) -> String {
    match contents {
        Contents::Labels(map) => {
            let label = map.names.iter().find(|(_, name)| name == "liver").or(map.names.first());
            let label = label.map_or(String::new(), |(_, name)| format!(" --label \"{name}\""));
            format!("glisson mesh {}{label} -o out/organ.vtu", output.display())
        }
        Contents::Values { .. } => format!("glisson segment {} -o out/liver.nii.gz", output.display()),
    }
}

fn as_json(args: &Args, image: &StoredImage, contents: &Contents) -> serde_json::Value {
    let grid = &image.grid;
    let axes: Vec<[f64; 3]> = (0..3).map(|axis| grid.axes.col(axis).to_array()).collect();
    let contents = match contents {
        Contents::Values { least, most, mean } => json!({"least": least, "most": most, "mean": mean}),
        Contents::Labels(map) => {
            let organs = organs_of(map).into_iter().map(|organ| {
                json!({
                    "label": organ.label,
                    "name": organ.name,
                    "volume_m3": organ.volume_m3,
                    "voxels_at_border": organ.n_at_border,
                })
            });
            json!({"labels": organs.collect::<Vec<_>>()})
        }
    };
    json!({
        "format": image.format,
        "modality": image.modality,
        "dims": grid.dims,
        "spacing_m": grid.spacing_m.to_array(),
        "origin_m": grid.origin_m.to_array(),
        "axes_lps": axes,
        "contents": contents,
        "notes": image.notes,
        "written": args.output.as_ref().map(|path| path.display().to_string()),
    })
}
