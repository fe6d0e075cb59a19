//! How an instrument moved: lengths, movements, rests.

use crate::math::DVec3;
use std::ops::Range;

/// A tip that goes slower than this rests [m/s]: a choice.
pub const REST_M_PER_S: f64 = 5e-3;
/// A movement is faster than [`REST_M_PER_S`] for at least so long [s] ...
const SHORTEST_MOVEMENT_S: f64 = 0.1;
/// ... and a rest of less than this does not end it [s]. Choices.
const SHORTEST_REST_S: f64 = 0.1;

/// Length of a way [m].
pub fn path_length_m(points_m: &[DVec3]) -> f64 {
    points_m.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
}

/// Sum of the angles by which a direction turned [rad].
pub fn angular_path_rad(directions: &[DVec3]) -> f64 {
    directions.windows(2).map(|pair| angle_rad(pair[0], pair[1])).sum()
}

/// Exact for small angles, too.
fn angle_rad(a: DVec3, b: DVec3) -> f64 {
    libm::atan2(a.cross(b).length(), a.dot(b))
}

/// Way along the instrument's own axis [m], in and out: "depth perception" of Chmarra et al. 2010, doi 10.1007/s00464-009-0721-y.
pub fn depth_path_m(tips_m: &[DVec3], shafts: &[DVec3]) -> f64 {
    let along = |(tips, shafts): (&[DVec3], &[DVec3])| {
        (tips[1] - tips[0]).dot((shafts[0] + shafts[1]).normalize_or(shafts[0])).abs()
    };
    tips_m.windows(2).zip(shafts.windows(2)).map(along).sum()
}

/// Speed from each sample to the next [m/s].
pub fn speeds_m_per_s(points_m: &[DVec3], period_s: f64) -> Vec<f64> {
    points_m.windows(2).map(|pair| pair[0].distance(pair[1]) / period_s).collect()
}

/// Movements: stretches of `speeds` that are faster than a rest. The last one may end with the record.
pub fn movements(speeds_m_per_s: &[f64], period_s: f64) -> Vec<Range<usize>> {
    let samples = |time_s: f64| (time_s / period_s).round().max(1.0) as usize;
    let (shortest, rest) = (samples(SHORTEST_MOVEMENT_S), samples(SHORTEST_REST_S));
    let mut found: Vec<Range<usize>> = Vec::new();
    for (at, speed) in speeds_m_per_s.iter().enumerate() {
        if *speed < REST_M_PER_S {
            continue;
        }
        match found.last_mut() {
            Some(last) if at - last.end < rest => last.end = at + 1,
            _ => found.push(at..at + 1),
        }
    }
    found.retain(|movement| movement.len() >= shortest);
    found
}

/// Free ways: stretches of `speeds` in which an instrument is not at work, from where it begins to move to where it comes to rest
/// for the last time, stops on the way included. `works` are those of the samples, one more than speeds. What is shorter than a
/// movement is none.
pub fn free_ways(speeds_m_per_s: &[f64], works: &[bool], period_s: f64) -> Vec<Range<usize>> {
    let shortest = (SHORTEST_MOVEMENT_S / period_s).round().max(1.0) as usize;
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut is_open = false;
    for (at, speed) in speeds_m_per_s.iter().enumerate() {
        if works[at] || works[at + 1] {
            is_open = false;
        } else if *speed >= REST_M_PER_S {
            match found.last_mut() {
                Some(last) if is_open => last.end = at + 1,
                _ => found.push(at..at + 1),
            }
            is_open = true;
        }
    }
    found.retain(|way| way.len() >= shortest);
    found
}

/// How straight ways were: the distances from their beginnings to their ends over their lengths, 1 for straight lines. None without
/// any.
pub fn economy(points_m: &[DVec3], ways: &[Range<usize>]) -> Option<f64> {
    let chords = ways.iter().map(|way| points_m[way.start].distance(points_m[way.end]));
    let paths = ways.iter().map(|way| path_length_m(&points_m[way.start..=way.end]));
    let (chords_m, paths_m) = (chords.sum::<f64>(), paths.sum::<f64>());
    (paths_m > 0.0).then(|| chords_m / paths_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A quarter of a circle of radius 0.1 m about the origin in 1 s, as seen 100 times a second.
    fn quarter() -> Vec<DVec3> {
        let at = |i: i32| libm::sincos(f64::from(i) / 100.0 * PI / 2.0);
        (0..=100).map(at).map(|(s, c)| DVec3::new(c, s, 0.0) * 0.1).collect()
    }

    #[test]
    fn lengths_of_a_quarter_of_a_circle() {
        let points_m = quarter();
        // Chords instead of the arc.
        let expected_m = 100.0 * 0.2 * libm::sin(PI / 400.0);
        assert!((path_length_m(&points_m) - expected_m).abs() < 1e-12);
        let shafts: Vec<DVec3> = points_m.iter().map(|p| p.normalize()).collect();
        assert!((angular_path_rad(&shafts) - PI / 2.0).abs() < 1e-12);
        // Around the pivot nothing goes along the shaft; along it all does.
        assert!(depth_path_m(&points_m, &shafts) < 1e-12);
        let along: Vec<DVec3> = [0.0, 0.03, 0.01].map(|x| DVec3::X * x).to_vec();
        assert!((depth_path_m(&along, &[DVec3::X; 3]) - 0.05).abs() < 1e-12);
        let movements = movements(&speeds_m_per_s(&points_m, 0.01), 0.01);
        assert_eq!(movements, std::iter::once(0..100).collect::<Vec<_>>());
        let economy = economy(&points_m, &movements).unwrap();
        assert!((economy - 0.1 * libm::sqrt(2.0) / expected_m).abs() < 1e-12);
    }

    #[test]
    fn free_ways_go_from_touch_to_touch_with_their_stops() {
        let mut speeds = vec![0.0; 200];
        speeds[10..40].fill(0.05);
        speeds[90..110].fill(0.05);
        speeds[150..170].fill(0.05);
        let mut touches = vec![false; 201];
        let ways = |touches: &[bool]| free_ways(&speeds, touches, 0.01);
        assert_eq!(ways(&touches), std::iter::once(10..170).collect::<Vec<_>>());
        touches[100..=130].fill(true);
        assert_eq!(ways(&touches), [10..99, 150..170]);
        touches.fill(true);
        assert!(ways(&touches).is_empty());
    }

    #[test]
    fn movements_end_with_rests_and_not_with_moments() {
        let fast = 0.05;
        let mut speeds = vec![0.0; 200];
        speeds[10..40].fill(fast);
        // 90 ms of rest go by; 100 ms do not.
        speeds[49..60].fill(fast);
        speeds[70..90].fill(fast);
        // Too short for a movement.
        speeds[120..129].fill(fast);
        speeds[190..200].fill(fast);
        assert_eq!(movements(&speeds, 0.01), [10..60, 70..90, 190..200]);
        assert!(movements(&vec![0.004; 300], 0.01).is_empty());
        assert_eq!(economy(&[], &[]), None);
    }
}
