//! All integration tests of the crate in one binary: it links once.

mod contours;
#[cfg(feature = "dicom")]
mod image_anonymize;
#[cfg(feature = "dicom")]
mod image_anonymize_pixels;
#[cfg(feature = "dicom")]
mod image_dicom;
#[cfg(feature = "dicom")]
mod image_dicom_stacks;
mod image_files;
mod image_nifti;
mod image_slices;
mod images;
mod mesh_edit_kinds;
mod mesh_edit_sequences;
mod mesh_edits;
mod mesh_file_samples;
mod mesh_files;
mod mesh_quality;
mod mesh_repair;
mod meshing;
mod organs;
mod sample_edits;
mod sample_images;
mod segmentation;
mod simplex;
mod simplex_fit;
mod surface_files;
mod surface_gltf;
mod surface_repair;
mod surfaces;
