//! A rigid frictionless indenter on nodes whose compliance is known: by the library's solver of contacts, and by an
//! active-set iteration that shares no code with it.

use glisson::contact::constraint::{Contact, ContactKey, Response, SweepReport, Sweeps, solve};
use glisson::math::{DMat3, DVec3};

/// A full symmetric matrix.
#[derive(Clone, Debug)]
pub(super) struct Dense {
    n: usize,
    value: Vec<f64>,
}

impl Dense {
    pub(super) fn zero(n: usize) -> Self {
        Self { n, value: vec![0.0; n * n] }
    }

    pub(super) fn set(&mut self, row: usize, column: usize, value: f64) {
        self.value[self.n * column + row] = value;
    }

    fn at(&self, row: usize, column: usize) -> f64 {
        self.value[self.n * column + row]
    }

    /// The rows and columns `kept`.
    fn part(&self, kept: &[usize]) -> Self {
        let mut part = Self::zero(kept.len());
        for (q, &j) in kept.iter().enumerate() {
            for (p, &i) in kept.iter().enumerate() {
                part.set(p, q, self.at(i, j));
            }
        }
        part
    }

    pub(super) fn leading(&self, n: usize) -> Self {
        self.part(&(0..n).collect::<Vec<_>>())
    }

    /// By Cholesky's factor.
    pub(super) fn solve(mut self, right: &[f64]) -> anyhow::Result<Vec<f64>> {
        let n = self.n;
        let mut x = right.to_vec();
        for k in 0..n {
            let pivot = self.at(k, k);
            anyhow::ensure!(pivot > 0.0, "row {k} of the compliance has no positive pivot");
            for j in k + 1..n {
                let factor = self.at(j, k) / pivot;
                for i in j..n {
                    let value = self.at(i, j) - factor * self.at(i, k);
                    self.set(i, j, value);
                }
                x[j] -= factor * x[k];
            }
        }
        for k in (0..n).rev() {
            let later: f64 = (k + 1..n).map(|i| self.at(i, k) * x[i]).sum();
            x[k] = (x[k] - later) / self.at(k, k);
        }
        Ok(x)
    }
}

/// Sweeps of the library's solver and the change of a force at which it stops: far below what is compared.
const SWEEPS: Sweeps = Sweeps { most: 20_000, tolerance: 1e-10 };

/// Forces [N] under an indenter whose foot lies `wanted_m` below each node, by [`glisson::contact::constraint::solve`]: one
/// contact without friction for each node under the foot, on the nodes' own compliance. The third axis points down.
pub(super) fn by_constraints(compliance_m_per_n: &Dense, wanted_m: &[f64]) -> (Vec<f64>, SweepReport) {
    let n = wanted_m.len();
    let mut response = Response::new(n, 1);
    response.set_group(0, 0..n as u32);
    let blocks = &mut response.group_mut(0).compliance_m_per_n;
    for column in 0..n {
        blocks.extend((0..n).map(|row| DMat3::from_diagonal(DVec3::Z * compliance_m_per_n.at(row, column))));
    }
    let mut contacts: Vec<Contact> = (0..n as u32)
        .filter(|v| wanted_m[*v as usize].is_finite())
        .map(|v| {
            let wanted_m = wanted_m[v as usize];
            let mut contact = Contact::new(ContactKey::VertexObstacle(v, 0), DVec3::Z, -wanted_m);
            contact.vertices[0] = v;
            contact.weights[0] = 1.0;
            // The node goes down at least as far as the foot.
            contact.slack_m = -wanted_m;
            contact
        })
        .collect();
    let report = solve(&mut contacts, &response, SWEEPS, &mut vec![DVec3::ZERO; n]);
    let mut forces_n = vec![0.0; n];
    for contact in &contacts {
        forces_n[contact.vertices[0] as usize] = contact.force_n.z;
    }
    (forces_n, report)
}

/// Forces [N] under an indenter whose foot lies `wanted_m` below each node: no force pulls, no node is above the foot. Nodes
/// that pull are let go and nodes above the foot taken in until there are none (an active-set iteration).
pub(super) fn unilateral(compliance_m_per_n: &Dense, wanted_m: &[f64]) -> anyhow::Result<Vec<f64>> {
    let n = wanted_m.len();
    let mut is_in: Vec<bool> = wanted_m.iter().map(|d| *d > 0.0).collect();
    for _ in 0..100 {
        let kept: Vec<usize> = (0..n).filter(|i| is_in[*i]).collect();
        let right: Vec<f64> = kept.iter().map(|i| wanted_m[*i]).collect();
        let solved = compliance_m_per_n.part(&kept).solve(&right)?;
        let mut forces_n = vec![0.0; n];
        for (&i, f) in kept.iter().zip(&solved) {
            forces_n[i] = *f;
        }
        let mut is_done = true;
        for i in 0..n {
            let moved_m: f64 = kept.iter().map(|j| compliance_m_per_n.at(i, *j) * forces_n[*j]).sum();
            let change = if is_in[i] { forces_n[i] < 0.0 } else { moved_m < wanted_m[i] - 1e-12 };
            if change {
                is_in[i] = !is_in[i];
                is_done = false;
            }
        }
        if is_done {
            return Ok(forces_n);
        }
    }
    anyhow::bail!("the contact of {n} nodes was not found in 100 rounds")
}

/// The largest value of (place, value) pairs and its place, from the parabola through the largest and its neighbours; nothing
/// where the largest is the first or last.
pub(super) fn parabola_vertex(values: &[(f64, f64)]) -> Option<(f64, f64)> {
    let best = (0..values.len()).max_by(|&i, &j| values[i].1.total_cmp(&values[j].1))?;
    if best == 0 || best + 1 == values.len() {
        return None;
    }
    let [(x0, y0), (x1, y1), (x2, y2)] = [values[best - 1], values[best], values[best + 1]];
    let (first, second) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let bend = (second - first) / (x2 - x0);
    let place = 0.5 * (x0 + x1 - first / bend);
    Some((y1 + first * (place - x1) + bend * (place - x0) * (place - x1), place))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_met_exactly() {
        let f = |x: f64| 3.0 - 2.0 * (x - 1.3) * (x - 1.3);
        let (value, place) = parabola_vertex(&[0.0, 0.9, 1.5, 2.0].map(|x| (x, f(x)))).unwrap();
        assert!((value - 3.0).abs() < 1e-12 && (place - 1.3).abs() < 1e-12);
        assert!(parabola_vertex(&[0.0, 0.9].map(|x| (x, f(x)))).is_none());
    }

    #[test]
    fn both_ways_find_the_same_forces() {
        // A row of nodes that follow each other less with the distance, under a blunt wedge.
        let n = 12;
        let mut compliance = Dense::zero(n);
        for i in 0..n {
            for j in 0..n {
                compliance.set(i, j, 1.0 / (1.0 + i.abs_diff(j) as f64));
            }
        }
        let wanted_m: Vec<f64> =
            (0..n).map(|i| if i == n - 1 { f64::NEG_INFINITY } else { 1.0 - 0.25 * i as f64 }).collect();
        let expected_n = unilateral(&compliance, &wanted_m).unwrap();
        let (found_n, report) = by_constraints(&compliance, &wanted_m);
        assert!(report.residual <= SWEEPS.tolerance, "{report:?}");
        assert!(expected_n.iter().filter(|f| **f > 0.0).count() > 1);
        for (found, expected) in found_n.iter().zip(&expected_n) {
            assert!((found - expected).abs() < 1e-8, "{found_n:?} {expected_n:?}");
        }
    }

    #[test]
    fn nodes_that_would_pull_are_let_go() {
        // Two springs that share a support: the second node follows the first by a half.
        let mut compliance = Dense::zero(2);
        for (i, j, c) in [(0, 0, 1.0), (1, 1, 1.0), (0, 1, 0.5), (1, 0, 0.5)] {
            compliance.set(i, j, c);
        }
        assert_eq!(unilateral(&compliance, &[1.0, 0.2]).unwrap(), [1.0, 0.0]);
        let both = unilateral(&compliance, &[1.0, 0.8]).unwrap();
        assert!((both[0] - 0.8).abs() < 1e-12 && (both[1] - 0.4).abs() < 1e-12, "{both:?}");
    }
}
