//! The table of models: what each row says holds for the model that it makes.

use crate::model_meshes::{block, held, nodes_below};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit};
use glisson_mesh::mesh::{EdgeId, NodeId, TetId};
use glisson_tissue::material::{LAWS, LawChoice, LinearElastic, PronyTerm, law_named};
use glisson_tissue::model::kind::{MODELS, ModelKind, build_model, build_model_as_cut};
use glisson_tissue::model::nonlinear_tensor_mass::Fibre;
use glisson_tissue::model::{
    Attachment, DeformableModel, FollowedEdits, MeasuredSample, ModelError, ModelMotion, ModelRow, OrganBody,
    StepAnswer, TissueParts,
};
use std::path::Path;

/// Stable for every model of explicit dynamics.
const SHORT_STEP_S: f64 = 1e-4;
/// Stable for none.
const LONG_STEP_S: f64 = 1.0;

/// A cube on a table, and curves to follow in a file of `folder`.
fn cube(folder: &Path) -> OrganBody {
    let mesh = block([4, 4, 4], DVec3::splat(0.1));
    let fixed = held(&nodes_below(&mesh, 2, 0.01));
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
    let curve = folder.join("curve.csv");
    std::fs::write(&curve, "axial_displacement_mm,force_mn\n0,0\n1,90\n2,200\n3,340\n4,520\n5,760\n6,1100\n")
        .unwrap();
    let measured = Some(MeasuredSample { curve, height_m: 0.02, radius_m: 0.01, degree: 4 });
    OrganBody { fixed, measured, ..OrganBody::new(mesh, material, SHORT_STEP_S) }
}

/// Calls `check` with every kind, its row and a fresh cube.
fn for_each_row(check: impl Fn(ModelKind, &ModelRow, OrganBody)) {
    let folder = tempfile::tempdir().unwrap();
    for kind in ModelKind::ALL {
        check(kind, kind.row(), cube(folder.path()));
    }
}

fn build(body: &OrganBody, kind: ModelKind) -> Box<dyn DeformableModel> {
    build_model(body, kind).unwrap_or_else(|error| panic!("{kind}: {error}: {error:?}"))
}

#[test]
fn the_table_of_models_is_sound() {
    // Sessions, scenes and the viewer know them by these names; messages list them in this order.
    let names: Vec<&str> = MODELS.iter().map(|row| row.name).collect();
    let expected = "precomputed, tensor_mass, nonlinear_tensor_mass, explicit, implicit, mass_spring, extended_mass_spring, \
                    hybrid, reduced, quasi_nonlinear";
    assert!(names.join(", ").starts_with(expected), "new models stand at the end: {names:?}");
    assert_eq!(names, ModelKind::ALL.map(ModelKind::name));
    for kind in ModelKind::ALL {
        let row = kind.row();
        assert_eq!(ModelKind::by_name(row.name), Some(kind), "a name is there once");
        // A session writes the kind's own name.
        let written = serde_json::to_string(&kind).unwrap();
        assert_eq!(written, format!("\"{}\"", row.name));
        assert_eq!(serde_json::from_str::<ModelKind>(&written).unwrap(), kind);
        assert_eq!(kind.to_string(), row.name);
        assert!(!row.about.is_empty(), "{kind}");
    }
    assert_eq!(ModelKind::by_name("no_such_model"), None);
}

#[test]
fn each_model_is_made_with_each_law_that_its_row_names() {
    for_each_row(|kind, row, mut body| {
        build(&body, kind);
        for law in kind.laws() {
            assert!(row.follows(law));
            let entry = LAWS.into_iter().find(|entry| entry.name == law);
            let entry = entry.unwrap_or_else(|| panic!("{kind} names the law {law}, which is in no table"));
            body.law = Some(LawChoice::typical(entry));
            build(&body, kind);
        }
        assert_eq!(row.follows("a_law_from_outside"), row.follows_any_law, "{kind}");
        if !row.follows_any_law {
            // It gives way to the model's own.
            body.law = law_named("mooney_rivlin");
            build(&body, kind);
        }
    });
}

fn half_of_softer_tissue(body: &OrganBody) -> TissueParts {
    let OrganBody { mesh, material, .. } = body;
    let young_modulus_pa = 0.5 * material.young_modulus_pa();
    let softer = LinearElastic::from_young_poisson(
        young_modulus_pa,
        material.poisson_ratio(),
        material.density_kg_per_m3(),
    );
    let n_tets = mesh.tetrahedra.len();
    TissueParts {
        materials: vec![softer.unwrap()],
        of_tet: (0..n_tets).map(|t| (2 * t < n_tets).then_some(0)).collect(),
    }
}

#[test]
fn what_a_row_says_that_a_model_lacks_is_refused() {
    let fibre = Fibre { lambda_along_pa: 2e4, mu_along_pa: 8e3, direction: DVec3::X };
    let sagged_m = |mut model: Box<dyn DeformableModel>| {
        model.set_gravity(DVec3::new(3.0, 0.0, -9.0));
        (0..20).for_each(|_| model.step(SHORT_STEP_S));
        model.state().positions_m.to_vec()
    };
    for_each_row(|kind, row, body| {
        let plain_m = sagged_m(build(&body, kind));
        let asked = [
            (row.has_fibres, "fibres", OrganBody { fibre: Some(fibre), ..body.clone() }),
            (
                row.has_fibres,
                "penalties of volume changes",
                OrganBody { volume_penalty_pa: 1e4, ..body.clone() },
            ),
            (
                row.relaxes,
                "relaxation terms",
                OrganBody { relaxation: vec![PronyTerm { share: 0.3, time_s: 0.1 }], ..body.clone() },
            ),
            (
                row.has_tissue_parts,
                "parts of other tissue",
                OrganBody { tissue_parts: Some(half_of_softer_tissue(&body)), ..body.clone() },
            ),
        ];
        for (knows, what, body) in asked {
            match build_model(&body, kind) {
                Ok(model) => {
                    assert!(knows, "{kind}: {what}");
                    assert!(sagged_m(model) != plain_m, "{kind} does nothing with {what}");
                }
                Err(ModelError::Unsupported { model, what: lacking }) => {
                    assert_eq!((model, lacking, knows), (row.name, what, false));
                }
                Err(error) => panic!("{kind}, {what}: {error}"),
            }
        }
        let without_curves = OrganBody { measured: None, ..body.clone() };
        assert_eq!(build_model(&without_curves, kind).is_err(), row.follows_curves, "{kind}");
        // A model is either made with a ligament or says in these words that it has none.
        let highest = NodeId::from_index(body.mesh.positions_m.len() - 1);
        let (anchor_m, slack_length_m, stiffness_n_per_m) = (DVec3::splat(0.15), 0.0866, 5.0);
        let ligament = Attachment { node: highest, anchor_m, slack_length_m, stiffness_n_per_m };
        if let Err(error) = build_model(&OrganBody { attachments: vec![ligament], ..body }, kind) {
            let text = format!("{error}: {error:?}");
            assert!(!row.corrects_steps && text.to_lowercase().contains("ligament"), "{kind}: {text}");
        }
    });
}

#[test]
fn each_model_moves_and_answers_to_contact_as_its_row_says() {
    for_each_row(|kind, row, mut body| {
        let mut model = build(&body, kind);
        model.set_gravity(DVec3::new(0.0, 0.0, -1.0));
        (0..3).for_each(|_| model.step(SHORT_STEP_S));
        let rest_m = &body.mesh.positions_m;
        let moved = model.state().positions_m.iter().zip(rest_m).any(|(x, rest)| x != rest);
        assert!(moved && model.state().positions_m.iter().all(|x| x.is_finite()), "{kind}");
        let has_velocities = !model.state().velocities_m_per_s.is_empty();
        assert_eq!(has_velocities, row.motion != ModelMotion::QuasiStatic, "{kind}");
        let corrects = matches!(model.step_answer(), StepAnswer::NodeByNode | StepAnswer::Coupled { .. });
        assert_eq!(corrects, row.corrects_steps, "{kind}");
        body.time_step_s = LONG_STEP_S;
        assert_eq!(build_model(&body, kind).is_err(), row.motion == ModelMotion::Explicit, "{kind}");
    });
}

#[test]
fn each_model_follows_the_edits_that_its_row_says() {
    for_each_row(|kind, row, body| {
        let follows = |edit: &MeshEdit| {
            let mut model = build(&body, kind);
            let mut mesh = EditableMesh::new(body.mesh.clone()).unwrap();
            let change = mesh.apply(edit).unwrap();
            let followed =
                model.topology_refusal().is_none() && model.topology_changed(mesh.mesh(), &change).is_ok();
            model.step(SHORT_STEP_S);
            assert!(model.state().positions_m.iter().all(|x| x.is_finite()), "{kind}");
            followed
        };
        let removal = MeshEdit::Remove { tets: vec![TetId(200), TetId(371)] };
        let split = MeshEdit::Split { edges: vec![EdgeSplit { edge: EdgeId(100), fraction: 0.4 }] };
        let expected = match row.edits {
            FollowedEdits::None => [false, false],
            FollowedEdits::Removals => [true, false],
            FollowedEdits::All => [true, true],
        };
        assert_eq!([follows(&removal), follows(&split)], expected, "{kind}");
        // Made of what is left, or of the whole.
        let mut live = vec![true; body.mesh.tetrahedra.len()];
        live[200] = false;
        assert!(build_model_as_cut(&body, kind, &live).is_ok(), "{kind}");
    });
}

/// The cells of the row of a table in a document whose first cell is this name.
fn cells_of<'a>(document: &'a str, name: &str) -> Option<Vec<&'a str>> {
    let row = document.lines().find(|line| line.starts_with(&format!("| `{name}` |")))?;
    Some(row.trim_matches('|').split('|').map(str::trim).collect())
}

/// docs/models.md has a row of every model; docs/scene.md one with its laws, whether it can be cut and its time step.
#[test]
fn the_documentation_has_a_row_for_every_model() {
    let read = |name: &str| {
        std::fs::read_to_string(format!("{}/../../docs/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
    };
    let (models, scene) = (read("models.md"), read("scene.md"));
    for kind in ModelKind::ALL {
        let row = kind.row();
        assert!(cells_of(&models, row.name).is_some(), "docs/models.md lacks a row for {kind}");
        let cells =
            cells_of(&scene, row.name).unwrap_or_else(|| panic!("docs/scene.md lacks a row for {kind}"));
        let [_, laws, _, can_be_cut, time_step] = cells[..] else { panic!("{kind}: {cells:?}") };
        let named: Vec<&str> = laws.split('`').skip(1).step_by(2).collect();
        assert_eq!(named, kind.laws(), "docs/scene.md on the laws of {kind}");
        let expected = if row.edits == FollowedEdits::None { "no" } else { "yes" };
        assert_eq!(can_be_cut, expected, "docs/scene.md on cuts of {kind}");
        let takes_any = time_step.starts_with("any");
        assert_eq!(
            takes_any,
            row.motion != ModelMotion::Explicit,
            "docs/scene.md on the time step of {kind}"
        );
    }
}
