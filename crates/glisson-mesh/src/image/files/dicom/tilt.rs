//! Slices of a tilted gantry: moved in their planes so that they stand above each other.
//!
//! The table of a CT moves along its own axis, not along the normal of a tilted gantry's slices, so that each slice lies
//! beside the one before by
//!
//! ```text
//! s = t - (t . n) n        t: step from slice to slice [mm], n: normal of the slices, tilt = acos(t . n / |t|)
//! ```
//!
//! The right-angled grid has the voxels of the first slice and as many more columns and rows as the last one lies
//! beside it. Slice k is read at its own voxel coordinates (i, j) - k s / spacing, linearly between neighbours; nothing
//! is interpolated between slices. Between pixels of a slice nothing is guessed: what lies outside of their centres gets
//! the lowest value of the image, in CT that of air. Values keep the type of number in which they are stored, so that
//! they are rounded to half of its step.

use std::path::Path;

use super::super::error::ImageError;
use super::super::placement::{MAX_SHEAR, right_angled};
use super::super::stored::StoredData;
use super::frames::Frame;
use crate::binary::{ByteOrder, NumberType};
use crate::image::VoxelGrid;
use crate::math::DVec3;

/// Largest tilt that is taken for a gantry's (they go to 30 degrees).
const MAX_TILT_DEG: f64 = 45.0;
/// Parts of a voxel that count as none: rounding in positions.
const NO_PART: f64 = 1e-6;
/// An image grows by at most this factor, unless it stays below [`SMALL`].
const MAX_GROWTH: f64 = 16.0;
/// Voxels of an image that is small however much it has grown.
const SMALL: f64 = (1u64 << 24) as f64;

/// How slices lie beside each other.
#[derive(Clone, Debug)]
pub(super) struct Tilt {
    /// Columns and rows by which each slice lies further on than the one before.
    shift: [f64; 2],
    /// Columns and rows before the first slice's own.
    n_before: [usize; 2],
    /// Of the slices, and their number.
    dims: [usize; 3],
    /// Of the slices' normal to the step.
    angle_deg: f64,
    /// The right-angled grid.
    pub(super) grid: VoxelGrid,
}

impl Tilt {
    /// The tilt of `n_slices` slices, where there is one: `first` is the lowest, `step_mm` leads to the next.
    ///
    /// # Errors
    /// An image that would grow out of measure; voxels of a size that is not allowed.
    pub(super) fn of(
        folder: &Path,
        first: &Frame,
        n_slices: usize,
        step_mm: DVec3,
    ) -> Result<Option<Self>, ImageError> {
        let distance_mm = step_mm.dot(first.normal());
        let aside_mm = first.directions.map(|direction| step_mm.dot(direction));
        let angle_deg = libm::acos((distance_mm / step_mm.length()).clamp(-1.0, 1.0)).to_degrees();
        let is_tilted = aside_mm.iter().any(|aside| aside.abs() > MAX_SHEAR * step_mm.length());
        if !is_tilted || angle_deg > MAX_TILT_DEG {
            return Ok(None);
        }
        let shift = [0, 1].map(|a| aside_mm[a] / first.spacing_mm[a]);
        let reach = shift.map(|shift| shift * (n_slices - 1) as f64);
        let beyond = |reach: f64| (reach.max(0.0) - NO_PART).ceil().max(0.0);
        let (before, after) = (reach.map(|reach| beyond(-reach)), reach.map(beyond));
        let grown = [0, 1].map(|a| first.dims[a] as f64 + before[a] + after[a]);
        let n_voxels = grown[0] * grown[1] * n_slices as f64;
        let growth = grown[0] * grown[1] / (first.dims[0] * first.dims[1]) as f64;
        if growth > MAX_GROWTH && n_voxels > SMALL {
            let reason = format!(
                "the slices lie beside each other by {aside_mm:.2?} mm from one to the next, a tilt of {angle_deg:.1} \
                 degrees; upright, the image would be {growth:.0} times as large, {MAX_GROWTH} allowed: are the \
                 positions right?"
            );
            return Err(ImageError::Series { folder: folder.to_path_buf(), reason });
        }
        let dims = [grown[0] as usize, grown[1] as usize, n_slices];
        let [columns_mm, rows_mm] = first.spacing_mm;
        let origin_mm = first.position_mm
            - first.directions[0] * before[0] * columns_mm
            - first.directions[1] * before[1] * rows_mm;
        let steps = [first.directions[0], first.directions[1], first.normal()];
        let spacing_m = DVec3::new(columns_mm, rows_mm, distance_mm) * 1e-3;
        let grid = right_angled(folder, dims, steps, spacing_m, origin_mm * 1e-3)?;
        let n_before = before.map(|n| n as usize);
        Ok(Some(Self { shift, n_before, dims: [first.dims[0], first.dims[1], n_slices], angle_deg, grid }))
    }

    /// Whether a slice moves by parts of a voxel, so that numbers are made that no voxel has.
    pub(super) fn is_between_voxels(&self) -> bool {
        let moved = |k: usize| self.shift.map(|shift| shift * k as f64);
        let is_part = |place: f64| (place - place.round()).abs() >= NO_PART;
        (0..self.dims[2]).any(|k| moved(k).into_iter().any(is_part))
    }

    /// The slices' numbers on the right-angled grid, and a note of what was done.
    pub(super) fn straighten(&self, slices: &StoredData) -> (StoredData, String) {
        let numbers = |bytes: &[u8]| {
            let mut list = Vec::with_capacity(bytes.len() / slices.kind.n_bytes());
            let plain = StoredData::plain(slices.kind, slices.order, bytes.to_vec(), 0);
            let Ok(()) = plain.for_each(|_, number| {
                list.push(number);
                Ok::<(), std::convert::Infallible>(())
            });
            list
        };
        let n_slice_bytes = self.dims[0] * self.dims[1] * slices.kind.n_bytes();
        let in_slices = || slices.bytes[slices.start..].chunks_exact(n_slice_bytes);
        let is_turned = slices.slope < 0.0;
        let outside = in_slices().flat_map(numbers).fold(f64::NAN, |lowest: f64, number| {
            if is_turned { lowest.max(number) } else { lowest.min(number) }
        });
        let outside = if outside.is_nan() { 0.0 } else { outside };
        let mut bytes = Vec::with_capacity(self.grid.n_voxels() * slices.kind.n_bytes());
        for (k, slice) in in_slices().enumerate() {
            let slice = numbers(slice);
            let [columns, rows] = [0, 1].map(|a| {
                let offset = self.n_before[a] as f64 + k as f64 * self.shift[a];
                places(offset, self.dims[a], self.grid.dims[a])
            });
            for row in &rows {
                for column in &columns {
                    let value = match (column, row) {
                        (Some(column), Some(row)) => between(&slice, self.dims[0], *column, *row),
                        _ => outside,
                    };
                    push(slices.kind, value, &mut bytes);
                }
            }
        }
        let lowest = outside * slices.slope + slices.intercept;
        let note = format!(
            "tilted gantry: the slices lean by {:.2} degrees; they were moved in their planes onto right-angled voxels \
             (linear interpolation), {} column(s) and {} row(s) were added, and what lies outside of the slices is {lowest}",
            self.angle_deg,
            self.grid.dims[0] - self.dims[0],
            self.grid.dims[1] - self.dims[1]
        );
        let data = StoredData::plain(slices.kind, ByteOrder::Little, bytes, 0);
        (StoredData { slope: slices.slope, intercept: slices.intercept, ..data }, note)
    }
}

/// Two neighbours in a row of voxels, and the share of the second.
type Place = (usize, usize, f64);

/// Where each of `n_out` voxels lies among `n` of a slice that begins at `offset`; none for those outside.
fn places(offset: f64, n: usize, n_out: usize) -> Vec<Option<Place>> {
    (0..n_out)
        .map(|at| {
            let place = at as f64 - offset;
            let nearest = place.round();
            let (low, share) = if (place - nearest).abs() < NO_PART {
                (nearest, 0.0)
            } else {
                (place.floor(), place - place.floor())
            };
            let high = if share > 0.0 { low + 1.0 } else { low };
            (low >= 0.0 && high < n as f64).then_some((low as usize, high as usize, share))
        })
        .collect()
}

/// The value between four voxels of a slice.
fn between(slice: &[f64], n_columns: usize, column: Place, row: Place) -> f64 {
    let in_row = |row: usize| {
        let (left, right) = (slice[row * n_columns + column.0], slice[row * n_columns + column.1]);
        left + column.2 * (right - left)
    };
    let (above, below) = (in_row(row.0), in_row(row.1));
    above + row.2 * (below - above)
}

/// Adds a number of a type, little-endian, the nearest one to `value`.
fn push(kind: NumberType, value: f64, bytes: &mut Vec<u8>) {
    macro_rules! push_whole {
        ($number:ty) => {
            bytes.extend((libm::rint(value) as $number).to_le_bytes())
        };
    }
    match kind {
        NumberType::U8 => push_whole!(u8),
        NumberType::I8 => push_whole!(i8),
        NumberType::I16 => push_whole!(i16),
        NumberType::U16 => push_whole!(u16),
        NumberType::I32 => push_whole!(i32),
        NumberType::U32 => push_whole!(u32),
        NumberType::I64 => push_whole!(i64),
        NumberType::U64 => push_whole!(u64),
        NumberType::F32 => bytes.extend((value as f32).to_le_bytes()),
        NumberType::F64 => bytes.extend(value.to_le_bytes()),
    }
}
