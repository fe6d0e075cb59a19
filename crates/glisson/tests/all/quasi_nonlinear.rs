//! The quasi non-linear correction: fits against exact polynomials, eqs 3 to 6 node by node, files with errors.

use crate::model_meshes::block;
use glisson::material::LinearElastic;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::quasi_nonlinear::{
    Correction, CurvePolynomial, FitError, LinearSample, MeasuredCurve, QuasiNonlinear, fit_curve,
};
use glisson::model::{
    Constraints, DeformableModel, FixedNode, ImposedDisplacement, LocalModel, LocalWork, NodalForce,
};
use glisson::scene::{MeasuredSample, OrganBody, build_model};
use proptest::prelude::*;
use std::path::Path;

fn horner(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| x * (sum + c))
}

#[test]
fn a_polynomial_of_each_degree_is_found_again() {
    let mut random = SeededRandom::new(4);
    for degree in 4..=10 {
        for low in [0.0, -3e-3] {
            // Rising: the slope at zero is larger than the sum of all that follows.
            let mut c: Vec<f64> = (0..degree).map(|_| random.uniform_in(-0.1, 0.1)).collect();
            c[0] = 2.0;
            let x: Vec<f64> = (0..=60).map(|i| low + (4e-3 - low) * f64::from(i) / 60.0).collect();
            let y: Vec<f64> = x.iter().map(|x| 12.0 * horner(&c, x / 4e-3)).collect();
            let fit = fit_curve(&x, &y, degree).unwrap();
            assert!(fit.largest_residual < 1e-12 * 30.0, "degree {degree}: {:e}", fit.largest_residual);
            assert!(fit.correlation > 1.0 - 1e-12);
            assert_eq!(fit.polynomial.is_odd(), low == 0.0);
            for (found, expected) in fit.polynomial.powers().iter().zip(&c) {
                assert!((found - 12.0 * expected).abs() < 1e-7, "degree {degree}: {found} {expected}");
            }
        }
    }
}

#[test]
fn noise_is_smoothed_as_least_squares_says() {
    let mut random = SeededRandom::new(5);
    let x: Vec<f64> = (1..=200).map(|i| f64::from(i) / 200.0).collect();
    let y: Vec<f64> = x.iter().map(|x| (2.0 * x).exp() - 1.0 + 0.01 * random.normal()).collect();
    let fit = fit_curve(&x, &y, 6).unwrap();
    // The residual is orthogonal to every column x^k: the normal equations hold.
    for k in 1..=6 {
        let sum: f64 = x.iter().zip(&y).map(|(x, y)| x.powi(k) * (y - fit.polynomial.value(*x))).sum();
        assert!(sum.abs() < 1e-10, "power {k}: {sum:e}");
    }
    assert!((0.007..0.013).contains(&fit.rms_residual) && fit.correlation > 0.9999);
    assert!(fit.polynomial.is_rising());
}

#[test]
fn points_of_negative_compression_make_the_same_curve() {
    let x: Vec<f64> = (1..=20).map(|i| 1e-4 * f64::from(i)).collect();
    let y: Vec<f64> = x.iter().map(|x| 3.0 * x + 800.0 * x * x).collect();
    let minus = |v: &[f64]| v.iter().map(|x| -x).collect::<Vec<f64>>();
    let (plus, mirrored) = (fit_curve(&x, &y, 5).unwrap(), fit_curve(&minus(&x), &minus(&y), 5).unwrap());
    assert_eq!(plus.polynomial, mirrored.polynomial);
    assert!((mirrored.correlation - 1.0).abs() < 1e-12);
}

#[test]
fn what_cannot_be_fitted_is_told() {
    let x: Vec<f64> = (0..=10).map(f64::from).collect();
    let message = |x: &[f64], y: &[f64], degree| fit_curve(x, y, degree).unwrap_err().to_string();
    assert_eq!(message(&x, &x, 3), "degree 3; allowed: 4 to 10");
    assert_eq!(fit_curve(&x, &x, 11), Err(FitError::Degree { found: 11 }));
    assert_eq!(message(&x, &x[1..], 4), "11 arguments but 10 values");
    let text = message(&x[..5], &x[..5], 4);
    assert!(text.starts_with("4 different arguments other than 0; a polynomial of degree 4"), "{text}");
    let falling: Vec<f64> = x.iter().map(|x| -x).collect();
    assert!(message(&x, &falling, 4).contains("run against the arguments"));
    assert!(message(&x, &[0.0; 11], 4).contains("run against the arguments"));
    let mut broken = x.clone();
    broken[4] = f64::NAN;
    assert_eq!(message(&x, &broken, 4), "point 5 (from 1) is not finite");
    let close: Vec<f64> = (0..20).map(|i| 1.0 + 1e-13 * f64::from(i)).collect();
    assert_eq!(fit_curve(&close, &close, 10), Err(FitError::Undetermined { degree: 10 }));
}

fn parse(text: &str) -> Result<MeasuredCurve, String> {
    MeasuredCurve::parse(Path::new("brain.csv"), text.as_bytes()).map_err(|e| e.to_string())
}

const CURVE: &str =
    "# brain\naxial_displacement_mm, force_mn, radial_displacement_m\n0,0,0\n1.5,250,0.4e-3\n";

#[test]
fn a_curve_is_read_in_si_and_its_faults_are_named() {
    let curve = parse(CURVE).unwrap();
    assert_eq!(curve.axial_displacement_m, [0.0, 1.5e-3]);
    assert_eq!(curve.force_n, [0.0, 0.25]);
    assert_eq!(curve.radial_displacement_m, [0.0, 0.4e-3]);
    let windows = format!("\u{feff}{}", CURVE.replace('\n', "\r\n"));
    assert_eq!(parse(&windows).unwrap(), curve);
    for (text, expected) in [
        ("", "brain.csv: no line of column names"),
        ("axial_displacement_mm,forc_n\n", "brain.csv:1: column 2 is called `forc_n`"),
        ("axial_displacement_mm,forc_n\n", "did you mean \"force_n\"?"),
        ("# c\n\nforce_n,radial_displacement_m\n", "brain.csv:3: no column of axial displacement"),
        ("axial_displacement_m\n", "no column of force or radial displacement"),
        ("axial_displacement_m,force_n,force_mn\n", "brain.csv:1: column 3 gives the force a second time"),
        ("axial_displacement_m,force_n\n0,0\n1,2,3\n", "brain.csv:3: 3 fields, but line 1 names 2 columns"),
        (
            "axial_displacement_m,force_n\n0,0\n1,2N\n",
            "brain.csv:3: column 2 (force_n): `2N` is not a finite number",
        ),
        ("axial_displacement_m,force_n\ninf,0\n", "column 1 (axial_displacement_m): `inf`"),
        ("axial_displacement_m,force_n\n1,\n", "column 2 (force_n): `` is not"),
    ] {
        let found = parse(text).unwrap_err();
        assert!(found.contains(expected), "{found}\n{expected}");
    }
    let error = MeasuredCurve::parse(Path::new("c.csv"), b"axial\xff").unwrap_err();
    assert_eq!(error.to_string(), "c.csv: byte 5 is not UTF-8 text");
    assert!(
        MeasuredCurve::read(Path::new("no_such.csv")).unwrap_err().to_string().starts_with("no_such.csv: ")
    );
}

proptest! {
    #[test]
    fn mutated_curves_never_panic(
        changes in prop::collection::vec((0usize..200, any::<u8>()), 0..6),
        cut in prop::option::of(0usize..200),
    ) {
        let mut bytes = CURVE.as_bytes().to_vec();
        let n = bytes.len();
        for (place, value) in changes {
            bytes[place % n] = value;
        }
        bytes.truncate(cut.unwrap_or(n));
        match MeasuredCurve::parse(Path::new("f"), &bytes) {
            Ok(curve) => {
                let n = curve.axial_displacement_m.len();
                for list in [&curve.force_n, &curve.radial_displacement_m] {
                    prop_assert!(list.is_empty() || list.len() == n);
                    prop_assert!(list.iter().all(|x| x.is_finite()));
                }
                let _ = fit_curve(&curve.axial_displacement_m, &curve.force_n, 4);
            }
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }
}

fn softening() -> CurvePolynomial {
    let x: Vec<f64> = (0..=50).map(|i| 2e-2 * f64::from(i)).collect();
    let y: Vec<f64> = x.iter().map(|x| 1.5 * (1.0 - (-x).exp())).collect();
    fit_curve(&x, &y, 8).unwrap().polynomial
}

struct Organ {
    mesh: TetMesh,
    linear: Precomputed,
    top: Vec<NodeId>,
}

fn organ() -> Organ {
    let mesh = block([3, 3, 3], DVec3::new(0.06, 0.06, 0.05));
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1060.0).unwrap();
    let at_height = |z: f64| {
        let places = mesh.positions_m.iter().enumerate();
        places.filter(|(_, p)| (p.z - z).abs() < 1e-9).map(|(n, _)| NodeId::from_index(n)).collect::<Vec<_>>()
    };
    let (fixed_nodes, top) = (at_height(0.0), at_height(0.05));
    let stored = StoredNodes::All;
    let params = PrecomputedParams {
        mesh: &mesh,
        material: &material,
        fixed_nodes: &fixed_nodes,
        stored,
        precision: Precision::F64,
        progress: None,
    };
    let linear = Precomputed::build(&params).unwrap();
    Organ { mesh, linear, top }
}

fn pushed(nodes: &[NodeId], by_m: impl Fn(NodeId) -> DVec3) -> Constraints {
    let displacements = nodes.iter().map(|&node| ImposedDisplacement { node, displacement_m: by_m(node) });
    Constraints { displacements: displacements.collect(), forces: Vec::new() }
}

/// Equations 3 to 6 at every node, from the linear model beside it.
#[test]
fn one_pushed_node_follows_the_equations() {
    let Organ { mesh, mut linear, top } = organ();
    let correction =
        Correction { force: Some(softening().enlarged(0.3)), radial: Some(softening().enlarged(2e-3)) };
    let mut model = QuasiNonlinear::new(linear.duplicate(), &mesh, correction).unwrap();
    let (p, q) = (correction.radial.unwrap(), correction.force.unwrap());
    for depth_m in [1e-12, 1e-4, 2e-3, 8e-3, 0.03] {
        let imposed_m = DVec3::new(0.2, -0.1, -1.0).normalize() * depth_m;
        let load = pushed(&top[5..6], |_| imposed_m);
        for model in [&mut linear as &mut dyn DeformableModel, &mut model] {
            model.apply(&load);
            model.step(1e-3);
        }
        let d = imposed_m.normalize();
        assert!((model.axis() - d).length() < 1e-14);
        for n in 0..mesh.positions_m.len() {
            let u = linear.state().positions_m[n] - mesh.positions_m[n];
            let (along, across) = (d * u.dot(d), u - d * u.dot(d));
            let expected = along + across.normalize_or_zero() * p.value(across.length());
            let found = model.state().positions_m[n] - mesh.positions_m[n];
            assert!((found - expected).length() < 1e-15 + 1e-12 * depth_m, "node {n}: {found} {expected}");
        }
        let f = linear.constraint_forces_n()[0];
        let along = d * f.dot(d);
        let expected = f - along + along.normalize() * q.value(along.length());
        let off_n = (model.constraint_forces_n()[0] - expected).length();
        assert!(off_n <= 1e-13 * f.length(), "{off_n:e} of {f}");
    }
}

/// A line of slope 1 changes nothing; the sum of a plate's forces follows Q whatever their shares.
#[test]
fn a_plate_follows_the_curve_as_a_whole() {
    let Organ { mesh, mut linear, top } = organ();
    let unit = CurvePolynomial::line(1.0, 1.0);
    let same = Correction { force: Some(unit), radial: Some(unit) };
    let q = softening().enlarged(0.8);
    let mut unchanged = QuasiNonlinear::new(linear.duplicate(), &mesh, same).unwrap();
    let corrected = Correction { force: Some(q), radial: None };
    let mut model = QuasiNonlinear::new(linear.duplicate(), &mesh, corrected).unwrap();
    let load = pushed(&top, |_| DVec3::new(0.0, 0.0, -6e-3));
    for model in [&mut linear as &mut dyn DeformableModel, &mut unchanged, &mut model] {
        model.apply(&load);
        model.step(1e-3);
    }
    assert_eq!(unchanged.constraint_forces_n(), linear.constraint_forces_n());
    assert_eq!(unchanged.state().positions_m, linear.state().positions_m);
    let sum_z = |forces: &[DVec3]| forces.iter().map(|f| f.z).sum::<f64>();
    let (found, whole) = (sum_z(model.constraint_forces_n()), sum_z(linear.constraint_forces_n()));
    assert!((found + q.value(-whole)).abs() < 1e-12, "{found} {whole}");
    assert!(found.abs() < 0.9 * whole.abs());
}

/// Jaws feel each their own sum; a curve of both signs tells a pull from a push.
#[test]
fn jaws_are_told_apart_and_so_are_push_and_pull() {
    let Organ { mesh, linear, top } = organ();
    let mut c: Vec<[f64; 2]> =
        (-40..=40).map(|i| 0.05 * f64::from(i)).map(|x| [x, x + 0.2 * x * x]).collect();
    c.retain(|p| p[0] != 0.0);
    let (x, y): (Vec<f64>, Vec<f64>) = c.into_iter().map(|[x, y]| (x, y)).unzip();
    let q = fit_curve(&x, &y, 4).unwrap().polynomial;
    assert!(!q.is_odd());
    let correction = Correction { force: Some(q), radial: None };
    let mut model = QuasiNonlinear::new(linear.duplicate(), &mesh, correction).unwrap();
    for sign in [-1.0, 1.0] {
        let load = pushed(&top, |_| DVec3::new(0.0, 0.0, sign * 4e-3));
        model.apply(&load);
        model.step(1e-3);
        let z = |forces: &[DVec3]| forces.iter().map(|f| f.z).sum::<f64>();
        let (found, whole) = (z(model.constraint_forces_n()), z(model.linear().constraint_forces_n()));
        // Pushed down is compression: a positive argument.
        assert!((found + q.value(-whole)).abs() < 1e-12, "{sign}: {found} {whole}");
    }
    let (left, right) = (top[4], top[7]);
    let load = pushed(&[left, right], |n| DVec3::X * if n == left { 2e-3 } else { -1e-3 });
    model.apply(&load);
    model.step(1e-3);
    for (found, whole) in model.constraint_forces_n().iter().zip(model.linear().constraint_forces_n()) {
        assert!((found.y - whole.y).abs() < 1e-15 && (found.x.abs() - whole.x.abs()).abs() > 1e-6);
        assert!(found.x * whole.x > 0.0);
    }
}

#[test]
fn a_cylinders_curves_become_curves_of_its_linear_answer() {
    let material = LinearElastic::from_young_poisson(3e3, 0.45, 1000.0).unwrap();
    let sample = LinearSample::cylinder(0.013, 0.015, &material);
    let (force, radial) = (softening(), softening().enlarged(0.01));
    let correction = Correction::of_sample(Some(&force), Some(&radial), &sample).unwrap();
    for x_m in [1e-4, 2e-3] {
        let linear_n = std::f64::consts::PI * 0.015 * 0.015 * 3e3 * x_m / 0.013;
        let linear_m = 0.45 * 0.015 * x_m / 0.013;
        assert!((correction.force.unwrap().value(linear_n) - force.value(x_m)).abs() < 1e-15);
        assert!((correction.radial.unwrap().value(linear_m) - radial.value(x_m)).abs() < 1e-15);
    }
}

#[test]
fn steps_allocate_nothing_in_the_model_and_its_copies() {
    let Organ { mesh, linear, top } = organ();
    let correction = Correction { force: Some(softening()), radial: Some(softening()) };
    let mut model = QuasiNonlinear::new(Box::new(linear), &mesh, correction).unwrap();
    let mut load = pushed(&top, |_| DVec3::new(1e-3, 0.0, -6e-3));
    load.forces = vec![NodalForce { node: top[0], force_n: DVec3::X }];
    let run = |model: &mut dyn DeformableModel| {
        let count = allocation_counter::measure(|| {
            for _ in 0..3 {
                model.apply(&load);
                model.step(1e-3);
            }
        });
        assert_eq!(count.count_total, 0);
        model.state().positions_m.to_vec()
    };
    let mut copy = model.duplicate();
    let places_m = run(&mut model);
    assert_eq!(run(&mut *copy), places_m);
    assert_eq!(run(&mut *copy.duplicate()), places_m);
    assert!(model.topology_refusal().is_some());
}

/// A sample that does not bulge, or gets thinner, has no linear bulging for the arguments of P.
#[test]
fn a_poisson_ratio_without_bulging_is_refused_where_a_curve_needs_it() {
    let (force, radial) = (softening(), softening().enlarged(0.01));
    let folder = tempfile::tempdir().unwrap();
    let mut text = "axial_displacement_mm,force_n,radial_displacement_mm\n".to_owned();
    for i in 0..=20 {
        let x = 0.2 * f64::from(i);
        text += &format!("{x},{},{}\n", 0.1 * x + 0.02 * x * x, 0.5 * x);
    }
    let curve = folder.path().join("curve.csv");
    std::fs::write(&curve, text).unwrap();
    for poisson_ratio in [0.0, -0.1] {
        let material = LinearElastic::from_young_poisson(3e3, poisson_ratio, 1000.0).unwrap();
        let sample = LinearSample::cylinder(0.013, 0.015, &material);
        let error = Correction::of_sample(Some(&force), Some(&radial), &sample).unwrap_err();
        assert!(error.quantity.contains("bulging") && error.found == sample.radial_m_per_m, "{error}");
        assert!(Correction::of_sample(Some(&force), None, &sample).is_ok());

        let mesh = block([2, 2, 2], DVec3::new(0.04, 0.04, 0.04));
        let mut body = OrganBody::new(mesh, material, 1e-3);
        let bottom = body.mesh.positions_m.iter().enumerate().filter(|(_, p)| p.z < 1e-9);
        body.fixed = bottom.map(|(n, _)| FixedNode::all_axes(NodeId::from_index(n))).collect();
        let (height_m, radius_m, degree) = (0.013, 0.015, 4);
        body.measured = Some(MeasuredSample { curve: curve.clone(), height_m, radius_m, degree });
        let error = build_model(&body, ModelKind::QuasiNonlinear).err().unwrap().to_string();
        let expected = format!("poisson_ratio = {poisson_ratio}");
        assert!(
            error.contains(&expected) && error.contains("curve.csv") && error.contains("above 0"),
            "{error}"
        );
    }
}

/// What the local model predicts of a deeper push is what the model then does.
#[test]
fn the_local_model_follows_the_curve() {
    let Organ { mesh, linear, top } = organ();
    let correction =
        Correction { force: Some(softening().enlarged(0.8)), radial: Some(softening().enlarged(2e-3)) };
    let plain = linear.clone();
    let mut model = QuasiNonlinear::new(Box::new(linear), &mesh, correction).unwrap();
    let (mut work, mut local, mut uncorrected) =
        (LocalWork::with_room_for(mesh.positions_m.len()), LocalModel::new(), LocalModel::new());
    for nodes in [&top[5..6], &top[..]] {
        let press = |model: &mut QuasiNonlinear, depth_m: f64| -> Vec<DVec3> {
            model.apply(&pushed(nodes, |_| DVec3::new(0.0, 0.0, -depth_m)));
            model.step(1e-3);
            model.constraint_forces_n().to_vec()
        };
        let (depth_m, more_m) = (8e-3, 1e-5);
        let deeper_n = press(&mut model, depth_m + more_m);
        let force_n = press(&mut model, depth_m);
        let count =
            allocation_counter::measure(|| model.local_model_into(nodes, 1e-3, &mut work, &mut local));
        assert_eq!(count.count_total, 0);
        plain.duplicate().local_model_into(nodes, 1e-3, &mut work, &mut uncorrected);
        assert_eq!(local.nodes, nodes);
        for (i, node) in nodes.iter().enumerate() {
            assert_eq!(local.position_m[i], model.state().positions_m[node.index()]);
            assert!((local.force_n[i] - force_n[i]).length() < 1e-14, "{} {}", local.force_n[i], force_n[i]);
        }
        let mut predicted_m = vec![DVec3::ZERO; nodes.len()];
        let mut linear_m = vec![DVec3::ZERO; nodes.len()];
        local.predict_into(&deeper_n, &mut predicted_m);
        uncorrected.position_m.copy_from_slice(&local.position_m);
        uncorrected.force_n.copy_from_slice(&local.force_n);
        uncorrected.predict_into(&deeper_n, &mut linear_m);
        for i in 0..nodes.len() {
            let by_m = |after_m: &[DVec3]| local.position_m[i].z - after_m[i].z;
            let (off, linear_off) = (by_m(&predicted_m) / more_m - 1.0, by_m(&linear_m) / more_m - 1.0);
            // A plate that holds its nodes sideways too has large terms across, which C has with another factor.
            let most = if nodes.len() == 1 { 0.03 } else { 0.5 * linear_off.abs() };
            assert!(off.abs() < most, "{} nodes, {i}: {off}, linear {linear_off}", nodes.len());
            assert!(linear_off.abs() > 0.1, "{} nodes, {i}: {linear_off}", nodes.len());
        }
        let n = 3 * nodes.len();
        let c = &local.compliance_m_per_n;
        let mut random = SeededRandom::new(9);
        for _ in 0..20 {
            let x: Vec<f64> = (0..n).map(|_| random.normal()).collect();
            let energy: f64 = (0..n).map(|i| (0..n).map(|j| x[i] * c[n * i + j] * x[j]).sum::<f64>()).sum();
            assert!(energy > 0.0);
        }
        assert!((0..n).all(|i| (0..i).all(|j| c[n * i + j] == c[n * j + i])));
    }
    // Forces act on the linear body.
    let force = NodalForce { node: top[5], force_n: DVec3::new(0.0, 0.0, -0.02) };
    model.apply(&Constraints { displacements: Vec::new(), forces: vec![force] });
    model.step(1e-3);
    model.local_model_into(&top, 1e-3, &mut work, &mut local);
    assert_eq!(local.compliance_m_per_n, uncorrected.compliance_m_per_n);
    assert_eq!(local.force_n[5], force.force_n);
}
