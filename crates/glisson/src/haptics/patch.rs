//! The stiffness that a tool feels at a patch of nodes that follow it.
//!
//! Node j of the patch moves by W_j d when the tip moves by d. With C the compliance of the patch
//! ([`crate::model::LocalModel`]) the nodes' forces rise by the columns of X, C X = W, and what does their work at the tip by
//! S = sum_i W_i^T X_i. S is symmetric for the whole patch; of a part of it, which its neighbours press as well, the symmetric
//! part is taken, without negative eigenvalues: a model that a hand cannot draw energy from.

use crate::material::eigen_symmetric;
use crate::math::{DMat3, DVec3, outer};
use crate::model::LocalModel;

/// A pivot of C below this share of its largest entry is none: a fixed axis, which bears any force.
const LEAST_PIVOT: f64 = 1e-12;

/// The solution X, and what it is computed in. Nothing is allocated after [`PatchStiffness::new`].
#[derive(Clone, Debug)]
pub struct PatchStiffness {
    /// Lower factor of C, row by row.
    factor: Vec<f64>,
    /// X, three columns a row.
    forces: Vec<[f64; 3]>,
    /// W, node by node.
    motions: Vec<DMat3>,
}

impl Default for PatchStiffness {
    fn default() -> Self {
        Self::new()
    }
}

impl PatchStiffness {
    /// With room for the largest patch.
    pub fn new() -> Self {
        let n = 3 * LocalModel::MOST_NODES;
        Self {
            factor: Vec::with_capacity(n * n),
            forces: Vec::with_capacity(n),
            motions: Vec::with_capacity(LocalModel::MOST_NODES),
        }
    }

    /// Solves for a patch whose node i moves by `motion(i)` times the tip's motion. Axes that do not yield at all are left
    /// out; a patch that is not positive beside them is taken node by node.
    pub fn solve(&mut self, local: &LocalModel, motion: impl Fn(usize) -> DMat3) {
        let n = 3 * local.nodes.len();
        let c = &local.compliance_m_per_n;
        let largest = (0..n).map(|i| c[n * i + i]).fold(0.0, f64::max);
        self.forces.clear();
        self.motions.clear();
        for node in 0..n / 3 {
            let turn = motion(node);
            self.motions.push(turn);
            self.forces.extend([0, 1, 2].map(|axis| turn.row(axis).to_array()));
        }
        let is_free = |i: usize| c[n * i + i] > LEAST_PIVOT * largest;
        if !self.factorize(c, n, is_free) {
            for i in 0..n {
                let inverse = if is_free(i) { 1.0 / c[n * i + i] } else { 0.0 };
                self.forces[i] = self.forces[i].map(|x| x * inverse);
            }
            return;
        }
        let (l, x) = (&self.factor, &mut self.forces);
        for i in 0..n {
            if !is_free(i) {
                x[i] = [0.0; 3];
                continue;
            }
            for a in 0..3 {
                let known: f64 = (0..i).map(|j| l[n * i + j] * x[j][a]).sum();
                x[i][a] = (x[i][a] - known) / l[n * i + i];
            }
        }
        for i in (0..n).rev().filter(|i| is_free(*i)) {
            for a in 0..3 {
                let known: f64 = (i + 1..n).map(|j| l[n * j + i] * x[j][a]).sum();
                x[i][a] = (x[i][a] - known) / l[n * i + i];
            }
        }
    }

    /// Cholesky's factor of the rows that are free; the others stay zero. False where C is not positive.
    fn factorize(&mut self, c: &[f64], n: usize, is_free: impl Fn(usize) -> bool) -> bool {
        let l = &mut self.factor;
        l.clear();
        l.resize(n * n, 0.0);
        for i in (0..n).filter(|i| is_free(*i)) {
            for j in (0..=i).filter(|j| is_free(*j)) {
                let known: f64 = (0..j).map(|k| l[n * i + k] * l[n * j + k]).sum();
                let rest = c[n * i + j] - known;
                l[n * i + j] = if j < i {
                    rest / l[n * j + j]
                } else if rest > LEAST_PIVOT * c[n * i + i] {
                    rest.sqrt()
                } else {
                    return false;
                };
            }
        }
        true
    }

    /// Rise of what does the force's work at the tip [N/m] by those nodes of the patch that `counts` names, as it is.
    pub fn rise_n_per_m(&self, counts: impl Fn(usize) -> bool) -> DMat3 {
        let nodes = self.forces.as_chunks::<3>().0.iter().zip(&self.motions).enumerate();
        let counted = nodes.filter(|(node, _)| counts(*node));
        counted.fold(DMat3::ZERO, |sum, (_, (rows, motion))| {
            sum + motion.transpose() * DMat3::from_cols_array_2d(rows).transpose()
        })
    }

    /// The same, symmetric and without negative eigenvalues.
    pub fn stiffness_n_per_m(&self, counts: impl Fn(usize) -> bool) -> DMat3 {
        let rise = self.rise_n_per_m(counts);
        not_negative((rise + rise.transpose()) * 0.5)
    }
}

/// A symmetric matrix with its negative eigenvalues set to zero; zero when it is not finite.
fn not_negative(symmetric: DMat3) -> DMat3 {
    if !symmetric.is_finite() {
        return DMat3::ZERO;
    }
    let (values, vectors) = eigen_symmetric(&symmetric.to_cols_array_2d());
    if values.iter().all(|v| *v >= 0.0) {
        return symmetric;
    }
    let parts = values.iter().zip(vectors).filter(|(value, _)| **value > 0.0);
    parts.fold(DMat3::ZERO, |sum, (value, vector)| {
        let v = DVec3::from_array(vector);
        sum + outer(v, v) * *value
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::NodeId;

    /// A chain of springs of 100 N/m from a wall: node i yields by (i + 1)/100 along each axis.
    fn chain(n: usize) -> LocalModel {
        let mut local = LocalModel::new();
        let size = 3 * n;
        local.nodes.extend((0..n).map(NodeId::from_index));
        local.compliance_m_per_n.resize(size * size, 0.0);
        for i in 0..n {
            for j in 0..n {
                for a in 0..3 {
                    local.compliance_m_per_n[size * (3 * i + a) + 3 * j + a] = 0.01 * (i.min(j) + 1) as f64;
                }
            }
        }
        local
    }

    #[test]
    fn a_chain_that_moves_as_one_has_the_stiffness_of_its_first_spring() {
        let mut patch = PatchStiffness::new();
        patch.solve(&chain(4), |_| DMat3::IDENTITY);
        let whole = patch.stiffness_n_per_m(|_| true);
        assert!((whole - DMat3::IDENTITY * 100.0).abs_diff_eq(DMat3::ZERO, 1e-9), "{whole}");
        assert!(
            patch.rise_n_per_m(|i| i == 3).abs_diff_eq(DMat3::ZERO, 1e-9),
            "no spring is stretched there"
        );
        patch.solve(&chain(1), |_| DMat3::from_diagonal(DVec3::new(1.0, 0.5, 0.0)));
        let whole = patch.stiffness_n_per_m(|_| true);
        assert!(whole.abs_diff_eq(DMat3::from_diagonal(DVec3::new(100.0, 25.0, 0.0)), 1e-9), "{whole}");
    }

    #[test]
    fn fixed_axes_bear_nothing_and_nothing_is_ever_negative() {
        let mut local = chain(2);
        for k in 0..6 {
            local.compliance_m_per_n[6 * 4 + k] = 0.0;
            local.compliance_m_per_n[6 * k + 4] = 0.0;
        }
        let mut patch = PatchStiffness::new();
        patch.solve(&local, |_| DMat3::IDENTITY);
        let whole = patch.stiffness_n_per_m(|_| true);
        assert!((whole - DMat3::IDENTITY * 100.0).abs_diff_eq(DMat3::ZERO, 1e-9), "{whole}");
        let strange = DMat3::from_cols_array_2d(&[[1.0, 3.0, 0.0], [3.0, 1.0, 0.0], [0.0, 0.0, 2.0]]);
        let kept = not_negative(strange);
        for x in [DVec3::new(1.0, -1.0, 0.0), DVec3::ONE, DVec3::Z] {
            assert!(x.dot(kept * x) > -1e-12);
        }
        assert!((DVec3::ONE.dot(kept * DVec3::ONE) - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_patch_that_does_not_yield_has_no_stiffness_to_tell() {
        let mut patch = PatchStiffness::new();
        let mut local = chain(2);
        local.compliance_m_per_n.fill(0.0);
        patch.solve(&local, |_| DMat3::IDENTITY);
        assert_eq!(patch.stiffness_n_per_m(|_| true), DMat3::ZERO);
    }
}
