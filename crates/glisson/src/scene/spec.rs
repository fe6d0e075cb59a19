//! What a scene file says.

use super::reader::{SceneError, Section, parse_toml};
use crate::math::{Aabb, DVec3};
use crate::model::kind::ModelKind;
use crate::tool::{Tool, ToolInput};
use crate::units::Dimension;
use crate::world::spec::{FixedRegion, WorldSpec};
use std::path::PathBuf;

/// Where an organ's elasticity comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialSource {
    /// A row of the table of tissues.
    Tissue(String),
    /// Numbers of the scene.
    Given {
        /// Young's modulus [Pa].
        young_modulus_pa: f64,
        /// Poisson's ratio.
        poisson_ratio: f64,
        /// Density [kg/m3].
        density_kg_per_m3: f64,
    },
}

/// Where an organ comes from and what moves it.
#[derive(Clone, Debug, PartialEq)]
pub struct OrganSource {
    /// Tetrahedral mesh, relative to the scene's folder.
    pub mesh: PathBuf,
    /// Elasticity and density.
    pub material: MaterialSource,
    /// Which model moves it.
    pub model: ModelKind,
    /// A saved pre-computation, relative to the scene's folder; made anew at set-up when absent.
    pub precomputed: Option<PathBuf>,
    /// Damping in proportion to mass [1/s]; dynamic models only.
    pub damping_per_s: f64,
}

/// One point of a scripted tool motion; between points the tip moves in straight lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathPoint {
    /// When the tool is there [s].
    pub time_s: f64,
    /// Where it is.
    pub tool: ToolInput,
}

/// A scene as its file says.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The world without its mesh and model.
    pub world: WorldSpec,
    /// The organ.
    pub organ: OrganSource,
    /// Scripted motion of the tool, ascending in time; empty when somebody holds it.
    pub path: Vec<PathPoint>,
    /// The file's text, for the session.
    pub text: String,
}

/// The only version of scene files so far.
const SCENE_VERSION: f64 = 1.0;

impl Scene {
    /// Reads a scene.
    ///
    /// # Errors
    /// [`SceneError`] with the line of the first mistake.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        let document = parse_toml(text)?;
        let mut root = Section::root(text, &document);
        match root.number("glisson_scene")? {
            Some((version, _)) if version == SCENE_VERSION => {}
            Some((version, at)) => {
                return Err(root.wrong_value(at, "glisson_scene", version.to_string(), "1"));
            }
            None => return Err(root.missing("glisson_scene", "glisson_scene = 1")),
        }
        let name = root.string("name")?.map_or_else(|| "unnamed scene".to_string(), |n| n.0);
        let simulation = root.section("simulation")?;
        let organ = root.section("organ")?.ok_or_else(|| root.missing("organ", "[organ]"))?;
        let tool = root.section("tool")?.ok_or_else(|| root.missing("tool", "[tool]"))?;
        root.finish()?;

        let time_step_s = read_simulation(simulation)?;
        let (organ, fixed) = read_organ(organ)?;
        let (tool, path) = read_tool(tool)?;
        let world = WorldSpec { name, time_step_s, fixed, tool };
        Ok(Self { world, organ, path, text: text.to_string() })
    }
}

/// One step a millisecond, the rate of force feedback.
const DEFAULT_TIME_STEP_S: f64 = 1e-3;

fn read_simulation(section: Option<Section<'_>>) -> Result<f64, SceneError> {
    let Some(mut section) = section else { return Ok(DEFAULT_TIME_STEP_S) };
    let time_step_s = section.positive("time_step", Dimension::Time)?;
    section.finish()?;
    Ok(time_step_s.unwrap_or(DEFAULT_TIME_STEP_S))
}

fn read_organ(mut section: Section<'_>) -> Result<(OrganSource, Vec<FixedRegion>), SceneError> {
    let mesh = section.string("mesh")?.ok_or_else(|| section.missing("mesh", "mesh = \"liver.vtu\""))?;
    let material = read_material(&mut section)?;
    let names = ModelKind::ALL.map(ModelKind::name).join(", ");
    let (model_name, at) =
        section.string("model")?.ok_or_else(|| section.missing("model", "model = \"precomputed\""))?;
    let model = ModelKind::by_name(&model_name)
        .ok_or_else(|| section.wrong_value(at, "model", format!("\"{model_name}\""), &names))?;
    let precomputed = section.string("precomputed")?.map(|p| PathBuf::from(p.0));
    let damping = section.quantity("damping", Dimension::Rate)?;
    if let Some((damping_per_s, at)) = damping
        && damping_per_s < 0.0
    {
        return Err(section.wrong_value(at, "damping", format!("{damping_per_s} 1/s"), "zero or more"));
    }
    let fixed = section.sections("fixed")?.into_iter().map(read_fixed).collect::<Result<Vec<_>, _>>()?;
    section.finish()?;
    let damping_per_s = damping.map_or(0.0, |d| d.0);
    Ok((OrganSource { mesh: mesh.0.into(), material, model, precomputed, damping_per_s }, fixed))
}

fn read_material(section: &mut Section<'_>) -> Result<MaterialSource, SceneError> {
    let tissue = section.string("tissue")?;
    let young = section.positive("young_modulus", Dimension::Pressure)?;
    let poisson = section.number("poisson_ratio")?;
    let lame_lambda = section.quantity("lame_lambda", Dimension::Pressure)?;
    let lame_mu = section.positive("lame_mu", Dimension::Pressure)?;
    let density = section.positive("density", Dimension::Density)?;
    let given =
        [young.is_some(), poisson.is_some(), lame_lambda.is_some(), lame_mu.is_some(), density.is_some()];
    if let Some((name, at)) = tissue {
        if given.contains(&true) {
            let allowed = "a tissue alone, or young_modulus, poisson_ratio and density without a tissue";
            return Err(section.wrong_value(
                at,
                "tissue",
                format!("\"{name}\" beside its own numbers"),
                allowed,
            ));
        }
        return Ok(MaterialSource::Tissue(name));
    }
    if lame_lambda.is_none() && lame_mu.is_some() {
        return Err(section.missing("lame_lambda", "lame_lambda = \"12.5 kPa\""));
    }
    if let Some((lambda_pa, at)) = lame_lambda {
        let mu_pa = lame_mu.ok_or_else(|| section.missing("lame_mu", "lame_mu = \"2 kPa\""))?;
        if young.is_some() || poisson.is_some() {
            let allowed = "lame_lambda and lame_mu, or young_modulus and poisson_ratio";
            return Err(section.wrong_value(
                at,
                "lame_lambda",
                "beside young_modulus or poisson_ratio".into(),
                allowed,
            ));
        }
        // Positive energy for every strain (LinearElastic::from_lame).
        if 3.0 * lambda_pa + 2.0 * mu_pa <= 0.0 {
            let allowed = "more than -2/3 of lame_mu";
            return Err(section.wrong_value(at, "lame_lambda", format!("{lambda_pa} Pa"), allowed));
        }
        let density_kg_per_m3 =
            density.ok_or_else(|| section.missing("density", "density = \"1060 kg/m3\""))?;
        return Ok(MaterialSource::Given {
            young_modulus_pa: mu_pa * (3.0 * lambda_pa + 2.0 * mu_pa) / (lambda_pa + mu_pa),
            poisson_ratio: lambda_pa / (2.0 * (lambda_pa + mu_pa)),
            density_kg_per_m3,
        });
    }
    let young_modulus_pa = young.ok_or_else(|| {
        section.missing("young_modulus", "young_modulus = \"5 kPa\" (or tissue = \"liver\")")
    })?;
    let (poisson_ratio, at) =
        poisson.ok_or_else(|| section.missing("poisson_ratio", "poisson_ratio = 0.45"))?;
    if !(poisson_ratio > -1.0 && poisson_ratio < 0.5) {
        let allowed = "more than -1 and less than 0.5 (a tissue that keeps its volume: 0.45 to 0.49)";
        return Err(section.wrong_value(at, "poisson_ratio", poisson_ratio.to_string(), allowed));
    }
    let density_kg_per_m3 = density.ok_or_else(|| section.missing("density", "density = \"1060 kg/m3\""))?;
    Ok(MaterialSource::Given { young_modulus_pa, poisson_ratio, density_kg_per_m3 })
}

fn read_fixed(mut section: Section<'_>) -> Result<FixedRegion, SceneError> {
    let bounds = section.section("box")?;
    let ball = section.section("ball")?;
    let furthest = section.section("furthest")?;
    let region = match (bounds, ball, furthest) {
        (Some(mut bounds), None, None) => {
            let min_m = required_point(&mut bounds, "min", "min = [\"-5 mm\", \"-5 mm\", \"0 mm\"]")?;
            let max_m = required_point(&mut bounds, "max", "max = [\"5 mm\", \"5 mm\", \"9 mm\"]")?;
            bounds.finish()?;
            FixedRegion::Box(Aabb { min_m, max_m })
        }
        (None, Some(mut ball), None) => {
            let center_m = required_point(&mut ball, "center", "center = [\"0 mm\", \"0 mm\", \"9 mm\"]")?;
            let radius_m = ball
                .positive("radius", Dimension::Length)?
                .ok_or_else(|| ball.missing("radius", "radius = \"20 mm\""))?;
            ball.finish()?;
            FixedRegion::Ball { center_m, radius_m }
        }
        (None, None, Some(mut furthest)) => {
            let direction = furthest
                .direction("direction")?
                .ok_or_else(|| furthest.missing("direction", "direction = [0, 0, -1]"))?;
            let (fraction, at) = furthest
                .number("fraction")?
                .ok_or_else(|| furthest.missing("fraction", "fraction = 0.05"))?;
            if !(fraction > 0.0 && fraction < 1.0) {
                return Err(furthest.wrong_value(at, "fraction", fraction.to_string(), "between 0 and 1"));
            }
            furthest.finish()?;
            FixedRegion::Furthest { direction, fraction }
        }
        _ => {
            let example = "exactly one of box = { min, max }, ball = { center, radius }, furthest = { direction, fraction }";
            return Err(section.missing("box, ball or furthest", example));
        }
    };
    section.finish()?;
    Ok(region)
}

fn required_point(
    section: &mut Section<'_>,
    key: &'static str,
    example: &'static str,
) -> Result<DVec3, SceneError> {
    section.point(key)?.ok_or_else(|| section.missing(key, example))
}

/// A 5 mm laparoscopic instrument, the common small size of trocars.
const DEFAULT_SHAFT_RADIUS_M: f64 = 2.5e-3;
const DEFAULT_SHAFT_LENGTH_M: f64 = 0.3;

fn read_tool(mut section: Section<'_>) -> Result<(Tool, Vec<PathPoint>), SceneError> {
    let name = section.string("name")?.map_or_else(|| "probe".to_string(), |n| n.0);
    let tip_radius_m = section
        .positive("tip_radius", Dimension::Length)?
        .ok_or_else(|| section.missing("tip_radius", "tip_radius = \"5 mm\""))?;
    let shaft_radius_m =
        section.positive("shaft_radius", Dimension::Length)?.unwrap_or(DEFAULT_SHAFT_RADIUS_M);
    let shaft_length_m =
        section.positive("shaft_length", Dimension::Length)?.unwrap_or(DEFAULT_SHAFT_LENGTH_M);
    let tip_in_world_m =
        required_point(&mut section, "home_tip", "home_tip = [\"0 mm\", \"-150 mm\", \"0 mm\"]")?;
    let shaft_in_world = section
        .direction("home_shaft")?
        .ok_or_else(|| section.missing("home_shaft", "home_shaft = [0, -1, 0.3]"))?;
    let home = ToolInput { tip_in_world_m, shaft_in_world };
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
        let tip_in_world_m = required_point(&mut point, "tip", "tip = [\"0 mm\", \"-90 mm\", \"0 mm\"]")?;
        let before = path.last().map_or(home, |p| p.tool);
        let shaft_in_world = point.direction("shaft")?.unwrap_or(before.shaft_in_world);
        point.finish()?;
        path.push(PathPoint { time_s, tool: ToolInput { tip_in_world_m, shaft_in_world } });
    }
    section.finish()?;
    Ok((Tool { name, tip_radius_m, shaft_radius_m, shaft_length_m, home }, path))
}

/// Where a scripted tool is at `time_s`: at home before the first point, at the last point after it.
pub fn tool_on_path(home: ToolInput, path: &[PathPoint], time_s: f64) -> ToolInput {
    let mut before = PathPoint { time_s: 0.0, tool: home };
    for point in path {
        if time_s < point.time_s {
            let t = (time_s - before.time_s) / (point.time_s - before.time_s);
            let (a, b) = (before.tool, point.tool);
            return ToolInput {
                tip_in_world_m: a.tip_in_world_m.lerp(b.tip_in_world_m, t),
                shaft_in_world: a.shaft_in_world.lerp(b.shaft_in_world, t).normalize_or(b.shaft_in_world),
            };
        }
        before = *point;
    }
    before.tool
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(super) const SCENE: &str = r#"glisson_scene = 1
name = "Palpation"

[simulation]
time_step = "1 ms"

[organ]
mesh = "liver.vtu"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1060 kg/m3"
model = "tensor_mass"
damping = "20 1/s"

[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.1 }

[[organ.fixed]]
box = { min = ["0 mm", "0 mm", "0 mm"], max = ["1 cm", "1 cm", "1 cm"] }

[tool]
tip_radius = "6 mm"
home_tip = ["0 mm", "-200 mm", "0 mm"]
home_shaft = [0, -2, 0]

[[tool.path]]
time = "1 s"
tip = ["0 mm", "-100 mm", "0 mm"]
"#;

    #[test]
    fn a_scene_is_read_into_si() {
        let scene = Scene::parse(SCENE).unwrap();
        assert_eq!(scene.world.time_step_s, 1e-3);
        assert_eq!(scene.organ.damping_per_s, 20.0);
        assert_eq!(scene.world.fixed.len(), 2);
        assert_eq!(scene.world.tool.tip_radius_m, 6.0 * 1e-3);
        assert_eq!(scene.world.tool.home.shaft_in_world, DVec3::new(0.0, -1.0, 0.0));
        let halfway = tool_on_path(scene.world.tool.home, &scene.path, 0.5);
        assert!((halfway.tip_in_world_m.y + 0.15).abs() < 1e-15);
        assert_eq!(tool_on_path(scene.world.tool.home, &scene.path, 9.0), scene.path[0].tool);
    }

    #[test]
    fn lame_numbers_stand_for_young_and_poisson() {
        let young = "young_modulus = \"5 kPa\"\npoisson_ratio = 0.45\n";
        let lame = "lame_lambda = \"12.5 kPa\"\nlame_mu = \"2 kPa\"\n";
        let scene = Scene::parse(&SCENE.replace(young, lame)).unwrap();
        let MaterialSource::Given { young_modulus_pa, poisson_ratio, .. } = scene.organ.material else {
            panic!("{:?}", scene.organ.material)
        };
        let law = crate::material::LinearElastic::from_lame(12.5e3, 2e3, 1060.0).unwrap();
        assert!((young_modulus_pa / law.young_modulus_pa() - 1.0).abs() < 1e-14);
        assert!((poisson_ratio / law.poisson_ratio() - 1.0).abs() < 1e-14);
        let both = Scene::parse(&SCENE.replace(young, &(young.to_string() + lame))).unwrap_err().to_string();
        assert!(both.contains("lame_lambda and lame_mu, or young_modulus and poisson_ratio"), "{both}");
        let half = Scene::parse(&SCENE.replace(young, "lame_lambda = \"1 kPa\"\n")).unwrap_err().to_string();
        assert!(half.contains("[organ] lacks \"lame_mu\""), "{half}");
        let mixed = Scene::parse(&SCENE.replace(young, &(young.to_string() + "lame_mu = \"2 kPa\"\n")));
        assert!(mixed.unwrap_err().to_string().contains("[organ] lacks \"lame_lambda\""));
    }

    #[test]
    fn mistakes_are_named_with_line_and_remedy() {
        let message = |from: &str, to: &str| {
            assert!(SCENE.contains(from), "{from}");
            Scene::parse(&SCENE.replacen(from, to, 1)).unwrap_err().to_string()
        };
        for (from, to, expected) in [
            ("poisson_ratio", "poison_ratio", "did you mean \"poisson_ratio\"?"),
            ("5 kPa", "5 kpa", "line 9: \"young_modulus\": \"kpa\" is not a unit of pressure"),
            ("\"5 kPa\"", "5", "line 9: \"young_modulus\": \"5\" has no unit"),
            ("0.45", "0.5", "line 10: \"poisson_ratio\" is 0.5; allowed: more than -1 and less than 0.5"),
            (
                "tensor_mass",
                "tensormass",
                "line 12: \"model\" is \"tensormass\"; allowed: precomputed, tensor_mass, st_venant_kirchhoff",
            ),
            ("mesh = \"liver.vtu\"\n", "", "[organ] lacks \"mesh\""),
            ("[0, -2, 0]", "[0, 0, 0]", "three numbers that are not all zero"),
            ("fraction = 0.1", "fraction = 7", "line 16: \"fraction\" is 7; allowed: between 0 and 1"),
            ("furthest = {", "furthest = [", "line 16: "),
            ("glisson_scene = 1", "glisson_scene = 2", "line 1: \"glisson_scene\" is 2; allowed: 1"),
            ("[simulation]\ntime_step", "[simulation]\ntimestep", "did you mean \"time_step\"?"),
            ("time_step = \"1 ms\"", "time_step = \"-1 ms\"", "more than zero"),
        ] {
            let found = message(from, to);
            assert!(found.contains(expected), "{to}: {found}");
        }
        let no_poisson = message("poisson_ratio = 0.45\n", "");
        assert!(no_poisson.starts_with("line 7: [organ] lacks \"poisson_ratio\""), "{no_poisson}");
    }

    proptest! {
        #[test]
        fn mutated_scenes_are_read_or_refused(at in 0..SCENE.len(), byte in any::<u8>(), cut in 0..SCENE.len()) {
            let mut bytes = SCENE.as_bytes().to_vec();
            bytes[at] = byte;
            bytes.truncate(SCENE.len() - cut / 4);
            let _ = Scene::parse(&String::from_utf8_lossy(&bytes));
        }
    }
}
