//! Nodes in connected groups of about equal size, and which of these groups are neighbours.

use super::MeshEdges;
use glisson_mesh::math::{Aabb, DVec3};

const NONE: u32 = u32::MAX;

/// For each node the edges to its neighbours that move, as rows of a matrix of blocks.
pub(super) struct Rows {
    pub(super) start: Vec<u32>,
    /// Ascending in each row.
    pub(super) neighbour: Vec<u32>,
    pub(super) edge: Vec<u32>,
}

impl Rows {
    /// Nodes that do not move have empty rows.
    pub(super) fn new(edges: &MeshEdges, moves: &[bool]) -> Self {
        let moving = || (0_u32..).zip(&edges.nodes).filter(|(_, ends)| ends.iter().all(|n| moves[n.index()]));
        let mut start = vec![0_u32; moves.len() + 1];
        for node in moving().flat_map(|(_, ends)| ends) {
            start[node.index() + 1] += 1;
        }
        for n in 0..moves.len() {
            start[n + 1] += start[n];
        }
        let n_blocks = start[moves.len()] as usize;
        let mut next = start.clone();
        let mut rows = Self { start, neighbour: vec![0; n_blocks], edge: vec![0; n_blocks] };
        for (edge, &[low, high]) in moving() {
            for (of, neighbour) in [(low, high), (high, low)] {
                let place = next[of.index()] as usize;
                rows.neighbour[place] = neighbour.0;
                rows.edge[place] = edge;
                next[of.index()] += 1;
            }
        }
        rows
    }

    pub(super) fn n_rows(&self) -> usize {
        self.start.len() - 1
    }

    pub(super) fn row(&self, n: usize) -> std::ops::Range<usize> {
        self.start[n] as usize..self.start[n + 1] as usize
    }
}

/// The aggregates: every node that moves belongs to one.
pub(super) struct Aggregates {
    /// Aggregate of each node, [`u32::MAX`] for those that do not move.
    pub(super) of_node: Vec<u32>,
    /// The nodes of each.
    pub(super) nodes: Vec<u32>,
    pub(super) start: Vec<u32>,
    /// Neighbours with a higher number of each, ascending.
    pub(super) higher: Vec<u32>,
    pub(super) higher_start: Vec<u32>,
}

impl Aggregates {
    /// Boxes of about equal numbers of nodes, each halved across its longest side, and of each box the connected parts: nodes
    /// on the two sides of a cut are never together.
    pub(super) fn new(positions_m: &[DVec3], rows: &Rows, moves: &[bool], n_boxes: usize) -> Self {
        let mut list: Vec<u32> = (0..moves.len() as u32).filter(|n| moves[*n as usize]).collect();
        let mut box_of = vec![NONE; moves.len()];
        let mut n_made = 0;
        divide(positions_m, &mut list, n_boxes.max(1), &mut |nodes| {
            nodes.iter().for_each(|n| box_of[*n as usize] = n_made);
            n_made += 1;
        });
        let mut aggregates = Self {
            of_node: vec![NONE; moves.len()],
            nodes: Vec::with_capacity(list.len()),
            start: vec![0],
            higher: Vec::new(),
            higher_start: vec![0],
        };
        // The order within a box is not told.
        list.sort_unstable();
        for first in list {
            aggregates.add_around(first, rows, &box_of);
        }
        aggregates.find_neighbours(rows);
        aggregates
    }

    pub(super) fn len(&self) -> usize {
        self.start.len() - 1
    }

    pub(super) fn members(&self, a: usize) -> &[u32] {
        &self.nodes[self.start[a] as usize..self.start[a + 1] as usize]
    }

    /// Place of a pair of neighbours in `higher`.
    pub(super) fn pair(&self, low: u32, high: u32) -> usize {
        let range = self.higher_start[low as usize] as usize..self.higher_start[low as usize + 1] as usize;
        range.start + self.higher[range].binary_search(&high).expect("neighbours have a place")
    }

    /// The part of its box that hangs together with `first`, unless it has been added.
    fn add_around(&mut self, first: u32, rows: &Rows, box_of: &[u32]) {
        if self.of_node[first as usize] != NONE {
            return;
        }
        let number = self.len() as u32;
        let mut at = self.nodes.len();
        self.of_node[first as usize] = number;
        self.nodes.push(first);
        while at < self.nodes.len() {
            let node = self.nodes[at] as usize;
            at += 1;
            for &neighbour in &rows.neighbour[rows.row(node)] {
                let n = neighbour as usize;
                if self.of_node[n] == NONE && box_of[n] == box_of[node] {
                    self.of_node[n] = number;
                    self.nodes.push(neighbour);
                }
            }
        }
        self.start.push(at as u32);
    }

    fn find_neighbours(&mut self, rows: &Rows) {
        let mut of_one = Vec::new();
        for a in 0..self.len() {
            let of_members = self.members(a).iter().flat_map(|n| &rows.neighbour[rows.row(*n as usize)]);
            of_one.extend(of_members.map(|n| self.of_node[*n as usize]).filter(|other| *other > a as u32));
            of_one.sort_unstable();
            of_one.dedup();
            self.higher.append(&mut of_one);
            self.higher_start.push(self.higher.len() as u32);
        }
    }
}

/// Hands out `list` in `n` lists of equal length, but for one.
fn divide(positions_m: &[DVec3], list: &mut [u32], n: usize, hand_out: &mut impl FnMut(&[u32])) {
    if n == 1 || list.len() <= 1 {
        if !list.is_empty() {
            hand_out(list);
        }
        return;
    }
    let bounds = list.iter().fold(Aabb::EMPTY, |bounds, n| bounds.including(positions_m[*n as usize]));
    let size_m = bounds.size_m();
    let axis = (0..3).max_by(|a, b| size_m[*a].total_cmp(&size_m[*b])).unwrap_or(0);
    let n_first = n / 2;
    let middle = (list.len() * n_first / n).clamp(1, list.len() - 1);
    let along = |n: &u32| positions_m[*n as usize][axis];
    list.select_nth_unstable_by(middle, |a, b| along(a).total_cmp(&along(b)).then(a.cmp(b)));
    let (first, second) = list.split_at_mut(middle);
    divide(positions_m, first, n_first, hand_out);
    divide(positions_m, second, n - n_first, hand_out);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::mesh::NodeId;

    /// Points on a line of `n`, 1 m apart, each an edge from the next, but for those after `cuts`.
    fn line(n: u32, cuts: &[u32]) -> (Vec<DVec3>, MeshEdges) {
        let positions_m = (0..n).map(|i| DVec3::new(f64::from(i), 0.0, 0.0)).collect();
        let ends = (0..n - 1).filter(|i| !cuts.contains(i)).map(|i| [NodeId(i), NodeId(i + 1)]);
        (positions_m, MeshEdges { nodes: ends.collect(), of_tet: Vec::new() })
    }

    #[test]
    fn boxes_hold_equal_numbers_and_a_cut_divides_them() {
        let (positions_m, edges) = line(40, &[4]);
        let mut moves = vec![true; 40];
        moves[39] = false;
        let rows = Rows::new(&edges, &moves);
        let aggregates = Aggregates::new(&positions_m, &rows, &moves, 4);
        let sizes: Vec<usize> = (0..aggregates.len()).map(|a| aggregates.members(a).len()).collect();
        assert_eq!(sizes.iter().sum::<usize>(), 39);
        assert_eq!(sizes.len(), 5, "{sizes:?}");
        assert_eq!(aggregates.of_node[39], u32::MAX);
        assert_ne!(aggregates.of_node[4], aggregates.of_node[5]);
        assert_eq!(aggregates.higher.len(), 3);
    }

    #[test]
    fn rows_hold_every_edge_between_moving_nodes_twice() {
        let (_, edges) = line(5, &[]);
        let rows = Rows::new(&edges, &[true, true, true, true, false]);
        assert_eq!(rows.n_rows(), 5);
        let of = |n: usize| rows.neighbour[rows.row(n)].to_vec();
        assert_eq!([of(0), of(1), of(3), of(4)], [vec![1], vec![0, 2], vec![2], vec![]]);
        assert_eq!(rows.edge[rows.row(1)], [0, 1]);
    }
}
