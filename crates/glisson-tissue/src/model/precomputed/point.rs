//! Imposed displacements of points of the surface, along some directions or all.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;

/// A point of the surface that is held at a displacement, along some directions.
///
/// The point is a weighted mean of up to three nodes: a node by itself, or a place on a surface triangle. Fixed nodes
/// may be among them; they do not move and bear no part of the load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointConstraint {
    /// The nodes; those of weight zero do not count.
    pub nodes: [NodeId; 3],
    /// Their weights; the barycentric coordinates of a place on a triangle.
    pub weights: [f64; 3],
    /// Displacement of the point from its place at rest [m]; only its components along `directions` count.
    pub displacement_m: DVec3,
    /// What is held: directions of any length above zero that are independent of each other. One that is zero is
    /// free: a point that slides on a plane is held along its normal alone.
    pub directions: [DVec3; 3],
}

impl PointConstraint {
    /// A node held along all axes.
    pub fn node(node: NodeId, displacement_m: DVec3) -> Self {
        Self { nodes: [node; 3], weights: [1.0, 0.0, 0.0], displacement_m, directions: DVec3::AXES }
    }

    /// A place on a triangle held along all axes.
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
