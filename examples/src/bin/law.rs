//! A constitutive law of one's own: it implements [`Material`], is checked by differences, and deforms a body.
//!
//! Demiray's law (H. Demiray, A note on the elasticity of soft biological tissues, Journal of Biomechanics 5, 1972),
//! made compressible as [`glisson::material::MooneyRivlin`] is:
//!
//! `W = mu/(2 b) (exp(b (I - 3)) - 1) + K/2 (J - 1)^2`, I = J^(-2/3) tr(F^T F), J = det F, mu and K in Pa, b a number.
//!
//! The stress grows exponentially with the stretch, as that of skin, vessels and capsules does. A bar under a
//! dead load then has a closed form: at constant volume its stretch s bears mu exp(b (s^2 + 2/s - 3)) (s - 1/s^2) per
//! area of the unloaded bar. The parameters here are an example, not a tissue's.
#![allow(clippy::print_stdout, reason = "an example shows its figures on standard output")]

use glisson::material::Material;
use glisson::material::check::{DerivativeErrors, derivative_errors};
use glisson::math::{DMat3, DVec3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson::model::{Constraints, DeformableModel, DynamicBody, FixedNode, NodalForce};
use std::error::Error;

/// Demiray's law.
#[derive(Clone, Copy)]
struct Demiray {
    /// mu [Pa].
    shear_pa: f64,
    /// b.
    exponent: f64,
    /// K [Pa].
    bulk_pa: f64,
}

/// a : b, the sum of products of entries.
fn contraction(a: &DMat3, b: &DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

/// dJ/dF, and its change with F by `df`.
fn cofactor(f: &DMat3, df: &DMat3) -> [DMat3; 2] {
    let ([a, b, c], [da, db, dc]) = ([f.x_axis, f.y_axis, f.z_axis], [df.x_axis, df.y_axis, df.z_axis]);
    let value = DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b));
    let x = db.cross(c) + b.cross(dc);
    let y = dc.cross(a) + c.cross(da);
    let z = da.cross(b) + a.cross(db);
    [value, DMat3::from_cols(x, y, z)]
}

impl Demiray {
    /// I, dI/dF and the change of dI/dF by `df`.
    fn invariant(f: &DMat3, df: &DMat3) -> (f64, DMat3, DMat3) {
        let (j, trace) = (f.determinant(), contraction(f, f));
        let [cofactor, cofactor_change] = cofactor(f, df);
        let (dj, dtrace) = (contraction(&cofactor, df), 2.0 * contraction(f, df));
        let shrink = j.powf(-2.0 / 3.0);
        let slope = (*f * 2.0 - cofactor * (2.0 / 3.0 * trace / j)) * shrink;
        let inner = cofactor * (dtrace / j - trace * dj / (j * j)) + cofactor_change * (trace / j);
        let change = (*df * 2.0 - inner * (2.0 / 3.0)) * shrink - slope * (2.0 / 3.0 * dj / j);
        (shrink * trace, slope, change)
    }

    /// exp(b (I - 3)).
    fn growth(&self, invariant: f64) -> f64 {
        (self.exponent * (invariant - 3.0)).exp()
    }

    /// Load over the unloaded cross-section [Pa] of a bar that keeps its volume.
    fn bar_load_pa(&self, s: f64) -> f64 {
        self.shear_pa * self.growth(s * s + 2.0 / s) * (s - 1.0 / (s * s))
    }
}

impl Material for Demiray {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let j = f.determinant();
        if j <= 0.0 {
            // Outside its range a law has an infinite energy: the solver then shortens its step.
            return f64::INFINITY;
        }
        let (invariant, ..) = Self::invariant(f, &DMat3::ZERO);
        0.5 * self.shear_pa / self.exponent * (self.growth(invariant) - 1.0)
            + 0.5 * self.bulk_pa * (j - 1.0) * (j - 1.0)
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        let (invariant, slope, _) = Self::invariant(f, &DMat3::ZERO);
        let [cofactor, _] = cofactor(f, &DMat3::ZERO);
        slope * (0.5 * self.shear_pa * self.growth(invariant))
            + cofactor * (self.bulk_pa * (f.determinant() - 1.0))
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let (invariant, slope, slope_change) = Self::invariant(f, df);
        let [cofactor, cofactor_change] = cofactor(f, df);
        let isochoric = slope * (self.exponent * contraction(&slope, df)) + slope_change;
        let volumetric = cofactor * contraction(&cofactor, df) + cofactor_change * (f.determinant() - 1.0);
        isochoric * (0.5 * self.shear_pa * self.growth(invariant)) + volumetric * self.bulk_pa
    }
}

/// Side of the cube [m].
const SIDE_M: f64 = 0.02;

/// Planes of symmetry: x = 0 does not move along x, and so on.
fn symmetry(mesh: &TetMesh) -> Vec<FixedNode> {
    let nodes = mesh.positions_m.iter().enumerate();
    let fixed =
        nodes.map(|(n, p)| FixedNode { node: NodeId::from_index(n), axes: p.to_array().map(|x| x == 0.0) });
    fixed.filter(|fixed| fixed.axes.contains(&true)).collect()
}

/// Even load on the upper face of the cube, shared by its nodes by the triangles around them.
fn load_on_top(mesh: &TetMesh, load_pa: f64) -> Vec<NodalForce> {
    let is_top = |n: NodeId| mesh.positions_m[n.index()].z == SIDE_M;
    let mut forces_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    for tet in &mesh.tetrahedra {
        let top: Vec<NodeId> = tet.iter().copied().filter(|&n| is_top(n)).collect();
        if let [a, b, c] = top[..] {
            let [a_m, b_m, c_m] = [a, b, c].map(|n| mesh.positions_m[n.index()]);
            let area_m2 = 0.5 * (b_m - a_m).cross(c_m - a_m).length();
            [a, b, c].iter().for_each(|n| forces_n[n.index()].z += load_pa * area_m2 / 3.0);
        }
    }
    let all = forces_n.into_iter().enumerate();
    let forces = all.map(|(n, force_n)| NodalForce { node: NodeId::from_index(n), force_n });
    forces.filter(|force| force.force_n != DVec3::ZERO).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let law = Demiray { shear_pa: 2_000.0, exponent: 2.0, bulk_pa: 400_000.0 };
    // The check that every law of the library passes: central differences at random strains.
    let DerivativeErrors { stress, differential, n_negative } = derivative_errors(&law);
    println!("stress against dW/dF: {stress:.1e} of the tangent, its differential: {differential:.1e}");
    println!("projected tangents with a negative eigenvalue: {n_negative}");

    let mesh = box_of_five([2, 2, 2], DVec3::splat(SIDE_M));
    let fixed = symmetry(&mesh);
    // Steps of a second are long beside the bar's oscillations: implicit Euler goes to rest in a few.
    let body = DynamicBody { fixed: &fixed, time_step_s: 1.0, ..DynamicBody::new(&mesh, 1_000.0) };
    let shared = ImplicitLaw::shared(law);
    let params = ImplicitParams { tolerance: 1e-8, ..ImplicitParams::new(body, &shared) };
    let mut model = ImplicitEuler::build(&params)?;
    for stretch in [1.1, 1.2, 1.3, 1.4] {
        let load_pa = law.bar_load_pa(stretch);
        model.apply(&Constraints { forces: load_on_top(&mesh, load_pa), ..Constraints::default() });
        (0..10).for_each(|_| model.step(1.0));
        let top_m = model.state().positions_m.last().map_or(0.0, |p| p.z);
        println!("load {load_pa:.0} Pa: stretch {:.4}, closed form {stretch:.4}", top_m / SIDE_M);
    }
    Ok(())
}
