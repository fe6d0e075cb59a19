//! Reading TOML tables key by key, with the line in every error.

use crate::math::DVec3;
use crate::text::{closest_name, did_you_mean};
use crate::units::{Dimension, UnitError, parse_quantity};
use std::collections::BTreeMap;
use std::ops::{Range, RangeInclusive};
use std::rc::Rc;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

/// What is wrong with a scene, and on which line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct SceneError {
    /// From 1.
    pub line: usize,
    /// What.
    pub problem: SceneProblem,
}

/// What can be wrong with a scene.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SceneProblem {
    /// Not TOML.
    #[error("{0}")]
    Syntax(String),
    /// A key that means nothing here.
    #[error("unknown key \"{key}\" in {section} (allowed: {allowed}){suggestion}")]
    UnknownKey {
        /// As found.
        key: String,
        /// Where.
        section: String,
        /// What may stand there.
        allowed: String,
        /// `; did you mean ...` or nothing.
        suggestion: String,
    },
    /// A key that has to be there.
    #[error("{section} lacks \"{key}\"; write for example {example}")]
    Missing {
        /// Which.
        key: &'static str,
        /// Where.
        section: String,
        /// A line that would be right.
        example: &'static str,
    },
    /// A value of another kind.
    #[error("\"{key}\" is {found}; expected {expected}")]
    WrongType {
        /// Which.
        key: String,
        /// What stands there.
        found: String,
        /// What should.
        expected: String,
    },
    /// Not a quantity of this dimension.
    #[error("\"{key}\": {error}")]
    Unit {
        /// Which.
        key: String,
        /// Why.
        error: UnitError,
    },
    /// A value out of its range, or a name that does not exist.
    #[error("\"{key}\" is {found}; allowed: {allowed}")]
    Value {
        /// Which.
        key: String,
        /// What stands there.
        found: String,
        /// What may.
        allowed: String,
    },
}

/// A table that is being read: what nobody asked for is an error at the end.
pub(crate) struct Section<'a> {
    text: &'a str,
    name: String,
    table: &'a DeTable<'a>,
    span: Range<usize>,
    asked: Vec<&'static str>,
    places: Rc<Places>,
}

/// Points [m] that other points of the scene may be given by.
pub(crate) type Places = BTreeMap<String, DVec3>;

/// A value in its place.
pub(crate) type Value<'a> = &'a Spanned<DeValue<'a>>;

/// The line (from 1) of byte `at`.
fn line_of(text: &str, at: usize) -> usize {
    text.bytes().take(at).filter(|&b| b == b'\n').count() + 1
}

/// The document as TOML.
pub(crate) fn parse_toml(text: &str) -> Result<Spanned<DeTable<'_>>, SceneError> {
    DeTable::parse(text).map_err(|error| SceneError {
        line: error.span().map_or(1, |s| line_of(text, s.start)),
        problem: SceneProblem::Syntax(error.message().to_string()),
    })
}

impl<'a> Section<'a> {
    pub(crate) fn root(text: &'a str, document: &'a Spanned<DeTable<'a>>) -> Self {
        let (name, table, span) = ("the scene".to_string(), document.get_ref(), 0..0);
        Self { text, name, table, span, asked: Vec::new(), places: Rc::default() }
    }

    /// From now on points may be given by these names.
    pub(crate) fn know_places(&mut self, places: Places) {
        self.places = Rc::new(places);
    }

    fn error(&self, span: &Range<usize>, problem: SceneProblem) -> SceneError {
        SceneError { line: line_of(self.text, span.start), problem }
    }

    /// An error at `value`.
    pub(crate) fn wrong_value(
        &self,
        value: Value<'_>,
        key: &str,
        found: String,
        allowed: &str,
    ) -> SceneError {
        let problem = SceneProblem::Value { key: key.into(), found, allowed: allowed.into() };
        self.error(&value.span(), problem)
    }

    /// An error of the whole table.
    pub(crate) fn wrong_table(&self, key: &str, found: String, allowed: String) -> SceneError {
        self.error(&self.span, SceneProblem::Value { key: key.into(), found, allowed })
    }

    fn wrong_type(&self, value: Value<'_>, key: &str, expected: &str) -> SceneError {
        let found = format!("a {}", value.get_ref().type_str());
        let problem = SceneProblem::WrongType { key: key.into(), found, expected: expected.into() };
        self.error(&value.span(), problem)
    }

    /// The value of `key`, if it is there.
    pub(crate) fn get(&mut self, key: &'static str) -> Option<Value<'a>> {
        self.asked.push(key);
        self.table.get(key)
    }

    /// The error for a key that has to be there, or for the mistyped key that stands in its place.
    pub(crate) fn missing(&self, key: &'static str, example: &'static str) -> SceneError {
        self.missing_one_of(&[key], example)
    }

    /// The same where one of several keys has to be there; told is the first.
    pub(crate) fn missing_one_of(&self, keys: &[&'static str], example: &'static str) -> SceneError {
        let mistyped = self.table.iter().find(|(found, _)| {
            let found: &str = found.get_ref();
            !self.asked.contains(&found) && closest_name(found, keys).is_some()
        });
        match mistyped {
            Some((found, _)) => self.unknown(found),
            None => {
                let (key, section) = (keys[0], self.name.clone());
                self.error(&self.span, SceneProblem::Missing { key, section, example })
            }
        }
    }

    fn unknown(&self, key: &Spanned<DeString<'_>>) -> SceneError {
        let problem = SceneProblem::UnknownKey {
            key: key.get_ref().to_string(),
            section: self.name.clone(),
            allowed: self.asked.join(", "),
            suggestion: did_you_mean(key.get_ref(), &self.asked),
        };
        self.error(&key.span(), problem)
    }

    pub(crate) fn string(&mut self, key: &'static str) -> Result<Option<(String, Value<'a>)>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match value.get_ref().as_str() {
            Some(text) => Ok(Some((text.to_string(), value))),
            None => Err(self.wrong_type(value, key, "a text in quotes")),
        }
    }

    pub(crate) fn number_of(&self, key: &str, value: Value<'_>) -> Result<f64, SceneError> {
        let text = match value.get_ref() {
            DeValue::Float(f) => f.as_str().to_string(),
            DeValue::Integer(i) => i.as_str().to_string(),
            _ => return Err(self.wrong_type(value, key, "a number")),
        };
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.wrong_value(value, key, text, "a finite decimal number")),
        }
    }

    pub(crate) fn number(&mut self, key: &'static str) -> Result<Option<(f64, Value<'a>)>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        Ok(Some((self.number_of(key, value)?, value)))
    }

    fn quantity_of(&self, key: &str, value: Value<'_>, dimension: Dimension) -> Result<f64, SceneError> {
        let unit_error = |error| {
            let problem = SceneProblem::Unit { key: key.into(), error };
            self.error(&value.span(), problem)
        };
        match value.get_ref() {
            DeValue::String(text) => parse_quantity(text, dimension).map_err(unit_error),
            DeValue::Float(f) => parse_quantity(f.as_str(), dimension).map_err(unit_error),
            DeValue::Integer(i) => parse_quantity(i.as_str(), dimension).map_err(unit_error),
            _ => Err(self.wrong_type(value, key, "a text with a number and its unit, such as \"5 mm\"")),
        }
    }

    pub(crate) fn quantity(
        &mut self,
        key: &'static str,
        dimension: Dimension,
    ) -> Result<Option<(f64, Value<'a>)>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        Ok(Some((self.quantity_of(key, value, dimension)?, value)))
    }

    /// A quantity above zero.
    pub(crate) fn positive(
        &mut self,
        key: &'static str,
        dimension: Dimension,
    ) -> Result<Option<f64>, SceneError> {
        match self.quantity(key, dimension)? {
            Some((quantity, value)) if quantity <= 0.0 => {
                let unit = dimension.units()[0].0;
                Err(self.wrong_value(value, key, format!("{quantity} {unit}"), "more than zero"))
            }
            found => Ok(found.map(|f| f.0)),
        }
    }

    fn three(&self, key: &str, value: Value<'a>) -> Result<[Value<'a>; 3], SceneError> {
        match value.get_ref().as_array().map(|array| &**array) {
            Some([x, y, z]) => Ok([x, y, z]),
            _ => Err(self.wrong_type(value, key, "a list of three")),
        }
    }

    /// Three lengths, the name of a place, or a place with three lengths beside it: `{ place, plus }`.
    pub(crate) fn point(&mut self, key: &'static str) -> Result<Option<DVec3>, SceneError> {
        self.get(key).map(|value| self.point_of(key, value)).transpose()
    }

    fn point_of(&self, key: &'static str, value: Value<'a>) -> Result<DVec3, SceneError> {
        if let Some(name) = value.get_ref().as_str() {
            return self.place_named(key, name, value);
        }
        if !value.get_ref().is_table() {
            return self.vector_of(key, value, Dimension::Length);
        }
        let mut table = self.section_of(format!("[{key}]"), key, value)?;
        let (name, at) =
            table.string("place")?.ok_or_else(|| table.missing("place", "place = \"nodule\""))?;
        let place_m = table.place_named("place", &name, at)?;
        let plus_m = table.vector("plus", Dimension::Length)?.unwrap_or(DVec3::ZERO);
        table.finish()?;
        Ok(place_m + plus_m)
    }

    /// A list of such points.
    pub(crate) fn points(
        &mut self,
        key: &'static str,
        example: &'static str,
    ) -> Result<Option<Vec<DVec3>>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let list = value.get_ref().as_array().ok_or_else(|| self.wrong_type(value, key, example))?;
        list.iter().map(|point| self.point_of(key, point)).collect::<Result<_, _>>().map(Some)
    }

    fn place_named(&self, key: &str, name: &str, at: Value<'_>) -> Result<DVec3, SceneError> {
        self.places.get(name).copied().ok_or_else(|| {
            let names: Vec<&str> = self.places.keys().map(String::as_str).collect();
            let known = if names.is_empty() { "none".into() } else { names.join(", ") };
            let allowed =
                format!("three lengths, or a [[place]] of the scene: {known}{}", did_you_mean(name, &names));
            self.wrong_value(at, key, format!("\"{name}\""), &allowed)
        })
    }

    /// Three lengths that have to be there.
    pub(crate) fn required_point(
        &mut self,
        key: &'static str,
        example: &'static str,
    ) -> Result<DVec3, SceneError> {
        self.point(key)?.ok_or_else(|| self.missing(key, example))
    }

    /// A length above zero that has to be there.
    pub(crate) fn required_length(
        &mut self,
        key: &'static str,
        example: &'static str,
    ) -> Result<f64, SceneError> {
        self.positive(key, Dimension::Length)?.ok_or_else(|| self.missing(key, example))
    }

    /// A whole number in a range.
    pub(crate) fn whole_number(
        &mut self,
        key: &'static str,
        allowed: RangeInclusive<u64>,
    ) -> Result<Option<u64>, SceneError> {
        match self.number(key)? {
            None => Ok(None),
            Some((n, _)) if n.fract() == 0.0 && n >= 0.0 && allowed.contains(&(n as u64)) => {
                Ok(Some(n as u64))
            }
            Some((n, at)) => {
                let allowed = format!("a whole number from {} to {}", allowed.start(), allowed.end());
                Err(self.wrong_value(at, key, n.to_string(), &allowed))
            }
        }
    }

    /// A list of whole numbers.
    pub(crate) fn whole_numbers(
        &mut self,
        key: &'static str,
        allowed: RangeInclusive<u64>,
    ) -> Result<Option<Vec<u64>>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let wrong = || self.wrong_type(value, key, "a list of whole numbers");
        let list = value.get_ref().as_array().ok_or_else(wrong)?;
        let each = |item: Value<'a>| {
            let n = self.number_of(key, item)?;
            if n.fract() == 0.0 && n >= 0.0 && allowed.contains(&(n as u64)) {
                return Ok(n as u64);
            }
            let range = format!("whole numbers from {} to {}", allowed.start(), allowed.end());
            Err(self.wrong_value(item, key, n.to_string(), &range))
        };
        list.iter().map(each).collect::<Result<_, _>>().map(Some)
    }

    /// A list of texts.
    pub(crate) fn strings(
        &mut self,
        key: &'static str,
    ) -> Result<Option<(Vec<String>, Value<'a>)>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let wrong = || self.wrong_type(value, key, "a list of texts in quotes");
        let list = value.get_ref().as_array().ok_or_else(wrong)?;
        let texts = list.iter().map(|item| item.get_ref().as_str().map(str::to_owned).ok_or_else(wrong));
        Ok(Some((texts.collect::<Result<_, _>>()?, value)))
    }

    /// Three quantities of one dimension.
    pub(crate) fn vector(
        &mut self,
        key: &'static str,
        dimension: Dimension,
    ) -> Result<Option<DVec3>, SceneError> {
        self.get(key).map(|value| self.vector_of(key, value, dimension)).transpose()
    }

    fn vector_of(&self, key: &str, value: Value<'a>, dimension: Dimension) -> Result<DVec3, SceneError> {
        let [x, y, z] = self.three(key, value)?;
        Ok(DVec3::new(
            self.quantity_of(key, x, dimension)?,
            self.quantity_of(key, y, dimension)?,
            self.quantity_of(key, z, dimension)?,
        ))
    }

    /// A list of lists of so many lengths each, `example` of them.
    pub(crate) fn lengths(
        &mut self,
        key: &'static str,
        (n_each, example): (RangeInclusive<usize>, &'static str),
    ) -> Result<Option<Vec<Vec<f64>>>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let wrong = |value| self.wrong_type(value, key, example);
        let list = value.get_ref().as_array().ok_or_else(|| wrong(value))?;
        let each = |item: Value<'a>| {
            let lengths = item.get_ref().as_array().filter(|lengths| n_each.contains(&lengths.len()));
            let lengths = lengths.ok_or_else(|| wrong(item))?.iter();
            lengths.map(|length| self.quantity_of(key, length, Dimension::Length)).collect()
        };
        list.iter().map(each).collect::<Result<_, _>>().map(Some)
    }

    /// A truth value.
    pub(crate) fn flag(&mut self, key: &'static str) -> Result<Option<bool>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match value.get_ref() {
            DeValue::Boolean(flag) => Ok(Some(*flag)),
            _ => Err(self.wrong_type(value, key, "true or false")),
        }
    }

    /// Names out of a closed list.
    pub(crate) fn names(
        &mut self,
        key: &'static str,
        allowed: &[&'static str],
    ) -> Result<Option<Vec<&'static str>>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let Some(array) = value.get_ref().as_array() else {
            return Err(self.wrong_type(value, key, "a list of names"));
        };
        if array.is_empty() {
            return Err(self.wrong_value(value, key, "an empty list".into(), &allowed.join(", ")));
        }
        let name = |item: Value<'a>| {
            let found = item.get_ref().as_str().unwrap_or_default();
            allowed
                .iter()
                .copied()
                .find(|name| *name == found)
                .ok_or_else(|| self.wrong_value(item, key, format!("\"{found}\""), &allowed.join(", ")))
        };
        array.iter().map(name).collect::<Result<_, _>>().map(Some)
    }

    /// The value at a path of tables, of lists of tables the first; nothing of it counts as asked for.
    pub(crate) fn value_at(&self, path: &[&str]) -> Option<Value<'a>> {
        let (first, rest) = path.split_first()?;
        rest.iter().try_fold(self.table.get(*first)?, |value, key| {
            let table = value.get_ref().as_array().map_or(value, |list| list.first().unwrap_or(value));
            table.get_ref().as_table()?.get(*key)
        })
    }

    /// All values at a path of tables and lists of tables.
    pub(crate) fn values_at(&self, path: &[&str]) -> Vec<Value<'a>> {
        let Some((first, rest)) = path.split_first() else { return Vec::new() };
        let all_of = |value: Value<'a>| match value.get_ref().as_array() {
            Some(list) => list.iter().collect(),
            None => vec![value],
        };
        let mut found: Vec<Value<'a>> = self.table.get(*first).into_iter().collect();
        for key in rest {
            let tables = found.into_iter().flat_map(all_of);
            found = tables.filter_map(|table| table.get_ref().as_table()?.get(*key)).collect();
        }
        found
    }

    /// Whether `key` is there; it still has to be asked for.
    pub(crate) fn has(&self, key: &str) -> bool {
        self.table.get(key).is_some()
    }

    /// Whether `key` holds a table.
    pub(crate) fn is_table(&self, key: &str) -> bool {
        self.table.get(key).is_some_and(|value| value.get_ref().is_table())
    }
    /// Three plain numbers, not all zero, as a unit vector.
    pub(crate) fn direction(&mut self, key: &'static str) -> Result<Option<DVec3>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        let [x, y, z] = self.three(key, value)?;
        let direction = DVec3::new(self.number_of(key, x)?, self.number_of(key, y)?, self.number_of(key, z)?);
        direction.try_normalize().map(Some).ok_or_else(|| {
            self.wrong_value(value, key, direction.to_string(), "three numbers that are not all zero")
        })
    }

    /// The table `key`.
    pub(crate) fn section(&mut self, key: &'static str) -> Result<Option<Section<'a>>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        self.section_of(format!("[{key}]"), key, value).map(Some)
    }

    fn section_of(&self, name: String, key: &str, value: Value<'a>) -> Result<Section<'a>, SceneError> {
        match value.get_ref().as_table() {
            Some(table) => Ok(Section {
                text: self.text,
                name,
                table,
                span: value.span(),
                asked: Vec::new(),
                places: Rc::clone(&self.places),
            }),
            None => Err(self.wrong_type(value, key, "a table")),
        }
    }

    /// The tables of `[[key]]`, none if it is not there.
    pub(crate) fn sections(&mut self, key: &'static str) -> Result<Vec<Section<'a>>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(Vec::new()) };
        let Some(array) = value.get_ref().as_array() else {
            return Err(self.wrong_type(value, key, "a list of tables"));
        };
        array.iter().map(|item| self.section_of(format!("[[{key}]]"), key, item)).collect()
    }

    /// Refuses what nobody asked for.
    pub(crate) fn finish(self) -> Result<(), SceneError> {
        match self.table.iter().find(|(key, _)| !self.asked.contains(&key.get_ref().as_ref())) {
            Some((key, _)) => Err(self.unknown(key)),
            None => Ok(()),
        }
    }
}
