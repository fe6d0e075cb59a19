//! The table of the laws that scenes and the command line know: one line a law.
//!
//! A law's own file has its [`LawEntry`]. Whoever reads laws (scenes, `glisson solve`, tests) goes through this table.

use super::{
    LawChoice, LawEntry, LinearElastic, MaterialError, MaterialSpec, holzapfel_gasser_ogden, linear_elastic,
    mooney_rivlin, neo_hooke_log, ogden, st_venant_kirchhoff, stable_neo_hooke,
};

/// Every law, in the order in which they are listed to people.
pub static LAWS: [&LawEntry; 7] = [
    &linear_elastic::LAW,
    &st_venant_kirchhoff::LAW,
    &neo_hooke_log::LAW,
    &stable_neo_hooke::LAW,
    &mooney_rivlin::LAW,
    &ogden::LAW,
    &holzapfel_gasser_ogden::LAW,
];

/// The law of this name, with the defaults of its parameters; none for another name.
pub fn law_named(name: &str) -> Option<LawChoice> {
    LAWS.iter().find(|entry| entry.name == name).map(|entry| LawChoice::of(entry))
}

/// The names of all laws, as scenes write them.
pub fn law_names() -> impl Iterator<Item = &'static str> {
    LAWS.iter().map(|entry| entry.name)
}

/// Every law of the table with values to try it with and the moduli of `linear` at small strain (a fibre law: without its
/// fibres): for tests and validation.
///
/// # Errors
/// [`MaterialError`] where the moduli are out of a law's range.
pub fn every_law(linear: &LinearElastic) -> Result<Vec<MaterialSpec>, MaterialError> {
    LAWS.iter().map(|entry| LawChoice::typical(entry).with_moduli_of(linear)).collect()
}
