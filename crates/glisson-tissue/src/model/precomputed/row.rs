//! Its row in the table of models.

use super::{
    NAME, Precision, Precomputed, PrecomputedError, PrecomputedExpectation, PrecomputedParams, StoredNodes,
};
use crate::material::LawChoice;
use crate::model::{DeformableModel, FollowedEdits, ModelError, ModelRow, OrganBody};
use glisson_mesh::progress::Teller;

pub(crate) const ROW: ModelRow = ModelRow {
    edits: FollowedEdits::Removals,
    make_as_cut: Some(make_as_cut),
    ..ModelRow::quasi_static(NAME, "linear elasticity through a pre-computed compliance", &["linear"], make)
};

fn make(body: &OrganBody, _: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let mut model = uncut(body, &ROW)?;
    // At the first cut it would hold up the simulation.
    model.prepare_cutting(&body.mesh).map_err(|error| ModelError::own(PrecomputedError::Solve(error)))?;
    Ok(Box::new(model))
}

/// Of a body that is not going to be cut, for the model of this row.
pub(in crate::model) fn uncut(body: &OrganBody, of: &ModelRow) -> Result<Precomputed, ModelError> {
    let (mesh, material, fixed_nodes) = (&body.mesh, &body.material, &of.nodes_fixed_wholly(body)?);
    let model = match &body.precomputed {
        Some(file) => Precomputed::load(file, &PrecomputedExpectation { mesh, material, fixed_nodes }),
        None => {
            let (stored, precision) = (StoredNodes::Surface, Precision::F64);
            let teller = Teller::here();
            let tell = |n_done: usize, n: usize| teller.tell(n_done as f64 / n as f64);
            let progress: Option<&(dyn Fn(usize, usize) + Sync)> = Some(&tell);
            let params = PrecomputedParams { mesh, material, fixed_nodes, stored, precision, progress };
            Precomputed::build(&params)
        }
    };
    Ok(under_gravity(model.map_err(ModelError::own)?, body))
}

fn make_as_cut(body: &OrganBody, live: &[bool]) -> Result<Box<dyn DeformableModel>, ModelError> {
    let (stored, precision) = match &body.precomputed {
        Some(file) => Precomputed::kept_in(file).map_err(ModelError::own)?,
        None => (StoredNodes::Surface, Precision::F64),
    };
    let params = PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &ROW.nodes_fixed_wholly(body)?,
        stored,
        precision,
        progress: None,
    };
    let model = Precomputed::build_cut(&params, live).map_err(ModelError::own)?;
    Ok(Box::new(under_gravity(model, body)))
}

fn under_gravity(mut model: Precomputed, body: &OrganBody) -> Precomputed {
    if body.is_imaged_under_gravity {
        model.carry_at_rest(body.gravity_m_per_s2);
    } else {
        model.set_gravity(body.gravity_m_per_s2);
    }
    model
}
