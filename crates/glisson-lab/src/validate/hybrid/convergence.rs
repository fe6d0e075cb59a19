//! How fast zones converge that exchange in turn, by their number and by the size of the loaded one.

use super::{Case, Load, SEED, ZONE_CELLS, figure};
use crate::validate::{Experiment, Figure, Outcome};
use glisson_report::plot::{Series, SeriesStyle};

/// Cells along the bar of each zone, from the loaded end.
const SIZE_CELLS: [&[usize]; 3] = [&[3, 12], &[7, 8], &[12, 3]];

/// Errors after each sweep of the bar under one load.
struct Curves {
    load: Load,
    /// For each of [`ZONE_CELLS`].
    by_number: Vec<Vec<f64>>,
    /// For each of [`SIZE_CELLS`].
    by_size: Vec<Vec<f64>>,
}

/// Errors of all curves after `n` sweeps.
fn after(curves: &[Vec<f64>], n: usize) -> Vec<f64> {
    curves.iter().map(|c| c[n - 1]).collect()
}

impl Curves {
    fn of(load: Load) -> anyhow::Result<Self> {
        let case = Case::bar(load)?;
        let run = |cells: &&[usize]| -> anyhow::Result<Vec<f64>> {
            Ok(case.errors(&mut case.precomputed(&case.zones(cells)?, |_| ())?, load.n_sweeps()))
        };
        let by_number = ZONE_CELLS.iter().map(run).collect::<anyhow::Result<_>>()?;
        let by_size = SIZE_CELLS.iter().map(run).collect::<anyhow::Result<_>>()?;
        Ok(Self { load, by_number, by_size })
    }

    fn table_lines(&self) -> String {
        let all = ZONE_CELLS.iter().zip(&self.by_number).chain(SIZE_CELLS.iter().zip(&self.by_size));
        let line = |(cells, errors): (&&[usize], &Vec<f64>)| {
            let after = |n: usize| errors.get(n - 1).map_or("-".into(), |e| format!("{e:.1e}"));
            format!(
                "| {} | {cells:?} | {} | {} | {} | {} |\n",
                self.load.name(),
                after(20),
                after(100),
                after(200),
                after(1_000)
            )
        };
        all.map(line).collect()
    }

    fn of_numbers(&self) -> [Experiment; 2] {
        let (name, n) = (self.load.name(), self.load.n_sweeps());
        [
            Experiment::at_most(
                &format!("bar, {name}: mean error over edge after {n} sweeps, the largest of 2 to 5 zones"),
                SEED,
                self.by_number.iter().map(|c| c[c.len() - 1]).fold(0.0, f64::max),
                1e-3,
            ),
            Experiment::at_most(
                &format!(
                    "bar, {name}: more zones are slower (error after 100 sweeps ascends from 2 to 5 zones)"
                ),
                SEED,
                disorder(&after(&self.by_number, 100)),
                0.0,
            ),
        ]
    }

    fn of_sizes(&self) -> Vec<Experiment> {
        match self.load {
            Load::Force => vec![
                Experiment::at_most(
                    "bar, force: a smaller loaded zone is slower (error after 20 sweeps ascends)",
                    SEED,
                    disorder(&after(&self.by_size, 20).into_iter().rev().collect::<Vec<f64>>()),
                    0.0,
                ),
                Experiment::at_most(
                    "bar, force: error after 20 sweeps where the loaded zone is almost the whole bar",
                    SEED,
                    self.by_size[2][19],
                    1e-2,
                ),
            ],
            Load::Displacement => vec![Experiment::at_most(
                "bar, displacement: error after 100 sweeps, the largest of three sizes of the loaded zone",
                SEED,
                after(&self.by_size, 100).into_iter().fold(0.0, f64::max),
                1e-3,
            )],
        }
    }

    /// What the loaded zone's size changes in the number of sweeps until 0.01 edges.
    fn spread(&self) -> f64 {
        let sweeps: Vec<usize> =
            self.by_size.iter().map(|e| e.iter().take_while(|e| **e > 1e-2).count()).collect();
        (sweeps.iter().max().unwrap_or(&0) - sweeps.iter().min().unwrap_or(&0)) as f64
    }

    fn figures(&self) -> [Figure; 2] {
        let name = self.load.name();
        let curves = |lists: &[&[usize]], errors: &[Vec<f64>]| -> Vec<Series> {
            lists.iter().zip(errors).map(|(cells, e)| log_curve(format!("{cells:?}"), e)).collect()
        };
        let (numbers, sizes) = match self.load {
            Load::Force => ("hybrid_force_zones.svg", "hybrid_force_sizes.svg"),
            Load::Displacement => ("hybrid_displacement_zones.svg", "hybrid_displacement_sizes.svg"),
        };
        [
            figure(
                numbers,
                format!("Bar under an imposed {name}, 2 to 5 zones (cells along the bar)."),
                &format!("Number of zones, {name}"),
                "sweeps",
                curves(&ZONE_CELLS, &self.by_number),
            ),
            figure(
                sizes,
                format!("Bar under an imposed {name}, three sizes of the loaded zone (cells along the bar)."),
                &format!("Size of the loaded zone, {name}"),
                "sweeps",
                curves(&SIZE_CELLS, &self.by_size),
            ),
        ]
    }
}

fn log_curve(name: String, errors: &[f64]) -> Series {
    let points = errors.iter().enumerate().map(|(i, e)| [(i + 1) as f64, e.max(1e-16).log10()]);
    Series { name, points: points.collect(), style: SeriesStyle::Line }
}

/// Largest step down between neighbours of a list that should ascend, over the later number; 0 when it ascends.
fn disorder(ascending: &[f64]) -> f64 {
    ascending.windows(2).map(|pair| (pair[0] - pair[1]) / pair[1].abs()).fold(0.0, f64::max)
}

/// Numbers of zones, and sizes of the loaded zone (report's figs 5.3, 5.5, 5.7, 5.8).
pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<String> {
    let mut notes = String::from(
        "Sweeps in turn over pre-computed zones (method B); mean error over the edge. The zones are given by their \
         cells along the bar, the loaded one first.\n\n| load | zones | after 20 sweeps | 100 | 200 | 1,000 |\n\
         |---|---|---|---|---|---|\n",
    );
    let loads = [Curves::of(Load::Force)?, Curves::of(Load::Displacement)?];
    for curves in &loads {
        notes += &curves.table_lines();
        outcome.experiments.extend(curves.of_numbers());
        outcome.experiments.extend(curves.of_sizes());
        outcome.figures.extend(curves.figures());
    }
    let [force, displacement] = &loads;
    outcome.experiments.push(Experiment::at_most(
        "bar: what the loaded zone's size changes in the number of sweeps until 0.01 edges, displacement over force",
        SEED,
        displacement.spread() / force.spread(),
        0.2,
    ));
    Ok(notes)
}
