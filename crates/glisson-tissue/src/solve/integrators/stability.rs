//! The longest stable step of each scheme.
//!
//! A linear body moves in modes x'' = -omega^2 x - d x' - c x', with omega up to the highest frequency, d the
//! nodes' damping and c that of the accelerations.
//! - Semi-implicit Euler: z^2 - (2 - h (d + c) - h^2 omega^2) z + 1 - h (d + c) has its roots in the unit circle for
//!   h^2 omega^2 + 2 h (d + c) <= 4.
//! - Central differences: the same with c alone, for d is taken in the middle of the step.
//! - Runge-Kutta of p stages and order p: |1 + z + ... + z^p/p!| <= 1 at z = h times the roots of
//!   s^2 + (d + c) s + omega^2; the largest h is bisected over sampled modes. Order 2 amplifies every undamped mode.
//! - Backward differences are stable; their fixed point is found when the iteration contracts, at a rate of at
//!   most [`CONTRACTION`]: (h^2 omega^2 + h alpha_0 c)/beta_0.

use super::Scheme;

/// Safety factor below each bound, at which a mode would grow by rounding.
const MARGIN: f64 = 0.999;

/// Half of the distance to the solution is lost in each iteration of a fixed point, or more.
const CONTRACTION: f64 = 0.5;

/// Sampled frequencies and dampings between their bounds.
const SAMPLES: usize = 24;

/// Bounds of a body's modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModeBounds {
    /// Highest circular frequency [rad/s].
    pub highest_frequency_rad_per_s: f64,
    /// Least and largest damping over mass of the nodes [1/s].
    pub damping_per_s: [f64; 2],
    /// Largest damping over mass within the accelerations [1/s]; zero without viscosity.
    pub viscosity_per_s: f64,
}

impl Scheme {
    /// Largest stable step [s]; infinite when nothing bounds it, zero when no step is stable.
    pub fn stable_step_s(self, bounds: &ModeBounds) -> f64 {
        let omega = bounds.highest_frequency_rad_per_s;
        let ([least, largest], viscosity) = (bounds.damping_per_s, bounds.viscosity_per_s);
        // The positive root of q2 h^2 + q1 h = right.
        let root = |q2: f64, q1: f64, right: f64| {
            if q1 == 0.0 && q2 == 0.0 {
                f64::INFINITY
            } else {
                2.0 * right / (q1 + (q1 * q1 + 4.0 * q2 * right).sqrt())
            }
        };
        let bound_s = match self {
            Self::CentralDifferences => root(omega * omega, 2.0 * viscosity, 4.0),
            Self::SemiImplicitEuler => root(omega * omega, 2.0 * (viscosity + largest), 4.0),
            Self::RungeKutta2 => runge_kutta_bound_s(2, omega, [least, largest + viscosity]),
            Self::RungeKutta4 => runge_kutta_bound_s(4, omega, [least, largest + viscosity]),
            Self::BackwardDifferences1 => root(omega * omega, viscosity, CONTRACTION),
            Self::BackwardDifferences2 => root(omega * omega, 1.5 * viscosity, 2.25 * CONTRACTION),
        };
        MARGIN * bound_s
    }
}

fn runge_kutta_bound_s(n_stages: u32, omega: f64, [least, largest]: [f64; 2]) -> f64 {
    let fastest = omega.max(largest);
    if fastest == 0.0 {
        return f64::INFINITY;
    }
    let share = |i: usize| i as f64 / SAMPLES as f64;
    let is_stable = |h: f64| {
        (0..=SAMPLES).all(|i| {
            let d = least + (largest - least) * share(i);
            (1..=SAMPLES).all(|j| amplification(n_stages, h, omega * share(j), d) <= 1.0 + ROUNDING)
        })
    };
    let (mut stable, mut unstable) = (0.0, 4.0 / fastest);
    for _ in 0..60 {
        let middle = 0.5 * (stable + unstable);
        if is_stable(middle) { stable = middle } else { unstable = middle }
    }
    // A step that passes by rounding alone counts as unstable.
    if stable * fastest < 1e-2 { 0.0 } else { stable }
}

/// An amplification above one by this much counts as rounding.
const ROUNDING: f64 = 1e-12;

/// Largest absolute value of the stability polynomial at the two roots of a mode.
fn amplification(n_stages: u32, h: f64, omega: f64, d: f64) -> f64 {
    let discriminant = 0.25 * d * d - omega * omega;
    let roots = if discriminant >= 0.0 {
        let r = discriminant.sqrt();
        [(-0.5 * d - r, 0.0), (-0.5 * d + r, 0.0)]
    } else {
        let r = (-discriminant).sqrt();
        [(-0.5 * d, r), (-0.5 * d, -r)]
    };
    let mut largest: f64 = 0.0;
    for (re, im) in roots {
        let z = (h * re, h * im);
        let (mut term, mut sum) = ((1.0, 0.0), (1.0, 0.0));
        for k in 1..=n_stages {
            let k = f64::from(k);
            term = ((term.0 * z.0 - term.1 * z.1) / k, (term.0 * z.1 + term.1 * z.0) / k);
            sum = (sum.0 + term.0, sum.1 + term.1);
        }
        largest = largest.max((sum.0 * sum.0 + sum.1 * sum.1).sqrt());
    }
    largest
}
