use super::super::judgement::{sneddon, square_and_round};
use super::table::{DEPTHS, Law, POISSON_RATIO, block, compute, reference_force};
use super::*;
use crate::validate::indentation::block::Elements;
use glisson::solve::NodeAveraging;

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
    let [square, round] = square_and_round(Elements::Averaged(NodeAveraging::STRAIN)).unwrap();
    assert!((square / round - 1.0).abs() < 0.01, "{square} {round}");
    let stored = reference_force(Law::Linear, 10e-3, 1.0).unwrap();
    assert!((square / stored - 1.0).abs() < 0.05, "{square} {stored}");
}

#[test]
fn what_the_ball_adds_is_differentiated_exactly() {
    let law = glisson::material::LinearElastic::from_young_poisson(1.0, POISSON_RATIO, 1.0).unwrap();
    let mut pressed = Pressed::new(&law, Push::OnPresentShape, block(10e-3), 10.0);
    let depth = 0.8;
    // Three nodes hardly inside the ball, off the axis.
    for i in 2..5 {
        let angle = 0.25 * i as f64;
        let away = 1.0 - 0.5 * SHALLOW;
        let rows = [0, 1].map(|c| pressed.unknown(i, 0, c));
        pressed.displacements[rows[0]] = away * angle.sin() - pressed.r[i];
        pressed.displacements[rows[1]] = 1.0 - depth - away * angle.cos();
        pressed.pushed[i] = true;
    }
    let slopes = |pressed: &Pressed<'_>| {
        let mut slopes = Vec::new();
        pressed.touch(depth, TangentKind::Exact, |_, slope, _| slopes.push(slope));
        slopes
    };
    let mut seconds = Vec::new();
    pressed.touch(depth, TangentKind::Exact, |_, _, second| seconds.push(second));
    for (k, second) in seconds.iter().enumerate() {
        for component in 0..2 {
            let (row, step) = (pressed.unknown(k + 2, 0, component), 1e-7);
            let mut moved = |by: f64| {
                pressed.displacements[row] += by;
                let found = slopes(&pressed)[k];
                pressed.displacements[row] -= by;
                found
            };
            let (up, down) = (moved(step), moved(-step));
            for other in 0..2 {
                let slope = (up[other] - down[other]) / (2.0 * step);
                assert!((slope - second[component][other]).abs() < 1e-6 * PENALTY, "{slope} {second:?}");
            }
        }
    }
}
