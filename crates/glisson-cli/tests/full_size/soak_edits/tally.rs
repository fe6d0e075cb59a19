//! What happened: counts and worst figures of a seed, kept line by line so that a long run can go on where it was
//! stopped, and their report.

use super::checks::GREATEST_STRETCH;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

/// What happened on one body.
#[derive(Clone, Serialize, Deserialize)]
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
    /// Removals by scissors.
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
    /// Edits that were taken back.
    pub(super) undone: u64,
    pub(super) grasps: u64,
    pub(super) held: u64,
    pub(super) refused: u64,
    /// With a model made afresh.
    pub(super) comparisons: u64,
    /// Nodes that were compared at rest, because what hangs at them was stretched beyond measure.
    pub(super) put_back: u64,
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
            blade_strokes: 0,
            scalpel_edits: 0,
            scalpel_strokes: 0,
            refinements: 0,
            burns: 0,
            snips: 0,
            tool_blade_edits: 0,
            stroke_partings: 0,
            singular_left: 0,
            bad_tets: 0,
            mendings: 0,
            mended_places: 0,
            tool_uses: 0,
            tears: 0,
            undone: 0,
            grasps: 0,
            held: 0,
            refused: 0,
            comparisons: 0,
            put_back: 0,
            worst_dihedral_deg: 180.0,
            worst_forces: 0.0,
            worst_weights: 0.0,
        }
    }
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

    fn add(&mut self, other: &Self) {
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
        self.tool_uses += other.tool_uses;
        self.tears += other.tears;
        self.undone += other.undone;
        self.grasps += other.grasps;
        self.held += other.held;
        self.refused += other.refused;
        self.comparisons += other.comparisons;
        self.put_back += other.put_back;
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
const VERSION: u32 = 4;

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
            "# Random edits\n{} edits in {} operations: {} of {n_seeds} seeds, at least {asked} edits each, on the explicit model (stable \
             neo-Hooke, three materials by place, relaxing stress) of a body with ligaments, loads and vessels.\n\n\
             An edit is one transaction that changed the mesh: a stroke of a blade is several, and each is checked. One that is taken \
             back and made again counts once. An operation is a removal around a place, a stroke of a blade that divides \
             tetrahedra (\"blade\") or of a scalpel that moves vertices (\"scalpel\"), a region made finer, or the use of a real tool through steps of the \
             world: hook or cautery (\"burns\"), scissors (\"snips\"), a scalpel of either kind (\"tool blade\"), a grasper that pulls until tissue tears.\n\n\
             After each edit (after each call of the tools, most of which make one): orientation of all tetrahedra, all adjacency, surface and Euler characteristics against a \
             recount; volume, and the sum of the model's masses (kept, or less by what was taken out; 1e-9); what touches and what is shown \
             against that recount; of all free nodes elastic forces with ligaments, and weights, against a plain loop over the live tetrahedra with \
             each one's own material (1e-9 of the largest); supports and loads by node, vessels by place at rest and against a search of all cut faces; skin and cut faces against the skin at the start, where no node of it moved; \
             stress memory of each tetrahedron (the same bits, or its parents'); new and moved nodes where their parents were, and new tetrahedra in edits that move no node and pull none onto another; finite numbers in the next three steps. \
             One edit in ten is taken back and made again, with the same bits. What a removal or tear leaves hanging together by a node or an edge alone is parted in the same edit, what a stroke leaves when the edge is lifted: then no node or edge holds parts together alone. \
             Every {compared_every} edits and at the end: forces, weights and supports against a model made afresh from the edited mesh, where the nodes are then; nodes of tetrahedra with an edge more than {GREATEST_STRETCH} times its \
             length are first put back at rest, since forces there are differences of much larger numbers.\n\nMade by `cargo xtask soak edits`.\n\n\
             | body | tetrahedra | seeds | removals | blade (strokes) | scalpel (strokes) | finer | burns | snips | tool blade | tears | removals and tears that parted singular places | strokes that did | places mended at strokes' ends, of bad tetrahedra | taken back | grasps | that held | refused | worst dihedral of a new or reshaped tetrahedron [deg] | comparisons | largest difference of forces | of weights |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
            all.edits(),
            all.operations(),
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
                "| {name} | {tetrahedra} | {} | {} | {} ({}) | {} ({}) | {} | {} | {} | {} | {} | {} | {} | {} of {} | {} | {} | {} | {} | {:.2} | {} | {:.1e} | {:.1e} |",
                results.of_seeds.len(),
                t.removals,
                t.blade_edits,
                t.blade_strokes,
                t.scalpel_edits,
                t.scalpel_strokes,
                t.refinements,
                t.burns,
                t.snips,
                t.tool_blade_edits,
                t.tears,
                t.partings,
                t.stroke_partings,
                t.mended_places,
                t.bad_tets,
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
        writeln!(
            report,
            "\nSingular places that could not be parted at the ends of strokes, because an edge is too short to be divided: {}.",
            all.singular_left
        )
        .unwrap();
        writeln!(report, "\nNodes put back at rest before comparisons: {}.", all.put_back).unwrap();
        writeln!(report, "\nSeeds that broke something: {n_broken}.").unwrap();
        for broken in self.broken() {
            writeln!(report, "- {}, seed {}: {}", broken.body, broken.seed, broken.broken.as_ref().unwrap())
                .unwrap();
        }
        report
    }
}
