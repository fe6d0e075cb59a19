/**
 * Sounds of the theatre, made by the browser: the tone of a cautery that is switched on, the hiss of suction, the monitor's beep, and
 * an alarm while much bleeds. What sounds follows from snapshots alone, in the time of the simulation; off until it is asked for.
 */
import { isSucking } from "./field/suction";
import { latticeValue } from "./noise";
import type { Hello, SnapshotHeader } from "./protocol";

/** Beats of the heart are made up: nothing of the patient is simulated that would change them [1/min]. */
const BEATS_PER_MIN = 72;
/** So much bleeding alarms [m3/s]: 5 ml/min, a choice. */
const ALARM_M3_PER_S = 5e-6 / 60;
/** The alarm's two notes change so often [s]. */
const ALARM_NOTE_S = 0.4;
const HOT: ReadonlySet<string> = new Set(["hook", "cautery"]);

/** What is to be heard now. */
export interface Sounds {
  /** An instrument that burns is switched on. */
  readonly cautery: boolean;
  /** A suction tube sucks. */
  readonly suction: boolean;
  /** A heartbeat fell between the last snapshot and this one. */
  readonly beat: boolean;
  /** The note of the alarm; null for none. */
  readonly alarm: 0 | 1 | null;
}

export const SILENCE: Sounds = { cautery: false, suction: false, beat: false, alarm: null };

export class Score {
  private time_s: number | null = null;

  /** What a snapshot sounds like. */
  take({ time_s, paused, tools, bleeding }: Pick<SnapshotHeader, "time_s" | "paused" | "tools" | "bleeding">, hello: Pick<Hello, "tools">): Sounds {
    const before_s = this.time_s ?? time_s;
    this.time_s = time_s;
    if (paused) return SILENCE;
    const beats = (at_s: number): number => Math.floor((at_s * BEATS_PER_MIN) / 60);
    return {
      cautery: tools.some(({ trigger }, i) => trigger > 0.5 && HOT.has(hello.tools[i]?.kind ?? "")),
      suction: tools.some((tool, i) => isSucking(hello.tools[i]?.kind, tool)),
      beat: beats(time_s) > beats(before_s),
      alarm: (bleeding?.rate_m3_per_s ?? 0) >= ALARM_M3_PER_S ? (Math.floor(time_s / ALARM_NOTE_S) % 2 === 0 ? 0 : 1) : null,
    };
  }
}

/** Without a snapshot for so long nothing sounds [ms]. */
const SILENT_AFTER_MS = 400;
/** Volumes, and how fast tones come and go [s]. */
const [TONE, BEEP, HISS, FADE_S] = [0.05, 0.07, 0.02, 0.015];
/** The hiss is noise around a frequency [Hz], so long before it comes again [s]. */
const HISS_AT_HZ = 2400;
const HISS_S = 1.7;

export class Sound {
  private score = new Score();
  private context: AudioContext | null = null;
  private readonly tones = new Map<string, { readonly oscillator: OscillatorNode; readonly gain: GainNode }>();
  private noise: GainNode | null = null;
  private silence: ReturnType<typeof setTimeout> | undefined;
  private isOn = false;

  get on(): boolean {
    return this.isOn;
  }

  turn(on: boolean): void {
    this.isOn = on;
    if (!on) return this.play(SILENCE);
    this.wake();
    // Browsers let a page sound once somebody has pressed something.
    for (const event of ["pointerdown", "keydown"] as const) window.addEventListener(event, () => this.wake(), { once: true });
  }

  private wake(): void {
    this.context ??= new AudioContext();
    if (this.isOn && this.context.state === "suspended") void this.context.resume().catch(() => undefined);
  }

  take(header: SnapshotHeader, hello: Hello | null): void {
    if (!this.isOn || hello === null) return;
    this.play(this.score.take(header, hello));
    clearTimeout(this.silence);
    this.silence = setTimeout(() => this.play(SILENCE), SILENT_AFTER_MS);
  }

  private play({ cautery, suction, beat, alarm }: Sounds): void {
    const { context } = this;
    if (context === null) return;
    this.tone(context, "cautery", 410, cautery ? TONE : 0);
    this.tone(context, "alarm", alarm === 1 ? 740 : 932, alarm === null ? 0 : TONE);
    this.hiss(context, suction ? HISS : 0);
    if (beat) this.beep(context);
  }

  private tone(context: AudioContext, name: string, hertz: number, volume: number): void {
    let tone = this.tones.get(name);
    if (tone === undefined) {
      if (volume === 0) return;
      tone = { oscillator: context.createOscillator(), gain: context.createGain() };
      tone.gain.gain.value = 0;
      tone.oscillator.connect(tone.gain).connect(context.destination);
      tone.oscillator.start();
      this.tones.set(name, tone);
    }
    tone.oscillator.frequency.value = hertz;
    tone.gain.gain.setTargetAtTime(volume, context.currentTime, FADE_S);
  }

  private hiss(context: AudioContext, volume: number): void {
    if (this.noise === null) {
      if (volume === 0) return;
      const buffer = context.createBuffer(1, HISS_S * context.sampleRate, context.sampleRate);
      buffer.getChannelData(0).forEach((_, i, samples) => (samples[i] = 2 * latticeValue(i, 0, 91) - 1));
      const [source, band] = [context.createBufferSource(), context.createBiquadFilter()];
      Object.assign(source, { buffer, loop: true });
      band.type = "bandpass";
      band.frequency.value = HISS_AT_HZ;
      band.Q.value = 0.5;
      this.noise = context.createGain();
      this.noise.gain.value = 0;
      source.connect(band).connect(this.noise).connect(context.destination);
      source.start();
    }
    this.noise.gain.setTargetAtTime(volume, context.currentTime, 4 * FADE_S);
  }

  private beep(context: AudioContext): void {
    const [oscillator, gain] = [context.createOscillator(), context.createGain()];
    oscillator.frequency.value = 880;
    gain.gain.setValueAtTime(BEEP, context.currentTime);
    gain.gain.setTargetAtTime(0, context.currentTime + 0.07, FADE_S);
    oscillator.connect(gain).connect(context.destination);
    oscillator.start();
    oscillator.stop(context.currentTime + 0.2);
  }
}
