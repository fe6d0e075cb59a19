//! Images and shapes as commands read them, and what a user should know about them.

use std::path::Path;

use anyhow::Context;
use glisson::image::LabelMap;
use glisson::image::files::{ImageError, SeriesChoice, StoredImage, format_of_file, read_image, read_series};
use glisson::image::labels::{LabelError, LabelSelection, Parts};
use glisson::surface::files::FileKind;
use glisson::units::{LengthUnit, likely_unit};

/// Whether a path is an image to `glisson mesh`, and no surface.
pub(crate) fn is_image(path: &Path) -> bool {
    path.is_dir() || (FileKind::of_path(path).is_err() && format_of_file(path).is_some())
}

/// The image in a file or folder; its notes go to standard error, so that they do not mix with JSON.
pub(crate) fn read_with_notes(path: &Path, series: Option<usize>) -> Result<StoredImage, ImageError> {
    let image = read(path, series)?;
    for note in &image.notes {
        eprintln!("note: {}: {note}", path.display());
    }
    Ok(image)
}

/// The image in a file or folder, or series number `series` of a DICOM folder.
pub(crate) fn read(path: &Path, series: Option<usize>) -> Result<StoredImage, ImageError> {
    match series {
        Some(number) => read_series(path, &SeriesChoice::Number(number)),
        None => read_image(path),
    }
}

/// Which organ of a label map.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct LabelChoice {
    /// Which DICOM series of a folder, by its place in the list of `glisson import --list`
    #[arg(long, value_name = "N")]
    pub(crate) series: Option<usize>,
    /// Which label of a label map, by name or number; several as one organ: `liver+tumour` [default: liver, or the only
    /// label]
    #[arg(long, value_name = "NAME_OR_NUMBER")]
    pub(crate) label: Option<String>,
    /// Take the organ's own label alone, without its vessels and tumours
    #[arg(long)]
    pub(crate) without_parts: bool,
}

impl LabelChoice {
    /// Whether anything is said.
    pub(crate) fn is_given(&self) -> bool {
        self.series.is_some() || self.label.is_some() || self.without_parts
    }

    /// The labels meant: those asked for; without any the liver, or the only label there is.
    pub(crate) fn select(&self, map: &LabelMap) -> Result<LabelSelection, LabelError> {
        let parts = if self.without_parts { Parts::Excluded } else { Parts::Included };
        map.select_or_usual(self.label.as_deref(), parts)
    }
}

/// The label map in a file or folder and the voxels of the organ meant.
pub(crate) fn label_mask(path: &Path, choice: &LabelChoice) -> anyhow::Result<(LabelMap, Vec<bool>)> {
    let map = read_with_notes(path, choice.series)?.label_map()?;
    let selection = choice.select(&map).with_context(|| path.display().to_string())?;
    let mask = map.mask(&selection);
    Ok((map, mask))
}

/// Says so where an organ read in `unit` has a volume that no organ has.
pub(crate) fn warn_of_unit(path: &Path, volume_m3: f64, unit: LengthUnit) {
    // glTF is in metres, whatever is asked for.
    let is_gltf = matches!(FileKind::of_path(path), Ok(FileKind::Gltf));
    let unit = if is_gltf { LengthUnit::Metre } else { unit };
    let Some(likely) = likely_unit(volume_m3, unit) else { return };
    let remedy = if is_gltf { "scale it where it was made".to_owned() } else { format!("--unit {likely}") };
    eprintln!(
        "warning: {}: {:.3} ml read in {unit}, organs have 1 ml to 20 l; the file is probably in {likely} ({remedy})",
        path.display(),
        1e6 * volume_m3
    );
}
