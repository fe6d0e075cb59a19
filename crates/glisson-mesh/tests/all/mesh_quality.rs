//! Criteria of a tetrahedron's shape, and how it can be degenerate (seed `000` s. 4.4.2).

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::quality::{
    Criterion, Degeneracy, DegeneracyLimits, REGULAR_DIHEDRAL_RAD, REGULAR_SOLID_ANGLE_SR, TetMeasures,
    degeneracy, radius_ratio,
};

/// Regular, with edges 1.
fn regular() -> [DVec3; 4] {
    let half = 0.5 / 2f64.sqrt();
    let corners = [(1., 1., 1.), (1., -1., -1.), (-1., -1., 1.), (-1., 1., -1.)];
    corners.map(|(x, y, z)| half * DVec3::new(x, y, z))
}

/// Corners on a square of side 1, two of them lifted by `height`: flat at 0.
fn sliver(height: f64) -> [DVec3; 4] {
    [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::new(0.0, 1.0, height), DVec3::new(1.0, 0.0, height)]
}

fn cap(height: f64) -> [DVec3; 4] {
    let corner = |turn: f64| {
        let (y, x) = (turn * std::f64::consts::TAU / 3.0).sin_cos();
        DVec3::new(x, y, 0.0)
    };
    [corner(0.0), corner(1.0), corner(2.0), DVec3::new(0.0, 0.0, height)]
}

fn criteria(corners: [DVec3; 4]) -> [f64; 5] {
    let measures = TetMeasures::of(corners);
    Criterion::ALL.map(|criterion| criterion.of(&measures))
}

#[test]
fn the_regular_tetrahedron_has_the_seeds_numbers_and_every_criterion_1() {
    let m = TetMeasures::of(regular());
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-14, "{found} {expected}");
    m.edges_m.into_iter().for_each(|l| near(l, 1.0));
    m.areas_m2.into_iter().for_each(|s| near(s, 3f64.sqrt() / 4.0));
    near(m.volume_m3, 2f64.sqrt() / 12.0);
    near(m.inner_radius_m, 6f64.sqrt() / 12.0);
    near(m.outer_radius_m, 6f64.sqrt() / 4.0);
    near(REGULAR_SOLID_ANGLE_SR, 6.0 * (3f64.sqrt() / 3.0).asin() - std::f64::consts::PI);
    near(REGULAR_DIHEDRAL_RAD, std::f64::consts::PI - (-1f64 / 3.0).acos());
    m.solid_angles_sr.into_iter().for_each(|a| near(a, REGULAR_SOLID_ANGLE_SR));
    m.dihedrals_rad.into_iter().for_each(|a| near(a, REGULAR_DIHEDRAL_RAD));
    for value in criteria(regular()) {
        near(value, 1.0);
    }
}

#[test]
fn solid_angles_are_the_sums_of_dihedral_angles_minus_pi() {
    let mut random = SeededRandom::new(5);
    for _ in 0..50 {
        let corners = [0; 4].map(|_| DVec3::new(random.uniform(), random.uniform(), random.uniform()));
        let m = TetMeasures::of(corners);
        // Dihedral angles by pairs of faces: the three faces at a corner are those opposite to the others.
        for (corner, others) in [[3, 4, 5], [1, 2, 5], [0, 2, 4], [0, 1, 3]].into_iter().enumerate() {
            let excess: f64 = others.iter().map(|&k| m.dihedrals_rad[k]).sum::<f64>() - std::f64::consts::PI;
            assert!((m.solid_angles_sr[corner] - excess).abs() < 1e-9);
        }
        // Another formula of the radii, in the same range for all criteria.
        assert!((Criterion::RadiusRatio.of(&m) - radius_ratio(corners)).abs() < 1e-9);
        assert!(criteria(corners).iter().all(|c| (0.0..=1.0 + 1e-12).contains(c)));
    }
}

#[test]
fn the_corner_of_a_cube_has_its_known_criteria() {
    let m = TetMeasures::of([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
    let root = 3f64.sqrt();
    let inner = 1.0 / (3.0 + root);
    let expected = [
        0.5f64.sqrt(),
        12.0 / 6f64.sqrt() * inner / 2f64.sqrt(),
        3.0 * inner / (root / 2.0),
        // At the three outer corners the dihedral angles are two of acos(1 / sqrt 3) and a right one.
        (2.0 * (1.0 / root).acos() + std::f64::consts::FRAC_PI_2 - std::f64::consts::PI)
            / REGULAR_SOLID_ANGLE_SR,
        (1.0 / root).acos() / REGULAR_DIHEDRAL_RAD,
    ];
    for (criterion, expected) in Criterion::ALL.into_iter().zip(expected) {
        assert!((criterion.of(&m) - expected).abs() < 1e-13, "{criterion:?}");
    }
}

#[test]
fn each_criterion_sees_what_the_seed_says_and_the_radius_ratio_sees_all() {
    let flat = 1e-3;
    let needle = [DVec3::ZERO, flat * DVec3::X, flat * DVec3::Y, DVec3::Z];
    // The edge ratio misses flat ones.
    assert!(criteria(sliver(flat))[0] > 0.7 && criteria(cap(flat))[0] > 0.5);
    // The dihedral angle misses needles.
    assert!(criteria(needle)[4] > 0.6);
    for corners in [sliver(flat), cap(flat), needle] {
        assert!(criteria(corners)[2] < 0.01);
        assert!(criteria(corners)[1] < 0.01 && criteria(corners)[3] < 0.02);
    }
    // Inside out: nothing but the lengths is there.
    let [a, b, c, d] = regular();
    assert_eq!(criteria([b, a, c, d])[1..], [0.0; 4]);
}

#[test]
fn degenerate_tetrahedra_are_told_apart() {
    let limits = DegeneracyLimits::default();
    let [a, b, c, d] = regular();
    let near = |p: DVec3| p + 0.02 * DVec3::new(0.3, -0.5, 0.8);
    let cases = [
        (regular(), None),
        ([a, near(a), c, d], Some(Degeneracy::OneShortEdge)),
        ([a, near(a), c, near(c)], Some(Degeneracy::TwoShortEdges)),
        ([a, near(a), a + 0.02 * DVec3::X, d], Some(Degeneracy::ThreeShortEdges)),
        // A chain of short edges makes one place, whatever the length of its ends' distance.
        ([a - 0.14 * DVec3::X, a, a + 0.14 * DVec3::X, d], Some(Degeneracy::ThreeShortEdges)),
        (sliver(1e-3), Some(Degeneracy::Sliver)),
        (sliver(0.0), Some(Degeneracy::Sliver)),
        (cap(1e-3), Some(Degeneracy::Cap)),
        (cap(0.0), Some(Degeneracy::Cap)),
        (sliver(0.9), None),
        (cap(1.0), None),
        ([a, b, c, 0.2 * (a + b + c) + 0.1 * d], None),
    ];
    for (at, (corners, expected)) in cases.into_iter().enumerate() {
        // The order of the corners does not count, as long as the volume is positive.
        let [p, q, r, s] = corners;
        for order in [[p, q, r, s], [q, r, p, s], [r, p, q, s], [q, p, s, r]] {
            assert_eq!(degeneracy(order, &limits), expected, "case {at}");
        }
    }
    assert!(Degeneracy::OneShortEdge.has_short_edges() && !Degeneracy::Cap.has_short_edges());
}
