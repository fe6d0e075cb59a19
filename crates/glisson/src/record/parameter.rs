//! What can be turned while a simulation runs, as sessions and the viewer's protocol name it. All in SI.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;

/// A number of the scene that can be turned while it runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Parameter {
    /// Stiffness of a body's own tissue at small strain [Pa].
    YoungModulus,
    /// How much of its volume that tissue keeps.
    PoissonRatio,
    /// Damping of a body in proportion to its mass [1/s].
    MassDamping,
    /// Damping of a body in proportion to its stiffness [s].
    StiffnessDamping,
    /// Stiffness of the spring between a user's hand and the instrument [N/m].
    HandStiffness,
    /// Damping over stiffness of that spring [s].
    HandReturnTime,
    /// Force at which the hand gives way [N].
    HandGreatestForce,
    /// Size of gravity [m/s2]; its direction stays. Sessions hold it as gravity.
    Gravity,
    /// Time that a step advances [s].
    TimeStep,
}

/// What of a scene a parameter belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterOf {
    /// Each organ has its own, and its model is made anew for another one.
    Body,
    /// The hand, whose next step has it.
    Hand,
    /// All that is around the bodies; holds at once.
    Surroundings,
    /// The whole scene; all models are made anew.
    Scene,
}

impl Parameter {
    /// All of them, in the order in which they are shown.
    pub const ALL: [Self; 9] = [
        Self::YoungModulus,
        Self::PoissonRatio,
        Self::MassDamping,
        Self::StiffnessDamping,
        Self::HandStiffness,
        Self::HandReturnTime,
        Self::HandGreatestForce,
        Self::Gravity,
        Self::TimeStep,
    ];

    /// As sessions and messages write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::YoungModulus => "young_modulus",
            Self::PoissonRatio => "poisson_ratio",
            Self::MassDamping => "mass_damping",
            Self::StiffnessDamping => "stiffness_damping",
            Self::HandStiffness => "hand_stiffness",
            Self::HandReturnTime => "hand_return_time",
            Self::HandGreatestForce => "hand_greatest_force",
            Self::Gravity => "gravity",
            Self::TimeStep => "time_step",
        }
    }

    /// Its SI unit; empty for a plain number.
    pub fn unit(self) -> &'static str {
        match self {
            Self::YoungModulus => "Pa",
            Self::PoissonRatio => "",
            Self::MassDamping => "1/s",
            Self::StiffnessDamping | Self::HandReturnTime | Self::TimeStep => "s",
            Self::HandStiffness => "N/m",
            Self::HandGreatestForce => "N",
            Self::Gravity => "m/s2",
        }
    }

    /// What may be asked for; a model may allow less. Choices: soft tissue is between 100 Pa and 1 MPa, a hand's spring between a
    /// loose grip and a vice.
    pub fn range(self) -> RangeInclusive<f64> {
        match self {
            Self::YoungModulus => 50.0..=1e7,
            Self::PoissonRatio => 0.0..=0.499,
            Self::MassDamping => 0.0..=1e4,
            Self::StiffnessDamping => 0.0..=1.0,
            Self::HandStiffness => 10.0..=1e6,
            Self::HandReturnTime => 1e-5..=1.0,
            Self::HandGreatestForce => 0.01..=1e3,
            Self::Gravity => 0.0..=100.0,
            Self::TimeStep => 1e-4..=0.05,
        }
    }

    /// What it belongs to.
    pub fn of(self) -> ParameterOf {
        match self {
            Self::YoungModulus | Self::PoissonRatio | Self::MassDamping | Self::StiffnessDamping => {
                ParameterOf::Body
            }
            Self::HandStiffness | Self::HandReturnTime | Self::HandGreatestForce => ParameterOf::Hand,
            Self::Gravity => ParameterOf::Surroundings,
            Self::TimeStep => ParameterOf::Scene,
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_names_are_those_of_sessions() {
        for parameter in Parameter::ALL {
            let written = serde_json::to_string(&parameter).unwrap();
            assert_eq!(written, format!("\"{parameter}\""));
        }
    }
}
