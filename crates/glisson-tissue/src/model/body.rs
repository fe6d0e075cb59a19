//! How a body is held, loaded at rest and damped: what every dynamic model takes beside its law.

use crate::solve::{Attachment, FixedNode, RestStress};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::TetMesh;

/// Rayleigh damping: C = mass_per_s M + stiffness_s K (Rayleigh 1877, The Theory of Sound, s. 97).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rayleigh {
    /// Factor of the mass [1/s]: a free slow motion decays as exp(-mass_per_s t/2).
    pub mass_per_s: f64,
    /// Factor of the stiffness [s]: damps fast motions.
    pub stiffness_s: f64,
}

impl Rayleigh {
    /// Damping of the mass alone.
    pub fn of_mass(mass_per_s: f64) -> Self {
        Self { mass_per_s, stiffness_s: 0.0 }
    }
}

/// What every dynamic model takes beside its law.
#[derive(Clone, Copy, Debug)]
pub struct DynamicBody<'a> {
    /// The body at rest; every tetrahedron counts.
    pub mesh: &'a TetMesh,
    /// Density [kg/m3].
    pub density_kg_per_m3: f64,
    /// Nodes that are held at rest along some or all axes; each at most once.
    pub fixed: &'a [FixedNode],
    /// Ligaments.
    pub attachments: &'a [Attachment],
    /// Stress in the rest shape, one a tetrahedron or none. With the equilibrating one
    /// (`solve::equilibrating_stress`) the rest shape is the loaded one.
    pub rest_stress_pa: &'a [RestStress],
    /// Gravity [m/s2].
    pub gravity_m_per_s2: DVec3,
    /// Damping.
    pub damping: Rayleigh,
    /// Largest internal step [s].
    pub time_step_s: f64,
    /// Into how many internal steps of at least `time_step_s / most_parts` the time step may be divided after an
    /// edit that made the stable step shorter. Where that is not enough, the masses of the limiting tetrahedra
    /// are scaled up, which [`super::ModelReport`] names. At least 1.
    pub most_parts: u32,
}

impl<'a> DynamicBody<'a> {
    /// A body without supports, loads and damping, at 1 ms.
    pub fn new(mesh: &'a TetMesh, density_kg_per_m3: f64) -> Self {
        Self {
            mesh,
            density_kg_per_m3,
            fixed: &[],
            attachments: &[],
            rest_stress_pa: &[],
            gravity_m_per_s2: DVec3::ZERO,
            damping: Rayleigh::default(),
            time_step_s: 1e-3,
            most_parts: DEFAULT_MOST_PARTS,
        }
    }
}

/// Enough for the bound of single tetrahedra, which holds after any cuts and is about half of the uncut step, with room to spare.
pub const DEFAULT_MOST_PARTS: u32 = 4;
