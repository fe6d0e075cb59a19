//! Why zenoh does not connect (feature `net`): it tries again and again and says so only in its log, of which these lines
//! are told, each once.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::Mutex;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// What is in lines that tell why there is no connection: of the side that connects, of the one that listens (whose hint
/// means something else).
const TOLD: [&str; 2] = ["Unable to connect to configured peer", ". Hint: increase the system open file limit"];
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

/// Lines that were told. There is one log in a program, so there is one of these.
static LINES: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());

/// What was told so far.
#[cfg(test)]
pub(super) fn lines() -> Vec<String> {
    LINES.lock().map_or_else(|_| Vec::new(), |lines| lines.iter().cloned().collect())
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

/// Without what changes from one attempt to the next, and without a hint that leads astray.
fn essence(line: &str) -> &str {
    let end = [". Retry in", ". Hint:", " at /"].iter().filter_map(|end| line.find(end)).min();
    &line[..end.unwrap_or(line.len())]
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
        if !TOLD.iter().any(|told| text.0.contains(told)) {
            return;
        }
        let line = essence(&text.0);
        let Ok(mut lines) = LINES.lock() else { return };
        if lines.len() < MOST_LINES && lines.insert(line.to_owned()) {
            eprintln!("zenoh: {line}");
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
