//! A rigid ball pressed without friction into a cylinder of soft tissue that is bonded to its base: our own axisymmetric
//! finite-element solution, for any law.
//!
//! The solution is the minimum of the elastic energy plus (penalty / 2) g^2 over the nodes of the upper side that are inside
//! the ball, g the depth of the node's **present** place under the ball's surface: so the force on a node points from the ball's
//! centre to where the node is now. Newton's method with the exact second derivatives, in steps of depth; where these are not
//! positive definite, with the nearest positive semi-definite ones; a step of depth that does not converge is halved.
//! Rectangles are fine under the ball and grow outwards and downwards.
//!
//! A linear law is linear in the displacements: F - 1 is the gradient of the displacement and the stress follows it by Hooke's
//! law whatever the rotation. Contact is at rest place plus displacement all the same. This is the mechanics of the
//! simulator's linear models.
//!
//! All is in units of the ball's radius R (lengths) and Young's modulus E (stresses): forces are F/(E R^2).

mod banded;
mod rectangle;
pub(super) mod table;

use super::super::indentation::graded;
use anyhow::{Context, bail};
use banded::Banded;
use glisson::material::Material;
use rectangle::{N_UNKNOWNS, Rectangle, TangentKind};

/// Stiffness [E R] of the penalty: forces on single nodes are below 0.5 E R^2, so that nodes are less than 5e-5 R inside.
const PENALTY: f64 = 1e4;
/// Fine rectangles reach so far from the axis [R]: beyond the widest contact (the ball's equator and some more, because
/// tissue moves inwards with the law of small strain).
const FINE_REACH: f64 = 1.25;
/// Growth of the rectangles outside, from one to the next: along the radius and downwards.
const GROWTH: [f64; 2] = [1.2, 1.15];
/// Newton's method ends when no displacement changes by more than this [R].
const CHANGE: f64 = 1e-8;
/// Iterations of a step of depth.
const MOST_ITERATIONS: usize = 30;
/// The turning of the normal counts for nodes no deeper inside the ball [R]: those that a new depth has put further in are on
/// their way out.
const SHALLOW: f64 = 1e-4;
/// Halvings of a step of depth that does not converge.
const MOST_DEPTH_HALVINGS: u32 = 5;

/// Along what the ball pushes a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::validate) enum Push {
    /// From the ball's centre to where the node is now: no friction on the deformed surface.
    OnPresentShape,
    /// Along the axis, and the node counts as at its rest radius: no friction on the surface at rest. The contact problem of the
    /// linear theory, as Hertz and Sneddon solved it.
    OnRestShape,
}

/// A cylinder of tissue [R].
#[derive(Clone, Copy, Debug)]
pub(in crate::validate) struct Cylinder {
    pub(in crate::validate) radius: f64,
    pub(in crate::validate) height: f64,
}

/// The state of a cylinder under a ball.
pub(in crate::validate) struct Pressed<'a> {
    law: &'a dyn Material,
    push: Push,
    /// Places of the nodes along the radius and along the axis, the upper side at 0 first.
    r: Vec<f64>,
    z: Vec<f64>,
    /// Radial and axial displacement of each node; nodes run along the axis first.
    displacements: Vec<f64>,
    before: Vec<f64>,
    depth: f64,
    depth_before: f64,
    system: Banded,
    n_factorizations: usize,
    /// Which nodes of the upper side the ball pushes, from the axis outwards.
    pushed: Vec<bool>,
}

/// Borders of rectangles with their middles between.
fn with_middles(borders: &[f64]) -> Vec<f64> {
    let mut all = vec![borders[0]];
    for pair in borders.windows(2) {
        all.extend([0.5 * (pair[0] + pair[1]), pair[1]]);
    }
    all
}

/// What the ball touches. `force`: on it, along the axis [E R^2].
struct Contact {
    force: f64,
    /// Radius at rest of the outermost node in contact; 0 for none.
    radius: f64,
    n_nodes: usize,
}

impl<'a> Pressed<'a> {
    /// At rest, with `per_radius` nodes on a radius of the ball.
    pub(in crate::validate) fn new(
        law: &'a dyn Material,
        push: Push,
        body: Cylinder,
        per_radius: f64,
    ) -> Self {
        let size = 2.0 / per_radius;
        let n_fine = (FINE_REACH / size).ceil() as usize;
        let mut borders: Vec<f64> = (0..=n_fine).map(|k| k as f64 * size).collect();
        let reach = borders[n_fine];
        let outside = graded(size * GROWTH[0], GROWTH[0], body.radius - reach);
        borders.extend(outside[1..].iter().map(|x| reach + x));
        let r = with_middles(&borders);
        let z: Vec<f64> =
            with_middles(&graded(size, GROWTH[1], body.height)).into_iter().map(|depth| -depth).collect();
        let n = 2 * r.len() * z.len();
        let system = Banded::new(n, 4 * z.len() + 5);
        let displacements = vec![0.0; n];
        let before = displacements.clone();
        let pushed = vec![false; r.len()];
        Self {
            law,
            push,
            r,
            z,
            displacements,
            before,
            depth: 0.0,
            depth_before: 0.0,
            system,
            n_factorizations: 0,
            pushed,
        }
    }

    fn unknown(&self, i: usize, j: usize, component: usize) -> usize {
        2 * (self.z.len() * i + j) + component
    }

    /// Unknowns that do not move: the base, and the axis along the radius.
    fn held(&self) -> Vec<usize> {
        let base = self.z.len() - 1;
        let of_base = (0..self.r.len()).flat_map(|i| [0, 1].map(|c| self.unknown(i, base, c)));
        let of_axis = (0..base).map(|j| self.unknown(0, j, 0));
        of_base.chain(of_axis).collect()
    }

    /// The rectangles with their unknowns.
    fn rectangles(&self) -> impl Iterator<Item = (Rectangle, [usize; N_UNKNOWNS])> + '_ {
        let (n_r, n_z) = ((self.r.len() - 1) / 2, (self.z.len() - 1) / 2);
        (0..n_r).flat_map(move |i| (0..n_z).map(move |j| (i, j))).map(|(i, j)| {
            let ends = |v: &[f64], k: usize| [v[2 * k], v[2 * k + 2]];
            let rectangle = Rectangle { r: ends(&self.r, i), z: ends(&self.z, j) };
            let rows = std::array::from_fn(|k| {
                let (node, component) = (k / 2, k % 2);
                self.unknown(2 * i + node % 3, 2 * j + node / 3, component)
            });
            (rectangle, rows)
        })
    }

    /// How far a node of the upper side is outside the ball at `depth`, and the unit vector along which it is pushed.
    fn gap(&self, i: usize, depth: f64) -> (f64, [f64; 2]) {
        let [u, w] = [0, 1].map(|c| self.displacements[self.unknown(i, 0, c)]);
        if self.push == Push::OnRestShape {
            let lowest = self.r[i].min(1.0);
            return (1.0 - depth - (1.0 - lowest * lowest).sqrt() - w, [0.0, -1.0]);
        }
        let away = [self.r[i] + u, w - (1.0 - depth)];
        let distance = away[0].hypot(away[1]);
        (distance - 1.0, away.map(|x| x / distance))
    }

    /// What the ball at `depth` does; `visit` gets a node's unknowns, its energy's slope and second derivatives.
    fn touch(
        &self,
        depth: f64,
        kind: TangentKind,
        mut visit: impl FnMut([usize; 2], [f64; 2], [[f64; 2]; 2]),
    ) -> Contact {
        let mut contact = Contact { force: 0.0, radius: 0.0, n_nodes: 0 };
        for (i, rest) in self.r.iter().enumerate() {
            let rows = [0, 1].map(|c| self.unknown(i, 0, c));
            if !self.pushed[i] {
                continue;
            }
            let (gap, normal) = self.gap(i, depth);
            let distance = gap + 1.0;
            contact.force += PENALTY * gap * normal[1];
            contact.radius = *rest;
            contact.n_nodes += 1;
            // The part of a normal that turns is negative.
            let turns = kind == TangentKind::Exact && self.push == Push::OnPresentShape;
            let turning = if turns && gap.abs() < SHALLOW { gap } else { 0.0 };
            let along = |a: usize, b: usize| {
                let across = if a == b { 1.0 } else { 0.0 } - normal[a] * normal[b];
                PENALTY * (normal[a] * normal[b] + turning / distance * across)
            };
            let second = [[along(0, 0), along(0, 1)], [along(1, 0), along(1, 1)]];
            visit(rows, normal.map(|x| PENALTY * gap * x), second);
        }
        contact
    }

    /// Sets the system up at the present displacements; answers minus the forces.
    fn assemble(&mut self, depth: f64, kind: TangentKind) -> Vec<f64> {
        let mut system = std::mem::replace(&mut self.system, Banded::new(0, 0));
        system.clear();
        let mut right = vec![0.0; self.displacements.len()];
        for (rectangle, rows) in self.rectangles() {
            let answer = rectangle.answer(self.law, &rows.map(|row| self.displacements[row]), kind);
            for (a, &row) in rows.iter().enumerate() {
                right[row] -= answer.forces[a];
                for (b, &column) in rows.iter().enumerate().filter(|(_, column)| **column <= row) {
                    system.add(row, column, answer.tangent[a][b]);
                }
            }
        }
        self.touch(depth, kind, |rows, slope, second| {
            for a in 0..2 {
                right[rows[a]] -= slope[a];
                for b in 0..=a {
                    system.add(rows[a], rows[b], second[a][b]);
                }
            }
        });
        for row in self.held() {
            system.hold(row);
            right[row] = 0.0;
        }
        self.system = system;
        right
    }

    /// One iteration; answers whether it changed nothing any more.
    fn iterate(&mut self, depth: f64) -> anyhow::Result<bool> {
        let mut right = Vec::new();
        let mut is_factorized = false;
        for kind in [TangentKind::Exact, TangentKind::Projected] {
            right = self.assemble(depth, kind);
            self.n_factorizations += 1;
            is_factorized = self.system.factorize().is_ok();
            if is_factorized {
                break;
            }
        }
        anyhow::ensure!(is_factorized, "no way down at depth {depth}");
        let mut change = right;
        self.system.solve(&mut change);
        let foreseen: Vec<f64> = (0..self.r.len())
            .map(|i| {
                let (gap, normal) = self.gap(i, depth);
                gap + normal[0] * change[self.unknown(i, 0, 0)] + normal[1] * change[self.unknown(i, 0, 1)]
            })
            .collect();
        for (u, du) in self.displacements.iter_mut().zip(&change) {
            *u += du;
        }
        let mut is_settled = change.iter().all(|x| x.abs() <= CHANGE);
        for i in 0..self.r.len() {
            // What would be pulled is let go; what is inside the ball is pushed.
            let is_under = self.push == Push::OnPresentShape || self.r[i] < 1.0;
            let gap = if self.pushed[i] { foreseen[i] } else { self.gap(i, depth).0 };
            let pushes = is_under && gap < 0.0;
            is_settled &= pushes == self.pushed[i];
            self.pushed[i] = pushes;
        }
        Ok(is_settled)
    }

    /// Newton's method at a depth.
    fn converge(&mut self, depth: f64) -> anyhow::Result<()> {
        for _ in 0..MOST_ITERATIONS {
            if self.iterate(depth)? {
                return Ok(());
            }
        }
        bail!("no equilibrium in {MOST_ITERATIONS} iterations at depth {depth}")
    }

    /// A step of depth, from where the last two lead to.
    fn step(&mut self, depth: f64) -> anyhow::Result<()> {
        let here = self.displacements.clone();
        let pushed = self.pushed.clone();
        let way = self.depth - self.depth_before;
        if way > 0.0 {
            let share = (depth - self.depth) / way;
            for (u, before) in self.displacements.iter_mut().zip(&self.before) {
                *u += share * (*u - before);
            }
        }
        for i in 0..self.r.len() {
            let is_under = self.push == Push::OnPresentShape || self.r[i] < 1.0;
            self.pushed[i] |= is_under && self.gap(i, depth).0 < 0.0;
        }
        if let Err(error) = self.converge(depth) {
            (self.displacements, self.pushed) = (here, pushed);
            return Err(error);
        }
        self.before = here;
        self.depth_before = self.depth;
        self.depth = depth;
        Ok(())
    }

    /// Presses the ball down to `depth` in steps no longer than `longest`; answers the force on it.
    pub(in crate::validate) fn press_to(&mut self, depth: f64, longest: f64) -> anyhow::Result<f64> {
        let mut halvings = 0;
        let mut step = longest;
        while self.depth < depth * (1.0 - 1e-12) {
            let n = ((depth - self.depth) / step).ceil();
            let next = if n <= 1.0 { depth } else { self.depth + (depth - self.depth) / n };
            match self.step(next) {
                Ok(()) => {}
                Err(error) if halvings == MOST_DEPTH_HALVINGS => {
                    return Err(error).context("steps of depth were halved without avail");
                }
                Err(_) => {
                    halvings += 1;
                    step *= 0.5;
                }
            }
        }
        Ok(self.contact().force)
    }

    fn contact(&self) -> Contact {
        self.touch(self.depth, TangentKind::Exact, |_, _, _| {})
    }
}

#[cfg(test)]
mod tests;
