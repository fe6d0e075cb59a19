//! A folder of pictures, one a slice, as the Visible Human has them: PNG, TIFF, or bytes without a header.
//!
//! Slices stand in the order of the last number in their names, which goes up by the same from one to the next. Such
//! pictures say nothing of places: the distances of voxels are given by the caller, and they lie as INRIMAGE's do, i
//! (columns) to the left, j (rows) to the back and k to the head in LPS, or to the feet where the first slice is the one
//! nearest to the head; a note says so. A picture seen from below, as radiology shows them, lies like this.
//!
//! Colours become grey: a channel, or the luma of ITU-R BT.601, Y = 0.299 R + 0.587 G + 0.114 B, rounded.

mod picture;
mod png_slice;
mod raw_slice;
mod tiff_slice;

use std::path::{Path, PathBuf};

use self::picture::{Colours, Picture, Shape, refuse};
use super::error::ImageError;
use super::masks::files_in;
use super::placement::right_angled;
use super::stored::{StoredData, StoredImage};
use crate::binary::{ByteOrder, NumberType};
use crate::math::DVec3;

pub use self::raw_slice::RawSlices;

/// What people call the format.
const NAME: &str = "pictures of slices";

/// Most bytes of the voxels of all slices: the Visible Human's have half of it as bytes.
const MAX_BYTES: u64 = 1 << 33;

/// What becomes of the colours of slices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SliceChannel {
    /// The luma of ITU-R BT.601.
    #[default]
    Luminance,
    /// Red alone.
    Red,
    /// Green alone.
    Green,
    /// Blue alone.
    Blue,
}

/// What pictures of slices do not say themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceOptions {
    /// Distances of neighbouring columns, rows and slices [mm].
    pub spacing_mm: [f64; 3],
    /// What becomes of colours.
    pub channel: SliceChannel,
    /// What slices without a header are.
    pub raw: Option<RawSlices>,
    /// Whether the slice with the lowest number is the nearest to the head instead of to the feet.
    pub head_first: bool,
}

/// How a slice is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Png,
    Tiff,
    Raw,
}

/// Ends of names in lower case, without the dot, and what they tell.
const KINDS: &[(&str, Kind)] =
    &[("png", Kind::Png), ("tif", Kind::Tiff), ("tiff", Kind::Tiff), ("raw", Kind::Raw), ("rgb", Kind::Raw)];

fn kind_of(file: &Path) -> Option<Kind> {
    let extension = file.extension()?.to_string_lossy().to_lowercase();
    KINDS.iter().find(|(known, _)| *known == extension).map(|(_, kind)| *kind)
}

/// The last number in a file's name.
fn number_in(file: &Path) -> Option<u64> {
    let stem = file.file_stem()?.to_string_lossy().into_owned();
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit());
    let start = start.map_or(0, |at| at + stem[at..].chars().next().map_or(1, char::len_utf8));
    stem[start..end].parse().ok()
}

fn name_of(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Why the pictures right in a folder are no image as long as nobody says how large their voxels are; none where there
/// are no pictures.
pub(super) fn without_spacing(folder: &Path) -> Option<ImageError> {
    let files = files_in(folder, |file| kind_of(file).is_some()).ok()?;
    let first = files.first()?;
    let (size, columns) = match kind_of(first) {
        Some(Kind::Raw) => (" --size COLUMNS,ROWS", " and how many columns and rows a slice has"),
        _ => ("", ""),
    };
    let reason = format!(
        "{} picture(s) of slices (e.g. {}), which do not say how large their voxels are; say it{columns}: glisson import \
         {} --spacing-mm X,Y,Z{size} -o image.nii.gz, with the distances of columns, rows and slices in mm",
        files.len(),
        name_of(first),
        folder.display()
    );
    Some(refuse(folder, reason))
}

/// A slice's file and the number in its name.
struct Slice {
    file: PathBuf,
    number: u64,
}

/// The slices of a folder in the order of their numbers, their kind, and by how much the numbers go up.
fn slices_of(folder: &Path, files: Vec<PathBuf>) -> Result<(Vec<Slice>, Kind, u64), ImageError> {
    let kind = files.first().and_then(|file| kind_of(file));
    let Some(kind) = kind else {
        let known: Vec<_> = KINDS.iter().map(|(extension, _)| format!(".{extension}")).collect();
        return Err(refuse(folder, format!("no pictures of slices in it; allowed: {}", known.join(", "))));
    };
    let mut slices = Vec::with_capacity(files.len());
    for file in files {
        if kind_of(&file) != Some(kind) {
            let first = slices.first().map_or_else(String::new, |slice: &Slice| name_of(&slice.file));
            let reason = format!(
                "pictures of two kinds ({first} and {}); keep slices of one kind in a folder of their own",
                name_of(&file)
            );
            return Err(refuse(folder, reason));
        }
        let Some(number) = number_in(&file) else {
            let reason = format!(
                "no number in the name of {}, which would tell its place (e.g. slice_001.png), or one that is too large",
                name_of(&file)
            );
            return Err(refuse(folder, reason));
        };
        slices.push(Slice { file, number });
    }
    slices.sort_by_key(|slice| slice.number);
    let pairs = || slices.windows(2).map(|pair| (&pair[0], &pair[1]));
    if let Some((a, b)) = pairs().find(|(a, b)| a.number == b.number) {
        let reason = format!(
            "two slices with the number {}: {} and {}; keep the slices of one stack, numbered by the last number in \
             their names",
            a.number,
            name_of(&a.file),
            name_of(&b.file)
        );
        return Err(refuse(folder, reason));
    }
    let step = pairs().map(|(a, b)| b.number - a.number).min().unwrap_or(1);
    if let Some((a, b)) = pairs().find(|(a, b)| b.number - a.number != step) {
        let (from, to) = (a.number + step, b.number - 1);
        let reason = format!(
            "slices missing between {} and {}: numbers go up by {step}, and none of {from} to {to} is there; copy the \
             slices again, all of them",
            name_of(&a.file),
            name_of(&b.file)
        );
        return Err(refuse(folder, reason));
    }
    Ok((slices, kind, step))
}

/// The image that the pictures right in a folder are the slices of.
///
/// # Errors
/// [`ImageError`]: no pictures, pictures of two kinds, names without a number, numbers that are there twice or missing,
/// slices of different size, grey and coloured ones together, another number of bits, a channel of grey slices, raw
/// slices without a size, planes of grey ones, damaged files, more than 8 GiB of voxels, voxels smaller than a micrometre
/// or larger than 100 mm.
pub fn read_slices(folder: &Path, options: &SliceOptions) -> Result<StoredImage, ImageError> {
    let files = files_in(folder, |file| kind_of(file).is_some())?;
    let (slices, kind, step) = slices_of(folder, files)?;
    let raw = match (kind, options.raw) {
        (Kind::Raw, None) => {
            let reason = "slices without a header (.raw, .rgb) do not say how large they are; say it with --size COLUMNS,ROWS";
            return Err(refuse(folder, reason));
        }
        (Kind::Raw, Some(raw)) => raw,
        (_, Some(_)) => {
            let reason =
                format!("{} says itself how large it is: leave --size out", name_of(&slices[0].file));
            return Err(refuse(folder, reason));
        }
        (_, None) => RawSlices { size: [0; 2], in_planes: false },
    };
    let shape_of = |file: &Path| match kind {
        Kind::Png => png_slice::shape(file),
        Kind::Tiff => tiff_slice::shape(file),
        Kind::Raw => raw_slice::shape(file, &raw),
    };
    // Before memory is taken for any of them.
    let first = shape_of(&slices[0].file)?;
    for slice in &slices[1..] {
        check_same(folder, &slices[0].file, first, &slice.file, shape_of(&slice.file)?)?;
    }
    if first.colours == Colours::Grey && options.channel != SliceChannel::Luminance {
        let reason =
            format!("grey slices ({}) have no channels: leave --channel out", name_of(&slices[0].file));
        return Err(refuse(folder, reason));
    }
    if first.colours == Colours::Grey && raw.in_planes {
        let reason = format!("grey slices ({}) have no planes: leave --planes out", name_of(&slices[0].file));
        return Err(refuse(folder, reason));
    }
    let to_next = if options.head_first { -DVec3::Z } else { DVec3::Z };
    let dims = [first.size[0], first.size[1], slices.len()];
    let spacing_m = DVec3::from_array(options.spacing_mm) * 1e-3;
    let grid = right_angled(folder, dims, [DVec3::X, DVec3::Y, to_next], spacing_m, DVec3::ZERO)?;

    let kind_of_number = if first.n_bits == 16 { NumberType::U16 } else { NumberType::U8 };
    let n_bytes = first.n_pixels() as u64 * slices.len() as u64 * kind_of_number.n_bytes() as u64;
    let mut bytes = Vec::new();
    let is_small = n_bytes <= MAX_BYTES;
    if !is_small || usize::try_from(n_bytes).map_or(true, |n| bytes.try_reserve_exact(n).is_err()) {
        let reason = format!(
            "{} slices of {first} are {n_bytes} bytes, {MAX_BYTES} allowed, and no more than there is memory; take every \
             second slice, or a part of each",
            slices.len()
        );
        return Err(refuse(folder, reason));
    }
    for slice in &slices {
        let picture = match kind {
            Kind::Png => png_slice::read(&slice.file),
            Kind::Tiff => tiff_slice::read(&slice.file),
            Kind::Raw => raw_slice::read(&slice.file, &raw),
        }?;
        check_same(folder, &slices[0].file, first, &slice.file, picture.shape)?;
        for value in greys(&picture, options.channel) {
            bytes.extend_from_slice(&value.to_le_bytes()[..kind_of_number.n_bytes()]);
        }
    }
    let data = StoredData::plain(kind_of_number, ByteOrder::Little, bytes, 0);
    let mut image = StoredImage::new(folder, NAME, grid, data);
    image.notes = notes(options, first, step);
    Ok(image)
}

fn check_same(
    folder: &Path,
    first: &Path,
    shape: Shape,
    file: &Path,
    found: Shape,
) -> Result<(), ImageError> {
    if found == shape {
        return Ok(());
    }
    let reason = format!(
        "slices that differ: {} has {shape}, {} has {found}; all slices of a stack must be alike",
        name_of(first),
        name_of(file)
    );
    Err(refuse(folder, reason))
}

/// One number a pixel.
fn greys(picture: &Picture, channel: SliceChannel) -> impl Iterator<Item = u16> {
    let shape = picture.shape;
    picture.samples.chunks_exact(shape.n_samples).map(move |pixel| match (shape.colours, channel) {
        (Colours::Grey, _) | (_, SliceChannel::Red) => pixel[0],
        (_, SliceChannel::Green) => pixel[1],
        (_, SliceChannel::Blue) => pixel[2],
        (_, SliceChannel::Luminance) => {
            let [red, green, blue] = [pixel[0], pixel[1], pixel[2]].map(u32::from);
            ((299 * red + 587 * green + 114 * blue + 500) / 1000) as u16
        }
    })
}

fn notes(options: &SliceOptions, shape: Shape, step: u64) -> Vec<String> {
    let side = if options.head_first { "feet" } else { "head" };
    let other = if options.head_first { "without" } else { "with" };
    let mut notes = vec![format!(
        "pictures do not say which side is left; read with columns to the left, rows to the back and slices to the {side} \
         in the order of their numbers (LPS); if the first slice is at the other end: {other} --head-first"
    )];
    if shape.colours == Colours::Three {
        notes.push(match options.channel {
            SliceChannel::Luminance => {
                "colours became their luminance (0.299 red + 0.587 green + 0.114 blue)".into()
            }
            channel => format!("of the colours {} was taken alone", format!("{channel:?}").to_lowercase()),
        });
    }
    if shape.n_samples.is_multiple_of(2) {
        notes.push("the opacity of pixels was passed over".into());
    }
    if step > 1 {
        notes.push(format!("the numbers of slices go up by {step}; none in between was taken for missing"));
    }
    notes
}
