//! The text of docs/soak_edits.md.

use super::checks::GREATEST_STRETCH;
use super::compare::COMPLIANCE_TOLERANCE;
use super::operations::{COMPARED_EVERY, COMPLIANCE_EVERY};
use super::patient::WILD_N;
use super::tally::{SeedResult, Tally, sum_of};
use std::fmt::Write as _;

/// What ran.
pub(super) struct Run<'a> {
    pub(super) of_seeds: &'a [SeedResult],
    pub(super) n_seeds: u64,
    /// Edits asked for of each seed.
    pub(super) asked: u64,
}

impl Run<'_> {
    pub(super) fn report(&self) -> String {
        let mut report = self.head();
        self.add_models(&mut report);
        self.add_refusals(&mut report);
        self.add_bodies(&mut report);
        self.add_findings(&mut report);
        report
    }

    fn head(&self) -> String {
        let all = sum_of(self.of_seeds);
        format!(
            "# Random edits\n{} edits in {} operations: {} of {} seeds, about {} edits each. A seed draws a body with loads and vessels, and from what \
             docs/scene.md says can be cut: models, laws and bodies take turns; self-contact, tearing, relaxing stress, damping, mending, hook or cautery, \
             the way in which a blade cuts and the time step (the longest stable one of those from the drawn one on) are at random. Models that know them have \
             ligaments. `explicit` with the first four laws is made of three materials by place. Fibres, volume penalties and gravity are not drawn.\n\n{}\n\n{}\n\n{}\n\n\
             Made by `cargo xtask soak edits`.\n",
            all.edits(),
            all.operations(),
            self.of_seeds.len(),
            self.n_seeds,
            self.asked,
            what_an_edit_is(),
            checks_of_all(),
            checks_by_model(),
        )
    }

    /// A table by model and law.
    fn add_models(&self, report: &mut String) {
        report.push_str(
            "\n## Models and laws\n| model | law | seeds | with self-contact | with tearing | edits | undone (later) | refused | panics | checks failed | not finite | \
             steps with a wild force | greatest force on a tool [N] | nodes recovered | steps with energy taken out | comparisons | largest difference of forces | of weights | simulated [s] | computed [s] |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        );
        let mut kinds: Vec<[&str; 2]> = Vec::new();
        for result in self.of_seeds {
            let kind = [result.model.as_str(), result.law.as_str()];
            if !kinds.contains(&kind) {
                kinds.push(kind);
            }
        }
        kinds.sort_unstable();
        for [model, law] in kinds {
            let own: Vec<SeedResult> =
                self.of_seeds.iter().filter(|r| r.model == model && r.law == law).cloned().collect();
            add_model_row(report, [model, law], &own);
        }
        add_model_row(report, ["all", ""], self.of_seeds);
    }

    /// A table of refusals by model and reason.
    fn add_refusals(&self, report: &mut String) {
        report.push_str("\n## Refusals\n| model | reason | times |\n|---|---|---|\n");
        let mut models: Vec<&str> = self.of_seeds.iter().map(|r| r.model.as_str()).collect();
        models.sort_unstable();
        models.dedup();
        for model in models {
            let own: Vec<SeedResult> = self.of_seeds.iter().filter(|r| r.model == model).cloned().collect();
            for (reason, n) in sum_of(&own).refused {
                writeln!(report, "| {model} | {reason} | {n} |").unwrap();
            }
        }
    }

    /// A table by body.
    fn add_bodies(&self, report: &mut String) {
        report.push_str(
            "\n## Bodies\n| body | tetrahedra | seeds | removals | blade (strokes) | scalpel (strokes) | finer | burns | snips | tool blade | tears | \
             removals and tears that parted singular places | strokes that did | places mended at strokes' ends, of bad tetrahedra | undone | grasps | that held | refused | \
             worst dihedral of a new or reshaped tetrahedron [deg] |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        );
        let mut bodies: Vec<(&str, usize)> =
            self.of_seeds.iter().map(|r| (r.body.as_str(), r.tetrahedra)).collect();
        bodies.sort_unstable();
        bodies.dedup();
        for (body, tetrahedra) in bodies {
            let own: Vec<SeedResult> = self.of_seeds.iter().filter(|r| r.body == body).cloned().collect();
            add_body_row(report, [body, &tetrahedra.to_string()], &own);
        }
        add_body_row(report, ["all", ""], self.of_seeds);
    }

    fn add_findings(&self, report: &mut String) {
        let all = sum_of(self.of_seeds);
        writeln!(
            report,
            "\nSingular places that could not be parted at the ends of strokes, because an edge is too short to be divided: {}.\n\n\
             Nodes put back at rest before comparisons: {}.\n\n\
             Pre-computed models that asked for a fresh pre-computation and were replaced by it: {}. Largest difference of the forces of others from those of a fresh one: {:.1e}.",
            all.singular_left, all.put_back, all.renewed, all.worst_compliance,
        )
        .unwrap();
        let broken: Vec<&SeedResult> = self.of_seeds.iter().filter(|r| r.broken.is_some()).collect();
        writeln!(report, "\nSeeds that broke something: {}.", broken.len()).unwrap();
        for result in broken {
            let told = result.broken.as_deref().unwrap_or_default();
            writeln!(
                report,
                "- {}, seed {}, {}, {}: {told}",
                result.body, result.seed, result.model, result.law
            )
            .unwrap();
        }
    }
}

fn what_an_edit_is() -> String {
    "An edit is one transaction that changed the mesh: a stroke of a blade is several, and each is checked. One that is taken \
     back and made again counts once. An operation is a removal around a place, a stroke of a blade that divides \
     tetrahedra (\"blade\") or of a scalpel that moves vertices (\"scalpel\"), a region made finer, or the use of a real tool through steps of the \
     world: hook or cautery (\"burns\"), scissors (\"snips\"), a scalpel of either kind (\"tool blade\"), a grasper that pulls until tissue tears. \
     Steps of the world are made within and after each."
        .to_string()
}

/// Checks that hold for every model.
fn checks_of_all() -> String {
    format!(
        "With every model, after each edit (after each call of the tools, most of which make one): orientation of all tetrahedra, all adjacency, surface and Euler \
         characteristics against a recount; volume (kept, or less by what was taken out; 1e-9); what touches and what is shown \
         against that recount; supports and loads by node, vessels by place at rest and against a search of all cut faces; skin and cut faces against the skin at the \
         start, where no node of it moved; new and moved nodes where their parents were, and new tetrahedra in edits that move no node and pull none onto another. \
         A refused edit changes no bit. One edit in ten is undone and made again, with the same bits; some are undone after more steps. In each step all positions, velocities, \
         numbers of the history, forces on tools and kinetic energies are finite; a force on a tool above {WILD_N} N is wild, counted and not failed."
    )
}

/// Checks that differ.
fn checks_by_model() -> String {
    format!(
        "- `explicit`, `implicit`, `tensor_mass`, `nonlinear_tensor_mass`, `extended_mass_spring`: after each edit the sum of the model's masses (1e-9), and of all free nodes \
         elastic forces with ligaments, and weights, against a plain loop over the live tetrahedra with each one's own material and law (1e-9 of the largest). Every {COMPARED_EVERY} edits and \
         at the end: forces, weights and supports against a model made afresh from the edited mesh, where the nodes are then; nodes of tetrahedra with an edge more than {GREATEST_STRETCH} times its \
         length, and of those near turning inside out with models and laws that end there (`implicit`: far from rest), are first put back at rest, since forces there are differences of much larger numbers.\n\
         - `mass_spring`: the same, but springs have no law: forces are compared with the model made afresh alone.\n\
         - `explicit` with relaxing stress: the stress memory of each tetrahedron (the same bits, or its parents').\n\
         - All of these: what a removal or tear leaves hanging together by a node or an edge alone is parted in the same edit, what a stroke leaves when the edge is lifted: then no node or edge holds parts together alone.\n\
         - `precomputed`, `hybrid`: they follow removals alone, so that parting, strokes and finer regions are refused. `precomputed`: every {COMPLIANCE_EVERY} edits and at the end the forces that hold some nodes out of their places, against those of \
         a model pre-computed afresh from what is left ({COMPLIANCE_TOLERANCE:e} of the largest). `hybrid`: a fresh model would have other zones; nothing is compared."
    )
}

fn add_model_row(report: &mut String, [model, law]: [&str; 2], own: &[SeedResult]) {
    let t: Tally = sum_of(own);
    let n_broken = own.iter().filter(|r| r.broken.is_some()).count() as u64;
    let failed = n_broken - t.panics;
    writeln!(
        report,
        "| {model} | {law} | {} | {} | {} | {} | {} ({}) | {} | {} | {failed} | {} | {} | {:.3} | {} | {} | {} | {:.1e} | {:.1e} | {:.1} | {:.0} |",
        own.len(),
        own.iter().filter(|r| r.touches_itself).count(),
        own.iter().filter(|r| r.tears_tissue).count(),
        t.edits(),
        t.undone,
        t.undone_late,
        t.n_refused(),
        t.panics,
        t.non_finite,
        t.wild_steps,
        t.greatest_force_n,
        t.recovered_nodes,
        t.limited_steps,
        t.comparisons,
        t.worst_forces.max(t.worst_compliance),
        t.worst_weights,
        t.simulated_s,
        t.computed_s,
    )
    .unwrap();
}

fn add_body_row(report: &mut String, [name, tetrahedra]: [&str; 2], own: &[SeedResult]) {
    let t = sum_of(own);
    writeln!(
        report,
        "| {name} | {tetrahedra} | {} | {} | {} ({}) | {} ({}) | {} | {} | {} | {} | {} | {} | {} | {} of {} | {} | {} | {} | {} | {:.2} |",
        own.len(),
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
        t.n_refused(),
        t.worst_dihedral_deg.unwrap_or(180.0),
    )
    .unwrap();
}
