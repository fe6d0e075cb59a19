//! Several organs at once: a label map filled with one conforming mesh of tetrahedra, a label on each.
//!
//! An organ with its vessels and tumours, or two organs that touch, share the nodes and faces of their interfaces: there is no
//! gap and no overlap, and what is set free at an interface can be cut there. The steps:
//! 1. the labels become smooth shares, which add up to 1 at every place (`field.rs`);
//! 2. a body-centred cubic lattice is laid over all organs, refined where smaller cells are wanted (`bisection.rs`), and each node gets the region with the largest share
//!    (`labelling.rs`);
//! 3. each lattice tetrahedron is cut between its corners of different regions (`stencils.rs`), which makes the border of every
//!    organ, and that of all together, a closed manifold, whatever the labels are; all angles are at least 18 degrees then, but
//!    the interfaces are jagged;
//! 4. the nodes on interfaces move to the borders, where shares are equal, while the angles stay above a bound (`fit.rs`);
//!    levels between the shares make the volumes right (`levels.rs`).
//!
//! The idea of cutting a lattice between materials along smooth indicator functions is that of lattice cleaving (Bronson, Levine and
//! Whitaker, Lattice Cleaving: A Multimaterial Tetrahedral Meshing Algorithm with Guarantees, IEEE Transactions on Visualization
//! and Computer Graphics 20(2), 2014, doi 10.1109/TVCG.2013.115). We differ: cuts begin in the middle, where the angles are best,
//! and move by optimisation with a guard, instead of being put on the border at once and snapped where that makes angles bad. So
//! the angle bound here is kept for every input, and where both cannot be had, the border gives way.
//!
//! Tetrahedra at borders are about half as long as those within organs.

mod params;
mod error;
mod regions;
mod cell_size;
mod bisection;
mod background;
mod field;
mod complex;
mod stencils;
mod levels;
mod labelling;
mod sizing;
mod label_faces;
mod interface_faces;
mod shape;
mod fit;
mod report;
mod organ_mesh;

pub use error::OrganMeshError;
pub use organ_mesh::{OrganMesh, OrganSurface};
pub use params::{
    FinerBall, Grading, MAX_FINER, MAX_ORGAN_TETRAHEDRA, MIN_ORGAN_TETRAHEDRA, OrganMeshParams, OrganSize,
};
pub use report::{LabelReport, OrganMeshReport};

use self::cell_size::{CellSize, FinePlaces};
use self::complex::Complex;
use self::field::ShareField;
use self::fit::Fit;
use self::interface_faces::interface_faces;
use self::levels::Levels;
use self::regions::RegionGrid;
use self::sizing::{SHARE_OF_TRIALS, Sized, sized};
use super::{NodeId, TetMesh};
use crate::image::LabelMap;
use crate::progress::tell;

/// Smallest dihedral angle [degrees] that a mesh of organs has; for cells that are smaller in places see [`GRADED_DIHEDRAL_DEG`].
pub const MIN_ORGAN_DIHEDRAL_DEG: f64 = 11.9;

/// Largest dihedral angle [degrees] that a mesh of organs has; for cells that are smaller in places see [`GRADED_DIHEDRAL_DEG`].
pub const MAX_ORGAN_DIHEDRAL_DEG: f64 = 160.5;

/// Smallest and largest dihedral angle [degrees] that a mesh of organs has whose cells are smaller in places.
pub const GRADED_DIHEDRAL_DEG: [f64; 2] = [10.8, 161.0];

/// Largest relative difference of an organ's volume from that of its voxels, for organs most of which are at least
/// [`RESOLVED_THICKNESS_CELLS`] thick.
pub const ORGAN_VOLUME_TOLERANCE: f64 = 0.015;

/// What is thinner than this many cells may lose or gain volume, and fall into pieces.
pub const RESOLVED_THICKNESS_CELLS: f64 = 2.0;

/// Sweeps over all nodes: the volumes and distances hardly change after ten.
const N_SWEEPS: usize = 12;

/// Sweeps before the volumes are first corrected: the nodes must have come near the borders.
const N_FREE_SWEEPS: usize = 2;

/// Part of the progress that the first steps take.
const PROGRESS_BEFORE_SWEEPS: f64 = SHARE_OF_TRIALS + 0.05;

/// Meshes the organs of `map` together.
///
/// The same bits on every machine and at any number of threads. The time grows linearly with the number of tetrahedra and the
/// number of voxels.
///
/// # Errors
/// [`OrganMeshError`]: labels that are not there or cut off by the border of the map, a size that makes no sense or too many
/// tetrahedra, an organ too thin to get any.
///
/// # Example
/// ```
/// use glisson_mesh::image::phantom::{self, PhantomParams, Tissue};
/// use glisson_mesh::mesh::organs::{Grading, OrganMeshParams, OrganSize, mesh_organs};
///
/// let patient = phantom::generate(&PhantomParams { voxel_m: 4e-3, ..PhantomParams::default() });
/// let labels = vec![Tissue::Liver.label(), Tissue::GallBladder.label()];
/// let params = OrganMeshParams { labels, size: OrganSize::CellM(0.012), grading: Grading::default() };
/// let organs = mesh_organs(&patient.labels, &params)?;
/// assert_eq!(organs.labels(), params.labels);
/// let bed = organs.interface(Tissue::Liver.label(), Tissue::GallBladder.label());
/// assert!(!bed.surface.triangles.is_empty());
/// # Ok::<(), glisson_mesh::mesh::organs::OrganMeshError>(())
/// ```
pub fn mesh_organs(map: &LabelMap, params: &OrganMeshParams) -> Result<OrganMesh, OrganMeshError> {
    let regions = RegionGrid::new(map, &params.labels)?;
    check_grading(&params.grading)?;
    let places = FinePlaces::new(&regions, &params.grading);
    let Sized { cell_m, labelling } = sized(&regions, params.size, &places)?;
    let field = ShareField::new(&regions, CellSize::new(cell_m, &places));
    let complex = stencils::cut(&labelling.lattice, &labelling.regions);
    let faces = interface_faces(&complex);
    tell(PROGRESS_BEFORE_SWEEPS);
    let wanted_m3 = regions.volumes_m3();
    let mut fit = Fit::new(complex, &field, Levels::new(labelling.levels.clone()));
    for sweep in 0..N_SWEEPS {
        if sweep >= N_FREE_SWEEPS {
            fit.correct_levels(&faces, &wanted_m3);
        }
        fit.sweep();
        let done = (sweep + 1) as f64 / N_SWEEPS as f64;
        tell(PROGRESS_BEFORE_SWEEPS + (1.0 - PROGRESS_BEFORE_SWEEPS) * done);
    }
    let (complex, levels) = fit.finish();
    let (mesh, tet_regions) = without_outside(&complex);
    let report = OrganMeshReport {
        labels: report::label_reports(&complex, &regions, &labelling, &levels),
        cell_m,
        n_sweeps: N_SWEEPS,
        n_crumb_nodes: labelling.n_crumb_nodes,
        ..OrganMeshReport::of_shape(&mesh, report::interface_distance_m(&complex, &faces, &field))
    };
    let label_of = tet_regions.into_iter().map(|region| regions.label(region)).collect();
    Ok(OrganMesh::new(mesh, label_of, report))
}

/// Refuses a grading that makes no sense.
fn check_grading(grading: &Grading) -> Result<(), OrganMeshError> {
    let wrong = |what, found: String, allowed| Err(OrganMeshError::BadParameter { what, found, allowed });
    let factors = grading.finer_at_surface.into_iter().chain(grading.balls.iter().map(|ball| ball.factor));
    if let Some(factor) = factors.into_iter().find(|factor| !(1.0..=MAX_FINER).contains(factor)) {
        return wrong("by how much cells are finer", factor.to_string(), format!("1 to {MAX_FINER}"));
    }
    let least = grading.least_tetrahedra;
    if least > MAX_ORGAN_TETRAHEDRA {
        let allowed = format!("0 to {MAX_ORGAN_TETRAHEDRA}");
        return wrong("the least number of tetrahedra of an organ", least.to_string(), allowed);
    }
    let is_ball =
        |ball: &&FinerBall| ball.center_m.is_finite() && ball.radius_m.is_finite() && ball.radius_m >= 0.0;
    if let Some(ball) = grading.balls.iter().find(|ball| !is_ball(ball)) {
        let found = format!("one of radius {} m around {} m", ball.radius_m, ball.center_m);
        return wrong("a ball of finer cells", found, "a finite one".into());
    }
    Ok(())
}

/// The tetrahedra of the regions alone, over their nodes, and the region of each.
fn without_outside(complex: &Complex) -> (TetMesh, Vec<u16>) {
    const UNUSED: NodeId = NodeId(u32::MAX);
    let mut id_of = vec![UNUSED; complex.positions_m.len()];
    let mut mesh = TetMesh::default();
    let mut regions = Vec::new();
    for (nodes, &region) in complex.tets.iter().zip(&complex.tet_regions).filter(|(_, region)| **region != 0)
    {
        for n in nodes.map(|n| n as usize) {
            if id_of[n] == UNUSED {
                id_of[n] = NodeId::from_index(mesh.positions_m.len());
                mesh.positions_m.push(complex.positions_m[n]);
            }
        }
        mesh.tetrahedra.push(nodes.map(|n| id_of[n as usize]));
        regions.push(region);
    }
    (mesh, regions)
}
