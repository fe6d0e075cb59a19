//! Instruments that a task names.

use super::super::reader::{SceneError, Section};
use crate::text::did_you_mean;
use crate::tool::Tool;

/// The instrument of a goal or an event, by its name; the only one when there is one.
pub(super) fn read_tool(table: &mut Section<'_>, tools: &[Tool]) -> Result<usize, SceneError> {
    match table.string("tool")? {
        None if tools.len() == 1 => Ok(0),
        None => Err(table.missing("tool", "tool = \"grasper\", the name of an instrument")),
        Some((name, at)) => tools.iter().position(|tool| tool.name == name).ok_or_else(|| {
            let names: Vec<&str> = tools.iter().map(|tool| tool.name.as_str()).collect();
            let allowed = format!("{}{}", names.join(", "), did_you_mean(&name, &names));
            table.wrong_value(at, "tool", format!("\"{name}\""), &allowed)
        }),
    }
}
