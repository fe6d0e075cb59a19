//! Ways for messages to reach the other machine. A message may be lost, doubled or overtaken; none is ever waited for.

use anyhow::{Context, anyhow, bail};
use std::io;
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Which of the two machines this one is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Role {
    /// Has the devices and makes their forces
    Haptics,
    /// Deforms the organ and shows it
    Simulation,
}

impl Role {
    /// The other machine's.
    pub(crate) fn other(self) -> Self {
        match self {
            Self::Haptics => Self::Simulation,
            Self::Simulation => Self::Haptics,
        }
    }

    /// As people write it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Haptics => "haptics",
            Self::Simulation => "simulation",
        }
    }
}

/// Sends; never waits for the network.
pub(crate) trait SendHalf: Send {
    /// Sends one message, or loses it.
    ///
    /// # Errors
    /// What the system says; a later message may get through.
    fn send(&mut self, message: &[u8]) -> io::Result<()>;
}

/// Receives.
pub(crate) trait ReceiveHalf: Send {
    /// The next message, for which it waits no longer than `wait`: its length in `buffer`.
    ///
    /// # Errors
    /// What the system says; a later call may succeed.
    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<Option<usize>>;

    /// The last message was one of ours: its sender is the one to talk to.
    fn trust_sender(&mut self);

    /// The last message may be one of ours: its sender gets one message, to answer, beside the one to talk to.
    fn ask_sender(&mut self);
}

/// Both directions.
pub(crate) struct Link {
    pub(crate) sender: Box<dyn SendHalf>,
    pub(crate) receiver: Box<dyn ReceiveHalf>,
}

/// Where the other machine is, as on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum LinkAddress {
    /// `udp://HOST:PORT`: the simulation listens there, the haptics machine sends there.
    Udp(String),
    /// `zenoh:` alone (peers find each other), with a locator (`zenoh:tcp/HOST:PORT`), or with zenoh's own
    /// configuration file (`zenoh:FILE.json5`).
    Zenoh(ZenohAddress),
}

/// How a zenoh session is set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ZenohAddress {
    /// By multicast on the local network.
    Scouting,
    /// The simulation listens there, the haptics machine connects.
    Locator(String),
    /// As the file says: client or peer, TLS, access rules.
    File(PathBuf),
}

impl ZenohAddress {
    /// Through what others than whom a certificate lets in, or than this machine's own programs, get there; none: nobody does.
    ///
    /// # Errors
    /// When the configuration file cannot be read.
    pub(super) fn open_door(&self) -> anyhow::Result<Option<String>> {
        Ok(match self {
            Self::Scouting => Some("multicast".to_owned()),
            Self::Locator(locator) => is_open(locator, false).then(|| locator.clone()),
            #[cfg(feature = "net")]
            Self::File(path) => super::zenoh_link::open_door(path)?,
            // A program without zenoh opens none.
            #[cfg(not(feature = "net"))]
            Self::File(_) => None,
        })
    }
}

/// Whether strangers get through an endpoint of zenoh's, `PROTOCOL/ADDRESS[?METADATA][#KEY=VALUE;...]`. `is_mutual`: unless
/// the endpoint says otherwise, certificates are asked of both sides.
pub(super) fn is_open(endpoint: &str, is_mutual: bool) -> bool {
    let (locator, settings) = endpoint.split_once('#').unwrap_or((endpoint, ""));
    let locator = locator.split('?').next().unwrap_or_default();
    let Some((protocol, address)) = locator.split_once('/') else { return true };
    let mutual = settings.split(';').find_map(|setting| setting.strip_prefix("enable_mtls="));
    let is_mutual = mutual.map_or(is_mutual, |mutual| mutual == "true");
    let host = address.rsplit_once(':').map_or("", |(host, _)| host.trim_matches(['[', ']']));
    let is_own = host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback());
    match protocol {
        "tls" | "quic" => !is_own && !is_mutual,
        "tcp" | "udp" | "ws" => !is_own,
        // Files of this machine.
        "unixsock-stream" | "unixpipe" => false,
        _ => true,
    }
}

impl std::str::FromStr for LinkAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(address) = text.strip_prefix("udp://") {
            let has_port = address
                .rsplit_once(':')
                .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
            return if has_port {
                Ok(Self::Udp(address.to_owned()))
            } else {
                Err(format!("{text}: after udp:// comes HOST:PORT, for example udp://127.0.0.1:7447"))
            };
        }
        let Some(rest) = text.strip_prefix("zenoh:") else {
            return Err(format!("{text}: must begin with udp:// or zenoh:"));
        };
        Ok(Self::Zenoh(if rest.is_empty() {
            ZenohAddress::Scouting
        } else if rest.ends_with(".json5") || rest.ends_with(".json") || rest.ends_with(".yaml") {
            ZenohAddress::File(rest.into())
        } else if rest.split_once('/').is_some_and(|(protocol, to)| !protocol.is_empty() && to.contains(':'))
        {
            ZenohAddress::Locator(rest.to_owned())
        } else {
            return Err(format!("{text}: after zenoh: comes nothing, PROTOCOL/HOST:PORT or FILE.json5"));
        }))
    }
}

impl std::fmt::Display for LinkAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Udp(address) => write!(f, "udp://{address}"),
            Self::Zenoh(ZenohAddress::Scouting) => f.write_str("zenoh:"),
            Self::Zenoh(ZenohAddress::Locator(locator)) => write!(f, "zenoh:{locator}"),
            Self::Zenoh(ZenohAddress::File(path)) => write!(f, "zenoh:{}", path.display()),
        }
    }
}

impl LinkAddress {
    /// What to look at when nobody is found there.
    pub(super) fn advice(&self) -> &'static str {
        match self {
            Self::Udp(_) | Self::Zenoh(ZenohAddress::Locator(_)) => {
                "does it run, at this address, with the same --link-key?"
            }
            Self::Zenoh(ZenohAddress::Scouting) => {
                "does it run, with the same --link-key, and was the network interface up on both machines when they were \
                 started? zenoh looks for others nowhere else"
            }
            Self::Zenoh(ZenohAddress::File(_)) => {
                "does it run, with the same --link-key, and does the file lead to it?"
            }
        }
    }

    /// Whether zenoh may be reached this way. `has_key`: whether messages are sealed with a key.
    ///
    /// # Errors
    /// When others could steer, or the configuration file cannot be read.
    pub(super) fn check(&self, has_key: bool) -> anyhow::Result<()> {
        let Self::Zenoh(address) = self else { return Ok(()) };
        match address.open_door()? {
            Some(door) if !has_key => bail!(
                "{self} can be reached from other machines ({door}), where anybody could steer the instruments: give both \
                 machines the same --link-key FILE, or a configuration file whose endpoints are tls/ or quic/ with \
                 enable_mtls, and without multicast (docs/network.md)"
            ),
            _ => Ok(()),
        }
    }

    /// Opens the link. `has_key`: whether messages are sealed with a key.
    ///
    /// # Errors
    /// When the address cannot be used.
    pub(crate) fn open(&self, role: Role, has_key: bool) -> anyhow::Result<Link> {
        self.check(has_key)?;
        match self {
            Self::Udp(address) => {
                let address = address
                    .to_socket_addrs()
                    .with_context(|| format!("udp://{address}"))?
                    .next()
                    .with_context(|| format!("udp://{address}: no such host"))?;
                if !address.ip().is_loopback() && !has_key {
                    bail!(
                        "udp://{address} leaves this machine, where anybody could steer the instruments: give both \
                         machines the same --link-key FILE, or use zenoh with TLS (docs/network.md)"
                    );
                }
                udp(address, role)
            }
            #[cfg(feature = "net")]
            Self::Zenoh(address) => super::zenoh_link::open(address, role),
            #[cfg(not(feature = "net"))]
            Self::Zenoh(_) => bail!(
                "this program was built without zenoh: build it with --features net, or use udp://HOST:PORT"
            ),
        }
    }
}

/// Datagrams: the simulation listens at `address` and answers where the last message came from, the haptics machine
/// talks to `address` only.
pub(crate) fn udp(address: SocketAddr, role: Role) -> anyhow::Result<Link> {
    let (socket, peer) = match role {
        Role::Simulation => {
            let socket =
                UdpSocket::bind(address).map_err(|e| anyhow!("cannot listen on udp://{address}: {e}"))?;
            (socket, Some(Arc::default()))
        }
        Role::Haptics => {
            let any = if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
            let socket = UdpSocket::bind(any).context("cannot open a UDP socket")?;
            socket.connect(address).with_context(|| format!("udp://{address}"))?;
            (socket, None)
        }
    };
    let sender = UdpSender { socket: socket.try_clone()?, peer: peer.clone() };
    let receiver = UdpReceiver { socket, peer, last_from: None };
    Ok(Link { sender: Box::new(sender), receiver: Box::new(receiver) })
}

/// Whom a listening socket answers.
#[derive(Clone, Copy, Default)]
struct Answered {
    trusted: Option<SocketAddr>,
    /// One message goes there, and no more: whoever sends a recorded one must not get a stream for it, or lead one elsewhere.
    asked: Option<SocketAddr>,
}

/// None for a connected socket.
type Peer = Option<Arc<Mutex<Answered>>>;

/// Whether the error only says that the other machine is not there now, or that nothing came.
fn passes(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionRefused, Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), ConnectionRefused | Interrupted | TimedOut | WouldBlock)
}

struct UdpSender {
    socket: UdpSocket,
    peer: Peer,
}

impl SendHalf for UdpSender {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        let may_fail = |sent: io::Result<usize>| match sent {
            Err(error) if !passes(&error) => Err(error),
            _ => Ok(()),
        };
        let Some(peer) = &self.peer else { return may_fail(self.socket.send(message)) };
        // The lock is held for a copy only.
        let Answered { trusted, asked } = peer
            .lock()
            .map_or_else(|_| Answered::default(), |mut peer| Answered { asked: peer.asked.take(), ..*peer });
        for to in trusted.into_iter().chain(asked.filter(|asked| trusted != Some(*asked))) {
            may_fail(self.socket.send_to(message, to))?;
        }
        Ok(())
    }
}

struct UdpReceiver {
    socket: UdpSocket,
    peer: Peer,
    last_from: Option<SocketAddr>,
}

impl ReceiveHalf for UdpReceiver {
    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        self.socket.set_read_timeout(Some(wait.max(Duration::from_millis(1))))?;
        match self.socket.recv_from(buffer) {
            Ok((n, from)) => {
                self.last_from = Some(from);
                Ok(Some(n))
            }
            Err(error) if passes(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn trust_sender(&mut self) {
        if let Some(peer) = &self.peer
            && let Ok(mut peer) = peer.lock()
        {
            peer.trusted = self.last_from;
        }
    }

    fn ask_sender(&mut self) {
        if let Some(peer) = &self.peer
            && let Ok(mut peer) = peer.lock()
        {
            peer.asked = self.last_from;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_mistakes_are_told() {
        let read = |text: &str| text.parse::<LinkAddress>();
        assert_eq!(read("udp://127.0.0.1:7000"), Ok(LinkAddress::Udp("127.0.0.1:7000".into())));
        assert_eq!(read("zenoh:"), Ok(LinkAddress::Zenoh(ZenohAddress::Scouting)));
        let locator = LinkAddress::Zenoh(ZenohAddress::Locator("tcp/10.0.0.2:7447".into()));
        assert_eq!(read("zenoh:tcp/10.0.0.2:7447"), Ok(locator));
        assert_eq!(read("zenoh:tls.json5"), Ok(LinkAddress::Zenoh(ZenohAddress::File("tls.json5".into()))));
        for wrong in ["127.0.0.1:7000", "udp://7000", "udp://host:port", "zenoh:host", "tcp://a:1"] {
            let error = read(wrong).unwrap_err();
            assert!(error.starts_with(wrong), "{error}");
        }
    }

    #[test]
    fn other_machines_are_reached_only_with_a_key() {
        let address: LinkAddress = "udp://192.0.2.1:7000".parse().unwrap();
        let error = address.open(Role::Haptics, false).err().unwrap().to_string();
        assert!(error.contains("--link-key"), "{error}");
        assert!(address.open(Role::Haptics, true).is_ok());
        for open in ["zenoh:", "zenoh:tcp/192.0.2.1:7447", "zenoh:tcp/host:7447", "zenoh:tcp/[::]:7447"] {
            let address: LinkAddress = open.parse().unwrap();
            let error = address.open(Role::Haptics, false).err().unwrap().to_string();
            assert!(error.contains("--link-key"), "{error}");
        }
        for closed in ["zenoh:tcp/127.0.0.1:7447", "zenoh:tcp/[::1]:7447", "zenoh:udp/localhost:1"] {
            assert!(closed.parse::<LinkAddress>().unwrap().check(false).is_ok(), "{closed}");
        }
    }

    #[test]
    fn strangers_get_through_an_endpoint_unless_it_asks_for_certificates_or_is_this_machines() {
        for (endpoint, of_file, expected) in [
            ("tcp/0.0.0.0:7447", true, true),
            ("tcp/192.0.2.1:7447#iface=127.0.0.1:1", true, true),
            ("tcp/127.0.0.1:7447", false, false),
            ("tcp/[::1]:7447?prio=6-7", false, false),
            ("tls/192.0.2.1:7447", true, false),
            ("tls/192.0.2.1:7447", false, true),
            ("tls/192.0.2.1:7447#enable_mtls=false", true, true),
            ("quic/host:7447#root_ca_certificate_file=ca.pem;enable_mtls=true", false, false),
            ("unixsock-stream/tmp/zenoh.sock", false, false),
            ("serial/dev/ttyUSB0", false, true),
            ("nonsense", true, true),
        ] {
            assert_eq!(is_open(endpoint, of_file), expected, "{endpoint}");
        }
    }
}
