//! Three tubes held at both ends under the same load: isotropic, with fibres along the axis, with fibres twice as
//! stiff (seed `002`, fig. 6). A fourth, with fibres across, shows that it is the direction that matters.
//!
//! Uniaxial tension along a fibre: S = E_L e a (x) a with E_L = E + 2 kappa and e the Green-St Venant strain along
//! it, at any stretch, because the lateral strains are those of the isotropic tube.

use super::{Claim, Figure, Outcome, check_all, series};
use crate::bodies::{
    LAMBDA_PA, MU_PA, TissuePoints, cylinder, displaced, isotropic, material, most, nodes_where,
    nonlinear_equilibrium, spread_over,
};
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::model::nonlinear_tensor_mass::{Fibre, NonlinearElasticity};
use glisson::solve::BoundaryConditions;
use glisson_report::plot::{LinePlot, SeriesStyle};

const SEED: &str = "Picinbono, Delingette and Ayache 2000, RR-4028, fig. 6";
const EXACT: &str = "exact: uniaxial tension, E_L = E + 2 kappa";
const RADIUS_M: f64 = 0.01;
const HEIGHT_M: f64 = 0.1;
const N_TETS: usize = 2_500;
/// Sideways forces [N] at a third and two thirds of the height, opposite to each other.
const FORCE_N: f64 = 0.12;
/// E_L over E of the middle tube; the right one's is twice that.
const ALONG_OVER_ACROSS: f64 = 5.0;
/// Half height of the rings that are loaded [m].
const RING_M: f64 = 0.006;
/// Distance between the tubes in the figure [m].
const APART_M: f64 = 0.05;

/// A tube and its fibres.
struct Tube {
    name: &'static str,
    /// E_L over E, and the direction.
    fibre: Option<(f64, DVec3)>,
}

const TUBES: [Tube; 4] = [
    Tube { name: "isotropic", fibre: None },
    Tube { name: "fibres along the axis", fibre: Some((ALONG_OVER_ACROSS, DVec3::Z)) },
    Tube { name: "fibres twice as stiff", fibre: Some((2.0 * ALONG_OVER_ACROSS, DVec3::Z)) },
    Tube { name: "fibres across", fibre: Some((ALONG_OVER_ACROSS, DVec3::Y)) },
];

impl Tube {
    fn fibres(&self, material: &LinearElastic, n_tets: usize) -> Vec<Fibre> {
        let of = |(ratio, direction): (f64, DVec3)| {
            let kappa_pa = 0.5 * (ratio - 1.0) * material.young_modulus_pa();
            Fibre { lambda_along_pa: LAMBDA_PA, mu_along_pa: MU_PA + kappa_pa, direction }
        };
        self.fibre.map_or_else(Vec::new, |fibre| vec![of(fibre); n_tets])
    }
}

/// What became of a tube.
struct Shape {
    /// Largest sideways displacement of the axis [m].
    sideways_m: f64,
    /// Stretch of the axis, less 1.
    axis_strain: f64,
    /// How much narrower the loaded section at a third of the height is in the direction of its force, over its
    /// width.
    squeeze: f64,
    /// Outline [m].
    outline_m: Vec<DVec3>,
}

impl Shape {
    fn squeeze_share(&self) -> f64 {
        self.squeeze / self.axis_strain
    }
}

fn shape(mesh: &TetMesh, displacement_m: &[DVec3]) -> Shape {
    let nodes_m = displaced(mesh, displacement_m);
    let line = |x_m: f64| (0..=60).map(move |i| DVec3::new(x_m, 0.0, HEIGHT_M * f64::from(i) / 60.0));
    let points = |list: Vec<DVec3>| TissuePoints::new(mesh, &list).at(mesh, &nodes_m);
    let axis_m = points(line(0.0).collect());
    let inside_m = RADIUS_M * (1.0 - 1e-3);
    let mut outline_m = points(line(-inside_m).collect());
    outline_m.extend(points(line(inside_m).collect()).into_iter().rev());
    outline_m.push(outline_m[0]);
    let across =
        points(vec![DVec3::new(-inside_m, 0.0, HEIGHT_M / 3.0), DVec3::new(inside_m, 0.0, HEIGHT_M / 3.0)]);
    let length_m: f64 = axis_m.windows(2).map(|w| w[0].distance(w[1])).sum();
    Shape {
        sideways_m: most(axis_m.iter().map(|p| p.x.abs())),
        axis_strain: length_m / HEIGHT_M - 1.0,
        squeeze: 1.0 - across[0].distance(across[1]) / (2.0 * inside_m),
        outline_m,
    }
}

/// Energy of a bar with fibres along it, pulled to 1.2 of its length, over the exact one, less 1.
fn tension_error(material: &LinearElastic) -> anyhow::Result<f64> {
    let (size_m, stretch) = (DVec3::new(0.02, 0.02, 0.05), 1.2);
    let mesh = box_of_five([2, 2, 4], size_m);
    let mut conditions = BoundaryConditions::new();
    for axis in 0..3 {
        for node in nodes_where(&mesh, |p| p[axis] < 1e-9) {
            conditions.impose(node, axis, 0.0);
        }
    }
    for node in nodes_where(&mesh, |p| p.z > size_m.z - 1e-9) {
        conditions.impose(node, 2, (stretch - 1.0) * size_m.z);
    }
    let fibres = TUBES[1].fibres(material, mesh.tetrahedra.len());
    let elasticity = NonlinearElasticity { fibres: &fibres, ..isotropic(material) };
    let force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let found_j = nonlinear_equilibrium(&mesh, &elasticity, &conditions, &force_n)?.energy_j;
    let strain = 0.5 * (stretch * stretch - 1.0);
    let along_pa = ALONG_OVER_ACROSS * material.young_modulus_pa();
    Ok((found_j / (0.5 * along_pa * strain * strain * mesh.volume_m3()) - 1.0).abs())
}

/// What the experiments judge.
struct Measured {
    tension_error: f64,
    /// As `TUBES`.
    shapes: [Shape; 4],
}

impl Measured {
    /// Stretch of the axis of one tube over that of another.
    fn stretch(&self, one: usize, other: usize) -> f64 {
        self.shapes[one].axis_strain / self.shapes[other].axis_strain
    }

    /// The same of the sideways displacement.
    fn sideways(&self, one: usize, other: usize) -> f64 {
        self.shapes[one].sideways_m / self.shapes[other].sideways_m
    }
}

/// Places in `TUBES`.
const PLAIN: usize = 0;
const ALONG: usize = 1;
const STIFF: usize = 2;
const ACROSS: usize = 3;

const CLAIMS: &[Claim<'_, Measured>] = &[
    Claim::at_most("bar with fibres, stretch 1.2: energy, relative", EXACT, |m| m.tension_error, 1e-8),
    Claim::within(
        "stretch of the axis: fibres along it over isotropic",
        SEED,
        |m| m.stretch(ALONG, PLAIN),
        [0.0, 0.9],
    ),
    Claim::within(
        "stretch of the axis: fibres twice as stiff over fibres",
        SEED,
        |m| m.stretch(STIFF, ALONG),
        [0.0, 0.9],
    ),
    Claim::within(
        "sideways displacement: fibres along the axis over isotropic",
        SEED,
        |m| m.sideways(ALONG, PLAIN),
        [0.0, 0.9],
    ),
    Claim::within(
        "sideways displacement: fibres twice as stiff over fibres",
        SEED,
        |m| m.sideways(STIFF, ALONG),
        [0.0, 0.95],
    ),
    Claim::within(
        "squeeze over stretch of the axis: fibres along it over fibres twice as stiff",
        SEED,
        |m| m.shapes[ALONG].squeeze_share() / m.shapes[STIFF].squeeze_share(),
        [0.0, 0.9],
    ),
    Claim::within(
        "sideways displacement: fibres across over isotropic",
        "control: they are not stretched",
        |m| m.sideways(ACROSS, PLAIN),
        [0.9, 1.1],
    ),
];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let material = material()?;
    let mesh = cylinder(RADIUS_M, HEIGHT_M, N_TETS)?;
    let measured =
        Measured { shapes: bent_shapes(&mesh, &material)?, tension_error: tension_error(&material)? };
    let experiments = check_all(CLAIMS, &measured);
    Ok(Outcome {
        experiments,
        figures: vec![outlines(&measured.shapes)],
        notes: notes(&mesh, &measured.shapes),
    })
}

/// The tubes under the two forces.
fn bent_shapes(mesh: &TetMesh, material: &LinearElastic) -> anyhow::Result<[Shape; 4]> {
    let margin_m = 0.02 * HEIGHT_M;
    let fixed = nodes_where(mesh, |p| p.z < margin_m || p.z > HEIGHT_M - margin_m);
    let ring = |z_m: f64| nodes_where(mesh, |p| (p.z - z_m).abs() < RING_M);
    let mut force_n = spread_over(mesh, &ring(HEIGHT_M / 3.0), DVec3::X * FORCE_N)?;
    let upper_n = spread_over(mesh, &ring(HEIGHT_M * 2.0 / 3.0), DVec3::X * -FORCE_N)?;
    force_n.iter_mut().zip(&upper_n).for_each(|(f, other)| *f += *other);
    let conditions = BoundaryConditions::fixed(&fixed);
    let bent = |tube: &Tube| -> anyhow::Result<Shape> {
        let fibres = tube.fibres(material, mesh.tetrahedra.len());
        let elasticity = NonlinearElasticity { fibres: &fibres, ..isotropic(material) };
        let solution = nonlinear_equilibrium(mesh, &elasticity, &conditions, &force_n)?;
        Ok(shape(mesh, &solution.displacement_m))
    };
    let [plain, along, stiff, across] = &TUBES;
    Ok([bent(plain)?, bent(along)?, bent(stiff)?, bent(across)?])
}

fn outlines(shapes: &[Shape; 4]) -> Figure {
    let outline = |(i, (tube, shape)): (usize, (&Tube, &Shape))| {
        let points = shape.outline_m.iter().map(|p| [1e3 * (p.x + APART_M * i as f64), 1e3 * p.z]);
        series(tube.name, points.collect(), SeriesStyle::Line)
    };
    let plot = LinePlot {
        title: "Tubes under the same two forces".into(),
        x_label: "x, tubes side by side [mm]".into(),
        y_label: "z [mm]".into(),
        series: TUBES.iter().zip(shapes).enumerate().map(outline).collect(),
        size: [900, 600],
    };
    let caption =
        "Outlines of the tubes, held at both ends, pulled to the right at a third and to the left at two \
                   thirds of their height."
            .to_owned();
    Figure { file: "tubes_shapes.svg", caption, plot }
}

fn notes(mesh: &TetMesh, shapes: &[Shape; 4]) -> String {
    let mut rows = String::new();
    for (tube, shape) in TUBES.iter().zip(shapes) {
        rows += &format!(
            "| {} | {:.1} | {:.2} | {:.2} | {:.2} | {:.1} |\n",
            tube.name,
            tube.fibre.map_or(1.0, |(ratio, _)| ratio),
            1e3 * shape.sideways_m,
            100.0 * shape.axis_strain,
            100.0 * shape.squeeze,
            shape.squeeze_share(),
        );
    }
    format!(
        "Tubes of {} mm radius and {} mm height, {} tetrahedra, lambda = 4 mu, held at both ends; {} N to the right at a \
         third of the height, as much to the left at two thirds. The report gives neither sizes nor loads nor moduli.\n\n\
         | tube | E_L/E | sideways displacement of the axis [mm] | stretch of the axis [%] | squeeze of the loaded \
         section [%] | squeeze over stretch |\n|---|---|---|---|---|---|\n{rows}\n\
         Agrees: the isotropic tube takes the snake-like shape; fibres along the axis stiffen it so that it is stretched \
         less, stiffer ones more so, and what remains of its deformation is more and more a squeeze across the fibres. \
         Fibres across the tube change little.",
        1e3 * RADIUS_M,
        1e3 * HEIGHT_M,
        mesh.tetrahedra.len(),
        FORCE_N,
    )
}
