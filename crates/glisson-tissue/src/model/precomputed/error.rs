//! Errors of the pre-computed model and its file.

use std::path::PathBuf;

use crate::solve::SolveError;

/// Why a pre-computed model cannot be built or read.
#[derive(Debug, thiserror::Error)]
pub enum PrecomputedError {
    /// The mesh with its fixed nodes has no solution.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// Every node of the surface is fixed.
    #[error("all {n_surface} nodes of the surface are fixed: nothing is left to push")]
    NothingLoadable {
        /// Number of nodes on the surface.
        n_surface: usize,
    },
    /// The compliance does not fit in memory.
    #[error(
        "the compliance of {n_loadable} loadable times {n_rows} stored nodes needs {bytes} bytes of memory"
    )]
    Memory {
        /// Number of nodes that can be loaded.
        n_loadable: usize,
        /// Number of nodes whose displacement is stored.
        n_rows: usize,
        /// What that takes.
        bytes: u128,
    },
    /// A file cannot be read or written.
    #[error("{}: {cause}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Another kind of file.
    #[error("{}: not a pre-computed compliance (it starts with {found:02x?}, expected \"GLISCOMP\")", file.display())]
    Kind {
        /// Which file.
        file: PathBuf,
        /// Its first bytes.
        found: Vec<u8>,
    },
    /// Another version of the format.
    #[error("{}: format version {found}, this program reads version {expected}: pre-compute again", file.display())]
    Version {
        /// Which file.
        file: PathBuf,
        /// Its version.
        found: u32,
        /// The version that is read.
        expected: u32,
    },
    /// The file's length is not what its header says.
    #[error("{}: {found} bytes, but its header asks for {expected}: cut off or damaged; pre-compute again", file.display())]
    Length {
        /// Which file.
        file: PathBuf,
        /// Bytes in the file.
        found: u64,
        /// Bytes that the header asks for.
        expected: u128,
    },
    /// The contents are not those that were written.
    #[error("{}: checksum {found}, the file says {expected}: damaged; pre-compute again", file.display())]
    Checksum {
        /// Which file.
        file: PathBuf,
        /// BLAKE3 of the contents.
        found: String,
        /// BLAKE3 at the end of the file.
        expected: String,
    },
    /// The file belongs to another mesh, material or support.
    #[error("{}: made for {what} {found}, but the scene has {expected}: pre-compute again", file.display())]
    Mismatch {
        /// Which file.
        file: PathBuf,
        /// What differs.
        what: &'static str,
        /// What the file was made for.
        found: String,
        /// What is wanted.
        expected: String,
    },
    /// The compliance followed cuts: it belongs to no mesh that a file could name.
    #[error("{}: not written: the compliance followed cuts; pre-compute the cut mesh and save that", file.display())]
    Cut {
        /// Which file.
        file: PathBuf,
    },
    /// A number in the file is impossible although the checksum holds.
    #[error("{}: {what}: not written by this program", file.display())]
    Contents {
        /// Which file.
        file: PathBuf,
        /// Which number.
        what: &'static str,
    },
    /// The file could not be written to its end: the disk is full, for example.
    #[error(
        "{}: {cause}. {done} of {total} nodes are kept there: make room and do the same again to go on", partial.display()
    )]
    Unfinished {
        /// The file with what was finished.
        partial: PathBuf,
        /// Loadable nodes in it.
        done: usize,
        /// Loadable nodes in all.
        total: usize,
        /// What the system says.
        cause: std::io::Error,
    },
    /// The pre-computation was stopped on request.
    #[error(
        "stopped after {done} of {total} nodes, which are kept in {}: do the same again to go on", partial.display()
    )]
    Stopped {
        /// The file with what was finished.
        partial: PathBuf,
        /// Loadable nodes in it.
        done: usize,
        /// Loadable nodes in all.
        total: usize,
    },
    /// An unfinished file is there, of another body.
    #[error(
        "{}: left by an interrupted pre-computation with {what} {found}; asked for now: {expected}. Do that one again \
         to go on with it, or start over (--restart), which overwrites it", partial.display()
    )]
    OtherPartial {
        /// The unfinished file.
        partial: PathBuf,
        /// What differs.
        what: &'static str,
        /// What the unfinished file is for.
        found: String,
        /// What is wanted.
        expected: String,
    },
    /// An unfinished file is there, and cannot be read.
    #[error(
        "{cause}. It is the rest of an interrupted pre-computation: start over (--restart), which overwrites it"
    )]
    BadPartial {
        /// Why.
        cause: Box<PrecomputedError>,
    },
    /// Another program is writing the same file.
    #[error("{}: another program is writing it; wait for it, or choose another file", partial.display())]
    Busy {
        /// The unfinished file.
        partial: PathBuf,
    },
}
