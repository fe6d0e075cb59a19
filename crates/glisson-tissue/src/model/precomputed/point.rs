//! Imposed displacements of points of the surface, along some directions or all.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// A point of the surface that is held at a displacement, along some directions.
///
/// The point is a weighted mean of up to three nodes: a single node, or a point on a surface triangle. Fixed nodes may be
/// among them; they do not move, and no part of the load acts on them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointConstraint {
    /// The nodes; those of weight zero do not count.
    pub nodes: [NodeId; 3],
    /// Their weights: the barycentric coordinates of a point on a triangle.
    pub weights: [f64; 3],
    /// Displacement of the point from its rest position [m]; only its components along `directions` count.
    pub displacement_m: DVec3,
    /// Held directions, linearly independent and of any length above zero. A zero vector is no direction: a point that slides
    /// on a plane is held along the normal alone.
    pub directions: [DVec3; 3],
}

impl PointConstraint {
    /// A node held along all axes.
    pub fn node(node: NodeId, displacement_m: DVec3) -> Self {
        Self { nodes: [node; 3], weights: [1.0, 0.0, 0.0], displacement_m, directions: DVec3::AXES }
    }

    /// A point on a triangle, held along all axes.
    pub fn on_triangle(nodes: [NodeId; 3], weights: [f64; 3], displacement_m: DVec3) -> Self {
        Self { nodes, weights, displacement_m, directions: DVec3::AXES }
    }

    /// The same point held along these axes alone.
    pub fn along_axes(self, axes: [bool; 3]) -> Self {
        let directions = [0, 1, 2].map(|axis| if axes[axis] { DVec3::AXES[axis] } else { DVec3::ZERO });
        Self { directions, ..self }
    }

    /// The same point held along one direction alone.
    pub fn along(self, direction: DVec3) -> Self {
        Self { directions: [direction, DVec3::ZERO, DVec3::ZERO], ..self }
    }
}
