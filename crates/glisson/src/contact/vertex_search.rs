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
pub(super) struct VertexSearch {
    /// The vertices of each triangle, [`NONE`] at the end; mostly one or none.
    of_triangle: Vec<[u32; 3]>,
    tree: Option<VertexTree>,
}

#[derive(Clone, Debug)]
struct VertexTree {
    /// Those that belong to a triangle.
    vertices: Vec<u32>,
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
        let mut of_triangle = vec![[NONE; 3]; rules.n_triangles()];
        for &[vertex, owner] in &owners {
            let own = &mut of_triangle[owner as usize];
            if let Some(place) = own.iter_mut().find(|v| **v == NONE) {
                *place = vertex;
            }
        }
        let tree = matches!(search.structure(), BroadPhase::Hierarchy(_)).then(|| {
            let vertices: Vec<u32> = owners.iter().map(|[v, _]| *v).collect();
            let rules = rules.of_triangles(owners.iter().map(|[_, owner]| *owner));
            let boxes: Vec<RoundedBox> =
                vertices.iter().map(|v| search.vertex_boxes()[*v as usize].checked()).collect();
            let tree = Hierarchy::new(&boxes, &rules);
            VertexTree { vertices, boxes, rules, tree }
        });
        Self { of_triangle, tree }
    }

    /// Follows `search`, which was updated.
    pub(super) fn update(&mut self, search: &PairSearch) {
        if let Some(VertexTree { vertices, boxes, rules, tree }) = &mut self.tree {
            for (bounds, v) in boxes.iter_mut().zip(vertices.iter()) {
                *bounds = search.vertex_boxes()[*v as usize].checked();
            }
            tree.update(boxes, rules);
        }
    }

    /// Calls `visit` once for each vertex and triangle that can be within the margin of each other.
    pub(super) fn for_each(&self, search: &PairSearch, mut visit: impl FnMut(u32, u32)) {
        if let (Some(own), BroadPhase::Hierarchy(tree)) = (&self.tree, search.structure()) {
            return own.tree.for_each_pair_with(&own.rules, tree, search.rules(), |place, triangle| {
                visit(own.vertices[place as usize], triangle);
            });
        }
        let (boxes, vertex_boxes) = (search.boxes(), search.vertex_boxes());
        search.structure().for_each_pair(boxes, search.rules(), |s, t| {
            for [from, at] in [[s, t], [t, s]] {
                for v in self.of_triangle[from as usize].into_iter().take_while(|v| *v != NONE) {
                    if vertex_boxes[v as usize].overlaps(&boxes[at as usize]) {
                        visit(v, at);
                    }
                }
            }
        });
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
