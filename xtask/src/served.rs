//! A running `glisson`, and what it says.

use crate::finished_within;
use anyhow::{Context, bail, ensure};
use std::cell::Cell;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// How long one that was interrupted may take to end: recordings are completed.
const ENDING: Duration = Duration::from_secs(5);

/// Ended when dropped.
pub(crate) struct Served {
    process: Child,
    lines: Receiver<String>,
    is_interrupted: Cell<bool>,
}

impl Served {
    /// Starts it; what it says is shown after `name`.
    pub(crate) fn start(command: &mut Command, name: &str) -> anyhow::Result<Self> {
        let mut process = command
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {}", command.get_program().to_string_lossy()))?;
        let out = process.stdout.take().expect("its output is piped");
        let (send, lines) = channel();
        let name = name.to_owned();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                println!("  {name}: {line}");
                // Its output is read to the end, also when nobody waits for it any more.
                let _ = send.send(line);
            }
        });
        Ok(Self { process, lines, is_interrupted: Cell::new(false) })
    }

    /// `glisson serve` on a free port, without a browser.
    pub(crate) fn serve(program: &Path, scene: &Path, options: &[&str]) -> anyhow::Result<Self> {
        let mut command = Command::new(program);
        command.args(["serve", "--port", "0", "--no-open"]).arg(scene).args(options);
        Self::start(command.current_dir(crate::root()), "serve")
    }

    /// `glisson patient` on a free port, which writes into `out`.
    pub(crate) fn patient(program: &Path, out: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(program);
        command.args(["patient", "--port", "0", "--no-open", "--out"]).arg(out);
        Self::start(command.current_dir(crate::root()), "patient")
    }

    /// Waits for a line with `text`; answers it.
    pub(crate) fn says(&self, text: &str, patience: Duration) -> anyhow::Result<String> {
        let end = Instant::now() + patience;
        loop {
            match self.lines.recv_timeout(end.saturating_duration_since(Instant::now())) {
                Ok(line) if line.contains(text) => return Ok(line),
                Ok(_) => {}
                Err(RecvTimeoutError::Disconnected) => bail!("it ended before it said {text:?}"),
                Err(RecvTimeoutError::Timeout) => {
                    bail!("it did not say {text:?} within {} s", patience.as_secs())
                }
            }
        }
    }

    /// Waits for a line with `text`; answers what follows that up to the next space.
    pub(crate) fn says_after(&self, text: &str, patience: Duration) -> anyhow::Result<String> {
        let line = self.says(text, patience)?;
        let rest = line.split_once(text).map_or("", |(_, rest)| rest);
        Ok(rest.split_whitespace().next().unwrap_or_default().to_owned())
    }

    /// As Ctrl-C does.
    pub(crate) fn interrupt(&self) -> anyhow::Result<()> {
        let id = self.process.id().to_string();
        let status = Command::new("kill").args(["-INT", &id]).status().context("cannot start kill")?;
        ensure!(status.success(), "kill -INT {id} failed");
        self.is_interrupted.set(true);
        Ok(())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let patience = if self.is_interrupted.get() { ENDING } else { Duration::ZERO };
        if !matches!(finished_within(patience, &mut self.process), Ok(Some(_))) {
            // It may have ended by itself.
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn one_that_ends_early_is_told_at_once_and_one_that_says_it_is_heard() {
        let start = Instant::now();
        let mut command = Command::new("sh");
        let served = Served::start(command.args(["-c", "echo it is at 127.0.0.1:7 now"]), "sh").unwrap();
        let patience = Duration::from_secs(60);
        assert_eq!(served.says_after("it is at ", patience).unwrap(), "127.0.0.1:7");
        let error = served.says("ready", patience).unwrap_err().to_string();
        assert_eq!(error, "it ended before it said \"ready\"");
        assert!(start.elapsed() < Duration::from_secs(30));
        let mut command = Command::new("sh");
        let served = Served::start(command.args(["-c", "exec sleep 30"]), "sh").unwrap();
        let error = served.says("ready", Duration::from_millis(50)).unwrap_err().to_string();
        assert!(error.contains("within"), "{error}");
    }
}
