// Time of a step in Node, of the simulation that pages have in themselves (`cargo xtask web` compiles it): `npm run bench:local`.
// The phantom's liver, which an instrument presses; processor time, medians of ten runs. `--separate`: without fused arithmetic;
// `--rapier`: a block, beside rapier's soft body.
import { readFileSync } from "node:fs";
import { setFlagsFromString } from "node:v8";
import { build } from "vite";

const CASES = {
  "precomputed, 4 ms": ['model = "precomputed"', "4 ms", 200],
  "implicit, 10 ms": ['model = "implicit"\nlaw = "stable_neo_hooke"\ndamping = "20 1/s"', "10 ms", 100],
  "explicit St Venant-Kirchhoff, 0.1 ms": ['model = "explicit"\nlaw = "st_venant_kirchhoff"\ndamping = "20 1/s"', "0.1 ms", 500],
  "explicit stable neo-Hooke, 0.1 ms": ['model = "explicit"\nlaw = "stable_neo_hooke"\ndamping = "20 1/s"', "0.1 ms", 500],
};

const scene = (model, step, tetrahedra) => `glisson_scene = 1
[simulation]
time_step = "${step}"
[organ]
phantom = { organ = "liver", seed = 1, tetrahedra = ${tetrahedra} }
tissue = "liver"
${model}
[[organ.fixed]]
furthest = { direction = [0, 1, 0.4], fraction = 0.1 }
[tool]
tip_radius = "5 mm"
home_tip = ["-30 mm", "-70 mm", "20 mm"]
home_shaft = [0, -1, 0]
path = [{ time = "20 ms", tip = ["-30 mm", "-52 mm", "20 mm"] }, { time = "10 s", tip = ["-30 mm", "-50 mm", "20 mm"] }]
`;

// Node 20 has the instructions, but does not turn them on.
setFlagsFromString("--experimental-wasm-relaxed-simd");
const entry = (name) => new URL(`src/local/${name}.ts`, import.meta.url).pathname;
async function module(name) {
  const [{ output }] = await build({ configFile: false, logLevel: "error", build: { write: false, lib: { entry: entry(name), formats: ["es"] } } });
  return import(`data:text/javascript,${encodeURIComponent(output[0].code)}`);
}
const [{ Program }, { unfused }] = [await module("program"), await module("unfused")];
const bytes = new Uint8Array(readFileSync(new URL("wasm/glisson.wasm", import.meta.url)));
const compiled = await WebAssembly.compile(process.argv.includes("--separate") ? unfused(bytes) : bytes);
const median = (numbers) => numbers.sort((a, b) => a - b)[Math.floor(numbers.length / 2)];

/** Runs a scene of these files, and says how long its steps take. */
async function measure(about, files, steps) {
  const program = await Program.start(compiled, new Map(Object.entries(files).map(([name, text]) => [name, new TextEncoder().encode(text)])));
  const begun = process.cpuUsage();
  program.openRun("scene.toml");
  const opening = process.cpuUsage(begun);
  // Until the engine has compiled it well, and the instrument touches.
  program.run(4 * steps);
  const times = Array.from({ length: 10 }, () => {
    const before = process.cpuUsage();
    program.run(steps);
    return process.cpuUsage(before).user / 1e3 / steps;
  });
  console.log(JSON.stringify({ ...about, arithmetic: program.arithmetic(), opening_s: opening.user / 1e6, step_ms: Number(median(times).toFixed(4)) }));
}

if (process.argv.includes("--rapier")) {
  const { block, blockFile, blockScene, rapierSteps } = await import("./bench_rapier.mjs");
  await measure({ name: "block, implicit, 10 ms, pressed by a ball", tetrahedra: block().tetrahedra.length }, { "scene.toml": blockScene(), "block.msh": blockFile() }, 100);
  console.log(JSON.stringify({ name: "block, rapier's soft body, 10 ms, under a force", ...(await rapierSteps(400)) }));
} else {
  for (const tetrahedra of [2000, 6180]) {
    for (const [name, [model, step, steps]] of Object.entries(CASES)) await measure({ name, tetrahedra }, { "scene.toml": scene(model, step, tetrahedra) }, steps);
  }
}
