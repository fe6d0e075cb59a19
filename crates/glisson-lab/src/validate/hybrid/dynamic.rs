//! Frontiers between pre-computed and tensor-mass zones, and a zone that is cut.

use super::{Case, Load, OWN, STEP_S, liver_ends, timed_s};
use crate::bodies::liver;
use crate::validate::{Experiment, Outcome};
use glisson::mesh::zones::Zones;
use glisson::mesh::{NodeId, TetId};
use glisson::model::DeformableModel;
use glisson::model::hybrid::exchange::{ExchangeParams, HybridExchange, Overlap, ZoneLaw, ZoneSize};

const DAMPING_PER_S: f64 = 30.0;

/// Overlaps of three zones, the middle one tensor-mass, and time between two exchanges [s]: slow enough, then hurried.
const OVERLAPS: [(&str, Overlap, f64); 6] = [
    ("two nodes", Overlap::Nodes(2), 1e-3),
    ("two nodes", Overlap::Nodes(2), 1e-2),
    ("three nodes", Overlap::Nodes(3), 0.3),
    ("four nodes", Overlap::Nodes(4), 0.3),
    ("three nodes", Overlap::Nodes(3), 1e-3),
    ("four nodes", Overlap::Nodes(4), 1e-3),
];

/// Relaxation of an overlap of one node, and time between two exchanges [s].
const ONE_NODE: [(f64, f64); 3] = [(0.02, 0.01), (0.3, 0.01), (0.3, 0.5)];

/// A bar whose zones exchange now and then, after 6 s or 40 exchanges.
struct Settled {
    /// When its error came below 1e-3 of the edge for good [s].
    reached_s: f64,
    error: f64,
}

fn settled(case: &Case, model: &mut HybridExchange, dt_s: f64) -> Settled {
    let (mut reached_s, mut time_s) = (f64::INFINITY, 0.0);
    let mut error = f64::INFINITY;
    while time_s < f64::max(6.0, 40.0 * dt_s) && !(error > 1e6 && error.is_finite()) {
        model.step(dt_s);
        time_s += dt_s;
        error = case.error(model.displacements_m());
        reached_s = if error > 1e-3 || error.is_nan() { f64::INFINITY } else { f64::min(reached_s, time_s) };
    }
    Settled { reached_s, error }
}

/// Errors for every row of [`OVERLAPS`] and of [`ONE_NODE`], and the lines of the table.
fn frontiers() -> anyhow::Result<([f64; 6], [f64; 3], String)> {
    let case = Case::bar(Load::Displacement)?;
    let mut lines = String::new();
    let mut run = |zones: &Zones, laws: &[ZoneLaw], (name, overlap, dt_s): (&str, Overlap, f64)| {
        let mut model =
            case.model(zones, laws, |p| (p.overlap, p.damping_per_s) = (overlap, DAMPING_PER_S))?;
        let Settled { reached_s, error } = settled(&case, &mut model, dt_s);
        lines += &format!("| {name} | {} | {reached_s:.2} | {error:.1e} |\n", 1e3 * dt_s);
        anyhow::Ok(error)
    };
    let zones = case.zones(&[5, 5, 5])?;
    let laws = [ZoneLaw::Precomputed, ZoneLaw::TensorMass, ZoneLaw::Precomputed];
    let mut errors = [f64::NAN; 6];
    for (error, row) in errors.iter_mut().zip(OVERLAPS) {
        *error = run(&zones, &laws, row)?;
    }
    let held = case.zones(&[7, 8])?;
    let held_laws = [ZoneLaw::TensorMass, ZoneLaw::Precomputed];
    let mut of_one = [f64::NAN; 3];
    for (error, (relaxation, dt_s)) in of_one.iter_mut().zip(ONE_NODE) {
        let name = format!("one node, relaxation {relaxation} (two zones, the held one pre-computed)");
        *error = run(&held, &held_laws, (&name, Overlap::OneNode { relaxation }, dt_s))?;
    }
    Ok((errors, of_one, lines))
}

pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<String> {
    let (errors, of_one, lines) = frontiers()?;
    outcome.experiments.extend([
        Experiment::at_most(
            "bar, tensor-mass between pre-computed zones, overlap of two nodes: mean error at rest over edge",
            OWN,
            errors[0].max(errors[1]),
            1e-6,
        ),
        Experiment::at_most(
            "bar, overlap of three and four nodes, 0.3 s between exchanges: mean error over edge after 40",
            OWN,
            errors[2].max(errors[3]),
            1e-2,
        ),
        Experiment::at_most(
            "bar, overlap of one node (forces one way, displacements the other), relaxation 0.02, 10 ms between \
             exchanges: mean error at rest over edge",
            OWN,
            of_one[0],
            1e-6,
        ),
    ]);
    let of_cut = cut(outcome)?;
    Ok(format!(
        "Three zones, the middle one tensor-mass, displacement: time that passes until the mean error stays below 1e-3 of the \
         edge, by overlap and by time between two exchanges.\n\n| overlap | between exchanges [ms] | time [s] | error \
         after 6 s or 40 exchanges |\n|---|---|---|---|\n{lines}\
         \nAn overlap of two nodes is stable however often zones exchange: eliminating the pre-computed nodes can \
         only soften what tensor-mass feels. Wider ones hold nodes twice, the motion of one copy does not come \
         back to it, and that makes energy unless tensor-mass comes to rest between two exchanges. One node \
         converges with a relaxation below 2 / (1 + rho), rho the largest ratio of tensor-mass' stiffness at the \
         frontier to the neighbour's: 4 where a free end is tensor-mass and comes to rest between two exchanges, \
         above 100 when its interior has no time to follow, and much also where tensor-mass is held itself, as \
         here. Two nodes is what scenes should take.\n\n{of_cut}"
    ))
}

/// A liver of two pre-computed zones, at rest under a load on one of them.
struct Liver {
    case: Case,
    zones: Zones,
    model: HybridExchange,
    /// The zone that is not loaded, and its tetrahedra along the frontier.
    cut_zone: usize,
    at_frontier: Vec<TetId>,
}

impl Liver {
    fn new() -> anyhow::Result<Self> {
        let mesh = liver(4_000)?;
        let (fixed, node, edge_m) = liver_ends(&mesh)?;
        let case = Case::new(mesh, fixed, node, Load::Force, edge_m)?;
        let zones = Zones::by_graph(&case.mesh, 2)?;
        let mut model = case.precomputed(&zones, |p| p.sweeps_per_step = 20)?;
        model.step(STEP_S);
        let cut_zone = 1 - zones.zones_of_node(node)[0] as usize;
        let is_shared = |n: &&NodeId| zones.zones_of_node(**n).len() > 1;
        let is_at_frontier =
            |tet: &TetId| case.mesh.tetrahedra[tet.index()].iter().filter(is_shared).count() == 3;
        let at_frontier = zones.tets(cut_zone).filter(is_at_frontier).collect();
        Ok(Self { case, zones, model, cut_zone, at_frontier })
    }

    /// Zones made of the mesh without `removed`, the cut one tensor-mass.
    fn made_anew(&self, removed: &[TetId]) -> anyhow::Result<HybridExchange> {
        let Self { case, zones, .. } = self;
        let remains = |tet: &TetId| !removed.contains(tet);
        let tets = || (0..case.mesh.tetrahedra.len()).map(TetId::from_index).filter(remains);
        let mut remaining = case.mesh.clone();
        remaining.tetrahedra = tets().map(|tet| case.mesh.tetrahedra[tet.index()]).collect();
        let of_tet: Vec<u32> = tets().map(|tet| zones.zone_of(tet) as u32).collect();
        let anew_zones = Zones::new(&remaining, of_tet)?;
        let mut laws = [ZoneLaw::Precomputed; 2];
        laws[self.cut_zone] = ZoneLaw::TensorMass;
        let params = ExchangeParams {
            sweeps_per_step: 20,
            ..ExchangeParams::new(&remaining, &case.material, &case.fixed, &anew_zones, &laws)
        };
        let mut anew = HybridExchange::build(&params)?;
        anew.apply(&case.load);
        Ok(anew)
    }

    /// Largest difference from zones made anew after the same sweeps, over the largest displacement.
    fn off_from_anew(&mut self, removed: &[TetId]) -> anyhow::Result<f64> {
        let mut anew = self.made_anew(removed)?;
        let model = &mut self.model;
        anew.take_over(model.state().positions_m);
        let at_m = model.state().positions_m.to_vec();
        model.take_over(&at_m);
        for _ in 0..5 {
            model.step(STEP_S);
            anew.step(STEP_S);
        }
        let pairs = model.displacements_m().iter().zip(anew.displacements_m());
        let off_m = pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        let largest_m = anew.displacements_m().iter().map(|u| u.length()).fold(0.0, f64::max);
        Ok(off_m / largest_m)
    }
}

/// Removes tetrahedra: the processor time [ms], and whether the neighbour was corrected.
fn timed_removal(model: &mut HybridExchange, tets: &[TetId]) -> anyhow::Result<(f64, bool)> {
    let mut removed = None;
    let seconds =
        timed_s(|| removed = Some(model.remove_tets(tets).map(|report| !report.corrected.is_empty())));
    Ok((1e3 * seconds, removed.transpose()?.unwrap_or_default()))
}

/// A pre-computed zone is cut next to its frontier: the neighbour's correction against computing it anew.
fn cut(outcome: &mut Outcome) -> anyhow::Result<String> {
    let mut liver = Liver::new()?;
    let tets = liver.at_frontier.clone();
    let mut copy = liver.model.clone();
    let (first_ms, first_is_corrected) = timed_removal(&mut liver.model, &tets[..1])?;
    let (second_ms, second_is_corrected) = timed_removal(&mut liver.model, &tets[1..2])?;
    let many = tets.len();
    let (many_ms, many_is_corrected) = timed_removal(&mut copy, &tets)?;
    outcome.experiments.extend([
        // The correction is exact: the same sweeps over zones made of the remaining mesh.
        Experiment::at_most(
            "liver, zone cut at its frontier: corrected neighbour against zones made anew, 100 sweeps, relative",
            OWN,
            liver.off_from_anew(&tets[..2])?,
            1e-9,
        ),
        Experiment::at_most(
            "liver: single removals that were not followed by a correction",
            OWN,
            2.0 - f64::from(u8::from(first_is_corrected)) - f64::from(u8::from(second_is_corrected)),
            0.0,
        ),
    ]);
    let sizes: Vec<ZoneSize> = liver.model.zone_sizes().map(|(_, size)| size).collect();
    Ok(format!(
        "A zone of the liver ({} nodes) is cut at its frontier: it turns into tensor-mass at its present shape and \
         velocity, and its pre-computed neighbour (N, F, S = {}, {}, {}) is corrected. First tetrahedron, with the \
         turn: {first_ms:.0} ms of processor time; a further one {second_ms:.0} ms, most of it for K and the lists \
         of neighbours; all {many} tetrahedra along the frontier at once {many_ms:.0} ms ({}).",
        liver.case.mesh.positions_m.len(),
        sizes[0].n_nodes,
        sizes[0].n_frontier,
        sizes[0].n_surface,
        if many_is_corrected { "by correction" } else { "the neighbour's tensors computed anew" },
    ))
}
