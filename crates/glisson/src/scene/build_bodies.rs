//! Several bodies at rest: their meshes joined, what they are held by, and where they carry each other.

use super::attachment::bonds;
use super::bodies::BodySource;
use super::build::{BuildError, OrganTables, organ_without_stress, read_organ_mesh};
use super::carried::carry;
use super::rigid::{RigidShape, RigidSource};
use super::spec::Scene;
use crate::contact::response::persistent::{BodiesOfSurface, ContactMemory, PlacesInTouch, places_in_touch};
use crate::math::{Aabb, DMat3, DVec3};
use crate::mesh::box_mesh::box_of_five;
use crate::mesh::faults::{FaultAction, ImportPolicy};
use crate::mesh::files::read_mesh_with;
use crate::mesh::generate::{MeshParams, WantedSize, generate};
use crate::mesh::topology::Topology;
use crate::mesh::{NodeId, TetMesh};
use crate::model::{BodyPart, BodySet, ModelError, ModelMotion};
use crate::surface::TriMesh;
use crate::surface::files::{import_closed_surface, surface_extensions};
use crate::workers::SharedWorkers;
use crate::world::organ::OrganError;
use crate::world::spec::{BodySpec, WorldSpec};
use std::path::Path;

/// A rigid body without an edge length of its own has so many edges along its longest side: a choice.
const EDGES_ALONG: f64 = 12.0;
/// Cells along a side of a rigid box at most: a choice.
const MOST_CELLS: f64 = 64.0;
/// Sides of the polygon that stands for the circle of a cylinder, and rings of triangles on a ball.
const N_AROUND: u32 = 48;
/// Reads all bodies of a scene and tells `spec` of them. With the forces with which they carry each other.
pub(super) fn read_bodies(
    scene: &Scene,
    folder: &Path,
    workers: SharedWorkers,
    spec: &mut WorldSpec,
) -> Result<(BodySet, ContactMemory), BuildError> {
    let of_body = |name: &str| {
        let name = name.to_owned();
        move |error: BuildError| BuildError::Body { name, error: Box::new(error) }
    };
    let (mut meshes, mut labels) = (Vec::new(), Vec::new());
    for body in &scene.bodies {
        let mesh = match &body.source {
            BodySource::Organ(source, _) => read_organ_mesh(source, folder),
            BodySource::Rigid(source) => read_rigid_mesh(source, folder).map(|mesh| (mesh, Vec::new())),
        };
        let (mesh, label_of) = mesh.map_err(of_body(&body.name))?;
        meshes.push(mesh);
        labels.push(label_of);
    }
    spec.bodies = body_specs(scene, &meshes);
    let joint = joined(&meshes);
    let topology = Topology::build(&joint).map_err(|error| {
        let (file, error) = (folder.join(&scene.organ.mesh), OrganError::Topology(error));
        BuildError::Organ { file, error }
    })?;
    let body_of = spec.body_of_nodes(joint.positions_m.len());
    let is_rigid: Vec<bool> = spec.bodies.iter().map(|body| body.is_rigid).collect();
    let surface =
        BodiesOfSurface { topology: &topology, mesh: &joint, body_of: &body_of, is_rigid: &is_rigid };
    add_bonds(scene, &joint, &topology, spec)?;

    let mut parts = Vec::new();
    for ((body, mesh), label_of) in scene.bodies.iter().zip(meshes).zip(labels) {
        parts.push(match &body.source {
            BodySource::Rigid(source) => BodyPart::Rigid { mesh, motion: source.motion.clone() },
            BodySource::Organ(source, own) => {
                let kind = source.model;
                if spec.body_contact.is_some() && kind.row().motion == ModelMotion::Mixed {
                    let (model, what) = (kind.name(), "contact with other bodies ([contact] bodies = false)");
                    return Err(of_body(&body.name)(ModelError::Unsupported { model, what }.into()));
                }
                let tables = OrganTables {
                    source,
                    supports: &own.supports,
                    ligaments: &own.ligaments,
                    loads: &own.loads,
                    mesh,
                    label_of,
                    may_float: kind.row().motion != ModelMotion::QuasiStatic,
                };
                let body = organ_without_stress(tables, scene, folder).map_err(of_body(&body.name))?;
                BodyPart::Organ { body: Box::new(body), kind }
            }
        });
    }
    for (body, part) in spec.bodies.iter_mut().zip(&parts) {
        body.tissue = if let BodyPart::Organ { body, .. } = part { Some(body.material) } else { None };
    }
    let places = match &spec.body_contact {
        Some(params) if params.touch_m > 0.0 => places_in_touch(params, &surface),
        _ => PlacesInTouch::default(),
    };
    let friction = spec.body_contact.as_ref().map_or(0.0, |params| params.friction);
    let memory = carry(&mut parts, &topology, &joint, &places, friction)
        .map_err(|(number, error)| of_body(&scene.bodies[number].name)(*error))?;
    Ok((BodySet::of_parts(parts, workers), memory))
}

/// What the attachments tie together, in the joint mesh.
fn add_bonds(
    scene: &Scene,
    joint: &TetMesh,
    topology: &Topology,
    spec: &mut WorldSpec,
) -> Result<(), BuildError> {
    for (number, source) in scene.attachments.iter().enumerate() {
        let found = bonds(source, &spec.bodies, joint, topology);
        if found.is_empty() {
            let names = source.bodies.map(|body| scene.bodies[body].name.clone());
            return Err(BuildError::NothingAttached {
                number: number + 1,
                names,
                reach_mm: 1e3 * source.reach_m,
            });
        }
        spec.bonds.extend(found);
    }
    Ok(())
}

fn body_specs(scene: &Scene, meshes: &[TetMesh]) -> Vec<BodySpec> {
    let (mut n_nodes, mut n_tets) = (0, 0);
    let mut specs = Vec::new();
    for (body, mesh) in scene.bodies.iter().zip(meshes) {
        let (node, tet) = (n_nodes, n_tets);
        n_nodes += mesh.positions_m.len() as u32;
        n_tets += mesh.tetrahedra.len() as u32;
        let own = if let BodySource::Organ(_, own) = &body.source { Some(own) } else { None };
        specs.push(BodySpec {
            name: body.name.clone(),
            color: body.color,
            is_rigid: own.is_none(),
            // Its material comes with the body.
            tissue: None,
            model: if let BodySource::Organ(source, _) = &body.source { Some(source.model) } else { None },
            nodes: node..n_nodes,
            tetrahedra: tet..n_tets,
            supports: own.map(|own| own.supports.clone()).unwrap_or_default(),
            ligaments: own.map(|own| own.ligaments.clone()).unwrap_or_default(),
            loads: own.map(|own| own.loads.clone()).unwrap_or_default(),
        });
    }
    specs
}

fn joined(meshes: &[TetMesh]) -> TetMesh {
    let mut joint = TetMesh::default();
    for mesh in meshes {
        let first = joint.positions_m.len();
        joint.positions_m.extend_from_slice(&mesh.positions_m);
        let moved = |corners: &[NodeId; 4]| corners.map(|n| NodeId::from_index(n.index() + first));
        joint.tetrahedra.extend(mesh.tetrahedra.iter().map(moved));
    }
    joint
}

fn read_rigid_mesh(source: &RigidSource, folder: &Path) -> Result<TetMesh, BuildError> {
    let edge_m = |longest_m: f64| source.edge_m.unwrap_or(longest_m / EDGES_ALONG);
    match &source.shape {
        RigidShape::File(file) => {
            let path = folder.join(file);
            let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
            // Legacy VTK holds either.
            if surface_extensions().contains(&&*extension) && extension != "vtk" {
                let surface = import_closed_surface(&path)?.mesh;
                return meshed(&surface, edge_m(longest(&surface.positions_m)));
            }
            let policy = ImportPolicy { faults: FaultAction::Refuse, ..ImportPolicy::default() };
            Ok(read_mesh_with(&path, &policy)?.0)
        }
        &RigidShape::Box { min_m, max_m } => {
            let size_m = max_m - min_m;
            let mut mesh = cells(size_m, edge_m(size_m.max_element()));
            mesh.positions_m.iter_mut().for_each(|p| *p += min_m);
            Ok(mesh)
        }
        &RigidShape::Slab { point_m, normal, size_m, thickness_m } => {
            let (across, along) = normal.any_orthonormal_pair();
            let frame = DMat3::from_cols(across, along, normal);
            let mut mesh = cells(DVec3::new(size_m, size_m, thickness_m), edge_m(size_m));
            let middle_m = DVec3::new(0.5 * size_m, 0.5 * size_m, thickness_m);
            mesh.positions_m.iter_mut().for_each(|p| *p = point_m + frame * (*p - middle_m));
            Ok(mesh)
        }
        &RigidShape::Ball { center_m, radius_m } => meshed(&ball(center_m, radius_m), edge_m(2.0 * radius_m)),
        &RigidShape::Cylinder { from_m, to_m, radius_m } => {
            let longest_m = from_m.distance(to_m).max(2.0 * radius_m);
            meshed(&cylinder(from_m, to_m, radius_m), edge_m(longest_m))
        }
    }
}

fn longest(positions_m: &[DVec3]) -> f64 {
    let bounds = Aabb::of_points(positions_m);
    (bounds.max_m - bounds.min_m).max_element()
}

fn meshed(surface: &TriMesh, edge_m: f64) -> Result<TetMesh, BuildError> {
    let params = MeshParams { size: WantedSize::EdgeM(edge_m), volume_m3: None };
    Ok(generate(surface, &params)?.0)
}

fn cells(size_m: DVec3, edge_m: f64) -> TetMesh {
    let cells = size_m.to_array().map(|side_m| (side_m / edge_m).round().clamp(1.0, MOST_CELLS) as usize);
    box_of_five(cells, size_m)
}

fn ball(center_m: DVec3, radius_m: f64) -> TriMesh {
    let (n_around, n_rings) = (N_AROUND, N_AROUND / 2);
    let mut surface = TriMesh::default();
    surface.positions_m.push(center_m + DVec3::Z * radius_m);
    for ring in 1..n_rings {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(n_rings);
        for i in 0..n_around {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n_around);
            let around = DVec3::new(libm::cos(angle), libm::sin(angle), 0.0) * libm::sin(polar);
            surface.positions_m.push(center_m + (around + DVec3::Z * libm::cos(polar)) * radius_m);
        }
    }
    surface.positions_m.push(center_m - DVec3::Z * radius_m);
    let last = surface.positions_m.len() as u32 - 1;
    let at = |ring: u32, i: u32| 1 + (ring - 1) * n_around + i % n_around;
    for i in 0..n_around {
        surface.triangles.push([0, at(1, i), at(1, i + 1)]);
        for ring in 1..n_rings - 1 {
            let (a, b) = (at(ring, i), at(ring, i + 1));
            let (c, d) = (at(ring + 1, i), at(ring + 1, i + 1));
            surface.triangles.extend([[a, c, d], [a, d, b]]);
        }
        surface.triangles.push([last, at(n_rings - 1, i + 1), at(n_rings - 1, i)]);
    }
    surface
}

fn cylinder(from_m: DVec3, to_m: DVec3, radius_m: f64) -> TriMesh {
    let axis = (to_m - from_m).normalize();
    let (x, y) = axis.any_orthonormal_pair();
    let n_around = N_AROUND;
    let mut surface = TriMesh::default();
    for end_m in [from_m, to_m] {
        for i in 0..n_around {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n_around);
            surface.positions_m.push(end_m + (x * libm::cos(angle) + y * libm::sin(angle)) * radius_m);
        }
    }
    let (base, top) = (2 * n_around, 2 * n_around + 1);
    surface.positions_m.extend([from_m, to_m]);
    for i in 0..n_around {
        let (a, b) = (i, (i + 1) % n_around);
        let (c, d) = (a + n_around, b + n_around);
        surface.triangles.extend([[a, b, d], [a, d, c], [base, b, a], [top, c, d]]);
    }
    surface
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_closed_and_have_their_volume() {
        let pi = std::f64::consts::PI;
        let file = Path::new("");
        let of = |shape: RigidShape| {
            let source = RigidSource { shape, edge_m: Some(0.01), motion: Default::default() };
            read_rigid_mesh(&source, file).unwrap()
        };
        let ball = of(RigidShape::Ball { center_m: DVec3::X, radius_m: 0.05 });
        assert!((ball.volume_m3() / (4.0 / 3.0 * pi * 0.05_f64.powi(3)) - 1.0).abs() < 0.01);
        let rod = RigidShape::Cylinder { from_m: DVec3::X, to_m: DVec3::X + DVec3::Y * 0.2, radius_m: 0.03 };
        assert!((of(rod).volume_m3() / (pi * 0.03 * 0.03 * 0.2) - 1.0).abs() < 0.01);
        let normal = DVec3::new(1.0, 2.0, -2.0).normalize();
        let (point_m, size_m, thickness_m) = (DVec3::new(0.1, 0.2, 0.3), 0.2, 0.02);
        let slab = of(RigidShape::Slab { point_m, normal, size_m, thickness_m });
        assert!((slab.volume_m3() / (0.2 * 0.2 * 0.02) - 1.0).abs() < 1e-9);
        let highest = slab.positions_m.iter().map(|p| (*p - point_m).dot(normal)).fold(f64::MIN, f64::max);
        assert!(highest.abs() < 1e-12, "the upper face goes through the point: {highest}");
        let middle: DVec3 = slab.positions_m.iter().sum::<DVec3>() / slab.positions_m.len() as f64;
        assert!((middle - point_m + normal * 0.01).length() < 1e-12);
    }
}
