//! Follows a removal in the table: rows and loaded nodes are added and removed, low-rank updates are added, and the error
//! is estimated.

use super::cuts::Cuts;
use super::low_rank::{Change, NodeColumns, NodeWeight, RemovedTet, Working, WorkingNode};
use super::table::{Table, place};
use super::table_rows::{LowRankChange, RANK, add_low_rank_to, swap_rows_of};
use super::{Compliance, NONE, Precision, Precomputed};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::{NodeId, TetId};

/// Tetrahedra that are removed as one change at most: the dense work in a change grows with the square of their
/// number, the passes over the table with their number alone.
const MOST_TETS_IN_CHANGE: usize = 16;

/// Number of random loads in one estimate of the error: a choice. All four are too small by more than a factor of three
/// about once in a hundred edits, and the largest estimate so far counts.
const N_PROBES: usize = 4;

/// Nodes of a probe that change from edit to edit, and the largest number of corners of removed tetrahedra: choices, so
/// that an estimate costs less than the edit.
const PROBED_IN_TURN: usize = 12;
const MOST_PROBED_CORNERS: usize = 16;

/// Least share of rows and loaded nodes to spare when a table grows: 1 / 8. A choice.
const SPARE_SHARE: usize = 8;

impl Precomputed {
    /// Removes the stiffness and weight of `taken` from the compliance, and holds the nodes `held` for good.
    pub(super) fn change_compliance(
        &mut self,
        cuts: &mut Cuts,
        taken: &[TetId],
        held: &[NodeId],
        borne: &[bool],
    ) {
        let mut touched: Vec<NodeId> = taken.iter().flat_map(|&t| cuts.corners(t)).collect();
        touched.extend(held);
        touched.sort_unstable();
        touched.dedup();
        touched.retain(|n| !(cuts.is_fixed[n.index()] || cuts.is_out[n.index()]));
        self.make_loadable(cuts, &touched);

        let mut working = self.working(cuts, &touched);
        let mut changes: Vec<Change> =
            held.chunks(MOST_TETS_IN_CHANGE).map(|nodes| working.hold(nodes)).collect();
        let material = self.compliance.material;
        let removed: Vec<RemovedTet> = taken
            .iter()
            .map(|&t| {
                let corners_m = cuts.body.mesh().corners_m(t);
                RemovedTet::new(cuts.corners(t), corners_m, material.lambda_pa(), material.mu_pa())
            })
            .collect();
        for tets in removed.chunks(MOST_TETS_IN_CHANGE) {
            let Some((change, least_pivot)) = working.remove(tets) else { continue };
            cuts.report.least_pivot = cuts.report.least_pivot.min(least_pivot);
            changes.push(change);
        }
        self.add_changes(cuts, &changes);
        for change in changes {
            cuts.history.push(change);
        }
        cuts.taken_out.extend(removed);

        let mut masses: Vec<(NodeId, f64)> = Vec::new();
        for &tet in taken {
            let corner_kg = material.density_kg_per_m3() * cuts.body.mesh().tet_volume_m3(tet) / 4.0;
            masses.extend(cuts.corners(tet).map(|n| (n, corner_kg)));
        }
        masses.retain(|(n, _)| borne[n.index()] && !cuts.is_fixed[n.index()]);
        for &(node, mass_kg) in &masses {
            let loaded = self.loadable_index(node).expect("corners of what goes are loadable");
            let response = &mut self.compliance.weight_response_s2;
            for axis in 0..3 {
                self.compliance.table.add_column_to(loaded as usize, axis, -mass_kg, response);
            }
        }
        let at =
            |&(n, m): &(NodeId, f64)| (cuts.history.place(n).expect("loadable nodes are known") as u32, m);
        let masses = masses.iter().map(at).collect();
        cuts.history.push_lighter(masses);
        cuts.report.n_columns = cuts.history.n_columns();
        cuts.report.n_taken_out = cuts.taken_out.len();
    }

    /// Adds missing rows and columns of nodes.
    fn make_loadable(&mut self, cuts: &mut Cuts, nodes: &[NodeId]) {
        let bare: Vec<NodeId> = nodes.iter().copied().filter(|&n| !self.is_loadable(n)).collect();
        if bare.is_empty() {
            return;
        }
        self.make_room(self.compliance.rows.len() + bare.len(), self.compliance.n_loadable + bare.len());
        for (i, (columns, weight)) in cuts.columns_from_factor(&bare).into_iter().enumerate() {
            self.add_loadable(cuts, bare[i], &columns, &weight);
        }
        cuts.report.n_laid_bare += bare.len();
    }

    fn add_loadable(&mut self, cuts: &Cuts, node: NodeId, columns: &NodeColumns, weight: &NodeWeight) {
        let compliance = &mut self.compliance;
        let m = compliance.n_loadable;
        let mut row = self.row_of[node.index()] as usize;
        if self.row_of[node.index()] == NONE {
            row = compliance.rows.len();
            compliance.rows.push(node);
            self.row_of[node.index()] = row as u32;
            for d in 0..3 {
                for axis in 0..3 {
                    compliance.weight_response_s2[place(row, axis, d)] = weight[d][axis];
                }
            }
        }
        if row != m {
            let other = compliance.rows[m];
            compliance.rows.swap(row, m);
            compliance.table.swap_rows(row, m);
            swap_rows_of(&mut compliance.weight_response_s2, row, m);
            self.row_of[other.index()] = row as u32;
            self.row_of[node.index()] = m as u32;
        }
        compliance.table.push_loaded();
        compliance.n_loadable += 1;
        for row in 0..compliance.rows.len() {
            let of = cuts.history.place(compliance.rows[row]).expect("rows are known");
            let column =
                |d: usize| DVec3::from_slice(columns[d].get(3 * of..3 * of + 3).unwrap_or(&[0.0; 3]));
            let tensor = DMat3::from_cols(column(0), column(1), column(2));
            compliance.table.set_tensor(row, m, &tensor);
            if row < m {
                compliance.table.set_tensor(m, row, &tensor.transpose());
            }
        }
    }

    /// Removes a node from the table, if it is there.
    pub(super) fn drop_node(&mut self, node: NodeId) {
        let row = self.row_of[node.index()];
        if row == NONE {
            return;
        }
        let mut row = row as usize;
        let compliance = &mut self.compliance;
        let mut exchange = |compliance: &mut Compliance, a: usize, b: usize| {
            if a != b {
                let (of_a, of_b) = (compliance.rows[a], compliance.rows[b]);
                compliance.rows.swap(a, b);
                compliance.table.swap_rows(a, b);
                swap_rows_of(&mut compliance.weight_response_s2, a, b);
                self.row_of[of_a.index()] = b as u32;
                self.row_of[of_b.index()] = a as u32;
            }
        };
        if row < compliance.n_loadable {
            let last = compliance.n_loadable - 1;
            compliance.table.swap_loaded(row, last);
            exchange(compliance, row, last);
            compliance.table.pop_loaded();
            compliance.n_loadable = last;
            row = last;
        }
        let last = compliance.rows.len() - 1;
        exchange(compliance, row, last);
        compliance.rows.pop();
        compliance.table.clear_row(last);
        for component in 0..9 {
            compliance.weight_response_s2[place(last, component / 3, component % 3)] = 0.0;
        }
        self.row_of[node.index()] = NONE;
    }

    /// Makes room for so many rows and loaded nodes.
    fn make_room(&mut self, n_rows: usize, n_loaded: usize) {
        if n_rows > self.compliance.table.room() {
            self.grow(n_rows, n_loaded);
        }
    }

    /// Makes room for so many rows and loaded nodes, and some to spare.
    pub(super) fn grow(&mut self, n_rows: usize, n_loaded: usize) {
        let compliance = &mut self.compliance;
        let with_spare = |n: usize| n + (n / SPARE_SHARE).max(32);
        compliance.table = compliance.table.with_room(with_spare(n_rows), with_spare(n_loaded));
        let room = compliance.table.room();
        compliance.weight_response_s2.resize(Table::stride(room), 0.0);
    }

    /// Columns and responses to weight of nodes that are loadable.
    fn working(&self, cuts: &mut Cuts, nodes: &[NodeId]) -> Working {
        let is_exact = self.compliance.table.precision() == Precision::F64;
        // Single precision would not tell a mechanism from a thin bridge, so the columns come from the factor.
        let from_factor = if is_exact { Vec::new() } else { cuts.columns_from_factor(nodes) };
        let mut from_factor = from_factor.into_iter();
        let of_node = |&node: &NodeId| {
            let loaded = self.row_of[node.index()] as usize;
            let (columns, weight) = from_factor.next().unwrap_or_else(|| {
                let mut columns: NodeColumns = std::array::from_fn(|_| vec![0.0; cuts.history.n_unknowns()]);
                for (row, n) in self.compliance.rows.iter().enumerate() {
                    let at = cuts.history.place(*n).expect("rows are known");
                    let tensor = self.compliance.table.tensor(row, loaded);
                    for (d, column) in columns.iter_mut().enumerate() {
                        column[3 * at..3 * at + 3].copy_from_slice(&tensor.col(d).to_array());
                    }
                }
                let response = &self.compliance.weight_response_s2;
                let weight: NodeWeight =
                    std::array::from_fn(|d| std::array::from_fn(|axis| response[place(loaded, axis, d)]));
                (columns, weight)
            });
            WorkingNode {
                node,
                place: cuts.history.place(node).expect("loadable nodes are known"),
                columns,
                weight,
            }
        };
        Working { nodes: nodes.iter().map(of_node).collect() }
    }

    /// Adds changes to the table and the response to weight.
    fn add_changes(&mut self, cuts: &Cuts, changes: &[Change]) {
        let compliance = &mut self.compliance;
        let places: Vec<usize> =
            compliance.rows.iter().map(|&n| 3 * cuts.history.place(n).expect("rows are known")).collect();
        let columns: Vec<(f64, &Vec<f64>, &[f64; 3])> = changes
            .iter()
            .flat_map(|c| c.columns().iter().zip(c.of_weight()).map(|(w, weight)| (c.sign(), w, weight)))
            .collect();
        for group in columns.chunks(RANK) {
            let of_row: Vec<_> = group
                .iter()
                .map(|&(_, w, _)| {
                    let places = &places;
                    move |row: usize, axis: usize| w[places[row] + axis]
                })
                .collect();
            let blocks = LowRankChange::blocks_of(compliance.rows.len(), &of_row);
            let mut factors = vec![[[0.0; 3]; RANK]; compliance.n_loadable];
            for (factors, &place) in factors.iter_mut().zip(&places) {
                for (factor, &(sign, w, _)) in factors.iter_mut().zip(group) {
                    *factor = [0, 1, 2].map(|d| sign * w[place + d]);
                }
            }
            let mut of_weight = [[0.0; 3]; RANK];
            for (factor, &(sign, _, weight)) in of_weight.iter_mut().zip(group) {
                *factor = weight.map(|x| sign * x);
            }
            add_low_rank_to(&mut compliance.weight_response_s2, &blocks, &of_weight);
            compliance.table.add_low_rank(&LowRankChange { blocks, factors });
        }
    }

    /// Estimates the error from the responses to [`N_PROBES`] loads: forces of 1 N with random signs on the softest node, on
    /// the corners of the `taken` tetrahedra and on [`PROBED_IN_TURN`] other nodes, which change from edit to edit.
    ///
    /// Let x be the table's response to a load g, C the exact compliance, C0 that of the uncut body, and U U^T the stiffness
    /// of the removed tetrahedra. Then y = x - C0 (g + U U^T x) is C0 K times the error, which is small where the cuts made
    /// the body soft. The error itself is y + C U U^T y; here C is read from the table. Random signs keep the errors of
    /// several columns from cancelling: the sum over columns j of D_ij with random signs is seldom less than a third of the
    /// largest of them (its standard deviation is their root sum of squares), and hardly ever in each of the probes.
    pub(super) fn probe(&self, cuts: &mut Cuts, taken: &[TetId]) {
        if self.compliance.n_loadable == 0 {
            return;
        }
        let (softest, largest) = self.softest();
        let mut random = SeededRandom::new(cuts.report.n_edits as u64);
        let probed = self.probed_nodes(cuts, taken, softest);
        let (mut right, responses) = self.probing_loads(cuts, &probed, &mut random);
        solve_twice(cuts, &mut right);
        let error = self.largest_error(cuts, &probed, &right, &responses);
        let report = &mut cuts.report;
        report.error = report.error.max(error / largest.max(f64::MIN_POSITIVE));
        let limits = self.recomputation_limits;
        report.wants_recomputation = report.error > limits.error || report.n_columns > limits.n_columns;
    }

    /// The loadable node with the largest diagonal compliance, and this compliance [m/N].
    fn softest(&self) -> (usize, f64) {
        let diagonal = |m: usize| {
            let tensor = self.compliance.table.tensor(m, m);
            [0, 1, 2].map(|d| tensor.col(d)[d]).into_iter().fold(f64::MIN_POSITIVE, f64::max)
        };
        let (mut softest, mut largest) = (0, 0.0);
        for m in 0..self.compliance.n_loadable {
            let yields = diagonal(m);
            if yields > largest {
                (softest, largest) = (m, yields);
            }
        }
        (softest, largest)
    }

    /// The loadable nodes that this edit's probes load, ascending.
    fn probed_nodes(&self, cuts: &Cuts, taken: &[TetId], softest: usize) -> Vec<usize> {
        let mut probed: Vec<usize> = vec![softest];
        let corners = taken.iter().flat_map(|&t| cuts.corners(t)).filter_map(|n| self.loadable_index(n));
        probed.extend(corners.take(MOST_PROBED_CORNERS).map(|m| m as usize));
        // A step by a prime number visits all loadable nodes in turn.
        let first = cuts.report.n_edits * PROBED_IN_TURN;
        probed.extend((first..first + PROBED_IN_TURN).map(|i| i * 7919 % self.compliance.n_loadable));
        probed.sort_unstable();
        probed.dedup();
        probed
    }

    /// x of a node, zero for one without a row.
    fn of_row(&self, x: &[DVec3], node: NodeId) -> DVec3 {
        let row = self.row_of[node.index()];
        if row == NONE { DVec3::ZERO } else { x[row as usize] }
    }

    /// g + U U^T x of each probe in the uncut body's unknowns, and x, the table's response to g.
    fn probing_loads(
        &self,
        cuts: &Cuts,
        probed: &[usize],
        random: &mut SeededRandom,
    ) -> (Vec<f64>, Vec<Vec<DVec3>>) {
        let compliance = &self.compliance;
        let system = &cuts.origin.system;
        let n_free = system.n_free();
        let mut right = vec![0.0; N_PROBES * n_free];
        let mut responses = vec![vec![DVec3::ZERO; compliance.rows.len()]; N_PROBES];
        for (right, x) in right.chunks_exact_mut(n_free.max(1)).zip(&mut responses) {
            let mut right_n = vec![DVec3::ZERO; self.rest_m.len()];
            for &m in probed {
                let mut sign = || if random.next_u64() >> 63 == 0 { 1.0 } else { -1.0 };
                let force_n = DVec3::new(sign(), sign(), sign());
                right_n[compliance.rows[m].index()] = force_n;
                for (row, x) in x.iter_mut().enumerate() {
                    *x += compliance.table.tensor(row, m) * force_n;
                }
            }
            add_taken_out(cuts, |n| self.of_row(x, n), &mut right_n);
            system.gather_into(&right_n, right);
        }
        (right, responses)
    }

    /// The largest component [m] of the probes' errors. `exact`: C0 (g + U U^T x) of each probe; `responses`: x.
    fn largest_error(&self, cuts: &Cuts, probed: &[usize], exact: &[f64], responses: &[Vec<DVec3>]) -> f64 {
        let compliance = &self.compliance;
        let system = &cuts.origin.system;
        let mut error = 0.0_f64;
        // A value that is not finite counts as an infinite error.
        let mut note = |off: DVec3| {
            let off = off.abs().max_element();
            error = if off.is_finite() { error.max(off) } else { f64::INFINITY };
        };
        let mut pulled: Vec<NodeId> = cuts.taken_out.iter().flat_map(|tet| tet.nodes).collect();
        pulled.sort_unstable();
        pulled.dedup();
        pulled.retain(|n| self.row_of[n.index()] != NONE);
        for (solution, x) in exact.chunks_exact(system.n_free().max(1)).zip(responses) {
            let exact = |n: NodeId| {
                DVec3::from_array([0, 1, 2].map(|d| system.row_of(n, d).map_or(0.0, |row| solution[row])))
            };
            let y = |n: NodeId| self.of_row(x, n) - exact(n);
            compliance.rows.iter().for_each(|&n| note(y(n)));
            let mut force_n = vec![DVec3::ZERO; self.rest_m.len()];
            add_taken_out(cuts, y, &mut force_n);
            for &m in probed {
                // The table is symmetric, and the columns of a loaded node are adjacent in memory.
                let follows = |n: &NodeId| {
                    let row = self.row_of[n.index()] as usize;
                    compliance.table.tensor(row, m).transpose() * force_n[n.index()]
                };
                note(y(compliance.rows[m]) + pulled.iter().map(follows).sum::<DVec3>());
            }
        }
        error
    }
}

/// Solves with the uncut body's factor for all probes, with one refinement: the table came from the same factor, whose
/// rounding would not show otherwise.
fn solve_twice(cuts: &Cuts, right: &mut [f64]) {
    let (system, factor) = (&cuts.origin.system, &cuts.origin.factor);
    let n_free = system.n_free().max(1);
    let mut scratch = factor.scratch(N_PROBES);
    let mut left = right.to_vec();
    factor.solve_in_place(right, N_PROBES, &mut scratch);
    for (x, left) in right.chunks_exact(n_free).zip(left.chunks_exact_mut(n_free)) {
        system.subtract_product(x, left);
    }
    factor.solve_in_place(&mut left, N_PROBES, &mut scratch);
    right.iter_mut().zip(&left).for_each(|(x, more)| *x += more);
}

/// Adds the forces [N] U U^T x of all removed tetrahedra for displacements x [m].
fn add_taken_out(cuts: &Cuts, x_m: impl Fn(NodeId) -> DVec3, force_n: &mut [DVec3]) {
    for tet in &cuts.taken_out {
        for (node, f) in tet.nodes.into_iter().zip(tet.forces_n(tet.nodes.map(&x_m))) {
            force_n[node.index()] += f;
        }
    }
}
