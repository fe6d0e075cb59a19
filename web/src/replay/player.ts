/** The player: joins recording, picture, panel, timeline and keys. One frame does all its work, and only on demand. */
import { BodyList } from "../bodies";
import { ButtonBar } from "../button_bar";
import { Controls } from "../controls";
import { actionIn, toolNumber } from "../keys";
import { panned, turned, zoomed, type Orbit } from "../orbit";
import { nextDetail, type DetailChoice } from "../detail";
import { text } from "../language";
import { drawOrientation } from "../orientation";
import { SURFACE_STYLES } from "../organ";
import { Help, helpOf, Messages, savePicture } from "../overlays";
import { Panel, panelValues } from "../panel";
import { drawChart, forceChart } from "../charts";
import { arrowScale_m_per_n, ForceHistory, PLOT_SPAN_S } from "../plot";
import { headerOfHand, type HandHeader, type Hello, type SnapshotHeader, type Topology } from "../protocol";
import { Resolution } from "../resolution";
import { Scene3d } from "../scene3d";
import { Theatre } from "../theatre/view";
import { between } from "./between";
import { timeInFragment } from "./fragment";
import { PLAYER_BINDINGS, PLAYER_BUTTONS, PLAYER_MOUSE, type PlayerAction } from "./keys";
import { MomentList } from "./moments";
import type { ReplayPage } from "./page";
import { neighbour, Playback } from "./playback";
import type { Recording, Shown } from "./recording";
import { Timeline } from "./timeline";

/** A press of a key turns the view as so many pixels do. */
const KEY_TURN = 24;
/** Longer between two frames is a pause of the browser, not of the player [s]. */
const LONGEST_FRAME_S = 0.5;
/** Who jumps further than this has not seen what touched the lens in between [s]. */
const JUMP_S = 1;

/** What tests read. */
export interface PlayerReport {
  readonly frame: number;
  readonly nFrames: number;
  readonly time_s: number;
  readonly playing: boolean;
  readonly speed: number;
  readonly header: HandHeader | null;
  readonly hello: Hello;
  readonly theatre: ReturnType<Theatre["report"]>;
  readonly messages: readonly string[];
}

export class Player {
  private readonly scene: Scene3d;
  private readonly theatre: Theatre;
  private readonly panel: Panel;
  private readonly messages: Messages;
  private readonly help: Help;
  private readonly bar: ButtonBar<PlayerAction>;
  private readonly bodies: BodyList;
  private readonly timeline: Timeline;
  private readonly list: MomentList;
  private readonly playback: Playback;
  private readonly resolution = new Resolution();
  private readonly history = new ForceHistory();
  /** Of each instrument, the largest force in all of the recording [N]. */
  private readonly largest_n: readonly number[];
  private hello: Hello;
  private topology: Topology | null = null;
  private header: HandHeader | null = null;
  private shownFrame = -1;
  /** As drawn, between that frame and the next. */
  private drawn: SnapshotHeader | null = null;
  private drawn_s = -1;
  private viewChanged = true;
  private sceneChanged = true;
  private frameAsked = false;
  private lastFrame_ms: number | null = null;
  private readonly shown = { style: 0, forces: true, fixedNodes: false, detail: "auto" as DetailChoice };

  constructor(private readonly page: ReplayPage, private readonly recording: Recording) {
    this.hello = recording.helloAt(0);
    this.playback = new Playback(recording.begin_s, recording.end_s);
    this.largest_n = this.hello.tools.map((_, tool) => recording.forces_n.reduce((max, forces) => Math.max(max, forces[tool] ?? 0), 0));
    this.messages = new Messages(page.messages);
    this.scene = new Scene3d(page.scene);
    this.scene.setDetail(this.shown.detail);
    this.panel = new Panel(page.panel, false);
    this.help = new Help(document.body, [[text("group_mouse"), PLAYER_MOUSE], ...helpOf(PLAYER_BINDINGS)]);
    this.bodies = new BodyList(page.bodies, (hidden) => { this.scene.hide(hidden); this.redraw(); });
    this.bar = new ButtonBar(page.toolbar, PLAYER_BUTTONS, PLAYER_BINDINGS, (action) => this.run(action));
    this.theatre = new Theatre(this.scene, { ...page, toolbar: page.transport });
    this.timeline = new Timeline(page.timeline, recording, (frame) => this.jumpToFrame(frame));
    this.list = new MomentList(page.story, recording.story, (time_s, tool) => {
      if (tool !== null) this.choose(tool);
      this.jump(time_s);
    });
    new Controls(page.scene, {
      isOnOrgan: () => false,
      pushBegin: () => undefined,
      pushMove: () => undefined,
      pushEnd: () => undefined,
      turn: (dx, dy) => this.look(turned(this.scene.orbit, dx, dy, this.scene.height)),
      move: (dx, dy) => this.look(panned(this.scene.orbit, dx, dy, this.scene.height)),
      wheel: (notches) => this.look(zoomed(this.scene.orbit, notches)),
    });
    window.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => this.jumpToAddress());
    window.addEventListener("error", (event) => this.messages.error(text("page_error", { message: event.message })));
    window.addEventListener("unhandledrejection", (event) => this.messages.error(text("page_error", { message: String(event.reason) })));
    page.scene.addEventListener("webglcontextlost", () => this.messages.error(text("graphics_lost")));
    this.begin(this.hello);
    const sizes = new ResizeObserver(() => this.resize());
    for (const part of [page.scene.parentElement!, page.transport, page.story]) sizes.observe(part);
    this.resize();
    this.scene.resetView();
    this.jumpToAddress();
  }

  private begin(hello: Hello): void {
    const { chosen } = this.scene;
    this.hello = hello;
    this.topology = null;
    this.scene.begin(hello);
    this.bodies.begin(hello.bodies);
    hello.tools.forEach(({ name }, tool) => this.bar.name(`tool_${tool + 1}` as PlayerAction, name));
    for (const tool of [0, 1, 2, 3]) this.bar.offer(`tool_${tool + 1}` as PlayerAction, hello.tools.length > 1 && tool < hello.tools.length);
    const hasMoments = (this.recording.story?.moments.length ?? 0) > 0;
    for (const action of ["moment_back", "moment_on"] as const) this.bar.offer(action, hasMoments);
    this.theatre.begin(hello, chosen);
    this.choose(Math.min(chosen, hello.tools.length - 1));
    document.title = text("replay_title", { scene: hello.scene.name });
  }

  private choose(tool: number): void {
    const { length } = this.hello.tools;
    if (tool >= length) return this.messages.error(text("no_instrument", { n: tool + 1, m: length }));
    this.scene.choose(tool);
    this.theatre.choose(tool);
    this.timeline.choose(tool, this.hello.tools[tool].name);
    if (this.header !== null) this.header = headerOfHand(this.header, tool);
    this.redraw();
  }

  private look(orbit: Orbit): void {
    // Through the endoscope the recording looks where it looked.
    if (this.theatre.on) return;
    this.scene.setOrbit(orbit);
    this.redraw();
  }

  private jump(time_s: number): void {
    const before_s = this.playback.time_s;
    this.playback.jump(time_s);
    if (this.playback.time_s < before_s || this.playback.time_s > before_s + JUMP_S) this.theatre.smear = 0;
    this.redraw();
  }

  /** Goes to the time in the page's address, if there is one: reports link to moments. */
  private jumpToAddress(): void {
    const time_s = timeInFragment(window.location.hash);
    if (time_s === null) return;
    this.playback.playing = false;
    this.jump(time_s);
  }

  private jumpToFrame(frame: number): void {
    this.playback.playing = false;
    this.jump(this.recording.times_s[Math.min(this.recording.nFrames - 1, Math.max(0, frame))]);
  }

  private jumpToMoment(forward: boolean): void {
    const times_s = (this.recording.story?.moments ?? []).map(({ from_s }) => from_s);
    const time_s = neighbour(times_s, this.playback.time_s, forward);
    if (time_s !== null) this.jump(time_s);
  }

  private redraw(): void {
    this.viewChanged = true;
    this.sceneChanged = true;
    this.invalidate();
  }

  private resize(): void {
    const [panel, story, transport] = [this.page.panel, this.page.story, this.page.transport].map((part) => part.getBoundingClientRect());
    // On a narrow page panel and list lie over the organ instead of beside it.
    const left = window.innerWidth > 860 ? panel.right : 0;
    const right = window.innerWidth > 1180 && story.width > 0 ? this.scene.width - story.left : 0;
    this.scene.setCovered(left, right, this.scene.height - transport.top);
    this.scene.resize();
    this.theatre.layOut();
    document.documentElement.style.setProperty("--transport", `${this.page.transport.offsetHeight}px`);
    this.redraw();
  }

  private key(event: KeyboardEvent): void {
    const onButton = event.target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter");
    const action = onButton ? null : actionIn(event, PLAYER_BINDINGS);
    if (action === null) return;
    event.preventDefault();
    this.run(action);
  }

  private run(action: PlayerAction): void {
    const { recording, playback, scene } = this;
    const tool = toolNumber(action);
    if (tool !== null) this.choose(tool);
    const turn = (dx: number, dy: number): void => this.look(turned(scene.orbit, dx, dy, scene.height));
    switch (action) {
      case "play": playback.toggle(); break;
      case "frame_back": this.jumpToFrame(this.frameNow - 1); break;
      case "frame_on": this.jumpToFrame(this.frameNow + 1); break;
      case "second_back": this.jump(playback.time_s - 1); break;
      case "second_on": this.jump(playback.time_s + 1); break;
      case "begin": this.jump(recording.begin_s); break;
      case "end": this.jump(recording.end_s); break;
      case "slower": playback.faster(-1); break;
      case "faster": playback.faster(1); break;
      case "moment_back": this.jumpToMoment(false); break;
      case "moment_on": this.jumpToMoment(true); break;
      case "reset_view": scene.resetView(); break;
      case "turn_left": turn(KEY_TURN, 0); break;
      case "turn_right": turn(-KEY_TURN, 0); break;
      case "turn_up": turn(0, KEY_TURN); break;
      case "turn_down": turn(0, -KEY_TURN); break;
      case "nearer": this.look(zoomed(scene.orbit, 1)); break;
      case "further": this.look(zoomed(scene.orbit, -1)); break;
      case "wireframe":
        this.shown.style = (this.shown.style + 1) % SURFACE_STYLES.length;
        scene.setStyle(SURFACE_STYLES[this.shown.style]);
        break;
      case "forces": this.shown.forces = !this.shown.forces; break;
      case "fixed_nodes":
        this.shown.fixedNodes = !this.shown.fixedNodes;
        scene.showFixed(this.shown.fixedNodes);
        break;
      case "bodies": this.bodies.hideNext(); break;
      case "theatre":
        if (this.theatre.endoscope === null) this.messages.notice(text("replay_no_endoscope"));
        else this.theatre.turn(!this.theatre.on);
        break;
      case "wipe": this.theatre.smear = 0; break;
      case "outside": this.theatre.toggleOutside(); break;
      case "detail":
        this.shown.detail = nextDetail(this.shown.detail);
        scene.setDetail(this.shown.detail);
        this.messages.notice(text(`detail_${this.shown.detail}`));
        break;
      case "screenshot": void savePicture(scene.picture(this.page.orientation), this.header?.step ?? 0, this.messages); break;
      case "help": this.help.open = !this.help.open; break;
      case "leave": this.help.open = false; break;
    }
    this.redraw();
  }

  private get frameNow(): number {
    return this.recording.frameAt(this.playback.time_s);
  }

  private invalidate(): void {
    if (this.frameAsked) return;
    this.frameAsked = true;
    requestAnimationFrame((now_ms) => this.draw(now_ms));
  }

  private draw(now_ms: number): void {
    this.frameAsked = false;
    const dt_s = Math.min(LONGEST_FRAME_S, Math.max(0, (now_ms - (this.lastFrame_ms ?? now_ms)) / 1000));
    this.playback.advance(dt_s);
    this.lastFrame_ms = this.playback.playing ? now_ms : null;
    this.take(this.frameNow);
    if (this.sceneChanged && this.drawn !== null) {
      this.scene.styleTools(arrowScale_m_per_n(Math.max(...this.largest_n)), this.shown.forces, true);
      this.scene.showTools(this.drawn);
      this.theatre.take(this.drawn);
      this.scene.render(this.resolution.moving(now_ms));
      this.sceneChanged = false;
      this.scene.renderFinerAtRest(() => this.sceneChanged);
    }
    this.showWords();
    if (this.viewChanged) drawOrientation(this.page.orientation, this.scene.orbit, this.scene.height);
    this.viewChanged = false;
    if (this.playback.playing) this.invalidate();
  }

  /** Takes a frame of the recording to the picture, as soon as it is unpacked, and what is on the way to the next one. */
  private take(frame: number): void {
    const { recording, playback: { time_s } } = this;
    if (frame === this.shownFrame && time_s === this.drawn_s) return;
    try {
      const look = (at: number): Shown | null => recording.at(at, () => this.invalidate(), (error) => this.fail(error));
      const found = look(frame);
      if (found === null) return;
      const hello = recording.helloAt(frame);
      if (hello !== this.hello) this.begin(hello);
      if (found.topology.version !== this.topology?.version) {
        this.topology = found.topology;
        this.scene.setTopology(found.topology);
      }
      const next = frame + 1 < recording.nFrames ? look(frame + 1) : null;
      const share = next === null ? 0 : (time_s - recording.times_s[frame]) / (recording.times_s[frame + 1] - recording.times_s[frame]);
      const drawn = next === null ? found.snapshot : between(found.snapshot, next.snapshot, Math.min(1, share));
      this.scene.show(drawn);
      this.drawn = drawn.header;
      this.drawn_s = time_s;
      this.header = headerOfHand(found.snapshot.header, this.scene.chosen);
      this.shownFrame = frame;
      this.sceneChanged = true;
    } catch (error) {
      this.fail(error);
    }
  }

  private fail(error: unknown): void {
    this.playback.playing = false;
    this.messages.error(`The recording cannot be played here: ${error instanceof Error ? error.message : String(error)}`);
  }

  /** Panel, plot, timeline, lists and switches. */
  private showWords(): void {
    const { recording, playback, scene: { chosen } } = this;
    const header = this.header && { ...this.header, paused: !playback.playing };
    const frame = this.frameNow;
    this.history.clear();
    let peak_n = 0;
    for (let i = 0; i <= frame; i++) {
      const [time_s, force_n] = [recording.times_s[i], recording.forces_n[i][chosen] ?? 0];
      peak_n = Math.max(peak_n, force_n);
      if (time_s >= recording.times_s[frame] - PLOT_SPAN_S) this.history.add({ time_s, force_n });
    }
    const values = panelValues(this.hello, header, peak_n, arrowScale_m_per_n(Math.max(...this.largest_n)), chosen);
    const state = playback.playing ? (playback.speed === 1 ? text("replay_state_playing") : text("replay_state_playing_at", { speed: playback.speed })) : text("value_paused");
    this.panel.show({ ...values, state }, header);
    drawChart(this.panel.plot, forceChart(this.history));
    this.timeline.show(frame, playback.time_s, playback.speed);
    this.list.show(playback.time_s);
    const { bar, shown, theatre } = this;
    bar.set("play", playback.playing, text(playback.playing ? "button_pause" : "replay_button_play"));
    bar.set("wireframe", shown.style !== 0);
    bar.set("forces", shown.forces);
    bar.set("fixed_nodes", shown.fixedNodes);
    bar.set("help", this.help.open);
    bar.set("theatre", theatre.on);
    bar.set("outside", theatre.showsOutside);
    bar.offer("theatre", theatre.endoscope !== null);
    for (const action of ["wipe", "outside"] as const) bar.offer(action, theatre.on);
    this.hello.tools.forEach((_, tool) => bar.set(`tool_${tool + 1}` as PlayerAction, tool === chosen));
  }

  report(): PlayerReport {
    const { shownFrame, recording, playback, header, hello, theatre, messages } = this;
    const { time_s, playing, speed } = playback;
    return structuredClone({ frame: shownFrame, nFrames: recording.nFrames, time_s, playing, speed, header, hello, theatre: theatre.report(), messages: messages.texts() });
  }
}
