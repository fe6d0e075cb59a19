//! NIfTI-1 files, made byte by byte.

use std::io::Write;
use std::path::{Path, PathBuf};

use glisson_mesh::image::files::{ImageError, read_label_map, read_volume, write_label_map, write_volume};
use glisson_mesh::image::{LabelMap, Volume, VoxelGrid};
use glisson_mesh::math::{DMat3, DVec3, SeededRandom};

use crate::sample_images::{assert_same_place, oblique_grid, plain_grid};

/// A NIfTI-1 file made byte by byte, independent of the writer: (byte, value) fields over a good header.
struct RawFile {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl RawFile {
    /// 2 x 3 x 1 voxels of `datatype`, sform with 2 mm voxels along RAS, origin (10, 20, 30) mm.
    fn new(datatype: i16, n_bits: i16, data: &[u8], big_endian: bool) -> Self {
        let mut file = Self { bytes: vec![0; 352], big_endian };
        file.i32(0, 348);
        for (place, n) in [3, 2, 3, 1].into_iter().enumerate() {
            file.i16(40 + 2 * place, n);
        }
        file.i16(70, datatype);
        file.i16(72, n_bits);
        for axis in 0..4 {
            file.f32(76 + 4 * axis, if axis == 0 { 1.0 } else { 2.0 });
        }
        file.f32(108, 352.0);
        file.bytes[123] = 2;
        file.i16(254, 1);
        for row in 0..3 {
            file.f32(280 + 16 * row + 4 * row, 2.0);
            file.f32(292 + 16 * row, 10.0 * (row + 1) as f32);
        }
        file.bytes[344..348].copy_from_slice(b"n+1\0");
        file.bytes.extend(data);
        file
    }

    fn put<const N: usize>(&mut self, byte: usize, mut little_endian: [u8; N]) {
        if self.big_endian {
            little_endian.reverse();
        }
        self.bytes[byte..byte + N].copy_from_slice(&little_endian);
    }

    fn i16(&mut self, byte: usize, value: i16) {
        self.put(byte, value.to_le_bytes());
    }

    fn i32(&mut self, byte: usize, value: i32) {
        self.put(byte, value.to_le_bytes());
    }

    fn f32(&mut self, byte: usize, value: f32) {
        self.put(byte, value.to_le_bytes());
    }

    fn save(&self, folder: &Path) -> PathBuf {
        let path = folder.join("raw.nii");
        std::fs::write(&path, &self.bytes).unwrap();
        path
    }
}

fn six_floats() -> RawFile {
    let data: Vec<u8> = (0..6u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
    RawFile::new(16, 32, &data, false)
}

#[test]
fn volumes_come_back_with_values_and_place() {
    let folder = tempfile::tempdir().unwrap();
    for (name, step) in [("a.nii", 0.25), ("a.nii.gz", 0.25), ("b.nii", 7.0), ("b.NII.GZ", 7.0)] {
        for left_handed in [false, true] {
            let grid = oblique_grid(left_handed);
            let values = (0..grid.n_voxels()).map(|v| v as f32 * step - 100.0).collect();
            let volume = Volume { grid, values };
            let path = folder.path().join(name);
            write_volume(&path, &volume).unwrap();
            let back = read_volume(&path).unwrap();
            assert_eq!(back.values, volume.values, "{name}");
            assert_same_place(&back.grid, &volume.grid);
            assert!((back.grid.axes.determinant() - volume.grid.axes.determinant()).abs() < 1e-6);
        }
    }
}

#[test]
fn written_sform_and_qform_say_the_same() {
    let folder = tempfile::tempdir().unwrap();
    // Four turns about z, so that the quaternion's real part takes both signs.
    for (quarter_turns, left_handed) in (0..4).flat_map(|n| [(n, false), (n, true)]) {
        let turn = DMat3::from_rotation_z(f64::from(quarter_turns) * std::f64::consts::FRAC_PI_2);
        let oblique = oblique_grid(left_handed);
        let grid = VoxelGrid { axes: turn * oblique.axes, ..oblique };
        let volume = Volume { values: vec![0.5; grid.n_voxels()], grid };
        let path = folder.path().join("a.nii");
        write_volume(&path, &volume).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[254..256].fill(0);
        std::fs::write(&path, bytes).unwrap();
        assert_same_place(&read_volume(&path).unwrap().grid, &volume.grid);
    }
}

#[test]
fn label_maps_come_back_with_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let grid = oblique_grid(false);
    let labels = (0..grid.n_voxels()).map(|v| (v * 1100) as u16).collect();
    let names = vec![(1, "liver".to_string()), (1100, "gall bladder \"é\"".to_string())];
    let map = LabelMap { grid, labels, names, colours: Vec::new() };
    for name in ["a.nii", "a.nii.gz"] {
        let path = folder.path().join(name);
        write_label_map(&path, &map).unwrap();
        let back = read_label_map(&path).unwrap();
        assert_eq!((&back.labels, &back.names), (&map.labels, &map.names));
        assert_same_place(&back.grid, &map.grid);
    }
    let n_plain = std::fs::metadata(folder.path().join("a.nii")).unwrap().len();
    assert_eq!(n_plain % 16, 120 % 16, "the extension keeps the data on 16 bytes after byte 352");
}

#[test]
fn every_number_type_is_read_in_both_byte_orders() {
    let folder = tempfile::tempdir().unwrap();
    macro_rules! check {
        ($number:ty, $code:expr, $values:expr) => {
            for big_endian in [false, true] {
                let values: [$number; 6] = $values;
                let to_bytes = |v: &$number| if big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
                let data: Vec<u8> = values.iter().flat_map(to_bytes).collect();
                let n_bits = 8 * size_of::<$number>() as i16;
                let mut file = RawFile::new($code, n_bits, &data, big_endian);
                let plain = read_volume(&file.save(folder.path())).unwrap();
                let expected: Vec<f32> = values.iter().map(|&v| v as f32).collect();
                assert_eq!(plain.values, expected, "datatype {}, big endian {big_endian}", $code);
                // LPS: x and y change sign.
                assert_eq!(plain.grid.origin_m * 1e3, DVec3::new(-10.0, -20.0, 30.0));
                assert_eq!(plain.grid.axes, DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
                assert_eq!(plain.grid.spacing_m, DVec3::splat(2e-3));
                file.f32(112, 2.0);
                file.f32(116, -3.0);
                let scaled = read_volume(&file.save(folder.path())).unwrap();
                let expected: Vec<f32> = values.iter().map(|&v| (v as f64 * 2.0 - 3.0) as f32).collect();
                assert_eq!(scaled.values, expected);
            }
        };
    }
    check!(u8, 2, [0, 1, 2, 3, 254, 255]);
    check!(i8, 256, [-128, -1, 0, 1, 2, 127]);
    check!(i16, 4, [-32768, -1, 0, 1, 2, 32767]);
    check!(u16, 512, [0, 1, 2, 3, 4, 65535]);
    check!(i32, 8, [-70000, -1, 0, 1, 2, 70000]);
    check!(u32, 768, [0, 1, 2, 3, 4, 70000]);
    check!(f32, 16, [-1.5, 0.0, 0.25, 1.0, 2.0, 1e9]);
    check!(f64, 64, [-1.5, 0.0, 0.25, 1.0, 2.0, 1e9]);
}

#[test]
fn units_of_length_are_honoured() {
    let folder = tempfile::tempdir().unwrap();
    for (code, unit_m) in [(0, 1e-3), (1, 1.0), (2, 1e-3), (3, 1e-6), (10, 1e-3)] {
        let mut file = six_floats();
        file.bytes[123] = code;
        for axis in 0..3 {
            file.f32(80 + 4 * axis, (2e-3 / unit_m) as f32);
            file.f32(280 + 20 * axis, (2e-3 / unit_m) as f32);
            file.f32(292 + 16 * axis, (0.01 * (axis + 1) as f64 / unit_m) as f32);
        }
        let grid = read_volume(&file.save(folder.path())).unwrap().grid;
        assert!((grid.spacing_m - DVec3::splat(2e-3)).length() < 1e-9, "code {code}");
        assert!((grid.origin_m - DVec3::new(-0.01, -0.02, 0.03)).length() < 1e-8, "code {code}");
    }
    // Metres for millimetres.
    let mut file = six_floats();
    file.bytes[123] = 1;
    let error = read_volume(&file.save(folder.path())).unwrap_err().to_string();
    assert!(error.contains("voxels of 2000 mm along axis 0"), "{error}");
}

#[test]
fn qform_alone_places_the_volume() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = six_floats();
    file.i16(254, 0);
    file.i16(252, 1);
    // A quarter turn about z: i points to RAS +y, j to -x. With qfac -1 k points to -z.
    let half_root = std::f32::consts::FRAC_1_SQRT_2;
    file.f32(76, -1.0);
    file.f32(264, half_root);
    file.f32(268, 10.0);
    let grid = read_volume(&file.save(folder.path())).unwrap().grid;
    let step_mm = |voxel: DVec3| (grid.position_m(voxel) - grid.origin_m) * 1e3;
    for (voxel, expected) in [(DVec3::X, -DVec3::Y), (DVec3::Y, DVec3::X), (DVec3::Z, -DVec3::Z)] {
        assert!((step_mm(voxel) - 2.0 * expected).length() < 1e-5, "{voxel} goes {}", step_mm(voxel));
    }
    assert!((grid.origin_m * 1e3 - DVec3::new(-10.0, 0.0, 0.0)).length() < 1e-9);
}

/// The message for a file with one thing changed.
fn message_after(change: impl FnOnce(&mut RawFile)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut file = six_floats();
    change(&mut file);
    read_volume(&file.save(folder.path())).unwrap_err().to_string()
}

#[test]
fn bad_headers_are_refused_with_place_found_and_allowed() {
    type Change = Box<dyn FnOnce(&mut RawFile)>;
    let cases: Vec<(Change, &[&str])> = vec![
        (Box::new(|f| f.i32(0, 7)), &["sizeof_hdr", "is 7", "348"]),
        (Box::new(|f| f.i32(0, 540)), &["NIfTI-2", "convert"]),
        (Box::new(|f| f.bytes[345] = b'i'), &["magic", "byte 344"]),
        (Box::new(|f| f.i16(40, 2)), &["dim[0]", "is 2", "3 to 7"]),
        (Box::new(|f| f.i16(40, 99)), &["dim[0]", "is 99"]),
        (Box::new(|f| f.i16(44, 0)), &["dim[2]", "byte 44", "is 0", "1 to 32767"]),
        (Box::new(|f| f.i16(44, -5)), &["dim[2]", "is -5"]),
        (
            Box::new(|f| {
                f.i16(40, 4);
                f.i16(48, 12);
            }),
            &["dim[4]", "is 12", "split"],
        ),
        (Box::new(|f| f.i16(44, 4)), &["376 bytes found", "384 expected", "[2, 4, 1]"]),
        (Box::new(|f| f.i16(44, 2)), &["376 bytes found", "368 expected"]),
        (Box::new(|f| f.bytes.truncate(370)), &["370 bytes found", "376 expected"]),
        (Box::new(|f| f.bytes.truncate(100)), &["100 bytes long", "at least 348"]),
        (Box::new(|f| f.bytes.clear()), &["0 bytes long"]),
        (Box::new(|f| f.i16(70, 128)), &["datatype", "is 128", "16 float32"]),
        (Box::new(|f| f.i16(72, 16)), &["bitpix", "is 16", "32 for datatype 16"]),
        (Box::new(|f| f.f32(84, f32::NAN)), &["pixdim[2]", "byte 84", "NaN", "above 0"]),
        (Box::new(|f| f.f32(80, 0.0)), &["pixdim[1]", "is 0"]),
        (Box::new(|f| f.f32(88, -2.0)), &["pixdim[3]", "is -2"]),
        (Box::new(|f| f.f32(88, 3.0)), &["pixdim[3]", "is 3", "2 +- 1 %"]),
        (Box::new(|f| f.f32(108, 100.0)), &["vox_offset", "is 100", "352"]),
        (Box::new(|f| f.f32(108, f32::NAN)), &["vox_offset", "NaN"]),
        (Box::new(|f| f.f32(112, f32::INFINITY)), &["scl_slope", "inf"]),
        (Box::new(|f| f.bytes[123] = 5), &["xyzt_units", "is 5"]),
        (Box::new(|f| f.i16(254, 0)), &["sform_code", "which side is left"]),
        (Box::new(|f| f.f32(284, 0.2)), &["[0, 1]", "degrees", "resample"]),
        (Box::new(|f| f.f32(292, f32::NAN)), &["srow_x", "not finite"]),
    ];
    for (number, (change, words)) in cases.into_iter().enumerate() {
        let message = message_after(change);
        for word in words.iter().chain(&["raw.nii"]) {
            assert!(message.contains(word), "case {number}: `{word}` missing in: {message}");
        }
    }
}

#[test]
fn a_truncated_gzip_is_named_with_its_byte_counts() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ct.nii.gz");
    let grid = plain_grid([20, 20, 20], [1.0; 3]);
    let mut random = SeededRandom::new(1);
    let values = (0..grid.n_voxels()).map(|_| random.uniform() as f32).collect();
    write_volume(&path, &Volume { grid, values }).unwrap();
    let whole = std::fs::read(&path).unwrap();
    // So short that the header's promise cannot be true, it is still called truncated.
    for n_kept in [400, whole.len() - 1, whole.len() - 9, whole.len() / 2, 30] {
        std::fs::write(&path, &whole[..n_kept]).unwrap();
        let error = read_volume(&path).unwrap_err();
        assert!(matches!(error, ImageError::Gzip { .. }), "{n_kept}: {error}");
        assert!(error.to_string().contains("ct.nii.gz: damaged or truncated gzip"), "{error}");
    }
    // A byte of the checksum at the end.
    let mut damaged = whole.clone();
    let at = damaged.len() - 6;
    damaged[at] ^= 1;
    std::fs::write(&path, &damaged).unwrap();
    assert!(matches!(read_volume(&path), Err(ImageError::Gzip { .. })));
}

#[test]
fn a_header_that_promises_too_much_is_refused_before_memory_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = six_floats();
    for byte in [42, 44, 46] {
        file.i16(byte, 32767);
    }
    let plain = file.save(folder.path());
    assert!(matches!(read_volume(&plain), Err(ImageError::SizeMismatch { .. })));
    let zipped = folder.path().join("huge.nii.gz");
    let mut encoder =
        flate2::write::GzEncoder::new(std::fs::File::create(&zipped).unwrap(), flate2::Compression::fast());
    encoder.write_all(&file.bytes).unwrap();
    encoder.finish().unwrap();
    let error = read_volume(&zipped).unwrap_err();
    assert!(
        matches!(error, ImageError::SizeMismatch { expected, found: 376, .. } if expected > 1 << 46),
        "{error}"
    );
}

#[test]
fn fractions_and_negative_numbers_are_no_labels() {
    let folder = tempfile::tempdir().unwrap();
    for value in [0.5f32, -1.0, 70000.0, f32::NAN] {
        let mut file = six_floats();
        file.f32(352 + 4 * 3, value);
        let error = read_label_map(&file.save(folder.path())).unwrap_err();
        assert!(matches!(error, ImageError::NotALabel { voxel: [1, 1, 0], .. }), "{error}");
    }
    assert_eq!(read_label_map(&six_floats().save(folder.path())).unwrap().labels, [0, 1, 2, 3, 4, 5]);
}
