//! The file of a compliance. All numbers little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `GLISCOMP` |
//! | 4, 4 | format version, bytes of a compliance (8 or 4) |
//! | 32 | [`mesh_hash`] |
//! | 8, 8, 8 | Young's modulus [Pa], Poisson's ratio, density [kg/m3] (f64) |
//! | 8, 8, 8, 8 | numbers (u64): nodes of the mesh, fixed nodes, stored nodes, loadable nodes |
//! | 4 each | fixed nodes, then stored nodes (u32) |
//! | 8 each | response to weight [m per m/s2] (f64): block of eight stored nodes, gravity axis, displacement axis, stored node |
//! | 32 | BLAKE3 of everything before: the head's checksum |
//!
//! then for every 16 loadable nodes, and for the remaining ones,
//!
//! | bytes | what |
//! |---|---|
//! | 8 or 4 each | compliances [m/N] (f64 or f32): loadable node, block of eight stored nodes, force axis, displacement axis, stored node |
//! | 32 | BLAKE3 of the number of the sixteen (u64, from 0) and the compliances, keyed with the head's checksum |
//!
//! So an unfinished file is valid up to its last whole block of sixteen, and no part of another file passes for a part
//! of this one.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use super::build::NODES_IN_BLOCK;
use super::table::{BLOCK_NUMBERS, LANES, Numbers, Precision, Table};
use super::{Compliance, Precomputed, PrecomputedError, StoredNodes};
use crate::material::LinearElastic;
use glisson_mesh::files::write_atomically;
use glisson_mesh::mesh::{NodeId, TetMesh};

const MAGIC: &[u8; 8] = b"GLISCOMP";
const VERSION: u32 = 4;
const FIXED_BYTES: usize = 8 + 8 + 32 + 3 * 8 + 4 * 8;
pub(super) const CHECKSUM_BYTES: usize = 32;

/// What a file must have been computed for.
#[derive(Clone, Copy, Debug)]
pub struct PrecomputedExpectation<'a> {
    /// The body at rest.
    pub mesh: &'a TetMesh,
    /// Its material.
    pub material: &'a LinearElastic,
    /// Nodes that never move, in any order.
    pub fixed_nodes: &'a [NodeId],
}

/// BLAKE3 of a mesh: numbers of nodes and tetrahedra, positions (bits), connectivity.
pub fn mesh_hash(mesh: &TetMesh) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(mesh.positions_m.len() as u64).to_le_bytes());
    hasher.update(&(mesh.tetrahedra.len() as u64).to_le_bytes());
    let mut bytes = Vec::with_capacity(24 * mesh.positions_m.len());
    for p in &mesh.positions_m {
        bytes.extend(p.to_array().into_iter().flat_map(f64::to_le_bytes));
    }
    hasher.update(&bytes);
    bytes.clear();
    for nodes in &mesh.tetrahedra {
        bytes.extend(nodes.iter().flat_map(|n| n.0.to_le_bytes()));
    }
    hasher.update(&bytes);
    *hasher.finalize().as_bytes()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// An entry of a compliance as stored in a file.
pub(super) trait Stored: Copy + Send + Sync + bytemuck::Pod {
    fn narrow(x: f64) -> Self;
    fn is_finite(self) -> bool;
    /// The same with its bytes swapped between little-endian and the machine's order.
    fn swapped(self) -> Self;
}

impl Stored for f64 {
    fn narrow(x: f64) -> Self {
        x
    }
    fn is_finite(self) -> bool {
        self.is_finite()
    }
    fn swapped(self) -> Self {
        Self::from_bits(self.to_bits().to_le())
    }
}

impl Stored for f32 {
    fn narrow(x: f64) -> Self {
        x as Self
    }
    fn is_finite(self) -> bool {
        self.is_finite()
    }
    fn swapped(self) -> Self {
        Self::from_bits(self.to_bits().to_le())
    }
}

/// The head of a file: everything before the compliances.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Head {
    pub(super) precision: Precision,
    pub(super) mesh_hash: [u8; 32],
    pub(super) material: LinearElastic,
    pub(super) n_nodes: usize,
    /// Ascending.
    pub(super) fixed_nodes: Vec<NodeId>,
    pub(super) rows: Vec<NodeId>,
    pub(super) n_loadable: usize,
    pub(super) weight_response_s2: Vec<f64>,
}

/// The key of the checksums of a file's blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BlockKey([u8; 32]);

impl BlockKey {
    fn checksum(&self, block: usize, bytes: &[u8]) -> [u8; CHECKSUM_BYTES] {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher.update(&(block as u64).to_le_bytes());
        hasher.update(bytes);
        *hasher.finalize().as_bytes()
    }
}

/// How much of a file has to be there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Extent {
    Whole,
    /// At least the head.
    Head,
}

/// Errors of a file of `length` bytes.
struct Faults<'a> {
    path: &'a Path,
    length: u64,
}

impl Faults<'_> {
    fn io(&self, cause: io::Error) -> PrecomputedError {
        PrecomputedError::Io { file: self.path.to_owned(), cause }
    }

    fn length(&self, expected: u128) -> PrecomputedError {
        PrecomputedError::Length { file: self.path.to_owned(), found: self.length, expected }
    }

    fn contents(&self, what: &'static str) -> PrecomputedError {
        PrecomputedError::Contents { file: self.path.to_owned(), what }
    }
}

/// What stands at the start of a file, before the lists of the head.
struct Opening {
    precision: Precision,
    mesh_hash: [u8; 32],
    /// Young's modulus [Pa], Poisson's ratio, density [kg/m3].
    material: [f64; 3],
    /// Numbers of nodes of the mesh, fixed nodes, stored nodes, loadable nodes.
    counts: [u64; 4],
}

impl Opening {
    /// Reads the first bytes of a file, which remain in `bytes`.
    fn read(
        faults: &Faults<'_>,
        from: &mut impl Read,
        bytes: &mut Vec<u8>,
    ) -> Result<Self, PrecomputedError> {
        let file = || faults.path.to_owned();
        from.by_ref().take(FIXED_BYTES as u64).read_to_end(bytes).map_err(|cause| faults.io(cause))?;
        if MAGIC.starts_with(bytes) && !bytes.is_empty() {
            // Cut off within the magic number.
            return Err(faults.length((FIXED_BYTES + CHECKSUM_BYTES) as u128));
        }
        if !bytes.starts_with(MAGIC) {
            let found = bytes.iter().take(8).copied().collect();
            return Err(PrecomputedError::Kind { file: file(), found });
        }
        if bytes.len() < FIXED_BYTES {
            return Err(faults.length((FIXED_BYTES + CHECKSUM_BYTES) as u128));
        }
        let mut cursor = Cursor(&bytes[MAGIC.len()..]);
        let version = u32::from_le_bytes(cursor.array());
        if version != VERSION {
            return Err(PrecomputedError::Version { file: file(), found: version, expected: VERSION });
        }
        let number_bytes = u32::from_le_bytes(cursor.array());
        let mesh_hash = cursor.array();
        let material = std::array::from_fn(|_| f64::from_le_bytes(cursor.array()));
        let counts = std::array::from_fn(|_| u64::from_le_bytes(cursor.array()));
        let precision = [Precision::F64, Precision::F32]
            .into_iter()
            .find(|p| p.bytes() as u32 == number_bytes)
            .ok_or_else(|| faults.contents("number of bytes of a compliance"))?;
        Ok(Self { precision, mesh_hash, material, counts })
    }

    /// Bytes of the head; refuses a file of another length.
    fn check_length(&self, faults: &Faults<'_>, extent: Extent) -> Result<u128, PrecomputedError> {
        let [_, n_fixed, n_rows, n_loadable] = self.counts;
        let [head_bytes, file_bytes] =
            extents(self.precision, [n_fixed, n_rows, n_loadable]).unwrap_or([u128::MAX; 2]);
        let length = u128::from(faults.length);
        match extent {
            Extent::Whole if file_bytes != length => Err(faults.length(file_bytes)),
            Extent::Head if head_bytes > length => Err(faults.length(head_bytes)),
            Extent::Whole | Extent::Head => Ok(head_bytes),
        }
    }
}

impl Head {
    /// Numbers in a whole block.
    pub(super) fn numbers_in_block(&self) -> usize {
        NODES_IN_BLOCK * Table::stride(self.rows.len())
    }

    pub(super) fn n_blocks(&self) -> usize {
        self.n_loadable.div_ceil(NODES_IN_BLOCK)
    }

    /// Bytes of the head.
    pub(super) fn n_bytes(&self) -> u64 {
        let n_nodes = self.fixed_nodes.len() + self.rows.len();
        (FIXED_BYTES + 4 * n_nodes + 8 * self.weight_response_s2.len() + CHECKSUM_BYTES) as u64
    }

    /// Bytes of a whole block with its checksum.
    pub(super) fn bytes_of_block(&self) -> u64 {
        (self.precision.bytes() * self.numbers_in_block() + CHECKSUM_BYTES) as u64
    }

    /// The head's bytes, and the key of its blocks.
    pub(super) fn to_bytes(&self) -> (Vec<u8>, BlockKey) {
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend((self.precision.bytes() as u32).to_le_bytes());
        bytes.extend(self.mesh_hash);
        let material = &self.material;
        for number in [material.young_modulus_pa(), material.poisson_ratio(), material.density_kg_per_m3()] {
            bytes.extend(number.to_le_bytes());
        }
        for count in [self.n_nodes, self.fixed_nodes.len(), self.rows.len(), self.n_loadable] {
            bytes.extend((count as u64).to_le_bytes());
        }
        bytes.extend(self.fixed_nodes.iter().chain(&self.rows).flat_map(|node| node.0.to_le_bytes()));
        bytes.extend(self.weight_response_s2.iter().flat_map(|x| x.to_le_bytes()));
        let checksum = *blake3::hash(&bytes).as_bytes();
        bytes.extend(checksum);
        (bytes, BlockKey(checksum))
    }

    /// Reads the head of a file of `length` bytes.
    pub(super) fn read(
        path: &Path,
        from: &mut impl Read,
        length: u64,
        extent: Extent,
    ) -> Result<(Self, BlockKey), PrecomputedError> {
        let faults = Faults { path, length };
        let mut bytes = Vec::new();
        let opening = Opening::read(&faults, from, &mut bytes)?;
        let head_bytes = opening.check_length(&faults, extent)?;
        // At most the file's length, which was checked just now.
        from.take(head_bytes as u64 - FIXED_BYTES as u64)
            .read_to_end(&mut bytes)
            .map_err(|cause| faults.io(cause))?;
        if (bytes.len() as u128) < head_bytes {
            return Err(faults.length(head_bytes));
        }
        let (contents, checksum) = bytes.split_at(bytes.len() - CHECKSUM_BYTES);
        let found = *blake3::hash(contents).as_bytes();
        check(path, found, checksum)?;
        Ok((Self::of(&opening, &contents[FIXED_BYTES..], &faults)?, BlockKey(found)))
    }

    /// The head with the lists that follow its opening.
    fn of(opening: &Opening, lists: &[u8], faults: &Faults<'_>) -> Result<Self, PrecomputedError> {
        let [n_nodes, n_fixed, n_rows, n_loadable] = opening.counts;
        let (n_fixed, stride) = (n_fixed as usize, Table::stride(n_rows as usize));
        let mut cursor = Cursor(lists);
        let fixed_nodes = cursor.nodes(n_fixed);
        let rows = cursor.nodes(n_rows as usize);
        let weight_response_s2: Vec<f64> = (0..stride).map(|_| f64::from_le_bytes(cursor.array())).collect();
        if n_loadable == 0 || n_loadable > n_rows {
            return Err(faults.contents("number of loadable nodes"));
        }
        let n_loadable = n_loadable as usize;
        let ascends = |nodes: &[NodeId]| {
            nodes.windows(2).all(|w| w[0] < w[1]) && nodes.last().is_none_or(|n| u64::from(n.0) < n_nodes)
        };
        if !(ascends(&fixed_nodes) && ascends(&rows[..n_loadable]) && ascends(&rows[n_loadable..])) {
            return Err(faults.contents("node numbers"));
        }
        if !weight_response_s2.iter().all(|x| x.is_finite()) {
            return Err(faults.contents("a response to weight that is not finite"));
        }
        let [young_modulus_pa, poisson_ratio, density_kg_per_m3] = opening.material;
        let material = LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, density_kg_per_m3)
            .map_err(|_| faults.contents("material"))?;
        let n_nodes = usize::try_from(n_nodes).map_err(|_| faults.contents("number of nodes"))?;
        let (precision, mesh_hash) = (opening.precision, opening.mesh_hash);
        Ok(Self {
            precision,
            mesh_hash,
            material,
            n_nodes,
            fixed_nodes,
            rows,
            n_loadable,
            weight_response_s2,
        })
    }

    /// The first difference from a body: its name, what was found, what was expected. The density is not compared.
    pub(super) fn difference(
        &self,
        expected: &PrecomputedExpectation<'_>,
    ) -> Option<(&'static str, String, String)> {
        let wanted = mesh_hash(expected.mesh);
        if self.mesh_hash != wanted {
            return Some(("the mesh with BLAKE3", hex(&self.mesh_hash), hex(&wanted)));
        }
        let describe =
            |m: &LinearElastic| format!("E = {} Pa, nu = {}", m.young_modulus_pa(), m.poisson_ratio());
        let (found, wanted) = (describe(&self.material), describe(expected.material));
        if found != wanted {
            return Some(("the material", found, wanted));
        }
        let mut fixed_nodes = expected.fixed_nodes.to_vec();
        fixed_nodes.sort_unstable();
        fixed_nodes.dedup();
        (self.fixed_nodes != fixed_nodes)
            .then(|| ("the fixed nodes", describe_nodes(&self.fixed_nodes), describe_nodes(&fixed_nodes)))
    }
}

/// Refuses a wrong checksum.
fn check(path: &Path, found: [u8; 32], expected: &[u8]) -> Result<(), PrecomputedError> {
    if found == *expected {
        return Ok(());
    }
    let (found, expected) = (hex(&found), hex(expected));
    Err(PrecomputedError::Checksum { file: path.to_owned(), found, expected })
}

fn describe_nodes(nodes: &[NodeId]) -> String {
    let mut hasher = blake3::Hasher::new();
    for node in nodes {
        hasher.update(&node.0.to_le_bytes());
    }
    let first: Vec<u32> = nodes.iter().take(5).map(|n| n.0).collect();
    format!("{} nodes ({first:?}..., BLAKE3 {})", nodes.len(), &hex(hasher.finalize().as_bytes())[..16])
}

/// Bytes of the head and of the whole file with these numbers of fixed, stored and loadable nodes, unless they
/// overflow.
fn extents(precision: Precision, [n_fixed, n_rows, n_loadable]: [u64; 3]) -> Option<[u128; 2]> {
    let wide = u128::from;
    let stride = wide(n_rows.div_ceil(LANES as u64)).checked_mul(BLOCK_NUMBERS as u128)?;
    let table = stride.checked_mul(wide(n_loadable))?.checked_mul(precision.bytes() as u128)?;
    let nodes = 4 * (wide(n_fixed) + wide(n_rows));
    let head = (FIXED_BYTES + CHECKSUM_BYTES) as u128 + nodes + 8 * stride;
    let checksums = wide(n_loadable.div_ceil(NODES_IN_BLOCK as u64)) * CHECKSUM_BYTES as u128;
    Some([head, head.checked_add(table)?.checked_add(checksums)?])
}

/// Writes blocks with their checksums, the first of them number `first_block`.
pub(super) fn write_blocks<T: Stored>(
    to: &mut impl Write,
    key: &BlockKey,
    first_block: usize,
    numbers_in_block: usize,
    numbers: &[T],
) -> io::Result<()> {
    for (i, block) in numbers.chunks(numbers_in_block).enumerate() {
        let swapped: Vec<T>;
        let bytes: &[u8] = if cfg!(target_endian = "little") {
            bytemuck::cast_slice(block)
        } else {
            swapped = block.iter().map(|x| x.swapped()).collect();
            bytemuck::cast_slice(&swapped)
        };
        to.write_all(bytes)?;
        to.write_all(&key.checksum(first_block + i, bytes))?;
    }
    Ok(())
}

/// Reads one block over `numbers` and checks it.
pub(super) fn read_block<T: Stored>(
    path: &Path,
    from: &mut impl Read,
    key: &BlockKey,
    block: usize,
    numbers: &mut [T],
) -> Result<(), PrecomputedError> {
    let io_error = |cause| PrecomputedError::Io { file: path.to_owned(), cause };
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(numbers);
    from.read_exact(bytes).map_err(io_error)?;
    let found = key.checksum(block, bytes);
    let mut expected = [0; CHECKSUM_BYTES];
    from.read_exact(&mut expected).map_err(io_error)?;
    check(path, found, &expected)?;
    if cfg!(target_endian = "big") {
        numbers.iter_mut().for_each(|x| *x = x.swapped());
    }
    if numbers.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    Err(PrecomputedError::Contents { file: path.to_owned(), what: "a compliance that is not finite" })
}

impl Precomputed {
    /// Writes the compliance; returns the number of bytes. Same bytes as [`super::precompute_to_file`].
    ///
    /// # Errors
    /// [`PrecomputedError::Io`], [`PrecomputedError::Cut`]; an old file of that name then remains untouched.
    pub fn save(&self, path: &Path) -> Result<u64, PrecomputedError> {
        if self.is_cut() {
            return Err(PrecomputedError::Cut { file: path.to_owned() });
        }
        let io_error = |cause| PrecomputedError::Io { file: path.to_owned(), cause };
        let Compliance { material, fixed_nodes, rows, n_loadable, mesh_hash, table, weight_response_s2 } =
            &self.compliance;
        let head = Head {
            precision: table.precision(),
            mesh_hash: *mesh_hash,
            material: *material,
            n_nodes: self.rest_m.len(),
            fixed_nodes: fixed_nodes.clone(),
            rows: rows.clone(),
            n_loadable: *n_loadable,
            weight_response_s2: weight_response_s2.clone(),
        };
        write_atomically(path, |w| {
            let (bytes, key) = head.to_bytes();
            w.write_all(&bytes)?;
            match &table.numbers {
                Numbers::F64(numbers) => write_blocks(w, &key, 0, head.numbers_in_block(), numbers),
                Numbers::F32(numbers) => write_blocks(w, &key, 0, head.numbers_in_block(), numbers),
            }
        })
        .map_err(io_error)?;
        Ok(std::fs::metadata(path).map_err(io_error)?.len())
    }

    /// Reads a compliance, and refuses one of another mesh, material or support. Takes no more memory than the compliance:
    /// the numbers are read in place.
    ///
    /// # Errors
    /// [`PrecomputedError`] naming the file, what was found and what was expected.
    pub fn load(path: &Path, expected: &PrecomputedExpectation<'_>) -> Result<Self, PrecomputedError> {
        let io_error = |cause| PrecomputedError::Io { file: path.to_owned(), cause };
        let mut file = File::open(path).map_err(io_error)?;
        let length = file.metadata().map_err(io_error)?.len();
        read(path, &mut file, length, expected)
    }

    /// Which nodes a file stores and in which precision, from its head alone; for a re-computation with the same settings.
    ///
    /// # Errors
    /// [`PrecomputedError`] when its head cannot be read.
    pub fn kept_in(path: &Path) -> Result<(StoredNodes, Precision), PrecomputedError> {
        let io_error = |cause| PrecomputedError::Io { file: path.to_owned(), cause };
        let mut file = File::open(path).map_err(io_error)?;
        let length = file.metadata().map_err(io_error)?.len();
        let (head, _) = Head::read(path, &mut file, length, Extent::Head)?;
        let has_inner = head.rows.len() > head.n_loadable;
        Ok((if has_inner { StoredNodes::All } else { StoredNodes::Surface }, head.precision))
    }

    /// [`Precomputed::load`] from the bytes of a file; `path` only names it in errors.
    ///
    /// # Errors
    /// [`PrecomputedError`] naming the file, what was found and what was expected.
    pub fn from_bytes(
        path: &Path,
        mut bytes: &[u8],
        expected: &PrecomputedExpectation<'_>,
    ) -> Result<Self, PrecomputedError> {
        let length = bytes.len() as u64;
        read(path, &mut bytes, length, expected)
    }
}

fn read(
    path: &Path,
    from: &mut impl Read,
    length: u64,
    expected: &PrecomputedExpectation<'_>,
) -> Result<Precomputed, PrecomputedError> {
    let (head, key) = Head::read(path, from, length, Extent::Whole)?;
    if let Some((what, found, expected)) = head.difference(expected) {
        return Err(PrecomputedError::Mismatch { file: path.to_owned(), what, found, expected });
    }
    if head.n_nodes != expected.mesh.positions_m.len() {
        return Err(PrecomputedError::Contents { file: path.to_owned(), what: "number of nodes" });
    }
    let (n_rows, n_loadable) = (head.rows.len(), head.n_loadable);
    let bytes = Table::bytes(head.precision, n_rows, n_loadable);
    let mut table = Table::zeros(head.precision, n_rows, n_loadable).ok_or(PrecomputedError::Memory {
        n_loadable,
        n_rows,
        bytes,
    })?;
    let numbers_in_block = head.numbers_in_block();
    match &mut table.numbers {
        Numbers::F64(numbers) => read_blocks(path, from, &key, numbers_in_block, numbers)?,
        Numbers::F32(numbers) => read_blocks(path, from, &key, numbers_in_block, numbers)?,
    }
    // The density may differ: only the response to weight depends on it, in proportion.
    let heavier = expected.material.density_kg_per_m3() / head.material.density_kg_per_m3();
    let mut weight_response_s2 = head.weight_response_s2;
    weight_response_s2.iter_mut().for_each(|u| *u *= heavier);
    let compliance = Compliance {
        material: *expected.material,
        fixed_nodes: head.fixed_nodes,
        rows: head.rows,
        n_loadable,
        mesh_hash: head.mesh_hash,
        table,
        weight_response_s2,
    };
    Ok(Precomputed::new(compliance, expected.mesh))
}

fn read_blocks<T: Stored>(
    path: &Path,
    from: &mut impl Read,
    key: &BlockKey,
    numbers_in_block: usize,
    numbers: &mut [T],
) -> Result<(), PrecomputedError> {
    let mut blocks = numbers.chunks_mut(numbers_in_block).enumerate();
    blocks.try_for_each(|(block, numbers)| read_block(path, from, key, block, numbers))
}

/// Bytes taken from the front; their number was checked before.
struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn take(&mut self, n: usize) -> &'a [u8] {
        let (front, rest) = self.0.split_at(n);
        self.0 = rest;
        front
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        self.take(N).try_into().expect("took as many bytes")
    }

    fn nodes(&mut self, n: usize) -> Vec<NodeId> {
        let bytes = self.take(4 * n);
        bytes
            .chunks_exact(4)
            .map(|b| NodeId(u32::from_le_bytes(b.try_into().expect("chunks of four"))))
            .collect()
    }
}
