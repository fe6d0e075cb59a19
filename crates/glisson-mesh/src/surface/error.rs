//! What can be wrong with a surface, or with the mask it should come from.

use std::fmt;

use crate::image::topology::TopologyError;
use crate::math::DVec3;

/// A point in metres, shown in millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place(pub DVec3);

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mm = 1e3 * self.0;
        write!(f, "({:.3}, {:.3}, {:.3}) mm", mm.x, mm.y, mm.z)
    }
}

/// Why there is no closed surface.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// The mask cannot become a ball.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// The organ is cut off by the end of the image.
    #[error(
        "the label touches the {side} end of image axis {axis} with {n_voxels} voxels: the organ is cut off \
         there. Use an image that holds all of it, or allow a flat face (`glisson mesh --cut-at-border`)"
    )]
    TouchesBorder {
        /// Image axis: i, j or k.
        axis: char,
        /// `lower` or `upper`.
        side: &'static str,
        /// Voxels of the label in the border layer.
        n_voxels: usize,
    },
    /// The repair would not resemble the mask.
    #[error(
        "making the label one piece without tunnels would change {changed} of its {voxels} voxels, more than \
         the allowed {allowed}: clean the label first (`glisson segment`), or allow more"
    )]
    RepairTooLarge {
        /// Voxels added and removed.
        changed: usize,
        /// Voxels of the mask.
        voxels: usize,
        /// Largest allowed number of changed voxels.
        allowed: usize,
    },
    /// No triangle.
    #[error("the surface has no triangle")]
    Empty,
    /// A corner that does not exist.
    #[error(
        "triangle {triangle} names vertex {vertex}, but there are {n_vertices} vertices (counted from 0)"
    )]
    NoSuchVertex {
        /// Which triangle, from 0.
        triangle: usize,
        /// The index found.
        vertex: u32,
        /// Number of vertices.
        n_vertices: usize,
    },
    /// A coordinate that is not a finite number.
    #[error("vertex {vertex} has the position {found_m:?} m; coordinates must be finite")]
    NotFinite {
        /// Which vertex, from 0.
        vertex: usize,
        /// Its position [m].
        found_m: DVec3,
    },
    /// A triangle without area.
    #[error(
        "triangle {triangle} (vertices {vertices:?}) at {place} has no area; remove it and join its neighbours"
    )]
    Degenerate {
        /// Which triangle, from 0.
        triangle: usize,
        /// Its vertices.
        vertices: [u32; 3],
        /// Its first corner.
        place: Place,
    },
    /// An edge of one triangle only.
    #[error(
        "the surface is not closed: edge {vertices:?} at {place} belongs to triangle {triangle} only ({n_open} such edges)"
    )]
    OpenEdge {
        /// Its end vertices.
        vertices: [u32; 2],
        /// Its only triangle.
        triangle: usize,
        /// Its middle.
        place: Place,
        /// Number of open edges of the surface.
        n_open: usize,
    },
    /// An edge of more than two triangles.
    #[error(
        "edge {vertices:?} at {place} belongs to {n_triangles} triangles (the first are {triangles:?}); two are allowed"
    )]
    NonManifoldEdge {
        /// Its end vertices.
        vertices: [u32; 2],
        /// The first two of its triangles.
        triangles: [usize; 2],
        /// Number of its triangles.
        n_triangles: usize,
        /// Its middle.
        place: Place,
    },
    /// Neighbours that disagree about what is outside.
    #[error(
        "triangles {triangles:?} run through their common edge {vertices:?} at {place} in the same direction: one of them is turned over"
    )]
    InconsistentOrientation {
        /// The edge's end vertices.
        vertices: [u32; 2],
        /// The two triangles.
        triangles: [usize; 2],
        /// The edge's middle.
        place: Place,
    },
    /// Two or more sheets that touch in one vertex.
    #[error(
        "vertex {vertex} at {place} joins {n_fans} separate fans of triangles (one of triangle {triangles:?} each): the surface is pinched there"
    )]
    PinchedVertex {
        /// Which vertex, from 0.
        vertex: usize,
        /// Number of fans.
        n_fans: usize,
        /// A triangle of the first and of the second fan.
        triangles: [usize; 2],
        /// The vertex's position.
        place: Place,
    },
    /// A closed piece whose triangles face the wrong way.
    #[error(
        "the closed piece of triangle {triangle} at {place} is inside out (volume {volume_ml:.3} ml): turn its triangles over"
    )]
    InsideOut {
        /// The piece's first triangle.
        triangle: usize,
        /// Signed volume [ml].
        volume_ml: f64,
        /// First corner of that triangle.
        place: Place,
    },
    /// Two triangles that pass through or touch each other.
    #[error("triangles {triangles:?} intersect near {place}: the surface passes through itself")]
    SelfIntersection {
        /// The two triangles, ascending.
        triangles: [u32; 2],
        /// A corner of the first.
        place: Place,
    },
    /// Smoothing or decimation left an intersection that could not be resolved.
    #[error(
        "{n} pairs of triangles intersect after {stage}, the first near {place}; smooth less or keep more triangles"
    )]
    Tangled {
        /// What was being done.
        stage: &'static str,
        /// Number of pairs.
        n: usize,
        /// A corner of one of the first pair.
        place: Place,
    },
    /// The wanted number of triangles cannot be had without breaking the manifold.
    #[error("decimation stopped at {reached} triangles, {target} were wanted: ask for at least {reached}")]
    TargetNotReached {
        /// Triangles wanted.
        target: usize,
        /// Triangles left.
        reached: usize,
    },
    /// A parameter out of its range.
    #[error("{name} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What is allowed.
        allowed: &'static str,
    },
}
