//! Central differences on the nodes of a part, two nodes per vector, with the energies of the step.

use super::lanes::Lanes;
use super::part::PartNodes;
use super::rows::{LaneNumbers, N_LANES, Row};
use super::step::{ROW_LANES, StepFactors, StepSums};

/// Displacements and increments below this [m] are set to zero. Otherwise a damped body would come to rest through
/// subnormal numbers (the cubes of its strains first), with which processors compute slowly.
const LEAST_M: f64 = 1e-90;

impl PartNodes {
    /// Moves the nodes by the summed forces, some rows at a time. Each of the eight lanes has its own sums, so the result does
    /// not depend on the number of lanes of a path.
    #[inline(always)]
    pub(super) fn advance<V: Lanes>(&mut self, factors: &StepFactors, any: V) {
        let n_groups = self.displacement_m.len() * ROW_LANES / N_LANES;
        let Self {
            displacement_m,
            increment_m,
            force_n,
            outer_n,
            inverse_mass_per_kg,
            moving_inertia_kg,
            ..
        } = self;
        let groups = Groups {
            u: &mut grouped_mut(displacement_m)[..n_groups],
            increment_m: &mut grouped_mut(increment_m)[..n_groups],
            balance_n: &grouped(force_n)[..n_groups],
            outer_n: &grouped(outer_n)[..n_groups],
            inverse_mass_per_kg: &grouped(inverse_mass_per_kg)[..n_groups],
            moving_inertia_kg: &grouped(moving_inertia_kg)[..n_groups],
        };
        self.sums = groups.advance(factors, any);
    }
}

fn grouped(rows: &[Row]) -> &[LaneNumbers] {
    bytemuck::cast_slice(rows)
}

fn grouped_mut(rows: &mut [Row]) -> &mut [LaneNumbers] {
    bytemuck::cast_slice_mut(rows)
}

/// The rows of a part's nodes, [`GROUP_ROWS`] at a time; slices of one length.
struct Groups<'a> {
    u: &'a mut [LaneNumbers],
    increment_m: &'a mut [LaneNumbers],
    balance_n: &'a [LaneNumbers],
    outer_n: &'a [LaneNumbers],
    inverse_mass_per_kg: &'a [LaneNumbers],
    moving_inertia_kg: &'a [LaneNumbers],
}

impl Groups<'_> {
    #[inline(always)]
    fn advance<V: Lanes>(self, factors: &StepFactors, any: V) -> StepSums {
        let Self { u, increment_m, balance_n, outer_n, inverse_mass_per_kg, moving_inertia_kg } = self;
        let n = u.len();
        let (increment_m, balance_n, outer_n) = (&mut increment_m[..n], &balance_n[..n], &outer_n[..n]);
        let (inverse_mass_per_kg, moving_inertia_kg) = (&inverse_mass_per_kg[..n], &moving_inertia_kg[..n]);
        let (keep, push_s2) = (any.constant(factors.keep), any.constant(factors.push_s2));
        let stretch = any.constant(factors.stretch);
        let (zero, least_m) = (any.constant(0.0), any.constant(LEAST_M));
        let infinity = any.constant(f64::INFINITY);
        let all = (1 << V::COUNT) - 1;
        // Twice the energies, without their common factors, lane by lane.
        let (mut before, mut after, mut work) = ([zero; N_LANES], [zero; N_LANES], [zero; N_LANES]);
        let mut n_recovered = 0;
        for i in 0..n {
            let mut is_finite = true;
            let (mut olds, mut news, mut places) = ([zero; N_LANES], [zero; N_LANES], [zero; N_LANES]);
            for k in 0..N_LANES / V::COUNT {
                let lane = k * V::COUNT;
                let load = |numbers: &LaneNumbers| zero.load(numbers, lane);
                let inverse_mass = load(&inverse_mass_per_kg[i]);
                let moves = inverse_mass.above_bits(zero);
                let old = load(&increment_m[i]).chosen(moves, zero);
                let net_n = load(&outer_n[i]).minus(load(&balance_n[i]));
                let moved = push_s2.times(inverse_mass).fused(net_n, keep.times(old));
                // Not `above`: a value that is not a number stays so, and is found below.
                let new = moved.chosen(moves & !least_m.above_bits(moved.magnitude()), zero);
                let place = load(&u[i]).plus(new);
                let distance = place.magnitude();
                let place = place.chosen(all & !least_m.above_bits(distance), zero);
                is_finite &= infinity.above_bits(distance) == all;
                (olds[k], news[k], places[k]) = (old, new, place);
            }
            if !is_finite {
                n_recovered += recover(&mut news, &mut places, &u[i]);
            }
            for k in 0..N_LANES / V::COUNT {
                let lane = k * V::COUNT;
                let load = |numbers: &LaneNumbers| zero.load(numbers, lane);
                let (old, new) = (olds[k], news[k]);
                places[k].store(&mut u[i], lane);
                new.store(&mut increment_m[i], lane);
                let inertia = load(&moving_inertia_kg[i]);
                before[k] = inertia.times(old).fused(old, before[k]);
                after[k] = inertia.times(new).fused(new, after[k]);
                work[k] = load(&outer_n[i]).fused(stretch.fused(old, new), work[k]);
            }
        }
        let [before_s2, after_s2] = factors.per_square_s2;
        StepSums {
            kinetic_before_j: 0.5 * before_s2 * sum_of_lanes(&before),
            kinetic_after_j: 0.5 * after_s2 * sum_of_lanes(&after),
            outer_work_j: 0.5 * sum_of_lanes(&work),
            n_recovered,
        }
    }
}

/// The sum of eight lanes, in their order.
#[inline(always)]
fn sum_of_lanes<V: Lanes>(vectors: &[V; N_LANES]) -> f64 {
    lanes_of(vectors).iter().sum()
}

#[inline(always)]
fn lanes_of<V: Lanes>(vectors: &[V; N_LANES]) -> LaneNumbers {
    let mut numbers = [0.0; N_LANES];
    for k in 0..N_LANES / V::COUNT {
        vectors[k].store(&mut numbers, k * V::COUNT);
    }
    numbers
}

/// Leaves nodes whose new position is not finite where they were, at rest; returns their number.
#[inline(always)]
fn recover<V: Lanes>(news: &mut [V; N_LANES], places: &mut [V; N_LANES], u: &LaneNumbers) -> u32 {
    let (mut new, mut place) = (lanes_of(news), lanes_of(places));
    let n_recovered = recover_nodes(&mut new, &mut place, u);
    for k in 0..N_LANES / V::COUNT {
        news[k] = news[k].load(&new, k * V::COUNT);
        places[k] = places[k].load(&place, k * V::COUNT);
    }
    n_recovered
}

#[cold]
#[inline(never)]
fn recover_nodes(new: &mut LaneNumbers, place: &mut LaneNumbers, u: &LaneNumbers) -> u32 {
    let mut n_recovered = 0;
    for first in (0..N_LANES).step_by(ROW_LANES) {
        let node = first..first + ROW_LANES;
        if !place[node.clone()].iter().all(|x| x.is_finite()) {
            new[node.clone()].fill(0.0);
            place[node.clone()].copy_from_slice(&u[node]);
            n_recovered += 1;
        }
    }
    n_recovered
}
