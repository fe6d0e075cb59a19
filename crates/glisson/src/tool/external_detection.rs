//! What a search outside of a world found of an instrument and the organ's surface: contact data that come with the hand.
//!
//! In fig. 14 of Cotin, Delingette and Ayache 1998 (RR-3511, s. 6.2) the machine that has the force-feedback device also
//! detects collisions; what crosses to the machine that deforms the organ are the instrument's degrees of freedom and
//! what detection found. A world that is given a [`ExternalDetection`] for an instrument searches nothing for it.

use crate::math::DVec3;
use crate::mesh::TriangleId;
use serde::{Deserialize, Serialize};

/// Parts of an instrument that touch by themselves: tip (or first jaw), second jaw, shaft, in this order.
pub const N_TOUCHING_PARTS: usize = 3;

/// How far weights may add up to something else than 1, and a normal be longer or shorter: rounding of 32-bit numbers.
const ROUNDING: f64 = 1e-5;

/// What of a part touches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum TouchingPoint {
    /// On the axis of the part's capsule: the share from its first end, 0 to 1. The instrument turns in place there.
    OnAxis(f64),
    /// Fixed to the instrument [m, in its frame]: of a tip that is a mesh.
    Fixed(DVec3),
}

/// A part of an instrument that meets the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExternalTouch {
    /// Triangle of the organ's mesh that is touched.
    pub triangle: TriangleId,
    /// Barycentric weights of the touched point, in the order of the triangle's nodes as seen from outside.
    pub weights: [f64; 3],
    /// Unit vector from the tissue to the instrument.
    pub normal: DVec3,
    /// What of the part touches.
    pub at: TouchingPoint,
    /// Gap when it was found [m]: negative when they overlapped before the part moved.
    pub gap_m: f64,
}

/// What was found for an instrument on the surface of one version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExternalDetection {
    /// Version of the surface that was searched; a world whose surface has another one searches by itself.
    pub surface_version: u32,
    /// Part by part; `None` for one that touches nothing.
    pub touches: [Option<ExternalTouch>; N_TOUCHING_PARTS],
}

impl ExternalTouch {
    /// Whether every number is one that a touch can have.
    pub fn is_plausible(&self) -> bool {
        let is_point = match self.at {
            TouchingPoint::OnAxis(along) => (0.0..=1.0).contains(&along),
            TouchingPoint::Fixed(in_tool_m) => in_tool_m.is_finite(),
        };
        is_point
            && self.weights.iter().all(|w| (-ROUNDING..=1.0 + ROUNDING).contains(w))
            && (self.weights.iter().sum::<f64>() - 1.0).abs() <= ROUNDING
            && self.normal.is_finite()
            && (self.normal.length() - 1.0).abs() <= ROUNDING
            && self.gap_m.is_finite()
    }
}

impl ExternalDetection {
    /// Whether every touch is plausible.
    pub fn is_plausible(&self) -> bool {
        self.touches.iter().flatten().all(ExternalTouch::is_plausible)
    }

    /// Whether nothing touches.
    pub fn is_free(&self) -> bool {
        self.touches.iter().all(Option::is_none)
    }
}
