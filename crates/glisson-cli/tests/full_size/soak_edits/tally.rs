//! What happened: counts and worst figures of a seed, kept line by line so that a long run can go on where it was
//! stopped.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::io::Write as _;
use std::path::PathBuf;

/// What happened on one body.
#[derive(Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tally {
    /// Removals by themselves.
    pub(super) removals: u64,
    /// Of these, and of the tools' removals, those that left singular places, which were parted.
    pub(super) partings: u64,
    /// Steps of dividing strokes that changed the mesh.
    pub(super) blade_edits: u64,
    /// Dividing strokes.
    pub(super) blade_strokes: u64,
    /// Steps of displacing strokes that changed the mesh.
    pub(super) scalpel_edits: u64,
    /// Displacing strokes.
    pub(super) scalpel_strokes: u64,
    pub(super) refinements: u64,
    /// Removals by hook or cautery.
    pub(super) burns: u64,
    /// Edits by scissors.
    pub(super) snips: u64,
    /// Steps of the scalpel tool that changed the mesh.
    pub(super) tool_blade_edits: u64,
    /// Strokes after which singular places were parted.
    pub(super) stroke_partings: u64,
    /// Singular places found at the ends of strokes that cannot be parted.
    pub(super) singular_left: u64,
    /// Tetrahedra below the limit near strokes, edits that mended some, and places that got better.
    pub(super) bad_tets: u64,
    pub(super) mendings: u64,
    pub(super) mended_places: u64,
    /// Uses of hook, cautery, scissors and scalpel.
    pub(super) tool_uses: u64,
    /// Removals because tissue tore.
    pub(super) tears: u64,
    /// Edits that were undone.
    pub(super) undone: u64,
    /// Calls that took the last edit back after more steps.
    pub(super) undone_late: u64,
    pub(super) grasps: u64,
    pub(super) held: u64,
    /// Refusals by reason.
    pub(super) refused: BTreeMap<String, u64>,
    /// Panics that no check made.
    pub(super) panics: u64,
    /// Positions, velocities, numbers of the history, forces on tools and energies that were not finite.
    pub(super) non_finite: u64,
    /// Steps in which a tool felt more than a wild force, and the most that one felt [N].
    pub(super) wild_steps: u64,
    pub(super) greatest_force_n: f64,
    /// Nodes that models brought back to their last finite place, and steps in which they took energy from nowhere out.
    pub(super) recovered_nodes: u64,
    pub(super) limited_steps: u64,
    /// Time in the world, and of the computer for everything, checks included [s].
    pub(super) simulated_s: f64,
    pub(super) computed_s: f64,
    /// With a model made afresh.
    pub(super) comparisons: u64,
    /// Pre-computed models that asked for a fresh pre-computation and were replaced by it.
    pub(super) renewed: u64,
    /// Nodes that were compared at rest, because what hangs at them was stretched beyond measure.
    pub(super) put_back: u64,
    /// None without a new tetrahedron.
    pub(super) worst_dihedral_deg: Option<f64>,
    pub(super) worst_forces: f64,
    pub(super) worst_weights: f64,
    pub(super) worst_compliance: f64,
}

impl Tally {
    /// Transactions that changed the mesh; taking one back and making it again counts nothing.
    pub(super) fn edits(&self) -> u64 {
        let direct = self.removals + self.blade_edits + self.scalpel_edits + self.refinements + self.mendings;
        direct + self.burns + self.snips + self.tool_blade_edits + self.tears
    }

    /// What a hand did: removals, strokes, refinements, uses of tools and grasps.
    pub(super) fn operations(&self) -> u64 {
        let direct = self.removals + self.blade_strokes + self.scalpel_strokes + self.refinements;
        direct + self.tool_uses + self.grasps
    }

    /// Counts a refusal.
    pub(super) fn refuse(&mut self, reason: &str) {
        *self.refused.entry(reason.to_string()).or_default() += 1;
    }

    pub(super) fn n_refused(&self) -> u64 {
        self.refused.values().sum()
    }

    /// Notes the least dihedral angle of a new tetrahedron.
    pub(super) fn note_dihedral(&mut self, angle_deg: f64) {
        self.worst_dihedral_deg = self.worst_dihedral_deg.into_iter().chain([angle_deg]).reduce(f64::min);
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.add_edits(other);
        self.add_findings(other);
        for (reason, n) in &other.refused {
            *self.refused.entry(reason.clone()).or_default() += n;
        }
        self.greatest_force_n = self.greatest_force_n.max(other.greatest_force_n);
        self.simulated_s += other.simulated_s;
        self.computed_s += other.computed_s;
        other.worst_dihedral_deg.into_iter().for_each(|angle_deg| self.note_dihedral(angle_deg));
        self.worst_forces = self.worst_forces.max(other.worst_forces);
        self.worst_weights = self.worst_weights.max(other.worst_weights);
        self.worst_compliance = self.worst_compliance.max(other.worst_compliance);
    }

    fn add_edits(&mut self, other: &Self) {
        self.removals += other.removals;
        self.partings += other.partings;
        self.blade_edits += other.blade_edits;
        self.blade_strokes += other.blade_strokes;
        self.scalpel_edits += other.scalpel_edits;
        self.scalpel_strokes += other.scalpel_strokes;
        self.refinements += other.refinements;
        self.burns += other.burns;
        self.snips += other.snips;
        self.tool_blade_edits += other.tool_blade_edits;
        self.stroke_partings += other.stroke_partings;
        self.singular_left += other.singular_left;
        self.bad_tets += other.bad_tets;
        self.mendings += other.mendings;
        self.mended_places += other.mended_places;
    }

    fn add_findings(&mut self, other: &Self) {
        self.tool_uses += other.tool_uses;
        self.tears += other.tears;
        self.undone += other.undone;
        self.undone_late += other.undone_late;
        self.grasps += other.grasps;
        self.held += other.held;
        self.panics += other.panics;
        self.non_finite += other.non_finite;
        self.wild_steps += other.wild_steps;
        self.recovered_nodes += other.recovered_nodes;
        self.limited_steps += other.limited_steps;
        self.comparisons += other.comparisons;
        self.renewed += other.renewed;
        self.put_back += other.put_back;
    }
}

/// Why something was refused, in short: the names of an error, and the reason that a model gives.
pub(super) fn reason(refusal: &impl Debug) -> String {
    let text = format!("{refusal:?}");
    let is_name = |c: char| c.is_alphanumeric() || c == '_' || c == '(';
    let names = text.split(|c| !is_name(c)).next().unwrap_or_default();
    let names = names.trim_end_matches('(').split('(').filter(|name| *name != "Model").collect::<Vec<_>>();
    let told =
        text.split_once("reason: \"").map(|(_, told)| told.split([';', '"']).next().unwrap_or_default());
    names.join(" ") + &told.map(|told| format!(": {told}")).unwrap_or_default()
}

/// A seed that ended.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct SeedResult {
    pub(super) body: String,
    pub(super) tetrahedra: usize,
    /// Scene names of model and law, and what else the seed drew.
    pub(super) model: String,
    pub(super) law: String,
    pub(super) touches_itself: bool,
    pub(super) tears_tissue: bool,
    pub(super) seed: u64,
    /// Edits asked for.
    pub(super) asked: u64,
    /// What it broke, if it did.
    pub(super) broken: Option<String>,
    pub(super) tally: Tally,
}

/// First line of a log: what its seeds are results of.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LogHeader {
    log_of: String,
    /// Goes up whenever a seed makes other edits, checks something else or counts otherwise.
    version: u32,
    n_seeds: u64,
    /// Edits asked for of each seed.
    asked: u64,
}

/// Version of what a seed does.
const VERSION: u32 = 5;

/// The seeds that ended, in a file if one is told.
pub(super) struct Results {
    file: Option<PathBuf>,
    pub(super) of_seeds: Vec<SeedResult>,
}

impl Results {
    /// Goes on with the seeds of a file, if there is one.
    ///
    /// # Panics
    /// If the file is a log of other seeds, or of a version that did something else.
    pub(super) fn go_on(file: Option<PathBuf>, n_seeds: u64, asked: u64) -> Self {
        let Some(file) = file else { return Self { file: None, of_seeds: Vec::new() } };
        let header = LogHeader { log_of: "random edits".into(), version: VERSION, n_seeds, asked };
        let text = std::fs::read_to_string(&file).unwrap_or_default();
        let mut lines = text.lines();
        match lines.next() {
            None => std::fs::write(&file, format!("{}\n", serde_json::to_string(&header).unwrap())).unwrap(),
            Some(first) => {
                let found = serde_json::from_str::<LogHeader>(first);
                assert!(
                    found.as_ref().is_ok_and(|found| *found == header),
                    "{}: line 1 is {found:?}; seeds are counted together only under {header:?}: name another file",
                    file.display()
                );
            }
        }
        // A line that a stopped run did not finish is no result.
        let known = lines.filter_map(|line| serde_json::from_str::<SeedResult>(line).ok());
        let of_seeds = known.filter(|r| r.broken.is_none()).collect();
        Self { file: Some(file), of_seeds }
    }

    pub(super) fn has(&self, seed: u64) -> bool {
        self.of_seeds.iter().any(|r| r.seed == seed)
    }

    pub(super) fn add(&mut self, result: SeedResult) {
        if let Some(file) = &self.file {
            let mut file = std::fs::OpenOptions::new().create(true).append(true).open(file).unwrap();
            writeln!(file, "{}", serde_json::to_string(&result).unwrap()).unwrap();
        }
        self.of_seeds.push(result);
        // The report does not tell who was ready first.
        self.of_seeds.sort_by_key(|r| r.seed);
    }

    pub(super) fn all(&self) -> Tally {
        sum_of(&self.of_seeds)
    }

    pub(super) fn broken(&self) -> impl Iterator<Item = &SeedResult> {
        self.of_seeds.iter().filter(|r| r.broken.is_some())
    }
}

/// All seeds together.
pub(super) fn sum_of(of_seeds: &[SeedResult]) -> Tally {
    of_seeds.iter().fold(Tally::default(), |mut sum, r| {
        sum.add(&r.tally);
        sum
    })
}
