//! What the user should know, in words; and what went wrong in steps: told when it begins, not in every step.

use glisson::model::{LevelOfDetail, ModelReport};
use glisson::world::StepReport;

/// Incidents of one run beyond which no more are told: a screen full of them helps nobody.
const MOST_INCIDENTS: usize = 100;
/// Notices that are kept, the newest ones: what is said last, that a device was lost, must not go under in what was said before.
const MOST_NOTICES: usize = 100;

/// Things that are told once in a run, with the numbers of the first time: they would be told with other numbers again and again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Once {
    /// Tissue is stretched too far and does not tear.
    TearRefusal,
    /// Faces of this instrument's cut merged.
    MergedFaces(usize),
    /// Time passes more slowly, though as little as possible is computed.
    TimeIsSlow,
}

impl Once {
    /// Whether something is wrong: a slow machine is no fault.
    fn is_problem(self) -> bool {
        self != Self::TimeIsSlow
    }
}

/// What the user should know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// In words.
    pub text: String,
    /// Whether something is wrong or was not done; otherwise all goes as it should.
    pub is_problem: bool,
}

/// What the user should know, in order.
#[derive(Debug, Default)]
pub(crate) struct Notices {
    newest: Vec<Notice>,
    n_told: usize,
    once: Vec<Once>,
}

impl Notices {
    /// A key that is held down asks for the same again and again: what was just said is not repeated.
    pub(crate) fn tell(&mut self, notice: Notice) {
        if self.newest.last() == Some(&notice) {
            return;
        }
        if self.newest.len() == MOST_NOTICES {
            self.newest.remove(0);
        }
        self.newest.push(notice);
        self.n_told += 1;
    }

    /// Tells it if nothing of the kind was told.
    pub(crate) fn tell_once(&mut self, kind: Once, text: impl FnOnce() -> String) {
        if !self.once.contains(&kind) {
            self.once.push(kind);
            self.tell(Notice { text: text(), is_problem: kind.is_problem() });
        }
    }

    /// The newest ones.
    pub(crate) fn newest(&self) -> &[Notice] {
        &self.newest
    }

    /// How many were told altogether.
    pub(crate) fn n_told(&self) -> usize {
        self.n_told
    }
}

/// Remembers what was told.
#[derive(Debug, Default)]
pub(crate) struct Incidents {
    last: ModelReport,
    n_told: usize,
}

impl Incidents {
    /// What began in this step, computed with this effort: what less effort brings with it was meant to happen.
    pub(crate) fn of_step(&mut self, report: &StepReport, effort: LevelOfDetail) -> Vec<Notice> {
        let (last, now) = (self.last, report.model);
        self.last = now;
        let mut notices: Vec<String> = Vec::new();
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
        if now.n_ignored_constraints > 0 && last.n_ignored_constraints == 0 {
            let n = now.n_ignored_constraints;
            notices.push(format!("{n} constraints were left out: on fixed or loose nodes, or not finite"));
        }
        let n_that_are_problems = notices.len();
        if now.energy_was_limited && !last.energy_was_limited {
            notices.push("the motion gained more energy than the outside gave, and was slowed down".into());
        }
        if now.missed_tolerance && !last.missed_tolerance {
            notices.push("the step ended before its residual was small enough".into());
        }
        notices.truncate(MOST_INCIDENTS - self.n_told);
        self.n_told += notices.len();
        let of_effort = |nth: usize| nth >= n_that_are_problems && effort < LevelOfDetail::Full;
        let told = |(nth, text): (usize, String)| match of_effort(nth) {
            true => Notice {
                text: format!("step {}: {text}: it computes with {} effort", report.step, effort.name()),
                is_problem: false,
            },
            false => Notice { text: format!("step {}: {text}", report.step), is_problem: true },
        };
        notices.into_iter().enumerate().map(told).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::TetId;

    #[test]
    fn what_is_told_last_is_there_however_much_was_told_before() {
        let news = |text: String| Notice { text, is_problem: false };
        let mut notices = Notices::default();
        for number in 0..500 {
            notices.tell(news(format!("notice {number}")));
            notices.tell(news(format!("notice {number}")));
            notices.tell_once(Once::MergedFaces(number % 2), || format!("merged {number}"));
            notices.tell_once(Once::TimeIsSlow, || format!("slow {number}"));
        }
        notices.tell(Notice { text: "the device was lost".to_owned(), is_problem: true });
        assert_eq!(notices.newest().len(), MOST_NOTICES);
        let [.., last_but_one, last] = notices.newest() else { panic!("{:?}", notices.newest()) };
        assert_eq!(*last_but_one, news("notice 499".to_owned()));
        assert_eq!((last.text.as_str(), last.is_problem), ("the device was lost", true));
        // Two instruments and the pace, once each.
        assert_eq!(notices.n_told(), 500 + 3 + 1);
    }

    #[test]
    fn an_incident_is_told_when_it_begins_and_again_when_it_comes_back() {
        let mut incidents = Incidents::default();
        let inverted = ModelReport {
            n_quarantined_tets: 2,
            first_quarantined: Some(TetId(7)),
            ..ModelReport::default()
        };
        let mut told = |step, model| {
            let report = StepReport { step, model, ..StepReport::default() };
            let notices = incidents.of_step(&report, LevelOfDetail::Full);
            notices.into_iter().map(|notice| notice.text).collect::<Vec<_>>()
        };
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

    #[test]
    fn what_less_effort_brings_with_it_is_no_problem() {
        let missed = ModelReport { missed_tolerance: true, n_recovered_nodes: 1, ..ModelReport::default() };
        let report = StepReport { step: 9, model: missed, ..StepReport::default() };
        let of = |effort| Incidents::default().of_step(&report, effort);
        assert!(of(LevelOfDetail::Full).iter().all(|notice| notice.is_problem));
        let [nodes, tolerance] = &of(LevelOfDetail::Least)[..] else { panic!("two notices") };
        assert!(nodes.is_problem && !tolerance.is_problem);
        assert!(tolerance.text.ends_with("with least effort"), "{}", tolerance.text);
    }
}
