//! Cases of the pre-computed model at work: other nodes in every call, spread over the whole surface.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::sync::{Arc, Mutex, PoisonError};

use glam::DVec3;
use glisson::math::SeededRandom;
use glisson::mesh::NodeId;
use glisson::model::kernel::KernelPath;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, LocalModel, LocalWork,
    NodalForce,
};

use super::body::StandardBody;
use super::{Case, Prepared, Settings, Work};

/// The cases of a whole response: forces solved, all surface positions written.
pub(super) const RESPONSES: &[&str] = &[
    "force_1",
    "displacements_1",
    "displacements_5",
    "displacements_10",
    "displacements_20",
    "force_1_f32",
    "displacements_1_f32",
    "displacements_5_f32",
    "displacements_10_f32",
    "displacements_20_f32",
];

macro_rules! case {
    ($name:literal, $about:literal, $prepare:expr) => {
        Case {
            name: $name,
            about: $about,
            per: "response",
            sizes: &[6_300],
            parallel: false,
            prepare: $prepare,
        }
    };
}

pub(super) const CASES: &[Case] = &[
    case!("force_1", "pre-computed: the surface under a force on one node", |s| response(
        s,
        0,
        Precision::F64
    )),
    case!("displacements_1", "pre-computed: the surface with one node held at a displacement", |s| {
        response(s, 1, Precision::F64)
    }),
    case!("displacements_5", "pre-computed: the surface with 5 nodes held at displacements", |s| {
        response(s, 5, Precision::F64)
    }),
    case!("displacements_10", "pre-computed: the surface with 10 nodes held at displacements", |s| {
        response(s, 10, Precision::F64)
    }),
    case!("displacements_20", "pre-computed: the surface with 20 nodes held at displacements", |s| {
        response(s, 20, Precision::F64)
    }),
    case!("force_1_f32", "force_1 with the compliance stored in f32", |s| response(s, 0, Precision::F32)),
    case!("displacements_1_f32", "displacements_1 with the compliance stored in f32", |s| {
        response(s, 1, Precision::F32)
    }),
    case!("displacements_5_f32", "displacements_5 with the compliance stored in f32", |s| {
        response(s, 5, Precision::F32)
    }),
    case!("displacements_10_f32", "displacements_10 with the compliance stored in f32", |s| {
        response(s, 10, Precision::F32)
    }),
    case!("displacements_20_f32", "displacements_20 with the compliance stored in f32", |s| {
        response(s, 20, Precision::F32)
    }),
    case!("haptic_force", "pre-computed: reaction forces alone of 20 other nodes in every call", |s| {
        haptic_force(s, 20)
    }),
    case!(
        "haptic_force_update",
        "pre-computed: reaction forces of 20 nodes, one of them another in every call",
        |s| { haptic_force(s, 1) }
    ),
    case!("local_model_3", "tensor-mass: the compliance of 3 touched nodes over a millisecond", |s| {
        local_model(s, 3)
    }),
    case!("local_model_20", "tensor-mass: the compliance of 20 touched nodes over a millisecond", |s| {
        local_model(s, 20)
    }),
];

/// Contact nodes of the haptic cases.
const N_CONTACTS: usize = 20;
/// Sets of nodes, after which they come again: together they touch every column many times.
const N_SETS: usize = 1_000;
/// Largest displacement that is imposed [m], and force [N].
const DEPTH_M: f64 = 0.005;
const FORCE_N: f64 = 0.1;
/// Period of a haptic loop [s].
const PERIOD_S: f64 = 1e-3;

fn built(size: usize, precision: Precision) -> anyhow::Result<(Precomputed, usize)> {
    type Made = Mutex<BTreeMap<(usize, usize), Arc<(Precomputed, usize)>>>;
    static MADE: Made = Mutex::new(BTreeMap::new());
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    let key = (size, precision.bytes());
    if let Some(model) = made.get(&key) {
        return Ok((**model).clone());
    }
    let body = StandardBody::shared(size)?;
    let model = Precomputed::build(&PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.fixed_nodes,
        stored: StoredNodes::Surface,
        precision,
        progress: None,
    })?;
    let model = Arc::new((model, body.mesh.tetrahedra.len()));
    made.insert(key, Arc::clone(&model));
    Ok((*model).clone())
}

fn vector(random: &mut SeededRandom, length: f64) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()) * (0.5 * length)
}

/// `n` different nodes in ascending order, any with the same chance.
fn some(random: &mut SeededRandom, nodes: &[NodeId], n: usize) -> Vec<NodeId> {
    let mut all: Vec<(f64, NodeId)> = nodes.iter().map(|&node| (random.normal(), node)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut chosen: Vec<NodeId> = all.into_iter().take(n).map(|(_, node)| node).collect();
    chosen.sort_unstable();
    chosen
}

fn held(random: &mut SeededRandom, nodes: Vec<NodeId>) -> Constraints {
    let displacement = |node| ImposedDisplacement { node, displacement_m: vector(random, DEPTH_M) };
    Constraints { displacements: nodes.into_iter().map(displacement).collect(), forces: vec![] }
}

/// `n_held` nodes at imposed displacements, or a force on one node for none.
fn response(settings: Settings, n_held: usize, precision: Precision) -> anyhow::Result<Prepared> {
    let (mut model, size) = built(settings.size, precision)?;
    let mut random = SeededRandom::new(7);
    let loadable = model.loadable_nodes().to_vec();
    let sets: Vec<Constraints> = (0..N_SETS)
        .map(|_| {
            let nodes = some(&mut random, &loadable, n_held.max(1));
            if n_held > 0 {
                return held(&mut random, nodes);
            }
            let force_n = vector(&mut random, FORCE_N);
            Constraints { displacements: vec![], forces: vec![NodalForce { node: nodes[0], force_n }] }
        })
        .collect();
    let n_rows = model.stored_nodes().len();
    let n_loads = n_held.max(1);
    let rows_3 = 3.0 * (3 * n_held) as f64;
    let column_bytes = precision.bytes() * 9 * n_rows;
    let mut turn = 0;
    Ok(Prepared {
        size,
        isa: KernelPath::fastest().name(),
        precision: if precision == Precision::F64 { "f64" } else { "f32" },
        // Columns read and added up, the factor of the small system (n^3/3) and its solution; positions written.
        work: Some(Work {
            flops: (2 * 9 * n_loads * n_rows) as f64 + rows_3.powi(3) / 27.0 / 3.0,
            bytes: (n_loads * column_bytes + 2 * 24 * n_rows) as f64,
            working_set_bytes: (loadable.len() * column_bytes) as f64,
        }),
        note: format!("{} loadable nodes, any of them; {n_rows} surface nodes follow", loadable.len()),
        run: Box::new(move || {
            turn = (turn + 1) % N_SETS;
            model.apply(black_box(&sets[turn]));
            model.step(0.01);
            black_box((model.state().positions_m, model.constraint_forces_n()));
        }),
    })
}

/// Reactions of [`N_CONTACTS`] nodes, of which `n_new` are others in every call.
fn haptic_force(settings: Settings, n_new: usize) -> anyhow::Result<Prepared> {
    let (mut model, size) = built(settings.size, Precision::F64)?;
    let mut random = SeededRandom::new(8);
    let loadable = model.loadable_nodes().to_vec();
    let mut nodes = some(&mut random, &loadable, N_CONTACTS);
    let sets: Vec<Constraints> = (0..N_SETS)
        .map(|i| {
            if n_new == N_CONTACTS {
                nodes = some(&mut random, &loadable, N_CONTACTS);
            } else {
                let others: Vec<NodeId> =
                    loadable.iter().copied().filter(|node| !nodes.contains(node)).collect();
                nodes[i % N_CONTACTS] = some(&mut random, &others, 1)[0];
                nodes.sort_unstable();
            }
            held(&mut random, nodes.clone())
        })
        .collect();
    let mut turn = 0;
    Ok(Prepared {
        size,
        isa: KernelPath::fastest().name(),
        precision: "f64",
        work: None,
        note: format!("{N_CONTACTS} contact nodes of {}", loadable.len()),
        run: Box::new(move || {
            turn = (turn + 1) % N_SETS;
            model.apply(black_box(&sets[turn]));
            black_box(model.update_reactions());
        }),
    })
}

/// The compliance of the `n` nodes nearest to the highest one, for a haptic loop, of a body at rest.
fn local_model(settings: Settings, n: usize) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let fixed: Vec<FixedNode> = body.fixed_nodes.iter().map(|&node| FixedNode::all_axes(node)).collect();
    let stable = TensorMass::stable_step(&body.mesh, &body.material)?;
    let mut model = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &fixed,
            time_step_s: 0.9 * stable.step_s,
            ..DynamicBody::new(&body.mesh, body.material.density_kg_per_m3())
        },
        material: &body.material,
    })?;
    let at = |node: &NodeId| body.mesh.positions_m[node.index()];
    let mut nodes: Vec<NodeId> = (0..body.mesh.positions_m.len()).map(NodeId::from_index).collect();
    nodes.sort_by(|a, b| at(b).z.total_cmp(&at(a).z));
    let top_m = at(&nodes[0]);
    nodes.sort_by(|a, b| at(a).distance(top_m).total_cmp(&at(b).distance(top_m)));
    nodes.truncate(n);
    let mut work = LocalWork::with_room_for(body.mesh.positions_m.len());
    let mut out = LocalModel::new();
    model.local_model_into(&nodes, PERIOD_S, &mut work, &mut out);
    let note = format!("{n} nodes, {} rings", out.n_rings.unwrap_or(0));
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: KernelPath::fastest().name(),
        precision: "f64",
        work: None,
        note,
        run: Box::new(move || {
            model.local_model_into(black_box(&nodes), PERIOD_S, &mut work, &mut out);
            black_box(&out);
        }),
    })
}
