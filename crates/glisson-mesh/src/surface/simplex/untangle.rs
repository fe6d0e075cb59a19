//! Taking crossings out of the dual triangulation.
//!
//! Dual triangle `v` belongs to simplex vertex `v`, so crossing triangles say which vertices went wrong. Where
//! a mesh without crossings was deformed, the vertices around go back part of the way, farther and in wider
//! surroundings each round, at last all the way; where there is no such state, the dual is smoothed there.

use super::dual::following_dual;
use super::mesh::SimplexMesh;
use crate::math::DVec3;
use crate::surface::TriMesh;
use crate::surface::error::{Place, SurfaceError};
use crate::surface::intersect::{Crossings, self_intersections};
use crate::surface::smooth::EdgeGraph;

/// Rounds of going back; from [`ALL_THE_WAY`] on the surroundings go all the way.
const MOST_RETURNS: usize = 14;
const ALL_THE_WAY: usize = 5;
/// Rounds of smoothing around crossings; by the last, twelve rings around them are smooth.
const MOST_SMOOTHINGS: usize = 12;
/// Smoothing sweeps of a round.
const SWEEPS: usize = 4;

/// Simplex vertices whose triangles cross others in the dual of `mesh`, ascending.
pub fn crossing_vertices(mesh: &SimplexMesh) -> Vec<u32> {
    let mut crossing: Vec<u32> =
        self_intersections(&following_dual(mesh), usize::MAX).into_iter().flatten().collect();
    crossing.sort_unstable();
    crossing.dedup();
    crossing
}

/// `vertices` and those within so many edges of them, ascending.
pub fn surroundings(mesh: &SimplexMesh, vertices: &[u32], n_rings: usize) -> Vec<u32> {
    rings_around(mesh.n_vertices(), vertices.to_vec(), n_rings, |v| &mesh.neighbours()[v])
}

/// `ring` and what is within `n_rings` steps to neighbours of it, of `n` vertices, ascending.
fn rings_around<'a>(
    n: usize,
    mut ring: Vec<u32>,
    n_rings: usize,
    neighbours: impl Fn(usize) -> &'a [u32],
) -> Vec<u32> {
    let mut reached = vec![false; n];
    for distance in 0..=n_rings {
        ring.retain(|&v| !std::mem::replace(&mut reached[v as usize], true));
        if distance < n_rings {
            ring = ring.iter().flat_map(|&v| neighbours(v as usize)).copied().collect();
        }
    }
    (0..n as u32).filter(|&v| reached[v as usize]).collect()
}

/// Moves vertices back towards `safe_m`, where the dual had no crossings, until it has none. Answers how many
/// vertices were moved and whether it has none now.
pub fn return_from_crossings(mesh: &mut SimplexMesh, safe_m: &[DVec3]) -> (usize, bool) {
    let moved_m = mesh.positions_m().to_vec();
    let mut share = vec![1.0f64; moved_m.len()];
    for round in 0..=MOST_RETURNS {
        let crossing = crossing_vertices(mesh);
        if crossing.is_empty() || round == MOST_RETURNS {
            return (share.iter().filter(|&&s| s < 1.0).count(), crossing.is_empty());
        }
        for v in surroundings(mesh, &crossing, 2 + 2 * round) {
            share[v as usize] *= if round >= ALL_THE_WAY { 0.0 } else { 0.5 };
        }
        for (v, position) in mesh.positions_m_mut().iter_mut().enumerate() {
            *position = safe_m[v].lerp(moved_m[v], share[v]);
        }
    }
    unreachable!("the last round returns")
}

/// Smooths a triangulation around crossing triangles, over wider and wider surroundings, until none cross.
/// Answers how many vertices were moved.
///
/// # Errors
/// [`SurfaceError::Tangled`] when that does not end.
pub fn smooth_crossings_away(mesh: &mut TriMesh) -> Result<usize, SurfaceError> {
    let n = mesh.positions_m.len();
    let mut moved = vec![false; n];
    let mut graph = None;
    let mut crossings = Crossings::of(mesh);
    for round in 0..=MOST_SMOOTHINGS {
        let pairs = &crossings.pairs;
        let Some(first) = pairs.first() else { break };
        if round == MOST_SMOOTHINGS {
            let place = Place(mesh.corners_m(first[0] as usize)[0]);
            return Err(SurfaceError::Tangled { stage: "fitting", n: pairs.len(), place });
        }
        let graph = graph.get_or_insert_with(|| EdgeGraph::of_mesh(mesh));
        let corners = pairs.iter().flatten().flat_map(|&t| mesh.triangles[t as usize]).collect();
        let around = rings_around(n, corners, round + 1, |v| graph.neighbours(v));
        let mut is_around = vec![false; n];
        around.iter().for_each(|&v| is_around[v as usize] = true);
        around.iter().for_each(|&v| moved[v as usize] = true);
        for _ in 0..SWEEPS {
            let middle = |v: u32| {
                let ring = graph.neighbours(v as usize);
                ring.iter().map(|&n| mesh.positions_m[n as usize]).sum::<DVec3>() / ring.len() as f64
            };
            let middles: Vec<DVec3> = around.iter().map(|&v| middle(v)).collect();
            for (&v, middle) in around.iter().zip(middles) {
                mesh.positions_m[v as usize] = middle;
            }
        }
        crossings.follow(mesh, &is_around);
    }
    Ok(moved.into_iter().filter(|&m| m).count())
}
