//! What the Inverse Service and its clients say to each other: JSON text, metres, newtons, quaternions x y z w.
//!
//! From service 3.5 on a force is a `vector`, before it was `values`. Unknown fields are passed over: services grow.

use glam::DQuat;
use glisson::haptics::DeviceState;
use glisson::math::DVec3;
use serde::Deserialize;
use serde_json::json;

/// How the service wants its commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Generation {
    /// Before 3.5.
    Values,
    /// 3.5 and later.
    Vector,
}

impl Generation {
    /// Of a text that holds the service's version, such as `{"version":"3.5.1"}`; none when there is no number in it.
    pub(super) fn of_version(text: &str) -> Option<Self> {
        let start = text.find(|c: char| c.is_ascii_digit())?;
        let mut numbers = text[start..].split(|c: char| !c.is_ascii_digit());
        let major: u32 = numbers.next()?.parse().ok()?;
        let minor: u32 = numbers.next().and_then(|n| n.parse().ok()).unwrap_or(0);
        Some(if (major, minor) >= (3, 5) { Self::Vector } else { Self::Values })
    }
}

#[derive(Deserialize)]
struct Frame {
    #[serde(default)]
    inverse3: Vec<Inverse3>,
    #[serde(default)]
    wireless_verse_grip: Vec<Grip>,
    #[serde(default)]
    verse_grip: Vec<Grip>,
    #[serde(default)]
    custom_verse_grip: Vec<Grip>,
}

#[derive(Deserialize)]
struct Inverse3 {
    device_id: String,
    state: Option<CursorState>,
    #[serde(default)]
    status: Status,
}

#[derive(Deserialize)]
struct CursorState {
    cursor_position: Xyz,
    #[serde(default)]
    cursor_velocity: Xyz,
}

#[derive(Default, Deserialize)]
struct Status {
    calibrated: Option<bool>,
    power_supply: Option<bool>,
}

#[derive(Deserialize)]
struct Grip {
    #[serde(default)]
    device_id: String,
    state: Option<GripState>,
}

#[derive(Deserialize)]
struct GripState {
    orientation: Option<Xyzw>,
    #[serde(default)]
    buttons: Buttons,
}

#[derive(Default, Deserialize)]
struct Buttons {
    #[serde(default)]
    a: bool,
    #[serde(default)]
    b: bool,
    #[serde(default)]
    c: bool,
}

#[derive(Clone, Copy, Default, Deserialize)]
struct Xyz {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Clone, Copy, Deserialize)]
struct Xyzw {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl From<Xyz> for DVec3 {
    fn from(v: Xyz) -> Self {
        Self::new(v.x, v.y, v.z)
    }
}

/// What a grip says.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GripTold {
    /// Which one.
    pub(super) device_id: String,
    /// None where it tells its buttons only.
    pub(super) orientation: Option<DQuat>,
    /// Bit by bit from the first one.
    pub(super) buttons: u32,
}

/// What a frame of the service says.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Update {
    /// Which Inverse3.
    pub(super) device_id: String,
    pub(super) position_m: DVec3,
    pub(super) velocity_m_per_s: DVec3,
    /// None where no grip, or not the wanted one, says anything.
    pub(super) grip: Option<GripTold>,
    /// What keeps it from being used, if something does.
    pub(super) hindrance: Option<&'static str>,
}

/// The device's arms are shorter, and no hand is faster: more is a broken message [m], [m/s].
const FURTHEST_M: f64 = 1.0;
const FASTEST_M_PER_S: f64 = 50.0;

/// Which devices of a service are used; the first ones that say something for none.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wanted<'a> {
    pub(super) device_id: Option<&'a str>,
    pub(super) grip_id: Option<&'a str>,
}

/// What the wanted Inverse3 and grip say in a frame.
///
/// # Errors
/// Why the frame says nothing that could be used.
pub(super) fn parse(text: &str, wanted: Wanted<'_>) -> Result<Update, String> {
    let Wanted { device_id: wanted, grip_id } = wanted;
    let frame: Frame = serde_json::from_str(text).map_err(|e| format!("not a frame of the service: {e}"))?;
    let found = frame.inverse3.iter().find(|device| wanted.is_none_or(|id| id == device.device_id));
    let Some(device) = found else {
        let known: Vec<&str> = frame.inverse3.iter().map(|device| device.device_id.as_str()).collect();
        return Err(match wanted {
            Some(id) if !known.is_empty() => format!("no Inverse3 \"{id}\"; there are: {}", known.join(", ")),
            _ => "no Inverse3 is connected to the service".into(),
        });
    };
    let Some(cursor) = &device.state else { return Err("the Inverse3 has no state yet".into()) };
    let position_m = DVec3::from(cursor.cursor_position);
    let velocity_m_per_s = DVec3::from(cursor.cursor_velocity);
    if !(position_m.abs().max_element() <= FURTHEST_M
        && velocity_m_per_s.abs().max_element() <= FASTEST_M_PER_S)
    {
        return Err(format!(
            "cursor at {position_m} m, {velocity_m_per_s} m/s: beyond what a device reaches"
        ));
    }
    let grips = [&frame.wireless_verse_grip, &frame.verse_grip, &frame.custom_verse_grip];
    let mut said = grips.into_iter().flatten().filter(|grip| grip_id.is_none_or(|id| id == grip.device_id));
    let grip = said.find_map(|grip| grip.state.as_ref().map(|state| grip_told(&grip.device_id, state)));
    let grip = grip.transpose()?;
    let hindrance = match device.status {
        Status { calibrated: Some(false), .. } => {
            Some("it is not calibrated: follow its light, then let go of it")
        }
        Status { power_supply: Some(false), .. } => Some("its power supply is off"),
        Status { .. } => None,
    };
    Ok(Update { device_id: device.device_id.clone(), position_m, velocity_m_per_s, grip, hindrance })
}

fn grip_told(device_id: &str, state: &GripState) -> Result<GripTold, String> {
    let orientation = state.orientation.map(|q| DQuat::from_xyzw(q.x, q.y, q.z, q.w));
    if let Some(length) = orientation.map(DQuat::length).filter(|length| !(0.5..2.0).contains(length)) {
        return Err(format!("a grip's orientation has length {length}; it must be 1"));
    }
    let Buttons { a, b, c } = state.buttons;
    Ok(GripTold {
        device_id: device_id.to_owned(),
        orientation: orientation.map(DQuat::normalize),
        buttons: u32::from(a) | u32::from(b) << 1 | u32::from(c) << 2,
    })
}

impl Update {
    /// The state of both; without a grip nobody tells an orientation or presses a button.
    pub(super) fn state_with(&self, grip: Option<&GripTold>) -> DeviceState {
        let buttons = grip.map_or(0, |grip| grip.buttons);
        DeviceState {
            position_m: self.position_m,
            velocity_m_per_s: self.velocity_m_per_s,
            orientation: grip.and_then(|grip| grip.orientation),
            // The grips have no jaws: the third button closes the tool's.
            jaw_opening: if buttons & 4 == 0 { 1.0 } else { 0.0 },
            buttons,
        }
    }
}

/// Asks for a frame with all that there is: at first, and as long as no Inverse3 was in one. The service tells nothing new to who
/// says nothing.
pub(super) fn full_state_request() -> String {
    json!({ "session": { "force_render_full_state": {} } }).to_string()
}

/// The answer to a frame: the service goes on telling the state only to who answers. A force holds until the next one.
pub(super) fn force_command(generation: Generation, device_id: &str, force_n: DVec3) -> String {
    let force = json!({ "x": force_n.x, "y": force_n.y, "z": force_n.z });
    let command = match generation {
        Generation::Values => json!({ "values": force }),
        Generation::Vector => json!({ "vector": force, "execute": true }),
    };
    json!({ "inverse3": [{ "device_id": device_id, "commands": { "set_cursor_force": command } }] })
        .to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Written from the published schema (service 3.5): first frame with the configuration.
    const FIRST: &str = r#"{"session_id":176,"inverse3":[{"device_id":"04C3","config":{"type":"inverse3","device_info":{"major_version":7,"minor_version":1,"id":"04C3","device_type":4},"port":"COM15","handedness":"right","basis":{"permutation":"XYZ"}},"state":{"cursor_position":{"x":0.128,"y":0.039,"z":-0.051},"cursor_velocity":{"x":0.01,"y":-0.02,"z":0.03},"angular_position":{"a0":1.0,"a1":2.0,"a2":3.0},"body_orientation":{"x":0,"y":0,"z":0,"w":1},"mode":"idle"},"status":{"calibrated":true,"in_use":false,"power_supply":true,"ready":true,"started":true}}],"verse_grip":[],"wireless_verse_grip":[{"device_id":"1102","state":{"battery_voltage":3.695,"buttons":{"a":true,"b":false,"c":true},"hall":12,"orientation":{"x":0,"y":0.6,"z":0,"w":0.8}}}],"custom_verse_grip":[]}"#;
    /// A later frame, and one of a service before 3.5 without a grip.
    const LATER: &str = r#"{"inverse3":[{"device_id":"04C3","state":{"cursor_position":{"x":0.1,"y":0.2,"z":0.3},"cursor_velocity":{"x":0,"y":0,"z":0}}}]}"#;

    #[test]
    fn frames_are_read() {
        let any = Wanted::default();
        let update = parse(FIRST, any).unwrap();
        assert_eq!(update.device_id, "04C3");
        let state = update.state_with(update.grip.as_ref());
        assert_eq!(state.position_m, DVec3::new(0.128, 0.039, -0.051));
        assert_eq!(state.velocity_m_per_s, DVec3::new(0.01, -0.02, 0.03));
        assert!(state.orientation.unwrap().abs_diff_eq(DQuat::from_xyzw(0.0, 0.6, 0.0, 0.8), 1e-15));
        assert_eq!((state.buttons, state.jaw_opening, update.hindrance), (5, 0.0, None));
        // Without a grip nobody knows where the handle points.
        let later = parse(LATER, Wanted { device_id: Some("04C3"), ..any }).unwrap();
        let state = later.state_with(later.grip.as_ref());
        assert_eq!((later.grip, state.orientation, state.jaw_opening), (None, None, 1.0));
        // The grip that was heard first is kept to.
        let of_grip = |id| parse(FIRST, Wanted { grip_id: Some(id), ..any }).unwrap().grip;
        assert_eq!(of_grip("1102").map(|grip| grip.buttons), Some(5));
        assert_eq!(of_grip("1103"), None);
    }

    #[test]
    fn frames_that_cannot_be_used_are_refused_with_a_reason() {
        let refused = |from: &str, to: &str, reason: &str| {
            assert!(FIRST.contains(from), "{from}");
            let error = parse(&FIRST.replace(from, to), Wanted::default()).unwrap_err();
            assert!(error.contains(reason), "{error}");
        };
        refused("\"x\":0.128", "\"x\":12.8", "beyond what a device reaches");
        refused("\"x\":0.128", "\"x\":1e999", "not a frame");
        refused("\"x\":0.01,", "", "not a frame");
        refused("\"w\":0.8", "\"w\":800", "length");
        refused("\"inverse3\"", "\"minverse\"", "no Inverse3 is connected");
        assert!(
            parse(FIRST, Wanted { device_id: Some("0000"), grip_id: None })
                .unwrap_err()
                .contains("there are: 04C3")
        );
        assert!(
            parse(r#"{"inverse3":[{"device_id":"1"}]}"#, Wanted::default())
                .unwrap_err()
                .contains("no state yet")
        );
        let update =
            parse(&FIRST.replace("\"calibrated\":true", "\"calibrated\":false"), Wanted::default()).unwrap();
        assert!(update.hindrance.unwrap().contains("not calibrated"));
    }

    #[test]
    fn commands_of_both_generations_are_as_published() {
        let force = DVec3::new(1.5, 0.0, -2.0);
        let golden = |generation| -> serde_json::Value {
            serde_json::from_str(&force_command(generation, "04C3", force)).unwrap()
        };
        let vector = r#"{"inverse3":[{"device_id":"04C3","commands":{"set_cursor_force":{"vector":{"x":1.5,"y":0,"z":-2},"execute":true}}}]}"#;
        let values = r#"{"inverse3":[{"device_id":"04C3","commands":{"set_cursor_force":{"values":{"x":1.5,"y":0,"z":-2}}}}]}"#;
        let number = |text: &str| -> serde_json::Value {
            serde_json::from_str(&text.replace(":0,", ":0.0,").replace(":-2}", ":-2.0}")).unwrap()
        };
        assert_eq!(full_state_request(), r#"{"session":{"force_render_full_state":{}}}"#);
        assert_eq!(golden(Generation::Vector), number(vector));
        assert_eq!(golden(Generation::Values), number(values));
    }

    #[test]
    fn the_generation_follows_from_the_version() {
        let of = Generation::of_version;
        for text in ["3.5.0", "{\"version\":\"3.5\"}", "v3.12.1", "4.0", "10.2"] {
            assert_eq!(of(text), Some(Generation::Vector), "{text}");
        }
        for text in ["3.4.9", "{\"version\":\"3.1.0\"}", "2.9", "3"] {
            assert_eq!(of(text), Some(Generation::Values), "{text}");
        }
        assert_eq!((of("none"), of("99999999999.1")), (None, None));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]
        #[test]
        fn mutated_frames_give_a_sound_state_or_a_reason(
            is_first in any::<bool>(),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..5),
            length in any::<prop::sample::Index>(),
            is_cut in any::<bool>(),
        ) {
            let mut bytes = if is_first { FIRST } else { LATER }.as_bytes().to_vec();
            for (at, byte) in changes {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if is_cut {
                bytes.truncate(length.index(bytes.len()));
            }
            match parse(&String::from_utf8_lossy(&bytes), Wanted::default()) {
                Ok(update) => {
                    prop_assert!(update.position_m.is_finite() && update.velocity_m_per_s.is_finite());
                    let turn = update.grip.and_then(|grip| grip.orientation).unwrap_or(DQuat::IDENTITY);
                    prop_assert!((turn.length() - 1.0).abs() < 1e-12);
                }
                Err(reason) => prop_assert!(!reason.is_empty()),
            }
        }
    }
}
