//! The organ's surface from the simulating machine to the one with the devices: in pieces that are said again until they
//! are acknowledged, so that a lossy link hands it over whole, or not at all.

use super::contact_messages::{HeldSurface, PIECE_ITEMS, PieceItems, SurfaceName, SurfacePiece};
use glisson::mesh::{NodeId, TriangleId};
use glisson::world::detection::SurfaceList;
use glisson_runtime::elsewhere::NodePlace;
use std::sync::Arc;

/// Pieces that are said before the first of them must be acknowledged: what an acknowledgement can tell.
const WINDOW: u32 = 64;

/// What a surface is called.
pub(crate) fn name_of(list: &SurfaceList) -> SurfaceName {
    let mut hasher = blake3::Hasher::new();
    for (triangle, nodes) in &list.triangles {
        hasher.update(&triangle.0.to_le_bytes());
        for node in nodes {
            hasher.update(&node.0.to_le_bytes());
        }
    }
    let hash = hasher.finalize().as_bytes()[..8].try_into().map_or(1, u64::from_le_bytes);
    SurfaceName {
        version: list.version,
        // 0 means none.
        hash: hash.max(1),
        n_triangles: list.triangles.len() as u32,
        n_nodes: list.nodes.len() as u32,
    }
}

/// The simulating machine's side.
#[derive(Default)]
pub(crate) struct SurfaceOut {
    list: Arc<SurfaceList>,
    name: SurfaceName,
    /// Next piece to say.
    next: u32,
}

impl SurfaceOut {
    /// What is to be handed over from now on.
    pub(crate) fn offer(&mut self, list: &Arc<SurfaceList>) {
        if !Arc::ptr_eq(list, &self.list) {
            (self.list, self.name, self.next) = (Arc::clone(list), name_of(list), 0);
        }
    }

    /// The name of what is handed over.
    pub(crate) fn name(&self) -> SurfaceName {
        self.name
    }

    /// The next piece that the other machine has not; none when it holds the surface, or has not asked for it.
    pub(crate) fn piece(&mut self, other: &HeldSurface) -> Option<SurfacePiece> {
        let name = self.name;
        if !name.is_known() || other.held == name.hash || other.collects != name.hash {
            return None;
        }
        let first = other.first_missing;
        let end = name.n_pieces().min(first.saturating_add(WINDOW));
        if !(first..end).contains(&self.next) {
            self.next = first;
        }
        // Once around the window at most.
        let n = end.checked_sub(first).filter(|n| *n > 0)?;
        let index = (0..n)
            .map(|step| first + (self.next - first + step) % n)
            .find(|index| other.has >> (index - first) & 1 == 0)?;
        self.next = index + 1;
        Some(SurfacePiece { surface: name, index, items: self.items(index) })
    }

    fn items(&self, index: u32) -> PieceItems {
        fn part<T>(list: &[T], piece: u32) -> &[T] {
            let first = piece as usize * PIECE_ITEMS;
            &list[first..list.len().min(first + PIECE_ITEMS)]
        }
        let n_first = self.name.n_triangle_pieces();
        if index < n_first {
            return PieceItems::Triangles(part(&self.list.triangles, index).to_vec());
        }
        let nodes = part(&self.list.nodes, index - n_first);
        PieceItems::Nodes(nodes.iter().map(|(node, position_m)| NodePlace::of(*node, *position_m)).collect())
    }
}

/// The other side: collects the pieces of one surface.
#[derive(Default)]
pub(crate) struct SurfaceIn {
    held: u64,
    name: SurfaceName,
    triangles: Vec<(TriangleId, [NodeId; 3])>,
    nodes: Vec<NodePlace>,
    has: Vec<bool>,
    first_missing: u32,
}

impl SurfaceIn {
    /// One that holds a surface already.
    pub(crate) fn holding(name: &SurfaceName) -> Self {
        Self { held: name.hash, ..Self::default() }
    }

    /// The simulation has this surface now: it is collected if it is another one than what is held.
    pub(crate) fn want(&mut self, name: &SurfaceName) {
        if !name.is_known() || name.hash == self.held || *name == self.name {
            if name.hash == self.held {
                self.forget();
            }
            return;
        }
        self.forget();
        self.name = *name;
        self.triangles.resize(name.n_triangles as usize, (TriangleId(0), [NodeId(0); 3]));
        self.nodes.resize(name.n_nodes as usize, NodePlace::default());
        self.has.resize(name.n_pieces() as usize, false);
    }

    fn forget(&mut self) {
        *self = Self { held: self.held, ..Self::default() };
    }

    /// What is told to the other machine.
    pub(crate) fn status(&self) -> HeldSurface {
        let first = self.first_missing as usize;
        let window = self.has.get(first..).unwrap_or_default().iter().take(WINDOW as usize);
        let has = window.enumerate().fold(0, |bits, (i, has)| bits | u64::from(*has) << i);
        HeldSurface { held: self.held, collects: self.name.hash, first_missing: self.first_missing, has }
    }

    /// Takes a piece; answers the surface and its hash when it was the last one.
    pub(crate) fn take(&mut self, piece: SurfacePiece) -> Option<(u64, SurfaceList)> {
        let SurfacePiece { surface, index, items } = piece;
        if surface != self.name || self.has.get(index as usize).is_none_or(|has| *has) {
            return None;
        }
        let n_first = self.name.n_triangle_pieces();
        // A message that was read has as many as belong there.
        match items {
            PieceItems::Triangles(triangles) => put_part(&mut self.triangles, index, &triangles)?,
            PieceItems::Nodes(nodes) => put_part(&mut self.nodes, index.checked_sub(n_first)?, &nodes)?,
        }
        self.has[index as usize] = true;
        let is_there = |at: u32| self.has.get(at as usize).is_some_and(|has| *has);
        while is_there(self.first_missing) {
            self.first_missing += 1;
        }
        if self.first_missing < self.name.n_pieces() {
            return None;
        }
        let nodes = self.nodes.iter().map(|place| (NodeId(place.node), place.position_m())).collect();
        let version = self.name.version;
        let list = SurfaceList { version, triangles: std::mem::take(&mut self.triangles), nodes };
        let name = self.name;
        self.forget();
        if name_of(&list) != name {
            // Two surfaces of the same name got mixed up: from the beginning.
            return None;
        }
        self.held = name.hash;
        Some((name.hash, list))
    }
}

fn put_part<T: Copy>(list: &mut [T], piece: u32, part: &[T]) -> Option<()> {
    let first = piece as usize * PIECE_ITEMS;
    list.get_mut(first..first + part.len())?.copy_from_slice(part);
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DVec3;

    fn list(n: u32, version: u32) -> SurfaceList {
        let triangles =
            (0..n).map(|t| (TriangleId(2 * t + version), [t, t + 1, t + 2].map(NodeId))).collect();
        let nodes = (0..n + 2).map(|v| (NodeId(v), DVec3::splat(f64::from(v) * 0.25))).collect();
        SurfaceList { version, triangles, nodes }
    }

    #[test]
    fn a_surface_arrives_whole_though_most_pieces_are_lost_or_come_late() {
        let sent = Arc::new(list(10_000, 3));
        let mut out = SurfaceOut::default();
        out.offer(&sent);
        let mut receiver = SurfaceIn::holding(&name_of(&list(5, 1)));
        assert_eq!(out.piece(&receiver.status()), None, "nobody asked");
        receiver.want(&out.name());
        let (mut random, mut late, mut found, mut n_said) = (7_u64, Vec::new(), None, 0);
        let mut status = receiver.status();
        while found.is_none() {
            let piece = out.piece(&status).expect("not all of it is there");
            n_said += 1;
            assert!(n_said < 2_000, "{status:?}");
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            match random % 5 {
                0 | 1 => {}
                2 => late.push(piece),
                3 => {
                    found = receiver.take(piece.clone());
                    assert!(found.is_some() || receiver.take(piece).is_none());
                }
                _ => found = receiver.take(piece),
            }
            if random.is_multiple_of(7) && found.is_none() {
                found = late.pop().and_then(|piece| receiver.take(piece));
            }
            // Acknowledgements are lost too.
            if random.is_multiple_of(3) {
                status = receiver.status();
            }
        }
        assert_eq!(found.unwrap(), (out.name().hash, list(10_000, 3)));
        assert_eq!(out.piece(&receiver.status()), None);
        assert!(receiver.status().held == out.name().hash && receiver.status().collects == 0);
    }

    #[test]
    fn another_surface_begins_anew_and_the_one_that_is_held_is_not_asked_for() {
        let (first, second) = (Arc::new(list(300, 1)), Arc::new(list(300, 2)));
        let mut out = SurfaceOut::default();
        out.offer(&first);
        let mut receiver = SurfaceIn::default();
        receiver.want(&out.name());
        let old = out.piece(&receiver.status()).unwrap();
        assert!(receiver.take(old.clone()).is_none() && receiver.status().first_missing == 1);
        out.offer(&second);
        receiver.want(&out.name());
        assert_eq!(receiver.status().first_missing, 0);
        assert!(receiver.take(old).is_none() && receiver.status().has == 0, "of another surface");
        while let Some(piece) = out.piece(&receiver.status()) {
            receiver.take(piece);
        }
        receiver.want(&out.name());
        assert_eq!(receiver.status(), HeldSurface { held: name_of(&second).hash, ..HeldSurface::default() });
        // Taken back: the first one again.
        receiver.want(&name_of(&first));
        assert_eq!(receiver.status().collects, name_of(&first).hash);
        receiver.want(&name_of(&second));
        assert_eq!(receiver.status().collects, 0);
    }
}
