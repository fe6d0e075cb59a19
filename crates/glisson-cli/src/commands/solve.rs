//! `glisson solve`.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::builder::{PossibleValue, PossibleValuesParser};
use glisson::material::{LAWS, LawEntry, LinearElastic, MaterialSpec, law_named};
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
  glisson solve CASE --law ogden --set exponent=-4.7 --out out/brain
  glisson solve CASE --law holzapfel_gasser_ogden --set fibre=1,0,0 --set 'k1=20 kPa' --set k2=5 --out out/fibres")]
pub(crate) struct Args {
    /// Folder with the four files.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Constitutive law.
    #[arg(long, value_name = "NAME", default_value = "linear", value_parser = PossibleValuesParser::new(law_values()))]
    law: String,
    /// Folder to write u.csv and reactions.csv into; made when missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Share of the load of the first load step, above 0 and at most 1 (laws other than `linear`).
    #[arg(long, value_name = "SHARE", default_value_t = NonlinearSettings::default().first_load_step)]
    first_load_step: f64,
    /// A parameter of the law, as in scenes: exponent=-4.7, k1="20 kPa", fibre=1,0,0 (again for a second family).
    #[arg(long = "set", value_name = "KEY=VALUE", allow_hyphen_values = true)]
    parameters: Vec<String>,
}

/// The laws of the library, each with what it is.
fn law_values() -> Vec<PossibleValue> {
    LAWS.iter().map(|entry| PossibleValue::new(entry.name).help(entry.about)).collect()
}

/// The law with the parameters that were given.
fn law_of(args: &Args, linear: &LinearElastic) -> anyhow::Result<MaterialSpec> {
    let mut law = law_named(&args.law).with_context(|| format!("{} is no law", args.law))?;
    for given in &args.parameters {
        let (name, value) = given
            .split_once('=')
            .with_context(|| format!("--set {given}: write KEY=VALUE, such as exponent=-4.7"))?;
        law = law.with_text(name, value).with_context(|| format!("--set {given}"))?;
    }
    if let Some(key) = law.missing() {
        let LawEntry { name, example, .. } = law.entry();
        bail!("the law {name} needs --set {}=VALUE ({}); in a scene: {example}", key.name, key.about);
    }
    Ok(law.with_moduli_of(linear)?)
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
    if args.law == "linear" {
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
    use super::*;
    use glisson::material::LawKeyKind;

    fn args(law: &str, parameters: &[&str]) -> Args {
        let parameters = parameters.iter().map(|&p| p.to_owned()).collect();
        let (folder, out, law) = (PathBuf::new(), PathBuf::new(), law.to_owned());
        Args { folder, law, out, first_load_step: 0.25, parameters }
    }

    #[test]
    fn every_law_of_the_library_can_be_chosen_and_says_what_it_lacks() {
        let linear = LinearElastic::from_young_poisson(5000.0, 0.45, 1000.0).unwrap();
        for entry in LAWS {
            let made = law_of(&args(entry.name, &[]), &linear);
            match entry.keys.iter().find(|key| key.kind != LawKeyKind::Number(Some(0.0))) {
                None => assert_eq!(made.unwrap().name(), entry.name),
                Some(key) => {
                    let message = format!("{:#}", made.unwrap_err());
                    assert!(message.contains(&format!("--set {}=", key.name)), "{message}");
                }
            }
        }
        let fibres = ["k1=20 kPa", "k2=5", "fibre=1,0,0", "fibre=0,1,0"];
        assert!(law_of(&args("holzapfel_gasser_ogden", &fibres), &linear).is_ok());
        for (law, wrong, part) in [
            ("ogden", "alpha=2", "allowed: exponent"),
            ("ogden", "exponent=much", "not a number"),
            ("ogden", "exponent=0", "allowed: a finite number other than 0"),
            ("holzapfel_gasser_ogden", "k1=-1 kPa", "allowed: a finite number above 0"),
            ("holzapfel_gasser_ogden", "kappa=0.4", "allowed: 0 (parallel fibres) to 1/3 (isotropic)"),
            ("linear", "exponent=2", "allowed: none"),
            ("holzapfel_gasser_ogden", "k1=20", "k1=20"),
            ("holzapfel_gasser_ogden", "fibre=1,0", "three numbers"),
        ] {
            let message = format!("{:#}", law_of(&args(law, &[wrong]), &linear).unwrap_err());
            assert!(message.contains(part), "{message}");
        }
    }
}
