//! What a format of tetrahedral meshes is to those who read and write files. Each format's file has its own; the table
//! [`super::FORMATS`] lists them.

use std::fs::File;
use std::io::{self, BufWriter};

use super::cells::RawMesh;
use crate::mesh::TetMesh;
use crate::scan::FormatError;
use crate::units::LengthUnit;

/// Writes a mesh into a file.
pub(super) type WriteMesh = fn(&TetMesh, &mut BufWriter<File>) -> io::Result<()>;

/// A format of tetrahedral meshes: a row of the table [`super::FORMATS`].
#[derive(Clone, Copy, Debug)]
pub struct MeshFormat {
    /// What people call it.
    pub name: &'static str,
    /// Extensions that name it, lower-case, without the dot.
    pub extensions: &'static [&'static str],
    /// Files of one mesh: one, or one for each of the extensions.
    pub n_files: usize,
    /// Reads the mesh in the bytes of its files, in the order of the extensions.
    pub(super) read: fn(&[&[u8]], LengthUnit) -> Result<RawMesh, FormatError>,
    /// Writes a mesh in millimetres; none for a format that is only read.
    pub(super) write: Option<WriteMesh>,
}

impl MeshFormat {
    /// Whether a mesh can be written in it.
    pub fn is_written(&self) -> bool {
        self.write.is_some()
    }
}

/// The bytes of file number `number` of a mesh; empty where it is not there.
pub(super) fn file<'a>(files: &[&'a [u8]], number: usize) -> &'a [u8] {
    files.get(number).copied().unwrap_or_default()
}
