//! Why a model of an organ cannot be made.

use crate::material::MaterialError;
use crate::solve::SolveError;
use std::error::Error;

/// What a model's own file refuses, with its numbers and their limits.
pub type ModelCause = Box<dyn Error + Send + Sync>;

/// Why a model of an organ cannot be made. Errors of one model alone stand in its file, and come as [`ModelCause`].
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The model refuses some of its numbers, which are those of a scene.
    #[error("{tables}")]
    Numbers {
        /// The tables of the scene that they stand in.
        tables: &'static str,
        /// Which ones, and why.
        #[source]
        cause: ModelCause,
    },
    /// The model refuses something else: a file, say.
    #[error(transparent)]
    Own(ModelCause),
    /// The law's numbers.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// The stress that balances gravity in the rest shape.
    #[error(
        "the stress that balances gravity: {0}; with imaged_under_gravity = false the organ sags instead"
    )]
    RestStress(SolveError),
    /// The shape under gravity is one from which the tissue buckles.
    #[error(
        "the tissue is too soft, or held in too few places, to carry its weight in the shape of the mesh: with the {model} \
         model it would buckle from it. Hold more of it ([[organ.fixed]]), lay it on a bed ([[rigid]] bodies or organs below it, as in \
         `glisson demo --task bed`), take a stiffer tissue or less gravity, a model \
         of small displacements (precomputed, tensor_mass), or imaged_under_gravity = false and let it sag"
    )]
    Buckles {
        /// The model's scene name.
        model: &'static str,
    },
    /// Something that is asked for and that the model does not know.
    #[error("the {model} model has no {what}; choose another model or leave them out of the scene")]
    Unsupported {
        /// The model's scene name.
        model: &'static str,
        /// What, in the plural.
        what: &'static str,
    },
}

impl ModelError {
    /// Numbers that the tables `[simulation]` and `[organ]` of a scene have.
    pub(super) fn of_numbers(cause: impl Error + Send + Sync + 'static) -> Self {
        Self::of_tables("[simulation] or [organ]", cause)
    }

    /// Numbers that these tables of a scene have.
    pub(super) fn of_tables(tables: &'static str, cause: impl Error + Send + Sync + 'static) -> Self {
        Self::Numbers { tables, cause: Box::new(cause) }
    }

    /// What says itself where it comes from.
    pub(super) fn own(cause: impl Error + Send + Sync + 'static) -> Self {
        Self::Own(Box::new(cause))
    }
}
