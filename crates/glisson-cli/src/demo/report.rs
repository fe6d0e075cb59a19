//! The demo's report: what was made, how well, and what the probe felt; as Markdown and as JSON.

use super::operation::Palpation;
use super::scenery::Files;
use crate::text_file::write_text;
use glisson::image::files::{read_label_map, read_volume};
use glisson::image::labels::{Parts, dice, mask_volume_m3};
use glisson::mesh::files::read_mesh;
use glisson::mesh::quality::MeshQuality;
use glisson_picture::{SlicePlane, SliceSpec, slice_picture};
use glisson_report::plot::{LinePlot, Series, SeriesStyle};
use serde_json::json;

/// One command of the demo.
pub(crate) struct Stage {
    pub(crate) command: String,
    pub(crate) elapsed_s: f64,
}

/// Grey window that shows the liver and its vessels [HU]: centre, width.
const LIVER_WINDOW_HU: [f64; 2] = [80.0, 350.0];
const SLICE_HEIGHT: usize = 700;

/// What the images say.
struct ImageFigures {
    dice: f64,
    true_volume_m3: f64,
    segmented_volume_m3: f64,
}

/// Compares the segmentation with the truth, and draws one slice with the labels over it.
fn images(files: &Files) -> anyhow::Result<ImageFigures> {
    let ct = read_volume(&files.ct)?;
    let truth = read_label_map(&files.labels)?;
    let found = read_label_map(&files.liver_label)?;
    super::patient::draw(files, &truth)?;
    let true_liver = truth.mask(&truth.select("liver", Parts::Included)?);
    let found_liver = found.mask(&found.select("liver", Parts::Included)?);
    let inside = true_liver.iter().enumerate().filter(|(_, inside)| **inside);
    let (sum, n) = inside.fold((glam::DVec3::ZERO, 0.0), |(sum, n), (index, _)| {
        let [i, j, k] = truth.grid.voxel(index);
        (sum + truth.grid.position_m(glam::DVec3::new(i as f64, j as f64, k as f64)), n + 1.0)
    });
    for (plane, name) in [
        (SlicePlane::Axial, "0_ct_axial.png"),
        (SlicePlane::Coronal, "0_ct_coronal.png"),
        (SlicePlane::Sagittal, "0_ct_sagittal.png"),
    ] {
        let spec = |caption: &str| SliceSpec {
            plane,
            through_m: sum / n,
            window_centre_width: LIVER_WINDOW_HU,
            shown_labels: Vec::new(),
            height: SLICE_HEIGHT,
            caption: caption.into(),
        };
        let plain = slice_picture(&ct, None, &spec("synthetic CT"))?;
        let labelled = slice_picture(&ct, Some(&found), &spec("liver as segmented"))?;
        plain.beside(&labelled, 8, [0, 0, 0]).write_png(&files.folder.join(name))?;
    }
    Ok(ImageFigures {
        dice: dice(&true_liver, &found_liver),
        true_volume_m3: mask_volume_m3(&truth.grid, &true_liver),
        segmented_volume_m3: mask_volume_m3(&found.grid, &found_liver),
    })
}

fn force_plot(palpation: &Palpation) -> LinePlot {
    let series = |name: &str, value: &dyn Fn(&super::operation::Sample) -> f64| Series {
        name: name.into(),
        points: palpation.samples.iter().map(|s| [s.time_s, value(s)]).collect(),
        style: SeriesStyle::Line,
    };
    let end_s = palpation.samples.last().map_or(0.0, |s| s.time_s);
    LinePlot {
        title: "Force on the probe during the palpation".into(),
        x_label: "time [s]".into(),
        y_label: "force [N]".into(),
        series: vec![
            series("x (left)", &|s| s.force_n.x),
            series("y (posterior)", &|s| s.force_n.y),
            series("z (superior)", &|s| s.force_n.z),
            series("magnitude", &|s| s.force_n.length()),
            Series {
                name: "greatest".into(),
                points: vec![[0.0, palpation.greatest_force_n()], [end_s, palpation.greatest_force_n()]],
                style: SeriesStyle::Dashed,
            },
            Series {
                name: "pictures".into(),
                points: palpation.pictured.clone(),
                style: SeriesStyle::Points,
            },
        ],
        size: [900, 500],
    }
}

/// What the report tells.
struct DemoReport<'a> {
    stages: &'a [Stage],
    images: ImageFigures,
    quality: MeshQuality,
    palpation: &'a Palpation,
    deepest_m: f64,
    simulated_s: f64,
}

impl DemoReport<'_> {
    fn real_time_factor(&self) -> f64 {
        self.simulated_s / self.palpation.elapsed_s
    }

    fn to_json(&self) -> serde_json::Value {
        json!({
            "stages": self.stages.iter().map(|s| json!({"command": s.command, "elapsed_s": s.elapsed_s})).collect::<Vec<_>>(),
            "segmentation": {
                "dice": self.images.dice,
                "true_volume_m3": self.images.true_volume_m3,
                "segmented_volume_m3": self.images.segmented_volume_m3,
            },
            "mesh": &self.quality,
            "palpation": {
                "model": self.palpation.model,
                "material": self.palpation.material,
                "steps": self.palpation.steps,
                "simulated_s": self.simulated_s,
                "real_time_factor": self.real_time_factor(),
                "greatest_force_n": self.palpation.greatest_force_n(),
                "deepest_indentation_m": self.deepest_m,
                "state_hash": self.palpation.state_hash.to_string(),
                "replayed_state_hash": self.palpation.replayed_hash.to_string(),
            },
        })
    }

    /// The rows of the table: what, and its value.
    fn rows(&self) -> Vec<(&'static str, String)> {
        let ml = |volume_m3: f64| volume_m3 * 1e6;
        vec![
            ("liver in the true label map", format!("{:.1} ml", ml(self.images.true_volume_m3))),
            ("liver as segmented", format!("{:.1} ml", ml(self.images.segmented_volume_m3))),
            ("Dice of the two", format!("{:.4}", self.images.dice)),
            (
                "mesh",
                format!(
                    "{} tetrahedra, {} nodes, {:.1} ml",
                    self.quality.tetrahedra,
                    self.quality.nodes,
                    ml(self.quality.volume_m3)
                ),
            ),
            (
                "dihedral angles",
                format!(
                    "{:.1} to {:.1} degrees",
                    self.quality.min_dihedral_deg, self.quality.max_dihedral_deg
                ),
            ),
            ("surface's Euler characteristic", self.quality.surface_euler_characteristic.to_string()),
            ("material", self.palpation.material.clone()),
            ("model", self.palpation.model.to_string()),
            ("greatest force on the probe", format!("{:.2} N", self.palpation.greatest_force_n())),
            ("deepest indentation", format!("{:.1} mm", self.deepest_m * 1e3)),
            (
                "simulated",
                format!(
                    "{} steps, {:.2} s, {:.0} x real time",
                    self.palpation.steps,
                    self.simulated_s,
                    self.real_time_factor()
                ),
            ),
            ("state hash", format!("`{}`", self.palpation.state_hash)),
            ("state hash of the replay", format!("`{}`", self.palpation.replayed_hash)),
        ]
    }

    fn to_markdown(&self) -> String {
        let mut text = String::from("# From a synthetic patient's image to a palpated liver\n\n");
        text += "![The patient's organs](0_patient.png)\n![CT and segmentation, axial](0_ct_axial.png)\n![CT and segmentation, coronal](0_ct_coronal.png)\n![CT and segmentation, sagittal](0_ct_sagittal.png)\n\n";
        text += "| what | value |\n|---|---|\n";
        for (what, value) in self.rows() {
            text += &format!("| {what} | {value} |\n");
        }
        text += "\n";
        for picture in &self.palpation.pictures {
            let name = picture.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            text += &format!("![{name}]({name})\n");
        }
        text += "\n![Force](force_time.svg)\n![Mesh quality](quality.svg)\n\n## Commands\n\n```\n";
        for stage in self.stages {
            text += &format!("{}   # {:.1} s\n", stage.command, stage.elapsed_s);
        }
        text += "```\n";
        text
    }
}

/// Writes plot, slices, `report.md` and `report.json`.
pub(crate) fn write(files: &Files, stages: &[Stage], palpation: &Palpation) -> anyhow::Result<()> {
    let images = images(files)?;
    force_plot(palpation).write_svg(&files.force_plot)?;
    let (mesh, _) = read_mesh(&files.mesh)?;
    let report = DemoReport {
        stages,
        images,
        quality: MeshQuality::of(&mesh),
        palpation,
        deepest_m: palpation.samples.iter().map(|s| s.indentation_m).fold(0.0, f64::max),
        simulated_s: palpation.samples.last().map_or(0.0, |s| s.time_s),
    };
    write_text(&files.report_json, &(serde_json::to_string_pretty(&report.to_json())? + "\n"))?;
    write_text(&files.report_md, &report.to_markdown())
}
