//! Faces that close a gap of a cut: of all that part what is below it from what is above, those of the least area, which are where
//! the greatest flow from one side to the other is full (Ford and Fulkerson 1956, doi 10.4153/CJM-1956-045-5; by shortest ways,
//! Edmonds and Karp 1972, doi 10.1145/321694.321699). And crumbs, which a cut does not part.

use super::patch::{Body, Patch, sorted};
use crate::math::tetrahedron_volume_m3;
use crate::mesh::quality::FACES;

/// Not reached.
const NONE: u32 = u32::MAX;

/// Of a tetrahedron that is on both sides.
const BOTH: i8 = 2;

/// A way from one tetrahedron to the next, through a face that is not cut.
struct Way {
    to: u32,
    /// The same face the other way.
    back: u32,
    /// How much more may flow [m2].
    room_m2: f64,
    face: [u32; 3],
}

/// Tetrahedra and the faces between them.
pub(super) struct Network {
    tets: Vec<u32>,
    ways: Vec<Way>,
    /// Ways from each.
    of_tet: Vec<Vec<u32>>,
    /// -1 below the cut, 1 above it, 0 not known.
    sides: Vec<i8>,
}

impl Network {
    /// The tetrahedra `tets`, ascending. `price`: area [m2] that counts for a face; none where it is cut already.
    pub(super) fn of(patch: &Patch, tets: &[u32], price: impl Fn([u32; 3]) -> Option<f64>) -> Self {
        let mut faces: Vec<([u32; 3], u32)> = Vec::with_capacity(FACES.len() * tets.len());
        for (at, &tet) in tets.iter().enumerate() {
            let nodes = patch.tets[tet as usize].nodes;
            faces.extend(FACES.map(|face| (sorted(face.map(|i| nodes[i])), at as u32)));
        }
        faces.sort_unstable();
        let mut this = Self {
            tets: tets.to_vec(),
            ways: Vec::with_capacity(faces.len()),
            of_tet: vec![Vec::new(); tets.len()],
            sides: vec![0; tets.len()],
        };
        for pair in faces.windows(2).filter(|w| w[0].0 == w[1].0) {
            let (face, [a, b]) = (pair[0].0, [pair[0].1, pair[1].1]);
            let Some(room_m2) = price(face) else { continue };
            let first = this.ways.len() as u32;
            this.ways.push(Way { to: b, back: first + 1, room_m2, face });
            this.ways.push(Way { to: a, back: first, room_m2, face });
            this.of_tet[a as usize].push(first);
            this.of_tet[b as usize].push(first + 1);
        }
        this
    }

    /// Tells the side of a tetrahedron, -1 or 1, or 0 for nothing; one that is told both is on neither.
    pub(super) fn set_side(&mut self, tet: u32, side: i8) {
        if let (Ok(at), true) = (self.tets.binary_search(&tet), side != 0) {
            self.sides[at] = if self.sides[at] == 0 || self.sides[at] == side { side } else { BOTH };
        }
    }

    /// The faces of the least area between what is below and what is above, and that area [m2]; none where nothing is known to be
    /// below, or above.
    pub(super) fn least_cut(&mut self) -> Option<(Vec<[u32; 3]>, f64)> {
        for side in self.sides.iter_mut().filter(|side| **side == BOTH) {
            *side = 0;
        }
        if ![-1, 1].into_iter().all(|side| self.sides.contains(&side)) {
            return None;
        }
        let mut flow_m2 = 0.0;
        loop {
            let from = self.reached();
            let Some(end) = (0..self.tets.len()).find(|&t| self.sides[t] > 0 && from[t] != NONE) else {
                let is_below = |t: u32| from[t as usize] != NONE;
                let is_full = |w: &&Way| is_below(self.ways[w.back as usize].to) && !is_below(w.to);
                return Some((self.ways.iter().filter(is_full).map(|w| w.face).collect(), flow_m2));
            };
            let mut ways = Vec::new();
            let mut at = end;
            while self.sides[at] >= 0 {
                let way = from[at];
                ways.push(way);
                at = self.ways[self.ways[way as usize].back as usize].to as usize;
            }
            let least_m2 = ways.iter().map(|&w| self.ways[w as usize].room_m2).fold(f64::INFINITY, f64::min);
            for way in ways {
                self.ways[way as usize].room_m2 -= least_m2;
                let back = self.ways[way as usize].back as usize;
                self.ways[back].room_m2 += least_m2;
            }
            flow_m2 += least_m2;
        }
    }

    /// The last way to each tetrahedron from what is below, [`NONE`] where there is none; to what is below itself any.
    fn reached(&self) -> Vec<u32> {
        let mut from = vec![NONE; self.tets.len()];
        let mut queue: Vec<u32> =
            (0..self.tets.len() as u32).filter(|&t| self.sides[t as usize] < 0).collect();
        for &t in &queue {
            from[t as usize] = 0;
        }
        let mut n_done = 0;
        while n_done < queue.len() {
            let tet = queue[n_done] as usize;
            n_done += 1;
            for &way in &self.of_tet[tet] {
                let Way { to, room_m2, .. } = self.ways[way as usize];
                if room_m2 > 0.0 && from[to as usize] == NONE {
                    from[to as usize] = way;
                    queue.push(to);
                }
            }
        }
        from
    }
}

/// Of what the faces of the cut and the surface enclose, and that is smaller than `least_m3`, the largest of these faces stays uncut.
pub(super) fn keep_crumbs(patch: &mut Patch, body: Body<'_>, least_m3: f64) {
    let mut starts: Vec<u32> =
        patch.cut.iter().flat_map(|&face| patch.pair_at_face(face)).flatten().collect();
    starts.sort_unstable();
    starts.dedup();
    for start in starts {
        let walls = walls_of_crumb(patch, body, start, least_m3);
        let area_m2 = |face: &[u32; 3]| patch.face_area_m2(*face);
        if let Some(largest) = walls.into_iter().max_by(|p, q| area_m2(p).total_cmp(&area_m2(q))) {
            patch.cut.retain(|face| *face != largest);
        }
    }
}

/// The faces of the cut around all that hangs together with `start`; none if that is more than `least_m3`.
fn walls_of_crumb(patch: &mut Patch, body: Body<'_>, start: u32, least_m3: f64) -> Vec<[u32; 3]> {
    let (mut crumb, mut walls) = (vec![start], Vec::new());
    let (mut n_done, mut crumb_m3) = (0, tetrahedron_volume_m3(patch.present_m(start)));
    while n_done < crumb.len() {
        if crumb_m3 >= least_m3 {
            return Vec::new();
        }
        let tet = crumb[n_done];
        let nodes = patch.tets[tet as usize].nodes;
        n_done += 1;
        for face in FACES.map(|face| sorted(face.map(|i| nodes[i]))) {
            patch.pull_star(body, face[0]);
            let Some(other) = patch.tets_at_face(face).find(|&t| t != tet) else { continue };
            if patch.cut.binary_search(&face).is_ok() {
                walls.push((face, other));
            } else if !crumb.contains(&other) {
                crumb_m3 += tetrahedron_volume_m3(patch.present_m(other));
                crumb.push(other);
            }
        }
    }
    // A cut within it parts it from nothing.
    walls.into_iter().filter(|wall| !crumb.contains(&wall.1)).map(|wall| wall.0).collect()
}
