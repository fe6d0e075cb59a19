//! The parameters and errors of the hybrid model.

use super::{Precision, StoredNodes};
use crate::material::LinearElastic;
use crate::model::DynamicBody;
use crate::model::explicit::ExplicitError;
use crate::solve::SolveError;
use glisson_mesh::mesh::NodeId;
use glisson_mesh::mesh::zones::{Zones, ZonesError};

/// The law of a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ZoneLaw {
    /// Quasi-static, from tables.
    Precomputed,
    /// Linear explicit dynamics; can be cut.
    TensorMass,
    /// Explicit dynamics of St Venant-Kirchhoff tissue, correct under large rotations; can be cut.
    NonlinearTensorMass,
}

impl ZoneLaw {
    /// Whether zones of this law have inertia.
    pub fn is_dynamic(self) -> bool {
        self != Self::Precomputed
    }
}

/// Largest principal stretch of non-linear zones in [`CondensedParams::new`]: a choice, well beyond the strains for
/// which St Venant-Kirchhoff's law is meant.
const LARGEST_STRETCH: f64 = 1.3;

/// Which nodes of pre-computed zones tools can hold. Forces can act on all nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Loadable<'a> {
    /// Nodes on the surface.
    #[default]
    Surface,
    /// All nodes.
    All,
    /// These nodes.
    Nodes(&'a [NodeId]),
}

/// How old positions inside a pre-computed zone become with [`Updated::SurfaceFirst`] [s], but for one step for each zone. A choice: less than a picture is shown. They take a solution with the zone's factor, which at 20,000 tetrahedra is
/// nearly all of a step.
pub const INSIDE_PERIOD_S: f64 = 0.01;

/// Which positions a step updates, besides those of dynamic and frontier nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Updated {
    /// All of them.
    #[default]
    All,
    /// Those on the surface.
    Surface,
    /// Those on the surface, and those inside in turn: a zone's when they are [`INSIDE_PERIOD_S`] old, of no more zones in a step than it
    /// takes for all of them in this time.
    SurfaceFirst,
    /// The stored ones of zones with loads or tools, which the haptic loop needs. The others keep their positions.
    LoadedZones,
}

/// Why a hybrid model cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CondensedError {
    /// A fault of the body or of its dynamic zones.
    #[error(transparent)]
    Body(#[from] ExplicitError),
    /// A fault of the partition.
    #[error(transparent)]
    Zones(#[from] ZonesError),
    /// A fault of a pre-computed zone, or of all of them together.
    #[error("pre-computed zones: {0}")]
    Solve(#[from] SolveError),
    /// The number of laws is not that of the zones.
    #[error("{found} laws given for {n_zones} zones")]
    Laws {
        /// Laws given.
        found: usize,
        /// Zones there are.
        n_zones: usize,
    },
    /// The law of cut zones cannot be cut.
    #[error("cut_law is {found:?}; allowed: TensorMass or NonlinearTensorMass, which can be cut")]
    CutLaw {
        /// What was given.
        found: ZoneLaw,
    },
    /// A ligament at a node of a pre-computed zone.
    #[error(
        "the ligament at node {node} lies in a pre-computed zone, which is linear and ligaments are not; make the zone \
         around it a tensor_mass one"
    )]
    Ligament {
        /// The node.
        node: NodeId,
    },
}

/// Parameters of the hybrid model.
#[derive(Clone, Copy, Debug)]
pub struct CondensedParams<'a> {
    /// The body, its supports and loads. Dynamic zones take shorter steps than its time step where stability asks for it.
    pub body: DynamicBody<'a>,
    /// Lame's coefficients; the density is the body's.
    pub material: &'a LinearElastic,
    /// The zones of the body's mesh.
    pub zones: &'a Zones,
    /// The law of each.
    pub laws: &'a [ZoneLaw],
    /// The law of a pre-computed zone after a cut, or when nothing holds it any more.
    pub cut_law: ZoneLaw,
    /// The step is stable while all principal stretches of non-linear zones stay within [1/s, s] for this s, at least 1.
    pub largest_stretch: f64,
    /// Where tools can hold pre-computed tissue.
    pub loadable: Loadable<'a>,
    /// Which nodes have rows in the tables besides the loadable ones; the others are solved with the factor on demand.
    pub stored: StoredNodes,
    /// Precision of the tables. The frontier's own stiffness is `f64`; a step reads a copy of it in this precision.
    pub precision: Precision,
}

impl<'a> CondensedParams<'a> {
    /// Loadable surface nodes, all rows stored in `f64`; zones that are cut become linear tensor-mass.
    pub fn new(
        body: DynamicBody<'a>,
        material: &'a LinearElastic,
        zones: &'a Zones,
        laws: &'a [ZoneLaw],
    ) -> Self {
        let (stored, precision) = (StoredNodes::All, Precision::F64);
        Self {
            body,
            material,
            zones,
            laws,
            cut_law: ZoneLaw::TensorMass,
            largest_stretch: LARGEST_STRETCH,
            loadable: Loadable::Surface,
            stored,
            precision,
        }
    }
}

/// Sizes of a model, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CondensedSize {
    /// Pre-computed zones.
    pub n_precomputed_zones: usize,
    /// Frontier nodes between pre-computed zones alone.
    pub n_condensed_nodes: usize,
    /// Frontier nodes between pre-computed and dynamic zones.
    pub n_dynamic_frontier_nodes: usize,
    /// Dynamic nodes, those of the frontier included.
    pub n_dynamic_nodes: usize,
    /// Nodes of pre-computed zones that tools can hold, those of the frontier included.
    pub n_loadable_nodes: usize,
    /// Bytes of tables and factors.
    pub bytes: usize,
}
