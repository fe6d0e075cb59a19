//! What happened: counts and worst figures of a seed, kept line by line so that a long run can go on where it was
//! stopped, and their report.

use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

/// What happened on one body.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Tally {
    pub(super) removals: u64,
    /// Removals and tears that left singular places, which were parted.
    pub(super) partings: u64,
    pub(super) blade_edits: u64,
    pub(super) scalpel_edits: u64,
    pub(super) tears: u64,
    pub(super) refinements: u64,
    pub(super) undone: u64,
    pub(super) grasps: u64,
    pub(super) held: u64,
    pub(super) refused: u64,
    pub(super) comparisons: u64,
    pub(super) worst_dihedral_deg: f64,
    pub(super) worst_forces: f64,
    pub(super) worst_weights: f64,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            removals: 0,
            partings: 0,
            blade_edits: 0,
            scalpel_edits: 0,
            tears: 0,
            refinements: 0,
            undone: 0,
            grasps: 0,
            held: 0,
            refused: 0,
            comparisons: 0,
            worst_dihedral_deg: 180.0,
            worst_forces: 0.0,
            worst_weights: 0.0,
        }
    }
}

impl Tally {
    pub(super) fn edits(&self) -> u64 {
        self.removals + self.blade_edits + self.scalpel_edits + self.tears + self.refinements + self.undone
    }

    fn add(&mut self, other: &Self) {
        self.removals += other.removals;
        self.partings += other.partings;
        self.blade_edits += other.blade_edits;
        self.scalpel_edits += other.scalpel_edits;
        self.tears += other.tears;
        self.refinements += other.refinements;
        self.undone += other.undone;
        self.grasps += other.grasps;
        self.held += other.held;
        self.refused += other.refused;
        self.comparisons += other.comparisons;
        self.worst_dihedral_deg = self.worst_dihedral_deg.min(other.worst_dihedral_deg);
        self.worst_forces = self.worst_forces.max(other.worst_forces);
        self.worst_weights = self.worst_weights.max(other.worst_weights);
    }
}

/// A seed that ended.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct SeedResult {
    pub(super) body: String,
    pub(super) tetrahedra: usize,
    pub(super) seed: u64,
    /// Edits asked for.
    pub(super) asked: u64,
    /// What it broke, if it did.
    pub(super) broken: Option<String>,
    pub(super) tally: Tally,
}

/// The seeds that ended, in a file if one is told.
pub(super) struct Results {
    file: Option<PathBuf>,
    pub(super) of_seeds: Vec<SeedResult>,
}

impl Results {
    /// Goes on with the seeds of a file, if there is one, that were asked for as many edits.
    pub(super) fn go_on(file: Option<PathBuf>, asked: u64) -> Self {
        let text = file.as_ref().and_then(|f| std::fs::read_to_string(f).ok()).unwrap_or_default();
        // A line that a stopped run did not finish is no result.
        let known = text.lines().filter_map(|line| serde_json::from_str::<SeedResult>(line).ok());
        Self { file, of_seeds: known.filter(|r| r.asked == asked && r.broken.is_none()).collect() }
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
    }

    pub(super) fn all(&self) -> Tally {
        self.of_seeds.iter().fold(Tally::default(), |mut sum, r| {
            sum.add(&r.tally);
            sum
        })
    }

    pub(super) fn broken(&self) -> impl Iterator<Item = &SeedResult> {
        self.of_seeds.iter().filter(|r| r.broken.is_some())
    }

    /// The text of docs/soak_edits.md.
    pub(super) fn report(&self, n_seeds: u64, asked: u64, compared_every: u64) -> String {
        let all = self.all();
        let mut report = format!(
            "# Random edits\n{} edits: {} of {n_seeds} seeds, at least {asked} edits each, on the explicit model (stable \
             neo-Hooke). Removals around a place, strokes of a blade that divides tetrahedra, strokes of a scalpel that moves \
             vertices, grasps that pull until tissue tears, regions made finer.\n\n\
             After each edit: orientation of all tetrahedra, all adjacency, surface and Euler characteristics against a \
             recount, volume (kept, or less by what was taken out; 1e-9), what touches and what is shown against that \
             recount, lengths of all attached arrays, finite numbers in the next three steps. One edit in ten is undone and done \
             again, with the same bits. What a removal or tear leaves hanging together by a node or an edge alone is parted in the same edit. Every {compared_every} edits and at the end: elastic forces and weights of all free nodes, \
             and which nodes are supported, against a model made afresh from the edited mesh; both have to agree to 1e-9 of \
             the largest.\n\nMade by `cargo xtask soak edits`.\n\n\
             | body | tetrahedra | seeds | removals | blade | scalpel | tears | finer | singular places parted | undone | grasps | that held | refused | worst dihedral of a new tetrahedron [deg] | comparisons | largest difference of forces | of weights |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
            all.edits(),
            self.of_seeds.len(),
        );
        let mut bodies: Vec<(&str, usize)> =
            self.of_seeds.iter().map(|r| (r.body.as_str(), r.tetrahedra)).collect();
        bodies.sort_unstable();
        bodies.dedup();
        let rows = bodies.into_iter().map(|(body, tetrahedra)| {
            let of_body: Vec<_> = self.of_seeds.iter().filter(|r| r.body == body).cloned().collect();
            (body, tetrahedra.to_string(), Self { file: None, of_seeds: of_body })
        });
        let whole = Self { file: None, of_seeds: self.of_seeds.clone() };
        for (name, tetrahedra, results) in rows.chain([("all", String::new(), whole)]) {
            let t = results.all();
            writeln!(
                report,
                "| {name} | {tetrahedra} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {:.1e} | {:.1e} |",
                results.of_seeds.len(),
                t.removals,
                t.blade_edits,
                t.scalpel_edits,
                t.tears,
                t.refinements,
                t.partings,
                t.undone,
                t.grasps,
                t.held,
                t.refused,
                t.worst_dihedral_deg,
                t.comparisons,
                t.worst_forces,
                t.worst_weights,
            )
            .unwrap();
        }
        let n_broken = self.broken().count();
        writeln!(report, "\nSeeds that broke something: {n_broken}.").unwrap();
        for broken in self.broken() {
            writeln!(report, "- {}, seed {}: {}", broken.body, broken.seed, broken.broken.as_ref().unwrap())
                .unwrap();
        }
        report
    }
}
