//! What changes as an instrument slides along the tissue, and a model of one place cannot know.
//!
//! [`HapticModel::force_at`] takes the touched patch as it is where the model was made. Along the surface the tissue becomes
//! stiffer and softer and its shape turns, so a tip that slides at one depth feels another force. What a model missed by the
//! time the next one came tells how fast: with r = F_n - (force of model n - 1 at the tip's place P_n), and w the tip's way along
//! the surface between them, s = (P - P_n) . w/|w| further along it the force is
//!
//! F_n(P) + n g s + a min(max(s, 0)/|w|, 1),   g = r . n/|w|,   a = r - n (r . n), without pull and within friction's cone:
//!
//! the secant of a quasi-Newton method (C. G. Broyden, A class of methods for solving nonlinear simultaneous equations,
//! Mathematics of Computation 19, 1965, doi 10.1090/S0025-5718-1965-0198670-6), for the motion along the surface only. The drag a
//! goes no further than to where it was seen: friction has its full size after a short way. g goes on changing as it did from one
//! slide to the next, by up to half of itself.
//!
//! It stays bounded: g is not steeper than the tissue is stiff along its normal, so a tick of the coupling still contracts; a
//! residual that is twice as steep is no slide but tissue that gave way, and counts nothing. It reaches two ways and
//! [`MOST_REACH_M`] at most, half of the push at most, and only from one model to the next. A tip that goes in and out along
//! the normal, or rests, has no way along the surface: then nothing is added, and what is passive without it stays so.

use super::tissue::{HapticModel, Touch, TouchedPart};
use crate::math::{DMat3, DVec3};

/// A shorter way between two models is no slide [m]: twice what devices resolve. A choice, as are the next five.
const LEAST_SLIDE_M: f64 = 1e-4;
/// So many of the last way are looked ahead: a model that is felt a period late is two of them behind at the next.
const MOST_WAYS: f64 = 2.0;
/// And no more than that [m]: about an element of an organ.
const MOST_REACH_M: f64 = 5e-3;
/// Share of the push that is added or taken at most.
const MOST_PUSH_SHARE: f64 = 0.5;
/// Share of itself by which the change along the way goes on changing at most.
const MOST_CHANGE: f64 = 0.5;

/// How much a part's lever may differ from none, entry by entry: of a tip behind its trocar, less than its radius over the
/// length that is in.
const LARGEST_LEVER: f64 = 0.2;

/// The change of force along a slide, from the last two models.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Slide {
    /// Unit vector of the way along the surface; zero without a slide.
    along: DVec3,
    way_m: f64,
    /// Rise of the push per way [N/m], as seen, and as looked ahead.
    seen_n_per_m: f64,
    rise_n_per_m: f64,
    /// Drag that the model before did not tell [N].
    drag_n: DVec3,
}

impl Slide {
    /// From the slide before, its model and the latest one.
    pub fn next(self, before: &HapticModel, latest: &HapticModel) -> Self {
        let (Some(_), Some(now)) = (contact(before), contact(latest)) else { return Self::default() };
        let between_s = latest.time_s - before.time_s;
        let moved_m = latest.tip_m - before.tip_m;
        let slid_m = moved_m - now.normal * moved_m.dot(now.normal);
        let way_m = slid_m.length();
        let is_slide = (LEAST_SLIDE_M..=MOST_REACH_M).contains(&way_m) && between_s > 0.0;
        if !is_slide || !now.friction_coefficient.is_finite() {
            return Self::default();
        }
        let missed_n = latest.force_n - before.force_at(latest.tip_m, between_s);
        let push_n = missed_n.dot(now.normal);
        let stiffness_n_per_m = now.normal.dot(now.stiffness_n_per_m * now.normal);
        let seen_n_per_m = push_n / way_m;
        if !missed_n.is_finite() || missed_n.length() > 2.0 * stiffness_n_per_m * way_m {
            return Self::default();
        }
        let change = if self.seen_n_per_m * seen_n_per_m > 0.0 {
            let most = MOST_CHANGE * seen_n_per_m.abs();
            (seen_n_per_m - self.seen_n_per_m).clamp(-most, most)
        } else {
            0.0
        };
        Self {
            along: slid_m / way_m,
            way_m,
            seen_n_per_m,
            rise_n_per_m: (seen_n_per_m + change).clamp(-stiffness_n_per_m, stiffness_n_per_m),
            drag_n: (missed_n - now.normal * push_n).clamp_length_max(stiffness_n_per_m * way_m),
        }
    }

    /// `force_n` [N] of the latest model at `tip_m` [m], with what the slide adds.
    pub fn force_at(&self, latest: &HapticModel, force_n: DVec3, tip_m: DVec3) -> DVec3 {
        let Some(now) = contact(latest).filter(|_| self.way_m > 0.0) else { return force_n };
        let alone_n = force_n.dot(now.normal);
        if alone_n <= 0.0 {
            return force_n;
        }
        let s_m = (tip_m - latest.tip_m).dot(self.along);
        let most_m = (MOST_WAYS * self.way_m).min(MOST_REACH_M);
        let most_n = MOST_PUSH_SHARE * alone_n;
        let push_n = alone_n + (self.rise_n_per_m * s_m.clamp(-most_m, most_m)).clamp(-most_n, most_n);
        let along_n = force_n - now.normal * alone_n;
        let drag_n = along_n + self.drag_n * (s_m / self.way_m).clamp(0.0, 1.0);
        // A lever may show a little more at the tip.
        let friction = now.friction_coefficient.max(along_n.length() / alone_n);
        now.normal * push_n + drag_n.clamp_length_max(friction * push_n)
    }
}

/// The one contact of a model that has no other part, if it is felt about where it is: what a shaft touches is not where
/// the tip slides.
fn contact(model: &HapticModel) -> Option<TouchedPart> {
    let part = match model.n_parts {
        0 => TouchedPart {
            touch: model.touch,
            force_n: model.force_n,
            stiffness_n_per_m: model.stiffness_n_per_m,
            normal: model.normal,
            friction_coefficient: model.friction_coefficient,
            ..TouchedPart::default()
        },
        1 if model.parts[0].lever.abs_diff_eq(DMat3::IDENTITY, LARGEST_LEVER) => model.parts[0],
        _ => return None,
    };
    (part.touch == Touch::Contact).then_some(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_M: f64 = 7e-4;

    /// Tissue 10 mm deep under a tip that slides along x, whose stiffness k(x) = 120 + 8e3 x [N/m] rises.
    fn model(step: u64, x_m: f64, depth_m: f64) -> HapticModel {
        let stiffness_n_per_m = stiffness(x_m);
        let push_n = stiffness_n_per_m * depth_m;
        HapticModel {
            step,
            time_s: step as f64 / 30.0,
            touch: Touch::Contact,
            tip_m: DVec3::new(x_m, 0.0, -depth_m),
            force_n: DVec3::new(-0.1 * push_n, 0.0, push_n),
            stiffness_n_per_m: DMat3::IDENTITY * stiffness_n_per_m,
            normal: DVec3::Z,
            friction_coefficient: 0.1,
            ..HapticModel::default()
        }
    }

    fn stiffness(x_m: f64) -> f64 {
        120.0 + 8e3 * x_m
    }

    fn slid(depths_m: [f64; 3]) -> (Slide, HapticModel) {
        let [a, b, c] = [0, 1, 2].map(|i| model(i, STEP_M * i as f64, depths_m[i as usize]));
        (Slide::default().next(&a, &b).next(&b, &c), c)
    }

    #[test]
    fn a_tip_that_slides_on_tissue_that_stiffens_feels_it_ahead() {
        let (slide, latest) = slid([0.01; 3]);
        for ways in [0.0, 0.5, 1.0, 2.0] {
            let tip_m = latest.tip_m + DVec3::X * (ways * STEP_M);
            let truth_n = stiffness(tip_m.x) * 0.01;
            let alone_n = latest.force_at(tip_m, 0.0);
            let found_n = slide.force_at(&latest, alone_n, tip_m);
            assert!((found_n.z - truth_n).abs() < 1e-9 * truth_n, "{ways}: {found_n} for {truth_n}");
            assert!(ways == 0.0 || (alone_n.z - truth_n).abs() > 0.02 * truth_n);
            // The drag is looked ahead by one way only.
            assert!((found_n.x + 0.1 * found_n.z).abs() < 8e-3, "{found_n}");
        }
        // Further than it looks, and back behind, it stays.
        let at = |x_m: f64| slide.force_at(&latest, latest.force_n, latest.tip_m + DVec3::X * x_m);
        assert_eq!((at(1.0).z, at(-1.0).z), (at(2.0 * STEP_M).z, at(-2.0 * STEP_M).z));
    }

    #[test]
    fn without_a_slide_or_with_tissue_that_gave_way_nothing_is_added() {
        let far_m = DVec3::X * 1e-3;
        let still = |slide: Slide, latest: &HapticModel| {
            let alone_n = latest.force_at(latest.tip_m + far_m, 0.0);
            slide.force_at(latest, alone_n, latest.tip_m + far_m) == alone_n
        };
        let (a, b) = (model(0, 0.0, 0.01), model(1, 0.0, 0.012));
        assert!(still(Slide::default().next(&a, &b), &b), "straight in");
        let torn = HapticModel { force_n: DVec3::Z * 0.3, ..model(1, STEP_M, 0.01) };
        assert!(still(Slide::default().next(&a, &torn), &torn), "torn");
        let grasped = HapticModel { touch: Touch::Grasp, ..model(1, STEP_M, 0.01) };
        assert!(still(Slide::default().next(&a, &grasped), &grasped));
        let sticky = HapticModel { friction_coefficient: f64::INFINITY, ..model(1, STEP_M, 0.01) };
        assert!(still(Slide::default().next(&a, &sticky), &sticky));
        let (far, again) = (model(1, 0.05, 0.01), HapticModel { time_s: 0.0, ..model(1, STEP_M, 0.01) });
        assert!(still(Slide::default().next(&a, &far), &far), "put elsewhere");
        assert!(still(Slide::default().next(&a, &again), &again), "no time between");
    }

    #[test]
    fn what_is_added_is_bounded_by_stiffness_and_push() {
        // As steep as is still taken for a slide.
        let mut b = model(1, STEP_M, 1e-3);
        b.force_n.z += 1.9 * stiffness(STEP_M) * STEP_M;
        let slide = Slide::default().next(&model(0, 0.0, 1e-3), &b);
        let mut last_n = slide.force_at(&b, b.force_n, b.tip_m - DVec3::X * 3e-3);
        for i in -2999..3000 {
            let found_n = slide.force_at(&b, b.force_n, b.tip_m + DVec3::X * (f64::from(i) * 1e-6));
            assert!((found_n.z - last_n.z).abs() <= stiffness(STEP_M) * 1.001e-6);
            assert!(found_n.z > 0.0 && found_n.z <= 1.5 * b.force_n.z + 1e-12);
            last_n = found_n;
        }
    }
}
