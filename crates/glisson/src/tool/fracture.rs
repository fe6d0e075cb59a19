//! Fracture energy: one law for cutting, tearing and burning tissue apart.
//!
//! A new crack of area A takes the energy G A, whoever pays for it: the blade's work, the elastic energy of stretched
//! tissue, or heat. G is measured in J/m2, which is also N/m: an edge of width b advances when it is pushed with G b.
//! In the two faces of a crack A is counted once.
//!
//! A blunt body of radius r goes in behind a ring crack as long as its circumference (flat punches: Shergold and Fleck 2004,
//! doi 10.1098/rspa.2004.1315), so that the force at which it breaks through is at least G 2 pi r; what the tissue around
//! stores is felt on top of it, because the model gives it.

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

    /// The same tissue with `share` of its strength left, 0 to 1.
    #[must_use]
    pub fn weakened(self, share: f64) -> Self {
        Self { energy_j_per_m2: self.energy_j_per_m2 * share.clamp(0.0, 1.0) }
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
        // Most tissue is far from tearing: with all principal strains squared the energy is no smaller.
        let columns = [strain.x_axis, strain.y_axis, strain.z_axis];
        let squares: f64 = columns.into_iter().map(DVec3::length_squared).sum();
        let trace = strain.x_axis.x + strain.y_axis.y + strain.z_axis.z;
        let stretch = trace.max(0.0);
        if 0.5 * material.lambda_pa() * stretch * stretch + material.mu_pa() * squares < limit {
            return false;
        }
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

/// An organ that comes apart where it is pushed or pulled too hard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tearing {
    /// What a crack takes.
    pub energy: FractureEnergy,
    /// What stretched tissue stores.
    pub material: LinearElastic,
}

/// A crack that a body opens as it goes ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrackFront {
    /// Length of the front [m]: the force on it has to reach G times this.
    pub length_m: f64,
    /// Area that has to be laid open before the tissue gives way [m2].
    pub area_m2: f64,
}

impl CrackFront {
    /// Before a blunt tip, or a shaft, of this radius: its circumference; it has broken through when the crack is as large as
    /// its cross-section (a choice: an advance of half the radius).
    pub fn blunt(radius_m: f64) -> Self {
        let pi = std::f64::consts::PI;
        Self { length_m: 2.0 * pi * radius_m, area_m2: pi * radius_m * radius_m }
    }

    /// Before an edge of which `length_m` presses on tissue; it is in when it went ahead by `radius_m`.
    pub fn edge(length_m: f64, radius_m: f64) -> Self {
        Self { length_m, area_m2: length_m * radius_m }
    }

    /// Around the patch of tissue that jaws hold: it tears out when the crack has gone all around it, as deep as it is wide.
    pub fn around(length_m: f64, width_m: f64) -> Self {
        let around_m = 2.0 * (length_m + width_m);
        Self { length_m: around_m, area_m2: around_m * width_m }
    }

    /// Whether a force is enough for the crack to run.
    pub fn is_pushed_open(self, energy: FractureEnergy, force_n: DVec3) -> bool {
        force_n.length() >= energy.cutting_force_n(self.length_m)
    }
}

/// Work on one crack front while it is pushed hard enough.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Breakthrough {
    work: CuttingWork,
}

impl Breakthrough {
    /// A body moved by `motion_m` while tissue pushed it with `force_on_body_n`. Answers whether the tissue gives way: its
    /// work under a force of at least G times the front's length has paid for the crack. Below that force nothing is saved
    /// up: what was done is stored in the tissue.
    pub fn push(
        &mut self,
        energy: FractureEnergy,
        front: CrackFront,
        force_on_body_n: DVec3,
        motion_m: DVec3,
    ) -> bool {
        if !front.is_pushed_open(energy, force_on_body_n) {
            self.work.leave();
            return false;
        }
        self.work.push(force_on_body_n, motion_m);
        self.work.pay(energy, front.area_m2)
    }

    /// Work saved up [J].
    pub fn available_j(&self) -> f64 {
        self.work.available_j
    }
}

/// Force with which jaws of this length have to close to part what is between them: the jaws sweep L^2 a / 2 of tissue while
/// their tips, where the force is measured, close by L a.
pub fn scissors_force_n(energy: FractureEnergy, jaw_length_m: f64) -> f64 {
    0.5 * energy.energy_j_per_m2 * jaw_length_m
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
    fn a_blunt_tip_breaks_through_with_its_circumference_and_not_by_a_blow() {
        let (energy, front) = (FractureEnergy::LIVER, CrackFront::blunt(3e-3));
        let critical_n = energy.cutting_force_n(front.length_m);
        assert!((critical_n - 164.0 * 0.018_849_6).abs() < 1e-3, "{critical_n}");
        let mut tip = Breakthrough::default();
        let step_m = DVec3::new(0.0, 0.0, -1e-5);
        // Below the limit for as long as you like.
        for _ in 0..10_000 {
            assert!(!tip.push(energy, front, DVec3::Z * 0.99 * critical_n, step_m));
        }
        assert_eq!(tip.available_j(), 0.0);
        // At it: after the way on which it lays its cross-section open.
        let n = (1..).find(|_| tip.push(energy, front, DVec3::Z * critical_n, step_m)).unwrap();
        assert!((f64::from(n) * 1e-5 / 1.5e-3 - 1.0).abs() < 0.01, "half the radius: {n} steps of 10 um");
        // One step of a blow, and a pull outwards, do nothing.
        assert!(!tip.push(energy, front, DVec3::Z * 5.0 * critical_n, step_m));
        assert!(!tip.push(energy, front, DVec3::Z * 5.0 * critical_n, -step_m));
    }

    #[test]
    fn scissors_pay_for_what_they_sweep() {
        let (energy, length_m, angle_rad) = (FractureEnergy::LIVER, 0.02, 0.7);
        let force_n = scissors_force_n(energy, length_m);
        let swept_m2 = 0.5 * length_m * length_m * angle_rad;
        assert!((force_n * length_m * angle_rad / (energy.energy_j_per_m2 * swept_m2) - 1.0).abs() < 1e-12);
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
