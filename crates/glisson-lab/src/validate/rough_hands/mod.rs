//! Hands that do what no surgeon does, to every model with every law: random violent motions, each of a seed ([`motions`]).
//!
//! Of each motion: the greatest force on the hand beside the hand's limit, how far a step takes an instrument from its hand, the work of
//! the hands beside that on the tissue ([`work`]), numbers that are not finite, tetrahedra that are inverted half a second after the tools
//! left, and how far the block is from its rest shape after two. With the limit of [`Hand::default`], and with ten times that: the
//! tissue's side has to hold without the limit's help.

mod motions;
mod work;

pub(crate) use self::motions::Subject;
use self::motions::{Block, Outcome as Felt, abuse, motion_name};
use self::work::Work;
use super::touch_truth::{BLOCK_SIZE_M, block};
use super::{Experiment, Outcome};
use crate::scratch::ScratchFolder;
use glisson::model::MeasuredSample;
use glisson::world::spec::Hand;
use std::fmt::Write as _;
use std::path::Path;

const OWN: &str = "requirement";
/// What the hand may bear beyond its limit, by rounding.
const OF_ROUNDING: f64 = 1e-9;
/// Tissue pushes an instrument no further from its hand in a step than this [m]: the size of the block's half height.
const MOST_ASTRAY_M: f64 = 0.03;
/// The tissue is not given more than this share of the hands' work, and so much [J]: what a light touch is.
const MOST_WORK_SHARE: f64 = 1.05;
const LEAST_WORK_J: f64 = 1e-3;
/// Tissue is at rest again when no node is further from its place [m].
const MOST_OFF_M: f64 = 1e-3;

/// A part of the motions.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Scene names of models; all if empty.
    pub models: Vec<String>,
    /// Names of laws; all if empty.
    pub laws: Vec<String>,
    /// Wanted tetrahedra of the block; the mesher finds no mesh of 1,000.
    pub n_tets: usize,
    /// The first seed.
    pub first_seed: u64,
    /// Motions of each model and law.
    pub n_motions: u64,
    /// Greatest forces of the hand, over the default.
    pub limits: Vec<f64>,
}

impl Default for Selection {
    fn default() -> Self {
        Self {
            models: Vec::new(),
            laws: Vec::new(),
            n_tets: 2_000,
            first_seed: 0,
            n_motions: 20,
            limits: vec![1.0, 10.0],
        }
    }
}

impl Selection {
    fn subjects(&self) -> anyhow::Result<Vec<Subject>> {
        let is_law = |law: &str| self.laws.iter().any(|l| l == law);
        let mut subjects = Subject::of_models(&self.models)?;
        subjects.retain(|subject| self.laws.is_empty() || subject.law.is_some_and(is_law));
        Ok(subjects)
    }
}

/// One motion of one subject.
#[derive(Clone, Copy, Debug)]
struct Case {
    subject: Subject,
    limit_n: f64,
    seed: u64,
    felt: Felt,
}

impl Case {
    const HEAD: &'static str = "| model | law | limit [N] | seed | motion | force [N] | astray [mm] | work of the hands [J] | on the tissue [J] | not finite | inverted | off rest [mm] | steps with a substitute law | with limited energy | |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";

    fn is_bounded(&self) -> bool {
        self.felt.greatest_force_n <= self.limit_n * (1.0 + OF_ROUNDING)
    }

    /// Not so when a place is no number.
    fn is_at_rest(&self) -> bool {
        self.felt.most_off_m <= MOST_OFF_M
    }

    /// Not so when a place is no number.
    fn stays_with_hand(&self) -> bool {
        self.felt.most_astray_m <= MOST_ASTRAY_M
    }

    /// Not so when a work is no number.
    fn keeps_energy(&self) -> bool {
        let Work { of_hands_j, on_tissue_j } = self.felt.work;
        on_tissue_j <= MOST_WORK_SHARE * of_hands_j.max(0.0) + LEAST_WORK_J
    }

    fn holds(&self) -> bool {
        let Felt { n_non_finite, n_inverted, .. } = self.felt;
        self.is_bounded()
            && self.stays_with_hand()
            && self.keeps_energy()
            && n_non_finite == 0
            && n_inverted == 0
            && self.is_at_rest()
    }

    fn row(&self) -> String {
        let Felt { greatest_force_n, most_astray_m, n_non_finite, n_inverted, most_off_m, .. } = self.felt;
        let Work { of_hands_j, on_tissue_j } = self.felt.work;
        format!(
            "| {} | {} | {} | {} | {} | {greatest_force_n:.3} | {:.3} | {of_hands_j:.4} | {on_tissue_j:.4} | {n_non_finite} | {n_inverted} | {:.3} | {} | {} | {} |\n",
            self.subject.kind,
            self.subject.law.unwrap_or("-"),
            self.limit_n,
            self.seed,
            motion_name(self.seed),
            most_astray_m * 1e3,
            most_off_m * 1e3,
            self.felt.n_quarantined_steps,
            self.felt.n_limited_steps,
            if self.holds() { "pass" } else { "FAIL" },
        )
    }
}

/// The curve of a cylinder that is linear up to a fifth of its height: what follows curves then answers as linear tissue.
fn write_curve(folder: &Path) -> anyhow::Result<MeasuredSample> {
    let curve = folder.join("curve.csv");
    let mut text = String::from("axial_displacement_mm,force_n\n");
    for i in 0..=20 {
        writeln!(text, "{},{}", 0.1 * f64::from(i), 0.05 * f64::from(i))?;
    }
    std::fs::write(&curve, text)?;
    Ok(MeasuredSample { curve, height_m: 0.01, radius_m: 0.01, degree: 4 })
}

/// Runs the selection; `see` hears of each case as soon as it is done.
fn run(selection: &Selection, see: &mut dyn FnMut(&Case)) -> anyhow::Result<Vec<Case>> {
    let folder = ScratchFolder::new()?;
    let mut block = Block::new(block(selection.n_tets)?, BLOCK_SIZE_M);
    block.measured = Some(write_curve(folder.path())?);
    let mut cases = Vec::new();
    for subject in selection.subjects()? {
        for limit in &selection.limits {
            let default = Hand::default();
            let hand = Hand { greatest_force_n: limit * default.greatest_force_n, ..default };
            for seed in selection.first_seed..selection.first_seed + selection.n_motions {
                let felt = abuse(&block, &subject, hand, seed).map_err(anyhow::Error::msg)?;
                let case = Case { subject, limit_n: hand.greatest_force_n, seed, felt };
                see(&case);
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

/// Runs the selection and writes a line a motion as soon as it is done.
///
/// # Errors
/// For an unknown model, and what cannot be set up.
pub fn write_motions(selection: &Selection, write: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    write(Case::HEAD);
    run(selection, &mut |case| write(&case.row()))?;
    Ok(())
}

type IsWrong = fn(&Case) -> bool;

/// Claims about all motions of one limit.
fn judge(cases: &[Case], limit_n: f64) -> Vec<Experiment> {
    let of_limit = || cases.iter().filter(|case| case.limit_n == limit_n);
    let count = |is_wrong: IsWrong| of_limit().filter(|case| is_wrong(case)).count() as f64;
    let n = of_limit().count();
    let claims: [(&str, IsWrong); 6] = [
        ("with a greater force on the hand", |case| !case.is_bounded()),
        ("with an instrument that a step takes more than 30 mm from its hand", |case| {
            !case.stays_with_hand()
        }),
        ("with more work on the tissue than the hands did", |case| !case.keeps_energy()),
        ("with a number that is not finite", |case| case.felt.n_non_finite > 0),
        ("with an inverted tetrahedron 0.5 s after the tools left", |case| case.felt.n_inverted > 0),
        ("further than 1 mm from rest after 2 s", |case| !case.is_at_rest()),
    ];
    let claim = |(what, is_wrong): (&str, IsWrong)| {
        Experiment::at_most(&format!("limit {limit_n} N: motions of {n} {what}"), OWN, count(is_wrong), 0.0)
    };
    claims.into_iter().map(claim).collect()
}

/// Of every model and law, the worst of its motions.
fn summary(cases: &[Case]) -> anyhow::Result<String> {
    let mut text = String::from(
        "\n### Every model and law, 20 violent motions each\n\nWorst of all motions; block of 100 x 100 x 60 mm in about 2,000 \
         tetrahedra, held at its base.\n\n\
         | model | law | limit [N] | force [N] | motions with inverted tetrahedra after 0.5 s | furthest from rest after 2 s [mm] | motions that hold |\n|---|---|---|---|---|---|---|\n",
    );
    let is_same = |a: &Case, b: &Case| {
        (a.subject.kind, a.subject.law, a.limit_n) == (b.subject.kind, b.subject.law, b.limit_n)
    };
    for of_subject in cases.chunk_by(is_same) {
        let Case { subject, limit_n, .. } = of_subject[0];
        let worst = |value: fn(&Case) -> f64| of_subject.iter().map(value).fold(0.0, f64::max);
        writeln!(
            text,
            "| `{}` | {} | {limit_n} | {:.3} | {} | {:.3} | {} of {} |",
            subject.kind,
            subject.law.unwrap_or("-"),
            worst(|case| case.felt.greatest_force_n),
            of_subject.iter().filter(|case| case.felt.n_inverted > 0).count(),
            1e3 * worst(|case| case.felt.most_off_m),
            of_subject.iter().filter(|case| case.holds()).count(),
            of_subject.len(),
        )?;
    }
    Ok(text)
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let selection = Selection::default();
    let cases = run(&selection, &mut |_| {})?;
    let mut outcome = Outcome { notes: summary(&cases)?, ..Outcome::default() };
    for limit in &selection.limits {
        outcome.experiments.extend(judge(&cases, limit * Hand::default().greatest_force_n));
    }
    Ok(outcome)
}
