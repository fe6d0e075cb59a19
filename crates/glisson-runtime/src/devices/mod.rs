//! Force-feedback devices: drivers behind [`glisson::haptics::HapticDevice`], and the names by which a user asks for them.

mod driver;
mod force_dimension;
mod haply;
pub mod lead;
mod openhaptics;
mod replayed;
pub mod trocar_board;
pub mod trocar_choice;
mod vendor;
pub mod viewer;

use crate::open_device::OpenDevice;
use anyhow::{Context, bail, ensure};
use glam::DQuat;
use glisson::haptics::mapping::patient_from_desk;
use glisson::haptics::trocar::Placement;
use glisson::haptics::{HandPath, HandSettings, HapticDevice, SimulatedDevice, SimulatedDeviceSettings};
use glisson::math::{DMat3, DVec3};
use glisson::tool::ToolInput;
use std::path::PathBuf;
use trocar_board::START_INSERTION_M;
use trocar_choice::TrocarChoice;

/// A device as the user names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceName {
    /// A simulated device with a hand that pushes by itself.
    Simulated,
    /// An instrument of a recorded session.
    Replay {
        /// Its file.
        session: PathBuf,
        /// Number of the instrument, from 0.
        tool: usize,
    },
    /// Haply Inverse3 behind the service at `host:port`.
    Haply {
        /// `HOST:PORT` of the service.
        address: String,
    },
    /// A device of Force Dimension's library.
    ForceDimension,
    /// By its name in the maker's configuration; the default one for none.
    OpenHaptics {
        /// Name in the maker's configuration.
        name: Option<String>,
    },
    /// An active trocar behind its board, or a simulated one.
    Trocar(TrocarChoice),
    /// Mouse, keyboard and gamepad of the viewer's page.
    Viewer,
}

impl DeviceName {
    /// For messages.
    pub(crate) fn text(&self) -> String {
        match self {
            Self::Simulated => "simulated device".into(),
            Self::Replay { session, .. } => format!("replay of {}", session.display()),
            Self::Haply { address } => format!("Haply Inverse3 at {address}"),
            Self::ForceDimension => "Force Dimension's device".into(),
            Self::OpenHaptics { name } => {
                format!("OpenHaptics {}", name.as_deref().unwrap_or("default device"))
            }
            Self::Trocar(choice) => choice.text(),
            Self::Viewer => "viewer".into(),
        }
    }
}

/// One kind of device, for lists.
pub struct Kind {
    /// How it is named.
    pub pattern: &'static str,
    /// What it is.
    pub about: &'static str,
}

/// Every kind, in the order of lists.
pub const KINDS: &[Kind] = &[
    Kind { pattern: "simulated", about: "a simulated device with a hand that pushes up and down by itself" },
    Kind {
        pattern: "replay:FILE[:TOOL]",
        about: "an instrument of a recorded session (TOOL from 0; default 0)",
    },
    Kind {
        pattern: "haply[:HOST:PORT]",
        about: "Haply Inverse3 through Haply's Inverse Service (default 127.0.0.1:10001)",
    },
    Kind {
        pattern: "force-dimension",
        about: "omega, delta, sigma, lambda, Falcon through Force Dimension's library",
    },
    Kind {
        pattern: "openhaptics[:NAME]",
        about: "3D Systems Touch, Phantom through the OpenHaptics library",
    },
    Kind {
        pattern: "trocar[:HOST:PORT][,KEY=VALUE ...]",
        about: "the active trocar behind its board; without an address a simulated one in a hand that pushes",
    },
    Kind {
        pattern: "viewer",
        about: "mouse, keyboard and gamepad of the page; its force is shown there, and shakes the gamepad",
    },
];

impl std::str::FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Only its options have commas: a file's name may have some, too.
        if let Some(rest) = text.strip_prefix("trocar")
            && (rest.is_empty() || rest.starts_with([':', ',']))
        {
            return TrocarChoice::parse(rest).map(Self::Trocar);
        }
        let (kind, rest) = text.split_once(':').map_or((text, None), |(kind, rest)| (kind, Some(rest)));
        let without = |name: Self| match rest {
            None => Ok(name),
            Some(rest) => Err(format!("\"{kind}\" takes nothing after it; found \"{rest}\"")),
        };
        match kind {
            "simulated" => without(Self::Simulated),
            "force-dimension" => without(Self::ForceDimension),
            "viewer" => without(Self::Viewer),
            "openhaptics" => Ok(Self::OpenHaptics { name: rest.map(str::to_owned) }),
            "haply" => Ok(Self::Haply { address: host_and_port(rest.unwrap_or(haply::ADDRESS))? }),
            "replay" => {
                let rest =
                    rest.filter(|rest| !rest.is_empty()).ok_or("replay needs a session: replay:FILE")?;
                let (file, tool) = match rest.rsplit_once(':') {
                    Some((file, tool)) if tool.parse::<usize>().is_ok() => (file, tool.parse().unwrap_or(0)),
                    _ => (rest, 0),
                };
                Ok(Self::Replay { session: file.into(), tool })
            }
            other => {
                let known: Vec<&str> = KINDS.iter().map(|kind| kind.pattern).collect();
                let names =
                    ["simulated", "replay", "haply", "force-dimension", "openhaptics", "trocar", "viewer"];
                let hint = glisson::text::did_you_mean(other, &names);
                Err(format!("there is no device \"{other}\"{hint}; known: {}", known.join(", ")))
            }
        }
    }
}

/// Checks that a text is `HOST:PORT`.
///
/// # Errors
/// In words, when it is not.
pub fn host_and_port(text: &str) -> Result<String, String> {
    let is_sound = text
        .rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|p| p > 0));
    if is_sound { Ok(text.to_owned()) } else { Err(format!("\"{text}\" is not HOST:PORT")) }
}

/// Axes of patients from those of Force Dimension's devices: their +x to the user is inferior, +y to his right is the
/// patient's left, +z up is anterior, for a user who looks at a supine patient from the feet.
fn patient_from_force_dimension() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Z, DVec3::X, DVec3::NEG_Y))
}

/// Axes of patients from those of an Inverse3 as its maker ships it: +x to the user's right, +y away from him, +z up; the
/// same user.
fn patient_from_haply() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y))
}

/// How deep the simulated hand pushes beyond where it starts [m], and how often [Hz].
const PUSH_M: f64 = 0.010;
const PUSHES_HZ: f64 = 1.0;

/// A simulated device whose hand pushes along its -z, and the seed of its noise.
pub(crate) fn pushing_device(rate_hz: f64, seed: u64) -> SimulatedDevice {
    let half_m = DVec3::Z * (PUSH_M / 2.0);
    let path = HandPath::Swing { center_m: -half_m, amplitude_m: -half_m, frequency_hz: PUSHES_HZ };
    let settings = SimulatedDeviceSettings { rate_hz, ..SimulatedDeviceSettings::default() };
    SimulatedDevice::new(&settings, &HandSettings::default(), path, seed)
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
    let plain = |device: Box<dyn HapticDevice>, name: &str, world_from_device| OpenDevice {
        device,
        name: name.to_owned(),
        world_from_device,
        has_clutch: true,
        stands: None,
        page: None,
    };
    Ok(match name {
        DeviceName::Simulated => {
            // It pushes along the instrument.
            let along = DQuat::from_rotation_arc(DVec3::Z, home.shaft_in_world.normalize());
            let device = Box::new(pushing_device(rate_hz, 1));
            let plain = plain(device, "simulated", along);
            OpenDevice { has_clutch: false, ..plain }
        }
        DeviceName::Replay { session, tool } => {
            let device = replayed::ReplayedDevice::open(session, *tool, rate_hz)?;
            let name = format!("replay of {}", session.display());
            OpenDevice { has_clutch: false, ..plain(Box::new(device), &name, DQuat::IDENTITY) }
        }
        DeviceName::Haply { address } => plain(haply::open(address)?, "Haply Inverse3", patient_from_haply()),
        DeviceName::ForceDimension => {
            let (device, name) = force_dimension::open(None)?;
            plain(device, &format!("Force Dimension {name}"), patient_from_force_dimension())
        }
        DeviceName::OpenHaptics { name } => {
            let (device, name) = openhaptics::open(name.as_deref(), None)?;
            plain(device, &format!("OpenHaptics {name}"), patient_from_desk())
        }
        DeviceName::Trocar(choice) => {
            let outward = home.shaft_in_world.normalize();
            let deepest_m = choice.profile().insertion_limit_m;
            let insertion_m = stands.map_or(START_INSERTION_M, |stands| {
                stands.pivot_in_world_m.distance(home.tip_in_world_m).min(deepest_m)
            });
            let device = Box::new(choice.open(rate_hz, insertion_m, tool_kind)?);
            // Its axis at rest is the instrument's, into the body.
            let axes = stands.unwrap_or_else(|| Placement::facing(DVec3::ZERO, -outward)).world_from_device;
            let plain = plain(device, &choice.text(), DQuat::from_mat3(&axes));
            OpenDevice { has_clutch: false, stands, ..plain }
        }
        DeviceName::Viewer => {
            let (device, page) = viewer::open(home, rate_hz);
            // Its places are the world's own.
            let stands =
                Some(Placement { pivot_in_world_m: DVec3::ZERO, world_from_device: DMat3::IDENTITY });
            let plain = plain(Box::new(device), "viewer", DQuat::IDENTITY);
            OpenDevice { has_clutch: false, stands, page: Some(page), ..plain }
        }
    })
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

/// A maker's library or service, for `glisson devices doctor`.
pub struct Finding {
    /// What was looked for.
    pub what: String,
    /// Whether it can be used.
    pub is_good: bool,
    /// What was found, or what to do.
    pub text: String,
}

/// Looks for libraries and services, and for a trocar's board where it has an address; opens no device.
pub fn examine(haply_address: &str, trocar_address: Option<&str>) -> Vec<Finding> {
    let of = |what: &str, answer: anyhow::Result<String>| Finding {
        what: what.to_owned(),
        is_good: answer.is_ok(),
        text: answer.unwrap_or_else(|error| format!("{error:#}")),
    };
    let library = |library: &vendor::VendorLibrary| {
        of(library.name, library.load(None).map(|(_, path)| format!("{} can be loaded", path.display())))
    };
    vec![
        of("Haply Inverse Service", haply::examine(haply_address)),
        library(&force_dimension::LIBRARY),
        library(&openhaptics::LIBRARY),
        of(
            "active trocar's board",
            trocar_address.map_or_else(
                || Err(anyhow::anyhow!("not looked for: --trocar HOST:PORT; `trocar` alone is simulated")),
                trocar_board::examine,
            ),
        ),
    ]
}

/// Where Haply's service listens unless told otherwise.
pub const HAPLY_ADDRESS: &str = haply::ADDRESS;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_mistakes_told() {
        let of = |text: &str| text.parse::<Assignment>();
        let name = |text: &str| of(text).unwrap().name;
        assert_eq!(of("simulated@2").unwrap(), Assignment { name: DeviceName::Simulated, tool: Some(2) });
        assert_eq!(name("haply"), DeviceName::Haply { address: "127.0.0.1:10001".into() });
        assert_eq!(name("haply:10.0.0.7:9000"), DeviceName::Haply { address: "10.0.0.7:9000".into() });
        assert_eq!(
            name("openhaptics:Left Device").clone(),
            DeviceName::OpenHaptics { name: Some("Left Device".into()) }
        );
        let session = PathBuf::from("C:a@b/s.jsonl");
        assert_eq!(name("replay:C:a@b/s.jsonl:3"), DeviceName::Replay { session: session.clone(), tool: 3 });
        assert_eq!(name("replay:C:a@b/s.jsonl"), DeviceName::Replay { session, tool: 0 });
        for (bad, part) in [
            ("haptly", "did you mean \"haply\""),
            ("haply:there", "HOST:PORT"),
            ("trocar:there", "HOST:PORT"),
            ("haply:there:0", "HOST:PORT"),
            ("simulated:3", "takes nothing"),
            ("replay:", "replay:FILE"),
            ("", "known: simulated"),
            ("simulated@99999999999999999999999", "no number"),
        ] {
            let error = of(bad).unwrap_err();
            assert!(error.contains(part), "{bad}: {error}");
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
        let name = DeviceName::Trocar(TrocarChoice::default());
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
