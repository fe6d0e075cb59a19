//! The active trocar's board: encoders in, analog outputs out, over a line of bytes.
//!
//! [`frames`] says what the bytes mean, [`driver`] makes a [`glisson::haptics::HapticDevice`] of a line with a board at its
//! other end, [`simulated`] is such a board with a mechanism and a hand. A real board takes its place by speaking the same
//! bytes on a TCP port, or behind a serial line that a program such as `socat` or `ser2net` passes on to one.
//! docs/active_trocar.md has the protocol.

mod driver;
mod frames;
mod simulated;

pub(crate) use driver::{BoardSettings, TcpLine, TrocarDevice};
pub(crate) use simulated::{SimulatedBoard, SimulatedLine, serve_board};

use anyhow::Context;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::{InstrumentTag, InstrumentType, TrocarJoints};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// How long a board may take to say what it is.
const PATIENCE: Duration = Duration::from_secs(2);
/// Between two looks whether it has.
const LOOK: Duration = Duration::from_millis(5);

/// The active trocar whose board listens at `address` (`host:port`).
pub(crate) fn connect(address: &str, settings: BoardSettings) -> anyhow::Result<TrocarDevice<TcpLine>> {
    let addresses = address.to_socket_addrs().with_context(|| format!("{address}: no such host and port"))?;
    let mut refusal = None;
    for address in addresses {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => {
                let mut device = TrocarDevice::new(TcpLine::new(stream)?, settings);
                let until = Instant::now() + PATIENCE;
                while !device.greet()? {
                    anyhow::ensure!(
                        Instant::now() < until,
                        "{address}: no active trocar answered within {} s{}",
                        PATIENCE.as_secs(),
                        device.last_refusal().map(|e| format!("; the last bytes: {e}")).unwrap_or_default()
                    );
                    std::thread::sleep(LOOK);
                }
                return Ok(device);
            }
            Err(error) => refusal = Some(error),
        }
    }
    Err(refusal.map_or_else(|| anyhow::anyhow!("no address"), anyhow::Error::from))
        .with_context(|| format!("{address}: cannot connect to the board of an active trocar"))
}

/// An active trocar without hardware: a board in memory that has passed its marks, with a probe 100 mm in, held by a hand
/// that keeps it there.
pub(crate) fn simulated(settings: BoardSettings, seed: u64) -> TrocarDevice<SimulatedLine> {
    let start = TrocarJoints { insertion_m: 0.1, ..TrocarJoints::default() };
    let tag = InstrumentTag { instrument: InstrumentType::PalpationProbe, serial: 1 };
    let board = SimulatedBoard::new(Mechanism::new(settings.profile, start), tag, seed).homed();
    TrocarDevice::new(SimulatedLine::new(board), settings)
}
