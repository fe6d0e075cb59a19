//! Mending that moves nothing: vertices at one place become one, triangles without area and doubled ones go.

use super::report::{FaultsFound, RepairsDone};
use crate::math::DVec3;
use crate::surface::TriMesh;
use crate::surface::check::{Side, has_no_area, sorted_sides};

/// Merges vertices at the same place, drops triangles that are degenerate or doubled, then vertices without
/// triangles; the order of the rest stays. Indices must be right.
///
/// Of triangles with the same corners one stays if more of them run one way around than the other, else
/// none.
pub(super) fn mend(mesh: &TriMesh, found: &mut FaultsFound, done: &mut RepairsDone) -> TriMesh {
    let first = first_at_place(mesh, found);
    let merged = |t: &[u32; 3]| t.map(|v| first[v as usize]);
    let mut kept = Vec::with_capacity(mesh.triangles.len());
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = merged(triangle);
        if a == b || b == c || c == a || has_no_area(mesh.corners_m(t)) {
            found.degenerate_triangles.add(mesh.corners_m(t)[0]);
        } else {
            kept.push([a, b, c]);
        }
    }
    let kept = without_duplicates(&kept, |v| mesh.positions_m[v as usize], found);
    done.triangles_dropped = mesh.triangles.len() - kept.len();
    done.vertices_merged = found.coincident_vertices.count;
    let mut is_used = vec![false; mesh.positions_m.len()];
    for &v in mesh.triangles.iter().flatten() {
        is_used[v as usize] = true;
    }
    for (v, _) in is_used.iter().enumerate().filter(|&(_, &used)| !used) {
        found.unused_vertices.add(mesh.positions_m[v]);
    }
    let n_distinct = mesh.positions_m.len() - done.vertices_merged;
    let mended = compact(&mesh.positions_m, &kept);
    done.vertices_dropped = n_distinct - mended.positions_m.len();
    mended
}

/// For each vertex the first one at its place.
fn first_at_place(mesh: &TriMesh, found: &mut FaultsFound) -> Vec<u32> {
    // Adding zero makes one of the two zeros.
    let place = |v: u32| (mesh.positions_m[v as usize] + DVec3::ZERO).to_array();
    let n = u32::try_from(mesh.positions_m.len()).expect("meshes have fewer than 2^32 vertices");
    let mut order: Vec<u32> = (0..n).collect();
    let compare = |a: [f64; 3], b: [f64; 3]| {
        a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
    };
    order.sort_unstable_by(|&a, &b| compare(place(a), place(b)).then(a.cmp(&b)));
    let mut first: Vec<u32> = (0..n).collect();
    for same in order.chunk_by(|&a, &b| compare(place(a), place(b)).is_eq()) {
        for &v in same {
            first[v as usize] = same[0];
        }
    }
    for v in (0..n).filter(|&v| first[v as usize] != v) {
        found.coincident_vertices.add(mesh.positions_m[v as usize]);
    }
    first
}

fn without_duplicates(
    triangles: &[[u32; 3]],
    at_m: impl Fn(u32) -> DVec3,
    found: &mut FaultsFound,
) -> Vec<[u32; 3]> {
    // Corners ascending, whether an even permutation did that, and the triangle.
    let mut keyed: Vec<([u32; 3], usize, bool)> = triangles
        .iter()
        .enumerate()
        .map(|(t, &triangle)| {
            let mut sorted = triangle;
            sorted.sort_unstable();
            let from = triangle.iter().position(|&v| v == sorted[0]).expect("one is the smallest");
            (sorted, t, triangle[(from + 1) % 3] == sorted[1])
        })
        .collect();
    keyed.sort_unstable();
    let mut stays = vec![true; triangles.len()];
    for same in keyed.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() > 1) {
        let n_even = same.iter().filter(|s| s.2).count();
        let wanted = (2 * n_even != same.len()).then_some(2 * n_even > same.len());
        let survivor = same.iter().find(|s| Some(s.2) == wanted).map(|s| s.1);
        for &(_, t, _) in same {
            stays[t] = Some(t) == survivor;
        }
    }
    for (t, _) in stays.iter().enumerate().filter(|&(_, &stays)| !stays) {
        found.duplicate_triangles.add(at_m(triangles[t][0]));
    }
    triangles.iter().zip(&stays).filter(|&(_, &stays)| stays).map(|(&t, _)| t).collect()
}

/// A mesh of `triangles` with the vertices they use, in the old order.
pub(super) fn compact(positions_m: &[DVec3], triangles: &[[u32; 3]]) -> TriMesh {
    let mut is_used = vec![false; positions_m.len()];
    for &v in triangles.iter().flatten() {
        is_used[v as usize] = true;
    }
    let mut new_index = vec![u32::MAX; positions_m.len()];
    let mut kept_m = Vec::new();
    for (v, _) in is_used.iter().enumerate().filter(|&(_, &used)| used) {
        new_index[v] = kept_m.len() as u32;
        kept_m.push(positions_m[v]);
    }
    let triangles = triangles.iter().map(|t| t.map(|v| new_index[v as usize])).collect();
    TriMesh { positions_m: kept_m, triangles }
}

/// Counts edges that do not belong to two triangles; answers all sides, those of an edge together.
pub(super) fn count_edges(mesh: &TriMesh, found: &mut FaultsFound) -> Vec<Side> {
    let sides = sorted_sides(mesh);
    for edge in sides.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)) {
        let middle_m =
            0.5 * (mesh.positions_m[edge[0].low as usize] + mesh.positions_m[edge[0].high as usize]);
        match edge.len() {
            1 => found.open_edges.add(middle_m),
            2 => {}
            _ => found.crowded_edges.add(middle_m),
        }
    }
    sides
}
