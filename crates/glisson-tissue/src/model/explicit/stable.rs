//! The largest stable step of central differences.
//!
//! The scheme is stable for h <= 2/omega_max with omega_max^2 the largest eigenvalue of M^-1 K; damping in
//! proportion to mass leaves the bound as it is (the roots of
//! (1 + d h/2) z^2 - (2 - omega^2 h^2) z + (1 - d h/2) = 0 stay in the unit circle for omega h <= 2).
//!
//! After any cuts: K and the lumped M are sums over tetrahedra, so the largest Rayleigh quotient of the whole, a
//! quotient of sums, is at most the largest quotient of a single tetrahedron with its own mass rho V/4 a corner
//! (the element eigenvalue theorem of Irons and Treharne, 1971, 3rd Conference on Matrix Methods in Structural
//! Mechanics); each is bounded from above by [`crate::solve::TetStiffness::squared_frequency_bound_per_s2`]. Removals only take
//! quotients away, so the bound stays. It is about half of the true limit, for corners share their mass.
//!
//! Uncut: power iteration estimates omega_max^2 from below; a value theta a few per cent above it is proven to
//! be above the spectrum by the Cholesky factorization of theta M - K, which exists only then. Meshes of more
//! than [`MOST_NODES_PROVEN`] nodes take a bound of shared masses ([`MassShares`]), because the factorization would take long.
//! Held nodes are left out of account: holding a node never raises a frequency.
//!
//! A law that stiffens as it is stretched tells by how much ([`StiffTet::stiffening`]); the bounds after cuts and of shared masses then
//! hold for every shape allowed for, and the proven one is that at rest with the largest stiffening of all tetrahedra: an estimate.

use super::mass_shares::{MassShares, StiffTet};
use crate::material::LinearElastic;
use crate::solve::{BoundaryConditions, FreeSystem, MeshEdges, P1Gradients, SolveError, StiffnessTensors};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use glisson_mesh::mesh::{TetId, TetMesh};

/// Kept below the bound, where a mode at omega h = 2 would grow by rounding.
pub(super) const MARGIN: f64 = 0.999;

/// Largest mesh whose step is proven by factorization: under half a second.
pub const MOST_NODES_PROVEN: usize = 10_000;

/// Power iteration converges from below within about 2 % in so many rounds; a worse estimate only costs a
/// further factorization.
const ROUNDS: usize = 80;

/// First value tried above the estimate, and the factor to the next one.
const ABOVE_ESTIMATE: f64 = 1.02;

/// The largest stable steps, and what limits them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StableStep {
    /// Largest step of the uncut mesh [s].
    pub step_s: f64,
    /// Largest step after any cuts [s]; not above [`StableStep::step_s`].
    pub after_cuts_s: f64,
    /// The tetrahedron of highest frequency by itself.
    pub tet: TetId,
}

impl StableStep {
    /// Bounds for a mesh of one material.
    ///
    /// # Errors
    /// [`SolveError`] for an empty mesh or a flat or inverted tetrahedron.
    pub(in crate::model) fn of(mesh: &TetMesh, material: &LinearElastic) -> Result<Self, SolveError> {
        Self::of_stiffness(mesh, material.density_kg_per_m3(), |_, gradients| StiffTet {
            at_rest: gradients.stiffness(material.lambda_pa(), material.mu_pa()),
            stiffening: 1.0,
        })
    }

    /// Bounds for a mesh whose tetrahedra are told one by one.
    ///
    /// # Errors
    /// [`SolveError`] for an empty mesh or a flat or inverted tetrahedron.
    pub(in crate::model) fn of_stiffness(
        mesh: &TetMesh,
        density_kg_per_m3: f64,
        stiffness_of: impl Fn(TetId, &P1Gradients) -> StiffTet,
    ) -> Result<Self, SolveError> {
        Stability::of_stiffness(mesh, density_kg_per_m3, stiffness_of).map(|stability| stability.step)
    }
}

/// The stable steps, and what each tetrahedron has to do with them.
#[derive(Clone)]
pub(in crate::model) struct Stability {
    pub(in crate::model) step: StableStep,
    /// Bound of each tetrahedron's squared frequency by itself, for every shape allowed for [1/s2].
    pub(in crate::model) tet_squared_frequency_per_s2: Vec<f64>,
    /// [`StiffTet::stiffening`] of each tetrahedron, if told.
    pub(in crate::model) tet_stiffening: Vec<f64>,
    /// Shares of the nodes' masses, if they were needed.
    shares: Option<MassShares>,
}

impl Stability {
    /// Bounds for a mesh whose tetrahedra are told one by one.
    ///
    /// # Errors
    /// [`SolveError`] for an empty mesh or a flat or inverted tetrahedron.
    pub(in crate::model) fn of_stiffness(
        mesh: &TetMesh,
        density_kg_per_m3: f64,
        stiffness_of: impl Fn(TetId, &P1Gradients) -> StiffTet,
    ) -> Result<Self, SolveError> {
        let edges = MeshEdges::of_mesh(mesh)?;
        let tets = (0..mesh.tetrahedra.len()).map(TetId::from_index);
        let of_tet =
            |tet: TetId| P1Gradients::of_tet(mesh, tet).map(|gradients| stiffness_of(tet, &gradients));
        let stiff: Vec<StiffTet> = tets.clone().map(of_tet).collect::<Result<_, _>>()?;
        let bounds_per_s2 = tets
            .zip(&stiff)
            .map(|(tet, stiff)| stiff.squared_frequency_per_s2([corner_kg(mesh, density_kg_per_m3, tet); 4]));
        let mut stability = Self::of_bounds(bounds_per_s2.collect());
        stability.tet_stiffening = stiff.iter().map(|stiff| stiff.stiffening).collect();
        let after_cuts = stability.tet_squared_frequency_per_s2[stability.step.tet.index()];
        let uncut = if mesh.positions_m.len() > MOST_NODES_PROVEN {
            let no_ligaments = vec![0.0; mesh.positions_m.len()];
            let stiffness = |tet: TetId| stiff[tet.index()];
            let mut shares = stability.take_mass_shares(mesh, density_kg_per_m3);
            shares.masses_mut().copy_from_slice(&masses_kg(mesh, density_kg_per_m3));
            shares.find_demands(&mesh.tetrahedra, |_| true, &no_ligaments, stiffness);
            let bound = shares.squared_frequency_per_s2(&mesh.tetrahedra, |_| true, &no_ligaments, stiffness);
            stability.shares = Some(shares);
            bound
        } else {
            let tensors = StiffnessTensors::assemble_with(mesh, &edges, |tet, _| stiff[tet.index()].at_rest)?;
            let stiffening = stability.tet_stiffening.iter().fold(1.0, |most: f64, of_tet| of_tet.max(most));
            stiffening
                * proven_squared_frequency(&edges, &tensors, &masses_kg(mesh, density_kg_per_m3), after_cuts)
        };
        stability.step.step_s = step_s(uncut.min(after_cuts));
        Ok(stability)
    }

    /// Bounds that hold after any cut, without a proof of more; where the bound of a tetrahedron is `known` [1/s2], its stiffness is not
    /// asked for. Does not tell how much each one stiffens.
    ///
    /// # Errors
    /// As [`Stability::of_stiffness`].
    pub(in crate::model) fn of_pieces(
        mesh: &TetMesh,
        density_kg_per_m3: f64,
        known: impl Fn(TetId) -> Option<f64>,
        stiffness_of: impl Fn(TetId, &P1Gradients) -> StiffTet,
    ) -> Result<Self, SolveError> {
        let found = |tet: TetId| {
            let stiff = stiffness_of(tet, &P1Gradients::of_tet(mesh, tet)?);
            Ok(stiff.squared_frequency_per_s2([corner_kg(mesh, density_kg_per_m3, tet); 4]))
        };
        let bound_of = |tet: TetId| match known(tet) {
            Some(bound_per_s2) => {
                debug_assert_eq!(found(tet), Ok(bound_per_s2), "what is known of {tet}");
                Ok(bound_per_s2)
            }
            None => found(tet),
        };
        let bounds_per_s2 = (0..mesh.tetrahedra.len()).map(TetId::from_index).map(bound_of);
        bounds_per_s2.collect::<Result<_, _>>().map(Self::of_bounds)
    }

    fn of_bounds(tet_squared_frequency_per_s2: Vec<f64>) -> Self {
        let (mut after_cuts, mut tet) = (0.0, TetId(0));
        for (t, &of_tet) in tet_squared_frequency_per_s2.iter().enumerate() {
            if of_tet > after_cuts {
                (after_cuts, tet) = (of_tet, TetId::from_index(t));
            }
        }
        let step = StableStep { step_s: step_s(after_cuts), after_cuts_s: step_s(after_cuts), tet };
        Self { step, tet_squared_frequency_per_s2, tet_stiffening: Vec::new(), shares: None }
    }

    /// Shares of the nodes' masses for these tetrahedra; on meshes of more than [`MOST_NODES_PROVEN`] nodes their demands are known,
    /// without ligaments.
    pub(in crate::model) fn take_mass_shares(
        &mut self,
        mesh: &TetMesh,
        density_kg_per_m3: f64,
    ) -> MassShares {
        if let Some(shares) = self.shares.take() {
            return shares;
        }
        let alone = (0..).map(TetId::from_index).zip(&self.tet_squared_frequency_per_s2);
        let kappa_n_per_m = alone.map(|(tet, per_s2)| per_s2 * corner_kg(mesh, density_kg_per_m3, tet));
        MassShares::new(kappa_n_per_m.collect(), mesh.positions_m.len())
    }
}

/// Mass of each node [kg].
pub(in crate::model) fn masses_kg(mesh: &TetMesh, density_kg_per_m3: f64) -> Vec<f64> {
    let mut masses_kg = vec![0.0; mesh.positions_m.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let corner_kg = corner_kg(mesh, density_kg_per_m3, TetId::from_index(t));
        nodes.iter().for_each(|node| masses_kg[node.index()] += corner_kg);
    }
    masses_kg
}

/// Mass of a tetrahedron at each of its corners [kg].
fn corner_kg(mesh: &TetMesh, density_kg_per_m3: f64, tet: TetId) -> f64 {
    density_kg_per_m3 * mesh.tet_volume_m3(tet) / 4.0
}

fn step_s(squared_frequency_per_s2: f64) -> f64 {
    MARGIN * 2.0 / squared_frequency_per_s2.sqrt()
}

/// A proven upper bound of the largest eigenvalue of M^-1 K [1/s2], at most `known`, which is one.
fn proven_squared_frequency(
    edges: &MeshEdges,
    tensors: &StiffnessTensors,
    mass_kg: &[f64],
    known: f64,
) -> f64 {
    let mut theta = ABOVE_ESTIMATE * estimate_from_below(edges, tensors, mass_kg);
    // Loose nodes have no row: any positive number does for them.
    let no_supports = BoundaryConditions::new();
    while theta < known {
        let shifted = StiffnessTensors {
            vertex: tensors
                .vertex
                .iter()
                .zip(mass_kg)
                .map(|(b, &m)| {
                    let inertia = if m > 0.0 { theta * m } else { 1.0 };
                    DMat3::from_diagonal(DVec3::splat(inertia)) - *b
                })
                .collect(),
            edge: tensors.edge.iter().map(|b| -*b).collect(),
        };
        let is_above = FreeSystem::new(edges, &shifted, &no_supports).and_then(|s| s.factorize());
        if is_above.is_ok() {
            return theta;
        }
        theta *= ABOVE_ESTIMATE;
    }
    known
}

/// Rayleigh quotient after power iteration: a lower bound of the largest eigenvalue of M^-1 K.
pub(in crate::model) fn estimate_from_below(
    edges: &MeshEdges,
    tensors: &StiffnessTensors,
    mass_kg: &[f64],
) -> f64 {
    let mut random = SeededRandom::new(0);
    let mut x: Vec<DVec3> =
        mass_kg.iter().map(|_| DVec3::new(random.normal(), random.normal(), random.normal())).collect();
    let mut force = vec![DVec3::ZERO; x.len()];
    let mut quotient = 0.0;
    for _ in 0..ROUNDS {
        let inertia: f64 = x.iter().zip(mass_kg).map(|(x, m)| m * x.length_squared()).sum();
        let scale = 1.0 / inertia.sqrt();
        x.iter_mut().for_each(|x| *x *= scale);
        tensors.force_into(edges, &x, &mut force);
        quotient = x.iter().zip(&force).map(|(x, f)| x.dot(*f)).sum();
        for ((x, f), &m) in x.iter_mut().zip(&force).zip(mass_kg) {
            *x = if m > 0.0 { *f / m } else { DVec3::ZERO };
        }
    }
    quotient
}
