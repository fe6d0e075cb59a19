//! Ways for messages to reach the other machine. A message may be lost, doubled or overtaken; none is ever waited for.

use anyhow::{Context, anyhow};
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Which of the two machines this one is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Role {
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
pub struct Link {
    pub(crate) sender: Box<dyn SendHalf>,
    pub(crate) receiver: Box<dyn ReceiveHalf>,
}

/// How a zenoh session is set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ZenohAddress {
    /// By multicast on the local network.
    Scouting,
    /// The simulation listens there, the haptics machine connects.
    Locator(String),
    /// As the file says: client or peer, TLS, access rules.
    File(PathBuf),
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
