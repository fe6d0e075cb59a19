//! The tables (docs/results.md), and how a file comes to have them.

use crate::error::StoreError;
use crate::settings::{APPLICATION_ID, SCHEMA_VERSION};
use rusqlite::{Connection, Transaction, TransactionBehavior};
use std::path::Path;

/// Numbers of results are never given twice (AUTOINCREMENT), so that who deletes one does not mean another. A person's results
/// and memberships go with the person, a result's metrics with the result.
const TABLES: &str = "
CREATE TABLE person (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;
CREATE TABLE result (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    person INTEGER NOT NULL REFERENCES person (id) ON DELETE CASCADE,
    task TEXT NOT NULL,
    title TEXT NOT NULL,
    scene_hash TEXT NOT NULL,
    finished_at TEXT NOT NULL,
    seed INTEGER,
    level TEXT,
    is_passed INTEGER NOT NULL CHECK (is_passed IN (0, 1)),
    outcome TEXT CHECK (outcome IN ('done', 'time_over')),
    duration_s REAL,
    session TEXT,
    result TEXT NOT NULL
) STRICT;
CREATE INDEX result_by_person ON result (person, scene_hash, finished_at);
CREATE INDEX result_by_scene ON result (scene_hash);
CREATE TABLE metric (
    result INTEGER NOT NULL REFERENCES result (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    tool TEXT NOT NULL,
    value REAL NOT NULL,
    unit TEXT NOT NULL,
    PRIMARY KEY (result, name, tool)
) STRICT, WITHOUT ROWID;
CREATE TABLE reference_group (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;
CREATE TABLE member (
    reference_group INTEGER NOT NULL REFERENCES reference_group (id) ON DELETE CASCADE,
    person INTEGER NOT NULL REFERENCES person (id) ON DELETE CASCADE,
    PRIMARY KEY (reference_group, person)
) STRICT, WITHOUT ROWID;
";

/// What a file is before anything is done with it.
struct Found {
    application: i64,
    version: i64,
    n_tables: i64,
}

/// Within a transaction: three readings on their own could see the file before and after somebody else makes the tables.
fn look(transaction: &Transaction<'_>) -> rusqlite::Result<Found> {
    let number = |sql| transaction.query_row(sql, [], |row| row.get(0));
    Ok(Found {
        application: number("PRAGMA application_id")?,
        version: number("PRAGMA user_version")?,
        n_tables: number("SELECT count(*) FROM sqlite_schema")?,
    })
}

/// Makes the tables in an empty file; refuses one of another program or of a later version.
pub(crate) fn prepare(connection: &mut Connection, file: &Path) -> Result<(), StoreError> {
    let failed = |cause| StoreError::of(cause, file);
    let is_ready = |found: &Found| -> Result<bool, StoreError> {
        let file = file.to_path_buf();
        match *found {
            Found { application: 0, version: 0, n_tables: 0 } => Ok(false),
            Found { application: APPLICATION_ID, version, .. } if version > SCHEMA_VERSION => {
                Err(StoreError::Newer { file, found: version })
            }
            Found { application: APPLICATION_ID, version: SCHEMA_VERSION, .. } => Ok(true),
            _ => Err(StoreError::Foreign { file, found: "a database of another program" }),
        }
    };
    let found = look(&connection.transaction().map_err(failed)?).map_err(failed)?;
    if is_ready(&found)? {
        return Ok(());
    }
    // Two programs may find it empty at once: who comes second finds the tables.
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failed)?;
    if !is_ready(&look(&transaction).map_err(failed)?)? {
        transaction.execute_batch(TABLES).map_err(failed)?;
        transaction.pragma_update(None, "application_id", APPLICATION_ID).map_err(failed)?;
        transaction.pragma_update(None, "user_version", SCHEMA_VERSION).map_err(failed)?;
    }
    transaction.commit().map_err(failed)
}
