//! The system with room for the most contacts, and without it for a moment that is kept.

use super::{
    Delassus, JAWS, MAX_TOOLS, MOST_BETWEEN, MOST_CONTACTS, MOST_DENSE, MOST_NODES, N_VERTICES, PointSearch,
    Press, Response, VERTICES,
};
use crate::math::{DMat3, DVec3};
use std::iter;

impl Press {
    pub(in crate::world) fn new() -> Self {
        // The touched nodes, and what each instrument moves and turns by.
        let groups = iter::once(MOST_NODES).chain([VERTICES + 1; MAX_TOOLS]);
        Self {
            contacts: Vec::with_capacity(MOST_CONTACTS + MOST_BETWEEN),
            of: Vec::with_capacity(MOST_CONTACTS + MOST_BETWEEN),
            nodes: Vec::with_capacity(MOST_NODES),
            is_held: Vec::with_capacity(MOST_NODES),
            response: Response::new(N_VERTICES, 1 + MAX_TOOLS).with_room_for_groups_of(groups),
            moves_m: vec![DVec3::ZERO; N_VERTICES],
            forces: Vec::with_capacity(MOST_NODES),
            touched: Vec::with_capacity(MOST_NODES),
            pressed: Vec::with_capacity(MOST_CONTACTS),
            between: Vec::with_capacity(MOST_BETWEEN),
            met: Self::room_for_met(),
            on_nodes_n: Vec::with_capacity(MOST_NODES),
            delassus: Delassus::with_room_for(MOST_DENSE),
            search: PointSearch::new(),
            answers_m: vec![DVec3::ZERO; N_VERTICES],
            ..Self::without_room()
        }
    }

    /// For a moment that is kept: it holds what the next step depends on, and no step is made with it.
    pub(in crate::world) fn without_room() -> Self {
        Self {
            contacts: Vec::new(),
            of: Vec::new(),
            nodes: Vec::new(),
            is_held: Vec::new(),
            response: Response::default(),
            moves_m: Vec::new(),
            turned_by_tip: [DMat3::ZERO; MAX_TOOLS],
            torques_n_m: [DVec3::ZERO; MAX_TOOLS],
            slips: [false; MAX_TOOLS],
            forces: Vec::new(),
            touched: Vec::new(),
            softness: 1.0,
            pressed: Vec::new(),
            sub_grid_m_per_n: [[0.0; JAWS]; MAX_TOOLS],
            outward: [[DVec3::ZERO; JAWS]; MAX_TOOLS],
            further_out_m: [[0.0; JAWS]; MAX_TOOLS],
            between: Vec::new(),
            met: Vec::new(),
            on_nodes_n: Vec::new(),
            delassus: Delassus::with_room_for(0),
            search: PointSearch::none(),
            answers_m: Vec::new(),
        }
    }

    /// What the next step depends on becomes that of another; the room stays.
    pub(in crate::world) fn take_over(&mut self, other: &Self) {
        self.contacts.clear();
        self.of.clear();
        self.nodes.clear();
        self.is_held.clear();
        self.met.clear();
        self.forces.clone_from(&other.forces);
        self.touched.clone_from(&other.touched);
        self.pressed.clone_from(&other.pressed);
        self.between.clone_from(&other.between);
        self.sub_grid_m_per_n = other.sub_grid_m_per_n;
        self.outward = other.outward;
        self.further_out_m = other.further_out_m;
        self.softness = other.softness;
        self.torques_n_m = other.torques_n_m;
        self.turned_by_tip = [DMat3::ZERO; MAX_TOOLS];
        self.slips = [false; MAX_TOOLS];
    }
}
