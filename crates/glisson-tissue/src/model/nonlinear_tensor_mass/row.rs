//! Its row in the table of models.

use super::{NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams};
use crate::material::LawChoice;
use crate::model::explicit::Cuttable;
use crate::model::organ_body::LARGEST_STRETCH;
use crate::model::{DeformableModel, ModelError, ModelRow, OrganBody};

pub(crate) const ROW: ModelRow = ModelRow {
    has_fibres: true,
    ..ModelRow::explicit(
        NonlinearTensorMass::NAME,
        "St Venant-Kirchhoff tensor-mass as in the papers, the reference: right under large rotations",
        &["st_venant_kirchhoff"],
        make,
    )
};

fn make(body: &OrganBody, _: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let elasticity = NonlinearElasticity {
        material: &body.material,
        fibres: &body.fibres(),
        volume_penalty_pa: body.volume_penalty_pa,
        largest_stretch: LARGEST_STRETCH,
    };
    let params = NonlinearTensorMassParams { body: body.dynamic(), elasticity };
    Ok(Box::new(NonlinearTensorMass::build(&params).map_err(ModelError::of_numbers)?))
}
