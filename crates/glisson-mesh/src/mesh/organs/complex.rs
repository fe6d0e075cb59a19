//! Tetrahedra of several regions over shared nodes, with what is known of each node: the mesh while it is made.

use crate::math::{DVec3, tetrahedron_volume_m3};

/// No region: fills the places of [`Complex::node_regions`] that a node does not need.
pub(super) const NO_REGION: u16 = u16::MAX;

/// A conforming mesh of all regions and of a layer of the outside around them.
#[derive(Clone, Debug, Default)]
pub(super) struct Complex {
    /// Nodes [m].
    pub(super) positions_m: Vec<DVec3>,
    /// Size of the cells around each node [m].
    pub(super) cell_m: Vec<f64>,
    /// Regions that meet in each node, ascending, filled up with [`NO_REGION`]: one inside a region, two on an interface,
    /// three on a line in which interfaces meet, four in a point.
    pub(super) node_regions: Vec<[u16; 4]>,
    /// Nodes of each tetrahedron, of positive volume.
    pub(super) tets: Vec<[u32; 4]>,
    /// Region of each tetrahedron.
    pub(super) tet_regions: Vec<u16>,
}

impl Complex {
    /// Number of regions that meet in a node.
    pub(super) fn n_regions_at(&self, node: usize) -> usize {
        n_regions(&self.node_regions[node])
    }

    /// Corners of a tetrahedron [m].
    pub(super) fn corners_m(&self, tet: usize) -> [DVec3; 4] {
        self.tets[tet].map(|n| self.positions_m[n as usize])
    }

    /// Volume of each region [m3], 0 first (the layer outside).
    pub(super) fn volumes_m3(&self, n_regions: usize) -> Vec<f64> {
        let mut volumes_m3 = vec![0.0; n_regions + 1];
        for (tet, &region) in self.tet_regions.iter().enumerate() {
            volumes_m3[usize::from(region)] += tetrahedron_volume_m3(self.corners_m(tet));
        }
        volumes_m3
    }
}

/// Number of regions in a filled up list.
pub(super) fn n_regions(regions: &[u16; 4]) -> usize {
    regions.iter().filter(|&&r| r != NO_REGION).count()
}

/// For each node its tetrahedra, in rows.
#[derive(Clone, Debug)]
pub(super) struct Stars {
    start: Vec<u32>,
    tets: Vec<u32>,
}

impl Stars {
    /// Tetrahedra around each of `n_nodes` nodes, ascending.
    pub(super) fn of(n_nodes: usize, tets: &[[u32; 4]]) -> Self {
        let mut start = vec![0u32; n_nodes + 1];
        for &n in tets.iter().flatten() {
            start[n as usize + 1] += 1;
        }
        for n in 0..n_nodes {
            start[n + 1] += start[n];
        }
        let mut next = start.clone();
        let mut rows = vec![0; 4 * tets.len()];
        for (tet, nodes) in (0u32..).zip(tets) {
            for &n in nodes {
                rows[next[n as usize] as usize] = tet;
                next[n as usize] += 1;
            }
        }
        Self { start, tets: rows }
    }

    /// Tetrahedra at a node.
    pub(super) fn at(&self, node: usize) -> &[u32] {
        &self.tets[self.start[node] as usize..self.start[node + 1] as usize]
    }
}
