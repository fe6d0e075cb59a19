import { readFileSync } from "node:fs";
import { join } from "node:path";
import { defineConfig } from "vite";
import { OUT, buildOf, inOneFile } from "./one_file.ts";
import { WASI_LICENSE, packed, packedProgram, withParts, without } from "./one_file_parts.ts";

const simulator = (): string => readFileSync(join(import.meta.dirname, OUT, "local.html"), "utf8");
const parts = () => ({ simulator: packed(without(simulator(), "program")), program: packedProgram() });

/** The page for a new patient in one file, with the simulator that comes after it. Built after that one. */
export default defineConfig({
  base: "./",
  plugins: [withParts("/src/patient/main.ts", "/src/local/patient.ts", parts), inOneFile("local_patient.html", [WASI_LICENSE])],
  worker: { format: "iife" },
  build: buildOf("patient.html"),
});
