//! Cases of the pictures without GPU.

use super::body::ellipsoid_surface;
use super::{Case, Prepared, Settings};
use glisson_picture::{Camera, Look, Picture, PictureScene, ShadedSurface, View, bounds_of};

pub(super) const CASES: &[Case] = &[Case {
    name: "picture",
    about: "a report's picture of 1280 x 800 pixels; size in surface triangles",
    per: "picture",
    sizes: &[3_000, 30_000],
    parallel: true,
    prepare: picture,
}];

/// Width and height [pixels].
const SIZE: [usize; 2] = [1280, 800];

fn picture(settings: Settings) -> anyhow::Result<Prepared> {
    let surface = ellipsoid_surface(settings.size);
    let size = surface.triangles.len();
    let organ = ShadedSurface {
        rest_positions_m: surface.positions_m.clone(),
        positions_m: surface.positions_m,
        triangles: surface.triangles,
        look: Look::Liver,
    };
    let camera = Camera::framing(bounds_of(std::slice::from_ref(&organ)), SIZE, View::default());
    let scene = PictureScene {
        surfaces: vec![organ],
        instruments: Vec::new(),
        arrows: Vec::new(),
        captions: Vec::new(),
        camera,
        size: SIZE,
    };
    Ok(Prepared {
        size,
        isa: "portable",
        precision: "f32",
        work: None,
        note: format!("{size} surface triangles"),
        run: Box::new(move || {
            std::hint::black_box(Picture::render(&scene).expect("the ellipsoid is a proper surface"));
        }),
    })
}
