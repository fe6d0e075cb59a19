/** A gamepad on the page of input devices: what its sticks and buttons do, and what they say at the moment. */
import { text } from "../language";
import { DEAD_ZONES, MOTIONS, SPEEDS_M_PER_S, stick, USUAL_PAD, type Motion, type PadMapping, type PadState } from "./mapping";
import { actionChoice, check, choice, element, instrumentChoice, pressButton, slider } from "./parts";

export class PadCard {
  readonly root = element("section", "devices-card");
  private readonly bars: HTMLElement[] = [];
  private readonly lamps: HTMLElement[] = [];

  constructor(
    readonly name: string,
    private readonly state: PadState,
    private mapping: PadMapping,
    private readonly names: readonly string[],
    private readonly changed: (mapping: PadMapping) => void,
  ) {
    this.build();
  }

  private put(part: Partial<PadMapping>): void {
    this.mapping = { ...this.mapping, ...part };
    this.changed(this.mapping);
  }

  private build(): void {
    const { mapping } = this;
    const lines = element("div", "devices-lines");
    const which = element("label", "devices-line");
    which.append(element("span", "", text("devices_moves")), instrumentChoice(text("devices_moves"), this.names, mapping.instrument, (instrument) => this.put({ instrument })));
    lines.append(
      which,
      slider(text("devices_dead_zone"), [DEAD_ZONES.least, DEAD_ZONES.greatest, 0.01], mapping.deadZone, (x) => `${Math.round(100 * x)} %`, (deadZone) => this.put({ deadZone })),
      slider(text("devices_speed"), [SPEEDS_M_PER_S.least, SPEEDS_M_PER_S.greatest, 0.005], mapping.speed_m_per_s, (x) => `${Math.round(1000 * x)} mm/s`, (speed_m_per_s) => this.put({ speed_m_per_s })),
    );
    for (const motion of MOTIONS) lines.append(this.axisLine(motion));
    const test = element("div", "devices-test");
    this.bars.length = this.lamps.length = 0;
    this.state.axes.forEach((_, axis) => {
      const bar = element("div", "devices-bar");
      bar.setAttribute("role", "meter");
      bar.setAttribute("aria-label", text("devices_axis", { n: axis }));
      bar.setAttribute("aria-valuemin", "-1");
      bar.setAttribute("aria-valuemax", "1");
      bar.append(element("span", "", String(axis)), element("i"));
      this.bars.push(bar);
      test.append(bar);
    });
    const buttons = element("div", "devices-buttons");
    this.state.pressed.forEach((_, number) => {
      const line = element("label", "devices-line");
      const lamp = element("span", "devices-lamp", text("devices_button", { n: number }));
      this.lamps.push(lamp);
      const label = text("devices_button", { n: number });
      const act = actionChoice(label, mapping.buttons[number] ?? null, (action) => {
        const { [number]: _, ...others } = this.mapping.buttons;
        this.put({ buttons: action === null ? others : { ...others, [number]: action } });
      });
      line.append(lamp, act);
      buttons.append(line);
    });
    const usual = pressButton(text("devices_usual"), () => {
      this.put(USUAL_PAD);
      this.build();
    });
    this.root.replaceChildren(element("h3", "", this.name), lines, test, buttons, usual);
    this.show(this.state);
  }

  private axisLine(motion: Motion): HTMLElement {
    const line = element("div", "devices-line");
    const { axis, inverted } = this.mapping.axes[motion];
    const label = text(`devices_${motion}`);
    const options = this.state.axes.map((_, number) => [String(number), text("devices_axis", { n: number })] as const);
    const put = (part: { axis?: number | null; inverted?: boolean }): void =>
      this.put({ axes: { ...this.mapping.axes, [motion]: { ...this.mapping.axes[motion], ...part } } });
    line.append(
      element("span", "", label),
      choice(label, [["", text("devices_nothing")], ...options], axis === null ? "" : String(axis), (value) => put({ axis: value === "" ? null : Number(value) })),
      check(text("devices_inverted"), inverted, (on) => put({ inverted: on })),
    );
    return line;
  }

  /** What it says now: a bar is dim within the dead zone. */
  show(state: PadState): void {
    this.bars.forEach((bar, axis) => {
      const value = state.axes[axis] ?? 0;
      bar.classList.toggle("acts", stick(value, this.mapping.deadZone) !== 0);
      bar.setAttribute("aria-valuenow", value.toFixed(2));
      const mark = bar.querySelector("i");
      if (mark !== null) mark.style.left = `${50 + 50 * Math.max(-1, Math.min(1, value))}%`;
    });
    this.lamps.forEach((lamp, number) => lamp.classList.toggle("on", state.pressed[number] === true));
  }
}
