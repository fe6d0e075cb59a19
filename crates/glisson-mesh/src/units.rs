//! Quantities with their units, read from text: `"5 kPa"`, `"2.5 mm"`, `"9.81 m/s2"`.
//!
//! A bare number is refused unless it is zero: guessing a unit is how simulations go wrong unseen. Files of shapes hold
//! bare numbers all the same: [`LengthUnit`] is what they are in, and [`likely_unit`] tells when that is improbable.

use std::fmt;
use std::str::FromStr;

use crate::text::did_you_mean;

/// What a number measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// Metres inside.
    Length,
    /// Pascals inside.
    Pressure,
    /// Newtons inside.
    Force,
    /// Seconds inside.
    Time,
    /// Kilograms per cubic metre inside.
    Density,
    /// Metres per second inside.
    Velocity,
    /// Metres per second squared inside.
    Acceleration,
    /// Radians inside.
    Angle,
    /// Reciprocal seconds inside.
    Rate,
    /// Newtons per metre inside.
    Stiffness,
    /// Watts inside.
    Power,
    /// Joules per square metre inside.
    FractureEnergy,
    /// Newton metres inside.
    Torque,
    /// Newton metres per radian inside.
    RotationalStiffness,
    /// Cubic metres inside.
    Volume,
    /// Cubic metres per second inside.
    VolumeFlow,
}

impl Dimension {
    /// Units that are understood, with their size in SI; the first is the SI unit.
    pub fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Length => &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6)],
            Self::Pressure => &[("Pa", 1.0), ("kPa", 1e3), ("MPa", 1e6), ("GPa", 1e9)],
            Self::Force => &[("N", 1.0), ("mN", 1e-3), ("kN", 1e3)],
            Self::Time => &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("min", 60.0)],
            Self::Density => &[("kg/m3", 1.0), ("g/cm3", 1e3)],
            Self::Velocity => &[("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3)],
            Self::Acceleration => &[("m/s2", 1.0), ("mm/s2", 1e-3)],
            Self::Angle => &[("rad", 1.0), ("deg", std::f64::consts::PI / 180.0)],
            Self::Rate => &[("1/s", 1.0), ("1/ms", 1e3)],
            Self::Stiffness => &[("N/m", 1.0), ("N/mm", 1e3)],
            Self::Power => &[("W", 1.0), ("mW", 1e-3)],
            Self::FractureEnergy => &[("J/m2", 1.0), ("kJ/m2", 1e3)],
            Self::Torque => &[("N m", 1.0), ("N mm", 1e-3)],
            Self::RotationalStiffness => &[("N m/rad", 1.0), ("N mm/rad", 1e-3)],
            Self::Volume => &[("m3", 1.0), ("ml", 1e-6), ("l", 1e-3)],
            Self::VolumeFlow => &[("m3/s", 1.0), ("ml/min", 1e-6 / 60.0), ("ml/s", 1e-6)],
        }
    }

    /// What the dimension is called in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Length => "length",
            Self::Pressure => "pressure",
            Self::Force => "force",
            Self::Time => "time",
            Self::Density => "density",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Angle => "angle",
            Self::Rate => "rate",
            Self::Stiffness => "stiffness",
            Self::Power => "power",
            Self::FractureEnergy => "fracture energy",
            Self::Torque => "torque",
            Self::RotationalStiffness => "rotational stiffness",
            Self::Volume => "volume",
            Self::VolumeFlow => "flow of a volume",
        }
    }
}

/// A quantity in the unit that people read it in: metres are shown in millimetres, cubic metres in millilitres, and so on.
/// A unit that is not known stays as it is.
pub fn for_people(value: f64, si_unit: &str) -> (f64, &str) {
    match si_unit {
        "m" => (1e3 * value, "mm"),
        "m2" => (1e4 * value, "cm2"),
        "m3" => (1e6 * value, "ml"),
        "m3/s" => (60e6 * value, "ml/min"),
        "rad" => (value.to_degrees(), "deg"),
        _ => (value, si_unit),
    }
}

/// Why a text is not a quantity.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UnitError {
    /// No number at the start.
    #[error("\"{found}\" does not start with a number; write for example \"{example}\"")]
    NoNumber {
        /// The text as found.
        found: String,
        /// One that would be right.
        example: String,
    },
    /// A number without a unit.
    #[error("\"{found}\" has no unit; write for example \"{example}\" (allowed units: {allowed})")]
    NoUnit {
        /// The text as found.
        found: String,
        /// The same number with a unit.
        example: String,
        /// The units of this dimension.
        allowed: String,
    },
    /// A unit of another dimension, or no unit at all.
    #[error("\"{unit}\" is not a unit of {dimension} (allowed: {allowed}){suggestion}")]
    UnknownUnit {
        /// The unit as found.
        unit: String,
        /// What is measured here.
        dimension: &'static str,
        /// The units of this dimension.
        allowed: String,
        /// `; did you mean ...` or nothing.
        suggestion: String,
    },
    /// Infinite or not a number.
    #[error("\"{found}\" is not a finite number")]
    NotFinite {
        /// The text as found.
        found: String,
    },
}

/// The value of `text` in SI.
///
/// # Errors
/// [`UnitError`] when there is no finite number, no unit, or a unit of another dimension.
pub fn parse_quantity(text: &str, dimension: Dimension) -> Result<f64, UnitError> {
    let trimmed = text.trim();
    let number_end = trimmed
        .char_indices()
        .find(|&(at, c)| {
            let exponent = (c == 'e' || c == 'E')
                && trimmed[at + 1..].starts_with(|d: char| d.is_ascii_digit() || d == '-' || d == '+');
            !(c.is_ascii_digit() || matches!(c, '.' | '-' | '+') || exponent)
        })
        .map_or(trimmed.len(), |(at, _)| at);
    let (number, unit) = (&trimmed[..number_end], trimmed[number_end..].trim());
    let units = dimension.units();
    let allowed = || units.iter().map(|u| u.0).collect::<Vec<_>>().join(", ");
    let Ok(value) = number.parse::<f64>() else {
        let example = format!("5 {}", units[0].0);
        return Err(UnitError::NoNumber { found: text.to_string(), example });
    };
    if !value.is_finite() {
        return Err(UnitError::NotFinite { found: text.to_string() });
    }
    if unit.is_empty() {
        if value == 0.0 {
            return Ok(0.0);
        }
        let example = format!("{number} {}", units[0].0);
        return Err(UnitError::NoUnit { found: text.to_string(), example, allowed: allowed() });
    }
    match units.iter().find(|u| u.0 == unit) {
        Some(&(_, size)) => Ok(value * size),
        None => Err(UnitError::UnknownUnit {
            unit: unit.to_string(),
            dimension: dimension.name(),
            allowed: allowed(),
            suggestion: did_you_mean(unit, &units.iter().map(|u| u.0).collect::<Vec<_>>()),
        }),
    }
}

/// Length unit of the numbers in a file: few formats say it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LengthUnit {
    /// Clinical tools.
    #[default]
    Millimetre,
    /// Older planning tools.
    Centimetre,
    /// Engineering tools.
    Metre,
    /// 25.4 mm: drawing programs.
    Inch,
}

impl LengthUnit {
    /// All units.
    pub const ALL: [Self; 4] = [Self::Millimetre, Self::Centimetre, Self::Metre, Self::Inch];

    /// The name: mm, cm, m or inch.
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Metre => "m",
            Self::Inch => "inch",
        }
    }

    /// A whole number and a power of ten, whose product is the unit in metres.
    pub fn decimal(self) -> (f64, i32) {
        match self {
            Self::Millimetre => (1.0, -3),
            Self::Centimetre => (1.0, -2),
            Self::Metre => (1.0, 0),
            Self::Inch => (254.0, -4),
        }
    }

    /// Size of the unit [m].
    pub fn size_m(self) -> f64 {
        match self {
            Self::Millimetre => 1e-3,
            Self::Centimetre => 1e-2,
            Self::Metre => 1.0,
            Self::Inch => 0.0254,
        }
    }

    /// Length [m] of so many of the unit. Powers of ten are exact numbers to divide by: that rounds once, and so the
    /// result is nearer than that of multiplying with [`LengthUnit::size_m`].
    pub fn to_metres(self, number: f64) -> f64 {
        match self {
            Self::Millimetre => number / 1e3,
            Self::Centimetre => number / 1e2,
            Self::Metre => number,
            Self::Inch => number * 254.0 / 1e4,
        }
    }
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for LengthUnit {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        let names = Self::ALL.map(Self::name);
        Self::ALL.into_iter().find(|unit| unit.name() == text).ok_or_else(|| UnitError::UnknownUnit {
            unit: text.to_string(),
            dimension: Dimension::Length.name(),
            allowed: names.join(", "),
            suggestion: did_you_mean(text, &names),
        })
    }
}

/// Volumes that an organ may have [m3]: 1 ml is less than an adrenal gland, 20 l more than any organ that has been
/// reported. A choice, wide enough that an organ read in its right unit is never suspicious.
const ORGAN_VOLUMES_M3: std::ops::RangeInclusive<f64> = 1e-6..=20e-3;

/// The volume nearest to which a guess has to come [m3], by ratio: a litre, which is between a kidney and a liver.
const USUAL_VOLUME_M3: f64 = 1e-3;

/// The unit that a file probably is in, if it gave an organ of `volume_m3` when it was read in `unit`: none if that
/// volume is one that an organ can have (1 ml to 20 l), or if no unit makes it one. Of several the one that comes nearest
/// to a litre by ratio. The volume of a surface that is inside out is below zero, which does not matter.
pub fn likely_unit(volume_m3: f64, unit: LengthUnit) -> Option<LengthUnit> {
    let volume_m3 = volume_m3.abs();
    if ORGAN_VOLUMES_M3.contains(&volume_m3) {
        return None;
    }
    let off = |volume_m3: f64| (volume_m3 / USUAL_VOLUME_M3).ln().abs();
    LengthUnit::ALL
        .into_iter()
        .map(|other| (volume_m3 * (other.size_m() / unit.size_m()).powi(3), other))
        .filter(|(volume_m3, _)| ORGAN_VOLUMES_M3.contains(volume_m3))
        .min_by(|(a, _), (b, _)| off(*a).total_cmp(&off(*b)))
        .map(|(_, other)| other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn quantities_become_si() {
        for (text, dimension, expected) in [
            ("5 kPa", Dimension::Pressure, 5000.0),
            ("2.5mm", Dimension::Length, 2.5e-3),
            ("-1e-2 m", Dimension::Length, -0.01),
            ("1060 kg/m3", Dimension::Density, 1060.0),
            ("1 ms", Dimension::Time, 1e-3),
            ("500 N mm", Dimension::Torque, 0.5),
            ("10 N m/rad", Dimension::RotationalStiffness, 10.0),
            ("180 deg", Dimension::Angle, std::f64::consts::PI),
            ("0", Dimension::Acceleration, 0.0),
        ] {
            let value = parse_quantity(text, dimension).unwrap();
            assert!((value - expected).abs() <= 1e-15 * expected.abs(), "{text}: {value}");
        }
    }

    #[test]
    fn mistakes_are_named() {
        let message = |text, dimension| parse_quantity(text, dimension).unwrap_err().to_string();
        assert!(message("5 kpa", Dimension::Pressure).contains("did you mean \"kPa\""));
        assert!(message("5", Dimension::Pressure).contains("has no unit"));
        assert!(message("5 mm", Dimension::Pressure).contains("not a unit of pressure"));
        assert!(message("soft", Dimension::Pressure).contains("does not start with a number"));
        assert!(message("1e999 m", Dimension::Length).contains("not a finite number"));
    }

    #[test]
    fn length_units_have_names_and_sizes() {
        for unit in LengthUnit::ALL {
            assert_eq!(unit.to_string().parse(), Ok(unit));
            let (factor, exponent) = unit.decimal();
            assert!((factor * 10f64.powi(exponent) - unit.size_m()).abs() < 1e-17);
            assert!((unit.to_metres(3.0) - 3.0 * unit.size_m()).abs() < 1e-15);
        }
        assert_eq!(LengthUnit::default(), LengthUnit::Millimetre);
        let message = "Inch".parse::<LengthUnit>().unwrap_err().to_string();
        assert!(message.contains("(allowed: mm, cm, m, inch); did you mean \"inch\"?"), "{message}");
    }

    #[test]
    fn an_organ_of_an_impossible_volume_has_a_likely_unit() {
        use LengthUnit::{Centimetre, Inch, Metre, Millimetre};
        // A liver of 0.9 l, in a file of one unit read in another.
        for (file, read, expected) in [
            (Millimetre, Millimetre, None),
            (Metre, Millimetre, Some(Metre)),
            (Centimetre, Millimetre, Some(Centimetre)),
            (Inch, Millimetre, Some(Inch)),
            (Millimetre, Metre, Some(Millimetre)),
            (Inch, Metre, Some(Inch)),
        ] {
            let volume_m3 = 0.9e-3 * (read.size_m() / file.size_m()).powi(3);
            assert_eq!(likely_unit(volume_m3, read), expected, "{file} read in {read}: {volume_m3} m3");
        }
        // Inches and centimetres both fit: the one nearer to a litre.
        assert_eq!(likely_unit(50e-9, Millimetre), Some(Inch));
        assert_eq!(likely_unit(-0.5e-6, Millimetre), Some(Centimetre));
        for nonsense in [0.0, f64::NAN, f64::INFINITY, 1e-30, 1e30] {
            assert_eq!(likely_unit(nonsense, Millimetre), None);
        }
        assert_eq!(likely_unit(-1e-3, Millimetre), None);
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in ".{0,12}") {
            let _ = parse_quantity(&text, Dimension::Length);
        }
    }
}
