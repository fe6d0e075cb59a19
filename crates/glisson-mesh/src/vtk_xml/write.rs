//! Writing data arrays of VTK XML files, little-endian, with counts of 64 bits.

use std::io::{self, Write};

use crate::base64::encode;

/// Size of the blocks that are compressed each for itself.
const BLOCK_BYTES: usize = 1 << 16;

/// A data array: attributes, then the bytes compressed in blocks, header and blocks each in base64.
pub(crate) fn write_array(out: &mut impl Write, attributes: &str, bytes: &[u8]) -> io::Result<()> {
    let mut sizes = Vec::new();
    let mut compressed = Vec::new();
    for block in bytes.chunks(BLOCK_BYTES) {
        let before = compressed.len();
        let mut encoder = flate2::write::ZlibEncoder::new(&mut compressed, flate2::Compression::default());
        encoder.write_all(block)?;
        encoder.finish()?;
        sizes.push(compressed.len() - before);
    }
    let header = [sizes.len(), BLOCK_BYTES, bytes.len() % BLOCK_BYTES];
    let header: Vec<u8> = header.iter().chain(&sizes).flat_map(|&w| (w as u64).to_le_bytes()).collect();
    writeln!(out, "<DataArray {attributes} format=\"binary\">")?;
    writeln!(out, "{}{}", encode(&header), encode(&compressed))?;
    writeln!(out, "</DataArray>")
}
