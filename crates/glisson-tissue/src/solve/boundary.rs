//! Supports: prescribed displacement components, and the check that they leave no rigid motion.

use std::collections::BTreeMap;

use super::{MeshEdges, SolveError};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Prescribed displacement components.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoundaryConditions {
    prescribed_m: BTreeMap<(NodeId, u8), f64>,
}

impl BoundaryConditions {
    /// An empty list of conditions.
    pub fn new() -> Self {
        Self::default()
    }

    /// Holds all three components of `nodes` at zero.
    pub fn fixed(nodes: &[NodeId]) -> Self {
        let mut conditions = Self::default();
        for &node in nodes {
            conditions.fix_node(node);
        }
        conditions
    }

    /// Holds a node at its rest position.
    pub fn fix_node(&mut self, node: NodeId) {
        self.impose_node(node, DVec3::ZERO);
    }

    /// Holds a node at a displacement [m].
    pub fn impose_node(&mut self, node: NodeId, displacement_m: DVec3) {
        for axis in 0..3 {
            self.impose(node, axis, displacement_m[axis]);
        }
    }

    /// Holds one component of a node at a displacement [m]; the others stay as they are. A later call for the
    /// same component replaces an earlier one.
    ///
    /// # Panics
    /// When `axis` is not 0 (x), 1 (y) or 2 (z).
    pub fn impose(&mut self, node: NodeId, axis: usize, displacement_m: f64) {
        assert!(axis < 3, "axes are 0, 1, 2");
        self.prescribed_m.insert((node, axis as u8), displacement_m);
    }

    /// Every prescribed component, ascending: node, axis, displacement [m].
    pub fn iter(&self) -> impl Iterator<Item = (NodeId, usize, f64)> {
        self.prescribed_m.iter().map(|(&(node, axis), &value)| (node, usize::from(axis), value))
    }

    /// Whether nothing is prescribed.
    pub fn is_empty(&self) -> bool {
        self.prescribed_m.is_empty()
    }

    /// Refuses conditions on missing nodes, values that are not finite, nodes of no tetrahedron that are not
    /// wholly prescribed, and pieces that can move as rigid bodies.
    ///
    /// # Errors
    /// [`SolveError`] naming the first of them.
    pub fn check(&self, mesh: &TetMesh, edges: &MeshEdges) -> Result<(), SolveError> {
        let n_nodes = mesh.positions_m.len();
        let mut held = vec![[false; 3]; n_nodes];
        for (node, axis, value) in self.iter() {
            if node.index() >= n_nodes {
                return Err(SolveError::ConditionOutOfRange { node, n_nodes });
            }
            if !value.is_finite() {
                return Err(SolveError::NonFiniteCondition { node });
            }
            held[node.index()][axis] = true;
        }
        let pieces = pieces(n_nodes, edges);
        let mut used = vec![false; n_nodes];
        for edge in &edges.nodes {
            used[edge[0].index()] = true;
            used[edge[1].index()] = true;
        }
        let loose: Vec<u32> =
            (0..n_nodes).filter(|&n| !used[n] && held[n] != [true; 3]).map(|n| n as u32).collect();
        if !loose.is_empty() {
            return Err(SolveError::LooseNodes {
                count: loose.len(),
                first: loose.into_iter().take(10).collect(),
            });
        }
        for piece in pieces.iter().filter(|p| used[p[0]]) {
            check_held(mesh, piece, &held)?;
        }
        Ok(())
    }
}

/// Nodes of each connected piece, ascending within a piece and by first node.
fn pieces(n_nodes: usize, edges: &MeshEdges) -> Vec<Vec<usize>> {
    let mut root: Vec<usize> = (0..n_nodes).collect();
    fn find(root: &mut [usize], mut n: usize) -> usize {
        while root[n] != n {
            root[n] = root[root[n]];
            n = root[n];
        }
        n
    }
    for edge in &edges.nodes {
        let (a, b) = (find(&mut root, edge[0].index()), find(&mut root, edge[1].index()));
        // The lower node is the root, so that a piece is named by its first node.
        root[a.max(b)] = a.min(b);
    }
    let mut place = vec![usize::MAX; n_nodes];
    let mut pieces: Vec<Vec<usize>> = Vec::new();
    for n in 0..n_nodes {
        let r = find(&mut root, n);
        if place[r] == usize::MAX {
            place[r] = pieces.len();
            pieces.push(Vec::new());
        }
        pieces[place[r]].push(n);
    }
    pieces
}

/// A direction counts as held when its pivot in the Gram matrix of the rigid motions exceeds this share of the number of
/// held components: a lever arm of 1e-5 of the piece's size.
const LEAST_PIVOT: f64 = 1e-10;

/// Refuses a piece whose held components leave a rigid motion free: the six rigid motions, restricted to the
/// held components, must be independent (rank of their Gram matrix, by Cholesky with pivoting).
fn check_held(mesh: &TetMesh, piece: &[usize], held: &[[bool; 3]]) -> Result<(), SolveError> {
    let centre_m =
        piece.iter().fold(DVec3::ZERO, |s, &n| s + mesh.positions_m[n]) / piece.len().max(1) as f64;
    let radius_m = piece.iter().map(|&n| mesh.positions_m[n].distance(centre_m)).fold(0.0, f64::max);
    let scale_m = if radius_m > 0.0 { radius_m } else { 1.0 };
    let mut gram = [[0.0; 6]; 6];
    let mut n_held = 0.0;
    for &n in piece {
        let r = (mesh.positions_m[n] - centre_m) / scale_m;
        for axis in (0..3).filter(|&a| held[n][a]) {
            // Row of the motions t + w x r for the component `axis`.
            let mut row = [0.0; 6];
            row[axis] = 1.0;
            for k in 0..3 {
                row[3 + k] = DVec3::AXES[k].cross(r)[axis];
            }
            for i in 0..6 {
                for j in 0..6 {
                    gram[i][j] += row[i] * row[j];
                }
            }
            n_held += 1.0;
        }
    }
    let mut done = [false; 6];
    let mut rank = 0;
    while let Some(pivot) = (0..6).filter(|&i| !done[i]).max_by(|&a, &b| gram[a][a].total_cmp(&gram[b][b]))
        && gram[pivot][pivot] > LEAST_PIVOT * n_held
    {
        done[pivot] = true;
        rank += 1;
        for i in (0..6).filter(|&i| !done[i]) {
            let factor = gram[i][pivot] / gram[pivot][pivot];
            for j in 0..6 {
                gram[i][j] -= factor * gram[pivot][j];
            }
        }
    }
    if rank == 6 {
        return Ok(());
    }
    const NAMES: [&str; 6] = [
        "translation along x",
        "translation along y",
        "translation along z",
        "rotation about x",
        "rotation about y",
        "rotation about z",
    ];
    let named: Vec<&str> = (0..6).filter(|&i| !done[i]).map(|i| NAMES[i]).collect();
    Err(SolveError::Floating {
        piece_nodes: piece.len(),
        node: NodeId::from_index(piece[0]),
        rigid_modes: 6 - rank,
        named: named.join(", "),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_tet() -> (TetMesh, MeshEdges) {
        let mesh = TetMesh {
            positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
            ..TetMesh::default()
        };
        let edges = MeshEdges::of_mesh(&mesh).unwrap();
        (mesh, edges)
    }

    fn free_modes(conditions: &BoundaryConditions) -> usize {
        let (mesh, edges) = one_tet();
        match conditions.check(&mesh, &edges) {
            Ok(()) => 0,
            Err(SolveError::Floating { rigid_modes, .. }) => rigid_modes,
            Err(other) => panic!("{other}"),
        }
    }

    #[test]
    fn rigid_modes_are_counted() {
        assert_eq!(free_modes(&BoundaryConditions::new()), 6);
        assert_eq!(free_modes(&BoundaryConditions::fixed(&[NodeId(0)])), 3);
        assert_eq!(free_modes(&BoundaryConditions::fixed(&[NodeId(0), NodeId(1)])), 1);
        assert_eq!(free_modes(&BoundaryConditions::fixed(&[NodeId(0), NodeId(1), NodeId(2)])), 0);
        // The classical six components: three at one node, two at the second, one at the third.
        let mut six = BoundaryConditions::fixed(&[NodeId(0)]);
        six.impose(NodeId(1), 1, 0.0);
        six.impose(NodeId(1), 2, 0.0);
        six.impose(NodeId(2), 2, 0.0);
        assert_eq!(free_modes(&six), 0);
    }

    #[test]
    fn a_loose_node_is_named_and_may_be_prescribed() {
        let (mut mesh, _) = one_tet();
        mesh.positions_m.push(DVec3::ONE);
        let edges = MeshEdges::of_mesh(&mesh).unwrap();
        let mut conditions = BoundaryConditions::fixed(&[0, 1, 2].map(NodeId));
        let error = conditions.check(&mesh, &edges).unwrap_err();
        assert_eq!(error, SolveError::LooseNodes { count: 1, first: vec![4] });
        conditions.fix_node(NodeId(4));
        conditions.check(&mesh, &edges).unwrap();
    }
}
