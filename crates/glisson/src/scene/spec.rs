//! What a scene file says.

use super::attachment::{AttachmentSource, read_attachment};
use super::bodies::{BodySections, BodySource, SceneBodies, SceneBody};
use super::contact::{read_body_contact, read_contact};
use super::hand::read_hand;
use super::instrument::{
    CutRules, InstrumentSource, PathPoint, embeds, read_tool, tool_on_path, tool_sections,
};
use super::organ::OrganSource;
use super::place::{patient_of, read_places};
use super::reader::{SceneError, Section, parse_toml};
use super::shape::BodyShape;
use super::simulation::read_simulation;
use super::suture::read_sutures;
use super::task::{TaskScene, TaskSource, read_task};
use crate::record::session::{
    FIRST_VERSION_WITH_EMBEDDED_CUTS, FIRST_VERSION_WITH_HAND, FIRST_VERSION_WITH_PARTING_SCISSORS,
    SessionHeader,
};
use crate::tool::{BladeCuts, MAX_TOOLS};
use crate::world::StepInput;
use crate::world::spec::{Hand, WorldSpec};
use std::path::PathBuf;

/// A scene as its file says.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The world without its mesh and model.
    pub world: WorldSpec,
    /// The organ; of several bodies the first organ.
    pub organ: OrganSource,
    /// Several bodies, the organs first; none for one organ alone.
    pub bodies: Vec<SceneBody>,
    /// What ties them to each other.
    pub attachments: Vec<AttachmentSource>,
    /// Into how many internal steps a step may be divided after an edit.
    pub most_parts: u32,
    /// Scripted motion of each tool, ascending in time; empty for one that somebody holds.
    pub paths: Vec<Vec<PathPoint>>,
    /// Surface file of each tool's tip, relative to the scene's folder; none for a ball.
    pub tool_shapes: Vec<Option<PathBuf>>,
    /// What somebody who trains has to do in it.
    pub task: Option<TaskSource>,
    /// The file's text, for the session.
    pub text: String,
}

/// The only version of scene files so far.
const SCENE_VERSION: f64 = 1.0;

/// What holds where a scene says nothing.
struct Defaults {
    hand: Option<Hand>,
    blade_cuts: BladeCuts,
    /// Whether scissors part tissue, organs become what `when_cut` says, and instruments that no organ follows are refused.
    all_cuts_part: bool,
}

impl Scene {
    /// Reads a scene.
    ///
    /// # Errors
    /// [`SceneError`] with the line of the first mistake.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        let (hand, blade_cuts) = (Some(Hand::default()), BladeCuts::Embedded);
        Self::parse_with(text, &Defaults { hand, blade_cuts, all_cuts_part: true })
    }

    /// Reads the scene of a recorded session, as it was understood when the session was recorded: before
    /// [`FIRST_VERSION_WITH_HAND`] instruments of scenes that say nothing of a hand imposed their motion, and before
    /// [`FIRST_VERSION_WITH_EMBEDDED_CUTS`] blades divided tetrahedra; before [`FIRST_VERSION_WITH_PARTING_SCISSORS`] scissors took
    /// whole ones, and a pre-computed organ stayed one.
    ///
    /// # Errors
    /// [`SceneError`] with the line of the first mistake.
    pub fn parse_recorded(header: &SessionHeader) -> Result<Self, SceneError> {
        let hand = (header.version >= FIRST_VERSION_WITH_HAND).then(Hand::default);
        let is_embedded = header.version >= FIRST_VERSION_WITH_EMBEDDED_CUTS;
        let blade_cuts = if is_embedded { BladeCuts::Embedded } else { BladeCuts::Subdivision };
        let all_cuts_part = header.version >= FIRST_VERSION_WITH_PARTING_SCISSORS;
        Self::parse_with(&header.scene, &Defaults { hand, blade_cuts, all_cuts_part })
    }

    fn parse_with(text: &str, defaults: &Defaults) -> Result<Self, SceneError> {
        let document = parse_toml(text)?;
        let mut root = Section::root(text, &document);
        check_version(&mut root)?;
        let places = root.sections("place")?;
        let places = read_places(places, patient_of(&root)?)?;
        let has_seed = root.value_at(&["organ", "phantom", "seed"]).is_some();
        root.know_places(places);
        let name = root.string("name")?.map_or_else(|| "unnamed scene".to_string(), |n| n.0);
        let simulation = root.section("simulation")?;
        let contact = root.section("contact")?;
        let hand = root.section("hand")?;
        let bodies = BodySections::of(&mut root)?;
        let tied = root.sections("attachment")?;
        let sewn = root.sections("suture")?;
        let tools = tool_sections(&mut root)?;
        let task = root.section("task")?;
        root.finish()?;

        let simulation = read_simulation(simulation)?;
        let SceneBodies { mut organ, surroundings, bodies } = bodies.read()?;
        let time_step_s = simulation.time_step_s;
        let (mut self_contact, mut body_contact) = (None, None);
        if bodies.is_empty() {
            let read = |section| read_contact(section, organ.model, time_step_s);
            self_contact = contact.map(read).transpose()?.flatten();
        } else {
            body_contact = read_body_contact(contact, &bodies, &simulation)?;
        }
        let mut attachments = Vec::new();
        for section in tied {
            if bodies.is_empty() {
                let allowed = "two bodies; of one organ to its surroundings: [[organ.ligament]]".into();
                return Err(section.wrong_table("attachment", "of one organ".into(), allowed));
            }
            attachments.push(read_attachment(section, &bodies)?);
        }
        let mut cuts = CutRules::of(&organ, &bodies, (defaults.blade_cuts, defaults.all_cuts_part));
        let mut sources = Vec::new();
        for section in tools {
            let source = read_tool(section, &cuts)?;
            cuts.learn(&source);
            sources.push(source);
        }
        let (mut scripted, mut tool_shapes, mut paths) = (Vec::new(), Vec::new(), Vec::new());
        for mut source in sources {
            cuts.complete(&mut source);
            let InstrumentSource { tool, path, shape, .. } = source;
            scripted.push(tool);
            paths.push(path);
            tool_shapes.push(shape);
        }
        if defaults.all_cuts_part
            && bodies.is_empty()
            && scripted.iter().any(|tool| embeds(&tool.kind).is_some())
        {
            organ.expect_blades();
        }
        let world = WorldSpec {
            name,
            time_step_s: simulation.time_step_s,
            gravity_m_per_s2: simulation.gravity_m_per_s2,
            supports: surroundings.supports,
            ligaments: surroundings.ligaments,
            loads: surroundings.loads,
            fields: surroundings.fields,
            // Its material comes with the mesh.
            tearing: None,
            mends_cuts: organ.mends_cuts,
            hand: hand.map_or(Ok(defaults.hand), read_hand)?,
            tissue: None,
            self_contact,
            // Their nodes come with their meshes.
            bodies: Vec::new(),
            body_contact,
            bonds: Vec::new(),
            vessels: Vec::new(),
            sutures: read_sutures(sewn)?,
            tools: scripted,
        };
        let around = TaskScene { tools: &world.tools, bodies: &bodies, has_seed };
        let task = task.map(|task| read_task(task, &around)).transpose()?;
        let (most_parts, text) = (simulation.most_parts, text.to_string());
        Ok(Self { world, organ, bodies, attachments, most_parts, paths, tool_shapes, task, text })
    }

    /// Its organs, in their order.
    pub fn organs(&self) -> impl Iterator<Item = &OrganSource> {
        let several = self.bodies.iter().filter_map(|body| match &body.source {
            BodySource::Organ(organ, _) => Some(&**organ),
            BodySource::Rigid(_) => None,
        });
        let only = self.bodies.is_empty().then_some(&self.organ);
        only.into_iter().chain(several)
    }

    /// The synthetic patient that its first organ is of, if it is of one.
    pub fn patient(&self) -> Option<u32> {
        match &self.organ.shape.shape {
            BodyShape::Phantom(organ) => u32::try_from(organ.seed).ok(),
            _ => None,
        }
    }

    /// Whether the cuts of its instruments are embedded.
    pub fn embeds_cuts(&self) -> bool {
        self.world.tools.iter().any(|tool| embeds(&tool.kind) == Some(true))
    }

    /// What the scripted tools do at `time_s`; the others stay at home.
    pub fn input_at(&self, time_s: f64) -> StepInput {
        let mut tools = [self.world.tools[0].home; MAX_TOOLS];
        for (input, (tool, path)) in tools.iter_mut().zip(self.world.tools.iter().zip(&self.paths)) {
            *input = tool_on_path(tool.home, path, time_s);
        }
        StepInput::of(&tools)
    }

    /// Scripted tools that set a clip after `from_s` and not after `to_s`.
    pub fn clips_between(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = usize> + '_ {
        let is_due =
            move |point: &PathPoint| point.sets_clip && from_s < point.time_s && point.time_s <= to_s;
        self.paths.iter().enumerate().filter(move |(_, path)| path.iter().any(is_due)).map(|(tool, _)| tool)
    }

    /// When the last scripted motion ends [s]; none without one.
    pub fn end_of_paths_s(&self) -> Option<f64> {
        self.paths.iter().filter_map(|path| path.last()).map(|point| point.time_s).reduce(f64::max)
    }
}

/// Whether the scene is written in the version that is read here.
fn check_version(root: &mut Section<'_>) -> Result<(), SceneError> {
    match root.number("glisson_scene")? {
        Some((version, _)) if version == SCENE_VERSION => Ok(()),
        Some((version, at)) => Err(root.wrong_value(at, "glisson_scene", version.to_string(), "1")),
        None => Err(root.missing("glisson_scene", "glisson_scene = 1")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::material::MaterialSource;
    use super::*;
    use crate::material::law_named;
    use crate::math::DVec3;
    use crate::tool::{Burnt, Snip, ToolKind};
    use crate::world::spec::LoadTime;
    use proptest::prelude::*;

    pub(super) const SCENE: &str = r#"glisson_scene = 1
name = "Palpation"

[simulation]
time_step = "1 ms"

[organ]
mesh = "liver.vtu"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1060 kg/m3"
model = "tensor_mass"
damping = "20 1/s"

[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.1 }

[[organ.fixed]]
box = { min = ["0 mm", "0 mm", "0 mm"], max = ["1 cm", "1 cm", "1 cm"] }

[tool]
tip_radius = "6 mm"
home_tip = ["0 mm", "-200 mm", "0 mm"]
home_shaft = [0, -2, 0]

[[tool.path]]
time = "1 s"
tip = ["0 mm", "-100 mm", "0 mm"]
"#;

    #[test]
    fn a_scene_is_read_into_si() {
        let scene = Scene::parse(SCENE).unwrap();
        assert_eq!(scene.world.time_step_s, 1e-3);
        assert_eq!(scene.organ.damping.mass_per_s, 20.0);
        assert_eq!(scene.world.supports.len(), 2);
        let tool = &scene.world.tools[0];
        assert_eq!((tool.tip_radius_m, tool.kind, tool.grip.is_sticky), (6.0 * 1e-3, ToolKind::PROBE, true));
        assert_eq!(tool.home.shaft_in_world, DVec3::new(0.0, -1.0, 0.0));
        let halfway = scene.input_at(0.5).tools[0];
        assert!((halfway.tip_in_world_m.y + 0.15).abs() < 1e-15);
        assert_eq!(scene.input_at(9.0).tools[0], scene.paths[0][0].tool);
    }

    #[test]
    fn several_instruments_are_read_each_with_its_kind_and_path() {
        let grasper = r#"
[[tool]]
kind = "grasper"
tip_radius = "1.5 mm"
jaw_length = "15 mm"
closing_force = "8 N"
friction = 0.4
trocar = ["80 mm", "-150 mm", "0 mm"]
home_tip = ["60 mm", "-100 mm", "0 mm"]
home_jaw = 1

[[tool.path]]
time = "0.5 s"
tip = ["40 mm", "-90 mm", "0 mm"]
roll = "90 deg"
jaw = 0
trigger = 1
"#;
        let two = SCENE.replace("[tool]", "[[tool]]") + grasper;
        let scene = Scene::parse(&two).unwrap();
        assert_eq!((scene.world.tools.len(), scene.paths[0].len(), scene.paths[1].len()), (2, 1, 1));
        let tool = &scene.world.tools[1];
        let jaws = tool.kind.jaws().unwrap();
        assert_eq!((tool.kind.name(), tool.kind.holds()), ("grasper", true));
        assert_eq!((jaws.length_m, jaws.closing_force_n), (0.015, 8.0));
        assert_eq!((tool.grip.is_sticky, tool.grip.friction_coefficient), (false, 0.4));
        let to_trocar = (tool.trocar_m.unwrap() - tool.home.tip_in_world_m).normalize();
        assert!(tool.home.shaft_in_world.distance(to_trocar) < 1e-15 && tool.home.jaw_opening == 1.0);
        let half = scene.input_at(0.25).tools[1];
        assert!((half.jaw_opening - 0.5).abs() < 1e-15 && (half.trigger - 0.5).abs() < 1e-15);
        assert!((half.roll_rad - std::f64::consts::FRAC_PI_4).abs() < 1e-15);
        assert_eq!(scene.end_of_paths_s(), Some(1.0));

        let message = |text: &str| Scene::parse(text).unwrap_err().to_string();
        let allowed = "\"kind\" is \"grabber\"; allowed: probe, grasper, scissors, scalpel, hook, cautery, clipper, endoscope, suction";
        assert!(message(&two.replace("\"grasper\"", "\"grabber\"")).contains(allowed));
        assert!(message(&two.replace("home_jaw = 1", "home_jaw = 2")).contains("between 0 and 1"));
        assert!(message(&two.replace("\"grasper\"", "\"probe\"")).contains("unknown key"));
        // The lever of a suction tube is let go unless its table says otherwise; it has no jaws.
        let suction = two.replace("\"grasper\"", "\"suction\"");
        assert!(message(&suction).contains("unknown key"));
        let plain = |line: &&str| !["jaw_", "closing_", "home_jaw"].iter().any(|key| line.starts_with(key));
        let suction: String = suction.lines().filter(plain).map(|line| line.to_owned() + "\n").collect();
        let home = |text: &str| Scene::parse(text).unwrap().world.tools[1].home.jaw_opening;
        assert_eq!(
            [&suction, &suction.replace("home_tip", "home_jaw = 0.25\nhome_tip")].map(|text| home(text)),
            [1.0, 0.25]
        );
        let six = two.clone() + &grasper.repeat(4);
        assert!(message(&six).contains("6 instruments; allowed: 1 to 5"), "{}", message(&six));
    }

    #[test]
    fn endoscopes_have_a_lens() {
        let base = SCENE.replace("[tool]", "[[tool]]")
            + "\n[[tool]]\nkind = \"endoscope\"\ntip_radius = \"5 mm\"\nhome_tip = [\"0 mm\", \"0 mm\", \"0 mm\"]\nhome_shaft = [0, 0, 1]\n";
        let lens = |text: &str| {
            let tool = Scene::parse(text).unwrap().world.tools[1].clone();
            assert!(!tool.grip.is_sticky && tool.kind.name() == "endoscope");
            let optics = *tool.kind.optics().unwrap();
            [optics.view_angle_rad, optics.field_of_view_rad].map(f64::to_degrees)
        };
        let close = |[a, b]: [f64; 2], [c, d]: [f64; 2]| (a - c).abs() < 1e-9 && (b - d).abs() < 1e-9;
        assert!(close(lens(&base), [30.0, 70.0]));
        let said = base.clone() + "view_angle = \"90 deg\"\nfield_of_view = \"20 deg\"\n";
        assert!(close(lens(&said), [90.0, 20.0]));
        let message = |text: &str| Scene::parse(text).unwrap_err().to_string();
        let wrong = message(&said.replace("\"90 deg\"", "\"-5 deg\""));
        assert!(wrong.contains("\"view_angle\" is -5.000 deg; allowed: 0 to 90 deg"), "{wrong}");
        let wrong = message(&said.replace("\"20 deg\"", "\"130 deg\""));
        assert!(wrong.contains("\"field_of_view\" is 130.000 deg; allowed: 20 to 120 deg"), "{wrong}");
        let wrong = message(&said.replace("\"endoscope\"", "\"probe\""));
        assert!(wrong.contains("unknown key"), "{wrong}");
    }

    #[test]
    fn hot_tips_sweep_where_cuts_are_embedded() {
        let hook = "[[tool]]\nkind = \"hook\"\ntip_radius = \"2 mm\"\nhome_tip = [\"0 mm\", \"0 mm\", \"0 mm\"]\nhome_shaft = [0, 0, 1]\n";
        let base = SCENE.replace("[tool]", "[[tool]]") + "\n" + hook;
        let takes = |text: &str| {
            let scene = Scene::parse(text).unwrap();
            (scene.world.tools[1].kind.burning().unwrap().takes, scene.embeds_cuts())
        };
        assert_eq!(takes(&base), (Burnt::Tetrahedra, false));
        let swept = base.clone() + "burns = \"swept\"\n";
        assert_eq!(takes(&swept), (Burnt::Swept { depth_m: 5e-4 }, true));
        let deeper = swept.clone() + "burn_depth = \"1 mm\"\n";
        assert_eq!(takes(&deeper), (Burnt::Swept { depth_m: 1e-3 }, true));
        let message = |text: &str| Scene::parse(text).unwrap_err().to_string();
        assert!(message(&(base.clone() + "burns = \"sweeps\"\n")).contains("tetrahedra, swept"));
        assert!(message(&(base + "burn_depth = \"1 mm\"\n")).contains("unknown key"));
        let divides = hook.replace("\"hook\"", "\"scalpel\"") + "blade_cuts = \"subdivision\"\n";
        let mixed = message(&(swept.clone() + &divides));
        assert!(mixed.contains("burns = \"swept\""), "{mixed}");
        let embedded = swept + &divides.replace("subdivision", "embedded");
        assert!(Scene::parse(&embedded).unwrap().embeds_cuts());
    }

    #[test]
    fn scissors_part_as_the_scenes_blades_cut() {
        let scissors = "[[tool]]\nkind = \"scissors\"\ntip_radius = \"2 mm\"\nhome_tip = [\"0 mm\", \"0 mm\", \"0 mm\"]\nhome_shaft = [0, 0, 1]\n";
        let scalpel = |cuts: &str| {
            let blade = scissors.replace("scissors", "scalpel");
            format!("{}\n{blade}blade_cuts = \"{cuts}\"\n", SCENE.replace("[tool]", "[[tool]]"))
        };
        let snip = |scene: &Scene| scene.world.tools.last().unwrap().kind.parting_jaws().unwrap().1;
        let of = |text: &str| Scene::parse(text).map(|scene| snip(&scene));
        let alone = SCENE.replace("[tool]", "[[tool]]") + "\n" + scissors;
        assert_eq!(of(&alone).unwrap(), Snip::Embedded);
        assert!(Scene::parse(&alone).unwrap().embeds_cuts());
        for (cuts, expected) in [
            ("embedded", Snip::Embedded),
            ("subdivision", Snip::Subdivision),
            ("displacement", Snip::Tetrahedra),
        ] {
            assert_eq!(of(&(scalpel(cuts) + scissors)).unwrap(), expected);
            // In either order.
            let first = scalpel(cuts).replacen("[[tool]]", &format!("{scissors}[[tool]]"), 1);
            let kinds = Scene::parse(&first).unwrap().world.tools;
            assert_eq!(kinds[0].kind.parting_jaws().unwrap().1, expected);
        }
        let whole = alone.clone() + "blade_cuts = \"tetrahedra\"\n";
        assert_eq!(of(&whole).unwrap(), Snip::Tetrahedra);
        let mixed =
            of(&(scalpel("subdivision") + scissors + "blade_cuts = \"embedded\"\n")).unwrap_err().to_string();
        assert!(mixed.contains("for none: subdivision or tetrahedra"), "{mixed}");
        let moved = of(&(alone.clone() + "blade_cuts = \"displacement\"\n")).unwrap_err().to_string();
        assert!(moved.contains("allowed: embedded, subdivision, tetrahedra"), "{moved}");
        // Sessions from before take whole tetrahedra.
        let mut header = SessionHeader::new(alone, String::new());
        assert_eq!(snip(&Scene::parse_recorded(&header).unwrap()), Snip::Embedded);
        header.version = FIRST_VERSION_WITH_PARTING_SCISSORS - 1;
        let before = Scene::parse_recorded(&header).unwrap();
        assert_eq!((snip(&before), before.embeds_cuts()), (Snip::Tetrahedra, false));
    }

    #[test]
    fn organs_become_what_cuts_make_of_them_or_refuse_the_instruments() {
        use crate::model::Rayleigh;
        use crate::model::kind::ModelKind;
        let organ = |keys: &str| {
            SCENE
                .replace("model = \"tensor_mass\"\ndamping = \"20 1/s\"\n", keys)
                .replace("[tool]", "[[tool]]")
        };
        let with = |keys: &str, kind: &str, more: &str| {
            let home =
                "tip_radius = \"2 mm\"\nhome_tip = [\"0 mm\", \"0 mm\", \"0 mm\"]\nhome_shaft = [0, 0, 1]\n";
            format!("{}\n[[tool]]\nkind = \"{kind}\"\n{home}{more}\n", organ(keys))
        };
        let (pre, removal) =
            ("model = \"precomputed\"\n", "model = \"precomputed\"\nwhen_cut = \"removal\"\n");
        let saved = "model = \"precomputed\"\nprecomputed = \"liver.precomputed\"\n";
        let (whole, swept) = ("blade_cuts = \"tetrahedra\"", "burns = \"swept\"");
        for (keys, kind, more, expected) in [
            (pre, "scalpel", "", ModelKind::Hybrid),
            (pre, "scalpel", "blade_cuts = \"subdivision\"", ModelKind::Hybrid),
            (pre, "scissors", "", ModelKind::Hybrid),
            (pre, "hook", swept, ModelKind::Hybrid),
            (pre, "hook", "", ModelKind::Precomputed),
            (pre, "scissors", whole, ModelKind::Precomputed),
            (pre, "grasper", "", ModelKind::Precomputed),
            (removal, "hook", swept, ModelKind::Precomputed),
            (removal, "scissors", "", ModelKind::Precomputed),
            (saved, "hook", "", ModelKind::Precomputed),
        ] {
            let found = Scene::parse(&with(keys, kind, more)).unwrap().organ;
            assert_eq!(found.model, expected, "{keys}{kind} {more}");
            let is_hybrid = expected == ModelKind::Hybrid;
            let damping = if is_hybrid { Rayleigh::of_mass(20.0) } else { Rayleigh::default() };
            assert_eq!(found.damping, damping, "{keys}{kind} {more}");
        }
        let own = Scene::parse(&with(&(pre.to_owned() + "damping = \"7 1/s\"\n"), "scalpel", "")).unwrap();
        assert_eq!(own.organ.damping, Rayleigh::of_mass(7.0));
        let message = |text: &str| Scene::parse(text).unwrap_err().to_string();
        for keys in [removal, saved] {
            let refused = message(&with(keys, "scalpel", ""));
            assert!(
                refused.contains("\"kind\" is \"scalpel\"") && refused.contains("when_cut = \"hybrid\""),
                "{refused}"
            );
        }
        let zero = Scene::parse(&with(&(pre.to_owned() + "damping = \"0 1/s\"\n"), "scalpel", "")).unwrap();
        assert_eq!(zero.organ.damping, Rayleigh::default());
        let both = message(&organ(&(saved.to_owned() + "when_cut = \"hybrid\"\n")));
        assert!(both.contains("removal, with a saved pre-computation"), "{both}");
        let unknown = message(&organ(&removal.replace("removal", "hybrids")));
        assert!(unknown.contains("allowed: hybrid, removal"), "{unknown}");
        let other = message(&organ("model = \"implicit\"\nwhen_cut = \"removal\"\n"));
        assert!(other.contains("unknown key"), "{other}");
        let reduced = "model = \"reduced\"\n";
        for kind in ["scalpel", "scissors", "hook", "cautery"] {
            let refused = message(&with(reduced, kind, ""));
            assert!(
                refused.contains("model = \"reduced\" cannot be cut; models that can: precomputed"),
                "{refused}"
            );
        }
        assert!(Scene::parse(&with(reduced, "grasper", "")).is_ok());
        // Sessions from before stay as they were.
        let mut header = SessionHeader::new(with(pre, "scalpel", ""), String::new());
        assert_eq!(Scene::parse_recorded(&header).unwrap().organ.model, ModelKind::Hybrid);
        header.version = FIRST_VERSION_WITH_PARTING_SCISSORS - 1;
        assert_eq!(Scene::parse_recorded(&header).unwrap().organ.model, ModelKind::Precomputed);
        header.scene = with(reduced, "scalpel", "");
        assert!(Scene::parse_recorded(&header).is_ok());
    }

    #[test]
    fn lame_numbers_stand_for_young_and_poisson() {
        let young = "young_modulus = \"5 kPa\"\npoisson_ratio = 0.45\n";
        let lame = "lame_lambda = \"12.5 kPa\"\nlame_mu = \"2 kPa\"\n";
        let scene = Scene::parse(&SCENE.replace(young, lame)).unwrap();
        let MaterialSource::Given { young_modulus_pa, poisson_ratio, .. } = scene.organ.material else {
            panic!("{:?}", scene.organ.material)
        };
        let law = crate::material::LinearElastic::from_lame(12.5e3, 2e3, 1060.0).unwrap();
        assert!((young_modulus_pa / law.young_modulus_pa() - 1.0).abs() < 1e-14);
        assert!((poisson_ratio / law.poisson_ratio() - 1.0).abs() < 1e-14);
        let both = Scene::parse(&SCENE.replace(young, &(young.to_string() + lame))).unwrap_err().to_string();
        assert!(both.contains("lame_lambda and lame_mu, or young_modulus and poisson_ratio"), "{both}");
        let half = Scene::parse(&SCENE.replace(young, "lame_lambda = \"1 kPa\"\n")).unwrap_err().to_string();
        assert!(half.contains("[organ] lacks \"lame_mu\""), "{half}");
        let mixed = Scene::parse(&SCENE.replace(young, &(young.to_string() + "lame_mu = \"2 kPa\"\n")));
        assert!(mixed.unwrap_err().to_string().contains("[organ] lacks \"lame_lambda\""));
    }

    /// The scene with one table of each kind that the short one does without.
    fn scene_with_more() -> String {
        let more = r#"model = "implicit"
law = { name = "ogden", exponent = -4.7 }
stiffness_damping = "0.1 ms"
imaged_under_gravity = false
fibre = { direction = [0, 0, 2], lambda_along = "20 kPa", mu_along = "8 kPa" }

[[organ.relaxation]]
share = 0.4
time = "0.5 s"

[[organ.ligament]]
ball = { center = ["0 mm", "0 mm", "9 mm"], radius = "20 mm" }
direction = [0, 0, 1]
length = "15 mm"
stiffness = "0.2 N/mm"

[[organ.load]]
furthest = { direction = [1, 0, 0], fraction = 0.1 }
force = ["0 N", "0.5 N", "0 N"]
from = "1 s"

[[organ.field]]
acceleration = ["0 m/s2", "0 m/s2", "2 m/s2"]
at = "0.5 s"

[[organ.fixed]]
axes = ["x", "z"]
"#;
        SCENE.replace("model = \"tensor_mass\"\ndamping = \"20 1/s\"\n\n[[organ.fixed]]\n", more).replace(
            "time_step = \"1 ms\"",
            "time_step = \"1 ms\"\ngravity = [0, \"9.81 m/s2\", 0]\nmost_parts = 8",
        )
    }

    #[test]
    fn laws_loads_and_supports_are_read() {
        let text = scene_with_more();
        let scene = Scene::parse(&text).unwrap();
        assert_eq!(scene.organ.law, law_named("ogden").map(|law| law.with_number("exponent", -4.7)));
        assert_eq!(scene.organ.damping.stiffness_s, 1e-4);
        assert_eq!(scene.organ.relaxation[0].time_s, 0.5);
        assert_eq!(scene.organ.fibre.unwrap().direction, DVec3::Z);
        assert!(!scene.organ.is_imaged_under_gravity);
        assert_eq!((scene.most_parts, scene.world.gravity_m_per_s2.y), (8, 9.81));
        assert_eq!(scene.world.supports[0].axes, [true, false, true]);
        assert_eq!(scene.world.ligaments[0].stiffness_n_per_m, 200.0);
        assert_eq!(scene.world.loads[0].time, LoadTime::During { from_s: 1.0, to_s: f64::INFINITY });
        assert_eq!(scene.world.fields[0].time, LoadTime::Once(0.5));

        let message = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            Scene::parse(&text.replacen(from, to, 1)).unwrap_err().to_string()
        };
        for (from, to, expected) in [
            (
                "\"implicit\"",
                "\"tensor_mass\"",
                "\"law\" is \"ogden\"; allowed: linear (the laws of the model",
            ),
            ("exponent = -4.7", "exponant = -4.7", "did you mean \"exponent\"?"),
            (
                "name = \"ogden\", exponent",
                "name = \"ogdan\", exponent",
                "\"law\" is \"ogdan\"; allowed: linear, st_",
            ),
            ("at = \"0.5 s\"", "at = \"0.5 s\"\nto = \"1 s\"", "at alone (one step), or from and to"),
            ("from = \"1 s\"", "from = \"1 s\"\nto = \"1 s\"", "later than from"),
            ("[\"x\", \"z\"]", "[\"x\", \"w\"]", "\"axes\" is \"w\"; allowed: x, y, z"),
            ("share = 0.4", "share = 1.4", "all shares together below 1"),
            ("most_parts = 8", "most_parts = 0.5", "a whole number from 1 to 1000"),
            ("\"0.2 N/mm\"", "\"0.2 N\"", "is not a unit of stiffness"),
        ] {
            let found = message(from, to);
            assert!(found.contains(expected), "{to}: {found}");
        }
    }

    #[test]
    fn mistakes_are_named_with_line_and_remedy() {
        let message = |from: &str, to: &str| {
            assert!(SCENE.contains(from), "{from}");
            Scene::parse(&SCENE.replacen(from, to, 1)).unwrap_err().to_string()
        };
        for (from, to, expected) in [
            ("poisson_ratio", "poison_ratio", "did you mean \"poisson_ratio\"?"),
            ("5 kPa", "5 kpa", "line 9: \"young_modulus\": \"kpa\" is not a unit of pressure"),
            ("\"5 kPa\"", "5", "line 9: \"young_modulus\": \"5\" has no unit"),
            ("0.45", "0.5", "line 10: \"poisson_ratio\" is 0.5; allowed: more than -1 and less than 0.5"),
            (
                "tensor_mass",
                "tensormass",
                "line 12: \"model\" is \"tensormass\"; allowed: precomputed, tensor_mass, nonlinear_tensor_mass",
            ),
            ("mesh = \"liver.vtu\"\n", "", "[organ] lacks \"mesh\""),
            ("[0, -2, 0]", "[0, 0, 0]", "three numbers that are not all zero"),
            ("fraction = 0.1", "fraction = 7", "line 16: \"fraction\" is 7; allowed: between 0 and 1"),
            ("furthest = {", "furthest = [", "line 16: "),
            ("glisson_scene = 1", "glisson_scene = 2", "line 1: \"glisson_scene\" is 2; allowed: 1"),
            ("[simulation]\ntime_step", "[simulation]\ntimestep", "did you mean \"time_step\"?"),
            ("time_step = \"1 ms\"", "time_step = \"-1 ms\"", "allowed: 1 us to 1 s"),
            ("time_step = \"1 ms\"", "time_step = \"1e20 s\"", "allowed: 1 us to 1 s"),
        ] {
            let found = message(from, to);
            assert!(found.contains(expected), "{to}: {found}");
        }
        let no_poisson = message("poisson_ratio = 0.45\n", "");
        assert!(no_poisson.starts_with("line 7: [organ] lacks \"poisson_ratio\""), "{no_poisson}");
    }

    proptest! {
        #[test]
        fn mutated_scenes_are_read_or_refused(at in 0..SCENE.len(), byte in any::<u8>(), cut in 0..SCENE.len()) {
            let mut bytes = SCENE.as_bytes().to_vec();
            bytes[at] = byte;
            bytes.truncate(SCENE.len() - cut / 4);
            let _ = Scene::parse(&String::from_utf8_lossy(&bytes));
        }
    }
}
