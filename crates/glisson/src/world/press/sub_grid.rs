//! The detail of a contact that the mesh is too coarse for, as a compliance in series with the contact.
//!
//! A ball of radius R that presses on an elastic half-space with a force F goes in by d_H(F) (I. N. Sneddon 1965, The relation
//! between load and penetration in the axisymmetric Boussinesq problem for a punch of arbitrary profile, doi
//! 10.1016/0020-7225(65)90019-4): with the reduced modulus E* = E/(1 - nu^2) and the contact's radius a,
//!
//! F = E* ((a^2 + R^2)/2 ln((R + a)/(R - a)) - a R),   d_H = a/2 ln((R + a)/(R - a)).
//!
//! Where the mesh's edges are larger than a, a few nodes bear F, and each spreads its share over the area around it: the mesh
//! yields less. Under forces f_i on nodes of a half-space it yields, in the mean that does the work,
//!
//! d_M(F) = sum_ij f_i f_j g_ij/F + sum_k f_k h_k/F,   g_ij = 1/(pi E* r_ij),
//!
//! where point k touches the ball by h_k further out than its foremost point, with the distances r_ij (Boussinesq's solution). g_ii is
//! what the tetrahedra around node i answer (`world/node_answer.rs`); where edits laid nodes bare it is c/(E* sqrt(A_i)), of a uniform
//! pressure on the area A_i of the surface around the node, lessened by what linear tetrahedra are too stiff. What is missing is
//! s(F) = d_H(F) - d_M(F) where that is positive: many nodes within the contact leave nothing of it. The part goes in by s further
//! than its surface on the mesh.
//!
//! Where it ends: E* is that of the material at rest and of small strain; sheets thinner than the contact and edges yield more than a
//! half-space, and the sides of shafts, blades and jaws, whose contact is long, are left to the mesh.

use crate::material::LinearElastic;
use crate::mesh::NodeId;
use crate::world::node_answer::reduced_modulus_pa;
use crate::world::organ::Organ;
use std::f64::consts::FRAC_1_PI;

/// g_ii E* sqrt(A_i) of uniform pressure on a disk of area A, mean displacement: 16/(3 pi^(3/2)) (K. L. Johnson 1985, Contact
/// Mechanics, s. 3.4).
const UNIFORM_PRESSURE: f64 = 16.0 / (3.0 * 5.568_327_996_831_708);
/// What of it nodes of our meshes show, the mean of those of `node_answer`.
const STIFF_MESH: f64 = 0.91;
/// Contacts of less depth than this share of the radius are taken to be of that depth: they would have no stiffness.
const LEAST_DEPTH: f64 = 1e-3;
/// The largest radius of contact, as a share of the ball's.
const MOST_RADIUS: f64 = 1.0 - 1e-9;
/// Halvings of the interval of the contact's radius.
const HALVINGS: u32 = 40;

/// s/F follows the force in so many times what shear waves need across the ball's radius, twice a step, and its direction once. s/F falls while F rises, the faster the
/// more of the ball the mesh shows: followed before the tissue has given way, a force would raise itself. A choice.
const LEARNING: f64 = 2.0;
/// How far the part is in the surface of the mesh follows s in so many such times, as a spring with a damper beside it: s/F that is
/// behind the force gives energy to tissue that swings under the part, and the nodes under it, light in the steps of explicit
/// models, would bounce on a spring alone. A choice.
const DAMPING: f64 = 1.0;

/// A ball on an elastic half-space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Indentation {
    /// E* [Pa].
    reduced_modulus_pa: f64,
    /// Speed of shear waves at rest [m/s].
    shear_wave_m_per_s: f64,
}

/// Force over E* R^2 and depth over R of a contact with radius `share` R.
fn sneddon(share: f64) -> [f64; 2] {
    let log = libm::log((1.0 + share) / (1.0 - share));
    [0.5 * (share * share + 1.0) * log - share, 0.5 * share * log]
}

impl Indentation {
    pub(super) fn of(material: &LinearElastic) -> Self {
        let reduced_modulus_pa = reduced_modulus_pa(material);
        let shear_wave_m_per_s = (material.mu_pa() / material.density_kg_per_m3()).sqrt();
        Self { reduced_modulus_pa, shear_wave_m_per_s }
    }

    /// What a ball's damper lets it follow, in a step, of how far it should yield.
    pub(super) fn followed(&self, radius_m: f64, dt_s: f64) -> f64 {
        self.share(DAMPING, radius_m, dt_s)
    }

    /// What of a change of s/F under a ball is taken over each of the [`super::SUB_GRID_ROUNDS`] times a step that it is found.
    pub(super) fn learned(&self, radius_m: f64, dt_s: f64) -> f64 {
        self.share(LEARNING, radius_m, dt_s)
    }

    fn share(&self, crossings: f64, radius_m: f64, dt_s: f64) -> f64 {
        let time_s = crossings * radius_m / self.shear_wave_m_per_s;
        if time_s.is_finite() { dt_s / (dt_s + time_s) } else { 1.0 }
    }

    /// d_H/F of a ball [m/N].
    fn ball_m_per_n(&self, radius_m: f64, force_n: f64) -> f64 {
        let scale_n = self.reduced_modulus_pa * radius_m * radius_m;
        let wanted = force_n / scale_n;
        let (mut low, mut high) = (0.0, MOST_RADIUS);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if sneddon(middle)[0] < wanted {
                low = middle;
            } else {
                high = middle;
            }
        }
        let [force, depth] = sneddon(high);
        let is_shallow = depth < LEAST_DEPTH;
        // Of a small radius both are differences of nearly equal numbers: Hertz.
        let hertz = |depth: f64| 0.75 / depth.sqrt();
        let per_force = if is_shallow { hertz(LEAST_DEPTH) } else { depth / force };
        per_force * radius_m / scale_n
    }

    /// d_M/F of forces on nodes [m/N], which are not all zero.
    fn mesh_m_per_n(&self, organ: &Organ, forces: &[(NodeId, f64)]) -> f64 {
        let rest_m = &organ.mesh().positions_m;
        let (mut sum, mut total_n) = (0.0, 0.0);
        for (i, &(node, force_n)) in forces.iter().enumerate() {
            let own = own_per_m(organ, node);
            sum += force_n * force_n * own;
            total_n += force_n;
            for &(other, other_n) in &forces[..i] {
                let between_m = rest_m[node.index()].distance(rest_m[other.index()]);
                let mutual = (FRAC_1_PI / between_m).min(own);
                sum += 2.0 * force_n * other_n * mutual;
            }
        }
        sum / (total_n * total_n * self.reduced_modulus_pa)
    }

    /// s/F [m/N] of a ball that bears on nodes with these forces along its way, in the mean so much further out than its foremost
    /// point [m].
    pub(super) fn missing_m_per_n(
        &self,
        organ: &Organ,
        (radius_m, further_out_m): (f64, f64),
        forces: &[(NodeId, f64)],
    ) -> f64 {
        let force_n: f64 = forces.iter().map(|(_, force_n)| force_n).sum();
        let of_mesh = self.mesh_m_per_n(organ, forces) + further_out_m / force_n;
        let of_ball = self.ball_m_per_n(radius_m, force_n);
        // Forces that nearly cancel, as in a fold, tell nothing of the mesh: it yields by nothing or more, not against them.
        let missing = of_ball - of_mesh;
        if missing.is_finite() { missing.clamp(0.0, of_ball) } else { 0.0 }
    }

    /// s/F [m/N] of a touch that just begins on a node.
    pub(super) fn at_first_m_per_n(&self, radius_m: f64) -> f64 {
        self.ball_m_per_n(radius_m, 0.0)
    }
}

/// g_ii E* [1/m]: as found in the mesh at its start; of nodes that edits brought in or laid bare by their area.
fn own_per_m(organ: &Organ, node: NodeId) -> f64 {
    organ
        .node_answer_per_m(node)
        .unwrap_or_else(|| UNIFORM_PRESSURE * STIFF_MESH / area_m2(organ, node).sqrt())
}

/// A third of the area at rest of the triangles around a node of the surface [m2].
fn area_m2(organ: &Organ, node: NodeId) -> f64 {
    let rest_m = &organ.mesh().positions_m;
    let areas_m2 = organ.skin().around(node).map(|nodes| {
        let [a, b, c] = nodes.map(|node| rest_m[node.index()]);
        (b - a).cross(c - a).length() / 6.0
    });
    areas_m2.sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use crate::mesh::TetMesh;

    /// Forces of the sides of a fold on one part cancel but for rounding.
    #[test]
    fn forces_that_cancel_leave_no_more_missing_than_a_touch_that_begins() {
        let contact = Indentation::of(&LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap());
        let positions_m = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * 0.01).to_vec();
        let mesh = TetMesh { positions_m, tetrahedra: vec![[0, 1, 2, 3].map(NodeId)], ..TetMesh::default() };
        let organ = Organ::new(mesh, &[], vec![0; 4]).unwrap();
        let radius_m = 3e-3;
        let most = contact.at_first_m_per_n(radius_m);
        let cancels = |left_n: f64| vec![(NodeId(0), 0.5), (NodeId(1), -0.5 + left_n)];
        for left_n in [1e-12, 1e-9, 0.0, -1e-12, -1e-9] {
            for forces in [cancels(left_n), vec![(NodeId(0), left_n)]] {
                // The places of both sides, weighted by forces of either sign, are in the mean anywhere.
                for further_out_m in [-1e-3, 0.0, 1e-3] {
                    let missing = contact.missing_m_per_n(&organ, (radius_m, further_out_m), &forces);
                    assert!((0.0..=most).contains(&missing), "{forces:?}, {further_out_m} m: {missing} m/N");
                }
            }
        }
    }

    #[test]
    fn a_shallow_contact_is_hertz_and_a_deep_one_sneddon() {
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
        let contact = Indentation::of(&material);
        let (reduced_pa, radius_m): (f64, f64) = (5e3 / (1.0 - 0.45 * 0.45), 5e-3);
        let depth_m = 0.01 * radius_m;
        let hertz_n = 4.0 / 3.0 * reduced_pa * radius_m.sqrt() * depth_m.powf(1.5);
        let found_m = contact.ball_m_per_n(radius_m, hertz_n) * hertz_n;
        assert!((found_m / depth_m - 1.0).abs() < 5e-3, "{found_m}");
        // a = 0.834 R: d = 1.0016 R, F = 1.2018 E* R^2.
        let force_n = 1.2018 * reduced_pa * radius_m * radius_m;
        let found_m = contact.ball_m_per_n(radius_m, force_n) * force_n;
        assert!((found_m / (1.0016 * radius_m) - 1.0).abs() < 2e-3, "{found_m}");
        // More force, deeper, and stiffer.
        let per_force = [0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0].map(|f| contact.ball_m_per_n(radius_m, f));
        assert!(per_force.windows(2).all(|pair| pair[0] >= pair[1]), "{per_force:?}");
    }
}
