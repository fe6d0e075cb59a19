//! How organs and tools look: colour, mottling, wetness, as functions of the rest position.
//!
//! All patterns come from noise in rest coordinates, so that they move with the tissue. Colours are
//! chosen by eye after the look of the organs in open surgery; they carry no information.

use std::sync::LazyLock;

use glam::Vec3;

use super::noise::noise;

/// A kind of surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Deep red-brown under a wet capsule.
    Liver,
    /// Green-blue, thin-walled.
    GallBladder,
    /// Dark red-brown.
    Kidney,
    /// Purple.
    Spleen,
    /// Pale pink.
    Stomach,
    /// Dark red.
    Artery,
    /// Blue: portal and hepatic veins.
    Vein,
    /// Pale, yellowish.
    Tumour,
    /// Ivory, dry.
    Bone,
    /// Red with fibres.
    Muscle,
    /// Yellow.
    Fat,
    /// A fresh cut through an organ.
    Cut,
    /// Blood.
    Blood,
    /// Steel.
    Metal,
    /// Brushed steel: an instrument's shaft.
    Shaft,
    /// Plastic or ceramic in one sRGB colour.
    Plastic {
        /// The colour.
        colour: [u8; 3],
    },
    /// A sign: one sRGB colour, little shading.
    Sign {
        /// The colour.
        colour: [u8; 3],
    },
    /// An unnamed organ in one sRGB colour.
    Plain {
        /// The colour.
        colour: [u8; 3],
    },
}

impl Look {
    /// Look of a structure of this name (`liver`, `portal_vein`, `left kidney`, ...); grey-pink when unknown.
    pub fn of_structure(name: &str) -> Self {
        const LOOKS: [(&str, Look); 18] = [
            ("tumour", Look::Tumour),
            ("tumor", Look::Tumour),
            ("gall", Look::GallBladder),
            ("vein", Look::Vein),
            ("vessel", Look::Vein),
            ("cava", Look::Vein),
            ("portal", Look::Vein),
            ("arter", Look::Artery),
            ("aorta", Look::Artery),
            ("liver", Look::Liver),
            ("kidney", Look::Kidney),
            ("spleen", Look::Spleen),
            ("stomach", Look::Stomach),
            ("spine", Look::Bone),
            ("rib", Look::Bone),
            ("bone", Look::Bone),
            ("muscle", Look::Muscle),
            ("fat", Look::Fat),
        ];
        let name = name.to_lowercase();
        let found = LOOKS.iter().find(|(part, _)| name.contains(part));
        found.map_or(Self::Plain { colour: [196, 160, 150] }, |&(_, look)| look)
    }

    /// Look of tissue of this name; of a liver when unknown.
    pub fn of_tissue(name: &str) -> Self {
        match Self::of_structure(name) {
            Self::Plain { .. } => Self::Liver,
            known => known,
        }
    }

    fn recipe(self) -> Recipe {
        let tissue = |base: [u8; 3], dark: [u8; 3]| Recipe { base, dark, ..WET };
        match self {
            Self::Liver => Recipe { lobules: 0.42, ..tissue([124, 55, 44], [68, 27, 23]) },
            Self::GallBladder => tissue([98, 128, 84], [48, 82, 62]),
            Self::Kidney => tissue([134, 62, 52], [88, 34, 32]),
            Self::Spleen => tissue([112, 50, 66], [68, 26, 42]),
            Self::Stomach => tissue([214, 142, 128], [176, 98, 90]),
            Self::Artery => tissue([170, 40, 36], [120, 22, 22]),
            Self::Vein => tissue([70, 84, 148], [44, 50, 106]),
            Self::Tumour => Recipe { lobules: 0.2, ..tissue([222, 198, 156], [178, 140, 104]) },
            Self::Bone => Recipe { coat: 0.25, ..tissue([228, 214, 184], [196, 176, 140]) },
            Self::Muscle => tissue([164, 64, 56], [116, 36, 34]),
            Self::Fat => tissue([232, 198, 112], [204, 160, 76]),
            Self::Cut => Recipe { lobules: 0.5, roughness: 0.4, ..tissue([158, 44, 36], [98, 20, 18]) },
            Self::Blood => Recipe { lobules: 0.0, bumps: [0.0; 2], ..tissue([112, 6, 8], [92, 3, 5]) },
            Self::Plain { colour } => tissue(colour, colour.map(|c| c / 10 * 7)),
            Self::Metal => Recipe { base: [226, 228, 232], dark: [226, 228, 232], roughness: 0.22, ..METAL },
            Self::Shaft => Recipe { base: [132, 136, 144], dark: [132, 136, 144], roughness: 0.40, ..METAL },
            Self::Plastic { colour } => Recipe { base: colour, dark: colour, ..PLASTIC },
            Self::Sign { colour } => Recipe { base: colour, dark: colour, ..SIGN },
        }
    }
}

/// The numbers behind a look.
#[derive(Clone, Copy, Debug)]
struct Recipe {
    /// sRGB colours between which the mottling moves.
    base: [u8; 3],
    dark: [u8; 3],
    /// Strength of the pattern of lobules (about 1.5 mm).
    lobules: f32,
    /// Slopes of the unevenness, coarse and fine.
    bumps: [f32; 2],
    /// Width of the body's highlight.
    roughness: f32,
    /// Strength of the wet film.
    coat: f32,
    metal: bool,
    /// Light of its own: a sign needs no lamp.
    glow: f32,
}

const WET: Recipe = Recipe {
    base: [0; 3],
    dark: [0; 3],
    lobules: 0.07,
    bumps: [0.08, 0.03],
    roughness: 0.5,
    coat: 1.0,
    metal: false,
    glow: 0.0,
};
const METAL: Recipe = Recipe { lobules: 0.0, bumps: [0.0, 0.0], coat: 0.0, metal: true, ..WET };
const PLASTIC: Recipe = Recipe { lobules: 0.0, bumps: [0.0, 0.0], coat: 0.35, roughness: 0.4, ..WET };
const SIGN: Recipe = Recipe { lobules: 0.0, bumps: [0.0, 0.0], coat: 0.0, glow: 0.45, roughness: 0.6, ..WET };

/// A look at one place.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePoint {
    /// Linear diffuse colour; the reflected colour of a metal.
    pub(super) albedo: Vec3,
    /// Unit normal with the unevenness.
    pub(super) normal: Vec3,
    pub(super) roughness: f32,
    pub(super) coat: f32,
    pub(super) metal: bool,
    pub(super) glow: f32,
}

/// Periods of the patterns [m].
const TONE_PERIODS_M: [f32; 2] = [0.048, 0.017];
const MOTTLE_PERIOD_M: f32 = 0.0055;
const LOBULE_PERIOD_M: f32 = 0.0021;
const BUMP_PERIODS_M: [f32; 2] = [0.021, 0.0042];

/// `look` at rest position `rest` [m], where the smooth surface has `normal` and a pixel spans `pixel_m`;
/// patterns too fine for the pixels fade out.
pub(super) fn surface_point(look: Look, rest: Vec3, normal: Vec3, pixel_m: f32) -> SurfacePoint {
    let recipe = look.recipe();
    let (base, dark) = (linear(recipe.base), linear(recipe.dark));
    let mut point = SurfacePoint {
        albedo: base,
        normal,
        roughness: recipe.roughness,
        coat: recipe.coat,
        metal: recipe.metal,
        glow: recipe.glow,
    };
    if recipe.metal || recipe.glow > 0.0 {
        return point;
    }
    let visible = |period_m: f32| (period_m / pixel_m / 2.0 - 1.0).clamp(0.0, 1.0);
    let tone = noise(rest / TONE_PERIODS_M[0]).0 + 0.6 * noise(rest / TONE_PERIODS_M[1]).0;
    let mottle = noise(rest / MOTTLE_PERIOD_M).0 * visible(MOTTLE_PERIOD_M);
    let mix = (0.42 - 0.70 * tone - 0.45 * mottle).clamp(0.0, 1.0);
    let mut albedo = base.lerp(dark, mix);
    let fine = visible(LOBULE_PERIOD_M);
    if fine > 0.0 && recipe.lobules > 0.0 {
        // Bright cells with a dark net between them.
        let cell = noise(rest / LOBULE_PERIOD_M).0;
        albedo *= 1.0 + recipe.lobules * fine * (1.4 * cell.abs().min(0.7) - 0.35);
    }
    point.albedo = albedo;
    let mut slope = Vec3::ZERO;
    for (period_m, height) in BUMP_PERIODS_M.into_iter().zip(recipe.bumps) {
        let strength = height * visible(period_m);
        if strength > 0.0 {
            slope += strength * noise(rest / period_m).1;
        }
    }
    slope -= slope.dot(normal) * normal;
    point.normal = (normal - slope).normalize_or(normal);
    point
}

/// Linear light of an sRGB byte colour (IEC 61966-2-1).
pub(super) fn linear(colour: [u8; 3]) -> Vec3 {
    static TABLE: LazyLock<[f32; 256]> =
        LazyLock::new(|| std::array::from_fn(|c| linear_of_srgb(c as f64 / 255.0) as f32));
    Vec3::from_array(colour.map(|c| TABLE[usize::from(c)]))
}

fn linear_of_srgb(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Bytes of the sRGB curve for linear light in steps of 1/4095.
#[derive(Debug)]
pub(super) struct SrgbTable(Vec<u8>);

impl SrgbTable {
    const LAST: usize = 4095;

    /// The one of all pictures.
    pub(super) fn shared() -> &'static Self {
        static TABLE: LazyLock<SrgbTable> = LazyLock::new(SrgbTable::new);
        &TABLE
    }

    fn new() -> Self {
        let encode = |l: f64| if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
        let byte = |i: usize| (encode(i as f64 / Self::LAST as f64) * 255.0).round() as u8;
        Self((0..=Self::LAST).map(byte).collect())
    }

    /// Byte colour of linear light; outside [0, 1] is cut off.
    pub(super) fn encode(&self, light: Vec3) -> [u8; 3] {
        light.to_array().map(|l| self.0[(l.clamp(0.0, 1.0) * Self::LAST as f32 + 0.5) as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_goes_there_and_back() {
        let table = SrgbTable::new();
        for c in 0..=255u8 {
            let [back, ..] = table.encode(linear([c; 3]));
            assert!(back.abs_diff(c) <= 1, "{c} became {back}");
        }
    }

    #[test]
    fn structures_find_their_look() {
        assert_eq!(Look::of_structure("liver"), Look::Liver);
        assert_eq!(Look::of_structure("Portal_Vein"), Look::Vein);
        assert_eq!(Look::of_structure("gall bladder"), Look::GallBladder);
        assert_eq!(Look::of_structure("liver_tumour"), Look::Tumour);
        assert!(matches!(Look::of_structure("thing"), Look::Plain { .. }));
    }
}
