//! Viscoelastic tissue: relaxation of a Prony series, and brain in unconfined compression at three rates.

use super::unit::{pressed_bar_pa, within_share};
use super::{Experiment, Figure, Outcome, series};
use glam::{DMat3, DVec3};
use glisson::material::{LinearElastic, Ogden, PronySeries, PronyTerm};
use glisson_report::plot::{LinePlot, SeriesStyle};

/// The article was not at hand: mu and alpha also stand in SlicerCBM's code, for the series no second source was found.
const SOURCE: &str = "closed form; model of Miller and Chinzei 2002, doi 10.1016/S0021-9290(01)00234-2";
const SERIES_SOURCE: &str = "closed form of the series";

/// Ogden's law of swine brain: mu [Pa] and alpha.
const MU_PA: f64 = 842.0;
const ALPHA: f64 = -4.7;
/// Shares and times [s] of its relaxation.
pub(super) const TERMS: [(f64, f64); 2] = [(0.450, 0.5), (0.365, 50.0)];
/// Strain rates of the experiment [1/s].
pub(super) const RATES_PER_S: [(&str, f64); 3] = [("0.64", 0.64), ("0.0064", 0.64e-2), ("6.4e-6", 0.64e-5)];
pub(super) const LAST_STRAIN: f64 = 0.3;
const N_STEPS: usize = 300;

fn relaxation_series() -> anyhow::Result<PronySeries> {
    Ok(PronySeries::new(&TERMS.map(|(share, time_s)| PronyTerm { share, time_s }))?)
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    relaxation(&mut outcome)?;
    brain(&mut outcome)?;
    Ok(outcome)
}

/// M7: the recursion against the series, in steps of any length.
fn relaxation(outcome: &mut Outcome) -> anyhow::Result<()> {
    let series = relaxation_series()?;
    let table = [(0.1, 0.9177), (0.5, 0.7119), (1.0, 0.6037), (5.0, 0.5153), (50.0, 0.3193), (500.0, 0.1850)];
    let elastic_pa = DMat3::from_diagonal(DVec3::new(1000.0, -200.0, 300.0));
    for (time_s, printed) in table {
        let mut worst = printed;
        for n_steps in [1, 7, 100] {
            // The step of strain takes a nanosecond.
            let mut history = series.rest();
            series.step(1e-9).advance(&mut history, &elastic_pa);
            let step = series.step(time_s / f64::from(n_steps));
            let mut stress = DMat3::ZERO;
            for _ in 0..n_steps {
                stress = step.stress_pa(&history, &elastic_pa);
                step.advance(&mut history, &elastic_pa);
            }
            let found = stress.x_axis.x / elastic_pa.x_axis.x;
            if (found - printed).abs() >= (worst - printed).abs() {
                worst = found;
            }
        }
        outcome.experiments.push(Experiment::near(
            &format!("M7 relaxation G(t)/G(0) at {time_s} s, worst of 1, 7 and 100 steps"),
            SERIES_SOURCE,
            worst,
            printed,
            0.002,
        ));
    }
    Ok(())
}

/// Nominal stress of the incompressible law in uniaxial stress [Pa].
pub(super) fn elastic_pa(stretch: f64) -> f64 {
    2.0 * MU_PA / ALPHA * (stretch.powf(ALPHA - 1.0) - stretch.powf(-0.5 * ALPHA - 1.0))
}

/// The convolution integral of the closed elastic form at constant rate, by Simpson's rule in strain: P(t) = P_e -
/// sum g_k int (1 - exp(-(t - s)/tau_k)) dP_e.
fn convolution_pa(rate_per_s: f64, stretch: f64) -> f64 {
    let slope = |l: f64| {
        2.0 * MU_PA / ALPHA
            * ((ALPHA - 1.0) * l.powf(ALPHA - 2.0) + (0.5 * ALPHA + 1.0) * l.powf(-0.5 * ALPHA - 2.0))
    };
    let end_s = (1.0 - stretch) / rate_per_s;
    let n = 4000;
    let width_s = end_s / f64::from(n);
    let kernel = |s: f64| {
        let kept: f64 = TERMS.iter().map(|(g, tau)| g * (1.0 - (-(end_s - s) / tau).exp())).sum();
        (1.0 - kept) * -rate_per_s * slope(1.0 - rate_per_s * s)
    };
    let weight = |i: i32| match i {
        0 => 1.0,
        i if i == n => 1.0,
        i if i % 2 == 1 => 4.0,
        _ => 2.0,
    };
    (0..=n).map(|i| weight(i) * kernel(width_s * f64::from(i))).sum::<f64>() * width_s / 3.0
}

/// Of the uniform compression.
fn stretch_of_step(i: usize) -> f64 {
    1.0 - LAST_STRAIN * i as f64 / N_STEPS as f64
}

/// Reference nominal stress [Pa] at stretches 0.9, 0.8 and 0.7, for each of `RATES_PER_S`.
const PRINTED_PA: [[f64; 3]; 3] =
    [[-322.6, -918.8, -2239.0], [-178.9, -494.9, -1194.0], [-63.9, -188.6, -468.0]];

/// T1: unconfined compression, frictionless plates, so uniaxial stress.
fn brain(outcome: &mut Outcome) -> anyhow::Result<()> {
    let material = LinearElastic::from_young_poisson(2.0 * 1.4999 * MU_PA, 0.4999, 1000.0)?;
    let law = Ogden::from_linear(&material, ALPHA)?;
    let relaxation = relaxation_series()?;
    // The elastic stress of the cube of five tetrahedra at every stretch: the sides are free at every moment, and all of
    // the stress relaxes alike, so that the shape does not depend on the rate.
    let stretches: Vec<f64> = (1..=N_STEPS).map(stretch_of_step).collect();
    let solved_pa = pressed_bar_pa(&law, &stretches)?;
    let elastic = stretches.iter().map(|&l| [100.0 * (1.0 - l), -elastic_pa(l)]).collect();
    let mut plotted = vec![series("elastic", elastic, SeriesStyle::Dashed)];
    outcome.notes += "### Brain in unconfined compression (T1)\n\nNominal stress [Pa]. Ours: equilibrium of a cube of five tetrahedra of Ogden's law at nu 0.4999, relaxed by the \
                      Prony recursion in 300 steps. Closed form: the incompressible law, convolved by quadrature.\n\n| rate [1/s] | stretch | ours | closed \
                      form | reference |\n|---|---|---|---|---|\n";
    for (rate, printed_pa) in RATES_PER_S.into_iter().zip(PRINTED_PA) {
        let step = relaxation.step(LAST_STRAIN / rate.1 / N_STEPS as f64);
        let mut history = relaxation.rest();
        let mut curve = Vec::new();
        for (&stretch, &pa) in stretches.iter().zip(&solved_pa) {
            let elastic_pa = DMat3::from_diagonal(DVec3::new(pa, 0.0, 0.0));
            curve.push([100.0 * (1.0 - stretch), -step.stress_pa(&history, &elastic_pa).x_axis.x]);
            step.advance(&mut history, &elastic_pa);
        }
        judge_curve(outcome, rate, printed_pa, &curve);
        plotted.push(series(&format!("{}/s", rate.0), curve, SeriesStyle::Line));
    }
    outcome.notes += "\nThe article's own measurements are not in the repository: this shows that law and recursion give the published model's \
                      curve, not that the model is right for brain. Its stated range is natural strain -0.3 to 0.2, stretch 0.74 to \
                      1.22; the point at 0.7 lies outside. mu = 842 Pa and alpha = -4.7 also stand in SlicerCBM's code; for the shares and times of the \
                      relaxation no second source was found.\n";
    outcome.figures.push(Figure {
        file: "tissue_brain.svg",
        caption: "Swine brain in unconfined compression at the three rates of Miller and Chinzei: Ogden's law with a Prony series."
            .into(),
        plot: LinePlot {
            title: "Unconfined compression of brain".into(),
            x_label: "compression [%]".into(),
            y_label: "nominal stress [Pa]".into(),
            series: plotted,
            size: [960, 540],
        },
    });
    Ok(())
}

/// Compares a curve of compression [%] and pressure [Pa] at three stretches with the reference and with quadrature.
fn judge_curve(
    outcome: &mut Outcome,
    (rate, rate_per_s): (&str, f64),
    printed_pa: [f64; 3],
    curve: &[[f64; 2]],
) {
    for (third, printed_pa) in printed_pa.into_iter().enumerate() {
        let i = (third + 1) * N_STEPS / 3 - 1;
        let (stretch, found_pa) = (0.9 - 0.1 * third as f64, -curve[i][1]);
        let closed_pa = convolution_pa(rate_per_s, stretch_of_step(i + 1));
        outcome.notes +=
            &format!("| {rate} | {stretch:.1} | {found_pa:.1} | {closed_pa:.1} | {printed_pa} |\n");
        outcome.experiments.push(Experiment::near(
            &format!("T1 swine brain at {rate}/s, stretch {stretch:.1}: nominal stress [Pa]"),
            SOURCE,
            found_pa,
            printed_pa,
            0.005,
        ));
        outcome.experiments.push(within_share(
            &format!("T1 at {rate}/s, stretch {stretch:.1}: recursion against quadrature"),
            SERIES_SOURCE,
            found_pa,
            closed_pa,
            0.002,
        ));
    }
}
