//! DICOM frames that do not stand one above the other as they come: tilted gantries, and offsets along a stack.

use std::path::Path;

use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag};
use glisson_mesh::image::files::{StoredImage, read_image};
use glisson_mesh::math::DVec3;

const COLUMNS: usize = 24;
const ROWS: usize = 20;
const SLICES: usize = 9;
const COLUMN_MM: f64 = 0.5;
const ROW_MM: f64 = 0.75;
const SLICE_MM: f64 = 2.5;
/// Place of the first voxel [mm].
const ORIGIN_MM: DVec3 = DVec3::new(-10.0, 20.0, -30.0);

fn element(tag: Tag, vr: VR, value: impl Into<PrimitiveValue>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, vr, value.into())
}

fn decimals(numbers: &[f64]) -> PrimitiveValue {
    PrimitiveValue::Strs(numbers.iter().map(|n| format!("{n}")).collect())
}

fn save(object: InMemDicomObject, path: &Path) {
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN)
        .media_storage_sop_class_uid(uids::CT_IMAGE_STORAGE)
        .media_storage_sop_instance_uid("1.2.3.4");
    object.with_meta(meta).unwrap().write_to_file(path).unwrap();
}

/// An image of 16-bit words in a plane.
fn plane(position_mm: DVec3, directions: [DVec3; 2], dims: [usize; 2], words: Vec<u16>) -> InMemDicomObject {
    let [x, y] = directions;
    let short = |tag, value: u16| element(tag, VR::US, PrimitiveValue::from(value));
    InMemDicomObject::from_element_iter([
        element(tags::MODALITY, VR::CS, "CT"),
        element(tags::SERIES_INSTANCE_UID, VR::UI, "1.2.1"),
        element(tags::IMAGE_POSITION_PATIENT, VR::DS, decimals(&position_mm.to_array())),
        element(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, decimals(&[x.x, x.y, x.z, y.x, y.y, y.z])),
        element(tags::PIXEL_SPACING, VR::DS, decimals(&[ROW_MM, COLUMN_MM])),
        short(tags::ROWS, dims[1] as u16),
        short(tags::COLUMNS, dims[0] as u16),
        short(tags::SAMPLES_PER_PIXEL, 1),
        short(tags::BITS_ALLOCATED, 16),
        short(tags::BITS_STORED, 16),
        short(tags::HIGH_BIT, 15),
        short(tags::PIXEL_REPRESENTATION, 0),
        element(tags::RESCALE_SLOPE, VR::DS, "0.5"),
        element(tags::RESCALE_INTERCEPT, VR::DS, "-1024"),
        element(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(words.into())),
    ])
}

/// Columns to the left, rows to the back and head.
fn directions() -> [DVec3; 2] {
    let (sin, cos) = (0.5, 0.75f64.sqrt());
    [DVec3::X, DVec3::new(0.0, cos, sin)]
}

/// The value at a place [mm]: waves that are longer than a voxel.
fn value_at(place_mm: DVec3) -> f64 {
    200.0 * (0.4 * place_mm.x).sin() * (0.3 * place_mm.y).cos() + 20.0 * place_mm.z
}

/// Nowhere is a value further off for linear interpolation: h^2 / 8 times the largest second derivative along columns
/// and rows, and half a stored step.
const MAX_ERROR: f64 = 200.0 * (0.4 * 0.4 * COLUMN_MM * COLUMN_MM + 0.3 * 0.3 * ROW_MM * ROW_MM) / 8.0 + 0.25;

/// Slices, each shifted by `aside_mm` along columns and rows over the one before.
fn tilted(folder: &Path, aside_mm: [f64; 2]) {
    let [x, y] = directions();
    let normal = x.cross(y);
    for k in 0..SLICES {
        let step_mm = normal * SLICE_MM + x * aside_mm[0] + y * aside_mm[1];
        let position_mm = ORIGIN_MM + step_mm * k as f64;
        let place = |n: usize| {
            position_mm + x * (COLUMN_MM * (n % COLUMNS) as f64) + y * (ROW_MM * (n / COLUMNS) as f64)
        };
        let words =
            (0..COLUMNS * ROWS).map(|n| ((value_at(place(n)) + 1024.0) / 0.5).round() as u16).collect();
        let name = format!("IM{:03}", 7919 * (k + 1) % 997);
        save(plane(position_mm, directions(), [COLUMNS, ROWS], words), &folder.join(name));
    }
}

#[test]
fn slices_of_a_tilted_gantry_are_put_upright() {
    let degree = SLICE_MM * 1f64.to_radians().tan();
    let shift_of = |angle_deg: f64| SLICE_MM * angle_deg.to_radians().tan();
    for (aside_mm, angle) in [
        ([0.0, shift_of(18.0)], "lean by 18.00 degrees"),
        ([0.0, -shift_of(30.0)], "lean by 30.00 degrees"),
        ([-shift_of(7.0), 0.0], "lean by 7.00 degrees"),
        ([degree, degree], "lean by 1.41 degrees"),
        // Whole voxels: nothing is interpolated.
        ([2.0 * COLUMN_MM, -ROW_MM], "lean by 26.57 degrees"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        tilted(folder.path(), aside_mm);
        let image = read_image(folder.path()).unwrap();
        let note = image.notes.iter().find(|note| note.contains("tilted gantry"));
        assert!(note.is_some_and(|note| note.contains(angle)), "{angle}: {:?}", image.notes);
        // The voxels of the first slice are voxels of the whole.
        let (grid, [x, y]) = (&image.grid, directions());
        let normal = x.cross(y);
        let axes = [grid.axes.col(0), grid.axes.col(1), grid.axes.col(2)];
        assert!([x, y, normal].iter().zip(axes).all(|(a, b)| a.distance(b) < 1e-12));
        let spacing_mm = DVec3::new(COLUMN_MM, ROW_MM, SLICE_MM);
        assert!((grid.spacing_m * 1e3).distance(spacing_mm) < 1e-9);
        let off_mm = ORIGIN_MM - grid.origin_m * 1e3;
        let first = [off_mm.dot(x) / COLUMN_MM, off_mm.dot(y) / ROW_MM, off_mm.dot(normal) / SLICE_MM];
        assert!(first.iter().all(|n| (n - n.round()).abs() < 1e-9 && *n > -1e-9), "{first:?}");
        // Every voxel that lies in its slice has the value of its place, and no other is further in than its border.
        let volume = image.volume();
        let lowest = volume.values.iter().copied().fold(f32::INFINITY, f32::min);
        let mut n_inside = 0;
        for (index, &value) in volume.values.iter().enumerate() {
            let voxel = grid.voxel(index);
            let place_mm = grid.position_m(DVec3::from_array(voxel.map(|v| v as f64))) * 1e3;
            let k = voxel[2] as f64;
            let in_slice = [
                ((place_mm - ORIGIN_MM).dot(x) - k * aside_mm[0]) / COLUMN_MM,
                ((place_mm - ORIGIN_MM).dot(y) - k * aside_mm[1]) / ROW_MM,
            ];
            let is_inside = |at: f64, n: usize| (-1e-9..=(n - 1) as f64 + 1e-9).contains(&at);
            if is_inside(in_slice[0], COLUMNS) && is_inside(in_slice[1], ROWS) {
                n_inside += 1;
                let off = (f64::from(value) - value_at(place_mm)).abs();
                assert!(off <= MAX_ERROR, "{angle}: voxel {voxel:?} is {off} off, {MAX_ERROR} allowed");
            } else {
                assert_eq!(value, lowest, "{angle}: voxel {voxel:?} lies outside");
            }
        }
        // Of each slice at most its last column and row fall between its voxels and the grid's.
        assert!(n_inside >= (COLUMNS - 1) * (ROWS - 1) * SLICES, "{n_inside}");
    }
}

#[test]
fn labels_of_a_tilted_gantry_are_refused_where_they_would_be_mixed() {
    for (shift, is_refused) in [(0.5, true), (2.0, false)] {
        let folder = tempfile::tempdir().unwrap();
        let [x, y] = directions();
        for k in 0..3 {
            let position_mm = (x.cross(y) * SLICE_MM + y * (shift * ROW_MM)) * k as f64;
            let labels = (0..COLUMNS * ROWS).map(|n| if n / COLUMNS < ROWS / 2 { 2 } else { 6 }).collect();
            let mut object = plane(position_mm, directions(), [COLUMNS, ROWS], labels);
            object.put(element(tags::RESCALE_SLOPE, VR::DS, "1"));
            object.put(element(tags::RESCALE_INTERCEPT, VR::DS, "0"));
            object.remove_element(tags::MODALITY);
            save(object, &folder.path().join(format!("IM{k}")));
        }
        let image = read_image(folder.path()).unwrap();
        assert_eq!(image.likely_labels().is_none(), is_refused, "{shift}");
        match image.label_map() {
            Ok(map) => assert!(!is_refused && map.present() == [2, 6], "{:?}", map.present()),
            Err(error) => {
                let message = error.to_string();
                assert!(is_refused && message.contains("tilted gantry"), "{message}");
                assert!(message.contains("nearest voxel"), "{message}");
            }
        }
    }
}

#[test]
fn an_image_that_leans_too_far_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    tilted(folder.path(), [0.0, SLICE_MM * 50f64.to_radians().tan()]);
    let message = read_image(folder.path()).unwrap_err().to_string();
    assert!(message.contains("degrees") && message.contains("tilted gantry"), "{message}");
}

#[test]
fn a_tilted_image_that_would_become_huge_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [x, y] = directions();
    // Positions that are wrong: two small slices 90 mm apart with voxels of 2 micrometres.
    for k in 0..2 {
        let position_mm = (x.cross(y) + x * 0.9 + y * 0.1) * 90.0 * k as f64;
        let mut object = plane(position_mm, [x, y], [4, 3], vec![5; 12]);
        object.put(element(tags::PIXEL_SPACING, VR::DS, decimals(&[2e-3, 2e-3])));
        save(object, &folder.path().join(format!("{k}")));
    }
    let message = read_image(folder.path()).unwrap_err().to_string();
    assert!(message.contains("times as large") && message.contains("are the positions right"), "{message}");
}

/// A dose of frames of 2 x 1 voxels, as read or refused.
fn dose(axes: [DVec3; 2], offsets_mm: Option<&[f64]>) -> Result<StoredImage, String> {
    let offsets = offsets_mm.map(|mm| element(tags::GRID_FRAME_OFFSET_VECTOR, VR::DS, decimals(mm)));
    dose_with(axes, offsets)
}

/// The same, with the element of the offsets.
fn dose_with(
    axes: [DVec3; 2],
    offsets: Option<DataElement<InMemDicomObject>>,
) -> Result<StoredImage, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dose.dcm");
    let n = 4;
    let words = (0..2 * n).map(|word| 100 + word as u16).collect();
    let mut object = plane(ORIGIN_MM, axes, [2, 1], words);
    object.put(element(tags::MODALITY, VR::CS, "RTDOSE"));
    object.remove_element(tags::RESCALE_SLOPE);
    object.remove_element(tags::RESCALE_INTERCEPT);
    object.put(element(tags::DOSE_GRID_SCALING, VR::DS, "0.25"));
    object.put(element(tags::NUMBER_OF_FRAMES, VR::IS, format!("{n}")));
    object.extend(offsets);
    save(object, &path);
    read_image(&path).map_err(|error| error.to_string())
}

#[test]
fn frames_with_offsets_are_placed_along_the_stack() {
    let across = [DVec3::X, DVec3::Y];
    // Prone on the other side: the normal goes to the feet.
    let turned = [DVec3::X, -DVec3::Y];
    let z = ORIGIN_MM.z;
    for (axes, offsets_mm, is_reversed, last_mm) in [
        (across, [0.0, 3.0, 6.0, 9.0], false, DVec3::Z * 9.0),
        (across, [0.0, -3.0, -6.0, -9.0], true, DVec3::Z * -9.0),
        (across, [z, z + 3.0, z + 6.0, z + 9.0], false, DVec3::Z * 9.0),
        (turned, [0.0, 3.0, 6.0, 9.0], false, DVec3::Z * -9.0),
        (turned, [z, z + 3.0, z + 6.0, z + 9.0], true, DVec3::Z * 9.0),
        (directions(), [0.0, 3.0, 6.0, 9.0], false, directions()[0].cross(directions()[1]) * 9.0),
    ] {
        let image = dose(axes, Some(&offsets_mm)).unwrap();
        assert_eq!(image.grid.dims, [2, 1, 4]);
        let values = image.volume().values;
        let (first, last) = if is_reversed { (3, 0) } else { (0, 3) };
        for (frame, k, place_mm) in [(0, first, ORIGIN_MM), (3, last, ORIGIN_MM + last_mm)] {
            let place = image.grid.position_m(DVec3::new(0.0, 0.0, k as f64)) * 1e3;
            assert!(place.distance(place_mm) < 1e-9, "{offsets_mm:?}: frame {frame} at {place}");
            // In gray: numbers times DoseGridScaling.
            assert_eq!(values[2 * k], 0.25 * (100 + 2 * frame) as f32, "{offsets_mm:?}");
        }
    }
}

#[test]
fn frames_without_places_or_at_uneven_ones_are_refused() {
    let across = [DVec3::X, DVec3::Y];
    for (axes, offsets_mm, words) in [
        (
            across,
            Some(&[0.0, 3.0, 7.0, 10.0][..]),
            &["uneven distances", "4.000 mm between dose.dcm, frame 2 and dose.dcm, frame 3"][..],
        ),
        (
            across,
            Some(&[0.0, 3.0, 6.0]),
            &["GridFrameOffsetVector (tag (3004,000C)) is 3 numbers", "4 frames"],
        ),
        (across, Some(&[5.0, 8.0, 11.0, 14.0]), &["GridFrameOffsetVector", "begin with 0", "-30"]),
        (directions(), Some(&[-30.0, -27.0, -24.0, -21.0]), &["GridFrameOffsetVector", "begin with 0"]),
        (
            across,
            None,
            &[
                "PerFrameFunctionalGroupsSequence",
                "GridFrameOffsetVector (3004,000C), which is missing too",
                "NM and ultrasound",
            ],
        ),
    ] {
        let message = dose(axes, offsets_mm).unwrap_err();
        for word in words {
            assert!(message.contains(word), "`{word}` missing in: {message}");
        }
    }
    // Of a program that did not know the element.
    let unknown =
        element(tags::GRID_FRAME_OFFSET_VECTOR, VR::UN, PrimitiveValue::from(b"0\\3\\6\\9 ".to_vec()));
    let message = dose_with(across, Some(unknown)).unwrap_err();
    assert!(message.contains("GridFrameOffsetVector (tag (3004,000C)) is of unknown kind (UN)"), "{message}");
}
