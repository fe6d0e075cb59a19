//! The forces with which bodies carry each other in the shape of their meshes, and the stress at rest under them.
//!
//! Many forces could carry a body. Those taken are the ones of rigid pieces on springs: the contact c has a stiffness in
//! proportion to the area a_c of its vertex, alike along and across its normal, and exerts only forces in Coulomb's cone. A piece
//! that nothing holds moves by u + w x (x - m), m its centre of mass; with the displacement d_c of a contact's vertex against the
//! place that it touches,
//!
//! f_c = a_c P(-d_c),   P(y) the point of the cone nearest to y,
//!
//! and u, w are the minimum of the sum of a_c |P(-d_c)|^2/2 less the work of the weights. It is convex; where it has a minimum
//! the forces balance weight and moment of every piece, and are the smallest that do (in the sum of |f_c|^2/a_c). Found by
//! Newton's method with shortened steps. Where it has none, because a piece falls or slides, the space itself is a weak spring:
//! the forces are bounded, and what they leave unbalanced accelerates the piece.

use super::build_error::BuildError;
use crate::contact::response::NodeContact;
use crate::contact::response::persistent::{ContactMemory, PlacesInTouch};
use crate::math::{DMat3, DVec3, outer};
use crate::mesh::topology::{Through, Topology};
use crate::mesh::{NodeId, TetMesh};
use crate::model::{BodyPart, FixedNode, ModelError, ModelMotion, NodalForce, OrganBody};
use crate::solve::{add_gravity_forces, solve_dense_in_place, stress_under_loads};

/// Of the friction so much is used to carry: what rests on the edge of its cone would creep. A choice.
const USED_FRICTION: f64 = 0.9;
/// Steps of Newton's method at most: choices, as are the next three.
const MOST_STEPS: usize = 200;
const MOST_HALVINGS: usize = 40;
/// It ends when no weight is out of balance by more than this share.
const BALANCED: f64 = 1e-13;
/// Added to the diagonal, as a share of its largest entry.
const DAMPING: f64 = 1e-12;
/// Stiffness of space where not all pieces are carried, as a share of that of the contacts.
const SPACE: f64 = 1e-3;
/// A piece counts as carried when no more than this share of its weight is unbalanced.
const CARRIED: f64 = 1e-9;

/// Unknowns of a piece: its displacement, and its rotation times its size.
const UNKNOWNS: usize = 6;

/// A piece of a body that nothing holds.
struct Piece {
    mass_kg: f64,
    middle_m: DVec3,
    /// Largest distance of a node from the middle [m].
    size_m: f64,
    /// Moment of inertia [kg m2].
    inertia_kg_m2: DMat3,
    /// What acts on it: weight and ligaments, and their moment about the middle.
    force_n: DVec3,
    moment_n_m: DVec3,
}

/// The pieces of all bodies.
struct Pieces {
    /// The piece of each node of the joint mesh; none for a node that is held, or of a body that has no stress at rest.
    of_node: Vec<Option<u32>>,
    free: Vec<Piece>,
    mass_kg: Vec<f64>,
}

/// Whether the body has a stress at rest, so that others can carry it.
fn is_imaged_under_load(part: &BodyPart) -> Option<&OrganBody> {
    let BodyPart::Organ { body, kind } = part else { return None };
    let has_stress = body.is_imaged_under_gravity
        && body.gravity_m_per_s2 != DVec3::ZERO
        && kind.row().motion != ModelMotion::QuasiStatic;
    has_stress.then_some(body)
}

/// Weight and ligaments of a body [N].
fn loads_n(body: &OrganBody) -> Vec<DVec3> {
    let mut load_n = vec![DVec3::ZERO; body.mesh.positions_m.len()];
    add_gravity_forces(&body.mesh, &body.material, body.gravity_m_per_s2, &mut load_n);
    for attachment in &body.attachments {
        let node = attachment.node.index();
        load_n[node] += attachment.force_n(body.mesh.positions_m[node]);
    }
    load_n
}

fn masses_kg(body: &OrganBody) -> impl Iterator<Item = f64> {
    let mut along_x = vec![DVec3::ZERO; body.mesh.positions_m.len()];
    add_gravity_forces(&body.mesh, &body.material, DVec3::X, &mut along_x);
    along_x.into_iter().map(|mass| mass.x)
}

/// The first node of each part in the joint mesh.
fn starts(parts: &[BodyPart]) -> Vec<usize> {
    let mut start = 0;
    let mut next = |part: &BodyPart| {
        start += part.mesh().positions_m.len();
        start - part.mesh().positions_m.len()
    };
    parts.iter().map(&mut next).collect()
}

impl Pieces {
    fn find(parts: &[BodyPart], topology: &Topology, joint: &TetMesh) -> Self {
        let n_nodes = joint.positions_m.len();
        let pieces = topology.pieces(Through::Nodes);
        let piece = |n: usize| {
            let tet = topology.node_tets(NodeId::from_index(n)).first()?;
            Some(pieces.of_tet[tet.index()])
        };
        let mut is_free = vec![true; pieces.count()];
        let (mut mass_kg, mut load_n) = (Vec::with_capacity(n_nodes), Vec::with_capacity(n_nodes));
        for (part, start) in parts.iter().zip(starts(parts)) {
            let n = part.mesh().positions_m.len();
            let held: Vec<usize> = if let Some(body) = is_imaged_under_load(part) {
                mass_kg.extend(masses_kg(body));
                load_n.extend(loads_n(body));
                body.fixed.iter().map(|held| held.node.index()).collect()
            } else {
                mass_kg.resize(start + n, 0.0);
                load_n.resize(start + n, DVec3::ZERO);
                (0..n).collect()
            };
            for piece in held.into_iter().filter_map(|n| piece(start + n)) {
                is_free[piece as usize] = false;
            }
        }
        let mut number = vec![None; is_free.len()];
        let free_ones = (0..is_free.len()).filter(|&piece| is_free[piece]);
        free_ones.zip(0u32..).for_each(|(piece, place)| number[piece] = Some(place));
        let of_node: Vec<Option<u32>> =
            (0..n_nodes).map(|n| piece(n).and_then(|piece| number[piece as usize])).collect();
        let n_free = is_free.iter().filter(|is_free| **is_free).count();
        let nodes_of = |piece: u32| {
            let is_of_it = move |of: &Option<u32>| *of == Some(piece);
            of_node.iter().enumerate().filter(move |(_, of)| is_of_it(of)).map(|(n, _)| n)
        };
        let free = (0..n_free as u32).map(|piece| {
            let mass: f64 = nodes_of(piece).map(|n| mass_kg[n]).sum();
            let middle_m = nodes_of(piece).map(|n| joint.positions_m[n] * mass_kg[n]).sum::<DVec3>() / mass;
            let arm_m = |n: usize| joint.positions_m[n] - middle_m;
            let inertia = |n: usize| {
                let arm_m = arm_m(n);
                let across = DMat3::from_diagonal(DVec3::splat(arm_m.length_squared()));
                (across - outer(arm_m, arm_m)) * mass_kg[n]
            };
            Piece {
                mass_kg: mass,
                middle_m,
                size_m: nodes_of(piece).map(|n| arm_m(n).length()).fold(0.0, f64::max),
                inertia_kg_m2: nodes_of(piece).map(inertia).fold(DMat3::ZERO, |sum, of_node| sum + of_node),
                force_n: nodes_of(piece).map(|n| load_n[n]).sum(),
                moment_n_m: nodes_of(piece).map(|n| arm_m(n).cross(load_n[n])).sum(),
            }
        });
        let free: Vec<Piece> = free.collect();
        Self { of_node, free, mass_kg }
    }
}

/// One contact as the minimum sees it.
struct Row {
    area_m2: f64,
    normal: DVec3,
    /// The pieces that move it, how far they reach into it, and the place's arm over the piece's size.
    sides: Vec<(usize, f64, DVec3)>,
}

impl Row {
    fn displacement_m(&self, q: &[f64]) -> DVec3 {
        let of_side = |&(piece, weight, arm): &(usize, f64, DVec3)| {
            let q = &q[UNKNOWNS * piece..];
            (DVec3::new(q[0], q[1], q[2]) + DVec3::new(q[3], q[4], q[5]).cross(arm)) * weight
        };
        self.sides.iter().map(of_side).sum()
    }

    /// Its unknowns, with the displacement that each brings.
    fn columns(&self) -> impl Iterator<Item = (usize, DVec3)> + '_ {
        self.sides.iter().flat_map(|&(piece, weight, arm)| {
            (0..UNKNOWNS).map(move |i| {
                let axis = DVec3::AXES[i % 3];
                let moved = if i < 3 { axis } else { axis.cross(arm) };
                (UNKNOWNS * piece + i, moved * weight)
            })
        })
    }
}

/// The point of Coulomb's cone nearest to `y`, and how it changes with y.
fn nearest_in_cone(normal: DVec3, y: DVec3, friction: f64) -> (DVec3, DMat3) {
    let along = y.dot(normal);
    let across = y - normal * along;
    let length = across.length();
    if length <= friction * along {
        return (y, DMat3::IDENTITY);
    }
    if friction * length <= -along {
        return (DVec3::ZERO, DMat3::ZERO);
    }
    let way = across / length;
    let edge = normal + way * friction;
    let share = 1.0 / (1.0 + friction * friction);
    let push = (along + friction * length) * share;
    let beside = DMat3::IDENTITY - outer(normal, normal) - outer(way, way);
    (edge * push, outer(edge, edge) * share + beside * (push * friction / length))
}

fn largest(of: &[f64]) -> f64 {
    of.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

struct Balance<'a> {
    rows: &'a [Row],
    load: Vec<f64>,
    friction: f64,
    /// Stiffness of space.
    space_m2: f64,
}

impl Balance<'_> {
    fn energy(&self, q: &[f64]) -> f64 {
        let of_row = |row: &Row| {
            let (force, _) = nearest_in_cone(row.normal, -row.displacement_m(q), self.friction);
            0.5 * row.area_m2 * force.length_squared()
        };
        let work: f64 = self.load.iter().zip(q).map(|(load, q)| load * q).sum();
        let of_space = 0.5 * self.space_m2 * q.iter().map(|q| q * q).sum::<f64>();
        self.rows.iter().map(of_row).sum::<f64>() + of_space - work
    }

    /// What is out of balance, and its stiffness by columns.
    fn linearize(&self, q: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let n = q.len();
        let mut stiffness = vec![0.0; n * n];
        (0..n).for_each(|i| stiffness[(n + 1) * i] = self.space_m2);
        let mut left: Vec<f64> = self.load.iter().zip(q).map(|(load, q)| load - self.space_m2 * q).collect();
        for row in self.rows {
            let (force, change) = nearest_in_cone(row.normal, -row.displacement_m(q), self.friction);
            if change == DMat3::ZERO {
                continue;
            }
            for (j, moved) in row.columns() {
                left[j] += row.area_m2 * force.dot(moved);
                let changed = change * moved * row.area_m2;
                row.columns().for_each(|(i, other)| stiffness[n * j + i] += other.dot(changed));
            }
        }
        (left, stiffness)
    }

    fn solve(&mut self) -> Vec<f64> {
        let q = self.minimize();
        let (left, _) = self.linearize(&q);
        if largest(&left) <= CARRIED * largest(&self.load) {
            return q;
        }
        self.space_m2 = SPACE * self.rows.iter().map(|row| row.area_m2).sum::<f64>();
        self.minimize()
    }

    /// The displacements with the least energy.
    fn minimize(&self) -> Vec<f64> {
        let n = self.load.len();
        let mut q = vec![0.0; n];
        let most_left = BALANCED * largest(&self.load);
        let mut energy = self.energy(&q);
        for _ in 0..MOST_STEPS {
            let (left, mut stiffness) = self.linearize(&q);
            if largest(&left) <= most_left {
                break;
            }
            let damping = DAMPING * (0..n).fold(0.0, |most: f64, i| most.max(stiffness[(n + 1) * i]));
            (0..n).for_each(|i| stiffness[(n + 1) * i] += damping);
            let mut step = left.clone();
            if solve_dense_in_place(n, &mut stiffness, &mut step, 0.0).is_err() {
                break;
            }
            let slope: f64 = left.iter().zip(&step).map(|(left, step)| left * step).sum();
            let mut share = 1.0;
            let mut next = q.clone();
            let mut is_lower = false;
            for _ in 0..MOST_HALVINGS {
                next.iter_mut().zip(&q).zip(&step).for_each(|((next, q), step)| *next = q + share * step);
                let there = self.energy(&next);
                // Near the minimum the energy no longer tells: its rounding is larger than what is gained.
                let rounding = 1e-14 * energy.abs();
                if there <= energy - 1e-4 * share * slope + rounding {
                    (energy, is_lower) = (there, true);
                    break;
                }
                share *= 0.5;
            }
            if !is_lower {
                break;
            }
            std::mem::swap(&mut q, &mut next);
        }
        q
    }
}

/// The force on the vertex of each contact [N].
fn forces_n(pieces: &Pieces, places: &PlacesInTouch, rest_m: &[DVec3], friction: f64) -> Vec<DVec3> {
    if pieces.free.is_empty() {
        return vec![DVec3::ZERO; places.contacts.len()];
    }
    let node = |v: usize| places.nodes[v].index();
    let row = |contact: &NodeContact| {
        let side = |(v, weight): (usize, f64)| {
            let piece = pieces.of_node[node(v)]? as usize;
            let Piece { middle_m, size_m, .. } = pieces.free[piece];
            Some((piece, weight, (rest_m[node(v)] - middle_m) / size_m))
        };
        let area_m2 = places.areas_m2[contact.vertices[0] as usize];
        Row { area_m2, normal: contact.normal, sides: contact.sides().filter_map(side).collect() }
    };
    let rows: Vec<Row> = places.contacts.iter().map(row).collect();
    let load = |piece: &Piece| {
        let (force, moment) = (piece.force_n, piece.moment_n_m / piece.size_m);
        [force.x, force.y, force.z, moment.x, moment.y, moment.z]
    };
    let load = pieces.free.iter().flat_map(load).collect();
    let mut balance = Balance { rows: &rows, load, friction, space_m2: 0.0 };
    let q = balance.solve();
    let force_n = |row: &Row| nearest_in_cone(row.normal, -row.displacement_m(&q), friction).0 * row.area_m2;
    rows.iter().map(force_n).collect()
}

/// Finds the forces with which the bodies carry each other at `places`, and the stress of each organ at rest under them.
///
/// # Errors
/// The number of a body with why it has no stress at rest.
pub(super) fn carry(
    parts: &mut [BodyPart],
    topology: &Topology,
    joint: &TetMesh,
    places: &PlacesInTouch,
    friction: f64,
) -> Result<ContactMemory, (usize, Box<BuildError>)> {
    let pieces = Pieces::find(parts, topology, joint);
    let forces_n = forces_n(&pieces, places, &joint.positions_m, USED_FRICTION * friction);
    let mut memory = ContactMemory::default();
    let mut on_nodes_n = vec![DVec3::ZERO; joint.positions_m.len()];
    for (contact, &force_n) in places.contacts.iter().zip(&forces_n) {
        if force_n == DVec3::ZERO {
            continue;
        }
        let node = |v: usize| places.nodes[v];
        let of_contact = NodalForce { node: node(contact.vertices[0] as usize), force_n };
        memory.start_with(of_contact, contact.sides().map(|(v, w)| (node(v), force_n * w)));
        contact.sides().for_each(|(v, w)| on_nodes_n[node(v).index()] += force_n * w);
    }
    for (number, start) in starts(parts).into_iter().enumerate() {
        let is_under_load = is_imaged_under_load(&parts[number]).is_some();
        let BodyPart::Organ { body, .. } = &mut parts[number] else { continue };
        let own = start..start + body.mesh.positions_m.len();
        if is_under_load {
            let forces = (0..).zip(&on_nodes_n[own.clone()]).filter(|(_, force_n)| **force_n != DVec3::ZERO);
            body.carried = forces.map(|(n, &force_n)| NodalForce { node: NodeId(n), force_n }).collect();
        }
        let of_node = &pieces.of_node[own.clone()];
        rest_under_load(body, of_node, &pieces.free, &pieces.mass_kg[own])
            .map_err(|error| (number, Box::new(error.into())))?;
    }
    Ok(memory)
}

/// The stress of a body at rest. Pieces that nothing holds are in balance, or fall: then what accelerates them is no load.
fn rest_under_load(
    body: &mut OrganBody,
    of_node: &[Option<u32>],
    free: &[Piece],
    mass_kg: &[f64],
) -> Result<(), ModelError> {
    let is_held = !(body.fixed.is_empty() && body.carried.is_empty());
    if !(body.is_imaged_under_gravity && body.gravity_m_per_s2 != DVec3::ZERO && is_held) {
        return Ok(());
    }
    let mut load_n = loads_n(body);
    body.carried.iter().for_each(|force| load_n[force.node.index()] += force.force_n);
    let mut held = body.fixed.clone();
    let positions_m = &body.mesh.positions_m;
    let mut own: Vec<u32> = of_node.iter().flatten().copied().collect();
    own.sort_unstable();
    own.dedup();
    for piece in own {
        let nodes: Vec<usize> = (0..of_node.len()).filter(|&n| of_node[n] == Some(piece)).collect();
        let Piece { mass_kg: mass, middle_m, inertia_kg_m2, .. } = free[piece as usize];
        let arm_m = |n: usize| positions_m[n] - middle_m;
        let force_n: DVec3 = nodes.iter().map(|&n| load_n[n]).sum();
        let moment_n_m: DVec3 = nodes.iter().map(|&n| arm_m(n).cross(load_n[n])).sum();
        let (linear, angular) = (force_n / mass, inertia_kg_m2.inverse() * moment_n_m);
        for &n in &nodes {
            load_n[n] -= (linear + angular.cross(arm_m(n))) * mass_kg[n];
        }
        held.extend(three_nodes(&nodes, positions_m));
    }
    held.sort_by_key(|held| held.node);
    body.rest_stress_pa =
        stress_under_loads(&body.mesh, &body.material, &held, &load_n).map_err(ModelError::RestStress)?;
    Ok(())
}

/// Three nodes with the axes that keep a piece in its place, and exert nothing on one that is in balance.
fn three_nodes(nodes: &[usize], positions_m: &[DVec3]) -> [FixedNode; 3] {
    let furthest = |by: &dyn Fn(usize) -> f64| {
        nodes.iter().copied().max_by(|&a, &b| by(a).total_cmp(&by(b))).unwrap_or_default()
    };
    let first = nodes.first().copied().unwrap_or_default();
    let second = furthest(&|n| positions_m[n].distance(positions_m[first]));
    let along = positions_m[second] - positions_m[first];
    let third = furthest(&|n| (positions_m[n] - positions_m[first]).cross(along).length());
    let across = along.cross(positions_m[third] - positions_m[first]).abs();
    let axis_of = |v: DVec3| (0..3).max_by(|&a, &b| v[a].total_cmp(&v[b])).unwrap_or_default();
    let (kept, turned) = (axis_of(along.abs()), axis_of(across));
    let held = |n: usize, axes: [bool; 3]| FixedNode { node: NodeId::from_index(n), axes };
    [
        held(first, [true; 3]),
        held(second, std::array::from_fn(|axis| axis != kept)),
        held(third, std::array::from_fn(|axis| axis == turned)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;

    #[test]
    fn the_nearest_force_of_the_cone_is_in_it_and_its_change_is_its_derivative() {
        let mut random = SeededRandom::new(3);
        let mut vector = || DVec3::new(random.normal(), random.normal(), random.normal());
        for _ in 0..500 {
            let (normal, y, friction) = (vector().normalize(), vector(), 0.3);
            let (force, change) = nearest_in_cone(normal, y, friction);
            let along = force.dot(normal);
            assert!((force - normal * along).length() <= friction * along + 1e-12);
            // The nearest point of a convex cone: what is left is at right angles to it and away from all others.
            let left = y - force;
            assert!(left.dot(force).abs() < 1e-12);
            let other = nearest_in_cone(normal, vector(), friction).0;
            assert!(left.dot(other) < 1e-12);
            let way = vector() * 1e-6;
            let there = nearest_in_cone(normal, y + way, friction).0;
            assert!((there - force - change * way).length() < 1e-9, "{y} {normal}");
        }
    }

    #[test]
    fn forces_balance_weight_and_moment_or_stay_bounded() {
        // A block of 1 N on four legs, its centre of mass off the middle; on a level, on a slope that holds, and on one too steep.
        let legs = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, -0.5));
        for (slope, is_carried) in [(0.0, true), (0.2, true), (0.6, false)] {
            let row = |leg: &DVec3| Row {
                area_m2: 0.25,
                normal: DVec3::Z,
                sides: vec![(0, 1.0, *leg - DVec3::X * 0.3)],
            };
            let rows: Vec<Row> = legs.iter().map(row).collect();
            let weight = DVec3::new(libm::sin(slope), 0.0, -libm::cos(slope));
            let load = vec![weight.x, weight.y, weight.z, 0.0, 0.0, 0.0];
            let mut balance = Balance { rows: &rows, load, friction: 0.3, space_m2: 0.0 };
            let q = balance.solve();
            let force = |row: &Row| nearest_in_cone(row.normal, -row.displacement_m(&q), 0.3).0 * row.area_m2;
            let sum: DVec3 = rows.iter().map(force).sum();
            let moment: DVec3 = rows.iter().map(|row| row.sides[0].2.cross(force(row))).sum();
            let off = (sum + weight).length().max(moment.length());
            assert_eq!(off < 1e-9, is_carried, "{slope}: {sum} {moment}");
            assert!(rows.iter().all(|row| force(row).length() < 2.0), "{slope}");
        }
    }

    #[test]
    fn three_nodes_hold_a_piece() {
        let mut random = SeededRandom::new(8);
        for _ in 0..50 {
            let positions_m: Vec<DVec3> =
                (0..12).map(|_| DVec3::new(random.normal(), random.normal(), random.normal())).collect();
            let nodes: Vec<usize> = (0..12).collect();
            let held = three_nodes(&nodes, &positions_m);
            // The motions of a rigid body along the held axes: none but rest leaves them all.
            let mut matrix = vec![0.0; 36];
            let mut row = 0;
            for held in held {
                for axis in (0..3).filter(|&axis| held.axes[axis]) {
                    for i in 0..6 {
                        let unit = DVec3::AXES[i % 3];
                        let moved = if i < 3 { unit } else { unit.cross(positions_m[held.node.index()]) };
                        matrix[6 * i + row] = moved[axis];
                    }
                    row += 1;
                }
            }
            assert_eq!(row, 6);
            assert!(solve_dense_in_place(6, &mut matrix, &mut [0.0; 6], 1e-6).is_ok());
        }
    }
}
