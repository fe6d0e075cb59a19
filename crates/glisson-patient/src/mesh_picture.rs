//! Pictures of the tetrahedra: from any side, cut open, coloured by organ or by quality.

use anyhow::ensure;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::TetId;
use glisson::mesh::quality::FACES;
use glisson::surface::TriMesh;

use super::tetrahedra::{Meshed, QUALITY_STEPS, step_of};
use glisson_picture::{Camera, Look, Picture, PictureScene, ShadedSurface, SlicePlane, View};

/// Size of a picture [pixels].
const SIZE: [usize; 2] = [640, 420];
/// Share of a face that its edges leave to its colour.
const INNER_SHARE: f64 = 0.88;
/// Colour of edges.
const EDGE: [u8; 3] = [28, 30, 34];

/// Colours of organs inside, in turn.
const ORGANS: [[u8; 3]; 6] =
    [[176, 112, 96], [214, 190, 130], [110, 150, 120], [120, 130, 190], [190, 130, 170], [140, 160, 170]];

/// What faces are coloured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Colours {
    Organ,
    Quality,
}

/// How the tetrahedra are looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeshView {
    pub(super) azimuth_deg: f64,
    pub(super) elevation_deg: f64,
    /// A plane, and the share of the box along its normal from where on tetrahedra are left out.
    pub(super) cut: Option<(SlicePlane, f64)>,
    pub(super) colours: Colours,
}

/// Faces without common vertices, so that they look flat.
#[derive(Default)]
struct Flat {
    positions_m: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Flat {
    fn push(&mut self, corners_m: [DVec3; 3]) {
        let first = u32::try_from(self.positions_m.len()).expect("a picture has fewer than 2^32 vertices");
        self.positions_m.extend(corners_m);
        self.triangles.push([first, first + 1, first + 2]);
    }

    fn shaded(self, look: Look) -> ShadedSurface {
        let (positions_m, triangles) = (self.positions_m, self.triangles);
        ShadedSurface { rest_positions_m: positions_m.clone(), positions_m, triangles, look }
    }
}

impl Meshed {
    /// The picture as PNG.
    pub(super) fn picture_png(&self, view: &MeshView) -> anyhow::Result<Vec<u8>> {
        let numbers = [view.azimuth_deg, view.elevation_deg, view.cut.map_or(0.0, |(_, share)| share)];
        ensure!(numbers.iter().all(|x| x.is_finite()), "a number of the view is not finite");
        let direction = View {
            azimuth_rad: view.azimuth_deg.to_radians(),
            elevation_rad: view.elevation_deg.clamp(-89.0, 89.0).to_radians(),
        };
        let scene = PictureScene {
            surfaces: self.surfaces(view),
            instruments: Vec::new(),
            arrows: Vec::new(),
            captions: Vec::new(),
            camera: Camera::framing_points(&self.mesh.positions_m, SIZE, direction),
            size: SIZE,
        };
        Picture::render(&scene)?.png()
    }

    /// Outer faces of organs as they look; where the mesh is cut open, and for its quality, flat faces with their edges.
    fn surfaces(&self, view: &MeshView) -> Vec<ShadedSurface> {
        let is_left = self.is_left(view.cut);
        let n_organs = self.names.len();
        let mut outer: Vec<Vec<[u32; 3]>> = vec![Vec::new(); n_organs];
        let mut flat: Vec<Flat> = (0..n_organs.max(QUALITY_STEPS.len())).map(|_| Flat::default()).collect();
        let mut edges = Flat::default();
        for t in (0..is_left.len()).filter(|t| is_left[*t]) {
            let neighbours = self.topology.tet_neighbours(TetId::from_index(t));
            let nodes = self.mesh.tetrahedra[t];
            let organ = usize::from(self.label_of[t]) - 1;
            for (face, neighbour) in FACES.iter().zip(neighbours) {
                let beyond = neighbour.get();
                if beyond.is_some_and(|beyond| is_left[beyond.index()]) {
                    continue;
                }
                let corners = face.map(|corner| nodes[corner]);
                if view.colours == Colours::Organ && beyond.is_none() {
                    outer[organ].push(corners.map(|node| node.0));
                    continue;
                }
                let colour = match view.colours {
                    Colours::Organ => organ,
                    Colours::Quality => step_of(self.dihedral_deg[t]),
                };
                framed(corners.map(|n| self.mesh.positions_m[n.index()]), &mut flat[colour], &mut edges);
            }
        }
        let mut surfaces: Vec<ShadedSurface> = Vec::new();
        for (name, triangles) in self.names.iter().zip(outer).filter(|(_, triangles)| !triangles.is_empty()) {
            surfaces.push(self.compact(&triangles, Look::of_structure(name)));
        }
        for (at, faces) in flat.into_iter().enumerate().filter(|(_, faces)| !faces.triangles.is_empty()) {
            let colour = match view.colours {
                Colours::Organ => ORGANS[at % ORGANS.len()],
                Colours::Quality => QUALITY_STEPS[at].colour,
            };
            surfaces.push(faces.shaded(Look::Sign { colour }));
        }
        if !edges.triangles.is_empty() {
            surfaces.push(edges.shaded(Look::Sign { colour: EDGE }));
        }
        surfaces
    }

    /// Which tetrahedra the cut leaves: those whose middle is behind the plane, seen from the front, the feet or the patient's right.
    fn is_left(&self, cut: Option<(SlicePlane, f64)>) -> Vec<bool> {
        let n_tets = self.mesh.tetrahedra.len();
        let Some((plane, share)) = cut else { return vec![true; n_tets] };
        let towards = match plane {
            SlicePlane::Axial => DVec3::NEG_Z,
            SlicePlane::Coronal => DVec3::NEG_Y,
            SlicePlane::Sagittal => DVec3::NEG_X,
        };
        let bounds = Aabb::of_points(&self.mesh.positions_m);
        let ends = [bounds.min_m.dot(towards), bounds.max_m.dot(towards)];
        let (far, near) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        let limit = near - share.clamp(0.0, 1.0) * (near - far);
        let middle = |t| self.mesh.corners_m(TetId::from_index(t)).iter().sum::<DVec3>() / 4.0;
        (0..n_tets).map(|t| middle(t).dot(towards) <= limit).collect()
    }

    /// Triangles of the mesh's nodes over their own vertices.
    fn compact(&self, triangles: &[[u32; 3]], look: Look) -> ShadedSurface {
        let TriMesh { positions_m, triangles } = TriMesh::over(&self.mesh.positions_m, triangles);
        ShadedSurface { rest_positions_m: positions_m.clone(), positions_m, triangles, look }
    }
}

/// A face in its colour, with a frame of edges.
fn framed(corners_m: [DVec3; 3], inside: &mut Flat, edges: &mut Flat) {
    let middle = corners_m.iter().sum::<DVec3>() / 3.0;
    let inner = corners_m.map(|corner| middle.lerp(corner, INNER_SHARE));
    inside.push(inner);
    for (a, b) in [(0, 1), (1, 2), (2, 0)] {
        edges.push([corners_m[a], corners_m[b], inner[b]]);
        edges.push([corners_m[a], inner[b], inner[a]]);
    }
}
