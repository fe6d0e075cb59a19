//! The body-centred cubic lattice: two interleaved cubic lattices, "even" (cube corners) and "odd" (cube
//! centres), and the tetrahedra between them.
//!
//! Every node has 14 neighbours: six of its own kind at the cube edge `h` (long edges) and eight of the
//! other kind at `sqrt(3)/2 h` (short edges). Every tetrahedron has one long even edge, one long odd edge
//! opposite to it, and four short edges; all are congruent, of volume h^3/12.

use crate::math::DVec3;

/// Number of neighbours of a node.
pub(super) const N_DIRECTIONS: usize = 14;

/// Number of edges that a node owns: each lattice edge is owned by one of its ends.
pub(super) const N_OWNED: usize = 7;

/// Directions of the owned edges: +x, +y, +z and the four short ones that go up.
pub(super) const OWNED_DIRECTIONS: [usize; N_OWNED] = [0, 2, 4, 10, 11, 12, 13];

/// Mean length of the lattice's edges over `h`: (3 + 4 sqrt(3)/2) / 7 for three long and four short edges
/// a node.
pub const MEAN_EDGE_OVER_CELL: f64 = 0.923_443_087_876_822;

/// Volume of a lattice tetrahedron over `h^3`.
pub const TETRAHEDRON_OVER_CELL: f64 = 1.0 / 12.0;

/// Where the lattice is: even node (i, j, k) at `origin_m + cell_m (i, j, k)`, odd node half a cell further
/// along x, y and z; both kinds have `dims` nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    /// Number of nodes of each kind along x, y, z.
    pub dims: [usize; 3],
    /// Edge of the cube `h` [m].
    pub cell_m: f64,
    /// Even node (0, 0, 0) [m].
    pub origin_m: DVec3,
}

/// Offset of a direction in half cells: long ones have one component of 2, short ones three of 1.
pub(super) fn direction_half_cells(direction: usize) -> [i32; 3] {
    if direction < 6 {
        let mut offset = [0; 3];
        offset[direction / 2] = if direction.is_multiple_of(2) { 2 } else { -2 };
        return offset;
    }
    let bits = direction - 6;
    [0, 1, 2].map(|axis| if bits >> axis & 1 == 1 { 1 } else { -1 })
}

/// The direction back.
pub(super) fn opposite(direction: usize) -> usize {
    if direction < 6 { direction ^ 1 } else { 6 + ((direction - 6) ^ 7) }
}

/// Whether the direction is a long edge's.
pub(super) fn is_long(direction: usize) -> bool {
    direction < 6
}

/// Of each direction a mask of the directions whose nodes are neighbours of its node: the link of a node, a
/// triangulated sphere.
pub(super) fn link_masks() -> [u16; N_DIRECTIONS] {
    let mut masks = [0; N_DIRECTIONS];
    for a in 0..N_DIRECTIONS {
        for b in 0..N_DIRECTIONS {
            let (p, q) = (direction_half_cells(a), direction_half_cells(b));
            let mut difference = [0, 1, 2].map(|axis| (p[axis] - q[axis]).abs());
            difference.sort_unstable();
            if difference == [0, 0, 2] || difference == [1, 1, 1] {
                masks[a] |= 1 << b;
            }
        }
    }
    masks
}

impl Lattice {
    /// Number of nodes of both kinds.
    pub fn n_nodes(&self) -> usize {
        2 * self.dims.iter().product::<usize>()
    }

    /// Node of grid place (i, j, k), odd or even.
    pub(super) fn node(&self, [i, j, k]: [usize; 3], odd: bool) -> usize {
        2 * (i + self.dims[0] * (j + self.dims[1] * k)) + usize::from(odd)
    }

    /// Grid place of a node.
    pub(super) fn place(&self, node: usize) -> [usize; 3] {
        let (row, i) = (node / 2 / self.dims[0], node / 2 % self.dims[0]);
        [i, row % self.dims[1], row / self.dims[1]]
    }

    /// Coordinates of a node in half cells.
    pub(in crate::mesh) fn half_cells(&self, node: usize) -> [i32; 3] {
        self.place(node).map(|n| 2 * n as i32 + (node & 1) as i32)
    }

    /// Position of a node [m].
    pub fn position_m(&self, node: usize) -> DVec3 {
        let [x, y, z] = self.half_cells(node);
        self.origin_m + 0.5 * self.cell_m * DVec3::new(f64::from(x), f64::from(y), f64::from(z))
    }

    /// Calls `visit` with the nodes of every tetrahedron of the self.
    pub(in crate::mesh) fn for_each_tet(&self, mut visit: impl FnMut([usize; 4])) {
        let [ni, nj, nk] = self.dims;
        for k in 0..nk {
            for j in 0..nj {
                for i in 0..ni {
                    for axis in 0..3 {
                        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                        let mut far = [i, j, k];
                        far[axis] += 1;
                        let mut last = far;
                        last[b] += 1;
                        last[c] += 1;
                        if (0..3).any(|a| last[a] >= self.dims[a]) {
                            continue;
                        }
                        // Two neighbouring cube centres and, around the edge between them, the square's corners.
                        let corner = |on_b: usize, on_c: usize| {
                            let mut place = far;
                            place[b] += on_b;
                            place[c] += on_c;
                            self.node(place, false)
                        };
                        let ring = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                        let ends = [self.node([i, j, k], true), self.node(far, true)];
                        for at in 0..4 {
                            visit([ends[0], ends[1], ring[at], ring[(at + 1) % 4]]);
                        }
                    }
                }
            }
        }
    }

    /// Whether a node is at least `layers` layers away from the lattice's border. From 1 on all its
    /// neighbours exist.
    pub(in crate::mesh) fn is_interior(&self, node: usize, layers: usize) -> bool {
        let place = self.place(node);
        (0..3).all(|axis| place[axis] >= layers && place[axis] + layers < self.dims[axis])
    }

    /// The 14 neighbours of an interior node.
    pub(in crate::mesh) fn neighbours(&self, node: usize) -> [usize; N_DIRECTIONS] {
        self.neighbour_steps()[node & 1].map(|step| stepped(node, step))
    }

    /// Neighbours' node numbers minus the node's, for an even and for an odd node. Both hold for interior
    /// nodes only.
    pub(super) fn neighbour_steps(&self) -> [[isize; N_DIRECTIONS]; 2] {
        let strides = [2, 2 * self.dims[0] as isize, 2 * (self.dims[0] * self.dims[1]) as isize];
        [0, 1].map(|odd: isize| {
            std::array::from_fn(|direction| {
                let offset = direction_half_cells(direction);
                let other_kind = if is_long(direction) { odd } else { 1 - odd };
                // Half cells: kind + 2 place, so place steps are (offset + kind - other kind) / 2.
                let step = (0..3)
                    .map(|axis| (offset[axis] as isize + odd - other_kind) / 2 * strides[axis])
                    .sum::<isize>();
                step + other_kind - odd
            })
        })
    }
}

/// `node` moved by a neighbour step.
pub(super) fn stepped(node: usize, step: isize) -> usize {
    node.wrapping_add_signed(step)
}
