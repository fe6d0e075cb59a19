//! `glisson solve`.

use std::path::PathBuf;

use anyhow::{Context, bail};
use glisson::material::{LawChoice, LinearElastic, MaterialSpec};
use glisson::math::DVec3;
use glisson::solve::case::{StaticCase, read_case, write_vectors};
use glisson::solve::{
    NonlinearProblem, NonlinearSettings, StaticProblem, add_gravity_forces, solve_nonlinear, solve_static,
};

/// Solve a static case given as files.
///
/// The folder holds nodes.csv (x,y,z in m; the row is the node), tets.csv (four nodes, from 0, positive
/// volume), dirichlet.csv (node, component 0/1/2, prescribed displacement in m) and load.json
/// ({"E": Pa, "nu": number, "rho": kg/m3, "gravity": [x, y, z] m/s2}). Writes u.csv (m) and reactions.csv (N,
/// zero at free components), one row a node.
///
/// Every law agrees with E and nu at small strain (the fibre law: without its fibres). All but `linear` are
/// solved by Newton's method with load steps; where equilibrium is lost, the load reached is named.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson solve crates/glisson-tissue/tests/data/reference/beam --law linear --out out/beam
  glisson solve crates/glisson-tissue/tests/data/reference/cylinder --law neo_hooke_log --out out/cylinder
  glisson solve CASE --law ogden --alpha=-4.7 --out out/brain
  glisson solve CASE --law holzapfel_gasser_ogden --fibre 1,0,0 --k1 20 --k2 5 --kappa 0.1 --out out/fibres")]
pub(crate) struct Args {
    /// Folder with the four files.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Constitutive law.
    #[arg(long, value_enum, default_value_t = Law::Linear)]
    law: Law,
    /// Folder to write u.csv and reactions.csv into; made when missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Share of the load of the first load step, above 0 and at most 1 (laws other than `linear`).
    #[arg(long, value_name = "SHARE", default_value_t = NonlinearSettings::default().first_load_step)]
    first_load_step: f64,
    /// mooney_rivlin: C01 as a share of C10 + C01, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    c01_share: f64,
    /// ogden: the exponent (no default: it belongs to the tissue).
    #[arg(long, value_name = "NUMBER", allow_hyphen_values = true)]
    alpha: Option<f64>,
    /// holzapfel_gasser_ogden: direction of a fibre family at rest; give it again for a second family.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true)]
    fibre: Vec<DVec3>,
    /// holzapfel_gasser_ogden: fibre stiffness k1 in kPa.
    #[arg(long, value_name = "KPA")]
    k1: Option<f64>,
    /// holzapfel_gasser_ogden: fibre exponent k2.
    #[arg(long, value_name = "NUMBER")]
    k2: Option<f64>,
    /// holzapfel_gasser_ogden: dispersion kappa, 0 (parallel) to 0.333 (isotropic).
    #[arg(long, value_name = "NUMBER", default_value_t = 0.0)]
    kappa: f64,
}

/// The names of [`MaterialSpec::NAMES`].
#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
enum Law {
    /// Isotropic linear elasticity at small strain.
    Linear,
    /// Linear in the Green-Lagrange strain.
    StVenantKirchhoff,
    /// mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2.
    NeoHookeLog,
    /// Smith, de Goes and Kim 2018: bears inverted elements.
    StableNeoHooke,
    /// Two isochoric invariants (--c01-share).
    MooneyRivlin,
    /// A power of the principal stretches (--alpha).
    Ogden,
    /// Fibres in a soft matrix (--fibre, --k1, --k2, --kappa).
    HolzapfelGasserOgden,
}

fn parse_direction(text: &str) -> Result<DVec3, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|field| field.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err(format!("`{text}` is not x,y,z: three numbers with commas")),
    }
}

fn law_of(args: &Args, linear: &LinearElastic) -> anyhow::Result<MaterialSpec> {
    let choice = match args.law {
        Law::Linear => LawChoice::Linear,
        Law::StVenantKirchhoff => LawChoice::StVenantKirchhoff,
        Law::NeoHookeLog => LawChoice::NeoHookeLog,
        Law::StableNeoHooke => LawChoice::StableNeoHooke,
        Law::MooneyRivlin => LawChoice::MooneyRivlin { second_share: args.c01_share },
        Law::Ogden => LawChoice::Ogden {
            exponent: args
                .alpha
                .context("the law ogden needs its exponent: --alpha (brain: --alpha=-4.7)")?,
        },
        Law::HolzapfelGasserOgden => {
            if args.fibre.is_empty() {
                bail!("the law holzapfel_gasser_ogden needs a fibre direction: --fibre x,y,z");
            }
            let k1_kpa = args.k1.context("the law holzapfel_gasser_ogden needs --k1 (kPa)")?;
            LawChoice::HolzapfelGasserOgden {
                fibre_stiffness_pa: 1e3 * k1_kpa,
                fibre_exponent: args.k2.context("the law holzapfel_gasser_ogden needs --k2")?,
                dispersion: args.kappa,
                fibre_directions: args.fibre.clone(),
            }
        }
    };
    Ok(choice.with_moduli_of(linear)?)
}

/// A solution of either solver, and what the non-linear one has to say about itself.
struct Solved {
    displacement_m: Vec<DVec3>,
    reaction_n: Vec<DVec3>,
    course: Option<String>,
}

fn solve_case(args: &Args, case: &StaticCase) -> anyhow::Result<Solved> {
    let mut nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
    add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut nodal_force_n);
    if args.law == Law::Linear {
        let solution = solve_static(&StaticProblem {
            mesh: &case.mesh,
            material: &case.material,
            conditions: &case.conditions,
            nodal_force_n: &nodal_force_n,
        })?;
        let (displacement_m, reaction_n) = (solution.displacement_m, solution.reaction_n);
        return Ok(Solved { displacement_m, reaction_n, course: None });
    }
    if !(args.first_load_step > 0.0 && args.first_load_step <= 1.0) {
        bail!("--first-load-step is {}; allowed: above 0 and at most 1", args.first_load_step);
    }
    let spec = law_of(args, &case.material)?;
    let settings = NonlinearSettings { first_load_step: args.first_load_step, ..Default::default() };
    let solution = solve_nonlinear(&NonlinearProblem {
        mesh: &case.mesh,
        laws: &[spec.material()],
        conditions: &case.conditions,
        nodal_force_n: &nodal_force_n,
        settings,
    })?;
    let course = format!(
        "{} load steps, {} Newton iterations, residual {:.2e} N, energy {:.6} mJ",
        solution.n_load_steps,
        solution.n_iterations,
        solution.residual_n,
        1e3 * solution.energy_j
    );
    let (displacement_m, reaction_n) = (solution.displacement_m, solution.reaction_n);
    Ok(Solved { displacement_m, reaction_n, course: Some(course) })
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let case = read_case(&args.folder)?;
    let solution = solve_case(args, &case).with_context(|| format!("case {}", args.folder.display()))?;

    std::fs::create_dir_all(&args.out).with_context(|| format!("making {}", args.out.display()))?;
    write_vectors(&args.out.join("u.csv"), "ux,uy,uz (m)", &solution.displacement_m)?;
    write_vectors(
        &args.out.join("reactions.csv"),
        "reaction Fx,Fy,Fz (N) at constrained dofs",
        &solution.reaction_n,
    )?;

    let largest_m = solution.displacement_m.iter().map(|u| u.length()).fold(0.0, f64::max);
    let reaction_n: DVec3 = solution.reaction_n.iter().sum();
    println!("nodes            {}", case.mesh.positions_m.len());
    println!("tetrahedra       {}", case.mesh.tetrahedra.len());
    println!("prescribed       {} components", case.conditions.iter().count());
    if let Some(course) = &solution.course {
        println!("solved           {course}");
    }
    println!("largest motion   {:.6} mm", 1e3 * largest_m);
    println!("sum of reactions ({:.6}, {:.6}, {:.6}) N", reaction_n.x, reaction_n.y, reaction_n.z);
    println!("written          {}", args.out.join("u.csv").display());
    println!("                 {}", args.out.join("reactions.csv").display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::*;

    #[test]
    fn every_law_of_the_library_is_offered_under_its_name() {
        let offered: Vec<String> = Law::value_variants()
            .iter()
            .map(|law| law.to_possible_value().expect("no law is hidden").get_name().to_owned())
            .collect();
        assert_eq!(offered, MaterialSpec::NAMES);
    }

    #[test]
    fn a_direction_is_three_numbers() {
        assert_eq!(parse_direction("1, -2,0.5"), Ok(DVec3::new(1.0, -2.0, 0.5)));
        assert!(parse_direction("1,2").is_err());
        assert!(parse_direction("1,2,x").is_err());
    }
}
