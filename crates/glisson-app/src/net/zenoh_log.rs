//! Why zenoh does not connect (feature `net`): it tries again and again and says so only in its log, of which these lines
//! are told, each once.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::sync::Mutex;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// How lines begin that tell why there is no connection: of the side that connects, of the one that listens.
const TOLD: [&str; 2] = ["Unable to connect to configured peer", "Can not accept TLS connections"];
/// Different lines that are told; a stranger who can make others does not fill the terminal.
const MOST_LINES: usize = 50;

/// Tells on the program's error output from now on. With the variable `RUST_LOG` all of zenoh's log is written instead.
pub(super) fn tell() {
    if std::env::var_os("RUST_LOG").is_some() {
        zenoh::try_init_log_from_env();
    } else {
        // Already set by an earlier session of this program: the same one.
        let _ = tracing::subscriber::set_global_default(Teller::new(|line| eprintln!("zenoh: {line}")));
    }
}

/// Hands each line on once.
pub(super) struct Teller<F> {
    out: F,
    told: Mutex<BTreeSet<String>>,
}

impl<F: Fn(&str) + Send + Sync + 'static> Teller<F> {
    pub(super) fn new(out: F) -> Self {
        Self { out, told: Mutex::default() }
    }
}

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

impl<F: Fn(&str) + Send + Sync + 'static> Subscriber for Teller<F> {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        let target = metadata.target();
        *metadata.level() <= Level::DEBUG
            && metadata.is_event()
            && (target.contains("orchestrator") || target.contains("zenoh_link_tls"))
    }

    fn event(&self, event: &Event<'_>) {
        let mut text = Text::default();
        event.record(&mut text);
        if !TOLD.iter().any(|beginning| text.0.starts_with(beginning)) {
            return;
        }
        let line = essence(&text.0);
        let Ok(mut told) = self.told.lock() else { return };
        if told.len() < MOST_LINES && told.insert(line.to_owned()) {
            (self.out)(line);
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
