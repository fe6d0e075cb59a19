//! Laws by themselves and in one cell: derivatives (M3), uniaxial stress (M5), fibres (M8).

use super::{all_laws, settings};
use crate::validate::model_rheology::free_sided_stress_pa;
use crate::validate::{Experiment, Figure, Outcome, series};
use anyhow::Context;
use glam::{DMat3, DVec3};
use glisson::material::check::{DerivativeErrors, derivative_errors};
use glisson::material::{
    HolzapfelGasserOgden, HolzapfelGasserOgdenParameters, LinearElastic, Material, MooneyRivlin, NeoHookeLog,
    Ogden, StableNeoHooke,
};
use glisson::mesh::NodeId;
use glisson::mesh::box_mesh::cube_of_five;
use glisson::solve::{BoundaryConditions, NonlinearProblem, solve_nonlinear};
use glisson_report::plot::{LinePlot, SeriesStyle};

/// M3: P = dW/dF and dP by central differences; the projected tangent has no negative eigenvalue.
pub(super) fn derivatives(outcome: &mut Outcome) -> anyhow::Result<()> {
    for spec in all_laws()? {
        let DerivativeErrors { stress, differential, n_negative } = derivative_errors(spec.material());
        let name = spec.name();
        let source = "central differences at 50 random strains of up to 30 %";
        outcome.experiments.extend([
            Experiment::at_most(&format!("M3 {name}: P against dW/dF, relative"), source, stress, 1e-6),
            Experiment::at_most(
                &format!("M3 {name}: dP against differences, relative"),
                source,
                differential,
                1e-6,
            ),
            Experiment::at_most(
                &format!("M3 {name}: projected tangents with a negative eigenvalue"),
                "Cholesky of the matrix shifted by 1e-9 of its largest entry",
                f64::from(n_negative),
                0.0,
            ),
        ]);
    }
    Ok(())
}

/// Stretches of M5.
const STRETCHES: [f64; 7] = [0.5, 0.7, 0.8, 0.9, 1.1, 1.25, 1.5];

/// A nearly incompressible bar.
struct Bar {
    name: &'static str,
    law: Box<dyn Material>,
    /// Nominal stress [Pa] at a stretch by the closed incompressible form.
    closed_pa: fn(f64) -> f64,
}

fn nearly_incompressible(mu_pa: f64) -> anyhow::Result<LinearElastic> {
    Ok(LinearElastic::from_young_poisson(2.0 * 1.4999 * mu_pa, 0.4999, 1000.0)?)
}

fn closed_ogden_pa(l: f64) -> f64 {
    -2.0 * 842.0 / 4.7 * (l.powf(-5.7) - l.powf(1.35))
}

fn closed_neo_hooke_pa(l: f64) -> f64 {
    1000.0 * (l - l.powi(-2))
}

fn closed_mooney_rivlin_pa(l: f64) -> f64 {
    2.0 * (263.0 + 263.0 / l) * (l - l.powi(-2))
}

fn bars() -> anyhow::Result<[Bar; 4]> {
    let (brain, gel, rubber) =
        (nearly_incompressible(842.0)?, nearly_incompressible(1000.0)?, nearly_incompressible(4.0 * 263.0)?);
    Ok([
        Bar {
            name: "ogden 842 Pa, -4.7",
            law: Box::new(Ogden::from_linear(&brain, -4.7)?),
            closed_pa: closed_ogden_pa,
        },
        Bar {
            name: "neo_hooke_log 1000 Pa",
            law: Box::new(NeoHookeLog::from(&gel)),
            closed_pa: closed_neo_hooke_pa,
        },
        Bar {
            name: "mooney_rivlin, C01 = 0",
            law: Box::new(MooneyRivlin::from_linear(&gel, 0.0)?),
            closed_pa: closed_neo_hooke_pa,
        },
        Bar {
            name: "mooney_rivlin 263, 263 Pa",
            law: Box::new(MooneyRivlin::from_linear(&rubber, 0.5)?),
            closed_pa: closed_mooney_rivlin_pa,
        },
    ])
}

/// M5: nearly incompressible bars, by the law alone and by equilibrium of elements.
pub(super) fn uniaxial(outcome: &mut Outcome) -> anyhow::Result<()> {
    outcome.notes += "### Uniaxial nominal stress (M5)\n\nBars of Poisson's ratio 0.4999 [Pa]: the closed incompressible form, the law with free sides, and equilibrium of a cube \
                      of five tetrahedra.\n\n| law | stretch | closed form | law | elements |\n|---|---|---|---|---|\n";
    let (mut plotted, mut dots) = (Vec::new(), Vec::new());
    for bar in bars()? {
        let solved_pa = pressed_bar_pa(&*bar.law, &STRETCHES)?;
        judge_bar(outcome, &bar, &solved_pa);
        // Without C01 the curve is the neo-Hookean one.
        if !bar.name.ends_with("C01 = 0") {
            let stretches = (0..=100).map(|i| 0.65 + 0.0085 * f64::from(i));
            let points = stretches.map(|l| [l, (bar.closed_pa)(l)]).collect();
            plotted.push(series(bar.name, points, SeriesStyle::Line));
        }
        let in_view = STRETCHES.iter().zip(&solved_pa).filter(|(l, _)| **l > 0.6);
        dots.extend(in_view.map(|(&l, &pa)| [l, pa]));
    }
    plotted.push(series("elements", dots, SeriesStyle::Points));
    let stable = StableNeoHooke::from(&nearly_incompressible(1000.0)?);
    let off = STRETCHES.map(|l| (free_sided_stress_pa(&stable, l) / closed_neo_hooke_pa(l) - 1.0).abs());
    outcome.notes += &format!(
        "\nStable neo-Hooke is another law of the same small strain: its bar differs from the neo-Hookean one by up to {:.0} %.\n\n",
        100.0 * off.into_iter().fold(0.0, f64::max)
    );
    outcome.figures.push(Figure {
        file: "unit_uniaxial.svg",
        caption: "Nominal stress of nearly incompressible bars: closed forms (lines) and equilibrium of a cube of five tetrahedra \
                  (dots)."
            .into(),
        plot: LinePlot {
            title: "Uniaxial nominal stress".into(),
            x_label: "stretch".into(),
            y_label: "nominal stress [Pa]".into(),
            series: plotted,
            size: [960, 540],
        },
    });
    Ok(())
}

/// Compares a bar's law and its elements (stresses at `STRETCHES`) with the closed form.
fn judge_bar(outcome: &mut Outcome, bar: &Bar, solved_pa: &[f64]) {
    let name = bar.name;
    let mut worst = [0.0_f64; 2];
    for (&stretch, solved_pa) in STRETCHES.iter().zip(solved_pa) {
        let (closed_pa, law_pa) = ((bar.closed_pa)(stretch), free_sided_stress_pa(&*bar.law, stretch));
        outcome.notes += &format!("| {name} | {stretch} | {closed_pa:.1} | {law_pa:.1} | {solved_pa:.1} |\n");
        for (worst, found_pa) in worst.iter_mut().zip([law_pa, *solved_pa]) {
            *worst = worst.max(((found_pa - closed_pa) / closed_pa).abs());
        }
    }
    let source = "incompressible closed form (Ogden 1972, doi 10.1098/rspa.1972.0026; Rivlin 1948, \
                  doi 10.1098/rsta.1948.0024)";
    for (worst, what) in worst.into_iter().zip(["law", "elements"]) {
        let title = format!("M5 uniaxial stress, {name}, {what}: error over stretches 0.5 to 1.5, relative");
        outcome.experiments.push(Experiment::at_most(&title, source, worst, 0.005));
    }
}

/// Nominal stress [Pa] of a cube of five tetrahedra at these stretches, by equilibrium: plates that slide, sides free.
pub(in crate::validate) fn pressed_bar_pa(law: &dyn Material, stretches: &[f64]) -> anyhow::Result<Vec<f64>> {
    let side_m = 0.01;
    let mesh = cube_of_five(2, side_m);
    let nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let mut stresses = Vec::with_capacity(stretches.len());
    for &stretch in stretches {
        let mut conditions = BoundaryConditions::new();
        for (n, p) in mesh.positions_m.iter().enumerate() {
            // Faces through the origin stay in their planes; the upper one is moved.
            for axis in 0..3 {
                if p[axis] == 0.0 {
                    conditions.impose(NodeId::from_index(n), axis, 0.0);
                }
            }
            if p.z > 0.5 * side_m {
                conditions.impose(NodeId::from_index(n), 2, (stretch - 1.0) * side_m);
            }
        }
        let solution = solve_nonlinear(&NonlinearProblem {
            mesh: &mesh,
            laws: &[law],
            conditions: &conditions,
            nodal_force_n: &nodal_force_n,
            settings: settings(1e-9),
        })
        .with_context(|| format!("a bar at stretch {stretch}"))?;
        let upper = mesh.positions_m.iter().zip(&solution.reaction_n).filter(|(p, _)| p.z > 0.5 * side_m);
        stresses.push(upper.map(|(_, r)| r.z).sum::<f64>() / (side_m * side_m));
    }
    Ok(stresses)
}

/// M8: two families of dispersed fibres, stretched in their plane.
pub(super) fn fibres(outcome: &mut Outcome) -> anyhow::Result<()> {
    let (c, k1, k2, kappa) = (7_640.0, 996_600.0, 524.6, 0.226);
    let angle = 49.98_f64.to_radians();
    let (a1, a2) = (angle.cos(), angle.sin());
    let law = HolzapfelGasserOgden::new(&HolzapfelGasserOgdenParameters {
        matrix_shear_pa: c,
        fibre_stiffness_pa: k1,
        fibre_exponent: k2,
        dispersion: kappa,
        fibre_directions: vec![DVec3::new(a1, a2, 0.0), DVec3::new(a1, -a2, 0.0)],
        bulk_pa: 1e11,
    })?;
    let mut worst = 0.0_f64;
    outcome.notes += "### Fibres (M8)\n\nNominal stress [Pa] along and across, third side free.\n\n| stretches | closed form | law |\n|---|---|---|\n";
    for [s1, s2] in [[1.02, 1.02], [1.05, 1.0], [1.0, 1.06], [1.04, 1.03], [0.95, 0.97]] {
        // P_i = c (s_i - s_3^2/s_i) + 2 dW/dE (2 kappa (s_i - s_3^2/s_i) + 2 (1 - 3 kappa) s_i a_i^2).
        let s3 = 1.0 / (s1 * s2);
        let strain = kappa * (s1 * s1 + s2 * s2 + s3 * s3 - 3.0)
            + (1.0 - 3.0 * kappa) * (s1 * s1 * a1 * a1 + s2 * s2 * a2 * a2 - 1.0);
        let pull = if strain > 0.0 { k1 * strain * (k2 * strain * strain).exp() } else { 0.0 };
        let expected = [(s1, a1), (s2, a2)].map(|(s, a)| {
            (c + 4.0 * kappa * pull) * (s - s3 * s3 / s) + 4.0 * (1.0 - 3.0 * kappa) * pull * s * a * a
        });
        let stress = |t: f64| law.first_piola_pa(&DMat3::from_diagonal(DVec3::new(s1, s2, t)));
        let (mut low, mut high) = (0.99 * s3, 1.01 * s3);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if stress(middle).z_axis.z < 0.0 { low = middle } else { high = middle }
        }
        let found = stress(0.5 * (low + high));
        let found = [found.x_axis.x, found.y_axis.y];
        for (found_pa, expected_pa) in found.into_iter().zip(expected) {
            worst = worst.max(((found_pa - expected_pa) / expected_pa).abs());
        }
        outcome.notes += &format!(
            "| {s1}, {s2} | {:.5e}, {:.5e} | {:.5e}, {:.5e} |\n",
            expected[0], expected[1], found[0], found[1]
        );
    }
    outcome.experiments.push(Experiment::at_most(
        "M8 fibres of an adventitia: nominal stress against our closed form, relative",
        "law: Gasser, Ogden and Holzapfel 2006, doi 10.1098/rsif.2005.0073; closed form: our own",
        worst,
        1e-4,
    ));
    outcome.notes += "\nThe parameters (c 7.64 kPa, k1 996.6 kPa, k2 524.6, kappa 0.226, 49.98 degrees) stand under the article's name in other people's \
                      codes; the article itself was not at hand, and no stress of it is compared here.\n";
    Ok(())
}
