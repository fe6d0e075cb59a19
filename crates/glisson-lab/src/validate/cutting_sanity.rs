//! What no cut may do to a moving body: lose or make mass, volume or energy, or leave another topology than it should.
//!
//! A block at rest is cut by a blade half way in, then by one that goes through. Another one is let go from a stretched
//! shape, undamped but for a little of stiffness damping, and is cut and loses tetrahedra while it vibrates. Energy is that of
//! deformation (ln J neo-Hookean) and of motion, with the mass of each tetrahedron at its corners.

use super::{Experiment, Figure, Outcome};
use crate::bodies::{material, nodes_where};
use glisson::material::{Material, NeoHookeLog};
use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::mesh::TetId;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::quality::MeshQuality;
use glisson::mesh::topology::{Through, Topology};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{DeformableModel, DynamicBody, FixedNode, Rayleigh};
use glisson::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};
use glisson_report::plot::{LinePlot, Series, SeriesStyle};

const BENCHMARK: &str = "T7: cutting sanity";
const SIZE_M: DVec3 = DVec3::new(0.06, 0.06, 0.04);
const CELLS: [usize; 3] = [6, 6, 4];
const STRETCH: f64 = 1.15;
/// Steps of the blade in a stroke, and steps of the body after each.
const BLADE_STEPS: usize = 20;
const STEPS_BETWEEN: usize = 8;
/// The stroke half way in: its y, and the tip's place above the bottom [m].
const HALF_WAY_M: [f64; 2] = [0.0213, 0.021];
const REMOVALS: usize = 15;
const TETS_A_REMOVAL: usize = 4;
/// Share of the longest stable step: the energy of central differences is as good as its square.
const STEP_SHARE: f64 = 0.25;
/// So many that no node has to be heavier than its tissue.
const MOST_PARTS: u32 = 1024;
const STIFFNESS_DAMPING_S: f64 = 1e-5;

/// A body that moves and is cut.
struct Body {
    mesh: EditableMesh,
    model: ExplicitKernel,
    law: NeoHookeLog,
    density_kg_per_m3: f64,
    step_s: f64,
    time_s: f64,
    /// Potential energy one step ago [J].
    earlier_j: f64,
    start_j: f64,
    /// Least energy so far, and what it grew by beyond it [J].
    least_j: f64,
    growth_j: f64,
    /// Largest change of energy in a cut by the blade, and largest growth in a removal [J].
    cut_j: f64,
    removal_j: f64,
    n_heavier: u32,
    curve: Vec<[f64; 2]>,
}

impl Body {
    fn new(stretch: f64) -> anyhow::Result<Self> {
        let material = material()?;
        let mesh = box_of_five(CELLS, SIZE_M);
        let fixed: Vec<FixedNode> =
            nodes_where(&mesh, |p| p.z < 1e-9).into_iter().map(FixedNode::all_axes).collect();
        let damping = Rayleigh { mass_per_s: 0.0, stiffness_s: STIFFNESS_DAMPING_S };
        let body = DynamicBody {
            fixed: &fixed,
            damping,
            most_parts: MOST_PARTS,
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        };
        let materials = [material];
        let params = ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, &materials);
        let step_s = STEP_SHARE * ExplicitKernel::stable_step(&params)?.step_s;
        let body = DynamicBody { time_step_s: step_s, ..body };
        let mut model = ExplicitKernel::build(&ExplicitKernelParams { body, ..params })?;
        let stretched: Vec<DVec3> =
            mesh.positions_m.iter().map(|p| DVec3::new(p.x, p.y, p.z * stretch)).collect();
        model.take_over(&stretched);
        let mut body = Self {
            mesh: EditableMesh::new(mesh)?,
            model,
            law: NeoHookeLog::from(&material),
            density_kg_per_m3: material.density_kg_per_m3(),
            step_s,
            time_s: 0.0,
            earlier_j: 0.0,
            start_j: 0.0,
            least_j: f64::INFINITY,
            growth_j: 0.0,
            cut_j: 0.0,
            removal_j: 0.0,
            n_heavier: 0,
            curve: Vec::new(),
        };
        body.earlier_j = body.potential_j();
        body.start_j = body.earlier_j;
        Ok(body)
    }

    fn potential_j(&self) -> f64 {
        let (mesh, positions_m) = (self.mesh.mesh(), self.model.state().positions_m);
        let of_tet = |tet: TetId| {
            let nodes = self.mesh.topology().tet_nodes(tet);
            let sides = |list: &[DVec3]| {
                let x = nodes.map(|n| list[n.index()]);
                DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0])
            };
            let f = sides(positions_m) * sides(&mesh.positions_m).inverse();
            self.law.energy_density_j_per_m3(&f) * mesh.tet_volume_m3(tet)
        };
        self.mesh.topology().live_tets().map(of_tet).sum()
    }

    fn kinetic_j(&self) -> f64 {
        let velocities = self.model.state().velocities_m_per_s;
        let of_tet = |tet: TetId| {
            let corner_kg = 0.25 * self.density_kg_per_m3 * self.mesh.mesh().tet_volume_m3(tet);
            let squared = self.mesh.topology().tet_nodes(tet).map(|n| velocities[n.index()].length_squared());
            0.5 * corner_kg * squared.into_iter().sum::<f64>()
        };
        self.mesh.topology().live_tets().map(of_tet).sum()
    }

    /// Makes some steps, and holds the energy of each against the least so far.
    fn run(&mut self, n_steps: usize) {
        for _ in 0..n_steps {
            self.model.step(self.step_s);
            self.time_s += self.step_s;
            let now_j = self.potential_j();
            // Velocities of central differences are those of half a step ago.
            let energy_j = 0.5 * (now_j + self.earlier_j) + self.kinetic_j();
            self.earlier_j = now_j;
            self.growth_j = self.growth_j.max(energy_j - self.least_j);
            self.least_j = self.least_j.min(energy_j);
            self.curve.push([1e3 * self.time_s, energy_j / self.start_j]);
        }
    }

    /// Makes an edit; the change of energy in it [J].
    fn edit(&mut self, edit: &MeshEdit) -> anyhow::Result<f64> {
        let before_j = self.earlier_j + self.kinetic_j();
        let change = self.mesh.apply(edit)?;
        self.model.topology_changed(self.mesh.mesh(), &change)?;
        self.earlier_j = self.potential_j();
        self.n_heavier = self.n_heavier.max(self.model.report().n_mass_scaled_nodes);
        let change_j = self.earlier_j + self.kinetic_j() - before_j;
        // The steps after it are held against what it left.
        self.least_j += change_j;
        Ok(change_j)
    }

    /// A stroke along x whose tip is at `depth_m` above the bottom, with steps of the body between those of the blade: area
    /// opened over area swept, and the smallest dihedral angle of what is new.
    fn stroke(&mut self, y_m: f64, depth_m: f64, n_steps: usize) -> anyhow::Result<(f64, f64)> {
        let quality = MeshQuality::of(&box_of_five(CELLS, SIZE_M));
        let mut cut = SubdivisionCut::new(SubdivisionParams::for_mean_edge(quality.mean_edge_m));
        for i in 0..=BLADE_STEPS {
            let x_m = -0.01 + (SIZE_M.x + 0.02) * i as f64 / BLADE_STEPS as f64;
            let blade_m = [DVec3::new(x_m, y_m, depth_m), DVec3::new(x_m, y_m, 2.0 * SIZE_M.z)];
            let positions_m = self.model.state().positions_m;
            let found = if i == BLADE_STEPS {
                cut.finish(&self.mesh, positions_m, blade_m)
            } else {
                cut.advance(&self.mesh, positions_m, blade_m)
            };
            if let Some(replacement) = found? {
                let change_j = self.edit(&MeshEdit::Replace(replacement))?;
                self.cut_j = self.cut_j.max(change_j);
            }
            self.run(n_steps);
        }
        let report = cut.report();
        Ok((report.cut_area_m2 / report.swept_area_m2, report.min_dihedral_deg))
    }

    /// Mass of all nodes [kg].
    fn mass_kg(&self) -> f64 {
        self.mesh.topology().live_nodes().map(|n| self.model.kernel().mass_kg(n)).sum()
    }

    fn euler(&self) -> [f64; 2] {
        let topology = self.mesh.topology();
        [topology.euler_characteristic() as f64, topology.surface_euler_characteristic() as f64]
    }
}

/// What is claimed of a stroke into the body at rest.
struct StrokeClaim {
    name: &'static str,
    /// Where it goes, and the tip's place above the bottom [m].
    y_m: f64,
    depth_m: f64,
    /// Euler characteristics of the body and of its surface after it.
    euler: [f64; 2],
}

const STROKES: [StrokeClaim; 2] = [
    StrokeClaim { name: "half way in", y_m: HALF_WAY_M[0], depth_m: HALF_WAY_M[1], euler: [1.0, 2.0] },
    StrokeClaim { name: "through", y_m: 0.0413, depth_m: -0.01, euler: [2.0, 4.0] },
];

fn relative(found: f64, expected: f64, whole: f64) -> f64 {
    ((found - expected) / whole).abs()
}

/// A body at rest that is cut half way in, then through.
fn at_rest() -> anyhow::Result<Vec<Experiment>> {
    let mut body = Body::new(1.0)?;
    let (volume_m3, mass_kg) = (body.mesh.volume_m3(), body.mass_kg());
    let mut list = Vec::new();
    for StrokeClaim { name, y_m, depth_m, euler: expected } in STROKES {
        let (area, angle_deg) = body.stroke(y_m, depth_m, 0)?;
        let found = body.euler();
        let about = |what: &str| format!("a stroke {name}: {what}");
        let euler =
            |what: &str, i: usize| Experiment::near(&about(what), BENCHMARK, found[i], expected[i], 0.0);
        list.extend([
            Experiment::near(&about("area opened over area swept"), BENCHMARK, area, 1.0, 0.02),
            Experiment::within(
                &about("smallest dihedral angle of what is new [deg]"),
                BENCHMARK,
                angle_deg,
                [3.0, 70.6],
            ),
            euler("Euler characteristic", 0),
            euler("that of its surface", 1),
        ]);
    }
    let n_pieces = body.mesh.topology().pieces(Through::Faces).count();
    list.extend([
        Experiment::near("pieces after both", BENCHMARK, n_pieces as f64, 2.0, 0.0),
        Experiment::at_most(
            "both strokes: change of volume, relative",
            BENCHMARK,
            relative(body.mesh.volume_m3(), volume_m3, volume_m3),
            1e-9,
        ),
        Experiment::at_most(
            "both strokes: change of the nodes' mass, relative",
            BENCHMARK,
            relative(body.mass_kg(), mass_kg, mass_kg),
            1e-9,
        ),
    ]);
    Ok(list)
}

/// Takes tetrahedra out at random, with steps of the body in between; their volume [m3].
fn remove_at_random(body: &mut Body) -> anyhow::Result<f64> {
    let mut random = SeededRandom::new(3);
    let mut removed_m3 = 0.0;
    for _ in 0..REMOVALS {
        let live: Vec<TetId> = body.mesh.topology().live_tets().collect();
        let mut tets: Vec<TetId> =
            (0..TETS_A_REMOVAL).map(|_| live[(random.next_u64() % live.len() as u64) as usize]).collect();
        tets.sort_unstable();
        tets.dedup();
        removed_m3 += tets.iter().map(|&t| body.mesh.mesh().tet_volume_m3(t)).sum::<f64>();
        let change_j = body.edit(&MeshEdit::Remove { tets })?;
        body.removal_j = body.removal_j.max(change_j);
        body.run(STEPS_BETWEEN);
    }
    Ok(removed_m3)
}

/// A body that vibrates while it is cut and loses tetrahedra; also its energy over time.
fn moving() -> anyhow::Result<([Experiment; 6], Vec<[f64; 2]>)> {
    let mut body = Body::new(STRETCH)?;
    let (volume_m3, mass_kg) = (body.mesh.volume_m3(), body.mass_kg());
    body.run(20);
    body.stroke(HALF_WAY_M[0], HALF_WAY_M[1], STEPS_BETWEEN)?;
    let removed_m3 = remove_at_random(&mut body)?;
    let experiments = [
        Experiment::at_most(
            "removals: volume that is left against that taken out, relative",
            BENCHMARK,
            relative(body.mesh.volume_m3(), volume_m3 - removed_m3, volume_m3),
            1e-9,
        ),
        Experiment::at_most(
            "removals: the nodes' mass against that taken out, relative",
            BENCHMARK,
            relative(body.mass_kg(), mass_kg - body.density_kg_per_m3 * removed_m3, mass_kg),
            1e-9,
        ),
        Experiment::at_most(
            "body moving, cuts of the blade: largest growth of energy in one (nodes near it snap), over all",
            BENCHMARK,
            body.cut_j / body.start_j,
            0.01,
        ),
        Experiment::at_most(
            "body moving, removals: largest growth of energy in one, over all",
            BENCHMARK,
            body.removal_j / body.start_j,
            1e-9,
        ),
        Experiment::at_most(
            "body moving, steps before, between and after cuts: growth of energy beyond the least, over all",
            BENCHMARK,
            body.growth_j / body.start_j,
            0.02,
        ),
        Experiment::at_most("nodes that had to be made heavier", BENCHMARK, f64::from(body.n_heavier), 0.0),
    ];
    Ok((experiments, body.curve))
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut experiments = at_rest()?;
    let (of_moving, points) = moving()?;
    experiments.extend(of_moving);
    holes(&mut experiments)?;
    let figure = Figure {
        file: "cutting_sanity_energy.svg",
        caption:
            "Energy of a vibrating block while a blade cuts it half way in and tetrahedra are taken out."
                .into(),
        plot: LinePlot {
            title: "Energy of a body that is cut".into(),
            x_label: "time [ms]".into(),
            y_label: "energy over that at the start".into(),
            series: vec![Series { name: "energy".into(), points, style: SeriesStyle::Line }],
            size: [900, 440],
        },
    };
    let notes = "20,000 random cuts, with every model: `cargo xtask soak edits`.".into();
    Ok(Outcome { experiments, figures: vec![figure], notes })
}

/// What removals leave: a cavity and a tunnel.
fn holes(list: &mut Vec<Experiment>) -> anyhow::Result<()> {
    let cell_m = SIZE_M / DVec3::new(CELLS[0] as f64, CELLS[1] as f64, CELLS[2] as f64);
    let is_in_column = |p: DVec3| (p.x / cell_m.x).floor() == 3.0 && (p.y / cell_m.y).floor() == 3.0;
    let is_in_cell = |p: DVec3| is_in_column(p) && (p.z / cell_m.z).floor() == 2.0;
    let without = |is_removed: &dyn Fn(DVec3) -> bool| -> anyhow::Result<[f64; 4]> {
        let mut mesh = EditableMesh::new(box_of_five(CELLS, SIZE_M))?;
        let center = |t: &TetId| mesh.mesh().corners_m(*t).into_iter().sum::<DVec3>() / 4.0;
        let tets = mesh.topology().live_tets().filter(|t| is_removed(center(t))).collect();
        mesh.apply(&MeshEdit::Remove { tets })?;
        let topology = mesh.topology();
        let recount = Topology::build(&mesh.live_mesh())?;
        Ok([
            topology.euler_characteristic() as f64,
            topology.surface_euler_characteristic() as f64,
            recount.euler_characteristic() as f64,
            recount.surface_euler_characteristic() as f64,
        ])
    };
    let cases: [(&str, [f64; 4], [f64; 2]); 2] =
        [("a cavity", without(&is_in_cell)?, [2.0, 4.0]), ("a tunnel", without(&is_in_column)?, [0.0, 0.0])];
    for (name, found, [solid, surface]) in cases {
        let expected = [solid, surface, solid, surface];
        let off: f64 = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).sum();
        list.push(Experiment::at_most(
            &format!(
                "removal of {name}: Euler characteristics of body and surface, followed and recounted, off by"
            ),
            BENCHMARK,
            off,
            0.0,
        ));
    }
    Ok(())
}
