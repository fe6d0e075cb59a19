//! `[[organ.vessel]]`: blood vessels of an organ that are written in the scene itself.

use super::reader::{SceneError, Section};
use crate::image::vessels::Tube;
use crate::units::Dimension;

const PATH: &str = "path = [[\"0 mm\", \"0 mm\", \"0 mm\"], [\"0 mm\", \"0 mm\", \"40 mm\"]]";
/// Points of a vessel at most.
const MOST_POINTS: usize = 1000;

/// The tubes of all vessels, each from where its blood comes; one from the end of each tube to the next.
pub(super) fn read_vessels(sections: Vec<Section<'_>>) -> Result<Vec<Tube>, SceneError> {
    let mut tubes = Vec::new();
    for section in sections {
        read_vessel(section, &mut tubes)?;
    }
    Ok(tubes)
}

fn read_vessel(mut section: Section<'_>, tubes: &mut Vec<Tube>) -> Result<(), SceneError> {
    let path_m = section.points("path", PATH)?.ok_or_else(|| section.missing("path", PATH))?;
    if path_m.len() < 2 || path_m.len() > MOST_POINTS || path_m.windows(2).any(|pair| pair[0] == pair[1]) {
        let found = format!("a path of {} points", path_m.len());
        let allowed = format!("2 to {MOST_POINTS} points, each apart from the one before");
        return Err(section.wrong_table("path", found, allowed));
    }
    let radius_m = section
        .positive("radius", Dimension::Length)?
        .ok_or_else(|| section.missing("radius", "radius = \"1.5 mm\""))?;
    section.finish()?;
    for (nth, pair) in path_m.windows(2).enumerate() {
        let parent = (nth > 0).then(|| tubes.len() as u32 - 1);
        tubes.push(Tube { parent, ends_m: [pair[0], pair[1]], radii_m: [radius_m; 2] });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::spec::Scene;
    use super::*;
    use crate::math::DVec3;

    fn vessels(text: &str) -> Result<Vec<Tube>, SceneError> {
        let scene = format!(
            "glisson_scene = 1\n[organ]\nball = {{ center = [0, 0, 0], radius = \"4 cm\" }}\ntissue = \"liver\"\n\
             model = \"implicit\"\n{text}[tool]\nhome_tip = [0, \"-9 cm\", 0]\nhome_shaft = [0, -1, 0]\ntip_radius = \"3 mm\"\n"
        );
        Scene::parse(&scene).map(|scene| scene.organ.vessel_tubes)
    }

    #[test]
    fn each_tube_goes_on_from_the_one_before_of_its_vessel() {
        let tubes = vessels(
            "[[organ.vessel]]\npath = [[0, 0, 0], [0, 0, \"1 cm\"], [0, 0, \"2 cm\"]]\nradius = \"2 mm\"\n\
             [[organ.vessel]]\npath = [[0, 0, 0], [0, \"1 cm\", 0]]\nradius = \"1 mm\"\n",
        )
        .unwrap();
        let parents: Vec<_> = tubes.iter().map(|tube| tube.parent).collect();
        assert_eq!(parents, [None, Some(0), None]);
        assert_eq!((tubes[1].ends_m, tubes[1].radii_m), ([DVec3::Z * 0.01, DVec3::Z * 0.02], [2e-3; 2]));
    }

    #[test]
    fn what_is_no_vessel_is_refused() {
        for (text, expected) in [
            ("[[organ.vessel]]\nradius = \"1 mm\"\n", "lacks \"path\""),
            ("[[organ.vessel]]\npath = [[0, 0, 0]]\nradius = \"1 mm\"\n", "2 to 1000 points"),
            (
                "[[organ.vessel]]\npath = [[0, 0, 0], [0, 0, 0]]\nradius = \"1 mm\"\n",
                "apart from the one before",
            ),
            ("[[organ.vessel]]\npath = [[0, 0, 0], [0, 0, \"1 cm\"]]\n", "lacks \"radius\""),
        ] {
            let error = vessels(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
