//! How well a mesh of several organs met what was wanted.

use super::complex::{Complex, n_regions};
use super::field::{ShareField, Shares};
use super::interface_faces::InterfaceFace;
use super::labelling::Labelling;
use super::levels::Levels;
use super::regions::RegionGrid;
use crate::math::DVec3;
use crate::mesh::quality::dihedral_cosine_range;
use crate::mesh::{TetId, TetMesh};
use rayon::prelude::*;

/// One organ of the mesh.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LabelReport {
    /// Its label.
    pub label: u16,
    /// Its tetrahedra.
    pub n_tets: usize,
    /// Their volume [m3].
    pub volume_m3: f64,
    /// Volume of its voxels [m3].
    pub voxel_volume_m3: f64,
    /// Its lattice nodes: inner nodes of the organ. The volume is met within 1.5 % for an organ most of which is at least
    /// two cells thick.
    pub n_lattice_nodes: usize,
    /// By how much its share was raised against those of its neighbours to meet the volume, -0.5 to 0.5. At an end of that
    /// range the organ is too thin for the cells.
    pub level: f64,
    /// Pieces connected by faces. More than the organ has: its thin parts fell between the lattice's nodes.
    pub n_pieces: usize,
}

impl LabelReport {
    /// Relative difference of the tetrahedra's volume from the voxels'.
    pub fn volume_error(&self) -> f64 {
        self.volume_m3 / self.voxel_volume_m3 - 1.0
    }
}

/// What was made, and how.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct OrganMeshReport {
    /// Each organ, by ascending label.
    pub labels: Vec<LabelReport>,
    /// Lattice cell [m].
    pub cell_m: f64,
    /// Nodes.
    pub n_nodes: usize,
    /// Tetrahedra.
    pub n_tets: usize,
    /// Smallest dihedral angle [degrees].
    pub min_dihedral_deg: f64,
    /// Largest dihedral angle [degrees].
    pub max_dihedral_deg: f64,
    /// Root mean square distance of the interfaces' nodes and face centres from the smooth borders of the label map [m].
    pub interface_rms_m: f64,
    /// Largest such distance [m].
    pub interface_max_m: f64,
    /// Lattice nodes of crumbs, pieces of fewer than four nodes, that were given to what is around them.
    pub n_crumb_nodes: usize,
    /// Sweeps over the nodes.
    pub n_sweeps: usize,
}

impl OrganMeshReport {
    /// Counts, angles and distances; the rest empty.
    pub(super) fn of_shape(mesh: &TetMesh, [interface_rms_m, interface_max_m]: [f64; 2]) -> Self {
        let angles =
            (0..mesh.tetrahedra.len()).map(|t| dihedral_cosine_range(mesh.corners_m(TetId::from_index(t))));
        let [low, high] = angles.fold([1.0f64, -1.0f64], |[low, high], [l, h]| [low.min(l), high.max(h)]);
        Self {
            n_nodes: mesh.positions_m.len(),
            n_tets: mesh.tetrahedra.len(),
            min_dihedral_deg: libm::acos(high).to_degrees(),
            max_dihedral_deg: libm::acos(low).to_degrees(),
            interface_rms_m,
            interface_max_m,
            ..Self::default()
        }
    }
}

/// What became of each organ.
pub(super) fn label_reports(
    complex: &Complex,
    regions: &RegionGrid,
    labelling: &Labelling,
    levels: &Levels,
) -> Vec<LabelReport> {
    let n_regions = regions.n_regions();
    let volumes_m3 = complex.volumes_m3(n_regions);
    let n_lattice_nodes = labelling.n_nodes_of_regions(n_regions);
    let n_pieces = labelling.n_pieces_of_regions(n_regions);
    let mut n_tets = vec![0; n_regions + 1];
    for &region in &complex.tet_regions {
        n_tets[usize::from(region)] += 1;
    }
    let described = (1u16..).zip(regions.volumes_m3()).map(|(region, voxel_volume_m3)| {
        let at = usize::from(region);
        LabelReport {
            label: regions.label(region),
            n_tets: n_tets[at],
            volume_m3: volumes_m3[at],
            voxel_volume_m3,
            n_lattice_nodes: n_lattice_nodes[at],
            level: levels.of_regions()[at],
            n_pieces: n_pieces[at],
        }
    });
    described.collect()
}

/// Slopes below this part of a flat border's are no border's: distances are taken with this one there.
const LEAST_SLOPE: f64 = 0.3;

/// Root mean square and largest distance [m] of the nodes and face centres of interfaces from the places where the
/// (unlevelled) shares make their regions equal.
pub(super) fn interface_distance_m(
    complex: &Complex,
    faces: &[InterfaceFace],
    field: &ShareField<'_>,
) -> [f64; 2] {
    let centres = faces.iter().map(|face| {
        let [a, b, c] = face.corners_m(complex);
        ((a + b + c) / 3.0, face.regions)
    });
    let nodes = complex.positions_m.iter().zip(&complex.node_regions);
    let on_two = nodes.filter(|(_, regions)| n_regions(regions) == 2);
    let places: Vec<(DVec3, [u16; 2])> =
        centres.chain(on_two.map(|(&p, regions)| (p, [regions[0], regions[1]]))).collect();
    let distance_m = |shares: &mut Shares, &(position_m, regions): &(DVec3, [u16; 2])| {
        field.sample_into(position_m, shares);
        let [a, b] = regions.map(usize::from);
        let (psi, gradient) = shares.lead(a, b);
        (psi / gradient.length().max(LEAST_SLOPE * shares.flat_slope)).abs()
    };
    let distances_m: Vec<f64> =
        places.par_iter().with_min_len(64).map_init(|| field.shares(), distance_m).collect();
    let sum_m2: f64 = distances_m.iter().map(|d| d * d).sum();
    let n = distances_m.len() as f64;
    let largest_m = distances_m.iter().copied().fold(0.0, f64::max);
    [if n > 0.0 { (sum_m2 / n).sqrt() } else { 0.0 }, largest_m]
}
