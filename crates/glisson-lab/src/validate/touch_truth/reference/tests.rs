use super::super::judgement::{sneddon, square_over_round};
use super::table::{DEPTHS, Law, POISSON_RATIO, block, compute, reference_force};
use super::*;

#[test]
fn a_large_body_answers_like_a_half_space() {
    let large = Cylinder { radius: 100.0, height: 100.0 };
    let forces = compute(Law::Linear, large, 20.0).unwrap();
    for (depth, force) in DEPTHS.into_iter().zip(forces).take(3) {
        let exact = sneddon(depth, POISSON_RATIO);
        assert!((force / exact - 1.0).abs() < 0.01, "{depth}: {force} {exact}");
    }
    // Shallow, the sphere is Hertz' paraboloid.
    let hertz = 4.0 / 3.0 * 0.01_f64.powf(1.5) / (1.0 - 0.45 * 0.45);
    assert!((sneddon(0.01, 0.45) / hertz - 1.0).abs() < 0.003);
}

#[test]
fn stored_forces_are_found_again() {
    for (law, ball_m) in [
        (Law::Linear, 3e-3),
        (Law::Linear, 5e-3),
        (Law::Linear, 10e-3),
        (Law::LinearOnPresentShape, 10e-3),
        (Law::StableNeoHooke, 10e-3),
    ] {
        let forces = compute(law, block(ball_m), 20.0).unwrap();
        for (depth, force) in DEPTHS.into_iter().zip(forces) {
            if let Some(stored) = reference_force(law, ball_m, depth) {
                assert!((force / stored - 1.0).abs() < 0.005, "{law:?} {ball_m} {depth}: {force} {stored}");
            }
        }
    }
}

#[test]
fn nodes_are_hardly_inside_the_ball_and_none_is_pulled() {
    let law = glisson::material::LinearElastic::from_young_poisson(1.0, POISSON_RATIO, 1.0).unwrap();
    let mut pressed = Pressed::new(&law, Push::OnRestShape, block(10e-3), 10.0);
    pressed.press_to(1.0, 0.5).unwrap();
    let gaps: Vec<f64> = (0..pressed.r.len()).map(|i| pressed.gap(i, pressed.depth).0).collect();
    for (gap, pushed) in gaps.iter().zip(&pressed.pushed) {
        assert!(*gap > -5e-5 && (!pushed || *gap < 0.0), "{gap} {pushed}");
    }
    assert!(pressed.pushed.iter().filter(|pushed| **pushed).count() > 5);
}

#[test]
fn a_square_block_is_as_stiff_as_the_cylinder_of_its_area() {
    let ratio = square_over_round().unwrap();
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}
