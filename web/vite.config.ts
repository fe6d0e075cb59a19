import { defineConfig } from "vite";

/** Address of a running `glisson serve` that `npm run dev` passes `/ws` and `/api` on to. */
const server = process.env.GLISSON_URL ?? "http://127.0.0.1:8080";

export default defineConfig({
  base: "./",
  build: {
    // place_build.mjs puts it into dist.
    outDir: "dist.new",
    emptyOutDir: true,
    target: "es2022",
    chunkSizeWarningLimit: 900,
    // The viewer, the page for a new patient, and the one that leads to both.
    rolldownOptions: { input: ["index.html", "patient.html", "start.html"] },
    // The notices that the bundled packages ask for.
    license: { fileName: "licenses.md" },
  },
  server: {
    proxy: {
      "/ws": { target: server.replace(/^http/, "ws"), ws: true },
      "/api": { target: server },
    },
  },
});
