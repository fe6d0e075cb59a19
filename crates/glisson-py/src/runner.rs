//! A simulation whose hands are led to poses, in so many steps.

use anyhow::Context;
use glisson::math::DVec3;
use glisson::scene::Scene;
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::training::surface_strain::SurfaceStrain;
use glisson::training::task::TaskProgress;
use glisson::world::{StepInput, World};
use glisson_runtime::inside::Inside;
use glisson_runtime::simulation::SavedSimulation;
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::film::view::{FilmCamera, FilmView, Layers};
use std::path::Path;

/// A world and its hands.
pub(crate) struct Runner {
    pub(crate) simulation: Simulation,
    /// Where the hands are; those beyond the last instrument do not count.
    hands: [ToolInput; MAX_TOOLS],
    /// How often it came back to an earlier moment.
    n_returns: u64,
    /// What is inside, as it was asked for last.
    inside: Option<Inside>,
    /// Its skin, and the version of the surface that it is of.
    skin: Option<(u32, SurfaceStrain)>,
    /// What takes pictures of it, one of each kind that was asked for.
    cameras: Vec<(PictureKind, FilmCamera)>,
}

/// From where a picture is taken, and how many pixels wide and high it is.
pub(crate) type PictureKind = (FilmView, [usize; 2]);

/// A moment to come back to.
pub(crate) struct Saved {
    simulation: SavedSimulation,
    hands: [ToolInput; MAX_TOOLS],
}

impl Runner {
    pub(crate) fn open(scene: OpenScene, record: Option<&Path>) -> anyhow::Result<Self> {
        let simulation = Simulation::open(scene, record)?;
        let hands = homes(simulation.world());
        Ok(Self::of(simulation, hands))
    }

    fn of(simulation: Simulation, hands: [ToolInput; MAX_TOOLS]) -> Self {
        Self { simulation, hands, n_returns: 0, inside: None, skin: None, cameras: Vec::new() }
    }

    /// Another one of the same scene, which begins at a saved moment.
    pub(crate) fn another_at(&self, saved: &Saved) -> Self {
        Self::of(self.simulation.another_at(&saved.simulation), saved.hands)
    }

    /// How often it came back to an earlier moment.
    pub(crate) fn n_returns(&self) -> u64 {
        self.n_returns
    }

    pub(crate) fn world(&self) -> &World {
        self.simulation.world()
    }

    /// `n` steps, in which the hands go straight to where they are wanted; where nothing is wanted they stay.
    pub(crate) fn step(&mut self, n: u32, wanted: Option<&[ToolInput]>) -> anyhow::Result<()> {
        let (from, mut to) = (self.hands, self.hands);
        for (hand, wanted) in to.iter_mut().zip(wanted.unwrap_or_default()) {
            *hand = *wanted;
        }
        for step in 1..=n {
            let share = f64::from(step) / f64::from(n);
            // At the end they are where they are wanted, to the bit.
            let tools =
                if step == n { to } else { std::array::from_fn(|i| towards(&from[i], &to[i], share)) };
            self.advance(&StepInput::of(&tools))?;
            self.hands = tools;
        }
        Ok(())
    }

    /// Leads the hands along the paths of the scene until a time, as a task without a window does: it ends before where the paths end, or the task.
    /// Whether there is more.
    pub(crate) fn demonstrate(&mut self, scene: &Scene, until_s: f64) -> anyhow::Result<bool> {
        let time_step_s = scene.world.time_step_s;
        let end_s = scene.end_of_paths_s().context("the instruments of this scene have no [[tool.path]]")?;
        let last_step = (end_s / time_step_s).ceil() as u64;
        loop {
            let step = self.world().steps_made();
            let [from_s, to_s] = [step, step + 1].map(|step| step as f64 * time_step_s);
            let is_over = self.simulation.task().is_some_and(|task| task.outcome().is_some());
            if step >= last_step || is_over {
                return Ok(false);
            }
            // Half a step, so that rounding makes no step more or less.
            if to_s > until_s + 0.5 * time_step_s {
                return Ok(true);
            }
            let tools = scene.input_at(to_s).tools;
            self.advance(&StepInput::of(&tools))?;
            self.hands = tools;
            for tool in scene.clips_between(from_s, to_s) {
                self.simulation.clip_vessel(tool)?;
            }
        }
    }

    /// A step with the hands put somewhere, without touching anything between.
    pub(crate) fn place(&mut self, poses: &[ToolInput]) -> anyhow::Result<()> {
        for (hand, pose) in self.hands.iter_mut().zip(poses) {
            *hand = *pose;
        }
        let tools = self.hands;
        self.advance(&StepInput::of(&tools).placed())
    }

    fn advance(&mut self, input: &StepInput) -> anyhow::Result<()> {
        let step = self.world().steps_made();
        self.simulation.advance(input).with_context(|| format!("step {step}")).map(|_| ())
    }

    /// What is inside now.
    pub(crate) fn inside(&mut self) -> &Inside {
        let now = Inside::of(&self.simulation, self.inside.as_ref());
        self.inside.insert(now)
    }

    pub(crate) fn save(&self) -> anyhow::Result<Saved> {
        Ok(Saved { simulation: self.simulation.save()?, hands: self.hands })
    }

    pub(crate) fn restore(&mut self, saved: &Saved) -> anyhow::Result<()> {
        self.simulation.restore(&saved.simulation)?;
        // Versions of the surface are counted from there on again.
        (self.skin, self.inside) = (None, None);
        for (_, camera) in &mut self.cameras {
            camera.look_again(self.simulation.world());
        }
        self.hands = saved.hands;
        self.n_returns += 1;
        Ok(())
    }

    pub(crate) fn reset(&mut self) -> anyhow::Result<()> {
        self.simulation.reset()?;
        self.hands = homes(self.world());
        Ok(())
    }

    /// A picture of the world now: red, green and blue of each pixel, row by row.
    pub(crate) fn picture(&mut self, kind: PictureKind) -> anyhow::Result<Vec<u8>> {
        let (camera, world) = self.camera(kind)?;
        Ok(camera.picture(world)?.into_rgb())
    }

    /// The same as PNG.
    pub(crate) fn png(&mut self, kind: PictureKind) -> anyhow::Result<Vec<u8>> {
        let (camera, world) = self.camera(kind)?;
        camera.picture(world)?.png()
    }

    /// Depth and kind of what is seen at each pixel, row by row.
    pub(crate) fn layers(&mut self, kind: PictureKind) -> anyhow::Result<Layers> {
        let (camera, world) = self.camera(kind)?;
        camera.layers(world)
    }

    fn camera(&mut self, kind: PictureKind) -> anyhow::Result<(&mut FilmCamera, &World)> {
        if !self.cameras.iter().any(|(known, _)| *known == kind) {
            let camera = FilmCamera::new(&self.simulation, kind.0, kind.1)?;
            self.cameras.push((kind, camera.without_words()));
        }
        let camera = self.cameras.iter_mut().find(|(known, _)| *known == kind);
        let (_, camera) = camera.context("a camera")?;
        Ok((camera, self.simulation.world()))
    }

    /// Greatest strain of the skin, its area at rest that is strained beyond what tears the capsule of livers [m2], tissue that was taken
    /// out [m3], blood that was lost [m3].
    pub(crate) fn damage(&mut self) -> [f64; 4] {
        let world = self.simulation.world();
        let version = world.organ().topology_version();
        let known = self.skin.take().filter(|(of, _)| *of == version);
        let (_, skin) = self.skin.insert(known.unwrap_or_else(|| (version, SurfaceStrain::of(world))));
        let positions_m = world.state().positions_m;
        let strain = skin.read(|node| positions_m[node.index()]);
        [strain.greatest, strain.beyond_m2, world.removed_volume_m3(), blood_lost_m3(world)]
    }

    /// So many vertices of the surface as it is drawn [m], spread evenly over their numbers; of a surface with fewer some come twice.
    pub(crate) fn cloud_m(&self, n: usize) -> Vec<DVec3> {
        let positions_m = self.world().snapshot().positions_m;
        (0..n).map(|i| positions_m[i * positions_m.len() / n]).collect()
    }

    /// Middle of the strand between bodies that is nearest to an instrument's tip [m]; none where none is left.
    pub(crate) fn nearest_strand_m(&self, tool: usize) -> Option<DVec3> {
        let tip_m = self.world().tool_pose(tool).tip_in_world_m;
        let middles_m = self.world().strands_m().map(|(_, [a, b])| a.midpoint(b));
        middles_m.min_by(|a, b| a.distance_squared(tip_m).total_cmp(&b.distance_squared(tip_m)))
    }

    /// How far its task is; of a scene without one there are no stages.
    pub(crate) fn progress(&self) -> TaskProgress {
        self.simulation.task().map(|task| task.progress()).unwrap_or_default()
    }

    /// The first, the middle and the last point of what its task marks now [m], of the tissue at rest.
    pub(crate) fn marks_m(&self) -> Option<[DVec3; 3]> {
        let points_m = self.simulation.task()?.mark()?.points_m;
        Some([*points_m.first()?, middle_of_line_m(&points_m), *points_m.last()?])
    }

    /// Number of the surface node that is nearest to a place at rest.
    pub(crate) fn surface_node_near(&self, at_rest_m: DVec3) -> Option<usize> {
        let organ = self.world().organ();
        let rest_m = &organ.mesh().positions_m;
        let away = |node: usize| rest_m[node].distance_squared(at_rest_m);
        let nodes = organ.surface_nodes().iter().map(|node| node.index());
        nodes.min_by(|a, b| away(*a).total_cmp(&away(*b)))
    }
}

/// Where half of a line's length is [m].
fn middle_of_line_m(points_m: &[DVec3]) -> DVec3 {
    let pieces = || points_m.windows(2).map(|ends| (ends[0], ends[1]));
    let mut left_m = 0.5 * pieces().map(|(from, to)| from.distance(to)).sum::<f64>();
    for (from, to) in pieces() {
        let length_m = from.distance(to);
        if left_m <= length_m && length_m > 0.0 {
            return from.lerp(to, left_m / length_m);
        }
        left_m -= length_m;
    }
    points_m[0]
}

pub(crate) fn blood_lost_m3(world: &World) -> f64 {
    world.vessels().map_or(0.0, glisson::world::vessels::Vessels::lost_m3)
}

fn homes(world: &World) -> [ToolInput; MAX_TOOLS] {
    let tools = world.tools();
    std::array::from_fn(|i| tools[i.min(tools.len() - 1)].home)
}

/// On the way from one pose to another; a trigger is pressed at once.
fn towards(from: &ToolInput, to: &ToolInput, share: f64) -> ToolInput {
    ToolInput { trigger: to.trigger, ..from.towards(to, share) }
}
