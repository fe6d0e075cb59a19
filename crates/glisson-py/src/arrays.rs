//! Between arrays of Python and what the library takes and gives.

use crate::runner::PictureKind;
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson_view::film::view::FilmView;
use numpy::ndarray::{Array, ArrayViewD, Dimension, ShapeBuilder};
use numpy::{
    AllowTypeChange, Element, IntoPyArray, PyArray, PyArray2, PyArrayDescrMethods, PyArrayLikeDyn,
    PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
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

/// Points (points, 3) that a caller gave as `name`; finite.
pub(crate) fn points_of(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Vec<DVec3>> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = given.extract()?;
    let view = array.as_array();
    if view.ndim() != 2 || view.shape()[1] != 3 {
        return Err(PyValueError::new_err(format!(
            "{name} has the shape {:?}; (points, 3) is expected, in m",
            view.shape()
        )));
    }
    let points: Vec<DVec3> = view.rows().into_iter().map(|row| DVec3::new(row[0], row[1], row[2])).collect();
    match points.iter().position(|point| !point.is_finite()) {
        Some(bad) => {
            Err(PyValueError::new_err(format!("{name}[{bad}] is {}: it is not finite", points[bad])))
        }
        None => Ok(points),
    }
}

/// Rows (rows, `N`) of numbers of nodes that a caller gave as `name`; there are `n_nodes`.
pub(crate) fn rows_of<const N: usize>(
    name: &str,
    given: &Bound<'_, PyAny>,
    n_nodes: usize,
) -> PyResult<Vec<[u32; N]>> {
    let array = array_of_kind(given, b"ui")?.ok_or_else(|| {
        PyTypeError::new_err(format!("{name} are numbers of nodes: an array of whole numbers"))
    })?;
    let array: PyArrayLikeDyn<'_, i64, AllowTypeChange> = array.as_any().extract()?;
    let view = array.as_array();
    if view.ndim() != 2 || view.shape()[1] != N {
        return Err(PyValueError::new_err(format!(
            "{name} has the shape {:?}; (n, {N}) is expected",
            view.shape()
        )));
    }
    let node = |&number: &i64| u32::try_from(number).ok().filter(|&node| (node as usize) < n_nodes);
    let all: Option<Vec<u32>> = view.iter().map(node).collect();
    let all = all.ok_or_else(|| {
        let bad = view.iter().find(|number| node(number).is_none()).copied().unwrap_or_default();
        PyValueError::new_err(format!("{name} name node {bad}; there are {n_nodes}, counted from 0"))
    })?;
    Ok(all.as_chunks().0.to_vec())
}

/// What was given as an array of numbers of one of these kinds, as numpy names them; `None` where it is of another kind.
pub(crate) fn array_of_kind<'py>(
    given: &Bound<'py, PyAny>,
    kinds: &[u8],
) -> PyResult<Option<Bound<'py, PyUntypedArray>>> {
    let array =
        given.py().import("numpy")?.call_method1("asarray", (given,))?.cast_into::<PyUntypedArray>()?;
    let is_empty = array.len() == 0;
    Ok((is_empty || kinds.contains(&array.dtype().kind())).then_some(array))
}

/// What a JSON text says, as Python has it.
pub(crate) fn from_json(py: Python<'_>, text: &str) -> PyResult<Py<PyAny>> {
    Ok(py.import("json")?.call_method1("loads", (text,))?.unbind())
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
