//! Numbers of the scene that are turned while it runs, each an input that the session holds.
//!
//! What a hand is takes effect in the next step. For another tissue, other damping or another time step all models are made anew
//! in the background, as for a change of the model, and take over at a step fixed when it was turned; where one cannot be made (its
//! stable step is shorter than the time step, say) all goes on as before, and the reason is told. The rest shape stays what it is:
//! under gravity the stress that carries the weight in it is kept.

use super::Simulation;
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::model::kind::ModelKind;
use glisson::model::{ModelMotion, OrganBody};
use glisson::record::parameter::{Parameter, ParameterOf};
use glisson::record::session::{SessionEvent, out_of_range};
use glisson::scene::{BodyPart, BodySet};
use glisson::world::spec::Hand;
use std::sync::Arc;

/// From a turn to the step at which models take over that are made in a moment [s]: a choice, for a large organ to be made in, too.
const TURN_S: f64 = 0.3;

/// Numbers that were turned and hold as soon as their models are made.
pub(super) struct Turned {
    pub(super) bodies: Arc<BodySet>,
    pub(super) at_step: u64,
}

/// A parameter that is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// Of which body; 0 for what is of no body.
    pub body: usize,
    /// Which one.
    pub parameter: Parameter,
    /// To what, in SI.
    pub value: f64,
}

/// How a parameter stands.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterState {
    /// Which one.
    pub parameter: Parameter,
    /// Of which body; 0 for what is of no body.
    pub body: usize,
    /// What holds now, in SI.
    pub value: f64,
    /// What the scene says.
    pub of_scene: f64,
    /// What will hold in a moment, where that is another value.
    pub coming: Option<f64>,
    /// Why it cannot be turned now, if it cannot.
    pub refusal: Option<String>,
}

/// What can be turned, and the material in words.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// All parameters of all organs, of the hand and of the scene.
    pub list: Vec<ParameterState>,
    /// The material of the first organ.
    pub material: String,
}

impl Simulation {
    /// How all parameters stand.
    pub fn parameters(&self) -> Parameters {
        let material = self.bodies.joint.material_text.clone();
        let mut list = Vec::new();
        for parameter in Parameter::ALL {
            let n_bodies =
                if parameter.of() == ParameterOf::Body { self.bodies.parts.len().max(1) } else { 1 };
            for body in 0..n_bodies {
                let Some(value) = self.value(&self.bodies, parameter, body) else { continue };
                let of_scene = self.value_of_scene(parameter, body).unwrap_or(value);
                let coming =
                    self.turned.as_ref().and_then(|turned| self.value(&turned.bodies, parameter, body));
                let coming = coming.filter(|coming| coming.to_bits() != value.to_bits());
                let refusal = self.refusal(parameter, body);
                list.push(ParameterState { parameter, body, value, of_scene, coming, refusal });
            }
        }
        Parameters { list, material }
    }

    /// Turns a parameter, or tells why not. In a replay the session says at which step it holds.
    pub(crate) fn turn(&mut self, turn: Turn, at_step: Option<u64>) -> anyhow::Result<()> {
        self.guarded(|simulation| simulation.turn_now(turn, at_step))
    }

    fn turn_now(&mut self, turn: Turn, at_step: Option<u64>) -> anyhow::Result<()> {
        let Turn { body, parameter, value } = turn;
        let refuse = |simulation: &mut Self, reason: String| {
            simulation.tell(format!("{parameter} was not turned: {reason}"));
            Ok(())
        };
        if !parameter.range().contains(&value) {
            return refuse(self, out_of_range(parameter, value));
        }
        if let Some(reason) = self.refusal(parameter, body) {
            return refuse(self, reason);
        }
        if parameter.of() == ParameterOf::Surroundings {
            return self.set_gravity_or_after_jerk(self.direction_of_gravity() * value);
        }
        let step = self.world.steps_made();
        let at_step = at_step.unwrap_or_else(|| self.step_of_turn(parameter)).max(step);
        let event = SessionEvent::Turn { step, at_step, body: body as u8, parameter, value };
        if let Some(hand) = self.world.spec().hand
            && parameter.of() == ParameterOf::Hand
        {
            self.record(&event);
            self.world.set_hand(turned_hand(hand, parameter, value));
            return Ok(());
        }
        let mut bodies = BodySet::clone(self.turned.as_ref().map_or(&self.bodies, |turned| &turned.bodies));
        if let Err(reason) = turn_in(&mut bodies, &self.bodies_of_scene, (parameter, body), value) {
            return refuse(self, reason);
        }
        self.record(&event);
        self.turned = Some(Turned { bodies: Arc::new(bodies), at_step });
        let kind = self.world.ordered_model().unwrap_or(self.world.model_kind());
        self.make_in_background(kind, at_step);
        Ok(())
    }

    /// The step at which what is turned now holds.
    fn step_of_turn(&self, parameter: Parameter) -> u64 {
        if parameter.of() == ParameterOf::Hand {
            return 0;
        }
        let kind = self.world.ordered_model().unwrap_or(self.world.model_kind());
        let delay_steps = match kind.row().motion {
            // Their making is the pre-computation.
            ModelMotion::QuasiStatic | ModelMotion::Mixed => self.recomputation_steps(),
            ModelMotion::Explicit | ModelMotion::Implicit => {
                (TURN_S / self.world.spec().time_step_s).ceil() as u64
            }
        };
        self.world.steps_made() + delay_steps
    }

    /// Why a parameter cannot be turned, whatever to.
    fn refusal(&self, parameter: Parameter, body: usize) -> Option<String> {
        if self.task.is_some() {
            return Some("a task is measured with the numbers of its scene".to_owned());
        }
        let known = self.value(&self.bodies, parameter, body);
        if known.is_none() {
            return Some(match parameter.of() {
                ParameterOf::Hand => {
                    "the hands of this scene impose their motion (touch = \"imposed\")".to_owned()
                }
                _ => format!("body {body} is none that deforms"),
            });
        }
        match parameter.of() {
            ParameterOf::Hand | ParameterOf::Surroundings => None,
            ParameterOf::Body => lacks(parameter, self.kind_of(body)?),
            ParameterOf::Scene if self.world.counts_time_in_steps() => Some(
                "loads or force fields of this scene begin or end at times that are counted in its steps"
                    .to_owned(),
            ),
            ParameterOf::Scene if self.is_scripted() => {
                Some("a script leads the instruments by the scene's steps".to_owned())
            }
            ParameterOf::Scene => None,
        }
    }

    /// Where things fall: as they do now, as in the scene, or from the front to the back of a patient who lies on it.
    fn direction_of_gravity(&self) -> DVec3 {
        let known = [self.gravity_m_per_s2(), self.world.spec().gravity_m_per_s2];
        known.into_iter().find_map(DVec3::try_normalize).unwrap_or(DVec3::Y)
    }

    fn is_scripted(&self) -> bool {
        self.script.is_some() && !self.script_is_over()
    }

    /// The model of a body; none of a rigid one.
    fn kind_of(&self, body: usize) -> Option<ModelKind> {
        match self.bodies.parts.get(body) {
            Some(BodyPart::Organ { kind, .. }) if body > 0 => Some(*kind),
            Some(BodyPart::Rigid { .. }) => None,
            _ => Some(self.world.ordered_model().unwrap_or(self.world.model_kind())),
        }
    }

    fn value(&self, bodies: &BodySet, parameter: Parameter, body: usize) -> Option<f64> {
        match parameter.of() {
            ParameterOf::Hand => Some(value_of_hand(&self.world.spec().hand?, parameter)),
            ParameterOf::Scene => Some(bodies.joint.time_step_s),
            ParameterOf::Surroundings => Some(self.gravity_m_per_s2().length()),
            ParameterOf::Body => value_of_body(organ_in(bodies, body)?, parameter),
        }
    }

    fn value_of_scene(&self, parameter: Parameter, body: usize) -> Option<f64> {
        match parameter.of() {
            ParameterOf::Hand => Some(value_of_hand(&self.hand_of_scene?, parameter)),
            ParameterOf::Surroundings => Some(self.world.spec().gravity_m_per_s2.length()),
            ParameterOf::Scene | ParameterOf::Body => self.value(&self.bodies_of_scene, parameter, body),
        }
    }
}

/// What a model has no use for.
fn lacks(parameter: Parameter, kind: ModelKind) -> Option<String> {
    let is_damping = matches!(parameter, Parameter::MassDamping | Parameter::StiffnessDamping);
    if is_damping && kind.row().motion == ModelMotion::QuasiStatic {
        return Some(format!("the {kind} model goes to its equilibrium in every step and has no damping"));
    }
    if parameter == Parameter::PoissonRatio && kind == ModelKind::MassSpring {
        return Some("the springs of the mass_spring model have no Poisson's ratio".to_owned());
    }
    None
}

fn organ_in(bodies: &BodySet, body: usize) -> Option<&OrganBody> {
    match bodies.parts.get(body) {
        Some(BodyPart::Organ { body, .. }) => Some(body),
        Some(BodyPart::Rigid { .. }) => None,
        None => (bodies.parts.is_empty() && body == 0).then_some(&bodies.joint),
    }
}

fn value_of_body(body: &OrganBody, parameter: Parameter) -> Option<f64> {
    match parameter {
        Parameter::YoungModulus => Some(body.material.young_modulus_pa()),
        Parameter::PoissonRatio => Some(body.material.poisson_ratio()),
        Parameter::MassDamping => Some(body.damping.mass_per_s),
        Parameter::StiffnessDamping => Some(body.damping.stiffness_s),
        _ => None,
    }
}

fn value_of_hand(hand: &Hand, parameter: Parameter) -> f64 {
    match parameter {
        Parameter::HandReturnTime => hand.return_time_s,
        Parameter::HandGreatestForce => hand.greatest_force_n,
        _ => hand.stiffness_n_per_m,
    }
}

fn turned_hand(hand: Hand, parameter: Parameter, value: f64) -> Hand {
    match parameter {
        Parameter::HandReturnTime => Hand { return_time_s: value, ..hand },
        Parameter::HandGreatestForce => Hand { greatest_force_n: value, ..hand },
        _ => Hand { stiffness_n_per_m: value, ..hand },
    }
}

/// Turns a number of `bodies`, or says why it cannot be.
fn turn_in(
    bodies: &mut BodySet,
    of_scene: &BodySet,
    (parameter, number): (Parameter, usize),
    value: f64,
) -> Result<(), String> {
    let is_scene = parameter.of() == ParameterOf::Scene;
    for (place, part) in bodies.parts.iter_mut().enumerate() {
        if let BodyPart::Organ { body, .. } = part
            && (is_scene || place == number)
        {
            turn_body(body, organ_in(of_scene, place), parameter, value)?;
        }
    }
    // Of several bodies it stands for the first one.
    if is_scene || number == 0 {
        let saved = if bodies.parts.is_empty() { organ_in(of_scene, 0) } else { None };
        turn_body(&mut bodies.joint, saved, parameter, value)?;
    }
    Ok(())
}

fn turn_body(
    body: &mut OrganBody,
    of_scene: Option<&OrganBody>,
    parameter: Parameter,
    value: f64,
) -> Result<(), String> {
    let (old, mut young_modulus_pa, mut poisson_ratio) =
        (body.material, body.material.young_modulus_pa(), body.material.poisson_ratio());
    match parameter {
        Parameter::YoungModulus => young_modulus_pa = value,
        Parameter::PoissonRatio => poisson_ratio = value,
        Parameter::MassDamping => body.damping.mass_per_s = value,
        Parameter::StiffnessDamping => body.damping.stiffness_s = value,
        _ => body.time_step_s = value,
    }
    if matches!(parameter, Parameter::YoungModulus | Parameter::PoissonRatio) {
        let material =
            LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, old.density_kg_per_m3());
        body.set_material(material.map_err(|error| error.to_string())?);
        // A saved pre-computation is one of the scene's tissue.
        body.precomputed = of_scene
            .filter(|saved| saved.material == body.material)
            .and_then(|saved| saved.precomputed.clone());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OpenScene;
    use crate::replay::replay;
    use glisson::mesh::TetId;
    use glisson::model::StateHash;
    use glisson::record::session::parse_session;
    use glisson::tool::ToolInput;
    use glisson::world::StepInput;
    use std::path::Path;

    const SCENE: &str = "glisson_scene = 1\n[simulation]\ntime_step = \"1 ms\"\n[organ]\nbox = { min = [0, 0, 0], \
        max = [\"40 mm\", \"30 mm\", \"20 mm\"] }\nedge = \"12 mm\"\nyoung_modulus = \"5 kPa\"\npoisson_ratio = 0.4\n\
        density = \"1000 kg/m3\"\nmodel = \"MODEL\"\nEXTRA\n[[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.2 }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"20 mm\", \"15 mm\", \"40 mm\"]\nhome_shaft = [0, 0, 1]\n";

    fn scene(model: ModelKind) -> String {
        let damping =
            if model.row().motion == ModelMotion::QuasiStatic { "" } else { "damping = \"30 1/s\"" };
        SCENE.replace("MODEL", model.name()).replace("EXTRA", damping)
    }

    fn open(text: &str, folder: &Path) -> Simulation {
        let scene = glisson::scene::Scene::parse(text).unwrap();
        let source = OpenScene { scene, folder: folder.to_path_buf(), origin: "test".into(), n_threads: 1 };
        Simulation::open(source, Some(&folder.join("session.jsonl"))).unwrap()
    }

    /// The tip goes 3 mm into the body and stays there.
    fn press(step: u64) -> StepInput {
        let z_m = (0.040 - 1e-4 * step as f64).max(0.022);
        StepInput::of(&[ToolInput::at(DVec3::new(0.02, 0.015, z_m), DVec3::Z)])
    }

    fn replayed(folder: &Path) -> (StateHash, Option<u64>) {
        let session = parse_session(&std::fs::read_to_string(folder.join("session.jsonl")).unwrap()).unwrap();
        let report = replay(&session, folder, |_| Ok(())).unwrap();
        (report.state_hash, report.first_difference)
    }

    fn force_n(simulation: &mut Simulation, n_steps: u64) -> f64 {
        for _ in 0..n_steps {
            let step = simulation.world().steps_made();
            simulation.advance(&press(step)).unwrap();
        }
        simulation.world().report().tools[0].force_on_tool_n.length()
    }

    fn to(body: usize, parameter: Parameter, value: f64) -> Turn {
        Turn { body, parameter, value }
    }

    /// The models that need no measured curves.
    fn models() -> impl Iterator<Item = ModelKind> {
        ModelKind::ALL.into_iter().filter(|kind| !kind.row().follows_curves)
    }

    #[test]
    fn every_model_takes_softer_tissue_pushes_less_and_replays_to_the_same_bits() {
        for kind in models() {
            let folder = tempfile::tempdir().unwrap();
            let mut simulation = open(&scene(kind), folder.path());
            let before_n = force_n(&mut simulation, 800);
            let step = simulation.world().steps_made();
            simulation.turn(to(0, Parameter::YoungModulus, 2_500.0), Some(step + 10)).unwrap();
            let coming = simulation.parameters().list[0].clone();
            assert_eq!((coming.value, coming.of_scene, coming.coming), (5_000.0, 5_000.0, Some(2_500.0)));
            let after_n = force_n(&mut simulation, 800);
            assert!(simulation.notices().is_empty(), "{kind}: {:?}", simulation.notices());
            let Parameters { list, material } = simulation.parameters();
            assert_eq!((list[0].value, list[0].coming), (2_500.0, None), "{kind}");
            assert!(material.contains("E 2.5 kPa"), "{material}");
            // Half as stiff; springs and non-linear laws in proportion, too, but for how fast they settle.
            let share = after_n / before_n;
            assert!((0.42..0.58).contains(&share), "{kind}: {before_n} N, then {after_n} N");
            simulation.turn(to(0, Parameter::HandGreatestForce, 0.05), None).unwrap();
            let given_way_n = force_n(&mut simulation, 200);
            assert!(given_way_n < 0.051, "{kind}: {given_way_n} N");
            let hash = simulation.finish().unwrap();
            assert_eq!(replayed(folder.path()), (hash, None), "{kind}");
        }
    }

    #[test]
    fn what_a_model_cannot_follow_is_refused_with_the_reason_and_changes_nothing() {
        for kind in models() {
            let folder = tempfile::tempdir().unwrap();
            let mut simulation = open(&scene(kind), folder.path());
            let before = simulation.parameters().list[0].value;
            let step = simulation.world().steps_made();
            // Ten thousand times as stiff as soft tissue: explicit steps of 1 ms are far too long.
            simulation.turn(to(0, Parameter::YoungModulus, 1e7), Some(step + 5)).unwrap();
            let calm_n = force_n(&mut simulation, 30);
            assert!(calm_n.is_finite() && simulation.broken().is_none(), "{kind}");
            let refused = kind.row().motion == ModelMotion::Explicit;
            let told = simulation.notices().first().map(|notice| notice.text.clone());
            assert_eq!(told.is_some(), refused, "{kind}: {told:?}");
            if let Some(told) = told {
                assert!(told.contains("stable") && told.ends_with("the numbers stay as they were"), "{told}");
            }
            let now = simulation.parameters().list[0].value;
            assert_eq!(now, if refused { before } else { 1e7 }, "{kind}");
            let refusals: Vec<String> =
                simulation.parameters().list.into_iter().filter_map(|state| state.refusal).collect();
            let is_quasi_static = kind.row().motion == ModelMotion::QuasiStatic;
            let expected = 2 * usize::from(is_quasi_static) + usize::from(kind == ModelKind::MassSpring);
            assert_eq!(refusals.len(), expected, "{kind}: {refusals:?}");
            let hash = simulation.finish().unwrap();
            assert_eq!(replayed(folder.path()), (hash, None), "{kind}");
        }
    }

    #[test]
    fn a_cut_that_is_undone_before_the_turn_holds_does_not_lose_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut simulation = open(&scene(ModelKind::Implicit), folder.path());
        force_n(&mut simulation, 50);
        simulation.turn(to(0, Parameter::MassDamping, 90.0), Some(60)).unwrap();
        simulation.remove_tetrahedra(vec![TetId(0)]).unwrap();
        force_n(&mut simulation, 5);
        simulation.undo_edit().unwrap();
        force_n(&mut simulation, 20);
        let damping = |simulation: &Simulation| {
            simulation.parameters().list.iter().find(|s| s.parameter == Parameter::MassDamping).unwrap().value
        };
        assert_eq!(damping(&simulation), 90.0);
        simulation.remove_tetrahedra(vec![TetId(1)]).unwrap();
        simulation.turn(to(0, Parameter::YoungModulus, 8_000.0), Some(90)).unwrap();
        force_n(&mut simulation, 60);
        simulation.reset().unwrap();
        force_n(&mut simulation, 60);
        assert_eq!((damping(&simulation), simulation.parameters().list[0].value), (90.0, 8_000.0));
        assert!(simulation.notices().is_empty(), "{:?}", simulation.notices());
        let hash = simulation.finish().unwrap();
        assert_eq!(replayed(folder.path()), (hash, None));
    }

    #[test]
    fn another_time_step_goes_on_from_the_time_that_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let mut simulation = open(&scene(ModelKind::Implicit), folder.path());
        force_n(&mut simulation, 100);
        simulation.turn(to(0, Parameter::TimeStep, 0.005), Some(150)).unwrap();
        force_n(&mut simulation, 70);
        assert_eq!(simulation.world().spec().time_step_s, 0.005);
        assert!((simulation.world().time_s() - (0.150 + 20.0 * 0.005)).abs() < 1e-12);
        let hash = simulation.finish().unwrap();
        assert_eq!(replayed(folder.path()), (hash, None));
    }

    #[test]
    fn one_of_several_bodies_is_turned_and_what_cannot_be_is_told() {
        let text = "glisson_scene = 1\n[[organ]]\nname = \"a\"\nbox = { min = [0, 0, 0], max = [\"40 mm\", \"30 mm\", \"20 mm\"] }\n\
            edge = \"12 mm\"\ntissue = \"liver\"\nmodel = \"implicit\"\n[[organ.fixed]]\n\
            furthest = { direction = [0, 0, -1], fraction = 0.2 }\n\
            [[organ]]\nname = \"b\"\nbox = { min = [\"60 mm\", 0, 0], max = [\"90 mm\", \"30 mm\", \"20 mm\"] }\n\
            edge = \"12 mm\"\nyoung_modulus = \"4 kPa\"\npoisson_ratio = 0.4\ndensity = \"1000 kg/m3\"\nmodel = \"implicit\"\n\
            [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.2 }\n\
            [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"20 mm\", \"15 mm\", \"40 mm\"]\nhome_shaft = [0, 0, 1]\n";
        let folder = tempfile::tempdir().unwrap();
        let mut simulation = open(text, folder.path());
        simulation.turn(to(1, Parameter::YoungModulus, 6_000.0), Some(5)).unwrap();
        simulation.turn(to(7, Parameter::YoungModulus, 6_000.0), Some(5)).unwrap();
        simulation.turn(to(0, Parameter::PoissonRatio, 0.5), Some(5)).unwrap();
        force_n(&mut simulation, 10);
        let young: Vec<f64> = simulation.parameters().list.iter().take(2).map(|state| state.value).collect();
        assert_eq!(young[1], 6_000.0);
        assert_ne!(young[0], 6_000.0);
        assert_eq!(simulation.world().spec().bodies[1].tissue.unwrap().young_modulus_pa(), 6_000.0);
        let told: Vec<&str> = simulation.notices().iter().map(|notice| notice.text.as_str()).collect();
        assert!(told.len() == 2 && told[0].contains("body 7") && told[1].contains("0 to 0.499"), "{told:?}");
        let hash = simulation.finish().unwrap();
        assert_eq!(replayed(folder.path()), (hash, None));
    }

    #[test]
    fn in_a_task_nothing_is_turned() {
        let folder = tempfile::tempdir().unwrap();
        let text = scene(ModelKind::Implicit)
            + "[task]\ntitle = \"t\"\n[[task.stage]]\ntitle = \"touch\"\ntouch = {}\n";
        let mut simulation = open(&text, folder.path());
        simulation.turn(to(0, Parameter::HandStiffness, 100.0), None).unwrap();
        assert!(simulation.notices()[0].text.contains("a task is measured"), "{:?}", simulation.notices());
        assert!(simulation.parameters().list.iter().all(|state| state.refusal.is_some()));
    }
}
