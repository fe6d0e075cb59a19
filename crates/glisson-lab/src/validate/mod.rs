//! The experiments of `glisson validate`: each claim with its source, what is expected, and what was obtained now.

mod active_trocar;
mod adaptive;
mod benchmarks;
mod contact_physics;
mod contact_response;
mod cut_subdivision;
mod cutting;
mod cutting_sanity;
mod detection;
mod elasticity;
mod embedded_cuts;
mod haptic_force;
mod haptic_jumps;
mod hybrid;
mod hybrid_condensed;
mod image;
mod indentation;
mod interaction;
mod mesh_repair;
mod model_rheology;
mod organs;
mod palpation;
mod passivity;
mod precomputed_cutting;
mod precompute;
mod prestress;
mod quasi_nonlinear;
mod reduced;
mod resection;
mod rheology;
mod rotation;
mod many_bodies;
mod self_contact;
mod sutures;
mod tasks;
mod tissue;
pub mod touch_truth;
pub mod rough_hands;
pub mod strokes;
mod tubes;
mod unit;
mod volume;

use glisson_report::plot::{LinePlot, Series, SeriesStyle};
use serde::Serialize;

/// One claim, reproduced.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Experiment {
    /// What is claimed.
    pub name: String,
    /// Where the expected value comes from.
    pub source: String,
    /// The value that should come out, in words with its unit.
    pub expected: String,
    /// The value that came out.
    pub obtained: f64,
    /// How far it may be off, in words.
    pub tolerance: String,
    /// Whether it holds.
    pub pass: bool,
    /// Whether it compares processor times, which a busy machine changes.
    pub compares_times: bool,
}

impl Experiment {
    /// A value that may not exceed `limit`.
    fn at_most(name: &str, source: &str, obtained: f64, limit: f64) -> Self {
        Self {
            name: name.into(),
            source: source.into(),
            expected: "0".into(),
            obtained,
            tolerance: format!("{limit:e}"),
            pass: obtained <= limit,
            compares_times: false,
        }
    }

    /// A value near `expected`; `tolerance` is a share of it.
    fn near(name: &str, source: &str, obtained: f64, expected: f64, tolerance: f64) -> Self {
        Self {
            name: name.into(),
            source: source.into(),
            expected: format!("{}", (expected * 1e6).round() / 1e6),
            obtained,
            tolerance: format!("{} %", (tolerance * 1e8).round() / 1e6),
            pass: (obtained - expected).abs() <= tolerance * expected.abs(),
            compares_times: false,
        }
    }

    /// A value that has to lie in a range.
    fn within(name: &str, source: &str, obtained: f64, [low, high]: [f64; 2]) -> Self {
        Self {
            name: name.into(),
            source: source.into(),
            expected: format!("{low} to {high}"),
            obtained,
            tolerance: "in the range".into(),
            pass: (low..=high).contains(&obtained),
            compares_times: false,
        }
    }

    /// It compares processor times.
    fn of_times(self) -> Self {
        Self { compares_times: true, ..self }
    }
}

/// Which values a claim allows.
#[derive(Clone, Copy)]
enum Expected {
    /// See [`Experiment::at_most`].
    AtMost(f64),
    /// The value and the tolerance of [`Experiment::near`].
    Near(f64, f64),
    /// See [`Experiment::within`].
    Within([f64; 2]),
}

/// A row of a table of experiments: a claim about what was measured, an `M`.
struct Claim<'a, M> {
    name: &'a str,
    source: &'a str,
    expected: Expected,
    /// The value in question.
    value: fn(&M) -> f64,
}

impl<'a, M> Claim<'a, M> {
    /// A value that may not exceed `limit`.
    const fn at_most(name: &'a str, source: &'a str, value: fn(&M) -> f64, limit: f64) -> Self {
        Self { name, source, expected: Expected::AtMost(limit), value }
    }

    /// A value near the first number; the second is the tolerance as a share of it.
    const fn near(name: &'a str, source: &'a str, value: fn(&M) -> f64, near: [f64; 2]) -> Self {
        let [expected, tolerance] = near;
        Self { name, source, expected: Expected::Near(expected, tolerance), value }
    }

    /// A value that has to lie in a range.
    const fn within(name: &'a str, source: &'a str, value: fn(&M) -> f64, range: [f64; 2]) -> Self {
        Self { name, source, expected: Expected::Within(range), value }
    }

    /// What came out.
    fn check(&self, measured: &M) -> Experiment {
        let (Self { name, source, .. }, obtained) = (self, (self.value)(measured));
        match self.expected {
            Expected::AtMost(limit) => Experiment::at_most(name, source, obtained, limit),
            Expected::Near(expected, tolerance) => {
                Experiment::near(name, source, obtained, expected, tolerance)
            }
            Expected::Within(range) => Experiment::within(name, source, obtained, range),
        }
    }
}

/// What came out of the rows of a table, in their order.
fn check_all<M>(claims: &[Claim<'_, M>], measured: &M) -> Vec<Experiment> {
    claims.iter().map(|claim| claim.check(measured)).collect()
}

/// A series of a plot.
fn series(name: &str, points: Vec<[f64; 2]>, style: SeriesStyle) -> Series {
    Series { name: name.into(), points, style }
}

/// A picture that belongs to some experiments.
#[derive(Clone, Debug)]
pub struct Figure {
    /// File name without folder, `GROUP_WHAT.svg`.
    pub file: &'static str,
    /// What it shows, one sentence.
    pub caption: String,
    /// The picture.
    pub plot: LinePlot,
}

/// What came out of a group.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Claims and what came out.
    pub experiments: Vec<Experiment>,
    /// Plots.
    pub figures: Vec<Figure>,
    /// Markdown below the table: tables of figures that are no pass or fail, and what they say.
    pub notes: String,
}

impl From<Vec<Experiment>> for Outcome {
    fn from(experiments: Vec<Experiment>) -> Self {
        Self { experiments, ..Self::default() }
    }
}

/// A group of experiments that share their set-up.
pub struct Group {
    /// Name on the command line.
    pub name: &'static str,
    /// What it is about, one sentence.
    pub about: &'static str,
    /// Runs it.
    pub run: fn() -> anyhow::Result<Outcome>,
}

impl Group {
    const fn new(name: &'static str, about: &'static str, run: fn() -> anyhow::Result<Outcome>) -> Self {
        Self { name, about, run }
    }
}

/// All groups, quick ones first. A new one is a file (and its `mod` above) and a row here.
// A row a group, however long.
#[rustfmt::skip]
pub const GROUPS: &[Group] = &[
    Group::new("elasticity", "Linear and non-linear statics against finite-element solutions.", elasticity::experiments),
    Group::new("interaction", "The touched organ: pre-computed and dynamic.", interaction::experiments),
    Group::new("precompute", "The pre-computation against direct solutions, Lagrange multipliers and the papers' conjugate gradients.", precompute::experiments),
    Group::new("detection", "Contact detection: fast tools that must not pass through, pairs of triangles against brute force.", detection::experiments),
    Group::new("contact_response", "Local responses to contact: the cubes of seed 000 by penalty, impulse and geometric alteration.", contact_response::experiments),
    Group::new("self_contact", "An organ that touches itself: lobes driven together, a piece cut loose that falls on the rest.", self_contact::experiments),
    Group::new("active_trocar", "The active trocar: statics over its workspace, saturation, encoders, and its board palpating an organ.", active_trocar::experiments),
    Group::new("indentation", "A sphere and a flat punch on a bonded layer: graded tetrahedra against an axisymmetric solution.", indentation::experiments),
    Group::new("touch_reference", "A ball pressed deep into a bonded block: our own axisymmetric solutions, linear and stable neo-Hookean.", touch_truth::reference_experiments),
    Group::new("palpation", "A stiff nodule under the surface, felt with a flat tip: commands to the device against static solutions.", palpation::experiments),
    Group::new("haptic_force", "The force between two steps of a simulation at 30 Hz against the full model stepped at 1 kHz.", haptic_force::experiments),
    Group::new("haptic_jumps", "From a tearing liver to the hand: start, lost device, standstill, cut and rupture without jumps of force.", haptic_jumps::experiments),
    Group::new("passivity", "Energy of the haptic loop: a simulated device with a hand, delays, slow steps, with control and without.", passivity::experiments),
    Group::new("contact_physics", "Contact by constraints with friction: an incline, stacks at rest, a bounce.", contact_physics::experiments),
    Group::new("unit", "Elements and laws one by one: patch, rigid motions, derivatives, uniaxial stress, recovery, fibres.", unit::experiments),
    Group::new("tissue", "Viscoelastic tissue: relaxation, and brain under unconfined compression.", tissue::experiments),
    Group::new("quasi_nonlinear", "The pre-computed model with magnitudes from measured curves: a compressed cylinder of brain.", quasi_nonlinear::experiments),
    Group::new("rheology", "Springs: the cubes of seed 000 dropped, pressed and pulled, and what a step costs.", rheology::experiments),
    Group::new("model_rheology", "Every dynamic model on the virtual rheology bench: plates and a punch.", model_rheology::experiments),
    Group::new("benchmarks", "Structural benchmarks of the field, on plain and smoothed tetrahedra.", benchmarks::experiments),
    Group::new("rotation", "A cube that is turned as a whole, by linear and non-linear tensor-mass.", rotation::experiments),
    Group::new("tubes", "Three tubes under the same load: isotropic, with fibres along the axis, with stiffer ones.", tubes::experiments),
    Group::new("prestress", "Stretched bodies that relax after tetrahedra are removed.", prestress::experiments),
    Group::new("precomputed_cutting", "Cutting the pre-computed liver: errors against fresh pre-computations, time of a removal, hinges.", precomputed_cutting::experiments),
    Group::new("mesh_repair", "Shape of tetrahedra, cuts by vertex displacement, and their repair by collapse and by remeshing.", mesh_repair::experiments),
    Group::new("cut_subdivision", "Cutting along the swept blade: areas, shapes, volumes, pieces.", cut_subdivision::experiments),
    Group::new("embedded_cuts", "Embedded cuts: slits against a conforming mesh, random strokes, the stable step after them.", embedded_cuts::experiments),
    Group::new("sutures", "A stitch through the sides of a groove: pulled shut, the same in two models, forces in balance, tied by clips.", sutures::experiments),
    Group::new("cutting", "Removal equals rebuild, and tearing.", cutting::experiments),
    Group::new("cutting_sanity", "A moving body that is cut: area, mass, volume, energy, Euler characteristics.", cutting_sanity::experiments),
    Group::new("volume", "Changes of volume of a bent cylinder and a pulled liver: linear, non-linear, with penalty.", volume::experiments),
    Group::new("adaptive", "Non-linear forces only where they matter: error against rate, and the cost of non-linear to linear.", adaptive::experiments),
    Group::new("reduced", "The pre-computed model made non-linear in reduced coordinates, against the full non-linear solution.", reduced::experiments),
    Group::new("hybrid", "Zones that exchange forces: convergence, cost, frontiers with tensor-mass, cuts.", hybrid::experiments),
    Group::new("hybrid_condensed", "Pre-computed and dynamic zones, exactly coupled: error against processor time.", hybrid_condensed::experiments),
    Group::new("image", "From the image to the organ.", image::experiments),
    Group::new("organs", "Six organs in one mesh: interfaces, volumes, angles, a small tumour, time up to a million tetrahedra.", organs::experiments),
    Group::new("tasks", "The tasks that come with the program: demonstrations, careless players, and faults that are made on purpose.", tasks::experiments),
];

/// Groups of some minutes each, which run only when they are asked for.
#[rustfmt::skip]
pub const SLOW_GROUPS: &[Group] = &[
    Group::new("many_bodies", "A liver of 6,300 tetrahedra on its bed at 1 g for a minute: overlap, drift, real time, bits.", many_bodies::experiments),
    Group::new("contact_physics_full_size", "Two phantom livers of 6,300 tetrahedra, one on the other, for more than a minute.", contact_physics::full_size_experiments),
    Group::new("rough_hands", "Random violent motions of a hand, every model and law: bounded force, finite numbers, tissue back at rest.", rough_hands::experiments),
    Group::new("strokes", "Random strokes of scalpel, scissors and hook, every model and law: nothing breaks, bounded force, area opened as swept, volume kept.", strokes::experiments),
    Group::new("touch_truth", "A ball pressed into blocks of 2,000 to 50,000 tetrahedra by every model: forces against the axisymmetric solutions.", touch_truth::block_experiments),
    Group::new("touch_truth_livers", "A ball pressed into livers of three patients by every model: the forces of meshes of 2,000 to 50,000 tetrahedra agree.", touch_truth::liver_experiments),
    Group::new("touch_sliding", "A ball drawn over flat, curved and deeply pressed tissue by every model: Coulomb's friction, and no energy gained.", touch_truth::sliding_experiments),
];
