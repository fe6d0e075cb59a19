//! Blood vessels inside an organ: what a cut opens, how fast it bleeds, and clips that close it.
//!
//! A tree of straight tubes lies in the rest shape and moves with the tetrahedra around it; it has no stiffness of its
//! own. A tube is severed where a triangle of a cut crosses its axis; the organ's own skin severs none. Blood comes out on the side of the
//! root alone, in liver the trunk of the portal vein or the hepatic vein at the vena cava; what lies beyond has lost its
//! supply. The rate follows Murray's law, by which the flow of a vessel goes with the cube of its diameter (Murray 1926,
//! doi 10.1073/pnas.12.3.207), scaled to the portal vein: an open end lets out what the vessel carried.

use super::clip::Clip;
pub use super::clip::ClipApplier;
use super::site::{Site, site_of};
use crate::image::vessels::{Tube, TubeError, check_tube};
use crate::math::{Aabb, DVec3, tetrahedron_volume_m3};
use crate::mesh::edit::{EditableMesh, TopologyChange};
use crate::mesh::{NodeId, TetId, TriangleId};
use crate::record::snapshot::{BleedingEnd, BleedingSnapshot};
use crate::surface::intersect::segment_meets_triangle;

/// Flow in the portal vein [m3/s]: 13.5 ml a minute for each kilogram of body weight (Carlisle et al. 1992,
/// Gut 33:92-97) at the 73 kg of the reference man (ICRP Publication 89, 2002).
pub const PORTAL_FLOW_M3_PER_S: f64 = 13.5e-6 * 73.0 / 60.0;
/// Mean diameter of the portal vein of healthy adults [m] (Stamm et al. 2016, doi 10.1007/s00261-016-0785-9: 15.5 +- 1.9 mm).
pub const PORTAL_DIAMETER_M: f64 = 15.5e-3;

/// Blood from an open end [m3/s].
pub fn bleeding_m3_per_s(diameter_m: f64) -> f64 {
    let share = diameter_m / PORTAL_DIAMETER_M;
    PORTAL_FLOW_M3_PER_S * share * share * share
}

/// An open end, closed by a clip or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenEnd {
    /// Which tube.
    pub tube: u32,
    /// Where on it, 0 to 1.
    pub along: f64,
    /// Diameter there [m].
    pub diameter_m: f64,
    /// Blood that comes out [m3/s].
    pub rate_m3_per_s: f64,
    site: Option<Site>,
    rest_m: DVec3,
}

/// The vessels of one organ.
#[derive(Clone, Debug, Default)]
pub struct Vessels {
    tubes: Vec<Tube>,
    bounds: Vec<Aabb>,
    /// Nearest cut to the root on each tube, 0 to 1.
    cut_along: Vec<Option<f64>>,
    /// Clips on each tube, nearest to the root first.
    clips: Vec<Vec<Clip>>,
    /// Middle of each tube.
    middles: Vec<Option<Site>>,
    open: Vec<OpenEnd>,
    bleeding_m3_per_s: f64,
    lost_m3: f64,
    /// Tubes that tore by themselves, and where: no undoing of a cut mends them.
    tears: Vec<(usize, f64)>,
}

/// Two cuts nearer than this on a tube are one [m].
const SAME_PLACE_M: f64 = 1e-6;

impl Vessels {
    /// Vessels in an organ; parts outside of it are not cut.
    ///
    /// # Errors
    /// The first tube that makes no sense, by number, and why.
    pub fn new(tubes: Vec<Tube>, body: &EditableMesh) -> Result<Self, (usize, TubeError)> {
        for (i, tube) in tubes.iter().enumerate() {
            check_tube(i, tube).map_err(|error| (i, error))?;
        }
        let n = tubes.len();
        let bounds = tubes.iter().map(|tube| Aabb::of_points(&tube.ends_m)).collect();
        let middles = tubes.iter().map(|tube| site_of(body, tube.point_m(0.5))).collect();
        Ok(Self {
            tubes,
            bounds,
            cut_along: vec![None; n],
            clips: vec![Vec::new(); n],
            middles,
            ..Self::default()
        })
    }

    /// The tubes, in the rest shape.
    pub fn tubes(&self) -> &[Tube] {
        &self.tubes
    }

    /// Ends that bleed.
    pub fn open_ends(&self) -> &[OpenEnd] {
        &self.open
    }

    /// Blood that is lost now [m3/s].
    pub fn bleeding_m3_per_s(&self) -> f64 {
        self.bleeding_m3_per_s
    }

    /// Blood lost so far [m3].
    pub fn lost_m3(&self) -> f64 {
        self.lost_m3
    }

    /// Where a tube is severed nearest to the root, 0 to 1 along it.
    pub fn severed_along(&self, tube: usize) -> Option<f64> {
        self.cut_along[tube]
    }

    /// Where the middle of a tube is now [m]; none where it is in no tissue.
    pub fn middle_m(&self, tube: usize, body: &EditableMesh, positions_m: &[DVec3]) -> Option<DVec3> {
        self.middles[tube].map(|site| site.place_m(body, positions_m))
    }

    /// Where clips are in the rest shape [m].
    pub fn clips_at_rest_m(&self) -> impl Iterator<Item = DVec3> + '_ {
        let all = self.tubes.iter().zip(&self.clips);
        all.flat_map(|(tube, clips)| Self::set(clips).map(|clip| tube.point_m(clip.along)))
    }

    /// Number of clips set.
    pub fn n_clips(&self) -> usize {
        self.clips.iter().map(|clips| Self::set(clips).count()).sum()
    }

    /// Clips, without threads.
    fn set(clips: &[Clip]) -> impl Iterator<Item = &Clip> {
        clips.iter().filter(|clip| !clip.is_thread)
    }

    /// Everything that bleeding depends on and is not told by the mesh.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let cuts = self.cut_along.iter().map(|along| along.unwrap_or(-1.0));
        let clips = self
            .clips
            .iter()
            .flat_map(|of_tube| std::iter::once(of_tube.len() as f64).chain(of_tube.iter().map(|c| c.along)));
        [self.lost_m3].into_iter().chain(cuts).chain(clips)
    }

    /// Writes what bleeds now, and the clips; allocates the first time, and after clips were set.
    pub fn bleeding_into(&self, body: &EditableMesh, positions_m: &[DVec3], out: &mut BleedingSnapshot) {
        out.has_vessels = true;
        out.lost_m3 = self.lost_m3;
        out.rate_m3_per_s = self.bleeding_m3_per_s;
        out.n_clips = self.n_clips() as u32;
        out.ends.clear();
        // A tube has one open end at most.
        out.ends.reserve(self.tubes.len());
        out.ends.extend(self.open.iter().map(|end| BleedingEnd {
            position_m: self.end_position_m(end, body, positions_m),
            rate_m3_per_s: end.rate_m3_per_s,
        }));
        let clips = self.tubes.iter().zip(&self.clips).flat_map(|(tube, clips)| {
            clips.iter().filter_map(move |clip| clip.snapshot(tube, body, positions_m))
        });
        out.clips.clear();
        out.clips.extend(clips);
    }

    /// Blood goes on flowing for `dt_s`.
    pub fn advance(&mut self, dt_s: f64) {
        self.lost_m3 += self.bleeding_m3_per_s * dt_s;
    }

    /// Where an open end is now [m].
    pub fn end_position_m(&self, end: &OpenEnd, body: &EditableMesh, positions_m: &[DVec3]) -> DVec3 {
        end.site.map_or(end.rest_m, |site| site.place_m(body, positions_m))
    }

    /// Follows an edit: what came to the surface may have severed tubes. Answers how many. Allocates. `is_cut` tells triangles
    /// in cuts from the organ's own skin, through which vessels enter it: skin that is divided or moved severs none.
    pub fn follow(
        &mut self,
        body: &EditableMesh,
        change: &TopologyChange,
        is_cut: impl Fn(TriangleId) -> bool,
    ) -> usize {
        let topology = body.topology();
        let rest_m = &body.mesh().positions_m;
        let mut n_severed = 0;
        // A surface whose nodes moved may have come over a tube as well as one that is new.
        let is_moved = |node: &NodeId| change.moved_nodes.binary_search(node).is_ok();
        let moved = change.moved_nodes.iter().flat_map(|&node| topology.surface_triangles_at(node));
        for triangle in change.surface_triangles_added.iter().copied().chain(moved).filter(|&t| is_cut(t)) {
            let corners_m = topology.triangle_nodes(triangle).map(|n| rest_m[n.index()]);
            let around = Aabb::of_points(&corners_m);
            for (i, tube) in self.tubes.iter().enumerate() {
                if !overlap(&around, &self.bounds[i]) {
                    continue;
                }
                let Some(along) = crossing(tube.ends_m, corners_m) else { continue };
                let tolerance = SAME_PLACE_M / tube.ends_m[0].distance(tube.ends_m[1]);
                if self.cut_along[i].is_none_or(|known| along < known - tolerance) {
                    n_severed += 1;
                    self.cut_along[i] = Some(along);
                }
            }
        }
        let is_lost = |tet: TetId| !topology.is_live_tet(tet) || topology.tet_nodes(tet).iter().any(is_moved);
        if change.is_renumbering() || !change.tets.removed.is_empty() || !change.moved_nodes.is_empty() {
            for (site, tube) in self.middles.iter_mut().zip(&self.tubes) {
                if change.is_renumbering() || site.is_some_and(|site| is_lost(site.tet)) {
                    *site = site_of(body, tube.point_m(0.5));
                }
            }
            for (clips, tube) in self.clips.iter_mut().zip(&self.tubes) {
                for clip in clips {
                    if change.is_renumbering() || clip.tet().is_some_and(is_lost) {
                        clip.find_tissue(tube, body);
                    }
                }
            }
            let ends_stay = change.tets.removed.is_empty()
                && n_severed == 0
                && !self.open.iter().any(|end| end.site.is_some_and(|site| is_lost(site.tet)));
            if !ends_stay || change.is_renumbering() {
                self.find_open_ends(body);
            }
        }
        n_severed
    }

    /// Sets a clip at the vessel that is nearest to the applier's tip in the present shape: on an open end, or around a vessel that
    /// is whole, if one is within its reach. Answers whether one was. Allocates.
    pub fn clip(&mut self, applier: &ClipApplier, body: &EditableMesh, positions_m: &[DVec3]) -> bool {
        let ends = self.open.iter().map(|end| {
            let place_m = self.end_position_m(end, body, positions_m);
            (place_m.distance(applier.tip_m), end.tube as usize, end.along)
        });
        let whole = self.middles.iter().enumerate().filter_map(|(i, site)| {
            let is_upstream = self.cut_along[i].is_none_or(|cut| cut > 0.5);
            let place_m = (*site).filter(|_| is_upstream)?.place_m(body, positions_m);
            Some((place_m.distance(applier.tip_m), i, 0.5))
        });
        let nearest = ends.chain(whole).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some((_, tube, along)) = nearest.filter(|n| n.0 <= applier.reach_m) else { return false };
        // A clip sits a little before the end that it closes.
        let along = (along - 1e-9).max(0.0);
        let around = (&self.tubes[tube], self.clips[tube].as_slice());
        let clip = Clip::set(along, applier.shaft, around, body, positions_m);
        self.clips[tube].push(clip);
        self.clips[tube].sort_by(|a, b| a.along.total_cmp(&b.along));
        self.find_open_ends(body);
        true
    }

    /// Threads are tight around these places at rest, each in their order, and no others: what goes through between them is closed
    /// there. Allocates.
    pub(super) fn tie(&mut self, threads: impl Iterator<Item = Vec<DVec3>>, body: &EditableMesh) {
        self.clips.iter_mut().for_each(|clips| clips.retain(|clip| !clip.is_thread));
        for around_m in threads {
            let middle_m = around_m.iter().sum::<DVec3>() / around_m.len().max(1) as f64;
            for (tube, clips) in self.tubes.iter().zip(&mut self.clips) {
                let pieces = around_m.iter().zip(around_m.iter().cycle().skip(1));
                let found = pieces.filter_map(|(&a, &b)| crossing(tube.ends_m, [middle_m, a, b]));
                clips.extend(found.min_by(f64::total_cmp).map(|along| Clip::thread(along, tube)));
                clips.sort_by(|a, b| a.along.total_cmp(&b.along));
            }
        }
        self.find_open_ends(body);
    }

    /// Tears the vessel that is nearest to a place at rest, there; answers whether blood came of it. Allocates.
    pub fn tear(&mut self, near_m: DVec3, body: &EditableMesh) -> bool {
        let whole = self.tubes.iter().enumerate().filter(|(i, _)| self.cut_along[*i].is_none());
        let places = whole.map(|(i, tube)| {
            let [from_m, to_m] = tube.ends_m;
            let way_m = to_m - from_m;
            let along = ((near_m - from_m).dot(way_m) / way_m.length_squared()).clamp(0.0, 1.0);
            (tube.point_m(along).distance(near_m), i, along)
        });
        let nearest = places.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some((_, tube, along)) = nearest else { return false };
        let before_m3_per_s = self.bleeding_m3_per_s;
        self.tears.push((tube, along));
        self.cut_along[tube] = Some(along);
        self.find_open_ends(body);
        self.bleeding_m3_per_s > before_m3_per_s
    }

    /// An edit is undone: vessels are as before it, but for those that have torn since, and for the blood that is lost. Allocates.
    pub(super) fn go_back_to(&mut self, before: &Self, body: &EditableMesh) {
        let (lost_m3, tears) = (self.lost_m3, std::mem::take(&mut self.tears));
        self.clone_from(before);
        (self.lost_m3, self.tears) = (lost_m3, tears);
        for &(tube, along) in &self.tears[before.tears.len()..] {
            let nearest = self.cut_along[tube].map_or(along, |cut| cut.min(along));
            self.cut_along[tube] = Some(nearest);
        }
        if self.tears.len() > before.tears.len() {
            self.find_open_ends(body);
        }
    }

    fn find_open_ends(&mut self, body: &EditableMesh) {
        self.open.clear();
        // Whether blood still comes through the whole of a tube; parents stand before their children.
        let mut carries = vec![false; self.tubes.len()];
        for (i, tube) in self.tubes.iter().enumerate() {
            let is_supplied = tube.parent.is_none_or(|parent| carries[parent as usize]);
            let clip = self.clips[i].first().map(|clip| clip.along);
            let is_clipped_before = |along: f64| clip.is_some_and(|c| c <= along);
            carries[i] = is_supplied && clip.is_none() && self.cut_along[i].is_none();
            let Some(along) = self.cut_along[i] else { continue };
            if !is_supplied || is_clipped_before(along) {
                continue;
            }
            let diameter_m = tube.diameter_m(along);
            // A little inside, where the tissue still is.
            let length_m = tube.ends_m[0].distance(tube.ends_m[1]);
            let inside = (along - 1e-4 / length_m.max(1e-9)).max(0.0);
            self.open.push(OpenEnd {
                tube: i as u32,
                along,
                diameter_m,
                rate_m3_per_s: bleeding_m3_per_s(diameter_m),
                site: site_of(body, tube.point_m(inside)),
                rest_m: tube.point_m(along),
            });
        }
        self.bleeding_m3_per_s = self.open.iter().fold(0.0, |sum, end| sum + end.rate_m3_per_s);
    }
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.min_m.cmple(b.max_m).all() && b.min_m.cmple(a.max_m).all()
}

/// Where the segment crosses the triangle, 0 to 1 along it; none where it lies in its plane, as far as rounding tells. Whether
/// it meets the triangle is decided exactly: between triangles with an edge in common nothing slips through.
fn crossing([from_m, to_m]: [DVec3; 2], corners_m: [DVec3; 3]) -> Option<f64> {
    let side = |p: DVec3| tetrahedron_volume_m3([corners_m[0], corners_m[1], corners_m[2], p]);
    let (before, after) = (side(from_m), side(to_m));
    let meets = before != after && segment_meets_triangle(from_m, to_m, corners_m);
    meets.then(|| (before / (before - after)).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::SeededRandom;
    use crate::mesh::box_mesh::box_of_five;
    use crate::mesh::edit::MeshEdit;
    use crate::record::snapshot::ClipSnapshot;

    #[test]
    fn nothing_slips_through_between_triangles_with_an_edge_in_common() {
        let mut random = SeededRandom::new(3);
        let mut at = || DVec3::from_array([0; 3].map(|_| random.uniform_in(0.01, 0.09)));
        for case in 0..20_000 {
            // Of two triangles that make a flat roof; the segment goes through a place on its ridge.
            let (a, b, away) = (at(), at(), at());
            let ridge_m = a.lerp(b, 0.375);
            let up = (b - a).cross(away).normalize();
            let fall = up * (0.3 * away.length());
            let [c, d] = [ridge_m + away - fall, ridge_m - away - fall];
            let way = up * 0.01 + at() * 1e-3;
            let ends_m = [ridge_m - way, ridge_m + way];
            let n = [[a, b, c], [b, a, d]].into_iter().filter(|t| crossing(ends_m, *t).is_some()).count();
            assert!(n > 0, "{case}");
        }
    }

    /// A trunk along x through a block of 40 x 20 x 20 mm that forks in the middle.
    fn block() -> (EditableMesh, Vessels) {
        let body = EditableMesh::new(box_of_five([8, 4, 4], DVec3::new(0.04, 0.02, 0.02))).unwrap();
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0103);
        let tube = |parent, a, b, r: [f64; 2]| Tube { parent, ends_m: [a, b], radii_m: r };
        let fork = at(0.02, 0.0102);
        let vessels = Vessels::new(
            vec![
                tube(None, at(-0.01, 0.0101), fork, [3e-3, 3e-3]),
                tube(Some(0), fork, at(0.038, 0.0041), [2.5e-3, 2.5e-3]),
                tube(Some(0), fork, at(0.038, 0.0162), [2.0e-3, 2.0e-3]),
            ],
            &body,
        )
        .unwrap();
        (body, vessels)
    }

    /// An applier whose shaft comes from the front.
    fn applier(tip_m: DVec3, reach_m: f64) -> ClipApplier {
        ClipApplier { tip_m, shaft: DVec3::Z, reach_m }
    }

    fn clips_of(vessels: &Vessels, body: &EditableMesh, positions_m: &[DVec3]) -> Vec<ClipSnapshot> {
        let mut told = BleedingSnapshot::default();
        vessels.bleeding_into(body, positions_m, &mut told);
        told.clips
    }

    /// Removes all tetrahedra whose centroid lies in a slab.
    fn cut_slab(
        body: &mut EditableMesh,
        vessels: &mut Vessels,
        from_x_m: f64,
        to_x_m: f64,
        y_m: [f64; 2],
    ) -> usize {
        let tets: Vec<TetId> = body
            .topology()
            .live_tets()
            .filter(|&t| {
                let c = body.mesh().corners_m(t).into_iter().sum::<DVec3>() / 4.0;
                (from_x_m..to_x_m).contains(&c.x) && (y_m[0]..y_m[1]).contains(&c.y)
            })
            .collect();
        let change = body.apply(&MeshEdit::Remove { tets }).unwrap();
        vessels.follow(body, &change, |_| true)
    }

    #[test]
    fn cutting_a_branch_bleeds_by_its_diameter_until_it_is_clipped() {
        let (mut body, mut vessels) = block();
        assert_eq!(vessels.bleeding_m3_per_s(), 0.0);
        assert!(cut_slab(&mut body, &mut vessels, 0.03, 0.035, [0.0, 0.01]) > 0);
        let [end] = vessels.open_ends() else { panic!("{:?}", vessels.open_ends()) };
        assert_eq!(end.tube, 1);
        assert!((end.rate_m3_per_s / bleeding_m3_per_s(5e-3) - 1.0).abs() < 1e-12);
        let moved_m: Vec<DVec3> = body.mesh().positions_m.iter().map(|p| *p + DVec3::Z).collect();
        let end_m = vessels.end_position_m(end, &body, &moved_m);
        assert!((end_m - DVec3::new(0.03, 0.0068, 1.0103)).length() < 5e-3, "{end_m}");
        vessels.advance(2.0);
        assert!((vessels.lost_m3() / (2.0 * bleeding_m3_per_s(5e-3)) - 1.0).abs() < 1e-12);
        assert!(!vessels.clip(&applier(DVec3::ZERO, 1e-3), &body, &moved_m), "nothing there");
        assert!(vessels.clip(&applier(end_m, 1e-3), &body, &moved_m));
        assert_eq!((vessels.open_ends().len(), vessels.bleeding_m3_per_s(), vessels.n_clips()), (0, 0.0, 1));
        // Cut again behind the clip: nothing. Before it: blood.
        cut_slab(&mut body, &mut vessels, 0.035, 0.04, [0.0, 0.01]);
        assert_eq!(vessels.bleeding_m3_per_s(), 0.0);
        cut_slab(&mut body, &mut vessels, 0.022, 0.03, [0.0, 0.01]);
        assert!(vessels.bleeding_m3_per_s() > 0.0);
    }

    #[test]
    fn the_trunk_feeds_the_branches_and_a_clip_before_the_cut_spares_the_blood() {
        let (mut body, mut vessels) = block();
        cut_slab(&mut body, &mut vessels, 0.025, 0.035, [0.0, 0.02]);
        assert_eq!(vessels.open_ends().len(), 2);
        // The trunk is cut too: what lies beyond bleeds no more.
        cut_slab(&mut body, &mut vessels, 0.01, 0.015, [0.0, 0.02]);
        let tubes: Vec<u32> = vessels.open_ends().iter().map(|end| end.tube).collect();
        assert_eq!(tubes, [0]);

        let (mut body, mut vessels) = block();
        let rest_m = body.mesh().positions_m.clone();
        assert!(vessels.clip(&applier(DVec3::new(0.005, 0.0101, 0.0103), 1e-3), &body, &rest_m));
        cut_slab(&mut body, &mut vessels, 0.025, 0.035, [0.0, 0.02]);
        assert_eq!(vessels.bleeding_m3_per_s(), 0.0);
    }

    #[test]
    fn clips_sit_on_their_vessel_turn_with_the_tissue_and_go_with_it() {
        let (mut body, mut vessels) = block();
        let rest_m = body.mesh().positions_m.clone();
        let trunk_m = DVec3::new(0.005, 0.0101, 0.0103);
        assert!(clips_of(&vessels, &body, &rest_m).is_empty());
        for _ in 0..2 {
            assert!(vessels.clip(&applier(trunk_m, 1e-3), &body, &rest_m));
        }
        // Beside each other, the second one nearer to where the blood comes from.
        let [clip, second] = clips_of(&vessels, &body, &rest_m)[..] else { panic!("two clips") };
        for (clip, x_m) in [(clip, 4e-3), (second, 2e-3)] {
            assert!((clip.position_m - DVec3::new(x_m, 0.01015, 0.0103)).length() < 1e-5, "{clip:?}");
        }
        assert!(
            clip.along.dot(DVec3::X) > 0.9999 && clip.legs.dot(DVec3::Z) > 0.9999 && clip.radius_m == 3e-3
        );

        // Stretched and turned about z: x to y, y to -x.
        let moved = |p: DVec3| DVec3::new(-p.y, 2.0 * p.x, p.z + 1.0);
        let moved_m: Vec<DVec3> = rest_m.iter().map(|p| moved(*p)).collect();
        let turned = clips_of(&vessels, &body, &moved_m)[0];
        assert!((turned.position_m - moved(clip.position_m)).length() < 1e-9);
        assert!(turned.along.dot(DVec3::Y) > 0.9999 && turned.legs.dot(DVec3::Z) > 0.9999, "{turned:?}");

        // Set in tissue that is turned: the legs lie along the applier then.
        let mut others = block().1;
        let at_m = moved(trunk_m);
        assert!(others.clip(&ClipApplier { shaft: DVec3::NEG_X, ..applier(at_m, 1e-3) }, &body, &moved_m));
        let [then, before] = [&moved_m, &rest_m].map(|at| clips_of(&others, &body, at)[0].legs);
        assert!(then.dot(DVec3::NEG_X) > 0.9999 && before.dot(DVec3::Y) > 0.9999, "{then} {before}");

        // Tissue that is cut out takes its clips along; they were set all the same.
        cut_slab(&mut body, &mut vessels, 0.01, 0.015, [0.0, 0.02]);
        assert_eq!(clips_of(&vessels, &body, &rest_m).len(), 2);
        cut_slab(&mut body, &mut vessels, 0.0, 0.01, [0.0, 0.02]);
        assert!(clips_of(&vessels, &body, &rest_m).is_empty() && vessels.n_clips() == 2);
    }

    #[test]
    fn a_vessel_tears_where_it_is_nearest_and_bleeds_until_it_is_clipped() {
        let (body, mut vessels) = block();
        let near_m = DVec3::new(0.03, 0.019, 0.0103);
        assert!(vessels.tear(near_m, &body));
        let [end] = vessels.open_ends() else { panic!("{:?}", vessels.open_ends()) };
        assert_eq!(end.tube, 2);
        assert!((end.rate_m3_per_s / bleeding_m3_per_s(4e-3) - 1.0).abs() < 1e-12);
        let rest_m = body.mesh().positions_m.clone();
        let end_m = vessels.end_position_m(end, &body, &rest_m);
        assert!(vessels.clip(&applier(end_m, 1e-3), &body, &rest_m));
        assert_eq!(vessels.bleeding_m3_per_s(), 0.0);
        // The trunk tears before both; a clip on it before that place would have spared the blood.
        assert!(vessels.tear(DVec3::new(0.005, 0.01, 0.01), &body));
        assert!((vessels.bleeding_m3_per_s() / bleeding_m3_per_s(6e-3) - 1.0).abs() < 1e-12);
        assert!(!vessels.tear(near_m, &body), "what lies beyond has lost its supply");
        // Going back to before all that: what tore stays torn, and the blood is lost.
        vessels.advance(2.0);
        let (_, before) = block();
        let (lost_m3, rate_m3_per_s) = (vessels.lost_m3(), vessels.bleeding_m3_per_s());
        vessels.go_back_to(&before, &body);
        assert_eq!((vessels.lost_m3(), vessels.bleeding_m3_per_s()), (lost_m3, rate_m3_per_s));
    }

    #[test]
    fn the_portal_vein_itself_lets_out_its_flow() {
        assert!((bleeding_m3_per_s(PORTAL_DIAMETER_M) * 60e6 - 985.5).abs() < 1e-9, "ml/min");
        assert!((bleeding_m3_per_s(3e-3) * 60e6 - 7.1).abs() < 0.1, "ml/min");
    }

    #[test]
    fn bad_lists_are_refused() {
        let (body, vessels) = block();
        let mut tubes = vessels.tubes().to_vec();
        tubes[1].parent = Some(1);
        assert_eq!(Vessels::new(tubes.clone(), &body).unwrap_err(), (1, TubeError::Parent { parent: 1 }));
        tubes[1].parent = None;
        tubes[2].radii_m[0] = f64::NAN;
        assert_eq!(Vessels::new(tubes, &body).unwrap_err(), (2, TubeError::Radius));
    }
}
