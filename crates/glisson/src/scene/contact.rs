//! `[contact]`: whether the organ touches itself, and how.

use super::bodies::{BodySource, SceneBody};
use super::reader::{SceneError, Section};
use super::simulation::Simulation;
use crate::contact::response::persistent::BodyContactParams;
use crate::contact::response::self_contact::SelfContactParams;
use crate::math::DVec3;
use crate::model::kind::{MODELS, ModelKind};
use crate::units::Dimension;

/// None when the organ does not touch itself; what else the table says has to be right all the same.
pub(super) fn read_contact(
    mut section: Section<'_>,
    model: ModelKind,
    time_step_s: f64,
) -> Result<Option<SelfContactParams>, SceneError> {
    let touches_itself = section.flag("self")?.unwrap_or(false);
    let response = section.string("response")?;
    let name = response.as_ref().map_or("geometric", |r| r.0.as_str());
    let is_penalty = match (name, &response) {
        ("geometric", _) => false,
        ("penalty", _) => true,
        (_, Some((_, at))) => {
            let allowed = "geometric, penalty";
            return Err(section.wrong_value(at, "response", format!("\"{name}\""), allowed));
        }
        (_, None) => false,
    };
    // The geometric response corrects steps.
    if touches_itself && !is_penalty && !model.row().corrects_steps {
        let able = MODELS.iter().filter(|row| row.corrects_steps).map(|row| row.name);
        let names = able.collect::<Vec<_>>().join(", ");
        let allowed = format!(
            "\"penalty\" with the model \"{model}\" (a stiffness as well), or \"geometric\" with one of {names}"
        );
        return Err(section.wrong_table("response", format!("\"{name}\""), allowed));
    }
    let margin_m = section.positive("margin", Dimension::Length)?;
    let friction = match section.number("friction")? {
        Some((friction, at)) if friction < 0.0 => {
            return Err(section.wrong_value(at, "friction", friction.to_string(), "zero or more"));
        }
        found => found.map_or(SelfContactParams::DEFAULT_FRICTION, |f| f.0),
    };
    // Asked for with springs only: elsewhere it is an unknown key.
    let stiffness_n_per_m =
        if is_penalty { section.positive("stiffness", Dimension::Stiffness)? } else { None };
    let response = match (is_penalty, stiffness_n_per_m) {
        (false, _) => SelfContactParams::geometric(friction),
        (true, Some(stiffness_n_per_m)) => SelfContactParams::penalty(stiffness_n_per_m, friction),
        (true, None) => return Err(section.missing("stiffness", "stiffness = \"50 N/m\"")),
    };
    section.finish()?;
    let margin_m = margin_m.unwrap_or(SelfContactParams::default_margin_m(time_step_s));
    Ok(touches_itself.then_some(SelfContactParams { margin_m, response }))
}

/// What counts as touching in a shape that was imaged, when the scene does not say so: about the voxel of a CT. A choice.
const DEFAULT_TOUCH_M: f64 = 1e-3;

/// Between several bodies: on when nothing is said; none when `bodies = false`.
pub(super) fn read_body_contact(
    section: Option<Section<'_>>,
    bodies: &[SceneBody],
    simulation: &Simulation,
) -> Result<Option<BodyContactParams>, SceneError> {
    let is_imaged_organ = |body: &SceneBody| matches!(&body.source, BodySource::Organ(organ, _) if organ.is_imaged_under_gravity);
    let is_imaged = simulation.gravity_m_per_s2 != DVec3::ZERO && bodies.iter().any(is_imaged_organ);
    let mut params = BodyContactParams {
        margin_m: SelfContactParams::default_margin_m(simulation.time_step_s),
        friction: SelfContactParams::DEFAULT_FRICTION,
        touches_itself: false,
        touch_m: if is_imaged { DEFAULT_TOUCH_M } else { 0.0 },
    };
    let Some(mut section) = section else { return Ok(Some(params)) };
    let touch = section.flag("bodies")?.unwrap_or(true);
    params.touches_itself = section.flag("self")?.unwrap_or(false);
    if let Some((name, at)) = section.string("response")?
        && name != "geometric"
    {
        let allowed = "\"geometric\" between several bodies";
        return Err(section.wrong_value(at, "response", format!("\"{name}\""), allowed));
    }
    if let Some(margin_m) = section.positive("margin", Dimension::Length)? {
        params.margin_m = margin_m;
    }
    if let Some((touch_m, at)) = section.quantity("touch", Dimension::Length)? {
        if !(0.0..=params.margin_m).contains(&touch_m) {
            let allowed = format!("from 0 to the margin, {} m", params.margin_m);
            return Err(section.wrong_value(at, "touch", format!("{touch_m} m"), &allowed));
        }
        params.touch_m = touch_m;
    }
    match section.number("friction")? {
        Some((friction, at)) if friction < 0.0 => {
            return Err(section.wrong_value(at, "friction", friction.to_string(), "zero or more"));
        }
        found => params.friction = found.map_or(params.friction, |f| f.0),
    }
    section.finish()?;
    Ok(touch.then_some(params))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::response::self_contact::SelfContactResponse;
    use crate::scene::Scene;

    const SCENE: &str = r#"glisson_scene = 1

[organ]
mesh = "liver.vtu"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1060 kg/m3"
model = "implicit"

[contact]
self = true
response = "penalty"
margin = "1 mm"
friction = 0.3
stiffness = "20 N/m"

[tool]
tip_radius = "6 mm"
home_tip = ["0 mm", "-200 mm", "0 mm"]
home_shaft = [0, -2, 0]
"#;

    fn self_contact(text: &str) -> Option<SelfContactParams> {
        Scene::parse(text).unwrap().world.self_contact
    }

    #[test]
    fn an_organ_touches_itself_when_the_scene_says_so() {
        let found = self_contact(SCENE).unwrap();
        assert_eq!(found.margin_m, 1e-3);
        assert_eq!(found.response, SelfContactParams::penalty(20.0, 0.3));
        let keys = "response = \"penalty\"\nmargin = \"1 mm\"\nfriction = 0.3\nstiffness = \"20 N/m\"\n";
        let short = self_contact(&SCENE.replace(keys, "")).unwrap();
        assert_eq!(short.margin_m, 2e-3);
        let coarse =
            SCENE.replace("[organ]", "[simulation]\ntime_step = \"5 ms\"\n\n[organ]").replace(keys, "");
        assert_eq!(self_contact(&coarse).unwrap().margin_m, 5e-3);
        assert!(matches!(short.response, SelfContactResponse::Geometric(_)));
        assert_eq!(self_contact(&SCENE.replace("self = true", "self = false")), None);
        assert_eq!(self_contact(&SCENE.replace("[contact]\nself = true\n", "").replace(keys, "")), None);
    }

    #[test]
    fn mistakes_are_named_with_line_and_remedy() {
        for (from, to, expected) in [
            ("self = true", "self = \"yes\"", "line 11: \"self\" is a string; expected true or false"),
            ("self = true", "slef = true", "unknown key \"slef\" in [contact]"),
            ("\"penalty\"", "\"impulse\"", "\"response\" is \"impulse\"; allowed: geometric, penalty"),
            ("\"1 mm\"", "\"0 mm\"", "\"margin\" is 0 m; allowed: more than zero"),
            ("0.3", "-0.3", "\"friction\" is -0.3; allowed: zero or more"),
            ("stiffness = \"20 N/m\"\n", "", "[contact] lacks \"stiffness\""),
            ("\"penalty\"", "\"geometric\"", "unknown key \"stiffness\" in [contact]"),
        ] {
            assert!(SCENE.contains(from), "{from}");
            let found = Scene::parse(&SCENE.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(found.contains(expected), "{to}: {found}");
        }
        let hybrid = SCENE.replace("\"implicit\"", "\"hybrid\"");
        assert!(self_contact(&hybrid).is_some());
        let silent = hybrid.replace("response = \"penalty\"\n", "").replace("stiffness = \"20 N/m\"\n", "");
        let found = Scene::parse(&silent).unwrap_err().to_string();
        assert!(found.contains("\"penalty\" with the model \"hybrid\""), "{found}");
    }
}
