//! Why organs cannot be meshed together.

use crate::image::labels::LabelError;

/// Why a label map cannot be meshed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OrganMeshError {
    /// The map's labels do not fill its grid.
    #[error(
        "the label map has {found} labels, but its grid has {allowed} voxels: one label a voxel is needed"
    )]
    BadMap {
        /// Labels of the map.
        found: usize,
        /// Voxels of its grid.
        allowed: usize,
    },
    /// No voxel has a label.
    #[error("the label map has no labels: every voxel is 0 (outside), at least one label is needed")]
    NoLabels,
    /// A label was asked for that no voxel has.
    #[error("no voxel has label {label}; the labels of the map are {available:?}")]
    UnknownLabel {
        /// The label asked for.
        label: u16,
        /// Labels of the map.
        available: Vec<u16>,
    },
    /// An organ is cut off by the end of the image.
    #[error("label {label}: {cut_off}")]
    Border {
        /// Which label.
        label: u16,
        /// Where it touches the border.
        cut_off: LabelError,
    },
    /// A size that is no size.
    #[error("{what} is {found}: {allowed} is allowed")]
    BadParameter {
        /// Which parameter.
        what: &'static str,
        /// Its value.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// The cells would be too many.
    #[error(
        "cells of {cell_mm} mm would give {estimated} tetrahedra or more for {volume_ml} ml, at most {allowed} are \
         allowed: take cells of at least {least_cell_mm:.3} mm"
    )]
    TooMany {
        /// Lattice cell [mm].
        cell_mm: f64,
        /// Volume of all organs [ml].
        volume_ml: f64,
        /// Number of tetrahedra that are certain.
        estimated: u64,
        /// Largest number allowed.
        allowed: usize,
        /// Smallest cell that would do [mm].
        least_cell_mm: f64,
    },
    /// Smaller cells in places would be too many.
    #[error(
        "cells of {cell_mm} mm that are smaller in places take more than {allowed} tetrahedra on the way for {volume_ml} ml: take \
         larger cells, or let fewer places have smaller ones, or not so much smaller"
    )]
    TooFine {
        /// The largest lattice cell [mm].
        cell_mm: f64,
        /// Volume of all organs [ml].
        volume_ml: f64,
        /// Largest number allowed.
        allowed: usize,
    },
    /// The lattice over all organs would be too large.
    #[error(
        "the box around all labels would take {estimated} lattice nodes at cells of {cell_mm} mm, at most {allowed} are \
         allowed: take cells of at least {least_cell_mm:.3} mm or fewer labels"
    )]
    LatticeTooLarge {
        /// Lattice cell [mm].
        cell_mm: f64,
        /// Lattice nodes.
        estimated: u64,
        /// Largest number allowed.
        allowed: u64,
        /// Smallest cell that would do [mm].
        least_cell_mm: f64,
    },
    /// An organ fell through the lattice.
    #[error(
        "label {label} ({n_voxels} voxels, {volume_ml:.3} ml) gets no tetrahedron at cells of {cell_mm:.3} mm: it is thinner \
         than about one cell everywhere; take smaller cells or leave the label out"
    )]
    Vanished {
        /// Which label.
        label: u16,
        /// Its voxels.
        n_voxels: usize,
        /// Their volume [ml].
        volume_ml: f64,
        /// Lattice cell [mm].
        cell_mm: f64,
    },
}
