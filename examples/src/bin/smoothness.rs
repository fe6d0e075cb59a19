//! Smoothness of a motion that something else recorded: `smoothness SPEEDS.txt RATE_HZ` reads one speed [m/s] a line and prints its
//! spectral arc length and log dimensionless jerk, by which tasks are assessed, too. Without arguments the example of
//! Balasubramanian et al. 2015 (doi 10.1186/s12984-015-0090-9): exp(-5 t^2), t = -1 to 0.99 s at 100 Hz.

#![allow(clippy::print_stdout, reason = "an example shows its figures on standard output")]

use glisson::training::smoothness::{log_dimensionless_jerk, sparc};
use std::error::Error;

fn bell() -> Vec<f64> {
    (-100..100).map(|i| f64::from(i) / 100.0).map(|t_s| (-5.0 * t_s * t_s).exp()).collect()
}

/// One number a line.
fn speeds_in(text: &str) -> Result<Vec<f64>, Box<dyn Error>> {
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let number = |(at, line): (usize, &str)| -> Result<f64, Box<dyn Error>> {
        let speed: f64 =
            line.trim().parse().map_err(|_| format!("line {}: \"{line}\" is not a number", at + 1))?;
        if !(speed.is_finite() && speed >= 0.0) {
            return Err(format!("line {}: {speed} is no speed; allowed: 0 m/s and more", at + 1).into());
        }
        Ok(speed)
    };
    lines.map(number).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (speeds_m_per_s, rate_hz) = match &arguments[..] {
        [] => (bell(), 100.0),
        [file, rate] => {
            let text = std::fs::read_to_string(file).map_err(|error| format!("{file}: {error}"))?;
            let speeds = speeds_in(&text).map_err(|error| format!("{file}: {error}"))?;
            (speeds, rate.parse::<f64>().map_err(|_| format!("rate \"{rate}\" is not a number"))?)
        }
        _ => return Err("give a file of speeds and the rate in Hz, or nothing".into()),
    };
    if !(rate_hz.is_finite() && rate_hz > 0.0) {
        return Err(format!("rate {rate_hz} Hz; allowed: more than 0").into());
    }
    let text = |value: Option<f64>| value.map_or("none".to_owned(), |value| format!("{value:.12}"));
    println!("spectral arc length: {}", text(sparc(&speeds_m_per_s, 1.0 / rate_hz)));
    println!("log dimensionless jerk: {}", text(log_dimensionless_jerk(&speeds_m_per_s, 1.0 / rate_hz)));
    Ok(())
}
