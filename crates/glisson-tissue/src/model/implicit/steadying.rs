//! Springs that hold nodes near places for a step ([`crate::model::NodalSpring`]).

use crate::model::NodalSpring;
use crate::model::bounded_vec::BoundedVec;
use glisson_mesh::math::DVec3;

#[derive(Clone, Debug)]
pub(super) struct Steadying {
    springs: BoundedVec<NodalSpring>,
}

impl Steadying {
    pub(super) fn new() -> Self {
        Self { springs: BoundedVec::with_capacity(NodalSpring::MOST) }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.springs.is_empty()
    }

    /// Adds one if there is room.
    pub(super) fn add(&mut self, spring: NodalSpring) {
        self.springs.try_push(spring);
    }

    /// Takes all away, and their pull with them.
    pub(super) fn clear(&mut self, pull_n: &mut [DVec3]) {
        self.start(pull_n);
        self.springs.clear();
    }

    /// Nothing pulls on their nodes.
    pub(super) fn start(&self, pull_n: &mut [DVec3]) {
        for spring in self.springs.iter() {
            pull_n[spring.node.index()] = DVec3::ZERO;
        }
    }

    /// Adds the forces on the nodes [N]; returns the energy [J].
    pub(super) fn add_pull(&self, rest_m: &[DVec3], displacement_m: &[DVec3], pull_n: &mut [DVec3]) -> f64 {
        let mut energy_j = 0.0;
        for spring in self.springs.iter() {
            let n = spring.node.index();
            let way_m = spring.place_m - rest_m[n] - displacement_m[n];
            pull_n[n] += way_m * spring.stiffness_n_per_m;
            energy_j += 0.5 * spring.stiffness_n_per_m * way_m.length_squared();
        }
        energy_j
    }

    /// Adds the tangent times a direction.
    pub(super) fn add_product(&self, direction_m: &[DVec3], force_n: &mut [DVec3]) {
        for spring in self.springs.iter() {
            let n = spring.node.index();
            force_n[n] += direction_m[n] * spring.stiffness_n_per_m;
        }
    }
}
