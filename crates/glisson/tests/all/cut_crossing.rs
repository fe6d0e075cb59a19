//! Strokes that cross earlier ones part what they enclose: wedges, prisms and pyramids come free, and nothing hangs on by a hair.

use crate::cut_subdivision::{Body, mean_edge_m};
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::topology::Through;
use glisson::tool::cut::subdivision::SubdivisionParams;

/// A block with its top at y = 30 mm.
const BLOCK_M: DVec3 = DVec3::new(0.06, 0.03, 0.06);

/// A piece of fewer tetrahedra is a crumb.
const CRUMB: u32 = 30;

/// Largest difference between what opens and what is swept, of all strokes together: the requirement is 0.02.
const MOST_OFF: f64 = 0.005;

/// Where strokes meet below the top, and how steep they are.
struct Solid {
    /// Ways out of it, from its axis, in the plane of the top [rad].
    outward_rad: Vec<f64>,
    /// Angle between its sides and its axis [rad]; none for a prism.
    half_angle_rad: f64,
    /// Where its axis meets its point, or the middle of its base.
    base_m: DVec3,
    /// Half of what the blade goes along a side [m].
    half_m: f64,
    /// By how much the blade goes deeper than the point [m].
    over_m: f64,
}

/// Two sides that go through the whole block.
fn wedge(random: &mut SeededRandom) -> Solid {
    let depth_m = random.uniform_in(0.008, 0.018);
    Solid {
        outward_rad: vec![0.0, core::f64::consts::PI],
        half_angle_rad: random.uniform_in(25.0, 50.0).to_radians(),
        base_m: DVec3::new(0.03 + random.uniform_in(-0.004, 0.004), BLOCK_M.y - depth_m, 0.03),
        half_m: 0.035,
        over_m: random.uniform_in(0.002, 0.006),
    }
}

/// Four sides, turned by any angle.
fn around(random: &mut SeededRandom, first_rad: f64) -> Vec<f64> {
    let start_rad = random.uniform_in(0.0, first_rad);
    (0..4).map(|side| start_rad + core::f64::consts::FRAC_PI_2 * f64::from(side)).collect()
}

fn pyramid(random: &mut SeededRandom) -> Solid {
    let depth_m = random.uniform_in(0.01, 0.018);
    let half_angle_rad = random.uniform_in(28.0, 45.0).to_radians();
    let over_m = random.uniform_in(0.002, 0.006);
    Solid {
        outward_rad: around(random, core::f64::consts::FRAC_PI_2),
        half_angle_rad,
        base_m: DVec3::new(0.03, BLOCK_M.y - depth_m, 0.03),
        half_m: depth_m * libm::tan(half_angle_rad) + 0.004 + over_m,
        over_m,
    }
}

/// Four upright sides, 8 mm from the middle, through the whole block.
fn prism(random: &mut SeededRandom) -> Solid {
    Solid {
        outward_rad: around(random, core::f64::consts::FRAC_PI_2),
        half_angle_rad: 0.0,
        base_m: DVec3::new(0.03, -0.004, 0.03),
        half_m: 0.008 + random.uniform_in(0.002, 0.006),
        over_m: 0.0,
    }
}

/// The blade along each side, from one end to the other.
fn strokes(solid: &Solid) -> impl Iterator<Item = Vec<[DVec3; 2]>> {
    solid.outward_rad.iter().map(|&rad| {
        let (sin, cos) = libm::sincos(rad);
        let (outward, along) = (DVec3::new(cos, 0.0, sin), DVec3::new(-sin, 0.0, cos));
        let (lean, up) = libm::sincos(solid.half_angle_rad);
        let to_heel = lean * outward + up * DVec3::Y;
        let is_prism = solid.half_angle_rad == 0.0;
        let middle_m = solid.base_m + if is_prism { 0.008 * outward } else { -solid.over_m * to_heel };
        let at = |step: u32| middle_m + along * (f64::from(step) / 45.0 - 1.0) * solid.half_m;
        (0..=90).map(|step| [at(step), at(step) + 0.05 * to_heel]).collect()
    })
}

/// How many of `n_solids` do not come free.
fn hanging(n_solids: u32, solid: fn(&mut SeededRandom) -> Solid) -> Vec<String> {
    let mut random = SeededRandom::new(11);
    let (mut hanging, mut off, mut n_strokes) = (Vec::new(), 0.0, 0.0);
    for trial in 0..n_solids {
        let n_cells = 7 + trial as usize % 3;
        let mesh = box_of_five([2 * n_cells, n_cells, 2 * n_cells], BLOCK_M);
        let edge_m = mean_edge_m(&mesh);
        let solid = solid(&mut random);
        for params in [SubdivisionParams::embedded(edge_m), SubdivisionParams::for_mean_edge(edge_m)] {
            let mut body = Body::new(mesh.clone());
            let what = format!("trial {trial}, nested {}", params.is_nested);
            for blades in strokes(&solid) {
                let report = body.stroke(&params, blades);
                assert_eq!(report.n_refused, 0, "{what}: {report:?}");
                off += (report.cut_area_m2 / report.swept_area_m2 - 1.0).abs();
                n_strokes += 1.0;
            }
            body.check(BLOCK_M.element_product(), &what);
            let n_tets = body.mesh.topology().pieces(Through::Faces).n_tets;
            if n_tets.iter().filter(|&&n| n >= CRUMB).count() != 2 {
                hanging.push(format!("{what}: {n_tets:?} tetrahedra"));
            }
        }
    }
    assert!(off < MOST_OFF * n_strokes, "{}", off / n_strokes);
    hanging
}

#[test]
fn wedges_come_free_where_two_strokes_cross() {
    let hanging = hanging(9, wedge);
    assert!(hanging.is_empty(), "{hanging:#?}");
}

#[test]
fn prisms_come_free_where_four_strokes_cross() {
    let hanging = hanging(6, prism);
    assert!(hanging.is_empty(), "{hanging:#?}");
}

/// Where four walls meet in a point, a few in a hundred hang on by faces of hundredths of a square millimetre.
#[test]
fn pyramids_come_free_but_for_few() {
    let hanging = hanging(9, pyramid);
    assert!(hanging.len() < 2, "{hanging:#?}");
}
