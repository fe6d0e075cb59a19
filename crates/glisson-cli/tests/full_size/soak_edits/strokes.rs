//! Removals, finer regions and strokes, planned by the library and made as edits.

use super::before::Volume;
use super::patient::Patient;
use super::tally::reason;
use glisson::math::DVec3;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::refine::{FineRegion, refining};
use glisson::mesh::repair::{MendParams, mending};
use glisson::mesh::topology::SingularEntities;
use glisson::mesh::{NodeId, TetId};
use glisson::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use glisson::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};

impl Patient<'_> {
    /// Takes out tetrahedra and parts what then hangs together by a node or an edge alone; answers whether it was done.
    fn take_out(&mut self, tets: Vec<TetId>) -> bool {
        let mut copy = self.world.organ().body().clone();
        let removed_m3 = tets.iter().map(|&t| copy.mesh().tet_volume_m3(t)).sum();
        let edits = copy.parting_removal(tets).unwrap_or_else(|e| panic!("{}: {e}", self.label()));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        let before = singular_places(&copy);
        let mut done = self.edit(&edits, Volume::Removed(removed_m3));
        let is_parted = done && edits.len() > 1;
        if !(done || edits.len() == 1 || self.draw.follows_all()) {
            // As the world does for its tools: the removal alone.
            done = self.edit(&edits[..1], Volume::Removed(removed_m3));
        }
        self.tally.partings += u64::from(is_parted);
        if done && self.draw.follows_all() {
            let after = singular_places(self.world.organ().body());
            // Where two cuts meet there may be an edge of this kind from before.
            assert!(
                after.nodes.len() <= before.nodes.len() && after.edges.len() <= before.edges.len(),
                "{}: singular places left: {after:?}",
                self.label()
            );
        }
        done
    }

    /// Takes out some tetrahedra around a place.
    pub(super) fn remove(&mut self) {
        let Some((place_m, _)) = self.place() else { return };
        let reach_m = self.mean_edge_m * self.random.uniform_in(0.3, 1.2);
        let body = self.world.organ().body();
        let positions_m = self.world.state().positions_m;
        let tets: Vec<TetId> = body
            .topology()
            .live_tets()
            .filter(|&t| {
                let corners = body.topology().tet_nodes(t).map(|n| positions_m[n.index()]);
                (corners.into_iter().sum::<DVec3>() / 4.0).distance(place_m) < reach_m
            })
            .collect();
        if tets.is_empty() {
            return;
        }
        if self.take_out(tets) {
            self.tally.removals += 1;
        }
    }

    /// Makes the mesh finer around a place.
    pub(super) fn refine(&mut self) {
        let n = self.world.organ().surface_nodes().len();
        if n == 0 {
            return;
        }
        let at = self.index(n);
        let mut copy = self.world.organ().body().clone();
        let center_m = copy.mesh().positions_m[self.world.organ().surface_nodes()[at].index()];
        let (radius_m, edge_m) =
            (1.5 * self.mean_edge_m, self.mean_edge_m * self.random.uniform_in(0.6, 1.0));
        let region = FineRegion { center_m, radius_m, edge_m };
        let edits = refining(&mut copy, &region).unwrap_or_else(|e| panic!("{}: {e}", self.label()));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        if !edits.is_empty() && self.edit(&edits, Volume::Kept) {
            self.tally.refinements += 1;
        }
    }

    /// A blade's ends along a random stroke through the surface.
    pub(super) fn stroke(&mut self) -> Option<Vec<[DVec3; 2]>> {
        let (place_m, normal) = self.place()?;
        let along = self.way_along(normal);
        let depth_m = self.mean_edge_m * self.random.uniform_in(0.5, 3.0);
        let length_m = self.mean_edge_m * self.random.uniform_in(1.0, 6.0);
        let n = (length_m / (0.8 * self.mean_edge_m)).ceil() as u32;
        let lean = normal + along * self.random.uniform_in(-0.5, 0.5);
        Some(
            (0..=n)
                .map(|i| {
                    let at_m = place_m + along * (length_m * (f64::from(i) / f64::from(n) - 0.5));
                    [at_m - lean * depth_m, at_m + lean * 2.0 * self.mean_edge_m]
                })
                .collect(),
        )
    }

    /// Cuts by subdivision.
    pub(super) fn blade(&mut self) {
        let Some(stroke) = self.stroke() else { return };
        self.tally.blade_strokes += 1;
        self.touched.clear();
        let mut cut = SubdivisionCut::new(SubdivisionParams::for_mean_edge(self.mean_edge_m));
        let last = stroke.len() - 1;
        for (i, &blade_m) in stroke.iter().enumerate() {
            let body = self.world.organ().body();
            let positions_m = self.world.state().positions_m;
            let nodes = (0..positions_m.len()).map(NodeId::from_index);
            cut.hold_still(nodes.map(|n| self.attached.is_anchored(n)));
            let step = if i == last {
                cut.finish(body, positions_m, blade_m)
            } else {
                cut.advance(body, positions_m, blade_m)
            };
            match step {
                Ok(Some(replacement)) => {
                    if self.edit(&[MeshEdit::Replace(replacement)], Volume::Kept) {
                        self.tally.blade_edits += 1;
                    } else {
                        cut.take_back();
                    }
                }
                Ok(None) => {}
                Err(refusal) => self.tally.refuse(&reason(&refusal)),
            }
        }
        self.finish_stroke();
    }

    /// Cuts by vertex displacement.
    pub(super) fn scalpel(&mut self) {
        let Some(stroke) = self.stroke() else { return };
        self.tally.scalpel_strokes += 1;
        self.touched.clear();
        self.displace_along(&stroke);
        self.finish_stroke();
    }

    fn displace_along(&mut self, stroke: &[[DVec3; 2]]) {
        let mut cut = ScalpelCut::new(ScalpelParams::default());
        for i in 0..=stroke.len() {
            loop {
                let body = self.world.organ().body();
                let positions_m = self.world.state().positions_m;
                let step = match stroke.get(i) {
                    Some(&blade_m) => cut.advance(body, positions_m, blade_m),
                    None => cut.finish(body, positions_m),
                };
                match step {
                    Ok(Some(edits)) if edits.is_empty() => {}
                    Ok(Some(edits)) => {
                        if !self.edit(&edits, Volume::Kept) {
                            return;
                        }
                        self.tally.scalpel_edits += 1;
                    }
                    Ok(None) => break,
                    Err(refusal) => {
                        self.tally.refuse(&reason(&refusal));
                        return;
                    }
                }
            }
        }
    }

    /// What the world does when an edge is lifted: parts what hangs together by a node or an edge alone, and mends the worst
    /// tetrahedra near the cut. A model that follows removals alone keeps such places.
    fn finish_stroke(&mut self) {
        if !self.draw.follows_all() {
            return;
        }
        let mut copy = self.world.organ().body().clone();
        let touched: Vec<NodeId> = std::mem::take(&mut self.touched);
        let live = |body: &EditableMesh, nodes: &[NodeId]| {
            let mut nodes: Vec<NodeId> =
                nodes.iter().copied().filter(|&n| body.topology().is_live_node(n)).collect();
            nodes.sort_unstable();
            nodes.dedup();
            nodes
        };
        let edits = copy.parting_edits(live(&copy, &touched));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        if !edits.is_empty() && self.edit(&edits, Volume::Kept) {
            self.tally.stroke_partings += 1;
        }
        self.check_singular();
        let mut copy = self.world.organ().body().clone();
        let topology = copy.topology();
        let near = live(&copy, &touched);
        let tets: Vec<TetId> = near.iter().flat_map(|&n| topology.node_tets(n)).copied().collect();
        let mending = mending(&mut copy, &tets, &MendParams::default(), &|n| self.attached.is_anchored(n));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        self.tally.bad_tets += mending.n_bad as u64;
        if !mending.edits.is_empty() && self.edit(&mending.edits, Volume::Kept) {
            self.tally.mendings += 1;
            self.tally.mended_places += (mending.n_remeshed + mending.n_collapsed) as u64;
        }
        self.check_singular();
    }

    /// The same at all places that hang together by a node or an edge alone.
    pub(super) fn finish_stroke_at_singular_places(&mut self) {
        let body = self.world.organ().body();
        let places = singular_places(body);
        let ends = places.edges.iter().flat_map(|&edge| body.topology().edge_nodes(edge));
        self.touched = places.nodes.iter().copied().chain(ends).collect();
        self.finish_stroke();
    }

    /// At the end of a stroke nothing hangs together by a node or an edge alone, but for edges too short to be divided, which
    /// are counted.
    pub(super) fn check_singular(&mut self) {
        if !self.draw.follows_all() {
            return;
        }
        let left = singular_places(self.world.organ().body());
        if left.is_empty() {
            self.left.clear();
            return;
        }
        let mut copy = self.world.organ().body().clone();
        let edge_nodes = |edge| copy.topology().edge_nodes(edge);
        let (known, new): (Vec<_>, Vec<_>) =
            left.edges.iter().map(|&edge| edge_nodes(edge)).partition(|nodes| self.left.contains(nodes));
        self.tally.singular_left += new.len() as u64;
        // Not the known ones: what was too short at an earlier stroke may have been mended since, and no stroke came by it.
        let places: Vec<NodeId> = left.nodes.iter().copied().chain(new.iter().flatten().copied()).collect();
        let edits = copy.parting_edits(places);
        assert!(edits.is_empty(), "{}: singular places left: {left:?}", self.label());
        self.left = [known, new].concat();
    }
}

fn singular_places(body: &EditableMesh) -> SingularEntities {
    let topology = body.topology();
    topology.singular_entities(&topology.live_nodes().collect::<Vec<_>>())
}
