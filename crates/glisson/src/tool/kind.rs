//! What an instrument is made for: the table of kinds, each of which says what parts it has.

use super::ligating_loop::LigatingLoop;
use super::{Blade, BladeCuts, CutRule, Jaws, Optics, Snip};

/// A kind of instrument: a row of the table [`INSTRUMENTS`]. What it does follows from the parts that it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstrumentKind {
    /// Its name in scenes.
    pub name: &'static str,
    /// What it does.
    pub about: &'static str,
    /// What its jaws do with what they close on; none for an instrument without jaws.
    pub jaws: Option<JawUse>,
    /// Whether it cuts along an edge.
    pub has_blade: bool,
    /// Whether it burns away what its tip touches, or what its closed jaws hold.
    pub burns: bool,
    /// Whether it looks through a lens at its tip.
    pub has_optics: bool,
    /// Whether it has a loop of thread before its tip, which jaws' lever draws tight and its trigger ties off.
    pub has_loop: bool,
    /// Whether it sucks while its trigger is pressed, and rinses while its lever is, which is where jaws are in an input (0 pressed): a
    /// matter of pictures, without effect on tissue.
    pub rinses: bool,
    /// Whether tissue sticks to it unless the scene knows how it slides.
    pub sticks: bool,
}

/// What jaws do with what they close on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JawUse {
    /// They hold it.
    Hold,
    /// They part it.
    Part,
    /// They set a clip on it.
    Clip,
}

/// An instrument without parts that tissue slides on: to begin a row with.
const PLAIN: InstrumentKind = InstrumentKind {
    name: "",
    about: "",
    jaws: None,
    has_blade: false,
    burns: false,
    has_optics: false,
    has_loop: false,
    rinses: false,
    sticks: false,
};

const PROBE: InstrumentKind = InstrumentKind { name: "probe", about: "pushes", sticks: true, ..PLAIN };
const GRASPER: InstrumentKind = InstrumentKind {
    name: "grasper",
    about: "holds tissue between its jaws",
    jaws: Some(JawUse::Hold),
    ..PLAIN
};
const SCISSORS: InstrumentKind = InstrumentKind {
    name: "scissors",
    about: "cuts what its jaws close on",
    jaws: Some(JawUse::Part),
    ..PLAIN
};
const SCALPEL: InstrumentKind =
    InstrumentKind { name: "scalpel", about: "cuts along its edge", has_blade: true, ..PLAIN };
const HOOK: InstrumentKind = InstrumentKind {
    name: "hook",
    about: "monopolar: burns away what its tip touches",
    burns: true,
    ..PLAIN
};
const CAUTERY: InstrumentKind = InstrumentKind {
    name: "cautery",
    about: "bipolar: burns away what its closed jaws hold",
    jaws: Some(JawUse::Hold),
    burns: true,
    ..PLAIN
};

const CLIPPER: InstrumentKind = InstrumentKind {
    name: "clipper",
    about: "sets clips on the threads that its jaws close on",
    jaws: Some(JawUse::Clip),
    ..PLAIN
};

const ENDOSCOPE: InstrumentKind =
    InstrumentKind { name: "endoscope", about: "shows what is before its tip", has_optics: true, ..PLAIN };

const SUCTION: InstrumentKind = InstrumentKind {
    name: "suction",
    about: "sucks away blood and smoke at its tip, and rinses",
    rinses: true,
    ..PLAIN
};

const LOOP: InstrumentKind = InstrumentKind {
    name: "loop",
    about: "draws a loop of thread tight around a stump, and ties it off",
    has_loop: true,
    ..PLAIN
};

/// Every kind, in the order of lists: one line a kind (docs/extending.md).
pub const INSTRUMENTS: &[InstrumentKind] =
    &[PROBE, GRASPER, SCISSORS, SCALPEL, HOOK, CAUTERY, CLIPPER, ENDOSCOPE, SUCTION, LOOP];

/// The names of all kinds, in the order of the table.
pub fn instrument_names() -> impl Iterator<Item = &'static str> {
    INSTRUMENTS.iter().map(|kind| kind.name)
}

/// What an instrument is made for, with the sizes of its parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolKind {
    kind: InstrumentKind,
    jaws: Option<Jaws>,
    blade: Option<Blade>,
    burning: Option<CutRule>,
    snip: Option<Snip>,
    optics: Option<Optics>,
    ligating_loop: Option<LigatingLoop>,
}

/// Sizes of the parts that instruments may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolParts {
    /// Of jaws.
    pub jaws: Jaws,
    /// Of an edge.
    pub blade: Blade,
    /// When an active tip takes away what it touches.
    pub burning: CutRule,
    /// What closing jaws do that part.
    pub snip: Snip,
    /// Of a lens.
    pub optics: Optics,
    /// Of a loop of thread.
    pub ligating_loop: LigatingLoop,
}

impl ToolKind {
    /// A probe: it pushes.
    pub const PROBE: Self = Self {
        kind: PROBE,
        jaws: None,
        blade: None,
        burning: None,
        snip: None,
        optics: None,
        ligating_loop: None,
    };

    /// A tube that sucks and rinses.
    pub const SUCTION: Self = Self { kind: SUCTION, ..Self::PROBE };

    /// An instrument of a kind, with those of the parts that the kind has.
    pub fn of(kind: &InstrumentKind, parts: &ToolParts) -> Self {
        Self {
            kind: *kind,
            jaws: kind.jaws.map(|_| parts.jaws),
            blade: kind.has_blade.then_some(parts.blade),
            burning: kind.burns.then_some(parts.burning),
            snip: (kind.jaws == Some(JawUse::Part)).then_some(parts.snip),
            optics: kind.has_optics.then_some(parts.optics),
            ligating_loop: kind.has_loop.then_some(parts.ligating_loop),
        }
    }

    /// A grasper with these jaws.
    pub const fn grasper(jaws: Jaws) -> Self {
        Self { kind: GRASPER, jaws: Some(jaws), ..Self::PROBE }
    }

    /// Scissors with these jaws.
    pub const fn scissors(jaws: Jaws, snip: Snip) -> Self {
        Self { kind: SCISSORS, jaws: Some(jaws), snip: Some(snip), ..Self::PROBE }
    }

    /// A scalpel with this edge.
    pub const fn scalpel(blade: Blade) -> Self {
        Self { kind: SCALPEL, blade: Some(blade), ..Self::PROBE }
    }

    /// A monopolar hook.
    pub const fn hook(burning: CutRule) -> Self {
        Self { kind: HOOK, burning: Some(burning), ..Self::PROBE }
    }

    /// A bipolar forceps with these jaws.
    pub const fn cautery(jaws: Jaws, burning: CutRule) -> Self {
        Self { kind: CAUTERY, jaws: Some(jaws), burning: Some(burning), ..Self::PROBE }
    }

    /// An endoscope with this lens.
    pub const fn endoscope(optics: Optics) -> Self {
        Self { kind: ENDOSCOPE, optics: Some(optics), ..Self::PROBE }
    }

    /// The name in scene files.
    pub fn name(&self) -> &'static str {
        self.kind.name
    }

    /// Its jaws, if it has some.
    pub fn jaws(&self) -> Option<&Jaws> {
        self.jaws.as_ref()
    }

    /// Its edge, if it cuts along one.
    pub fn blade(&self) -> Option<&Blade> {
        self.blade.as_ref()
    }

    /// When it takes away what it touches or holds, if it burns.
    pub fn burning(&self) -> Option<&CutRule> {
        self.burning.as_ref()
    }

    /// Its lens, if it looks through one.
    pub fn optics(&self) -> Option<&Optics> {
        self.optics.as_ref()
    }

    /// Its loop of thread, if it has one.
    pub fn ligating_loop(&self) -> Option<&LigatingLoop> {
        self.ligating_loop.as_ref()
    }

    /// Whether its jaws hold what they close on.
    pub fn holds(&self) -> bool {
        self.kind.jaws == Some(JawUse::Hold)
    }

    /// Whether it rinses while its lever is pressed.
    pub fn rinses(&self) -> bool {
        self.kind.rinses
    }

    /// Whether its jaws set clips.
    pub fn sets_clips(&self) -> bool {
        self.kind.jaws == Some(JawUse::Clip)
    }

    /// The jaws with which it parts what they close on, and how, if it does.
    pub fn parting_jaws(&self) -> Option<(&Jaws, Snip)> {
        self.jaws.as_ref().zip(self.snip)
    }

    /// The same where its edge, or the edges of its jaws, cut so.
    #[must_use]
    pub fn cutting(self, blade_cuts: BladeCuts, snip: Snip) -> Self {
        Self {
            blade: self.blade.map(|blade| Blade { cuts: blade_cuts, ..blade }),
            snip: self.snip.map(|_| snip),
            ..self
        }
    }

    /// How its edge parts tissue, or the edges of its jaws, if it has any.
    pub fn edge_cuts(&self) -> Option<BladeCuts> {
        self.blade.map(|blade| blade.cuts).or_else(|| self.snip?.edge_cuts())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_instruments_is_sound() {
        for (place, kind) in INSTRUMENTS.iter().enumerate() {
            assert_eq!(instrument_names().position(|name| name == kind.name), Some(place), "{}", kind.name);
            assert!(
                !kind.about.is_empty() && kind.name.bytes().all(|b| b.is_ascii_lowercase()),
                "{}",
                kind.name
            );
        }
    }
}
