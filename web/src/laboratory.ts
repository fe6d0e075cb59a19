/** What a laboratory has beside the picture: numbers to turn, the inside of bodies, plots, and the page of input devices. */
import type { Action } from "./actions";
import { LiveBookmarks } from "./bookmarks";
import type { Connection } from "./connection";
import type { HandMotion } from "./hand_motion";
import type { Hands } from "./hands";
import type { DevicesNow } from "./input_devices/dialog";
import { Inputs, type InputEvents } from "./input_devices/inputs";
import { Inside } from "./inside/inside";
import type { Page } from "./page";
import type { Panel } from "./panel";
import { Plots } from "./plots";
import type { Hello } from "./protocol";
import type { Scene3d } from "./scene3d";
import type { LoopNews } from "./timing";
import { Turning } from "./turning/turning";

export interface LaboratoryParts {
  readonly page: Page;
  readonly panel: Panel;
  readonly scene: Scene3d;
  readonly hands: Hands;
  readonly motion: HandMotion;
  readonly news: LoopNews;
  readonly connection: () => Connection;
}

export interface LaboratoryEvents extends InputEvents {
  /** The picture is another one. */
  redraw(): void;
  now(): DevicesNow & {
    /** Of what is shown [s]; null before there is something. */
    readonly time_s: number | null;
  };
}

export class Laboratory {
  readonly plots: Plots;
  readonly inside: Inside;
  private readonly turning: Turning;
  private readonly inputs: Inputs;
  private readonly bookmarks: LiveBookmarks;

  constructor(private readonly parts: LaboratoryParts, private readonly events: LaboratoryEvents) {
    const { page, panel, scene, hands, motion, news, connection } = parts;
    this.plots = new Plots(panel);
    this.turning = new Turning(page.turning, (message) => connection().send(message));
    this.inside = new Inside(page.inside, scene.inside, connection, (plane) => {
      scene.inside.cut(plane, scene.organs.values(), scene.renderer);
      // Drops would hang in the air where tissue is taken away.
      scene.field.group.visible = plane === null;
      events.redraw();
    });
    this.inputs = new Inputs(connection, hands, motion, news, events);
    this.bookmarks = new LiveBookmarks(page.messages, (message) => connection().send(message));
    news.turned = (parameters) => this.turning.show(parameters);
  }

  begin(hello: Hello): void {
    this.plots.clear();
    this.turning.begin(hello.bodies.map(({ name }) => name));
    this.inside.begin(hello);
  }

  /** Does what an action asks for that is of the laboratory; other actions are not. */
  run(action: Action): void {
    switch (action) {
      case "turning":
        this.turning.open = !this.turning.open;
        break;
      case "devices":
        this.inputs.devices.open = !this.inputs.devices.open;
        break;
      case "field":
        this.inside.nextField();
        break;
      case "plane":
        this.inside.nextPlane();
        break;
      case "plane_deeper":
      case "plane_back":
        this.inside.move(action === "plane_deeper" ? 1 : -1);
        break;
      case "bookmark": {
        const { time_s } = this.events.now();
        if (time_s !== null) this.bookmarks.set(time_s);
        break;
      }
      case "plot_next":
        this.plots.next();
        break;
      case "plot_save":
        this.plots.save();
        break;
    }
  }

  /** Closes what is open of it, the foremost first; false if nothing is. */
  close(): boolean {
    const open = [this.inputs.devices, this.turning].find((part) => part.open);
    if (open !== undefined) open.open = false;
    return open !== undefined;
  }

  /** Once a frame. */
  draw(): void {
    this.inside.plotEnergies(this.plots.looksInside);
    this.plots.draw(this.parts.news.timing);
    this.inside.showScale();
  }

  /** What is switched on, for the buttons. */
  get shown(): { readonly turning: boolean; readonly devices: boolean; readonly field: boolean; readonly plane: boolean } {
    const { field, plane } = this.inside.looks;
    return { turning: this.turning.open, devices: this.inputs.devices.open, field: field !== "none", plane: plane !== "off" };
  }
}
