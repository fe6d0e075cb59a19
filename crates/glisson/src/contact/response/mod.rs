//! Local answers to contacts between deforming surfaces: penalty, impulse, geometric alteration (seed `000`, s. 4.3).
//!
//! Each looks at one contact at a time, in a fixed order; the cost is linear in their number. A contact joins vertices i
//! with weights w_i: 1 on the vertex that touches, minus the barycentric weights on the triangle touched (none on a
//! rigid surface). With the gap g along the normal n (towards the vertex) and the inverse masses W_i (zero along the
//! axes of supports), one contact answers to an impulse J as a body of mass
//!
//! m = 1 / sum_i w_i^2 n.W_i n,   and its vertices by   v_i += W_i w_i J.
//!
//! The w_i add up to zero between two bodies: momentum is conserved whatever J is. Angular momentum is too where the
//! vertex lies on the triangle; at a gap g along n the impulse along n has no moment either, friction one of J_t g.
//!
//! | | changes | steps | when to use |
//! |---|---|---|---|
//! | [`penalty`] | forces of the next step | 1 ms | cheapest; a gap or an overlap stays |
//! | [`impulse`] | velocities | ten times shorter, says the thesis | hard blows, bouncing |
//! | [`geometric`] | places and velocities | 1 ms | lasting contact of living tissue, which hardly slides |
//!
//! Contacts do not know of each other here: in a heap or under a lasting load they leave gaps, overlaps and creep.

pub mod bodies;
pub mod find;
pub mod geometric;
pub mod impulse;
pub mod penalty;
mod coupled;
pub mod bond;
pub mod persistent;
mod rest_gaps;
pub mod self_contact;

use crate::math::DVec3;

/// A vertex at a triangle or at a rigid surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeContact {
    /// The vertex, then the triangle's; those without weight do not count.
    pub vertices: [u32; 4],
    /// 1, then minus the barycentric weights of the place touched.
    pub weights: [f64; 4],
    /// Unit normal of the place touched, towards where the vertex should be.
    pub normal: DVec3,
    /// Distance [m]; negative behind the surface.
    pub gap_m: f64,
    /// Velocity of a rigid surface [m/s].
    pub rigid_m_per_s: DVec3,
}

impl NodeContact {
    /// A vertex at a triangle, at the place with barycentric weights `at`.
    pub fn with_triangle(vertex: u32, [a, b, c]: [u32; 3], at: [f64; 3], normal: DVec3, gap_m: f64) -> Self {
        Self {
            vertices: [vertex, a, b, c],
            weights: [1.0, -at[0], -at[1], -at[2]],
            normal,
            gap_m,
            rigid_m_per_s: DVec3::ZERO,
        }
    }

    /// A vertex at a rigid surface that moves.
    pub fn with_rigid(vertex: u32, normal: DVec3, gap_m: f64, rigid_m_per_s: DVec3) -> Self {
        Self { vertices: [vertex, 0, 0, 0], weights: [1.0, 0.0, 0.0, 0.0], normal, gap_m, rigid_m_per_s }
    }

    /// Vertices that take part, with their weights.
    #[inline]
    pub fn sides(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let sides = self.vertices.iter().zip(self.weights).filter(|(_, w)| *w != 0.0);
        sides.map(|(v, w)| (*v as usize, w))
    }

    /// Velocity of the vertex against the place touched [m/s].
    #[inline]
    pub fn relative_m_per_s(&self, velocities_m_per_s: &[DVec3]) -> DVec3 {
        self.sides().map(|(v, w)| velocities_m_per_s[v] * w).sum::<DVec3>() - self.rigid_m_per_s
    }

    /// 1/m along a unit direction [1/kg].
    #[inline]
    pub fn inverse_mass_per_kg(&self, along: DVec3, inverse_mass_per_kg: &[DVec3]) -> f64 {
        self.sides().map(|(v, w)| w * w * along.dot(inverse_mass_per_kg[v] * along)).sum()
    }
}

/// What a response changes in a step, of each vertex: an impulse J_i, by which its velocity changes by W_i J_i, and a
/// mass times displacement S_i, by which its place changes by W_i S_i. Both add up to zero between bodies.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    /// Impulses [N s].
    pub impulses_n_s: Vec<DVec3>,
    /// Shifts [kg m].
    pub shifts_kg_m: Vec<DVec3>,
}

impl Answer {
    /// No change of `n` vertices.
    pub fn none(n: usize) -> Self {
        Self { impulses_n_s: vec![DVec3::ZERO; n], shifts_kg_m: vec![DVec3::ZERO; n] }
    }

    /// Back to no change.
    pub fn clear(&mut self) {
        self.impulses_n_s.fill(DVec3::ZERO);
        self.shifts_kg_m.fill(DVec3::ZERO);
    }
}

/// How velocities are brought to what contacts allow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Blow {
    pub(crate) restitution: f64,
    pub(crate) friction: f64,
}

impl Blow {
    /// One contact: an impulse along the normal that turns an approach at speed v into a retreat at e v, and one across of at
    /// most mu times it that stops sliding. Each takes energy of motion, or none: (1 - e^2) m v^2 / 2 and m v_t^2 / 2 at most.
    /// Answers their sum [N s].
    #[inline]
    pub(crate) fn strike(
        &self,
        contact: &NodeContact,
        inverse_mass_per_kg: &[DVec3],
        velocities_m_per_s: &mut [DVec3],
        impulses_n_s: &mut [DVec3],
    ) -> DVec3 {
        let n = contact.normal;
        let approach_m_per_s = -contact.relative_m_per_s(velocities_m_per_s).dot(n);
        let per_kg = contact.inverse_mass_per_kg(n, inverse_mass_per_kg);
        // Also false for what is no number.
        if !(approach_m_per_s > 0.0 && per_kg > 0.0) {
            return DVec3::ZERO;
        }
        let normal_n_s = (1.0 + self.restitution) * approach_m_per_s / per_kg;
        let mut sum_n_s = DVec3::ZERO;
        let mut give = |impulse_n_s: DVec3, velocities_m_per_s: &mut [DVec3]| {
            sum_n_s += impulse_n_s;
            for (v, w) in contact.sides() {
                velocities_m_per_s[v] += inverse_mass_per_kg[v] * impulse_n_s * w;
                impulses_n_s[v] += impulse_n_s * w;
            }
        };
        give(n * normal_n_s, velocities_m_per_s);
        if self.friction <= 0.0 {
            return sum_n_s;
        }
        let across = contact.relative_m_per_s(velocities_m_per_s);
        let across = across - n * across.dot(n);
        let speed_m_per_s = across.length();
        if speed_m_per_s > 0.0 {
            let along = across / speed_m_per_s;
            let per_kg = contact.inverse_mass_per_kg(along, inverse_mass_per_kg);
            if per_kg > 0.0 {
                let stopping_n_s = speed_m_per_s / per_kg;
                give(along * -stopping_n_s.min(self.friction * normal_n_s), velocities_m_per_s);
            }
        }
        sum_n_s
    }
}

/// The nearest force in Coulomb's cone, along the normal first.
fn within_cone(normal: DVec3, force_n: DVec3, friction: f64) -> DVec3 {
    let push_n = force_n.dot(normal).max(0.0);
    let across_n = force_n - normal * force_n.dot(normal);
    normal * push_n + across_n.clamp_length_max(friction * push_n)
}
