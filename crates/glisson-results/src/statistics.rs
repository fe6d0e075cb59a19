//! Quartiles of a group, where a value lies among them, and learning curves: pure functions.
//!
//! A quartile is the sample quantile of definition 7 of Hyndman and Fan: `Q(p) = x_j + g (x_(j+1) - x_j)` with
//! `(n - 1) p + 1 = j + g`, `j` whole and `0 <= g < 1`, `x_1 <= ... <= x_n`: the ordered values stand at equal distances from
//! p = 0 to p = 1, with straight lines between them. It is the default of R and NumPy. Definitions differ in small groups.
//!
//! Source: R. J. Hyndman and Y. Fan, Sample quantiles in statistical packages, The American Statistician 50 (1996) 361-365,
//! doi 10.1080/00031305.1996.10473566.

use glisson::training::metrics::Better;
use serde::Serialize;

/// Fewer values have no quartiles: each quarter of a group has somebody in it. A choice.
pub const FEWEST_FOR_QUARTILES: usize = 4;

/// What a group's values are like.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quartiles {
    /// The smallest value.
    pub least: f64,
    /// A quarter is below.
    pub first: f64,
    /// The median.
    pub median: f64,
    /// A quarter is above.
    pub third: f64,
    /// The greatest value.
    pub greatest: f64,
}

/// Quartiles of values; none of fewer than [`FEWEST_FOR_QUARTILES`]. What is not finite does not count.
///
/// ```
/// let quartiles = glisson_results::statistics::quartiles(&[4.0, 1.0, 3.0, 2.0]).unwrap();
/// assert_eq!([quartiles.first, quartiles.median, quartiles.third], [1.75, 2.5, 3.25]);
/// ```
pub fn quartiles(values: &[f64]) -> Option<Quartiles> {
    let mut ordered: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    if ordered.len() < FEWEST_FOR_QUARTILES {
        return None;
    }
    ordered.sort_by(f64::total_cmp);
    let [least, first, median, third, greatest] =
        [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| quantile(&ordered, share));
    Some(Quartiles { least, first, median, third, greatest })
}

/// The quantile of ordered values, at least one, at a share from 0 to 1.
fn quantile(ordered: &[f64], share: f64) -> f64 {
    let place = (ordered.len() - 1) as f64 * share;
    let (below, between) = (place.floor() as usize, place.fract());
    let above = (below + 1).min(ordered.len() - 1);
    // Between equal values rounding must not leave them.
    (ordered[below] + between * (ordered[above] - ordered[below])).clamp(ordered[below], ordered[above])
}

/// Where a value lies among a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// Below the first quartile.
    Below,
    /// From the first to the third quartile, both among them.
    Within,
    /// Above the third quartile.
    Above,
}

/// What a place means, where less or more is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Better than the middle half of the group.
    Better,
    /// As the middle half.
    As,
    /// Worse than the middle half.
    Worse,
}

impl Quartiles {
    /// Where a value lies; none for one that is no number.
    pub fn place(&self, value: f64) -> Option<Place> {
        match value {
            value if value < self.first => Some(Place::Below),
            value if value > self.third => Some(Place::Above),
            value if value.is_nan() => None,
            _ => Some(Place::Within),
        }
    }
}

impl Place {
    /// Whether that is good; none for a metric that only describes.
    pub fn standing(self, better: Better) -> Option<Standing> {
        match (self, better) {
            (_, Better::Neither) => None,
            (Self::Within, _) => Some(Standing::As),
            (Self::Below, Better::Less) | (Self::Above, Better::More) => Some(Standing::Better),
            (Self::Below, Better::More) | (Self::Above, Better::Less) => Some(Standing::Worse),
        }
    }
}

impl Standing {
    /// For people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::As => "as the group",
            Self::Worse => "worse",
        }
    }
}

/// A metric over the attempts of one person at one task.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LearningCurve {
    /// Attempt's number, from 1, and value. Attempts that were not done have a number and no point: who breaks off early is
    /// not fast.
    pub points: Vec<(usize, f64)>,
    /// Attempts in all.
    pub n_attempts: usize,
    /// Of the group beside it, if there is one of enough people.
    pub band: Option<Quartiles>,
}

/// The curve of values by attempt, in the order of time: none where an attempt was not done or the metric has no meaning.
pub fn learning_curve(values: &[Option<f64>], band: Option<Quartiles>) -> LearningCurve {
    let numbered = (1..).zip(values);
    let points = numbered.filter_map(|(attempt, value)| value.map(|value| (attempt, value)));
    let points = points.filter(|(_, value)| value.is_finite()).collect();
    LearningCurve { points, n_attempts: values.len(), band }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn five(values: &[f64]) -> [f64; 5] {
        let Quartiles { least, first, median, third, greatest } = quartiles(values).unwrap();
        [least, first, median, third, greatest]
    }

    #[test]
    fn quartiles_are_those_computed_by_hand() {
        // n = 4: places 0.75, 1.5, 2.25 of 0 to 3. n = 5: places 1, 2, 3. n = 6: places 1.25, 2.5, 3.75.
        assert_eq!(five(&[1.0, 2.0, 3.0, 4.0]), [1.0, 1.75, 2.5, 3.25, 4.0]);
        assert_eq!(five(&[50.0, 10.0, 40.0, 20.0, 30.0]), [10.0, 20.0, 30.0, 40.0, 50.0]);
        assert_eq!(five(&[0.0, 4.0, 8.0, 16.0, 32.0, 64.0]), [0.0, 5.0, 12.0, 28.0, 64.0]);
        assert_eq!(five(&[-3.0; 7]), [-3.0; 5]);
        assert_eq!(five(&[1.0, f64::NAN, 2.0, f64::INFINITY, 3.0, 4.0]), [1.0, 1.75, 2.5, 3.25, 4.0]);
    }

    #[test]
    fn fewer_than_four_values_have_none() {
        assert_eq!(quartiles(&[]), None);
        assert_eq!(quartiles(&[1.0, 2.0, 3.0]), None);
        assert_eq!(quartiles(&[1.0, 2.0, 3.0, f64::NAN]), None);
    }

    #[test]
    fn a_place_is_good_or_not_by_the_metric() {
        let quartiles = quartiles(&[1.0, 2.0, 3.0, 4.0]).unwrap();
        for (value, place, less, more) in [
            (1.7, Place::Below, Standing::Better, Standing::Worse),
            (1.75, Place::Within, Standing::As, Standing::As),
            (3.25, Place::Within, Standing::As, Standing::As),
            (3.3, Place::Above, Standing::Worse, Standing::Better),
        ] {
            assert_eq!(quartiles.place(value), Some(place), "{value}");
            assert_eq!(place.standing(Better::Less), Some(less), "{value}");
            assert_eq!(place.standing(Better::More), Some(more), "{value}");
            assert_eq!(place.standing(Better::Neither), None, "{value}");
        }
        assert_eq!(quartiles.place(f64::NAN), None);
    }

    #[test]
    fn an_attempt_that_was_not_done_has_a_number_and_no_point() {
        let curve = learning_curve(&[Some(9.0), None, Some(7.0), Some(f64::NAN)], None);
        assert_eq!((curve.points, curve.n_attempts), (vec![(1, 9.0), (3, 7.0)], 4));
    }

    proptest! {
        #[test]
        fn quartiles_divide_a_group_and_follow_its_scale(
            mut values in prop::collection::vec(-1e6_f64..1e6, 4..60),
            scale in 0.01_f64..100.0,
            offset in -1e3_f64..1e3,
            turn in 0_usize..60,
        ) {
            let found = five(&values);
            prop_assert!(found.is_sorted());
            let n = values.len();
            let below = values.iter().filter(|value| **value < found[1]).count();
            let above = values.iter().filter(|value| **value > found[3]).count();
            // Definition 7 puts floor(h) + 1 values at or below the place h.
            prop_assert!(4 * below <= n + 2 && 4 * above <= n + 2, "{below} and {above} of {n}");
            let moved: Vec<f64> = values.iter().map(|value| scale * value + offset).collect();
            for (a, b) in found.iter().zip(five(&moved)) {
                prop_assert!((scale * a + offset - b).abs() <= 1e-9 * (1.0 + (scale * a).abs() + offset.abs()));
            }
            let mirrored: Vec<f64> = values.iter().map(|value| -value).collect();
            for (a, b) in found.iter().zip(five(&mirrored).iter().rev()) {
                prop_assert!((a + b).abs() <= 1e-9 * (1.0 + a.abs()));
            }
            values.rotate_left(turn % n);
            prop_assert_eq!(five(&values), found);
        }
    }
}
