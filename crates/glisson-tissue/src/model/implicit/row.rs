//! The row of `implicit` in the table of models.

use std::sync::Arc;

use super::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use crate::material::{LawChoice, LinearElastic, MaterialSpec, NeoHookeLog};
use crate::model::{DeformableModel, ModelError, ModelMotion, ModelRow, OrganBody};

pub(in crate::model) const ROW: ModelRow = ModelRow {
    follows_any_law: true,
    has_tissue_parts: true,
    relaxes: true,
    motion: ModelMotion::Implicit,
    ..ModelRow::explicit(
        "implicit",
        "implicit Euler with any law: large steps",
        &["neo_hooke_log", "stable_neo_hooke", "st_venant_kirchhoff"],
        make,
    )
};

fn make(body: &OrganBody, law: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let spec_of = |tissue: &LinearElastic| match law {
        None => Ok(MaterialSpec::from(NeoHookeLog::from(tissue))),
        Some(law) => law.with_moduli_of(tissue),
    };
    let law = if body.tissue_parts.is_some() {
        ImplicitLaw::of_each(body.of_tissues(spec_of)?)
    } else {
        ImplicitLaw::from(&spec_of(&body.material)?)
    };
    let relaxation = body.series()?;
    let params =
        ImplicitParams { relaxation: relaxation.as_ref(), ..ImplicitParams::new(body.dynamic(), &law) };
    let mut model = ImplicitEuler::build(&params).map_err(ModelError::of_numbers)?;
    model.set_workers(Arc::clone(&body.workers));
    Ok(Box::new(model))
}
