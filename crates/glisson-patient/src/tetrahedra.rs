//! The organs filled with tetrahedra.

use anyhow::{Context, ensure};
use glisson::image::LabelMap;
use glisson::image::labels::{mask_volume_m3, sides_at_border};
use glisson::mesh::faults::drop_loose_nodes;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::mesh::organs::{Grading, OrganMesh, OrganMeshParams, OrganSize, mesh_organs};
use glisson::mesh::quality::{MeshQuality, dihedral_cosine_range};
use glisson::mesh::topology::{Through, Topology};
use glisson::mesh::{TetId, TetMesh};
use glisson::progress::part;
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Tetrahedra: least, what is offered, most.
pub(super) const TETRAHEDRA: [usize; 3] = [500, 6_000, 200_000];
/// Tetrahedra that each of several organs gets at least, about: enough to keep the volume of a round tumour. A choice.
const LEAST_OF_EACH: usize = 300;
/// Share of each of its organs that a piece holds at least; smaller ones are crumbs of thin places, and are left out. A choice.
const LEAST_SHARE: f64 = 0.02;

/// Tetrahedra whose smallest dihedral angle is at least this, up to the next step.
pub(super) struct QualityStep {
    pub(super) from_deg: f64,
    pub(super) colour: [u8; 3],
}

/// From what time steps and factors suffer by to what they like. The colours grow in brightness, so that they can be told apart
/// without hues as well.
pub(super) const QUALITY_STEPS: [QualityStep; 6] = [
    QualityStep { from_deg: 0.0, colour: [122, 18, 40] },
    QualityStep { from_deg: 10.0, colour: [178, 72, 30] },
    QualityStep { from_deg: 20.0, colour: [96, 110, 120] },
    QualityStep { from_deg: 30.0, colour: [70, 140, 150] },
    QualityStep { from_deg: 40.0, colour: [110, 185, 150] },
    QualityStep { from_deg: 50.0, colour: [190, 225, 160] },
];

/// The tetrahedra of all organs.
pub(super) struct Meshed {
    pub(super) mesh: TetMesh,
    pub(super) topology: Topology,
    /// The organ of each tetrahedron, from 1.
    pub(super) label_of: Vec<u16>,
    /// Names of the organs, the first that of label 1.
    pub(super) names: Vec<String>,
    /// Smallest dihedral angle of each tetrahedron [degrees].
    pub(super) dihedral_deg: Vec<f64>,
    pub(super) summary: Value,
}

/// Organs that hang together: a body of the scene.
pub(super) struct Body {
    pub(super) mesh: TetMesh,
    pub(super) label_of: Vec<u16>,
    /// The labels that it holds, that of the largest organ first.
    pub(super) labels: Vec<u16>,
}

impl Meshed {
    /// About so many tetrahedra for the organs of `map`, whose labels go from 1 to their number.
    pub(super) fn of(map: &LabelMap, n_tets: usize) -> anyhow::Result<Self> {
        let [least, _, most] = TETRAHEDRA;
        ensure!((least..=most).contains(&n_tets), "found {n_tets} tetrahedra, allowed: {least} to {most}");
        let names: Vec<String> = map.names.iter().map(|(_, name)| name.clone()).collect();
        if let Some(label) = (1..).zip(&names).find(|(label, _)| !map.labels.contains(label)) {
            anyhow::bail!("nothing is left of {}: later organs cover it; remove one of them", label.1);
        }
        match names.len() {
            1 => Self::of_one(map, names, n_tets),
            _ => Self::of_several(map, names, n_tets),
        }
    }

    /// One organ: its smooth surface, stuffed.
    fn of_one(map: &LabelMap, names: Vec<String>, n_tets: usize) -> anyhow::Result<Self> {
        let grid = &map.grid;
        let mask: Vec<bool> = map.labels.iter().map(|&label| label != 0).collect();
        let is_cut_off = !sides_at_border(grid, &mask).is_empty();
        let params = SurfaceParams { cap_at_border: is_cut_off, ..SurfaceParams::default() };
        let (surface, _) =
            part(0.0, 0.5, || surface_of_mask(grid, &mask, &params)).context("the surface of the organ")?;
        let volume_m3 = mask_volume_m3(grid, &mask);
        let params = MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: Some(volume_m3) };
        let (mesh, report) =
            part(0.5, 1.0, || generate(&surface, &params)).context("filling the organ with tetrahedra")?;
        let label_of = vec![1; mesh.tetrahedra.len()];
        let voxels_m3 = vec![volume_m3];
        Self::new(mesh, label_of, names, &voxels_m3, (report.thin_features.len(), 0))
    }

    /// Several: one mesh that shares the faces between them.
    fn of_several(map: &LabelMap, names: Vec<String>, n_tets: usize) -> anyhow::Result<Self> {
        let labels: Vec<u16> = map.names.iter().map(|(label, _)| *label).collect();
        // Not more in all than are asked for.
        let least_tetrahedra = LEAST_OF_EACH.min(n_tets / (2 * labels.len()));
        let params = OrganMeshParams {
            labels,
            size: OrganSize::Tetrahedra(n_tets),
            grading: Grading { least_tetrahedra, ..Grading::default() },
        };
        let OrganMesh { mesh, label_of, report, .. } =
            mesh_organs(map, &params).context("filling the organs with tetrahedra")?;
        let voxels_m3: Vec<f64> = report.labels.iter().map(|organ| organ.voxel_volume_m3).collect();
        let (mesh, label_of, n_crumbs) = without_crumbs(mesh, label_of)?;
        Self::new(mesh, label_of, names, &voxels_m3, (0, n_crumbs))
    }

    fn new(
        mesh: TetMesh,
        label_of: Vec<u16>,
        names: Vec<String>,
        voxels_m3: &[f64],
        (n_thin, n_crumbs): (usize, usize),
    ) -> anyhow::Result<Self> {
        let topology = Topology::build(&mesh)?;
        let quality = MeshQuality::of(&mesh);
        let corners = |t: usize| mesh.corners_m(TetId::from_index(t));
        let dihedral_deg: Vec<f64> = (0..mesh.tetrahedra.len())
            .into_par_iter()
            .map(|t| dihedral_cosine_range(corners(t))[1].acos().to_degrees())
            .collect();
        let volumes_m3 = volumes_by_label(&mesh, &label_of, names.len());
        let organs: Vec<Value> = names
            .iter()
            .enumerate()
            .map(|(at, name)| {
                json!({
                    "name": name,
                    "tetrahedra": label_of.iter().filter(|&&label| usize::from(label) == at + 1).count(),
                    "volume_ml": 1e6 * volumes_m3[at],
                    "volume_error": volumes_m3[at] / voxels_m3[at] - 1.0,
                })
            })
            .collect();
        let mut n_of_quality = [0_usize; QUALITY_STEPS.len()];
        dihedral_deg.iter().for_each(|&angle| n_of_quality[step_of(angle)] += 1);
        let summary = json!({
            "tetrahedra": mesh.tetrahedra.len(),
            "nodes": mesh.positions_m.len(),
            "organs": organs,
            "bodies": topology.pieces(Through::Nodes).count(),
            "dihedral_deg": [quality.min_dihedral_deg, quality.max_dihedral_deg],
            "n_of_quality": n_of_quality,
            "mean_edge_mm": 1e3 * quality.mean_edge_m,
            "thin_places": n_thin,
            "crumbs": n_crumbs,
        });
        Ok(Self { mesh, topology, label_of, names, dihedral_deg, summary })
    }

    /// The bodies, by their lowest tetrahedron.
    pub(super) fn bodies(&self) -> Vec<Body> {
        let pieces = self.topology.pieces(Through::Nodes);
        (0..pieces.count())
            .map(|piece| {
                let (mesh, label_of) =
                    extracted(&self.mesh, &self.label_of, |t| pieces.of_tet[t] as usize == piece);
                let volumes_m3 = volumes_by_label(&mesh, &label_of, self.names.len());
                let volume_of = |label: u16| volumes_m3[usize::from(label) - 1];
                let all = (1..).take(self.names.len());
                let mut labels: Vec<u16> = all.filter(|&label| volume_of(label) > 0.0).collect();
                labels.sort_by(|&a, &b| volume_of(b).total_cmp(&volume_of(a)));
                Body { mesh, label_of, labels }
            })
            .collect()
    }
}

/// The step of [`QUALITY_STEPS`] that an angle belongs to.
pub(super) fn step_of(dihedral_deg: f64) -> usize {
    QUALITY_STEPS.iter().rposition(|step| dihedral_deg >= step.from_deg).unwrap_or(0)
}

/// Volume of each label from 1 on [m3].
fn volumes_by_label(mesh: &TetMesh, label_of: &[u16], n_labels: usize) -> Vec<f64> {
    let mut volumes_m3 = vec![0.0; n_labels];
    for (t, &label) in label_of.iter().enumerate() {
        volumes_m3[usize::from(label) - 1] += mesh.tet_volume_m3(TetId::from_index(t));
    }
    volumes_m3
}

/// The mesh without pieces that hold little of each of their organs, and how many these were.
fn without_crumbs(mesh: TetMesh, label_of: Vec<u16>) -> anyhow::Result<(TetMesh, Vec<u16>, usize)> {
    let pieces = Topology::build(&mesh)?.pieces(Through::Nodes);
    let n_labels = label_of.iter().copied().max().map_or(0, usize::from);
    let of_all = volumes_by_label(&mesh, &label_of, n_labels);
    let mut of_piece = vec![vec![0.0; n_labels]; pieces.count()];
    for (t, (&label, &piece)) in label_of.iter().zip(&pieces.of_tet).enumerate() {
        of_piece[piece as usize][usize::from(label) - 1] += mesh.tet_volume_m3(TetId::from_index(t));
    }
    let mut is_kept: Vec<bool> = of_piece
        .iter()
        .map(|volumes_m3| volumes_m3.iter().zip(&of_all).any(|(here, all)| *here > LEAST_SHARE * all))
        .collect();
    // An organ that is nothing but crumbs keeps the largest.
    for label in 0..n_labels {
        let largest = (0..of_piece.len()).max_by(|&a, &b| of_piece[a][label].total_cmp(&of_piece[b][label]));
        largest.into_iter().for_each(|piece| is_kept[piece] = true);
    }
    let n_crumbs = is_kept.iter().filter(|kept| !**kept).count();
    if n_crumbs == 0 {
        return Ok((mesh, label_of, 0));
    }
    let (mesh, label_of) = extracted(&mesh, &label_of, |t| is_kept[pieces.of_tet[t] as usize]);
    Ok((mesh, label_of, n_crumbs))
}

/// The tetrahedra that are taken, over their nodes, in the same order.
fn extracted(mesh: &TetMesh, label_of: &[u16], is_taken: impl Fn(usize) -> bool) -> (TetMesh, Vec<u16>) {
    let taken = || (0..mesh.tetrahedra.len()).filter(|t| is_taken(*t));
    let mut part = TetMesh {
        positions_m: mesh.positions_m.clone(),
        tetrahedra: taken().map(|t| mesh.tetrahedra[t]).collect(),
        ..TetMesh::default()
    };
    drop_loose_nodes(&mut part);
    (part, taken().map(|t| label_of[t]).collect())
}
