//! Memory and operations of the two methods, by the formulas of seed `003` s. 4.4.
//!
//! A zone has N nodes, F of them on frontiers and S on the surface but not on frontiers; fixed nodes do not count.
//! The unit is a tensor (nine numbers), or its product with a vector.
//!
//! | | stored tensors | products per sweep without outer force |
//! |---|---|---|
//! | A, surface | (2 F + S)(F + S) | F (2 F + S) |
//! | B, all nodes | N (F + S) | F N + products of edges that leave the zone at frontier nodes |
//! | tensor-mass | vertices and edges | nodes times mean number of neighbours |
//!
//! For the edges the report's text takes half of 20 neighbours, F N + 10 F; its table 5.2 has 2.7 to 2.9 per
//! frontier node. The products of neighbour forces in method A for edges between frontier nodes of two other zones, which
//! exist only where more than two zones meet, are beyond the report's formula.

/// Numbers of nodes of a zone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ZoneSize {
    /// N: all free nodes.
    pub n_nodes: u64,
    /// F: free nodes that other zones share.
    pub n_frontier: u64,
    /// S: free nodes of the surface that no other zone shares.
    pub n_surface: u64,
}

impl ZoneSize {
    /// Tensors that method A stores.
    pub fn surface_tensors(self) -> u64 {
        (2 * self.n_frontier + self.n_surface) * (self.n_frontier + self.n_surface)
    }

    /// Tensors that method B stores.
    pub fn all_nodes_tensors(self) -> u64 {
        self.n_nodes * (self.n_frontier + self.n_surface)
    }

    /// Products of method A per sweep, without outer force.
    pub fn surface_products(self) -> u64 {
        self.n_frontier * (2 * self.n_frontier + self.n_surface)
    }

    /// Products of method B per sweep, without outer force and without those of the edges that leave the zone.
    pub fn all_nodes_products(self) -> u64 {
        self.n_frontier * self.n_nodes
    }
}

/// Operations of a step, over all zones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExchangeCount {
    /// Sweeps over the zones.
    pub n_sweeps: u64,
    /// Products of pre-computed tensors with forces.
    pub response_products: u64,
    /// Products of stiffness tensors with neighbours' displacements, for the forces that zones pass on.
    pub edge_products: u64,
    /// Products of stiffness tensors in tensor-mass zones.
    pub dynamic_products: u64,
    /// Forces on frontier nodes that a zone took over from its neighbours.
    pub n_exchanged_forces: u64,
}

impl ExchangeCount {
    /// All products.
    pub fn products(&self) -> u64 {
        self.response_products + self.edge_products + self.dynamic_products
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.n_sweeps += other.n_sweeps;
        self.response_products += other.response_products;
        self.edge_products += other.edge_products;
        self.dynamic_products += other.dynamic_products;
        self.n_exchanged_forces += other.n_exchanged_forces;
    }
}
