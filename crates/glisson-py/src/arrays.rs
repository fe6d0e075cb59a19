//! Between arrays of Python and what the library takes and gives.

use crate::runner::PictureKind;
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson_view::film::view::FilmView;
use numpy::ndarray::{Array, ArrayViewD, Dimension, ShapeBuilder};
use numpy::{Element, IntoPyArray, PyArray, PyArray2, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Numbers of a pose: tip (3), shaft towards the handle (3), roll, jaws, trigger.
pub(crate) const POSE_LENGTH: usize = 9;

/// An array of rows of this width, which nobody writes to.
pub(crate) fn read_only<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    width: usize,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let n_rows = values.len() / width;
    Ok(gathered(py, (n_rows, width), values)?.into_bound(py))
}

/// An array of Python's own of this shape, which nobody writes to.
pub(crate) fn gathered<T: Element, D: Dimension>(
    py: Python<'_>,
    shape: impl ShapeBuilder<Dim = D>,
    values: Vec<T>,
) -> PyResult<Py<PyArray<T, D>>> {
    let array =
        Array::from_shape_vec(shape, values).map_err(|error| PyValueError::new_err(error.to_string()))?;
    let array = array.into_pyarray(py);
    array.try_readwrite()?.make_nonwriteable();
    Ok(array.unbind())
}

/// What a picture is called, and its size, as the runner takes them.
pub(crate) fn picture_kind(view: &str, width: usize, height: usize) -> PyResult<PictureKind> {
    let view = match view {
        "outside" => FilmView::Outside,
        "endoscope" => FilmView::Endoscope,
        _ => {
            return Err(PyValueError::new_err(format!(
                "view is \"{view}\"; there are \"outside\" and \"endoscope\""
            )));
        }
    };
    Ok((view, [width, height]))
}

/// x, y, z of each.
pub(crate) fn flat(vectors: impl IntoIterator<Item = DVec3>) -> Vec<f64> {
    vectors.into_iter().flat_map(|v| v.to_array()).collect()
}

/// A pose as numbers.
pub(crate) fn numbers_of(pose: &ToolInput) -> [f64; POSE_LENGTH] {
    let [x, y, z] = pose.tip_in_world_m.to_array();
    let [u, v, w] = pose.shaft_in_world.to_array();
    [x, y, z, u, v, w, pose.roll_rad, pose.jaw_opening, pose.trigger]
}

/// Numbers as a pose; `None` where the shaft has no direction, or something is not finite.
fn pose_of(numbers: &[f64]) -> Option<ToolInput> {
    let tip_in_world_m = DVec3::from_slice(&numbers[..3]);
    let shaft_in_world = DVec3::from_slice(&numbers[3..6]).try_normalize()?;
    let [roll_rad, jaw_opening, trigger] = [numbers[6], numbers[7], numbers[8]];
    let pose = ToolInput { tip_in_world_m, shaft_in_world, roll_rad, jaw_opening, trigger };
    pose.is_finite().then_some(pose)
}

/// Poses of `n_tools` instruments in each of `n_worlds`, from an array of shape `shape` (told in what is wrong).
pub(crate) fn poses_of(
    array: &PyReadonlyArrayDyn<'_, f64>,
    (n_worlds, n_tools): (Option<usize>, usize),
) -> PyResult<Vec<Vec<ToolInput>>> {
    let view: ArrayViewD<'_, f64> = array.as_array();
    let expected: Vec<usize> = n_worlds.into_iter().chain([n_tools, POSE_LENGTH]).collect();
    if view.shape() != expected {
        return Err(PyValueError::new_err(format!(
            "poses have the shape {:?}, and {expected:?} is expected: for each instrument tip (3 numbers, m), shaft towards the handle \
             (3), roll (rad), jaws (0 closed to 1 open), trigger (0 to 1)",
            view.shape()
        )));
    }
    let numbers: Vec<f64> = view.iter().copied().collect();
    let mut poses = Vec::with_capacity(numbers.len() / POSE_LENGTH);
    for (place, of_tool) in numbers.chunks_exact(POSE_LENGTH).enumerate() {
        let pose = pose_of(of_tool).ok_or_else(|| {
            let (world, tool) = (place / n_tools, place % n_tools);
            let of = n_worlds.map_or_else(String::new, |_| format!(" of world {world}"));
            PyValueError::new_err(format!(
                "the pose of instrument {tool}{of} is not finite, or its shaft has no direction: {of_tool:?}"
            ))
        })?;
        poses.push(pose);
    }
    Ok(poses.chunks(n_tools).map(<[ToolInput]>::to_vec).collect())
}
