//! `glisson mesh`.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use glisson::image::labels::{mask_volume_m3, sides_at_border};
use glisson::mesh::files::{MeshFormat, extensions_of, write_mesh};
use glisson::mesh::generate::{
    MAX_TETRAHEDRA, MIN_TETRAHEDRA, MeshParams, MeshPlan, MeshReport, USUAL_TETRAHEDRA, WantedSize,
};
use glisson::mesh::thin::ThinKind;
use glisson::surface::TriMesh;
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use glisson::surface::files::{
    SurfaceFileError, import_closed_surface_with, surface_extensions, write_surface,
};
use glisson::units::LengthUnit;

use super::image_input::{LabelChoice, is_image, read_with_notes, warn_of_unit};
use super::output::{check_extension, make_folder_of};
use super::repair::{How, print_report as print_repair, repaired};

/// Turn a label map or a closed surface into a tetrahedral mesh.
///
/// Of a label map the organ is taken with the vessels and tumours inside it; its surface is extracted,
/// smoothed and checked. The mesh has dihedral angles above 10 degrees, the volume of the label (or surface)
/// within 0.1 % and as many pieces and tunnels as the surface, or it is refused.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson mesh out/phantom/labels.nii.gz -o out/liver.vtu
  glisson mesh labels.nii.gz --label spleen --tetrahedra 2000 -o spleen.msh
  glisson mesh labels.nii.gz --label 5 --element-size-mm 8 --surface-out liver.stl -o liver.vtk
  glisson mesh liver.stl --tetrahedra 20000 -o liver.vtu")]
pub(crate) struct Args {
    /// Label map (.nii, .nii.gz, .nrrd, .seg.nrrd, .mha, .mhd, .inr, .dcm or a folder of masks) or closed surface (.stl,
    /// .obj, .ply, .vtk)
    input: PathBuf,
    #[command(flatten)]
    label: LabelChoice,
    /// Number of tetrahedra, met within 5 % [default: 6300]
    #[arg(long, value_name = "N", conflicts_with = "element_size_mm")]
    tetrahedra: Option<usize>,
    /// Mean edge of the tetrahedra inside [mm]
    #[arg(long, value_name = "MM")]
    element_size_mm: Option<f64>,
    /// Close an organ that the border of the image cuts off with a flat face there
    #[arg(long)]
    cut_at_border: bool,
    /// Close a surface that has holes, crossings, doubled or flipped triangles (see `glisson repair`)
    #[arg(long)]
    repair: bool,
    #[command(flatten)]
    how_to_repair: How,
    /// Unit of the numbers in a surface file, which names none (glTF: always m) [default: mm]
    #[arg(long, value_name = "mm|cm|m|inch")]
    unit: Option<LengthUnit>,
    /// Thin the label's surface out to this many triangles before meshing
    #[arg(long, value_name = "N")]
    surface_triangles: Option<usize>,
    /// Write the closed surface, too (.stl, .obj, .ply, .vtk)
    #[arg(long, value_name = "FILE")]
    surface_out: Option<PathBuf>,
    /// Mesh to write (.vtu, .vtk or .msh)
    #[arg(short, long, default_value = "out/mesh.vtu")]
    output: PathBuf,
}

/// A surface to mesh, and the volume that the mesh should have.
struct Source {
    surface: TriMesh,
    volume_m3: f64,
    volume_of: &'static str,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    check_arguments(args)?;
    let begun = Instant::now();
    let progress = indicatif::ProgressBar::new_spinner();
    progress.enable_steady_tick(Duration::from_millis(200));
    let stages = Stages { progress };
    let source = if is_image(&args.input) { of_label(args, &stages)? } else { of_surface(args, &stages)? };
    if let Some(path) = &args.surface_out {
        make_folder_of(path)?;
        write_surface(path, &source.surface)?;
        println!("surface      written to {}", path.display());
    }

    let size = match args.element_size_mm {
        Some(size_mm) => WantedSize::EdgeM(1e-3 * size_mm),
        None => WantedSize::Tetrahedra(args.tetrahedra.unwrap_or(USUAL_TETRAHEDRA)),
    };
    let params = MeshParams { size, volume_m3: Some(source.volume_m3) };
    let in_input = || args.input.display().to_string();
    let (plan, field) = stages
        .timed(
            "distance",
            || {
                let plan = MeshPlan::new(&source.surface, &params)?;
                let field = plan.distance_field(&source.surface)?;
                anyhow::Ok((plan, field))
            },
            |(_, field)| {
                let [x, y, z] = field.dims();
                format!("{x} x {y} x {z} nodes, {:.2} mm apart", 1e3 * field.spacing_m())
            },
        )
        .with_context(in_input)?;
    let (mesh, report) = stages
        .timed(
            "tetrahedra",
            || plan.fill(&field),
            |(mesh, report)| {
                let (n, nodes) = (mesh.tetrahedra.len(), mesh.positions_m.len());
                format!("{n} with {nodes} nodes, {} fillings", report.n_fillings)
            },
        )
        .with_context(in_input)?;
    make_folder_of(&args.output)?;
    stages.timed("written", || write_mesh(&args.output, &mesh), |()| args.output.display().to_string())?;
    stages.progress.finish_and_clear();
    print_report(&source, &report);
    println!("time         {:.2} s in all", begun.elapsed().as_secs_f64());
    Ok(())
}

/// Refuses what would fail only after the work.
fn check_arguments(args: &Args) -> anyhow::Result<()> {
    ensure!(
        args.repair || !args.how_to_repair.is_given(),
        "--grid-mm, --smallest-feature-mm and --largest-hole say how to repair: add --repair"
    );
    check_extension(&args.output, &extensions_of(MeshFormat::is_written))?;
    if let Some(path) = &args.surface_out {
        check_extension(path, &surface_extensions())?;
    }
    if let Some(n) = args.tetrahedra {
        let allowed = MIN_TETRAHEDRA..=MAX_TETRAHEDRA;
        ensure!(
            allowed.contains(&n),
            "--tetrahedra {n} is outside the allowed {MIN_TETRAHEDRA} to {MAX_TETRAHEDRA}"
        );
    }
    if let Some(size_mm) = args.element_size_mm {
        ensure!(
            size_mm > 0.0 && size_mm.is_finite(),
            "--element-size-mm {size_mm}: a size above 0 is needed"
        );
    }
    Ok(())
}

/// Times stages and says what came out.
struct Stages {
    progress: indicatif::ProgressBar,
}

impl Stages {
    fn timed<T, E>(
        &self,
        name: &'static str,
        work: impl FnOnce() -> Result<T, E>,
        told: impl FnOnce(&T) -> String,
    ) -> Result<T, E> {
        self.progress.set_message(name);
        let begun = Instant::now();
        let done = work()?;
        let seconds = begun.elapsed().as_secs_f64();
        self.progress.suspend(|| println!("{name:12} {} ({seconds:.2} s)", told(&done)));
        Ok(done)
    }
}

fn of_label(args: &Args, stages: &Stages) -> anyhow::Result<Source> {
    ensure!(
        args.unit.is_none(),
        "{}: an image says its own unit: --unit is for surfaces",
        args.input.display()
    );
    let in_input = || args.input.display().to_string();
    let map = stages.timed(
        "label map",
        || read_with_notes(&args.input, args.label.series).and_then(|image| image.label_map()),
        |map| {
            let ([x, y, z], spacing_mm) = (map.grid.dims, 1e3 * map.grid.spacing_m);
            format!(
                "{x} x {y} x {z} voxels of {:.2} x {:.2} x {:.2} mm",
                spacing_mm.x, spacing_mm.y, spacing_mm.z
            )
        },
    )?;
    let selection = args.label.select(&map).with_context(in_input)?;
    let mask = map.mask(&selection);
    let volume_m3 = mask_volume_m3(&map.grid, &mask);
    let names: Vec<String> =
        selection.labels.iter().map(|&l| map.name_of(l).map_or(l.to_string(), String::from)).collect();
    println!("label        {}: {:.1} ml", names.join(" + "), 1e6 * volume_m3);
    if args.cut_at_border {
        for side in sides_at_border(&map.grid, &mask) {
            println!("cut off      closed with a flat face at {side}");
        }
    }
    let params = SurfaceParams {
        target_triangles: args.surface_triangles,
        cap_at_border: args.cut_at_border,
        ..SurfaceParams::default()
    };
    let (surface, _) = stages
        .timed(
            "surface",
            || surface_of_mask(&map.grid, &mask, &params),
            |(_, report)| {
                let repair = &report.repair;
                format!(
                    "{} triangles, {:.1} ml, Euler number {}, {} voxels added and {} removed by the repair",
                    report.n_triangles,
                    1e6 * report.surface_volume_m3,
                    report.euler_characteristic,
                    repair.voxels_added,
                    repair.voxels_removed
                )
            },
        )
        .with_context(in_input)?;
    Ok(Source { surface, volume_m3, volume_of: "label" })
}

fn of_surface(args: &Args, stages: &Stages) -> anyhow::Result<Source> {
    if args.label.is_given() || args.surface_triangles.is_some() || args.cut_at_border {
        bail!(
            "{} is no label map: --series, --label, --without-parts, --cut-at-border and --surface-triangles are for label maps",
            args.input.display()
        );
    }
    let unit = args.unit.unwrap_or_default();
    if args.repair {
        let (surface, report) = repaired(&args.input, unit, &args.how_to_repair)?;
        print_repair(&report);
        warn_of_unit(&args.input, report.volume_after_m3, unit);
        return Ok(Source { surface, volume_m3: report.volume_after_m3, volume_of: "surface" });
    }
    let imported = stages.timed(
        "surface",
        || import_closed_surface_with(&args.input, unit),
        |imported| {
            let t = &imported.topology;
            let (pieces, euler, volume_ml) = (t.n_pieces, t.euler_characteristic, 1e6 * t.volume_m3);
            format!(
                "{} triangles, closed, {pieces} piece(s), Euler number {euler}, {volume_ml:.1} ml",
                t.n_triangles
            )
        },
    );
    let imported = imported.map_err(|error| match error {
        SurfaceFileError::Surface { .. } => anyhow::anyhow!("{error:#}; `--repair` closes such surfaces"),
        other => other.into(),
    })?;
    for note in &imported.notes {
        println!("note         {note}");
    }
    warn_of_unit(&args.input, imported.topology.volume_m3, unit);
    let (surface, topology) = (imported.mesh, imported.topology);
    Ok(Source { surface, volume_m3: topology.volume_m3, volume_of: "surface" })
}

fn print_report(source: &Source, report: &MeshReport) {
    let quality = &report.quality;
    println!(
        "volume       {:.2} ml, {} {:.2} ml ({:+.3} %)",
        1e6 * quality.volume_m3,
        source.volume_of,
        1e6 * source.volume_m3,
        100.0 * (quality.volume_m3 / source.volume_m3 - 1.0)
    );
    println!(
        "dihedral     {:.2} to {:.2} degrees; radius ratio {:.3} at least, {:.3} mean",
        quality.min_dihedral_deg,
        quality.max_dihedral_deg,
        quality.min_radius_ratio,
        quality.mean_radius_ratio
    );
    println!(
        "edges        {:.2} to {:.2} mm, mean {:.2} mm",
        1e3 * quality.min_edge_m,
        1e3 * quality.max_edge_m,
        1e3 * quality.mean_edge_m
    );
    println!(
        "boundary     {} triangles, {} piece(s), Euler number {}",
        quality.surface_triangles, quality.surface_pieces, quality.surface_euler_characteristic
    );
    println!(
        "repairs      {} lattice nodes changed sides, {} kept in place, {} crumbs dropped, {} holes filled",
        report.changed_nodes, report.stiff_nodes, report.crumb_nodes, report.filled_nodes
    );
    for reason in &report.given_up {
        println!("given up     {reason}");
    }
    print_thin_features(report);
}

fn print_thin_features(report: &MeshReport) {
    const N_SHOWN: usize = 5;
    let thin = &report.thin_features;
    let limit_mm = 2e3 * report.cell_m;
    if thin.is_empty() {
        println!("thin         nothing is thinner than two cells ({limit_mm:.1} mm)");
        return;
    }
    let n_gaps = thin.iter().filter(|f| f.kind == ThinKind::Gap).count();
    println!(
        "thin         {} rims or sheets and {n_gaps} gaps are thinner than two cells ({limit_mm:.1} mm); the largest:",
        thin.len() - n_gaps
    );
    for feature in thin.iter().take(N_SHOWN) {
        let [x, y, z] = feature.position_m.map(|p| 1e3 * p);
        let kind = match feature.kind {
            ThinKind::Body => "body",
            ThinKind::Gap => "gap",
        };
        println!(
            "             {kind} at ({x:.0}, {y:.0}, {z:.0}) mm, {:.1} mm thick, {:.0} mm long, {:.2} ml",
            1e3 * feature.thickness_m,
            1e3 * feature.extent_m,
            1e6 * feature.volume_m3
        );
    }
}
