//! The instruments of a seed: what they are, not what hands do with them.

use super::draw::Draw;
use glisson::tool::{Blade, Burnt, CutRule, Grip, Jaws, Snip, Tool, ToolInput, ToolKind, ToolShape};

const JAWS: Jaws = Jaws { length_m: 0.02, width_m: 6e-3, greatest_opening_rad: 1.0, closing_force_n: 20.0 };
pub(super) const TIP_RADIUS_M: f64 = 1.5e-3;
/// Steps with the current on that take away what a hook touches.
const STEPS_TO_CUT: f64 = 5.0;
/// Energy of a cautery in a step [J]: it parts a tetrahedron within some steps, as no device does.
const ENERGY_OF_STEP_J: f64 = 1.6;

pub(super) const GRASPER: usize = 0;
pub(super) const HOT: usize = 1;
pub(super) const SCISSORS: usize = 2;
pub(super) const SCALPEL: usize = 3;
pub(super) const N_TOOLS: usize = 4;

/// A grasper, a hook or cautery, scissors and a scalpel of one of two kinds, for a mesh with edges of `mean_edge_m`.
pub(super) fn tools(draw: &Draw, mean_edge_m: f64, time_step_s: f64, home: ToolInput) -> [Tool; N_TOOLS] {
    let at_once = CutRule {
        least_force_n: 1e-4,
        least_time_s: STEPS_TO_CUT * time_step_s,
        power_w: 0.0,
        takes: Burnt::Tetrahedra,
    };
    let hot = CutRule { power_w: ENERGY_OF_STEP_J / time_step_s, ..at_once };
    let burns = if draw.burns_with_hook { ToolKind::hook(at_once) } else { ToolKind::cautery(JAWS, hot) };
    let scalpel =
        ToolKind::scalpel(Blade { length_m: 4.0 * mean_edge_m, edge_radius_m: 0.0, cuts: draw.blade_cuts });
    let tool = |name: &str, kind: ToolKind, tip_radius_m: f64| Tool {
        kind,
        shape: ToolShape::Capsules,
        grip: Grip { friction_coefficient: 1.0, is_sticky: true },
        ..Tool::probe(name, tip_radius_m, home)
    };
    [
        tool("grasper", ToolKind::grasper(JAWS), 3e-3),
        tool("hot tip", burns, TIP_RADIUS_M),
        tool("scissors", ToolKind::scissors(JAWS, Snip::beside(draw.blade_cuts)), TIP_RADIUS_M),
        tool("scalpel", scalpel, 2e-4),
    ]
}
