//! Wavefront OBJ: vertices and faces; normals, textures, groups and materials are passed over.

use std::io::{self, Write};

use super::cursor::{Cursor, quote};
use super::{RawSurface, SurfaceFileError, Written};
use crate::math::DVec3;

/// Statements that say nothing about the shape of the surface.
const IGNORED: [&str; 13] =
    ["vn", "vt", "vp", "g", "o", "s", "mg", "l", "p", "usemtl", "mtllib", "usemap", "maplib"];

pub(super) fn parse(mut cursor: Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    let mut raw = RawSurface::default();
    let mut space = None;
    let mut corners = Vec::new();
    while let Some(line) = cursor.next_line() {
        let line = line.trim_ascii();
        if let Some(comment) = line.strip_prefix(b"#") {
            space = space.or(cursor.space(comment)?);
            continue;
        }
        let Ok(line) = std::str::from_utf8(line) else { return Err(cursor.error("text", quote(line))) };
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            None => {}
            Some("v") => {
                let mut p = DVec3::ZERO;
                for axis in 0..3 {
                    let Some(word) = words.next() else {
                        return Err(cursor.error("'v X Y Z'", quote(line.as_bytes())));
                    };
                    p[axis] = cursor.parse(word, "a coordinate")?;
                }
                raw.positions.push(cursor.finite(p)?);
            }
            Some("f") => {
                corners.clear();
                for word in words {
                    let number: i64 =
                        cursor.parse(word.split('/').next().unwrap_or_default(), "a vertex number")?;
                    // From 1, or backwards from the last vertex so far.
                    let from_zero = match number {
                        0 => return Err(cursor.error("a vertex number from 1 or below 0", "0")),
                        1.. => number - 1,
                        _ => (raw.positions.len() as i64).saturating_add(number),
                    };
                    corners.push(from_zero);
                }
                let n_vertices = raw.positions.len();
                raw.add_polygon(&cursor, &corners, n_vertices)?;
            }
            Some(word) if IGNORED.contains(&word) => {}
            Some(word) => {
                return Err(
                    cursor.error("an OBJ statement (v, f, vn, vt, g, o, s, ...)", quote(word.as_bytes()))
                );
            }
        }
    }
    raw.space = space.unwrap_or_default();
    Ok(raw)
}

pub(super) fn write(out: &mut impl Write, surface: &Written<'_>) -> io::Result<()> {
    writeln!(out, "# glisson surface SPACE={} UNIT=mm", surface.space.name())?;
    for p in &surface.positions_mm {
        writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for [a, b, c] in surface.triangles {
        writeln!(out, "f {} {} {}", a + 1, b + 1, c + 1)?;
    }
    Ok(())
}
