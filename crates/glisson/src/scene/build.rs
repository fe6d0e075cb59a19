//! From a scene to a world at rest: reads the mesh, finds the material, makes the model.

use super::organ::MaterialSource;
use super::spec::Scene;
use crate::contact::shapes::MeshShape;
use crate::image::vessels::{VesselFileError, read_vessels};
use crate::material::tissues::{Tissue, TissueError};
use crate::material::{LinearElastic, MaterialError};
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::mesh::faults::{FaultAction, ImportPolicy};
use crate::mesh::files::{MeshFileError, read_mesh_with};
use crate::model::explicit_kernel::SharedWorkers;
use crate::model::kind::build_model;
use crate::model::precomputed::{self};
use crate::model::{BodyZone, MeasuredSample, ModelError, OrganBody};
use crate::solve::equilibrating_stress;
use crate::surface::files::{SurfaceFileError, import_closed_surface};
use crate::tool::fracture::Tearing;
use crate::tool::{Tool, ToolShape};
use crate::world::World;
use crate::world::organ::OrganError;
use crate::world::spec::{Region, WorldSpec, attachments, fixed_nodes, nodes_in};
use std::path::{Path, PathBuf};

/// Why a scene gives no world.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The mesh file.
    #[error(transparent)]
    MeshFile(#[from] MeshFileError),
    /// The mesh is no body.
    #[error("{}: {error}", file.display())]
    Organ {
        /// The mesh file.
        file: PathBuf,
        /// What is wrong with it.
        error: OrganError,
    },
    /// The surface of an instrument's tip.
    #[error(transparent)]
    ToolShape(#[from] SurfaceFileError),
    /// The organ's vessels.
    #[error(transparent)]
    Vessels(#[from] VesselFileError),
    /// The tissue's name or numbers.
    #[error(transparent)]
    Tissue(#[from] TissueError),
    /// The material's numbers.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// Nothing holds the organ.
    #[error(
        "no node of {} lies in the scene's fixed regions ({n_regions} given): the organ would float; \
         add [[organ.fixed]] with a region that holds some of it (the mesh spans {min_mm} to {max_mm} mm)",
        file.display()
    )]
    NothingFixed {
        /// The mesh file.
        file: PathBuf,
        /// Regions in the scene.
        n_regions: usize,
        /// Smallest corner of the mesh [mm].
        min_mm: DVec3,
        /// Largest corner of the mesh [mm].
        max_mm: DVec3,
    },
    /// A part of the scene that no node of the mesh belongs to.
    #[error(
        "no node of {} lies in the region of {what}: it would do nothing (the mesh spans {min_mm:.1} to {max_mm:.1} mm)",
        file.display()
    )]
    EmptyRegion {
        /// The mesh file.
        file: PathBuf,
        /// Which table, with its number from 1.
        what: String,
        /// Smallest corner of the mesh [mm].
        min_mm: DVec3,
        /// Largest corner of the mesh [mm].
        max_mm: DVec3,
    },
    /// The model that the scene asks for.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// A closed surface as the shape of a tip, in the frame of the tool.
fn read_tool_shape(file: &Path) -> Result<MeshShape, BuildError> {
    let surface = import_closed_surface(file)?.mesh;
    Ok(MeshShape::new(surface.positions_m, surface.triangles))
}

/// The scene's instruments with the shapes of their tips.
///
/// # Errors
/// [`BuildError::ToolShape`] when the file of a shape cannot be read.
pub fn read_tools(scene: &Scene, folder: &Path) -> Result<Vec<Tool>, BuildError> {
    let mut tools = scene.world.tools.clone();
    for (tool, file) in tools.iter_mut().zip(&scene.tool_shapes) {
        if let Some(file) = file {
            tool.shape = ToolShape::Mesh(read_tool_shape(&folder.join(file))?);
        }
    }
    Ok(tools)
}

/// The material at rest, and the tissue's name with a space after it when it is one of the table's.
fn read_material(source: &MaterialSource) -> Result<(LinearElastic, String), BuildError> {
    match source {
        MaterialSource::Tissue(name) => {
            let tissue = Tissue::by_name(name)?;
            Ok((tissue.linear_elastic()?, format!("{} ", tissue.name)))
        }
        &MaterialSource::Given { young_modulus_pa, poisson_ratio, density_kg_per_m3 } => {
            let material =
                LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, density_kg_per_m3)?;
            Ok((material, String::new()))
        }
    }
}

/// Reads an organ's mesh and material; the mesh's path is relative to `folder`.
///
/// # Errors
/// [`BuildError`]: an unreadable mesh, an unknown tissue, nothing that holds the organ.
pub fn read_organ(scene: &Scene, folder: &Path) -> Result<OrganBody, BuildError> {
    let file = folder.join(&scene.organ.mesh);
    let policy = ImportPolicy { faults: FaultAction::Refuse, ..ImportPolicy::default() };
    let (mesh, _) = read_mesh_with(&file, &policy)?;
    let (material, name) = read_material(&scene.organ.material)?;
    let WorldSpec { supports, ligaments, gravity_m_per_s2, time_step_s, .. } = &scene.world;
    let fixed = fixed_nodes(supports, &mesh.positions_m);
    let attachments = attachments(ligaments, &mesh.positions_m);
    let bounds = crate::math::Aabb::of_points(&mesh.positions_m);
    let (min_mm, max_mm) = (bounds.min_m * 1e3, bounds.max_m * 1e3);
    let named = |what: &'static str, regions: Vec<Region>| {
        regions.into_iter().enumerate().map(move |(i, region)| (what, i + 1, region))
    };
    let regions = named("[[organ.fixed]]", supports.iter().map(|s| s.region).collect())
        .chain(named("[[organ.ligament]]", ligaments.iter().map(|l| l.region).collect()))
        .chain(named("[[organ.load]]", scene.world.loads.iter().map(|l| l.region).collect()));
    for (what, number, region) in regions {
        if nodes_in(&[region], &mesh.positions_m).is_empty() {
            let what = format!("{what} number {number}");
            return Err(BuildError::EmptyRegion { file, what, min_mm, max_mm });
        }
    }
    if fixed.is_empty() && attachments.is_empty() {
        return Err(BuildError::NothingFixed { file, n_regions: supports.len(), min_mm, max_mm });
    }
    let mut body = OrganBody::new(mesh, material, *time_step_s);
    body.material_text.insert_str(0, &name);
    body.law.clone_from(&scene.organ.law);
    body.relaxation.clone_from(&scene.organ.relaxation);
    body.fibre = scene.organ.fibre;
    body.volume_penalty_pa = scene.organ.volume_penalty_pa;
    body.fixed = fixed;
    body.attachments = attachments;
    body.gravity_m_per_s2 = *gravity_m_per_s2;
    body.is_imaged_under_gravity = scene.organ.is_imaged_under_gravity;
    if body.is_imaged_under_gravity && body.gravity_m_per_s2 != DVec3::ZERO {
        let (fixed, attachments) = (&body.fixed, &body.attachments);
        body.rest_stress_pa =
            equilibrating_stress(&body.mesh, &body.material, fixed, attachments, body.gravity_m_per_s2)
                .map_err(ModelError::RestStress)?;
    }
    body.damping = scene.organ.damping;
    body.most_parts = scene.most_parts;
    let zones = scene.organ.zones.iter();
    body.zones = zones
        .map(|zone| BodyZone { nodes: nodes_in(&[zone.region], &body.mesh.positions_m), law: zone.law })
        .collect();
    body.measured = scene
        .organ
        .measured
        .clone()
        .map(|measured| MeasuredSample { curve: folder.join(&measured.curve), ..measured });
    body.precomputed = scene.organ.precomputed.as_ref().map(|file| folder.join(file));
    Ok(body)
}

/// BLAKE3 of a mesh (positions and connectivity), hexadecimal: what a session names its mesh by.
pub fn mesh_hash(mesh: &TetMesh) -> String {
    precomputed::mesh_hash(mesh).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A world at rest, and what its models are made from; files are relative to `folder`, models that can use several
/// threads get `workers`.
///
/// # Errors
/// [`BuildError`] of [`read_organ`] and [`build_model`], and a mesh that is no body.
pub fn build_world(
    scene: &Scene,
    folder: &Path,
    workers: SharedWorkers,
) -> Result<(World, OrganBody), BuildError> {
    let body = OrganBody { workers, ..read_organ(scene, folder)? };
    let kind = scene.organ.model;
    let model = build_model(&body, kind)?;
    let mut spec = scene.world.clone();
    spec.tools = read_tools(scene, folder)?;
    if let Some(file) = &scene.organ.vessels {
        spec.vessels = read_vessels(&folder.join(file))?;
    }
    spec.tearing = scene.organ.tearing.map(|energy| Tearing { energy, material: body.material });
    spec.tissue = Some(body.material);
    let world = World::new(spec, body.mesh.clone(), model, kind)
        .map_err(|error| BuildError::Organ { file: folder.join(&scene.organ.mesh), error })?;
    Ok((world, body))
}
