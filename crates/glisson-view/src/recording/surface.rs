//! The displayed surface in a recording: each as what it keeps of one before, in order, and what is new.

use super::error::RecordingError;
use glisson::math::DVec3;
use glisson::mesh::NodeId;
use glisson::record::snapshot::DisplayTopology;
use glisson_protocol::quantized::numbers::{Taker, put, put_signed};
use glisson_protocol::quantized::places::{Place, place_of};
use std::collections::HashMap;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Vertex {
    node: u32,
    rest: Place,
    body: u8,
}

/// Vertices and triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Surface {
    pub(super) version: u32,
    vertices: Vec<Vertex>,
    triangles: Vec<[u32; 3]>,
    is_cut: Vec<bool>,
}

impl Surface {
    /// None if a place is no number or too far away.
    pub(super) fn of(topology: &DisplayTopology, step_m: f64) -> Option<Self> {
        let DisplayTopology { version, nodes, rest_positions_m, triangles, is_cut, body_of } = topology;
        let vertices = nodes.iter().zip(rest_positions_m).zip(body_of).map(|((node, &rest_m), &body)| {
            Some(Vertex { node: node.0, rest: place_of(rest_m, step_m)?, body })
        });
        Some(Self {
            version: *version,
            vertices: vertices.collect::<Option<_>>()?,
            triangles: triangles.clone(),
            is_cut: is_cut.clone(),
        })
    }

    /// As displays are told of it.
    pub(super) fn topology(&self, step_m: f64) -> DisplayTopology {
        let rest_m = |vertex: &Vertex| DVec3::from_array(vertex.rest.map(|x| f64::from(x) * step_m));
        DisplayTopology {
            version: self.version,
            nodes: self.vertices.iter().map(|vertex| NodeId(vertex.node)).collect(),
            rest_positions_m: self.vertices.iter().map(rest_m).collect(),
            triangles: self.triangles.clone(),
            is_cut: self.is_cut.clone(),
            body_of: self.vertices.iter().map(|vertex| vertex.body).collect(),
        }
    }

    pub(super) fn n_vertices(&self) -> usize {
        self.vertices.len()
    }

    /// Where the vertices are at rest.
    pub(super) fn rest(&self) -> Vec<Place> {
        self.vertices.iter().map(|vertex| vertex.rest).collect()
    }

    fn vertex_of_node(&self) -> HashMap<u32, u32> {
        (0..).zip(&self.vertices).map(|(i, vertex)| (vertex.node, i)).collect()
    }

    /// Of each vertex of `before`, its number here.
    fn numbers_of(&self, before: &Self) -> Vec<Option<u32>> {
        let here = self.vertex_of_node();
        before.vertices.iter().map(|vertex| here.get(&vertex.node).copied()).collect()
    }

    /// Where each vertex is looked for: where its node was before, else where it is at rest.
    pub(super) fn expected(&self, before: &Self, places: &[Place]) -> Vec<Place> {
        let there = before.vertex_of_node();
        let place = |vertex: &Vertex| there.get(&vertex.node).map_or(vertex.rest, |&i| places[i as usize]);
        self.vertices.iter().map(place).collect()
    }

    /// Appends what it takes to make this of `before`.
    pub(super) fn put_after(&self, before: &Self, out: &mut Vec<u8>) {
        put(out, self.version);
        let there = before.vertex_of_node();
        let same = |vertex: &Vertex| {
            there.get(&vertex.node).copied().filter(|&i| before.vertices[i as usize] == *vertex)
        };
        let mut last = Vertex { node: 0, rest: [0; 3], body: 0 };
        put_list(out, &self.vertices.iter().map(same).collect::<Vec<_>>(), |out, i| {
            let vertex = self.vertices[i];
            put_signed(out, vertex.node.wrapping_sub(last.node) as i32);
            (0..3).for_each(|k| put_signed(out, vertex.rest[k] - last.rest[k]));
            out.push(vertex.body);
            last = vertex;
        });
        // A triangle is known again by the numbers that its vertices have here.
        let numbers = self.numbers_of(before);
        let renumbered = |triangle: &[u32; 3]| -> Option<[u32; 3]> {
            let [a, b, c] = triangle.map(|v| numbers[v as usize]);
            Some([a?, b?, c?])
        };
        let known: HashMap<([u32; 3], bool), u32> = (0..)
            .zip(before.triangles.iter().zip(&before.is_cut))
            .filter_map(|(i, (triangle, &is_cut))| Some(((renumbered(triangle)?, is_cut), i)))
            .collect();
        let of_before: Vec<Option<u32>> = self
            .triangles
            .iter()
            .zip(&self.is_cut)
            .map(|(t, &is_cut)| known.get(&(*t, is_cut)).copied())
            .collect();
        let mut first = 0;
        put_list(out, &of_before, |out, i| {
            let [a, b, c] = self.triangles[i];
            out.push(u8::from(self.is_cut[i]));
            [(a, first), (b, a), (c, a)]
                .iter()
                .for_each(|(x, from)| put_signed(out, x.wrapping_sub(*from) as i32));
            first = a;
        });
    }

    /// What [`Surface::put_after`] wrote.
    pub(super) fn take_after(before: &Self, from: &mut Taker) -> Result<Self, RecordingError> {
        let mut surface = Self { version: from.number()?, ..Self::default() };
        let mut last = Vertex { node: 0, rest: [0; 3], body: 0 };
        let vertices = &mut surface.vertices;
        take_list(from, before.vertices.len(), |from, kept| {
            vertices.push(match kept {
                Some(i) => before.vertices[i],
                None => {
                    let node = last.node.wrapping_add(from.signed()? as u32);
                    let mut rest = last.rest;
                    for x in &mut rest {
                        *x = x.wrapping_add(from.signed()?);
                    }
                    last = Vertex { node, rest, body: from.byte()? };
                    last
                }
            });
            Ok(())
        })?;
        let numbers = surface.numbers_of(before);
        let n_vertices = surface.vertices.len() as u32;
        let mut first = 0_u32;
        take_list(from, before.triangles.len(), |from, kept| {
            let (triangle, is_cut) = match kept {
                Some(i) => {
                    let kept = before.triangles[i].map(|v| numbers[v as usize]);
                    let [Some(a), Some(b), Some(c)] = kept else {
                        return Err(RecordingError::Broken("a triangle is kept and its vertex is not"));
                    };
                    ([a, b, c], before.is_cut[i])
                }
                None => {
                    let is_cut = from.byte()? != 0;
                    first = first.wrapping_add(from.signed()? as u32);
                    let mut other = || from.signed().map(|x| first.wrapping_add(x as u32));
                    ([first, other()?, other()?], is_cut)
                }
            };
            if triangle.iter().any(|&v| v >= n_vertices) {
                return Err(RecordingError::Broken("a triangle has a vertex that is not there"));
            }
            surface.triangles.push(triangle);
            surface.is_cut.push(is_cut);
            Ok(())
        })?;
        Ok(surface)
    }
}

/// Appends a list of which some are in one before: runs of those that are kept, in their order, and of new ones.
///
/// Each run: twice its length, and 1 for new ones; then for kept ones how many are left out before them, else what `put_new` writes.
fn put_list(out: &mut Vec<u8>, of_before: &[Option<u32>], mut put_new: impl FnMut(&mut Vec<u8>, usize)) {
    put(out, of_before.len() as u32);
    let (mut at, mut next) = (0, 0);
    while at < of_before.len() {
        let n_kept = match of_before[at] {
            Some(first) if first >= next => {
                (first..).zip(&of_before[at..]).take_while(|(i, of)| **of == Some(*i)).count()
            }
            _ => 0,
        };
        if n_kept > 0 {
            let first = of_before[at].unwrap_or(next);
            put(out, (n_kept as u32) << 1);
            put(out, first - next);
            next = first + n_kept as u32;
            at += n_kept;
        } else {
            let n_new = of_before[at..].iter().take_while(|of| of.is_none_or(|i| i < next)).count();
            put(out, (n_new as u32) << 1 | 1);
            (at..at + n_new).for_each(|i| put_new(out, i));
            at += n_new;
        }
    }
}

/// What [`put_list`] wrote; `take` gets the place of each in the list of `n_before`, or none and takes a new one.
fn take_list(
    from: &mut Taker,
    n_before: usize,
    mut take: impl FnMut(&mut Taker, Option<usize>) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let (mut left, mut next) = (from.number()? as usize, 0);
    while left > 0 {
        let run = from.number()?;
        let n = (run >> 1) as usize;
        if n == 0 || n > left {
            return Err(RecordingError::Broken("a run is longer than its list"));
        }
        left -= n;
        if run & 1 == 1 {
            (0..n).try_for_each(|_| take(from, None))?;
            continue;
        }
        let first = next + from.number()? as usize;
        next = first + n;
        if next > n_before {
            return Err(RecordingError::Broken("a run is kept of what is not there"));
        }
        (first..next).try_for_each(|i| take(from, Some(i)))?;
    }
    Ok(())
}
