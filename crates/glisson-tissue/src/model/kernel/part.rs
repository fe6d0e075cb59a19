//! A part of the mesh with its memory, and the two phases of a force computation.
//!
//! First each part collects the displacements of the nodes that it touches, and sums its tetrahedra's forces in its own
//! rows. Then each part sums, for the nodes that it owns, its own rows and those of the other parts that borrow the node,
//! in the order in which they began to borrow it. Neither depends on which thread computes a part, or when.
//!
//! The locks share memory between threads without `unsafe`. No thread ever waits for one: within a phase, no part reads
//! what another writes.

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use super::KernelLaw;
use super::element::{ElementLaw, Linear, StVenantKirchhoff};
use super::extras::{Extras, Full, Guarded, Plain, Viscous};
use super::general::{General, SharedMaterial};
use super::lanes::Lanes;
use super::neo_hooke::{NeoHookeLog, StableNeoHooke};
use super::paths::{KernelPath, LaneWork};
use super::quarantine::{Guard, LaneTets, NO_TET, Quarantine, QuarantineReport};
use super::rows::{Block, LaneNumbers, MOST_ROWS, N_LANES, Row, Rows};
use super::step::{GROUP_ROWS, StepFactors, StepSums};
use crate::material::PronySeries;
use crate::model::bounded_vec::BoundedVec;
use glisson_mesh::mesh::NodeId;

/// A panic elsewhere leaves valid memory.
pub(super) fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

pub(super) fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

/// Rows that two parts share.
#[derive(Clone, Debug)]
pub(super) struct Exchange {
    /// The other part.
    pub(super) part: usize,
    /// Row here and row there.
    pub(super) rows: Vec<[u16; 2]>,
}

/// State of the nodes that a part owns. Rows are padded to whole groups ([`GROUP_ROWS`]).
#[derive(Clone, Debug)]
pub(super) struct PartNodes {
    pub(super) displacement_m: Vec<Row>,
    /// u(t) - u(t - h).
    pub(super) increment_m: Vec<Row>,
    /// Force that balances the deformation, of the last computation.
    pub(super) force_n: Vec<Row>,
    /// Force from outside.
    pub(super) outer_n: Vec<Row>,
    pub(super) mass_kg: Vec<f64>,
    /// Added mass, which has no weight.
    pub(super) added_mass_kg: Vec<f64>,
    /// Zero for axes that the step does not move.
    pub(super) inverse_mass_per_kg: Vec<Row>,
    /// Mass and added mass; zero for axes that the step does not move.
    pub(super) moving_inertia_kg: Vec<Row>,
    pub(super) is_held: Vec<[bool; 3]>,
    /// Number of live tetrahedra at a node.
    pub(super) n_tets: Vec<u32>,
    /// Displacements plus beta times the velocities, for stiffness damping; empty without it.
    pub(super) led_m: Vec<Row>,
    /// Of the last step.
    pub(super) sums: StepSums,
}

impl PartNodes {
    pub(super) fn at_rest(n_own: usize) -> Self {
        let rows = || vec![[0.0; 4]; n_own.next_multiple_of(GROUP_ROWS)];
        Self {
            displacement_m: rows(),
            increment_m: rows(),
            force_n: rows(),
            outer_n: rows(),
            mass_kg: vec![0.0; n_own],
            added_mass_kg: vec![0.0; n_own],
            inverse_mass_per_kg: rows(),
            moving_inertia_kg: rows(),
            is_held: vec![[false; 3]; n_own],
            n_tets: vec![0; n_own],
            led_m: Vec::new(),
            sums: StepSums::default(),
        }
    }
}

/// The tetrahedra of a part.
#[derive(Clone, Debug)]
pub(super) struct Elements {
    pub(super) blocks: Vec<Block>,
    pub(super) extras: Extras,
    /// Which law of [`Parts::laws`], for each lane of each block; empty for laws of the kernel's own.
    pub(super) law_of: Vec<[u32; N_LANES]>,
    /// The tetrahedron of each lane.
    pub(super) tets: Vec<LaneTets>,
    /// Blocks and lanes without a tetrahedron; the last one is filled first. With capacity for all.
    pub(super) spare: BoundedVec<[u32; 2]>,
}

impl Elements {
    /// Removes a tetrahedron from its lane.
    pub(super) fn clear(&mut self, block: usize, lane: usize) {
        self.blocks[block].clear(lane);
        self.extras.clear(block, lane);
        self.tets[block][lane] = NO_TET;
        let has_room = self.spare.try_push([block as u32, lane as u32]);
        debug_assert!(has_room, "there is room for every lane");
    }

    /// Bytes that a computation of the forces reads.
    pub(super) fn n_bytes(&self) -> usize {
        size_of_val(self.blocks.as_slice()) + self.extras.n_bytes() + size_of_val(self.law_of.as_slice())
    }
}

/// State of a part's tetrahedra that a step changes.
#[derive(Clone, Debug, Default)]
pub(super) struct Progress {
    /// The memory of the relaxing stress, see [`Viscous::history`].
    pub(super) history: Vec<LaneNumbers>,
    /// What the last step left out.
    pub(super) quarantined: QuarantineReport,
    /// Whether a tetrahedron of the last step was near to inversion or torn apart.
    pub(super) is_strained: bool,
}

/// The Prony series and its numbers for the present step length.
#[derive(Clone, Debug)]
pub(super) struct Relaxation {
    pub(super) series: PronySeries,
    lasting_share: f64,
    terms: Vec<[f64; 3]>,
    /// Step that the terms are for [s]; 0 before the first.
    step_s: f64,
}

impl Relaxation {
    /// Before the first step: stress changes without time to relax.
    pub(super) fn new(series: PronySeries) -> Self {
        let terms: Vec<[f64; 3]> = series.terms().iter().map(|term| [term.share, 1.0, 1.0]).collect();
        let lasting_share = 1.0 - terms.iter().map(|[share, ..]| share).sum::<f64>();
        Self { series, lasting_share, terms, step_s: 0.0 }
    }

    /// For steps of `step_s`; allocates nothing.
    pub(super) fn set_step(&mut self, step_s: f64) {
        if std::mem::replace(&mut self.step_s, step_s) == step_s {
            return;
        }
        for (numbers, term) in self.terms.iter_mut().zip(self.series.terms()) {
            *numbers = term.recursion(step_s);
        }
    }
}

/// How forces are computed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ForceMode {
    /// What is left out.
    pub(super) quarantine: Option<Quarantine>,
    /// Whether the computation belongs to a step, which advances the viscous memory.
    pub(super) in_step: bool,
    /// See [`Guard::calm_squared_strain`].
    pub(super) calm_squared_strain: f64,
}

/// The rows of a part. Own ones start at the front, borrowed ones at the end, backwards, so that both can grow.
#[derive(Clone, Debug, Default)]
pub(super) struct Layout {
    pub(super) own: Vec<NodeId>,
    /// Rows borrowed from other parts.
    pub(super) borrowed: Vec<Exchange>,
    /// Own rows that other parts borrow.
    pub(super) lent: Vec<Exchange>,
    pub(super) n_borrowed: usize,
}

impl Layout {
    /// Own and borrowed rows together.
    pub(super) fn n_rows(&self) -> usize {
        self.own.len() + self.n_borrowed
    }
}

/// The row of a part's borrowed node `i`.
pub(super) fn borrowed_row(i: usize) -> usize {
    MOST_ROWS - 1 - i
}

/// One part.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) layout: RwLock<Layout>,
    pub(super) elements: RwLock<Elements>,
    pub(super) progress: RwLock<Progress>,
    pub(super) nodes: RwLock<PartNodes>,
    pub(super) rows: RwLock<Box<Rows>>,
}

impl Part {
    pub(super) fn new(layout: Layout, elements: Elements, progress: Progress, nodes: PartNodes) -> Self {
        Self {
            layout: RwLock::new(layout),
            elements: RwLock::new(elements),
            progress: RwLock::new(progress),
            nodes: RwLock::new(nodes),
            rows: RwLock::new(Rows::zero()),
        }
    }

    pub(super) fn layout(&self) -> RwLockReadGuard<'_, Layout> {
        read(&self.layout)
    }

    pub(super) fn layout_mut(&self) -> RwLockWriteGuard<'_, Layout> {
        write(&self.layout)
    }

    pub(super) fn nodes(&self) -> RwLockReadGuard<'_, PartNodes> {
        read(&self.nodes)
    }

    pub(super) fn nodes_mut(&self) -> RwLockWriteGuard<'_, PartNodes> {
        write(&self.nodes)
    }

    pub(super) fn elements(&self) -> RwLockReadGuard<'_, Elements> {
        read(&self.elements)
    }

    pub(super) fn elements_mut(&self) -> RwLockWriteGuard<'_, Elements> {
        write(&self.elements)
    }

    pub(super) fn progress(&self) -> RwLockReadGuard<'_, Progress> {
        read(&self.progress)
    }

    pub(super) fn progress_mut(&self) -> RwLockWriteGuard<'_, Progress> {
        write(&self.progress)
    }
}

/// All parts: what the tasks of several threads work on.
pub(super) struct Parts {
    pub(super) law: KernelLaw,
    /// Of [`KernelLaw::General`].
    pub(super) laws: RwLock<Vec<SharedMaterial>>,
    pub(super) relaxation: Option<RwLock<Relaxation>>,
    pub(super) mode: RwLock<ForceMode>,
    pub(super) path: RwLock<KernelPath>,
    pub(super) all: Vec<Part>,
    pub(super) step: RwLock<StepFactors>,
}

impl std::fmt::Debug for Parts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Parts").field("law", &self.law).field("all", &self.all).finish_non_exhaustive()
    }
}

impl Parts {
    pub(super) fn set_path(&self, path: KernelPath) {
        *write(&self.path) = path;
    }

    pub(super) fn path(&self) -> KernelPath {
        *read(&self.path)
    }

    pub(super) fn set_step(&self, factors: StepFactors) {
        *write(&self.step) = factors;
    }

    pub(super) fn set_mode(&self, mode: ForceMode) {
        *write(&self.mode) = mode;
    }

    /// None without a series.
    pub(super) fn n_relaxation_terms(&self) -> Option<usize> {
        self.relaxation.as_ref().map(|relaxation| read(relaxation).series.terms().len())
    }

    pub(super) fn set_relaxation_step(&self, step_s: f64) {
        if let Some(relaxation) = &self.relaxation {
            write(relaxation).set_step(step_s);
        }
    }

    /// First phase.
    pub(super) fn add_element_forces(&self, p: usize) {
        let rows = &mut *write(&self.all[p].rows);
        self.path().vectorize(
            #[inline(always)]
            || self.collect_displacements(p, rows),
        );
        let elements = &*self.all[p].elements();
        match self.law {
            KernelLaw::Linear => self.add_forces_of(p, Linear, elements, rows),
            KernelLaw::StVenantKirchhoff => self.add_forces_of(p, StVenantKirchhoff, elements, rows),
            KernelLaw::NeoHookeLog => self.add_forces_of(p, NeoHookeLog, elements, rows),
            KernelLaw::StableNeoHooke => self.add_forces_of(p, StableNeoHooke, elements, rows),
            KernelLaw::General => {
                let law = General { laws: &read(&self.laws), law_of: &elements.law_of };
                self.add_forces_of(p, law, elements, rows);
            }
        }
    }

    fn add_forces_of(&self, p: usize, law: impl ElementLaw, elements: &Elements, rows: &mut Rows) {
        let ForceMode { quarantine, in_step, calm_squared_strain } = *read(&self.mode);
        let Elements { blocks, extras, tets, .. } = elements;
        let watch = quarantine.filter(|quarantine| *quarantine != Quarantine::Off);
        let path = self.path();
        if watch.is_none() && extras.is_empty() && self.relaxation.is_none() {
            return path.add_forces(&mut Plain(law), blocks, rows);
        }
        let Progress { history, quarantined, is_strained } = &mut *self.all[p].progress_mut();
        *quarantined = QuarantineReport::default();
        *is_strained = false;
        let guard = watch.map(|watch| Guard {
            replaces_inverted: watch == Quarantine::Inverted,
            tets,
            found: quarantined,
            is_strained,
            calm_squared_strain,
        });
        let relaxation = self.relaxation.as_ref().map(read);
        let viscous = relaxation.as_ref().map(|relaxation| Viscous {
            lasting_share: relaxation.lasting_share,
            terms: &relaxation.terms,
            history,
            advances: in_step,
        });
        match guard {
            Some(guard) if extras.is_empty() && viscous.is_none() => {
                path.add_forces(&mut Guarded { law, guard }, blocks, rows);
            }
            guard => path.add_forces(&mut Full { law, extras, viscous, guard }, blocks, rows),
        }
    }

    #[inline(always)]
    fn collect_displacements(&self, p: usize, rows: &mut Rows) {
        let part = &self.all[p];
        let leads = read(&self.step).leads();
        let layout = part.layout();
        let rows = rows.nodes_mut();
        for (row, displacement_m) in rows[..layout.own.len()].iter_mut().zip(part.nodes().strained_m(leads)) {
            *row = [*displacement_m, [0.0; 4]];
        }
        for exchange in &layout.borrowed {
            let owner = self.all[exchange.part].nodes();
            let displacement_m = owner.strained_m(leads);
            for &[here, there] in &exchange.rows {
                rows[usize::from(here)] = [displacement_m[usize::from(there)], [0.0; 4]];
            }
        }
    }

    /// Second phase: forces on the own nodes.
    pub(super) fn sum_forces(&self, p: usize) {
        self.path().vectorize(
            #[inline(always)]
            || self.sum_forces_into(p, &mut self.all[p].nodes_mut().force_n),
        );
    }

    #[inline(always)]
    fn sum_forces_into(&self, p: usize, sums: &mut [Row]) {
        let part = &self.all[p];
        let layout = part.layout();
        for (sum, [_, force]) in sums[..layout.own.len()].iter_mut().zip(read(&part.rows).nodes()) {
            *sum = *force;
        }
        for exchange in &layout.lent {
            let rows = read(&self.all[exchange.part].rows);
            let rows = rows.nodes();
            for &[here, there] in &exchange.rows {
                let (sum, [_, force]) = (&mut sums[usize::from(here)], rows[usize::from(there)]);
                *sum = std::array::from_fn(|i| sum[i] + force[i]);
            }
        }
    }

    /// Second phase of a step: forces on the own nodes, and their motion.
    pub(super) fn sum_and_advance(&self, p: usize) {
        self.path().run(SumAndAdvance { parts: self, p });
    }
}

/// [`Parts::sum_and_advance`] of a part.
struct SumAndAdvance<'a> {
    parts: &'a Parts,
    p: usize,
}

impl LaneWork for SumAndAdvance<'_> {
    #[inline(always)]
    fn run<V: Lanes>(self, any: V) {
        let Self { parts, p } = self;
        let factors = *read(&parts.step);
        let mut nodes = parts.all[p].nodes_mut();
        parts.sum_forces_into(p, &mut nodes.force_n);
        nodes.advance(&factors, any);
    }
}
