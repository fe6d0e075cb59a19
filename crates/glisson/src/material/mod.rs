//! Constitutive laws and tissue parameters.

mod linear_elastic;
pub mod tissues;

pub use linear_elastic::{LinearElastic, MaterialError};
