//! `[[attachment]]`: what ties two bodies to each other.

use super::bodies::{SceneBody, read_body_named};
use super::reader::{SceneError, Section};
use super::region::read_region;
use crate::contact::response::bond::Bond;
use crate::math::{DVec3, closest_point_barycentric};
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TetMesh};
use crate::units::Dimension;
use crate::world::spec::{BodySpec, Region, nodes_in};

/// What an attachment does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttachmentKind {
    /// Holds what touches: it pulls and pushes along all axes.
    Glue,
    /// Bands from node to the nearest place, slack up to their length at rest: they pull, never push.
    Ligament,
}

/// An attachment as its table says.
#[derive(Clone, Debug, PartialEq)]
pub struct AttachmentSource {
    /// The bodies by their numbers: nodes of the first are tied to the surface of the second.
    pub bodies: [usize; 2],
    /// What it does.
    pub kind: AttachmentKind,
    /// Which nodes of the first body; all of its surface when absent.
    pub region: Option<Region>,
    /// How far from the second body they may be at rest [m].
    pub reach_m: f64,
    /// Stiffness of the whole attachment [N/m].
    pub stiffness_n_per_m: f64,
    /// Damping over stiffness [s].
    pub damping_s: f64,
    /// Whether edges and hot tips part it.
    pub can_be_cut: bool,
    /// Pull that tears the whole attachment, if all of it is pulled alike [N]; infinite where nothing tears it.
    pub strength_n: f64,
}

pub(super) fn read_attachment(
    mut section: Section<'_>,
    bodies: &[SceneBody],
) -> Result<AttachmentSource, SceneError> {
    let mut number = |key_with_example| read_body_named(&mut section, key_with_example, bodies);
    let pair = [number(("body", "body = \"liver\""))?, number(("to", "to = \"stomach\""))?];
    if pair[0] == pair[1] {
        let (found, allowed) = ("the same body".to_string(), "another body than \"body\"".to_string());
        return Err(section.wrong_table("to", found, allowed));
    }
    let (kind, at) = section.string("kind")?.ok_or_else(|| section.missing("kind", "kind = \"glue\""))?;
    let kind = match kind.as_str() {
        "glue" => AttachmentKind::Glue,
        "ligament" | "membrane" => AttachmentKind::Ligament,
        _ => {
            let allowed = "glue, ligament, membrane";
            return Err(section.wrong_value(at, "kind", format!("\"{kind}\""), allowed));
        }
    };
    let has_region = ["box", "ball", "furthest"].iter().any(|key| section.has(key));
    let region = if has_region { Some(read_region(&mut section)?) } else { None };
    let reach_m = section
        .positive("reach", Dimension::Length)?
        .ok_or_else(|| section.missing("reach", "reach = \"3 mm\""))?;
    let stiffness_n_per_m = section
        .positive("stiffness", Dimension::Stiffness)?
        .ok_or_else(|| section.missing("stiffness", "stiffness = \"200 N/m\""))?;
    let damping_s = section.positive("damping", Dimension::Time)?.unwrap_or(0.0);
    let can_be_cut = section.flag("cut")?.unwrap_or(false);
    let strength_n = section.positive("strength", Dimension::Force)?.unwrap_or(f64::INFINITY);
    section.finish()?;
    Ok(AttachmentSource {
        bodies: pair,
        kind,
        region,
        reach_m,
        stiffness_n_per_m,
        damping_s,
        can_be_cut,
        strength_n,
    })
}

/// The bonds of an attachment: one for each surface node of the first body in the region, with the nearest place of the second one
/// within reach. They share stiffness and strength evenly.
pub(super) fn bonds(
    source: &AttachmentSource,
    bodies: &[BodySpec],
    mesh: &TetMesh,
    topology: &Topology,
) -> Vec<Bond> {
    let [of, to] = source.bodies.map(|number| &bodies[number]);
    let own_m = &mesh.positions_m[of.nodes.start as usize..of.nodes.end as usize];
    let mut is_in = vec![source.region.is_none(); own_m.len()];
    for node in source.region.iter().flat_map(|region| nodes_in(&[*region], own_m)) {
        is_in[node.index()] = true;
    }
    let triangles: Vec<[NodeId; 3]> = topology
        .surface_triangles()
        .map(|triangle| topology.outward_nodes(triangle))
        .filter(|nodes| to.nodes.contains(&nodes[0].0))
        .collect();
    let place_m = |node: NodeId| mesh.positions_m[node.index()];
    let mut found: Vec<([NodeId; 4], [f64; 3])> = Vec::new();
    let own = |node: &NodeId| of.nodes.contains(&node.0) && is_in[(node.0 - of.nodes.start) as usize];
    for node in topology.surface_nodes().filter(own) {
        let mut nearest = (source.reach_m, None);
        for &nodes in &triangles {
            let corners_m = nodes.map(place_m);
            let weights = closest_point_barycentric(place_m(node), corners_m);
            let at_m: DVec3 = corners_m.iter().zip(weights).map(|(corner, w)| *corner * w).sum();
            let distance_m = at_m.distance(place_m(node));
            if distance_m < nearest.0 || distance_m == nearest.0 && nearest.1.is_none() {
                nearest = (distance_m, Some((nodes, weights)));
            }
        }
        if let (_, Some(([a, b, c], weights))) = nearest {
            found.push(([node, a, b, c], weights));
        }
    }
    let n_found = found.len().max(1) as f64;
    let share_n_per_m = source.stiffness_n_per_m / n_found;
    let (can_be_cut, strength_n) = (source.can_be_cut, source.strength_n / n_found);
    let bond = |(nodes, at): ([NodeId; 4], [f64; 3])| match source.kind {
        AttachmentKind::Glue => Bond::glue(nodes, at, &mesh.positions_m, share_n_per_m, source.damping_s),
        AttachmentKind::Ligament => {
            Bond::ligament(nodes, at, &mesh.positions_m, share_n_per_m, source.damping_s)
        }
    };
    found.into_iter().map(bond).map(|bond| Bond { can_be_cut, strength_n, ..bond }).collect()
}
