//! Surfaces as they are found made closed.
//!
//! 1. Mending that moves nothing: vertices at one place become one, triangles without area and doubled ones
//!    go, neighbours are made to agree, pieces face outward. Where the result passes [`check_closed`], that is
//!    the answer.
//! 2. Otherwise a new surface is drawn around all points where the winding number is above one half, on a
//!    grid ([`super::winding`]): holes are closed by a smooth film, pieces that cross become their union, and
//!    the vertices lie on the old surface where there is one.

mod report;
mod mending;
mod pieces;
mod field;
mod solid;
mod net;

pub use report::{FaultsFound, MOST_PLACES, RepairError, RepairParams, RepairReport, RepairsDone, Sightings};

use self::field::Field;
use self::net::Old;
use self::pieces::Piece;
use self::solid::Solid;
use super::TriMesh;
use super::box_tree::BoxTree;
use super::check::{SurfaceTopology, check_closed, check_numbers};
use super::error::Place;
use super::intersect::self_intersections;
use super::signed_distance::SignedDistance;
use crate::math::{Aabb, DVec3};
use rayon::prelude::*;

/// Cells along the longest side by default.
const DEFAULT_CELLS: f64 = 160.0;
/// Cells across the smallest feature: with two a sheet between nodes still holds one.
const CELLS_PER_FEATURE: f64 = 3.0;
/// Free space around the surface [cells]. No simple fraction: flat sides along the axes should not fall on
/// nodes.
const MARGIN_CELLS: f64 = 3.37;
/// Counting self-intersections stops after this many.
const MOST_INTERSECTIONS: usize = 1000;

/// The closed surface that `surface` stands for, and what was found and done. A surface that is closed
/// already, without pieces below the share of `params`, comes back bit for bit.
///
/// # Errors
/// [`RepairError`]: numbers that mean nothing, nothing left, no inside, holes beyond the share of `params`.
pub fn repair(surface: &TriMesh, params: &RepairParams) -> Result<(TriMesh, RepairReport), RepairError> {
    check_params(params)?;
    check_numbers(surface)?;
    let mut report = RepairReport::default();
    let (found, done) = (&mut report.found, &mut report.done);
    let mut mended = mending::mend(surface, found, done);
    if mended.triangles.is_empty() {
        return Err(RepairError::NothingLeft {
            n_triangles: surface.triangles.len(),
            n_degenerate: found.degenerate_triangles.count,
        });
    }
    let sides = mending::count_edges(&mended, found);
    let pieces = pieces::orient(&mut mended, &sides, found, done);
    for [t, _] in self_intersections(&mended, MOST_INTERSECTIONS) {
        found.self_intersections.add(mended.corners_m(t as usize)[0]);
    }
    found.intersections_limit = MOST_INTERSECTIONS;
    let are_closed = found.open_edges.count + found.crowded_edges.count + found.self_intersections.count == 0;
    let mut answer = None;
    if are_closed {
        let (volume_m3, whole) = without_needless_pieces(&mended, &pieces, params, &mut report);
        if let Ok(topology) = check_closed(&whole) {
            report.volume_before_m3 = volume_m3;
            answer = Some((whole, topology));
        } else {
            report.done.small_pieces_dropped = Sightings::default();
            report.done.inner_pieces_filled = Sightings::default();
        }
    }
    let (answer, topology) = match answer {
        Some(answer) => answer,
        None => rebuild(&Old::of(&mended, &sides), params, &mut report)?,
    };
    report.volume_after_m3 = topology.volume_m3;
    report.n_triangles = topology.n_triangles;
    report.n_pieces = topology.n_pieces;
    report.euler_characteristic = topology.euler_characteristic;
    Ok((answer, report))
}

fn check_params(params: &RepairParams) -> Result<(), RepairError> {
    let wrong = |name, found, allowed| Err(RepairError::Parameter { name, found, allowed });
    for (name, length_m) in
        [("grid spacing [m]", params.spacing_m), ("smallest feature [m]", params.smallest_feature_m)]
    {
        if let Some(found) = length_m
            && !(found > 0.0 && found.is_finite())
        {
            return wrong(name, found, "positive and finite");
        }
    }
    for (name, found) in [
        ("smallest share of a piece", params.smallest_piece_share),
        ("largest share of closing triangles", params.largest_closing_share),
    ] {
        if !(0.0..=1.0).contains(&found) {
            return wrong(name, found, "0 to 1");
        }
    }
    Ok(())
}

/// `mesh`, of closed pieces that do not cross, without small ones and those inside the solid; answers also the
/// volume that all its pieces enclose [m3].
fn without_needless_pieces(
    mesh: &TriMesh,
    pieces: &[Piece],
    params: &RepairParams,
    report: &mut RepairReport,
) -> (f64, TriMesh) {
    let largest_m3 = pieces.iter().map(|p| p.volume_m3.abs()).fold(0.0, f64::max);
    let borders = pieces::are_borders(pieces);
    let mut stays = vec![true; pieces.len()];
    for (p, piece) in pieces.iter().enumerate() {
        if !borders[p] {
            report.done.inner_pieces_filled.add(piece.place_m);
        } else if piece.volume_m3.abs() < params.smallest_piece_share * largest_m3 {
            report.done.small_pieces_dropped.add(piece.place_m);
        } else {
            continue;
        }
        stays[p] = false;
    }
    let volume_m3 = pieces.iter().zip(&borders).filter(|&(_, &b)| b).map(|(p, _)| p.volume_m3).sum();
    (volume_m3, pieces::kept(mesh, pieces, &stays))
}

fn rebuild(
    old: &Old<'_>,
    params: &RepairParams,
    report: &mut RepairReport,
) -> Result<(TriMesh, SurfaceTopology), RepairError> {
    let (mended, tree) = (old.mesh, &old.tree);
    let longest_m = Aabb::of_points(&mended.positions_m).size_m().max_element();
    let default_m = longest_m / DEFAULT_CELLS;
    let feature_m = params.smallest_feature_m.map_or(f64::INFINITY, |f| f / CELLS_PER_FEATURE);
    let spacing_m = params.spacing_m.unwrap_or(default_m.min(feature_m));
    report.rebuilt = true;
    report.spacing_m = Some(spacing_m);
    let band = SignedDistance::unsigned_band(mended, spacing_m, MARGIN_CELLS * spacing_m)?;
    let mut field = Field::of(tree, band)?;
    report.volume_before_m3 = field.n_inside as f64 * spacing_m.powi(3);

    let mut solid = Solid { dims: field.band.dims(), inside: std::mem::take(&mut field.inside) };
    let place_m = |at: usize| field.band.node_position_m(field.band.node(at));
    let mut dropped = solid.drop_small_pieces(params.smallest_piece_share);
    report.done.contacts_filled = solid.fill_contacts(&field.winding);
    dropped.extend(solid.fill_small_cavities(params.smallest_piece_share));
    for at in dropped {
        report.done.small_pieces_dropped.add(place_m(at));
    }
    let net = net::surface_of(&field, &solid, old)?;
    report.done.vertices_held_back = net.n_held_back;
    check_holes(&net, params, report)?;

    let moves = net.mesh.positions_m.par_iter().zip(&net.is_on_old).map(|(&p, &is_on_old)| {
        if is_on_old { tree.closest(p, f64::INFINITY).map_or(0.0, |(_, _, d)| d) } else { 0.0 }
    });
    report.greatest_move_m = moves.reduce(|| 0.0, f64::max);
    let new_tree = BoxTree::of_triangles(&net.mesh);
    let from_old = mended.positions_m.par_iter().map(|&p| new_tree.closest(&net.mesh, p, f64::INFINITY));
    let from_old = from_old.map(|closest| closest.map_or(0.0, |(_, _, d)| d));
    report.greatest_distance_from_old_m = from_old.reduce(|| 0.0, f64::max);
    Ok((net.mesh, net.topology))
}

/// Measures the triangles that lie over holes.
fn check_holes(net: &net::Net, params: &RepairParams, report: &mut RepairReport) -> Result<(), RepairError> {
    let (mut total, mut closing, mut weighted) = (0.0, 0.0, DVec3::ZERO);
    for (t, triangle) in net.mesh.triangles.iter().enumerate() {
        let [a, b, c] = net.mesh.corners_m(t);
        let area = (b - a).cross(c - a).length();
        total += area;
        if triangle.iter().all(|&v| !net.is_on_old[v as usize]) {
            closing += area;
            weighted += area * (a + b + c) / 3.0;
        }
    }
    report.closing_share = closing / total;
    if report.closing_share > params.largest_closing_share {
        return Err(RepairError::HoleTooLarge {
            share: report.closing_share,
            allowed: params.largest_closing_share,
            place: Place(weighted / closing),
        });
    }
    Ok(())
}
