//! How thoroughly a model computes its steps: less, when they take longer than the time they simulate.

use serde::{Deserialize, Serialize};

/// How thoroughly steps are computed. Decided outside, because it depends on time that a clock measured; a session records it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LevelOfDetail {
    /// As little as still follows the instruments.
    Least,
    /// Less than it should be.
    Reduced,
    /// As the model was set up.
    #[default]
    Full,
}

impl LevelOfDetail {
    /// For people: the name that sessions write.
    pub fn name(self) -> &'static str {
        match self {
            Self::Least => "least",
            Self::Reduced => "reduced",
            Self::Full => "full",
        }
    }

    /// One step less; the least stays.
    #[must_use]
    pub fn less(self) -> Self {
        match self {
            Self::Full => Self::Reduced,
            Self::Reduced | Self::Least => Self::Least,
        }
    }

    /// One step more; the full one stays.
    #[must_use]
    pub fn more(self) -> Self {
        match self {
            Self::Least => Self::Reduced,
            Self::Reduced | Self::Full => Self::Full,
        }
    }
}
