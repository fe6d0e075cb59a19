//! What a report says of a result beside a group and beside the same person's other attempts.

use crate::statistics::{LearningCurve, Quartiles, Standing};
use glisson::training::metrics::Better;

/// Metrics whose learning curves a report shows: time, motion, force, smoothness.
pub const MAIN_METRICS: [&str; 4] = ["time", "path_length", "peak_force", "smoothness_sparc"];

/// Which metric, of which instrument.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetricName {
    /// Its name.
    pub name: String,
    /// The instrument; none for one of the whole task.
    pub tool: Option<String>,
}

/// The group that a result is compared with.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Its name.
    pub group: String,
    /// Members with a passed result at this task, without the person who is compared.
    pub n_people: usize,
}

/// A metric of a result beside a group's.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricComparison {
    /// Which.
    pub of: MetricName,
    /// Its name for people.
    pub title: String,
    /// SI unit; empty for a plain number.
    pub unit: String,
    /// Which way is better.
    pub better: Better,
    /// The result's value.
    pub value: Option<f64>,
    /// Members who have this metric.
    pub n_people: usize,
    /// Of the group, where there are enough people.
    pub quartiles: Option<Quartiles>,
    /// What the value is beside them. None without quartiles, for a metric that only describes, and for an attempt that was not
    /// done: who breaks off early is not fast.
    pub standing: Option<Standing>,
}

/// The learning curve of a metric.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCurve {
    /// Which metric.
    pub of: MetricName,
    /// Its name for people.
    pub title: String,
    /// SI unit; empty for a plain number.
    pub unit: String,
    /// The values.
    pub curve: LearningCurve,
}

/// What a report says of a result beside others.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The result's number in the store.
    pub id: i64,
    /// Who did it.
    pub person: String,
    /// The group, if one was asked for.
    pub reference: Option<Reference>,
    /// All metrics of the result.
    pub metrics: Vec<MetricComparison>,
    /// Of the [`MAIN_METRICS`] that the result has.
    pub curves: Vec<NamedCurve>,
}

impl Comparison {
    /// A metric's place beside the group.
    pub fn metric(&self, name: &str, tool: Option<&str>) -> Option<&MetricComparison> {
        self.metrics.iter().find(|metric| metric.of.name == name && metric.of.tool.as_deref() == tool)
    }
}
