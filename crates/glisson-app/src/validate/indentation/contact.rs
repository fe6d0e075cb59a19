//! A rigid frictionless indenter on nodes whose compliance is known.

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
