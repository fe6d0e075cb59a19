//! Which files of a folder are one image.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, OpenFileOptions};

use super::super::error::ImageError;
use super::frames::{integer, text};
use super::lengths::check_lengths;

/// Which series of a folder is meant.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum SeriesChoice {
    /// The only one; several are refused.
    #[default]
    Only,
    /// The one of this place in the list of [`super::series_in`], from 1.
    Number(usize),
}

/// What a series is, for who has to choose one. Nothing of it tells who the patient is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeriesSummary {
    /// `CT`, `MR`, `SEG` or another code of DICOM PS3.3 C.7.3.1.1.1.
    pub modality: Option<String>,
    /// Number that the scanner gave.
    pub number: Option<i64>,
    /// What the scanner or its user called it.
    pub description: Option<String>,
    /// Files.
    pub n_files: usize,
}

impl std::fmt::Display for SeriesSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.modality.as_deref().unwrap_or("unknown modality"))?;
        if let Some(number) = self.number {
            write!(f, ", series {number}")?;
        }
        if let Some(description) = &self.description {
            write!(f, ", \"{description}\"")?;
        }
        write!(f, ", {} file(s)", self.n_files)
    }
}

/// The files of one series.
#[derive(Clone, Debug)]
pub(super) struct Series {
    pub(super) modality: Option<String>,
    number: Option<i64>,
    pub(super) description: Option<String>,
    /// In the order of their names.
    pub(super) files: Vec<PathBuf>,
    pub(super) notes: Vec<String>,
}

impl Series {
    pub(super) fn summary(&self) -> SeriesSummary {
        SeriesSummary {
            modality: self.modality.clone(),
            number: self.number,
            description: self.description.clone(),
            n_files: self.files.len(),
        }
    }
}

/// The object in a file, up to its pixels or whole.
pub(super) fn open(file: &Path, with_pixels: bool) -> Result<DefaultDicomObject, ImageError> {
    check_lengths(file)?;
    let options = OpenFileOptions::new();
    let options = if with_pixels { options } else { options.read_until(tags::PIXEL_DATA) };
    options.open_file(file).map_err(|error| {
        let reason = format!("damaged or not DICOM: {}", causes(&error));
        ImageError::Series { folder: file.to_path_buf(), reason }
    })
}

/// An error and what caused it, in one line.
pub(super) fn causes(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let text = cause.to_string();
        if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
        source = cause.source();
    }
    line
}

/// The files in a folder and in the folders in it, in the order of their names; a file stands for itself.
pub(super) fn files_below(path: &Path) -> Result<Vec<PathBuf>, ImageError> {
    let io_error = |source| ImageError::Io { file: path.to_path_buf(), source };
    if !path.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let (mut files, mut folders) = (Vec::new(), vec![path.to_path_buf()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).map_err(io_error)? {
            let entry = entry.map_err(io_error)?;
            let kind = entry.file_type().map_err(io_error)?;
            // Links to folders are not followed: they may lead in a circle.
            if kind.is_dir() {
                folders.push(entry.path());
            } else if !entry.path().is_dir() {
                files.push(entry.path());
            }
        }
    }
    files.sort();
    Ok(files)
}

/// Whether a file has DICOM's mark behind its preamble.
pub(super) fn is_dicom(file: &Path) -> bool {
    let mut first = [0; 132];
    let read = std::fs::File::open(file).and_then(|mut file| file.read_exact(&mut first));
    read.is_ok() && &first[128..] == b"DICM"
}

/// The image series of a folder, or of a file, by their numbers.
pub(super) fn find(path: &Path) -> Result<Vec<Series>, ImageError> {
    let files = files_below(path)?;
    let is_folder = path.is_dir();
    let (mut found, mut n_other, mut n_without_image) =
        (BTreeMap::<(Option<i64>, String), Series>::new(), 0, 0);
    for file in &files {
        if is_folder && !is_dicom(file) {
            n_other += 1;
            continue;
        }
        let object = open(file, false)?;
        // Reports, plans, the index of a disc: DICOM without an image.
        if object.get(tags::ROWS).is_none() {
            n_without_image += 1;
            continue;
        }
        let number = integer(&object, tags::SERIES_NUMBER);
        let uid = text(&object, tags::SERIES_INSTANCE_UID).unwrap_or_default();
        let series = found.entry((number, uid)).or_insert_with(|| Series {
            modality: text(&object, tags::MODALITY),
            number,
            description: text(&object, tags::SERIES_DESCRIPTION),
            files: Vec::new(),
            notes: Vec::new(),
        });
        series.files.push(file.clone());
    }
    if found.is_empty() {
        let reason = format!(
            "no DICOM image found among {} file(s) ({n_without_image} DICOM without an image, {n_other} not DICOM); \
             name the folder that holds the slices",
            files.len()
        );
        return Err(ImageError::Series { folder: path.to_path_buf(), reason });
    }
    let mut all: Vec<Series> = found.into_values().collect();
    for series in &mut all {
        if n_other > 0 {
            series.notes.push(format!("{n_other} file(s) that are not DICOM were passed over"));
        }
        if n_without_image > 0 {
            series.notes.push(format!(
                "{n_without_image} DICOM file(s) without an image (reports, plans, the index of a disc) were passed over"
            ));
        }
    }
    Ok(all)
}

/// The series that is meant.
pub(super) fn chosen(path: &Path, choice: &SeriesChoice) -> Result<Series, ImageError> {
    chosen_of(path, find(path)?, choice)
}

/// The one of several series that is meant; a refusal lists them as they are.
pub(super) fn chosen_of(
    path: &Path,
    mut all: Vec<Series>,
    choice: &SeriesChoice,
) -> Result<Series, ImageError> {
    let refuse = |reason: String| Err(ImageError::Series { folder: path.to_path_buf(), reason });
    let list = |all: &[Series]| {
        let lines = all.iter().enumerate().map(|(n, s)| format!("\n  {}: {}", n + 1, s.summary()));
        lines.collect::<String>()
    };
    match *choice {
        SeriesChoice::Only if all.len() == 1 => Ok(all.remove(0)),
        SeriesChoice::Only => refuse(format!(
            "{} image series found, one allowed; choose one by its place in this list (`--series N`):{}",
            all.len(),
            list(&all)
        )),
        SeriesChoice::Number(n) if (1..=all.len()).contains(&n) => Ok(all.remove(n - 1)),
        SeriesChoice::Number(n) => {
            refuse(format!("series {n} asked for, allowed: 1 to {}:{}", all.len(), list(&all)))
        }
    }
}
