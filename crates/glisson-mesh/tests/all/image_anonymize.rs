//! Copies of DICOM series without the patient.

use crate::sample_images::damaged;
use std::path::{Path, PathBuf};

use dicom_core::value::{DataSetSequence, PixelFragmentSequence};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, Tag, open_file};
use glisson_mesh::image::files::{AnonymousCopy, SeriesChoice, anonymize, read_image, series_in};
use proptest::prelude::*;

/// Whoever finds this in a copy knows the patient.
pub(super) const SECRET: &str = "Zzyzx^Quintilla";
pub(super) const CT: &str = uids::CT_IMAGE_STORAGE;

pub(super) fn element(tag: Tag, vr: VR, value: impl Into<PrimitiveValue>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, vr, value.into())
}

pub(super) fn number(tag: Tag, value: u16) -> DataElement<InMemDicomObject> {
    element(tag, VR::US, PrimitiveValue::from(value))
}

fn sequence(tag: Tag, elements: Vec<DataElement<InMemDicomObject>>) -> DataElement<InMemDicomObject> {
    let item = InMemDicomObject::from_element_iter(elements);
    DataElement::new(tag, VR::SQ, DataSetSequence::from(vec![item]))
}

/// Slice `n` of 2 x 2 voxels with twelve bits, and the secret in everything that is not the image.
pub(super) fn slice(n: usize, series: &str) -> InMemDicomObject {
    let mut object = InMemDicomObject::from_element_iter([
        element(tags::SOP_CLASS_UID, VR::UI, CT),
        element(tags::SOP_INSTANCE_UID, VR::UI, format!("1.2.9876.{series}.{n}")),
        element(tags::STUDY_INSTANCE_UID, VR::UI, "1.2.9876.1"),
        element(tags::SERIES_INSTANCE_UID, VR::UI, format!("1.2.9876.2.{series}")),
        element(tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.2.9876.3"),
        element(tags::MODALITY, VR::CS, "CT"),
        element(tags::SERIES_NUMBER, VR::IS, series.to_owned()),
        element(
            tags::IMAGE_TYPE,
            VR::CS,
            PrimitiveValue::Strs(["ORIGINAL", SECRET, "AXIAL"].map(String::from).to_vec().into()),
        ),
        element(tags::PATIENT_POSITION, VR::CS, SECRET),
        element(tags::IMAGE_POSITION_PATIENT, VR::DS, format!("-1.5\\2\\{}", 2.5 * n as f64)),
        element(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0"),
        element(tags::PIXEL_SPACING, VR::DS, "0.75\\0.5"),
        number(tags::ROWS, 2),
        number(tags::COLUMNS, 2),
        number(tags::SAMPLES_PER_PIXEL, 1),
        element(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
        number(tags::BITS_ALLOCATED, 16),
        number(tags::BITS_STORED, 12),
        number(tags::HIGH_BIT, 11),
        number(tags::PIXEL_REPRESENTATION, 0),
        element(tags::RESCALE_SLOPE, VR::DS, "1"),
        element(tags::RESCALE_INTERCEPT, VR::DS, "-1024"),
        element(tags::WINDOW_CENTER, VR::DS, "40"),
    ]);
    // An overlay in the bits that pixels do not use, and words behind the last pixel.
    let mut words: Vec<u16> = (0..4).map(|v| 0xa000 | (1000 + 10 * n + v) as u16).collect();
    words.extend(
        SECRET.as_bytes().chunks(2).map(|pair| u16::from_le_bytes([pair[0], *pair.get(1).unwrap_or(&0)])),
    );
    object.put(element(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(words.into())));
    for (tag, vr) in [
        (tags::PATIENT_NAME, VR::PN),
        (tags::PATIENT_ID, VR::LO),
        (tags::PATIENT_COMMENTS, VR::LT),
        (tags::INSTITUTION_NAME, VR::LO),
        (tags::OPERATORS_NAME, VR::PN),
        (tags::STUDY_DESCRIPTION, VR::LO),
        (tags::SERIES_DESCRIPTION, VR::LO),
        (tags::IMAGE_COMMENTS, VR::LT),
        (tags::PROTOCOL_NAME, VR::LO),
        (tags::RESCALE_TYPE, VR::LO),
        (tags::WINDOW_CENTER_WIDTH_EXPLANATION, VR::LO),
        (Tag(0x0009, 0x0010), VR::LO),
        (Tag(0x0009, 0x1001), VR::LO),
        (Tag(0x6000, 0x4000), VR::LT),
        (Tag(0x4321, 0x0001), VR::UN),
    ] {
        object.put(element(tag, vr, SECRET));
    }
    object.put(element(tags::STUDY_DATE, VR::DA, "19870319"));
    object.put(element(Tag(0x6000, 0x3000), VR::OW, PrimitiveValue::from(SECRET.as_bytes().to_vec())));
    object.put(sequence(
        tags::REQUEST_ATTRIBUTES_SEQUENCE,
        vec![element(tags::REQUESTED_PROCEDURE_DESCRIPTION, VR::LO, SECRET)],
    ));
    // A sequence that is kept, with more in it than is kept; it refers to the slice before.
    let inner =
        sequence(tags::PURPOSE_OF_REFERENCE_CODE_SEQUENCE, vec![element(tags::CODE_MEANING, VR::LO, SECRET)]);
    object.put(sequence(
        tags::SOURCE_IMAGE_SEQUENCE,
        vec![
            element(tags::REFERENCED_SOP_CLASS_UID, VR::UI, CT),
            element(
                tags::REFERENCED_SOP_INSTANCE_UID,
                VR::UI,
                format!("1.2.9876.{series}.{}", n.saturating_sub(1)),
            ),
            element(Tag(0x0011, 0x1001), VR::LO, SECRET),
            inner,
        ],
    ));
    object
}

pub(super) fn save(object: InMemDicomObject, syntax: &str, path: &Path) {
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(syntax)
        .media_storage_sop_class_uid(CT)
        .media_storage_sop_instance_uid("1.2.3.4")
        .source_application_entity_title(SECRET);
    object.with_meta(meta).unwrap().write_to_file(path).unwrap();
    // The preamble is for whoever writes the file.
    let mut bytes = std::fs::read(path).unwrap();
    bytes[..SECRET.len()].copy_from_slice(SECRET.as_bytes());
    std::fs::write(path, bytes).unwrap();
}

/// A folder with a series of three slices, in files named after the patient.
fn scan(folder: &Path, series: &str, syntax: &str) -> PathBuf {
    let scan = folder.join("scan");
    std::fs::create_dir_all(&scan).unwrap();
    for n in 0..3 {
        save(slice(n, series), syntax, &scan.join(format!("Zzyzx-{series}-{}.dcm", 9 - n)));
    }
    scan
}

pub(super) fn copy(input: &Path, output: &Path) -> AnonymousCopy {
    anonymize(input, &SeriesChoice::Only, output, [7; 32]).unwrap()
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { files.extend(files_below(&path)) } else { files.push(path) }
    }
    files.sort();
    files
}

#[test]
fn a_copy_has_the_voxels_and_nothing_of_the_patient() {
    for syntax in [
        uids::EXPLICIT_VR_LITTLE_ENDIAN,
        uids::IMPLICIT_VR_LITTLE_ENDIAN,
        "1.2.840.10008.1.2.2",
        uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN,
    ] {
        let folder = tempfile::tempdir().unwrap();
        let scan = scan(folder.path(), "4", syntax);
        let out = folder.path().join("out/copy");
        let done = copy(&scan, &out);
        assert_eq!((done.n_series, done.n_files, done.notes.len()), (1, 3, 1), "{:?}", done.notes);
        assert!(done.notes[0].contains("in 3 file(s) 12 pixel(s) had something in bits"), "{:?}", done.notes);
        let files = files_below(&out);
        let names: Vec<_> = files.iter().map(|file| file.file_name().unwrap().to_string_lossy()).collect();
        assert_eq!(names, ["slice_0001.dcm", "slice_0002.dcm", "slice_0003.dcm"]);
        for file in &files {
            // Deflated files hide their bytes: what is in them is looked for in the text of all of it.
            let object = open_file(file).unwrap();
            assert_eq!(object.meta().transfer_syntax().trim_end_matches('\0'), syntax);
            let bytes = std::fs::read(file).unwrap();
            for secret in ["Zzyzx", "Quintilla", "ZZYZX", "19870319", "1.2.9876"] {
                let is_in = bytes.windows(secret.len()).any(|window| window == secret.as_bytes());
                assert!(!is_in && !format!("{object:?}").contains(secret), "{secret} in {}", file.display());
            }
            assert!(object.iter().all(|element| element.header().tag.group() % 2 == 0));
            let text = |tag| object.element(tag).unwrap().to_str().unwrap().into_owned();
            assert_eq!(text(tags::PATIENT_IDENTITY_REMOVED), "YES");
            assert_eq!(text(tags::IMAGE_TYPE), "ORIGINAL\\OTHER\\AXIAL");
            assert_eq!(text(tags::WINDOW_CENTER), "40");
            // The four pixels, without the overlay in their upper bits.
            let pixels = object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
            assert!(pixels.len() == 4 && pixels.iter().all(|word| word & 0xf000 == 0), "{pixels:?}");
            assert!(object.get(tags::DEIDENTIFICATION_METHOD_CODE_SEQUENCE).is_some());
        }
        let (before, after) = (read_image(&scan).unwrap(), read_image(&out).unwrap());
        assert_eq!(before.grid, after.grid);
        assert_eq!(before.volume().values, after.volume().values);
        assert_eq!(after.volume().values[0], -24.0);
        assert_eq!(after.modality.as_deref(), Some("CT"));
    }
}

#[test]
fn what_refers_to_a_file_refers_to_its_copy() {
    let folder = tempfile::tempdir().unwrap();
    let scan = scan(folder.path(), "4", uids::EXPLICIT_VR_LITTLE_ENDIAN);
    super::image_anonymize::scan(folder.path(), "5", uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let out = folder.path().join("copy");
    assert_eq!(copy(&scan, &out).n_series, 2);
    let text = |file: &str, tag| {
        let object = open_file(out.join(file)).unwrap();
        let inside = object.element(tags::SOURCE_IMAGE_SEQUENCE).unwrap().items().unwrap()[0].clone();
        let element = object.get(tag).or_else(|| inside.get(tag)).unwrap().clone();
        element.to_str().unwrap().into_owned()
    };
    let (first, second) = ("series_1/slice_0001.dcm", "series_1/slice_0002.dcm");
    let uid = text(first, tags::SOP_INSTANCE_UID);
    assert!(uid.starts_with("2.25.") && uid.len() <= 64, "{uid}");
    assert_eq!(text(second, tags::REFERENCED_SOP_INSTANCE_UID), uid);
    assert_ne!(text(second, tags::SOP_INSTANCE_UID), uid);
    for (tag, is_same) in [
        (tags::STUDY_INSTANCE_UID, true),
        (tags::FRAME_OF_REFERENCE_UID, true),
        (tags::SERIES_INSTANCE_UID, false),
    ] {
        assert_eq!(text(first, tag) == text("series_2/slice_0001.dcm", tag), is_same, "{tag}");
    }
    assert_eq!(series_in(&out).unwrap().len(), 2);
    // Another key, other identifiers.
    let other = folder.path().join("other");
    anonymize(&scan, &SeriesChoice::Number(1), &other, [8; 32]).unwrap();
    let object = open_file(other.join("slice_0001.dcm")).unwrap();
    assert_ne!(object.element(tags::SOP_INSTANCE_UID).unwrap().to_str().unwrap(), uid);
}

#[test]
fn a_segmentation_keeps_its_places_and_loses_its_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("seg.dcm");
    let mut object = super::image_dicom::segmentation("BINARY", &[0b0011_0011, 0b1111_0001]);
    object.put(element(tags::CONTENT_LABEL, VR::CS, SECRET));
    save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
    let out = folder.path().join("out");
    let done = copy(&path, &out);
    assert!(done.notes[0].contains("names of 2 segment(s)"), "{:?}", done.notes);
    let [before, after] = [&path, &out].map(|path| read_image(path).unwrap().label_map().unwrap());
    assert_eq!((before.grid, before.labels, before.colours), (after.grid, after.labels, after.colours));
    assert_eq!(after.names, [(1, "Segment 1".to_owned()), (2, "Segment 2".to_owned())]);
    // Nine bits in two bytes: the others are nobody's.
    let object = open_file(out.join("slice_0001.dcm")).unwrap();
    assert_eq!(*object.element(tags::PIXEL_DATA).unwrap().to_bytes().unwrap(), [0b0011_0011, 0b1]);
}

#[test]
fn comments_of_compressed_pixels_are_cleared() {
    let segment = |marker: u8, payload: &[u8]| {
        let length = (payload.len() as u16 + 2).to_be_bytes();
        [&[0xff, marker], &length[..], payload].concat()
    };
    // Not images: what stands beside the coded data is looked at, and that these stay.
    let coded = [0x12, 0xff, 0x00, 0x34, 0xff, 0xd1, 0x56];
    let jpeg = [
        &[0xff, 0xd8][..],
        &segment(0xe0, &[b"JFIF\0\x01\x01\0\0\x01\0\x01\0\0", SECRET.as_bytes()].concat()),
        &segment(0xe1, format!("Exif\0\0{SECRET}").as_bytes()),
        &segment(0xfe, SECRET.as_bytes()),
        &segment(0xda, &[1, 2, 3]),
        &coded,
        &segment(0xfe, SECRET.as_bytes()),
        &[0xff, 0xd9],
        SECRET.as_bytes(),
    ]
    .concat();
    let tile = vec![0xff, 0x93, 0xff, 0x64, 0, 9, 9, 9];
    let mut start = segment(0x90, &[0, 0, 0, 0, 0, 0, 0, 1]);
    let comment_in_tile = segment(0x64, &[&[0, 1], SECRET.as_bytes()].concat());
    let n_tile = (start.len() + comment_in_tile.len() + tile.len()) as u32;
    start[6..10].copy_from_slice(&n_tile.to_be_bytes());
    let jpeg_2000 = [
        &[0xff, 0x4f][..],
        &segment(0x51, &[0; 39]),
        &segment(0x64, &[&[0, 1], SECRET.as_bytes()].concat()),
        &start,
        &comment_in_tile,
        &tile,
        &[0xff, 0xd9],
        SECRET.as_bytes(),
    ]
    .concat();
    for (stream, syntax, kept) in
        [(jpeg, uids::JPEG_LOSSLESS_SV1, coded.to_vec()), (jpeg_2000, uids::JPEG2000_LOSSLESS, tile)]
    {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dcm");
        let mut object = slice(0, "4");
        // Also in two fragments, the name in both.
        let (a, b) = stream.split_at(stream.len() / 2);
        let fragments = PixelFragmentSequence::new_fragments(vec![a.to_vec(), b.to_vec()]);
        object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, fragments));
        save(object, syntax, &path);
        let out = folder.path().join("out");
        copy(&path, &out);
        let object = open_file(out.join("slice_0001.dcm")).unwrap();
        let copied = object.element(tags::PIXEL_DATA).unwrap().fragments().unwrap().concat();
        assert!(copied.len() >= stream.len());
        assert!(!copied.windows(4).any(|w| SECRET.as_bytes().windows(4).any(|s| s == w)), "{syntax}");
        assert!(copied.windows(kept.len()).any(|window| window == kept), "{syntax}");
        assert_eq!(copied[..2], stream[..2]);
    }
}

/// The notes of a copy, or the message of a refusal.
pub(super) type Outcome = Result<Vec<String>, String>;

/// What becomes of a slice that is changed.
pub(super) fn with(change: impl FnOnce(&mut InMemDicomObject)) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    let mut object = slice(0, "4");
    change(&mut object);
    let path = folder.path().join("a.dcm");
    save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
    let out = folder.path().join("out");
    let result = anonymize(&path, &SeriesChoice::Only, &out, [7; 32]);
    if result.is_err() {
        // Neither the folder nor the one that it was to become of.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    result.map(|copy| copy.notes).map_err(|error| error.to_string())
}

#[test]
fn what_may_tell_the_patient_is_refused() {
    let refused: Vec<(Outcome, &[&str])> = vec![
        (
            with(|o| drop(o.put(element(tags::RESCALE_SLOPE, VR::DS, "Zzyzx")))),
            &["RescaleSlope (tag (0028,1053)) is no number"],
        ),
        (
            with(|o| drop(o.put(element(tags::SLICE_LOCATION, VR::LO, "Zzyzx")))),
            &["SliceLocation", "no number"],
        ),
        (
            with(|o| drop(o.put(element(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "PALETTE COLOR")))),
            &["PhotometricInterpretation", "MONOCHROME2"],
        ),
        (
            with(|o| drop(o.put(element(tags::SOP_CLASS_UID, VR::UI, "1.3.12.2")))),
            &["SOPClassUID", "manufacturer"],
        ),
        (with(|o| assert!(o.remove_element(tags::PIXEL_DATA))), &["PixelData (tag (7FE0,0010)) is missing"]),
        (with(|o| drop(o.put(number(tags::ROWS, 2000)))), &["bytes found", "8000 expected"]),
        (
            with(|o| {
                let table = element(tags::LUT_DATA, VR::US, PrimitiveValue::from(1u16));
                o.put(sequence(tags::MODALITY_LUT_SEQUENCE, vec![table]));
            }),
            &["ModalityLUTSequence", "a table of values", "a slope and an intercept"],
        ),
        (
            with(|o| {
                let bytes = PrimitiveValue::from(SECRET.as_bytes().to_vec());
                o.put(element(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, VR::UN, bytes));
            }),
            &["SharedFunctionalGroupsSequence", "no sequence", "UN"],
        ),
    ];
    for (number, (result, words)) in refused.iter().enumerate() {
        let message = result.as_ref().unwrap_err();
        assert!(!message.contains("Zzyzx"), "case {number}: {message}");
        for word in words.iter().chain(&["a.dcm"]) {
            assert!(message.contains(word), "case {number}: `{word}` missing in: {message}");
        }
    }
}

#[test]
fn numbers_that_tell_volumes_apart_and_units_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.dcm"), folder.path().join("out"));
    let mut object = slice(0, "4");
    for (tag, vr, value) in [
        (tags::ACQUISITION_NUMBER, VR::IS, "3"),
        (tags::TEMPORAL_POSITION_IDENTIFIER, VR::IS, "5"),
        (tags::ECHO_NUMBERS, VR::IS, "1\\2"),
        (tags::UNITS, VR::CS, "BQML"),
    ] {
        object.put(element(tag, vr, value));
    }
    // An empty sequence is none that is not understood.
    object.put(element(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, VR::UN, PrimitiveValue::Empty));
    save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
    copy(&path, &out);
    let object = open_file(out.join("slice_0001.dcm")).unwrap();
    let text = |tag| object.element(tag).unwrap().to_str().unwrap().into_owned();
    assert_eq!(text(tags::ACQUISITION_NUMBER), "3");
    assert_eq!(text(tags::TEMPORAL_POSITION_IDENTIFIER), "5");
    assert_eq!(text(tags::ECHO_NUMBERS), "1\\2");
    assert_eq!(text(tags::UNITS), "BQML");
}

#[test]
fn files_that_are_not_copied_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let scan = scan(folder.path(), "4", uids::EXPLICIT_VR_LITTLE_ENDIAN);
    std::fs::write(scan.join("notes.txt"), "3 slices").unwrap();
    let mut report = slice(0, "4");
    report.remove_element(tags::ROWS);
    save(report, uids::EXPLICIT_VR_LITTLE_ENDIAN, &scan.join("report.dcm"));
    let notes = copy(&scan, &folder.path().join("out")).notes;
    for words in ["1 file(s) that are not DICOM were passed over", "1 DICOM file(s) without an image"] {
        assert!(notes.iter().any(|note| note.contains(words)), "{notes:?}");
    }
    // A choice that is not there is refused without what series are called.
    let out = folder.path().join("other");
    let message = anonymize(&scan, &SeriesChoice::Number(99), &out, [7; 32]).unwrap_err().to_string();
    assert!(message.contains("series 99 asked for, allowed: 1 to 1"), "{message}");
    assert!(message.contains("CT, series 4, 3 file(s)") && !message.contains(SECRET), "{message}");
}

#[test]
fn an_output_in_the_input_or_at_a_link_is_refused_before_anything_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let scan = scan(folder.path(), "4", uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let at = |place: &str| folder.path().join(place);
    std::os::unix::fs::symlink(at("nowhere"), at("link")).unwrap();
    std::os::unix::fs::symlink(&scan, at("other_name")).unwrap();
    let one = scan.join("Zzyzx-4-7.dcm");
    let lies_in = "it lies in what is copied";
    for (input, output, words) in [
        (&scan, at("new/../scan/copy"), lies_in),
        (&scan, at("other_name/copy"), lies_in),
        (&scan, at("scan/../scan/new/copy"), lies_in),
        (&at("other_name"), at("scan"), lies_in),
        (&one, one.clone(), lies_in),
        (&one, one.join("copy"), lies_in),
        (&scan, at("link"), "a link is there already"),
    ] {
        let error = anonymize(input, &SeriesChoice::Only, &output, [7; 32]).unwrap_err().to_string();
        assert!(error.contains(words), "{}: {error}", output.display());
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    assert_eq!(files_below(&scan).len(), 3);
    // Nor do the folders above it stay where nothing came about.
    let mut bad = slice(0, "4");
    bad.put(element(tags::RESCALE_SLOPE, VR::DS, "Zzyzx"));
    save(bad, uids::EXPLICIT_VR_LITTLE_ENDIAN, &scan.join("bad.dcm"));
    anonymize(&scan, &SeriesChoice::Only, &at("a/b/copy"), [7; 32]).unwrap_err();
    assert!(!at("a").exists());
    // Where one was there, it stays.
    std::fs::create_dir(at("a")).unwrap();
    anonymize(&scan, &SeriesChoice::Only, &at("a/b/copy"), [7; 32]).unwrap_err();
    assert!(at("a").exists() && !at("a/b").exists());
    // `..` behind something that is not there makes nothing of it.
    std::fs::remove_file(scan.join("bad.dcm")).unwrap();
    copy(&scan, &at("new/../copy"));
    assert!(at("copy/slice_0001.dcm").exists() && !at("new").exists());
}

#[test]
fn a_folder_in_use_and_what_is_no_dicom_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scan = scan(folder.path(), "4", uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let file = folder.path().join("a.nrrd");
    std::fs::write(&file, "NRRD0004\n").unwrap();
    let used = folder.path().join("used");
    std::fs::create_dir(&used).unwrap();
    std::fs::write(used.join("b"), "b").unwrap();
    let message = |input: &Path, output: &Path| {
        anonymize(input, &SeriesChoice::Only, output, [7; 32]).unwrap_err().to_string()
    };
    let new = folder.path().join("new");
    for (message, words) in [
        (message(&scan, &used), ["used", "a folder with files in it is there already"]),
        (message(&scan, &file), ["a.nrrd", "a file is there already"]),
        (message(&scan, &scan.join("copy")), ["scan/copy", "it lies in what is copied"]),
        (message(&file, &new), ["a.nrrd", "copies without the patient are made of DICOM"]),
        (message(&used, &new), ["used", "no DICOM image found among 1 file(s)"]),
    ] {
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
    assert!(!new.exists() && files_below(&scan).len() == 3);
    // A folder that is there and empty is taken.
    std::fs::create_dir(&new).unwrap();
    copy(&scan, &new);
    assert_eq!(files_below(&new).len(), 3);
}

fn good_file() -> &'static [u8] {
    static FILE: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    FILE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dcm");
        save(slice(0, "4"), uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
        std::fs::read(path).unwrap()
    })
}

/// Whether bytes say who the patient is.
fn tells(bytes: &[u8]) -> bool {
    bytes.windows(8).any(|window| window == &SECRET.as_bytes()[..8])
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_are_copied_whole_or_not_at_all(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        kept in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let bytes = damaged(good_file(), changes, usize::MAX, cut.then_some(kept));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.dcm");
        std::fs::write(&path, bytes).unwrap();
        let out = folder.path().join("out");
        match anonymize(&path, &SeriesChoice::Only, &out, [7; 32]) {
            Ok(_) => {
                let bytes = std::fs::read(out.join("slice_0001.dcm")).unwrap();
                prop_assert!(!tells(&bytes));
            }
            Err(_) => prop_assert!(std::fs::read_dir(folder.path()).unwrap().count() == 1),
        }
    }
}

#[test]
fn no_damaged_length_brings_text_into_a_copy() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("damaged.dcm"), folder.path().join("out"));
    let good = good_file();
    let mut n_copied = 0;
    // Every byte, as those of lengths, with the even lengths that reach over some elements.
    for at in 132..good.len() {
        for length in [18, 36, 70, 110, 170, 250] {
            let mut bytes = good.to_vec();
            bytes[at] = length;
            std::fs::write(&path, &bytes).unwrap();
            if anonymize(&path, &SeriesChoice::Only, &out, [7; 32]).is_ok() {
                let copied = std::fs::read(out.join("slice_0001.dcm")).unwrap();
                assert!(!tells(&copied), "byte {at} made {length}");
                std::fs::remove_dir_all(&out).unwrap();
                n_copied += 1;
            }
        }
    }
    assert!(n_copied > 1000, "{n_copied}");
}

#[test]
fn several_segments_that_an_image_is_of_are_kept_and_letters_are_not() {
    let with = |numbers: Vec<u16>| {
        let folder = tempfile::tempdir().unwrap();
        let (path, out) = (folder.path().join("a.dcm"), folder.path().join("out"));
        let mut object = slice(0, "4");
        let segments = element(tags::REFERENCED_SEGMENT_NUMBER, VR::US, PrimitiveValue::U16(numbers.into()));
        object.put(sequence(tags::SOURCE_IMAGE_SEQUENCE, vec![segments]));
        save(object, uids::EXPLICIT_VR_LITTLE_ENDIAN, &path);
        anonymize(&path, &SeriesChoice::Only, &out, [7; 32])?;
        let copied = open_file(out.join("slice_0001.dcm")).unwrap();
        let items = copied.element(tags::SOURCE_IMAGE_SEQUENCE).unwrap();
        let item = items.items().unwrap()[0].element(tags::REFERENCED_SEGMENT_NUMBER).unwrap();
        Ok::<_, glisson_mesh::image::files::ImageError>(item.to_multi_int::<u16>().unwrap())
    };
    assert_eq!(with(vec![1, 2, 300]).unwrap(), [1, 2, 300]);
    let refused = with(vec![u16::from_le_bytes(*b"Zz"), u16::from_le_bytes(*b"yz")]).unwrap_err().to_string();
    assert!(refused.contains("ReferencedSegmentNumber") && refused.contains("no number"), "{refused}");
}
