//! Writing NRRD.

use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::super::error::ImageError;
use super::super::written::WrittenImage;
use crate::binary::NumberType;
use crate::files::write_atomically;
use crate::image::VoxelGrid;
use crate::math::DVec3;

/// Writes an image with its header and data in one file, LPS and millimetres, compressed.
pub(super) fn write(path: &Path, image: &WrittenImage<'_>) -> Result<(), ImageError> {
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    if name.ends_with(".nhdr") {
        let reason = "a header and its data go into one file; name it .nrrd".into();
        return Err(ImageError::Unwritable { file: path.to_path_buf(), reason });
    }
    let header = header_text(image);
    let result = write_atomically(path, |out| {
        out.write_all(header.as_bytes())?;
        let mut encoder = GzEncoder::new(out, Compression::fast());
        encoder.write_all(&image.bytes)?;
        encoder.finish().map(|_| ())
    });
    result.map_err(|source| ImageError::Io { file: path.to_path_buf(), source })
}

fn vector_mm(v_m: DVec3) -> String {
    let [x, y, z] = (v_m * 1e3).to_array();
    format!("({x},{y},{z})")
}

fn header_text(image: &WrittenImage<'_>) -> String {
    let grid = image.grid;
    let kind = match image.kind {
        NumberType::I16 => "short",
        NumberType::U16 => "unsigned short",
        _ => "float",
    };
    let [i, j, k] = grid.dims;
    let steps: Vec<String> =
        (0..3).map(|axis| vector_mm(grid.axes.col(axis) * grid.spacing_m[axis])).collect();
    let mut lines = vec![
        "NRRD0005".to_owned(),
        "# Complete NRRD file format specification at:".to_owned(),
        "# http://teem.sourceforge.net/nrrd/format.html".to_owned(),
        format!("type: {kind}"),
        "dimension: 3".to_owned(),
        "space: left-posterior-superior".to_owned(),
        format!("sizes: {i} {j} {k}"),
        format!("space directions: {}", steps.join(" ")),
        "kinds: domain domain domain".to_owned(),
        "space units: \"mm\" \"mm\" \"mm\"".to_owned(),
        "endian: little".to_owned(),
        "encoding: gzip".to_owned(),
        format!("space origin: {}", vector_mm(grid.origin_m)),
    ];
    if image.is_label_map {
        lines.extend(segment_lines(image));
    }
    lines.join("\n") + "\n\n"
}

/// What 3D Slicer asks for of a segmentation.
fn segment_lines(image: &WrittenImage<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    let extents = extents(image.grid, &image.bytes);
    for (n, (label, name)) in image.names.iter().filter(|(label, _)| *label != 0).enumerate() {
        let extent = extents[usize::from(*label)].map_or("0 -1 0 -1 0 -1".into(), |[i, j, k]| {
            format!("{} {} {} {} {} {}", i[0], i[1], j[0], j[1], k[0], k[1])
        });
        // One line a key: what would end it or mean something is written with a backslash.
        let name = name.replace('\\', "\\\\").replace('\n', "\\n");
        lines.push(format!("Segment{n}_ID:=Segment_{label}"));
        lines.push(format!("Segment{n}_Name:={name}"));
        if let Some((_, [red, green, blue])) = image.colours.iter().find(|(l, _)| l == label) {
            lines.push(format!("Segment{n}_Color:={red} {green} {blue}"));
        }
        lines.push(format!("Segment{n}_LabelValue:={label}"));
        lines.push(format!("Segment{n}_Layer:=0"));
        lines.push(format!("Segment{n}_Extent:={extent}"));
    }
    if !lines.is_empty() {
        lines.push("Segmentation_ContainedRepresentationNames:=Binary labelmap|".to_owned());
        lines.push("Segmentation_MasterRepresentation:=Binary labelmap".to_owned());
        lines.push("Segmentation_ReferenceImageExtentOffset:=0 0 0".to_owned());
    }
    lines
}

/// First and last voxel of every label along each axis; none for a label that no voxel has.
fn extents(grid: &VoxelGrid, bytes: &[u8]) -> Vec<Option<[[usize; 2]; 3]>> {
    let mut found = vec![None; 1 << 16];
    for (index, pair) in bytes.chunks_exact(2).enumerate() {
        let voxel = grid.voxel(index);
        let extent =
            found[usize::from(u16::from_le_bytes([pair[0], pair[1]]))].get_or_insert(voxel.map(|v| [v, v]));
        for (range, v) in extent.iter_mut().zip(voxel) {
            *range = [range[0].min(v), range[1].max(v)];
        }
    }
    found
}
