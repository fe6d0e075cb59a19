//! Deforming surfaces that touch themselves and each other, for benchmarks and validation of contact detection.

use glisson::math::DVec3;
use std::f64::consts::TAU;

/// Steps after which a motion repeats.
pub(crate) const N_FRAMES: usize = 32;

/// A surface in every step of its motion.
pub(crate) struct Moving {
    /// Vertices [m] in each frame.
    pub(crate) frames_m: Vec<Vec<DVec3>>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// The body of each triangle.
    pub(crate) body_of: Vec<u32>,
}

/// Motion of each vertex in a step [m].
const STEP_M: f64 = 1e-3;

/// A ring of 16 cm in about `n_triangles` triangles, pressed together in the middle until its two sides go 1 cm into each
/// other; each vertex goes round a circle, where waves over the ring have it, by 1 mm a step.
pub(crate) fn folded_ring(n_triangles: usize) -> Moving {
    let around = ((n_triangles as f64 / 4.8).sqrt().round() as usize).max(6);
    let along = n_triangles.div_ceil(2 * around);
    let circle_m = STEP_M / (2.0 * (0.5 * TAU / N_FRAMES as f64).sin());
    let across = DVec3::new(0.4, 0.3, 0.8).normalize();
    let along_ring = DVec3::new(0.6, -0.8, 0.0);
    let place = |i: usize, j: usize, phase: f64| {
        let (u, v) = (TAU * i as f64 / along as f64, TAU * j as f64 / around as f64);
        let out_m = 0.06 + 0.02 * v.cos();
        let (x, y, z) = (out_m * u.cos(), out_m * u.sin(), 0.02 * v.sin());
        let pressed_m = 0.045 * (-(x / 0.0453).powi(2)).exp() * (y / 0.02).tanh();
        let (sin, cos) = (3.0 * u + v + phase).sin_cos();
        DVec3::new(x, y - pressed_m, z) + (across * sin + along_ring * cos) * circle_m
    };
    let frames_m = (0..N_FRAMES)
        .map(|frame| {
            let phase = TAU * frame as f64 / N_FRAMES as f64;
            (0..along).flat_map(|i| (0..around).map(move |j| place(i, j, phase))).collect()
        })
        .collect();
    let mut triangles = Vec::new();
    for i in 0..along {
        for j in 0..around {
            let at = |di: usize, dj: usize| (((i + di) % along) * around + (j + dj) % around) as u32;
            triangles.push([at(0, 0), at(1, 0), at(1, 1)]);
            triangles.push([at(0, 0), at(1, 1), at(0, 1)]);
        }
    }
    let body_of = vec![0; triangles.len()];
    Moving { frames_m, triangles, body_of }
}

/// Cells along an edge of a cube: 300 triangles, where the cubes of seed 000 (353 tetrahedra) have 288.
const CUBE_CELLS: usize = 5;
/// Edge of a cube [m] (seed 000, s. 2.3.4).
const CUBE_M: f64 = 0.05;

/// `n` cubes in a row of two by two that rock and press 0.5 mm into each other.
pub(crate) fn rocking_cubes(n: usize) -> Moving {
    let cells = CUBE_CELLS;
    let mut cube_m = Vec::new();
    let mut faces = Vec::new();
    let mut vertex = std::collections::BTreeMap::new();
    let mut vertex_at = |place: [usize; 3]| {
        *vertex.entry(place).or_insert_with(|| {
            cube_m.push(DVec3::from_array(place.map(|c| c as f64 / cells as f64 - 0.5)) * CUBE_M);
            cube_m.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for side in [0, cells] {
            for i in 0..cells {
                for j in 0..cells {
                    let mut at = |di: usize, dj: usize| {
                        let mut place = [side; 3];
                        (place[(axis + 1) % 3], place[(axis + 2) % 3]) = (i + di, j + dj);
                        vertex_at(place)
                    };
                    let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                    faces.extend(if side == 0 { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
                }
            }
        }
    }
    let place = |k: usize, p: &DVec3, phase: f64| {
        let cell = DVec3::new((k % 2) as f64, (k / 2 % 2) as f64, (k / 4) as f64);
        let turn = DVec3::new(0.02, 0.01, 0.015) * (phase + 1.7 * k as f64).sin();
        let bulge = 1.0 - 0.1 * p.length_squared() / (CUBE_M * CUBE_M);
        *p * bulge + turn.cross(*p) + cell * (CUBE_M * 0.95)
    };
    let mut frames_m = Vec::new();
    for frame in 0..N_FRAMES {
        let phase = TAU * frame as f64 / N_FRAMES as f64;
        let cubes = (0..n).flat_map(|k| cube_m.iter().map(move |p| (k, p)));
        frames_m.push(cubes.map(|(k, p)| place(k, p, phase)).collect());
    }
    let n_vertices = cube_m.len() as u32;
    let of_cube = |k: u32| faces.iter().map(move |t| t.map(|v| v + k * n_vertices));
    Moving {
        frames_m,
        triangles: (0..n as u32).flat_map(of_cube).collect(),
        body_of: (0..n as u32).flat_map(|k| vec![k; faces.len()]).collect(),
    }
}
