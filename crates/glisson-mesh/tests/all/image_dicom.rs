//! DICOM folders, frames and segmentations, written element by element.

use crate::sample_images::damaged;
use std::path::{Path, PathBuf};

use dicom_core::{DataElement, PrimitiveValue, VR, value::DataSetSequence};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag};
use glisson_mesh::image::files::{
    SeriesChoice, read_image, read_series, read_volume, series_in, write_label_map, write_volume,
};
use glisson_mesh::math::DVec3;
use proptest::prelude::*;

const COLUMNS: usize = 4;
const ROWS: usize = 3;

fn element(tag: Tag, vr: VR, value: impl Into<PrimitiveValue>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, vr, value.into())
}

fn decimals(numbers: &[f64]) -> PrimitiveValue {
    PrimitiveValue::Strs(numbers.iter().map(|n| format!("{n}")).collect())
}

/// Writes an object with a transfer syntax.
fn save(object: InMemDicomObject, syntax: &str, path: &Path) {
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(syntax)
        .media_storage_sop_class_uid(uids::CT_IMAGE_STORAGE)
        .media_storage_sop_instance_uid("1.2.3.4");
    object.with_meta(meta).unwrap().write_to_file(path).unwrap();
}

/// A CT slice of a series that goes along a tilted normal.
#[derive(Clone)]
struct Slice {
    number: usize,
    series: &'static str,
    position_mm: DVec3,
    values: Vec<u16>,
}

fn directions() -> [DVec3; 2] {
    // 30 degrees about x: columns go to the left, rows to the back and head.
    let (sin, cos) = (0.5, 0.75f64.sqrt());
    [DVec3::X, DVec3::new(0.0, cos, sin)]
}

impl Slice {
    /// Number `n` of a series with 2.5 mm between slices.
    fn new(n: usize) -> Self {
        let [x, y] = directions();
        let position_mm = DVec3::new(-10.0, 20.0, -30.0) + x.cross(y) * 2.5 * n as f64;
        let values = (0..COLUMNS * ROWS).map(|v| (1000 + 100 * n + v) as u16).collect();
        Self { number: n, series: "1.2.1", position_mm, values }
    }

    fn object(&self) -> InMemDicomObject {
        let [x, y] = directions();
        let axes = [x.x, x.y, x.z, y.x, y.y, y.z];
        InMemDicomObject::from_element_iter([
            element(tags::MODALITY, VR::CS, "CT"),
            element(tags::PATIENT_NAME, VR::PN, "Doe^Phantom"),
            element(tags::PATIENT_ID, VR::LO, "PID-4711"),
            element(tags::SERIES_INSTANCE_UID, VR::UI, self.series),
            element(tags::SERIES_NUMBER, VR::IS, "3"),
            element(tags::SERIES_DESCRIPTION, VR::LO, "abdomen"),
            element(tags::IMAGE_POSITION_PATIENT, VR::DS, decimals(&self.position_mm.to_array())),
            element(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, decimals(&axes)),
            element(tags::PIXEL_SPACING, VR::DS, decimals(&[0.75, 0.5])),
            element(tags::SLICE_THICKNESS, VR::DS, decimals(&[5.0])),
            element(tags::ROWS, VR::US, PrimitiveValue::from(ROWS as u16)),
            element(tags::COLUMNS, VR::US, PrimitiveValue::from(COLUMNS as u16)),
            element(tags::SAMPLES_PER_PIXEL, VR::US, PrimitiveValue::from(1u16)),
            element(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
            element(tags::BITS_ALLOCATED, VR::US, PrimitiveValue::from(16u16)),
            element(tags::BITS_STORED, VR::US, PrimitiveValue::from(12u16)),
            element(tags::HIGH_BIT, VR::US, PrimitiveValue::from(11u16)),
            element(tags::PIXEL_REPRESENTATION, VR::US, PrimitiveValue::from(0u16)),
            element(tags::RESCALE_SLOPE, VR::DS, decimals(&[1.0])),
            element(tags::RESCALE_INTERCEPT, VR::DS, decimals(&[-1024.0])),
            element(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(self.values.clone().into())),
        ])
    }

    fn save(&self, folder: &Path) -> PathBuf {
        // Names that say nothing of the order.
        let path = folder.join(format!("IM{:03}", 7919 * (self.number + 1) % 997));
        save(self.object(), uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
        path
    }
}

fn series(folder: &Path, n: usize) -> Vec<PathBuf> {
    (0..n).map(|n| Slice::new(n).save(folder)).collect()
}

#[test]
fn a_folder_of_slices_is_put_in_order_and_placed() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("disc/series");
    std::fs::create_dir_all(&inner).unwrap();
    series(&inner, 6);
    std::fs::write(folder.path().join("README.txt"), "a disc").unwrap();
    let image = read_image(folder.path()).unwrap();
    assert_eq!((image.format, image.modality.as_deref()), ("DICOM", Some("CT")));
    assert_eq!(image.grid.dims, [COLUMNS, ROWS, 6]);
    assert!((image.grid.spacing_m - DVec3::new(0.5e-3, 0.75e-3, 2.5e-3)).length() < 1e-12);
    let [x, y] = directions();
    assert!((image.grid.axes.col(0) - x).length() < 1e-9 && (image.grid.axes.col(1) - y).length() < 1e-9);
    assert!((image.grid.origin_m - DVec3::new(-0.01, 0.02, -0.03)).length() < 1e-12);
    let expected: Vec<f32> =
        (0..6).flat_map(|n| Slice::new(n).values).map(|v| f32::from(v) - 1024.0).collect();
    assert_eq!(image.volume().values, expected);
    assert!(image.notes[0].contains("1 file(s) that are not DICOM"), "{:?}", image.notes);
}

#[test]
fn nothing_of_the_patient_is_told_or_written() {
    let folder = tempfile::tempdir().unwrap();
    series(folder.path(), 3);
    let image = read_image(folder.path()).unwrap();
    let told = format!("{image:?} {:?}", series_in(folder.path()).unwrap());
    assert!(!told.contains("Doe") && !told.contains("4711"));
    for name in ["ct.nii", "ct.nrrd", "ct.mha"] {
        let path = folder.path().join(name);
        write_volume(&path, &image.volume()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for secret in [b"Doe^".as_slice(), b"4711"] {
            assert!(!bytes.windows(secret.len()).any(|window| window == secret), "{name}");
        }
    }
}

#[test]
fn a_slice_that_is_there_twice_is_taken_once() {
    let folder = tempfile::tempdir().unwrap();
    let files = series(folder.path(), 4);
    std::fs::copy(&files[2], folder.path().join("copy")).unwrap();
    let image = read_image(folder.path()).unwrap();
    assert_eq!(image.grid.dims[2], 4);
    assert!(image.notes.iter().any(|note| note.contains("1 slice(s) were there twice")), "{:?}", image.notes);
}

/// Changes a series before it is written; the slices and the folder.
type Change = fn(&mut Vec<Slice>, &Path);

#[test]
fn what_is_no_volume_is_refused_with_its_place() {
    let cases: &[(&str, Change, &[&str])] = &[
        (
            "missing",
            |s, _| drop(s.remove(3)),
            &["1 slice(s) missing between", "5.00 mm apart", "2.50 mm apart"],
        ),
        (
            "two missing",
            |s, _| {
                s.remove(3);
                s.remove(3);
            },
            &["2 slice(s) missing between"],
        ),
        ("uneven", |s, _| s[3].position_mm += DVec3::new(0.0, -0.25, 0.433), &["uneven distances"]),
        ("beside", |s, _| s[3].position_mm.x += 3.0, &["beside the line of the other slices"]),
        (
            "phases",
            |s, _| {
                let mut other = s[2].clone();
                other.number = 40;
                other.values[5] += 1;
                s.push(other);
            },
            &["two different slices at one place", "phases of a contrast agent"],
        ),
        (
            "one place",
            |s, _| {
                let place = s[0].position_mm;
                s.iter_mut().for_each(|slice| slice.position_mm = place);
            },
            &["6 slices at one place", "not a volume"],
        ),
        (
            "two series",
            |s, _| s[4].series = "1.2.2",
            &["2 image series found", "--series N", "1: CT, series 3, \"abdomen\", 5 file(s)", "2: CT"],
        ),
    ];
    for (name, change, words) in cases {
        let folder = tempfile::tempdir().unwrap();
        let mut slices: Vec<Slice> = (0..6).map(Slice::new).collect();
        change(&mut slices, folder.path());
        for slice in &slices {
            slice.save(folder.path());
        }
        let message = read_image(folder.path()).unwrap_err().to_string();
        for word in *words {
            assert!(message.contains(word), "{name}: `{word}` missing in: {message}");
        }
        assert!(!message.contains("Doe"), "{name}: {message}");
    }
}

#[test]
fn a_series_of_several_is_chosen_by_its_place_in_the_list() {
    let folder = tempfile::tempdir().unwrap();
    series(folder.path(), 3);
    for n in 0..5 {
        Slice { number: 20 + n, series: "1.2.2", ..Slice::new(n) }.save(folder.path());
    }
    let list = series_in(folder.path()).unwrap();
    assert_eq!(list.iter().map(|s| s.n_files).collect::<Vec<_>>(), [3, 5]);
    let image = read_series(folder.path(), &SeriesChoice::Number(2)).unwrap();
    assert_eq!(image.grid.dims[2], 5);
    let error = read_series(folder.path(), &SeriesChoice::Number(3)).unwrap_err().to_string();
    assert!(error.contains("series 3 asked for, allowed: 1 to 2"), "{error}");
}

/// The message for a slice with one element changed (or, without a value, left out).
fn message_with(tag: Tag, changed: Option<DataElement<InMemDicomObject>>, syntax: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut object = Slice::new(0).object();
    object.remove_element(tag);
    if let Some(changed) = changed {
        object.put(changed);
    }
    let path = folder.path().join("slice.dcm");
    save(object, syntax, &path);
    read_image(&path).unwrap_err().to_string()
}

#[test]
fn bad_elements_are_refused_with_tag_found_and_allowed() {
    let short = |tag, number: u16| Some(element(tag, VR::US, PrimitiveValue::from(number)));
    let plain = uids::EXPLICIT_VR_LITTLE_ENDIAN;
    let cases: Vec<(String, &[&str])> = vec![
        (
            message_with(tags::IMAGE_POSITION_PATIENT, None, plain),
            &["ImagePositionPatient (tag (0020,0032)) is missing", "where the slice is"],
        ),
        (
            message_with(tags::IMAGE_ORIENTATION_PATIENT, None, plain),
            &["ImageOrientationPatient", "which side is left"],
        ),
        (
            message_with(
                tags::IMAGE_ORIENTATION_PATIENT,
                Some(element(
                    tags::IMAGE_ORIENTATION_PATIENT,
                    VR::DS,
                    decimals(&[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]),
                )),
                plain,
            ),
            &["right angle"],
        ),
        (
            message_with(
                tags::PIXEL_SPACING,
                Some(element(tags::PIXEL_SPACING, VR::DS, decimals(&[0.0, 1.0]))),
                plain,
            ),
            &["PixelSpacing (tag (0028,0030))", "above 0"],
        ),
        (
            message_with(
                tags::PIXEL_SPACING,
                Some(element(tags::PIXEL_SPACING, VR::DS, decimals(&[700.0, 500.0]))),
                plain,
            ),
            &["voxels of 500 mm along axis 0", "0.001 to 100 mm"],
        ),
        (
            message_with(
                tags::RESCALE_INTERCEPT,
                Some(element(tags::RESCALE_INTERCEPT, VR::DS, PrimitiveValue::from("-1024,0"))),
                plain,
            ),
            &["RescaleIntercept (tag (0028,1052)) is \"-1024,0\"", "one finite number"],
        ),
        (message_with(tags::ROWS, short(tags::ROWS, 0), plain), &["Rows (tag (0028,0010))", "1 to 65535"]),
        (message_with(tags::ROWS, short(tags::ROWS, 65_535), plain), &["24 bytes found", "524280 expected"]),
        (message_with(tags::SAMPLES_PER_PIXEL, short(tags::SAMPLES_PER_PIXEL, 3), plain), &["colour image"]),
        (message_with(tags::BITS_ALLOCATED, short(tags::BITS_ALLOCATED, 12), plain), &["1, 8, 16 or 32"]),
        (message_with(tags::BITS_STORED, short(tags::BITS_STORED, 20), plain), &["BitsStored", "1 to 16"]),
        (message_with(tags::PIXEL_DATA, None, plain), &["PixelData (tag (7FE0,0010)) is missing"]),
        (
            message_with(
                tags::NUMBER_OF_FRAMES,
                Some(element(tags::NUMBER_OF_FRAMES, VR::IS, PrimitiveValue::from("2"))),
                plain,
            ),
            &["PerFrameFunctionalGroupsSequence", "frames without a place"],
        ),
        (
            message_with(tags::ROWS, None, plain),
            &["no DICOM image found among 1 file(s) (1 DICOM without an image"],
        ),
    ];
    for (number, (message, words)) in cases.iter().enumerate() {
        for word in words.iter().chain(&["slice.dcm"]) {
            assert!(message.contains(word), "case {number}: `{word}` missing in: {message}");
        }
    }
}

#[test]
fn a_transfer_syntax_that_is_not_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slice.dcm");
    save(Slice::new(0).object(), uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
    // The identifier of a syntax of the same length, in the place of the true one.
    let mut object = Slice::new(0).object();
    object.put(DataElement::new(
        tags::PIXEL_DATA,
        VR::OB,
        dicom_core::value::PixelFragmentSequence::new_fragments(vec![vec![0u8; 8]]),
    ));
    save(object, uids::HTJ2K_LOSSLESS, &path);
    let message = read_image(&path).unwrap_err().to_string();
    assert!(message.contains("1.2.840.10008.1.2.4.201") && message.contains("High-Throughput"), "{message}");
    assert!(message.contains("uncompressed"), "{message}");
}

#[test]
fn stored_bits_signs_and_scales_make_the_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slice.dcm");
    let mut object = Slice::new(0).object();
    // Twelve signed bits in the upper part of sixteen, with rubbish below.
    object.put(element(tags::PIXEL_REPRESENTATION, VR::US, PrimitiveValue::from(1u16)));
    object.put(element(tags::HIGH_BIT, VR::US, PrimitiveValue::from(15u16)));
    let numbers: Vec<i16> = (0..12).map(|n| n * 300 - 1500).collect();
    let words: Vec<u16> = numbers.iter().map(|&n| (n as u16) << 4 | 7).collect();
    object.put(element(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(words.into())));
    for syntax in [uids::EXPLICIT_VR_LITTLE_ENDIAN, uids::IMPLICIT_VR_LITTLE_ENDIAN, "1.2.840.10008.1.2.2"] {
        save(object.clone(), syntax, &path);
        let expected: Vec<f32> = numbers.iter().map(|&n| f32::from(n) - 1024.0).collect();
        assert_eq!(read_volume(&path).unwrap().values, expected, "{syntax}");
    }
    // Slices with scales of their own, as PET has them.
    let series = folder.path().join("series");
    std::fs::create_dir(&series).unwrap();
    for n in 0..3 {
        let mut object = Slice::new(n).object();
        object.put(element(tags::RESCALE_SLOPE, VR::DS, decimals(&[1.0 + n as f64])));
        save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &series.join(format!("{n}")));
    }
    let values = read_volume(&series).unwrap().values;
    let expected =
        (0..3).flat_map(|n| Slice::new(n).values.into_iter().map(move |v| f32::from(v) * (1 + n) as f32));
    assert_eq!(values, expected.map(|v| v - 1024.0).collect::<Vec<_>>());
}

/// A sequence of one item.
fn sequence(tag: Tag, elements: Vec<DataElement<InMemDicomObject>>) -> DataElement<InMemDicomObject> {
    let item = InMemDicomObject::from_element_iter(elements);
    DataElement::new(tag, VR::SQ, DataSetSequence::from(vec![item]))
}

/// A segmentation of two segments: three frames in the planes 0 and 2 of 2 mm.
pub(super) fn segmentation(kind: &str, bits: &[u8]) -> InMemDicomObject {
    let plane = |place: f64, segment: u16| {
        let position =
            element(tags::IMAGE_POSITION_PATIENT, VR::DS, decimals(&[1.0, 2.0, 3.0 + 2.0 * place]));
        let number = element(tags::REFERENCED_SEGMENT_NUMBER, VR::US, PrimitiveValue::from(segment));
        InMemDicomObject::from_element_iter([
            sequence(tags::PLANE_POSITION_SEQUENCE, vec![position]),
            sequence(tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![number]),
        ])
    };
    let frames = vec![plane(0.0, 1), plane(2.0, 1), plane(2.0, 2)];
    let orientation =
        element(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, decimals(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
    let measures = vec![
        element(tags::PIXEL_SPACING, VR::DS, decimals(&[1.0, 1.0])),
        element(tags::SPACING_BETWEEN_SLICES, VR::DS, decimals(&[2.0])),
    ];
    let shared = vec![
        sequence(tags::PLANE_ORIENTATION_SEQUENCE, vec![orientation]),
        sequence(tags::PIXEL_MEASURES_SEQUENCE, measures),
    ];
    let segment = |number: u16, name: &str, lab: [u16; 3]| {
        InMemDicomObject::from_element_iter([
            element(tags::SEGMENT_NUMBER, VR::US, PrimitiveValue::from(number)),
            element(tags::SEGMENT_LABEL, VR::LO, name),
            element(
                tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE,
                VR::US,
                PrimitiveValue::U16(lab.to_vec().into()),
            ),
        ])
    };
    // White, and sRGB's red (L 54.29, a 80.81, b 69.89 under D50).
    let segments =
        vec![segment(1, "Liver", [65_535, 32_896, 32_896]), segment(2, "Tumour", [35_579, 53_664, 50_858])];
    InMemDicomObject::from_element_iter([
        element(tags::MODALITY, VR::CS, "SEG"),
        element(tags::SERIES_INSTANCE_UID, VR::UI, "1.2.9"),
        element(tags::SEGMENTATION_TYPE, VR::CS, kind),
        element(tags::NUMBER_OF_FRAMES, VR::IS, "3"),
        element(tags::ROWS, VR::US, PrimitiveValue::from(1u16)),
        element(tags::COLUMNS, VR::US, PrimitiveValue::from(3u16)),
        element(tags::SAMPLES_PER_PIXEL, VR::US, PrimitiveValue::from(1u16)),
        element(tags::BITS_ALLOCATED, VR::US, PrimitiveValue::from(if kind == "BINARY" { 1u16 } else { 8 })),
        element(tags::BITS_STORED, VR::US, PrimitiveValue::from(if kind == "BINARY" { 1u16 } else { 8 })),
        element(tags::HIGH_BIT, VR::US, PrimitiveValue::from(if kind == "BINARY" { 0u16 } else { 7 })),
        element(tags::PIXEL_REPRESENTATION, VR::US, PrimitiveValue::from(0u16)),
        DataElement::new(tags::SEGMENT_SEQUENCE, VR::SQ, DataSetSequence::from(segments)),
        DataElement::new(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, VR::SQ, DataSetSequence::from(frames)),
        sequence(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, shared),
        element(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(bits.to_vec().into())),
    ])
}

#[test]
fn segmentations_become_label_maps_with_names_and_colours() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seg.dcm");
    // Bits of the three frames one after the other, from the lowest: 110, 011, 001.
    for (kind, pixels) in [
        ("BINARY", vec![0b0011_0011u8, 0b1]),
        ("FRACTIONAL", vec![255, 128, 100, 0, 200, 255, 3, 0, 129, 0]),
        ("LABELMAP", vec![1, 1, 0, 0, 1, 1, 0, 0, 2, 0]),
    ] {
        save(segmentation(kind, &pixels), uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
        let image = read_image(&path).unwrap();
        let map = image.label_map().unwrap();
        assert_eq!(map.grid.dims, [3, 1, 3], "{kind}");
        // The plane between, in which nothing is, has no frame.
        assert_eq!(map.labels, [1, 1, 0, 0, 0, 0, 0, 1, 2], "{kind}");
        assert_eq!(map.names, [(1, "Liver".to_string()), (2, "Tumour".to_string())]);
        assert!((map.grid.origin_m - DVec3::new(1e-3, 2e-3, 3e-3)).length() < 1e-12);
        for (colour, expected) in map.colours.iter().zip([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]]) {
            let off = (0..3).map(|part| (colour.1[part] - expected[part]).abs()).fold(0.0, f32::max);
            assert!(off < 0.02, "{:?}", colour.1);
        }
        assert!(image.notes.iter().any(|note| note.contains("overlap in 1 voxels")), "{:?}", image.notes);
        let out = folder.path().join("seg.nrrd");
        write_label_map(&out, &map).unwrap();
    }
}

#[test]
fn planes_of_a_segmentation_are_as_far_apart_as_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seg.dcm");
    // Frames 4 mm apart: with a stated distance of 2 mm there is an empty plane between; a thickness says nothing.
    for (stated, n_planes) in
        [(Some((tags::SPACING_BETWEEN_SLICES, 2.0)), 3), (Some((tags::SLICE_THICKNESS, 2.0)), 2), (None, 2)]
    {
        let mut object = segmentation("BINARY", &[0b0011_0011, 0b1]);
        let orientation =
            element(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, decimals(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
        let mut measures = vec![element(tags::PIXEL_SPACING, VR::DS, decimals(&[1.0, 1.0]))];
        measures.extend(stated.map(|(tag, size)| element(tag, VR::DS, decimals(&[size]))));
        object.put(sequence(
            tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE,
            vec![
                sequence(tags::PLANE_ORIENTATION_SEQUENCE, vec![orientation]),
                sequence(tags::PIXEL_MEASURES_SEQUENCE, measures),
            ],
        ));
        save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
        assert_eq!(read_image(&path).unwrap().grid.dims, [3, 1, n_planes], "{stated:?}");
    }
}

#[test]
fn a_folder_of_dicom_and_other_images_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    series(folder.path(), 3);
    let volume = read_volume(folder.path()).unwrap();
    write_volume(&folder.path().join("ct.nii"), &volume).unwrap();
    let error = read_image(folder.path()).unwrap_err().to_string();
    assert!(error.contains("it holds DICOM and 1 other image(s)"), "{error}");
    assert_eq!(read_series(folder.path(), &SeriesChoice::Number(1)).unwrap().grid.dims[2], 3);
}

#[test]
fn pictures_beside_damaged_dicom_are_not_what_is_told_of() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("preview1.png"), "no picture").unwrap();
    let message = || read_image(folder.path()).unwrap_err().to_string();
    assert!(message().contains("picture(s) of slices"), "{}", message());
    let below = folder.path().join("series");
    std::fs::create_dir(&below).unwrap();
    let path = Slice::new(0).save(&below);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 10]).unwrap();
    assert!(message().contains("element (7FE0,0010)"), "{}", message());
}

#[test]
fn a_segmentation_on_tilted_slices_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seg.dcm");
    let mut object = segmentation("BINARY", &[0b0011_0011, 0b1]);
    let plane = |aside: f64, place: f64| {
        let position =
            element(tags::IMAGE_POSITION_PATIENT, VR::DS, decimals(&[1.0, 2.0 + aside, 3.0 + place]));
        let number = element(tags::REFERENCED_SEGMENT_NUMBER, VR::US, PrimitiveValue::from(1u16));
        InMemDicomObject::from_element_iter([
            sequence(tags::PLANE_POSITION_SEQUENCE, vec![position]),
            sequence(tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![number]),
        ])
    };
    let frames = vec![plane(0.0, 0.0), plane(0.6, 2.0), plane(1.2, 4.0)];
    object.put(DataElement::new(
        tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE,
        VR::SQ,
        DataSetSequence::from(frames),
    ));
    save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
    let message = read_image(&path).unwrap_err().to_string();
    for words in ["frame 2", "0.60 mm beside", "tilted gantry", "nearest voxel"] {
        assert!(message.contains(words), "`{words}` missing in: {message}");
    }
}

#[test]
fn a_file_that_is_cut_is_named_with_its_element() {
    let folder = tempfile::tempdir().unwrap();
    let path = Slice::new(0).save(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 10]).unwrap();
    let message = read_image(&path).unwrap_err().to_string();
    assert!(
        message.contains("element (7FE0,0010)") && message.contains("claims 24 bytes, 14 are left"),
        "{message}"
    );
}

/// A file to damage: a small one, so that changes hit what counts.
fn good_files() -> &'static [Vec<u8>; 2] {
    static FILES: std::sync::OnceLock<[Vec<u8>; 2]> = std::sync::OnceLock::new();
    FILES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dcm");
        [Slice::new(0).object(), segmentation("BINARY", &[0b0011_0011, 0b1])].map(|object| {
            save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
            std::fs::read(&path).unwrap()
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        which in 0..2usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        kept in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let bytes = damaged(&good_files()[which], changes, usize::MAX, cut.then_some(kept));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.dcm");
        std::fs::write(&path, bytes).unwrap();
        match read_volume(&path) {
            Ok(volume) => prop_assert_eq!(volume.values.len(), volume.grid.n_voxels()),
            Err(error) => prop_assert!(error.to_string().contains("damaged.dcm")),
        }
    }
}
