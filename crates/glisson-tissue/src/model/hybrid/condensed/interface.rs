//! The frontier of the pre-computed zones, solved exactly.
//!
//! There are two kinds of frontier nodes: p, between pre-computed zones alone, and d, which a dynamic zone shares.
//! Let S be the sum of the zones' Schur complements and g the forces on the frontier, with those inside a zone
//! transferred by B^T:
//!
//! u_p = S_pp^-1 (g_p - S_pd u_d), so that the dynamic nodes feel
//! S' u_d - (g_d + Q^T g_p) with Q = -S_pp^-1 S_pd and S' = S_dd + S_dp Q.
//!
//! S' is at most the frontier's assembled stiffness (a Schur complement of a positive semi-definite matrix), and the
//! frontier nodes keep the mass of all their tetrahedra. So the highest frequency is at most that of the whole
//! tensor-mass body, and the stable step is not shorter.
//!
//! For every loadable component, a column holds the effect of a unit force on the frontier: the displacement of p
//! (with d held) and the force on d.

use crate::model::precomputed::Precision;
use crate::solve::SolveError;
use glisson_mesh::mesh::NodeId;

use super::columns::{Columns, SymmetricTiles, dot};
use super::zone::{N_CONSTANT, PrecomputedZone};

/// The frontier of the zones of one body.
#[derive(Clone)]
pub(super) struct Interface {
    /// p ascending, then d ascending.
    pub(super) nodes: Vec<NodeId>,
    /// Number of p.
    pub(super) n_condensed: usize,
    /// Place among `nodes` of each zone's frontier nodes.
    pub(super) places: Vec<Vec<u32>>,
    /// Columns of the components of p: S_pp^-1 above Q^T.
    pub(super) of_condensed: Columns,
    /// Columns of each zone's loadable components: S_pp^-1 B_p^T above B_d^T + Q^T B_p^T.
    pub(super) of_loadable: Vec<Columns>,
    /// S' [N/m], and the same in the form that the steps use.
    pub(super) stiffness_on_dynamic: Columns,
    pub(super) stiffness_tiles: SymmetricTiles,
    /// A column per constant load, like that of a loadable component.
    pub(super) constant: Columns,
    /// S_pp^-1 B_p^T on each zone's own frontier, as added to the zone's compliance.
    in_compliance: Vec<Columns>,
}

/// What an earlier interface added to each zone's compliance, to be subtracted from it.
pub(super) type Composed = Vec<Columns>;

/// The frontier's nodes in the interface's order.
struct FrontierNodes {
    nodes: Vec<NodeId>,
    n_condensed: usize,
    places: Vec<Vec<u32>>,
}

impl FrontierNodes {
    fn of(zones: &[PrecomputedZone], is_dynamic: &[bool]) -> Self {
        let mut all: Vec<NodeId> = zones.iter().flat_map(|z| z.frontier.iter().copied()).collect();
        all.sort_unstable();
        all.dedup();
        let (mut nodes, dynamic): (Vec<NodeId>, Vec<NodeId>) =
            all.into_iter().partition(|n| !is_dynamic[n.index()]);
        let n_condensed = nodes.len();
        nodes.extend(dynamic);
        let mut place_of = vec![0; is_dynamic.len()];
        for (k, n) in nodes.iter().enumerate() {
            place_of[n.index()] = k as u32;
        }
        let places = zones.iter().map(|z| z.frontier.iter().map(|n| place_of[n.index()]).collect()).collect();
        Self { nodes, n_condensed, places }
    }
}

/// S of all zones. A held component has a row and a column of its own.
fn summed_stiffness(zones: &[PrecomputedZone], places: &[Vec<u32>], is_held: &[bool]) -> Columns {
    let n_all = is_held.len();
    let mut sum = Columns::zeros(n_all, n_all);
    let component = |places: &[u32], c: usize| 3 * places[c / 3] as usize + c % 3;
    for (zone, places) in zones.iter().zip(places) {
        for j in 0..zone.frontier_stiffness.n_columns() {
            let to = sum.column_mut(component(places, j));
            for (i, x) in zone.frontier_stiffness.column(j).iter().enumerate() {
                to[component(places, i)] += x;
            }
        }
    }
    let largest = (0..n_all).map(|i| sum.entry(i, i)).fold(0.0, f64::max);
    for i in (0..n_all).filter(|&i| is_held[i]) {
        sum.column_mut(i).fill(0.0);
        (0..n_all).for_each(|j| sum.column_mut(j)[i] = 0.0);
        sum.column_mut(i)[i] = largest;
    }
    sum
}

/// A part of a matrix times a factor.
fn part_of(
    matrix: &Columns,
    rows: std::ops::Range<usize>,
    columns: std::ops::Range<usize>,
    factor: f64,
) -> Columns {
    let (n_rows, n_columns) = (rows.len(), columns.len());
    let numbers = columns.flat_map(|j| matrix.column(j)[rows.clone()].iter().map(move |x| factor * x));
    Columns::of(n_rows, n_columns, numbers.collect())
}

/// S with the components of p eliminated.
struct Condensation {
    /// S_pp^-1 above Q^T.
    of_condensed: Columns,
    /// S'.
    on_dynamic: Columns,
}

impl Condensation {
    /// Eliminates the first `n_p` components of `sum`.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when S_pp is not positive definite.
    fn of(sum: &Columns, n_p: usize, is_held: &[bool]) -> Result<Self, SolveError> {
        let n_all = sum.n_rows();
        let mut inverse = part_of(sum, 0..n_p, 0..n_p, 1.0).inverse().ok_or(SolveError::Singular)?;
        for i in (0..n_p).filter(|&i| is_held[i]) {
            inverse.column_mut(i)[i] = 0.0;
        }
        let mut gathered = Columns::zeros(n_all - n_p, n_p);
        gathered.add_product(&part_of(sum, n_p..n_all, 0..n_p, -1.0), &inverse);
        let mut on_dynamic = part_of(sum, n_p..n_all, n_p..n_all, 1.0);
        on_dynamic.add_product(&gathered, &part_of(sum, 0..n_p, n_p..n_all, 1.0));
        on_dynamic.symmetrize();
        for i in (0..n_all - n_p).filter(|i| is_held[n_p + i]) {
            on_dynamic.column_mut(i)[i] = 0.0;
        }
        let mut of_condensed = Columns::zeros(n_all, n_p);
        for j in 0..n_p {
            let column = of_condensed.column_mut(j);
            column[..n_p].copy_from_slice(inverse.column(j));
            column[n_p..].copy_from_slice(gathered.column(j));
        }
        Ok(Self { of_condensed, on_dynamic })
    }
}

impl Interface {
    /// Couples the zones, and adds to each zone's compliance that of the others. `before`: what an earlier interface
    /// added, one per zone.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when the pre-computed zones can move with the dynamic nodes held.
    pub(super) fn build(
        zones: &mut [PrecomputedZone],
        is_dynamic: &[bool],
        held: &[[bool; 3]],
        before: Option<&Composed>,
        precision: Precision,
    ) -> Result<Self, SolveError> {
        let FrontierNodes { nodes, n_condensed, places } = FrontierNodes::of(zones, is_dynamic);
        let is_held: Vec<bool> = nodes.iter().flat_map(|n| held[n.index()]).collect();
        let sum = summed_stiffness(zones, &places, &is_held);
        let Condensation { of_condensed, on_dynamic } = Condensation::of(&sum, 3 * n_condensed, &is_held)?;
        let mut interface = Self {
            constant: Columns::zeros(3 * nodes.len(), N_CONSTANT),
            nodes,
            n_condensed,
            places,
            of_condensed,
            of_loadable: Vec::new(),
            stiffness_tiles: SymmetricTiles::of(&on_dynamic, precision),
            stiffness_on_dynamic: on_dynamic,
            in_compliance: Vec::new(),
        };
        for z in 0..zones.len() {
            interface.bring_in(z, &mut zones[z], before.map(|b| &b[z]), precision);
        }
        interface.fill_constants(zones);
        Ok(interface)
    }

    /// What was added to the zones' compliances, for the interface that replaces this one.
    pub(super) fn take_composed(&mut self) -> Composed {
        std::mem::take(&mut self.in_compliance)
    }

    /// Computes the columns of a zone's loadable components, and completes its compliance.
    fn bring_in(
        &mut self,
        z: usize,
        zone: &mut PrecomputedZone,
        before: Option<&Columns>,
        precision: Precision,
    ) {
        let (n_all, n_p) = (3 * self.nodes.len(), 3 * self.n_condensed);
        let n_loadable = 3 * zone.n_loadable;
        let on_frontier = zone.extension.transpose_of_rows(0..n_loadable);
        let mut on_condensed = Columns::zeros(n_p, n_loadable);
        let mut of_loadable = Columns::zeros(n_all, n_loadable);
        let places = &self.places[z];
        let component = |c: usize| 3 * places[c / 3] as usize + c % 3;
        for j in 0..n_loadable {
            for (c, &x) in on_frontier.column(j).iter().enumerate() {
                match component(c) {
                    p if p < n_p => on_condensed.column_mut(j)[p] = x,
                    d => of_loadable.column_mut(j)[d] = x,
                }
            }
        }
        of_loadable.add_product(&self.of_condensed, &on_condensed);
        let mut on_own = Columns::zeros(on_frontier.n_rows(), n_loadable);
        for j in 0..n_loadable {
            for c in (0..on_own.n_rows()).filter(|&c| component(c) < n_p) {
                on_own.column_mut(j)[c] = of_loadable.column(j)[component(c)];
            }
        }
        let change = match before {
            Some(before) => {
                let numbers = on_own.numbers().iter().zip(before.numbers()).map(|(now, then)| now - then);
                Columns::of(on_own.n_rows(), n_loadable, numbers.collect())
            }
            None => on_own.clone(),
        };
        zone.compliance.add_product(&zone.extension, &change);
        if before.is_none() {
            let compliance = std::mem::replace(&mut zone.compliance, Columns::zeros(0, 0));
            zone.compliance = compliance.kept_in(precision);
        }
        self.of_loadable.push(of_loadable);
        self.in_compliance.push(on_own);
    }

    /// The dynamic part has the weight of its nodes itself, from all their tetrahedra.
    fn fill_constants(&mut self, zones: &[PrecomputedZone]) {
        let n_p = 3 * self.n_condensed;
        for load in 0..N_CONSTANT {
            let mut force_n = vec![0.0; 3 * self.nodes.len()];
            for (zone, places) in zones.iter().zip(&self.places) {
                let transfer = zone.constant_transfer.column(load);
                let own = zone.constant_on_frontier.column(load);
                for c in 0..transfer.len() {
                    let at = 3 * places[c / 3] as usize + c % 3;
                    let bears_own = at < n_p || load == N_CONSTANT - 1;
                    force_n[at] += transfer[c] + if bears_own { own[c] } else { 0.0 };
                }
            }
            let column = self.constant.column_mut(load);
            column[n_p..].copy_from_slice(&force_n[n_p..]);
            self.of_condensed.add_times(&force_n[..n_p], column);
        }
    }

    /// Adds the effect of forces [N] on a zone's frontier: displacements of p and forces on d.
    pub(super) fn add_frontier_forces(&self, z: usize, frontier_n: &[f64], reduced: &mut [f64]) {
        let n_p = 3 * self.n_condensed;
        let at = |c: usize| 3 * self.places[z][c / 3] as usize + c % 3;
        let on_condensed =
            frontier_n.iter().enumerate().map(|(c, f)| (at(c), *f)).filter(|&(at, _)| at < n_p);
        self.of_condensed.add_weighted(on_condensed, reduced);
        for (c, f) in frontier_n.iter().enumerate() {
            if at(c) >= n_p {
                reduced[at(c)] += f;
            }
        }
    }

    /// Adds Q u_d to the displacements of p [m].
    pub(super) fn add_following(&self, dynamic_m: &[f64], condensed_m: &mut [f64]) {
        let n_p = 3 * self.n_condensed;
        if dynamic_m.is_empty() {
            return;
        }
        for (j, u) in condensed_m.iter_mut().enumerate() {
            *u += dot(&self.of_condensed.column(j)[n_p..], dynamic_m);
        }
    }

    /// Bytes of the columns.
    pub(super) fn bytes(&self) -> usize {
        let of_loadable: usize = self.of_loadable.iter().chain(&self.in_compliance).map(Columns::bytes).sum();
        self.of_condensed.bytes() + of_loadable + self.stiffness_on_dynamic.bytes()
    }
}
