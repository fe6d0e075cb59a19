//! Which of the cases run.

use super::press::{SUBJECTS, Subject};
use anyhow::ensure;
use glisson::model::kind::ModelKind;

/// Wanted tetrahedra.
const SIZES: [usize; 4] = [2_000, 6_300, 20_000, 50_000];

/// A part of the cases.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Scene names of models; all four if empty.
    pub models: Vec<String>,
    /// Wanted tetrahedra; 2,000, 6,300, 20,000 and 50,000 if empty.
    pub sizes: Vec<usize>,
    /// Radii of balls for the block [m]; 3, 5 and 10 mm if empty.
    pub balls_m: Vec<f64>,
    /// How many of the three places.
    pub n_places: usize,
    /// Explicit models above so many tetrahedra are left out: a second of theirs takes many of the machine's.
    pub most_explicit: usize,
}

impl Default for Selection {
    fn default() -> Self {
        Self {
            models: Vec::new(),
            sizes: Vec::new(),
            balls_m: Vec::new(),
            n_places: 1,
            most_explicit: 20_000,
        }
    }
}

impl Selection {
    /// Every place.
    pub(super) fn whole() -> Self {
        Self { n_places: 3, ..Self::default() }
    }

    /// The models of the selection.
    pub(super) fn subjects(&self) -> anyhow::Result<Vec<Subject>> {
        let known = SUBJECTS.map(|subject| subject.kind.name());
        for name in &self.models {
            ensure!(known.contains(&name.as_str()), "no model {name:?}; there are: {}", known.join(", "));
        }
        let is_wanted = |subject: &Subject| {
            self.models.is_empty() || self.models.iter().any(|name| name == subject.kind.name())
        };
        Ok(SUBJECTS.into_iter().filter(is_wanted).collect())
    }

    /// Wanted tetrahedra.
    pub(super) fn sizes(&self) -> &[usize] {
        if self.sizes.is_empty() { &SIZES } else { &self.sizes }
    }

    /// Whether a model runs at a size.
    pub(super) fn wants(&self, subject: &Subject, size: usize) -> bool {
        subject.kind != ModelKind::Explicit || size <= self.most_explicit
    }
}
