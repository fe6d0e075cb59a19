//! `glisson check`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use glisson::files::write_atomically;
use glisson::mesh::TetMesh;
use glisson::mesh::checked::{MeshCheck, SurfaceCheck};
use glisson::mesh::faults::{ImportPolicy, ImportReport};
use glisson::mesh::files::{format_of_extension, read_mesh_with};
use glisson::mesh::quality::{
    DIHEDRAL_BIN_DEG, MeshQuality, RADIUS_RATIO_BINS, dihedral_angles_deg, radius_ratios,
};
use glisson::surface::TriMesh;
use glisson::surface::files::{read_surface_with, surface_extensions};
use glisson::units::LengthUnit;

use glisson_report::plot::Histogram;

use super::image_input::warn_of_unit;
use super::output::make_folder_of;

/// Say how good a mesh is, and what is wrong with it.
///
/// Reads tetrahedral meshes and closed surfaces. Lengths in the JSON are in metres, angles in degrees. When
/// something is wrong (duplicate or loose nodes, inverted or flat tetrahedra, a surface that is not a
/// manifold), it is listed by index and the exit code is 1.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson check out/liver.vtu
  glisson check out/liver.vtu --json
  glisson check out/liver.msh --svg out/quality.svg
  glisson check liver.stl")]
pub(crate) struct Args {
    /// Tetrahedral mesh (.vtu, .vtk, .msh, .feb, .inp, .node/.ele, plain list) or surface (.stl, .obj, .ply, .vtk, .vtp,
    /// .glb, .gltf)
    file: PathBuf,
    /// Unit of the numbers in a file that names none
    #[arg(long, value_name = "mm|cm|m|inch", default_value_t)]
    unit: LengthUnit,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
    /// Draw histograms of dihedral angles and radius ratios (tetrahedral meshes)
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let extension = args.file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let policy = ImportPolicy { unit: args.unit, ..ImportPolicy::default() };
    let is_mesh = format_of_extension(&extension).is_some();
    if !is_mesh && surface_extensions().contains(&extension.as_str()) {
        return check_surface(args, &read_surface_with(&args.file, args.unit)?);
    }
    match read_mesh_with(&args.file, &policy) {
        Ok((mesh, import)) => check_mesh(args, &mesh, &import),
        // `.vtk` holds either; the error that counts is the mesh's.
        Err(error) if extension == "vtk" => match read_surface_with(&args.file, args.unit) {
            Ok(surface) if !surface.triangles.is_empty() => check_surface(args, &surface),
            _ => Err(error.into()),
        },
        Err(error) => Err(error.into()),
    }
}

fn check_mesh(args: &Args, mesh: &TetMesh, import: &ImportReport) -> anyhow::Result<()> {
    let (checked, faults) = MeshCheck::of(mesh, import);
    warn_of_unit(&args.file, checked.quality.volume_m3, args.unit);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&checked)?);
    } else {
        print_quality(&checked.quality);
        for (kind, count) in &import.skipped_cells {
            println!("passed over   {count} cells: {kind}");
        }
    }
    if let Some(path) = &args.svg {
        write_histograms(path, mesh)?;
    }
    conclude(args, &faults)
}

fn check_surface(args: &Args, surface: &TriMesh) -> anyhow::Result<()> {
    ensure!(args.svg.is_none(), "{}: --svg draws tetrahedra, this is a surface", args.file.display());
    let (checked, topology) = SurfaceCheck::of(surface);
    if let Some(topology) = &topology {
        warn_of_unit(&args.file, topology.volume_m3, args.unit);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&checked)?);
    } else if let Some(topology) = &topology {
        println!("vertices      {}", topology.n_vertices);
        println!("triangles     {}", topology.n_triangles);
        println!("volume        {:.3} ml", 1e6 * topology.volume_m3);
        println!("area          {:.2} cm2", 1e4 * topology.area_m2);
        println!("pieces        {}", topology.n_pieces);
        println!("Euler number  {}", topology.euler_characteristic);
    }
    conclude(args, &checked.faults)
}

fn conclude(args: &Args, faults: &[String]) -> anyhow::Result<()> {
    if faults.is_empty() {
        if !args.json {
            println!("faults        none");
        }
        return Ok(());
    }
    bail!("{} is not fit for simulation:\n  {}", args.file.display(), faults.join("\n  "))
}

fn print_quality(quality: &MeshQuality) {
    println!("nodes         {}", quality.nodes);
    println!("tetrahedra    {}", quality.tetrahedra);
    println!("volume        {:.3} ml", 1e6 * quality.volume_m3);
    println!(
        "tetrahedron   {:.5} to {:.5} ml",
        1e6 * quality.min_tetrahedron_volume_m3,
        1e6 * quality.max_tetrahedron_volume_m3
    );
    println!("dihedral      {:.2} to {:.2} degrees", quality.min_dihedral_deg, quality.max_dihedral_deg);
    println!("radius ratio  {:.3} at least, {:.3} mean", quality.min_radius_ratio, quality.mean_radius_ratio);
    println!(
        "edges         {:.3} to {:.3} mm, mean {:.3} mm",
        1e3 * quality.min_edge_m,
        1e3 * quality.max_edge_m,
        1e3 * quality.mean_edge_m
    );
    println!(
        "surface       {} triangles, {:.2} cm2, {} piece(s), Euler number {}",
        quality.surface_triangles,
        1e4 * quality.surface_area_m2,
        quality.surface_pieces,
        quality.surface_euler_characteristic
    );
    println!("angles by {DIHEDRAL_BIN_DEG:.0} degrees from 0: {:?}", quality.dihedral_histogram);
}

/// Dihedral angles above, radius ratios below, in one picture.
fn write_histograms(path: &Path, mesh: &TetMesh) -> anyhow::Result<()> {
    const SIZE: [u32; 2] = [800, 360];
    let angles_deg = dihedral_angles_deg(mesh);
    let extreme = |pick: fn(f64, f64) -> f64, start: f64| angles_deg.iter().copied().fold(start, pick);
    let (least_deg, most_deg) = (extreme(f64::min, 180.0), extreme(f64::max, 0.0));
    let angles = Histogram {
        title: format!("Dihedral angles of {} tetrahedra", mesh.tetrahedra.len()),
        x_label: "dihedral angle [degrees]".into(),
        y_label: "number".into(),
        marks: vec![
            (least_deg, format!("smallest {least_deg:.1}")),
            (most_deg, format!("largest {most_deg:.1}")),
        ],
        values: angles_deg,
        range: [0.0, 180.0],
        n_bins: 90,
        size: SIZE,
    };
    let ratios = Histogram {
        title: "Radius ratios 3 r_in / r_out".into(),
        x_label: "radius ratio (1: regular)".into(),
        y_label: "number".into(),
        values: radius_ratios(mesh),
        range: [0.0, 1.0],
        n_bins: 2 * RADIUS_RATIO_BINS,
        marks: Vec::new(),
        size: SIZE,
    };
    let [width, height] = SIZE;
    let svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{}\">\n<g>\n{}</g>\n<g \
         transform=\"translate(0 {height})\">\n{}</g>\n</svg>\n",
        2 * height,
        without_prolog(&angles.to_svg()?),
        without_prolog(&ratios.to_svg()?)
    );
    make_folder_of(path)?;
    write_atomically(path, |out| std::io::Write::write_all(out, svg.as_bytes()))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// The `<svg>` element without what may stand before it.
fn without_prolog(svg: &str) -> &str {
    svg.find("<svg").map_or(svg, |at| &svg[at..])
}
