//! Lengths, pressures and other quantities with their units, read from text.
