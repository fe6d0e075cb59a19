/** The viewer: joins connection, picture, panel, pointer and keys. One frame does all its work, and only on demand. */
import { Vector3 } from "three";
import { Connection, socketAddress, type ConnectionState } from "./connection";
import { Controls } from "./controls";
import type { ToolPose } from "./drag";
import type { ViewerHook } from "./hook";
import { actionOf, toolDirection, TOOL_STEP_M, TOOL_STEP_WITH_SHIFT_M, type Action } from "./keys";
import { panned, turned, zoomed } from "./orbit";
import { drawOrientation } from "./orientation";
import { SURFACE_STYLES } from "./organ";
import { connectionText, Help, Messages, Toolbar } from "./overlays";
import { lengthOf, Panel, panelValues } from "./panel";
import { arrowScale_m_per_n, drawPlot, ForceHistory } from "./plot";
import { Profile, profilerText } from "./profiler";
import { ProtocolError, type Hello, type Snapshot, type SnapshotHeader, type Topology, type Vec3 } from "./protocol";
import { Scene3d } from "./scene3d";
import { ToolDriver } from "./tool_driver";

/** The page's fixed parts (index.html). */
export interface Page {
  readonly scene: HTMLCanvasElement;
  readonly orientation: HTMLCanvasElement;
  readonly panel: HTMLElement;
  readonly link: HTMLElement;
  readonly banner: HTMLElement;
  readonly messages: HTMLElement;
  readonly profiler: HTMLElement;
  readonly toolbar: HTMLElement;
  readonly hint: HTMLElement;
}

const vec3 = (v: Vector3): Vec3 => [v.x, v.y, v.z];

export class Viewer {
  private readonly scene: Scene3d;
  private readonly panel: Panel;
  private readonly messages: Messages;
  private readonly help: Help;
  private readonly toolbar: Toolbar;
  private readonly controls: Controls;
  private readonly connection: Connection;
  private readonly tool = new ToolDriver();
  private readonly history = new ForceHistory();
  private readonly profile = new Profile();

  private hello: Hello | null = null;
  private waiting = new Map<number, Snapshot>();
  private header: SnapshotHeader | null = null;
  private peak_n = 0;
  private pickedVertex: number | null = null;
  private state: ConnectionState = "connecting";
  private viewChanged = true;
  private frameAsked = false;
  private lastFrame_ms: number | null = null;
  private readonly shown = { style: 0, contacts: true, forces: true, fixedNodes: false, profiler: false };
  private readonly counters = {
    topologyFrames: 0,
    snapshotFrames: 0,
    ignoredSnapshots: 0,
    drawnFrames: 0,
    sentToolMessages: 0,
    connections: 0,
    screenshots: 0,
  };

  constructor(private readonly page: Page) {
    this.messages = new Messages(page.messages);
    this.scene = new Scene3d(page.scene);
    this.panel = new Panel(page.panel);
    this.help = new Help(document.body);
    this.toolbar = new Toolbar(page.toolbar, (action) => this.run(action, false));
    this.controls = new Controls(page.scene, {
      isOnOrgan: (x, y) => this.scene.pick(x, y) !== null,
      pushBegin: (x, y) => this.beginPush(x, y),
      pushMove: (x, y) => {
        this.tool.follow(this.scene.ray(x, y));
        this.invalidate();
      },
      pushEnd: () => {
        this.tool.retract();
        this.invalidate();
      },
      turn: (dx, dy) => this.setOrbit(turned(this.scene.orbit, dx, dy, this.scene.height)),
      move: (dx, dy) => this.setOrbit(panned(this.scene.orbit, dx, dy, this.scene.height)),
      wheel: (notches) => {
        if (this.tool.wheel(notches)) this.invalidate();
        else this.setOrbit(zoomed(this.scene.orbit, notches));
      },
    });
    window.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("error", (event) => this.messages.error(`Error in the page: ${event.message}`));
    window.addEventListener("unhandledrejection", (event) => this.messages.error(`Error in the page: ${event.reason}`));
    new ResizeObserver(() => {
      this.scene.resize();
      this.viewChanged = true;
      this.invalidate();
    }).observe(page.scene);
    page.scene.addEventListener("webglcontextlost", () => this.messages.error("The graphics were lost; reload the page."));

    this.connection = new Connection(socketAddress(window.location.href), {
      state: (state, attempt) => this.connectionState(state, attempt),
      hello: (hello) => this.begin(hello),
      topology: (topology) => this.setTopology(topology),
      snapshot: (snapshot, bytes) => this.receive(snapshot, bytes),
      error: (message) => this.messages.error(message),
    });
    this.connection.open();
    this.refreshSwitches();
    // The panel's rates and the profiler stay fresh although nothing moves.
    setInterval(() => this.shown.profiler && this.showProfiler(), 250);
  }

  // ---- what arrives ----

  private connectionState(state: ConnectionState, attempt: number): void {
    this.state = state;
    this.page.link.textContent = state === "open" ? "connected" : state === "lost" ? "disconnected" : "connecting…";
    this.page.link.dataset.state = state;
    this.page.banner.hidden = state === "open" || state === "connecting";
    this.page.banner.textContent = connectionText(state, attempt);
    if (state === "open") this.counters.connections += 1;
    if (state === "lost") {
      this.controls.cancel();
      this.tool.forget();
    }
  }

  private begin(hello: Hello): void {
    this.hello = hello;
    this.waiting.clear();
    this.header = null;
    this.history.clear();
    this.peak_n = 0;
    this.scene.begin(hello);
    document.title = `${hello.scene.name} – Glisson`;
    this.viewChanged = true;
    this.invalidate();
  }

  private setTopology(topology: Topology): void {
    this.counters.topologyFrames += 1;
    this.scene.setTopology(topology);
    this.invalidate();
  }

  private receive(snapshot: Snapshot, bytes: number): void {
    this.counters.snapshotFrames += 1;
    this.profile.arrival({ at_ms: performance.now(), bytes });
    const { header } = snapshot;
    if (header.organ === 0) {
      const force_n = lengthOf(header.forceOnTool_n);
      if (header.step < (this.history.all().length === 0 ? 0 : this.lastStep)) this.peak_n = 0;
      this.lastStep = header.step;
      this.history.add({ time_s: header.time_s, force_n });
      this.peak_n = Math.max(this.peak_n, force_n);
    }
    this.waiting.set(header.organ, snapshot);
    this.invalidate();
  }
  private lastStep = 0;

  // ---- what the hand does ----

  private setOrbit(orbit: typeof this.scene.orbit): void {
    this.scene.setOrbit(orbit);
    this.viewChanged = true;
    this.invalidate();
  }

  private beginPush(x: number, y: number): void {
    const pick = this.scene.pick(x, y);
    if (pick === null || this.hello === null) return;
    this.pickedVertex = pick.vertex;
    const start = {
      hit_m: pick.point_m,
      normal: pick.normal,
      tipRadius_m: this.hello.tool.tip_radius_m,
      view: this.scene.axes(),
    };
    this.tool.beginPush(start, this.scene.ray(x, y));
    this.page.hint.classList.add("gone");
    this.invalidate();
  }

  private key(event: KeyboardEvent): void {
    const onButton = event.target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter");
    const action = onButton ? null : actionOf(event);
    if (action === null) return;
    event.preventDefault();
    this.run(action, event.shiftKey);
  }

  private run(action: Action, shift: boolean): void {
    const direction = toolDirection(action);
    if (direction !== null) {
      this.nudge(direction, shift ? TOOL_STEP_WITH_SHIFT_M : TOOL_STEP_M);
      return;
    }
    switch (action) {
      case "pause":
        this.connection.send({ type: "pause", paused: !(this.header?.paused ?? false) });
        break;
      case "single_step":
        if (this.header?.paused === false) this.connection.send({ type: "pause", paused: true });
        else this.connection.send({ type: "single_step" });
        break;
      case "reset_simulation":
        this.controls.cancel();
        this.tool.forget();
        this.connection.send({ type: "reset" });
        break;
      case "reset_view":
        this.scene.resetView();
        this.viewChanged = true;
        break;
      case "wireframe":
        this.shown.style = (this.shown.style + 1) % SURFACE_STYLES.length;
        this.scene.setStyle(SURFACE_STYLES[this.shown.style]);
        break;
      case "contacts":
        this.shown.contacts = !this.shown.contacts;
        break;
      case "forces":
        this.shown.forces = !this.shown.forces;
        break;
      case "fixed_nodes":
        this.shown.fixedNodes = !this.shown.fixedNodes;
        this.scene.showFixed(this.shown.fixedNodes);
        break;
      case "profiler":
        this.shown.profiler = !this.shown.profiler;
        this.showProfiler();
        break;
      case "help":
        this.help.open = !this.help.open;
        break;
      case "screenshot":
        void this.screenshot();
        break;
      case "leave":
        this.leave();
        break;
      case "tool_place":
        this.placeTool();
        break;
    }
    this.refreshSwitches();
    this.invalidate();
  }

  /** Closes what is open, else takes the instrument off the organ. */
  private leave(): void {
    if (this.help.open) this.help.open = false;
    else if (this.tool.pushing) this.controls.cancel();
    else if (this.tool.active) this.tool.retract();
    else if (this.shown.profiler) this.run("profiler", false);
  }

  private shownPose(): ToolPose | null {
    const instrument = this.scene.instrument;
    return instrument === null ? null : { tip_m: instrument.tip(), shaft: instrument.shaft() };
  }

  private nudge(direction: readonly [number, number, number], step_m: number): void {
    const current = this.shownPose();
    if (current === null) return;
    const { right, up, forward } = this.scene.axes();
    const offset = new Vector3()
      .addScaledVector(right, direction[0] * step_m)
      .addScaledVector(up, direction[1] * step_m)
      .addScaledVector(forward, direction[2] * step_m);
    this.tool.nudge(offset, current);
    this.invalidate();
  }

  private placeTool(): void {
    const pick = this.scene.pick(this.scene.width / 2, this.scene.height / 2);
    if (this.hello === null || this.tool.pushing) return;
    if (pick === null) {
      this.messages.error("Nothing of the organ is at the middle of the view: reset the view (R) and try again.");
      return;
    }
    this.pickedVertex = pick.vertex;
    const view = this.scene.axes();
    const start = { hit_m: pick.point_m, normal: pick.normal, tipRadius_m: this.hello.tool.tip_radius_m, view };
    this.tool.place(start);
    this.page.hint.classList.add("gone");
  }

  private async screenshot(): Promise<void> {
    try {
      const blob = await this.scene.picture(this.page.orientation);
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `glisson-step-${String(this.header?.step ?? 0).padStart(6, "0")}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
      this.counters.screenshots += 1;
    } catch (error) {
      this.messages.error(`The picture was not saved: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  private refreshSwitches(): void {
    const { shown, toolbar } = this;
    const paused = this.header?.paused ?? false;
    toolbar.set("pause", paused, paused ? "Go on" : "Pause");
    toolbar.set("wireframe", shown.style !== 0);
    toolbar.set("contacts", shown.contacts);
    toolbar.set("forces", shown.forces);
    toolbar.set("fixed_nodes", shown.fixedNodes);
    toolbar.set("profiler", shown.profiler);
    toolbar.set("help", this.help.open);
  }

  // ---- the frame ----

  private invalidate(): void {
    if (this.frameAsked) return;
    this.frameAsked = true;
    requestAnimationFrame((now_ms) => this.frame(now_ms));
  }

  private frame(now_ms: number): void {
    this.frameAsked = false;
    const begun_ms = performance.now();
    const dt_s = Math.min(0.1, Math.max(0, (now_ms - (this.lastFrame_ms ?? now_ms)) / 1000));
    this.lastFrame_ms = now_ms;

    const pose = this.tool.advance(dt_s);
    if (pose !== null && this.connection.send({ type: "tool", tip_m: vec3(pose.tip_m), shaft: vec3(pose.shaft) })) {
      this.counters.sentToolMessages += 1;
    }
    this.showWaiting();
    if (this.scene.instrument !== null) {
      this.scene.instrument.arrowScale_m_per_n = arrowScale_m_per_n(this.peak_n);
      this.scene.instrument.setForces(this.shown.forces);
      this.scene.instrument.setContacts(this.shown.contacts);
      if (this.header !== null) this.scene.instrument.show(this.header);
    }
    const drawing_ms = performance.now();
    this.scene.render();
    const drawn_ms = performance.now();
    this.panel.show(
      panelValues(this.hello, this.header, this.peak_n, arrowScale_m_per_n(this.peak_n)),
      this.header,
    );
    drawPlot(this.panel.plot, this.history);
    if (this.viewChanged) drawOrientation(this.page.orientation, this.scene.orbit, this.scene.height);
    this.viewChanged = false;
    this.refreshSwitches();
    this.counters.drawnFrames += 1;
    this.profile.frame({ at_ms: now_ms, work_ms: performance.now() - begun_ms, draw_ms: drawn_ms - drawing_ms });
    if (this.tool.settled) {
      // The next motion starts with a stride of one frame, not of the pause before it.
      if (this.waiting.size === 0 && !this.tool.pushing) this.lastFrame_ms = null;
    } else {
      this.invalidate();
    }
  }

  private showWaiting(): void {
    for (const snapshot of this.waiting.values()) {
      try {
        if (!this.scene.show(snapshot)) this.counters.ignoredSnapshots += 1;
        else if (snapshot.header.organ === 0) this.header = snapshot.header;
      } catch (error) {
        if (!(error instanceof ProtocolError)) throw error;
        this.messages.error(`Message not understood: ${error.message}`);
      }
    }
    this.waiting.clear();
  }

  private showProfiler(): void {
    this.page.profiler.hidden = !this.shown.profiler;
    if (!this.shown.profiler) return;
    const { render } = this.scene.renderer.info;
    this.page.profiler.textContent = profilerText({
      ...this.profile.summary(performance.now()),
      rate_steps_per_s: this.header?.rate_steps_per_s ?? 0,
      timeStep_s: this.hello?.scene.time_step_s ?? 0,
      triangles: render.triangles,
      drawCalls: render.calls,
      software: this.scene.software,
    });
  }

  // ---- what tests read ----

  hook(): ViewerHook {
    const viewer = this;
    const organ = () => viewer.scene.organs.get(0) ?? null;
    const box = () => viewer.page.scene.getBoundingClientRect();
    const copyOf = <T>(value: T): T => structuredClone(value);
    return Object.freeze({
      get hello() { return copyOf(viewer.hello); },
      get header() { return copyOf(viewer.header); },
      get positions() { return organ()?.positions_m.slice() ?? null; },
      get restPositions() { return organ()?.topology.rest_m.slice() ?? null; },
      get nodeIds() { return organ()?.topology.nodeIds.slice() ?? null; },
      get triangles() { return organ()?.topology.triangles.slice() ?? null; },
      get pickedVertex() { return viewer.pickedVertex; },
      get tool() {
        const { active, pushing, settled, pose } = viewer.tool;
        return { active, pushing, settled, sentTip: pose === null ? null : vec3(pose.tip_m) };
      },
      get panel() { return viewer.panel.values(); },
      get view() {
        const { style, contacts, forces, fixedNodes, profiler } = viewer.shown;
        const { azimuth_rad, elevation_rad, distance_m, target_m } = viewer.scene.orbit;
        return {
          style: SURFACE_STYLES[style], contacts, forces, fixedNodes, profiler, help: viewer.help.open,
          azimuth_rad, elevation_rad, distance_m, target_m: vec3(target_m),
        };
      },
      get connection() { return viewer.state; },
      get messages() { return viewer.messages.texts(); },
      get counters() { return { ...viewer.counters }; },
      get frameWork_ms() { return viewer.profile.summary(performance.now()).work_ms; },
      project(vertex: number): [number, number] | null {
        const positions = organ()?.positions_m;
        if (positions === undefined || !(vertex >= 0 && 3 * vertex + 2 < positions.length)) return null;
        const [x, y] = viewer.scene.project(new Vector3().fromArray(positions, 3 * vertex));
        return [x + box().left, y + box().top];
      },
      vertexAt(x: number, y: number): number | null {
        const pick = viewer.scene.pick(x - box().left, y - box().top);
        return pick === null || pick.organ !== 0 ? null : pick.vertex;
      },
    });
  }
}

