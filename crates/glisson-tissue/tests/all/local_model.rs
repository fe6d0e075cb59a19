//! The compliance of a patch for a haptic loop: against exact inverses and against what the models do.

use crate::model_meshes::{block, held, nodes_below, shaken_block};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::zones::Zones;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::LinearElastic;
use glisson_tissue::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson_tissue::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use glisson_tissue::model::hybrid::condensed::{CondensedHybrid, CondensedParams, Updated, ZoneLaw};
use glisson_tissue::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson_tissue::model::kernel::{KernelLaw, KernelPath};
use glisson_tissue::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use glisson_tissue::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson_tissue::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson_tissue::model::reduced::{Reduced, ReducedParams};
use glisson_tissue::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson_tissue::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, Integration, LocalModel,
    LocalWork, NodalForce, Rayleigh,
};
use glisson_tissue::solve::{BoundaryConditions, FreeSystem, MeshEdges, StiffnessTensors};

const DENSITY_KG_PER_M3: f64 = 1060.0;

struct Body {
    mesh: TetMesh,
    material: LinearElastic,
    fixed_nodes: Vec<NodeId>,
    fixed: Vec<FixedNode>,
}

impl Body {
    fn of(mesh: TetMesh, below_m: f64) -> Self {
        let fixed_nodes = nodes_below(&mesh, 2, below_m);
        let fixed = held(&fixed_nodes);
        let material = LinearElastic::from_young_poisson(5e3, 0.4, DENSITY_KG_PER_M3).unwrap();
        Self { mesh, material, fixed_nodes, fixed }
    }

    fn small() -> Self {
        Self::of(shaken_block([3, 2, 3], DVec3::new(0.06, 0.05, 0.06), 0.1, 3), 0.005)
    }

    fn large() -> Self {
        Self::of(shaken_block([9, 9, 8], DVec3::new(0.09, 0.09, 0.08), 0.15, 4), 0.003)
    }

    fn dynamics(&self, damping: Rayleigh, time_step_s: f64) -> DynamicBody<'_> {
        DynamicBody {
            fixed: &self.fixed,
            damping,
            time_step_s,
            ..DynamicBody::new(&self.mesh, DENSITY_KG_PER_M3)
        }
    }

    fn stable_step_s(&self) -> f64 {
        TensorMass::stable_step(&self.mesh, &self.material).unwrap().step_s
    }

    fn tensor_mass(&self, damping: Rayleigh, time_step_s: f64) -> TensorMass {
        let body = self.dynamics(damping, time_step_s);
        TensorMass::build(&TensorMassParams { body, material: &self.material }).unwrap()
    }

    /// Every model with the law of linear elasticity at rest, with its name.
    fn elastic_models(&self, damping: Rayleigh, time_step_s: f64) -> Vec<(String, Box<dyn DeformableModel>)> {
        let body = self.dynamics(damping, time_step_s);
        let material = &self.material;
        let mut models: Vec<(String, Box<dyn DeformableModel>)> = Vec::new();
        models.push(("tensor_mass".into(), Box::new(self.tensor_mass(damping, time_step_s))));
        let elasticity =
            NonlinearElasticity { material, fibres: &[], volume_penalty_pa: 0.0, largest_stretch: 1.05 };
        let params = NonlinearTensorMassParams { body, elasticity };
        models.push(("nonlinear_tensor_mass".into(), Box::new(NonlinearTensorMass::build(&params).unwrap())));
        for law in [
            KernelLaw::Linear,
            KernelLaw::StVenantKirchhoff,
            KernelLaw::NeoHookeLog,
            KernelLaw::StableNeoHooke,
        ] {
            let materials = [*material];
            let params = ExplicitKernelParams {
                largest_stretch: 1.05,
                ..ExplicitKernelParams::new(body, law, &materials)
            };
            models.push((format!("explicit {law:?}"), Box::new(ExplicitKernel::build(&params).unwrap())));
        }
        for law in [EdgeLaw::StVenantKirchhoff, EdgeLaw::NeoHooke] {
            let params = ExtendedMassSpringParams {
                body,
                law,
                material,
                viscosity_kg_per_m3_s: 0.0,
                integration: Integration::default(),
            };
            let model = ExtendedMassSpring::build(&params).unwrap();
            models.push((format!("extended_mass_spring {law:?}"), Box::new(model)));
        }
        for law in [ImplicitLaw::neo_hooke(material), ImplicitLaw::shared(*material)] {
            let model =
                ImplicitEuler::build(&ImplicitParams { tolerance: 1e-10, ..ImplicitParams::new(body, &law) })
                    .unwrap();
            models.push((format!("implicit {law:?}"), Box::new(model)));
        }
        models
    }

    fn springs(&self, damping: Rayleigh, time_step_s: f64) -> MassSpring {
        MassSpring::build(&MassSpringParams {
            body: self.dynamics(damping, time_step_s),
            young_modulus_pa: 5e3,
            masses: NodalMasses::VolumeWeighted,
            link_damping_n_s_per_m: 0.0,
            node_damping_n_s_per_m: 0.0,
            integration: Integration::default(),
        })
        .unwrap()
    }

    /// The `n` free nodes that are nearest to the middle of the top.
    fn patch(&self, n: usize) -> Vec<NodeId> {
        let top = self.mesh.positions_m.iter().fold(DVec3::ZERO, |m, p| m.max(*p));
        let touched = top * DVec3::new(0.5, 0.5, 1.0);
        let mut nodes: Vec<NodeId> = (0..self.mesh.positions_m.len()).map(NodeId::from_index).collect();
        nodes.retain(|node| self.fixed_nodes.binary_search(node).is_err());
        let far = |node: &NodeId| self.mesh.positions_m[node.index()].distance(touched);
        nodes.sort_by(|a, b| far(a).total_cmp(&far(b)));
        nodes.truncate(n);
        nodes
    }

    /// The patch's part of (M/h^2 + D/h + K)^-1 of the whole body.
    fn exact(&self, patch: &[NodeId], damping: Rayleigh, period_s: f64) -> Vec<f64> {
        let mut mass_kg = vec![0.0; self.mesh.positions_m.len()];
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate() {
            let share_kg = DENSITY_KG_PER_M3 * self.mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
            nodes.iter().for_each(|n| mass_kg[n.index()] += share_kg);
        }
        let edges = MeshEdges::of_mesh(&self.mesh).unwrap();
        let mut tensors = StiffnessTensors::assemble(&self.mesh, &edges, &self.material).unwrap();
        let per_stiffness = 1.0 + damping.stiffness_s / period_s;
        tensors.vertex.iter_mut().chain(&mut tensors.edge).for_each(|b| *b *= per_stiffness);
        for (n, b) in tensors.vertex.iter_mut().enumerate() {
            let kg = mass_kg[n];
            *b += DMat3::from_diagonal(DVec3::splat(kg * (1.0 / period_s + damping.mass_per_s) / period_s));
        }
        let conditions = BoundaryConditions::fixed(&self.fixed_nodes);
        let system = FreeSystem::new(&edges, &tensors, &conditions).unwrap();
        let factor = system.factorize().unwrap();
        let mut scratch = factor.scratch(1);
        let n = 3 * patch.len();
        let mut compliance = vec![0.0; n * n];
        for j in 0..n {
            let mut right = vec![0.0; system.n_free()];
            right[system.row_of(patch[j / 3], j % 3).unwrap()] = 1.0;
            factor.solve_in_place(&mut right, 1, &mut scratch);
            for i in 0..n {
                compliance[n * i + j] = right[system.row_of(patch[i / 3], i % 3).unwrap()];
            }
        }
        compliance
    }
}

fn local(model: &mut dyn DeformableModel, patch: &[NodeId], period_s: f64) -> LocalModel {
    let mut work = LocalWork::with_room_for(model.state().positions_m.len());
    let mut out = LocalModel::new();
    model.local_model_into(patch, period_s, &mut work, &mut out);
    out
}

/// Largest difference over the largest entry of `expected`.
fn difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    found.iter().zip(expected).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / largest
}

fn is_positive_definite(mut a: Vec<f64>) -> bool {
    let n = a.len().isqrt();
    for k in 0..n {
        if a[n * k + k] <= 0.0 {
            return false;
        }
        for i in k + 1..n {
            let factor = a[n * i + k] / a[n * k + k];
            for j in k + 1..n {
                a[n * i + j] -= factor * a[n * k + j];
            }
        }
    }
    true
}

#[test]
fn rings_around_the_patch_are_within_a_hundredth_of_the_whole_body() {
    let body = Body::large();
    let step_s = 0.9 * body.stable_step_s();
    let mut model = body.tensor_mass(Rayleigh::default(), step_s);
    for damping in [Rayleigh::default(), Rayleigh { mass_per_s: 20.0, stiffness_s: 1e-4 }] {
        if damping != Rayleigh::default() {
            model = body.tensor_mass(damping, 0.5 * step_s);
        }
        for n in [3, 8, 20] {
            for period_s in [0.25 * step_s, step_s, 2.0 * step_s] {
                if (n == 8) != (period_s == step_s) && damping != Rayleigh::default() {
                    continue;
                }
                let patch = body.patch(n);
                let found = local(&mut model, &patch, period_s);
                let error = difference(&found.compliance_m_per_n, &body.exact(&patch, damping, period_s));
                assert!(error < 0.01, "{n} nodes, {period_s} s, {:?} rings: {error}", found.n_rings);
                assert!(!found.is_inertial);
                assert!(is_positive_definite(found.compliance_m_per_n.clone()));
                let m = 3 * n;
                for (i, x) in found.compliance_m_per_n.iter().enumerate() {
                    assert_eq!(*x, found.compliance_m_per_n[m * (i % m) + i / m], "symmetric");
                }
            }
        }
    }
}

#[test]
fn at_rest_all_elastic_models_say_the_same() {
    let body = Body::small();
    let patch = body.patch(5);
    let damping = Rayleigh { mass_per_s: 5.0, stiffness_s: 0.0 };
    let step_s = 0.5 * body.stable_step_s();
    let mut models = body.elastic_models(damping, step_s);
    for period_s in [step_s, 1e-3, 1.0] {
        let exact = body.exact(&patch, damping, period_s);
        for (name, model) in &mut models {
            let found = local(&mut **model, &patch, period_s);
            let error = difference(&found.compliance_m_per_n, &exact);
            assert!(error < 1e-2, "{name}, {period_s} s: {error}, {:?} rings", found.n_rings);
        }
    }
}

/// Runs to rest under constant forces on the patch.
fn settled(model: &dyn DeformableModel, forces: &[NodalForce], dt_s: f64, n_steps: usize) -> Vec<DVec3> {
    let mut model = model.duplicate();
    model.apply(&Constraints { displacements: vec![], forces: forces.to_vec() });
    (0..n_steps).for_each(|_| model.step(dt_s));
    model.state().positions_m.to_vec()
}

#[test]
fn over_a_long_period_it_is_the_change_of_the_loaded_equilibrium() {
    let body = Body::small();
    let mut patch = body.patch(3);
    patch.sort_unstable();
    let damping = Rayleigh::of_mass(40.0);
    let step_s = 0.4 * body.stable_step_s();
    let mut models = body.elastic_models(damping, step_s);
    models.push(("mass_spring".into(), Box::new(body.springs(damping, 0.5 * step_s))));
    for (name, mut model) in models {
        // Implicit steps may be long; what they damp does not matter.
        let (dt_s, n_steps) = if name.starts_with("implicit") { (0.05, 150) } else { (step_s, 3_000) };
        let force_n = DVec3::new(0.06, -0.03, -0.09);
        let load = |change_n: DVec3| -> Vec<NodalForce> {
            let of =
                |(i, &node)| NodalForce { node, force_n: if i == 0 { force_n + change_n } else { force_n } };
            patch.iter().enumerate().map(of).collect()
        };
        model.apply(&Constraints { displacements: vec![], forces: load(DVec3::ZERO) });
        (0..n_steps).for_each(|_| model.step(dt_s));
        let found = local(&mut *model, &patch, 1e3);
        assert!(!found.is_inertial, "{name}");
        for (i, force) in load(DVec3::ZERO).iter().enumerate() {
            assert_eq!(found.force_n[i], force.force_n, "{name}");
        }
        let strain_m = (found.position_m[0] - body.mesh.positions_m[patch[0].index()]).length();
        assert!(strain_m > 1e-3, "{name}: {strain_m}");
        let change_n = 1e-5;
        let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
        for axis in DVec3::AXES {
            let [more, less] =
                [1.0, -1.0].map(|s| settled(&*model, &load(axis * (s * change_n)), dt_s, n_steps / 2));
            for (i, node) in patch.iter().enumerate() {
                let expected = (more[node.index()] - less[node.index()]) / (2.0 * change_n);
                let answer = found.tensor_m_per_n(i, 0) * axis;
                worst = worst.max(answer.distance(expected));
                largest = largest.max(expected.length());
            }
        }
        assert!(worst < 2e-3 * largest, "{name}: {}", worst / largest);
    }
}

#[test]
fn over_a_short_step_it_is_what_a_small_force_does() {
    let body = Body::small();
    let patch = body.patch(4);
    let step_s = 0.05 * body.stable_step_s();
    let mut models = body.elastic_models(Rayleigh::of_mass(10.0), step_s);
    models.push(("mass_spring".into(), Box::new(body.springs(Rayleigh::of_mass(10.0), step_s))));
    for (name, mut model) in models {
        let found = local(&mut *model, &patch, step_s);
        let force = NodalForce { node: patch[1], force_n: DVec3::new(1e-4, 2e-4, -1e-4) };
        let [with, without] = [vec![force], vec![]].map(|forces| settled(&*model, &forces, step_s, 1));
        let mut worst = 0.0_f64;
        let answer = |i: usize| found.tensor_m_per_n(i, 1) * force.force_n;
        for (i, node) in patch.iter().enumerate() {
            worst = worst.max(answer(i).distance(with[node.index()] - without[node.index()]));
        }
        let error = worst / answer(1).length();
        // Explicit steps leave out K h^2/M <= 4 (0.05)^2; an implicit step is the same equation.
        let tolerance = if name.starts_with("implicit") { 2e-4 } else { 0.02 };
        assert!(error < tolerance, "{name}: {error}");
    }
}

/// What the elements' forces have changed by is what the next step begins with: with it, where a node goes in a single stable
/// step is known.
#[test]
fn an_explicit_step_is_known_from_the_last_ones_and_the_change_of_forces() {
    let body = Body::small();
    let patch = body.patch(6);
    // Of some laws the tangent is stiffer where they are squeezed.
    let step_s = 0.4 * body.stable_step_s();
    let mut models = body.elastic_models(Rayleigh::default(), step_s);
    models.retain(|(name, _)| !name.starts_with("implicit"));
    models.push(("mass_spring".into(), Box::new(body.springs(Rayleigh::default(), 0.5 * step_s))));
    for (name, mut model) in models {
        let dt_s = if name == "mass_spring" { 0.5 * step_s } else { step_s };
        let force_n = DVec3::new(0.03, -0.01, -0.05);
        let forces = patch.iter().map(|&node| NodalForce { node, force_n }).collect();
        model.apply(&Constraints { displacements: vec![], forces });
        (0..20).for_each(|_| model.step(dt_s));
        let before = model.state().velocities_m_per_s.to_vec();
        model.step(dt_s);
        let mut work = LocalWork::with_room_for(100).from_one_ring().telling_drift();
        work.set_telling_changes(true);
        let mut found = LocalModel::new();
        model.local_model_into(&patch, dt_s, &mut work, &mut found);
        let state = model.state();
        let goes_on = |(i, node): (usize, &NodeId)| {
            let v = state.velocities_m_per_s[node.index()];
            let balance_n = (v - before[node.index()]) * (found.mass_kg[i] / dt_s);
            let there_m = |force_n: DVec3| {
                state.positions_m[node.index()] + v * dt_s + force_n * (dt_s * dt_s / found.mass_kg[i])
            };
            [there_m(balance_n), there_m(balance_n + found.changed_n[i].unwrap())]
        };
        let expected_m: Vec<[DVec3; 2]> = patch.iter().enumerate().map(goes_on).collect();
        model.step(dt_s);
        let positions_m = model.state().positions_m;
        let off_m = |which: usize| {
            let pairs = patch.iter().zip(&expected_m);
            pairs.map(|(node, m)| positions_m[node.index()].distance(m[which])).fold(0.0, f64::max)
        };
        assert!(off_m(1) < 0.05 * off_m(0), "{name}: {:e}, without the change {:e}", off_m(1), off_m(0));
    }
}

/// What touch asks for in short steps: the masses alone, which is all that answers.
#[test]
fn a_short_step_of_the_explicit_kernel_is_answered_by_its_masses() {
    let body = Body::small();
    let patch = body.patch(4);
    let materials = [body.material];
    let rest = ExplicitKernelParams {
        largest_stretch: 1.05,
        ..ExplicitKernelParams::new(
            body.dynamics(Rayleigh::default(), 1e-6),
            KernelLaw::StableNeoHooke,
            &materials,
        )
    };
    let stable_s = ExplicitKernel::stable_step(&rest).unwrap().step_s;
    // Steps of one part and of two; in the second, neighbours begin to answer.
    for (time_step_s, period_s, tolerance) in
        [(0.8 * stable_s, 0.8 * stable_s, 1e-7), (0.15 * stable_s, 0.3 * stable_s, 0.03)]
    {
        let dynamics = body.dynamics(Rayleigh::of_mass(40.0), time_step_s);
        let params = ExplicitKernelParams {
            largest_stretch: 1.05,
            ..ExplicitKernelParams::new(dynamics, KernelLaw::StableNeoHooke, &materials)
        };
        let mut model = ExplicitKernel::build(&params).unwrap();
        let mut work = LocalWork::with_room_for(100).from_one_ring();
        let mut found = LocalModel::new();
        model.local_model_into(&patch, period_s, &mut work, &mut found);
        assert!(found.is_inertial && found.n_rings == Some(0));
        let force = NodalForce { node: patch[1], force_n: DVec3::new(1e-3, 2e-3, -1e-3) };
        let [with, without] = [vec![force], vec![]].map(|forces| settled(&model, &forces, period_s, 1));
        for (i, node) in patch.iter().enumerate() {
            let moved_m = with[node.index()] - without[node.index()];
            let off_m = (found.tensor_m_per_n(i, 1) * force.force_n).distance(moved_m);
            let largest_m = (found.tensor_m_per_n(1, 1) * force.force_n).length();
            assert!(off_m <= tolerance * largest_m, "{i}: {off_m:e} of {largest_m:e}");
        }
        // Longer periods, and who does not ask for short ones, have the tissue's answer.
        model.local_model_into(&patch, 4.0 * stable_s, &mut work, &mut found);
        assert!(!found.is_inertial && found.n_rings > Some(0));
        assert!(local(&mut model, &patch, period_s).n_rings > Some(0));
    }
}

#[test]
fn an_implicit_step_is_answered_by_its_factor() {
    let body = Body::large();
    let law = ImplicitLaw::shared(body.material);
    let params = ImplicitParams::new(body.dynamics(Rayleigh::of_mass(3.0), 0.01), &law);
    let mut model = ImplicitEuler::build(&params).unwrap();
    let patch = body.patch(3);
    let found = local(&mut model, &patch, 0.01);
    assert_eq!(found.n_rings, None);
    let exact = body.exact(&patch, Rayleigh::of_mass(3.0), 0.01);
    let error = difference(&found.compliance_m_per_n, &exact);
    assert!(error < 1e-9, "{error:e}");
    // A held patch is let go: its nodes are cut off in the factor, so rings must answer.
    let displacements = |z_m: f64| {
        let mut nodes = patch.clone();
        nodes.sort_unstable();
        let imposed = |node| ImposedDisplacement { node, displacement_m: DVec3::new(0.0, 0.0, z_m) };
        Constraints { displacements: nodes.into_iter().map(imposed).collect(), forces: vec![] }
    };
    model.apply(&displacements(-1e-4));
    model.step(0.01);
    let before = model.state().positions_m.to_vec();
    let support_n = model.support_forces_n().to_vec();
    let found = local(&mut model, &patch, 0.01);
    assert_eq!(model.state().positions_m, before);
    assert_eq!(model.support_forces_n(), support_n);
    let error = difference(&found.compliance_m_per_n, &exact);
    assert!(error < 0.01, "{error:e} {:?}", found.n_rings);
    let sum_n: DVec3 = found.force_n.iter().sum();
    assert!(sum_n.z < -1e-4, "{sum_n}");
}

#[test]
fn a_precomputed_patch_is_its_compliance() {
    let body = Body::small();
    let mut model = Precomputed::build(&PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &body.fixed_nodes,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })
    .unwrap();
    let mut patch: Vec<NodeId> =
        body.patch(40).into_iter().filter(|&n| model.is_loadable(n)).take(6).collect();
    patch.sort_unstable();
    let force = NodalForce { node: patch[2], force_n: DVec3::new(0.0, 0.01, 0.02) };
    let imposed = ImposedDisplacement { node: patch[4], displacement_m: DVec3::new(1e-3, 0.0, 0.0) };
    model.apply(&Constraints { displacements: vec![imposed], forces: vec![force] });
    model.step(1e-3);
    let found = local(&mut model, &patch, 1e-3);
    assert!(is_positive_definite(found.compliance_m_per_n.clone()));
    assert_eq!((found.force_n[2], found.force_n[4]), (force.force_n, model.constraint_forces_n()[0]));
    for (i, &of) in patch.iter().enumerate() {
        assert_eq!(found.position_m[i], model.state().positions_m[of.index()]);
        for (j, &by) in patch.iter().enumerate() {
            let off = found.tensor_m_per_n(i, j) - model.compliance_m_per_n(of, by).unwrap();
            let largest = off.to_cols_array().into_iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            assert!(largest < 1e-15, "{largest:e}");
        }
    }
    // The prediction is the next step's place.
    let mut forces_n = found.force_n.clone();
    forces_n[1] += DVec3::new(1e-3, 2e-3, 0.0);
    let mut predicted_m = vec![DVec3::ZERO; 6];
    found.predict_into(&forces_n, &mut predicted_m);
    let forces = patch.iter().zip(&forces_n).map(|(&node, &force_n)| NodalForce { node, force_n }).collect();
    model.apply(&Constraints { displacements: vec![], forces });
    model.step(1e-3);
    for (predicted_m, node) in predicted_m.iter().zip(&patch) {
        assert!(predicted_m.distance(model.state().positions_m[node.index()]) < 1e-12);
    }
}

#[test]
fn fixed_nodes_and_other_tools_hold_and_bad_patches_are_told() {
    let body = Body::small();
    let step_s = 0.5 * body.stable_step_s();
    let mut model = body.tensor_mass(Rayleigh::default(), step_s);
    let patch = body.patch(2);
    let free = local(&mut model, &patch, 0.1);
    // A neighbour held by another tool makes the patch stiffer.
    let neighbour = body.patch(3)[2];
    let imposed = ImposedDisplacement { node: neighbour, displacement_m: DVec3::ZERO };
    model.apply(&Constraints { displacements: vec![imposed], forces: vec![] });
    let stiffer = local(&mut model, &patch, 0.1);
    let trace = |m: &LocalModel| -> f64 { (0..6).map(|i| m.compliance_m_per_n[7 * i]).sum() };
    assert!(trace(&stiffer) < 0.99 * trace(&free));

    let asked = [patch[0], body.fixed_nodes[0], NodeId(9999), patch[0]];
    let found = local(&mut model, &asked, 0.1);
    assert_eq!((found.nodes.len(), found.n_left_out), (2, 2));
    assert_eq!(found.tensor_m_per_n(1, 1), DMat3::ZERO);
    assert!(found.tensor_m_per_n(0, 0).x_axis.x > 0.0);
    for period_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let found = local(&mut model, &patch, period_s);
        assert!(found.compliance_m_per_n.iter().all(|x| *x == 0.0));
    }
    assert_eq!(local(&mut model, &[], 0.1).nodes.len(), 0);
    let body = Body::large();
    let mut model = body.tensor_mass(Rayleigh::default(), 0.5 * body.stable_step_s());
    let many: Vec<NodeId> = (0..LocalModel::MOST_NODES + 8).map(NodeId::from_index).collect();
    assert_eq!(local(&mut model, &many, 1e-4).n_left_out, 8);
}

#[test]
fn every_path_gives_the_same_local_model_and_a_used_work_space_too() {
    let body = Body::of(block([5, 5, 5], DVec3::splat(0.08)), 1e-9);
    let step_s = 0.9 * body.stable_step_s();
    let mut model = body.tensor_mass(Rayleigh::of_mass(2.0), step_s);
    let mut random = SeededRandom::new(2);
    let mut used = LocalWork::with_room_for(10);
    for n in [1, 4, 9] {
        let patch = body.patch(n);
        let period_s = step_s * (1.0 + random.normal().abs());
        let mut first = LocalModel::new();
        model.local_model_into(&patch, period_s, &mut used, &mut first);
        for path in KernelPath::available() {
            let mut work = LocalWork::with_room_for(body.mesh.positions_m.len());
            work.set_path(path);
            let mut out = LocalModel::new();
            model.local_model_into(&patch, period_s, &mut work, &mut out);
            assert_eq!(out, first, "{}", path.name());
        }
    }
}

#[test]
fn a_local_model_allocates_nothing() {
    let body = Body::small();
    let patch = body.patch(12);
    let mut work = LocalWork::with_room_for(body.mesh.positions_m.len());
    let mut out = LocalModel::new();
    let step_s = 0.5 * body.stable_step_s();
    for (name, mut model) in body.elastic_models(Rayleigh::default(), step_s) {
        model.step(step_s);
        let count = allocation_counter::measure(|| {
            for n in [3, 12, 1] {
                model.local_model_into(&patch[..n], 1e-3, &mut work, &mut out);
                model.local_model_into(&patch[..n], step_s, &mut work, &mut out);
            }
        });
        assert_eq!(count.count_total, 0, "{name}");
    }
}

/// What a small change of force on a node of the patch does to the patch in `n_steps` of `dt_s`, per Newton.
fn response(
    model: &dyn DeformableModel,
    (patch, forces): (&[NodeId], &[NodalForce]),
    by: usize,
    change_n: DVec3,
    (dt_s, n_steps): (f64, usize),
) -> Vec<DVec3> {
    let [more_m, less_m] = [1.0, -1.0].map(|sign| {
        let mut forces = forces.to_vec();
        forces.push(NodalForce { node: patch[by], force_n: change_n * sign });
        settled(model, &forces, dt_s, n_steps)
    });
    patch.iter().map(|n| (more_m[n.index()] - less_m[n.index()]) / (2.0 * change_n.length())).collect()
}

/// Largest difference of the local model's answer from the model's own, over the largest of these.
fn response_error(
    model: &mut dyn DeformableModel,
    load: (&[NodeId], &[NodalForce]),
    change_n: f64,
    (dt_s, n_steps, period_s): (f64, usize, f64),
) -> f64 {
    let found = local(model, load.0, period_s);
    assert!(is_positive_definite(found.compliance_m_per_n.clone()));
    let m = 3 * load.0.len();
    for (i, x) in found.compliance_m_per_n.iter().enumerate() {
        assert_eq!(*x, found.compliance_m_per_n[m * (i % m) + i / m], "symmetric");
    }
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for by in 0..load.0.len() {
        for axis in DVec3::AXES {
            let expected = response(model, load, by, axis * change_n, (dt_s, n_steps));
            for (i, expected) in expected.into_iter().enumerate() {
                worst = worst.max((found.tensor_m_per_n(i, by) * axis).distance(expected));
                largest = largest.max(expected.length());
            }
        }
    }
    worst / largest
}

/// Two zones side by side, the one beyond x = 0.03 with this law.
fn condensed(body: &Body, second: ZoneLaw, time_step_s: f64) -> CondensedHybrid {
    let of_tet = |t: usize| {
        let centre_m = body.mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() / 4.0;
        u32::from(centre_m.x > 0.03)
    };
    let of_tets = (0..body.mesh.tetrahedra.len()).map(of_tet).collect();
    let zones = Zones::new(&body.mesh, of_tets).unwrap();
    let laws = [ZoneLaw::Precomputed, second];
    let dynamics = body.dynamics(Rayleigh::of_mass(10.0), time_step_s);
    CondensedHybrid::build(&CondensedParams::new(dynamics, &body.material, &zones, &laws)).unwrap()
}

#[test]
fn a_condensed_patch_is_exact_without_dynamic_zones() {
    let body = Body::small();
    let mut model = condensed(&body, ZoneLaw::Precomputed, 1e-4);
    model.set_updated(Updated::All);
    // Nodes of both zones and of their frontier.
    let mut patch: Vec<NodeId> =
        body.patch(40).into_iter().filter(|&n| model.is_loadable(n)).take(7).collect();
    patch.sort_unstable();
    let forces = [NodalForce { node: patch[1], force_n: DVec3::new(0.02, 0.0, -0.01) }];
    model.apply(&Constraints { displacements: vec![], forces: forces.to_vec() });
    model.step(1e-3);
    let error = response_error(&mut model, (&patch, &forces), 1e-3, (1e-3, 1, 1e-3));
    assert!(error < 1e-9, "{error:e}");
    let found = local(&mut model, &patch, 1e-3);
    assert_eq!((found.n_rings, found.force_n[1], found.force_n[0]), (None, forces[0].force_n, DVec3::ZERO));
    assert_eq!(found.position_m[1], model.state().positions_m[patch[1].index()]);
    // The whole body over a long period is the same static one.
    let exact = body.exact(&patch, Rayleigh::default(), 1e6);
    let error = difference(&found.compliance_m_per_n, &exact);
    assert!(error < 1e-8, "{error:e}");
}

#[test]
fn a_condensed_patch_over_dynamic_tissue_is_what_a_small_force_does() {
    let body = Body::small();
    let step_s = 0.05 * body.stable_step_s();
    let mut model = condensed(&body, ZoneLaw::TensorMass, step_s);
    let patch: Vec<NodeId> = body.patch(60).into_iter().filter(|&n| model.is_loadable(n)).take(9).collect();
    let is_beyond = |n: &&NodeId| body.mesh.positions_m[n.index()].x > 0.035;
    let n_beyond = patch.iter().filter(is_beyond).count();
    assert!(n_beyond > 1 && n_beyond < 8, "{n_beyond}");
    // Over so short a step the frontier stands still for what acts on pre-computed nodes.
    let error = response_error(&mut model, (&patch, &[]), 1e-4, (step_s, 1, step_s));
    assert!(error < 0.02, "{error}");
    // Dynamic nodes alone: what the tensor-mass body says.
    let far: Vec<NodeId> = patch.iter().copied().filter(|n| is_beyond(&n)).collect();
    let period_s = 0.5 * body.stable_step_s();
    let found = local(&mut model, &far, period_s);
    let exact = body.exact(&far, Rayleigh::of_mass(10.0), period_s);
    let error = difference(&found.compliance_m_per_n, &exact);
    assert!(error < 0.02, "{error}");
}

#[test]
fn a_reduced_patch_is_the_tangent_of_its_equilibrium() {
    let body = Body::small();
    let params = ReducedParams::new(&body.mesh, &body.material, &body.fixed);
    let mut model = Reduced::build(&params).unwrap();
    let patch: Vec<NodeId> =
        body.patch(40).into_iter().filter(|n| model.loadable_nodes().contains(n)).take(5).collect();
    let forces: Vec<NodalForce> =
        patch.iter().map(|&node| NodalForce { node, force_n: DVec3::new(0.05, 0.02, -0.05) }).collect();
    let at_rest = local(&mut model, &patch, 1e-3);
    let exact = body.exact(&patch, Rayleigh::default(), 1e6);
    let error = difference(&at_rest.compliance_m_per_n, &exact);
    assert!(error < 1e-8, "{error:e}");
    model.apply(&Constraints { displacements: vec![], forces: forces.clone() });
    (0..3).for_each(|_| model.step(1e-3));
    let loaded = local(&mut model, &patch, 1e-3);
    assert_eq!(loaded.force_n[2], forces[2].force_n);
    // The load bends the body enough to tell the tangent from the stiffness at rest.
    let change = difference(&loaded.compliance_m_per_n, &at_rest.compliance_m_per_n);
    assert!(change > 0.02, "{change}");
    let error = response_error(&mut model, (&patch, &forces), 1e-5, (1e-3, 3, 1e-3));
    assert!(error < 1e-5, "{error:e}");
}

#[test]
fn local_models_of_zones_and_modes_allocate_nothing() {
    let body = Body::small();
    let mut work = LocalWork::with_room_for(body.mesh.positions_m.len());
    let mut out = LocalModel::new();
    let reduced =
        Reduced::build(&ReducedParams::new(&body.mesh, &body.material, &body.fixed)).unwrap().duplicate();
    let hybrid = condensed(&body, ZoneLaw::TensorMass, 0.5 * body.stable_step_s()).duplicate();
    for mut model in [reduced, hybrid] {
        model.step(1e-3);
        let patch = body.patch(12);
        let state = model.state().positions_m.to_vec();
        let count = allocation_counter::measure(|| model.local_model_into(&patch, 1e-3, &mut work, &mut out));
        assert_eq!(count.count_total, 0);
        // Asking changes nothing.
        assert_eq!(model.state().positions_m, state);
        assert!(out.compliance_m_per_n.iter().any(|x| *x > 0.0));
    }
}

#[test]
fn a_solution_that_the_iterations_do_not_reach_is_told() {
    let mut body = Body::small();
    let patch = body.patch(4);
    let told = |body: &Body| {
        let mut model = body.tensor_mass(Rayleigh::default(), body.stable_step_s());
        local(&mut model, &patch, 1.0)
    };
    assert!(!told(&body).missed_tolerance);
    // Almost incompressible: the volume's stiffness is far above that of the shape.
    body.material = LinearElastic::from_young_poisson(5e3, 0.4999999, DENSITY_KG_PER_M3).unwrap();
    let found = told(&body);
    assert!(found.missed_tolerance && !found.is_inertial);
    assert!(found.compliance_m_per_n.iter().all(|x| x.is_finite()));
}
