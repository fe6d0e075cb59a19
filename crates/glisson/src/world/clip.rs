//! A clip on a vessel: what it closes, where it sits and how it lies. It goes with the tissue around it.

use super::site::{Site, site_of};
use crate::image::vessels::Tube;
use crate::math::DVec3;
use crate::mesh::TetId;
use crate::mesh::edit::EditableMesh;
use crate::record::snapshot::ClipSnapshot;

/// Clips on a tube lie so far apart at least [m]: a choice, twice the width of the wire of titanium clips.
const APART_M: f64 = 2e-3;

/// An instrument that sets a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipApplier {
    /// Its tip [m].
    pub tip_m: DVec3,
    /// From there towards the handle: along the legs of its clips.
    pub shaft: DVec3,
    /// A vessel that is further away gets no clip [m].
    pub reach_m: f64,
}

/// A clip that was set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Clip {
    /// From where on it closes its tube, 0 to 1.
    pub(super) along: f64,
    /// Its middle, as the way from the tube's beginning at rest [m].
    middle_m: f64,
    /// Along its legs to their bend, at rest.
    legs: DVec3,
    /// None where its tissue is gone.
    site: Option<Site>,
    /// Whether it is a thread around the vessel, which is drawn elsewhere, and no clip.
    pub(super) is_thread: bool,
}

impl Clip {
    /// A thread that closes a tube from `along` on.
    pub(super) fn thread(along: f64, tube: &Tube) -> Self {
        Self { along, middle_m: along * length_m(tube), legs: DVec3::X, site: None, is_thread: true }
    }

    /// A clip that closes a tube from `along` on, its legs along `legs` as the tissue is now; beside `others` on that tube.
    pub(super) fn set(
        along: f64,
        legs: DVec3,
        (tube, others): (&Tube, &[Self]),
        body: &EditableMesh,
        positions_m: &[DVec3],
    ) -> Self {
        // It closes the tube with its far edge.
        let mut middle_m = along * length_m(tube) - 0.5 * APART_M;
        // Each of the others is in the way once: the place only goes down.
        while let Some(other) = others.iter().find(|o| (o.middle_m - middle_m).abs() < 0.99 * APART_M) {
            middle_m = other.middle_m - APART_M;
        }
        let mut clip = Self { along, middle_m: middle_m.max(0.0), legs, site: None, is_thread: false };
        clip.find_tissue(tube, body);
        if let Some(site) = &clip.site {
            clip.legs = site.way_at_rest(legs, body, positions_m);
        }
        clip
    }

    /// The tetrahedron that it sits in.
    pub(super) fn tet(&self) -> Option<TetId> {
        self.site.map(|site| site.tet)
    }

    /// Looks where its tissue is after an edit.
    pub(super) fn find_tissue(&mut self, tube: &Tube, body: &EditableMesh) {
        self.site = site_of(body, tube.point_m(self.share(tube)));
    }

    fn share(&self, tube: &Tube) -> f64 {
        (self.middle_m / length_m(tube).max(f64::MIN_POSITIVE)).min(1.0)
    }

    /// Where it sits and how it lies now; none where its tissue is gone.
    pub(super) fn snapshot(
        &self,
        tube: &Tube,
        body: &EditableMesh,
        positions_m: &[DVec3],
    ) -> Option<ClipSnapshot> {
        let site = self.site.filter(|_| !self.is_thread)?;
        let [from_m, to_m] = tube.ends_m;
        let along = site.way_now(to_m - from_m, body, positions_m).normalize_or(DVec3::X);
        let legs = site.way_now(self.legs, body, positions_m).reject_from_normalized(along);
        Some(ClipSnapshot {
            position_m: site.place_m(body, positions_m),
            along,
            legs: legs.normalize_or(along.any_orthonormal_vector()),
            radius_m: 0.5 * tube.diameter_m(self.share(tube)),
        })
    }
}

fn length_m(tube: &Tube) -> f64 {
    tube.ends_m[0].distance(tube.ends_m[1])
}
