//! From a scene to a world at rest.

use super::build::{organ_of, read_tools};
use super::build_bodies::read_bodies;
use super::build_error::BuildError;
use super::build_shape::ShapeBuilder;
use super::spec::Scene;
use crate::image::vessels::{Tube, read_vessels};
use crate::model::{BodySet, OrganBody};
use crate::tool::fracture::Tearing;
use crate::workers::SharedWorkers;
use crate::world::World;
use std::path::Path;

/// A world at rest, and what its models are made from; files are relative to `folder`, models that can use several
/// threads get `workers`.
///
/// # Errors
/// [`BuildError`] of [`super::read_organ`] and of models, a mesh that is no body, a rigid body's shape.
pub fn build_world(
    scene: &Scene,
    folder: &Path,
    workers: SharedWorkers,
) -> Result<(World, BodySet), BuildError> {
    let mut spec = scene.world.clone();
    spec.tools = read_tools(scene, folder)?;
    let mut shapes = ShapeBuilder::new(folder);
    for organ in scene.organs() {
        let of_file = organ.vessels.as_ref().map(|file| read_vessels(&folder.join(file))).transpose()?;
        let own = of_file.filter(|own| !own.is_empty()).unwrap_or_else(|| shapes.vessels(&organ.shape));
        append_vessels(&mut spec.vessels, &own);
        append_vessels(&mut spec.vessels, &organ.vessel_tubes);
    }
    let kind = scene.organ.model;
    let (bodies, memory) = if scene.bodies.is_empty() {
        (BodySet::single(OrganBody { workers, ..organ_of(scene, folder, &mut shapes)? }), None)
    } else {
        let (bodies, memory) = read_bodies(scene, folder, &mut shapes, workers, &mut spec)?;
        (bodies, Some(memory))
    };
    let model = bodies.build_model(kind)?;
    spec.tissue = Some(bodies.joint.material);
    spec.tearing = scene.organ.tearing.map(|energy| Tearing { energy, material: bodies.joint.material });
    let mut world = World::new(spec, bodies.joint.mesh.clone(), model, kind)
        .map_err(|error| BuildError::Organ { mesh: scene.organ.shape.shape.name(folder), error })?;
    if let Some(memory) = memory {
        world.start_in_touch(memory);
    }
    Ok((world, bodies))
}

/// Adds tubes, whose parents are among them.
fn append_vessels(all: &mut Vec<Tube>, more: &[Tube]) {
    let n_before = all.len() as u32;
    let moved = |tube: &Tube| Tube { parent: tube.parent.map(|parent| parent + n_before), ..*tube };
    all.extend(more.iter().map(moved));
}
