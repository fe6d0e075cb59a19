//! The free rows and columns of K in a fixed sparse pattern, and their Cholesky factor.
//!
//! The pattern is computed once: every tensor entry has its slot, so new stiffness values are written without a search and
//! without allocation. The factor is faer's supernodal L L^T on one thread; where its values are made in slices, by our own
//! loop with the same bits (`supernodal_factor`). The fill-reducing order is approximate minimum degree (Amestoy, Davis and Duff 1996,
//! doi 10.1137/S0895479894278952) of the node graph, or nested dissection where it pays (`ordering`). The node graph is nine
//! times smaller than that of the components, and keeps a node's components together.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side};
use std::sync::Arc;

use super::ordering::nested_dissection;
use super::supernodal::{self, FactorScratch};
use super::supernodal_factor::{self, FactorPlan, LoopScratch};
use super::{BoundaryConditions, MeshEdges, SolveError, StiffnessTensors};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::NodeId;

/// Marks a prescribed component and a slot that does not exist.
const NONE: u32 = u32::MAX;

/// Bodies of at least so many nodes are ordered by nested dissection: smaller ones gain too little to make up for the time
/// of the ordering.
const DISSECTED_NODES: usize = 3_000;

/// The free part of K: upper triangle by columns, components in node order.
#[derive(Clone, Debug)]
pub struct FreeSystem {
    free_of: Vec<[u32; 3]>,
    n_free: usize,
    column_start: Vec<u32>,
    row: Vec<u32>,
    value: Vec<f64>,
    vertex_slots: Vec<[u32; 6]>,
    edge_slots: Vec<[u32; 9]>,
    node_order: Vec<u32>,
}

/// Entries (row, column) of a vertex tensor's upper triangle, in slot order.
const UPPER: [[usize; 2]; 6] = [[0, 0], [0, 1], [1, 1], [0, 2], [1, 2], [2, 2]];

impl FreeSystem {
    /// The system of `tensors` without the prescribed components.
    ///
    /// # Errors
    /// [`SolveError::Factorization`] when the ordering fails.
    pub fn new(
        edges: &MeshEdges,
        tensors: &StiffnessTensors,
        conditions: &BoundaryConditions,
    ) -> Result<Self, SolveError> {
        let order = minimum_degree(tensors.vertex.len(), edges).map_err(|reason| {
            SolveError::Factorization { n_rows: 3 * tensors.vertex.len(), reason: reason.to_string() }
        })?;
        Ok(Self::ordered(edges, tensors, conditions, order))
    }

    /// [`FreeSystem::new`] for a body whose system is solved often: large ones are ordered by nested dissection, which
    /// takes longer and makes factor and solutions faster. `positions_m` are those of the nodes.
    ///
    /// # Errors
    /// [`SolveError::Factorization`] when the ordering fails.
    ///
    /// # Panics
    /// When there is not one position per node.
    pub fn for_many_solutions(
        positions_m: &[DVec3],
        edges: &MeshEdges,
        tensors: &StiffnessTensors,
        conditions: &BoundaryConditions,
    ) -> Result<Self, SolveError> {
        assert_eq!(positions_m.len(), tensors.vertex.len(), "one position a node");
        if positions_m.len() < DISSECTED_NODES {
            return Self::new(edges, tensors, conditions);
        }
        Ok(Self::ordered(edges, tensors, conditions, nested_dissection(positions_m, edges)))
    }

    fn ordered(
        edges: &MeshEdges,
        tensors: &StiffnessTensors,
        conditions: &BoundaryConditions,
        node_order: Vec<u32>,
    ) -> Self {
        let n_nodes = tensors.vertex.len();
        let mut free_of = vec![[0; 3]; n_nodes];
        for (node, axis, _) in conditions.iter() {
            free_of[node.index()][axis] = NONE;
        }
        let mut n_free = 0;
        for free in free_of.iter_mut().flatten().filter(|f| **f != NONE) {
            *free = n_free;
            n_free += 1;
        }
        let mut system = Self {
            free_of,
            n_free: n_free as usize,
            column_start: vec![0; n_free as usize + 1],
            row: Vec::new(),
            value: Vec::new(),
            vertex_slots: vec![[NONE; 6]; n_nodes],
            edge_slots: vec![[NONE; 9]; edges.nodes.len()],
            node_order,
        };
        system.make_pattern(edges);
        system.refill(tensors);
        system
    }

    /// Columns of the higher node hold the lower node's rows; edges ascend, so rows ascend in each column.
    fn make_pattern(&mut self, edges: &MeshEdges) {
        let is_free = |f: &[u32; 3]| f.map(|x| usize::from(x != NONE));
        let mut count = vec![0u32; self.n_free];
        for &[p, q] in &edges.nodes {
            let rows: usize = is_free(&self.free_of[p.index()]).iter().sum();
            for column in self.free_of[q.index()].into_iter().filter(|&c| c != NONE) {
                count[column as usize] += rows as u32;
            }
        }
        for free in &self.free_of {
            let mut above = 0;
            for column in free.iter().filter(|c| **c != NONE) {
                above += 1;
                count[*column as usize] += above;
            }
        }
        for j in 0..self.n_free {
            self.column_start[j + 1] = self.column_start[j] + count[j];
        }
        let n_entries = self.column_start[self.n_free] as usize;
        self.row = vec![0; n_entries];
        self.value = vec![0.0; n_entries];
        let mut next: Vec<u32> = self.column_start[..self.n_free].to_vec();
        let mut place = |row: &mut [u32], r: u32, c: u32| {
            if r == NONE || c == NONE {
                return NONE;
            }
            let slot = next[c as usize];
            next[c as usize] += 1;
            row[slot as usize] = r;
            slot
        };
        for (e, &[p, q]) in edges.nodes.iter().enumerate() {
            for b in 0..3 {
                for a in 0..3 {
                    let (r, c) = (self.free_of[p.index()][a], self.free_of[q.index()][b]);
                    self.edge_slots[e][3 * b + a] = place(&mut self.row, r, c);
                }
            }
        }
        for n in 0..self.free_of.len() {
            for (s, [a, b]) in UPPER.into_iter().enumerate() {
                self.vertex_slots[n][s] = place(&mut self.row, self.free_of[n][a], self.free_of[n][b]);
            }
        }
    }

    /// Sets new stiffness values on the same mesh and supports, without allocation.
    pub fn refill(&mut self, tensors: &StiffnessTensors) {
        let entry = |m: &DMat3, a: usize, b: usize| m.col(b)[a];
        for (slots, m) in self.edge_slots.iter().zip(&tensors.edge) {
            for b in 0..3 {
                for a in 0..3 {
                    if let Some(v) = self.value.get_mut(slots[3 * b + a] as usize) {
                        *v = entry(m, a, b);
                    }
                }
            }
        }
        for (slots, m) in self.vertex_slots.iter().zip(&tensors.vertex) {
            for (s, [a, b]) in UPPER.into_iter().enumerate() {
                if let Some(v) = self.value.get_mut(slots[s] as usize) {
                    *v = entry(m, a, b);
                }
            }
        }
    }

    /// Number of free components: the size of the system.
    pub fn n_free(&self) -> usize {
        self.n_free
    }

    /// Row of a node's component `axis`, unless it is prescribed.
    pub fn row_of(&self, node: NodeId, axis: usize) -> Option<usize> {
        let free = self.free_of[node.index()][axis];
        (free != NONE).then_some(free as usize)
    }

    /// Overwrites `free` with the free components of a vector over nodes.
    pub fn gather_into(&self, of_node: &[DVec3], free: &mut [f64]) {
        for (rows, v) in self.free_of.iter().zip(of_node) {
            for axis in 0..3 {
                if let Some(x) = free.get_mut(rows[axis] as usize) {
                    *x = v[axis];
                }
            }
        }
    }

    /// Adds the free components to a vector over nodes.
    pub fn add_scattered(&self, free: &[f64], of_node: &mut [DVec3]) {
        for (rows, v) in self.free_of.iter().zip(of_node) {
            for axis in 0..3 {
                if let Some(x) = free.get(rows[axis] as usize) {
                    v[axis] += x;
                }
            }
        }
    }

    /// Subtracts K x from `from`, both over the free components: the residual of a solution.
    pub(crate) fn subtract_product(&self, x: &[f64], from: &mut [f64]) {
        for (c, range) in self.column_start.windows(2).enumerate() {
            for at in range[0] as usize..range[1] as usize {
                let (r, value) = (self.row[at] as usize, self.value[at]);
                from[r] -= value * x[c];
                if r != c {
                    from[c] -= value * x[r];
                }
            }
        }
    }

    /// Where the columns of the upper triangle start, rows (ascending, the diagonal last) and values [N/m].
    pub(super) fn upper_columns(&self) -> (&[u32], &[u32], &[f64]) {
        (&self.column_start, &self.row, &self.value)
    }

    fn pattern(&self) -> SymbolicSparseColMatRef<'_, u32> {
        SymbolicSparseColMatRef::new_checked(self.n_free, self.n_free, &self.column_start, None, &self.row)
    }

    /// Factors the system.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when it is not positive definite in floating point,
    /// [`SolveError::Factorization`] when memory is short.
    pub fn factorize(&self) -> Result<Factorization, SolveError> {
        let FactorPattern(symbolic) = self.pattern_of_factor()?;
        let making = self.making_at_once(&symbolic)?;
        let mut factor = Factorization { value: Arc::default(), symbolic, making };
        factor.refactor(self)?;
        Ok(factor)
    }

    /// The pattern of the factor.
    ///
    /// # Errors
    /// [`SolveError::Factorization`] when memory is short.
    pub(crate) fn pattern_of_factor(&self) -> Result<FactorPattern, SolveError> {
        let mut forward = Vec::with_capacity(self.n_free);
        for &node in &self.node_order {
            forward.extend(self.free_of[node as usize].into_iter().filter(|&f| f != NONE));
        }
        let mut inverse = vec![0; self.n_free];
        for (new, &old) in forward.iter().enumerate() {
            inverse[old as usize] = new as u32;
        }
        let parameters = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let order = SymmetricOrdering::Custom(PermRef::new_checked(&forward, &inverse, self.n_free));
        let symbolic = factorize_symbolic_cholesky(self.pattern(), Side::Upper, order, parameters)
            .map_err(|e| self.failed(e.to_string()))?;
        Ok(FactorPattern(Arc::new(symbolic)))
    }

    /// A factor without values, which are made in slices ([`Factorization::advance`]): always by our own loop, which takes longer
    /// than faer's for large systems.
    ///
    /// # Errors
    /// [`SolveError::Factorization`] when memory is short.
    ///
    /// # Panics
    /// When the pattern is that of another system.
    pub(crate) fn factor_for_slices(&self, pattern: FactorPattern) -> Result<Factorization, SolveError> {
        let FactorPattern(symbolic) = pattern;
        let making = match symbolic.raw() {
            SymbolicCholeskyRaw::Supernodal(nodes) => {
                let (_, inverse) =
                    symbolic.perm().expect("factors are made in an order of their own").arrays();
                let plan = FactorPlan::new(nodes, (&self.column_start, &self.row), inverse);
                Making::ByUnits { scratch: plan.scratch(self.n_free), plan: Arc::new(plan) }
            }
            SymbolicCholeskyRaw::Simplicial(_) => self.making_at_once(&symbolic)?,
        };
        Ok(Factorization { value: Arc::default(), symbolic, making })
    }

    fn making_at_once(&self, symbolic: &SymbolicCholesky<u32>) -> Result<Making, SolveError> {
        let request = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let memory = MemBuffer::try_new(request).map_err(|_| self.failed("out of memory".to_owned()))?;
        Ok(Making::AtOnce { memory })
    }

    fn failed(&self, reason: String) -> SolveError {
        SolveError::Factorization { n_rows: self.n_free, reason }
    }

    /// What gathers and scatters need of the system; it has no entries.
    pub(crate) fn numbering(&self) -> Self {
        Self {
            free_of: self.free_of.clone(),
            n_free: self.n_free,
            column_start: Vec::new(),
            row: Vec::new(),
            value: Vec::new(),
            vertex_slots: Vec::new(),
            edge_slots: Vec::new(),
            node_order: Vec::new(),
        }
    }
}

/// Order of elimination and pattern of a factor.
#[derive(Clone)]
pub(crate) struct FactorPattern(Arc<SymbolicCholesky<u32>>);

/// Nodes in elimination order, by approximate minimum degree.
pub(super) fn minimum_degree(n_nodes: usize, edges: &MeshEdges) -> Result<Vec<u32>, faer::sparse::FaerError> {
    let mut start = vec![0u32; n_nodes + 1];
    for edge in &edges.nodes {
        start[edge[1].index() + 1] += 1;
    }
    for n in 0..n_nodes {
        start[n + 1] += start[n];
    }
    let mut next = start.clone();
    let mut row = vec![0u32; edges.nodes.len()];
    for &[p, q] in &edges.nodes {
        row[next[q.index()] as usize] = p.0;
        next[q.index()] += 1;
    }
    let pattern = SymbolicSparseColMatRef::new_checked(n_nodes, n_nodes, &start, None, &row);
    let request = amd::order_maybe_unsorted_scratch::<u32>(n_nodes, row.len());
    let mut memory = MemBuffer::try_new(request).map_err(|_| faer::sparse::FaerError::OutOfMemory)?;
    let (mut order, mut inverse) = (vec![0u32; n_nodes], vec![0u32; n_nodes]);
    let stack = MemStack::new(&mut memory);
    amd::order_maybe_unsorted(&mut order, &mut inverse, pattern, amd::Control::default(), stack)?;
    Ok(order)
}

/// How new values are factored.
enum Making {
    /// By our own loop, which can stop.
    ByUnits { plan: Arc<FactorPlan>, scratch: LoopScratch },
    /// By faer: what is not made in slices, and a matrix that is nothing but its diagonal.
    AtOnce { memory: MemBuffer },
}

impl Clone for Making {
    /// Scratch of the same size; its contents do not matter.
    fn clone(&self) -> Self {
        match self {
            Self::ByUnits { plan, scratch } => {
                Self::ByUnits { plan: Arc::clone(plan), scratch: scratch.clone() }
            }
            Self::AtOnce { memory } => Self::AtOnce { memory: supernodal_factor::same_size(memory) },
        }
    }
}

/// L L^T of a [`FreeSystem`]; its pattern is kept for new values.
pub struct Factorization {
    symbolic: Arc<SymbolicCholesky<u32>>,
    /// Its own, but for [`Factorization::for_solutions`].
    value: Arc<Vec<f64>>,
    making: Making,
}

impl Clone for Factorization {
    /// With values of its own, so that making others allocates nothing.
    fn clone(&self) -> Self {
        Self {
            symbolic: Arc::clone(&self.symbolic),
            value: Arc::new(Vec::clone(&self.value)),
            making: self.making.clone(),
        }
    }
}

/// `n` values to write anew: those that are there and nobody else reads, or others.
fn own_values(values: &mut Arc<Vec<f64>>, n: usize) -> &mut Vec<f64> {
    if Arc::get_mut(values).is_none_or(|values| values.len() != n) {
        *values = Arc::new(vec![0.0; n]);
    }
    Arc::get_mut(values).expect("nobody else reads them")
}

/// New values of a factor, made in slices while the present ones serve.
#[derive(Default)]
pub(crate) struct NextFactor {
    value: Arc<Vec<f64>>,
    /// The unit of work to go on with.
    unit: usize,
}

impl Clone for NextFactor {
    /// What was not begun has nothing to copy.
    fn clone(&self) -> Self {
        let value = if self.unit == 0 { vec![0.0; self.value.len()] } else { Vec::clone(&self.value) };
        Self { value: Arc::new(value), unit: self.unit }
    }
}

impl NextFactor {
    /// Begins anew.
    pub(crate) fn restart(&mut self) {
        self.unit = 0;
    }
}

/// Factors into `value` from a unit on; see [`supernodal_factor::advance`].
fn go_on(
    (symbolic, making): (&SymbolicCholesky<u32>, &mut Making),
    system: &FreeSystem,
    value: &mut [f64],
    unit: usize,
    work_ns: &mut u64,
) -> Result<usize, SolveError> {
    match (making, symbolic.raw()) {
        (Making::ByUnits { plan, scratch }, SymbolicCholeskyRaw::Supernodal(nodes)) => {
            supernodal_factor::advance((nodes, plan), &system.value, value, unit, work_ns, scratch)
        }
        (Making::AtOnce { memory }, _) => {
            let matrix = SparseColMatRef::new(system.pattern(), &system.value[..]);
            let stack = MemStack::new(memory);
            symbolic
                .factorize_numeric_llt(
                    value,
                    matrix,
                    Side::Upper,
                    LltRegularization::default(),
                    Par::Seq,
                    stack,
                    Default::default(),
                )
                .map(|_| 1)
                .map_err(|_| SolveError::Singular)
        }
        (Making::ByUnits { .. }, SymbolicCholeskyRaw::Simplicial(_)) => {
            unreachable!("made by units where there are supernodes")
        }
    }
}

/// K counts as singular when the growth of a right-hand side through K^-1, times the largest diagonal entry, exceeds this:
/// the pivots of a true mechanism are rounding errors, 1e-16 of the diagonal; the worst organ meshes reach 1e9.
const SINGULAR_GROWTH: f64 = 1e13;

impl Factorization {
    /// A copy that reads the same values and makes no others.
    pub(crate) fn for_solutions(&self) -> Self {
        Self {
            symbolic: Arc::clone(&self.symbolic),
            value: Arc::clone(&self.value),
            making: Making::AtOnce { memory: MemBuffer::new(StackReq::EMPTY) },
        }
    }

    /// Factors new values of the same system and checks that K is not singular.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when they are not positive definite in floating point.
    pub fn refactor(&mut self, system: &FreeSystem) -> Result<(), SolveError> {
        self.refactor_definite(system)?;
        self.check_growth(system)
    }

    /// Factors new values of a system that cannot be nearly singular because its diagonal contains masses: like
    /// [`Factorization::refactor`] without that check. No allocation.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when a pivot is not positive.
    pub fn refactor_definite(&mut self, system: &FreeSystem) -> Result<(), SolveError> {
        if system.n_free == 0 {
            return Ok(());
        }
        let Self { symbolic, value, making } = self;
        go_on((symbolic, making), system, own_values(value, symbolic.len_val()), 0, &mut { u64::MAX })
            .map(|_| ())
    }

    /// Makes room for new values, which [`Factorization::advance`] does where there is none.
    pub(crate) fn make_room(&self, next: &mut NextFactor) {
        own_values(&mut next.value, self.symbolic.len_val());
    }

    /// Goes on with new values of the system, which must not change meanwhile, for as long as `work_ns` lasts, but by one
    /// unit at least; takes what was done from `work_ns`. True when all are there. The bits are those of
    /// [`Factorization::refactor_definite`] whatever the slices. No allocation.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when a pivot is not positive.
    pub(crate) fn advance(
        &mut self,
        next: &mut NextFactor,
        system: &FreeSystem,
        work_ns: &mut u64,
    ) -> Result<bool, SolveError> {
        let Self { symbolic, making, .. } = self;
        let value = own_values(&mut next.value, symbolic.len_val());
        next.unit = go_on((symbolic, making), system, value, next.unit, work_ns)?;
        Ok(next.unit == self.n_units())
    }

    /// Exchanges the values for new ones.
    pub(crate) fn exchange(&mut self, next: &mut NextFactor) {
        std::mem::swap(&mut self.value, &mut next.value);
    }

    /// Work of a whole factor [ns]: a fixed estimate from counts ([`supernodal_factor`]), no time that anything took.
    pub(crate) fn work_ns(&self) -> u64 {
        match &self.making {
            Making::ByUnits { plan, .. } => plan.work_ns(),
            Making::AtOnce { .. } => self.value.len() as u64,
        }
    }

    fn n_units(&self) -> usize {
        match &self.making {
            Making::ByUnits { plan, .. } => plan.n_units(),
            Making::AtOnce { .. } => 1,
        }
    }

    fn check_growth(&self, system: &FreeSystem) -> Result<(), SolveError> {
        if system.n_free == 0 {
            return Ok(());
        }
        let largest = (0..system.n_free)
            .map(|j| system.value[system.column_start[j + 1] as usize - 1])
            .fold(0.0, f64::max);
        let mut random = SeededRandom::new(0);
        let mut x: Vec<f64> = (0..system.n_free).map(|_| random.normal()).collect();
        let norm = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>().sqrt();
        let before = norm(&x);
        self.solve_in_place(&mut x, 1, &mut self.scratch(1));
        let growth = norm(&x) / before * largest;
        if growth < SINGULAR_GROWTH { Ok(()) } else { Err(SolveError::Singular) }
    }

    /// Number of entries of L, fill included.
    pub fn n_entries(&self) -> usize {
        self.value.len()
    }

    /// Number of unknowns.
    pub fn n_rows(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Scratch for solving up to `n_columns` right-hand sides at once.
    pub fn scratch(&self, n_columns: usize) -> FactorScratch {
        FactorScratch::new(&self.symbolic, n_columns)
    }

    /// Replaces `n_columns` right-hand sides, one after the other in `columns`, by their solutions; no
    /// allocation. The bits of a column depend on the number of columns solved with it.
    ///
    /// # Panics
    /// When the length of `columns` or the scratch does not fit.
    pub fn solve_in_place(&self, columns: &mut [f64], n_columns: usize, scratch: &mut FactorScratch) {
        supernodal::solve_in_place((&self.symbolic, &self.value), columns, n_columns, scratch);
    }

    /// Overwrites `solution` with L^-1 P b for one right-hand side b, in the order of elimination; no allocation.
    ///
    /// # Panics
    /// When a length does not fit.
    pub(crate) fn solve_lower_into(&self, right: &[f64], solution: &mut [f64], scratch: &mut FactorScratch) {
        let n = self.symbolic.nrows();
        assert_eq!([right.len(), solution.len()], [n; 2], "columns of {n} rows");
        let (forward, _) = self.order();
        for (x, old) in solution.iter_mut().zip(forward) {
            *x = right[*old as usize];
        }
        supernodal::solve_lower_in_place((&self.symbolic, &self.value), solution, scratch);
    }

    /// Overwrites `solution` with that for one right-hand side, in the rows of the supernodes that are asked about, with the bits of
    /// [`Self::solve_in_place`]; what other rows get has no meaning. `given`: the supernodes outside which the right-hand side is zero.
    /// Both lists with all ancestors. No allocation.
    ///
    /// # Panics
    /// When a length does not fit.
    pub(crate) fn solve_on_paths(
        &self,
        column: &mut [f64],
        ordered: &mut [f64],
        [given, asked]: [&[bool]; 2],
        scratch: &mut FactorScratch,
    ) {
        let (forward, inverse) = self.order();
        for (x, old) in ordered.iter_mut().zip(forward) {
            *x = column[*old as usize];
        }
        supernodal::solve_on_paths((&self.symbolic, &self.value), ordered, [given, asked], scratch);
        for (x, place) in column.iter_mut().zip(inverse) {
            *x = ordered[*place as usize];
        }
    }

    /// Place of a row in the order of elimination.
    pub(crate) fn place_of_row(&self, row: usize) -> usize {
        self.order().1[row] as usize
    }

    /// Whether L is kept by supernodes: always, but for a matrix that is nothing but its diagonal.
    pub(crate) fn is_supernodal(&self) -> bool {
        matches!(self.symbolic.raw(), SymbolicCholeskyRaw::Supernodal(_))
    }

    /// Number of supernodes: runs of columns of L with the same rows below them.
    pub(crate) fn n_supernodes(&self) -> usize {
        self.supernodal().n_supernodes()
    }

    /// A supernode, in the order of elimination.
    pub(crate) fn supernode(&self, s: usize) -> Supernode<'_> {
        let symbolic = self.supernodal();
        let start = symbolic.supernode_begin()[s] as usize;
        let size = symbolic.supernode_end()[s] as usize - start;
        let values = symbolic.col_ptr_for_val();
        let values = &self.value[values[s] as usize..values[s + 1] as usize];
        Supernode { start, size, rows_below: symbolic.supernode(s).pattern(), values }
    }

    fn order(&self) -> (&[u32], &[u32]) {
        self.symbolic.perm().expect("factors are made in an order of their own").arrays()
    }

    fn supernodal(&self) -> &SymbolicSupernodalCholesky<u32> {
        match self.symbolic.raw() {
            SymbolicCholeskyRaw::Supernodal(symbolic) => symbolic,
            SymbolicCholeskyRaw::Simplicial(_) => unreachable!("asked of supernodal factors alone"),
        }
    }
}

/// Columns of L with the same rows below them.
pub(crate) struct Supernode<'a> {
    /// The first column.
    pub(crate) start: usize,
    /// Number of columns.
    pub(crate) size: usize,
    /// Rows below the triangle of the columns, ascending.
    pub(crate) rows_below: &'a [u32],
    /// Columns one after the other: first the rows of the triangle, of which the upper part does not count, then those below.
    pub(crate) values: &'a [f64],
}
