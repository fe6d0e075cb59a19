//! A step of a thread: the least incremental potential, by Newton's method.
//!
//! m |x - y|^2/(2 h^2) + stretch + bending + ties + repulsion + bonds,  y = x(t) + h v(t) + h^2 g
//!
//! The matrix of all but repulsion and bonds reaches from a node to its second neighbours ([`super::banded`]); those join places far
//! apart along the thread, and are some columns beside it (Woodbury's formula). A thread hardly stretches: a step that turns a segment
//! by an angle makes it longer by the square of that, which the next iteration takes back, so that the potential may grow in between;
//! what resists the turn is the pull with which the step began, not that of the way in between. Asking each iteration for a lower
//! potential takes three times as many. No iteration brings the thread through itself. Nothing is allocated once there is room.

use super::banded::Banded;
use super::meeting::{Bond, Pair, allowed_share, find_pairs, repulsion, room_for_pairs};
use super::rod::{Rod, RodPlace};
use super::tie::Tie;
use crate::math::{DMat3, DVec3, outer};
use crate::model::bounded_vec::BoundedVec;
use crate::solve::solve_dense_in_place;

/// Newton iterations at most: a choice; three or four are usual.
const MOST_ITERATIONS: usize = 12;
/// The step ends where no node moves by more than this share of a segment: a choice.
const TOLERANCE: f64 = 1e-4;
/// No node moves further in an iteration than this many segments: a choice, which keeps what may meet to what is near.
const MOST_SEGMENTS: f64 = 1.0;
/// Columns beside the banded matrix, at most: three a bond, one where the thread meets itself.
const MOST_COLUMNS: usize = 36;
/// Velocities fade with this time [s]: a choice, for the blood and fluid that a thread lies in.
const FADES_S: f64 = 0.02;

/// Room for the steps of one thread.
#[derive(Clone, Debug)]
pub struct Solver {
    matrix: Banded,
    gradient_n: Vec<DVec3>,
    step_m: Vec<DVec3>,
    target_m: Vec<DVec3>,
    before_m: Vec<DVec3>,
    /// Pull in each segment when the step began [N].
    tension_n: Vec<f64>,
    pairs: BoundedVec<Pair>,
    columns: BoundedVec<Column>,
    solved: Vec<Vec<DVec3>>,
    small: BoundedVec<f64>,
    right: BoundedVec<f64>,
}

/// A column of what is added to the banded matrix: a spring along a direction between two places.
#[derive(Clone, Copy, Debug)]
struct Column {
    at: [RodPlace; 2],
    along: DVec3,
}

impl Column {
    fn each(&self, mut act: impl FnMut(usize, DVec3)) {
        for (at, sign) in self.at.iter().zip([1.0, -1.0]) {
            at.of_nodes().for_each(|(node, weight)| act(node, self.along * (sign * weight)));
        }
    }

    fn dot(&self, values: &[DVec3]) -> f64 {
        let mut sum = 0.0;
        self.each(|node, entry| sum += entry.dot(values[node]));
        sum
    }
}

/// What surrounds a thread in a step.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// What holds it.
    pub ties: &'a [Tie],
    /// What holds it together.
    pub bonds: &'a [Bond],
    /// Time step [s].
    pub dt_s: f64,
}

impl Solver {
    /// For threads of so many nodes.
    pub fn new(n_nodes: usize) -> Self {
        let zeros = || vec![DVec3::ZERO; n_nodes];
        Self {
            matrix: Banded::with_room_for(n_nodes),
            gradient_n: zeros(),
            step_m: zeros(),
            target_m: zeros(),
            before_m: zeros(),
            tension_n: vec![0.0; n_nodes - 1],
            pairs: BoundedVec::with_capacity(room_for_pairs(n_nodes)),
            columns: BoundedVec::with_capacity(MOST_COLUMNS),
            solved: (0..MOST_COLUMNS).map(|_| zeros()).collect(),
            small: BoundedVec::with_capacity(MOST_COLUMNS * MOST_COLUMNS),
            right: BoundedVec::with_capacity(MOST_COLUMNS),
        }
    }

    /// A step begins: where the thread goes by itself.
    pub fn start(&mut self, rod: &Rod, gravity_m_per_s2: DVec3, dt_s: f64) {
        self.before_m.copy_from_slice(&rod.positions_m);
        for (segment, tension_n) in self.tension_n.iter_mut().enumerate() {
            *tension_n = rod.tension_n(segment);
        }
        let kept = dt_s * FADES_S / (FADES_S + dt_s);
        let fall_m = gravity_m_per_s2 * (dt_s * dt_s);
        for (i, target_m) in self.target_m.iter_mut().enumerate() {
            *target_m = rod.positions_m[i] + rod.velocities_m_per_s[i] * kept + fall_m;
        }
    }

    /// Brings the thread to the least potential under these ties; may be called again with others in the same step.
    pub fn settle(&mut self, rod: &mut Rod, around: &Surroundings<'_>) {
        let spacing_m = rod.spacing_m();
        for _ in 0..MOST_ITERATIONS {
            let most_m = MOST_SEGMENTS * spacing_m;
            find_pairs(&rod.positions_m, (rod.radius_m(), most_m), around.bonds, &mut self.pairs);
            self.find_direction(rod, around);
            if !self.step_m.iter().all(|step_m| step_m.is_finite()) {
                return;
            }
            let longest_m = self.step_m.iter().map(|s| s.length()).fold(0.0, f64::max);
            let free = allowed_share(&self.pairs, &rod.positions_m, &self.step_m, rod.radius_m());
            let share = free.min(most_m / longest_m.max(f64::MIN_POSITIVE));
            for (position_m, step_m) in rod.positions_m.iter_mut().zip(&self.step_m) {
                *position_m += *step_m * share;
            }
            if longest_m * share < TOLERANCE * spacing_m {
                return;
            }
        }
    }

    /// A step ends: how fast the thread moved.
    pub fn finish(&self, rod: &mut Rod, dt_s: f64) {
        for (velocity, (now, before)) in
            rod.velocities_m_per_s.iter_mut().zip(rod.positions_m.iter().zip(&self.before_m))
        {
            *velocity = (*now - *before) / dt_s;
        }
    }

    /// Newton's direction at the thread's place, into `step_m`.
    fn find_direction(&mut self, rod: &Rod, around: &Surroundings<'_>) {
        let positions_m = &rod.positions_m;
        self.matrix.clear();
        let per_s2 = 1.0 / (around.dt_s * around.dt_s);
        for (i, &mass_kg) in rod.mass_kg().iter().enumerate() {
            self.matrix.add(i, i, DMat3::IDENTITY * (mass_kg * per_s2));
            self.gradient_n[i] = (positions_m[i] - self.target_m[i]) * (mass_kg * per_s2);
        }
        rod.add_gradient(positions_m, &mut self.gradient_n);
        rod.add_hessian(positions_m, &self.tension_n, &mut self.matrix);
        for tie in around.ties {
            tie.add_to(positions_m, &mut self.gradient_n, &mut self.matrix);
        }
        self.columns.clear();
        for bond in around.bonds {
            self.add_bond(bond, positions_m);
        }
        for i in 0..self.pairs.len() {
            self.add_repulsion(self.pairs[i], positions_m, rod.radius_m());
        }
        self.matrix.factor();
        for (step_m, gradient_n) in self.step_m.iter_mut().zip(&self.gradient_n) {
            *step_m = -*gradient_n;
        }
        self.matrix.solve(&mut self.step_m);
        self.add_columns();
    }

    fn add_bond(&mut self, bond: &Bond, positions_m: &[DVec3]) {
        let [a, b] = bond.at.map(|at| at.point_m(positions_m));
        let pull_n = (a - b) * bond.stiffness_n_per_m;
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let along = axis * bond.stiffness_n_per_m.sqrt();
            self.add_column(Column { at: bond.at, along });
        }
        let with = Column { at: bond.at, along: DVec3::ONE };
        with.each(|node, entry| self.gradient_n[node] += pull_n * entry);
    }

    fn add_repulsion(&mut self, pair: Pair, positions_m: &[DVec3], radius_m: f64) {
        let near = pair.nearness(positions_m);
        let [_, slope_n, curvature_n_per_m] = repulsion(near.distance_m, radius_m);
        if slope_n == 0.0 {
            return;
        }
        let column = Column { at: near.at, along: near.normal };
        column.each(|node, entry| self.gradient_n[node] += entry * slope_n);
        self.add_column(Column { along: near.normal * curvature_n_per_m.sqrt(), ..column });
    }

    /// A column beside the matrix; without room for it, what it does to each of its two places alone goes into the matrix, twice: a
    /// bound from above of what it does.
    fn add_column(&mut self, column: Column) {
        if self.columns.try_push(column) {
            return;
        }
        let tensor = outer(column.along, column.along) * 2.0;
        for at in column.at {
            for (i, of) in at.of_nodes() {
                for (j, by) in at.of_nodes().filter(|(j, _)| *j <= i) {
                    self.matrix.add(i, j, tensor * (of * by));
                }
            }
        }
    }

    /// From the solution with the banded matrix to that with its columns.
    fn add_columns(&mut self) {
        let n = self.columns.len();
        if n == 0 {
            return;
        }
        for (column, solved) in self.columns.iter().zip(&mut self.solved) {
            solved.fill(DVec3::ZERO);
            column.each(|node, entry| solved[node] += entry);
            self.matrix.solve(solved);
        }
        self.small.clear();
        self.right.clear();
        for j in 0..n {
            for i in 0..n {
                let own = if i == j { 1.0 } else { 0.0 };
                self.small.push(own + self.columns[i].dot(&self.solved[j]));
            }
            self.right.push(self.columns[j].dot(&self.step_m));
        }
        // Its eigenvalues are at least one.
        if solve_dense_in_place(n, &mut self.small, &mut self.right, 0.0).is_err() {
            return;
        }
        for (solved, share) in self.solved.iter().zip(self.right.iter()) {
            for (step_m, way) in self.step_m.iter_mut().zip(solved) {
                *step_m -= *way * *share;
            }
        }
    }
}

#[cfg(test)]
mod tests;
