//! One step: loads onto the frontier, tools, the dynamic zones, and the positions of everything.

use super::columns::{Columns, dot};
use super::contact::ContactSystem;
use super::interface::Interface;
use super::zone::PrecomputedZone;
use super::{Ages, CondensedHybrid, Held, INSIDE_PERIOD_S, Place, Updated, ZoneWork};
use crate::model::explicit::Mover;
use glisson_mesh::math::{DMat3, DVec3};

/// The matrix with the columns of a node of a pre-computed zone or of their frontier, and the first of its three.
pub(super) fn columns_of(interface: &Interface, place: Place) -> (&Columns, usize) {
    match place {
        Place::Own { zone, own } => (&interface.of_loadable[zone as usize], 3 * own as usize),
        Place::Condensed(p) => (&interface.of_condensed, 3 * p as usize),
        Place::Nowhere | Place::Dynamic(_) => unreachable!("only loads on pre-computed tissue are kept"),
    }
}

fn own_in(place: Place, z: usize) -> Option<usize> {
    match place {
        Place::Own { zone, own } if zone as usize == z => Some(own as usize),
        _ => None,
    }
}

/// Columns with their factors for a force on the node whose first column is `first`.
fn weighted(first: usize, force_n: DVec3) -> [(usize, f64); 3] {
    [0, 1, 2].map(|axis| (first + axis, force_n[axis]))
}

pub(super) fn node_at(numbers: &[f64], node: usize) -> DVec3 {
    DVec3::from_slice(&numbers[3 * node..3 * node + 3])
}

impl CondensedHybrid {
    /// A step of finite length above 0.
    pub(super) fn advance(&mut self, dt_s: f64) {
        self.reduce_loads();
        self.prepare_tools();
        self.move_dynamic(dt_s);
        self.close_interface();
        self.show(dt_s);
    }

    /// Computes the displacements of p and the forces on d from the loads, with the dynamic nodes at rest and without
    /// tools.
    fn reduce_loads(&mut self) {
        let Self { interface, zones, work, loads, reduced, constant, .. } = self;
        reduced.copy_from_slice(constant);
        for (z, (zone, work)) in zones.iter_mut().zip(work).enumerate() {
            work.own_m.fill(0.0);
            let of_zone =
                loads.iter().filter_map(|load| own_in(load.place, z).map(|own| (own, load.force_n)));
            if work.is_solved {
                zone.start_load();
                of_zone.for_each(|(own, force_n)| zone.add_load(own, force_n));
                work.frontier.fill(0.0);
                zone.solve_load(&mut work.frontier);
                interface.add_frontier_forces(z, &work.frontier, reduced);
            } else if work.is_loaded {
                let of_zone = of_zone.flat_map(|(own, force_n)| weighted(3 * own, force_n));
                interface.of_loadable[z].add_weighted(of_zone.clone(), reduced);
                interface.of_loadable[z].add_weighted(of_zone, &mut work.own_m);
            }
        }
        let on_condensed = loads.iter().filter_map(|load| match load.place {
            Place::Condensed(p) => Some(weighted(3 * p as usize, load.force_n)),
            _ => None,
        });
        interface.of_condensed.add_weighted(on_condensed.flatten(), reduced);
    }

    /// Whether something outside a zone's own columns moves its frontier. Dynamic nodes also move zones that do not border on them.
    fn is_moved_from_outside(&self, z: usize) -> bool {
        self.work[z].is_solved
            || self.interface.nodes.len() > self.interface.n_condensed
            || self.loads.iter().any(|load| own_in(load.place, z).is_none())
            || self.held.iter().any(|held| own_in(held.place, z).is_none())
    }

    /// Factors the compliance of the held nodes, and computes their displacements without the tools.
    fn prepare_tools(&mut self) {
        if self.held.is_empty() {
            return;
        }
        let mut gathered = None;
        for i in 0..self.held.len() {
            let place = self.held[i].place;
            let mut without_m = match place {
                Place::Own { zone, own } => {
                    let (z, own) = (zone as usize, own as usize);
                    let is_moved = self.is_moved_from_outside(z);
                    if is_moved && gathered != Some(z) {
                        let work = &mut self.work[z];
                        gather_from_outside(&self.interface, &self.reduced, &self.constant, z, &[], work);
                        gathered = Some(z);
                    }
                    let outside = is_moved.then_some(&self.work[z].frontier[..]);
                    without_tools(&self.zones[z], &self.work[z], own, outside)
                }
                Place::Condensed(p) => node_at(&self.reduced, p as usize),
                Place::Nowhere | Place::Dynamic(_) => continue,
            };
            if let Place::Own { zone, own } = place
                && !self.work[zone as usize].is_solved
            {
                for load in self.loads.iter() {
                    if let Some(by) = own_in(load.place, zone as usize) {
                        without_m +=
                            tensor(&self.zones[zone as usize].compliance, own as usize, by) * load.force_n;
                    }
                }
            }
            self.held[i].without_m = without_m;
        }
        let Self { interface, zones, held, system, row, .. } = self;
        system.start(3 * held.len());
        for j in 0..held.len() {
            for i in j..held.len() {
                system.set(i, j, compliance(interface, zones, row, held[i].place, held[j].place));
            }
        }
        system.factor();
    }

    fn move_dynamic(&mut self, dt_s: f64) {
        let Self { dynamic, interface, held, system, reduced, .. } = self;
        let Some(dynamic) = dynamic else { return };
        let n_p = 3 * interface.n_condensed;
        dynamic.step(dt_s, &interface.stiffness_tiles, &reduced[n_p..], |u_m, force_n| {
            solve_tools(interface, system, held, u_m);
            for (i, held) in held.iter().enumerate() {
                let (columns, first) = columns_of(interface, held.place);
                for (column, f) in weighted(first, system.solution(i)) {
                    for (to, h) in force_n.iter_mut().zip(&columns.column(column)[n_p..]) {
                        *to -= h * f;
                    }
                }
            }
        });
        for (&at, f) in self.dynamic_places.iter().zip(dynamic.motion.constraint_forces_n()) {
            self.constraint_forces_n[at as usize] = *f;
        }
    }

    /// Computes the tools' forces and the displacements of p for the present dynamic nodes.
    fn close_interface(&mut self) {
        let Self { dynamic, interface, held, system, reduced, work, constraint_forces_n, .. } = self;
        let dynamic_m = dynamic.as_mut().map_or(&[][..], |d| d.frontier_displacements());
        let n_p = 3 * interface.n_condensed;
        solve_tools(interface, system, held, dynamic_m);
        let condensed_m = &mut reduced[..n_p];
        for i in 0..held.len() {
            let force_n = system.solution(i);
            let held = &mut held[i];
            held.force_n = force_n;
            constraint_forces_n[held.at as usize] = force_n;
            let (columns, first) = columns_of(interface, held.place);
            columns.add_weighted(weighted(first, force_n).into_iter(), condensed_m);
            if let Place::Own { zone, .. } = held.place {
                let own_m = &mut work[zone as usize].own_m;
                columns.add_weighted(weighted(first, force_n).into_iter(), own_m);
            }
        }
        interface.add_following(dynamic_m, condensed_m);
    }

    /// Updates positions and velocities as far as [`Updated`] asks for.
    fn show(&mut self, dt_s: f64) {
        if let Some(dynamic) = &self.dynamic {
            for (local, n) in dynamic.moving() {
                if self.place[n] != Place::Nowhere {
                    let (u_m, velocity) = dynamic.state_of(local);
                    self.positions_m[n] = self.mesh.positions_m[n] + u_m;
                    self.velocities_m_per_s[n] = velocity;
                }
            }
        }
        self.ages.iter_mut().flatten().chain([&mut self.condensed_age]).for_each(|age| age.since_s += dt_s);
        let per_s = self.condensed_age.renew();
        for p in 0..self.interface.n_condensed {
            let n = self.interface.nodes[p].index();
            self.place_node(n, node_at(&self.reduced, p), per_s);
        }
        self.choose_zones_with_old_inside(dt_s);
        for z in 0..self.zones.len() {
            match self.updated {
                Updated::All => self.show_zone(z, 3),
                Updated::SurfaceFirst if self.work[z].is_inside_due => self.show_zone(z, 3),
                Updated::SurfaceFirst => self.show_zone(z, 1),
                Updated::Surface => self.show_zone(z, 1),
                Updated::LoadedZones if self.work[z].is_loaded => self.show_zone(z, 2),
                Updated::LoadedZones => (),
            }
        }
    }

    /// Chooses the zones whose nodes inside get their positions in this step: those that wait longest, of those that have waited for
    /// [`INSIDE_PERIOD_S`], and as many as it takes for all zones in this time.
    fn choose_zones_with_old_inside(&mut self, dt_s: f64) {
        self.work.iter_mut().for_each(|work| work.is_inside_due = false);
        let n_zones = self.zones.len();
        let n_a_step = (n_zones as f64 * dt_s / INSIDE_PERIOD_S).ceil() as usize;
        for _ in 0..n_a_step.min(n_zones) {
            let mut oldest = None;
            let mut longest_s = INSIDE_PERIOD_S;
            for z in 0..n_zones {
                let [.., inside] = self.ages[z];
                let waits_s = if inside.was_given { f64::INFINITY } else { inside.since_s };
                let has_inside = self.zones[z].n_shown < self.zones[z].nodes.len();
                let is_older = waits_s > longest_s || oldest.is_none() && waits_s == longest_s;
                if has_inside && is_older && !self.work[z].is_inside_due {
                    (oldest, longest_s) = (Some(z), waits_s);
                }
            }
            let Some(z) = oldest else { return };
            self.work[z].is_inside_due = true;
        }
    }

    /// Updates the positions of pre-computed zones that the last steps left out, for the present loads, tools and
    /// dynamic nodes. Their velocity is the mean since their last update.
    pub(super) fn catch_up(&mut self) {
        let is_stale = |ages: &Ages| ages.iter().any(|age| age.is_stale());
        if !self.ages.iter().any(is_stale) {
            return;
        }
        self.reduce_loads();
        self.prepare_tools();
        self.close_interface();
        // Current nodes keep their velocity: a load since the last step moves them in no time.
        for p in 0..self.interface.n_condensed {
            let n = self.interface.nodes[p].index();
            self.positions_m[n] = self.mesh.positions_m[n] + node_at(&self.reduced, p);
        }
        for z in 0..self.zones.len() {
            if is_stale(&self.ages[z]) {
                self.show_zone(z, 3);
            }
        }
    }

    /// Updates the first `n_groups` of a zone's groups of nodes.
    fn show_zone(&mut self, z: usize, n_groups: usize) {
        let zone = &self.zones[z];
        let ends = [zone.n_shown, zone.n_stored, zone.nodes.len()];
        let n_rows = ends[n_groups.min(2) - 1];
        let was_fresh = self.ages[z].map(|age| !age.is_stale());
        let mut per_s = [0.0; 3];
        for (per_s, age) in per_s.iter_mut().zip(&mut self.ages[z]).take(n_groups) {
            *per_s = age.renew();
        }
        let is_moved = self.is_moved_from_outside(z);
        if is_moved {
            let dynamic_m = self.dynamic.as_ref().map_or(&[][..], |d| d.last_frontier_m());
            gather_from_outside(
                &self.interface,
                &self.reduced,
                &self.constant,
                z,
                dynamic_m,
                &mut self.work[z],
            );
        }
        let Self { zones, work, loads, held, .. } = self;
        let (zone, work) = (&zones[z], &mut work[z]);
        let rows_m = &mut work.rows_m[..3 * n_rows];
        rows_m.copy_from_slice(&work.base_m[..3 * n_rows]);
        if work.is_solved {
            for (i, row) in rows_m.chunks_exact_mut(3).enumerate() {
                let u_m = zone.loaded_m(i);
                (0..3).for_each(|axis| row[axis] += u_m[axis]);
            }
        }
        let is_solved = work.is_solved;
        let of_loads = loads.iter().filter(|_| !is_solved).map(|load| (load.place, load.force_n));
        let of_tools = held.iter().map(|held| (held.place, held.force_n));
        let of_zone = of_loads.chain(of_tools).filter_map(|(place, f)| own_in(place, z).map(|own| (own, f)));
        let columns = of_zone.flat_map(|(own, force_n)| weighted(3 * own, force_n));
        zone.compliance.add_weighted(columns, rows_m);
        if is_moved {
            zone.extension.add_times(&work.frontier, rows_m);
        }
        for i in 0..n_rows {
            let group = usize::from(i >= ends[0]);
            let (n, u_m) = (self.zones[z].nodes[i].index(), node_at(&self.work[z].rows_m, i));
            if was_fresh[group] {
                self.positions_m[n] = self.mesh.positions_m[n] + u_m;
            } else {
                self.place_node(n, u_m, per_s[group]);
            }
        }
        if n_groups == 3 && n_rows < ends[2] {
            self.show_inner(z, n_rows, per_s[2]);
        }
    }

    /// Updates the nodes without rows, by a solution with the zone's factor.
    fn show_inner(&mut self, z: usize, from: usize, per_s: f64) {
        let Self { zones, work, loads, held, interface, reduced, dynamic, .. } = self;
        let (zone, work) = (&mut zones[z], &mut work[z]);
        let n_p = 3 * interface.n_condensed;
        let dynamic_m = dynamic.as_ref().map_or(&[][..], |d| d.last_frontier_m());
        for (k, to) in interface.places[z].iter().zip(work.frontier.chunks_exact_mut(3)) {
            for (axis, to) in to.iter_mut().enumerate() {
                let at = 3 * *k as usize + axis;
                *to = if at < n_p { reduced[at] } else { dynamic_m[at - n_p] };
            }
        }
        zone.start_load();
        for (place, force_n) in
            loads.iter().map(|l| (l.place, l.force_n)).chain(held.iter().map(|h| (h.place, h.force_n)))
        {
            if let Some(own) = own_in(place, z) {
                zone.add_load(own, force_n);
            }
        }
        zone.add_pull_of_frontier(&work.frontier);
        zone.solve_load(&mut work.frontier);
        for i in from..self.zones[z].nodes.len() {
            let zone = &self.zones[z];
            let (n, u_m) = (zone.nodes[i].index(), zone.loaded_m(i) + node_at(&self.work[z].constant_m, i));
            self.place_node(n, u_m, per_s);
        }
    }

    fn place_node(&mut self, n: usize, displacement_m: DVec3, per_s: f64) {
        let position_m = self.mesh.positions_m[n] + displacement_m;
        self.velocities_m_per_s[n] = (position_m - self.positions_m[n]) * per_s;
        self.positions_m[n] = position_m;
    }
}

/// Writes the displacements of a zone's frontier [m], without those in the columns of its own loads, to `work.frontier`.
/// With an empty `dynamic_m` the dynamic nodes are at rest.
fn gather_from_outside(
    interface: &Interface,
    reduced: &[f64],
    constant: &[f64],
    z: usize,
    dynamic_m: &[f64],
    work: &mut ZoneWork,
) {
    let n_p = 3 * interface.n_condensed;
    for (k, to) in interface.places[z].iter().zip(work.frontier.chunks_exact_mut(3)) {
        for (axis, to) in to.iter_mut().enumerate() {
            let at = 3 * *k as usize + axis;
            *to = if at < n_p {
                reduced[at] - constant[at] - work.own_m[at]
            } else {
                dynamic_m.get(at - n_p).copied().unwrap_or(0.0)
            };
        }
    }
}

/// Solves for the tools' forces at these displacements of the dynamic frontier nodes.
fn solve_tools(interface: &Interface, system: &mut ContactSystem, held: &[Held], dynamic_m: &[f64]) {
    if held.is_empty() {
        return;
    }
    let n_p = 3 * interface.n_condensed;
    for (i, held) in held.iter().enumerate() {
        let (columns, first) = columns_of(interface, held.place);
        for axis in 0..3 {
            let follows_m = dot(&columns.column(first + axis)[n_p..], dynamic_m);
            system.right_mut()[3 * i + axis] = held.target_m[axis] - held.without_m[axis] - follows_m;
        }
    }
    system.solve();
}

fn tensor(matrix: &Columns, row: usize, column: usize) -> DMat3 {
    let of_axis = |d: usize| DVec3::from_array([0, 1, 2].map(|a| matrix.entry(3 * row + a, 3 * column + d)));
    DMat3::from_cols(of_axis(0), of_axis(1), of_axis(2))
}

/// Displacement [m] of an own node without the tools and without those loads of its zone that act through columns.
fn without_tools(zone: &PrecomputedZone, work: &ZoneWork, own: usize, outside: Option<&[f64]>) -> DVec3 {
    let mut u_m = node_at(&work.base_m, own);
    if work.is_solved {
        u_m += zone.loaded_m(own);
    }
    for (c, x) in outside.unwrap_or(&[]).iter().enumerate() {
        for axis in 0..3 {
            u_m[axis] += zone.extension.entry(3 * own + axis, c) * x;
        }
    }
    u_m
}

/// Displacement [m/N] of one held node for a unit force on another, the dynamic nodes held. `row`: scratch over p.
pub(super) fn compliance(
    interface: &Interface,
    zones: &[PrecomputedZone],
    row: &mut [f64],
    of: Place,
    by: Place,
) -> DMat3 {
    match (of, by) {
        (Place::Own { zone, own }, Place::Own { zone: by_zone, own: by }) if zone == by_zone => {
            tensor(&zones[zone as usize].compliance, own as usize, by as usize)
        }
        (Place::Condensed(p), by) => {
            let (columns, first) = columns_of(interface, by);
            let of_axis = |d: usize| node_at(columns.column(first + d), p as usize);
            DMat3::from_cols(of_axis(0), of_axis(1), of_axis(2))
        }
        (of, Place::Condensed(_)) => compliance(interface, zones, row, by, of).transpose(),
        (Place::Own { zone, own }, by) => {
            let (columns, first) = columns_of(interface, by);
            let z = zone as usize;
            let mut tensor = DMat3::ZERO;
            for axis in 0..3 {
                row.fill(0.0);
                for (k, &place) in interface.places[z].iter().enumerate() {
                    if (place as usize) < interface.n_condensed {
                        for a in 0..3 {
                            row[3 * place as usize + a] =
                                zones[z].extension.entry(3 * own as usize + axis, 3 * k + a);
                        }
                    }
                }
                for d in 0..3 {
                    tensor.col_mut(d)[axis] = dot(row, columns.column(first + d));
                }
            }
            tensor
        }
        (Place::Nowhere | Place::Dynamic(_), _) => DMat3::ZERO,
    }
}
