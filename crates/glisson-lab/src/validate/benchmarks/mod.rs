//! Structural benchmarks of the field on plain and on smoothed tetrahedra, as tables and a figure of convergence.
//!
//! Values that no source was found for are marked so where they stand.

mod bodies;
mod cases;
mod motion;

use self::cases::Tetrahedra;
use super::{Experiment, Figure, Outcome};
use glisson::solve::Smoothing;
use glisson_report::plot::{LinePlot, Series, SeriesStyle};

const KINDS: [Tetrahedra; 2] = [Tetrahedra::Plain, Tetrahedra::Smoothed(Smoothing::BENDING)];

/// A run on `n` cells along a characteristic edge: number of nodes and values.
type Run = fn(usize, Tetrahedra) -> anyhow::Result<(usize, Vec<f64>)>;

/// Some quantities of one problem over refinements. All of them take some ten seconds of CPU.
struct Benchmark {
    ladder: &'static [usize],
    run: Run,
    quantities: &'static [Quantity],
}

/// A value that a benchmark gives.
struct Quantity {
    name: &'static str,
    unit: &'static str,
    reference: f64,
    /// Source of the reference, and how near the finest mesh has to come, as a share; none where it is only told.
    claim: Option<(&'static str, f64)>,
}

impl Quantity {
    const fn claimed(
        name: &'static str,
        unit: &'static str,
        reference: f64,
        claim: (&'static str, f64),
    ) -> Self {
        Self { name, unit, reference, claim: Some(claim) }
    }

    const fn told(name: &'static str, unit: &'static str, reference: f64) -> Self {
        Self { name, unit, reference, claim: None }
    }
}

/// One quantity over the refinements.
struct Convergence {
    quantity: &'static Quantity,
    /// Number of nodes, and the value on plain and on smoothed tetrahedra.
    rows: Vec<(usize, [f64; 2])>,
}

impl Convergence {
    /// The value on the finest mesh of smoothed tetrahedra.
    fn finest(&self) -> f64 {
        self.rows.last().map_or(f64::NAN, |(_, [_, smoothed])| *smoothed)
    }

    /// The finest mesh has to come within a share of the reference.
    fn experiment(&self) -> Option<Experiment> {
        let Quantity { name, unit, reference, claim } = self.quantity;
        let (source, share) = (*claim)?;
        let error = (self.finest() / reference - 1.0).abs();
        Some(Experiment {
            name: format!("{name}, smoothed [{unit}]"),
            source: source.into(),
            expected: format!("{reference}"),
            obtained: self.finest(),
            tolerance: format!("{} %", 100.0 * share),
            pass: error <= share,
            compares_times: false,
        })
    }

    fn table(&self) -> String {
        let Quantity { name, unit, reference, .. } = self.quantity;
        let mut text = format!(
            "\n**{name}** [{unit}], reference {reference}\n\n| nodes | plain | error | smoothed | error |\n|---|---|---|---|---|\n",
        );
        for (n_nodes, values) in &self.rows {
            let [plain, smoothed] =
                values.map(|v| format!("{v:.4} | {:+.2} %", 100.0 * (v / reference - 1.0)));
            text += &format!("| {n_nodes} | {plain} | {smoothed} |\n");
        }
        text
    }

    /// Errors over the number of nodes, both as decimal logarithms.
    fn series(&self) -> [Series; 2] {
        let logarithms = |kind: usize| {
            self.rows
                .iter()
                .map(|(n, values)| {
                    [(*n as f64).log10(), (values[kind] / self.quantity.reference - 1.0).abs().log10()]
                })
                .collect()
        };
        [("plain", SeriesStyle::Dashed, 0), ("smoothed", SeriesStyle::Line, 1)].map(|(kind, style, k)| {
            Series {
                name: format!("{} {kind}", self.quantity.name.split(' ').next().unwrap_or_default()),
                points: logarithms(k),
                style,
            }
        })
    }
}

impl Benchmark {
    /// Every quantity on both kinds of tetrahedra.
    fn climb(&'static self) -> anyhow::Result<Vec<Convergence>> {
        let mut found: Vec<Convergence> =
            self.quantities.iter().map(|quantity| Convergence { quantity, rows: Vec::new() }).collect();
        for &n in self.ladder {
            let (n_nodes, plain) = (self.run)(n, KINDS[0])?;
            let (_, smoothed) = (self.run)(n, KINDS[1])?;
            for (k, convergence) in found.iter_mut().enumerate() {
                convergence.rows.push((n_nodes, [plain[k], smoothed[k]]));
            }
        }
        Ok(found)
    }
}

/// A run of one value.
fn one((n_nodes, value): (usize, f64)) -> (usize, Vec<f64>) {
    (n_nodes, vec![value])
}

/// A run of two values.
fn two((n_nodes, values): (usize, [f64; 2])) -> (usize, Vec<f64>) {
    (n_nodes, values.to_vec())
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

const ROD_Y: &str = "B2 rod, tip y";
const COOK_MIDDLE: &str = "B5 Cook's membrane, nu 0.4999, middle";
/// Quantities whose errors are drawn.
const DRAWN: [&str; 3] =
    ["M11 thick sphere, mean inner displacement", "B1 cantilever, tip drop", "B4 large shear, W"];

static BENCHMARKS: [Benchmark; 8] = [
    Benchmark {
        ladder: &[4, 6, 10],
        run: |n, kind| cases::thick_sphere_mm(n, kind).map(one),
        quantities: &[Quantity::claimed(DRAWN[0], "mm", 0.8543, (LAME, 0.02))],
    },
    Benchmark {
        ladder: &[2, 3, 4],
        run: |n, kind| cases::cantilever_mm(n, kind).map(one),
        quantities: &[Quantity::claimed(DRAWN[1], "mm", 31.72, (ELASTICA, 0.05))],
    },
    Benchmark {
        ladder: &[2, 3, 4],
        run: |n, kind| cases::cantilever_hz(n, kind).map(one),
        quantities: &[Quantity::claimed("B1 cantilever, first frequency", "Hz", 3.444, (BEAM, 0.05))],
    },
    Benchmark {
        ladder: &[2, 4],
        run: |n, kind| cases::rod_tip_mm(n, kind).map(two),
        quantities: &[
            Quantity::claimed(ROD_Y, "mm", -118.7, (SOFA, 0.05)),
            Quantity::claimed("B2 rod, tip z", "mm", 129.6, (SOFA, 0.05)),
        ],
    },
    Benchmark {
        ladder: &[1, 2, 3],
        run: |n, kind| cases::large_shear(n, kind).map(two),
        quantities: &[
            Quantity::claimed(DRAWN[2], "-", 6.700, (SZE, 0.05)),
            Quantity::claimed("B4 large shear, U", "-", 3.289, (SZE, 0.05)),
        ],
    },
    Benchmark {
        ladder: &[12, 24, 48],
        run: |n, kind| cases::cook_mm(n, 0.4999, kind).map(two),
        quantities: &[
            Quantity::told(COOK_MIDDLE, "mm", 27.45),
            Quantity::told("B5 Cook's membrane, nu 0.4999, upper end", "mm", 27.45),
        ],
    },
    Benchmark {
        ladder: &[12, 24, 48],
        run: |n, kind| cases::cook_mm(n, 1.0 / 3.0, kind).map(two),
        quantities: &[
            Quantity::told("B5 Cook's membrane, nu 1/3, middle", "mm", 32.24),
            Quantity::told("B5 Cook's membrane, nu 1/3, upper end", "mm", 32.24),
        ],
    },
    Benchmark {
        ladder: &[2, 4, 8],
        run: |n, kind| cases::thick_plate_mpa(n, kind).map(two),
        quantities: &[
            Quantity::told("B6 LE10, sigma_yy at D, mean of the tetrahedra there", "MPa", -5.38),
            Quantity::told("B6 LE10, sigma_yy at D, extrapolated from such means", "MPa", -5.38),
        ],
    },
];

/// Refinements of the twisting column.
const COLUMN_LADDER: [usize; 3] = [2, 3, 4];

fn convergence_figure(all: &[Convergence]) -> Figure {
    let drawn = all.iter().filter(|c| DRAWN.contains(&c.quantity.name));
    let plot = LinePlot {
        title: "Error of plain (broken) and smoothed tetrahedra".into(),
        x_label: "nodes, decimal logarithm".into(),
        y_label: "relative error, decimal logarithm".into(),
        series: drawn.flat_map(Convergence::series).collect(),
        size: [1100, 620],
    };
    let caption = "Thick sphere (M11), cantilever (B1) and large shear (B4): relative error over the number of nodes, plain \
                   and smoothed tetrahedra."
        .into();
    Figure { file: "benchmarks_convergence.svg", caption, plot }
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let climbed: Vec<Vec<Convergence>> =
        BENCHMARKS.iter().map(Benchmark::climb).collect::<anyhow::Result<_>>()?;
    let all: Vec<Convergence> = climbed.into_iter().flatten().collect();
    let finest =
        |name: &str| all.iter().find(|c| c.quantity.name == name).map_or(f64::NAN, Convergence::finest);
    let mut experiments: Vec<Experiment> = all.iter().filter_map(Convergence::experiment).collect();
    experiments.extend([
        Experiment::within(
            "B2 rod, tip y, smoothed, against the measurement [mm]",
            "measured: -116.25 mm, as SOFA's hyperelastic test says",
            finest(ROD_Y),
            [-116.25 * 1.05, -116.25 * 0.95],
        ),
        Experiment::within(
            "B5 Cook's membrane, nu 0.4999, smoothed [mm]",
            COOK,
            finest(COOK_MIDDLE),
            [26.0, 28.0],
        ),
    ]);
    let mut notes = String::from(NOTES);
    notes.extend(all.iter().map(Convergence::table));
    add_column(&COLUMN_LADDER, &mut experiments, &mut notes)?;
    add_critical_step(&mut experiments, &mut notes)?;
    Ok(Outcome { experiments, figures: vec![convergence_figure(&all)], notes })
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
