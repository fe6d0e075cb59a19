//! Surfaces and tetrahedral meshes as arrays, and how good they are.

use crate::arrays::{flat, from_json, points_of, read_only, rows_of};
use crate::images::{Label, PyLabels};
use crate::work;
use anyhow::bail;
use glisson::math::DVec3;
use glisson::mesh::checked::{MeshCheck, SurfaceCheck};
use glisson::mesh::faults::{ImportPolicy, ImportReport};
use glisson::mesh::files::{FieldPlace, FieldValues, VtuField, read_mesh_with, write_mesh, write_vtu_with};
use glisson::mesh::generate::{MeshParams, USUAL_TETRAHEDRA, WantedSize, generate};
use glisson::mesh::quality::surface_triangles;
use glisson::mesh::{NodeId, TetMesh};
use glisson::progress::part;
use glisson::surface::TriMesh;
use glisson::surface::check::orient_outward;
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use glisson::surface::files::{read_surface_with, write_surface};
use glisson::units::LengthUnit;
use numpy::{AllowTypeChange, PyArray2, PyArrayLikeDyn};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

fn unit_of(unit: &str) -> PyResult<LengthUnit> {
    unit.parse().map_err(|error| PyValueError::new_err(format!("unit: {error}")))
}

/// A surface of triangles, in the patient frame LPS.
#[pyclass(name = "Surface", module = "glisson", frozen)]
pub(crate) struct PySurface {
    mesh: TriMesh,
}

#[pymethods]
impl PySurface {
    /// A surface of vertices (vertices, 3) in m and triangles (triangles, 3) of their numbers, counter-clockwise seen from outside.
    #[new]
    fn new(positions_m: &Bound<'_, PyAny>, triangles: &Bound<'_, PyAny>) -> PyResult<Self> {
        let positions_m = points_of("positions_m", positions_m)?;
        let triangles = rows_of::<3>("triangles", triangles, positions_m.len())?;
        Ok(Self { mesh: TriMesh { positions_m, triangles } })
    }

    /// Reads STL, OBJ, PLY, VTK, VTP or glTF; `unit`: what its numbers are (glTF: always m), mm, cm, m or inch.
    #[staticmethod]
    #[pyo3(signature = (path, unit = "mm"))]
    fn load(py: Python<'_>, path: PathBuf, unit: &str) -> PyResult<Self> {
        let unit = unit_of(unit)?;
        let mesh = work::done(py, None, || Ok(read_surface_with(&path, unit)?))?;
        Ok(Self { mesh })
    }

    /// Writes it in mm; the ending tells how (.stl, .obj, .ply, .vtk and others).
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        work::done(py, None, || Ok(write_surface(&path, &self.mesh)?))
    }

    /// Places of its vertices [m], (vertices, 3).
    #[getter]
    fn positions_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        Ok(read_only(py, flat(self.mesh.positions_m.iter().copied()), 3)?.unbind())
    }

    /// Vertices of its triangles, (triangles, 3).
    #[getter]
    fn triangles(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        Ok(read_only(py, self.mesh.triangles.as_flattened().to_vec(), 3)?.unbind())
    }

    /// What it encloses [m3]; below 0 where it is inside out.
    #[getter]
    fn volume_m3(&self) -> f64 {
        self.mesh.volume_m3()
    }

    fn __repr__(&self) -> String {
        let (n, volume_ml) = (self.mesh.triangles.len(), 1e6 * self.mesh.volume_m3());
        format!("<glisson.Surface, {n} triangles, {volume_ml:.1} ml>")
    }
}

/// A mesh of tetrahedra, in the patient frame LPS.
#[pyclass(name = "Mesh", module = "glisson", frozen)]
pub(crate) struct PyMesh {
    mesh: TetMesh,
    import: ImportReport,
}

/// Values at the nodes or in the tetrahedra of a mesh.
struct Field {
    name: String,
    place: FieldPlace,
    numbers: Vec<f64>,
    vectors: Vec<DVec3>,
}

impl Field {
    fn as_vtu(&self) -> VtuField<'_> {
        let vectors = || FieldValues::Vectors(&self.vectors);
        let values = if self.vectors.is_empty() { FieldValues::Scalars(&self.numbers) } else { vectors() };
        VtuField { name: &self.name, place: self.place, values }
    }
}

impl PyMesh {
    pub(crate) fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// A field of this mesh; its length tells what it lies on.
    fn field(&self, name: String, given: &Bound<'_, PyAny>) -> PyResult<Field> {
        let (n_nodes, n_tets) = (self.mesh.positions_m.len(), self.mesh.tetrahedra.len());
        let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = given.extract()?;
        let view = array.as_array();
        let place = match view.shape().first() {
            Some(&n) if n == n_nodes => FieldPlace::Nodes,
            Some(&n) if n == n_tets => FieldPlace::Tets,
            _ => {
                return Err(PyValueError::new_err(format!(
                    "the field {name} has the shape {:?}; the mesh has {n_nodes} nodes and {n_tets} tetrahedra",
                    view.shape()
                )));
            }
        };
        let numbers: Vec<f64> = view.iter().copied().collect();
        match view.shape() {
            [_] => Ok(Field { name, place, numbers, vectors: Vec::new() }),
            [_, 3] => {
                let vectors = numbers.as_chunks().0.iter().copied().map(DVec3::from_array).collect();
                Ok(Field { name, place, numbers: Vec::new(), vectors })
            }
            shape => Err(PyValueError::new_err(format!(
                "the field {name} has the shape {shape:?}: one number, or three, for each node or tetrahedron is expected"
            ))),
        }
    }
}

#[pymethods]
impl PyMesh {
    /// A mesh of nodes (nodes, 3) in m and tetrahedra (tetrahedra, 4) of their numbers. Tetrahedra that are inside out are turned; what else
    /// is wrong `glisson.check` tells.
    #[new]
    fn new(py: Python<'_>, positions_m: &Bound<'_, PyAny>, tetrahedra: &Bound<'_, PyAny>) -> PyResult<Self> {
        let positions_m = points_of("positions_m", positions_m)?;
        let tetrahedra = rows_of::<4>("tetrahedra", tetrahedra, positions_m.len())?;
        let tetrahedra = tetrahedra.into_iter().map(|tet| tet.map(NodeId)).collect();
        work::done(py, None, || {
            let mut mesh = TetMesh { positions_m, tetrahedra, ..TetMesh::default() };
            let import = ImportReport::import(&mut mesh, &ImportPolicy::default(), "the mesh")?;
            Ok(Self { mesh, import })
        })
    }

    /// Reads VTK (.vtu, .vtk), Gmsh, FEBio, Abaqus, TetGen or a plain list; `unit`: what its numbers are, mm, cm, m or inch.
    #[staticmethod]
    #[pyo3(signature = (path, unit = "mm"))]
    fn load(py: Python<'_>, path: PathBuf, unit: &str) -> PyResult<Self> {
        let policy = ImportPolicy { unit: unit_of(unit)?, ..ImportPolicy::default() };
        let (mesh, import) = work::done(py, None, || Ok(read_mesh_with(&path, &policy)?))?;
        Ok(Self { mesh, import })
    }

    /// Writes it in mm; the ending tells how (.vtu, .vtk, .msh).
    ///
    /// `fields`: values at nodes or in tetrahedra by name, arrays of one number, or of three, for each; a .vtu file takes them, and keeps
    /// them in their own units.
    #[pyo3(signature = (path, fields = None))]
    fn save(&self, py: Python<'_>, path: PathBuf, fields: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let Some(fields) = fields.filter(|fields| !fields.is_empty()) else {
            return work::done(py, None, || Ok(write_mesh(&path, &self.mesh)?));
        };
        let fields: Vec<Field> = fields
            .iter()
            .map(|(name, values)| self.field(name.extract()?, &values))
            .collect::<PyResult<_>>()?;
        let fields: Vec<VtuField<'_>> = fields.iter().map(Field::as_vtu).collect();
        work::done(py, None, || {
            if path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("vtu")) {
                bail!("{}: fields are written to .vtu files", path.display());
            }
            Ok(write_vtu_with(&path, &self.mesh, &fields)?)
        })
    }

    /// Places of its nodes [m], (nodes, 3).
    #[getter]
    fn positions_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        Ok(read_only(py, flat(self.mesh.positions_m.iter().copied()), 3)?.unbind())
    }

    /// Nodes of its tetrahedra, (tetrahedra, 4).
    #[getter]
    fn tetrahedra(&self, py: Python<'_>) -> PyResult<Py<PyArray2<u32>>> {
        let nodes = self.mesh.tetrahedra.iter().flatten().map(|node| node.0).collect();
        Ok(read_only(py, nodes, 4)?.unbind())
    }

    /// Its volume [m3].
    #[getter]
    fn volume_m3(&self) -> f64 {
        self.mesh.volume_m3()
    }

    /// Its surface; the vertices are the nodes that it has, in their order.
    fn surface(&self) -> PySurface {
        let (triangles, _) = surface_triangles(&self.mesh);
        PySurface { mesh: TriMesh::over(&self.mesh.positions_m, &triangles) }
    }

    fn __repr__(&self) -> String {
        let (n, nodes) = (self.mesh.tetrahedra.len(), self.mesh.positions_m.len());
        format!("<glisson.Mesh, {n} tetrahedra, {nodes} nodes, {:.1} ml>", 1e6 * self.mesh.volume_m3())
    }
}

/// The closed surface of an organ in a label map: of the voxels' volume, one ball, smoothed.
///
/// `label`: a name or number, several with + between them; without one the liver, or the only label. `parts`: with the vessels and tumours
/// inside it. `triangles`: thin it out to so many. `cut_at_border`: close an organ that the border of the image cuts off with a flat face.
#[pyfunction]
#[pyo3(signature = (labels, label = None, *, parts = true, triangles = None, cut_at_border = false, progress = None))]
pub(crate) fn surface_of(
    py: Python<'_>,
    labels: &PyLabels,
    label: Option<Label>,
    parts: bool,
    triangles: Option<usize>,
    cut_at_border: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<PySurface> {
    let params =
        SurfaceParams { target_triangles: triangles, cap_at_border: cut_at_border, ..Default::default() };
    let mesh = work::done(py, progress, || {
        let organ = labels.organ(label.as_ref(), parts)?;
        Ok(surface_of_mask(&organ.grid, &organ.mask, &params)?.0)
    })?;
    Ok(PySurface { mesh })
}

/// A mesh of tetrahedra that fills a closed `Surface`, or an organ of `Labels`: `glisson mesh`.
///
/// `tetrahedra`: how many, met within 5 %, 6,300 unless told; or `edge_m`: the mean edge of those inside. Its volume is the surface's, or
/// the label's, within 0.1 %. For labels `label`, `parts`, `triangles` and `cut_at_border` are as for `surface_of`; a surface that is inside
/// out is turned. Raises MeshError where the surface is not closed, or too thin for tetrahedra of this size.
#[pyfunction]
#[pyo3(signature = (source, tetrahedra = None, *, edge_m = None, label = None, parts = true, triangles = None,
                    cut_at_border = false, progress = None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn mesh(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    tetrahedra: Option<usize>,
    edge_m: Option<f64>,
    label: Option<Label>,
    parts: bool,
    triangles: Option<usize>,
    cut_at_border: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<PyMesh> {
    let size = match (tetrahedra, edge_m) {
        (Some(_), Some(_)) => return Err(PyValueError::new_err("give tetrahedra or edge_m, and not both")),
        (None, Some(edge_m)) => WantedSize::EdgeM(edge_m),
        (n, None) => WantedSize::Tetrahedra(n.unwrap_or(USUAL_TETRAHEDRA)),
    };
    let filled = |surface: &TriMesh, volume_m3| Ok(generate(surface, &MeshParams { size, volume_m3 })?.0);
    let mesh = if let Ok(surface) = source.cast::<PySurface>() {
        if label.is_some() || !parts || triangles.is_some() || cut_at_border {
            let words = "label, parts, triangles and cut_at_border are for Labels, not for a Surface";
            return Err(PyValueError::new_err(words));
        }
        let given = &surface.get().mesh;
        work::done(py, progress, || {
            let mut surface = TriMesh::over(&given.positions_m, &given.triangles);
            orient_outward(&mut surface)?;
            filled(&surface, None)
        })?
    } else if let Ok(labels) = source.cast::<PyLabels>() {
        let labels = labels.get();
        let params =
            SurfaceParams { target_triangles: triangles, cap_at_border: cut_at_border, ..Default::default() };
        work::done(py, progress, || {
            let organ = labels.organ(label.as_ref(), parts)?;
            let surface = part(0.0, 0.3, || surface_of_mask(&organ.grid, &organ.mask, &params))?.0;
            part(0.3, 1.0, || filled(&surface, Some(organ.volume_m3)))
        })?
    } else {
        let kind = source.get_type().name()?;
        return Err(PyTypeError::new_err(format!("a {kind} cannot be meshed: give a Surface, or Labels")));
    };
    Ok(PyMesh { mesh, import: ImportReport::default() })
}

/// How good a `Mesh` or a `Surface` is: `glisson check --json`, a dictionary, with `problems`: what makes it unfit, in words, none where it
/// is fit.
#[pyfunction]
pub(crate) fn check(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<Py<PyAny>> {
    let value = if let Ok(mesh) = source.cast::<PyMesh>() {
        let mesh = mesh.get();
        work::done(py, None, || {
            let (checked, problems) = MeshCheck::of(&mesh.mesh, &mesh.import);
            let mut value = serde_json::to_value(&checked)?;
            value["problems"] = problems.into();
            Ok(value)
        })?
    } else if let Ok(surface) = source.cast::<PySurface>() {
        let surface = &surface.get().mesh;
        work::done(py, None, || {
            let (checked, _) = SurfaceCheck::of(surface);
            let mut value = serde_json::to_value(&checked)?;
            value["problems"] = value["faults"].clone();
            Ok(value)
        })?
    } else {
        let kind = source.get_type().name()?;
        return Err(PyTypeError::new_err(format!("a {kind} cannot be checked: give a Mesh or a Surface")));
    };
    from_json(py, &value.to_string())
}
