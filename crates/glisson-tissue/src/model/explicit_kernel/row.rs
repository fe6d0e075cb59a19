//! Its row in the table of models.

use super::{ExplicitKernel, ExplicitKernelParams, NAME};
use crate::material::LawChoice;
use crate::model::kernel::{KernelLaw, SharedMaterial};
use crate::model::organ_body::LARGEST_STRETCH;
use crate::model::{DeformableModel, ModelError, ModelRow, OrganBody};
use std::sync::Arc;

pub(crate) const ROW: ModelRow = ModelRow {
    follows_any_law: true,
    has_fibres: true,
    has_tissue_parts: true,
    relaxes: true,
    ..ModelRow::explicit(
        NAME,
        "the fast kernel with any law, total Lagrangian explicit dynamics, on several threads",
        &["st_venant_kirchhoff"],
        make,
    )
};

fn make(body: &OrganBody, law: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let materials = body.materials();
    let mut laws: Vec<SharedMaterial> = Vec::new();
    let law = match law {
        None => KernelLaw::StVenantKirchhoff,
        Some(law) => match KernelLaw::named(law.name()) {
            Some(fast) => fast,
            None => {
                laws =
                    body.of_tissues(|tissue| Ok::<_, ModelError>(law.with_moduli_of(tissue)?.into_shared()))?;
                KernelLaw::General
            }
        },
    };
    let relaxation = body.series()?;
    let params = ExplicitKernelParams {
        fibres: &body.fibres(),
        volume_penalty_pa: body.volume_penalty_pa,
        laws: &laws,
        relaxation: relaxation.as_ref(),
        largest_stretch: LARGEST_STRETCH,
        workers: Arc::clone(&body.workers),
        ..ExplicitKernelParams::new(body.dynamic(), law, &materials)
    };
    Ok(Box::new(ExplicitKernel::build(&params).map_err(ModelError::of_numbers)?))
}
