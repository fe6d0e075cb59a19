//! The groups of experiments: the reference against others' solutions and its own stored figures; every model against it.

use super::blocks::{self, Case};
use super::livers;
use super::reference::Cylinder;
use super::reference::table::{BALLS_M, DEPTHS, Law, POISSON_RATIO, block, compute, reference_force};
use super::selection::Selection;
use crate::bodies::most;
use crate::validate::indentation::block::{Elements, Grading};
use crate::validate::indentation::graded;
use crate::validate::{Experiment, Outcome};
use anyhow::Context;
use glisson::material::LinearElastic;
use glisson::solve::NodeAveraging;
use std::f64::consts::PI;
use std::fmt::Write as _;

const STORED: &str = "own axisymmetric solution, four times as fine (touch_truth/reference)";
const SNEDDON: &str =
    "Sneddon 1965, Int. J. Eng. Sci. 3, doi 10.1016/0020-7225(65)90019-4: a sphere on a half-space";
const OWN: &str = "own axisymmetric solution (touch_truth/reference)";
const SQUARE: &str = "the same tetrahedra under the ball, the outer ones square or round";
const REQUIREMENT: &str = "requirement; own axisymmetric solution (touch_truth/reference)";

const AGREE: &str = "requirement: meshes of one organ agree";
/// The coarsest meshes may be off by more.
const COARSE: usize = 2_000;

/// Nodes on a radius of the ball when the reference is computed again, and how far it may be from what is stored.
const PER_RADIUS: f64 = 20.0;
const STORED_WITHIN: f64 = 0.005;
/// The half-space's stand-in: so many radii wide and deep. What is left of the base is some 0.4 % of the force.
const HALF_SPACE_RADII: f64 = 150.0;

/// F/(E R^2) of a rigid sphere on a half-space: d = a artanh a, F = ((a^2 + 1) artanh a - a)/(1 - nu^2) with a, d in radii.
pub(super) fn sneddon(depth: f64, nu: f64) -> f64 {
    // d rises with a: halve the interval.
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if middle * middle.atanh() < depth { low = middle } else { high = middle }
    }
    ((low * low + 1.0) * low.atanh() - low) / (1.0 - nu * nu)
}

/// F/(E R^2) of linear tissue under a ball of 10 mm a radius deep, in tetrahedra whose edges under the ball are a tenth of
/// its radius: of the square block, and of the cylinder of its cross-section's area in tetrahedra that are the same within 12 mm
/// of the axis.
pub(super) fn square_and_round(elements: Elements) -> anyhow::Result<[f64; 2]> {
    let (radius_m, fine_m, fine_reach_m, height_m) = (10e-3, 1e-3, 12e-3, 60e-3);
    let young_pa = 1e3;
    let material = LinearElastic::from_young_poisson(young_pa, POISSON_RATIO, 1e3)?;
    let force = |outer_m: f64, is_square: bool| -> anyhow::Result<f64> {
        let mut radii_m: Vec<f64> = (0..=12).map(|k| f64::from(k) * fine_m).collect();
        let outside = graded(1.3 * fine_m, 1.3, outer_m - fine_reach_m);
        radii_m.extend(outside[1..].iter().map(|x| fine_reach_m + x));
        let depths_m = graded(fine_m, 1.3, height_m);
        let round_m = if is_square { fine_reach_m } else { radii_m[radii_m.len() - 1] };
        let grading = Grading { radii_m, depths_m, fine_m, round_m };
        Ok(grading.ball_n(&material, elements, [radius_m; 2])? / (young_pa * radius_m * radius_m))
    };
    let outer_m = [0.05, 0.1 / PI.sqrt()];
    Ok([force(outer_m[0], true)?, force(outer_m[1], false)?])
}

/// The reference, computed again.
pub(crate) fn reference_experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let half_space = Cylinder { radius: HALF_SPACE_RADII, height: HALF_SPACE_RADII };
    let forces = compute(Law::Linear, half_space, 2.0 * PER_RADIUS)?;
    for (depth, force) in DEPTHS.into_iter().zip(forces) {
        outcome.experiments.push(Experiment::near(
            &format!("sphere {depth} radii deep in a large body: F/(E R^2)"),
            SNEDDON,
            force,
            sneddon(depth, POISSON_RATIO),
            0.01,
        ));
    }
    outcome.notes += "F/(E R^2), stored:\n\n| law | ball [mm] | 0.3 | 0.6 | 1.0 | 1.5 radii |\n|---|---|---|---|---|---|\n";
    for law in Law::ALL {
        for ball_m in BALLS_M {
            let computed = compute(law, block(ball_m), PER_RADIUS)?;
            let stored = DEPTHS.map(|depth| reference_force(law, ball_m, depth));
            let pairs = computed.iter().zip(stored);
            let off = most(pairs.filter_map(|(now, stored)| Some((now / stored? - 1.0).abs())));
            let name = format!(
                "{}, ball of {} mm: largest difference from the stored forces",
                law.name(),
                ball_m * 1e3
            );
            outcome.experiments.push(Experiment::at_most(&name, STORED, off, STORED_WITHIN));
            write!(outcome.notes, "| {} | {} |", law.name(), ball_m * 1e3)?;
            for force in stored {
                write!(outcome.notes, " {} |", force.map_or("-".into(), |force| format!("{force:.4}")))?;
            }
            outcome.notes.push('\n');
        }
    }
    let [square, round] = square_and_round(Elements::Averaged(NodeAveraging::STRAIN))?;
    let [plain, _] = square_and_round(Elements::Plain)?;
    let in_block = reference_force(Law::Linear, BALLS_M[2], DEPTHS[2]).context("no stored force")?;
    outcome.experiments.extend([
        Experiment::near(
            "force on the square block over that on the cylinder of equal area, ball of 10 mm",
            SQUARE,
            square / round,
            1.0,
            0.01,
        ),
        Experiment::near(
            "square block of tetrahedra with averaged strain, ball of 10 mm a radius deep, linear: F/(E R^2)",
            OWN,
            square,
            in_block,
            0.05,
        ),
    ]);
    writeln!(
        outcome.notes,
        "\nPlain tetrahedra of the same size (edges under the ball a tenth of its radius), which the models have, are {:.1} % \
         stiffer than the axisymmetric solution; with strain averaged over nodes they are {:.1} % softer.",
        100.0 * (plain / in_block - 1.0),
        100.0 * (1.0 - square / in_block)
    )?;
    Ok(outcome)
}

/// Every model on every block: slow.
pub(crate) fn block_experiments() -> anyhow::Result<Outcome> {
    let cases = blocks::run(&Selection::whole(), &mut |_| {})?;
    let mut outcome = Outcome { notes: Case::HEAD.into(), ..Outcome::default() };
    for case in &cases {
        outcome.notes += &case.row();
    }
    // A row for a model, a mesh and a ball: the worst place and depth, beside its tolerance.
    let key = |case: &Case| (case.model, case.n_tets, (case.ball_m * 1e6) as u64);
    for group in cases.chunk_by(|a, b| key(a) == key(b)) {
        let excess = |case: &Case| (case.ratio() - 1.0).abs() / case.tolerance();
        let worst = group.iter().max_by(|a, b| excess(a).total_cmp(&excess(b))).context("an empty group")?;
        outcome.experiments.push(Experiment::near(
            &format!(
                "{}, {} tetrahedra, ball of {} mm, worst of {} (place {}, {} radii): force over the reference",
                worst.model,
                worst.n_tets,
                worst.ball_m * 1e3,
                group.len(),
                worst.place + 1,
                worst.depth
            ),
            REQUIREMENT,
            worst.ratio(),
            1.0,
            worst.tolerance(),
        ));
    }
    Ok(outcome)
}

/// Every model on every liver: slow.
pub(crate) fn liver_experiments() -> anyhow::Result<Outcome> {
    let selection = Selection::whole();
    let pushes = livers::run(&selection, &mut |_| {})?;
    let mut outcome = Outcome { notes: livers::Push::HEAD.into(), ..Outcome::default() };
    for push in &pushes {
        outcome.notes += &push.row();
    }
    for subject in selection.subjects()? {
        let model = subject.kind.name();
        for &size in selection.sizes() {
            let Some((worst, ratio)) = livers::worst_ratio(&pushes, model, size) else { continue };
            let tolerance = if size <= COARSE { 0.15 } else { 0.1 };
            let name = format!(
                "{model}, livers of {size} tetrahedra: force over that on the finest, worst (patient {}, place {}, {} mm)",
                worst.seed,
                worst.place + 1,
                worst.depth_m * 1e3
            );
            outcome.experiments.push(Experiment::near(&name, AGREE, ratio, 1.0, tolerance));
        }
    }
    Ok(outcome)
}
