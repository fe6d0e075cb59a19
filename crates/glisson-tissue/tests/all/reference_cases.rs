//! Our own finite-element solutions (P1, total Lagrangian with the linear law; CalculiX agrees to its printed
//! digits): displacements and reactions of beam, cylinder and patch.

use std::path::{Path, PathBuf};

use glisson_mesh::math::DVec3;
use glisson_tissue::solve::case::{
    CaseBytes, CaseError, parse_case, parse_vectors, read_case, write_vectors,
};
use glisson_tissue::solve::{StaticProblem, StaticSolution, add_gravity_forces, solve_static};
use proptest::prelude::*;

use crate::model_meshes::relative_difference;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/reference").join(name)
}

fn solve(name: &str) -> StaticSolution {
    let case = read_case(&folder(name)).unwrap();
    let mut nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
    add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut nodal_force_n);
    solve_static(&StaticProblem {
        mesh: &case.mesh,
        material: &case.material,
        conditions: &case.conditions,
        nodal_force_n: &nodal_force_n,
    })
    .unwrap()
}

fn vectors(name: &str, file: &str) -> Vec<DVec3> {
    let file = folder(name).join(file);
    parse_vectors(&file, &std::fs::read(&file).unwrap()).unwrap()
}

fn check(name: &str) {
    let solution = solve(name);
    let u = relative_difference(&solution.displacement_m, &vectors(name, "u_np_linear.csv"));
    assert!(u < 1e-8, "{name}: displacement off by {u:e}");
    let r = relative_difference(&solution.reaction_n, &vectors(name, "reactions_np_linear.csv"));
    assert!(r < 1e-8, "{name}: reactions off by {r:e}");
}

#[test]
fn beam_agrees() {
    check("beam");
}

#[test]
fn cylinder_agrees() {
    check("cylinder");
    let case = read_case(&folder("cylinder")).unwrap();
    let top_n: f64 = solve("cylinder")
        .reaction_n
        .iter()
        .zip(&case.mesh.positions_m)
        .filter(|(_, x)| x.z > 0.049)
        .map(|(f, _)| f.x)
        .sum();
    assert!((top_n - 0.135672).abs() < 1e-6, "{top_n}");
}

#[test]
fn patch_agrees_and_is_affine() {
    check("patch");
    let case = read_case(&folder("patch")).unwrap();
    let affine =
        |p: DVec3| DVec3::new(0.05 * p.x + 0.1 * p.y, -0.03 * p.y + 0.04 * p.z, 0.02 * p.x + 0.06 * p.z);
    for (u, &p) in solve("patch").displacement_m.iter().zip(&case.mesh.positions_m) {
        assert!((*u - affine(p)).length() <= 1e-15, "{u} at {p}");
    }
}

#[test]
fn written_vectors_read_back_to_the_same_bits() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("u.csv");
    let vectors = vec![DVec3::new(0.1, -1.0 / 3.0, 5e-324), DVec3::new(-0.0, 1.7976931348623157e308, 1e-9)];
    write_vectors(&file, "ux,uy,uz (m)", &vectors).unwrap();
    let read = parse_vectors(&file, &std::fs::read(&file).unwrap()).unwrap();
    for (a, b) in read.iter().zip(&vectors) {
        assert_eq!(a.to_array().map(f64::to_bits), b.to_array().map(f64::to_bits));
    }
}

fn tiny() -> CaseBytes {
    CaseBytes {
        nodes: b"# x,y,z\n0,0,0\n1,0,0\n0,1,0\n0,0,1\n".to_vec(),
        tets: b"0,1,2,3\n".to_vec(),
        dirichlet: b"0,0,0\n0,1,0\n0,2,1e-3\n".to_vec(),
        load: br#"{"E": 5000.0, "nu": 0.45, "rho": 1000, "gravity": [0, 0, -9.81]}"#.to_vec(),
    }
}

#[test]
fn errors_name_file_line_and_what_was_found() {
    let message = |bytes: &CaseBytes| parse_case(Path::new("d"), bytes).unwrap_err().to_string();
    assert!(parse_case(Path::new("d"), &tiny()).is_ok());
    let with = |change: &dyn Fn(&mut CaseBytes)| {
        let mut bytes = tiny();
        change(&mut bytes);
        message(&bytes)
    };
    let found = with(&|b| b.nodes = b"0,0,0\n\n1,x,0\n".to_vec());
    assert_eq!(found, "d/nodes.csv:3: `x` is not a finite number");
    let found = with(&|b| b.nodes = b"0,0,0\n1,nan,0\n".to_vec());
    assert_eq!(found, "d/nodes.csv:2: `nan` is not a finite number");
    let found = with(&|b| b.tets = b"0,1,2\n".to_vec());
    assert_eq!(found, "d/tets.csv:1: 3 fields, expected n0,n1,n2,n3");
    let found = with(&|b| b.tets = b"0,1,2,4\n".to_vec());
    assert_eq!(found, "d/tets.csv:1: node 4 does not exist; nodes.csv has 4 (numbered from 0)");
    let found = with(&|b| b.dirichlet = b"0,3,0\n".to_vec());
    assert_eq!(found, "d/dirichlet.csv:1: `3` is not a component: 0 (x), 1 (y) or 2 (z)");
    let found = with(&|b| b.dirichlet = b"0,0,0\n0,0,1\n".to_vec());
    assert!(found.starts_with("d/dirichlet.csv:2: component 0 of node 0 is prescribed twice"), "{found}");
    let found = with(&|b| b.tets = vec![b'0', 0xff]);
    assert_eq!(found, "d/tets.csv: byte 1 is not UTF-8 text");
    let found = with(&|b| b.load = br#"{"E": 5000.0, "nu": 0.5, "rho": 1, "gravity": [0,0,0]}"#.to_vec());
    assert!(found.contains("d/load.json: Poisson's ratio is 0.5"), "{found}");
    let found = with(&|b| b.load = br#"{"E": 5000.0, "nu": 0.3}"#.to_vec());
    assert!(found.contains("d/load.json") && found.contains("rho"), "{found}");
    let missing = read_case(Path::new("no/such/folder")).unwrap_err();
    assert!(matches!(missing, CaseError::Io { .. }));
    assert!(missing.to_string().contains("no/such/folder/nodes.csv"), "{missing}");
}

proptest! {
    /// Mutated and truncated bytes give a case or an error, never a panic; what is a case can be solved or is
    /// refused.
    #[test]
    fn mutated_cases_never_panic(
        file in 0usize..4,
        cut in 0usize..200,
        changes in prop::collection::vec((0usize..200, any::<u8>()), 0..6),
    ) {
        let mut bytes = tiny();
        let target = match file {
            0 => &mut bytes.nodes,
            1 => &mut bytes.tets,
            2 => &mut bytes.dirichlet,
            _ => &mut bytes.load,
        };
        for (place, value) in changes {
            let n = target.len();
            target[place % n] = value;
        }
        if cut < 100 {
            target.truncate(cut);
        }
        if let Ok(case) = parse_case(Path::new("d"), &bytes) {
            let nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
            let _ = solve_static(&StaticProblem {
                mesh: &case.mesh,
                material: &case.material,
                conditions: &case.conditions,
                nodal_force_n: &nodal_force_n,
            });
        }
    }
}
