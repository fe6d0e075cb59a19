//! Which moments of a session are frames of its film.

/// What is a step's rounding, as a part of a frame's time.
const ROUNDING: f64 = 1e-6;

/// Counts the frames of a film, at equal times of the session.
#[derive(Clone, Copy, Debug)]
pub struct FrameClock {
    /// Where the film begins and ends in the session [s].
    span_s: [f64; 2],
    frames_per_s: f64,
    n: u64,
}

impl FrameClock {
    /// A film of `span_s` of a session [s], `speed` times as fast, of `rate_hz` frames a second.
    pub fn new(span_s: [f64; 2], speed: f64, rate_hz: f64) -> Self {
        Self { span_s, frames_per_s: rate_hz / speed, n: 0 }
    }

    /// How many frames show the step that ends at `time_s`: those since the step before.
    pub fn due(&mut self, time_s: f64) -> u64 {
        let [from_s, to_s] = self.span_s;
        let since_s = time_s.min(to_s) - from_s;
        // Where the film begins within a step, that is its first frame.
        let n = if since_s < 0.0 { 0 } else { (since_s * self.frames_per_s + ROUNDING).floor() as u64 + 1 };
        let due = n.saturating_sub(self.n);
        self.n += due;
        due
    }

    /// Frames so far.
    pub fn n_frames(&self) -> u64 {
        self.n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(span_s: [f64; 2], speed: f64, rate_hz: f64, step_s: f64, n_steps: u64) -> Vec<u64> {
        let mut clock = FrameClock::new(span_s, speed, rate_hz);
        let due: Vec<u64> = (1..=n_steps).map(|i| clock.due(i as f64 * step_s)).collect();
        assert_eq!(clock.n_frames(), due.iter().sum::<u64>());
        due
    }

    #[test]
    fn a_second_has_as_many_frames_as_the_rate_says_whatever_the_step() {
        for (step_s, n_steps) in [(0.01, 100), (0.004, 250), (1.0 / 3.0, 3), (0.0002, 5000)] {
            let n: u64 = all([0.0, f64::INFINITY], 1.0, 30.0, step_s, n_steps).iter().sum();
            assert_eq!(n, 31, "steps of {step_s} s");
        }
    }

    #[test]
    fn slow_motion_shows_a_step_more_than_once_and_a_quick_film_leaves_steps_out() {
        assert_eq!(all([0.0, f64::INFINITY], 0.1, 30.0, 0.01, 3), [4, 3, 3]);
        assert_eq!(all([0.0, f64::INFINITY], 3.0, 10.0, 0.1, 7), [1, 0, 1, 0, 0, 1, 0]);
    }

    #[test]
    fn only_the_wanted_part_is_filmed() {
        // From the first step at or after its beginning to its end.
        assert_eq!(all([0.2, 0.4], 1.0, 10.0, 0.1, 6), [0, 1, 1, 1, 0, 0]);
        assert_eq!(all([9.0, 10.0], 1.0, 10.0, 0.1, 6), [0; 6]);
    }
}
