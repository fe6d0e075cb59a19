//! Images and label maps as arrays, and the organ in an image.

use crate::arrays::{array_of_kind, gathered, points_of};
use crate::errors::of_shape;
use crate::work;
use glisson::image::files::{read_image, write_label_map, write_volume};
use glisson::image::labels::{Parts, mask_volume_m3};
use glisson::image::segment::{SeededParams, Seeds, segment_with_seeds};
use glisson::image::{LabelMap, Volume, VoxelGrid};
use glisson::math::{DMat3, DVec3};
use glisson::progress::tell;
use numpy::ndarray::{ArrayView3, ShapeBuilder};
use numpy::{AllowTypeChange, PyArray2, PyArray3, PyArrayLike3};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Axes that are further from orthonormal than this are no axes.
const LARGEST_SKEW: f64 = 1e-4;

type Axes = [[f64; 3]; 3];
/// Voxels along the patient's axes.
const STRAIGHT: Axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Where voxels are. `axes` has the directions of i, j and k in its columns, as its property has.
fn grid_of(dims: &[usize], spacing_m: [f64; 3], origin_m: [f64; 3], axes: Axes) -> PyResult<VoxelGrid> {
    if dims.contains(&0) {
        return Err(PyValueError::new_err(format!("the image has no voxel: its shape is {dims:?}")));
    }
    if !spacing_m.iter().all(|spacing| *spacing > 0.0 && spacing.is_finite()) {
        return Err(PyValueError::new_err(format!(
            "spacing_m is {spacing_m:?}: three distances above 0 m between neighbouring voxels are needed"
        )));
    }
    let axes = DMat3::from_cols_array_2d(&axes).transpose();
    let skew = axes.transpose() * axes - DMat3::IDENTITY;
    let is_skew = !skew.to_cols_array().iter().all(|x| x.abs() < LARGEST_SKEW);
    if is_skew || !origin_m.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err(
            "axes are three rows of three numbers whose columns are of length 1 and at right angles, and origin_m is finite",
        ));
    }
    let (spacing_m, origin_m) = (DVec3::from_array(spacing_m), DVec3::from_array(origin_m));
    Ok(VoxelGrid { dims: [dims[0], dims[1], dims[2]], spacing_m, origin_m, axes })
}

/// Values in the order of the library: i runs fastest.
fn in_order<T: Copy>(values: &ArrayView3<'_, T>) -> Vec<T> {
    values.t().iter().copied().collect()
}

/// An image: a value for each voxel, (ni, nj, nk) with i, j, k along the columns of `axes`, in the patient frame LPS.
#[pyclass(name = "Image", module = "glisson", frozen)]
pub(crate) struct PyImage {
    volume: Volume<f32>,
    notes: Vec<String>,
}

#[pymethods]
impl PyImage {
    /// An image of values (ni, nj, nk), for CT in Hounsfield units: any numbers, kept with 32 bits. `spacing_m` (3): from a voxel to its
    /// neighbours along i, j, k; `origin_m` (3): where the centre of the first voxel is, LPS; `axes` (3, 3): in its columns the directions
    /// of i, j, k.
    #[new]
    #[pyo3(signature = (values, spacing_m, origin_m = [0.0; 3], axes = STRAIGHT))]
    fn new(
        values: PyArrayLike3<'_, f32, AllowTypeChange>,
        spacing_m: [f64; 3],
        origin_m: [f64; 3],
        axes: Axes,
    ) -> PyResult<Self> {
        let values = values.as_array();
        let grid = grid_of(values.shape(), spacing_m, origin_m, axes)?;
        Ok(Self { volume: Volume { grid, values: in_order(&values) }, notes: Vec::new() })
    }

    /// Reads a DICOM folder, NIfTI, NRRD, MetaImage, Inrimage or a folder of slices (docs/images.md).
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let image = work::done(py, None, || Ok(read_image(&path)?))?;
        Ok(Self { volume: image.volume(), notes: image.notes })
    }

    /// Writes it; the ending tells how (.nii, .nii.gz, .nrrd, .mha).
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        work::done(py, None, || Ok(write_volume(&path, &self.volume)?))
    }

    /// What one should know about the file that it was read from.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// A copy of its values, (ni, nj, nk).
    #[getter]
    fn values(&self, py: Python<'_>) -> PyResult<Py<PyArray3<f32>>> {
        gathered(py, self.volume.grid.dims.f(), self.volume.values.clone())
    }

    /// From a voxel to its neighbours along i, j, k [m].
    #[getter]
    fn spacing_m(&self) -> [f64; 3] {
        self.volume.grid.spacing_m.to_array()
    }

    /// Where the centre of the first voxel is [m], LPS.
    #[getter]
    fn origin_m(&self) -> [f64; 3] {
        self.volume.grid.origin_m.to_array()
    }

    /// Directions of i, j, k in its columns, (3, 3).
    #[getter]
    fn axes(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        gathered(py, (3, 3).f(), self.volume.grid.axes.to_cols_array().to_vec())
    }

    fn __repr__(&self) -> String {
        described("Image", &self.volume.grid)
    }
}

fn described(kind: &str, grid: &VoxelGrid) -> String {
    let ([i, j, k], mm) = (grid.dims, 1e3 * grid.spacing_m);
    format!("<glisson.{kind}, {i} x {j} x {k} voxels of {:.2} x {:.2} x {:.2} mm>", mm.x, mm.y, mm.z)
}

/// Which organ each voxel belongs to, (ni, nj, nk); 0 is none.
#[pyclass(name = "Labels", module = "glisson", frozen)]
pub(crate) struct PyLabels {
    map: LabelMap,
    notes: Vec<String>,
}

/// Which organ: a number, or a name, several with + between them.
#[derive(FromPyObject)]
pub(crate) enum Label {
    Number(u16),
    Name(String),
}

/// An organ of a label map.
pub(crate) struct Organ {
    pub(crate) grid: VoxelGrid,
    pub(crate) mask: Vec<bool>,
    pub(crate) volume_m3: f64,
}

impl PyLabels {
    /// The organ of this name or number, else the liver or the only label.
    pub(crate) fn organ(&self, label: Option<&Label>, parts: bool) -> anyhow::Result<Organ> {
        let parts = if parts { Parts::Included } else { Parts::Excluded };
        let label = label.map(|label| match label {
            Label::Number(number) => number.to_string(),
            Label::Name(name) => name.clone(),
        });
        let mask = self.map.mask(&self.map.select_or_usual(label.as_deref(), parts)?);
        let grid = self.map.grid.clone();
        Ok(Organ { volume_m3: mask_volume_m3(&grid, &mask), grid, mask })
    }
}

#[pymethods]
impl PyLabels {
    /// A label map of whole numbers (ni, nj, nk) from 0 to 65535, or of truth values; `names`: what labels are called. Where its voxels are:
    /// as for `Image`.
    #[new]
    #[pyo3(signature = (values, spacing_m, origin_m = [0.0; 3], axes = STRAIGHT, *, names = BTreeMap::new()))]
    fn new(
        values: &Bound<'_, PyAny>,
        spacing_m: [f64; 3],
        origin_m: [f64; 3],
        axes: Axes,
        names: BTreeMap<u16, String>,
    ) -> PyResult<Self> {
        let array = array_of_kind(values, b"bui")?.ok_or_else(|| {
            let words = "labels are whole numbers from 0 to 65535, and the array is of another type: use values.astype(numpy.uint16)";
            PyTypeError::new_err(words)
        })?;
        let values: PyArrayLike3<'_, i64, AllowTypeChange> = array.as_any().extract()?;
        let values = values.as_array();
        let grid = grid_of(values.shape(), spacing_m, origin_m, axes)?;
        let labels: Result<Vec<u16>, _> = values.t().iter().map(|&label| u16::try_from(label)).collect();
        let labels =
            labels.map_err(|_| PyValueError::new_err("there is a label that is not from 0 to 65535"))?;
        let map = LabelMap { grid, labels, names: names.into_iter().collect(), colours: Vec::new() };
        Ok(Self { map, notes: Vec::new() })
    }

    /// Reads NIfTI, NRRD (also 3D Slicer's .seg.nrrd), MetaImage, DICOM segmentations or a folder of masks (docs/images.md).
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let image = work::done(py, None, || Ok(read_image(&path)?))?;
        let map = image.label_map().map_err(|error| of_shape(&error.into()))?;
        Ok(Self { map, notes: image.notes })
    }

    /// Writes it; the ending tells how (.nii, .nii.gz, .nrrd, .seg.nrrd, .mha).
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        work::done(py, None, || Ok(write_label_map(&path, &self.map)?))
    }

    /// What one should know about the file that it was read from.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// A copy of its labels, (ni, nj, nk).
    #[getter]
    fn values(&self, py: Python<'_>) -> PyResult<Py<PyArray3<u16>>> {
        gathered(py, self.map.grid.dims.f(), self.map.labels.clone())
    }

    /// What labels are called.
    #[getter]
    fn names(&self) -> BTreeMap<u16, String> {
        self.map.names.iter().cloned().collect()
    }

    /// From a voxel to its neighbours along i, j, k [m].
    #[getter]
    fn spacing_m(&self) -> [f64; 3] {
        self.map.grid.spacing_m.to_array()
    }

    /// Where the centre of the first voxel is [m], LPS.
    #[getter]
    fn origin_m(&self) -> [f64; 3] {
        self.map.grid.origin_m.to_array()
    }

    /// Directions of i, j, k in its columns, (3, 3).
    #[getter]
    fn axes(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        gathered(py, (3, 3).f(), self.map.grid.axes.to_cols_array().to_vec())
    }

    /// Volume of an organ [m3], by name or number; without one of the liver, or of the only label. Without `parts` its vessels and tumours
    /// do not count.
    #[pyo3(signature = (label = None, *, parts = true))]
    fn volume_m3(&self, label: Option<Label>, parts: bool) -> PyResult<f64> {
        let organ = self.organ(label.as_ref(), parts).map_err(|error| of_shape(&error))?;
        Ok(organ.volume_m3)
    }

    fn __repr__(&self) -> String {
        described("Labels", &self.map.grid)
    }
}

/// The liver in a CT, or the organ at points: `glisson segment`.
///
/// `inside_m` (points, 3): points in the organ [m], LPS, the first in its main part; without them the liver is looked for. `outside_m`
/// (points, 3): points in tissue that is not to be taken. `name`: what the organ is called in what comes of it, its label is 1. `progress`
/// is called with the share of the work that is done.
#[pyfunction]
#[pyo3(signature = (image, inside_m = None, outside_m = None, *, name = "liver".to_owned(), progress = None))]
pub(crate) fn segment(
    py: Python<'_>,
    image: &PyImage,
    inside_m: Option<&Bound<'_, PyAny>>,
    outside_m: Option<&Bound<'_, PyAny>>,
    name: String,
    progress: Option<Py<PyAny>>,
) -> PyResult<PyLabels> {
    let points =
        |name, given: Option<&Bound<'_, PyAny>>| given.map_or(Ok(Vec::new()), |p| points_of(name, p));
    let seeds = Seeds { inside_m: points("inside_m", inside_m)?, outside_m: points("outside_m", outside_m)? };
    let volume = &image.volume;
    let found = work::done(py, progress, || {
        let found = segment_with_seeds(volume, &seeds, &SeededParams::default())?;
        tell(1.0);
        Ok(found)
    })?;
    let labels = found.mask.iter().map(|&inside| u16::from(inside)).collect();
    let map = LabelMap { grid: volume.grid.clone(), labels, names: vec![(1, name)], colours: Vec::new() };
    Ok(PyLabels { map, notes: Vec::new() })
}
