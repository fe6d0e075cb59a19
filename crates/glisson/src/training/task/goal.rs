//! Whether a stage's goal is reached.

use super::cut_line::{CutLine, CutQuality};
use super::landmark::Landmark;
use crate::math::DVec3;
use crate::mesh::topology::{Pieces, Through};
use crate::scene::GoalSource;
use crate::world::World;

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
    topology_version: Option<u32>,
    pieces: Pieces,
    are_apart: bool,
    was_triggered: bool,
}

impl Goal {
    /// A goal in a world at rest; the place [m] where there is no tissue as an error.
    pub(super) fn new(source: GoalSource, world: &World) -> Result<Self, DVec3> {
        let points_m = match source {
            GoalSource::Touch { near_m, .. } | GoalSource::Grasp { near_m, .. } => {
                near_m.into_iter().map(|(near_m, _)| near_m).collect()
            }
            GoalSource::Mark { near_m, .. } => vec![near_m],
            GoalSource::Lift { point_m, .. } | GoalSource::See { point_m, .. } => vec![point_m],
            GoalSource::Part { from_m, to_m } | GoalSource::Cut { from_m, to_m, .. } => vec![from_m, to_m],
            GoalSource::Reach { .. } | GoalSource::Clip { .. } | GoalSource::Bleed { .. } => Vec::new(),
        };
        let places = points_m.into_iter().map(|point_m| Landmark::find(point_m, world).ok_or(point_m));
        let line = match source {
            GoalSource::Cut { from_m, to_m, within_m, .. } => {
                Some(CutLine::new(from_m, to_m, within_m, world))
            }
            _ => None,
        };
        Ok(Self {
            source,
            places: places.collect::<Result<_, _>>()?,
            line,
            quality: CutQuality::default(),
            topology_version: None,
            pieces: Pieces::default(),
            are_apart: false,
            was_triggered: false,
        })
    }

    /// How well the line was cut, if the goal is one.
    pub(super) fn cut_quality(&self) -> Option<CutQuality> {
        self.line.as_ref().map(|_| self.quality)
    }

    /// How far it is after a step.
    pub(super) fn look(&mut self, world: &World) -> Look {
        match self.source {
            GoalSource::Reach { tool, point_m, within_m } => {
                let away_m = world.tool_pose(tool).tip_in_world_m.distance(point_m);
                Look { share: (within_m / away_m).min(1.0), holds: away_m <= within_m, mistake: None }
            }
            GoalSource::Touch { tool, near_m } => Look::of(self.touches(world, tool, near_m)),
            GoalSource::Mark { tool, near_m, within_m } => self.marks(world, tool, (near_m, within_m)),
            GoalSource::Grasp { tool, near_m } => {
                let is_near = near_m.is_none_or(|(_, within_m)| {
                    let tip_m = world.tool_pose(tool).tip_in_world_m;
                    self.places[0].position_m(world).distance(tip_m) <= within_m.max(HELD_NEAR_M)
                });
                Look::of(world.report().tools[tool].n_held_nodes > 0 && is_near)
            }
            GoalSource::Lift { tool, by_m, direction, .. } => {
                let place = &mut self.places[0];
                let moved_m = place.position_m(world) - place.rest_m();
                let way_m = direction.map_or(moved_m.length(), |direction| moved_m.dot(direction));
                let look = Look::towards(way_m, by_m);
                Look { holds: look.holds && world.report().tools[tool].n_held_nodes > 0, ..look }
            }
            GoalSource::Cut { share, .. } => {
                if self.is_edited(world)
                    && let Some(line) = &self.line
                {
                    self.quality = line.quality(&world.display_topology());
                }
                Look::towards(self.quality.share, share)
            }
            GoalSource::Part { .. } => {
                if self.is_edited(world) {
                    world.organ().body().topology().pieces_into(Through::Faces, &mut self.pieces);
                    let piece = |place: &mut Landmark| self.pieces.of_tet[place.tet(world).index()];
                    let [from, to] = &mut self.places[..] else { return Look::default() };
                    self.are_apart = piece(from) != piece(to);
                }
                Look::of(self.are_apart)
            }
            GoalSource::See { tool, within_rad, nearer_than_m, .. } => {
                let place_m = self.places[0].position_m(world);
                let Some(eye) = world.eye(tool) else {
                    return Look::default();
                };
                let is_near =
                    nearer_than_m.is_none_or(|most_m| eye.position_in_world_m.distance(place_m) <= most_m);
                let off_rad = eye.off_middle_rad(place_m);
                let holds = eye.sees(place_m) && off_rad <= within_rad && is_near;
                Look { share: (within_rad / off_rad.max(1e-9)).min(1.0), holds, mistake: None }
            }
            GoalSource::Clip { n_clips } => {
                let set = world.vessels().map_or(0, crate::world::vessels::Vessels::n_clips);
                Look::towards(set as f64, f64::from(n_clips))
            }
            GoalSource::Bleed { below_m3_per_s } => {
                let rate_m3_per_s =
                    world.vessels().map_or(0.0, crate::world::vessels::Vessels::bleeding_m3_per_s);
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

    fn marks(&mut self, world: &World, tool: usize, (near_m, within_m): (DVec3, f64)) -> Look {
        let is_triggered = world.tool_pose(tool).is_triggered();
        if std::mem::replace(&mut self.was_triggered, is_triggered) || !is_triggered {
            return Look::default();
        }
        match world.touched_at_rest_m(tool) {
            None => Look { mistake: Some("marked without touching the tissue".into()), ..Look::default() },
            Some(touched_m) if touched_m.distance(near_m) <= within_m => Look::of(true),
            Some(touched_m) => {
                let off_mm = 1e3 * touched_m.distance(near_m);
                Look { mistake: Some(format!("marked {off_mm:.0} mm from the place")), ..Look::default() }
            }
        }
    }
}
