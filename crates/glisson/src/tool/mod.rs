//! Instruments: what they are, where they are.

pub mod cut;

use crate::math::DVec3;
use serde::{Deserialize, Serialize};

/// A rigid straight instrument that ends in a ball: a probe for palpation.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool {
    /// What the user calls it.
    pub name: String,
    /// Radius of the ball at the tip [m].
    pub tip_radius_m: f64,
    /// Radius of the shaft [m].
    pub shaft_radius_m: f64,
    /// Length of the shaft [m].
    pub shaft_length_m: f64,
    /// Where the tool is when nobody holds it.
    pub home: ToolInput,
}

/// Where a tool is in one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToolInput {
    /// Centre of the tip [m].
    pub tip_in_world_m: DVec3,
    /// Unit vector from the tip towards the handle.
    pub shaft_in_world: DVec3,
}

impl ToolInput {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.tip_in_world_m.is_finite() && self.shaft_in_world.is_finite()
    }
}
