//! A virtual rheology bench (seed `000` s. 2.3.4): plates and punches that act on any [`DeformableModel`] through
//! imposed displacements, and the sum of the reactions.
//!
//! A plate holds its nodes along its axis. Where the nodes slide, the bench moves them across the axis itself, by
//! semi-implicit Euler with their lumped masses and the reactions that the model reports. The model sees ordinary imposed
//! displacements.

pub mod experiments;

use super::{Constraints, DeformableModel, ImposedDisplacement};
use glisson_mesh::math::{Aabb, DVec3, is_inverted, tetrahedron_volume_m3};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// How a plate holds its nodes across its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlateContact {
    /// The nodes stick to the plate.
    Sticking,
    /// The nodes slide without friction.
    Sliding,
}

/// A body between two plates: the lower one rests, the upper one moves along the axis.
#[derive(Clone, Copy, Debug)]
pub struct PlateTest<'a> {
    /// The body at rest, a box along the axes.
    pub mesh: &'a TetMesh,
    /// Axis of the test: 0, 1 or 2.
    pub axis: usize,
    /// Both plates.
    pub contact: PlateContact,
    /// Density for the masses of sliding nodes [kg/m3].
    pub density_kg_per_m3: f64,
    /// Damping over mass of sliding nodes [1/s].
    pub damping_per_s: f64,
    /// Speed of the upper plate [m/s], positive.
    pub speed_m_per_s: f64,
    /// Time in which the plate reaches its speed [s]: a jolt would excite vibrations.
    pub ramp_s: f64,
    /// Step [s].
    pub step_s: f64,
    /// Stretches (length over rest length) at which to read the force, moving away from 1; the last one ends the motion.
    pub stretches: &'a [f64],
    /// How long the plate rests afterwards before the last reading [s].
    pub hold_s: f64,
}

/// The readings at one position of the upper plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateReading {
    /// Length over rest length.
    pub stretch: f64,
    /// Force of the upper plate on the body along the axis [N]; positive pulls.
    pub force_n: f64,
    /// Tetrahedra that stand inverted or flat.
    pub n_inverted: usize,
}

/// Result of a plate test.
#[derive(Clone, Debug, PartialEq)]
pub struct PlateOutcome {
    /// A reading for each of [`PlateTest::stretches`] and one after the hold.
    pub readings: Vec<PlateReading>,
    /// Stretch at which a tetrahedron was first seen inverted.
    pub first_inversion: Option<f64>,
}

/// Young's modulus [Pa] that a force at a stretch of a bar stands for: (force/area)/(displacement/length) (seed
/// `000` eq. 2.8).
pub fn measured_modulus_pa(reading: PlateReading, area_m2: f64) -> f64 {
    reading.force_n / area_m2 / (reading.stretch - 1.0)
}

/// Steps between checks for inversions.
const INVERSION_INTERVAL: u64 = 20;

/// Runs a plate test on a model of the test's mesh, at rest and without supports of its own on the plates.
///
/// # Panics
/// When the axis is not 0, 1 or 2, or no stretch is given.
pub fn press_between_plates(model: &mut dyn DeformableModel, test: &PlateTest<'_>) -> PlateOutcome {
    let bounds = Aabb::of_points(&test.mesh.positions_m);
    let (low_m, length_m) = (bounds.min_m[test.axis], bounds.size_m()[test.axis]);
    let &last = test.stretches.last().expect("a test has readings");
    let at = |share: f64| (low_m + share * length_m, 1e-9 * length_m);
    let driven = |(plane_m, tolerance_m): (f64, f64), share: f64| {
        let near = move |p: &DVec3| (p[test.axis] - plane_m).abs() <= tolerance_m;
        let on_plane = test.mesh.positions_m.iter().enumerate().filter(move |(_, p)| near(p));
        on_plane.map(move |(n, _)| (NodeId::from_index(n), share))
    };
    let nodes: Vec<(NodeId, f64)> = driven(at(0.0), 0.0).chain(driven(at(1.0), 1.0)).collect();
    let mut rig = Rig::new(test.mesh, nodes, test.axis, test.density_kg_per_m3);
    rig.slides = test.contact == PlateContact::Sliding;
    rig.damping_per_s = test.damping_per_s;

    let direction = if last > 1.0 { 1.0 } else { -1.0 };
    let mut outcome = PlateOutcome { readings: Vec::new(), first_inversion: None };
    let (mut driven_m, mut time_s, mut steps) = (0.0, 0.0, 0u64);
    for &wanted in test.stretches {
        let target_m = (wanted - 1.0) * length_m;
        while (target_m - driven_m) * direction > 0.0 {
            time_s += test.step_s;
            let share = (time_s / test.ramp_s).min(1.0);
            let way_m = direction * test.speed_m_per_s * share * test.step_s;
            // The last step before a reading is shorter, so that the reading is at the requested stretch.
            driven_m =
                if direction > 0.0 { target_m.min(driven_m + way_m) } else { target_m.max(driven_m + way_m) };
            rig.advance(model, driven_m, test.step_s);
            steps += 1;
            if outcome.first_inversion.is_none()
                && steps.is_multiple_of(INVERSION_INTERVAL)
                && n_inverted(test.mesh, model.state().positions_m) > 0
            {
                outcome.first_inversion = Some(1.0 + driven_m / length_m);
            }
        }
        outcome.readings.push(rig.reading(test, model, wanted));
    }
    let hold_steps = (test.hold_s / test.step_s).ceil() as u64;
    for _ in 0..hold_steps {
        rig.advance(model, driven_m, test.step_s);
    }
    if hold_steps > 0 {
        outcome.readings.push(rig.reading(test, model, last));
    }
    if outcome.first_inversion.is_none() {
        outcome.first_inversion = outcome.readings.iter().find(|r| r.n_inverted > 0).map(|r| r.stretch);
    }
    outcome
}

/// A flat round punch pressed into the upper side of a body whose lower side is held; nodes stick to both.
#[derive(Clone, Copy, Debug)]
pub struct IndentationTest<'a> {
    /// The body at rest, a box along the axes.
    pub mesh: &'a TetMesh,
    /// Axis of the test: 0, 1 or 2.
    pub axis: usize,
    /// Radius of the punch [m], about the middle of the upper side.
    pub radius_m: f64,
    /// Depth [m].
    pub depth_m: f64,
    /// Time of the descent, which is smooth [s].
    pub press_s: f64,
    /// Time to wait before the reading [s].
    pub hold_s: f64,
    /// Step [s].
    pub step_s: f64,
}

/// Result of an indentation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndentationOutcome {
    /// Force of the punch into the body [N].
    pub force_n: f64,
    /// Nodes under the punch.
    pub n_nodes: usize,
    /// Tetrahedra that stand inverted or flat.
    pub n_inverted: usize,
}

impl IndentationOutcome {
    /// Young's modulus [Pa] of a half space with the same resistance to a flat punch: F (1 - nu^2)/(2 a d) (I. N. Sneddon 1965,
    /// doi 10.1016/0020-7225(65)90019-4). A body that is shallow compared with the punch seems stiffer, a mesh with few nodes
    /// under the punch softer.
    pub fn half_space_modulus_pa(&self, test: &IndentationTest<'_>, poisson_ratio: f64) -> f64 {
        self.force_n * (1.0 - poisson_ratio * poisson_ratio) / (2.0 * test.radius_m * test.depth_m)
    }
}

/// The nodes of an indentation: those of the held side with 0, those under the punch with 1; ascending.
pub fn indentation_nodes(test: &IndentationTest<'_>) -> Vec<(NodeId, f64)> {
    let bounds = Aabb::of_points(&test.mesh.positions_m);
    let tolerance_m = 1e-9 * bounds.size_m()[test.axis];
    let role = |p: &DVec3| {
        let mut off_m = *p - bounds.center_m();
        off_m[test.axis] = 0.0;
        if p[test.axis] - bounds.min_m[test.axis] <= tolerance_m {
            Some(0.0)
        } else if bounds.max_m[test.axis] - p[test.axis] <= tolerance_m
            && off_m.length() <= test.radius_m + tolerance_m
        {
            Some(1.0)
        } else {
            None
        }
    };
    let of_node = |(n, p): (usize, &DVec3)| role(p).map(|share| (NodeId::from_index(n), share));
    test.mesh.positions_m.iter().enumerate().filter_map(of_node).collect()
}

/// Runs an indentation on a model of the test's mesh, at rest.
pub fn indent(model: &mut dyn DeformableModel, test: &IndentationTest<'_>) -> IndentationOutcome {
    let nodes = indentation_nodes(test);
    let n_nodes = nodes.iter().filter(|(_, share)| *share > 0.0).count();
    let mut rig = Rig::new(test.mesh, nodes, test.axis, 0.0);
    let n_steps = ((test.press_s + test.hold_s) / test.step_s).ceil() as u64;
    for step in 1..=n_steps {
        let t = (step as f64 * test.step_s / test.press_s).min(1.0);
        rig.advance(model, -test.depth_m * t * t * (3.0 - 2.0 * t), test.step_s);
    }
    IndentationOutcome {
        force_n: -rig.force_n,
        n_nodes,
        n_inverted: n_inverted(test.mesh, model.state().positions_m),
    }
}

/// How many tetrahedra of a mesh stand inverted or flat at these positions.
pub fn n_inverted(mesh: &TetMesh, positions_m: &[DVec3]) -> usize {
    let volume_m3 = |nodes: &[NodeId; 4]| tetrahedron_volume_m3(nodes.map(|n| positions_m[n.index()]));
    mesh.tetrahedra.iter().filter(|nodes| is_inverted(volume_m3(nodes))).count()
}

/// Mass of each node [kg]: a quarter of each tetrahedron's to each of its corners.
pub fn lumped_masses_kg(mesh: &TetMesh, density_kg_per_m3: f64) -> Vec<f64> {
    let mut masses_kg = vec![0.0; mesh.positions_m.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let share_kg = density_kg_per_m3 * mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
        for node in nodes {
            masses_kg[node.index()] += share_kg;
        }
    }
    masses_kg
}

/// The nodes that the bench holds, and how they are held across the axis.
struct Rig {
    axis: usize,
    /// Share of the driven displacement of each node: 0 for the support, 1 for the tool.
    shares: Vec<f64>,
    masses_kg: Vec<f64>,
    slides: bool,
    damping_per_s: f64,
    across_m: Vec<DVec3>,
    across_m_per_s: Vec<DVec3>,
    constraints: Constraints,
    /// Sum over the tool's nodes, along the axis.
    force_n: f64,
}

impl Rig {
    fn new(mesh: &TetMesh, mut nodes: Vec<(NodeId, f64)>, axis: usize, density_kg_per_m3: f64) -> Self {
        nodes.sort_unstable_by_key(|(node, _)| *node);
        let masses_kg = lumped_masses_kg(mesh, density_kg_per_m3);
        let at_rest = |&(node, _): &(NodeId, f64)| ImposedDisplacement { node, displacement_m: DVec3::ZERO };
        let displacements = nodes.iter().map(at_rest).collect();
        Self {
            axis,
            shares: nodes.iter().map(|(_, share)| *share).collect(),
            masses_kg: nodes.iter().map(|(node, _)| masses_kg[node.index()]).collect(),
            slides: false,
            damping_per_s: 0.0,
            across_m: vec![DVec3::ZERO; nodes.len()],
            across_m_per_s: vec![DVec3::ZERO; nodes.len()],
            constraints: Constraints { displacements, forces: Vec::new() },
            force_n: 0.0,
        }
    }

    fn advance(&mut self, model: &mut dyn DeformableModel, driven_m: f64, h_s: f64) {
        for (i, imposed) in self.constraints.displacements.iter_mut().enumerate() {
            imposed.displacement_m = self.across_m[i];
            imposed.displacement_m[self.axis] = driven_m * self.shares[i];
        }
        model.apply(&self.constraints);
        model.step(h_s);
        self.force_n = 0.0;
        for (i, reaction_n) in model.constraint_forces_n().iter().enumerate() {
            self.force_n += self.shares[i] * reaction_n[self.axis];
            if self.slides {
                let v = self.across_m_per_s[i];
                let mut v = v + h_s * (-*reaction_n / self.masses_kg[i] - self.damping_per_s * v);
                v[self.axis] = 0.0;
                self.across_m_per_s[i] = v;
                self.across_m[i] += h_s * v;
            }
        }
    }

    fn reading(&self, test: &PlateTest<'_>, model: &dyn DeformableModel, stretch: f64) -> PlateReading {
        let n_inverted = n_inverted(test.mesh, model.state().positions_m);
        PlateReading { stretch, force_n: self.force_n, n_inverted }
    }
}
