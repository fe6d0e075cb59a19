//! What a user chooses about how forces are made.

use anyhow::ensure;
use glisson::haptics::{EnergyControl, ForceEstimate, GainShares, LawSettings};

/// How forces are made from models and motions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceChoices {
    /// How the force between two models is estimated.
    pub estimate: ForceEstimate,
    /// Whether the energy given to the hand is limited.
    pub control: EnergyControl,
    /// Shares of the device's gains that are used.
    pub shares: GainShares,
}

impl Default for ForceChoices {
    fn default() -> Self {
        let LawSettings { estimate, control, shares, .. } = LawSettings::default();
        Self { estimate, control, shares }
    }
}

impl ForceChoices {
    /// `settings` with these choices.
    pub(crate) fn into_settings(self, settings: LawSettings) -> LawSettings {
        let Self { estimate, control, shares } = self;
        LawSettings { estimate, control, shares, ..settings }
    }

    /// Whether energy is controlled and not only watched.
    pub fn is_controlled(&self) -> bool {
        self.control == EnergyControl::Tank
    }

    /// For people.
    pub fn text(&self) -> String {
        let estimate = match self.estimate {
            ForceEstimate::LocalModel => "from the local model",
            ForceEstimate::Hold => "held between models",
            ForceEstimate::ExtrapolateInTime => "extrapolated in time",
            ForceEstimate::ExtrapolateInPosition => "extrapolated in position",
        };
        let control = if self.is_controlled() { "on" } else { "off" };
        let GainShares { stiffness, damping, injected } = self.shares;
        format!(
            "{estimate}, energy control {control}, coupling {:.0} % of the device's stiffness and {:.0} % of its damping \
             ({:.0} % for control)",
            100.0 * stiffness,
            100.0 * damping,
            100.0 * injected
        )
    }
}

/// How the loop gets from published models to the force now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum EstimateName {
    /// From the tissue's local model (its geometry and stiffness at the tip)
    #[value(alias = "local_model")]
    Local,
    /// The last force
    Hold,
    /// Along the last two forces, by time
    #[value(alias = "extrapolate_in_time")]
    Time,
    /// Along the last two forces, by the tip's position
    #[value(alias = "extrapolate_in_position")]
    Position,
}

/// Whether the energy tank controls or only watches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Switch {
    On,
    Off,
}

/// How forces are made.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Forces on devices")]
pub struct ForceArgs {
    /// How forces are made between two steps of the simulation
    #[arg(long, value_enum, value_name = "HOW", default_value = "local")]
    force_estimate: EstimateName,
    /// Whether a device gives a hand no more energy than it got, but for 10 mJ; off to compare: it may then vibrate
    #[arg(long, value_enum, value_name = "ON", default_value = "on")]
    energy_control: Switch,
    /// Share of the device's largest stiffness for the spring between hand and instrument: how stiff tissue can feel
    #[arg(long, value_name = "SHARE", default_value_t = GainShares::default().stiffness)]
    coupling_stiffness: f64,
    /// Share of the device's largest damping for the damper beside that spring
    #[arg(long, value_name = "SHARE", default_value_t = GainShares::default().damping)]
    coupling_damping: f64,
    /// Share of the device's largest damping that energy control may add
    #[arg(long, value_name = "SHARE", default_value_t = GainShares::default().injected)]
    control_damping: f64,
}

impl ForceArgs {
    /// The choices.
    ///
    /// # Errors
    /// For shares that no device has room for.
    pub fn choices(&self) -> anyhow::Result<ForceChoices> {
        let (stiffness, damping, injected) =
            (self.coupling_stiffness, self.coupling_damping, self.control_damping);
        for (name, share) in [
            ("--coupling-stiffness", stiffness),
            ("--coupling-damping", damping),
            ("--control-damping", injected),
        ] {
            ensure!(
                (0.0..=1.0).contains(&share),
                "{name} {share}: must be 0 to 1, a share of what the device can"
            );
        }
        ensure!(
            stiffness > 0.0,
            "--coupling-stiffness 0: without a spring there is no force; must be above 0"
        );
        let sum = stiffness + damping + injected;
        ensure!(
            sum <= 1.0 + ROUNDING,
            "--coupling-stiffness {stiffness}, --coupling-damping {damping} and --control-damping {injected} add up to \
             {sum:.3}: a device renders at most 1"
        );
        let estimate = match self.force_estimate {
            EstimateName::Local => ForceEstimate::LocalModel,
            EstimateName::Hold => ForceEstimate::Hold,
            EstimateName::Time => ForceEstimate::ExtrapolateInTime,
            EstimateName::Position => ForceEstimate::ExtrapolateInPosition,
        };
        let control = match self.energy_control {
            Switch::On => EnergyControl::Tank,
            Switch::Off => EnergyControl::ObserveOnly,
        };
        Ok(ForceChoices { estimate, control, shares: GainShares { stiffness, damping, injected } })
    }
}

/// Of a sum of three shares.
const ROUNDING: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        forces: ForceArgs,
    }

    fn choices(arguments: &[&str]) -> Result<ForceChoices, String> {
        let line = std::iter::once(&"glisson").chain(arguments);
        let line = Line::try_parse_from(line).map_err(|e| e.to_string())?;
        line.forces.choices().map_err(|e| e.to_string())
    }

    #[test]
    fn every_estimate_can_be_chosen_by_its_short_and_its_long_name() {
        assert_eq!(choices(&[]).unwrap(), ForceChoices::default());
        for (short, estimate) in ["hold", "time", "position", "local"].into_iter().zip(ForceEstimate::ALL) {
            for name in [short, estimate.name()] {
                assert_eq!(choices(&["--force-estimate", name]).unwrap().estimate, estimate, "{name}");
            }
        }
        let off =
            choices(&["--energy-control", "off", "--coupling-stiffness", "0.8", "--control-damping", "0.1"]);
        let settings = off.unwrap().into_settings(LawSettings::default());
        assert_eq!(settings.control, EnergyControl::ObserveOnly);
        assert_eq!(settings.shares, GainShares { stiffness: 0.8, damping: 0.1, injected: 0.1 });
    }

    #[test]
    fn mistakes_are_told_with_what_is_allowed() {
        for (bad, part) in [
            (["--force-estimate", "guess"], "[possible values: local, hold, time, position]"),
            (["--energy-control", "maybe"], "[possible values: on, off]"),
            (["--coupling-stiffness", "0"], "must be above 0"),
            (["--coupling-damping", "1.5"], "must be 0 to 1"),
            (["--coupling-stiffness", "0.9"], "add up to 1.300: a device renders at most 1"),
            (["--control-damping", "nan"], "must be 0 to 1"),
        ] {
            let error = choices(&bad).unwrap_err();
            assert!(error.contains(part), "{bad:?}: {error}");
        }
    }

    #[test]
    fn what_is_chosen_is_told() {
        let text = choices(&["--force-estimate", "time", "--energy-control", "off"]).unwrap().text();
        assert_eq!(
            text,
            "extrapolated in time, energy control off, coupling 60 % of the device's stiffness and 10 % of its damping \
             (30 % for control)"
        );
    }
}
