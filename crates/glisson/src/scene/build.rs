//! From a scene to a world at rest: reads the mesh, finds the material, makes the model.

use super::models::build_model;
use super::organ::{MaterialSource, MeasuredSample, OrganZone};
use super::spec::Scene;
use crate::contact::shapes::MeshShape;
use crate::image::vessels::{VesselFileError, read_vessels};
use crate::material::tissues::{Tissue, TissueError};
use crate::material::{LawChoice, LinearElastic, MaterialError, PronyTerm};
use crate::math::DVec3;
use crate::mesh::faults::{FaultAction, ImportPolicy};
use crate::mesh::files::{MeshFileError, read_mesh_with};
use crate::mesh::topology::TopologyError;
use crate::mesh::{NodeId, TetMesh};
use crate::model::explicit_kernel::{ExplicitKernelError, SharedWorkers};
use crate::model::hybrid::condensed::CondensedError;
use crate::model::implicit::ImplicitError;
use crate::model::kernel::Sequential;
use crate::model::kind::ModelKind;
use crate::model::nonlinear_tensor_mass::{Fibre, NonlinearTensorMassError};
use crate::model::precomputed::{self, PrecomputedError};
use crate::model::quasi_nonlinear::{CurveError, FitError, ScaleError};
use crate::model::reduced::ReducedError;
use crate::model::{
    Attachment, DEFAULT_MOST_PARTS, DynamicBody, ExplicitError, FixedNode, Rayleigh, RestStress,
};
use crate::solve::{SolveError, equilibrating_stress};
use crate::surface::files::{SurfaceFileError, import_closed_surface};
use crate::tool::fracture::Tearing;
use crate::tool::{Tool, ToolShape};
use crate::world::World;
use crate::world::organ::OrganError;
use crate::world::spec::{Region, WorldSpec, attachments, fixed_nodes, nodes_in};
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
    /// The pre-computed model.
    #[error(transparent)]
    Precomputed(#[from] PrecomputedError),
    /// A model with explicit dynamics; its numbers are those of the scene.
    #[error("[simulation] or [organ]")]
    Explicit(#[from] ExplicitError),
    /// The explicit model; its numbers are those of the scene.
    #[error("[simulation] or [organ]")]
    ExplicitKernel(#[from] ExplicitKernelError),
    /// The stress that balances gravity in the rest shape.
    #[error(
        "the stress that balances gravity: {0}; with imaged_under_gravity = false the organ sags instead"
    )]
    RestStress(SolveError),
    /// The non-linear tensor-mass model; its numbers are those of the scene.
    #[error("[simulation] or [organ]")]
    NonlinearTensorMass(#[from] NonlinearTensorMassError),
    /// The implicit model; its numbers are those of the scene.
    #[error("[simulation] or [organ]")]
    Implicit(#[from] ImplicitError),
    /// The hybrid model; its numbers are those of the scene.
    #[error("[simulation], [organ] or [[organ.zone]]")]
    Hybrid(#[from] CondensedError),
    /// The reduced model.
    #[error(transparent)]
    Reduced(#[from] ReducedError),
    /// A measured curve that cannot be read.
    #[error(transparent)]
    Curve(#[from] CurveError),
    /// A measured curve that no polynomial of the degree follows.
    #[error("{}: fitting the {quantity}: {error}", file.display())]
    Fit {
        /// The curves.
        file: PathBuf,
        /// Which of them.
        quantity: &'static str,
        /// Why not.
        error: FitError,
    },
    /// The linear organ has nothing to which a measured curve could be put in proportion.
    #[error(
        "the quasi_nonlinear model cannot follow {}: with poisson_ratio = {poisson_ratio}, {error}; give the organ a \
         poisson_ratio above 0, or take the column of radial displacements out of the file",
        file.display()
    )]
    NoLinearAnswer {
        /// The measured curve.
        file: PathBuf,
        /// Of the organ.
        poisson_ratio: f64,
        /// What is wrong.
        error: ScaleError,
    },
    /// The quasi non-linear model without curves.
    #[error(
        "the quasi_nonlinear model follows measured curves, but the scene has none: add [organ.measured] with curve = \"FILE.csv\", \
         height and radius of the cylinder (docs/scene.md)"
    )]
    NoCurves,
    /// The organ's surface.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// A zone of the hybrid model without a tetrahedron of its own.
    #[error(
        "[[organ.zone]] number {number} has no tetrahedron: none has all its corners in the region and in no zone \
         before it; make the region larger or take it out"
    )]
    EmptyZone {
        /// Which table, from 1.
        number: usize,
    },
    /// The shape under gravity is one from which the tissue buckles.
    #[error(
        "the tissue is too soft, or held in too few places, to carry its weight in the shape of the mesh: with the {model} \
         model it would buckle from it. Hold more of it ([[organ.fixed]]), take a stiffer tissue or less gravity, a model \
         of small displacements (precomputed, tensor_mass), or imaged_under_gravity = false and let it sag"
    )]
    Buckles {
        /// Which model.
        model: ModelKind,
    },
    /// Something that the scene asks for and the model does not know.
    #[error("the {model} model has no {what}; choose another model or leave them out of the scene")]
    Unsupported {
        /// Which model.
        model: ModelKind,
        /// What, in the plural.
        what: &'static str,
    },
}

/// What the models of one organ are made from.
#[derive(Clone)]
pub struct OrganBody {
    /// The body at rest.
    pub mesh: TetMesh,
    /// Its elasticity at small strain, and its density.
    pub material: LinearElastic,
    /// The material in words.
    pub material_text: String,
    /// The law of the models that have a choice; each its own when absent.
    pub law: Option<LawChoice>,
    /// Viscoelastic relaxation.
    pub relaxation: Vec<PronyTerm>,
    /// Stiffness along a direction.
    pub fibre: Option<Fibre>,
    /// Penalty on changes of volume [Pa].
    pub volume_penalty_pa: f64,
    /// Nodes held at rest along some axes, ascending.
    pub fixed: Vec<FixedNode>,
    /// Ligaments.
    pub attachments: Vec<Attachment>,
    /// Stress of the rest shape, one a tetrahedron or none.
    pub rest_stress_pa: Vec<RestStress>,
    /// Gravity of the start [m/s2].
    pub gravity_m_per_s2: DVec3,
    /// Whether the rest shape is the one under this gravity; then `rest_stress_pa` balances it.
    pub is_imaged_under_gravity: bool,
    /// Damping.
    pub damping: Rayleigh,
    /// The world's time step [s].
    pub time_step_s: f64,
    /// Into how many internal steps it may be divided after an edit.
    pub most_parts: u32,
    /// A saved pre-computation.
    pub precomputed: Option<PathBuf>,
    /// Zones of the hybrid model.
    pub zones: Vec<OrganZone>,
    /// What the quasi non-linear model follows, with its file's full path.
    pub measured: Option<MeasuredSample>,
    /// Who computes for models that can use several threads.
    pub workers: SharedWorkers,
}

impl OrganBody {
    /// A body without supports, loads and damping.
    pub fn new(mesh: TetMesh, material: LinearElastic, time_step_s: f64) -> Self {
        Self {
            material_text: material_text("", &material),
            mesh,
            material,
            law: None,
            relaxation: Vec::new(),
            fibre: None,
            volume_penalty_pa: 0.0,
            fixed: Vec::new(),
            attachments: Vec::new(),
            rest_stress_pa: Vec::new(),
            gravity_m_per_s2: DVec3::ZERO,
            is_imaged_under_gravity: true,
            damping: Rayleigh::default(),
            time_step_s,
            most_parts: DEFAULT_MOST_PARTS,
            precomputed: None,
            zones: Vec::new(),
            measured: None,
            workers: Arc::new(Sequential),
        }
    }

    /// The held nodes, for a model that knows no supports along single axes and no ligaments.
    ///
    /// # Errors
    /// [`BuildError::Unsupported`] when there are such.
    pub fn nodes_fixed_wholly(&self, model: ModelKind) -> Result<Vec<NodeId>, BuildError> {
        if !self.attachments.is_empty() {
            return Err(BuildError::Unsupported { model, what: "ligaments" });
        }
        if self.fixed.iter().any(|held| held.axes != [true; 3]) {
            return Err(BuildError::Unsupported { model, what: "supports along single axes" });
        }
        Ok(self.fixed.iter().map(|held| held.node).collect())
    }

    /// What every dynamic model takes.
    pub(super) fn dynamic(&self) -> DynamicBody<'_> {
        DynamicBody {
            mesh: &self.mesh,
            density_kg_per_m3: self.material.density_kg_per_m3(),
            fixed: &self.fixed,
            attachments: &self.attachments,
            rest_stress_pa: &self.rest_stress_pa,
            gravity_m_per_s2: self.gravity_m_per_s2,
            damping: self.damping,
            time_step_s: self.time_step_s,
            most_parts: self.most_parts,
        }
    }
}

fn material_text(name: &str, material: &LinearElastic) -> String {
    format!(
        "{name}(E {} kPa, nu {}, {} kg/m3)",
        material.young_modulus_pa() / 1e3,
        material.poisson_ratio(),
        material.density_kg_per_m3()
    )
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
    body.material_text = material_text(&name, &material);
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
                .map_err(BuildError::RestStress)?;
    }
    body.damping = scene.organ.damping;
    body.most_parts = scene.most_parts;
    body.zones.clone_from(&scene.organ.zones);
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
    let world = World::new(spec, body.mesh.clone(), model, kind)
        .map_err(|error| BuildError::Organ { file: folder.join(&scene.organ.mesh), error })?;
    Ok((world, body))
}
