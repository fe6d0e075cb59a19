//! Instruments: what they are, where they are, and what they take to cut.

mod kind;
pub mod cautery;
pub mod fracture;
pub mod cut;
pub mod pose;
pub mod endoscope;
pub mod trocar;
pub mod external_detection;
pub mod ligating_loop;

pub use kind::{INSTRUMENTS, InstrumentKind, JawUse, ToolKind, ToolParts, instrument_names};

use crate::contact::shapes::MeshShape;
use crate::math::DVec3;
use serde::{Deserialize, Serialize};

/// Instruments of a world at most: two hands, a camera, an assistant, and one that is taken in exchange.
pub const MAX_TOOLS: usize = 5;

/// A rigid straight instrument: a shaft that ends in a tip.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool {
    /// What the user calls it.
    pub name: String,
    /// What it is made for.
    pub kind: ToolKind,
    /// Radius of the ball at the tip [m].
    pub tip_radius_m: f64,
    /// Radius of the shaft [m].
    pub shaft_radius_m: f64,
    /// Length of the shaft [m].
    pub shaft_length_m: f64,
    /// What of it touches tissue.
    pub shape: ToolShape,
    /// How tissue slides on it.
    pub grip: Grip,
    /// Where it goes through the abdominal wall [m]: its shaft then always points there.
    pub trocar_m: Option<DVec3>,
    /// Where the tool is when nobody holds it.
    pub home: ToolInput,
}

/// Two jaws that turn about a hinge behind the tip; closed they end at the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jaws {
    /// From the hinge to the ends [m].
    pub length_m: f64,
    /// Across, along the hinge [m].
    pub width_m: f64,
    /// Angle between them when wide open [rad].
    pub greatest_opening_rad: f64,
    /// Force with which they close on tissue [N].
    pub closing_force_n: f64,
}

/// A straight edge from the tip backwards along the shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blade {
    /// Length of the edge [m].
    pub length_m: f64,
    /// Radius of the edge [m]: it is in tissue that has strength when it has opened a crack as long as what presses, twice this at
    /// least, and as deep as this; 0 for a perfectly sharp one.
    pub edge_radius_m: f64,
    /// How it parts tissue.
    pub cuts: BladeCuts,
}

/// The lens of an endoscope ([`endoscope`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// Between the way out of the tip and the direction of view [rad].
    pub view_angle_rad: f64,
    /// Full angle of the cone that is seen [rad].
    pub field_of_view_rad: f64,
}

/// How a blade parts tissue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BladeCuts {
    /// Along the swept blade, through the tetrahedra, which copies of the uncut ones carry ([`crate::model::embedded`]).
    Embedded,
    /// Along the swept blade, through the tetrahedra ([`cut::subdivision`]).
    Subdivision,
    /// Along the faces of tetrahedra, whose nodes are moved there ([`cut::scalpel`], seed `000`).
    Displacement,
}

/// What scissors do with what their jaws close on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Snip {
    /// They take away the tetrahedra between their jaws.
    Tetrahedra,
    /// Their edges part it along the surface between the jaws, as a blade with [`BladeCuts::Embedded`] does that goes from one jaw to
    /// the other.
    Embedded,
    /// The same as a blade with [`BladeCuts::Subdivision`].
    Subdivision,
}

impl Snip {
    /// How the edges cut, if they do.
    pub fn edge_cuts(self) -> Option<BladeCuts> {
        match self {
            Self::Tetrahedra => None,
            Self::Embedded => Some(BladeCuts::Embedded),
            Self::Subdivision => Some(BladeCuts::Subdivision),
        }
    }

    /// What goes with blades that cut so. What moves nodes needs a blade that moves bit by bit.
    pub fn beside(cuts: BladeCuts) -> Self {
        match cuts {
            BladeCuts::Embedded => Self::Embedded,
            BladeCuts::Subdivision => Self::Subdivision,
            BladeCuts::Displacement => Self::Tetrahedra,
        }
    }
}

/// When an active tip takes away what it touches: seed `000`, s. 4.4.2, removes the touched tetrahedron when the force
/// reaches a threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutRule {
    /// Least force on the tip [N].
    pub least_force_n: f64,
    /// How long it has to touch with the current on [s]; without effect when there is a power.
    pub least_time_s: f64,
    /// Electrical power that heats what it touches until it comes apart [W]; 0: all goes after the time
    /// ([`cautery`]).
    pub power_w: f64,
    /// What goes.
    pub takes: Burnt,
}

/// What an active tip takes away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Burnt {
    /// Whole tetrahedra that it touches, or that its closed jaws hold.
    Tetrahedra,
    /// What lies in its ball, or in a capsule along its closed jaws, where it is and on its way there
    /// ([`cut::subdivision::carving`]), for models with embedded cuts.
    Swept {
        /// How much larger than the tip the ball is [m]: tissue comes apart before the metal is there.
        depth_m: f64,
    },
}

/// What of an instrument touches tissue.
#[derive(Clone, Debug, PartialEq)]
pub enum ToolShape {
    /// The ball at the tip, and the shaft as a capsule.
    Capsules,
    /// A closed triangle mesh in the frame of the tip ([`pose::ToolFrame`]), in place of the ball; the shaft as a capsule.
    Mesh(MeshShape),
}

/// How tissue slides on an instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Coulomb's coefficient of friction.
    pub friction_coefficient: f64,
    /// Tissue that touches it never slides.
    pub is_sticky: bool,
}

impl Tool {
    /// A ball on a shaft to which tissue sticks: a probe for palpation.
    pub fn probe(name: &str, tip_radius_m: f64, home: ToolInput) -> Self {
        Self {
            name: name.into(),
            kind: ToolKind::PROBE,
            tip_radius_m,
            shaft_radius_m: tip_radius_m.min(2.5e-3),
            shaft_length_m: 0.3,
            shape: ToolShape::Capsules,
            grip: Grip { friction_coefficient: 1.0, is_sticky: true },
            trocar_m: None,
            home,
        }
    }

    /// The pose that this tool takes when a hand asks for `asked` and it was at `before`, none when it was put there.
    ///
    /// Through a trocar the shaft is inserted by 0 to its length (a home further in counts as well; an instrument without a
    /// shaft goes as far as it likes). A tip that is drawn out past the pivot, as seen along the shaft that was and along that
    /// of the home, stays in the pivot with the shaft that was: an instrument does not turn round into the patient.
    #[must_use]
    pub fn held(&self, asked: ToolInput, before: Option<&ToolInput>) -> ToolInput {
        let Some(trocar_m) = self.trocar_m else { return asked };
        let home = self.home.through(self.trocar_m);
        let former = before.unwrap_or(&home).shaft_in_world;
        let to_pivot_m = trocar_m - asked.tip_in_world_m;
        if to_pivot_m.dot(former) < 0.0 && to_pivot_m.dot(home.shaft_in_world) < 0.0 {
            return ToolInput { tip_in_world_m: trocar_m, shaft_in_world: former, ..asked };
        }
        let shaft_in_world = to_pivot_m.normalize_or(former);
        let longest_m = self.shaft_length_m.max(home.tip_in_world_m.distance(trocar_m));
        let is_too_far = self.shaft_length_m > 0.0 && to_pivot_m.length() > longest_m;
        let tip_in_world_m =
            if is_too_far { trocar_m - shaft_in_world * longest_m } else { asked.tip_in_world_m };
        ToolInput { tip_in_world_m, shaft_in_world, ..asked }
    }
}

/// What one hand does with a tool in one step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolInput {
    /// Centre of the tip [m].
    pub tip_in_world_m: DVec3,
    /// Unit vector from the tip towards the handle.
    pub shaft_in_world: DVec3,
    /// Turn about the shaft [rad].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub roll_rad: f64,
    /// How far the jaws are open: 0 closed, 1 wide open.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub jaw_opening: f64,
    /// How far the trigger (pedal, button) is pressed: 0 to 1.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub trigger: f64,
}

fn is_zero(number: &f64) -> bool {
    number.to_bits() == 0
}

/// Half-way: beyond it a trigger counts as pressed.
const TRIGGER_PRESSED: f64 = 0.5;

impl ToolInput {
    /// A tool at rest there, its jaws closed.
    pub fn at(tip_in_world_m: DVec3, shaft_in_world: DVec3) -> Self {
        Self { tip_in_world_m, shaft_in_world, roll_rad: 0.0, jaw_opening: 0.0, trigger: 0.0 }
    }

    /// The same so far from there.
    pub fn moved_by(self, way_m: DVec3) -> Self {
        Self { tip_in_world_m: self.tip_in_world_m + way_m, ..self }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.tip_in_world_m.is_finite()
            && self.shaft_in_world.is_finite()
            && self.roll_rad.is_finite()
            && self.jaw_opening.is_finite()
            && self.trigger.is_finite()
    }

    /// Whether the trigger is pressed.
    pub fn is_triggered(&self) -> bool {
        self.trigger > TRIGGER_PRESSED
    }

    /// On the straight way to another pose, at a share of it.
    #[must_use]
    pub fn towards(&self, to: &Self, share: f64) -> Self {
        let between = |from: f64, to: f64| from + (to - from) * share;
        let shaft = self.shaft_in_world.lerp(to.shaft_in_world, share);
        Self {
            tip_in_world_m: self.tip_in_world_m.lerp(to.tip_in_world_m, share),
            shaft_in_world: shaft.normalize_or(to.shaft_in_world),
            roll_rad: between(self.roll_rad, to.roll_rad),
            jaw_opening: between(self.jaw_opening, to.jaw_opening),
            trigger: between(self.trigger, to.trigger),
        }
    }

    /// The pose of a tool that goes through a trocar, its tip inside: its shaft points there. A tip in the trocar itself keeps
    /// its shaft. For places that are chosen; what a hand asks for goes through [`Tool::held`].
    #[must_use]
    pub fn through(self, trocar_m: Option<DVec3>) -> Self {
        let Some(trocar_m) = trocar_m else { return self };
        let shaft_in_world = (trocar_m - self.tip_in_world_m).normalize_or(self.shaft_in_world);
        Self { shaft_in_world, ..self }
    }
}
