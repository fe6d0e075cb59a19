//! The fast kernel's laws and what stands beside them, against the laws of `material`, the tensor-mass reference
//! and definitions; quarantine; viscous memory.

use std::sync::Arc;

use glisson_mesh::math::{DMat3, DVec3, SeededRandom, outer};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::{
    HolzapfelGasserOgden, HolzapfelGasserOgdenParameters, LinearElastic, Material, MooneyRivlin, NeoHookeLog,
    Ogden, OgdenTerm, PronySeries, PronyTerm, StVenantKirchhoff, StableNeoHooke,
};
use glisson_tissue::model::kernel::{
    ExplicitStep, FastKernel, KernelError, KernelExtras, KernelLaw, KernelParams, KernelPath, Quarantine,
    QuarantineReport, SharedMaterial,
};
use glisson_tissue::model::nonlinear_tensor_mass::{
    DirectBody, Fibre, NonlinearElasticity, NonlinearPart, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson_tissue::model::{DynamicBody, RestStress};
use glisson_tissue::solve::{ElasticBody, MeshEdges, P1Gradients};
use glisson_tissue::workers::Sequential;

use crate::model_meshes::{block, relative_difference, shaken_block};

const SIZE_M: DVec3 = DVec3::new(0.1, 0.06, 0.05);

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

fn mesh() -> TetMesh {
    shaken_block([9, 7, 6], SIZE_M, 0.15, 3)
}

pub(crate) fn kernel_with(mesh: &TetMesh, law: KernelLaw, extras: &KernelExtras<'_>) -> FastKernel {
    let path = KernelPath::fastest();
    let params = KernelParams { mesh, law, materials: &[material()], path };
    FastKernel::with_extras(&params, extras).unwrap()
}

fn forces(kernel: &mut FastKernel, u: &[DVec3]) -> Vec<DVec3> {
    let mut force_n = vec![DVec3::ONE; u.len()];
    kernel.force_into(&Sequential, u, &mut force_n);
    force_n
}

/// A homogeneous deformation, shaken by up to `noise_m`.
fn deformed(mesh: &TetMesh, f: DMat3, noise_m: f64, seed: u64) -> Vec<DVec3> {
    let mut random = SeededRandom::new(seed);
    let mut noise = || DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-noise_m, noise_m)));
    mesh.positions_m.iter().map(|&p| f * p - p + noise()).collect()
}

/// Turned, sheared and stretched to the volume ratios 0.6, 1.02 and 2.2.
fn deformations(mesh: &TetMesh) -> Vec<Vec<DVec3>> {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 1.0);
    let shear = DMat3::from_cols(DVec3::X, DVec3::new(0.3, 1.0, 0.1), DVec3::Z);
    [0.6_f64, 1.02, 2.2]
        .iter()
        .enumerate()
        .map(|(i, ratio)| {
            let stretch = DMat3::from_diagonal(DVec3::new(1.1, 0.95, ratio / (1.1 * 0.95)));
            deformed(mesh, turn * shear * stretch, 8e-4, 40 + i as u64)
        })
        .collect()
}

fn materials_that_differ(n: usize) -> Vec<LinearElastic> {
    let mut random = SeededRandom::new(4);
    let mut one = || {
        let young_pa = random.uniform_in(1e3, 2e4);
        LinearElastic::from_young_poisson(young_pa, random.uniform_in(0.1, 0.49), 1000.0).unwrap()
    };
    (0..n).map(|_| one()).collect()
}

fn check_against_laws<M: Material>(mesh: &TetMesh, kernel: &mut FastKernel, laws: &[M]) {
    let edges = MeshEdges::of_mesh(mesh).unwrap();
    let body = ElasticBody::new(mesh, &edges, laws).unwrap();
    assert!(kernel.n_parts() >= 4, "parts exchange rows");
    for u in deformations(mesh) {
        assert_eq!(body.first_inverted(&u), None, "the laws have a stress");
        let mut expected = vec![DVec3::ZERO; u.len()];
        body.force_into(&u, &mut expected);
        let off = relative_difference(&forces(kernel, &u), &expected);
        assert!(off < 1e-12, "{:?}: {off:e}", kernel.law());
    }
}

#[test]
fn neo_hookean_forces_equal_those_of_the_materials() {
    let mesh = mesh();
    let materials = materials_that_differ(mesh.tetrahedra.len());
    let kernel = |law| {
        let params = KernelParams { mesh: &mesh, law, materials: &materials, path: KernelPath::fastest() };
        FastKernel::new(&params).unwrap()
    };
    let log: Vec<NeoHookeLog> = materials.iter().map(NeoHookeLog::from).collect();
    check_against_laws(&mesh, &mut kernel(KernelLaw::NeoHookeLog), &log);
    let stable: Vec<StableNeoHooke> = materials.iter().map(StableNeoHooke::from).collect();
    check_against_laws(&mesh, &mut kernel(KernelLaw::StableNeoHooke), &stable);
}

#[test]
fn neo_hookean_laws_keep_their_digits_at_tiny_strain_and_rest_without_force() {
    let mesh = mesh();
    let tiny = deformed(&mesh, DMat3::IDENTITY, 1e-12, 7);
    let expected = forces(&mut kernel_with(&mesh, KernelLaw::Linear, &KernelExtras::default()), &tiny);
    for law in [KernelLaw::NeoHookeLog, KernelLaw::StableNeoHooke] {
        let mut kernel = kernel_with(&mesh, law, &KernelExtras::default());
        let off = relative_difference(&forces(&mut kernel, &tiny), &expected);
        assert!(off < 1e-8, "{law:?}: {off:e}");
        let moved = vec![DVec3::splat(0.25); tiny.len()];
        assert!(forces(&mut kernel, &moved).iter().all(|f| *f == DVec3::ZERO), "{law:?}");
    }
}

/// Mooney-Rivlin, Ogden and Holzapfel-Gasser-Ogden.
pub(crate) fn general_laws() -> [SharedMaterial; 3] {
    let ogden = [OgdenTerm { mu_pa: 842.0, exponent: -4.7 }, OgdenTerm { mu_pa: 300.0, exponent: 2.0 }];
    let fibred = HolzapfelGasserOgdenParameters {
        matrix_shear_pa: 764.0,
        fibre_stiffness_pa: 996.0,
        fibre_exponent: 0.05,
        dispersion: 0.1,
        fibre_directions: vec![DVec3::new(1.0, 0.2, 0.0), DVec3::new(0.0, 1.0, 1.0)],
        bulk_pa: 2e4,
    };
    [
        Arc::new(MooneyRivlin::new(263.0, 200.0, 1e4).unwrap()),
        Arc::new(Ogden::new(&ogden, 1e4).unwrap()),
        Arc::new(HolzapfelGasserOgden::new(&fibred).unwrap()),
    ]
}

#[test]
fn general_laws_give_the_forces_of_the_elastic_body() {
    let mesh = mesh();
    let n_tets = mesh.tetrahedra.len();
    let three = general_laws();
    for law in &three {
        let laws = std::slice::from_ref(law);
        let mut kernel =
            kernel_with(&mesh, KernelLaw::General, &KernelExtras { laws, ..KernelExtras::default() });
        check_against_laws(&mesh, &mut kernel, &[&**law]);
    }
    let mixed: Vec<SharedMaterial> = (0..n_tets).map(|t| Arc::clone(&three[t % 3])).collect();
    let mut kernel =
        kernel_with(&mesh, KernelLaw::General, &KernelExtras { laws: &mixed, ..KernelExtras::default() });
    let borrowed: Vec<&(dyn Material + Send + Sync)> = mixed.iter().map(|law| &**law).collect();
    check_against_laws(&mesh, &mut kernel, &borrowed);
    // Without the corners of one node it is free, of exactly no force.
    let bare = mesh.tetrahedra[0][0];
    for t in (0..n_tets).filter(|&t| mesh.tetrahedra[t].contains(&bare)) {
        kernel.remove_tet(&mesh, TetId::from_index(t));
    }
    let found = forces(&mut kernel, &deformed(&mesh, DMat3::IDENTITY * 1.1, 1e-3, 8));
    assert_eq!(found[bare.index()], DVec3::ZERO);
}

/// A fibre for each tetrahedron, all different.
fn fibres(n: usize) -> Vec<Fibre> {
    let mut random = SeededRandom::new(21);
    (0..n)
        .map(|_| {
            let any = DVec3::from_array(std::array::from_fn(|_| random.normal()));
            Fibre {
                lambda_along_pa: random.uniform_in(1e4, 3e4),
                mu_along_pa: random.uniform_in(2e3, 9e3),
                direction: any.normalize(),
            }
        })
        .collect()
}

#[test]
fn fibres_and_penalty_agree_with_the_tensor_mass_reference_also_after_removals() {
    let mesh = mesh();
    let (n_nodes, n_tets) = (mesh.positions_m.len(), mesh.tetrahedra.len());
    let fibres = fibres(n_tets);
    let elasticity = NonlinearElasticity {
        material: &material(),
        fibres: &fibres,
        volume_penalty_pa: 3e4,
        largest_stretch: 1.0,
    };
    let extras = KernelExtras { fibres: &fibres, volume_penalty_pa: 3e4, ..KernelExtras::default() };
    let mut reference = NonlinearTensorMass::build(&NonlinearTensorMassParams {
        body: DynamicBody { time_step_s: 1e-5, ..DynamicBody::new(&mesh, material().density_kg_per_m3()) },
        elasticity,
    })
    .unwrap();
    let laws = elasticity.laws(n_tets).unwrap();
    let direct = DirectBody { mesh: &mesh, laws: &laws, gamma_pa: 3e4 };
    let mut kernel = kernel_with(&mesh, KernelLaw::StVenantKirchhoff, &extras);
    let mut expected = vec![DVec3::ZERO; n_nodes];
    for u in deformations(&mesh) {
        let found = forces(&mut kernel, &u);
        direct.forces_into(&u, &mut expected);
        assert!(relative_difference(&found, &expected) < 1e-12);
        reference.elastic_forces_into(&u, &mut expected);
        let off = relative_difference(&found, &expected);
        assert!(off < 1e-10, "{off:e}");
    }
    // The linear law with fibres is the linear part of that.
    let u = deformed(&mesh, DMat3::IDENTITY, 1e-3, 22);
    reference.set_nonlinear_part(NonlinearPart::AboveDisplacement { threshold_m: f64::INFINITY });
    reference.elastic_forces_into(&u, &mut expected);
    let mut linear = kernel_with(&mesh, KernelLaw::Linear, &extras);
    assert!(relative_difference(&forces(&mut linear, &u), &expected) < 1e-10);
    // What is left after removals, and nothing where nothing is left.
    let bare = mesh.tetrahedra[0][0];
    let goes = |t: &usize| t % 5 == 2 || mesh.tetrahedra[*t].contains(&bare);
    let (removed, kept): (Vec<usize>, Vec<usize>) = (0..n_tets).partition(goes);
    for &t in &removed {
        kernel.remove_tet(&mesh, TetId::from_index(t));
    }
    let rest = TetMesh {
        positions_m: mesh.positions_m.clone(),
        tetrahedra: kept.iter().map(|&t| mesh.tetrahedra[t]).collect(),
        ..TetMesh::default()
    };
    let laws: Vec<_> = kept.iter().map(|&t| laws[t]).collect();
    DirectBody { mesh: &rest, laws: &laws, gamma_pa: 3e4 }.forces_into(&u, &mut expected);
    let found = forces(&mut kernel, &u);
    assert!(relative_difference(&found, &expected) < 1e-12);
    assert_eq!(found[bare.index()], DVec3::ZERO);
}

fn rest_stresses(n: usize) -> Vec<RestStress> {
    let mut random = SeededRandom::new(23);
    (0..n).map(|_| std::array::from_fn(|_| random.uniform_in(-400.0, 400.0))).collect()
}

fn symmetric([xx, yy, zz, xy, xz, yz]: RestStress) -> DMat3 {
    DMat3::from_cols_array_2d(&[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
}

/// The kernel's forces without the stress at rest, plus V F S_0 alpha of the tetrahedra that are there.
fn with_rest_stress(
    mesh: &TetMesh,
    law: KernelLaw,
    rest: &[RestStress],
    u: &[DVec3],
    there: impl Fn(usize) -> bool,
) -> Vec<DVec3> {
    let mut plain = kernel_with(mesh, law, &KernelExtras::default());
    (0..rest.len()).filter(|&t| !there(t)).for_each(|t| plain.remove_tet(mesh, TetId::from_index(t)));
    let mut expected = forces(&mut plain, u);
    for (t, nodes) in mesh.tetrahedra.iter().enumerate().filter(|(t, _)| there(*t)) {
        let gradients = P1Gradients::new(mesh.corners_m(TetId::from_index(t)));
        let mut f = DMat3::IDENTITY;
        if law != KernelLaw::Linear {
            for (n, alpha) in nodes.iter().zip(gradients.alpha_per_m) {
                f += outer(u[n.index()], alpha);
            }
        }
        let stress = f * symmetric(rest[t]) * gradients.volume_m3;
        for (n, alpha) in nodes.iter().zip(gradients.alpha_per_m) {
            expected[n.index()] += stress * alpha;
        }
    }
    expected
}

#[test]
fn stress_in_the_rest_shape_is_carried_with_the_body_and_leaves_with_the_tetrahedron() {
    let mesh = mesh();
    let n_tets = mesh.tetrahedra.len();
    let rest = rest_stresses(n_tets);
    let bare = mesh.tetrahedra[7][2];
    for law in
        [KernelLaw::Linear, KernelLaw::StVenantKirchhoff, KernelLaw::NeoHookeLog, KernelLaw::StableNeoHooke]
    {
        let extras = KernelExtras { rest_stress_pa: &rest, ..KernelExtras::default() };
        let mut kernel = kernel_with(&mesh, law, &extras);
        let mut all = deformations(&mesh);
        all.push(vec![DVec3::ZERO; mesh.positions_m.len()]);
        for u in &all {
            let off = relative_difference(
                &forces(&mut kernel, u),
                &with_rest_stress(&mesh, law, &rest, u, |_| true),
            );
            assert!(off < 1e-12, "{law:?}: {off:e}");
        }
        // Forces of each tetrahedron sum to zero: a loose piece falls with its whole weight.
        let sum: DVec3 = forces(&mut kernel, &all[0]).into_iter().sum();
        assert!(sum.length() < 1e-12, "{sum}");
        let there = |t: usize| t % 4 != 1 && !mesh.tetrahedra[t].contains(&bare);
        (0..n_tets).filter(|&t| !there(t)).for_each(|t| kernel.remove_tet(&mesh, TetId::from_index(t)));
        let found = forces(&mut kernel, &all[1]);
        let expected = with_rest_stress(&mesh, law, &rest, &all[1], there);
        assert!(relative_difference(&found, &expected) < 1e-12);
        assert_eq!(found[bare.index()], DVec3::ZERO);
    }
}

const STEP: ExplicitStep = ExplicitStep { step_s: 1e-4, damping_per_s: 5.0 };

/// The node that is nowhere in [`BadShape::bad`].
const NOWHERE: NodeId = NodeId(222);

/// A shape with inverted tetrahedra and ones without a number.
struct BadShape {
    mesh: TetMesh,
    upright: Vec<DVec3>,
    bad: Vec<DVec3>,
    /// Tetrahedra that are inverted or have no number, ascending.
    unsound: Vec<TetId>,
}

impl BadShape {
    fn new() -> Self {
        let mesh = mesh();
        let upright = deformed(&mesh, DMat3::IDENTITY * 1.02, 1e-4, 31);
        // One node through faces opposite to it, another nowhere.
        let mut bad = upright.clone();
        let middle = (0..mesh.positions_m.len())
            .min_by(|&a, &b| {
                let away = |n: usize| mesh.positions_m[n].distance(0.5 * SIZE_M);
                away(a).total_cmp(&away(b))
            })
            .unwrap();
        bad[middle] += DVec3::splat(0.012);
        bad[NOWHERE.index()].y = f64::NAN;
        let f = |t: TetId| {
            let gradients = P1Gradients::new(mesh.corners_m(t));
            let corners = mesh.tetrahedra[t.index()].iter().zip(gradients.alpha_per_m);
            corners.fold(DMat3::IDENTITY, |f, (n, a)| f + outer(bad[n.index()], a))
        };
        let is_sound = |t: &TetId| f(*t).determinant() > 0.0;
        let unsound: Vec<TetId> =
            (0..mesh.tetrahedra.len()).map(TetId::from_index).filter(|t| !is_sound(t)).collect();
        let n_nan = mesh.tetrahedra.iter().filter(|nodes| nodes.contains(&NOWHERE)).count();
        assert!(unsound.len() > n_nan + 2 && n_nan > 2, "{} {n_nan}", unsound.len());
        Self { mesh, upright, bad, unsound }
    }

    fn forces_of(&self, kernel: &FastKernel) -> Vec<DVec3> {
        let mut force_n = vec![DVec3::ZERO; self.mesh.positions_m.len()];
        kernel.forces_into(&mut force_n);
        force_n
    }
}

fn all_finite(forces: &[DVec3]) -> bool {
    forces.iter().all(|f| f.is_finite())
}

#[test]
fn inverted_tetrahedra_follow_a_stand_in_and_no_numbers_are_left_out() {
    let shape = BadShape::new();
    let rest = rest_stresses(shape.mesh.tetrahedra.len());
    let prony = brain();
    let plain = KernelExtras::default();
    let full = KernelExtras {
        rest_stress_pa: &rest,
        volume_penalty_pa: 1e4,
        relaxation: Some(&prony),
        ..KernelExtras::default()
    };
    for extras in [plain, full] {
        for law in [KernelLaw::Linear, KernelLaw::StVenantKirchhoff, KernelLaw::NeoHookeLog] {
            let mut kernel = left_out_and_back(&shape, law, &extras);
            bad_shape_without_quarantine(&shape, law, &mut kernel);
        }
    }
}

/// Stress of a tetrahedron that is inside out: by the stand-in, or St Venant-Kirchhoff's with its guard up to ten times the stiffness.
fn unsound_stress_pa(law: KernelLaw, f: &DMat3) -> DMat3 {
    let material = material();
    let modulus_pa = material.lambda_pa() + 2.0 * material.mu_pa();
    let cofactor =
        DMat3::from_cols(f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis), f.x_axis.cross(f.y_axis));
    let guard_pa = cofactor * (2.0 * modulus_pa * (f.determinant() - 0.1));
    let guarded_pa = StVenantKirchhoff::from(&material).first_piola_pa(f) + guard_pa;
    let greatest_pa = guarded_pa.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if law == KernelLaw::StVenantKirchhoff && greatest_pa <= 10.0 * modulus_pa {
        return guarded_pa;
    }
    StableNeoHooke::from(&material).first_piola_pa(f)
}

/// Unsound tetrahedra count as removed while they are unsound, but for the stable neo-Hookean stress of those that are inverted,
/// and no longer. Answers the kernel in the upright shape.
fn left_out_and_back(shape: &BadShape, law: KernelLaw, extras: &KernelExtras<'_>) -> FastKernel {
    let BadShape { mesh, unsound, .. } = shape;
    let mut kernel = kernel_with(mesh, law, extras);
    let mut without = kernel_with(mesh, law, extras);
    unsound.iter().for_each(|&t| without.remove_tet(mesh, t));
    for kernel in [&mut kernel, &mut without] {
        kernel.set_displacements(&shape.bad);
        kernel.step(&Sequential, STEP);
    }
    let found = shape.forces_of(&kernel);
    assert!(all_finite(&found));
    let mut expected = shape.forces_of(&without);
    for tet in unsound {
        let (nodes, gradients) = (mesh.tetrahedra[tet.index()], P1Gradients::new(mesh.corners_m(*tet)));
        let corners = nodes.iter().zip(gradients.alpha_per_m);
        let f = corners.fold(DMat3::IDENTITY, |f, (n, a)| f + outer(shape.bad[n.index()], a));
        if f.is_finite() {
            let stress_pa = unsound_stress_pa(law, &f);
            for (node, alpha) in nodes.iter().zip(gradients.alpha_per_m) {
                expected[node.index()] += stress_pa * alpha * gradients.volume_m3;
            }
        }
    }
    let off = relative_difference(&found, &expected);
    // Guarded tissue goes on with its extras.
    let goes_on = law == KernelLaw::StVenantKirchhoff && extras.volume_penalty_pa > 0.0;
    assert!(off < 1e-12 || goes_on, "{law:?}: as if they had been removed, with the stand-in: {off:e}");
    // Beside them are tetrahedra that are strained beyond what a step can follow, in both.
    let n_more = kernel.quarantined().n_tets - without.quarantined().n_tets;
    assert_eq!(n_more as usize, unsound.len());
    kernel.set_displacements(&shape.upright);
    kernel.step(&Sequential, STEP);
    assert_eq!(kernel.quarantined(), QuarantineReport::default());
    assert!(all_finite(&shape.forces_of(&kernel)));
    kernel
}

/// Without quarantine it spreads; a removed tetrahedron is not counted.
fn bad_shape_without_quarantine(shape: &BadShape, law: KernelLaw, kernel: &mut FastKernel) {
    kernel.set_displacements(&shape.bad);
    kernel.set_quarantine(Quarantine::NotFinite);
    kernel.remove_tet(&shape.mesh, shape.unsound[0]);
    kernel.step(&Sequential, STEP);
    assert!((kernel.quarantined().n_tets as usize) < shape.unsound.len());
    assert!(all_finite(&shape.forces_of(kernel)) || law == KernelLaw::NeoHookeLog);
    kernel.set_quarantine(Quarantine::Off);
    kernel.step(&Sequential, STEP);
    assert!(shape.forces_of(kernel).iter().any(|f| f.is_nan()));
}

/// A law that resists inversion is let do so: only what is no number is left out, both are counted.
#[test]
fn a_law_that_resists_inversion_loses_only_tetrahedra_without_numbers() {
    let shape = BadShape::new();
    let mesh = &shape.mesh;
    let quarantining = || {
        let mut kernel = kernel_with(mesh, KernelLaw::StableNeoHooke, &KernelExtras::default());
        kernel.set_quarantine(Quarantine::NotFinite);
        kernel
    };
    let mut kernel = quarantining();
    kernel.set_displacements(&shape.bad);
    kernel.step(&Sequential, STEP);
    assert_eq!(kernel.quarantined().n_tets as usize, shape.unsound.len());
    let mut without = quarantining();
    let has_no_number = |t: usize| mesh.tetrahedra[t].contains(&NOWHERE);
    (0..mesh.tetrahedra.len())
        .filter(|&t| has_no_number(t))
        .for_each(|t| without.remove_tet(mesh, TetId::from_index(t)));
    without.set_displacements(&shape.bad);
    without.step(&Sequential, STEP);
    assert!(shape.forces_of(&kernel) == shape.forces_of(&without));
}

/// The series of brain tissue in Miller and Chinzei 2002.
fn brain() -> PronySeries {
    let terms = [PronyTerm { share: 0.450, time_s: 0.5 }, PronyTerm { share: 0.365, time_s: 50.0 }];
    PronySeries::new(&terms).unwrap()
}

#[test]
fn a_compressed_body_relaxes_as_its_series_says() {
    // Compressed by 15 % at once, its surface held, the inside free: the homogeneous shape stays in balance.
    let mesh = shaken_block([3, 3, 3], DVec3::splat(0.03), 0.0, 51);
    let series = brain();
    let inside = |p: DVec3| p.min_element() > 1e-6 && p.max_element() < 0.03 - 1e-6;
    let f = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.85));
    let u: Vec<DVec3> = mesh.positions_m.iter().map(|&p| f * p - p).collect();
    for law in [KernelLaw::StVenantKirchhoff, KernelLaw::NeoHookeLog] {
        let extras = KernelExtras { relaxation: Some(&series), ..KernelExtras::default() };
        let mut kernel = kernel_with(&mesh, law, &extras);
        for (n, &p) in mesh.positions_m.iter().enumerate() {
            kernel.hold(NodeId::from_index(n), !inside(p));
        }
        kernel.set_displacements(&u);
        let mut force_n = vec![DVec3::ZERO; u.len()];
        let on_top = |force_n: &[DVec3]| -> f64 {
            let top = mesh.positions_m.iter().zip(force_n).filter(|(p, _)| p.z > 0.03 - 1e-6);
            top.map(|(_, f)| f.z).sum()
        };
        kernel.compute_forces(&Sequential);
        kernel.forces_into(&mut force_n);
        let at_once_n = on_top(&force_n);
        assert!(at_once_n < -0.1, "{at_once_n}");
        let step = ExplicitStep { step_s: 5e-4, damping_per_s: 20.0 };
        let mut n_steps = 0;
        for time_s in [0.01, 0.1, 0.5, 2.0, 10.0] {
            while f64::from(n_steps) * step.step_s < time_s {
                kernel.step(&Sequential, step);
                n_steps += 1;
            }
            kernel.forces_into(&mut force_n);
            let found = on_top(&force_n) / at_once_n;
            // The first step spreads the jump over its length.
            let expected = series.relaxation(time_s - 0.5 * step.step_s);
            assert!((found - expected).abs() < 2e-3 * expected, "{time_s} s: {found} for {expected}");
        }
        kernel.displacements_into(&mut force_n);
        assert!(relative_difference(&force_n, &u) < 1e-6, "the shape stays");
    }
}

#[test]
fn every_law_relaxes_as_the_recursion_on_its_second_stress_says() {
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let (series, linear) = (brain(), material());
    let general: [SharedMaterial; 1] = [Arc::new(Ogden::from_linear(&linear, 3.0).unwrap())];
    let cases: [(KernelLaw, &[SharedMaterial], SharedMaterial); 4] = [
        (KernelLaw::StVenantKirchhoff, &[], Arc::new(StVenantKirchhoff::from(&linear))),
        (KernelLaw::NeoHookeLog, &[], Arc::new(NeoHookeLog::from(&linear))),
        (KernelLaw::StableNeoHooke, &[], Arc::new(StableNeoHooke::from(&linear))),
        (KernelLaw::General, &general, Arc::clone(&general[0])),
    ];
    for (law, laws, oracle) in cases {
        let extras = KernelExtras { relaxation: Some(&series), laws, ..KernelExtras::default() };
        let mut kernel = kernel_with(&mesh, law, &extras);
        (0..4).for_each(|n| kernel.hold(NodeId(n), true));
        let mut history = series.rest();
        let mut saved: Option<(usize, Vec<f64>, Vec<DVec3>)> = None;
        let run = |kernel: &mut FastKernel, i: usize, step_s: f64| {
            let turn = DMat3::from_axis_angle(DVec3::new(1.0, -1.0, 0.5).normalize(), 0.3 * i as f64);
            let stretch = DMat3::from_diagonal(DVec3::new(1.0 + 0.02 * i as f64, 1.1, 0.9));
            let u: Vec<DVec3> = mesh.positions_m.iter().map(|&p| turn * stretch * p - p).collect();
            kernel.set_displacements(&u);
            kernel.step(&Sequential, ExplicitStep { step_s, damping_per_s: 0.0 });
            let mut force_n = vec![DVec3::ZERO; 4];
            kernel.forces_into(&mut force_n);
            (turn * stretch, force_n)
        };
        for i in 0..12 {
            // Another step length half way: the recursion follows.
            let step_s = if i < 6 { 0.1 } else { 0.03 };
            if i == 8 {
                let mut numbers = vec![0.0; kernel.history_len()];
                kernel.history_into(&mut numbers);
                assert_eq!(numbers.len(), 18);
                saved = Some((i, numbers, Vec::new()));
            }
            let (f, force_n) = run(&mut kernel, i, step_s);
            let elastic = f.inverse() * oracle.first_piola_pa(&f);
            let prony = series.step(step_s);
            let stress = f * prony.stress_pa(&history, &elastic);
            prony.advance(&mut history, &elastic);
            // alpha_k of the unit tetrahedron are the axes.
            let expected: Vec<DVec3> = (0..3).map(|k| stress.col(k) / 6.0).collect();
            assert!(relative_difference(&force_n[1..], &expected) < 1e-11, "{law:?} step {i}");
            if let Some((8, _, after)) = &mut saved
                && i == 8
            {
                *after = force_n;
            }
        }
        // Back to the memory of then: the same bits.
        let (i, numbers, after) = saved.unwrap();
        kernel.set_history(&numbers);
        assert_eq!(run(&mut kernel, i, 0.03).1, after, "{law:?}");
    }
}

#[test]
fn impossible_extras_are_named() {
    let mesh = block([2, 1, 1], SIZE_M);
    let build = |law, extras: &KernelExtras<'_>| {
        let params = KernelParams { mesh: &mesh, law, materials: &[material()], path: KernelPath::fastest() };
        FastKernel::with_extras(&params, extras).err()
    };
    let none = KernelExtras::default();
    let general = KernelLaw::General;
    assert_eq!(build(general, &none), Some(KernelError::Laws { found: 0, law: general, n_tets: 12 }));
    let laws = &general_laws()[..1];
    let law = KernelLaw::Linear;
    let extras = KernelExtras { laws, ..none };
    assert_eq!(build(law, &extras), Some(KernelError::Laws { found: 1, law, n_tets: 12 }));
    let extras = KernelExtras { rest_stress_pa: &[[0.0; 6]; 3], ..none };
    let what = "stresses in the rest shape";
    assert_eq!(build(law, &extras), Some(KernelError::ExtraCount { what, found: 3, n_tets: 12 }));
    let mut rest = [[0.0; 6]; 12];
    rest[4][1] = f64::INFINITY;
    let extras = KernelExtras { rest_stress_pa: &rest, ..none };
    assert_eq!(build(law, &extras), Some(KernelError::RestStress { tet: TetId(4) }));
    let extras = KernelExtras { volume_penalty_pa: -1.0, ..none };
    assert_eq!(build(law, &extras), Some(KernelError::VolumePenalty { found_pa: -1.0 }));
    let mut along = fibres(12);
    along[3].direction *= 2.0;
    let extras = KernelExtras { fibres: &along, ..none };
    assert!(matches!(build(law, &extras), Some(KernelError::Fibre(_))));
    let extras = KernelExtras { fibres: &along[..2], ..none };
    let what = "fibres";
    assert_eq!(build(law, &extras), Some(KernelError::ExtraCount { what, found: 2, n_tets: 12 }));
}

/// Everything that a body may have beside its law.
pub(crate) struct AllExtras {
    rest: Vec<RestStress>,
    fibres: Vec<Fibre>,
    series: PronySeries,
    laws: Vec<SharedMaterial>,
}

impl AllExtras {
    pub(crate) fn of_mesh(mesh: &TetMesh) -> Self {
        let n = mesh.tetrahedra.len();
        let three = general_laws();
        Self {
            rest: rest_stresses(n),
            fibres: fibres(n),
            series: brain(),
            laws: (0..n).map(|t| Arc::clone(&three[t % 3])).collect(),
        }
    }

    pub(crate) fn for_law(&self, law: KernelLaw) -> KernelExtras<'_> {
        KernelExtras {
            rest_stress_pa: &self.rest,
            fibres: &self.fibres,
            volume_penalty_pa: 2e4,
            laws: self.laws_for(law),
            relaxation: Some(&self.series),
        }
    }

    pub(crate) fn laws_for(&self, law: KernelLaw) -> &[SharedMaterial] {
        if law == KernelLaw::General { &self.laws } else { &[] }
    }
}
