//! The table of the models that scenes know: one line a model. A model's own file has its [`ModelRow`]; whoever reads models
//! (scenes, sessions, contact, the viewer, tests) goes through this table.

use super::{DeformableModel, ModelError, ModelRow, OrganBody};
use serde::{Deserialize, Serialize};
use std::fmt;

macro_rules! models {
    ($($kind:ident: $row:path,)+) => {
        /// Which model moves an organ: its place in the table [`MODELS`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum ModelKind {
            $(
                #[doc = concat!("`", stringify!($row), "` says what it is.")]
                $kind,
            )+
        }

        impl ModelKind {
            /// All kinds, in the order that messages list them.
            pub const ALL: [Self; MODELS.len()] = [$(Self::$kind),+];
        }

        /// Every model, in the order of [`ModelKind::ALL`].
        pub const MODELS: &[&ModelRow] = &[$(&$row),+];
    };
}

models! {
    Precomputed: super::precomputed::row::ROW,
    TensorMass: super::tensor_mass::row::ROW,
    NonlinearTensorMass: super::nonlinear_tensor_mass::row::ROW,
    Explicit: super::explicit_kernel::row::ROW,
    Implicit: super::implicit::row::ROW,
    MassSpring: super::mass_spring::ROW,
    ExtendedMassSpring: super::extended_mass_spring::row::ROW,
    Hybrid: super::hybrid::row::ROW,
    Reduced: super::reduced::row::ROW,
    QuasiNonlinear: super::quasi_nonlinear::row::ROW,
}

impl ModelKind {
    /// What the model tells about itself.
    pub const fn row(self) -> &'static ModelRow {
        MODELS[self as usize]
    }

    /// The name in scene files.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// The kind with this scene name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Names of the laws that the model can follow; the first is its own. None for springs without a law.
    pub fn laws(self) -> Vec<&'static str> {
        self.row().all_laws()
    }

    /// Whether the model can follow a law of this name.
    pub fn follows(self, law: &str) -> bool {
        self.row().follows(law)
    }
}

impl fmt::Display for ModelKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Makes a model of an organ at rest: [`ModelRow::build`].
///
/// # Errors
/// [`ModelError`] of the model.
pub fn build_model(body: &OrganBody, kind: ModelKind) -> Result<Box<dyn DeformableModel>, ModelError> {
    kind.row().build(body)
}

/// Makes a model of an organ from which tetrahedra are already gone: [`ModelRow::build_as_cut`].
///
/// # Errors
/// As [`build_model`].
pub fn build_model_as_cut(
    body: &OrganBody,
    kind: ModelKind,
    live: &[bool],
) -> Result<Box<dyn DeformableModel>, ModelError> {
    kind.row().build_as_cut(body, live)
}
