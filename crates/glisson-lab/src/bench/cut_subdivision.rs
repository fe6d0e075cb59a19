//! A step of a blade that divides tetrahedra: worked out and carried out in the mesh. It is undone, untimed, so
//! that the next call finds the same body.

use std::hint::black_box;

use anyhow::{Context, ensure};
use glisson::math::{Aabb, DVec3};
use glisson::mesh::edit::{EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use glisson::mesh::quality::MeshQuality;
use glisson::mesh::remap::follow_in_tissue;
use glisson::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};

use super::body::StandardBody;
use super::timing::untimed;
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[Case {
    name: "cut_subdivision_step",
    about: "a blade's step through about 20 tetrahedra: planned, and carried out in the mesh",
    per: "step",
    sizes: &[6_300],
    parallel: false,
    prepare: cut_subdivision_step,
}];

/// Tetrahedra that the step should meet.
const N_MET: usize = 20;

/// Steps before the one that is timed.
const N_STEPS_BEFORE: usize = 3;

/// Blades that are tried until one meets the wished number of tetrahedra.
const N_DEPTHS: usize = 30;

/// A stroke that is about to take the step, and the blade's next place.
struct Ready {
    cut: SubdivisionCut,
    mesh: EditableMesh,
    positions_m: Vec<DVec3>,
    blade_m: [DVec3; 2],
    n_met: usize,
}

fn cut_subdivision_step(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let params = SubdivisionParams::for_mean_edge(MeshQuality::of(&body.mesh).mean_edge_m);
    let bounds = Aabb::of_points(&body.mesh.positions_m);
    let mut best: Option<Ready> = None;
    for i in 0..N_DEPTHS {
        let depth_m = bounds.size_m().z * (i + 1) as f64 / (N_DEPTHS + 1) as f64;
        let blade = |step: usize| {
            // The step that is timed crosses the middle.
            let x = bounds.center_m().x + (step as f64 - N_STEPS_BEFORE as f64 - 0.5) * params.min_advance_m;
            let skin = DVec3::new(x, bounds.center_m().y, bounds.max_m.z);
            [skin - depth_m * DVec3::Z, skin + 0.01 * DVec3::Z]
        };
        let mut ready = Ready {
            cut: SubdivisionCut::new(params.clone()),
            mesh: EditableMesh::new(body.mesh.clone())?,
            positions_m: body.mesh.positions_m.clone(),
            blade_m: blade(N_STEPS_BEFORE + 1),
            n_met: 0,
        };
        for step in 0..=N_STEPS_BEFORE {
            if let Some(edit) = ready.cut.advance(&ready.mesh, &ready.positions_m, blade(step))? {
                let change = ready.mesh.apply(&MeshEdit::Replace(edit))?;
                follow_in_tissue(&mut ready.positions_m, &change);
            }
        }
        let before = ready.cut.report().n_touched;
        ready.cut.advance(&ready.mesh, &ready.positions_m, ready.blade_m)?;
        ready.n_met = ready.cut.report().n_touched - before;
        ready.cut.take_back();
        if best.as_ref().is_none_or(|b| ready.n_met.abs_diff(N_MET) < b.n_met.abs_diff(N_MET)) {
            best = Some(ready);
        }
    }
    let Ready { mut cut, mut mesh, positions_m, blade_m, n_met } = best.context("a depth was tried")?;
    ensure!(n_met > 0, "the blade meets nothing");
    let edit = cut.advance(&mesh, &positions_m, blade_m)?.context("the step cuts")?;
    cut.take_back();
    let note = format!("meets {n_met}, {} tetrahedra go, {} come", edit.tets.len(), edit.new_tets.len());
    let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        work: None,
        note,
        run: Box::new(move || {
            let edit = cut.advance(&mesh, &positions_m, blade_m).expect("accepted before").expect("cuts");
            mesh.apply_saving(&MeshEdit::Replace(edit), &mut change, &mut undo).expect("possible before");
            black_box(&change);
            untimed(|| {
                mesh.undo(&undo);
                cut.take_back();
            });
        }),
    })
}
