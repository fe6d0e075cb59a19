//! Several bodies at rest: their meshes joined, what they are held by, and where they carry each other.

use super::attachment::bonds;
use super::bodies::BodySource;
use super::build::{OrganTables, organ_without_stress};
use super::build_error::BuildError;
use super::build_shape::{FileKind, ShapeBuilder};
use super::carried::carry;
use super::spec::Scene;
use crate::contact::response::persistent::{BodiesOfSurface, ContactMemory, PlacesInTouch, places_in_touch};
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TetMesh};
use crate::model::{BodyPart, BodySet, ModelError, ModelMotion};
use crate::workers::SharedWorkers;
use crate::world::organ::OrganError;
use crate::world::spec::{BodySpec, WorldSpec};
use std::path::Path;

/// Reads all bodies of a scene and tells `spec` of them. With the forces with which they carry each other.
pub(super) fn read_bodies(
    scene: &Scene,
    folder: &Path,
    shapes: &mut ShapeBuilder<'_>,
    workers: SharedWorkers,
    spec: &mut WorldSpec,
) -> Result<(BodySet, ContactMemory), BuildError> {
    let of_body = |name: &str| {
        let name = name.to_owned();
        move |error: BuildError| BuildError::Body { name, error: Box::new(error) }
    };
    let (mut meshes, mut labels) = (Vec::new(), Vec::new());
    for body in &scene.bodies {
        let mesh = match &body.source {
            BodySource::Organ(organ, _) => shapes.mesh(&organ.shape, FileKind::Tetrahedra),
            BodySource::Rigid(rigid) => shapes.mesh(&rigid.source, FileKind::SurfaceToo),
        };
        let (mesh, label_of) = mesh.map_err(of_body(&body.name))?;
        meshes.push(mesh);
        labels.push(label_of);
    }
    spec.bodies = body_specs(scene, &meshes);
    let joint = joined(&meshes);
    let topology = Topology::build(&joint).map_err(|error| {
        let (mesh, error) = (scene.organ.shape.shape.name(folder), OrganError::Topology(error));
        BuildError::Organ { mesh, error }
    })?;
    let body_of = spec.body_of_nodes(joint.positions_m.len());
    let is_rigid: Vec<bool> = spec.bodies.iter().map(|body| body.is_rigid).collect();
    let surface =
        BodiesOfSurface { topology: &topology, mesh: &joint, body_of: &body_of, is_rigid: &is_rigid };
    add_bonds(scene, &joint, &topology, spec)?;

    let mut parts = Vec::new();
    for ((body, mesh), label_of) in scene.bodies.iter().zip(meshes).zip(labels) {
        parts.push(match &body.source {
            BodySource::Rigid(source) => BodyPart::Rigid { mesh, motion: source.motion.clone() },
            BodySource::Organ(source, own) => {
                let kind = source.model;
                if spec.body_contact.is_some() && kind.row().motion == ModelMotion::Mixed {
                    let (model, what) = (kind.name(), "contact with other bodies ([contact] bodies = false)");
                    return Err(of_body(&body.name)(ModelError::Unsupported { model, what }.into()));
                }
                let tables = OrganTables {
                    source,
                    supports: &own.supports,
                    ligaments: &own.ligaments,
                    loads: &own.loads,
                    mesh,
                    label_of,
                    may_float: kind.row().motion != ModelMotion::QuasiStatic,
                };
                let body = organ_without_stress(tables, scene, folder).map_err(of_body(&body.name))?;
                BodyPart::Organ { body: Box::new(body), kind }
            }
        });
    }
    for (body, part) in spec.bodies.iter_mut().zip(&parts) {
        body.tissue = if let BodyPart::Organ { body, .. } = part { Some(body.material) } else { None };
    }
    let places = match &spec.body_contact {
        Some(params) if params.touch_m > 0.0 => places_in_touch(params, &surface),
        _ => PlacesInTouch::default(),
    };
    let friction = spec.body_contact.as_ref().map_or(0.0, |params| params.friction);
    let memory = carry(&mut parts, &topology, &joint, &places, friction)
        .map_err(|(number, error)| of_body(&scene.bodies[number].name)(*error))?;
    Ok((BodySet::of_parts(parts, workers), memory))
}

/// What the attachments tie together, in the joint mesh.
fn add_bonds(
    scene: &Scene,
    joint: &TetMesh,
    topology: &Topology,
    spec: &mut WorldSpec,
) -> Result<(), BuildError> {
    for (number, source) in scene.attachments.iter().enumerate() {
        let found = bonds(source, &spec.bodies, joint, topology);
        if found.is_empty() {
            let names = source.bodies.map(|body| scene.bodies[body].name.clone());
            return Err(BuildError::NothingAttached {
                number: number + 1,
                names,
                reach_mm: 1e3 * source.reach_m,
            });
        }
        spec.bonds.extend(found);
    }
    Ok(())
}

fn body_specs(scene: &Scene, meshes: &[TetMesh]) -> Vec<BodySpec> {
    let (mut n_nodes, mut n_tets) = (0, 0);
    let mut specs = Vec::new();
    for (body, mesh) in scene.bodies.iter().zip(meshes) {
        let (node, tet) = (n_nodes, n_tets);
        n_nodes += mesh.positions_m.len() as u32;
        n_tets += mesh.tetrahedra.len() as u32;
        let own = if let BodySource::Organ(_, own) = &body.source { Some(own) } else { None };
        specs.push(BodySpec {
            name: body.name.clone(),
            color: body.color,
            is_rigid: own.is_none(),
            // Its material comes with the body.
            tissue: None,
            model: if let BodySource::Organ(source, _) = &body.source { Some(source.model) } else { None },
            nodes: node..n_nodes,
            tetrahedra: tet..n_tets,
            supports: own.map(|own| own.supports.clone()).unwrap_or_default(),
            ligaments: own.map(|own| own.ligaments.clone()).unwrap_or_default(),
            loads: own.map(|own| own.loads.clone()).unwrap_or_default(),
        });
    }
    specs
}

fn joined(meshes: &[TetMesh]) -> TetMesh {
    let mut joint = TetMesh::default();
    for mesh in meshes {
        let first = joint.positions_m.len();
        joint.positions_m.extend_from_slice(&mesh.positions_m);
        let moved = |corners: &[NodeId; 4]| corners.map(|n| NodeId::from_index(n.index() + first));
        joint.tetrahedra.extend(mesh.tetrahedra.iter().map(moved));
    }
    joint
}
