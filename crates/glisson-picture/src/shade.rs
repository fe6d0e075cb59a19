//! Light on the surfaces of a picture.
//!
//! In a room: three lamps that go with the camera (key, fill, rim) and a dim surrounding with a soft lamp in it.
//! Through an endoscope: the lamp beside its lens, whose light falls off with the square of the distance and is turned up
//! until what is seen is bright enough, and the little that walls throw back, red.
//! Tissue: wrapped diffuse light, redder in the half-shade, as light that went a short way through it;
//! above it a body highlight and a wet film, both microfacet highlights (Walter, Marschner, Li and
//! Torrance 2007, doi 10.2312/EGWR/EGSR07/195-206) with Schlick's Fresnel term (1994, doi
//! 10.1111/1467-8659.1330233). Shadows of the key lamp from a shadow map; darkening in folds by scalable
//! ambient obscurance (McGuire, Mara and Luebke 2012, doi 10.2312/EGGH/HPG12/097-103).
//! A filmic curve (the rational fit by Narkowicz 2016) brings the light into the screen's range.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::camera::{Camera, Light, Projection};
use super::geometry::{Facets, Part};
use super::look::{SrgbTable, SurfacePoint, linear, surface_point};
use super::raster::{Fragment, Samples, ShadowMap};

/// Samples of the obscurance a pixel, and rotations of their pattern (one a cell of 4 x 4 pixels).
const OBSCURANCE_SAMPLES: usize = 16;
const OBSCURANCE_ROTATIONS: usize = 16;
/// Reach of the obscurance, as a part of the organs' diagonal.
const OBSCURANCE_REACH: f32 = 0.075;
const OBSCURANCE_STRENGTH: f32 = 3.2;
/// Half edge of the window over which the obscurance is averaged [pixels].
const OBSCURANCE_BLUR: usize = 2;
/// Radii of a lit film's and a soft lamp's highlight.
const FILM_ROUGHNESS: f32 = 0.17;
/// Brightness of the whole picture.
const EXPOSURE: f32 = 0.62;
/// Reflection of water at normal incidence.
const WATER_REFLECTION: f32 = 0.035;
/// What the lamp beside the lens makes of a surface that faces it, where that is as far away as most of the picture.
const LENS_LIGHT: [f32; 3] = [2.9, 2.75, 2.6];
/// What metal scatters of the light of the lamp at the lens.
const METAL_SCATTERS: f32 = 0.16;
/// Light that walls inside the body throw back.
const THROWN_BACK: Vec3 = Vec3::new(0.16, 0.052, 0.04);
/// From where on the picture of an endoscope is darker towards its rim, as a part of its radius; and by how much there.
const RIM_FROM: f32 = 0.62;
const RIM_DARKER: f32 = 0.55;
/// Nearer than this the lamp is not turned down any more [m].
const NEAREST_METERED_M: f32 = 0.02;
/// Background from top to bottom, sRGB.
const BACKGROUND: [[u8; 3]; 2] = [[24, 30, 38], [78, 88, 98]];

#[derive(Clone, Copy, Debug)]
struct Lamp {
    /// Unit vector to the lamp.
    towards: Vec3,
    light: Vec3,
}

/// A place on a surface that a pixel sees; relative to the target [m].
#[derive(Clone, Copy, Debug)]
struct Hit {
    position: Vec3,
    /// Smooth unit normal, on the eye's side.
    normal: Vec3,
    rest: Vec3,
    part: Part,
}

/// Everything that shading needs, for one picture.
#[derive(Debug)]
pub(super) struct Shading<'a> {
    facets: &'a Facets,
    samples: &'a Samples,
    projection: Projection,
    /// Key, fill, rim; in the light of a lens the first one's alone counts.
    lamps: [Lamp; 3],
    /// Of the key lamp.
    shadows: Option<ShadowMap>,
    light: Light,
    /// Square of the distance [m] at which the lamp at the lens makes what it makes.
    metered_m2: f32,
    /// Share of the surrounding's light that reaches the nearest surface of each pixel.
    openness: Vec<f32>,
    srgb: &'static SrgbTable,
    /// From top to bottom.
    background: [Vec3; 2],
}

impl<'a> Shading<'a> {
    pub(super) fn new(facets: &'a Facets, camera: &Camera, samples: &'a Samples) -> Self {
        let projection = Projection::new(camera, samples.size);
        let lamp = |right: f32, up: f32, back: f32, light: [f32; 3]| Lamp {
            towards: (projection.right * right + projection.up * up - projection.forward * back)
                .normalize_or(Vec3::Z),
            light: Vec3::from_array(light),
        };
        let lamps = [
            lamp(-0.50, 0.85, 0.62, [3.0, 2.85, 2.65]),
            lamp(0.90, 0.05, 0.55, [0.42, 0.47, 0.56]),
            lamp(0.35, 0.55, -0.80, [1.25, 1.2, 1.2]),
        ];
        let mut shading = Self {
            facets,
            samples,
            projection,
            lamps,
            shadows: (camera.light == Light::Room)
                .then(|| ShadowMap::new(facets, lamps[0].towards, samples.size)),
            light: camera.light,
            metered_m2: 1.0,
            openness: Vec::new(),
            srgb: SrgbTable::shared(),
            background: BACKGROUND.map(linear),
        };
        let nearest = shading.nearest();
        shading.openness = shading.obscured(&nearest);
        shading.metered_m2 = shading.metered(&nearest);
        shading
    }

    /// Of all that an endoscope sees, the square of the distance at which its lamp does what it does on average [m2].
    fn metered(&self, nearest: &[Option<(Vec3, Vec3)>]) -> f32 {
        let mut sum = 0.0;
        let mut n = 0.0;
        for (position, _) in nearest.iter().flatten() {
            sum += 1.0 / f64::from((*position - self.projection.eye).length_squared()).max(1e-12);
            n += 1.0;
        }
        let least = NEAREST_METERED_M * NEAREST_METERED_M;
        if n > 0.0 { ((n / sum) as f32).max(least) } else { 1.0 }
    }

    /// How far a pixel is from the middle of an endoscope's picture, as a part of its radius.
    fn off_middle(&self, column: usize, row: usize) -> f32 {
        let [x, y] = self.projection.center_pixels;
        (column as f32 + 0.5 - x).hypot(row as f32 + 0.5 - y) / y
    }

    /// What of the light comes to a pixel.
    fn through_lens(&self, column: usize, row: usize) -> f32 {
        if self.light == Light::Room {
            return 1.0;
        }
        let off = self.off_middle(column, row);
        let towards_rim = ((off - RIM_FROM) / (1.0 - RIM_FROM)).clamp(0.0, 1.0);
        let inside = ((1.0 - off) * self.projection.center_pixels[1]).clamp(0.0, 1.0);
        inside * (1.0 - RIM_DARKER * towards_rim * towards_rim)
    }

    /// Colours of row `row` of the picture: three bytes a pixel.
    pub(super) fn row_into(&self, row: usize, bytes: &mut [u8]) {
        let [width, _] = self.samples.size;
        for (column, pixel) in bytes.chunks_exact_mut(3).enumerate() {
            let index = row * width + column;
            let through = self.through_lens(column, row);
            if through == 0.0 {
                pixel.fill(0);
                continue;
            }
            let (mut light, mut rest) = (Vec3::ZERO, 1.0);
            for fragment in self.samples.of_pixel(index) {
                let hit = self.hit(fragment);
                light += fragment.coverage * filmic(self.light_of(&hit, self.openness[index]));
                rest -= fragment.coverage;
            }
            if rest > 1e-3 {
                light += rest * self.background(column, row);
            }
            pixel.copy_from_slice(&self.srgb.encode(through * light));
        }
    }

    /// Where the ray of a fragment meets its triangle. The mean place of the samples may lie just outside;
    /// then the nearest place of the triangle counts.
    fn hit(&self, fragment: &Fragment) -> Hit {
        let t = fragment.triangle as usize;
        let corners = self.facets.triangles[t].map(|v| v as usize);
        let p = corners.map(|v| self.facets.positions[v]);
        let (eye, ray) = (self.projection.eye, self.projection.ray(fragment.place));
        let across = (p[1] - p[0]).cross(p[2] - p[0]);
        let facing = across.dot(ray);
        let mut share = [1.0 / 3.0; 3];
        if facing.abs() > f32::MIN_POSITIVE {
            let at = eye + ray * (across.dot(p[0] - eye) / facing);
            let area = across.length_squared();
            let b = across.dot((p[2] - p[1]).cross(at - p[1])) / area;
            let c = across.dot((p[0] - p[2]).cross(at - p[2])) / area;
            let cut = [b, c, 1.0 - b - c].map(|s| s.max(0.0));
            let sum = cut[0] + cut[1] + cut[2];
            if sum.is_finite() && sum > 0.0 {
                share = cut.map(|s| s / sum);
            }
        }
        let mean = |values: &[Vec3]| {
            share[0] * values[corners[0]] + share[1] * values[corners[1]] + share[2] * values[corners[2]]
        };
        let position = mean(&self.facets.positions);
        let normal = mean(&self.facets.normals).normalize_or(Vec3::Z);
        // An open surface may be seen from inside.
        let flip = across.dot(ray) > 0.0 && normal.dot(ray) > 0.0;
        Hit {
            position,
            normal: if flip { -normal } else { normal },
            rest: mean(&self.facets.rest),
            part: self.facets.parts[self.facets.part_of[t] as usize],
        }
    }

    /// Light that comes from `hit` to the eye.
    fn light_of(&self, hit: &Hit, openness: f32) -> Vec3 {
        let to_eye = self.projection.eye - hit.position;
        let depth = to_eye.dot(-self.projection.forward);
        let pixel_m = depth / self.projection.focal_pixels;
        let point = surface_point(hit.part.look, hit.rest, hit.normal, pixel_m);
        let view = to_eye.normalize_or(Vec3::Z);
        let facing = point.normal.dot(view).max(0.02);
        let openness = if hit.part.overlay { 1.0 } else { openness };
        let key_share = match &self.shadows {
            Some(shadows) if !hit.part.overlay => shadows.lit_share(hit.position, hit.normal),
            _ => 1.0,
        };
        let mut light = point.glow * point.albedo * 1.6;
        match self.light {
            Light::Room => {
                for (lamp, share) in self.lamps.iter().zip([key_share, 1.0, openness]) {
                    light += share * lit_by(lamp, &point, view, facing);
                }
            }
            Light::AtLens => {
                let power = self.metered_m2 / to_eye.length_squared().max(1e-8);
                let lamp = Lamp { towards: view, light: power * Vec3::from_array(LENS_LIGHT) };
                light += (0.35 + 0.65 * openness) * lit_by(&lamp, &point, view, facing);
                if point.metal {
                    // No metal is a perfect mirror.
                    light += METAL_SCATTERS * facing * lamp.light * point.albedo;
                }
            }
        }
        let mirrored = 2.0 * facing * point.normal - view;
        if point.metal {
            let rim = schlick(0.6, facing);
            light += point.albedo * rim * self.surrounding(mirrored, point.roughness, key_share) * openness;
        } else {
            let sky = 0.5 + 0.5 * point.normal.dot(self.projection.up);
            let ambient = match self.light {
                Light::Room => Vec3::new(0.22, 0.22, 0.24).lerp(Vec3::new(0.42, 0.43, 0.45), sky),
                Light::AtLens => THROWN_BACK * (0.6 + 0.8 * sky),
            };
            // Light that was scattered in the folds around has the folds' colour.
            light += point.albedo * ambient * bounced(openness, point.albedo);
            let film = schlick(WATER_REFLECTION, facing);
            light += point.coat * film * openness * self.surrounding(mirrored, FILM_ROUGHNESS, key_share);
            // Fat and connective tissue in the capsule: a pale sheen where one looks along the surface.
            let grazing = (1.0 - facing) * (1.0 - facing) * (1.0 - facing);
            light += point.coat * grazing * openness * Vec3::new(0.10, 0.062, 0.058);
        }
        light
    }

    /// Light of the room from a direction, blurred as a surface of this roughness sees it; of the key lamp
    /// `key_share` arrives.
    fn surrounding(&self, direction: Vec3, roughness: f32, key_share: f32) -> Vec3 {
        let up = 0.5 + 0.5 * direction.dot(self.projection.up);
        if self.light == Light::AtLens {
            return THROWN_BACK * (0.5 + up);
        }
        let mut light = Vec3::new(0.16, 0.17, 0.18).lerp(Vec3::new(0.70, 0.73, 0.78), up * up);
        // The soft box around the key lamp, and a window opposite.
        let edge = |cosine: f32, limit: f32| {
            let t = ((cosine - limit + roughness * 0.5) / (roughness + 0.02)).clamp(0.0, 1.0);
            t * t * (3.0 - 2.0 * t)
        };
        light += key_share * edge(direction.dot(self.lamps[0].towards), 0.93) * Vec3::new(3.0, 2.95, 2.9);
        light += edge(direction.dot(self.lamps[1].towards), 0.95) * Vec3::new(0.9, 1.0, 1.15);
        light
    }

    fn background(&self, column: usize, row: usize) -> Vec3 {
        if self.light == Light::AtLens {
            return 0.08 * THROWN_BACK;
        }
        let [width, height] = self.samples.size.map(|edge| edge as f32);
        let (x, y) = ((column as f32 + 0.5) / width - 0.5, (row as f32 + 0.5) / height);
        let [top, bottom] = self.background;
        let light = top.lerp(bottom, y * y);
        light * (1.0 - 0.9 * (x * x + (y - 0.55) * (y - 0.55)))
    }

    /// Place [m] and normal of the nearest surface in each pixel that is no overlay.
    fn nearest(&self) -> Vec<Option<(Vec3, Vec3)>> {
        let [width, height] = self.samples.size;
        (0..width * height)
            .into_par_iter()
            .map(|pixel| {
                let mut hits = self.samples.of_pixel(pixel).iter().map(|fragment| self.hit(fragment));
                hits.find(|hit| !hit.part.overlay).map(|hit| (hit.position, hit.normal))
            })
            .collect()
    }

    /// Openness of each pixel's nearest surface, averaged over a small window of similar depth.
    fn obscured(&self, nearest: &[Option<(Vec3, Vec3)>]) -> Vec<f32> {
        let [width, height] = self.samples.size;
        let (low, high) = self.facets.organ_bounds.unwrap_or((Vec3::ZERO, Vec3::ONE));
        let reach_m = OBSCURANCE_REACH * (high - low).length();
        let pattern = obscurance_pattern();
        // An order of the rotations in which neighbours differ much.
        const DITHER: [usize; 16] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
        let raw: Vec<f32> = (0..width * height)
            .into_par_iter()
            .map(|pixel| {
                let Some((position, normal)) = nearest[pixel] else { return 1.0 };
                let (x, y) = (pixel % width, pixel / width);
                let depth = (position - self.projection.eye).dot(self.projection.forward);
                let radius = reach_m * self.projection.focal_pixels / depth;
                let rotation = DITHER[(x % 4) + 4 * (y % 4)];
                let mut sum = 0.0;
                for offset in &pattern[rotation * OBSCURANCE_SAMPLES..][..OBSCURANCE_SAMPLES] {
                    let (u, v) = (x as f32 + radius * offset.x, y as f32 + radius * offset.y);
                    if u < 0.0 || v < 0.0 || u >= width as f32 || v >= height as f32 {
                        continue;
                    }
                    if let Some((other, _)) = nearest[u as usize + width * v as usize] {
                        let to_other = (other - position) / reach_m;
                        let squared = to_other.length_squared();
                        let fade = (1.0 - squared).max(0.0);
                        let rise = (to_other.dot(normal) - 0.02).max(0.0);
                        sum += fade * fade * fade * rise / (squared + 1e-3);
                    }
                }
                (1.0 - OBSCURANCE_STRENGTH * sum / OBSCURANCE_SAMPLES as f32).max(0.0)
            })
            .collect();
        smoothed(&raw, nearest, [width, height], reach_m)
    }
}

/// Places around a pixel, in the unit circle, for every rotation in turn.
fn obscurance_pattern() -> Vec<Vec2> {
    (0..OBSCURANCE_ROTATIONS * OBSCURANCE_SAMPLES)
        .map(|i| {
            const GOLDEN_ANGLE_RAD: f32 = 2.399_963_2;
            let (rotation, sample) = (i / OBSCURANCE_SAMPLES, i % OBSCURANCE_SAMPLES);
            let turn = std::f32::consts::TAU * rotation as f32 / OBSCURANCE_ROTATIONS as f32;
            let radius = ((sample as f32 + 0.5) / OBSCURANCE_SAMPLES as f32).sqrt();
            radius * Vec2::from_angle(turn + GOLDEN_ANGLE_RAD * sample as f32)
        })
        .collect()
}

/// Values averaged over a small window of similar depth; `nearest` are place [m] and normal of each pixel.
fn smoothed(
    raw: &[f32],
    nearest: &[Option<(Vec3, Vec3)>],
    [width, height]: [usize; 2],
    reach_m: f32,
) -> Vec<f32> {
    (0..width * height)
        .into_par_iter()
        .map(|pixel| {
            let Some((position, normal)) = nearest[pixel] else { return 1.0 };
            let (x, y) = (pixel % width, pixel / width);
            let (mut sum, mut total) = (0.0, 0.0);
            for v in y.saturating_sub(OBSCURANCE_BLUR)..(y + OBSCURANCE_BLUR).min(height) {
                for u in x.saturating_sub(OBSCURANCE_BLUR)..(x + OBSCURANCE_BLUR).min(width) {
                    let other = u + width * v;
                    if let Some((place, _)) = nearest[other] {
                        let off = (place - position).dot(normal).abs() / reach_m;
                        let weight = (1.0 - 8.0 * off).max(0.0);
                        sum += weight * raw[other];
                        total += weight;
                    }
                }
            }
            if total > 0.0 { sum / total } else { raw[pixel] }
        })
        .collect()
}

/// Openness as seen after many bounces between walls of colour `albedo` (cubic fit of Jimenez, Wu, Pesce
/// and Jarabo 2016, "Practical real-time strategies for accurate indirect occlusion").
fn bounced(openness: f32, albedo: Vec3) -> Vec3 {
    let a = 2.0404 * albedo - Vec3::splat(0.3324);
    let b = -4.7951 * albedo + Vec3::splat(0.6417);
    let c = 2.7552 * albedo + Vec3::splat(0.6903);
    Vec3::splat(openness).max(((openness * a + b) * openness + c) * openness)
}

/// Light of one lamp that a place sends to the eye.
fn lit_by(lamp: &Lamp, point: &SurfacePoint, view: Vec3, facing: f32) -> Vec3 {
    let cosine = point.normal.dot(lamp.towards);
    let halfway = (lamp.towards + view).normalize_or(point.normal);
    let half_cosine = point.normal.dot(halfway).max(0.0);
    let incidence = view.dot(halfway).max(0.0);
    if point.metal {
        let shine = highlight(point.roughness, half_cosine, cosine.max(0.0), facing);
        return lamp.light * point.albedo * shine * schlick(0.6, incidence) * cosine.max(0.0);
    }
    // Red light goes furthest through tissue: it reaches round the terminator.
    let wrap = Vec3::new(0.26, 0.09, 0.07);
    let diffuse = ((Vec3::splat(cosine) + wrap) / (Vec3::ONE + wrap)).max(Vec3::ZERO);
    let mut light = point.albedo * diffuse;
    if cosine > 0.0 && point.coat > 0.0 {
        let body = 0.5 * highlight(point.roughness, half_cosine, cosine, facing);
        let film = point.coat * highlight(FILM_ROUGHNESS, half_cosine, cosine, facing);
        light += Vec3::splat((body + film) * schlick(WATER_REFLECTION, incidence) * cosine);
    }
    light * lamp.light
}

/// Microfacet distribution times visibility, with the factor pi of the lamps' units.
fn highlight(roughness: f32, half_cosine: f32, cosine: f32, facing: f32) -> f32 {
    let a2 = (roughness * roughness) * (roughness * roughness);
    let d = half_cosine * half_cosine * (a2 - 1.0) + 1.0;
    let k = 0.5 * roughness * roughness;
    let visible = 0.25 / ((cosine * (1.0 - k) + k) * (facing * (1.0 - k) + k));
    (a2 / (d * d)).min(400.0) * visible
}

fn schlick(straight: f32, cosine: f32) -> f32 {
    let c = 1.0 - cosine.clamp(0.0, 1.0);
    straight + (1.0 - straight) * (c * c) * (c * c) * c
}

fn filmic(light: Vec3) -> Vec3 {
    let x = EXPOSURE * light;
    let curved =
        x * (2.51 * x + Vec3::splat(0.03)) / (x * (2.43 * x + Vec3::splat(0.59)) + Vec3::splat(0.14));
    curved.clamp(Vec3::ZERO, Vec3::ONE)
}
