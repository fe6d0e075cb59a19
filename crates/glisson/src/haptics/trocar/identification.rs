//! Which instrument is in the trocar: a tag on it, read as a bar code or by radio (seed `000`, s. 5.3.1, 5.4.5).
//!
//! The seed wants about ten types told apart and does not list them; these thirteen cover its gestures (palpate, grasp, biopsy,
//! cut, suture) and what goes through trocars beside them. A tag is four bytes: type, serial number (least byte first), and
//! the check byte of both, CRC-8 with the polynomial x^8 + x^2 + x + 1.

/// What an instrument is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InstrumentType {
    /// A blunt rod that palpates.
    PalpationProbe,
    /// Grasps without hurting.
    AtraumaticGrasper,
    /// Grasps with teeth.
    ToothedGrasper,
    /// Takes a sample by traction.
    BiopsyForceps,
    /// Cuts between two blades.
    Scissors,
    /// Cuts with an edge.
    Scalpel,
    /// Monopolar hook.
    Hook,
    /// Bipolar forceps.
    BipolarForceps,
    /// Holds the needle of a suture.
    NeedleHolder,
    /// The camera.
    Endoscope,
    /// Sets clips.
    ClipApplier,
    /// Sucks and rinses.
    SuctionTube,
    /// Draws a loop of thread tight around a stump.
    LigatingLoop,
}

impl InstrumentType {
    /// All of them, in the order of their codes from 1.
    pub const ALL: [Self; 13] = [
        Self::PalpationProbe,
        Self::AtraumaticGrasper,
        Self::ToothedGrasper,
        Self::BiopsyForceps,
        Self::Scissors,
        Self::Scalpel,
        Self::Hook,
        Self::BipolarForceps,
        Self::NeedleHolder,
        Self::Endoscope,
        Self::ClipApplier,
        Self::SuctionTube,
        Self::LigatingLoop,
    ];

    /// On the tag; 0 is no code.
    pub fn code(self) -> u8 {
        self as u8 + 1
    }

    /// The type of a code.
    pub fn of_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code.checked_sub(1)?)).copied()
    }

    /// For messages.
    pub fn name(self) -> &'static str {
        [
            "palpation probe",
            "atraumatic grasper",
            "toothed grasper",
            "biopsy forceps",
            "scissors",
            "scalpel",
            "hook",
            "bipolar forceps",
            "needle holder",
            "endoscope",
            "clip applier",
            "suction tube",
            "ligating loop",
        ][self as usize]
    }

    /// The instruments that act as a scene's tool of that kind ([`InstrumentType::tool_kind`]).
    pub fn acting_as(tool_kind: &str) -> impl Iterator<Item = Self> + use<'_> {
        Self::ALL.into_iter().filter(move |instrument| instrument.tool_kind() == tool_kind)
    }

    /// The kind of a scene's tool that it acts as ([`crate::tool::INSTRUMENTS`]).
    pub fn tool_kind(self) -> &'static str {
        match self {
            Self::PalpationProbe => "probe",
            Self::AtraumaticGrasper | Self::ToothedGrasper | Self::BiopsyForceps | Self::NeedleHolder => {
                "grasper"
            }
            Self::Scissors => "scissors",
            Self::Scalpel => "scalpel",
            Self::Hook => "hook",
            Self::BipolarForceps => "cautery",
            Self::Endoscope => "endoscope",
            Self::ClipApplier => "clipper",
            Self::SuctionTube => "suction",
            Self::LigatingLoop => "loop",
        }
    }
}

/// One instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstrumentTag {
    /// What it is.
    pub instrument: InstrumentType,
    /// Which one of them.
    pub serial: u16,
}

/// Why a tag says nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TagError {
    /// It was read wrongly.
    #[error("the check byte of the tag is {found:#04x}, not {wanted:#04x}: read it again")]
    Check {
        /// On the tag.
        found: u8,
        /// Of its other bytes.
        wanted: u8,
    },
    /// A type that is not in the list.
    #[error("the tag has the type {0}; types go from 1 to {n_types}", n_types = InstrumentType::ALL.len())]
    Type(u8),
}

impl InstrumentTag {
    /// The bytes of the tag.
    pub fn to_bytes(self) -> [u8; 4] {
        let [low, high] = self.serial.to_le_bytes();
        let bytes = [self.instrument.code(), low, high];
        [bytes[0], bytes[1], bytes[2], check_byte(bytes)]
    }

    /// The instrument of a tag.
    ///
    /// # Errors
    /// [`TagError`] when the check byte or the type is wrong.
    pub fn of_bytes([code, low, high, found]: [u8; 4]) -> Result<Self, TagError> {
        let wanted = check_byte([code, low, high]);
        if found != wanted {
            return Err(TagError::Check { found, wanted });
        }
        let instrument = InstrumentType::of_code(code).ok_or(TagError::Type(code))?;
        Ok(Self { instrument, serial: u16::from_le_bytes([low, high]) })
    }
}

fn check_byte(bytes: [u8; 3]) -> u8 {
    bytes.into_iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| if crc & 0x80 == 0 { crc << 1 } else { (crc << 1) ^ 0x07 })
    })
}
