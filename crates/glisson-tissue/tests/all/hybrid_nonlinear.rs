//! Non-linear zones of the hybrids: balance of forces against the definition, the whole St Venant-Kirchhoff body, the
//! linear hybrid at small loads, turned pieces, cuts.

use crate::hybrid_condensed::{Bar, SIZE_M, STEP_S, displacements_of, largest_difference, run, sorted};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::zones::Zones;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::model::hybrid::condensed::{CondensedError, CondensedHybrid, CondensedParams, ZoneLaw};
use glisson_tissue::model::hybrid::exchange::{self, ExchangeParams, HybridExchange, Overlap};
use glisson_tissue::model::nonlinear_tensor_mass::{
    DirectBody, NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams, TetLaw,
};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, LocalModel, LocalWork, NodalForce, Rayleigh,
};
use glisson_tissue::solve::{MeshEdges, StiffnessTensors};

use ZoneLaw::{NonlinearTensorMass as Nonlinear, Precomputed, TensorMass};

fn part_of(mesh: &TetMesh, has: impl Fn(usize) -> bool) -> TetMesh {
    let tetrahedra = (0..mesh.tetrahedra.len()).filter(|&t| has(t)).map(|t| mesh.tetrahedra[t]).collect();
    TetMesh { positions_m: mesh.positions_m.clone(), tetrahedra, ..TetMesh::default() }
}

/// Largest unbalanced force at a free node over the largest outer one, the non-linear tetrahedra by their definition and
/// the others by their stiffness.
fn imbalance(bar: &Bar, is_nonlinear: impl Fn(usize) -> bool, u_m: &[DVec3], forces: &[NodalForce]) -> f64 {
    let curved = part_of(&bar.mesh, &is_nonlinear);
    let laws = vec![TetLaw::isotropic(&bar.material); curved.tetrahedra.len()];
    let mut force_n = vec![DVec3::ZERO; u_m.len()];
    DirectBody { mesh: &curved, laws: &laws, gamma_pa: 0.0 }.forces_into(u_m, &mut force_n);
    let straight = part_of(&bar.mesh, |t| !is_nonlinear(t));
    if !straight.tetrahedra.is_empty() {
        let edges = MeshEdges::of_mesh(&straight).unwrap();
        let tensors = StiffnessTensors::assemble(&straight, &edges, &bar.material).unwrap();
        let mut linear_n = force_n.clone();
        tensors.force_into(&edges, u_m, &mut linear_n);
        force_n.iter_mut().zip(&linear_n).for_each(|(f, linear)| *f += *linear);
    }
    forces.iter().for_each(|f| force_n[f.node.index()] -= f.force_n);
    bar.fixed.iter().for_each(|f| force_n[f.node.index()] = DVec3::ZERO);
    let largest = |f: &mut dyn Iterator<Item = DVec3>| f.map(|f| f.length()).fold(0.0, f64::max);
    largest(&mut force_n.into_iter()) / largest(&mut forces.iter().map(|f| f.force_n))
}

/// Forces that pull the outer zones of a bar of three slices apart lengthwise and bend them, balanced among themselves
/// but for the bending, so that the other zones bear little.
fn pull(bar: &Bar, size_n: f64) -> Vec<NodalForce> {
    let face = |x: f64| -> Vec<NodeId> {
        let on_face = |n: &usize| (bar.mesh.positions_m[*n].x - x * SIZE_M.x).abs() < 1e-9;
        (0..bar.mesh.positions_m.len()).filter(on_face).map(NodeId::from_index).collect()
    };
    let along = |nodes: Vec<NodeId>, force_n: DVec3| -> Vec<NodalForce> {
        let share = 1.0 / nodes.len() as f64;
        nodes.into_iter().map(|node| NodalForce { node, force_n: force_n * share }).collect()
    };
    let outward = along(face(1.0), DVec3::new(size_n, 0.0, -0.01 * size_n));
    let inward = along(face(0.8), DVec3::new(-size_n, 0.0, 0.01 * size_n));
    sorted([outward, inward].concat(), |f| f.node)
}

fn whole(bar: &Bar) -> NonlinearTensorMass {
    let elasticity = NonlinearElasticity {
        material: &bar.material,
        fibres: &[],
        volume_penalty_pa: 0.0,
        largest_stretch: 1.3,
    };
    NonlinearTensorMass::build(&NonlinearTensorMassParams { body: bar.body(), elasticity }).unwrap()
}

#[test]
fn a_nonlinear_zone_at_rest_balances_its_forces_with_the_condensed_rest() {
    let bar = Bar::new(3);
    let laws = [Precomputed, Precomputed, TensorMass, Precomputed, Nonlinear, Nonlinear];
    let law_of = |t: usize| laws[bar.zones.of_tets()[t] as usize];
    // A quarter to a third longer, and bent: far from linear.
    let forces = pull(&bar, 1.5);
    let mut model = bar.build(&laws);
    model.apply(&Constraints { displacements: vec![], forces: forces.clone() });
    run(&mut model, 6_000);
    assert_eq!(model.report().n_quarantined_tets, 0);
    let u_m = displacements_of(&model, &bar.mesh);
    let error = imbalance(&bar, |t| law_of(t) == Nonlinear, &u_m, &forces);
    // What is left of the motion after 1.2 s.
    assert!(error < 1e-5, "{error:e}");
    // The linear zones alone would not do: their balance is another one.
    let linear = imbalance(&bar, |_| false, &u_m, &forces);
    assert!(linear > 0.05, "{linear}");
}

#[test]
fn only_where_one_zone_deforms_much_it_is_the_whole_nonlinear_body() {
    let bar = Bar::new(3);
    let nonlinear = [Precomputed, Precomputed, Precomputed, Precomputed, Nonlinear, Nonlinear];
    let linear = nonlinear.map(|law| if law == Nonlinear { TensorMass } else { law });
    let at_rest = |model: &mut dyn DeformableModel, forces: Vec<NodalForce>| {
        model.apply(&Constraints { displacements: vec![], forces });
        run(model, 6_000);
        displacements_of(model, &bar.mesh)
    };
    let forces = pull(&bar, 1.5);
    let expected = at_rest(&mut whole(&bar), forces.clone());
    let longest_m = expected.iter().map(|u| u.x).fold(0.0, f64::max);
    assert!(longest_m > 0.2 * 0.2 * SIZE_M.x, "{longest_m} m");
    let error = largest_difference(&at_rest(&mut bar.build(&nonlinear), forces.clone()), &expected);
    let linear_error = largest_difference(&at_rest(&mut bar.build(&linear), forces), &expected);
    // 0.1 % and 20 % when this was written: what the pre-computed zones are off by, and the whole law.
    assert!(error < 0.02 && linear_error > 5.0 * error, "{error} {linear_error}");

    // Small loads: the linear hybrid, off in proportion to the strain.
    let mut errors = [1e-3, 1e-4].map(|share| {
        let forces = pull(&bar, 1.5 * share);
        let u_m = at_rest(&mut bar.build(&nonlinear), forces.clone());
        largest_difference(&u_m, &at_rest(&mut bar.build(&linear), forces))
    });
    errors[1] *= 10.0;
    assert!(errors[0] < 2e-3 && (errors[0] / errors[1] - 1.0).abs() < 0.05, "{errors:?}");
}

#[test]
fn nonlinear_zones_alone_are_the_nonlinear_tensor_mass_model() {
    let bar = Bar::new(2);
    // Not so much that the corner under a force turns inside out, nor displacements from one step to the next: of both the
    // models with a watch over their energy make something else.
    let weaker = |f: NodalForce| NodalForce { force_n: 0.3 * f.force_n, ..f };
    let constraints =
        Constraints { displacements: vec![], forces: bar.forces().into_iter().map(weaker).collect() };
    let mut reference = whole(&bar);
    let mut condensed = bar.build(&[Nonlinear; 4]);
    let fixed: Vec<NodeId> = bar.fixed.iter().map(|f| f.node).collect();
    let laws = [exchange::ZoneLaw::NonlinearTensorMass; 4];
    let params = ExchangeParams::new(&bar.mesh, &bar.material, &fixed, &bar.zones, &laws);
    let mut exchanged = HybridExchange::build(&ExchangeParams { damping_per_s: 30.0, ..params }).unwrap();
    let step_s = exchanged.stable_step_s().min(STEP_S) * 0.9;
    let models: [&mut dyn DeformableModel; 3] = [&mut reference, &mut condensed, &mut exchanged];
    let [reference, condensed, exchanged] = models.map(|model| {
        model.apply(&constraints);
        (0..600).for_each(|_| model.step(step_s));
        assert_eq!(model.report().n_quarantined_tets, 0);
        displacements_of(model, &bar.mesh)
    });
    let moved_m = reference.iter().map(|u| u.length()).fold(0.0, f64::max);
    assert!(moved_m > 0.003, "{moved_m}");
    let errors = [condensed, exchanged].map(|found| largest_difference(&found, &reference));
    assert!(errors.iter().all(|e| *e < 1e-8), "{errors:?}");
}

#[test]
fn the_exchange_comes_to_rest_with_nonlinear_forces_too() {
    let bar = Bar::new(3);
    let fixed: Vec<NodeId> = bar.fixed.iter().map(|f| f.node).collect();
    let laws = [0, 0, 1, 0, 2, 2].map(|l| {
        use exchange::ZoneLaw as Law;
        [Law::Precomputed, Law::TensorMass, Law::NonlinearTensorMass][l]
    });
    let is_nonlinear = |t: usize| bar.zones.of_tets()[t] >= 4;
    // With one node in common the frontier follows by a hundredth a sweep, else it swings up; so it is not all there yet.
    for (overlap, tolerance) in
        [(Overlap::Nodes(2), 1e-5), (Overlap::Nodes(3), 1e-5), (Overlap::OneNode { relaxation: 0.01 }, 1e-3)]
    {
        let forces = pull(&bar, 1.5);
        let params = ExchangeParams::new(&bar.mesh, &bar.material, &fixed, &bar.zones, &laws);
        let params = ExchangeParams { overlap, damping_per_s: 60.0, sweeps_per_step: 2, ..params };
        let mut model = HybridExchange::build(&params).unwrap();
        model.apply(&Constraints { displacements: vec![], forces: forces.clone() });
        (0..1200).for_each(|_| model.step(2e-3));
        let error = imbalance(&bar, is_nonlinear, model.displacements_m(), &forces);
        assert!(error < tolerance, "{overlap:?}: {error:e}");
        // A zone that is cut becomes what was asked for.
        let params = ExchangeParams { cut_law: exchange::ZoneLaw::NonlinearTensorMass, ..params };
        let mut model = HybridExchange::build(&params).unwrap();
        model.remove_tets(&bar.zones.tets(0).take(1).collect::<Vec<_>>()).unwrap();
        assert_eq!(model.laws()[0], exchange::ZoneLaw::NonlinearTensorMass);
    }
}

#[test]
fn a_cut_in_a_nonlinear_zone_is_the_model_built_anew() {
    let bar = Bar::new(3);
    let laws = [Precomputed, Precomputed, TensorMass, Precomputed, Nonlinear, Precomputed];
    let cut_law = Nonlinear;
    let mut model = CondensedHybrid::build(&CondensedParams { cut_law, ..bar.params(&laws) }).unwrap();
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    // In the zone itself, at its frontier, then in a pre-computed and in a linear one.
    let in_zone = |zone: usize| bar.zones.tets(zone).collect::<Vec<_>>();
    let edits = [
        in_zone(4)[30..33].to_vec(),
        in_zone(4)[..8].to_vec(),
        in_zone(5)[40..42].to_vec(),
        in_zone(2)[20..22].to_vec(),
    ];
    for tets in &edits {
        let change = mesh.apply(&MeshEdit::Remove { tets: tets.clone() }).unwrap();
        model.topology_changed(mesh.mesh(), &change).unwrap();
    }
    let gone = edits.concat();
    let stays = |t: &usize| !gone.contains(&TetId::from_index(*t));
    let of_tet = (0..bar.mesh.tetrahedra.len()).filter(stays).map(|t| bar.zones.of_tets()[t]).collect();
    let change = mesh.compact();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    let now = model.laws().to_vec();
    assert_eq!(now, [Precomputed, Precomputed, TensorMass, Precomputed, Nonlinear, Nonlinear]);
    let new_id = |f: &FixedNode| change.nodes.new_ids[f.node.index()].map(FixedNode::all_axes);
    let left = Bar {
        mesh: mesh.mesh().clone(),
        fixed: bar.fixed.iter().filter_map(new_id).collect(),
        zones: Zones::new(mesh.mesh(), of_tet).unwrap(),
        material: bar.material,
    };
    let mut anew = CondensedHybrid::build(&CondensedParams { cut_law, ..left.params(&now) }).unwrap();
    let mut copy = model.duplicate();
    let constraints = Constraints { displacements: left.displacements(), forces: left.forces() };
    let models: [&mut dyn DeformableModel; 3] = [&mut model, &mut anew, &mut *copy];
    let [edited, anew, copied] = models.map(|model| {
        model.take_over(&left.mesh.positions_m);
        model.apply(&constraints);
        model.set_gravity(DVec3::new(0.0, 3.0, -9.0));
        let count = allocation_counter::measure(|| run(model, 200));
        assert_eq!(count.count_total, 0);
        displacements_of(model, &left.mesh)
    });
    assert!(largest_difference(&edited, &anew) < 1e-10);
    assert_eq!(edited, copied);
}

/// Takes the outer zones off, so that they hang on nothing.
fn cut_off(bar: &Bar, cut_law: ZoneLaw) -> CondensedHybrid {
    let laws = [Precomputed; 6];
    let body = DynamicBody { damping: Rayleigh::default(), ..bar.body() };
    let params = CondensedParams { body, cut_law, ..bar.params(&laws) };
    let mut model = CondensedHybrid::build(&params).unwrap();
    let mut mesh = EditableMesh::new(bar.mesh.clone()).unwrap();
    let tets = [2, 3].into_iter().flat_map(|zone| bar.zones.tets(zone)).collect();
    let change = mesh.apply(&MeshEdit::Remove { tets }).unwrap();
    model.topology_changed(mesh.mesh(), &change).unwrap();
    assert_eq!(model.laws()[4..], [cut_law; 2]);
    model
}

#[test]
fn a_turned_piece_of_nonlinear_tissue_keeps_its_shape() {
    let bar = Bar::new(3);
    let centre_m = SIZE_M * DVec3::new(5.0 / 6.0, 0.5, 0.5);
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 1.8);
    let mut is_off = vec![false; bar.mesh.positions_m.len()];
    [4, 5].into_iter().flat_map(|z| bar.zones.nodes(z)).for_each(|n| is_off[n.index()] = true);
    let turn_m = |p: DVec3| centre_m + turn * (p - centre_m);
    let at_rest_m = bar.mesh.positions_m.iter().zip(&is_off);
    let turned: Vec<DVec3> = at_rest_m.map(|(&p, &off)| if off { turn_m(p) } else { p }).collect();
    let strays = |law: ZoneLaw| {
        let mut model = cut_off(&bar, law);
        model.take_over(&turned);
        run(&mut model, 50);
        let now = model.state().positions_m;
        let strayed_m = (0..now.len()).filter(|&n| is_off[n]).map(|n| now[n].distance(turned[n]));
        strayed_m.fold(0.0, f64::max) / SIZE_M.z
    };
    let (nonlinear, linear) = (strays(Nonlinear), strays(TensorMass));
    assert!(nonlinear < 1e-9 && linear > 0.1, "{nonlinear:e} {linear:e}");
}

#[test]
fn inverted_tetrahedra_are_told_by_the_meshes_numbers_and_bad_laws_are_refused() {
    let bar = Bar::new(3);
    let mut model = cut_off(&bar, Nonlinear);
    let mut squeezed = bar.mesh.positions_m.clone();
    squeezed.iter_mut().filter(|p| p.x > 0.95 * SIZE_M.x).for_each(|p| p.x = 0.85 * SIZE_M.x);
    model.take_over(&squeezed);
    model.step(STEP_S);
    let report = model.report();
    let first = report.first_quarantined.unwrap();
    assert!(report.n_quarantined_tets > 10);
    assert!(bar.mesh.corners_m(first).iter().any(|p| p.x > 0.95 * SIZE_M.x), "{first}");
    run(&mut model, 500);
    assert!(model.state().positions_m.iter().all(|p| p.is_finite()));

    let laws = [Precomputed; 6];
    let refused = |params| CondensedHybrid::build(&params).err().unwrap();
    let error = refused(CondensedParams { cut_law: Precomputed, ..bar.params(&laws) });
    assert_eq!(error, CondensedError::CutLaw { found: Precomputed });
    let error = refused(CondensedParams { largest_stretch: 0.5, ..bar.params(&laws) });
    assert!(error.to_string().contains("largest stretch"), "{error}");
}

#[test]
fn the_local_model_of_a_nonlinear_zone_is_that_of_the_whole_body() {
    let bar = Bar::new(2);
    let forces = bar.forces();
    let patch = [bar.node_at(1.0, 1.0, 1.0), bar.node_at(0.9, 1.0, 1.0)];
    let mut reference = whole(&bar);
    let mut hybrid = bar.build(&[Nonlinear; 4]);
    let models: [&mut dyn DeformableModel; 2] = [&mut reference, &mut hybrid];
    let [expected, found] = models.map(|model| {
        model.apply(&Constraints { displacements: vec![], forces: forces.clone() });
        model.set_gravity(DVec3::new(0.0, 0.0, -9.81));
        run(model, 400);
        let (mut work, mut local) =
            (LocalWork::with_room_for(bar.mesh.positions_m.len()), LocalModel::default());
        model.local_model_into(&patch, 1e-3, &mut work, &mut local);
        local.tensor_m_per_n(0, 1)
    });
    let size = |m: DMat3| m.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
    assert!(size(found - expected) < 1e-6 * size(expected), "{found} {expected}");
}
