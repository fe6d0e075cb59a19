/** `npm run fake`: the viewer with hot reload in front of the test ellipsoid. For work on the viewer only. */
import type { Socket } from "node:net";
import { defineConfig } from "vite";
import { FakeSimulator } from "./fake_server";

export default defineConfig({
  plugins: [
    {
      name: "fake-simulator",
      configureServer(server) {
        const simulator = new FakeSimulator();
        server.middlewares.use((request, response, next) => {
          if (!simulator.api(request, response)) next();
        });
        server.httpServer?.on("upgrade", (request, socket, head) => {
          simulator.upgrade(request, socket as Socket, head as Buffer);
        });
        server.httpServer?.on("close", () => simulator.close());
      },
    },
  ],
});
