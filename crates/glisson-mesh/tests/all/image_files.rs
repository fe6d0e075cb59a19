//! Image files of every format: round trips, files of other programs, and what is refused.

use std::path::{Path, PathBuf};

use glisson_mesh::image::files::{
    FORMATS, ImageError, ImageFormat, format_of_name, image_extensions, read_image, read_label_map,
    read_volume, write_label_map, write_volume,
};
use glisson_mesh::image::{LabelMap, Volume};
use glisson_mesh::math::{DMat3, DVec3};
use proptest::prelude::*;

use crate::sample_images::{assert_same_place, damaged, oblique_grid, plain_grid};

/// Names of files that can be written, one of each way.
const WRITTEN: [&str; 5] = ["a.nii", "a.nii.gz", "a.nrrd", "a.seg.nrrd", "a.mha"];

fn named_map() -> LabelMap {
    let grid = oblique_grid(false);
    let labels = (0..grid.n_voxels()).map(|v| v as u16 % 4).collect();
    let names = vec![(1, "liver".to_string()), (2, "gall bladder \"é\"".to_string()), (3, "a\\nb".into())];
    let colours = vec![(1, [0.75, 0.25, 0.125]), (3, [0.0, 1.0, 0.5])];
    LabelMap { grid, labels, names, colours }
}

#[test]
fn every_written_format_keeps_values_places_names_and_colours() {
    let folder = tempfile::tempdir().unwrap();
    for name in WRITTEN {
        let path = folder.path().join(name);
        for left_handed in [false, true] {
            for step in [1.0, 0.37] {
                let grid = oblique_grid(left_handed);
                let values = (0..grid.n_voxels()).map(|v| v as f32 * step - 30.0).collect();
                let volume = Volume { grid, values };
                write_volume(&path, &volume).unwrap();
                let back = read_volume(&path).unwrap();
                assert_eq!(back.values, volume.values, "{name}");
                assert_same_place(&back.grid, &volume.grid);
            }
        }
        let map = named_map();
        write_label_map(&path, &map).unwrap();
        let back = read_label_map(&path).unwrap();
        assert_eq!(
            (&back.labels, &back.names, &back.colours),
            (&map.labels, &map.names, &map.colours),
            "{name}"
        );
        assert_same_place(&back.grid, &map.grid);
    }
}

#[test]
fn text_headers_keep_places_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let map = named_map();
    for name in ["a.nrrd", "a.mha"] {
        let path = folder.path().join(name);
        write_label_map(&path, &map).unwrap();
        let once = read_label_map(&path).unwrap();
        write_label_map(&path, &once).unwrap();
        let twice = read_label_map(&path).unwrap();
        let far = (once.grid.origin_m - map.grid.origin_m).length() / map.grid.origin_m.length();
        assert!(far < 1e-15, "{name}: {far}");
        assert!((once.grid.spacing_m - twice.grid.spacing_m).length() < 1e-15, "{name}");
    }
}

#[test]
fn a_refused_write_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let volume = Volume { values: vec![0.0; 8], grid: plain_grid([2, 2, 2], [1.0; 3]) };
    for (name, words) in [
        ("ct.dcm", "must end in one of .nii, .nii.gz, .nrrd"),
        ("ct.inr", "must end in one of"),
        ("ct.nhdr", "name it .nrrd"),
        ("ct.mhd", "name it .mha"),
    ] {
        let error = write_volume(&folder.path().join(name), &volume).unwrap_err();
        assert!(error.to_string().contains(words), "{name}: {error}");
    }
    let missing = folder.path().join("no/such/folder/ct.nii");
    assert!(matches!(write_volume(&missing, &volume), Err(ImageError::Io { .. })));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_format_is_told_by_the_name_or_else_by_the_first_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let map = named_map();
    for name in WRITTEN {
        let path = folder.path().join(name);
        write_label_map(&path, &map).unwrap();
        let nameless = folder.path().join("IM0001");
        std::fs::rename(&path, &nameless).unwrap();
        assert_eq!(read_label_map(&nameless).unwrap().labels, map.labels, "{name}");
    }
    std::fs::write(folder.path().join("notes"), "liver").unwrap();
    let error = read_volume(&folder.path().join("notes")).unwrap_err().to_string();
    assert!(error.contains("begins with \"liver\"") && error.contains(".nii.gz"), "{error}");
    assert_eq!(format_of_name(Path::new("A.SEG.NRRD")).unwrap().name, "NRRD");
    assert!(format_of_name(Path::new("nii")).is_none());
    assert!(FORMATS.iter().any(ImageFormat::is_written) && image_extensions(|_| true).contains(&"inr.gz"));
}

// ---- NRRD --------------------------------------------------------------------------------------------

/// 2 x 3 x 1 voxels of 2 x 3 x 4 mm.
const NRRD: &str = "NRRD0004
# by hand
type: short
dimension: 3
space: right-anterior-superior
sizes: 2 3 1
space directions: (2,0,0) (0, 3, 0) (0,0,4)
kinds: domain domain domain
endian: big
encoding: ENCODING
space origin: (10,20,30)
EXTRA
DATA";

fn nrrd_file(folder: &Path, encoding: &str, extra: &str, data: &[u8]) -> PathBuf {
    let text =
        NRRD.replace("ENCODING", encoding).replace("EXTRA\n", if extra.is_empty() { "" } else { "EXTRA\n" });
    let text = text.replace("EXTRA", extra).replace("DATA", "\n");
    let path = folder.join("a.nrrd");
    std::fs::write(&path, [text.as_bytes(), data].concat()).unwrap();
    path
}

fn six_shorts() -> (Vec<u8>, [f32; 6]) {
    let numbers = [-2i16, -1, 0, 1, 2, 300];
    (numbers.iter().flat_map(|v| v.to_be_bytes()).collect(), numbers.map(f32::from))
}

#[test]
fn nrrd_of_every_encoding_is_read_and_placed() {
    let folder = tempfile::tempdir().unwrap();
    let (data, expected) = six_shorts();
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, &data).unwrap();
    let packed = encoder.finish().unwrap();
    let hex: String = data.iter().map(|b| format!("{b:02X}\n")).collect();
    let skipped = [b"one\ntwo\nxy".as_slice(), &data].concat();
    let at_end = [b"anything at all".as_slice(), &data].concat();
    for (encoding, extra, bytes) in [
        ("raw", "", data.as_slice()),
        ("gzip", "", &packed),
        ("ascii", "", b"-2 -1 0\n1 2 3e2\n"),
        ("hex", "", hex.as_bytes()),
        ("raw", "line skip: 2\nbyte skip: 2", &skipped),
        ("raw", "byte skip: -1", &at_end),
        ("raw", "space units: \"mm\" \"mm\" \"mm\"", &data),
    ] {
        let image = read_image(&nrrd_file(folder.path(), encoding, extra, bytes)).unwrap();
        assert_eq!(image.volume().values, expected, "{encoding} {extra}");
        // RAS in the file: x and y change sign.
        assert!((image.grid.origin_m - DVec3::new(-0.01, -0.02, 0.03)).length() < 1e-15);
        assert!((image.grid.spacing_m - DVec3::new(2e-3, 3e-3, 4e-3)).length() < 1e-15);
        assert_eq!(image.grid.axes, DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
    }
    std::fs::write(folder.path().join("a.raw"), &data).unwrap();
    let detached = nrrd_file(folder.path(), "raw", "data file: a.raw", b"");
    assert_eq!(read_volume(&detached).unwrap().values, expected);
}

#[test]
fn bad_nrrd_is_refused_with_line_found_and_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let (data, _) = six_shorts();
    let good = std::fs::read(nrrd_file(folder.path(), "raw", "", &data)).unwrap();
    let header = String::from_utf8(good[..good.len() - data.len()].to_vec()).unwrap();
    let cases: &[(&str, &str, &[&str])] = &[
        ("NRRD0004", "NORD0004", &["magic", "not an NRRD"]),
        ("type: short", "type: shrot", &["type (line 3)", "\"shrot\"", "did you mean \"short\"?"]),
        ("type: short\n", "", &["type (anywhere in it) is missing"]),
        ("dimension: 3", "dimension: 2", &["dimension (line 4)", "3 to 4"]),
        ("sizes: 2 3 1", "sizes: 2 3", &["sizes (line 6)", "3 numbers of voxels"]),
        ("sizes: 2 3 1", "sizes: 2 3 0", &["sizes (line 6)", "from 1"]),
        ("sizes: 2 3 1", "sizes: 16777216 16777216 16777216", &["sizes (line 6)"]),
        ("sizes: 2 3 1", "sizes: 65536 65536 65536", &["sizes (line 6)", "below 2^45"]),
        ("sizes: 2 3 1", "sizes: 65536 65536 4096", &["12 bytes found", "35184372088832 expected"]),
        ("sizes: 2 3 1", "sizes: 2 3 2", &["12 bytes found", "24 expected"]),
        ("space: right-anterior-superior\n", "", &["no `space`", "which side is left"]),
        ("right-anterior-superior", "3D-right-handed", &["space (line 5)", "left-posterior-superior"]),
        ("(2,0,0)", "(2,0)", &["space directions (line 7)", "3 vectors"]),
        ("(2,0,0)", "(0,0,0)", &["space directions (line 7)", "not zero"]),
        ("(2,0,0)", "none", &["space directions (line 7)"]),
        ("(2,0,0)", "(2,0.2,0)", &["[0, 1]", "degrees", "resample"]),
        ("(2,0,0)", "(2000,0,0)", &["voxels of 2000 mm along axis 0", "0.001 to 100 mm"]),
        ("endian: big\n", "", &["endian", "missing"]),
        ("encoding: raw", "encoding: bzip2", &["encoding (line 10)", "bzip2", "gzip"]),
        ("encoding: raw", "encoding: raw\ndata file: ../a.raw", &["data file", "header's folder"]),
        ("encoding: raw", "encoding: raw\ndata file: s%d.raw 1 3 1", &["data file", "join the slices"]),
        ("encoding: raw", "encoding: raw\nnonsense", &["line 11", "nonsense"]),
    ];
    for (number, (from, to, words)) in cases.iter().enumerate() {
        assert!(header.contains(from), "case {number}");
        let path = folder.path().join("bad.nrrd");
        std::fs::write(&path, [header.replacen(from, to, 1).as_bytes(), &data].concat()).unwrap();
        let message = read_volume(&path).unwrap_err().to_string();
        for word in words.iter().chain(&["bad.nrrd"]) {
            assert!(message.contains(word), "case {number}: `{word}` missing in: {message}");
        }
    }
}

#[test]
fn segments_of_several_layers_become_one_label_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.seg.nrrd");
    // Two layers; in voxel 1 both have something. Both segments are number 1 of their layer.
    let header = "NRRD0004\ntype: unsigned char\ndimension: 4\nspace: LPS\nsizes: 2 3 1 1\n\
        space directions: none (1,0,0) (0,1,0) (0,0,1)\nkinds: list domain domain domain\nencoding: raw\n\
        space origin: (0,0,0)\nSegment0_ID:=Segment_1\nSegment0_Name:=liver\nSegment0_LabelValue:=1\n\
        Segment0_Layer:=0\nSegment0_Color:=0.5 0.25 0\nSegment1_ID:=Segment_2\nSegment1_Name:=tumour\n\
        Segment1_LabelValue:=1\nSegment1_Layer:=1\n\n";
    std::fs::write(&path, [header.as_bytes(), &[1, 0, 1, 1, 0, 0]].concat()).unwrap();
    let image = read_image(&path).unwrap();
    let map = image.label_map().unwrap();
    assert_eq!(map.labels, [1, 2, 0]);
    assert_eq!(map.names, [(1, "liver".to_string()), (2, "tumour".to_string())]);
    assert_eq!(map.colours, [(1, [0.5, 0.25, 0.0])]);
    assert_eq!(image.notes.len(), 1);
    assert!(image.notes[0].contains("overlap in 1 voxels"), "{}", image.notes[0]);
    let beyond = header.replace("Segment1_Layer:=1", "Segment1_Layer:=2");
    std::fs::write(&path, [beyond.as_bytes(), &[1, 0, 1, 1, 0, 0]].concat()).unwrap();
    let error = read_image(&path).unwrap_err().to_string();
    assert!(error.contains("Segment1_Layer (line 18)") && error.contains("0 to 1"), "{error}");
}

#[test]
fn layers_of_old_files_are_zeros_and_ones_and_layers_of_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.nrrd");
    let header = "NRRD0004\ntype: unsigned char\ndimension: 4\nspace: LPS\nsizes: 2 3 1 1\n\
        space directions: none (1,0,0) (0,1,0) (0,0,1)\nkinds: list domain domain domain\nencoding: raw\nNAMES\n";
    // Before layers had numbers: a component for each segment.
    let names =
        "Segment0_ID:=Segment_1\nSegment0_Name:=liver\nSegment1_ID:=Segment_2\nSegment1_Name:=tumour\n";
    std::fs::write(&path, [header.replace("NAMES\n", names).as_bytes(), b"\n", &[1, 0, 0, 1, 0, 7]].concat())
        .unwrap();
    let image = read_image(&path).unwrap();
    assert_eq!(image.label_map().unwrap().labels, [1, 2, 0]);
    assert!(image.notes[0].contains("1 numbers that no segment has"), "{:?}", image.notes);
    // A series of images.
    std::fs::write(&path, [header.replace("NAMES\n", "").as_bytes(), b"\n", &[1, 0, 0, 1, 0, 7]].concat())
        .unwrap();
    let error = read_image(&path).unwrap_err().to_string();
    assert!(error.contains("sizes (line 5)") && error.contains("one volume a file"), "{error}");
}

// ---- MetaImage ---------------------------------------------------------------------------------------

const META: &str = "ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = True
CompressedData = False
TransformMatrix = 0 1 0 -1 0 0 0 0 1
Offset = 10 20 30
CenterOfRotation = 0 0 0
ElementSpacing = 2 3 4
DimSize = 2 3 1
ElementType = MET_SHORT
ElementDataFile = LOCAL
";

#[test]
fn metaimage_is_read_attached_detached_packed_and_as_text() {
    let folder = tempfile::tempdir().unwrap();
    let (data, expected) = six_shorts();
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, &data).unwrap();
    let packed = encoder.finish().unwrap();
    std::fs::write(folder.path().join("a.raw"), [b"head".as_slice(), &data].concat()).unwrap();
    let packed_header = META.replace("CompressedData = False", "CompressedData = True");
    let text_header = META.replace("BinaryData = True", "BinaryData = False");
    let skipped = META.replace("ElementDataFile = LOCAL", "HeaderSize = 4\nElementDataFile = a.raw");
    let from_end = META.replace("ElementDataFile = LOCAL", "HeaderSize = -1\nElementDataFile = a.raw");
    let windows = META.replace('\n', "\r\n");
    for (header, bytes) in [
        (META, data.as_slice()),
        (&packed_header, &packed),
        (&text_header, b"-2 -1 0 1 2 300"),
        (&skipped, b""),
        (&from_end, b""),
        (&windows, &data),
    ] {
        let path = folder.path().join("a.mha");
        std::fs::write(&path, [header.as_bytes(), bytes].concat()).unwrap();
        let volume = read_volume(&path).unwrap();
        assert_eq!(volume.values, expected, "{header}");
        // The rows of the matrix are the directions of the voxel axes.
        assert_eq!(volume.grid.axes, DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z));
        assert!((volume.grid.origin_m - DVec3::new(0.01, 0.02, 0.03)).length() < 1e-15);
        assert!((volume.grid.spacing_m - DVec3::new(2e-3, 3e-3, 4e-3)).length() < 1e-15);
    }
    let by_letters = META.replace("TransformMatrix = 0 1 0 -1 0 0 0 0 1", "AnatomicalOrientation = LPI");
    let path = folder.path().join("letters.mha");
    std::fs::write(&path, [by_letters.as_bytes(), &data].concat()).unwrap();
    let axes = read_volume(&path).unwrap().grid.axes;
    assert_eq!(axes, DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
}

#[test]
fn bad_metaimage_is_refused_with_line_found_and_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let (data, _) = six_shorts();
    let cases: &[(&str, &str, &[&str])] = &[
        ("NDims = 3", "NDims = 2", &["NDims (line 2)", "3 to 3"]),
        ("ObjectType = Image", "ObjectType = Tube", &["ObjectType (line 1)", "Image"]),
        ("DimSize = 2 3 1", "DimSize = 2 3", &["DimSize (line 10)", "3 numbers"]),
        ("DimSize = 2 3 1", "DimSize = 2 3 9", &["12 bytes found", "108 expected"]),
        ("DimSize = 2 3 1", "DimSize = 65536 65536 4096", &["12 bytes found"]),
        ("ElementSpacing = 2 3 4", "ElementSpacing = 2 -3 4", &["ElementSpacing (line 9)", "above 0"]),
        ("ElementSpacing = 2 3 4", "ElementSpacing = 2 3 nan", &["ElementSpacing (line 9)", "3 finite"]),
        ("ElementSpacing = 2 3 4", "ElementSpacing = 2 3 4000", &["4000 mm along axis 2"]),
        (
            "ElementType = MET_SHORT",
            "ElementType = MET_SHOT",
            &["ElementType", "did you mean \"MET_SHORT\"?"],
        ),
        ("TransformMatrix = 0 1 0 -1 0 0 0 0 1\n", "", &["which side is left", "TransformMatrix"]),
        ("TransformMatrix = 0 1 0 -1 0 0 0 0 1", "AnatomicalOrientation = ???", &["which side is left"]),
        ("TransformMatrix = 0 1 0 -1 0 0 0 0 1", "AnatomicalOrientation = RAX", &["R, L, A, P, I, S"]),
        ("-1 0 0 0 0 1", "-1 0 0 0 0 0", &["TransformMatrix (line 6)", "not zero"]),
        ("CompressedData = False", "CompressedData = True", &["damaged"]),
        ("ElementDataFile = LOCAL", "ElementDataFile = LIST", &["ElementDataFile", "join the slices"]),
        ("ElementDataFile = LOCAL", "ElementDataFile = /a.raw", &["ElementDataFile", "header's folder"]),
        ("ElementDataFile = LOCAL", "ElementDataFile = none.raw", &["none.raw", "cannot be read"]),
        ("ElementDataFile = LOCAL\n", "", &["line 12", "Key = value"]),
        ("NDims = 3", "NDims 3", &["line 2", "Key = value"]),
    ];
    for (number, (from, to, words)) in cases.iter().enumerate() {
        assert!(META.contains(from), "case {number}");
        let path = folder.path().join("bad.mha");
        // Data without an equals sign and a line end, which would be taken for lines of the header.
        std::fs::write(&path, [META.replacen(from, to, 1).as_bytes(), &data].concat()).unwrap();
        let message = read_volume(&path).unwrap_err().to_string();
        for word in *words {
            assert!(message.contains(word), "case {number}: `{word}` missing in: {message}");
        }
    }
}

// ---- INRIMAGE ----------------------------------------------------------------------------------------

const INR: &str = "#INRIMAGE-4#{\nXDIM=2\nYDIM=3\nZDIM=1\nVDIM=1\nTYPE=signed fixed\nPIXSIZE=16 bits\nSCALE=2**0\nCPU=sun\nVX=2\nVY=3\nVZ=4\n";

fn inr_bytes(header: &str, data: &[u8]) -> Vec<u8> {
    let mut text = header.to_owned();
    text.extend(std::iter::repeat_n('\n', 256 - 4 - text.len()));
    [(text + "##}\n").as_bytes(), data].concat()
}

#[test]
fn inrimage_is_read_with_a_note_about_its_sides() {
    let folder = tempfile::tempdir().unwrap();
    let (data, expected) = six_shorts();
    let plain = inr_bytes(INR, &data);
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, &plain).unwrap();
    let packed = encoder.finish().unwrap();
    let scaled = inr_bytes(&INR.replace("2**0", "2**-1"), &data);
    for (name, bytes, scale) in [("a.inr", &plain, 1.0), ("a.inr.gz", &packed, 1.0), ("b.inr", &scaled, 0.5)]
    {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let image = read_image(&path).unwrap();
        assert_eq!(image.volume().values, expected.map(|v| v * scale), "{name}");
        assert_eq!((image.grid.dims, image.grid.axes), ([2, 3, 1], DMat3::IDENTITY));
        assert!((image.grid.spacing_m - DVec3::new(2e-3, 3e-3, 4e-3)).length() < 1e-15);
        assert!(image.notes[0].contains("which side is left"));
    }
    let cases: &[(&str, &str, &[&str])] = &[
        ("XDIM=2", "XDIM=0", &["XDIM (line 2)", "1 to 65536"]),
        ("XDIM=2\n", "", &["XDIM", "missing"]),
        ("XDIM=2", "XDIM=3", &["268 bytes found", "274 expected"]),
        ("VDIM=1", "VDIM=3", &["VDIM", "1 to 1"]),
        ("TYPE=signed fixed", "TYPE=packed", &["TYPE (line 6)", "signed fixed"]),
        ("PIXSIZE=16 bits", "PIXSIZE=64 bits", &["PIXSIZE (line 7)", "8, 16 or 32 bits"]),
        ("CPU=sun", "CPU=vax", &["CPU (line 9)", "decm"]),
        ("VX=2", "VX=0", &["0 mm along axis 0"]),
        ("SCALE=2**0", "SCALE=10", &["SCALE (line 8)", "2**"]),
        ("#INRIMAGE-4#{", "#INRIMAGE-5#{", &["not an INRIMAGE"]),
    ];
    for (number, (from, to, words)) in cases.iter().enumerate() {
        let path = folder.path().join("bad.inr");
        std::fs::write(&path, inr_bytes(&INR.replacen(from, to, 1), &data)).unwrap();
        let message = read_volume(&path).unwrap_err().to_string();
        for word in words.iter().chain(&["bad.inr"]) {
            assert!(message.contains(word), "case {number}: `{word}` missing in: {message}");
        }
    }
}

// ---- Label tables of other programs ------------------------------------------------------------------

#[test]
fn the_label_table_of_totalsegmentator_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.nii");
    write_label_map(&path, &LabelMap { names: Vec::new(), colours: Vec::new(), ..named_map() }).unwrap();
    let plain = std::fs::read(&path).unwrap();
    let xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?> <CaretExtension>  <Date><![CDATA[2013-07-14T05:45:09]]></Date>\
        <VolumeInformation Index=\"0\">  <LabelTable><Label Key=\"1\" Red=\"0.2\" Green=\"0.4\" Blue=\"1\" Alpha=\"1\">\
        <![CDATA[liver]]></Label><Label Key=\"2\" Red=\"1\" Green=\"0\" Blue=\"0\" Alpha=\"1\"><![CDATA[spleen]]></Label>\
        </LabelTable></VolumeInformation></CaretExtension>";
    let size = (8 + xml.len()).next_multiple_of(16);
    let mut extension = vec![1, 0, 0, 0];
    extension.extend((size as i32).to_le_bytes());
    extension.extend(0i32.to_le_bytes());
    extension.extend(xml.as_bytes());
    extension.resize(4 + size, 0);
    let mut header = plain[..348].to_vec();
    header[108..112].copy_from_slice(&((348 + extension.len()) as f32).to_le_bytes());
    std::fs::write(&path, [&header, extension.as_slice(), &plain[352..]].concat()).unwrap();
    let map = read_label_map(&path).unwrap();
    assert_eq!(map.names, [(1, "liver".to_string()), (2, "spleen".to_string())]);
    assert_eq!(map.colours, [(1, [0.2, 0.4, 1.0]), (2, [1.0, 0.0, 0.0])]);
}

// ---- Damage ------------------------------------------------------------------------------------------

/// Good files to damage, by their names.
fn good_files() -> &'static [(String, Vec<u8>)] {
    static FILES: std::sync::OnceLock<Vec<(String, Vec<u8>)>> = std::sync::OnceLock::new();
    FILES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (data, _) = six_shorts();
        let mut files: Vec<(String, Vec<u8>)> = WRITTEN
            .iter()
            .map(|name| {
                let path = folder.path().join(name);
                write_label_map(&path, &named_map()).unwrap();
                (name.to_string(), std::fs::read(path).unwrap())
            })
            .collect();
        files.push(("raw.nrrd".into(), std::fs::read(nrrd_file(folder.path(), "raw", "", &data)).unwrap()));
        files.push((
            "hex.nrrd".into(),
            std::fs::read(nrrd_file(folder.path(), "hex", "", b"0102030405060708090a0b0c")).unwrap(),
        ));
        files.push((
            "text.nrrd".into(),
            std::fs::read(nrrd_file(folder.path(), "text", "", b"1 2 3 4 5 6")).unwrap(),
        ));
        files.push(("raw.mha".into(), [META.as_bytes(), &data].concat()));
        files.push(("raw.inr".into(), inr_bytes(INR, &data)));
        files
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1200, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        which in any::<prop::sample::Index>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        early in any::<bool>(),
        kept in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let (name, good) = &good_files()[which.index(good_files().len())];
        // Half the cases aim at the header.
        let reach = if early { 352 } else { usize::MAX };
        let bytes = damaged(good, changes, reach, cut.then_some(kept));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        for result in [read_volume(&path).map(|v| v.values.len() == v.grid.n_voxels()),
                       read_label_map(&path).map(|m| m.labels.len() == m.grid.n_voxels())] {
            match result {
                Ok(consistent) => prop_assert!(consistent),
                Err(error) => prop_assert!(error.to_string().contains(folder.path().to_str().unwrap())),
            }
        }
    }
}

// ---- Folders of masks --------------------------------------------------------------------------------

#[test]
fn a_folder_of_masks_is_one_label_map_named_after_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let mask = |voxels: &[usize]| {
        let grid = oblique_grid(false);
        let labels = (0..grid.n_voxels()).map(|v| u16::from(voxels.contains(&v))).collect();
        LabelMap { grid, labels, names: Vec::new(), colours: Vec::new() }
    };
    write_label_map(&folder.path().join("spleen.nii.gz"), &mask(&[5, 6])).unwrap();
    write_label_map(&folder.path().join("liver.nii.gz"), &mask(&[0, 1, 5])).unwrap();
    let image = read_image(folder.path()).unwrap();
    let map = image.label_map().unwrap();
    assert_eq!(map.names, [(1, "liver".to_string()), (2, "spleen".to_string())]);
    assert_eq!(map.labels[..7], [1, 1, 0, 0, 0, 2, 2]);
    assert!(image.notes.iter().any(|note| note.contains("overlap in 1 voxels")), "{:?}", image.notes);
    let mut several = mask(&[1]);
    several.labels[3] = 2;
    write_label_map(&folder.path().join("ct.nii.gz"), &several).unwrap();
    let error = read_image(folder.path()).unwrap_err().to_string();
    assert!(error.contains("`ct` holds several numbers"), "{error}");
    std::fs::remove_file(folder.path().join("ct.nii.gz")).unwrap();
    let mut moved = mask(&[1]);
    moved.grid.origin_m.x += 1e-3;
    write_label_map(&folder.path().join("stomach.nii.gz"), &moved).unwrap();
    let error = read_image(folder.path()).unwrap_err().to_string();
    assert!(error.contains("`stomach`") && error.contains("one grid"), "{error}");
}
