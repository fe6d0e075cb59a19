//! The faces between tetrahedra of different regions.

use super::complex::Complex;
use super::label_faces::label_faces;
use crate::math::DVec3;
use crate::mesh::NodeId;

/// A face between two regions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct InterfaceFace {
    /// Nodes, counter-clockwise seen from the second region.
    pub(super) nodes: [u32; 3],
    /// Both regions, ascending.
    pub(super) regions: [u16; 2],
}

impl InterfaceFace {
    /// Corners [m].
    pub(super) fn corners_m(&self, complex: &Complex) -> [DVec3; 3] {
        self.nodes.map(|n| complex.positions_m[n as usize])
    }

    /// Area [m2].
    pub(super) fn area_m2(&self, complex: &Complex) -> f64 {
        let [a, b, c] = self.corners_m(complex);
        0.5 * (b - a).cross(c - a).length()
    }
}

/// All faces between two regions of a complex, the outside among them, in the order of their ascending nodes.
pub(super) fn interface_faces(complex: &Complex) -> Vec<InterfaceFace> {
    let tets: Vec<[NodeId; 4]> = complex.tets.iter().map(|nodes| nodes.map(NodeId)).collect();
    label_faces(&tets, &complex.tet_regions)
        .into_iter()
        .filter(|face| face.labels[0] < face.labels[1])
        .map(|face| InterfaceFace { nodes: face.nodes.map(|n| n.0), regions: face.labels })
        .collect()
}
