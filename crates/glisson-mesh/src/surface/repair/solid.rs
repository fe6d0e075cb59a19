//! A set of grid nodes without specks, whose dual surface is a manifold.

use crate::image::topology::well_composed_blocks;

/// Nodes of a grid, x fastest; those at its border are never set.
pub(super) struct Solid {
    pub(super) dims: [usize; 3],
    pub(super) inside: Vec<bool>,
}

impl Solid {
    fn strides(&self) -> [usize; 3] {
        [1, self.dims[0], self.dims[0] * self.dims[1]]
    }

    /// The eight nodes of the cell whose smallest node is `low`: bit x + 2 y + 4 z.
    pub(super) fn cell_nodes(&self, low: usize) -> [usize; 8] {
        let s = self.strides();
        std::array::from_fn(|c| low + (c & 1) * s[0] + (c >> 1 & 1) * s[1] + (c >> 2) * s[2])
    }

    /// Which of the nodes of a cell are inside, bit by bit.
    pub(super) fn pattern(&self, low: usize) -> u8 {
        let nodes = self.cell_nodes(low);
        (0..8).fold(0, |bits, c| bits | u8::from(self.inside[nodes[c]]) << c)
    }

    /// Smallest nodes of all cells, ascending.
    pub(super) fn cells(&self) -> impl Iterator<Item = usize> + use<> {
        let [nx, ny, nz] = self.dims;
        (0..nz - 1)
            .flat_map(move |k| (0..ny - 1).flat_map(move |j| (0..nx - 1).map(move |i| i + nx * (j + ny * k))))
    }

    /// Pieces joined by faces of the nodes that are `of`, by flood fill: the label of each node (from 1, 0
    /// elsewhere) and the nodes of each piece.
    fn pieces(&self, of: bool) -> (Vec<u32>, Vec<usize>) {
        let mut labels = vec![0u32; self.inside.len()];
        let mut sizes = Vec::new();
        let mut stack = Vec::new();
        for start in 0..self.inside.len() {
            if self.inside[start] != of || labels[start] != 0 {
                continue;
            }
            let label = u32::try_from(sizes.len() + 1).expect("fewer pieces than nodes");
            labels[start] = label;
            stack.push(start);
            let mut size = 0;
            while let Some(at) = stack.pop() {
                size += 1;
                for stride in self.strides() {
                    // Beyond the border a neighbour wraps onto other border nodes, all of one piece.
                    for next in [at.checked_sub(stride), at.checked_add(stride)].into_iter().flatten() {
                        if next < labels.len() && self.inside[next] == of && labels[next] == 0 {
                            labels[next] = label;
                            stack.push(next);
                        }
                    }
                }
            }
            sizes.push(size);
        }
        (labels, sizes)
    }

    /// Takes away pieces below `share` of the largest; answers the first node of each.
    pub(super) fn drop_small_pieces(&mut self, share: f64) -> Vec<usize> {
        let (labels, sizes) = self.pieces(true);
        let largest = sizes.iter().max().copied().unwrap_or(0);
        let limit = share * largest as f64;
        self.flip(&labels, |label| (sizes[label] as f64) < limit)
    }

    /// Fills cavities of fewer nodes than `share` of those inside; answers the first node of each.
    pub(super) fn fill_small_cavities(&mut self, share: f64) -> Vec<usize> {
        let limit = share * self.inside.iter().filter(|&&i| i).count() as f64;
        let (labels, sizes) = self.pieces(false);
        // Node 0 is at the border: label 1 is the outside.
        self.flip(&labels, |label| label > 0 && (sizes[label] as f64) < limit)
    }

    fn flip(&mut self, labels: &[u32], is_flipped: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut first = std::collections::BTreeMap::new();
        for (at, &label) in labels.iter().enumerate() {
            if label > 0 && is_flipped(label as usize - 1) {
                self.inside[at] = !self.inside[at];
                first.entry(label).or_insert(at);
            }
        }
        first.into_values().collect()
    }

    /// Adds nodes until no two nodes inside, and no two outside, touch by an edge or a corner only (the
    /// condition of [`crate::image::topology`]): of the outer nodes of such a cell the one of the largest
    /// `merit`. Pieces, cavities and tunnels may join, never open. Answers how many were added.
    ///
    /// Ends because it only adds, within the bounding box of what is there.
    pub(super) fn fill_contacts(&mut self, merit: &[f64]) -> usize {
        let is_good = well_composed_blocks();
        let mut n_added = 0;
        let mut pending: Vec<usize> =
            self.cells().filter(|&low| !is_good[usize::from(self.pattern(low))]).collect();
        pending.reverse();
        while let Some(low) = pending.pop() {
            let pattern = self.pattern(low);
            if is_good[usize::from(pattern)] {
                continue;
            }
            let nodes = self.cell_nodes(low);
            let outer = (0..8).filter(|c| pattern >> c & 1 == 0).map(|c| nodes[c]);
            let best = outer.max_by(|&a, &b| merit[a].total_cmp(&merit[b]).then(b.cmp(&a)));
            let best = best.expect("a full cell is well-composed");
            self.inside[best] = true;
            n_added += 1;
            let s = self.strides();
            pending
                .extend((0..8).rev().map(|c| best - (c & 1) * s[0] - (c >> 1 & 1) * s[1] - (c >> 2) * s[2]));
        }
        n_added
    }
}
