//! Cases of the models that make the pre-computed one non-linear: reduced coordinates, and corrected magnitudes.

use std::hint::black_box;

use anyhow::ensure;
use glam::DVec3;
use glisson::mesh::NodeId;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::quasi_nonlinear::{Correction, QuasiNonlinear, fit_curve};
use glisson::model::reduced::{Reduced, ReducedParams};
use glisson::model::{Constraints, DeformableModel, FixedNode, ImposedDisplacement, NodalForce};

use super::body::StandardBody;
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "reduced_step",
        about: "one equilibrium of the reduced non-linear model, r = 30, a load of 1 N wandering over the top; whole surface",
        per: "step",
        sizes: &[6_300],
        parallel: false,
        prepare: loaded,
    },
    Case {
        name: "reduced_step_displacements",
        about: "the same with five nodes moved by a tool",
        per: "step",
        sizes: &[6_300],
        parallel: false,
        prepare: moved,
    },
    Case {
        name: "quasi_nonlinear_step",
        about: "five nodes moved: the pre-computed model with corrected magnitudes; whole surface",
        per: "step",
        sizes: &[6_300],
        parallel: false,
        prepare: corrected,
    },
];

/// The load goes round in this many steps, on an ellipse of half the body's half axes.
const N_STEPS: usize = 400;
const LOAD_N: f64 = 1.0;
/// Nodes that share it, or that a tool moves.
const N_NODES: usize = 5;
const DEPTH_M: f64 = 0.01;

/// The nodes of the top that are nearest to a place that wanders, ascending.
fn spots(body: &StandardBody, loadable: &[NodeId]) -> Vec<Vec<NodeId>> {
    let at = |step: usize| {
        let angle = std::f64::consts::TAU * step as f64 / N_STEPS as f64;
        let centre_m = DVec3::new(0.075 * angle.cos(), 0.05 * angle.sin(), 0.05);
        let mut nodes = loadable.to_vec();
        let away = |n: &NodeId| body.mesh.positions_m[n.index()].distance_squared(centre_m);
        nodes.sort_by(|a, b| away(a).total_cmp(&away(b)));
        nodes.truncate(N_NODES);
        nodes.sort_unstable();
        nodes
    };
    (0..N_STEPS).map(at).collect()
}

fn forces(nodes: &[NodeId]) -> Constraints {
    let force_n = DVec3::new(0.0, 0.0, -LOAD_N / nodes.len() as f64);
    let forces = nodes.iter().map(|&node| NodalForce { node, force_n }).collect();
    Constraints { displacements: Vec::new(), forces }
}

fn displacements(nodes: &[NodeId]) -> Constraints {
    let displacement_m = DVec3::new(0.0, 0.0, -DEPTH_M);
    let displacements = nodes.iter().map(|&node| ImposedDisplacement { node, displacement_m }).collect();
    Constraints { displacements, forces: Vec::new() }
}

fn loaded(settings: Settings) -> anyhow::Result<Prepared> {
    reduced(settings, forces)
}

fn moved(settings: Settings) -> anyhow::Result<Prepared> {
    reduced(settings, displacements)
}

fn reduced(settings: Settings, load_of: fn(&[NodeId]) -> Constraints) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let fixed: Vec<FixedNode> = body.fixed_nodes.iter().map(|&n| FixedNode::all_axes(n)).collect();
    let started = super::thread_cpu_ns();
    let mut model = Reduced::build(&ReducedParams::new(&body.mesh, &body.material, &fixed))?;
    let build_s = 1e-9 * (super::thread_cpu_ns() - started) as f64;
    let loads: Vec<Constraints> =
        spots(&body, model.loadable_nodes()).iter().map(|nodes| load_of(nodes)).collect();
    let (mut iterations, mut deepest_m) = (0, 0.0_f64);
    for load in &loads {
        model.apply(load);
        model.step(1e-3);
        ensure!(model.solution().converged, "a step ended with {:?}", model.solution());
        iterations += model.solution().n_iterations;
        let moved = model.state().positions_m.iter().zip(&body.mesh.positions_m).map(|(p, r)| p.distance(*r));
        deepest_m = moved.fold(deepest_m, f64::max);
    }
    let note = format!(
        "{} nodes, {} loadable, r = {}; {:.2} Newton iterations a step; displacement {:.1} mm; made in {build_s:.2} s",
        body.mesh.positions_m.len(),
        model.loadable_nodes().len(),
        model.n_reduced(),
        f64::from(iterations) / N_STEPS as f64,
        1e3 * deepest_m,
    );
    Ok(prepared(body.mesh.tetrahedra.len(), note, loads, Box::new(model)))
}

fn corrected(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let linear = Precomputed::build(&PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.fixed_nodes,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })?;
    let loads: Vec<Constraints> =
        spots(&body, linear.loadable_nodes()).iter().map(|nodes| displacements(nodes)).collect();
    // Any curve costs the same.
    let x: Vec<f64> = (0..=20).map(|i| 0.001 * f64::from(i)).collect();
    let y: Vec<f64> = x.iter().map(|x| x + 30.0 * x * x).collect();
    let curve = fit_curve(&x, &y, 6)?.polynomial;
    let correction = Correction { force: Some(curve.enlarged(100.0)), radial: Some(curve) };
    let note = format!("{} nodes; polynomials of degree 6", body.mesh.positions_m.len());
    let model = QuasiNonlinear::new(Box::new(linear), &body.mesh, correction)?;
    Ok(prepared(body.mesh.tetrahedra.len(), note, loads, Box::new(model)))
}

fn prepared(
    size: usize,
    note: String,
    loads: Vec<Constraints>,
    mut model: Box<dyn DeformableModel>,
) -> Prepared {
    let mut turn = 0;
    Prepared {
        size,
        isa: "portable",
        precision: "f64",
        work: None,
        note,
        run: Box::new(move || {
            model.apply(&loads[turn]);
            model.step(1e-3);
            turn = (turn + 1) % loads.len();
            black_box(model.state().positions_m);
        }),
    }
}
