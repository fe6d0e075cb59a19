//! Static cases of elastic bodies.

use crate::arrays::{flat, points_of, read_only};
use crate::meshes::PyMesh;
use crate::work;
use anyhow::{Context, bail};
use glisson::material::{LawEntry, LinearElastic, MaterialSpec, law_named, law_names};
use glisson::math::DVec3;
use glisson::mesh::NodeId;
use glisson::solve::{
    BoundaryConditions, NonlinearProblem, NonlinearSettings, StaticProblem, add_gravity_forces,
    solve_nonlinear, solve_static,
};
use glisson::text::did_you_mean;
use numpy::{AllowTypeChange, PyArray2, PyArrayLikeDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// What a loaded body does, at rest.
#[pyclass(name = "Solution", module = "glisson", frozen)]
pub(crate) struct PySolution {
    displacement_m: Vec<DVec3>,
    reaction_n: Vec<DVec3>,
    /// Of the non-linear solver.
    course: Option<Course>,
}

/// How the non-linear solver went.
struct Course {
    energy_j: f64,
    residual_n: f64,
    n_load_steps: usize,
    n_iterations: usize,
}

#[pymethods]
impl PySolution {
    /// How far each node went [m], (nodes, 3).
    #[getter]
    fn displacement_m(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        Ok(read_only(py, flat(self.displacement_m.iter().copied()), 3)?.unbind())
    }

    /// What holds each node where its place is prescribed [N], (nodes, 3); 0 where it is free.
    #[getter]
    fn reaction_n(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        Ok(read_only(py, flat(self.reaction_n.iter().copied()), 3)?.unbind())
    }

    /// Elastic energy [J]; None of a linear solution.
    #[getter]
    fn energy_j(&self) -> Option<f64> {
        self.course.as_ref().map(|course| course.energy_j)
    }

    /// Force that is left unbalanced [N]; None of a linear solution.
    #[getter]
    fn residual_n(&self) -> Option<f64> {
        self.course.as_ref().map(|course| course.residual_n)
    }

    /// Steps in which the load came, and iterations of Newton's method in all; None of a linear solution.
    #[getter]
    fn iterations(&self) -> Option<(usize, usize)> {
        self.course.as_ref().map(|course| (course.n_load_steps, course.n_iterations))
    }

    fn __repr__(&self) -> String {
        let largest_m = self.displacement_m.iter().map(|u| u.length()).fold(0.0, f64::max);
        format!("<glisson.Solution, largest motion {:.3} mm>", 1e3 * largest_m)
    }
}

/// Parameters of a law, as texts: a number, a text with a unit, a direction or a list of directions.
fn parameters_of(given: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<(String, String)>> {
    let direction = |numbers: &Vec<f64>| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let mut all = Vec::new();
    for (name, value) in given.into_iter().flatten() {
        let name: String = name.extract()?;
        // Arrays of numpy are no sequences: lists of their numbers are.
        let value = if value.hasattr("tolist")? { value.call_method0("tolist")? } else { value };
        if let Ok(numbers) = value.extract::<Vec<f64>>() {
            all.push((name, direction(&numbers)));
        } else if let Ok(several) = value.extract::<Vec<Vec<f64>>>() {
            all.extend(several.iter().map(|numbers| (name.clone(), direction(numbers))));
        } else {
            all.push((name, value.str()?.to_string()));
        }
    }
    Ok(all)
}

/// A law by name with its parameters and the moduli of `linear`.
fn law_of(
    name: &str,
    parameters: &[(String, String)],
    linear: &LinearElastic,
) -> anyhow::Result<MaterialSpec> {
    let names: Vec<&str> = law_names().collect();
    let law = law_named(name).with_context(|| {
        format!("there is no law \"{name}\"{}; there are: {}", did_you_mean(name, &names), names.join(", "))
    })?;
    let law = parameters.iter().try_fold(law, |law, (key, value)| {
        law.with_text(key, value).with_context(|| format!("parameters[\"{key}\"]"))
    })?;
    if let Some(key) = law.missing() {
        let LawEntry { name, .. } = law.entry();
        bail!("the law {name} needs parameters[\"{}\"] ({})", key.name, key.about);
    }
    Ok(law.with_moduli_of(linear)?)
}

/// Places that are prescribed: displacements (nodes, 3) in m, not a number (NaN) where a node is free.
fn conditions_of(given: &Bound<'_, PyAny>, n_nodes: usize) -> PyResult<BoundaryConditions> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = given.extract()?;
    let view = array.as_array();
    if view.shape() != [n_nodes, 3] {
        return Err(PyValueError::new_err(format!(
            "prescribed_m has the shape {:?}; [{n_nodes}, 3] is expected: a displacement in m for each node, NaN where it is free",
            view.shape()
        )));
    }
    let mut conditions = BoundaryConditions::new();
    for ((node, axis), &displacement_m) in view.indexed_iter().map(|(at, u)| ((at[0], at[1]), u)) {
        if displacement_m.is_infinite() {
            return Err(PyValueError::new_err(format!("prescribed_m[{node}, {axis}] is infinite")));
        }
        if !displacement_m.is_nan() {
            conditions.impose(NodeId::from_index(node), axis, displacement_m);
        }
    }
    Ok(conditions)
}

/// How an elastic body is deformed that is held and loaded, at rest: `glisson solve`.
///
/// `prescribed_m` (nodes, 3): displacements that are prescribed, NaN for what is free. `forces_n` (nodes, 3): on each node. Weight:
/// `gravity_m_per_s2` with `density_kg_per_m3`. `law`: "linear", or a hyperelastic one with the moduli of `young_pa` and `poisson` at small
/// strain, solved by Newton's method with load steps of which the first takes `first_load_step` of the load; `parameters`: what the law
/// needs beside them, as scenes have it: `{"exponent": -4.7}`, `{"k1": "20 kPa", "fibre": [[1, 0, 0], [0, 1, 0]]}`. `progress` is called with
/// the share of the load that is reached.
///
/// Raises MeshError where the body is not held, or equilibrium is lost.
#[pyfunction]
#[pyo3(signature = (mesh, young_pa, poisson, prescribed_m, forces_n = None, *, density_kg_per_m3 = 0.0, gravity_m_per_s2 = [0.0; 3],
                    law = "linear", parameters = None, first_load_step = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn solve(
    py: Python<'_>,
    mesh: &PyMesh,
    young_pa: f64,
    poisson: f64,
    prescribed_m: &Bound<'_, PyAny>,
    forces_n: Option<&Bound<'_, PyAny>>,
    density_kg_per_m3: f64,
    gravity_m_per_s2: [f64; 3],
    law: &str,
    parameters: Option<&Bound<'_, PyDict>>,
    first_load_step: Option<f64>,
    progress: Option<Py<PyAny>>,
) -> PyResult<PySolution> {
    let mesh = mesh.mesh();
    let n_nodes = mesh.positions_m.len();
    let conditions = conditions_of(prescribed_m, n_nodes)?;
    let forces = forces_n.map(|given| points_of("forces_n", given)).transpose()?;
    let mut nodal_force_n = forces.unwrap_or_else(|| vec![DVec3::ZERO; n_nodes]);
    if nodal_force_n.len() != n_nodes {
        let found = nodal_force_n.len();
        return Err(PyValueError::new_err(format!(
            "forces_n has {found} rows; the mesh has {n_nodes} nodes"
        )));
    }
    let gravity = DVec3::from_array(gravity_m_per_s2);
    let first_load_step = first_load_step.unwrap_or(NonlinearSettings::default().first_load_step);
    if !(gravity.is_finite() && first_load_step > 0.0 && first_load_step <= 1.0) {
        let words = "gravity_m_per_s2 is three finite numbers, first_load_step above 0 and at most 1";
        return Err(PyValueError::new_err(words));
    }
    if density_kg_per_m3 == 0.0 && gravity != DVec3::ZERO {
        return Err(PyValueError::new_err(
            "gravity_m_per_s2 without density_kg_per_m3: nothing would have a weight",
        ));
    }
    let parameters = parameters_of(parameters)?;
    work::done(py, progress, || {
        // A body without weight has a density, too: one that loads nothing.
        let density = if density_kg_per_m3 == 0.0 { 1.0 } else { density_kg_per_m3 };
        let material = LinearElastic::from_young_poisson(young_pa, poisson, density)?;
        if density_kg_per_m3 != 0.0 {
            add_gravity_forces(mesh, &material, gravity, &mut nodal_force_n);
        }
        if law == "linear" && parameters.is_empty() {
            let (material, conditions, nodal_force_n) = (&material, &conditions, &nodal_force_n[..]);
            let solved = solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n })?;
            let (displacement_m, reaction_n) = (solved.displacement_m, solved.reaction_n);
            return Ok(PySolution { displacement_m, reaction_n, course: None });
        }
        let law = law_of(law, &parameters, &material)?;
        let laws = [law.material()];
        let settings = NonlinearSettings { first_load_step, ..Default::default() };
        let (laws, conditions, nodal_force_n) = (&laws[..], &conditions, &nodal_force_n[..]);
        let solved = solve_nonlinear(&NonlinearProblem { mesh, laws, conditions, nodal_force_n, settings })?;
        let course = Course {
            energy_j: solved.energy_j,
            residual_n: solved.residual_n,
            n_load_steps: solved.n_load_steps,
            n_iterations: solved.n_iterations,
        };
        let (displacement_m, reaction_n) = (solved.displacement_m, solved.reaction_n);
        Ok(PySolution { displacement_m, reaction_n, course: Some(course) })
    })
}
