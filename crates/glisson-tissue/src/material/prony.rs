//! Linear viscoelastic stress on any elastic law: a Prony series with one history a term.
//!
//! P(t) = P_e(t) - sum_k g_k integral_0^t (1 - exp(-(t - s)/tau_k)) dP_e(s)/ds ds, where P_e is the law's
//! stress of F(t) (convolution on the elastic stress, Miller and Chinzei 2002,
//! doi 10.1016/S0021-9290(01)00234-2). Equally P = (1 - sum g_k) P_e + sum g_k h_k with the histories
//! dh_k/dt = dP_e/dt - h_k/tau_k. Relaxation after a step: G(t)/G(0) = 1 - sum g_k (1 - exp(-t/tau_k)).
//!
//! The recursion over a step dt (as Kaliske and Rothert, Computational Mechanics 19:228-239, 1997)
//!
//! h_k(t + dt) = e h_k(t) + (tau_k/dt)(1 - e) (P_e(t + dt) - P_e(t)), e = exp(-dt/tau_k),
//!
//! is exact when P_e is linear in time within the step. The volumetric part of P_e relaxes with the rest.
//! P_e is the first Piola-Kirchhoff stress: histories turn with the body only if the convolution is done on
//! P rotated back, so a caller with large rotations between steps passes F^-1 P (second Piola-Kirchhoff), on
//! which the same recursion acts.
//! g_k >= 0 without unit, sum g_k < 1; tau_k > 0 [s].

use super::MaterialError;
use glisson_mesh::math::DMat3;

/// One exponential of a Prony series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PronyTerm {
    /// g: share of the instantaneous stiffness that relaxes.
    pub share: f64,
    /// tau: relaxation time [s].
    pub time_s: f64,
}

impl PronyTerm {
    /// g, exp(-h/tau) and (tau/h)(1 - exp(-h/tau)) of the recursion for steps of h = `step_s` > 0.
    pub(crate) fn recursion(&self, step_s: f64) -> [f64; 3] {
        let lost = -libm::expm1(-step_s / self.time_s);
        [self.share, 1.0 - lost, lost * self.time_s / step_s]
    }
}

/// A relaxation series.
///
/// ```
/// use glisson_tissue::material::{PronySeries, PronyTerm};
/// let brain = PronySeries::new(&[
///     PronyTerm { share: 0.450, time_s: 0.5 },
///     PronyTerm { share: 0.365, time_s: 50.0 },
/// ])?;
/// assert!((brain.relaxation(1.0) - 0.6037).abs() < 5e-5);
/// # Ok::<(), glisson_tissue::material::MaterialError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct PronySeries {
    terms: Vec<PronyTerm>,
}

/// The state of one tetrahedron: it belongs to the simulated state (snapshot, hash, remapping), not to the law.
#[derive(Clone, Debug, PartialEq)]
pub struct PronyHistory {
    /// Elastic stress at the end of the last step [Pa].
    pub elastic_pa: DMat3,
    /// h_k of each term [Pa].
    pub terms_pa: Vec<DMat3>,
}

/// The recursion's two numbers of each term for one step length; made once for a fixed step.
#[derive(Clone, Debug, PartialEq)]
pub struct PronyStep {
    /// 1 - sum g_k.
    lasting_share: f64,
    /// g_k, exp(-dt/tau_k) and (tau_k/dt)(1 - exp(-dt/tau_k)).
    terms: Vec<[f64; 3]>,
}

impl PronySeries {
    /// The series of its terms.
    ///
    /// # Errors
    /// [`MaterialError::Parameter`] unless every share is at least 0, their sum below 1 and every time positive.
    pub fn new(terms: &[PronyTerm]) -> Result<Self, MaterialError> {
        let refuse =
            |name, found, allowed| Err(MaterialError::Parameter { law: "prony", name, found, allowed });
        let mut sum = 0.0;
        for term in terms {
            if !(term.share.is_finite() && term.share >= 0.0) {
                return refuse("g", term.share, "0 or more");
            }
            if !(term.time_s.is_finite() && term.time_s > 0.0) {
                return refuse("tau", term.time_s, "a finite number of seconds above 0");
            }
            sum += term.share;
        }
        if sum >= 1.0 {
            return refuse("sum of g", sum, "below 1 (a solid keeps some stiffness)");
        }
        Ok(Self { terms: terms.to_vec() })
    }

    /// Its terms.
    pub fn terms(&self) -> &[PronyTerm] {
        &self.terms
    }

    /// G(t)/G(0) after a step of strain, `time_s` >= 0.
    pub fn relaxation(&self, time_s: f64) -> f64 {
        1.0 + self.terms.iter().map(|k| k.share * libm::expm1(-time_s / k.time_s)).sum::<f64>()
    }

    /// A body that has been at rest for ever.
    pub fn rest(&self) -> PronyHistory {
        PronyHistory { elastic_pa: DMat3::ZERO, terms_pa: vec![DMat3::ZERO; self.terms.len()] }
    }

    /// The recursion for steps of `step_s` > 0.
    pub fn step(&self, step_s: f64) -> PronyStep {
        let mut step = PronyStep { lasting_share: 1.0, terms: Vec::with_capacity(self.terms.len()) };
        self.step_into(step_s, &mut step);
        step
    }

    /// Overwrites the recursion of this series with the one for steps of `step_s` > 0; no allocation.
    pub fn step_into(&self, step_s: f64, step: &mut PronyStep) {
        step.lasting_share = 1.0 - self.terms.iter().map(|k| k.share).sum::<f64>();
        step.terms.clear();
        step.terms.extend(self.terms.iter().map(|k| k.recursion(step_s)));
    }
}

impl PronyStep {
    /// Stress [Pa] at the end of a step that ends with the elastic stress `elastic_pa`; the history stays.
    pub fn stress_pa(&self, history: &PronyHistory, elastic_pa: &DMat3) -> DMat3 {
        let change = *elastic_pa - history.elastic_pa;
        let mut stress = *elastic_pa * self.lasting_share;
        for (&[share, kept, gained], h) in self.terms.iter().zip(&history.terms_pa) {
            stress += (*h * kept + change * gained) * share;
        }
        stress
    }

    /// d(stress)/d(elastic stress): what an implicit step multiplies the law's tangent by.
    pub fn tangent_factor(&self) -> f64 {
        self.lasting_share + self.terms.iter().map(|&[share, _, gained]| share * gained).sum::<f64>()
    }

    /// Takes the history to the end of that step; no allocation.
    pub fn advance(&self, history: &mut PronyHistory, elastic_pa: &DMat3) {
        let change = *elastic_pa - history.elastic_pa;
        for (&[_, kept, gained], h) in self.terms.iter().zip(&mut history.terms_pa) {
            *h = *h * kept + change * gained;
        }
        history.elastic_pa = *elastic_pa;
    }
}
