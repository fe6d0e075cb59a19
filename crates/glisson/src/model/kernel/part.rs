//! A part of the mesh with its memory, and the two phases of a force computation.
//!
//! First each part collects the displacements of the nodes that it touches and adds up its tetrahedra's forces
//! in rows of its own. Then each part sums, for the nodes that it owns, its own rows and those of the later parts
//! that borrow the node, in their order. Neither depends on who computes which part when.
//!
//! The locks are there to share memory between threads without `unsafe`. Nobody ever waits for one: in a phase,
//! what one part writes no other reads.

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use super::KernelLaw;
use super::motion::{StepFactors, StepSums};
use super::paths::KernelPath;
use super::rows::{Block, Row, Rows};
use crate::mesh::NodeId;

/// A panic elsewhere leaves numbers behind, no broken memory.
pub(super) fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
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

/// What moves on the nodes that a part owns.
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
    /// Inertia without weight.
    pub(super) added_mass_kg: Vec<f64>,
    /// Zero for axes that the step does not move.
    pub(super) inverse_mass_per_kg: Vec<Row>,
    pub(super) is_held: Vec<[bool; 3]>,
    /// Tetrahedra that a node has left.
    pub(super) n_tets: Vec<u32>,
    /// Displacements ahead by the stiffness damping; empty without.
    pub(super) led_m: Vec<Row>,
    /// Of the last step.
    pub(super) sums: StepSums,
}

impl PartNodes {
    pub(super) fn at_rest(n_own: usize) -> Self {
        Self {
            displacement_m: vec![[0.0; 4]; n_own],
            increment_m: vec![[0.0; 4]; n_own],
            force_n: vec![[0.0; 4]; n_own],
            outer_n: vec![[0.0; 4]; n_own],
            mass_kg: vec![0.0; n_own],
            added_mass_kg: vec![0.0; n_own],
            inverse_mass_per_kg: vec![[0.0; 4]; n_own],
            is_held: vec![[false; 3]; n_own],
            n_tets: vec![0; n_own],
            led_m: Vec::new(),
            sums: StepSums::default(),
        }
    }
}

/// One part.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) own: Vec<NodeId>,
    /// Rows borrowed from earlier parts, ascending.
    pub(super) borrowed: Vec<Exchange>,
    /// Own rows that later parts borrow, ascending.
    pub(super) lent: Vec<Exchange>,
    /// Own and borrowed rows together.
    pub(super) n_rows: usize,
    pub(super) blocks: RwLock<Vec<Block>>,
    pub(super) nodes: RwLock<PartNodes>,
    pub(super) rows: RwLock<Box<Rows>>,
}

impl Part {
    pub(super) fn new(own: Vec<NodeId>, n_rows: usize, blocks: Vec<Block>, nodes: PartNodes) -> Self {
        Self {
            own,
            borrowed: Vec::new(),
            lent: Vec::new(),
            n_rows,
            blocks: RwLock::new(blocks),
            nodes: RwLock::new(nodes),
            rows: RwLock::new(Rows::zero()),
        }
    }

    pub(super) fn nodes(&self) -> RwLockReadGuard<'_, PartNodes> {
        read(&self.nodes)
    }

    pub(super) fn nodes_mut(&self) -> RwLockWriteGuard<'_, PartNodes> {
        write(&self.nodes)
    }

    pub(super) fn blocks(&self) -> RwLockReadGuard<'_, Vec<Block>> {
        read(&self.blocks)
    }

    pub(super) fn blocks_mut(&self) -> RwLockWriteGuard<'_, Vec<Block>> {
        write(&self.blocks)
    }
}

/// All parts: what the tasks of several threads work on.
#[derive(Debug)]
pub(super) struct Parts {
    pub(super) law: KernelLaw,
    pub(super) path: RwLock<KernelPath>,
    pub(super) all: Vec<Part>,
    pub(super) step: RwLock<StepFactors>,
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

    /// First phase.
    pub(super) fn add_element_forces(&self, p: usize) {
        let part = &self.all[p];
        let leads = read(&self.step).leads();
        let mut rows = write(&part.rows);
        let (own, borrowed) = rows.nodes_mut()[..part.n_rows].split_at_mut(part.own.len());
        for (row, displacement_m) in own.iter_mut().zip(part.nodes().strained_m(leads)) {
            *row = [*displacement_m, [0.0; 4]];
        }
        for exchange in &part.borrowed {
            let owner = self.all[exchange.part].nodes();
            let displacement_m = owner.strained_m(leads);
            for &[here, there] in &exchange.rows {
                let row = &mut borrowed[usize::from(here) - own.len()];
                *row = [displacement_m[usize::from(there)], [0.0; 4]];
            }
        }
        self.path().add_forces(self.law, &part.blocks(), &mut rows);
    }

    /// Second phase: forces on the own nodes.
    pub(super) fn sum_forces(&self, p: usize) {
        self.sum_forces_into(p, &mut self.all[p].nodes_mut().force_n);
    }

    fn sum_forces_into(&self, p: usize, sums: &mut [Row]) {
        let part = &self.all[p];
        for (sum, [_, force]) in sums.iter_mut().zip(read(&part.rows).nodes()) {
            *sum = *force;
        }
        for exchange in &part.lent {
            let rows = read(&self.all[exchange.part].rows);
            let rows = rows.nodes();
            for &[here, there] in &exchange.rows {
                let (sum, [_, force]) = (&mut sums[usize::from(here)], &rows[usize::from(there)]);
                for i in 0..4 {
                    sum[i] += force[i];
                }
            }
        }
    }

    /// Second phase of a step: forces on the own nodes, and their motion.
    pub(super) fn sum_and_advance(&self, p: usize) {
        let factors = *read(&self.step);
        let mut nodes = self.all[p].nodes_mut();
        self.sum_forces_into(p, &mut nodes.force_n);
        nodes.advance(&factors);
    }
}
