//! The meshes of bodies: read from files, or made of simple solids and of organs of the synthetic patient.

use super::build_error::BuildError;
use super::shape::{BodyShape, PhantomOrgan, ShapeSource, TubePath};
use super::solids::{ball, cylinder, tube};
use crate::image::LabelMap;
use crate::image::labels::Parts;
use crate::image::phantom::{PhantomParams, PhantomTruth, truth};
use crate::image::vessels::Tube;
use crate::math::{Aabb, DMat3, DVec3};
use crate::mesh::TetMesh;
use crate::mesh::box_mesh::box_of_five;
use crate::mesh::faults::{FaultAction, ImportPolicy};
use crate::mesh::files::read_mesh_with;
use crate::mesh::generate::{MeshParams, MeshPlan, WantedSize, generate};
use crate::mesh::organs::{Grading, OrganMeshParams, OrganSize, mesh_organs};
use crate::mesh::stuffing::WantedTopology;
use crate::surface::TriMesh;
use crate::surface::extract::{SurfaceParams, surface_of_mask};
use crate::surface::files::{import_closed_surface, surface_extensions};
use crate::surface::repair::{RepairParams, repair};
use std::path::Path;

/// A solid without an edge length of its own has so many edges along its longest side: a choice.
const EDGES_ALONG: f64 = 12.0;
/// Cells along a side of a box at most: a choice.
const MOST_CELLS: f64 = 64.0;

/// Makes the meshes of a scene's bodies; each synthetic patient once.
pub(super) struct ShapeBuilder<'a> {
    /// Folder that files are relative to.
    folder: &'a Path,
    patients: Vec<(u64, PhantomTruth)>,
}

/// What may stand in a mesh file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileKind {
    /// Tetrahedra.
    Tetrahedra,
    /// These, or a closed surface that is filled with them.
    SurfaceToo,
}

impl<'a> ShapeBuilder<'a> {
    pub(super) fn new(folder: &'a Path) -> Self {
        Self { folder, patients: Vec::new() }
    }

    /// The mesh with the labels of its tetrahedra, if it has any.
    pub(super) fn mesh(
        &mut self,
        source: &ShapeSource,
        files: FileKind,
    ) -> Result<(TetMesh, Vec<i64>), BuildError> {
        let edge_m = |longest_m: f64| source.edge_m.unwrap_or(longest_m / EDGES_ALONG);
        let mesh = match &source.shape {
            BodyShape::File { file, unit } => {
                let path = self.folder.join(file);
                let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
                let extension = extension.unwrap_or_default();
                // Legacy VTK holds either.
                let is_surface = surface_extensions().contains(&&*extension) && extension != "vtk";
                if files == FileKind::SurfaceToo && is_surface {
                    let surface = import_closed_surface(&path)?.mesh;
                    meshed(&surface, edge_m(longest(&surface.positions_m)))?
                } else {
                    let policy =
                        ImportPolicy { faults: FaultAction::Refuse, unit: *unit, ..ImportPolicy::default() };
                    let (mesh, report) = read_mesh_with(&path, &policy)?;
                    return Ok((mesh, report.label_of));
                }
            }
            BodyShape::Phantom(organ) => return self.phantom_organ(organ),
            &BodyShape::Box { min_m, max_m } => {
                let size_m = max_m - min_m;
                let mut mesh = cells(size_m, edge_m(size_m.max_element()));
                mesh.positions_m.iter_mut().for_each(|p| *p += min_m);
                mesh
            }
            &BodyShape::Slab { point_m, normal, size_m, thickness_m } => {
                let (across, along) = normal.any_orthonormal_pair();
                let frame = DMat3::from_cols(across, along, normal);
                let mut mesh = cells(DVec3::new(size_m, size_m, thickness_m), edge_m(size_m));
                let middle_m = DVec3::new(0.5 * size_m, 0.5 * size_m, thickness_m);
                mesh.positions_m.iter_mut().for_each(|p| *p = point_m + frame * (*p - middle_m));
                mesh
            }
            &BodyShape::Ball { center_m, radius_m } => {
                meshed(&ball(center_m, radius_m), edge_m(2.0 * radius_m))?
            }
            &BodyShape::Cylinder { from_m, to_m, radius_m } => {
                let longest_m = from_m.distance(to_m).max(2.0 * radius_m);
                meshed(&cylinder(from_m, to_m, radius_m), edge_m(longest_m))?
            }
            BodyShape::Tube { stem, branches } => {
                let surface = branched(stem, branches)?;
                let edge_m = edge_m(longest(&surface.positions_m));
                let plan = MeshPlan::new(&surface, &with_edges(edge_m))?;
                let plan =
                    if branches.is_empty() { plan } else { plan.with_topology(topology_of(stem, branches)) };
                let mesh = plan.fill(&plan.distance_field(&surface)?)?.0;
                std::iter::once(stem)
                    .chain(branches)
                    .try_for_each(|path| check_whole(path, &mesh, edge_m))?;
                mesh
            }
        };
        Ok((mesh, Vec::new()))
    }

    /// The vessels of the organ that has them, if it is one of the synthetic patient.
    pub(super) fn vessels(&mut self, source: &ShapeSource) -> Vec<Tube> {
        match &source.shape {
            BodyShape::Phantom(organ) if organ.has_vessels => self.patient(organ.seed).vessels.clone(),
            _ => Vec::new(),
        }
    }

    fn patient(&mut self, seed: u64) -> &PhantomTruth {
        let known = self.patients.iter().position(|(known, _)| *known == seed);
        let at = known.unwrap_or_else(|| {
            self.patients.push((seed, truth(seed, PhantomParams::default().voxel_m)));
            self.patients.len() - 1
        });
        &self.patients[at].1
    }

    fn phantom_organ(&mut self, organ: &PhantomOrgan) -> Result<(TetMesh, Vec<i64>), BuildError> {
        let labels = &self.patient(organ.seed).labels;
        let selection = labels.select(organ.organ.name(), Parts::Included)?;
        if organ.parts.is_empty() && organ.finer.is_none() {
            let mask = labels.mask(&selection);
            let params = SurfaceParams { cap_at_border: true, ..SurfaceParams::default() };
            let (surface, _) = surface_of_mask(&labels.grid, &mask, &params)?;
            let size = WantedSize::Tetrahedra(organ.n_tetrahedra);
            let params = MeshParams { size, volume_m3: Some(labels.volume_m3(&selection)) };
            return Ok((generate(&surface, &params)?.0, Vec::new()));
        }
        let map = with_parts_alone(labels, &selection.labels, organ);
        let wanted = std::iter::once(organ.organ).chain(organ.parts.iter().copied());
        let params = OrganMeshParams {
            labels: wanted.map(|tissue| tissue.label()).collect(),
            size: OrganSize::Tetrahedra(organ.n_tetrahedra),
            grading: Grading { balls: organ.finer.into_iter().collect(), ..Grading::default() },
        };
        let made = mesh_organs(&map, &params)?;
        Ok((made.mesh, made.label_of.into_iter().map(i64::from).collect()))
    }
}

/// The map with the organ in one, but for the parts that keep a label.
fn with_parts_alone(labels: &LabelMap, of_organ: &[u16], organ: &PhantomOrgan) -> LabelMap {
    let mut map = labels.clone();
    let kept: Vec<u16> = organ.parts.iter().map(|part| part.label()).collect();
    for label in &mut map.labels {
        if of_organ.contains(label) && !kept.contains(label) {
            *label = organ.organ.label();
        }
    }
    map
}

/// The surface of all tubes together.
fn branched(stem: &TubePath, branches: &[TubePath]) -> Result<TriMesh, BuildError> {
    let of = |path: &TubePath| tube(&path.path_m, &path.radii_m);
    let mut all = of(stem);
    for branch in branches.iter().map(of) {
        let first = all.positions_m.len() as u32;
        all.positions_m.extend(branch.positions_m);
        all.triangles.extend(branch.triangles.iter().map(|corners| corners.map(|corner| first + corner)));
    }
    if branches.is_empty() {
        return Ok(all);
    }
    let radii_m = std::iter::once(stem).chain(branches).flat_map(|path| path.radii_m.iter().copied());
    let params = RepairParams { smallest_feature_m: radii_m.reduce(f64::min), ..RepairParams::default() };
    // Pieces that cross become their union.
    let (surface, report) = repair(&all, &params).map_err(|error| BuildError::Branches(error.to_string()))?;
    if report.n_pieces != 1 {
        let found = format!("{} parts that do not touch", report.n_pieces);
        return Err(BuildError::Branches(format!("{found}; let each branch begin or end in the tube")));
    }
    Ok(surface)
}

/// What the tubes are together: a ball, with a tunnel for each branch that begins and ends in the stem or in branches before it. Where two come
/// close, their common surface can have tunnels narrower than its triangles, which are not meant.
fn topology_of(stem: &TubePath, branches: &[TubePath]) -> WantedTopology {
    let mut n_tunnels = 0;
    for (at, branch) in branches.iter().enumerate() {
        let others = || std::iter::once(stem).chain(&branches[..at]);
        let [first_m, last_m] = [branch.path_m[0], branch.path_m[branch.path_m.len() - 1]];
        let is_in = |end_m: DVec3| others().any(|other| is_in_tube(end_m, other));
        n_tunnels += i64::from(is_in(first_m) && is_in(last_m));
    }
    WantedTopology { surface_euler_characteristic: 2 - 2 * n_tunnels, ..WantedTopology::BALL }
}

/// Checks that a tube that is thinner than its tetrahedra is there at the points of its path.
fn check_whole(path: &TubePath, mesh: &TetMesh, edge_m: f64) -> Result<(), BuildError> {
    for (point_m, radius_m) in path.path_m.iter().zip(&path.radii_m) {
        let near_m =
            mesh.positions_m.iter().map(|node_m| node_m.distance(*point_m)).fold(f64::INFINITY, f64::min);
        if near_m > radius_m + edge_m {
            return Err(BuildError::ThinTube {
                place_mm: 1e3 * *point_m,
                radius_mm: 1e3 * radius_m,
                edge_mm: 1e3 * edge_m,
            });
        }
    }
    Ok(())
}

/// Whether a point is in a tube, whose radius changes evenly between the points of its path.
fn is_in_tube(point_m: DVec3, tube: &TubePath) -> bool {
    tube.path_m.windows(2).zip(tube.radii_m.windows(2)).any(|(ends_m, radii_m)| {
        let (from_m, along_m) = (ends_m[0], ends_m[1] - ends_m[0]);
        let share = ((point_m - from_m).dot(along_m) / along_m.length_squared()).clamp(0.0, 1.0);
        point_m.distance(from_m + share * along_m) <= radii_m[0] + share * (radii_m[1] - radii_m[0])
    })
}

fn longest(positions_m: &[DVec3]) -> f64 {
    let bounds = Aabb::of_points(positions_m);
    (bounds.max_m - bounds.min_m).max_element()
}

fn meshed(surface: &TriMesh, edge_m: f64) -> Result<TetMesh, BuildError> {
    Ok(generate(surface, &with_edges(edge_m))?.0)
}

fn with_edges(edge_m: f64) -> MeshParams {
    MeshParams { size: WantedSize::EdgeM(edge_m), volume_m3: None }
}

fn cells(size_m: DVec3, edge_m: f64) -> TetMesh {
    let cells = size_m.to_array().map(|side_m| (side_m / edge_m).round().clamp(1.0, MOST_CELLS) as usize);
    box_of_five(cells, size_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::phantom::Tissue;

    #[test]
    fn shapes_are_closed_and_have_their_volume() {
        let pi = std::f64::consts::PI;
        let file = Path::new("");
        let of = |shape: BodyShape| {
            let source = ShapeSource { shape, edge_m: Some(0.01) };
            ShapeBuilder::new(file).mesh(&source, FileKind::Tetrahedra).unwrap().0
        };
        let ball = of(BodyShape::Ball { center_m: DVec3::X, radius_m: 0.05 });
        assert!((ball.volume_m3() / (4.0 / 3.0 * pi * 0.05_f64.powi(3)) - 1.0).abs() < 0.01);
        let rod = BodyShape::Cylinder { from_m: DVec3::X, to_m: DVec3::X + DVec3::Y * 0.2, radius_m: 0.03 };
        assert!((of(rod).volume_m3() / (pi * 0.03 * 0.03 * 0.2) - 1.0).abs() < 0.01);
        let normal = DVec3::new(1.0, 2.0, -2.0).normalize();
        let (point_m, size_m, thickness_m) = (DVec3::new(0.1, 0.2, 0.3), 0.2, 0.02);
        let slab = of(BodyShape::Slab { point_m, normal, size_m, thickness_m });
        assert!((slab.volume_m3() / (0.2 * 0.2 * 0.02) - 1.0).abs() < 1e-9);
        let highest = slab.positions_m.iter().map(|p| (*p - point_m).dot(normal)).fold(f64::MIN, f64::max);
        assert!(highest.abs() < 1e-12, "the upper face goes through the point: {highest}");
        let middle: DVec3 = slab.positions_m.iter().sum::<DVec3>() / slab.positions_m.len() as f64;
        assert!((middle - point_m + normal * 0.01).length() < 1e-12);
    }

    #[test]
    fn a_tube_with_a_branch_is_one_body_of_both_volumes_and_loose_branches_are_refused() {
        let tube = |from_m: DVec3, to_m: DVec3, radius_m: f64| TubePath {
            path_m: vec![from_m, to_m],
            radii_m: vec![radius_m; 2],
        };
        let stem = tube(DVec3::ZERO, DVec3::Z * 0.1, 0.012);
        let branch = tube(DVec3::Z * 0.05, DVec3::new(0.06, 0.0, 0.05), 0.003);
        let source = |branch| ShapeSource {
            shape: BodyShape::Tube { stem: stem.clone(), branches: vec![branch] },
            edge_m: Some(0.005),
        };
        let mut shapes = ShapeBuilder::new(Path::new(""));
        let (mesh, _) = shapes.mesh(&source(branch), FileKind::Tetrahedra).unwrap();
        let pi = std::f64::consts::PI;
        let of_stem_m3 = pi * 0.012 * 0.012 * 0.1 + 4.0 / 3.0 * pi * 0.012_f64.powi(3);
        // What sticks out of the stem, with its rounded end.
        let of_branch_m3 = pi * 0.003 * 0.003 * 0.048 + 2.0 / 3.0 * pi * 0.003_f64.powi(3);
        let volume_m3 = mesh.volume_m3();
        assert!((volume_m3 / (of_stem_m3 + of_branch_m3) - 1.0).abs() < 0.02, "{volume_m3}");
        assert!(mesh.positions_m.iter().any(|p| p.x > 0.06));
        let loose = tube(DVec3::X * 0.05, DVec3::new(0.05, 0.0, 0.1), 0.003);
        let error = shapes.mesh(&source(loose), FileKind::Tetrahedra).unwrap_err().to_string();
        assert!(error.contains("2 parts that do not touch"), "{error}");
    }

    #[test]
    fn ducts_thinner_than_the_tetrahedra_are_whole_and_stay_apart() {
        let mm = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * 1e-3;
        // A gall bladder whose artery leaves its neck at so flat an angle that their surfaces meet again.
        let stem = TubePath {
            path_m: vec![
                mm(-7.0, -14.0, -12.0),
                mm(0.0, 0.0, 0.0),
                mm(9.0, 0.0, -5.0),
                mm(16.5, 0.0, -9.0),
                mm(40.0, 6.0, -16.0),
            ],
            radii_m: vec![12.5e-3, 10e-3, 6e-3, 2.5e-3, 2.5e-3],
        };
        let artery = TubePath {
            path_m: vec![
                mm(5.0, 0.0, -2.8),
                mm(12.5, -6.5, -3.5),
                mm(24.0, -10.0, -4.0),
                mm(38.0, -8.0, -6.0),
            ],
            radii_m: vec![2e-3; 4],
        };
        for edge_m in [4.5e-3, 5e-3, 6e-3] {
            let shape = BodyShape::Tube { stem: stem.clone(), branches: vec![artery.clone()] };
            let source = ShapeSource { shape, edge_m: Some(edge_m) };
            let mesh = ShapeBuilder::new(Path::new("")).mesh(&source, FileKind::Tetrahedra).unwrap().0;
            for path in [&stem, &artery] {
                let end_m = path.path_m[path.path_m.len() - 1];
                let away_m = mesh.positions_m.iter().map(|p| p.distance(end_m)).fold(f64::INFINITY, f64::min);
                assert!(away_m < 3e-3, "{edge_m}: a duct ends {away_m} m before its end");
            }
            let quality = crate::mesh::quality::MeshQuality::of(&mesh);
            assert_eq!((quality.surface_pieces, quality.surface_euler_characteristic), (1, 2), "{edge_m}");
            // Nothing between the ducts.
            let middle_m = mm(34.0, -2.0, -10.0);
            let nearest_m =
                mesh.positions_m.iter().map(|p| p.distance(middle_m)).fold(f64::INFINITY, f64::min);
            assert!(nearest_m > 2.5e-3, "{edge_m}: tissue {nearest_m} m from the middle between the ducts");
        }
        let shape = BodyShape::Tube { stem: stem.clone(), branches: vec![artery.clone()] };
        let source = ShapeSource { shape, edge_m: Some(9e-3) };
        let error =
            ShapeBuilder::new(Path::new("")).mesh(&source, FileKind::Tetrahedra).unwrap_err().to_string();
        assert!(
            error.contains("is lost between tetrahedra with edges of 9.0 mm; take a shorter edge"),
            "{error}"
        );
        let back = TubePath {
            path_m: vec![mm(5.0, 0.0, -2.8), mm(20.0, 30.0, 0.0), mm(40.0, 6.0, -16.0)],
            radii_m: vec![4e-3; 3],
        };
        let euler =
            |branch: &TubePath| topology_of(&stem, std::slice::from_ref(branch)).surface_euler_characteristic;
        assert_eq!((euler(&artery), euler(&back)), (2, 0), "a branch that comes back makes a tunnel");
    }

    fn phantom(n_tetrahedra: usize, parts: Vec<Tissue>) -> ShapeSource {
        let organ = PhantomOrgan {
            organ: Tissue::Liver,
            seed: 3,
            n_tetrahedra,
            parts,
            has_vessels: true,
            finer: None,
        };
        ShapeSource { shape: BodyShape::Phantom(organ), edge_m: None }
    }

    #[test]
    fn organs_of_the_phantom_have_their_volume_their_parts_and_their_vessels() {
        let mut shapes = ShapeBuilder::new(Path::new(""));
        let truth = truth(3, PhantomParams::default().voxel_m);
        let volume_m3 =
            |name: &str, parts| truth.labels.volume_m3(&truth.labels.select(name, parts).unwrap());
        let liver_m3 = volume_m3("liver", Parts::Included);

        let (mesh, labels) = shapes.mesh(&phantom(2000, Vec::new()), FileKind::Tetrahedra).unwrap();
        assert!(labels.is_empty());
        assert!((mesh.volume_m3() / liver_m3 - 1.0).abs() < 1e-3);
        assert!((mesh.tetrahedra.len() as f64 / 2000.0 - 1.0).abs() < 0.05);

        let source = phantom(20_000, vec![Tissue::LiverTumour]);
        let (mesh, labels) = shapes.mesh(&source, FileKind::Tetrahedra).unwrap();
        assert!((mesh.volume_m3() / liver_m3 - 1.0).abs() < 5e-3);
        let is_tumour = |label: &i64| *label == i64::from(Tissue::LiverTumour.label());
        let tets = labels.iter().zip(&mesh.tetrahedra).filter(|(label, _)| is_tumour(label));
        let corners = |tet: &[crate::mesh::NodeId; 4]| tet.map(|node| mesh.positions_m[node.index()]);
        let tumour_m3: f64 = tets.map(|(_, tet)| crate::math::tetrahedron_volume_m3(corners(tet))).sum();
        let wanted_m3 = volume_m3("liver_tumour", Parts::Excluded);
        assert!((tumour_m3 / wanted_m3 - 1.0).abs() < 0.05, "{tumour_m3} of {wanted_m3}");
        assert_eq!(shapes.vessels(&source), truth.vessels);
        assert_eq!(shapes.patients.len(), 1, "one patient is made once");
    }
}
