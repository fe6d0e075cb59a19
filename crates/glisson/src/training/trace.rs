//! What is known of a session for its assessment: instruments, forces, cuts and blood at regular times.

use super::surface_strain::{StrainReading, SurfaceStrain};
use crate::math::DVec3;
use crate::record::snapshot::{ContactKind, ContactPoints};
use crate::tool::ToolInput;
use crate::tool::endoscope::Eye;
use crate::world::World;
use crate::world::vessels::Vessels;

/// Samples are so far apart [s], or a step where that is longer.
pub const SAMPLE_PERIOD_S: f64 = 0.01;

/// A session at regular times, from its beginning on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    /// From one sample to the next [s]: a whole number of steps.
    pub period_s: f64,
    /// Of each instrument, in the scene's order.
    pub tools: Vec<ToolTrace>,
    /// Blood lost until each sample [m3]; zeros without vessels.
    pub blood_lost_m3: Vec<f64>,
    /// Blood that comes out at each sample [m3/s].
    pub bleeding_m3_per_s: Vec<f64>,
    /// Tissue taken out until each sample [m3].
    pub removed_m3: Vec<f64>,
    /// Area that blades opened until each sample [m2].
    pub cut_area_m2: Vec<f64>,
    /// Greatest strain of the organs' surface at each sample ...
    pub surface_strain: Vec<f64>,
    /// ... and its area that is strained so far that a liver's capsule tears [m2] ([`super::surface_strain`]).
    pub overstrained_m2: Vec<f64>,
    /// Pairs of instruments that press on each other.
    pub n_clashing: Vec<u32>,
    /// Whether the mesh changed since the sample before: a cut, a burn, or an edit that was undone.
    pub is_edited: Vec<bool>,
}

/// An instrument at each sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ToolTrace {
    /// What the user calls it.
    pub name: String,
    /// Its kind, as scenes name it.
    pub kind: &'static str,
    /// Whether it is there to see, and not to work.
    pub is_endoscope: bool,
    /// Where it is.
    pub poses: Vec<ToolInput>,
    /// Size of the force on it, mean since the sample before [N] ...
    pub mean_force_n: Vec<f64>,
    /// ... and its greatest [N].
    pub peak_force_n: Vec<f64>,
    /// Whether it touched or held tissue in any step since the sample before.
    pub touches: Vec<bool>,
    /// Nodes that its jaws hold.
    pub n_held_nodes: Vec<u32>,
    /// Whether an endoscope sees its tip; nothing where there is no endoscope, and for an endoscope itself.
    pub is_seen: Vec<bool>,
    /// The place of the tissue at rest that its tip touches [m], if it does.
    pub touched_at_rest_m: Vec<Option<DVec3>>,
}

impl Trace {
    /// Samples so far.
    pub fn n_samples(&self) -> usize {
        self.removed_m3.len()
    }

    /// Simulated time that it covers [s].
    pub fn duration_s(&self) -> f64 {
        self.n_samples().saturating_sub(1) as f64 * self.period_s
    }

    /// When a sample was taken [s].
    pub fn time_s(&self, sample: usize) -> f64 {
        sample as f64 * self.period_s
    }
}

impl ToolTrace {
    /// Where the tip was [m].
    pub fn tips_m(&self) -> Vec<DVec3> {
        self.poses.iter().map(|pose| pose.tip_in_world_m).collect()
    }

    /// Where the shaft pointed.
    pub fn shafts(&self) -> Vec<DVec3> {
        self.poses.iter().map(|pose| pose.shaft_in_world).collect()
    }
}

/// What the steps since the last sample brought.
#[derive(Clone, Copy, Debug, Default)]
struct Since {
    force_sum_n: f64,
    peak_n: f64,
    touches: bool,
}

/// Takes a trace of a world, step by step. Nothing that it does changes the world.
#[derive(Clone, Debug)]
pub struct TraceRecorder {
    trace: Trace,
    steps_per_sample: u64,
    first_step: u64,
    since: Vec<Since>,
    contacts: ContactPoints,
    strain: SurfaceStrain,
    last_strain: StrainReading,
    topology_version: u32,
    /// What there was before the beginning.
    before: Totals,
}

/// What a world counts from its start on.
#[derive(Clone, Copy, Debug, Default)]
struct Totals {
    lost_m3: f64,
    removed_m3: f64,
    cut_area_m2: f64,
}

impl Totals {
    fn of(world: &World) -> Self {
        let lost_m3 = world.vessels().map_or(0.0, Vessels::lost_m3);
        let (removed_m3, cut_area_m2) = (world.removed_volume_m3(), world.blades().cut_area_m2);
        Self { lost_m3, removed_m3, cut_area_m2 }
    }
}

impl TraceRecorder {
    /// Begins with the world as it is.
    pub fn new(world: &World) -> Self {
        let step_s = world.spec().time_step_s;
        let steps_per_sample = (SAMPLE_PERIOD_S / step_s).round().max(1.0) as u64;
        let tools = world.tools().iter().map(|tool| ToolTrace {
            name: tool.name.clone(),
            kind: tool.kind.name(),
            is_endoscope: tool.kind.optics().is_some(),
            ..ToolTrace::default()
        });
        let trace =
            Trace { period_s: steps_per_sample as f64 * step_s, tools: tools.collect(), ..Trace::default() };
        let mut recorder = Self {
            since: vec![Since::default(); trace.tools.len()],
            trace,
            steps_per_sample,
            first_step: world.steps_made(),
            contacts: ContactPoints::default(),
            strain: SurfaceStrain::of(world),
            last_strain: StrainReading::default(),
            topology_version: world.organ().topology_version(),
            before: Totals::of(world),
        };
        recorder.take(world);
        recorder
    }

    /// What there is so far.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// After each step; answers whether a sample was taken.
    pub fn after_step(&mut self, world: &World) -> bool {
        for (since, report) in self.since.iter_mut().zip(&world.report().tools) {
            let force_n = report.force_on_tool_n.length();
            since.force_sum_n += force_n;
            since.peak_n = since.peak_n.max(force_n);
            since.touches |= report.in_contact;
        }
        let made = world.steps_made() - self.first_step;
        if !made.is_multiple_of(self.steps_per_sample) {
            return false;
        }
        self.take(world);
        true
    }

    fn take(&mut self, world: &World) {
        let version = world.organ().topology_version();
        let is_edited = std::mem::replace(&mut self.topology_version, version) != version;
        let before = self.before;
        let trace = &mut self.trace;
        let eyes: Vec<Eye> = (0..trace.tools.len()).filter_map(|tool| world.eye(tool)).collect();
        for (place, (tool, since)) in trace.tools.iter_mut().zip(&mut self.since).enumerate() {
            let report = &world.report().tools[place];
            tool.poses.push(world.tool_pose(place));
            tool.mean_force_n.push(since.force_sum_n / self.steps_per_sample as f64);
            tool.peak_force_n.push(since.peak_n);
            tool.touches.push(since.touches);
            if !eyes.is_empty() && !tool.is_endoscope {
                let tip_m = world.tool_pose(place).tip_in_world_m;
                tool.is_seen.push(eyes.iter().any(|eye| eye.sees(tip_m)));
            }
            tool.n_held_nodes.push(report.n_held_nodes);
            tool.touched_at_rest_m.push(world.touched_at_rest_m(place));
            *since = Since::default();
        }
        let (lost_m3, rate_m3_per_s) =
            world.vessels().map_or((0.0, 0.0), |vessels| (vessels.lost_m3(), vessels.bleeding_m3_per_s()));
        // To count the volume takes long; it changes with the mesh alone.
        let removed_m3 = match trace.removed_m3.last() {
            Some(last_m3) if !is_edited => *last_m3,
            _ => (world.removed_volume_m3() - before.removed_m3).max(0.0),
        };
        trace.is_edited.push(is_edited);
        // Nodes that an edit brought find their places in the next step.
        let strain = if is_edited {
            self.strain = SurfaceStrain::of(world);
            self.last_strain
        } else {
            self.strain.read(|node| world.surface_position_m(node).unwrap_or(DVec3::NAN))
        };
        self.last_strain = strain;
        trace.surface_strain.push(strain.greatest);
        trace.overstrained_m2.push(strain.beyond_m2);
        trace.blood_lost_m3.push(lost_m3 - before.lost_m3);
        trace.bleeding_m3_per_s.push(rate_m3_per_s);
        trace.removed_m3.push(removed_m3);
        trace.cut_area_m2.push(world.blades().cut_area_m2 - before.cut_area_m2);
        let n_clashing = if trace.tools.len() < 2 {
            0
        } else {
            world.contact_points_into(&mut self.contacts);
            let mut pairs: Vec<(u8, u8)> = self
                .contacts
                .points
                .iter()
                .filter(|point| point.kind == ContactKind::Tools)
                .map(|point| (point.touched, point.by))
                .collect();
            pairs.sort_unstable();
            pairs.dedup();
            pairs.len() as u32
        };
        trace.n_clashing.push(n_clashing);
    }
}
