//! From a scene to a world at rest: reads the mesh, finds the material, makes the model.

use super::spec::{MaterialSource, Scene};
use crate::material::tissues::{Tissue, TissueError};
use crate::material::{LinearElastic, MaterialError};
use crate::math::DVec3;
use crate::mesh::faults::{FaultAction, ImportPolicy};
use crate::mesh::files::{MeshFileError, read_mesh_with};
use crate::mesh::{NodeId, TetMesh};
use crate::model::kind::ModelKind;
use crate::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassError, NonlinearTensorMassParams,
};
use crate::model::precomputed::{
    self, Precomputed, PrecomputedError, PrecomputedExpectation, PrecomputedParams, StoredNodes,
};
use crate::model::tensor_mass::{TensorMass, TensorMassError, TensorMassParams};
use crate::model::{DeformableModel, DynamicBody, FixedNode, Rayleigh};
use crate::world::World;
use crate::world::organ::OrganError;
use crate::world::spec::nodes_in;
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
    /// The pre-computed model.
    #[error(transparent)]
    Precomputed(#[from] PrecomputedError),
    /// The tensor-mass model; its numbers are those of the scene.
    #[error("[simulation] or [organ]")]
    TensorMass(#[from] TensorMassError),
    /// The St Venant-Kirchhoff model; its numbers are those of the scene.
    #[error("[simulation] or [organ]")]
    StVenantKirchhoff(#[from] NonlinearTensorMassError),
}

/// St Venant-Kirchhoff tissue stiffens as it is stretched: its stable step is computed for principal stretches up
/// to this one. A choice, not a measurement: the law itself is meant for strains well below it.
const LARGEST_STRETCH: f64 = 1.3;

/// What the models of one organ are made from.
#[derive(Clone, Debug)]
pub struct OrganBody {
    /// The body at rest.
    pub mesh: TetMesh,
    /// Its material.
    pub material: LinearElastic,
    /// The material in words.
    pub material_text: String,
    /// Nodes that never move, ascending.
    pub fixed_nodes: Vec<NodeId>,
}

/// Reads an organ's mesh and material; the mesh's path is relative to `folder`.
///
/// # Errors
/// [`BuildError`]: an unreadable mesh, an unknown tissue, nothing that holds the organ.
pub fn read_organ(scene: &Scene, folder: &Path) -> Result<OrganBody, BuildError> {
    let file = folder.join(&scene.organ.mesh);
    let policy = ImportPolicy { faults: FaultAction::Refuse, ..ImportPolicy::default() };
    let (mesh, _) = read_mesh_with(&file, &policy)?;
    let (material, name) = match &scene.organ.material {
        MaterialSource::Tissue(name) => {
            let tissue = Tissue::by_name(name)?;
            (tissue.linear_elastic()?, format!("{} ", tissue.name))
        }
        &MaterialSource::Given { young_modulus_pa, poisson_ratio, density_kg_per_m3 } => {
            let material =
                LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, density_kg_per_m3)?;
            (material, String::new())
        }
    };
    let material_text = format!(
        "{name}(E {} kPa, nu {}, {} kg/m3)",
        material.young_modulus_pa() / 1e3,
        material.poisson_ratio(),
        material.density_kg_per_m3()
    );
    let fixed_nodes = nodes_in(&scene.world.fixed, &mesh.positions_m);
    if fixed_nodes.is_empty() {
        let bounds = crate::math::Aabb::of_points(&mesh.positions_m);
        let (min_mm, max_mm) = (bounds.min_m * 1e3, bounds.max_m * 1e3);
        return Err(BuildError::NothingFixed { file, n_regions: scene.world.fixed.len(), min_mm, max_mm });
    }
    Ok(OrganBody { mesh, material, material_text, fixed_nodes })
}

/// BLAKE3 of a mesh (positions and connectivity), hexadecimal: what a session names its mesh by.
pub fn mesh_hash(mesh: &TetMesh) -> String {
    precomputed::mesh_hash(mesh).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Makes a model of an organ at rest; a saved pre-computation is loaded if the scene names one.
///
/// # Errors
/// [`BuildError`] of the model: a file that belongs to another organ, a time step above the stable one.
pub fn build_model(
    scene: &Scene,
    folder: &Path,
    body: &OrganBody,
    kind: ModelKind,
) -> Result<Box<dyn DeformableModel>, BuildError> {
    let OrganBody { mesh, material, fixed_nodes, .. } = body;
    let fixed: Vec<FixedNode> = fixed_nodes.iter().map(|&node| FixedNode::all_axes(node)).collect();
    let dynamic = DynamicBody {
        fixed: &fixed,
        damping: Rayleigh { mass_per_s: scene.organ.damping_per_s, stiffness_s: 0.0 },
        time_step_s: scene.world.time_step_s,
        ..DynamicBody::new(mesh, material.density_kg_per_m3())
    };
    Ok(match (kind, &scene.organ.precomputed) {
        (ModelKind::Precomputed, Some(file)) => {
            let expected = PrecomputedExpectation { mesh, material, fixed_nodes };
            Box::new(Precomputed::load(&folder.join(file), &expected)?)
        }
        (ModelKind::Precomputed, None) => {
            let stored = StoredNodes::Surface;
            let params = PrecomputedParams { mesh, material, fixed_nodes, stored, progress: None };
            Box::new(Precomputed::build(&params)?)
        }
        (ModelKind::TensorMass, _) => {
            Box::new(TensorMass::build(&TensorMassParams { body: dynamic, material })?)
        }
        (ModelKind::StVenantKirchhoff, _) => {
            let largest_stretch = LARGEST_STRETCH;
            Box::new(NonlinearTensorMass::build(&NonlinearTensorMassParams {
                body: dynamic,
                elasticity: NonlinearElasticity {
                    material,
                    fibres: &[],
                    volume_penalty_pa: 0.0,
                    largest_stretch,
                },
            })?)
        }
    })
}

/// A world at rest, and what its models are made from; files are relative to `folder`.
///
/// # Errors
/// [`BuildError`] of [`read_organ`] and [`build_model`], and a mesh that is no body.
pub fn build_world(scene: &Scene, folder: &Path) -> Result<(World, OrganBody), BuildError> {
    let body = read_organ(scene, folder)?;
    let kind = scene.organ.model;
    let model = build_model(scene, folder, &body, kind)?;
    let world = World::new(scene.world.clone(), body.mesh.clone(), model, kind)
        .map_err(|error| BuildError::Organ { file: folder.join(&scene.organ.mesh), error })?;
    Ok((world, body))
}
