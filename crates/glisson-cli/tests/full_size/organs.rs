//! From images to organs at full size: seeds, simplex meshes, several organs in one mesh.

use crate::{glisson, quality, real_ct};
use serde_json::Value;

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&glisson(arguments)).unwrap()
}

#[test]
fn a_real_liver_is_found_with_three_points() {
    let Some(ct) = real_ct() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| ct.join(name).to_str().unwrap().to_string();
    let (image, mask) = (at("cxr.nii.gz"), at("mask.nii.gz"));
    let liver = folder.path().join("liver.nii.gz");
    // The right lobe, the tip of the left one, the dome where the heart's contrast agent darkens it.
    let seeds = ["150,281,36", "279,385,31", "193,293,56"];
    let mut arguments = vec!["segment", &image, "--truth", &mask, "--label", "5", "--json"];
    arguments.extend(["-o", liver.to_str().unwrap()]);
    arguments.extend(seeds.into_iter().flat_map(|seed| ["--seed-voxel", seed]));
    let report = json(&arguments);
    assert!(report["dice"].as_f64().unwrap() >= 0.95, "{report}");
    assert!(report["hausdorff_95_m"].as_f64().unwrap() <= 4e-3, "{report}");
}

#[test]
fn a_real_liver_gets_a_simplex_mesh_that_can_be_filled() {
    let Some(ct) = real_ct() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let mask = ct.join("mask.nii.gz");
    let report =
        json(&["fit-simplex", mask.to_str().unwrap(), "--label", "5", "-o", &at("liver.stl"), "--json"]);
    let number = |path: &str| report.pointer(path).and_then(Value::as_f64).unwrap();
    assert!(6.0 * number("/n_triangles") <= number("/n_triangles_extracted") + 6.0, "{report}");
    // Voxels of 0.703 x 0.703 x 2.5 mm are as large as cubes of this side.
    let voxel_m = 1.073e-3;
    for way in ["to_data", "from_data"] {
        assert!(number(&format!("/{way}/mean_m")) <= 0.5 * voxel_m, "{way}: {report}");
        assert!(number(&format!("/{way}/p95_m")) <= voxel_m, "{way}: {report}");
    }
    assert!(number("/density_correlation") > 0.5, "{report}");
    assert!((number("/volume_m3") / number("/data_volume_m3") - 1.0).abs() < 1e-3, "{report}");
    let mesh = at("liver.vtu");
    glisson(&["mesh", &at("liver.stl"), "--tetrahedra", "20000", "-o", &mesh]);
    let quality = quality(mesh.as_ref());
    assert!(quality["min_dihedral_deg"].as_f64().unwrap() >= 10.0, "{quality}");
}

#[test]
fn five_organs_share_their_interfaces_in_200_000_tetrahedra() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    glisson(&["phantom", "--seed", "1", "--out", folder.path().to_str().unwrap()]);
    let organs = ["liver", "liver_tumour", "portal_vein", "hepatic_vein", "gall_bladder"];
    let (labels, mesh, surfaces) = (at("labels.nii.gz"), at("organs.vtu"), at("surfaces"));
    let mut arguments = vec!["mesh-organs", &labels, "--tetrahedra", "200000", "-o", &mesh];
    arguments.extend(["--surfaces", &surfaces, "--json"]);
    arguments.extend(organs.into_iter().flat_map(|organ| ["--label", organ]));
    let report = json(&arguments);
    let number = |value: &Value, key: &str| value[key].as_f64().unwrap();
    assert!((number(&report, "n_tets") / 200_000.0 - 1.0).abs() <= 0.05, "{report}");
    assert!(number(&report, "min_dihedral_deg") >= 8.0, "{report}");
    for organ in report["labels"].as_array().unwrap() {
        let error = number(organ, "volume_m3") / number(organ, "voxel_volume_m3") - 1.0;
        assert!(error.abs() <= 0.015, "{organ}");
    }
    assert_eq!(std::fs::read_dir(&surfaces).unwrap().count(), organs.len());
    let quality = quality(mesh.as_ref());
    assert_eq!(quality["tetrahedra"], report["n_tets"], "{quality}");
}
