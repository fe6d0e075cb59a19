//! The synthetic patient's liver on its bed: a scene of several bodies, for the experiments and the demo.
//!
//! The patient lies on the back. The bed is what lies behind the liver in the image, a centimetre and a half deep, as one rigid
//! body; right kidney, spine and stomach are rigid bodies of their own.

use anyhow::Context;
use glisson::image::VoxelGrid;
use glisson::image::labels::{Parts, mask_volume_m3};
use glisson::image::phantom::{PhantomParams, generate as generate_phantom};
use glisson::math::{Aabb, DVec3};
use glisson::mesh::files::write_mesh;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use glisson::surface::files::write_surface;
use std::path::{Path, PathBuf};

/// Thickness of the bed [m]: a choice.
const THICKNESS_M: f64 = 0.015;
/// Share of the bed's voxels that the repair of its topology may change: it is cut out of columns of voxels.
const LARGEST_REPAIR: f64 = 0.3;
/// Edge of the rigid bodies' triangles [mm]: a choice, about that of the liver's.
const EDGE_MM: f64 = 9.0;
/// How far surfaces may be apart or in each other where they touch in the image [mm]: half an edge and a little, as the liver's
/// and the bed's triangles fit each other no better where the liver is hollow (4.2 mm with 6,300 tetrahedra).
const TOUCH_MM: f64 = 5.0;
/// What else is shown, with its colour.
const NEIGHBOURS: [(&str, &str); 3] =
    [("kidney_right", "#8a4a3c"), ("spine", "#d8d0bc"), ("stomach", "#c99a86")];

/// Voxels behind those of `mask` and not among them, as far as the bed is thick.
fn behind(grid: &VoxelGrid, mask: &[bool]) -> Vec<bool> {
    let along: Vec<f64> = (0..3).map(|axis| grid.axes.col(axis).y).collect();
    let axis = (0..3).max_by(|&a, &b| along[a].abs().total_cmp(&along[b].abs())).unwrap_or(1);
    let stride = [1, grid.dims[0], grid.dims[0] * grid.dims[1]][axis];
    let n_deep = (THICKNESS_M / grid.spacing_m[axis]).round() as usize;
    let mut bed = vec![false; mask.len()];
    for voxel in (0..mask.len()).filter(|&voxel| mask[voxel]) {
        let at = voxel / stride % grid.dims[axis];
        let room = if along[axis] > 0.0 { grid.dims[axis] - 1 - at } else { at };
        for step in 1..=n_deep.min(room) {
            let there = if along[axis] > 0.0 { voxel + step * stride } else { voxel - step * stride };
            bed[there] |= !mask[there];
        }
    }
    bed
}

/// Writes meshes and scene into `folder`; answers with the scene's file.
///
/// # Errors
/// When a surface cannot be made or a file not be written.
pub fn write_liver_on_bed(folder: &Path, n_tets: usize) -> anyhow::Result<PathBuf> {
    let phantom = generate_phantom(&PhantomParams::default());
    let grid = &phantom.labels.grid;
    let liver = phantom.labels.mask(&phantom.labels.select("liver", Parts::Included)?);
    let (surface, _) = surface_of_mask(grid, &liver, &SurfaceParams::default())?;
    let size =
        MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: Some(mask_volume_m3(grid, &liver)) };
    let mesh = generate(&surface, &size)?.0;
    write_mesh(&folder.join("liver.vtu"), &mesh)?;
    let params =
        SurfaceParams { cap_at_border: true, largest_repair: LARGEST_REPAIR, ..SurfaceParams::default() };
    let (bed, _) = surface_of_mask(grid, &behind(grid, &liver), &params).context("the bed")?;
    write_surface(&folder.join("bed.stl"), &bed)?;
    let mut rigid = String::new();
    for (name, color) in NEIGHBOURS {
        let mask = phantom.labels.mask(&phantom.labels.select(name, Parts::Included)?);
        let (surface, _) = surface_of_mask(grid, &mask, &params).context(name)?;
        let file = format!("{name}.stl");
        write_surface(&folder.join(&file), &surface)?;
        rigid += &format!(
            "[[rigid]]\nname = \"{}\"\ncolor = \"{color}\"\nmesh = \"{file}\"\nedge = \"{EDGE_MM} mm\"\n\n",
            name.replace('_', " ")
        );
    }
    let bounds = Aabb::of_points(&mesh.positions_m);
    let above_m = DVec3::new(
        0.5 * (bounds.min_m.x + bounds.max_m.x),
        bounds.min_m.y - 0.06,
        0.5 * (bounds.min_m.z + bounds.max_m.z),
    );
    let [x, y, z] = (above_m * 1e3).to_array();
    let text = format!(
        "# Written by Glisson. The patient lies on the back: gravity points to +y. Positions are in the patient frame (LPS).\n\
         glisson_scene = 1\nname = \"A synthetic patient's liver on its bed\"\n\n\
         [simulation]\ntime_step = \"10 ms\"\ngravity = [0, \"9.81 m/s2\", 0]\n\n\
         # Nothing is fixed: the bed carries it in the imaged shape, and holds it by friction.\n\
         [[organ]]\nname = \"liver\"\nmesh = \"liver.vtu\"\ntissue = \"liver\"\nmodel = \"implicit\"\nlaw = \"stable_neo_hooke\"\n\
         damping = \"20 1/s\"\n\n\
         [[rigid]]\nname = \"bed\"\ncolor = \"#b98d77\"\nmesh = \"bed.stl\"\nedge = \"{EDGE_MM} mm\"\n\n{rigid}\
         [contact]\nmargin = \"5 mm\"\ntouch = \"{TOUCH_MM} mm\"\n\n\
         [tool]\nname = \"palpation probe\"\ntip_radius = \"6 mm\"\nfriction = 0.1\n\
         home_tip = [\"{x:.3} mm\", \"{y:.3} mm\", \"{z:.3} mm\"]\nhome_shaft = [-0.2, -1, 0.3]\n"
    );
    let scene = folder.join("liver_on_bed.toml");
    std::fs::write(&scene, text).with_context(|| scene.display().to_string())?;
    Ok(scene)
}
