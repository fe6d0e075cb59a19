/** The viewer: joins connection, picture, panel, pointer and keys. One frame does all its work, and only on demand. */
import { ClassView } from "./class_view";
import { Connection, messageOf, type Carrier, type ConnectionState } from "./connection";
import { Contacts } from "./contacts";
import { Controls } from "./controls";
import { HandMotion } from "./hand_motion";
import { Hands } from "./hands";
import { newCounters, type ViewerParts } from "./hook";
import { rollOf, toolDirection, toolNumber, TOOL_STEP_M, TOOL_STEP_WITH_SHIFT_M, type Action } from "./keys";
import { text } from "./language";
import { Laboratory } from "./laboratory";
import { Leaving } from "./leaving";
import { isSwitch, Looks } from "./looks";
import type { Orbit } from "./orbit";
import { drawOrientation } from "./orientation";
import { Help, Messages, savePicture, showConnection, Toolbar } from "./overlays";
import type { Page } from "./page";
import { Panel, panelValues } from "./panel";
import { BodyList } from "./bodies";
import { Profile, profilerReport } from "./profiler";
import { LoopNews, mayMove } from "./timing";
import { headerOfHand, ProtocolError, type HandHeader, type Hello, type Snapshot, type SnapshotHeader, type Topology } from "./protocol";
import { Resolution } from "./resolution";
import { Scene3d } from "./scene3d";
import { Table } from "./table";
import { ownReport, TaskPanel } from "./task";
import { Headset } from "./theatre/headset";
import { Theatre } from "./theatre/view";
import type { ToolDriver } from "./tool_driver";

export class Viewer {
  private readonly scene: Scene3d;
  private readonly theatre: Theatre;
  private readonly motion: HandMotion;
  private readonly panel: Panel;
  private readonly messages: Messages;
  private readonly help: Help;
  private readonly toolbar: Toolbar;
  private readonly controls: Controls;
  private readonly connection: Connection;
  private readonly bodies: BodyList;
  private readonly contacts: Contacts;
  private readonly task: TaskPanel;
  private readonly classroom: ClassView;
  private readonly hands = new Hands();
  private readonly table = new Table();
  private readonly lab: Laboratory;
  private readonly profile = new Profile();
  private hello: Hello | null = null;
  private readonly news = new LoopNews(() => this.showPanel(), (feel) => this.scene.feel(feel));
  private waiting = new Map<number, Snapshot>();
  private header: HandHeader | null = null;
  private state: ConnectionState = "connecting";
  /** The camera or the page's size changed. */
  private viewChanged = true;
  /** The three-dimensional picture is not what should be shown. */
  private sceneChanged = true;
  private readonly resolution = new Resolution();
  private frameAsked = false;
  private lastFrame_ms: number | null = null;
  private readonly looks: Looks;
  private readonly headset: Headset;
  private readonly leaving: Leaving;
  private readonly counters = newCounters();

  constructor(private readonly page: Page, carrier: Carrier) {
    this.messages = new Messages(page.messages);
    this.scene = new Scene3d(page.scene);
    this.panel = new Panel(page.panel);
    this.help = new Help(document.body);
    this.bodies = new BodyList(page.bodies, (hidden) => { this.scene.hide(hidden); this.redraw(); });
    this.contacts = new Contacts(page.contacts, this.scene.contactMarks);
    this.task = new TaskPanel(page.task, (number) => this.connection.send({ type: "task_event", number }), ownReport(carrier, this.messages));
    this.classroom = new ClassView(page, this.scene, (message) => this.connection.send(message), () => this.redraw());
    this.toolbar = new Toolbar(page.toolbar, (action) => this.run(action, false));
    this.theatre = new Theatre(this.scene, page);
    this.motion = new HandMotion(this.scene, this.hands, this.theatre, page, this.messages, {
      moved: () => this.invalidate(), viewed: (orbit) => this.setOrbit(orbit), mayMove: (tool) => mayMove(this.news.role, tool),
    });
    this.controls = new Controls(page.scene, this.motion);
    const { panel, scene, hands, motion, news } = this;
    this.lab = new Laboratory({ page, panel, scene, hands, motion, news, connection: () => this.connection }, {
      run: (action, shift, tool) => this.run(action, shift, tool),
      now: () => ({ hello: this.hello, role: news.role, chosen: hands.chosen, time_s: this.header?.time_s ?? null }),
      changed: () => this.refreshSwitches(),
      redraw: () => this.redraw(),
    });
    window.addEventListener("error", (event) => this.messages.error(text("page_error", { message: event.message })));
    window.addEventListener("unhandledrejection", (event) => this.messages.error(text("page_error", { message: String(event.reason) })));
    const sizes = new ResizeObserver(() => this.resize());
    // Not the canvas, which is as deep as the panel: what is changed while one size is told has to be deeper to be told, too.
    for (const part of [page.scene.parentElement!, page.toolbar, page.panel, page.task]) sizes.observe(part);
    page.scene.addEventListener("webglcontextlost", () => this.messages.error(text("graphics_lost")));
    this.connection = new Connection(carrier, {
      state: (state, attempt) => this.connectionState(state, attempt),
      hello: (hello) => this.begin(hello),
      topology: (topology) => this.setTopology(topology),
      snapshot: (snapshot, bytes) => this.receive(snapshot, bytes),
      ...this.news.events,
      ...this.classroom.events,
      task: ({ status }) => {
        if (this.task.show(status) && !this.theatre.on) this.turnTheatre(true);
        if (this.theatre.setDark(status?.is_dark ?? false)) this.redraw();
        if (this.scene.taskMarks.show(status?.mark ?? null, this.scene.organs.get(0)?.positions_m ?? null)) this.redraw();
      },
      error: (message) => this.messages.error(message),
      notice: (message) => this.messages.notice(message),
    }, () => this.hello?.can_leave === true);
    this.leaving = new Leaving({
      leave: () => this.connection.send({ type: "leave" }),
      notice: (words) => this.messages.notice(words),
      changed: () => this.refreshSwitches(),
    });
    this.looks = new Looks(page.panel, this.panel, this.scene, this.theatre, this.contacts, (action) => this.run(action, false), (words) => this.messages.notice(words));
    this.looks.begin(this.connection);
    this.headset = new Headset(this.scene, this.messages, {
      // The head moves: every frame is drawn.
      frame: (now_ms) => { this.sceneChanged = true; this.frame(now_ms); },
      found: () => this.toolbar.offer("headset", true),
    });
    this.showProfiler();
    this.resize();
    this.connection.open();
    this.refreshSwitches();
    // The panel's rates and the profiler stay fresh although nothing moves.
    setInterval(() => this.looks.shown.profiler && this.showProfiler(), 250);
  }

  private connectionState(state: ConnectionState, attempt: number): void {
    this.state = state;
    showConnection(this.page, state, attempt);
    if (state === "open") {
      this.counters.connections += 1;
      this.contacts.ask(this.connection);
    } else if (state === "lost") {
      this.controls.cancel();
      this.hands.forget();
      this.table.level();
      this.news.feel = null;
    }
  }

  /** The driver of the instrument in the hand. */
  private get tool(): ToolDriver {
    return this.hands.driver;
  }

  private choose(tool: number): void {
    if (tool !== this.hands.chosen) this.controls.cancel();
    if (!this.hands.choose(tool, this.messages)) return;
    this.lab.plots.clear();
    this.scene.choose(tool);
    this.theatre.choose(tool);
    if (this.header !== null) this.header = headerOfHand(this.header, tool);
  }

  private begin(hello: Hello): void {
    this.hello = hello;
    this.waiting.clear();
    this.header = null;
    this.contacts.forget();
    this.lab.begin(hello);
    this.hands.begin(hello);
    this.toolbar.begin(hello.tools);
    this.scene.begin(hello);
    this.bodies.begin(hello.bodies);
    this.scene.choose(this.hands.chosen);
    this.theatre.begin(hello, this.hands.chosen);
    document.title = `${hello.scene.name} – Glisson`;
    this.redraw();
  }

  private setTopology(topology: Topology): void {
    this.counters.topologyFrames += 1;
    this.scene.setTopology(topology);
    this.redraw();
  }

  private receive(snapshot: Snapshot, bytes: number): void {
    this.counters.snapshotFrames += 1;
    this.profile.arrival({ at_ms: performance.now(), bytes });
    this.lab.plots.add(snapshot.header, this.hands.chosen);
    this.waiting.set(snapshot.header.organ, snapshot);
    this.invalidate();
  }

  private setOrbit(orbit: Orbit): void {
    this.scene.setOrbit(orbit);
    this.redraw();
  }

  /** The view changed: everything is drawn anew. */
  private redraw(): void {
    this.viewChanged = true;
    this.sceneChanged = true;
    this.invalidate();
  }

  private resize(): void {
    this.looks.layOut();
    const [panel, toolbar, task] = [this.page.panel, this.page.toolbar, this.page.task].map((part) => part.getBoundingClientRect());
    // On a narrow page the panel is above the organ instead of beside it.
    if (panel.width < 0.6 * window.innerWidth) this.scene.setCovered(panel.right);
    else this.scene.setCovered(0, 0, Math.max(0, window.innerHeight - toolbar.top), Math.max(panel.bottom, task.bottom));
    this.scene.resize();
    this.theatre.layOut();
    this.redraw();
  }

  /** Does what a key, a button, a gamepad or a pedal asks for; `of`: of which instrument. */
  private run(action: Action, shift: boolean, of = this.hands.chosen): void {
    const direction = toolDirection(action);
    if (direction !== null) return this.motion.nudge(direction, shift ? TOOL_STEP_WITH_SHIFT_M : TOOL_STEP_M, of);
    const roll_rad = rollOf(action);
    if (roll_rad !== null) return this.motion.roll(roll_rad, of);
    const tool = toolNumber(action);
    if (tool !== null) this.choose(tool);
    if (action === "bodies") this.bodies.hideNext();
    if (isSwitch(action)) this.looks.turn(action, this.connection);
    if (action === "profiler") this.showProfiler();
    this.classroom.run(action, this.hands.chosen);
    switch (action) {
      case "pause":
      case "single_step":
      case "cut":
      case "clip":
      case "refine":
      case "undo":
        this.connection.send(messageOf(action, this.header?.paused, of));
        break;
      case "slow_motion":
        this.connection.send({ type: "speed", factor: this.news.slowMotion.next() });
        break;
      case "jaws":
      case "trigger":
        this.hands.press(action, of);
        break;
      case "reset_simulation":
        this.controls.cancel();
        this.hands.forget();
        this.table.level();
        this.connection.send({ type: "reset" });
        break;
      case "next_model":
        this.connection.askForNextModel(this.hello);
        break;
      case "tilt_left":
      case "tilt_right":
        this.table.press(action === "tilt_left" ? 1 : -1, this.hello, this.connection, this.messages, this.news.gravity_m_per_s2);
        break;
      case "reset_view":
        this.scene.resetView();
        break;
      case "theatre":
        this.turnTheatre(!this.theatre.on);
        this.looks.keepTheatre();
        break;
      case "wipe":
        this.theatre.smear = 0;
        break;
      case "outside":
        this.theatre.toggleOutside();
        this.looks.keepTheatre();
        break;
      case "headset": void this.headset.enter(); break;
      case "start_page":
        this.leaving.press(this.hello?.can_leave === true, performance.now());
        break;
      case "help":
        this.help.open = !this.help.open;
        break;
      case "screenshot": void this.screenshot(); break;
      case "leave": this.leave(); break;
      case "tool_place":
        this.motion.place();
        break;
      default:
        this.lab.run(action);
    }
    this.refreshSwitches();
    this.redraw();
  }

  private turnTheatre(on: boolean): void {
    if (this.theatre.endoscope === null) return this.messages.notice(text("no_endoscope"));
    this.controls.cancel();
    this.theatre.turn(on);
    this.refreshSwitches();
    this.redraw();
  }

  /** Closes what is open, else takes the instrument off the organ. */
  private leave(): void {
    if (this.help.open) this.help.open = false;
    else if (this.lab.close()) return;
    else if (this.hands.pushing) this.controls.cancel();
    else if (this.tool.active) this.tool.retract();
    else if (this.looks.shown.profiler) this.run("profiler", false);
  }

  private async screenshot(): Promise<void> {
    if (await savePicture(this.scene.picture(this.page.orientation), this.header?.step ?? 0, this.messages)) this.counters.screenshots += 1;
  }

  private refreshSwitches(): void {
    const leaving = this.hello?.can_leave === true ? (this.leaving.isAsked(performance.now()) ? "asked" : "offered") : null;
    this.toolbar.show(this.header?.paused ?? false, this.help.open, this.looks.shown, this.theatre, leaving, this.news.slowMotion.speed, this.lab.shown);
    this.toolbar.showHand(this.hands.chosen, this.hands.state);
  }

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
    for (const { tool, pose } of this.hands.advance(dt_s * this.news.slowMotion.speed, (tool) => this.scene.pose(tool))) {
      if (this.connection.send(this.hands.message(tool, pose, this.header))) this.counters.sentToolMessages += 1;
    }
    this.showWaiting();
    if (this.sceneChanged) {
      this.scene.styleTools(this.lab.plots.arrowScale_m_per_n, this.looks.shown.forces, !this.looks.shown.contacts);
      this.contacts.show(this.scene.distance_m);
      if (this.header !== null) {
        this.scene.showTools(this.header);
        this.theatre.take(this.header);
      }
    }
    const drawing_ms = performance.now();
    if (this.sceneChanged) this.scene.render(this.resolution.moving(now_ms));
    const drawn_ms = performance.now();
    if (this.sceneChanged) {
      this.sceneChanged = false;
      this.counters.drawnFrames += 1;
      this.profile.frame({ at_ms: now_ms, work_ms: drawn_ms - begun_ms, draw_ms: drawn_ms - drawing_ms });
      this.scene.renderFinerAtRest(() => this.sceneChanged);
    }
    this.showPanel();
    this.lab.draw();
    if (this.viewChanged) drawOrientation(this.page.orientation, this.scene.orbit, this.scene.height);
    this.viewChanged = false;
    this.refreshSwitches();
    if (this.hands.settled) {
      // The next motion starts with a stride of one frame, not of the pause before it.
      if (this.waiting.size === 0 && !this.hands.pushing) this.lastFrame_ms = null;
    } else {
      this.invalidate();
    }
  }

  private showWaiting(): void {
    for (const snapshot of this.waiting.values()) {
      try {
        const shown = this.scene.show(snapshot);
        if (shown === "other_topology") this.counters.ignoredSnapshots += 1;
        else if (snapshot.header.organ === 0) this.showHeader(snapshot.header);
        if (shown === "changed") this.sceneChanged = true;
      } catch (error) {
        if (!(error instanceof ProtocolError)) throw error;
        this.messages.error(text("not_understood", { message: error.message }));
      }
    }
    this.waiting.clear();
  }

  private showHeader(header: SnapshotHeader): void {
    const drawn = (h: SnapshotHeader | null): string => (h === null ? "" : JSON.stringify([h.tools, h.bleeding?.ends, h.contactPoints, h.threads, h.clips, h.strands_m.length]));
    if (drawn(header) !== drawn(this.header)) this.sceneChanged = true;
    this.contacts.take(header.contactPoints);
    this.looks.sound.take(header, this.hello);
    this.task.tick(header.time_s);
    this.header = headerOfHand(header, this.hands.chosen);
  }

  private showPanel(): void {
    const { hello, header, lab: { plots }, hands, news } = this;
    this.panel.show(panelValues(hello, header, plots.force.peak_n, plots.arrowScale_m_per_n, hands.chosen, news), header, news.slowMotion.speed);
    this.panel.showJitter(news.timing?.haptics ?? null);
  }

  private showProfiler(): void {
    this.page.profiler.hidden = !this.looks.shown.profiler;
    if (!this.looks.shown.profiler) return;
    const { hello, header, news, scene: { renderer, software } } = this;
    this.page.profiler.textContent = profilerReport(this.profile.summary(performance.now()), renderer.info.render, software, header, hello, news.timing);
  }

  /** The parts that `hook.ts` reads. */
  parts(): ViewerParts {
    const { scene, panel, messages, help, tool, profile, hello, header, theatre, motion: { pickedVertex }, state, looks: { shown }, counters } = this;
    return { scene, panel, messages, help, tool, profile, hello, header, theatre, pickedVertex, state, shown, counters };
  }
}
