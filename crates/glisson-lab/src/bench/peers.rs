//! The implicit step at several sizes beside other simulators: what `cargo xtask peers` reports.
//!
//! The others are programs of their own (`xtask/peers`). Each gets the body and the load of [`super::implicit`] in a file, and answers
//! with its times; with the settings that its name in the table tells.

use super::body::StandardBody;
use super::implicit::{STEP_S, round_of_loads};
use super::{Machine, MachineBudget, Request, cases, measure_case};
use anyhow::{Context, bail, ensure};
use glisson_report::plot::{LinePlot, Series, SeriesStyle};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The case that the others are measured beside.
const CASE: &str = "implicit_step";

/// A body that goes further has come apart [mm]: half its height, some five times what the load does.
const MOST_MM: f64 = 60.0;

/// A program gets so many times its measuring time, and [`SET_UP`] for making its model, before it is stopped.
const PATIENCE: f64 = 4.0;
const SET_UP: Duration = Duration::from_secs(300);

/// Another simulator.
#[derive(Clone, Debug)]
pub struct Peer {
    /// Name and version.
    pub name: String,
    /// Length of its steps [s].
    pub step_s: f64,
    /// Program and first arguments; the body's file, the step [s] and the time to measure [s] follow.
    pub command: Vec<String>,
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct PeersRequest {
    /// Sizes in tetrahedra.
    pub sizes: Vec<usize>,
    /// Time for each simulator and size [s].
    pub seconds: f64,
    /// The others.
    pub peers: Vec<Peer>,
    /// Where the bodies' files go.
    pub folder: PathBuf,
}

/// One simulator at one size.
#[derive(Clone, Debug, PartialEq)]
struct Measured {
    n_tets: usize,
    median_ms: f64,
    p99_ms: f64,
    /// What else its steps did.
    note: String,
}

/// One simulator at all sizes that it was measured at, and why it was not at others.
struct Row {
    name: String,
    step_s: f64,
    measured: Vec<Measured>,
    faults: Vec<String>,
}

impl Row {
    fn of(name: &str, step_s: f64) -> Self {
        Self { name: name.to_owned(), step_s, measured: Vec::new(), faults: Vec::new() }
    }
}

/// What was found.
pub struct PeersReport {
    /// For docs/peers.md.
    pub markdown: String,
    /// Time of a step over the size, both as logarithms.
    pub svg: String,
}

/// Measures Glisson and the others in turn, size by size; hears what comes with `tell`.
///
/// # Errors
/// When Glisson's own case cannot be measured or a file not be written. A peer that fails is left out of the table, with the reason below
/// it.
pub fn measure_peers(request: &PeersRequest, tell: &dyn Fn(&str)) -> anyhow::Result<PeersReport> {
    ensure!(!request.sizes.is_empty(), "no size is given");
    ensure!(request.seconds > 0.0 && request.seconds.is_finite(), "{} s: must be above 0", request.seconds);
    let machine = Machine::measure(MachineBudget::default())?;
    let case = cases().into_iter().find(|case| case.name == CASE).context("the case is in the table")?;
    let own = Request {
        name: Some(CASE.to_owned()),
        sizes: None,
        seconds: request.seconds,
        threads: 1,
        machine: MachineBudget::default(),
    };
    let mut rows = vec![Row::of("Glisson `implicit`, ln J neo-Hooke", STEP_S)];
    rows.extend(request.peers.iter().map(|peer| Row::of(&peer.name, peer.step_s)));
    std::fs::create_dir_all(&request.folder)
        .with_context(|| format!("{}: cannot make the folder", request.folder.display()))?;
    let folder = std::path::absolute(&request.folder)?;
    for &size in &request.sizes {
        let body = StandardBody::shared(size)?;
        let file = folder.join(format!("ellipsoid-{size}.txt"));
        std::fs::write(&file, text_of(&body)?)
            .with_context(|| format!("{}: cannot be written", file.display()))?;
        let n_tets = body.mesh.tetrahedra.len();
        tell(&format!("Glisson at {n_tets} tetrahedra"));
        let outcome = measure_case(&case, size, &own, &machine)?;
        let (median_ms, p99_ms) = (1e-6 * outcome.median_ns, 1e-6 * outcome.p99_ns);
        rows[0].measured.push(Measured { n_tets, median_ms, p99_ms, note: outcome.note });
        for (peer, row) in request.peers.iter().zip(&mut rows[1..]) {
            tell(&format!("{} at {n_tets} tetrahedra", peer.name));
            match run_peer(peer, &folder, &file, request.seconds) {
                Ok([median_ms, p99_ms, _, deepest_mm]) => {
                    let note = format!("displacement up to {deepest_mm:.1} mm");
                    row.measured.push(Measured { n_tets, median_ms, p99_ms, note });
                }
                Err(error) => row.faults.push(format!("{} at {n_tets} tetrahedra: {error:#}", peer.name)),
            }
        }
    }
    Ok(PeersReport { markdown: markdown_of(&rows, &machine, request.seconds), svg: plot_of(&rows).to_svg()? })
}

/// The body and a round of its load, as the peers' programs read it (`xtask/peers/rapier/src/main.rs`).
fn text_of(body: &StandardBody) -> anyhow::Result<String> {
    let round = round_of_loads(body)?;
    let mut loaded: Vec<u32> = round.iter().flat_map(|load| &load.forces).map(|force| force.node.0).collect();
    loaded.sort_unstable();
    loaded.dedup();
    let (mesh, material) = (&body.mesh, &body.material);
    let mut text = format!(
        "{} {} {} {} {} {} {} {} {STEP_S}\n",
        mesh.positions_m.len(),
        mesh.tetrahedra.len(),
        body.fixed_nodes.len(),
        loaded.len(),
        round.len(),
        material.young_modulus_pa(),
        material.poisson_ratio(),
        material.density_kg_per_m3(),
    );
    for p in &mesh.positions_m {
        writeln!(text, "{} {} {}", p.x, p.y, p.z)?;
    }
    for [a, b, c, d] in &mesh.tetrahedra {
        writeln!(text, "{} {} {} {}", a.0, b.0, c.0, d.0)?;
    }
    let line = |numbers: Vec<String>| numbers.join(" ") + "\n";
    text += &line(body.fixed_nodes.iter().map(|n| n.0.to_string()).collect());
    text += &line(loaded.iter().map(u32::to_string).collect());
    for load in &round {
        let force_n = |node: &u32| {
            let of_node = load.forces.iter().find(|force| force.node.0 == *node);
            of_node.map_or(0.0, |force| force.force_n.z).to_string()
        };
        text += &line(loaded.iter().map(force_n).collect());
    }
    Ok(text)
}

/// Median and 99th percentile of a step [ms], number of steps, and largest displacement [mm].
fn run_peer(peer: &Peer, folder: &Path, file: &Path, seconds: f64) -> anyhow::Result<[f64; 4]> {
    let [program, first @ ..] = &peer.command[..] else { bail!("has no program") };
    let mut process = Command::new(program)
        .args(first)
        .arg(file)
        .current_dir(folder)
        .args([peer.step_s.to_string(), seconds.to_string()])
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .with_context(|| format!("{program} cannot be started"))?;
    let limit = SET_UP + Duration::from_secs_f64(PATIENCE * seconds);
    let start = Instant::now();
    while process.try_wait()?.is_none() {
        if start.elapsed() > limit {
            process.kill()?;
            process.wait()?;
            bail!("did not end within {} s", limit.as_secs());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let output = process.wait_with_output()?;
    ensure!(output.status.success(), "ended with {}", output.status);
    let text = String::from_utf8_lossy(&output.stdout);
    let numbers: Vec<f64> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
    let numbers: [f64; 4] =
        numbers.try_into().ok().with_context(|| format!("answered {text:?} instead of four numbers"))?;
    let [.., deepest_mm] = numbers;
    let is_sound = numbers.iter().all(|x| x.is_finite()) && deepest_mm < MOST_MM;
    ensure!(
        is_sound,
        "answered {text:?}: its body moved further than {MOST_MM} mm, so that its times count for nothing"
    );
    Ok(numbers)
}

fn markdown_of(rows: &[Row], machine: &Machine, seconds: f64) -> String {
    let head = format!(
        "# The implicit step beside other simulators\n\nWritten by `cargo xtask peers`. The standard body of `glisson bench` (an ellipsoid of \
         30 x 20 x 12 cm, 5 kPa, Poisson's ratio 0.45, its lowest 5 % of nodes held) under 1 N that goes round on its top, {seconds} s for \
         each figure, one thread, processor time of a step: median (99th percentile) in ms. One core of this machine does {:.0} GFLOP/s \
         (f64).\n\nThe columns are sizes in tetrahedra. A step is as long as in the second column; a simulator with shorter ones needs more \
         of them, so that the last column has the simulator's time for a simulated second at the last size that it was measured at.\n\n",
        machine.fma_gflops_f64,
    );
    head + &table_of(rows) + "\n![time of a step over the number of tetrahedra](images/peers.svg)\n"
}

/// The table, what the steps did, and what was not measured.
fn table_of(rows: &[Row]) -> String {
    let sizes: Vec<usize> = rows[0].measured.iter().map(|measured| measured.n_tets).collect();
    let head: Vec<String> = sizes.iter().map(usize::to_string).collect();
    let mut text = format!("| simulator | step [ms] | {} | for a second [s] |\n", head.join(" | "));
    text += &format!("|---|---|{}---|\n", "---|".repeat(sizes.len()));
    for row in rows {
        let at = |size: &usize| {
            let found = row.measured.iter().find(|measured| measured.n_tets == *size);
            found.map_or("-".to_owned(), |m| format!("{:.2} ({:.2})", m.median_ms, m.p99_ms))
        };
        let cells: Vec<String> = sizes.iter().map(at).collect();
        let for_a_second = row.measured.last().map_or("-".to_owned(), |last| {
            format!("{:.2} at {}", 1e-3 * last.median_ms / row.step_s, last.n_tets)
        });
        text +=
            &format!("| {} | {} | {} | {for_a_second} |\n", row.name, 1e3 * row.step_s, cells.join(" | "));
    }
    text += "\nWhat the steps did. The others start from rest and do not damp, so that they swing; Glisson's figures are after a round of the load, \
             with every step solved to a residual of 1e-3. rapier3d stops its conjugate gradients after 20 iterations, its default, converged or not.\n";
    for row in rows {
        for measured in &row.measured {
            text += &format!("- {} at {} tetrahedra: {}\n", row.name, measured.n_tets, measured.note);
        }
    }
    for fault in rows.iter().flat_map(|row| &row.faults) {
        text += &format!("\nNot measured: {fault}.\n");
    }
    text
}

fn plot_of(rows: &[Row]) -> LinePlot {
    let series = rows.iter().filter(|row| !row.measured.is_empty()).map(|row| Series {
        // The legend has one line: the name without its settings.
        name: format!(
            "{}, {} ms",
            row.name.split(',').next().unwrap_or_default().replace('`', ""),
            1e3 * row.step_s
        ),
        points: row.measured.iter().map(|m| [(m.n_tets as f64).log10(), m.median_ms.log10()]).collect(),
        style: SeriesStyle::Line,
    });
    LinePlot {
        title: "A step of the implicit body".to_owned(),
        x_label: "log10 of the number of tetrahedra".to_owned(),
        y_label: "log10 of a step's time [ms]".to_owned(),
        series: series.collect(),
        size: [800, 500],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer_of(script: &str) -> anyhow::Result<[f64; 4]> {
        let command = ["sh", "-c", script].map(str::to_owned).to_vec();
        run_peer(
            &Peer { name: "a peer".to_owned(), step_s: 0.01, command },
            Path::new("."),
            Path::new("body.txt"),
            0.1,
        )
    }

    #[test]
    fn a_peer_answers_with_four_numbers_or_is_left_out_with_the_reason() {
        assert_eq!(answer_of("echo 1.5 2 300 4e-1").unwrap(), [1.5, 2.0, 300.0, 0.4]);
        for (script, reason) in [
            ("exit 3", "exit status: 3"),
            ("echo 1 2 3", "instead of four numbers"),
            ("echo 1 2 3 4 5", "instead of four numbers"),
            ("echo 1 2 NaN 4", "count for nothing"),
            ("echo 1 2 3 372530", "count for nothing"),
        ] {
            let error = format!("{:#}", answer_of(script).unwrap_err());
            assert!(error.contains(reason), "{script}: {error}");
        }
        let missing = Peer { name: String::new(), step_s: 0.01, command: vec!["no-such-program".to_owned()] };
        assert!(run_peer(&missing, Path::new("."), Path::new("body.txt"), 0.1).is_err());
    }

    #[test]
    fn peers_get_the_whole_body_and_a_load_of_one_newton() {
        let body = StandardBody::shared(2_000).unwrap();
        let text = text_of(&body).unwrap();
        let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let [n_nodes, n_tets, n_held, n_loaded, n_round] = std::array::from_fn(|i| numbers[i] as usize);
        assert_eq!((n_nodes, n_tets), (body.mesh.positions_m.len(), body.mesh.tetrahedra.len()));
        let loads = &numbers[9 + 3 * n_nodes + 4 * n_tets + n_held + n_loaded..];
        assert_eq!(loads.len(), n_round * n_loaded);
        for load in loads.chunks_exact(n_loaded) {
            assert!((load.iter().sum::<f64>() + 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn what_was_not_measured_is_a_dash_with_its_reason() {
        let mut rows = [Row::of("own", 0.01), Row::of("other", 0.002)];
        let measured = |n_tets: usize, median_ms: f64| Measured {
            n_tets,
            median_ms,
            p99_ms: 2.0 * median_ms,
            note: "a note".to_owned(),
        };
        rows[0].measured = vec![measured(2_000, 1.0), measured(6_000, 3.0)];
        rows[1].measured = vec![measured(2_000, 4.0)];
        rows[1].faults.push("other at 6000 tetrahedra: ended".to_owned());
        let text = table_of(&rows);
        assert!(text.contains("| own | 10 | 1.00 (2.00) | 3.00 (6.00) | 0.30 at 6000 |"), "{text}");
        assert!(text.contains("| other | 2 | 4.00 (8.00) | - | 2.00 at 2000 |"), "{text}");
        assert!(text.contains("Not measured: other at 6000 tetrahedra: ended."), "{text}");
        assert!(plot_of(&rows).to_svg().unwrap().contains("own, 10 ms"));
    }
}
