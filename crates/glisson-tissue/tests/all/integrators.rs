//! Integrators: order of convergence, energy, stability, nodes that are held.

use glisson_mesh::math::DVec3;
use glisson_tissue::solve::integrators::{
    Effort, EquationsOfMotion, FixedPoint, Integrator, ModeBounds, Motion, Scheme,
};

/// Three oscillators in the components of one node: a = -omega^2 x.
struct Oscillators {
    omega_rad_per_s: DVec3,
}

impl EquationsOfMotion for Oscillators {
    fn accelerations_into(&mut self, x: &[DVec3], _: &[DVec3], a: &mut [DVec3]) {
        for (a, x) in a.iter_mut().zip(x) {
            *a = -self.omega_rad_per_s * self.omega_rad_per_s * *x;
        }
    }
}

const OMEGA: DVec3 = DVec3::new(1.0, 2.0, 3.0);

/// One oscillating node and what it takes to move it.
struct Run {
    oscillators: Oscillators,
    integrator: Integrator,
    x: [DVec3; 1],
    v: [DVec3; 1],
    d: [f64; 1],
}

impl Run {
    fn new(scheme: Scheme, omega_rad_per_s: DVec3, d: f64) -> Self {
        let fixed_point = FixedPoint { tolerance_m: 1e-15, most_iterations: 200 };
        Self {
            oscillators: Oscillators { omega_rad_per_s },
            integrator: Integrator::new(scheme, fixed_point, 1),
            x: [DVec3::ONE],
            v: [DVec3::ZERO],
            d: [d],
        }
    }

    fn step(&mut self, h_s: f64) -> Effort {
        let mut motion = Motion {
            positions_m: &mut self.x,
            velocities_m_per_s: &mut self.v,
            moves: &[true],
            damping_per_s: &self.d,
        };
        self.integrator.step(&mut self.oscillators, &mut motion, h_s)
    }

    fn energy(&self) -> f64 {
        0.5 * (self.v[0].length_squared() + (self.oscillators.omega_rad_per_s * self.x[0]).length_squared())
    }
}

/// x'' + d x' + omega^2 x = 0 from x = 1 at standstill.
fn exact(omega: f64, d: f64, t: f64) -> f64 {
    let w = (omega * omega - 0.25 * d * d).sqrt();
    (-0.5 * d * t).exp() * ((w * t).cos() + 0.5 * d / w * (w * t).sin())
}

#[test]
fn every_scheme_converges_with_its_order() {
    for scheme in Scheme::ALL {
        for d in [0.0, 0.4] {
            let error = |n_steps: u32| {
                let t = 2.0;
                let mut run = Run::new(scheme, OMEGA, d);
                for _ in 0..n_steps {
                    assert!(!run.step(t / f64::from(n_steps)).missed_fixed_point);
                }
                let expected = DVec3::from_array(OMEGA.to_array().map(|omega| exact(omega, d, t)));
                (run.x[0] - expected).length()
            };
            let (coarse, fine) = (error(160), error(320));
            let order = (coarse / fine).log2();
            let wanted = f64::from(scheme.order());
            assert!((order - wanted).abs() < 0.2, "{} d {d}: order {order}, error {fine:e}", scheme.name());
        }
    }
}

#[test]
fn energy_is_kept_lost_or_gained_as_the_scheme_promises() {
    let energy_after = |scheme: Scheme| {
        let mut run = Run::new(scheme, OMEGA, 0.0);
        let before = run.energy();
        let mut largest: f64 = 0.0;
        for _ in 0..20_000 {
            run.step(0.05);
            largest = largest.max(run.energy());
        }
        [run.energy() / before, largest / before]
    };
    for scheme in [Scheme::CentralDifferences, Scheme::SemiImplicitEuler] {
        // 1000 s, some 480 periods of the fastest: it swings about its first value and does not drift.
        let [last, largest] = energy_after(scheme);
        assert!((0.8..1.2).contains(&last) && largest < 1.2, "{} {last} {largest}", scheme.name());
    }
    assert!(energy_after(Scheme::RungeKutta4)[0] > 0.9);
    assert!(energy_after(Scheme::RungeKutta4)[1] <= 1.0 + 1e-12);
    assert!(energy_after(Scheme::RungeKutta2)[0] > 1.5, "the midpoint rule amplifies");
    assert!(energy_after(Scheme::BackwardDifferences1)[0] < 1e-6);
    assert!(energy_after(Scheme::BackwardDifferences2)[0] < 0.5);
}

#[test]
fn the_stable_step_is_the_border_of_stability() {
    let omega = 50.0;
    for scheme in Scheme::ALL {
        for d in [0.0, 8.0, 60.0] {
            let bounds = ModeBounds {
                highest_frequency_rad_per_s: omega,
                damping_per_s: [d, d],
                viscosity_per_s: 0.0,
            };
            let h_s = scheme.stable_step_s(&bounds);
            if scheme == Scheme::RungeKutta2 && d == 0.0 {
                assert_eq!(h_s, 0.0);
                continue;
            }
            let largest = |h_s: f64| {
                // The whole range of modes: a slow one can be the first to grow when the damping is strong.
                let mut run = Run::new(scheme, omega * DVec3::new(1.0, 0.5, 1.0 / 24.0), d);
                (0..20_000).map(|_| run.step(h_s)).for_each(drop);
                run.x[0].length()
            };
            let name = scheme.name();
            // Central differences come to the border with a double root: it grows at most linearly there.
            let stable = largest(0.995 * h_s);
            assert!(stable < 10.0, "{name} d {d} h {h_s}: {stable}");
            if matches!(scheme, Scheme::BackwardDifferences1 | Scheme::BackwardDifferences2) {
                // The border is that of fast contraction; at a good twice the step it does not contract any more.
                let mut run = Run::new(scheme, DVec3::splat(omega), 0.0);
                assert!(!run.step(h_s).missed_fixed_point, "{name}");
                assert!(run.step(2.2 * h_s).missed_fixed_point, "{name}");
            } else {
                let unstable = largest(1.01 * h_s);
                assert!(unstable.is_nan() || unstable >= 1e3, "{name} d {d} h {h_s}: {unstable}");
            }
        }
    }
}

#[test]
fn held_nodes_stay_where_they_were_put_and_the_past_can_be_restored() {
    for scheme in Scheme::ALL {
        let mut integrator = Integrator::new(scheme, FixedPoint::default(), 2);
        let mut equations = Oscillators { omega_rad_per_s: OMEGA };
        let mut x = [DVec3::ONE, DVec3::ONE];
        let mut v = [DVec3::ZERO, DVec3::X];
        let go = |integrator: &mut Integrator,
                  equations: &mut Oscillators,
                  x: &mut [DVec3; 2],
                  v: &mut [DVec3; 2]| {
            for _ in 0..5 {
                let (positions_m, velocities_m_per_s) = (&mut x[..], &mut v[..]);
                let mut motion = Motion {
                    positions_m,
                    velocities_m_per_s,
                    moves: &[true, false],
                    damping_per_s: &[0.1, 0.1],
                };
                integrator.step(equations, &mut motion, 0.01);
            }
        };
        go(&mut integrator, &mut equations, &mut x, &mut v);
        assert_eq!((x[1], v[1]), (DVec3::ONE, DVec3::X), "{}", scheme.name());
        assert_ne!(x[0], DVec3::ONE);
        let (saved_x, saved_v, history) = (x, v, integrator.history().to_vec());
        go(&mut integrator, &mut equations, &mut x, &mut v);
        let (mut x2, mut v2) = (saved_x, saved_v);
        let mut other = Integrator::new(scheme, FixedPoint::default(), 2);
        other.set_history(&history);
        go(&mut other, &mut equations, &mut x2, &mut v2);
        assert_eq!((x, v), (x2, v2), "{}", scheme.name());
    }
}
