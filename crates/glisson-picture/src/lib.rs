//! Pictures drawn on the processor: no GPU, no window, no system font.
//!
//! A scene of organs, instruments and force arrows becomes a PNG for reports and headless runs. The way:
//! everything is turned into triangles (`geometry`, `instrument`, `piece`), the triangles are z-buffered at 3 x 3 samples a pixel
//! (`raster`), each pixel's samples are grouped by surface and each group is shaded once (`shade`, `look`),
//! with one shadow map and screen-space ambient obscurance; then captions are laid over (`text`).
//! What a simulation shows is brought into this form by `of_world`. Slices of a volume with its labels are in `slice`.
//!
//! Own code, because no kept crate fits: `euc` (Apache-2.0 and MIT, 0.5.3) has had no release for years and
//! brings its own vector library; the others need a GPU or a display. Letters come from
//! `noto-sans-mono-bitmap` (MIT; Noto is under the SIL Open Font License), rasterised at its build time.
//!
//! Deterministic: work is split into fixed bands of rows, no step depends on the number of threads, and
//! the only transcendental function is a table of the sRGB curve rounded to bytes.

mod noise;
mod look;
mod piece;
mod instrument;
mod camera;
mod geometry;
mod clip;
mod of_world;
mod raster;
mod shade;
mod text;
mod slice;

pub use camera::{Camera, View};
pub use geometry::{Arrow, ShadedSurface, bounds_of};
pub use instrument::{Instrument, JawShape, WorkingEnd};
pub use look::Look;
pub use of_world::{Shown, looks_of, shown_of};
pub use slice::{SlicePlane, SliceSpec, slice_picture};
pub use text::{Caption, CaptionPlace};

use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, ensure};
use rayon::prelude::*;

/// Largest edge of a picture [pixels]: beyond it a wrong size is likelier than a wish.
const MAX_EDGE_PIXELS: usize = 8192;

/// What to draw.
#[derive(Clone, Debug)]
pub struct PictureScene {
    /// Organs.
    pub surfaces: Vec<ShadedSurface>,
    /// Tools.
    pub instruments: Vec<Instrument>,
    /// Forces.
    pub arrows: Vec<Arrow>,
    /// Lines of text over the picture.
    pub captions: Vec<Caption>,
    /// From where.
    pub camera: Camera,
    /// Width and height [pixels].
    pub size: [usize; 2],
}

/// What is seen at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// How deep it is along the view [m].
    pub depth_m: f32,
    /// Number of its surface; none for instruments and arrows.
    pub surface: Option<usize>,
}

impl PictureScene {
    fn checked_size(&self) -> anyhow::Result<[usize; 2]> {
        let [width, height] = self.size;
        ensure!(
            (1..=MAX_EDGE_PIXELS).contains(&width) && (1..=MAX_EDGE_PIXELS).contains(&height),
            "picture of {width} x {height} pixels: each edge must be 1 to {MAX_EDGE_PIXELS}"
        );
        Ok(self.size)
    }

    /// What is seen at the middle of each pixel, row by row from the top; none where nothing is.
    ///
    /// # Errors
    /// As [`Picture::render`].
    pub fn depths_and_surfaces(&self) -> anyhow::Result<Vec<Option<Seen>>> {
        let size = self.checked_size()?;
        let facets = geometry::Facets::of_scene(self)?;
        let seen = raster::depths_and_parts(&facets, &self.camera, size);
        // A part for each surface comes first.
        let surface = |part: u32| Some(part as usize).filter(|part| *part < self.surfaces.len());
        let pixel = |(depth_m, part)| Seen { depth_m, surface: surface(part) };
        Ok(seen.into_iter().map(|seen| seen.map(pixel)).collect())
    }
}

/// Pixels: 8-bit sRGB, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width and height [pixels].
    pub(crate) size: [usize; 2],
    /// Red, green, blue of each pixel: `3 * width * height` bytes.
    pub(crate) rgb: Vec<u8>,
}

impl Picture {
    /// One colour everywhere.
    pub(crate) fn filled(size: [usize; 2], colour: [u8; 3]) -> Self {
        Self { size, rgb: colour.repeat(size[0] * size[1]) }
    }

    /// Draws `scene`.
    ///
    /// # Errors
    /// When the size is zero or absurd, a triangle names a vertex that is not there, rest and current
    /// positions differ in number, or a position is not finite.
    pub fn render(scene: &PictureScene) -> anyhow::Result<Self> {
        let [width, height] = scene.checked_size()?;
        let facets = geometry::Facets::of_scene(scene)?;
        let samples = raster::Samples::of_view(&facets, &scene.camera, scene.size);
        let shading = shade::Shading::new(&facets, &scene.camera, &samples);
        let mut picture = Self { size: scene.size, rgb: vec![0; 3 * width * height] };
        picture.rgb.par_chunks_mut(3 * width).enumerate().for_each(|(row, bytes)| {
            shading.row_into(row, bytes);
        });
        for caption in &scene.captions {
            text::draw_caption(&mut picture, caption);
        }
        Ok(picture)
    }

    /// Red, green, blue of each pixel, row by row from the top; 8-bit sRGB.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// [`Picture::rgb`], kept.
    pub fn into_rgb(self) -> Vec<u8> {
        self.rgb
    }

    /// Writes a PNG; a failure leaves no half-written file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_png(&self, path: &Path) -> anyhow::Result<()> {
        glisson::files::write_atomically(path, |writer| self.encode(writer))
            .with_context(|| format!("writing the picture {}", path.display()))
    }

    /// The picture as PNG.
    ///
    /// # Errors
    /// When an edge has 2^32 pixels or more.
    pub fn png(&self) -> anyhow::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes).context("writing a picture")?;
        Ok(bytes)
    }

    fn encode(&self, out: impl Write) -> io::Result<()> {
        let [width, height] = self.size.map(u32::try_from);
        let too_large = |_| io::Error::other("picture edge above 2^32 pixels");
        let mut encoder = png::Encoder::new(out, width.map_err(too_large)?, height.map_err(too_large)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut image = encoder.write_header().map_err(io::Error::other)?;
        image.write_image_data(&self.rgb).map_err(io::Error::other)?;
        image.finish().map_err(io::Error::other)
    }

    #[cfg(test)]
    /// Colour of the pixel at column `x`, row `y`.
    pub(crate) fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        let at = 3 * (x + y * self.size[0]);
        [self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]]
    }

    /// Lays `colour` over the pixel at column `x`, row `y` with opacity `alpha` (0 to 255); outside is
    /// nothing.
    pub(crate) fn blend(&mut self, [x, y]: [usize; 2], colour: [u8; 3], alpha: u8) {
        if x >= self.size[0] || y >= self.size[1] {
            return;
        }
        let at = 3 * (x + y * self.size[0]);
        let alpha = u32::from(alpha);
        for (old, new) in self.rgb[at..at + 3].iter_mut().zip(colour) {
            let mixed = (u32::from(*old) * (255 - alpha) + u32::from(new) * alpha + 127) / 255;
            *old = u8::try_from(mixed).expect("a mean of bytes is a byte");
        }
    }

    /// `self` and `other` side by side, top edges aligned, `gap` pixels between, on `colour`.
    pub fn beside(&self, other: &Self, gap: usize, colour: [u8; 3]) -> Self {
        let size = [self.size[0] + gap + other.size[0], self.size[1].max(other.size[1])];
        let mut both = Self::filled(size, colour);
        for (part, offset) in [(self, 0), (other, self.size[0] + gap)] {
            for (row, bytes) in part.rgb.chunks_exact(3 * part.size[0]).enumerate() {
                let start = 3 * (row * size[0] + offset);
                both.rgb[start..start + bytes.len()].copy_from_slice(bytes);
            }
        }
        both
    }
}

#[cfg(test)]
mod tests;
