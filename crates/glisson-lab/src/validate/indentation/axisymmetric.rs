//! An elastic layer bonded to its base, indented along its axis: linear, axisymmetric, on biquadratic rectangles.
//!
//! The strain (e_rr, e_zz, e_tt, g_rz) = (u_r', w_z, u/r, u_z + w_r) at 3 x 3 Gauss points, the weight 2 pi r. What is not
//! loaded is free, the base does not move. Compliances of the upper side's nodes against vertical forces come from one banded
//! Cholesky factor; a rigid punch of radius a then is a dense system.
//!
//! Contact radius of a smooth indenter: at a given depth the true one makes the force largest (the derivative of the force
//! by the radius vanishes where the pressure at the edge does; Barber 1974, "Determining the contact area in elastic-indentation
//! problems", J. Strain Anal. 9(4)).

use super::contact::{Dense, parabola_vertex};

/// Gauss points and weights on [-1, 1].
const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// A layer and its rectangles.
pub(in crate::validate) struct Layer {
    /// Borders of the rectangles along the radius, from 0 [m].
    pub(in crate::validate) radii_m: Vec<f64>,
    /// Depths of their borders below the upper side, from 0 to the base [m].
    pub(in crate::validate) depths_m: Vec<f64>,
    pub(in crate::validate) young_modulus_pa: f64,
    pub(in crate::validate) poisson_ratio: f64,
    /// A stiffer ball on the axis, if there is one.
    pub(in crate::validate) nodule: Option<Nodule>,
}

/// A ball of other stiffness, bonded to what is around it.
#[derive(Clone, Copy, Debug)]
pub(in crate::validate) struct Nodule {
    pub(in crate::validate) radius_m: f64,
    /// Of its middle below the upper side [m].
    pub(in crate::validate) depth_m: f64,
    /// Its stiffness over that around it.
    pub(in crate::validate) stiffness: f64,
}

impl Nodule {
    /// How many times stiffer it is there.
    pub(in crate::validate) fn stiffness_at(&self, radius_m: f64, depth_m: f64) -> f64 {
        let is_inside = radius_m.hypot(depth_m - self.depth_m) <= self.radius_m;
        if is_inside { self.stiffness } else { 1.0 }
    }
}

/// How the upper side answers to vertical forces near the axis.
pub(in crate::validate) struct UpperSide {
    /// Nodes from the axis outwards [m].
    pub(in crate::validate) radii_m: Vec<f64>,
    /// Downward displacement of node i for a downward force on node j [m/N].
    compliance_m_per_n: Dense,
}

fn shape(x: f64) -> [(f64, f64); 3] {
    [(0.5 * x * (x - 1.0), x - 0.5), (1.0 - x * x, -2.0 * x), (0.5 * x * (x + 1.0), x + 0.5)]
}

/// Borders of the rectangles with their middles between.
fn with_middles(borders: &[f64]) -> Vec<f64> {
    let mut all = vec![borders[0]];
    for pair in borders.windows(2) {
        all.extend([0.5 * (pair[0] + pair[1]), pair[1]]);
    }
    all
}

impl Layer {
    /// Compliance of the nodes of the upper side within `reach_m` of the axis.
    pub(in crate::validate) fn upper_side(&self, reach_m: f64) -> anyhow::Result<UpperSide> {
        let (radii_m, depths_m) = (with_middles(&self.radii_m), with_middles(&self.depths_m));
        // Nodes run along the depth first; the last of each column is on the base.
        let n_deep = depths_m.len();
        let row = |i: usize, j: usize, component: usize| 2 * (n_deep * i + j) + component;
        let n = 2 * n_deep * radii_m.len();
        let mut system = Banded::new(n, 4 * n_deep + 6);
        for i in 0..self.radii_m.len() - 1 {
            for j in 0..self.depths_m.len() - 1 {
                let at = |v: &[f64], k: usize| [v[2 * k], v[2 * k + 2]];
                let stiffness = self.rectangle(at(&radii_m, i), at(&depths_m, j));
                let rows: Vec<usize> =
                    (0..9).flat_map(|k| [0, 1].map(|c| row(2 * i + k % 3, 2 * j + k / 3, c))).collect();
                for (p, &a) in rows.iter().enumerate() {
                    for (q, &b) in rows.iter().enumerate().filter(|(_, b)| **b <= a) {
                        system.add(a, b, stiffness[18 * p + q]);
                    }
                }
            }
        }
        for i in 0..radii_m.len() {
            system.hold(row(i, n_deep - 1, 0));
            system.hold(row(i, n_deep - 1, 1));
        }
        for j in 0..n_deep {
            system.hold(row(0, j, 0));
        }
        system.factorize()?;
        let n_near = radii_m.iter().take_while(|r| **r <= reach_m * (1.0 + 1e-9)).count();
        let mut compliance_m_per_n = Dense::zero(n_near);
        let mut right = vec![0.0; n];
        for j in 0..n_near {
            right.fill(0.0);
            right[row(j, 0, 1)] = 1.0;
            system.solve(&mut right);
            for i in 0..n_near {
                compliance_m_per_n.set(i, j, right[row(i, 0, 1)]);
            }
        }
        Ok(UpperSide { radii_m: radii_m[..n_near].to_vec(), compliance_m_per_n })
    }

    /// Stiffness of one rectangle, z downwards; nodes along the radius first.
    fn rectangle(&self, r_m: [f64; 2], z_m: [f64; 2]) -> Vec<f64> {
        let (e, nu) = (self.young_modulus_pa, self.poisson_ratio);
        let (lambda, mu) = (e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 * e / (1.0 + nu));
        let (half_r, half_z) = (0.5 * (r_m[1] - r_m[0]), 0.5 * (z_m[1] - z_m[0]));
        let mut stiffness = vec![0.0; 18 * 18];
        for (x, wx) in GAUSS {
            for (y, wy) in GAUSS {
                let radius = r_m[0] + half_r * (1.0 + x);
                let depth_m = z_m[0] + half_z * (1.0 + y);
                let stiffer = self.nodule.map_or(1.0, |nodule| nodule.stiffness_at(radius, depth_m));
                let weight = stiffer * wx * wy * half_r * half_z * std::f64::consts::TAU * radius;
                let (along, down) = (shape(x), shape(y));
                // Strains of a unit displacement of each component.
                let mut strains = [[0.0; 4]; 18];
                for k in 0..9 {
                    let ((f, df), (g, dg)) = (along[k % 3], down[k / 3]);
                    let (dr, dz) = (df * g / half_r, f * dg / half_z);
                    strains[2 * k] = [dr, 0.0, f * g / radius, dz];
                    strains[2 * k + 1] = [0.0, dz, 0.0, dr];
                }
                for (p, a) in strains.iter().enumerate() {
                    let trace = a[0] + a[1] + a[2];
                    for (q, b) in strains.iter().enumerate() {
                        let volume = lambda * trace * (b[0] + b[1] + b[2]);
                        let shear = 2.0 * mu * (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) + mu * a[3] * b[3];
                        stiffness[18 * p + q] += weight * (volume + shear);
                    }
                }
            }
        }
        stiffness
    }
}

impl UpperSide {
    /// Force [N] of a rigid frictionless indenter whose foot lies at `depth_m(radius)` below the upper side within a contact
    /// of the first `n` nodes.
    fn force_n(&self, n: usize, depth_m: impl Fn(f64) -> f64) -> anyhow::Result<f64> {
        let wanted_m: Vec<f64> = self.radii_m[..n].iter().map(|r| depth_m(*r)).collect();
        Ok(self.compliance_m_per_n.leading(n).solve(&wanted_m)?.iter().sum())
    }

    /// Force of a flat punch whose edge is the border of a rectangle.
    pub(in crate::validate) fn flat_punch_n(&self, radius_m: f64, depth_m: f64) -> anyhow::Result<f64> {
        let n = self.radii_m.iter().take_while(|r| **r <= radius_m * (1.0 + 1e-9)).count();
        self.force_n(n, |_| depth_m)
    }

    /// Force and contact radius of a sphere, taken as a paraboloid as Hertz does.
    pub(super) fn sphere(&self, radius_m: f64, depth_m: f64) -> anyhow::Result<(f64, f64)> {
        // Contacts that end at the border of a rectangle.
        let mut forces = Vec::new();
        for n in (3..=self.radii_m.len()).step_by(2) {
            let foot_m = |r: f64| depth_m - 0.5 * r * r / radius_m;
            forces.push((self.radii_m[n - 1], self.force_n(n, foot_m)?));
        }
        parabola_vertex(&forces).ok_or_else(|| anyhow::anyhow!("the contact is as wide as the fine part"))
    }
}

/// A symmetric matrix whose entries lie near the diagonal, and its Cholesky factor.
struct Banded {
    n: usize,
    width: usize,
    /// Row by row, the entry on the diagonal last.
    value: Vec<f64>,
    held: Vec<bool>,
}

impl Banded {
    fn new(n: usize, width: usize) -> Self {
        Self { n, width, value: vec![0.0; n * (width + 1)], held: vec![false; n] }
    }

    fn place(&self, row: usize, column: usize) -> usize {
        (self.width + 1) * row + self.width - (row - column)
    }

    fn add(&mut self, row: usize, column: usize, value: f64) {
        let at = self.place(row, column);
        self.value[at] += value;
    }

    /// Keeps one unknown at zero.
    fn hold(&mut self, row: usize) {
        for column in row.saturating_sub(self.width)..row {
            let at = self.place(row, column);
            self.value[at] = 0.0;
        }
        for below in row + 1..(row + self.width + 1).min(self.n) {
            let at = self.place(below, row);
            self.value[at] = 0.0;
        }
        let at = self.place(row, row);
        self.value[at] = 1.0;
        self.held[row] = true;
    }

    fn factorize(&mut self) -> anyhow::Result<()> {
        let width = self.width;
        for row in 0..self.n {
            let first = row.saturating_sub(width);
            for column in first..=row {
                let start = first.max(column.saturating_sub(width));
                let (a, b) = (self.place(row, start), self.place(column, start));
                let n = column - start;
                let product: f64 =
                    self.value[a..a + n].iter().zip(&self.value[b..b + n]).map(|(x, y)| x * y).sum();
                let at = self.place(row, column);
                let rest = self.value[at] - product;
                if column < row {
                    self.value[at] = rest / self.value[self.place(column, column)];
                } else {
                    anyhow::ensure!(rest > 0.0, "row {row} of the layer's stiffness has no positive pivot");
                    self.value[at] = rest.sqrt();
                }
            }
        }
        Ok(())
    }

    fn solve(&self, right: &mut [f64]) {
        for (x, held) in right.iter_mut().zip(&self.held) {
            if *held {
                *x = 0.0;
            }
        }
        for row in 0..self.n {
            let first = row.saturating_sub(self.width);
            let at = self.place(row, first);
            let n = row - first;
            let product: f64 =
                self.value[at..at + n].iter().zip(&right[first..row]).map(|(l, x)| l * x).sum();
            right[row] = (right[row] - product) / self.value[at + n];
        }
        for row in (0..self.n).rev() {
            let first = row.saturating_sub(self.width);
            let at = self.place(row, first);
            let n = row - first;
            right[row] /= self.value[at + n];
            let solved = right[row];
            for (x, l) in right[first..row].iter_mut().zip(&self.value[at..at + n]) {
                *x -= l * solved;
            }
        }
    }
}
