//! The demo's files and its scene: where the liver is held, and where the probe pushes.

use crate::text_file::write_text;
use anyhow::Context;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::files::read_mesh;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::surface::TriMesh;
use glisson::surface::normals::{NormalWeight, vertex_normals};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Where everything that the demo makes lies.
pub(crate) struct Files {
    pub(crate) folder: PathBuf,
    pub(crate) ct: PathBuf,
    pub(crate) labels: PathBuf,
    pub(crate) liver_label: PathBuf,
    pub(crate) surface: PathBuf,
    pub(crate) mesh: PathBuf,
    pub(crate) quality_plot: PathBuf,
    pub(crate) scene: PathBuf,
    pub(crate) precomputed: PathBuf,
    pub(crate) session: PathBuf,
    pub(crate) force_csv: PathBuf,
    pub(crate) force_plot: PathBuf,
    pub(crate) report_md: PathBuf,
    pub(crate) report_json: PathBuf,
}

impl Files {
    pub(crate) fn in_folder(folder: &Path) -> Self {
        let at = |name: &str| folder.join(name);
        Self {
            folder: folder.to_path_buf(),
            ct: at("ct.nii.gz"),
            labels: at("labels.nii.gz"),
            liver_label: at("liver_label.nii.gz"),
            surface: at("liver.stl"),
            mesh: at("liver.vtu"),
            quality_plot: at("quality.svg"),
            scene: at("scene.toml"),
            precomputed: at("liver.precomputed"),
            session: at("session.jsonl"),
            force_csv: at("force.csv"),
            force_plot: at("force_time.svg"),
            report_md: at("report.md"),
            report_json: at("report.json"),
        }
    }
}

/// Share of the liver's nodes that the diaphragm and the vessels behind hold.
const HELD_FRACTION: f64 = 0.1;
/// Backwards and upwards: where the bare area and the inferior vena cava are.
const HELD_DIRECTION: [f64; 3] = [0.0, 1.0, 0.4];
const TIP_RADIUS_M: f64 = 6e-3;
/// How far the probe stands off before it pushes [m].
const STAND_OFF_M: f64 = 0.03;
/// How deep it pushes [m].
const PUSH_DEPTH_M: f64 = 0.015;
/// Where it pushes, as shares of the liver's width (from the patient's right) and height (from below), in
/// order: right lobe, left lobe.
const PLACES: [[f64; 2]; 2] = [[0.3, 0.5], [0.68, 0.55]];
/// Radius around a place in which the foremost vertex is taken [m].
const PLACE_RADIUS_M: f64 = 0.015;

/// A place to push: the surface's point and outward normal.
struct Place {
    point_m: DVec3,
    normal: DVec3,
}

fn place(surface: &TriMesh, normals: &[DVec3], share: [f64; 2]) -> anyhow::Result<Place> {
    let bounds = Aabb::of_points(&surface.positions_m);
    let size = bounds.size_m();
    let column = DVec3::new(bounds.min_m.x + share[0] * size.x, 0.0, bounds.min_m.z + share[1] * size.z);
    let in_column = |p: &DVec3| DVec3::new(p.x, 0.0, p.z).distance(column) <= PLACE_RADIUS_M;
    let (index, point_m) = surface
        .positions_m
        .iter()
        .enumerate()
        .filter(|(_, p)| in_column(p))
        .min_by(|a, b| a.1.y.total_cmp(&b.1.y).then(a.0.cmp(&b.0)))
        .context("the liver has no surface where the demo wants to push")?;
    Ok(Place { point_m: *point_m, normal: normals[index] })
}

fn quoted_mm(point_m: DVec3) -> String {
    let [x, y, z] = (point_m * 1e3).to_array();
    format!("[\"{x:.3} mm\", \"{y:.3} mm\", \"{z:.3} mm\"]")
}

/// Reads the mesh and writes a scene in which its liver is held behind and palpated in front.
pub(crate) fn write_scene(files: &Files) -> anyhow::Result<()> {
    let (mesh, _) = read_mesh(&files.mesh)?;
    let (surface, _) = surface_of(&Topology::build(&mesh)?, &mesh);
    let normals = vertex_normals(&surface, NormalWeight::Area);
    let name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let first = place(&surface, &normals, PLACES[0])?;
    let home_m = first.point_m + first.normal * 2.0 * STAND_OFF_M;
    let mut text = format!(
        "# Written by `glisson demo`. Every quantity names its unit; positions are in the patient frame (LPS).\n\
         glisson_scene = 1\nname = \"Palpation of a synthetic patient's liver\"\n\n\
         # Short enough for tensor_mass and st_venant_kirchhoff too; the pre-computed model takes any step.\n\
         [simulation]\ntime_step = \"0.4 ms\"\n\n\
         [organ]\nmesh = \"{}\"\ntissue = \"liver\"\nmodel = \"precomputed\"\nprecomputed = \"{}\"\n\
         damping = \"20 1/s\"\n\n\
         # Held where the diaphragm and the great vessels hold a liver: behind and above.\n\
         [[organ.fixed]]\nfurthest = {{ direction = {HELD_DIRECTION:?}, fraction = {HELD_FRACTION} }}\n\n\
         [tool]\nname = \"palpation probe\"\ntip_radius = \"{} mm\"\nhome_tip = {}\nhome_shaft = [-0.2, -1, 0.5]\n",
        name(&files.mesh),
        name(&files.precomputed),
        TIP_RADIUS_M * 1e3,
        quoted_mm(home_m),
    );
    let mut time_s = 0.0;
    for share in PLACES {
        let place = place(&surface, &normals, share)?;
        let at = |distance_m: f64| place.point_m + place.normal * (TIP_RADIUS_M + distance_m);
        // Approach, push, hold, withdraw.
        for (lasts_s, distance_m) in
            [(0.4, STAND_OFF_M), (0.5, -PUSH_DEPTH_M), (0.3, -PUSH_DEPTH_M), (0.4, STAND_OFF_M)]
        {
            time_s += lasts_s;
            let tip = quoted_mm(at(distance_m));
            write!(text, "\n[[tool.path]]\ntime = \"{time_s:.2} s\"\ntip = {tip}\n")?;
        }
    }
    write_text(&files.scene, &text)
}
