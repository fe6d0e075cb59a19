//! What threads and needles are made of.
//!
//! Diameters: Therapeutic Goods Order No. 49 (Australia 1995), schedule 1, the middle of what each size may be on average. Stiffness:
//! the initial modulus of rapidly absorbed polyglactin 910 of size 3-0, S. E. Naleway, W. Lear, J. J. Kruzic and C. B. Maughan 2015,
//! Mechanical properties of suture materials in general and cutaneous surgery, doi 10.1002/jbm.b.33171. A braid bends more easily than a
//! solid rod; by how much no readable source told, so that [`BRAID`] is a choice, as are the density of water (a thread's weight
//! counts for nothing beside its pull) and the friction on tissue (it falls with the load and differs between materials, L. Zhang
//! and others 2017, doi 10.1007/s11249-017-0909-6, whose coefficients could not be read).
//!
//! A needle is far stiffer than all that it meets: how stiff is a choice. It goes in at the force of a crack as wide as itself,
//! 164 J/m2 (bovine liver, C. Gokgol, C. Basdogan and D. Canadinc 2012, doi 10.1016/j.medengphy.2011.09.030) by its diameter.

use super::RodMaterial;
use std::f64::consts::PI;

/// A size of thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadSize {
    /// Its name in scenes, by the United States Pharmacopeia.
    pub name: &'static str,
    /// Diameter [m].
    pub diameter_m: f64,
}

/// The sizes, from thick to thin.
pub const SIZES: &[ThreadSize] = &[
    ThreadSize { name: "2-0", diameter_m: 0.325e-3 },
    ThreadSize { name: "3-0", diameter_m: 0.225e-3 },
    ThreadSize { name: "4-0", diameter_m: 0.175e-3 },
    ThreadSize { name: "5-0", diameter_m: 0.125e-3 },
];

/// Young's modulus along a thread [Pa].
pub const THREAD_PA: f64 = 9.32e9;
/// Bending stiffness of a braid over that of a solid rod: a choice.
pub const BRAID: f64 = 0.005;
/// Density [kg/m3]: a choice, of water.
pub const DENSITY_KG_PER_M3: f64 = 1000.0;
/// Coulomb's coefficient on tissue: a choice.
pub const FRICTION: f64 = 0.1;
/// Energy of a crack in liver [J/m2].
pub const CRACK_J_PER_M2: f64 = 164.0;
/// Diameter of a needle over that of its thread: a choice.
pub const NEEDLE_OVER_THREAD: f64 = 3.0;
/// How much stiffer a needle is than its thread along itself, how stiff in bending [N m2], and how much heavier: choices.
const NEEDLE_AXIAL: f64 = 10.0;
const NEEDLE_BENDING_N_M2: f64 = 5e-3;
const NEEDLE_WEIGHT: f64 = 30.0;

/// What a thread of this diameter is made of.
pub fn thread(diameter_m: f64) -> RodMaterial {
    let area_m2 = 0.25 * PI * diameter_m * diameter_m;
    let solid_n_m2 = THREAD_PA * PI / 64.0 * diameter_m.powi(4);
    RodMaterial {
        axial_stiffness_n: THREAD_PA * area_m2,
        bending_stiffness_n_m2: BRAID * solid_n_m2,
        linear_density_kg_per_m: DENSITY_KG_PER_M3 * area_m2,
    }
}

/// What its needle is made of.
pub fn needle(diameter_m: f64) -> RodMaterial {
    let thread = thread(diameter_m);
    RodMaterial {
        axial_stiffness_n: NEEDLE_AXIAL * thread.axial_stiffness_n,
        bending_stiffness_n_m2: NEEDLE_BENDING_N_M2,
        linear_density_kg_per_m: NEEDLE_WEIGHT * thread.linear_density_kg_per_m,
    }
}

/// Force at which its needle goes into liver [N].
pub fn puncture_force_n(diameter_m: f64) -> f64 {
    CRACK_J_PER_M2 * NEEDLE_OVER_THREAD * diameter_m
}
