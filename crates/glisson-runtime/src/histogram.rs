//! Times counted in fixed arrays that one thread fills and any thread reads: nothing is allocated, nobody waits.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Buckets of an octave: a bucket is at most 1/32 of its value wide.
const PER_OCTAVE_BITS: u32 = 5;
/// Up to 2^36 ns = 69 s; longer times count there.
const LONGEST_NS: u64 = (1 << 36) - 1;
const N_BUCKETS: usize = 1024;

/// How often which time was seen. One thread records; readers see each count at some recent moment.
#[derive(Debug)]
pub struct Histogram {
    counts: Box<[AtomicU32; N_BUCKETS]>,
    greatest_ns: AtomicU64,
}

/// Figures of a histogram [ns].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Percentiles {
    /// Values counted.
    pub n: u64,
    /// Median [ns].
    pub p50_ns: u64,
    /// 99 of 100 are no larger [ns].
    pub p99_ns: u64,
    /// 999 of 1000 are no larger [ns].
    pub p999_ns: u64,
    /// The largest [ns].
    pub greatest_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: Box::new([const { AtomicU32::new(0) }; N_BUCKETS]), greatest_ns: AtomicU64::new(0) }
    }
}

/// Times below 64 ns have a bucket each, then each octave has 32.
fn bucket_of(ns: u64) -> usize {
    let ns = ns.min(LONGEST_NS);
    let octave = (63 - ns.max(1).leading_zeros()).max(PER_OCTAVE_BITS) - PER_OCTAVE_BITS;
    ((octave as usize) << PER_OCTAVE_BITS) + (ns >> octave) as usize
}

/// Longest time that counts in a bucket [ns].
fn end_of_bucket_ns(bucket: usize) -> u64 {
    let octave = (bucket >> PER_OCTAVE_BITS).saturating_sub(1);
    let step = (bucket - (octave << PER_OCTAVE_BITS)) as u64;
    ((step + 1) << octave) - 1
}

impl Histogram {
    /// Counts one time. Only one thread may do this.
    pub fn record(&self, ns: u64) {
        let count = &self.counts[bucket_of(ns)];
        count.store(count.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
        if ns > self.greatest_ns.load(Ordering::Relaxed) {
            self.greatest_ns.store(ns, Ordering::Relaxed);
        }
    }

    /// What was seen so far. A percentile is the end of its bucket: at most 1/32 too much.
    pub fn percentiles(&self) -> Percentiles {
        let counts: Vec<u64> = self.counts.iter().map(|n| u64::from(n.load(Ordering::Relaxed))).collect();
        let n: u64 = counts.iter().sum();
        let greatest_ns = self.greatest_ns.load(Ordering::Relaxed);
        let percentile = |share: f64| {
            let rank = ((n as f64 * share).ceil() as u64).max(1);
            let mut seen = 0;
            let bucket = counts.iter().position(|count| {
                seen += count;
                seen >= rank
            });
            bucket.map_or(0, |bucket| end_of_bucket_ns(bucket).min(greatest_ns))
        };
        Percentiles {
            n,
            p50_ns: percentile(0.5),
            p99_ns: percentile(0.99),
            p999_ns: percentile(0.999),
            greatest_ns,
        }
    }
}

impl Histogram {
    /// How many times were seen from one power of two nanoseconds to the next: its end and the count, from the first to the
    /// last that is not zero.
    pub(crate) fn octaves(&self) -> Vec<(u64, u64)> {
        let mut octaves = [0_u64; 64];
        for (bucket, count) in self.counts.iter().enumerate() {
            let octave = 64 - end_of_bucket_ns(bucket).leading_zeros();
            octaves[octave as usize] += u64::from(count.load(Ordering::Relaxed));
        }
        let first = octaves.iter().position(|&n| n > 0).unwrap_or(0);
        let last = octaves.iter().rposition(|&n| n > 0).map_or(0, |last| last + 1);
        (first..last).map(|octave| (1 << octave, octaves[octave])).collect()
    }
}

/// The greatest of values; 0 if none is greater. One thread raises it, any thread reads it.
#[derive(Debug, Default)]
pub struct GreatestValue(AtomicU64);

impl GreatestValue {
    /// The largest so far; 0 before the first.
    pub fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    /// A value that is no number is left out.
    pub fn raise_to(&self, value: f64) {
        if value > self.get() {
            self.0.store(value.to_bits(), Ordering::Relaxed);
        }
    }
}

impl Percentiles {
    /// With the given unit [ns], as benchmarks print it.
    pub fn to_json(self, unit_ns: f64) -> serde_json::Value {
        let of = |ns: u64| (ns as f64 / unit_ns * 1e3).round() / 1e3;
        serde_json::json!({
            "p50": of(self.p50_ns), "p99": of(self.p99_ns), "p999": of(self.p999_ns), "max": of(self.greatest_ns),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn percentiles_are_those_of_the_sorted_times() {
        let histogram = Histogram::default();
        assert_eq!(histogram.percentiles(), Percentiles::default());
        let mut times: Vec<u64> = (0..10_000_u64).map(|i| i * i % 1_000_003).collect();
        times.iter().for_each(|&ns| histogram.record(ns));
        times.sort_unstable();
        let found = histogram.percentiles();
        for (share, found_ns) in [(0.5, found.p50_ns), (0.99, found.p99_ns), (0.999, found.p999_ns)] {
            let exact_ns = times[(times.len() as f64 * share).ceil() as usize - 1];
            assert!(
                found_ns >= exact_ns && found_ns <= exact_ns + exact_ns / 32,
                "{found_ns} for {exact_ns}"
            );
        }
        assert_eq!((found.n, found.greatest_ns), (10_000, *times.last().unwrap()));
        for (end_ns, count) in histogram.octaves() {
            let inside = times.iter().filter(|&&ns| ns < end_ns && ns >= end_ns / 2).count();
            assert_eq!(count, inside as u64, "up to {end_ns} ns");
        }
        assert_eq!(histogram.octaves().iter().map(|(_, count)| count).sum::<u64>(), 10_000);
    }

    #[test]
    fn the_greatest_value_begins_at_zero_and_only_grows() {
        let greatest = GreatestValue::default();
        for (value, expected) in [(-3.0, 0.0), (0.5, 0.5), (f64::NAN, 0.5), (0.25, 0.5), (2.0, 2.0)] {
            greatest.raise_to(value);
            assert_eq!(greatest.get(), expected);
        }
    }

    proptest! {
        #[test]
        fn every_time_lies_in_its_bucket(ns in prop_oneof![0_u64..200, any::<u64>(), 0_u64..1 << 37]) {
            let (bucket, ns) = (bucket_of(ns), ns.min(LONGEST_NS));
            prop_assert!(bucket < N_BUCKETS);
            prop_assert!(end_of_bucket_ns(bucket) >= ns);
            prop_assert!(bucket == 0 || end_of_bucket_ns(bucket - 1) < ns);
        }
    }
}
