//! Why zenoh does not connect (feature `net`): it tries again and again and says so only in its log, of which these lines
//! are told, each once.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Mutex;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// What is in the lines of the side that connects ...
const CONNECTING: &str = "Unable to connect to configured peer";
/// ... and of the one that listens: a hint that means something else.
const LISTENING: &str = ". Hint: increase the system open file limit";
/// What a side hears whose certificate the other one does not take.
const ALERT: &str = "received fatal alert";
/// Different lines that are told; a stranger who can make others does not fill the terminal.
const MOST_LINES: usize = 50;

/// Tells on the program's error output from now on. With the variable `RUST_LOG` all of zenoh's log is written instead.
pub(super) fn tell() {
    if std::env::var_os("RUST_LOG").is_some() {
        zenoh::try_init_log_from_env();
    } else {
        // Already set by an earlier session of this program: the same one.
        let _ = tracing::subscriber::set_global_default(Teller);
    }
}

/// Lines that were told, by what they are without digits: ports change from one attempt to the next. There is one log in a
/// program, so there is one of these.
static LINES: Mutex<BTreeMap<String, String>> = Mutex::new(BTreeMap::new());

/// What was told so far.
#[cfg(test)]
pub(super) fn lines() -> Vec<String> {
    LINES.lock().map_or_else(|_| Vec::new(), |lines| lines.values().cloned().collect())
}

/// Tells each line once.
struct Teller;

/// The text of an event.
#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            // Writing to a text does not fail.
            let _ = write!(self.0, "{value:?}");
        }
    }
}

/// What a user should hear of a line; none when it tells nothing about a connection. Without what changes from one attempt to
/// the next.
fn told(line: &str) -> Option<String> {
    let until = |ends: &[&str]| {
        let end = ends.iter().filter_map(|end| line.find(end)).min();
        &line[..end.unwrap_or(line.len())]
    };
    if line.starts_with(CONNECTING) {
        let essence = until(&[" at /", ". Retry in"]);
        let refused =
            if line.contains(ALERT) { " (the other machine refuses this one's certificate)" } else { "" };
        Some(format!("{essence}{refused}; it is tried again"))
    } else if line.contains(LISTENING) {
        Some(format!("a connection was refused: {}", until(&[LISTENING])))
    } else {
        None
    }
}

impl Subscriber for Teller {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        let target = metadata.target();
        *metadata.level() <= Level::DEBUG
            && metadata.is_event()
            && (target.contains("orchestrator") || target.contains("zenoh_link_tls"))
    }

    fn event(&self, event: &Event<'_>) {
        let mut text = Text::default();
        event.record(&mut text);
        let Some(line) = told(&text.0) else { return };
        let Ok(mut lines) = LINES.lock() else { return };
        let key = line.replace(|c: char| c.is_ascii_digit(), "");
        if lines.len() < MOST_LINES && !lines.contains_key(&key) {
            eprintln!("zenoh: {line}");
            lines.insert(key, line);
        }
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        // No span is enabled.
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[cfg(test)]
mod tests {
    use super::told;

    #[test]
    fn lines_tell_the_reason_and_no_more() {
        let line = "Unable to connect to configured peer tls/10.0.0.2:7447! received fatal alert: UnknownCA at /io/src/link.rs:1.. \
                    Retry in 200ms.";
        assert_eq!(
            told(line).unwrap(),
            "Unable to connect to configured peer tls/10.0.0.2:7447! received fatal alert: UnknownCA (the other machine refuses this \
             one's certificate); it is tried again"
        );
        let line = "invalid peer certificate: UnknownIssuer. Hint: increase the system open file limit.";
        assert_eq!(told(line).unwrap(), "a connection was refused: invalid peer certificate: UnknownIssuer");
        assert_eq!(told("Listener added: tls/10.0.0.2:7447"), None);
    }
}
