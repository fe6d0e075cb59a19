//! Parameters of an implicit model, and their checks.

use super::law::ImplicitLaw;
use super::{DynamicBody, VolumeResistance};
use crate::material::PronySeries;
use crate::solve::SolveError;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetId};

/// Why an implicit model cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ImplicitError {
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] SolveError),
    /// A parameter that is out of its range or not a number.
    #[error("{what} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which one, with its unit.
        what: &'static str,
        /// What was given.
        found: f64,
        /// What may be given.
        allowed: &'static str,
    },
    /// The number of laws is neither one nor that of the tetrahedra.
    #[error("{found} laws for {n_tets} tetrahedra; allowed: 1 or {n_tets}")]
    LawCount {
        /// Number of laws given.
        found: usize,
        /// Number of tetrahedra.
        n_tets: usize,
    },
    /// The number of rest stresses is neither zero nor that of the tetrahedra.
    #[error("{found} rest stresses for {n_tets} tetrahedra; allowed: 0 or {n_tets}")]
    RestStressCount {
        /// Number of stresses given.
        found: usize,
        /// Number of tetrahedra.
        n_tets: usize,
    },
    /// A rest stress that is not finite.
    #[error("the rest stress of tetrahedron {tet} is not finite")]
    RestStress {
        /// Which tetrahedron.
        tet: TetId,
    },
    /// A law without stiffness at rest.
    #[error(
        "the law of tetrahedron {tet} has lambda {lambda_pa} Pa and mu {mu_pa} Pa at rest; allowed: mu above 0 and \
         lambda above -2/3 mu"
    )]
    NotStiffAtRest {
        /// The first tetrahedron with this law.
        tet: TetId,
        /// Its first Lamé coefficient at rest [Pa].
        lambda_pa: f64,
        /// Its shear modulus at rest [Pa].
        mu_pa: f64,
    },
    /// Viscosity with a law that is linear in the displacements.
    #[error(
        "the stress of the law of tetrahedron {tet} does not turn with the body, so it cannot relax. Take a law for \
         large rotations"
    )]
    DoesNotTurn {
        /// The first tetrahedron with this law.
        tet: TetId,
    },
    /// Node-averaging with a law whose volume term is not separate.
    #[error(
        "node-averaged resistance is there for the ln J neo-Hookean law only (`ImplicitLaw::NeoHookeLog`): other laws \
         do not tell their volume term apart. Take that law, or `VolumeResistance::Element`"
    )]
    NotAveraged,
    /// Relaxation with averaged strain.
    #[error(
        "node-averaged strain does not go with relaxation: its stress does not turn with each tetrahedron. Take \
         `VolumeResistance::NodeAveraged`"
    )]
    AveragedStrainRelaxes,
    /// A node that is supported twice.
    #[error("node {node} is supported twice; name each node once, with all its axes")]
    SupportedTwice {
        /// Which node.
        node: NodeId,
    },
}

/// Parameters of an implicit model.
#[derive(Clone, Copy, Debug)]
pub struct ImplicitParams<'a> {
    /// Mesh, supports, loads and damping. `time_step_s` is the usual step: the first factor is made for it. The
    /// model is stable at any step, so `most_parts` has no meaning here.
    pub body: DynamicBody<'a>,
    /// The law.
    pub law: &'a ImplicitLaw,
    /// Relaxation of the stress, if any. The law is then the instantaneous one.
    pub relaxation: Option<&'a PronySeries>,
    /// Where the volume change is resisted.
    pub volume: VolumeResistance,
    /// Residual over applied, inertial and holding forces at which a step ends; [`DEFAULT_TOLERANCE`].
    pub tolerance: f64,
    /// What the conjugate gradients of a step are preconditioned with.
    pub preconditioner: Preconditioner,
}

/// What the conjugate gradients of a step are preconditioned with: the tangent at an earlier state, inverted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preconditioner {
    /// A factor for small bodies, two grids for large ones.
    #[default]
    BySize,
    /// A sparse Cholesky factor: few iterations, exact local models; time and memory that grow faster than the body.
    Factor,
    /// Smoothing and the rigid motions of groups of nodes: more iterations, each in a time that grows with the number of nodes.
    TwoGrid,
}

/// A tenth of a per cent of the forces: below what linear tetrahedra of organ size can promise.
pub const DEFAULT_TOLERANCE: f64 = 1e-3;
/// Newton's method cannot reach less than this in double precision.
const LEAST_TOLERANCE: f64 = 1e-12;

fn refuse(what: &'static str, found: f64, allowed: &'static str) -> Result<(), ImplicitError> {
    Err(ImplicitError::Parameter { what, found, allowed })
}

fn from_zero(what: &'static str, found: f64) -> Result<(), ImplicitError> {
    if found.is_finite() && found >= 0.0 { Ok(()) } else { refuse(what, found, "a finite number from 0") }
}

impl<'a> ImplicitParams<'a> {
    /// An elastic body with volume resisted in each tetrahedron and the default tolerance.
    pub fn new(body: DynamicBody<'a>, law: &'a ImplicitLaw) -> Self {
        Self {
            body,
            law,
            relaxation: None,
            volume: VolumeResistance::Element,
            tolerance: DEFAULT_TOLERANCE,
            preconditioner: Preconditioner::BySize,
        }
    }

    /// Checks everything that needs no building; [`ImplicitLaw::stand_ins`] checks the laws.
    pub(super) fn check(&self) -> Result<(), ImplicitError> {
        self.check_numbers()?;
        self.check_mesh()?;
        self.check_ligaments()?;
        self.check_rest_stress()?;
        self.check_combination()?;
        self.free_axes().map(|_| ())
    }

    fn check_numbers(&self) -> Result<(), ImplicitError> {
        let body = &self.body;
        from_zero("mass damping [1/s]", body.damping.mass_per_s)?;
        from_zero("stiffness damping [s]", body.damping.stiffness_s)?;
        for (what, found) in
            [("density [kg/m3]", body.density_kg_per_m3), ("time step [s]", body.time_step_s)]
        {
            if !(found.is_finite() && found > 0.0) {
                return refuse(what, found, "a finite number above 0");
            }
        }
        if !body.gravity_m_per_s2.is_finite() {
            return refuse("gravity [m/s2]", body.gravity_m_per_s2.length(), "finite numbers");
        }
        if !(self.tolerance >= LEAST_TOLERANCE && self.tolerance <= 0.1) {
            return refuse("tolerance", self.tolerance, "1e-12 to 0.1");
        }
        Ok(())
    }

    fn check_mesh(&self) -> Result<(), SolveError> {
        let mesh = self.body.mesh;
        let n_nodes = mesh.positions_m.len();
        if mesh.tetrahedra.is_empty() {
            return Err(SolveError::EmptyMesh);
        }
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            if let Some(&node) = nodes.iter().find(|n| n.index() >= n_nodes) {
                return Err(SolveError::NodeOutOfRange { tet: TetId::from_index(t), node, n_nodes });
            }
        }
        Ok(())
    }

    fn check_ligaments(&self) -> Result<(), ImplicitError> {
        let n_nodes = self.body.mesh.positions_m.len();
        for ligament in self.body.attachments {
            if ligament.node.index() >= n_nodes {
                return Err(SolveError::ConditionOutOfRange { node: ligament.node, n_nodes }.into());
            }
            from_zero("stiffness of an attachment [N/m]", ligament.stiffness_n_per_m)?;
            from_zero("slack length of an attachment [m]", ligament.slack_length_m)?;
            if !ligament.anchor_m.is_finite() {
                return refuse("anchor of an attachment [m]", ligament.anchor_m.length(), "finite numbers");
            }
        }
        Ok(())
    }

    fn check_rest_stress(&self) -> Result<(), ImplicitError> {
        let rest_stress_pa = self.body.rest_stress_pa;
        let n_tets = self.body.mesh.tetrahedra.len();
        if !(rest_stress_pa.is_empty() || rest_stress_pa.len() == n_tets) {
            return Err(ImplicitError::RestStressCount { found: rest_stress_pa.len(), n_tets });
        }
        match rest_stress_pa.iter().position(|s| !s.iter().all(|x| x.is_finite())) {
            Some(t) => Err(ImplicitError::RestStress { tet: TetId::from_index(t) }),
            None => Ok(()),
        }
    }

    /// Refuses unsupported combinations of law, volume resistance and relaxation.
    fn check_combination(&self) -> Result<(), ImplicitError> {
        if self.volume != VolumeResistance::Element && !matches!(self.law, ImplicitLaw::NeoHookeLog(_)) {
            return Err(ImplicitError::NotAveraged);
        }
        if self.relaxation.is_some() && self.volume == VolumeResistance::NodeAveragedStrain {
            return Err(ImplicitError::AveragedStrainRelaxes);
        }
        if self.relaxation.is_some()
            && let Some(t) = self.law.first_not_turning()
        {
            return Err(ImplicitError::DoesNotTurn { tet: TetId::from_index(t) });
        }
        Ok(())
    }

    /// 1 for each axis along which a node may move, 0 for the others.
    pub(super) fn free_axes(&self) -> Result<Vec<DVec3>, ImplicitError> {
        let n_nodes = self.body.mesh.positions_m.len();
        let mut free = vec![DVec3::ONE; n_nodes];
        let mut is_named = vec![false; n_nodes];
        for support in self.body.fixed {
            let n = support.node.index();
            if n >= n_nodes {
                return Err(SolveError::ConditionOutOfRange { node: support.node, n_nodes }.into());
            }
            if std::mem::replace(&mut is_named[n], true) {
                return Err(ImplicitError::SupportedTwice { node: support.node });
            }
            free[n] = DVec3::from_array(support.axes.map(|held| if held { 0.0 } else { 1.0 }));
        }
        Ok(free)
    }
}
