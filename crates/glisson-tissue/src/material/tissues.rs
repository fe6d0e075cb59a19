//! Elastic parameters of tissues, each with its source, its test condition and its range.
//!
//! A number without a source is absent (`None`), never guessed. Poisson's ratio is the exception that is
//! named as such: soft tissue is measured as incompressible (nu = 0.5), which linear tetrahedra cannot
//! follow, and [`MODELLING_POISSON_RATIO`] is the choice of seed `003` s. 2.4.
//! Tissue stiffness differs between people, states and test methods by factors, not by per cent: the ranges
//! are those of the one source named, not of the literature.

use super::{LinearElastic, MaterialError};
use glisson_mesh::text::closest_name;

/// Poisson's ratio that every tissue of the table carries: a modelling choice (seed `003` s. 2.4), not a
/// measurement.
pub const MODELLING_POISSON_RATIO: f64 = 0.45;

/// One tissue's parameters for small strains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tissue {
    /// Name for scenes and the command line.
    pub name: &'static str,
    /// Young's modulus E [Pa] at small strain.
    pub young_modulus_pa: f64,
    /// Lowest and highest E [Pa] of the same source.
    pub young_modulus_range_pa: [f64; 2],
    /// Where E and its range come from: authors, year, DOI.
    pub source: &'static str,
    /// How E was measured, and what was converted.
    pub test_condition: &'static str,
    /// Poisson's ratio: [`MODELLING_POISSON_RATIO`].
    pub poisson_ratio: f64,
    /// Density [kg/m3]; absent where no source was found.
    pub density_kg_per_m3: Option<f64>,
    /// Where the density comes from.
    pub density_source: Option<&'static str>,
}

const PHYS_MED_BIOL_2019: &str =
    "table 1 of the article doi 10.1088/1361-6560/ab5010 (Phys. Med. Biol. 64:225001, 2019)";
const MECH_MATER_2012: &str =
    "table 3 of the article doi 10.1016/j.mechmat.2011.08.007 (Mech. Mater. 44:174-188, 2012)";

/// The table.
pub const TISSUES: [Tissue; 6] = [
    Tissue {
        name: "liver",
        young_modulus_pa: 4100.0,
        young_modulus_range_pa: [2300.0, 5900.0],
        source: "Fung et al. 2013, doi 10.1371/journal.pone.0085067",
        test_condition: "transient elastography (E = 3 G) in vivo, 530 healthy Chinese adults: mean 4.1 kPa, standard deviation 0.89, reference range 2.3 to 5.9",
        poisson_ratio: MODELLING_POISSON_RATIO,
        density_kg_per_m3: Some(1060.0),
        density_source: Some(MECH_MATER_2012),
    },
    Tissue {
        name: "gall_bladder",
        young_modulus_pa: 255_000.0,
        young_modulus_range_pa: [230_400.0, 279_600.0],
        source: "Karimi, Shojaei and Tehrani 2017, doi 10.1080/03091902.2017.1366561, as shear modulus 85 +- 8.2 \
                 kPa in table 1 of doi 10.1088/1361-6560/ab5010",
        test_condition: "wall of the gall bladder, as the second source quotes it; E = 3 G, range one standard \
                         deviation. The bile inside is not part of it",
        poisson_ratio: MODELLING_POISSON_RATIO,
        density_kg_per_m3: Some(1060.0),
        density_source: Some(PHYS_MED_BIOL_2019),
    },
    Tissue {
        name: "kidney",
        young_modulus_pa: 5000.0,
        young_modulus_range_pa: [2100.0, 7900.0],
        source: "Arda et al. 2011, doi 10.2214/AJR.10.5449",
        test_condition: "renal cortex, shear-wave elastography in vivo, 127 healthy adults: 5.0 +- 2.9 kPa (the \
                         renal pelvis has 23.6 +- 5.4); range one standard deviation",
        poisson_ratio: MODELLING_POISSON_RATIO,
        density_kg_per_m3: Some(1050.0),
        density_source: Some(MECH_MATER_2012),
    },
    Tissue {
        name: "brain",
        young_modulus_pa: 2655.0,
        young_modulus_range_pa: [2220.0, 3090.0],
        source: "table 1 of the review doi 10.3390/jfb3040839 (J. Funct. Biomater. 3:839-863, 2012)",
        test_condition: "porcine brain, indentation at 0.1 mm/s: shear modulus 0.74 kPa (grey matter) and 1.03 \
                         kPa (white matter), the ends of the range; the value is their mean; E = 3 G",
        poisson_ratio: MODELLING_POISSON_RATIO,
        density_kg_per_m3: Some(1040.0),
        density_source: Some(MECH_MATER_2012),
    },
    Tissue {
        name: "vessel",
        young_modulus_pa: 620_000.0,
        young_modulus_range_pa: [210_000.0, 1_030_000.0],
        source: "Umale et al. 2011, doi 10.1016/j.jbiomech.2011.03.029",
        test_condition: "porcine hepatic vein ex vivo, uniaxial tension at 0.1 mm/s, small strain, 20 samples: \
                         0.62 +- 0.41 MPa (large strain 2.81 +- 2.23); range one standard deviation",
        poisson_ratio: MODELLING_POISSON_RATIO,
        density_kg_per_m3: Some(1050.0),
        density_source: Some("hepatic artery in table 1 of the article doi 10.1088/1361-6560/ab5010"),
    },
    Tissue {
        name: "glisson_capsule",
        young_modulus_pa: 8_220_000.0,
        young_modulus_range_pa: [4_800_000.0, 11_640_000.0],
        source: "Umale et al. 2011, doi 10.1016/j.jbiomech.2011.03.029",
        test_condition: "porcine Glisson's capsule ex vivo, uniaxial tension at 0.1 mm/s, small strain, 30 \
                         samples: 8.22 +- 3.42 MPa (large strain 48.15 +- 4.5); range one standard deviation",
        poisson_ratio: MODELLING_POISSON_RATIO,
        density_kg_per_m3: None,
        density_source: None,
    },
];

/// Why a name gives no material.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TissueError {
    /// No tissue of that name.
    #[error("there is no tissue `{found}`{} Known: {known}", did_you_mean.map_or(".".to_owned(), |n| format!(", did you mean `{n}`?")))]
    Unknown {
        /// The name asked for.
        found: String,
        /// The nearest name, when one is near.
        did_you_mean: Option<&'static str>,
        /// All names.
        known: String,
    },
    /// The table has no density for it.
    #[error("no source gives the density of `{tissue}`: state one")]
    NoDensity {
        /// Which tissue.
        tissue: &'static str,
    },
    /// A density that was given in place of the table's is impossible.
    #[error(transparent)]
    Material(#[from] MaterialError),
}

impl Tissue {
    /// The tissue of that name; capitals, spaces and hyphens do not matter.
    ///
    /// # Errors
    /// [`TissueError::Unknown`] with the nearest name.
    pub fn by_name(name: &str) -> Result<&'static Self, TissueError> {
        let wanted = name.trim().to_lowercase().replace([' ', '-'], "_");
        if let Some(tissue) = TISSUES.iter().find(|t| t.name == wanted) {
            return Ok(tissue);
        }
        let names = TISSUES.map(|t| t.name);
        Err(TissueError::Unknown {
            found: name.to_owned(),
            did_you_mean: closest_name(&wanted, &names),
            known: names.join(", "),
        })
    }

    /// The tissue as a linear elastic material, with the table's density.
    ///
    /// # Errors
    /// [`TissueError::NoDensity`] where the table has none.
    pub fn linear_elastic(&self) -> Result<LinearElastic, TissueError> {
        let density = self.density_kg_per_m3.ok_or(TissueError::NoDensity { tissue: self.name })?;
        Ok(LinearElastic::from_young_poisson(self.young_modulus_pa, self.poisson_ratio, density)?)
    }

    /// The tissue as a linear elastic material of another density.
    ///
    /// # Errors
    /// [`TissueError::Material`] for an impossible density.
    pub fn linear_elastic_of_density(&self, density_kg_per_m3: f64) -> Result<LinearElastic, TissueError> {
        Ok(LinearElastic::from_young_poisson(self.young_modulus_pa, self.poisson_ratio, density_kg_per_m3)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tissue_has_a_source_and_lies_in_its_range() {
        for tissue in &TISSUES {
            let [low, high] = tissue.young_modulus_range_pa;
            assert!(low < tissue.young_modulus_pa && tissue.young_modulus_pa < high, "{}", tissue.name);
            assert!(tissue.source.contains("doi 10."), "{}", tissue.name);
            assert!(!tissue.test_condition.is_empty());
            assert_eq!(tissue.density_kg_per_m3.is_some(), tissue.density_source.is_some());
            assert!(tissue.linear_elastic_of_density(1000.0).is_ok());
        }
    }

    #[test]
    fn names_are_found_and_typing_errors_are_understood() {
        assert_eq!(Tissue::by_name("Gall bladder").unwrap().name, "gall_bladder");
        let error = Tissue::by_name("lvier").unwrap_err();
        assert!(matches!(&error, TissueError::Unknown { did_you_mean: Some("liver"), .. }), "{error}");
        assert!(error.to_string().contains("did you mean `liver`?"));
        let error = Tissue::by_name("xyz").unwrap_err();
        assert!(matches!(&error, TissueError::Unknown { did_you_mean: None, .. }), "{error}");
        let capsule = Tissue::by_name("glisson-capsule").unwrap();
        assert_eq!(capsule.linear_elastic(), Err(TissueError::NoDensity { tissue: "glisson_capsule" }));
    }
}
