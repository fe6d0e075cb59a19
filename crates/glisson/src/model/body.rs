//! How a body is held, loaded at rest and damped: what every dynamic model takes beside its law.

use crate::math::DVec3;
use crate::mesh::{NodeId, TetMesh};

/// A node that is held at rest along some axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FixedNode {
    /// Which node.
    pub node: NodeId,
    /// Which of x, y, z do not move.
    pub axes: [bool; 3],
}

impl FixedNode {
    /// A node that does not move at all.
    pub fn all_axes(node: NodeId) -> Self {
        Self { node, axes: [true; 3] }
    }
}

/// A ligament: a spring from a node to a point of the surroundings that does not move. It pulls when it is longer
/// than at rest and never pushes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attachment {
    /// Which node.
    pub node: NodeId,
    /// Where it begins in the surroundings [m].
    pub anchor_m: DVec3,
    /// Length up to which it is slack [m].
    pub slack_length_m: f64,
    /// Stiffness [N/m].
    pub stiffness_n_per_m: f64,
}

impl Attachment {
    /// Force [N] on the node when it is at `position_m`.
    pub fn force_n(&self, position_m: DVec3) -> DVec3 {
        let span_m = self.anchor_m - position_m;
        let length_m = span_m.length();
        if length_m <= self.slack_length_m || length_m == 0.0 {
            return DVec3::ZERO;
        }
        span_m * (self.stiffness_n_per_m * (length_m - self.slack_length_m) / length_m)
    }
}

/// Rayleigh damping: C = mass_per_s M + stiffness_s K (Rayleigh 1877, The Theory of Sound, s. 97).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rayleigh {
    /// Factor of the mass [1/s]: a free slow motion decays as exp(-mass_per_s t/2).
    pub mass_per_s: f64,
    /// Factor of the stiffness [s]: damps fast motions.
    pub stiffness_s: f64,
}

/// Second Piola-Kirchhoff stress that a tetrahedron has in the rest shape [Pa]: xx, yy, zz, xy, xz, yz.
pub type RestStress = [f64; 6];

/// What every dynamic model takes beside its law.
#[derive(Clone, Copy, Debug)]
pub struct DynamicBody<'a> {
    /// The body at rest; every tetrahedron counts.
    pub mesh: &'a TetMesh,
    /// Density [kg/m3].
    pub density_kg_per_m3: f64,
    /// Nodes that are held at rest along some or all axes; each at most once.
    pub fixed: &'a [FixedNode],
    /// Ligaments.
    pub attachments: &'a [Attachment],
    /// Stress in the rest shape, one a tetrahedron or none. With the equilibrating one
    /// (`solve::equilibrating_stress`) the rest shape is the loaded one.
    pub rest_stress_pa: &'a [RestStress],
    /// Gravity [m/s2].
    pub gravity_m_per_s2: DVec3,
    /// Damping.
    pub damping: Rayleigh,
    /// Largest internal step [s].
    pub time_step_s: f64,
    /// Into how many internal steps of at least `time_step_s / most_parts` the time step may be divided after an
    /// edit that made the stable step shorter. Where that is not enough, the masses of the limiting tetrahedra
    /// are scaled up, which [`super::ModelReport`] names. At least 1.
    pub most_parts: u32,
}

impl<'a> DynamicBody<'a> {
    /// A body without supports, loads and damping, at 1 ms.
    pub fn new(mesh: &'a TetMesh, density_kg_per_m3: f64) -> Self {
        Self {
            mesh,
            density_kg_per_m3,
            fixed: &[],
            attachments: &[],
            rest_stress_pa: &[],
            gravity_m_per_s2: DVec3::ZERO,
            damping: Rayleigh::default(),
            time_step_s: 1e-3,
            most_parts: DEFAULT_MOST_PARTS,
        }
    }
}

/// Enough for the bound that holds after any cuts, which is about half of the uncut step, with room to spare.
pub const DEFAULT_MOST_PARTS: u32 = 4;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ligament_pulls_when_taut_and_never_pushes() {
        let ligament = Attachment {
            node: NodeId(0),
            anchor_m: DVec3::new(0.0, 0.0, 0.1),
            slack_length_m: 0.05,
            stiffness_n_per_m: 100.0,
        };
        assert_eq!(ligament.force_n(DVec3::new(0.0, 0.0, 0.06)), DVec3::ZERO);
        assert_eq!(ligament.force_n(ligament.anchor_m), DVec3::ZERO);
        let force_n = ligament.force_n(DVec3::ZERO);
        assert!((force_n - DVec3::new(0.0, 0.0, 5.0)).length() < 1e-12, "{force_n}");
    }
}
