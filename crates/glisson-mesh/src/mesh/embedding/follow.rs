//! How the copies follow an edit of the cut mesh.

use super::slits::{Face, Slits, joined_pieces, slits_between, sort_faces};
use super::{Embedding, EmbeddingRefusal, EmbeddingUndo, Tie};
use crate::disjoint_sets::DisjointSets;
use crate::math::tetrahedron_volume_m3;
use crate::mesh::edit::TopologyChange;
use crate::mesh::quality::FACES;
use crate::mesh::{NodeId, TetId, TetMesh};

/// Shares of a piece that fills its tetrahedron differ from one by rounding alone.
const FULL: f64 = 1e-12;

/// What an edit brings in, checked.
struct Incoming {
    places: Vec<Tie>,
    origins: Vec<TetId>,
}

/// A copy near the edit: one from before, or a piece that may become one.
struct Candidate {
    origin: TetId,
    tets: Vec<TetId>,
    /// The copy that carried it, or most of it.
    before: TetId,
    /// Whether its piece may have changed.
    is_new: bool,
    share: f64,
}

impl Embedding {
    /// Follows an edit of the cut mesh, which `cut` is after it; what it changes of the copies, with nodes and tetrahedra alone.
    /// What it overwrites is in `undo` then.
    ///
    /// # Errors
    /// [`EmbeddingRefusal`]; nothing changed then.
    pub fn follow(
        &mut self,
        cut: &TetMesh,
        change: &TopologyChange,
        undo: &mut EmbeddingUndo,
    ) -> Result<TopologyChange, EmbeddingRefusal> {
        let incoming = self.incoming(cut, change)?;
        undo.start(self);
        let touched = self.take_in(&incoming, change, undo);
        let corners = self.corners_of(&touched);
        let candidates = self.candidates(cut, change, &touched, &corners);
        let mut sets = self.joined(cut, &candidates, &corners);
        let mut told = TopologyChange::default();
        (told.nodes.n_before, told.tets.n_before) =
            (self.copies.positions_m.len(), self.copies.tetrahedra.len());
        let assigned = self.assign(&candidates, &corners, &mut sets, &mut told);
        self.replace(cut, &candidates, &assigned, &mut told, undo);
        (told.nodes.n_after, told.tets.n_after) =
            (self.copies.positions_m.len(), self.copies.tetrahedra.len());
        self.list_dead_nodes(&candidates, &corners, &mut told);
        // Copies part where slits end, before the cut mesh does.
        for pieces in [&mut told.pieces.through_faces, &mut told.pieces.through_nodes] {
            pieces.may_have_split = true;
        }
        Ok(told)
    }

    /// Where what comes in lies among the first nodes and tetrahedra.
    fn incoming(&self, cut: &TetMesh, change: &TopologyChange) -> Result<Incoming, EmbeddingRefusal> {
        if change.is_renumbering() {
            return Err(EmbeddingRefusal::Renumbered);
        }
        if !change.moved_nodes.is_empty() {
            return Err(EmbeddingRefusal::Moved);
        }
        let mut places = Vec::with_capacity(change.nodes.added.ids().len());
        for (_, parents) in change.nodes.added.iter() {
            let of_parents = parents.iter().map(|&(parent, weight)| (self.places[parent.index()], weight));
            places.push(Tie::blend(of_parents).ok_or(EmbeddingRefusal::Across)?);
        }
        let n_before = self.places.len();
        let place = |node: NodeId| match node.index().checked_sub(n_before) {
            Some(new) => &places[new],
            None => &self.places[node.index()],
        };
        let mut origins = Vec::with_capacity(change.tets.added.ids().len());
        for (tet, parents) in change.tets.added.iter() {
            let heaviest = parents.iter().rev().max_by(|a, b| a.1.total_cmp(&b.1));
            let (parent, _) = heaviest.ok_or(EmbeddingRefusal::Across)?;
            let origin = self.origin_of[parent.index()];
            let corners = &self.origin.tetrahedra[origin.index()];
            let lies_in = |node: &NodeId| place(*node).iter().all(|(of, _)| corners.contains(&of));
            if !cut.tetrahedra[tet.index()].iter().all(lies_in) {
                return Err(EmbeddingRefusal::Across);
            }
            origins.push(origin);
        }
        Ok(Incoming { places, origins })
    }

    /// Takes in what comes and lists the pieces anew; the first tetrahedra that the edit touches, ascending.
    fn take_in(
        &mut self,
        incoming: &Incoming,
        change: &TopologyChange,
        undo: &mut EmbeddingUndo,
    ) -> Vec<TetId> {
        self.places.extend_from_slice(&incoming.places);
        self.ties.extend_from_slice(&incoming.places);
        self.origin_of.extend_from_slice(&incoming.origins);
        let removed = change.tets.removed.iter().filter(|tet| tet.index() < change.tets.n_before);
        let mut touched: Vec<TetId> = removed.map(|tet| self.origin_of[tet.index()]).collect();
        touched.extend_from_slice(&incoming.origins);
        touched.sort_unstable();
        touched.dedup();
        for &origin in &touched {
            undo.pieces.push((origin, self.pieces.get(&origin).cloned()));
            self.pieces
                .entry(origin)
                .or_insert_with(|| vec![origin])
                .retain(|tet| change.tets.removed.binary_search(tet).is_err());
        }
        for (&tet, origin) in change.tets.added.ids().iter().zip(&incoming.origins) {
            if change.tets.removed.binary_search(&tet).is_err() {
                self.pieces.get_mut(origin).expect("listed above").push(tet);
            }
            self.copy_of.push(TetId(u32::MAX));
        }
        for (tet, parents) in change.tets.added.iter() {
            let heaviest = parents.iter().rev().max_by(|a, b| a.1.total_cmp(&b.1)).expect("checked").0;
            self.copy_of[tet.index()] = self.copy_of[heaviest.index()];
        }
        touched
    }

    /// The first nodes of these first tetrahedra, ascending.
    fn corners_of(&self, origins: &[TetId]) -> Vec<NodeId> {
        let mut corners: Vec<NodeId> =
            origins.iter().flat_map(|origin| self.origin.tetrahedra[origin.index()]).collect();
        corners.sort_unstable();
        corners.dedup();
        corners
    }

    /// All copies at `corners`, and the pieces that take the place of those that the edit touched.
    fn candidates(
        &self,
        cut: &TetMesh,
        change: &TopologyChange,
        touched: &[TetId],
        corners: &[NodeId],
    ) -> Vec<Candidate> {
        let mut near: Vec<TetId> =
            corners.iter().flat_map(|corner| self.origin.at(*corner)).copied().collect();
        near.sort_unstable();
        near.dedup();
        let mut candidates = Vec::new();
        for origin in near {
            let tets = self.pieces_in(&origin);
            if touched.binary_search(&origin).is_ok() {
                candidates.extend(self.parts_of(cut, origin, tets));
                // What is gone is listed without tissue, so that its copies are known.
                let gone = change.tets.removed.iter().filter(|tet| {
                    tet.index() < change.tets.n_before && self.origin_of[tet.index()] == origin
                });
                let mut before: Vec<TetId> = gone.map(|tet| self.copy_of[tet.index()]).collect();
                before.sort_unstable();
                before.dedup();
                let empty = |before| Candidate { origin, tets: Vec::new(), before, is_new: true, share: 0.0 };
                candidates.extend(before.into_iter().map(empty));
                continue;
            }
            let mut copies: Vec<TetId> = tets.iter().map(|tet| self.copy_of[tet.index()]).collect();
            copies.sort_unstable();
            copies.dedup();
            for before in copies {
                let own = tets.iter().copied().filter(|tet| self.copy_of[tet.index()] == before).collect();
                let share = self.copies.share(before);
                candidates.push(Candidate { origin, tets: own, before, is_new: false, share });
            }
        }
        candidates
    }

    /// The pieces of a first tetrahedron, each of tetrahedra that hang together by faces.
    fn parts_of(&self, cut: &TetMesh, origin: TetId, tets: &[TetId]) -> Vec<Candidate> {
        let mut faces: Vec<Face> = Vec::with_capacity(4 * tets.len());
        for (at, tet) in (0_u32..).zip(tets) {
            faces.extend(faces_of(cut, *tet).map(|face| (face, at)));
        }
        sort_faces(&mut faces);
        let mut sets = joined_pieces(&faces, tets.len(), |_| true);
        let ahead = Slits::in_piece(cut, &faces, &mut sets);
        if !ahead.is_empty() {
            sets = joined_pieces(&faces, tets.len(), |(face, at)| {
                !ahead.take(cut, *face, sets.root(*at as usize))
            });
        }
        let whole_m3 = self.origin.volumes_m3[origin.index()];
        let mut parts: Vec<(usize, Candidate, f64)> = Vec::new();
        for (at, &tet) in tets.iter().enumerate() {
            let root = sets.root(at);
            let volume_m3 = tetrahedron_volume_m3(cut.corners_m(tet));
            let before = self.copy_of[tet.index()];
            match parts.iter_mut().find(|part| part.0 == root) {
                Some((_, part, largest_m3)) => {
                    part.tets.push(tet);
                    part.share += volume_m3 / whole_m3;
                    if volume_m3 > *largest_m3 {
                        (part.before, *largest_m3) = (before, volume_m3);
                    }
                }
                None => {
                    let share = volume_m3 / whole_m3;
                    parts.push((
                        root,
                        Candidate { origin, tets: vec![tet], before, is_new: true, share },
                        volume_m3,
                    ));
                }
            }
        }
        let full = |share: f64| if (share - 1.0).abs() <= FULL { 1.0 } else { share };
        parts.into_iter().map(|(_, part, _)| Candidate { share: full(part.share), ..part }).collect()
    }

    /// Which corners candidates share: number `4 c + k` for corner k of candidate c.
    fn joined(&self, cut: &TetMesh, candidates: &[Candidate], corners: &[NodeId]) -> DisjointSets {
        let mut faces: Vec<Face> = Vec::new();
        for (at, candidate) in (0_u32..).zip(candidates) {
            for &tet in &candidate.tets {
                faces.extend(faces_of(cut, tet).map(|face| (face, at)));
            }
        }
        sort_faces(&mut faces);
        let mut sets = DisjointSets::new(4 * candidates.len());
        let parted = slits_between(cut, &faces);
        for pair in faces.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
            let [a, b] = [pair[0].1 as usize, pair[1].1 as usize];
            // One piece, or two that a slit parts further on than it goes.
            let is_parted = candidates[a].origin == candidates[b].origin;
            if is_parted || parted.binary_search(&[a.min(b) as u32, a.max(b) as u32]).is_ok() {
                continue;
            }
            let [of_a, of_b] = [a, b].map(|c| &self.origin.tetrahedra[candidates[c].origin.index()]);
            for (k, node) in of_a.iter().enumerate().filter(|(_, node)| corners.binary_search(node).is_ok()) {
                if let Some(l) = of_b.iter().position(|other| other == node) {
                    sets.join(4 * a + k, 4 * b + l);
                }
            }
        }
        sets
    }

    /// The nodes of each candidate's copy. What changed least keeps the node that was there; others get copies of it.
    fn assign(
        &mut self,
        candidates: &[Candidate],
        corners: &[NodeId],
        sets: &mut DisjointSets,
        told: &mut TopologyChange,
    ) -> Vec<[NodeId; 4]> {
        let mut assigned: Vec<[NodeId; 4]> =
            candidates.iter().map(|candidate| self.copies.tetrahedra[candidate.before.index()]).collect();
        // Corners at the edit, by first node, set and place.
        let mut slots: Vec<(NodeId, usize, usize)> = Vec::new();
        for (c, candidate) in
            candidates.iter().enumerate().filter(|(_, candidate)| !candidate.tets.is_empty())
        {
            for (k, &node) in self.origin.tetrahedra[candidate.origin.index()].iter().enumerate() {
                if corners.binary_search(&node).is_ok() {
                    slots.push((node, sets.root(4 * c + k), 4 * c + k));
                }
            }
        }
        slots.sort_unstable();
        for at_node in slots.chunk_by(|a, b| a.0 == b.0) {
            let groups: Vec<&[(NodeId, usize, usize)]> = at_node.chunk_by(|a, b| a.1 == b.1).collect();
            let mut kept: Vec<Option<NodeId>> = vec![None; groups.len()];
            for stays in [true, false] {
                for (g, group) in groups.iter().enumerate() {
                    let mut known = group.iter().filter(|slot| !stays || !candidates[slot.2 / 4].is_new);
                    if let (None, Some(&(_, _, slot))) = (kept[g], known.next()) {
                        let before = assigned[slot / 4][slot % 4];
                        kept[g] = Some(before).filter(|_| !kept.contains(&Some(before)));
                    }
                }
            }
            for (group, kept) in groups.iter().zip(kept) {
                let (first, _, slot) = group[0];
                let before = assigned[slot / 4][slot % 4];
                let node = kept.unwrap_or_else(|| {
                    let node = NodeId::from_index(self.copies.positions_m.len());
                    self.copies.positions_m.push(self.copies.positions_m[first.index()]);
                    told.nodes.added.push(node, &[(before, 1.0)]);
                    node
                });
                group.iter().for_each(|&(_, _, slot)| assigned[slot / 4][slot % 4] = node);
            }
        }
        assigned
    }

    /// Replaces the copies that changed, and ties to them what they carry.
    fn replace(
        &mut self,
        cut: &TetMesh,
        candidates: &[Candidate],
        assigned: &[[NodeId; 4]],
        told: &mut TopologyChange,
        undo: &mut EmbeddingUndo,
    ) {
        let mut kept: Vec<TetId> = Vec::new();
        for (candidate, &nodes) in candidates.iter().zip(assigned) {
            let Candidate { before, share, is_new, .. } = *candidate;
            let at = before.index();
            let is_same = self.copies.tetrahedra[at] == nodes && self.copies.shares[at] == share;
            let copy = if candidate.tets.is_empty() {
                continue;
            } else if is_same && !kept.contains(&before) {
                kept.push(before);
                before
            } else {
                let copy = TetId::from_index(self.copies.tetrahedra.len());
                self.copies.tetrahedra.push(nodes);
                self.copies.shares.push(share);
                told.tets.added.push(copy, &[(before, 1.0)]);
                copy
            };
            if is_new || copy != before {
                self.tie_to(copy, nodes, cut, candidate, undo);
            }
        }
        let before = candidates.iter().map(|candidate| candidate.before);
        told.tets.removed.extend(before.filter(|before| !kept.contains(before)));
        told.tets.removed.sort_unstable();
        told.tets.removed.dedup();
    }

    /// Has a copy with these nodes carry a candidate's tissue.
    fn tie_to(
        &mut self,
        copy: TetId,
        nodes: [NodeId; 4],
        cut: &TetMesh,
        candidate: &Candidate,
        undo: &mut EmbeddingUndo,
    ) {
        let corners = self.origin.tetrahedra[candidate.origin.index()];
        for &tet in &candidate.tets {
            undo.copy_of.push((tet, std::mem::replace(&mut self.copy_of[tet.index()], copy)));
            for node in cut.tetrahedra[tet.index()] {
                let mut tie = self.places[node.index()];
                for of in &mut tie.nodes[..usize::from(tie.n)] {
                    let at = corners.iter().position(|corner| corner == of).expect("it lies in there");
                    *of = nodes[at];
                }
                undo.ties.push((node, std::mem::replace(&mut self.ties[node.index()], tie)));
            }
        }
    }

    /// Nodes of copies from before that no copy has any more.
    fn list_dead_nodes(&self, candidates: &[Candidate], corners: &[NodeId], told: &mut TopologyChange) {
        let mut before: Vec<NodeId> = Vec::new();
        let mut now: Vec<NodeId> = Vec::new();
        for candidate in candidates {
            let first = self.origin.tetrahedra[candidate.origin.index()];
            let at_edit = |nodes: [NodeId; 4]| {
                first.into_iter().zip(nodes).filter(|(first, _)| corners.binary_search(first).is_ok())
            };
            before.extend(at_edit(self.copies.tetrahedra[candidate.before.index()]).map(|(_, node)| node));
            if let Some(tet) = candidate.tets.first() {
                let copy = self.copy_of[tet.index()];
                now.extend(at_edit(self.copies.tetrahedra[copy.index()]).map(|(_, node)| node));
            }
        }
        for nodes in [&mut before, &mut now] {
            nodes.sort_unstable();
            nodes.dedup();
        }
        before.retain(|node| now.binary_search(node).is_err());
        told.nodes.removed = before;
    }
}

/// The faces of a tetrahedron, corners ascending.
fn faces_of(mesh: &TetMesh, tet: TetId) -> [[NodeId; 3]; 4] {
    let nodes = mesh.tetrahedra[tet.index()];
    FACES.map(|face| {
        let mut corners = face.map(|i| nodes[i]);
        corners.sort_unstable();
        corners
    })
}
