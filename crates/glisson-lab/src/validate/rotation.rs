//! A cube that is turned as a whole, linear and non-linear (seed `002`, fig. 2).
//!
//! Linear elasticity takes a rotation by theta for a strain (cos theta - 1) across its axis. A linear body that is
//! turned and let go therefore swells until it has the displacements of the infinitesimal rotation of the same
//! moment, sin theta k x X: its volume has grown by sin^2 theta. Both are exact, whatever the mesh.

use super::{Experiment, Figure, Outcome};
use crate::bodies::{
    LAMBDA_PA, MU_PA, displacements, isotropic, largest, linear_model, material, most, nonlinear_model,
    relax, volume_change,
};
use glisson::math::{DMat3, DVec3};
use glisson::mesh::box_mesh::cube_of_five;
use glisson::model::DeformableModel;
use glisson::model::nonlinear_tensor_mass::NonlinearPart;
use glisson_view::plot::{LinePlot, Series, SeriesStyle};

const SEED: &str = "Picinbono, Delingette and Ayache 2000, RR-4028, s. 2.2, fig. 2";
const EXACT: &str = "exact: strain (cos theta - 1) across the axis";
const SIDE_M: f64 = 0.05;
const NODES_A_SIDE: usize = 5;
const ANGLES_DEG: [f64; 6] = [15.0, 30.0, 45.0, 60.0, 75.0, 90.0];
/// Not along an edge of the cube.
const AXIS: DVec3 = DVec3::new(1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0);
/// Damping of the cube that is let go [1/s].
const DAMPING_PER_S: f64 = 100.0;
const AT_REST_M: f64 = 1e-12;
const MOST_STEPS: usize = 20_000;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mesh = cube_of_five(NODES_A_SIDE, SIDE_M);
    let material = material()?;
    let mut linear = linear_model(&mesh, &material, &[], DAMPING_PER_S)?;
    let mut nonlinear = nonlinear_model(&mesh, isotropic(&material), &[], DAMPING_PER_S)?;
    let (mut swelling, mut expected_swelling, mut steady) = (Vec::new(), Vec::new(), Vec::new());
    let [mut energy_error, mut swelling_error, mut force_share, mut drift, mut growth] = [0.0_f64; 5];
    let mut rows = String::new();
    for angle_deg in ANGLES_DEG {
        let angle = angle_deg.to_radians();
        let rotation = DMat3::from_axis_angle(AXIS, angle);
        let centre_m = DVec3::splat(0.5 * SIDE_M);
        let turned_m: Vec<DVec3> =
            mesh.positions_m.iter().map(|&p| centre_m + rotation * (p - centre_m)).collect();
        let turned_u_m: Vec<DVec3> = turned_m.iter().zip(&mesh.positions_m).map(|(p, r)| *p - *r).collect();

        // Energy and forces of the turned cube.
        linear.take_over(&turned_m);
        let strain = angle.cos() - 1.0;
        let expected_j = 2.0 * (LAMBDA_PA + MU_PA) * strain * strain * mesh.volume_m3();
        energy_error = most([energy_error, (linear.energy_j() / expected_j - 1.0).abs()]);
        let mut force_n = vec![DVec3::ZERO; turned_m.len()];
        nonlinear.set_nonlinear_part(NonlinearPart::AboveDisplacement { threshold_m: f64::INFINITY });
        nonlinear.elastic_forces_into(&turned_u_m, &mut force_n);
        let linear_n = largest(&force_n);
        nonlinear.set_nonlinear_part(NonlinearPart::Everywhere);
        nonlinear.elastic_forces_into(&turned_u_m, &mut force_n);
        force_share = most([force_share, largest(&force_n) / linear_n]);

        // Let go.
        let step_s = linear.time_step_s();
        relax(&mut linear, step_s, AT_REST_M, MOST_STEPS)?;
        let linear_growth = volume_change(&mesh, &displacements(&mesh, &linear));
        let expected_growth = angle.sin().powi(2);
        swelling_error = most([swelling_error, (linear_growth - expected_growth).abs()]);
        nonlinear.take_over(&turned_m);
        let step_s = nonlinear.time_step_s();
        for _ in 0..2_000 {
            nonlinear.step(step_s);
        }
        let now_m = nonlinear.state().positions_m;
        let moved_m = now_m.iter().zip(&turned_m).map(|(a, b)| a.distance(*b));
        drift = most(moved_m.chain([drift]));
        let nonlinear_growth = volume_change(&mesh, &displacements(&mesh, &nonlinear));
        growth = most([growth, nonlinear_growth.abs()]);
        swelling.push([angle_deg, 100.0 * linear_growth]);
        steady.push([angle_deg, 100.0 * nonlinear_growth]);
        rows += &format!(
            "| {angle_deg} | {:.1} | {:.4} | {:.4} | {nonlinear_growth:.1e} |\n",
            1e3 * linear_n,
            100.0 * linear_growth,
            100.0 * expected_growth,
        );
    }
    for degree in 0..=90 {
        let angle_deg = f64::from(degree);
        expected_swelling.push([angle_deg, 100.0 * angle_deg.to_radians().sin().powi(2)]);
    }
    let experiments = vec![
        Experiment::at_most("turned linear cube: its energy, relative", EXACT, energy_error, 1e-10),
        Experiment::at_most(
            "linear cube let go: growth of its volume, from sin^2 of the angle",
            "exact: conserved moment of the linear model",
            swelling_error,
            1e-6,
        ),
        Experiment::at_most(
            "turned non-linear cube: largest nodal force over the linear one",
            SEED,
            force_share,
            1e-10,
        ),
        Experiment::at_most(
            "non-linear cube let go: largest motion over its side",
            SEED,
            drift / SIDE_M,
            1e-9,
        ),
        Experiment::at_most("non-linear cube let go: change of its volume, relative", SEED, growth, 1e-9),
    ];
    let series = |name: &str, points, style| Series { name: name.into(), points, style };
    let plot = LinePlot {
        title: "A cube turned and let go".into(),
        x_label: "angle [degrees]".into(),
        y_label: "change of volume [%]".into(),
        series: vec![
            series("linear", swelling, SeriesStyle::Points),
            series("sin^2 of the angle", expected_swelling, SeriesStyle::Dashed),
            series("non-linear", steady, SeriesStyle::Points),
        ],
        size: [720, 440],
    };
    let caption =
        "A cube turned as a whole and let go: the linear one swells, the non-linear one keeps its volume."
            .to_owned();
    let notes = format!(
        "A cube of {} mm, {NODES_A_SIDE} nodes a side and {} tetrahedra is turned about an axis along none of its edges, and let go.\n\n\
         | angle [degrees] | largest nodal force of the linear model [mN] | growth of its volume [%] | expected [%] | \
         growth of the non-linear cube |\n|---|---|---|---|---|\n{rows}\n\
         Agrees: the growing volume of the report's figure 2 and that the non-linear model knows no such growth. The \
         report prints no numbers for it; the expected ones are exact.",
        1e3 * SIDE_M,
        mesh.tetrahedra.len(),
    );
    Ok(Outcome { experiments, figures: vec![Figure { file: "rotation_volume.svg", caption, plot }], notes })
}
