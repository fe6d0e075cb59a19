//! What a hybrid model is made from, and why there may be none.

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
    /// Explicit dynamics of St Venant-Kirchhoff tissue, right under large rotations of the zone; can be cut.
    NonlinearTensorMass,
}

impl ZoneLaw {
    /// Whether such a zone moves by itself.
    pub fn is_dynamic(self) -> bool {
        self != Self::Precomputed
    }
}

/// Largest principal stretch of non-linear zones that [`CondensedParams::new`] takes steps for: a choice, well beyond
/// the strains for which St Venant-Kirchhoff's law is meant.
const LARGEST_STRETCH: f64 = 1.3;

/// Which nodes of pre-computed zones tools can hold. Forces can act on all nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Loadable<'a> {
    /// Those on the surface.
    #[default]
    Surface,
    /// All.
    All,
    /// These.
    Nodes(&'a [NodeId]),
}

/// Which positions a step brings up to date, beside those of dynamic and frontier nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Updated {
    /// All of them.
    #[default]
    All,
    /// Those on the surface.
    Surface,
    /// The stored ones of zones with loads or tools: what the haptic loop needs. The others stay where they are shown.
    LoadedZones,
}

/// Why there is no hybrid model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CondensedError {
    /// The body or its dynamic zones.
    #[error(transparent)]
    Body(#[from] ExplicitError),
    /// The partition.
    #[error(transparent)]
    Zones(#[from] ZonesError),
    /// A pre-computed zone, or all of them together.
    #[error("pre-computed zones: {0}")]
    Solve(#[from] SolveError),
    /// Not one law a zone.
    #[error("{found} laws given for {n_zones} zones")]
    Laws {
        /// Laws given.
        found: usize,
        /// Zones there are.
        n_zones: usize,
    },
    /// The law of cut zones.
    #[error("cut_law is {found:?}; allowed: TensorMass or NonlinearTensorMass, which can be cut")]
    CutLaw {
        /// What was given.
        found: ZoneLaw,
    },
    /// A ligament where nothing is dynamic.
    #[error(
        "the ligament at node {node} lies in a pre-computed zone, which is linear and ligaments are not; make the zone \
         around it a tensor_mass one"
    )]
    Ligament {
        /// The node.
        node: NodeId,
    },
}

/// What a hybrid model is made from.
#[derive(Clone, Copy, Debug)]
pub struct CondensedParams<'a> {
    /// The body, its supports and loads. Dynamic zones take shorter steps than its time step where they have to.
    pub body: DynamicBody<'a>,
    /// Lame's numbers; the density is the body's.
    pub material: &'a LinearElastic,
    /// The zones of the body's mesh.
    pub zones: &'a Zones,
    /// The law of each.
    pub laws: &'a [ZoneLaw],
    /// What a pre-computed zone becomes when it is cut, or when nothing holds it any more.
    pub cut_law: ZoneLaw,
    /// The stable step holds while all principal stretches of non-linear zones stay within [1/s, s] for this s, from 1.
    pub largest_stretch: f64,
    /// Where tools can hold pre-computed tissue.
    pub loadable: Loadable<'a>,
    /// Which nodes have rows in the tables, beside the loadable ones; the others are computed with the factor when they are asked for.
    pub stored: StoredNodes,
    /// How the tables are kept. The frontier's own stiffness is `f64`; a step reads a copy of it in this precision.
    pub precision: Precision,
}

impl<'a> CondensedParams<'a> {
    /// Surface nodes loadable, everything stored in `f64`; what is cut becomes linear tensor-mass.
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
    /// Nodes that move by themselves, those of the frontier included.
    pub n_dynamic_nodes: usize,
    /// Nodes of pre-computed zones that tools can hold, those of the frontier included.
    pub n_loadable_nodes: usize,
    /// Bytes of tables and factors.
    pub bytes: usize,
}
