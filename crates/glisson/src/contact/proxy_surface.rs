//! Which triangles of a surface lie around a vertex or across an edge, while cuts put triangles in and take them out.
//!
//! Triangles have slots as in [`super::tool_contact::SurfaceSearch`]. The corners at a vertex form a linked list, so that
//! a triangle comes in constant time and goes in the time of its corners' rings, both without allocation. The order in a
//! list depends on the history of the edits: what is chosen from a ring has to be chosen by value, not by order.

/// End of a list, or a corner of an empty slot.
const NONE: u32 = u32::MAX;

/// Triangles in slots, and the corners at each vertex.
#[derive(Clone, Debug, Default)]
pub struct SurfaceAdjacency {
    triangles: Vec<Option<[u32; 3]>>,
    /// First corner (3 slot + place) at each vertex.
    first: Vec<u32>,
    /// Next corner at the same vertex, for each corner.
    next: Vec<u32>,
}

impl SurfaceAdjacency {
    /// For `triangles` over `n_vertices`, with `n_spare` slots more.
    ///
    /// # Panics
    /// When a triangle names a vertex that is not there.
    pub fn new(n_vertices: usize, triangles: &[[u32; 3]], n_spare: usize) -> Self {
        let n_slots = triangles.len() + n_spare;
        let mut adjacency = Self {
            triangles: vec![None; n_slots],
            first: vec![NONE; n_vertices],
            next: vec![NONE; 3 * n_slots],
        };
        for (slot, &triangle) in triangles.iter().enumerate() {
            adjacency.set_triangle(slot as u32, Some(triangle));
        }
        adjacency
    }

    /// Number of slots.
    pub fn n_slots(&self) -> usize {
        self.triangles.len()
    }

    /// Number of vertices.
    pub fn n_vertices(&self) -> usize {
        self.first.len()
    }

    /// Makes room for more slots and vertices; allocates.
    pub fn grow(&mut self, n_vertices: usize, n_slots: usize) {
        self.first.resize(n_vertices.max(self.first.len()), NONE);
        self.triangles.resize(n_slots.max(self.triangles.len()), None);
        self.next.resize(3 * self.triangles.len(), NONE);
    }

    /// Vertices of a slot, counter-clockwise from outside; `None` when it is empty or does not exist.
    #[inline]
    pub fn triangle(&self, slot: u32) -> Option<[u32; 3]> {
        self.triangles.get(slot as usize).copied().flatten()
    }

    /// Puts a triangle into a slot, or takes it out.
    ///
    /// # Panics
    /// When there is no such slot or vertex.
    pub fn set_triangle(&mut self, slot: u32, triangle: Option<[u32; 3]>) {
        let old = self.triangles[slot as usize];
        if old == triangle {
            return;
        }
        for (place, vertex) in (0..).zip(old.into_iter().flatten()) {
            self.unlink(vertex, 3 * slot + place);
        }
        for (place, vertex) in (0..).zip(triangle.into_iter().flatten()) {
            let corner = 3 * slot + place;
            self.next[corner as usize] = self.first[vertex as usize];
            self.first[vertex as usize] = corner;
        }
        self.triangles[slot as usize] = triangle;
    }

    fn unlink(&mut self, vertex: u32, corner: u32) {
        let after = self.next[corner as usize];
        let first = &mut self.first[vertex as usize];
        if *first == corner {
            *first = after;
            return;
        }
        let mut at = *first;
        while self.next[at as usize] != corner {
            at = self.next[at as usize];
        }
        self.next[at as usize] = after;
    }

    /// Slots of the triangles at a vertex, each with the place of the vertex in it; in no meaningful order.
    #[inline]
    pub fn around(&self, vertex: u32) -> impl Iterator<Item = (u32, usize)> + '_ {
        let mut corner = self.first.get(vertex as usize).copied().unwrap_or(NONE);
        std::iter::from_fn(move || {
            if corner == NONE {
                return None;
            }
            let found = (corner / 3, corner as usize % 3);
            corner = self.next[corner as usize];
            Some(found)
        })
    }

    /// Whether every list holds exactly the corners of the triangles, and each corner once: for tests.
    pub fn is_consistent(&self) -> bool {
        let mut seen = vec![false; self.next.len()];
        for vertex in 0..self.first.len() as u32 {
            for (slot, place) in self.around(vertex) {
                let is_right = self.triangle(slot).is_some_and(|t| t[place] == vertex);
                let seen = &mut seen[3 * slot as usize + place];
                if !is_right || *seen {
                    return false;
                }
                *seen = true;
            }
        }
        seen.chunks_exact(3).zip(&self.triangles).all(|(corners, t)| corners == [t.is_some(); 3])
    }
}
