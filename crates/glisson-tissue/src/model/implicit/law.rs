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
    /// The ln J neo-Hookean law with numbers for each tetrahedron, eight at a time.
    NeoHookeLogOfEach(Vec<NeoHookeLog>),
    /// The stable neo-Hookean law with numbers for each tetrahedron, eight at a time.
    StableNeoHookeOfEach(Vec<StableNeoHooke>),
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

    /// These laws of each tetrahedron, eight at a time where they can be.
    pub(super) fn of_each(laws: Vec<MaterialSpec>) -> Self {
        if let Some(logs) = laws.iter().map(|law| law.as_law().copied()).collect() {
            Self::NeoHookeLogOfEach(logs)
        } else if let Some(stables) = laws.iter().map(|law| law.as_law().copied()).collect() {
            Self::StableNeoHookeOfEach(stables)
        } else {
            Self::General(laws.into_iter().map(MaterialSpec::into_shared).collect())
        }
    }

    /// What stands in for each law where a tetrahedron is inside out: one, or one a tetrahedron.
    pub(super) fn stand_ins(&self, n_tets: usize) -> Result<Vec<StableNeoHooke>, ImplicitError> {
        let law_error = |number, [lambda_pa, mu_pa]: [f64; 2]| ImplicitError::NotStiffAtRest {
            tet: TetId::from_index(number),
            lambda_pa,
            mu_pa,
        };
        let stand_in = |(number, lame_pa): (usize, [f64; 2])| {
            StableNeoHooke::new(lame_pa[0], lame_pa[1]).map_err(|_| law_error(number, lame_pa))
        };
        let n_laws = self.n_laws();
        if n_laws != 1 && n_laws != n_tets {
            return Err(ImplicitError::LawCount { found: n_laws, n_tets });
        }
        match self {
            Self::StableNeoHooke(law) => Ok(vec![*law]),
            Self::StableNeoHookeOfEach(laws) => Ok(laws.clone()),
            Self::NeoHookeLog(_) | Self::NeoHookeLogOfEach(_) | Self::General(_) => {
                self.lame_at_rest_pa().enumerate().map(stand_in).collect()
            }
        }
    }

    fn n_laws(&self) -> usize {
        match self {
            Self::NeoHookeLog(_) | Self::StableNeoHooke(_) => 1,
            Self::NeoHookeLogOfEach(laws) => laws.len(),
            Self::StableNeoHookeOfEach(laws) => laws.len(),
            Self::General(laws) => laws.len(),
        }
    }

    /// The law of a tetrahedron.
    pub(super) fn of_tet(&self, tet: usize) -> &dyn Material {
        match self {
            Self::NeoHookeLog(law) => law,
            Self::StableNeoHooke(law) => law,
            Self::NeoHookeLogOfEach(laws) => &laws[tet],
            Self::StableNeoHookeOfEach(laws) => &laws[tet],
            Self::General(laws) => &*laws[if laws.len() == 1 { 0 } else { tet }],
        }
    }

    /// Lame's coefficients at rest of each law [Pa].
    fn lame_at_rest_pa(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        (0..self.n_laws()).map(|number| match self {
            Self::NeoHookeLog(law) => [law.lambda_pa(), law.mu_pa()],
            Self::StableNeoHooke(law) => [law.lambda_pa(), law.mu_pa()],
            Self::NeoHookeLogOfEach(laws) => [laws[number].lambda_pa(), laws[number].mu_pa()],
            Self::StableNeoHookeOfEach(laws) => [laws[number].lambda_pa(), laws[number].mu_pa()],
            Self::General(laws) => laws[number].lame_at_rest_pa(),
        })
    }

    /// Largest lambda + 2 mu at rest [Pa].
    pub(super) fn modulus_pa(&self) -> f64 {
        self.lame_at_rest_pa().map(|[lambda_pa, mu_pa]| lambda_pa + 2.0 * mu_pa).fold(0.0, f64::max)
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
            Self::NeoHookeLogOfEach(laws) => write!(f, "NeoHookeLogOfEach({} laws)", laws.len()),
            Self::StableNeoHookeOfEach(laws) => write!(f, "StableNeoHookeOfEach({} laws)", laws.len()),
            Self::General(laws) => write!(f, "General({} laws)", laws.len()),
        }
    }
}
