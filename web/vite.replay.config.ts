import { defineConfig } from "vite";
import { buildOf, inOneFile } from "./one_file.ts";

/** The player of recorded sessions, which `glisson export` puts a recording into. Built after the other pages, beside them. */
export default defineConfig({
  base: "./",
  plugins: [inOneFile("replay.html")],
  build: buildOf("replay.html"),
});
