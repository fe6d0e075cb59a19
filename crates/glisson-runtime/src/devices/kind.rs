//! What a kind of device is to those who list, name, open and examine devices. Each kind's file has its own; the table
//! [`super::KINDS`] lists them.

use crate::open_device::OpenDevice;
use glisson::haptics::trocar::Placement;
use glisson::tool::ToolInput;
use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// One kind of device: a row of the table [`super::KINDS`].
#[derive(Clone, Copy)]
pub struct DeviceKind {
    /// How its names begin.
    pub name: &'static str,
    /// How it is named, with what may stand after its name.
    pub pattern: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Reads what stands after its name: nothing, or from the `:` or `,` on.
    pub(super) parse: ParseDevice,
    /// Looks for what it needs, for `glisson devices doctor`, at an address if the user gave one; opens no device.
    pub(super) examine: Option<fn(Option<&str>) -> Finding>,
}

/// Reads what stands after the name of a kind, or says in words what is wrong with it.
pub(super) type ParseDevice = fn(&str) -> Result<Arc<dyn DeviceChoice>, String>;

/// What a device is opened for.
#[derive(Clone, Copy, Debug)]
pub struct OpenRequest<'a> {
    /// Home of the instrument that it will hold.
    pub home: &'a ToolInput,
    /// Kind of that instrument in the scene; any for none.
    pub tool_kind: Option<&'static str>,
    /// Where an active trocar stands; none where its place at the start is to hold the instrument at its home.
    pub stands: Option<Placement>,
    /// Ticks a second.
    pub rate_hz: f64,
}

/// One device that a user may name: a kind with what stood after its name.
pub trait DeviceChoice: fmt::Debug + Send + Sync + Any {
    /// For messages.
    fn text(&self) -> String;

    /// Opens it.
    ///
    /// # Errors
    /// When it is not there, or the instrument in it is of another kind; with what to do.
    fn open(&self, request: &OpenRequest<'_>) -> anyhow::Result<OpenDevice>;
}

/// A device as the user names it.
#[derive(Clone)]
pub struct DeviceName {
    pub(super) kind: &'static DeviceKind,
    pub(super) choice: Arc<dyn DeviceChoice>,
}

impl DeviceName {
    /// Whether it is of the kind of this name.
    pub fn is(&self, kind: &str) -> bool {
        self.kind.name == kind
    }

    /// For messages.
    pub(crate) fn text(&self) -> String {
        self.choice.text()
    }

    /// The device where it is one of these.
    pub(super) fn as_choice<C: DeviceChoice>(&self) -> Option<&C> {
        let any: &dyn Any = &*self.choice;
        any.downcast_ref()
    }
}

/// Two names are alike when they name the same kind and all that stood after it means the same.
impl PartialEq for DeviceName {
    fn eq(&self, other: &Self) -> bool {
        self.is(other.kind.name) && format!("{:?}", self.choice) == format!("{:?}", other.choice)
    }
}

impl Eq for DeviceName {}

impl fmt::Debug for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {:?}", self.kind.name, self.choice)
    }
}

/// What stands after the `:`; none without one.
pub(super) fn after_colon(rest: &str) -> Option<&str> {
    rest.strip_prefix(':')
}

/// Refuses what stands after the name of a kind that takes nothing.
///
/// # Errors
/// In words, when there is something.
pub(super) fn nothing_after(kind: &str, rest: &str) -> Result<(), String> {
    if rest.is_empty() {
        return Ok(());
    }
    let found = after_colon(rest).unwrap_or(rest);
    Err(format!("\"{kind}\" takes nothing after it; found \"{found}\""))
}

/// Checks that a text is `HOST:PORT`.
///
/// # Errors
/// In words, when it is not.
pub fn host_and_port(text: &str) -> Result<String, String> {
    let is_sound = text
        .rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|p| p > 0));
    if is_sound { Ok(text.to_owned()) } else { Err(format!("\"{text}\" is not HOST:PORT")) }
}

/// What was found of a maker's library, service or board, for `glisson devices doctor`.
pub struct Finding {
    /// What was looked for.
    pub what: String,
    /// Whether it can be used.
    pub is_good: bool,
    /// What was found, or what to do.
    pub text: String,
}

impl Finding {
    /// Of an answer: what was found, or why it cannot be used.
    pub(super) fn of(what: &str, answer: anyhow::Result<String>) -> Self {
        Self {
            what: what.to_owned(),
            is_good: answer.is_ok(),
            text: answer.unwrap_or_else(|error| format!("{error:#}")),
        }
    }
}
