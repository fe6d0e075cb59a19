//! An image as its file holds it: numbers of some type, and where they are.

use std::path::{Path, PathBuf};

use super::error::ImageError;
use crate::binary::{ByteOrder, NumberType};
use crate::image::{LabelMap, Volume, VoxelGrid};

/// An image as its file holds it, read and checked, its numbers not yet converted.
#[derive(Clone, Debug)]
pub struct StoredImage {
    /// Where the voxels are.
    pub grid: VoxelGrid,
    /// What people call its format.
    pub format: &'static str,
    /// What made the image (`CT`, `MR`, `SEG`), where the format says so.
    pub modality: Option<String>,
    /// Labels that the file names, ascending.
    pub names: Vec<(u16, String)>,
    /// Colours that the file gives labels, red, green, blue from 0 to 1, ascending.
    pub colours: Vec<(u16, [f32; 3])>,
    /// What a user should know: what the file leaves open and how it was read, what is missing or was passed over.
    pub notes: Vec<String>,
    pub(super) file: PathBuf,
    pub(super) data: StoredData,
    /// Whether numbers lie between those of the file, as on moved slices: labels do not.
    pub(super) is_interpolated: bool,
}

/// Different numbers up to which whole numbers look like labels: a choice.
const MOST_LIKELY_LABELS: usize = 32;

/// Numbers in a file, i fastest.
#[derive(Clone, Debug)]
pub(super) struct StoredData {
    pub(super) kind: NumberType,
    pub(super) order: ByteOrder,
    /// The numbers start at byte `start` and go to the end.
    pub(super) bytes: Vec<u8>,
    pub(super) start: usize,
    /// Value = stored number * slope + intercept.
    pub(super) slope: f64,
    pub(super) intercept: f64,
}

impl StoredData {
    /// Numbers that mean themselves.
    pub(super) fn plain(kind: NumberType, order: ByteOrder, bytes: Vec<u8>, start: usize) -> Self {
        Self { kind, order, bytes, start, slope: 1.0, intercept: 0.0 }
    }

    pub(super) fn n_numbers(&self) -> usize {
        (self.bytes.len() - self.start) / self.kind.n_bytes()
    }

    /// Calls `visit` with each scaled value, in file order.
    pub(super) fn for_each<E>(&self, mut visit: impl FnMut(usize, f64) -> Result<(), E>) -> Result<(), E> {
        macro_rules! decode {
            ($number:ty) => {
                for (index, bytes) in self.bytes[self.start..].chunks_exact(size_of::<$number>()).enumerate()
                {
                    let bytes = bytes.try_into().expect("chunks have the number's size");
                    let stored = match self.order {
                        ByteOrder::Big => <$number>::from_be_bytes(bytes),
                        ByteOrder::Little => <$number>::from_le_bytes(bytes),
                    };
                    visit(index, stored as f64 * self.slope + self.intercept)?;
                }
            };
        }
        match self.kind {
            NumberType::U8 => decode!(u8),
            NumberType::I8 => decode!(i8),
            NumberType::I16 => decode!(i16),
            NumberType::U16 => decode!(u16),
            NumberType::I32 => decode!(i32),
            NumberType::U32 => decode!(u32),
            NumberType::I64 => decode!(i64),
            NumberType::U64 => decode!(u64),
            NumberType::F32 => decode!(f32),
            NumberType::F64 => decode!(f64),
        }
        Ok(())
    }
}

impl StoredImage {
    /// An image of a file that names no labels.
    pub(super) fn new(file: &Path, format: &'static str, grid: VoxelGrid, data: StoredData) -> Self {
        let (names, colours, notes) = (Vec::new(), Vec::new(), Vec::new());
        let file = file.to_path_buf();
        Self { grid, format, modality: None, names, colours, notes, file, data, is_interpolated: false }
    }

    /// Its values, scaled as the file says.
    pub fn volume(&self) -> Volume<f32> {
        let mut values = Vec::with_capacity(self.grid.n_voxels());
        let result = self.data.for_each(|_, value| {
            values.push(value as f32);
            Ok::<(), std::convert::Infallible>(())
        });
        let Ok(()) = result;
        Volume { grid: self.grid.clone(), values }
    }

    /// Whether the file names labels, or says that it is a segmentation.
    pub fn is_of_labels(&self) -> bool {
        !self.names.is_empty() || self.modality.as_deref() == Some("SEG")
    }

    /// Labels that its numbers probably are, where the file does not say what they are: whole and few, and of no modality.
    pub fn likely_labels(&self) -> Option<LabelMap> {
        let says_nothing = !self.is_of_labels() && self.modality.is_none();
        let labels = if says_nothing { self.label_map().ok() } else { None };
        labels.filter(|map| map.present().len() <= MOST_LIKELY_LABELS)
    }

    /// Its labels, with the names and colours that the file gives them.
    ///
    /// # Errors
    /// A voxel that is not a whole number from 0 to 65535; numbers between those of the file.
    pub fn label_map(&self) -> Result<LabelMap, ImageError> {
        if self.is_interpolated {
            let reason = "it is no label map: its slices are those of a tilted gantry, and were put upright by interpolation, \
                          which makes labels that nothing has; resample them by the nearest voxel (e.g. with 3D Slicer)";
            return Err(ImageError::Series { folder: self.file.clone(), reason: reason.into() });
        }
        let mut labels = Vec::with_capacity(self.grid.n_voxels());
        self.data.for_each(|index, value| {
            if !(0.0..=65535.0).contains(&value) || value.fract() != 0.0 {
                let voxel = self.grid.voxel(index);
                return Err(ImageError::NotALabel { file: self.file.clone(), voxel, found: value });
            }
            labels.push(value as u16);
            Ok(())
        })?;
        let (names, colours) = (self.names.clone(), self.colours.clone());
        Ok(LabelMap { grid: self.grid.clone(), labels, names, colours })
    }
}
