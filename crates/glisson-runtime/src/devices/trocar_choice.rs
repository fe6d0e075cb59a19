//! How an active trocar is named on the command line, and where several of them stand.

use super::kind::{DeviceChoice, DeviceKind, DeviceName, Finding, OpenRequest, host_and_port};
use super::trocar_board::{
    BoardLine, BoardSettings, HandMotion, MOST_TROCARS, START_INSERTION_M, SimulatedLine, SoftWall,
    TrocarDevice, connect, simulated_line,
};
use super::{simulated, trocar_board};
use crate::open_device::OpenDevice;
use anyhow::{Context, anyhow, bail, ensure};
use glam::DQuat;
use glisson::haptics::trocar::placement::ArrangementError;
use glisson::haptics::trocar::{
    Arrangement, InstrumentTag, InstrumentType, Mapping, Placement, Saturation, TrocarProfile,
};
use glisson::math::DVec3;
use glisson::tool::Tool;
use std::sync::Arc;

/// The kind's row of the table.
pub(super) const KIND: DeviceKind = DeviceKind {
    name: "trocar",
    pattern: "trocar[:HOST:PORT][,KEY=VALUE ...]",
    about: "the active trocar behind its board; without an address a simulated one in a hand that pushes",
    parse: |rest| TrocarChoice::parse(rest).map(|choice| Arc::new(choice) as Arc<dyn DeviceChoice>),
    examine: Some(|address| {
        let not_looked_for =
            || Err(anyhow!("not looked for: --trocar HOST:PORT; `trocar` alone is simulated"));
        Finding::of("active trocar's board", address.map_or_else(not_looked_for, trocar_board::examine))
    }),
};

impl DeviceChoice for TrocarChoice {
    fn text(&self) -> String {
        self.description()
    }

    fn open(&self, request: &OpenRequest<'_>) -> anyhow::Result<OpenDevice> {
        let OpenRequest { home, tool_kind, stands, rate_hz } = *request;
        let outward = home.shaft_in_world.normalize();
        let deepest_m = self.profile().insertion_limit_m;
        let insertion_m = stands.map_or(START_INSERTION_M, |stands| {
            stands.pivot_in_world_m.distance(home.tip_in_world_m).min(deepest_m)
        });
        let device = Box::new(self.open_device(rate_hz, insertion_m, tool_kind)?);
        // Its axis at rest is the instrument's, into the body.
        let axes = stands.unwrap_or_else(|| Placement::facing(DVec3::ZERO, -outward)).world_from_device;
        let world_from_device = DQuat::from_mat3(&axes);
        Ok(OpenDevice { world_from_device, stands, ..OpenDevice::new(device, &self.description()) })
    }
}

/// An active trocar as the user names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TrocarChoice {
    /// Where its board listens, `host:port`; a simulated one for none.
    pub(crate) address: Option<String>,
    /// Name of its profile.
    profile: &'static str,
    mapping: Mapping,
    saturation: Saturation,
    /// Its number on the board's line, from 0.
    number: u8,
    /// Its place of the four that trocars can have beside each other, from 1.
    place: Option<u8>,
    /// What is in a simulated one; one that acts as the scene's instrument for none.
    inserted: Option<Inserted>,
}

/// What the user puts into a simulated trocar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Inserted {
    Nothing,
    Instrument(InstrumentType),
}

impl Default for TrocarChoice {
    fn default() -> Self {
        Self {
            address: None,
            profile: TrocarProfile::NAMES[0],
            mapping: Mapping::Thesis,
            saturation: Saturation::EachMotor,
            number: 0,
            place: None,
            inserted: None,
        }
    }
}

const MAPPINGS: [(&str, Mapping); 2] = [("thesis", Mapping::Thesis), ("virtual-work", Mapping::VirtualWork)];
const SATURATIONS: [(&str, Saturation); 2] =
    [("each-motor", Saturation::EachMotor), ("keep-direction", Saturation::KeepDirection)];
const KEYS: [&str; 6] = ["profile", "mapping", "saturation", "number", "place", "instrument"];
/// For lists and messages.
pub const OPTIONS: &str = "profile=built|specified, mapping=thesis|virtual-work, \
                                  saturation=each-motor|keep-direction, number=0..3, place=1..4; of a simulated one \
                                  instrument=none|palpation-probe|atraumatic-grasper|...";
/// A hand that holds a simulated trocar pushes as that of the simulated device does; how far it sways is a choice.
const MOTION: HandMotion =
    HandMotion { push_m: simulated::PUSH_M, sway_rad: 0.05, frequency_hz: simulated::PUSHES_HZ };
/// What a simulated follower meets: 5 mm before its tip, as soft as an organ under a probe. Choices.
const WALL_AHEAD_M: f64 = 0.005;
const WALL_N_PER_M: f64 = 300.0;

impl TrocarChoice {
    /// Reads what stands after `trocar`: `[:HOST:PORT][,KEY=VALUE ...]`.
    ///
    /// # Errors
    /// What is found and what is allowed.
    pub(super) fn parse(rest: &str) -> Result<Self, String> {
        let (address, options) = rest.split_once(',').map_or((rest, None), |(a, o)| (a, Some(o)));
        let address = match address.strip_prefix(':') {
            Some(address) => Some(host_and_port(address)?),
            None => None,
        };
        let mut choice = Self { address, ..Self::default() };
        let mut seen = Vec::new();
        for option in options.into_iter().flat_map(|options| options.split(',')) {
            let (key, value) = option
                .split_once('=')
                .ok_or_else(|| format!("\"{option}\" is not KEY=VALUE; trocar takes: {OPTIONS}"))?;
            if seen.contains(&key) {
                return Err(format!("\"{key}\" is given twice"));
            }
            choice.set(key, value)?;
            seen.push(key);
        }
        if choice.address.is_some() && choice.inserted.is_some() {
            return Err("instrument=... is for a simulated trocar; a board tells what is in it".into());
        }
        Ok(choice)
    }

    fn set(&mut self, key: &str, value: &str) -> Result<(), String> {
        match key {
            "profile" => self.profile = one_of(key, value, &TrocarProfile::NAMES.map(|name| (name, name)))?,
            "mapping" => self.mapping = one_of(key, value, &MAPPINGS)?,
            "saturation" => self.saturation = one_of(key, value, &SATURATIONS)?,
            "number" => self.number = number_in(key, value, 0, MOST_TROCARS - 1)?,
            "instrument" => self.inserted = Some(inserted_of(key, value)?),
            "place" => self.place = Some(number_in(key, value, 1, MOST_TROCARS)?),
            _ => {
                let hint = glisson::text::did_you_mean(key, &KEYS);
                return Err(format!("a trocar has no \"{key}\"{hint}; it takes: {OPTIONS}"));
            }
        }
        Ok(())
    }

    /// Its profile.
    pub(crate) fn profile(&self) -> TrocarProfile {
        TrocarProfile::of_name(self.profile).expect("names of profiles are checked when they are read")
    }

    fn settings(&self, loop_rate_hz: f64, tool_kind: Option<&'static str>) -> BoardSettings {
        let Self { mapping, saturation, number, .. } = *self;
        BoardSettings {
            mapping,
            saturation,
            trocar: number,
            loop_rate_hz,
            tool_kind,
            ..BoardSettings::new(self.profile())
        }
    }

    /// Whether both name the same trocar of the same board.
    pub(super) fn is_same_as(&self, other: &Self) -> bool {
        self.address.is_some() && (&self.address, self.number) == (&other.address, other.number)
    }

    /// For messages.
    pub(crate) fn description(&self) -> String {
        let mapping = MAPPINGS.iter().find(|(_, mapping)| *mapping == self.mapping).map_or("", |m| m.0);
        let saturation = SATURATIONS.iter().find(|(_, s)| *s == self.saturation).map_or("", |s| s.0);
        let where_it_is = self.address.as_ref().map(|address| format!(" at {address}")).unwrap_or_default();
        let simulated = if self.address.is_none() { "simulated " } else { "" };
        let number = if self.number > 0 { format!(", number {}", self.number) } else { String::new() };
        format!(
            "{simulated}active trocar{where_it_is} ({}{number}, mapping {mapping}, saturation {saturation})",
            self.profile
        )
    }

    /// Opens it for a loop of `loop_rate_hz` [Hz] and a scene's instrument of that kind; any for none. A simulated one has its
    /// instrument `insertion_m` [m] in, in a hand that pushes.
    ///
    /// # Errors
    /// When its board is not there or not what it should be, or the instrument in it does not act as the scene's.
    pub(super) fn open_device(
        &self,
        loop_rate_hz: f64,
        insertion_m: f64,
        tool_kind: Option<&'static str>,
    ) -> anyhow::Result<TrocarDevice<BoardLine>> {
        let settings = self.settings(loop_rate_hz, tool_kind);
        if let Some(address) = &self.address {
            return connect(address, settings);
        }
        let line = self.simulated_line(&settings, insertion_m).looked_at(loop_rate_hz).moved_by(MOTION);
        let mut device = TrocarDevice::new(BoardLine::Simulated(Box::new(line)), settings);
        device.hear()?;
        device.check_instrument().with_context(|| self.description())?;
        Ok(device)
    }

    /// Opens it to be driven by another device. A simulated one is in nobody's hand and before something soft.
    pub(super) fn open_follower(&self, loop_rate_hz: f64) -> anyhow::Result<TrocarDevice<BoardLine>> {
        if self.address.is_some() {
            return self.open_device(loop_rate_hz, START_INSERTION_M, None);
        }
        let settings = self.settings(loop_rate_hz, None);
        let wall = SoftWall { from_m: START_INSERTION_M + WALL_AHEAD_M, stiffness_n_per_m: WALL_N_PER_M };
        let line = self.simulated_line(&settings, START_INSERTION_M).looked_at(loop_rate_hz).before(wall);
        Ok(TrocarDevice::new(BoardLine::Simulated(Box::new(line)), settings))
    }

    /// A board in memory with what was asked for in it.
    fn simulated_line(&self, settings: &BoardSettings, insertion_m: f64) -> SimulatedLine {
        let mut line = simulated_line(settings, insertion_m, 1 + u64::from(self.number));
        match self.inserted {
            None => {}
            Some(Inserted::Nothing) => line.board.change_instrument(None),
            Some(Inserted::Instrument(instrument)) => {
                line.board.hold_instrument(InstrumentTag { instrument, serial: 1 });
            }
        }
        line
    }
}

/// Names of instruments on the command line have hyphens.
fn inserted_of(key: &str, value: &str) -> Result<Inserted, String> {
    let hyphened = |instrument: InstrumentType| instrument.name().replace(' ', "-");
    let found = InstrumentType::ALL.into_iter().find(|instrument| hyphened(*instrument) == value);
    match (value, found) {
        ("none", _) => Ok(Inserted::Nothing),
        (_, Some(instrument)) => Ok(Inserted::Instrument(instrument)),
        _ => {
            let names: Vec<String> =
                std::iter::once("none".to_owned()).chain(InstrumentType::ALL.map(hyphened)).collect();
            let known: Vec<&str> = names.iter().map(String::as_str).collect();
            let hint = glisson::text::did_you_mean(value, &known);
            Err(format!("{key}={value}{hint}; allowed: {}", names.join(", ")))
        }
    }
}

fn one_of<T: Copy>(key: &str, value: &str, known: &[(&str, T)]) -> Result<T, String> {
    let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
    known.iter().find(|(name, _)| *name == value).map(|(_, found)| *found).ok_or_else(|| {
        let hint = glisson::text::did_you_mean(value, &names);
        format!("{key}={value}{hint}; allowed: {}", names.join(", "))
    })
}

fn number_in(key: &str, value: &str, least: u8, most: u8) -> Result<u8, String> {
    let found = value.parse().ok().filter(|number| (least..=most).contains(number));
    found.ok_or_else(|| format!("{key}={value}; allowed: {least} to {most}"))
}

/// Where an instrument's own trocar is: the scene's, else as if the tip at its home were 100 mm in (a choice).
fn own_placement(instrument: &Tool) -> Placement {
    let outward = instrument.home.shaft_in_world.normalize();
    let pivot_m = instrument.trocar_m.unwrap_or(instrument.home.tip_in_world_m + outward * START_INSERTION_M);
    Placement::facing(pivot_m, -outward)
}

/// A place and the scene's point of the same instrument are the same up to this [m].
const SAME_PLACE_M: f64 = 1e-3;

/// A trocar that stands somewhere: number of its instrument, what was asked for, and where.
type Standing<'a> = (usize, &'a TrocarChoice, Placement);

/// Where the trocar at `place` (from 1) of a row stands that begins at `first`.
fn place_of(choice: &TrocarChoice, place: u8, first: Placement) -> anyhow::Result<Placement> {
    let four = Arrangement::adjacent(choice.profile(), first, MOST_TROCARS.into())?;
    Ok(four.placements()[usize::from(place) - 1])
}

/// Checks that a place of the row is the scene's trocar point of the instrument, where the scene gives one.
fn check_place(found: &Placement, place: u8, tool: usize, instrument: &Tool) -> anyhow::Result<()> {
    let off_m = instrument.trocar_m.map_or(0.0, |trocar_m| found.pivot_in_world_m.distance(trocar_m));
    ensure!(
        off_m <= SAME_PLACE_M,
        "place={place} of the trocar for instrument {tool} ({}) is {:.1} mm from its `trocar` in the scene: \
         leave the place out, or take `trocar` out of the scene",
        instrument.name,
        off_m * 1e3
    );
    Ok(())
}

/// Checks that the cradles of the widest trocar do not overlap.
fn check_distances(standing: &[Standing<'_>], instruments: &[Tool]) -> anyhow::Result<()> {
    if let Some((_, widest, _)) = standing
        .iter()
        .max_by(|a, b| a.1.profile().cradle_diameter_m.total_cmp(&b.1.profile().cradle_diameter_m))
    {
        let placements = standing.iter().map(|(_, _, placement)| *placement).collect();
        let checked = Arrangement::new(widest.profile(), placements);
        if let Err(error @ ArrangementError::TooNear { pair, .. }) = &checked {
            let [a, b] = pair.map(|i| {
                let tool = standing[i].0;
                format!("{tool} ({})", instruments[tool].name)
            });
            let what_to_do =
                "give them places (place=1 to place=4 stand side by side), or move `trocar` in the scene";
            bail!("the trocars of instruments {a} and {b}: {error}; {what_to_do}");
        }
        checked.context("active trocars")?;
    }
    Ok(())
}

/// Where the active trocars among `devices` (name and number of the instrument) stand, in the same order: in the scene's
/// trocar points, or in the places that were asked for, of which the first one is its instrument's own. None where neither is
/// given: the instrument's home is then where the device is at the start.
///
/// # Errors
/// For more than four, for cradles that overlap, for one that is named twice.
pub fn stand(
    devices: &[(&DeviceName, usize)],
    instruments: &[Tool],
) -> anyhow::Result<Vec<Option<Placement>>> {
    let mut stands = vec![None; devices.len()];
    let mut base: Option<Placement> = None;
    let mut standing: Vec<Standing<'_>> = Vec::new();
    for (i, (name, tool)) in devices.iter().enumerate() {
        let Some(choice) = name.as_choice::<TrocarChoice>() else { continue };
        let instrument = &instruments[*tool];
        let own = own_placement(instrument);
        let placement = match choice.place {
            None => own,
            Some(place) => {
                let at = |first| place_of(choice, place, first);
                let first = match base {
                    Some(first) => first,
                    None => {
                        let back_m = own.pivot_in_world_m - at(own)?.pivot_in_world_m;
                        Placement { pivot_in_world_m: own.pivot_in_world_m + back_m, ..own }
                    }
                };
                base = Some(first);
                let found = at(first)?;
                check_place(&found, place, *tool, instrument)?;
                found
            }
        };
        if let Some((_, other, _)) = standing.iter().find(|(_, other, _)| other.is_same_as(choice)) {
            bail!("{} is given twice: each trocar of a line has its own number=0..3", other.description());
        }
        if choice.place.is_some() || instrument.trocar_m.is_some() {
            stands[i] = Some(placement);
        }
        standing.push((*tool, choice, placement));
    }
    check_distances(&standing, instruments)?;
    Ok(stands)
}

#[cfg(test)]
#[path = "trocar_choice_tests.rs"]
mod tests;
