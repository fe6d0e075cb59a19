//! Cases of the hybrid model whose zones exchange forces (seed `003`, table 5.2): a sweep is a refresh.

use std::hint::black_box;

use glam::DVec3;
use glisson::math::SeededRandom;
use glisson::mesh::zones::Zones;
use glisson::model::DeformableModel;
use glisson::model::hybrid::exchange::{
    ExchangeParams, HybridExchange, Method, SweepOrder, ZoneLaw, ZoneSize,
};

use super::body::StandardBody;
use super::{Case, Prepared, Settings, Work};

/// Sizes of about 469 and 4,919 nodes, the report's livers.
const SIZES: &[usize] = &[1_900, 24_500];

pub(super) const CASES: &[Case] = &[
    Case {
        name: "hybrid_exchange_surface",
        about: "one sweep over two pre-computed zones in turn, method A: surface and frontier forces",
        per: "sweep",
        sizes: SIZES,
        parallel: false,
        prepare: |settings| prepare(settings, 2, Method::Surface, SweepOrder::GaussSeidel),
    },
    Case {
        name: "hybrid_exchange_all_nodes",
        about: "one sweep over two pre-computed zones in turn, method B: all nodes",
        per: "sweep",
        sizes: SIZES,
        parallel: false,
        prepare: |settings| prepare(settings, 2, Method::AllNodes, SweepOrder::GaussSeidel),
    },
    Case {
        name: "hybrid_exchange_at_once",
        about: "one sweep over four pre-computed zones at once (Jacobi), method B, a zone a task",
        per: "sweep",
        sizes: &[1_900, 12_000],
        parallel: true,
        prepare: |settings| prepare(settings, 4, Method::AllNodes, SweepOrder::Jacobi),
    },
];

fn prepare(
    settings: Settings,
    n_zones: usize,
    method: Method,
    order: SweepOrder,
) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let zones = Zones::by_graph(&body.mesh, n_zones)?;
    let laws = vec![ZoneLaw::Precomputed; n_zones];
    let mut model = HybridExchange::build(&ExchangeParams {
        method,
        order,
        ..ExchangeParams::new(&body.mesh, &body.material, &body.fixed_nodes, &zones, &laws)
    })?;
    // Back to rest from a shaken shape, without outer force, as in the report's counts. Sweeps go on for ever at
    // numbers that are not subnormal because gravity pulls.
    let mut random = SeededRandom::new(1);
    let shaken_m: Vec<DVec3> = body
        .mesh
        .positions_m
        .iter()
        .map(|&p| p + DVec3::new(random.normal(), random.normal(), random.normal()) * 1e-3)
        .collect();
    model.take_over(&shaken_m);
    model.step(0.01);
    let count = model.count();
    let sizes: Vec<String> = model
        .zone_sizes()
        .map(|(_, ZoneSize { n_nodes, n_frontier, n_surface })| {
            format!("({n_nodes}, {n_frontier}, {n_surface})")
        })
        .collect();
    let n_tensors = model.n_tensors();
    model.set_gravity(DVec3::new(0.0, 0.0, -1.0));
    // A tensor is 72 bytes, a product 18 operations; answers of all frontier nodes are added up once each.
    let products = count.products() as f64;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        work: (order == SweepOrder::GaussSeidel).then_some(Work {
            flops: 18.0 * products,
            bytes: 72.0 * products,
            working_set_bytes: 72.0 * products,
        }),
        note: format!(
            "{} nodes, zones (N, F, S) {}, {} products a sweep, {n_tensors} tensors",
            body.mesh.positions_m.len(),
            sizes.join(" "),
            count.products(),
        ),
        run: Box::new(move || {
            model.step_in_pool(0.01);
            black_box(model.displacements_m());
        }),
    })
}
