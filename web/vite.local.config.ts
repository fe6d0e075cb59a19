import { defineConfig } from "vite";
import { buildOf, inOneFile } from "./one_file.ts";
import { WASI_LICENSE, packedProgram, withParts } from "./one_file_parts.ts";

const parts = () => ({ "take-over": "", "scene-files": "", program: packedProgram() });

/** The simulator in one file, which `glisson export` puts a scene into. Built after the other pages, beside them. */
export default defineConfig({
  base: "./",
  plugins: [withParts("/src/main.ts", "/src/local/main.ts", parts), inOneFile("local.html", [WASI_LICENSE])],
  // Browsers start no Worker that is a module from a file on disk.
  worker: { format: "iife" },
  build: buildOf("index.html"),
});
