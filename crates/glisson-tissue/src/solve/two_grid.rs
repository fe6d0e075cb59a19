//! Two grids: the inverse of a stiffness matrix with masses, approximately, in time and memory that grow with the number of
//! nodes.
//!
//! What varies slowly is taken by the rigid motions of groups of nodes ([`Aggregates`]), whose matrix is small and factored:
//! Q = P (P^T A P)^-1 P^T. What varies from node to node is taken by three steps of Chebyshev's iteration with the blocks of
//! the diagonal, S. Together they are
//!
//! M = Q + (1 - Q A) S (1 - A Q),
//!
//! which is symmetric and positive definite, so that conjugate gradients can be preconditioned by it, and leaves no force and
//! no moment on any group: P^T (b - A M b) = 0. So what is left of a solution that ends early neither pushes nor turns the
//! body. Groups and their rigid motions: V. E. Bulgakov and G. Kuhn 1995, High-performance multilevel iterative aggregation
//! solver for large finite-element structural analysis problems, doi 10.1002/nme.1620382009. M: J. Mandel 1993, Balancing
//! domain decomposition, doi 10.1002/cnm.1640090307. Chebyshev's iteration in the place of S: M. Adams, M. Brezina, J. Hu
//! and R. Tuminaro 2003, Parallel multigrid smoothing: polynomial versus Gauss-Seidel, doi 10.1016/S0021-9991(03)00194-3.
//!
//! All of it is in single precision but for the small matrix: it is read four times in every application, and only directions
//! come from it.

use glam::{DMat3, DVec3, Mat3A, Vec3A};
use std::sync::Arc;

use super::aggregates::{Aggregates, Rows};
use super::{
    BoundaryConditions, FactorScratch, Factorization, FreeSystem, MeshEdges, NextFactor, SolveError,
    StiffnessTensors,
};
use crate::workers::{Workers, in_stretches};
use glisson_mesh::math::{SeededRandom, cross_matrix};
use glisson_mesh::mesh::NodeId;

/// Nodes of a group: fewer bring fewer iterations and a larger matrix. A choice.
const GROUP_NODES: usize = 30;
/// Most groups, so that the factor of their matrix is read in less time than A.
const MOST_GROUPS: usize = 300;
/// Chebyshev's iteration takes the eigenvalues of D^-1 A from the largest down to this share of it.
const SMOOTHED_SHARE: f32 = 0.1;
const SMOOTHING_STEPS: usize = 3;
/// The largest eigenvalue is looked for by so many steps of the power method, which comes from below: this much is added.
const POWER_STEPS: usize = 12;
const POWER_MARGIN: f32 = 1.1;
/// D^-1 A of tetrahedra has none above the number of their corners.
const LARGEST_EIGENVALUE: f32 = 4.0;
/// Added to the rotations' part of the small matrix, as a share: groups of nodes on a line have one that moves nothing.
const REGULARIZATION: f64 = 1e-6;

// Work [ns], see [`Factorization::work_ns`]: fixed estimates. They decide where slices end, and enter no number.
const BLOCK_WORK_NS: u64 = 40;
const POWER_BLOCK_WORK_NS: u64 = 2;

/// What follows from edges and supports alone.
struct Structure {
    rows: Rows,
    aggregates: Aggregates,
    /// 1 for each axis along which a node moves, 0 for the others.
    free_axes: Vec<Vec3A>,
    /// Where the edges of each group's translation begin among those of the small matrix.
    small_edge: Vec<u32>,
}

impl Structure {
    fn translation_edge(&self, pair: usize, low: usize) -> usize {
        let [first, _] = [low, low + 1].map(|a| self.aggregates.higher_start[a] as usize);
        self.small_edge[low] as usize + 1 + 2 * (pair - first)
    }

    /// The small matrix's edges: a group is two nodes of it, one for its translation and one for its rotation.
    fn edges_of_small(aggregates: &Aggregates) -> (MeshEdges, Vec<u32>) {
        let (mut nodes, mut first) = (Vec::new(), Vec::new());
        for a in 0..aggregates.len() {
            first.push(nodes.len() as u32);
            let [translation, rotation] = motions_of(a);
            nodes.push([translation, rotation]);
            let range = aggregates.higher_start[a] as usize..aggregates.higher_start[a + 1] as usize;
            for own in [translation, rotation] {
                let others = aggregates.higher[range.clone()].iter().flat_map(|b| motions_of(*b as usize));
                nodes.extend(others.map(|other| [own, other]));
            }
        }
        (MeshEdges { nodes, of_tet: Vec::new() }, first)
    }
}

/// The two nodes of a group in the small matrix.
fn motions_of(group: usize) -> [NodeId; 2] {
    [NodeId::from_index(2 * group), NodeId::from_index(2 * group + 1)]
}

/// What follows from the matrix.
#[derive(Clone, Default)]
struct Values {
    diagonal: Vec<Mat3A>,
    /// Blocks of [`Rows`].
    blocks: Vec<Mat3A>,
    /// Inverse of each block of the diagonal.
    inverse: Vec<Mat3A>,
    /// From the centre of its group to each node, and the axes along which the node follows the group.
    arm: Vec<Vec3A>,
    follows: Vec<Vec3A>,
    /// Largest eigenvalue of D^-1 A, with a margin.
    largest: f32,
}

impl Values {
    fn for_rows(rows: &Rows) -> Self {
        let (n, n_blocks) = (rows.n_rows(), rows.neighbour.len());
        Self {
            diagonal: vec![Mat3A::ZERO; n],
            blocks: vec![Mat3A::ZERO; n_blocks],
            inverse: vec![Mat3A::ZERO; n],
            arm: vec![Vec3A::ZERO; n],
            follows: vec![Vec3A::ZERO; n],
            largest: LARGEST_EIGENVALUE,
        }
    }

    /// Row `n` of A v.
    fn product(&self, rows: &Rows, n: usize, v: &[Vec3A]) -> Vec3A {
        let row = rows.row(n);
        let mut sum = self.diagonal[n] * v[n];
        for (block, neighbour) in self.blocks[row.clone()].iter().zip(&rows.neighbour[row]) {
            sum += *block * v[*neighbour as usize];
        }
        sum
    }
}

/// The matrix, and where it comes from.
pub(crate) struct Given<'a> {
    pub(crate) tensors: &'a StiffnessTensors,
    pub(crate) rest_m: &'a [DVec3],
    pub(crate) displacement_m: &'a [DVec3],
    /// Nodes without stiffness to others, which follow no group.
    pub(crate) is_held: &'a [bool],
}

impl Given<'_> {
    fn position_m(&self, n: usize) -> DVec3 {
        self.rest_m[n] + self.displacement_m[n]
    }
}

/// New values, made in slices while the present ones serve.
#[derive(Clone, Default)]
struct Next {
    values: Arc<Values>,
    factor: NextFactor,
    stage: Stage,
    /// The power method's vector: applications between slices must not change it.
    power: Vec<Vec3A>,
}

#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Stage {
    #[default]
    Start,
    /// The next row.
    Rows(usize),
    /// Steps of the power method that are left.
    Power(usize),
    Factor,
}

/// Vectors of an application.
#[derive(Clone)]
struct Scratch {
    right: Vec<Vec3A>,
    solution: Vec<Vec3A>,
    residual: Vec<Vec3A>,
    change: Vec<Vec3A>,
    /// What comes after `change`.
    other: Vec<Vec3A>,
    small: Vec<f64>,
    factor: FactorScratch,
    search: Vec<Vec3A>,
    sum: Vec<Vec3A>,
}

/// An approximate inverse of the matrix of a mesh, by two grids.
pub(crate) struct TwoGrid {
    structure: Arc<Structure>,
    values: Arc<Values>,
    small_tensors: StiffnessTensors,
    small: FreeSystem,
    factor: Factorization,
    next: Next,
    scratch: Scratch,
}

impl Clone for TwoGrid {
    /// With values of its own, so that making others allocates nothing.
    fn clone(&self) -> Self {
        Self {
            structure: Arc::clone(&self.structure),
            values: Arc::new(Values::clone(&self.values)),
            small_tensors: self.small_tensors.clone(),
            small: self.small.clone(),
            factor: self.factor.clone(),
            next: Next { values: Arc::new(Values::clone(&self.next.values)), ..self.next.clone() },
            scratch: self.scratch.clone(),
        }
    }
}

impl TwoGrid {
    /// For the matrix of a mesh with these edges; `free_axes`: 1 for each axis along which a node can move, 0 for the others.
    /// It has no values yet.
    ///
    /// # Errors
    /// [`SolveError::Factorization`] when memory is short.
    pub(crate) fn new(
        positions_m: &[DVec3],
        edges: &MeshEdges,
        free_axes: &[DVec3],
    ) -> Result<Self, SolveError> {
        let moves: Vec<bool> = free_axes.iter().map(|free| *free != DVec3::ZERO).collect();
        let n_moving = moves.iter().filter(|moves| **moves).count();
        let n_groups = (n_moving / GROUP_NODES).clamp(1, MOST_GROUPS);
        let rows = Rows::new(edges, &moves);
        let aggregates = Aggregates::new(positions_m, &rows, &moves, n_groups);
        let (small_edges, small_edge) = Structure::edges_of_small(&aggregates);
        let small_tensors = StiffnessTensors::zeros(2 * aggregates.len(), &small_edges);
        let small = FreeSystem::new(&small_edges, &small_tensors, &BoundaryConditions::new())?;
        let factor = small.factor_for_slices(small.pattern_of_factor()?)?;
        let n = free_axes.len();
        let zeros = || vec![Vec3A::ZERO; n];
        let scratch = Scratch {
            right: zeros(),
            solution: zeros(),
            residual: zeros(),
            change: zeros(),
            other: zeros(),
            small: vec![0.0; small.n_free()],
            factor: factor.scratch(1),
            search: zeros(),
            sum: zeros(),
        };
        let values = || Arc::new(Values::for_rows(&rows));
        let next = Next { values: values(), power: zeros(), ..Next::default() };
        let values = values();
        let free_axes = free_axes.iter().map(|free| free.as_vec3a()).collect();
        let structure = Arc::new(Structure { rows, aggregates, free_axes, small_edge });
        Ok(Self { structure, values, small_tensors, small, factor, next, scratch })
    }

    /// A copy that reads the same values and makes no others.
    pub(crate) fn for_solutions(&self) -> Self {
        Self {
            structure: Arc::clone(&self.structure),
            values: Arc::clone(&self.values),
            small_tensors: StiffnessTensors::default(),
            small: self.small.numbering(),
            factor: self.factor.for_solutions(),
            next: Next::default(),
            scratch: self.scratch.clone(),
        }
    }

    /// Once it has values: makes room for others.
    pub(crate) fn complete(&mut self) {
        self.factor.make_room(&mut self.next.factor);
    }

    /// Work to make values [ns]: a fixed estimate from counts.
    pub(crate) fn work_ns(&self) -> u64 {
        let n_blocks = self.structure.rows.neighbour.len() as u64;
        n_blocks * (BLOCK_WORK_NS + POWER_STEPS as u64 * POWER_BLOCK_WORK_NS) + self.factor.work_ns()
    }

    /// Gives up the values that are being made.
    pub(crate) fn restart(&mut self) {
        self.next.stage = Stage::Start;
        self.next.factor.restart();
    }

    /// Makes values at once, and uses them.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when the matrix is not positive definite.
    pub(crate) fn fill(&mut self, given: &Given<'_>) -> Result<(), SolveError> {
        self.restart();
        self.advance(given, &mut { u64::MAX }).map(|_| ())
    }

    /// Goes on with new values, for as long as `work_ns` lasts, but by something at least; takes what was done from it. True when
    /// they serve. The bits do not depend on the slices. No allocation, but where a copy reads the values before.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when the matrix is not positive definite; the values before serve on.
    pub(crate) fn advance(&mut self, given: &Given<'_>, work_ns: &mut u64) -> Result<bool, SolveError> {
        let structure = Arc::clone(&self.structure);
        if Arc::get_mut(&mut self.next.values).is_none_or(|values| values.diagonal.is_empty()) {
            self.next.values = Arc::new(Values::for_rows(&structure.rows));
        }
        let values = Arc::get_mut(&mut self.next.values).expect("nobody else reads them");
        let n_blocks = structure.rows.neighbour.len() as u64;
        loop {
            self.next.stage = match self.next.stage {
                Stage::Start => {
                    self.small_tensors.vertex.fill(DMat3::ZERO);
                    self.small_tensors.edge.fill(DMat3::ZERO);
                    structure.place(given, values);
                    Stage::Rows(0)
                }
                Stage::Rows(n) if n == structure.rows.n_rows() => {
                    for motions in self.small_tensors.vertex.chunks_exact_mut(2) {
                        regularize(motions);
                    }
                    self.small.refill(&self.small_tensors);
                    let mut random = SeededRandom::new(0);
                    for (v, free) in self.next.power.iter_mut().zip(&structure.free_axes) {
                        *v = Vec3A::from_array([0; 3].map(|_| random.normal() as f32)) * *free;
                    }
                    Stage::Power(POWER_STEPS)
                }
                Stage::Rows(n) => {
                    structure.fill_row(n, given, values, &mut self.small_tensors);
                    *work_ns = work_ns.saturating_sub(structure.rows.row(n).len() as u64 * BLOCK_WORK_NS);
                    Stage::Rows(n + 1)
                }
                Stage::Power(0) => Stage::Factor,
                Stage::Power(left) => {
                    structure.power_step(values, &mut self.next.power, &mut self.scratch.change);
                    *work_ns = work_ns.saturating_sub(n_blocks * POWER_BLOCK_WORK_NS);
                    Stage::Power(left - 1)
                }
                Stage::Factor => match self.factor.advance(&mut self.next.factor, &self.small, work_ns) {
                    Ok(true) => {
                        self.factor.exchange(&mut self.next.factor);
                        std::mem::swap(&mut self.values, &mut self.next.values);
                        self.restart();
                        return Ok(true);
                    }
                    Ok(false) => Stage::Factor,
                    Err(error) => {
                        self.restart();
                        return Err(error);
                    }
                },
            };
            if *work_ns == 0 {
                return Ok(false);
            }
        }
    }

    /// Overwrites `solution` with about the inverse times `right`, zero for components that are not free: a symmetric, positive
    /// definite product, to rounding in single precision. Nodes beyond those of the matrix are left alone.
    pub(crate) fn apply_into(&mut self, workers: &dyn Workers, right: &[DVec3], solution: &mut [DVec3]) {
        let Some(scale) = self.read(right) else { return };
        let Self { structure, values, factor, scratch, .. } = self;
        let cycle = Cycle { structure, values, factor, workers };
        cycle.run(scratch);
        for (x, own) in solution.iter_mut().zip(&scratch.solution) {
            *x = own.as_dvec3() * scale;
        }
    }

    /// Overwrites `solution` with the inverse times `right`, to a residual of `tolerance`, zero for components that are not free, by
    /// at most so many iterations of conjugate gradients. False when they are not enough.
    pub(crate) fn solve_into(
        &mut self,
        workers: &dyn Workers,
        right: &[DVec3],
        solution: &mut [DVec3],
        (tolerance, most_iterations): (f64, u32),
    ) -> bool {
        let Some(scale) = self.read(right) else { return true };
        let Self { structure, values, factor, scratch, .. } = self;
        let cycle = Cycle { structure, values, factor, workers };
        scratch.sum.fill(Vec3A::ZERO);
        let square_of = |right: &[Vec3A]| dot(right, right);
        let limit = tolerance * tolerance * square_of(&scratch.right);
        let mut product = 0.0;
        for k in 0..most_iterations {
            if square_of(&scratch.right) <= limit {
                break;
            }
            cycle.run(scratch);
            let before = std::mem::replace(&mut product, dot(&scratch.right, &scratch.solution));
            // The first step is as long as M says: from then on no group is pushed or turned.
            let beta = if k < 2 { 0.0 } else { (product / before) as f32 };
            for (p, z) in scratch.search.iter_mut().zip(&scratch.solution) {
                *p = if k < 2 { *z } else { *z + *p * beta };
            }
            cycle.product_into(&scratch.search, &mut scratch.change);
            let curvature = dot(&scratch.search, &scratch.change);
            if !(curvature > 0.0 && product > 0.0) {
                break;
            }
            let length = if k == 0 { 1.0 } else { (product / curvature) as f32 };
            for n in 0..scratch.search.len() {
                scratch.sum[n] += scratch.search[n] * length;
                scratch.right[n] -= scratch.change[n] * length;
            }
        }
        for (x, own) in solution.iter_mut().zip(&scratch.sum) {
            *x = own.as_dvec3() * scale;
        }
        square_of(&scratch.right) <= limit
    }

    /// Reads the free components of a vector, so scaled that none is above 1; none for zero, or what is no number.
    fn read(&mut self, right: &[DVec3]) -> Option<f64> {
        let free_axes = &self.structure.free_axes;
        let largest = right
            .iter()
            .zip(free_axes)
            .fold(0.0, |largest: f64, (v, free)| largest.max((*v * free.as_dvec3()).abs().max_element()));
        if !(largest > 0.0 && largest.is_finite()) {
            return None;
        }
        for ((own, v), free) in self.scratch.right.iter_mut().zip(right).zip(free_axes) {
            *own = (*v / largest).as_vec3a() * *free;
        }
        Some(largest)
    }
}

/// Gives stiffness to motions of a group that move nothing: along an axis that is fixed at all of its nodes, and rotations where
/// its nodes lie on a line, or there is one alone.
fn regularize(motions: &mut [DMat3]) {
    let size = |m: &DMat3| m.col(0).x + m.col(1).y + m.col(2).z;
    // All of its nodes are held: any will do.
    let largest = if size(&motions[0]) > 0.0 { size(&motions[0]) } else { 1.0 };
    for k in 0..3 {
        let stiffness = &mut motions[0].col_mut(k)[k];
        if *stiffness == 0.0 {
            *stiffness = largest;
        }
    }
    let added = REGULARIZATION * size(&motions[1]).max(REGULARIZATION * size(&motions[0]));
    motions[1] += DMat3::from_diagonal(DVec3::splat(added));
}

impl Structure {
    /// Where the nodes are in their groups. Arms are in units of the group's size.
    fn place(&self, given: &Given<'_>, values: &mut Values) {
        for (n, follows) in values.follows.iter_mut().enumerate() {
            *follows = if given.is_held[n] { Vec3A::ZERO } else { self.free_axes[n] };
        }
        for a in 0..self.aggregates.len() {
            let members = self.aggregates.members(a);
            let places = || members.iter().map(|n| given.position_m(*n as usize));
            let center_m = places().sum::<DVec3>() / members.len() as f64;
            let size2 = places().map(|p| p.distance_squared(center_m)).sum::<f64>() / members.len() as f64;
            let per_m = if size2 > 0.0 { 1.0 / size2.sqrt() } else { 0.0 };
            for &n in members {
                let arm = (given.position_m(n as usize) - center_m) * per_m;
                values.arm[n as usize] = if arm.is_finite() { arm.as_vec3a() } else { Vec3A::ZERO };
            }
        }
    }

    /// Row `n` of A, and what it and the same columns add to the small matrix.
    fn fill_row(&self, n: usize, given: &Given<'_>, values: &mut Values, small: &mut StiffnessTensors) {
        let free = self.free_axes[n];
        let own = given.tensors.vertex[n];
        let fixed = Mat3A::from_diagonal((Vec3A::ONE - free).into());
        let diagonal = between(free, &own, free) + fixed;
        values.diagonal[n] = diagonal;
        let inverse = diagonal.inverse();
        values.inverse[n] = if inverse.is_finite() { inverse } else { Mat3A::ZERO };
        let group = self.aggregates.of_node[n];
        if group == u32::MAX {
            return;
        }
        let mine = [values.arm[n], values.follows[n]];
        self.add_small(group, group, of_motions(mine, &own, mine), small);
        for place in self.rows.row(n) {
            let other = self.rows.neighbour[place] as usize;
            let tensor = &given.tensors.edge[self.rows.edge[place] as usize];
            let block = if n < other { *tensor } else { tensor.transpose() };
            values.blocks[place] = between(free, &block, self.free_axes[other]);
            let of_other = self.aggregates.of_node[other];
            if of_other >= group {
                let theirs = [values.arm[other], values.follows[other]];
                self.add_small(group, of_other, of_motions(mine, &block, theirs), small);
            }
        }
    }

    /// Adds the four blocks between the motions of two groups.
    fn add_small(&self, low: u32, high: u32, blocks: [DMat3; 4], small: &mut StiffnessTensors) {
        let low_n = low as usize;
        let [tt, tr, rt, rr] = blocks;
        if low == high {
            small.vertex[2 * low_n] += tt;
            small.vertex[2 * low_n + 1] += rr;
            small.edge[self.small_edge[low_n] as usize] += tr;
            return;
        }
        let first = self.translation_edge(self.aggregates.pair(low, high), low_n);
        let n_higher = self.aggregates.higher_start[low_n + 1] - self.aggregates.higher_start[low_n];
        let second = first + 2 * n_higher as usize;
        small.edge[first] += tt;
        small.edge[first + 1] += tr;
        small.edge[second] += rt;
        small.edge[second + 1] += rr;
    }

    /// One step of the power method on D^-1 A.
    fn power_step(&self, values: &mut Values, vector: &mut [Vec3A], next: &mut [Vec3A]) {
        for n in 0..next.len() {
            next[n] = values.inverse[n] * values.product(&self.rows, n, vector);
        }
        let growth = (dot(next, next) / dot(vector, vector)).sqrt() as f32;
        let largest = growth * POWER_MARGIN;
        // A matrix of no rows has none.
        values.largest =
            if largest.is_finite() { largest.clamp(1.0, LARGEST_EIGENVALUE) } else { LARGEST_EIGENVALUE };
        for (v, next) in vector.iter_mut().zip(next) {
            *v = if growth > 0.0 { *next / growth } else { *next };
        }
    }
}

/// B with the rows and columns of free axes alone.
fn between(rows: Vec3A, b: &DMat3, columns: Vec3A) -> Mat3A {
    let column = |k: usize| (b.col(k).as_vec3a() * rows) * columns[k];
    Mat3A::from_cols(column(0), column(1), column(2))
}

/// The blocks of a tensor between the rigid motions of two nodes, from arms and axes that follow: translations, translation
/// and rotation, rotation and translation, rotations.
fn of_motions([arm, follows]: [Vec3A; 2], b: &DMat3, [other_arm, other_follows]: [Vec3A; 2]) -> [DMat3; 4] {
    let diagonal = |v: Vec3A| DMat3::from_diagonal(v.as_dvec3());
    let tt = diagonal(follows) * *b * diagonal(other_follows);
    // A rotation w moves a node by w x arm = -[arm] w.
    let turned = cross_matrix(other_arm.as_dvec3());
    let turning = cross_matrix(arm.as_dvec3());
    let tr = tt * turned * -1.0;
    [tt, tr, turning * tt, turning * tr]
}

fn dot(a: &[Vec3A], b: &[Vec3A]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a.dot(*b))).sum()
}

/// What an application reads.
struct Cycle<'a> {
    structure: &'a Structure,
    values: &'a Values,
    factor: &'a Factorization,
    workers: &'a dyn Workers,
}

/// Rows that are worth a task.
const LEAST_ROWS: usize = 256;

impl Cycle<'_> {
    /// Overwrites `product` with A v.
    fn product_into(&self, v: &[Vec3A], product: &mut [Vec3A]) {
        in_stretches(self.workers, LEAST_ROWS, product, |first, product| {
            for (n, product) in (first..).zip(product) {
                *product = self.values.product(&self.structure.rows, n, v);
            }
        });
    }

    /// Overwrites `solution` with M times `right`.
    fn run(&self, scratch: &mut Scratch) {
        let Scratch { right, solution, residual, change, other, small, factor, .. } = scratch;
        self.move_groups([right, solution], small, factor);
        self.smooth(right, [solution, residual, change, other]);
        self.move_groups([residual, change], small, factor);
        solution.iter_mut().zip(change).for_each(|(x, more)| *x += *more);
    }

    /// Adds the steps of Chebyshev's iteration (Y. Saad 2003, Iterative Methods for Sparse Linear Systems, doi
    /// 10.1137/1.9780898718003, algorithm 12.1), and leaves the residual.
    fn smooth(&self, right: &[Vec3A], [solution, residual, change, other]: [&mut Vec<Vec3A>; 4]) {
        let Self { structure: Structure { rows, .. }, values, workers, .. } = *self;
        let Values { inverse, largest, .. } = values;
        let [centre, half] = [1.0 + SMOOTHED_SHARE, 1.0 - SMOOTHED_SHARE].map(|c| 0.5 * c * largest);
        let sigma = centre / half;
        let mut rho = 1.0 / sigma;
        in_stretches(
            workers,
            LEAST_ROWS,
            (&mut residual[..], &mut change[..]),
            |first, (residual, change)| {
                for (n, (residual, change)) in (first..).zip(residual.iter_mut().zip(change)) {
                    *residual = right[n] - values.product(rows, n, solution);
                    *change = inverse[n] * *residual * (1.0 / centre);
                }
            },
        );
        for _ in 0..SMOOTHING_STEPS {
            let next_rho = 1.0 / (2.0 * sigma - rho);
            let lists = ((&mut residual[..], &mut solution[..]), &mut other[..]);
            in_stretches(workers, LEAST_ROWS, lists, |first, ((residual, solution), other)| {
                for (k, n) in (first..first + residual.len()).enumerate() {
                    residual[k] -= values.product(rows, n, change);
                    solution[k] += change[n];
                    other[k] =
                        change[n] * (rho * next_rho) + inverse[n] * residual[k] * (2.0 * next_rho / half);
                }
            });
            std::mem::swap(change, other);
            rho = next_rho;
        }
    }

    /// Overwrites `motion` with the rigid motions of the groups that answer `right`.
    fn move_groups(
        &self,
        [right, motion]: [&mut Vec<Vec3A>; 2],
        small: &mut [f64],
        scratch: &mut FactorScratch,
    ) {
        let Values { arm, follows, .. } = self.values;
        let aggregates = &self.structure.aggregates;
        for (a, sums) in small.chunks_exact_mut(6).enumerate() {
            let (mut force, mut moment) = (Vec3A::ZERO, Vec3A::ZERO);
            for &n in aggregates.members(a) {
                let pull = right[n as usize] * follows[n as usize];
                force += pull;
                moment += arm[n as usize].cross(pull);
            }
            sums[..3].copy_from_slice(&force.as_dvec3().to_array());
            sums[3..].copy_from_slice(&moment.as_dvec3().to_array());
        }
        self.factor.solve_in_place(small, 1, scratch);
        motion.fill(Vec3A::ZERO);
        for (a, of_group) in small.chunks_exact(6).enumerate() {
            let [translation, rotation] =
                [&of_group[..3], &of_group[3..]].map(|v| DVec3::from_slice(v).as_vec3a());
            for &n in aggregates.members(a) {
                let n = n as usize;
                motion[n] = (translation + rotation.cross(arm[n])) * follows[n];
            }
        }
    }
}

#[cfg(test)]
#[path = "two_grid_tests.rs"]
mod tests;
