//! A board with a mechanism and a hand: what a real one does, without one.

use super::driver::{ByteLine, TcpLine};
use super::frames::{
    Frame, FrameDecoder, FrameError, Identity, MOST_FRAME_BYTES, Message, Outputs, State, flags,
};
use glisson::haptics::trocar::encoders::counts_at;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::motors::torques_of_outputs;
use glisson::haptics::trocar::{
    Axis, AxisEfforts, EncoderSample, InstrumentTag, N_AXES, TrocarJoints, TrocarProfile,
};
use glisson::math::SeededRandom;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Outputs older than this are taken away [s]: a choice, ten ticks of 1 kHz.
const WATCHDOG_S: f64 = 0.01;
/// Encoders are switched on anywhere within so many steps of their marks.
const ZERO_STEPS: f64 = 20_000.0;
/// Room for what the board has to say: a state, an identity and refusals.
const OUT_BYTES: usize = 8 * MOST_FRAME_BYTES;

/// A board, its trocar, and whoever holds the instrument.
pub struct SimulatedBoard {
    /// Masses, springs and friction of the trocar.
    pub mechanism: Mechanism,
    /// What else acts on the axes: the surroundings of a remote instrument.
    pub outside: AxisEfforts,
    trocar: u8,
    decoder: FrameDecoder,
    outputs: Outputs,
    /// Ticks since outputs came.
    n_silent: u32,
    time_us: f64,
    sequence: u16,
    /// Counts, not whole, where the motions are 0.
    zero_steps: [f64; N_AXES],
    is_marked: [bool; N_AXES],
    tag: Option<InstrumentTag>,
    is_smeared: bool,
    is_stopped: bool,
    last_refusal: Option<FrameError>,
    out: [u8; OUT_BYTES],
    n_out: usize,
}

impl SimulatedBoard {
    /// A board just switched on, no mark passed, with an instrument in it.
    pub fn new(mechanism: Mechanism, tag: InstrumentTag, seed: u64) -> Self {
        let mut random = SeededRandom::new(seed);
        Self {
            mechanism,
            outside: AxisEfforts::default(),
            trocar: 0,
            decoder: FrameDecoder::new(),
            outputs: Outputs::default(),
            n_silent: u32::MAX,
            time_us: 0.0,
            sequence: 0,
            zero_steps: std::array::from_fn(|_| random.uniform_in(-ZERO_STEPS, ZERO_STEPS)),
            is_marked: [false; N_AXES],
            tag: Some(tag),
            is_smeared: false,
            is_stopped: false,
            last_refusal: None,
            out: [0; OUT_BYTES],
            n_out: 0,
        }
    }

    /// The same as that trocar of its line.
    #[must_use]
    pub(crate) fn numbered(self, trocar: u8) -> Self {
        Self { trocar, ..self }
    }

    /// The same after all marks were passed.
    #[must_use]
    pub fn homed(self) -> Self {
        Self { is_marked: [true; N_AXES], ..self }
    }

    /// The instrument leaves, or another one comes in; its insertion, turn and jaws have to pass their marks again.
    pub fn change_instrument(&mut self, tag: Option<InstrumentTag>) {
        self.tag = tag;
        for axis in [Axis::Insertion, Axis::SelfRotation, Axis::Jaw] {
            self.is_marked[axis as usize] = false;
        }
        self.mechanism.joints =
            TrocarJoints { insertion_m: 0.0, self_rotation_rad: 0.0, ..self.mechanism.joints };
        self.mechanism.rates = [0.0; N_AXES];
    }

    /// Another instrument is where the first one was when the board was switched on.
    pub fn hold_instrument(&mut self, tag: InstrumentTag) {
        self.tag = Some(tag);
    }

    /// The tag cannot be read any more, or again.
    pub fn smear_tag(&mut self, is_smeared: bool) {
        self.is_smeared = is_smeared;
    }

    /// The emergency stop.
    pub fn press_stop(&mut self, is_pressed: bool) {
        self.is_stopped = is_pressed;
    }

    /// Why bytes were last no frame.
    pub fn last_refusal(&self) -> Option<FrameError> {
        self.last_refusal
    }

    /// What the motors exert now.
    pub fn motor_efforts(&self) -> AxisEfforts {
        if !self.motors_run() {
            return AxisEfforts::default();
        }
        let TrocarProfile { transmission, limits, .. } = &self.mechanism.profile;
        let full_scale_n_m = transmission.full_scale_n_m(limits);
        transmission.efforts(&torques_of_outputs(&self.outputs.levels, &full_scale_n_m))
    }

    fn motors_run(&self) -> bool {
        self.outputs.is_enabled && !self.is_stopped && self.tag.is_some() && !self.is_timed_out()
    }

    fn is_timed_out(&self) -> bool {
        f64::from(self.n_silent) > (WATCHDOG_S * self.mechanism.profile.rate_hz).round()
    }

    /// Takes bytes from the host.
    pub(crate) fn receive(&mut self, bytes: &[u8]) {
        let mut pushed = 0;
        while pushed < bytes.len() {
            pushed += self.decoder.push(&bytes[pushed..]);
            while let Some(found) = self.decoder.next_frame() {
                match found {
                    Ok(frame) if frame.trocar == self.trocar => self.obey(frame.message),
                    Ok(_) => {}
                    Err(error) => {
                        self.last_refusal = Some(error);
                        self.say(Message::Refusal(error.code()));
                    }
                }
            }
        }
    }

    fn obey(&mut self, message: Message) {
        match message {
            Message::Greeting => {
                let name = self.mechanism.profile.name;
                let place = TrocarProfile::NAMES.iter().position(|n| *n == name);
                self.say(Message::Identity(Identity {
                    profile: place.map_or(0, |place| place as u8 + 1),
                    firmware: 1,
                    serial: 1,
                    rate_hz: self.mechanism.profile.rate_hz as u16,
                }));
            }
            Message::Outputs(outputs) => {
                self.outputs = outputs;
                self.n_silent = 0;
            }
            Message::Stop => self.outputs = Outputs::default(),
            // Only a board sends these.
            Message::Identity(_) | Message::State(_) | Message::Refusal(_) => {}
        }
    }

    /// Moves on by a tick and says what is seen.
    pub(crate) fn tick(&mut self) {
        let period_s = 1.0 / self.mechanism.profile.rate_hz;
        let before = self.mechanism.joints.to_array();
        if self.tag.is_some() {
            let (motors, outside) = (self.motor_efforts().to_array(), self.outside.to_array());
            let sum = std::array::from_fn(|i| motors[i] + outside[i]);
            self.mechanism.advance(&AxisEfforts::from_array(sum), period_s);
        }
        self.n_silent = self.n_silent.saturating_add(1);
        self.time_us += period_s * 1e6;
        let after = self.mechanism.joints.to_array();
        for i in 0..N_AXES {
            self.is_marked[i] |= self.tag.is_some() && before[i] * after[i] <= 0.0;
        }
        let state = self.state();
        self.say(Message::State(state));
    }

    fn state(&self) -> State {
        let (values, resolution) = (self.mechanism.joints.to_array(), self.mechanism.profile.resolution);
        let at = |values: [f64; N_AXES]| {
            std::array::from_fn(|i| counts_at(values[i], resolution[i], self.zero_steps[i]))
        };
        let set = |flag: u16, is_set: bool| if is_set { flag } else { 0 };
        let mark_counts = if self.is_marked.contains(&true) { at([0.0; N_AXES]) } else { [0; N_AXES] };
        State {
            time_us: (self.time_us % 4_294_967_296.0) as u32,
            flags: set(flags::PRESENT, self.tag.is_some())
                | set(flags::ENABLED, self.motors_run())
                | set(flags::STOPPED, self.is_stopped)
                | set(flags::TIMED_OUT, self.outputs.is_enabled && self.is_timed_out()),
            encoders: EncoderSample { counts: at(values), mark_counts, is_marked: self.is_marked },
            tag: self.tag.map_or([0; 4], |tag| {
                let [code, low, high, check] = tag.to_bytes();
                [code, low, high, if self.is_smeared { !check } else { check }]
            }),
            buttons: 0,
        }
    }

    /// A message that does not fit is not sent: nobody reads.
    fn say(&mut self, message: Message) {
        let frame = Frame { trocar: self.trocar, sequence: self.sequence, message }.to_bytes();
        let bytes = frame.as_slice();
        if self.n_out + bytes.len() <= OUT_BYTES {
            self.sequence = self.sequence.wrapping_add(1);
            self.out[self.n_out..self.n_out + bytes.len()].copy_from_slice(bytes);
            self.n_out += bytes.len();
        }
    }

    /// Moves what it has to say to `into`; how many bytes.
    pub(crate) fn speak(&mut self, into: &mut [u8]) -> usize {
        let n = self.n_out.min(into.len());
        into[..n].copy_from_slice(&self.out[..n]);
        self.out.copy_within(n..self.n_out, 0);
        self.n_out -= n;
        n
    }
}

/// A hand that moves the instrument by itself about where it began: pushes and sways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandMotion {
    /// How far it pushes in and comes back [m].
    pub(crate) push_m: f64,
    /// How far it tilts to both sides [rad].
    pub(crate) sway_rad: f64,
    /// Pushes a second [Hz]; it sways half as often.
    pub(crate) frequency_hz: f64,
}

impl HandMotion {
    fn target(&self, start: &TrocarJoints, time_s: f64) -> TrocarJoints {
        let phase = std::f64::consts::TAU * self.frequency_hz * time_s;
        TrocarJoints {
            insertion_m: start.insertion_m + 0.5 * self.push_m * (1.0 - phase.cos()),
            roll_rad: start.roll_rad + self.sway_rad * (0.5 * phase).sin(),
            ..*start
        }
    }
}

/// Something soft across the instrument's way: it pushes back along the instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftWall {
    /// Insertion at which the tip meets it [m].
    pub(crate) from_m: f64,
    /// [N/m]
    pub(crate) stiffness_n_per_m: f64,
}

/// A board in memory: it moves on by a tick whenever the host looks for what has come.
pub struct SimulatedLine {
    /// The board.
    pub board: SimulatedBoard,
    has_ticked: bool,
    /// Ticks of the board for a look of the host, and what is left of one.
    ticks_a_look: f64,
    ticks_due: f64,
    motion: Option<(HandMotion, TrocarJoints)>,
    wall: Option<SoftWall>,
    /// Bytes both ways.
    pub n_bytes: u64,
}

impl SimulatedLine {
    pub(crate) fn new(board: SimulatedBoard) -> Self {
        Self {
            board,
            has_ticked: false,
            ticks_a_look: 1.0,
            ticks_due: 0.0,
            motion: None,
            wall: None,
            n_bytes: 0,
        }
    }

    /// For a host that looks `rate_hz` times a second: the board's time goes on as the host's.
    #[must_use]
    pub(crate) fn looked_at(self, rate_hz: f64) -> Self {
        Self { ticks_a_look: self.board.mechanism.profile.rate_hz / rate_hz, ..self }
    }

    /// In a hand that moves it about where it is now.
    #[must_use]
    pub(crate) fn moved_by(self, motion: HandMotion) -> Self {
        Self { motion: Some((motion, self.board.mechanism.joints)), ..self }
    }

    /// In nobody's hand, with that before its tip.
    #[must_use]
    pub(crate) fn before(mut self, wall: SoftWall) -> Self {
        self.board.mechanism.hand_target = None;
        Self { wall: Some(wall), ..self }
    }

    fn tick(&mut self) {
        if let Some((motion, start)) = &self.motion {
            self.board.mechanism.hand_target = Some(motion.target(start, self.board.time_us * 1e-6));
        }
        if let Some(wall) = &self.wall {
            let depth_m = (self.board.mechanism.joints.insertion_m - wall.from_m).max(0.0);
            self.board.outside.translation_n = -wall.stiffness_n_per_m * depth_m;
        }
        self.board.tick();
    }
}

impl ByteLine for SimulatedLine {
    fn receive(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        if !self.has_ticked {
            self.ticks_due += self.ticks_a_look;
            while self.ticks_due >= 1.0 {
                self.tick();
                self.ticks_due -= 1.0;
            }
            self.has_ticked = true;
        }
        let n = self.board.speak(into);
        // The host looks until there is nothing more; its next look is the next tick.
        self.has_ticked = n > 0;
        self.n_bytes += n as u64;
        Ok(n)
    }

    fn delay_ticks(&self) -> usize {
        0
    }

    fn send(&mut self, frame: &[u8]) -> std::io::Result<()> {
        self.n_bytes += frame.len() as u64;
        self.board.receive(frame);
        Ok(())
    }
}

/// Times that a host may send no frame in a row before the line is closed.
const MOST_REFUSED_IN_A_ROW: u32 = 64;

/// Lets a board speak on a line at its own rate until `stop` or until the host is gone or speaks nonsense; why it ended.
pub fn serve_board(mut line: TcpLine, board: &mut SimulatedBoard, stop: &AtomicBool) -> std::io::Result<()> {
    let period = Duration::from_secs_f64(1.0 / board.mechanism.profile.rate_hz);
    let mut next = Instant::now();
    let mut refused = 0;
    while !stop.load(Ordering::Relaxed) {
        let mut bytes = [0; 256];
        loop {
            let n = line.receive(&mut bytes)?;
            if n == 0 {
                break;
            }
            board.last_refusal = None;
            board.receive(&bytes[..n]);
            refused = if board.last_refusal.is_some() { refused + 1 } else { 0 };
            if refused >= MOST_REFUSED_IN_A_ROW {
                let why = board.last_refusal.map(|e| e.to_string()).unwrap_or_default();
                return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, why));
            }
        }
        board.tick();
        let mut said = [0; OUT_BYTES];
        let n = board.speak(&mut said);
        line.send(&said[..n])?;
        next += period;
        let now = Instant::now();
        match next.checked_duration_since(now) {
            Some(left) => std::thread::sleep(left),
            None => next = now,
        }
    }
    Ok(())
}
