//! From a scene to an organ at rest: reads the mesh, finds the material and what holds it.

use super::bodies::BodySource;
use super::material::{ElasticitySource, MaterialSource, TissuePartSource};
use super::organ::OrganSource;
use super::spec::Scene;
use crate::contact::shapes::MeshShape;
use crate::image::vessels::VesselFileError;
use crate::material::tissues::{Tissue, TissueError};
use crate::material::{LinearElastic, MaterialError};
use crate::math::DVec3;
use crate::mesh::TetMesh;
use crate::mesh::faults::{FaultAction, ImportPolicy};
use crate::mesh::files::{LABEL_FIELD, MeshFileError, read_mesh_with};
use crate::mesh::generate::MeshingError;
use crate::model::precomputed::{self};
use crate::model::{BodyPart, BodySet, BodyZone, MeasuredSample, ModelError, OrganBody, TissueParts};
use crate::solve::equilibrating_stress;
use crate::surface::files::{SurfaceFileError, import_closed_surface};
use crate::tool::{Tool, ToolShape};
use crate::world::organ::OrganError;
use crate::world::spec::{Ligament, Load, Region, Support, WorldSpec, attachments, fixed_nodes, nodes_in};
use std::collections::BTreeSet;
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
    /// Parts of other tissue in a mesh without labels.
    #[error(
        "{}: found no labels of tetrahedra, [[organ.part]] needs them: the cell field `{LABEL_FIELD}` of a .vtu file, which \
         `glisson mesh-organs` writes",
        file.display()
    )]
    NoLabels {
        /// The mesh file.
        file: PathBuf,
    },
    /// A part that the mesh has not.
    #[error("{}: no tetrahedron has the label {label} of [[organ.part]]; labels found: {found}", file.display())]
    NoSuchLabel {
        /// The mesh file.
        file: PathBuf,
        /// The label.
        label: i64,
        /// Those that are there.
        found: String,
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
         add [[organ.fixed]] with a region that holds some of it (the mesh spans {min_mm} to {max_mm} mm), or, with a dynamic \
         model, a [[rigid]] body or another organ that carries it",
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
    /// A body among several.
    #[error("body \"{name}\": {error}")]
    Body {
        /// Its name.
        name: String,
        /// What is wrong with it.
        error: Box<BuildError>,
    },
    /// Bodies that are too far from each other for an attachment.
    #[error(
        "[[attachment]] number {number}: no node of \"{}\" in its region is within {reach_mm} mm of \"{}\"", names[0], names[1]
    )]
    NothingAttached {
        /// Its number from 1.
        number: usize,
        /// The bodies.
        names: [String; 2],
        /// Its reach [mm].
        reach_mm: f64,
    },
    /// The surface of a rigid body cannot be filled with tetrahedra.
    #[error("its surface cannot be meshed: {0}; another \"edge\" may help")]
    Meshing(#[from] MeshingError),
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

/// The elasticity of a part.
fn read_elasticity(source: &ElasticitySource, density_kg_per_m3: f64) -> Result<LinearElastic, BuildError> {
    Ok(match source {
        ElasticitySource::Tissue(name) => Tissue::by_name(name)?.linear_elastic()?,
        &ElasticitySource::Given { young_modulus_pa, poisson_ratio } => {
            LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, density_kg_per_m3)?
        }
    })
}

/// The parts of other tissue; none if the scene has none.
fn tissue_parts(
    sources: &[TissuePartSource],
    label_of: &[i64],
    density_kg_per_m3: f64,
    file: &Path,
) -> Result<Option<TissueParts>, BuildError> {
    if sources.is_empty() {
        return Ok(None);
    }
    if label_of.is_empty() {
        return Err(BuildError::NoLabels { file: file.to_owned() });
    }
    let labels: BTreeSet<i64> = label_of.iter().copied().collect();
    if let Some(missing) = sources.iter().find(|source| !labels.contains(&source.label)) {
        let found = labels.iter().take(MOST_LABELS_NAMED).map(i64::to_string).collect::<Vec<_>>().join(", ");
        return Err(BuildError::NoSuchLabel { file: file.to_owned(), label: missing.label, found });
    }
    let materials = sources.iter().map(|source| read_elasticity(&source.elasticity, density_kg_per_m3));
    let part_of = |label: &i64| sources.iter().zip(0..).find(|(source, _)| source.label == *label);
    Ok(Some(TissueParts {
        materials: materials.collect::<Result<_, _>>()?,
        of_tet: label_of.iter().map(|label| part_of(label).map(|(_, part)| part)).collect(),
    }))
}

/// So many labels an error lists at most.
const MOST_LABELS_NAMED: usize = 20;

/// The mesh of an organ with the labels of its tetrahedra, if the file has any; its path is relative to `folder`.
pub(super) fn read_organ_mesh(
    source: &OrganSource,
    folder: &Path,
) -> Result<(TetMesh, Vec<i64>), BuildError> {
    let policy =
        ImportPolicy { faults: FaultAction::Refuse, unit: source.mesh_unit, ..ImportPolicy::default() };
    let (mesh, report) = read_mesh_with(&folder.join(&source.mesh), &policy)?;
    Ok((mesh, report.label_of))
}

/// An organ's tables with its mesh.
pub(super) struct OrganTables<'a> {
    pub(super) source: &'a OrganSource,
    pub(super) supports: &'a [Support],
    pub(super) ligaments: &'a [Ligament],
    pub(super) loads: &'a [Load],
    pub(super) mesh: TetMesh,
    /// The label of each tetrahedron, or none.
    pub(super) label_of: Vec<i64>,
    /// Whether nothing need hold it.
    pub(super) may_float: bool,
}

/// Reads an organ's mesh and material; the mesh's path is relative to `folder`. Of several bodies the first organ, as if it were
/// alone.
///
/// # Errors
/// [`BuildError`]: an unreadable mesh, an unknown tissue, nothing that holds the organ.
pub fn read_organ(scene: &Scene, folder: &Path) -> Result<OrganBody, BuildError> {
    let (mesh, label_of) = read_organ_mesh(&scene.organ, folder)?;
    let WorldSpec { supports, ligaments, loads, .. } = &scene.world;
    let (mut supports, mut ligaments, mut loads) = (&supports[..], &ligaments[..], &loads[..]);
    if let Some(BodySource::Organ(_, own)) = scene.bodies.first().map(|body| &body.source) {
        (supports, ligaments, loads) = (&own.supports, &own.ligaments, &own.loads);
    }
    let tables =
        OrganTables { source: &scene.organ, supports, ligaments, loads, mesh, label_of, may_float: false };
    let mut body = organ_without_stress(tables, scene, folder)?;
    if body.is_imaged_under_gravity && body.gravity_m_per_s2 != DVec3::ZERO {
        let OrganBody { mesh, material, fixed, attachments, gravity_m_per_s2, .. } = &body;
        body.rest_stress_pa = equilibrating_stress(mesh, material, fixed, attachments, *gravity_m_per_s2)
            .map_err(ModelError::RestStress)?;
    }
    Ok(body)
}

/// What an organ's models are made from, but for the stress at rest.
pub(super) fn organ_without_stress(
    tables: OrganTables<'_>,
    scene: &Scene,
    folder: &Path,
) -> Result<OrganBody, BuildError> {
    let OrganTables { source, supports, ligaments, loads, mesh, label_of, may_float } = tables;
    let file = folder.join(&source.mesh);
    let (material, name) = read_material(&source.material)?;
    let WorldSpec { gravity_m_per_s2, time_step_s, .. } = &scene.world;
    let fixed = fixed_nodes(supports, &mesh.positions_m);
    let attachments = attachments(ligaments, &mesh.positions_m);
    let bounds = crate::math::Aabb::of_points(&mesh.positions_m);
    let (min_mm, max_mm) = (bounds.min_m * 1e3, bounds.max_m * 1e3);
    let named = |what: &'static str, regions: Vec<Region>| {
        regions.into_iter().enumerate().map(move |(i, region)| (what, i + 1, region))
    };
    let regions = named("[[organ.fixed]]", supports.iter().map(|s| s.region).collect())
        .chain(named("[[organ.ligament]]", ligaments.iter().map(|l| l.region).collect()))
        .chain(named("[[organ.load]]", loads.iter().map(|l| l.region).collect()));
    for (what, number, region) in regions {
        if nodes_in(&[region], &mesh.positions_m).is_empty() {
            let what = format!("{what} number {number}");
            return Err(BuildError::EmptyRegion { file, what, min_mm, max_mm });
        }
    }
    if fixed.is_empty() && attachments.is_empty() && !may_float {
        return Err(BuildError::NothingFixed { file, n_regions: supports.len(), min_mm, max_mm });
    }
    let parts = tissue_parts(&source.tissue_parts, &label_of, material.density_kg_per_m3(), &file)?;
    let mut body = OrganBody::new(mesh, material, *time_step_s);
    body.material_text.insert_str(0, &name);
    body.tissue_parts = parts;
    body.law.clone_from(&source.law);
    body.relaxation.clone_from(&source.relaxation);
    body.fibre = source.fibre;
    body.volume_penalty_pa = source.volume_penalty_pa;
    body.fixed = fixed;
    body.attachments = attachments;
    body.gravity_m_per_s2 = *gravity_m_per_s2;
    body.is_imaged_under_gravity = source.is_imaged_under_gravity;
    body.damping = source.damping;
    body.most_parts = scene.most_parts;
    body.embeds_cuts = scene.embeds_cuts();
    // The first organ's rules for all of them.
    body.inside_may_lag = scene.organ.tearing.is_none();
    let zones = source.zones.iter();
    body.zones = zones
        .map(|zone| BodyZone { nodes: nodes_in(&[zone.region], &body.mesh.positions_m), law: zone.law })
        .collect();
    body.measured = source
        .measured
        .clone()
        .map(|measured| MeasuredSample { curve: folder.join(&measured.curve), ..measured });
    body.precomputed = source.precomputed.as_ref().map(|file| folder.join(file));
    Ok(body)
}

/// BLAKE3 of an organ's mesh (positions and connectivity, and where tetrahedra are of other tissue), hexadecimal: what a session
/// names its mesh by.
pub fn mesh_hash(body: &OrganBody) -> String {
    hash_with_parts(&body.mesh, body.tissue_parts.iter())
}

/// The same of all bodies.
pub fn joint_mesh_hash(bodies: &BodySet) -> String {
    let of_parts = bodies.parts.iter().filter_map(|part| match part {
        BodyPart::Organ { body, .. } => body.tissue_parts.as_ref(),
        BodyPart::Rigid { .. } => None,
    });
    let alone = bodies.joint.tissue_parts.iter().filter(|_| bodies.parts.is_empty());
    hash_with_parts(&bodies.joint.mesh, alone.chain(of_parts))
}

fn hash_with_parts<'a>(mesh: &TetMesh, parts: impl Iterator<Item = &'a TissueParts>) -> String {
    let mut hash = precomputed::mesh_hash(mesh);
    for parts in parts {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&hash);
        // Part 0 is the organ's own tissue.
        let numbers = parts.of_tet.iter().map(|part| part.map_or(0, |part| u32::from(part) + 1));
        hasher.update(&numbers.flat_map(u32::to_le_bytes).collect::<Vec<u8>>());
        hash = *hasher.finalize().as_bytes();
    }
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}
