import { defineConfig } from "vite";
import { inOneFile, OUT } from "./one_file.ts";

/** The player of recorded sessions, which `glisson export` puts a recording into. Built after the other pages, beside them. */
export default defineConfig({
  base: "./",
  plugins: [inOneFile("replay.html")],
  build: {
    outDir: OUT,
    emptyOutDir: false,
    target: "es2022",
    cssCodeSplit: false,
    modulePreload: false,
    chunkSizeWarningLimit: 900,
    rolldownOptions: { input: "replay.html", output: { codeSplitting: false } },
  },
});
