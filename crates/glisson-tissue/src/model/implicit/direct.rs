//! The preconditioner of small bodies: a sparse factor of the matrix, which also tells entries of its inverse.

use super::patch_inverse::{Factored, PatchInverse};
use crate::model::kernel::KernelPath;
use crate::model::{LocalModel, NodalForce};
use crate::solve::{
    FactorPattern, FactorScratch, Factorization, FreeSystem, NextFactor, SolveError, StiffnessTensors,
};
use glisson_mesh::math::{DMat3, DVec3};

/// L L^T of the free components.
#[derive(Clone)]
pub(super) struct Direct {
    system: FreeSystem,
    factor: Factorization,
    next: NextFactor,
    scratch: FactorScratch,
    free: Vec<f64>,
    eliminated: Vec<f64>,
    /// Supernodes on the paths of nodes that forces act on, and of those that are asked about.
    paths: [Vec<bool>; 2],
    /// None for a matrix that is nothing but its diagonal, and before there are values.
    inverse: Option<PatchInverse>,
}

impl Direct {
    /// Without values.
    ///
    /// # Errors
    /// [`SolveError::Factorization`] when memory is short.
    pub(super) fn new(system: FreeSystem, pattern: FactorPattern) -> Result<Self, SolveError> {
        let factor = system.factor_for_slices(pattern)?;
        let free = vec![0.0; system.n_free()];
        Ok(Self {
            scratch: factor.scratch(1),
            eliminated: free.clone(),
            free,
            paths: [Vec::new(), Vec::new()],
            inverse: None,
            next: NextFactor::default(),
            system,
            factor,
        })
    }

    /// Once it has values: makes room for entries of the inverse, and for the next factor.
    pub(super) fn complete(&mut self, n_nodes: usize) {
        self.inverse = self.factor.is_supernodal().then(|| PatchInverse::new(&self.factor, n_nodes));
        let n_supernodes = if self.inverse.is_some() { self.factor.n_supernodes() } else { 0 };
        self.paths = [(); 2].map(|()| vec![false; n_supernodes]);
        self.factor.make_room(&mut self.next);
    }

    /// A copy that reads the same values and makes no others.
    pub(super) fn for_solutions(&self) -> Self {
        Self {
            system: self.system.numbering(),
            factor: self.factor.for_solutions(),
            scratch: self.scratch.clone(),
            free: self.free.clone(),
            eliminated: Vec::new(),
            paths: [Vec::new(), Vec::new()],
            inverse: None,
            next: NextFactor::default(),
        }
    }

    /// Work of a whole factor [ns].
    pub(super) fn work_ns(&self) -> u64 {
        self.factor.work_ns()
    }

    /// Factors new values, and checks on request that the matrix is not singular.
    pub(super) fn fill(&mut self, tensors: &StiffnessTensors, is_checked: bool) -> Result<(), SolveError> {
        self.system.refill(tensors);
        self.forget();
        if is_checked {
            self.factor.refactor(&self.system)
        } else {
            self.factor.refactor_definite(&self.system)
        }
    }

    /// New values for the slices that follow.
    pub(super) fn refill(&mut self, tensors: &StiffnessTensors) {
        self.system.refill(tensors);
    }

    /// Makes the next slice; true when the new values serve.
    pub(super) fn advance(&mut self, work_ns: &mut u64) -> Result<bool, SolveError> {
        let is_made = self.factor.advance(&mut self.next, &self.system, work_ns)?;
        if is_made {
            self.factor.exchange(&mut self.next);
            self.forget();
        }
        Ok(is_made)
    }

    pub(super) fn restart(&mut self) {
        self.next.restart();
    }

    fn forget(&mut self) {
        if let Some(inverse) = &mut self.inverse {
            inverse.forget();
        }
    }

    /// Overwrites `solution` with the inverse times `right`, zero for components that are not free.
    pub(super) fn solve_into(&mut self, right: &[DVec3], solution: &mut [DVec3]) {
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_in_place(&mut self.free, 1, &mut self.scratch);
        solution.fill(DVec3::ZERO);
        self.system.add_scattered(&self.free, solution);
    }

    /// As [`Self::solve_into`] for forces on these nodes, right at them alone and with the same bits there: nothing outside their paths in
    /// the elimination tree is computed.
    pub(super) fn solve_at_into(&mut self, forces: &[NodalForce], right: &[DVec3], solution: &mut [DVec3]) {
        let Some(inverse) = &self.inverse else { return self.solve_into(right, solution) };
        let of = (&self.system, &self.factor);
        let [given, asked] = &mut self.paths;
        for counts in [&mut *given, &mut *asked] {
            counts.fill(false);
        }
        for force in forces {
            inverse.add_path(force.node, of, asked);
            if force.force_n != DVec3::ZERO {
                inverse.add_path(force.node, of, given);
            }
        }
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_on_paths(&mut self.free, &mut self.eliminated, [given, asked], &mut self.scratch);
        solution.fill(DVec3::ZERO);
        self.system.add_scattered(&self.free, solution);
    }

    /// Whether it tells entries of the inverse.
    pub(super) fn tells_entries(&self) -> bool {
        self.inverse.is_some()
    }

    /// Overwrites C of a local model with entries of the inverse; the bits are the same on every path.
    pub(super) fn fill_compliance(&mut self, path: KernelPath, out: &mut LocalModel) {
        let with = Factored { factor: &self.factor, system: &self.system, path };
        let Some(inverse) = &mut self.inverse else { return };
        inverse.hold(&out.nodes, &with);
        for j in 0..out.nodes.len() {
            for i in 0..=j {
                let tensor: DMat3 = inverse.tensor(out.nodes[i], out.nodes[j], &with);
                out.set_tensor(i, j, tensor);
                out.set_tensor(j, i, tensor.transpose());
            }
        }
    }

    /// Overwrites the drift of a local model, after its C, with the inverse times `right`.
    pub(super) fn fill_drift(&mut self, right: &[DVec3], path: KernelPath, out: &mut LocalModel) {
        let Some(inverse) = &mut self.inverse else { return };
        self.system.gather_into(right, &mut self.free);
        self.factor.solve_lower_into(&self.free, &mut self.eliminated, &mut self.scratch);
        let with = Factored { factor: &self.factor, system: &self.system, path };
        for (node, drift_m) in out.nodes.iter().zip(&mut out.drift_m) {
            *drift_m = DVec3::from_array(inverse.product(*node, &self.eliminated, &with));
        }
    }
}
