//! What was cut out around a ball of tissue, such as a tumour, and with which margin.

use crate::math::{DVec3, closest_point_barycentric};
use crate::mesh::TetId;
use crate::mesh::topology::{Pieces, Through};
use crate::world::World;

/// What is to be cut out: a ball of the tissue at rest.
#[derive(Clone, Debug)]
pub(super) struct Excision {
    center_m: DVec3,
    radius_m: f64,
    body: u32,
    pieces: Pieces,
    volumes_m3: Vec<f64>,
}

/// What was cut out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Excised {
    /// Volume at rest of the pieces that hold tissue of the ball, and hang together with nothing else [m3].
    pub specimen_m3: f64,
    /// Least and mean distance of the faces of cuts of these pieces from the ball, at rest [m]: negative where a cut went into it. None
    /// without such a face.
    pub margins_m: Option<[f64; 2]>,
}

impl Excision {
    /// A ball in a world at rest; none where it holds no tissue.
    pub(super) fn new(center_m: DVec3, radius_m: f64, world: &World) -> Option<Self> {
        let mut new = Self { center_m, radius_m, body: 0, pieces: Pieces::default(), volumes_m3: Vec::new() };
        let topology = world.organ().body().topology();
        let inside = topology.live_tets().find(|&tet| new.holds(tet, world))?;
        new.body = world.organ().body_of_nodes()[topology.tet_nodes(inside)[0].index()];
        Some(new)
    }

    /// Whether the middle of a tetrahedron at rest is in the ball.
    fn holds(&self, tet: TetId, world: &World) -> bool {
        let corners_m = world.organ().mesh().corners_m(tet);
        (corners_m.into_iter().sum::<DVec3>() * 0.25).distance(self.center_m) <= self.radius_m
    }

    /// What is cut out now: none while tissue of the ball hangs together, through faces, with the greatest piece of its organ.
    pub(super) fn look(&mut self, world: &World) -> Option<Excised> {
        let organ = world.organ();
        let topology = organ.body().topology();
        topology.pieces_into(Through::Faces, &mut self.pieces);
        let piece_of = |tet: TetId| self.pieces.of_tet[tet.index()] as usize;
        let is_of_body = |tet: TetId| organ.body_of_nodes()[topology.tet_nodes(tet)[0].index()] == self.body;
        self.volumes_m3.clear();
        self.volumes_m3.resize(self.pieces.count(), 0.0);
        let of_body = topology.live_tets().filter(|&tet| is_of_body(tet));
        of_body.for_each(|tet| self.volumes_m3[piece_of(tet)] += organ.mesh().tet_volume_m3(tet));
        let volumes_m3 = self.volumes_m3.iter().enumerate();
        let (greatest, _) = volumes_m3.max_by(|a, b| a.1.total_cmp(b.1))?;
        let mut is_specimen = vec![false; self.pieces.count()];
        for tet in topology.live_tets().filter(|&tet| self.holds(tet, world) && is_of_body(tet)) {
            is_specimen[piece_of(tet)] = true;
        }
        if is_specimen[greatest] || !is_specimen.contains(&true) {
            return None;
        }
        let of_specimen = self.volumes_m3.iter().zip(&is_specimen).filter(|(_, is_specimen)| **is_specimen);
        let specimen_m3 = of_specimen.map(|(volume_m3, _)| volume_m3).sum();
        let (mut least_m, mut sum_m3, mut area_m2) = (f64::INFINITY, 0.0, 0.0);
        for triangle in topology.surface_triangles().filter(|&triangle| organ.is_cut(triangle)) {
            let behind = topology.triangle_tets(triangle).into_iter().find_map(|tet| tet.get());
            if !behind.is_some_and(|tet| is_specimen[piece_of(tet)]) {
                continue;
            }
            let corners_m =
                topology.triangle_nodes(triangle).map(|node| organ.mesh().positions_m[node.index()]);
            let weights = closest_point_barycentric(self.center_m, corners_m);
            let nearest_m: DVec3 = corners_m.iter().zip(weights).map(|(corner_m, w)| *corner_m * w).sum();
            least_m = least_m.min(nearest_m.distance(self.center_m) - self.radius_m);
            let middle_m = corners_m.iter().sum::<DVec3>() / 3.0;
            let [a, b, c] = corners_m;
            let triangle_m2 = 0.5 * (b - a).cross(c - a).length();
            sum_m3 += triangle_m2 * (middle_m.distance(self.center_m) - self.radius_m);
            area_m2 += triangle_m2;
        }
        let margins_m = (area_m2 > 0.0).then(|| [least_m, sum_m3 / area_m2]);
        Some(Excised { specimen_m3, margins_m })
    }
}
