//! `glisson mesh-organs`.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use glisson::image::LabelMap;
use glisson::math::DVec3;
use glisson::mesh::files::{FieldPlace, FieldValues, LABEL_FIELD, VtuField, write_vtu_with};
use glisson::mesh::organs::{FinerBall, Grading, OrganMesh, OrganMeshParams, OrganSize, mesh_organs};
use glisson::surface::files::write_surface;

use super::image_input::read_with_notes;
use super::numbers::numbers;
use super::output::{check_extension, make_folder_of};
use super::progress::with_bar;

/// Number of tetrahedra when neither a number nor a size is given.
const DEFAULT_TETRAHEDRA: usize = 20_000;

/// Turn several organs of a label map into one mesh of tetrahedra with a label on each.
///
/// Organs that touch, or lie in each other, share the nodes and faces of their interfaces: there are no gaps. Dihedral
/// angles are at least 11.9 degrees (10.8 where cells are smaller in places); volumes are those of the labels within 1.5 % for organs that are two cells thick.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson mesh-organs out/phantom/labels.nii.gz --label liver --label liver_tumour --label gall_bladder -o out/organs.vtu
  glisson mesh-organs out/phantom/labels.nii.gz --label liver --label liver_tumour --tetrahedra 6300 --least-tetrahedra 300
  glisson mesh-organs labels.nii.gz --label 5 --label 7 --cell-mm 5 --surfaces out/surfaces -o out/organs.vtu")]
pub(crate) struct Args {
    /// Label map (.nii, .nii.gz, .nrrd, .seg.nrrd, .mha, .mhd, .inr, .dcm or a folder of masks)
    input: PathBuf,
    /// Which DICOM series of a folder, by its place in the list of `glisson import --list`
    #[arg(long, value_name = "N")]
    series: Option<usize>,
    /// An organ, by name or number; give it again for each [default: all labels]
    #[arg(long, value_name = "NAME_OR_NUMBER")]
    label: Vec<String>,
    /// Number of tetrahedra of all organs together, met within 5 % [default: 20000]
    #[arg(long, value_name = "N", conflicts_with = "cell_mm")]
    tetrahedra: Option<usize>,
    /// Cell of the lattice [mm]: inner edges are 0.92 of it, those at borders about half as long
    #[arg(long, value_name = "MM")]
    cell_mm: Option<f64>,
    /// Tetrahedra that each organ gets at least, about: cells are smaller in small organs, and grow around them
    #[arg(long, value_name = "N", default_value_t = 0)]
    least_tetrahedra: usize,
    /// By how much cells at the surface of all organs together are smaller than within (1 to 16)
    #[arg(long, value_name = "FACTOR")]
    finer_at_surface: Option<f64>,
    /// A ball in which cells are smaller: centre and radius in mm (LPS), and by how much (1 to 16); give it again for each
    #[arg(long, value_name = "X,Y,Z,R,FACTOR", value_parser = numbers::<5>, allow_hyphen_values = true)]
    finer_ball: Vec<[f64; 5]>,
    /// Write the closed surface of each organ into this folder, too (.stl)
    #[arg(long, value_name = "FOLDER")]
    surfaces: Option<PathBuf>,
    /// Mesh to write (.vtu, with the cell field `label`)
    #[arg(short, long, default_value = "out/organs.vtu")]
    output: PathBuf,
    /// Print JSON: lengths in metres
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    check_extension(&args.output, &["vtu"])?;
    let map = read_with_notes(&args.input, args.series)?.label_map()?;
    let in_input = || args.input.display().to_string();
    let mut labels = args
        .label
        .iter()
        .map(|name| map.resolve(name))
        .collect::<Result<Vec<u16>, _>>()
        .with_context(in_input)?;
    labels.sort_unstable();
    labels.dedup();
    ensure!(labels.len() == args.label.len(), "the same label is given twice: {}", args.label.join(", "));
    let size = match args.cell_mm {
        Some(cell_mm) => OrganSize::CellM(1e-3 * cell_mm),
        None => OrganSize::Tetrahedra(args.tetrahedra.unwrap_or(DEFAULT_TETRAHEDRA)),
    };
    let balls = args.finer_ball.iter().map(|&[x, y, z, radius, factor]| FinerBall {
        center_m: 1e-3 * DVec3::new(x, y, z),
        radius_m: 1e-3 * radius,
        factor,
    });
    let grading = Grading {
        least_tetrahedra: args.least_tetrahedra,
        finer_at_surface: args.finer_at_surface,
        balls: balls.collect(),
    };
    let params = OrganMeshParams { labels, size, grading };
    let organs = with_bar("filling", || mesh_organs(&map, &params)).with_context(in_input)?;
    make_folder_of(&args.output)?;
    let label_of: Vec<i32> = organs.label_of.iter().map(|&label| i32::from(label)).collect();
    let field =
        VtuField { name: LABEL_FIELD, place: FieldPlace::Tets, values: FieldValues::Integers(&label_of) };
    write_vtu_with(&args.output, &organs.mesh, &[field])?;
    if let Some(folder) = &args.surfaces {
        write_surfaces(folder, &map, &organs)?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&organs.report)?);
    } else {
        print_report(args, &map, &organs);
    }
    Ok(())
}

/// Name of a label, or its number.
fn name_of(map: &LabelMap, label: u16) -> String {
    map.name_of(label).map_or_else(|| label.to_string(), String::from)
}

fn write_surfaces(folder: &Path, map: &LabelMap, organs: &OrganMesh) -> anyhow::Result<()> {
    for label in organs.labels() {
        // A name may hold what a file name must not.
        let name: String = name_of(map, label)
            .chars()
            .map(|c| if c.is_alphanumeric() || "-_".contains(c) { c } else { '_' })
            .collect();
        let path = folder.join(format!("{label}_{name}.stl"));
        make_folder_of(&path)?;
        write_surface(&path, &organs.surface_of(label).surface)?;
    }
    Ok(())
}

fn print_report(args: &Args, map: &LabelMap, organs: &OrganMesh) {
    let report = &organs.report;
    println!(
        "tetrahedra   {} with {} nodes, cells of {:.2} mm",
        report.n_tets,
        report.n_nodes,
        1e3 * report.cell_m
    );
    for organ in &report.labels {
        println!(
            "organ        {}: {} tetrahedra, {:.2} ml, voxels {:.2} ml ({:+.2} %), {} piece(s)",
            name_of(map, organ.label),
            organ.n_tets,
            1e6 * organ.volume_m3,
            1e6 * organ.voxel_volume_m3,
            100.0 * organ.volume_error(),
            organ.n_pieces
        );
    }
    for [a, b] in organs.neighbours().into_iter().filter(|pair| pair[0] != 0) {
        let n = organs.n_faces_between(a, b);
        println!("interface    {} and {}: {n} triangles", name_of(map, a), name_of(map, b));
    }
    println!("dihedral     {:.2} to {:.2} degrees", report.min_dihedral_deg, report.max_dihedral_deg);
    println!(
        "borders      {:.3} mm from the labels' smooth ones (root mean square), {:.2} mm at most",
        1e3 * report.interface_rms_m,
        1e3 * report.interface_max_m
    );
    println!("written      {}", args.output.display());
}
