//! Zones: the tetrahedra of a mesh shared out among several, with the nodes between them.
//!
//! An element-based partition (seed `003` s. 4.2): each tetrahedron belongs to one zone, a node to every zone that
//! one of its tetrahedra is in. A node of two or more zones is a frontier node.
//!
//! By hand: [`Zones::new`]; by region: [`Zones::by_place`]; by graph: [`Zones::by_graph`].

mod partition;

use super::{NodeId, TetId, TetMesh};

/// Why tetrahedra cannot be shared out so.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ZonesError {
    /// A list of another length.
    #[error("{found} zone numbers given where {expected} are needed")]
    Length {
        /// Numbers given.
        found: usize,
        /// Tetrahedra of the mesh, or zones to rename.
        expected: usize,
    },
    /// Zones are numbered from 0 without gaps.
    #[error("zone {zone} of {n_zones} has no tetrahedron: leave it out, or make its region larger")]
    EmptyZone {
        /// Which one.
        zone: usize,
        /// Highest number given, plus one.
        n_zones: usize,
    },
    /// A mesh cannot be divided into so many zones.
    #[error("{n_zones} zones asked for; allowed: 1 to the number of tetrahedra, {n_tets}")]
    Count {
        /// Number asked for.
        n_zones: usize,
        /// Tetrahedra of the mesh.
        n_tets: usize,
    },
}

/// A partition of a mesh's tetrahedra. All node lists ascend.
#[derive(Clone, Debug, PartialEq)]
pub struct Zones {
    of_tet: Vec<u32>,
    nodes: Vec<Vec<NodeId>>,
    frontier: Vec<Vec<NodeId>>,
    frontier_nodes: Vec<NodeId>,
    zones_start: Vec<u32>,
    zones_of_node: Vec<u32>,
}

impl Zones {
    /// Zones given by the number of each tetrahedron's, from 0 without gaps.
    ///
    /// # Errors
    /// [`ZonesError`] naming the fault.
    pub fn new(mesh: &TetMesh, of_tet: Vec<u32>) -> Result<Self, ZonesError> {
        let (found, expected) = (of_tet.len(), mesh.tetrahedra.len());
        if found != expected {
            return Err(ZonesError::Length { found, expected });
        }
        let n_zones = of_tet.iter().max().map_or(0, |&z| z as usize + 1);
        let mut pairs: Vec<(NodeId, u32)> =
            mesh.tetrahedra.iter().zip(&of_tet).flat_map(|(nodes, &z)| nodes.map(|n| (n, z))).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut zones_start = vec![0u32; mesh.positions_m.len() + 1];
        for (node, _) in &pairs {
            zones_start[node.index() + 1] += 1;
        }
        for n in 0..mesh.positions_m.len() {
            zones_start[n + 1] += zones_start[n];
        }
        let mut zones = Self {
            of_tet,
            nodes: vec![Vec::new(); n_zones],
            frontier: vec![Vec::new(); n_zones],
            frontier_nodes: Vec::new(),
            zones_start,
            zones_of_node: pairs.iter().map(|&(_, zone)| zone).collect(),
        };
        for &(node, zone) in &pairs {
            zones.nodes[zone as usize].push(node);
            if zones.zones_of_node(node).len() > 1 {
                zones.frontier[zone as usize].push(node);
                if zones.frontier_nodes.last() != Some(&node) {
                    zones.frontier_nodes.push(node);
                }
            }
        }
        if let Some(zone) = zones.nodes.iter().position(Vec::is_empty) {
            return Err(ZonesError::EmptyZone { zone, n_zones });
        }
        Ok(zones)
    }

    /// Number of zones.
    pub fn n_zones(&self) -> usize {
        self.nodes.len()
    }

    /// Zone of each tetrahedron.
    pub fn of_tets(&self) -> &[u32] {
        &self.of_tet
    }

    /// Zone of a tetrahedron.
    pub fn zone_of(&self, tet: TetId) -> usize {
        self.of_tet[tet.index()] as usize
    }

    /// Tetrahedra of a zone, ascending.
    pub fn tets(&self, zone: usize) -> impl Iterator<Item = TetId> + '_ {
        let is_in = move |&(_, &z): &(usize, &u32)| z as usize == zone;
        self.of_tet.iter().enumerate().filter(is_in).map(|(t, _)| TetId::from_index(t))
    }

    /// Nodes of a zone, those that it shares included.
    pub fn nodes(&self, zone: usize) -> &[NodeId] {
        &self.nodes[zone]
    }

    /// Nodes that a zone shares with others.
    pub fn frontier(&self, zone: usize) -> &[NodeId] {
        &self.frontier[zone]
    }

    /// All nodes that zones share.
    pub fn frontier_nodes(&self) -> &[NodeId] {
        &self.frontier_nodes
    }

    /// Zones of a node, ascending; none for a node without tetrahedron.
    pub fn zones_of_node(&self, node: NodeId) -> &[u32] {
        let n = node.index();
        &self.zones_of_node[self.zones_start[n] as usize..self.zones_start[n + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;

    #[test]
    fn two_tetrahedra_share_a_frontier_of_three_nodes() {
        let mesh = TetMesh {
            positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, -DVec3::Z],
            tetrahedra: vec![[0, 1, 2, 3].map(NodeId), [0, 2, 1, 4].map(NodeId)],
            ..TetMesh::default()
        };
        let zones = Zones::new(&mesh, vec![1, 0]).unwrap();
        assert_eq!(zones.nodes(0), [0, 1, 2, 4].map(NodeId));
        assert_eq!(zones.frontier(1), [0, 1, 2].map(NodeId));
        assert_eq!(zones.frontier_nodes(), zones.frontier(0));
        assert_eq!(zones.zones_of_node(NodeId(3)), [1]);
        let error = Zones::new(&mesh, vec![2, 0]).unwrap_err();
        assert_eq!(error, ZonesError::EmptyZone { zone: 1, n_zones: 3 });
    }
}
