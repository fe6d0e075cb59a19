//! The quasi non-linear correction of a linear model (Cotin, Delingette and Ayache 1998, RR-3511, s. 3.4 and 4.3, eqs
//! 3 to 6): the linear answer to the same constraints, with magnitudes that follow curves measured on a sample.
//!
//! With the line d along which the constraint moves the tissue, the linear displacement of node n is split into
//! u_n^t along d and u_n^r orthogonal to it, the linear force at a constrained node into f_n^t and f_n^r. Then
//!
//! u_n = u_n^t + P(|u_n^r|) u_n^r/|u_n^r|,   f_n = f_n^r + Q(|f_n^t|) f_n^t/|f_n^t|.
//!
//! P and Q are polynomials through the origin ([`CurvePolynomial`]), so that the quotients are continuous at zero, where
//! the printed ones are 0/0. Their arguments are the *linear* magnitudes: a curve measured over the axial displacement is
//! converted by the linear response of the same sample ([`LinearSample`], the paper's d_r^L = nu r x/h and
//! f^L = s E x/h).
//!
//! Where the paper is silent, chosen here:
//! - Several constrained nodes: d is the line along which their displacements are largest (principal axis of
//!   sum u u^T), the same whatever the order of the nodes and for the two jaws of a pinch. A curve is measured on the
//!   sample as a whole, so Q takes the sum of the collinear forces on the nodes that move one way along d, and they are
//!   scaled alike; those that move the other way, or are held, are another such sum. One node: eq. 6 itself.
//! - Constrained nodes keep the displacement that is imposed on them.
//! - Loads given as forces act on the linear body; with no imposed displacement, d is their principal axis.
//! - Curves measured in compression and traction both: compression where the constraint moves against the outward
//!   normal of the surface. A curve of one kind serves both.
//!
//! The correction changes magnitudes and is not an elastic law: forces and displacements are no longer in equilibrium
//! inside the body, and away from the places where the curves were measured the paper itself calls the result an
//! assumption.

mod curve;
mod fit;
mod polynomial;
pub(super) mod row;

pub use curve::{CurveError, MeasuredCurve};
pub use fit::{Fit, FitError, fit_curve};
pub use polynomial::{CurvePolynomial, GREATEST_DEGREE, LEAST_DEGREE, ScaleError};

use super::bounded_vec::BoundedVec;
use super::{
    Constraints, DeformableModel, LocalModel, LocalWork, ModelReport, ModelState, NodalForce, TopologyRefusal,
};
use crate::material::LinearElastic;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::topology::Topology;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Scene name.
const NAME: &str = "quasi_nonlinear";

/// Linear response of a sample per metre of compression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearSample {
    /// Force on its top [N/m].
    pub force_n_per_m: f64,
    /// TopologyUpdate of its radius at mid-height [m/m].
    pub radial_m_per_m: f64,
}

impl LinearSample {
    /// A cylinder between plates without friction: s E/h and nu r/h (seed `001`, s. 3.4).
    ///
    /// A mesh whose ends are held is stiffer than this; use the response of the mesh itself then.
    pub fn cylinder(height_m: f64, radius_m: f64, material: &LinearElastic) -> Self {
        let area_m2 = std::f64::consts::PI * radius_m * radius_m;
        Self {
            force_n_per_m: area_m2 * material.young_modulus_pa() / height_m,
            radial_m_per_m: material.poisson_ratio() * radius_m / height_m,
        }
    }
}

/// P and Q over linear magnitudes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Correction {
    /// Q: collinear force [N] over the linear one [N]; `None` leaves the linear one.
    pub force: Option<CurvePolynomial>,
    /// P: orthogonal displacement [m] over the linear one [m]; `None` leaves the linear one.
    pub radial: Option<CurvePolynomial>,
}

impl Correction {
    /// The correction from curves fitted over the axial displacement [m] of a sample with a known linear response.
    ///
    /// # Errors
    /// [`ScaleError`] where there is a curve and the sample's linear response is not finite and above 0: a material with a
    /// Poisson's ratio of 0 or less has no bulging to which a measured one could be related.
    pub fn of_sample(
        force_n: Option<&CurvePolynomial>,
        radial_m: Option<&CurvePolynomial>,
        sample: &LinearSample,
    ) -> Result<Self, ScaleError> {
        let over = |curve: Option<&CurvePolynomial>, factor, quantity| {
            let over = curve.map(|curve| curve.over(factor)).transpose();
            over.map_err(|ScaleError { found, .. }| ScaleError { quantity, found })
        };
        Ok(Self {
            force: over(force_n, sample.force_n_per_m, "linear force of the sample [N/m]")?,
            radial: over(radial_m, sample.radial_m_per_m, "linear bulging of the sample [m/m]")?,
        })
    }

    /// The correction for a body whose displacements are `length_ratio` times, and whose forces are `force_ratio` times, those
    /// of the sample at the same strain.
    ///
    /// # Panics
    /// When a ratio that is used is not finite and above 0.
    #[must_use]
    pub fn enlarged(&self, length_ratio: f64, force_ratio: f64) -> Self {
        Self {
            force: self.force.map(|q| q.enlarged(force_ratio)),
            radial: self.radial.map(|p| p.enlarged(length_ratio)),
        }
    }
}

/// The local model's slope of Q is at least this share of Q(f)/f: where a fit is level or falls, the tissue would not
/// resist a tool at all. A choice.
const LEAST_SLOPE: f64 = 0.05;

/// A linear model with corrected magnitudes.
pub struct QuasiNonlinear {
    linear: Box<dyn DeformableModel>,
    correction: Correction,
    rest_m: Vec<DVec3>,
    /// Outward area vector of the surface at each node [m2].
    outward_m2: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    constraint_forces_n: BoundedVec<DVec3>,
    /// Constrained nodes, and whether each moves along the axis, against it, or not at all.
    imposed: BoundedVec<(NodeId, bool)>,
    /// Unit vector of the line d; zero without a constraint.
    axis: DVec3,
}

impl QuasiNonlinear {
    /// The model `linear` on `mesh` with this correction. It must be a linear quasi-static model: `Precomputed`.
    ///
    /// # Errors
    /// [`glisson_mesh::mesh::topology::TopologyError`] when the mesh is no body.
    pub fn new(
        linear: Box<dyn DeformableModel>,
        mesh: &TetMesh,
        correction: Correction,
    ) -> Result<Self, glisson_mesh::mesh::topology::TopologyError> {
        let topology = Topology::build(mesh)?;
        let mut outward_m2 = vec![DVec3::ZERO; mesh.positions_m.len()];
        for triangle in topology.surface_triangles() {
            let share_m2 = topology.area_vector_m2(triangle, &mesh.positions_m) / 3.0;
            topology.outward_nodes(triangle).iter().for_each(|n| outward_m2[n.index()] += share_m2);
        }
        let n_nodes = mesh.positions_m.len();
        Ok(Self {
            positions_m: linear.state().positions_m.to_vec(),
            linear,
            correction,
            rest_m: mesh.positions_m.clone(),
            outward_m2,
            constraint_forces_n: BoundedVec::with_capacity(n_nodes),
            imposed: BoundedVec::with_capacity(n_nodes),
            axis: DVec3::ZERO,
        })
    }

    /// The linear model inside: its positions are the uncorrected ones.
    pub fn linear(&self) -> &dyn DeformableModel {
        &*self.linear
    }

    /// The correction.
    pub fn correction(&self) -> &Correction {
        &self.correction
    }

    /// Unit vector of the line along which the constraints of the last [`DeformableModel::apply`] move the tissue;
    /// zero when there are none.
    pub fn axis(&self) -> DVec3 {
        self.axis
    }

    /// Sum of collinear linear forces on one group, and whether the group moves out of the body.
    fn group(&self, is_along: bool) -> (f64, bool) {
        let (mut sum_n, mut outward_m2) = (0.0, 0.0);
        let members = self.imposed.iter().zip(self.linear.constraint_forces_n());
        for (&(node, _), force_n) in members.filter(|((_, along), _)| *along == is_along) {
            sum_n += force_n.dot(self.axis);
            outward_m2 += self.outward_m2.get(node.index()).map_or(0.0, |a| a.dot(self.axis));
        }
        (sum_n, if is_along { outward_m2 > 0.0 } else { outward_m2 < 0.0 })
    }

    fn correct_forces(&mut self) {
        self.constraint_forces_n.clear();
        let n = self.linear.constraint_forces_n().len();
        for place in 0..n {
            let force_n = self.linear.constraint_forces_n()[place];
            self.constraint_forces_n.try_push(force_n);
        }
        let Some(q) = &self.correction.force else { return };
        let factor = [false, true].map(|is_along| {
            let (sum_n, is_outward) = self.group(is_along);
            q.ratio(signed(sum_n.abs(), is_outward)) - 1.0
        });
        let axis = self.axis;
        for (force_n, &(_, is_along)) in self.constraint_forces_n.iter_mut().zip(self.imposed.iter()) {
            *force_n += axis * (factor[usize::from(is_along)] * force_n.dot(axis));
        }
    }

    /// Square root of the factor of the compliance along the axis, for each node of a group.
    fn softening(&self, q: &CurvePolynomial, is_along: bool) -> f64 {
        let (sum_n, is_outward) = self.group(is_along);
        let linear_n = signed(sum_n.abs(), is_outward);
        let slope = q.slope(linear_n).max(LEAST_SLOPE * q.ratio(linear_n));
        // Where Q is level at zero, its slope tells nothing.
        if slope > 0.0 { 1.0 / slope.sqrt() } else { 1.0 }
    }

    /// C = B C B; see [`DeformableModel::local_model_into`] of this model.
    fn soften(&self, out: &mut LocalModel) {
        let Some(q) = self.correction.force.filter(|_| !self.imposed.is_empty()) else { return };
        let of_group = [false, true].map(|is_along| self.softening(&q, is_along));
        let along = outer(self.axis, self.axis);
        let spread = |node: NodeId| {
            let imposed = self.imposed.iter().find(|(n, _)| *n == node);
            let factor = of_group[imposed.map_or(1, |(_, is_along)| usize::from(*is_along))];
            DMat3::IDENTITY + along * (factor - 1.0)
        };
        for i in 0..out.nodes.len() {
            for j in 0..out.nodes.len() {
                let tensor = spread(out.nodes[i]) * out.tensor_m_per_n(i, j) * spread(out.nodes[j]);
                out.set_tensor(i, j, tensor);
            }
        }
        out.symmetrize();
    }

    fn correct_displacements(&mut self) {
        let axis = self.axis;
        let curve = self.correction.radial.filter(|_| axis != DVec3::ZERO);
        let is_outward = curve.is_some_and(|p| !p.is_odd()) && self.group(true).1;
        let linear_m = self.linear.state().positions_m;
        let Some(p) = curve else {
            self.positions_m.copy_from_slice(linear_m);
            return;
        };
        for ((position_m, linear_m), rest_m) in self.positions_m.iter_mut().zip(linear_m).zip(&*self.rest_m) {
            let u_m = *linear_m - *rest_m;
            let orthogonal_m = u_m - axis * u_m.dot(axis);
            let factor = p.ratio(signed(orthogonal_m.length(), is_outward)) - 1.0;
            *position_m = *linear_m + orthogonal_m * factor;
        }
        for (node, _) in self.imposed.iter() {
            if let Some(position_m) = self.positions_m.get_mut(node.index()) {
                *position_m = linear_m[node.index()];
            }
        }
    }
}

/// A magnitude as the argument of a curve: traction is negative.
fn signed(magnitude: f64, is_outward: bool) -> f64 {
    if is_outward { -magnitude } else { magnitude }
}

/// Squarings of the power iteration: the 256th power separates axes whose shares differ by a few per cent.
const SQUARINGS: u32 = 8;

/// Unit vector of the line along which vectors with this sum of v v^T are largest; zero for the zero matrix.
fn principal_axis(sum: DMat3) -> DVec3 {
    let trace = |m: &DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
    if !(trace(&sum) > 0.0 && trace(&sum).is_finite()) {
        return DVec3::ZERO;
    }
    let mut power = sum * (1.0 / trace(&sum));
    for _ in 0..SQUARINGS {
        power = power * power;
        power *= 1.0 / trace(&power);
    }
    let columns = [power.x_axis, power.y_axis, power.z_axis];
    let longest = columns.into_iter().fold(DVec3::ZERO, |longest, c| {
        if c.length_squared() > longest.length_squared() { c } else { longest }
    });
    longest.normalize_or_zero()
}

/// Sum of v v^T over the largest size of a component, so that no square under- or overflows.
fn scatter(vectors: impl Iterator<Item = DVec3> + Clone) -> DMat3 {
    let finite = vectors.filter(|v| v.is_finite());
    let largest = finite.clone().fold(0.0, |m: f64, v| m.max(v.abs().max_element()));
    if largest == 0.0 {
        return DMat3::ZERO;
    }
    finite.fold(DMat3::ZERO, |sum, v| sum + outer(v / largest, v / largest))
}

impl DeformableModel for QuasiNonlinear {
    fn apply(&mut self, constraints: &Constraints) {
        self.linear.apply(constraints);
        let imposed = constraints.displacements.iter().map(|i| i.displacement_m);
        self.axis = principal_axis(scatter(imposed.clone()));
        if self.axis == DVec3::ZERO {
            self.axis = principal_axis(scatter(constraints.forces.iter().map(|f: &NodalForce| f.force_n)));
        }
        // Most of the nodes move along the axis, not against it.
        if imposed.filter(|u| u.is_finite()).map(|u| u.dot(self.axis)).sum::<f64>() < 0.0 {
            self.axis = -self.axis;
        }
        self.imposed.clear();
        for imposed in &constraints.displacements {
            self.imposed.try_push((imposed.node, imposed.displacement_m.dot(self.axis) > 0.0));
        }
    }

    fn step(&mut self, dt_s: f64) {
        self.linear.step(dt_s);
        self.correct_forces();
        self.correct_displacements();
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, ..self.linear.state() }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        self.linear.history_into(numbers);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.linear.take_over(positions_m);
        self.positions_m.copy_from_slice(self.linear.state().positions_m);
        self.constraint_forces_n.fill(DVec3::ZERO);
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.linear.set_gravity(gravity_m_per_s2);
    }

    fn report(&self) -> ModelReport {
        self.linear.report()
    }

    /// Positions and forces are the corrected ones; C = B C_linear B with B = 1 + (1/sqrt(Q') - 1) d d^T, and Q' the slope of Q
    /// at the linear force on a node's group. For a node that is not constrained, the group is that of the nodes moving along
    /// d.
    ///
    /// Along d, C is the linear one over Q', as in equation 6 while the nodes of a group share its force as they do now;
    /// across d it is the linear one. C stays symmetric: the entries between the two have the factor 1/sqrt(Q'), where
    /// equation 6 has a factor of one. P changes positions only. Without an imposed displacement Q does not act, and C is
    /// the linear one: a tool feels linear tissue at the first touch, until its nodes are constrained.
    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        self.linear.local_model_into(patch, period_s, work, out);
        for (node, position_m) in out.nodes.iter().zip(&mut out.position_m) {
            *position_m = self.positions_m[node.index()];
        }
        let linear_n = self.linear.constraint_forces_n();
        for ((&(node, _), corrected_n), linear_n) in
            self.imposed.iter().zip(self.constraint_forces_n.iter()).zip(linear_n)
        {
            if let Some(i) = out.nodes.iter().position(|n| *n == node) {
                out.force_n[i] += *corrected_n - *linear_n;
            }
        }
        self.soften(out);
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(Self {
            linear: self.linear.duplicate(),
            correction: self.correction,
            rest_m: self.rest_m.clone(),
            outward_m2: self.outward_m2.clone(),
            positions_m: self.positions_m.clone(),
            constraint_forces_n: self.constraint_forces_n.clone(),
            imposed: self.imposed.clone(),
            axis: self.axis,
        })
    }

    fn topology_refusal(&self) -> Option<TopologyRefusal> {
        Some(TopologyRefusal::Frozen {
            model: NAME,
            reason: "the linear model that it corrects holds for the uncut mesh; switch to tensor_mass before cutting",
        })
    }

    fn topology_changed(&mut self, _: &TetMesh, _: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.topology_refusal().map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_is_that_of_the_largest_displacements() {
        let d = DVec3::new(1.0, -2.0, 0.5).normalize();
        let same = |v: DVec3| (v.dot(d).abs() - 1.0).abs();
        assert!(same(principal_axis(scatter([d * 1e-3].into_iter()))) < 1e-15);
        assert!(same(principal_axis(scatter([d * 1e-200, d * -3e-200].into_iter()))) < 1e-15);
        let across = d.any_orthonormal_vector();
        assert!(same(principal_axis(scatter([d, d * 0.9, across * 0.3].into_iter()))) < 1e-12);
        assert_eq!(principal_axis(scatter([DVec3::ZERO, DVec3::NAN].into_iter())), DVec3::ZERO);
    }
}
