//! All tetrahedra: derivatives, quarantine, and the fast laws against the general ones.

use super::super::law::SharedLaw;
use super::*;
use crate::material::{
    LinearElastic, MaterialSpec, MooneyRivlin, NeoHookeLog, Ogden, OgdenTerm, StVenantKirchhoff,
};
use crate::workers::Sequential;
use glisson_mesh::math::SeededRandom;
use std::sync::Arc;

const LAME_PA: [f64; 2] = [9000.0, 1000.0];

fn cube(random: &mut SeededRandom) -> TetMesh {
    let mut mesh = TetMesh::default();
    for i in 0..8 {
        let corner = DVec3::new(f64::from(i & 1), f64::from((i >> 1) & 1), f64::from(i >> 2));
        mesh.positions_m.push(corner + vector(random, 0.05));
    }
    mesh.tetrahedra = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
        .map(|t| t.map(NodeId))
        .to_vec();
    mesh
}

fn vector(random: &mut SeededRandom, scale: f64) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()) * scale
}

/// Lame's coefficients of the tetrahedra of [`cube`] where each has its own [Pa].
fn lame_of_each_pa() -> impl Iterator<Item = [f64; 2]> {
    (0..6).map(|t| [LAME_PA[0] * (1.0 + f64::from(t)), LAME_PA[1] * (4.0 - 0.5 * f64::from(t))])
}

fn logs_of_each() -> Vec<NeoHookeLog> {
    lame_of_each_pa().map(|[lambda_pa, mu_pa]| NeoHookeLog::new(lambda_pa, mu_pa).unwrap()).collect()
}

fn stables_of_each() -> Vec<StableNeoHooke> {
    lame_of_each_pa().map(|[lambda_pa, mu_pa]| StableNeoHooke::new(lambda_pa, mu_pa).unwrap()).collect()
}

fn laws() -> Vec<(ImplicitLaw, VolumeResistance)> {
    let [lambda_pa, mu_pa] = LAME_PA;
    let fast = ImplicitLaw::from(NeoHookeLog::new(lambda_pa, mu_pa).unwrap());
    let ogden = Ogden::new(&[OgdenTerm { mu_pa, exponent: -4.7 }], lambda_pa).unwrap();
    let stable = StableNeoHooke::new(lambda_pa, mu_pa).unwrap();
    vec![
        (fast.clone(), VolumeResistance::Element),
        (fast.clone(), VolumeResistance::NodeAveraged),
        (fast, VolumeResistance::NodeAveragedStrain),
        (
            ImplicitLaw::shared(LinearElastic::from_lame(lambda_pa, mu_pa, 1000.0).unwrap()),
            VolumeResistance::Element,
        ),
        (ImplicitLaw::shared(StVenantKirchhoff::new(lambda_pa, mu_pa).unwrap()), VolumeResistance::Element),
        (stable.into(), VolumeResistance::Element),
        (ImplicitLaw::shared(stable), VolumeResistance::Element),
        (ImplicitLaw::shared(ogden), VolumeResistance::Element),
        (ImplicitLaw::NeoHookeLogOfEach(logs_of_each()), VolumeResistance::Element),
        (ImplicitLaw::StableNeoHookeOfEach(stables_of_each()), VolumeResistance::Element),
    ]
}

fn elements(mesh: &TetMesh, law: &ImplicitLaw, volume: VolumeResistance, rest: &[RestStress]) -> Elements {
    let n_tets = mesh.tetrahedra.len();
    Elements::new(&ElementsParams {
        mesh,
        live: &vec![true; n_tets],
        law,
        stand_ins: &law.stand_ins(n_tets).unwrap(),
        volume,
        rest_stress_pa: rest,
        is_viscous: true,
        known: None,
    })
    .unwrap()
}

/// Forces are the slope of the energy, and the tangent product that of the forces.
fn check_derivatives(elements: &mut Elements, u: &[DVec3], d: &[DVec3], name: &str) {
    let step = 1e-6;
    let moved = |s: f64| -> Vec<DVec3> { u.iter().zip(d).map(|(u, d)| *u + *d * s).collect() };
    let mut forces = [vec![DVec3::ZERO; 8], vec![DVec3::ZERO; 8], vec![DVec3::ZERO; 8]];
    let above = elements.evaluate(&Sequential, &moved(step), &mut forces[0]);
    let below = elements.evaluate(&Sequential, &moved(-step), &mut forces[1]);
    assert!(elements.evaluate(&Sequential, u, &mut forces[2]).is_usable());
    let work: f64 = forces[2].iter().zip(d).map(|(f, d)| f.dot(*d)).sum();
    let slope = (above.energy_j - below.energy_j) / (2.0 * step);
    assert!((work - slope).abs() <= 1e-6 * work.abs(), "{name}: {work} {slope}");
    let mut product = vec![DVec3::ZERO; 8];
    elements.tangent_product(&Sequential, d, &mut product);
    let size = product.iter().map(|f| f.length()).fold(0.0, f64::max);
    for n in 0..8 {
        let slope = (forces[0][n] - forces[1][n]) / (2.0 * step);
        assert!((product[n] - slope).length() <= 1e-6 * size, "{name}: {} {slope}", product[n]);
    }
    // Forces balance each other.
    assert!(forces[2].iter().sum::<DVec3>().length() <= 1e-12 * size);
}

#[test]
fn forces_and_tangent_are_derivatives_for_each_law_with_rest_stress_and_viscosity() {
    let mut random = SeededRandom::new(8);
    let mesh = cube(&mut random);
    let mut vectors = |scale: f64| -> Vec<DVec3> { (0..8).map(|_| vector(&mut random, scale)).collect() };
    let (u, d) = (vectors(0.05), vectors(1.0));
    let rest: Vec<RestStress> =
        (0..6).map(|t| [200.0, -150.0, 80.0, 60.0, -90.0, 30.0 * f64::from(t)]).collect();
    for (law, volume) in laws() {
        let name = format!("{law:?} {volume:?}");
        let mut plain = elements(&mesh, &law, volume, &[]);
        check_derivatives(&mut plain, &u, &d, &name);
        let mut stressed = elements(&mesh, &law, volume, &rest);
        check_derivatives(&mut stressed, &u, &d, &name);
        stressed
            .set_viscous(0.7, |tet| symmetric(&[50.0, 20.0, -30.0, 10.0 * tet.index() as f64, 5.0, -7.0]));
        check_derivatives(&mut stressed, &u, &d, &name);
    }
}

/// Turned inside out by node 1: its tetrahedra and their neighbours follow the stand-in.
#[test]
fn in_quarantine_forces_and_tangent_are_derivatives_too() {
    let mut random = SeededRandom::new(9);
    let mesh = cube(&mut random);
    let mut vectors = |scale: f64| -> Vec<DVec3> { (0..8).map(|_| vector(&mut random, scale)).collect() };
    let (mut u, d) = (vectors(0.02), vectors(1.0));
    u[5] = DVec3::new(-1.5, 1.5, 0.0);
    let rest = vec![[200.0, -150.0, 80.0, 60.0, -90.0, 30.0]; 6];
    for (law, volume) in laws() {
        let allows_inversion = match &law {
            ImplicitLaw::NeoHookeLog(_) | ImplicitLaw::NeoHookeLogOfEach(_) => false,
            ImplicitLaw::StableNeoHooke(_) | ImplicitLaw::StableNeoHookeOfEach(_) => true,
            ImplicitLaw::General(laws) => laws[0].returns_from_inversion(),
        };
        let mut elements = elements(&mesh, &law, volume, &rest);
        assert_eq!(elements.quarantine(&[DVec3::ZERO; 8], Recovery::None), (0, None));
        let (n, first) = elements.quarantine(&u, Recovery::None);
        assert_eq!(n > 0, !allows_inversion, "{law:?}");
        assert_eq!(first.is_some(), !allows_inversion);
        check_derivatives(&mut elements, &u, &d, &format!("{law:?} {volume:?}"));
    }
}

/// What the elements say at a shape, with stress at rest and viscosity.
struct Answers {
    evaluation: Evaluation,
    /// Forces, and the tangent product.
    nodal: [Vec<DVec3>; 2],
    projected: TetStiffness,
    /// None where the tetrahedron is left out.
    stress_pa: Option<DMat3>,
}

fn answers(elements: &mut Elements, u: &[DVec3], d: &[DVec3], left_out: u8) -> Answers {
    elements.set_viscous(0.7, |tet| symmetric(&[50.0, 20.0, -30.0, 10.0 * tet.index() as f64, 5.0, -7.0]));
    elements.shape.groups[0].left_out = left_out;
    let mut nodal = [vec![DVec3::ZERO; 8], vec![DVec3::ZERO; 8]];
    let evaluation = elements.evaluate(&Sequential, u, &mut nodal[0]);
    elements.tangent_product(&Sequential, d, &mut nodal[1]);
    let f = DMat3::IDENTITY + elements.gradient(2, u);
    let projected = elements.projected_stiffness(2, f, false, [0.7, 1.3]);
    Answers { evaluation, nodal, projected, stress_pa: elements.second_piola_pa(3, u) }
}

/// Largest difference over the largest number.
fn off(a: &[f64], b: &[f64]) -> f64 {
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |m: f64, x| m.max(x.abs()));
    largest(&mut a.iter().zip(b).map(|(a, b)| a - b)) / largest(&mut a.iter().copied()).max(1e-300)
}

/// The laws eight at a time are those through the trait, also where tetrahedra are left out or inverted.
#[test]
fn the_fast_neo_hooke_laws_are_the_general_ones() {
    let mut random = SeededRandom::new(10);
    let mesh = cube(&mut random);
    let mut vectors = |scale: f64| -> Vec<DVec3> { (0..8).map(|_| vector(&mut random, scale)).collect() };
    let (u, d) = (vectors(0.05), vectors(1.0));
    let mut inverted = u.clone();
    inverted[5] = DVec3::new(-1.5, 1.5, 0.0);
    let rest = vec![[200.0, -150.0, 80.0, 60.0, -90.0, 30.0]; 6];
    let log = NeoHookeLog::new(LAME_PA[0], LAME_PA[1]).unwrap();
    let stable = StableNeoHooke::new(LAME_PA[0], LAME_PA[1]).unwrap();
    let logs = [ImplicitLaw::from(log), ImplicitLaw::shared(log)];
    let stables = [ImplicitLaw::from(stable), ImplicitLaw::shared(stable)];
    let shared = |law: &StableNeoHooke| -> SharedLaw { Arc::new(*law) };
    let stables_of_each = [
        ImplicitLaw::StableNeoHookeOfEach(stables_of_each()),
        ImplicitLaw::General(stables_of_each().iter().map(shared).collect()),
    ];
    let shared = |law: &NeoHookeLog| -> SharedLaw { Arc::new(*law) };
    let logs_of_each = [
        ImplicitLaw::NeoHookeLogOfEach(logs_of_each()),
        ImplicitLaw::General(logs_of_each().iter().map(shared).collect()),
    ];
    for (laws, u, left_out) in [
        (&logs, &u, 0),
        (&logs, &u, 0b1000),
        (&logs_of_each, &u, 0b1000),
        (&stables_of_each, &u, 0b1000),
        (&stables_of_each, &inverted, 0),
        (&stables, &u, 0),
        (&stables, &u, 0b1110_1000),
        (&stables, &inverted, 0),
        // All that are inverted.
        (&stables, &inverted, 0b1111_0000),
    ] {
        let [fast, general] = [0, 1].map(|k| {
            let mut elements = elements(&mesh, &laws[k], VolumeResistance::Element, &rest);
            answers(&mut elements, u, &d, left_out)
        });
        let name = format!("{:?}, left out {left_out:b}", laws[0]);
        let (a, b) = (fast.evaluation, general.evaluation);
        assert!(off(&[a.energy_j], &[b.energy_j]) <= 1e-12, "{name}: {a:?} {b:?}");
        assert_eq!((a.is_upright, a.has_inverted), (b.is_upright, b.has_inverted), "{name}");
        assert_eq!(a.has_inverted, u == &inverted && left_out == 0, "{name}");
        let flat = |vectors: &[DVec3]| -> Vec<f64> { vectors.iter().flat_map(DVec3::to_array).collect() };
        for k in 0..2 {
            let (a, b) = (flat(&fast.nodal[k]), flat(&general.nodal[k]));
            assert!(off(&a, &b) <= 1e-12, "{name}: {a:?} {b:?}");
        }
        let entries = |k: &TetStiffness| -> Vec<f64> {
            k.vertex.iter().chain(&k.edge).flat_map(DMat3::to_cols_array).collect()
        };
        let (a, b) = (entries(&fast.projected), entries(&general.projected));
        assert!(off(&a, &b) <= 1e-12, "{name}: {a:?} {b:?}");
        assert_eq!(fast.stress_pa.is_some(), left_out & 0b1000 == 0);
        let entries = |s: &Option<DMat3>| s.unwrap_or(DMat3::ZERO).to_cols_array();
        assert!(off(&entries(&fast.stress_pa), &entries(&general.stress_pa)) <= 1e-12, "{name}");
    }
}

/// Vectors of two numbers and those of the processor.
#[test]
fn each_instruction_set_gives_the_same_bits() {
    let mut random = SeededRandom::new(11);
    let mesh = cube(&mut random);
    let mut vectors = |scale: f64| -> Vec<DVec3> { (0..8).map(|_| vector(&mut random, scale)).collect() };
    let (u, d) = (vectors(0.05), vectors(1.0));
    let rest = vec![[200.0, -150.0, 80.0, 60.0, -90.0, 30.0]; 6];
    for (law, volume) in laws() {
        let [a, b] = [Level::baseline(), Level::new()].map(|level| {
            let mut elements = Elements { level, ..elements(&mesh, &law, volume, &rest) };
            answers(&mut elements, &u, &d, 0)
        });
        let name = format!("{law:?} {volume:?}");
        assert_eq!(a.evaluation, b.evaluation, "{name}");
        for (a, b) in a.nodal.iter().flatten().zip(b.nodal.iter().flatten()) {
            assert_eq!(a.to_array().map(f64::to_bits), b.to_array().map(f64::to_bits), "{name}");
        }
    }
}

#[test]
fn a_stress_that_overflows_is_told_although_the_energy_does_not() {
    let mut mesh = TetMesh {
        positions_m: vec![DVec3::ZERO],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    mesh.positions_m.extend(DVec3::AXES);
    let u = [DVec3::ZERO, DVec3::X * 1e83, DVec3::Y * 1e83, DVec3::Z * (f64::EPSILON - 1.0)];
    let stable = StableNeoHooke::new(LAME_PA[0], LAME_PA[1]).unwrap();
    for law in [ImplicitLaw::from(stable), ImplicitLaw::shared(stable)] {
        let found = elements(&mesh, &law, VolumeResistance::Element, &[]).evaluate(
            &Sequential,
            &u,
            &mut [DVec3::ZERO; 4],
        );
        assert!(found.energy_j.is_finite() && !found.is_upright, "{law:?}: {found:?}");
    }
}

#[test]
fn the_fast_laws_have_no_energy_and_no_force_at_rest_to_the_bit() {
    let mesh = cube(&mut SeededRandom::new(13));
    for (law, volume) in laws().into_iter().filter(|(law, _)| !matches!(law, ImplicitLaw::General(_))) {
        let mut force_n = vec![DVec3::ONE; 8];
        let found = elements(&mesh, &law, volume, &[]).evaluate(&Sequential, &[DVec3::ZERO; 8], &mut force_n);
        assert_eq!((found.energy_j, &force_n), (0.0, &vec![DVec3::ZERO; 8]), "{law:?} {volume:?}");
    }
}

#[test]
fn named_laws_become_the_law_of_a_body() {
    let law = MooneyRivlin::new(100.0, 200.0, 1e4).unwrap();
    let general = ImplicitLaw::from(&MaterialSpec::from(law));
    assert!(matches!(&general, ImplicitLaw::General(laws) if laws.len() == 1));
    assert!(general.modulus_pa() > 1e4);
    let stable = StableNeoHooke::new(LAME_PA[0], LAME_PA[1]).unwrap();
    let fast = ImplicitLaw::from(&MaterialSpec::from(stable));
    assert!(matches!(fast, ImplicitLaw::StableNeoHooke(law) if law == stable));
    let [fast_pa, general_pa] = [fast, ImplicitLaw::shared(stable)].map(|law| law.modulus_pa());
    assert!((fast_pa - general_pa).abs() <= 1e-12 * general_pa, "{fast_pa} {general_pa}");
}
