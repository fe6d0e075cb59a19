//! What can be wrong with a database of results: each tells the file, what was found, and what to do.

use crate::attempt::KeptError;
use crate::name::NameError;
use crate::settings::{BUSY_S, SCHEMA_VERSION};
use rusqlite::ErrorCode;
use std::path::{Path, PathBuf};

/// Why results cannot be stored or read.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is no file.
    #[error(
        "{}: there is no database of results yet; `glisson task run TASK --person NAME` makes one, or give another place with \
         --database FILE", file.display()
    )]
    NotThere {
        /// The database.
        file: PathBuf,
    },
    /// It can be neither opened nor made.
    #[error(
        "{}: the database cannot be opened or made; make its folder, get the right to write there, or give another place with \
         --database FILE", file.display()
    )]
    NotOpened {
        /// The database.
        file: PathBuf,
    },
    /// Some other file.
    #[error("{}: found {found}, which is no database of results; give another place with --database FILE", file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// What it is.
        found: &'static str,
    },
    /// Written by a later program.
    #[error(
        "{}: found a database of version {found}; this program knows versions up to {SCHEMA_VERSION}: use the newer program, \
         or give another place with --database FILE", file.display()
    )]
    Newer {
        /// The database.
        file: PathBuf,
        /// Its version.
        found: i64,
    },
    /// Another program has it.
    #[error(
        "{}: another program has the database locked, for more than {BUSY_S} s; try again when it is done", file.display()
    )]
    Locked {
        /// The database.
        file: PathBuf,
    },
    /// No room.
    #[error("{}: the disk is full; nothing of this result is in the database: make room and try again", file.display())]
    Full {
        /// The database.
        file: PathBuf,
    },
    /// May only be read.
    #[error(
        "{}: the database or its folder may only be read; get the right to write there, or give another place with \
         --database FILE", file.display()
    )]
    ReadOnly {
        /// The database.
        file: PathBuf,
    },
    /// What is in it is broken.
    #[error(
        "{}: the database is damaged ({cause}); keep a copy, and take a backup or `sqlite3 FILE .recover`", file.display()
    )]
    Damaged {
        /// The database.
        file: PathBuf,
        /// What is wrong.
        cause: String,
    },
    /// Something else.
    #[error("{}: {cause}", file.display())]
    Other {
        /// The database.
        file: PathBuf,
        /// What SQLite said.
        cause: rusqlite::Error,
    },
    /// An attempt cannot be kept.
    #[error(transparent)]
    Kept(#[from] KeptError),
    /// A name is none.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Nothing has that name or number.
    #[error("{}: there is no {what} {name}{suggestion}", file.display())]
    Unknown {
        /// The database.
        file: PathBuf,
        /// What was looked for.
        what: &'static str,
        /// Its name or number.
        name: String,
        /// What may have been meant.
        suggestion: String,
    },
}

impl StoreError {
    /// What SQLite's error means for a file.
    pub(crate) fn of(cause: rusqlite::Error, file: &Path) -> Self {
        let file = file.to_path_buf();
        match cause.sqlite_error_code() {
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => Self::Locked { file },
            Some(ErrorCode::DiskFull) => Self::Full { file },
            Some(ErrorCode::ReadOnly) => Self::ReadOnly { file },
            Some(ErrorCode::NotADatabase) => Self::Foreign { file, found: "a file of another kind" },
            Some(ErrorCode::CannotOpen) => Self::NotOpened { file },
            Some(ErrorCode::DatabaseCorrupt) => Self::Damaged { file, cause: cause.to_string() },
            _ => Self::Other { file, cause },
        }
    }
}
