//! A recorded session: the scene and every input that the world was given, so that a replay makes the same bits.
//!
//! A session is a text of JSON lines: a header, then one line for every event, the last one `end`. Inputs are
//! written only when they change. Every decision that was taken outside the library (sub-steps, when another
//! model is swapped in) stands here as an input. Check-point hashes let a replay say where it first differs.

use crate::math::{Arithmetic, DVec3};
use crate::mesh::TetId;
use crate::model::LevelOfDetail;
use crate::model::StateHash;
use crate::model::kind::ModelKind;
use crate::record::note::Note;
use crate::record::parameter::Parameter;
use crate::tool::external_detection::ExternalDetection;
use crate::tool::{MAX_TOOLS, ToolInput};
use serde::{Deserialize, Serialize};
use std::io::{self, Write};

/// Parts that a step is divided into at most: more would stall for minutes. A choice.
pub const MOST_SUBSTEPS: u32 = 1000;

/// Format version written. Version 1 had one instrument, whose contact was found otherwise, and is not read.
pub const SESSION_VERSION: u32 = 5;
/// The first version whose scenes have a hand that gives way where they say nothing of one.
pub const FIRST_VERSION_WITH_HAND: u32 = 3;
/// From this version on, cuts of blades whose scene does not say otherwise are embedded.
pub const FIRST_VERSION_WITH_EMBEDDED_CUTS: u32 = 4;
/// From this version on, where a scene does not say otherwise, scissors part tissue along their edges, edges are sharp, and a
/// pre-computed organ that instruments divide is a hybrid.
pub const FIRST_VERSION_WITH_PARTING_SCISSORS: u32 = 5;
const OLDEST_VERSION: u32 = 2;
const FORMAT: &str = "glisson-session";

/// What a session starts from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionHeader {
    /// Always `glisson-session`.
    pub format: String,
    /// [`SESSION_VERSION`], or an older one that is read.
    pub version: u32,
    /// Version of the library that recorded it.
    pub glisson: String,
    /// The scene file's text.
    pub scene: String,
    /// BLAKE3 of the mesh (positions and connectivity), hexadecimal.
    pub mesh_hash: String,
    /// How the program that recorded it rounded.
    #[serde(default, skip_serializing_if = "is_usual")]
    pub arithmetic: Arithmetic,
}

fn is_usual(arithmetic: &Arithmetic) -> bool {
    *arithmetic == Arithmetic::default()
}

impl SessionHeader {
    /// The header of a session that starts now.
    pub fn new(scene: String, mesh_hash: String) -> Self {
        Self {
            format: FORMAT.into(),
            version: SESSION_VERSION,
            glisson: env!("CARGO_PKG_VERSION").into(),
            scene,
            mesh_hash,
            arithmetic: Arithmetic::here(),
        }
    }
}

/// One thing that the world was told, or that it answered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case", deny_unknown_fields)]
pub enum SessionEvent {
    /// From this step on the hands do this and the steps are divided so.
    Input {
        /// Index of the step to be made, from 0.
        step: u64,
        /// What each hand does, in the scene's order.
        tools: Vec<ToolInput>,
        /// Equal parts that the step is divided into.
        n_substeps: u32,
        /// Instruments that were put there without touching anything between, by their place in `tools`.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        placed: Vec<u8>,
        /// What was found outside of the world for instruments, by their place in `tools`; empty when the world looked for
        /// all of them.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        detected: Vec<Option<ExternalDetection>>,
    },
    /// Before this step everything went back to rest.
    Reset {
        /// Index of the step to be made.
        step: u64,
    },
    /// From this step on gravity is this one.
    Gravity {
        /// Index of the step to be made.
        step: u64,
        /// Gravity [m/s2].
        gravity_m_per_s2: DVec3,
    },
    /// Before this step these tetrahedra were taken out.
    Remove {
        /// Index of the step to be made.
        step: u64,
        /// Which ones.
        tets: Vec<TetId>,
    },
    /// Before this step the last cut was undone.
    UndoEdit {
        /// Index of the step to be made.
        step: u64,
    },
    /// Before this step the mesh was made finer in a ball at rest.
    Refine {
        /// Index of the step to be made.
        step: u64,
        /// Its middle [m].
        center_m: DVec3,
        /// Its radius [m].
        radius_m: f64,
        /// Longest edge wanted there [m].
        edge_m: f64,
    },
    /// Before this step an instrument set a clip on the vessel nearest to its tip.
    Clip {
        /// Index of the step to be made.
        step: u64,
        /// Which instrument, in the scene's order.
        tool: u8,
    },
    /// Before this step the vessel nearest to a place tore there.
    TearVessel {
        /// Index of the step to be made.
        step: u64,
        /// The place at rest [m].
        near_m: DVec3,
    },
    /// Before this step who teaches let an event of the task come. What it does follows in events of its own.
    TaskEvent {
        /// Index of the step to be made.
        step: u64,
        /// Which one, from 0 in the scene's order.
        number: u32,
    },
    /// From this step on steps are computed so thoroughly: the clock of the recording did not allow more.
    Effort {
        /// Index of the step to be made.
        step: u64,
        /// How thoroughly.
        effort: LevelOfDetail,
    },
    /// Another model was ordered; it takes over before step `at_step`, which waits for it.
    QueueModelSwap {
        /// Index of the step to be made when it was ordered.
        step: u64,
        /// Before which step it takes over.
        at_step: u64,
        /// Which model.
        model: ModelKind,
    },
    /// A number of the scene was turned. Where models are made anew for it, they take over before step `at_step`, which waits for
    /// them; where one cannot be made, nothing changes.
    Turn {
        /// Index of the step to be made when it was turned.
        step: u64,
        /// Before which step it holds.
        at_step: u64,
        /// Of which body, by its place in the scene; 0 for what is of no body.
        body: u8,
        /// What.
        parameter: Parameter,
        /// Its new value, in SI.
        value: f64,
    },
    /// Somebody who watched wanted this to be kept. It changes nothing.
    Note {
        /// Index of the step to be made.
        step: u64,
        /// What.
        note: Note,
    },
    /// The state after `step` steps.
    Checkpoint {
        /// Steps made.
        step: u64,
        /// Hash of the state.
        state_hash: StateHash,
    },
    /// The recording ended after `step` steps.
    End {
        /// Steps made.
        step: u64,
        /// Hash of the state.
        state_hash: StateHash,
    },
}

impl SessionEvent {
    /// The step that the event belongs to.
    pub fn step(&self) -> u64 {
        match *self {
            Self::Input { step, .. }
            | Self::Reset { step }
            | Self::Gravity { step, .. }
            | Self::Remove { step, .. }
            | Self::UndoEdit { step }
            | Self::Clip { step, .. }
            | Self::TearVessel { step, .. }
            | Self::TaskEvent { step, .. }
            | Self::Refine { step, .. }
            | Self::Effort { step, .. }
            | Self::QueueModelSwap { step, .. }
            | Self::Turn { step, .. }
            | Self::Note { step, .. }
            | Self::Checkpoint { step, .. }
            | Self::End { step, .. } => step,
        }
    }
}

/// A whole session.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// What it starts from.
    pub header: SessionHeader,
    /// In order of their steps.
    pub events: Vec<SessionEvent>,
    /// Whether the last line is missing or torn: the recording was cut off.
    pub cut_off: bool,
}

/// Why a text is not a session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// There is not one line.
    #[error("the file is empty; a session starts with a header line")]
    Empty,
    /// A line that is not what it should be.
    #[error("line {line}: {reason}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// Another kind of file.
    #[error("line 1: format \"{found}\", expected \"glisson-session\"")]
    Format {
        /// As found.
        found: String,
    },
    /// A newer or older format.
    #[error(
        "line 1: session version {found}, recorded by Glisson {glisson}; this program reads versions {OLDEST_VERSION} to {SESSION_VERSION}: \
         replay it with the program that recorded it"
    )]
    Version {
        /// As found.
        found: u32,
        /// Version of the library that recorded it.
        glisson: String,
    },
}

/// Reads a session. A torn last line is no error: the recording was cut off, what came before it is whole.
///
/// # Errors
/// [`SessionError`] with the line.
pub fn parse_session(text: &str) -> Result<Session, SessionError> {
    let mut lines = text.lines().enumerate();
    let (_, first) = lines.next().ok_or(SessionError::Empty)?;
    let wrong = |line: usize, reason: String| SessionError::Line { line: line + 1, reason };
    let header: SessionHeader = serde_json::from_str(first).map_err(|e| wrong(0, e.to_string()))?;
    if header.format != FORMAT {
        return Err(SessionError::Format { found: header.format });
    }
    if !(OLDEST_VERSION..=SESSION_VERSION).contains(&header.version) {
        return Err(SessionError::Version { found: header.version, glisson: header.glisson });
    }
    let mut events: Vec<SessionEvent> = Vec::new();
    let mut cut_off = true;
    while let Some((line, content)) = lines.next() {
        let event: SessionEvent = match serde_json::from_str(content) {
            Ok(event) => event,
            Err(e) if lines.next().is_none() && e.is_eof() => break,
            Err(e) => return Err(wrong(line, e.to_string())),
        };
        let last_step = events.last().map_or(0, SessionEvent::step);
        check_event(&event, last_step).map_err(|reason| wrong(line, reason))?;
        if let SessionEvent::End { .. } = event {
            if lines.next().is_some() {
                return Err(wrong(line + 1, "there is a line after the end".into()));
            }
            cut_off = false;
        }
        events.push(event);
    }
    Ok(Session { header, events, cut_off })
}

/// The reason why an event cannot follow one of `last_step`, or cannot be.
fn check_event(event: &SessionEvent, last_step: u64) -> Result<(), String> {
    let step = event.step();
    if step < last_step {
        return Err(format!("step {step} comes after step {last_step}; steps only go up"));
    }
    match event {
        SessionEvent::Input { .. } => check_input(event),
        SessionEvent::Note { note, .. } => note.check(),
        SessionEvent::Clip { tool, .. } if usize::from(*tool) >= MAX_TOOLS => {
            Err(format!("instrument {tool}; allowed: below {MAX_TOOLS}"))
        }
        SessionEvent::Refine { center_m, radius_m, edge_m, .. }
            if !(center_m.is_finite() && radius_m.is_finite() && *edge_m > 0.0) =>
        {
            Err(format!(
                "a ball of {radius_m} m around {center_m} with edges of {edge_m} m; allowed: finite numbers, edges above 0"
            ))
        }
        SessionEvent::TearVessel { near_m, .. } if !near_m.is_finite() => {
            Err("the place of a tear is not finite".into())
        }
        SessionEvent::Gravity { gravity_m_per_s2, .. } if !gravity_m_per_s2.is_finite() => {
            Err("gravity is not finite".into())
        }
        SessionEvent::QueueModelSwap { at_step, .. } | SessionEvent::Turn { at_step, .. }
            if *at_step < step =>
        {
            Err(format!("at_step {at_step} lies before step {step}"))
        }
        SessionEvent::Turn { parameter, value, .. } if !parameter.range().contains(value) => {
            Err(out_of_range(*parameter, *value))
        }
        _ => Ok(()),
    }
}

/// Why a parameter cannot have a value, whatever the model.
pub fn out_of_range(parameter: Parameter, value: f64) -> String {
    let (range, unit) = (parameter.range(), parameter.unit());
    format!("{parameter} = {value} {unit}; allowed: {} to {} {unit}", range.start(), range.end())
}

/// The reason why an input cannot be.
fn check_input(event: &SessionEvent) -> Result<(), String> {
    let SessionEvent::Input { tools, n_substeps, placed, detected, .. } = event else { return Ok(()) };
    if let Some(at) = tools.iter().position(|tool| !tool.is_finite()) {
        return Err(format!("the place of instrument {at} is not finite"));
    }
    if tools.is_empty() || tools.len() > MAX_TOOLS {
        return Err(format!("{} instruments; allowed: 1 to {MAX_TOOLS}", tools.len()));
    }
    if let Some(place) = placed.iter().find(|&&place| usize::from(place) >= tools.len()) {
        return Err(format!("placed names instrument {place} of {}", tools.len()));
    }
    if !detected.is_empty() && detected.len() != tools.len() {
        let (n, n_tools) = (detected.len(), tools.len());
        return Err(format!("detected has {n} entries for {n_tools} instruments"));
    }
    if let Some(at) = detected.iter().position(|d| d.is_some_and(|d| !d.is_plausible())) {
        return Err(format!("what was detected for instrument {at} is no touch"));
    }
    if !(1..=MOST_SUBSTEPS).contains(n_substeps) {
        return Err(format!("n_substeps is {n_substeps}; allowed: 1 to {MOST_SUBSTEPS}"));
    }
    Ok(())
}

/// Instruments, parts of the step, those that were put somewhere, and what was found for them.
type LastInput = (Vec<ToolInput>, u32, Vec<u8>, Vec<Option<ExternalDetection>>);

/// Writes a session line by line while it happens.
#[derive(Debug)]
pub struct SessionWriter<W: Write> {
    out: W,
    last_input: Option<LastInput>,
}

impl<W: Write> SessionWriter<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// Whatever `out` answers.
    pub fn new(mut out: W, header: &SessionHeader) -> io::Result<Self> {
        serde_json::to_writer(&mut out, header)?;
        out.write_all(b"\n")?;
        Ok(Self { out, last_input: None })
    }

    /// Writes an event; an input equal to the one before is left out.
    ///
    /// # Errors
    /// Whatever the output answers.
    pub fn write(&mut self, event: &SessionEvent) -> io::Result<()> {
        if let SessionEvent::Input { tools, n_substeps, placed, detected, .. } = event {
            let is_same = self.last_input.as_ref().is_some_and(|last| {
                (&last.0, &last.1, &last.2, &last.3) == (tools, n_substeps, placed, detected)
            });
            if is_same {
                return Ok(());
            }
            self.last_input = Some((tools.clone(), *n_substeps, placed.clone(), detected.clone()));
        }
        serde_json::to_writer(&mut self.out, event)?;
        self.out.write_all(b"\n")
    }

    /// Hands on what was written.
    ///
    /// # Errors
    /// Whatever the output answers.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Gives the output back.
    pub fn into_inner(self) -> W {
        self.out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use crate::mesh::TriangleId;
    use crate::tool::external_detection::{ExternalTouch, TouchingPoint};
    use proptest::prelude::*;

    fn sample() -> (Vec<SessionEvent>, String) {
        let tool = ToolInput {
            roll_rad: 0.1,
            jaw_opening: 1.0 / 3.0,
            ..ToolInput::at(DVec3::new(0.1, -1.0 / 3.0, 5e-324), DVec3::new(0.0, -1.0, 0.0))
        };
        let tools = vec![tool, ToolInput::at(DVec3::ZERO, DVec3::Z)];
        let hash = StateHash::try_from("0f".repeat(32)).unwrap();
        let touch = ExternalTouch {
            triangle: TriangleId(7),
            weights: [0.25, 0.5, 0.25],
            normal: DVec3::Z,
            at: TouchingPoint::OnAxis(1.0 / 3.0),
            gap_m: -1e-7,
        };
        let on_mesh = ExternalTouch { at: TouchingPoint::Fixed(DVec3::X), ..touch };
        let found = ExternalDetection { surface_version: 3, touches: [Some(touch), None, Some(on_mesh)] };
        let events = vec![
            SessionEvent::Input {
                step: 0,
                tools,
                n_substeps: 1,
                placed: vec![1],
                detected: vec![None, Some(found)],
            },
            SessionEvent::QueueModelSwap { step: 5, at_step: 50, model: ModelKind::Precomputed },
            SessionEvent::Turn {
                step: 5,
                at_step: 60,
                body: 1,
                parameter: Parameter::YoungModulus,
                value: 1.0 / 3.0e-4,
            },
            SessionEvent::Checkpoint { step: 10, state_hash: hash },
            SessionEvent::Note { step: 11, note: Note::Bookmark { time_s: 0.1, text: "\"so\"".into() } },
            SessionEvent::Note { step: 11, note: Note::Drawing { points_m: vec![DVec3::X / 3.0] } },
            SessionEvent::Note { step: 11, note: Note::Erased {} },
            SessionEvent::Reset { step: 12 },
            SessionEvent::UndoEdit { step: 12 },
            SessionEvent::Clip { step: 12, tool: 1 },
            SessionEvent::Refine { step: 12, center_m: DVec3::X, radius_m: 0.02, edge_m: 4e-3 },
            SessionEvent::Effort { step: 13, effort: LevelOfDetail::Reduced },
            SessionEvent::End { step: 20, state_hash: hash },
        ];
        let header = SessionHeader::new("name = \"x\"\n".into(), "ab".into());
        let mut writer = SessionWriter::new(Vec::new(), &header).unwrap();
        for event in &events {
            writer.write(event).unwrap();
        }
        (events, String::from_utf8(writer.into_inner()).unwrap())
    }

    #[test]
    fn a_session_comes_back_bit_for_bit() {
        let (events, text) = sample();
        let session = parse_session(&text).unwrap();
        assert_eq!(session.events, events);
        assert!(!session.cut_off);
    }

    #[test]
    fn an_input_equal_to_the_one_before_is_left_out() {
        let (events, _) = sample();
        let header = SessionHeader::new(String::new(), String::new());
        let mut writer = SessionWriter::new(Vec::new(), &header).unwrap();
        for _ in 0..3 {
            writer.write(&events[0]).unwrap();
        }
        assert_eq!(String::from_utf8(writer.into_inner()).unwrap().lines().count(), 2);
    }

    #[test]
    fn a_torn_recording_keeps_what_was_written() {
        let (events, text) = sample();
        let session = parse_session(&text[..text.len() - 30]).unwrap();
        assert!(session.cut_off);
        assert_eq!(session.events, events[..events.len() - 1]);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        let (_, text) = sample();
        let with = |from: &str, to: &str| parse_session(&text.replace(from, to)).unwrap_err().to_string();
        assert!(with("\"step\":10", "\"step\":3").starts_with("line 5: step 3 comes after step 5"));
        assert!(with("\"version\":5", "\"version\":1").contains("version 1, recorded by Glisson"));
        assert!(
            with("\"placed\":[1]", "\"placed\":[2]").starts_with("line 2: placed names instrument 2 of 2")
        );
        assert!(with("glisson-session", "other").contains("\"other\""));
        assert!(with("n_substeps\":1", "n_substeps\":0").starts_with("line 2"));
        assert!(with("reset", "explode").starts_with("line 9"));
        assert!(with("\"time_s\":0.1", "\"time_s\":-0.1").starts_with("line 6: \"time_s\" is -0.1"));
        assert!(
            with("\"clip\",\"step\":12,\"tool\":1", "\"clip\",\"step\":12,\"tool\":9")
                .starts_with("line 11: instrument 9")
        );
    }

    proptest! {
        #[test]
        fn mutated_bytes_are_read_or_refused(at in 0usize..2000, byte in any::<u8>(), cut in 0usize..2000) {
            let (_, text) = sample();
            let mut bytes = text.into_bytes();
            let n = bytes.len();
            bytes[at % n] = byte;
            bytes.truncate(n - cut % n);
            let _ = parse_session(&String::from_utf8_lossy(&bytes));
        }
    }
}
