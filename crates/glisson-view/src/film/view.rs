//! The picture of a simulation as a film shows it.

use anyhow::Context;
use glisson::math::{Aabb, DVec3};
use glisson::record::snapshot::{DisplayTopology, Snapshot};
use glisson::tool::Tool;
use glisson::tool::endoscope::Eye;
use glisson::world::World;
use glisson_picture::{
    Camera, Caption, CaptionPlace, Instrument, Look, Picture, PictureScene, Shown, View, looks_of, shown_of,
};
use glisson_runtime::Simulation;
use std::fmt::Write as _;

/// As the viewer begins: from the patient's right, a little from above [rad].
const OUTSIDE: View = View { azimuth_rad: 0.38, elevation_rad: 0.3 };
/// So much more than the organ is in the picture, for instruments: a choice.
const ROOM: f64 = 1.25;

/// From where a film is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilmView {
    /// From outside, the whole organ in the picture.
    Outside,
    /// Through the scene's first endoscope.
    Endoscope,
}

/// Takes the pictures of a film.
pub struct FilmCamera {
    size: [usize; 2],
    looks: Vec<Look>,
    outside: Camera,
    /// The instrument that is looked through, if one is.
    endoscope: Option<usize>,
    /// The displayed surface, as long as it is the same.
    topology: DisplayTopology,
    /// Whether time, forces and blood are written into the picture.
    has_words: bool,
}

/// What a picture shows, pixel by pixel, row by row from the top.
#[derive(Clone, Debug)]
pub struct Layers {
    /// How deep it is along the view [m]; 0 where nothing is seen.
    pub depths_m: Vec<f32>,
    /// What it is: 0 for nothing, or one of the numbers here.
    pub kinds: Vec<u8>,
}

impl Layers {
    /// An instrument.
    pub const INSTRUMENT: u8 = 1;
    /// A thread, a clip, a strand between bodies, a drop of blood.
    pub const THING: u8 = 2;
    /// A face of a cut.
    pub const CUT_FACE: u8 = 3;
    /// The skin of the first body; the next ones follow.
    pub const FIRST_BODY: u8 = 4;
}

fn is_endoscope(tool: &Tool) -> bool {
    tool.kind.optics().is_some()
}

impl FilmCamera {
    /// A camera for a simulation that begins.
    ///
    /// # Errors
    /// When a view through an endoscope is wanted, and the scene has none.
    pub fn new(simulation: &Simulation, view: FilmView, size: [usize; 2]) -> anyhow::Result<Self> {
        let world = simulation.world();
        let endoscope = match view {
            FilmView::Outside => None,
            FilmView::Endoscope => {
                let found = world.tools().iter().position(is_endoscope);
                Some(
                    found
                        .context("the scene has no endoscope to look through; it can be seen from outside")?,
                )
            }
        };
        Ok(Self {
            size,
            looks: looks_of(world.spec(), &simulation.body().material_text),
            outside: outside(&world.snapshot().positions_m, size),
            endoscope,
            topology: world.display_topology(),
            has_words: true,
        })
    }

    /// The simulation came back to an earlier moment: versions of its surface are counted from there on again.
    pub fn look_again(&mut self, world: &World) {
        self.topology = world.display_topology();
    }

    /// The same without words in its pictures: for programs that look at them.
    #[must_use]
    pub fn without_words(self) -> Self {
        Self { has_words: false, ..self }
    }

    /// The simulation as it is now.
    ///
    /// # Errors
    /// When a place is no number.
    pub fn picture(&mut self, world: &World) -> anyhow::Result<Picture> {
        Picture::render(&self.scene(world).0)
    }

    /// Depth and kind of what is seen at the middle of each pixel.
    ///
    /// # Errors
    /// When a place is no number.
    pub fn layers(&mut self, world: &World) -> anyhow::Result<Layers> {
        let (scene, shown) = self.scene(world);
        let seen = scene.depths_and_surfaces()?;
        let kind = |surface: Option<usize>| match surface.map(|number| shown[number]) {
            None => Layers::INSTRUMENT,
            Some(Shown::Thing) => Layers::THING,
            Some(Shown::CutFace(_)) => Layers::CUT_FACE,
            Some(Shown::Body(body)) => Layers::FIRST_BODY.saturating_add(body),
        };
        Ok(Layers {
            depths_m: seen.iter().map(|pixel| pixel.map_or(0.0, |seen| seen.depth_m)).collect(),
            kinds: seen.iter().map(|pixel| pixel.map_or(0, |seen| kind(seen.surface))).collect(),
        })
    }

    /// What is drawn of the simulation as it is now, and what each surface is of.
    fn scene(&mut self, world: &World) -> (PictureScene, Vec<Shown>) {
        let snapshot = world.snapshot();
        if snapshot.topology_version != self.topology.version {
            self.topology = world.display_topology();
        }
        let tools = world.tools();
        let is_shown = |&number: &usize| Some(number) != self.endoscope;
        let (surfaces, shown) = shown_of(&self.topology, &snapshot, &self.looks);
        let scene = PictureScene {
            surfaces,
            instruments: (0..tools.len())
                .filter(is_shown)
                .map(|number| Instrument::of(&tools[number], &snapshot.tools[number]))
                .collect(),
            arrows: Vec::new(),
            captions: if self.has_words {
                vec![Caption { text: words(tools, &snapshot), place: CaptionPlace::BottomLeft }]
            } else {
                Vec::new()
            },
            camera: self.camera(tools, &snapshot),
            size: self.size,
        };
        (scene, shown)
    }

    fn camera(&self, tools: &[Tool], snapshot: &Snapshot) -> Camera {
        let through = |number: usize| {
            let optics = tools[number].kind.optics()?;
            Some(Camera::through(&Eye::of(&snapshot.tools[number].pose, optics)))
        };
        self.endoscope.and_then(through).unwrap_or(self.outside)
    }
}

/// From where the whole organ is seen, with room around it.
fn outside(positions_m: &[DVec3], size: [usize; 2]) -> Camera {
    let middle_m = Aabb::of_points(positions_m).center_m();
    let wider_m: Vec<DVec3> = positions_m.iter().map(|&p| middle_m + ROOM * (p - middle_m)).collect();
    Camera::framing_points(&wider_m, size, OUTSIDE)
}

/// Time, forces on the instruments that touch, and blood.
fn words(tools: &[Tool], snapshot: &Snapshot) -> String {
    let mut text = format!("{:7.2} s", snapshot.time_s);
    for (tool, now) in tools.iter().zip(&snapshot.tools).filter(|(tool, _)| !is_endoscope(tool)) {
        let _ = write!(text, "\n{:5.2} N  {}", now.force_n.length(), tool.name);
    }
    if snapshot.bleeding.has_vessels {
        let _ = write!(text, "\n{:5.1} ml blood", 1e6 * snapshot.bleeding.lost_m3);
    }
    text
}
