//! Which vertices can be near which triangles: each vertex once with each triangle.
//!
//! Every vertex belongs to one of its triangles, and counts with the triangles with which that one counts. A hierarchy is
//! asked with a second one over the vertices, whose boxes are far smaller than those of the triangles; the other structures
//! give pairs of triangles, from which those with a vertex of one in the box of the other are taken.

use super::boxes::{PairRules, RoundedBox};
use super::broad_phase::BroadPhase;
use super::hierarchy::Hierarchy;
use super::self_collision::PairSearch;

const NONE: u32 = u32::MAX;

/// The search for vertices, beside a search for pairs of triangles. Updating and asking never allocate.
#[derive(Clone, Debug)]
pub(super) enum VertexSearch {
    /// Beside a hierarchy.
    Tree(Box<VertexTree>),
    /// The vertices of each triangle, [`NONE`] at the end; mostly one or none.
    OfTriangles(Vec<[u32; 3]>),
}

/// A hierarchy over vertices.
#[derive(Clone, Debug)]
pub(super) struct VertexTree {
    /// Those that belong to a triangle, with that triangle.
    owners: Vec<[u32; 2]>,
    /// Their boxes.
    boxes: Vec<RoundedBox>,
    /// The triangles that they belong to.
    rules: PairRules,
    tree: Hierarchy,
}

impl VertexSearch {
    /// Beside `search`.
    pub(super) fn new(search: &PairSearch) -> Self {
        let rules = search.rules();
        let owners = owners(search.vertex_boxes().len(), rules.triangles());
        if let BroadPhase::Hierarchy(_) = search.structure() {
            let rules = rules.of_triangles(owners.iter().map(|[_, owner]| *owner));
            let boxes: Vec<RoundedBox> = owners.iter().map(|owner| box_of(search, *owner)).collect();
            let tree = Hierarchy::for_queries(&boxes, &rules);
            return Self::Tree(Box::new(VertexTree { owners, boxes, rules, tree }));
        }
        let mut of_triangle = vec![[NONE; 3]; rules.n_triangles()];
        for &[vertex, owner] in &owners {
            let place = of_triangle[owner as usize].iter_mut().find(|v| **v == NONE);
            *place.expect("a triangle owns no more than its three vertices") = vertex;
        }
        Self::OfTriangles(of_triangle)
    }

    /// Follows `search`, which was updated.
    pub(super) fn update(&mut self, search: &PairSearch) {
        if let Self::Tree(own) = self {
            let VertexTree { owners, boxes, rules, tree } = own.as_mut();
            for (bounds, owner) in boxes.iter_mut().zip(owners.iter()) {
                *bounds = box_of(search, *owner);
            }
            tree.update(boxes, rules);
        }
    }

    /// Calls `visit` once for each vertex and triangle that can be within the margin of each other.
    pub(super) fn for_each(&self, search: &PairSearch, mut visit: impl FnMut(u32, u32)) {
        match (self, search.structure()) {
            (Self::Tree(own), BroadPhase::Hierarchy(tree)) => {
                own.tree.for_each_pair_with(&own.rules, tree, search.rules(), |place, triangle| {
                    visit(own.owners[place as usize][0], triangle);
                });
            }
            (Self::Tree(_), _) => unreachable!("a search keeps its structure"),
            (Self::OfTriangles(of_triangle), structure) => {
                let (boxes, vertex_boxes) = (search.boxes(), search.vertex_boxes());
                structure.for_each_pair(boxes, search.rules(), |s, t| {
                    for [from, at] in [[s, t], [t, s]] {
                        for v in of_triangle[from as usize].into_iter().take_while(|v| *v != NONE) {
                            if vertex_boxes[v as usize].overlaps(&boxes[at as usize]) {
                                visit(v, at);
                            }
                        }
                    }
                });
            }
        }
    }
}

/// The box of a vertex; of nothing when its triangle is broken, as pairs of triangles have it.
fn box_of(search: &PairSearch, [vertex, owner]: [u32; 2]) -> RoundedBox {
    if search.boxes()[owner as usize].is_nothing() {
        RoundedBox::NOTHING
    } else {
        search.vertex_boxes()[vertex as usize]
    }
}

/// Each vertex that is in a triangle with the one that it belongs to, one with few of them.
fn owners(n_vertices: usize, triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); n_vertices];
    for (t, triangle) in (0..).zip(triangles) {
        triangle.iter().for_each(|v| around[*v as usize].push(t));
    }
    let mut n_owned = vec![0; triangles.len()];
    let mut owners = Vec::with_capacity(n_vertices);
    for (vertex, around) in (0..).zip(&around) {
        if let Some(&owner) = around.iter().min_by_key(|t| n_owned[**t as usize]) {
            n_owned[owner as usize] += 1;
            owners.push([vertex, owner]);
        }
    }
    owners
}
