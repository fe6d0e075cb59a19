//! Copies of DICOM series that do not tell who the patient is.
//!
//! A copy holds what is on a list ([`kept`]) and nothing else: the size, place and meaning of the voxels, and the voxels.
//! So every attribute that the basic profile of DICOM PS3.15 2024, table E.1-1, removes or empties is gone (names,
//! identifiers, dates, times, institutions, persons, comments, descriptions, private groups, curves and overlays), and
//! those that nobody has thought of. What a valid file must have is filled in empty or with a fixed word. Numbers have
//! to be numbers and words those that the standard defines, so that nothing hides under the tag of something else.
//!
//! Unique identifiers are replaced by `2.25.` and a 128-bit number: the keyed BLAKE3 hash of the old one. The key is the
//! caller's and should be random and forgotten: with a fixed one, whoever has a list of a hospital's identifiers could
//! look up which of them a copy is of. Equal identifiers remain equal among all files of one call, so that what one
//! file says of another (a segmentation of its image) still holds; copies of two calls cannot be linked.
//!
//! Pixels keep their coding ([`bare_pixels`]).

mod bare_pixels;
mod bare_streams;
mod identifiers;
mod kept;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Component, Path, PathBuf};

use dicom_core::{DataElement, PrimitiveValue, VR, value::DataSetSequence};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, FileMetaTableBuilder, InMemDicomObject, Tag};

use self::identifiers::NewIdentifiers;
use super::super::error::ImageError;
use super::frames::{frames_of, text};
use super::pixels::{coding_of, syntax_of};
use super::series::{self, SeriesChoice, causes, is_dicom, open};
use crate::files::fill_folder_atomically;

/// Which patient all copies are of.
const PATIENT: &str = "ANONYMOUS";
/// What was done, for who reads the copies (at most 64 characters).
const METHOD: &str = "glisson: only listed attributes kept, identifiers replaced";
/// Storage classes whose pixels are numbers of a scanner or a program, into which no text is drawn (DICOM PS3.4, B.5).
const WITHOUT_TEXT: &[&str] = &[
    uids::CT_IMAGE_STORAGE,
    uids::ENHANCED_CT_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_CT_IMAGE_STORAGE,
    uids::MR_IMAGE_STORAGE,
    uids::ENHANCED_MR_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_MR_IMAGE_STORAGE,
    uids::POSITRON_EMISSION_TOMOGRAPHY_IMAGE_STORAGE,
    uids::ENHANCED_PET_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_PET_IMAGE_STORAGE,
    uids::SEGMENTATION_STORAGE,
    uids::LABEL_MAP_SEGMENTATION_STORAGE,
    uids::RT_DOSE_STORAGE,
];

/// What was copied.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AnonymousCopy {
    /// Series.
    pub n_series: usize,
    /// Files, one for each of the original.
    pub n_files: usize,
    /// What a user should know before the copies are given away.
    pub notes: Vec<String>,
}

/// Writes a copy of the DICOM series in `input` (a folder or a file; all of them, or the one that is chosen) into the
/// folder `output` that does not tell who the patient is. `key` makes the new identifiers; see the module.
///
/// Files are called `slice_0001.dcm` and so on, in the order of their places; those of several series lie in folders
/// `series_1` and so on.
///
/// # Errors
/// [`ImageError`]: no DICOM, a damaged file, a transfer syntax or an element that is not read, a storage class that is
/// not the standard's own, an output folder that is not empty or lies in `input`, a refusal of the file system. Then
/// there is no output folder.
pub fn anonymize(
    input: &Path,
    choice: &SeriesChoice,
    output: &Path,
    key: [u8; 32],
) -> Result<AnonymousCopy, ImageError> {
    if input.is_file() && !is_dicom(input) {
        return Err(ImageError::UnknownFormat {
            file: input.to_path_buf(),
            found: "no DICM behind its first 128 bytes".into(),
            allowed: "copies without the patient are made of DICOM; write another format with `-o`, which takes nothing \
                      but the image along"
                .into(),
        });
    }
    let mut all = series::find(input)?;
    if let SeriesChoice::Number(_) = choice {
        // Descriptions are free text, and may name the patient in a refusal.
        all.iter_mut().for_each(|series| series.description = None);
        all = vec![series::chosen_of(input, all, choice)?];
    }
    let unwritable = |reason: String| ImageError::Unwritable { file: output.to_path_buf(), reason };
    let place = resolved(output);
    if input.canonicalize().is_ok_and(|input| place.starts_with(input)) {
        return Err(unwritable("it lies in what is copied; name a folder outside of it".into()));
    }
    let mut seen = Seen::default();
    let result = fill_folder_atomically(&place, |folder| {
        let identifiers = NewIdentifiers::with_key(key);
        for (index, series) in all.iter().enumerate() {
            let folder = if all.len() == 1 {
                folder.to_path_buf()
            } else {
                let own = folder.join(format!("series_{}", index + 1));
                std::fs::create_dir(&own)?;
                own
            };
            for (number, file) in in_order(&series.files)?.into_iter().enumerate() {
                let copy = folder.join(format!("slice_{:04}.dcm", number + 1));
                let numbers = Numbers { series: index + 1, instance: number + 1 };
                write_copy(file, &copy, &identifiers, &numbers, &mut seen)?;
            }
        }
        Ok::<(), Failure>(())
    });
    result.map_err(|failure| match failure {
        Failure::Image(error) => error,
        Failure::Output(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            unwritable(format!("{error}; name a folder that is not there or is empty"))
        }
        Failure::Output(source) => ImageError::Io { file: output.to_path_buf(), source },
    })?;
    let n_files = all.iter().map(|series| series.files.len()).sum();
    let mut notes = seen.notes();
    // Of the whole folder, the same for each series.
    notes.extend(all.first().map(|series| series.notes.clone()).unwrap_or_default());
    Ok(AnonymousCopy { n_series: all.len(), n_files, notes })
}

/// Why no copy came about.
enum Failure {
    Image(ImageError),
    Output(std::io::Error),
}

impl From<ImageError> for Failure {
    fn from(error: ImageError) -> Self {
        Self::Image(error)
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Output(error)
    }
}

/// Where a path leads that need not be there: without `..` and links, but for a link at its very end.
fn resolved(path: &Path) -> PathBuf {
    let Some(name) = path.file_name() else { return path.to_path_buf() };
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let mut folder = PathBuf::new();
    for component in absolute.parent().unwrap_or(Path::new("")).components() {
        match component {
            // What is there was resolved, so that this is the folder above it.
            Component::ParentDir => drop(folder.pop()),
            other => folder.push(other),
        }
        folder = folder.canonicalize().unwrap_or(folder);
    }
    folder.join(name)
}

/// Files in the order of their first frames along the normal of these; files without a place before, by their names.
fn in_order(files: &[PathBuf]) -> Result<Vec<&Path>, ImageError> {
    let mut placed = Vec::with_capacity(files.len());
    for file in files {
        let frames = frames_of(file, &open(file, false)?).unwrap_or_default();
        let height_mm = frames.first().map(|frame| frame.position_mm.dot(frame.normal()));
        placed.push((height_mm.unwrap_or(f64::NEG_INFINITY), file.as_path()));
    }
    placed.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(placed.into_iter().map(|(_, file)| file).collect())
}

/// The numbers that a copy gets, from 1.
struct Numbers {
    series: usize,
    instance: usize,
}

/// What copied files say of themselves.
#[derive(Clone, Debug, Default)]
struct Seen {
    n_burned_in: usize,
    n_silent: usize,
    n_recognizable: usize,
    n_renamed_segments: usize,
    /// Files, and pixels in them, that had something in bits that are not used.
    n_with_unused_bits: [usize; 2],
}

impl Seen {
    /// Takes note of a file of a storage class; says whether its pixels may tell who the patient is.
    fn look_at(&mut self, object: &InMemDicomObject, class: &str) -> bool {
        let burned_in = text(object, tags::BURNED_IN_ANNOTATION);
        let (is_burned_in, is_silent) = match burned_in.as_deref() {
            Some("NO") => (false, false),
            Some(_) => (true, false),
            None => (false, !is_of_scanner(object, class)),
        };
        let is_recognizable =
            text(object, tags::RECOGNIZABLE_VISUAL_FEATURES).is_some_and(|word| word != "NO");
        self.n_burned_in += usize::from(is_burned_in);
        self.n_silent += usize::from(is_silent);
        self.n_recognizable += usize::from(is_recognizable);
        let segments = object.get(tags::SEGMENT_SEQUENCE).and_then(|element| element.items());
        self.n_renamed_segments += segments.map_or(0, <[_]>::len);
        is_burned_in || is_silent || is_recognizable
    }

    fn notes(&self) -> Vec<String> {
        const LOOK: &str = "pixels are copied as they are and PatientIdentityRemoved is NO: look at them before you give \
                            the copies away";
        let mut notes = Vec::new();
        if self.n_burned_in > 0 {
            notes.push(format!(
                "WARNING: {} file(s) say that text is drawn into their pixels (BurnedInAnnotation); {LOOK}",
                self.n_burned_in
            ));
        }
        if self.n_silent > 0 {
            notes.push(format!(
                "WARNING: {} file(s) are of a kind that often has text drawn into its pixels (ultrasound, endoscopy, X-ray, \
                 pictures of a screen or of paper) and do not say whether they have; {LOOK}",
                self.n_silent
            ));
        }
        if self.n_recognizable > 0 {
            notes.push(format!(
                "WARNING: {} file(s) say that the patient can be recognized in their pixels \
                 (RecognizableVisualFeatures), as by a face; {LOOK}",
                self.n_recognizable
            ));
        }
        let [n_files, n_pixels] = self.n_with_unused_bits;
        if n_files > 0 {
            notes.push(format!(
                "in {n_files} file(s) {n_pixels} pixel(s) had something in bits that they do not use, as overlays of old \
                 files; it was cleared. Where BitsStored or PixelRepresentation is wrong these were parts of values: \
                 compare a copy with its original"
            ));
        }
        if self.n_renamed_segments > 0 {
            notes.push(format!(
                "the names of {} segment(s) are free text and were replaced by their numbers",
                self.n_renamed_segments
            ));
        }
        notes
    }
}

/// Whether a file is of a class into whose pixels scanners and programs draw no text, and not a picture made of one.
fn is_of_scanner(object: &InMemDicomObject, class: &str) -> bool {
    let image_type = object.get(tags::IMAGE_TYPE).and_then(|element| element.to_multi_str().ok());
    let is_secondary =
        image_type.is_some_and(|words| words.get(1).is_some_and(|word| word.trim() == "SECONDARY"));
    WITHOUT_TEXT.contains(&class) && !is_secondary && object.get(tags::CONVERSION_TYPE).is_none()
}

/// An element of text.
fn word(tag: Tag, vr: VR, value: &str) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, vr, PrimitiveValue::from(value))
}

fn write_copy(
    file: &Path,
    copy: &Path,
    identifiers: &NewIdentifiers,
    numbers: &Numbers,
    seen: &mut Seen,
) -> Result<(), Failure> {
    let object = open(file, true)?;
    let bare = bare_copy(file, &object, identifiers, numbers, seen)?;
    let meta = FileMetaTableBuilder::new().transfer_syntax(syntax_of(&object));
    let refuse = |error: &dyn std::error::Error| ImageError::Series {
        folder: file.to_path_buf(),
        reason: format!("it cannot be copied: {}", causes(error)),
    };
    let whole = bare.with_meta(meta).map_err(|error| refuse(&error))?;
    let mut writer = BufWriter::new(File::create_new(copy)?);
    whole.write_all(&mut writer).map_err(|error| refuse(&error))?;
    writer.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
    Ok(())
}

/// The object of a file with what is kept, and what a valid file must have.
fn bare_copy(
    file: &Path,
    object: &DefaultDicomObject,
    identifiers: &NewIdentifiers,
    numbers: &Numbers,
    seen: &mut Seen,
) -> Result<InMemDicomObject, ImageError> {
    let coding = coding_of(file, syntax_of(object))?;
    let mut bare = kept::kept_of(file, object, identifiers)?;
    let class = match text(&bare, tags::SOP_CLASS_UID) {
        Some(class) => class,
        None => kept::class_of_the_standard(file, object.meta().media_storage_sop_class_uid())?,
    };
    bare.put(word(tags::SOP_CLASS_UID, VR::UI, &class));
    let is_doubtful = seen.look_at(object, &class);
    let (pixels, n_changed) = bare_pixels::of(file, object, coding)?;
    bare.put(pixels);
    seen.n_with_unused_bits[0] += usize::from(n_changed > 0);
    seen.n_with_unused_bits[1] += n_changed;
    for (tag, vr) in [
        (tags::STUDY_DATE, VR::DA),
        (tags::STUDY_TIME, VR::TM),
        (tags::ACCESSION_NUMBER, VR::SH),
        (tags::MANUFACTURER, VR::LO),
        (tags::REFERRING_PHYSICIAN_NAME, VR::PN),
        (tags::PATIENT_BIRTH_DATE, VR::DA),
        (tags::PATIENT_SEX, VR::CS),
        (tags::STUDY_ID, VR::SH),
        (tags::POSITION_REFERENCE_INDICATOR, VR::LO),
    ] {
        bare.put(DataElement::new(tag, vr, PrimitiveValue::Empty));
    }
    bare.put(word(tags::PATIENT_NAME, VR::PN, PATIENT));
    bare.put(word(tags::PATIENT_ID, VR::LO, PATIENT));
    bare.put(word(tags::SERIES_NUMBER, VR::IS, &numbers.series.to_string()));
    bare.put(word(tags::INSTANCE_NUMBER, VR::IS, &numbers.instance.to_string()));
    // Files that lack these are told apart, or kept together, as reading them does.
    let instance = format!("instance {} of series {}", numbers.instance, numbers.series);
    for (tag, instead) in [
        (tags::SOP_INSTANCE_UID, instance.as_str()),
        (tags::SERIES_INSTANCE_UID, "series"),
        (tags::STUDY_INSTANCE_UID, "study"),
    ] {
        if bare.get(tag).is_none() {
            bare.put(word(tag, VR::UI, &identifiers.of(instead)));
        }
    }
    bare.put(word(tags::DEIDENTIFICATION_METHOD, VR::LO, METHOD));
    // YES says that nothing is left in the pixels either (DICOM PS3.3, C.7.1.1).
    let is_removed = if is_doubtful { "NO" } else { "YES" };
    bare.put(word(tags::PATIENT_IDENTITY_REMOVED, VR::CS, is_removed));
    if !is_doubtful {
        let profile = InMemDicomObject::from_element_iter([
            word(tags::CODE_VALUE, VR::SH, "113100"),
            word(tags::CODING_SCHEME_DESIGNATOR, VR::SH, "DCM"),
            word(tags::CODE_MEANING, VR::LO, "Basic Application Confidentiality Profile"),
        ]);
        let methods = DataSetSequence::from(vec![profile]);
        bare.put(DataElement::new(tags::DEIDENTIFICATION_METHOD_CODE_SEQUENCE, VR::SQ, methods));
    }
    bare.put(word(tags::LONGITUDINAL_TEMPORAL_INFORMATION_MODIFIED, VR::CS, "REMOVED"));
    Ok(bare)
}
