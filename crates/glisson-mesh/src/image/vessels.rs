//! Trees of blood vessels as straight tubes, and their files.
//!
//! `vessels.csv`: first line `parent,from_x_m,from_y_m,from_z_m,to_x_m,to_y_m,to_z_m,from_radius_m,to_radius_m`, then one
//! tube a line; `parent` is the number of the tube that it branches from (lines count from 0, parents come first) or
//! empty for a root. Blood comes from the roots.

use crate::math::DVec3;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// One straight piece of a vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tube {
    /// The tube that it branches from, earlier in the list; none for a root.
    pub parent: Option<u32>,
    /// Ends of its axis [m], the first towards the root.
    pub ends_m: [DVec3; 2],
    /// Radii there [m].
    pub radii_m: [f64; 2],
}

impl Tube {
    /// The axis at the share `along` from the first end [m].
    pub fn point_m(&self, along: f64) -> DVec3 {
        self.ends_m[0].lerp(self.ends_m[1], along)
    }

    /// Diameter there [m].
    pub fn diameter_m(&self, along: f64) -> f64 {
        2.0 * (self.radii_m[0] + along * (self.radii_m[1] - self.radii_m[0]))
    }
}

/// What is wrong with a list of tubes.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TubeError {
    /// A parent that does not come earlier.
    #[error("names {parent} as the one it branches from; it must be an earlier one, numbered from 0")]
    Parent {
        /// What it names.
        parent: u32,
    },
    /// Ends that are not finite, or one point.
    #[error("has ends that are not two different finite points")]
    Ends,
    /// A radius that is not above 0.
    #[error("has a radius that is not a finite number above 0")]
    Radius,
}

/// Checks the tube that stands at `place` of its list.
///
/// # Errors
/// [`TubeError`].
pub fn check_tube(place: usize, tube: &Tube) -> Result<(), TubeError> {
    if let Some(parent) = tube.parent.filter(|&p| p as usize >= place) {
        return Err(TubeError::Parent { parent });
    }
    let [a, b] = tube.ends_m;
    if !(a.is_finite() && b.is_finite() && a.distance(b) > 0.0) {
        return Err(TubeError::Ends);
    }
    let is_radius = |r: &f64| r.is_finite() && *r > 0.0;
    if tube.radii_m.iter().all(is_radius) { Ok(()) } else { Err(TubeError::Radius) }
}

/// Why a file gives no vessels.
#[derive(Debug, thiserror::Error)]
pub enum VesselFileError {
    /// The file cannot be read.
    #[error("{}: {cause}", file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// Why.
        cause: io::Error,
    },
    /// It is no text.
    #[error("{}: not a text file (UTF-8)", file.display())]
    NotText {
        /// Which file.
        file: PathBuf,
    },
    /// The first line.
    #[error("{}:1: found `{found}`; expected the heading `{HEADING}`", file.display())]
    Heading {
        /// Which file.
        file: PathBuf,
        /// What stands there.
        found: String,
    },
    /// A line has not nine fields.
    #[error("{}:{line}: {found} fields; expected 9: {HEADING}", file.display())]
    Fields {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// How many.
        found: usize,
    },
    /// A field is no number.
    #[error("{}:{line}: `{found}` is no {expected}", file.display())]
    Number {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// The field.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// The tube makes no sense.
    #[error("{}:{line}: the tube {error}", file.display())]
    Tube {
        /// Which file.
        file: PathBuf,
        /// Line from 1.
        line: usize,
        /// What is wrong.
        error: TubeError,
    },
}

const HEADING: &str = "parent,from_x_m,from_y_m,from_z_m,to_x_m,to_y_m,to_z_m,from_radius_m,to_radius_m";

/// Reads `vessels.csv`.
///
/// # Errors
/// [`VesselFileError`] with file and line.
pub fn read_vessels(file: &Path) -> Result<Vec<Tube>, VesselFileError> {
    let bytes = std::fs::read(file).map_err(|cause| VesselFileError::Io { file: file.into(), cause })?;
    parse_vessels(file, &bytes)
}

/// The tubes of a file already read; `file` only names it in errors.
///
/// # Errors
/// [`VesselFileError`] with file and line.
pub fn parse_vessels(file: &Path, bytes: &[u8]) -> Result<Vec<Tube>, VesselFileError> {
    let text = std::str::from_utf8(bytes).map_err(|_| VesselFileError::NotText { file: file.into() })?;
    let mut lines = text.lines().enumerate();
    let heading = lines.next().map_or("", |(_, line)| line.trim());
    if heading != HEADING {
        let found = heading.chars().take(100).collect();
        return Err(VesselFileError::Heading { file: file.into(), found });
    }
    let mut tubes = Vec::new();
    for (at, text) in lines.filter(|(_, text)| !text.trim().is_empty()) {
        let line = at + 1;
        let fields: Vec<&str> = text.split(',').map(str::trim).collect();
        if fields.len() != 9 {
            return Err(VesselFileError::Fields { file: file.into(), line, found: fields.len() });
        }
        let bad = |found: &str, expected| VesselFileError::Number {
            file: file.into(),
            line,
            found: found.chars().take(40).collect(),
            expected,
        };
        let parent = match fields[0] {
            "" => None,
            number => Some(number.parse().map_err(|_| bad(number, "number of a tube, from 0"))?),
        };
        let mut numbers = [0.0; 8];
        for (number, field) in numbers.iter_mut().zip(&fields[1..]) {
            *number = field.parse().map_err(|_| bad(field, "number"))?;
        }
        let [a, b, c, d, e, f, from_radius_m, to_radius_m] = numbers;
        let ends_m = [DVec3::new(a, b, c), DVec3::new(d, e, f)];
        let tube = Tube { parent, ends_m, radii_m: [from_radius_m, to_radius_m] };
        check_tube(tubes.len(), &tube).map_err(|error| VesselFileError::Tube {
            file: file.into(),
            line,
            error,
        })?;
        tubes.push(tube);
    }
    Ok(tubes)
}

/// Writes `vessels.csv`; every number is read back with the same bits.
///
/// # Errors
/// Those of `out`.
pub fn write_vessels(out: &mut impl Write, tubes: &[Tube]) -> io::Result<()> {
    writeln!(out, "{HEADING}")?;
    for tube in tubes {
        let parent = tube.parent.map_or(String::new(), |p| p.to_string());
        let [a, b] = tube.ends_m;
        let [r, s] = tube.radii_m;
        writeln!(out, "{parent},{},{},{},{},{},{},{r},{s}", a.x, a.y, a.z, b.x, b.y, b.z)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tubes() -> Vec<Tube> {
        let fork = DVec3::new(0.02, 0.1 + 0.2, -1.0 / 3.0);
        vec![
            Tube { parent: None, ends_m: [DVec3::ZERO, fork], radii_m: [3e-3, 2e-3] },
            Tube { parent: Some(0), ends_m: [fork, DVec3::ONE], radii_m: [2e-3, 1e-3] },
        ]
    }

    fn text() -> Vec<u8> {
        let mut text = Vec::new();
        write_vessels(&mut text, &tubes()).unwrap();
        text
    }

    #[test]
    fn what_is_written_is_read_back() {
        assert_eq!(parse_vessels(Path::new("v.csv"), &text()).unwrap(), tubes());
    }

    #[test]
    fn errors_name_line_and_remedy() {
        let error = |from: &str, to: &str| {
            let text = String::from_utf8(text()).unwrap().replace(from, to);
            parse_vessels(Path::new("v.csv"), text.as_bytes()).unwrap_err().to_string()
        };
        assert!(error("parent,", "").starts_with("v.csv:1: found `from_x_m"));
        assert_eq!(
            error("\n0,0.02", "\n7,0.02"),
            "v.csv:3: the tube names 7 as the one it branches from; it must be an earlier one, numbered from 0"
        );
        assert_eq!(error("\n0,0.02", "\nx,0.02"), "v.csv:3: `x` is no number of a tube, from 0");
        assert_eq!(
            error(",0.002,0.001", ",0.002,-0.001"),
            "v.csv:3: the tube has a radius that is not a finite number above 0"
        );
        assert_eq!(
            error(",0.002,0.001", ",NaN,0.001"),
            "v.csv:3: the tube has a radius that is not a finite number above 0"
        );
        assert!(error(",0.002,0.001", "").contains("v.csv:3: 7 fields; expected 9"));
    }

    proptest! {
        #[test]
        fn mutated_files_give_tubes_or_errors(place in 0usize..300, byte: u8, cut in 0usize..300) {
            let mut text = text();
            let n = text.len();
            text[place % n] = byte;
            text.truncate(cut.max(1));
            if let Ok(tubes) = parse_vessels(Path::new("v.csv"), &text) {
                for (i, tube) in tubes.iter().enumerate() {
                    prop_assert!(check_tube(i, tube).is_ok());
                }
            }
        }
    }
}
