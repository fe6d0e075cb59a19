//! Force-feedback devices: drivers behind [`glisson::haptics::HapticDevice`], and the names by which a user asks for them.

mod kind;
mod driver;
mod force_dimension;
mod haply;
pub mod lead;
mod openhaptics;
mod replayed;
mod simulated;
pub mod trocar_board;
pub mod trocar_choice;
mod vendor;
pub mod viewer;

pub use kind::{DeviceChoice, DeviceKind, DeviceName, Finding, OpenRequest, host_and_port};

use crate::open_device::OpenDevice;
use anyhow::{Context, bail, ensure};
use glisson::haptics::trocar::Placement;
use glisson::tool::ToolInput;

/// Every kind of device, in the order of lists: one line a kind, whose description is in its own file (docs/extending.md).
pub const KINDS: &[DeviceKind] = &[
    simulated::KIND,
    replayed::KIND,
    haply::KIND,
    force_dimension::KIND,
    openhaptics::KIND,
    trocar_choice::KIND,
    viewer::KIND,
];

impl std::str::FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let after = |kind: &DeviceKind| {
            let rest = text.strip_prefix(kind.name)?;
            (rest.is_empty() || rest.starts_with([':', ','])).then_some(rest)
        };
        match KINDS.iter().find_map(|kind| after(kind).map(|rest| (kind, rest))) {
            Some((kind, rest)) => Ok(Self { kind, choice: (kind.parse)(rest)? }),
            None => {
                let found = text.split_once(':').map_or(text, |(name, _)| name);
                let names: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
                let known: Vec<&str> = KINDS.iter().map(|kind| kind.pattern).collect();
                let hint = glisson::text::did_you_mean(found, &names);
                Err(format!("there is no device \"{found}\"{hint}; known: {}", known.join(", ")))
            }
        }
    }
}

/// Opens a device for an instrument whose home is `home`.
///
/// # Errors
/// When it is not there, with what to do.
pub fn open(name: &DeviceName, home: &ToolInput, rate_hz: f64) -> anyhow::Result<OpenDevice> {
    open_standing(name, home, None, None, rate_hz)
}

/// The same for an active trocar that stands there, and a scene's instrument of that kind.
///
/// # Errors
/// When it is not there, or the instrument in it is of another kind; with what to do.
pub fn open_standing(
    name: &DeviceName,
    home: &ToolInput,
    tool_kind: Option<&'static str>,
    stands: Option<Placement>,
    rate_hz: f64,
) -> anyhow::Result<OpenDevice> {
    name.choice.open(&OpenRequest { home, tool_kind, stands, rate_hz })
}

/// Which device holds which instrument, as on the command line: `NAME` or `NAME@TOOL`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// Which device.
    pub name: DeviceName,
    /// Number of the instrument, from 0; the next free one for none.
    pub(crate) tool: Option<usize>,
}

impl std::str::FromStr for Assignment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, tool) = match text.rsplit_once('@') {
            Some((name, tool)) if tool.bytes().all(|b| b.is_ascii_digit()) && !tool.is_empty() => {
                let tool = tool.parse().map_err(|_| format!("\"{tool}\" is no number of an instrument"))?;
                (name, Some(tool))
            }
            _ => (text, None),
        };
        Ok(Self { name: name.parse()?, tool })
    }
}

/// The instrument of each assignment.
///
/// # Errors
/// For an instrument that the scene does not have, or two devices for one.
pub fn tools_of(assignments: &[Assignment], n_tools: usize) -> anyhow::Result<Vec<usize>> {
    let mut taken: Vec<usize> = assignments.iter().filter_map(|a| a.tool).collect();
    let mut tools = Vec::new();
    for assignment in assignments {
        let tool = match assignment.tool {
            Some(tool) => tool,
            None => {
                let free = (0..n_tools).find(|tool| !taken.contains(tool));
                let free = free.with_context(|| {
                    format!("{} devices, but the scene has {n_tools} instruments", assignments.len())
                })?;
                taken.push(free);
                free
            }
        };
        ensure!(tool < n_tools, "there is no instrument {tool}: the scene has {n_tools}, numbered from 0");
        if tools.contains(&tool) {
            bail!("two devices hold instrument {tool}");
        }
        tools.push(tool);
    }
    Ok(tools)
}

/// Looks for libraries and services, and for a trocar's board where it has an address; opens no device.
pub fn examine(haply_address: &str, trocar_address: Option<&str>) -> Vec<Finding> {
    let given = [(haply::KIND.name, Some(haply_address)), (trocar_choice::KIND.name, trocar_address)];
    let address_of = |kind: &DeviceKind| given.iter().find(|(name, _)| *name == kind.name)?.1;
    KINDS.iter().filter_map(|kind| Some(kind.examine?(address_of(kind)))).collect()
}

/// Where Haply's service listens unless told otherwise.
pub const HAPLY_ADDRESS: &str = haply::ADDRESS;

#[cfg(test)]
mod tests {
    use super::force_dimension::patient_from_force_dimension;
    use super::haply::patient_from_haply;
    use super::*;
    use glisson::math::DVec3;

    #[test]
    fn names_are_read_and_mistakes_told() {
        let of = |text: &str| text.parse::<Assignment>();
        let name = |text: &str| of(text).unwrap().name;
        let held = of("simulated@2").unwrap();
        assert!(held.name.is("simulated") && held.tool == Some(2));
        let alike = |a: &str, b: &str| name(a) == name(b);
        assert!(alike("haply", "haply:127.0.0.1:10001") && !alike("haply", "haply:10.0.0.7:9000"));
        assert_eq!(name("haply:10.0.0.7:9000").text(), "Haply Inverse3 at 10.0.0.7:9000");
        assert_eq!(name("openhaptics:Left Device").text(), "OpenHaptics Left Device");
        assert_eq!(name("openhaptics").text(), "OpenHaptics default device");
        // A session's name may have colons, the last number is the instrument's.
        assert_eq!(name("replay:C:a@b/s.jsonl:3").text(), "replay of C:a@b/s.jsonl");
        assert!(alike("replay:C:a@b/s.jsonl:0", "replay:C:a@b/s.jsonl") && !alike("replay:s:3", "replay:s"));
        for (bad, part) in [
            ("haptly", "did you mean \"haply\""),
            ("haply:there", "HOST:PORT"),
            ("trocar:there", "HOST:PORT"),
            ("haply:there:0", "HOST:PORT"),
            ("simulated:3", "\"simulated\" takes nothing after it; found \"3\""),
            ("simulator", "did you mean \"simulated\""),
            ("replay:", "replay:FILE"),
            ("", "known: simulated"),
            ("simulated@99999999999999999999999", "no number"),
        ] {
            let error = of(bad).unwrap_err();
            assert!(error.contains(part), "{bad}: {error}");
        }
    }

    #[test]
    fn the_table_of_kinds_is_sound() {
        for (place, kind) in KINDS.iter().enumerate() {
            let first = KINDS.iter().position(|other| other.name == kind.name);
            assert!(first == Some(place) && kind.pattern.starts_with(kind.name), "{}", kind.name);
            assert!(!kind.about.is_empty(), "{}", kind.name);
            let read: Result<DeviceName, String> = kind.name.parse();
            // A kind that needs more says what.
            assert!(read.map_or_else(|error| error.contains(kind.name), |name| name.is(kind.name)));
        }
    }

    #[test]
    fn each_instrument_has_one_device() {
        let tools = |names: &[&str], n| {
            let list: Vec<Assignment> = names.iter().map(|name| name.parse().unwrap()).collect();
            tools_of(&list, n).map_err(|e| e.to_string())
        };
        assert_eq!(tools(&["simulated", "simulated@0", "haply"], 3), Ok(vec![1, 0, 2]));
        assert!(tools(&["simulated@1", "haply@1"], 2).unwrap_err().contains("two devices hold instrument 1"));
        assert!(tools(&["simulated@2"], 2).unwrap_err().contains("the scene has 2"));
        assert!(tools(&["simulated", "haply"], 1).unwrap_err().contains("has 1 instruments"));
    }

    #[test]
    fn mappings_turn_axes_without_mirroring_them() {
        for (turn, to_user) in
            [(patient_from_force_dimension(), DVec3::X), (patient_from_haply(), DVec3::NEG_Y)]
        {
            assert!((turn.length() - 1.0).abs() < 1e-15);
            // To the user is to the patient's feet, up is to the front.
            assert!((turn * to_user).abs_diff_eq(DVec3::NEG_Z, 1e-15));
            assert!((turn * DVec3::Z).abs_diff_eq(DVec3::NEG_Y, 1e-15));
        }
    }

    #[test]
    fn a_simulated_trocar_points_where_the_instrument_does_and_stands_where_it_is_put() {
        let name: DeviceName = "trocar".parse().unwrap();
        let home = ToolInput::at(DVec3::new(0.01, 0.02, 0.03), DVec3::new(0.0, -0.6, 0.8));
        let tip_m = |opened: &mut OpenDevice| {
            let state = opened.device.read().unwrap();
            let shaft = opened.world_from_device * state.orientation.unwrap() * DVec3::Z;
            assert!(shaft.distance(home.shaft_in_world) < 1e-2, "{shaft}");
            let mapping = opened.mapping(state.position_m, &home);
            mapping.world_origin_m + opened.world_from_device * (state.position_m - mapping.device_origin_m)
        };
        let mut opened = open(&name, &home, 1_000.0).unwrap();
        assert!(tip_m(&mut opened).distance(home.tip_in_world_m) < 1e-12);
        // 80 mm up the shaft: the tip of an instrument that is as far in is at the home.
        let pivot_m = home.tip_in_world_m + home.shaft_in_world * 0.08;
        let stands = Some(Placement::facing(pivot_m, -home.shaft_in_world));
        let mut opened = open_standing(&name, &home, Some("probe"), stands, 1_000.0).unwrap();
        assert!(tip_m(&mut opened).distance(home.tip_in_world_m) < 5e-4);
    }

    #[test]
    fn a_doctor_finds_no_vendor_here_and_says_what_to_do() {
        // Nobody listens on port 1.
        let findings = examine("127.0.0.1:1", Some("127.0.0.1:1"));
        assert_eq!(findings.len(), 4);
        let board = &findings[3];
        assert!(!board.is_good && board.text.contains("cannot connect to the board"), "{}", board.text);
        assert!(examine("127.0.0.1:1", None)[3].text.contains("--trocar HOST:PORT"));
        assert!(!findings[0].is_good && findings[0].text.contains("Inverse Service"), "{}", findings[0].text);
    }
}
