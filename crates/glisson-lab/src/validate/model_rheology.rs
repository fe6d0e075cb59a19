//! Every dynamic model on the virtual rheology bench (seed `000` s. 2.3.4): a cube between sliding plates, and a
//! flat punch.

use super::{Experiment, Figure, Outcome, series};
use glam::{DMat3, DVec3};
use glisson::material::{LinearElastic, Material, NeoHookeLog, StVenantKirchhoff};
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::cube_of_five;
use glisson::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use glisson::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use glisson::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson::model::rheology::experiments::{
    DENSITY_KG_PER_M3, ForceOperations, POISSON_RATIO, SIDE_M, YOUNG_MODULUS_PA, seed_material,
};
use glisson::model::rheology::{
    IndentationTest, PlateContact, PlateOutcome, PlateTest, indent, indentation_nodes, measured_modulus_pa,
    press_between_plates,
};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{DeformableModel, DynamicBody, Integration, Rayleigh};
use glisson::solve::{BoundaryConditions, StaticProblem, solve_static};
use glisson_report::plot::{LinePlot, Series, SeriesStyle};

/// Damping over mass of all models on the bench [1/s].
pub(super) const BENCH_DAMPING_PER_S: f64 = 30.0;

/// The dynamic models, with the law that each moves by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BenchModel {
    TensorMass,
    NonlinearTensorMass,
    ExtendedMassSpring,
    ExtendedMassSpringNeoHooke,
    MassSpring,
    Implicit,
}

/// A body of known law under uniaxial stress.
#[derive(Clone, Copy, Debug)]
enum Law {
    Linear,
    StVenantKirchhoff,
    NeoHooke,
}

/// Share of the stable step at rest that explicit models take: pressed to three quarters, none becomes twice as stiff.
const STEP_SHARE: f64 = 0.5;

/// Residual at which an implicit step ends: smaller than in use, so that the law shows and not the solver.
const IMPLICIT_TOLERANCE: f64 = 1e-6;

impl BenchModel {
    pub(super) const ALL: [Self; 6] = [
        Self::TensorMass,
        Self::NonlinearTensorMass,
        Self::ExtendedMassSpring,
        Self::ExtendedMassSpringNeoHooke,
        Self::MassSpring,
        Self::Implicit,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::TensorMass => "tensor-mass, linear",
            Self::NonlinearTensorMass => "tensor-mass, St Venant-Kirchhoff",
            Self::ExtendedMassSpring => "extended mass-spring, St Venant-Kirchhoff",
            Self::ExtendedMassSpringNeoHooke => "extended mass-spring, neo-Hooke",
            Self::MassSpring => "mass-spring",
            Self::Implicit => "implicit Euler, neo-Hooke",
        }
    }

    /// Whether a rotated body moves as the body at rest does.
    pub(super) fn is_rotation_invariant(self) -> bool {
        self != Self::TensorMass
    }

    pub(super) fn is_implicit(self) -> bool {
        self == Self::Implicit
    }

    /// Operations of one evaluation of its forces, where they are counted.
    pub(super) fn operations(self, counted: &ForceOperations) -> Option<usize> {
        match self {
            Self::TensorMass => Some(counted.linear_tensor_mass),
            Self::NonlinearTensorMass => Some(counted.tensor_mass),
            Self::ExtendedMassSpring => Some(counted.extended_mass_spring),
            _ => None,
        }
    }

    fn law(self) -> Option<Law> {
        match self {
            Self::TensorMass => Some(Law::Linear),
            Self::NonlinearTensorMass | Self::ExtendedMassSpring => Some(Law::StVenantKirchhoff),
            Self::ExtendedMassSpringNeoHooke | Self::Implicit => Some(Law::NeoHooke),
            Self::MassSpring => None,
        }
    }

    /// The model of the seed's material, without supports and gravity, and its step [s]: half the stable one of
    /// tensor-mass, or less.
    pub(super) fn build(
        self,
        mesh: &TetMesh,
        damping_per_s: f64,
    ) -> anyhow::Result<(Box<dyn DeformableModel>, f64)> {
        let material = &seed_material()?;
        let step_s = STEP_SHARE * TensorMass::stable_step(mesh, material)?.step_s;
        let body = DynamicBody {
            damping: Rayleigh::of_mass(damping_per_s),
            time_step_s: step_s,
            ..DynamicBody::new(mesh, material.density_kg_per_m3())
        };
        let model: Box<dyn DeformableModel> = match self {
            Self::TensorMass => Box::new(TensorMass::build(&TensorMassParams { body, material })?),
            Self::NonlinearTensorMass => {
                let elasticity = NonlinearElasticity {
                    material,
                    fibres: &[],
                    volume_penalty_pa: 0.0,
                    largest_stretch: 1.0,
                };
                Box::new(NonlinearTensorMass::build(&NonlinearTensorMassParams { body, elasticity })?)
            }
            Self::ExtendedMassSpring => return extended(EdgeLaw::StVenantKirchhoff, body),
            Self::ExtendedMassSpringNeoHooke => return extended(EdgeLaw::NeoHooke, body),
            Self::MassSpring => return mass_spring(body),
            Self::Implicit => {
                let law = &ImplicitLaw::neo_hooke(material);
                let params =
                    ImplicitParams { tolerance: IMPLICIT_TOLERANCE, ..ImplicitParams::new(body, law) };
                Box::new(ImplicitEuler::build(&params)?)
            }
        };
        Ok((model, step_s))
    }
}

/// The extended mass-spring model in a step of at most `body.time_step_s` and a share of its own stable one.
fn extended(law: EdgeLaw, body: DynamicBody<'_>) -> anyhow::Result<(Box<dyn DeformableModel>, f64)> {
    let material = &seed_material()?;
    let build = |time_step_s| {
        let (body, integration) = (DynamicBody { time_step_s, ..body }, Integration::default());
        let params =
            ExtendedMassSpringParams { body, law, material, viscosity_kg_per_m3_s: 0.0, integration };
        ExtendedMassSpring::build(&params)
    };
    let stable_s = build(0.01 * body.time_step_s)?.stable_step_s();
    let step_s = body.time_step_s.min(STEP_SHARE * stable_s);
    Ok((Box::new(build(step_s)?), step_s))
}

/// The mass-spring model in a step of at most `body.time_step_s` and a share of its own stable one.
fn mass_spring(body: DynamicBody<'_>) -> anyhow::Result<(Box<dyn DeformableModel>, f64)> {
    let build = |time_step_s| {
        MassSpring::build(&MassSpringParams {
            body: DynamicBody { time_step_s, ..body },
            young_modulus_pa: YOUNG_MODULUS_PA,
            masses: NodalMasses::VolumeWeighted,
            link_damping_n_s_per_m: 0.001,
            node_damping_n_s_per_m: 0.0,
            integration: Integration::default(),
        })
    };
    let stable_s = build(0.01 * body.time_step_s)?.stable_step_s();
    let step_s = body.time_step_s.min(STEP_SHARE * stable_s);
    Ok((Box::new(build(step_s)?), step_s))
}

/// Nominal stress [Pa] of a bar at this stretch whose sides are free.
pub(super) fn free_sided_stress_pa(law: &dyn Material, stretch: f64) -> f64 {
    let stress = |t: f64| law.first_piola_pa(&DMat3::from_diagonal(DVec3::new(stretch, t, t)));
    // The side that pulls is too wide: between half and twice the width of constant volume.
    let (mut low, mut high) = (0.5 / stretch.sqrt(), 2.0 / stretch.sqrt());
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if stress(middle).y_axis.y < 0.0 { low = middle } else { high = middle }
    }
    stress(0.5 * (low + high)).x_axis.x
}

impl Law {
    fn nominal_stress_pa(self, material: &LinearElastic, stretch: f64) -> f64 {
        match self {
            Self::Linear => material.young_modulus_pa() * (stretch - 1.0),
            Self::StVenantKirchhoff => free_sided_stress_pa(&StVenantKirchhoff::from(material), stretch),
            Self::NeoHooke => free_sided_stress_pa(&NeoHookeLog::from(material), stretch),
        }
    }
}

const N_NODES: usize = 5;
const AREA_M2: f64 = SIDE_M * SIDE_M;
const SMALL: f64 = 0.99;
const LARGE: f64 = 0.76;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    plates(&mut outcome)?;
    punch(&mut outcome)?;
    Ok(outcome)
}

fn press(which: BenchModel, mesh: &TetMesh) -> anyhow::Result<PlateOutcome> {
    let (mut model, step_s) = which.build(mesh, BENCH_DAMPING_PER_S)?;
    let stretches: Vec<f64> = (1..=24).map(|i| 1.0 - 0.01 * f64::from(i)).collect();
    let test = PlateTest {
        mesh,
        axis: 2,
        contact: PlateContact::Sliding,
        density_kg_per_m3: DENSITY_KG_PER_M3,
        damping_per_s: BENCH_DAMPING_PER_S,
        speed_m_per_s: 0.005,
        ramp_s: 0.2,
        step_s,
        stretches: &stretches,
        hold_s: 0.5,
    };
    Ok(press_between_plates(&mut *model, &test))
}

/// A cube between plates in one model.
struct Pressed {
    which: BenchModel,
    /// Modulus at `SMALL` and at `LARGE` [Pa]: measured, and that of the model's law if it has one.
    measured_pa: [f64; 2],
    expected_pa: [Option<f64>; 2],
    plates: PlateOutcome,
}

impl Pressed {
    fn new(which: BenchModel, mesh: &TetMesh, material: &LinearElastic) -> anyhow::Result<Self> {
        let plates = press(which, mesh)?;
        let (first, last) = (plates.readings[0], plates.readings[plates.readings.len() - 1]);
        let measured_pa = [first, last].map(|r| measured_modulus_pa(r, AREA_M2));
        let own =
            |stretch: f64| which.law().map(|law| law.nominal_stress_pa(material, stretch) / (stretch - 1.0));
        Ok(Self { which, measured_pa, expected_pa: [own(SMALL), own(LARGE)], plates })
    }

    fn check(&self) -> Vec<Experiment> {
        let mut experiments = Vec::new();
        // On the way the plate's waves are in the reading, and viscosity of all nodes.
        for (i, (what, tolerance)) in [("1 %", 0.02), ("24 %", 0.005)].into_iter().enumerate() {
            let Some(expected_pa) = self.expected_pa[i] else { continue };
            experiments.push(Experiment::near(
                &format!("plates, {}: measured modulus at {what} [Pa]", self.which.name()),
                "exact: the law in uniaxial stress",
                self.measured_pa[i],
                expected_pa,
                tolerance,
            ));
        }
        experiments
    }

    /// Its line of the table.
    fn row(&self) -> String {
        let kpa = |pa: Option<f64>| pa.map_or("-".to_owned(), |pa| format!("{:.3}", 1e-3 * pa));
        let readings = &self.plates.readings;
        format!(
            "| {} | {} | {} | {} | {} | {} |\n",
            self.which.name(),
            kpa(Some(self.measured_pa[0])),
            kpa(self.expected_pa[0]),
            kpa(Some(self.measured_pa[1])),
            kpa(self.expected_pa[1]),
            readings[readings.len() - 1].n_inverted
        )
    }

    /// Force over compression on the way.
    fn curve(&self) -> Series {
        let readings = &self.plates.readings;
        let moving = readings[..readings.len() - 1].iter();
        let points = moving.map(|r| [100.0 * (1.0 - r.stretch), -r.force_n]).collect();
        series(self.which.name(), points, SeriesStyle::Line)
    }
}

fn plates(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mesh = cube_of_five(N_NODES, SIDE_M);
    let material = seed_material()?;
    outcome.notes += "### Plane compression\n\nThe 50 mm cube of 320 tetrahedra (E 20 kPa, nu 0.3) between sliding plates at 5 mm/s. The measured modulus is \
                      (force/area)/(displacement/length) [kPa], at 1 % on the way and at 24 % after a rest; beside it that of \
                      the law itself in uniaxial stress.\n\n| model | at 1 % | law | at 24 % | law | inverted |\n|---|---|---|---|---|---|\n";
    let mut curves = Vec::new();
    for which in BenchModel::ALL {
        let pressed = Pressed::new(which, &mesh, &material)?;
        outcome.experiments.extend(pressed.check());
        outcome.notes += &pressed.row();
        if which != BenchModel::ExtendedMassSpring && which != BenchModel::ExtendedMassSpringNeoHooke {
            curves.push(pressed.curve());
        }
    }
    outcome.notes += "\nMass-spring has no law of its own to compare with. The two extended mass-spring models are other arithmetic for the \
                      same elements: their curves lie on those of tensor-mass and implicit Euler of the same law.\n\n";
    outcome.figures.push(Figure {
        file: "model_rheology_plates.svg",
        caption: "The same cube pressed in each model. St Venant-Kirchhoff softens, neo-Hooke stiffens, springs do neither well."
            .into(),
        plot: LinePlot {
            title: "Plane compression in each model".into(),
            x_label: "compression [%]".into(),
            y_label: "force [N]".into(),
            series: curves,
            size: [960, 540],
        },
    });
    Ok(())
}

fn punch(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mesh = cube_of_five(N_NODES, SIDE_M);
    let material = seed_material()?;
    let test = |step_s: f64| IndentationTest {
        mesh: &mesh,
        axis: 2,
        radius_m: 0.014,
        depth_m: 0.001,
        press_s: 0.3,
        hold_s: 1.0,
        step_s,
    };
    let mut conditions = BoundaryConditions::new();
    let nodes = indentation_nodes(&test(1e-3));
    for &(node, share) in &nodes {
        conditions.impose_node(node, DVec3::Z * (-1e-3 * share));
    }
    let nodal_force_n = &vec![DVec3::ZERO; mesh.positions_m.len()];
    let (problem_mesh, problem_material, conditions) = (&mesh, &material, &conditions);
    let statics = solve_static(&StaticProblem {
        mesh: problem_mesh,
        material: problem_material,
        conditions,
        nodal_force_n,
    })?;
    let under_punch = nodes.iter().filter(|(_, share)| *share > 0.0);
    let static_n: f64 = under_punch.map(|(node, _)| -statics.reaction_n[node.index()].z).sum();
    outcome.notes += &format!(
        "### Indentation\n\nA flat punch of 14 mm radius, 1 mm deep, nodes sticking to it, the cube's lower side held. Linear statics of the same mesh: \
         {static_n:.4} N.\n\n| model | force [N] | modulus of a half space (Sneddon) [kPa] |\n|---|---|---|\n"
    );
    for which in BenchModel::ALL {
        let (mut model, step_s) = which.build(&mesh, BENCH_DAMPING_PER_S)?;
        let test = test(step_s);
        let found = indent(&mut *model, &test);
        outcome.notes += &format!(
            "| {} | {:.4} | {:.2} |\n",
            which.name(),
            found.force_n,
            1e-3 * found.half_space_modulus_pa(&test, POISSON_RATIO)
        );
        let tolerance = match which.law() {
            Some(Law::Linear) => 1e-3,
            // A depth of a quarter of an element is no small strain.
            Some(_) => 0.05,
            None => continue,
        };
        outcome.experiments.push(Experiment::near(
            &format!("punch, {}: force [N]", which.name()),
            "linear statics of the same mesh and supports",
            found.force_n,
            static_n,
            tolerance,
        ));
    }
    outcome.notes += "\nThe half space is the wrong body for a cube 3.6 punch radii deep and wide with 13 nodes under the punch: the figure says \
                      how a measurement that assumes one would read.\n";
    Ok(())
}
