use super::super::rod::RodMaterial;
use super::super::tie::TieLaw;
use super::*;

const DENSITY: f64 = 6e-5;

fn thread(positions_m: Vec<DVec3>, spacing_m: f64, bending: f64) -> Rod {
    Rod::new(positions_m, spacing_m, 1.5e-4, |_| RodMaterial {
        axial_stiffness_n: 100.0,
        bending_stiffness_n_m2: bending,
        linear_density_kg_per_m: DENSITY,
    })
}

fn held(n_nodes: usize, segment: usize, share: f64, place_m: DVec3) -> Tie {
    Tie {
        at: RodPlace::on_segment(n_nodes, segment, share),
        law: TieLaw::Held,
        stiffness_n_per_m: 1e4,
        place_m,
        force_before_n: DVec3::ZERO,
    }
}

fn run(
    rod: &mut Rod,
    ties: &mut [Tie],
    bonds: &[Bond],
    n_steps: usize,
    mut lead: impl FnMut(usize, &mut [Tie]),
) {
    let mut solver = Solver::new(rod.n_nodes());
    for step in 0..n_steps {
        lead(step, ties);
        let around = Surroundings { ties, bonds, dt_s: 1e-3 };
        solver.start(rod, DVec3::Z * -9.81, 1e-3);
        solver.settle(rod, &around);
        solver.finish(rod, 1e-3);
    }
}

/// A thread between two places at the same height hangs as a catenary.
#[test]
fn a_slack_thread_hangs_as_a_catenary() {
    let n = 81;
    let spacing_m = 2e-3;
    // Laid as a roof: the right length between places 120 mm apart.
    let length_m = spacing_m * (n - 1) as f64;
    let half_m: f64 = 0.06;
    let high_m = (0.25 * length_m * length_m - half_m * half_m).sqrt();
    let place = |i: usize| {
        let share = i as f64 / (n - 1) as f64;
        let up = 1.0 - (2.0 * share - 1.0).abs();
        DVec3::new(2.0 * half_m * share - half_m, 0.0, -high_m * up)
    };
    let mut rod = thread((0..n).map(place).collect(), spacing_m, 1e-12);
    let mut ties = [held(n, 0, 0.0, place(0)), held(n, n - 2, 1.0, place(n - 1))];
    run(&mut rod, &mut ties, &[], 1500, |_, _| {});
    // 2 a sinh(w/(2 a)) = length.
    let mut a_m: f64 = 0.05;
    for _ in 0..60 {
        let f = 2.0 * a_m * (half_m / a_m).sinh() - length_m;
        let slope = 2.0 * (half_m / a_m).sinh() - 2.0 * half_m / a_m * (half_m / a_m).cosh();
        a_m -= f / slope;
    }
    let sag_m = a_m * ((half_m / a_m).cosh() - 1.0);
    assert!((-rod.positions_m[n / 2].z / sag_m - 1.0).abs() < 0.01, "{} {sag_m}", rod.positions_m[n / 2].z);
    let lowest_n = DENSITY * 9.81 * a_m;
    assert!((rod.tension_n(n / 2) / lowest_n - 1.0).abs() < 0.02, "{} {lowest_n}", rod.tension_n(n / 2));
}

/// The end of a clamped thread sinks by q l^4/(8 EI) under its own weight.
#[test]
fn a_short_thread_bends_under_its_weight_as_a_beam() {
    let (n, spacing_m, bending) = (21, 1e-3, 3e-6);
    let place = |i: usize| DVec3::X * (spacing_m * i as f64);
    let mut rod = thread((0..n).map(place).collect(), spacing_m, bending);
    let clamp = |segment, share, place_m| Tie { stiffness_n_per_m: 1e8, ..held(n, segment, share, place_m) };
    let mut ties = [clamp(0, 0.0, place(0)), clamp(1, 0.0, place(1))];
    run(&mut rod, &mut ties, &[], 600, |_, _| {});
    // The spring of the second node stands for the half segments on both sides of it.
    let free_m = spacing_m * (n as f64 - 1.5);
    let sinks_m = DENSITY * 9.81 * free_m.powi(4) / (8.0 * bending);
    let found_m = -rod.positions_m[n - 1].z;
    assert!((found_m / sinks_m - 1.0).abs() < 0.02, "{found_m} {sinks_m}");
}

/// Points on a path of straight pieces, so far apart.
fn resampled(path_m: &[DVec3], spacing_m: f64) -> Vec<DVec3> {
    let mut points_m = vec![path_m[0]];
    let mut left_m = spacing_m;
    for piece in path_m.windows(2) {
        let (mut at_m, along) = (piece[0], (piece[1] - piece[0]).normalize());
        while at_m.distance(piece[1]) >= left_m {
            at_m += along * left_m;
            points_m.push(at_m);
            left_m = spacing_m;
        }
        left_m -= at_m.distance(piece[1]);
    }
    points_m
}

/// A thread crosses over itself, and is pressed down on itself with several newtons.
#[test]
fn a_thread_pressed_against_itself_does_not_pass() {
    let spacing_m = 2e-3;
    let corners_m = [[0, 0, 0], [60, 0, 0], [70, -20, 0], [50, -40, 2], [30, -40, 4], [30, 40, 4]];
    let path_m = corners_m.map(|corner| DVec3::from_array(corner.map(|mm| 1e-3 * f64::from(mm))));
    let positions_m = resampled(&path_m, spacing_m);
    let n = positions_m.len();
    let mut rod = thread(positions_m.clone(), spacing_m, 1e-9);
    let soft = |node: usize| {
        let (segment, share) = if node + 1 < n { (node, 0.0) } else { (n - 2, 1.0) };
        Tie { stiffness_n_per_m: 1e3, ..held(n, segment, share, positions_m[node]) }
    };
    let mut ties = [soft(0), soft(30), soft(n - 34), soft(n - 1)];
    let mut least_m = f64::INFINITY;
    let mut most_n: f64 = 0.0;
    let mut pairs = Vec::with_capacity(room_for_pairs(n));
    let mut solver = Solver::new(n);
    for step in 0..1500 {
        let down_m = DVec3::Z * (-0.022 * (step as f64 / 1000.0).min(1.0));
        ties[2].place_m = positions_m[n - 34] + down_m;
        ties[3].place_m = positions_m[n - 1] + down_m;
        find_pairs(&rod.positions_m, (rod.radius_m(), 0.0), &[], &mut pairs);
        let nearest_m = pairs.iter().map(|pair| pair.nearness(&rod.positions_m).distance_m);
        least_m = nearest_m.fold(least_m, f64::min);
        most_n = ties.iter().map(|tie| tie.force_n(&rod.positions_m).length()).fold(most_n, f64::max);
        let gravity_m_per_s2 = DVec3::Z * -9.81;
        let around = Surroundings { ties: &ties, bonds: &[], dt_s: 1e-3 };
        solver.start(&rod, gravity_m_per_s2, 1e-3);
        solver.settle(&mut rod, &around);
        solver.finish(&mut rod, 1e-3);
    }
    assert!(least_m > rod.radius_m(), "{least_m}");
    assert!(most_n > 0.5 && most_n < 20.0, "{most_n}");
    // The upper one lies on the lower one, and both sag.
    let upper_m = rod.positions_m[n - 21].z;
    assert!((-0.016..=-0.003).contains(&upper_m), "{upper_m}");
}

/// A clip makes a ring of a thread, which stays one when it is pulled.
#[test]
fn a_bond_holds_two_places_together() {
    let n = 41;
    let spacing_m = 2e-3;
    let radius_m = spacing_m * 40.0 / std::f64::consts::TAU;
    let place = |i: usize| {
        let angle = 0.98 * std::f64::consts::TAU * i as f64 / (n - 1) as f64;
        DVec3::new(angle.cos(), angle.sin(), 0.02 * angle) * radius_m
    };
    let mut rod = thread((0..n).map(place).collect(), spacing_m, 1e-9);
    let bond = Bond {
        at: [RodPlace::on_segment(n, 1, 0.0), RodPlace::on_segment(n, n - 3, 1.0)],
        stiffness_n_per_m: 1e4,
    };
    let mut ties = [held(n, 20, 0.0, place(20)), held(n, 0, 0.0, place(0))];
    run(&mut rod, &mut ties, &[bond], 1500, |step, ties| {
        ties[1].place_m = place(0) + DVec3::X * (0.0155 * (step as f64 / 1000.0).min(1.0));
    });
    let [a, b] = bond.at.map(|at| at.point_m(&rod.positions_m));
    let pull_n = rod.tension_n(0);
    assert!(a.distance(b) < 5e-4, "{} m", a.distance(b));
    // Both strands of the ring bear the pull; the clip gives way a little between them.
    let strands_n = [10, 30].map(|segment| rod.tension_n(segment));
    assert!(pull_n > 0.5 && ((strands_n[0] + strands_n[1]) / pull_n - 1.0).abs() < 0.02, "{strands_n:?}");
    assert!((strands_n[0] / strands_n[1]).ln().abs() < 0.3, "{strands_n:?} {pull_n}");
}
