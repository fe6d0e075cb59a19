//! Its row in the table of models: that of [`super::condensed`].

use super::NAME;
use super::condensed::{CondensedError, CondensedHybrid, CondensedParams, StoredNodes, Updated, ZoneLaw};
use crate::material::LawChoice;
use crate::model::organ_body::LARGEST_STRETCH;
use crate::model::{DeformableModel, FollowedEdits, ModelError, ModelMotion, ModelRow, OrganBody};
use glisson_mesh::math::Aabb;
use glisson_mesh::mesh::TetId;
use glisson_mesh::mesh::zones::Zones;

pub(crate) const ROW: ModelRow = ModelRow {
    motion: ModelMotion::Mixed,
    edits: FollowedEdits::All,
    ..ModelRow::quasi_static(
        NAME,
        "pre-computed zones and tensor-mass ones, coupled exactly",
        &["linear", "st_venant_kirchhoff"],
        make,
    )
};

/// Zones into which what no zone of the body has is cut across its longest axis: so much becomes dynamic with the first
/// cut there. A choice: more zones have more frontier to solve.
const REST_ZONES: usize = 4;

/// A zone without a tetrahedron of its own.
#[derive(Debug, thiserror::Error)]
#[error(
    "[[organ.zone]] number {number} has no tetrahedron: none has all its corners in the region and in no zone before it; \
     make the region larger or take it out"
)]
struct EmptyZone {
    /// Which one, from 1.
    number: usize,
}

fn make(body: &OrganBody, law: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let is_nonlinear_when_cut = law.map(LawChoice::name) == Some("st_venant_kirchhoff");
    // With that law it was looked at before.
    if !is_nonlinear_when_cut && body.zones.iter().any(|zone| zone.law == ZoneLaw::NonlinearTensorMass) {
        ROW.refuse_to_buckle(body)?;
    }
    let (of_tet, laws) = zones_of(body)?;
    let refused =
        |error: CondensedError| ModelError::of_tables("[simulation], [organ] or [[organ.zone]]", error);
    let zones = Zones::new(&body.mesh, of_tet).map_err(|error| refused(error.into()))?;
    let mut params = CondensedParams::new(body.dynamic(), &body.material, &zones, &laws);
    // Inner nodes are not seen; the factor gives their places.
    params.stored = StoredNodes::Surface;
    if is_nonlinear_when_cut {
        params.cut_law = ZoneLaw::NonlinearTensorMass;
    }
    params.largest_stretch = LARGEST_STRETCH;
    let mut model = CondensedHybrid::build(&params).map_err(refused)?;
    if body.inside_may_lag {
        model.set_updated(Updated::SurfaceFirst);
    }
    Ok(Box::new(model))
}

/// The zone of every tetrahedron, and the law of every zone.
fn zones_of(body: &OrganBody) -> Result<(Vec<u32>, Vec<ZoneLaw>), ModelError> {
    let mesh = &body.mesh;
    let n_tets = mesh.tetrahedra.len();
    let mut of_tet = vec![usize::MAX; n_tets];
    let mut laws: Vec<ZoneLaw> = Vec::new();
    for (z, zone) in body.zones.iter().enumerate() {
        let mut is_in = vec![false; mesh.positions_m.len()];
        zone.nodes.iter().for_each(|n| is_in[n.index()] = true);
        let is_free = |t: &usize| of_tet[*t] == usize::MAX;
        let own: Vec<usize> = (0..n_tets)
            .filter(is_free)
            .filter(|&t| mesh.tetrahedra[t].iter().all(|n| is_in[n.index()]))
            .collect();
        if own.is_empty() {
            return Err(ModelError::own(EmptyZone { number: z + 1 }));
        }
        own.into_iter().for_each(|t| of_tet[t] = z);
        laws.push(zone.law);
    }
    let bounds = Aabb::of_points(&mesh.positions_m);
    let longest = bounds.size_m().max_position();
    // Those of the rest that have tetrahedra, in their order.
    let mut rest: [Option<usize>; REST_ZONES] = [None; REST_ZONES];
    for t in 0..n_tets {
        if of_tet[t] == usize::MAX {
            let middle_m = mesh.corners_m(TetId::from_index(t)).iter().map(|p| p[longest]).sum::<f64>() / 4.0;
            let share = (middle_m - bounds.min_m[longest]) / bounds.size_m()[longest];
            let slice = ((share * REST_ZONES as f64) as usize).min(REST_ZONES - 1);
            of_tet[t] = *rest[slice].get_or_insert_with(|| {
                laws.push(ZoneLaw::Precomputed);
                laws.len() - 1
            });
        }
    }
    Ok((of_tet.into_iter().map(|z| z as u32).collect(), laws))
}
