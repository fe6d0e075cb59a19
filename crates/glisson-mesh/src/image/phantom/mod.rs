//! The synthetic patient: a portal-phase CT of an upper abdomen and its true label map, made from a seed.
//!
//! Organs are implicit shapes painted over each other; a voxel on a border gets the mixture that the
//! distance to the border says (partial volume). Then the image is blurred by a Gaussian (the scanner's
//! point spread), white noise is added and the numbers are rounded to whole Hounsfield units.
//! The label of a voxel is the organ at its centre.
//!
//! CT numbers of liver, muscle, spleen, kidney, vessels, tumour, gall bladder, stomach, fat and air are set
//! by the task (portal venous phase); bone, skin and lung are common textbook values.

mod anatomy;
mod shapes;
mod vessels;

use rayon::prelude::*;

use self::anatomy::{Anatomy, Organ};
use super::filter::gaussian;
use super::vessels::Tube;
use super::{LabelMap, Volume, VoxelGrid};
use crate::math::{DMat3, DVec3, SeededRandom};

/// Part of the body that the image covers [m].
const FIELD_OF_VIEW_M: DVec3 = DVec3::new(0.384, 0.222, 0.216);

/// What the label map distinguishes. The number is the label.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Tissue {
    /// Around the body.
    Air = 0,
    /// Liver without its vessels and tumour.
    Liver = 1,
    /// A hypodense tumour inside the liver.
    LiverTumour = 2,
    /// Portal vein inside the liver.
    PortalVein = 3,
    /// Hepatic veins inside the liver.
    HepaticVein = 4,
    /// Gall bladder with its bile.
    GallBladder = 5,
    /// Spleen.
    Spleen = 6,
    /// The patient's right kidney, which touches the liver.
    KidneyRight = 7,
    /// The patient's left kidney.
    KidneyLeft = 8,
    /// Stomach, filled.
    Stomach = 9,
    /// Vertebrae and spinal canal.
    Spine = 10,
    /// Ribs.
    Rib = 11,
    /// Body wall, back and diaphragm.
    Muscle = 12,
    /// Fat under the skin and between the organs.
    Fat = 13,
    /// Skin.
    Skin = 14,
    /// Bases of the lungs.
    Lung = 15,
    /// Aorta.
    Aorta = 16,
    /// Inferior vena cava, with the hepatic vein's stem outside the liver.
    VenaCava = 17,
    /// Portal vein outside the liver.
    PortalTrunk = 18,
}

impl Tissue {
    /// All that have a label, ascending.
    pub const ALL: [Self; 18] = [
        Self::Liver,
        Self::LiverTumour,
        Self::PortalVein,
        Self::HepaticVein,
        Self::GallBladder,
        Self::Spleen,
        Self::KidneyRight,
        Self::KidneyLeft,
        Self::Stomach,
        Self::Spine,
        Self::Rib,
        Self::Muscle,
        Self::Fat,
        Self::Skin,
        Self::Lung,
        Self::Aorta,
        Self::VenaCava,
        Self::PortalTrunk,
    ];

    /// Label in the label map.
    pub fn label(self) -> u16 {
        self as u16
    }

    /// Name in the label map.
    pub fn name(self) -> &'static str {
        match self {
            Self::Air => "air",
            Self::Liver => "liver",
            Self::LiverTumour => "liver_tumour",
            Self::PortalVein => "portal_vein",
            Self::HepaticVein => "hepatic_vein",
            Self::GallBladder => "gall_bladder",
            Self::Spleen => "spleen",
            Self::KidneyRight => "kidney_right",
            Self::KidneyLeft => "kidney_left",
            Self::Stomach => "stomach",
            Self::Spine => "spine",
            Self::Rib => "ribs",
            Self::Muscle => "muscle",
            Self::Fat => "fat",
            Self::Skin => "skin",
            Self::Lung => "lung",
            Self::Aorta => "aorta",
            Self::VenaCava => "vena_cava",
            Self::PortalTrunk => "portal_trunk",
        }
    }

    /// CT number [HU] before blur and noise. Bone is not uniform: this is its hard shell.
    pub fn hounsfield(self) -> f64 {
        match self {
            Self::Air => -1000.0,
            Self::Lung => -850.0,
            Self::Fat => -90.0,
            Self::GallBladder => 10.0,
            Self::Stomach | Self::Skin => 30.0,
            Self::Muscle => 60.0,
            Self::LiverTumour => 70.0,
            Self::Liver => 110.0,
            Self::Spleen => 120.0,
            Self::PortalVein | Self::HepaticVein | Self::PortalTrunk | Self::Aorta | Self::VenaCava => 170.0,
            Self::KidneyRight | Self::KidneyLeft => 180.0,
            Self::Spine => 500.0,
            Self::Rib => 650.0,
        }
    }

    fn coat(self) -> Coat {
        self.coat_of_hu(self.hounsfield())
    }

    fn coat_of_hu(self, hounsfield: f64) -> Coat {
        Coat { label: self.label(), hounsfield }
    }
}

/// What is painted: a label and a CT number.
#[derive(Clone, Copy, Debug)]
struct Coat {
    label: u16,
    hounsfield: f64,
}

/// What to make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhantomParams {
    /// Chooses the patient and the noise.
    pub seed: u64,
    /// Edge of the cubic voxels [m].
    pub voxel_m: f64,
    /// Standard deviation of the Gaussian blur [m].
    pub blur_m: f64,
    /// Standard deviation of the noise [HU].
    pub noise_hu: f64,
}

impl Default for PhantomParams {
    fn default() -> Self {
        Self { seed: 1, voxel_m: 1.5e-3, blur_m: 1e-3, noise_hu: 20.0 }
    }
}

/// A CT and the truth about it, on the same grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Phantom {
    /// Whole Hounsfield units.
    pub ct: Volume<f32>,
    /// The organ at the centre of each voxel; see [`Tissue`].
    pub labels: LabelMap,
    /// The vessels inside the liver: portal vein and hepatic vein, from trunk to branches.
    pub vessels: Vec<Tube>,
}

/// The synthetic patient of `params`. The same bits on every machine and at any number of threads.
///
/// # Panics
/// A voxel size outside 0.5 mm to 10 mm.
pub fn generate(params: &PhantomParams) -> Phantom {
    let (mut values, PhantomTruth { labels, vessels }) = paint(params.seed, params.voxel_m);
    let grid = labels.grid.clone();
    let n_slice = grid.dims[0] * grid.dims[1];
    values = gaussian(&grid, &values, params.blur_m);
    values.par_chunks_mut(n_slice).enumerate().for_each(|(k, slice)| {
        // One sequence a slice: the noise does not depend on which thread comes first.
        let mut random = SeededRandom::new(params.seed ^ (k as u64 + 1).wrapping_mul(0xD1B5_4A32_D192_ED03));
        for value in slice {
            *value = (f64::from(*value) + params.noise_hu * random.normal()).round() as f32;
        }
    });
    Phantom { ct: Volume { grid, values }, labels, vessels }
}

/// What is true of a synthetic patient, without an image of it.
#[derive(Clone, Debug, PartialEq)]
pub struct PhantomTruth {
    /// The organ at the centre of each voxel; see [`Tissue`].
    pub labels: LabelMap,
    /// The vessels inside the liver: portal vein and hepatic vein, from trunk to branches.
    pub vessels: Vec<Tube>,
}

/// The truth of [`generate`] alone, which takes no blur and no noise.
///
/// # Panics
/// A voxel size outside 0.5 mm to 10 mm.
pub fn truth(seed: u64, voxel_m: f64) -> PhantomTruth {
    paint(seed, voxel_m).1
}

/// Places of a synthetic patient, by its shapes and not by voxels.
pub struct PhantomPlaces {
    anatomy: Anatomy,
}

/// How far a way out is looked for, and by which steps [m].
const FURTHEST_OUT_M: f64 = 0.4;
const WAY_OUT_STEP_M: f64 = 1e-3;

impl PhantomPlaces {
    /// Of the patient of `seed`.
    pub fn new(seed: u64) -> Self {
        Self { anatomy: Anatomy::new(seed) }
    }

    /// The middle of the tumour, the gall bladder, the spleen or a kidney [m]; none of what has no middle worth naming.
    pub fn middle_m(&self, tissue: Tissue) -> Option<DVec3> {
        self.anatomy.middle_m(tissue)
    }

    /// The ends of the gall bladder's axis [m]: neck and fundus, each the middle of the ball that closes it.
    pub fn gall_bladder_ends_m(&self) -> [DVec3; 2] {
        self.anatomy.gall_bladder_ends_m()
    }

    /// Where the way from a place inside the liver, straight along a unit vector, leaves it [m]; none from outside.
    pub fn way_out_of_liver_m(&self, from_m: DVec3, toward: DVec3) -> Option<DVec3> {
        let f = |away_m: f64| self.anatomy.liver(from_m + toward * away_m);
        if f(0.0) >= 0.0 {
            return None;
        }
        let steps = (1..).map(|step| f64::from(step) * WAY_OUT_STEP_M);
        let mut out_m =
            steps.take_while(|away_m| *away_m <= FURTHEST_OUT_M).find(|away_m| f(*away_m) >= 0.0)?;
        let mut in_m = out_m - WAY_OUT_STEP_M;
        // To a nanometre.
        for _ in 0..20 {
            let middle_m = 0.5 * (in_m + out_m);
            *(if f(middle_m) < 0.0 { &mut in_m } else { &mut out_m }) = middle_m;
        }
        Some(from_m + toward * out_m)
    }
}

/// CT numbers [HU] without blur and noise, and the truth.
fn paint(seed: u64, voxel_m: f64) -> (Vec<f32>, PhantomTruth) {
    assert!((0.5e-3..=10e-3).contains(&voxel_m), "voxels of 0.5 mm to 10 mm");
    let grid = grid(voxel_m);
    let anatomy = Anatomy::new(seed);
    let organs = anatomy.organs();
    let n_slice = grid.dims[0] * grid.dims[1];
    let mut labels = vec![Tissue::Air.label(); grid.n_voxels()];
    let mut values = vec![Tissue::Air.hounsfield() as f32; grid.n_voxels()];
    let slices = values.par_chunks_mut(n_slice).zip(labels.par_chunks_mut(n_slice));
    slices.enumerate().for_each(|(k, (values, labels))| {
        let mut slice = Slice { grid: &grid, k, values, labels };
        slice.paint_torso(&anatomy);
        for organ in &organs {
            slice.paint_organ(organ);
        }
    });
    let names = Tissue::ALL.map(|t| (t.label(), t.name().to_string())).to_vec();
    let labels = LabelMap { grid, labels, names, colours: Vec::new() };
    (values, PhantomTruth { labels, vessels: anatomy.vessels() })
}

/// Cubic voxels that cover the field of view, centred on the origin.
fn grid(voxel_m: f64) -> VoxelGrid {
    let dims = [0, 1, 2].map(|axis| (FIELD_OF_VIEW_M[axis] / voxel_m).round() as usize);
    let half_m = 0.5 * voxel_m * DVec3::new(dims[0] as f64 - 1.0, dims[1] as f64 - 1.0, dims[2] as f64 - 1.0);
    VoxelGrid { dims, spacing_m: DVec3::splat(voxel_m), origin_m: -half_m, axes: DMat3::IDENTITY }
}

/// One slice of the image while it is painted.
struct Slice<'a> {
    grid: &'a VoxelGrid,
    k: usize,
    values: &'a mut [f32],
    labels: &'a mut [u16],
}

impl Slice<'_> {
    fn paint_torso(&mut self, anatomy: &Anatomy) {
        let voxel_m = self.grid.spacing_m.x;
        for j in 0..self.grid.dims[1] {
            for i in 0..self.grid.dims[0] {
                let place = i + self.grid.dims[0] * j;
                let point_m = self.grid.position_m(DVec3::new(i as f64, j as f64, self.k as f64));
                let (value, label) = (&mut self.values[place], &mut self.labels[place]);
                anatomy
                    .paint_torso(point_m, |coat, distance_m| cover(value, label, coat, distance_m / voxel_m));
            }
        }
    }

    fn paint_organ(&mut self, organ: &Organ<'_>) {
        let low = self.grid.voxel_at(organ.bounds_m.min_m);
        let high = self.grid.voxel_at(organ.bounds_m.max_m);
        if (self.k as f64) < low.z || self.k as f64 > high.z {
            return;
        }
        // Saturating casts keep the range inside the image.
        let range = |axis: usize| {
            low[axis].ceil() as usize..self.grid.dims[axis].min(high[axis].floor() as usize + 1)
        };
        let voxel_m = self.grid.spacing_m.x;
        for j in range(1) {
            for i in range(0) {
                let place = i + self.grid.dims[0] * j;
                let point_m = self.grid.position_m(DVec3::new(i as f64, j as f64, self.k as f64));
                let distance = (organ.shape)(point_m) / voxel_m;
                cover(&mut self.values[place], &mut self.labels[place], organ.coat, distance);
            }
        }
    }
}

/// Paints over a voxel as far as a border at `distance` [voxels] (negative: the centre is inside) covers it.
fn cover(value: &mut f32, label: &mut u16, coat: Coat, distance: f64) {
    let share = (0.5 - distance).clamp(0.0, 1.0);
    if share > 0.0 {
        *value += (share * (coat.hounsfield - f64::from(*value))) as f32;
    }
    if distance < 0.0 {
        *label = coat.label;
    }
}
