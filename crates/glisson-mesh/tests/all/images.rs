//! Label maps, filters, the synthetic patient and segmentation.

use glisson_mesh::image::filter::{self, Connectivity};
use glisson_mesh::image::labels::{LabelError, Parts, check_clear_of_border, dice};
use glisson_mesh::image::phantom::{Phantom, PhantomParams, Tissue, generate};
use glisson_mesh::image::segment::{SegmentError, SegmentParams, bare_band, guess_seed, segment};
use glisson_mesh::image::topology::{is_well_composed, solid_euler_characteristic};
use glisson_mesh::image::{LabelMap, Volume, VoxelGrid};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};
use proptest::prelude::*;

use crate::sample_images::plain_grid;

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn distance_transform_agrees_with_the_definition(
        dims in [1..6usize, 1..6usize, 1..6usize],
        spacing_mm in [0.5..3.0f64, 0.5..3.0f64, 0.5..3.0f64],
        seed in any::<u64>(),
        share in 0.0..0.6f64,
    ) {
        let grid = plain_grid(dims, spacing_mm);
        let mut random = SeededRandom::new(seed);
        let mask: Vec<bool> = (0..grid.n_voxels()).map(|_| random.uniform() < share).collect();
        let found = filter::distance_squared_m2(&grid, &mask);
        let place = |index: usize| DVec3::from_array(grid.voxel(index).map(|v| v as f64)) * grid.spacing_m;
        for index in 0..mask.len() {
            let distances = (0..mask.len()).filter(|&o| mask[o]).map(|o| place(o).distance_squared(place(index)));
            let expected = distances.fold(f64::INFINITY, f64::min);
            let agrees = f64::from(found[index]) == expected
                || (f64::from(found[index]) - expected).abs() <= 1e-5 * expected;
            prop_assert!(agrees, "voxel {index}: {} instead of {expected}", found[index]);
        }
    }
}

// ---- Labels ------------------------------------------------------------------------------------------

fn labelled(labels: Vec<u16>, names: &[(u16, &str)]) -> LabelMap {
    LabelMap {
        grid: plain_grid([labels.len(), 1, 1], [1.0, 2.0, 3.0]),
        labels,
        names: names.iter().map(|(l, n)| (*l, (*n).to_string())).collect(),
        colours: Vec::new(),
    }
}

const ABDOMEN: [(u16, &str); 6] = [
    (1, "liver"),
    (2, "liver_tumour"),
    (3, "portal_vein"),
    (4, "hepatic_vein"),
    (6, "spleen"),
    (9, "Stomach wall"),
];

#[test]
fn labels_are_found_by_name_or_number() {
    let map = labelled(vec![0, 1, 1, 2, 3, 4, 9, 5], &ABDOMEN);
    for (text, label) in [("liver", 1), ("Liver", 1), ("1", 1), ("stomach_wall", 9), ("5", 5)] {
        assert_eq!(map.resolve(text), Ok(label), "{text}");
    }
    let Err(error) = map.resolve("lvier") else { panic!("found") };
    assert_eq!(
        error.to_string(),
        "the label map has no label named `lvier`, did you mean `liver`?; available: 1 (liver), 2 (liver_tumour), \
         3 (portal_vein), 4 (hepatic_vein), 5, 9 (Stomach wall)"
    );
    let Err(error) = map.resolve("brain stem") else { panic!("found") };
    assert!(matches!(error, LabelError::UnknownName { suggestion: None, .. }), "{error}");
    for empty in ["spleen", "6", "77", "0"] {
        let Err(error) = map.resolve(empty) else { panic!("{empty} found") };
        assert!(matches!(error, LabelError::Empty { n_voxels: 8, .. }), "{error}");
    }
}

#[test]
fn the_liver_includes_what_is_inside_it_unless_asked() {
    let map = labelled(vec![0, 1, 1, 2, 3, 4, 6, 1], &ABDOMEN);
    for text in ["liver", "1"] {
        assert_eq!(map.select(text, Parts::Included).unwrap().labels, [1, 2, 3, 4]);
        assert_eq!(map.select(text, Parts::Excluded).unwrap().labels, [1]);
    }
    assert_eq!(map.select("spleen", Parts::Included).unwrap().labels, [6]);
    let liver = map.select("liver", Parts::Included).unwrap();
    assert_eq!(map.mask(&liver), [false, true, true, true, true, true, false, true]);
    assert!((map.volume_m3(&liver) - 6.0 * 6e-9).abs() < 1e-20);
}

#[test]
fn dice_counts_the_overlap_twice() {
    let (t, f) = (true, false);
    assert_eq!(dice(&[t, t, f, f], &[t, f, t, t]), 2.0 / 5.0);
    assert_eq!(dice(&[t, f], &[t, f]), 1.0);
    assert_eq!(dice(&[t, f], &[f, t]), 0.0);
    assert_eq!(dice(&[f, f], &[f, f]), 1.0);
}

#[test]
fn an_organ_cut_by_the_border_is_refused_with_the_side() {
    // i runs to the head, j to the right, k to the front.
    let axes = DMat3::from_cols(DVec3::Z, -DVec3::X, -DVec3::Y);
    let grid = VoxelGrid { axes, ..plain_grid([5, 6, 7], [1.0; 3]) };
    let mut inside = vec![false; grid.n_voxels()];
    inside[grid.index([2, 3, 3])] = true;
    assert_eq!(check_clear_of_border(&grid, &inside), Ok(()));
    for (voxel, side) in [
        ([0, 3, 3], "i = 0 (inferior)"),
        ([4, 3, 3], "i = 4 (superior)"),
        ([2, 0, 3], "j = 0 (left)"),
        ([2, 5, 3], "j = 5 (right)"),
        ([2, 3, 0], "k = 0 (posterior)"),
        ([2, 3, 6], "k = 6 (anterior)"),
    ] {
        let mut mask = inside.clone();
        mask[grid.index(voxel)] = true;
        let expected = LabelError::LabelTouchesBorder { side: side.into(), n_voxels: 1 };
        assert_eq!(check_clear_of_border(&grid, &mask), Err(expected));
    }
}

// ---- Filters -----------------------------------------------------------------------------------------

#[test]
fn gaussian_keeps_constants_mass_and_has_its_variance() {
    let grid = plain_grid([31, 25, 21], [1.0, 1.5, 2.0]);
    let sigma_m = 2e-3;
    let constant = filter::gaussian(&grid, &vec![7.0; grid.n_voxels()], sigma_m);
    assert!(constant.iter().all(|v| (v - 7.0).abs() < 1e-5));
    let mut impulse = vec![0.0; grid.n_voxels()];
    let center = [15, 12, 10];
    impulse[grid.index(center)] = 1.0;
    let smoothed = filter::gaussian(&grid, &impulse, sigma_m);
    assert!((smoothed.iter().sum::<f32>() - 1.0).abs() < 1e-4);
    for axis in 0..3 {
        let variance: f64 = (0..grid.n_voxels())
            .map(|index| {
                let offset = (grid.voxel(index)[axis] as f64 - center[axis] as f64) * grid.spacing_m[axis];
                f64::from(smoothed[index]) * offset * offset
            })
            .sum();
        // Cut at 3.5 sigma, sampled at one sigma: half a per cent short at most.
        assert!((variance.sqrt() / sigma_m - 1.0).abs() < 5e-3, "axis {axis}: {}", variance.sqrt());
    }
    let gain = filter::gaussian_noise_gain(&grid, sigma_m);
    let energy: f32 = smoothed.iter().map(|v| v * v).sum();
    assert!((f64::from(energy).sqrt() / gain.smoothed - 1.0).abs() < 1e-4);
    let at = grid.index(center);
    let residual: f32 =
        smoothed.iter().enumerate().map(|(i, v)| (v - f32::from(u8::from(i == at))).powi(2)).sum();
    assert!((f64::from(residual).sqrt() / gain.residual - 1.0).abs() < 1e-4);
}

fn ball(grid: &VoxelGrid, center: [usize; 3], radius_m: f64) -> Vec<bool> {
    let place = |v: [usize; 3]| DVec3::from_array(v.map(|x| x as f64)) * grid.spacing_m;
    (0..grid.n_voxels())
        .map(|i| place(grid.voxel(i)).distance(place(center)) <= radius_m * (1.0 + 1e-9))
        .collect()
}

#[test]
fn morphology_uses_a_ball_in_millimetres() {
    let grid = plain_grid([21, 17, 13], [1.0, 1.5, 2.0]);
    let center = [10, 8, 6];
    let mut point = vec![false; grid.n_voxels()];
    point[grid.index(center)] = true;
    let grown = filter::dilate(&grid, &point, 6e-3);
    assert_eq!(grown, ball(&grid, center, 6e-3));
    // The border is no outside: a full volume stays full.
    assert!(filter::erode(&grid, &vec![true; grid.n_voxels()], 3e-3).iter().all(|&m| m));
    assert!(filter::dilate(&grid, &vec![false; grid.n_voxels()], 3e-3).iter().all(|&m| !m));
    // Two balls with a bridge one voxel wide: opening cuts the bridge, closing fills a one-voxel hole.
    let mut dumbbell = ball(&grid, [4, 8, 6], 4e-3);
    for (inside, other) in dumbbell.iter_mut().zip(ball(&grid, [16, 8, 6], 4e-3)) {
        *inside |= other;
    }
    for i in 4..=16 {
        dumbbell[grid.index([i, 8, 6])] = true;
    }
    assert_eq!(filter::components(&grid, &dumbbell, Connectivity::Faces).sizes.len(), 1);
    let opened = filter::open(&grid, &dumbbell, 2e-3);
    assert_eq!(filter::components(&grid, &opened, Connectivity::Corners).sizes.len(), 2);
    let mut holed = dumbbell.clone();
    holed[grid.index([4, 8, 6])] = false;
    let closed = filter::close(&grid, &holed, 2e-3);
    assert!(closed[grid.index([4, 8, 6])] && holed.iter().zip(&closed).all(|(h, c)| !h || *c));
}

#[test]
fn pieces_depend_on_the_connectivity_and_cavities_are_filled() {
    let grid = plain_grid([6, 6, 6], [1.0; 3]);
    let mut mask = vec![false; grid.n_voxels()];
    for voxel in [[0, 0, 0], [1, 1, 0], [1, 2, 0], [2, 3, 1], [5, 5, 5]] {
        mask[grid.index(voxel)] = true;
    }
    assert_eq!(filter::components(&grid, &mask, Connectivity::Faces).sizes, [1, 2, 1, 1]);
    assert_eq!(filter::components(&grid, &mask, Connectivity::Corners).sizes, [4, 1]);
    assert_eq!(filter::largest_piece(&grid, &mask, Connectivity::Faces).iter().filter(|&&m| m).count(), 2);
    assert!(!filter::largest_piece(&grid, &vec![false; 216], Connectivity::Faces).contains(&true));

    let shell: Vec<bool> = (0..216)
        .map(|i| {
            let [a, b, c] = grid.voxel(i).map(|v| (1..5).contains(&v));
            let [d, e, f] = grid.voxel(i).map(|v| (2..4).contains(&v));
            a && b && c && !(d && e && f)
        })
        .collect();
    let mut filled = shell.clone();
    assert_eq!(filter::fill_cavities(&grid, &mut filled), 8);
    let mut pierced = shell;
    pierced[grid.index([1, 2, 2])] = false;
    let before = pierced.clone();
    assert_eq!(filter::fill_cavities(&grid, &mut pierced), 0, "a hole to the outside is no cavity");
    assert_eq!(pierced, before);
}

// ---- The synthetic patient ---------------------------------------------------------------------------

fn coarse(seed: u64) -> Phantom {
    generate(&PhantomParams { seed, voxel_m: 3e-3, ..PhantomParams::default() })
}

fn liver_of(patient: &Phantom) -> Vec<bool> {
    patient.labels.mask(&patient.labels.select("liver", Parts::Included).unwrap())
}

/// Faces between voxels of the mask and voxels of `tissue`.
fn n_shared_faces(patient: &Phantom, mask: &[bool], tissue: Tissue) -> usize {
    let grid = &patient.labels.grid;
    let is_other = |index: usize| patient.labels.labels[index] == tissue.label();
    let mut n = 0;
    for index in 0..mask.len() {
        let voxel = grid.voxel(index);
        for axis in 0..3 {
            if voxel[axis] + 1 < grid.dims[axis] {
                let mut next = voxel;
                next[axis] += 1;
                let next = grid.index(next);
                n += usize::from((mask[index] && is_other(next)) || (mask[next] && is_other(index)));
            }
        }
    }
    n
}

#[test]
fn every_patient_has_one_whole_liver_among_its_neighbours() {
    for seed in 0..6 {
        let patient = coarse(seed);
        let grid = &patient.labels.grid;
        let liver = liver_of(&patient);
        let pieces = filter::components(grid, &liver, Connectivity::Faces).sizes;
        assert_eq!(pieces.len(), 1, "seed {seed}: pieces of {pieces:?} voxels");
        assert_eq!(solid_euler_characteristic(grid, &liver), Ok(1), "seed {seed}: tunnels or cavities");
        assert_eq!(check_clear_of_border(grid, &liver), Ok(()), "seed {seed}");
        let volume_ml = liver.iter().filter(|&&m| m).count() as f64 * grid.voxel_volume_m3() * 1e6;
        assert!((1200.0..1800.0).contains(&volume_ml), "seed {seed}: {volume_ml} ml");
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        for index in (0..liver.len()).filter(|&i| liver[i]) {
            let voxel = grid.voxel(index);
            for axis in 0..3 {
                low[axis] = low[axis].min(voxel[axis]);
                high[axis] = high[axis].max(voxel[axis] + 1);
            }
        }
        for (axis, (about_mm, share)) in [(280.0, 0.06), (80.0, 0.12), (160.0, 0.06)].into_iter().enumerate()
        {
            let size_mm = (high[axis] - low[axis]) as f64 * grid.spacing_m[axis] * 1e3;
            assert!((size_mm / about_mm - 1.0).abs() < share, "seed {seed}, axis {axis}: {size_mm} mm");
        }
        for (tissue, least) in [(Tissue::Stomach, 50), (Tissue::Muscle, 200), (Tissue::KidneyRight, 20)] {
            let n = n_shared_faces(&patient, &liver, tissue);
            assert!(n >= least, "seed {seed}: {n} faces of 9 mm2 shared with {tissue:?}");
        }
        for tissue in Tissue::ALL {
            assert!(patient.labels.labels.contains(&tissue.label()), "seed {seed} has no {tissue:?}");
        }
        let tumour_ml = patient.labels.labels.iter().filter(|&&l| l == Tissue::LiverTumour.label()).count()
            as f64
            * grid.voxel_volume_m3()
            * 1e6;
        assert!((3.0..16.0).contains(&tumour_ml), "seed {seed}: tumour of {tumour_ml} ml");
    }
}

#[test]
fn two_millimetres_of_fat_separate_liver_and_spleen() {
    let patient = generate(&PhantomParams::default());
    let distance2 = filter::distance_squared_m2(&patient.labels.grid, &liver_of(&patient));
    let is_spleen = |&i: &usize| patient.labels.labels[i] == Tissue::Spleen.label();
    let gap2 = (0..distance2.len()).filter(is_spleen).map(|i| distance2[i]).fold(f32::INFINITY, f32::min);
    // Between centres of 1.5 mm voxels a gap of 2 mm is at least 2 mm, and where it runs flat at most 3.5 mm.
    assert!((2.0e-3..3.1e-3).contains(&gap2.sqrt()), "{} m", gap2.sqrt());
    let near = |&i: &usize| is_spleen(&i) && distance2[i] < 3.6e-3 * 3.6e-3;
    let n_near = (0..distance2.len()).filter(near).count();
    assert!(n_near > 200, "{n_near} voxels along the gap");
}

#[test]
fn tissues_have_their_ct_numbers_and_the_noise_its_deviation() {
    let patient = coarse(1);
    let grid = &patient.ct.grid;
    for tissue in [
        Tissue::Liver,
        Tissue::LiverTumour,
        Tissue::GallBladder,
        Tissue::Spleen,
        Tissue::KidneyRight,
        Tissue::KidneyLeft,
        Tissue::Stomach,
        Tissue::Muscle,
        Tissue::Fat,
        Tissue::Aorta,
        Tissue::Air,
        Tissue::Lung,
    ] {
        let mask: Vec<bool> = patient.labels.labels.iter().map(|&l| l == tissue.label()).collect();
        let deep = filter::erode(grid, &mask, 4.5e-3);
        let values: Vec<f64> =
            (0..deep.len()).filter(|&i| deep[i]).map(|i| f64::from(patient.ct.values[i])).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let deviation = (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n).sqrt();
        assert!(n > 10.0, "{tissue:?}: {n} voxels");
        let allowed = 5.0 * 20.0 / n.sqrt() + 0.1;
        assert!((mean - tissue.hounsfield()).abs() < allowed, "{tissue:?}: {mean} HU, {n} voxels");
        if n > 2000.0 {
            assert!((deviation - 20.0).abs() < 0.8, "{tissue:?}: noise {deviation} HU");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_at_any_thread_count() {
    let params = PhantomParams { seed: 5, voxel_m: 6e-3, ..PhantomParams::default() };
    let with_threads = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let one = with_threads(1).install(|| generate(&params));
    assert_eq!(one, with_threads(3).install(|| generate(&params)));
    assert_ne!(one.labels.labels, generate(&PhantomParams { seed: 6, ..params }).labels.labels);
}

// ---- Segmentation ------------------------------------------------------------------------------------

#[test]
fn the_liver_is_found_among_touching_organs() {
    for seed in [1, 2] {
        let patient = coarse(seed);
        let truth = liver_of(&patient);
        let found = segment(&patient.ct, &SegmentParams::default()).unwrap();
        let overlap = dice(&found.mask, &truth);
        let bare = dice(&bare_band(&patient.ct, found.band_hu), &truth);
        assert!(overlap > 0.95, "seed {seed}: Dice {overlap}");
        assert!(bare < 0.93, "seed {seed}: Dice of the bare band {bare}");
        // Even at the width that the truth shows to be best, which a user cannot know.
        let best_bare = (2..=10)
            .map(|step| f64::from(step) * 5.0)
            .map(|width| dice(&bare_band(&patient.ct, [110.0 - width, 110.0 + width]), &truth))
            .fold(0.0, f64::max);
        assert!(best_bare > 0.7 && best_bare < overlap - 0.01, "seed {seed}: {best_bare} of a bare band");
        assert!((found.noise_hu - 20.0).abs() < 4.0, "noise {} HU", found.noise_hu);
        assert!((found.level_hu - 110.0).abs() < 6.0, "level {} HU", found.level_hu);
        let grid = &patient.ct.grid;
        assert_eq!(solid_euler_characteristic(grid, &found.mask), Ok(1));
        assert_eq!(is_well_composed(grid, &found.mask), Ok(true));
    }
}

#[test]
fn the_result_hardly_depends_on_the_seed_point() {
    let patient = coarse(3);
    let automatic = segment(&patient.ct, &SegmentParams::default()).unwrap();
    let seed_m = Some(DVec3::new(60.0, -30.0, 25.0) * 1e-3);
    let given = segment(&patient.ct, &SegmentParams { seed_m, ..SegmentParams::default() }).unwrap();
    let overlap = dice(&given.mask, &automatic.mask);
    assert!(overlap > 0.99, "Dice with the automatic one {overlap}");
}

#[test]
fn seeds_in_the_wrong_place_are_refused() {
    let patient = generate(&PhantomParams { voxel_m: 6e-3, ..PhantomParams::default() });
    let at = |x: f64, y: f64, z: f64| SegmentParams {
        seed_m: Some(DVec3::new(x, y, z) * 1e-3),
        ..SegmentParams::default()
    };
    let Err(error) = segment(&patient.ct, &at(-900.0, 0.0, 0.0)) else { panic!("found") };
    assert!(
        matches!(error, SegmentError::SeedOutside { .. }) && error.to_string().contains("-900"),
        "{error}"
    );
    let Err(error) = segment(&patient.ct, &at(-188.0, -105.0, 0.0)) else { panic!("found") };
    assert!(matches!(error, SegmentError::SeedNotSoftTissue { .. }), "{error}");
    assert!(segment(&patient.ct, &at(f64::NAN, 0.0, 0.0)).is_err());
    let empty = Volume { values: vec![-1000.0; patient.ct.grid.n_voxels()], grid: patient.ct.grid.clone() };
    let Err(error) = segment(&empty, &SegmentParams::default()) else { panic!("found") };
    assert!(matches!(error, SegmentError::NoSeed { .. }), "{error}");
    assert!(guess_seed(&empty.grid, &empty.values).is_err());
}

#[test]
fn the_vessels_of_the_phantom_are_trees_inside_its_veins() {
    let patient = coarse(3);
    let roots = patient.vessels.iter().filter(|tube| tube.parent.is_none()).count();
    assert_eq!(roots, 2, "portal vein and hepatic vein");
    assert!(patient.vessels.len() > 50, "{}", patient.vessels.len());
    let veins = ["portal_vein", "hepatic_vein"]
        .map(|name| patient.labels.mask(&patient.labels.select(name, Parts::Excluded).unwrap()));
    let mut n_inside = 0;
    for (i, tube) in patient.vessels.iter().enumerate() {
        glisson_mesh::image::vessels::check_tube(i, tube).unwrap();
        if let Some(parent) = tube.parent {
            assert_eq!(patient.vessels[parent as usize].ends_m[1], tube.ends_m[0]);
        }
        let voxel = patient.labels.grid.voxel_at(tube.point_m(0.5)).round();
        let place = patient.labels.grid.index([voxel.x as usize, voxel.y as usize, voxel.z as usize]);
        n_inside += usize::from(veins.iter().any(|mask| mask[place]));
    }
    // Voxels of 3 mm miss the thinnest.
    assert!(2 * n_inside > patient.vessels.len(), "{n_inside} of {}", patient.vessels.len());
}
