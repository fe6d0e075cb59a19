//! A polynomial through the origin that stands for a measured curve, on the range of the measurement.
//!
//! p(x) = x g(x), g(x) = sum_k c_k T_k(s), s = (2 x - low - high)/(high - low), k from 0 to degree - 1, with
//! Chebyshev's polynomials T_k: well conditioned on the range, and p(x)/x needs no division. Values and derivatives by
//! Clenshaw's recurrence (1955, Mathematics of Computation 9, 118).
//!
//! Beyond the range p continues as a straight line with its slope at the end, or level where that slope is negative: the
//! measurement says nothing there, and a polynomial of degree 10 would diverge.

/// Least degree of a fit (seed `001`, s. 3.4).
pub const LEAST_DEGREE: usize = 4;
/// Greatest degree of a fit (seed `001`, s. 3.4).
pub const GREATEST_DEGREE: usize = 10;

/// A number that other arguments cannot be expressed by.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the {quantity} is {found}; it must be finite and above 0")]
pub struct ScaleError {
    /// Which number, with its unit.
    pub quantity: &'static str,
    /// What was given.
    pub found: f64,
}

/// A measured curve as a polynomial without constant term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePolynomial {
    /// Chebyshev coefficients of g; those from `degree` on are zero.
    coefficient: [f64; GREATEST_DEGREE],
    degree: usize,
    range: [f64; 2],
    is_odd: bool,
}

impl CurvePolynomial {
    pub(super) fn new(
        coefficient: [f64; GREATEST_DEGREE],
        degree: usize,
        range: [f64; 2],
        is_odd: bool,
    ) -> Self {
        debug_assert!(range[0] <= 0.0 && range[1] > 0.0 && degree <= GREATEST_DEGREE);
        Self { coefficient, degree, range, is_odd }
    }

    /// The straight line of this slope, up to `high`: the response of a linear body.
    ///
    /// # Panics
    /// When `high` is not finite and above 0.
    pub fn line(slope: f64, high: f64) -> Self {
        assert!(high.is_finite() && high > 0.0, "a line up to {high}: it must be finite and above 0");
        let mut coefficient = [0.0; GREATEST_DEGREE];
        coefficient[0] = slope;
        Self::new(coefficient, 1, [0.0, high], true)
    }

    /// Degree of p.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Chebyshev coefficients of g.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficient[..self.degree]
    }

    /// Arguments of the measurement: the fit holds between them. The first is 0 for an odd polynomial.
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// Whether the measurement lies on one side of zero: then p(-x) = -p(x).
    pub fn is_odd(&self) -> bool {
        self.is_odd
    }

    /// p(x).
    pub fn value(&self, x: f64) -> f64 {
        x * self.ratio(x)
    }

    /// p(x)/x, continuous at zero and never negative: the factor of the linear magnitude.
    pub fn ratio(&self, x: f64) -> f64 {
        let x = if self.is_odd { x.abs() } else { x };
        let end = x.clamp(self.range[0], self.range[1]);
        let (g, slope_of_g) = self.factor(end);
        let ratio = if end == x { g } else { (end * g + (g + end * slope_of_g).max(0.0) * (x - end)) / x };
        ratio.max(0.0)
    }

    /// dp/dx; beyond the range that of its end, at least 0.
    pub fn slope(&self, x: f64) -> f64 {
        let x = if self.is_odd { x.abs() } else { x };
        let end = x.clamp(self.range[0], self.range[1]);
        let (g, slope_of_g) = self.factor(end);
        let slope = g + end * slope_of_g;
        if end == x { slope } else { slope.max(0.0) }
    }

    /// Whether p increases at each of 1,000 points of the range.
    pub fn is_rising(&self) -> bool {
        let [low, high] = self.range;
        (0..=1_000).all(|i| self.slope(low + (high - low) * f64::from(i) / 1_000.0) > 0.0)
    }

    /// q with q(factor x) = p(x): the same values over another argument.
    ///
    /// # Errors
    /// [`ScaleError`] for a factor that is not finite and above 0, or so small or large that q has no range: a range
    /// that is empty or runs backwards holds no argument.
    pub fn over(&self, factor: f64) -> Result<Self, ScaleError> {
        let coefficient = self.coefficient.map(|c| c / factor);
        let range = self.range.map(|x| x * factor);
        let is_usable = factor.is_finite()
            && factor > 0.0
            && range[1].is_normal()
            && range[0].is_finite()
            && coefficient.iter().all(|c| c.is_finite());
        if is_usable {
            Ok(Self { coefficient, range, ..*self })
        } else {
            Err(ScaleError { quantity: "factor between the arguments", found: factor })
        }
    }

    /// q(x) = ratio p(x/ratio): the curve of a body that is `ratio` times as large in argument and value alike.
    ///
    /// # Panics
    /// When the ratio is not finite and above 0.
    #[must_use]
    pub fn enlarged(&self, ratio: f64) -> Self {
        assert!(ratio.is_finite() && ratio > 0.0, "a ratio of {ratio}: it must be finite and above 0");
        Self { range: self.range.map(|x| x * ratio), ..*self }
    }

    /// Coefficients a_1 to a_degree of p = sum_k a_k (x/high)^k, for display; evaluate with [`Self::value`].
    pub fn powers(&self) -> Vec<f64> {
        // T_k in powers of t = x/high: s = alpha t + beta.
        let [low, high] = self.range;
        let (alpha, beta) = (2.0 * high / (high - low), -(high + low) / (high - low));
        let times_s = |p: &[f64]| {
            let mut product = vec![0.0; p.len() + 1];
            for (k, c) in p.iter().enumerate() {
                product[k] += beta * c;
                product[k + 1] += alpha * c;
            }
            product
        };
        let (mut before, mut now) = (vec![1.0], vec![beta, alpha]);
        let mut g = vec![0.0; self.degree];
        for k in 0..self.degree {
            for (sum, c) in g.iter_mut().zip(&before) {
                *sum += self.coefficient[k] * c;
            }
            let mut next = times_s(&now);
            next.iter_mut().for_each(|c| *c *= 2.0);
            for (n, b) in next.iter_mut().zip(&before) {
                *n -= b;
            }
            before = std::mem::replace(&mut now, next);
        }
        g.into_iter().map(|c| c * high).collect()
    }

    /// g and dg/dx at a place of the range.
    fn factor(&self, x: f64) -> (f64, f64) {
        let [low, high] = self.range;
        let s = (2.0 * x - low - high) / (high - low);
        let ([mut b1, mut b2], [mut d1, mut d2]) = ([0.0; 2], [0.0; 2]);
        for &c in self.coefficients()[1..].iter().rev() {
            (d1, d2) = (2.0 * (b1 + s * d1) - d2, d1);
            (b1, b2) = (2.0 * s * b1 - b2 + c, b1);
        }
        (self.coefficient[0] + s * b1 - b2, (b1 + s * d1 - d2) * 2.0 / (high - low))
    }
}

/// T_0 to T_(n-1) at s.
pub(super) fn chebyshev(s: f64, values: &mut [f64]) {
    for k in 0..values.len() {
        values[k] = match k {
            0 => 1.0,
            1 => s,
            _ => 2.0 * s * values[k - 1] - values[k - 2],
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(is_odd: bool) -> CurvePolynomial {
        let mut coefficient = [0.0; GREATEST_DEGREE];
        coefficient[..5].copy_from_slice(&[3.0, 0.7, -0.2, 0.11, 0.05]);
        CurvePolynomial::new(coefficient, 5, [if is_odd { 0.0 } else { -1.5 }, 2.5], is_odd)
    }

    #[test]
    fn clenshaw_sums_the_chebyshev_series_and_powers_say_the_same() {
        for p in [example(true), example(false)] {
            let [low, high] = p.range();
            let powers = p.powers();
            for i in 0..=40 {
                let x = low + (high - low) * f64::from(i) / 40.0;
                let mut t = [0.0; 5];
                chebyshev((2.0 * x - low - high) / (high - low), &mut t);
                let expected = x * t.iter().zip(p.coefficients()).map(|(t, c)| t * c).sum::<f64>();
                assert!((p.value(x) - expected).abs() < 1e-13, "{x}");
                let in_powers: f64 =
                    powers.iter().enumerate().map(|(k, a)| a * (x / high).powi(k as i32 + 1)).sum();
                assert!((in_powers - expected).abs() < 1e-12, "{x}: {in_powers} {expected}");
                if x > low && x < high {
                    let h = 1e-6;
                    let slope = (p.value(x + h) - p.value(x - h)) / (2.0 * h);
                    assert!((p.slope(x) - slope).abs() < 1e-8, "{x}");
                }
            }
        }
    }

    #[test]
    fn beyond_the_range_it_goes_straight_on_and_never_falls() {
        let p = example(true);
        let [_, high] = p.range();
        let (end, slope) = (p.value(high), p.slope(high));
        assert!(slope > 0.0);
        assert!((p.value(high + 1.0) - (end + slope)).abs() < 1e-12);
        assert!((p.value(-high - 1.0) + (end + slope)).abs() < 1e-12);
        let mut falling = [0.0; GREATEST_DEGREE];
        falling[..2].copy_from_slice(&[1.0, -0.9]);
        let p = CurvePolynomial::new(falling, 2, [0.0, 1.0], true);
        assert!(p.slope(1.0) < 0.0 && !p.is_rising());
        assert_eq!(p.value(5.0), p.value(1.0));
    }

    #[test]
    fn other_scales_say_the_same() {
        let p = example(true);
        let (over, enlarged) = (p.over(0.2).unwrap(), p.enlarged(3.0));
        for x in [0.3, 1.7, 4.0] {
            assert!((over.value(0.2 * x) - p.value(x)).abs() < 1e-12);
            assert!((enlarged.value(3.0 * x) - 3.0 * p.value(x)).abs() < 1e-12);
        }
        let line = CurvePolynomial::line(2.0, 1.0);
        assert_eq!([line.value(0.5), line.value(7.0), line.ratio(0.0)], [1.0, 14.0, 2.0]);
    }

    #[test]
    fn a_factor_without_a_range_is_refused() {
        let p = example(true);
        for factor in [0.0, -0.0, -0.1, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e-320, 1e308] {
            let error = p.over(factor).unwrap_err();
            assert_eq!(error.found.to_bits(), factor.to_bits());
            assert!(error.to_string().ends_with("must be finite and above 0"), "{error}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_values_beyond_the_range_too() {
        for p in [example(true), example(false)] {
            for x in [-4.0, -1.0, 0.7, 2.4, 2.6, 9.0] {
                let h = 1e-6;
                let expected = (p.value(x + h) - p.value(x - h)) / (2.0 * h);
                assert!((p.slope(x) - expected).abs() < 1e-7, "{x}: {} {expected}", p.slope(x));
            }
        }
    }
}
