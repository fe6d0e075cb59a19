//! Measured curves as text: comma-separated columns under a line of names, `#` before comments.
//!
//! `axial_displacement_mm` (or `_m`), and `force_n` (or `_mn`), `radial_displacement_mm` (or `_m`), or both, in any order.
//! Compression, the force against it and outward bulging are positive.

use std::path::{Path, PathBuf};

use glisson_mesh::text::did_you_mean;

/// Why a file cannot be read as a curve.
#[derive(Debug, thiserror::Error)]
pub enum CurveError {
    /// The file cannot be read.
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
    /// No line of names.
    #[error("{}: no line of column names; allowed: {NAMES}", file.display())]
    NoHeader {
        /// Which file.
        file: PathBuf,
    },
    /// A name that is no column.
    #[error("{}:{line}: column {column} is called `{found}`; allowed: {NAMES}{hint}", file.display())]
    Name {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// Column from 1.
        column: usize,
        /// The name, shortened.
        found: String,
        /// What was probably meant.
        hint: String,
    },
    /// A quantity twice.
    #[error("{}:{line}: column {column} gives the {quantity} a second time: remove one", file.display())]
    Repeated {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// Column from 1.
        column: usize,
        /// Which quantity.
        quantity: &'static str,
    },
    /// Nothing to fit.
    #[error("{}:{line}: no column of {missing}; allowed: {NAMES}", file.display())]
    Missing {
        /// Which file.
        file: PathBuf,
        /// Line of the names, from 1.
        line: usize,
        /// What is missing.
        missing: &'static str,
    },
    /// A line has too few or too many fields.
    #[error("{}:{line}: {found} fields, but line {header} names {expected} columns", file.display())]
    Fields {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// Number of fields.
        found: usize,
        /// Number of names.
        expected: usize,
        /// Line of the names.
        header: usize,
    },
    /// A field is no number.
    #[error("{}:{line}: column {column} ({name}): `{found}` is not a finite number", file.display())]
    Number {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// Column from 1.
        column: usize,
        /// Its name.
        name: &'static str,
        /// The field, shortened.
        found: String,
    },
}

/// The column names that messages list.
const NAMES: &str =
    "axial_displacement_mm (or _m) with force_n (or _mn), radial_displacement_mm (or _m), or both";

#[derive(Clone, Copy, PartialEq)]
enum Quantity {
    Axial,
    Force,
    Radial,
}

/// Name, quantity, unit in SI.
const COLUMNS: [(&str, Quantity, f64); 6] = [
    ("axial_displacement_mm", Quantity::Axial, 1e-3),
    ("axial_displacement_m", Quantity::Axial, 1.0),
    ("force_n", Quantity::Force, 1.0),
    ("force_mn", Quantity::Force, 1e-3),
    ("radial_displacement_mm", Quantity::Radial, 1e-3),
    ("radial_displacement_m", Quantity::Radial, 1.0),
];

impl Quantity {
    fn name(self) -> &'static str {
        match self {
            Self::Axial => "axial displacement",
            Self::Force => "force",
            Self::Radial => "radial displacement",
        }
    }
}

/// A sample's measured response to compression. A list that was not measured is empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredCurve {
    /// Shortening of the sample [m].
    pub axial_displacement_m: Vec<f64>,
    /// Force on its top [N]; one per shortening, or none.
    pub force_n: Vec<f64>,
    /// Increase of its radius at mid-height [m]; one per shortening, or none.
    pub radial_displacement_m: Vec<f64>,
}

impl MeasuredCurve {
    /// Reads a file.
    ///
    /// # Errors
    /// [`CurveError`] with file, line and column.
    pub fn read(file: &Path) -> Result<Self, CurveError> {
        let bytes = std::fs::read(file).map_err(|cause| CurveError::Io { file: file.to_owned(), cause })?;
        Self::parse(file, &bytes)
    }

    /// Reads the bytes of a file; `file` is for messages only.
    ///
    /// # Errors
    /// [`CurveError`] with file, line and column.
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, CurveError> {
        let text = std::str::from_utf8(bytes)
            .map_err(|e| CurveError::NotText { file: file.to_owned(), byte: e.valid_up_to() })?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let Some((header, names)) = lines.next() else {
            return Err(CurveError::NoHeader { file: file.to_owned() });
        };
        let columns = parse_names(file, header, names)?;
        let mut curve = Self::default();
        for (line, text) in lines {
            let found = text.split(',').count();
            if found != columns.len() {
                let (file, expected) = (file.to_owned(), columns.len());
                return Err(CurveError::Fields { file, line, found, expected, header });
            }
            for (place, (field, &(name, quantity, unit))) in text.split(',').zip(&columns).enumerate() {
                let field = field.trim();
                let value = field.parse::<f64>().ok().map(|v| v * unit).filter(|v| v.is_finite());
                let value = value.ok_or_else(|| CurveError::Number {
                    file: file.to_owned(),
                    line,
                    column: place + 1,
                    name,
                    found: shortened(field),
                })?;
                match quantity {
                    Quantity::Axial => curve.axial_displacement_m.push(value),
                    Quantity::Force => curve.force_n.push(value),
                    Quantity::Radial => curve.radial_displacement_m.push(value),
                }
            }
        }
        Ok(curve)
    }
}

type Column = (&'static str, Quantity, f64);

fn parse_names(file: &Path, line: usize, names: &str) -> Result<Vec<Column>, CurveError> {
    let mut columns: Vec<Column> = Vec::new();
    for (place, name) in names.split(',').map(str::trim).enumerate() {
        let column = place + 1;
        let Some(&known) = COLUMNS.iter().find(|c| c.0 == name) else {
            let hint = did_you_mean(&shortened(name), &COLUMNS.map(|c| c.0));
            return Err(CurveError::Name {
                file: file.to_owned(),
                line,
                column,
                found: shortened(name),
                hint,
            });
        };
        if columns.iter().any(|c| c.1 == known.1) {
            let (file, quantity) = (file.to_owned(), known.1.name());
            return Err(CurveError::Repeated { file, line, column, quantity });
        }
        columns.push(known);
    }
    let has = |quantity| columns.iter().any(|c| c.1 == quantity);
    let missing = if !has(Quantity::Axial) {
        "axial displacement"
    } else if !has(Quantity::Force) && !has(Quantity::Radial) {
        "force or radial displacement"
    } else {
        return Ok(columns);
    };
    Err(CurveError::Missing { file: file.to_owned(), line, missing })
}

fn shortened(field: &str) -> String {
    field.chars().take(40).collect()
}
