//! `[organ]`: mesh, material, law, model, supports and loads.

use super::law::read_law;
use super::material::{MaterialSource, TissuePartSource, read_material, read_tissue_parts};
use super::reader::{SceneError, Section};
use super::region::read_region;
use super::shape::{ShapeSource, read_shape};
use super::vessel::read_vessels;
use super::when_cut::{WhenCut, read_when_cut, turns_hybrid};
use crate::image::vessels::Tube;
use crate::material::{LawChoice, PronyTerm};
use crate::model::hybrid::condensed::ZoneLaw;
use crate::model::kind::ModelKind;
use crate::model::nonlinear_tensor_mass::Fibre;
use crate::model::quasi_nonlinear::{GREATEST_DEGREE, LEAST_DEGREE};
use crate::model::{MeasuredSample, Rayleigh};
use crate::tool::fracture::FractureEnergy;
use crate::units::Dimension;
use crate::world::spec::{ForceField, Ligament, Load, LoadTime, Region, Support};
use std::path::PathBuf;

/// A zone of the hybrid model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrganZone {
    /// Its tetrahedra: those with all corners here that are in no zone before it.
    pub region: Region,
    /// What moves it at first.
    pub law: ZoneLaw,
}

/// Where an organ comes from and what moves it.
#[derive(Clone, Debug, PartialEq)]
pub struct OrganSource {
    /// Its mesh.
    pub shape: ShapeSource,
    /// Elasticity and density.
    pub material: MaterialSource,
    /// Parts of other tissue.
    pub tissue_parts: Vec<TissuePartSource>,
    /// Which law the models that have a choice follow; each its own when absent.
    pub law: Option<LawChoice>,
    /// Viscoelastic relaxation of the stress, for models that know it.
    pub relaxation: Vec<PronyTerm>,
    /// Stiffness along a direction, for models that know it.
    pub fibre: Option<Fibre>,
    /// Penalty on changes of volume [Pa], for models that know it; 0 is none.
    pub volume_penalty_pa: f64,
    /// Blood vessels in it, relative to the scene's folder; none when absent.
    pub vessels: Option<PathBuf>,
    /// Blood vessels that the scene itself describes.
    pub vessel_tubes: Vec<Tube>,
    /// What a crack in it takes; it does not tear when absent.
    pub tearing: Option<FractureEnergy>,
    /// Whether the mesh at a cut is mended when the blade is lifted.
    pub mends_cuts: bool,
    /// Which model moves it.
    pub model: ModelKind,
    /// A saved pre-computation, relative to the scene's folder; made anew at set-up when absent.
    pub precomputed: Option<PathBuf>,
    /// What becomes of it when blades divide it, if it is pre-computed and nothing was saved.
    pub when_cut: WhenCut,
    /// Damping; dynamic models only.
    pub damping: Rayleigh,
    /// The same of a hybrid that it is because instruments divide it: a choice, if the scene says nothing.
    pub damping_when_cut: Rayleigh,
    /// Whether the imaged shape is the one under the scene's gravity.
    pub is_imaged_under_gravity: bool,
    /// Zones of the hybrid model; what is in none of them is pre-computed.
    pub zones: Vec<OrganZone>,
    /// What the quasi non-linear model follows, its file relative to the scene's folder.
    pub measured: Option<MeasuredSample>,
}

/// Damping of the moving zones of a pre-computed organ that is a hybrid because blades divide it, if its scene gives none [1/s]: a
/// choice.
const DAMPING_WHEN_CUT_PER_S: f64 = 20.0;

impl OrganSource {
    /// Becomes what it is in a scene whose instruments divide it.
    pub(super) fn expect_blades(&mut self) {
        if turns_hybrid(self.model, self.when_cut) {
            self.model = ModelKind::Hybrid;
            self.damping = self.damping_when_cut;
        }
    }
}

/// What `[organ]` says about the world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OrganSurroundings {
    /// What holds it.
    pub supports: Vec<Support>,
    /// What ties it to its surroundings.
    pub ligaments: Vec<Ligament>,
    /// Forces on parts of it.
    pub loads: Vec<Load>,
    /// Accelerations of the whole.
    pub fields: Vec<ForceField>,
}

pub(super) fn read_organ(mut section: Section<'_>) -> Result<(OrganSource, OrganSurroundings), SceneError> {
    let shape = read_shape(&mut section)?;
    let material = read_material(&mut section)?;
    let names = ModelKind::ALL.map(ModelKind::name).join(", ");
    let (model_name, at) =
        section.string("model")?.ok_or_else(|| section.missing("model", "model = \"precomputed\""))?;
    let model = ModelKind::by_name(&model_name)
        .ok_or_else(|| section.wrong_value(at, "model", format!("\"{model_name}\""), &names))?;
    let law = read_law(&mut section, model)?;
    let tissue_parts = read_tissue_parts(&mut section, model)?;
    let relaxation = read_relaxation(&mut section)?;
    let fibre = section.section("fibre")?.map(read_fibre).transpose()?;
    let vessels = section.string("vessels")?.map(|p| PathBuf::from(p.0));
    let vessel_tubes = read_vessels(section.sections("vessel")?)?;
    let tearing = read_tearing(&mut section)?;
    if tearing.is_some() && !tissue_parts.is_empty() {
        let allowed = "one tissue: what a crack takes is known for the organ's own alone".into();
        return Err(section.wrong_table("part", "in an organ that tears".into(), allowed));
    }
    let mends_cuts = section.flag("mend_cuts")?.unwrap_or(false);
    let volume_penalty_pa = not_negative(&mut section, "volume_penalty", Dimension::Pressure)?;
    let precomputed = section.string("precomputed")?.map(|p| PathBuf::from(p.0));
    let when_cut = read_when_cut(&mut section, model, precomputed.is_some())?;
    let is_damping_said = section.has("damping") || section.has("stiffness_damping");
    let damping = Rayleigh {
        mass_per_s: not_negative(&mut section, "damping", Dimension::Rate)?,
        stiffness_s: not_negative(&mut section, "stiffness_damping", Dimension::Time)?,
    };
    let damping_when_cut = if is_damping_said { damping } else { Rayleigh::of_mass(DAMPING_WHEN_CUT_PER_S) };
    let is_imaged_under_gravity = section.flag("imaged_under_gravity")?.unwrap_or(true);
    let supports = section.sections("fixed")?.into_iter().map(read_support).collect::<Result<_, _>>()?;
    let ligaments = section.sections("ligament")?.into_iter().map(read_ligament).collect::<Result<_, _>>()?;
    let loads = section.sections("load")?.into_iter().map(read_load).collect::<Result<_, _>>()?;
    let zones = section.sections("zone")?.into_iter().map(read_zone).collect::<Result<_, _>>()?;
    let measured = section.section("measured")?.map(read_measured).transpose()?;
    let fields = section.sections("field")?.into_iter().map(read_field).collect::<Result<_, _>>()?;
    section.finish()?;
    let organ = OrganSource {
        shape,
        material,
        tissue_parts,
        law,
        relaxation,
        fibre,
        volume_penalty_pa,
        vessels,
        vessel_tubes,
        tearing,
        mends_cuts,
        model,
        precomputed,
        when_cut,
        damping,
        damping_when_cut,
        is_imaged_under_gravity,
        zones,
        measured,
    };
    Ok((organ, OrganSurroundings { supports, ligaments, loads, fields }))
}

/// `tearing = true`, and the energy of a crack; that of liver when the scene gives none.
fn read_tearing(section: &mut Section<'_>) -> Result<Option<FractureEnergy>, SceneError> {
    let tears = section.flag("tearing")?.unwrap_or(false);
    let given = section.positive("fracture_energy", Dimension::FractureEnergy)?;
    let energy = given.map_or(FractureEnergy::LIVER, |energy_j_per_m2| FractureEnergy { energy_j_per_m2 });
    Ok(tears.then_some(energy))
}

/// Degree of the fitted polynomials when the scene gives none, as of `glisson fit`.
const DEFAULT_DEGREE: usize = 6;

fn read_measured(mut section: Section<'_>) -> Result<MeasuredSample, SceneError> {
    let curve = section.string("curve")?.ok_or_else(|| section.missing("curve", "curve = \"brain.csv\""))?;
    let height_m = section
        .positive("height", Dimension::Length)?
        .ok_or_else(|| section.missing("height", "height = \"13 mm\""))?;
    let radius_m = section
        .positive("radius", Dimension::Length)?
        .ok_or_else(|| section.missing("radius", "radius = \"15 mm\""))?;
    let degree = section.whole_number("degree", LEAST_DEGREE as u64..=GREATEST_DEGREE as u64)?;
    let degree = degree.map_or(DEFAULT_DEGREE, |degree| degree as usize);
    section.finish()?;
    Ok(MeasuredSample { curve: curve.0.into(), height_m, radius_m, degree })
}

fn read_zone(mut section: Section<'_>) -> Result<OrganZone, SceneError> {
    let region = read_region(&mut section)?;
    let (name, at) =
        section.string("model")?.ok_or_else(|| section.missing("model", "model = \"tensor_mass\""))?;
    let law = match ModelKind::by_name(&name) {
        Some(ModelKind::Precomputed) => ZoneLaw::Precomputed,
        Some(ModelKind::TensorMass) => ZoneLaw::TensorMass,
        Some(ModelKind::NonlinearTensorMass) => ZoneLaw::NonlinearTensorMass,
        _ => {
            let allowed = "\"precomputed\", \"tensor_mass\" or \"nonlinear_tensor_mass\" in a zone";
            return Err(section.wrong_value(at, "model", format!("\"{name}\""), allowed));
        }
    };
    section.finish()?;
    Ok(OrganZone { region, law })
}

/// A quantity from zero; zero when it is not there.
fn not_negative(
    section: &mut Section<'_>,
    key: &'static str,
    dimension: Dimension,
) -> Result<f64, SceneError> {
    match section.quantity(key, dimension)? {
        Some((quantity, at)) if quantity < 0.0 => {
            let unit = dimension.units()[0].0;
            Err(section.wrong_value(at, key, format!("{quantity} {unit}"), "zero or more"))
        }
        found => Ok(found.map_or(0.0, |f| f.0)),
    }
}

fn read_relaxation(section: &mut Section<'_>) -> Result<Vec<PronyTerm>, SceneError> {
    let mut terms = Vec::new();
    let mut sum = 0.0;
    for mut term in section.sections("relaxation")? {
        let (share, at) = term.number("share")?.ok_or_else(|| term.missing("share", "share = 0.4"))?;
        sum += share;
        if share <= 0.0 || sum >= 1.0 {
            let allowed = "more than zero, all shares together below 1";
            return Err(term.wrong_value(at, "share", share.to_string(), allowed));
        }
        let time_s = term
            .positive("time", Dimension::Time)?
            .ok_or_else(|| term.missing("time", "time = \"0.5 s\""))?;
        term.finish()?;
        terms.push(PronyTerm { share, time_s });
    }
    Ok(terms)
}

fn read_fibre(mut section: Section<'_>) -> Result<Fibre, SceneError> {
    let example = "fibre = { direction = [1, 0, 0], lambda_along = \"20 kPa\", mu_along = \"8 kPa\" }";
    let direction = section.direction("direction")?.ok_or_else(|| section.missing("direction", example))?;
    let lambda_along = section.quantity("lambda_along", Dimension::Pressure)?;
    let (lambda_along_pa, _) = lambda_along.ok_or_else(|| section.missing("lambda_along", example))?;
    let mu_along_pa = section
        .positive("mu_along", Dimension::Pressure)?
        .ok_or_else(|| section.missing("mu_along", example))?;
    section.finish()?;
    Ok(Fibre { lambda_along_pa, mu_along_pa, direction })
}

fn read_support(mut section: Section<'_>) -> Result<Support, SceneError> {
    let region = read_region(&mut section)?;
    let names = section.names("axes", &["x", "y", "z"])?;
    section.finish()?;
    let axes = names.map_or([true; 3], |names| ["x", "y", "z"].map(|axis| names.contains(&axis)));
    Ok(Support { region, axes })
}

fn read_ligament(mut section: Section<'_>) -> Result<Ligament, SceneError> {
    let region = read_region(&mut section)?;
    let direction = section
        .direction("direction")?
        .ok_or_else(|| section.missing("direction", "direction = [0, 0, 1]"))?;
    let length_m = section
        .positive("length", Dimension::Length)?
        .ok_or_else(|| section.missing("length", "length = \"20 mm\""))?;
    let stiffness_n_per_m = section
        .positive("stiffness", Dimension::Stiffness)?
        .ok_or_else(|| section.missing("stiffness", "stiffness = \"200 N/m\""))?;
    section.finish()?;
    Ok(Ligament { region, direction, length_m, stiffness_n_per_m })
}

fn read_load(mut section: Section<'_>) -> Result<Load, SceneError> {
    let region = read_region(&mut section)?;
    let force_n = section
        .vector("force", Dimension::Force)?
        .ok_or_else(|| section.missing("force", "force = [\"0 N\", \"0.5 N\", \"0 N\"]"))?;
    let time = read_load_time(&mut section)?;
    section.finish()?;
    Ok(Load { region, force_n, time })
}

fn read_field(mut section: Section<'_>) -> Result<ForceField, SceneError> {
    let example = "acceleration = [\"0 m/s2\", \"0 m/s2\", \"2 m/s2\"]";
    let acceleration_m_per_s2 = section
        .vector("acceleration", Dimension::Acceleration)?
        .ok_or_else(|| section.missing("acceleration", example))?;
    let time = read_load_time(&mut section)?;
    section.finish()?;
    Ok(ForceField { acceleration_m_per_s2, time })
}

/// `at` for one step, `from` and `to` for a while, none of them for always.
fn read_load_time(section: &mut Section<'_>) -> Result<LoadTime, SceneError> {
    let at = section.quantity("at", Dimension::Time)?;
    let from = section.quantity("from", Dimension::Time)?;
    let to = section.quantity("to", Dimension::Time)?;
    for (key, (time_s, place)) in
        [("at", at), ("from", from), ("to", to)].into_iter().filter_map(|(k, v)| v.map(|v| (k, v)))
    {
        if time_s < 0.0 {
            return Err(section.wrong_value(place, key, format!("{time_s} s"), "zero or more"));
        }
    }
    match (at, from, to) {
        (None, None, None) => Ok(LoadTime::Always),
        (Some((at_s, _)), None, None) => Ok(LoadTime::Once(at_s)),
        (Some((at_s, place)), ..) => {
            let allowed = "at alone (one step), or from and to";
            Err(section.wrong_value(place, "at", format!("{at_s} s beside from or to"), allowed))
        }
        (None, from, to) => {
            let from_s = from.map_or(0.0, |f| f.0);
            let to_s = to.map_or(f64::INFINITY, |t| t.0);
            match to {
                Some((_, place)) if to_s <= from_s => {
                    Err(section.wrong_value(place, "to", format!("{to_s} s"), "later than from"))
                }
                _ => Ok(LoadTime::During { from_s, to_s }),
            }
        }
    }
}
