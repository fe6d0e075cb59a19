//! Adaptive non-linearity (seed `002`, s. 6): linear forces everywhere, the non-linear part where it matters.
//!
//! By displacement, as the report does it: a node gets its non-linear force when it is displaced by more than a
//! threshold. That tells nothing about the error, and a body that only moves away becomes non-linear.
//!
//! By error bound: a translation leaves the sum of the non-linear forces at a node p as it is, so displacements may
//! be taken relative to that of p itself. With r the largest of |u_j - u_p| over the edges (p, j), every sum at p
//! that has a factor u_p - u_p vanishes, and what is left is at most
//!
//! |N_p| <= c_p r^2 + d_p r^3,
//! c_p = sum over edges (|C_pjj| + 2 |C_jjp|) + sum over triangles 2 (|C_pjk| + |C_jkp| + |C_kjp|),
//! d_p = 4 [ sum over edges |D_jjjp| + sum over triangles (|D_jjkp| + |D_jkjp + D_kjjp| + |D_kkjp| + |D_kjkp + D_jkkp|)
//!         + sum over tetrahedra (|D_jklp + D_kjlp| + |D_jlkp + D_ljkp| + |D_kljp + D_lkjp|) ].
//!
//! c_p and d_p are accumulated once and follow removals. A node whose bound is below the tolerance gets its linear
//! force alone: its force is then wrong by at most that bound, which the report states. The bound adds sizes where
//! forces of neighbouring tetrahedra cancel: in a smoothly bent bar it is 40 to 50 times the true error.

use super::numbers::{EdgeStiffness, TetScalars, TriangleStiffness};
use crate::model::explicit::{Padded, unpadded};

/// Covers the rounding of the bounds' own sums, relatively.
const ROUNDING: f64 = 1.0 + 1e-9;

/// Where the non-linear part of the force is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum NonlinearPart {
    /// At every node: the full model.
    #[default]
    Everywhere,
    /// At nodes displaced by more than this (seed `002`, s. 6); infinite: the linear model.
    AboveDisplacement {
        /// Threshold [m].
        threshold_m: f64,
    },
    /// At nodes where leaving it out could change the force by more than this.
    AboveErrorBound {
        /// Tolerance of the force on each node [N].
        tolerance_n: f64,
    },
}

/// What the last force evaluation left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AdaptiveReport {
    /// Nodes with their non-linear force.
    pub n_nonlinear: usize,
    /// Nodes with a tetrahedron.
    pub n_live: usize,
    /// No node's force differs from that of the full model by more [N]; zero for the full model, unknown (`None`)
    /// with a threshold on displacement.
    pub force_error_bound_n: Option<f64>,
    /// Nor does the sum of all nodes' differences [N].
    pub summed_error_bound_n: Option<f64>,
}

impl AdaptiveReport {
    /// Share of the nodes that are non-linear, from 0 to 1.
    pub fn nonlinear_share(&self) -> f64 {
        if self.n_live == 0 { 0.0 } else { self.n_nonlinear as f64 / self.n_live as f64 }
    }
}

/// The coefficients of a node's bound.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Bound {
    /// c_p [N/m2].
    pub(super) quadratic: f64,
    /// d_p [N/m3].
    pub(super) cubic: f64,
}

impl Bound {
    pub(super) fn add(&mut self, other: Self, sign: f64) {
        self.quadratic += sign * other.quadratic;
        self.cubic += sign * other.cubic;
    }

    /// Bound of the non-linear force [N] for neighbours displaced by at most `r_m` relative to the node.
    fn force_n(&self, r_m: f64) -> f64 {
        (self.quadratic + self.cubic * r_m) * (r_m * r_m) * ROUNDING
    }
}

/// Shares of an edge in the bounds of its two nodes.
pub(super) fn edge_bounds(stiffness: &EdgeStiffness) -> [Bound; 2] {
    let [c_ppj, c_pjj, c_jpp, c_jjp] = stiffness.c.map(|c| c.length());
    let [d_jppp, d_jjjp, ..] = stiffness.d.map(f64::abs);
    [
        Bound { quadratic: c_pjj + 2.0 * c_jjp, cubic: 4.0 * d_jjjp },
        Bound { quadratic: c_jpp + 2.0 * c_ppj, cubic: 4.0 * d_jppp },
    ]
}

/// Shares of a triangle in the bounds of its three nodes.
pub(super) fn triangle_bounds(stiffness: &TriangleStiffness) -> [Bound; 3] {
    let quadratic = 2.0 * stiffness.c.iter().map(|c| c.length()).sum::<f64>();
    let of_doubled = stiffness.d.map(|[a, b, e]| 4.0 * (a.abs() + (b + e).abs()));
    let all: f64 = of_doubled.iter().sum();
    of_doubled.map(|own| Bound { quadratic, cubic: all - own })
}

/// Share of a tetrahedron in the bound of each of its nodes.
pub(super) fn tet_bound(scalars: &TetScalars) -> Bound {
    let cubic = scalars.d.iter().map(|[d, exchanged]| 4.0 * (d + exchanged).abs()).sum();
    Bound { quadratic: 0.0, cubic }
}

/// The choice of nodes, with its scratch.
#[derive(Clone, Debug)]
pub(super) struct Adaptivity {
    pub(super) part: NonlinearPart,
    /// Nodes that get their non-linear force; meaningless for [`NonlinearPart::Everywhere`].
    pub(super) is_nonlinear: Vec<bool>,
    /// Squared r of each node.
    reach_m2: Vec<f64>,
    pub(super) report: AdaptiveReport,
}

impl Adaptivity {
    pub(super) fn new(n_nodes: usize) -> Self {
        Self {
            part: NonlinearPart::Everywhere,
            is_nonlinear: vec![true; n_nodes],
            reach_m2: vec![0.0; n_nodes],
            report: AdaptiveReport::default(),
        }
    }

    /// For another number of nodes, until the next evaluation selects among them.
    pub(super) fn resize(&mut self, n_nodes: usize) {
        self.is_nonlinear.resize(n_nodes, true);
        self.reach_m2.resize(n_nodes, 0.0);
    }

    /// Marks the nodes that get their non-linear force, and reports. `edges`: nodes of each edge that lives.
    pub(super) fn select(
        &mut self,
        u: &[Padded],
        is_live: &[bool],
        bounds: &[Bound],
        edges: impl Iterator<Item = [usize; 2]>,
    ) {
        let mut report = AdaptiveReport::default();
        match self.part {
            NonlinearPart::Everywhere => {
                report.n_live = is_live.iter().filter(|&&live| live).count();
                report.n_nonlinear = report.n_live;
                report.force_error_bound_n = Some(0.0);
                report.summed_error_bound_n = Some(0.0);
            }
            NonlinearPart::AboveDisplacement { threshold_m } => {
                for (p, u) in u.iter().enumerate() {
                    let live = is_live[p];
                    self.is_nonlinear[p] = live && unpadded(u).length() > threshold_m;
                    report.n_live += usize::from(live);
                    report.n_nonlinear += usize::from(self.is_nonlinear[p]);
                }
            }
            NonlinearPart::AboveErrorBound { tolerance_n } => {
                self.measure_reach(u, edges);
                let (mut largest_n, mut sum_n) = (0.0_f64, 0.0);
                for (p, bound) in bounds.iter().enumerate() {
                    let live = is_live[p];
                    let error_n = bound.force_n(self.reach_m2[p].sqrt());
                    // Not `>`: what is no number is not left out.
                    let left_out = error_n <= tolerance_n;
                    self.is_nonlinear[p] = live && !left_out;
                    report.n_live += usize::from(live);
                    report.n_nonlinear += usize::from(self.is_nonlinear[p]);
                    if live && left_out {
                        largest_n = largest_n.max(error_n);
                        sum_n += error_n;
                    }
                }
                report.force_error_bound_n = Some(largest_n);
                report.summed_error_bound_n = Some(sum_n);
            }
        }
        self.report = report;
    }

    fn measure_reach(&mut self, u: &[Padded], edges: impl Iterator<Item = [usize; 2]>) {
        self.reach_m2.fill(0.0);
        for [p, j] in edges {
            let (a, b) = (&u[p], &u[j]);
            let d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
            let square_m2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            for n in [p, j] {
                // What is no number stays, and no bound is below any tolerance then.
                if square_m2 > self.reach_m2[n] || square_m2.is_nan() {
                    self.reach_m2[n] = square_m2;
                }
            }
        }
    }
}
