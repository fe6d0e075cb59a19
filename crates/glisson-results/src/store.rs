//! The store: a SQLite file.
//!
//! It has a rollback journal, not a write-ahead log: a result is written once in some minutes, and such a log needs memory that
//! all who use the file share, so that it does not work on a network drive (sqlite.org/wal.html). On a network drive the file
//! is as safe as the locks of that drive.

use crate::attempt::{Attempt, AttemptResult, Kept};
use crate::error::StoreError;
use crate::schema;
use crate::settings::BUSY_S;
use glisson::text::did_you_mean;
use glisson::training::task::Outcome;
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, Transaction, TransactionBehavior, params};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Results of people, in a file.
#[derive(Debug)]
pub struct Store {
    pub(crate) connection: Connection,
    pub(crate) file: PathBuf,
}

/// What came of storing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Added {
    /// It has this number now.
    New(i64),
    /// It was there already, under this number.
    There(i64),
}

impl Added {
    /// The result's number.
    pub fn id(self) -> i64 {
        let (Self::New(id) | Self::There(id)) = self;
        id
    }
}

/// Which results are asked for; all where nothing is given.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// Of this person.
    pub person: Option<String>,
    /// At this task.
    pub task: Option<String>,
    /// At this level.
    pub level: Option<String>,
    /// Of this synthetic patient.
    pub patient: Option<u32>,
}

/// A result in the store.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredResult {
    /// Its number.
    pub id: i64,
    /// Who did it.
    pub person: String,
    /// The whole of it.
    pub kept: Kept,
    /// What is read of it.
    pub result: AttemptResult,
    /// How long it took [s].
    pub duration_s: Option<f64>,
}

/// A person in the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Person {
    /// Name or pseudonym.
    pub name: String,
    /// Results.
    pub n_results: usize,
    /// Groups that the person is in.
    pub groups: Vec<String>,
}

impl Store {
    /// The store in a file, which is made where there is none; its folder has to be there.
    ///
    /// # Errors
    /// [`StoreError`] with the file and what to do.
    pub fn open(file: &Path) -> Result<Self, StoreError> {
        Self::open_with(file, OpenFlags::SQLITE_OPEN_CREATE)
    }

    /// The store in a file that is there.
    ///
    /// # Errors
    /// As [`Store::open`], and [`StoreError::NotThere`].
    pub fn open_existing(file: &Path) -> Result<Self, StoreError> {
        if !file.exists() {
            return Err(StoreError::NotThere { file: file.into() });
        }
        Self::open_with(file, OpenFlags::empty())
    }

    fn open_with(file: &Path, more: OpenFlags) -> Result<Self, StoreError> {
        let failed = |cause| StoreError::of(cause, file);
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX | more;
        let mut connection = Connection::open_with_flags(file, flags).map_err(failed)?;
        connection.busy_timeout(Duration::from_secs(BUSY_S)).map_err(failed)?;
        connection.pragma_update(None, "foreign_keys", true).map_err(failed)?;
        // What is deleted is overwritten: a person who is forgotten is not found in the file's free pages.
        connection.pragma_update(None, "secure_delete", true).map_err(failed)?;
        schema::prepare(&mut connection, file)?;
        Ok(Self { connection, file: file.into() })
    }

    /// That a result could be stored now.
    ///
    /// # Errors
    /// [`StoreError::ReadOnly`], [`StoreError::Locked`].
    pub fn check_writable(&mut self) -> Result<(), StoreError> {
        // A transaction on a file that may only be read would begin as one that reads.
        if self.connection.is_readonly("main").map_err(|cause| self.failed(cause))? {
            return Err(StoreError::ReadOnly { file: self.file.clone() });
        }
        self.write(|_| Ok(()))
    }

    /// Where it is.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Gives up when somebody else writes for so long, instead of ten seconds.
    ///
    /// # Errors
    /// What SQLite says.
    pub fn set_patience(&self, patience: Duration) -> Result<(), StoreError> {
        self.connection.busy_timeout(patience).map_err(|cause| self.failed(cause))
    }

    pub(crate) fn failed(&self, cause: rusqlite::Error) -> StoreError {
        StoreError::of(cause, &self.file)
    }

    /// Writes all or nothing.
    pub(crate) fn write<T>(
        &mut self,
        write: impl FnOnce(&Transaction<'_>) -> rusqlite::Result<T>,
    ) -> Result<T, StoreError> {
        let file = &self.file;
        let failed = |cause| StoreError::of(cause, file);
        // Immediate: who would write after reading cannot find that somebody else has written in between.
        let transaction =
            self.connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failed)?;
        let written = write(&transaction).map_err(failed)?;
        transaction.commit().map_err(failed)?;
        Ok(written)
    }

    /// Stores an attempt, once: the same of the same person, time and session is found again.
    ///
    /// # Errors
    /// [`StoreError::Kept`] where a field is wrong; otherwise what the file does not allow. Nothing is stored then.
    pub fn add(&mut self, kept: &Kept) -> Result<Added, StoreError> {
        let all = self.add_all(std::slice::from_ref(kept))?;
        Ok(all.into_iter().next().expect("one for each"))
    }

    /// The same of several, all or none.
    ///
    /// # Errors
    /// As [`Store::add`].
    pub fn add_all(&mut self, all: &[Kept]) -> Result<Vec<Added>, StoreError> {
        let read: Vec<_> = all.iter().map(Kept::checked).collect::<Result<_, _>>()?;
        self.write(|transaction| {
            all.iter().zip(&read).map(|(kept, read)| insert(transaction, kept, read)).collect()
        })
    }

    /// Results in the order of time.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where there is no such person, task or level.
    pub fn results(&self, filter: &Filter) -> Result<Vec<StoredResult>, StoreError> {
        if let Some(person) = &filter.person {
            self.person_id(person)?;
        }
        if let Some(task) = &filter.task {
            self.require("task", "SELECT DISTINCT task FROM result ORDER BY task", task)?;
        }
        if let Some(level) = &filter.level {
            let levels = "SELECT DISTINCT level FROM result WHERE level IS NOT NULL ORDER BY level";
            self.require("level", levels, level)?;
        }
        let chosen = "WHERE (?1 IS NULL OR person.name = ?1) AND (?2 IS NULL OR task = ?2) AND (?3 IS NULL OR level = ?3) \
             AND (?4 IS NULL OR seed = ?4) ORDER BY finished_at, result.id";
        self.select(chosen, params![filter.person, filter.task, filter.level, filter.patient])
    }

    /// A result by its number.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where there is none.
    pub fn result(&self, id: i64) -> Result<StoredResult, StoreError> {
        self.select("WHERE result.id = ?1", [id])?
            .pop()
            .ok_or_else(|| self.unknown("result", id.to_string(), &[]))
    }

    /// All attempts of a person at the task of a scene, in the order of time.
    ///
    /// # Errors
    /// What the file does not allow.
    pub fn attempts(&self, person: &str, scene_hash: &str) -> Result<Vec<StoredResult>, StoreError> {
        let chosen = "WHERE person.name = ?1 AND scene_hash = ?2 ORDER BY finished_at, result.id";
        self.select(chosen, [person, scene_hash])
    }

    fn select(&self, chosen: &str, values: impl rusqlite::Params) -> Result<Vec<StoredResult>, StoreError> {
        let sql = format!(
            "SELECT result.id, person.name, task, scene_hash, finished_at, seed, level, session, result.result, duration_s \
             FROM result JOIN person ON person.id = result.person {chosen}"
        );
        let rows =
            self.list(&sql, values, |row| Ok((row.get(0)?, attempt(row)?, row.get(8)?, row.get(9)?)))?;
        let stored = |(id, attempt, text, duration_s): (i64, Attempt, String, Option<f64>)| {
            let damaged = |cause: serde_json::Error| StoreError::Damaged {
                file: self.file.clone(),
                cause: format!("the result {id} is not that of a task: {cause}"),
            };
            let whole: serde_json::Value = serde_json::from_str(&text).map_err(damaged)?;
            let result = AttemptResult::deserialize(&whole).map_err(damaged)?;
            let person = attempt.person.clone().unwrap_or_default();
            Ok(StoredResult { id, person, kept: Kept { attempt, result: whole }, result, duration_s })
        };
        rows.into_iter().map(stored).collect()
    }

    /// Everybody, by name.
    ///
    /// # Errors
    /// What the file does not allow.
    pub fn people(&self) -> Result<Vec<Person>, StoreError> {
        let sql = "SELECT name, (SELECT count(*) FROM result WHERE result.person = person.id) FROM person ORDER BY name";
        let rows: Vec<(String, i64)> = self.list(sql, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
        let of = "SELECT reference_group.name FROM member JOIN reference_group ON reference_group.id = member.reference_group \
                  JOIN person ON person.id = member.person WHERE person.name = ?1 ORDER BY 1";
        let person = |(name, n_results): (String, i64)| {
            let groups = self.list(of, [&name], |row| row.get(0))?;
            Ok(Person { groups, n_results: usize::try_from(n_results).unwrap_or(0), name })
        };
        rows.into_iter().map(person).collect()
    }

    /// Takes a result out.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where there is none.
    pub fn delete(&mut self, id: i64) -> Result<(), StoreError> {
        match self.write(|transaction| transaction.execute("DELETE FROM result WHERE id = ?1", [id]))? {
            0 => Err(self.unknown("result", id.to_string(), &[])),
            _ => Ok(()),
        }
    }

    /// Takes a person out, with all results and memberships. Recorded sessions are files of their own and stay.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where there is nobody of that name.
    pub fn forget(&mut self, person: &str) -> Result<(), StoreError> {
        let id = self.person_id(person)?;
        self.write(|transaction| transaction.execute("DELETE FROM person WHERE id = ?1", [id])).map(|_| ())
    }

    /// The number of a person.
    pub(crate) fn person_id(&self, name: &str) -> Result<i64, StoreError> {
        self.require("person", "SELECT name FROM person ORDER BY name", name)?;
        let found =
            self.connection.query_row("SELECT id FROM person WHERE name = ?1", [name], |row| row.get(0));
        found.map_err(|cause| self.failed(cause))
    }

    /// That `name` is one of those that `sql` answers.
    pub(crate) fn require(&self, what: &'static str, sql: &str, name: &str) -> Result<(), StoreError> {
        let known: Vec<String> = self.list(sql, [], |row| row.get(0))?;
        if known.iter().any(|known| known == name) {
            return Ok(());
        }
        let known: Vec<&str> = known.iter().map(String::as_str).collect();
        Err(self.unknown(what, format!("\"{name}\""), &known))
    }

    pub(crate) fn unknown(&self, what: &'static str, name: String, known: &[&str]) -> StoreError {
        let mut suggestion = did_you_mean(name.trim_matches('"'), known);
        if suggestion.is_empty() && !known.is_empty() {
            suggestion = format!("; there are: {}", known.join(", "));
        }
        StoreError::Unknown { file: self.file.clone(), what, name, suggestion }
    }

    /// One value a row.
    pub(crate) fn list<T>(
        &self,
        sql: &str,
        values: impl rusqlite::Params,
        read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, StoreError> {
        let list = || self.connection.prepare(sql)?.query_map(values, read)?.collect();
        let found: rusqlite::Result<Vec<T>> = list();
        found.map_err(|cause| self.failed(cause))
    }
}

fn outcome_name(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Done => "done",
        Outcome::TimeOver => "time_over",
    }
}

/// Of a row of [`Store::select`].
fn attempt(row: &Row<'_>) -> rusqlite::Result<Attempt> {
    Ok(Attempt {
        person: row.get(1)?,
        task: row.get(2)?,
        scene_hash: row.get(3)?,
        finished_at: row.get(4)?,
        seed: row.get(5)?,
        level: row.get(6)?,
        session: row.get(7)?,
    })
}

/// Stores what was checked, once.
fn insert(
    transaction: &Transaction<'_>,
    kept: &Kept,
    (person, read): &(String, AttemptResult),
) -> rusqlite::Result<Added> {
    let text = kept.result.to_string();
    let Attempt { task, scene_hash, finished_at, seed, level, session, .. } = &kept.attempt;
    let outcome = read.outcome.map(outcome_name);
    let duration_s = read.metric("time", None).and_then(|metric| metric.value);
    transaction.execute("INSERT INTO person (name) VALUES (?1) ON CONFLICT DO NOTHING", [person])?;
    let person: i64 =
        transaction.query_row("SELECT id FROM person WHERE name = ?1", [person], |row| row.get(0))?;
    let same = "SELECT id FROM result WHERE person = ?1 AND scene_hash = ?2 AND finished_at = ?3 AND session IS ?4 AND result = ?5";
    let same_as = params![person, scene_hash, finished_at, session, text];
    let found = transaction.query_row(same, same_as, |row| row.get(0));
    if let Some(id) = found.optional()? {
        return Ok(Added::There(id));
    }
    let insert = "INSERT INTO result (person, task, title, scene_hash, finished_at, seed, level, is_passed, outcome, \
                  duration_s, session, result) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12)";
    transaction.execute(
        insert,
        params![
            person,
            task,
            read.title,
            scene_hash,
            finished_at,
            seed,
            level,
            read.is_passed,
            outcome,
            duration_s,
            session,
            text
        ],
    )?;
    let id = transaction.last_insert_rowid();
    let mut insert = transaction
        .prepare("INSERT INTO metric (result, name, tool, value, unit) VALUES (?1, ?2, ?3, ?4, ?5)")?;
    for metric in &read.metrics {
        // What is no number stays in the text alone.
        if let Some(value) = metric.value.filter(|value| value.is_finite()) {
            let tool = metric.tool.as_deref().unwrap_or_default();
            insert.execute(params![id, metric.name, tool, value, metric.unit])?;
        }
    }
    Ok(Added::New(id))
}

#[cfg(test)]
mod tests;
