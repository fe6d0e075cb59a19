//! Linear elasticity against finite-element solutions.

use super::Experiment;
use anyhow::Context;
use glisson::math::DVec3;
use glisson::solve::case::{CaseBytes, StaticCase, parse_case, parse_vectors};
use glisson::solve::{StaticProblem, StaticSolution, add_gravity_forces, solve_static};
use std::path::Path;

const SOURCE: &str = "own P1 Newton solution to residual 1e-9; CalculiX 2.20 agrees to its printed digits";

/// A reference case as it lies in the library's test data.
struct Reference {
    name: &'static str,
    case: CaseBytes,
    displacement: &'static [u8],
    reaction: &'static [u8],
}

macro_rules! reference_file {
    ($case:literal, $file:literal) => {
        include_bytes!(concat!("../../../glisson/tests/data/reference/", $case, "/", $file))
    };
}

macro_rules! reference {
    ($case:literal) => {
        Reference {
            name: $case,
            case: CaseBytes {
                nodes: reference_file!($case, "nodes.csv").to_vec(),
                tets: reference_file!($case, "tets.csv").to_vec(),
                dirichlet: reference_file!($case, "dirichlet.csv").to_vec(),
                load: reference_file!($case, "load.json").to_vec(),
            },
            displacement: reference_file!($case, "u_np_linear.csv"),
            reaction: reference_file!($case, "reactions_np_linear.csv"),
        }
    };
}

fn solve(case: &StaticCase) -> anyhow::Result<StaticSolution> {
    let mut nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
    add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut nodal_force_n);
    let (mesh, material, conditions) = (&case.mesh, &case.material, &case.conditions);
    Ok(solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n: &nodal_force_n })?)
}

/// The clamped cylinder as a case: radius 20 mm, height 50 mm.
pub(super) fn cylinder_case() -> anyhow::Result<StaticCase> {
    Ok(parse_case(Path::new("cylinder"), &reference!("cylinder").case)?)
}

/// Largest distance over the largest expected length.
pub(super) fn relative_difference(found: &[DVec3], expected: &[DVec3]) -> f64 {
    let scale = expected.iter().map(|v| v.length()).fold(0.0, f64::max);
    let worst = found.iter().zip(expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    worst / scale
}

pub(super) fn experiments() -> anyhow::Result<Vec<Experiment>> {
    let mut found = Vec::new();
    for reference in [reference!("beam"), reference!("cylinder"), reference!("patch")] {
        let name = reference.name;
        let case = parse_case(Path::new(name), &reference.case)?;
        let solution = solve(&case).context(name)?;
        let expected = |bytes| parse_vectors(Path::new(name), bytes);
        let u = relative_difference(&solution.displacement_m, &expected(reference.displacement)?);
        let r = relative_difference(&solution.reaction_n, &expected(reference.reaction)?);
        found.push(Experiment::at_most(&format!("{name}: linear displacements, relative"), SOURCE, u, 1e-8));
        found.push(Experiment::at_most(&format!("{name}: linear reactions, relative"), SOURCE, r, 1e-8));
        if name == "patch" {
            found.push(patch(&case, &solution));
        }
    }
    Ok(found)
}

/// The affine field of the patch case, the matrix of its `load.json`.
fn patch(case: &StaticCase, solution: &StaticSolution) -> Experiment {
    let affine =
        |p: DVec3| DVec3::new(0.05 * p.x + 0.1 * p.y, -0.03 * p.y + 0.04 * p.z, 0.02 * p.x + 0.06 * p.z);
    let exact: Vec<DVec3> = case.mesh.positions_m.iter().map(|&p| affine(p)).collect();
    let error = relative_difference(&solution.displacement_m, &exact);
    Experiment::at_most(
        "patch test: nodal error, relative",
        "exact: affine boundary displacement",
        error,
        1e-10,
    )
}
