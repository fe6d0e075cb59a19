//! Weight, supports along single axes, ligaments, stress at rest, damping and what goes wrong: what all explicit
//! models have in common.

use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::{Attachment, FixedNode, RestStress};
use glisson::solve::{SolveError, add_gravity_forces, equilibrating_stress, stress_forces_into};

use crate::model_meshes::{nodes_below, rounded_block, shaken_block};

const GRAVITY_M_PER_S2: DVec3 = DVec3::new(0.0, 0.0, -9.81);

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

/// Some 2,000 tetrahedra, rounded as an organ, 15 x 10 x 6 cm.
fn organ() -> TetMesh {
    rounded_block([9, 7, 5], DVec3::new(0.15, 0.10, 0.06))
}

/// The lower nodes lie on a table that does not hold them sideways; a few behind are grown to it.
fn supports(mesh: &TetMesh) -> Vec<FixedNode> {
    let grown = nodes_below(mesh, 1, -0.03);
    assert!(grown.len() > 5);
    let mut fixed: Vec<FixedNode> = grown.iter().map(|&node| FixedNode::all_axes(node)).collect();
    for node in nodes_below(mesh, 2, -0.02) {
        if !grown.contains(&node) {
            fixed.push(FixedNode { node, axes: [false, false, true] });
        }
    }
    assert!(fixed.len() > grown.len() + 10);
    fixed
}

/// A ligament that is a little stretched at rest, from the highest node upwards.
fn ligament(mesh: &TetMesh) -> Attachment {
    let height = |&n: &usize| mesh.positions_m[n].z;
    let highest = (0..mesh.positions_m.len()).max_by(|a, b| height(a).total_cmp(&height(b))).unwrap();
    Attachment {
        node: NodeId::from_index(highest),
        anchor_m: mesh.positions_m[highest] + DVec3::new(0.01, 0.0, 0.04),
        slack_length_m: 0.04,
        stiffness_n_per_m: 50.0,
    }
}

/// Forces of the stress minus the loads, over the largest nodal weight, at components that are not held.
fn unbalanced(
    mesh: &TetMesh,
    fixed: &[FixedNode],
    attachments: &[Attachment],
    stress_pa: &[RestStress],
) -> f64 {
    let mut weight_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(mesh, &material(), GRAVITY_M_PER_S2, &mut weight_n);
    let largest_n = weight_n.iter().map(|f| f.length()).fold(0.0, f64::max);
    let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    stress_forces_into(mesh, stress_pa, &mut force_n);
    for attachment in attachments {
        let n = attachment.node.index();
        force_n[n] -= attachment.force_n(mesh.positions_m[n]);
    }
    let mut off_n = 0.0_f64;
    for n in 0..force_n.len() {
        let held = fixed.iter().find(|f| f.node.index() == n).map_or([false; 3], |f| f.axes);
        for axis in (0..3).filter(|&axis| !held[axis]) {
            off_n = off_n.max((force_n[n] - weight_n[n])[axis].abs());
        }
    }
    off_n / largest_n
}

#[test]
fn the_equilibrating_stress_carries_the_weight_in_the_rest_shape() {
    for mesh in [organ(), shaken_block([6, 5, 4], DVec3::new(0.15, 0.10, 0.06), 0.1, 4)] {
        let mut fixed = supports(&organ());
        if mesh.positions_m.len() != organ().positions_m.len() {
            fixed = nodes_below(&mesh, 0, 0.02).into_iter().map(FixedNode::all_axes).collect();
        }
        for attachments in [&[][..], &[ligament(&mesh)]] {
            let stress_pa =
                equilibrating_stress(&mesh, &material(), &fixed, attachments, GRAVITY_M_PER_S2).unwrap();
            let off = unbalanced(&mesh, &fixed, attachments, &stress_pa);
            assert!(off <= 1e-12, "{off:e}");
            let nothing = vec![[0.0; 6]; stress_pa.len()];
            assert!(unbalanced(&mesh, &fixed, attachments, &nothing) > 0.5);
        }
    }
}

/// A column on a table that does not hold it sideways carries just what stands above.
#[test]
fn a_column_has_the_pressure_of_what_stands_on_it() {
    let mesh = crate::model_meshes::block([1, 1, 20], DVec3::new(0.01, 0.01, 0.2));
    let mut fixed: Vec<FixedNode> = nodes_below(&mesh, 2, 1e-6)
        .into_iter()
        .map(|node| FixedNode { node, axes: [false, false, true] })
        .collect();
    fixed[0].axes = [true; 3];
    fixed[1].axes = [false, true, true];
    let stress_pa = equilibrating_stress(&mesh, &material(), &fixed, &[], GRAVITY_M_PER_S2).unwrap();
    let layer_n = 1060.0 * 1e-4 * 0.01 * 9.81;
    for layer in 0..20 {
        // Each layer of six carries, on average, what is above its middle.
        let mean_pa = (0..6).map(|i| stress_pa[6 * layer + i][2]).sum::<f64>() / 6.0;
        let expected_pa = -layer_n / 1e-4 * (19.5 - layer as f64);
        assert!((mean_pa - expected_pa).abs() <= 1e-9 * layer_n / 1e-4, "{layer}: {mean_pa} {expected_pa}");
    }
}

#[test]
fn what_floats_or_does_not_exist_has_no_equilibrating_stress() {
    let mesh = organ();
    let solve = |fixed: &[FixedNode], attachments: &[Attachment], gravity: DVec3| {
        equilibrating_stress(&mesh, &material(), fixed, attachments, gravity).unwrap_err()
    };
    let fixed = supports(&mesh);
    assert!(matches!(solve(&[], &[ligament(&mesh)], GRAVITY_M_PER_S2), SolveError::Floating { .. }));
    let nowhere = Attachment { node: NodeId(100_000), ..ligament(&mesh) };
    assert!(matches!(solve(&fixed, &[nowhere], GRAVITY_M_PER_S2), SolveError::ConditionOutOfRange { .. }));
    assert!(matches!(solve(&fixed, &[], GRAVITY_M_PER_S2 * f64::NAN), SolveError::NonFiniteCondition { .. }));
}
