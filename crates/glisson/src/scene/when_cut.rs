//! `when_cut`: what becomes of a pre-computed organ when instruments cut it, and which organs cannot be cut.

use super::reader::{SceneError, Section};
use crate::model::kind::{MODELS, ModelKind};
use crate::model::{FollowedEdits, ModelMotion, ModelRow};
use crate::tool::{InstrumentKind, JawUse};

/// What becomes of a pre-computed organ that instruments divide.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenCut {
    /// It is a [`ModelKind::Hybrid`] of pre-computed zones from the start: those that an edit reaches turn dynamic.
    #[default]
    Hybrid,
    /// It stays pre-computed and loses tetrahedra, by low-rank updates.
    Removal,
}

/// As scenes write it.
const NAMES: [(&str, WhenCut); 2] = [("hybrid", WhenCut::Hybrid), ("removal", WhenCut::Removal)];

/// `when_cut` of a pre-computed organ. A saved pre-computation is one of the whole organ, and stays it.
pub(super) fn read_when_cut(
    section: &mut Section<'_>,
    model: ModelKind,
    is_saved: bool,
) -> Result<WhenCut, SceneError> {
    let unsaid = if is_saved { WhenCut::Removal } else { WhenCut::default() };
    if model != ModelKind::Precomputed {
        return Ok(unsaid);
    }
    let Some((name, at)) = section.string("when_cut")? else { return Ok(unsaid) };
    let named = NAMES.into_iter().find(|(known, _)| *known == name).map(|(_, when_cut)| when_cut);
    let allowed = match named {
        Some(WhenCut::Hybrid) if is_saved => "removal, with a saved pre-computation (\"precomputed\")",
        Some(when_cut) => return Ok(when_cut),
        None => "hybrid, removal",
    };
    Err(section.wrong_value(at, "when_cut", format!("\"{name}\""), allowed))
}

/// Whether an organ is a hybrid in a scene whose instruments divide it.
pub(super) fn turns_hybrid(model: ModelKind, when_cut: WhenCut) -> bool {
    model == ModelKind::Precomputed && when_cut == WhenCut::Hybrid
}

/// Instruments that a model does not follow.
pub(super) struct RefusedCuts {
    /// Whether those that take whole tetrahedra away are followed.
    pub(super) takes_tetrahedra: bool,
    /// What a scene may have instead.
    pub(super) allowed: String,
}

impl RefusedCuts {
    /// None for an organ that every instrument cuts.
    pub(super) fn of(model: ModelKind, when_cut: WhenCut, is_alone: bool) -> Option<Self> {
        let (name, edits) = (model.name(), model.row().edits);
        if edits == FollowedEdits::All || is_alone && turns_hybrid(model, when_cut) {
            return None;
        }
        let takes_tetrahedra = edits == FollowedEdits::Removals;
        let allowed = if takes_tetrahedra {
            let hybrid = if is_alone {
                "when_cut = \"hybrid\" in [organ] and take a saved pre-computation (\"precomputed\") out, or "
            } else {
                ""
            };
            format!(
                "hook, cautery or scissors, because model = \"{name}\" loses whole tetrahedra here; for a blade write {hybrid}another \
                 model: {}",
                names_of(
                    |row| row.edits == FollowedEdits::All && (is_alone || row.motion != ModelMotion::Mixed)
                )
            )
        } else {
            format!(
                "probe or grasper, because model = \"{name}\" cannot be cut; models that can: {}",
                names_of(|row| row.edits != FollowedEdits::None)
            )
        };
        Some(Self { takes_tetrahedra, allowed })
    }

    /// Whether an instrument is among them.
    pub(super) fn meets(&self, kind: &InstrumentKind) -> bool {
        let takes = kind.burns || kind.jaws == Some(JawUse::Part);
        kind.has_blade || takes && !self.takes_tetrahedra
    }
}

fn names_of(has: impl Fn(&ModelRow) -> bool) -> String {
    MODELS.iter().filter(|row| has(row)).map(|row| row.name).collect::<Vec<_>>().join(", ")
}
