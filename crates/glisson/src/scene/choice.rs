//! What may be chosen of a scene with a task: its patient and its level. The choice is written into the scene's text, so that a session
//! holds it.

use super::reader::{SceneError, Section, Value, parse_toml};
use super::spec::Scene;
use std::ops::Range;

/// What is chosen; nothing of what is left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// The synthetic patient: one of the task's `patients`.
    pub patient: Option<u32>,
    /// The level: one of the task's.
    pub level: Option<String>,
}

/// The text of a scene with this choice.
///
/// # Errors
/// [`SceneError`] where the scene cannot be read, or has not what is chosen.
pub fn choose(text: &str, choice: &Choice) -> Result<String, SceneError> {
    let scene = Scene::parse(text)?;
    let document = parse_toml(text)?;
    let root = Section::root(text, &document);
    let mut edits: Vec<Edit> = Vec::new();
    let task = scene.task.as_ref();
    if let Some(patient) = choice.patient {
        let patients = task.map_or(&[][..], |task| &task.patients[..]);
        if !patients.contains(&patient) {
            let names: Vec<String> = patients.iter().map(u32::to_string).collect();
            return Err(no_such(&root, "patients", &patient.to_string(), &names));
        }
        edits.extend(edits_of_patient(&root, patient));
    }
    if let Some(level) = &choice.level {
        let levels = task.map_or(&[][..], |task| &task.levels[..]);
        let chosen = root.value_at(&["task", "level"]);
        match chosen.filter(|_| levels.contains(level)) {
            Some(value) => edits.push((value.span(), quoted(level))),
            None => return Err(no_such(&root, "level", &format!("\"{level}\""), levels)),
        }
    }
    Ok(edited(text, edits))
}

/// The text of a scene with another synthetic patient, also one that its task does not name.
///
/// # Errors
/// [`SceneError`] where the scene cannot be read, or does not say of each of its synthetic bodies which patient it is of.
pub fn with_patient(text: &str, patient: u32) -> Result<String, SceneError> {
    let document = parse_toml(text)?;
    let root = Section::root(text, &document);
    let all_of =
        |path: &[&str]| ["organ", "rigid"].map(|body| root.values_at(&[&[body], path].concat()).len());
    let [n_phantoms, n_seeds]: [usize; 2] =
        [&["phantom"][..], &["phantom", "seed"]].map(|path| all_of(path).iter().sum());
    if n_phantoms == 0 || n_seeds < n_phantoms {
        let found = format!("in a scene with {n_phantoms} synthetic organs, {n_seeds} of which have a seed");
        let allowed = "a scene with phantom = { seed = ... } in every synthetic organ".to_owned();
        return Err(root.wrong_table("patient", found, allowed));
    }
    Ok(edited(text, edits_of_patient(&root, patient)))
}

/// A place in a text, and what it is replaced by.
type Edit = (Range<usize>, String);

/// Of several bodies all that are of the same patient as the first one.
fn edits_of_patient(root: &Section<'_>, patient: u32) -> Vec<Edit> {
    let seeds = ["organ", "rigid"].map(|body| root.values_at(&[body, "phantom", "seed"])).concat();
    let digits = |seed: &Value<'_>| seed.get_ref().as_integer().map(|seed| seed.as_str().to_owned());
    let usual = seeds.first().and_then(digits);
    let of_usual = seeds.iter().filter(|seed| digits(seed) == usual);
    of_usual.map(|seed| (seed.span(), patient.to_string())).collect()
}

fn edited(text: &str, mut edits: Vec<Edit>) -> String {
    // From the end on, so that places before stay where they are.
    edits.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
    let mut text = text.to_owned();
    edits.into_iter().for_each(|(span, new)| text.replace_range(span, &new));
    text
}

/// A text as TOML has it in quotes.
fn quoted(text: &str) -> String {
    let letter = |letter: char| match letter {
        '"' | '\\' => format!("\\{letter}"),
        _ if letter.is_control() => format!("\\U{:08X}", u32::from(letter)),
        _ => letter.to_string(),
    };
    format!("\"{}\"", text.chars().map(letter).collect::<String>())
}

fn no_such(root: &Section<'_>, key: &str, found: &str, allowed: &[String]) -> SceneError {
    let allowed = if allowed.is_empty() { "none: the task has no choice".into() } else { allowed.join(", ") };
    match root.value_at(&["task"]) {
        Some(task) => root.wrong_value(task, key, found.to_owned(), &allowed),
        None => root.wrong_table(key, found.to_owned(), allowed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DVec3;
    use crate::scene::GoalSource;

    const SCENE: &str = "glisson_scene = 1\n[[place]]\nname = \"nodule\"\nmiddle_of = \"liver_tumour\"\ntoward = [0, -1, 0]\n\
        [organ]\nphantom = { organ = \"liver\", seed = 26, tetrahedra = 900 } # one of five\ntissue = \"liver\"\nmodel = \"implicit\"\n\
        [tool]\nname = \"probe\"\ntip_radius = \"5 mm\"\nhome_tip = { place = \"nodule\", plus = [0, \"-50 mm\", 0] }\nhome_shaft = [0, -1, 0]\n\
        [task]\ntitle = \"T\"\npatients = [26, 4]\nlevel = \"normal\"\ntime_limit = \"3 min\"\n\
        [[task.levels]]\nname = \"normal\"\n[[task.levels]]\nname = \"hard\"\ntime_limit = \"1 min\"\nhints = false\ngate = { mistakes = 0 }\n\
        [[task.event]]\ntitle = \"dark\"\nat = \"3 s\"\nlevels = [\"hard\"]\nlight_out = { for = \"1 s\" }\n\
        [[task.stage]]\ntitle = \"a\"\nhint = \"h\"\nmark = { near = \"nodule\", within = \"9 mm\" }\n";

    fn chosen(patient: Option<u32>, level: Option<&str>) -> Result<Scene, SceneError> {
        let choice = Choice { patient, level: level.map(str::to_owned) };
        choose(SCENE, &choice).map(|text| Scene::parse(&text).unwrap())
    }

    #[test]
    fn places_go_with_the_patient() {
        let near_m = |scene: &Scene| match scene.task.as_ref().unwrap().stages[0].goal {
            GoalSource::Mark { near_m, .. } => near_m,
            ref other => panic!("{other:?}"),
        };
        let (usual, other) = (chosen(None, None).unwrap(), chosen(Some(4), None).unwrap());
        assert_eq!((usual.patient(), other.patient()), (Some(26), Some(4)));
        let [a_m, b_m] = [&usual, &other].map(near_m);
        assert!(a_m.distance(b_m) > 0.02, "{a_m} {b_m}");
        // On the front of the liver, where the voxels of the same patient end.
        assert!((a_m - DVec3::new(-0.0856, -0.048, -0.032)).abs().max_element() < 2e-3, "{a_m}");
        assert_eq!(other.world.tools[0].home.tip_in_world_m, b_m - DVec3::Y * 0.05);
        assert!(other.text.contains("seed = 4, tetrahedra = 900 } # one of five"));
    }

    #[test]
    fn studies_take_any_patient() {
        let scene = Scene::parse(&with_patient(SCENE, 77).unwrap()).unwrap();
        assert_eq!(scene.patient(), Some(77));
        for (organs, expected) in [
            ("[organ]\nbox = 1\n", "0 synthetic organs"),
            (
                "[[organ]]\nphantom = { seed = 1 }\n[[organ]]\nphantom = {}\n",
                "2 synthetic organs, 1 of which",
            ),
        ] {
            let error = with_patient(&format!("glisson_scene = 1\n{organs}"), 77).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_level_changes_limit_hints_gate_and_events() {
        let of = |level| chosen(None, level).unwrap().task.unwrap();
        let (normal, hard) = (of(None), of(Some("hard")));
        assert_eq!((normal.time_limit_s, hard.time_limit_s), (180.0, 60.0));
        assert_eq!((normal.stages[0].hint.as_deref(), hard.stages[0].hint.as_deref()), (Some("h"), None));
        assert_eq!((normal.gate.n_mistakes, hard.gate.n_mistakes), (None, Some(0)));
        assert_eq!((normal.events.len(), hard.events.len()), (0, 1));
        assert_eq!((normal.level.as_deref(), hard.level.as_deref()), (Some("normal"), Some("hard")));
    }

    #[test]
    fn a_level_may_be_called_anything() {
        let name = "tr\u{e8}s\u{a0}\u{301}dur \\ \"x\" \u{1}";
        let scene = SCENE.replace("name = \"hard\"", &format!("name = {}", quoted(name)));
        let scene = scene.replace("levels = [\"hard\"]", &format!("levels = [{}]", quoted(name)));
        let text = choose(&scene, &Choice { patient: None, level: Some(name.into()) }).unwrap();
        assert_eq!(Scene::parse(&text).unwrap().task.unwrap().level.as_deref(), Some(name));
    }

    #[test]
    fn what_is_not_there_is_not_chosen() {
        for (patient, level, expected) in [
            (Some(5), None, "\"patients\" is 5; allowed: 26, 4"),
            (None, Some("easy"), "\"level\" is \"easy\"; allowed: normal, hard"),
        ] {
            let error = chosen(patient, level).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let without = SCENE.replace("near = \"nodule\"", "near = \"nodul\"");
        let error = Scene::parse(&without).unwrap_err().to_string();
        assert!(error.contains("a [[place]] of the scene: nodule; did you mean \"nodule\"?"), "{error}");
        let outside = SCENE.replace("middle_of = \"liver_tumour\"", "inside = [0, \"-1 m\", 0]");
        let error = Scene::parse(&outside).unwrap_err().to_string();
        assert!(error.contains("from a place inside the liver"), "{error}");
        let no_level = SCENE.replace("level = \"normal\"\n", "");
        assert!(Scene::parse(&no_level).unwrap_err().to_string().contains("lacks \"level\""));
    }
}
