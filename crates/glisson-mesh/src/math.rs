//! Small vectors and matrices, boxes, and the seeded random numbers of everything synthetic.
//!
//! Vectors are `glam`'s; the names are re-exported here so that one `use` serves.

pub use glam::{DMat3, DQuat, DVec2, DVec3};

/// A right-handed turn about a unit axis. As [`DQuat::from_axis_angle`], but with the same bits on every system: that asks the system's
/// own sine.
pub fn rotation_about(axis: DVec3, angle_rad: f64) -> DQuat {
    let (sine, cosine) = libm::sincos(0.5 * angle_rad);
    let v = axis * sine;
    DQuat::from_xyzw(v.x, v.y, v.z, cosine)
}

/// The rotation at a share of the shorter way from one to another, at constant speed (Shoemake 1985, Computer Graphics 19(3), 245). As
/// [`DQuat::slerp`], but with the same bits on every system.
pub fn rotation_between(from: DQuat, to: DQuat, share: f64) -> DQuat {
    let cosine = from.dot(to);
    let (to, cosine) = if cosine < 0.0 { (-to, -cosine) } else { (to, cosine) };
    // Of so small a turn the sine is the angle.
    if cosine > 1.0 - f64::EPSILON {
        return (from * (1.0 - share) + to * share).normalize();
    }
    let angle = libm::acos(cosine);
    let weight = |share: f64| libm::sin(share * angle) / libm::sin(angle);
    from * weight(1.0 - share) + to * weight(share)
}

/// How numbers are rounded, which decides the bits of nearly everything: results are the same in one class, on any machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arithmetic {
    /// Of programs: `a * b + c` is rounded once.
    #[default]
    Fused,
    /// Of browsers: the same, but dense matrices, from which factors are made, are multiplied in another order. Where no factor is
    /// needed, the bits are those of programs.
    WebFused,
    /// Of browsers that have no operation for it: `a * b + c` is rounded twice, product and sum.
    WebSeparate,
}

impl Arithmetic {
    /// That of this program where it runs.
    pub fn here() -> Self {
        // The product's last bit is lost where it is rounded before the sum.
        let x = std::hint::black_box(1.0 + f64::EPSILON);
        let is_fused = fused(x, x, -(1.0 + 2.0 * f64::EPSILON)) != 0.0;
        match (cfg!(target_family = "wasm"), is_fused) {
            (false, _) => Self::Fused,
            (true, true) => Self::WebFused,
            (true, false) => Self::WebSeparate,
        }
    }

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fused => "fused",
            Self::WebFused => "web_fused",
            Self::WebSeparate => "web_separate",
        }
    }
}

/// `a * b + c` in this program's [`Arithmetic`].
#[inline(always)]
pub fn fused(a: f64, b: f64, c: f64) -> f64 {
    #[cfg(all(target_arch = "wasm32", target_feature = "relaxed-simd"))]
    {
        use core::arch::wasm32::{f64x2_extract_lane, f64x2_relaxed_madd, f64x2_splat};
        f64x2_extract_lane::<0>(f64x2_relaxed_madd(f64x2_splat(a), f64x2_splat(b), f64x2_splat(c)))
    }
    #[cfg(all(target_arch = "wasm32", not(target_feature = "relaxed-simd")))]
    {
        a * b + c
    }
    #[cfg(not(target_arch = "wasm32"))]
    a.mul_add(b, c)
}

/// Axis-aligned box in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest corner [m].
    pub min_m: DVec3,
    /// Largest corner [m].
    pub max_m: DVec3,
}

impl Aabb {
    /// The box that holds nothing: growing it by a point gives that point.
    pub const EMPTY: Self = Self { min_m: DVec3::INFINITY, max_m: DVec3::NEG_INFINITY };

    /// Smallest box that holds all `points_m`; [`Aabb::EMPTY`] for none.
    pub fn of_points(points_m: &[DVec3]) -> Self {
        points_m.iter().fold(Self::EMPTY, |b, &p| b.including(p))
    }

    /// This box grown to hold `point_m`.
    pub fn including(self, point_m: DVec3) -> Self {
        Self { min_m: self.min_m.min(point_m), max_m: self.max_m.max(point_m) }
    }

    /// The smallest box that holds both.
    pub fn joined(self, other: &Self) -> Self {
        self.including(other.min_m).including(other.max_m)
    }

    /// This box grown by `margin_m` on every side.
    pub fn grown(self, margin_m: f64) -> Self {
        Self { min_m: self.min_m - DVec3::splat(margin_m), max_m: self.max_m + DVec3::splat(margin_m) }
    }

    /// Edge lengths [m].
    pub fn size_m(self) -> DVec3 {
        self.max_m - self.min_m
    }

    /// Centre [m].
    pub fn center_m(self) -> DVec3 {
        0.5 * (self.min_m + self.max_m)
    }

    /// Whether `point_m` lies inside or on the border.
    pub fn contains(self, point_m: DVec3) -> bool {
        point_m.cmpge(self.min_m).all() && point_m.cmple(self.max_m).all()
    }
}

/// The matrix [v] with [v] x = v x x.
pub fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// Outer product a b^T.
pub fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Signed volume [m3] of a tetrahedron: positive when (b-a, c-a, d-a) is right-handed.
pub fn tetrahedron_volume_m3(p_m: [DVec3; 4]) -> f64 {
    (p_m[1] - p_m[0]).cross(p_m[2] - p_m[0]).dot(p_m[3] - p_m[0]) / 6.0
}

/// Whether a tetrahedron of this volume is turned inside out or flat; a volume that is no number counts as such.
pub fn is_inverted(volume_m3: f64) -> bool {
    let is_positive = volume_m3 > 0.0;
    !is_positive
}

/// Point of triangle `(a, b, c)` closest to `p`, as barycentric weights
/// (Ericson, Real-Time Collision Detection, 2005, s. 5.1.5).
pub fn closest_point_barycentric(p: DVec3, [a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let sum = va + vb + vc;
    let (v, w) = (vb / sum, vc / sum);
    [1.0 - v - w, v, w]
}

/// Distance of two segments (Ericson, Real-Time Collision Detection, 2005, s. 5.1.9).
pub fn segment_distance([p0, p1]: [DVec3; 2], [q0, q1]: [DVec3; 2]) -> f64 {
    let (u, v, w) = (p1 - p0, q1 - q0, p0 - q0);
    let (a, b, c, d, e) = (u.dot(u), u.dot(v), v.dot(v), u.dot(w), v.dot(w));
    let share = |over: f64, under: f64| if under > 0.0 { (over / under).clamp(0.0, 1.0) } else { 0.0 };
    let mut s = share(b * e - c * d, a * c - b * b);
    let mut t = share(b * s + e, c);
    // The end of the second segment that t was brought back to has its own nearest point on the first.
    s = share(b * t - d, a);
    t = share(b * s + e, c);
    (w + u * s - v * t).length()
}

/// Seeded random numbers, the same on every machine: SplitMix64 (Steele, Lea and Flood 2014,
/// doi 10.1145/2660193.2660195).
#[derive(Clone, Debug)]
pub struct SeededRandom {
    state: u64,
}

impl SeededRandom {
    /// A sequence that depends on `seed` alone.
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// Next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn uniform_in(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Standard normal (Box and Muller 1958, doi 10.1214/aoms/1177706645).
    pub fn normal(&mut self) -> f64 {
        let u = 1.0 - self.uniform();
        let v = self.uniform();
        libm::sqrt(-2.0 * libm::log(u)) * libm::cos(std::f64::consts::TAU * v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_are_those_of_glam() {
        let mut random = SeededRandom::new(8);
        let mut unit = || {
            let v = DVec3::new(
                random.uniform_in(-1.0, 1.0),
                random.uniform_in(-1.0, 1.0),
                random.uniform_in(-1.0, 1.0),
            );
            v.normalize_or(DVec3::X)
        };
        for i in 0..200 {
            let (axis, angle_rad) = (unit(), 0.05 * f64::from(i) - 4.0);
            let (found, other) = (rotation_about(axis, angle_rad), DQuat::from_axis_angle(unit(), 1.3));
            assert!(found.abs_diff_eq(DQuat::from_axis_angle(axis, angle_rad), 1e-15));
            for share in [0.0, 0.3, 1.0] {
                // `slerp` approximates an angle.
                let close = |a: DQuat, b: DQuat| a.abs_diff_eq(b, 1e-3);
                let between = rotation_between(found, other, share);
                assert!(close(between, found.slerp(other, share)) && between.is_normalized());
            }
            assert!(rotation_between(found, found, 0.4).abs_diff_eq(found, 1e-15));
        }
        let half = rotation_between(DQuat::IDENTITY, rotation_about(DVec3::Z, 1.0), 0.5);
        assert!(half.abs_diff_eq(rotation_about(DVec3::Z, 0.5), 1e-15));
    }

    #[test]
    fn programs_round_once() {
        assert_eq!(Arithmetic::here(), Arithmetic::Fused);
        let x = 1.0 + f64::EPSILON;
        assert_eq!(fused(x, x, -(1.0 + 2.0 * f64::EPSILON)), f64::EPSILON * f64::EPSILON);
    }
}
