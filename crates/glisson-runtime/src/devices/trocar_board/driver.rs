//! The active trocar as a haptic device: what its board says becomes a pose, a force becomes what its motors get.

use super::frames::{
    Frame, FrameDecoder, FrameError, Identity, MOST_FRAME_BYTES, MOST_TROCARS, Message, Outputs, State, flags,
};
use glisson::haptics::trocar::encoders::{JointReading, SensorFault};
use glisson::haptics::trocar::identification::TagError;
use glisson::haptics::trocar::motors::analog_outputs;
use glisson::haptics::trocar::placement::handle_orientation;
use glisson::haptics::trocar::statics::{AxisEfforts, efforts};
use glisson::haptics::trocar::{
    ContactForce, InstrumentTag, InstrumentType, JointReader, Mapping, Saturation, TrocarProfile, Wrench,
};
use glisson::haptics::{
    DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice, InsertedInstrument,
};
use std::borrow::Cow;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;

/// A line of bytes that never waits.
pub trait ByteLine: Send {
    /// Bytes that have come, as many as fit; 0 when there are none now.
    fn receive(&mut self, into: &mut [u8]) -> std::io::Result<usize>;

    /// Sends all of `bytes`, whole frames, or nothing of them when the line is full: the next tick has newer ones.
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()>;

    /// Ticks that it adds between a command and the first state that shows what it did.
    fn delay_ticks(&self) -> usize;
}

/// A board behind a socket has its own clock: a command waits for its next tick, and what it did comes with the state at the
/// end of that tick, for which the loop's next look may be too early.
const TCP_DELAY_TICKS: usize = 2;

/// Most bytes that are sent at once.
const MOST_SENT_BYTES: usize = 8 * MOST_FRAME_BYTES;

/// A line over TCP.
pub struct TcpLine {
    stream: TcpStream,
    /// What is left of frames of which a part was sent: `rest[from..to]`.
    rest: [u8; MOST_SENT_BYTES],
    from: usize,
    to: usize,
}

impl TcpLine {
    /// A line over a connected socket.
    ///
    /// # Errors
    /// When the socket cannot be set up.
    pub fn new(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        Ok(Self { stream, rest: [0; MOST_SENT_BYTES], from: 0, to: 0 })
    }

    /// How many bytes went; none when the line is full.
    fn push(stream: &mut TcpStream, bytes: &[u8]) -> std::io::Result<usize> {
        match stream.write(bytes) {
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            other => other,
        }
    }
}

impl ByteLine for TcpLine {
    fn receive(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        match self.stream.read(into) {
            Ok(0) => Err(std::io::Error::new(ErrorKind::UnexpectedEof, "the board closed the line")),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            other => other,
        }
    }

    fn delay_ticks(&self) -> usize {
        TCP_DELAY_TICKS
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        assert!(bytes.len() <= MOST_SENT_BYTES, "{} bytes at once", bytes.len());
        self.from += Self::push(&mut self.stream, &self.rest[self.from..self.to])?;
        if self.from < self.to {
            return Ok(());
        }
        let n = Self::push(&mut self.stream, bytes)?;
        if n > 0 {
            (self.from, self.to) = (n, bytes.len());
            self.rest[..bytes.len()].copy_from_slice(bytes);
        }
        Ok(())
    }
}

/// How a trocar is driven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardSettings {
    /// What is at the other end; another profile is refused.
    pub profile: TrocarProfile,
    /// Its number on the line.
    pub trocar: u8,
    /// How forces become motor efforts.
    pub mapping: Mapping,
    /// What is done where a motor saturates.
    pub saturation: Saturation,
    /// Ticks a second of the loop that drives it [Hz]: a slower one than the board's renders less stiffness.
    pub loop_rate_hz: f64,
    /// The kind of the scene's tool ([`glisson::tool::INSTRUMENTS`]) that the instrument has to act as; any for none.
    pub tool_kind: Option<&'static str>,
}

impl BoardSettings {
    /// The first trocar of a line, by the thesis' equations.
    pub fn new(profile: TrocarProfile) -> Self {
        Self {
            profile,
            trocar: 0,
            mapping: Mapping::Thesis,
            saturation: Saturation::EachMotor,
            loop_rate_hz: profile.rate_hz,
            tool_kind: None,
        }
    }
}

/// What came over the line so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineReport {
    pub n_states: u64,
    /// Frames that the board numbered and that did not come.
    pub n_lost: u64,
    /// Times that bytes were no frame.
    pub n_refused: u64,
    /// Frames of ours that the board refused.
    pub n_refused_by_board: u64,
}

const LINE_DOWN: DeviceFault = lost("the line to the board is down");

/// A fault that allocates nothing: it may come every tick.
const fn lost(why: &'static str) -> DeviceFault {
    DeviceFault::Lost(Cow::Borrowed(why))
}

/// Ticks without a new state that are bridged with the last one: a choice, 5 ms.
const TICKS_BRIDGED: u32 = 5;
/// Bytes that were no frame, so many times without a frame between them: this is no board. Noise on a line damages single
/// frames.
const MOST_REFUSED_IN_A_ROW: u32 = 64;
/// Longest way between two states of the board that counts as a tick [s]: after it, velocities begin anew.
const LONGEST_PERIOD_S: f64 = 0.05;
/// Reads of a tick at most: what a board sends in a second at its rate comes in less.
const MOST_READS: usize = 64;

/// An active trocar at the other end of a line.
pub struct TrocarDevice<L> {
    line: L,
    settings: BoardSettings,
    decoder: FrameDecoder,
    reader: JointReader,
    identity: Option<Identity>,
    state: Option<State>,
    reading: Result<JointReading, SensorFault>,
    /// Of the last state; none before the first one.
    tag: Option<Result<InstrumentTag, TagError>>,
    ticks_without_state: u32,
    n_refused_in_a_row: u32,
    last_refusal: Option<FrameError>,
    board_sequence: Option<u16>,
    sequence: u16,
    report: LineReport,
    commanded: AxisEfforts,
    /// Why it will not work any more.
    failure: Option<DeviceFault>,
}

impl<L: ByteLine> TrocarDevice<L> {
    /// The device at the other end of `line`, which has not said anything yet.
    pub(crate) fn new(line: L, settings: BoardSettings) -> Self {
        assert!(settings.trocar < MOST_TROCARS, "trocar {} of a line", settings.trocar);
        Self {
            line,
            settings,
            decoder: FrameDecoder::new(),
            reader: JointReader::new(settings.profile),
            identity: None,
            state: None,
            reading: Err(glisson::haptics::trocar::NotHomed([true; 5]).into()),
            tag: None,
            ticks_without_state: 0,
            n_refused_in_a_row: 0,
            last_refusal: None,
            board_sequence: None,
            sequence: 0,
            report: LineReport::default(),
            commanded: AxisEfforts::default(),
            failure: None,
        }
    }

    /// Asks the board what it is; answers whether it has said so and is what it should be.
    ///
    /// # Errors
    /// When it is something else, or the line is down.
    pub fn greet(&mut self) -> anyhow::Result<bool> {
        if self.identity.is_none() {
            self.send(Message::Greeting)?;
        }
        self.drain()?;
        if let Some(DeviceFault::Failed(why)) = &self.failure {
            anyhow::bail!("{why}");
        }
        Ok(self.identity.is_some())
    }

    /// What the board said it is.
    pub fn identity(&self) -> Option<Identity> {
        self.identity
    }

    /// The instrument in it, if there is one and its tag could be read.
    pub fn instrument(&self) -> Option<InstrumentTag> {
        self.tag().and_then(Result::ok)
    }

    /// What the tag of the instrument in it says; none before the first state and without an instrument.
    pub(crate) fn tag(&self) -> Option<Result<InstrumentTag, TagError>> {
        self.tag.filter(|_| self.state.is_some_and(|state| state.flags & flags::PRESENT != 0))
    }

    /// Reads until the board has told a state; answers whether it has.
    ///
    /// # Errors
    /// When it is not what it should be, or the line is down.
    pub(crate) fn hear(&mut self) -> anyhow::Result<bool> {
        self.drain()?;
        if let Some(DeviceFault::Failed(why)) = &self.failure {
            anyhow::bail!("{why}");
        }
        Ok(self.state.is_some())
    }

    /// Whether it drives the right instrument, if that is known.
    ///
    /// # Errors
    /// For one that does not act as the scene's tool: what is in it and what should be.
    pub fn check_instrument(&self) -> anyhow::Result<()> {
        let (Some(kind), Some(tag)) = (self.settings.tool_kind, self.instrument()) else { return Ok(()) };
        let InstrumentTag { instrument, serial } = tag;
        if instrument.tool_kind() == kind {
            return Ok(());
        }
        let acts_as = format!("a \"{}\"", instrument.tool_kind());
        let fitting: Vec<&str> = InstrumentType::acting_as(kind).map(InstrumentType::name).collect();
        anyhow::bail!(
            "the instrument in it ({}, number {serial}) acts as {acts_as}; the scene's instrument is a \"{kind}\": \
             put in one of: {}; or give the device another instrument of the scene (DEVICE@NUMBER)",
            instrument.name(),
            fitting.join(", ")
        )
    }

    /// What came over the line so far.
    pub fn report(&self) -> LineReport {
        self.report
    }

    /// Why bytes were last no frame.
    pub(crate) fn last_refusal(&self) -> Option<FrameError> {
        self.last_refusal
    }

    /// Motions and rates at the last state, or why they are not known.
    pub fn reading(&self) -> Result<JointReading, SensorFault> {
        self.reading
    }

    /// What the axes were last told to exert.
    pub fn commanded(&self) -> AxisEfforts {
        self.commanded
    }

    /// The line.
    pub fn line_mut(&mut self) -> &mut L {
        &mut self.line
    }

    /// Makes it push as contacts do that act at several places, in its own frame; `jaw_n` opens the handle's jaws.
    pub(crate) fn write_contacts(
        &mut self,
        contacts: &[ContactForce],
        jaw_n: f64,
    ) -> Result<(), DeviceFault> {
        let Ok(JointReading { joints, .. }) = self.reading else {
            return self.stop();
        };
        self.write_efforts(&efforts(self.settings.mapping, &joints, &Wrench::of(contacts), jaw_n))
    }

    /// Makes its axes exert `wanted`, as far as they can.
    pub fn write_efforts(&mut self, wanted: &AxisEfforts) -> Result<(), DeviceFault> {
        let BoardSettings { profile, saturation, .. } = self.settings;
        let limited = profile.limits.limit(wanted, saturation);
        let torques_n_m = profile.transmission.motor_torques_n_m(&limited.efforts);
        let full_scale_n_m = profile.transmission.full_scale_n_m(&profile.limits);
        let levels = analog_outputs(&torques_n_m, &full_scale_n_m);
        self.commanded = limited.efforts;
        self.tell(Message::Outputs(Outputs { levels, is_enabled: true }))
    }

    /// All motors off.
    pub(crate) fn stop(&mut self) -> Result<(), DeviceFault> {
        self.commanded = AxisEfforts::default();
        self.tell(Message::Stop)
    }

    fn tell(&mut self, message: Message) -> Result<(), DeviceFault> {
        self.send(message).map_err(|_| LINE_DOWN)
    }

    fn send(&mut self, message: Message) -> std::io::Result<()> {
        let frame = Frame { trocar: self.settings.trocar, sequence: self.sequence, message };
        self.sequence = self.sequence.wrapping_add(1);
        self.line.send(frame.to_bytes().as_slice())
    }

    /// Reads what has come; answers whether a new state was among it.
    fn drain(&mut self) -> std::io::Result<bool> {
        let mut bytes = [0; 256];
        let mut is_new = false;
        for _ in 0..MOST_READS {
            let n = self.line.receive(&mut bytes)?;
            if n == 0 {
                break;
            }
            let mut pushed = 0;
            while pushed < n {
                pushed += self.decoder.push(&bytes[pushed..n]);
                while let Some(found) = self.decoder.next_frame() {
                    is_new |= self.take(found);
                }
            }
        }
        Ok(is_new)
    }

    /// Takes a frame; whether it is a new state.
    fn take(&mut self, found: Result<Frame, FrameError>) -> bool {
        let frame = match found {
            Ok(frame) => frame,
            Err(error) => {
                self.report.n_refused += 1;
                self.n_refused_in_a_row += 1;
                self.last_refusal = Some(error);
                if self.n_refused_in_a_row >= MOST_REFUSED_IN_A_ROW && self.failure.is_none() {
                    let why = format!(
                        "{MOST_REFUSED_IN_A_ROW} times in a row no frame of an active trocar came; the last bytes: {error}"
                    );
                    self.failure = Some(DeviceFault::Failed(why.into()));
                }
                return false;
            }
        };
        self.n_refused_in_a_row = 0;
        if frame.trocar != self.settings.trocar {
            return false;
        }
        if let Some(last) = self.board_sequence {
            self.report.n_lost += u64::from(frame.sequence.wrapping_sub(last).wrapping_sub(1));
        }
        self.board_sequence = Some(frame.sequence);
        match frame.message {
            Message::Identity(identity) => {
                let refusal = refuse_identity(&identity, &self.settings.profile);
                self.failure = refusal.map(|why| DeviceFault::Failed(why.into()));
                self.identity = Some(identity);
                false
            }
            Message::State(state) => {
                self.take_state(state);
                true
            }
            Message::Refusal(_) => {
                self.report.n_refused_by_board += 1;
                false
            }
            // Only a host sends these.
            Message::Greeting | Message::Outputs(_) | Message::Stop => false,
        }
    }

    fn take_state(&mut self, state: State) {
        self.report.n_states += 1;
        let elapsed_s = |before: State| f64::from(state.time_us.wrapping_sub(before.time_us)) * 1e-6;
        let period_s = self.state.map_or(1.0 / self.settings.profile.rate_hz, elapsed_s);
        let is_present = state.flags & flags::PRESENT != 0;
        let is_tick = period_s > 0.0 && period_s <= LONGEST_PERIOD_S;
        if !is_present || !is_tick {
            self.reader.forget_rates();
        }
        if self.state.is_none_or(|before| before.tag != state.tag) {
            self.tag = Some(InstrumentTag::of_bytes(state.tag));
        }
        self.reading = self.reader.read(&state.encoders, period_s.clamp(1e-6, LONGEST_PERIOD_S));
        self.state = Some(state);
    }

    /// What the last state says against rendering.
    fn objection(&self) -> Option<DeviceFault> {
        let lost = |why| Some(lost(why));
        let Some(state) = self.state else { return lost("the board has said nothing yet") };
        let has = |flag: u16| state.flags & flag != 0;
        if has(flags::STOPPED) {
            return lost("the emergency stop is pressed");
        }
        if has(flags::HOT) {
            return lost("motors or amplifiers are too hot");
        }
        if !has(flags::PRESENT) {
            return lost("no instrument is in the trocar");
        }
        match (self.tag, self.settings.tool_kind) {
            (Some(Ok(tag)), Some(kind)) if tag.instrument.tool_kind() != kind => {
                return lost(wrong_instrument(tag.instrument));
            }
            (Some(Err(_)) | None, _) => {
                return lost("the tag of the instrument in the trocar cannot be read: put it in again");
            }
            (Some(Ok(_)), _) => {}
        }
        match self.reading {
            Ok(_) => None,
            Err(SensorFault::NotHomed(_)) => lost(
                "positions are not known: take the instrument through upright, turn it once, close its jaws",
            ),
            Err(SensorFault::OutOfRange { .. }) => {
                lost("encoders say where the mechanism cannot be: lost counts or another profile")
            }
        }
    }
}

/// Fixed texts: it may be said every tick.
fn wrong_instrument(instrument: InstrumentType) -> &'static str {
    macro_rules! acts_as {
        ($name:literal, $kind:literal) => {
            concat!(
                "the instrument in the trocar is a ",
                $name,
                ", which acts as ",
                $kind,
                "; the scene's instrument does not: put another one in"
            )
        };
    }
    match instrument {
        InstrumentType::PalpationProbe => acts_as!("palpation probe", "a \"probe\""),
        InstrumentType::AtraumaticGrasper => acts_as!("atraumatic grasper", "a \"grasper\""),
        InstrumentType::ToothedGrasper => acts_as!("toothed grasper", "a \"grasper\""),
        InstrumentType::BiopsyForceps => acts_as!("biopsy forceps", "a \"grasper\""),
        InstrumentType::Scissors => acts_as!("pair of scissors", "\"scissors\""),
        InstrumentType::Scalpel => acts_as!("scalpel", "a \"scalpel\""),
        InstrumentType::Hook => acts_as!("hook", "a \"hook\""),
        InstrumentType::BipolarForceps => acts_as!("bipolar forceps", "a \"cautery\""),
        InstrumentType::NeedleHolder => acts_as!("needle holder", "a \"grasper\""),
        InstrumentType::Endoscope => acts_as!("endoscope", "an \"endoscope\""),
        InstrumentType::ClipApplier => acts_as!("clip applier", "a \"clipper\""),
        InstrumentType::SuctionTube => acts_as!("suction tube", "a \"suction\""),
        InstrumentType::LigatingLoop => acts_as!("ligating loop", "a \"loop\""),
    }
}

/// Why a board is not what it should be.
fn refuse_identity(identity: &Identity, profile: &TrocarProfile) -> Option<String> {
    let names = TrocarProfile::NAMES;
    let found = usize::from(identity.profile).checked_sub(1).and_then(|i| names.get(i));
    if found == Some(&profile.name) {
        return None;
    }
    let found = found.map_or_else(|| format!("number {}", identity.profile), |name| format!("\"{name}\""));
    Some(format!(
        "board {:08x} has the profile {found}, not \"{}\"; there are: {}",
        identity.serial,
        profile.name,
        names.join(", ")
    ))
}

impl<L: ByteLine> HapticDevice for TrocarDevice<L> {
    fn limits(&self) -> DeviceLimits {
        let BoardSettings { profile, loop_rate_hz, .. } = self.settings;
        let limits = TrocarProfile { rate_hz: profile.rate_hz.min(loop_rate_hz), ..profile }.device_limits();
        DeviceLimits { loop_delay_ticks: self.line.delay_ticks(), ..limits }
    }

    fn inserted(&self) -> Option<InsertedInstrument> {
        let InstrumentTag { instrument, serial } = self.instrument()?;
        Some(InsertedInstrument { name: instrument.name(), serial })
    }

    /// The position is that of the instrument's tip, in the device's frame: where forces act.
    fn read(&mut self) -> Result<DeviceState, DeviceFault> {
        let drained = self.drain();
        if let Some(failure) = &self.failure {
            return Err(failure.clone());
        }
        let is_new = drained.map_err(|_| LINE_DOWN)?;
        self.ticks_without_state = if is_new { 0 } else { self.ticks_without_state.saturating_add(1) };
        if self.ticks_without_state > TICKS_BRIDGED {
            return Err(lost("nothing new came from the board"));
        }
        if let Some(fault) = self.objection() {
            return Err(fault);
        }
        let (Ok(JointReading { joints, rates }), Some(state)) = (self.reading, self.state) else {
            return Err(lost("the board has said nothing yet"));
        };
        let pose = joints.pose();
        let [velocity_m_per_s, _] = joints.velocity(&rates);
        Ok(DeviceState {
            position_m: pose.tip_m,
            velocity_m_per_s,
            orientation: Some(handle_orientation(&pose)),
            jaw_opening: joints.jaw_opening.clamp(0.0, 1.0),
            buttons: state.buttons.into(),
        })
    }

    /// Force and torque act at the tip. Without a pose the motors are switched off.
    fn write(&mut self, command: &ForceCommand) -> Result<(), DeviceFault> {
        let tip_m = self.reading.map_or(glam::DVec3::ZERO, |reading| reading.joints.pose().tip_m);
        let contact =
            ContactForce { point_m: tip_m, force_n: command.force_n, torque_n_m: command.torque_n_m };
        self.write_contacts(&[contact], command.jaw_force_n)
    }
}

#[cfg(test)]
#[path = "driver_tests.rs"]
mod tests;
