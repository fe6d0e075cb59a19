//! `[tool]` or `[[tool]]`: the instruments and their scripted motion.

use super::bodies::{BodySource, SceneBody};
use super::organ::OrganSource;
use super::reader::{SceneError, Section};
use super::suture::read_size;
use super::when_cut::RefusedCuts;
use crate::math::DVec3;
use crate::suture::material::SIZES;
use crate::tool::ligating_loop::LigatingLoop;
use crate::tool::{
    Blade, BladeCuts, Burnt, CutRule, Grip, INSTRUMENTS, JawUse, Jaws, MAX_TOOLS, Optics, Snip, Tool,
    ToolInput, ToolKind, ToolParts, ToolShape, instrument_names,
};
use crate::units::Dimension;
use std::path::PathBuf;

/// One point of a scripted tool motion; between points the tip moves in straight lines, the rest in proportion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// When the tool is there [s].
    pub time_s: f64,
    /// Where it is.
    pub tool: ToolInput,
    /// Whether it sets a clip there on the vessel nearest to its tip.
    pub sets_clip: bool,
}

/// An instrument as its table says.
pub(super) struct InstrumentSource {
    pub(super) tool: Tool,
    pub(super) path: Vec<PathPoint>,
    /// A surface file in place of the ball at the tip.
    pub(super) shape: Option<PathBuf>,
    /// Whether its table says how its edges cut.
    says_cuts: bool,
}

/// A 5 mm laparoscopic instrument, the common small size of trocars.
const DEFAULT_SHAFT_RADIUS_M: f64 = 2.5e-3;
const DEFAULT_SHAFT_LENGTH_M: f64 = 0.3;

/// Jaws, blade and energy of an instrument whose table does not say otherwise: choices of the size of 5 mm laparoscopic
/// instruments.
const DEFAULT_JAWS: Jaws =
    Jaws { length_m: 0.02, width_m: 5e-3, greatest_opening_rad: 1.0, closing_force_n: 5.0 };
const DEFAULT_BLADE: Blade = Blade { length_m: 0.02, edge_radius_m: 0.0, cuts: BladeCuts::Subdivision };
const DEFAULT_SNIP: Snip = Snip::Tetrahedra;
const DEFAULT_CUT: CutRule =
    CutRule { least_force_n: 0.05, least_time_s: 0.05, power_w: 0.0, takes: Burnt::Tetrahedra };
/// How much larger than the tip what it sweeps away is: a choice.
const DEFAULT_BURN_DEPTH_M: f64 = 5e-4;

/// The loop of a ligating loop whose table does not say: choices, and the thread of size 2-0.
const DEFAULT_LOOP: LigatingLoop =
    LigatingLoop { diameter_m: 0.03, thread_m: SIZES[0].diameter_m, greatest_pull_n: 2.0 };

/// The lens of an endoscope whose table does not say: choices, and between what they may be [rad].
const DEFAULT_OPTICS: Optics =
    Optics { view_angle_rad: 30.0 * DEGREE_RAD, field_of_view_rad: 70.0 * DEGREE_RAD };
const VIEW_ANGLES_DEG: [f64; 2] = [0.0, 90.0];
const FIELDS_OF_VIEW_DEG: [f64; 2] = [20.0, 120.0];
const DEGREE_RAD: f64 = std::f64::consts::PI / 180.0;
const ANGLE_ROUNDING_DEG: f64 = 1e-9;

/// How blades cut, as scenes write it, and scissors.
const BLADE_CUTS: [(&str, BladeCuts); 3] = [
    ("embedded", BladeCuts::Embedded),
    ("subdivision", BladeCuts::Subdivision),
    ("displacement", BladeCuts::Displacement),
];
const SNIPS: [(&str, Snip); 3] =
    [("embedded", Snip::Embedded), ("subdivision", Snip::Subdivision), (WHOLE_TETRAHEDRA, Snip::Tetrahedra)];

/// How scenes write that an instrument takes whole tetrahedra.
const WHOLE_TETRAHEDRA: &str = "tetrahedra";

/// Friction of tissue on an instrument whose table does not say otherwise: a choice.
const DEFAULT_FRICTION: f64 = 0.3;

/// The tables of a scene's instruments.
pub(super) fn tool_sections<'a>(root: &mut Section<'a>) -> Result<Vec<Section<'a>>, SceneError> {
    let sections = if root.is_table("tool") {
        root.section("tool")?.into_iter().collect()
    } else {
        root.sections("tool")?
    };
    match sections.get(MAX_TOOLS) {
        None if sections.is_empty() => Err(root.missing("tool", "[tool]")),
        None => Ok(sections),
        Some(one_too_many) => {
            let found = format!("{} instruments", sections.len());
            Err(one_too_many.wrong_table("tool", found, format!("1 to {MAX_TOOLS}")))
        }
    }
}

/// What ways to cut the instruments of a scene may have.
pub(super) struct CutRules {
    /// That of the blades read so far.
    known: Option<BladeCuts>,
    /// Whether cuts are embedded, as far as instruments read so far say.
    embeds: Option<bool>,
    /// That of blades whose table does not say.
    default: BladeCuts,
    /// Whether scissors whose table does not say part tissue along their edges, and edges are sharp instead of as blunt as the tip.
    all_cuts_part: bool,
    /// Whether nodes move after cuts, which embedded ones cannot follow.
    mends_cuts: bool,
    /// What no organ of the scene follows.
    refused: Option<RefusedCuts>,
}

/// Whether what an instrument cuts is embedded, if it cuts in a way that can be.
pub(super) fn embeds(kind: &ToolKind) -> Option<bool> {
    match (kind.edge_cuts(), kind.burning()) {
        (Some(cuts), _) => Some(cuts == BladeCuts::Embedded),
        (_, Some(CutRule { takes: Burnt::Swept { .. }, .. })) => Some(true),
        _ => None,
    }
}

impl CutRules {
    /// With how blades cut whose table does not say, and whether scissors part tissue then and what no organ follows is refused.
    pub(super) fn of(
        organ: &OrganSource,
        bodies: &[SceneBody],
        (default, all_cuts_part): (BladeCuts, bool),
    ) -> Self {
        let of_bodies = || {
            bodies.iter().filter_map(|body| match &body.source {
                BodySource::Organ(organ, _) => Some(&**organ),
                BodySource::Rigid(_) => None,
            })
        };
        let organs = || std::iter::once(organ).chain(of_bodies());
        let mends = organs().any(|organ| organ.mends_cuts);
        let default = if mends { BladeCuts::Subdivision } else { default };
        let is_alone = bodies.is_empty();
        let refused_by = |organ: &OrganSource| RefusedCuts::of(organ.model, organ.when_cut, is_alone);
        let by_each: Option<Vec<_>> = organs().map(refused_by).collect();
        // What one organ follows is followed.
        let refused = by_each
            .filter(|_| all_cuts_part)
            .and_then(|by_each| by_each.into_iter().max_by_key(|refused| refused.takes_tetrahedra));
        Self { known: None, embeds: None, default, all_cuts_part, mends_cuts: mends, refused }
    }

    /// Notes what the table of an instrument says.
    pub(super) fn learn(&mut self, source: &InstrumentSource) {
        let kind = &source.tool.kind;
        if source.says_cuts || kind.burning().is_some() {
            self.known = self.known.or(kind.edge_cuts());
            self.embeds = self.embeds.or(embeds(kind));
        }
    }

    /// When all tables are read: edges whose table does not say cut as the others do.
    pub(super) fn complete(&self, source: &mut InstrumentSource) {
        if !source.says_cuts {
            source.tool.kind = source.tool.kind.cutting(self.unsaid(), self.unsaid_snip());
        }
    }

    /// The way to cut of an edge whose table does not say.
    fn unsaid(&self) -> BladeCuts {
        self.known.unwrap_or(self.default)
    }

    /// What scissors do whose table does not say.
    fn unsaid_snip(&self) -> Snip {
        if self.all_cuts_part { Snip::beside(self.unsaid()) } else { Snip::Tetrahedra }
    }

    fn check(&self, is_embedded: bool, others: &str) -> Result<(), String> {
        if is_embedded && self.mends_cuts {
            return Err(format!("{others} with mend_cuts, which moves nodes"));
        }
        if self.embeds.is_some_and(|embeds| embeds != is_embedded) {
            return Err(format!(
                "embedded cuts (blade_cuts = \"embedded\", burns = \"swept\") for all instruments of the scene or for none; for none: {others}"
            ));
        }
        Ok(())
    }
}

pub(super) fn read_tool(mut section: Section<'_>, cuts: &CutRules) -> Result<InstrumentSource, SceneError> {
    let tip_radius_m = section.positive("tip_radius", Dimension::Length)?;
    let says_cuts = section.has("blade_cuts");
    let (kind, sticks) = read_kind(&mut section, cuts, tip_radius_m)?;
    let name = section.string("name")?.map_or_else(|| kind.name().to_string(), |n| n.0);
    let tip_radius_m = tip_radius_m.ok_or_else(|| section.missing("tip_radius", "tip_radius = \"5 mm\""))?;
    let shaft_radius_m =
        section.positive("shaft_radius", Dimension::Length)?.unwrap_or(DEFAULT_SHAFT_RADIUS_M);
    let shaft_length_m =
        section.positive("shaft_length", Dimension::Length)?.unwrap_or(DEFAULT_SHAFT_LENGTH_M);
    let shape = section.string("shape")?.map(|s| PathBuf::from(s.0));
    let friction = section.number("friction")?;
    if let Some((coefficient, at)) = friction
        && coefficient < 0.0
    {
        let allowed = "a coefficient of friction, 0 or more";
        return Err(section.wrong_value(at, "friction", coefficient.to_string(), allowed));
    }
    // A probe sticks unless the scene knows how it slides.
    let sticks = friction.is_none() && sticks;
    let grip = Grip {
        friction_coefficient: friction.map_or(DEFAULT_FRICTION, |(coefficient, _)| coefficient),
        is_sticky: section.flag("sticky")?.unwrap_or(sticks),
    };
    let trocar_m = section.point("trocar")?;
    let tip_in_world_m =
        section.required_point("home_tip", "home_tip = [\"0 mm\", \"-150 mm\", \"0 mm\"]")?;
    let to_trocar = trocar_m.and_then(|trocar_m| (trocar_m - tip_in_world_m).try_normalize());
    let shaft_in_world = section
        .direction("home_shaft")?
        .or(to_trocar)
        .ok_or_else(|| section.missing("home_shaft", "home_shaft = [0, -1, 0.3]"))?;
    // A lever that rinses is let go, a loop is open.
    let jaw_opening = if kind.rinses() || kind.ligating_loop().is_some() { 1.0 } else { 0.0 };
    let at_rest = ToolInput { jaw_opening, ..ToolInput::at(tip_in_world_m, shaft_in_world) };
    let home = read_hand(&mut section, ["home_roll", "home_jaw"], at_rest)?;
    let home = home.through(trocar_m);
    let path = read_path(&mut section, home, trocar_m)?;
    section.finish()?;
    let tool = Tool {
        name,
        kind,
        tip_radius_m,
        shaft_radius_m,
        shaft_length_m,
        shape: ToolShape::Capsules,
        grip,
        trocar_m,
        home,
    };
    Ok(InstrumentSource { tool, path, shape, says_cuts })
}

/// The kind of an instrument, and whether tissue sticks to such unless the scene knows how it slides.
fn read_kind(
    section: &mut Section<'_>,
    cuts: &CutRules,
    tip_radius_m: Option<f64>,
) -> Result<(ToolKind, bool), SceneError> {
    let Some((name, at)) = section.string("kind")? else { return Ok((ToolKind::PROBE, true)) };
    let Some(kind) = INSTRUMENTS.iter().find(|kind| kind.name == name) else {
        let allowed = instrument_names().collect::<Vec<_>>().join(", ");
        return Err(section.wrong_value(at, "kind", format!("\"{name}\""), &allowed));
    };
    if let Some(refused) = cuts.refused.as_ref().filter(|refused| refused.meets(kind)) {
        return Err(section.wrong_value(at, "kind", format!("\"{name}\""), &refused.allowed));
    }
    // Keys of parts that the kind does not have are unknown.
    let jaws = if kind.jaws.is_some() { read_jaws(section)? } else { DEFAULT_JAWS };
    let blade_of = |section| read_blade(section, cuts, tip_radius_m.unwrap_or_default());
    let blade = if kind.has_blade { blade_of(section)? } else { DEFAULT_BLADE };
    let burning = if kind.burns { read_cut(section, cuts)? } else { DEFAULT_CUT };
    let snip = if kind.jaws == Some(JawUse::Part) { read_snip(section, cuts)? } else { DEFAULT_SNIP };
    let optics = if kind.has_optics { read_optics(section)? } else { DEFAULT_OPTICS };
    let ligating_loop = if kind.has_loop { read_loop(section)? } else { DEFAULT_LOOP };
    let parts = ToolParts { jaws, blade, burning, snip, optics, ligating_loop };
    Ok((ToolKind::of(kind, &parts), kind.sticks))
}

fn read_loop(section: &mut Section<'_>) -> Result<LigatingLoop, SceneError> {
    let d = DEFAULT_LOOP;
    Ok(LigatingLoop {
        diameter_m: section.positive("loop_diameter", Dimension::Length)?.unwrap_or(d.diameter_m),
        thread_m: read_size(section)?.map_or(d.thread_m, |size| size.diameter_m),
        greatest_pull_n: section.positive("pull", Dimension::Force)?.unwrap_or(d.greatest_pull_n),
    })
}

fn read_blade(section: &mut Section<'_>, rules: &CutRules, tip_radius_m: f64) -> Result<Blade, SceneError> {
    let length_m = section.positive("blade_length", Dimension::Length)?.unwrap_or(DEFAULT_BLADE.length_m);
    let named = read_edge_cuts(section, &BLADE_CUTS, |cuts: BladeCuts| {
        rules.check(cuts == BladeCuts::Embedded, "subdivision or displacement")
    })?;
    let edge_radius_m = match section.quantity("edge_radius", Dimension::Length)? {
        Some((radius_m, at)) if radius_m < 0.0 => {
            return Err(section.wrong_value(at, "edge_radius", format!("{radius_m} m"), "zero or more"));
        }
        Some((radius_m, _)) => radius_m,
        None if rules.all_cuts_part => DEFAULT_BLADE.edge_radius_m,
        None => tip_radius_m,
    };
    Ok(Blade { length_m, edge_radius_m, cuts: named.unwrap_or_else(|| rules.unsaid()) })
}

/// What scissors do with what they close on.
fn read_snip(section: &mut Section<'_>, rules: &CutRules) -> Result<Snip, SceneError> {
    let named = read_edge_cuts(section, &SNIPS, |snip: Snip| match snip.edge_cuts() {
        Some(cuts) => rules.check(cuts == BladeCuts::Embedded, "subdivision or tetrahedra"),
        None => Ok(()),
    })?;
    Ok(named.unwrap_or_else(|| rules.unsaid_snip()))
}

/// How edges cut, one of some `ways`, as their table says it.
fn read_edge_cuts<W: Copy>(
    section: &mut Section<'_>,
    ways: &[(&str, W)],
    check: impl FnOnce(W) -> Result<(), String>,
) -> Result<Option<W>, SceneError> {
    let Some((name, at)) = section.string("blade_cuts")? else { return Ok(None) };
    let named = ways.iter().find(|(known, _)| *known == name).map(|(_, way)| *way);
    let allowed = || ways.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
    match named.ok_or_else(allowed).and_then(|way| check(way).map(|()| way)) {
        Ok(way) => Ok(Some(way)),
        Err(allowed) => Err(section.wrong_value(at, "blade_cuts", format!("\"{name}\""), &allowed)),
    }
}

fn read_jaws(section: &mut Section<'_>) -> Result<Jaws, SceneError> {
    let d = DEFAULT_JAWS;
    Ok(Jaws {
        length_m: section.positive("jaw_length", Dimension::Length)?.unwrap_or(d.length_m),
        width_m: section.positive("jaw_width", Dimension::Length)?.unwrap_or(d.width_m),
        greatest_opening_rad: section
            .positive("jaw_angle", Dimension::Angle)?
            .unwrap_or(d.greatest_opening_rad),
        closing_force_n: section.positive("closing_force", Dimension::Force)?.unwrap_or(d.closing_force_n),
    })
}

fn read_optics(section: &mut Section<'_>) -> Result<Optics, SceneError> {
    let mut between = |key, [least, most]: [f64; 2], default_rad| {
        let Some((angle_rad, at)) = section.quantity(key, Dimension::Angle)? else { return Ok(default_rad) };
        let degrees = angle_rad / DEGREE_RAD;
        // A bound that is written in degrees is allowed, whatever rounding makes of it.
        if (least - ANGLE_ROUNDING_DEG..=most + ANGLE_ROUNDING_DEG).contains(&degrees) {
            return Ok(angle_rad);
        }
        let allowed = format!("{least} to {most} deg");
        Err(section.wrong_value(at, key, format!("{degrees:.3} deg"), &allowed))
    };
    let d = DEFAULT_OPTICS;
    Ok(Optics {
        view_angle_rad: between("view_angle", VIEW_ANGLES_DEG, d.view_angle_rad)?,
        field_of_view_rad: between("field_of_view", FIELDS_OF_VIEW_DEG, d.field_of_view_rad)?,
    })
}

fn read_cut(section: &mut Section<'_>, cuts: &CutRules) -> Result<CutRule, SceneError> {
    let d = DEFAULT_CUT;
    let is_swept = match section.string("burns")? {
        None => false,
        Some((way, at)) => {
            let known = match way.as_str() {
                "swept" => cuts.check(true, "tetrahedra").map(|()| true),
                WHOLE_TETRAHEDRA => Ok(false),
                _ => Err("tetrahedra, swept".into()),
            };
            known.map_err(|allowed| section.wrong_value(at, "burns", format!("\"{way}\""), &allowed))?
        }
    };
    let takes = if is_swept {
        let depth_m = section.positive("burn_depth", Dimension::Length)?.unwrap_or(DEFAULT_BURN_DEPTH_M);
        Burnt::Swept { depth_m }
    } else {
        d.takes
    };
    Ok(CutRule {
        least_force_n: section.positive("cut_force", Dimension::Force)?.unwrap_or(d.least_force_n),
        least_time_s: section.positive("cut_time", Dimension::Time)?.unwrap_or(d.least_time_s),
        power_w: section.positive("power", Dimension::Power)?.unwrap_or(d.power_w),
        takes,
    })
}

/// Roll and jaws of a pose, as before where the table does not say.
fn read_hand(
    section: &mut Section<'_>,
    [roll, jaw]: [&'static str; 2],
    before: ToolInput,
) -> Result<ToolInput, SceneError> {
    let roll_rad = section.quantity(roll, Dimension::Angle)?.map_or(before.roll_rad, |(roll, _)| roll);
    let jaw_opening = share(section, jaw)?.unwrap_or(before.jaw_opening);
    Ok(ToolInput { roll_rad, jaw_opening, ..before })
}

fn share(section: &mut Section<'_>, key: &'static str) -> Result<Option<f64>, SceneError> {
    let Some((share, at)) = section.number(key)? else { return Ok(None) };
    if (0.0..=1.0).contains(&share) {
        return Ok(Some(share));
    }
    Err(section.wrong_value(at, key, share.to_string(), "between 0 and 1"))
}

fn read_path(
    section: &mut Section<'_>,
    home: ToolInput,
    trocar_m: Option<DVec3>,
) -> Result<Vec<PathPoint>, SceneError> {
    let mut path: Vec<PathPoint> = Vec::new();
    for mut point in section.sections("path")? {
        let (time_s, at) = point
            .quantity("time", Dimension::Time)?
            .ok_or_else(|| point.missing("time", "time = \"0.5 s\""))?;
        if time_s < path.last().map_or(0.0, |p| p.time_s) {
            return Err(point.wrong_value(
                at,
                "time",
                format!("{time_s} s"),
                "times that only go up, from 0",
            ));
        }
        let tip_in_world_m = point.required_point("tip", "tip = [\"0 mm\", \"-90 mm\", \"0 mm\"]")?;
        let before = path.last().map_or(home, |p| p.tool);
        let shaft_in_world = point.direction("shaft")?.unwrap_or(before.shaft_in_world);
        let pose = ToolInput { tip_in_world_m, shaft_in_world, ..before };
        let pose = read_hand(&mut point, ["roll", "jaw"], pose)?;
        let trigger = share(&mut point, "trigger")?.unwrap_or(before.trigger);
        let sets_clip = point.flag("clip")?.unwrap_or(false);
        point.finish()?;
        path.push(PathPoint { time_s, tool: ToolInput { trigger, ..pose }.through(trocar_m), sets_clip });
    }
    Ok(path)
}

/// Where a scripted tool is at `time_s`: at home before the first point, at the last point after it.
pub fn tool_on_path(home: ToolInput, path: &[PathPoint], time_s: f64) -> ToolInput {
    let mut before = PathPoint { time_s: 0.0, tool: home, sets_clip: false };
    for point in path {
        if time_s < point.time_s {
            let t = (time_s - before.time_s) / (point.time_s - before.time_s);
            return before.tool.towards(&point.tool, t);
        }
        before = *point;
    }
    before.tool
}
