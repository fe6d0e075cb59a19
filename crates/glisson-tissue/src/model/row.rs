//! What a model tells about itself, so that scenes, contact, edits, benchmarks and tests know it: one row, in the model's file.

use super::embedded::Embedded;
use super::{DeformableModel, ModelError, OrganBody};
use crate::material::{LawChoice, law_names};
use crate::solve::is_stable_under;
use glisson_mesh::mesh::NodeId;

/// A model that scenes know by name. The table of rows is [`super::kind::MODELS`].
#[derive(Debug)]
pub struct ModelRow {
    /// As scenes write it: the name of its [`super::kind::ModelKind`] in snake case.
    pub name: &'static str,
    /// What it is, in a few words.
    pub about: &'static str,
    /// Names of laws that it follows; the first is its own. None for springs without a law.
    pub laws: &'static [&'static str],
    /// Whether it follows every other law as well, also one that is not in the table of laws.
    pub follows_any_law: bool,
    /// Whether it knows fibres and the penalty on changes of volume.
    pub has_fibres: bool,
    /// Whether parts may be of other tissue.
    pub has_tissue_parts: bool,
    /// Whether its stress may relax.
    pub relaxes: bool,
    /// Whether it follows measured curves, without which it cannot be made.
    pub follows_curves: bool,
    /// How it moves.
    pub motion: ModelMotion,
    /// Whether contact can correct its steps: whether they answer to further forces with
    /// [`super::StepAnswer::NodeByNode`] or [`super::StepAnswer::Coupled`].
    pub corrects_steps: bool,
    /// Which edits of the mesh it follows.
    pub edits: FollowedEdits,
    /// Makes it of an organ at rest.
    pub make: MakeModel,
    /// Makes it of what is left of an organ from which tetrahedra are gone. None: it is made of the whole and follows their
    /// removal.
    pub make_as_cut: Option<MakeCutModel>,
}

/// Makes a model of an organ with its law, where the model follows that one; else with the model's own.
pub type MakeModel = fn(&OrganBody, Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError>;

/// Makes a model of the live tetrahedra of an organ.
pub type MakeCutModel = fn(&OrganBody, &[bool]) -> Result<Box<dyn DeformableModel>, ModelError>;

/// How a model moves, which decides on its time step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelMotion {
    /// It goes to its equilibrium in every step, of any length.
    QuasiStatic,
    /// Explicit dynamics: a step is at most the stable one.
    Explicit,
    /// Implicit dynamics: a step may have any length.
    Implicit,
    /// A part goes to its equilibrium; another one moves, and divides the step where it needs to.
    Mixed,
}

/// Which edits of the mesh a model follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FollowedEdits {
    /// None: it cannot be cut.
    None,
    /// Removals of tetrahedra alone.
    Removals,
    /// All of them.
    All,
}

impl ModelRow {
    /// A quasi-static model that follows one law and no edit, and knows nothing else: to begin a row with.
    pub(super) const fn quasi_static(
        name: &'static str,
        about: &'static str,
        laws: &'static [&'static str],
        make: MakeModel,
    ) -> Self {
        Self {
            name,
            about,
            laws,
            follows_any_law: false,
            has_fibres: false,
            has_tissue_parts: false,
            relaxes: false,
            follows_curves: false,
            motion: ModelMotion::QuasiStatic,
            corrects_steps: false,
            edits: FollowedEdits::None,
            make,
            make_as_cut: None,
        }
    }

    /// A model of explicit dynamics, which follows every edit and whose steps contact can correct: to begin a row with.
    pub(super) const fn explicit(
        name: &'static str,
        about: &'static str,
        laws: &'static [&'static str],
        make: MakeModel,
    ) -> Self {
        Self {
            motion: ModelMotion::Explicit,
            corrects_steps: true,
            edits: FollowedEdits::All,
            ..Self::quasi_static(name, about, laws, make)
        }
    }

    /// Names of all laws that it follows: its own first, then the others in the order of their table.
    pub fn all_laws(&self) -> Vec<&'static str> {
        let others = law_names().filter(|name| self.follows_any_law && !self.laws.contains(name));
        self.laws.iter().copied().chain(others).collect()
    }

    /// Whether it follows a law of this name.
    pub fn follows(&self, law: &str) -> bool {
        self.follows_any_law || self.laws.contains(&law)
    }

    /// The model of an organ at rest; a saved pre-computation is loaded if the organ names one.
    ///
    /// # Errors
    /// [`ModelError`]: a file that belongs to another organ, a time step above the stable one, something that the model does
    /// not know.
    pub fn build(&self, body: &OrganBody) -> Result<Box<dyn DeformableModel>, ModelError> {
        let law = body.law.as_ref().filter(|law| self.follows(law.name()));
        self.refuse_what_it_lacks(body)?;
        if law.map(LawChoice::name).or(self.laws.first().copied()) != Some("linear") {
            self.refuse_to_buckle(body)?;
        }
        let model = (self.make)(body, law)?;
        let is_embedded = body.embeds_cuts && self.edits == FollowedEdits::All;
        Ok(if is_embedded { Box::new(Embedded::new(model, &body.mesh)) } else { model })
    }

    /// The model of an organ from which tetrahedra are already gone: of what is left, or of the whole, which then has to
    /// follow the removals.
    ///
    /// # Errors
    /// As [`ModelRow::build`].
    pub fn build_as_cut(
        &self,
        body: &OrganBody,
        live: &[bool],
    ) -> Result<Box<dyn DeformableModel>, ModelError> {
        match self.make_as_cut {
            Some(make) if live.contains(&false) => {
                self.refuse_what_it_lacks(body)?;
                make(body, live)
            }
            _ => self.build(body),
        }
    }

    /// The held nodes of an organ, for a model that knows no supports along single axes and no ligaments.
    ///
    /// # Errors
    /// [`ModelError::Unsupported`] when there are such.
    pub fn nodes_fixed_wholly(&self, body: &OrganBody) -> Result<Vec<NodeId>, ModelError> {
        self.refuse_ligaments(body)?;
        if body.fixed.iter().any(|held| held.axes != [true; 3]) {
            return Err(self.lacks("supports along single axes"));
        }
        Ok(body.fixed.iter().map(|held| held.node).collect())
    }

    /// For a model that knows no ligaments.
    pub(super) fn refuse_ligaments(&self, body: &OrganBody) -> Result<(), ModelError> {
        if body.attachments.is_empty() { Ok(()) } else { Err(self.lacks("ligaments")) }
    }

    /// A linear body carries any stress at rest; for the others it may be more than the tissue's own stiffness bears.
    pub(super) fn refuse_to_buckle(&self, body: &OrganBody) -> Result<(), ModelError> {
        if body.rest_stress_pa.is_empty() {
            return Ok(());
        }
        match is_stable_under(&body.mesh, &body.materials(), &body.held_at_rest(), &body.rest_stress_pa) {
            Ok(true) => Ok(()),
            Ok(false) => Err(ModelError::Buckles { model: self.name }),
            Err(error) => Err(ModelError::RestStress(error)),
        }
    }

    fn refuse_what_it_lacks(&self, body: &OrganBody) -> Result<(), ModelError> {
        let asked = [
            (body.fibre.is_some() && !self.has_fibres, "fibres"),
            (body.volume_penalty_pa != 0.0 && !self.has_fibres, "penalties of volume changes"),
            (!body.relaxation.is_empty() && !self.relaxes, "relaxation terms"),
            (body.tissue_parts.is_some() && !self.has_tissue_parts, "parts of other tissue"),
        ];
        match asked.into_iter().find(|(lacks, _)| *lacks) {
            Some((_, what)) => Err(self.lacks(what)),
            None => Ok(()),
        }
    }

    fn lacks(&self, what: &'static str) -> ModelError {
        ModelError::Unsupported { model: self.name, what }
    }
}
