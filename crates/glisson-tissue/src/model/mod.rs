//! Deformable models behind one contract: constraints in, positions and reaction forces out.

mod body;
mod correction;
mod report;
mod state_hash;
mod level_of_detail;
pub mod bounded_vec;
mod topology_update;
pub mod extended_mass_spring;
pub mod implicit;
mod tet_law;
pub mod kernel;
pub mod mass_spring;
pub(crate) mod explicit;
pub mod explicit_kernel;
pub mod local_model;
pub mod hybrid;
pub mod precomputed;
pub mod quasi_nonlinear;
pub mod reduced;
pub mod rheology;
pub mod tensor_mass;
pub mod nonlinear_tensor_mass;
mod undo;
pub mod rigid;
pub mod composite;
pub mod embedded;
mod error;
mod organ_body;
mod row;
pub mod kind;
mod body_set;

pub use crate::solve::{Attachment, FixedNode, RestStress};
pub use body::{DEFAULT_MOST_PARTS, DynamicBody, Rayleigh};
pub use body_set::{BodyPart, BodySet};
pub use correction::{Answered, Correction, StepAnswer};
pub use error::{ModelCause, ModelError};
pub use explicit::{ExplicitError, Inertia, Integration};
pub use level_of_detail::LevelOfDetail;
pub use local_model::{LocalModel, LocalWork};
pub use organ_body::{BodyZone, MeasuredSample, OrganBody, TissueParts};
pub use report::ModelReport;
pub use row::{FollowedEdits, MakeCutModel, MakeModel, ModelMotion, ModelRow};
pub use state_hash::StateHash;
use undo::UndoReader;
pub use undo::{ModelUndo, follow_edit};

use glisson_mesh::fault::OrderedFault;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// A node held at a displacement from its rest position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImposedDisplacement {
    /// Which node.
    pub node: NodeId,
    /// Displacement from the rest position [m].
    pub displacement_m: DVec3,
}

/// An external force on a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodalForce {
    /// Which node.
    pub node: NodeId,
    /// Force that the outside exerts on the node [N].
    pub force_n: DVec3,
}

/// A spring without length that holds a node near a place.
///
/// The pull of a thread turns with what it pulls on. Told as forces of a fixed direction it would throw tissue aside in a model that
/// goes far in one step: springs at the places that are expected at the end of a step, which pull nothing there, keep it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodalSpring {
    /// Which node.
    pub node: NodeId,
    /// The place [m].
    pub place_m: DVec3,
    /// Stiffness [N/m].
    pub stiffness_n_per_m: f64,
}

impl NodalSpring {
    /// Springs that a model takes in a step at most.
    pub const MOST: usize = 2048;
}

/// What the outside does to a model during one step. Both lists ascend by node, without repetition.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Constraints {
    /// Nodes moved by a tool.
    pub displacements: Vec<ImposedDisplacement>,
    /// Forces on free nodes.
    pub forces: Vec<NodalForce>,
}

/// Where a model's nodes are and how fast. What else its next step depends on: [`DeformableModel::history_into`].
#[derive(Clone, Copy, Debug)]
pub struct ModelState<'a> {
    /// Node positions [m].
    pub positions_m: &'a [DVec3],
    /// Node velocities [m/s]; empty for a model in which nothing has inertia.
    pub velocities_m_per_s: &'a [DVec3],
}

/// Why a model cannot follow a change of the mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TopologyRefusal {
    /// The model's data hold for the mesh they were computed on only.
    #[error("the {model} model cannot change its topology: {reason}")]
    Frozen {
        /// The model's scene name.
        model: &'static str,
        /// Why, and what to do.
        reason: &'static str,
    },
    /// A new or reshaped tetrahedron is flat, inside out or not finite.
    #[error(
        "the {model} model cannot follow the edit: tetrahedron {tet} has {volume_m3:e} m3 at rest; it must be a finite \
         number well above 0"
    )]
    Unsound {
        /// The model's scene name.
        model: &'static str,
        /// The first such tetrahedron.
        tet: TetId,
        /// Its volume at rest [m3].
        volume_m3: f64,
    },
    /// The change is of another mesh than the model's.
    #[error(
        "the {model} model cannot follow the edit: it has {n_tets} tetrahedra and {n_nodes} nodes, the edit was made in a \
         mesh of {n_tets_before} and {n_nodes_before}; make the model anew"
    )]
    OtherMesh {
        /// The model's scene name.
        model: &'static str,
        /// Tetrahedra of the model, dead ones included.
        n_tets: usize,
        /// Nodes of the model, dead ones included.
        n_nodes: usize,
        /// Tetrahedra of the mesh before the edit.
        n_tets_before: usize,
        /// Nodes of the mesh before the edit.
        n_nodes_before: usize,
    },
    /// The change is of a mesh with another number of nodes.
    #[error(
        "the model cannot follow the edit: it has {n_nodes} nodes, the edit was made in a mesh of {n_nodes_before}; make \
         the model anew"
    )]
    OtherNodes {
        /// Nodes of the model, dead ones included.
        n_nodes: usize,
        /// Nodes of the mesh before the edit.
        n_nodes_before: usize,
    },
    /// Only in tests.
    #[error(transparent)]
    Ordered(#[from] OrderedFault),
}

impl TopologyRefusal {
    /// Refuses a change of a mesh that has not the model's counts of tetrahedra and nodes.
    ///
    /// # Errors
    /// [`TopologyRefusal::OtherMesh`].
    pub fn of_other_mesh(
        model: &'static str,
        change: &TopologyChange,
        [n_tets, n_nodes]: [usize; 2],
    ) -> Result<(), Self> {
        let (n_tets_before, n_nodes_before) = (change.tets.n_before, change.nodes.n_before);
        if (n_tets, n_nodes) == (n_tets_before, n_nodes_before) {
            return Ok(());
        }
        Err(Self::OtherMesh { model, n_tets, n_nodes, n_tets_before, n_nodes_before })
    }
}

/// One organ's mechanics.
pub trait DeformableModel: Send {
    /// Takes over the constraints that hold from the next step on.
    fn apply(&mut self, constraints: &Constraints);

    /// Advances by `dt_s`; a quasi-static model goes to its equilibrium. Never fails, never allocates.
    fn step(&mut self, dt_s: f64);

    /// Positions and velocities after the last step.
    fn state(&self) -> ModelState<'_>;

    /// Appends the further numbers that the next step depends on (previous positions, viscous history). With [`Self::state`]
    /// they are all that changes in time: hashes and replays see no more.
    fn history_into(&self, numbers: &mut Vec<f64>);

    /// The clocks of bodies that have one [s], each also among the numbers of [`DeformableModel::history_into`].
    fn clocks_s(&self) -> &[f64] {
        &[]
    }

    /// The numbers of [`DeformableModel::history_into`].
    fn history(&self) -> Vec<f64> {
        let mut numbers = Vec::new();
        self.history_into(&mut numbers);
        numbers
    }

    /// Force [N] that the constraint exerts on each node of `Constraints::displacements`, in its order,
    /// after the last step. A tool feels the opposite.
    fn constraint_forces_n(&self) -> &[DVec3];

    /// Starts from these node positions with velocities zero: where another model left off, or the rest shape.
    /// A quasi-static model only shows them until its next step.
    fn take_over(&mut self, positions_m: &[DVec3]);

    /// [`DeformableModel::take_over`] of another model's state, with its velocities where it tells them and this model has
    /// its own answer to that: tissue in motion goes on. Others start at standstill. `clocks_s`: the other model's
    /// ([`DeformableModel::clocks_s`]).
    fn take_over_in_motion(&mut self, state: &ModelState<'_>, _clocks_s: &[f64]) {
        self.take_over(state.positions_m);
    }

    /// Brings positions up to date that steps leave out ([`OrganBody::inside_may_lag`]).
    fn bring_up_to_date(&mut self) {}

    /// Holds a node near a place in the steps until [`DeformableModel::apply`] is called again, which is called before. A model whose
    /// steps are short, or whose answer does not depend on its shape, needs none and leaves it aside; so may one that has no room.
    fn steady(&mut self, _spring: NodalSpring) {}

    /// Gravity from the next step on [m/s2]. A model whose rest shape is the loaded one answers to the difference
    /// from the gravity it was made with.
    fn set_gravity(&mut self, gravity_m_per_s2: DVec3);

    /// How thoroughly it computes from the next step on; answers whether that makes a difference to this model.
    fn set_level_of_detail(&mut self, _effort: LevelOfDetail) -> bool {
        false
    }

    /// How the last step went.
    fn report(&self) -> ModelReport;

    /// A copy of everything that the next steps depend on: state, constraints, accumulated stiffness, warm starts,
    /// factors.
    fn duplicate(&self) -> Box<dyn DeformableModel>;

    /// What the nodes of a touched patch do in the next `period_s`, for a haptic loop: see [`local_model`]. Overwrites
    /// `out`; never fails, and allocates nothing that [`LocalWork::with_room_for`] had room for. A model without an own
    /// answer gives a patch that does not yield.
    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        _work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        out.start(patch, period_s, self.state().positions_m);
    }

    /// How the result of a step answers to further forces: see [`StepAnswer`].
    fn step_answer(&self) -> StepAnswer {
        let is_static = self.state().velocities_m_per_s.is_empty();
        if is_static { StepAnswer::Static } else { StepAnswer::Unknown }
    }

    /// With [`StepAnswer::NodeByNode`]: displacement of a node for a unit force along each axis in a step of `dt_s`
    /// [m/N]; zero along axes that are fixed or held.
    fn node_answer_m_per_n(&self, _node: NodeId, _dt_s: f64) -> DVec3 {
        DVec3::ZERO
    }

    /// Corners at rest and now [m] of the element that carries a tetrahedron of the mesh ([`embedded`]); none where that is its own.
    fn carrier_m(&self, _tet: TetId) -> Option<[[DVec3; 4]; 2]> {
        None
    }

    /// Whether two places on the body, given as nodes with weights of sum zero, can move against each other at all. Places that the
    /// same element carries cannot ([`embedded`]).
    fn can_part(&self, _sides: &mut dyn Iterator<Item = (NodeId, f64)>) -> bool {
        true
    }

    /// With [`StepAnswer::Coupled`]: displacement [m] of every node for forces on some in a step of the length of the last
    /// one. Overwrites `moves_m`, as long as there are nodes; allocates nothing.
    fn answer_into(&mut self, _forces: &[NodalForce], moves_m: &mut [DVec3], _at: Answered) {
        moves_m.fill(DVec3::ZERO);
    }

    /// Corrects the last step, of `dt_s`, by what `forces` beside those applied would have done. With
    /// [`StepAnswer::NodeByNode`] and [`StepAnswer::Coupled`]; others do nothing. Allocates nothing.
    fn correct_step(&mut self, _forces: &[NodalForce], _dt_s: f64, _correction: Correction) {}

    /// Why the model could not follow an edit of the mesh, if it could not.
    fn topology_refusal(&self) -> Option<TopologyRefusal> {
        None
    }

    /// Follows an edit of the mesh, or says why it cannot. A model that refuses did not change, unless it is one that is
    /// copied whole for [`DeformableModel::save_for_undo`]: that one has to be put back or dropped. [`follow_edit`] does
    /// all of it.
    ///
    /// # Errors
    /// [`TopologyRefusal`] when the model cannot follow.
    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal>;

    /// Writes what [`DeformableModel::topology_changed`] with `change` is about to overwrite, and the state, into `undo`.
    /// Called between the edit of the mesh and `topology_changed`. A model without a shorter answer is copied whole.
    fn save_for_undo(&self, _change: &TopologyChange, undo: &mut ModelUndo) {
        undo.keep_whole(self.duplicate());
    }

    /// Whether the next edit makes the mesh finer and does nothing else: with embedded cuts, elements become smaller and not only
    /// what they carry, as long as nothing is cut.
    fn expect_finer_mesh(&mut self, _is_finer: bool) {}

    /// Both of [`DeformableModel::save_for_undo`] and [`DeformableModel::topology_changed`]: what [`follow_edit`] calls.
    ///
    /// # Errors
    /// As [`DeformableModel::topology_changed`].
    fn follow_saving(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        undo: &mut ModelUndo,
    ) -> Result<(), TopologyRefusal> {
        self.save_for_undo(change, undo);
        self.topology_changed(mesh, change)
    }

    /// Puts back what [`DeformableModel::save_for_undo`] wrote: every number has the bits from before the edit. Edits are
    /// undone in the opposite order. Called through [`ModelUndo::put_back`]; a model that is copied whole has nothing to do.
    fn undo(&mut self, _undo: &ModelUndo) {}
}
