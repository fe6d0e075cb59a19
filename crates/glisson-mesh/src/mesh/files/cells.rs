//! Kinds of cells in mesh files, and how lists of cells become tetrahedra.

use std::collections::BTreeMap;

use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::scan::FormatError;

/// What a cell is to a tetrahedral mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CellKind {
    /// A tetrahedron of four nodes.
    Tetrahedron,
    /// A point, line or face: passed over.
    Flat(&'static str),
    /// A volume that is no plain tetrahedron: refused.
    Volume(&'static str),
}

/// The kind of a VTK cell (vtkCellType.h numbering).
pub(super) fn vtk_cell_kind(cell_type: i64) -> Option<CellKind> {
    use CellKind::{Flat, Tetrahedron, Volume};
    Some(match cell_type {
        10 => Tetrahedron,
        0 => Flat("empty cell"),
        1 | 2 => Flat("vertex"),
        3 | 4 | 21 | 35 | 51 | 60 | 68 | 75 => Flat("line"),
        5 | 6 | 22 | 34 | 52 | 61 | 69 | 76 => Flat("triangle"),
        7 | 36 => Flat("polygon"),
        8 | 9 | 23 | 28 | 30 | 62 | 70 | 77 => Flat("quadrilateral"),
        11 => Volume("voxel"),
        12 => Volume("hexahedron"),
        13 => Volume("wedge"),
        14 => Volume("pyramid"),
        15 | 16 => Volume("prism"),
        24 => Volume("quadratic tetrahedron"),
        25 | 29 | 33 => Volume("quadratic hexahedron"),
        26 | 31 | 32 => Volume("quadratic wedge"),
        27 | 37 => Volume("quadratic pyramid"),
        41 | 42 => Volume("polyhedron"),
        64 | 71 | 78 => Volume("higher-order tetrahedron"),
        65 | 66 | 67 | 72 | 73 | 74 | 79 | 80 | 81 => Volume("higher-order volume cell"),
        _ => return None,
    })
}

/// Number of nodes of the plain flat VTK cells; none for the others.
fn vtk_cell_size(cell_type: i64) -> Option<usize> {
    match cell_type {
        1 => Some(1),
        3 => Some(2),
        5 => Some(3),
        8..=10 => Some(4),
        _ => None,
    }
}

/// The kind of a Gmsh element and its number of nodes (Gmsh reference manual, "MSH file format").
pub(super) fn gmsh_element_kind(element_type: i64) -> Option<(CellKind, usize)> {
    use CellKind::{Flat, Tetrahedron, Volume};
    Some(match element_type {
        4 => (Tetrahedron, 4),
        15 => (Flat("vertex"), 1),
        1 => (Flat("line"), 2),
        8 => (Flat("line"), 3),
        26 => (Flat("line"), 4),
        2 => (Flat("triangle"), 3),
        9 => (Flat("triangle"), 6),
        20 => (Flat("triangle"), 9),
        21 => (Flat("triangle"), 10),
        3 => (Flat("quadrilateral"), 4),
        16 => (Flat("quadrilateral"), 8),
        10 => (Flat("quadrilateral"), 9),
        5 => (Volume("hexahedron"), 8),
        6 => (Volume("wedge"), 6),
        7 => (Volume("pyramid"), 5),
        11 => (Volume("quadratic tetrahedron"), 10),
        12 => (Volume("quadratic hexahedron"), 27),
        13 => (Volume("quadratic wedge"), 18),
        14 => (Volume("quadratic pyramid"), 14),
        17 => (Volume("quadratic hexahedron"), 20),
        18 => (Volume("quadratic wedge"), 15),
        19 => (Volume("quadratic pyramid"), 13),
        29 => (Volume("cubic tetrahedron"), 20),
        30 => (Volume("fourth-order tetrahedron"), 35),
        31 => (Volume("fifth-order tetrahedron"), 56),
        _ => return None,
    })
}

/// Axes of the coordinates in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Frame {
    /// +x left, +y posterior: also without a word in the file.
    #[default]
    Lps,
    /// +x right, +y anterior.
    Ras,
}

impl Frame {
    /// The frame that a title or comment names by `SPACE=LPS` or `SPACE=RAS` (3D Slicer's convention).
    pub(super) fn named_in(comment: &[u8]) -> Self {
        if comment.to_ascii_uppercase().windows(9).any(|w| w == b"SPACE=RAS") { Self::Ras } else { Self::Lps }
    }
}

/// A mesh as a reader found it.
#[derive(Clone, Debug, Default)]
pub(super) struct RawMesh {
    /// Nodes [m], axes of `frame`.
    pub(super) positions_m: Vec<DVec3>,
    pub(super) tetrahedra: Vec<[NodeId; 4]>,
    /// The label of each tetrahedron; fewer where the file does not give them.
    pub(super) label_of: Vec<i64>,
    pub(super) frame: Frame,
    pub(super) skipped: BTreeMap<&'static str, usize>,
}

impl RawMesh {
    /// Notes a cell that is passed over.
    pub(super) fn skip(&mut self, name: &'static str, n: usize) {
        *self.skipped.entry(name).or_default() += n;
    }

    /// Adds a tetrahedron over nodes numbered from `first`, of which there are `n_nodes`. `what` names it in
    /// the error.
    pub(super) fn add_tetrahedron(
        &mut self,
        nodes: [i64; 4],
        first: i64,
        n_nodes: usize,
        what: impl Fn() -> String,
    ) -> Result<(), FormatError> {
        let mut ids = [NodeId(0); 4];
        for (id, node) in ids.iter_mut().zip(nodes) {
            let index =
                node.checked_sub(first).and_then(|n| usize::try_from(n).ok()).filter(|&n| n < n_nodes);
            *id = NodeId::from_index(index.ok_or_else(|| {
                let last = first + n_nodes as i64 - 1;
                FormatError::named(what(), format!("node {node}"), format!("a node from {first} to {last}"))
            })?);
        }
        self.tetrahedra.push(ids);
        Ok(())
    }

    /// Adds the tetrahedra of a VTK cell list over the last `n_points` positions; passes over what is flat.
    pub(super) fn add_vtk_cells(&mut self, cells: &VtkCells, n_points: usize) -> Result<(), FormatError> {
        let before = self.positions_m.len() - n_points;
        let mut start = 0usize;
        if cells.ends.len() != cells.types.len() {
            return Err(FormatError::named(
                "the cells",
                format!("{} cell types", cells.types.len()),
                format!("{}, one for each cell", cells.ends.len()),
            ));
        }
        for (c, (&end, &cell_type)) in cells.ends.iter().zip(&cells.types).enumerate() {
            let what = || format!("cell {c}");
            let nodes = usize::try_from(end)
                .ok()
                .and_then(|end| cells.connectivity.get(start..end))
                .ok_or_else(|| {
                    let found = format!("nodes {start} to {end} of the connectivity");
                    let length = cells.connectivity.len();
                    FormatError::named(
                        what(),
                        found,
                        format!("an ascending range within its {length} entries"),
                    )
                })?;
            start += nodes.len();
            let kind = vtk_cell_kind(cell_type);
            if let Some(expected) = vtk_cell_size(cell_type).filter(|&n| n != nodes.len()) {
                let name = match kind {
                    Some(CellKind::Flat(name)) => name,
                    _ => "tetrahedron",
                };
                let found = format!("a {name} of {} nodes", nodes.len());
                return Err(FormatError::named(what(), found, format!("{expected}")));
            }
            match kind {
                Some(CellKind::Tetrahedron) => {
                    let nodes = nodes.try_into().expect("the size was checked");
                    self.add_tetrahedron(nodes, 0, n_points, what)?;
                    let last = self.tetrahedra.last_mut().expect("one was just added");
                    *last = last.map(|n| NodeId::from_index(n.index() + before));
                }
                Some(CellKind::Flat(name)) => self.skip(name, 1),
                Some(CellKind::Volume(name)) => return Err(refused_volume(what(), name)),
                None => {
                    let found = format!("unknown VTK cell type {cell_type}");
                    return Err(FormatError::named(what(), found, "tetrahedra (type 10)"));
                }
            }
        }
        Ok(())
    }
}

/// The error for a volume cell that is no plain tetrahedron.
pub(super) fn refused_volume(place: String, name: &str) -> FormatError {
    FormatError::named(
        place,
        format!("a {name}"),
        "4-node tetrahedra as the only volume cells: divide or remesh it in the program that wrote it",
    )
}

/// A VTK cell list: cell `c` has the nodes `connectivity[ends[c - 1]..ends[c]]`.
#[derive(Clone, Debug, Default)]
pub(super) struct VtkCells {
    pub(super) ends: Vec<i64>,
    pub(super) connectivity: Vec<i64>,
    pub(super) types: Vec<i64>,
}
