//! `[[place]]`: points of the synthetic patient that the other points of a scene are given by, so that it goes with other patients.

use super::reader::{Places, SceneError, Section};
use super::shape::tissue_named;
use crate::image::phantom::PhantomPlaces;
use crate::math::DVec3;

/// The synthetic patient of a scene's first organ; none if it is of no such patient. A seed that cannot be is refused with the organ.
pub(super) fn patient_of(root: &Section<'_>) -> Result<Option<u64>, SceneError> {
    if root.value_at(&["organ", "phantom"]).is_none() {
        return Ok(None);
    }
    let Some(seed) = root.value_at(&["organ", "phantom", "seed"]) else { return Ok(Some(1)) };
    root.number_of("seed", seed).map(|seed| Some(seed as u64))
}

/// Places of the scene whose organ is of the patient `seed`.
pub(super) fn read_places(sections: Vec<Section<'_>>, seed: Option<u64>) -> Result<Places, SceneError> {
    let mut places = Places::new();
    let mut patient = None;
    for mut section in sections {
        let Some(seed) = seed else {
            let found = "in a scene without an organ of the synthetic patient".to_string();
            return Err(section.wrong_table("place", found, "beside phantom = { organ, seed }".into()));
        };
        let patient = patient.get_or_insert_with(|| PhantomPlaces::new(seed));
        let (name, place_m) = read_place(&mut section, patient)?;
        if places.contains_key(&name) {
            let found = format!("\"{name}\" once more");
            return Err(section.wrong_table("name", found, "a name of its own for each place".into()));
        }
        section.finish()?;
        places.insert(name, place_m);
    }
    Ok(places)
}

fn read_place(section: &mut Section<'_>, patient: &PhantomPlaces) -> Result<(String, DVec3), SceneError> {
    let name = section.string("name")?.ok_or_else(|| section.missing("name", "name = \"nodule\""))?.0;
    let middle_of = section.string("middle_of")?;
    let end_of = section.string("end_of")?;
    let inside_m = section.point("inside")?;
    let from_m = match (middle_of, end_of, inside_m) {
        (None, Some((end, at)), None) => {
            let [neck_m, fundus_m] = patient.gall_bladder_ends_m();
            match end.as_str() {
                "gall_bladder_neck" => neck_m,
                "gall_bladder_fundus" => fundus_m,
                _ => {
                    let allowed = "gall_bladder_neck or gall_bladder_fundus";
                    return Err(section.wrong_value(at, "end_of", format!("\"{end}\""), allowed));
                }
            }
        }
        (Some((part, at)), None, None) => {
            let tissue = tissue_named(section, "middle_of", &part, at)?;
            patient.middle_m(tissue).ok_or_else(|| {
                let allowed = "liver_tumour, gall_bladder, spleen, kidney_right or kidney_left";
                section.wrong_value(at, "middle_of", format!("\"{part}\""), allowed)
            })?
        }
        (None, None, Some(inside_m)) => inside_m,
        _ => {
            let one_of = ["middle_of", "end_of", "inside"];
            return Err(section.missing_one_of(&one_of, "middle_of = \"liver_tumour\""));
        }
    };
    let place_m = match section.direction("toward")? {
        None => from_m,
        Some(toward) => patient.way_out_of_liver_m(from_m, toward).ok_or_else(|| {
            let found =
                format!("from ({:.1}, {:.1}, {:.1}) mm", from_m.x * 1e3, from_m.y * 1e3, from_m.z * 1e3);
            section.wrong_table("toward", found, "from a place inside the liver".into())
        })?,
    };
    Ok((name, place_m))
}
