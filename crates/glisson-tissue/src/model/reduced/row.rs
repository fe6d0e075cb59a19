//! Its row in the table of models.

use super::{NAME, Reduced, ReducedParams};
use crate::material::LawChoice;
use crate::model::{DeformableModel, ModelError, ModelRow, OrganBody};

pub(crate) const ROW: ModelRow = ModelRow::quasi_static(
    NAME,
    "St Venant-Kirchhoff in reduced coordinates: right under bending and turning",
    &["st_venant_kirchhoff"],
    make,
);

fn make(body: &OrganBody, _: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    ROW.refuse_ligaments(body)?;
    let params = ReducedParams::new(&body.mesh, &body.material, &body.fixed);
    let mut model = Reduced::build(&params).map_err(ModelError::own)?;
    if body.is_imaged_under_gravity {
        model.carry_at_rest(body.gravity_m_per_s2);
    } else {
        model.set_gravity(body.gravity_m_per_s2);
    }
    Ok(Box::new(model))
}
