//! A result beside a group and beside the same person's other attempts.

use crate::attempt::{AttemptResult, KeptMetric};
use crate::comparison::{Comparison, MAIN_METRICS, MetricComparison, MetricName, NamedCurve, Reference};
use crate::error::StoreError;
use crate::statistics::{learning_curve, quartiles};
use crate::store::{Store, StoredResult};
use glisson::training::task::Outcome;

/// Values of a metric in results of the store.
fn values(store: &Store, results: &[i64], of: &MetricName) -> Result<Vec<f64>, StoreError> {
    let sql = "SELECT value FROM metric WHERE result = ?1 AND name = ?2 AND tool = ?3";
    let tool = of.tool.as_deref().unwrap_or_default();
    let mut found = Vec::new();
    for result in results {
        let of_result: Vec<f64> = store.list(sql, (result, &of.name, tool), |row| row.get(0))?;
        found.extend(of_result);
    }
    Ok(found)
}

/// A person's values by attempt: none where the task was not done.
fn by_attempt(attempts: &[StoredResult], of: &MetricName) -> Vec<Option<f64>> {
    let value = |result: &AttemptResult| {
        let metric = result.metric(&of.name, of.tool.as_deref());
        metric.and_then(|metric| metric.value).filter(|_| result.outcome == Some(Outcome::Done))
    };
    attempts.iter().map(|attempt| value(&attempt.result)).collect()
}

fn named(metric: &KeptMetric) -> MetricName {
    MetricName { name: metric.name.clone(), tool: metric.tool.clone() }
}

impl Store {
    /// A result beside a group, if one is given, and beside the same person's attempts at the same scene.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where there is no such result or group.
    pub fn compare(&self, id: i64, group: Option<&str>) -> Result<Comparison, StoreError> {
        let stored = self.result(id)?;
        let scene_hash = &stored.kept.attempt.scene_hash;
        let references = match group {
            Some(group) => self.reference_results(group, scene_hash, &stored.person)?,
            None => Vec::new(),
        };
        let attempts = self.attempts(&stored.person, scene_hash)?;
        let is_done = stored.result.outcome == Some(Outcome::Done);
        let (mut metrics, mut curves) = (Vec::new(), Vec::new());
        for KeptMetric { title, value, unit, better, name, tool } in &stored.result.metrics {
            let of = MetricName { name: name.clone(), tool: tool.clone() };
            let others = values(self, &references, &of)?;
            let quartiles = quartiles(&others);
            let place = quartiles.zip(value.filter(|_| is_done)).and_then(|(all, value)| all.place(value));
            if MAIN_METRICS.contains(&name.as_str()) {
                let curve = learning_curve(&by_attempt(&attempts, &of), quartiles);
                curves.push(NamedCurve { of: of.clone(), title: title.clone(), unit: unit.clone(), curve });
            }
            metrics.push(MetricComparison {
                of,
                title: title.clone(),
                unit: unit.clone(),
                better: *better,
                value: *value,
                n_people: others.len(),
                quartiles,
                standing: place.and_then(|place| place.standing(*better)),
            });
        }
        let reference = group.map(|group| Reference { group: group.into(), n_people: references.len() });
        Ok(Comparison { id, person: stored.person, reference, metrics, curves })
    }

    /// The learning curves of a metric over the attempts of the person at the task that `filter` names: one for each instrument
    /// that has it. Of what it lets through, the attempts at the last scene; answers how many at other scenes are left out.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where the person, the task, the group or the metric is not there.
    pub fn curves(
        &self,
        filter: &crate::Filter,
        metric: &str,
        group: Option<&str>,
    ) -> Result<(Vec<NamedCurve>, usize), StoreError> {
        let all = self.results(filter)?;
        let Some(last) = all.last() else {
            let task = filter.task.as_deref().unwrap_or_default();
            return Err(self.unknown("such result at the task", format!("\"{task}\""), &[]));
        };
        let person = last.person.as_str();
        let scene_hash = &last.kept.attempt.scene_hash;
        let is_there =
            |result: &&StoredResult| result.person == person && result.kept.attempt.scene_hash == *scene_hash;
        let attempts: Vec<StoredResult> = all.iter().filter(is_there).cloned().collect();
        let references = match group {
            Some(group) => self.reference_results(group, scene_hash, person)?,
            None => Vec::new(),
        };
        let mut known: Vec<&KeptMetric> = Vec::new();
        for found in attempts.iter().flat_map(|attempt| &attempt.result.metrics) {
            if !known.iter().any(|known| known.name == found.name && known.tool == found.tool) {
                known.push(found);
            }
        }
        let chosen: Vec<&KeptMetric> = known.iter().copied().filter(|known| known.name == metric).collect();
        if chosen.is_empty() {
            let mut names: Vec<&str> = known.iter().map(|known| known.name.as_str()).collect();
            names.dedup();
            return Err(self.unknown("metric", format!("\"{metric}\""), &names));
        }
        let curve = |metric: &&KeptMetric| {
            let of = named(metric);
            let band = quartiles(&values(self, &references, &of)?);
            let curve = learning_curve(&by_attempt(&attempts, &of), band);
            Ok(NamedCurve { of, title: metric.title.clone(), unit: metric.unit.clone(), curve })
        };
        let curves = chosen.iter().map(curve).collect::<Result<Vec<_>, StoreError>>()?;
        Ok((curves, all.len() - attempts.len()))
    }
}
