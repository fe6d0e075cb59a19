//! Who may talk to the server: this machine's own programs and pages, or whoever knows the token.

use anyhow::{Context, ensure};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{AppendHeaders, IntoResponse, Redirect, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// A token is at least so long: 16 of 64 signs are 96 bits.
const LEAST_TOKEN: usize = 16;
const MOST_TOKEN: usize = 128;
const COOKIE: &str = "glisson_token";
const TEACHER_COOKIE: &str = "glisson_teacher";

/// Who may connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    token: Option<String>,
    /// What who teaches knows, beside the token.
    teacher_key: String,
}

/// Whether a request comes from who teaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct IsTeacher(pub(super) bool);

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
        Ok(Self { token, teacher_key: random_token()? })
    }

    /// Whether only who knows a token may connect.
    pub fn needs_token(&self) -> bool {
        self.token.is_some()
    }

    /// What has to follow the page's address, `?token=...` or nothing.
    pub fn address_suffix(&self) -> String {
        self.token.as_ref().map_or_else(String::new, |token| format!("?token={token}"))
    }

    /// The same for who teaches.
    pub fn teacher_suffix(&self) -> String {
        let token = self.address_suffix();
        let sign = if token.is_empty() { '?' } else { '&' };
        format!("{token}{sign}teacher={}", self.teacher_key)
    }

    fn is_teacher(&self, headers: &HeaderMap, uri: &Uri) -> bool {
        let given = of_query(uri, "teacher=").or_else(|| of_cookie(headers, TEACHER_COOKIE));
        given.is_some_and(|given| is_same(given, &self.teacher_key))
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
        let given = of_query(uri, "token=").or(bearer).or_else(|| of_cookie(headers, COOKIE));
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

fn of_query<'a>(uri: &'a Uri, key: &str) -> Option<&'a str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix(key))
}

fn of_cookie<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|v| v.to_str().ok());
    cookies
        .flat_map(|line| line.split(';'))
        .find_map(|pair| pair.trim().strip_prefix(name)?.strip_prefix('='))
}

/// Takes as long for a wrong first sign as for a wrong last one.
fn is_same(given: &str, token: &str) -> bool {
    let differences = given.bytes().zip(token.bytes()).fold(0, |seen, (a, b)| seen | (a ^ b));
    given.len() == token.len() && differences == 0
}

/// Turns away whom [`Access::check`] refuses. A page that was opened with the token, or with the key of who
/// teaches, gets it as a cookie, which its further requests carry, and loses it from its address.
pub(crate) async fn guard(State(access): State<Arc<Access>>, mut request: Request, next: Next) -> Response {
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
    let is_teacher = access.is_teacher(request.headers(), request.uri());
    request.extensions_mut().insert(IsTeacher(is_teacher));
    let uri = request.uri();
    let token = of_query(uri, "token=").filter(|_| access.token.is_some()).map(|token| (COOKIE, token));
    let key = of_query(uri, "teacher=").filter(|_| is_teacher).map(|key| (TEACHER_COOKIE, key));
    let cookies = token.into_iter().chain(key);
    let cookies = cookies.map(|(name, value)| {
        (header::SET_COOKIE, format!("{name}={value}; HttpOnly; SameSite=Strict; Path=/"))
    });
    let cookies: Vec<_> = cookies.filter(|_| uri.path() == "/").collect();
    if cookies.is_empty() {
        return next.run(request).await;
    }
    (AppendHeaders(cookies), Redirect::to("/")).into_response()
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
    fn who_teaches_is_known_by_the_key_and_by_nothing_else() {
        let access = Access::for_address(IpAddr::from([0, 0, 0, 0]), Some(TOKEN.into())).unwrap();
        let suffix = access.teacher_suffix();
        let key = suffix.strip_prefix(&format!("?token={TOKEN}&teacher=")).unwrap();
        assert_eq!(key.len(), 32);
        assert!(access.is_teacher(&headers(&[]), &uri(&format!("/ws?teacher={key}"))));
        assert!(
            access.is_teacher(&headers(&[(header::COOKIE, &format!("glisson_teacher={key}"))]), &uri("/ws"))
        );
        for other in ["/ws", "/ws?teacher=", &format!("/ws?teacher={TOKEN}"), &format!("/ws?token={key}")] {
            assert!(!access.is_teacher(&headers(&[]), &uri(other)), "{other}");
        }
        // The key alone lets nobody in.
        assert_eq!(access.check(&headers(&[]), &uri(&format!("/ws?teacher={key}"))), Err(Refusal::Token));
        let local = Access::for_address(IpAddr::from([127, 0, 0, 1]), None).unwrap();
        assert!(local.teacher_suffix().starts_with("?teacher="));
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
