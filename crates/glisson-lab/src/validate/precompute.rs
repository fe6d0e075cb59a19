//! The pre-computation of the synthetic patient's liver: against direct solutions, against the Lagrange multipliers
//! of seed `001`, in its two forms, and beside the conjugate gradients that the papers used.

use super::elasticity::relative_difference;
use super::{Claim, Outcome, check_all};
use crate::bench::thread_cpu_ns;
use crate::bodies::{cylinder, liver, most, nodes_where};
use crate::scratch::ScratchFolder;
use anyhow::Context;
use glisson::material::LinearElastic;
use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::precomputed::{
    ComplianceCheck, Precision, Precomputed, PrecomputedExpectation, PrecomputedParams, StoredNodes,
    StreamOptions, UnitDisplacements, check_compliance, precompute_to_file,
};
use glisson::model::{Constraints, DeformableModel, ImposedDisplacement, NodalForce};
use glisson::solve::{
    BoundaryConditions, FreeSystem, IncompleteCholesky, LagrangeSolution, LinearConstraint, MeshEdges,
    StaticProblem, StiffnessTensors, solve_lagrange, solve_lagrange_densely,
};

const OWN: &str = "requirement";
const MULTIPLIERS: &str = "Cotin, Delingette and Ayache 1998, RR-3511, eq. 2";
const FORMS: &str = "Cotin, Delingette and Ayache 1998, RR-3511, s. 4.1";
const GRADIENTS: &str = "Checoury 2002 s. 2.1: 140 iterations, 1,313 nodes, 1e-6 m";
/// The report's liver.
const LIVER_TETS: usize = 6_300;
/// Meshes of table 1 and s. 4.1 of RR-3511 and of s. 2.4 of seed `003`: tetrahedra, nodes, and what they took.
const PAPERS: [(usize, &str, &str); 4] = [
    (725, "193 nodes / 725 tetrahedra (001 s. 4.1)", "7 min (Alpha 400 MHz)"),
    (6_342, "1,394 / 6,342, 614 loadable (003 s. 2.4)", "a little over 4 h; file 36 \"megabits\""),
    (6_500, "1,400 / 6,500 (001, before table 1)", "about 8 h (Alpha 400 MHz)"),
    (8_124, "1,735 / 8,124 (001 s. 4.1)", "about 9 h (Alpha 400 MHz)"),
];
/// Share of the nodes, those at the back, that is held.
const HELD_SHARE: f64 = 0.08;
/// Loads of the comparison with conjugate gradients: each moves its node by so much [m], and is solved to the
/// report's precision [m].
const MOVED_M: f64 = 0.01;
const PRECISION_M: f64 = 1e-6;
const RELATIVE_RESIDUAL: f64 = 1e-6;
const MOST_ITERATIONS: usize = 10_000;
/// Loaded nodes of that comparison.
const N_LOADS: usize = 12;

/// Poisson's ratio of seed `003`. Its Young's modulus (1e4 kg/cm2) is that of no liver; it scales all alike, so
/// that any other will do.
fn material() -> anyhow::Result<LinearElastic> {
    Ok(LinearElastic::from_young_poisson(5e3, 0.45, 1e3)?)
}

/// A held body.
struct Body {
    mesh: TetMesh,
    fixed: Vec<NodeId>,
    material: LinearElastic,
}

impl Body {
    fn liver(n_tets: usize) -> anyhow::Result<Self> {
        let mesh = liver(n_tets)?;
        let mut by_depth: Vec<NodeId> = (0..mesh.positions_m.len()).map(NodeId::from_index).collect();
        let depth_m = |n: &NodeId| mesh.positions_m[n.index()].y;
        by_depth.sort_by(|a, b| depth_m(b).total_cmp(&depth_m(a)));
        by_depth.truncate((HELD_SHARE * by_depth.len() as f64).ceil() as usize);
        by_depth.sort_unstable();
        Ok(Self { mesh, fixed: by_depth, material: material()? })
    }

    /// Small enough for a dense solution; held at its base.
    fn small_cylinder() -> anyhow::Result<Self> {
        let mesh = cylinder(0.03, 0.08, 300)?;
        let fixed = nodes_where(&mesh, |p| p.z < 1e-3);
        Ok(Self { mesh, fixed, material: material()? })
    }

    fn params(&self) -> PrecomputedParams<'_> {
        PrecomputedParams {
            mesh: &self.mesh,
            material: &self.material,
            fixed_nodes: &self.fixed,
            stored: StoredNodes::Surface,
            precision: Precision::F64,
            progress: None,
        }
    }

    fn system(&self) -> anyhow::Result<FreeSystem> {
        let edges = MeshEdges::of_mesh(&self.mesh)?;
        let tensors = StiffnessTensors::assemble(&self.mesh, &edges, &self.material)?;
        Ok(FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(&self.fixed))?)
    }
}

/// Some loadable nodes, evenly chosen.
fn some(model: &Precomputed, n: usize) -> Vec<NodeId> {
    let nodes = model.loadable_nodes();
    nodes.iter().copied().step_by((nodes.len() / n).max(1)).take(n).collect()
}

/// Difference of the model's response to imposed displacements from Lagrange multipliers: of displacements and forces,
/// relative.
fn against_multipliers(
    body: &Body,
    n_imposed: usize,
    solve: impl Fn(&StaticProblem<'_>, &[LinearConstraint]) -> anyhow::Result<LagrangeSolution>,
) -> anyhow::Result<[f64; 2]> {
    let mut model = Precomputed::build(&PrecomputedParams { stored: StoredNodes::All, ..body.params() })?;
    let mut random = SeededRandom::new(12);
    let imposed: Vec<ImposedDisplacement> = some(&model, n_imposed)
        .into_iter()
        .map(|node| {
            let direction = DVec3::new(random.normal(), random.normal(), random.normal());
            ImposedDisplacement { node, displacement_m: direction * 0.003 }
        })
        .collect();
    let constraints: Vec<LinearConstraint> =
        imposed.iter().flat_map(|i| LinearConstraint::node(i.node, i.displacement_m)).collect();
    let solution = solve(
        &StaticProblem {
            mesh: &body.mesh,
            material: &body.material,
            conditions: &BoundaryConditions::fixed(&body.fixed),
            nodal_force_n: &vec![DVec3::ZERO; body.mesh.positions_m.len()],
        },
        &constraints,
    )?;
    model.apply(&Constraints { displacements: imposed, forces: vec![] });
    model.step(0.0);
    let moved = model.state().positions_m.iter().zip(&body.mesh.positions_m);
    let displacement_m: Vec<DVec3> = moved.map(|(x, rest)| *x - *rest).collect();
    let exerted_n: Vec<DVec3> =
        solution.multiplier_n.chunks_exact(3).map(|l| -DVec3::from_slice(l)).collect();
    Ok([
        relative_difference(&displacement_m, &solution.displacement_m),
        relative_difference(model.constraint_forces_n(), &exerted_n),
    ])
}

fn largest(tensors: impl IntoIterator<Item = DMat3>) -> f64 {
    most(tensors.into_iter().flat_map(|t| t.to_cols_array()).map(f64::abs))
}

/// Difference of the two forms of the pre-computation, relative.
fn forms_differ(body: &Body, model: &Precomputed) -> anyhow::Result<f64> {
    let nodes = some(model, 3);
    let derived = UnitDisplacements::of(model, &nodes);
    let solved =
        UnitDisplacements::compute(&body.mesh, &body.material, &body.fixed, &nodes, model.stored_nodes())?;
    let pairs = || derived.nodes().iter().zip(solved.nodes());
    let forces = largest(pairs().map(|(a, b)| a.force_n_per_m - b.force_n_per_m))
        / largest(pairs().map(|(_, b)| b.force_n_per_m));
    let displacements =
        pairs().flat_map(|(a, b)| a.displacement.iter().zip(&b.displacement).map(|(a, b)| *a - *b));
    Ok(forces.max(largest(displacements)))
}

/// What conjugate gradients take.
struct Gradients {
    /// Mean iterations until every displacement is within the precision, and until the residual is small.
    n_iterations: [f64; 2],
    /// Of the latter, a right-hand side [s].
    seconds: f64,
    /// To factor [s].
    factor_seconds: f64,
    /// Of the diagonal.
    shift: f64,
    /// Largest difference from the compliance at the small residual [m].
    off_m: f64,
}

fn gradients(body: &Body, model: &Precomputed) -> anyhow::Result<Gradients> {
    let system = body.system()?;
    let start_ns = thread_cpu_ns();
    let preconditioner = IncompleteCholesky::new(&system)?;
    let factor_seconds = 1e-9 * (thread_cpu_ns() - start_ns) as f64;
    let mut scratch = preconditioner.scratch();
    let [mut right, mut solution] = [(); 2].map(|()| vec![0.0; system.n_free()]);
    let (mut n_iterations, mut seconds, mut off_m) = ([0; 2], 0.0, 0.0_f64);
    let loads = some(model, N_LOADS);
    for (i, &node) in loads.iter().enumerate() {
        let axis = i % 3;
        let row = system.row_of(node, axis).context("loadable nodes are free")?;
        let own = model.compliance_m_per_n(node, node).context("loadable nodes are stored")?;
        let force_n = MOVED_M / own.col(axis)[axis];
        right[row] = force_n;
        let expected: Vec<(usize, f64)> = model
            .stored_nodes()
            .iter()
            .filter_map(|&n| model.compliance_m_per_n(n, node).map(|t| (n, t.col(axis) * force_n)))
            .flat_map(|(n, u_m)| [0, 1, 2].map(|a| (n, a, u_m[a])))
            .filter_map(|(n, a, u_m)| Some((system.row_of(n, a)?, u_m)))
            .collect();
        let off = |found: &[f64]| most(expected.iter().map(|&(row, u_m)| (found[row] - u_m).abs()));
        let precise = |found: &[f64]| off(found) <= PRECISION_M;
        let report =
            preconditioner.solve_into(&right, &mut solution, 0.0, MOST_ITERATIONS, &mut scratch, precise);
        n_iterations[0] += report.n_iterations;
        let start_ns = thread_cpu_ns();
        let report = preconditioner.solve_into(
            &right,
            &mut solution,
            RELATIVE_RESIDUAL,
            MOST_ITERATIONS,
            &mut scratch,
            |_| false,
        );
        seconds += 1e-9 * (thread_cpu_ns() - start_ns) as f64;
        n_iterations[1] += report.n_iterations;
        off_m = off_m.max(off(&solution));
        right[row] = 0.0;
    }
    let n = loads.len() as f64;
    let n_iterations = n_iterations.map(|sum| f64::from(u32::try_from(sum).unwrap_or(u32::MAX)) / n);
    let shift = preconditioner.shift();
    Ok(Gradients { n_iterations, seconds: seconds / n, factor_seconds, shift, off_m })
}

/// A line of the table of the papers' meshes.
fn paper_row(n_tets: usize, mesh: &str, took: &str) -> anyhow::Result<String> {
    let body = Body::liver(n_tets)?;
    let folder = ScratchFolder::new()?;
    let file = folder.path().join("liver.precomputed");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (written, ours) = pool.install(|| {
        let start_ns = thread_cpu_ns();
        let written = precompute_to_file(&body.params(), &file, &StreamOptions::default());
        (written, 1e-9 * (thread_cpu_ns() - start_ns) as f64)
    });
    let written = written?;
    let Body { mesh: tets, material, fixed } = &body;
    let model =
        Precomputed::load(&file, &PrecomputedExpectation { mesh: tets, material, fixed_nodes: fixed })?;
    let cg = gradients(&body, &model)?;
    let cg_total = cg.factor_seconds + cg.seconds * 3.0 * written.n_loadable as f64;
    Ok(format!(
        "| {mesh} | {took} | {} / {} / {} | {:.0} to {:.0e} m, {:.0} to a residual of {RELATIVE_RESIDUAL:e} | {:.2} | {:.1} | \
         {ours:.2} | {:.0} | {:.1} |\n",
        tets.positions_m.len(),
        tets.tetrahedra.len(),
        written.n_loadable,
        cg.n_iterations[0],
        PRECISION_M,
        cg.n_iterations[1],
        1e3 * cg.seconds,
        cg_total,
        cg_total / ours,
        1e-6 * written.n_bytes as f64,
    ))
}

/// Nodes that are loaded or moved, what table 2.1 of seed `003` says of it for its fastest machines.
const RESPONSES: [(usize, bool, &str, &str); 5] = [
    (1, true, "force on 1 node", "3,846 Hz"),
    (1, false, "displacement of 1 node", "3,759 Hz"),
    (5, false, "displacements of 5 nodes", "561 Hz"),
    (10, false, "displacements of 10 nodes", "185 Hz"),
    (20, false, "displacements of 20 nodes", "40 Hz"),
];
/// Timed responses of each kind.
const N_RESPONSES: usize = 600;

/// Lines of the table of response rates: other nodes in every call, all surface nodes moved.
fn response_rows(model: &mut Precomputed) -> String {
    let loadable = model.loadable_nodes().to_vec();
    let mut random = SeededRandom::new(21);
    let mut rows = String::new();
    for (n, is_force, what, paper) in RESPONSES {
        let mut times_ns: Vec<u64> = (0..N_RESPONSES)
            .map(|_| {
                let mut nodes: Vec<NodeId> = Vec::new();
                while nodes.len() < n {
                    let node = loadable[(random.uniform() * loadable.len() as f64) as usize];
                    if !nodes.contains(&node) {
                        nodes.push(node);
                    }
                }
                nodes.sort_unstable();
                let mut constraints = Constraints::default();
                for node in nodes {
                    let vector = DVec3::new(random.normal(), random.normal(), random.normal()) * 1e-3;
                    if is_force {
                        constraints.forces.push(NodalForce { node, force_n: vector });
                    } else {
                        constraints.displacements.push(ImposedDisplacement { node, displacement_m: vector });
                    }
                }
                let start_ns = thread_cpu_ns();
                model.apply(&constraints);
                model.step(1e-3);
                thread_cpu_ns() - start_ns
            })
            .collect();
        times_ns.sort_unstable();
        let median_ns = times_ns[N_RESPONSES / 2] as f64;
        rows += &format!("| {what} | {paper} | {:.1} | {:.0} |\n", 1e-3 * median_ns, 1e9 / median_ns);
    }
    rows
}

/// What the experiments judge.
struct Measured {
    check: ComplianceCheck,
    check_f32: ComplianceCheck,
    /// Displacements and forces of the liver, and of the small cylinder.
    multipliers: [f64; 2],
    whole_system: [f64; 2],
    forms: f64,
    gradients: Gradients,
}

impl Measured {
    fn new(body: &Body, model: &Precomputed) -> anyhow::Result<Self> {
        let short = Precomputed::build(&PrecomputedParams { precision: Precision::F32, ..body.params() })?;
        let by_factor = |p: &StaticProblem<'_>, c: &[LinearConstraint]| Ok(solve_lagrange(p, c)?);
        let whole = |p: &StaticProblem<'_>, c: &[LinearConstraint]| Ok(solve_lagrange_densely(p, c)?);
        Ok(Self {
            check: check_compliance(model, &body.mesh, 30)?,
            check_f32: check_compliance(&short, &body.mesh, 30)?,
            multipliers: against_multipliers(body, 20, by_factor)?,
            whole_system: against_multipliers(&Body::small_cylinder()?, 6, whole)?,
            forms: forms_differ(body, model)?,
            gradients: gradients(body, model)?,
        })
    }
}

const CLAIMS: &[Claim<'_, Measured>] = &[
    Claim::at_most(
        "liver: compliance against direct solutions, over its largest entry",
        OWN,
        |m| m.check.difference,
        1e-10,
    ),
    Claim::at_most(
        "liver: compliance against its transpose, over its largest entry",
        "Maxwell-Betti",
        |m| m.check.asymmetry,
        1e-12,
    ),
    Claim::at_most(
        "liver: compliance stored in f32 against direct solutions, over its largest entry",
        OWN,
        |m| m.check_f32.difference,
        1e-5,
    ),
    Claim::at_most(
        "liver: displacements imposed on 20 nodes against Lagrange multipliers, relative",
        MULTIPLIERS,
        |m| m.multipliers[0],
        1e-10,
    ),
    Claim::at_most(
        "liver: forces that hold them against minus the multipliers, relative",
        MULTIPLIERS,
        |m| m.multipliers[1],
        1e-9,
    ),
    Claim::at_most(
        "cylinder: displacements imposed on 6 nodes against the whole dense system, relative",
        MULTIPLIERS,
        |m| m.whole_system[0],
        1e-10,
    ),
    Claim::at_most(
        "cylinder: forces that hold them against minus its multipliers, relative",
        MULTIPLIERS,
        |m| m.whole_system[1],
        1e-10,
    ),
    Claim::at_most(
        "liver: unit displacements by the compliance against solving for them, relative",
        FORMS,
        |m| m.forms,
        1e-10,
    ),
    Claim::at_most(
        "liver: conjugate gradients against the compliance for loads of 10 mm [m]",
        GRADIENTS,
        |m| m.gradients.off_m,
        PRECISION_M,
    ),
    Claim::within(
        "liver: iterations of conjugate gradients to 1e-6 m",
        GRADIENTS,
        |m| m.gradients.n_iterations[0],
        [30.0, 300.0],
    ),
];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let body = Body::liver(LIVER_TETS)?;
    let mut model = Precomputed::build(&body.params())?;
    let measured = Measured::new(&body, &model)?;
    let experiments = check_all(CLAIMS, &measured);
    let notes = notes(&body, &mut model, measured.gradients.shift)?;
    Ok(Outcome { experiments, figures: Vec::new(), notes })
}

/// The tables of the papers' meshes and of responses; `shift` is what the incomplete factor needed.
fn notes(body: &Body, model: &mut Precomputed, shift: f64) -> anyhow::Result<String> {
    let rows: String =
        PAPERS.into_iter().map(|(n, mesh, took)| paper_row(n, mesh, took)).collect::<Result<_, _>>()?;
    let responses = response_rows(model);
    Ok(format!(
        "The liver ({} nodes, {} tetrahedra, {} loadable surface nodes) is held at its back. Direct solutions are refined \
         with the stiffness itself. The incomplete factor has no fill; it {}. Each of the {N_LOADS} loads moves its own node by \
         {:.0} mm.\n\n\
         The papers' meshes beside ours of about as many tetrahedra; times are processor seconds of one core. The sums of \
         conjugate gradients are three times the loadable nodes times the mean of {N_LOADS} solutions.\n\n\
         | paper's mesh | paper | ours: nodes / tetrahedra / loadable | iterations | ms a solution | conjugate gradients [s] | \
         sparse factor, file written [s] | ratio | file [MB] |\n|---|---|---|---|---|---|---|---|---|\n{rows}\n\
         Responses beside table 2.1 of seed `003` (the fastest of its three machines; its liver has 614 surface nodes): \
         processor time of one core, median of {N_RESPONSES} with other nodes each, all surface nodes moved, call included; \
         `glisson bench precomputed_response` measures the same more finely. Table 1 of seed `001` has 7 ms for one \
         deformation of its liver, 15,000 ms without the pre-computation.\n\n\
         | response | paper | ours [us] | ours [Hz] |\n|---|---|---|---|\n{responses}\n\
         The report's \"36 megabits\" must be megabytes: 614 x 614 tensors are 27.1 MB of f64.",
        body.mesh.positions_m.len(),
        body.mesh.tetrahedra.len(),
        model.loadable_nodes().len(),
        if shift > 0.0 {
            format!("needs {shift} of the diagonal added to exist")
        } else {
            "exists as it is".to_owned()
        },
        1e3 * MOVED_M,
    ))
}
