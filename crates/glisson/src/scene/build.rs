//! From a scene to an organ at rest: reads the mesh, finds the material and what holds it.

use super::bodies::BodySource;
use super::build_error::BuildError;
use super::build_shape::{FileKind, ShapeBuilder};
use super::material::{ElasticitySource, MaterialSource, PartPlace, TissuePartSource};
use super::organ::OrganSource;
use super::spec::Scene;
use crate::contact::shapes::MeshShape;
use crate::material::LinearElastic;
use crate::material::tissues::Tissue;
use crate::math::DVec3;
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::model::precomputed::{self};
use crate::model::{BodyPart, BodySet, BodyZone, MeasuredSample, ModelError, OrganBody, TissueParts};
use crate::solve::equilibrating_stress;
use crate::surface::files::import_closed_surface;
use crate::tool::{Tool, ToolShape};
use crate::world::spec::{Ligament, Load, Region, Support, WorldSpec, attachments, fixed_nodes, nodes_in};
use std::collections::BTreeSet;
use std::path::Path;

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

/// The parts of other tissue; none if the scene has none. A tetrahedron that two parts have is of the first.
fn tissue_parts(
    sources: &[TissuePartSource],
    mesh: &TetMesh,
    label_of: &[i64],
    density_kg_per_m3: f64,
    name_of_mesh: &str,
) -> Result<Option<TissueParts>, BuildError> {
    if sources.is_empty() {
        return Ok(None);
    }
    let mut of_tet = vec![None; mesh.tetrahedra.len()];
    for (source, part) in sources.iter().zip(0..) {
        let tets = match source.place {
            PartPlace::Label(label) => tets_with_label(label, label_of, name_of_mesh)?,
            PartPlace::Region(region) => tets_in(region, mesh, part, name_of_mesh)?,
        };
        for tet in tets {
            of_tet[tet].get_or_insert(part);
        }
    }
    let materials = sources.iter().map(|source| read_elasticity(&source.elasticity, density_kg_per_m3));
    Ok(Some(TissueParts { materials: materials.collect::<Result<_, _>>()?, of_tet }))
}

fn tets_with_label(label: i64, label_of: &[i64], mesh: &str) -> Result<Vec<usize>, BuildError> {
    if label_of.is_empty() {
        return Err(BuildError::NoLabels { mesh: mesh.to_owned() });
    }
    let tets: Vec<usize> = (0..label_of.len()).filter(|&tet| label_of[tet] == label).collect();
    if tets.is_empty() {
        let labels: BTreeSet<i64> = label_of.iter().copied().collect();
        let found = labels.iter().take(MOST_LABELS_NAMED).map(i64::to_string).collect::<Vec<_>>().join(", ");
        return Err(BuildError::NoSuchLabel { mesh: mesh.to_owned(), label, found });
    }
    Ok(tets)
}

/// Tetrahedra with their middle in the region of part number `part`.
fn tets_in(region: Region, mesh: &TetMesh, part: u16, name_of_mesh: &str) -> Result<Vec<usize>, BuildError> {
    let tets = (0..mesh.tetrahedra.len()).map(TetId::from_index);
    let middles_m: Vec<DVec3> =
        tets.map(|tet| 0.25 * mesh.corners_m(tet).into_iter().sum::<DVec3>()).collect();
    let tets: Vec<usize> = nodes_in(&[region], &middles_m).into_iter().map(NodeId::index).collect();
    if tets.is_empty() {
        let bounds = crate::math::Aabb::of_points(&mesh.positions_m);
        return Err(BuildError::EmptyRegion {
            mesh: name_of_mesh.to_owned(),
            what: format!("[[organ.part]] number {}", part + 1),
            min_mm: bounds.min_m * 1e3,
            max_mm: bounds.max_m * 1e3,
        });
    }
    Ok(tets)
}

/// So many labels an error lists at most.
const MOST_LABELS_NAMED: usize = 20;

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
    organ_of(scene, folder, &mut ShapeBuilder::new(folder))
}

/// [`read_organ`] beside what else is made of the scene's shapes.
pub(super) fn organ_of(
    scene: &Scene,
    folder: &Path,
    shapes: &mut ShapeBuilder<'_>,
) -> Result<OrganBody, BuildError> {
    let (mesh, label_of) = shapes.mesh(&scene.organ.shape, FileKind::Tetrahedra)?;
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
    let name_of_mesh = source.shape.shape.name(folder);
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
            return Err(BuildError::EmptyRegion { mesh: name_of_mesh, what, min_mm, max_mm });
        }
    }
    if fixed.is_empty() && attachments.is_empty() && !may_float {
        return Err(BuildError::NothingFixed {
            mesh: name_of_mesh,
            n_regions: supports.len(),
            min_mm,
            max_mm,
        });
    }
    let density_kg_per_m3 = material.density_kg_per_m3();
    let parts = tissue_parts(&source.tissue_parts, &mesh, &label_of, density_kg_per_m3, &name_of_mesh)?;
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
