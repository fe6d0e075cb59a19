//! Forces of the reference, stored: F/(E R^2) of a ball of radius R pressed into a bonded block of 100 x 100 x 60 mm with a
//! Poisson's ratio of 0.45, without friction. Stored are those of 80 nodes on a radius of the ball; those of 40 differ by less
//! than 0.1 %, those of 20 by less than 0.4 %. The square block is taken as the cylinder of its cross-section's area: less
//! than 0.5 % of the force (`validate touch_reference`).
//!
//! Two linear solutions. The linear theory loads the shape at rest: each force points along the normal of the surface at rest, and
//! the tissue comes to lie on the ball where it was (Hertz, Sneddon). If the same linear tissue is pushed along the present
//! normals, its rings are driven apart without the resistance that finite strain has: the force is 28 to 33 % lower at a depth of a
//! radius, is greatest at 1.1 radii, and beyond the ball goes through. The forces of finite strain are 2 to
//! 5 % below the linear theory's up to a radius, 8 % at 1.5. So linear models are judged by the linear theory; the other column is told.

use super::{Cylinder, Pressed, Push};
use glisson::material::{LinearElastic, Material, StableNeoHooke};
use std::f64::consts::PI;

/// Poisson's ratio.
pub(in crate::validate) const POISSON_RATIO: f64 = 0.45;
/// Radii of the balls [m].
pub(in crate::validate) const BALLS_M: [f64; 3] = [3e-3, 5e-3, 10e-3];
/// Depths in radii.
pub(in crate::validate) const DEPTHS: [f64; 4] = [0.3, 0.6, 1.0, 1.5];

/// The law of the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::validate) enum Law {
    /// Hooke's law, pushed on the shape at rest.
    Linear,
    /// Hooke's law, pushed on the present shape.
    LinearOnPresentShape,
    /// The stable neo-Hookean law, pushed on the present shape.
    StableNeoHooke,
}

/// Linear tissue that is pushed on its present shape lets the ball through at 1.1 radii: there is no force beyond.
const LAST_ON_PRESENT_SHAPE: f64 = 1.0;

/// Forces by ball and depth.
type Forces = [[f64; DEPTHS.len()]; BALLS_M.len()];

const LINEAR: Forces = [
    [0.27216, 0.75134, 1.55668, 2.71453],
    [0.27612, 0.76610, 1.59364, 2.78570],
    [0.28650, 0.80559, 1.69253, 2.97859],
];
const LINEAR_ON_PRESENT_SHAPE: Forces = [
    [0.26235, 0.66667, 1.11761, f64::NAN],
    [0.26577, 0.67597, 1.12378, f64::NAN],
    [0.27441, 0.69855, 1.13379, f64::NAN],
];
const STABLE_NEO_HOOKE: Forces = [
    [0.26633, 0.72638, 1.47759, 2.49711],
    [0.27014, 0.74046, 1.51167, 2.55837],
    [0.28036, 0.77943, 1.60877, 2.73771],
];

impl Law {
    pub(in crate::validate) const ALL: [Self; 3] =
        [Self::Linear, Self::LinearOnPresentShape, Self::StableNeoHooke];

    pub(in crate::validate) fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::LinearOnPresentShape => "linear, pushed on its present shape",
            Self::StableNeoHooke => "stable neo-Hookean",
        }
    }

    fn forces(self) -> &'static Forces {
        match self {
            Self::Linear => &LINEAR,
            Self::LinearOnPresentShape => &LINEAR_ON_PRESENT_SHAPE,
            Self::StableNeoHooke => &STABLE_NEO_HOOKE,
        }
    }

    /// Longest step of depth in radii: what is linear but for its contact needs few.
    fn longest_step(self) -> f64 {
        match self {
            Self::Linear => 0.5,
            Self::LinearOnPresentShape | Self::StableNeoHooke => 0.1,
        }
    }
}

/// The stored force [E R^2] on a ball of that radius [m] at that depth [radii].
pub(in crate::validate) fn reference_force(law: Law, ball_m: f64, depth: f64) -> Option<f64> {
    let near = |x: f64, y: f64| (x - y).abs() <= 1e-9 * y.abs();
    let ball = BALLS_M.iter().position(|known| near(*known, ball_m))?;
    let depth = DEPTHS.iter().position(|known| near(*known, depth))?;
    Some(law.forces()[ball][depth]).filter(|force| force.is_finite())
}

/// The block's stand-in for a ball of `radius_m`: a cylinder of its height and its cross-section's area.
pub(in crate::validate) fn block(radius_m: f64) -> Cylinder {
    Cylinder { radius: 0.1 / PI.sqrt() / radius_m, height: 0.06 / radius_m }
}

/// Forces [E R^2] at [`DEPTHS`], computed now with `per_radius` nodes on a radius of the ball.
pub(in crate::validate) fn compute(
    law: Law,
    body: Cylinder,
    per_radius: f64,
) -> anyhow::Result<[f64; DEPTHS.len()]> {
    let linear = LinearElastic::from_young_poisson(1.0, POISSON_RATIO, 1.0)?;
    let stable = StableNeoHooke::from(&linear);
    let material: &dyn Material = match law {
        Law::Linear | Law::LinearOnPresentShape => &linear,
        Law::StableNeoHooke => &stable,
    };
    let push = if law == Law::Linear { Push::OnRestShape } else { Push::OnPresentShape };
    let mut pressed = Pressed::new(material, push, body, per_radius);
    let mut forces = [f64::NAN; DEPTHS.len()];
    for (force, depth) in forces.iter_mut().zip(DEPTHS) {
        if law != Law::LinearOnPresentShape || depth <= LAST_ON_PRESENT_SHAPE {
            *force = pressed.press_to(depth, law.longest_step())?;
        }
    }
    Ok(forces)
}
