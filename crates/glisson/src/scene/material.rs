//! What an organ is made of: its tissue, and parts of other tissue in it.

use super::reader::{SceneError, Section};
use super::region::read_region;
use crate::model::kind::ModelKind;
use crate::units::Dimension;
use crate::world::spec::Region;

/// Where an organ's elasticity comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum MaterialSource {
    /// A row of the table of tissues.
    Tissue(String),
    /// Numbers of the scene.
    Given {
        /// Young's modulus [Pa].
        young_modulus_pa: f64,
        /// Poisson's ratio.
        poisson_ratio: f64,
        /// Density [kg/m3].
        density_kg_per_m3: f64,
    },
}

/// Where a part's elasticity comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum ElasticitySource {
    /// A row of the table of tissues.
    Tissue(String),
    /// Numbers of the scene.
    Given {
        /// Young's modulus [Pa].
        young_modulus_pa: f64,
        /// Poisson's ratio.
        poisson_ratio: f64,
    },
}

/// Which tetrahedra are of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PartPlace {
    /// Those with this label in the mesh's file.
    Label(i64),
    /// Those with their middle in this region, at rest.
    Region(Region),
}

/// A part of an organ that is of other tissue: a tumour, say. Its density is the organ's.
#[derive(Clone, Debug, PartialEq)]
pub struct TissuePartSource {
    /// Which tetrahedra.
    pub place: PartPlace,
    /// Its elasticity.
    pub elasticity: ElasticitySource,
}

fn read_elasticity(
    section: &mut Section<'_>,
    may_have_density: bool,
) -> Result<ElasticitySource, SceneError> {
    let tissue = section.string("tissue")?;
    let young = section.positive("young_modulus", Dimension::Pressure)?;
    let poisson = section.number("poisson_ratio")?;
    let lame_lambda = section.quantity("lame_lambda", Dimension::Pressure)?;
    let lame_mu = section.positive("lame_mu", Dimension::Pressure)?;
    let has_density = may_have_density && section.has("density");
    let given = [young.is_some(), poisson.is_some(), lame_lambda.is_some(), lame_mu.is_some(), has_density];
    if let Some((name, at)) = tissue {
        if given.contains(&true) {
            let allowed = if may_have_density {
                "a tissue alone, or young_modulus, poisson_ratio and density without a tissue"
            } else {
                "a tissue alone, or young_modulus and poisson_ratio without a tissue"
            };
            return Err(section.wrong_value(
                at,
                "tissue",
                format!("\"{name}\" beside its own numbers"),
                allowed,
            ));
        }
        return Ok(ElasticitySource::Tissue(name));
    }
    if lame_lambda.is_none() && lame_mu.is_some() {
        return Err(section.missing("lame_lambda", "lame_lambda = \"12.5 kPa\""));
    }
    if let Some((lambda_pa, at)) = lame_lambda {
        let mu_pa = lame_mu.ok_or_else(|| section.missing("lame_mu", "lame_mu = \"2 kPa\""))?;
        if young.is_some() || poisson.is_some() {
            let allowed = "lame_lambda and lame_mu, or young_modulus and poisson_ratio";
            return Err(section.wrong_value(
                at,
                "lame_lambda",
                "beside young_modulus or poisson_ratio".into(),
                allowed,
            ));
        }
        // Positive energy for every strain (LinearElastic::from_lame).
        if 3.0 * lambda_pa + 2.0 * mu_pa <= 0.0 {
            let allowed = "more than -2/3 of lame_mu";
            return Err(section.wrong_value(at, "lame_lambda", format!("{lambda_pa} Pa"), allowed));
        }
        return Ok(ElasticitySource::Given {
            young_modulus_pa: mu_pa * (3.0 * lambda_pa + 2.0 * mu_pa) / (lambda_pa + mu_pa),
            poisson_ratio: lambda_pa / (2.0 * (lambda_pa + mu_pa)),
        });
    }
    let young_modulus_pa = young.ok_or_else(|| {
        section.missing("young_modulus", "young_modulus = \"5 kPa\" (or tissue = \"liver\")")
    })?;
    let (poisson_ratio, at) =
        poisson.ok_or_else(|| section.missing("poisson_ratio", "poisson_ratio = 0.45"))?;
    if !(poisson_ratio > -1.0 && poisson_ratio < 0.5) {
        let allowed = "more than -1 and less than 0.5 (a tissue that keeps its volume: 0.45 to 0.49)";
        return Err(section.wrong_value(at, "poisson_ratio", poisson_ratio.to_string(), allowed));
    }
    Ok(ElasticitySource::Given { young_modulus_pa, poisson_ratio })
}

pub(super) fn read_material(section: &mut Section<'_>) -> Result<MaterialSource, SceneError> {
    let elasticity = read_elasticity(section, true)?;
    let density = section.positive("density", Dimension::Density)?;
    Ok(match elasticity {
        ElasticitySource::Tissue(name) => MaterialSource::Tissue(name),
        ElasticitySource::Given { young_modulus_pa, poisson_ratio } => {
            let density_kg_per_m3 =
                density.ok_or_else(|| section.missing("density", "density = \"1060 kg/m3\""))?;
            MaterialSource::Given { young_modulus_pa, poisson_ratio, density_kg_per_m3 }
        }
    })
}

/// `[[organ.part]]`.
pub(super) fn read_tissue_parts(
    section: &mut Section<'_>,
    model: ModelKind,
) -> Result<Vec<TissuePartSource>, SceneError> {
    let mut parts: Vec<TissuePartSource> = Vec::new();
    for mut part in section.sections("part")? {
        if !model.row().has_tissue_parts {
            let with_parts = ModelKind::ALL.into_iter().filter(|kind| kind.row().has_tissue_parts);
            let allowed = with_parts.map(|kind| format!("\"{kind}\"")).collect::<Vec<_>>().join(", ");
            let found = format!("of an organ with the model \"{model}\"");
            return Err(part.wrong_table("part", found, format!("organs with one of the models {allowed}")));
        }
        let place = match part.number("label")? {
            Some((label, at)) => {
                let is_known = parts.iter().any(|other| other.place == PartPlace::Label(label as i64));
                if label.fract() != 0.0 || label.abs() > MOST_LABEL || is_known {
                    let allowed = "a whole number that the cell field `label` of the mesh has, once";
                    return Err(part.wrong_value(at, "label", label.to_string(), allowed));
                }
                PartPlace::Label(label as i64)
            }
            None if ["box", "ball", "furthest"].iter().any(|key| part.has(key)) => {
                PartPlace::Region(read_region(&mut part)?)
            }
            None => return Err(part.missing("label", "label = 2 (or a region: box, ball)")),
        };
        let elasticity = read_elasticity(&mut part, false)?;
        part.finish()?;
        parts.push(TissuePartSource { place, elasticity });
    }
    Ok(parts)
}

/// Beyond this a number of the scene is not every whole number.
const MOST_LABEL: f64 = 9e15;
