//! The metrics of an assessment: one row each, with its formula, unit, source, and what is known of its validity.

use super::gestures::{GestureKind, cuts, gestures, slips};
use super::motion::{
    REST_M_PER_S, angular_path_rad, depth_path_m, economy, free_ways, movements, path_length_m,
    speeds_m_per_s,
};
use super::smoothness::{log_dimensionless_jerk, sparc};
use super::trace::{ToolTrace, Trace};
use crate::math::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Mean force with which forceps gripped the liver in laparoscopic hepatectomies of pigs, the greatest was 3.38 N; damage grew with
/// the force [N] (doi 10.1080/13645706.2020.1755313). Here the threshold of the force between an instrument and tissue, unless a
/// task gives its own: a choice.
pub const GRIP_OF_PORCINE_LIVER_N: f64 = 1.75;

/// Which way a metric is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Smaller values are better.
    Less,
    /// Larger values are better.
    More,
    /// Neither: it describes.
    Neither,
}

/// What is published about whether a metric tells the skilled from the unskilled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Validity {
    /// It told groups of different experience apart in every task of the source.
    AllTasks,
    /// In some tasks of the source.
    SomeTasks,
    /// The source measures it, or defines it, for another purpose.
    Defined,
    /// None is known to us.
    None,
}

/// What a metric is computed from.
pub struct Measured<'a> {
    /// The whole session.
    pub trace: &'a Trace,
    /// Threshold of the forces [N].
    pub threshold_n: f64,
    hands: Vec<Hand<'a>>,
}

/// What several metrics of an instrument need.
struct Hand<'a> {
    tool: &'a ToolTrace,
    tips_m: Vec<DVec3>,
    shafts: Vec<DVec3>,
    speeds_m_per_s: Vec<f64>,
    movements: Vec<Range<usize>>,
    free_ways: Vec<Range<usize>>,
}

impl<'a> Measured<'a> {
    /// A session, and the threshold of its forces [N].
    pub fn new(trace: &'a Trace, threshold_n: f64) -> Self {
        let hand = |tool: &'a ToolTrace| {
            let tips_m = tool.tips_m();
            let speeds_m_per_s = speeds_m_per_s(&tips_m, trace.period_s);
            let movements = movements(&speeds_m_per_s, trace.period_s);
            let works = |at: usize| tool.touches[at] || cuts(trace, tool, at);
            let works: Vec<bool> = (0..trace.n_samples()).map(works).collect();
            let free_ways = free_ways(&speeds_m_per_s, &works, trace.period_s);
            Hand { tool, tips_m, shafts: tool.shafts(), speeds_m_per_s, movements, free_ways }
        };
        Self { trace, threshold_n, hands: trace.tools.iter().map(hand).collect() }
    }
}

/// How a metric is computed; none where it has no meaning.
#[derive(Clone, Copy)]
enum Formula {
    /// Of one instrument.
    Hand(fn(&Measured<'_>, &Hand<'_>) -> Option<f64>),
    /// Of the whole session.
    Session(fn(&Measured<'_>) -> Option<f64>),
}

/// A metric: a row of [`METRICS`].
#[derive(Clone, Copy)]
pub struct Metric {
    /// Its name in files.
    pub name: &'static str,
    /// Its name in reports.
    pub title: &'static str,
    /// SI unit; empty for a plain number.
    pub unit: &'static str,
    /// Which way is better.
    pub better: Better,
    /// How it is computed, in words.
    pub formula: &'static str,
    /// Where it comes from.
    pub source: &'static str,
    /// What is known of its validity.
    pub validity: Validity,
    value: Formula,
}

impl std::fmt::Debug for Metric {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

const OROPESA: &str = "Oropesa et al. 2013, doi 10.1177/1553350612459808";
const CHMARRA: &str = "Chmarra et al. 2010, doi 10.1007/s00464-009-0721-y";
const BALASUBRAMANIAN: &str = "Balasubramanian et al. 2015, doi 10.1186/s12984-015-0090-9";
const GRIP: &str = "porcine liver gripped with 1.75 N on average: doi 10.1080/13645706.2020.1755313";
const TEARING: &str = "a liver's capsule tore at a strain of 0.47 on average: Brunon et al. 2010, doi 10.1016/j.jbiomech.2010.03.038";
const OURS: &str = "ours";

/// All metrics, in the order of reports.
pub const METRICS: &[Metric] = &[
    Metric {
        name: "time",
        title: "Time",
        unit: "s",
        better: Better::Less,
        formula: "from the beginning to the end of the task",
        source: OROPESA,
        validity: Validity::AllTasks,
        value: Formula::Session(|m| Some(m.trace.duration_s())),
    },
    Metric {
        name: "path_length",
        title: "Path length",
        unit: "m",
        better: Better::Less,
        formula: "way of the instrument's tip",
        source: OROPESA,
        validity: Validity::AllTasks,
        value: Formula::Hand(|_, hand| Some(path_length_m(&hand.tips_m))),
    },
    Metric {
        name: "depth_path",
        title: "Depth perception",
        unit: "m",
        better: Better::Less,
        formula: "way of the tip along the instrument's axis, in and out",
        source: OROPESA,
        validity: Validity::AllTasks,
        value: Formula::Hand(|_, hand| Some(depth_path_m(&hand.tips_m, &hand.shafts))),
    },
    Metric {
        name: "angular_path",
        title: "Angular path",
        unit: "rad",
        better: Better::Less,
        formula: "sum of the angles by which the instrument's axis turned",
        source: CHMARRA,
        validity: Validity::Defined,
        value: Formula::Hand(|_, hand| Some(angular_path_rad(&hand.shafts))),
    },
    Metric {
        name: "movements",
        title: "Movements",
        unit: "",
        better: Better::Less,
        formula: "stretches in which the tip is faster than 5 mm/s for 0.1 s at least; rests of less than 0.1 s do not end one",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(|_, hand| Some(hand.movements.len() as f64)),
    },
    Metric {
        name: "economy",
        title: "Economy of motion",
        unit: "",
        better: Better::More,
        formula: "straight distances from the beginnings to the ends of all free ways, from one touch or cut to the next, over their lengths",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(|_, hand| economy(&hand.tips_m, &hand.free_ways)),
    },
    Metric {
        name: "smoothness_sparc",
        title: "Smoothness (SPARC)",
        unit: "",
        better: Better::More,
        formula: "spectral arc length of the tip's speed on each free way, from one touch or cut to the next, mean by their times",
        source: BALASUBRAMANIAN,
        validity: Validity::Defined,
        value: Formula::Hand(|m, hand| smoothness(m, hand, sparc)),
    },
    Metric {
        name: "smoothness_ldlj",
        title: "Smoothness (log dimensionless jerk)",
        unit: "",
        better: Better::More,
        formula: "log dimensionless jerk of the tip's speed on each free way, from one touch or cut to the next, mean by their times",
        source: BALASUBRAMANIAN,
        validity: Validity::Defined,
        value: Formula::Hand(|m, hand| smoothness(m, hand, log_dimensionless_jerk)),
    },
    Metric {
        name: "idle_time",
        title: "Idle time",
        unit: "s",
        better: Better::Less,
        formula: "time in which the tip is slower than 5 mm/s and touches nothing; not of endoscopes, which are to stand still",
        source: OROPESA,
        validity: Validity::SomeTasks,
        value: Formula::Hand(|m, hand| (!hand.tool.is_endoscope).then(|| idle_s(m, hand))),
    },
    Metric {
        name: "out_of_view_time",
        title: "Time out of view",
        unit: "s",
        better: Better::Less,
        formula: "time in which no endoscope has the tip in the cone that it sees",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(|m, hand| {
            let unseen = hand.tool.is_seen.iter().skip(1).filter(|is_seen| !**is_seen).count();
            (!hand.tool.is_seen.is_empty()).then_some(unseen as f64 * m.trace.period_s)
        }),
    },
    Metric {
        name: "hand_balance",
        title: "Balance of hands",
        unit: "",
        better: Better::More,
        formula: "of the two instruments with the longest ways, endoscopes left out, the shorter way over the longer one",
        source: OURS,
        validity: Validity::None,
        value: Formula::Session(hand_balance),
    },
    Metric {
        name: "mean_force",
        title: "Mean force",
        unit: "N",
        better: Better::Less,
        formula: "size of the force on the instrument, mean over the samples (10 ms) in which it touches",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(mean_force_n),
    },
    Metric {
        name: "peak_force",
        title: "Greatest force",
        unit: "N",
        better: Better::Less,
        formula: "greatest size of the force on the instrument",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(|_, hand| Some(hand.tool.peak_force_n.iter().copied().fold(0.0, f64::max))),
    },
    Metric {
        name: "time_over_threshold",
        title: "Time above the force threshold",
        unit: "s",
        better: Better::Less,
        formula: "time of the samples (10 ms) whose greatest force on the instrument exceeds the threshold",
        source: GRIP,
        validity: Validity::Defined,
        value: Formula::Hand(|m, hand| {
            let above = hand.tool.peak_force_n.iter().filter(|peak_n| **peak_n > m.threshold_n);
            Some(above.count() as f64 * m.trace.period_s)
        }),
    },
    Metric {
        name: "surface_strain",
        title: "Greatest strain of the surface",
        unit: "",
        better: Better::Less,
        formula: "greatest stretch less one of the organs' surface in its plane, each vertex with the mean of its triangles; cuts and \
                  what touches them left out",
        source: TEARING,
        validity: Validity::Defined,
        value: Formula::Session(|m| m.trace.surface_strain.iter().copied().reduce(f64::max)),
    },
    Metric {
        name: "overstrained_area",
        title: "Surface strained beyond tearing",
        unit: "m2",
        better: Better::Less,
        formula: "greatest area at rest whose strain exceeds 0.47 at one time",
        source: TEARING,
        validity: Validity::Defined,
        value: Formula::Session(|m| m.trace.overstrained_m2.iter().copied().reduce(f64::max)),
    },
    Metric {
        name: "slips",
        title: "Slips",
        unit: "",
        better: Better::Less,
        formula: "times at which tissue left jaws that had not opened since they took it",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(|m, hand| Some(slips(m.trace, hand.tool).len() as f64)),
    },
    Metric {
        name: "grasps",
        title: "Grasps",
        unit: "",
        better: Better::Neither,
        formula: "times at which the jaws took tissue",
        source: OURS,
        validity: Validity::None,
        value: Formula::Hand(|m, hand| Some(n_grasps(m, hand))),
    },
    Metric {
        name: "clash_time",
        title: "Clashes of instruments",
        unit: "s",
        better: Better::Less,
        formula: "time of the samples (10 ms) at which two instruments press on each other",
        source: OURS,
        validity: Validity::None,
        value: Formula::Session(|m| {
            let clashing = m.trace.n_clashing.iter().filter(|n| **n > 0).count();
            Some(clashing as f64 * m.trace.period_s)
        }),
    },
    Metric {
        name: "blood_lost",
        title: "Blood lost",
        unit: "m3",
        better: Better::Less,
        formula: "blood that came out of severed vessels",
        source: OURS,
        validity: Validity::None,
        value: Formula::Session(|m| m.trace.blood_lost_m3.last().copied()),
    },
    Metric {
        name: "volume_removed",
        title: "Tissue taken out",
        unit: "m3",
        better: Better::Neither,
        formula: "volume at rest of the tissue that was taken out",
        source: OURS,
        validity: Validity::None,
        value: Formula::Session(|m| m.trace.removed_m3.last().copied()),
    },
    Metric {
        name: "cut_area",
        title: "Area cut",
        unit: "m2",
        better: Better::Neither,
        formula: "area that blades opened, one side",
        source: OURS,
        validity: Validity::None,
        value: Formula::Session(|m| m.trace.cut_area_m2.last().copied()),
    },
];

/// The mean of a smoothness over all free ways, by their times.
fn smoothness(m: &Measured<'_>, hand: &Hand<'_>, of: fn(&[f64], f64) -> Option<f64>) -> Option<f64> {
    // An endoscope works by being moved: no way of it is free.
    if hand.tool.is_endoscope {
        return None;
    }
    let (mut sum, mut n_samples) = (0.0, 0);
    for way in &hand.free_ways {
        if let Some(value) = of(&hand.speeds_m_per_s[way.clone()], m.trace.period_s) {
            sum += value * way.len() as f64;
            n_samples += way.len();
        }
    }
    (n_samples > 0).then(|| sum / n_samples as f64)
}

fn idle_s(m: &Measured<'_>, hand: &Hand<'_>) -> f64 {
    let idle = hand.speeds_m_per_s.iter().zip(hand.tool.touches.iter().skip(1));
    let n = idle.filter(|(speed, touches)| **speed < REST_M_PER_S && !**touches).count();
    n as f64 * m.trace.period_s
}

fn hand_balance(m: &Measured<'_>) -> Option<f64> {
    let hands = m.hands.iter().filter(|hand| !hand.tool.is_endoscope);
    let mut ways_m: Vec<f64> = hands.map(|hand| path_length_m(&hand.tips_m)).collect();
    ways_m.sort_by(|a, b| b.total_cmp(a));
    match ways_m[..] {
        [longer_m, shorter_m, ..] if longer_m > 0.0 => Some(shorter_m / longer_m),
        _ => None,
    }
}

fn mean_force_n(_: &Measured<'_>, hand: &Hand<'_>) -> Option<f64> {
    let forces_n = hand.tool.mean_force_n.iter().zip(&hand.tool.touches);
    let touching: Vec<f64> = forces_n.filter(|(_, touches)| **touches).map(|(force_n, _)| *force_n).collect();
    (!touching.is_empty()).then(|| touching.iter().sum::<f64>() / touching.len() as f64)
}

fn n_grasps(m: &Measured<'_>, hand: &Hand<'_>) -> f64 {
    let holds = |kind| matches!(kind, GestureKind::Grasp | GestureKind::Pull);
    let gestures = gestures(m.trace, hand.tool);
    let begins = |at: &usize| holds(gestures[*at].kind) && (*at == 0 || !holds(gestures[*at - 1].kind));
    (0..gestures.len()).filter(begins).count() as f64
}

/// A metric's value.
#[derive(Clone, Copy, Debug)]
pub struct MetricValue {
    /// Which metric.
    pub metric: &'static Metric,
    /// Of which instrument; none for one of the whole session.
    pub tool: Option<usize>,
    /// Its value, in the metric's unit.
    pub value: f64,
}

/// All metrics that have a meaning, in the order of [`METRICS`], then of the instruments.
pub fn measure(measured: &Measured<'_>) -> Vec<MetricValue> {
    let mut values = Vec::new();
    for metric in METRICS {
        match metric.value {
            Formula::Session(of) => {
                values.extend(of(measured).map(|value| MetricValue { metric, tool: None, value }));
            }
            Formula::Hand(of) => {
                for (place, hand) in measured.hands.iter().enumerate() {
                    let value = of(measured, hand);
                    values.extend(value.map(|value| MetricValue { metric, tool: Some(place), value }));
                }
            }
        }
    }
    values
}
