//! The faces between tetrahedra of different regions.

use super::complex::Complex;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::mesh::topology::TET_TRIANGLES;
use crate::mesh::topology::build::sorted_faces;

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
    let mut found = Vec::new();
    for same in sorted_faces(&tets).chunk_by(|a, b| a.0 == b.0) {
        let [first, second] = same else { continue };
        let region = |record: u32| complex.tet_regions[record as usize / 4];
        let (a, b) = (region(first.1), region(second.1));
        if a != b {
            let from = if a < b { first.1 } else { second.1 } as usize;
            let nodes = TET_TRIANGLES[from % 4].map(|k| complex.tets[from / 4][k]);
            found.push(InterfaceFace { nodes, regions: [a.min(b), a.max(b)] });
        }
    }
    found
}
