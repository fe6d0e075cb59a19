//! Fracture energy: one law for cutting, tearing and burning tissue apart.
//!
//! A new crack of area A takes the energy G A, whoever pays for it: the blade's work, the elastic energy of stretched
//! tissue, or heat. G is measured in J/m2, which is also N/m: an edge of width b advances when it is pushed with G b.
//! In the two faces of a crack A is counted once.

use crate::material::{LinearElastic, eigen_symmetric};
use crate::math::{DMat3, DVec3};

/// Energy that a new crack takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FractureEnergy {
    /// Energy of a crack's area [J/m2].
    pub energy_j_per_m2: f64,
}

impl FractureEnergy {
    /// Bovine liver: 164 +- 6 J/m2 (Gokgol, Basdogan and Canadinc 2012, doi 10.1016/j.medengphy.2011.09.030, insertion of
    /// needles of four diameters). Porcine liver in other tests: 76 to 185 J/m2 (needles) and 187 to 225 (blades), both in
    /// table 2 of doi 10.1186/s10033-022-00767-4.
    pub const LIVER: Self = Self { energy_j_per_m2: 164.0 };

    /// Force [N] at which an edge of `width_m` cuts its way: the work F dx pays for the area b dx.
    pub fn cutting_force_n(self, width_m: f64) -> f64 {
        self.energy_j_per_m2 * width_m
    }

    /// Area [m2] that `work_j` can lay open.
    pub fn area_m2(self, work_j: f64) -> f64 {
        work_j.max(0.0) / self.energy_j_per_m2
    }

    /// Energy density [J/m3] at which a tetrahedron of `volume_m3` tears. A crack through a band of width h frees the
    /// elastic energy w h of each unit of its area, so that it runs when w h reaches G, whatever the mesh (crack band of
    /// Bazant and Oh 1983, Materials and Structures 16:155-177). h is the edge of the regular tetrahedron of the same volume.
    pub fn tearing_density_j_per_m3(self, volume_m3: f64) -> f64 {
        self.energy_j_per_m2 / libm::cbrt(6.0 * std::f64::consts::SQRT_2 * volume_m3)
    }

    /// Whether a tetrahedron tears: corners at rest and now [m], of an elastic tissue (St Venant-Kirchhoff energy of the
    /// stretched directions alone: tissue that is pressed together does not tear). A shape that is no number tears.
    pub fn tears(self, material: &LinearElastic, rest_m: [DVec3; 4], corners_m: [DVec3; 4]) -> bool {
        let edges = |c: [DVec3; 4]| DMat3::from_cols(c[1] - c[0], c[2] - c[0], c[3] - c[0]);
        let rest = edges(rest_m);
        let volume_m3 = rest.determinant().abs() / 6.0;
        let gradient = edges(corners_m) * rest.inverse();
        let strain = 0.5 * (gradient.transpose() * gradient - DMat3::IDENTITY);
        let limit = self.tearing_density_j_per_m3(volume_m3);
        let density = tensile_energy_density_j_per_m3(material, strain);
        density.is_nan() || density >= limit
    }
}

/// Elastic energy density of a strain [J/m3] that its stretched part holds: lambda/2 <tr E>^2 + mu sum <e_i>^2 with
/// principal strains e_i and <x> = max(x, 0) (split of Miehe, Hofacker and Welschinger 2010,
/// doi 10.1016/j.cma.2010.04.011).
pub fn tensile_energy_density_j_per_m3(material: &LinearElastic, strain: DMat3) -> f64 {
    let trace = strain.col(0).x + strain.col(1).y + strain.col(2).z;
    let (strains, _) = eigen_symmetric(&strain.transpose().to_cols_array_2d());
    let squares: f64 = strains.into_iter().map(|e| e.max(0.0) * e.max(0.0)).sum();
    let stretch = trace.max(0.0);
    if !trace.is_finite() {
        return f64::NAN;
    }
    0.5 * material.lambda_pa() * stretch * stretch + material.mu_pa() * squares
}

/// What a blade may cut: work that was done on it and not yet spent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CuttingWork {
    /// Work not yet spent [J].
    pub available_j: f64,
    /// Energy spent on new cracks [J].
    pub spent_j: f64,
}

impl CuttingWork {
    /// The blade was moved by `motion_m` against tissue that pushes it with `force_on_blade_n`. Work that the tissue does
    /// on the hand is not taken from what is there: it was stored in the tissue.
    pub fn push(&mut self, force_on_blade_n: DVec3, motion_m: DVec3) {
        self.available_j += (-force_on_blade_n.dot(motion_m)).max(0.0);
    }

    /// Pays for a crack of `area_m2`; answers whether there was enough. If not, nothing is spent.
    pub fn pay(&mut self, energy: FractureEnergy, area_m2: f64) -> bool {
        let price_j = energy.energy_j_per_m2 * area_m2;
        let is_enough = price_j <= self.available_j;
        if is_enough {
            self.available_j -= price_j;
            self.spent_j += price_j;
        }
        is_enough
    }

    /// The blade left the tissue: what was not spent went back into it.
    pub fn leave(&mut self) {
        self.available_j = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tissue() -> LinearElastic {
        LinearElastic::from_young_poisson(4100.0, 0.45, 1060.0).unwrap()
    }

    #[test]
    fn a_blade_of_a_centimetre_needs_less_than_two_newton() {
        let force_n = FractureEnergy::LIVER.cutting_force_n(0.01);
        assert!((force_n - 1.64).abs() < 1e-12);
        // The same by work: 1 mm of way opens 10 mm2.
        let mut work = CuttingWork::default();
        work.push(DVec3::new(0.0, 0.0, force_n), DVec3::new(0.0, 0.0, -1e-3));
        assert!((FractureEnergy::LIVER.area_m2(work.available_j) - 1e-5).abs() < 1e-18);
        assert!(!work.pay(FractureEnergy::LIVER, 1.01e-5));
        assert!(work.pay(FractureEnergy::LIVER, 0.99e-5));
        assert!(!work.pay(FractureEnergy::LIVER, 0.99e-5), "it was spent");
        work.push(DVec3::Z, DVec3::Z);
        assert!(work.available_j < 2e-5, "what pulls the blade in is no work of the hand");
    }

    #[test]
    fn tearing_costs_the_same_energy_whatever_the_mesh() {
        let energy = FractureEnergy::LIVER;
        for edge_m in [2e-3, 5e-3, 10e-3] {
            let volume_m3 = edge_m * edge_m * edge_m / (6.0 * std::f64::consts::SQRT_2);
            let density = energy.tearing_density_j_per_m3(volume_m3);
            assert!((density * edge_m / energy.energy_j_per_m2 - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn stretched_tissue_tears_and_pressed_or_turned_tissue_does_not() {
        let energy = FractureEnergy { energy_j_per_m2: 20.0 };
        let rest_m = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * 5e-3);
        let tears = |f: DMat3| energy.tears(&tissue(), rest_m, rest_m.map(|p| f * p));
        let stretched = |s: f64| DMat3::from_diagonal(DVec3::new(s, 1.0 / s.sqrt(), 1.0 / s.sqrt()));
        assert!(!tears(DMat3::IDENTITY));
        assert!(!tears(DMat3::from_rotation_x(1.0)));
        assert!(!tears(stretched(1.3)));
        assert!(!tears(DMat3::from_diagonal(DVec3::splat(0.3))), "pressed from all sides");
        assert!(tears(stretched(3.0)));
        assert!(tears(DMat3::from_rotation_y(2.0) * stretched(3.0)), "turned as well");
        assert!(tears(DMat3::IDENTITY * f64::NAN));
        // Uniaxial strain against the closed form.
        let e = 0.2;
        let strain = DMat3::from_diagonal(DVec3::new(e, 0.0, 0.0));
        let expected = (0.5 * tissue().lambda_pa() + tissue().mu_pa()) * e * e;
        assert!((tensile_energy_density_j_per_m3(&tissue(), strain) / expected - 1.0).abs() < 1e-12);
    }
}
