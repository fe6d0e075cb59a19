//! How places of an instrument move when it turns about its tip.
//!
//! A turn t moves a place with the arm a by t x a where the arm is that of half-way: taken at the beginning of the turn, what is off
//! by half the square of the angle would add up from step to step, and an instrument that is held still would creep along what holds
//! it until friction bears no more. Where something holds it, an instrument turns back by about as much as its hand turned it in the
//! step: half-way is between how it is alone and how it was before.
//!
//! Through a trocar at the distance L from the tip, along the shaft's direction s, a motion d of the tip turns it by -s x d/L: a place
//! with the arm a moves by d (1 - a.s/L) + s (a.d)/L.

use super::vertices::turn_vertex_of;
use crate::contact::constraint::Turn;
use crate::math::{DMat3, DVec3, cross_matrix};
use crate::tool::pose::ToolFrame;
use crate::tool::{Tool, ToolInput};
use crate::world::spec::Hand;

/// An instrument that turns about its tip in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turning {
    vertex: u32,
    tip_m: DVec3,
    /// From how it is alone to how it was before.
    back: DMat3,
}

impl Turning {
    /// Of tool number `place`, before the step and where it is alone.
    pub(super) fn of(place: usize, [before, now]: [&ToolInput; 2]) -> Self {
        let is_turned = before.shaft_in_world != now.shaft_in_world || before.roll_rad != now.roll_rad;
        let back = if is_turned {
            ToolFrame::of(before).world_from_tool * ToolFrame::of(now).world_from_tool.transpose()
        } else {
            DMat3::IDENTITY
        };
        Self { vertex: turn_vertex_of(place), tip_m: now.tip_in_world_m, back }
    }

    /// How a place of it, where it is alone, moves in a contact that begins when this share of the turn is left.
    pub(super) fn at(&self, point_m: DVec3, left: f64) -> Turn {
        let arm_m = point_m - self.tip_m;
        Turn { vertex: self.vertex, arm_m: arm_m + (self.back * arm_m - arm_m) * (0.5 * left) }
    }
}

/// How a hand lets its instrument move in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct HandAnswer {
    /// Of the tip [m/N].
    pub(super) m_per_n: f64,
    pub(super) turns: HandTurns,
}

/// How a hand lets its instrument turn in a step.
#[derive(Clone, Copy, Debug)]
pub(super) enum HandTurns {
    /// About its tip [rad/(N m)].
    Free { rad_per_n_m: f64 },
    /// With its tip, through a trocar: the rotation vector for a motion of the tip [rad/m].
    WithTip { rad_per_m: DMat3 },
}

impl HandAnswer {
    /// Of a tool there, in a step of `dt_s`.
    pub(super) fn of(hand: &Hand, tool: &Tool, [before, now]: [&ToolInput; 2], dt_s: f64) -> Self {
        let m_per_n = 1.0 / hand.step_stiffness_n_per_m(dt_s);
        let turns = match tool.trocar_m {
            None => HandTurns::Free { rad_per_n_m: 1.0 / hand.step_stiffness_n_m_per_rad(dt_s) },
            Some(trocar_m) => {
                let length_m = trocar_m.distance(now.tip_in_world_m);
                // Half-way, as for the arms.
                let shaft = (before.shaft_in_world + now.shaft_in_world).normalize_or(now.shaft_in_world);
                let is_inside = length_m > tool.tip_radius_m;
                let rad_per_m = if is_inside { cross_matrix(shaft) * (-1.0 / length_m) } else { DMat3::ZERO };
                HandTurns::WithTip { rad_per_m }
            }
        };
        Self { m_per_n, turns }
    }
}
