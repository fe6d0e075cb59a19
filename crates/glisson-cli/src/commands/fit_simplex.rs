//! `glisson fit-simplex`.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use glisson::surface::files::{import_closed_surface_with, surface_extensions, write_surface};
use glisson::surface::simplex::fit::{
    SimplexFit, SimplexFitParams, SimplexFitProgress, SimplexFitReport, fit_simplex, fit_simplex_to_surface,
};
use glisson::units::LengthUnit;

use super::image_input::{LabelChoice, is_image, label_mask, warn_of_unit};
use super::output::{check_extension, make_folder_of};

/// Fit a smooth surface with few triangles to an organ: a simplex mesh and its dual triangulation.
///
/// Each vertex of a simplex mesh has three neighbours. Forces of curvature continuity take the voxels' stairs away, the
/// organ's border keeps it in place, and vertices gather where it is curved. The surface written is closed, without
/// crossings, has the organ's volume and by default a sixth of the triangles of marching cubes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson fit-simplex out/phantom/labels.nii.gz -o out/liver.stl
  glisson fit-simplex labels.nii.gz --label 5 --triangles 8000 -o out/liver.vtp --json
  glisson fit-simplex liver.stl --resolution-mm 1.5 -o out/smooth.stl")]
pub(crate) struct Args {
    /// Label map (.nii, .nii.gz, .nrrd, .seg.nrrd, .mha, .mhd, .inr, .dcm or a folder of masks) or closed surface
    input: PathBuf,
    #[command(flatten)]
    label: LabelChoice,
    /// Number of triangles [default: a sixth of those of marching cubes]
    #[arg(long, value_name = "N")]
    triangles: Option<usize>,
    /// Over how many edges curvature is kept even: more is smoother [default: 4]
    #[arg(long, value_name = "EDGES")]
    rigidity: Option<usize>,
    /// Of a surface: size of what is noise on it, such as the voxels it came from [mm]
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    resolution_mm: f64,
    /// Unit of the numbers in a surface file that names none
    #[arg(long, value_name = "mm|cm|m|inch", default_value_t)]
    unit: LengthUnit,
    /// Close an organ that the border of the image cuts off with a flat face there
    #[arg(long)]
    cut_at_border: bool,
    /// Surface to write (.stl, .obj, .ply, .vtk, .vtp, .glb or .gltf)
    #[arg(short, long)]
    output: PathBuf,
    /// Print JSON: lengths in metres
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    check_extension(&args.output, &surface_extensions())?;
    let default = SimplexFitParams::default();
    let params = SimplexFitParams {
        target_triangles: args.triangles,
        rigidity: args.rigidity.unwrap_or(default.rigidity),
        cap_at_border: args.cut_at_border,
        ..default
    };
    let bar = indicatif::ProgressBar::new(100);
    if let Ok(style) = indicatif::ProgressStyle::with_template("{msg:24} {wide_bar} {percent} %") {
        bar.set_style(style);
    }
    let mut progress = |at: SimplexFitProgress| {
        let far = at.mean_offset_m.map_or(String::new(), |m| format!(", {:.2} mm", 1e3 * m));
        bar.set_message(format!("{}{far}", at.stage));
        bar.set_position((100.0 * at.share) as u64);
        ControlFlow::Continue(())
    };
    let fit = fitted(args, &params, &mut progress)?;
    bar.finish_and_clear();
    make_folder_of(&args.output)?;
    write_surface(&args.output, &fit.mesh)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&fit.report)?);
    } else {
        print_report(&fit.report, &args.output);
    }
    Ok(())
}

fn fitted(
    args: &Args,
    params: &SimplexFitParams,
    progress: &mut dyn FnMut(SimplexFitProgress) -> ControlFlow<()>,
) -> anyhow::Result<SimplexFit> {
    let in_input = || args.input.display().to_string();
    if is_image(&args.input) {
        let (map, mask) = label_mask(&args.input, &args.label)?;
        return fit_simplex(&map.grid, &mask, params, progress).with_context(in_input);
    }
    ensure!(
        !args.label.is_given() && !args.cut_at_border,
        "{} is no label map: --series, --label, --without-parts and --cut-at-border are for label maps",
        args.input.display()
    );
    let imported = import_closed_surface_with(&args.input, args.unit)?;
    imported.notes.iter().for_each(|note| eprintln!("note: {}: {note}", args.input.display()));
    warn_of_unit(&args.input, imported.topology.volume_m3, args.unit);
    fit_simplex_to_surface(&imported.mesh, 1e-3 * args.resolution_mm, params, progress).with_context(in_input)
}

fn print_report(report: &SimplexFitReport, output: &Path) {
    println!(
        "surface      {} triangles of {}, {} cells",
        report.n_triangles, report.n_triangles_extracted, report.n_cells
    );
    let mm = |m: f64| 1e3 * m;
    for (name, far) in [("to data", &report.to_data), ("from data", &report.from_data)] {
        println!(
            "{name:12} {:.3} mm mean, {:.3} mm for 95 %, {:.2} mm at most",
            mm(far.mean_m),
            mm(far.p95_m),
            mm(far.max_m)
        );
    }
    let [low, high] = report.curvatures_per_m;
    let [stairs_low, stairs_high] = report.data_curvatures_per_m;
    println!(
        "curvature    {low:.0} to {high:.0} 1/m for 90 %; with the voxels' stairs {stairs_low:.0} to {stairs_high:.0}"
    );
    println!("vertices     denser where it is curved: rank correlation {:.2}", report.density_correlation);
    println!("volume       {:.2} ml, data {:.2} ml", 1e6 * report.volume_m3, 1e6 * report.data_volume_m3);
    println!("written      {}", output.display());
}
