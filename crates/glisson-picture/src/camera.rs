//! The perspective camera, in the patient frame (LPS: +x patient's left, +y back, +z head).

use glam::{DVec3, Vec3};
use glisson::math::Aabb;
use glisson::tool::endoscope::Eye;

/// Half the default vertical opening angle: 14 degrees, about a 72 mm lens, little distortion.
const HALF_FIELD_OF_VIEW_RAD: f64 = 14.0 * std::f64::consts::PI / 180.0;
/// Part of the picture's edge that framing leaves free on each side.
const FRAME_MARGIN: f64 = 0.06;
/// Part of the eye's distance below which nothing is drawn.
const NEAR_FRACTION: f64 = 0.02;
/// What an endoscope looks at is about so far away [m].
const LENS_TO_TARGET_M: f64 = 0.1;

/// The direction to look from, around the patient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Angle from the front (-y) towards the patient's right (-x) [rad].
    pub azimuth_rad: f64,
    /// Angle above the horizontal [rad].
    pub elevation_rad: f64,
}

impl Default for View {
    /// From the front, 20 degrees to the patient's right, 16 degrees from above.
    fn default() -> Self {
        Self { azimuth_rad: 20f64.to_radians(), elevation_rad: 16f64.to_radians() }
    }
}

impl View {
    /// Unit vector from the target to the eye.
    fn towards_eye(self) -> DVec3 {
        let (sin_azimuth, cos_azimuth) = self.azimuth_rad.sin_cos();
        let (sin_elevation, cos_elevation) = self.elevation_rad.sin_cos();
        DVec3::new(-sin_azimuth * cos_elevation, -cos_azimuth * cos_elevation, sin_elevation)
    }
}

/// What lights a picture, and its shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Light {
    /// Lamps around; the whole rectangle.
    Room,
    /// The lamp beside an endoscope's lens; a circle.
    AtLens,
}

/// Eye, direction, opening angle, and light that goes with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Eye [m].
    pub(crate) eye_m: DVec3,
    /// Point in the middle of the picture [m].
    pub(crate) target_m: DVec3,
    /// Direction that points up in the picture; need not be perpendicular to the view.
    pub(crate) up: DVec3,
    /// Vertical opening angle [rad].
    pub(crate) vertical_field_of_view_rad: f64,
    /// What lights.
    pub(crate) light: Light,
}

impl Camera {
    /// Camera that sees the whole of `bounds_m` from `view` in a picture of `size` pixels.
    pub fn framing(bounds_m: Aabb, size: [usize; 2], view: View) -> Self {
        let (center_m, half_m) = (bounds_m.center_m(), 0.5 * bounds_m.size_m());
        let corners_m = [0, 1, 2, 3, 4, 5, 6, 7].map(|corner: u32| {
            let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
            center_m + half_m * DVec3::new(sign(0), sign(1), sign(2))
        });
        Self::framing_points(&corners_m, size, view)
    }

    /// Camera that sees all `points_m` from `view` in a picture of `size` pixels, as large as fits. The middle
    /// of the points' box is in the middle of the picture.
    pub fn framing_points(points_m: &[DVec3], size: [usize; 2], view: View) -> Self {
        let bounds_m = Aabb::of_points(points_m);
        let target_m = if points_m.is_empty() { DVec3::ZERO } else { bounds_m.center_m() };
        let towards_eye = view.towards_eye();
        let mut camera = Self {
            eye_m: target_m + towards_eye,
            target_m,
            up: DVec3::Z,
            vertical_field_of_view_rad: 2.0 * HALF_FIELD_OF_VIEW_RAD,
            light: Light::Room,
        };
        let [right, up, forward] = camera.axes();
        let tan_vertical = HALF_FIELD_OF_VIEW_RAD.tan() * (1.0 - 2.0 * FRAME_MARGIN);
        let tan_horizontal = tan_vertical * size[0] as f64 / size[1] as f64;
        let distance_m = points_m
            .iter()
            .map(|&point_m| {
                let offset = point_m - target_m;
                let across =
                    (offset.dot(right).abs() / tan_horizontal).max(offset.dot(up).abs() / tan_vertical);
                across - offset.dot(forward)
            })
            .fold(1e-6, f64::max);
        camera.eye_m = target_m + distance_m * towards_eye;
        camera
    }

    /// What an endoscope sees: a circle in the middle of the picture, lit by its own lamp.
    pub fn through(eye: &Eye) -> Self {
        Self {
            eye_m: eye.position_in_world_m,
            target_m: eye.position_in_world_m + LENS_TO_TARGET_M * eye.forward_in_world,
            up: eye.up_in_world,
            vertical_field_of_view_rad: eye.field_of_view_rad,
            light: Light::AtLens,
        }
    }

    /// Unit vectors to the right, up and forward in the picture.
    pub(super) fn axes(&self) -> [DVec3; 3] {
        let forward = (self.target_m - self.eye_m).try_normalize().unwrap_or(DVec3::Y);
        let right =
            forward.cross(self.up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        [right, right.cross(forward), forward]
    }

    /// Distance in front of the eye below which nothing is drawn [m].
    pub(super) fn near_m(&self) -> f64 {
        NEAR_FRACTION * self.eye_m.distance(self.target_m)
    }
}

/// A camera ready for a picture of a given size; coordinates relative to the target, so that `f32` serves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    /// Eye relative to the target [m].
    pub(super) eye: Vec3,
    /// Directions to the right, up and forward in the picture.
    pub(super) right: Vec3,
    pub(super) up: Vec3,
    pub(super) forward: Vec3,
    /// Pixels for each unit of tangent.
    pub(super) focal_pixels: f32,
    /// Middle of the picture [pixels].
    pub(super) center_pixels: [f32; 2],
    /// Nearest depth drawn [m].
    pub(super) near_m: f32,
}

impl Projection {
    pub(super) fn new(camera: &Camera, size: [usize; 2]) -> Self {
        let [right, up, forward] = camera.axes();
        let half_height = 0.5 * size[1] as f64;
        Self {
            eye: (camera.eye_m - camera.target_m).as_vec3(),
            right: right.as_vec3(),
            up: up.as_vec3(),
            forward: forward.as_vec3(),
            focal_pixels: (half_height / (0.5 * camera.vertical_field_of_view_rad).tan()) as f32,
            center_pixels: [0.5 * size[0] as f32, half_height as f32],
            near_m: camera.near_m() as f32,
        }
    }

    /// Coordinates along right, up and forward from the eye [m].
    pub(super) fn to_camera(self, position: Vec3) -> Vec3 {
        let d = position - self.eye;
        Vec3::new(d.dot(self.right), d.dot(self.up), d.dot(self.forward))
    }

    /// Column and row [pixels] of camera coordinates in front of the eye.
    pub(super) fn to_pixels(self, camera: Vec3) -> [f32; 2] {
        let scale = self.focal_pixels / camera.z;
        [self.center_pixels[0] + scale * camera.x, self.center_pixels[1] - scale * camera.y]
    }

    /// About how many pixels a surface of these vertices has, front and back, also of what is beside the picture.
    pub(super) fn pixels_of(self, positions: &[Vec3]) -> f32 {
        let Some(&first) = positions.first() else { return 0.0 };
        let (low, high) = positions.iter().fold((first, first), |(a, b), &p| (a.min(p), b.max(p)));
        let radius = 0.5 * (high - low).length();
        let depth = (0.5 * (low + high)).distance(self.eye).max(self.near_m);
        let across = radius * self.focal_pixels / depth;
        2.0 * std::f32::consts::PI * across * across
    }

    /// Direction, not normalised, of the ray through a place in the picture: one metre forward.
    pub(super) fn ray(self, [x, y]: [f32; 2]) -> Vec3 {
        let across = (x - self.center_pixels[0]) / self.focal_pixels;
        let upward = (self.center_pixels[1] - y) / self.focal_pixels;
        self.forward + self.right * across + self.up * upward
    }
}
