//! Groups of people that others are compared with. Users make them; there is none at the beginning.

use crate::error::StoreError;
use crate::name::checked_name;
use crate::store::Store;
use rusqlite::OptionalExtension;

/// A group and who is in it, by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Its name.
    pub name: String,
    /// Who is in it.
    pub people: Vec<String>,
}

impl Store {
    /// Takes people into a group, which is made where there is none of that name. Who is in it already stays.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] for somebody without results here: nobody is taken in then.
    pub fn add_to_group(&mut self, group: &str, people: &[String]) -> Result<(), StoreError> {
        let group = checked_name(group)?;
        let ids = people.iter().map(|person| self.person_id(person)).collect::<Result<Vec<i64>, _>>()?;
        self.write(|transaction| {
            transaction
                .execute("INSERT INTO reference_group (name) VALUES (?1) ON CONFLICT DO NOTHING", [&group])?;
            let add = "INSERT INTO member (reference_group, person) \
                       SELECT id, ?2 FROM reference_group WHERE name = ?1 ON CONFLICT DO NOTHING";
            let mut add = transaction.prepare(add)?;
            ids.iter().try_for_each(|person| add.execute((&group, person)).map(|_| ()))
        })
    }

    /// Takes people out of a group; the group itself where none are given.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] for a group or a member that is not there: nobody is taken out then.
    pub fn remove_from_group(&mut self, group: &str, people: &[String]) -> Result<(), StoreError> {
        let members = self.members(group)?;
        let members: Vec<&str> = members.iter().map(String::as_str).collect();
        if let Some(other) = people.iter().find(|person| !members.contains(&person.as_str())) {
            return Err(self.unknown("member of that group", format!("\"{other}\""), &members));
        }
        self.write(|transaction| {
            if people.is_empty() {
                transaction.execute("DELETE FROM reference_group WHERE name = ?1", [group])?;
            }
            let remove = "DELETE FROM member WHERE reference_group = (SELECT id FROM reference_group WHERE name = ?1) \
                          AND person = (SELECT id FROM person WHERE name = ?2)";
            let mut remove = transaction.prepare(remove)?;
            people.iter().try_for_each(|person| remove.execute((group, person)).map(|_| ()))
        })
    }

    /// Who is in a group.
    ///
    /// # Errors
    /// [`StoreError::Unknown`] where there is no such group.
    pub fn members(&self, group: &str) -> Result<Vec<String>, StoreError> {
        self.require("group", "SELECT name FROM reference_group ORDER BY name", group)?;
        let sql = "SELECT person.name FROM member JOIN person ON person.id = member.person \
                   JOIN reference_group ON reference_group.id = member.reference_group \
                   WHERE reference_group.name = ?1 ORDER BY person.name";
        self.list(sql, [group], |row| row.get(0))
    }

    /// All groups, by name.
    ///
    /// # Errors
    /// What the file does not allow.
    pub fn groups(&self) -> Result<Vec<Group>, StoreError> {
        let names: Vec<String> =
            self.list("SELECT name FROM reference_group ORDER BY name", [], |row| row.get(0))?;
        names.into_iter().map(|name| Ok(Group { people: self.members(&name)?, name })).collect()
    }

    /// The result by which each member of a group stands for it in the task of a scene: the last one that was passed, so that
    /// who tried often does not count more, and who was fast and not safe not at all. Without `but`.
    pub(crate) fn reference_results(
        &self,
        group: &str,
        scene_hash: &str,
        but: &str,
    ) -> Result<Vec<i64>, StoreError> {
        let last = "SELECT result.id FROM result JOIN person ON person.id = result.person \
                    WHERE person.name = ?1 AND scene_hash = ?2 AND is_passed ORDER BY finished_at DESC, result.id DESC LIMIT 1";
        let mut results = Vec::new();
        for member in self.members(group)?.iter().filter(|member| *member != but) {
            let found =
                self.connection.query_row(last, [member.as_str(), scene_hash], |row| row.get::<_, i64>(0));
            results.extend(found.optional().map_err(|cause| self.failed(cause))?);
        }
        Ok(results)
    }
}
