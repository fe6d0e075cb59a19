//! `glisson precompute`.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use super::numbers::numbers;
use anyhow::{Context, bail};
use glisson::material::LinearElastic;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::faults::{FaultAction, ImportPolicy};
use glisson::mesh::files::read_mesh_with;
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{
    ComplianceCheck, Precision, Precomputed, PrecomputedExpectation, PrecomputedParams, StoredNodes,
    StreamOptions, StreamSummary, check_compliance, precompute_to_file,
};
use glisson::scene::{OrganBody, read_organ};
use glisson::world::spec::{Region, Support, fixed_nodes};
use glisson_runtime::OpenScene;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Compute and save the compliance of a mesh for the pre-computed model.
///
/// A scene says mesh, material and support itself. For a mesh, held nodes come from boxes, balls and shares along a direction, added up; each option may be given several
/// times. The file holds for exactly this mesh, material and support: another one is refused when it is loaded.
/// It is written while it is computed, as FILE.partial; after an interruption (Ctrl-C, a crash, a full disk) the same command goes on where that one stopped.
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
    /// Bytes of a stored number: f64 (eight), or f32 (four) for half the file and memory at relative errors of 6e-8.
    #[arg(long, value_enum, default_value_t = PrecisionName::F64)]
    precision: PrecisionName,
    /// Starts over, overwriting what an interrupted pre-computation left, rather than going on with it.
    #[arg(long)]
    restart: bool,
    /// Reads the file back and compares the responses to forces on about this many nodes with direct solutions.
    #[arg(long, value_name = "NODES", num_args = 0..=1, default_missing_value = "20")]
    check: Option<usize>,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
    /// Threads; the bits of the result do not depend on it. 0: as many as the machine has.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// File to write.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
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

/// `--precision`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PrecisionName {
    F64,
    F32,
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Self {
        match name {
            PrecisionName::F64 => Self::F64,
            PrecisionName::F32 => Self::F32,
        }
    }
}

/// Work shorter than this shows no progress bar.
const QUIET: Duration = Duration::from_secs(1);
/// Largest difference from a direct solution and from the transpose that `--check` lets pass, over the largest entry:
/// of eight bytes a number, and of four.
const TOLERANCES: [[f64; 2]; 2] = [[1e-10, 1e-12], [1e-5, 1e-6]];

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
            "no node of {} is held: the organ would float, all its 6 rigid motions free (translation along and rotation \
             about x, y and z). Give --fix-box-mm, --fix-ball-mm or --fix-furthest; the mesh reaches from \
             {min_mm:.1} to {max_mm:.1} mm",
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
    let body = read_organ(&source.scene, &source.folder)?;
    if body.tissue_parts.is_some() {
        bail!(
            "{}: [[organ.part]]: an organ with parts of other tissue cannot be pre-computed",
            args.input.display()
        );
    }
    Ok(body)
}

/// What the bar shows while nodes are solved for.
const NODES: &str = "pre-computing {bar:40} {pos}/{len} nodes, {msg}";
/// Between two showings of the time.
const TICK: Duration = Duration::from_millis(500);

/// A progress bar with the time left, from the rate since the first nodes were done.
struct Progress {
    bar: ProgressBar,
    start: Instant,
    /// When the factor was there, and nodes that an earlier run had done.
    solving: OnceLock<(Instant, usize)>,
}

impl Progress {
    fn new() -> anyhow::Result<Self> {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        bar.set_style(ProgressStyle::with_template(NODES)?);
        let factoring = ProgressStyle::with_template("factoring the stiffness matrix, {elapsed}")?;
        let of_factor = bar.clone();
        // There are no nodes to count before the factor is there: until then the time is shown.
        std::thread::spawn(move || {
            std::thread::sleep(QUIET);
            let goes_on = || of_factor.length().is_none() && !of_factor.is_finished();
            if goes_on() {
                of_factor.set_style(factoring);
                of_factor.set_draw_target(ProgressDrawTarget::stderr());
            }
            while goes_on() {
                of_factor.tick();
                std::thread::sleep(TICK);
            }
        });
        Ok(Self { bar, start: Instant::now(), solving: OnceLock::new() })
    }

    fn tell(&self, done: usize, total: usize) {
        let (since, before) = *self.solving.get_or_init(|| {
            self.bar.set_length(total as u64);
            if let Ok(nodes) = ProgressStyle::with_template(NODES) {
                self.bar.set_style(nodes);
            }
            (Instant::now(), done)
        });
        self.bar.set_length(total as u64);
        // Blocks finish in any order; the bar only goes forward.
        self.bar.set_position(self.bar.position().max(done as u64));
        if let Some(left) = time_left(since.elapsed(), done - before.min(done), total - done) {
            self.bar.set_message(format!("{} left", HumanDuration(left)));
        }
        if self.start.elapsed() > QUIET && self.bar.is_hidden() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
    }
}

/// Time for as many nodes as are left, at the rate so far.
fn time_left(elapsed: Duration, n_done: usize, n_left: usize) -> Option<Duration> {
    (n_done > 0).then(|| elapsed.mul_f64(n_left as f64 / n_done as f64))
}

/// Becomes true at the first Ctrl-C; the second ends the program.
fn stop_on_interrupt() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::spawn(move || {
        runtime.block_on(async {
            if tokio::signal::ctrl_c().await.is_err() {
                return;
            }
            seen.store(true, Ordering::Relaxed);
            eprintln!("stopping after the nodes at hand; Ctrl-C again stops at once, at the cost of these");
            if tokio::signal::ctrl_c().await.is_ok() {
                std::process::exit(1);
            }
        });
    });
    Ok(stop)
}

/// What `--json` prints.
#[derive(serde::Serialize)]
struct Answer {
    nodes: usize,
    tetrahedra: usize,
    held_nodes: usize,
    loadable_nodes: usize,
    stored_nodes: usize,
    resumed_nodes: usize,
    young_modulus_pa: f64,
    poisson_ratio: f64,
    seconds: f64,
    file_bytes: u64,
    file: PathBuf,
    check: Option<CheckAnswer>,
}

/// What came out of `--check`.
#[derive(Clone, Copy, serde::Serialize)]
struct CheckAnswer {
    nodes: usize,
    largest_m_per_n: f64,
    difference: f64,
    asymmetry: f64,
}

impl From<ComplianceCheck> for CheckAnswer {
    fn from(check: ComplianceCheck) -> Self {
        let ComplianceCheck { n_compared, largest_m_per_n, difference, asymmetry } = check;
        Self { nodes: n_compared, largest_m_per_n, difference, asymmetry }
    }
}

impl Answer {
    fn print(&self) {
        println!("nodes           {}", self.nodes);
        println!("tetrahedra      {}", self.tetrahedra);
        println!("held nodes      {}", self.held_nodes);
        println!("loadable nodes  {}", self.loadable_nodes);
        println!("stored nodes    {}", self.stored_nodes);
        if self.resumed_nodes > 0 {
            println!("done before     {} loadable nodes, by an interrupted run", self.resumed_nodes);
        }
        println!("Young's modulus {} kPa", 1e-3 * self.young_modulus_pa);
        println!("Poisson's ratio {}", self.poisson_ratio);
        println!("with the file   {:.3} s", self.seconds);
        println!("file size       {:.1} MB", 1e-6 * self.file_bytes as f64);
        println!("written         {}", self.file.display());
        if let Some(check) = &self.check {
            println!(
                "compared with   direct solutions at {} nodes: differs by {:.1e} of the largest entry",
                check.nodes, check.difference
            );
            println!("asymmetry       {:.1e} of the largest entry", check.asymmetry);
        }
    }

    /// Refuses a compliance that differs too much from direct solutions, or is not symmetric enough.
    fn ensure_exact(&self, args: &Args) -> anyhow::Result<()> {
        let [difference, asymmetry] = TOLERANCES[usize::from(args.precision == PrecisionName::F32)];
        match &self.check {
            Some(check) if !(check.difference <= difference && check.asymmetry <= asymmetry) => bail!(
                "{}: differs from direct solutions by {:e} (allowed: {difference:e}) and from its transpose by {:e} \
                 (allowed: {asymmetry:e}) of its largest entry: the mesh is too badly shaped, or the material too nearly \
                 incompressible",
                args.out.display(),
                check.difference,
                check.asymmetry
            ),
            _ => Ok(()),
        }
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let is_scene = args.input.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let body = if is_scene { body_of_scene(args)? } else { body_of_mesh(args)? };
    let fixed_nodes = ModelKind::Precomputed.row().nodes_fixed_wholly(&body)?;
    let OrganBody { mesh, material, .. } = body;

    let progress = Progress::new()?;
    let tell = |done: usize, total: usize| progress.tell(done, total);
    let stored = if args.all_nodes { StoredNodes::All } else { StoredNodes::Surface };
    let params = PrecomputedParams {
        mesh: &mesh,
        material: &material,
        fixed_nodes: &fixed_nodes,
        stored,
        precision: args.precision.into(),
        progress: Some(&tell),
    };
    let stop = stop_on_interrupt().context("listening for Ctrl-C")?;
    let is_stopped = || stop.load(Ordering::Relaxed);
    let options = StreamOptions { restart: args.restart, stop: Some(&is_stopped) };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads)
        .build()
        .with_context(|| format!("starting {} threads", args.threads))?;
    let written = pool.install(|| precompute_to_file(&params, &args.out, &options));
    progress.bar.finish_and_clear();
    let StreamSummary { n_loadable, n_stored, n_resumed, n_bytes } =
        written.with_context(|| format!("pre-computing {}", args.input.display()))?;
    let seconds = progress.start.elapsed().as_secs_f64();

    let check = args.check.map(|n_nodes| -> anyhow::Result<CheckAnswer> {
        let expected = PrecomputedExpectation { mesh: &mesh, material: &material, fixed_nodes: &fixed_nodes };
        let model = Precomputed::load(&args.out, &expected)?;
        Ok(check_compliance(&model, &mesh, n_nodes)?.into())
    });
    let answer = Answer {
        nodes: mesh.positions_m.len(),
        tetrahedra: mesh.tetrahedra.len(),
        held_nodes: fixed_nodes.len(),
        loadable_nodes: n_loadable,
        stored_nodes: n_stored,
        resumed_nodes: n_resumed,
        young_modulus_pa: material.young_modulus_pa(),
        poisson_ratio: material.poisson_ratio(),
        seconds,
        file_bytes: n_bytes,
        file: args.out.clone(),
        check: check.transpose()?,
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&answer)?);
    } else {
        answer.print();
    }
    answer.ensure_exact(args)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_told_from_the_first_nodes_on() {
        let second = Duration::from_secs(1);
        assert_eq!(time_left(second, 0, 100), None);
        assert_eq!(time_left(second, 16, 160), Some(10 * second));
        // Those that an earlier run had done say nothing of this one's rate.
        let progress = Progress::new().unwrap();
        progress.tell(600, 614);
        assert_eq!(progress.solving.get().map(|(_, before)| *before), Some(600));
        assert!(progress.bar.message().is_empty());
        progress.tell(601, 614);
        assert!(progress.bar.message().ends_with("left"));
        progress.tell(599, 614);
        assert_eq!(progress.bar.position(), 601);
    }
}
