//! Topological operators that keep three neighbours a vertex and the Euler characteristic.
//!
//! - T1 removes an edge with its two vertices: the cells on its sides become one. In the dual an edge
//!   collapses.
//! - T2 cuts a cell by a new edge between two new vertices on two edges of its contour. In the dual a vertex
//!   is split.
//! - A swap turns an edge across: the cells on its sides part, those at its ends meet. In the dual an edge
//!   flips; it is a T2 followed by a T1.
//!
//! T3 and T4, which would change the genus, are left out: an organ is a ball. An operator that would leave a
//! cell of two vertices or two cells with two common edges is refused and changes nothing.
//! Source: H. Delingette 1999, doi 10.1023/A:1008157432188.

use super::mesh::SimplexMesh;

const REMOVED: u32 = u32::MAX;

/// A mesh being edited: indices stay while it is, removed vertices and cells leave holes until
/// [`SimplexEdit::finish`].
#[derive(Clone, Debug)]
pub struct SimplexEdit {
    mesh: SimplexMesh,
    n_cells: usize,
}

/// What T1 took away and left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MergedCells {
    /// The cell that now covers both.
    pub kept: u32,
    /// The cell that is gone.
    pub removed: u32,
    /// The vertices that are gone.
    pub removed_vertices: [u32; 2],
}

/// What T2 made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitCell {
    /// The new cell.
    pub cell: u32,
    /// The new vertices.
    pub vertices: [u32; 2],
}

impl SimplexEdit {
    /// Starts to edit a valid mesh.
    pub fn new(mesh: SimplexMesh) -> Self {
        Self { n_cells: mesh.n_cells(), mesh }
    }

    /// The mesh with its holes: a removed vertex has the neighbours `[u32::MAX; 3]`.
    pub fn mesh(&self) -> &SimplexMesh {
        &self.mesh
    }

    /// Cells that there are now.
    pub fn n_cells(&self) -> usize {
        self.n_cells
    }

    /// Whether a vertex is still there.
    pub fn has_vertex(&self, vertex: u32) -> bool {
        self.mesh.neighbours[vertex as usize][0] != REMOVED
    }

    /// Whether a cell is still there.
    pub fn has_cell(&self, cell: u32) -> bool {
        self.mesh.first_of_cell[cell as usize] != REMOVED
    }

    /// Cells around `cell`, one for each edge of its contour: the `i`-th beyond the edge from vertex `i` to the
    /// next.
    pub fn cells_around(&self, cell: u32) -> Vec<u32> {
        self.mesh.contour(cell).into_iter().map(|v| self.beyond(cell, v)).collect()
    }

    /// The cell beyond the contour's edge from `vertex` to the next.
    fn beyond(&self, cell: u32, vertex: u32) -> u32 {
        let cells = self.mesh.cells[vertex as usize];
        cells[(place_of(&cells, cell) + 2) % 3]
    }

    fn n_sides(&self, cell: u32) -> usize {
        self.mesh.contour(cell).len()
    }

    /// Whether [`SimplexEdit::remove_edge`] would be done.
    pub fn can_remove_edge(&self, vertex: u32, side: usize) -> bool {
        if !self.has_vertex(vertex) || self.n_cells <= 4 {
            return false;
        }
        let other = self.mesh.neighbours[vertex as usize][side];
        let (x, a, b, y) = self.cells_at(vertex, side, other);
        if x == y || self.n_sides(x) < 4 || self.n_sides(y) < 4 {
            return false;
        }
        let (around_a, around_b) = (self.cells_around(a), self.cells_around(b));
        // The link condition: no third cell meets both.
        around_a.len() + around_b.len() >= 7 && around_a.iter().filter(|c| around_b.contains(c)).count() == 2
    }

    /// T1: removes the edge from `vertex` to its neighbour `side` and both its ends; the cells on its sides
    /// become the first of them. None if that is refused.
    pub fn remove_edge(&mut self, vertex: u32, side: usize) -> Option<MergedCells> {
        if !self.can_remove_edge(vertex, side) {
            return None;
        }
        let other = self.mesh.neighbours[vertex as usize][side];
        let (x, a, b, y) = self.cells_at(vertex, side, other);
        let contour_b = self.mesh.contour(b);
        for (end, across) in [(vertex, other), (other, vertex)] {
            let at = place_of(&self.mesh.neighbours[end as usize], across);
            let [p, q] = [1, 2].map(|step| self.mesh.neighbours[end as usize][(at + step) % 3]);
            self.replace_neighbour(p, end, q);
            self.replace_neighbour(q, end, p);
            let beyond = if end == vertex { x } else { y };
            self.mesh.first_of_cell[beyond as usize] = p;
            self.mesh.first_of_cell[a as usize] = p;
        }
        for v in contour_b {
            for cell in &mut self.mesh.cells[v as usize] {
                if *cell == b {
                    *cell = a;
                }
            }
        }
        for end in [vertex, other] {
            self.mesh.neighbours[end as usize] = [REMOVED; 3];
            self.mesh.cells[end as usize] = [REMOVED; 3];
        }
        self.mesh.first_of_cell[b as usize] = REMOVED;
        self.n_cells -= 1;
        Some(MergedCells { kept: a, removed: b, removed_vertices: [vertex, other] })
    }

    /// T2: cuts `cell` from the middle of its contour's edge `from` to that of its edge `to` (edge `i` runs from
    /// vertex `i` of [`SimplexMesh::contour`] to the next). The new cell has the vertices after `to` up to
    /// `from`. None for a removed cell or equal or missing edges.
    pub fn split_cell(&mut self, cell: u32, from: usize, to: usize) -> Option<SplitCell> {
        if !self.has_cell(cell) {
            return None;
        }
        let contour = self.mesh.contour(cell);
        let n = contour.len();
        if from == to || from >= n || to >= n {
            return None;
        }
        let new_cell = u32::try_from(self.mesh.first_of_cell.len()).ok()?;
        let first = u32::try_from(self.mesh.positions_m.len()).ok().filter(|&v| v < REMOVED - 1)?;
        let ends = [first, first + 1];
        let sides = [from, to].map(|i| [contour[i], contour[(i + 1) % n]]);
        let beyond = sides.map(|[v, _]| self.beyond(cell, v));
        for at in 0..2 {
            let [back, ahead] = sides[at];
            let middle = 0.5 * (self.mesh.positions_m[back as usize] + self.mesh.positions_m[ahead as usize]);
            // The cell before the new vertex and the one after it, going round the old contour.
            let (before, after) = if at == 0 { (new_cell, cell) } else { (cell, new_cell) };
            self.mesh.positions_m.push(middle);
            self.mesh.neighbours.push([ahead, ends[1 - at], back]);
            self.mesh.cells.push([before, beyond[at], after]);
        }
        for at in 0..2 {
            let [back, ahead] = sides[at];
            self.replace_neighbour(back, ahead, ends[at]);
            self.replace_neighbour(ahead, back, ends[at]);
        }
        let mut i = (to + 1) % n;
        loop {
            for c in &mut self.mesh.cells[contour[i] as usize] {
                if *c == cell {
                    *c = new_cell;
                }
            }
            if i == from {
                break;
            }
            i = (i + 1) % n;
        }
        self.mesh.first_of_cell[cell as usize] = ends[0];
        self.mesh.first_of_cell.push(ends[0]);
        self.n_cells += 1;
        Some(SplitCell { cell: new_cell, vertices: ends })
    }

    /// The cells that lose an edge in [`SimplexEdit::swap_edge`] and those that gain one; none if it would be
    /// refused.
    pub fn swap_cells(&self, vertex: u32, side: usize) -> Option<([u32; 2], [u32; 2])> {
        if !self.has_vertex(vertex) {
            return None;
        }
        let other = self.mesh.neighbours[vertex as usize][side];
        let (x, a, b, y) = self.cells_at(vertex, side, other);
        let apart = x != y && !self.cells_around(x).contains(&y);
        (apart && self.n_sides(a) >= 4 && self.n_sides(b) >= 4).then_some(([a, b], [x, y]))
    }

    /// Turns the edge from `vertex` to its neighbour `side` across, about its middle. Says whether it was done.
    pub fn swap_edge(&mut self, vertex: u32, side: usize) -> bool {
        if self.swap_cells(vertex, side).is_none() {
            return false;
        }
        let other = self.mesh.neighbours[vertex as usize][side];
        let (x, a, b, y) = self.cells_at(vertex, side, other);
        let back = place_of(&self.mesh.neighbours[other as usize], vertex);
        // Named by the cell they do not touch.
        let [v_a, v_b] = [1, 2].map(|step| self.mesh.neighbours[vertex as usize][(side + step) % 3]);
        let [w_b, w_a] = [1, 2].map(|step| self.mesh.neighbours[other as usize][(back + step) % 3]);
        let at_m = |v: u32| self.mesh.positions_m[v as usize];
        let middle = 0.5 * (at_m(vertex) + at_m(other));
        let half_length = 0.5 * at_m(vertex).distance(at_m(other));
        let across = (at_m(v_b) + at_m(w_b) - at_m(v_a) - at_m(w_a)).normalize_or_zero();
        self.mesh.positions_m[vertex as usize] = middle + half_length * across;
        self.mesh.positions_m[other as usize] = middle - half_length * across;
        self.mesh.cells[vertex as usize] = [x, a, y];
        self.mesh.neighbours[vertex as usize] = [w_b, other, v_b];
        self.mesh.cells[other as usize] = [x, y, b];
        self.mesh.neighbours[other as usize] = [w_a, v_a, vertex];
        self.replace_neighbour(w_b, other, vertex);
        self.replace_neighbour(v_a, vertex, other);
        for (cell, first) in [(x, vertex), (y, vertex), (a, vertex), (b, other)] {
            self.mesh.first_of_cell[cell as usize] = first;
        }
        true
    }

    /// The mesh without holes, vertices and cells in the order they had.
    pub fn finish(self) -> SimplexMesh {
        let number = |there: Vec<bool>| {
            let mut next = 0u32;
            there
                .into_iter()
                .map(|there| {
                    next += u32::from(there);
                    if there { next - 1 } else { REMOVED }
                })
                .collect::<Vec<u32>>()
        };
        let mesh = &self.mesh;
        let vertices = number(mesh.neighbours.iter().map(|n| n[0] != REMOVED).collect());
        let cells = number(mesh.first_of_cell.iter().map(|&f| f != REMOVED).collect());
        let kept = (0..vertices.len()).filter(|&v| vertices[v] != REMOVED);
        let mut compact = SimplexMesh {
            positions_m: Vec::new(),
            neighbours: Vec::new(),
            cells: Vec::new(),
            first_of_cell: Vec::new(),
        };
        for v in kept {
            compact.positions_m.push(mesh.positions_m[v]);
            compact.neighbours.push(mesh.neighbours[v].map(|n| vertices[n as usize]));
            compact.cells.push(mesh.cells[v].map(|c| cells[c as usize]));
        }
        let firsts = mesh.first_of_cell.iter().filter(|&&f| f != REMOVED);
        compact.first_of_cell = firsts.map(|&f| vertices[f as usize]).collect();
        compact
    }

    /// The cells around an edge: at the end `vertex`, on its two sides, at the other end.
    pub(super) fn cells_at(&self, vertex: u32, side: usize, other: u32) -> (u32, u32, u32, u32) {
        let own = self.mesh.cells[vertex as usize];
        let back = place_of(&self.mesh.neighbours[other as usize], vertex);
        (own[side], own[(side + 1) % 3], own[(side + 2) % 3], self.mesh.cells[other as usize][back])
    }

    fn replace_neighbour(&mut self, of: u32, old: u32, new: u32) {
        let neighbours = &mut self.mesh.neighbours[of as usize];
        neighbours[place_of(neighbours, old)] = new;
    }
}

/// Which of three is `wanted`.
///
/// # Panics
/// If none is: the mesh was not valid.
fn place_of(three: &[u32; 3], wanted: u32) -> usize {
    three.iter().position(|&x| x == wanted).expect("neighbours and cells of a valid mesh are mutual")
}
