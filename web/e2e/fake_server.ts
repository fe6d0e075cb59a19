/** TEST CODE ONLY: a server that speaks docs/protocol.md with {@link FakeOrgan} behind it. */
import { createServer, type IncomingMessage, type Server, type ServerResponse } from "node:http";
import { readFile } from "node:fs/promises";
import { extname, join, normalize } from "node:path";
import type { AddressInfo, Socket } from "node:net";
import { Vector3 } from "three";
import { WebSocketServer, type WebSocket } from "ws";
import { encodeSnapshot, encodeTopology } from "../src/encode";
import { PROTOCOL_VERSION, type Hello, type Vec3 } from "../src/protocol";
import { FakeOrgan, HOME_SHAFT, HOME_TIP_M, TIP_RADIUS_M } from "./fake_organ";

const TIME_STEP_S = 0.002;
const FRAME_MS = 16;
const TYPES: Record<string, string> = {
  ".html": "text/html; charset=utf-8",
  ".js": "text/javascript",
  ".css": "text/css",
  ".png": "image/png",
  ".svg": "image/svg+xml",
};

const vec3 = (v: Vector3): Vec3 => [v.x, v.y, v.z];

export class FakeSimulator {
  readonly organ = new FakeOrgan();
  step = 0;
  paused = false;
  readonly received: string[] = [];
  private readonly sockets = new Set<WebSocket>();
  /** Who asked for contact points. */
  private readonly watchers = new Set<WebSocket>();
  private readonly socketServer = new WebSocketServer({ noServer: true });
  private readonly timer: NodeJS.Timeout;
  private last_ms = performance.now();

  constructor() {
    this.timer = setInterval(() => this.tick(), FRAME_MS);
  }

  close(): void {
    clearInterval(this.timer);
    for (const socket of this.sockets) socket.terminate();
    this.socketServer.close();
  }

  /** For an http server's "upgrade" event; false if the path is not ours. */
  upgrade(request: IncomingMessage, socket: Socket, head: Buffer): boolean {
    if (new URL(request.url ?? "/", "http://x").pathname !== "/ws") return false;
    this.socketServer.handleUpgrade(request, socket, head, (client) => this.greet(client));
    return true;
  }

  /** Answers /api/...; false if the path is not ours. */
  api(request: IncomingMessage, response: ServerResponse): boolean {
    const path = new URL(request.url ?? "/", "http://x").pathname;
    const body = path === "/api/scene" ? this.hello() : path === "/api/snapshot" ? this.snapshot() : null;
    if (body === null) return false;
    response.writeHead(200, { "content-type": "application/json" }).end(JSON.stringify(body));
    return true;
  }

  /** Sends a text message to everyone: for tests of what the page does with it. */
  say(text: string): void {
    for (const socket of this.sockets) socket.send(text);
  }

  /** Ends all connections; pages make new ones. */
  drop(): void {
    for (const socket of this.sockets) socket.terminate();
  }

  sayBytes(bytes: Uint8Array): void {
    for (const socket of this.sockets) socket.send(bytes);
  }

  private greet(client: WebSocket): void {
    this.sockets.add(client);
    client.on("close", () => [this.sockets, this.watchers].forEach((set) => set.delete(client)));
    client.on("message", (data) => this.receive(client, String(data)));
    client.send(JSON.stringify(this.hello()));
    client.send(
      new Uint8Array(
        encodeTopology({
          version: 1,
          organ: 0,
          nodeIds: Uint32Array.from(this.organ.nodeIds),
          rest_m: Float32Array.from(this.organ.rest_m.flatMap((p) => p.toArray())),
          triangles: Uint32Array.from(this.organ.triangles),
          isCut: new Uint8Array(this.organ.triangles.length / 3),
          bodyOf: new Uint8Array(this.organ.nodeIds.length),
        }),
      ),
    );
    client.send(this.frame(client));
  }

  private receive(client: WebSocket, text: string): void {
    this.received.push(text);
    const message = JSON.parse(text) as { type: string; paused?: boolean; shown?: boolean; tip_m?: Vec3; shaft?: Vec3 };
    if (message.type === "pause") this.paused = message.paused === true;
    else if (message.type === "single_step") this.step += 1;
    else if (message.type === "contacts" && message.shown === true) this.watchers.add(client);
    else if (message.type === "contacts") this.watchers.delete(client);
    // It has no inside.
    else if (message.type === "inside") return;
    else if (message.type === "reset") {
      this.step = 0;
      this.organ.reset();
    } else if (message.type === "tool" && message.tip_m !== undefined && message.shaft !== undefined) {
      if (!this.paused) this.organ.moveTool(new Vector3(...message.tip_m), new Vector3(...message.shaft));
      return;
    } else client.send(JSON.stringify({ type: "error", message: `unknown message "${message.type}"` }));
    this.broadcast();
  }

  private tick(): void {
    const now_ms = performance.now();
    const steps = Math.floor((now_ms - this.last_ms) / 1000 / TIME_STEP_S);
    this.last_ms += steps * TIME_STEP_S * 1000;
    if (this.paused || steps === 0) return;
    this.step += steps;
    this.broadcast();
  }

  private broadcast(): void {
    for (const socket of this.sockets) socket.send(this.frame(socket));
  }

  private frame(client: WebSocket): Uint8Array {
    const { organ } = this;
    const contact = organ.contactReport();
    return new Uint8Array(
      encodeSnapshot({
        header: {
          version: 1,
          organ: 0,
          step: this.step,
          time_s: this.step * TIME_STEP_S,
          rate_steps_per_s: this.paused ? 0 : 1 / TIME_STEP_S,
          realTimeFactor: this.paused ? 0 : 1,
          paused: this.paused,
          oddResets: false,
          bleeding: null,
          contactPoints: this.watchers.has(client) ? organ.contactPoints() : null,
          threads: [],
          strands_m: new Float32Array(),
          clips: [],
          inside: null,
          tools: [
            {
              tip_m: vec3(organ.tip_m),
              shaft: vec3(organ.shaft),
              roll_rad: 0,
              jaw: 0,
              trigger: 0,
              forceOnTool_n: vec3(organ.forceOnTool_n()),
              contactPoint_m: (contact?.point_m ?? [0, 0, 0]) as unknown as Vec3,
              contact: contact !== null,
              grasps: false,
              heldNodes: 0,
              shownFurtherOut_m: [0, 0, 0],
            },
          ],
        },
        positions_m: Float32Array.from(organ.positions_m.flatMap((p) => p.toArray())),
      }),
    );
  }

  hello(): Hello {
    const { rest_m, fixedNodes } = this.organ;
    const bound = (pick: (...x: number[]) => number): Vec3 => [
      pick(...rest_m.map((p) => p.x)),
      pick(...rest_m.map((p) => p.y)),
      pick(...rest_m.map((p) => p.z)),
    ];
    return {
      type: "hello",
      protocol: PROTOCOL_VERSION,
      scene: {
        name: "test ellipsoid",
        model: "closed-form dimple (test)",
        material: "none (test)",
        time_step_s: TIME_STEP_S,
        gravity_m_per_s2: [0, 0, 0],
        n_nodes: rest_m.length,
        n_tetrahedra: 0,
        n_vessels: 0,
      },
      bodies: [],
      bounds: { min_m: bound(Math.min), max_m: bound(Math.max) },
      tools: [
        {
          name: "probe",
          kind: "probe",
          tip_radius_m: TIP_RADIUS_M,
          shaft_radius_m: 0.0025,
          shaft_length_m: 0.32,
          jaws: null,
          optics: null,
          trocar_m: null,
          home_tip_m: vec3(HOME_TIP_M),
          home_shaft: vec3(HOME_SHAFT),
          home_jaw: 0,
        },
      ],
      models: ["closed-form dimple (test)"],
      fixed_nodes: fixedNodes,
      can_leave: false,
    devices: [],
    };
  }

  snapshot(): object {
    const { organ } = this;
    return {
      step: this.step,
      time_s: this.step * TIME_STEP_S,
      paused: this.paused,
      tools: [
        {
          tip_m: organ.tip_m.toArray(),
          force_on_tool_n: organ.forceOnTool_n().toArray(),
          contact: organ.contactReport(),
        },
      ],
      node_ids: organ.nodeIds,
      rest_positions_m: organ.rest_m.map((p) => p.toArray()),
      positions_m: organ.positions_m.map((p) => p.toArray()),
      state_hash: "test",
    };
  }
}

export interface RunningServer {
  readonly url: string;
  readonly simulator: FakeSimulator;
  close(): Promise<void>;
}

/** Serves the built page (`web/dist`) and the fake simulator on `port` (0: any free one). */
export async function startFakeServer(dist: string, port = 0): Promise<RunningServer> {
  const simulator = new FakeSimulator();
  const server: Server = createServer((request, response) => {
    if (simulator.api(request, response)) return;
    const path = normalize(new URL(request.url ?? "/", "http://x").pathname);
    readFile(join(dist, path === "/" ? "index.html" : path)).then(
      (body) => response.writeHead(200, { "content-type": TYPES[extname(path) || ".html"] ?? "text/plain" }).end(body),
      () => response.writeHead(404).end("not found"),
    );
  });
  server.on("upgrade", (request: IncomingMessage, socket: Socket, head: Buffer) => {
    if (!simulator.upgrade(request, socket, head)) socket.destroy();
  });
  await new Promise<void>((resolve, reject) => {
    server.once("error", reject);
    server.listen(port, "127.0.0.1", resolve);
  });
  const { port: found } = server.address() as AddressInfo;
  return {
    url: `http://127.0.0.1:${found}/`,
    simulator,
    close: () => {
      simulator.close();
      server.closeAllConnections();
      return new Promise((resolve) => server.close(() => resolve()));
    },
  };
}
