//! A world that computes less thoroughly leaves something out, follows its instruments all the same, and comes back.

use glam::DVec3;
use glisson_mesh::mesh::{NodeId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson_tissue::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, LevelOfDetail,
};

/// A row of cubes of five tetrahedra each, 1 cm wide.
fn bar() -> TetMesh {
    let n = 6;
    let mut mesh = TetMesh::default();
    for x in 0..=n {
        for corner in [[0, 0], [1, 0], [1, 1], [0, 1]] {
            mesh.positions_m
                .push(DVec3::new(f64::from(x), f64::from(corner[0]), f64::from(corner[1])) * 0.01);
        }
    }
    for x in 0..n as u32 {
        let at = |dx: u32, corner: u32| NodeId(4 * (x + dx) + corner);
        // Corners 0 to 3 of this end, 4 to 7 of the next; the diagonals of neighbours meet.
        let c = [at(0, 0), at(0, 1), at(0, 2), at(0, 3), at(1, 0), at(1, 1), at(1, 2), at(1, 3)];
        let five = if x % 2 == 0 {
            [[0, 1, 3, 4], [1, 2, 3, 6], [1, 5, 6, 4], [3, 6, 7, 4], [1, 3, 4, 6]]
        } else {
            [[0, 1, 2, 5], [0, 2, 3, 7], [0, 5, 7, 4], [2, 5, 6, 7], [0, 2, 5, 7]]
        };
        mesh.tetrahedra.extend(five.map(|tet| tet.map(|corner: usize| c[corner])));
    }
    for tet in 0..mesh.tetrahedra.len() {
        let [a, b, c, d] = mesh.tetrahedra[tet].map(|node| mesh.positions_m[node.index()]);
        if (b - a).cross(c - a).dot(d - a) < 0.0 {
            mesh.tetrahedra[tet].swap(2, 3);
        }
    }
    mesh
}

fn push(model: &mut dyn DeformableModel, last: NodeId, y_m: f64) {
    let displacement_m = DVec3::new(0.0, y_m, 0.0);
    let displacements = vec![ImposedDisplacement { node: last, displacement_m }];
    model.apply(&Constraints { displacements, forces: Vec::new() });
    model.step(1e-3);
}

fn bodies() -> (TetMesh, Vec<FixedNode>, LinearElastic, NodeId) {
    let mesh = bar();
    let fixed = (0..4).map(|node| FixedNode::all_axes(NodeId(node))).collect();
    let last = NodeId::from_index(mesh.positions_m.len() - 1);
    (mesh, fixed, LinearElastic::from_young_poisson(5_000.0, 0.4, 1_000.0).unwrap(), last)
}

#[test]
fn implicit_steps_take_fewer_iterations_with_less_effort_and_held_nodes_still_arrive() {
    let (mesh, fixed, material, last) = bodies();
    let law = ImplicitLaw::neo_hooke(&material);
    let body = DynamicBody { fixed: &fixed, ..DynamicBody::new(&mesh, 1_000.0) };
    // Strict, so that the full effort has something to do.
    let params = ImplicitParams { tolerance: 1e-10, ..ImplicitParams::new(body, &law) };
    let start = ImplicitEuler::build(&params).unwrap();
    let iterations = |effort| {
        let mut model = start.clone();
        assert!(model.set_level_of_detail(effort));
        let mut most = 0;
        for step in 1..=15 {
            push(&mut model, last, 2e-3 * f64::from(step));
            most = most.max(model.step_report().newton_iterations);
            let place_m = model.state().positions_m[last.index()] - mesh.positions_m[last.index()];
            assert!(place_m.distance(DVec3::Y * 2e-3 * f64::from(step)) < 1e-12, "{effort:?}: {place_m}");
        }
        most
    };
    let (full, least) = (iterations(LevelOfDetail::Full), iterations(LevelOfDetail::Least));
    assert!(least <= 2 && full > least, "{full} and {least} iterations");
}

#[test]
fn nonlinear_tensor_mass_leaves_small_forces_out_and_takes_them_back() {
    let (mesh, fixed, material, last) = bodies();
    let elasticity = NonlinearElasticity {
        material: &material,
        fibres: &[],
        volume_penalty_pa: 0.0,
        largest_stretch: 1.3,
    };
    let body = DynamicBody { fixed: &fixed, time_step_s: 2e-4, ..DynamicBody::new(&mesh, 1_000.0) };
    let mut model = NonlinearTensorMass::build(&NonlinearTensorMassParams { body, elasticity }).unwrap();
    let share = |effort: LevelOfDetail| {
        assert!(model.set_level_of_detail(effort));
        push(&mut model, last, 1e-4);
        model.adaptive_report().nonlinear_share()
    };
    assert_eq!([LevelOfDetail::Full, LevelOfDetail::Least, LevelOfDetail::Full].map(share), [1.0, 0.0, 1.0]);
}

#[test]
fn efforts_go_down_and_up_and_end() {
    let all = [LevelOfDetail::Full, LevelOfDetail::Reduced, LevelOfDetail::Least];
    assert_eq!(
        all.map(LevelOfDetail::less),
        [LevelOfDetail::Reduced, LevelOfDetail::Least, LevelOfDetail::Least]
    );
    assert_eq!(
        all.map(LevelOfDetail::more),
        [LevelOfDetail::Full, LevelOfDetail::Full, LevelOfDetail::Reduced]
    );
}
