//! Bodies of the messages that are sent: TRANSFORM, POLYDATA, STATUS, CAPABILITY, and the answers to STT and STP.
//! Lengths in mm. Source: the documents of the same names in the repository openigtlink/OpenIGTLink.

use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson::tool::pose::ToolFrame;

/// The directions of the axes of what is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Axes {
    /// +x right, +y front, +z head: what 3D Slicer takes
    #[default]
    Ras,
    /// +x left, +y back, +z head: as in DICOM, and inside Glisson
    Lps,
}

const MM_PER_M: f64 = 1e3;

impl Axes {
    /// A vector of the patient frame (LPS) in these axes.
    fn turned(self, in_lps: DVec3) -> DVec3 {
        match self {
            Self::Lps => in_lps,
            // Not with a minus sign, which would make -0 of 0.
            Self::Ras => DVec3::new(0.0 - in_lps.x, 0.0 - in_lps.y, in_lps.z),
        }
    }

    /// As people write it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Ras => "RAS",
            Self::Lps => "LPS",
        }
    }
}

fn put_vector(body: &mut Vec<u8>, v: DVec3) {
    body.extend(v.as_vec3().to_array().iter().flat_map(|x| x.to_be_bytes()));
}

fn put_counts(body: &mut Vec<u8>, counts: &[usize]) {
    body.extend(counts.iter().flat_map(|&n| (n as u32).to_be_bytes()));
}

/// TRANSFORM: 12 numbers, column by column, from the tool's axes to the patient's. The tool's origin is its tip, its
/// z axis points to the handle, its jaws open along x. Between RAS and LPS the patient's x and y turn over together:
/// a rotation, so the tool's axes stay right-handed.
pub(crate) fn transform(pose: &ToolInput, axes: Axes) -> Vec<u8> {
    let frame = ToolFrame::of(pose).world_from_tool;
    let mut body = Vec::with_capacity(48);
    for column in [frame.x_axis, frame.y_axis, frame.z_axis] {
        put_vector(&mut body, axes.turned(column));
    }
    put_vector(&mut body, axes.turned(pose.tip_in_world_m) * MM_PER_M);
    body
}

/// POLYDATA: a surface of triangles. In the header come numbers of points, vertices, lines, polygons, strips and
/// attributes; behind each of the four in the middle the bytes of its list.
pub(crate) fn polydata(positions_m: &[DVec3], triangles: &[[u32; 3]], axes: Axes) -> Vec<u8> {
    let list_bytes = triangles.len() * 16;
    let mut body = Vec::with_capacity(40 + positions_m.len() * 12 + list_bytes);
    put_counts(&mut body, &[positions_m.len(), 0, 0, 0, 0, triangles.len(), list_bytes, 0, 0, 0]);
    for &position_m in positions_m {
        put_vector(&mut body, axes.turned(position_m) * MM_PER_M);
    }
    for triangle in triangles {
        body.extend([3, triangle[0], triangle[1], triangle[2]].iter().flat_map(|n| n.to_be_bytes()));
    }
    body
}

/// Codes of a STATUS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StatusCode {
    Ok = 1,
    NotFound = 4,
    Busy = 6,
    Overflow = 8,
    Checksum = 9,
    IllegalInstruction = 12,
    ShuttingDown = 19,
}

impl StatusCode {
    fn name(self) -> &'static str {
        match self {
            Self::Ok => "OK",
            Self::NotFound => "not found",
            Self::Busy => "busy",
            Self::Overflow => "overflow",
            Self::Checksum => "checksum error",
            Self::IllegalInstruction => "illegal instruction",
            Self::ShuttingDown => "exiting",
        }
    }
}

/// STATUS: code, sub-code (0), a name of 20 bytes, a sentence that ends with a zero.
pub(crate) fn status(code: StatusCode, sentence: &str) -> Vec<u8> {
    let mut body = Vec::with_capacity(31 + sentence.len());
    body.extend((code as u16).to_be_bytes());
    body.extend(0_i64.to_be_bytes());
    let mut name = [0; 20];
    name[..code.name().len()].copy_from_slice(code.name().as_bytes());
    body.extend(name);
    body.extend(sentence.as_bytes());
    body.push(0);
    body
}

/// CAPABILITY: type names of 12 bytes.
pub(crate) fn capability(kinds: &[&str]) -> Vec<u8> {
    let mut body = Vec::with_capacity(12 * kinds.len());
    for kind in kinds {
        let mut field = [0; 12];
        field[..kind.len().min(12)].copy_from_slice(&kind.as_bytes()[..kind.len().min(12)]);
        body.extend(field);
    }
    body
}

/// The answer to STT_... and STP_...: 0 done, 1 not.
pub(crate) fn answer(is_done: bool) -> Vec<u8> {
    vec![u8::from(!is_done)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floats(body: &[u8]) -> Vec<f32> {
        body.chunks(4).map(|x| f32::from_be_bytes(x.try_into().unwrap())).collect()
    }

    fn words(body: &[u8]) -> Vec<u32> {
        body.chunks(4).map(|x| u32::from_be_bytes(x.try_into().unwrap())).collect()
    }

    #[test]
    fn a_transform_is_in_mm_and_in_the_axes_asked_for() {
        let pose = ToolInput {
            roll_rad: 0.3,
            ..ToolInput::at(DVec3::new(0.01, -0.02, 0.3), DVec3::new(0.6, 0.0, 0.8))
        };
        let lps = floats(&transform(&pose, Axes::Lps));
        assert_eq!(lps.len(), 12);
        assert_eq!(lps[9..], [10.0, -20.0, 300.0]);
        // The third column is the shaft.
        assert_eq!(lps[6..9], [0.6, 0.0, 0.8]);
        let ras = floats(&transform(&pose, Axes::Ras));
        for (i, (ras, lps)) in ras.iter().zip(&lps).enumerate() {
            assert_eq!(*ras, if i % 3 == 2 { *lps } else { -lps }, "number {i}");
        }
        let column =
            |m: &[f32], i: usize| DVec3::new(m[3 * i].into(), m[3 * i + 1].into(), m[3 * i + 2].into());
        for m in [&lps, &ras] {
            let volume = column(m, 0).cross(column(m, 1)).dot(column(m, 2));
            assert!((volume - 1.0).abs() < 1e-6, "right-handed and not scaled: {volume}");
        }
    }

    #[test]
    fn a_surface_has_the_documented_layout() {
        let positions_m = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE];
        let body = polydata(&positions_m, &[[0, 1, 2], [1, 3, 2]], Axes::Ras);
        assert_eq!(words(&body[..40]), [4, 0, 0, 0, 0, 2, 32, 0, 0, 0]);
        let points = floats(&body[40..88]);
        assert_eq!(points[..6], [-1000.0, 0.0, 0.0, 0.0, -1000.0, 0.0]);
        assert_eq!(words(&body[88..]), [3, 0, 1, 2, 3, 1, 3, 2]);
    }

    #[test]
    fn a_status_and_a_list_of_types_have_the_documented_layout() {
        let body = status(StatusCode::Checksum, "why");
        assert_eq!(body[..10], [0, 9, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(&body[10..30], b"checksum error\0\0\0\0\0\0");
        assert_eq!(&body[30..], b"why\0");
        assert_eq!(capability(&["STATUS", "TRANSFORM"]).len(), 24);
        assert_eq!(&capability(&["STATUS", "TRANSFORM"])[12..], b"TRANSFORM\0\0\0");
        assert_eq!((answer(true), answer(false)), (vec![0], vec![1]));
    }
}
