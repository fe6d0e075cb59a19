//! What it costs models to follow edits of the mesh, with what it takes to take them back.

use std::hint::black_box;

use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use glisson::mesh::{EdgeId, NodeId, TetId};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{DeformableModel, DynamicBody, ModelUndo};

use super::body::StandardBody;
use super::{Case, Prepared, Settings};

const STEP_S: f64 = 1e-5;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "save_and_remove_explicit",
        about: "the fast explicit model notes what the removal of one tetrahedron overwrites, and follows it",
        per: "edit",
        sizes: &[6_300],
        parallel: false,
        prepare: |settings| removals(settings, explicit),
    },
    Case {
        name: "save_and_remove_tensor_mass",
        about: "the tensor-mass model notes what the removal of one tetrahedron overwrites, and follows it",
        per: "edit",
        sizes: &[6_300],
        parallel: false,
        prepare: |settings| removals(settings, tensor_mass),
    },
    Case {
        name: "split_and_undo_explicit",
        about: "the fast explicit model follows a split of four edges, and takes it back",
        per: "edit",
        sizes: &[6_300],
        parallel: false,
        prepare: |settings| splits(settings, explicit),
    },
    Case {
        name: "split_and_undo_tensor_mass",
        about: "the tensor-mass model follows a split of four edges, and takes it back by a copy",
        per: "edit",
        sizes: &[6_300],
        parallel: false,
        prepare: |settings| splits(settings, tensor_mass),
    },
];

type Build = fn(&StandardBody) -> anyhow::Result<Box<dyn DeformableModel>>;

fn dynamic_body(body: &StandardBody) -> DynamicBody<'_> {
    DynamicBody { time_step_s: STEP_S, ..DynamicBody::new(&body.mesh, body.material.density_kg_per_m3()) }
}

fn explicit(body: &StandardBody) -> anyhow::Result<Box<dyn DeformableModel>> {
    let materials = std::slice::from_ref(&body.material);
    let params = ExplicitKernelParams::new(dynamic_body(body), KernelLaw::StVenantKirchhoff, materials);
    Ok(Box::new(ExplicitKernel::build(&params)?))
}

fn tensor_mass(body: &StandardBody) -> anyhow::Result<Box<dyn DeformableModel>> {
    let params = TensorMassParams { body: dynamic_body(body), material: &body.material };
    Ok(Box::new(TensorMass::build(&params)?))
}

fn prepared(size: usize, note: String, run: Box<dyn FnMut() + Send>) -> Prepared {
    Prepared { size, isa: "portable", precision: "f64", work: None, note, run }
}

/// One removal after the other; then a whole body comes in, which one call in some thousand pays for.
fn removals(settings: Settings, build: Build) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let n_tets = body.mesh.tetrahedra.len();
    let mut mesh = EditableMesh::new(body.mesh.clone())?;
    let mut random = SeededRandom::new(1);
    let mut changes = Vec::new();
    while changes.len() < n_tets / 3 {
        let tet = TetId((random.next_u64() % n_tets as u64) as u32);
        if mesh.topology().is_live_tet(tet) {
            changes.push(mesh.apply(&MeshEdit::Remove { tets: vec![tet] })?);
        }
    }
    let whole = build(&body)?;
    let (mut model, mut next) = (whole.duplicate(), 0);
    let mut undo = ModelUndo::default();
    let note = format!("{} nodes", body.mesh.positions_m.len());
    Ok(prepared(
        n_tets,
        note,
        Box::new(move || {
            if next == changes.len() {
                (model, next) = (whole.duplicate(), 0);
            }
            model.save_for_undo(&changes[next], &mut undo);
            model.topology_changed(mesh.mesh(), &changes[next]).expect("the model follows removals");
            next += 1;
            black_box((&undo, &model));
        }),
    ))
}

/// The same split in the middle of the body, there and back.
fn splits(settings: Settings, build: Build) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut mesh = EditableMesh::new(body.mesh.clone())?;
    let places_m = &body.mesh.positions_m;
    let middle_m = places_m.iter().sum::<DVec3>() / places_m.len() as f64;
    let off_m = |edge: &EdgeId| {
        let of_end = |n: NodeId| places_m[n.index()].distance(middle_m);
        mesh.topology().edge_nodes(*edge).map(of_end).iter().sum::<f64>()
    };
    let mut edges: Vec<EdgeId> = mesh.topology().live_edges().collect();
    edges.sort_by(|a, b| off_m(a).total_cmp(&off_m(b)));
    let edges = edges[..4].iter().map(|&edge| EdgeSplit { edge, fraction: 0.5 }).collect();
    let (mut change, mut mesh_undo) = (TopologyChange::default(), MeshUndo::default());
    mesh.apply_saving(&MeshEdit::Split { edges }, &mut change, &mut mesh_undo)?;
    let mut model = build(&body)?;
    let mut undo = ModelUndo::default();
    let note = format!("{} tetrahedra go, {} come", change.tets.removed.len(), change.tets.added.ids().len());
    Ok(prepared(
        body.mesh.tetrahedra.len(),
        note,
        Box::new(move || {
            model.save_for_undo(&change, &mut undo);
            model.topology_changed(mesh.mesh(), &change).expect("the model follows splits");
            undo.put_back(&mut model);
            black_box(&model);
        }),
    ))
}
