//! Where the other machine is, as on the command line, and how a link to it is opened.

use crate::link::{Link, Role, ZenohAddress, is_open, udp};
use anyhow::{Context, bail};
use std::net::ToSocketAddrs;

/// Where the other machine is, as on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkAddress {
    /// `udp://HOST:PORT`: the simulation listens there, the haptics machine sends there.
    Udp(String),
    /// `zenoh:` alone (peers find each other), with a locator (`zenoh:tcp/HOST:PORT`), or with zenoh's own
    /// configuration file (`zenoh:FILE.json5`).
    Zenoh(ZenohAddress),
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
            Self::File(path) => crate::zenoh_link::open_door(path)?,
            // A program without zenoh opens none.
            #[cfg(not(feature = "net"))]
            Self::File(_) => None,
        })
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
    pub fn open(&self, role: Role, has_key: bool) -> anyhow::Result<Link> {
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
            Self::Zenoh(address) => crate::zenoh_link::open(address, role),
            #[cfg(not(feature = "net"))]
            Self::Zenoh(_) => bail!(
                "this program was built without zenoh: build it with --features net, or use udp://HOST:PORT"
            ),
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
}
