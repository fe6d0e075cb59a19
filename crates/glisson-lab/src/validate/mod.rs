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
mod haptic_force;
mod haptic_jumps;
mod hybrid;
mod hybrid_condensed;
mod image;
mod indentation;
mod interaction;
mod mesh_repair;
mod model_rheology;
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
mod self_contact;
mod tissue;
mod tubes;
mod unit;
mod volume;

use glisson_view::plot::LinePlot;
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

/// All groups, quick ones first.
pub const GROUPS: &[Group] = &[
    Group {
        name: "elasticity",
        about: "Linear and non-linear statics against finite-element solutions.",
        run: elasticity::experiments,
    },
    Group {
        name: "interaction",
        about: "The touched organ: pre-computed and dynamic.",
        run: interaction::experiments,
    },
    Group {
        name: "precompute",
        about: "The pre-computation against direct solutions, Lagrange multipliers and the papers' conjugate gradients.",
        run: precompute::experiments,
    },
    Group {
        name: "detection",
        about: "Contact detection: fast tools that must not pass through, pairs of triangles against brute force.",
        run: detection::experiments,
    },
    Group {
        name: "contact_response",
        about: "Local responses to contact: the cubes of seed 000 by penalty, impulse and geometric alteration.",
        run: contact_response::experiments,
    },
    Group {
        name: "self_contact",
        about: "An organ that touches itself: lobes driven together, a piece cut loose that falls on the rest.",
        run: self_contact::experiments,
    },
    Group {
        name: "active_trocar",
        about: "The active trocar: statics over its workspace, saturation, encoders, and its board palpating an organ.",
        run: active_trocar::experiments,
    },
    Group {
        name: "indentation",
        about: "A sphere and a flat punch on a bonded layer: graded tetrahedra against an axisymmetric solution.",
        run: indentation::experiments,
    },
    Group {
        name: "palpation",
        about: "A stiff nodule under the surface, felt with a flat tip: commands to the device against static solutions.",
        run: palpation::experiments,
    },
    Group {
        name: "haptic_force",
        about: "The force between two steps of a simulation at 30 Hz against the full model stepped at 1 kHz.",
        run: haptic_force::experiments,
    },
    Group {
        name: "haptic_jumps",
        about: "From a tearing liver to the hand: start, lost device, standstill, cut and rupture without jumps of force.",
        run: haptic_jumps::experiments,
    },
    Group {
        name: "passivity",
        about: "Energy of the haptic loop: a simulated device with a hand, delays, slow steps, with control and without.",
        run: passivity::experiments,
    },
    Group {
        name: "contact_physics",
        about: "Contact by constraints with friction: an incline, stacks at rest, a bounce.",
        run: contact_physics::experiments,
    },
    Group {
        name: "unit",
        about: "Elements and laws one by one: patch, rigid motions, derivatives, uniaxial stress, recovery, fibres.",
        run: unit::experiments,
    },
    Group {
        name: "tissue",
        about: "Viscoelastic tissue: relaxation, and brain under unconfined compression.",
        run: tissue::experiments,
    },
    Group {
        name: "quasi_nonlinear",
        about: "The pre-computed model with magnitudes from measured curves: a compressed cylinder of brain.",
        run: quasi_nonlinear::experiments,
    },
    Group {
        name: "rheology",
        about: "Springs: the cubes of seed 000 dropped, pressed and pulled, and what a step costs.",
        run: rheology::experiments,
    },
    Group {
        name: "model_rheology",
        about: "Every dynamic model on the virtual rheology bench: plates and a punch.",
        run: model_rheology::experiments,
    },
    Group {
        name: "benchmarks",
        about: "Structural benchmarks of the field, on plain and smoothed tetrahedra.",
        run: benchmarks::experiments,
    },
    Group {
        name: "rotation",
        about: "A cube that is turned as a whole, by linear and non-linear tensor-mass.",
        run: rotation::experiments,
    },
    Group {
        name: "tubes",
        about: "Three tubes under the same load: isotropic, with fibres along the axis, with stiffer ones.",
        run: tubes::experiments,
    },
    Group {
        name: "prestress",
        about: "Stretched bodies that relax after tetrahedra are removed.",
        run: prestress::experiments,
    },
    Group {
        name: "precomputed_cutting",
        about: "Cutting the pre-computed liver: errors against fresh pre-computations, time of a removal, hinges.",
        run: precomputed_cutting::experiments,
    },
    Group {
        name: "mesh_repair",
        about: "Shape of tetrahedra, cuts by vertex displacement, and their repair by collapse and by remeshing.",
        run: mesh_repair::experiments,
    },
    Group {
        name: "cut_subdivision",
        about: "Cutting along the swept blade: areas, shapes, volumes, pieces.",
        run: cut_subdivision::experiments,
    },
    Group { name: "cutting", about: "Removal equals rebuild, and tearing.", run: cutting::experiments },
    Group {
        name: "cutting_sanity",
        about: "A moving body that is cut: area, mass, volume, energy, Euler characteristics.",
        run: cutting_sanity::experiments,
    },
    Group {
        name: "volume",
        about: "Changes of volume of a bent cylinder and a pulled liver: linear, non-linear, with penalty.",
        run: volume::experiments,
    },
    Group {
        name: "adaptive",
        about: "Non-linear forces only where they matter: error against rate, and the cost of non-linear to linear.",
        run: adaptive::experiments,
    },
    Group {
        name: "reduced",
        about: "The pre-computed model made non-linear in reduced coordinates, against the full non-linear solution.",
        run: reduced::experiments,
    },
    Group {
        name: "hybrid",
        about: "Zones that exchange forces: convergence, cost, frontiers with tensor-mass, cuts.",
        run: hybrid::experiments,
    },
    Group {
        name: "hybrid_condensed",
        about: "Pre-computed and dynamic zones, exactly coupled: error against processor time.",
        run: hybrid_condensed::experiments,
    },
    Group { name: "image", about: "From the image to the organ.", run: image::experiments },
];

/// Groups of some minutes each, which run only when they are asked for.
pub const SLOW_GROUPS: &[Group] = &[Group {
    name: "contact_physics_full_size",
    about: "Two phantom livers of 6,300 tetrahedra, one on the other, for more than a minute.",
    run: contact_physics::full_size_experiments,
}];
