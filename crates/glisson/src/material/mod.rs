//! Constitutive laws and tissue parameters.
