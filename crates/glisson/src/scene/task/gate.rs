//! `[task.gate]`: what must not happen.

use super::super::reader::{SceneError, Section};
use crate::units::Dimension;

/// A safety gate: who goes beyond one of these, or stays below a least one, does not pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GateSource {
    /// Greatest force on an instrument [N].
    pub peak_force_n: Option<f64>,
    /// Blood lost [m3].
    pub blood_m3: Option<f64>,
    /// Tissue taken out [m3].
    pub removed_m3: Option<f64>,
    /// Mistakes.
    pub n_mistakes: Option<u32>,
    /// Times that tissue slipped out of the jaws.
    pub n_slips: Option<u32>,
    /// Least distance of a cut from what is to be excised [m].
    pub least_margin_m: Option<f64>,
}

/// Mistakes and slips are counted up to this.
const MOST: u64 = 1000;

pub(super) fn read_gate(mut section: Section<'_>) -> Result<GateSource, SceneError> {
    let count = |n: Option<u64>| n.map(|n| n as u32);
    let gate = GateSource {
        peak_force_n: section.positive("peak_force", Dimension::Force)?,
        blood_m3: section.positive("blood", Dimension::Volume)?,
        removed_m3: section.positive("removed", Dimension::Volume)?,
        n_mistakes: count(section.whole_number("mistakes", 0..=MOST)?),
        n_slips: count(section.whole_number("slips", 0..=MOST)?),
        least_margin_m: section.positive("margin", Dimension::Length)?,
    };
    section.finish()?;
    Ok(gate)
}
