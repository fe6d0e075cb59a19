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
//! | 8 or 4 each | compliances [m/N] (f64 or f32): loadable node, block of eight stored nodes, force axis, displacement axis, stored node |
//! | 8 each | response to weight [m per m/s2] (f64): block, gravity axis, displacement axis, stored node |
//! | 32 | BLAKE3 of everything before |

use std::io::{self, Write};
use std::path::Path;

use super::table::{BLOCK_NUMBERS, LANES, Numbers, Precision, Table};
use super::{Compliance, Precomputed, PrecomputedError};
use crate::files::write_atomically;
use crate::material::LinearElastic;
use crate::mesh::{NodeId, TetMesh};

const MAGIC: &[u8; 8] = b"GLISCOMP";
const VERSION: u32 = 3;
const HEADER_BYTES: usize = 8 + 8 + 32 + 3 * 8 + 4 * 8;
const CHECKSUM_BYTES: usize = 32;

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

/// Writes and hashes.
struct Hashing<W> {
    inner: W,
    hasher: blake3::Hasher,
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.inner.write(bytes)?;
        self.hasher.update(&bytes[..n]);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl Precomputed {
    /// Writes the compliance; answers the number of bytes.
    ///
    /// # Errors
    /// [`PrecomputedError::Io`], [`PrecomputedError::Cut`]; an old file of that name then remains untouched.
    pub fn save(&self, path: &Path) -> Result<u64, PrecomputedError> {
        if self.is_cut() {
            return Err(PrecomputedError::Cut { file: path.to_owned() });
        }
        let io_error = |cause| PrecomputedError::Io { file: path.to_owned(), cause };
        write_atomically(path, |w| write(&self.compliance, self.rest_m.len(), w)).map_err(io_error)?;
        Ok(std::fs::metadata(path).map_err(io_error)?.len())
    }

    /// Reads a compliance and refuses one of another mesh, material or support.
    ///
    /// # Errors
    /// [`PrecomputedError`] naming the file, what was found and what was expected.
    pub fn load(path: &Path, expected: &PrecomputedExpectation<'_>) -> Result<Self, PrecomputedError> {
        let bytes =
            std::fs::read(path).map_err(|cause| PrecomputedError::Io { file: path.to_owned(), cause })?;
        Self::from_bytes(path, &bytes, expected)
    }

    /// [`Precomputed::load`] from the bytes of a file; `path` only names it in errors.
    ///
    /// # Errors
    /// [`PrecomputedError`] naming the file, what was found and what was expected.
    pub fn from_bytes(
        path: &Path,
        bytes: &[u8],
        expected: &PrecomputedExpectation<'_>,
    ) -> Result<Self, PrecomputedError> {
        let (mut compliance, n_nodes) = parse(path, bytes)?;
        let mismatch = |what, found: String, expected: String| {
            Err(PrecomputedError::Mismatch { file: path.to_owned(), what, found, expected })
        };
        let wanted = mesh_hash(expected.mesh);
        if compliance.mesh_hash != wanted {
            return mismatch("the mesh with BLAKE3", hex(&compliance.mesh_hash), hex(&wanted));
        }
        let describe =
            |m: &LinearElastic| format!("E = {} Pa, nu = {}", m.young_modulus_pa(), m.poisson_ratio());
        let (found, wanted) = (describe(&compliance.material), describe(expected.material));
        if found != wanted {
            return mismatch("the material", found, wanted);
        }
        let mut fixed_nodes = expected.fixed_nodes.to_vec();
        fixed_nodes.sort_unstable();
        fixed_nodes.dedup();
        if compliance.fixed_nodes != fixed_nodes {
            return mismatch(
                "the fixed nodes",
                describe_nodes(&compliance.fixed_nodes),
                describe_nodes(&fixed_nodes),
            );
        }
        if n_nodes != expected.mesh.positions_m.len() as u64 {
            return Err(PrecomputedError::Contents { file: path.to_owned(), what: "number of nodes" });
        }
        // The density may differ: all that it enters is the response to weight, in proportion.
        let heavier = expected.material.density_kg_per_m3() / compliance.material.density_kg_per_m3();
        compliance.weight_response_s2.iter_mut().for_each(|u| *u *= heavier);
        compliance.material = *expected.material;
        Ok(Self::new(compliance, expected.mesh))
    }
}

fn describe_nodes(nodes: &[NodeId]) -> String {
    let mut hasher = blake3::Hasher::new();
    for node in nodes {
        hasher.update(&node.0.to_le_bytes());
    }
    let first: Vec<u32> = nodes.iter().take(5).map(|n| n.0).collect();
    format!("{} nodes ({first:?}..., BLAKE3 {})", nodes.len(), &hex(hasher.finalize().as_bytes())[..16])
}

fn write(compliance: &Compliance, n_nodes: usize, to: &mut impl Write) -> io::Result<()> {
    let mut w = Hashing { inner: to, hasher: blake3::Hasher::new() };
    w.write_all(MAGIC)?;
    w.write_all(&VERSION.to_le_bytes())?;
    w.write_all(&(compliance.table.precision().bytes() as u32).to_le_bytes())?;
    w.write_all(&compliance.mesh_hash)?;
    let material = &compliance.material;
    for number in [material.young_modulus_pa(), material.poisson_ratio(), material.density_kg_per_m3()] {
        w.write_all(&number.to_le_bytes())?;
    }
    for count in [n_nodes, compliance.fixed_nodes.len(), compliance.rows.len(), compliance.n_loadable] {
        w.write_all(&(count as u64).to_le_bytes())?;
    }
    for node in compliance.fixed_nodes.iter().chain(&compliance.rows) {
        w.write_all(&node.0.to_le_bytes())?;
    }
    match &compliance.table.numbers {
        Numbers::F64(numbers) => write_numbers(&mut w, numbers, |x| x.to_le_bytes())?,
        Numbers::F32(numbers) => write_numbers(&mut w, numbers, |x| x.to_le_bytes())?,
    }
    write_numbers(&mut w, &compliance.weight_response_s2, |x| x.to_le_bytes())?;
    let checksum = *w.hasher.finalize().as_bytes();
    w.inner.write_all(&checksum)
}

fn write_numbers<T: Copy + bytemuck::NoUninit, const N: usize>(
    w: &mut impl Write,
    numbers: &[T],
    bytes: impl Fn(T) -> [u8; N],
) -> io::Result<()> {
    if cfg!(target_endian = "little") {
        return w.write_all(bytemuck::cast_slice(numbers));
    }
    numbers.iter().try_for_each(|&number| w.write_all(&bytes(number)))
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

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.array())
    }

    fn numbers(&mut self, n: usize) -> Vec<f64> {
        let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("chunks of eight"));
        self.take(8 * n).chunks_exact(8).map(number).collect()
    }

    fn short_numbers(&mut self, n: usize) -> Vec<f32> {
        let number = |b: &[u8]| f32::from_le_bytes(b.try_into().expect("chunks of four"));
        self.take(4 * n).chunks_exact(4).map(number).collect()
    }

    fn nodes(&mut self, n: usize) -> Vec<NodeId> {
        let bytes = self.take(4 * n);
        bytes
            .chunks_exact(4)
            .map(|b| NodeId(u32::from_le_bytes(b.try_into().expect("chunks of four"))))
            .collect()
    }
}

/// The compliance in `bytes` and the number of nodes of its mesh.
fn parse(path: &Path, bytes: &[u8]) -> Result<(Compliance, u64), PrecomputedError> {
    let file = || path.to_owned();
    if !bytes.starts_with(MAGIC) {
        return Err(PrecomputedError::Kind { file: file(), found: bytes.iter().take(8).copied().collect() });
    }
    let least = HEADER_BYTES + CHECKSUM_BYTES;
    let length_error =
        |expected| PrecomputedError::Length { file: file(), found: bytes.len() as u64, expected };
    if bytes.len() < least {
        return Err(length_error(least as u128));
    }
    let mut cursor = Cursor(&bytes[MAGIC.len()..]);
    let version = u32::from_le_bytes(cursor.array());
    if version != VERSION {
        return Err(PrecomputedError::Version { file: file(), found: version, expected: VERSION });
    }
    let number_bytes = u32::from_le_bytes(cursor.array());
    let mesh_hash = cursor.array();
    let [young_modulus_pa, poisson_ratio, density_kg_per_m3] = std::array::from_fn(|_| cursor.f64());
    let [n_nodes, n_fixed, n_rows, n_loadable] = std::array::from_fn(|_| cursor.u64());
    let precision =
        [Precision::F64, Precision::F32]
            .into_iter()
            .find(|p| p.bytes() as u32 == number_bytes)
            .ok_or(PrecomputedError::Contents { file: file(), what: "number of bytes of a compliance" })?;
    let expected = file_bytes(precision, [n_fixed, n_rows, n_loadable]).unwrap_or(u128::MAX);
    if expected != bytes.len() as u128 {
        return Err(length_error(expected));
    }
    let (contents, checksum) = bytes.split_at(bytes.len() - CHECKSUM_BYTES);
    let found = blake3::hash(contents);
    if found.as_bytes() != checksum {
        return Err(PrecomputedError::Checksum {
            file: file(),
            found: hex(found.as_bytes()),
            expected: hex(checksum),
        });
    }
    let contents_error = |what| PrecomputedError::Contents { file: file(), what };
    let (n_fixed, n_rows, n_loadable) = (n_fixed as usize, n_rows as usize, n_loadable as usize);
    let fixed_nodes = cursor.nodes(n_fixed);
    let rows = cursor.nodes(n_rows);
    if n_loadable == 0 || n_loadable > n_rows {
        return Err(contents_error("number of loadable nodes"));
    }
    let ascends = |nodes: &[NodeId]| {
        nodes.windows(2).all(|w| w[0] < w[1]) && nodes.last().is_none_or(|n| u64::from(n.0) < n_nodes)
    };
    if !(ascends(&fixed_nodes) && ascends(&rows[..n_loadable]) && ascends(&rows[n_loadable..])) {
        return Err(contents_error("node numbers"));
    }
    let material = LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, density_kg_per_m3)
        .map_err(|_| contents_error("material"))?;
    let stride = Table::stride(n_rows);
    let numbers = match precision {
        Precision::F64 => Numbers::F64(cursor.numbers(stride * n_loadable)),
        Precision::F32 => Numbers::F32(cursor.short_numbers(stride * n_loadable)),
    };
    let weight_response_s2 = cursor.numbers(stride);
    let table = Table::of_numbers(n_rows, numbers);
    if !(table.is_finite() && weight_response_s2.iter().all(|x| x.is_finite())) {
        return Err(contents_error("a compliance that is not finite"));
    }
    let compliance =
        Compliance { material, fixed_nodes, rows, n_loadable, mesh_hash, table, weight_response_s2 };
    Ok((compliance, n_nodes))
}

/// Length of a file with these numbers of fixed, stored and loadable nodes, unless it overflows.
fn file_bytes(precision: Precision, [n_fixed, n_rows, n_loadable]: [u64; 3]) -> Option<u128> {
    let wide = u128::from;
    let stride = wide(n_rows.div_ceil(LANES as u64)).checked_mul(BLOCK_NUMBERS as u128)?;
    let table = stride.checked_mul(wide(n_loadable))?.checked_mul(precision.bytes() as u128)?;
    let nodes = 4 * (wide(n_fixed) + wide(n_rows));
    table.checked_add(8 * stride + nodes + (HEADER_BYTES + CHECKSUM_BYTES) as u128)
}
