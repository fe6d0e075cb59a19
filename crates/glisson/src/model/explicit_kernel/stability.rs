//! The largest stable step with ligaments and stiffness damping, and the masses that keep it long enough after
//! cuts.
//!
//! Without damping a step h is stable while theta h^2 <= 4 for the largest squared frequency theta
//! ([`StableStep`]). A ligament of stiffness k adds at most k to its node's diagonal block: k/m_i to theta, and
//! after cuts k over the smallest share of mass that a tetrahedron can leave the node.
//!
//! Other laws stiffen by the largest eigenvalue of their tangent within the stretches allowed for, over
//! lambda + 2 mu; a stress at rest adds its largest principal value over that.
//!
//! Forces at u + beta v with the velocity v of the last half step give a mode of squared frequency theta, with
//! damping d over mass, the characteristic polynomial
//! (1 + d h/2) z^2 - (2 - theta h^2 - theta beta h) z + (1 - d h/2 - theta beta h): its roots stay in the unit
//! circle while theta (h^2 + 2 beta h) <= 4 (its value at z = -1), so h <= sqrt(beta^2 + 4/theta) - beta.
//!
//! After the first removal the bound of the single tetrahedra counts, which holds after any cuts. Where that step is
//! shorter than the shortest one allowed, the limiting tetrahedra get the inertia that makes up for it; their weight
//! stays. Since the bound is that of every tetrahedron by itself, this holds after any further cuts, too.

use super::{ExplicitKernelParams, StableStep};
use crate::material::{Material, NeoHookeLog, StableNeoHooke, largest_tangent_eigenvalue_pa};
use crate::mesh::{NodeId, TetId, TetMesh};
use crate::model::explicit::StiffTet;
use crate::model::kernel::{FastKernel, KernelLaw};
use crate::model::nonlinear_tensor_mass::{TetLaw, linear_stiffness};
use crate::solve::{P1Gradients, SolveError};

/// theta h^2 of the longest step: a little below 4, as far as [`StableStep`] keeps below it.
const SQUARED_LIMIT: f64 = 3.99;

/// A tetrahedron that gets more inertia once the body is cut.
#[derive(Clone, Copy, Debug)]
struct ScaledTet {
    tet: TetId,
    /// Added to each of its corners [kg].
    corner_kg: f64,
}

/// Added inertia, and where it is.
#[derive(Clone, Debug)]
pub(super) struct MassScaling {
    /// Ascending; a tetrahedron that was removed stays, with nothing to add.
    tets: Vec<ScaledTet>,
    added_kg: Vec<f64>,
    /// Scaled tetrahedra at each node.
    n_scaled: Vec<u32>,
    pub(super) n_nodes: u32,
}

/// How long a step may be, and what makes it so.
#[derive(Clone, Debug)]
pub(super) struct Stability {
    /// Without added inertia.
    pub(super) step: StableStep,
    /// After any cuts, with it [s].
    pub(super) after_cuts_s: f64,
    pub(super) scaling: MassScaling,
}

impl Stability {
    /// Of a mesh whose tetrahedra are sound.
    pub(super) fn of(params: &ExplicitKernelParams<'_>) -> Result<Self, SolveError> {
        let body = &params.body;
        let mesh = body.mesh;
        let stretch = params.largest_stretch;
        let tangents_pa: Vec<f64> =
            params.laws.iter().map(|law| largest_tangent_eigenvalue_pa(law.as_ref(), stretch)).collect();
        // The search over stretches costs more than everything else about a tetrahedron: once for one material.
        let of_one = match (params.law, params.materials) {
            (KernelLaw::NeoHookeLog, [one]) => {
                Some(largest_tangent_eigenvalue_pa(&NeoHookeLog::from(one), stretch))
            }
            (KernelLaw::StableNeoHooke, [one]) => {
                Some(largest_tangent_eigenvalue_pa(&StableNeoHooke::from(one), stretch))
            }
            _ => None,
        };
        let stiff = |tet: TetId, gradients: &P1Gradients| {
            let material = params.material(tet);
            let law = match params.fibres.get(tet.index()) {
                Some(fibre) => TetLaw::with_fibre(material, fibre, tet).expect("the kernel was made of it"),
                None => TetLaw::isotropic(material),
            };
            // K(F) is at most the largest tangent times the scalar Laplacian, and that at most K at rest over
            // lambda + 2 mu.
            let wave_pa = (material.lambda_pa() + 2.0 * material.mu_pa()).max(material.mu_pa());
            let of_tangent = |tangent_pa: f64| (tangent_pa / wave_pa).max(1.0);
            let of_law = |law: &dyn Material| {
                of_tangent(of_one.unwrap_or_else(|| largest_tangent_eigenvalue_pa(law, stretch)))
            };
            let stiffening = match params.law {
                KernelLaw::Linear if params.volume_penalty_pa == 0.0 => 1.0,
                KernelLaw::Linear | KernelLaw::StVenantKirchhoff => {
                    law.stiffening(stretch, params.volume_penalty_pa)
                }
                KernelLaw::NeoHookeLog => of_law(&NeoHookeLog::from(material)),
                KernelLaw::StableNeoHooke => of_law(&StableNeoHooke::from(material)),
                KernelLaw::General => {
                    of_tangent(tangents_pa[if tangents_pa.len() == 1 { 0 } else { tet.index() }])
                }
            };
            let rest_pa = body.rest_stress_pa.get(tet.index()).map_or(0.0, |s| {
                // Largest row sum: at least the largest principal stress.
                let [xx, yy, zz, xy, xz, yz] = s.map(f64::abs);
                (xx + xy + xz).max(xy + yy + yz).max(xz + yz + zz)
            });
            StiffTet {
                at_rest: linear_stiffness(&law, gradients),
                stiffening: stiffening + rest_pa / wave_pa,
            }
        };
        let elastic = StableStep::of_stiffness(mesh, body.density_kg_per_m3, stiff)?;
        let mut ligaments_n_per_m = vec![0.0; mesh.positions_m.len()];
        for ligament in body.attachments {
            ligaments_n_per_m[ligament.node.index()] += ligament.stiffness_n_per_m;
        }
        let squared_frequency = |tet: TetId, corner_kg: f64| -> Result<f64, SolveError> {
            let stiff = stiff(tet, &P1Gradients::of_tet(mesh, tet)?);
            let elastic = stiff.stiffening * stiff.at_rest.squared_frequency_bound_per_s2([corner_kg; 4]);
            let ligaments = mesh.tetrahedra[tet.index()].map(|n| ligaments_n_per_m[n.index()]);
            Ok(elastic + ligaments.into_iter().fold(0.0, f64::max) / corner_kg)
        };
        let corner_kg = |tet: TetId| 0.25 * body.density_kg_per_m3 * mesh.tet_volume_m3(tet);
        let tets = || (0..mesh.tetrahedra.len()).map(TetId::from_index);

        let mut mass_kg = vec![0.0; mesh.positions_m.len()];
        for tet in tets() {
            for node in mesh.tetrahedra[tet.index()] {
                mass_kg[node.index()] += corner_kg(tet);
            }
        }
        let per_mass = ligaments_n_per_m.iter().zip(&mass_kg).filter(|(_, m)| **m > 0.0).map(|(k, m)| k / m);
        let uncut = SQUARED_LIMIT / (elastic.step_s * elastic.step_s) + per_mass.fold(0.0, f64::max);
        let mut after_cuts = SQUARED_LIMIT / (elastic.after_cuts_s * elastic.after_cuts_s);
        let mut limiting = elastic.tet;
        for tet in tets() {
            let nodes = mesh.tetrahedra[tet.index()];
            if nodes.iter().any(|n| ligaments_n_per_m[n.index()] > 0.0) {
                let of_tet = squared_frequency(tet, corner_kg(tet))?;
                if of_tet > after_cuts {
                    (after_cuts, limiting) = (of_tet, tet);
                }
            }
        }
        let beta = body.damping.stiffness_s;
        let longest_s = |squared_frequency: f64| {
            let square = SQUARED_LIMIT / squared_frequency;
            square / ((beta * beta + square).sqrt() + beta)
        };
        let step_s = longest_s(uncut).max(longest_s(after_cuts));
        let step = StableStep { step_s, after_cuts_s: longest_s(after_cuts), tet: limiting };
        let shortest_s = body.time_step_s / f64::from(body.most_parts);
        let mut scaled = Vec::new();
        if step.after_cuts_s < shortest_s && shortest_s <= step_s {
            let allowed = SQUARED_LIMIT / (shortest_s * shortest_s + 2.0 * beta * shortest_s);
            for tet in tets() {
                let own_kg = corner_kg(tet);
                let of_tet = squared_frequency(tet, own_kg)?;
                if of_tet > allowed {
                    scaled.push(ScaledTet { tet, corner_kg: own_kg * (of_tet / allowed - 1.0) });
                }
            }
        }
        let after_cuts_s = if scaled.is_empty() { step.after_cuts_s } else { shortest_s };
        Ok(Self { step, after_cuts_s, scaling: MassScaling::of_tets(scaled, mesh.positions_m.len()) })
    }
}

impl MassScaling {
    fn of_tets(tets: Vec<ScaledTet>, n_nodes: usize) -> Self {
        Self { tets, added_kg: vec![0.0; n_nodes], n_scaled: vec![0; n_nodes], n_nodes: 0 }
    }

    /// The body is cut from now on: the limiting tetrahedra among the live ones become heavier.
    pub(super) fn apply(&mut self, mesh: &TetMesh, kernel: &mut FastKernel) {
        for i in 0..self.tets.len() {
            let ScaledTet { tet, corner_kg } = self.tets[i];
            for node in mesh.tetrahedra[tet.index()] {
                self.change(kernel, node, corner_kg, 1);
            }
        }
    }

    /// A tetrahedron was removed: what it added goes.
    pub(super) fn remove_tet(&mut self, mesh: &TetMesh, tet: TetId, kernel: &mut FastKernel) {
        let Ok(at) = self.tets.binary_search_by_key(&tet, |scaled| scaled.tet) else { return };
        let corner_kg = std::mem::replace(&mut self.tets[at].corner_kg, 0.0);
        for node in mesh.tetrahedra[tet.index()] {
            self.change(kernel, node, -corner_kg, -1);
        }
    }

    fn change(&mut self, kernel: &mut FastKernel, node: NodeId, added_kg: f64, tets: i32) {
        let n = node.index();
        let before = self.n_scaled[n];
        self.n_scaled[n] = before.saturating_add_signed(tets);
        self.added_kg[n] = if self.n_scaled[n] > 0 { self.added_kg[n] + added_kg } else { 0.0 };
        self.n_nodes = self.n_nodes + u32::from(before == 0) - u32::from(self.n_scaled[n] == 0);
        kernel.set_added_mass(node, self.added_kg[n]);
    }

    /// The same tetrahedra under new ids, not yet applied.
    pub(super) fn renumbered(&self, new_tets: &[Option<TetId>], n_nodes: usize) -> Self {
        let moved = |scaled: &ScaledTet| new_tets[scaled.tet.index()].map(|tet| ScaledTet { tet, ..*scaled });
        Self::of_tets(self.tets.iter().filter_map(moved).collect(), n_nodes)
    }
}
