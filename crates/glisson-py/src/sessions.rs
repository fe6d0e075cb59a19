//! Recorded sessions.

use crate::errors::{SimulationError, guarded, of_simulation};
use glisson_runtime::replay;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// The folder that was given for a session's files, else its own.
fn folder_of(session: &Path, given: Option<PathBuf>) -> PathBuf {
    let beside = session.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    given.unwrap_or_else(|| beside.to_path_buf())
}

/// A recorded session as a page that plays it, as text; `glisson.notebook.player` shows it.
#[pyfunction]
#[pyo3(signature = (session, folder = None))]
pub(crate) fn _replay_page(py: Python<'_>, session: PathBuf, folder: Option<PathBuf>) -> PyResult<String> {
    let folder = folder_of(&session, folder);
    py.detach(|| guarded(|| glisson_cli::replay_page(&session, &folder)))
        .map_err(|error| of_simulation(&error))
}

/// Replays a recorded session with its scene's files in `folder` (its own, if not given), and answers the hash of the end.
///
/// Raises SimulationError where the bits are not those of the recording.
#[pyfunction]
#[pyo3(signature = (session, folder = None))]
pub(crate) fn replay_session(py: Python<'_>, session: PathBuf, folder: Option<PathBuf>) -> PyResult<String> {
    let folder = folder_of(&session, folder);
    let report = py
        .detach(|| replay::replay(&replay::read_session(&session)?, &folder, |_| Ok(())))
        .map_err(|error| of_simulation(&error))?;
    if let Some(step) = report.first_difference {
        let message =
            format!("the replay differs from the recording: first at the check-point of step {step}");
        return Err(SimulationError::new_err(message));
    }
    match report.recorded_hash {
        Some(recorded) if recorded != report.state_hash => {
            let message =
                format!("the replay ends with {}, the recording with {recorded}", report.state_hash);
            Err(SimulationError::new_err(message))
        }
        _ => Ok(report.state_hash.to_string()),
    }
}
