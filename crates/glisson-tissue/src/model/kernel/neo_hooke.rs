//! The neo-Hookean laws of [`crate::material`] in lanes, written with G = F - Id so that rest is exactly free of
//! stress and nothing cancels at small strain. J - 1 and H = cof F - Id: [`VolumeChange`].

use super::element::{At, ElementLaw, Matrix, VolumeChange};
use super::lanes::{Lanes, log_of_one_plus};

/// [`crate::material::NeoHookeLog`]: P = mu (F - F^-T) + lambda ln J F^-T. With F^-T = (Id + H)/J,
///
/// J P = mu ((J - 1) Id + J G - H) + lambda ln J (Id + H).
pub(super) struct NeoHookeLog;

impl ElementLaw for NeoHookeLog {
    /// V lambda and V mu.
    fn numbers(volume_m3: f64, lambda_pa: f64, mu_pa: f64) -> [f64; 2] {
        [volume_m3 * lambda_pa, volume_m3 * mu_pa]
    }

    fn lame_of_volume(&self, numbers: [f64; 2], _: At) -> [f64; 2] {
        numbers
    }

    #[inline(always)]
    fn scaled_stress<V: Lanes>(&self, g: &Matrix<V>, [lambda, mu]: [V; 2], _: At) -> Matrix<V> {
        let VolumeChange { growth, cofactor_growth: h } = VolumeChange::of(g);
        let one = growth.constant(1.0);
        let j = growth.plus(one);
        let inverse = one.over(j);
        let shear = inverse.times(mu);
        let pressure = inverse.times(lambda.times(log_of_one_plus(growth)));
        let diagonal = |i: usize| {
            let difference = j.fused(g[i][i], growth.minus(h[i][i]));
            shear.fused(difference, pressure.fused(h[i][i], pressure))
        };
        let off = |i: usize, k: usize| {
            let difference = j.fused(g[i][k], h[i][k].negative());
            shear.fused(difference, pressure.times(h[i][k]))
        };
        [
            [diagonal(0), off(0, 1), off(0, 2)],
            [off(1, 0), diagonal(1), off(1, 2)],
            [off(2, 0), off(2, 1), diagonal(2)],
        ]
    }
}

/// [`crate::material::StableNeoHooke`]: P = m (1 - 1/(I1 + 1)) F + l (J - 1 - 3/4 m/l) cof F. With
/// e = I1 - 3 = 2 tr G + |G|^2 and r = e/(4 (4 + e)),
///
/// P = m (r Id + (3/4 + r) G - 3/4 H) + l (J - 1)(Id + H).
pub(super) struct StableNeoHooke;

impl ElementLaw for StableNeoHooke {
    /// V l and V m of l = lambda + 5/6 mu, m = 4/3 mu.
    fn numbers(volume_m3: f64, lambda_pa: f64, mu_pa: f64) -> [f64; 2] {
        [volume_m3 * (lambda_pa + 5.0 / 6.0 * mu_pa), volume_m3 * (4.0 / 3.0 * mu_pa)]
    }

    fn lame_of_volume(&self, [l, m]: [f64; 2], _: At) -> [f64; 2] {
        [l - 5.0 / 8.0 * m, 0.75 * m]
    }

    #[inline(always)]
    fn scaled_stress<V: Lanes>(&self, g: &Matrix<V>, [l, m]: [V; 2], _: At) -> Matrix<V> {
        let VolumeChange { growth, cofactor_growth: h } = VolumeChange::of(g);
        let trace = g[0][0].plus(g[1][1]).plus(g[2][2]);
        let square =
            |i: usize, rest: V| g[i][0].fused(g[i][0], g[i][1].fused(g[i][1], g[i][2].fused(g[i][2], rest)));
        let e = square(0, square(1, square(2, trace.plus(trace))));
        let four = e.constant(4.0);
        let three_quarters = e.constant(0.75);
        let r = e.over(four.fused(e, e.constant(16.0)));
        let of_g = m.times(r.plus(three_quarters));
        let pressure = l.times(growth);
        let of_h = pressure.minus(m.times(three_quarters));
        let of_identity = m.fused(r, pressure);
        let off = |i: usize, k: usize| of_g.fused(g[i][k], of_h.times(h[i][k]));
        let diagonal = |i: usize| of_g.fused(g[i][i], of_h.fused(h[i][i], of_identity));
        [
            [diagonal(0), off(0, 1), off(0, 2)],
            [off(1, 0), diagonal(1), off(1, 2)],
            [off(2, 0), off(2, 1), diagonal(2)],
        ]
    }
}
