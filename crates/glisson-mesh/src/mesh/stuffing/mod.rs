//! Isosurface stuffing: the inside of a level set filled with tetrahedra of bounded dihedral angles.
//!
//! Labelle and Shewchuk, Isosurface Stuffing: Fast Tetrahedral Meshes with Good Dihedral Angles, ACM
//! Transactions on Graphics 26(3), 2007, doi 10.1145/1276377.1276448, the uniform version:
//! 1. the field is sampled at the nodes of a body-centred cubic [`Lattice`];
//! 2. where an edge's ends lie on different sides, a cut point is found on it;
//! 3. a node with a cut point nearer than `alpha` times the edge ([`ALPHA_LONG`], [`ALPHA_SHORT`]) is warped
//!    to its nearest one and lies on the surface; the other cut points of its edges go;
//! 4. every tetrahedron is filled by its stencil (`stencils.rs`).
//!
//! The paper states dihedral angles between 10.7 and 164.8 degrees for these thresholds. A random search over
//! all positions of warped nodes and cut points, taken as independent, goes down to 9.2 degrees, so the bound
//! is measured and kept here, and three things are added, all by making lattice nodes *stiff*: a stiff node is never
//! warped, its cut points are kept at least `alpha` away from it. With all nodes stiff the angles lie between
//! 12.7 and 155.0 degrees and the surface is a manifold, so that the loop that stiffens nodes always ends:
//! - where the surface is pinched (a node or an edge at which more than one fan of triangles meets), the
//!   warped nodes concerned become stiff;
//! - where a tetrahedron breaks the bound, its farthest warped node becomes stiff;
//! - where the wanted topology is not that of the sampled signs, the signs of few nodes are changed
//!   (`signs.rs`; thin parts that show as a chain of crumbs are joined first, `joining.rs`), and those nodes become
//!   stiff.
//!
//! Stiffness and changed signs stay for later levels of the same field, so that the volume as a function of
//! the level has no large jumps.

mod joining;
mod lattice;
mod signs;
mod stencils;

pub use lattice::{Lattice, MEAN_EDGE_OVER_CELL, TETRAHEDRON_OVER_CELL};
pub use signs::{SignChanges, WantedTopology};

use super::quality::{SurfaceShape, dihedral_cosine_range};
use super::{NodeId, TetMesh};
use crate::math::DVec3;
use lattice::{N_DIRECTIONS, N_OWNED, OWNED_DIRECTIONS, is_long, opposite};
use signs::SignGrid;
use stencils::{Key, Pieces, Sign, Stencil};

/// A node is warped to a cut point on a long edge nearer than this part of the edge.
pub const ALPHA_LONG: f64 = 0.24999;

/// A node is warped to a cut point on a short edge nearer than this part of the edge.
pub const ALPHA_SHORT: f64 = 0.41189;

/// Smallest dihedral angle [degrees] that a filled mesh has.
pub const MIN_DIHEDRAL_DEG: f64 = 10.7;

/// Largest dihedral angle [degrees] that a filled mesh has.
pub const MAX_DIHEDRAL_DEG: f64 = 164.8;

/// Place of a cut point on its edge is found to this part of the edge.
const CUT_TOLERANCE: f64 = 1e-10;

/// Why a level set cannot be filled.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StuffingError {
    /// No lattice node is inside.
    #[error("no lattice node lies inside at {cell_m} m cells: take smaller ones")]
    NothingInside {
        /// Lattice cell [m].
        cell_m: f64,
    },
    /// The signs at the lattice nodes do not have the wanted topology and no repair was found.
    #[error(
        "at {cell_m} m cells the lattice sees {} bodies, {} cavities and Euler number {}, but {}, {} and {} are \
         wanted",
        found.bodies, found.cavities, found.surface_euler_characteristic,
        wanted.bodies, wanted.cavities, wanted.surface_euler_characteristic
    )]
    Topology {
        /// Lattice cell [m].
        cell_m: f64,
        /// What the sampled signs stand for.
        found: WantedTopology,
        /// What was asked for.
        wanted: WantedTopology,
    },
    /// The filled mesh has another topology than its signs though every node is stiff.
    #[error(
        "the filled surface has {pieces} pieces and Euler number {euler_characteristic}, against the signs"
    )]
    Inconsistent {
        /// Connected surfaces found.
        pieces: usize,
        /// Euler characteristic found.
        euler_characteristic: i64,
    },
}

/// A filled level set.
#[derive(Clone, Debug)]
pub struct Filling {
    /// The tetrahedra; nodes and tetrahedra in lattice order.
    pub mesh: TetMesh,
    /// Surface triangles over the mesh's nodes, counter-clockwise seen from outside.
    pub surface: Vec<[u32; 3]>,
    /// Shape of the surface.
    pub shape: SurfaceShape,
    /// Crumbs and cavities removed before filling.
    pub sign_changes: SignChanges,
}

/// Fills level sets of one field on one lattice. `field(position)` is negative inside, like a signed
/// distance, and roughly in metres; it is cut where it equals the level.
pub struct Stuffing<F: Fn(DVec3) -> f64> {
    lattice: Lattice,
    field: F,
    wanted: WantedTopology,
    values: Vec<f64>,
    forced: Vec<Option<bool>>,
    stiff: Vec<bool>,
}

impl<F: Fn(DVec3) -> f64> Stuffing<F> {
    /// Samples the field at the lattice's nodes. Nodes in the lattice's two border layers count
    /// as outside.
    pub fn new(lattice: Lattice, field: F, wanted: WantedTopology) -> Self {
        let n_nodes = lattice.n_nodes();
        let values = (0..n_nodes).map(|n| field(lattice.position_m(n))).collect();
        Self { lattice, field, wanted, values, forced: vec![None; n_nodes], stiff: vec![false; n_nodes] }
    }

    /// The lattice.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Number of lattice nodes whose sign was changed for the topology.
    pub fn n_changed_signs(&self) -> usize {
        self.forced.iter().filter(|f| f.is_some()).count()
    }

    /// Number of lattice nodes that may not be warped.
    pub fn n_stiff(&self) -> usize {
        self.stiff.iter().filter(|s| **s).count()
    }

    /// Fills the inside of the surface `field = level`.
    ///
    /// # Errors
    /// [`StuffingError`] when nothing is inside or the wanted topology cannot be had.
    pub fn fill(&mut self, level: f64) -> Result<Filling, StuffingError> {
        let (inside, sign_changes) = self.wanted_signs(level)?;
        let grid = SignGrid::new(&self.lattice);
        let wanted_pieces = self.wanted.bodies + self.wanted.cavities;
        let cuts = self.cut_places(&grid, &inside, level);
        let mut all_stiff = false;
        loop {
            let warped = Warped::new(&self.lattice, &grid, &inside, &self.stiff, cuts.clone());
            let (filling, keys) = warped.filled(&grid, sign_changes);
            let mut newly_stiff: Vec<usize> = Vec::new();
            let pinched = filling.shape.pinched_vertices.iter().copied();
            let pinched = pinched.chain(filling.shape.pinched_edges.iter().flatten().copied());
            newly_stiff.extend(pinched.filter_map(|v| lattice_node(keys[v as usize])));
            newly_stiff.extend(bad_angle_nodes(&filling.mesh, &keys, &self.lattice));
            newly_stiff.retain(|&n| warped.signs[n] == Sign::OnSurface);
            if newly_stiff.is_empty() {
                let shape = &filling.shape;
                let is_wanted = shape.is_closed_manifold()
                    && shape.pieces == wanted_pieces
                    && shape.euler_characteristic == self.wanted.surface_euler_characteristic;
                if is_wanted {
                    return Ok(filling);
                }
                if all_stiff {
                    return Err(StuffingError::Inconsistent {
                        pieces: shape.pieces,
                        euler_characteristic: shape.euler_characteristic,
                    });
                }
                // A warped node closed or opened a passage that the signs do not have: first the nodes whose
                // neighbours are not in one patch inside and one outside, at last all.
                let on_surface = |&n: &usize| warped.signs[n] == Sign::OnSurface;
                newly_stiff = (0..self.lattice.n_nodes())
                    .filter(on_surface)
                    .filter(|&n| !warped.has_simple_link(&grid, n))
                    .collect();
                if newly_stiff.is_empty() {
                    newly_stiff = (0..self.lattice.n_nodes()).collect();
                    all_stiff = true;
                }
            }
            for node in newly_stiff {
                self.stiff[node] = true;
            }
        }
    }

    /// Place of the cut point on each owned edge between an inside and an outside node as a part of the edge
    /// from its owner; NaN on other edges. Where the sign of an end was changed and the field does not cross
    /// the level: as near as possible to the changed node.
    fn cut_places(&self, grid: &SignGrid<'_>, inside: &[bool], level: f64) -> Vec<f64> {
        let mut cuts = vec![f64::NAN; self.lattice.n_nodes() * N_OWNED];
        for node in (0..self.lattice.n_nodes()).filter(|&n| grid.is_interior(n)) {
            for (slot, &direction) in OWNED_DIRECTIONS.iter().enumerate() {
                let other = grid.neighbour(node, direction);
                if inside[node] != inside[other] {
                    let place = cut_place(&self.field, &self.lattice, level, node, other);
                    let next_to_changed = if self.forced[node].is_some() { 0.0 } else { 1.0 };
                    cuts[node * N_OWNED + slot] = place.unwrap_or(next_to_changed);
                }
            }
        }
        cuts
    }

    /// Signs at the level with the wanted topology; nodes changed for it are remembered and become stiff.
    fn wanted_signs(&mut self, level: f64) -> Result<(Vec<bool>, SignChanges), StuffingError> {
        let grid = SignGrid::new(&self.lattice);
        let mut inside: Vec<bool> = (0..self.values.len())
            .map(|n| grid.may_be_inside(n) && self.forced[n].unwrap_or(self.values[n] < level))
            .collect();
        if !inside.contains(&true) {
            return Err(StuffingError::NothingInside { cell_m: self.lattice.cell_m });
        }
        let joining = {
            let is_closed = |node: usize| self.forced[node] == Some(false);
            grid.join_crumbs(&mut inside, &self.values, level, self.wanted.bodies, is_closed)
        };
        let changes = grid.drop_crumbs(&mut inside, self.wanted);
        for &node in joining.iter().filter(|&&node| inside[node]) {
            self.forced[node] = Some(true);
            self.stiff[node] = true;
        }
        let found = grid.topology(&inside);
        if found != self.wanted {
            let repaired = grid
                .repaired(&inside, &self.values, level, self.wanted)
                .filter(|repaired| grid.keeps_to_the_body(&inside, repaired, &self.values, level))
                .ok_or(StuffingError::Topology { cell_m: self.lattice.cell_m, found, wanted: self.wanted })?;
            for node in 0..inside.len() {
                if repaired[node] != inside[node] {
                    self.forced[node] = Some(repaired[node]);
                    self.stiff[node] = true;
                }
            }
            inside = repaired;
        }
        Ok((inside, changes))
    }
}

/// Place of the level's cut point on the edge from `node` to `other`, as a part of the edge; `None` when both
/// ends are on one side (the sign of one was changed).
fn cut_place(
    field: &impl Fn(DVec3) -> f64,
    lattice: &Lattice,
    level: f64,
    node: usize,
    other: usize,
) -> Option<f64> {
    let (a_m, b_m) = (lattice.position_m(node), lattice.position_m(other));
    let at = |t: f64| field(a_m + t * (b_m - a_m)) - level;
    let (mut low, mut high) = ((0.0, at(0.0)), (1.0, at(1.0)));
    if (low.1 < 0.0) == (high.1 < 0.0) {
        return None;
    }
    // Regula falsi with the Illinois rule (Dowell and Jarratt 1971, doi 10.1007/BF01934364), bisection when
    // it is slow.
    let (mut value_low, mut value_high) = (low.1, high.1);
    for iteration in 0..60 {
        let mut t = low.0 + (high.0 - low.0) * value_low / (value_low - value_high);
        if iteration >= 20 || !(t > low.0 && t < high.0) {
            t = 0.5 * (low.0 + high.0);
        }
        let value = at(t);
        if (value < 0.0) == (low.1 < 0.0) {
            low = (t, value);
            value_low = value;
            value_high *= 0.5;
        } else {
            high = (t, value);
            value_high = value;
            value_low *= 0.5;
        }
        if high.0 - low.0 < CUT_TOLERANCE || value.abs() < CUT_TOLERANCE * lattice.cell_m {
            return Some(t);
        }
    }
    Some(0.5 * (low.0 + high.0))
}

fn node_key(node: usize) -> Key {
    (node * (N_OWNED + 1)) as Key
}

/// The lattice node of a key that is not a cut point's.
fn lattice_node(key: Key) -> Option<usize> {
    let (node, slot) = (key as usize / (N_OWNED + 1), key as usize % (N_OWNED + 1));
    (slot == 0).then_some(node)
}

/// Of each tetrahedron that breaks the angle bound the node warped farthest.
fn bad_angle_nodes(mesh: &TetMesh, keys: &[Key], lattice: &Lattice) -> Vec<usize> {
    let highest = libm::cos(MIN_DIHEDRAL_DEG.to_radians());
    let lowest = libm::cos(MAX_DIHEDRAL_DEG.to_radians());
    let mut found = Vec::new();
    for nodes in &mesh.tetrahedra {
        let corners_m = nodes.map(|n| mesh.positions_m[n.index()]);
        let [min, max] = dihedral_cosine_range(corners_m);
        if min >= lowest && max <= highest {
            continue;
        }
        let shifts = nodes.iter().filter_map(|n| {
            let node = lattice_node(keys[n.index()])?;
            Some((mesh.positions_m[n.index()].distance(lattice.position_m(node)), node))
        });
        found.extend(shifts.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, node)| node));
    }
    found
}

/// A lattice after warping.
struct Warped<'a> {
    lattice: &'a Lattice,
    signs: Vec<Sign>,
    /// Positions of the warped nodes, by node, ascending.
    moved_m: Vec<(usize, DVec3)>,
    /// Place of the cut point on each owned edge as a part of it from its owner; NaN for none.
    cuts: Vec<f64>,
}

fn alpha(direction: usize) -> f64 {
    if is_long(direction) { ALPHA_LONG } else { ALPHA_SHORT }
}

/// Owner's slot of each direction, `None` when the edge belongs to its other end.
fn owned_slots() -> [Option<usize>; N_DIRECTIONS] {
    std::array::from_fn(|d| OWNED_DIRECTIONS.iter().position(|&o| o == d))
}

impl<'a> Warped<'a> {
    fn new(
        lattice: &'a Lattice,
        grid: &SignGrid<'_>,
        inside: &[bool],
        stiff: &[bool],
        mut cuts: Vec<f64>,
    ) -> Self {
        let n_nodes = lattice.n_nodes();
        let mut is_cut = vec![false; n_nodes];
        for node in (0..n_nodes).filter(|&n| grid.is_interior(n)) {
            for (slot, &direction) in OWNED_DIRECTIONS.iter().enumerate() {
                let place = &mut cuts[node * N_OWNED + slot];
                if place.is_nan() {
                    continue;
                }
                let other = grid.neighbour(node, direction);
                is_cut[node] = true;
                is_cut[other] = true;
                if stiff[node] {
                    *place = place.max(alpha(direction));
                }
                if stiff[other] {
                    *place = place.min(1.0 - alpha(direction));
                }
            }
        }
        let signs = inside.iter().map(|&i| if i { Sign::Inside } else { Sign::Outside }).collect();
        let mut warped = Self { lattice, signs, moved_m: Vec::new(), cuts };
        for node in (0..n_nodes).filter(|&n| is_cut[n] && !stiff[n] && grid.is_interior(n)) {
            warped.warp(grid, node);
        }
        warped
    }

    /// Warps a node to its nearest cut point within the thresholds, if there is one.
    fn warp(&mut self, grid: &SignGrid<'_>, node: usize) {
        let slots = owned_slots();
        let edge = |direction: usize| {
            if let Some(slot) = slots[direction] {
                return (node * N_OWNED + slot, false);
            }
            let slot = slots[opposite(direction)].expect("one end owns the edge");
            (grid.neighbour(node, direction) * N_OWNED + slot, true)
        };
        let mut nearest: Option<(f64, usize, f64)> = None;
        for direction in 0..N_DIRECTIONS {
            let (at, reversed) = edge(direction);
            let place = if reversed { 1.0 - self.cuts[at] } else { self.cuts[at] };
            // The stiff end keeps its cut points 1 - alpha away exactly; rounding must not warp to them.
            if place < alpha(direction) - 1e-12 {
                let length = if is_long(direction) { 1.0 } else { 0.75f64.sqrt() };
                if nearest.is_none_or(|(found, ..)| place * length < found) {
                    nearest = Some((place * length, direction, place));
                }
            }
        }
        if let Some((_, direction, place)) = nearest {
            let (from_m, to_m) =
                (self.lattice.position_m(node), self.lattice.position_m(grid.neighbour(node, direction)));
            self.moved_m.push((node, from_m + place * (to_m - from_m)));
            self.signs[node] = Sign::OnSurface;
            for direction in 0..N_DIRECTIONS {
                self.cuts[edge(direction).0] = f64::NAN;
            }
        }
    }

    /// Whether a warped node's inside neighbours make one disc around it, and its outside ones too.
    fn has_simple_link(&self, grid: &SignGrid<'_>, node: usize) -> bool {
        let mask_of = |sign: Sign| {
            (0..N_DIRECTIONS)
                .filter(|&d| self.signs[grid.neighbour(node, d)] == sign)
                .fold(0u16, |mask, d| mask | 1 << d)
        };
        // Others on the surface lie between: a patch can be a ring around them, whose Euler characteristic is 0.
        [Sign::Inside, Sign::Outside]
            .map(mask_of)
            .into_iter()
            .all(|mask| grid.is_patch(mask) && grid.link_euler(mask) == 1)
    }

    /// The filled mesh, and the key of each of its nodes.
    fn filled(&self, grid: &SignGrid<'_>, sign_changes: SignChanges) -> (Filling, Vec<Key>) {
        let pieces = self.fill_stencils(grid);
        let mut place_of = vec![u32::MAX; self.lattice.n_nodes() * (N_OWNED + 1)];
        for &key in pieces.tetrahedra.iter().flatten() {
            place_of[key as usize] = 0;
        }
        let mut keys = Vec::new();
        for (key, place) in place_of.iter_mut().enumerate() {
            if *place == 0 {
                *place = keys.len() as u32;
                keys.push(key as Key);
            }
        }
        let mut moved = self.moved_m.iter().peekable();
        let positions_m = keys
            .iter()
            .map(|&key| {
                let node = key as usize / (N_OWNED + 1);
                let slot = key as usize % (N_OWNED + 1);
                if slot == 0 {
                    while moved.peek().is_some_and(|(n, _)| *n < node) {
                        moved.next();
                    }
                    return match moved.peek() {
                        Some((n, position_m)) if *n == node => *position_m,
                        _ => self.lattice.position_m(node),
                    };
                }
                let other = grid.neighbour(node, OWNED_DIRECTIONS[slot - 1]);
                let (from_m, to_m) = (self.lattice.position_m(node), self.lattice.position_m(other));
                from_m + self.cuts[node * N_OWNED + slot - 1] * (to_m - from_m)
            })
            .collect();
        let place = |key: Key| place_of[key as usize];
        let tetrahedra = pieces.tetrahedra.iter().map(|t| t.map(|key| NodeId(place(key)))).collect();
        let surface: Vec<[u32; 3]> = pieces.triangles.iter().map(|t| t.map(place)).collect();
        let shape = SurfaceShape::of(keys.len(), &surface);
        (
            Filling {
                mesh: TetMesh { positions_m, tetrahedra, ..TetMesh::default() },
                surface,
                shape,
                sign_changes,
            },
            keys,
        )
    }

    fn fill_stencils(&self, grid: &SignGrid<'_>) -> Pieces {
        let slots = owned_slots();
        let cut_key = |inner: usize, outer: usize| {
            let direction = (0..N_DIRECTIONS)
                .find(|&d| grid.neighbour(inner, d) == outer)
                .expect("corners are neighbours");
            match slots[direction] {
                Some(slot) => node_key(inner) + 1 + slot as Key,
                None => {
                    let slot = slots[opposite(direction)].expect("one end owns the edge");
                    node_key(outer) + 1 + slot as Key
                }
            }
        };
        let mut pieces = Pieces::default();
        for even in (0..self.lattice.n_nodes()).step_by(2).filter(|&n| grid.is_interior(n)) {
            for axis in 0..3 {
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                let next = grid.neighbour(even, 2 * axis);
                // Odd nodes around the long edge, counter-clockwise about it: bits of short directions.
                let ring = [0, 1 << b, 1 << b | 1 << c, 1 << c]
                    .map(|bits| grid.neighbour(even, 6 + (bits | 1 << axis)));
                for corner in 0..4 {
                    let nodes = [even, next, ring[corner], ring[(corner + 1) % 4]];
                    let signs = nodes.map(|n| self.signs[n]);
                    let lattice = self.lattice;
                    let before = pieces.tetrahedra.len();
                    Stencil { lattice, nodes, signs, cut: cut_key, node_key }.fill_into(&mut pieces);
                    if pieces.tetrahedra.len() > before {
                        self.add_warped_face(grid, nodes, signs, &mut pieces);
                    }
                }
            }
        }
        pieces
    }

    /// A whole face of warped nodes is on the surface when the tetrahedron across it has nothing inside.
    fn add_warped_face(&self, grid: &SignGrid<'_>, nodes: [usize; 4], signs: [Sign; 4], pieces: &mut Pieces) {
        let n_on_surface = signs.iter().filter(|s| **s == Sign::OnSurface).count();
        if n_on_surface != 3 {
            return;
        }
        let apex = signs.iter().position(|s| *s == Sign::Inside).expect("it was filled");
        // The face's long edge is opposite to the apex's; the apex' mirror image shares the face.
        let mate = apex ^ 1;
        let across = (0..N_DIRECTIONS)
            .map(|d| grid.neighbour(nodes[mate], d))
            .find(|&n| {
                n != nodes[apex]
                    && nodes.iter().enumerate().all(|(c, &other)| {
                        c == apex || (0..N_DIRECTIONS).any(|d| grid.neighbour(n, d) == other)
                    })
            })
            .expect("every face of the lattice's inside has two tetrahedra");
        if self.signs[across] != Sign::Inside {
            let outward = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]][apex];
            pieces.triangles.push(outward.map(|c| node_key(nodes[c])));
        }
    }
}
