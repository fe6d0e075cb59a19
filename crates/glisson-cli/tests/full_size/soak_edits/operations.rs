//! What a hand does next.

use super::draw::Depth;
use super::patient::Patient;

/// Edits between two comparisons with a fresh model.
pub(super) const COMPARED_EVERY: u64 = 50;
/// Removals between two looks at a pre-computed model: it may ask for a fresh one soon.
pub(super) const COMPLIANCE_EVERY: u64 = 20;
/// Tries for each edit that is asked for, at most.
const TRIES: u64 = 10;

impl Patient<'_> {
    /// Makes random operations until `most_edits` edits are made, or too many tries made none.
    pub(super) fn run(&mut self, most_edits: u64) {
        let (mut n_tries, mut compared) = (0, 0);
        while self.tally.edits() < most_edits && n_tries < TRIES * most_edits {
            n_tries += 1;
            if self.world.organ().surface_nodes().is_empty() {
                break;
            }
            if self.draw.follows_all() {
                self.any_operation();
            } else {
                self.mostly_removal();
            }
            let every =
                if self.draw.depth() == Depth::Compliance { COMPLIANCE_EVERY } else { COMPARED_EVERY };
            if self.tally.edits() >= compared + every {
                compared = self.tally.edits();
                self.compare();
                self.compare_compliance();
            }
        }
        self.compare();
        self.compare_compliance();
    }

    fn any_operation(&mut self) {
        match self.index(25) {
            0..=7 => self.remove(),
            8..=12 => self.blade(),
            13..=16 => self.scalpel(),
            17 => self.refine(),
            18 => self.grasp(),
            19..=20 => self.burn(),
            21..=22 => self.snip(),
            23 => self.incise(),
            _ => self.take_back_late(),
        }
    }

    /// For a model that follows removals alone: strokes and finer regions are refused.
    fn mostly_removal(&mut self) {
        match self.index(25) {
            0..=10 => self.remove(),
            11 => self.blade(),
            12 => self.scalpel(),
            13 => self.refine(),
            14..=16 => self.grasp(),
            17..=20 => self.burn(),
            21..=22 => self.snip(),
            23 => self.incise(),
            _ => self.take_back_late(),
        }
    }
}
