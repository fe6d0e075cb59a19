//! Its row in the table of models.

use super::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use crate::material::LawChoice;
use crate::model::explicit::Cuttable;
use crate::model::{DeformableModel, ModelError, ModelRow, OrganBody};

pub(crate) const ROW: ModelRow = ModelRow::explicit(
    ExtendedMassSpring::NAME,
    "forces from squared edge lengths: explicit dynamics",
    &["st_venant_kirchhoff", "neo_hooke_log"],
    make,
);

fn make(body: &OrganBody, law: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let params = ExtendedMassSpringParams {
        body: body.dynamic(),
        law: match law.map(LawChoice::name) {
            Some("neo_hooke_log") => EdgeLaw::NeoHooke,
            _ => EdgeLaw::StVenantKirchhoff,
        },
        material: &body.material,
        viscosity_kg_per_m3_s: 0.0,
        integration: body.integration(),
    };
    Ok(Box::new(ExtendedMassSpring::build(&params).map_err(ModelError::of_numbers)?))
}
