//! A simulation whose hands are led to poses, in so many steps.

use anyhow::Context;
use glisson::math::DVec3;
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::{StepInput, World};
use glisson_runtime::simulation::SavedSimulation;
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::film::view::{FilmCamera, FilmView};
use std::path::Path;

/// A world and its hands.
pub(crate) struct Runner {
    pub(crate) simulation: Simulation,
    /// Where the hands are; those beyond the last instrument do not count.
    hands: [ToolInput; MAX_TOOLS],
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
        Ok(Self { simulation, hands, cameras: Vec::new() })
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

    pub(crate) fn save(&self) -> anyhow::Result<Saved> {
        Ok(Saved { simulation: self.simulation.save()?, hands: self.hands })
    }

    pub(crate) fn restore(&mut self, saved: &Saved) -> anyhow::Result<()> {
        self.simulation.restore(&saved.simulation)?;
        for (_, camera) in &mut self.cameras {
            camera.look_again(self.simulation.world());
        }
        self.hands = saved.hands;
        Ok(())
    }

    pub(crate) fn reset(&mut self) -> anyhow::Result<()> {
        self.simulation.reset()?;
        self.hands = homes(self.world());
        Ok(())
    }

    /// A picture of the world now: red, green and blue of each pixel, row by row.
    pub(crate) fn picture(&mut self, kind: PictureKind) -> anyhow::Result<Vec<u8>> {
        if !self.cameras.iter().any(|(known, _)| *known == kind) {
            let camera = FilmCamera::new(&self.simulation, kind.0, kind.1)?;
            self.cameras.push((kind, camera.without_words()));
        }
        let camera = self.cameras.iter_mut().find(|(known, _)| *known == kind);
        let (_, camera) = camera.context("a camera")?;
        Ok(camera.picture(self.simulation.world())?.into_rgb())
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

fn homes(world: &World) -> [ToolInput; MAX_TOOLS] {
    let tools = world.tools();
    std::array::from_fn(|i| tools[i.min(tools.len() - 1)].home)
}

/// On the way from one pose to another; a trigger is pressed at once.
fn towards(from: &ToolInput, to: &ToolInput, share: f64) -> ToolInput {
    ToolInput { trigger: to.trigger, ..from.towards(to, share) }
}
