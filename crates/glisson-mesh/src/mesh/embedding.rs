//! A mesh that is cut, carried by copies of the tetrahedra that it had at first: embedded cuts (virtual nodes).
//!
//! The cut mesh has a face wherever a blade went, and slivers where it went near a node. A model that moves its nodes would have to
//! follow the slivers with its time step. Instead the nodes are carried: each of the first tetrahedra that a cut goes through is copied
//! once for each piece of it that hangs together, and the copy moves as its piece does, with the share of the material that its piece
//! has. Nodes of the cut mesh are where the copy takes them, by their barycentric coordinates. So no element ever has another shape
//! than at first, and elastic energy and mass keep their proportion: the stable step of a copy is that of the first tetrahedron.
//!
//! Which corners two copies share follows from the cut mesh alone: where pieces of two neighbours have a common face, the copies have
//! common corners there. Slits that end in a piece part all of it (`slits`). Places at rest are looked at for that and for the shares.
//!
//! After N. Molino, Z. Bao and R. Fedkiw 2004, A virtual node algorithm for changing mesh topology during simulation (doi
//! 10.1145/1015706.1015734). There a tetrahedron gives each of its nodes a copy at most; here pieces come from any conforming
//! subdivision, as with E. Sifakis, K. Der and R. Fedkiw 2007, Arbitrary cutting of deformable tetrahedralized objects (SCA 2007), but
//! made by `tool/cut/subdivision` and not by clipping.

mod follow;
mod slits;
mod undo;

pub use self::undo::EmbeddingUndo;

use super::{NodeId, TetId, TetMesh};
use crate::math::{DVec3, tetrahedron_volume_m3};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A node as a mean of nodes of one tetrahedron; places beyond the first `n` have the first node and the weight 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tie {
    n: u8,
    nodes: [NodeId; 4],
    weights: [f64; 4],
}

impl Tie {
    /// The node is this one.
    pub fn to(node: NodeId) -> Self {
        Self { n: 1, nodes: [node; 4], weights: [1.0, 0.0, 0.0, 0.0] }
    }

    /// Nodes with their weights, of sum 1.
    pub fn iter(&self) -> impl Iterator<Item = (NodeId, f64)> + '_ {
        self.nodes.iter().copied().zip(self.weights).take(self.n.into())
    }

    /// The node that it is tied to alone.
    pub fn single(&self) -> Option<NodeId> {
        (self.n == 1).then_some(self.nodes[0])
    }

    /// The mean of what its nodes have.
    #[inline]
    pub fn mean(&self, of: impl Fn(NodeId) -> DVec3) -> DVec3 {
        let Self { n, nodes: [a, b, c, d], weights } = *self;
        if n == 1 {
            return of(a);
        }
        DVec3::ZERO + of(a) * weights[0] + of(b) * weights[1] + of(c) * weights[2] + of(d) * weights[3]
    }

    /// The mean of means; none where that takes more than four nodes, or none at all.
    fn blend(parts: impl Iterator<Item = (Self, f64)>) -> Option<Self> {
        let mut found = Self { n: 0, ..Self::to(NodeId(0)) };
        for (tie, share) in parts {
            for (node, weight) in tie.iter().filter(|(_, weight)| weight * share != 0.0) {
                let n = usize::from(found.n);
                let at = found.nodes[..n].iter().position(|known| *known == node).unwrap_or(n);
                if at == 4 {
                    return None;
                }
                if at == n {
                    found.n += 1;
                    found.nodes[at] = node;
                    found.weights[at] = 0.0;
                }
                found.weights[at] += weight * share;
            }
        }
        let (used, unused) = found.nodes.split_at_mut(found.n.into());
        unused.fill(*used.first()?);
        Some(found)
    }
}

/// Why copies cannot follow an edit; nothing changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.reason())]
pub enum EmbeddingRefusal {
    /// Numbers changed their meaning.
    Renumbered,
    /// A node went to another place at rest.
    Moved,
    /// A new node or tetrahedron lies in no single one of the first tetrahedra.
    Across,
}

impl EmbeddingRefusal {
    /// The message.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Renumbered => {
                "an edit that renumbers the mesh cannot be told to embedded copies; make the model anew"
            }
            Self::Moved => {
                "an edit moved nodes at rest, which embedded copies cannot follow: write `blade_cuts = \"embedded\"` for every blade, \
                 and no `mend_cuts`"
            }
            Self::Across => {
                "an edit brought in tissue that lies in several of the first tetrahedra, which embedded copies cannot follow: write \
                 `blade_cuts = \"embedded\"` for every blade, and no `mend_cuts`"
            }
        }
    }
}

/// The tetrahedra of a mesh before any cut.
#[derive(Debug)]
struct Origin {
    tetrahedra: Vec<[NodeId; 4]>,
    volumes_m3: Vec<f64>,
    /// Where the tetrahedra at each node begin in `at_node`.
    starts: Vec<u32>,
    at_node: Vec<TetId>,
}

impl Origin {
    fn of(mesh: &TetMesh, dead: &[TetId]) -> Self {
        let live = || {
            let all = mesh.tetrahedra.iter().enumerate().map(|(t, nodes)| (TetId::from_index(t), nodes));
            all.filter(|(tet, _)| dead.binary_search(tet).is_err())
        };
        let mut starts = vec![0_u32; mesh.positions_m.len() + 1];
        for node in live().flat_map(|(_, nodes)| nodes) {
            starts[node.index() + 1] += 1;
        }
        for n in 1..starts.len() {
            starts[n] += starts[n - 1];
        }
        let mut ends = starts.clone();
        let mut at_node = vec![TetId(0); starts[starts.len() - 1] as usize];
        for (tet, nodes) in live() {
            for node in nodes {
                let end = &mut ends[node.index()];
                at_node[*end as usize] = tet;
                *end += 1;
            }
        }
        let volumes =
            (0..mesh.tetrahedra.len()).map(|t| tetrahedron_volume_m3(mesh.corners_m(TetId::from_index(t))));
        Self { tetrahedra: mesh.tetrahedra.clone(), volumes_m3: volumes.collect(), starts, at_node }
    }

    fn at(&self, node: NodeId) -> &[TetId] {
        &self.at_node[self.starts[node.index()] as usize..self.starts[node.index() + 1] as usize]
    }
}

/// The cut mesh and the copies that carry it.
#[derive(Clone, Debug)]
pub struct Embedding {
    origin: Arc<Origin>,
    /// The copies, with what of each is material. Records of dead nodes and copies stay.
    copies: TetMesh,
    /// Of each tetrahedron of the cut mesh: the first one that it is in, and the copy that carries it.
    origin_of: Vec<TetId>,
    copy_of: Vec<TetId>,
    /// The live tetrahedra in each first one that an edit changed, ascending; every other one is whole.
    pieces: BTreeMap<TetId, Vec<TetId>>,
    /// Where each node of the cut mesh is among the nodes of the first one.
    places: Vec<Tie>,
    /// What carries each node of the cut mesh now.
    ties: Vec<Tie>,
}

impl Embedding {
    /// Of a mesh before any cut: every tetrahedron carries itself.
    pub fn new(mesh: &TetMesh) -> Self {
        Self::without(mesh, &[])
    }

    /// The same where some tetrahedra, ascending, are dead.
    pub fn without(mesh: &TetMesh, dead: &[TetId]) -> Self {
        let tets: Vec<TetId> = (0..mesh.tetrahedra.len()).map(TetId::from_index).collect();
        let ties: Vec<Tie> = (0..mesh.positions_m.len()).map(|n| Tie::to(NodeId::from_index(n))).collect();
        let copies = TetMesh { shares: vec![1.0; tets.len()], ..mesh.clone() };
        Self {
            origin: Arc::new(Origin::of(mesh, dead)),
            copies,
            origin_of: tets.clone(),
            copy_of: tets,
            pieces: BTreeMap::new(),
            places: ties.clone(),
            ties,
        }
    }

    /// The mesh of the copies at rest, dead ones included.
    pub fn copies(&self) -> &TetMesh {
        &self.copies
    }

    /// What carries each node of the cut mesh.
    pub fn ties(&self) -> &[Tie] {
        &self.ties
    }

    /// The copy that carries a tetrahedron of the cut mesh.
    pub fn copy_of(&self, tet: TetId) -> TetId {
        self.copy_of[tet.index()]
    }

    /// Whether no edit touched the mesh: every tetrahedron is its own copy.
    pub fn is_whole(&self) -> bool {
        self.pieces.is_empty()
    }

    /// How many nodes the cut mesh has.
    pub fn n_nodes(&self) -> usize {
        self.ties.len()
    }

    /// How many tetrahedra the cut mesh has.
    pub fn n_tets(&self) -> usize {
        self.copy_of.len()
    }

    /// The live tetrahedra of the cut mesh in a first one.
    fn pieces_in<'a>(&'a self, origin: &'a TetId) -> &'a [TetId] {
        self.pieces.get(origin).map_or(std::slice::from_ref(origin), Vec::as_slice)
    }
}
