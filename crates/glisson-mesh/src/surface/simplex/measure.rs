//! How near a surface is to another, how bent it is, and whether two quantities go together.

use super::mesh::SimplexMesh;
use crate::math::DVec3;
use crate::surface::TriMesh;
use crate::surface::box_tree::BoxTree;
use crate::surface::normals::{NormalWeight, vertex_normals};
use rayon::prelude::*;

/// Distances [m] from one surface to another, weighted by area.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct DistanceSummary {
    /// Mean.
    pub mean_m: f64,
    /// Exceeded by 5 % of the area.
    pub p95_m: f64,
    /// Largest of the samples.
    pub max_m: f64,
}

/// Distances from `from` to `to`, at the centres of the quarters of each triangle of `from`. Zero for no
/// triangles.
pub fn surface_distances(from: &TriMesh, to: &TriMesh) -> DistanceSummary {
    let tree = BoxTree::of_triangles(to);
    let of_triangle = |t: usize| {
        let corners_m = from.corners_m(t);
        let [a, b, c] = corners_m;
        let centre_m = (a + b + c) / 3.0;
        let weight = 0.125 * (b - a).cross(c - a).length();
        let quarter = |p: Option<DVec3>| {
            let at_m = p.map_or(centre_m, |corner_m| 0.5 * (corner_m + centre_m));
            let distance_m = tree.closest(to, at_m, f64::INFINITY).map_or(0.0, |(_, _, d)| d);
            (distance_m, weight)
        };
        [quarter(None), quarter(Some(a)), quarter(Some(b)), quarter(Some(c))]
    };
    let mut samples: Vec<(f64, f64)> =
        (0..from.triangles.len()).into_par_iter().flat_map_iter(of_triangle).collect();
    samples.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = samples.iter().map(|s| s.1).sum();
    let mean_m = if total > 0.0 { samples.iter().map(|s| s.0 * s.1).sum::<f64>() / total } else { 0.0 };
    let mut below = 0.0;
    let p95 = samples.iter().find(|s| {
        below += s.1;
        below >= 0.95 * total
    });
    DistanceSummary { mean_m, p95_m: p95.map_or(0.0, |s| s.0), max_m: samples.last().map_or(0.0, |s| s.0) }
}

/// Mean curvature at each vertex of a closed triangulation [1/m], positive where convex: the cotangent
/// Laplacian over the vertex's Voronoi area, or the usual share of obtuse triangles (M. Meyer, M. Desbrun, P. Schröder and A. Barr, "Discrete
/// differential-geometry operators for triangulated 2-manifolds", 2003, doi 10.1007/978-3-662-05105-4_2).
pub fn triangulation_mean_curvatures_per_m(mesh: &TriMesh) -> Vec<f64> {
    let mut laplacians = vec![(DVec3::ZERO, 0.0); mesh.positions_m.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let corners_m = mesh.corners_m(t);
        let doubled_area_m2 = (corners_m[1] - corners_m[0]).cross(corners_m[2] - corners_m[0]).length();
        if doubled_area_m2 <= 0.0 {
            continue;
        }
        let cotangents = [0, 1, 2].map(|c| {
            let [u, v] = [1, 2].map(|step| corners_m[(c + step) % 3] - corners_m[c]);
            u.dot(v) / doubled_area_m2
        });
        let is_obtuse = cotangents.iter().any(|&x| x < 0.0);
        for c in 0..3 {
            let (p, q) = ((c + 1) % 3, (c + 2) % 3);
            let edge_m = corners_m[p] - corners_m[q];
            let half = 0.5 * cotangents[c] * edge_m;
            laplacians[triangle[p] as usize].0 += half;
            laplacians[triangle[q] as usize].0 -= half;
            if is_obtuse {
                let share = if cotangents[c] < 0.0 { 0.25 } else { 0.125 };
                laplacians[triangle[c] as usize].1 += share * doubled_area_m2;
            } else {
                let voronoi_m2 = 0.125 * cotangents[c] * edge_m.length_squared();
                laplacians[triangle[p] as usize].1 += voronoi_m2;
                laplacians[triangle[q] as usize].1 += voronoi_m2;
            }
        }
    }
    let normals = vertex_normals(mesh, NormalWeight::Area);
    let curvature = |(&(sum, area_m2), normal): (&(DVec3, f64), &DVec3)| {
        if area_m2 > 0.0 { 0.5 * sum.dot(*normal) / area_m2 } else { 0.0 }
    };
    laplacians.iter().zip(&normals).map(curvature).collect()
}

/// The range that holds the middle 90 % of the values: their 5th and 95th percentile. Zeros for no values.
pub fn middle_range(values: &[f64]) -> [f64; 2] {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| sorted.get((share * sorted.len().saturating_sub(1) as f64).round() as usize);
    [0.05, 0.95].map(|share| at(share).copied().unwrap_or(0.0))
}

/// Spearman's rank correlation, equal values sharing their mean rank; 0 when one of the two is constant.
///
/// # Panics
/// If the lists have different lengths.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "pairs of values");
    let (a, b) = (ranks(a), ranks(b));
    let mean = 0.5 * (a.len() as f64 - 1.0);
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    let variance = product(&a, &a) * product(&b, &b);
    if variance > 0.0 { product(&a, &b) / variance.sqrt() } else { 0.0 }
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]).then(i.cmp(&j)));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for equal in order.chunk_by(|&i, &j| values[i] == values[j]) {
        let rank = first as f64 + 0.5 * (equal.len() as f64 - 1.0);
        equal.iter().for_each(|&i| ranks[i] = rank);
        first += equal.len();
    }
    ranks
}

/// Rank correlation over the cells between their density, 1 / area, and their mean absolute value of
/// `curvatures_per_m`, one a vertex.
pub fn density_correlation(mesh: &SimplexMesh, curvatures_per_m: &[f64]) -> f64 {
    let magnitudes: Vec<f64> = curvatures_per_m.iter().map(|h| h.abs()).collect();
    let densities: Vec<f64> = mesh.cell_areas_m2().iter().map(|area_m2| 1.0 / area_m2).collect();
    rank_correlation(&densities, &mesh.cell_means(&magnitudes))
}
