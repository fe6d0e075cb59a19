import { defineConfig } from "vitest/config";

/** Browser tests: one after the other, because software drawing keeps both cores busy. */
export default defineConfig({
  test: {
    include: ["e2e/**/*.e2e.ts"],
    environment: "node",
    fileParallelism: false,
    testTimeout: 120_000,
    hookTimeout: 60_000,
  },
});
