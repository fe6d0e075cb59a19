//! The real tools, driven through steps of the world: what they cut is found, cut and torn by the world itself.

use super::before::Volume;
use super::instruments::{GRASPER, HOT, SCALPEL, SCISSORS, TIP_RADIUS_M};
use super::patient::Patient;
use super::tally::reason;
use glisson::math::DVec3;
use glisson::tool::ToolInput;

/// Share of the calls that cut and are then undone.
const TAKEN_BACK: f64 = 0.1;

impl Patient<'_> {
    /// A step with one tool there and the others away, and what the tools then cut.
    /// Answers whether these cuts stand.
    fn work(&mut self, tool: usize, input: ToolInput, placed: bool) -> bool {
        let mut inputs = self.away;
        inputs[tool] = input;
        self.step(&inputs, placed);
        let before = self.before();
        let positions_m = self.world.state().positions_m.to_vec();
        let live = self.world.organ().live_tetrahedra().to_vec();
        self.world.take_changes();
        let cuts = self.world.cut_with_tools();
        let refusals = cuts.refusals.iter().map(|(_, refusal)| refusal).chain(&cuts.tear_refusal);
        refusals.for_each(|refusal| self.tally.refuse(&reason(refusal)));
        let changes = self.world.take_changes();
        let n_edits = changes.len();
        if n_edits == 0 {
            return true;
        }
        let n_tets = cuts.n_removed + cuts.n_torn;
        let n_changes_before = cuts.n_edits;
        let volume = Volume::Taken { n_tets, n_changes_before };
        self.check(&before, volume, &changes, cuts.blades.n_mended > 0);
        // Edits for which the model was copied whole cannot all be undone.
        if self.random.uniform() < TAKEN_BACK && self.world.n_edits_to_undo() >= n_edits {
            let label = self.label();
            for _ in 0..n_edits {
                assert!(self.world.undo_edit(), "{label}: cannot be undone");
            }
            let now_m = self.world.state().positions_m;
            let bits =
                |list: &[DVec3]| list.iter().flat_map(|p| p.to_array()).map(f64::to_bits).collect::<Vec<_>>();
            assert_eq!(bits(now_m), bits(&positions_m), "{label}: undone");
            assert_eq!(self.world.organ().live_tetrahedra(), live, "{label}: undone");
            self.go_back_to(before);
            self.check_attached(&label);
            self.tally.undone += n_edits as u64;
            self.is_parting_taken_back |= cuts.blades.n_partings > 0;
            return false;
        }
        let by_edge = cuts.n_edits as u64;
        let by_tip = u64::from(cuts.n_removed > 0);
        self.tally.tears += n_edits as u64 - by_edge - by_tip;
        self.tally.stroke_partings += cuts.blades.n_partings as u64;
        self.tally.mended_places += cuts.blades.n_mended as u64;
        match tool {
            SCISSORS => self.tally.snips += by_tip + by_edge,
            SCALPEL => self.tally.tool_blade_edits += by_edge,
            _ => self.tally.burns += by_tip,
        }
        self.keep_last(before, n_edits);
        true
    }

    fn put_away(&mut self) {
        self.rest_after_edit();
    }

    /// Grasps, pulls until tissue tears, lets go.
    pub(super) fn grasp(&mut self) {
        let Some((place_m, normal)) = self.place() else { return };
        let at = |out_m: f64, jaw_opening: f64| ToolInput {
            jaw_opening,
            ..ToolInput::at(place_m + normal * out_m, normal)
        };
        self.work(GRASPER, at(0.02, 1.0), true);
        for k in 0..10 {
            let share = f64::from(k) / 9.0;
            self.work(GRASPER, at(0.02 * (1.0 - share) - 3e-3 * share, 1.0), false);
        }
        for k in 0..8 {
            self.work(GRASPER, at(-3e-3, 1.0 - f64::from(k) / 7.0), false);
        }
        let pull_m = 0.03 * self.random.uniform();
        let mut held = 0;
        for k in 0..24 {
            self.work(GRASPER, at(-3e-3 + pull_m * f64::from(k) / 23.0, 0.0), false);
            held = held.max(self.world.report().tools[GRASPER].n_held_nodes);
        }
        self.work(GRASPER, at(pull_m, 1.0), false);
        self.tally.grasps += 1;
        self.tally.held += u64::from(held > 0);
        self.put_away();
    }

    /// A hot tip is pressed in and drawn along.
    pub(super) fn burn(&mut self) {
        let Some((place_m, normal)) = self.place() else { return };
        let along = self.way_along(normal);
        let length_m = self.mean_edge_m * self.random.uniform_in(0.5, 3.0);
        let at = |out_m: f64, along_m: f64, trigger: f64| ToolInput {
            trigger,
            ..ToolInput::at(place_m + normal * out_m + along * along_m, normal)
        };
        let (above_m, below_m) = (TIP_RADIUS_M + 2e-3, TIP_RADIUS_M - 2.5e-3);
        self.work(HOT, at(above_m, 0.0, 0.0), true);
        for k in 1..=12 {
            let share = f64::from(k) / 12.0;
            self.work(HOT, at(above_m + (below_m - above_m) * share, 0.0, 1.0), false);
        }
        for k in 1..=16 {
            self.work(HOT, at(below_m, length_m * f64::from(k) / 16.0, 1.0), false);
        }
        self.work(HOT, at(above_m, length_m, 0.0), false);
        self.tally.tool_uses += 1;
        self.put_away();
    }

    /// Scissors are put around some tissue and closed.
    pub(super) fn snip(&mut self) {
        let Some((place_m, normal)) = self.place() else { return };
        let depth_m = self.mean_edge_m * self.random.uniform_in(0.3, 1.5);
        let at = |out_m: f64, jaw_opening: f64| ToolInput {
            jaw_opening,
            ..ToolInput::at(place_m + normal * out_m, normal)
        };
        self.work(SCISSORS, at(0.015, 1.0), true);
        for k in 1..=8 {
            let share = f64::from(k) / 8.0;
            self.work(SCISSORS, at(0.015 * (1.0 - share) - depth_m * share, 1.0), false);
        }
        for k in 1..=6 {
            self.work(SCISSORS, at(-depth_m, 1.0 - f64::from(k) / 6.0), false);
        }
        self.work(SCISSORS, at(0.015, 0.0), false);
        self.tally.tool_uses += 1;
        self.put_away();
    }

    /// The scalpel is set down, pressed in and drawn, its trigger pressed, then let go.
    pub(super) fn incise(&mut self) {
        let Some(stroke) = self.stroke() else { return };
        let at = |[tip_m, heel_m]: [DVec3; 2], trigger: f64| ToolInput {
            trigger,
            ..ToolInput::at(tip_m, (heel_m - tip_m).normalize())
        };
        self.is_parting_taken_back = false;
        let first = stroke[0];
        let lift_m = (first[1] - first[0]) * 1.2;
        self.work(SCALPEL, at(first.map(|p| p + lift_m), 1.0), true);
        for k in 1..=8 {
            let left_m = lift_m * (1.0 - f64::from(k) / 8.0);
            self.work(SCALPEL, at(first.map(|p| p + left_m), 1.0), false);
        }
        for pair in stroke.windows(2) {
            for k in 1..=3 {
                let share = f64::from(k) / 3.0;
                self.work(SCALPEL, at([0, 1].map(|i| pair[0][i].lerp(pair[1][i], share)), 1.0), false);
            }
        }
        let stands = self.work(SCALPEL, at(stroke[stroke.len() - 1], 0.0), false);
        if stands && !self.is_parting_taken_back {
            self.check_singular();
        } else {
            // What was parted hangs together again, and no later stroke comes by here: it is parted at once.
            self.finish_stroke_at_singular_places();
        }
        self.tally.tool_uses += 1;
        self.put_away();
    }
}
