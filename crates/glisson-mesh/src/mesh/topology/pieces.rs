//! Connected pieces of the live mesh.

use super::Topology;
use crate::mesh::{NodeId, TetId};

/// What holds a piece together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Through {
    /// Common faces: parts that hang together by an edge or a node alone are pieces of their own.
    Faces,
    /// Common nodes: what moves together in a finite-element model.
    Nodes,
}

/// Pieces of a mesh, numbered by their lowest tetrahedron. Reusable: [`Topology::pieces_into`] allocates
/// nothing once the buffers have grown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pieces {
    /// The piece of each tetrahedron; `u32::MAX` for a dead one.
    pub of_tet: Vec<u32>,
    /// Number of tetrahedra of each piece.
    pub n_tets: Vec<u32>,
    stack: Vec<TetId>,
    seen_nodes: Vec<bool>,
}

impl Pieces {
    /// Number of pieces.
    pub fn count(&self) -> usize {
        self.n_tets.len()
    }
}

const UNSEEN: u32 = u32::MAX;

impl Topology {
    /// The pieces of the live mesh.
    pub fn pieces(&self, through: Through) -> Pieces {
        let mut pieces = Pieces::default();
        self.pieces_into(through, &mut pieces);
        pieces
    }

    /// [`Topology::pieces`] into buffers that are kept.
    pub fn pieces_into(&self, through: Through, pieces: &mut Pieces) {
        pieces.of_tet.clear();
        pieces.of_tet.resize(self.n_tets(), UNSEEN);
        pieces.n_tets.clear();
        pieces.seen_nodes.clear();
        pieces.seen_nodes.resize(self.n_nodes(), false);
        for start in self.live_tets() {
            if pieces.of_tet[start.index()] != UNSEEN {
                continue;
            }
            let piece = u32::try_from(pieces.n_tets.len()).expect("fewer pieces than tetrahedra");
            pieces.n_tets.push(0);
            pieces.of_tet[start.index()] = piece;
            pieces.stack.push(start);
            while let Some(tet) = pieces.stack.pop() {
                pieces.n_tets[piece as usize] += 1;
                match through {
                    Through::Faces => {
                        for next in self.tet_neighbours(tet).into_iter().filter_map(|n| n.get()) {
                            visit(pieces, next, piece);
                        }
                    }
                    Through::Nodes => {
                        for node in self.tet_nodes(tet) {
                            self.visit_node(pieces, node, piece);
                        }
                    }
                }
            }
        }
    }

    fn visit_node(&self, pieces: &mut Pieces, node: NodeId, piece: u32) {
        if !pieces.seen_nodes[node.index()] {
            pieces.seen_nodes[node.index()] = true;
            for &next in self.node_tets(node) {
                visit(pieces, next, piece);
            }
        }
    }
}

fn visit(pieces: &mut Pieces, tet: TetId, piece: u32) {
    let of_tet = &mut pieces.of_tet[tet.index()];
    if *of_tet == UNSEEN {
        *of_tet = piece;
        pieces.stack.push(tet);
    }
}
