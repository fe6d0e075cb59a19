//! Benchmarks of one element, one law or one small body: patch test (M1), rigid motions (M2), derivatives and orders of
//! nodes (M3), traction of a cylinder (M4), uniaxial stress (M5), recovery of collapsed shapes (M6), fibres (M8).
//! Relaxation (M7) is in the group `tissue`.

mod laws;
mod motions;
mod recovery;

pub(super) use laws::pressed_bar_pa;

use super::elasticity::{cylinder_case, relative_difference};
use super::{Experiment, Outcome};
use anyhow::{Context, ensure};
use glam::{DMat3, DVec3};
use glisson::material::{LAWS, LawChoice, LawEntry, LinearElastic, MaterialSpec};
use glisson::mesh::box_mesh::irregular_cube;
use glisson::mesh::{NodeId, TetMesh};
use glisson::solve::{
    BoundaryConditions, NonlinearProblem, NonlinearSettings, StaticProblem, boundary_nodes, solve_nonlinear,
    solve_static,
};

const EXACT: &str = "exact";

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    patch(&mut outcome)?;
    motions::rigid_motions(&mut outcome)?;
    laws::derivatives(&mut outcome)?;
    motions::orders_of_nodes(&mut outcome)?;
    traction(&mut outcome)?;
    laws::uniaxial(&mut outcome)?;
    recovery::recovery(&mut outcome)?;
    laws::fibres(&mut outcome)?;
    Ok(outcome)
}

/// A value whose distance from `expected` may be a share of it.
pub(super) fn within_share(name: &str, source: &str, found: f64, expected: f64, share: f64) -> Experiment {
    Experiment::at_most(&format!("{name}, relative"), source, ((found - expected) / expected).abs(), share)
}

/// E 5 kPa, nu 0.45.
fn tissue() -> anyhow::Result<LinearElastic> {
    Ok(LinearElastic::from_young_poisson(5000.0, 0.45, 1000.0)?)
}

/// Every law of the table, alike at small strain but for the fibres.
fn all_laws() -> anyhow::Result<Vec<MaterialSpec>> {
    let linear = tissue()?;
    let made = |entry: &&'static LawEntry| {
        let law = LawChoice::typical(entry);
        let has_fibres = entry.keys.iter().any(|key| key.name == "k1");
        let law = if has_fibres { law.with_number("k1", 2.0 * linear.mu_pa()) } else { law };
        law.with_moduli_of(&linear)
    };
    Ok(LAWS.iter().map(made).collect::<Result<_, _>>()?)
}

fn settings(residual_tolerance: f64) -> NonlinearSettings {
    NonlinearSettings { residual_tolerance, ..NonlinearSettings::default() }
}

/// M1: an affine displacement of the boundary comes out affine inside, whatever the mesh and the law.
fn patch(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mesh = irregular_cube(0.05, 1);
    let gradient = DMat3::from_cols(
        DVec3::new(0.05, 0.0, 0.02),
        DVec3::new(0.1, -0.03, 0.0),
        DVec3::new(0.0, 0.04, 0.06),
    );
    let exact: Vec<DVec3> = mesh.positions_m.iter().map(|&p| gradient * p).collect();
    let boundary = boundary_nodes(&mesh);
    ensure!(boundary.len() < mesh.positions_m.len(), "there are inner nodes");
    let mut conditions = BoundaryConditions::new();
    for &node in &boundary {
        conditions.impose_node(node, exact[node.index()]);
    }
    let (mesh, conditions, nodal_force_n) = (&mesh, &conditions, &vec![DVec3::ZERO; exact.len()][..]);
    for law in all_laws()? {
        let problem = NonlinearProblem {
            mesh,
            laws: &[law.material()],
            conditions,
            nodal_force_n,
            settings: settings(1e-13),
        };
        let found = solve_nonlinear(&problem).with_context(|| format!("patch of {}", law.name()))?;
        outcome.experiments.push(Experiment::at_most(
            &format!("M1 patch test, {}: nodal error, relative", law.name()),
            "exact: affine boundary displacement on 400 irregular tetrahedra",
            relative_difference(&found.displacement_m, &exact),
            1e-10,
        ));
    }
    Ok(())
}

/// M4: traction of a cylinder of 0.2 m radius and 1 m height, and of a box: axial strain p/E, radial -nu p/E.
fn traction(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut cylinder = cylinder_case()?.mesh;
    // From 20 mm and 50 mm.
    cylinder.positions_m.iter_mut().for_each(|p| *p *= DVec3::new(10.0, 10.0, 20.0));
    let source = "exact: p/E and -nu p/E; tolerances of SOFA's LinearElasticity test";
    let [axial, radial] = traction_errors(&cylinder)?;
    outcome.experiments.extend([
        Experiment::at_most(
            "M4 cylinder under traction, p/E 1 %: error of the axial strain",
            source,
            axial,
            1e-4,
        ),
        Experiment::at_most("M4 cylinder under traction: error of the radial strain", source, radial, 2e-4),
    ]);
    let [axial, radial] = traction_errors(&irregular_cube(1.0, 1))?;
    outcome.experiments.push(Experiment::at_most(
        "M4 box of irregular tetrahedra under traction: error of the strains",
        "exact: p/E and -nu p/E",
        axial.max(radial),
        1e-12,
    ));
    outcome.notes += "### Traction (M4)\n\nThe sides of the cylinder's mesh are not quite upright, so that its exact strain is not quite even: hence its error, \
                      where the box has only rounding.\n\n";
    Ok(())
}

/// Largest errors of the axial and the radial strain of a body between z = 0 and z = 1 m that is pulled upwards.
fn traction_errors(mesh: &TetMesh) -> anyhow::Result<[f64; 2]> {
    let (young_pa, poisson, traction_pa) = (1000.0, 0.3, 10.0);
    let material = LinearElastic::from_young_poisson(young_pa, poisson, 1000.0)?;
    let at = |z_m: f64, p: &DVec3| (p.z - z_m).abs() < 1e-9;
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    for nodes in &mesh.tetrahedra {
        for opposite in 0..4 {
            let face = [1, 2, 3].map(|i| nodes[(opposite + i) % 4]);
            let p = face.map(|n| mesh.positions_m[n.index()]);
            if p.iter().all(|p| at(1.0, p)) {
                let area_m2 = 0.5 * (p[1] - p[0]).cross(p[2] - p[0]).length();
                face.iter().for_each(|n| nodal_force_n[n.index()].z += traction_pa * area_m2 / 3.0);
            }
        }
    }
    let mut conditions = BoundaryConditions::new();
    let base: Vec<usize> = (0..mesh.positions_m.len()).filter(|&n| at(0.0, &mesh.positions_m[n])).collect();
    base.iter().for_each(|&n| conditions.impose(NodeId::from_index(n), 2, 0.0));
    let exact = |p: DVec3| traction_pa / young_pa * DVec3::new(-poisson * p.x, -poisson * p.y, p.z);
    // Two nodes more, held where the exact solution has them, keep it from sliding and turning.
    let along = |n: usize, axis: usize| mesh.positions_m[n][axis];
    let far = |axis: usize| {
        base.iter().copied().max_by(|&a, &b| along(a, axis).total_cmp(&along(b, axis))).context("no base")
    };
    let near = |axis: usize| {
        base.iter().copied().min_by(|&a, &b| along(a, axis).total_cmp(&along(b, axis))).context("no base")
    };
    let (first, second) = (near(1)?, far(1)?);
    conditions.impose_node(NodeId::from_index(first), exact(mesh.positions_m[first]));
    conditions.impose(NodeId::from_index(second), 0, exact(mesh.positions_m[second]).x);
    let (material, conditions, nodal_force_n) = (&material, &conditions, &nodal_force_n[..]);
    let found = solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n })?;
    let error = |axis: usize| {
        let moved = found.displacement_m.iter().zip(&mesh.positions_m);
        let off_m = moved.map(|(u, p)| (*u - exact(*p))[axis].abs()).fold(0.0, f64::max);
        off_m / mesh.positions_m.iter().map(|p| p[axis].abs()).fold(0.0, f64::max)
    };
    Ok([error(2), error(0).max(error(1))])
}
