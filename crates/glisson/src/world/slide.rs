//! A contact that slides: Coulomb's friction for a tool that drives the tissue by displacements.
//!
//! The touched point is where the tool is, so that how far the tissue was drawn along is known only by its force. The
//! proxy ([`crate::contact::proxy`]) of the contact is asked where it would go for the goal point + force / k, with k the
//! stiffness that the tissue showed so far (force over motion): it slides by just what is more than friction holds. Then
//! another point of the tissue follows the tool from there on; its triangle's nodes start from where they are.

use super::organ::Organ;
use super::touch::HeldContact;
use crate::contact::proxy::{Proxy, ProxyParams, ProxyState};
use crate::contact::spread::motion_weights;
use crate::math::DVec3;

/// Stiffness of a contact that was not yet pressed [N/m]: a choice, of the size of what a probe feels on liver.
const FIRST_STIFFNESS_N_PER_M: f64 = 100.0;
/// A shorter motion says nothing about stiffness [m].
const LEAST_MOTION_M: f64 = 1e-5;

/// What a slide depends on.
pub(super) struct SlideInput {
    /// The tool's touching point [m].
    pub(super) point_m: DVec3,
    /// Radius of the tool there [m].
    pub(super) radius_m: f64,
    /// Coulomb's coefficient.
    pub(super) friction: f64,
    /// Force on the organ in the last step [N].
    pub(super) force_on_organ_n: DVec3,
}

impl HeldContact {
    /// After a step: lets the tool slide on the tissue as far as friction does not hold; answers how far [m]. Allocates
    /// nothing.
    pub(super) fn slide(&mut self, organ: &Organ, input: &SlideInput) -> f64 {
        let surface = organ.skin().proxy_surface();
        let Some(slot) = organ.skin().slot_of(self.triangle) else { return 0.0 };
        let Some(mut proxy) = Proxy::at(&surface, slot, self.weights) else { return 0.0 };
        let positions_m = organ.positions_m();
        let before_m = self.point_m(positions_m);
        let motion_m = self.motion_before_m + (input.point_m - self.neutral_m);
        let (force_n, moved_m) = (input.force_on_organ_n.length(), motion_m.length());
        let stiffness_n_per_m = if moved_m > LEAST_MOTION_M && force_n > 0.0 {
            force_n / moved_m
        } else {
            FIRST_STIFFNESS_N_PER_M
        };
        let params = ProxyParams {
            static_friction: input.friction,
            kinetic_friction: input.friction,
            ..ProxyParams::frictionless(stiffness_n_per_m)
        };
        let goal_m = before_m + input.force_on_organ_n / stiffness_n_per_m;
        if proxy.advance_to(&surface, goal_m, &params).state != ProxyState::Slides {
            return 0.0;
        }
        let place = organ.skin().place_in_slot(proxy.slot());
        let weights = proxy.weights();
        let Some(spread) = motion_weights(weights, place.1.map(|n| organ.is_fixed(n))) else { return 0.0 };
        let after_m = proxy.point_m(positions_m);
        let slip_m = after_m - before_m;
        // The tool rolls over the tissue as its normal turns: slowly, by a slip of its radius to most of it.
        let turns = slip_m.length() / (slip_m.length() + input.radius_m);
        let normal = self.normal.lerp(organ.face_normal(place.1), turns).normalize_or(self.normal);
        let wanted_m = before_m + (self.normal - normal) * input.radius_m;
        let rest_m = &organ.mesh().positions_m;
        (self.triangle, self.nodes) = place;
        self.weights = weights;
        self.motion_weights = spread;
        self.displacements_at_touch_m = self.nodes.map(|n| positions_m[n.index()] - rest_m[n.index()]);
        self.neutral_m = input.point_m - (wanted_m - after_m);
        self.motion_before_m = motion_m - slip_m - (input.point_m - self.neutral_m);
        self.normal = normal;
        slip_m.length()
    }
}
