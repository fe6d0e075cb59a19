//! Folders of pictures, one a slice.

use std::fs;
use std::path::{Path, PathBuf};

use glisson_mesh::image::files::{
    RawSlices, SliceChannel, SliceOptions, read_image, read_slices, read_volume, write_volume,
};
use glisson_mesh::math::{DMat3, DVec3};
use proptest::prelude::*;
use tiff::encoder::{TiffEncoder, colortype};

use super::sample_images::{assert_same_place, damaged};

const COLUMNS: usize = 5;
const ROWS: usize = 4;

const PLAIN: SliceOptions = SliceOptions {
    spacing_mm: [0.33, 0.5, 1.0],
    channel: SliceChannel::Luminance,
    raw: None,
    head_first: false,
};

/// Bytes of slice `k`, one for each number of a pixel.
fn bytes_of(k: usize, n_samples: usize) -> Vec<u8> {
    (0..COLUMNS * ROWS * n_samples).map(|n| (31 * k + 7 * n + n / 9) as u8).collect()
}

fn png_of(path: &Path, size: [usize; 2], colours: png::ColorType, depth: png::BitDepth, bytes: &[u8]) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), size[0] as u32, size[1] as u32);
    encoder.set_color(colours);
    encoder.set_depth(depth);
    if colours == png::ColorType::Indexed {
        encoder.set_palette((0..=255u8).flat_map(|n| [n, n / 2, 255 - n]).collect::<Vec<_>>());
    }
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
}

/// Slices 8 to 11, whose names say nothing where they are not sorted as numbers.
fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    (0..4).map(|k| folder.join(format!("scan2_vm{}.{extension}", 8 + k))).collect()
}

fn rgb_pngs(folder: &Path) -> Vec<PathBuf> {
    let files = files(folder, "png");
    for (k, file) in files.iter().enumerate() {
        png_of(file, [COLUMNS, ROWS], png::ColorType::Rgb, png::BitDepth::Eight, &bytes_of(k, 3));
    }
    files
}

fn luma(pixel: &[u8]) -> f32 {
    let [red, green, blue] = [pixel[0], pixel[1], pixel[2]].map(f64::from);
    (0.299 * red + 0.587 * green + 0.114 * blue).round() as f32
}

#[test]
fn coloured_slices_become_a_grey_volume_in_the_order_of_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    rgb_pngs(folder.path());
    fs::write(folder.path().join("README.txt"), "4 slices").unwrap();
    for (channel, of_pixel) in [
        (SliceChannel::Luminance, luma as fn(&[u8]) -> f32),
        (SliceChannel::Red, |pixel| f32::from(pixel[0])),
        (SliceChannel::Green, |pixel| f32::from(pixel[1])),
        (SliceChannel::Blue, |pixel| f32::from(pixel[2])),
    ] {
        let image = read_slices(folder.path(), &SliceOptions { channel, ..PLAIN }).unwrap();
        assert_eq!(image.grid.dims, [COLUMNS, ROWS, 4]);
        assert!((image.grid.spacing_m - DVec3::new(0.33e-3, 0.5e-3, 1e-3)).length() < 1e-15);
        assert_eq!((image.grid.axes, image.grid.origin_m), (DMat3::IDENTITY, DVec3::ZERO));
        let expected: Vec<f32> =
            (0..4).flat_map(|k| bytes_of(k, 3).chunks(3).map(of_pixel).collect::<Vec<_>>()).collect();
        assert_eq!(image.volume().values, expected, "{channel:?}");
        assert!(image.notes[0].contains("do not say which side is left"), "{:?}", image.notes);
        assert!(image.notes[0].contains("slices to the head"), "{:?}", image.notes);
    }
    let image = read_slices(folder.path(), &SliceOptions { head_first: true, ..PLAIN }).unwrap();
    assert_eq!(image.grid.axes.col(2), -DVec3::Z);
    assert!(image.notes[0].contains("slices to the feet"), "{:?}", image.notes);
    // And on from there in a format that says where things are.
    let path = folder.path().join("body.nii.gz");
    write_volume(&path, &image.volume()).unwrap();
    let again = read_volume(&path).unwrap();
    assert_eq!(again.values, image.volume().values);
    assert_same_place(&again.grid, &image.grid);
}

#[test]
fn every_kind_of_picture_is_read() {
    let greys = |k: usize| bytes_of(k, 1).into_iter().map(f32::from).collect::<Vec<_>>();
    let words = |k: usize| (0..COLUMNS * ROWS).map(|n| (3000 * k + 257 * n) as u16).collect::<Vec<_>>();
    let wide = |k: usize| words(k).into_iter().map(f32::from).collect::<Vec<_>>();
    let lumas = |k: usize| bytes_of(k, 3).chunks(3).map(luma).collect::<Vec<_>>();
    let big_endian = |k: usize| words(k).into_iter().flat_map(u16::to_be_bytes).collect::<Vec<_>>();
    let size = [COLUMNS, ROWS];
    let save_png =
        move |colours, depth, bytes: Vec<u8>, file: &Path| png_of(file, size, colours, depth, &bytes);
    type Save<'a> = Box<dyn Fn(usize, &Path) + 'a>;
    type Expected<'a> = Box<dyn Fn(usize) -> Vec<f32> + 'a>;
    fn tiff<C: colortype::ColorType>(file: &Path, numbers: &[C::Inner])
    where
        [C::Inner]: tiff::encoder::TiffValue,
    {
        let mut encoder = TiffEncoder::new(fs::File::create(file).unwrap()).unwrap();
        encoder.write_image::<C>(COLUMNS as u32, ROWS as u32, numbers).unwrap();
    }
    let eight = png::BitDepth::Eight;
    let raw = Some(RawSlices { size, in_planes: false });
    let cases: Vec<(&str, &str, Option<RawSlices>, Save<'_>, Expected<'_>)> = vec![
        (
            "grey PNG",
            "png",
            None,
            Box::new(|k, file| save_png(png::ColorType::Grayscale, eight, bytes_of(k, 1), file)),
            Box::new(greys),
        ),
        (
            "16-bit PNG",
            "PNG",
            None,
            Box::new(|k, file| {
                save_png(png::ColorType::Grayscale, png::BitDepth::Sixteen, big_endian(k), file);
            }),
            Box::new(wide),
        ),
        (
            "1-bit PNG",
            "png",
            None,
            Box::new(|k, file| {
                save_png(
                    png::ColorType::Grayscale,
                    png::BitDepth::One,
                    vec![(k as u8) << 6 | 0b0010_1000; 4],
                    file,
                );
            }),
            Box::new(|k| {
                let row =
                    [k & 2 != 0, k & 1 != 0, true, false, true].map(|bit| if bit { 255.0 } else { 0.0 });
                row.repeat(ROWS)
            }),
        ),
        (
            "palette PNG",
            "png",
            None,
            Box::new(|k, file| save_png(png::ColorType::Indexed, eight, bytes_of(k, 1), file)),
            Box::new(|k| bytes_of(k, 1).into_iter().map(|n| luma(&[n, n / 2, 255 - n])).collect()),
        ),
        (
            "PNG with opacity",
            "png",
            None,
            Box::new(|k, file| save_png(png::ColorType::Rgba, eight, bytes_of(k, 4), file)),
            Box::new(|k| bytes_of(k, 4).chunks(4).map(luma).collect()),
        ),
        (
            "grey TIFF",
            "tif",
            None,
            Box::new(|k, file| tiff::<colortype::Gray8>(file, &bytes_of(k, 1))),
            Box::new(greys),
        ),
        (
            "16-bit TIFF",
            "tiff",
            None,
            Box::new(|k, file| tiff::<colortype::Gray16>(file, &words(k))),
            Box::new(wide),
        ),
        (
            "RGB TIFF",
            "TIF",
            None,
            Box::new(|k, file| tiff::<colortype::RGB8>(file, &bytes_of(k, 3))),
            Box::new(lumas),
        ),
        (
            "LZW TIFF",
            "tif",
            None,
            Box::new(|k, file| {
                let encoder = TiffEncoder::new(fs::File::create(file).unwrap()).unwrap();
                let mut encoder = encoder.with_compression(tiff::encoder::Compression::Lzw);
                let image = encoder.new_image::<colortype::RGB8>(COLUMNS as u32, ROWS as u32).unwrap();
                image.write_data(&bytes_of(k, 3)).unwrap();
            }),
            Box::new(lumas),
        ),
        (
            "grey bytes",
            "raw",
            raw,
            Box::new(|k, file| fs::write(file, bytes_of(k, 1)).unwrap()),
            Box::new(greys),
        ),
        (
            "RGB bytes",
            "rgb",
            raw,
            Box::new(|k, file| fs::write(file, bytes_of(k, 3)).unwrap()),
            Box::new(lumas),
        ),
        (
            "RGB bytes in planes",
            "raw",
            Some(RawSlices { size, in_planes: true }),
            Box::new(|k, file| {
                let bytes = bytes_of(k, 3);
                let planes =
                    (0..3).flat_map(|colour| bytes[colour..].iter().copied().step_by(3).collect::<Vec<_>>());
                fs::write(file, planes.collect::<Vec<_>>()).unwrap();
            }),
            Box::new(lumas),
        ),
    ];
    for (name, extension, raw, save, expected) in cases {
        let folder = tempfile::tempdir().unwrap();
        for (k, file) in files(folder.path(), extension).iter().enumerate() {
            save(k, file);
        }
        let image = read_slices(folder.path(), &SliceOptions { raw, ..PLAIN })
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        let values: Vec<f32> = (0..4).flat_map(expected).collect();
        assert_eq!(image.volume().values, values, "{name}");
        let has_note = image.notes.iter().any(|note| note.contains("opacity of pixels was passed over"));
        assert_eq!(has_note, name == "PNG with opacity", "{name}: {:?}", image.notes);
    }
}

#[test]
fn pictures_without_distances_are_refused_with_what_to_write() {
    let folder = tempfile::tempdir().unwrap();
    rgb_pngs(folder.path());
    let message = read_image(folder.path()).unwrap_err().to_string();
    for words in
        ["4 picture(s) of slices", "scan2_vm10.png", "--spacing-mm X,Y,Z", "columns, rows and slices in mm"]
    {
        assert!(message.contains(words), "`{words}` missing in: {message}");
    }
    assert!(!message.contains("--size"), "{message}");
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("1.raw"), [0; 10]).unwrap();
    let message = read_image(folder.path()).unwrap_err().to_string();
    assert!(message.contains("--size COLUMNS,ROWS"), "{message}");
}

#[test]
fn what_is_no_stack_is_refused_with_its_place() {
    type Change = fn(&Path, &[PathBuf]);
    let cases: &[(&str, Change, SliceOptions, &[&str])] = &[
        (
            "missing",
            |_, files| fs::remove_file(&files[2]).unwrap(),
            PLAIN,
            &["slices missing between scan2_vm9.png and scan2_vm11.png", "none of 10 to 10"],
        ),
        (
            "twice",
            |folder, files| {
                fs::copy(&files[2], folder.join("other10.png")).unwrap();
            },
            PLAIN,
            &["two slices with the number 10", "other10.png", "scan2_vm10.png"],
        ),
        (
            "no number",
            |folder, files| {
                fs::copy(&files[2], folder.join("preview.png")).unwrap();
            },
            PLAIN,
            &["no number in the name of preview.png"],
        ),
        (
            "another size",
            |_, files| {
                png_of(&files[3], [2, 4], png::ColorType::Rgb, png::BitDepth::Eight, &bytes_of(0, 3)[..24]);
            },
            PLAIN,
            &["scan2_vm8.png has 5 x 4 pixels, in colour, 8 bits", "scan2_vm11.png has 2 x 4 pixels"],
        ),
        (
            "grey among colours",
            |_, files| {
                png_of(
                    &files[3],
                    [COLUMNS, ROWS],
                    png::ColorType::Grayscale,
                    png::BitDepth::Eight,
                    &bytes_of(0, 1),
                );
            },
            PLAIN,
            &["scan2_vm11.png has 5 x 4 pixels, grey"],
        ),
        (
            "two kinds",
            |folder, _| fs::write(folder.join("12.tif"), "II").unwrap(),
            PLAIN,
            &["two kinds (12.tif and scan2_vm10.png)"],
        ),
        (
            "channel of grey",
            |_, files| {
                for file in files {
                    png_of(
                        file,
                        [COLUMNS, ROWS],
                        png::ColorType::Grayscale,
                        png::BitDepth::Eight,
                        &bytes_of(0, 1),
                    );
                }
            },
            SliceOptions { channel: SliceChannel::Red, ..PLAIN },
            &["grey slices", "leave --channel out"],
        ),
        (
            "spacing",
            |_, _| {},
            SliceOptions { spacing_mm: [0.33, 0.0, 1.0], ..PLAIN },
            &["voxels of 0 mm along axis 1"],
        ),
        (
            "not a number",
            |_, _| {},
            SliceOptions { spacing_mm: [0.33, 0.5, f64::NAN], ..PLAIN },
            &["voxels of NaN mm along axis 2"],
        ),
        (
            "size of PNG",
            |_, _| {},
            SliceOptions { raw: Some(RawSlices { size: [5, 4], in_planes: false }), ..PLAIN },
            &["leave --size out"],
        ),
        (
            "nothing",
            |_, files| files.iter().for_each(|file| fs::remove_file(file).unwrap()),
            PLAIN,
            &["no pictures of slices in it", ".png", ".raw"],
        ),
        (
            "cut",
            |_, files| {
                let bytes = fs::read(&files[1]).unwrap();
                fs::write(&files[1], &bytes[..bytes.len() - 30]).unwrap();
            },
            PLAIN,
            &["scan2_vm9.png: damaged"],
        ),
    ];
    for (name, change, options, words) in cases {
        let folder = tempfile::tempdir().unwrap();
        let files = rgb_pngs(folder.path());
        change(folder.path(), &files);
        let message = read_slices(folder.path(), options).unwrap_err().to_string();
        for word in *words {
            assert!(message.contains(word), "{name}: `{word}` missing in: {message}");
        }
    }
}

#[test]
fn slices_without_a_header_have_the_size_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    for (k, file) in files(folder.path(), "raw").iter().enumerate() {
        fs::write(file, bytes_of(k, 3)).unwrap();
    }
    let message = |raw| read_slices(folder.path(), &SliceOptions { raw, ..PLAIN }).unwrap_err().to_string();
    assert!(message(None).contains("--size COLUMNS,ROWS"));
    let with = |size| message(Some(RawSlices { size, in_planes: false }));
    assert!(with([COLUMNS, ROWS + 1]).contains("60 bytes, allowed for slices of 5 x 5 pixels: 75"));
    assert!(with([0, ROWS]).contains("0 x 4 pixels, 1 to 65535 allowed"));
    assert!(with([usize::MAX, usize::MAX]).contains("1 to 65535 allowed"));
}

#[test]
fn planes_of_grey_slices_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (k, file) in files(folder.path(), "raw").iter().enumerate() {
        fs::write(file, bytes_of(k, 1)).unwrap();
    }
    let raw = Some(RawSlices { size: [COLUMNS, ROWS], in_planes: true });
    let message = read_slices(folder.path(), &SliceOptions { raw, ..PLAIN }).unwrap_err().to_string();
    assert!(message.contains("grey slices") && message.contains("leave --planes out"), "{message}");
}

#[test]
fn pictures_that_are_to_be_turned_are_refused() {
    for (orientation, is_refused) in [(None, false), (Some(1u16), false), (Some(3), true), (Some(6), true)] {
        let folder = tempfile::tempdir().unwrap();
        let file = fs::File::create(folder.path().join("1.tif")).unwrap();
        let mut encoder = TiffEncoder::new(file).unwrap();
        let mut image = encoder.new_image::<colortype::Gray8>(COLUMNS as u32, ROWS as u32).unwrap();
        if let Some(orientation) = orientation {
            image.encoder().write_tag(tiff::tags::Tag::Orientation, orientation).unwrap();
        }
        image.write_data(&bytes_of(0, 1)).unwrap();
        match read_slices(folder.path(), &PLAIN) {
            Ok(_) => assert!(!is_refused, "{orientation:?}"),
            Err(error) => {
                let message = error.to_string();
                assert!(
                    is_refused && message.contains("1.tif") && message.contains("Orientation"),
                    "{message}"
                );
                assert!(message.contains("-auto-orient"), "{message}");
            }
        }
    }
}

#[test]
fn opacity_of_one_colour_is_counted_with_what_a_file_can_hold() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("1.png");
    let mut encoder = png::Encoder::new(fs::File::create(&path).unwrap(), 4096, 4096);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_compression(png::Compression::High);
    encoder.set_trns(vec![0u8, 0]);
    encoder.write_header().unwrap().write_image_data(&vec![0; 4096 * 4096]).unwrap();
    // As small as it can be, so that its numbers with opacity are more than a deflate stream can make.
    assert!(2 * 4096 * 4096 > 1032 * fs::metadata(&path).unwrap().len());
    let image = read_slices(folder.path(), &PLAIN).unwrap();
    assert_eq!(image.grid.dims, [4096, 4096, 1]);
}

#[test]
fn more_slices_than_there_may_be_take_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    for n in 0..3 {
        // Nothing of it is on the disk.
        let file = fs::File::create(folder.path().join(format!("{n}.raw"))).unwrap();
        file.set_len(65_535 * 65_535).unwrap();
    }
    let raw = Some(RawSlices { size: [65_535; 2], in_planes: false });
    let mut message = String::new();
    let info = allocation_counter::measure(|| {
        message = read_slices(folder.path(), &SliceOptions { raw, ..PLAIN }).unwrap_err().to_string();
    });
    assert!(
        message.contains("3 slices of 65535 x 65535 pixels") && message.contains("8589934592"),
        "{message}"
    );
    assert!(info.bytes_max < 1 << 21, "{} bytes", info.bytes_max);
}

/// A PNG's header with another width and height, and its checksum.
fn with_size(bytes: &mut [u8], size: [u32; 2]) {
    bytes[16..20].copy_from_slice(&size[0].to_be_bytes());
    bytes[20..24].copy_from_slice(&size[1].to_be_bytes());
    let mut crc = flate2::Crc::new();
    crc.update(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&crc.sum().to_be_bytes());
}

#[test]
fn promises_that_a_file_cannot_keep_take_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("1.png");
    png_of(&path, [COLUMNS, ROWS], png::ColorType::Rgb, png::BitDepth::Eight, &bytes_of(0, 3));
    let mut bytes = fs::read(&path).unwrap();
    let tiff_folder = tempfile::tempdir().unwrap();
    let tiff_path = tiff_folder.path().join("1.tif");
    let mut encoder = TiffEncoder::new(fs::File::create(&tiff_path).unwrap()).unwrap();
    encoder.write_image::<colortype::Gray8>(COLUMNS as u32, ROWS as u32, &bytes_of(0, 1)).unwrap();
    for size in [[60_000, 60_000], [70_000, 1]] {
        with_size(&mut bytes, size);
        fs::write(&path, &bytes).unwrap();
        let mut message = String::new();
        let info = allocation_counter::measure(|| {
            message = read_slices(folder.path(), &PLAIN).unwrap_err().to_string();
        });
        assert!(message.contains("cannot be in") || message.contains("1 to 65535 allowed"), "{message}");
        assert!(info.bytes_max < 1 << 21, "{} bytes for {size:?}", info.bytes_max);
        // The same of a TIFF: entries of its directory for width and height.
        let mut bytes = fs::read(&tiff_path).unwrap();
        for (tag, value) in [(256u16, size[0]), (257, size[1])] {
            let entry = [tag.to_le_bytes(), 4u16.to_le_bytes()].concat();
            let at = bytes.windows(4).position(|window| window == entry).unwrap();
            bytes[at + 8..at + 12].copy_from_slice(&value.to_le_bytes());
        }
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("1.tif"), &bytes).unwrap();
        let info = allocation_counter::measure(|| {
            message = read_slices(folder.path(), &PLAIN).unwrap_err().to_string();
        });
        assert!(message.contains("1.tif"), "{message}");
        assert!(info.bytes_max < 1 << 21, "{} bytes for {size:?}", info.bytes_max);
    }
}

/// Files to damage.
fn good_files() -> &'static [(&'static str, Vec<u8>); 3] {
    static FILES: std::sync::OnceLock<[(&str, Vec<u8>); 3]> = std::sync::OnceLock::new();
    FILES.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let [png, plain, packed] = ["1.png", "1.tif", "2.tif"].map(|name| folder.path().join(name));
        png_of(&png, [COLUMNS, ROWS], png::ColorType::Rgb, png::BitDepth::Eight, &bytes_of(0, 3));
        let mut encoder = TiffEncoder::new(fs::File::create(&plain).unwrap()).unwrap();
        encoder.write_image::<colortype::RGB8>(COLUMNS as u32, ROWS as u32, &bytes_of(0, 3)).unwrap();
        let encoder = TiffEncoder::new(fs::File::create(&packed).unwrap()).unwrap();
        let mut encoder = encoder.with_compression(tiff::encoder::Compression::Lzw);
        encoder
            .write_image::<colortype::Gray16>(COLUMNS as u32, ROWS as u32, &[300; COLUMNS * ROWS])
            .unwrap();
        [
            ("1.png", fs::read(png).unwrap()),
            ("1.tif", fs::read(plain).unwrap()),
            ("1.tif", fs::read(packed).unwrap()),
        ]
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, ..ProptestConfig::default() })]

    #[test]
    fn damaged_pictures_never_panic(
        which in 0..3usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        kept in any::<prop::sample::Index>(),
        cut in any::<bool>(),
        size in prop::option::of([0..70_000u32, 0..70_000u32]),
    ) {
        let (name, mut bytes) = good_files()[which].clone();
        if let Some(size) = size.filter(|_| name == "1.png") {
            with_size(&mut bytes, size);
        }
        let bytes = damaged(&bytes, changes, usize::MAX, cut.then_some(kept));
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(name), bytes).unwrap();
        match read_slices(folder.path(), &PLAIN) {
            Ok(image) => prop_assert_eq!(image.volume().values.len(), image.grid.n_voxels()),
            Err(error) => prop_assert!(error.to_string().contains(name), "{}", error),
        }
    }
}
