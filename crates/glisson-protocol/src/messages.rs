//! The JSON messages of the viewer's protocol.

use crate::class::{ClassWish, LONGEST_NAME, Present};
use crate::hands::FeltBy;
use crate::inside::Look;
use glisson::math::{Aabb, DVec3};
use glisson::model::kind::{MODELS, ModelKind};
use glisson::record::inside::{Field, Plane};
use glisson::record::note::{MOST_POINTS, Note};
use glisson::record::parameter::Parameter;
use glisson::record::snapshot::{
    BleedingEnd, BleedingSnapshot, ClipSnapshot, ContactReport, ThreadSnapshot, ToolSnapshot,
};
use glisson::tool::{Tool, ToolInput};
use glisson::training::task::TaskStatus;
use glisson::world::spec::BodySpec;
use glisson_runtime::control::{Holder, Steers, Viewer};
use glisson_runtime::haptic_loop::{HapticReport, ToolLink};
use glisson_runtime::live::Command;
use glisson_runtime::page_hand::GREATEST_FORCE_N;
use glisson_runtime::published::Published;
use glisson_runtime::{Notice, ParameterState, Parameters, Simulation, Turn};
use serde::Deserialize;
use serde_json::{Value, json};

const PROTOCOL: u32 = 12;

/// The first message on a connection.
pub fn hello(simulation: &Simulation) -> Value {
    let world = simulation.world();
    let (spec, organ) = (world.spec(), world.organ());
    let bounds = Aabb::of_points(&organ.mesh().positions_m);
    json!({
        "type": "hello",
        "protocol": PROTOCOL,
        "scene": {
            "name": spec.name,
            "model": world.model_kind().name(),
            "material": simulation.body().material_text,
            "time_step_s": spec.time_step_s,
            "gravity_m_per_s2": world.gravity_m_per_s2().to_array(),
            "n_nodes": organ.mesh().positions_m.len(),
            "n_tetrahedra": organ.mesh().tetrahedra.len(),
            "n_vessels": world.vessels().map_or(0, |vessels| vessels.tubes().len()),
        },
        "bounds": { "min_m": bounds.min_m.to_array(), "max_m": bounds.max_m.to_array() },
        "bodies": spec.bodies.iter().map(body).collect::<Vec<_>>(),
        "tools": spec.tools.iter().map(described).collect::<Vec<_>>(),
        "models": MODELS
            .iter()
            .filter(|row| !row.follows_curves || simulation.body().measured.is_some())
            .map(|row| row.name)
            .collect::<Vec<_>>(),
        "fixed_nodes": organ.fixed_nodes().iter().map(|n| n.0).collect::<Vec<_>>(),
    })
}

/// Which device holds which instrument.
pub fn devices<'a>(links: impl Iterator<Item = &'a ToolLink>) -> Value {
    links.map(|link| json!({ "tool": link.tool, "name": link.device_name })).collect()
}

fn body(body: &BodySpec) -> Value {
    let hex = |[red, green, blue]: [u8; 3]| format!("#{red:02x}{green:02x}{blue:02x}");
    json!({
        "name": body.name,
        "color": body.color.map(hex),
        "is_rigid": body.is_rigid,
        "n_tetrahedra": body.tetrahedra.len(),
    })
}

fn described(tool: &Tool) -> Value {
    let jaws = tool.kind.jaws().map(|jaws| {
        json!({
            "length_m": jaws.length_m,
            "width_m": jaws.width_m,
            "greatest_opening_rad": jaws.greatest_opening_rad,
        })
    });
    let optics = tool.kind.optics().map(|optics| {
        json!({
            "view_angle_rad": optics.view_angle_rad,
            "field_of_view_rad": optics.field_of_view_rad,
        })
    });
    json!({
        "name": tool.name,
        "kind": tool.kind.name(),
        "tip_radius_m": tool.tip_radius_m,
        "shaft_radius_m": tool.shaft_radius_m,
        "shaft_length_m": tool.shaft_length_m,
        "jaws": jaws,
        "optics": optics,
        "trocar_m": tool.trocar_m.map(|p| p.to_array()),
        "home_tip_m": tool.home.tip_in_world_m.to_array(),
        "home_shaft": tool.home.shaft_in_world.to_array(),
        "home_jaw": tool.home.jaw_opening,
    })
}

/// `hello` after another model took over.
pub(crate) fn hello_with_model(hello: &Value, model: ModelKind) -> Value {
    let mut changed = hello.clone();
    changed["scene"]["model"] = model.name().into();
    changed
}

/// The latest displayed state in full precision.
pub fn snapshot(published: &Published) -> Value {
    let Published { snapshot, topology, .. } = published;
    let list = |points: &[DVec3]| points.iter().map(|p| p.to_array()).collect::<Vec<_>>();
    json!({
        "step": snapshot.step,
        "time_s": snapshot.time_s,
        "topology_version": snapshot.topology_version,
        "paused": published.pace.paused,
        "model": published.model.name(),
        "tools": snapshot.tools.iter().map(tool_state).collect::<Vec<_>>(),
        "node_ids": topology.nodes.iter().map(|n| n.0).collect::<Vec<_>>(),
        "rest_positions_m": list(&topology.rest_positions_m),
        "positions_m": list(&snapshot.positions_m),
        "bleeding": snapshot.bleeding.has_vessels.then(|| bleeding_state(&snapshot.bleeding)),
        "threads": snapshot.threads.iter().map(thread).collect::<Vec<_>>(),
        "state_hash": published.state_hash.to_string(),
    })
}

fn thread(thread: &ThreadSnapshot) -> Value {
    let list = |points: &[DVec3]| points.iter().map(|p| p.to_array()).collect::<Vec<_>>();
    json!({
        "radius_m": thread.radius_m,
        "nodes_m": list(&thread.nodes_m),
        "n_needle_nodes": thread.n_needle_nodes,
        "clips_m": list(&thread.clips_m),
    })
}

fn bleeding_state(bleeding: &BleedingSnapshot) -> Value {
    let end = |end: &BleedingEnd| json!({ "position_m": end.position_m.to_array(), "rate_m3_per_s": end.rate_m3_per_s });
    let clip = |clip: &ClipSnapshot| {
        json!({
            "position_m": clip.position_m.to_array(),
            "along": clip.along.to_array(),
            "legs": clip.legs.to_array(),
            "radius_m": clip.radius_m,
        })
    };
    json!({
        "lost_m3": bleeding.lost_m3,
        "rate_m3_per_s": bleeding.rate_m3_per_s,
        "n_clips": bleeding.n_clips,
        "ends": bleeding.ends.iter().map(end).collect::<Vec<_>>(),
        "clips": bleeding.clips.iter().map(clip).collect::<Vec<_>>(),
    })
}

fn tool_state(tool: &ToolSnapshot) -> Value {
    let contact = |contact: &ContactReport| {
        json!({
            "point_m": contact.point_m.to_array(),
            "node_ids": contact.nodes.map(|n| n.0),
            "weights": contact.weights,
        })
    };
    json!({
        "tip_m": tool.pose.tip_in_world_m.to_array(),
        "shaft": tool.pose.shaft_in_world.to_array(),
        "roll_rad": tool.pose.roll_rad,
        "jaw": tool.pose.jaw_opening,
        "trigger": tool.pose.trigger,
        "force_on_tool_n": tool.force_n.to_array(),
        "contact": tool.contacts.iter().flatten().next().map(contact),
        "n_held_nodes": tool.n_held_nodes,
        "shown_further_out_m": tool.shown_further_out_m.to_array(),
    })
}

/// What a hand would feel that a page holds.
pub(crate) fn feel(all: &[FeltBy]) -> Value {
    let hand = |FeltBy { tool, felt }: &FeltBy| json!({ "tool": tool, "force_n": felt.force_n.to_array(), "is_held": felt.is_held });
    json!({
        "type": "feel",
        "greatest_force_n": GREATEST_FORCE_N,
        "hands": all.iter().map(hand).collect::<Vec<_>>(),
    })
}

/// What is wrong, for the page to show.
pub fn error(message: &str) -> Value {
    json!({ "type": "error", "message": message })
}

/// What the user should know, for the page to show.
pub(crate) fn notice(notice: &Notice) -> Value {
    let kind = if notice.is_problem { "error" } else { "news" };
    json!({ "type": kind, "message": notice.text })
}

/// How far the task is; none when it cannot be done any more.
pub(crate) fn task(status: Option<&TaskStatus>) -> Value {
    json!({ "type": "task", "status": status })
}

/// Whether this viewer controls, whether anybody does, and who has each instrument in the hand.
pub(crate) fn role(steers: &Steers, viewer: Viewer) -> Value {
    let role = if steers.controller == Some(viewer) { "controller" } else { "viewer" };
    let held = |holder: &Holder| match holder {
        Holder::Controller => "controller",
        Holder::Offered => "offered",
        Holder::Taken(by) if *by == viewer => "this",
        Holder::Taken(_) => "another",
    };
    json!({
        "type": "role",
        "role": role,
        "control_is_taken": steers.controller.is_some(),
        "instruments": steers.holders.iter().map(held).collect::<Vec<_>>(),
    })
}

/// What can be turned, and how it stands.
pub(crate) fn parameters(parameters: &Parameters) -> Value {
    let one = |state: &ParameterState| {
        let (name, unit, range) = (state.parameter.name(), state.parameter.unit(), state.parameter.range());
        json!({
            "name": name,
            "unit": unit,
            "body": state.body,
            "value": state.value,
            "of_scene": state.of_scene,
            "coming": state.coming,
            "least": range.start(),
            "greatest": range.end(),
            "refusal": state.refusal,
        })
    };
    json!({
        "type": "parameters",
        "material": parameters.material,
        "parameters": parameters.list.iter().map(one).collect::<Vec<_>>(),
    })
}

/// Who watches, and who of them `you` is and controls.
pub(crate) fn class(present: &Present, you: u64, controls: Option<u64>) -> Value {
    json!({ "type": "class", "you": you, "controls": controls, "people": present.people })
}

/// What is drawn on the tissue.
pub(crate) fn marks(present: &Present) -> Value {
    json!({ "type": "marks", "marks": present.marks })
}

/// Where the loop is that gives forces to hands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HapticsAt {
    /// No device holds an instrument.
    Nowhere,
    /// In this program.
    Here,
    /// The machine with `--role haptics`, which knows its times.
    OtherMachine,
}

/// How the loops keep their time.
pub fn timing(published: &Published, at: HapticsAt, haptics: Option<&HapticReport>) -> Value {
    let Published { pace, lateness, effort, meters, .. } = published;
    let mut simulation = meters.times().to_json();
    simulation["rate_hz"] = json!(pace.rate_hz);
    simulation["real_time_factor"] = json!(pace.real_time_factor);
    simulation["times_given_up"] = json!(lateness.n_given_up);
    simulation["left_out_s"] = json!(lateness.left_out_s);
    simulation["effort"] = json!(effort.name());
    simulation["speed"] = json!(pace.slow_motion.unwrap_or(1.0));
    json!({
        "type": "timing",
        "simulation": simulation,
        "haptics": haptics.map(HapticReport::to_json),
        "haptics_at": match at {
            HapticsAt::Nowhere => "nowhere",
            HapticsAt::Here => "here",
            HapticsAt::OtherMachine => "other_machine",
        },
    })
}

/// What a viewer wants.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Wish {
    /// Something of the simulation: for the one who controls.
    Command(Command),
    /// Somebody else may control.
    ReleaseControl,
    /// The one who controls offers an instrument to the others, or has it again.
    Offer { tool: usize, is_offered: bool },
    /// An instrument that is offered is taken, or given back.
    Hold { tool: usize, is_held: bool },
    /// Contact points are looked at, or no longer: for everyone.
    Contacts(bool),
    /// Something inside of the bodies is looked at, or nothing any longer: for everyone.
    Inside(Look),
    /// Something of those who watch together.
    Class(ClassWish),
    /// The simulation ends, and the page that it was started from comes again.
    Leave,
}

#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
enum ViewerMessage {
    Tool {
        #[serde(default)]
        tool: usize,
        tip_m: [f64; 3],
        shaft: [f64; 3],
        #[serde(default)]
        roll_rad: f64,
        #[serde(default)]
        jaw: f64,
        #[serde(default)]
        trigger: f64,
    },
    Pause {
        paused: bool,
    },
    Speed {
        factor: f64,
    },
    SingleStep {},
    Reset {},
    Model {
        name: String,
    },
    Gravity {
        m_per_s2: [f64; 3],
    },
    Cut {
        #[serde(default)]
        tool: usize,
    },
    Clip {
        #[serde(default)]
        tool: usize,
    },
    Refine {
        #[serde(default)]
        tool: usize,
    },
    Undo {},
    TaskEvent {
        number: u32,
    },
    Turn {
        #[serde(default)]
        body: usize,
        parameter: Parameter,
        value: f64,
    },
    Offer {
        tool: usize,
        offered: bool,
    },
    Hold {
        tool: usize,
        held: bool,
    },
    ReleaseControl {},
    TakeOver {},
    GiveBack {},
    Introduce {
        name: String,
    },
    Point {
        at_m: Option<[f64; 3]>,
    },
    Draw {
        points_m: Vec<[f64; 3]>,
    },
    Erase {},
    Bookmark {
        #[serde(default)]
        time_s: Option<f64>,
        #[serde(default)]
        text: String,
    },
    Leave {},
    Contacts {
        shown: bool,
    },
    Inside {
        #[serde(default)]
        field: FieldName,
        #[serde(default)]
        plane: Option<PlaneMessage>,
        #[serde(default)]
        energies: bool,
    },
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum FieldName {
    #[default]
    None,
    Strain,
    Stress,
    Quality,
}

impl From<FieldName> for Field {
    fn from(name: FieldName) -> Self {
        match name {
            FieldName::None => Self::None,
            FieldName::Strain => Self::Strain,
            FieldName::Stress => Self::Stress,
            FieldName::Quality => Self::Quality,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlaneMessage {
    point_m: [f64; 3],
    normal: [f64; 3],
}

impl PlaneMessage {
    fn plane(self) -> Result<Plane, String> {
        let normal = DVec3::from_array(self.normal).try_normalize();
        let normal = normal.ok_or_else(|| "\"normal\" has no direction".to_string())?;
        let point_m = DVec3::from_array(self.point_m);
        if point_m.abs().max_element() > FURTHEST_TIP_M {
            return Err(format!("\"point_m\" is {point_m} m; allowed: up to {FURTHEST_TIP_M} m"));
        }
        Ok(Plane { point_m, normal })
    }
}

/// No patient and no room is so large: more is millimetres taken for metres [m].
const FURTHEST_TIP_M: f64 = 100.0;

/// Ten times that of the Earth: more is a mistyped number.
const STRONGEST_GRAVITY_M_PER_S2: f64 = 100.0;

/// Slower than this nothing seems to move: a choice.
const SLOWEST: f64 = 0.05;

fn near_enough(key: &str, place_m: &[f64; 3]) -> Result<(), String> {
    match place_m.iter().find(|x| x.abs() > FURTHEST_TIP_M) {
        Some(found) => Err(format!("\"{key}\" has {found} m; allowed: up to {FURTHEST_TIP_M} m")),
        None => Ok(()),
    }
}

/// What a viewer asks for, or why it cannot be understood.
pub(crate) fn wish(text: &str) -> Result<Wish, String> {
    let message: ViewerMessage =
        serde_json::from_str(text).map_err(|e| format!("message not understood: {e}"))?;
    Ok(Wish::Command(match message {
        ViewerMessage::ReleaseControl {} => return Ok(Wish::ReleaseControl),
        ViewerMessage::Leave {} => return Ok(Wish::Leave),
        ViewerMessage::Offer { tool, offered } => return Ok(Wish::Offer { tool, is_offered: offered }),
        ViewerMessage::Hold { tool, held } => return Ok(Wish::Hold { tool, is_held: held }),
        ViewerMessage::Turn { body, parameter, value } => Command::Turn(Turn { body, parameter, value }),
        ViewerMessage::Inside { field, plane, energies } => {
            let plane = plane.map(PlaneMessage::plane).transpose()?;
            return Ok(Wish::Inside(Look { field: field.into(), plane, energies }));
        }
        ViewerMessage::TakeOver {} => return Ok(Wish::Class(ClassWish::TakeOver)),
        ViewerMessage::GiveBack {} => return Ok(Wish::Class(ClassWish::GiveBack)),
        ViewerMessage::Erase {} => return Ok(Wish::Class(ClassWish::Erase)),
        ViewerMessage::Introduce { name } => {
            let name = name.trim().to_owned();
            let n = name.chars().count();
            if n > LONGEST_NAME || name.chars().any(char::is_control) {
                return Err(format!(
                    "\"name\" has {n} signs; allowed: up to {LONGEST_NAME} that can be seen"
                ));
            }
            return Ok(Wish::Class(ClassWish::Introduce(name)));
        }
        ViewerMessage::Point { at_m } => {
            at_m.as_slice().iter().try_for_each(|at_m| near_enough("at_m", at_m))?;
            return Ok(Wish::Class(ClassWish::Point(at_m)));
        }
        ViewerMessage::Draw { points_m } => {
            let n = points_m.len();
            if !(1..=MOST_POINTS).contains(&n) {
                return Err(format!("\"points_m\" has {n} points; allowed: 1 to {MOST_POINTS}"));
            }
            points_m.iter().try_for_each(|point_m| near_enough("points_m", point_m))?;
            return Ok(Wish::Class(ClassWish::Draw(points_m)));
        }
        ViewerMessage::Bookmark { time_s, text } => {
            // Of now: the simulation knows when that is.
            let time_s = time_s.unwrap_or(f64::MAX);
            let note = Note::Bookmark { time_s, text: text.trim().to_owned() };
            note.check()?;
            Command::Note(note)
        }
        ViewerMessage::Contacts { shown } => return Ok(Wish::Contacts(shown)),
        ViewerMessage::Tool { tool, tip_m, shaft, roll_rad, jaw, trigger } => {
            let shaft_in_world = DVec3::from_array(shaft)
                .try_normalize()
                .ok_or_else(|| "\"shaft\" has no direction".to_string())?;
            let shares = [("jaw", jaw), ("trigger", trigger)];
            if let Some((key, found)) = shares.into_iter().find(|(_, share)| !(0.0..=1.0).contains(share)) {
                return Err(format!("\"{key}\" is {found}; allowed: between 0 and 1"));
            }
            near_enough("tip_m", &tip_m)?;
            let pose = ToolInput::at(DVec3::from_array(tip_m), shaft_in_world);
            Command::Tool { tool, pose: ToolInput { roll_rad, jaw_opening: jaw, trigger, ..pose } }
        }
        ViewerMessage::Pause { paused } => Command::Pause(paused),
        ViewerMessage::Speed { factor } if (SLOWEST..=1.0).contains(&factor) => Command::Speed(factor),
        ViewerMessage::Speed { factor } => {
            return Err(format!("\"factor\" is {factor}; allowed: between {SLOWEST} and 1"));
        }
        ViewerMessage::SingleStep {} => Command::SingleStep,
        ViewerMessage::Reset {} => Command::Reset,
        ViewerMessage::Model { name } => {
            let names = ModelKind::ALL.map(ModelKind::name).join(", ");
            let kind = ModelKind::by_name(&name)
                .ok_or_else(|| format!("no model \"{name}\"; there are: {names}"))?;
            Command::Model(kind)
        }
        ViewerMessage::Cut { tool } => Command::Cut { tool },
        ViewerMessage::Clip { tool } => Command::Clip { tool },
        ViewerMessage::Refine { tool } => Command::Refine { tool },
        ViewerMessage::Undo {} => Command::Undo,
        ViewerMessage::TaskEvent { number } => Command::TaskEvent { number },
        ViewerMessage::Gravity { m_per_s2 } => {
            let gravity_m_per_s2 = DVec3::from_array(m_per_s2);
            if gravity_m_per_s2.length() > STRONGEST_GRAVITY_M_PER_S2 {
                return Err(format!(
                    "gravity of {m_per_s2:?} m/s2; allowed: up to {STRONGEST_GRAVITY_M_PER_S2}"
                ));
            }
            Command::Gravity(gravity_m_per_s2)
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::tool::{Optics, ToolKind};
    use proptest::prelude::*;

    fn command(text: &str) -> Result<Command, String> {
        match wish(text)? {
            Wish::Command(command) => Ok(command),
            other => Err(format!("{other:?}")),
        }
    }

    const MESSAGES: [&str; 10] = [
        r#"{"type":"inside","field":"stress","plane":{"point_m":[0,0.1,0],"normal":[0,0,2]},"energies":true}"#,
        r#"{"type":"turn","parameter":"young_modulus","body":1,"value":6e3}"#,
        r#"{"type":"hold","tool":1,"held":true}"#,
        r#"{"type":"tool","tool":1,"tip_m":[1,-2.5,3e-3],"shaft":[0,0,2],"roll_rad":0.5,"jaw":1,"trigger":0.25}"#,
        r#"{"type":"pause","paused":true}"#,
        r#"{"type":"model","name":"explicit"}"#,
        r#"{"type":"gravity","m_per_s2":[0,9.81,0]}"#,
        r#"{"type":"cut","tool":3}"#,
        r#"{"type":"release_control"}"#,
        r#"{"type":"contacts","shown":true}"#,
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]
        #[test]
        fn mutated_messages_are_understood_or_refused_with_a_reason(
            which in 0..MESSAGES.len(),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
            cut in any::<prop::sample::Index>(),
            is_cut in any::<bool>(),
        ) {
            let mut bytes = MESSAGES[which].as_bytes().to_vec();
            for (at, byte) in changes {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if is_cut {
                bytes.truncate(cut.index(bytes.len()));
            }
            match wish(&String::from_utf8_lossy(&bytes)) {
                Ok(Wish::Command(Command::Tool { pose, .. })) => {
                    prop_assert!(pose.is_finite() && (pose.shaft_in_world.length() - 1.0).abs() < 1e-12);
                    prop_assert!((0.0..=1.0).contains(&pose.jaw_opening) && (0.0..=1.0).contains(&pose.trigger));
                }
                Ok(_) => {}
                Err(reason) => prop_assert!(!reason.is_empty()),
            }
        }

        #[test]
        fn any_text_is_understood_or_refused_with_a_reason(text in ".{0,200}") {
            if let Err(reason) = wish(&text) {
                prop_assert!(!reason.is_empty());
            }
        }
    }

    #[test]
    fn the_lens_of_an_endoscope_is_described() {
        let probe = Tool::probe("camera", 5e-3, ToolInput::at(DVec3::ZERO, DVec3::NEG_Y));
        assert!(described(&probe)["optics"].is_null());
        let kind = ToolKind::endoscope(Optics { view_angle_rad: 0.5, field_of_view_rad: 1.25 });
        let described = described(&Tool { kind, ..probe });
        assert_eq!(described["kind"], "endoscope");
        assert_eq!(described["optics"], json!({ "view_angle_rad": 0.5, "field_of_view_rad": 1.25 }));
    }

    #[test]
    fn commands_are_read_and_mistakes_answered() {
        assert_eq!(command(r#"{"type":"pause","paused":true}"#), Ok(Command::Pause(true)));
        assert_eq!(command(r#"{"type":"single_step"}"#), Ok(Command::SingleStep));
        let tool = command(r#"{"type":"tool","tip_m":[1,2,3],"shaft":[0,0,2]}"#).unwrap();
        let pose = ToolInput::at(DVec3::new(1.0, 2.0, 3.0), DVec3::Z);
        assert_eq!(tool, Command::Tool { tool: 0, pose });
        let second = r#"{"type":"tool","tool":1,"tip_m":[1,2,3],"shaft":[0,0,2],"roll_rad":0.5,"jaw":1,"trigger":0.25}"#;
        let pose = ToolInput { roll_rad: 0.5, jaw_opening: 1.0, trigger: 0.25, ..pose };
        assert_eq!(command(second), Ok(Command::Tool { tool: 1, pose }));
        assert_eq!(command(r#"{"type":"cut"}"#), Ok(Command::Cut { tool: 0 }));
        assert_eq!(command(r#"{"type":"cut","tool":2}"#), Ok(Command::Cut { tool: 2 }));
        assert_eq!(command(r#"{"type":"clip","tool":1}"#), Ok(Command::Clip { tool: 1 }));
        assert_eq!(command(r#"{"type":"refine","tool":1}"#), Ok(Command::Refine { tool: 1 }));
        assert_eq!(command(r#"{"type":"undo"}"#), Ok(Command::Undo));
        assert_eq!(command(r#"{"type":"task_event","number":1}"#), Ok(Command::TaskEvent { number: 1 }));
        assert_eq!(wish(r#"{"type":"contacts","shown":true}"#), Ok(Wish::Contacts(true)));
        assert_eq!(wish(r#"{"type":"leave"}"#), Ok(Wish::Leave));
        assert_eq!(wish(r#"{"type":"take_over"}"#), Ok(Wish::Class(ClassWish::TakeOver)));
        let named = wish(r#"{"type":"introduce","name":" Ada "}"#);
        assert_eq!(named, Ok(Wish::Class(ClassWish::Introduce("Ada".into()))));
        let drawn = wish(r#"{"type":"draw","points_m":[[0,0,0.1],[0,1,0]]}"#);
        assert_eq!(drawn, Ok(Wish::Class(ClassWish::Draw(vec![[0.0, 0.0, 0.1], [0.0, 1.0, 0.0]]))));
        let note = |time_s, text: &str| Ok(Command::Note(Note::Bookmark { time_s, text: text.into() }));
        assert_eq!(command(r#"{"type":"bookmark"}"#), note(f64::MAX, ""));
        assert_eq!(
            command(r#"{"type":"bookmark","time_s":1.5,"text":" it bleeds "}"#),
            note(1.5, "it bleeds")
        );
        assert_eq!(wish(r#"{"type":"point","at_m":null}"#), Ok(Wish::Class(ClassWish::Point(None))));
        assert_eq!(command(r#"{"type":"speed","factor":0.25}"#), Ok(Command::Speed(0.25)));
        let tilted = command(r#"{"type":"gravity","m_per_s2":[0,9.81,0]}"#);
        assert_eq!(tilted, Ok(Command::Gravity(DVec3::new(0.0, 9.81, 0.0))));
        for bad in [
            "",
            "{}",
            r#"{"type":"fly"}"#,
            r#"{"type":"tool","tip_m":[1,2],"shaft":[0,0,1]}"#,
            r#"{"type":"tool","tip_m":[1,2,3],"shaft":[0,0,0]}"#,
            r#"{"type":"tool","tip_m":[1,2,300],"shaft":[0,0,1]}"#,
            r#"{"type":"tool","tip_m":[1,2,1e999],"shaft":[0,0,1]}"#,
            r#"{"type":"tool","tip_m":[1,2,3],"shaft":[0,0,1],"jaw":2}"#,
            r#"{"type":"model","name":"jelly"}"#,
            r#"{"type":"contacts"}"#,
            r#"{"type":"draw","points_m":[]}"#,
            r#"{"type":"draw","points_m":[[0,0,1000]]}"#,
            r#"{"type":"point","at_m":[0,1e999,0]}"#,
            r#"{"type":"introduce","name":"a\u0007"}"#,
            r#"{"type":"introduce","name":"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"}"#,
            r#"{"type":"bookmark","time_s":-1}"#,
            r#"{"type":"bookmark","text":"a\u0007"}"#,
            r#"{"type":"speed","factor":0}"#,
            r#"{"type":"speed","factor":2}"#,
            r#"{"type":"leave","now":true}"#,
            r#"{"type":"gravity","m_per_s2":[0,981,0]}"#,
        ] {
            assert!(command(bad).is_err(), "{bad}");
        }
    }
}
