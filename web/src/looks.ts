/** What of the viewer is switched on, and kept for the next time: the look of the organ, what is drawn with it, panel and plot. */
import type { Connection } from "./connection";
import type { Contacts } from "./contacts";
import { nextDetail, type DetailChoice } from "./detail";
import type { Action } from "./keys";
import { text } from "./language";
import { SURFACE_STYLES } from "./organ";
import type { ShownParts } from "./overlays";
import type { Panel } from "./panel";
import type { Scene3d } from "./scene3d";
import { keepSettings, readSettings, type Settings } from "./settings";
import { Sound } from "./sound";
import { nextStereo } from "./theatre/stereo";
import type { Theatre } from "./theatre/view";

/** On a narrower page the panel begins with the force alone [CSS pixels]. */
const NARROW_PX = 560;

/** The actions that turn a switch, or go on to its next place. */
const SWITCHES = ["wireframe", "contacts", "forces", "fixed_nodes", "profiler", "panel", "plot", "detail", "sound", "stereo"] as const;
export type Switch = (typeof SWITCHES)[number];

export function isSwitch(action: Action): action is Switch {
  return (SWITCHES as readonly string[]).includes(action);
}

type Shown = { -readonly [name in keyof ShownParts]: ShownParts[name] };

export class Looks {
  readonly shown: Shown;
  readonly sound = new Sound();
  /** How much is drawn, as it was chosen. */
  private detail: DetailChoice;
  /** The panel was never asked for: it is open where there is room. */
  private panelIsUsual: boolean;
  private readonly panelSwitch = document.createElement("button");
  private readonly plotSwitch = document.createElement("button");

  constructor(
    private readonly root: HTMLElement,
    private readonly panel: Panel,
    private readonly scene: Scene3d,
    private readonly theatre: Theatre,
    private readonly contacts: Contacts,
    run: (action: Action) => void,
    private readonly tell: (words: string) => void,
  ) {
    const { style, contacts: hasContacts, forces, fixedNodes, profiler, panel: isOpen, plot, theatre: on, outside, detail, sound, stereo } = readSettings();
    this.detail = detail;
    this.shown = { style, contacts: hasContacts, forces, fixedNodes, profiler, panel: isOpen ?? true, plot, sound };
    this.panelIsUsual = isOpen === null;
    theatre.beginsOn = on;
    theatre.outside = outside;
    theatre.stereo = stereo;
    for (const [button, action] of [[this.panelSwitch, "panel"], [this.plotSwitch, "plot"]] as const) {
      button.type = "button";
      button.className = "panel-switch";
      button.addEventListener("click", (event) => {
        run(action);
        // After a mouse click the space bar should pause again, not press this button.
        if (event.detail > 0) button.blur();
      });
    }
    root.querySelector("header")?.append(this.panelSwitch);
    panel.plotLegend.append(" ", this.plotSwitch);
  }

  /** All as it was kept. */
  begin(connection: Connection): void {
    this.scene.setStyle(SURFACE_STYLES[this.shown.style]);
    this.scene.showFixed(this.shown.fixedNodes);
    this.scene.setDetail(this.detail);
    this.sound.turn(this.shown.sound);
    if (this.shown.contacts) this.contacts.turn(true, connection);
    this.layOut();
  }

  /** Turns a switch and keeps it. */
  turn(which: Switch, connection: Connection): void {
    const { shown } = this;
    switch (which) {
      case "wireframe":
        shown.style = (shown.style + 1) % SURFACE_STYLES.length;
        this.scene.setStyle(SURFACE_STYLES[shown.style]);
        break;
      case "contacts":
        shown.contacts = !shown.contacts;
        this.contacts.turn(shown.contacts, connection);
        break;
      case "forces":
        shown.forces = !shown.forces;
        break;
      case "fixed_nodes":
        shown.fixedNodes = !shown.fixedNodes;
        this.scene.showFixed(shown.fixedNodes);
        break;
      case "profiler":
        shown.profiler = !shown.profiler;
        break;
      case "panel":
        shown.panel = !shown.panel;
        this.panelIsUsual = false;
        break;
      case "plot":
        shown.plot = !shown.plot;
        break;
      case "sound":
        this.sound.turn(!this.sound.on);
        shown.sound = this.sound.on;
        break;
      case "stereo":
        this.theatre.stereo = nextStereo(this.theatre.stereo);
        this.tell(text(`stereo_${this.theatre.stereo}`));
        break;
      case "detail":
        this.detail = nextDetail(this.detail);
        this.scene.setDetail(this.detail);
        this.tell(text(`detail_${this.detail}`));
        break;
    }
    this.layOut();
    this.keep({ ...shown, detail: this.detail, stereo: this.theatre.stereo, panel: this.panelIsUsual ? null : shown.panel });
  }

  /** What the theatre view is now, as the user chose it. */
  keepTheatre(): void {
    this.keep({ theatre: this.theatre.on, outside: this.theatre.outside });
  }

  private keep(changed: Partial<Settings>): void {
    keepSettings(changed);
  }

  /** The page's size changed, or a switch was turned. */
  layOut(): void {
    if (this.panelIsUsual) this.shown.panel = window.innerWidth > NARROW_PX;
    const { panel: isOpen, plot } = this.shown;
    this.root.classList.toggle("shut", !isOpen);
    this.panelSwitch.textContent = isOpen ? "−" : "+";
    this.panelSwitch.setAttribute("aria-expanded", String(isOpen));
    this.panelSwitch.title = text(isOpen ? "panel_hide" : "panel_show");
    this.panelSwitch.setAttribute("aria-label", this.panelSwitch.title);
    this.panel.plot.hidden = !plot;
    this.plotSwitch.textContent = plot ? "−" : "+";
    this.plotSwitch.setAttribute("aria-expanded", String(plot));
    this.plotSwitch.title = text(plot ? "plot_hide" : "plot_show");
    this.plotSwitch.setAttribute("aria-label", this.plotSwitch.title);
  }
}
