//! The hybrid model by exact condensation: against direct solutions, models built anew, and free fall.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::box_mesh::box_of_five;
use glisson_mesh::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit};
use glisson_mesh::mesh::zones::Zones;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::hybrid::condensed::{
    CondensedError, CondensedHybrid, CondensedParams, INSIDE_PERIOD_S, Loadable, MANY_LOADS, Precision,
    StoredNodes, Updated, ZoneLaw,
};
use glisson_tissue::model::{
    Attachment, Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, NodalForce,
    Rayleigh,
};
use glisson_tissue::solve::{
    BoundaryConditions, SolveError, StaticProblem, StaticSolution, add_gravity_forces, equilibrating_stress,
    solve_static,
};

use ZoneLaw::{Precomputed, TensorMass};

pub(crate) const SIZE_M: DVec3 = DVec3::new(0.10, 0.04, 0.03);
const CELLS: [usize; 3] = [10, 4, 3];
const DENSITY_KG_PER_M3: f64 = 1_000.0;
pub(crate) const STEP_S: f64 = 2e-4;

/// A bar of several zones.
pub(crate) struct Bar {
    pub(crate) mesh: TetMesh,
    pub(crate) material: LinearElastic,
    pub(crate) fixed: Vec<FixedNode>,
    pub(crate) zones: Zones,
}

impl Bar {
    /// Held at x = 0, in `along` zones along x, each divided in two along y: nodes of four zones stand inside.
    pub(crate) fn new(along: usize) -> Self {
        let mesh = box_of_five(CELLS, SIZE_M);
        let material = LinearElastic::from_young_poisson(5_000.0, 0.45, DENSITY_KG_PER_M3).unwrap();
        let fixed = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].x == 0.0)
            .map(|n| FixedNode::all_axes(NodeId::from_index(n)))
            .collect();
        let zones = Zones::new(&mesh, zone_of_tets(&mesh, along)).unwrap();
        Self { mesh, material, fixed, zones }
    }

    pub(crate) fn body(&self) -> DynamicBody<'_> {
        DynamicBody {
            fixed: &self.fixed,
            damping: Rayleigh::of_mass(30.0),
            time_step_s: STEP_S,
            ..DynamicBody::new(&self.mesh, DENSITY_KG_PER_M3)
        }
    }

    pub(crate) fn params<'a>(&'a self, laws: &'a [ZoneLaw]) -> CondensedParams<'a> {
        CondensedParams::new(self.body(), &self.material, &self.zones, laws)
    }

    pub(crate) fn build(&self, laws: &[ZoneLaw]) -> CondensedHybrid {
        CondensedHybrid::build(&self.params(laws)).unwrap()
    }

    pub(crate) fn node_at(&self, x: f64, y: f64, z: f64) -> NodeId {
        let wanted = SIZE_M * DVec3::new(x, y, z);
        let far = |n: &usize| self.mesh.positions_m[*n].distance(wanted);
        let nearest = (0..self.mesh.positions_m.len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap();
        NodeId::from_index(nearest)
    }

    /// Forces on nodes of one zone, of two and of four, and inside.
    pub(crate) fn forces(&self) -> Vec<NodalForce> {
        let at = [
            (self.node_at(1.0, 1.0, 1.0), DVec3::new(0.0, 0.01, -0.03)),
            (self.node_at(0.5, 0.0, 1.0), DVec3::new(0.01, 0.0, -0.01)),
            (self.node_at(0.5, 0.5, 0.4), DVec3::new(0.0, -0.02, 0.01)),
            (self.node_at(0.8, 0.5, 1.0), DVec3::new(0.01, 0.01, 0.0)),
        ];
        sorted(at.map(|(node, force_n)| NodalForce { node, force_n }).to_vec(), |f| f.node)
    }

    /// Displacements of nodes of several zones and of the frontiers between them.
    pub(crate) fn displacements(&self) -> Vec<ImposedDisplacement> {
        let at = [
            (self.node_at(0.9, 1.0, 1.0), DVec3::new(0.001, 0.0, -0.002)),
            (self.node_at(0.8, 1.0, 1.0), DVec3::new(0.0, 0.0, -0.002)),
            (self.node_at(0.2, 0.0, 1.0), DVec3::new(0.0, 0.0005, -0.0003)),
            (self.node_at(0.5, 0.5, 1.0), DVec3::new(0.0, 0.001, 0.0)),
            (self.node_at(0.3, 0.5, 1.0), DVec3::new(0.0002, 0.0, 0.0)),
        ];
        let imposed = at.map(|(node, displacement_m)| ImposedDisplacement { node, displacement_m });
        sorted(imposed.to_vec(), |d| d.node)
    }

    fn direct(&self, constraints: &Constraints, gravity_m_per_s2: DVec3) -> StaticSolution {
        let mut conditions = BoundaryConditions::new();
        self.fixed.iter().for_each(|f| conditions.fix_node(f.node));
        constraints.displacements.iter().for_each(|d| conditions.impose_node(d.node, d.displacement_m));
        let mut force_n = vec![DVec3::ZERO; self.mesh.positions_m.len()];
        constraints.forces.iter().for_each(|f| force_n[f.node.index()] += f.force_n);
        add_gravity_forces(&self.mesh, &self.material, gravity_m_per_s2, &mut force_n);
        let (mesh, material) = (&self.mesh, &self.material);
        let problem = StaticProblem { mesh, material, conditions: &conditions, nodal_force_n: &force_n };
        solve_static(&problem).unwrap()
    }

    /// Largest difference from the direct solution over its largest displacement, and the same of the tools' forces.
    fn errors(
        &self,
        model: &dyn DeformableModel,
        constraints: &Constraints,
        gravity_m_per_s2: DVec3,
    ) -> [f64; 2] {
        let direct = self.direct(constraints, gravity_m_per_s2);
        let error = largest_difference(&displacements_of(model, &self.mesh), &direct.displacement_m);
        let forces: Vec<DVec3> =
            constraints.displacements.iter().map(|d| direct.reaction_n[d.node.index()]).collect();
        let of_forces =
            if forces.is_empty() { 0.0 } else { largest_difference(model.constraint_forces_n(), &forces) };
        [error, of_forces]
    }
}

fn zone_of_tets(mesh: &TetMesh, along: usize) -> Vec<u32> {
    let of_tet = |t: usize| {
        let corners_m = mesh.corners_m(TetId::from_index(t));
        let centre_m = corners_m.into_iter().sum::<DVec3>() / 4.0;
        let slice = (centre_m.x / SIZE_M.x * along as f64).floor().min(along as f64 - 1.0) as u32;
        2 * slice + u32::from(centre_m.y > 0.5 * SIZE_M.y)
    };
    (0..mesh.tetrahedra.len()).map(of_tet).collect()
}

pub(crate) fn sorted<T>(mut list: Vec<T>, node: impl Fn(&T) -> NodeId) -> Vec<T> {
    list.sort_by_key(|x| node(x));
    list
}

pub(crate) fn displacements_of(model: &dyn DeformableModel, mesh: &TetMesh) -> Vec<DVec3> {
    model.state().positions_m.iter().zip(&mesh.positions_m).map(|(p, r)| *p - *r).collect()
}

pub(crate) fn largest_difference(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let scale = b.iter().map(|x| x.length()).fold(0.0, f64::max);
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / scale
}

pub(crate) fn run(model: &mut dyn DeformableModel, n_steps: usize) {
    (0..n_steps).for_each(|_| model.step(STEP_S));
}

#[test]
fn precomputed_zones_follow_loads_and_tools_as_the_direct_solution() {
    let bar = Bar::new(2);
    let loaded = Constraints { displacements: vec![], forces: bar.forces() };
    let held = Constraints { displacements: bar.displacements(), forces: vec![] };
    let both = Constraints { displacements: bar.displacements(), forces: bar.forces() };
    let every = (0..bar.mesh.positions_m.len()).map(NodeId::from_index).filter(|n| {
        !bar.fixed.iter().any(|f| f.node == *n) && !both.displacements.iter().any(|d| d.node == *n)
    });
    let force_n = DVec3::new(1e-4, 2e-4, -1e-4);
    let many = Constraints {
        displacements: bar.displacements(),
        forces: every.map(|node| NodalForce { node, force_n }).collect(),
    };
    // On inner nodes too, whose columns are not stored with the surface alone: through the factors.
    assert!(many.forces.len() > 2 * MANY_LOADS);
    let gravity_m_per_s2 = DVec3::new(0.0, 2.0, -9.81);
    for (stored, loadable, precision, tolerance) in [
        (StoredNodes::All, Loadable::All, Precision::F64, 1e-10),
        (StoredNodes::All, Loadable::Surface, Precision::F64, 1e-10),
        (StoredNodes::Surface, Loadable::Surface, Precision::F64, 1e-10),
        (StoredNodes::Surface, Loadable::Surface, Precision::F32, 2e-6),
    ] {
        let laws = [Precomputed; 4];
        let params = CondensedParams { loadable, stored, precision, ..bar.params(&laws) };
        let mut model = CondensedHybrid::build(&params).unwrap();
        assert_eq!(model.size().n_precomputed_zones, 4);
        for gravity_m_per_s2 in [DVec3::ZERO, gravity_m_per_s2] {
            model.set_gravity(gravity_m_per_s2);
            for constraints in [&loaded, &held, &both, &many] {
                model.apply(constraints);
                model.step(STEP_S);
                assert_eq!(model.report().n_ignored_constraints, 0);
                let errors = bar.errors(&model, constraints, gravity_m_per_s2);
                // Forces that hold displacements amplify rounding by the compliance's condition.
                assert!(
                    errors[0] < tolerance && errors[1] < 10.0 * tolerance,
                    "{stored:?} {loadable:?} {errors:?}"
                );
            }
        }
    }
}

#[test]
fn only_what_is_asked_for_is_brought_up_to_date() {
    let bar = Bar::new(2);
    let mut model = bar.build(&[Precomputed; 4]);
    let force = NodalForce { node: bar.node_at(1.0, 1.0, 1.0), force_n: DVec3::new(0.0, 0.0, -0.03) };
    let constraints = Constraints { displacements: vec![], forces: vec![force] };
    let direct = bar.direct(&constraints, DVec3::ZERO).displacement_m;
    model.apply(&constraints);
    for (updated, n_least, n_most) in
        [(Updated::LoadedZones, 60, 120), (Updated::Surface, 180, 202), (Updated::All, 220, 220)]
    {
        model.take_over(&bar.mesh.positions_m);
        model.set_updated(updated);
        model.step(STEP_S);
        let shown = displacements_of(&model, &bar.mesh);
        let right = shown.iter().zip(&direct).filter(|(a, b)| a.distance(**b) < 1e-12).count();
        assert!((n_least..=n_most).contains(&right), "{updated:?}: {right}");
        let moved = shown.iter().filter(|u| **u != DVec3::ZERO).count();
        assert!(moved <= right, "{updated:?}: {moved} nodes moved, {right} are right");
    }
}

#[test]
fn a_dynamic_zone_comes_to_rest_at_the_direct_solution() {
    let bar = Bar::new(3);
    let both = Constraints { displacements: bar.displacements(), forces: bar.forces() };
    let gravity_m_per_s2 = DVec3::new(0.0, 0.0, -9.81);
    for laws in [
        [Precomputed, Precomputed, TensorMass, Precomputed, Precomputed, Precomputed],
        [Precomputed, Precomputed, TensorMass, TensorMass, Precomputed, TensorMass],
        [TensorMass; 6],
    ] {
        let mut model = bar.build(&laws);
        model.set_gravity(gravity_m_per_s2);
        model.apply(&both);
        run(&mut model, 6_000);
        let errors = bar.errors(&model, &both, gravity_m_per_s2);
        assert!(errors[0] < 1e-6 && errors[1] < 1e-5, "{laws:?}: {errors:?}");
        // Tools in pre-computed tissue are exactly where they should be in every step.
        model.take_over(&bar.mesh.positions_m);
        model.step(STEP_S);
        for d in &both.displacements {
            let n = d.node.index();
            let u_m = model.state().positions_m[n] - bar.mesh.positions_m[n];
            assert!(u_m.distance(d.displacement_m) < 1e-12, "{laws:?}");
        }
    }
}

/// Nothing loads the pre-computed zones, and the one at the wall does not border on the dynamic ones.
#[test]
fn what_moves_dynamic_tissue_moves_the_zones_behind_its_neighbours() {
    let bar = Bar::new(3);
    let end = bar.node_at(1.0, 0.0, 1.0);
    let pulled = Constraints {
        displacements: vec![ImposedDisplacement { node: end, displacement_m: DVec3::new(2e-3, 0.0, 1e-3) }],
        forces: vec![],
    };
    let laws = [Precomputed, Precomputed, Precomputed, Precomputed, TensorMass, TensorMass];
    let mut model = bar.build(&laws);
    model.apply(&pulled);
    run(&mut model, 12_000);
    let errors = bar.errors(&model, &pulled, DVec3::ZERO);
    assert!(errors.iter().all(|e| *e < 1e-5), "{errors:?}");
}

#[test]
fn tissue_that_jumped_back_is_not_thrown_on_when_it_is_cut() {
    let bar = Bar::new(2);
    let mut model = bar.build(&[Precomputed; 4]);
    let node = bar.node_at(1.0, 1.0, 1.0);
    let pulled = vec![ImposedDisplacement { node, displacement_m: DVec3::X * 0.01 }];
    model.apply(&Constraints { displacements: pulled, forces: vec![] });
    run(&mut model, 3);
    model.apply(&Constraints::default());
    model.step(STEP_S);
    assert!(model.state().velocities_m_per_s[node.index()].length() > 10.0, "it has no inertia");
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    let change = mesh.apply(&MeshEdit::Remove { tets: bar.zones.tets(3).take(1).collect() }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    for _ in 0..500 {
        model.step(STEP_S);
        let strayed = displacements_of(&model, &bar.mesh).iter().map(|u| u.length()).fold(0.0, f64::max);
        assert!(strayed < 1e-6, "{strayed:e} m");
    }
}

#[test]
fn a_shape_imaged_under_gravity_stays_as_it_is() {
    let bar = Bar::new(3);
    let gravity_m_per_s2 = DVec3::new(1.0, 0.0, -9.81);
    let stress = equilibrating_stress(&bar.mesh, &bar.material, &bar.fixed, &[], gravity_m_per_s2).unwrap();
    let laws = [Precomputed, Precomputed, TensorMass, Precomputed, Precomputed, TensorMass];
    let body = DynamicBody { rest_stress_pa: &stress, gravity_m_per_s2, ..bar.body() };
    let mut model = CondensedHybrid::build(&CondensedParams { body, ..bar.params(&laws) }).unwrap();
    run(&mut model, 100);
    let strayed = displacements_of(&model, &bar.mesh).iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!(strayed < 1e-12, "{strayed:e} m");
    // Tilted: the static solution of the difference.
    let tilted = DVec3::new(0.0, 5.0, -8.0);
    model.set_gravity(tilted);
    let none = Constraints::default();
    let tilt = bar.direct(&none, tilted - gravity_m_per_s2).displacement_m;
    let there_m: Vec<DVec3> = bar.mesh.positions_m.iter().zip(&tilt).map(|(p, u)| *p + *u).collect();
    model.take_over(&there_m);
    run(&mut model, 100);
    assert!(bar.errors(&model, &none, tilted - gravity_m_per_s2)[0] < 1e-9);
}

#[test]
fn the_condensed_stiffness_is_below_the_assembled_one_and_energy_stays_bounded() {
    let bar = Bar::new(3);
    let laws = [Precomputed, Precomputed, TensorMass, TensorMass, Precomputed, Precomputed];
    let body = DynamicBody { damping: Rayleigh::default(), time_step_s: 1.0, ..bar.body() };
    let mut model = CondensedHybrid::build(&CondensedParams { body, ..bar.params(&laws) }).unwrap();
    let whole =
        glisson_tissue::model::tensor_mass::TensorMass::stable_step(&bar.mesh, &bar.material).unwrap();
    let stable_s = model.stable_step_s().unwrap();
    assert!(stable_s >= 0.99 * whole.step_s, "{stable_s} {}", whole.step_s);

    // Pulled aside and let go, at the largest step: the work of the pull is all the energy there is.
    let force = NodalForce { node: bar.node_at(1.0, 1.0, 1.0), force_n: DVec3::new(0.0, 0.01, -0.03) };
    let pulled = Constraints { displacements: vec![], forces: vec![force] };
    let at_rest = bar.direct(&pulled, DVec3::ZERO).displacement_m;
    let work_j = 0.5 * force.force_n.dot(at_rest[force.node.index()]);
    let start_m: Vec<DVec3> = bar.mesh.positions_m.iter().zip(&at_rest).map(|(p, u)| *p + *u).collect();
    model.take_over(&start_m);
    let mut largest_j = 0.0_f64;
    for _ in 0..20_000 {
        model.step(stable_s);
        largest_j = largest_j.max(model.report().kinetic_energy_j);
    }
    assert!(largest_j > 0.1 * work_j && largest_j < 1.05 * work_j, "{largest_j:e} of {work_j:e} J");
    assert!(!model.report().energy_was_limited);
}

/// An edit of the mesh as it then is.
type EditOf = Box<dyn Fn(&EditableMesh) -> MeshEdit>;

/// The bar after `edits`, beside the model that is built from what is left with the same laws.
fn edited_and_anew(bar: &Bar, laws: &[ZoneLaw], edits: &[EditOf]) -> (Vec<ZoneLaw>, [f64; 3]) {
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    let mut model = bar.build(laws);
    let (mut of_tet, mut fixed) = (bar.zones.of_tets().to_vec(), bar.fixed.clone());
    for edit in edits {
        let change = mesh.apply(&edit(&mesh)).unwrap();
        model.topology_changed(mesh.mesh(), &change).unwrap();
        // A zone has what comes of its tetrahedra; a node is held that comes of held ones.
        for (_, parents) in change.tets.added.iter() {
            of_tet.push(of_tet[parents[0].0.index()]);
        }
        for (node, parents) in change.nodes.added.iter() {
            let is_held = |of: NodeId| fixed.iter().any(|f| f.node == of);
            if parents.iter().all(|(parent, _)| is_held(*parent)) {
                fixed.push(FixedNode::all_axes(node));
            }
        }
    }
    let change = mesh.compact();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    if !change.tets.new_ids.is_empty() {
        let stays = |t: &usize| change.tets.new_ids[*t].is_some();
        of_tet = (0..of_tet.len()).filter(stays).map(|t| of_tet[t]).collect();
        let kept = fixed.iter().filter_map(|f| change.nodes.new_ids[f.node.index()]);
        fixed = kept.map(FixedNode::all_axes).collect();
    }

    let left = Bar {
        mesh: mesh.mesh().clone(),
        fixed,
        zones: Zones::new(mesh.mesh(), of_tet).unwrap(),
        material: bar.material,
    };
    let now = model.laws().to_vec();
    let mut anew = left.build(&now);
    let stiffness = {
        let (nodes, edited) = model.condensed_stiffness_n_per_m();
        let (anew_nodes, anew) = anew.condensed_stiffness_n_per_m();
        assert_eq!(nodes, anew_nodes);
        let scale = anew.iter().fold(1e-300, |m: f64, x| m.max(x.abs()));
        edited.iter().zip(anew).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / scale
    };
    let constraints = Constraints { displacements: left.displacements(), forces: left.forces() };
    for model in [&mut model, &mut anew] {
        model.take_over(&left.mesh.positions_m);
        model.apply(&constraints);
        model.set_gravity(DVec3::new(0.0, 3.0, -9.0));
        assert_eq!(model.parts_of_step(STEP_S), 1);
        run(model, 200);
    }
    let shape =
        largest_difference(&displacements_of(&model, &left.mesh), &displacements_of(&anew, &left.mesh));
    let forces = largest_difference(model.constraint_forces_n(), anew.constraint_forces_n());
    (now, [stiffness, shape, forces])
}

#[test]
fn after_any_edit_it_is_the_model_built_anew() {
    let bar = Bar::new(3);
    let mut laws = vec![Precomputed; 6];
    let in_zone = |zone: usize| bar.zones.tets(zone).collect::<Vec<_>>();
    // A zone that is cut becomes dynamic; the others stay.
    let remove = |tets: &[TetId]| -> EditOf {
        let tets = tets.to_vec();
        Box::new(move |_| MeshEdit::Remove { tets: tets.clone() })
    };
    let (now, errors) = edited_and_anew(&bar, &laws, &[remove(&in_zone(4)[30..33])]);
    laws[4] = TensorMass;
    assert_eq!(now, laws);
    assert!(errors.iter().all(|e| *e < 1e-10), "{errors:?}");
    // Further cuts there, then in its neighbour, one after the other and at the frontier, so that nodes between the
    // zones lose their dynamic tetrahedra.
    let mut edits: Vec<EditOf> = in_zone(4).chunks(9).take(4).map(remove).collect();
    edits.push(remove(&in_zone(5)[20..24]));
    let (now, errors) = edited_and_anew(&bar, &laws, &edits);
    laws[5] = TensorMass;
    assert_eq!(now, laws);
    assert!(errors.iter().all(|e| *e < 1e-10), "{errors:?}");
}

/// Divided edges, opened vertices and moved ones: inside a zone, and on the frontiers of two and of four.
#[test]
fn after_an_edit_that_brings_something_in_it_is_the_model_built_anew() {
    let bar = Bar::new(3);
    let split = |from: NodeId, fraction: f64| -> EditOf {
        Box::new(move |mesh| {
            let topology = mesh.topology();
            let edge = topology.live_edges().find(|edge| topology.edge_nodes(*edge).contains(&from)).unwrap();
            MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction }] }
        })
    };
    let part = |node: NodeId| -> EditOf {
        Box::new(move |mesh| {
            let at = &mesh.topology().node_tets(node);
            MeshEdit::DuplicateVertex { node, tets_of_copy: at[..at.len() / 2].to_vec() }
        })
    };
    let shift = |node: NodeId| -> EditOf {
        Box::new(move |mesh| {
            let position_m = mesh.mesh().positions_m[node.index()] + DVec3::new(4e-4, -3e-4, 5e-4);
            MeshEdit::MoveVertex { node, position_m }
        })
    };
    let inside = bar.node_at(0.85, 0.8, 0.5);
    let (of_two, of_four) = (bar.node_at(0.85, 0.5, 0.5), bar.node_at(2.0 / 3.0, 0.5, 0.5));
    let anywhere = bar.node_at(0.2, 0.8, 1.0);
    let edits: [(&str, Vec<EditOf>); 8] = [
        ("an edge", vec![split(inside, 0.4)]),
        ("an edge at two zones", vec![split(of_two, 0.3)]),
        ("an edge at four zones", vec![split(of_four, 0.6)]),
        ("a vertex", vec![part(inside)]),
        ("a vertex of four zones", vec![part(of_four)]),
        ("a moved vertex of four zones", vec![shift(of_four)]),
        ("a vertex moved twice", vec![shift(inside), shift(inside)]),
        (
            "all of it",
            vec![
                split(inside, 0.4),
                part(inside),
                split(inside, 0.6),
                shift(of_two),
                part(of_two),
                split(anywhere, 0.5),
                part(anywhere),
            ],
        ),
    ];
    for start in [Precomputed, TensorMass] {
        for (what, edits) in &edits {
            let mut laws = vec![Precomputed; 6];
            laws[5] = start;
            let (now, errors) = edited_and_anew(&bar, &laws, edits);
            assert!(now.contains(&TensorMass), "{what}");
            assert!(errors.iter().all(|e| *e < 1e-10), "{what}: {errors:?}");
        }
    }
}

#[test]
fn a_zone_that_is_cut_goes_on_with_its_position_and_velocity() {
    let bar = Bar::new(2);
    let mut model = bar.build(&[Precomputed; 4]);
    let force = |share: f64| {
        let force_n = share * DVec3::new(0.0, 0.01, -0.03);
        let forces = vec![NodalForce { node: bar.node_at(1.0, 1.0, 1.0), force_n }];
        Constraints { displacements: vec![], forces }
    };
    // Slowly, so that the energy is that of tissue in use and is not limited.
    for share in [0.999, 1.0] {
        model.apply(&force(share));
        model.step(STEP_S);
    }
    let before = (model.state().positions_m.to_vec(), model.state().velocities_m_per_s.to_vec());
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    let cut = bar.zones.tets(3).take(1).collect();
    let change = mesh.apply(&MeshEdit::Remove { tets: cut }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    assert_eq!(model.laws()[3], TensorMass);
    assert_eq!(model.state().positions_m, before.0);
    let n = bar.node_at(0.9, 1.0, 1.0).index();
    let moved_m = before.0[n] - bar.mesh.positions_m[n];
    assert!((before.1[n] * STEP_S / moved_m.length()).length() > 0.9e-3);
    // The loads are kept; the nodes go on with their velocity.
    model.step(STEP_S);
    let way_m = model.state().positions_m[n] - before.0[n];
    assert!(way_m.distance(before.1[n] * STEP_S) < 0.2 * way_m.length(), "{way_m} {}", before.1[n] * STEP_S);
}

#[test]
fn a_cut_starts_from_where_the_tissue_is_whatever_was_shown() {
    let bar = Bar::new(2);
    let force = |share: f64| {
        let force_n = share * DVec3::new(0.0, 0.01, -0.03);
        let forces = vec![NodalForce { node: bar.node_at(1.0, 1.0, 1.0), force_n }];
        Constraints { displacements: vec![], forces }
    };
    // Evenly, so that the mean velocity since nodes were shown is the last one.
    let shares = [0.997, 0.998, 0.999, 1.0];
    // One zone is loaded, and one is moved by it alone.
    for (stored, zone) in [StoredNodes::All, StoredNodes::Surface].into_iter().zip([3, 1]) {
        let laws = [Precomputed; 4];
        let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
        let cut = bar.zones.tets(zone).take(1).collect();
        let change = mesh.apply(&MeshEdit::Remove { tets: cut }).unwrap();
        let runs =
            [Updated::All, Updated::Surface, Updated::SurfaceFirst, Updated::LoadedZones].map(|updated| {
                let mut model =
                    CondensedHybrid::build(&CondensedParams { stored, ..bar.params(&laws) }).unwrap();
                for (i, share) in shares.into_iter().enumerate() {
                    model.apply(&force(share));
                    model.set_updated(if i < 2 { Updated::All } else { updated });
                    model.step(STEP_S);
                }
                let shown = displacements_of(&model, &bar.mesh);
                model.topology_changed(mesh.mesh(), &change).unwrap();
                assert_eq!(model.laws()[zone], TensorMass);
                assert_eq!(model.report().n_reanalyses, 1);
                model.set_updated(Updated::All);
                let at_cut = displacements_of(&model, &bar.mesh);
                run(&mut model, 20);
                (shown, at_cut, displacements_of(&model, &bar.mesh))
            });
        let [(_, at_cut, after), others @ ..] = runs;
        assert!(largest_difference(&after, &at_cut) > 1e-3);
        for (shown, other_at_cut, other_after) in others {
            assert!(largest_difference(&shown, &at_cut) > 1e-4, "was stale");
            assert!(largest_difference(&other_at_cut, &at_cut) < 1e-12, "{stored:?}");
            let error = largest_difference(&other_after, &after);
            assert!(error < 1e-9, "{stored:?}: {error:e}");
        }
    }
}

#[test]
fn places_inside_follow_the_surface_within_their_period() {
    let bar = Bar::new(2);
    let laws = [Precomputed; 4];
    let mut models = [Updated::All, Updated::Surface, Updated::SurfaceFirst].map(|updated| {
        let params = CondensedParams { stored: StoredNodes::Surface, ..bar.params(&laws) };
        let mut model = CondensedHybrid::build(&params).unwrap();
        model.set_updated(updated);
        model
    });
    let mut run = |n_steps: usize, force_n: DVec3| {
        let forces = vec![NodalForce { node: bar.node_at(1.0, 1.0, 1.0), force_n }];
        models.each_mut().map(|model| {
            model.apply(&Constraints { displacements: vec![], forces: forces.clone() });
            (0..n_steps).for_each(|_| model.step(STEP_S));
            displacements_of(model, &bar.mesh)
        })
    };
    // At first every zone in a step of its own, from the rest shape that was given.
    let [all, _, in_turn] = run(laws.len(), DVec3::new(0.0, 0.01, -0.03));
    assert!(largest_difference(&all, &in_turn) < 1e-12);
    let other_n = DVec3::new(0.0, -0.02, 0.01);
    let [all, surface, in_turn] = run(1, other_n);
    let [never, later] = [surface, in_turn].map(|shown| largest_difference(&all, &shown));
    assert!(never > 1e-4 && later > 1e-4, "{never:e} {later:e}");
    let [all, surface, in_turn] = run((INSIDE_PERIOD_S / STEP_S).ceil() as usize + laws.len(), other_n);
    let [never, later] = [surface, in_turn].map(|shown| largest_difference(&all, &shown));
    assert!(never > 1e-4 && later < 1e-12, "{never:e} {later:e}");
    // The surface at once.
    let [all, _, in_turn] = run(1, DVec3::new(0.01, 0.0, 0.0));
    let is_outside = |p: &DVec3| p.min_element() < 1e-9 || (SIZE_M - *p).min_element() < 1e-9;
    let outside = bar.mesh.positions_m.iter().zip(all.iter().zip(&in_turn)).filter(|(p, _)| is_outside(p));
    let lag = outside.map(|(_, (all, in_turn))| all.distance(*in_turn)).fold(0.0, f64::max);
    assert!(lag < 1e-12 && largest_difference(&all, &in_turn) > 1e-5, "{lag:e}");
}

#[test]
fn positions_taken_over_give_precomputed_tissue_no_velocity() {
    let bar = Bar::new(2);
    let mut model = bar.build(&[Precomputed; 4]);
    model.set_updated(Updated::Surface);
    model.apply(&Constraints { displacements: vec![], forces: bar.forces() });
    let fastest = |model: &CondensedHybrid| {
        model.state().velocities_m_per_s.iter().map(|v| v.length()).fold(0.0, f64::max)
    };
    for _ in 0..2 {
        model.take_over(&bar.mesh.positions_m);
        run(&mut model, 2);
        model.set_updated(Updated::All);
        model.step(STEP_S);
        assert!(largest_difference(&displacements_of(&model, &bar.mesh), &bar.mesh.positions_m) > 1e-2);
        // Without a tool that moves, nothing does after the jump.
        assert!(fastest(&model) < 1e-9, "{}", fastest(&model));
    }
}

#[test]
fn a_piece_cut_loose_falls() {
    let bar = Bar::new(5);
    let laws = vec![Precomputed; 10];
    let body = DynamicBody { damping: Rayleigh::default(), ..bar.body() };
    let mut model = CondensedHybrid::build(&CondensedParams { body, ..bar.params(&laws) }).unwrap();
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    // A slice two fifths along the bar is taken out, so that the zones beyond it hang on nothing.
    let slice: Vec<TetId> = (0..bar.mesh.tetrahedra.len())
        .map(TetId::from_index)
        .filter(|&t| {
            let x = bar.mesh.corners_m(t).into_iter().map(|p| p.x).sum::<f64>() / 4.0;
            (0.4..0.5).contains(&(x / SIZE_M.x))
        })
        .collect();
    let change = mesh.apply(&MeshEdit::Remove { tets: slice }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    let mut expected = vec![TensorMass; 10];
    expected[..4].fill(Precomputed);
    assert_eq!(model.laws(), expected);
    model.set_gravity(DVec3::new(0.0, 0.0, -9.81));
    run(&mut model, 250);
    let n = bar.node_at(1.0, 0.0, 0.0).index();
    let fallen_m = bar.mesh.positions_m[n].z - model.state().positions_m[n].z;
    let t_s = 250.0 * STEP_S;
    // Central differences fall half a step further.
    let expected_m = 0.5 * 9.81 * t_s * (t_s + STEP_S);
    assert!((fallen_m / expected_m - 1.0).abs() < 1e-9, "{fallen_m} {expected_m}");
}

#[test]
fn steps_allocate_nothing_and_copies_have_the_same_bits() {
    let bar = Bar::new(3);
    let laws = [Precomputed, Precomputed, TensorMass, Precomputed, Precomputed, Precomputed];
    let build = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| {
            let params = CondensedParams { stored: StoredNodes::Surface, ..bar.params(&laws) };
            CondensedHybrid::build(&params).unwrap()
        })
    };
    let constraints = [
        Constraints { displacements: bar.displacements(), forces: bar.forces() },
        Constraints { displacements: bar.displacements()[1..].to_vec(), forces: vec![] },
    ];
    let mut model = build(1);
    model.apply(&constraints[0]);
    run(&mut model, 10);
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    let inside: Vec<TetId> = bar.zones.tets(2).collect();
    let change = mesh.apply(&MeshEdit::Remove { tets: inside[10..12].to_vec() }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    let mut copy = model.duplicate();
    let mut other = build(2);
    other.apply(&constraints[0]);
    run(&mut other, 10);
    other.topology_changed(mesh.mesh(), &change).unwrap();
    for model in [&mut model as &mut dyn DeformableModel, &mut *copy, &mut other] {
        let count = allocation_counter::measure(|| {
            for i in 0..50 {
                model.apply(&constraints[i % 2]);
                model.set_gravity(DVec3::new(0.0, 0.0, -0.1 * i as f64));
                model.step(STEP_S);
            }
        });
        assert_eq!(count.count_total, 0);
    }
    for other in [&*copy, &other as &dyn DeformableModel] {
        assert_eq!(model.state().positions_m, other.state().positions_m);
        assert_eq!(model.history(), other.history());
        assert_eq!(model.constraint_forces_n(), other.constraint_forces_n());
    }
}

#[test]
fn what_cannot_be_is_refused_and_what_cannot_be_done_is_counted() {
    let bar = Bar::new(2);
    let refused = |params: CondensedParams<'_>| CondensedHybrid::build(&params).err().unwrap();
    let error = refused(bar.params(&[Precomputed; 3]));
    assert_eq!(error, CondensedError::Laws { found: 3, n_zones: 4 });
    let laws = [Precomputed; 4];
    let (node, anchor_m) = (bar.node_at(1.0, 1.0, 1.0), DVec3::ZERO);
    let ligament = [Attachment { node, anchor_m, slack_length_m: 0.1, stiffness_n_per_m: 1.0 }];
    let body = DynamicBody { attachments: &ligament, ..bar.body() };
    assert_eq!(refused(CondensedParams { body, ..bar.params(&laws) }), CondensedError::Ligament { node });
    let body = DynamicBody { fixed: &bar.fixed[..2], ..bar.body() };
    let error = refused(CondensedParams { body, ..bar.params(&laws) });
    assert!(matches!(error, CondensedError::Solve(SolveError::Floating { rigid_modes: 1, .. })), "{error}");

    let mut model = bar.build(&laws);
    let fixed = bar.fixed[0].node;
    let inner = bar.node_at(0.7, 0.75, 0.4);
    assert!(!model.is_loadable(inner) && !model.is_loadable(fixed) && model.is_loadable(node));
    model.apply(&Constraints {
        displacements: sorted(
            vec![
                ImposedDisplacement { node: inner, displacement_m: DVec3::X },
                ImposedDisplacement { node: fixed, displacement_m: DVec3::X },
                ImposedDisplacement { node, displacement_m: DVec3::NAN },
            ],
            |d| d.node,
        ),
        forces: vec![NodalForce { node: NodeId(10_000), force_n: DVec3::X }],
    });
    model.step(STEP_S);
    assert_eq!(model.report().n_ignored_constraints, 4);
    assert_eq!(model.constraint_forces_n(), [DVec3::ZERO; 3]);
    assert!(displacements_of(&model, &bar.mesh).iter().all(|u| *u == DVec3::ZERO));

    // More than one a node: what has no room is counted.
    let n_nodes = bar.mesh.positions_m.len();
    let forces = vec![NodalForce { node, force_n: DVec3::ZERO }; n_nodes + 7];
    model.apply(&Constraints { displacements: vec![], forces });
    model.step(STEP_S);
    assert_eq!(model.report().n_ignored_constraints, 7);

    // Also when an edit follows.
    let nowhere = ImposedDisplacement { node: NodeId(10_000), displacement_m: DVec3::X };
    model.apply(&Constraints { displacements: vec![nowhere], forces: vec![] });
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    let moved = MeshEdit::MoveVertex { node, position_m: bar.mesh.positions_m[node.index()] * 1.001 };
    let change = mesh.apply(&moved).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    model.step(STEP_S);
    assert_eq!(model.report().n_ignored_constraints, 1);
}
