//! The step, with a bed of independent springs in place of an elastic model.

use super::*;
use crate::mesh::edit::{MeshEdit, TopologyChange};
use crate::mesh::{NodeId, TetId};
use crate::model::{ImposedDisplacement, TopologyRefusal};
use crate::tool::Tool;
use spec::{Region, Support};

const STIFFNESS_N_PER_M: f64 = 100.0;

/// Every node on its own spring: forces and positions are known exactly.
#[derive(Clone)]
struct SpringBed {
    rest_m: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    imposed: Vec<ImposedDisplacement>,
    forces_n: Vec<DVec3>,
}

impl SpringBed {
    fn new(mesh: &TetMesh) -> Box<Self> {
        let rest_m = mesh.positions_m.clone();
        Box::new(Self { positions_m: rest_m.clone(), rest_m, imposed: Vec::new(), forces_n: Vec::new() })
    }
}

impl DeformableModel for SpringBed {
    fn apply(&mut self, constraints: &Constraints) {
        self.imposed.clone_from(&constraints.displacements);
    }

    fn step(&mut self, _dt_s: f64) {
        self.positions_m.clone_from(&self.rest_m);
        self.forces_n.clear();
        for c in &self.imposed {
            self.positions_m[c.node.index()] += c.displacement_m;
            self.forces_n.push(c.displacement_m * STIFFNESS_N_PER_M);
        }
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &[] }
    }

    fn history_into(&self, _numbers: &mut Vec<f64>) {}

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.positions_m.copy_from_slice(positions_m);
    }

    fn set_gravity(&mut self, _: DVec3) {}

    fn report(&self) -> ModelReport {
        ModelReport::default()
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    fn topology_changed(&mut self, _: &TetMesh, _: &TopologyChange) -> Result<(), TopologyRefusal> {
        Ok(())
    }
}

/// One tetrahedron with its largest face in z = 0, outward normal +z.
fn one_tetrahedron() -> TetMesh {
    let positions_m = vec![
        DVec3::new(0.0, 0.0, -0.1),
        DVec3::new(-0.1, -0.1, 0.0),
        DVec3::new(0.1, -0.1, 0.0),
        DVec3::new(0.0, 0.1, 0.0),
    ];
    let mesh = TetMesh { positions_m, tetrahedra: vec![[0, 1, 2, 3].map(NodeId)], ..TetMesh::default() };
    assert!(mesh.tet_volume_m3(TetId(0)) > 0.0);
    mesh
}

fn tool_at(z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(0.0, -0.03, z_m), DVec3::Z)
}

fn world(fixed: Vec<Region>) -> World {
    let mesh = one_tetrahedron();
    let tool = Tool::probe("probe", 0.01, tool_at(0.1));
    let model = SpringBed::new(&mesh);
    let mut spec = WorldSpec::new("test", 1e-3, tool);
    spec.supports = fixed.into_iter().map(Support::all_axes).collect();
    World::new(spec, mesh, model, ModelKind::Precomputed).unwrap()
}

fn input(z_m: f64) -> StepInput {
    StepInput::of(&[tool_at(z_m)])
}

#[test]
fn the_touched_point_follows_the_tool_and_the_force_pushes_back() {
    let mut world = world(vec![]);
    assert!(!world.step(&input(0.02)).in_contact());
    assert!(world.step(&input(0.005)).in_contact());
    let report = world.step(&input(-0.005));
    let point = world.snapshot().tools[0].contacts[0].unwrap().point_m;
    assert!((point.z + 0.015).abs() < 2e-5, "{point}");
    assert!(point.truncate().distance(glam::DVec2::new(0.0, -0.03)) < 1e-12);
    assert!(
        report.tools[0].force_on_tool_n.z > 0.0
            && report.tools[0].force_on_tool_n.truncate().length() < 1e-12
    );
}

#[test]
fn a_tool_that_withdraws_lets_go_and_the_organ_is_at_rest_again() {
    let mut world = world(vec![]);
    let rest = world.state_hash();
    for z in [0.02, 0.0, 0.008, 0.02, 0.05] {
        world.step(&input(z));
    }
    assert!(!world.report().in_contact());
    assert_eq!(world.report().tools[0].force_on_tool_n, DVec3::ZERO);
    assert_eq!(world.state_hash(), rest);
}

#[test]
fn a_tool_does_not_move_fixed_nodes() {
    let all = Region::Furthest { direction: DVec3::Z, fraction: 0.99 };
    let mut held = world(vec![all]);
    held.step(&input(0.02));
    let report = held.step(&input(-0.02));
    assert!(report.tools[0].blocked_by_fixed_tissue && !report.in_contact());
    assert_eq!(held.state().positions_m, one_tetrahedron().positions_m);

    let one = Region::Ball { center_m: DVec3::new(-0.1, -0.1, 0.0), radius_m: 1e-3 };
    let mut partly = world(vec![one]);
    partly.step(&input(0.02));
    assert!(partly.step(&input(-0.005)).in_contact());
    assert!(partly.constrained_nodes().iter().all(|c| c.node != NodeId(1)));
    assert!((partly.snapshot().tools[0].contacts[0].unwrap().point_m.z + 0.015).abs() < 2e-5);
}

#[test]
fn an_input_that_is_not_finite_is_refused_and_the_world_goes_on() {
    let mut world = world(vec![]);
    world.step(&input(0.005));
    let report = world.step(&input(f64::NAN));
    assert!(report.tools[0].input_rejected && report.in_contact() && report.n_non_finite_nodes == 0);
    assert_eq!(report.step, 2);
}

#[test]
fn a_step_waits_for_the_model_that_was_ordered_for_it() {
    let mut world = world(vec![]);
    world.queue_model_swap(2, ModelKind::TensorMass);
    world.step(&input(0.05));
    world.step(&input(0.05));
    assert_eq!(world.awaited_model(), Some(ModelKind::TensorMass));
    let report = world.step(&input(0.05));
    assert!(report.waits_for_model && report.step == 2);
    let spring_bed = || SpringBed::new(&one_tetrahedron());
    assert_eq!(world.deliver_model(spring_bed(), ModelKind::Precomputed), Ok(false));
    assert_eq!(world.deliver_model(spring_bed(), ModelKind::TensorMass), Ok(true));
    assert_eq!(world.step(&input(0.05)).step, 3);
    assert_eq!(world.model_kind(), ModelKind::TensorMass);
}

#[test]
fn reset_brings_the_rest_shape_and_the_tool_home() {
    let mut world = world(vec![]);
    let rest = world.state_hash();
    world.step(&input(0.0));
    assert_ne!(world.state_hash(), rest);
    world.reset();
    assert_eq!(world.state_hash(), rest);
    let snapshot = world.snapshot();
    assert!(snapshot.tools[0].contacts == [None; 3] && snapshot.tools[0].pose == tool_at(0.1));
    assert_eq!(snapshot.positions_m, world.display_topology().rest_positions_m);
}

#[test]
fn a_removed_tetrahedron_leaves_the_surface_and_the_hash_knows() {
    let mut world = world(vec![]);
    let whole = world.state_hash();
    let change = world.edit(&MeshEdit::Remove { tets: vec![TetId(0)] }).unwrap();
    assert_eq!(change.tets.removed, [TetId(0)]);
    assert!(world.display_topology().triangles.is_empty());
    assert_eq!(world.display_topology().version, 2);
    assert_ne!(world.state_hash(), whole);
    assert!(!world.step(&input(0.0)).in_contact());
    assert!(matches!(world.edit(&MeshEdit::Remove { tets: vec![TetId(0)] }), Err(EditRefusal::Mesh(_))));
}

#[test]
fn a_tool_that_is_placed_elsewhere_touches_nothing_on_the_way() {
    let mut world = world(vec![]);
    world.step(&input(0.0));
    assert!(world.report().in_contact());
    assert!(!world.step(&input(-0.5).placed()).in_contact());
    assert!(!world.step(&input(0.1).placed()).in_contact());
    assert!(world.step(&input(0.0)).in_contact());
}

#[test]
fn a_deep_tool_that_drags_sideways_keeps_its_contact() {
    let mut world = world(vec![]);
    world.step(&input(0.02));
    world.step(&input(0.0));
    for i in 1..20 {
        let mut sideways = input(0.0);
        sideways.tools[0].tip_in_world_m.x += 1e-3 * f64::from(i);
        assert!(world.step(&sideways).in_contact());
    }
    let point = world.snapshot().tools[0].contacts[0].unwrap().point_m;
    assert!((point.x - 0.019).abs() < 1e-12, "{point}");
}

#[test]
fn a_new_node_is_held_where_all_its_parents_are() {
    use crate::mesh::edit::EdgeSplit;
    let support = Support::all_axes(Region::Furthest { direction: DVec3::Z, fraction: 0.75 });
    let mesh = one_tetrahedron();
    let held = super::spec::fixed_nodes(&[support], &mesh.positions_m);
    let mut organ = Organ::new(mesh, &held, vec![0; 4]).unwrap();
    assert_eq!(organ.fixed_nodes(), [1, 2, 3].map(NodeId));
    // Near the held end of an edge whose other end moves, and between two held nodes.
    for ([a, b], is_held) in [([0, 1], false), ([1, 2], true)] {
        let edge = organ.body().topology().edge_between(NodeId(a), NodeId(b)).unwrap();
        let split = MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.9 }] };
        let change = organ.body_mut().apply(&split).unwrap();
        organ.follow_edit(&change, &mut organ::OrganBefore::default());
        let [new] = *change.nodes.added.ids() else { panic!("one new node") };
        assert_eq!(organ.is_fixed(new), is_held, "{a} {b}");
    }
}
