//! The factor of an edited mesh: made in stages, one a step, while the old one serves ([`super::late`]).
//!
//! First come edges, then order of elimination and pattern of the matrix, then the pattern of the factor and the plan by which it
//! is made; each takes up to two milliseconds for 6,000 tetrahedra. Then its values follow in the slices of [`Lagged::advance`], for the state at the first of them.
//! An edit that comes meanwhile begins anew. What a stage does follows from the mesh alone, so that the bits are the same
//! whenever steps are made. Stages allocate: they are work of the edit that is put off.

use super::direct::Direct;
use super::lagged::{Lagged, Slice, Solver, system_of};
use super::lagged_state::{Edited, LaggedState};
use crate::solve::{FactorPattern, FreeSystem, MeshEdges, TwoGrid};

#[derive(Clone, Default)]
enum Stage {
    #[default]
    Edges,
    System(MeshEdges),
    Pattern(MeshEdges, FreeSystem),
    Plan(MeshEdges, (FreeSystem, FactorPattern)),
    Values(Box<Lagged>),
}

/// The stages done so far.
#[derive(Clone, Default)]
pub(super) struct Successor {
    stage: Stage,
    /// Whether the present shape had no factor: that of the rest shape is made.
    is_of_rest: bool,
}

impl Successor {
    /// Makes the next stage or slice; gives the factor when its values are there. `now` is asked for the state that these are
    /// made for. Where there is no factor, all begins anew for the rest shape.
    pub(super) fn advance(
        &mut self,
        edited: &Edited<'_>,
        now: impl FnOnce() -> LaggedState,
    ) -> Option<Box<Lagged>> {
        let next = match std::mem::take(&mut self.stage) {
            Stage::Edges => Ok(Stage::System(edited.edges())),
            Stage::System(edges) if edited.preconditioner.is_two_grid(edited.free_axes) => {
                let grids = TwoGrid::new(edited.terms.rest_m, &edges, edited.free_axes);
                grids.map(|grids| self.ordered((edges, Solver::TwoGrid(Box::new(grids))), edited, now))
            }
            Stage::System(edges) => {
                system_of(&edges, edited.free_axes).map(|system| Stage::Pattern(edges, system))
            }
            Stage::Pattern(edges, system) => {
                system.pattern_of_factor().map(|pattern| Stage::Plan(edges, (system, pattern)))
            }
            Stage::Plan(edges, (system, pattern)) => Direct::new(system, pattern)
                .map(|direct| self.ordered((edges, Solver::Direct(Box::new(direct))), edited, now)),
            Stage::Values(mut lagged) => match lagged.advance(edited.elements, edited.terms) {
                Slice::Underway => Ok(Stage::Values(lagged)),
                Slice::Serves => {
                    lagged.complete();
                    return Some(lagged);
                }
                Slice::Failed => {
                    self.is_of_rest = true;
                    Ok(Stage::Edges)
                }
            },
        };
        self.stage = next.unwrap_or_default();
        None
    }

    /// The values are next.
    fn ordered(
        &self,
        (edges, solver): (MeshEdges, Solver),
        edited: &Edited<'_>,
        now: impl FnOnce() -> LaggedState,
    ) -> Stage {
        let state = if self.is_of_rest { now().at_rest() } else { now() };
        let mut lagged = Lagged::without_values(edges, solver, edited.elements, state);
        lagged.order();
        Stage::Values(Box::new(lagged))
    }

    /// How far it is, and what the values are made for.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let (stage, lagged) = match &self.stage {
            Stage::Edges => (0, None),
            Stage::System(_) => (1, None),
            Stage::Pattern(..) => (2, None),
            Stage::Plan(..) => (3, None),
            Stage::Values(lagged) => (4, Some(lagged)),
        };
        let of_values = lagged.into_iter().flat_map(|lagged| {
            let n_slices = lagged.pending().map_or(0, |pending| pending.n_slices);
            lagged.state.numbers().chain(std::iter::once(f64::from(n_slices)))
        });
        [f64::from(stage), f64::from(u8::from(self.is_of_rest))].into_iter().chain(of_values)
    }
}
