use super::*;
use crate::material::LinearElastic;
use crate::workers::Sequential;
use glisson_mesh::mesh::TetMesh;
use glisson_mesh::mesh::box_mesh::box_of_five;

/// A block of tetrahedra with masses as in a step, its lowest nodes fixed and one held.
struct Block {
    mesh: TetMesh,
    edges: MeshEdges,
    tensors: StiffnessTensors,
    free_axes: Vec<DVec3>,
    is_held: Vec<bool>,
}

impl Block {
    fn new(mesh: TetMesh) -> Self {
        let material = LinearElastic::from_young_poisson(5_000.0, 0.45, 1_000.0).unwrap();
        let edges = MeshEdges::of_mesh(&mesh).unwrap();
        let mut tensors = StiffnessTensors::assemble(&mesh, &edges, &material).unwrap();
        let n = mesh.positions_m.len();
        tensors.vertex.iter_mut().for_each(|b| *b += DMat3::from_diagonal(DVec3::splat(0.5)));
        let fixed = |p: &DVec3| if p.z < 1e-9 { DVec3::new(0.0, 1.0, 0.0) } else { DVec3::ONE };
        let free_axes = mesh.positions_m.iter().map(fixed).collect();
        let mut is_held = vec![false; n];
        is_held[n - 1] = true;
        for (ends, tensor) in edges.nodes.iter().zip(&mut tensors.edge) {
            if ends.iter().any(|n| is_held[n.index()]) {
                *tensor = DMat3::ZERO;
            }
        }
        Self { mesh, edges, tensors, free_axes, is_held }
    }

    fn given(&self) -> Given<'_> {
        Given {
            tensors: &self.tensors,
            rest_m: &self.mesh.positions_m,
            displacement_m: &self.mesh.positions_m,
            is_held: &self.is_held,
        }
    }

    fn grids(&self) -> TwoGrid {
        TwoGrid::new(&self.mesh.positions_m, &self.edges, &self.free_axes).unwrap()
    }

    fn product(&self, x: &[DVec3]) -> Vec<DVec3> {
        let mut product = vec![DVec3::ZERO; x.len()];
        self.tensors.force_into(&self.edges, x, &mut product);
        product.iter_mut().zip(&self.free_axes).for_each(|(p, free)| *p *= *free);
        product
    }

    fn random(&self, seed: u64) -> Vec<DVec3> {
        let mut random = SeededRandom::new(seed);
        let vector = |free: &DVec3| DVec3::from_array([0; 3].map(|_| random.normal())) * *free;
        self.free_axes.iter().map(vector).collect()
    }
}

fn inner(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn block() -> Block {
    Block::new(box_of_five([6, 8, 9], DVec3::new(0.06, 0.08, 0.09)))
}

#[test]
fn an_application_is_symmetric_and_positive_and_leaves_no_force_on_the_body() {
    let block = block();
    let mut grids = block.grids();
    grids.fill(&block.given()).unwrap();
    let answer = |grids: &mut TwoGrid, right: &[DVec3]| {
        let mut solution = vec![DVec3::ZERO; right.len()];
        grids.apply_into(&Sequential, right, &mut solution);
        solution
    };
    for seed in 0..5 {
        let (a, b) = (block.random(seed), block.random(seed + 100));
        let (of_a, of_b) = (answer(&mut grids, &a), answer(&mut grids, &b));
        let size = (inner(&a, &of_a) * inner(&b, &of_b)).sqrt();
        assert!(size > 0.0 && (inner(&a, &of_b) - inner(&b, &of_a)).abs() < 1e-5 * size);
        let left_n = a.iter().zip(block.product(&of_a)).map(|(r, p)| *r - p);
        let free = left_n.zip(&block.is_held).filter(|(_, is_held)| !**is_held).map(|(left_n, _)| left_n);
        let (sum_n, all_n2) =
            free.fold((DVec3::ZERO, 0.0), |(s, q), left_n| (s + left_n, q + left_n.length_squared()));
        assert!(sum_n.length() < 1e-4 * all_n2.sqrt(), "{sum_n} of {all_n2}");
        // Nothing moves along axes that are fixed.
        let fixed = of_a.iter().zip(&block.free_axes).map(|(x, free)| (*x * (1.0 - *free)).length());
        assert_eq!(fixed.fold(0.0, f64::max), 0.0);
    }
}

#[test]
fn solutions_have_a_small_residual_after_a_few_iterations() {
    let block = block();
    let mut grids = block.grids();
    grids.fill(&block.given()).unwrap();
    for (tolerance, most) in [(1e-1, 6), (1e-2, 12), (1e-4, 24)] {
        let right = block.random(3);
        let mut solution = vec![DVec3::ZERO; right.len()];
        assert!(grids.solve_into(&Sequential, &right, &mut solution, (tolerance, most)));
        let left: Vec<DVec3> = right.iter().zip(block.product(&solution)).map(|(r, p)| *r - p).collect();
        let share = (inner(&left, &left) / inner(&right, &right)).sqrt();
        assert!(share < 1.05 * tolerance, "{share:e} after {most} iterations");
    }
}

#[test]
fn values_in_slices_have_the_bits_of_those_made_at_once() {
    let block = block();
    let (mut at_once, mut sliced) = (block.grids(), block.grids());
    at_once.fill(&block.given()).unwrap();
    let mut n_slices = 1;
    let right = block.random(1);
    let [mut a, mut b] = [(); 2].map(|()| vec![DVec3::ZERO; right.len()]);
    // What serves meanwhile is asked between slices.
    sliced.fill(&block.given()).unwrap();
    while !sliced.advance(&block.given(), &mut { sliced.work_ns() / 30 }).unwrap() {
        sliced.apply_into(&Sequential, &right, &mut b);
        n_slices += 1;
    }
    assert!((25..=40).contains(&n_slices), "{n_slices} slices");
    at_once.apply_into(&Sequential, &right, &mut a);
    sliced.apply_into(&Sequential, &right, &mut b);
    assert_eq!(a, b);
    // A retired copy reads them while others are made.
    let mut retired = sliced.for_solutions();
    let mut other = block.given();
    let stiffer = StiffnessTensors {
        vertex: block.tensors.vertex.iter().map(|b| *b * 2.0).collect(),
        edge: block.tensors.edge.iter().map(|b| *b * 2.0).collect(),
    };
    other.tensors = &stiffer;
    sliced.fill(&other).unwrap();
    sliced.fill(&other).unwrap();
    retired.apply_into(&Sequential, &right, &mut b);
    assert_eq!(a, b);
    sliced.apply_into(&Sequential, &right, &mut b);
    assert_ne!(a, b);
}

/// As of a body in plane strain.
#[test]
fn an_axis_that_is_fixed_everywhere_is_no_obstacle() {
    let mut block = block();
    block.free_axes.iter_mut().for_each(|free| free.y = 0.0);
    let mut grids = block.grids();
    grids.fill(&block.given()).unwrap();
    let right = block.random(3);
    let mut solution = vec![DVec3::ZERO; right.len()];
    assert!(grids.solve_into(&Sequential, &right, &mut solution, (1e-3, 30)));
    assert!(solution.iter().all(|x| x.is_finite() && x.y == 0.0));
}

#[test]
fn a_matrix_that_is_not_positive_definite_is_refused_and_the_values_before_serve_on() {
    let block = block();
    let mut grids = block.grids();
    grids.fill(&block.given()).unwrap();
    let right = block.random(1);
    let [mut a, mut b] = [(); 2].map(|()| vec![DVec3::ZERO; right.len()]);
    grids.apply_into(&Sequential, &right, &mut a);
    let negative = StiffnessTensors {
        vertex: block.tensors.vertex.iter().map(|b| *b * -1.0).collect(),
        edge: block.tensors.edge.clone(),
    };
    assert_eq!(grids.fill(&Given { tensors: &negative, ..block.given() }), Err(SolveError::Singular));
    grids.apply_into(&Sequential, &right, &mut b);
    assert_eq!(a, b);
}
