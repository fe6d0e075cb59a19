//! Points of a cut as blends of nodes of the mesh.

use crate::mesh::NodeId;

/// Most nodes of the mesh that a point is a blend of: four, more between points that have moved.
const MAX_PARENTS: usize = 12;

/// A point as a blend of nodes of the mesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blend {
    n: usize,
    nodes: [NodeId; MAX_PARENTS],
    weights: [f64; MAX_PARENTS],
}

impl Blend {
    pub(super) fn of(node: NodeId) -> Self {
        Self::of_corners([node; 4], [1.0, 0.0, 0.0, 0.0])
    }

    /// Of corners of one tetrahedron, those with no weight left out.
    pub(super) fn of_corners(nodes: [NodeId; 4], weights: [f64; 4]) -> Self {
        let mut blend = Self { n: 0, nodes: [nodes[0]; MAX_PARENTS], weights: [0.0; MAX_PARENTS] };
        for (node, weight) in nodes.into_iter().zip(weights) {
            if weight != 0.0 {
                blend.nodes[blend.n] = node;
                blend.weights[blend.n] = weight;
                blend.n += 1;
            }
        }
        blend
    }

    /// The point `share` of the way from `self` to `other`; `None` if that takes too many nodes.
    pub(super) fn towards(&self, other: &Self, share: f64) -> Option<Self> {
        let mut mixed = *self;
        for weight in &mut mixed.weights {
            *weight *= 1.0 - share;
        }
        for (node, weight) in other.parents() {
            if let Some(at) = mixed.nodes[..mixed.n].iter().position(|&n| n == node) {
                mixed.weights[at] += share * weight;
            } else if mixed.n < MAX_PARENTS {
                mixed.nodes[mixed.n] = node;
                mixed.weights[mixed.n] = share * weight;
                mixed.n += 1;
            } else {
                return None;
            }
        }
        Some(mixed)
    }

    pub(super) fn parents(&self) -> impl Iterator<Item = (NodeId, f64)> + '_ {
        self.nodes[..self.n].iter().copied().zip(self.weights)
    }
}
