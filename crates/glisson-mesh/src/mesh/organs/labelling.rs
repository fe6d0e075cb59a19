//! Regions of the nodes of a body-centred cubic lattice over all organs.

use super::background::Background;
use super::bisection::MOST_BISECTED;
use super::cell_size::CellSize;
use super::error::OrganMeshError;
use super::field::ShareField;
use super::levels::LARGEST_LEVEL;
use super::regions::RegionGrid;
use super::stencils::n_pieces;
use crate::disjoint_sets::DisjointSets;
use crate::math::{Aabb, DVec3};
use crate::mesh::stuffing::Lattice;
use rayon::prelude::*;
use std::ops::Range;

/// Connected lattice nodes of one region fewer than this are a crumb, and become what is around them.
const LEAST_PIECE_NODES: usize = 4;

/// Most lattice nodes: 60 million take some 4 GB on the way.
const MOST_LATTICE_NODES: f64 = 6e7;

/// Nodes that are sampled in one go.
const CHUNK_NODES: usize = 4096;

/// Shares kept of a node near borders.
const N_SHARES: usize = 4;

/// Steps towards the wanted numbers of nodes.
const N_BALANCE_STEPS: usize = 20;

/// Nodes with a lead below this tell how many change with the level.
const NEAR: f64 = 0.1;

/// Largest change of a level in one step.
const LARGEST_BALANCE_CHANGE: f64 = 0.05;

/// The lattice and the region of each of its nodes; the border nodes are outside.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Labelling {
    pub(super) lattice: Background,
    pub(super) regions: Vec<u16>,
    /// Level of each region, 0 first, with which the shares were compared.
    pub(super) levels: Vec<f64>,
    /// Nodes of crumbs that were given another region.
    pub(super) n_crumb_nodes: usize,
}

/// The lattice of cells of `cell_m` that holds all organs with a layer of the outside around them.
fn lattice_over(regions: &RegionGrid, cell_m: f64) -> Result<Lattice, OrganMeshError> {
    let grid = regions.grid();
    let last = DVec3::new(grid.dims[0] as f64, grid.dims[1] as f64, grid.dims[2] as f64) - 0.5;
    let bounds_m = (0..8).fold(Aabb::EMPTY, |bounds_m, corner| {
        let high = DVec3::new(f64::from(corner & 1), f64::from((corner >> 1) & 1), f64::from(corner >> 2));
        bounds_m.including(grid.position_m(high * last - (1.0 - high) * 0.5))
    });
    // A voxel's share reaches no farther than a cell beyond it where it is the largest.
    let bounds_m = bounds_m.grown(2.0 * cell_m);
    let n_cells = (bounds_m.size_m() / cell_m).ceil();
    let n_nodes = 2.0 * (n_cells + 1.0).element_product();
    if n_nodes.is_nan() || n_nodes > MOST_LATTICE_NODES {
        return Err(OrganMeshError::LatticeTooLarge {
            cell_mm: 1e3 * cell_m,
            estimated: n_nodes as u64,
            allowed: MOST_LATTICE_NODES as u64,
            least_cell_mm: 1e3 * cell_m * libm::cbrt(n_nodes / MOST_LATTICE_NODES),
        });
    }
    let origin_m = bounds_m.center_m() - 0.5 * cell_m * n_cells;
    let dims = n_cells.to_array().map(|n| n as usize + 1);
    Ok(Lattice { dims, cell_m, origin_m })
}

impl Labelling {
    /// Gives each lattice node the region with the largest share there, levelled so that as many nodes come to each region as
    /// its volume asks for.
    ///
    /// # Errors
    /// A lattice of too many nodes.
    pub(super) fn new(
        regions: &RegionGrid,
        field: &ShareField<'_>,
        size: &CellSize<'_>,
    ) -> Result<Self, OrganMeshError> {
        let cell_m = size.largest_m();
        let lattice = Background::new(lattice_over(regions, cell_m)?, size).ok_or_else(|| {
            let volume_ml = 1e6 * regions.volumes_m3().iter().sum::<f64>();
            OrganMeshError::TooFine { cell_mm: 1e3 * cell_m, volume_ml, allowed: MOST_BISECTED }
        })?;
        let n_regions = regions.n_regions();
        let n_nodes = lattice.n_nodes();
        let chunks: Vec<Chunk> = (0..n_nodes.div_ceil(CHUNK_NODES))
            .into_par_iter()
            .map(|chunk| {
                let nodes = chunk * CHUNK_NODES..n_nodes.min((chunk + 1) * CHUNK_NODES);
                Chunk::sampled(nodes, &lattice, field)
            })
            .collect();
        let mut of_nodes = Vec::with_capacity(n_nodes);
        let mut mixed = Vec::new();
        for chunk in chunks {
            of_nodes.extend(chunk.regions);
            mixed.extend(chunk.mixed);
        }
        let node_volume_m3 = 0.5 * cell_m * cell_m * cell_m;
        let wanted: Vec<f64> = regions.volumes_m3().iter().map(|v| v / node_volume_m3).collect();
        let levels = balanced_levels(&mut of_nodes, &mixed, &wanted, &lattice);
        let mut labelling = Self { lattice, regions: of_nodes, levels, n_crumb_nodes: 0 };
        labelling.remove_crumbs(n_regions);
        Ok(labelling)
    }

    /// Number of tetrahedra into which the regions will be cut.
    pub(super) fn n_tets(&self) -> usize {
        let mut n = 0;
        self.lattice.for_each_tet(|nodes| n += n_pieces(nodes.map(|node| self.regions[node])));
        n
    }

    /// Number of lattice nodes of each region, 0 first.
    pub(super) fn n_nodes_of_regions(&self, n_regions: usize) -> Vec<usize> {
        let mut n_nodes = vec![0; n_regions + 1];
        for &region in &self.regions {
            n_nodes[usize::from(region)] += 1;
        }
        n_nodes
    }

    /// Number of connected pieces of each region, 0 first. The region's tetrahedra have as many: they deform onto its nodes and
    /// the edges, triangles and tetrahedra between these.
    pub(super) fn n_pieces_of_regions(&self, n_regions: usize) -> Vec<usize> {
        let mut pieces = self.pieces();
        let mut n_pieces = vec![0; n_regions + 1];
        for node in 0..self.regions.len() {
            n_pieces[usize::from(self.regions[node])] += usize::from(pieces.root(node) == node);
        }
        n_pieces
    }

    /// Lattice nodes of the same region joined by edges.
    fn pieces(&self) -> DisjointSets {
        let mut pieces = DisjointSets::new(self.regions.len());
        self.lattice.for_each_tet(|nodes| {
            for a in 0..4 {
                for b in a + 1..4 {
                    if self.regions[nodes[a]] == self.regions[nodes[b]] {
                        pieces.join(nodes[a], nodes[b]);
                    }
                }
            }
        });
        pieces
    }

    /// Gives the nodes of crumbs the region that most of their neighbours have. The last piece of a region stays.
    fn remove_crumbs(&mut self, n_regions: usize) {
        let mut pieces = self.pieces();
        let n = self.regions.len();
        let mut size = vec![0usize; n];
        let mut largest = vec![0usize; n_regions + 1];
        for node in 0..n {
            size[pieces.root(node)] += 1;
        }
        for node in 0..n {
            let largest = &mut largest[usize::from(self.regions[node])];
            *largest = (*largest).max(size[node]);
        }
        let is_crumb: Vec<bool> = (0..n)
            .map(|node| {
                let size = size[pieces.root(node)];
                size < LEAST_PIECE_NODES && size < largest[usize::from(self.regions[node])]
            })
            .collect();
        let crumb_nodes: Vec<usize> =
            (0..n).filter(|&n| is_crumb[n] && self.lattice.is_interior(n)).collect();
        // Crumbs do not vote, and nothing else changes.
        let mut votes = vec![0usize; n_regions + 1];
        for (&node, neighbours) in crumb_nodes.iter().zip(self.lattice.neighbours_of(&crumb_nodes)) {
            votes.fill(0);
            for neighbour in neighbours.into_iter().filter(|&n| !is_crumb[n]) {
                votes[usize::from(self.regions[neighbour])] += 1;
            }
            let most = votes.iter().copied().max().unwrap_or(0);
            let winner = votes.iter().position(|&v| v == most && most > 0);
            if let Some(winner) = winner {
                self.regions[node] = u16::try_from(winner).expect("regions are fewer than labels");
            }
        }
        self.n_crumb_nodes = crumb_nodes.len();
    }
}

/// The regions of some lattice nodes in turn, and more of those near borders.
struct Chunk {
    regions: Vec<u16>,
    mixed: Vec<MixedNode>,
}

/// A lattice node that sees more than one region: the outside's share if there is one, and the largest others.
struct MixedNode {
    node: usize,
    shares: [(u16, f32); N_SHARES],
}

impl Chunk {
    fn sampled(nodes: Range<usize>, lattice: &Background, field: &ShareField<'_>) -> Self {
        let mut chunk = Self { regions: Vec::with_capacity(nodes.len()), mixed: Vec::new() };
        let mut shares = field.shares();
        let mut found: Vec<(u16, f32)> = Vec::new();
        for node in nodes {
            if !lattice.is_interior(node) {
                chunk.regions.push(0);
                continue;
            }
            field.sample_into(lattice.position_m(node), &mut shares);
            found.clear();
            found
                .extend((0u16..).zip(&shares.value).filter(|&(_, &v)| v > 1e-6).map(|(r, &v)| (r, v as f32)));
            // The outside first, then the largest.
            found.sort_by(|a, b| (b.0 == 0).cmp(&(a.0 == 0)).then(b.1.total_cmp(&a.1)).then(a.0.cmp(&b.0)));
            chunk.regions.push(found.first().map_or(0, |f| f.0));
            if found.len() > 1 {
                let shares = std::array::from_fn(|at| found.get(at).copied().unwrap_or((found[0].0, 0.0)));
                chunk.mixed.push(MixedNode { node, shares });
            }
        }
        chunk
    }
}

impl MixedNode {
    /// Region of the node with these levels, the region that would be next, and by how much the first leads.
    fn leader(&self, levels: &[f64]) -> (u16, u16, f64) {
        let (mut best, mut next) = ((0, f64::NEG_INFINITY), (0, f64::NEG_INFINITY));
        let mut outside = 0.0;
        for &(region, share) in self.shares.iter().filter(|s| s.1 > 0.0) {
            if region == 0 {
                outside = f64::from(share);
                continue;
            }
            let value = f64::from(share) + levels[usize::from(region)];
            if value > best.1 {
                (next, best) = (best, (region, value));
            } else if value > next.1 {
                next = (region, value);
            }
        }
        let over_outside = 1.0 - 2.0 * outside + levels[usize::from(best.0)];
        if over_outside <= 0.0 {
            return (0, best.0, -over_outside);
        }
        let over_next = best.1 - next.1;
        if over_outside < over_next { (best.0, 0, over_outside) } else { (best.0, next.0, over_next) }
    }
}

/// Levels of all regions (0 for the outside) with which `wanted` nodes (from region 1 on) come to each; gives the mixed nodes
/// their regions.
///
/// Nodes count by their volume. Newton's method region by region, with the number of nodes that change for a small change of the level as derivative.
fn balanced_levels(
    of_nodes: &mut [u16],
    mixed: &[MixedNode],
    wanted: &[f64],
    lattice: &Background,
) -> Vec<f64> {
    let n = wanted.len() + 1;
    let mut levels = vec![0.0; n];
    for step in 0..=N_BALANCE_STEPS {
        for node in mixed {
            of_nodes[node.node] = node.leader(&levels).0;
        }
        if step == N_BALANCE_STEPS {
            break;
        }
        let mut count = vec![0.0; n];
        for (node, &region) in of_nodes.iter().enumerate() {
            count[usize::from(region)] += lattice.weight(node);
        }
        let (mut n_near, mut nodes_near) = (vec![0.0; n], vec![0usize; n]);
        for node in mixed {
            let (first, second, lead) = node.leader(&levels);
            if lead < NEAR {
                for region in [first, second].map(usize::from) {
                    n_near[region] += lattice.weight(node.node);
                    nodes_near[region] += 1;
                }
            }
        }
        for region in 1..n {
            let a_node =
                if nodes_near[region] > 0 { n_near[region] / nodes_near[region] as f64 } else { 1.0 };
            let nodes_per_level = n_near[region] / (2.0 * NEAR) + a_node;
            let change = 0.7 * (wanted[region - 1] - count[region]) / nodes_per_level;
            let level = levels[region] + change.clamp(-LARGEST_BALANCE_CHANGE, LARGEST_BALANCE_CHANGE);
            levels[region] = level.clamp(-LARGEST_LEVEL, LARGEST_LEVEL);
        }
    }
    levels
}
