//! The needle: it goes into tissue where its tip is pressed on it with the force of a puncture, draws the thread after it, and comes
//! out where it reaches the surface again.

use super::Suture;
use super::passage::{INNER_M, MOST_PASSAGES, Passage};
use crate::contact::shapes::Capsule;
use crate::math::DVec3;
use crate::world::organ::Organ;
use crate::world::site::Site;
use crate::world::suture_spec::SutureSpec;

/// A needle goes in where it is at least so steep to the surface, as the sine of the angle: a choice.
const STEEP: f64 = 0.2;
/// The surface is looked for so far around a tip that comes out [m].
const REACH_M: f64 = 5e-3;

impl Suture {
    /// Lets the needle's tip go in or come out, after the last step.
    pub(super) fn pierce(&mut self, spec: &SutureSpec, organ: &Organ) {
        let Some(needle) = &spec.needle else { return };
        let has_room = self.passages.len() < MOST_PASSAGES;
        let tip_m = self.rod.positions_m[0];
        if !self.tip_is_inside {
            let push_n = self.lies_n[0];
            let along = -self.rod.direction_at(0.0);
            let goes_in =
                push_n.length() >= needle.puncture_force_n && along.dot(push_n) > STEEP * push_n.length();
            if goes_in
                && has_room
                && let Some((site, _)) = self.nearest_of_surface(tip_m, organ)
            {
                self.passages.insert(0, Passage::new(organ.body(), site, 0.0, true));
                self.lies_n[0] = DVec3::ZERO;
                self.tip_is_inside = true;
            }
            return;
        }
        let Some(last) = self.passages.first().copied() else { return };
        let topology = organ.body().topology();
        match Site::walk(topology, last.site.tet, tip_m, organ.positions_m()) {
            Some(site) if last.along_m > INNER_M && has_room => {
                self.passages.insert(0, Passage::new(organ.body(), site, 0.0, false));
            }
            Some(_) => {}
            None => {
                let Some((site, out_m)) = self.nearest_of_surface(tip_m, organ) else { return };
                // The way there left the tissue, and the tip is in it: around a corner.
                if out_m < 0.0 {
                    return;
                }
                // Back out of the hole that it went in by, or through another.
                if last.is_hole && last.along_m <= out_m.max(self.rod.radius_m()) {
                    self.passages.remove(0);
                } else {
                    if !has_room {
                        // The place before gives way to the hole.
                        self.passages.remove(0);
                    }
                    let along_m = out_m.min(0.5 * last.along_m);
                    self.passages.insert(0, Passage::new(organ.body(), site, along_m, true));
                }
                self.tip_is_inside = false;
            }
        }
    }

    /// The place of the surface that is nearest to a point, and how far the point is out of it [m].
    fn nearest_of_surface(&mut self, point_m: DVec3, organ: &Organ) -> Option<(Site, f64)> {
        let near = &mut self.scratch.near;
        organ.skin().nearest_into(&Capsule::ball(point_m, 0.0), REACH_M, near);
        let place = organ.skin().place_of(*near.first()?);
        let on = (place.nodes, place.found.weights);
        let site = Site::on_surface(organ.body().topology(), place.triangle, on)?;
        let off_m = point_m - site.place_m(organ.body(), organ.positions_m());
        let side = if off_m.dot(organ.face_normal(place.nodes)) < 0.0 { -1.0 } else { 1.0 };
        Some((site, side * off_m.length()))
    }
}
