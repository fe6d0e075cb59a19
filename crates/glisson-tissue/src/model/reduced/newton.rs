//! Equilibrium in reduced coordinates with imposed displacements: Newton's method with a line search.
//!
//! The unknowns are q and the forces lambda that hold the m imposed components. V_c are the rows of the modes there, C_c is
//! the part of C_r there, and u_0 the displacement there from the other loads through C_r:
//!
//! f(q) = b + V_c^T lambda,   V_c q + C_c lambda + u_0 = U.
//!
//! With J = df/dq = L L^T the forces follow from (V_c J^-1 V_c^T + C_c) lambda = U - u_0 - V_c (q + J^-1 (b - f)). At rest
//! this matrix is the compliance of the pre-computed model. Where J is not positive definite, multiples of the stiffness
//! at rest are added. A step is halved until the residual, measured as an energy of the linear body, decreases, or the
//! potential W(q) - b q - lambda V_c q does; every step is a descent direction of the latter for fixed lambda.

use super::cubic::{ReducedForces, ReducedState};
use super::dense::{cholesky, dot, solve_lower, solve_upper};

/// The memory of a solution.
#[derive(Clone, Debug)]
pub(super) struct Newton {
    /// q, the start of the next solution.
    pub(super) q: Vec<f64>,
    /// V_c^T: a column of r for each imposed component.
    pub(super) modes_there: Vec<f64>,
    /// C_c by columns.
    pub(super) remainder_there: Vec<f64>,
    /// U - u_0.
    pub(super) target_m: Vec<f64>,
    /// b.
    pub(super) load: Vec<f64>,
    /// lambda [N].
    pub(super) hold_n: Vec<f64>,
    state: ReducedState,
    factor: Vec<f64>,
    half_solved: Vec<f64>,
    schur: Vec<f64>,
    step: Vec<f64>,
    trial: Vec<f64>,
    gap: Vec<f64>,
}

/// Report on a solution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReducedSolution {
    /// Newton iterations.
    pub n_iterations: u32,
    /// Whether the residual reached the tolerance.
    pub converged: bool,
}

/// The iteration ends when the energy of the residual is below this share of that of the acting forces: 1e-10 in forces.
const TOLERANCE: f64 = 1e-20;
/// Share of the full decrease that a step must bring (Armijo).
const ARMIJO: f64 = 1e-4;
const MOST_HALVINGS: u32 = 12;
const MOST_SHIFTS: u32 = 12;
/// A pivot below this share of its diagonal entry is a row that repeats others: its force is left out.
const LEAST_PIVOT: f64 = 1e-13;

impl Newton {
    pub(super) fn new(forces: &ReducedForces, most_components: usize) -> Self {
        let (r, m) = (forces.squared_frequency_per_s2.len(), most_components);
        Self {
            q: vec![0.0; r],
            modes_there: vec![0.0; r * m],
            remainder_there: vec![0.0; m * m],
            target_m: vec![0.0; m],
            load: vec![0.0; r],
            hold_n: vec![0.0; m],
            state: forces.state(),
            factor: vec![0.0; r * r],
            half_solved: vec![0.0; r * m],
            schur: vec![0.0; m * m],
            step: vec![0.0; r],
            trial: vec![0.0; r],
            gap: vec![0.0; m],
        }
    }

    /// Solves for `m` imposed components; `negligible_j` is a negligible energy [J].
    pub(super) fn solve(
        &mut self,
        forces: &ReducedForces,
        m: usize,
        most_iterations: u32,
        negligible_j: f64,
    ) -> ReducedSolution {
        forces.evaluate(&self.q, &mut self.state);
        for n_iterations in 1..=most_iterations {
            self.factor_stiffness(forces);
            self.find_step(m);
            let before_j = self.residual_energy_j(forces, m, 1.0);
            if !before_j.is_finite() {
                break;
            }
            let scale_j = self.energy_of_forces_j(forces);
            if before_j <= TOLERANCE * scale_j + negligible_j {
                // The last step is free and meets the constraints up to rounding.
                self.q.iter_mut().zip(&self.step).for_each(|(q, d)| *q += d);
                return ReducedSolution { n_iterations, converged: true };
            }
            if !self.search(forces, m, before_j) {
                return ReducedSolution { n_iterations, converged: false };
            }
        }
        if !self.q.iter().chain(&self.hold_n[..m]).all(|x| x.is_finite()) {
            self.q.fill(0.0);
            self.hold_n[..m].fill(0.0);
        }
        ReducedSolution { n_iterations: most_iterations, converged: false }
    }

    fn factor_stiffness(&mut self, forces: &ReducedForces) {
        let r = self.q.len();
        let mut shift = 0.0;
        for _ in 0..MOST_SHIFTS {
            self.factor.copy_from_slice(&self.state.stiffness);
            for (i, squared) in forces.squared_frequency_per_s2.iter().enumerate() {
                self.factor[i * r + i] += shift * squared;
            }
            if cholesky(&mut self.factor, r, LEAST_PIVOT) {
                return;
            }
            shift = if shift == 0.0 { 0.1 } else { 3.0 * shift };
        }
    }

    /// L^-1 times the `m` columns of r numbers that `fill` writes, with L of the stiffness at the present q: the dot product of
    /// two of them is their compliance. Overwrites the scratch of a solution, which each solution computes anew.
    pub(super) fn half_solve(
        &mut self,
        forces: &ReducedForces,
        m: usize,
        fill: impl Fn(usize, &mut [f64]),
    ) -> &[f64] {
        let r = self.q.len();
        forces.evaluate(&self.q, &mut self.state);
        self.factor_stiffness(forces);
        for (component, column) in self.half_solved[..r * m].chunks_exact_mut(r).enumerate() {
            fill(component, column);
            solve_lower(&self.factor, r, column);
        }
        &self.half_solved[..r * m]
    }

    /// Computes the Newton step and the forces at its end.
    fn find_step(&mut self, m: usize) {
        let r = self.q.len();
        for i in 0..r {
            self.step[i] = self.load[i] - self.state.force[i];
        }
        solve_lower(&self.factor, r, &mut self.step);
        let (half, modes) = (&mut self.half_solved[..r * m], &self.modes_there[..r * m]);
        half.copy_from_slice(modes);
        half.chunks_exact_mut(r).for_each(|column| solve_lower(&self.factor, r, column));
        for (j, column) in half.chunks_exact(r).enumerate() {
            let there_m = dot(&modes[j * r..(j + 1) * r], &self.q);
            self.hold_n[j] = self.target_m[j] - there_m - dot(column, &self.step);
            for (i, other) in half.chunks_exact(r).enumerate().skip(j) {
                self.schur[j * m + i] = self.remainder_there[j * m + i] + dot(column, other);
            }
        }
        cholesky(&mut self.schur[..m * m], m, LEAST_PIVOT);
        solve_lower(&self.schur, m, &mut self.hold_n[..m]);
        solve_upper(&self.schur, m, &mut self.hold_n[..m]);
        for (column, hold_n) in half.chunks_exact(r).zip(&self.hold_n) {
            self.step.iter_mut().zip(column).for_each(|(s, c)| *s += hold_n * c);
        }
        solve_upper(&self.factor, r, &mut self.step);
        for (j, column) in modes.chunks_exact(r).enumerate() {
            let held_m: f64 =
                (0..m).map(|i| self.remainder_there[i.min(j) * m + i.max(j)] * self.hold_n[i]).sum();
            self.gap[j] = dot(column, &self.q) + held_m - self.target_m[j];
        }
    }

    /// Energy [J] of the unbalanced forces, plus `share` of that of the gaps at the imposed components.
    fn residual_energy_j(&self, forces: &ReducedForces, m: usize, share: f64) -> f64 {
        let r = self.q.len();
        let mut sum = 0.0;
        for i in 0..r {
            let held: f64 = (0..m).map(|j| self.modes_there[j * r + i] * self.hold_n[j]).sum();
            let residual = self.state.force[i] - self.load[i] - held;
            sum += residual * residual / forces.squared_frequency_per_s2[i];
        }
        for j in 0..m {
            let column = &self.modes_there[j * r..(j + 1) * r];
            let compliance = column.iter().zip(&forces.squared_frequency_per_s2).map(|(v, w)| v * v / w);
            let whole = compliance.sum::<f64>() + self.remainder_there[j * m + j];
            if whole > 0.0 {
                let gap_m = share * self.gap[j];
                sum += gap_m * gap_m / whole;
            }
        }
        sum
    }

    fn energy_of_forces_j(&self, forces: &ReducedForces) -> f64 {
        let parts = self.state.force.iter().zip(&self.load).zip(&forces.squared_frequency_per_s2);
        parts.map(|((f, b), w)| (f * f + b * b) / w).sum()
    }

    /// W(q) - b q - lambda V_c q [J].
    fn potential_j(&self, m: usize) -> f64 {
        let there = self.modes_there.chunks_exact(self.q.len()).zip(&self.hold_n[..m]);
        let held: f64 = there.map(|(column, hold_n)| hold_n * dot(column, &self.q)).sum();
        self.state.energy_j - dot(&self.load, &self.q) - held
    }

    /// Slope of the potential along the step [J].
    fn slope_j(&self, m: usize) -> f64 {
        let there = self.modes_there.chunks_exact(self.q.len()).zip(&self.hold_n[..m]);
        let held: f64 = there.map(|(column, hold_n)| hold_n * dot(column, &self.step)).sum();
        dot(&self.state.force, &self.step) - dot(&self.load, &self.step) - held
    }

    /// Takes as much of the step as lowers the residual or the potential; returns whether any part did.
    fn search(&mut self, forces: &ReducedForces, m: usize, before_j: f64) -> bool {
        let (potential_j, slope_j) = (self.potential_j(m), self.slope_j(m));
        let mut share = 1.0;
        self.trial.copy_from_slice(&self.q);
        for _ in 0..=MOST_HALVINGS {
            for i in 0..self.q.len() {
                self.q[i] = self.trial[i] + share * self.step[i];
            }
            forces.evaluate(&self.q, &mut self.state);
            let is_nearer =
                self.residual_energy_j(forces, m, 1.0 - share) <= (1.0 - ARMIJO * share) * before_j;
            let is_lower = slope_j < 0.0 && self.potential_j(m) <= potential_j + ARMIJO * share * slope_j;
            if is_nearer || is_lower {
                return true;
            }
            share *= 0.5;
        }
        self.q.copy_from_slice(&self.trial);
        false
    }
}
