//! The laws of an implicit body.

use std::fmt;
use std::sync::Arc;

use super::ImplicitError;
use crate::material::{LinearElastic, Material, MaterialSpec, NeoHookeLog, StableNeoHooke};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::TetId;

/// A law that a body and its copies share.
pub type SharedLaw = Arc<dyn Material + Send + Sync>;

/// The law of an implicit body.
///
/// ```
/// use glisson_tissue::material::{LinearElastic, MaterialSpec, StableNeoHooke};
/// use glisson_tissue::model::implicit::ImplicitLaw;
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// assert!(matches!(ImplicitLaw::neo_hooke(&liver), ImplicitLaw::NeoHookeLog(_)));
/// let stable = MaterialSpec::from(StableNeoHooke::from(&liver));
/// assert!(matches!(ImplicitLaw::from(&stable), ImplicitLaw::StableNeoHooke(_)));
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone)]
pub enum ImplicitLaw {
    /// The ln J neo-Hookean law for all tetrahedra, eight at a time.
    NeoHookeLog(NeoHookeLog),
    /// The stable neo-Hookean law for all tetrahedra, eight at a time.
    StableNeoHooke(StableNeoHooke),
    /// Any law, one tetrahedron at a time: one for all, or one a tetrahedron.
    General(Vec<SharedLaw>),
}

impl ImplicitLaw {
    /// The fast ln J neo-Hookean law of Lame's coefficients.
    pub fn neo_hooke(linear: &LinearElastic) -> Self {
        Self::NeoHookeLog(NeoHookeLog::from(linear))
    }

    /// One law for all tetrahedra, computed one at a time whichever law it is.
    pub fn shared(law: impl Material + Send + 'static) -> Self {
        Self::General(vec![Arc::new(law)])
    }

    /// What stands in for each law where a tetrahedron is inside out: one, or one a tetrahedron.
    pub(super) fn stand_ins(&self, n_tets: usize) -> Result<Vec<StableNeoHooke>, ImplicitError> {
        let law_error = |number, [lambda_pa, mu_pa]: [f64; 2]| ImplicitError::NotStiffAtRest {
            tet: TetId::from_index(number),
            lambda_pa,
            mu_pa,
        };
        match self {
            Self::NeoHookeLog(law) => {
                let lame_pa = [law.lambda_pa(), law.mu_pa()];
                StableNeoHooke::new(lame_pa[0], lame_pa[1])
                    .map(|s| vec![s])
                    .map_err(|_| law_error(0, lame_pa))
            }
            Self::StableNeoHooke(law) => Ok(vec![*law]),
            Self::General(laws) => {
                if laws.len() != 1 && laws.len() != n_tets {
                    return Err(ImplicitError::LawCount { found: laws.len(), n_tets });
                }
                let stand_in = |(number, law): (usize, &SharedLaw)| {
                    let lame_pa = law.lame_at_rest_pa();
                    StableNeoHooke::new(lame_pa[0], lame_pa[1]).map_err(|_| law_error(number, lame_pa))
                };
                laws.iter().enumerate().map(stand_in).collect()
            }
        }
    }

    /// Largest lambda + 2 mu at rest [Pa].
    pub(super) fn modulus_pa(&self) -> f64 {
        match self {
            Self::NeoHookeLog(law) => law.lambda_pa() + 2.0 * law.mu_pa(),
            Self::StableNeoHooke(law) => law.lambda_pa() + 2.0 * law.mu_pa(),
            Self::General(laws) => laws
                .iter()
                .map(|law| law.lame_at_rest_pa())
                .map(|[lambda_pa, mu_pa]| lambda_pa + 2.0 * mu_pa)
                .fold(0.0, f64::max),
        }
    }

    /// The first law whose stress does not turn with the body: P(Q F) = Q P(F) fails for a quarter turn.
    pub(super) fn first_not_turning(&self) -> Option<usize> {
        let Self::General(laws) = self else { return None };
        let f = DMat3::from_cols(
            DVec3::new(1.01, 0.02, 0.0),
            DVec3::new(-0.01, 0.99, 0.03),
            DVec3::new(0.02, 0.0, 1.02),
        );
        let turn = DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z);
        laws.iter().position(|law| {
            let expected = turn * law.first_piola_pa(&f);
            let off = (law.first_piola_pa(&(turn * f)) - expected).to_cols_array();
            let size = expected.to_cols_array().into_iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            off.into_iter().any(|x| x.abs() > TURNING_TOLERANCE * size)
        })
    }
}

/// Far above rounding, far below the error of a law that is linear in the displacements.
const TURNING_TOLERANCE: f64 = 1e-6;

impl From<NeoHookeLog> for ImplicitLaw {
    fn from(law: NeoHookeLog) -> Self {
        Self::NeoHookeLog(law)
    }
}

impl From<StableNeoHooke> for ImplicitLaw {
    fn from(law: StableNeoHooke) -> Self {
        Self::StableNeoHooke(law)
    }
}

impl From<&MaterialSpec> for ImplicitLaw {
    fn from(spec: &MaterialSpec) -> Self {
        if let Some(law) = spec.as_law::<NeoHookeLog>() {
            Self::NeoHookeLog(*law)
        } else if let Some(law) = spec.as_law::<StableNeoHooke>() {
            Self::StableNeoHooke(*law)
        } else {
            Self::General(vec![spec.clone().into_shared()])
        }
    }
}

impl fmt::Debug for ImplicitLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NeoHookeLog(law) => law.fmt(f),
            Self::StableNeoHooke(law) => law.fmt(f),
            Self::General(laws) => write!(f, "General({} laws)", laws.len()),
        }
    }
}
