//! The static benchmarks: each a function of the mesh's refinement and the kind of tetrahedra.

use super::bodies::{hold, mapped_box, mean, nodes_where, sphere_octant, surface_forces};
use glisson::material::{LinearElastic, Material, MooneyRivlin, NeoHookeLog, StVenantKirchhoff};
use glisson::math::{DMat3, DVec3};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::solve::{
    BoundaryConditions, FreeSystem, MeshEdges, NonlinearProblem, NonlinearSettings, SmoothedBody, Smoothing,
    StaticProblem, StiffnessTensors, TangentKind, add_gravity_forces, node_deformation_gradients,
    solve_nonlinear, solve_nonlinear_smoothed, solve_static, solve_static_smoothed,
};

/// What the tetrahedra do with their strain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Tetrahedra {
    /// Constant in each.
    Plain,
    /// Averaged.
    Smoothed(Smoothing),
}

const TINY_M: f64 = 1e-9;

fn linear(problem: &StaticProblem<'_>, kind: Tetrahedra) -> anyhow::Result<Vec<DVec3>> {
    Ok(match kind {
        Tetrahedra::Plain => solve_static(problem)?,
        Tetrahedra::Smoothed(smoothing) => solve_static_smoothed(problem, smoothing)?,
    }
    .displacement_m)
}

fn finite<M: Material>(
    mesh: &TetMesh,
    law: M,
    conditions: &BoundaryConditions,
    nodal_force_n: &[DVec3],
    kind: Tetrahedra,
) -> anyhow::Result<Vec<DVec3>> {
    let settings = NonlinearSettings { residual_tolerance: RESIDUAL, ..NonlinearSettings::default() };
    let problem = NonlinearProblem { mesh, laws: &[law], conditions, nodal_force_n, settings };
    Ok(match kind {
        Tetrahedra::Plain => solve_nonlinear(&problem)?,
        Tetrahedra::Smoothed(smoothing) => solve_nonlinear_smoothed(&problem, smoothing)?,
    }
    .displacement_m)
}

/// Far below what a mesh promises.
const RESIDUAL: f64 = 1e-7;

/// M11: radial displacement [mm] of the inner nodes, mean, of a sphere of 10 to 20 mm under 1 kPa inside; E 10 kPa,
/// nu 0.49.
pub(super) fn thick_sphere_mm(n: usize, kind: Tetrahedra) -> anyhow::Result<(usize, f64)> {
    let mesh = sphere_octant([10e-3, 20e-3], n, (4 * n).div_ceil(5));
    let material = LinearElastic::from_young_poisson(10e3, 0.49, 1000.0)?;
    let mut conditions = BoundaryConditions::new();
    for axis in 0..3 {
        hold(&mut conditions, &nodes_where(&mesh, |p| p[axis] < TINY_M), axis);
    }
    let is_inner = |p: DVec3| p.length() < 10e-3 + TINY_M;
    let nodal_force_n = surface_forces(&mesh, is_inner, |area_m2| -1e3 * area_m2);
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let u_m = linear(&problem, kind)?;
    let outward_m = |n: usize| u_m[n].dot(mesh.positions_m[n].normalize());
    Ok((mesh.positions_m.len(), 1e3 * mean(&nodes_where(&mesh, is_inner), outward_m)))
}

/// B5: Cook's membrane, one cell thick in plane strain: upward displacement [mm] of the middle and of the upper end of
/// the loaded side. E 70 MPa, 6.25 N/mm2 of shear on that side.
pub(super) fn cook_mm(n: usize, poisson_ratio: f64, kind: Tetrahedra) -> anyhow::Result<(usize, [f64; 2])> {
    let thickness_m = 48e-3 / n as f64;
    let mesh = mapped_box([n, n, 1], |p| {
        let (low, high) = (44.0 * p.x, 44.0 + 16.0 * p.x);
        DVec3::new(48e-3 * p.x, 1e-3 * (low + (high - low) * p.y), thickness_m * p.z)
    });
    let material = LinearElastic::from_young_poisson(70e6, poisson_ratio, 1000.0)?;
    let mut conditions = BoundaryConditions::fixed(&nodes_where(&mesh, |p| p.x == 0.0));
    hold(&mut conditions, &nodes_where(&mesh, |_| true), 2);
    let is_loaded = |p: DVec3| p.x > 48e-3 - TINY_M;
    let nodal_force_n = surface_forces(&mesh, is_loaded, |area_m2| DVec3::Y * (6.25e6 * area_m2.length()));
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let u_m = linear(&problem, kind)?;
    let rises_mm = |y_m: f64| {
        let nodes = nodes_where(&mesh, |p| is_loaded(p) && (p.y - y_m).abs() < TINY_M);
        1e3 * mean(&nodes, |n| u_m[n].y)
    };
    Ok((mesh.positions_m.len(), [rises_mm(52e-3), rises_mm(60e-3)]))
}

/// B6: the thick elliptic plate NAFEMS LE10: sigma_yy [MPa] at D, mean of the tetrahedra there and extrapolated to it,
/// with `n` cells through the thickness.
pub(super) fn thick_plate_mpa(n: usize, kind: Tetrahedra) -> anyhow::Result<(usize, [f64; 2])> {
    let mesh = mapped_box([2 * n, 3 * n, n], |p| {
        let angle = (1.0 - p.y) * std::f64::consts::FRAC_PI_2;
        let (inner, outer) = ([2.0, 1.0], [3.25, 2.75]);
        let semi_axis = |k: usize| outer[k] + (inner[k] - outer[k]) * p.x;
        // Exactly zero on the planes of symmetry.
        let (cos, sin) = if p.y == 0.0 { (0.0, 1.0) } else { (angle.cos(), angle.sin()) };
        DVec3::new(semi_axis(0) * cos, semi_axis(1) * sin, 0.6 * (p.z - 0.5))
    });
    let material = LinearElastic::from_young_poisson(210e9, 0.3, 1000.0)?;
    let mut conditions = BoundaryConditions::new();
    for axis in 0..2 {
        hold(&mut conditions, &nodes_where(&mesh, |p| p[axis] == 0.0), axis);
    }
    let is_outer = |p: DVec3| (p.x / 3.25).powi(2) + (p.y / 2.75).powi(2) > 1.0 - 1e-9;
    for axis in 0..2 {
        hold(&mut conditions, &nodes_where(&mesh, is_outer), axis);
    }
    hold(&mut conditions, &nodes_where(&mesh, |p| is_outer(p) && p.z.abs() < TINY_M), 2);
    let nodal_force_n = surface_forces(&mesh, |p| p.z > 0.3 - TINY_M, |area_m2| -1e6 * area_m2);
    let problem = StaticProblem {
        mesh: &mesh,
        material: &material,
        conditions: &conditions,
        nodal_force_n: &nodal_force_n,
    };
    let u_m = linear(&problem, kind)?;
    let d = nodes_where(&mesh, |p| p.distance(DVec3::new(2.0, 0.0, 0.3)) < 1e-6);
    anyhow::ensure!(d.len() == 1, "one node at D, found {}", d.len());
    let gradients = node_deformation_gradients(&mesh, &u_m)?;
    let stress_pa = |n: usize| material.first_piola_pa(&gradients[n]).y_axis.y;
    let at_d_pa = [stress_pa(d[0].index()), extrapolated(&mesh, d[0], stress_pa)?];
    Ok((mesh.positions_m.len(), at_d_pa.map(|pa| 1e-6 * pa)))
}

/// A node's value from node averages. An average over tetrahedra belongs to their common centroid, which for a node
/// on the surface lies inside: a linear field is fitted to the averages of the node and its two rings of neighbours
/// at those centroids (after the patch recovery of Zienkiewicz and Zhu).
fn extrapolated(mesh: &TetMesh, node: NodeId, average: impl Fn(usize) -> f64) -> anyhow::Result<f64> {
    let mut moment = vec![(DVec3::ZERO, 0.0); mesh.positions_m.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let volume_m3 = mesh.tet_volume_m3(TetId::from_index(t));
        let centroid_m = nodes.iter().map(|n| mesh.positions_m[n.index()]).sum::<DVec3>() / 4.0;
        for n in nodes {
            moment[n.index()].0 += centroid_m * volume_m3;
            moment[n.index()].1 += volume_m3;
        }
    }
    let mut near = vec![node];
    for _ in 0..2 {
        let touching = mesh.tetrahedra.iter().filter(|nodes| nodes.iter().any(|n| near.contains(n)));
        let mut wider: Vec<NodeId> = touching.flatten().copied().collect();
        wider.sort_unstable();
        wider.dedup();
        near = wider;
    }
    // Normal equations of value = c0 + c . (x - x_node).
    let mut rows = [[0.0; 5]; 4];
    let scale_m = near
        .iter()
        .map(|n| mesh.positions_m[n.index()].distance(mesh.positions_m[node.index()]))
        .fold(0.0, f64::max);
    for n in &near {
        let (sum, volume_m3) = moment[n.index()];
        let at = (sum / volume_m3 - mesh.positions_m[node.index()]) / scale_m;
        let basis = [1.0, at.x, at.y, at.z];
        for i in 0..4 {
            for j in 0..4 {
                rows[i][j] += basis[i] * basis[j];
            }
            rows[i][4] += basis[i] * average(n.index());
        }
    }
    // Positive definite: Gauss-Jordan without pivoting.
    for pivot in 0..4 {
        anyhow::ensure!(rows[pivot][pivot] > 1e-9, "the neighbours of a node lie in a plane");
        let row = rows[pivot].map(|x| x / rows[pivot][pivot]);
        for i in 0..4 {
            let factor = if i == pivot { 0.0 } else { rows[i][pivot] };
            for j in 0..5 {
                rows[i][j] -= factor * row[j];
            }
        }
        rows[pivot] = row;
    }
    Ok(rows[0][4])
}

fn cantilever(n: usize) -> anyhow::Result<(TetMesh, LinearElastic, BoundaryConditions)> {
    let mesh = mapped_box([n, n, 7 * n + 1], |p| DVec3::new(0.02 * p.x, 0.02 * p.y, 0.2 * p.z));
    let material = LinearElastic::from_young_poisson(2e6, 0.45, 1100.0)?;
    let conditions = BoundaryConditions::fixed(&nodes_where(&mesh, |p| p.z == 0.0));
    Ok((mesh, material, conditions))
}

/// B1: how far the tip of a neo-Hooke cantilever of 20 x 20 x 200 mm sinks [mm] under its weight; `n` cells in
/// height. E 2 MPa, nu 0.45, 1100 kg/m3.
pub(super) fn cantilever_mm(n: usize, kind: Tetrahedra) -> anyhow::Result<(usize, f64)> {
    let (mesh, material, conditions) = cantilever(n)?;
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(&mesh, &material, DVec3::new(0.0, -9.81, 0.0), &mut nodal_force_n);
    let u_m = finite(&mesh, NeoHookeLog::from(&material), &conditions, &nodal_force_n, kind)?;
    let tip = nodes_where(&mesh, |p| p.z > 0.2 - TINY_M);
    Ok((mesh.positions_m.len(), -1e3 * mean(&tip, |n| u_m[n].y)))
}

/// B1: lowest frequency [Hz] of the same cantilever at rest, with lumped masses: inverse iteration.
pub(super) fn cantilever_hz(n: usize, kind: Tetrahedra) -> anyhow::Result<(usize, f64)> {
    let (mesh, material, conditions) = cantilever(n)?;
    let n_nodes = mesh.positions_m.len();
    let (edges, tensors) = match kind {
        Tetrahedra::Plain => {
            let edges = MeshEdges::of_mesh(&mesh)?;
            let tensors = StiffnessTensors::assemble(&mesh, &edges, &material)?;
            (edges, tensors)
        }
        Tetrahedra::Smoothed(smoothing) => {
            let laws = [material];
            let body = SmoothedBody::new(&mesh, &laws, smoothing)?;
            let mut tensors = StiffnessTensors {
                vertex: vec![DMat3::ZERO; n_nodes],
                edge: vec![DMat3::ZERO; body.pairs().nodes.len()],
            };
            body.stiffness_into(&vec![DVec3::ZERO; n_nodes], TangentKind::Exact, &mut tensors);
            (body.pairs().clone(), tensors)
        }
    };
    let system = FreeSystem::new(&edges, &tensors, &conditions)?;
    let factor = system.factorize()?;
    let mut scratch = factor.scratch(1);
    // A quarter of each tetrahedron's mass at its corners, as the weight of a unit gravity.
    let mut mass_kg = vec![DVec3::ZERO; n_nodes];
    add_gravity_forces(&mesh, &material, DVec3::ONE, &mut mass_kg);
    let mut free_mass_kg = vec![0.0; system.n_free()];
    system.gather_into(&mass_kg, &mut free_mass_kg);
    let mut shape = free_mass_kg.clone();
    let mut squared_per_s2 = 0.0;
    for _ in 0..INVERSE_ITERATIONS {
        // The Rayleigh quotient of K^-1 M x, in the norm of M.
        let right: Vec<f64> = shape.iter().zip(&free_mass_kg).map(|(x, m)| x * m).collect();
        let mut next = right.clone();
        factor.solve_in_place(&mut next, 1, &mut scratch);
        let energy: f64 = next.iter().zip(&right).map(|(x, f)| x * f).sum();
        let inertia: f64 = next.iter().zip(&free_mass_kg).map(|(x, m)| m * x * x).sum();
        squared_per_s2 = energy / inertia;
        let scale = inertia.sqrt().recip();
        shape = next.into_iter().map(|x| x * scale).collect();
    }
    Ok((n_nodes, squared_per_s2.sqrt() / std::f64::consts::TAU))
}

/// The second bending frequency is 6.3 times the first: the error falls by 1600 an iteration.
const INVERSE_ITERATIONS: usize = 8;

/// B2: where the tip of the PDMS rod comes to lie, (y, z) [mm]: radius 4.25 mm, 182 mm long, Mooney-Rivlin, under
/// its weight; `n` cells across. The polygon of the section has the circle's area (and so, to 0.1 %, its second moment).
pub(super) fn rod_tip_mm(n: usize, kind: Tetrahedra) -> anyhow::Result<(usize, [f64; 2])> {
    let sides = 4 * n;
    let corner = std::f64::consts::TAU / sides as f64;
    let radius_m = 4.25e-3 * (corner / corner.sin()).sqrt();
    let mesh = mapped_box([n, n, 10 * n], |p| {
        let disc = disc_of_square(2.0 * p.x - 1.0, 2.0 * p.y - 1.0);
        DVec3::new(radius_m * disc[0], radius_m * disc[1], 0.182 * p.z)
    });
    let law = MooneyRivlin::new(101_709.668, 151_065.46, 1e7)?;
    // Only its density counts.
    let weight = LinearElastic::from_young_poisson(1.0, 0.0, 965.0)?;
    let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(&mesh, &weight, DVec3::new(0.0, -9.81, 0.0), &mut nodal_force_n);
    let conditions = BoundaryConditions::fixed(&nodes_where(&mesh, |p| p.z == 0.0));
    let u_m = finite(&mesh, law, &conditions, &nodal_force_n, kind)?;
    let tip = nodes_where(&mesh, |p| p.z > 0.182 - TINY_M);
    let at = |axis: usize| 1e3 * mean(&tip, |n| (mesh.positions_m[n] + u_m[n])[axis]);
    Ok((mesh.positions_m.len(), [at(1), at(2)]))
}

/// A square [-1, 1]^2 as the unit disc: concentric squares become circles, evenly in angle.
fn disc_of_square(x: f64, y: f64) -> [f64; 2] {
    let radius = x.abs().max(y.abs());
    if radius == 0.0 {
        return [0.0, 0.0];
    }
    let quarter = std::f64::consts::FRAC_PI_4;
    if x.abs() > y.abs() {
        let angle = quarter * y / x;
        [x * angle.cos(), x * angle.sin()]
    } else {
        let angle = quarter * x / y;
        [y * angle.sin(), y * angle.cos()]
    }
}

/// B4: how far the tip of a thin cantilever, 10 x 1 x 0.1, sinks and comes back (W, U) under an end force of 4; E
/// 1.2e6, nu 0 (no units); `n` cells in height.
pub(super) fn large_shear(n: usize, kind: Tetrahedra) -> anyhow::Result<(usize, [f64; 2])> {
    let mesh = mapped_box([30 * n, 2, n], |p| DVec3::new(10.0 * p.x, p.y, 0.1 * p.z));
    let material = LinearElastic::from_young_poisson(1.2e6, 0.0, 1.0)?;
    let conditions = BoundaryConditions::fixed(&nodes_where(&mesh, |p| p.x == 0.0));
    let is_tip = |p: DVec3| p.x > 10.0 - TINY_M;
    let nodal_force_n = surface_forces(&mesh, is_tip, |area_m2| DVec3::Z * (40.0 * area_m2.length()));
    let u_m = finite(&mesh, StVenantKirchhoff::from(&material), &conditions, &nodal_force_n, kind)?;
    let tip = nodes_where(&mesh, is_tip);
    Ok((mesh.positions_m.len(), [mean(&tip, |n| u_m[n].z), -mean(&tip, |n| u_m[n].x)]))
}
