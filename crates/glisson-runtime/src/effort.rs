//! When the simulation cannot keep pace with the clock it computes less thoroughly, and more again when it has time to spare.

use glisson::model::LevelOfDetail;

/// How the last while went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Load {
    /// Simulated time over time that passed.
    pub(crate) real_time_factor: f64,
    /// Share of the time that passed in which steps were computed.
    pub(crate) busy_share: f64,
}

/// Slower than this is late.
const LATE_BELOW: f64 = 0.95;
/// With less work than this there is time to spare: half of it, so that what takes twice as long fits.
const IDLE_BELOW: f64 = 0.5;
/// So many looks in a row without haste before more is computed again: some five seconds, lest it swings to and fro.
const CALM_LOOKS: u32 = 10;

/// Decides from one look to the next.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EffortControl {
    effort: LevelOfDetail,
    n_calm: u32,
}

impl EffortControl {
    /// Another effort, if there should be one.
    pub(crate) fn look(&mut self, load: Load) -> Option<LevelOfDetail> {
        let is_calm = load.real_time_factor >= LATE_BELOW && load.busy_share < IDLE_BELOW;
        self.n_calm = if is_calm { self.n_calm + 1 } else { 0 };
        let wanted = if load.real_time_factor < LATE_BELOW {
            self.effort.less()
        } else if self.n_calm >= CALM_LOOKS {
            self.n_calm = 0;
            self.effort.more()
        } else {
            self.effort
        };
        let changes = wanted != self.effort;
        self.effort = wanted;
        changes.then_some(wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn less_is_computed_when_late_and_more_again_after_a_calm_while() {
        let mut control = EffortControl::default();
        let late = Load { real_time_factor: 0.7, busy_share: 1.0 };
        let even = Load { real_time_factor: 1.0, busy_share: 0.8 };
        let calm = Load { real_time_factor: 1.0, busy_share: 0.2 };
        assert_eq!(control.look(even), None);
        assert_eq!(
            [late, late, late].map(|load| control.look(load)),
            [Some(LevelOfDetail::Reduced), Some(LevelOfDetail::Least), None]
        );
        // What is just enough stays.
        assert!((0..50).all(|_| control.look(even).is_none()));
        assert!((0..9).all(|_| control.look(calm).is_none()));
        // One busy look begins the wait anew.
        assert_eq!(control.look(even), None);
        assert!((0..9).all(|_| control.look(calm).is_none()));
        assert_eq!(control.look(calm), Some(LevelOfDetail::Reduced));
        assert!((0..9).all(|_| control.look(calm).is_none()));
        assert_eq!(control.look(calm), Some(LevelOfDetail::Full));
        assert!((0..50).all(|_| control.look(calm).is_none()));
    }
}
