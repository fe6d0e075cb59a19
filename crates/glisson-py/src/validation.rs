//! The program's claims.

use crate::arrays::from_json;
use crate::errors::of_simulation;
use crate::work;
use anyhow::{Context, anyhow};
use glisson_lab::validate::{Experiment, GROUPS, Group, SLOW_GROUPS};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::BTreeMap;

/// Groups of experiments, and what each is about; those that take minutes are among them.
#[pyfunction]
pub(crate) fn validation_groups() -> BTreeMap<&'static str, &'static str> {
    GROUPS.iter().chain(SLOW_GROUPS).map(|group| (group.name, group.about)).collect()
}

/// Reproduces the claims of a group, or of all but those that take minutes each: `glisson validate --json`.
///
/// A list of dictionaries: `name`, `source`, `expected`, `obtained`, `tolerance`, `pass`, and `compares_times`, whether processor times are
/// compared, which a busy machine disturbs. It runs without Python's lock; Ctrl + C ends it after the group that it is in.
#[pyfunction]
#[pyo3(signature = (group = None))]
pub(crate) fn validate(py: Python<'_>, group: Option<String>) -> PyResult<Py<PyAny>> {
    let every = || GROUPS.iter().chain(SLOW_GROUPS);
    let groups: Vec<&Group> = match &group {
        Some(name) => every().filter(|group| group.name == name).collect(),
        None => GROUPS.iter().collect(),
    };
    if groups.is_empty() {
        let names: Vec<&str> = every().map(|group| group.name).collect();
        let name = group.unwrap_or_default();
        let suggestion = glisson::text::did_you_mean(&name, &names);
        return Err(PyValueError::new_err(format!(
            "there is no group \"{name}\" of experiments{suggestion}; there are: {}",
            names.join(", ")
        )));
    }
    let mut experiments: Vec<Experiment> = Vec::new();
    for group in groups {
        py.check_signals()?;
        let outcome = work::done_or(py, of_simulation, None, || (group.run)().with_context(|| group.name))?;
        experiments.extend(outcome.experiments);
    }
    let text = serde_json::to_string(&experiments).map_err(|error| of_simulation(&anyhow!(error)))?;
    from_json(py, &text)
}
