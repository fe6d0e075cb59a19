//! The session that is recorded: kept while it happens, lost where it cannot be written, gone on with.

use super::Simulation;
use crate::recorder::Recorder;
use anyhow::bail;
use glisson::record::note::Note;
use glisson::record::session::{Session, SessionEvent};
use std::path::Path;

impl Simulation {
    pub(super) fn record(&mut self, event: &SessionEvent) {
        let written = self.recorder.as_mut().map_or(Ok(()), |recorder| recorder.write(event));
        self.unless_written(written);
    }

    /// A full disk is no reason to take the instruments out of somebody's hands.
    fn unless_written(&mut self, written: anyhow::Result<()>) {
        let (Err(error), Some(recorder)) = (written, &self.recorder) else { return };
        let (partial, step) = (recorder.partial().display(), self.world.steps_made());
        let lost = format!(
            "the session is not recorded any more, from step {step} on: {error:#}; what was written before is in {partial}"
        );
        self.recorder = None;
        self.tell(lost.clone());
        self.lost_recording = Some(lost);
    }

    /// Keeps in the session what somebody who watches wants to be kept. It changes nothing.
    pub fn note(&mut self, note: Note) {
        let (step, now_s) = (self.world.steps_made(), self.world.time_s());
        if self.recorder.is_none() {
            if matches!(note, Note::Bookmark { .. }) {
                self.tell(
                    "there is no bookmark: nothing is recorded here (--record FILE records)".to_owned(),
                );
            }
            return;
        }
        let note = match note {
            // What is to come cannot be marked.
            Note::Bookmark { time_s, text } => Note::Bookmark { time_s: time_s.min(now_s), text },
            other => other,
        };
        if let Note::Bookmark { time_s, text } = &note {
            let about = if text.is_empty() { String::new() } else { format!(": {text}") };
            self.tell_news(format!("a bookmark at {time_s:.2} s{about}"));
        }
        self.record(&SessionEvent::Note { step, note });
    }

    /// From here on a crash of the program loses nothing of what happened before.
    pub(crate) fn keep_session(&mut self) {
        let step = self.world.steps_made();
        if self.recorder.as_ref().is_some_and(|recorder| recorder.last_checkpoint() != Some(step)) {
            // Says how far it came, also where the hands rest.
            let state_hash = self.world.state_hash();
            self.record(&SessionEvent::Checkpoint { step, state_hash });
        }
        let written = self.recorder.as_mut().map_or(Ok(()), Recorder::flush);
        self.unless_written(written);
    }

    /// Ends the recording, if there is one.
    pub(super) fn finish_recording(&mut self) -> anyhow::Result<()> {
        if let Some(lost) = &self.lost_recording {
            bail!("{lost}");
        }
        self.recorder.take().map_or(Ok(()), Recorder::finish)
    }

    /// After a replay of `session`: it goes on live, and is recorded in a file of its own from the beginning.
    pub(crate) fn go_on(&mut self, session: &Session, folder: &Path, record: &Path) -> anyhow::Result<()> {
        self.recorder = Some(Recorder::create(record, folder, &session.header, &session.events)?);
        self.is_live = true;
        // Otherwise it was ordered before, and is being made.
        self.orders_recomputations = self.builder.is_none();
        self.is_resumed = true;
        let time_s = self.world.time_s();
        self.tell_news(format!(
            "the session goes on from {time_s:.1} s; it stands still until you let time pass"
        ));
        Ok(())
    }

    /// Whether it goes on from a moment of a session: then it stands still at first.
    pub(crate) fn is_resumed(&self) -> bool {
        self.is_resumed
    }
}
