//! Whole transactions in a world: mesh, model, collision, journal and what the display keeps.

use std::hint::black_box;

use fearless_simd::Level;
use glisson::math::DVec3;
use glisson::mesh::TetId;
use glisson::mesh::edit::MeshEdit;
use glisson::model::DynamicBody;
use glisson::model::FixedNode;
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::kind::ModelKind;
use glisson::tool::{Grip, Tool, ToolInput};
use glisson::world::spec::WorldSpec;
use glisson::world::{StepInput, World};

use super::body::StandardBody;
use super::{Case, Prepared, Settings, isa_name};
use glisson_protocol::frames::topology_frame;

pub(super) const CASES: &[Case] = &[
    Case {
        name: "edit_transaction",
        about: "the removal of one tetrahedron from a world: mesh, explicit model, collision, journal, surface lists",
        per: "removal",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: edit_transaction,
    },
    Case {
        name: "edit_transaction_parting",
        about: "the same as instruments make it: what would hang by a node or an edge alone is parted as well",
        per: "removal",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: edit_transaction_parting,
    },
    Case {
        name: "edit_transaction_shown",
        about: "edit_transaction and the new surface for the viewer after every removal, as the simulation publishes it once a frame",
        per: "removal",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: edit_transaction_shown,
    },
    Case {
        name: "edit_frame",
        about: "the message with that surface, as the server makes it for a viewer in its own thread",
        per: "frame",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: edit_frame,
    },
    Case {
        name: "edit_undo",
        about: "the same, undone again at once",
        per: "removal and undo",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: edit_undo,
    },
    Case {
        name: "tool_step",
        about: "what four sliding tools add to a world's step: the whole step, explicit model included",
        per: "step",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: tool_step,
    },
];

/// Removals before the world starts anew.
const N_REMOVALS: usize = 200;
/// Below what the explicit model bears on these bodies.
const TIME_STEP_S: f64 = 1e-4;

pub(super) fn world_of(size: usize, n_tools: usize) -> anyhow::Result<World> {
    let body = StandardBody::shared(size)?;
    let fixed: Vec<FixedNode> =
        body.fixed_nodes.iter().map(|&node| FixedNode { node, axes: [true; 3] }).collect();
    let dynamic = DynamicBody {
        fixed: &fixed,
        time_step_s: TIME_STEP_S,
        ..DynamicBody::new(&body.mesh, body.material.density_kg_per_m3())
    };
    let materials = &[body.material];
    let params = ExplicitKernelParams::new(dynamic, KernelLaw::StVenantKirchhoff, materials);
    let model = Box::new(ExplicitKernel::build(&params)?);
    let home = ToolInput::at(DVec3::Z * 0.3, DVec3::Z);
    let grip = Grip { friction_coefficient: 0.2, is_sticky: false };
    let tool = Tool { grip, ..Tool::probe("probe", 5e-3, home) };
    let mut spec = WorldSpec::new("ellipsoid", TIME_STEP_S, tool.clone());
    spec.tools = vec![tool; n_tools];
    Ok(World::new(spec, body.mesh.clone(), model, ModelKind::Explicit)?)
}

/// One removal each, from the top of the body down along a plane.
fn removals(world: &World) -> Vec<[MeshEdit; 1]> {
    let mesh = world.organ().mesh();
    let middle_m = |t: TetId| mesh.corners_m(t).into_iter().sum::<DVec3>() / 4.0;
    let mut tets: Vec<TetId> = (0..mesh.tetrahedra.len()).map(TetId::from_index).collect();
    tets.sort_by(|&a, &b| {
        let distance = |t: TetId| middle_m(t).x.abs() - middle_m(t).z;
        distance(a).total_cmp(&distance(b))
    });
    tets.truncate(N_REMOVALS);
    tets.into_iter().map(|tet| [MeshEdit::Remove { tets: vec![tet] }]).collect()
}

pub(super) fn prepared(size: usize, note: String, run: Box<dyn FnMut() + Send>) -> Prepared {
    Prepared { size, isa: isa_name(Level::new()), precision: "f64", work: None, note, run }
}

fn edit_transaction(settings: Settings) -> anyhow::Result<Prepared> {
    removing(settings, |world, edit| {
        let change = world.edit_in_place(black_box(edit));
        black_box(change.expect("a live tetrahedron goes"));
    })
}

fn edit_transaction_parting(settings: Settings) -> anyhow::Result<Prepared> {
    removing(settings, |world, edit| {
        let [MeshEdit::Remove { tets }] = edit else { unreachable!("removals alone") };
        // One that was divided with a singular edge is there no more: refused.
        let _ = black_box(world.remove_and_part(black_box(tets.clone())));
    })
}

fn edit_transaction_shown(settings: Settings) -> anyhow::Result<Prepared> {
    removing(settings, |world, edit| {
        black_box(world.edit_in_place(black_box(edit)).expect("a live tetrahedron goes"));
        black_box(world.display_topology());
    })
}

fn edit_frame(settings: Settings) -> anyhow::Result<Prepared> {
    let world = world_of(settings.size, 1)?;
    let size = world.organ().mesh().tetrahedra.len();
    let shown = world.display_topology();
    let note = format!("{} vertices, {} triangles", shown.nodes.len(), shown.triangles.len());
    let run = move || {
        black_box(topology_frame(black_box(&shown)));
    };
    Ok(prepared(size, note, Box::new(run)))
}

/// Removals in a row, each made by `remove`.
fn removing(settings: Settings, remove: fn(&mut World, &[MeshEdit; 1])) -> anyhow::Result<Prepared> {
    let mut world = world_of(settings.size, 1)?;
    let whole = world.save();
    let edits = removals(&world);
    let size = world.organ().mesh().tetrahedra.len();
    let mut next = 0;
    let run = move || {
        if next == edits.len() {
            // One sample in two hundred also restores the world.
            world.restore(&whole);
            next = 0;
        }
        remove(&mut world, &edits[next]);
        next += 1;
    };
    let note = format!("up to {N_REMOVALS} removals in a row, undo kept for 32");
    Ok(prepared(size, note, Box::new(run)))
}

fn edit_undo(settings: Settings) -> anyhow::Result<Prepared> {
    let mut world = world_of(settings.size, 1)?;
    let edits = removals(&world);
    let size = world.organ().mesh().tetrahedra.len();
    let mut next = 0;
    let run = move || {
        next = (next + 1) % edits.len();
        world.edit_in_place(black_box(&edits[next])).expect("a live tetrahedron goes");
        assert!(world.undo_edit());
    };
    Ok(prepared(size, String::new(), Box::new(run)))
}

fn tool_step(settings: Settings) -> anyhow::Result<Prepared> {
    let mut world = world_of(settings.size, 4)?;
    let size = world.organ().mesh().tetrahedra.len();
    let top_m = world.organ().mesh().positions_m.iter().fold(f64::MIN, |top, p| top.max(p.z));
    let mut step = 0_u32;
    let run = move || {
        let t = f64::from(step) * TIME_STEP_S;
        let tools = [0.0, 1.0, 2.0, 3.0].map(|i| {
            let (x_m, y_m) = (0.03 * (i - 1.5) + 0.01 * (20.0 * t).sin(), 0.01 * (15.0 * t).cos());
            ToolInput::at(DVec3::new(x_m, y_m, top_m + 2e-3), DVec3::Z)
        });
        let input = StepInput::of(&tools);
        world.step(&if step == 0 { input.placed() } else { input });
        step += 1;
    };
    Ok(prepared(size, "four probes of 5 mm, pressed in by 3 mm, friction 0.2".into(), Box::new(run)))
}
