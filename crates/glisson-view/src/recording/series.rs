//! Moments of a simulation as files that ParaView, PyVista and meshio read: a `.pvd` list, and for each moment the tetrahedra with
//! their fields (`.vtu`) and the instruments (`.vtp`). Source: VTK file formats, "XML file formats" (docs.vtk.org), and ParaView's
//! "ParaView Data (PVD)" file format.
//!
//! Places are in millimetres, LPS, as in every mesh that is written; fields keep the unit that their name says.

use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::files::{FieldPlace, FieldValues, VtuField, write_vtu_with};
use glisson::record::inside::Field;
use glisson::record::snapshot::ToolSnapshot;
use glisson::text::escaped_xml;
use glisson_runtime::Simulation;
use glisson_runtime::inside::Inside;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A list of moments that grows.
pub struct Series {
    pvd: PathBuf,
    /// Of the moments' files, and what it is called in the list.
    folder: PathBuf,
    folder_name: String,
    times_s: Vec<f64>,
    has_tools: bool,
}

impl Series {
    /// A list without a moment; the moments' files go to the folder `NAME_files` beside `NAME.pvd`. What was there is overwritten.
    ///
    /// # Errors
    /// A name that does not end in `.pvd`; a folder that cannot be made.
    pub fn new(pvd: &Path) -> anyhow::Result<Self> {
        let is_pvd = pvd.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("pvd"));
        ensure!(is_pvd, "{}: a list of moments ends in .pvd", pvd.display());
        let stem = pvd.file_stem().unwrap_or_default().to_string_lossy();
        let folder_name = format!("{stem}_files");
        let folder = pvd.with_file_name(&folder_name);
        std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        Ok(Self { pvd: pvd.to_owned(), folder, folder_name, times_s: Vec::new(), has_tools: false })
    }

    /// How many moments there are.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there is none yet.
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// Writes the simulation as it is now. Without [`Series::finish`] it is not in the list.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn add(&mut self, simulation: &Simulation) -> anyhow::Result<()> {
        let (world, number) = (simulation.world(), self.times_s.len());
        // Of each moment anew: a world that went back may have another inside of the same version.
        let inside = Inside::of(simulation, None);
        let [strain, stress_pa] =
            [Field::Strain, Field::Stress].map(|field| inside.interior.at_nodes(field, &inside.positions_m));
        let (rest, live) = (world.organ().mesh(), world.organ().live_tetrahedra());
        let is_live = |tet: &usize| live[*tet];
        let tets: Vec<usize> = (0..rest.tetrahedra.len()).filter(is_live).collect();
        let body_of_nodes = world.organ().body_of_nodes();
        let body_of = |tet: &usize| {
            let first = rest.tetrahedra[*tet][0].index();
            body_of_nodes.get(first).copied().unwrap_or(0) as i32
        };
        let bodies: Vec<i32> = tets.iter().map(body_of).collect();
        let now = TetMesh {
            positions_m: inside.positions_m.clone(),
            tetrahedra: tets.iter().map(|&tet| rest.tetrahedra[tet]).collect(),
            ..TetMesh::default()
        };
        let displacement_m: Vec<DVec3> =
            now.positions_m.iter().zip(&rest.positions_m).map(|(now, rest)| *now - *rest).collect();
        let velocity_m_per_s = world.state().velocities_m_per_s;
        let at_nodes = |name, values| VtuField { name, place: FieldPlace::Nodes, values };
        let mut fields = vec![
            at_nodes("displacement_m", FieldValues::Vectors(&displacement_m)),
            at_nodes("strain", FieldValues::Scalars(&strain)),
            at_nodes("stress_pa", FieldValues::Scalars(&stress_pa)),
            VtuField { name: "body", place: FieldPlace::Tets, values: FieldValues::Integers(&bodies) },
        ];
        // A pre-computed organ has none.
        if velocity_m_per_s.len() == now.positions_m.len() {
            fields.push(at_nodes("velocity_m_per_s", FieldValues::Vectors(velocity_m_per_s)));
        }
        write_vtu_with(&self.folder.join(organ_file(number)), &now, &fields)?;
        self.has_tools = !world.tools().is_empty();
        if self.has_tools {
            let file = self.folder.join(tools_file(number));
            let written = write_atomically(&file, |out| write_tools(simulation, out));
            written.with_context(|| file.display().to_string())?;
        }
        self.times_s.push(world.time_s());
        Ok(())
    }

    /// Writes the list of the moments up to now; more may follow.
    ///
    /// # Errors
    /// A list that cannot be written.
    pub fn finish(&self) -> anyhow::Result<()> {
        let written = write_atomically(&self.pvd, |out| self.write_list(out));
        written.with_context(|| self.pvd.display().to_string())
    }

    fn write_list(&self, out: &mut impl Write) -> io::Result<()> {
        writeln!(out, "<?xml version=\"1.0\"?>")?;
        writeln!(out, "<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">")?;
        writeln!(out, "<Collection>")?;
        let folder = escaped_xml(&self.folder_name);
        for (number, time_s) in self.times_s.iter().enumerate() {
            let tools = self.has_tools.then(|| tools_file(number));
            for (part, file) in std::iter::once(organ_file(number)).chain(tools).enumerate() {
                writeln!(
                    out,
                    "<DataSet timestep=\"{time_s}\" group=\"\" part=\"{part}\" file=\"{folder}/{file}\"/>"
                )?;
            }
        }
        writeln!(out, "</Collection>\n</VTKFile>")
    }
}

fn organ_file(number: usize) -> String {
    format!("organ_{number:05}.vtu")
}

fn tools_file(number: usize) -> String {
    format!("tools_{number:05}.vtp")
}

/// A point for each instrument's tip, with what is known of it.
fn write_tools(simulation: &Simulation, out: &mut impl Write) -> io::Result<()> {
    let tools = simulation.world().snapshot().tools;
    let n = tools.len();
    let vectors = |of: fn(&ToolSnapshot) -> DVec3| -> Vec<f64> {
        tools.iter().flat_map(|tool| of(tool).to_array()).collect()
    };
    let numbers = |of: fn(&ToolSnapshot) -> f64| -> Vec<f64> { tools.iter().map(of).collect() };
    writeln!(out, "<?xml version=\"1.0\"?>\n<!-- Glisson instruments; millimetres; SPACE=LPS -->")?;
    writeln!(out, "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\">\n<PolyData>")?;
    writeln!(out, "<Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"{n}\">\n<PointData>")?;
    write_numbers(out, "Float64", "shaft", 3, &vectors(|tool| tool.pose.shaft_in_world))?;
    write_numbers(out, "Float64", "force_n", 3, &vectors(|tool| tool.force_n))?;
    write_numbers(out, "Float64", "roll_rad", 1, &numbers(|tool| tool.pose.roll_rad))?;
    write_numbers(out, "Float64", "jaw_opening", 1, &numbers(|tool| tool.pose.jaw_opening))?;
    write_numbers(out, "Float64", "trigger", 1, &numbers(|tool| tool.pose.trigger))?;
    write_numbers(out, "Float64", "held_nodes", 1, &numbers(|tool| f64::from(tool.n_held_nodes)))?;
    writeln!(out, "</PointData>\n<Points>")?;
    write_numbers(out, "Float64", "Points", 3, &vectors(|tool| tool.pose.tip_in_world_m * 1e3))?;
    writeln!(out, "</Points>\n<Verts>")?;
    let upto = |first: usize| (first..first + n).map(|i| i as f64).collect::<Vec<f64>>();
    write_numbers(out, "Int64", "connectivity", 1, &upto(0))?;
    write_numbers(out, "Int64", "offsets", 1, &upto(1))?;
    writeln!(out, "</Verts>\n</Piece>\n</PolyData>\n</VTKFile>")
}

/// A data array as text: rows of `width` numbers.
fn write_numbers(
    out: &mut impl Write,
    kind: &str,
    name: &str,
    width: usize,
    values: &[f64],
) -> io::Result<()> {
    write!(
        out,
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{width}\" format=\"ascii\">"
    )?;
    values.iter().try_for_each(|value| write!(out, "{value} "))?;
    writeln!(out, "</DataArray>")
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::files::read_mesh;
    use glisson::scene::Scene;
    use glisson_runtime::OpenScene;

    const BALL: &str = r#"glisson_scene = 1
[organ]
ball = { center = ["0 mm", "0 mm", "0 mm"], radius = "30 mm" }
edge = "12 mm"
tissue = "liver"
model = "implicit"
[[organ.fixed]]
furthest = { direction = [0, 1, 0], fraction = 0.2 }
[[tool]]
name = "probe"
tip_radius = "4 mm"
home_tip = ["0 mm", "-60 mm", "0 mm"]
home_shaft = [0, -1, 0]
"#;

    #[test]
    fn moments_are_meshes_in_a_list() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let pvd = folder.join("a & b.pvd");
        let source = OpenScene {
            scene: Scene::parse(BALL).unwrap(),
            folder: folder.to_owned(),
            origin: "ball".into(),
            n_threads: 1,
        };
        let mut simulation = Simulation::open(source, None).unwrap();
        let mut series = Series::new(&pvd).unwrap();
        series.add(&simulation).unwrap();
        let poses = [simulation.world().tools()[0].home];
        simulation.advance(&glisson::world::StepInput::of(&poses)).unwrap();
        series.add(&simulation).unwrap();
        assert!(!pvd.exists(), "the list is whole or not there");
        series.finish().unwrap();
        let list = std::fs::read_to_string(&pvd).unwrap();
        let step_s = simulation.world().spec().time_step_s;
        assert_eq!(list.matches("<DataSet ").count(), 4);
        assert!(list.contains(&format!(
            "timestep=\"{step_s}\" group=\"\" part=\"1\" file=\"a &amp; b_files/tools_00001.vtp\""
        )));
        let moment = folder.join("a & b_files/organ_00001.vtu");
        let (mesh, _) = read_mesh(&moment).unwrap();
        assert_eq!(mesh.tetrahedra, simulation.world().organ().mesh().tetrahedra);
        let text = std::fs::read_to_string(&moment).unwrap();
        for name in ["displacement_m", "velocity_m_per_s", "strain", "stress_pa", "body"] {
            assert!(text.contains(&format!("Name=\"{name}\"")), "{name}");
        }
        assert!(Series::new(&folder.join("a.vtu")).is_err());
    }
}
