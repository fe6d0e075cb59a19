// The same block and load for this simulation and for rapier's soft body, in Node: `npm run bench:local -- --rapier`. Rapier is fetched
// for it, and is no part of the page.
import { execFileSync } from "node:child_process";
import { mkdirSync } from "node:fs";
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const RAPIER = "@dimforge/rapier3d-compat@0.21.0";
/** Git-ignored. */
const PLACE = fileURLToPath(new URL("../target/peers/npm", import.meta.url));

/** Cells of the block along each axis, and their edge: six tetrahedra each. */
const CELLS = [17, 10, 6];
const EDGE_M = 6e-3;
const YOUNG_PA = 4100;
const POISSON_RATIO = 0.45;
const DENSITY_KG_PER_M3 = 1060;
const STEP_S = 0.01;
/** The force on its top goes up and down between these, once in a while. */
const FORCES_N = [0.2, 0.6];
const PERIOD_S = 1;
/** Rapier computes with single precision, in tenths of a metre: in metres bodies of this size fall apart. */
const UNITS_PER_M = 10;

/** A block of cubes, each parted into the six tetrahedra around its diagonal. */
export function block() {
  const [nx, ny, nz] = CELLS;
  const node = (i, j, k) => i + (nx + 1) * (j + (ny + 1) * k);
  const nodes_m = [];
  for (let k = 0; k <= nz; k++) for (let j = 0; j <= ny; j++) for (let i = 0; i <= nx; i++) nodes_m.push([i, j, k].map((n) => n * EDGE_M));
  const ways = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
  const tetrahedra = [];
  for (let k = 0; k < nz; k++) for (let j = 0; j < ny; j++) for (let i = 0; i < nx; i++) {
    for (const [n, way] of ways.entries()) {
      const at = [i, j, k];
      const corners = [node(...at)];
      for (const axis of way) {
        at[axis] += 1;
        corners.push(node(...at));
      }
      // Odd ways go round the other way.
      if (n >= 3) corners.splice(1, 2, corners[2], corners[1]);
      tetrahedra.push(corners);
    }
  }
  return { nodes_m, tetrahedra };
}

/** The block as a file of Gmsh's format 2, in millimetres. */
export function blockFile() {
  const { nodes_m, tetrahedra } = block();
  const nodes = nodes_m.map((x_m, n) => `${n + 1} ${x_m.map((x) => 1e3 * x).join(" ")}`);
  const elements = tetrahedra.map((corners, n) => `${n + 1} 4 2 0 1 ${corners.map((c) => c + 1).join(" ")}`);
  return ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", nodes.length, ...nodes, "$EndNodes", "$Elements", elements.length, ...elements, "$EndElements", ""].join("\n");
}

const top_m = () => CELLS[2] * EDGE_M;
const middle_m = () => [CELLS[0], CELLS[1]].map((n) => 0.5 * n * EDGE_M);

/** A ball presses the block's top a little more and less; its bottom is held. */
export function blockScene() {
  const at = (depth_mm) => `[${[...middle_m(), top_m() + 5e-3 - depth_mm * 1e-3].map((x) => `"${(1e3 * x).toFixed(2)} mm"`).join(", ")}]`;
  const path = Array.from({ length: 40 }, (_, n) => `{ time = "${(n + 1) * 0.5 * PERIOD_S} s", tip = ${at(n % 2 === 0 ? 6 : 3)} }`);
  return `glisson_scene = 1
[simulation]
time_step = "${STEP_S} s"
[organ]
mesh = "block.msh"
young_modulus = "${YOUNG_PA} Pa"
poisson_ratio = ${POISSON_RATIO}
density = "${DENSITY_KG_PER_M3} kg/m3"
model = "implicit"
law = "stable_neo_hooke"
[[organ.fixed]]
furthest = { direction = [0, 0, -1], fraction = 0.14 }
[tool]
tip_radius = "5 mm"
home_tip = ${at(-20)}
home_shaft = [0, 0, 1]
path = [${path.join(", ")}]
`;
}

/** Median time of rapier's steps on the processor [ms], and how far its block went in [mm]. */
export async function rapierSteps(steps) {
  mkdirSync(PLACE, { recursive: true });
  execFileSync("npm", ["install", "--no-save", "--no-audit", "--no-fund", "--prefix", PLACE, RAPIER], { stdio: ["ignore", "ignore", "inherit"] });
  const rapier = createRequire(`${PLACE}/index.js`)("@dimforge/rapier3d-compat");
  await rapier.init();
  const { nodes_m, tetrahedra } = block();
  const volume_m3 = EDGE_M ** 3 / 6;
  const masses = new Float32Array(nodes_m.length);
  for (const corners of tetrahedra) for (const n of corners) masses[n] += (DENSITY_KG_PER_M3 * volume_m3) / 4;
  const material = new rapier.SoftBodyMaterial();
  [material.youngModulus, material.poissonRatio, material.elasticDampingRatio] = [YOUNG_PA / UNITS_PER_M, POISSON_RATIO, 0];
  const held = nodes_m.flatMap(([, , z], n) => (z === 0 ? [n] : []));
  const [x0, y0] = middle_m();
  const loaded = nodes_m.flatMap(([x, y, z], n) => (z > top_m() - 1e-9 && Math.hypot(x - x0, y - y0) < 8e-3 ? [n] : []));
  const world = new rapier.World({ x: 0, y: 0, z: 0 });
  world.integrationParameters.dt = STEP_S;
  world.integrationParameters.numSolverIterations = 1;
  world.integrationParameters.softBodiesMaxExtraSubsteps = 0;
  const description = new rapier.SoftBodyDesc(new Float32Array(nodes_m.flat().map((x) => x * UNITS_PER_M)))
    .setCells(new Uint32Array(tetrahedra.flat()))
    .setMasses(masses)
    .setCellModel(rapier.SoftBodyCellModel.NeoHookean)
    .setMaterial(material)
    .setSolver(rapier.SoftBodySolver.Fem)
    .setPinnedParticles(new Uint32Array(held))
    .setNoSurfaceCollider()
    .setCanSleep(false);
  const body = world.createSoftBody(description);
  let deepest_mm = 0;
  const times_ms = Array.from({ length: steps }, (_, step) => {
    body.resetForces(false);
    const share = 0.5 - 0.5 * Math.cos((2 * Math.PI * step * STEP_S) / PERIOD_S);
    const force_n = FORCES_N[0] + share * (FORCES_N[1] - FORCES_N[0]);
    for (const n of loaded) body.addParticleForce(n, { x: 0, y: 0, z: (-force_n / loaded.length) * UNITS_PER_M }, true);
    const before = process.cpuUsage();
    world.step();
    const time_ms = process.cpuUsage(before).user / 1e3;
    for (const n of loaded) deepest_mm = Math.max(deepest_mm, 1e3 * (top_m() - body.particlePosition(n).z / UNITS_PER_M));
    return time_ms;
  });
  times_ms.sort((a, b) => a - b);
  return { tetrahedra: tetrahedra.length, step_ms: Number(times_ms[Math.floor(steps / 2)].toFixed(3)), deepest_mm: Number(deepest_mm.toFixed(1)) };
}
