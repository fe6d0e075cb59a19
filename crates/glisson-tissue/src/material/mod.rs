//! Constitutive laws and tissue parameters.
//!
//! Every law implements [`Material`] and has its own file. [`LAWS`] is the table of those that scenes and
//! the command line know by name: a new law is a file and a line there (docs/extending.md). Loops over elements are generic in the law (`M: Material`), so that the law is chosen
//! outside the loop.

mod law;
mod named;
mod eigen;
pub mod principal;
pub mod check;
mod linear_elastic;
mod st_venant_kirchhoff;
mod neo_hooke_log;
mod stable_neo_hooke;
mod mooney_rivlin;
mod ogden;
mod holzapfel_gasser_ogden;
mod prony;
mod table;
pub mod tissues;

pub use eigen::eigen_symmetric;
pub(crate) use eigen::{SignedSingularValues, signed_singular_values};
pub use holzapfel_gasser_ogden::{HolzapfelGasserOgden, HolzapfelGasserOgdenParameters};
pub use law::{Material, Tangent, largest_tangent_eigenvalue_pa, projected};
pub(crate) use law::{cofactor, cofactor_differential, contraction};
pub use linear_elastic::{LinearElastic, MaterialError};
pub use mooney_rivlin::MooneyRivlin;
pub use named::{
    LawChoice, LawEntry, LawKey, LawKeyKind, LawTextError, MaterialSpec, NamedLaw, NumberRange, Typical,
};
pub use neo_hooke_log::NeoHookeLog;
pub use ogden::{Ogden, OgdenTerm};
pub use prony::{PronyHistory, PronySeries, PronyStep, PronyTerm};
pub use st_venant_kirchhoff::StVenantKirchhoff;
pub(crate) use st_venant_kirchhoff::{GuardedStVenantKirchhoff, SQUEEZED_J, squeeze_guard_pa};
pub use stable_neo_hooke::StableNeoHooke;
pub use table::{LAWS, every_law, law_named, law_names};
