//! Local refinement of a region of interest while the simulation runs (seed `003` s. 3.5): longest edges are divided
//! in their middles until no tetrahedron of the region has an edge above the wanted length.
//!
//! An edge is divided only if it is the longest of all its tetrahedra. From a tetrahedron that is too large, the way
//! to such an edge goes to a neighbour with a longer edge again and again (longest-edge propagation path; Rivara 1997,
//! New longest-edge algorithms for the refinement and/or improvement of unstructured triangulations), so that the mesh
//! stays conforming and the tetrahedra do not degenerate. It may reach a little beyond the region.

use crate::math::DVec3;
use crate::mesh::edit::{EdgeSplit, EditError, EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use crate::mesh::{EdgeId, TetId};

/// Edges divided in one [`refining`] at most: a choice, some ten thousand new tetrahedra.
const MOST_SPLITS: usize = 2_000;

/// Lengths within this factor count as equal: rounding must not send the way through a whole regular mesh.
const EQUAL: f64 = 1.0 + 1e-9;

/// Where a mesh is wanted finer: a ball at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FineRegion {
    /// Middle of the ball [m], at rest.
    pub center_m: DVec3,
    /// Its radius [m].
    pub radius_m: f64,
    /// Longest edge wanted there [m].
    pub edge_m: f64,
}

impl FineRegion {
    /// Whether the middle of a tetrahedron is in the ball.
    pub fn contains(&self, body: &EditableMesh, tet: TetId) -> bool {
        let middle_m = 0.25 * body.mesh().corners_m(tet).into_iter().sum::<DVec3>();
        middle_m.distance_squared(self.center_m) <= self.radius_m * self.radius_m
    }
}

/// The next edit that makes the mesh finer: middles of longest edges, at most `most_splits` of them. `None` when every edge of the region is short enough. Call it again after carrying the
/// edit out.
pub fn refine(body: &EditableMesh, region: &FineRegion, most_splits: usize) -> Option<MeshEdit> {
    refine_where(body, region.edge_m, |tet| region.contains(body, tet), most_splits)
}

/// [`refine`] of the tetrahedra that `is_in` takes, to edges of `edge_m` [m] at most.
pub fn refine_where(
    body: &EditableMesh,
    edge_m: f64,
    is_in: impl Fn(TetId) -> bool,
    most_splits: usize,
) -> Option<MeshEdit> {
    let topology = body.topology();
    let coarse = topology.live_tets().filter(|&t| longest_edge(body, t).0 > edge_m && is_in(t));
    let mut edges: Vec<EdgeId> = coarse.map(|t| longest_around(body, t)).collect();
    edges.sort_unstable();
    edges.dedup();
    let splits: Vec<EdgeSplit> =
        edges.into_iter().take(most_splits).map(|edge| EdgeSplit { edge, fraction: 0.5 }).collect();
    (!splits.is_empty()).then_some(MeshEdit::Split { edges: splits })
}

/// All edits that make a region fine, one after the other: a list for [`EditableMesh::apply_all_saving`], empty if it is fine.
/// The mesh is as it was afterwards. It stops after 2,000 divided edges.
///
/// # Errors
/// [`EditError::InList`] if an edge is too short to be divided.
pub fn refining(body: &mut EditableMesh, region: &FineRegion) -> Result<Vec<MeshEdit>, EditError> {
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    let (mut edits, mut n_left) = (Vec::new(), MOST_SPLITS);
    body.apply_each_saving(&mut change, &mut undo, |body, _| {
        let edit = refine(body, region, n_left)?;
        if let MeshEdit::Split { edges } = &edit {
            n_left -= edges.len();
        }
        edits.push(edit.clone());
        Some(edit)
    })?;
    body.undo(&undo);
    Ok(edits)
}

/// The longest edge of a tetrahedron and its length [m]; of equal ones the oldest.
fn longest_edge(body: &EditableMesh, tet: TetId) -> (f64, EdgeId) {
    let topology = body.topology();
    let positions_m = &body.mesh().positions_m;
    topology.tet_edges(tet).into_iter().fold((0.0, EdgeId(u32::MAX)), |longest, edge| {
        let [a, b] = topology.edge_nodes(edge).map(|n| positions_m[n.index()]);
        let length_m = a.distance(b);
        let is_longer = length_m > longest.0 * EQUAL || (length_m * EQUAL > longest.0 && edge < longest.1);
        if is_longer { (length_m, edge) } else { longest }
    })
}

/// The end of the way from a tetrahedron to ever longer edges: an edge than which none of its tetrahedra has a longer
/// one.
fn longest_around(body: &EditableMesh, tet: TetId) -> EdgeId {
    let mut at = longest_edge(body, tet);
    loop {
        // Lengths only rise along the way, so that it ends.
        let tets = body.topology().edge_tets(at.1).iter();
        match tets.map(|&t| longest_edge(body, t)).find(|(length_m, _)| *length_m > at.0 * EQUAL) {
            Some(longer) => at = longer,
            None => return at.1,
        }
    }
}
