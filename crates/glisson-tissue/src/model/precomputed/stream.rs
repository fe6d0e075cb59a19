//! Writes a compliance to a file while it is computed: for bodies whose compliance does not fit in memory, and so that an
//! interruption loses nothing.
//!
//! The file grows as `FILE.partial`, block after block in order. While some blocks are computed, those before them are
//! written; only these two batches are in memory. At the end the file is renamed. After an interruption the unfinished
//! file is checked block by block and continued, to the same bits.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::build::{NODES_IN_BLOCK, Plan, Solver};
use super::file::{
    BlockKey, Extent, Head, PrecomputedExpectation, Stored, mesh_hash, read_block, write_blocks,
};
use super::table::{Precision, Table};
use super::{PrecomputedError, PrecomputedParams};
use crate::material::LinearElastic;

/// Options of writing.
#[derive(Clone, Copy, Default)]
pub struct StreamOptions<'a> {
    /// Whether to overwrite an unfinished file instead of continuing it.
    pub restart: bool,
    /// Called between blocks: whether to stop. Finished blocks stay in the unfinished file.
    pub stop: Option<&'a (dyn Fn() -> bool + Sync)>,
}

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamSummary {
    /// Nodes that forces can act on.
    pub n_loadable: usize,
    /// Nodes whose displacements are stored.
    pub n_stored: usize,
    /// Loadable nodes that an earlier, interrupted pre-computation had done.
    pub n_resumed: usize,
    /// Length of the file.
    pub n_bytes: u64,
}

/// Blocks per thread in one of the two batches in memory: enough for threads to finish together.
const BLOCKS_PER_THREAD: usize = 2;

/// Path of the unfinished file.
pub fn partial_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".partial");
    name.into()
}

/// Computes a compliance into the file `path`, as [`super::Precomputed::load`] reads it. Runs on the threads of the
/// rayon pool it is called in; the bytes do not depend on their number, nor on interruptions. Memory: the factor, and
/// four blocks of 16 loadable nodes a thread.
///
/// # Errors
/// [`PrecomputedError::Solve`] and [`PrecomputedError::NothingLoadable`] before anything is written;
/// [`PrecomputedError::Stopped`] and [`PrecomputedError::Unfinished`] leave what is done in `FILE.partial`, with which
/// the next call goes on; [`PrecomputedError::OtherPartial`], [`PrecomputedError::BadPartial`] and
/// [`PrecomputedError::Busy`] when that is in the way; [`PrecomputedError::Io`]. An old file `path` is untouched until
/// the new one is complete.
pub fn precompute_to_file(
    params: &PrecomputedParams<'_>,
    path: &Path,
    options: &StreamOptions<'_>,
) -> Result<StreamSummary, PrecomputedError> {
    let plan = Plan::new(params)?;
    let partial = partial_path(path);
    let mut growing = Growing::open(params, &plan, &partial, options.restart)?;
    let n_resumed = growing.n_nodes();
    if growing.head.is_none() || n_resumed < plan.n_loadable {
        let solver = plan.factorize().inspect_err(|_| growing.leave_nothing_empty())?;
        growing.begin(params, &plan, &solver)?;
        solver.skip(n_resumed, params);
        match params.precision {
            Precision::F64 => growing.compute::<f64>(params, &solver, options)?,
            Precision::F32 => growing.compute::<f32>(params, &solver, options)?,
        }
    }
    growing.file.sync_all().map_err(|cause| growing.unfinished(cause))?;
    let n_bytes = growing.file.metadata().map_err(|cause| growing.unfinished(cause))?.len();
    std::fs::rename(&partial, path).map_err(|cause| growing.unfinished(cause))?;
    Ok(StreamSummary { n_loadable: plan.n_loadable, n_stored: plan.rows.len(), n_resumed, n_bytes })
}

/// The unfinished file.
struct Growing<'a> {
    partial: &'a Path,
    file: File,
    n_loadable: usize,
    /// Its head, once it has one.
    head: Option<(Head, BlockKey)>,
    /// Blocks in it.
    n_blocks: usize,
}

impl<'a> Growing<'a> {
    /// Opens the unfinished file, truncated after its last good block, or an empty one.
    fn open(
        params: &PrecomputedParams<'_>,
        plan: &Plan,
        partial: &'a Path,
        restart: bool,
    ) -> Result<Self, PrecomputedError> {
        let io_error = |cause| PrecomputedError::Io { file: partial.to_owned(), cause };
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(partial)
            .map_err(io_error)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(PrecomputedError::Busy { partial: partial.to_owned() });
            }
            // A file system without locks.
            Err(TryLockError::Error(_)) => {}
        }
        let mut growing = Self { partial, file, n_loadable: plan.n_loadable, head: None, n_blocks: 0 };
        let length = growing.file.metadata().map_err(io_error)?.len();
        if length > 0 && restart {
            growing.file.set_len(0).map_err(io_error)?;
        }
        if length == 0 || restart {
            return Ok(growing);
        }
        growing.read(length).map_err(|cause| PrecomputedError::BadPartial { cause: Box::new(cause) })?;
        if let Some((head, _)) = &growing.head {
            refuse_other(head, params, plan, partial)?;
        }
        growing.cut_off().map_err(io_error)?;
        Ok(growing)
    }

    /// Reads head and good blocks.
    fn read(&mut self, length: u64) -> Result<(), PrecomputedError> {
        let mut from = BufReader::with_capacity(1 << 20, &self.file);
        let (head, key) = match Head::read(self.partial, &mut from, length, Extent::Head) {
            Ok(found) => found,
            // Interrupted before the first block: nothing is lost.
            Err(PrecomputedError::Length { .. }) => return Ok(()),
            Err(other) => return Err(other),
        };
        let n_blocks = match head.precision {
            Precision::F64 => good_blocks::<f64>(self.partial, &mut from, &head, &key)?,
            Precision::F32 => good_blocks::<f32>(self.partial, &mut from, &head, &key)?,
        };
        (self.head, self.n_blocks) = (Some((head, key)), n_blocks);
        Ok(())
    }

    /// Bytes up to the last good block.
    fn n_bytes(&self) -> u64 {
        self.head.as_ref().map_or(0, |(head, _)| {
            let missing = (self.n_blocks * NODES_IN_BLOCK).saturating_sub(head.n_loadable);
            let missing_bytes = missing * Table::stride(head.rows.len()) * head.precision.bytes();
            head.n_bytes() + self.n_blocks as u64 * head.bytes_of_block() - missing_bytes as u64
        })
    }

    /// Truncates the file after the last good block, and seeks to its end.
    fn cut_off(&mut self) -> io::Result<()> {
        let n_bytes = self.n_bytes();
        if self.file.metadata()?.len() > n_bytes {
            self.file.set_len(n_bytes)?;
        }
        self.file.seek(SeekFrom::Start(n_bytes)).map(|_| ())
    }

    /// Loadable nodes in it.
    fn n_nodes(&self) -> usize {
        (self.n_blocks * NODES_IN_BLOCK).min(self.n_loadable)
    }

    fn unfinished(&self, cause: io::Error) -> PrecomputedError {
        let (partial, done, total) = (self.partial.to_owned(), self.n_nodes(), self.n_loadable);
        PrecomputedError::Unfinished { partial, done, total, cause }
    }

    /// Removes an empty file.
    fn leave_nothing_empty(&self) {
        if self.head.is_none() {
            // The error that led here is the one that is reported.
            let _ = std::fs::remove_file(self.partial);
        }
    }

    /// Writes the head unless there is one.
    fn begin(
        &mut self,
        params: &PrecomputedParams<'_>,
        plan: &Plan,
        solver: &Solver,
    ) -> Result<(), PrecomputedError> {
        if self.head.is_some() {
            return Ok(());
        }
        let head = Head {
            precision: params.precision,
            mesh_hash: mesh_hash(params.mesh),
            material: *params.material,
            n_nodes: params.mesh.positions_m.len(),
            fixed_nodes: plan.fixed_nodes.clone(),
            rows: plan.rows.clone(),
            n_loadable: plan.n_loadable,
            weight_response_s2: plan.weight_response_s2(params, solver),
        };
        let (bytes, key) = head.to_bytes();
        let written = self.file.seek(SeekFrom::Start(0)).and_then(|_| self.file.write_all(&bytes));
        written.map_err(|cause| self.unfinished(cause))?;
        self.head = Some((head, key));
        Ok(())
    }

    /// Computes and writes the missing blocks: one batch is written while the next is computed.
    fn compute<T: Stored>(
        &mut self,
        params: &PrecomputedParams<'_>,
        solver: &Solver,
        options: &StreamOptions<'_>,
    ) -> Result<(), PrecomputedError> {
        let (head, key) = self.head.clone().expect("the head is written first");
        let numbers_in_block = head.numbers_in_block();
        let stride = Table::stride(head.rows.len());
        let blocks_in_lot = BLOCKS_PER_THREAD * rayon::current_num_threads();
        let zero = T::narrow(0.0);
        let mut lots = [(); 2].map(|()| Vec::<T>::new());
        for lot in &mut lots {
            let n_numbers = numbers_in_block * blocks_in_lot.min(head.n_blocks() - self.n_blocks);
            lot.try_reserve_exact(n_numbers).map_err(|_| PrecomputedError::Memory {
                n_loadable: NODES_IN_BLOCK * blocks_in_lot,
                n_rows: head.rows.len(),
                bytes: Table::bytes(head.precision, head.rows.len(), NODES_IN_BLOCK * blocks_in_lot),
            })?;
            lot.resize(n_numbers, zero);
        }
        let [mut ready, mut next] = lots;
        // Numbers in `ready` that are not written yet.
        let mut n_ready = 0;
        let mut first_node = self.n_nodes();
        loop {
            let stops = options.stop.is_some_and(|stop| stop());
            let nodes_left = if stops { 0 } else { self.n_loadable - first_node };
            let n_next = stride * nodes_left.min(NODES_IN_BLOCK * blocks_in_lot);
            let (written, ()) = rayon::join(
                || write_blocks(&mut self.file, &key, self.n_blocks, numbers_in_block, &ready[..n_ready]),
                || {
                    if n_next > 0 {
                        solver.fill(params, first_node, &mut next[..n_next], T::narrow);
                    }
                },
            );
            written.map_err(|cause| self.unfinished(cause))?;
            self.n_blocks += n_ready.div_ceil(numbers_in_block);
            if n_next == 0 {
                break;
            }
            (n_ready, first_node) = (n_next, first_node + n_next / stride);
            std::mem::swap(&mut ready, &mut next);
        }
        if self.n_nodes() < self.n_loadable {
            let (partial, done, total) = (self.partial.to_owned(), self.n_nodes(), self.n_loadable);
            return Err(PrecomputedError::Stopped { partial, done, total });
        }
        Ok(())
    }
}

/// Whole blocks with the right checksum, from the first on.
fn good_blocks<T: Stored>(
    path: &Path,
    from: &mut impl io::Read,
    head: &Head,
    key: &BlockKey,
) -> Result<usize, PrecomputedError> {
    let numbers_in_block = head.numbers_in_block();
    let mut numbers: Vec<T> = Vec::new();
    for block in 0..head.n_blocks() {
        let n_nodes = (head.n_loadable - block * NODES_IN_BLOCK).min(NODES_IN_BLOCK);
        numbers.resize(numbers_in_block / NODES_IN_BLOCK * n_nodes, T::narrow(0.0));
        match read_block(path, from, key, block, &mut numbers) {
            Ok(()) => {}
            Err(PrecomputedError::Io { cause, .. }) if cause.kind() == io::ErrorKind::UnexpectedEof => {
                return Ok(block);
            }
            Err(PrecomputedError::Checksum { .. }) => return Ok(block),
            Err(other) => return Err(other),
        }
    }
    Ok(head.n_blocks())
}

/// Refuses a head that differs from that of this pre-computation.
fn refuse_other(
    head: &Head,
    params: &PrecomputedParams<'_>,
    plan: &Plan,
    partial: &Path,
) -> Result<(), PrecomputedError> {
    let PrecomputedParams { mesh, material, fixed_nodes, precision, .. } = *params;
    let difference = head.difference(&PrecomputedExpectation { mesh, material, fixed_nodes }).or_else(|| {
        let density = |m: &LinearElastic| format!("{} kg/m3", m.density_kg_per_m3());
        let stored = |n: usize| n.to_string();
        let bytes = |p: Precision| p.bytes().to_string();
        [
            ("the density", density(&head.material), density(material)),
            ("a number of stored nodes of", stored(head.rows.len()), stored(plan.rows.len())),
            ("compliances of as many bytes as", bytes(head.precision), bytes(precision)),
        ]
        .into_iter()
        .find(|(_, found, expected)| found != expected)
    });
    let Some((what, found, expected)) = difference else { return Ok(()) };
    Err(PrecomputedError::OtherPartial { partial: partial.to_owned(), what, found, expected })
}
