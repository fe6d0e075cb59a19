//! Haply Inverse3 through Haply's own Inverse Service: a WebSocket with JSON text, on this machine as a rule.

mod messages;

use super::driver::{Line, ThreadedDevice};
use super::kind::{DeviceChoice, DeviceKind, Finding, OpenRequest, after_colon, host_and_port};
use crate::open_device::OpenDevice;
use anyhow::Context;
use glam::DQuat;
use glisson::haptics::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice};
use glisson::math::{DMat3, DVec3};
use messages::{Generation, GripTold, Update, Wanted, force_command, full_state_request, parse};
use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Message, WebSocket};

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "haply",
    pattern: "haply[:HOST:PORT]",
    about: "Haply Inverse3 through Haply's Inverse Service (default 127.0.0.1:10001)",
    parse: |rest| {
        let address =
            host_and_port(after_colon(rest).unwrap_or(if rest.is_empty() { ADDRESS } else { rest }))?;
        Ok(Arc::new(HaplyChoice { address }))
    },
    examine: Some(|address| Finding::of("Haply Inverse Service", examine(address.unwrap_or(ADDRESS)))),
};

/// A device behind the service at an address.
#[derive(Debug)]
struct HaplyChoice {
    /// `HOST:PORT` of the service.
    address: String,
}

impl DeviceChoice for HaplyChoice {
    fn text(&self) -> String {
        format!("Haply Inverse3 at {}", self.address)
    }

    fn open(&self, _: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        Ok(OpenDevice {
            world_from_device: patient_from_haply(),
            has_clutch: true,
            ..OpenDevice::new(open(&self.address)?, "Haply Inverse3")
        })
    }
}

/// Axes of patients from those of an Inverse3 as its maker ships it: +x to the user's right, +y away from him, +z up; the
/// user looks at a supine patient from the feet.
pub(super) fn patient_from_haply() -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y))
}

/// Where the service listens unless told otherwise.
pub(super) const ADDRESS: &str = "127.0.0.1:10001";

/// A choice on the careful side, below what the maker allows; the law keeps within it.
const LIMITS: DeviceLimits = DeviceLimits {
    force_n: 5.0,
    torque_n_m: 0.0,
    force_rate_n_per_s: 2_000.0,
    stiffness_n_per_m: 600.0,
    damping_n_s_per_m: 4.0,
    resolution_m: 1e-5,
    rate_hz: 1_000.0,
    ..DeviceLimits::NONE
};

/// A service that says nothing for so long has stopped.
const LONGEST_SILENCE: Duration = Duration::from_millis(500);
/// What takes so long to say something of use has stopped, too.
const LONGEST_TURN: Duration = Duration::from_secs(1);
/// Between two tries to reach the service.
const RETRY: Duration = Duration::from_millis(500);
/// A grip that says nothing for so long is silent; meanwhile its last word counts. A choice: wireless ones leave frames out, and
/// a hand turns little in that time.
const LONGEST_GRIP_SILENCE: Duration = Duration::from_millis(100);
const GRIP_IS_SILENT: &str = "its grip says nothing: switch it on, or begin again without it";
/// Frames have some 2 kB a device.
const LONGEST_FRAME_BYTES: usize = 1 << 17;

/// Opens the device behind the service at `address`, `host:port`. The service need not run yet.
fn open(address: &str) -> anyhow::Result<Box<dyn HapticDevice>> {
    let line = HaplyLine {
        address: address.to_owned(),
        session: None,
        grip: HeldGrip::default(),
        next_try: Instant::now(),
    };
    Ok(Box::new(ThreadedDevice::start("haply", LIMITS, line)?))
}

/// One line on the service: its version, or why it cannot be reached.
pub(super) fn service_version(address: &str) -> anyhow::Result<String> {
    let mut stream = connect(address)?;
    write!(stream, "GET /version HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut answer = Vec::new();
    // What came before a time-out is enough, if it holds the version.
    let _ = stream.take(8192).read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let (head, body) = answer.split_once("\r\n\r\n").context("the service's answer is no HTTP")?;
    anyhow::ensure!(
        head.contains(" 200 "),
        "the service answers {:?}",
        head.lines().next().unwrap_or_default()
    );
    Ok(body.trim().chars().take(100).collect())
}

fn connect(address: &str) -> anyhow::Result<TcpStream> {
    let mut addresses = address.to_socket_addrs().with_context(|| format!("{address}: no address"))?;
    let first = addresses.next().with_context(|| format!("{address}: no address"))?;
    let stream = TcpStream::connect_timeout(&first, LONGEST_SILENCE)
        .with_context(|| format!("{address}: nobody answers; is Haply's Inverse Service running there?"))?;
    stream.set_read_timeout(Some(LONGEST_SILENCE))?;
    stream.set_write_timeout(Some(LONGEST_SILENCE))?;
    // A command must not wait for the next one.
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// A connection that waits no longer than until a moment, however slowly the bytes come.
struct Impatient {
    stream: TcpStream,
    until: Instant,
}

impl Read for Impatient {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        if Instant::now() >= self.until {
            return Err(std::io::ErrorKind::TimedOut.into());
        }
        self.stream.read(bytes)
    }
}

impl Write for Impatient {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.stream.flush()
    }
}

struct Session {
    socket: WebSocket<Impatient>,
    generation: Generation,
    /// The first Inverse3 that was seen is kept to.
    device_id: Option<String>,
    /// Frames in a row that could not be used.
    n_refused: u32,
}

/// The first grip that said something is kept to, beyond the end of a connection: an instrument that began to turn with a hand
/// does not go back to its home's direction in the middle of tissue.
#[derive(Default)]
struct HeldGrip(Option<(GripTold, Instant)>);

impl HeldGrip {
    fn id(&self) -> Option<&str> {
        self.0.as_ref().map(|(grip, _)| grip.device_id.as_str())
    }

    /// The state with what the grip says now, or said a moment ago; none when it is silent for longer.
    fn state(&mut self, update: &Update, now: Instant) -> Option<DeviceState> {
        let last = self.0.take();
        self.0 = match (update.grip.clone(), last) {
            // A word without an orientation renews the buttons only.
            (Some(GripTold { orientation: None, buttons, .. }), Some((last, heard)))
                if last.orientation.is_some() =>
            {
                Some((GripTold { buttons, ..last }, heard))
            }
            (Some(told), _) => Some((told, now)),
            (None, last) => last,
        };
        match &self.0 {
            Some((_, heard)) if now.duration_since(*heard) > LONGEST_GRIP_SILENCE => None,
            held => Some(update.state_with(held.as_ref().map(|(grip, _)| grip))),
        }
    }
}

struct HaplyLine {
    address: String,
    session: Option<Session>,
    grip: HeldGrip,
    next_try: Instant,
}

/// So many frames in a row without a usable state: the device is lost.
const MOST_REFUSED: u32 = 10;
const UNUSABLE: &str = "the service sends frames that cannot be used; `glisson devices doctor` tells why";

impl HaplyLine {
    fn begin(&self) -> anyhow::Result<Session> {
        // A service that does not tell its version is taken for a present one.
        let version = service_version(&self.address).ok();
        let generation = version.and_then(|v| Generation::of_version(&v)).unwrap_or(Generation::Vector);
        let request = format!("ws://{}/", self.address).into_client_request()?;
        let config = WebSocketConfig::default()
            .max_message_size(Some(LONGEST_FRAME_BYTES))
            .max_frame_size(Some(LONGEST_FRAME_BYTES));
        let stream = Impatient { stream: connect(&self.address)?, until: Instant::now() + LONGEST_TURN };
        let (mut socket, _) = tungstenite::client::client_with_config(request, stream, Some(config))
            .map_err(|e| anyhow::anyhow!("{}: no WebSocket: {e}", self.address))?;
        socket.send(Message::text(full_state_request())).context("the service stopped listening")?;
        Ok(Session { socket, generation, device_id: None, n_refused: 0 })
    }
}

/// What went wrong in a turn; fixed texts, because the haptic loop hands them on.
enum Trouble {
    /// Of the connection: a new one may help.
    Line(&'static str),
    /// Of the device: it keeps its connection.
    Device(&'static str),
}

impl Session {
    fn turn(&mut self, command: &ForceCommand, grip: &mut HeldGrip) -> Result<DeviceState, Trouble> {
        let deaf = |_| Trouble::Line("the service stopped listening");
        self.socket.get_mut().until = Instant::now() + LONGEST_TURN;
        loop {
            let message = self.socket.read().map_err(|_| Trouble::Line("the service stopped answering"))?;
            // What is no text is no state either.
            let update = match message {
                Message::Text(text) => {
                    parse(&text, Wanted { device_id: self.device_id.as_deref(), grip_id: grip.id() }).ok()
                }
                _ => None,
            };
            let Some(update) = update else {
                self.n_refused += 1;
                if self.n_refused < MOST_REFUSED {
                    self.socket.send(Message::text(full_state_request())).map_err(deaf)?;
                    continue;
                }
                return Err(Trouble::Line(UNUSABLE));
            };
            self.n_refused = 0;
            let usable = match update.hindrance {
                Some(hindrance) => Err(hindrance),
                None => grip.state(&update, Instant::now()).ok_or(GRIP_IS_SILENT),
            };
            // A device that must not be used gets no force.
            let force_n = if usable.is_err() { DVec3::ZERO } else { command.force_n };
            let reply = force_command(self.generation, &update.device_id, force_n);
            self.device_id = Some(update.device_id);
            self.socket.send(Message::text(reply)).map_err(deaf)?;
            return usable.map_err(Trouble::Device);
        }
    }
}

/// What the service says about its device, or what is wrong: for people.
fn examine(address: &str) -> anyhow::Result<String> {
    let version = service_version(address)?;
    let line = HaplyLine {
        address: address.to_owned(),
        session: None,
        grip: HeldGrip::default(),
        next_try: Instant::now(),
    };
    let mut session = line.begin()?;
    let until = Instant::now() + 2 * LONGEST_SILENCE;
    let mut reason = "it sends nothing".to_owned();
    while Instant::now() < until {
        session.socket.get_mut().until = until;
        let Message::Text(text) = session.socket.read().context("the service stopped answering")? else {
            continue;
        };
        match parse(&text, Wanted::default()) {
            Ok(update) => {
                let hindrance = update.hindrance.map_or(String::new(), |text| format!("; {text}"));
                return Ok(format!("service {version}, Inverse3 {}{hindrance}", update.device_id));
            }
            Err(refusal) => reason = refusal,
        }
    }
    anyhow::bail!("service {version}: {reason}")
}

impl Line for HaplyLine {
    fn turn(&mut self, command: &ForceCommand) -> Result<DeviceState, DeviceFault> {
        if self.session.is_none() && Instant::now() >= self.next_try {
            self.next_try = Instant::now() + RETRY;
            self.session = self.begin().ok();
        }
        let Some(session) = &mut self.session else {
            std::thread::sleep(RETRY / 20);
            return Err(DeviceFault::Lost("no connection to Haply's service".into()));
        };
        session.turn(command, &mut self.grip).map_err(|trouble| match trouble {
            Trouble::Line(reason) => {
                self.session = None;
                DeviceFault::Lost(reason.into())
            }
            Trouble::Device(reason) => DeviceFault::Lost(reason.into()),
        })
    }

    fn most_turns_hz(&self) -> Option<f64> {
        None
    }
}

#[cfg(test)]
mod tests;
