//! The programs run, and what they print is what their formulas say.

use std::process::Command;

/// What a program printed.
fn printed_by(program: &str) -> String {
    let output = Command::new(program).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    text
}

/// The numbers of the lines that begin with `start`.
fn numbers(text: &str, start: &str) -> Vec<Vec<f64>> {
    let lines = text.lines().filter(|line| line.starts_with(start));
    let found: Vec<Vec<f64>> = lines
        .map(|line| line.split([' ', ',', ':']).filter_map(|word| word.parse().ok()).collect())
        .collect();
    assert!(!found.is_empty(), "no line begins with \"{start}\":\n{text}");
    found
}

fn assert_near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found}, expected {expected} within {tolerance}");
}

#[test]
fn the_law_has_its_derivatives_and_a_bar_of_it_the_stretch_of_the_closed_form() {
    let text = printed_by(env!("CARGO_BIN_EXE_law"));
    for error in &numbers(&text, "stress against")[0] {
        assert!(*error < 1e-7, "{text}");
    }
    assert_eq!(numbers(&text, "projected tangents")[0], [0.0], "{text}");
    let loads = numbers(&text, "load ");
    assert_eq!(loads.len(), 4, "{text}");
    for line in &loads {
        // The closed form keeps the volume, the bar almost: K is 200 mu.
        assert_near(line[1], line[2], 4e-3);
    }
    // The tissue stiffens: the fourth tenth of stretch bears more than twice the first.
    assert!(loads[3][0] - loads[2][0] > 2.0 * loads[0][0], "{text}");
}

#[test]
fn a_world_with_the_outside_force_model_pushes_back_and_the_dent_returns_in_time() {
    let text = printed_by(env!("CARGO_BIN_EXE_force_model"));
    let dents = numbers(&text, "dent ");
    assert_eq!(dents.len(), 3, "{text}");
    for line in &dents {
        assert_near(line[1], line[2], 1e-4);
    }
    assert_near(dents[2][0], 1.5, 1e-3);
    // (lambda + 2 mu)/h, times a third of the four triangles of 12.5 mm2 around the node.
    let stiffness_n_per_m = 5e3 * 0.55 / (1.45 * 0.1) / 4e-3 * 4.0 * 12.5e-6 / 3.0;
    assert_near(dents[2][1] / 1.5e-3, stiffness_n_per_m, 0.01);
    let left = &numbers(&text, "left of the dent")[0];
    assert_near(left[1], (-1.0_f64).exp(), 1e-3);
}

#[test]
fn the_device_comes_to_rest_where_hand_coupling_and_tissue_balance() {
    let text = printed_by(env!("CARGO_BIN_EXE_device"));
    assert!(numbers(&text, "ticks counted")[0][0] > 500.0, "{text}");
    let motor = &numbers(&text, "motor ")[0];
    assert_near(motor[0], -motor[1], 0.05);
    let handle = &numbers(&text, "handle ")[0];
    assert_near(handle[0], handle[1], 0.3);
    let tool = &numbers(&text, "instrument ")[0];
    assert_near(tool[0], tool[1], 0.3);
    // The loop took its force back.
    assert_eq!(numbers(&text, "motor after")[0], [0.0], "{text}");
}

#[test]
fn the_smoothness_of_a_recorded_motion_is_that_of_its_source() {
    let text = printed_by(env!("CARGO_BIN_EXE_smoothness"));
    // Balasubramanian et al. 2015.
    assert_near(numbers(&text, "spectral arc length")[0][0], -1.41403, 5e-6);
    assert_near(numbers(&text, "log dimensionless jerk")[0][0], -5.81636, 5e-6);
    let output =
        Command::new(env!("CARGO_BIN_EXE_smoothness")).args(["no such file", "100"]).output().unwrap();
    assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains("no such file"));
}
