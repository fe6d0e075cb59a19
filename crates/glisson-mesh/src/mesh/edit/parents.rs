//! Which of the tetrahedra that make room or get another shape held the place of a new one, by their shares of its volume.

use super::EditableMesh;
use super::overlap::{Corners, Relation, Tet, are_near};
use crate::math::{Aabb, DVec3};
use crate::mesh::TetId;
use std::cell::OnceCell;

const NONE: u32 = u32::MAX;

/// The parts of a new tetrahedron that were found are all of it when not more than this share of its volume is missing.
const NOTHING_MISSING: f64 = 1e-10;

/// Finds parents. From the tetrahedron that holds the new one's centre the search goes through the faces of what it
/// overlaps; if that does not account for its volume (where the old ones do not hang together), it looks at all of them.
pub(super) struct ParentsByVolume<'a> {
    body: &'a EditableMesh,
    ids: &'a [TetId],
    /// Worked out when looked at: most are far from the new tetrahedra that are asked for.
    olds: Vec<OnceCell<Old>>,
    parents: Vec<(TetId, f64)>,
    /// Places still to be looked at, in order, and those from which the search has gone on.
    queue: Vec<u32>,
    is_queued: Vec<bool>,
    /// Where the next search begins.
    last: usize,
}

/// A tetrahedron that makes room or gets another shape.
struct Old {
    shape: Tet,
    /// The one beyond each face, as a place in the list of ids; [`NONE`] if it stays as it is.
    beyond: [u32; 4],
}

impl<'a> ParentsByVolume<'a> {
    /// Among `ids`, the tetrahedra of `body` in whose place new ones are, ascending.
    pub(super) fn new(body: &'a EditableMesh, ids: &'a [TetId]) -> Self {
        Self {
            body,
            ids,
            olds: (0..ids.len()).map(|_| OnceCell::new()).collect(),
            parents: Vec::new(),
            queue: Vec::new(),
            is_queued: vec![false; ids.len()],
            last: 0,
        }
    }

    /// The parents of the tetrahedron with the given corners, ascending, with shares that add up to 1.
    pub(super) fn of(&mut self, corners_m: [DVec3; 4]) -> &[(TetId, f64)] {
        self.parents.clear();
        let own = Corners::new(corners_m);
        if !self.search_from_centre(&own) {
            self.look_at_all(&own);
        }
        let Self { ids, parents, .. } = self;
        parents.sort_unstable_by_key(|p| p.0);
        let sum: f64 = parents.iter().map(|p| p.1).sum();
        if sum > 0.0 {
            parents.iter_mut().for_each(|p| p.1 /= sum);
        } else {
            // Too thin to share a volume with anything in floating point: all alike.
            let share = 1.0 / ids.len() as f64;
            parents.extend(ids.iter().map(|&tet| (tet, share)));
        }
        parents
    }

    /// The one that holds a point, on the way from the last one through faces; `None` if the way is barred.
    fn holder(&self, point_m: DVec3) -> Option<usize> {
        let mut at = self.last;
        // Rounding could lead in a circle.
        for _ in 0..self.ids.len() {
            let old = old_at(self.body, self.ids, &self.olds, at);
            match old.shape.face_towards(point_m) {
                None => return Some(at),
                Some(face) => at = old.beyond[face] as usize,
            }
            if at == NONE as usize {
                return None;
            }
        }
        None
    }

    /// Writes the parents with their volumes; whether they account for all of it.
    fn search_from_centre(&mut self, own: &Corners) -> bool {
        let Some(holder) = self.holder(own.center_m()) else { return false };
        self.last = holder;
        let Self { body, ids, olds, parents, queue, is_queued, .. } = self;
        if old_at(body, ids, olds, holder).shape.relation(own) == Relation::Within {
            parents.push((ids[holder], 1.0));
            return true;
        }
        let (own, own_m3) = (Tet::new(own.clone()), own.volume_m3());
        queue.clear();
        queue.push(holder as u32);
        is_queued[holder] = true;
        let (mut n_done, mut missing_m3) = (0, own_m3);
        while n_done < queue.len() && missing_m3 > NOTHING_MISSING * own_m3 {
            let at = queue[n_done] as usize;
            n_done += 1;
            let old = old_at(body, ids, olds, at);
            let shared_m3 = own.shared_volume_m3(&old.shape);
            if shared_m3 <= 0.0 {
                continue;
            }
            parents.push((ids[at], shared_m3));
            missing_m3 -= shared_m3;
            for next in old.beyond {
                if next != NONE && !is_queued[next as usize] {
                    is_queued[next as usize] = true;
                    queue.push(next);
                }
            }
        }
        for &at in queue.iter() {
            is_queued[at as usize] = false;
        }
        let is_whole = missing_m3 <= NOTHING_MISSING * own_m3;
        if !is_whole {
            parents.clear();
        }
        is_whole
    }

    /// The same without following faces. The next search begins at the largest share.
    fn look_at_all(&mut self, own: &Corners) {
        let (own, own_bounds) = (Tet::new(own.clone()), own.bounds());
        let mut largest_m3 = 0.0;
        for (at, &tet) in self.ids.iter().enumerate() {
            if are_near(&own_bounds, &Aabb::of_points(&self.body.mesh().corners_m(tet))) {
                let shared_m3 = own.shared_volume_m3(&old_at(self.body, self.ids, &self.olds, at).shape);
                if shared_m3 > 0.0 {
                    self.parents.push((tet, shared_m3));
                    if shared_m3 > largest_m3 {
                        (largest_m3, self.last) = (shared_m3, at);
                    }
                }
            }
        }
    }
}

/// The tetrahedron at a place of `ids`.
fn old_at<'a>(body: &EditableMesh, ids: &[TetId], olds: &'a [OnceCell<Old>], at: usize) -> &'a Old {
    olds[at].get_or_init(|| Old {
        shape: Tet::new(Corners::new(body.mesh().corners_m(ids[at]))),
        beyond: body.topology().tet_neighbours(ids[at]).map(|next| {
            next.get().and_then(|next| ids.binary_search(&next).ok()).map_or(NONE, |at| at as u32)
        }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;
    use crate::mesh::box_mesh::cube_of_five;

    /// The same by looking at every old tetrahedron.
    fn by_all(parents: &mut ParentsByVolume<'_>, corners_m: [DVec3; 4]) -> Vec<(TetId, f64)> {
        parents.parents.clear();
        parents.look_at_all(&Corners::new(corners_m));
        let sum: f64 = parents.parents.iter().map(|p| p.1).sum();
        parents.parents.iter().map(|p| (p.0, p.1 / sum)).collect()
    }

    #[test]
    fn following_faces_finds_what_looking_at_all_finds() {
        let body = EditableMesh::new(cube_of_five(5, 1.0)).unwrap();
        let all: Vec<TetId> = body.topology().live_tets().collect();
        let mut random = SeededRandom::new(7);
        // Whole, and with holes that bar the way or leave parts of the new ones in nothing.
        for holes in [0.0, 0.2] {
            let ids: Vec<TetId> = all.iter().copied().filter(|_| random.uniform() >= holes).collect();
            let mut parents = ParentsByVolume::new(&body, &ids);
            let (mut n_by_faces, mut n_single) = (0, 0);
            for at in 0..300 {
                let center = DVec3::new(random.uniform(), random.uniform(), random.uniform()) * 0.8 + 0.1;
                // Some smaller than a cell, some across many.
                let size_m = if at % 2 == 0 { 0.02 } else { 0.2 };
                let corners_m: [DVec3; 4] = std::array::from_fn(|_| {
                    let offset = DVec3::new(random.uniform(), random.uniform(), random.uniform()) - 0.5;
                    (center + offset * size_m).clamp(DVec3::ZERO, DVec3::ONE)
                });
                let wanted = by_all(&mut parents, corners_m);
                parents.parents.clear();
                n_by_faces += usize::from(parents.search_from_centre(&Corners::new(corners_m)));
                let found = parents.of(corners_m);
                assert!((found.iter().map(|p| p.1).sum::<f64>() - 1.0).abs() < 1e-12);
                assert!(found.is_sorted_by_key(|p| p.0));
                if wanted.iter().all(|p| p.1.is_finite()) && !wanted.is_empty() {
                    n_single += usize::from(found.len() == 1);
                    let share = |list: &[(TetId, f64)], tet| {
                        list.iter().find(|p: &&(TetId, f64)| p.0 == tet).map_or(0.0, |p| p.1)
                    };
                    for &(tet, _) in wanted.iter().chain(found) {
                        assert!(
                            (share(found, tet) - share(&wanted, tet)).abs() < 1e-8,
                            "{found:?} {wanted:?}"
                        );
                    }
                }
            }
            assert!(n_single > 20, "{n_single}");
            if holes == 0.0 {
                assert_eq!(n_by_faces, 300);
            } else {
                assert!((50..280).contains(&n_by_faces), "{n_by_faces}");
            }
        }
    }
}
