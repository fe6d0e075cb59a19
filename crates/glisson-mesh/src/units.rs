//! Quantities with their units, read from text: `"5 kPa"`, `"2.5 mm"`, `"9.81 m/s2"`.
//!
//! A bare number is refused unless it is zero: guessing a unit is how simulations go wrong unseen.

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
        }
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

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in ".{0,12}") {
            let _ = parse_quantity(&text, Dimension::Length);
        }
    }
}
