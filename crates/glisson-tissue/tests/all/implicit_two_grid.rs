//! Implicit bodies whose steps are preconditioned by two grids: the same motion as with a factor, also where they do not solve.

use crate::implicit::{bits, body, clamped};
use crate::model_meshes::{nodes_below, relative_difference, shaken_block};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::implicit::{
    ImplicitEuler, ImplicitLaw, ImplicitParams, ImplicitStatus, Preconditioner,
};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, NodalForce,
};

const SIZE_M: DVec3 = DVec3::new(0.12, 0.1, 0.08);
const STEP_S: f64 = 0.01;

struct Block {
    mesh: TetMesh,
    fixed: Vec<FixedNode>,
    law: ImplicitLaw,
}

impl Block {
    fn new() -> Self {
        let mesh = shaken_block([8, 7, 7], SIZE_M, 0.15, 12);
        let fixed = clamped(&nodes_below(&mesh, 2, 0.002));
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
        Self { mesh, fixed, law: ImplicitLaw::neo_hooke(&material) }
    }

    fn model(&self, preconditioner: Preconditioner, tolerance: f64) -> ImplicitEuler {
        let params = ImplicitParams::new(body(&self.mesh, &self.fixed), &self.law);
        ImplicitEuler::build(&ImplicitParams { preconditioner, tolerance, ..params }).unwrap()
    }

    fn nodes(&self, is_in: impl Fn(DVec3) -> bool) -> impl Iterator<Item = NodeId> {
        let all = self.mesh.positions_m.iter().enumerate();
        all.filter(move |(_, p)| is_in(**p)).map(|(n, _)| NodeId::from_index(n))
    }

    /// A load on the top that grows and turns.
    fn load(&self, step: usize) -> Constraints {
        let angle = 0.1 * step as f64;
        let force_n = DVec3::new(0.02 * libm::cos(angle), 0.0, -0.03) * (1.0 - libm::exp(-angle));
        let forces = self.nodes(|p| p.z > 0.076).map(|node| NodalForce { node, force_n }).collect();
        Constraints { displacements: Vec::new(), forces }
    }

    /// A tool that takes the middle of the top along.
    fn drag(&self, displacement_m: DVec3) -> Constraints {
        let middle = SIZE_M * DVec3::new(0.5, 0.5, 1.0);
        let held = self.nodes(|p| p.distance(middle) < 0.02);
        let displacements = held.map(|node| ImposedDisplacement { node, displacement_m }).collect();
        Constraints { displacements, forces: Vec::new() }
    }
}

#[test]
fn steps_end_where_those_with_a_factor_end() {
    let block = Block::new();
    let mut models = [Preconditioner::Factor, Preconditioner::TwoGrid].map(|by| block.model(by, 1e-9));
    let mut iterations = [0; 2];
    for step in 1..80 {
        for (model, iterations) in models.iter_mut().zip(&mut iterations) {
            model.apply(&block.load(step));
            model.step(STEP_S);
            let report = model.step_report();
            assert_eq!(report.status, ImplicitStatus::Converged, "{report:?}");
            *iterations += report.cg_iterations;
        }
        let [a, b] = [&models[0], &models[1]].map(ImplicitEuler::displacements_m);
        let apart = relative_difference(a, b);
        assert!(apart < 1e-6, "step {step}: {apart:e}");
    }
    assert!(iterations[1] < 4 * iterations[0], "{iterations:?}");
}

/// What a step leaves of the forces at the nodes neither pushes nor turns the body as a whole.
#[test]
fn a_body_that_falls_has_its_weight() {
    let block = Block::new();
    let free = DynamicBody { gravity_m_per_s2: DVec3::NEG_Z * 9.81, ..body(&block.mesh, &[]) };
    let params = ImplicitParams::new(free, &block.law);
    let mut model =
        ImplicitEuler::build(&ImplicitParams { preconditioner: Preconditioner::TwoGrid, ..params }).unwrap();
    let mut pull = block.load(30);
    pull.forces.truncate(5);
    let pull_n: DVec3 = pull.forces.iter().map(|f| f.force_n).sum();
    model.apply(&pull);
    let volume_m3 = SIZE_M.element_product();
    let mut speed_m_per_s = DVec3::ZERO;
    for _ in 0..50 {
        model.step(STEP_S);
        speed_m_per_s += (pull_n / (1000.0 * volume_m3) + DVec3::NEG_Z * 9.81) * STEP_S;
    }
    let kinetic_of_fall_j = 0.5 * 1000.0 * volume_m3 * speed_m_per_s.length_squared();
    let mean = model.state().velocities_m_per_s.iter().sum::<DVec3>() / block.mesh.positions_m.len() as f64;
    assert!((mean - speed_m_per_s).length() < 0.05 * speed_m_per_s.length(), "{mean} {speed_m_per_s}");
    assert!(model.report().kinetic_energy_j > 0.99 * kinetic_of_fall_j);
}

/// Tetrahedra pressed flat are many times stiffer than the others: two grids give way to a factor, and come back.
#[test]
fn where_two_grids_do_not_solve_a_factor_does_and_the_tissue_comes_back() {
    let block = Block::new();
    let mut model = block.model(Preconditioner::TwoGrid, 1e-3);
    let mut n_factors = 0;
    for step in 0..12 {
        model.apply(&block.drag(DVec3::NEG_Z * (0.012 * step as f64).min(0.09)));
        model.step(STEP_S);
        n_factors += model.step_report().n_factors;
        assert!(model.state().positions_m.iter().all(|p| p.is_finite()));
    }
    assert!(n_factors > 0);
    model.apply(&Constraints::default());
    for _ in 0..150 {
        model.step(0.05);
    }
    let off_m = model.displacements_m().iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!(off_m < 1e-4, "{off_m}");
    assert!(!model.step_report().factor_is_pending);
}

#[test]
fn an_edited_body_goes_on_as_one_built_of_what_is_left() {
    let block = Block::new();
    let mut model = block.model(Preconditioner::TwoGrid, 1e-9);
    let mut mesh = EditableMesh::new(block.mesh.clone()).unwrap();
    let corner = |t: &[NodeId; 4]| t.iter().all(|n| block.mesh.positions_m[n.index()].x < 0.05);
    let tets = (0..).zip(&block.mesh.tetrahedra).filter(|(_, t)| corner(t)).map(|(t, _)| TetId(t));
    let tets: Vec<TetId> = tets.filter(|t| t.0 % 5 == 0).collect();
    let change = mesh.apply(&MeshEdit::Remove { tets }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    let rest = mesh.live_mesh();
    let params = ImplicitParams::new(body(&rest, &block.fixed), &block.law);
    let mut built = ImplicitEuler::build(&ImplicitParams { tolerance: 1e-9, ..params }).unwrap();
    for step in 1..40 {
        for model in [&mut model, &mut built] {
            model.apply(&block.load(step));
            model.step(STEP_S);
        }
        let apart = relative_difference(model.displacements_m(), built.displacements_m());
        assert!(apart < 1e-6, "step {step}: {apart:e}");
    }
    assert!(!model.step_report().factor_is_pending);
}

#[test]
fn a_copy_and_a_restored_snapshot_have_the_same_bits() {
    let block = Block::new();
    let mut model = block.model(Preconditioner::TwoGrid, 1e-3);
    let go_on = |model: &mut ImplicitEuler, steps: std::ops::Range<usize>| {
        for step in steps {
            let phase = 0.05 * step as f64;
            model.apply(&block.drag(DVec3::new(libm::sin(phase), libm::sin(0.7 * phase), 0.0) * 0.03));
            model.step(STEP_S);
        }
    };
    let mut from = 0;
    // Also while values are being made.
    for _ in 0..2 {
        go_on(&mut model, from..from + 30);
        from += 30;
        while !model.step_report().factor_is_pending && from < 400 {
            go_on(&mut model, from..from + 1);
            from += 1;
        }
        let (saved, mut copy) = (model.snapshot(), model.clone());
        go_on(&mut model, from..from + 30);
        go_on(&mut copy, from..from + 30);
        assert_eq!(bits(&model), bits(&copy));
        copy.restore(&saved);
        go_on(&mut copy, from..from + 30);
        assert_eq!(bits(&model), bits(&copy));
        from += 30;
    }
}
