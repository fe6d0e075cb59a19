//! What went wrong in steps, in words: told when it begins, not in every step.

use glisson::model::ModelReport;
use glisson::world::StepReport;

/// Notices of one run beyond which no more are told: a screen full of them helps nobody.
pub(super) const MOST_NOTICES: usize = 100;

/// Remembers what was told.
#[derive(Debug, Default)]
pub(super) struct Incidents {
    last: ModelReport,
    n_told: usize,
}

impl Incidents {
    /// What began in this step.
    pub(super) fn of_step(&mut self, report: &StepReport) -> Vec<String> {
        let (last, now) = (self.last, report.model);
        self.last = now;
        let mut notices = Vec::new();
        if now.n_quarantined_tets > 0 && last.n_quarantined_tets == 0 {
            let first = now.first_quarantined.map_or(String::new(), |tet| format!(" (the first: {tet})"));
            notices.push(format!("{} tetrahedra are inverted or not finite{first}", now.n_quarantined_tets));
        }
        if now.n_recovered_nodes > 0 && last.n_recovered_nodes == 0 {
            let n = now.n_recovered_nodes;
            notices.push(format!("{n} nodes were brought back to their last finite place"));
        }
        if now.n_mass_scaled_nodes > last.n_mass_scaled_nodes {
            let n = now.n_mass_scaled_nodes;
            notices.push(format!(
                "{n} nodes were made heavier: the mesh allows no step this long after the edit"
            ));
        }
        if now.energy_was_limited && !last.energy_was_limited {
            notices.push("the motion gained more energy than the outside gave, and was slowed down".into());
        }
        if now.missed_tolerance && !last.missed_tolerance {
            notices.push("the step ended before its residual was small enough".into());
        }
        if now.n_ignored_constraints > 0 && last.n_ignored_constraints == 0 {
            let n = now.n_ignored_constraints;
            notices.push(format!("{n} constraints were left out: on fixed or loose nodes, or not finite"));
        }
        notices.truncate(MOST_NOTICES - self.n_told);
        self.n_told += notices.len();
        notices.into_iter().map(|notice| format!("step {}: {notice}", report.step)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::TetId;

    #[test]
    fn an_incident_is_told_when_it_begins_and_again_when_it_comes_back() {
        let mut incidents = Incidents::default();
        let inverted = ModelReport {
            n_quarantined_tets: 2,
            first_quarantined: Some(TetId(7)),
            ..ModelReport::default()
        };
        let mut told = |step, model| incidents.of_step(&StepReport { step, model, ..StepReport::default() });
        let first = told(3, inverted);
        assert!(first.len() == 1 && first[0].starts_with("step 3: 2 tetrahedra") && first[0].contains('7'));
        assert!(told(4, inverted).is_empty());
        assert!(told(5, ModelReport::default()).is_empty());
        assert_eq!(told(6, inverted).len(), 1);
        for step in 0..500 {
            told(step, if step % 2 == 0 { inverted } else { ModelReport::default() });
        }
        assert!(told(999, inverted).is_empty());
    }
}
