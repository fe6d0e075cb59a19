//! All that models of an organ are made from, and why none can be made.

use super::organ::{MeasuredSample, OrganZone};
use crate::image::vessels::VesselFileError;
use crate::material::tissues::TissueError;
use crate::material::{LawChoice, LinearElastic, MaterialError, PronyTerm};
use crate::math::DVec3;
use crate::mesh::files::MeshFileError;
use crate::mesh::topology::TopologyError;
use crate::mesh::{NodeId, TetMesh};
use crate::model::explicit_kernel::{ExplicitKernelError, SharedWorkers};
use crate::model::hybrid::condensed::CondensedError;
use crate::model::implicit::ImplicitError;
use crate::model::kernel::Sequential;
use crate::model::kind::ModelKind;
use crate::model::nonlinear_tensor_mass::{Fibre, NonlinearTensorMassError};
use crate::model::precomputed::PrecomputedError;
use crate::model::quasi_nonlinear::{CurveError, FitError, ScaleError};
use crate::model::reduced::ReducedError;
use crate::model::{
    Attachment, DEFAULT_MOST_PARTS, DynamicBody, ExplicitError, FixedNode, Rayleigh, RestStress,
};
use crate::solve::SolveError;
use crate::surface::files::SurfaceFileError;
use crate::world::organ::OrganError;
use std::path::PathBuf;
use std::sync::Arc;

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

pub(super) fn material_text(name: &str, material: &LinearElastic) -> String {
    format!(
        "{name}(E {} kPa, nu {}, {} kg/m3)",
        material.young_modulus_pa() / 1e3,
        material.poisson_ratio(),
        material.density_kg_per_m3()
    )
}
