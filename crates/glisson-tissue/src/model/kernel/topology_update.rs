//! Tetrahedra and nodes that are added after the memory was laid out.
//!
//! A new tetrahedron takes a spare lane of its parent's part, or a new block; a new node gets a row of the part of its first
//! tetrahedron. The places depend on the edits alone, so that the sums of forces have one order on every path and for any
//! number of threads. Undo removes in the opposite order, so that lanes and rows are those from before.

use super::build::{of_tet, share_row};
use super::order::Place;
use super::part::{Elements, Part, PartNodes, borrowed_row, write};
use super::rows::{Block, MOST_ROWS, N_LANES, offset_of};
use super::step::GROUP_ROWS;
use super::{FastKernel, KernelExtras, KernelParams, TetPlace};
use crate::solve::P1Gradients;
use glisson_mesh::mesh::{NodeId, TetId};

/// Masses of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::model) struct NodeMass {
    pub(in crate::model) mass_kg: f64,
    pub(in crate::model) added_kg: f64,
    pub(in crate::model) n_tets: u32,
}

/// Sizes of a kernel before an edit.
#[derive(Clone, Copy, Debug)]
pub(in crate::model) struct KernelCounts {
    pub(in crate::model) n_nodes: usize,
    pub(in crate::model) n_tets: usize,
    pub(in crate::model) n_added: usize,
}

impl Elements {
    /// Adds a block, all of its lanes spare.
    fn append_block(&mut self) {
        let block = self.blocks.len();
        self.blocks.push(Block::EMPTY);
        self.extras.append_block();
        if !self.law_of.is_empty() {
            self.law_of.push([0; N_LANES]);
        }
        self.tets.push([super::quarantine::NO_TET; N_LANES]);
        self.spare.make_room(N_LANES * self.blocks.len());
        for lane in (0..N_LANES).rev() {
            self.spare.push([block as u32, lane as u32]);
        }
    }

    /// Drops the blocks beyond the first `n_blocks`, which are empty.
    fn truncate(&mut self, n_blocks: usize) {
        self.blocks.truncate(n_blocks);
        self.extras.truncate(n_blocks);
        self.law_of.truncate(n_blocks);
        self.tets.truncate(n_blocks);
        self.spare.retain(|[block, _]| (*block as usize) < n_blocks);
    }
}

impl PartNodes {
    /// Adds a node without tetrahedra, mass or support.
    fn push(&mut self) {
        let n = self.mass_kg.len();
        let has_led = !self.led_m.is_empty();
        if n == self.displacement_m.len() {
            for rows in self.rows_mut() {
                rows.resize(n + GROUP_ROWS, [0.0; 4]);
            }
            if has_led {
                self.led_m.resize(n + GROUP_ROWS, [0.0; 4]);
            }
        }
        self.mass_kg.push(0.0);
        self.added_mass_kg.push(0.0);
        self.is_held.push([false; 3]);
        self.n_tets.push(0);
    }

    /// Removes the nodes beyond the first `n`.
    fn truncate(&mut self, n: usize) {
        let n_rows = n.next_multiple_of(GROUP_ROWS);
        for rows in self.rows_mut() {
            rows.truncate(n_rows);
            rows[n..].fill([0.0; 4]);
        }
        self.led_m.truncate(n_rows);
        self.mass_kg.truncate(n);
        self.added_mass_kg.truncate(n);
        self.is_held.truncate(n);
        self.n_tets.truncate(n);
    }

    fn rows_mut(&mut self) -> [&mut Vec<super::rows::Row>; 6] {
        [
            &mut self.displacement_m,
            &mut self.increment_m,
            &mut self.force_n,
            &mut self.outer_n,
            &mut self.inverse_mass_per_kg,
            &mut self.moving_inertia_kg,
        ]
    }
}

impl FastKernel {
    /// Grows to so many nodes and tetrahedra; new ones have no place yet.
    pub(in crate::model) fn grow(&mut self, n_nodes: usize, extras: &KernelExtras<'_>, n_tets: usize) {
        self.node_places.resize(n_nodes, None);
        let nowhere = TetPlace { part: 0, block: 0, lane: 0, is_live: false };
        self.tet_places.resize(n_tets, nowhere);
        self.mass_share_kg.resize(n_tets, 0.0);
        let laws = &mut *write(&self.parts.laws);
        laws.extend_from_slice(extras.laws.get(laws.len()..).unwrap_or_default());
    }

    /// Whether the memory should be laid out anew: when the added tetrahedra are half of the former ones.
    pub(in crate::model) fn is_outgrown_by(&self, n_tets: usize) -> bool {
        2 * (self.n_added + n_tets) > self.n_laid_out
    }

    /// Whether all parts have rows for `n_tets` more tetrahedra in any case.
    pub(in crate::model) fn has_rows_for(&self, n_tets: usize) -> bool {
        self.parts.all.iter().all(|part| part.layout().n_rows() + 4 * n_tets <= MOST_ROWS)
    }

    /// Adds a tetrahedron without a place, near another one. False when there are no rows for its nodes: the memory must then be
    /// laid out anew.
    pub(in crate::model) fn add_tet(
        &mut self,
        params: &KernelParams<'_>,
        extras: &KernelExtras<'_>,
        tet: TetId,
        near: Option<TetId>,
    ) -> bool {
        let nodes = params.mesh.tetrahedra[tet.index()];
        let of_corner = || nodes.iter().find_map(|n| self.node_places[n.index()]).map(|place| place.part);
        let Some(p) = near.map(|near| self.tet_places[near.index()].part).or_else(of_corner) else {
            return false;
        };
        let p = p as usize;
        let Some(part) = self.parts.all.get(p) else { return false };
        let rows = nodes.map(|n| self.row_in(part, p, n));
        let n_missing = rows.iter().filter(|row| row.is_none()).count();
        if part.layout().n_rows() + n_missing > MOST_ROWS {
            return false;
        }
        let offsets = nodes.map(|n| offset_of(self.row_in_or_new(p, n)));
        let gradients = P1Gradients::in_mesh(params.mesh, tet);
        let part = &self.parts.all[p];
        let elements = &mut *part.elements_mut();
        if elements.spare.is_empty() {
            let history = &mut part.progress_mut().history;
            let a_block = history.len() / elements.blocks.len();
            history.resize(history.len() + a_block, [0.0; N_LANES]);
            elements.append_block();
        }
        let [block, lane] = elements.spare.pop().expect("a block has lanes");
        elements.blocks[block as usize].offsets[lane as usize] = offsets;
        let at = [block as usize, lane as usize];
        elements.put(at, tet, &gradients, params, extras).expect("its parents were sound");
        self.tet_places[tet.index()] = TetPlace { part: p as u32, block, lane: lane as u8, is_live: true };
        self.n_added += 1;
        let share_kg = self.share_kg(params, tet, &gradients);
        self.mass_share_kg[tet.index()] = share_kg;
        nodes.into_iter().for_each(|n| self.change_mass(n, share_kg, 1));
        true
    }

    /// Gives a live tetrahedron the shape that it has in the mesh. Its memory of stress stays, for another volume.
    pub(in crate::model) fn reshape_tet(
        &mut self,
        params: &KernelParams<'_>,
        extras: &KernelExtras<'_>,
        tet: TetId,
    ) {
        let TetPlace { part, block, lane, .. } = self.tet_places[tet.index()];
        let at = [block as usize, usize::from(lane)];
        let gradients = P1Gradients::in_mesh(params.mesh, tet);
        let part = &self.parts.all[part as usize];
        part.elements_mut().put(at, tet, &gradients, params, extras).expect("it was sound before");
        let share_kg = self.share_kg(params, tet, &gradients);
        let before_kg = std::mem::replace(&mut self.mass_share_kg[tet.index()], share_kg);
        let larger = share_kg / before_kg;
        self.for_each_memory_of(tet, |_, number| *number *= larger);
        for node in params.mesh.tetrahedra[tet.index()] {
            self.exchange_mass(node, before_kg, share_kg);
        }
    }

    fn share_kg(&self, params: &KernelParams<'_>, tet: TetId, gradients: &P1Gradients) -> f64 {
        0.25 * of_tet(params.materials, tet.index()).density_kg_per_m3() * gradients.volume_m3
    }

    /// Memory of the relaxing stress of a tetrahedron, as in [`FastKernel::history_into`].
    pub(in crate::model) fn tet_history(&self, tet: TetId) -> Vec<f64> {
        let mut numbers = Vec::new();
        self.for_each_memory_of(tet, |_, number| numbers.push(*number));
        numbers
    }

    /// Restores a memory of [`FastKernel::tet_history`].
    pub(in crate::model) fn set_tet_history(&mut self, tet: TetId, numbers: &[f64]) {
        self.for_each_memory_of(tet, |i, number| *number = numbers[i]);
    }

    fn for_each_memory_of(&self, tet: TetId, mut visit: impl FnMut(usize, &mut f64)) {
        let TetPlace { part, block, lane, is_live } = self.tet_places[tet.index()];
        let n = self.history_len() / self.n_tets().max(1);
        if !is_live || n == 0 {
            return;
        }
        let history = &mut self.parts.all[part as usize].progress_mut().history;
        for (i, numbers) in history[block as usize * n..][..n].iter_mut().enumerate() {
            visit(i, &mut numbers[usize::from(lane)]);
        }
    }

    /// Row of a node in a part that has one for it.
    fn row_in(&self, part: &Part, p: usize, node: NodeId) -> Option<usize> {
        let Place { part: owner, index } = self.node_places[node.index()]?;
        if owner as usize == p {
            return Some(index as usize);
        }
        let layout = part.layout();
        let mut of_owner = layout.borrowed.iter().filter(|exchange| exchange.part == owner as usize);
        of_owner.find_map(|exchange| {
            let rows = exchange.rows.iter().find(|[_, there]| u32::from(*there) == index);
            rows.map(|[here, _]| usize::from(*here))
        })
    }

    /// Row of a node in a part; a node without a place becomes the part's own, one of another part is borrowed.
    fn row_in_or_new(&mut self, p: usize, node: NodeId) -> usize {
        let part = &self.parts.all[p];
        if let Some(row) = self.row_in(part, p, node) {
            return row;
        }
        if let Some(Place { part: owner, index }) = self.node_places[node.index()] {
            let row = borrowed_row(part.layout().n_borrowed);
            part.layout_mut().n_borrowed += 1;
            share_row(&self.parts.all, [p, row], [owner as usize, index as usize]);
            return row;
        }
        let mut layout = part.layout_mut();
        let row = layout.own.len();
        layout.own.push(node);
        part.nodes_mut().push();
        self.node_places[node.index()] = Some(Place { part: p as u32, index: row as u32 });
        row
    }

    /// Masses of a node.
    pub(in crate::model) fn node_mass(&self, node: NodeId) -> NodeMass {
        self.place(node).map_or(NodeMass { mass_kg: 0.0, added_kg: 0.0, n_tets: 0 }, |(part, n)| {
            let nodes = part.nodes();
            NodeMass { mass_kg: nodes.mass_kg[n], added_kg: nodes.added_mass_kg[n], n_tets: nodes.n_tets[n] }
        })
    }

    /// Restores the masses of a node.
    pub(in crate::model) fn set_node_mass(&mut self, node: NodeId, mass: &NodeMass) {
        if let Some((part, n)) = self.place(node) {
            let mut nodes = part.nodes_mut();
            nodes.mass_kg[n] = mass.mass_kg;
            nodes.added_mass_kg[n] = mass.added_kg;
            nodes.n_tets[n] = mass.n_tets;
            nodes.update_inverse_mass(n);
        }
    }

    /// The present sizes.
    pub(in crate::model) fn counts(&self) -> KernelCounts {
        KernelCounts { n_nodes: self.n_nodes(), n_tets: self.n_tets(), n_added: self.n_added }
    }

    /// Blocks, own rows and borrowed rows of each part, for [`FastKernel::shrink`].
    pub(in crate::model) fn part_counts(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.parts.all.iter().map(|part| {
            let layout = part.layout();
            [part.elements().blocks.len(), layout.own.len(), layout.n_borrowed]
        })
    }

    /// Removes the tetrahedra beyond `counts` from their lanes, the last one first, and the nodes beyond. The kernel is then as
    /// before an edit, except for masses and removed tetrahedra.
    pub(in crate::model) fn shrink(
        &mut self,
        counts: &KernelCounts,
        part_counts: impl Iterator<Item = [usize; 3]>,
    ) {
        for t in (counts.n_tets..self.n_tets()).rev() {
            let TetPlace { part, block, lane, is_live } = self.tet_places[t];
            if is_live {
                self.for_each_memory_of(TetId::from_index(t), |_, number| *number = 0.0);
                let mut elements = self.parts.all[part as usize].elements_mut();
                elements.clear(block as usize, usize::from(lane));
                elements.blocks[block as usize].offsets[usize::from(lane)] = [0; 4];
            }
        }
        self.tet_places.truncate(counts.n_tets);
        self.mass_share_kg.truncate(counts.n_tets);
        self.node_places.truncate(counts.n_nodes);
        self.n_added = counts.n_added;
        let laws = &mut *write(&self.parts.laws);
        laws.truncate(counts.n_tets.max(1));
        let part_counts: Vec<[usize; 3]> = part_counts.collect();
        for (part, [n_blocks, n_own, n_borrowed]) in self.parts.all.iter().zip(&part_counts) {
            let elements = &mut *part.elements_mut();
            let a_block = part.progress().history.len() / elements.blocks.len().max(1);
            part.progress_mut().history.truncate(a_block * n_blocks);
            elements.truncate(*n_blocks);
            part.nodes_mut().truncate(*n_own);
            let layout = &mut *part.layout_mut();
            layout.own.truncate(*n_own);
            layout.n_borrowed = *n_borrowed;
            let is_borrowed = |row: u16, n: usize| usize::from(row) > MOST_ROWS - 1 - n;
            for exchange in &mut layout.borrowed {
                exchange.rows.retain(|[here, _]| is_borrowed(*here, *n_borrowed));
            }
            for exchange in &mut layout.lent {
                let n_of_other = part_counts[exchange.part][2];
                exchange.rows.retain(|[_, there]| is_borrowed(*there, n_of_other));
            }
            layout.borrowed.retain(|exchange| !exchange.rows.is_empty());
            layout.lent.retain(|exchange| !exchange.rows.is_empty());
        }
    }

    /// Puts a removed tetrahedron back into its former lane, which is the last one that became spare. Its masses are restored
    /// separately.
    pub(in crate::model) fn put_back_tet(
        &mut self,
        params: &KernelParams<'_>,
        extras: &KernelExtras<'_>,
        tet: TetId,
    ) {
        let gradients = P1Gradients::in_mesh(params.mesh, tet);
        self.tet_places[tet.index()].is_live = true;
        let TetPlace { part: p, block, lane, .. } = self.tet_places[tet.index()];
        let part = &self.parts.all[p as usize];
        let row = |n: NodeId| self.row_in(part, p as usize, n).expect("its nodes have rows");
        let offsets = params.mesh.tetrahedra[tet.index()].map(|n| offset_of(row(n)));
        let elements = &mut *part.elements_mut();
        let spare = elements.spare.pop();
        debug_assert_eq!(spare, Some([block, u32::from(lane)]), "edits are undone in the opposite order");
        let at = [block as usize, usize::from(lane)];
        elements.blocks[at[0]].offsets[at[1]] = offsets;
        elements.put(at, tet, &gradients, params, extras).expect("it was sound before");
    }
}
