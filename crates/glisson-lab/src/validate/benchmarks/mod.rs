//! Structural benchmarks of the field on plain and on smoothed tetrahedra, as tables and a figure of convergence.
//!
//! Values that no source was found for are marked so where they stand.

mod bodies;
mod cases;
mod motion;

use self::cases::Tetrahedra;
use super::{Experiment, Figure, Outcome};
use glisson::solve::Smoothing;
use glisson_view::plot::{LinePlot, Series, SeriesStyle};

/// The refinements of each benchmark, cells along a characteristic edge.
struct Ladder {
    sphere: &'static [usize],
    cantilever: &'static [usize],
    rod: &'static [usize],
    large_shear: &'static [usize],
    cook: &'static [usize],
    plate: &'static [usize],
    column: &'static [usize],
}

/// Some ten seconds of CPU in all.
const LADDER: Ladder = Ladder {
    sphere: &[4, 6, 10],
    cantilever: &[2, 3, 4],
    rod: &[2, 4],
    large_shear: &[1, 2, 3],
    cook: &[12, 24, 48],
    plate: &[2, 4, 8],
    column: &[2, 3, 4],
};

const KINDS: [Tetrahedra; 2] = [Tetrahedra::Plain, Tetrahedra::Smoothed(Smoothing::BENDING)];

/// One quantity over the refinements.
struct Convergence {
    name: &'static str,
    unit: &'static str,
    reference: f64,
    /// Number of nodes, and the value on plain and on smoothed tetrahedra.
    rows: Vec<(usize, [f64; 2])>,
}

impl Convergence {
    /// The value on the finest mesh of smoothed tetrahedra.
    fn finest(&self) -> f64 {
        self.rows.last().map_or(f64::NAN, |(_, [_, smoothed])| *smoothed)
    }

    /// The finest mesh has to come within `share` of the reference.
    fn within(&self, source: &str, share: f64) -> Experiment {
        let name = format!("{}, smoothed [{}]", self.name, self.unit);
        let error = (self.finest() / self.reference - 1.0).abs();
        Experiment {
            name,
            source: source.into(),
            expected: format!("{}", self.reference),
            obtained: self.finest(),
            tolerance: format!("{} %", 100.0 * share),
            pass: error <= share,
            compares_times: false,
        }
    }

    fn table(&self) -> String {
        let mut text = format!(
            "\n**{}** [{}], reference {}\n\n| nodes | plain | error | smoothed | error |\n|---|---|---|---|---|\n",
            self.name, self.unit, self.reference
        );
        for (n_nodes, values) in &self.rows {
            let [plain, smoothed] =
                values.map(|v| format!("{v:.4} | {:+.2} %", 100.0 * (v / self.reference - 1.0)));
            text += &format!("| {n_nodes} | {plain} | {smoothed} |\n");
        }
        text
    }

    /// Errors over the number of nodes, both as decimal logarithms.
    fn series(&self) -> [Series; 2] {
        let logarithms = |kind: usize| {
            self.rows
                .iter()
                .map(|(n, values)| [(*n as f64).log10(), (values[kind] / self.reference - 1.0).abs().log10()])
                .collect()
        };
        [("plain", SeriesStyle::Dashed, 0), ("smoothed", SeriesStyle::Line, 1)].map(|(kind, style, k)| {
            Series {
                name: format!("{} {kind}", self.name.split(' ').next().unwrap_or_default()),
                points: logarithms(k),
                style,
            }
        })
    }
}

/// A benchmark of `N` values over a ladder, on both kinds of tetrahedra.
fn climb<const N: usize>(
    ladder: &[usize],
    run: impl Fn(usize, Tetrahedra) -> anyhow::Result<(usize, [f64; N])>,
    named: [(&'static str, &'static str, f64); N],
) -> anyhow::Result<[Convergence; N]> {
    let mut found =
        named.map(|(name, unit, reference)| Convergence { name, unit, reference, rows: Vec::new() });
    for &n in ladder {
        let (n_nodes, plain) = run(n, KINDS[0])?;
        let (_, smoothed) = run(n, KINDS[1])?;
        for (k, convergence) in found.iter_mut().enumerate() {
            convergence.rows.push((n_nodes, [plain[k], smoothed[k]]));
        }
    }
    Ok(found)
}

/// A benchmark of one value, for [`climb`].
fn one(result: anyhow::Result<(usize, f64)>) -> anyhow::Result<(usize, [f64; 1])> {
    result.map(|(n_nodes, value)| (n_nodes, [value]))
}

const LAME: &str = "Lame's solution of the thick sphere";
const ELASTICA: &str = "inextensible elastica, integrated numerically";
const BEAM: &str = "Euler-Bernoulli beam, first bending frequency";
const SOFA: &str = "inextensible elastica of the rod of SOFA's hyperelastic test, E 1.517 MPa";
const SZE: &str = "inextensible elastica, integrated numerically; problem of Sze, Liu and Lo 2004, doi 10.1016/j.finel.2003.11.001";
const COOK: &str = "requirement: at least 26 mm on 48 x 48 cells";
const COLUMN: &str = "requirement; column of Bonet, Gil and Lee as in SPHinXsys's case (doi \
                      10.1016/j.cma.2014.09.024); 105 rad/s and nu 0.495 have no source found";
const TLED: &str = "edge over wave speed is an estimate; the proven step is our own bound";

/// What the tables do not say by themselves.
const NOTES: &str = "\
Smoothed tetrahedra: energy of shape six tenths on edges, four tenths on nodes, energy of volume on nodes. These shares \
were chosen after six others had been run, as those for which the cantilever B1 has the beam's frequency on two and on \
four cells: B1 is calibration, not evidence. M11, B5 and B6 had been looked at by then; B2 and B4 were run \
only after.

LE10 is reported, without pass or fail. The reference is that of Fino's case 012. The mean over the tetrahedra at D \
belongs to a point inside the plate; the extrapolated value lies 4 to 5 % beyond the reference, on \
plain and on smoothed tetrahedra alike.

Cook's membrane: which point the published comparisons take (27.35 to 27.56 mm, and 32.20 to 32.28 mm for nu 1/3) was not \
found. Only the upper end of the loaded side comes to both values here, so it is probably theirs; the middle, which the \
requirement of 26 mm is measured at, converges to less. The plain tetrahedra of those comparisons (8.69 and 11.80 mm) are on \
meshes that are not ours.

The values of the elastica do not stretch or shear; the rod's K of 10 MPa makes it 1.7 % softer than the E of 1.517 MPa \
that its reference has.
";

/// How long the column is followed: three quarters of its first swing back and forth.
const COLUMN_S: f64 = 0.25;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let ladder = &LADDER;
    let [sphere] = climb(
        ladder.sphere,
        |n, kind| one(cases::thick_sphere_mm(n, kind)),
        [("M11 thick sphere, mean inner displacement", "mm", 0.8543)],
    )?;
    let [sinks] = climb(
        ladder.cantilever,
        |n, kind| one(cases::cantilever_mm(n, kind)),
        [("B1 cantilever, tip drop", "mm", 31.72)],
    )?;
    let [frequency] = climb(
        ladder.cantilever,
        |n, kind| one(cases::cantilever_hz(n, kind)),
        [("B1 cantilever, first frequency", "Hz", 3.444)],
    )?;
    let [rod_y, rod_z] = climb(
        ladder.rod,
        cases::rod_tip_mm,
        [("B2 rod, tip y", "mm", -118.7), ("B2 rod, tip z", "mm", 129.6)],
    )?;
    let [shear_w, shear_u] = climb(
        ladder.large_shear,
        cases::large_shear,
        [("B4 large shear, W", "-", 6.700), ("B4 large shear, U", "-", 3.289)],
    )?;
    let [cook, cook_end] = climb(
        ladder.cook,
        |n, kind| cases::cook_mm(n, 0.4999, kind),
        [
            ("B5 Cook's membrane, nu 0.4999, middle", "mm", 27.45),
            ("B5 Cook's membrane, nu 0.4999, upper end", "mm", 27.45),
        ],
    )?;
    let [softer, softer_end] = climb(
        ladder.cook,
        |n, kind| cases::cook_mm(n, 1.0 / 3.0, kind),
        [
            ("B5 Cook's membrane, nu 1/3, middle", "mm", 32.24),
            ("B5 Cook's membrane, nu 1/3, upper end", "mm", 32.24),
        ],
    )?;
    let [plate_mean, plate] = climb(
        ladder.plate,
        cases::thick_plate_mpa,
        [
            ("B6 LE10, sigma_yy at D, mean of the tetrahedra there", "MPa", -5.38),
            ("B6 LE10, sigma_yy at D, extrapolated from such means", "MPa", -5.38),
        ],
    )?;

    let mut experiments = vec![
        sphere.within(LAME, 0.02),
        sinks.within(ELASTICA, 0.05),
        frequency.within(BEAM, 0.05),
        rod_y.within(SOFA, 0.05),
        rod_z.within(SOFA, 0.05),
        shear_w.within(SZE, 0.05),
        shear_u.within(SZE, 0.05),
        Experiment::within(
            "B2 rod, tip y, smoothed, against the measurement [mm]",
            "measured: -116.25 mm, as SOFA's hyperelastic test says",
            rod_y.finest(),
            [-116.25 * 1.05, -116.25 * 0.95],
        ),
        Experiment::within("B5 Cook's membrane, nu 0.4999, smoothed [mm]", COOK, cook.finest(), [26.0, 28.0]),
    ];
    let mut notes = String::from(NOTES);
    let all = [
        sphere, sinks, frequency, rod_y, rod_z, shear_w, shear_u, cook, cook_end, softer, softer_end,
        plate_mean, plate,
    ];
    for convergence in &all {
        notes += &convergence.table();
    }
    add_column(ladder.column, &mut experiments, &mut notes)?;
    add_critical_step(&mut experiments, &mut notes)?;

    let [sphere, sinks, _, _, _, shear, ..] = &all;
    let plot = LinePlot {
        title: "Error of plain (broken) and smoothed tetrahedra".into(),
        x_label: "nodes, decimal logarithm".into(),
        y_label: "relative error, decimal logarithm".into(),
        series: [sphere, sinks, shear].iter().flat_map(|c| c.series()).collect(),
        size: [1100, 620],
    };
    let caption = "Thick sphere (M11), cantilever (B1) and large shear (B4): relative error over the number of nodes, plain \
                   and smoothed tetrahedra."
        .into();
    Ok(Outcome {
        experiments,
        figures: vec![Figure { file: "benchmarks_convergence.svg", caption, plot }],
        notes,
    })
}

fn add_column(ladder: &[usize], experiments: &mut Vec<Experiment>, notes: &mut String) -> anyhow::Result<()> {
    *notes += "\n**B9 twisting column**, central differences, ln J neo-Hooke\n\n| foot | tetrahedra | nodes | steps | \
               energy drift | angular momentum drift | largest twist of the top [rad] | inverted |\n\
               |---|---|---|---|---|---|---|---|\n";
    let mut worst = [0.0_f64; 2];
    let mut any_inverted = false;
    let finest = ladder.last().copied().unwrap_or(2);
    let held = ladder.iter().map(|&n| (n, true));
    for (n, is_held) in held.chain([(finest, false)]) {
        for (kind, name) in KINDS.into_iter().zip(["plain", "smoothed"]) {
            let twist = motion::twisting_column(n, is_held, kind, COLUMN_S)?;
            worst[0] = worst[0].max(twist.energy_drift);
            let (foot, momentum) = if is_held {
                ("held", "not kept".to_owned())
            } else {
                worst[1] = worst[1].max(twist.momentum_drift);
                ("free", format!("{:.1e}", twist.momentum_drift))
            };
            any_inverted |= twist.any_inverted;
            *notes += &format!(
                "| {foot} | {name} | {} | {} | {:.1e} | {momentum} | {:.3} | {} |\n",
                twist.n_nodes,
                twist.n_steps,
                twist.energy_drift,
                twist.largest_rad,
                if twist.any_inverted { "yes" } else { "none" }
            );
        }
    }
    experiments.push(Experiment::at_most("B9 twisting column: energy drift", COLUMN, worst[0], 0.01));
    experiments.push(Experiment::at_most(
        "B9 twisting column, free: angular momentum drift",
        COLUMN,
        worst[1],
        0.01,
    ));
    let inverted = f64::from(u8::from(any_inverted));
    experiments.push(Experiment::at_most(
        "B9 twisting column: runs with an inversion",
        COLUMN,
        inverted,
        0.0,
    ));
    Ok(())
}

fn add_critical_step(experiments: &mut Vec<Experiment>, notes: &mut String) -> anyhow::Result<()> {
    let critical = motion::critical_step()?;
    let [below, above] = critical.growth;
    *notes += &format!(
        "\n**B11 critical step** of a free block of 2 mm cells of five tetrahedra, E 3 kPa, nu 0.49, 1000 kg/m3: proven \
         stable {:.4} ms, edge over wave speed {:.4} ms. A random motion grows {below:.1} times at 0.9 and {above:.1e} \
         times at 1.2 of the proven step.\n",
        1e3 * critical.stable_s,
        1e3 * critical.edge_over_speed_s,
    );
    experiments.push(Experiment::within(
        "B11 edge over wave speed [ms]",
        TLED,
        1e3 * critical.edge_over_speed_s,
        [0.278, 0.280],
    ));
    experiments.push(Experiment::at_most("B11 growth at 0.9 of the proven step", TLED, below, 100.0));
    experiments.push(Experiment::within(
        "B11 growth at 1.2 of the proven step",
        TLED,
        above,
        [motion::BLOWN_UP, f64::INFINITY],
    ));
    Ok(())
}
