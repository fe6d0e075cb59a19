//! Its row in the table of models.

use super::{TensorMass, TensorMassParams};
use crate::material::LawChoice;
use crate::model::explicit::Cuttable;
use crate::model::{DeformableModel, ModelError, ModelRow, OrganBody};

pub(crate) const ROW: ModelRow =
    ModelRow::explicit(TensorMass::NAME, "linear tensor-mass: explicit dynamics", &["linear"], make);

fn make(body: &OrganBody, _: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let params = TensorMassParams { body: body.dynamic(), material: &body.material };
    Ok(Box::new(TensorMass::build(&params).map_err(ModelError::of_numbers)?))
}
