//! Interface nodes are brought to the true borders, the others make room: guarded moves of nodes.
//!
//! A node at which regions a, b, ... meet belongs where `phi_a + l_a = phi_b + l_b = ...`, with the smooth shares `phi` of
//! [`super::field`] and a level `l` a region, by which the volumes are corrected ([`super::levels`]); one at which they meet the
//! outside where `1 - 2 phi_0 + (mean of l_a, l_b, ...) = 0` besides. With these differences `psi` and their Jacobian `J` a sweep
//! wants
//!
//! `d = -(J^T J + lambda I)^-1 J^T psi + theta (1 - (J^T J + lambda I)^-1 J^T J) (mean of neighbours - x)`
//!
//! a Levenberg-Marquardt step across the border, and along it, where nothing else holds the node, a part of the way to the
//! middle of its neighbours on the same border. Wanted steps are computed for all nodes at once (in parallel, each by
//! itself); then node by node, in their order, as much of the step is done as keeps the dihedral angles around the node
//! above [`GUARD_DEG`] or at least not worse than before. Nodes within a region, and along their borders those with bad
//! angles, move where the worst angle around them improves. (Freitag and Ollivier-Gooch, Tetrahedral mesh improvement using swapping and smoothing, 1997,
//! doi `10.1002/(SICI)1097-0207(19971115)40:21<3979::AID-NME251>3.0.CO;2-9`, for guarded smoothing by the worst angle.)

use super::complex::{Complex, NO_REGION, Stars};
use super::field::{ShareField, Shares};
use super::interface_faces::InterfaceFace;
use super::levels::Levels;
use super::shape::StarShape;
use crate::math::{DMat3, DVec3, outer};
use crate::mesh::quality::FACES;
use rayon::prelude::*;

/// No move makes an angle smaller than this [degrees].
pub(super) const GUARD_DEG: f64 = 12.0;

/// Stars with larger angles than this [degrees] are not improved.
const GOOD_DEG: f64 = 30.0;

/// Nodes on borders are not moved along them for larger angles than this [degrees].
const BEARABLE_DEG: f64 = 18.0;

/// Longest step across a border in a sweep, over the cell.
const LONGEST_STEP_OVER_CELL: f64 = 0.25;

/// Part of the way along the border to the middle of the neighbours.
const ALONG: f64 = 0.5;

/// `lambda` over the squared slope of a flat border.
const DAMPING: f64 = 1e-2;

/// How far the lattice nodes of the outside may go, over the cell: tetrahedra of which all four corners move by less than
/// half their width, a quarter of the cell, do not turn inside out, so that the unmeshed outside stays free of folds.
const OUTSIDE_RANGE_OVER_CELL: f64 = 0.2;

/// Parts of a wanted step that are tried in turn.
const PARTS: [f64; 4] = [1.0, 0.5, 0.25, 0.1];

/// A complex on its way to the borders.
pub(super) struct Fit<'a> {
    complex: Complex,
    field: &'a ShareField<'a>,
    levels: Levels,
    stars: Stars,
    /// Nodes on borders.
    border_nodes: Vec<u32>,
    /// Nodes within regions.
    inner_nodes: Vec<u32>,
    /// First places of the nodes [m].
    first_m: Vec<DVec3>,
}

/// `(J^T J + lambda I)^-1`, `J^T J` and `J^T psi` at a node.
struct Border {
    inverse: DMat3,
    normal_matrix: DMat3,
    residual: DVec3,
}

impl<'a> Fit<'a> {
    pub(super) fn new(complex: Complex, field: &'a ShareField<'a>, levels: Levels) -> Self {
        let n_nodes = complex.positions_m.len();
        let (border_nodes, inner_nodes) =
            (0..n_nodes as u32).partition(|&n| complex.n_regions_at(n as usize) > 1);
        let stars = Stars::of(n_nodes, &complex.tets);
        let first_m = complex.positions_m.clone();
        Self { complex, field, levels, stars, border_nodes, inner_nodes, first_m }
    }

    /// Changes the levels towards the volumes `wanted_m3` (from region 1 on).
    pub(super) fn correct_levels(&mut self, faces: &[InterfaceFace], wanted_m3: &[f64]) {
        self.levels.correct(&self.complex, faces, self.field, wanted_m3);
    }

    /// The complex and the levels at last.
    pub(super) fn finish(self) -> (Complex, Levels) {
        (self.complex, self.levels)
    }

    /// One sweep over all nodes.
    pub(super) fn sweep(&mut self) {
        let wishes: Vec<DVec3> = self
            .border_nodes
            .par_iter()
            .with_min_len(64)
            .map_init(|| self.field.shares(), |shares, &node| self.wish(node as usize, shares))
            .collect();
        self.move_border_nodes(&wishes);
        self.improve_inner_nodes();
        self.improve_border_nodes();
    }

    /// The step that node `node` on a border wants to take.
    fn wish(&self, node: usize, shares: &mut Shares) -> DVec3 {
        let at_m = self.complex.positions_m[node];
        let Border { inverse, normal_matrix, residual } = self.border(node, shares);
        let across_m = -(inverse * residual);
        let along_m = self.middle_of_neighbours_m(node) - at_m;
        let along_m = ALONG * (along_m - inverse * (normal_matrix * along_m));
        let longest_m = LONGEST_STEP_OVER_CELL * self.complex.cell_m[node];
        let step_m = across_m.clamp_length_max(longest_m) + along_m.clamp_length_max(longest_m);
        if step_m.is_finite() { step_m } else { DVec3::ZERO }
    }

    /// The border at a node.
    fn border(&self, node: usize, shares: &mut Shares) -> Border {
        self.field.sample_into(self.complex.positions_m[node], shares);
        let damping = DAMPING * shares.flat_slope * shares.flat_slope;
        let (normal_matrix, residual) = self.border_system(node, shares);
        let inverse = (normal_matrix + DMat3::from_diagonal(DVec3::splat(damping))).inverse();
        Border { inverse, normal_matrix, residual }
    }

    /// `J^T J` and `J^T psi` of the regions that meet in `node`.
    fn border_system(&self, node: usize, shares: &Shares) -> (DMat3, DVec3) {
        let regions = &self.complex.node_regions[node][..self.complex.n_regions_at(node)];
        let (mut matrix, mut residual) = (DMat3::ZERO, DVec3::ZERO);
        let mut add = |psi: f64, row: DVec3| {
            matrix += outer(row, row);
            residual += row * psi;
        };
        // Against the outside once, for all others together; among the others each against the first.
        let (is_outer, inner) = match regions {
            [0, inner @ ..] => (true, inner),
            inner => (false, inner),
        };
        let inner = inner.iter().map(|&r| usize::from(r));
        if is_outer {
            let (psi, row) = shares.lead(0, 1);
            let level: f64 = inner.clone().map(|r| self.levels.difference(r, 0)).sum();
            add(psi + level / inner.len() as f64, row);
        }
        let mut inner = inner;
        if let Some(first) = inner.next() {
            for region in inner {
                let (psi, row) = shares.lead(first, region);
                add(psi + self.levels.difference(region, first), row);
            }
        }
        (matrix, residual)
    }

    /// Middle of the neighbours that lie on all borders of `node`.
    fn middle_of_neighbours_m(&self, node: usize) -> DVec3 {
        let own = self.complex.node_regions[node];
        let (mut sum_m, mut n) = (DVec3::ZERO, 0.0);
        for &tet in self.stars.at(node) {
            for other in
                self.complex.tets[tet as usize].map(|n| n as usize).into_iter().filter(|&o| o != node)
            {
                let others = self.complex.node_regions[other];
                if own.iter().all(|r| *r == NO_REGION || others.contains(r)) {
                    sum_m += self.complex.positions_m[other];
                    n += 1.0;
                }
            }
        }
        if n > 0.0 { sum_m / n } else { self.complex.positions_m[node] }
    }

    fn move_border_nodes(&mut self, wishes: &[DVec3]) {
        let guard = libm::cos(GUARD_DEG.to_radians());
        let shape = StarShape { stars: &self.stars };
        for (&node, wish_m) in self.border_nodes.iter().zip(wishes) {
            let node = node as usize;
            let at_m = self.complex.positions_m[node];
            let (now, _) = shape.worst_at(&self.complex, node, at_m);
            let limit = now.max(guard);
            let part = PARTS
                .iter()
                .find(|&&part| shape.is_within(&self.complex, node, at_m + part * *wish_m, limit));
            if let Some(part) = part {
                self.complex.positions_m[node] = at_m + *part * *wish_m;
            }
        }
    }

    fn improve_inner_nodes(&mut self) {
        let good = libm::cos(GOOD_DEG.to_radians());
        let shape = StarShape { stars: &self.stars };
        for &node in &self.inner_nodes {
            let node = node as usize;
            let at_m = self.complex.positions_m[node];
            let (mut now, tet) = shape.worst_at(&self.complex, node, at_m);
            let is_outside = self.complex.node_regions[node][0] == 0;
            if now < good {
                continue;
            }
            let mut best_m = at_m;
            let away = self.away_from_opposite_face(tet, node) * self.complex.cell_m[node];
            let to_middle = self.middle_of_neighbours_m(node) - at_m;
            let range_m = OUTSIDE_RANGE_OVER_CELL * self.complex.cell_m[node];
            for step_m in [to_middle, 0.2 * away, 0.06 * away, 0.02 * away] {
                let to_m = at_m + step_m;
                if is_outside && to_m.distance(self.first_m[node]) > range_m {
                    continue;
                }
                let (then, _) = shape.worst_at(&self.complex, node, to_m);
                if then < now {
                    (now, best_m) = (then, to_m);
                }
            }
            self.complex.positions_m[node] = best_m;
        }
    }

    /// Moves nodes along their borders where the worst angle around them is bad and improves.
    fn improve_border_nodes(&mut self) {
        let bearable = libm::cos(BEARABLE_DEG.to_radians());
        let mut shares = self.field.shares();
        for at in 0..self.border_nodes.len() {
            let node = self.border_nodes[at] as usize;
            let at_m = self.complex.positions_m[node];
            let shape = StarShape { stars: &self.stars };
            let (mut now, tet) = shape.worst_at(&self.complex, node, at_m);
            if now < bearable {
                continue;
            }
            let border = self.border(node, &mut shares);
            let away = self.away_from_opposite_face(tet, node);
            let along = (away - border.inverse * (border.normal_matrix * away)).normalize_or_zero();
            let mut best_m = at_m;
            for part in [0.12, 0.04, -0.04, 0.013] {
                let to_m = at_m + part * self.complex.cell_m[node] * along;
                let (then, _) = shape.worst_at(&self.complex, node, to_m);
                if then < now {
                    (now, best_m) = (then, to_m);
                }
            }
            self.complex.positions_m[node] = best_m;
        }
    }

    /// Unit vector from the face opposite to `node` in `tet` towards `node`.
    fn away_from_opposite_face(&self, tet: u32, node: usize) -> DVec3 {
        let nodes = self.complex.tets[tet as usize];
        let corners_m = self.complex.corners_m(tet as usize);
        let at = nodes.iter().position(|&n| n as usize == node).unwrap_or(0);
        let [p, q, r] = FACES[at].map(|c| corners_m[c]);
        -(q - p).cross(r - p).normalize_or_zero()
    }
}
