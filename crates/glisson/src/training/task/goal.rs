//! Whether a stage's goal is reached.

use super::cut_line::{CutLine, CutQuality};
use super::excision::{Excised, Excision};
use super::landmark::Landmark;
use crate::math::DVec3;
use crate::mesh::topology::{Pieces, Through};
use crate::scene::GoalSource;
use crate::world::World;
use crate::world::vessels::Vessels;

/// Tissue that jaws hold is at a place when their tip is so near it, or nearer than the goal says [m]: the places that they hold are
/// around the tip.
const HELD_NEAR_M: f64 = 5e-3;

/// What a goal says of a moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Look {
    /// How far it is, 0 to 1.
    pub(super) share: f64,
    /// Whether it is reached now.
    pub(super) holds: bool,
    /// What was done wrong since the last look.
    pub(super) mistake: Option<String>,
}

impl Look {
    fn of(holds: bool) -> Self {
        Self { share: if holds { 1.0 } else { 0.0 }, holds, mistake: None }
    }

    /// Reached where `value` is at least `wanted`.
    fn towards(value: f64, wanted: f64) -> Self {
        Self { share: (value / wanted).clamp(0.0, 1.0), holds: value >= wanted, mistake: None }
    }
}

/// A goal and what it remembers.
#[derive(Clone, Debug)]
pub(super) struct Goal {
    source: GoalSource,
    places: Vec<Landmark>,
    line: Option<CutLine>,
    quality: CutQuality,
    excision: Option<Excision>,
    excised: Option<Excised>,
    topology_version: Option<u32>,
    pieces: Pieces,
    are_apart: bool,
    /// Clips that were there at the beginning.
    n_clips_before: usize,
}

/// Why a goal cannot be reached in a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum CannotBe {
    /// There is no tissue at a place [m].
    NoTissue { point_m: DVec3 },
    /// A ball holds the middle of no tetrahedron.
    SmallBall,
    /// Two bodies are not attached to each other.
    NotAttached { bodies: [usize; 2] },
}

/// A trigger that was pressed since the last look, and where its tip touched then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Press {
    pub(super) tool: usize,
    pub(super) touched_at_rest_m: Option<DVec3>,
}

/// Clips that are set, anywhere or near a place at rest.
fn n_clips_set(world: &World, near_m: Option<(DVec3, f64)>) -> usize {
    let is_near =
        |clip_m: &DVec3| near_m.is_none_or(|(near_m, within_m)| clip_m.distance(near_m) <= within_m);
    world.vessels().map_or(0, |vessels| vessels.clips_at_rest_m().filter(is_near).count())
}

impl Goal {
    /// A goal in a world at rest.
    pub(super) fn new(source: GoalSource, world: &World) -> Result<Self, CannotBe> {
        let points_m = match &source {
            GoalSource::Touch { near_m, .. } | GoalSource::Grasp { near_m, .. } => {
                near_m.iter().map(|(near_m, _)| *near_m).collect()
            }
            GoalSource::Mark { near_m: point_m, .. }
            | GoalSource::Lift { point_m, .. }
            | GoalSource::See { point_m, .. }
            | GoalSource::Excise { center_m: point_m, .. } => vec![*point_m],
            GoalSource::Part { from_m, to_m } => vec![*from_m, *to_m],
            GoalSource::Cut { line, .. } => line.points_m.clone(),
            GoalSource::Reach { .. }
            | GoalSource::Detach { .. }
            | GoalSource::Clip { .. }
            | GoalSource::Ligate { .. }
            | GoalSource::Bleed { .. } => Vec::new(),
        };
        if let GoalSource::Detach { bodies } = source
            && (world.n_strands_between(bodies)[0] == 0 || !world.can_be_detached(bodies))
        {
            return Err(CannotBe::NotAttached { bodies });
        }
        let places = points_m
            .into_iter()
            .map(|point_m| Landmark::find(point_m, world).ok_or(CannotBe::NoTissue { point_m }));
        let places: Vec<Landmark> = places.collect::<Result<_, _>>()?;
        let line = match &source {
            GoalSource::Cut { line, within_m, .. } => Some(CutLine::new(line, *within_m, world)),
            _ => None,
        };
        let excision = match source {
            GoalSource::Excise { center_m, radius_m } => {
                Some(Excision::new(center_m, radius_m, world).ok_or(CannotBe::SmallBall)?)
            }
            _ => None,
        };
        let near_clips_m = if let GoalSource::Clip { near_m, .. } = source { near_m } else { None };
        Ok(Self {
            source,
            places,
            line,
            quality: CutQuality::default(),
            excision,
            excised: None,
            topology_version: None,
            pieces: Pieces::default(),
            are_apart: false,
            n_clips_before: n_clips_set(world, near_clips_m),
        })
    }

    /// How well the line was cut, if the goal is one.
    pub(super) fn cut_quality(&self) -> Option<CutQuality> {
        self.line.as_ref().map(|_| self.quality)
    }

    /// What was cut out, if the goal is that.
    pub(super) fn excised(&self) -> Option<Excised> {
        self.excised
    }

    /// Looks at the cut along its line, or at what is cut out, if it is about that and the mesh changed; also when its stage is over,
    /// because somebody may cut on.
    pub(super) fn measure(&mut self, world: &World) {
        if (self.line.is_none() && self.excision.is_none()) || !self.is_edited(world) {
            return;
        }
        if let Some(line) = &self.line {
            self.quality = line.quality(&world.display_topology());
        }
        if let Some(excision) = &mut self.excision {
            self.excised = excision.look(world);
        }
    }

    /// How far it is after a step.
    pub(super) fn look(&mut self, world: &World, presses: &[Press]) -> Look {
        match self.source {
            GoalSource::Reach { tool, point_m, within_m } => {
                let away_m = world.tool_pose(tool).tip_in_world_m.distance(point_m);
                Look { share: (within_m / away_m).min(1.0), holds: away_m <= within_m, mistake: None }
            }
            GoalSource::Touch { tool, near_m } => Look::of(self.touches(world, tool, near_m)),
            GoalSource::Mark { tool, near_m, within_m } => {
                marks(presses.iter().filter(|press| press.tool == tool), (near_m, within_m))
            }
            GoalSource::Grasp { tool, near_m } => {
                let is_near = near_m.is_none_or(|(_, within_m)| {
                    let tip_m = world.tool_pose(tool).tip_in_world_m;
                    let place_m = self.places[0].position_m(world);
                    place_m.is_some_and(|place_m| place_m.distance(tip_m) <= within_m.max(HELD_NEAR_M))
                });
                Look::of(world.report().tools[tool].n_held_nodes > 0 && is_near)
            }
            GoalSource::Lift { tool, by_m, direction, .. } => {
                let Some(moved_m) = self.places[0].moved_m(world) else { return Look::default() };
                let way_m = direction.map_or(moved_m.length(), |direction| moved_m.dot(direction));
                let look = Look::towards(way_m, by_m);
                Look { holds: look.holds && world.report().tools[tool].n_held_nodes > 0, ..look }
            }
            GoalSource::Cut { share, .. } => {
                self.measure(world);
                Look::towards(self.quality.share, share)
            }
            GoalSource::Part { .. } => {
                if self.is_edited(world) {
                    world.organ().body().topology().pieces_into(Through::Faces, &mut self.pieces);
                    let piece =
                        |place: &mut Landmark| place.tet(world).map(|tet| self.pieces.of_tet[tet.index()]);
                    let [from, to] = &mut self.places[..] else { return Look::default() };
                    let both = piece(from).zip(piece(to));
                    // Where tissue of one is gone there is nothing that hangs together with the other.
                    self.are_apart = both.is_none_or(|(from, to)| from != to);
                }
                Look::of(self.are_apart)
            }
            GoalSource::Excise { .. } => {
                self.measure(world);
                Look::of(self.excised.is_some())
            }
            GoalSource::See { tool, within_rad, nearer_than_m, .. } => {
                let Some((eye, place_m)) = world.eye(tool).zip(self.places[0].position_m(world)) else {
                    return Look::default();
                };
                let is_near =
                    nearer_than_m.is_none_or(|most_m| eye.position_in_world_m.distance(place_m) <= most_m);
                let off_rad = eye.off_middle_rad(place_m);
                let holds = eye.sees(place_m) && off_rad <= within_rad && is_near;
                Look { share: (within_rad / off_rad.max(1e-9)).min(1.0), holds, mistake: None }
            }
            GoalSource::Detach { bodies } => {
                let [n_now, n_before] = world.n_strands_between(bodies);
                Look::towards((n_before - n_now) as f64, n_before as f64)
            }
            GoalSource::Clip { n_clips, near_m } => {
                let set = n_clips_set(world, near_m).saturating_sub(self.n_clips_before);
                Look::towards(set as f64, f64::from(n_clips))
            }
            GoalSource::Ligate { n_loops, near_m } => {
                let is_near = |middle_m: &DVec3| {
                    near_m.is_none_or(|(near_m, within_m)| middle_m.distance(near_m) <= within_m)
                };
                let tied = world.tied_loops_at_rest_m().filter(is_near).count();
                Look::towards(tied as f64, f64::from(n_loops))
            }
            GoalSource::Bleed { below_m3_per_s } => {
                let rate_m3_per_s = world.vessels().map_or(0.0, Vessels::bleeding_m3_per_s);
                Look::of(rate_m3_per_s <= below_m3_per_s)
            }
        }
    }

    /// Whether the mesh changed since the last look.
    fn is_edited(&mut self, world: &World) -> bool {
        let version = world.organ().topology_version();
        self.topology_version.replace(version) != Some(version)
    }

    /// Whether a tip touches the tissue, near a place of it at rest.
    fn touches(&self, world: &World, tool: usize, near_m: Option<(DVec3, f64)>) -> bool {
        let touched_m = world.touched_at_rest_m(tool);
        touched_m.is_some_and(|touched_m| {
            near_m.is_none_or(|(near_m, within_m)| touched_m.distance(near_m) <= within_m)
        })
    }
}

/// What came of the presses of a trigger, where a place is to be marked.
fn marks<'a>(presses: impl Iterator<Item = &'a Press>, (near_m, within_m): (DVec3, f64)) -> Look {
    let mut look = Look::default();
    for press in presses {
        match press.touched_at_rest_m.map(|touched_m| touched_m.distance(near_m)) {
            None => look.mistake = Some("marked without touching the tissue".into()),
            Some(off_m) if off_m <= within_m => return Look::of(true),
            Some(off_m) => look.mistake = Some(format!("marked {:.0} mm from the place", 1e3 * off_m)),
        }
    }
    look
}
