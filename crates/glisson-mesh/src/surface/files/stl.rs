//! STL: triangles that repeat their corners, as text or binary.

use std::io::{self, Write};

use super::cursor::{Cursor, quote};
use super::weld::Welded;
use super::{RawSurface, Space, SurfaceFileError, Written};
use crate::math::DVec3;

const HEADER: usize = 80;
const BYTES_PER_TRIANGLE: usize = 50;

pub(super) fn parse(mut cursor: Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    let all = cursor.all();
    let count = all.get(HEADER..HEADER + 4).map(|c| u32::from_le_bytes(c.try_into().expect("four bytes")));
    let binary_size = count.map(|c| (HEADER + 4) as u64 + u64::from(c) * BYTES_PER_TRIANGLE as u64);
    // Some programs begin binary files with `solid` too; their length gives them away.
    if binary_size != Some(all.len() as u64) && all.trim_ascii_start().starts_with(b"solid") {
        return parse_ascii(cursor);
    }
    let header = cursor.take(HEADER, "bytes of an STL header (text STL begins with 'solid')")?;
    let space = cursor.space(header)?;
    let count = cursor.take(4, "bytes of the number of triangles")?;
    let count = u32::from_le_bytes(count.try_into().expect("four bytes"));
    let count = cursor.check_count(u64::from(count), BYTES_PER_TRIANGLE, "triangles")?;
    if cursor.rest().len() != count * BYTES_PER_TRIANGLE {
        let found = format!("{} more", cursor.rest().len() - count * BYTES_PER_TRIANGLE);
        return Err(cursor.error(format!("no bytes after {count} triangles"), found));
    }
    let (mut welded, mut corners) = (Welded::default(), Vec::new());
    for _ in 0..count {
        let triangle = cursor.take(BYTES_PER_TRIANGLE, "bytes of a triangle")?;
        let number = |n: usize| {
            let start = 12 + 4 * n;
            let bytes = triangle[start..start + 4].try_into().expect("four bytes");
            f64::from(f32::from_le_bytes(bytes))
        };
        for corner in 0..3 {
            let [x, y, z] = [0, 1, 2].map(|axis| number(3 * corner + axis));
            corners.push(welded.add(cursor.finite(DVec3::new(x, y, z))?));
        }
    }
    Ok(raw_of(welded, &corners, space.unwrap_or_default()))
}

fn parse_ascii(mut cursor: Cursor<'_>) -> Result<RawSurface, SurfaceFileError> {
    let mut space = None;
    let (mut welded, mut corners) = (Welded::default(), Vec::new());
    while cursor.rest().iter().any(|b| !b.is_ascii_whitespace()) {
        let title = cursor.next_line().unwrap_or_default();
        if title.trim_ascii().is_empty() {
            continue;
        }
        if !title.trim_ascii_start().starts_with(b"solid") {
            return Err(cursor.error("'solid NAME'", quote(title)));
        }
        space = space.or(cursor.space(title)?);
        loop {
            match cursor.token("'facet' or 'endsolid'")? {
                "facet" => {}
                "endsolid" => {
                    // The rest of the line repeats the name.
                    cursor.next_line();
                    break;
                }
                found => return Err(cursor.error("'facet' or 'endsolid'", quote(found.as_bytes()))),
            }
            expect(&mut cursor, "normal")?;
            for _ in 0..3 {
                // The normal follows from the corners; exporters write all sorts of numbers here.
                cursor.number::<f64>("a normal's component")?;
            }
            expect(&mut cursor, "outer")?;
            expect(&mut cursor, "loop")?;
            for _ in 0..3 {
                expect(&mut cursor, "vertex")?;
                let mut p = DVec3::ZERO;
                for axis in 0..3 {
                    p[axis] = cursor.number("a coordinate")?;
                }
                corners.push(welded.add(cursor.finite(p)?));
            }
            expect(&mut cursor, "endloop")?;
            expect(&mut cursor, "endfacet")?;
        }
    }
    Ok(raw_of(welded, &corners, space.unwrap_or_default()))
}

fn expect(cursor: &mut Cursor<'_>, word: &str) -> Result<(), SurfaceFileError> {
    let what = format!("'{word}'");
    let found = cursor.token(&what)?;
    if found == word { Ok(()) } else { Err(cursor.error(what, quote(found.as_bytes()))) }
}

fn raw_of(welded: Welded, corners: &[u32], space: Space) -> RawSurface {
    let triangles = corners.as_chunks().0.to_vec();
    RawSurface { positions: welded.positions, triangles, space, ..RawSurface::default() }
}

fn unit_normal(corners: [DVec3; 3]) -> DVec3 {
    (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero()
}

pub(super) fn write_ascii(out: &mut impl Write, surface: &Written<'_>) -> io::Result<()> {
    writeln!(out, "solid glisson SPACE={} UNIT=mm", surface.space.name())?;
    for triangle in surface.triangles {
        let corners = triangle.map(|v| surface.positions_mm[v as usize]);
        let n = unit_normal(corners);
        writeln!(out, "  facet normal {} {} {}", n.x, n.y, n.z)?;
        writeln!(out, "    outer loop")?;
        for p in corners {
            writeln!(out, "      vertex {} {} {}", p.x, p.y, p.z)?;
        }
        writeln!(out, "    endloop\n  endfacet")?;
    }
    writeln!(out, "endsolid glisson")
}

pub(super) fn write_binary(out: &mut impl Write, surface: &Written<'_>) -> io::Result<()> {
    let mut header = [b' '; HEADER];
    // Must not begin with `solid`, which would look like text.
    let title = format!("glisson surface SPACE={} UNIT=mm", surface.space.name());
    header[..title.len()].copy_from_slice(title.as_bytes());
    out.write_all(&header)?;
    let count = u32::try_from(surface.triangles.len())
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "STL holds at most 2^32 - 1 triangles"))?;
    out.write_all(&count.to_le_bytes())?;
    for triangle in surface.triangles {
        let corners = triangle.map(|v| surface.positions_mm[v as usize]);
        for p in [unit_normal(corners), corners[0], corners[1], corners[2]] {
            for x in p.to_array() {
                out.write_all(&(x as f32).to_le_bytes())?;
            }
        }
        out.write_all(&[0; 2])?;
    }
    Ok(())
}
