//! Cases of mesh generation.

use std::hint::black_box;

use glisson::mesh::generate::generate;

use super::body::{params_for, surface_for};
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[Case {
    name: "mesh",
    about: "tetrahedra from a closed surface by isosurface stuffing, with the search for count and volume",
    per: "mesh",
    sizes: &[2_000, 6_300, 20_000, 100_000],
    parallel: false,
    prepare: mesh,
}];

fn mesh(settings: Settings) -> anyhow::Result<Prepared> {
    let (surface, params) = (surface_for(settings.size), params_for(settings.size));
    let (made, report) = generate(&surface, &params)?;
    let note = format!("{} surface triangles given, {} fillings", surface.triangles.len(), report.n_fillings);
    Ok(Prepared {
        size: made.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        work: None,
        note,
        run: Box::new(move || {
            black_box(generate(black_box(&surface), &params).expect("it was meshed before"));
        }),
    })
}
