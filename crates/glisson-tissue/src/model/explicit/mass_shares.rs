//! A bound of the highest frequency of a body as it is, from shares of the nodes' masses.
//!
//! K is the sum of the K_e of tetrahedra. However the mass of each node is shared among its tetrahedra, the largest Rayleigh quotient
//! of the whole is at most the largest one of a tetrahedron with its shares: a quotient of sums (the element eigenvalue theorem of
//! Irons and Treharne, 1971, with other masses than each tetrahedron's own). Here a node's mass is shared in proportion to a demand
//! of each tetrahedron: kappa_e, the largest eigenvalue of K_e, times a factor that is found once, round by round: those that limit
//! the step ask for more, the others for less. So the stiff lean on the soft beside them, as they do in the body. On livers the step is
//! 0.7 to 0.85 of the longest one; with each tetrahedron's own mass it is half.
//!
//! After an edit the shares at its nodes are others, and what is known of the tetrahedra there bounds what they have now: a squared
//! frequency grows at most as much as that share shrank which shrank most. Only where that is above the bound so far they are looked at anew.
//!
//! A ligament counts as a tetrahedron at its node alone, with its stiffness as demand.
//!
//! The bound is that of the live tetrahedra: a removal may raise it.

use crate::solve::TetStiffness;
use glisson_mesh::mesh::{NodeId, TetId};

/// Rounds that find the factors of the demands, and what a factor shrinks to at most in a round: a choice. More rounds bring a hundredth.
const ROUNDS: usize = 4;
const LEAST_FACTOR: f64 = 0.5;

/// A tetrahedron's part in the stable step.
#[derive(Clone, Copy)]
pub(in crate::model) struct StiffTet {
    /// Its tensors in the rest shape.
    pub at_rest: TetStiffness,
    /// Bound of its highest squared frequency in any shape allowed for, over the one at rest; from 1.
    pub stiffening: f64,
}

impl StiffTet {
    /// Bound of its squared frequency by itself, for every shape allowed for, with these masses at its corners [1/s2].
    pub(in crate::model) fn squared_frequency_per_s2(&self, corners_kg: [f64; 4]) -> f64 {
        self.stiffening * self.at_rest.squared_frequency_bound_per_s2(corners_kg)
    }
}

/// What is known of a tetrahedron: its squared frequency [1/s2] with these shares at its corners [kg].
#[derive(Clone, Copy, Debug)]
struct Known {
    shares_kg: [f64; 4],
    per_s2: f64,
}

impl Known {
    const NOTHING: Self = Self { shares_kg: [0.0; 4], per_s2: f64::INFINITY };

    /// The most that the squared frequency is with other shares.
    fn at_most_per_s2(&self, shares_kg: &[f64; 4]) -> f64 {
        let shrank = self.shares_kg.iter().zip(shares_kg).map(|(before, now)| before / now);
        // A hair more, so that rounding decides nothing; and above 0, so that nothing known stays endless.
        self.per_s2 * shrank.fold(f64::MIN_POSITIVE, f64::max) * (1.0 + 1e-9)
    }
}

/// What the bound is made from, and what of it is known.
#[derive(Clone, Debug)]
pub(in crate::model) struct MassShares {
    /// kappa of each tetrahedron, in every shape allowed for [N/m].
    kappa_n_per_m: Vec<f64>,
    /// Its demand over that.
    factor: Vec<f64>,
    known: Vec<Known>,
    /// Of each node [kg].
    mass_kg: Vec<f64>,
    /// Mass of a node over all demands there [kg m/N].
    per_demand: Vec<f64>,
    /// Whether the demands were found.
    has_demands: bool,
}

impl MassShares {
    /// From kappa of each tetrahedron [N/m].
    pub(in crate::model) fn new(kappa_n_per_m: Vec<f64>, n_nodes: usize) -> Self {
        let n_tets = kappa_n_per_m.len();
        Self {
            kappa_n_per_m,
            factor: vec![1.0; n_tets],
            known: vec![Known::NOTHING; n_tets],
            mass_kg: vec![0.0; n_nodes],
            per_demand: vec![0.0; n_nodes],
            has_demands: false,
        }
    }

    /// As many tetrahedra and nodes.
    pub(in crate::model) fn resize(&mut self, n_tets: usize, n_nodes: usize) {
        self.kappa_n_per_m.resize(n_tets, 0.0);
        self.factor.resize(n_tets, 1.0);
        self.known.resize(n_tets, Known::NOTHING);
        self.mass_kg.resize(n_nodes, 0.0);
        self.per_demand.resize(n_nodes, 0.0);
    }

    pub(in crate::model) fn kappa_n_per_m(&self, tet: TetId) -> f64 {
        self.kappa_n_per_m[tet.index()]
    }

    /// A tetrahedron came in, or has another shape.
    pub(in crate::model) fn set_tet(&mut self, tet: TetId, kappa_n_per_m: f64) {
        self.kappa_n_per_m[tet.index()] = kappa_n_per_m;
        self.known[tet.index()] = Known::NOTHING;
    }

    /// A new tetrahedron asks for as much as the one of its `parents` that asks for most.
    pub(in crate::model) fn take_after(&mut self, tet: TetId, parents: impl Iterator<Item = TetId>) {
        let most = parents.map(|parent| self.factor[parent.index()]).fold(0.0, f64::max);
        self.factor[tet.index()] = if most > 0.0 { most } else { 1.0 };
    }

    /// Drops tetrahedra and nodes that do not stay.
    pub(in crate::model) fn keep(&mut self, nodes: &[bool], tets: &[bool]) {
        super::keep(&mut self.kappa_n_per_m, tets);
        super::keep(&mut self.factor, tets);
        super::keep(&mut self.known, tets);
        super::keep(&mut self.mass_kg, nodes);
        super::keep(&mut self.per_demand, nodes);
    }

    /// Masses of all nodes [kg], all zero; those that stay so belong to nothing.
    pub(in crate::model) fn masses_mut(&mut self) -> &mut [f64] {
        self.mass_kg.fill(0.0);
        &mut self.mass_kg
    }

    /// Finds what each tetrahedron asks for, with the masses as they are, where that was not done before. `stiffness` tells what a tetrahedron has to do with it.
    pub(in crate::model) fn find_demands(
        &mut self,
        tets: &[[NodeId; 4]],
        is_live: impl Fn(TetId) -> bool + Copy,
        ligaments_n_per_m: &[f64],
        stiffness: impl Fn(TetId) -> StiffTet,
    ) {
        if std::mem::replace(&mut self.has_demands, true) {
            return;
        }
        for _ in 0..ROUNDS {
            self.share(tets, is_live, ligaments_n_per_m);
            let mut most_per_s2 = 0.0;
            for (tet, nodes) in live(tets, is_live) {
                let per_s2 = self.look_at(tet, self.shares_kg(tet, nodes), &stiffness);
                most_per_s2 = f64::max(most_per_s2, per_s2);
            }
            if !(most_per_s2 > 0.0 && most_per_s2.is_finite()) {
                return;
            }
            for (factor, known) in self.factor.iter_mut().zip(&self.known) {
                *factor *= (known.per_s2 / most_per_s2).clamp(LEAST_FACTOR, 1.0);
            }
        }
    }

    /// The bound [1/s2] for the live ones among `tets`; `stiffness` as before.
    pub(in crate::model) fn squared_frequency_per_s2(
        &mut self,
        tets: &[[NodeId; 4]],
        is_live: impl Fn(TetId) -> bool + Copy,
        ligaments_n_per_m: &[f64],
        stiffness: impl Fn(TetId) -> StiffTet,
    ) -> f64 {
        self.share(tets, is_live, ligaments_n_per_m);
        let of_ligaments = ligaments_n_per_m.iter().zip(&self.per_demand).filter(|(k, _)| **k > 0.0);
        let mut most_per_s2 =
            of_ligaments.filter(|(_, share)| **share > 0.0).map(|(_, share)| 1.0 / share).fold(0.0, f64::max);
        // What is known well first: it leaves less to look at.
        for is_known in [true, false] {
            for (tet, nodes) in live(tets, is_live) {
                let shares_kg = self.shares_kg(tet, nodes);
                let known = &self.known[tet.index()];
                if (known.shares_kg == shares_kg) != is_known
                    || known.at_most_per_s2(&shares_kg) <= most_per_s2
                {
                    continue;
                }
                let per_s2 = if is_known { known.per_s2 } else { self.look_at(tet, shares_kg, &stiffness) };
                most_per_s2 = most_per_s2.max(per_s2);
            }
        }
        most_per_s2
    }

    /// Shares the masses among the live ones.
    fn share(&mut self, tets: &[[NodeId; 4]], is_live: impl Fn(TetId) -> bool, ligaments_n_per_m: &[f64]) {
        let Self { kappa_n_per_m, factor, mass_kg, per_demand, .. } = self;
        per_demand.copy_from_slice(ligaments_n_per_m);
        for (tet, nodes) in live(tets, is_live) {
            let demand = kappa_n_per_m[tet.index()] * factor[tet.index()];
            nodes.iter().for_each(|node| per_demand[node.index()] += demand);
        }
        for (share, kg) in per_demand.iter_mut().zip(mass_kg) {
            *share = if *share > 0.0 { *kg / *share } else { 0.0 };
        }
    }

    fn shares_kg(&self, tet: TetId, nodes: &[NodeId; 4]) -> [f64; 4] {
        let demand = self.kappa_n_per_m[tet.index()] * self.factor[tet.index()];
        nodes.map(|node| demand * self.per_demand[node.index()])
    }

    fn look_at(&mut self, tet: TetId, shares_kg: [f64; 4], stiffness: &impl Fn(TetId) -> StiffTet) -> f64 {
        // No mass at a corner is no bound: what is no number comes of a share below zero, which rounding may leave.
        let per_s2 = Some(stiffness(tet).squared_frequency_per_s2(shares_kg)).filter(|bound| !bound.is_nan());
        let per_s2 = per_s2.unwrap_or(f64::INFINITY);
        self.known[tet.index()] = Known { shares_kg, per_s2 };
        per_s2
    }
}

fn live(
    tets: &[[NodeId; 4]],
    is_live: impl Fn(TetId) -> bool,
) -> impl Iterator<Item = (TetId, &[NodeId; 4])> {
    let all = tets.iter().enumerate().map(|(t, nodes)| (TetId::from_index(t), nodes));
    all.filter(move |(tet, _)| is_live(*tet))
}

#[cfg(test)]
mod tests {
    use super::super::stable::{StableStep, estimate_from_below, masses_kg};
    use super::*;
    use crate::material::LinearElastic;
    use crate::solve::{MeshEdges, P1Gradients, StiffnessTensors};
    use glisson_mesh::math::SeededRandom;
    use glisson_mesh::mesh::TetMesh;
    use glisson_mesh::mesh::box_mesh::irregular_cube;

    struct Body {
        mesh: TetMesh,
        tissue: LinearElastic,
        is_live: Vec<bool>,
        shares: MassShares,
    }

    impl Body {
        fn new(seed: u64) -> Self {
            let mesh = irregular_cube(0.05, seed);
            let tissue = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
            let mut body = Self {
                is_live: vec![true; mesh.tetrahedra.len()],
                shares: MassShares::new(Vec::new(), mesh.positions_m.len()),
                mesh,
                tissue,
            };
            body.shares = body.fresh_shares();
            let masses_kg = body.masses_kg();
            body.shares.masses_mut().copy_from_slice(&masses_kg);
            let stiffness = stiffness_of(&body.mesh, &body.tissue);
            body.shares.find_demands(
                &body.mesh.tetrahedra,
                |_| true,
                &vec![0.0; body.mesh.positions_m.len()],
                stiffness,
            );
            body
        }

        fn fresh_shares(&self) -> MassShares {
            let stiffness = stiffness_of(&self.mesh, &self.tissue);
            let tets = (0..self.mesh.tetrahedra.len()).map(TetId::from_index);
            let kappa = tets.map(|tet| stiffness(tet).squared_frequency_per_s2([1.0; 4]));
            MassShares::new(kappa.collect(), self.mesh.positions_m.len())
        }

        /// What is left, with its nodes.
        fn rest(&self) -> TetMesh {
            let live = self.mesh.tetrahedra.iter().zip(&self.is_live).filter(|(_, live)| **live);
            TetMesh { tetrahedra: live.map(|(nodes, _)| *nodes).collect(), ..self.mesh.clone() }
        }

        fn masses_kg(&self) -> Vec<f64> {
            masses_kg(&self.rest(), 1060.0)
        }

        fn bound_per_s2(&self, shares: &mut MassShares, masses_kg: &[f64]) -> f64 {
            shares.masses_mut().copy_from_slice(masses_kg);
            let no_ligaments = vec![0.0; masses_kg.len()];
            let stiffness = stiffness_of(&self.mesh, &self.tissue);
            let is_live = |tet: TetId| self.is_live[tet.index()];
            shares.squared_frequency_per_s2(&self.mesh.tetrahedra, is_live, &no_ligaments, stiffness)
        }

        fn estimate_per_s2(&self, masses_kg: &[f64]) -> f64 {
            let rest = self.rest();
            let edges = MeshEdges::of_mesh(&rest).unwrap();
            let stiffness = stiffness_of(&rest, &self.tissue);
            let tensors =
                StiffnessTensors::assemble_with(&rest, &edges, |tet, _| stiffness(tet).at_rest).unwrap();
            estimate_from_below(&edges, &tensors, masses_kg)
        }
    }

    fn stiffness_of(mesh: &TetMesh, tissue: &LinearElastic) -> impl Fn(TetId) -> StiffTet + Copy {
        move |tet| {
            let gradients = P1Gradients::in_mesh(mesh, tet);
            StiffTet { at_rest: gradients.stiffness(tissue.lambda_pa(), tissue.mu_pa()), stiffening: 1.0 }
        }
    }

    #[test]
    fn the_bound_is_above_the_spectrum_and_nearer_than_that_of_single_tetrahedra() {
        for seed in 0..4 {
            let body = Body::new(seed);
            let masses_kg = body.masses_kg();
            let bound = body.bound_per_s2(&mut body.shares.clone(), &masses_kg);
            let below = body.estimate_per_s2(&masses_kg);
            let alone_s = StableStep::of(&body.mesh, &body.tissue).unwrap().after_cuts_s;
            let alone = 4.0 / (alone_s * alone_s);
            assert!(bound >= below && bound < 2.0 * below, "{below} {bound}");
            assert!(bound < 0.7 * alone, "{bound} {alone}");
        }
    }

    #[test]
    fn after_removals_and_with_other_masses_it_is_the_one_of_shares_made_anew() {
        for seed in 0..4 {
            let mut body = Body::new(seed);
            let mut random = SeededRandom::new(seed);
            let mut kept = body.shares.clone();
            for _ in 0..12 {
                for _ in 0..5 {
                    let tet = random.uniform_in(0.0, body.is_live.len() as f64) as usize;
                    body.is_live[tet] = false;
                }
                let mut masses_kg = body.masses_kg();
                masses_kg.iter_mut().for_each(|kg| *kg *= random.uniform_in(1.0, 1.3));
                let bound = body.bound_per_s2(&mut kept, &masses_kg);
                // What is known of no tetrahedron is computed of each.
                let mut anew = body.fresh_shares();
                anew.factor.clone_from(&kept.factor);
                assert_eq!(bound, body.bound_per_s2(&mut anew, &masses_kg));
                assert!(bound >= body.estimate_per_s2(&masses_kg));
            }
        }
    }
}
