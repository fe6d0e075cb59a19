//! The pre-computed model under gravity.

use crate::model_meshes::block;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::precomputed::{
    Precision, Precomputed, PrecomputedExpectation, PrecomputedParams, StoredNodes,
};
use glisson_tissue::model::{Constraints, DeformableModel};
use glisson_tissue::solve::{BoundaryConditions, StaticProblem, add_gravity_forces, solve_static};
use std::path::Path;

#[test]
fn a_tilted_table_deforms_the_rest_shape_by_the_difference_of_the_weights() {
    let mesh = block([4, 3, 5], DVec3::new(0.08, 0.06, 0.1));
    let material = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
    let fixed_nodes: Vec<NodeId> = (0..mesh.positions_m.len())
        .filter(|&n| mesh.positions_m[n].z < 1e-9)
        .map(NodeId::from_index)
        .collect();
    let stored = StoredNodes::All;
    let mut model = Precomputed::build(&PrecomputedParams {
        mesh: &mesh,
        material: &material,
        fixed_nodes: &fixed_nodes,
        stored,
        precision: Precision::F64,
        progress: None,
    })
    .unwrap();
    let (level, tilted) = (DVec3::new(0.0, 9.81, 0.0), DVec3::new(5.0, 8.0, -1.0));
    model.carry_at_rest(level);
    model.apply(&Constraints::default());
    model.step(1e-3);
    assert_eq!(model.state().positions_m, mesh.positions_m);
    model.set_gravity(tilted);
    model.step(1e-3);

    let mut weight_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(&mesh, &material, tilted - level, &mut weight_n);
    let solution = solve_static(&StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &BoundaryConditions::fixed(&fixed_nodes),
        nodal_force_n: &weight_n,
    })
    .unwrap();
    let largest_m = solution.displacement_m.iter().map(|u| u.length()).fold(0.0, f64::max);
    let error_m = |model: &Precomputed, scale: f64| {
        let found = model.state().positions_m.iter().zip(&mesh.positions_m).map(|(x, rest)| *x - *rest);
        found.zip(&solution.displacement_m).map(|(u, s)| u.distance(*s * scale)).fold(0.0, f64::max)
    };
    assert!(largest_m > 1e-3, "{largest_m}");
    assert!(error_m(&model, 1.0) < 1e-12 * largest_m, "{}", error_m(&model, 1.0));

    // From a file, for a tissue of twice the density.
    let file = tempfile::NamedTempFile::new().unwrap();
    model.save(file.path()).unwrap();
    let heavy = LinearElastic::from_young_poisson(5e3, 0.45, 2120.0).unwrap();
    let expected = PrecomputedExpectation { mesh: &mesh, material: &heavy, fixed_nodes: &fixed_nodes };
    let bytes = std::fs::read(file.path()).unwrap();
    let mut loaded = Precomputed::from_bytes(Path::new("liver"), &bytes, &expected).unwrap();
    loaded.set_gravity(tilted - level);
    loaded.apply(&Constraints::default());
    loaded.step(1e-3);
    assert!(error_m(&loaded, 2.0) < 1e-12 * largest_m, "{}", error_m(&loaded, 2.0));
}
