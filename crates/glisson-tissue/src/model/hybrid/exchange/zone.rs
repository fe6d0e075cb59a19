//! One pre-computed zone: its tensors, the forces on it, and its response.
//!
//! Let K_zz be the rows and columns of K of the zone's free nodes, where frontier nodes include the stiffness of other
//! zones. Then K_zz u = f where f_p = F_p - sum over neighbours j outside the zone of B^pj u_j (seed `003` eq. 4.13
//! and 4.16; exact also for nodes of more than two zones). T = K_zz^-1 is kept for unit forces on the loadable
//! nodes: those of frontier and surface.
//!
//! After a removal next to the zone K_zz has lost Delta on some frontier nodes D. Then T' = T + T_D W T_D^T with
//! W = Delta (I - T_DD Delta)^-1 (Sherman and Morrison 1950, doi 10.1214/aoms/1177729893; Woodbury 1950): the tensors
//! stay, and the forces W u_D act on D in addition.

use super::dense::SmallLu;
use super::{ExchangeAmount, ExchangeCount, Method};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::NodeId;

/// Most nodes of one zone whose displacement can be imposed at once.
pub(super) const MAX_IMPOSED: usize = 64;
/// Marks a node that is not in a zone.
pub(super) const NONE: u32 = u32::MAX;
/// After so many sweeps with partial exchange the response is summed anew, so that rounding does not accumulate.
const SWEEPS_TO_RENEW: u64 = 256;

/// State that all zones read.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    /// Latest displacement of each node [m].
    pub(super) displacement_m: Vec<DVec3>,
    /// Displacement of each node [m] as the tensor-mass zones see it.
    pub(super) dynamic_view_m: Vec<DVec3>,
    /// Force [N] by which linear elasticity exceeds the non-linear tetrahedra at each node; empty without such.
    pub(super) surplus_n: Vec<DVec3>,
    /// Method A: forces [N] that hold a zone's inner nodes' displacements at its frontier nodes, for each zone.
    pub(super) outgoing_n: Vec<Vec<DVec3>>,
    /// Gravity minus the one at rest [m/s2].
    pub(super) pull_m_per_s2: DVec3,
}

/// Lists in one array, one after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct Lists<T> {
    start: Vec<u32>,
    items: Vec<T>,
}

impl<T> Lists<T> {
    pub(super) fn of(lists: impl Iterator<Item = Vec<T>>) -> Self {
        let mut all = Self { start: vec![0], items: Vec::new() };
        for list in lists {
            all.items.extend(list);
            all.start.push(all.items.len() as u32);
        }
        all
    }

    pub(super) fn get(&self, i: usize) -> &[T] {
        &self.items[self.start[i] as usize..self.start[i + 1] as usize]
    }

    pub(super) fn n_items(&self) -> usize {
        self.items.len()
    }
}

/// What acts from neighbours on each frontier node of a zone.
#[derive(Clone, Debug, Default)]
pub(super) struct Incoming {
    /// Nodes outside the zone and their tensors B^pj, on [`Shared::displacement_m`].
    pub(super) nodes: Lists<(u32, DMat3)>,
    /// Nodes of tensor-mass zones and their tensors, on [`Shared::dynamic_view_m`].
    pub(super) dynamic: Lists<(u32, DMat3)>,
    /// Method A: zones and their frontier nodes, on [`Shared::outgoing_n`].
    pub(super) forces: Lists<(u32, u32)>,
}

/// A correction of the tensors for tetrahedra removed around the zone.
#[derive(Clone, Debug)]
pub(super) struct Correction {
    /// Loadable nodes D, ascending.
    pub(super) nodes: Vec<u32>,
    /// Delta [N/m] by rows, three per node.
    lost: Vec<f64>,
    /// W [N/m] by rows.
    pub(super) weight: Vec<f64>,
    before_m: Vec<f64>,
    /// W T_D^j of one loadable node j: a tensor per node of D.
    spread: Vec<DMat3>,
}

impl Correction {
    /// W between two nodes of D.
    fn weight(&self, i: usize, j: usize) -> DMat3 {
        let n = 3 * self.nodes.len();
        let row = |a: usize| DVec3::from_slice(&self.weight[(3 * i + a) * n + 3 * j..][..3]);
        DMat3::from_cols(row(0), row(1), row(2)).transpose()
    }

    /// Delta between two nodes of D [N/m].
    pub(super) fn lost_between(&self, i: usize, j: usize) -> DMat3 {
        let n = 3 * self.nodes.len();
        let column = |b: usize| DVec3::from_array([0, 1, 2].map(|a| self.lost[(3 * i + a) * n + 3 * j + b]));
        DMat3::from_cols(column(0), column(1), column(2))
    }
}

#[derive(Clone, Copy, Debug)]
struct Imposed {
    /// Place among the constraints.
    place: u32,
    loadable: u32,
    target_m: DVec3,
}

#[derive(Debug)]
pub(super) struct PrecomputedZone {
    /// Number of the zone.
    pub(super) zone: usize,
    /// Free nodes: frontier, then surface, then inner ones, each ascending.
    pub(super) nodes: Vec<NodeId>,
    pub(super) n_frontier: usize,
    pub(super) n_loadable: usize,
    /// Number of nodes whose displacement is stored: the loadable ones (A) or all (B).
    pub(super) n_rows: usize,
    /// Number of frontier forces that are stored (A).
    pub(super) n_force_rows: usize,
    /// Row of each node of the mesh.
    pub(super) row_of: Vec<u32>,
    /// For each loadable node and then for gravity three columns of displacements [m] and frontier forces [N].
    pub(super) table: Vec<f64>,
    pub(super) incoming: Incoming,
    /// Rows that this zone publishes when several do at once.
    pub(super) is_owner: Vec<bool>,
    pub(super) correction: Option<Correction>,

    outer_n: Vec<DVec3>,
    incoming_n: Vec<DVec3>,
    offered_n: Vec<DVec3>,
    imposed: Vec<Imposed>,
    reaction_n: Vec<DVec3>,
    imposed_system: SmallLu,
    right: Vec<f64>,
    /// Displacements [m] of the rows, then frontier forces [N].
    answer: Vec<f64>,
    must_renew: bool,
    pub(super) count: ExchangeCount,
}

impl Clone for PrecomputedZone {
    /// A copy with the same capacity, so that its steps allocate nothing either.
    fn clone(&self) -> Self {
        let mut copy = Self {
            table: self.table.clone(),
            incoming: self.incoming.clone(),
            is_owner: self.is_owner.clone(),
            correction: self.correction.clone(),
            outer_n: self.outer_n.clone(),
            incoming_n: self.incoming_n.clone(),
            offered_n: self.offered_n.clone(),
            imposed: Vec::with_capacity(MAX_IMPOSED),
            reaction_n: Vec::with_capacity(MAX_IMPOSED),
            imposed_system: self.imposed_system.clone(),
            right: Vec::with_capacity(3 * MAX_IMPOSED),
            answer: self.answer.clone(),
            nodes: self.nodes.clone(),
            row_of: self.row_of.clone(),
            ..*self
        };
        copy.imposed.extend_from_slice(&self.imposed);
        copy.reaction_n.extend_from_slice(&self.reaction_n);
        copy
    }
}

/// Adds three columns times their factors.
fn add_columns(columns: &[f64], factors: DVec3, out: &mut [f64]) {
    let n = out.len();
    let (x, rest) = columns.split_at(n);
    let (y, z) = rest.split_at(n);
    for i in 0..n {
        out[i] += x[i] * factors.x + y[i] * factors.y + z[i] * factors.z;
    }
}

fn vector(of: &[f64], place: usize) -> DVec3 {
    DVec3::from_slice(&of[3 * place..3 * place + 3])
}

impl PrecomputedZone {
    /// A zone at rest without its table.
    pub(super) fn new(
        zone: usize,
        [frontier, surface, inner]: [Vec<NodeId>; 3],
        n_mesh_nodes: usize,
        method: Method,
    ) -> Self {
        let (n_frontier, n_loadable) = (frontier.len(), frontier.len() + surface.len());
        let nodes = [frontier, surface, inner].concat();
        let (n_rows, n_force_rows) = match method {
            Method::Surface => (n_loadable, n_frontier),
            Method::AllNodes => (nodes.len(), 0),
        };
        let mut row_of = vec![NONE; n_mesh_nodes];
        for (row, node) in nodes.iter().enumerate() {
            row_of[node.index()] = row as u32;
        }
        Self {
            zone,
            n_frontier,
            n_loadable,
            n_rows,
            n_force_rows,
            row_of,
            table: Vec::new(),
            incoming: Incoming::default(),
            is_owner: vec![false; nodes.len()],
            correction: None,
            outer_n: vec![DVec3::ZERO; n_loadable],
            incoming_n: vec![DVec3::ZERO; n_frontier],
            offered_n: vec![DVec3::ZERO; n_frontier],
            imposed: Vec::with_capacity(MAX_IMPOSED),
            reaction_n: Vec::with_capacity(MAX_IMPOSED),
            imposed_system: SmallLu::with_room_for(3 * MAX_IMPOSED),
            right: Vec::with_capacity(3 * MAX_IMPOSED),
            answer: vec![0.0; 3 * (n_rows + n_force_rows)],
            must_renew: true,
            count: ExchangeCount::default(),
            nodes,
        }
    }

    /// Numbers of one loadable node in the table.
    pub(super) fn stride(&self) -> usize {
        9 * (self.n_rows + self.n_force_rows)
    }

    pub(super) fn loadable_of(&self, node: NodeId) -> Option<u32> {
        let row = *self.row_of.get(node.index())?;
        ((row as usize) < self.n_loadable).then_some(row)
    }

    /// T^ab of a kept and a loadable node [m/N], without correction.
    pub(super) fn table_tensor(&self, row: usize, loadable: usize) -> DMat3 {
        let column = |axis: usize| {
            let start = loadable * self.stride() + axis * self.stride() / 3;
            vector(&self.table[start..], row)
        };
        DMat3::from_cols(column(0), column(1), column(2))
    }

    /// T'^ab [m/N], corrected, after [`Self::spread`] of the same loadable node.
    fn tensor(&self, row: usize, loadable: usize) -> DMat3 {
        let mut tensor = self.table_tensor(row, loadable);
        if let Some(Correction { nodes, spread, .. }) = &self.correction {
            for (&c, spread) in nodes.iter().zip(spread) {
                tensor += self.table_tensor(row, c as usize) * *spread;
            }
        }
        tensor
    }

    /// W T_D^j of loadable node j: once, for all rows of its column.
    fn spread(&mut self, loadable: usize) {
        let Some(mut correction) = self.correction.take() else { return };
        let mut spread = std::mem::take(&mut correction.spread);
        for (i, spread) in spread.iter_mut().enumerate() {
            let nodes = correction.nodes.iter().enumerate();
            *spread = nodes.fold(DMat3::ZERO, |sum, (j, &d)| {
                sum + correction.weight(i, j) * self.table_tensor(d as usize, loadable)
            });
        }
        correction.spread = spread;
        self.correction = Some(correction);
    }

    /// Computes W from Delta; returns the smallest pivot, which tells how far the system is from singular.
    pub(super) fn correct(&mut self, nodes: Vec<u32>, lost: Vec<f64>) -> f64 {
        let n = 3 * nodes.len();
        let mut compliance = vec![0.0; n * n];
        for (i, &c) in nodes.iter().enumerate() {
            for (j, &d) in nodes.iter().enumerate() {
                let tensor = self.table_tensor(c as usize, d as usize);
                for a in 0..3 {
                    for b in 0..3 {
                        compliance[(3 * i + a) * n + 3 * j + b] = tensor.col(b)[a];
                    }
                }
            }
        }
        // W = Delta (I - T Delta)^-1 is symmetric, so W = (I - Delta T)^-1 Delta.
        let mut system = SmallLu::with_room_for(n);
        let entries = system.start(n);
        for i in 0..n {
            for j in 0..n {
                let product: f64 = (0..n).map(|k| lost[i * n + k] * compliance[k * n + j]).sum();
                entries[i * n + j] = f64::from(u8::from(i == j)) - product;
            }
        }
        let definiteness = system.factor();
        let mut weight = vec![0.0; n * n];
        let mut column = vec![0.0; n];
        for j in 0..n {
            (0..n).for_each(|i| column[i] = lost[i * n + j]);
            system.solve(&mut column);
            (0..n).for_each(|i| weight[i * n + j] = column[i]);
        }
        let spread = vec![DMat3::ZERO; nodes.len()];
        self.correction = Some(Correction { nodes, lost, weight, before_m: vec![0.0; n], spread });
        self.must_renew = true;
        definiteness
    }

    /// Without outer forces and imposed displacements.
    pub(super) fn clear_constraints(&mut self) {
        self.outer_n.fill(DVec3::ZERO);
        self.imposed.clear();
        self.must_renew = true;
    }

    /// Returns to the state after set-up.
    pub(super) fn reset(&mut self) {
        self.clear_constraints();
        self.reaction_n.clear();
        self.incoming_n.fill(DVec3::ZERO);
        self.answer.fill(0.0);
    }

    pub(super) fn renew(&mut self) {
        self.must_renew = true;
    }

    pub(super) fn add_outer_force(&mut self, loadable: u32, force_n: DVec3) {
        self.outer_n[loadable as usize] += force_n;
    }

    /// Whether there was room.
    pub(super) fn impose(&mut self, place: u32, loadable: u32, target_m: DVec3) -> bool {
        let has_room = self.imposed.len() < MAX_IMPOSED;
        if has_room {
            self.imposed.push(Imposed { place, loadable, target_m });
        }
        has_room
    }

    /// Factors the small system of the imposed displacements (seed `003` eq. 2.12).
    pub(super) fn factor_imposed(&mut self) {
        let n = 3 * self.imposed.len();
        let mut system = std::mem::replace(&mut self.imposed_system, SmallLu::with_room_for(0));
        let entries = system.start(n);
        for j in 0..self.imposed.len() {
            let b = self.imposed[j];
            self.spread(b.loadable as usize);
            for (i, a) in self.imposed.iter().enumerate() {
                let tensor = self.tensor(a.loadable as usize, b.loadable as usize);
                for row in 0..3 {
                    for column in 0..3 {
                        entries[(3 * i + row) * n + 3 * j + column] = tensor.col(column)[row];
                    }
                }
            }
        }
        system.factor();
        self.imposed_system = system;
        self.reaction_n.clear();
        self.reaction_n.resize(self.imposed.len(), DVec3::ZERO);
        self.must_renew = true;
    }

    /// Place among the constraints and force [N] of each imposed displacement.
    pub(super) fn reactions_n(&self) -> impl Iterator<Item = (u32, DVec3)> + '_ {
        self.imposed.iter().zip(&self.reaction_n).map(|(imposed, &r)| (imposed.place, r))
    }

    pub(super) fn displacement_m(&self, row: usize) -> DVec3 {
        vector(&self.answer, row)
    }

    pub(super) fn outgoing_into(&self, outgoing_n: &mut [DVec3]) {
        for (i, force_n) in outgoing_n.iter_mut().enumerate() {
            *force_n = vector(&self.answer, self.n_rows + i);
        }
    }

    /// Adds the response to a force on a loadable node (or, for the last number, to gravity), without correction.
    fn add_answer(&mut self, loadable: usize, factors: DVec3) {
        let stride = self.stride();
        add_columns(&self.table[stride * loadable..stride * (loadable + 1)], factors, &mut self.answer);
        self.count.response_products += (self.n_rows + self.n_force_rows) as u64;
    }

    fn start_correction(&mut self) {
        if let Some(Correction { nodes, before_m, .. }) = &mut self.correction {
            for (before_m, &row) in before_m.chunks_exact_mut(3).zip(nodes.iter()) {
                before_m.copy_from_slice(&vector(&self.answer, row as usize).to_array());
            }
        }
    }

    /// Adds W times the displacement of the correction's nodes since [`Self::start_correction`].
    fn end_correction(&mut self) {
        let Some(mut correction) = self.correction.take() else { return };
        let n = correction.before_m.len();
        let moved_m = &mut correction.before_m;
        for (moved_m, &row) in moved_m.chunks_exact_mut(3).zip(&correction.nodes) {
            let now_m = vector(&self.answer, row as usize) - DVec3::from_slice(moved_m);
            moved_m.copy_from_slice(&now_m.to_array());
        }
        for (i, &node) in correction.nodes.iter().enumerate() {
            let force_n = [0, 1, 2].map(|axis| {
                let row = &correction.weight[(3 * i + axis) * n..(3 * i + axis + 1) * n];
                row.iter().zip(moved_m.iter()).map(|(w, u)| w * u).sum::<f64>()
            });
            self.add_answer(node as usize, DVec3::from_array(force_n));
        }
        self.correction = Some(correction);
    }

    /// Force [N] of the neighbours' latest state on frontier node `p`.
    fn gather(&self, p: usize, shared: &Shared) -> DVec3 {
        let mut force_n = DVec3::ZERO;
        for &(j, b) in self.incoming.nodes.get(p) {
            force_n -= b * shared.displacement_m[j as usize];
        }
        for &(j, b) in self.incoming.dynamic.get(p) {
            force_n -= b * shared.dynamic_view_m[j as usize];
        }
        if let Some(surplus_n) = shared.surplus_n.get(self.nodes[p].index()) {
            force_n += *surplus_n;
        }
        for &(zone, i) in self.incoming.forces.get(p) {
            force_n -= shared.outgoing_n[zone as usize][i as usize];
        }
        force_n
    }

    /// One visit: neighbours' forces first, then the forces that hold the imposed displacements against all others,
    /// then the displacements.
    pub(super) fn visit(&mut self, shared: &Shared, amount: ExchangeAmount, sweep: u64) {
        let in_turn = match amount {
            ExchangeAmount::InTurn { n_sets } => Some((u64::from(n_sets), sweep % u64::from(n_sets))),
            _ => None,
        };
        let mut largest_n = 0.0_f64;
        for p in 0..self.n_frontier {
            self.offered_n[p] = self.incoming_n[p];
            if in_turn.is_some_and(|(n_sets, set)| p as u64 % n_sets != set) {
                continue;
            }
            self.offered_n[p] = self.gather(p, shared);
            self.count.edge_products +=
                (self.incoming.nodes.get(p).len() + self.incoming.dynamic.get(p).len()) as u64;
            largest_n = largest_n.max(self.offered_n[p].distance_squared(self.incoming_n[p]));
        }
        let least = match amount {
            ExchangeAmount::Largest { share } => share * share * largest_n,
            _ => 0.0,
        };
        let renews =
            self.must_renew || amount == ExchangeAmount::All || sweep.is_multiple_of(SWEEPS_TO_RENEW);
        if renews {
            self.answer.fill(0.0);
        }
        self.start_correction();
        for p in 0..self.n_frontier {
            let change_n = self.offered_n[p] - self.incoming_n[p];
            let size = change_n.length_squared();
            let is_taken = size > 0.0 && size >= least;
            if is_taken {
                self.incoming_n[p] = self.offered_n[p];
                self.count.n_exchanged_forces += 1;
            }
            if renews {
                let force_n = self.incoming_n[p] + self.outer_n[p];
                self.add_answer(p, force_n);
            } else if is_taken {
                self.add_answer(p, change_n);
            }
        }
        if renews {
            for m in self.n_frontier..self.n_loadable {
                let force_n = self.outer_n[m];
                if force_n != DVec3::ZERO {
                    self.add_answer(m, force_n);
                }
            }
            if shared.pull_m_per_s2 != DVec3::ZERO {
                self.add_answer(self.n_loadable, shared.pull_m_per_s2);
            }
            self.reaction_n.fill(DVec3::ZERO);
        }
        self.end_correction();
        if !self.imposed.is_empty() {
            self.hold_imposed();
        }
        self.must_renew = false;
    }

    /// Adds the forces that bring the imposed nodes to their targets.
    fn hold_imposed(&mut self) {
        let mut right = std::mem::take(&mut self.right);
        right.clear();
        for imposed in &self.imposed {
            let missing_m = imposed.target_m - vector(&self.answer, imposed.loadable as usize);
            right.extend_from_slice(&missing_m.to_array());
        }
        self.imposed_system.solve(&mut right);
        self.start_correction();
        for i in 0..self.imposed.len() {
            let r = vector(&right, i);
            self.reaction_n[i] += r;
            let loadable = self.imposed[i].loadable as usize;
            self.add_answer(loadable, r);
        }
        self.end_correction();
        self.right = right;
    }
}
