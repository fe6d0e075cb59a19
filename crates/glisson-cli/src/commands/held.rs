//! Devices that take instruments of a scene into the hand: options and opening.

use glisson::haptics::InsertedInstrument;
use glisson::tool::Tool;
use glisson_runtime::devices::trocar_choice::stand;
use glisson_runtime::devices::{self, Assignment, tools_of};
use glisson_runtime::force_choices::ForceArgs;
use glisson_runtime::haptic_loop::{HapticSettings, HeldTool, ToolLink, check_rate, join};
use glisson_runtime::realtime::{CoreKept, OwnCore, make_punctual};
use glisson_runtime::workers::allowed_cores;

/// Which devices hold instruments, and how their loop runs.
#[derive(Debug, clap::Args)]
pub(super) struct DeviceArgs {
    /// Put an instrument into the hand at a device: NAME, or NAME@TOOL with TOOL from 0; may be given several times. `glisson
    /// devices list` tells the names
    #[arg(long = "device", value_name = "NAME[@TOOL]")]
    pub(super) devices: Vec<Assignment>,
    /// Ticks a second of the haptic loop [Hz]: 100 to 4000
    #[arg(long, value_name = "HZ", default_value_t = 1000.0)]
    haptic_rate: f64,
    /// Core that the haptic loop stays on, and the program's other threads do not use; the last one that it may use when left
    /// out
    #[arg(long, value_name = "N")]
    haptic_core: Option<usize>,
    #[command(flatten)]
    forces: ForceArgs,
}

impl DeviceArgs {
    /// The instruments that devices hold; tells which, and how their loop will run on `core`.
    pub(super) fn held(
        &self,
        instruments: &[Tool],
        core: OwnCore,
    ) -> anyhow::Result<Vec<(HeldTool, ToolLink)>> {
        let mut held = Vec::new();
        check_rate(self.haptic_rate)?;
        let tools = tools_of(&self.devices, instruments.len())?;
        let named: Vec<_> = self.devices.iter().map(|assignment| &assignment.name).zip(tools).collect();
        let stands = stand(&named, instruments)?;
        for ((name, tool), stands) in named.into_iter().zip(stands) {
            let home = instruments[tool].home;
            let kind = Some(instruments[tool].kind.name());
            let device = devices::open_standing(name, &home, kind, stands, self.haptic_rate)?;
            println!("instrument {tool} ({}) is in the hand of: {}", instruments[tool].name, device.name);
            if let Some(InsertedInstrument { name, serial }) = device.device.inserted() {
                println!("  the instrument in it: {name}, number {serial}");
            }
            held.push(join(device, tool, home));
        }
        if !held.is_empty() {
            println!("forces {} times a second: {}", self.haptic_rate, self.forces.choices()?.text());
            // A thread that asks for what the loop will ask for: the user hears of it now, not in the report at the end.
            if let Ok(scheduling) = std::thread::spawn(move || make_punctual(core)).join() {
                println!("the loop of the devices: {}", scheduling.text);
            }
        }
        Ok(held)
    }

    /// The core of the loop, taken before anything else is started; none without devices.
    pub(super) fn keep_core(&self) -> Option<CoreKept> {
        (!self.devices.is_empty()).then(|| CoreKept::keep(self.haptic_core))
    }

    /// How the loop runs on its core.
    pub(super) fn settings(&self, core: OwnCore) -> anyhow::Result<HapticSettings> {
        check_rate(self.haptic_rate)?;
        Ok(HapticSettings { rate_hz: self.haptic_rate, core, forces: self.forces.choices()? })
    }

    /// Threads of the simulation: no more than cores that are left beside the loop's, where each waits for the others. Tells
    /// when these are fewer than asked for.
    pub(super) fn n_threads(&self, asked: u8, core: OwnCore) -> usize {
        let asked = usize::from(asked);
        let n_left = allowed_cores().len();
        if !matches!(core, OwnCore::Kept(_)) || asked <= n_left {
            return asked;
        }
        println!(
            "--threads {asked}: beside the core of the devices' loop there are {n_left}, so as many are used"
        );
        n_left
    }
}
