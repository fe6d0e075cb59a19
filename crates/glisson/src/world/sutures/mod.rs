//! Threads that pass through tissue, lie on it and are held by instruments.
//!
//! A thread is a rod ([`crate::suture`]). What it passes through and lies on gives way as in [`super::press`]: under forces F of the
//! thread the touched nodes go to x(t) + d + C (F - f), with the forces f of the last step and the way d that their motion takes them;
//! so tissue and thread meet in the middle within a step ([`super::tissue_patch`]), and the forces go to the model. In a single explicit step, which C knows
//! exactly, their last acceleration goes on as well; foreseen for a longer step, where it is that of few of the nodes that take part,
//! it shook the tissue. C joins places: what one pulls on, another feels. Each place is taken to be as soft as all of them make it
//! together, which never overshoots, and the step is repeated some times from where that led ([`ROUNDS`]). In each round the thread
//! slides through its holes as far as friction does not hold it, by Coulomb's law on the force across it there.
//!
//! Instruments hold it by their hand's spring: they come after it by what it pulls.

mod grip;
mod needle;
mod passage;
mod settling;
mod walls;

pub(super) use walls::surface_at;

use super::World;
use super::organ::Organ;
use super::suture_spec::{SutureError, SutureSpec};
use super::tissue_patch::PatchMemory;
use super::tool_state::ToolState;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::mesh::edit::EditableMesh;
use crate::model::NodalForce;
use crate::model::bounded_vec::BoundedVec;
use crate::record::snapshot::ThreadSnapshot;
use crate::suture::{Rod, Solver, nearest_to_itself_m};
use crate::tool::{MAX_TOOLS, Tool};
use grip::{Grip, MOST_CLIPS, ThreadClip, strands};
use passage::{MOST_PASSAGES, Passage, is_inside, laid};
use settling::Scratch;

/// How often a step is repeated from where it led: a choice.
const ROUNDS: usize = 5;
/// Segments of a thread at most: a choice.
const MOST_SEGMENTS: usize = 400;

/// A thread in the world.
#[derive(Clone, Debug)]
pub struct Suture {
    rod: Rod,
    solver: Solver,
    /// Ascending along the thread.
    passages: BoundedVec<Passage>,
    /// Whether its first end is in tissue.
    tip_is_inside: bool,
    clips: BoundedVec<ThreadClip>,
    grips: [Option<Grip>; MAX_TOOLS],
    /// Force of each node on the tissue that it lies on in the last step [N].
    lies_n: Vec<DVec3>,
    /// What is known of the tissue that was touched in the last step.
    memory: PatchMemory,
    /// Forces on nodes of the tissue in the last step, ascending.
    forces: BoundedVec<NodalForce>,
    /// Forces on the instruments that hold it in the last step [N].
    on_tools_n: [DVec3; MAX_TOOLS],
    scratch: Box<Scratch>,
}

impl Suture {
    /// A thread at rest along its path.
    ///
    /// # Errors
    /// [`SutureError`].
    pub(super) fn new(spec: &SutureSpec, organ: &Organ) -> Result<Self, SutureError> {
        let length_m: f64 = spec.path_m.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        let n_segments = (length_m / spec.spacing_m).round().max(2.0) as usize;
        if n_segments > MOST_SEGMENTS {
            return Err(SutureError::Segments { n_segments, most: MOST_SEGMENTS });
        }
        let spacing_m = length_m / n_segments as f64;
        let needle_m = spec.needle.map_or(0.0, |needle| needle.length_m);
        let material = |segment: usize| match &spec.needle {
            Some(needle) if (segment as f64 + 0.5) * spacing_m < needle_m => needle.material,
            _ => spec.thread,
        };
        let positions_m = divided(&spec.path_m, n_segments);
        let rod = Rod::new(positions_m, spacing_m, spec.radius_m, material);
        if let Some((least_m, at_m)) = nearest_to_itself_m(&rod).filter(|(m, _)| *m <= 2.0 * spec.radius_m) {
            let needed_mm = 2e3 * spec.radius_m;
            return Err(SutureError::MeetsItself {
                least_mm: 1e3 * least_m,
                at_mm: at_m.map(|m| 1e3 * m),
                needed_mm,
            });
        }
        let (passages, tip_is_inside) = laid(&rod, organ)?;
        let n_nodes = rod.n_nodes();
        let mut suture = Self {
            solver: Solver::new(n_nodes),
            passages: BoundedVec::with_capacity(MOST_PASSAGES),
            tip_is_inside,
            clips: BoundedVec::with_capacity(MOST_CLIPS),
            grips: [None; MAX_TOOLS],
            lies_n: vec![DVec3::ZERO; n_nodes],
            memory: PatchMemory::new(),
            forces: BoundedVec::with_capacity(4 * MOST_PASSAGES + 3 * n_nodes),
            on_tools_n: [DVec3::ZERO; MAX_TOOLS],
            scratch: Box::new(Scratch::for_nodes(n_nodes)),
            rod,
        };
        suture.passages.extend(passages);
        for &along_m in &spec.clips_m {
            let length_m = suture.rod.length_m();
            if let Some(beyond_m) = along_m.into_iter().find(|m| !(0.0..=length_m).contains(m)) {
                return Err(SutureError::Clip { at_mm: 1e3 * beyond_m, length_mm: 1e3 * length_m });
            }
            if !suture.add_clip(along_m) {
                return Err(SutureError::Clips { n: spec.clips_m.len(), most: MOST_CLIPS });
            }
        }
        Ok(suture)
    }

    /// The thread.
    pub fn rod(&self) -> &Rod {
        &self.rod
    }

    /// Where it passes through the surface of tissue: its way from the first end, ascending [m].
    pub fn holes_m(&self) -> impl Iterator<Item = f64> + '_ {
        self.passages.iter().filter(|passage| passage.is_hole).map(|passage| passage.along_m)
    }

    /// Where its clips are along it [m]: one of a strand, where both places are the same, or of two.
    pub fn clips_m(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.clips.iter().map(|clip| clip.along_m)
    }

    /// Whether the thread is in tissue at so much of its way.
    pub fn is_in_tissue(&self, along_m: f64) -> bool {
        is_inside(&self.passages, self.tip_is_inside, along_m)
    }

    /// Forces on nodes of the tissue in the last step, ascending by node.
    pub fn forces(&self) -> &[NodalForce] {
        &self.forces
    }

    /// Force of the thread on an instrument that holds it in the last step [N]; zero for one that does not.
    pub fn force_on_tool_n(&self, tool: usize) -> DVec3 {
        self.on_tools_n.get(tool).copied().unwrap_or(DVec3::ZERO)
    }

    /// Whether an instrument holds it.
    pub fn is_held_by(&self, tool: usize) -> bool {
        self.grips.get(tool).is_some_and(Option::is_some)
    }

    /// Writes what a viewer draws; allocates the first time only.
    pub(super) fn snapshot_into(&self, spec: &SutureSpec, out: &mut ThreadSnapshot) {
        out.radius_m = self.rod.radius_m();
        out.nodes_m.clear();
        out.nodes_m.extend_from_slice(&self.rod.positions_m);
        let needle_m = spec.needle.map(|needle| needle.length_m);
        out.n_needle_nodes =
            needle_m.map_or(0, |needle_m| (needle_m / self.rod.spacing_m()).round() as u32 + 1);
        out.clips_m.clear();
        out.clips_m.reserve(MOST_CLIPS);
        out.clips_m.extend(self.clips.iter().map(|clip| {
            let ends = clip.along_m.map(|m| self.rod.place_at(m).point_m(&self.rod.positions_m));
            ends[0].midpoint(ends[1])
        }));
    }

    /// Sets a clip, its places in the thread's order; answers whether there was room for it.
    fn add_clip(&mut self, [a, b]: [f64; 2]) -> bool {
        self.clips.try_push(ThreadClip { along_m: [a.min(b), a.max(b)] })
    }

    /// Everything that its next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let rod = self.rod.positions_m.iter().chain(&self.rod.velocities_m_per_s).chain(&self.lies_n);
        let passages = self.passages.iter().flat_map(Passage::numbers);
        let clips = self.clips.iter().flat_map(|clip| clip.along_m);
        let grips = self.grips.iter().enumerate();
        let grips = grips.filter_map(|(tool, grip)| Some((tool, (*grip)?)));
        let grips = grips.flat_map(|(tool, grip)| std::iter::once(tool as f64).chain(grip.numbers()));
        let forces = self.forces.iter().map(|force| (force.node, force.force_n));
        let forces = forces.flat_map(|(node, f)| [f64::from(node.0), f.x, f.y, f.z]);
        let counts = [self.passages.len(), self.clips.len()].map(|n| n as f64);
        let inside = f64::from(u8::from(self.tip_is_inside));
        let rod = rod.flat_map(|v| v.to_array());
        rod.chain(passages)
            .chain(clips)
            .chain(grips)
            .chain(self.memory.numbers())
            .chain(forces)
            .chain(counts)
            .chain([inside])
    }

    /// Takes hold where jaws have just closed, and lets go where they are open.
    fn follow_jaws(&mut self, spec: &SutureSpec, tools: &[Tool], states: &[ToolState]) {
        for (place, (tool, state)) in tools.iter().zip(states).enumerate() {
            let Some(jaws) = tool.kind.jaws() else { continue };
            if self.grips[place].is_some() && grip::lets_go(state) {
                self.grips[place] = None;
            }
            if !state.just_closed {
                continue;
            }
            let between = (tool, jaws, state.opened_to);
            if tool.kind.sets_clips() {
                self.clip_between(between, state);
            } else if tool.kind.holds() && self.grips[place].is_none() {
                let needle_m = spec.needle.map(|needle| needle.length_m);
                self.grips[place] = Grip::close(&self.rod, needle_m, between, state);
            }
        }
    }

    /// A clip on the strand between the jaws, or on the first two.
    fn clip_between(&mut self, between: (&Tool, &crate::tool::Jaws, f64), state: &ToolState) {
        let mut found = strands(&self.rod, between, state);
        let Some(first) = found.next() else { return };
        let second = found.next().map_or(first.along_m, |strand| strand.along_m);
        drop(found);
        self.add_clip([first.along_m, second]);
    }

    /// After an edit of the tissue.
    pub(super) fn follow_edit(&mut self, body: &EditableMesh) {
        passage::follow(&mut self.passages, &mut self.tip_is_inside, body);
        let topology = body.topology();
        let is_there = |node: NodeId| node.index() < topology.n_nodes() && topology.is_live_node(node);
        self.memory.retain(is_there);
        self.forces.retain(|force| is_there(force.node));
    }

    /// An instrument was put elsewhere.
    pub(super) fn let_go(&mut self, tool: usize) {
        self.grips[tool] = None;
    }
}

/// Places at equal ways along a path.
fn divided(path_m: &[DVec3], n_segments: usize) -> Vec<DVec3> {
    let length_m: f64 = path_m.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let mut pieces = path_m.windows(2);
    let mut piece = pieces.next().unwrap_or(path_m);
    let mut before_m = 0.0;
    let at = |i: usize| length_m * i as f64 / n_segments as f64;
    (0..=n_segments)
        .map(|i| {
            loop {
                let piece_m = piece[0].distance(piece[1]);
                if at(i) <= before_m + piece_m {
                    return piece[0].lerp(piece[1], (at(i) - before_m) / piece_m.max(f64::MIN_POSITIVE));
                }
                let Some(next) = pieces.next() else { return piece[1] };
                before_m += piece_m;
                piece = next;
            }
        })
        .collect()
}

impl World {
    /// The threads.
    pub fn sutures(&self) -> &[Suture] {
        &self.sutures
    }

    /// All threads as at the start, in the tissue that is there now; one that cannot be laid any more is as it was.
    pub(super) fn lay_threads_anew(&mut self) {
        for (suture, spec) in self.sutures.iter_mut().zip(&self.spec.sutures) {
            match Suture::new(spec, &self.organ) {
                Ok(new) => *suture = new,
                Err(_) => suture.follow_edit(self.organ.body()),
            }
        }
        self.hold_threads_at_start();
    }

    /// Instruments that begin closed around a thread hold it.
    pub(super) fn hold_threads_at_start(&mut self) {
        for (suture, spec) in self.sutures.iter_mut().zip(&self.spec.sutures) {
            for (place, (tool, state)) in self.spec.tools.iter().zip(&self.tool_states).enumerate() {
                let Some(jaws) = tool.kind.jaws().filter(|_| tool.kind.holds() && !grip::lets_go(state))
                else {
                    continue;
                };
                let needle_m = spec.needle.map(|needle| needle.length_m);
                // As wide as what lets go: what lies between them is held.
                let between = (tool, jaws, super::grasp::LETS_GO_ABOVE);
                suture.grips[place] = Grip::close(&suture.rod, needle_m, between, state);
            }
        }
    }

    /// Moves the threads, and finds their forces. Allocates nothing.
    pub(super) fn sew(&mut self) {
        let mut sutures = std::mem::take(&mut self.sutures);
        for (number, suture) in sutures.iter_mut().enumerate() {
            let spec = &self.spec.sutures[number];
            suture.follow_jaws(spec, &self.spec.tools, &self.tool_states);
            suture.pierce(spec, &self.organ);
            self.settle_thread(number, suture);
        }
        self.sutures = sutures;
    }

    /// Instruments that hold a thread are no further from where they were than their hand's greatest force allows.
    pub(super) fn hold_back_from_threads(&mut self) {
        let Some(hand) = self.spec.hand else { return };
        let most_m = hand.most_behind_m(self.spec.time_step_s);
        for place in 0..self.tool_states.len() {
            if self.holds_thread(place) {
                let (state, tool) = (&mut self.tool_states[place], &self.spec.tools[place]);
                let (before_m, now_m) = (state.before.tip_in_world_m, state.now.tip_in_world_m);
                if before_m.distance(now_m) > most_m {
                    state.put_tip(tool, before_m + (now_m - before_m).clamp_length_max(most_m));
                }
            }
        }
    }

    /// Force of all threads and of its loop on an instrument in the last step [N].
    pub(super) fn force_of_threads_n(&self, tool: usize) -> DVec3 {
        let of_sutures: DVec3 = self.sutures.iter().map(|suture| suture.on_tools_n[tool]).sum();
        of_sutures + self.loops.force_on_tool_n(tool)
    }

    /// Whether an instrument holds a thread, or its loop pulls on tissue.
    pub(super) fn holds_thread(&self, tool: usize) -> bool {
        self.sutures.iter().any(|suture| suture.is_held_by(tool)) || self.loops.pulls(tool)
    }
}
