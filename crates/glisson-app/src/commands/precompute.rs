//! `glisson precompute`.

use std::path::PathBuf;
use std::sync::Once;
use std::time::{Duration, Instant};

use crate::runtime::OpenScene;
use anyhow::{Context, bail};
use glisson::material::LinearElastic;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::faults::{FaultAction, ImportPolicy};
use glisson::mesh::files::read_mesh_with;
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::scene::{OrganBody, read_organ};
use glisson::world::spec::{Region, Support, fixed_nodes};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Compute and save the compliance of a mesh for the pre-computed model.
///
/// A scene says mesh, material and support itself. For a mesh, held nodes come from boxes, balls and shares along a direction, added up; each option may be given several
/// times. The file holds for exactly this mesh, material and support: another one is refused when it is loaded.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson precompute scene.toml -o liver.precomputed
  glisson precompute liver.vtu --tissue liver --fix-furthest 0,1,0,0.08 -o liver.precomputed
  glisson precompute liver.vtu --young-kpa 5 --poisson 0.45 --fix-box-mm=-20,60,-30,20,90,30 -o liver.precomputed")]
#[command(group = clap::ArgGroup::new("elasticity").args(["tissue", "young_kpa"]))]
pub(crate) struct Args {
    /// Scene (.toml), or tetrahedral mesh in mm (.vtu, .vtk, .msh, .node/.ele, plain list)
    input: PathBuf,
    /// Tissue from the table: liver, gall_bladder, kidney, brain, vessel, glisson_capsule.
    #[arg(long)]
    tissue: Option<String>,
    /// Young's modulus [kPa].
    #[arg(long, value_name = "KPA", requires = "poisson")]
    young_kpa: Option<f64>,
    /// Poisson's ratio, above -1 and below 0.5.
    #[arg(long, value_name = "RATIO", requires = "young_kpa")]
    poisson: Option<f64>,
    /// Holds the nodes in a box: its smallest and largest corner [mm].
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = numbers::<6>, allow_hyphen_values = true)]
    fix_box_mm: Vec<[f64; 6]>,
    /// Holds the nodes in a ball: centre and radius [mm].
    #[arg(long, value_name = "X,Y,Z,R", value_parser = numbers::<4>, allow_hyphen_values = true)]
    fix_ball_mm: Vec<[f64; 4]>,
    /// Holds the share of all nodes that lies furthest along a direction: direction (LPS) and share (0 to 1).
    #[arg(long, value_name = "DX,DY,DZ,SHARE", value_parser = numbers::<4>, allow_hyphen_values = true)]
    fix_furthest: Vec<[f64; 4]>,
    /// Stores the displacements of inner nodes too, not of the surface alone.
    #[arg(long)]
    all_nodes: bool,
    /// Threads; the bits of the result do not depend on it. 0: as many as the machine has.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// File to write.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

/// `N` finite numbers separated by commas.
fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let found: Vec<f64> = text
        .split(',')
        .map(|field| match field.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("`{}` is not a finite number", field.trim())),
        })
        .collect::<Result<_, _>>()?;
    let n = found.len();
    found.try_into().map_err(|_| format!("{n} numbers, expected {N} separated by commas"))
}

/// Density of a given material; a static response does not depend on it.
const ANY_DENSITY_KG_PER_M3: f64 = 1000.0;

fn material(args: &Args) -> anyhow::Result<LinearElastic> {
    if let Some(name) = &args.tissue {
        let tissue = Tissue::by_name(name)?;
        let density_kg_per_m3 = tissue.density_kg_per_m3.unwrap_or(ANY_DENSITY_KG_PER_M3);
        return Ok(tissue.linear_elastic_of_density(density_kg_per_m3)?);
    }
    match (args.young_kpa, args.poisson) {
        (Some(young_kpa), Some(poisson_ratio)) => {
            let young_modulus_pa = 1e3 * young_kpa;
            Ok(LinearElastic::from_young_poisson(young_modulus_pa, poisson_ratio, ANY_DENSITY_KG_PER_M3)?)
        }
        _ => bail!("give --tissue, or both --young-kpa and --poisson"),
    }
}

fn fixed_regions(args: &Args) -> anyhow::Result<Vec<Region>> {
    const M_PER_MM: f64 = 1e-3;
    let mut regions = Vec::new();
    for b in &args.fix_box_mm {
        let (min_m, max_m) = (DVec3::from_slice(&b[..3]) * M_PER_MM, DVec3::from_slice(&b[3..]) * M_PER_MM);
        if min_m.cmpgt(max_m).any() {
            bail!("--fix-box-mm {b:?}: the first corner must be the smallest in x, y and z");
        }
        regions.push(Region::Box(Aabb { min_m, max_m }));
    }
    for b in &args.fix_ball_mm {
        let center_m = DVec3::from_slice(&b[..3]) * M_PER_MM;
        regions.push(Region::Ball { center_m, radius_m: b[3] * M_PER_MM });
    }
    for f in &args.fix_furthest {
        let (direction, fraction) = (DVec3::from_slice(&f[..3]), f[3]);
        if direction == DVec3::ZERO || !(fraction > 0.0 && fraction < 1.0) {
            bail!("--fix-furthest {f:?}: needs a direction that is not zero and a share between 0 and 1");
        }
        regions.push(Region::Furthest { direction, fraction });
    }
    Ok(regions)
}

/// Work shorter than this shows no progress bar.
const QUIET: Duration = Duration::from_secs(1);

/// Mesh, material and support that the options say.
fn body_of_mesh(args: &Args) -> anyhow::Result<OrganBody> {
    let material = material(args)?;
    let regions = fixed_regions(args)?;
    let policy = ImportPolicy { faults: FaultAction::Refuse, ..ImportPolicy::default() };
    let (mesh, _) = read_mesh_with(&args.input, &policy)?;
    let supports: Vec<Support> = regions.into_iter().map(Support::all_axes).collect();
    let fixed = fixed_nodes(&supports, &mesh.positions_m);
    if fixed.is_empty() {
        let bounds = Aabb::of_points(&mesh.positions_m);
        let (min_mm, max_mm) = (1e3 * bounds.min_m, 1e3 * bounds.max_m);
        bail!(
            "no node of {} is held: the organ would float. Give --fix-box-mm, --fix-ball-mm or --fix-furthest; \
             the mesh reaches from {min_mm:.1} to {max_mm:.1} mm",
            args.input.display()
        );
    }
    // A pre-computed organ goes through states at rest only: no step.
    let mut body = OrganBody::new(mesh, material, 0.0);
    body.fixed = fixed;
    Ok(body)
}

/// Mesh, material and support that a scene says.
fn body_of_scene(args: &Args) -> anyhow::Result<OrganBody> {
    let given = args.tissue.is_some()
        || args.young_kpa.is_some()
        || !(args.fix_box_mm.is_empty() && args.fix_ball_mm.is_empty() && args.fix_furthest.is_empty());
    if given {
        bail!(
            "{} is a scene: it says the material and what is held; leave those options out",
            args.input.display()
        );
    }
    let source = OpenScene::read(&args.input)?;
    Ok(read_organ(&source.scene, &source.folder)?)
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let is_scene = args.input.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let body = if is_scene { body_of_scene(args)? } else { body_of_mesh(args)? };
    let fixed_nodes = body.nodes_fixed_wholly(ModelKind::Precomputed)?;
    let OrganBody { mesh, material, .. } = body;

    let start = Instant::now();
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
    bar.set_style(ProgressStyle::with_template("pre-computing {bar:40} {pos}/{len} nodes, {eta} left")?);
    let shown = Once::new();
    let progress = |done: usize, total: usize| {
        if start.elapsed() > QUIET {
            shown.call_once(|| bar.set_draw_target(ProgressDrawTarget::stderr()));
        }
        bar.set_length(total as u64);
        // Blocks finish in any order; the bar only goes forward.
        bar.set_position(bar.position().max(done as u64));
    };
    let stored = if args.all_nodes { StoredNodes::All } else { StoredNodes::Surface };
    let params = PrecomputedParams {
        mesh: &mesh,
        material: &material,
        fixed_nodes: &fixed_nodes,
        stored,
        precision: Precision::F64,
        progress: Some(&progress),
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads)
        .build()
        .with_context(|| format!("starting {} threads", args.threads))?;
    let model = pool
        .install(|| Precomputed::build(&params))
        .with_context(|| format!("pre-computing {}", args.input.display()))?;
    bar.finish_and_clear();
    let computed = start.elapsed();
    let n_bytes = model.save(&args.out)?;
    let total = start.elapsed();

    println!("nodes           {}", mesh.positions_m.len());
    println!("tetrahedra      {}", mesh.tetrahedra.len());
    println!("held nodes      {}", fixed_nodes.len());
    println!("loadable nodes  {}", model.loadable_nodes().len());
    println!("stored nodes    {}", model.stored_nodes().len());
    println!("Young's modulus {} kPa", 1e-3 * material.young_modulus_pa());
    println!("Poisson's ratio {}", material.poisson_ratio());
    println!("computed in     {:.3} s", computed.as_secs_f64());
    println!("with the file   {:.3} s", total.as_secs_f64());
    println!("file size       {:.1} MB", 1e-6 * n_bytes as f64);
    println!("written         {}", args.out.display());
    Ok(())
}
