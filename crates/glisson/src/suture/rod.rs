//! A thread as an elastic rod: nodes at equal distances, segments that stretch, nodes that bend.
//!
//! With segments e of rest length l,
//!
//! stretch: EA/(2 l) (|e| - l)^2, bending: EI/(2 l^3) |x(i-1) - 2 x(i) + x(i+1)|^2,
//!
//! which for segments of their rest length is EI/l (1 - cos of the angle between them): the discrete elastic rod that is straight at
//! rest and does not resist twist (M. Bergou, M. Wardetzky, S. Robinson, B. Audoly and E. Grinspun 2008, Discrete elastic rods,
//! doi 10.1145/1360612.1360662, of which the bending energy differs from the fourth power of the angle on).

use super::banded::Banded;
use crate::math::{DMat3, DVec3, outer};

/// What a piece of thread is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RodMaterial {
    /// EA [N].
    pub axial_stiffness_n: f64,
    /// EI [N m2].
    pub bending_stiffness_n_m2: f64,
    /// Mass over length [kg/m].
    pub linear_density_kg_per_m: f64,
}

/// A place on a thread: a mean of three nodes that follow each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RodPlace {
    /// The first of the three.
    pub(super) first: usize,
    /// Their weights, of sum one.
    pub(super) weights: [f64; 3],
}

impl RodPlace {
    /// In a segment of a thread of so many nodes, as a share of its way.
    pub fn on_segment(n_nodes: usize, segment: usize, share: f64) -> Self {
        if segment + 2 < n_nodes {
            Self { first: segment, weights: [1.0 - share, share, 0.0] }
        } else {
            Self { first: n_nodes - 3, weights: [0.0, 1.0 - share, share] }
        }
    }

    /// Where it is [m].
    pub fn point_m(self, positions_m: &[DVec3]) -> DVec3 {
        self.of_nodes().map(|(node, weight)| positions_m[node] * weight).sum()
    }

    /// Its nodes and their weights.
    pub(super) fn of_nodes(self) -> impl Iterator<Item = (usize, f64)> {
        self.weights.into_iter().enumerate().map(move |(i, weight)| (self.first + i, weight))
    }

    /// Whether a segment is among those that it lies in, or beside them.
    pub(super) fn is_beside(self, segment: usize) -> bool {
        (self.first..=self.first + 2).contains(&(segment + 1))
    }
}

/// A thread and how it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Rod {
    /// Where the nodes are [m].
    pub positions_m: Vec<DVec3>,
    /// How fast they move [m/s].
    pub velocities_m_per_s: Vec<DVec3>,
    /// Rest length of each segment [m].
    spacing_m: f64,
    radius_m: f64,
    /// EA/l of each segment [N/m].
    stretch_n_per_m: Vec<f64>,
    /// EI/l^3 of each node [N/m]; none at the ends.
    bend_n_per_m: Vec<f64>,
    mass_kg: Vec<f64>,
}

impl Rod {
    /// A thread at rest along a path, whose segments are as long as its pieces on average; `material` tells that of each segment.
    ///
    /// # Panics
    /// With fewer than three nodes.
    pub fn new(
        positions_m: Vec<DVec3>,
        spacing_m: f64,
        radius_m: f64,
        material: impl Fn(usize) -> RodMaterial,
    ) -> Self {
        let n = positions_m.len();
        assert!(n >= 3, "a thread of {n} nodes");
        let stretch = |i: usize| material(i).axial_stiffness_n / spacing_m;
        let bend = |i: usize| match i {
            0 => 0.0,
            i if i + 1 == n => 0.0,
            // Where two materials meet the softer one bends.
            i => {
                let both = [i - 1, i].map(|segment| material(segment).bending_stiffness_n_m2);
                both[0].min(both[1]) / spacing_m.powi(3)
            }
        };
        let half_kg = |i: usize| 0.5 * spacing_m * material(i).linear_density_kg_per_m;
        let mass = |i: usize| {
            let before = if i > 0 { half_kg(i - 1) } else { 0.0 };
            before + if i + 1 < n { half_kg(i) } else { 0.0 }
        };
        Self {
            velocities_m_per_s: vec![DVec3::ZERO; n],
            spacing_m,
            radius_m,
            stretch_n_per_m: (0..n - 1).map(stretch).collect(),
            bend_n_per_m: (0..n).map(bend).collect(),
            mass_kg: (0..n).map(mass).collect(),
            positions_m,
        }
    }

    /// Number of nodes.
    pub fn n_nodes(&self) -> usize {
        self.positions_m.len()
    }

    /// Rest length of a segment [m].
    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Length at rest [m].
    pub fn length_m(&self) -> f64 {
        self.spacing_m * (self.n_nodes() - 1) as f64
    }

    /// Radius [m].
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// The place at so much of its way from the first node, which is brought into it [m]: on the quadratic B-spline of the nodes, whose
    /// direction does not jump. What slides over a polygon snaps from side to side.
    pub fn place_at(&self, along_m: f64) -> RodPlace {
        let (node, d) = self.nearest(along_m);
        let (before, after) = (0.5 - d, 0.5 + d);
        RodPlace { first: node - 1, weights: [0.5 * before * before, 0.75 - d * d, 0.5 * after * after] }
    }

    /// The place of a node.
    pub fn place_of(&self, node: usize) -> RodPlace {
        let first = node.saturating_sub(1).min(self.n_nodes() - 3);
        RodPlace { first, weights: [0, 1, 2].map(|i| if first + i == node { 1.0 } else { 0.0 }) }
    }

    /// The inner node nearest to a place, and how far beyond it that is, in segments.
    fn nearest(&self, along_m: f64) -> (usize, f64) {
        let last = self.n_nodes() - 1;
        let along = (along_m / self.spacing_m).clamp(0.0, last as f64);
        let node = (along.round() as usize).clamp(1, last - 1);
        (node, along - node as f64)
    }

    /// Direction at so much of its way; zero where there is none.
    pub fn direction_at(&self, along_m: f64) -> DVec3 {
        let (node, d) = self.nearest(along_m);
        let [a, b, c] = [node - 1, node, node + 1].map(|i| self.positions_m[i]);
        (a * (d - 0.5) - b * (2.0 * d) + c * (d + 0.5)).normalize_or_zero()
    }

    /// Pull in a segment [N]; negative where it is pressed.
    pub fn tension_n(&self, segment: usize) -> f64 {
        let length_m = self.positions_m[segment].distance(self.positions_m[segment + 1]);
        self.stretch_n_per_m[segment] * (length_m - self.spacing_m)
    }

    /// Masses [kg].
    pub(super) fn mass_kg(&self) -> &[f64] {
        &self.mass_kg
    }

    /// Energy of stretch and bending at these places [J].
    #[cfg(test)]
    pub(super) fn energy_j(&self, positions_m: &[DVec3]) -> f64 {
        let mut sum_j = 0.0;
        for (i, pair) in positions_m.windows(2).enumerate() {
            let longer_m = pair[0].distance(pair[1]) - self.spacing_m;
            sum_j += 0.5 * self.stretch_n_per_m[i] * longer_m * longer_m;
        }
        for (i, three) in positions_m.windows(3).enumerate() {
            let bent_m = three[0] - three[1] * 2.0 + three[2];
            sum_j += 0.5 * self.bend_n_per_m[i + 1] * bent_m.length_squared();
        }
        sum_j
    }

    /// Adds the gradient of that energy [N].
    pub(super) fn add_gradient(&self, positions_m: &[DVec3], gradient_n: &mut [DVec3]) {
        for (i, pair) in positions_m.windows(2).enumerate() {
            let edge_m = pair[1] - pair[0];
            let pull_n =
                edge_m.normalize_or_zero() * (self.stretch_n_per_m[i] * (edge_m.length() - self.spacing_m));
            gradient_n[i] -= pull_n;
            gradient_n[i + 1] += pull_n;
        }
        for (i, three) in positions_m.windows(3).enumerate() {
            let force_n = (three[0] - three[1] * 2.0 + three[2]) * self.bend_n_per_m[i + 1];
            gradient_n[i] += force_n;
            gradient_n[i + 1] -= force_n * 2.0;
            gradient_n[i + 2] += force_n;
        }
    }

    /// Adds the Hessian of that energy [N/m], without what pressed segments would take from it.
    pub(super) fn add_hessian(&self, positions_m: &[DVec3], tension_n: &[f64], matrix: &mut Banded) {
        for (i, pair) in positions_m.windows(2).enumerate() {
            let edge_m = pair[1] - pair[0];
            let (length_m, along) = (edge_m.length(), edge_m.normalize_or_zero());
            let k = self.stretch_n_per_m[i];
            let across = tension_n[i].max(0.0) / length_m.max(f64::MIN_POSITIVE);
            let along_along = outer(along, along);
            let tensor = along_along * k + (DMat3::IDENTITY - along_along) * across;
            matrix.add(i, i, tensor);
            matrix.add(i + 1, i + 1, tensor);
            matrix.add(i + 1, i, -tensor);
        }
        const SHARES: [f64; 3] = [1.0, -2.0, 1.0];
        for i in 1..positions_m.len() - 1 {
            for (a, of) in SHARES.into_iter().enumerate() {
                for (b, by) in SHARES.into_iter().enumerate().take(a + 1) {
                    let tensor = DMat3::from_diagonal(DVec3::splat(self.bend_n_per_m[i] * of * by));
                    matrix.add(i - 1 + a, i - 1 + b, tensor);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    const THREAD: RodMaterial =
        RodMaterial { axial_stiffness_n: 100.0, bending_stiffness_n_m2: 1e-8, linear_density_kg_per_m: 6e-5 };

    fn crooked(n: usize) -> Rod {
        let mut random = SeededRandom::new(9);
        let mut at = |i: usize| {
            let off = DVec3::from_array([0; 3].map(|_| random.uniform_in(-4e-4, 4e-4)));
            DVec3::X * (2.05e-3 * i as f64) + off
        };
        let positions_m = (0..n).map(&mut at).collect();
        Rod::new(positions_m, 2e-3, 1.5e-4, |_| THREAD)
    }

    #[test]
    fn the_gradient_is_that_of_the_energy_and_the_hessian_of_a_taut_thread_that_of_the_gradient() {
        let rod = crooked(7);
        let mut gradient_n = vec![DVec3::ZERO; 7];
        rod.add_gradient(&rod.positions_m, &mut gradient_n);
        let step_m = 1e-9;
        let mut taut_m = rod.positions_m.clone();
        taut_m.iter_mut().for_each(|p| *p *= 1.2);
        let pulls: Vec<f64> =
            taut_m.windows(2).map(|pair| 100.0 / 2e-3 * (pair[0].distance(pair[1]) - 2e-3)).collect();
        let mut hessian = Banded::with_room_for(7);
        rod.add_hessian(&taut_m, &pulls, &mut hessian);
        hessian.factor();
        for node in 0..7 {
            for axis in 0..3 {
                let moved = |from_m: &[DVec3], by_m: f64| {
                    let mut moved_m = from_m.to_vec();
                    moved_m[node][axis] += by_m;
                    moved_m
                };
                let energy = |by_m| rod.energy_j(&moved(&rod.positions_m, by_m));
                let slope_n = (energy(step_m) - energy(-step_m)) / (2.0 * step_m);
                assert!((slope_n - gradient_n[node][axis]).abs() < 1e-5 * gradient_n[node].length().max(1.0));
            }
        }
        // H d = g(x + d) - g(x) for a small d that leaves the place of the whole as it is not free: solved back.
        let mut random = SeededRandom::new(2);
        let way_m: Vec<DVec3> =
            (0..7).map(|_| DVec3::from_array([0; 3].map(|_| random.uniform_in(-1e-8, 1e-8)))).collect();
        let mut change_n = vec![DVec3::ZERO; 7];
        let there_m: Vec<DVec3> = taut_m.iter().zip(&way_m).map(|(p, d)| *p + *d).collect();
        rod.add_gradient(&there_m, &mut change_n);
        let mut before_n = vec![DVec3::ZERO; 7];
        rod.add_gradient(&taut_m, &mut before_n);
        let mut with_springs = Banded::with_room_for(7);
        rod.add_hessian(&taut_m, &pulls, &mut with_springs);
        (0..7).for_each(|i| with_springs.add(i, i, DMat3::IDENTITY * 1e4));
        with_springs.factor();
        let mut found_m: Vec<DVec3> = (0..7).map(|i| change_n[i] - before_n[i] + way_m[i] * 1e4).collect();
        with_springs.solve(&mut found_m);
        for (found, way) in found_m.iter().zip(&way_m) {
            assert!((*found - *way).length() < 1e-11, "{found} {way}");
        }
    }
}
