//! How smooth a movement is: spectral arc length and log dimensionless jerk of its speed.
//!
//! Source: Balasubramanian, Melendez-Calderon, Roby-Brami and Burdet 2015, doi 10.1186/s12984-015-0090-9. Both are for one
//! movement, do not depend on its amplitude, and are the nearer to zero the smoother it is.

use std::f64::consts::TAU;

/// Frequencies above this do not count [Hz]: the source's choice.
const HIGHEST_HZ: f64 = 10.0;
/// The arc ends at the last frequency whose magnitude is this share of the greatest: the source's choice.
const LEAST_MAGNITUDE: f64 = 0.05;
/// The spectrum is padded to the next power of two, times two to this power: the source's choice.
const PADDING: u32 = 4;

/// Spectral arc length of a speed profile [m/s], one value each `period_s` seconds: the negative length of its normalised
/// magnitude spectrum up to 10 Hz, or up to where that stays below a twentieth. None without motion.
pub fn sparc(speed_m_per_s: &[f64], period_s: f64) -> Option<f64> {
    let greatest = speed_m_per_s.iter().copied().fold(0.0, f64::max);
    if greatest <= 0.0 || speed_m_per_s.len() < 2 {
        return None;
    }
    let n = speed_m_per_s.len().next_power_of_two() << PADDING;
    let step_hz = 1.0 / (n as f64 * period_s);
    // Up to half of the sampling rate.
    let n_bins = ((HIGHEST_HZ / step_hz) as usize + 1).min(n / 2 + 1);
    let magnitudes = magnitudes(speed_m_per_s, n, n_bins);
    let last = magnitudes.iter().rposition(|magnitude| *magnitude >= LEAST_MAGNITUDE)?;
    let step = 1.0 / last as f64;
    let arc = magnitudes[..=last].windows(2).map(|pair| libm::hypot(step, pair[1] - pair[0]));
    Some(-arc.sum::<f64>())
}

/// The first `n_bins` magnitudes of the spectrum of `values` padded with zeros to `n`, a power of two, in shares of the greatest.
/// Speeds are not negative: that is the first.
fn magnitudes(values: &[f64], n: usize, n_bins: usize) -> Vec<f64> {
    let mut spectrum = vec![[0.0; 2]; n];
    for (bin, value) in spectrum.iter_mut().zip(values) {
        bin[0] = *value;
    }
    transform(&mut spectrum);
    let magnitude = |[real, imaginary]: [f64; 2]| libm::hypot(real, imaginary);
    spectrum[..n_bins].iter().map(|bin| magnitude(*bin) / magnitude(spectrum[0])).collect()
}

/// Discrete Fourier transform in place, by halves (Cooley and Tukey 1965, doi 10.1090/S0025-5718-1965-0178586-1); the length is a
/// power of two.
fn transform(values: &mut [[f64; 2]]) {
    let n = values.len();
    let shift = usize::BITS - n.trailing_zeros();
    for i in 0..n {
        let mirrored = if n > 1 { i.reverse_bits() >> shift } else { i };
        if mirrored > i {
            values.swap(i, mirrored);
        }
    }
    let turns: Vec<(f64, f64)> = (0..n / 2).map(|i| libm::sincos(-TAU * i as f64 / n as f64)).collect();
    let mut half = 1;
    while half < n {
        let stride = n / (2 * half);
        for block in values.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for (nth, (a, b)) in low.iter_mut().zip(high).enumerate() {
                let (sine, cosine) = turns[nth * stride];
                let turned = [b[0] * cosine - b[1] * sine, b[0] * sine + b[1] * cosine];
                (*a, *b) = ([a[0] + turned[0], a[1] + turned[1]], [a[0] - turned[0], a[1] - turned[1]]);
            }
        }
        half *= 2;
    }
}

/// Log dimensionless jerk of a speed profile [m/s]: -ln(T^3 / v_max^2 times the integral of the squared second derivative of the
/// speed) over the movement's time T. None without motion, or where the speed has no second derivative.
pub fn log_dimensionless_jerk(speed_m_per_s: &[f64], period_s: f64) -> Option<f64> {
    let greatest = speed_m_per_s.iter().copied().fold(0.0, f64::max);
    let duration_s = speed_m_per_s.len() as f64 * period_s;
    let jerk = |v: &[f64]| (v[2] - 2.0 * v[1] + v[0]) / (period_s * period_s);
    let squares: f64 = speed_m_per_s.windows(3).map(|v| jerk(v) * jerk(v) * period_s).sum();
    let jerk = duration_s.powi(3) / (greatest * greatest) * squares;
    (greatest > 0.0 && jerk > 0.0).then(|| -libm::log(jerk))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the source's own program: v = exp(-5 t^2) at t = -1 to 0.99 s, 100 Hz.
    fn bell(amplitude: f64, rate_hz: f64) -> Vec<f64> {
        let n = (2.0 * rate_hz).round() as usize;
        (0..n).map(|i| -1.0 + i as f64 / rate_hz).map(|t| amplitude * libm::exp(-5.0 * t * t)).collect()
    }

    #[test]
    fn the_sources_example_has_the_sources_numbers() {
        assert!((sparc(&bell(1.0, 100.0), 0.01).unwrap() + 1.41403).abs() < 5e-6);
        assert!((log_dimensionless_jerk(&bell(1.0, 100.0), 0.01).unwrap() + 5.81636).abs() < 5e-6);
    }

    #[test]
    fn neither_depends_on_amplitude_nor_the_jerk_on_duration() {
        let (one, ten) = (bell(1.0, 100.0), bell(10.0, 100.0));
        assert!((sparc(&one, 0.01).unwrap() - sparc(&ten, 0.01).unwrap()).abs() < 1e-12);
        let jerk = |speeds: &[f64], period_s| log_dimensionless_jerk(speeds, period_s).unwrap();
        assert!((jerk(&one, 0.01) - jerk(&ten, 0.01)).abs() < 1e-12);
        // The same bell, twice as slow.
        assert!((jerk(&one, 0.01) - jerk(&one, 0.02)).abs() < 1e-12);
    }

    #[test]
    fn the_fast_transform_is_the_sum_that_defines_it() {
        for n in [1, 2, 8, 64] {
            let values: Vec<f64> = (0..n).map(|i| libm::sin(0.7 * i as f64) + 0.1 * i as f64).collect();
            let mut fast: Vec<[f64; 2]> = values.iter().map(|value| [*value, 0.0]).collect();
            transform(&mut fast);
            for (bin, [real, imaginary]) in fast.into_iter().enumerate() {
                let turn = |i: usize| libm::sincos(-TAU * (bin * i) as f64 / n as f64);
                let sum = values.iter().enumerate().map(|(i, value)| (turn(i).1 * value, turn(i).0 * value));
                let (x, y) = sum.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
                assert!((real - x).abs() < 1e-11 && (imaginary - y).abs() < 1e-11, "{n} {bin}");
            }
        }
    }

    #[test]
    fn a_movement_in_two_parts_is_less_smooth() {
        let one = bell(1.0, 100.0);
        let two: Vec<f64> = one.iter().chain(&one).copied().collect();
        assert!(sparc(&two, 0.01).unwrap() < sparc(&one, 0.01).unwrap() - 0.3);
        assert!(
            log_dimensionless_jerk(&two, 0.01).unwrap() < log_dimensionless_jerk(&one, 0.01).unwrap() - 1.0
        );
    }

    #[test]
    fn what_does_not_move_has_no_smoothness() {
        for speeds in [&[][..], &[0.0; 50], &[0.2]] {
            assert_eq!(sparc(speeds, 0.01), None);
            assert_eq!(log_dimensionless_jerk(speeds, 0.01), None);
        }
        assert_eq!(log_dimensionless_jerk(&[0.1; 20], 0.01), None, "a constant speed has no jerk");
    }
}
