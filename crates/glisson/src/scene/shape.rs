//! Where the mesh of a body comes from: a file, a simple solid, or an organ of the synthetic patient.

use super::reader::{SceneError, Section, Value};
use crate::image::phantom::Tissue;
use crate::math::DVec3;
use crate::mesh::organs::{FinerBall, MAX_FINER};
use crate::text::did_you_mean;
use crate::units::{Dimension, LengthUnit};
use std::path::{Path, PathBuf};

/// The shape of a body at rest.
#[derive(Clone, Debug, PartialEq)]
pub enum BodyShape {
    /// A tetrahedral mesh, or for rigid bodies a closed surface.
    File {
        /// Relative to the scene's folder.
        file: PathBuf,
        /// What its numbers are in.
        unit: LengthUnit,
    },
    /// A box along the axes.
    Box {
        /// Smallest corner [m].
        min_m: DVec3,
        /// Largest corner [m].
        max_m: DVec3,
    },
    /// A ball.
    Ball {
        /// Centre [m].
        center_m: DVec3,
        /// Radius [m].
        radius_m: f64,
    },
    /// A cylinder between the centres of its ends.
    Cylinder {
        /// Centre of an end [m].
        from_m: DVec3,
        /// Centre of the other [m].
        to_m: DVec3,
        /// Radius [m].
        radius_m: f64,
    },
    /// A tube with what branches off it.
    Tube {
        /// The tube.
        stem: TubePath,
        /// Tubes that begin or end in it, or in each other.
        branches: Vec<TubePath>,
    },
    /// A square plate.
    Slab {
        /// Middle of its upper face [m].
        point_m: DVec3,
        /// Unit normal of that face.
        normal: DVec3,
        /// Edge of the face [m].
        size_m: f64,
        /// Thickness below it [m].
        thickness_m: f64,
    },
    /// An organ of the synthetic patient ([`crate::image::phantom`]).
    Phantom(PhantomOrgan),
}

/// A tube around a smooth line through points, with rounded ends.
#[derive(Clone, Debug, PartialEq)]
pub struct TubePath {
    /// The points [m].
    pub path_m: Vec<DVec3>,
    /// The radius at each [m].
    pub radii_m: Vec<f64>,
}

/// An organ of a synthetic patient.
#[derive(Clone, Debug, PartialEq)]
pub struct PhantomOrgan {
    /// Which one; what lies inside it belongs to it.
    pub organ: Tissue,
    /// Which patient.
    pub seed: u64,
    /// Tetrahedra that are wanted.
    pub n_tetrahedra: usize,
    /// What inside it keeps a label of its own, for `[[organ.part]]`.
    pub parts: Vec<Tissue>,
    /// Whether its blood vessels come with it.
    pub has_vessels: bool,
    /// Where its tetrahedra are smaller.
    pub finer: Option<FinerBall>,
}

/// A shape, and how finely it is meshed.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeSource {
    /// The shape.
    pub shape: BodyShape,
    /// Edge of its triangles [m], where it is meshed; by its size when absent.
    pub edge_m: Option<f64>,
}

const KEYS: [&str; 7] = ["mesh", "box", "ball", "cylinder", "tube", "slab", "phantom"];
const EXAMPLE: &str = "mesh = \"liver.vtu\", or in its place box = { min, max }, ball = { center, radius }, \
     cylinder = { from, to, radius }, tube = { path, radii }, slab = { point, normal, size, thickness } or phantom = { organ, seed, tetrahedra }";
const ALLOWED: &str = "exactly one of mesh, box, ball, cylinder, tube, slab and phantom";

/// What lies in the liver, and can have a label of its own.
const INSIDE_LIVER: [Tissue; 3] = [Tissue::LiverTumour, Tissue::PortalVein, Tissue::HepaticVein];
/// Points of a tube at most, and branches: choices.
const MOST_OF_TUBE: usize = 100;
const MOST_BRANCHES: usize = 20;
/// Tetrahedra of an organ of the phantom unless the scene says how many.
const DEFAULT_TETRAHEDRA: usize = 6300;
/// The fewest and most that a scene may ask for.
const TETRAHEDRA: std::ops::RangeInclusive<usize> = 200..=200_000;

/// The shape of a body, `edge` with it.
pub(super) fn read_shape(section: &mut Section<'_>) -> Result<ShapeSource, SceneError> {
    let mesh = section.string("mesh")?;
    let unit = read_mesh_unit(section)?;
    let mut solids = Vec::new();
    for (key, read) in SOLIDS {
        solids.extend(section.section(key)?.map(|table| (read, table)));
    }
    let mut solids = solids.into_iter();
    let shape = match (mesh, solids.next(), solids.next()) {
        (Some((file, _)), None, _) => BodyShape::File { file: file.into(), unit },
        (None, Some((read, mut table)), None) => {
            let shape = read(&mut table)?;
            table.finish()?;
            shape
        }
        (None, None, _) => return Err(section.missing_one_of(&KEYS, EXAMPLE)),
        _ => {
            let found: Vec<&str> = KEYS.into_iter().filter(|key| section.has(key)).collect();
            return Err(section.wrong_table(
                "mesh",
                format!("one of {}", found.join(" and ")),
                ALLOWED.into(),
            ));
        }
    };
    let edge_m = section.positive("edge", Dimension::Length)?;
    let (is_file, is_phantom) =
        (matches!(shape, BodyShape::File { .. }), matches!(shape, BodyShape::Phantom(_)));
    if section.has("mesh_unit") && !is_file {
        return Err(section.wrong_table(
            "mesh_unit",
            "without a mesh".into(),
            "mesh_unit beside mesh alone".into(),
        ));
    }
    if edge_m.is_some() && is_phantom {
        let allowed = "tetrahedra = 6300 in it: how many there are says how long edges are".into();
        return Err(section.wrong_table("edge", "beside phantom".into(), allowed));
    }
    Ok(ShapeSource { shape, edge_m })
}

impl BodyShape {
    /// What messages call it.
    pub fn name(&self, folder: &Path) -> String {
        match self {
            Self::File { file, .. } => folder.join(file).display().to_string(),
            Self::Box { .. } => "the box".into(),
            Self::Ball { .. } => "the ball".into(),
            Self::Cylinder { .. } => "the cylinder".into(),
            Self::Tube { .. } => "the tube".into(),
            Self::Slab { .. } => "the slab".into(),
            Self::Phantom(organ) => format!("the {} of phantom {}", organ.organ.name(), organ.seed),
        }
    }
}

/// What may stand in place of a file.
const SOLIDS: [(&str, ReadSolid); 6] = [
    ("box", read_box),
    ("ball", read_ball),
    ("cylinder", read_cylinder),
    ("tube", read_tube),
    ("slab", read_slab),
    ("phantom", read_phantom),
];

type ReadSolid = fn(&mut Section<'_>) -> Result<BodyShape, SceneError>;

/// What the numbers in the mesh file are in: millimetres unless it is said.
fn read_mesh_unit(section: &mut Section<'_>) -> Result<LengthUnit, SceneError> {
    let Some((name, at)) = section.string("mesh_unit")? else { return Ok(LengthUnit::default()) };
    let allowed = LengthUnit::ALL.map(LengthUnit::name).join(", ");
    name.parse().map_err(|_| section.wrong_value(at, "mesh_unit", format!("\"{name}\""), &allowed))
}

fn read_box(table: &mut Section<'_>) -> Result<BodyShape, SceneError> {
    let min_m = table.required_point("min", "min = [\"-5 mm\", \"-5 mm\", \"0 mm\"]")?;
    let max_m = table.required_point("max", "max = [\"5 mm\", \"5 mm\", \"9 mm\"]")?;
    if min_m.cmpge(max_m).any() {
        let found = format!("{min_m} to {max_m} m");
        return Err(table.wrong_table("box", found, "min below max along every axis".into()));
    }
    Ok(BodyShape::Box { min_m, max_m })
}

fn read_ball(table: &mut Section<'_>) -> Result<BodyShape, SceneError> {
    let center_m = table.required_point("center", "center = [\"0 mm\", \"0 mm\", \"9 mm\"]")?;
    let radius_m = table.required_length("radius", "radius = \"20 mm\"")?;
    Ok(BodyShape::Ball { center_m, radius_m })
}

fn read_cylinder(table: &mut Section<'_>) -> Result<BodyShape, SceneError> {
    let from_m = table.required_point("from", "from = [\"0 mm\", \"0 mm\", \"0 mm\"]")?;
    let to_m = table.required_point("to", "to = [\"0 mm\", \"0 mm\", \"90 mm\"]")?;
    let radius_m = table.required_length("radius", "radius = \"20 mm\"")?;
    if from_m == to_m {
        return Err(table.wrong_table("cylinder", "without length".into(), "from and to apart".into()));
    }
    Ok(BodyShape::Cylinder { from_m, to_m, radius_m })
}

fn read_tube(table: &mut Section<'_>) -> Result<BodyShape, SceneError> {
    let stem = read_tube_path(table)?;
    let mut branches = Vec::new();
    for mut branch in table.sections("branches")? {
        branches.push(read_tube_path(&mut branch)?);
        branch.finish()?;
    }
    if branches.len() > MOST_BRANCHES {
        let (found, allowed) = (branches.len().to_string(), format!("at most {MOST_BRANCHES}"));
        return Err(table.wrong_table("branches", found, allowed));
    }
    Ok(BodyShape::Tube { stem, branches })
}

fn read_tube_path(table: &mut Section<'_>) -> Result<TubePath, SceneError> {
    const PATH: &str = "path = [[\"0 mm\", \"0 mm\", \"0 mm\"], [\"0 mm\", \"0 mm\", \"90 mm\"]]";
    const RADII: &str = "radii = [[\"9 mm\"], [\"5 mm\"]], one for each point of the path";
    let path_m = table.points("path", PATH)?.ok_or_else(|| table.missing("path", PATH))?;
    let radii = table.lengths("radii", (1..=1, RADII))?.ok_or_else(|| table.missing("radii", RADII))?;
    let radii_m = radii.concat();
    let is_still = path_m.windows(2).any(|pair| pair[0] == pair[1]);
    if !(2..=MOST_OF_TUBE).contains(&path_m.len()) || is_still || radii_m.len() != path_m.len() {
        let found = format!("a path of {} points with {} radii", path_m.len(), radii_m.len());
        let allowed =
            format!("2 to {MOST_OF_TUBE} points, each apart from the one before, and a radius for each");
        return Err(table.wrong_table("tube", found, allowed));
    }
    if radii_m.iter().any(|radius_m| *radius_m <= 0.0) {
        return Err(table.wrong_table("radii", "a radius of zero or less".into(), "more than zero".into()));
    }
    Ok(TubePath { path_m, radii_m })
}

fn read_slab(table: &mut Section<'_>) -> Result<BodyShape, SceneError> {
    let point_m = table.required_point("point", "point = [\"0 mm\", \"0 mm\", \"0 mm\"]")?;
    let normal = table.direction("normal")?.ok_or_else(|| table.missing("normal", "normal = [0, -1, 0]"))?;
    let size_m = table.required_length("size", "size = \"300 mm\"")?;
    let thickness_m = table.required_length("thickness", "thickness = \"20 mm\"")?;
    Ok(BodyShape::Slab { point_m, normal, size_m, thickness_m })
}

fn read_phantom(table: &mut Section<'_>) -> Result<BodyShape, SceneError> {
    let (name, at) = table.string("organ")?.ok_or_else(|| table.missing("organ", "organ = \"liver\""))?;
    let organ = tissue_named(table, "organ", &name, at)?;
    let seed = table.whole_number("seed", 0..=u64::from(u32::MAX))?.unwrap_or(1);
    let most = *TETRAHEDRA.end() as u64;
    let n_tetrahedra = table.whole_number("tetrahedra", *TETRAHEDRA.start() as u64..=most)?;
    let n_tetrahedra = n_tetrahedra.map_or(DEFAULT_TETRAHEDRA, |n| n as usize);
    let mut parts = Vec::new();
    if let Some((names, at)) = table.strings("parts")? {
        for name in names {
            let part = tissue_named(table, "parts", &name, at)?;
            if organ != Tissue::Liver || !INSIDE_LIVER.contains(&part) {
                let names = INSIDE_LIVER.map(Tissue::name).join(", ");
                let allowed = format!("what lies in the liver: {names}; the other organs have no parts");
                return Err(table.wrong_value(
                    at,
                    "parts",
                    format!("\"{}\" of the {}", part.name(), organ.name()),
                    &allowed,
                ));
            }
            parts.push(part);
        }
    }
    let vessels = table.flag("vessels")?.unwrap_or(false);
    if vessels && organ != Tissue::Liver {
        let allowed = "vessels = true with organ = \"liver\" alone: the others have none".into();
        return Err(table.wrong_table("vessels", format!("true for the {name}"), allowed));
    }
    let finer = table.section("finer")?.map(read_finer).transpose()?;
    Ok(BodyShape::Phantom(PhantomOrgan { organ, seed, n_tetrahedra, parts, has_vessels: vessels, finer }))
}

fn read_finer(mut table: Section<'_>) -> Result<FinerBall, SceneError> {
    let center_m = table.required_point("center", "center = [\"0 mm\", \"0 mm\", \"9 mm\"]")?;
    let radius_m = table.required_length("radius", "radius = \"30 mm\"")?;
    let (factor, at) = table.number("factor")?.ok_or_else(|| table.missing("factor", "factor = 2"))?;
    if !(1.0..=MAX_FINER).contains(&factor) {
        let allowed = format!("1 to {MAX_FINER}");
        return Err(table.wrong_value(at, "factor", factor.to_string(), &allowed));
    }
    table.finish()?;
    Ok(FinerBall { center_m, radius_m, factor })
}

pub(super) fn tissue_named(
    table: &Section<'_>,
    key: &'static str,
    name: &str,
    at: Value<'_>,
) -> Result<Tissue, SceneError> {
    let names = Tissue::ALL.map(Tissue::name);
    Tissue::ALL.into_iter().find(|tissue| tissue.name() == name).ok_or_else(|| {
        let allowed = format!("{}{}", names.join(", "), did_you_mean(name, &names));
        table.wrong_value(at, key, format!("\"{name}\""), &allowed)
    })
}

#[cfg(test)]
mod tests {
    use super::super::spec::Scene;
    use super::*;

    fn scene(shape: &str) -> Result<Scene, SceneError> {
        let tool = "[tool]\nhome_tip = [0, \"-9 cm\", 0]\nhome_shaft = [0, -1, 0]\ntip_radius = \"3 mm\"\n";
        let organ = "tissue = \"liver\"\nmodel = \"precomputed\"\n";
        Scene::parse(&format!("glisson_scene = 1\n[organ]\n{shape}\n{organ}{tool}"))
    }

    #[test]
    fn an_organ_of_the_phantom_needs_no_file() {
        let read = scene(
            "phantom = { organ = \"liver\", seed = 7, tetrahedra = 900, parts = [\"liver_tumour\"], vessels = true }",
        );
        let expected = PhantomOrgan {
            organ: Tissue::Liver,
            seed: 7,
            n_tetrahedra: 900,
            parts: vec![Tissue::LiverTumour],
            has_vessels: true,
            finer: None,
        };
        assert_eq!(read.unwrap().organ.shape.shape, BodyShape::Phantom(expected));
    }

    #[test]
    fn what_is_no_shape_is_refused_with_what_is() {
        for (shape, expected) in [
            ("", "[organ] lacks \"mesh\"; write for example mesh = \"liver.vtu\", or in its place box"),
            ("bxo = {}", "did you mean \"box\""),
            (
                "mesh = \"a.vtu\"\nball = { center = [0, 0, 0], radius = \"1 cm\" }",
                "exactly one of mesh, box",
            ),
            ("phantom = { organ = \"lever\" }", "did you mean \"liver\""),
            ("phantom = { organ = \"liver\", tetrahedra = 50 }", "a whole number from 200 to 200000"),
            ("phantom = { organ = \"liver\", seed = 1.5 }", "a whole number from 0 to"),
            ("phantom = { organ = \"spleen\", vessels = true }", "the others have none"),
            ("phantom = { organ = \"liver\", parts = [\"spleen\"] }", "what lies in the liver: liver_tumour"),
            (
                "phantom = { organ = \"spleen\", parts = [\"liver_tumour\"] }",
                "the other organs have no parts",
            ),
            ("phantom = { organ = \"liver\" }\nedge = \"5 mm\"", "beside phantom"),
            (
                "box = { min = [0, 0, 0], max = [\"1 cm\", \"1 cm\", \"1 cm\"] }\nmesh_unit = \"cm\"",
                "beside mesh alone",
            ),
            ("phantom = { organ = \"liver\", sed = 1 }", "did you mean \"seed\""),
        ] {
            let error = scene(shape).unwrap_err().to_string();
            assert!(error.contains(expected), "{shape}: {error}");
        }
    }
}
