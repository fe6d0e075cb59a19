//! The bits of an implicit body do not depend on the threads.

use crate::implicit::{bits, body, clamped};
use crate::model_meshes::{nodes_below, shaken_block};
use crate::team::team;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;
use glisson_tissue::material::{LinearElastic, Ogden, OgdenTerm, StableNeoHooke};
use glisson_tissue::model::implicit::{
    ImplicitEuler, ImplicitLaw, ImplicitParams, Preconditioner, VolumeResistance,
};
use glisson_tissue::model::{
    Answered, Constraints, Correction, DeformableModel, ImposedDisplacement, NodalForce,
};

const SIZE_M: DVec3 = DVec3::new(0.12, 0.1, 0.08);

#[test]
fn steps_and_corrections_have_the_same_bits_at_any_number_of_threads() {
    let mesh = shaken_block([8, 8, 8], SIZE_M, 0.15, 12);
    let fixed = clamped(&nodes_below(&mesh, 2, 0.002));
    let linear = LinearElastic::from_young_poisson(5e3, 0.45, 1000.0).unwrap();
    let stable = StableNeoHooke::from(&linear);
    let ogden = Ogden::new(&[OgdenTerm { mu_pa: 1_500.0, exponent: -4.7 }], 1e4).unwrap();
    let top: Vec<NodeId> = (0..mesh.positions_m.len())
        .filter(|n| mesh.positions_m[*n].distance(SIZE_M * DVec3::new(0.5, 0.5, 1.0)) < 0.03)
        .map(NodeId::from_index)
        .collect();
    for (law, volume, by) in [
        (ImplicitLaw::neo_hooke(&linear), VolumeResistance::Element, Preconditioner::TwoGrid),
        (ImplicitLaw::neo_hooke(&linear), VolumeResistance::NodeAveragedStrain, Preconditioner::Factor),
        (stable.into(), VolumeResistance::Element, Preconditioner::Factor),
        (ImplicitLaw::shared(ogden), VolumeResistance::Element, Preconditioner::TwoGrid),
    ] {
        let params = ImplicitParams::new(body(&mesh, &fixed), &law);
        let built = ImplicitEuler::build(&ImplicitParams { volume, preconditioner: by, ..params }).unwrap();
        let after = |n_threads: usize| {
            let mut model = built.clone();
            model.set_workers(team(n_threads));
            let mut moved_m = vec![DVec3::ZERO; mesh.positions_m.len()];
            for step in 1..=6 {
                // A push, then a pull by a tool that is fast enough to turn tetrahedra inside out.
                let mut inputs = Constraints::default();
                let way_m = DVec3::new(0.4, 0.1, -1.0) * 0.01 * f64::from(step - 3);
                for &node in &top {
                    if step < 4 {
                        inputs.forces.push(NodalForce { node, force_n: DVec3::new(0.01, 0.0, -0.02) });
                    } else {
                        inputs.displacements.push(ImposedDisplacement { node, displacement_m: way_m });
                    }
                }
                model.apply(&inputs);
                model.step(0.01);
                let pull = [NodalForce { node: NodeId::from_index(300), force_n: DVec3::X * 0.02 }];
                model.answer_into(&pull, &mut moved_m, Answered::Everywhere);
                model.correct_step(&pull, 0.01, Correction::Motion);
            }
            let moved = moved_m.iter().flat_map(DVec3::to_array).map(f64::to_bits);
            let energy = model.energy_j().to_bits();
            (bits(&model), moved.chain([energy]).collect::<Vec<u64>>())
        };
        let expected = after(1);
        for n_threads in [2, 3] {
            assert!(after(n_threads) == expected, "{law:?} {volume:?} {by:?}: {n_threads} threads");
        }
    }
}
