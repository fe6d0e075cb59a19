//! The bodies of a scene: `[organ]` alone, or `[[organ]]` and `[[rigid]]` together.

use super::organ::{OrganSource, OrganSurroundings, read_organ};
use super::reader::{SceneError, Section};
use super::rigid::{RigidSource, read_rigid};

/// One of several bodies, as its table says.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneBody {
    /// What the user calls it.
    pub name: String,
    /// sRGB colour.
    pub color: Option<[u8; 3]>,
    /// What it is.
    pub source: BodySource,
}

/// Where a body comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum BodySource {
    /// It deforms.
    Organ(Box<OrganSource>, Box<OrganSurroundings>),
    /// It does not.
    Rigid(RigidSource),
}

/// All tables of bodies.
pub(super) struct BodySections<'a> {
    organs: Vec<Section<'a>>,
    rigid: Vec<Section<'a>>,
}

/// All bodies, the organs first.
pub(super) struct SceneBodies {
    /// The first organ.
    pub(super) organ: OrganSource,
    /// What is around the only organ; empty when there are several bodies.
    pub(super) surroundings: OrganSurroundings,
    /// Several bodies; none for one organ.
    pub(super) bodies: Vec<SceneBody>,
}

/// Bodies of a scene at most: their numbers are told to viewers in seven bits.
pub(super) const MOST_BODIES: usize = 127;

impl<'a> BodySections<'a> {
    pub(super) fn of(root: &mut Section<'a>) -> Result<Self, SceneError> {
        let organs = if root.is_table("organ") {
            root.section("organ")?.into_iter().collect()
        } else {
            root.sections("organ")?
        };
        if organs.is_empty() {
            return Err(root.missing("organ", "[organ]"));
        }
        let rigid = root.sections("rigid")?;
        Ok(Self { organs, rigid })
    }

    pub(super) fn read(self) -> Result<SceneBodies, SceneError> {
        let Self { organs, rigid } = self;
        let n_bodies = organs.len() + rigid.len();
        let mut bodies: Vec<SceneBody> = Vec::new();
        let mut only = None;
        for mut section in organs {
            let (name, color) = read_name(&mut section, &bodies, "organ")?;
            let fields = section.has("field").then(|| {
                section.wrong_table(
                    "field",
                    "of one of several bodies".into(),
                    "gravity in [simulation], which is that of all bodies".into(),
                )
            });
            let (organ, surroundings) = read_organ(section)?;
            if n_bodies == 1 {
                only = Some((organ, surroundings));
                continue;
            }
            if let Some(error) = fields {
                return Err(error);
            }
            let source = BodySource::Organ(Box::new(organ), Box::new(surroundings));
            bodies.push(SceneBody { name, color, source });
        }
        for mut section in rigid {
            let (name, color) = read_name(&mut section, &bodies, "rigid")?;
            if bodies.len() == MOST_BODIES {
                let allowed = format!("at most {MOST_BODIES} bodies");
                return Err(section.wrong_table("rigid", format!("{n_bodies} bodies"), allowed));
            }
            bodies.push(SceneBody { name, color, source: BodySource::Rigid(read_rigid(section)?) });
        }
        if let Some((organ, surroundings)) = only {
            return Ok(SceneBodies { organ, surroundings, bodies });
        }
        let first = bodies.iter().find_map(|body| match &body.source {
            BodySource::Organ(organ, _) => Some(OrganSource::clone(organ)),
            BodySource::Rigid(_) => None,
        });
        let organ = first.expect("there is at least one organ");
        Ok(SceneBodies { organ, surroundings: OrganSurroundings::default(), bodies })
    }
}

/// The number of the body that a table names.
pub(super) fn read_body_named(
    section: &mut Section<'_>,
    (key, example): (&'static str, &'static str),
    bodies: &[SceneBody],
) -> Result<usize, SceneError> {
    let (name, at) = section.string(key)?.ok_or_else(|| section.missing(key, example))?;
    bodies.iter().position(|body| body.name == name).ok_or_else(|| {
        let names: Vec<&str> = bodies.iter().map(|body| body.name.as_str()).collect();
        let allowed = if names.is_empty() { "one of several bodies".into() } else { names.join(", ") };
        section.wrong_value(at, key, format!("\"{name}\""), &allowed)
    })
}

/// `name` and `color`; a body without a name has that of its sort and its number, which no other body has.
fn read_name(
    section: &mut Section<'_>,
    before: &[SceneBody],
    sort: &str,
) -> Result<(String, Option<[u8; 3]>), SceneError> {
    let given = section.string("name")?;
    let color = match section.string("color")? {
        None => None,
        Some((text, at)) => match parse_color(&text) {
            None => {
                let allowed = "red, green and blue in hexadecimal, such as \"#c86450\"";
                return Err(section.wrong_value(at, "color", format!("\"{text}\""), allowed));
            }
            color => color,
        },
    };
    let number = before.len() + 1;
    let name = given.as_ref().map_or_else(|| format!("{sort} {number}"), |(name, _)| name.clone());
    if let Some((_, at)) = given
        && before.iter().any(|body| body.name == name)
    {
        let allowed = "a name of its own for each body";
        return Err(section.wrong_value(at, "name", format!("\"{name}\" once more"), allowed));
    }
    Ok((name, color))
}

fn parse_color(text: &str) -> Option<[u8; 3]> {
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.is_ascii())?;
    let byte = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).ok();
    Some([byte(0)?, byte(2)?, byte(4)?])
}

#[cfg(test)]
mod tests {
    use crate::scene::{BodyShape, BodySource, Scene};

    const SCENE: &str = r##"glisson_scene = 1
[[organ]]
name = "liver"
color = "#8c3a30"
mesh = "liver.vtu"
tissue = "liver"
model = "implicit"
[[organ]]
mesh = "stomach.vtu"
tissue = "liver"
model = "explicit"
[[rigid]]
name = "spine"
ball = { center = [0, 0, 0], radius = "20 mm" }
breathing = { direction = [0, 0, -1], amplitude = "10 mm", period = "4 s" }
[[attachment]]
body = "liver"
to = "spine"
kind = "ligament"
reach = "5 mm"
stiffness = "200 N/m"
[tool]
tip_radius = "5 mm"
home_tip = [0, 0, "200 mm"]
home_shaft = [0, 0, 1]
"##;

    #[test]
    fn bodies_are_read_with_names_and_touch_by_default() {
        let scene = Scene::parse(SCENE).unwrap();
        let names: Vec<&str> = scene.bodies.iter().map(|body| body.name.as_str()).collect();
        assert_eq!(names, ["liver", "organ 2", "spine"]);
        assert_eq!(scene.bodies[0].color, Some([0x8c, 0x3a, 0x30]));
        let BodySource::Rigid(rigid) = &scene.bodies[2].source else { panic!("it is rigid") };
        assert!(matches!(rigid.source.shape, BodyShape::Ball { .. }));
        assert!(scene.world.body_contact.is_some() && scene.world.self_contact.is_none());
        assert_eq!(scene.attachments[0].bodies, [0, 2]);
        let apart = Scene::parse(&(SCENE.to_owned() + "[contact]\nbodies = false\n")).unwrap();
        assert_eq!(apart.world.body_contact, None);
        // One organ alone has the old path, however it is written.
        let (start, end) = (SCENE.find("[[organ]]\nmesh").unwrap(), SCENE.find("[tool]").unwrap());
        let alone = Scene::parse(&(SCENE[..start].to_owned() + &SCENE[end..])).unwrap();
        assert!(alone.bodies.is_empty() && alone.world.body_contact.is_none());
    }

    #[test]
    fn mistakes_of_bodies_are_named_with_line_and_remedy() {
        for (from, to, expected) in [
            (
                "\"spine\"\nball",
                "\"liver\"\nball",
                "line 13: \"name\" is \"liver\" once more; allowed: a name of its own",
            ),
            ("#8c3a30", "#8c3a3", "line 4: \"color\" is \"#8c3a3\"; allowed: red, green and blue"),
            ("to = \"spine\"", "to = \"spines\"", "\"to\" is \"spines\"; allowed: liver, organ 2, spine"),
            ("\"ligament\"", "\"nail\"", "allowed: glue, ligament, membrane"),
            ("amplitude = \"10 mm\", ", "", "lacks \"amplitude\""),
            ("ball = {", "bald = {", "unknown key \"bald\""),
        ] {
            assert!(SCENE.contains(from), "{from}");
            let read = Scene::parse(&SCENE.replacen(from, to, 1));
            let error = read.unwrap_err().to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
    }
}
