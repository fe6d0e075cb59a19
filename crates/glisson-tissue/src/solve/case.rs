//! A static case as a folder of files, SI units: `nodes.csv` (x,y,z; the row is the node), `tets.csv` (four
//! nodes from 0), `dirichlet.csv` (node, component 0/1/2, displacement), `load.json` (E, nu, rho, gravity;
//! further keys are ignored). Results: `u.csv` and `reactions.csv`, one row of x,y,z per node, with as many
//! digits as the numbers have. Lines that start with `#` and empty lines are comments.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::BoundaryConditions;
use crate::material::{LinearElastic, MaterialError};
use glisson_mesh::files::write_atomically;
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Why a folder is no case.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// A file cannot be read or written.
    #[error("{}: {cause}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Bytes that are not text.
    #[error("{}: byte {byte} is not UTF-8 text", file.display())]
    NotText {
        /// Which file.
        file: PathBuf,
        /// Place of the first bad byte.
        byte: usize,
    },
    /// A line has too few or too many fields.
    #[error("{}:{line}: {found} fields, expected {expected}", file.display())]
    Fields {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// Number of fields.
        found: usize,
        /// What belongs there.
        expected: &'static str,
    },
    /// A field is not a number of the kind that belongs there.
    #[error("{}:{line}: `{found}` is not {expected}", file.display())]
    Number {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// The field, shortened.
        found: String,
        /// What belongs there.
        expected: &'static str,
    },
    /// A node number without a node.
    #[error("{}:{line}: node {found} does not exist; nodes.csv has {n_nodes} (numbered from 0)", file.display())]
    Node {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// The number.
        found: u32,
        /// Number of nodes.
        n_nodes: usize,
    },
    /// The same component twice with different values.
    #[error(
        "{}:{line}: component {axis} of node {node} is prescribed twice: {first} m, then {second} m", file.display()
    )]
    PrescribedTwice {
        /// Which file.
        file: PathBuf,
        /// Line of the second, from 1.
        line: usize,
        /// Which node.
        node: u32,
        /// Which component.
        axis: usize,
        /// First value [m].
        first: f64,
        /// Second value [m].
        second: f64,
    },
    /// `load.json` is not what it should be.
    #[error("{}: {cause}; expected {{\"E\": Pa, \"nu\": number, \"rho\": kg/m3, \"gravity\": [x, y, z] m/s2}}", file.display())]
    Json {
        /// Which file.
        file: PathBuf,
        /// What is wrong, with line and column.
        cause: serde_json::Error,
    },
    /// The gravity is not finite.
    #[error("{}: gravity is not finite", file.display())]
    Gravity {
        /// Which file.
        file: PathBuf,
    },
    /// The material is impossible.
    #[error("{}: {cause}", file.display())]
    Material {
        /// Which file.
        file: PathBuf,
        /// Why.
        cause: MaterialError,
    },
}

/// A static case.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticCase {
    /// The body at rest.
    pub mesh: TetMesh,
    /// What is held where.
    pub conditions: BoundaryConditions,
    /// Its material.
    pub material: LinearElastic,
    /// Gravity [m/s2].
    pub gravity_m_per_s2: DVec3,
}

#[derive(serde::Deserialize)]
struct Load {
    #[serde(rename = "E")]
    young_modulus_pa: f64,
    nu: f64,
    #[serde(rename = "rho")]
    density_kg_per_m3: f64,
    #[serde(rename = "gravity")]
    gravity_m_per_s2: [f64; 3],
}

/// Contents of the four files of a case.
#[derive(Clone, Debug, Default)]
pub struct CaseBytes {
    /// `nodes.csv`
    pub nodes: Vec<u8>,
    /// `tets.csv`
    pub tets: Vec<u8>,
    /// `dirichlet.csv`
    pub dirichlet: Vec<u8>,
    /// `load.json`
    pub load: Vec<u8>,
}

/// Reads the case in `folder`.
///
/// # Errors
/// [`CaseError`] with file and line.
pub fn read_case(folder: &Path) -> Result<StaticCase, CaseError> {
    let read = |name: &str| {
        let file = folder.join(name);
        std::fs::read(&file).map_err(|cause| CaseError::Io { file, cause })
    };
    let bytes = CaseBytes {
        nodes: read("nodes.csv")?,
        tets: read("tets.csv")?,
        dirichlet: read("dirichlet.csv")?,
        load: read("load.json")?,
    };
    parse_case(folder, &bytes)
}

/// The case of files already read; `folder` only names them in errors.
///
/// # Errors
/// [`CaseError`] with file and line.
pub fn parse_case(folder: &Path, bytes: &CaseBytes) -> Result<StaticCase, CaseError> {
    let positions_m = parse_vectors(&folder.join("nodes.csv"), &bytes.nodes)?;
    let n_nodes = positions_m.len();

    let file = folder.join("tets.csv");
    let mut tetrahedra = Vec::new();
    for (line, fields) in rows::<4>(&file, &bytes.tets, "n0,n1,n2,n3")? {
        let mut nodes = [NodeId(0); 4];
        for (node, field) in nodes.iter_mut().zip(fields) {
            *node = parse_node(&file, line, field, n_nodes)?;
        }
        tetrahedra.push(nodes);
    }

    let file = folder.join("dirichlet.csv");
    let mut conditions = BoundaryConditions::new();
    let mut seen = std::collections::BTreeMap::new();
    for (line, [node, axis, value]) in rows::<3>(&file, &bytes.dirichlet, "node,component,displacement")? {
        let node = parse_node(&file, line, node, n_nodes)?;
        let axis_number: usize = match axis {
            "0" => 0,
            "1" => 1,
            "2" => 2,
            _ => return Err(bad_number(&file, line, axis, "a component: 0 (x), 1 (y) or 2 (z)")),
        };
        let second = parse_finite(&file, line, value)?;
        if let Some(first) = seen.insert((node, axis_number), second)
            && first != second
        {
            let (node, axis) = (node.0, axis_number);
            return Err(CaseError::PrescribedTwice { file, line, node, axis, first, second });
        }
        conditions.impose(node, axis_number, second);
    }

    let file = folder.join("load.json");
    let load: Load =
        serde_json::from_slice(&bytes.load).map_err(|cause| CaseError::Json { file: file.clone(), cause })?;
    let material = LinearElastic::from_young_poisson(load.young_modulus_pa, load.nu, load.density_kg_per_m3)
        .map_err(|cause| CaseError::Material { file: file.clone(), cause })?;
    let gravity_m_per_s2 = DVec3::from_array(load.gravity_m_per_s2);
    if !gravity_m_per_s2.is_finite() {
        return Err(CaseError::Gravity { file });
    }
    Ok(StaticCase {
        mesh: TetMesh { positions_m, tetrahedra, ..TetMesh::default() },
        conditions,
        material,
        gravity_m_per_s2,
    })
}

/// Rows of three finite numbers.
///
/// # Errors
/// [`CaseError`] with file and line.
pub fn parse_vectors(file: &Path, bytes: &[u8]) -> Result<Vec<DVec3>, CaseError> {
    rows::<3>(file, bytes, "x,y,z")?
        .into_iter()
        .map(|(line, [x, y, z])| {
            Ok(DVec3::new(
                parse_finite(file, line, x)?,
                parse_finite(file, line, y)?,
                parse_finite(file, line, z)?,
            ))
        })
        .collect()
}

/// Writes rows x,y,z under a comment line; reading them back gives the same bits.
///
/// # Errors
/// [`CaseError::Io`]; the old file then remains.
pub fn write_vectors(file: &Path, comment: &str, vectors: &[DVec3]) -> Result<(), CaseError> {
    write_atomically(file, |w| {
        writeln!(w, "# {comment}")?;
        for v in vectors {
            writeln!(w, "{:e},{:e},{:e}", v.x, v.y, v.z)?;
        }
        Ok(())
    })
    .map_err(|cause| CaseError::Io { file: file.to_owned(), cause })
}

/// Line numbers and fields of the lines that are no comment.
fn rows<'a, const N: usize>(
    file: &Path,
    bytes: &'a [u8],
    expected: &'static str,
) -> Result<Vec<(usize, [&'a str; N])>, CaseError> {
    let text = std::str::from_utf8(bytes)
        .map_err(|e| CaseError::NotText { file: file.to_owned(), byte: e.valid_up_to() })?;
    let mut rows = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut fields = [""; N];
        let mut found = 0;
        for field in line.split(',') {
            if let Some(place) = fields.get_mut(found) {
                *place = field.trim();
            }
            found += 1;
        }
        if found != N {
            return Err(CaseError::Fields { file: file.to_owned(), line: index + 1, found, expected });
        }
        rows.push((index + 1, fields));
    }
    Ok(rows)
}

fn bad_number(file: &Path, line: usize, field: &str, expected: &'static str) -> CaseError {
    let found = field.chars().take(40).collect();
    CaseError::Number { file: file.to_owned(), line, found, expected }
}

fn parse_finite(file: &Path, line: usize, field: &str) -> Result<f64, CaseError> {
    match field.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(bad_number(file, line, field, "a finite number")),
    }
}

fn parse_node(file: &Path, line: usize, field: &str, n_nodes: usize) -> Result<NodeId, CaseError> {
    let found: u32 =
        field.parse().map_err(|_| bad_number(file, line, field, "a node number (a whole number from 0)"))?;
    if (found as usize) < n_nodes {
        Ok(NodeId(found))
    } else {
        Err(CaseError::Node { file: file.to_owned(), line, found, n_nodes })
    }
}
