//! `law` of `[organ]`: any law of the table, its numbers read as its description says.

use super::reader::{SceneError, Section, Value};
use crate::material::{LawChoice, LawKey, LawKeyKind, law_named, law_names};
use crate::model::kind::ModelKind;

/// `law = "neo_hooke_log"`, or a table with the law's own numbers.
pub(super) fn read_law(section: &mut Section<'_>, model: ModelKind) -> Result<Option<LawChoice>, SceneError> {
    let (law, at) = if section.is_table("law") {
        let at = section.get("law");
        let Some(mut table) = section.section("law")? else { return Ok(None) };
        let (name, at_name) =
            table.string("name")?.ok_or_else(|| table.missing("name", "name = \"ogden\""))?;
        let law = read_choice(&mut table, &name, at_name)?;
        table.finish()?;
        (law, at)
    } else {
        let Some((name, at)) = section.string("law")? else { return Ok(None) };
        (read_choice(section, &name, at)?, Some(at))
    };
    match at {
        Some(at) if !model.follows(law.name()) => {
            let allowed = model.laws();
            let allowed = if allowed.is_empty() {
                format!("none: the model \"{model}\" follows no law; leave the key out")
            } else {
                format!("{} (the laws of the model \"{model}\")", allowed.join(", "))
            };
            Err(section.wrong_value(at, "law", format!("\"{}\"", law.name()), &allowed))
        }
        _ => Ok(Some(law)),
    }
}

fn read_choice(section: &mut Section<'_>, name: &str, at: Value<'_>) -> Result<LawChoice, SceneError> {
    let Some(mut law) = law_named(name) else {
        let allowed = law_names().collect::<Vec<_>>().join(", ");
        return Err(section.wrong_value(at, "law", format!("\"{name}\""), &allowed));
    };
    for key in law.entry().keys {
        law = read_key(section, law, key)?;
    }
    match law.missing() {
        Some(key) => Err(section.missing(key.name, law.entry().example)),
        None => Ok(law),
    }
}

/// The law with what the scene says of one of its parameters; as it was where the scene says nothing.
fn read_key(
    section: &mut Section<'_>,
    law: LawChoice,
    key: &'static LawKey,
) -> Result<LawChoice, SceneError> {
    let (found, unit) = match key.kind {
        LawKeyKind::Number(_) => (section.number(key.name)?, String::new()),
        LawKeyKind::Positive(dimension) => {
            (section.quantity(key.name, dimension)?, format!(" {}", dimension.units()[0].0))
        }
        LawKeyKind::Directions => {
            let direction = section.direction(key.name)?;
            return Ok(
                direction.map_or_else(|| law.clone(), |direction| law.clone().with_direction(direction))
            );
        }
    };
    match found {
        Some((number, at)) if !(key.range.holds)(number) => {
            Err(section.wrong_value(at, key.name, format!("{number}{unit}"), key.range.allowed))
        }
        Some((number, _)) => Ok(law.with_number(key.name, number)),
        None => Ok(law),
    }
}

#[cfg(test)]
mod tests {
    use super::super::spec::Scene;
    use super::*;
    use crate::material::{LAWS, LawEntry};

    fn scene(law: &str) -> String {
        format!(
            "glisson_scene = 1\n[organ]\nmesh = \"a.vtu\"\ntissue = \"liver\"\nmodel = \"implicit\"\n{law}\n\
             [[organ.fixed]]\nfurthest = {{ direction = [0, 1, 0], fraction = 0.1 }}\n\
             [tool]\ntip_radius = \"6 mm\"\nhome_tip = [\"0 mm\", \"-200 mm\", \"0 mm\"]\nhome_shaft = [0, -1, 0]\n"
        )
    }

    fn message(law: &str) -> String {
        Scene::parse(&scene(law)).unwrap_err().to_string()
    }

    /// The line of a scene that chooses a law.
    fn line_of(law: &LawEntry) -> String {
        if law.keys.is_empty() { format!("law = \"{}\"", law.name) } else { law.example.to_owned() }
    }

    #[test]
    fn the_example_of_every_law_of_the_table_is_read() {
        for law in LAWS {
            let found = Scene::parse(&scene(&line_of(law))).unwrap().organ.law.unwrap();
            assert_eq!(found.name(), law.name);
            let wrong = line_of(law).replace(law.name, "no_such_law");
            let allowed = law_names().collect::<Vec<_>>().join(", ");
            assert!(message(&wrong).contains(&format!("\"no_such_law\"; allowed: {allowed}")), "{wrong}");
        }
    }

    /// The example of a law with another value of one key.
    fn with_value(law: &LawEntry, key: &str, value: &str) -> String {
        let at = law.example.find(&format!("{key} = ")).unwrap() + key.len() + " = ".len();
        let rest = &law.example[at..];
        let end = match rest.strip_prefix('"') {
            Some(quoted) => quoted.find('"').unwrap() + 2,
            None => rest.find([',', ' ', '}']).unwrap(),
        };
        format!("{}{value}{}", &law.example[..at], &rest[end..])
    }

    #[test]
    fn parameters_of_every_law_are_refused_with_their_line_when_mistyped_or_out_of_range() {
        let (mut n_mistyped, mut n_refused) = (0, 0);
        for law in LAWS {
            for key in law.keys {
                let name = key.name;
                let renamed = law.example.replace(&format!("{name} = "), &format!("{name}x = "));
                if renamed == law.example {
                    assert!(
                        matches!(key.kind, LawKeyKind::Number(Some(_))),
                        "{}'s example lacks {name}",
                        law.name
                    );
                    continue;
                }
                let mistyped = message(&renamed);
                let is_told = mistyped.contains(&format!("did you mean \"{name}\"?"));
                assert!(mistyped.starts_with("line 6: ") && is_told, "{mistyped}");
                n_mistyped += 1;
                for number in [-1.0, 0.0, 2.0].into_iter().filter(|x| !(key.range.holds)(*x)) {
                    let (value, shown) = match key.kind {
                        LawKeyKind::Positive(dimension) => {
                            let unit = dimension.units()[0].0;
                            (format!("\"{number} {unit}\""), format!("{number} {unit}"))
                        }
                        _ => (format!("{number:?}"), number.to_string()),
                    };
                    let found = message(&with_value(law, name, &value));
                    let expected = format!("line 6: \"{name}\" is {shown}; allowed: {}", key.range.allowed);
                    assert!(found.starts_with(&expected), "{found}");
                    n_refused += 1;
                }
            }
        }
        assert!(n_mistyped >= 5 && n_refused >= 7, "{n_mistyped} {n_refused}");
        let bare = message("law = \"ogden\"");
        assert!(bare.contains("lacks \"exponent\"; write for example law = { name = \"ogden\""), "{bare}");
    }

    #[test]
    fn models_without_a_choice_say_so() {
        let of = |model: &str| {
            let text = scene("law = \"neo_hooke_log\"").replace("\"implicit\"", &format!("\"{model}\""));
            Scene::parse(&text).unwrap_err().to_string()
        };
        assert!(of("mass_spring").contains("none: the model \"mass_spring\" follows no law"));
        assert!(of("reduced").contains("allowed: st_venant_kirchhoff (the laws of the model \"reduced\")"));
    }
}
