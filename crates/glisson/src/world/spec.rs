//! What a world is made from, in SI.

use crate::math::{Aabb, DVec3};
use crate::mesh::NodeId;
use crate::tool::Tool;

/// Description of a world; files are read in `scene`.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldSpec {
    /// What the user calls it.
    pub name: String,
    /// Time that one step advances [s].
    pub time_step_s: f64,
    /// Regions whose nodes are held at rest.
    pub fixed: Vec<FixedRegion>,
    /// The instrument.
    pub tool: Tool,
}

/// A region whose nodes are held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixedRegion {
    /// All nodes inside a box.
    Box(Aabb),
    /// All nodes inside a ball.
    Ball {
        /// Centre [m].
        center_m: DVec3,
        /// Radius [m].
        radius_m: f64,
    },
    /// The share of all nodes that lies furthest along a direction, such as the lowest 5 %.
    Furthest {
        /// Direction, any length but zero.
        direction: DVec3,
        /// Between 0 and 1.
        fraction: f64,
    },
}

/// The nodes in any of `regions`, ascending.
pub fn nodes_in(regions: &[FixedRegion], positions_m: &[DVec3]) -> Vec<NodeId> {
    let mut held = vec![false; positions_m.len()];
    for region in regions {
        match *region {
            FixedRegion::Box(bounds) => {
                for (h, &p) in held.iter_mut().zip(positions_m) {
                    *h |= bounds.contains(p);
                }
            }
            FixedRegion::Ball { center_m, radius_m } => {
                for (h, &p) in held.iter_mut().zip(positions_m) {
                    *h |= p.distance(center_m) <= radius_m;
                }
            }
            FixedRegion::Furthest { direction, fraction } => {
                let mut order: Vec<usize> = (0..positions_m.len()).collect();
                let along = |i: &usize| positions_m[*i].dot(direction);
                order.sort_by(|a, b| along(b).total_cmp(&along(a)).then(a.cmp(b)));
                let n = (fraction * positions_m.len() as f64).ceil() as usize;
                for &i in order.iter().take(n) {
                    held[i] = true;
                }
            }
        }
    }
    (0..held.len()).filter(|&i| held[i]).map(NodeId::from_index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_hold_the_nodes_inside_them() {
        let positions: Vec<DVec3> = (0..10).map(|i| DVec3::new(0.0, 0.0, f64::from(i))).collect();
        let ids =
            |regions: &[FixedRegion]| nodes_in(regions, &positions).iter().map(|n| n.0).collect::<Vec<_>>();
        let lowest = FixedRegion::Furthest { direction: -DVec3::Z, fraction: 0.2 };
        let ball = FixedRegion::Ball { center_m: DVec3::new(0.0, 0.0, 8.0), radius_m: 0.5 };
        let bounds = Aabb { min_m: DVec3::new(-1.0, -1.0, 3.5), max_m: DVec3::new(1.0, 1.0, 5.0) };
        assert_eq!(ids(&[lowest]), [0, 1]);
        assert_eq!(ids(&[ball, FixedRegion::Box(bounds)]), [4, 5, 8]);
        assert!(ids(&[]).is_empty());
    }
}
