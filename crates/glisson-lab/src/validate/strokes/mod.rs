//! Random strokes of scalpel, scissors and hook through whole scenes, as `glisson run` makes them: livers of synthetic patients,
//! a cube and a cylinder, with every model that blades cut and its laws, with self-contact and tearing on and off ([`motions`]).
//!
//! Of each case: whether the simulation broke, the greatest force on an instrument beside what a hand bears, area opened beside
//! area swept, what the body lost of its volume without a hook or tearing, and why something was not cut.

mod motions;

use self::motions::{Sight, Strokes, strokes};
use super::rough_hands::Subject;
use super::{Experiment, Outcome};
use crate::bodies::{cylinder, filled, liver_surface};
use crate::scratch::ScratchFolder;
use crate::scripted::{LongestStep, open_with_longest_step};
use anyhow::ensure;
use glisson::image::phantom::PhantomParams;
use glisson::material::{LawKeyKind, Typical, law_named};
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::files::write_mesh;
use glisson::model::FollowedEdits;
use glisson::world::spec::Hand;
use glisson_runtime::Simulation;
use std::collections::BTreeSet;
use std::fmt::Write as _;

const OWN: &str = "requirement";
const N_STROKES: usize = 4;
/// The patients [seeds of the phantom], the sides of the cube, and the cylinder's radius and height [m].
const FIRST_PATIENT: u64 = 61;
const N_PATIENTS: u64 = 20;
const CUBE_M: f64 = 0.06;
const CYLINDER_M: [f64; 2] = [0.025, 0.06];
/// What a hand may bear beyond its limit, by rounding.
const OF_ROUNDING: f64 = 1e-9;
/// Opened over swept area, and volume lost without a hook over that of the body.
const MOST_AREA_OFF: f64 = 0.02;
const MOST_VOLUME_OFF: f64 = 1e-12;

/// A part of the cases.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Scene names of models; all that blades cut if empty.
    pub models: Vec<String>,
    /// The first seed.
    pub first_seed: u64,
    /// Cases, of four strokes each.
    pub n_cases: u64,
    /// Wanted tetrahedra of the body.
    pub n_tets: usize,
}

impl Default for Selection {
    fn default() -> Self {
        Self { models: Vec::new(), first_seed: 0, n_cases: 100, n_tets: 2_000 }
    }
}

impl Selection {
    fn subjects(&self) -> anyhow::Result<Vec<Subject>> {
        let mut subjects = Subject::of_models(&self.models)?;
        subjects.retain(|Subject { kind, .. }| {
            kind.row().edits != FollowedEdits::None && !kind.row().follows_curves
        });
        ensure!(!subjects.is_empty(), "blades cut none of the models {}", self.models.join(", "));
        Ok(subjects)
    }
}

/// What is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Body {
    Liver(u64),
    Cube,
    Cylinder,
}

impl Body {
    /// Two livers of three.
    fn of_seed(seed: u64) -> Self {
        match seed % 6 {
            4 => Self::Cube,
            5 => Self::Cylinder,
            // Four of six seeds, each patient in turn.
            of_six => Self::Liver(FIRST_PATIENT + (4 * (seed / 6) + of_six) % N_PATIENTS),
        }
    }

    fn mesh(self, n_tets: usize) -> anyhow::Result<TetMesh> {
        match self {
            Self::Liver(seed) => {
                filled(&liver_surface(&PhantomParams { seed, ..PhantomParams::default() })?, n_tets)
            }
            Self::Cube => {
                let n = ((n_tets as f64 / 5.0).cbrt().round() as usize).max(2);
                Ok(box_of_five([n; 3], DVec3::splat(CUBE_M)))
            }
            Self::Cylinder => cylinder(CYLINDER_M[0], CYLINDER_M[1], n_tets),
        }
    }

    /// Where it is held, from its middle.
    fn behind(self) -> DVec3 {
        match self {
            Self::Liver(_) => DVec3::new(0.0, 1.0, 0.4),
            Self::Cube | Self::Cylinder => -DVec3::Z,
        }
    }

    fn name(self) -> String {
        match self {
            Self::Liver(seed) => format!("liver {seed}"),
            Self::Cube => "cube".into(),
            Self::Cylinder => "cylinder".into(),
        }
    }
}

/// Four strokes.
struct Case {
    subject: Subject,
    seed: u64,
    body: Body,
    touches_itself: bool,
    tears: bool,
    felt: Felt,
}

/// What came of them.
#[derive(Default)]
struct Felt {
    n_tets: usize,
    step_s: f64,
    greatest_force_n: f64,
    swept_m2: f64,
    opened_m2: f64,
    /// Strokes whose faces merged with others.
    n_merged: usize,
    /// Whether the hook took tissue away.
    burns: bool,
    n_torn: usize,
    n_edits: u32,
    /// Of the body at rest, over that at the start.
    lost: f64,
    broken: Option<String>,
    /// What was not done, in words.
    refusals: BTreeSet<String>,
}

impl Case {
    const HEAD: &'static str = "| model | law | body | seed | self-contact | tearing | tetrahedra | step [us] | edits | force [N] | swept [cm2] | opened [cm2] | merged | torn | lost | broken, or not cut |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";

    fn is_bounded(&self) -> bool {
        self.felt.greatest_force_n <= Hand::default().greatest_force_n * (1.0 + OF_ROUNDING)
    }

    /// Torn tissue leaves the blade nothing to open.
    fn opens_what_it_sweeps(&self) -> bool {
        let Felt { swept_m2, opened_m2, n_torn, .. } = self.felt;
        n_torn > 0 || (opened_m2 - swept_m2).abs() <= MOST_AREA_OFF * swept_m2
    }

    /// Hooks and tearing take tissue away.
    fn keeps_volume(&self) -> bool {
        self.felt.burns || self.felt.n_torn > 0 || self.felt.lost.abs() <= MOST_VOLUME_OFF
    }

    fn row(&self) -> String {
        let Felt {
            n_tets,
            step_s,
            greatest_force_n,
            swept_m2,
            opened_m2,
            n_merged,
            n_torn,
            n_edits,
            lost,
            ..
        } = self.felt;
        let broken = self.felt.broken.iter().chain(&self.felt.refusals);
        format!(
            "| {} | {} | {} | {} | {} | {} | {n_tets} | {:.0} | {n_edits} | {greatest_force_n:.2} | {:.2} | {:.2} | {n_merged} | {n_torn} | {lost:.1e} | {} |\n",
            self.subject.kind,
            self.subject.law.unwrap_or("-"),
            self.body.name(),
            self.seed,
            if self.touches_itself { "on" } else { "off" },
            if self.tears { "on" } else { "off" },
            1e6 * step_s,
            1e4 * swept_m2,
            1e4 * opened_m2,
            broken.cloned().collect::<Vec<_>>().join("; "),
        )
    }
}

/// A law with what is typical of it, in scene text.
fn law_text(name: &str) -> String {
    let mut text = format!("law = {{ name = \"{name}\"");
    for key in law_named(name).iter().flat_map(|law| law.entry().keys) {
        match (key.typical, key.kind) {
            (Typical::Number(number), LawKeyKind::Positive(_)) => {
                text += &format!(", {} = \"{number} Pa\"", key.name);
            }
            (Typical::Number(number), _) => text += &format!(", {} = {number}", key.name),
            (Typical::Directions(directions), _) => {
                text += &format!(", {} = {:?}", key.name, directions[0].to_array());
            }
        }
    }
    text + " }\n"
}

fn scene_text(case: &Case, step_s: f64, tools: &str) -> String {
    let Case { subject, body, .. } = case;
    let law = subject.law.map_or(String::new(), law_text);
    let behind = body.behind();
    let contact = if case.touches_itself { "[contact]\nself = true\n" } else { "" };
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"{} us\"\n{contact}\
         [organ]\nmesh = \"body.vtu\"\ntissue = \"liver\"\nmodel = \"{}\"\n{law}damping = \"20 1/s\"\ntearing = {}\n\
         [[organ.fixed]]\nfurthest = {{ direction = [{}, {}, {}], fraction = 0.15 }}\n{tools}",
        step_s * 1e6,
        subject.kind,
        case.tears,
        behind.x,
        behind.y,
        behind.z
    )
}

/// The case of a seed, cut.
fn cut(subject: Subject, seed: u64, n_tets: usize) -> anyhow::Result<Case> {
    let (body, mut random) = (Body::of_seed(seed), SeededRandom::new(seed));
    let touches_itself = subject.kind.row().corrects_steps && seed / 12 % 2 == 1;
    let mut case =
        Case { subject, seed, body, touches_itself, tears: seed / 6 % 2 == 1, felt: Felt::default() };
    let mesh = body.mesh(n_tets)?;
    let folder = ScratchFolder::new()?;
    write_mesh(&folder.path().join("body.vtu"), &mesh)?;
    let Strokes { tools, end_s, burns } = strokes(&Sight::new(&mesh, body.behind()), N_STROKES, &mut random);
    let text = |step_s: f64| scene_text(&case, step_s, &tools);
    let LongestStep { mut simulation, scene, step_s } =
        open_with_longest_step(folder.path(), 1, subject.step_s, &text)?;
    let mut felt = Felt { n_tets: mesh.tetrahedra.len(), step_s, burns, ..Felt::default() };
    for step in 1..=(end_s / step_s).ceil() as u64 {
        match simulation.advance(&scene.input_at(step as f64 * step_s)) {
            Ok(report) => {
                let forces_n = report.tools.iter().map(|tool| tool.force_on_tool_n.length());
                // NaN is the greatest of all.
                felt.greatest_force_n = forces_n
                    .fold(felt.greatest_force_n, |most, n| if most.is_nan() || n <= most { most } else { n });
            }
            Err(error) => {
                felt.broken = Some(format!("{error:#}"));
                break;
            }
        }
        felt.refusals.extend(refusals(&simulation));
    }
    let (world, blades) = (simulation.world(), *simulation.world().blades());
    (felt.swept_m2, felt.opened_m2, felt.n_merged) =
        (blades.swept_area_m2, blades.cut_area_m2, blades.n_merged);
    felt.n_torn = simulation.n_torn();
    felt.n_edits = world.organ().topology_version() - 1;
    felt.lost = 1.0 - world.organ().body().volume_m3() / mesh.volume_m3();
    case.felt = felt;
    Ok(case)
}

/// What the simulation told of cuts that were not made.
fn refusals(simulation: &Simulation) -> impl Iterator<Item = String> {
    let notices = simulation.notices().iter().filter(|notice| notice.is_problem);
    notices.map(|notice| notice.text.clone()).filter(|text| text.contains("cut nothing"))
}

/// Runs the selection; `see` hears of each case as soon as it is done.
fn run(selection: &Selection, see: &mut dyn FnMut(&Case)) -> anyhow::Result<Vec<Case>> {
    let subjects = selection.subjects()?;
    let mut cases = Vec::new();
    for seed in selection.first_seed..selection.first_seed + selection.n_cases {
        // One after the other, and another one first in each round, so that in the long run each meets every body, with and without
        // self-contact and tearing.
        let n = subjects.len() as u64;
        let subject = subjects[((seed + seed / n) % n) as usize];
        let case = cut(subject, seed, selection.n_tets)?;
        see(&case);
        cases.push(case);
    }
    Ok(cases)
}

/// Runs the selection and writes a line a case as soon as it is done.
///
/// # Errors
/// For an unknown model, and what cannot be set up.
pub fn write_cases(selection: &Selection, write: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    write(Case::HEAD);
    run(selection, &mut |case| write(&case.row()))?;
    Ok(())
}

type Holds = fn(&Case) -> bool;

/// Claims about all cases.
fn judge(cases: &[Case]) -> Vec<Experiment> {
    let n = cases.len();
    let claims: [(&str, Holds); 4] = [
        ("in which the simulation broke", |case| case.felt.broken.is_none()),
        ("with a force above the hand's", Case::is_bounded),
        ("without tearing that open 2 % more or less than they sweep", Case::opens_what_it_sweeps),
        ("without tearing and hook that lose more than 1e-12 of the volume", Case::keeps_volume),
    ];
    let claim = |(what, holds): (&str, Holds)| {
        let n_wrong = cases.iter().filter(|case| !holds(case)).count();
        Experiment::at_most(&format!("cases of {n}, four strokes each, {what}"), OWN, n_wrong as f64, 0.0)
    };
    claims.into_iter().map(claim).collect()
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let cases = run(&Selection::default(), &mut |_| {})?;
    let mut notes = format!("\n### Every case, {N_STROKES} strokes each\n\n{}", Case::HEAD);
    cases.iter().try_for_each(|case| write!(notes, "{}", case.row()))?;
    Ok(Outcome { notes, ..Outcome::from(judge(&cases)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::scene::Scene;

    #[test]
    fn every_model_and_law_has_a_scene_and_what_is_wrong_is_counted() {
        let subjects = Selection::default().subjects().unwrap();
        let body = Body::Cube;
        let mesh = body.mesh(600).unwrap();
        let sight = Sight::new(&mesh, body.behind());
        let tools = strokes(&sight, N_STROKES, &mut SeededRandom::new(1)).tools;
        for subject in &subjects {
            let felt = Felt::default();
            let touches_itself = subject.kind.row().corrects_steps;
            let case = Case { subject: *subject, seed: 0, body, touches_itself, tears: true, felt };
            Scene::parse(&scene_text(&case, 1e-4, &tools)).unwrap();
        }
        let implicit = subjects.iter().find(|subject| subject.kind.name() == "implicit").unwrap();
        // A cube without tearing.
        let case = cut(*implicit, 4, 600).unwrap();
        assert!(case.felt.n_edits > 0 && case.felt.swept_m2 > 0.0, "{}", case.row());
        assert!(case.felt.broken.is_none() && case.is_bounded() && case.keeps_volume(), "{}", case.row());
        let wrong =
            Case { felt: Felt { greatest_force_n: f64::NAN, opened_m2: 1.0, ..Felt::default() }, ..case };
        assert_eq!(judge(&[wrong]).iter().filter(|claim| !claim.pass).count(), 2);
    }
}
