//! The tension of a closed thread of a given length around corners that give way.
//!
//! Corners without the thread are at p0; under forces f on them they are at p = p0 + A f. The thread of tension T pulls each by -T dP/dp,
//! with the perimeter P; so p = p0 - T A dP(p)/dp. T is as great as it takes to make P the wanted length, from zero to a greatest one.
//! Newton's method for both together: with r = p - p0 + T A dP/dp and J = 1 + T A d2P/dp2, the step is -J^-1 r - dT J^-1 A dP/dp, with the
//! dT that makes the perimeter the wanted one. The second derivative counts: without it corners would be thrown off sideways by T over
//! the length of a side, which is stiff beside what moves in a step.

use crate::math::{DMat3, DVec3, outer};
use crate::solve::solve_dense_in_place;

/// Iterations at most, and the step below which they end, over the wanted length: choices.
const MOST_ITERATIONS: usize = 8;
const TOLERANCE: f64 = 1e-6;
/// An iteration moves no corner by more than this share of a mean side: a choice.
const MOST_OF_SIDE: f64 = 0.5;
/// A side e counts as (e2 + s2)^1/2, with s of this share of a mean side: a choice. Corners that meet push each other nowhere then.
const SMOOTH: f64 = 0.05;

/// A closed thread in a step. Nothing in it lasts.
#[derive(Debug)]
pub(super) struct ClosedThread {
    /// The corners without its pull, in their order around [m].
    pub(super) free_m: Vec<DVec3>,
    /// Where they are with its pull of the step before [m].
    pub(super) start_m: Vec<DVec3>,
    /// How they answer: corner i to a force on corner j, by rows [m/N].
    pub(super) answers_m_per_n: Vec<DMat3>,
    /// Where they are with it [m].
    pub(super) corners_m: Vec<DVec3>,
    /// dP/dp of each: against it the thread pulls.
    gradients: Vec<DVec3>,
    matrix: Vec<f64>,
    right: Vec<f64>,
}

impl ClosedThread {
    pub(super) fn with_room_for(n: usize) -> Self {
        Self {
            free_m: Vec::with_capacity(n),
            start_m: Vec::with_capacity(n),
            answers_m_per_n: Vec::with_capacity(n * n),
            corners_m: Vec::with_capacity(n),
            gradients: Vec::with_capacity(n),
            matrix: Vec::with_capacity(9 * n * n),
            right: Vec::with_capacity(6 * n),
        }
    }

    /// Force on a corner for a tension [N].
    pub(super) fn force_n(&self, corner: usize, tension_n: f64) -> DVec3 {
        self.gradients.get(corner).map_or(DVec3::ZERO, |gradient| *gradient * -tension_n)
    }

    /// Mean length of its sides [m].
    pub(super) fn mean_side_m(&self) -> f64 {
        let n = self.corners_m.len();
        let sides_m = (0..n).map(|corner| self.side_m(corner).length());
        (sides_m.sum::<f64>() / n.max(1) as f64).max(f64::MIN_POSITIVE)
    }

    /// From the corner before to each one [m].
    fn side_m(&self, corner: usize) -> DVec3 {
        let n = self.corners_m.len();
        self.corners_m[corner] - self.corners_m[(corner + n - 1) % n]
    }

    /// What is taken from the shape of sides for a thread of this length [m].
    fn smooth_m(&self, length_m: f64) -> f64 {
        SMOOTH * length_m / self.corners_m.len().max(1) as f64
    }

    /// The perimeter [m], and its gradient.
    pub(super) fn measure(&mut self, smooth_m: f64) -> f64 {
        let n = self.corners_m.len();
        self.gradients.clear();
        self.gradients.resize(n, DVec3::ZERO);
        let mut length_m = 0.0;
        for corner in 0..n {
            let side_m = self.side_m(corner);
            let smoothed_m = libm::hypot(side_m.length(), smooth_m);
            length_m += smoothed_m;
            let along = if smoothed_m > 0.0 { side_m / smoothed_m } else { DVec3::ZERO };
            self.gradients[corner] += along;
            self.gradients[(corner + n - 1) % n] -= along;
        }
        length_m
    }

    /// Finds the tension for a length from that of the step before, and from where that takes the corners; leaves them where it pulls
    /// them. Where that is not found in some iterations the tension stays as it was. Allocates nothing.
    pub(super) fn solve(&mut self, wanted_m: f64, before_n: f64, greatest_n: f64) -> f64 {
        let n = self.free_m.len();
        self.corners_m.clear();
        self.corners_m.extend_from_slice(&self.start_m);
        if n < 2 {
            self.gradients.clear();
            return 0.0;
        }
        let smooth_m = self.smooth_m(wanted_m);
        let mut tension_n = before_n.clamp(0.0, greatest_n);
        for _ in 0..MOST_ITERATIONS {
            let length_m = self.measure(smooth_m);
            if tension_n == 0.0 && length_m <= wanted_m {
                // Slack, and nothing moves.
                return 0.0;
            }
            let Some(step_n) = self.find_step(tension_n, (length_m, wanted_m), greatest_n, smooth_m) else {
                break;
            };
            let furthest_m = (0..n).map(|i| self.step_m(i).length()).fold(0.0, f64::max);
            let share = (MOST_OF_SIDE * wanted_m / n as f64 / furthest_m).min(1.0);
            for i in 0..n {
                let step_m = self.step_m(i);
                self.corners_m[i] += step_m * share;
            }
            tension_n = (tension_n + share * step_n).clamp(0.0, greatest_n);
            if furthest_m < TOLERANCE * wanted_m {
                self.measure(smooth_m);
                return tension_n;
            }
        }
        self.corners_m.clear();
        self.corners_m.extend_from_slice(&self.start_m);
        self.measure(smooth_m);
        before_n.clamp(0.0, greatest_n)
    }

    /// The way of a corner in an iteration [m].
    fn step_m(&self, corner: usize) -> DVec3 {
        DVec3::from_slice(&self.right[3 * corner..3 * corner + 3])
    }

    /// Newton's step: of the tension, answered [N], and of the corners, in `right` [m]; none where it is no number.
    fn find_step(
        &mut self,
        tension_n: f64,
        (length_m, wanted_m): (f64, f64),
        greatest_n: f64,
        smooth_m: f64,
    ) -> Option<f64> {
        let n = self.corners_m.len();
        let rows = 3 * n;
        let answer = |i: usize, gradients: &[DVec3]| -> DVec3 {
            let row = &self.answers_m_per_n[n * i..n * (i + 1)];
            row.iter().zip(gradients).map(|(tensor, gradient)| *tensor * *gradient).sum()
        };
        self.right.clear();
        self.right.resize(2 * rows, 0.0);
        for i in 0..n {
            let pulled = answer(i, &self.gradients);
            let off_m = self.corners_m[i] - self.free_m[i] + pulled * tension_n;
            (-off_m).write_to_slice(&mut self.right[3 * i..3 * i + 3]);
            (-pulled).write_to_slice(&mut self.right[rows + 3 * i..rows + 3 * i + 3]);
        }
        self.matrix.clear();
        self.matrix.resize(rows * rows, 0.0);
        for i in 0..rows {
            self.matrix[(rows + 1) * i] = 1.0;
        }
        for corner in 0..n {
            // The side to it: d2P of its two ends is this, with the other sign between them.
            let side_m = self.side_m(corner);
            let smoothed_m = libm::hypot(side_m.length(), smooth_m);
            let along = side_m / smoothed_m;
            let stiffness = (DMat3::IDENTITY - outer(along, along)) * (tension_n / smoothed_m);
            let ends = [(corner + n - 1) % n, corner];
            for i in 0..n {
                let [from, to] = ends.map(|end| self.answers_m_per_n[n * i + end] * stiffness);
                let difference = to - from;
                for (end, sign) in [(ends[0], -1.0), (ends[1], 1.0)] {
                    for a in 0..3 {
                        let column = &mut self.matrix[rows * (3 * end + a) + 3 * i..][..3];
                        let values = (difference.col(a) * sign).to_array();
                        column.iter_mut().zip(values).for_each(|(entry, value)| *entry += value);
                    }
                }
            }
        }
        solve_dense_in_place(rows, &mut self.matrix, &mut self.right, 0.0).ok()?;
        let (of_place, of_tension) = self.right.split_at_mut(rows);
        let slope = |ways: &[f64]| -> f64 {
            let ways = ways.chunks_exact(3).map(DVec3::from_slice);
            self.gradients.iter().zip(ways).map(|(gradient, way)| gradient.dot(way)).sum()
        };
        let (missing_m, yields_m_per_n) = (length_m - wanted_m + slope(of_place), -slope(of_tension));
        let wanted_n = if yields_m_per_n > 0.0 { tension_n + missing_m / yields_m_per_n } else { tension_n };
        let step_n = wanted_n.clamp(0.0, greatest_n) - tension_n;
        of_place.iter_mut().zip(of_tension).for_each(|(way, by_tension)| *way += step_n * *by_tension);
        (step_n.is_finite() && of_place.iter().all(|way| way.is_finite())).then_some(step_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    /// Corners about a circle of 10 mm, each on springs of its own and pulled along by its neighbours.
    fn thread(n: usize, m_per_n: f64, seed: u64) -> ClosedThread {
        let mut random = SeededRandom::new(seed);
        let mut thread = ClosedThread::with_room_for(n);
        for i in 0..n {
            let (sine, cosine) = libm::sincos(std::f64::consts::TAU * i as f64 / n as f64);
            let off = DVec3::from_array([0; 3].map(|_| random.uniform_in(-1e-3, 1e-3)));
            thread.free_m.push(DVec3::new(cosine, sine, 0.0) * 1e-2 + off);
        }
        for i in 0..n {
            for j in 0..n {
                let apart = (i + n - j) % n;
                let share = [1.0, 0.4, 0.1].get(apart.min(n - apart)).copied().unwrap_or(0.0);
                thread.answers_m_per_n.push(DMat3::IDENTITY * (m_per_n * share));
            }
        }
        thread
    }

    #[test]
    fn the_thread_is_as_long_as_wanted_and_all_is_in_balance() {
        for (m_per_n, seed) in [(1e-4, 1), (1e-2, 2), (1.0, 3), (50.0, 4)] {
            let mut thread = thread(12, m_per_n, seed);
            thread.corners_m.clone_from(&thread.free_m);
            thread.start_m.clone_from(&thread.free_m);
            let loose_m = thread.measure(0.0);
            let mut tension_n = 0.0;
            for _ in 0..20 {
                tension_n = thread.solve(0.9 * loose_m, tension_n, 1e3);
            }
            let length_m = thread.measure(thread.smooth_m(0.9 * loose_m));
            assert!((length_m / loose_m - 0.9).abs() < 1e-6, "{m_per_n}: {length_m} of {loose_m}");
            assert!(tension_n > 0.0);
            let n = thread.free_m.len();
            for i in 0..n {
                let forces = (0..n).map(|j| thread.answers_m_per_n[n * i + j] * thread.force_n(j, tension_n));
                let at_m = thread.free_m[i] + forces.sum::<DVec3>();
                assert!(at_m.distance(thread.corners_m[i]) < 1e-6, "{m_per_n}: corner {i}");
            }
            // Of itself it pulls nowhere.
            let sum_n: DVec3 = (0..n).map(|i| thread.force_n(i, tension_n)).sum();
            assert!(sum_n.length() < 1e-12 * tension_n);
        }
    }

    #[test]
    fn a_slack_thread_pulls_nothing_and_none_pulls_more_than_it_may() {
        let mut thread = thread(9, 1e-2, 5);
        thread.start_m.clone_from(&thread.free_m);
        assert_eq!(thread.solve(1.0, 0.3, 2.0), 0.0);
        let mut ways_m = thread.corners_m.iter().zip(&thread.free_m).map(|(now, free)| now.distance(*free));
        assert!(ways_m.all(|way_m| way_m < 1e-12));
        for _ in 0..20 {
            assert!(thread.solve(1e-3, 0.05, 0.05) <= 0.05);
        }
        assert_eq!(thread.solve(1e-3, 0.05, 0.05), 0.05);
    }
}
