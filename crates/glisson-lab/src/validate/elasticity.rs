//! Linear, St Venant-Kirchhoff and ln J neo-Hooke elasticity against finite-element solutions.

use super::{Experiment, Outcome};
use crate::bodies::most;
use anyhow::Context;
use glisson::material::{MaterialSpec, NeoHookeLog, StVenantKirchhoff};
use glisson::math::DVec3;
use glisson::solve::case::{CaseBytes, StaticCase, parse_case, parse_vectors};
use glisson::solve::{
    NonlinearProblem, NonlinearSettings, StaticProblem, add_gravity_forces, solve_nonlinear, solve_static,
};
use std::path::Path;

const SOURCE: &str = "own P1 Newton solution to residual 1e-9; CalculiX 2.20 agrees to its printed digits";

/// A reference case as it lies in the library's test data.
struct Reference {
    name: &'static str,
    case: CaseBytes,
    /// Displacements and reactions of the linear, St Venant-Kirchhoff and neo-Hooke solutions.
    solutions: [[&'static [u8]; 2]; 3],
}

macro_rules! reference_file {
    ($case:literal, $file:literal) => {
        include_bytes!(concat!("../../reference/", $case, "/", $file))
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
            solutions: [
                [
                    reference_file!($case, "u_np_linear.csv"),
                    reference_file!($case, "reactions_np_linear.csv"),
                ],
                [reference_file!($case, "u_np_stvk.csv"), reference_file!($case, "reactions_np_stvk.csv")],
                [reference_file!($case, "u_np_nh.csv"), reference_file!($case, "reactions_np_nh.csv")],
            ],
        }
    };
}

/// The three laws, in the order of [`Reference::solutions`], with the tolerance asked for.
const LAWS: [(&str, f64); 3] = [("linear", 1e-8), ("St Venant-Kirchhoff", 1e-6), ("ln J neo-Hooke", 1e-6)];

/// Displacements and reactions.
type Fields = [Vec<DVec3>; 2];

fn solve(case: &StaticCase, law: usize) -> anyhow::Result<Fields> {
    let mut nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
    add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut nodal_force_n);
    let (mesh, conditions, nodal_force_n) = (&case.mesh, &case.conditions, &nodal_force_n[..]);
    if law == 0 {
        let material = &case.material;
        let solution = solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n })?;
        return Ok([solution.displacement_m, solution.reaction_n]);
    }
    let spec = match law {
        1 => MaterialSpec::from(StVenantKirchhoff::from(&case.material)),
        _ => MaterialSpec::from(NeoHookeLog::from(&case.material)),
    };
    let (laws, settings) = (&[spec.material()][..], NonlinearSettings::default());
    let solution = solve_nonlinear(&NonlinearProblem { mesh, laws, conditions, nodal_force_n, settings })?;
    Ok([solution.displacement_m, solution.reaction_n])
}

/// The clamped cylinder as a case: radius 20 mm, height 50 mm.
pub(super) fn cylinder_case() -> anyhow::Result<StaticCase> {
    Ok(parse_case(Path::new("cylinder"), &reference!("cylinder").case)?)
}

/// Largest distance over the largest expected length.
pub(super) fn relative_difference(found: &[DVec3], expected: &[DVec3]) -> f64 {
    let scale = most(expected.iter().map(|v| v.length()));
    most(found.iter().zip(expected).map(|(a, b)| a.distance(*b))) / scale
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut found = Vec::new();
    for reference in [reference!("beam"), reference!("cylinder"), reference!("patch")] {
        let name = reference.name;
        let case = parse_case(Path::new(name), &reference.case)?;
        for (law, (law_name, tolerance)) in LAWS.into_iter().enumerate() {
            let fields = solve(&case, law).with_context(|| format!("{name}, {law_name}"))?;
            for ((field, bytes), what) in
                fields.iter().zip(reference.solutions[law]).zip(["displacements", "reactions"])
            {
                let error = relative_difference(field, &parse_vectors(Path::new(name), bytes)?);
                let title = format!("{name}: {law_name} {what}, relative");
                found.push(Experiment::at_most(&title, SOURCE, error, tolerance));
            }
            if name == "patch" && law == 0 {
                found.push(patch(&case, &fields[0]));
            }
        }
    }
    Ok(found.into())
}

/// The affine field of the patch case, the matrix of its `load.json`.
fn patch(case: &StaticCase, displacement_m: &[DVec3]) -> Experiment {
    let affine =
        |p: DVec3| DVec3::new(0.05 * p.x + 0.1 * p.y, -0.03 * p.y + 0.04 * p.z, 0.02 * p.x + 0.06 * p.z);
    let exact: Vec<DVec3> = case.mesh.positions_m.iter().map(|&p| affine(p)).collect();
    let error = relative_difference(displacement_m, &exact);
    Experiment::at_most(
        "patch test: nodal error, relative",
        "exact: affine boundary displacement",
        error,
        1e-10,
    )
}
