//! What a seed is about: body, model, law and everything else that a scene can say of an organ that is cut.

use glisson::contact::response::self_contact::SelfContactParams;
use glisson::material::{LawChoice, law_named};
use glisson::math::{DVec3, SeededRandom};
use glisson::model::kind::ModelKind;
use glisson::model::{FollowedEdits, ModelMotion};
use glisson::tool::BladeCuts;

/// The models that can be cut (docs/scene.md), in the order in which seeds take turns with them.
pub(super) const MODELS: [ModelKind; 8] = [
    ModelKind::Explicit,
    ModelKind::Implicit,
    ModelKind::TensorMass,
    ModelKind::NonlinearTensorMass,
    ModelKind::MassSpring,
    ModelKind::ExtendedMassSpring,
    ModelKind::Hybrid,
    ModelKind::Precomputed,
];

/// Time steps [s] of models that go to an equilibrium or solve equations: usual ones (docs/scene.md).
const LONG_STEPS_S: [f64; 4] = [1e-3, 2e-3, 5e-3, 1e-2];
/// Time steps [s] of explicit dynamics, of which a body takes the drawn one or the next that is stable.
const SHORT_STEPS_S: [f64; 8] = [1e-3, 5e-4, 4e-4, 3e-4, 2e-4, 1e-4, 5e-5, 2e-5];
/// So many of them are drawn from.
const DRAWN_SHORT_STEPS: usize = 4;
/// Law with which the first seed of a model begins: those of a bounded share are not all the models' own.
const FIRST_LAW: u64 = 3;
/// Stiffness of springs where the organ touches itself [N/m], of models without a geometric response: that of docs/scene.md.
const OWN_CONTACT_N_PER_M: f64 = 50.0;

/// What holds of a model after an edit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Depth {
    /// Forces and masses against a plain loop, and against a model made afresh.
    Forces,
    /// Masses against a plain loop, and forces against a model made afresh: springs have no law.
    Afresh,
    /// Compliance against one computed afresh, at the end.
    Compliance,
    /// Nothing of the model but its numbers and its bits: a fresh one has other zones.
    Bits,
}

/// How far from rest a tetrahedron may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Limit {
    /// Least share of its volume that is left.
    pub(super) least_ratio: f64,
    /// Most of |F|^2, which is 3 at rest.
    pub(super) most_squares: f64,
}

/// Laws that end where a tetrahedron is flat have forces near it that are differences of much larger numbers.
const UPRIGHT: Limit = Limit { least_ratio: 0.1, most_squares: f64::INFINITY };
/// The extended mass-spring model continues the logarithm's law below 0.4.
const LOGARITHMIC: Limit = Limit { least_ratio: 0.45, ..UPRIGHT };
/// The implicit model gives tetrahedra that were inside out their law back only near rest (0.6 and 4.5).
const NEAR_REST: Limit = Limit { least_ratio: 0.65, most_squares: 4.4 };

/// What a seed is about.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Draw {
    pub(super) seed: u64,
    /// Which body.
    pub(super) body: usize,
    pub(super) kind: ModelKind,
    /// None for springs.
    pub(super) law: Option<LawChoice>,
    /// Whether its stress relaxes.
    pub(super) relaxes: bool,
    pub(super) touches_itself: bool,
    pub(super) tears: bool,
    pub(super) mends_cuts: bool,
    /// A hook, else a cautery.
    pub(super) burns_with_hook: bool,
    pub(super) blade_cuts: BladeCuts,
    /// In proportion to mass [1/s].
    pub(super) damping_per_s: f64,
    /// Time steps that are tried, in this order [s].
    pub(super) time_steps_s: Vec<f64>,
}

impl Draw {
    /// The draw of a seed: models, laws and bodies take turns, everything else is at random.
    pub(super) fn of(seed: u64, n_bodies: usize) -> Self {
        let n_models = MODELS.len() as u64;
        let (turn, round) = (seed % n_models, seed / n_models);
        let kind = MODELS[turn as usize];
        let laws = kind.laws();
        let law = laws.get(((round + FIRST_LAW) % laws.len().max(1) as u64) as usize);
        // Not the patient's own numbers.
        let mut random = SeededRandom::new(seed + 1_000_000);
        let mut coin = |probability: f64| random.uniform() < probability;
        let (touches_itself, tears, mends_cuts) = (coin(0.4), coin(0.7), coin(0.5));
        // The implicit model's memory turns with the tissue, which the linear law does not.
        let knows_relaxation = kind.row().relaxes && (kind, law) != (ModelKind::Implicit, Some(&"linear"));
        let (relaxes, burns_with_hook, divides) = (coin(0.7) && knows_relaxation, coin(0.5), coin(0.5));
        let damping_per_s = if coin(0.5) { 20.0 } else { 0.0 };
        let steps_s: &[f64] = if has_long_steps(kind) { &LONG_STEPS_S } else { &SHORT_STEPS_S };
        let n_drawn = steps_s.len().min(DRAWN_SHORT_STEPS);
        let first = ((random.uniform() * n_drawn as f64) as usize).min(n_drawn - 1);
        Self {
            seed,
            body: ((turn + round + round / 4) % n_bodies as u64) as usize,
            kind,
            law: law.map(|name| law_by_name(name)),
            relaxes,
            touches_itself,
            tears,
            mends_cuts,
            burns_with_hook,
            blade_cuts: if divides { BladeCuts::Subdivision } else { BladeCuts::Displacement },
            damping_per_s,
            time_steps_s: steps_s[first..].to_vec(),
        }
    }

    /// The law's name in scenes.
    pub(super) fn law_name(&self) -> &'static str {
        self.law.as_ref().map_or("springs", LawChoice::name)
    }

    /// Whether the model follows new nodes and tetrahedra; else it follows removals alone.
    pub(super) fn follows_all(&self) -> bool {
        self.kind.row().edits == FollowedEdits::All
    }

    /// Pre-computed tissue has none.
    pub(super) fn knows_ligaments(&self) -> bool {
        self.follows_all() && self.kind.row().corrects_steps
    }

    /// Whether the model's history ends with the stress memory of each tetrahedron.
    pub(super) fn shows_memory(&self) -> bool {
        self.relaxes && self.kind == ModelKind::Explicit
    }

    /// How far from rest tetrahedra may be for the model to follow its law in all of them; none where that is no matter.
    pub(super) fn limit(&self) -> Option<Limit> {
        // Tetrahedra that are inside out follow another law there, and near them for a while.
        let leaves_out = matches!(self.kind, ModelKind::NonlinearTensorMass | ModelKind::ExtendedMassSpring)
            || self.kind == ModelKind::Implicit && self.law_name() == "st_venant_kirchhoff";
        let is_finite = ["springs", "linear", "st_venant_kirchhoff", "stable_neo_hooke"];
        if !leaves_out && is_finite.contains(&self.law_name()) {
            return None;
        }
        Some(match self.kind {
            ModelKind::Implicit => NEAR_REST,
            ModelKind::ExtendedMassSpring if self.law_name() == "neo_hooke_log" => LOGARITHMIC,
            _ => UPRIGHT,
        })
    }

    /// What is checked of the model.
    pub(super) fn depth(&self) -> Depth {
        match self.kind {
            ModelKind::MassSpring => Depth::Afresh,
            ModelKind::Precomputed => Depth::Compliance,
            ModelKind::Hybrid => Depth::Bits,
            _ => Depth::Forces,
        }
    }

    /// How it touches itself in steps of `time_step_s`.
    pub(super) fn self_contact(&self, time_step_s: f64) -> Option<SelfContactParams> {
        let friction = SelfContactParams::DEFAULT_FRICTION;
        let response = if self.kind.row().corrects_steps {
            SelfContactParams::geometric(friction)
        } else {
            SelfContactParams::penalty(OWN_CONTACT_N_PER_M, friction)
        };
        let margin_m = SelfContactParams::default_margin_m(time_step_s);
        self.touches_itself.then_some(SelfContactParams { margin_m, response })
    }
}

/// Whether a model takes any time step.
fn has_long_steps(kind: ModelKind) -> bool {
    kind.row().motion != ModelMotion::Explicit
}

/// A law of scenes, with usual numbers of its own.
fn law_by_name(name: &str) -> LawChoice {
    let mut law = law_named(name).unwrap_or_else(|| panic!("there is no law {name}"));
    for (of, key, number) in [
        ("mooney_rivlin", "c01_share", 0.3),
        ("ogden", "exponent", -4.7),
        ("holzapfel_gasser_ogden", "k1", 2e3),
        ("holzapfel_gasser_ogden", "k2", 1.0),
        ("holzapfel_gasser_ogden", "kappa", 0.1),
    ] {
        if of == name {
            law = law.with_number(key, number);
        }
    }
    if name == "holzapfel_gasser_ogden" {
        law = law.with_direction(DVec3::new(1.0, 0.3, 0.2));
    }
    if law.missing().is_some() { LawChoice::typical(law.entry()) } else { law }
}

#[test]
fn every_model_law_and_body_has_its_turn() {
    let draws: Vec<Draw> = (0..200).map(|seed| Draw::of(seed, 4)).collect();
    for kind in ModelKind::ALL {
        let own = || draws.iter().filter(move |draw| draw.kind == kind);
        let can_be_cut = kind.row().edits != FollowedEdits::None;
        assert_eq!(MODELS.contains(&kind), can_be_cut, "{kind} belongs in MODELS when it can be cut");
        assert_eq!(own().next().is_some(), can_be_cut, "{kind}");
        if !can_be_cut {
            continue;
        }
        assert!(own().any(|draw| draw.touches_itself) && own().any(|draw| !draw.touches_itself), "{kind}");
        assert!(own().any(|draw| draw.tears) && own().any(|draw| !draw.tears), "{kind}");
        for law in kind.laws() {
            assert!(own().any(|draw| draw.law_name() == law), "{kind}, {law}");
        }
        for body in 0..4 {
            assert!(own().any(|draw| draw.body == body), "{kind}, body {body}");
        }
    }
    // A bounded share: one seed of each model.
    let first: Vec<ModelKind> = draws[..MODELS.len()].iter().map(|draw| draw.kind).collect();
    assert_eq!(first, MODELS);
    assert_eq!(draws, (0..200).map(|seed| Draw::of(seed, 4)).collect::<Vec<_>>());
}
