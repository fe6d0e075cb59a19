//! What this machine can do at most, on one core: fused multiply-adds and reads from each level of memory.
//!
//! Peaks come from the quickest tenth of many short runs, so that neither a busy neighbour lowers them nor a
//! glitch of the clock raises them. Fused multiply-add:
//! independent chains, twice as many as two units of latency four need. Reading: the sum of an array that fits
//! the level in question and none below it. The instruction set is chosen when the program runs, as in the
//! library's own kernels.

use std::hint::black_box;

use anyhow::Context;
use fearless_simd::{Level, Simd, dispatch, prelude::*};

use super::timing::{quantile, thread_cpu_ns};

/// Independent chains of multiply-adds, and accumulators of the reading loop.
const N_FMA_CHAINS: usize = 12;
const N_SUMS: usize = 16;
/// Multiply-adds of one chain in one timed run: about 200 microseconds.
const FMA_ROUNDS: usize = 131_072;
/// Cache sizes where the system does not tell.
const FALLBACK_CACHE_BYTES: [usize; 3] = [32 << 10, 1 << 20, 32 << 20];
/// A read array for DRAM is this many times the last cache, ...
const DRAM_CACHES: usize = 2;
/// ... and at most this large.
const MAX_ARRAY_BYTES: usize = 1 << 30;
/// A read of this many bytes is one timed run, if the array is smaller.
const READ_RUN_BYTES: usize = 32 << 20;
const CACHE_LINE_BYTES: usize = 64;

/// Bytes of each cache of the first core.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub(crate) struct CacheBytes {
    /// First level, data.
    pub(crate) l1: usize,
    /// Second level.
    pub(crate) l2: usize,
    /// Third level, perhaps shared.
    pub(crate) l3: usize,
}

/// Gigabytes (1e9) read a second from each level.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub(crate) struct ReadBandwidth {
    /// First level.
    pub(crate) l1: f64,
    /// Second level.
    pub(crate) l2: f64,
    /// Third level.
    pub(crate) l3: f64,
    /// Memory.
    pub(crate) dram: f64,
}

/// What one core can do at most.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Machine {
    /// The processor's name, as it says itself.
    pub(crate) cpu: String,
    /// Best instruction set that the program uses here.
    pub(crate) isa: &'static str,
    /// Cores that this process may use.
    pub(crate) cores: usize,
    /// Sizes of the caches.
    pub(crate) cache_bytes: CacheBytes,
    /// 1e9 operations a second; a fused multiply-add counts as two.
    pub(crate) fma_gflops_f64: f64,
    /// The same in single precision.
    pub(crate) fma_gflops_f32: f64,
    /// 1e9 bytes a second.
    pub(crate) read_gb_per_s: ReadBandwidth,
    /// What is wrong with these numbers, if something is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) note: Option<String>,
}

/// How much effort the peaks are worth.
#[derive(Clone, Copy, Debug)]
pub struct MachineBudget {
    /// Processor time for each of the six peaks [s].
    pub(crate) seconds: f64,
    /// Largest array read [bytes].
    pub(crate) max_array_bytes: usize,
}

impl Default for MachineBudget {
    fn default() -> Self {
        Self { seconds: 0.15, max_array_bytes: MAX_ARRAY_BYTES }
    }
}

impl Machine {
    /// Measures this machine.
    ///
    /// # Errors
    /// When the memory for the largest array is not there.
    pub(crate) fn measure(budget: MachineBudget) -> anyhow::Result<Self> {
        let level = Level::new();
        let caches = cache_bytes();
        let lanes = dispatch!(level, simd => lanes(simd));
        let fma = |lanes: usize, run: &mut dyn FnMut()| {
            let flops = (2 * lanes * N_FMA_CHAINS * FMA_ROUNDS) as f64;
            flops / quick_ns(budget.seconds, run)
        };
        let fma_gflops_f64 = fma(lanes[0], &mut || {
            black_box(dispatch!(level, simd => fma_f64(simd, black_box(FMA_ROUNDS))));
        });
        let fma_gflops_f32 = fma(lanes[1], &mut || {
            black_box(dispatch!(level, simd => fma_f32(simd, black_box(FMA_ROUNDS))));
        });

        let wanted = read_sizes(caches);
        let largest = wanted[3].min(budget.max_array_bytes);
        let n_values = (largest + CACHE_LINE_BYTES) / size_of::<f64>();
        let mut values: Vec<f64> = Vec::new();
        values
            .try_reserve_exact(n_values)
            .with_context(|| format!("no {} MB of memory for the array that measures DRAM", largest >> 20))?;
        values.resize(n_values, 1.0);
        // Loads that straddle cache lines would halve the rate of the first level.
        let start = values.as_ptr().align_offset(CACHE_LINE_BYTES).min(CACHE_LINE_BYTES / size_of::<f64>());
        let read = |bytes: usize| {
            let array = &values[start..start + bytes.min(largest) / size_of::<f64>()];
            let repeats = (READ_RUN_BYTES / size_of_val(array).max(1)).max(1);
            let ns = quick_ns(budget.seconds, &mut || {
                black_box(dispatch!(level, simd => sum(simd, black_box(array), repeats)));
            });
            (repeats * size_of_val(array)) as f64 / ns
        };
        let [l1, l2, l3, dram] = wanted.map(read);
        let note = (wanted[3] > largest).then(|| {
            format!(
                "the array for DRAM has {} MB beside a last cache of {} MB: dram may be a cache's rate",
                largest >> 20,
                caches.l3 >> 20
            )
        });
        Ok(Self {
            cpu: cpu_name(),
            isa: isa_name(level),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            cache_bytes: caches,
            fma_gflops_f64,
            fma_gflops_f32,
            read_gb_per_s: ReadBandwidth { l1, l2, l3, dram },
            note,
        })
    }

    /// Shortest time [ns] in which one core can do `flops` operations and read `bytes` bytes of a working set
    /// of `working_set_bytes`.
    pub(crate) fn limit_ns(&self, work: &super::Work, precision: &str) -> f64 {
        let peak = if precision == "f32" { self.fma_gflops_f32 } else { self.fma_gflops_f64 };
        let (caches, rates) = (self.cache_bytes, self.read_gb_per_s);
        let levels = [(caches.l1, rates.l1), (caches.l2, rates.l2), (caches.l3, rates.l3)];
        let fits = levels.iter().find(|(size, _)| work.working_set_bytes <= *size as f64);
        let rate = fits.map_or(rates.dram, |(_, rate)| *rate);
        (work.flops / peak).max(work.bytes / rate)
    }
}

/// Name of an instruction set level.
pub(crate) fn isa_name(level: Level) -> &'static str {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    match level {
        Level::Avx512(_) => return "avx512",
        Level::Avx2(_) => return "avx2",
        Level::Sse4_2(_) => return "sse4.2",
        Level::Sse2(_) => return "sse2",
        _ => {}
    }
    #[cfg(target_arch = "aarch64")]
    if let Level::Neon(_) = level {
        return "neon";
    }
    let _ = level;
    "portable"
}

/// Time of a call of `run` [ns] that a tenth of the calls do not exceed, within about `seconds` of processor
/// time.
fn quick_ns(seconds: f64, run: &mut dyn FnMut()) -> f64 {
    run();
    let start = thread_cpu_ns();
    let mut samples = Vec::new();
    loop {
        let before = thread_cpu_ns();
        run();
        let after = thread_cpu_ns();
        samples.push((after - before).max(1) as f64);
        if (after - start) as f64 > seconds * 1e9 {
            samples.sort_by(f64::total_cmp);
            return quantile(&samples, 0.1);
        }
    }
}

/// Array sizes whose reading measures L1, L2, L3 and DRAM: well inside each level and outside the one below.
fn read_sizes(caches: CacheBytes) -> [usize; 4] {
    let between = |low: usize, high: usize| (low as f64 * high as f64).sqrt() as usize;
    let sizes = [
        caches.l1 / 2,
        between(caches.l1, caches.l2),
        between(caches.l2, caches.l3),
        (DRAM_CACHES * caches.l3).min(MAX_ARRAY_BYTES),
    ];
    sizes.map(|bytes| bytes / 4096 * 4096)
}

/// Lanes of double and single precision.
#[inline(always)]
fn lanes<S: Simd>(_: S) -> [usize; 2] {
    [S::f64s::LEN, S::f32s::LEN]
}

#[inline(always)]
fn fma_f64<S: Simd>(simd: S, rounds: usize) -> f64 {
    let factor = S::f64s::splat(simd, black_box(0.999_999));
    let term = S::f64s::splat(simd, black_box(1e-6));
    let mut chains = [S::f64s::splat(simd, black_box(1.0)); N_FMA_CHAINS];
    for _ in 0..rounds {
        for chain in &mut chains {
            *chain = chain.mul_add(factor, term);
        }
    }
    chains.iter().map(|chain| chain.as_slice()[0]).sum()
}

#[inline(always)]
fn fma_f32<S: Simd>(simd: S, rounds: usize) -> f32 {
    let factor = S::f32s::splat(simd, black_box(0.999));
    let term = S::f32s::splat(simd, black_box(1e-3));
    let mut chains = [S::f32s::splat(simd, black_box(1.0)); N_FMA_CHAINS];
    for _ in 0..rounds {
        for chain in &mut chains {
            *chain = chain.mul_add(factor, term);
        }
    }
    chains.iter().map(|chain| chain.as_slice()[0]).sum()
}

/// Sum of an array, read `repeats` times; a rest shorter than a round of the loop is left out.
#[inline(always)]
fn sum<S: Simd>(simd: S, values: &[f64], repeats: usize) -> f64 {
    let lanes = S::f64s::LEN;
    let mut sums = [S::f64s::splat(simd, 0.0); N_SUMS];
    for _ in 0..repeats {
        for round in black_box(values).chunks_exact(N_SUMS * lanes) {
            for (sum, part) in sums.iter_mut().zip(round.chunks_exact(lanes)) {
                *sum += S::f64s::from_slice(simd, part);
            }
        }
    }
    sums.iter().flat_map(|sum| sum.as_slice()).sum()
}

/// Sizes of the first core's caches from Linux; constants elsewhere.
fn cache_bytes() -> CacheBytes {
    let mut found = FALLBACK_CACHE_BYTES;
    for index in 0..8 {
        let read = |name: &str| {
            std::fs::read_to_string(format!("/sys/devices/system/cpu/cpu0/cache/index{index}/{name}"))
        };
        let (Ok(level), Ok(kind), Ok(size)) = (read("level"), read("type"), read("size")) else { continue };
        let place = level.trim().parse::<usize>().ok().and_then(|l| l.checked_sub(1)).filter(|&l| l < 3);
        if let (Some(place), Some(bytes)) = (place, parse_size(&size))
            && kind.trim() != "Instruction"
        {
            found[place] = bytes;
        }
    }
    let [l1, l2, l3] = found;
    // A machine without a third level, or one that lies: keep them ascending.
    let l2 = l2.max(2 * l1);
    CacheBytes { l1, l2, l3: l3.max(2 * l2) }
}

/// `48K`, `2M` or plain bytes.
fn parse_size(text: &str) -> Option<usize> {
    let text = text.trim();
    let digits = text.trim_end_matches(['K', 'M', 'G']);
    let unit = match &text[digits.len()..] {
        "" => 1,
        "K" => 1 << 10,
        "M" => 1 << 20,
        "G" => 1 << 30,
        _ => return None,
    };
    digits.parse::<usize>().ok()?.checked_mul(unit).filter(|&bytes| bytes > 0)
}

fn cpu_name() -> String {
    let listing = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = listing.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_caches_are_read_as_linux_writes_them() {
        assert_eq!(parse_size("48K\n"), Some(49_152));
        assert_eq!(parse_size("2M"), Some(2 << 20));
        assert_eq!(parse_size("512"), Some(512));
        assert_eq!((parse_size("0K"), parse_size("big"), parse_size("KK")), (None, None, None));
    }

    #[test]
    fn the_reading_loop_reads_everything() {
        let values: Vec<f64> = (0..4096).map(f64::from).collect();
        let total = dispatch!(Level::new(), simd => sum(simd, &values, 3));
        assert_eq!(total, 3.0 * 4095.0 * 4096.0 / 2.0);
    }

    #[test]
    fn arrays_grow_from_level_to_level_and_fit_theirs() {
        let caches = CacheBytes { l1: 48 << 10, l2: 2 << 20, l3: 260 << 20 };
        let sizes = read_sizes(caches);
        assert!(sizes[0] <= caches.l1 / 2 && sizes[0] > 0);
        assert!(sizes[1] > 2 * caches.l1 && sizes[1] < caches.l2 / 2);
        assert!(sizes[2] > 2 * caches.l2 && sizes[2] < caches.l3 / 2);
        assert_eq!(sizes[3], 520 << 20);
    }
}
