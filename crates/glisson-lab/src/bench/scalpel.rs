//! Cases of the scalpel that cuts by vertex displacement: planning and edits of the mesh alone, and of a whole world.

use std::hint::black_box;

use anyhow::Context;
use glam::DVec3;
use glisson::mesh::edit::{EditableMesh, TopologyChange};
use glisson::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use glisson::world::World;
use glisson::world::saved::SavedWorld;

use super::body::StandardBody;
use super::timing::untimed;
use super::world::{self, world_of};
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "scalpel_step",
        about: "the blade goes 0.1 mm further into the surface (0.1 m/s at 1 kHz), mesh alone; few steps open anything",
        per: "step",
        sizes: &[2_000, 6_300, 20_000],
        parallel: false,
        prepare: |settings| scalpel(settings, Some(STEP_M)),
    },
    Case {
        name: "scalpel_opening",
        about: "the blade goes on by a mean edge: nodes are selected, moved and opened",
        per: "edge",
        sizes: &[2_000, 6_300, 20_000],
        parallel: false,
        prepare: |settings| scalpel(settings, None),
    },
    Case {
        name: "scalpel_world_opening",
        about: "only those steps of 0.1 mm that move or open nodes, as whole transactions of a world: mesh, explicit model, collision, journal",
        per: "step",
        sizes: &[2_000, 6_300, 20_000],
        parallel: false,
        prepare: |settings| in_world(settings, true),
    },
    Case {
        name: "scalpel_world_idle",
        about: "the steps between them, that change nothing",
        per: "step",
        sizes: &[2_000, 6_300, 20_000],
        parallel: false,
        prepare: |settings| in_world(settings, false),
    },
];

/// Motion in a step [m].
const STEP_M: f64 = 1e-4;
/// Depth of the tip below the highest point [m].
const DEPTH_M: f64 = 0.012;

/// One blade that goes across the body again and again, each time elsewhere and on a whole body.
struct Strokes {
    whole: EditableMesh,
    body: EditableMesh,
    cut: ScalpelCut,
    change: TopologyChange,
    /// Tip at the start and at the end [m], moved sideways by each stroke.
    ends_m: [DVec3; 2],
    n_steps: usize,
    n_done: usize,
    n_strokes: usize,
}

impl Strokes {
    fn step(&mut self) {
        if self.n_done > self.n_steps {
            // The median does not see the new start.
            self.body.clone_from(&self.whole);
            self.cut = ScalpelCut::new(ScalpelParams::default());
            self.n_strokes += 1;
            self.n_done = 0;
        }
        let sideways_m = 0.004 * (self.n_strokes % 9) as f64 - 0.016;
        let share = self.n_done as f64 / self.n_steps as f64;
        let tip_m = self.ends_m[0].lerp(self.ends_m[1], share) + sideways_m * DVec3::Y;
        self.n_done += 1;
        let blade_m = [tip_m, tip_m + 0.1 * DVec3::Z];
        // At rest the present positions are the mesh's own.
        while let Ok(Some(edits)) = self.cut.advance(&self.body, &self.body.mesh().positions_m, blade_m) {
            for edit in &edits {
                if self.body.apply_into(edit, &mut self.change).is_err() {
                    self.n_done = self.n_steps + 1;
                    return;
                }
            }
        }
    }
}

/// Strokes beside each other before all of them are made again.
const N_BESIDE: usize = 9;

/// The same strokes through a world's transactions.
struct WorldStrokes {
    world: World,
    whole: SavedWorld,
    cut: ScalpelCut,
    ends_m: [DVec3; 2],
    n_steps: usize,
    /// Which of all strokes' steps comes next.
    next: usize,
}

impl WorldStrokes {
    /// A step; how many transactions it took, or none and that one was refused.
    fn step(&mut self) -> (usize, bool) {
        let (stroke, step) = (self.next / (self.n_steps + 1), self.next % (self.n_steps + 1));
        let sideways_m = 0.004 * stroke as f64 - 0.016;
        let tip_m =
            self.ends_m[0].lerp(self.ends_m[1], step as f64 / self.n_steps as f64) + sideways_m * DVec3::Y;
        let blade_m = [tip_m, tip_m + 0.1 * DVec3::Z];
        let mut n_edits = 0;
        loop {
            let world = &self.world;
            match self.cut.advance(world.organ().body(), world.state().positions_m, blade_m) {
                Ok(Some(edits)) => match self.world.edit_all(&edits) {
                    Ok(_) => n_edits += 1,
                    Err(_) => return (n_edits, true),
                },
                Ok(None) => return (n_edits, false),
                Err(_) => return (n_edits, true),
            }
        }
    }

    /// The world is whole again before every stroke.
    fn advance(&mut self) {
        self.next = (self.next + 1) % (N_BESIDE * (self.n_steps + 1));
        if self.next.is_multiple_of(self.n_steps + 1) {
            self.world.restore(&self.whole);
            self.cut = ScalpelCut::new(ScalpelParams::default());
        }
    }
}

fn in_world(settings: Settings, opening: bool) -> anyhow::Result<Prepared> {
    let world = world_of(settings.size, 1)?;
    let size = world.organ().mesh().tetrahedra.len();
    let top_m = world.organ().mesh().positions_m.iter().fold(f64::NEG_INFINITY, |most, p| p.z.max(most));
    let tip_m = DVec3::new(0.0, 0.0, top_m - DEPTH_M);
    let ends_m = [tip_m - 0.1 * DVec3::X, tip_m + 0.1 * DVec3::X];
    let n_steps = (ends_m[0].distance(ends_m[1]) / STEP_M).ceil() as usize;
    let (whole, cut) = (world.save(), ScalpelCut::new(ScalpelParams::default()));
    let mut strokes = WorldStrokes { world, whole, cut, ends_m, n_steps, next: 0 };
    // A first round tells which steps open: the next rounds are the same.
    let (mut opens, mut n_refused, mut n_edits, mut n_copies) = (Vec::new(), 0, 0, 0);
    for _ in 0..N_BESIDE * (n_steps + 1) {
        let (n, is_refused) = strokes.step();
        opens.push(n > 0);
        n_edits += n;
        n_refused += usize::from(is_refused);
        if (strokes.next + 1).is_multiple_of(n_steps + 1) {
            n_copies += strokes.cut.report().n_copies;
        }
        strokes.advance();
    }
    let n_opening = opens.iter().filter(|o| **o).count();
    anyhow::ensure!(n_opening > 0, "the strokes of the benchmark open nothing");
    let note = format!(
        "{n_opening} of {} steps open, by {n_edits} transactions that copy {n_copies} nodes; {n_refused} refused",
        opens.len()
    );
    let run = move || {
        untimed(|| {
            while opens[strokes.next] != opening {
                strokes.step();
                strokes.advance();
            }
        });
        black_box(strokes.step());
        untimed(|| strokes.advance());
    };
    Ok(world::prepared(size, note, Box::new(run)))
}

fn scalpel(settings: Settings, step_m: Option<f64>) -> anyhow::Result<Prepared> {
    let standard = StandardBody::shared(settings.size)?;
    let mut whole = EditableMesh::new(standard.mesh.clone()).context("the ellipsoid")?;
    whole.reserve(1_000);
    let topology = whole.topology();
    let positions_m = &standard.mesh.positions_m;
    let (sum_m, n_edges) =
        topology.live_edges().filter(|&e| topology.is_surface_edge(e)).fold((0.0, 0), |(sum_m, n), edge| {
            let [a, b] = topology.edge_nodes(edge).map(|n| positions_m[n.index()]);
            (sum_m + a.distance(b), n + 1)
        });
    let edge_m = sum_m / f64::from(n_edges);
    let top_m = positions_m.iter().fold(f64::NEG_INFINITY, |most, p| p.z.max(most));
    let tip_m = DVec3::new(0.0, 0.0, top_m - DEPTH_M);
    let ends_m = [tip_m - 0.1 * DVec3::X, tip_m + 0.1 * DVec3::X];
    let n_steps = (ends_m[0].distance(ends_m[1]) / step_m.unwrap_or(edge_m)).ceil() as usize;
    let mut strokes = Strokes {
        body: whole.clone(),
        whole,
        cut: ScalpelCut::new(ScalpelParams::default()),
        change: TopologyChange::default(),
        ends_m,
        n_steps,
        n_done: 0,
        n_strokes: 0,
    };
    for _ in 0..=n_steps {
        strokes.step();
    }
    let note = format!(
        "surface edges {:.1} mm; the first stroke of {n_steps} steps opens {} nodes",
        1e3 * edge_m,
        strokes.cut.report().n_copies
    );
    Ok(Prepared {
        size: standard.mesh.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        work: None,
        note,
        run: Box::new(move || strokes.step()),
    })
}
