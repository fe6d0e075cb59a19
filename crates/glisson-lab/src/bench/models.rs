//! Cases of the deformable models: the pre-computed one and the linear tensor-mass.

use std::hint::black_box;

use fearless_simd::Level;
use glam::DVec3;
use glisson::model::precomputed::{
    Precision, PrecomputedParams, StoredNodes, StreamOptions, precompute_to_file,
};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{DeformableModel, DynamicBody, FixedNode};
use glisson::solve::{
    BoundaryConditions, FreeSystem, IncompleteCholesky, MeshEdges, StiffnessTensors, boundary_nodes,
};

use super::body::StandardBody;
use super::{Case, Prepared, Settings, Work, isa_name};
use crate::scratch::ScratchFolder;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "precompute",
        about: "the compliance of all loadable surface nodes: assembly, sparse Cholesky, unit forces, its file written",
        per: "build",
        sizes: &[2_000, 6_300, 20_000],
        parallel: true,
        prepare: precompute,
    },
    Case {
        name: "precompute_cg",
        about: "the baseline: the same unit forces one by one by conjugate gradients with incomplete Cholesky",
        per: "build",
        sizes: &[1_000],
        parallel: false,
        prepare: precompute_cg,
    },
    Case {
        name: "tensor_mass_step",
        about: "one explicit step of the linear tensor-mass: internal forces and central differences",
        per: "step",
        sizes: &[2_000, 6_300, 20_000, 100_000],
        parallel: false,
        prepare: tensor_mass_step,
    },
];

fn precomputed_params(body: &StandardBody) -> PrecomputedParams<'_> {
    PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.fixed_nodes,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    }
}

fn precompute(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let folder = ScratchFolder::new()?;
    let file = folder.path().join("body.precomputed");
    let written = precompute_to_file(&precomputed_params(&body), &file, &StreamOptions::default())?;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        // The sparse solver chooses its kernels when the program runs: AVX-512 in matrix products where there
        // is any (faer's private-gemm-x86), at most AVX2 elsewhere (its pulp is built without x86-v4).
        isa: isa_name(Level::new()),
        precision: "f64",
        work: None,
        note: format!(
            "{} nodes, {} of them held, {} loadable; file {:.1} MB",
            body.mesh.positions_m.len(),
            body.fixed_nodes.len(),
            written.n_loadable,
            1e-6 * written.n_bytes as f64
        ),
        run: Box::new(move || {
            let file = folder.path().join("body.precomputed");
            let written = precompute_to_file(&precomputed_params(&body), &file, &StreamOptions::default());
            black_box(written.expect("it was written once before"));
        }),
    })
}

/// Residual over the right-hand side at which the baseline stops.
const CG_TOLERANCE: f64 = 1e-6;
const CG_MOST_ITERATIONS: usize = 10_000;

fn precompute_cg(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let edges = MeshEdges::of_mesh(&body.mesh)?;
    let tensors = StiffnessTensors::assemble(&body.mesh, &edges, &body.material)?;
    let system = FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(&body.fixed_nodes))?;
    let loaded: Vec<usize> = boundary_nodes(&body.mesh)
        .iter()
        .flat_map(|&node| [0, 1, 2].map(|axis| (node, axis)))
        .filter_map(|(node, axis)| system.row_of(node, axis))
        .collect();
    let solve_all = move || -> anyhow::Result<(usize, usize)> {
        let preconditioner = IncompleteCholesky::new(&system)?;
        let mut scratch = preconditioner.scratch();
        let [mut right, mut solution] = [(); 2].map(|()| vec![0.0; system.n_free()]);
        let mut n_iterations = 0;
        for &row in &loaded {
            right[row] = 1.0;
            let report = preconditioner.solve_into(
                &right,
                &mut solution,
                CG_TOLERANCE,
                CG_MOST_ITERATIONS,
                &mut scratch,
                |_| false,
            );
            right[row] = 0.0;
            n_iterations += report.n_iterations;
            black_box(&solution);
        }
        Ok((n_iterations, loaded.len()))
    };
    let (n_iterations, n_columns) = solve_all()?;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!(
            "{n_columns} right-hand sides, {:.1} iterations each to a relative residual of {CG_TOLERANCE:e}",
            n_iterations as f64 / n_columns as f64
        ),
        run: Box::new(move || {
            black_box(solve_all().expect("it was solved once before"));
        }),
    })
}

fn tensor_mass_step(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let stable = TensorMass::stable_step(&body.mesh, &body.material)?;
    let step_s = 0.9 * stable.step_s;
    let fixed: Vec<FixedNode> = body.fixed_nodes.iter().map(|&node| FixedNode::all_axes(node)).collect();
    // Without damping it moves for ever: no number becomes subnormal, which would be slow.
    let mut model = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &fixed,
            time_step_s: step_s,
            ..DynamicBody::new(&body.mesh, body.material.density_kg_per_m3())
        },
        material: &body.material,
    })?;
    let bent_m: Vec<DVec3> = body
        .mesh
        .positions_m
        .iter()
        .map(|&p| p + DVec3::new(0.0, 0.2 * (p.x / 0.15) * (p.z / 0.06 + 1.0) * 0.01, 0.02 * p.x))
        .collect();
    model.take_over(&bent_m);
    let (n_edges, n_nodes) = (MeshEdges::of_mesh(&body.mesh)?.nodes.len(), body.mesh.positions_m.len());
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        // Two 3x3 products an edge and one a node, then 12 operations a component for the step. Each tensor
        // is nine numbers; displacements of two times, forces, positions and velocities are three a node.
        work: Some(Work {
            flops: (36 * n_edges + (18 + 36) * n_nodes) as f64,
            bytes: ((72 + 8) * n_edges + (72 + 6 * 24) * n_nodes) as f64,
            working_set_bytes: ((72 + 8) * n_edges + (72 + 6 * 24) * n_nodes) as f64,
        }),
        note: format!("{n_edges} edges, stable step {:.2} ms", 1e3 * stable.step_s),
        run: Box::new(move || {
            model.step(step_s);
            black_box(model.state().positions_m);
        }),
    })
}
