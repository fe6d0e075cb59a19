//! Cutting by heat: the active tip of a hook or of bipolar jaws heats the tetrahedra that it touches until their water
//! boils away.
//!
//! Electrosurgery cuts where tissue is heated beyond boiling fast, and coagulates where it stays below
//! (Taheri et al. 2014, doi 10.1016/j.jaad.2013.09.056). Each tetrahedron is one lump of tissue: the power is shared by
//! what is touched, in proportion to volume; a lump that is not touched cools towards the body by the blood that
//! flows through it. Heat that spreads to neighbours is not modelled.

use crate::mesh::TetId;

/// How tissue takes up heat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeatedTissue {
    /// Density [kg/m3].
    pub density_kg_per_m3: f64,
    /// Specific heat [J/(kg K)].
    pub specific_heat_j_per_kg_k: f64,
    /// Share of the mass that has to boil away before the tissue comes apart.
    pub boiled_fraction: f64,
    /// Rate at which blood takes excess heat away [1/s].
    pub cooling_rate_per_s: f64,
}

/// Temperature of the body [C].
pub const BODY_C: f64 = 37.0;
/// Temperature at which the tissue's water boils [C].
pub const BOILING_C: f64 = 100.0;
/// Heat of evaporation of water at 100 C [J/kg] (IAPWS-95 formulation, Wagner and Pruss 2002, doi 10.1063/1.1461829).
pub const EVAPORATION_J_PER_KG: f64 = 2.2565e6;

impl HeatedTissue {
    /// Liver: density of the table of tissues; specific heat at 25 C from Haemmerich et al. 2006 (Med. Eng. Phys. 28:194-197),
    /// who also find a fifth of the mass lost at 90 C. Choices: tissue that has lost that share counts as cut, and blood
    /// cools nothing in the short time that a tip stays at one place.
    pub const LIVER: Self = Self {
        density_kg_per_m3: 1060.0,
        specific_heat_j_per_kg_k: 3411.0,
        boiled_fraction: 0.2,
        cooling_rate_per_s: 0.0,
    };

    /// Heat [J/m3] from the body's temperature to boiling.
    pub fn heat_to_boil_j_per_m3(&self) -> f64 {
        self.density_kg_per_m3 * self.specific_heat_j_per_kg_k * (BOILING_C - BODY_C)
    }

    /// Heat [J/m3] at which the tissue comes apart.
    pub fn heat_to_part_j_per_m3(&self) -> f64 {
        self.heat_to_boil_j_per_m3() + self.density_kg_per_m3 * self.boiled_fraction * EVAPORATION_J_PER_KG
    }

    /// Share of its strength that tissue has left after it took up `heat_j_per_m3`: it falls evenly to none where the tissue
    /// comes apart by heat alone (a choice). Heat pays for the crack of [`super::fracture`] many times over.
    pub fn strength_left(&self, heat_j_per_m3: f64) -> f64 {
        (1.0 - heat_j_per_m3 / self.heat_to_part_j_per_m3()).clamp(0.0, 1.0)
    }

    /// Temperature [C] of tissue that took up `heat_j_per_m3`: it stays at boiling until it has parted.
    pub fn temperature_c(&self, heat_j_per_m3: f64) -> f64 {
        let rise = heat_j_per_m3 / (self.density_kg_per_m3 * self.specific_heat_j_per_kg_k);
        (BODY_C + rise).min(BOILING_C)
    }
}

/// Heat that single tetrahedra have taken up; the few that a tip is at are listed, ascending.
#[derive(Debug, Default, PartialEq)]
pub struct TissueHeat {
    heat: Vec<(TetId, f64)>,
}

impl Clone for TissueHeat {
    /// With the same room: what finds none takes up no heat, and a copy has to go on as its original does.
    fn clone(&self) -> Self {
        let mut heat = Vec::with_capacity(self.heat.capacity());
        heat.extend_from_slice(&self.heat);
        Self { heat }
    }
}

impl TissueHeat {
    /// With room for `n_tets` warm tetrahedra.
    pub fn with_room_for(n_tets: usize) -> Self {
        Self { heat: Vec::with_capacity(n_tets) }
    }

    /// Warm tetrahedra with the heat that they took up [J/m3], ascending.
    pub fn warm(&self) -> &[(TetId, f64)] {
        &self.heat
    }

    /// Heat that a tetrahedron has taken up [J/m3].
    pub fn of(&self, tet: TetId) -> f64 {
        self.heat.binary_search_by_key(&tet, |entry| entry.0).map_or(0.0, |at| self.heat[at].1)
    }

    /// A tip of `power_w` touches `touched` (ascending, with their volumes in the rest shape) for `dt_s`. Appends what
    /// comes apart to `parted`, ascending; it has to be removed by an edit. What finds no room among the warm ones
    /// takes up no heat.
    pub fn heat_up(
        &mut self,
        tissue: &HeatedTissue,
        power_w: f64,
        touched: impl Iterator<Item = (TetId, f64)> + Clone,
        dt_s: f64,
        parted: &mut Vec<TetId>,
    ) {
        let volume_m3: f64 = touched.clone().map(|(_, v)| v).sum();
        if !(volume_m3 > 0.0 && power_w > 0.0) {
            return;
        }
        let gained_j_per_m3 = power_w * dt_s / volume_m3;
        let limit = tissue.heat_to_part_j_per_m3();
        for (tet, _) in touched {
            match self.heat.binary_search_by_key(&tet, |entry| entry.0) {
                Ok(at) => self.heat[at].1 += gained_j_per_m3,
                Err(at) if self.heat.len() < self.heat.capacity() => {
                    self.heat.insert(at, (tet, gained_j_per_m3));
                }
                Err(_) => {}
            }
        }
        for &(tet, heat) in &self.heat {
            if heat >= limit {
                parted.push(tet);
            }
        }
        self.heat.retain(|&(_, heat)| heat < limit);
    }

    /// Time passes: all cool down, and what is nearly at the body's temperature is forgotten.
    pub fn cool_down(&mut self, tissue: &HeatedTissue, dt_s: f64) {
        if tissue.cooling_rate_per_s == 0.0 {
            return;
        }
        let left = libm::exp(-tissue.cooling_rate_per_s * dt_s);
        let negligible = 1e-3 * tissue.heat_to_boil_j_per_m3();
        for entry in &mut self.heat {
            entry.1 *= left;
        }
        self.heat.retain(|&(_, heat)| heat > negligible);
    }

    /// Forgets tetrahedra that are gone.
    pub fn keep_live(&mut self, is_live: impl Fn(TetId) -> bool) {
        self.heat.retain(|&(tet, _)| is_live(tet));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn energy_in_is_energy_of_what_parts() {
        let tissue = HeatedTissue::LIVER;
        let volumes = [(TetId(3), 4e-9), (TetId(7), 2e-9)];
        let mut heat = TissueHeat::with_room_for(8);
        let mut parted = Vec::with_capacity(8);
        let (power_w, dt_s) = (30.0, 1e-3);
        let mut n_steps = 0;
        while parted.is_empty() {
            heat.heat_up(&tissue, power_w, volumes.into_iter(), dt_s, &mut parted);
            n_steps += 1;
            assert!(heat.warm().iter().all(|&(_, h)| tissue.temperature_c(h) <= BOILING_C));
        }
        assert_eq!(parted, [TetId(3), TetId(7)], "they share in proportion to volume, so they part together");
        assert!(heat.warm().is_empty());
        let needed_j = tissue.heat_to_part_j_per_m3() * 6e-9;
        let given_j = power_w * dt_s * f64::from(n_steps);
        assert!(given_j >= needed_j && given_j < needed_j + power_w * dt_s, "{given_j} {needed_j}");
        // 30 W through 6 mm3 take about a seventh of a second.
        assert!((0.1..0.2).contains(&(dt_s * f64::from(n_steps))), "{n_steps}");
    }

    #[test]
    fn tissue_cools_when_it_is_let_go_and_full_lists_do_not_grow() {
        let tissue = HeatedTissue { cooling_rate_per_s: 0.5, ..HeatedTissue::LIVER };
        let mut heat = TissueHeat::with_room_for(1);
        let mut parted = Vec::new();
        let room = heat.heat.capacity();
        let many = (0..room as u32 + 3).map(|t| (TetId(t), 1e-9));
        heat.heat_up(&tissue, 100.0, many, 1e-3, &mut parted);
        assert_eq!((heat.warm().len(), heat.heat.capacity()), (room, room));
        let before = heat.warm()[0].1;
        heat.cool_down(&tissue, 1.0);
        assert!((heat.warm()[0].1 / before - (-0.5_f64).exp()).abs() < 1e-12);
        for _ in 0..100 {
            heat.cool_down(&tissue, 1.0);
        }
        assert!(heat.warm().is_empty());
        assert!(parted.is_empty());
    }
}
