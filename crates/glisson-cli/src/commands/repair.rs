//! `glisson repair`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use glisson::surface::TriMesh;
use glisson::surface::files::{read_surface_with, surface_extensions, write_surface};
use glisson::surface::repair::{RepairParams, RepairReport, Sightings, repair};
use glisson::units::LengthUnit;

use super::image_input::warn_of_unit;
use super::output::{check_extension, make_folder_of};

/// Close a surface that has holes, crossings, doubled or flipped triangles.
///
/// What can be mended without moving anything is (doubled and empty triangles go, pieces are turned outward). Where
/// that is not enough, a new surface is drawn around all that the old one winds around more than half, on a grid: holes
/// are closed by a smooth film, pieces that cross become one. Tells what was found and where, and how far it moved.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson repair liver.stl -o out/liver.stl
  glisson repair liver.obj --unit cm --grid-mm 1 -o out/liver.vtp --json")]
pub(crate) struct Args {
    /// Surface (.stl, .obj, .ply, .vtk, .vtp, .glb or .gltf)
    input: PathBuf,
    /// Surface to write, in the same formats
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    how: How,
    /// Unit of the numbers in a file that names none
    #[arg(long, value_name = "mm|cm|m|inch", default_value_t)]
    unit: LengthUnit,
    /// Print JSON: lengths in metres
    #[arg(long)]
    json: bool,
}

/// What can be said of how to repair.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct How {
    /// Spacing of the grid on which a surface is drawn anew [mm] [default: a 160th of the longest side]
    #[arg(long, value_name = "MM")]
    grid_mm: Option<f64>,
    /// Thickness of the thinnest part, or width of the narrowest gap, that has to stay [mm]
    #[arg(long, value_name = "MM")]
    smallest_feature_mm: Option<f64>,
    /// Largest share of the surface that may close holes
    #[arg(long, value_name = "SHARE")]
    largest_hole: Option<f64>,
}

impl How {
    /// Whether anything is said.
    pub(crate) fn is_given(&self) -> bool {
        self.grid_mm.or(self.smallest_feature_mm).or(self.largest_hole).is_some()
    }

    fn params(&self) -> RepairParams {
        let default = RepairParams::default();
        RepairParams {
            spacing_m: self.grid_mm.map(|mm| 1e-3 * mm),
            smallest_feature_m: self.smallest_feature_mm.map(|mm| 1e-3 * mm),
            largest_closing_share: self.largest_hole.unwrap_or(default.largest_closing_share),
            ..default
        }
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    check_extension(&args.output, &surface_extensions())?;
    let (surface, report) = repaired(&args.input, args.unit, &args.how)?;
    warn_of_unit(&args.input, report.volume_after_m3, args.unit);
    make_folder_of(&args.output)?;
    write_surface(&args.output, &surface)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print_report(&report);
        println!("written      {}", args.output.display());
    }
    Ok(())
}

/// The closed surface that a file stands for, and what was done.
pub(crate) fn repaired(path: &Path, unit: LengthUnit, how: &How) -> anyhow::Result<(TriMesh, RepairReport)> {
    let surface = read_surface_with(path, unit)?;
    repair(&surface, &how.params()).with_context(|| path.display().to_string())
}

pub(crate) fn print_report(report: &RepairReport) {
    let found = &report.found;
    let faults: [(&str, &Sightings); 9] = [
        ("coincident vertices", &found.coincident_vertices),
        ("unused vertices", &found.unused_vertices),
        ("triangles without area", &found.degenerate_triangles),
        ("doubled triangles", &found.duplicate_triangles),
        ("open edges", &found.open_edges),
        ("edges of more than two triangles", &found.crowded_edges),
        ("turned triangles", &found.turned_triangles),
        ("pieces inside out", &found.turned_pieces),
        ("crossing triangles", &found.self_intersections),
    ];
    let mut any = false;
    for (name, seen) in faults.into_iter().filter(|(_, seen)| seen.count > 0) {
        println!("found        {} {name}{}", seen.count, places(seen));
        any = true;
    }
    if !any {
        println!("found        nothing wrong");
    }
    for (name, seen) in [
        ("small pieces or cavities taken away", &report.done.small_pieces_dropped),
        ("pieces inside others made part of the body", &report.done.inner_pieces_filled),
    ] {
        if seen.count > 0 {
            println!("done         {} {name}{}", seen.count, places(seen));
        }
    }
    match report.spacing_m {
        Some(spacing_m) => println!(
            "done         drawn anew on a grid of {:.2} mm: at most {:.3} mm from the old surface, {:.2} % of it closes holes",
            1e3 * spacing_m,
            1e3 * report.greatest_move_m,
            100.0 * report.closing_share
        ),
        None => println!("done         mended without moving a vertex"),
    }
    println!(
        "surface      {} triangles, closed, {} piece(s), Euler number {}, {:.2} ml (as given {:.2} ml)",
        report.n_triangles,
        report.n_pieces,
        report.euler_characteristic,
        1e6 * report.volume_after_m3,
        1e6 * report.volume_before_m3
    );
}

/// Where something was seen first.
fn places(seen: &Sightings) -> String {
    const N_SHOWN: usize = 3;
    let shown: Vec<String> = seen
        .places_m
        .iter()
        .take(N_SHOWN)
        .map(|p| format!("({:.1}, {:.1}, {:.1})", 1e3 * p.x, 1e3 * p.y, 1e3 * p.z))
        .collect();
    let more = if seen.count > shown.len() { " ..." } else { "" };
    format!(" at {}{more} mm", shown.join(", "))
}
