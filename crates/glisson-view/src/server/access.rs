//! Who may talk to the server: this machine's own programs and pages, or whoever knows the token.

use anyhow::{Context, ensure};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Redirect, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// A token is at least so long: 16 of 64 signs are 96 bits.
const LEAST_TOKEN: usize = 16;
const MOST_TOKEN: usize = 128;
const COOKIE: &str = "glisson_token";

/// Who may connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    token: Option<String>,
}

/// Why somebody is turned away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The page belongs to another site.
    Origin,
    /// The server was asked for under a name that is not this machine's own.
    Host,
    /// The token is missing or wrong.
    Token,
}

impl Access {
    /// Loopback addresses need no token; any other one gets a random token if none is given.
    ///
    /// # Errors
    /// For a token that is too short or has signs that do not belong into an address.
    pub fn for_address(address: IpAddr, token: Option<String>) -> anyhow::Result<Self> {
        if let Some(token) = &token {
            let is_sound = token.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_');
            ensure!(
                is_sound && (LEAST_TOKEN..=MOST_TOKEN).contains(&token.len()),
                "the token has {} signs{}; allowed: {LEAST_TOKEN} to {MOST_TOKEN} letters, digits, - and _; leave it \
                 out to get a random one",
                token.len(),
                if is_sound { "" } else { ", not all of them allowed" }
            );
        }
        let token = match token {
            None if !address.is_loopback() => Some(random_token()?),
            given => given,
        };
        Ok(Self { token })
    }

    /// Whether only who knows a token may connect.
    pub fn needs_token(&self) -> bool {
        self.token.is_some()
    }

    /// What has to follow the page's address, `?token=...` or nothing.
    pub fn address_suffix(&self) -> String {
        self.token.as_ref().map_or_else(String::new, |token| format!("?token={token}"))
    }

    pub(super) fn check(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), Refusal> {
        // What is not text is no name of ours.
        let text = |name| headers.get(name).map(|v: &axum::http::HeaderValue| v.to_str().unwrap_or_default());
        let host = text(header::HOST);
        if !from_own_page(text(header::ORIGIN), host) {
            return Err(Refusal::Origin);
        }
        let Some(token) = &self.token else {
            // A page of another site whose name was made to lead here (DNS rebinding) is its own origin: the name
            // tells it.
            return if host.is_none_or(is_loopback_host) { Ok(()) } else { Err(Refusal::Host) };
        };
        let bearer = text(header::AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
        let given = token_of_query(uri).or(bearer).or_else(|| token_of_cookie(headers));
        if given.is_some_and(|given| is_same(given, token)) { Ok(()) } else { Err(Refusal::Token) }
    }
}

/// 128 random bits in hexadecimal.
fn random_token() -> anyhow::Result<String> {
    let mut bytes = [0_u8; 16];
    let n = rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty())
        .context("the system gives no random numbers for a token; give one with --token")?;
    ensure!(n == bytes.len(), "the system gave {n} of 16 random bytes; give a token with --token");
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// A page of another site must not steer the simulation through the visitor's browser.
fn from_own_page(origin: Option<&str>, host: Option<&str>) -> bool {
    match (origin, host) {
        (Some(origin), Some(host)) => origin.split_once("://").is_some_and(|(_, from)| from == host),
        (Some(_), None) => false,
        // Programs that are no browsers send no origin.
        (None, _) => true,
    }
}

/// Whether a `Host` names this machine: `localhost`, 127.x.x.x or `[::1]`, with or without a port.
fn is_loopback_host(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn token_of_query(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="))
}

fn token_of_cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|v| v.to_str().ok());
    cookies
        .flat_map(|line| line.split(';'))
        .find_map(|pair| pair.trim().strip_prefix(COOKIE)?.strip_prefix('='))
}

/// Takes as long for a wrong first sign as for a wrong last one.
fn is_same(given: &str, token: &str) -> bool {
    let differences = given.bytes().zip(token.bytes()).fold(0, |seen, (a, b)| seen | (a ^ b));
    given.len() == token.len() && differences == 0
}

/// Turns away whom [`Access::check`] refuses. A page that was opened with the token gets it as a cookie, which its
/// further requests carry, and loses it from its address.
pub(crate) async fn guard(State(access): State<Arc<Access>>, request: Request, next: Next) -> Response {
    if let Err(refusal) = access.check(request.headers(), request.uri()) {
        let (status, text) = match refusal {
            Refusal::Origin => (StatusCode::FORBIDDEN, "only the viewer's own page may connect\n"),
            Refusal::Host => {
                (StatusCode::FORBIDDEN, "this server is for this machine: ask for it as localhost\n")
            }
            Refusal::Token => (
                StatusCode::UNAUTHORIZED,
                "the token is missing or wrong: use the address that the program printed, or send it as \
                 Authorization: Bearer\n",
            ),
        };
        return (status, text).into_response();
    }
    let is_page = request.uri().path() == "/";
    match token_of_query(request.uri()).filter(|_| is_page && access.token.is_some()) {
        Some(token) => {
            let cookie = format!("{COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/");
            ([(header::SET_COOKIE, cookie)], Redirect::to("/")).into_response()
        }
        None => next.run(request).await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "0123456789abcdef";

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.clone(), value.parse().unwrap())).collect()
    }

    fn uri(text: &str) -> Uri {
        text.parse().unwrap()
    }

    #[test]
    fn pages_of_other_sites_are_turned_away_also_under_a_rebound_name() {
        let access = Access::for_address(IpAddr::from([127, 0, 0, 1]), None).unwrap();
        let check = |pairs: &[(header::HeaderName, &str)]| access.check(&headers(pairs), &uri("/ws"));
        let own = (header::HOST, "127.0.0.1:8077");
        assert_eq!(check(&[]), Ok(()));
        assert_eq!(check(std::slice::from_ref(&own)), Ok(()));
        assert_eq!(check(&[own.clone(), (header::ORIGIN, "http://127.0.0.1:8077")]), Ok(()));
        for origin in ["http://elsewhere.example", "null", "http://127.0.0.1:9000", "\u{7f}"] {
            if let Ok(value) = axum::http::HeaderValue::from_bytes(origin.as_bytes()) {
                let mut map = headers(std::slice::from_ref(&own));
                map.insert(header::ORIGIN, value);
                assert_eq!(access.check(&map, &uri("/ws")), Err(Refusal::Origin), "{origin}");
            }
        }
        let rebound = [(header::HOST, "evil.example:8077"), (header::ORIGIN, "http://evil.example:8077")];
        assert_eq!(check(&rebound), Err(Refusal::Host));
        for host in ["localhost", "LOCALHOST:80", "127.9.9.9", "[::1]:8077", "[::1]"] {
            assert_eq!(check(&[(header::HOST, host)]), Ok(()), "{host}");
        }
        for host in ["localhost.example", "192.168.0.7:8077", "[::2]:1", "", "127.0.0.1.example"] {
            assert_eq!(check(&[(header::HOST, host)]), Err(Refusal::Host), "{host}");
        }
    }

    #[test]
    fn other_addresses_need_the_token_in_one_of_three_places() {
        let access = Access::for_address(IpAddr::from([0, 0, 0, 0]), Some(TOKEN.into())).unwrap();
        let host = (header::HOST, "simulator.example:8077");
        let check = |pairs: &[(header::HeaderName, &str)], address: &str| {
            access.check(&headers(&[pairs, std::slice::from_ref(&host)].concat()), &uri(address))
        };
        assert_eq!(check(&[], "/ws"), Err(Refusal::Token));
        assert_eq!(check(&[], &format!("/ws?a=b&token={TOKEN}")), Ok(()));
        assert_eq!(check(&[(header::AUTHORIZATION, &format!("Bearer {TOKEN}"))], "/ws"), Ok(()));
        assert_eq!(check(&[(header::COOKIE, &format!("x=1; glisson_token={TOKEN}"))], "/ws"), Ok(()));
        for wrong in ["", "0123456789abcde", "0123456789abcdef0", "0123456789abcdeF"] {
            assert_eq!(check(&[], &format!("/ws?token={wrong}")), Err(Refusal::Token), "{wrong}");
        }
        let foreign = (header::ORIGIN, "http://elsewhere.example");
        assert_eq!(check(&[foreign], &format!("/ws?token={TOKEN}")), Err(Refusal::Origin));
    }

    #[test]
    fn a_missing_token_is_made_and_a_weak_one_refused() {
        let anywhere = IpAddr::from([0, 0, 0, 0]);
        let [one, other] = [(); 2].map(|()| Access::for_address(anywhere, None).unwrap().address_suffix());
        assert!(one.len() == "?token=".len() + 32 && one != other, "{one} {other}");
        assert_eq!(Access::for_address(IpAddr::from([127, 0, 0, 1]), None).unwrap().address_suffix(), "");
        for weak in ["short", "sixteen signs  !!", &"x".repeat(129)] {
            let error = Access::for_address(anywhere, Some(weak.into())).unwrap_err().to_string();
            assert!(error.contains("allowed: 16 to 128"), "{error}");
        }
    }
}
