//! Contacts solved on their Delassus operator: the same conditions, order and sweeps as [`super::constraint::solve`], with the
//! bodies' vertices eliminated first.
//!
//! A force on contact j moves contact i by `W_ij = sum_ab L_a^T C_ab L_b`, over the vertices a of i and b of j, with C the bodies'
//! compliance and L what a unit force of the contact does at a vertex: its weight, or the torque of a vertex that turns. Sweeps then
//! cost nine products for each pair of contacts, whatever the number of vertices, and the vertices are moved once at the end. It
//! pays where many contacts share bodies that answer as a whole.

use super::constraint::{
    Contact, Response, SweepReport, Sweeps, delassus_block, relaxed_n, solve, stiffness_of, sweep,
};
use crate::math::{DMat3, DVec3};
use fearless_simd::{Level, dispatch};

/// The operator of the contacts that are solved, with room for the most.
#[derive(Debug)]
pub struct Delassus {
    most: usize,
    /// Columns of the operator [m/N]: for each axis of a force on contact j the displacements of all contacts along x, then along y,
    /// then along z, so that many are changed at once.
    columns_m_per_n: Vec<f64>,
    /// The same of contact j on itself.
    own_m_per_n: Vec<DMat3>,
    /// Relative displacements of the contacts [m]: along x, along y, along z.
    relative_m: Vec<f64>,
    /// Forces at the start [N].
    start_n: Vec<DVec3>,
}

impl Delassus {
    /// For up to so many contacts; more are solved vertex by vertex.
    pub fn with_room_for(most: usize) -> Self {
        Self {
            most,
            columns_m_per_n: Vec::with_capacity(9 * most * most),
            own_m_per_n: Vec::with_capacity(most),
            relative_m: Vec::with_capacity(3 * most),
            start_n: Vec::with_capacity(most),
        }
    }

    /// Finds the forces of `contacts`, starting from those that they have and that `moves_m` already answers to; adds what they
    /// change to `moves_m` [m]. Never fails, never allocates.
    pub fn solve(
        &mut self,
        contacts: &mut [Contact],
        response: &Response,
        sweeps: Sweeps,
        moves_m: &mut [DVec3],
    ) -> SweepReport {
        let n = contacts.len();
        if n > self.most {
            return solve(contacts, response, sweeps, moves_m);
        }
        dispatch!(Level::new(), _simd => self.assemble(contacts, response, moves_m));
        for (contact, own) in contacts.iter_mut().zip(&self.own_m_per_n) {
            contact.stiffness_n_per_m = stiffness_of(own, contact.normal);
        }
        // The same operations in the same order on every processor.
        let report = dispatch!(Level::new(), _simd => sweep(n, sweeps, |place| self.relax(&mut contacts[place], place)));
        for (contact, start_n) in contacts.iter().zip(&self.start_n) {
            let by_n = contact.force_n - *start_n;
            if by_n != DVec3::ZERO {
                contact.push(by_n, response, moves_m);
            }
        }
        report
    }

    #[inline(always)]
    fn assemble(&mut self, contacts: &[Contact], response: &Response, moves_m: &[DVec3]) {
        let n = contacts.len();
        self.relative_m.clear();
        self.relative_m.resize(3 * n, 0.0);
        for (i, contact) in contacts.iter().enumerate() {
            for (axis, relative_m) in contact.relative_m(moves_m).to_array().into_iter().enumerate() {
                self.relative_m[axis * n + i] = relative_m;
            }
        }
        self.start_n.clear();
        self.start_n.extend(contacts.iter().map(|contact| contact.force_n));
        self.columns_m_per_n.clear();
        self.columns_m_per_n.resize(9 * n * n, 0.0);
        self.own_m_per_n.clear();
        for (j, by) in contacts.iter().enumerate() {
            for (i, of) in contacts.iter().enumerate().take(j + 1) {
                let block = delassus_block(of, by, response);
                self.set_block(n, [i, j], &block);
                // Bodies are elastic: their compliance is symmetric.
                self.set_block(n, [j, i], &block.transpose());
                if i == j {
                    self.own_m_per_n.push(block);
                }
            }
        }
    }

    #[inline(always)]
    fn set_block(&mut self, n: usize, [of, by]: [usize; 2], block: &DMat3) {
        for along in 0..3 {
            for (axis, entry) in block.col(along).to_array().into_iter().enumerate() {
                self.columns_m_per_n[(3 * by + along) * 3 * n + axis * n + of] = entry;
            }
        }
    }

    /// Solves one contact; answers its force and the change of it [N].
    #[inline(always)]
    fn relax(&mut self, contact: &mut Contact, place: usize) -> [DVec3; 2] {
        let n = self.own_m_per_n.len();
        let u = DVec3::from_array([0, 1, 2].map(|axis| self.relative_m[axis * n + place]));
        let [force_n, _] = relaxed_n(contact, u, |by_n| u + self.own_m_per_n[place] * by_n);
        let by_n = force_n - contact.force_n;
        contact.force_n = force_n;
        if by_n != DVec3::ZERO {
            let columns = &self.columns_m_per_n[9 * n * place..9 * n * (place + 1)];
            let (x, yz) = columns.split_at(3 * n);
            let (y, z) = yz.split_at(3 * n);
            for (((relative_m, x), y), z) in self.relative_m.iter_mut().zip(x).zip(y).zip(z) {
                *relative_m += x * by_n.x + y * by_n.y + z * by_n.z;
            }
        }
        [force_n, by_n]
    }
}

#[cfg(test)]
mod tests {
    use super::super::constraint::{ContactKey, Turn};
    use super::*;
    use crate::math::{SeededRandom, outer};

    const N_NODES: u32 = 12;
    /// Of two instruments: how they move, and how they turn.
    const TOOLS: [[u32; 2]; 2] = [[12, 13], [14, 15]];

    fn vector(random: &mut SeededRandom) -> DVec3 {
        DVec3::from_array([0; 3].map(|_| random.uniform_in(-1.0, 1.0)))
    }

    /// Nodes that answer as one body, an instrument whose turning is coupled to its moving, and one that turns by itself.
    fn response(random: &mut SeededRandom) -> Response {
        let mut response = Response::new(16, 3);
        let mut coupled = |group: usize, vertices: std::ops::Range<u32>| {
            let n = vertices.len();
            response.set_group(group, vertices);
            let mut blocks = vec![DMat3::ZERO; n * n];
            // A sum of squares is symmetric and positive.
            for _ in 0..4 * n {
                let v: Vec<DVec3> = (0..n).map(|_| vector(&mut *random)).collect();
                for column in 0..n {
                    for row in 0..n {
                        blocks[column * n + row] += outer(v[row], v[column]) * 1e-3;
                    }
                }
            }
            response.group_mut(group).compliance_m_per_n = blocks;
        };
        coupled(0, 0..N_NODES);
        coupled(1, TOOLS[0][0]..TOOLS[0][1] + 1);
        response.set_alone(TOOLS[1][0], DVec3::splat(2e-3));
        response.set_alone(TOOLS[1][1], DVec3::splat(0.1));
        response
    }

    fn contacts(random: &mut SeededRandom) -> Vec<Contact> {
        let made = (0..10_u32).map(|i| {
            let normal = vector(&mut *random).normalize();
            let key = ContactKey::VertexObstacle(i, 0);
            let mut contact = Contact::new(key, normal, 0.0);
            let [tip, turn] = TOOLS[i as usize % 2];
            contact.vertices = [i % N_NODES, (i + 3) % N_NODES, (i + 7) % N_NODES, tip];
            contact.weights = [0.5, 0.3, 0.2, -1.0];
            contact.turns[0] = Turn { vertex: turn, arm_m: vector(&mut *random) * 0.1 }.of_second();
            contact.moved_m = vector(&mut *random) * 1e-3;
            contact.friction = [0.0, 0.3, 1.0][i as usize % 3];
            contact.sticks = i == 4;
            contact.force_n = contact.into_cone(vector(&mut *random));
            contact
        });
        made.collect()
    }

    #[test]
    fn forces_and_motions_are_those_of_the_sweeps_over_vertices() {
        for seed in 0..20 {
            let mut random = SeededRandom::new(seed);
            let response = response(&mut random);
            let mut expected = contacts(&mut random);
            let mut moves_m = vec![DVec3::ZERO; 16];
            expected.iter().for_each(|contact| contact.push(contact.force_n, &response, &mut moves_m));
            let (mut found, mut found_m) = (expected.clone(), moves_m.clone());
            for sweeps in [Sweeps { most: 1, tolerance: 0.0 }, Sweeps { most: 200, tolerance: 1e-10 }] {
                let of_vertices = solve(&mut expected, &response, sweeps, &mut moves_m);
                let of_contacts =
                    Delassus::with_room_for(10).solve(&mut found, &response, sweeps, &mut found_m);
                let most_n = expected.iter().map(|c| c.force_n.length()).fold(0.0, f64::max);
                for (a, b) in expected.iter().zip(&found) {
                    assert!(a.force_n.distance(b.force_n) < 1e-7 * most_n, "{seed} {sweeps:?}: {a:?} {b:?}");
                }
                for (a, b) in moves_m.iter().zip(&found_m) {
                    assert!(a.distance(*b) < 1e-8, "{seed} {sweeps:?}: {a} {b}");
                }
                assert!(of_vertices.n_sweeps.abs_diff(of_contacts.n_sweeps) <= 1, "{seed}");
            }
        }
    }

    #[test]
    fn more_contacts_than_there_is_room_for_are_solved_all_the_same() {
        let mut random = SeededRandom::new(3);
        let response = response(&mut random);
        let mut expected = contacts(&mut random);
        let mut found = expected.clone();
        let mut moves_m = vec![DVec3::ZERO; 16];
        let mut found_m = moves_m.clone();
        let sweeps = Sweeps { most: 5, tolerance: 0.0 };
        solve(&mut expected, &response, sweeps, &mut moves_m);
        Delassus::with_room_for(3).solve(&mut found, &response, sweeps, &mut found_m);
        assert_eq!((expected, moves_m), (found, found_m));
    }
}
