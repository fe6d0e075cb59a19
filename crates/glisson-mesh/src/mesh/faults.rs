//! What can be wrong with a mesh that comes from outside, found by index; the winding is put right.

use std::fmt;

use crate::math::DVec3;
use crate::mesh::topology::TET_EDGES;
use crate::mesh::topology::build::{sorted_face, sorted_faces};
use crate::mesh::{NodeId, TetId, TetMesh};

pub use crate::units::LengthUnit;

/// A tetrahedron counts as flat below this volume over the cube of its longest edge (0.118 for a regular
/// one). A hundred times above what rounding leaves of a flat one whose edges are a thousandth of its
/// distance from the origin.
pub const FLAT_VOLUME_RATIO: f64 = 1e-11;

/// A tetrahedron that names a node that is not there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeOutOfRange {
    /// Which tetrahedron.
    pub tet: TetId,
    /// The node it names.
    pub node: NodeId,
}

/// A triangle with the tetrahedra that share it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SharedTriangle {
    /// Its nodes, ascending.
    pub nodes: [NodeId; 3],
    /// Its tetrahedra, ascending.
    pub tets: Vec<TetId>,
}

/// Everything wrong with a mesh. All lists ascend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshFaults {
    /// Nodes with a coordinate that is not a finite number.
    pub non_finite_nodes: Vec<NodeId>,
    /// Nodes at exactly the place of an earlier one, with that one.
    pub duplicate_nodes: Vec<(NodeId, NodeId)>,
    /// Nodes of no tetrahedron.
    pub loose_nodes: Vec<NodeId>,
    /// Tetrahedra that name a node that is not there.
    pub out_of_range: Vec<NodeOutOfRange>,
    /// Tetrahedra that name a node twice.
    pub repeated_nodes: Vec<TetId>,
    /// Tetrahedra with the nodes of an earlier one, with that one.
    pub repeated_tets: Vec<(TetId, TetId)>,
    /// Tetrahedra wound the wrong way: their volume is negative.
    pub inverted: Vec<TetId>,
    /// Tetrahedra without volume ([`FLAT_VOLUME_RATIO`]).
    pub flat: Vec<TetId>,
    /// Triangles of more than two tetrahedra.
    pub crowded_triangles: Vec<SharedTriangle>,
    /// Triangles whose two tetrahedra lie on the same side, whatever their winding.
    pub folded_triangles: Vec<SharedTriangle>,
}

impl MeshFaults {
    /// Whether nothing is wrong.
    pub fn is_empty(&self) -> bool {
        self.lines().is_empty()
    }

    /// One line for each kind of fault that there is: how many, which, and what to do.
    pub fn lines(&self) -> Vec<String> {
        let first = |pairs: &[(TetId, TetId)]| pairs.iter().map(|p| p.0).collect::<Vec<_>>();
        let triangles = |list: &[SharedTriangle]| {
            list.iter()
                .map(|s| format!("({}, {}, {})", s.nodes[0], s.nodes[1], s.nodes[2]))
                .collect::<Vec<_>>()
        };
        let duplicates: Vec<String> =
            self.duplicate_nodes.iter().map(|(node, earlier)| format!("{node} (as {earlier})")).collect();
        let out_of_range: Vec<String> =
            self.out_of_range.iter().map(|o| format!("{} (node {})", o.tet, o.node)).collect();
        [
            listed(
                &self.non_finite_nodes,
                "node(s) with a coordinate that is no finite number",
                "mend the file",
            ),
            listed(&duplicates, "node(s) at the place of another", "merge them"),
            listed(&self.loose_nodes, "node(s) of no tetrahedron", "drop them"),
            listed(&out_of_range, "tetrahedra that name a node that is not there", "mend the file"),
            listed(&self.repeated_nodes, "tetrahedra that name a node twice", "drop them"),
            listed(&first(&self.repeated_tets), "tetrahedra with the nodes of another", "drop them"),
            listed(&self.inverted, "tetrahedra inside out (volume below 0)", "fix the winding"),
            listed(&self.flat, "tetrahedra without volume", "remesh, or drop them"),
            listed(
                &triangles(&self.crowded_triangles),
                "triangle(s) of more than two tetrahedra",
                "drop all but two",
            ),
            listed(
                &triangles(&self.folded_triangles),
                "triangle(s) with both tetrahedra on the same side",
                "the mesh is folded there: remesh",
            ),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// How many of a list a message names.
const N_NAMED: usize = 8;

/// How many there are, what they are, the first of them, and in brackets what to do, if something is said of it.
pub(super) fn listed<T: fmt::Display>(items: &[T], what: &str, remedy: &str) -> Option<String> {
    let names: Vec<String> = items.iter().take(N_NAMED).map(ToString::to_string).collect();
    let more = match items.len().saturating_sub(N_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let remedy = if remedy.is_empty() { String::new() } else { format!(" ({remedy})") };
    (!items.is_empty()).then(|| format!("{} {what}: {}{more}{remedy}", items.len(), names.join(", ")))
}

impl fmt::Display for MeshFaults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.lines()[..] {
            [] => f.write_str("nothing wrong"),
            lines => f.write_str(&lines.join("; ")),
        }
    }
}

/// Everything wrong with `mesh`. A tetrahedron that names missing or repeated nodes is in its own list
/// alone; the other checks pass it over.
pub fn find_faults(mesh: &TetMesh) -> MeshFaults {
    let n_nodes = mesh.positions_m.len();
    let nodes = || (0..n_nodes).map(NodeId::from_index);
    let mut faults = MeshFaults {
        non_finite_nodes: nodes().filter(|n| !mesh.positions_m[n.index()].is_finite()).collect(),
        duplicate_nodes: duplicate_nodes(&mesh.positions_m),
        ..MeshFaults::default()
    };
    let mut used = vec![false; n_nodes];
    // The tetrahedra with four nodes, and their numbers in the mesh.
    let mut sound: Vec<[NodeId; 4]> = Vec::with_capacity(mesh.tetrahedra.len());
    let mut numbers: Vec<TetId> = Vec::with_capacity(mesh.tetrahedra.len());
    for (t, &nodes) in mesh.tetrahedra.iter().enumerate() {
        let tet = TetId::from_index(t);
        for node in nodes {
            if let Some(used) = used.get_mut(node.index()) {
                *used = true;
            }
        }
        if let Some(&node) = nodes.iter().find(|n| n.index() >= n_nodes) {
            faults.out_of_range.push(NodeOutOfRange { tet, node });
        } else if TET_EDGES.iter().any(|&[a, b]| nodes[a] == nodes[b]) {
            faults.repeated_nodes.push(tet);
        } else {
            sound.push(nodes);
            numbers.push(tet);
            let volume_m3 = mesh.tet_volume_m3(tet);
            if is_flat(mesh.corners_m(tet), volume_m3) {
                faults.flat.push(tet);
            } else if volume_m3 < 0.0 {
                faults.inverted.push(tet);
            }
        }
    }
    faults.loose_nodes = nodes().filter(|n| !used[n.index()]).collect();
    faults.repeated_tets = repeated_tets(&sound, &numbers);
    find_triangle_faults(&sound, &numbers, &mut faults);
    faults
}

/// Whether the volume is below [`FLAT_VOLUME_RATIO`]; not so if it is not a number at all.
fn is_flat(corners_m: [DVec3; 4], volume_m3: f64) -> bool {
    let longest_m = TET_EDGES
        .iter()
        .map(|&[a, b]| corners_m[a].distance_squared(corners_m[b]))
        .fold(0.0, f64::max)
        .sqrt();
    volume_m3.abs() <= FLAT_VOLUME_RATIO * longest_m * longest_m * longest_m
}

fn duplicate_nodes(positions_m: &[DVec3]) -> Vec<(NodeId, NodeId)> {
    // Adding 0 makes -0 and 0 the same bits.
    let bits = |n: NodeId| (positions_m[n.index()] + DVec3::ZERO).to_array().map(f64::to_bits);
    let mut order: Vec<NodeId> = (0..positions_m.len()).map(NodeId::from_index).collect();
    order.sort_unstable_by_key(|&n| (bits(n), n));
    let mut found: Vec<(NodeId, NodeId)> = order
        .chunk_by(|&a, &b| bits(a) == bits(b))
        .flat_map(|same| same[1..].iter().map(|&n| (n, same[0])))
        .collect();
    found.sort_unstable();
    found
}

fn repeated_tets(sound: &[[NodeId; 4]], numbers: &[TetId]) -> Vec<(TetId, TetId)> {
    let mut order: Vec<([NodeId; 4], TetId)> = sound
        .iter()
        .zip(numbers)
        .map(|(&nodes, &tet)| {
            let mut nodes = nodes;
            nodes.sort_unstable();
            (nodes, tet)
        })
        .collect();
    order.sort_unstable();
    let mut found: Vec<(TetId, TetId)> = order
        .chunk_by(|a, b| a.0 == b.0)
        .flat_map(|same| same[1..].iter().map(|&(_, tet)| (tet, same[0].1)))
        .collect();
    found.sort_unstable();
    found
}

fn find_triangle_faults(sound: &[[NodeId; 4]], numbers: &[TetId], faults: &mut MeshFaults) {
    let is_in = |list: &[TetId], tet: TetId| list.binary_search(&tet).is_ok();
    for group in sorted_faces(sound).chunk_by(|a, b| a.0 == b.0) {
        let tets: Vec<TetId> = group.iter().map(|g| numbers[(g.1 / 4) as usize]).collect();
        let shared = |tets| SharedTriangle { nodes: group[0].0.map(NodeId), tets };
        // The side on which a tetrahedron lies, as if its winding were right.
        let side = |i: usize| {
            let (_, odd) = sorted_face(sound[(group[i].1 / 4) as usize], (group[i].1 % 4) as usize);
            odd != is_in(&faults.inverted, tets[i])
        };
        let repeated = |i: usize| faults.repeated_tets.binary_search_by_key(&tets[i], |p| p.0).is_ok();
        if tets.len() > 2 {
            faults.crowded_triangles.push(shared(tets));
        } else if tets.len() == 2
            && side(0) == side(1)
            && !(0..2).any(|i| repeated(i) || is_in(&faults.flat, tets[i]))
        {
            faults.folded_triangles.push(shared(tets));
        }
    }
}

/// Turns every tetrahedron of negative volume the right way round by swapping its last two nodes, and
/// returns which ones. Tetrahedra with missing nodes stay as they are.
pub fn fix_winding(mesh: &mut TetMesh) -> Vec<TetId> {
    let n_nodes = mesh.positions_m.len();
    let mut fixed = Vec::new();
    for t in 0..mesh.tetrahedra.len() {
        let tet = TetId::from_index(t);
        if mesh.tetrahedra[t].iter().all(|n| n.index() < n_nodes) && mesh.tet_volume_m3(tet) < 0.0 {
            mesh.tetrahedra[t].swap(2, 3);
            fixed.push(tet);
        }
    }
    fixed
}

/// Takes out the nodes of no tetrahedron, numbers the others anew in the old order, and returns how many
/// went.
///
/// # Panics
/// If a tetrahedron names a node that is not there.
pub fn drop_loose_nodes(mesh: &mut TetMesh) -> usize {
    let mut used = vec![false; mesh.positions_m.len()];
    for node in mesh.tetrahedra.iter().flatten() {
        used[node.index()] = true;
    }
    let mut new_id = vec![NodeId(0); used.len()];
    let mut kept = 0;
    for (node, _) in used.iter().enumerate().filter(|(_, used)| **used) {
        new_id[node] = NodeId::from_index(kept);
        mesh.positions_m[kept] = mesh.positions_m[node];
        kept += 1;
    }
    mesh.positions_m.truncate(kept);
    for nodes in &mut mesh.tetrahedra {
        *nodes = nodes.map(|n| new_id[n.index()]);
    }
    used.len() - kept
}

/// Why a mesh from outside cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// There is no tetrahedron.
    #[error(
        "{source_name}: found no tetrahedron, at least one is needed (a surface is meshed by `glisson mesh`)"
    )]
    Empty {
        /// Where the mesh comes from.
        source_name: String,
    },
    /// Something is wrong with nodes or tetrahedra.
    #[error("{source_name}: {faults}. None of this is allowed in a mesh to simulate")]
    Faulty {
        /// Where the mesh comes from.
        source_name: String,
        /// What is wrong, by index from 0 in the order of the file.
        faults: Box<MeshFaults>,
    },
}

/// What to do with faults at import.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FaultAction {
    /// The mesh comes back with the report; the caller decides.
    #[default]
    Report,
    /// Any fault that is left is an error.
    Refuse,
}

/// How a mesh from outside is taken in. Wrong winding is always fixed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImportPolicy {
    /// What the numbers of the file are.
    pub unit: LengthUnit,
    /// What to do with faults.
    pub faults: FaultAction,
    /// What to do with nodes of no tetrahedron (Gmsh writes the construction points of the geometry).
    pub loose_nodes: LooseNodes,
}

/// What to do with nodes of no tetrahedron.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LooseNodes {
    /// They stay and count as a fault: node numbers are the file's.
    #[default]
    Keep,
    /// They go, and the others are numbered anew.
    Drop,
}

/// What was found and done at import.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImportReport {
    /// Tetrahedra that were inside out and are fixed.
    pub winding_fixed: Vec<TetId>,
    /// Nodes of no tetrahedron that were dropped.
    pub n_loose_nodes_dropped: usize,
    /// Cells that are not volumes and were passed over: kind and number, by kind.
    pub skipped_cells: Vec<(&'static str, usize)>,
    /// The label of each tetrahedron; empty where the file has none.
    pub label_of: Vec<i64>,
    /// What is wrong with the mesh as it is handed over.
    pub faults: MeshFaults,
}

impl ImportReport {
    /// Puts the winding of `mesh` right, drops loose nodes if asked, and finds what is wrong.
    ///
    /// # Errors
    /// [`MeshError`] for a mesh without a tetrahedron, with missing nodes or positions that are not finite
    /// (nothing can be done with it), and for any fault if the policy refuses faults.
    pub fn import(mesh: &mut TetMesh, policy: &ImportPolicy, source_name: &str) -> Result<Self, MeshError> {
        let source_name = || source_name.to_owned();
        if mesh.tetrahedra.is_empty() {
            return Err(MeshError::Empty { source_name: source_name() });
        }
        let mut faults = find_faults(mesh);
        if !faults.out_of_range.is_empty() || !faults.non_finite_nodes.is_empty() {
            return Err(MeshError::Faulty { source_name: source_name(), faults: Box::new(faults) });
        }
        let mut report = Self { winding_fixed: fix_winding(mesh), ..Self::default() };
        if policy.loose_nodes == LooseNodes::Drop {
            report.n_loose_nodes_dropped = drop_loose_nodes(mesh);
        }
        if !report.winding_fixed.is_empty() || report.n_loose_nodes_dropped > 0 {
            faults = find_faults(mesh);
        }
        report.faults = faults;
        match policy.faults {
            FaultAction::Report => Ok(report),
            FaultAction::Refuse => report.refuse_faults(&source_name()),
        }
    }

    /// What there is to say, a line for each: nothing if the file was a faultless mesh of tetrahedra alone.
    pub fn lines(&self) -> Vec<String> {
        let skipped = self.skipped_cells.iter().map(|(kind, n)| format!("{n} cell(s) passed over: {kind}"));
        let dropped = (self.n_loose_nodes_dropped > 0)
            .then(|| format!("{} node(s) of no tetrahedron dropped", self.n_loose_nodes_dropped));
        let fixed = listed(&self.winding_fixed, "tetrahedra were inside out", "fixed");
        skipped.chain(dropped).chain(fixed).chain(self.faults.lines()).collect()
    }

    /// The report itself if nothing is wrong.
    ///
    /// # Errors
    /// [`MeshError::Faulty`] naming what is.
    pub fn refuse_faults(self, source_name: &str) -> Result<Self, MeshError> {
        if self.faults.is_empty() {
            Ok(self)
        } else {
            let faults = Box::new(self.faults);
            Err(MeshError::Faulty { source_name: source_name.to_owned(), faults })
        }
    }
}
