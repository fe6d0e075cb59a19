//! `glisson solve`.

use std::path::PathBuf;

use anyhow::Context;
use glisson::math::DVec3;
use glisson::solve::case::{read_case, write_vectors};
use glisson::solve::{StaticProblem, add_gravity_forces, solve_static};

/// Solve a static case given as files.
///
/// The folder holds nodes.csv (x,y,z in m; the row is the node), tets.csv (four nodes, from 0, positive
/// volume), dirichlet.csv (node, component 0/1/2, prescribed displacement in m) and load.json
/// ({"E": Pa, "nu": number, "rho": kg/m3, "gravity": [x, y, z] m/s2}). Writes u.csv (m) and reactions.csv (N,
/// zero at free components), one row a node.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson solve crates/glisson/tests/data/reference/beam --law linear --out out/beam")]
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
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Law {
    /// Isotropic linear elasticity at small strain.
    Linear,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let case = read_case(&args.folder)?;
    let mut nodal_force_n = vec![DVec3::ZERO; case.mesh.positions_m.len()];
    add_gravity_forces(&case.mesh, &case.material, case.gravity_m_per_s2, &mut nodal_force_n);
    let problem = StaticProblem {
        mesh: &case.mesh,
        material: &case.material,
        conditions: &case.conditions,
        nodal_force_n: &nodal_force_n,
    };
    let solution = match args.law {
        Law::Linear => solve_static(&problem),
    }
    .with_context(|| format!("case {}", args.folder.display()))?;

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
    println!("largest motion   {:.6} mm", 1e3 * largest_m);
    println!("sum of reactions ({:.6}, {:.6}, {:.6}) N", reaction_n.x, reaction_n.y, reaction_n.z);
    println!("written          {}", args.out.join("u.csv").display());
    println!("                 {}", args.out.join("reactions.csv").display());
    Ok(())
}
