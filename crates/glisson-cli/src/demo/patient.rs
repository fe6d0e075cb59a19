//! A picture of the synthetic patient's organs, from the true label map.

use super::scenery::Files;
use glisson::image::LabelMap;
use glisson::image::labels::Parts;
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use glisson_picture::{Camera, Caption, CaptionPlace, Look, Picture, PictureScene, ShadedSurface, View};

/// What is shown, front organs and the spine behind them.
const ORGANS: [&str; 9] = [
    "liver",
    "gall_bladder",
    "stomach",
    "spleen",
    "kidney_right",
    "kidney_left",
    "spine",
    "aorta",
    "vena_cava",
];
/// Triangles of each organ: enough for a smooth outline at this size.
const TRIANGLES: usize = 6000;
const PICTURE_SIZE: [usize; 2] = [1280, 800];

/// Draws the organs into `0_patient.png`. Structures that end at the border of the image get a flat cap.
pub(crate) fn draw(files: &Files, labels: &LabelMap) -> anyhow::Result<()> {
    let params =
        SurfaceParams { target_triangles: Some(TRIANGLES), cap_at_border: true, ..SurfaceParams::default() };
    let mut surfaces = Vec::new();
    for organ in ORGANS {
        let mask = labels.mask(&labels.select(organ, Parts::Included)?);
        let (surface, _) = surface_of_mask(&labels.grid, &mask, &params)?;
        surfaces.push(ShadedSurface {
            rest_positions_m: surface.positions_m.clone(),
            positions_m: surface.positions_m,
            triangles: surface.triangles,
            look: Look::of_structure(organ),
        });
    }
    let points_m: Vec<_> = surfaces.iter().flat_map(|s| s.positions_m.iter().copied()).collect();
    let camera = Camera::framing_points(&points_m, PICTURE_SIZE, View::default());
    let text = format!("The synthetic patient: {}", ORGANS.join(", ").replace('_', " "));
    let scene = PictureScene {
        surfaces,
        instruments: Vec::new(),
        arrows: Vec::new(),
        captions: vec![Caption { text, place: CaptionPlace::BottomLeft }],
        camera,
        size: PICTURE_SIZE,
    };
    Picture::render(&scene)?.write_png(&files.folder.join("0_patient.png"))
}
