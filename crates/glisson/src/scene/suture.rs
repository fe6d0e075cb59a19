//! `[[suture]]`: threads, where they lie at the start, and their needles and clips.

use super::reader::{SceneError, Section};
use crate::math::DVec3;
use crate::suture::material::{FRICTION, SIZES, ThreadSize, needle, puncture_force_n, thread};
use crate::units::Dimension;
use crate::world::spec::{MOST_SUTURES, Needle, SutureSpec};

/// Length of a segment where a scene says nothing [m]: a choice.
const SEGMENT_M: f64 = 2e-3;
const PATH: &str = "path = [[\"0 mm\", \"0 mm\", \"5 mm\"], [\"40 mm\", \"0 mm\", \"5 mm\"]]";

pub(super) fn read_sutures(sections: Vec<Section<'_>>) -> Result<Vec<SutureSpec>, SceneError> {
    if sections.len() > MOST_SUTURES {
        let found = format!("{} threads", sections.len());
        return Err(sections[MOST_SUTURES].wrong_table("suture", found, format!("at most {MOST_SUTURES}")));
    }
    sections.into_iter().map(read_suture).collect()
}

/// The size of a thread, if its table says it.
pub(super) fn read_size(section: &mut Section<'_>) -> Result<Option<&'static ThreadSize>, SceneError> {
    let Some((size, at)) = section.string("size")? else { return Ok(None) };
    let known = SIZES.iter().find(|known| known.name == size).ok_or_else(|| {
        let names: Vec<&str> = SIZES.iter().map(|size| size.name).collect();
        section.wrong_value(at, "size", format!("\"{size}\""), &names.join(", "))
    })?;
    Ok(Some(known))
}

fn read_suture(mut section: Section<'_>) -> Result<SutureSpec, SceneError> {
    let name = section.string("name")?.map_or_else(|| "suture".to_string(), |name| name.0);
    let known = read_size(&mut section)?.ok_or_else(|| section.missing("size", "size = \"3-0\""))?;
    let points = section.lengths("path", (3..=3, PATH))?.ok_or_else(|| section.missing("path", PATH))?;
    let path_m: Vec<DVec3> = points.iter().map(|point| DVec3::from_slice(point)).collect();
    let length_m: f64 = path_m.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let spacing_m = section.positive("segment", Dimension::Length)?.unwrap_or(SEGMENT_M);
    if length_m < 2.0 * spacing_m {
        let found = format!("a path of {:.1} mm", 1e3 * length_m);
        return Err(section.wrong_table("path", found, "at least two segments long".into()));
    }
    let needle_m = section.positive("needle", Dimension::Length)?;
    if let Some(needle_m) = needle_m.filter(|needle_m| !(4.0 * spacing_m..length_m).contains(needle_m)) {
        let found = format!("{:.1} mm", 1e3 * needle_m);
        return Err(section.wrong_table(
            "needle",
            found,
            "four segments or more, and shorter than the path".into(),
        ));
    }
    let friction = section.number("friction")?;
    if let Some((_, at)) = friction.filter(|(friction, _)| *friction < 0.0) {
        return Err(section.wrong_value(at, "friction", "below zero".into(), "zero or more"));
    }
    let clips = section.lengths("clips", (1..=2, "clips = [[\"10 mm\"], [\"20 mm\", \"60 mm\"]]"))?;
    section.finish()?;
    let clip_m = |clip: Vec<f64>| [clip[0], clip[clip.len() - 1]];
    Ok(SutureSpec {
        name,
        path_m,
        radius_m: 0.5 * known.diameter_m,
        spacing_m,
        thread: thread(known.diameter_m),
        needle: needle_m.map(|length_m| Needle {
            length_m,
            material: needle(known.diameter_m),
            puncture_force_n: puncture_force_n(known.diameter_m),
        }),
        friction_coefficient: friction.map_or(FRICTION, |friction| friction.0),
        clips_m: clips.unwrap_or_default().into_iter().map(clip_m).collect(),
    })
}

#[cfg(test)]
mod tests {
    use crate::scene::Scene;

    const SCENE: &str = "glisson_scene = 1\n[simulation]\ntime_step = \"1 ms\"\n[organ]\nmesh = \"a.vtu\"\nyoung_modulus = \"5 kPa\"\n\
        poisson_ratio = 0.45\ndensity = \"1060 kg/m3\"\nmodel = \"explicit\"\n[[organ.fixed]]\n\
        furthest = { direction = [0, 1, 0], fraction = 0.1 }\n[tool]\ntip_radius = \"6 mm\"\nhome_tip = [\"0 mm\", \"-200 mm\", \"0 mm\"]\n\
        home_shaft = [0, -2, 0]\n[[suture]]\nsize = \"3-0\"\npath = [[\"0 mm\", \"0 mm\", \"5 mm\"], [\"40 mm\", \"0 mm\", \"5 mm\"]]\n";

    #[test]
    fn threads_are_read() {
        let text = format!(
            "{SCENE}needle = \"20 mm\"\nfriction = 0\nclips = [[\"30 mm\"], [\"5 mm\", \"25 mm\"]]\n"
        );
        let scene = Scene::parse(&text).unwrap();
        let suture = &scene.world.sutures[0];
        assert_eq!((suture.path_m.len(), suture.radius_m, suture.spacing_m), (2, 0.5 * 0.225e-3, 2e-3));
        assert_eq!(suture.needle.unwrap().length_m, 0.02);
        assert_eq!(
            (suture.friction_coefficient, &suture.clips_m[..]),
            (0.0, &[[0.03; 2], [0.005, 0.025]][..])
        );
        assert!(
            suture.needle.unwrap().material.bending_stiffness_n_m2
                > 1e3 * suture.thread.bending_stiffness_n_m2
        );
    }

    #[test]
    fn wrong_threads_are_refused_with_what_is_allowed() {
        let message = |from: &str, to: &str| Scene::parse(&SCENE.replace(from, to)).unwrap_err().to_string();
        assert!(message("3-0", "9-0").contains("2-0, 3-0, 4-0, 5-0"));
        assert!(message("size = \"3-0\"\n", "").contains("size = \"3-0\""));
        assert!(message(", \"5 mm\"]]", "]]").contains("path = [["));
        assert!(message("\"40 mm\"", "\"1 mm\"").contains("at least two segments"));
        assert!(message("size", "needle = \"90 mm\"\nsize").contains("shorter than the path"));
        assert!(message("size", "thickness = 1\nsize").contains("unknown key"));
        let five = format!("{SCENE}{}", SCENE[SCENE.find("[[suture]]").unwrap()..].repeat(4));
        assert!(Scene::parse(&five).unwrap_err().to_string().contains("at most 4"));
    }
}
