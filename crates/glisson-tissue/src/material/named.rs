//! What a law tells about itself, so that scenes and the command line can read it: name, what it is, the parameters that
//! it needs beside the moduli of small strain, and how it is made from them.

use super::{LinearElastic, Material, MaterialError};
use glisson_mesh::math::DVec3;
use glisson_mesh::units::{Dimension, UnitError, parse_quantity};
use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// A law that has a name.
#[derive(Debug)]
pub struct LawEntry {
    /// As scenes write it.
    pub name: &'static str,
    /// What it is, in a few words.
    pub about: &'static str,
    /// Where its formula stands: authors, year and DOI, or the seed.
    pub source: &'static str,
    /// What it needs beside the moduli of small strain.
    pub keys: &'static [LawKey],
    /// How a scene writes it, for messages; empty for a law without keys.
    pub example: &'static str,
    /// Makes the law that has the moduli of the linear one at small strain (a fibre law: without its fibres).
    pub make: fn(&LinearElastic, &LawChoice) -> Result<MaterialSpec, MaterialError>,
}

/// A parameter of a law.
#[derive(Debug)]
pub struct LawKey {
    /// As scenes write it.
    pub name: &'static str,
    /// What it means.
    pub about: &'static str,
    /// What kind of value it is.
    pub kind: LawKeyKind,
    /// Which numbers it may be, in SI; [`NumberRange::ANY`] for directions.
    pub range: NumberRange,
    /// A value to try the law with, for tests and validation.
    pub typical: Typical,
}

/// Which numbers a parameter may be. The law's constructor checks with the same one.
#[derive(Clone, Copy)]
pub struct NumberRange {
    /// In words, for messages.
    pub allowed: &'static str,
    /// Whether a number is one of them.
    pub holds: fn(f64) -> bool,
}

impl NumberRange {
    /// Every number.
    pub const ANY: Self = Self { allowed: "any number", holds: |_| true };
    /// Every finite number above 0.
    pub const ABOVE_ZERO: Self =
        Self { allowed: "a finite number above 0", holds: |x| x.is_finite() && x > 0.0 };

    /// Refuses a number that is not one of them; `law` is the law's name, `name` the parameter's.
    ///
    /// # Errors
    /// [`MaterialError::Parameter`].
    pub fn check(&self, law: &'static str, name: &'static str, found: f64) -> Result<(), MaterialError> {
        if (self.holds)(found) {
            return Ok(());
        }
        Err(MaterialError::Parameter { law, name, found, allowed: self.allowed })
    }
}

impl fmt::Debug for NumberRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.allowed)
    }
}

/// A value to try a law with.
#[derive(Clone, Copy, Debug)]
pub enum Typical {
    /// A number, in SI.
    Number(f64),
    /// Directions.
    Directions(&'static [DVec3]),
}

/// Kinds of parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LawKeyKind {
    /// A number without unit; the default, if it may be left out.
    Number(Option<f64>),
    /// A quantity above zero.
    Positive(Dimension),
    /// A direction, of any length but zero; at least one.
    Directions,
}

/// A law by name with its own parameters: what scenes and the command line give.
///
/// ```
/// use glisson_tissue::material::{LinearElastic, law_named};
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let ogden = law_named("ogden").unwrap().with_number("exponent", -4.7);
/// assert_eq!(ogden.with_moduli_of(&liver)?.name(), "ogden");
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone)]
pub struct LawChoice {
    entry: &'static LawEntry,
    numbers: Vec<(&'static str, f64)>,
    directions: Vec<DVec3>,
}

/// A parameter of a law that cannot be taken from texts; says why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LawTextError {
    /// The law has no such parameter.
    #[error("the law {law} has no parameter {found}; allowed: {allowed}")]
    Unknown {
        /// Which law.
        law: &'static str,
        /// What was given.
        found: String,
        /// Its parameters.
        allowed: String,
    },
    /// A value that is no number.
    #[error("`{0}` is not a number")]
    NotANumber(String),
    /// A value that is no quantity of the parameter's dimension.
    #[error(transparent)]
    Quantity(#[from] UnitError),
    /// A value that is no direction.
    #[error("`{0}` is not x,y,z: three numbers with commas")]
    NotADirection(String),
    /// A number outside the parameter's range.
    #[error("allowed: {0}")]
    OutOfRange(&'static str),
}

fn parse_direction(text: &str) -> Result<DVec3, LawTextError> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|field| field.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err(LawTextError::NotADirection(text.to_owned())),
    }
}

impl LawChoice {
    /// A law with the defaults of its parameters.
    pub fn of(entry: &'static LawEntry) -> Self {
        let defaults = entry.keys.iter().filter_map(|key| match key.kind {
            LawKeyKind::Number(default) => Some((key.name, default?)),
            LawKeyKind::Positive(_) | LawKeyKind::Directions => None,
        });
        Self { entry, numbers: defaults.collect(), directions: Vec::new() }
    }

    /// A law with values to try it with: for tests and validation, which go through the whole table.
    pub fn typical(entry: &'static LawEntry) -> Self {
        entry.keys.iter().fold(Self::of(entry), |law, key| match key.typical {
            Typical::Number(number) => law.with_number(key.name, number),
            Typical::Directions(directions) => directions.iter().copied().fold(law, Self::with_direction),
        })
    }

    /// Its line in the table.
    pub fn entry(&self) -> &'static LawEntry {
        self.entry
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.entry.name
    }

    /// The same with this value of a parameter, in SI.
    #[must_use]
    pub fn with_number(mut self, key: &'static str, value: f64) -> Self {
        self.numbers.retain(|(name, _)| *name != key);
        self.numbers.push((key, value));
        self
    }

    /// The same with one more direction.
    #[must_use]
    pub fn with_direction(mut self, direction: DVec3) -> Self {
        self.directions.push(direction);
        self
    }

    /// The same with a parameter as texts give it: `exponent` and `-4.7`, `k1` and `20 kPa`, `fibre` and `1,0,0` (again for a second
    /// family).
    ///
    /// # Errors
    /// [`LawTextError`]: a parameter that the law has not, or a value that is none of it.
    pub fn with_text(self, name: &str, value: &str) -> Result<Self, LawTextError> {
        let keys = self.entry.keys;
        let key = keys.iter().find(|key| key.name == name).ok_or_else(|| {
            let allowed: Vec<&str> = keys.iter().map(|key| key.name).collect();
            let allowed = if allowed.is_empty() { "none".to_owned() } else { allowed.join(", ") };
            LawTextError::Unknown { law: self.entry.name, found: name.to_owned(), allowed }
        })?;
        let number = match key.kind {
            LawKeyKind::Number(_) => value.parse().map_err(|_| LawTextError::NotANumber(value.to_owned()))?,
            LawKeyKind::Positive(dimension) => parse_quantity(value, dimension)?,
            LawKeyKind::Directions => return Ok(self.with_direction(parse_direction(value)?)),
        };
        if !(key.range.holds)(number) {
            return Err(LawTextError::OutOfRange(key.range.allowed));
        }
        Ok(self.with_number(key.name, number))
    }

    /// The value of a parameter, in SI; no number where it was not given.
    pub fn number(&self, key: &str) -> f64 {
        self.numbers.iter().find(|(name, _)| *name == key).map_or(f64::NAN, |(_, value)| *value)
    }

    /// The directions.
    pub fn directions(&self) -> &[DVec3] {
        &self.directions
    }

    /// The first parameter that is needed and was not given.
    pub fn missing(&self) -> Option<&'static LawKey> {
        let is_given = |key: &LawKey| match key.kind {
            LawKeyKind::Directions => !self.directions.is_empty(),
            LawKeyKind::Number(_) | LawKeyKind::Positive(_) => !self.number(key.name).is_nan(),
        };
        self.entry.keys.iter().find(|key| !is_given(key))
    }

    /// The law that has the moduli of `linear` at small strain (a fibre law: without its fibres).
    ///
    /// # Errors
    /// [`MaterialError`] for parameters outside the law's range.
    pub fn with_moduli_of(&self, linear: &LinearElastic) -> Result<MaterialSpec, MaterialError> {
        (self.entry.make)(linear, self)
    }
}

impl PartialEq for LawChoice {
    fn eq(&self, other: &Self) -> bool {
        let has_same = |key: &LawKey| self.number(key.name).to_bits() == other.number(key.name).to_bits();
        self.name() == other.name()
            && self.directions == other.directions
            && self.entry.keys.iter().all(has_same)
    }
}

impl fmt::Debug for LawChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {:?} {:?}", self.name(), self.numbers, self.directions)
    }
}

/// A law of the table.
pub trait NamedLaw: Material + Send + Sync + 'static {
    /// Its line.
    const ENTRY: &'static LawEntry;
}

/// A law with its parameters and its name, shared between threads.
///
/// ```
/// use glisson_tissue::material::{LinearElastic, MaterialSpec, StableNeoHooke};
/// use glisson_mesh::math::DMat3;
/// let liver = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0)?;
/// let spec = MaterialSpec::from(StableNeoHooke::from(&liver));
/// assert_eq!(spec.name(), "stable_neo_hooke");
/// assert!(spec.material().energy_density_j_per_m3(&(DMat3::IDENTITY * 1.1)) > 0.0);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone)]
pub struct MaterialSpec {
    entry: &'static LawEntry,
    law: Arc<dyn Material + Send + Sync>,
    /// The same, to find out which.
    any: Arc<dyn Any + Send + Sync>,
}

impl<M: NamedLaw> From<M> for MaterialSpec {
    fn from(law: M) -> Self {
        let law = Arc::new(law);
        Self { entry: M::ENTRY, any: Arc::<M>::clone(&law), law }
    }
}

impl MaterialSpec {
    /// Its name.
    pub fn name(&self) -> &'static str {
        self.entry.name
    }

    /// The law, to be shared between threads.
    pub fn into_shared(self) -> Arc<dyn Material + Send + Sync> {
        self.law
    }

    /// The law itself, for code that is not generic.
    pub fn material(&self) -> &dyn Material {
        &*self.law
    }

    /// The law itself where it is this one: for code that is faster for it.
    pub fn as_law<M: NamedLaw>(&self) -> Option<&M> {
        self.any.downcast_ref()
    }
}

impl fmt::Debug for MaterialSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::law_named;

    #[test]
    fn parameters_come_from_texts() {
        let fibres = || law_named("holzapfel_gasser_ogden").unwrap();
        let law = fibres().with_text("k1", "20 kPa").unwrap().with_text("fibre", "1, -2,0.5").unwrap();
        assert_eq!((law.number("k1"), law.directions()), (20e3, &[DVec3::new(1.0, -2.0, 0.5)][..]));
        for (name, value, words) in [
            ("alpha", "2", "has no parameter alpha; allowed: "),
            ("k2", "much", "`much` is not a number"),
            ("k1", "20", "20"),
            ("k1", "-1 kPa", "allowed: "),
            ("fibre", "1,2", "`1,2` is not x,y,z"),
            ("fibre", "1,2,x", "`1,2,x` is not x,y,z"),
        ] {
            let error = fibres().with_text(name, value).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
