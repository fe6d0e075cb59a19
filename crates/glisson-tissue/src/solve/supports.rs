//! Supports, ligaments and stress at rest, for statics and dynamics.

use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;

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
    /// Its fixed end in the surroundings [m].
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

/// Second Piola-Kirchhoff stress that a tetrahedron has in the rest shape [Pa]: xx, yy, zz, xy, xz, yz.
pub type RestStress = [f64; 6];

/// A rest stress as the symmetric tensor it stands for.
pub fn stress_tensor_pa([xx, yy, zz, xy, xz, yz]: RestStress) -> DMat3 {
    DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz))
}

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
