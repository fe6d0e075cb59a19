//! Strokes that are not straight part what they go through: where two pieces of a stroke meet at an angle, no face stays closed, and
//! no crumb falls off.

use crate::cut_subdivision::{Body, mean_edge_m};
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::topology::Through;
use glisson::tool::cut::subdivision::SubdivisionParams;

/// A plate like that of the task `pattern_cut`.
const PLATE_M: DVec3 = DVec3::new(0.08, 0.08, 0.004);

/// How far the blade goes from one place to the next [m]: slow and fast.
const STEPS_M: [f64; 2] = [1e-4, 7e-4];

/// Largest difference between what opens and what is swept: the requirement is 0.02, for most strokes.
const MOST_OFF: f64 = 0.02;

/// A blade through the plate, beside its middle.
fn blade_at([x_m, y_m]: [f64; 2]) -> [DVec3; 2] {
    [-0.006, 0.009].map(|z_m| 0.5 * PLATE_M + DVec3::new(x_m, y_m, z_m))
}

/// Blades along a line through points, so far [m] from each other.
fn blades_along(points_m: &[[f64; 2]], step_m: f64) -> Vec<[DVec3; 2]> {
    let mut blades = vec![blade_at(points_m[0])];
    for ends in points_m.windows(2) {
        let ([x0, y0], [x1, y1]) = (ends[0], ends[1]);
        let n = (libm::hypot(x1 - x0, y1 - y0) / step_m).ceil().max(1.0) as usize;
        let place = |i: usize| i as f64 / n as f64;
        blades.extend((1..=n).map(|i| blade_at([x0 + place(i) * (x1 - x0), y0 + place(i) * (y1 - y0)])));
    }
    blades
}

/// In beside a polygon of so many corners on a circle of 20 mm, around, and out across where it began.
fn around(n_corners: usize, start_deg: f64) -> Vec<[f64; 2]> {
    let at = |share: f64, deg: f64| {
        let (sin, cos) = libm::sincos((start_deg + deg).to_radians());
        [0.02 * share * cos, 0.02 * share * sin]
    };
    let corner = |i: usize| at(1.0, 360.0 * i as f64 / n_corners as f64);
    let mut points = vec![at(1.08, -12.0), at(1.07, -9.0)];
    points.extend((0..n_corners).map(corner));
    points.extend([at(1.0, -4.0), at(1.09, -1.0)]);
    points
}

/// From one side of the plate to the other in a wave.
fn wave(start_rad: f64) -> Vec<[f64; 2]> {
    let x_m = |i: u32| -0.045 + 0.0015 * f64::from(i);
    (0..=60).map(|i| [x_m(i), 0.012 * libm::sin(110.0 * x_m(i) + start_rad)]).collect()
}

/// From one side of the plate to the other with three kinks.
fn zigzag(beside_m: f64) -> Vec<[f64; 2]> {
    vec![[-0.045, 0.0], [-0.02, 0.01 + beside_m], [-0.005, -0.012], [0.01, 0.008 + beside_m], [0.045, -0.004]]
}

/// The plate as it is, or bent and sheared.
fn plate(n_cells: usize, is_deformed: bool) -> Body {
    let n_layers = (PLATE_M.z * n_cells as f64 / PLATE_M.x).round().max(1.0) as usize;
    let body = Body::new(box_of_five([n_cells, n_cells, n_layers], PLATE_M));
    if !is_deformed {
        return body;
    }
    body.deformed(|p| {
        let bent_m = libm::sin(50.0 * p.x + 30.0 * p.y);
        p + 0.003 * DVec3::new(libm::sin(60.0 * p.y), 0.7 * libm::cos(80.0 * p.x), 0.3 * bent_m)
    })
}

/// Checks that embedded strokes along all of `lines` make two pieces, of which each is more than a crumb.
fn check_parts(lines: &[(&str, Vec<[f64; 2]>)]) {
    let (mut failed, mut off_m2, mut swept_m2) = (Vec::new(), 0.0, 0.0);
    for n_cells in [20, 27, 32] {
        for (at, (name, points_m)) in lines.iter().enumerate() {
            for step_m in STEPS_M {
                let mut body = plate(n_cells, at % 2 == 1);
                let params = SubdivisionParams::embedded(mean_edge_m(body.mesh.mesh()));
                let report = body.stroke(&params, blades_along(points_m, step_m));
                let what = format!("{name}, {n_cells} cells, {step_m} m: {report:?}");
                body.check(PLATE_M.element_product(), &what);
                assert_eq!(report.n_refused, 0, "{what}");
                off_m2 += (report.cut_area_m2 - report.swept_area_m2).abs();
                swept_m2 += report.swept_area_m2;
                let n_tets = body.mesh.topology().pieces(Through::Faces).n_tets;
                if n_tets.len() != 2 || n_tets.iter().any(|&n| n < 100) {
                    failed.push(format!("{n_tets:?} tetrahedra: {what}"));
                }
            }
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(off_m2 < MOST_OFF * swept_m2, "{off_m2} m2 of {swept_m2}");
}

#[test]
fn a_disc_comes_free_where_a_stroke_goes_around() {
    let circles = [3.0, 17.0, 41.0, 44.1, 57.8, 71.5].map(|start_deg| ("circle", around(48, start_deg)));
    check_parts(&circles);
}

#[test]
fn polygons_come_free_at_their_corners_too() {
    let polygons = [(6, 30.4), (6, 57.8), (4, 3.0), (4, 30.4)];
    check_parts(&polygons.map(|(n_corners, start_deg)| ("polygon", around(n_corners, start_deg))));
}

#[test]
fn strokes_across_in_waves_and_kinks_make_two_parts() {
    let mut lines: Vec<(&str, Vec<[f64; 2]>)> =
        [0.3, 1.0, 2.1].into_iter().map(|start_rad| ("wave", wave(start_rad))).collect();
    lines.extend([0.0, 2e-4, 7e-4].into_iter().map(|beside_m| ("zigzag", zigzag(beside_m))));
    check_parts(&lines);
}
