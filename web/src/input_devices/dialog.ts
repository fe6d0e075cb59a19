/**
 * The page of input devices: which instrument each pointer, gamepad, pedal and force-feedback device moves, what its sticks and buttons do, and
 * what they say at the moment; and which instruments another machine has. While it is open, gamepads and pedals move nothing.
 */
import { connectedPads, padNames, stateOf } from "../gamepad";
import { giveFocusBack } from "../keys";
import { text } from "../language";
import type { ClientMessage, Hello } from "../protocol";
import { keepSettings, readSettings } from "../settings";
import type { Holder, Role } from "../timing";
import { USUAL_PAD, type Pedal, type PadMappings, type Pedals } from "./mapping";
import { PadCard } from "./pad_card";
import { actionChoice, check, element, instrumentChoice, pressButton } from "./parts";

export interface DevicesNow {
  readonly hello: Hello | null;
  readonly role: Role | null;
  /** Number of the instrument that pointer and keys move. */
  readonly chosen: number;
}

export class Devices {
  pads: PadMappings;
  pedals: Pedals;
  private readonly root = element("div", "overlay devices");
  private readonly page = element("div", "devices-page");
  private cards: PadCard[] = [];
  private table: HTMLElement = element("table");
  private waitsForPedal = false;
  private focusedBefore: Element | null = null;
  private shown = "";

  constructor(
    parent: HTMLElement,
    private readonly now: () => DevicesNow,
    private readonly send: (message: ClientMessage) => void,
    private readonly opened: (open: boolean) => void,
  ) {
    ({ pads: this.pads, pedals: this.pedals } = readSettings());
    this.root.setAttribute("role", "dialog");
    this.root.setAttribute("aria-label", text("devices_title"));
    this.root.setAttribute("aria-modal", "true");
    this.root.hidden = true;
    this.page.tabIndex = -1;
    this.root.append(this.page);
    this.root.addEventListener("click", (event) => {
      if (event.target === this.root) this.open = false;
    });
    window.addEventListener("keydown", (event) => this.takePedal(event), true);
    parent.append(this.root);
  }

  get open(): boolean {
    return !this.root.hidden;
  }

  set open(open: boolean) {
    if (open === this.open) return;
    this.root.hidden = !open;
    // The keyboard stays in the page while it is open.
    for (const id of ["frame", "scene"]) document.getElementById(id)?.toggleAttribute("inert", open);
    this.waitsForPedal = false;
    this.opened(open);
    if (open) {
      this.focusedBefore = document.activeElement;
      this.shown = "";
      this.look();
      this.page.focus();
    } else {
      giveFocusBack(this.focusedBefore);
    }
  }

  /** Once a frame while it is open: what is connected, and what it says. */
  private look(): void {
    if (!this.open) return;
    const pads = connectedPads();
    const { hello, role, chosen } = this.now();
    const shown = JSON.stringify([pads.map(({ id, index }) => [id, index]), hello?.tools.map(({ name }) => name), hello?.devices, role, chosen]);
    if (shown !== this.shown) this.build(pads);
    this.shown = shown;
    this.cards.forEach((card, i) => {
      const pad = pads[i];
      if (pad !== undefined) card.show(stateOf(pad));
    });
    requestAnimationFrame(() => this.look());
  }

  private get names(): string[] {
    return this.now().hello?.tools.map(({ name }) => name) ?? [];
  }

  private build(pads: readonly Gamepad[]): void {
    const focusable = (): HTMLElement[] => [...this.page.querySelectorAll<HTMLElement>("input, select, button")];
    const focused = focusable().indexOf(document.activeElement as HTMLElement);
    const names = padNames.of(pads);
    this.cards = pads.map(
      (pad, i) =>
        new PadCard(names[i], stateOf(pad), this.pads[names[i]] ?? USUAL_PAD, this.names, (mapping) => {
          this.pads = { ...this.pads, [names[i]]: mapping };
          keepSettings({ pads: this.pads });
          this.table.replaceWith((this.table = this.instruments()));
        }),
    );
    const cards = element("div", "devices-cards");
    cards.append(...this.cards.map(({ root }) => root));
    if (this.cards.length === 0) cards.append(element("p", "", text("devices_no_pad")));
    this.page.replaceChildren(
      element("h1", "", text("devices_title")),
      element("h2", "", text("devices_instruments")),
      (this.table = this.instruments()),
      element("h2", "", text("devices_pads")),
      cards,
      element("h2", "", text("devices_pedals")),
      this.pedalList(),
      element("p", "help-foot", text("devices_foot")),
      pressButton(text("devices_close"), () => (this.open = false)),
    );
    // What is built anew keeps the focus.
    if (focused >= 0) (focusable()[focused] ?? this.page).focus();
  }

  /** Which device or page has each instrument. */
  private instruments(): HTMLElement {
    const { hello, role, chosen } = this.now();
    const list = element("table", "devices-table");
    hello?.tools.forEach(({ name }, tool) => {
      const device = hello.devices.find((held) => held.tool === tool)?.name;
      const holder = role?.instruments[tool] ?? "controller";
      const row = element("tr");
      const movers = pointsTo(this.pads, this.pedals, tool, chosen, connectedPads());
      const who = device !== undefined ? text("devices_held_by", { device }) : movers.join(", ");
      row.append(element("td", "", `${tool + 1}: ${name}`), element("td", "", who), element("td", "", text(`devices_holder_${holder}`)));
      const last = element("td");
      last.append(...this.steps(tool, holder, role?.role === "controller"));
      row.append(last);
      list.append(row);
    });
    return list;
  }

  private steps(tool: number, holder: Holder, controls: boolean): HTMLElement[] {
    const button = (what: "offer" | "call_back" | "take" | "give_back", message: ClientMessage): HTMLElement => {
      const press = pressButton(text(`devices_${what}`), () => this.send(message));
      press.setAttribute("aria-label", `${text(`devices_${what}`)}: ${tool + 1}`);
      return press;
    };
    if (holder === "this") return [button("give_back", { type: "hold", tool, held: false })];
    if (controls) {
      return [holder === "controller" ? button("offer", { type: "offer", tool, offered: true }) : button("call_back", { type: "offer", tool, offered: false })];
    }
    return holder === "offered" ? [button("take", { type: "hold", tool, held: true })] : [];
  }

  private pedalList(): HTMLElement {
    const list = element("div", "devices-lines");
    for (const [code, pedal] of Object.entries(this.pedals)) {
      const put = (changed: Partial<Pedal>): void => this.keepPedals({ ...this.pedals, [code]: { ...pedal, ...changed } });
      const line = element("div", "devices-line");
      const { [code]: _, ...others } = this.pedals;
      line.append(
        element("kbd", "", code),
        actionChoice(text("devices_pedal_does", { key: code }), pedal.action, (action) => (action === null ? this.keepPedals(others) : put({ action }))),
        instrumentChoice(text("devices_pedal_moves", { key: code }), this.names, pedal.instrument, (instrument) => put({ instrument })),
      );
      if (pedal.action === "trigger" || pedal.action === "jaws") line.append(check(text("devices_while_held"), pedal.whileHeld, (whileHeld) => put({ whileHeld })));
      const remove = pressButton("×", () => this.keepPedals(others));
      remove.setAttribute("aria-label", text("devices_remove", { key: code }));
      line.append(remove);
      list.append(line);
    }
    const add = pressButton(text(this.waitsForPedal ? "devices_press_pedal" : "devices_add_pedal"), () => {
      this.waitsForPedal = !this.waitsForPedal;
      this.shown = "";
    });
    list.append(add);
    return list;
  }

  private keepPedals(pedals: Pedals): void {
    this.pedals = pedals;
    keepSettings({ pedals });
    this.shown = "";
  }

  /** The next key is a pedal. */
  private takePedal(event: KeyboardEvent): void {
    if (!this.open || !this.waitsForPedal || ["Escape", "Tab", "Shift", "Control", "Alt", "Meta"].includes(event.key)) return;
    event.preventDefault();
    event.stopPropagation();
    this.waitsForPedal = false;
    this.keepPedals({ ...this.pedals, [event.code]: { action: "trigger", instrument: null, whileHeld: true } });
  }
}

/** What moves an instrument: pointer and keys the one in the hand, gamepads and pedals as they are mapped. */
function pointsTo(pads: PadMappings, pedals: Pedals, tool: number, chosen: number, connected: readonly Gamepad[]): string[] {
  const isMeant = (instrument: number | null): boolean => (instrument ?? chosen) === tool;
  const movers = tool === chosen ? [text("devices_pointer")] : [];
  for (const name of padNames.of(connected)) if (isMeant((pads[name] ?? USUAL_PAD).instrument)) movers.push(name);
  for (const [code, { instrument }] of Object.entries(pedals)) if (isMeant(instrument)) movers.push(code);
  return movers;
}
