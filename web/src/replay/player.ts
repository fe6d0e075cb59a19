/** The player: joins recording, picture, panel, timeline and keys. One frame does all its work, and only on demand. */
import { BodyList } from "../bodies";
import { ButtonBar } from "../button_bar";
import { Controls } from "../controls";
import { actionIn, toolNumber } from "../keys";
import { panned, turned, zoomed } from "../orbit";
import { nextDetail, type DetailChoice } from "../detail";
import { text } from "../language";
import { drawOrientation } from "../orientation";
import { SURFACE_STYLES } from "../organ";
import { Help, helpOf, Messages, savePicture } from "../overlays";
import { forceText, Panel, panelValues } from "../panel";
import { drawChart, forceChart } from "../charts";
import { ForceHistory, PLOT_SPAN_S } from "../plot";
import type { HandHeader, Hello } from "../protocol";
import type { Theatre } from "../theatre/view";
import { BookmarkList } from "./bookmark_list";
import { Bookmarks, type ListedBookmark } from "./bookmarks";
import type { Beginning } from "./clock";
import type { Bookmark } from "./notes";
import { COLOURS, LETTERS } from "./entry";
import { timeInFragment } from "./fragment";
import { PLAYER_BINDINGS, PLAYER_BUTTONS, PLAYER_MOUSE, type PlayerAction } from "./keys";
import { MomentList, storyOf } from "./moments";
import { partsBeside, type ReplayPage } from "./page";
import { neighbour, Playback } from "./playback";
import type { Recording } from "./recording";
import { Timeline, timeText } from "./timeline";
import { Views } from "./views";
import { MOST_TOOLS } from "../tool_info";
import { browsersStore } from "../settings";

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
  readonly bookmarks: readonly ListedBookmark[];
  /** How many dots are drawn on the tissue. */
  readonly drawnDots: number;
  /** Of the recording beside it; null where there is none. */
  readonly beside: { readonly frame: number; readonly time_s: number; readonly header: HandHeader | null; readonly azimuth_rad: number } | null;
  readonly azimuth_rad: number;
}

export class Player {
  private readonly views: Views;
  private readonly panel: Panel;
  private readonly messages: Messages;
  private readonly help: Help;
  private readonly bar: ButtonBar<PlayerAction>;
  private readonly bodies: BodyList;
  private readonly timeline: Timeline;
  private readonly lists: readonly MomentList[];
  private readonly bookmarks: BookmarkList;
  private playback: Playback;
  private readonly history = new ForceHistory();
  private viewChanged = true;
  private isLeaving = false;
  private frameAsked = false;
  private lastFrame_ms: number | null = null;
  private readonly shown = { style: 0, contacts: false, forces: true, fixedNodes: false, detail: "auto" as DetailChoice };

  /** `recordings`: one, or two to be compared; `name`: of what is in the page, for what the browser keeps of it; `takeOver`: simulates on from a step. */
  constructor(private readonly page: ReplayPage, recordings: readonly Recording[], name: string, private readonly takeOver: ((step: number) => Promise<void>) | null) {
    this.messages = new Messages(page.messages);
    const parts = recordings.length > 1 ? [page, partsBeside(page)] : [page];
    this.views = new Views(parts, recordings, {
      began: () => this.began(),
      ready: () => this.invalidate(),
      failed: (error) => this.fail(error),
    });
    const { views } = this;
    this.playback = new Playback(views.clock.begin_s, views.clock.end_s);
    for (const { scene } of views.all) scene.setDetail(this.shown.detail);
    this.panel = new Panel(page.panel, false);
    this.help = new Help(document.body, [[text("group_mouse"), PLAYER_MOUSE], ...helpOf(PLAYER_BINDINGS)]);
    this.bodies = new BodyList(page.bodies, (hidden) => { for (const { scene } of views.all) scene.hide(hidden); this.redraw(); });
    this.bar = new ButtonBar(page.toolbar, PLAYER_BUTTONS, PLAYER_BINDINGS, (action) => this.run(action));
    this.timeline = new Timeline(page.timeline, (frame) => this.jumpToFrame(frame));
    this.lists = views.all.map(({ recording: { story } }, i) => new MomentList(views.isPair ? storyOf(page.story, i) : page.story, story, (time_s, tool) => {
      if (tool !== null) this.choose(tool);
      this.jump(time_s - views.clock.start_s(i));
    }));
    page.story.hidden = views.all.every(({ recording }) => recording.story === null);
    // In the time of the first recording.
    const recorded = (): Bookmark[] => views.all.flatMap(({ recording: { notes } }, i) => notes.bookmarks.map((bookmark) => ({ ...bookmark, time_s: bookmark.time_s - views.clock.start_s(i) + views.clock.start_s(0) })));
    this.bookmarks = new BookmarkList(page.bookmarks, new Bookmarks(recorded, name, views.clock.end_s + views.clock.start_s(0), browsersStore()), {
      jump: (time_s) => this.jump(time_s - views.clock.start_s(0)),
      now: () => this.playback.time_s + views.clock.start_s(0),
      changed: () => this.showBookmarks(),
      notice: (words) => this.messages.notice(words),
    });
    views.all.forEach(({ scene }, i) => {
      new Controls(scene.canvas, {
        isOnOrgan: () => false,
        pushBegin: () => false,
        pushMove: () => undefined,
        pushEnd: () => undefined,
        turn: (dx, dy) => this.look((orbit, height) => turned(orbit, dx, dy, height), i),
        move: (dx, dy) => this.look((orbit, height) => panned(orbit, dx, dy, height), i),
        wheel: (notches) => this.look((orbit) => zoomed(orbit, notches), i),
      });
      scene.canvas.addEventListener("webglcontextlost", () => this.messages.error(text("graphics_lost")));
    });
    window.addEventListener("keydown", (event) => this.key(event));
    window.addEventListener("hashchange", () => this.jumpToAddress());
    window.addEventListener("error", (event) => this.messages.error(text("page_error", { message: event.message })));
    window.addEventListener("unhandledrejection", (event) => this.messages.error(text("page_error", { message: String(event.reason) })));
    for (const view of views.all) view.begin();
    const sizes = new ResizeObserver(() => this.resize());
    for (const part of [page.scene.parentElement!, page.transport, page.story]) sizes.observe(part);
    this.resize();
    views.resetView();
    this.jumpToAddress();
  }

  /** The recording's scene is another one, or the first. */
  private began(): void {
    const { views, bar } = this;
    const { hello, scene } = views.first;
    const tracks = views.all.map(({ recording }, i) => ({ recording, start_s: views.clock.start_s(i), colour: COLOURS[i] }));
    this.timeline.begin(tracks, views.clock.frames_s);
    for (const action of ["couple", "align"] as const) bar.offer(action, action === "couple" ? views.isPair : views.clock.canBeginWithTask);
    bar.offer("take_over", this.takeOver !== null);
    this.bodies.begin(hello.bodies);
    hello.tools.forEach(({ name }, tool) => this.bar.name(`tool_${tool + 1}` as PlayerAction, name));
    for (let tool = 0; tool < MOST_TOOLS; tool++) this.bar.offer(`tool_${tool + 1}` as PlayerAction, hello.tools.length > 1 && tool < hello.tools.length);
    this.showBookmarks();
    this.timeline.choose(scene.chosen, hello.tools[scene.chosen].name);
    document.title = text("replay_title", { scene: hello.scene.name });
  }

  private choose(tool: number): void {
    const { tools } = this.views.first.hello;
    if (tool >= tools.length) return this.messages.error(text("no_instrument", { n: tool + 1, m: tools.length }));
    for (const view of this.views.all) if (tool < view.hello.tools.length) view.choose(tool);
    this.timeline.choose(tool, tools[tool].name);
    this.redraw();
  }

  private look(change: Parameters<Views["look"]>[1], view = this.views.active): void {
    this.views.look(view, change);
    this.redraw();
  }

  private jump(time_s: number): void {
    const before_s = this.playback.time_s;
    this.playback.jump(time_s);
    if (this.playback.time_s < before_s || this.playback.time_s > before_s + JUMP_S) for (const { theatre } of this.views.all) theatre.smear = 0;
    this.redraw();
  }

  /** What can be gone to by keys, marks on the curve. */
  private showBookmarks(): void {
    this.timeline.mark(this.bookmarks_s);
    for (const action of ["moment_back", "moment_on"] as const) this.bar.offer(action, this.moments_s.length > 0);
    this.redraw();
  }

  /** Goes to the time in the page's address, if there is one: reports link to moments. Takes the bookmarks that it brings. */
  private jumpToAddress(): void {
    this.bookmarks.take(window.location.hash);
    const time_s = timeInFragment(window.location.hash);
    if (time_s === null) return;
    this.playback.playing = false;
    // In the time of the first recording, as bookmarks.
    this.jump(time_s - this.views.clock.start_s(0));
  }

  private jumpToFrame(frame: number): void {
    this.playback.playing = false;
    const { frames_s } = this.views.clock;
    this.jump(frames_s[Math.min(frames_s.length - 1, Math.max(0, frame))]);
  }

  /** Where bookmarks are on the clock [s]. */
  private get bookmarks_s(): number[] {
    return this.bookmarks.all.map(({ time_s }) => time_s - this.views.clock.start_s(0));
  }

  /** What went wrong, and bookmarks. */
  private get moments_s(): number[] {
    const { views } = this;
    const wrong_s = views.all.flatMap(({ recording }, i) => (recording.story?.moments ?? []).map(({ from_s }) => from_s - views.clock.start_s(i)));
    return [...wrong_s, ...this.bookmarks_s].sort((a, b) => a - b);
  }

  private jumpToMoment(forward: boolean): void {
    const time_s = neighbour(this.moments_s, this.playback.time_s, forward);
    if (time_s !== null) this.jump(time_s);
  }

  private redraw(): void {
    this.viewChanged = true;
    this.views.change();
    this.invalidate();
  }

  private resize(): void {
    const [panel, story, transport] = [this.page.panel, this.page.story, this.page.transport].map((part) => part.getBoundingClientRect());
    // On a narrow page panel and list lie over the organ instead of beside it.
    const left = window.innerWidth > 860 ? panel.right : 0;
    const { views } = this;
    for (const view of views.all) {
      const { width, height } = view.scene;
      const right = window.innerWidth > 1180 && story.width > 0 && !views.isPair ? width - story.left : 0;
      view.resize(views.isPair ? 0 : left, right, height - transport.top);
    }
    document.documentElement.style.setProperty("--transport", `${this.page.transport.offsetHeight}px`);
    this.redraw();
  }

  private key(event: KeyboardEvent): void {
    if (event.target instanceof HTMLInputElement && event.target.type === "text") return;
    const onButton = event.target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter");
    const action = onButton ? null : actionIn(event, PLAYER_BINDINGS);
    if (action === null) return;
    event.preventDefault();
    this.run(action);
  }

  private run(action: PlayerAction): void {
    if (this.isLeaving) return;
    const { playback, views } = this;
    const tool = toolNumber(action);
    if (tool !== null) this.choose(tool);
    const turn = (dx: number, dy: number): void => this.look((orbit, height) => turned(orbit, dx, dy, height));
    const scenes = views.all.map(({ scene }) => scene);
    switch (action) {
      case "play": playback.toggle(); break;
      case "frame_back": this.jumpToFrame(this.frameNow - 1); break;
      case "frame_on": this.jumpToFrame(this.frameNow + 1); break;
      case "second_back": this.jump(playback.time_s - 1); break;
      case "second_on": this.jump(playback.time_s + 1); break;
      case "begin": this.jump(views.clock.begin_s); break;
      case "end": this.jump(views.clock.end_s); break;
      case "slower": playback.faster(-1); break;
      case "faster": playback.faster(1); break;
      case "moment_back": this.jumpToMoment(false); break;
      case "moment_on": this.jumpToMoment(true); break;
      case "bookmark":
        playback.playing = false;
        this.bookmarks.mark();
        break;
      case "take_over":
        playback.playing = false;
        this.isLeaving = this.takeOver !== null && views.first.header !== null;
        if (this.isLeaving) void this.takeOver!(views.first.header!.step);
        else this.messages.notice(text("replay_no_simulator"));
        break;
      case "couple":
        views.coupled = !views.coupled;
        if (views.coupled) views.follow(views.active);
        break;
      case "align": this.beginWith(views.clock.beginning === "task" ? "recording" : "task"); break;
      case "reset_view": views.resetView(); break;
      case "turn_left": turn(KEY_TURN, 0); break;
      case "turn_right": turn(-KEY_TURN, 0); break;
      case "turn_up": turn(0, KEY_TURN); break;
      case "turn_down": turn(0, -KEY_TURN); break;
      case "nearer": this.look((orbit) => zoomed(orbit, 1)); break;
      case "further": this.look((orbit) => zoomed(orbit, -1)); break;
      case "wireframe":
        this.shown.style = (this.shown.style + 1) % SURFACE_STYLES.length;
        for (const scene of scenes) scene.setStyle(SURFACE_STYLES[this.shown.style]);
        break;
      case "contacts":
        this.shown.contacts = !this.shown.contacts;
        for (const view of views.all) view.showContacts(this.shown.contacts);
        break;
      case "forces": this.shown.forces = !this.shown.forces; break;
      case "fixed_nodes":
        this.shown.fixedNodes = !this.shown.fixedNodes;
        for (const scene of scenes) scene.showFixed(this.shown.fixedNodes);
        break;
      case "bodies": this.bodies.hideNext(); break;
      case "theatre": this.turnTheatre(); break;
      case "wipe": for (const { theatre } of views.all) theatre.smear = 0; break;
      case "outside": for (const { theatre } of views.all) theatre.toggleOutside(); break;
      case "detail":
        this.shown.detail = nextDetail(this.shown.detail);
        for (const scene of scenes) scene.setDetail(this.shown.detail);
        this.messages.notice(text(`detail_${this.shown.detail}`));
        break;
      case "screenshot": void savePicture(scenes[views.active].picture(this.page.orientation), views.all[views.active].header?.step ?? 0, this.messages); break;
      case "help": this.help.open = !this.help.open; break;
      case "leave": this.help.open = false; break;
    }
    this.redraw();
  }

  /** All look through their endoscopes, or from outside. */
  private turnTheatre(): void {
    const theatres = this.views.all.map(({ theatre }) => theatre).filter(({ endoscope }) => endoscope !== null);
    if (theatres.length === 0) return this.messages.notice(text("replay_no_endoscope"));
    const on = !theatres[0].on;
    for (const theatre of theatres) if (theatre.on !== on) theatre.turn(on);
  }

  /** Both are seen from another beginning on; the clock stays at the same place of the first one. */
  private beginWith(beginning: Beginning): void {
    const { views } = this;
    if (!views.clock.canBeginWithTask) return;
    const time_s = views.clock.timeIn(0, this.playback.time_s);
    views.clock.beginWith(beginning);
    this.playback = new Playback(views.clock.begin_s, views.clock.end_s, this.playback);
    this.began();
    this.bookmarks.show();
    this.jump(time_s - views.clock.start_s(0));
  }

  private get frameNow(): number {
    return this.views.clock.frameAt(this.playback.time_s);
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
    this.views.take(this.playback.time_s);
    this.views.draw(now_ms, this.shown.forces);
    this.showWords();
    if (this.viewChanged) drawOrientation(this.page.orientation, this.views.first.scene.orbit, this.views.first.scene.height);
    this.viewChanged = false;
    if (this.playback.playing) this.invalidate();
  }

  private fail(error: unknown): void {
    this.playback.playing = false;
    this.messages.error(`The recording cannot be played here: ${error instanceof Error ? error.message : String(error)}`);
  }

  /** Panel, plot, timeline, lists and switches. */
  private showWords(): void {
    const { playback, views, views: { first: { recording, hello, theatre, header: shownHeader, arrowScale_m_per_n, scene: { chosen } } } } = this;
    const header = shownHeader && { ...shownHeader, paused: !playback.playing };
    const frame = recording.frameAt(views.clock.timeIn(0, playback.time_s));
    this.history.clear();
    let peak_n = 0;
    for (let i = 0; i <= frame; i++) {
      const [time_s, force_n] = [recording.times_s[i], recording.forces_n[i][chosen] ?? 0];
      peak_n = Math.max(peak_n, force_n);
      if (time_s >= recording.times_s[frame] - PLOT_SPAN_S) this.history.add({ time_s, force_n });
    }
    const values = panelValues(hello, header, peak_n, arrowScale_m_per_n, chosen);
    const state = playback.playing ? (playback.speed === 1 ? text("replay_state_playing") : text("replay_state_playing_at", { speed: playback.speed })) : text("value_paused");
    this.panel.show({ ...values, state }, header);
    drawChart(this.panel.plot, forceChart(this.history));
    this.timeline.show(this.frameNow, playback.time_s, playback.speed);
    this.lists.forEach((list, i) => list.show(views.clock.timeIn(i, playback.time_s)));
    if (views.isPair) this.page.names.forEach((node, i) => this.showName(node, i));
    const { bar, shown } = this;
    bar.set("play", playback.playing, text(playback.playing ? "button_pause" : "replay_button_play"));
    const { contacts, forces, fixedNodes } = shown;
    const switches = { wireframe: shown.style !== 0, contacts, forces, fixed_nodes: fixedNodes, help: this.help.open, couple: views.coupled, align: views.clock.beginning === "task", theatre: theatre.on, outside: theatre.showsOutside };
    for (const [action, on] of Object.entries(switches)) bar.set(action as PlayerAction, on);
    bar.offer("theatre", theatre.endoscope !== null);
    for (const action of ["wipe", "outside"] as const) bar.offer(action, theatre.on);
    hello.tools.forEach((_, tool) => bar.set(`tool_${tool + 1}` as PlayerAction, tool === chosen));
  }

  /** Above a picture: which recording it is, its own time, and the force on the instrument. */
  private showName(node: HTMLElement, view: number): void {
    const { recording: { name }, header } = this.views.all[view];
    const force = header === null ? "" : forceText(Math.hypot(...header.forceOnTool_n));
    const words = [`${LETTERS[view]} ${name}`, timeText(this.views.clock.timeIn(view, this.playback.time_s)), force].join(" · ");
    if (node.textContent !== words) node.textContent = words;
  }

  report(): PlayerReport {
    const { playback, messages, bookmarks, views, views: { first: { recording, shownFrame, header, hello, theatre, scene } } } = this;
    const { time_s, playing, speed } = playback;
    const [, other] = views.all;
    const beside = other === undefined ? null : { frame: other.shownFrame, time_s: views.clock.timeIn(1, time_s), header: other.header, azimuth_rad: other.scene.orbit.azimuth_rad };
    return structuredClone({ frame: shownFrame, nFrames: recording.nFrames, time_s, playing, speed, header, hello, theatre: theatre.report(), messages: messages.texts(), bookmarks: bookmarks.all, drawnDots: scene.classMarks.shown.dots, azimuth_rad: scene.orbit.azimuth_rad, beside });
  }
}
