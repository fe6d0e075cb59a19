//! Least squares: the polynomial through the origin that is nearest to measured points.
//!
//! Columns x T_k(s) of Chebyshev's polynomials, x and y over their largest size, by Householder's QR decomposition
//! (Golub and Van Loan, Matrix Computations, 4th edition 2013, s. 5.2 and 5.3): the normal equations of monomials of
//! degree 10 would lose all digits.

use super::polynomial::{CurvePolynomial, GREATEST_DEGREE, LEAST_DEGREE, chebyshev};

/// Why no polynomial can be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The degree is out of the range of the method.
    #[error("degree {found}; allowed: {LEAST_DEGREE} to {GREATEST_DEGREE}")]
    Degree {
        /// What was asked for.
        found: usize,
    },
    /// The numbers of arguments and values differ.
    #[error("{n_x} arguments but {n_y} values")]
    Lengths {
        /// Number of arguments.
        n_x: usize,
        /// Number of values.
        n_y: usize,
    },
    /// A number is not finite.
    #[error("point {place} (from 1) is not finite")]
    NotFinite {
        /// Which point, from 1.
        place: usize,
    },
    /// Not enough points for the degree.
    #[error(
        "{found} different arguments other than 0; a polynomial of degree {degree} through the origin needs at least \
         {needed}: measure more points or choose a lower degree"
    )]
    TooFewPoints {
        /// Different arguments other than zero.
        found: usize,
        /// Wanted degree.
        degree: usize,
        /// How many it needs.
        needed: usize,
    },
    /// Values that do not grow with the argument.
    #[error(
        "the values run against the arguments (their products add up to {sum:e}): both must have the same sign, \
         compression and what it causes positive"
    )]
    Opposed {
        /// Sum of argument times value, over the largest of each.
        sum: f64,
    },
    /// The points do not determine the polynomial.
    #[error("the arguments lie too close together for degree {degree}: choose a lower degree")]
    Undetermined {
        /// Wanted degree.
        degree: usize,
    },
}

/// A fitted polynomial and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The polynomial.
    pub polynomial: CurvePolynomial,
    /// Pearson's correlation r of measured and fitted values.
    pub correlation: f64,
    /// Root of the mean squared difference, in the values' unit.
    pub rms_residual: f64,
    /// Largest difference, in the values' unit.
    pub largest_residual: f64,
    /// Number of points.
    pub n_points: usize,
}

/// A diagonal entry of R below this share of the first is rounding.
const LEAST_PIVOT: f64 = 1e-12;

/// The polynomial of `degree` through the origin that is nearest to the points (x, y) in least squares.
///
/// Points on one side of zero give an odd polynomial (points with negative x are mirrored through the origin); points on
/// both sides are fitted as they are.
///
/// # Errors
/// [`FitError`]: a degree out of 4 to 10, too few points, values that are not finite or run against their arguments.
pub fn fit_curve(x: &[f64], y: &[f64], degree: usize) -> Result<Fit, FitError> {
    if !(LEAST_DEGREE..=GREATEST_DEGREE).contains(&degree) {
        return Err(FitError::Degree { found: degree });
    }
    if x.len() != y.len() {
        return Err(FitError::Lengths { n_x: x.len(), n_y: y.len() });
    }
    if let Some(at) = x.iter().zip(y).position(|(x, y)| !(x.is_finite() && y.is_finite())) {
        return Err(FitError::NotFinite { place: at + 1 });
    }
    let mut different: Vec<f64> = x.iter().copied().filter(|x| *x != 0.0).collect();
    different.sort_by(f64::total_cmp);
    different.dedup();
    if different.len() <= degree {
        return Err(FitError::TooFewPoints { found: different.len(), degree, needed: degree + 1 });
    }
    let (lowest, highest) = (different[0], different[different.len() - 1]);
    let largest_x = highest.max(-lowest);
    let largest_y = y.iter().fold(0.0, |m: f64, y| m.max(y.abs()));
    let sum: f64 = x.iter().zip(y).map(|(x, y)| (x / largest_x) * (y / largest_y)).sum();
    if !(sum > 0.0 && sum.is_finite()) {
        return Err(FitError::Opposed { sum });
    }
    // Points of compression counted as negative belong to the same odd curve.
    let mirror = if highest < 0.0 { -1.0 } else { 1.0 };
    let is_odd = lowest > 0.0 || highest < 0.0;
    let range = if is_odd { [0.0, largest_x] } else { [lowest, highest] };

    let n = x.len();
    let mut columns = vec![0.0; n * degree];
    let mut row = [0.0; GREATEST_DEGREE];
    for (i, x) in x.iter().enumerate() {
        let x = mirror * x;
        chebyshev((2.0 * x - range[0] - range[1]) / (range[1] - range[0]), &mut row[..degree]);
        for k in 0..degree {
            columns[k * n + i] = x / largest_x * row[k];
        }
    }
    let mut right: Vec<f64> = y.iter().map(|y| mirror * y / largest_y).collect();
    let mut coefficient =
        least_squares(&mut columns, &mut right, degree).ok_or(FitError::Undetermined { degree })?;
    coefficient.iter_mut().for_each(|c| *c *= largest_y / largest_x);
    let polynomial = CurvePolynomial::new(coefficient, degree, range, is_odd);
    Ok(quality(polynomial, x, y))
}

fn quality(polynomial: CurvePolynomial, x: &[f64], y: &[f64]) -> Fit {
    let n = x.len() as f64;
    let fitted: Vec<f64> = x.iter().map(|&x| polynomial.value(x)).collect();
    let (mean_y, mean_f) = (y.iter().sum::<f64>() / n, fitted.iter().sum::<f64>() / n);
    let [mut yy, mut ff, mut yf, mut squares, mut largest_residual] = [0.0_f64; 5];
    for (y, f) in y.iter().zip(&fitted) {
        yy += (y - mean_y) * (y - mean_y);
        ff += (f - mean_f) * (f - mean_f);
        yf += (y - mean_y) * (f - mean_f);
        squares += (y - f) * (y - f);
        largest_residual = largest_residual.max((y - f).abs());
    }
    Fit {
        polynomial,
        correlation: yf / (yy * ff).sqrt(),
        rms_residual: (squares / n).sqrt(),
        largest_residual,
        n_points: x.len(),
    }
}

/// Least squares by Householder reflections; `None` when the columns depend on each other.
fn least_squares(columns: &mut [f64], right: &mut [f64], degree: usize) -> Option<[f64; GREATEST_DEGREE]> {
    let n = right.len();
    let mut diagonal = [0.0; GREATEST_DEGREE];
    for k in 0..degree {
        let (head, tail) = columns.split_at_mut(n * (k + 1));
        let v = &mut head[n * k + k..];
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        diagonal[k] = if v[0] > 0.0 { -norm } else { norm };
        if norm <= LEAST_PIVOT * diagonal[0].abs() {
            return None;
        }
        v[0] -= diagonal[k];
        let half_square = diagonal[k] * -v[0];
        let reflect = |target: &mut [f64]| {
            let share = v.iter().zip(&*target).map(|(v, t)| v * t).sum::<f64>() / half_square;
            target.iter_mut().zip(&*v).for_each(|(t, v)| *t -= share * v);
        };
        tail.chunks_exact_mut(n).for_each(|column| reflect(&mut column[k..]));
        reflect(&mut right[k..]);
    }
    let mut coefficient = [0.0; GREATEST_DEGREE];
    for k in (0..degree).rev() {
        let later: f64 = (k + 1..degree).map(|j| columns[j * n + k] * coefficient[j]).sum();
        coefficient[k] = (right[k] - later) / diagonal[k];
    }
    Some(coefficient)
}
