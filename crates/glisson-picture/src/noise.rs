//! Smooth noise in space with its gradient: lattice gradients from an integer hash, quintic blending
//! (Perlin 2002, doi 10.1145/566654.566636). Integer hashing makes it the same everywhere.

use glam::Vec3;

/// Bits that depend on a lattice point alone.
fn hash(x: i32, y: i32, z: i32) -> u32 {
    let mut h = x.cast_unsigned().wrapping_mul(0x8da6_b343)
        ^ y.cast_unsigned().wrapping_mul(0xd816_3841)
        ^ z.cast_unsigned().wrapping_mul(0xcb1a_b31f);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^ (h >> 15)
}

/// Gradient at a lattice point: each component in [-1, 1).
fn gradient(x: i32, y: i32, z: i32) -> Vec3 {
    let h = hash(x, y, z);
    let part = |shift: u32| ((h >> shift) & 0x3ff) as f32 / 512.0 - 1.0;
    Vec3::new(part(0), part(10), part(20))
}

/// Noise in about [-1, 1] with period 1, and its gradient. Zero mean.
pub(super) fn noise(p: Vec3) -> (f32, Vec3) {
    let cell = p.floor();
    let f = p - cell;
    let [x, y, z] = cell.to_array().map(|c| c as i32);
    let weight = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let slope = 30.0 * f * f * (f * (f - 2.0) + 1.0);
    let mut value = [0.0f32; 8];
    let mut slopes = [Vec3::ZERO; 8];
    for corner in 0..8usize {
        let (i, j, k) = ((corner & 1) as i32, (corner >> 1 & 1) as i32, (corner >> 2) as i32);
        let g = gradient(x.wrapping_add(i), y.wrapping_add(j), z.wrapping_add(k));
        slopes[corner] = g;
        value[corner] = g.dot(f - Vec3::new(i as f32, j as f32, k as f32));
    }
    let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
    // Along x, then y, then z; the derivative of the blending weights is added on the way.
    let along_x: [f32; 4] = std::array::from_fn(|c| mix(value[2 * c], value[2 * c + 1], weight.x));
    let slopes_x: [Vec3; 4] = std::array::from_fn(|c| slopes[2 * c].lerp(slopes[2 * c + 1], weight.x));
    let jump_x: [f32; 4] = std::array::from_fn(|c| value[2 * c + 1] - value[2 * c]);
    let along_y: [f32; 2] = std::array::from_fn(|c| mix(along_x[2 * c], along_x[2 * c + 1], weight.y));
    let slopes_y: [Vec3; 2] = std::array::from_fn(|c| slopes_x[2 * c].lerp(slopes_x[2 * c + 1], weight.y));
    let jump_x_y: [f32; 2] = std::array::from_fn(|c| mix(jump_x[2 * c], jump_x[2 * c + 1], weight.y));
    let jump_y: [f32; 2] = std::array::from_fn(|c| along_x[2 * c + 1] - along_x[2 * c]);
    let total = mix(along_y[0], along_y[1], weight.z);
    let blended = slopes_y[0].lerp(slopes_y[1], weight.z);
    let jumps = Vec3::new(
        mix(jump_x_y[0], jump_x_y[1], weight.z),
        mix(jump_y[0], jump_y[1], weight.z),
        along_y[1] - along_y[0],
    );
    (total, blended + slope * jumps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_is_the_derivative() {
        let mut random = glisson::math::SeededRandom::new(1);
        for _ in 0..200 {
            let p = Vec3::new(
                random.uniform_in(-5.0, 5.0) as f32,
                random.uniform_in(-5.0, 5.0) as f32,
                random.uniform_in(-5.0, 5.0) as f32,
            );
            let (_, gradient) = noise(p);
            let h = 1e-3;
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                let difference = (noise(p + h * axis).0 - noise(p - h * axis).0) / (2.0 * h);
                assert!((difference - gradient.dot(axis)).abs() < 5e-3, "{p}: {difference} {gradient}");
            }
        }
    }

    #[test]
    fn noise_vanishes_on_the_lattice_and_is_not_flat() {
        assert_eq!(noise(Vec3::new(3.0, -2.0, 7.0)).0, 0.0);
        let spread = (0..1000).map(|i| noise(Vec3::splat(0.37 * i as f32)).0.abs()).fold(0.0, f32::max);
        assert!((0.3..1.2).contains(&spread), "{spread}");
    }
}
