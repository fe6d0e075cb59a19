//! The active trocar's board: encoders in, analog outputs out, over a line of bytes.
//!
//! [`frames`] says what the bytes mean, [`driver`] makes a [`glisson::haptics::HapticDevice`] of a line with a board at its
//! other end, [`simulated`] is such a board with a mechanism and a hand. A real board takes its place by speaking the same
//! bytes on a TCP port, or behind a serial line that a program such as `socat` or `ser2net` passes on to one.
//! docs/active_trocar.md has the protocol.

mod driver;
mod frames;
mod simulated;

pub use driver::{BoardSettings, ByteLine, TcpLine, TrocarDevice};
pub(crate) use frames::MOST_TROCARS;
pub use simulated::{HandMotion, SimulatedBoard, SimulatedLine, SoftWall, serve_board};

use anyhow::Context;
use frames::Identity;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::{InstrumentTag, InstrumentType, TrocarJoints, TrocarProfile};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// How long a board may take to say what it is.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long a board that was greeted may take to tell a state.
const FIRST_STATE: Duration = Duration::from_millis(500);
/// Between two looks whether it has.
const LOOK: Duration = Duration::from_millis(5);

/// A line to a board, wherever it is.
pub enum BoardLine {
    /// A board behind TCP.
    Tcp(Box<TcpLine>),
    /// A board in memory.
    Simulated(Box<SimulatedLine>),
}

impl ByteLine for BoardLine {
    fn receive(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Self::Tcp(line) => line.receive(into),
            Self::Simulated(line) => line.receive(into),
        }
    }

    fn delay_ticks(&self) -> usize {
        match self {
            Self::Tcp(line) => line.delay_ticks(),
            Self::Simulated(line) => line.delay_ticks(),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        match self {
            Self::Tcp(line) => line.send(bytes),
            Self::Simulated(line) => line.send(bytes),
        }
    }
}

/// The active trocar whose board listens at `address` (`host:port`).
pub fn connect(address: &str, settings: BoardSettings) -> anyhow::Result<TrocarDevice<BoardLine>> {
    let line = BoardLine::Tcp(Box::new(TcpLine::new(stream_to(address)?)?));
    let mut device = TrocarDevice::new(line, settings);
    wait_for(address, &mut device, TrocarDevice::greet)?;
    let until = Instant::now() + FIRST_STATE;
    while !device.hear()? && Instant::now() < until {
        std::thread::sleep(LOOK);
    }
    device.check_instrument().with_context(|| address.to_owned())?;
    Ok(device)
}

/// What the board at `address` (`host:port`) says it is, whatever its profile; for `glisson devices doctor`.
pub(crate) fn examine(address: &str) -> anyhow::Result<String> {
    let settings = BoardSettings::new(TrocarProfile::built());
    let mut device = TrocarDevice::new(TcpLine::new(stream_to(address)?)?, settings);
    wait_for(address, &mut device, |device| {
        // It may be of another profile: that is told, too.
        let greeted = device.greet();
        if device.identity().is_some() { Ok(true) } else { greeted }
    })?;
    let identity = device.identity().context("a board that was greeted")?;
    let until = Instant::now() + FIRST_STATE;
    // Of another profile it tells its instrument all the same.
    while device.tag().is_none() && Instant::now() < until {
        let _ = device.hear();
        std::thread::sleep(LOOK);
    }
    Ok(format!("at {address}: {}; {}", identity_text(&identity), instrument_text(&device)))
}

/// For people: what is in it.
fn instrument_text<L: ByteLine>(device: &TrocarDevice<L>) -> String {
    match device.tag() {
        Some(Ok(tag)) => format!("in it: {}, number {}", tag.instrument.name(), tag.serial),
        Some(Err(error)) => format!("the instrument in it cannot be told: {error}"),
        None => "no instrument is in it".into(),
    }
}

/// For people: which board it is.
fn identity_text(identity: &Identity) -> String {
    let profile = usize::from(identity.profile).checked_sub(1).and_then(|i| TrocarProfile::NAMES.get(i));
    let profile = profile
        .map_or_else(|| format!("an unknown profile {}", identity.profile), |p| format!("profile {p}"));
    let Identity { serial, firmware, rate_hz, .. } = identity;
    format!("board {serial:08x}, {profile}, firmware {firmware}, {rate_hz} states a second")
}

fn stream_to(address: &str) -> anyhow::Result<TcpStream> {
    let addresses = address.to_socket_addrs().with_context(|| format!("{address}: no such host and port"))?;
    let mut refusal = None;
    for address in addresses {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => return Ok(stream),
            Err(error) => refusal = Some(error),
        }
    }
    Err(refusal.map_or_else(|| anyhow::anyhow!("no address"), anyhow::Error::from))
        .with_context(|| format!("{address}: cannot connect to the board of an active trocar"))
}

/// Asks again and again until the board has answered.
fn wait_for<L: ByteLine>(
    address: &str,
    device: &mut TrocarDevice<L>,
    mut ask: impl FnMut(&mut TrocarDevice<L>) -> anyhow::Result<bool>,
) -> anyhow::Result<()> {
    let until = Instant::now() + PATIENCE;
    while !ask(device)? {
        anyhow::ensure!(
            Instant::now() < until,
            "{address}: no active trocar answered within {} s{}",
            PATIENCE.as_secs(),
            device.last_refusal().map(|e| format!("; the last bytes: {e}")).unwrap_or_default()
        );
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// How far in the instrument of a simulated trocar begins [m].
pub(crate) const START_INSERTION_M: f64 = 0.1;

/// An active trocar without hardware: a board in memory that has passed its marks, with a probe 100 mm in, held by a hand
/// that keeps it there.
pub fn simulated(settings: BoardSettings, seed: u64) -> TrocarDevice<SimulatedLine> {
    TrocarDevice::new(simulated_line(&settings, START_INSERTION_M, seed), settings)
}

/// A line to such a board, with the instrument `insertion_m` [m] in: one that acts as the scene's.
pub(crate) fn simulated_line(settings: &BoardSettings, insertion_m: f64, seed: u64) -> SimulatedLine {
    let start = TrocarJoints { insertion_m, ..TrocarJoints::default() };
    let fitting = settings.tool_kind.and_then(|kind| InstrumentType::acting_as(kind).next());
    let tag = InstrumentTag { instrument: fitting.unwrap_or(InstrumentType::PalpationProbe), serial: 1 };
    let board = SimulatedBoard::new(Mechanism::new(settings.profile, start), tag, seed);
    SimulatedLine::new(board.numbered(settings.trocar).homed())
}
