//! The clip applier of the scripted resection: it goes to a vessel that bleeds, sets a clip and goes on to the next one or
//! home.

use glisson::tool::ToolInput;
use std::collections::VecDeque;

/// How fast it is led [m/s]: a choice.
const SPEED_M_PER_S: f64 = 0.6;

/// What to do next.
#[derive(Clone, Copy, Debug)]
enum Order {
    Go(ToolInput),
    Clip,
}

/// An instrument with orders.
pub(super) struct ClipApplier {
    home: ToolInput,
    now: ToolInput,
    orders: VecDeque<Order>,
}

impl ClipApplier {
    /// At home, without orders.
    pub(super) fn new(home: ToolInput) -> Self {
        Self { home, now: home, orders: VecDeque::new() }
    }

    /// Whether orders are left.
    pub(super) fn is_busy(&self) -> bool {
        !self.orders.is_empty()
    }

    /// One clip at `near`, to which the way leads from `far` along the shaft, and back again.
    pub(super) fn send(&mut self, [far, near]: [ToolInput; 2]) {
        self.orders.extend([Order::Go(far), Order::Go(near), Order::Clip, Order::Go(far)]);
    }

    /// Home after what it does now.
    pub(super) fn go_home(&mut self) {
        if self.now != self.home || self.is_busy() {
            self.orders.push_back(Order::Go(self.home));
        }
    }

    /// Where it is after another `dt_s`, and whether a clip is to be set there.
    pub(super) fn advance(&mut self, dt_s: f64) -> (ToolInput, bool) {
        let mut clips = false;
        if let Some(Order::Go(to)) = self.orders.front().copied() {
            let left_m = to.tip_in_world_m.distance(self.now.tip_in_world_m);
            let share = SPEED_M_PER_S * dt_s / left_m.max(1e-12);
            if share < 1.0 {
                self.now.tip_in_world_m = self.now.tip_in_world_m.lerp(to.tip_in_world_m, share);
                let shaft = self.now.shaft_in_world.lerp(to.shaft_in_world, share);
                self.now.shaft_in_world = shaft.normalize_or(to.shaft_in_world);
            } else {
                self.now = to;
                self.orders.pop_front();
            }
        }
        if let Some(Order::Clip) = self.orders.front() {
            self.orders.pop_front();
            clips = true;
        }
        (self.now, clips)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DVec3;

    #[test]
    fn it_clips_once_a_place_at_the_place_and_comes_home() {
        let at = |x: f64, z: f64| ToolInput::at(DVec3::new(x, 0.0, z), DVec3::Z);
        let home = at(0.0, 0.1);
        let mut applier = ClipApplier::new(home);
        assert!(!applier.is_busy() && applier.advance(1e-3) == (home, false));
        applier.go_home();
        assert!(!applier.is_busy(), "it is there");
        applier.send([at(0.03, 0.05), at(0.03, 0.0)]);
        applier.send([at(-0.03, 0.05), at(-0.03, 0.01)]);
        applier.go_home();
        let (mut clipped, mut last) = (Vec::new(), home);
        while applier.is_busy() {
            let (pose, clips) = applier.advance(1e-3);
            let moved_m = pose.tip_in_world_m.distance(last.tip_in_world_m);
            assert!(moved_m <= SPEED_M_PER_S * 1e-3 * (1.0 + 1e-9), "{moved_m}");
            if clips {
                clipped.push(pose);
            }
            last = pose;
        }
        assert_eq!(clipped, [at(0.03, 0.0), at(-0.03, 0.01)]);
        assert_eq!(last, home);
    }
}
