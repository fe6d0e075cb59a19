//! Cutting the pre-computed liver: one tetrahedron after the other along a plane.

use std::hint::black_box;

use fearless_simd::Level;
use glisson::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use glisson::mesh::{TetId, TetMesh};
use glisson::model::DeformableModel;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};

use super::body::StandardBody;
use super::{Case, Prepared, Settings, isa_name};

pub(super) const CASES: &[Case] = &[Case {
    name: "precomputed_cut",
    about: "the pre-computed model follows the removal of one tetrahedron, a hundred in a row along a plane",
    per: "removal",
    sizes: &[2_000, 6_300],
    parallel: false,
    prepare: precomputed_cut,
}];

/// Removals before it starts anew.
const N_REMOVALS: usize = 100;

fn precomputed_cut(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut whole = Precomputed::build(&PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.fixed_nodes,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })?;
    whole.prepare_cutting(&body.mesh)?;
    let changes = along_a_plane(&body.mesh, N_REMOVALS)?;
    let n_rows = whole.stored_nodes().len();
    let mut model = whole.clone();
    let mut next = 0;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: isa_name(Level::new()),
        precision: "f64",
        work: None,
        note: format!("{n_rows} surface nodes, history of up to {N_REMOVALS} removals"),
        run: Box::new(move || {
            if next == changes.len() {
                // One sample in a hundred also copies the model.
                model = whole.clone();
                next = 0;
            }
            let followed = model.topology_changed(&body.mesh, black_box(&changes[next]));
            followed.expect("the model follows removals");
            next += 1;
        }),
    })
}

/// What removing the tetrahedra along the plane x = 0 does, one by one from the top.
fn along_a_plane(mesh: &TetMesh, n: usize) -> anyhow::Result<Vec<TopologyChange>> {
    let corners = |t: &TetId| mesh.corners_m(*t);
    let height = |t: &TetId| corners(t).iter().map(|p| p.z).sum::<f64>();
    let mut tets: Vec<TetId> = (0..mesh.tetrahedra.len())
        .map(TetId::from_index)
        .filter(|t| corners(t).iter().any(|p| p.x < 0.0) && corners(t).iter().any(|p| p.x >= 0.0))
        .collect();
    tets.sort_by(|a, b| height(b).total_cmp(&height(a)));
    tets.truncate(n);
    let mut cut = EditableMesh::new(mesh.clone())?;
    tets.into_iter().map(|tet| Ok(cut.apply(&MeshEdit::Remove { tets: vec![tet] })?)).collect()
}
