//! Edits with what is checked after each, and how they are undone.

use super::attached::{Memory, check_parents};
use super::before::{Before, LastEdit, Volume};
use super::checks::{Plain, against_plain, check_adjacency, measured};
use super::draw::Depth;
use super::patient::Patient;
use super::substance::DENSITY_KG_PER_M3;
use super::tally::reason;
use glisson::math::DVec3;
use glisson::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use glisson::mesh::quality::dihedral_cosine_range;
use glisson::mesh::{NodeId, TetId};
use glisson::world::EditRefusal;

/// Steps after an edit.
const STEPS_AFTER: u64 = 3;

impl Patient<'_> {
    pub(super) fn volume_m3(&self) -> f64 {
        self.world.organ().body().volume_m3()
    }

    pub(super) fn before(&self) -> Before {
        Before {
            volume_m3: self.volume_m3(),
            rest_m: self.world.organ().mesh().positions_m.clone(),
            memory: self.draw.shows_memory().then(|| Memory::of(&self.world)),
            attached: self.attached.clone(),
            mass_kg: self.mass_kg,
        }
    }

    /// As if what came since had not been: it was undone.
    pub(super) fn go_back_to(&mut self, before: Before) {
        self.attached = before.attached;
        self.mass_kg = before.mass_kg;
    }

    /// Whether everything attached is as it has to be.
    pub(super) fn check_attached(&mut self, label: &str) {
        self.attached.check(&self.world, label);
        self.check_forces_and_masses(self.mass_kg);
    }

    /// Keeps what it takes to take `n_edits` edits back after more steps.
    pub(super) fn keep_last(&mut self, before: Before, n_edits: usize) {
        self.last_edit = Some(LastEdit { before, n_edits });
    }

    /// Undoes the last edit, steps after it was made: rest shape, tetrahedra and everything attached are as before it.
    pub(super) fn take_back_late(&mut self) {
        let Some(LastEdit { before, n_edits }) = self.last_edit.take() else { return };
        if self.world.n_edits_to_undo() < n_edits {
            return;
        }
        let label = self.label();
        for _ in 0..n_edits {
            assert!(self.world.undo_edit(), "{label}: cannot be undone");
        }
        let bits =
            |list: &[DVec3]| list.iter().flat_map(|p| p.to_array()).map(f64::to_bits).collect::<Vec<_>>();
        let rest_m = &self.world.organ().mesh().positions_m;
        assert_eq!(bits(rest_m), bits(&before.rest_m), "{label}: undone late");
        assert_eq!(self.volume_m3().to_bits(), before.volume_m3.to_bits(), "{label}: undone late");
        self.go_back_to(before);
        check_adjacency(&self.world, &label);
        self.check_attached(&label);
        self.tally.undone += n_edits as u64;
        self.tally.undone_late += 1;
        self.rest_after_edit();
        // What was parted hangs together again, and no later stroke comes by here.
        self.finish_stroke_at_singular_places();
    }

    pub(super) fn rest_after_edit(&mut self) {
        for _ in 0..STEPS_AFTER {
            self.step(&self.away.clone(), true);
        }
    }

    /// Checks everything that an edit, or the few of one call of the tools, must not break.
    pub(super) fn check(
        &mut self,
        before: &Before,
        volume: Volume,
        changes: &[TopologyChange],
        is_mended: bool,
    ) {
        let label = self.label();
        let removed_m3 = self.check_volumes(before, volume, changes, &label);
        self.check_followers(before, changes, is_mended, &label);
        let topology = self.world.organ().body().topology();
        self.touched.extend(changes.iter().flat_map(|change| topology.nodes_near(change)));
        let last = changes.last().expect("something changed");
        let n_nodes = topology.n_nodes();
        assert_eq!(self.world.state().positions_m.len(), n_nodes, "{label}");
        assert_eq!(self.world.organ().live_tetrahedra().len(), topology.n_tets(), "{label}");
        assert_eq!((last.nodes.n_after, last.tets.n_after), (n_nodes, topology.n_tets()), "{label}");
        if topology.live_counts().tets == 0 {
            self.mass_kg = 0.0;
            return;
        }
        check_adjacency(&self.world, &label);
        let new_dihedral = least_new_dihedral_deg(self.world.organ().body(), changes);
        new_dihedral.into_iter().for_each(|angle_deg| self.tally.note_dihedral(angle_deg));
        self.check_forces_and_masses(before.mass_kg - removed_m3 * DENSITY_KG_PER_M3);
    }

    /// Orientation of all tetrahedra, and the volume; answers what was taken out [m3].
    fn check_volumes(&self, before: &Before, volume: Volume, changes: &[TopologyChange], label: &str) -> f64 {
        let body = self.world.organ().body();
        for tet in body.topology().live_tets() {
            assert!(body.mesh().tet_volume_m3(tet) > 0.0, "{label}: {tet} is turned inside out");
        }
        let now_m3 = self.volume_m3();
        let removed_m3 = match volume {
            Volume::Removed(removed_m3) => removed_m3,
            Volume::Kept => 0.0,
            Volume::Taken { n_tets, n_changes_before } => {
                let taken: Vec<TetId> =
                    changes[n_changes_before..].iter().flat_map(without_descendants).collect();
                assert_eq!(taken.len(), n_tets, "{label}: tetrahedra that were taken out");
                taken.into_iter().map(|t| body.mesh().tet_volume_m3(t)).sum()
            }
        };
        let expected_m3 = before.volume_m3 - removed_m3;
        assert!(
            (now_m3 - expected_m3).abs() <= 1e-9 * before.volume_m3,
            "{label}: {now_m3} for {expected_m3} m3"
        );
        removed_m3
    }

    /// Everything attached, parents, and the stress memory.
    fn check_followers(&mut self, before: &Before, changes: &[TopologyChange], is_mended: bool, label: &str) {
        for change in changes {
            self.attached.follow(&self.world, change, is_mended);
        }
        for change in changes {
            self.attached.check_skin(&self.world, change, label);
        }
        self.attached.check(&self.world, label);
        if let [change] = changes {
            // What an edge that is pulled together leaves lies where others were.
            if !is_mended {
                check_parents(&before.rest_m, self.world.organ().body(), change, label);
            }
            if let Some(memory) = &before.memory {
                memory.check(&self.world, change, label);
            }
        }
    }

    /// The model's forces and masses at all free nodes against a plain loop over the tetrahedra, and the sum of the masses.
    fn check_forces_and_masses(&mut self, expected_kg: f64) {
        if matches!(self.draw.depth(), Depth::Compliance | Depth::Bits) {
            self.mass_kg = expected_kg;
            return;
        }
        let label = self.label();
        let body = self.world.organ().body();
        let plain = |now_m: &[DVec3]| {
            let (forces_n, masses_kg) = self.attached.plain_forces(body, now_m, &self.substance);
            let at_rest_n = self.attached.ligaments_n(&body.mesh().positions_m);
            let live = || body.topology().live_nodes().map(NodeId::index);
            let is_fixed: Vec<bool> = live().map(|n| self.attached.is_fixed[n]).collect();
            let of_free = |all_n: &[DVec3]| {
                let of_node = |(n, is_fixed): (usize, &bool)| if *is_fixed { DVec3::ZERO } else { all_n[n] };
                live().zip(&is_fixed).map(of_node).collect::<Vec<_>>()
            };
            let (forces_n, at_rest_n) = (of_free(&forces_n), of_free(&at_rest_n));
            Plain { forces_n, at_rest_n, masses_kg: live().map(|n| masses_kg[n]).collect(), is_fixed }
        };
        let model = self.world.copy_of_model();
        let (all_m, _) = measured(&self.world, &body.mesh().positions_m, self.draw.limit());
        let (mut found, mass_kg) = against_plain(body, model, &all_m, plain, &label);
        if self.draw.depth() == Depth::Afresh {
            found.forces = 0.0;
        }
        assert!(found.forces < 1e-9 && found.weights < 1e-9, "{label}: {found:?}");
        assert!(
            (mass_kg - expected_kg).abs() <= 1e-9 * expected_kg,
            "{label}: {mass_kg} for {expected_kg} kg"
        );
        self.mass_kg = mass_kg;
        self.tally.worst_forces = self.tally.worst_forces.max(found.forces);
        self.tally.worst_weights = self.tally.worst_weights.max(found.weights);
    }

    /// One edit or several as one, checked; answers whether it was done.
    pub(super) fn edit(&mut self, edits: &[MeshEdit], volume: Volume) -> bool {
        let before = self.before();
        let hash = self.world.state_hash();
        match self.make(edits) {
            Ok(change) => {
                let is_mended = edits.iter().any(|edit| matches!(edit, MeshEdit::Collapse { .. }));
                self.check(&before, volume, std::slice::from_ref(&change), is_mended);
                // Now and then back again, bit for bit, and once more.
                if self.random.uniform() < 0.1 {
                    let after = self.world.state_hash();
                    assert!(self.world.undo_edit(), "{}: cannot be undone", self.label());
                    assert_eq!(self.world.state_hash(), hash, "{}: undone", self.label());
                    assert_eq!(self.volume_m3().to_bits(), before.volume_m3.to_bits(), "{}", self.label());
                    let again =
                        self.make(edits).unwrap_or_else(|e| panic!("{}: once more: {e}", self.label()));
                    assert_eq!(again, change, "{}", self.label());
                    assert_eq!(self.world.state_hash(), after, "{}: once more", self.label());
                    self.tally.undone += 1;
                }
                self.keep_last(before, 1);
                self.rest_after_edit();
                true
            }
            Err(refusal) => {
                assert_eq!(self.world.state_hash(), hash, "{}: refused, so unchanged", self.label());
                self.tally.refuse(&reason(&refusal));
                false
            }
        }
    }

    fn make(&mut self, edits: &[MeshEdit]) -> Result<TopologyChange, EditRefusal> {
        match edits {
            [edit] => self.world.edit(edit),
            edits => self.world.edit_all(edits),
        }
    }
}

/// Least dihedral angle of a new or reshaped tetrahedron [deg], if there is one.
fn least_new_dihedral_deg(body: &EditableMesh, changes: &[TopologyChange]) -> Option<f64> {
    let new = changes.iter().flat_map(|change| change.tets.added.ids().iter().chain(&change.reshaped_tets));
    new.filter(|t| body.topology().is_live_tet(**t))
        .map(|&t| {
            let [_, largest_cosine] = dihedral_cosine_range(body.mesh().corners_m(t));
            largest_cosine.clamp(-1.0, 1.0).acos().to_degrees()
        })
        .reduce(f64::min)
}

/// Tetrahedra that a change took out without anything in their place.
fn without_descendants(change: &TopologyChange) -> impl Iterator<Item = TetId> + '_ {
    let parents: std::collections::BTreeSet<TetId> =
        change.tets.added.iter().flat_map(|(_, parents)| parents.iter().map(|p| p.0)).collect();
    change.tets.removed.iter().copied().filter(move |t| !parents.contains(t))
}
