//! Small dense systems of imposed displacements and of corrections: Gaussian elimination with row exchange, without
//! allocation.

/// A square system of up to a fixed size, by rows.
#[derive(Debug)]
pub(super) struct SmallLu {
    n: usize,
    room: usize,
    entry: Vec<f64>,
    row_of: Vec<usize>,
    solved: Vec<f64>,
}

impl Clone for SmallLu {
    /// A copy with the same capacity.
    fn clone(&self) -> Self {
        let mut copy = Self::with_room_for(self.room);
        copy.n = self.n;
        copy.entry.copy_from_slice(&self.entry);
        copy.row_of.copy_from_slice(&self.row_of);
        copy
    }
}

impl SmallLu {
    /// A system with capacity for `room` rows.
    pub(super) fn with_room_for(room: usize) -> Self {
        Self { n: 0, room, entry: vec![0.0; room * room], row_of: vec![0; room], solved: vec![0.0; room] }
    }

    /// Starts a system of `n` rows; returns its entries, by rows, to be written and then factored.
    pub(super) fn start(&mut self, n: usize) -> &mut [f64] {
        assert!(n <= self.room, "room was made for {} rows", self.room);
        self.n = n;
        &mut self.entry[..n * n]
    }

    /// Factors the entries. Returns the smallest pivot over the largest entry; 1 for no row. A zero pivot's
    /// unknown is left out.
    pub(super) fn factor(&mut self) -> f64 {
        let n = self.n;
        let a = &mut self.entry[..n * n];
        let largest = a.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let mut least = 1.0_f64;
        for k in 0..n {
            self.row_of[k] = k;
        }
        for k in 0..n {
            let pivot_row =
                (k..n).fold(k, |best, i| if a[i * n + k].abs() > a[best * n + k].abs() { i } else { best });
            if pivot_row != k {
                self.row_of.swap(k, pivot_row);
                for j in 0..n {
                    a.swap(k * n + j, pivot_row * n + j);
                }
            }
            let pivot = a[k * n + k];
            least = least.min(pivot.abs() / largest.max(f64::MIN_POSITIVE));
            let inverse = if pivot == 0.0 { 0.0 } else { 1.0 / pivot };
            for i in k + 1..n {
                let factor = a[i * n + k] * inverse;
                a[i * n + k] = factor;
                if factor != 0.0 {
                    let (upper, lower) = a.split_at_mut(i * n);
                    for (x, p) in lower[k + 1..n].iter_mut().zip(&upper[k * n + k + 1..k * n + n]) {
                        *x -= factor * p;
                    }
                }
            }
        }
        least
    }

    /// Replaces a right-hand side by its solution.
    pub(super) fn solve(&mut self, right: &mut [f64]) {
        let n = self.n;
        assert_eq!(right.len(), n, "one number a row");
        let (a, x) = (&self.entry[..n * n], &mut self.solved[..n]);
        for i in 0..n {
            x[i] = right[self.row_of[i]];
            for j in 0..i {
                x[i] -= a[i * n + j] * x[j];
            }
        }
        for i in (0..n).rev() {
            for j in i + 1..n {
                x[i] -= a[i * n + j] * x[j];
            }
            let pivot = a[i * n + i];
            x[i] = if pivot == 0.0 { 0.0 } else { x[i] / pivot };
        }
        right.copy_from_slice(x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::SeededRandom;

    #[test]
    fn random_systems_are_solved() {
        let mut random = SeededRandom::new(8);
        let mut system = SmallLu::with_room_for(24);
        for n in [0, 1, 2, 5, 24] {
            let a: Vec<f64> = (0..n * n).map(|_| random.normal()).collect();
            let x: Vec<f64> = (0..n).map(|_| random.normal()).collect();
            let mut right: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * x[j]).sum()).collect();
            system.start(n).copy_from_slice(&a);
            assert!(system.factor() > 1e-8);
            system.clone().solve(&mut right);
            assert!(right.iter().zip(&x).all(|(found, x)| (found - x).abs() < 1e-10));
        }
        system.start(2).copy_from_slice(&[1.0, 2.0, 2.0, 4.0]);
        assert!(system.factor() < 1e-15);
    }
}
