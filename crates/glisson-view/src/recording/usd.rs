//! A session as a USD scene in text (`.usda`): the surfaces of all bodies and the instruments, moving. Source: "USD file format, text"
//! and the schemas UsdGeomMesh, UsdGeomCylinder and UsdGeomSphere (openusd.org).
//!
//! Metres, LPS with z (to the head) upwards. Where tissue was cut, the surface has other points and triangles from that moment on.

use glisson::math::{DQuat, DVec3};
use glisson::record::snapshot::DisplayTopology;
use glisson::tool::Tool;
use glisson::world::World;
use std::io::{self, Seek, SeekFrom, Write};

/// Digits after the point of a place [m]: a hundredth of a millimetre.
const DIGITS: usize = 5;
/// Colours of bodies, one after the other: liver, then those of the viewer's list. Red, green, blue, linear.
const COLOURS: [[f64; 3]; 4] = [[0.35, 0.07, 0.05], [0.45, 0.35, 0.12], [0.5, 0.4, 0.3], [0.3, 0.3, 0.35]];
const STEEL: [f64; 3] = [0.6, 0.62, 0.65];

/// Writes frames as they come.
pub struct UsdWriter<W> {
    out: W,
    rate_hz: f64,
    /// Number of the last frame that was written.
    last_frame: Option<u64>,
    /// Where the number of the last frame stands, in as many places as a number may have.
    end_at: u64,
    /// Versions of the surface that were written, by their frames.
    surfaces: Vec<Surface>,
    tools: Vec<ToolTrack>,
}

/// A version of the surface, from a frame on.
struct Surface {
    from_frame: u64,
    version: u32,
    triangles: Vec<[u32; 3]>,
    body_of: Vec<u8>,
}

/// Where an instrument was, as samples in time.
struct ToolTrack {
    name: String,
    tip_radius_m: f64,
    shaft_radius_m: f64,
    shaft_length_m: f64,
    places: String,
    turns: String,
}

impl<W: Write + Seek> UsdWriter<W> {
    /// A scene of `rate_hz` frames a second of simulated time, which begins with its first frame.
    pub fn new(out: W, rate_hz: f64) -> Self {
        Self { out, rate_hz, last_frame: None, end_at: 0, surfaces: Vec::new(), tools: Vec::new() }
    }

    fn begin(&mut self, world: &World) -> io::Result<()> {
        let (out, rate_hz) = (&mut self.out, self.rate_hz);
        writeln!(
            out,
            "#usda 1.0\n(\n    defaultPrim = \"glisson\"\n    metersPerUnit = 1\n    upAxis = \"Z\""
        )?;
        writeln!(out, "    timeCodesPerSecond = {rate_hz}\n    framesPerSecond = {rate_hz}")?;
        writeln!(out, "    startTimeCode = 0")?;
        write!(out, "    endTimeCode = ")?;
        self.end_at = out.stream_position()?;
        writeln!(out, "{:20}\n)\n", 0)?;
        writeln!(out, "def Xform \"glisson\"\n{{")?;
        writeln!(out, "    def Mesh \"tissue\"\n    {{")?;
        writeln!(out, "        uniform token subdivisionScheme = \"none\"")?;
        writeln!(out, "        uniform token orientation = \"rightHanded\"")?;
        writeln!(out, "        point3f[] points.timeSamples = {{")?;
        let mut names = Vec::new();
        let track = |tool: &Tool| ToolTrack {
            name: identifier(&tool.name, &mut names),
            tip_radius_m: tool.tip_radius_m,
            shaft_radius_m: tool.shaft_radius_m,
            shaft_length_m: tool.shaft_length_m,
            places: String::new(),
            turns: String::new(),
        };
        self.tools = world.tools().iter().map(track).collect();
        Ok(())
    }

    /// Adds a frame; its number counts from 0 at the scene's rate, and is later than the last one's.
    ///
    /// # Errors
    /// What the file says.
    pub fn add(&mut self, frame: u64, world: &World) -> io::Result<()> {
        if self.last_frame.is_none() {
            self.begin(world)?;
        }
        let snapshot = world.snapshot();
        let version = snapshot.topology_version;
        if self.surfaces.last().is_none_or(|last| last.version != version) {
            let DisplayTopology { triangles, body_of, .. } = world.display_topology();
            self.surfaces.push(Surface { from_frame: frame, version, triangles, body_of });
        }
        let points: Vec<String> = snapshot.positions_m.iter().map(|p| point(p.to_array())).collect();
        writeln!(self.out, "            {frame}: [{}],", points.join(", "))?;
        for (track, tool) in self.tools.iter_mut().zip(&snapshot.tools) {
            let tip_m = tool.pose.tip_in_world_m + tool.shown_further_out_m;
            let [w, x, y, z] = turn_from_z(tool.pose.shaft_in_world);
            track.places += &format!("{frame}: {}, ", point(tip_m.to_array()));
            track.turns += &format!("{frame}: ({w:.6}, {x:.6}, {y:.6}, {z:.6}), ");
        }
        self.last_frame = Some(frame);
        Ok(())
    }

    /// Ends the scene; one without a frame stays empty.
    ///
    /// # Errors
    /// What the file says.
    pub fn finish(mut self) -> io::Result<W> {
        let Some(last_frame) = self.last_frame else { return Ok(self.out) };
        writeln!(self.out, "        }}")?;
        let counts = |surface: &Surface| vec!["3"; surface.triangles.len()].join(", ");
        let corners = |surface: &Surface| {
            let corners: Vec<String> = surface.triangles.iter().flatten().map(u32::to_string).collect();
            corners.join(", ")
        };
        let colours = |surface: &Surface| {
            let colour = |body: &u8| point(COLOURS[usize::from(*body) % COLOURS.len()]);
            surface.body_of.iter().map(colour).collect::<Vec<_>>().join(", ")
        };
        self.write_samples("int[] faceVertexCounts", counts)?;
        self.write_samples("int[] faceVertexIndices", corners)?;
        writeln!(
            self.out,
            "        color3f[] primvars:displayColor (\n            interpolation = \"vertex\"\n        )"
        )?;
        self.write_samples("color3f[] primvars:displayColor", colours)?;
        writeln!(self.out, "    }}")?;
        for track in &self.tools {
            track.write(&mut self.out)?;
        }
        writeln!(self.out, "}}")?;
        self.out.seek(SeekFrom::Start(self.end_at))?;
        write!(self.out, "{:20}", last_frame)?;
        self.out.seek(SeekFrom::End(0))?;
        Ok(self.out)
    }

    /// An attribute that has another value with each version of the surface.
    fn write_samples(&mut self, name: &str, of: impl Fn(&Surface) -> String) -> io::Result<()> {
        writeln!(self.out, "        {name}.timeSamples = {{")?;
        for surface in &self.surfaces {
            writeln!(self.out, "            {}: [{}],", surface.from_frame, of(surface))?;
        }
        writeln!(self.out, "        }}")
    }
}

impl ToolTrack {
    fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let Self { name, places, turns, tip_radius_m, shaft_radius_m, shaft_length_m } = self;
        writeln!(out, "    def Xform \"{name}\"\n    {{")?;
        writeln!(out, "        double3 xformOp:translate.timeSamples = {{{places}}}")?;
        writeln!(out, "        quatd xformOp:orient.timeSamples = {{{turns}}}")?;
        writeln!(out, "        uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]")?;
        let colour = format!("color3f[] primvars:displayColor = [{}]", point(STEEL));
        writeln!(out, "        def Sphere \"tip\"\n        {{")?;
        writeln!(out, "            double radius = {tip_radius_m}\n            {colour}\n        }}")?;
        writeln!(out, "        def Cylinder \"shaft\"\n        {{\n            uniform token axis = \"Z\"")?;
        writeln!(
            out,
            "            double radius = {shaft_radius_m}\n            double height = {shaft_length_m}"
        )?;
        writeln!(out, "            double3 xformOp:translate = (0, 0, {})", 0.5 * shaft_length_m)?;
        writeln!(
            out,
            "            uniform token[] xformOpOrder = [\"xformOp:translate\"]\n            {colour}"
        )?;
        writeln!(out, "        }}\n    }}")
    }
}

fn point([x, y, z]: [f64; 3]) -> String {
    format!("({x:.DIGITS$}, {y:.DIGITS$}, {z:.DIGITS$})")
}

/// The shortest turn from z to a unit vector, as a quaternion w, x, y, z.
fn turn_from_z(to: DVec3) -> [f64; 4] {
    let turn = DQuat::from_rotation_arc(DVec3::Z, to);
    [turn.w, turn.x, turn.y, turn.z]
}

/// A name as USD allows it, which none of those `taken` has: letters, digits and underscores.
fn identifier(name: &str, taken: &mut Vec<String>) -> String {
    let kept = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    // Not with a digit at first, and not the name of the tissue.
    let plain = format!("tool_{}", name.chars().map(kept).collect::<String>());
    let numbered = (2..).map(|n| format!("{plain}_{n}"));
    let free = std::iter::once(plain.clone()).chain(numbered).find(|name| !taken.contains(name));
    let free = free.unwrap_or(plain);
    taken.push(free.clone());
    free
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::scene::Scene;
    use glisson_runtime::tasks::task_named;
    use glisson_runtime::{OpenScene, Simulation};
    use std::io::Cursor;
    use std::path::PathBuf;

    fn samples<'a>(text: &'a str, attribute: &str) -> Vec<&'a str> {
        let after = text.split(&format!("{attribute}.timeSamples = {{\n")).nth(1).unwrap();
        after.lines().take_while(|line| line.trim() != "}").collect()
    }

    #[test]
    fn a_scene_has_the_points_of_every_frame_and_the_triangles_of_every_surface() {
        let scene = Scene::parse(task_named("line_cut").unwrap()).unwrap();
        let source = OpenScene {
            scene: scene.clone(),
            folder: PathBuf::from("."),
            origin: "line_cut".into(),
            n_threads: 1,
        };
        let mut simulation = Simulation::open(source, None).unwrap();
        let mut writer = UsdWriter::new(Cursor::new(Vec::new()), 30.0);
        let mut sizes = Vec::new();
        // Into the cut, with a frame before it and two in it.
        for step in 1..=1200 {
            let world = simulation.world();
            let at_s = (world.steps_made() + 1) as f64 * world.spec().time_step_s;
            let poses = scene.input_at(at_s).tools[..world.tools().len()].to_vec();
            simulation.advance(&glisson::world::StepInput::of(&poses)).unwrap();
            if [10, 1100, 1200].contains(&step) {
                // The second frame is missing, as where a step is longer than a frame.
                writer.add([0, 2, 3][sizes.len()], simulation.world()).unwrap();
                sizes.push(simulation.world().snapshot().positions_m.len());
            }
        }
        assert!(sizes[2] > sizes[0], "{sizes:?}: nothing was cut");
        let text = String::from_utf8(writer.finish().unwrap().into_inner()).unwrap();
        let header = text.split("def Xform").next().unwrap();
        assert!(header.contains("endTimeCode =                    3\n"), "{header}");
        let points: Vec<usize> =
            samples(&text, "points").iter().map(|frame| frame.matches('(').count()).collect();
        assert_eq!(points, sizes);
        let corners = samples(&text, "faceVertexIndices");
        assert!((2..=3).contains(&corners.len()) && corners[0].trim().starts_with("0: ["));
        for corner in corners.last().unwrap().split(['[', ']']).nth(1).unwrap().split(", ") {
            assert!(corner.parse::<usize>().unwrap() < sizes[2]);
        }
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        assert!(text.contains("def Xform \"tool_scalpel\""));
    }

    #[test]
    fn names_are_identifiers_and_each_its_own() {
        let mut taken = Vec::new();
        let names = ["left grasper", "left-grasper", "2"].map(|name| identifier(name, &mut taken));
        assert_eq!(names, ["tool_left_grasper", "tool_left_grasper_2", "tool_2"]);
    }
}
