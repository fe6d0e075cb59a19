//! The shapes of the synthetic abdomen, chosen from a seed.
//!
//! Millimetres below are in the patient frame (LPS) with the origin in the middle of the upper abdomen.
//! Organs are painted in the order of [`Anatomy::organs`]; a later one covers what it overlaps. So two
//! organs touch where the earlier one reaches a little into the later.

use super::shapes::{Tube, cylinder, ellipsoid, mm, smooth_difference, smooth_union};
use super::vessels::{Branching, grow_tree};
use super::{Coat, Tissue};
use crate::image::vessels;
use crate::math::{Aabb, DVec3, SeededRandom};

/// How far an organ that the liver rests on reaches into it, so that they touch [m].
const CONTACT_M: f64 = 1.0e-3;
/// Width of the fat between liver and spleen [m].
const SPLEEN_GAP_M: f64 = 2.0e-3;
/// Liver tissue over the branches of the veins; only the two stems come up to the surface [m].
const BRANCH_COVER_M: f64 = 3.0e-3;
/// Skin [m].
const SKIN_M: f64 = 2.0e-3;
/// Muscle of the body wall [m].
const WALL_M: f64 = 11.0e-3;

/// An organ as a function of place.
pub(super) struct Organ<'a> {
    pub(super) coat: Coat,
    /// Box outside which it has no voxel.
    pub(super) bounds_m: Aabb,
    /// Negative inside, close to the signed distance [m] near the surface.
    pub(super) shape: Box<dyn Fn(DVec3) -> f64 + Sync + 'a>,
}

/// Centre and half axes of an ellipsoid [m].
#[derive(Clone, Copy, Debug)]
struct Lobe {
    center_m: DVec3,
    half_m: DVec3,
}

impl Lobe {
    fn at(self, point_m: DVec3) -> f64 {
        ellipsoid(point_m, self.center_m, self.half_m)
    }

    fn bounds_m(self) -> Aabb {
        Aabb { min_m: self.center_m - self.half_m, max_m: self.center_m + self.half_m }
    }
}

/// All that the seed decides.
pub(super) struct Anatomy {
    body_center_y_m: f64,
    body_half_m: [f64; 2],
    subcutaneous_fat_m: f64,
    right_lobe: Lobe,
    middle_lobe: Lobe,
    left_lobe: Lobe,
    visceral_hollow: Lobe,
    fissure: Lobe,
    /// Wave vectors [rad/m] and phases of the unevenness of the liver.
    bumps: [(DVec3, f64); 4],
    kidneys: [Lobe; 2],
    fundus: Lobe,
    gastric_body: Tube,
    spleen: Lobe,
    gall_bladder: Tube,
    vena_cava: Tube,
    aorta: Tube,
    portal_trunk: Tube,
    hepatic_root: Tube,
    portal_tree: Vec<Tube>,
    hepatic_tree: Vec<Tube>,
    tumour: Lobe,
    rib_offset_m: f64,
}

/// Right, middle and left lobe, visceral hollow and fissure. `about` gives a value within a share of the one asked for.
fn liver_lobes(about: &mut impl FnMut(f64, f64) -> f64, inner_x_m: f64) -> [Lobe; 5] {
    let right_half = mm(about(74.0, 0.03), about(40.5, 0.03), about(79.0, 0.03));
    // The right lobe rests on the body wall.
    let right_center =
        mm(0.0, about(-10.0, 0.15), about(2.0, 0.5)) - DVec3::X * (inner_x_m + 2e-3 - right_half.x);
    let right_lobe = Lobe { center_m: right_center, half_m: right_half };
    let middle_lobe = Lobe {
        center_m: mm(about(-18.0, 0.2), about(-20.0, 0.1), about(11.0, 0.2)),
        half_m: mm(about(62.0, 0.04), about(31.0, 0.04), about(57.0, 0.04)),
    };
    let left_lobe = Lobe {
        center_m: mm(about(35.0, 0.05), about(-27.0, 0.08), about(24.0, 0.1)),
        half_m: mm(about(96.0, 0.03), about(25.0, 0.04), about(40.0, 0.04)),
    };
    let visceral_hollow = Lobe {
        center_m: mm(about(5.0, 0.5), about(50.0, 0.06), about(-55.0, 0.08)),
        half_m: mm(about(70.0, 0.04), about(48.0, 0.04), about(62.0, 0.04)),
    };
    let fissure = Lobe {
        center_m: mm(about(16.0, 0.25), about(-34.0, 0.08), about(-27.0, 0.08)),
        half_m: mm(about(8.0, 0.12), about(40.0, 0.05), about(36.0, 0.08)),
    };
    [right_lobe, middle_lobe, left_lobe, visceral_hollow, fissure]
}

/// Both kidneys.
fn kidney_lobes(about: &mut impl FnMut(f64, f64) -> f64) -> [Lobe; 2] {
    let kidney_half = mm(about(26.0, 0.04), about(23.0, 0.04), about(54.0, 0.04));
    [
        Lobe { center_m: mm(about(-66.0, 0.04), about(38.0, 0.03), about(-45.0, 0.08)), half_m: kidney_half },
        Lobe { center_m: mm(about(64.0, 0.04), about(44.0, 0.03), about(-38.0, 0.08)), half_m: kidney_half },
    ]
}

fn stomach(about: &mut impl FnMut(f64, f64) -> f64) -> (Lobe, Tube) {
    let fundus = Lobe {
        center_m: mm(about(66.0, 0.04), about(17.0, 0.1), about(30.0, 0.1)),
        half_m: mm(about(34.0, 0.05), about(27.0, 0.05), about(36.0, 0.05)),
    };
    let antrum = mm(about(34.0, 0.1), about(-16.0, 0.1), about(-44.0, 0.06));
    let gastric_body = Tube { ends_m: [mm(66.0, 6.0, 8.0), antrum], radii_m: [0.028, 0.019] };
    (fundus, gastric_body)
}

fn gall_bladder(about: &mut impl FnMut(f64, f64) -> f64) -> Tube {
    let fundus_of_gall_bladder = mm(about(-38.0, 0.06), about(-36.0, 0.06), about(-58.0, 0.04));
    Tube { ends_m: [mm(-22.0, -10.0, -36.0), fundus_of_gall_bladder], radii_m: [0.008, about(0.015, 0.1)] }
}

impl Anatomy {
    /// The patient of `seed`.
    pub(super) fn new(seed: u64) -> Self {
        let mut random = SeededRandom::new(seed);
        let mut about = |value: f64, share: f64| value * random.uniform_in(1.0 - share, 1.0 + share);
        let body_half_m = [about(0.172, 0.01), about(0.092, 0.01)];
        let subcutaneous_fat_m = about(0.011, 0.15);
        let inner_x_m = body_half_m[0] - SKIN_M - subcutaneous_fat_m - WALL_M;

        let [right_lobe, middle_lobe, left_lobe, visceral_hollow, fissure] =
            liver_lobes(&mut about, inner_x_m);
        let kidneys = kidney_lobes(&mut about);
        let (fundus, gastric_body) = stomach(&mut about);
        let spleen = Lobe {
            center_m: mm(about(113.0, 0.01), about(17.0, 0.1), about(18.0, 0.1)),
            half_m: mm(about(24.0, 0.04), about(40.0, 0.04), about(50.0, 0.04)),
        };
        let gall_bladder = gall_bladder(&mut about);
        let vena_cava =
            Tube { ends_m: [mm(-23.0, 22.0, -140.0), mm(-20.0, 18.0, 140.0)], radii_m: [0.011, 0.012] };
        let aorta = Tube { ends_m: [mm(8.0, 22.0, -140.0), mm(4.0, 24.0, 140.0)], radii_m: [0.010, 0.011] };
        let bumps = std::array::from_fn(|_| {
            let direction = DVec3::new(about(1.0, 1.0) - 1.0, about(1.0, 1.0) - 1.0, about(1.0, 1.0) - 1.0);
            (direction.normalize_or(DVec3::X) * about(80.0, 0.3), about(3.0, 1.0))
        });

        let mut anatomy = Self {
            body_center_y_m: 97e-3 - body_half_m[1],
            body_half_m,
            subcutaneous_fat_m,
            right_lobe,
            middle_lobe,
            left_lobe,
            visceral_hollow,
            fissure,
            bumps,
            kidneys,
            fundus,
            gastric_body,
            spleen,
            gall_bladder,
            vena_cava,
            aorta,
            portal_trunk: Tube {
                ends_m: [mm(14.0, 12.0, -34.0), mm(-26.0, -6.0, -4.0)],
                radii_m: [0.0065; 2],
            },
            hepatic_root: Tube {
                ends_m: [mm(-20.5, 18.0, 40.0), mm(-30.0, 2.0, 34.0)],
                radii_m: [0.008, 0.007],
            },
            portal_tree: Vec::new(),
            hepatic_tree: Vec::new(),
            tumour: Lobe { center_m: DVec3::ZERO, half_m: DVec3::ONE },
            rib_offset_m: about(8e-3, 1.0),
        };
        anatomy.grow_vessels(&mut random);
        anatomy.place_tumour(&mut random);
        anatomy
    }

    fn grow_vessels(&mut self, random: &mut SeededRandom) {
        // The smallest veins end a centimetre below the capsule.
        let mut supplied = |n: usize| -> Vec<DVec3> {
            std::iter::repeat_with(|| self.random_point_in_liver(random, 10e-3)).take(n).collect()
        };
        let (mut portal_points, mut hepatic_points) = (supplied(1500), supplied(1500));
        let branching = Branching { min_radius_m: 1.5e-3, reach: 0.55 };
        let trunk = self.portal_trunk;
        self.portal_tree = grow_tree(trunk.ends_m[1], trunk.radii_m[1], &mut portal_points, &branching);
        let root = self.hepatic_root;
        self.hepatic_tree = grow_tree(root.ends_m[1], root.radii_m[1], &mut hepatic_points, &branching);
    }

    /// Both trees with their trunks as roots. A branch begins where the one before it ends.
    pub(super) fn vessels(&self) -> Vec<vessels::Tube> {
        let mut all: Vec<vessels::Tube> = Vec::new();
        for (trunk, tree) in
            [(&self.portal_trunk, &self.portal_tree), (&self.hepatic_root, &self.hepatic_tree)]
        {
            let first = all.len();
            for tube in std::iter::once(trunk).chain(tree) {
                let before = all[first..].iter().position(|earlier| earlier.ends_m[1] == tube.ends_m[0]);
                let parent = before.map(|place| (first + place) as u32);
                all.push(vessels::Tube { parent, ends_m: tube.ends_m, radii_m: tube.radii_m });
            }
        }
        all
    }

    fn place_tumour(&mut self, random: &mut SeededRandom) {
        let radius_m = random.uniform_in(11e-3, 15e-3);
        let half_m = radius_m * DVec3::new(1.0, random.uniform_in(0.85, 1.0), random.uniform_in(0.85, 1.0));
        self.tumour = Lobe { center_m: self.random_point_in_liver(random, radius_m + 7e-3), half_m };
    }

    /// Uniform point at least `depth_m` below the surface of the liver.
    fn random_point_in_liver(&self, random: &mut SeededRandom, depth_m: f64) -> DVec3 {
        let Aabb { min_m, max_m } = self.liver_bounds_m();
        loop {
            let share = DVec3::new(random.uniform(), random.uniform(), random.uniform());
            let point = min_m + share * (max_m - min_m);
            if self.liver(point) < -depth_m {
                return point;
            }
        }
    }

    fn liver_bounds_m(&self) -> Aabb {
        let lobes = [self.right_lobe, self.middle_lobe, self.left_lobe].map(Lobe::bounds_m);
        let all = lobes.iter().fold(Aabb::EMPTY, |b, l| b.joined(l));
        all.grown(8e-3)
    }

    /// The middle of an organ that is one shape.
    pub(super) fn middle_m(&self, tissue: Tissue) -> Option<DVec3> {
        match tissue {
            Tissue::LiverTumour => Some(self.tumour.center_m),
            Tissue::Spleen => Some(self.spleen.center_m),
            Tissue::KidneyRight => Some(self.kidneys[0].center_m),
            Tissue::KidneyLeft => Some(self.kidneys[1].center_m),
            Tissue::GallBladder => Some((self.gall_bladder.ends_m[0] + self.gall_bladder.ends_m[1]) * 0.5),
            _ => None,
        }
    }

    /// The ends of the gall bladder's axis, neck and fundus [m].
    pub(super) fn gall_bladder_ends_m(&self) -> [DVec3; 2] {
        self.gall_bladder.ends_m
    }

    /// The liver with all that lies inside it: negative inside.
    pub(super) fn liver(&self, p: DVec3) -> f64 {
        let lobes = smooth_union(self.right_lobe.at(p), self.middle_lobe.at(p), 20e-3);
        let mut f = smooth_union(lobes, self.left_lobe.at(p), 15e-3);
        // Impressions and unevenness matter only near the surface.
        if f > 20e-3 {
            return f;
        }
        for (wave, phase) in self.bumps {
            f += 0.5e-3 * libm::sin(wave.dot(p) + phase);
        }
        f = smooth_difference(f, self.visceral_hollow.at(p), 16e-3);
        f = smooth_difference(f, self.fissure.at(p), 7e-3);
        f = smooth_difference(f, self.kidneys[0].at(p) + CONTACT_M, 6e-3);
        f = smooth_difference(f, self.stomach(p) + CONTACT_M, 6e-3);
        f = smooth_difference(f, self.gall_bladder.signed_distance_m(p) + CONTACT_M, 5e-3);
        smooth_difference(f, self.vena_cava.signed_distance_m(p) + CONTACT_M, 5e-3)
    }

    fn stomach(&self, p: DVec3) -> f64 {
        smooth_union(self.fundus.at(p), self.gastric_body.signed_distance_m(p), 15e-3)
    }

    /// Outline of the body: a cylinder over |x/a|^2.5 + |y/b|^2.5 = 1.
    fn body(&self, p: DVec3) -> f64 {
        let [a, b] = self.body_half_m;
        let (u, v) = ((p.x / a).abs(), ((p.y - self.body_center_y_m) / b).abs());
        let (u15, v15) = (u * u.sqrt(), v * v.sqrt());
        let sum = u15 * u + v15 * v;
        if sum < 1e-6 {
            return -a.min(b);
        }
        let radius = libm::pow(sum, 0.4);
        let slope = radius / sum * DVec3::new(u15 / a, v15 / b, 0.0).length();
        (radius - 1.0) / slope
    }

    /// Inner surface of the diaphragm: two domes over cylinders that reach down, and always around the liver.
    fn under_diaphragm(&self, p: DVec3) -> f64 {
        let dome = |center: DVec3, half: DVec3| ellipsoid(p.with_z(p.z.max(center.z)), center, half);
        let right = dome(mm(-72.0, -3.0, 0.0), mm(76.0, 48.0, 80.0));
        let left = dome(mm(66.0, 2.0, -8.0), mm(76.0, 58.0, 76.0));
        let domes = smooth_union(right, left, 25e-3);
        smooth_union(domes, self.liver(p) + CONTACT_M, 6e-3)
    }

    /// Paints air, body wall, lungs, diaphragm and the fat of the abdomen at `p`, inside to be covered.
    pub(super) fn paint_torso(&self, p: DVec3, mut paint: impl FnMut(Coat, f64)) {
        let body = self.body(p);
        if body > 3e-3 {
            return;
        }
        let wall_m = SKIN_M + self.subcutaneous_fat_m;
        let cavity = body + wall_m + WALL_M;
        paint(Tissue::Skin.coat(), body);
        paint(Tissue::Fat.coat(), body + SKIN_M);
        paint(Tissue::Muscle.coat(), body + wall_m);
        paint(Tissue::Fat.coat(), cavity);
        // Lungs reach lower behind than in front.
        let above_recess = (26e-3 - 0.6 * p.y) - p.z;
        if cavity < 3e-3 && above_recess < 30e-3 {
            let under = self.under_diaphragm(p);
            let lung = cavity.max(above_recess);
            paint(Tissue::Lung.coat(), lung.max(4e-3 - under));
            paint(Tissue::Muscle.coat(), lung.max(under - 4e-3).max(-under));
        }
        let rib = self.rib(p, body + wall_m + 0.5 * WALL_M);
        paint(Tissue::Rib.coat(), rib);
        paint(Tissue::Rib.coat_of_hu(300.0), rib + 1.8e-3);
        self.paint_back(p, paint);
    }

    /// Ribs run in the middle of the muscle of the wall, `depth_m` from it, falling towards the front.
    fn rib(&self, p: DVec3, depth_m: f64) -> f64 {
        const SPACING_M: f64 = 34e-3;
        let height = p.z - self.rib_offset_m - 0.38 * p.y + 0.1;
        let across = height - SPACING_M * (height / SPACING_M).round();
        let tube = ellipsoid(DVec3::new(depth_m, across, 0.0), DVec3::ZERO, mm(4.6, 7.0, 1.0));
        // The costal margin: the ribs end further back the lower they are.
        let front_end = (-50e-3 - 0.9 * (p.z - 40e-3)) - p.y;
        tube.max(front_end).max(-p.y - 88e-3)
    }

    fn paint_back(&self, p: DVec3, mut paint: impl FnMut(Coat, f64)) {
        if p.y < 0.0 {
            return;
        }
        let mirrored = DVec3::new(p.x.abs(), p.y, p.z);
        paint(Tissue::Muscle.coat(), cylinder(mirrored, mm(30.0, 73.0, 0.0), 31e-3, 15e-3));
        paint(Tissue::Muscle.coat(), ellipsoid(mirrored, mm(36.0, 52.0, -110.0), mm(16.0, 15.0, 80.0)));
        let discs = 1.5e-3 * libm::cos(std::f64::consts::TAU * p.z / 32e-3);
        let vertebra = cylinder(p, mm(0.0, 49.0, 0.0), 21e-3, 16e-3) - discs;
        let arch = cylinder(p, mm(0.0, 70.0, 0.0), 14e-3, 11e-3);
        let process =
            Tube { ends_m: [mm(0.0, 76.0, p.z * 1e3), mm(0.0, 84.0, p.z * 1e3)], radii_m: [4e-3, 3e-3] };
        let bone = vertebra.min(arch).min(process.signed_distance_m(p));
        paint(Tissue::Spine.coat(), bone);
        paint(Tissue::Spine.coat_of_hu(230.0), vertebra + 2e-3);
        paint(Tissue::Spine.coat_of_hu(30.0), cylinder(p, mm(0.0, 70.0, 0.0), 9e-3, 7.5e-3));
    }

    /// The organs in the order of painting.
    pub(super) fn organs<'a>(&'a self) -> Vec<Organ<'a>> {
        let mut organs = Vec::new();
        let mut add = |coat: Coat, bounds_m: Aabb, shape: Box<dyn Fn(DVec3) -> f64 + Sync + 'a>| {
            organs.push(Organ { coat, bounds_m: bounds_m.grown(3e-3), shape });
        };
        for (tube, tissue) in [(&self.aorta, Tissue::Aorta), (&self.vena_cava, Tissue::VenaCava)] {
            add(tissue.coat(), tube_bounds_m(tube), Box::new(|p| tube.signed_distance_m(p)));
        }
        for (kidney, tissue) in self.kidneys.iter().zip([Tissue::KidneyRight, Tissue::KidneyLeft]) {
            add(tissue.coat(), kidney.bounds_m(), Box::new(|p| kidney.at(p)));
        }
        let stomach_bounds = Aabb::of_points(&[
            self.fundus.bounds_m().min_m,
            self.fundus.bounds_m().max_m,
            tube_bounds_m(&self.gastric_body).min_m,
            tube_bounds_m(&self.gastric_body).max_m,
        ]);
        add(Tissue::Stomach.coat(), stomach_bounds.grown(5e-3), Box::new(|p| self.stomach(p)));
        add(
            Tissue::Spleen.coat(),
            self.spleen.bounds_m(),
            Box::new(|p| self.inside_wall(p).max(self.spleen.at(p)).max(SPLEEN_GAP_M - self.liver(p))),
        );
        let gall_bladder = &self.gall_bladder;
        add(
            Tissue::GallBladder.coat(),
            tube_bounds_m(gall_bladder),
            Box::new(|p| gall_bladder.signed_distance_m(p)),
        );
        let trunk = &self.portal_trunk;
        add(Tissue::PortalTrunk.coat(), tube_bounds_m(trunk), Box::new(|p| trunk.signed_distance_m(p)));
        let root = &self.hepatic_root;
        add(Tissue::VenaCava.coat(), tube_bounds_m(root), Box::new(|p| root.signed_distance_m(p)));
        add(Tissue::Liver.coat(), self.liver_bounds_m(), Box::new(|p| self.liver(p)));
        let hepatic = self.hepatic_tree.iter().map(|t| (t, Tissue::HepaticVein, BRANCH_COVER_M));
        let portal = self.portal_tree.iter().map(|t| (t, Tissue::PortalVein, BRANCH_COVER_M));
        let stems = [(root, Tissue::HepaticVein, 0.0), (trunk, Tissue::PortalVein, 0.0)];
        for (tube, tissue, cover_m) in hepatic.chain(portal).chain(stems) {
            add(
                tissue.coat(),
                tube_bounds_m(tube),
                Box::new(move |p| tube.signed_distance_m(p).max(self.liver(p) + cover_m)),
            );
        }
        add(Tissue::LiverTumour.coat(), self.tumour.bounds_m(), Box::new(|p| self.tumour.at(p)));
        organs
    }

    /// Negative inside the muscle of the body wall, less a millimetre of fat.
    fn inside_wall(&self, p: DVec3) -> f64 {
        self.body(p) + SKIN_M + self.subcutaneous_fat_m + WALL_M + 1e-3
    }
}

fn tube_bounds_m(tube: &Tube) -> Aabb {
    Aabb::of_points(&tube.ends_m).grown(tube.radii_m[0].max(tube.radii_m[1]))
}
