//! Edits are transactions: a fault at any place of an edit leaves every bit of the world as it was, in every model; the
//! next edit works, and all that follows has the bits of a world in which nothing was refused.

use crate::model_meshes::shaken_block;
use glisson::image::vessels::{Tube, write_vessels};
use glisson::math::DVec3;
use glisson::mesh::edit::{EdgeSplit, MeshEdit, VertexCopy};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::FollowedEdits;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, Scene, build_model, build_world};
use glisson::workers::Sequential;
use glisson::world::{EditRefusal, StepInput, World};
use glisson_mesh::fault;
use std::fmt::Write as _;
use std::sync::Arc;

/// Laws that a model of any law is tried with, beside its own.
const TRIED_LAWS: [&str; 3] = ["linear", "st_venant_kirchhoff", "stable_neo_hooke"];

/// A model that can be cut, and a law of it; empty for springs.
type Case = (ModelKind, &'static str);

/// Every one, with each law that it names.
fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for kind in ModelKind::ALL.into_iter().filter(|kind| kind.row().edits != FollowedEdits::None) {
        let laws = kind.row().laws;
        cases.extend(laws.iter().map(|law| (kind, *law)));
        if laws.is_empty() {
            cases.push((kind, ""));
        }
        let others = TRIED_LAWS.into_iter().filter(|law| kind.row().follows_any_law && !laws.contains(law));
        cases.extend(others.map(|law| (kind, law)));
    }
    cases
}

/// No edit of these tests passes more places.
const MOST_PLACES: usize = 200;
const SIZE_M: DVec3 = DVec3::new(0.09, 0.06, 0.06);

fn mesh() -> TetMesh {
    shaken_block([3, 2, 2], SIZE_M, 0.1, 7)
}

/// A mesh as a list of nodes and tetrahedra, as scenes read it.
pub(crate) fn list_file(mesh: &TetMesh) -> String {
    let mut text = format!("{} {}\n", mesh.positions_m.len(), mesh.tetrahedra.len());
    for p in &mesh.positions_m {
        let mm = *p * 1e3;
        writeln!(text, "{} {} {}", mm.x, mm.y, mm.z).unwrap();
    }
    for [a, b, c, d] in mesh.tetrahedra.iter().map(|tet| tet.map(|n| n.0)) {
        writeln!(text, "{a} {b} {c} {d}").unwrap();
    }
    text
}

fn scene_text((kind, law): Case) -> String {
    let law = if law.is_empty() { String::new() } else { format!("law = \"{law}\"\n") };
    let contact = if kind.row().corrects_steps { "[contact]\nself = true\n" } else { "" };
    format!(
        "glisson_scene = 1\n[simulation]\ntime_step = \"0.1 ms\"\n\
         [organ]\nmesh = \"body.tet\"\nyoung_modulus = \"5 kPa\"\npoisson_ratio = 0.4\ndensity = \"1000 kg/m3\"\n\
         model = \"{kind}\"\n{law}damping = \"30 1/s\"\nvessels = \"vessels.csv\"\n\
         [[organ.fixed]]\nfurthest = {{ direction = [0, 0, -1], fraction = 0.1 }}\n\
         [[organ.load]]\nball = {{ center = [\"90 mm\", \"60 mm\", \"60 mm\"], radius = \"25 mm\" }}\n\
         force = [\"10 mN\", 0, 0]\n{contact}\
         [tool]\ntip_radius = \"8 mm\"\nfriction = 0.3\n\
         home_tip = [\"45 mm\", \"30 mm\", \"80 mm\"]\nhome_shaft = [0, 0, 1]\n"
    )
}

/// A world whose tool presses into the body.
fn touched_world(case: Case) -> (World, OrganBody) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("body.tet"), list_file(&mesh())).unwrap();
    let ends_m = [DVec3::new(0.0, 0.03, 0.03), DVec3::new(0.09, 0.03, 0.03)];
    let tube = Tube { parent: None, ends_m, radii_m: [2e-3; 2] };
    let mut vessels = Vec::new();
    write_vessels(&mut vessels, &[tube]).unwrap();
    std::fs::write(folder.path().join("vessels.csv"), vessels).unwrap();
    let scene = Scene::parse(&scene_text(case)).unwrap();
    let (mut world, body) = build_world(&scene, folder.path(), Arc::new(Sequential)).unwrap();
    steps(&mut world, 40);
    assert!(world.report().in_contact(), "{case:?}");
    (world, body.joint)
}

/// The tool goes down to 4 mm in the surface and stays there.
fn steps(world: &mut World, n: usize) {
    for _ in 0..n {
        let z_m = (0.08 - 4e-4 * world.steps_made() as f64).max(SIZE_M.z + 4e-3);
        let mut tool = world.tools()[0].home;
        tool.tip_in_world_m.z = z_m;
        world.step(&StepInput::of(&[tool]));
    }
}

/// Lists of edits, the first of which every model follows.
fn edits(world: &World) -> Vec<(&'static str, Vec<MeshEdit>)> {
    let topology = world.organ().body().topology();
    let middle = |tet: &TetId| {
        let corners_m = world.organ().mesh().corners_m(*tet);
        corners_m.iter().sum::<DVec3>().distance(4.0 * DVec3::new(0.045, 0.03, 0.04))
    };
    let mut near: Vec<TetId> = topology.live_tets().collect();
    near.sort_by(|a, b| middle(a).total_cmp(&middle(b)));
    let inner = (0..topology.n_nodes()).map(NodeId::from_index).find(|&n| topology.node_tets(n).len() > 8);
    let node = inner.unwrap();
    let copied = topology.node_tets(node)[..1].to_vec();
    let split = |tet: TetId| EdgeSplit { edge: topology.tet_edges(tet)[0], fraction: 0.5 };
    vec![
        ("removal", vec![MeshEdit::Remove { tets: near[..2].to_vec() }]),
        (
            "two removals",
            vec![MeshEdit::Remove { tets: vec![near[2]] }, MeshEdit::Remove { tets: vec![near[9]] }],
        ),
        ("split", vec![MeshEdit::Split { edges: vec![split(near[4])] }]),
        (
            "split and removal",
            vec![MeshEdit::Split { edges: vec![split(near[4])] }, MeshEdit::Remove { tets: vec![near[11]] }],
        ),
        (
            "copy of a node",
            vec![MeshEdit::DuplicateVertices { copies: vec![VertexCopy { node, tets: copied }] }],
        ),
    ]
}

/// Everything of two worlds that can be told apart, now and in what they do next.
fn assert_same(name: &str, world: &World, twin: &World) {
    assert_eq!(world.state_hash(), twin.state_hash(), "{name}");
    assert!(world.organ().body() == twin.organ().body(), "{name}: mesh");
    assert_eq!(world.organ().fixed_nodes(), twin.organ().fixed_nodes(), "{name}: supports");
    assert_eq!(world.organ().topology_version(), twin.organ().topology_version(), "{name}: version");
    assert_eq!(world.display_topology(), twin.display_topology(), "{name}: surface");
    assert_eq!(world.snapshot(), twin.snapshot(), "{name}: tools, contacts, blood");
    assert_eq!(world.n_edits_to_undo(), twin.n_edits_to_undo(), "{name}: journal");
    assert_eq!(world.ordered_model(), twin.ordered_model(), "{name}: ordered model");
    assert_eq!(world.load_forces(), twin.load_forces(), "{name}: loads");
}

/// Fails each place of each edit in turn; answers how many places there are.
fn fail_everywhere(name: &str, world: &mut World, twin: &mut World) -> Vec<&'static str> {
    let mut places = Vec::new();
    for (edit_name, list) in edits(world) {
        let name = format!("{name}, {edit_name}");
        for n_before in 0..=MOST_PLACES {
            assert!(n_before < MOST_PLACES, "{name}: an edit with so many places");
            let (done, failed) = fault::order(n_before, || world.edit_all(&list));
            let Some(place) = failed else {
                // A model that follows no such edit says so, with a fault or without.
                let expected = twin.edit_all(&list);
                assert_eq!(done, expected, "{name}");
                assert!(edit_name != "removal" || done.is_ok(), "{name}: {done:?}");
                break;
            };
            places.push(place);
            match done {
                Err(_) => {}
                // What only the waiting model could not follow is made without it.
                Ok(_) => panic!("{name}: an edit was made with a fault at {place}"),
            }
            assert_same(&format!("{name}, fault at {place}"), world, twin);
        }
        assert_same(&format!("{name}, after the edit"), world, twin);
        for world in [&mut *world, &mut *twin] {
            steps(world, 5);
        }
        assert_same(&format!("{name}, steps after the edit"), world, twin);
    }
    places
}

#[test]
fn a_fault_at_any_place_of_an_edit_leaves_every_bit_as_it_was_in_every_model() {
    for case in cases() {
        let name = format!("{} {}", case.0, case.1);
        let (mut world, _) = touched_world(case);
        let (mut twin, _) = touched_world(case);
        assert_same(&name, &world, &twin);
        let mut places = fail_everywhere(&name, &mut world, &mut twin);
        // The mesh, the model, and each of the world's own parts.
        assert!(places.len() >= 10, "{name}: {} faults", places.len());
        places.sort_unstable();
        places.dedup();
        for place in ["mesh: before an edit", "model: before it follows", "world: surface", "world: journal"]
        {
            assert!(places.contains(&place), "{name}: {place} was not among {places:?}");
        }
        // The way back is whole, too.
        while world.n_edits_to_undo() > 0 {
            assert!(world.undo_edit() && twin.undo_edit());
            assert_same(&format!("{name}, undone"), &world, &twin);
        }
        assert!(!twin.undo_edit());
    }
}

/// With a model that was delivered and waits to take over: it follows, is put back with the rest, and takes over.
#[test]
fn a_model_that_waits_to_take_over_is_put_back_with_the_rest() {
    for (before, kind) in [
        (ModelKind::TensorMass, ModelKind::Implicit),
        (ModelKind::Implicit, ModelKind::TensorMass),
        (ModelKind::Precomputed, ModelKind::Explicit),
    ] {
        let (case, name) = ((before, before.row().laws[0]), format!("{before} before {kind}"));
        let prepared = || {
            let (mut world, body) = touched_world(case);
            world.queue_model_swap(world.steps_made() + 3, kind);
            assert!(world.deliver_model(build_model(&body, kind).unwrap(), kind).unwrap());
            world
        };
        let (mut world, mut twin) = (prepared(), prepared());
        let list = edits(&world).swap_remove(0).1;
        for n_before in 0..=MOST_PLACES {
            let (done, failed) = fault::order(n_before, || world.edit_all(&list));
            let Some(place) = failed else { break };
            if done.is_ok() {
                // The fault was in the waiting model alone: the present one goes on, and the order is gone.
                assert_eq!(world.ordered_model(), None, "{name}: {place}");
                world = prepared();
            }
            assert_same(&format!("{name}, fault at {place}"), &world, &twin);
        }
        twin.edit_all(&list).unwrap();
        for world in [&mut world, &mut twin] {
            steps(world, 6);
            assert_eq!(world.model_kind(), kind);
        }
        assert_same(&name, &world, &twin);
    }
}

/// A fault while an instrument cuts: the cut is refused with a reason, and the world goes on.
#[test]
fn a_fault_under_an_instrument_is_told_and_the_next_cut_works() {
    for case in cases() {
        let (mut world, _) = touched_world(case);
        let near = world.touched_tetrahedra(0);
        let hash = world.state_hash();
        for n_before in 0..MOST_PLACES {
            let (done, failed) = fault::order(n_before, || world.remove_and_part(near.clone()));
            if failed.is_none() {
                done.unwrap();
                break;
            }
            if matches!(done, Err(EditRefusal::Ordered(_) | EditRefusal::Mesh(_) | EditRefusal::Model(_))) {
                assert_eq!(world.state_hash(), hash, "{case:?}");
            } else {
                // Parting was left out where it could not be done; the removal was made.
                assert!(done.is_ok() && world.undo_edit(), "{case:?}: {done:?}");
            }
        }
        steps(&mut world, 10);
        assert_eq!(world.report().n_non_finite_nodes, 0, "{case:?}");
    }
}
