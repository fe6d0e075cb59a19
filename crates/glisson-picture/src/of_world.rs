//! What a simulation shows, as surfaces with looks.

use super::clip::clip;
use super::geometry::ShadedSurface;
use super::look::Look;
use glisson::record::snapshot::{BleedingEnd, DisplayTopology, Snapshot};
use glisson::world::spec::WorldSpec;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Blood of so long a time hangs at an open vessel as a drop [s]: a choice.
const DROP_S: f64 = 0.3;
/// Radii of drops [m].
const DROPS_M: [f64; 2] = [0.8e-3, 4e-3];
/// A needle is so much thicker than its thread, as on the page.
const NEEDLE: f64 = 1.6;
/// What is thinner is not seen [m], as on the page.
const LEAST_RADIUS_M: f64 = 0.35e-3;
/// Loose tissue between bodies, and the radius of its strands [m], as on the page.
const LOOSE_TISSUE: Look = Look::Plain { colour: [230, 201, 160] };
const STRAND_RADIUS_M: f64 = 0.8e-3;
const THREAD: Look = Look::Plastic { colour: [58, 52, 120] };

/// The look of each body: its own colour, or that of its name; of one organ, of its `material`.
pub fn looks_of(spec: &WorldSpec, material: &str) -> Vec<Look> {
    if spec.bodies.is_empty() {
        return vec![Look::of_tissue(material)];
    }
    spec.bodies
        .iter()
        .map(|body| match body.color {
            Some(colour) => Look::Plain { colour },
            None if body.is_rigid => Look::Bone,
            None => Look::of_tissue(&body.name),
        })
        .collect()
}

/// What a surface of a picture is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// The skin of a body.
    Body(u8),
    /// Faces of its cuts.
    CutFace(u8),
    /// Threads, clips, strands between bodies, drops of blood.
    Thing,
}

/// Bodies with their cuts, strands between them, clips, threads and drops of blood, and what each surface is of; `looks` of the bodies.
pub fn shown_of(
    topology: &DisplayTopology,
    snapshot: &Snapshot,
    looks: &[Look],
) -> (Vec<ShadedSurface>, Vec<Shown>) {
    let mut parts: BTreeMap<(u8, bool), Vec<[u32; 3]>> = BTreeMap::new();
    for (triangle, &is_cut) in topology.triangles.iter().zip(&topology.is_cut) {
        parts.entry((topology.body_of[triangle[0] as usize], is_cut)).or_default().push(*triangle);
    }
    let is_of = |&(body, is_cut): &(u8, bool)| if is_cut { Shown::CutFace(body) } else { Shown::Body(body) };
    let mut shown: Vec<Shown> = parts.keys().map(is_of).collect();
    let part = |((body, is_cut), triangles): ((u8, bool), Vec<[u32; 3]>)| {
        let own = looks.get(usize::from(body)).copied().unwrap_or(Look::Liver);
        part_of(topology, snapshot, &triangles, if is_cut { Look::Cut } else { own })
    };
    let mut surfaces: Vec<ShadedSurface> = parts.into_iter().map(part).collect();
    for thread in &snapshot.threads {
        let radius_m = thread.radius_m.max(LEAST_RADIUS_M);
        let needle = (thread.n_needle_nodes as usize).min(thread.nodes_m.len());
        surfaces.push(ShadedSurface::wire(&thread.nodes_m[..needle], NEEDLE * radius_m, Look::Metal));
        let rest = &thread.nodes_m[needle.saturating_sub(1)..];
        surfaces.push(ShadedSurface::wire(rest, radius_m, THREAD));
        let clips =
            thread.clips_m.iter().map(|&p| ShadedSurface::ball(p, 3.0 * thread.radius_m, Look::Metal));
        surfaces.extend(clips);
    }
    let strands = snapshot.strands_m.iter();
    surfaces.extend(strands.map(|ends_m| ShadedSurface::wire(ends_m, STRAND_RADIUS_M, LOOSE_TISSUE)));
    let clips = snapshot.bleeding.clips.iter();
    surfaces.extend(clips.map(|set| clip(set, &snapshot.positions_m, &topology.triangles)));
    let drop = |end: &BleedingEnd| {
        let radius_m = (0.75 / PI * end.rate_m3_per_s * DROP_S).cbrt().clamp(DROPS_M[0], DROPS_M[1]);
        ShadedSurface::ball(end.position_m, radius_m, Look::Blood)
    };
    surfaces.extend(snapshot.bleeding.ends.iter().filter(|end| end.rate_m3_per_s > 0.0).map(drop));
    shown.resize(surfaces.len(), Shown::Thing);
    (surfaces, shown)
}

/// The triangles of one look with the vertices that they have.
fn part_of(
    topology: &DisplayTopology,
    snapshot: &Snapshot,
    triangles: &[[u32; 3]],
    look: Look,
) -> ShadedSurface {
    let mut place_of = vec![u32::MAX; snapshot.positions_m.len()];
    let (mut positions_m, mut rest_positions_m) = (Vec::new(), Vec::new());
    let own = triangles.iter().map(|triangle| {
        triangle.map(|vertex| {
            let vertex = vertex as usize;
            if place_of[vertex] == u32::MAX {
                place_of[vertex] = u32::try_from(positions_m.len()).expect("no more than all vertices");
                positions_m.push(snapshot.positions_m[vertex]);
                rest_positions_m.push(topology.rest_positions_m[vertex]);
            }
            place_of[vertex]
        })
    });
    let triangles = own.collect();
    ShadedSurface { positions_m, triangles, rest_positions_m, look }
}
