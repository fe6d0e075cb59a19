/** Which way the patient lies (axes with the letters of the anatomical directions) and a scale bar. */
import { Vector3 } from "three";
import { metresPerPixel, viewAxes, type Orbit } from "./orbit";

export interface AxisEnd {
  readonly letter: string;
  /** On the screen, right and up, in units of the axis' length. */
  readonly x: number;
  readonly y: number;
  /** Towards the viewer, -1 to 1. */
  readonly near: number;
  readonly colour: string;
}

/** Patient frame LPS: +x left, +y posterior, +z superior. Letters: left/right, anterior/posterior, superior/inferior. */
const ENDS: ReadonlyArray<readonly [string, Vector3, string]> = [
  ["L", new Vector3(1, 0, 0), "#ff7a6b"],
  ["R", new Vector3(-1, 0, 0), "#ff7a6b"],
  ["P", new Vector3(0, 1, 0), "#7ddc86"],
  ["A", new Vector3(0, -1, 0), "#7ddc86"],
  ["S", new Vector3(0, 0, 1), "#74b6ff"],
  ["I", new Vector3(0, 0, -1), "#74b6ff"],
];

/** The six ends as seen, the farthest first. */
export function axisEnds(orbit: Orbit): AxisEnd[] {
  const { right, up, forward } = viewAxes(orbit);
  return ENDS.map(([letter, axis, colour]) => ({
    letter,
    colour,
    x: axis.dot(right),
    y: axis.dot(up),
    near: -axis.dot(forward),
  })).sort((a, b) => a.near - b.near);
}

/** The longest of 1, 2, 5 times a power of ten [m] that is at most `pixels` wide. */
export function scaleBar_m(orbit: Orbit, heightPixels: number, pixels: number): number {
  const widest = metresPerPixel(orbit, heightPixels) * pixels;
  const power = Math.pow(10, Math.floor(Math.log10(widest)));
  return ([5, 2, 1].find((f) => f * power <= widest) ?? 1) * power;
}

export function drawOrientation(canvas: HTMLCanvasElement, orbit: Orbit, sceneHeight: number): void {
  const context = canvas.getContext("2d");
  if (context === null) return;
  const ratio = Math.max(1, window.devicePixelRatio);
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);

  const length = 40;
  const [cx, cy] = [width - length - 24, length + 18];
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.font = "600 13px system-ui, sans-serif";
  for (const end of axisEnds(orbit)) {
    const [x, y] = [cx + end.x * length, cy - end.y * length];
    context.globalAlpha = 0.45 + 0.55 * (0.5 + 0.5 * end.near);
    context.strokeStyle = end.colour;
    context.lineWidth = end.near > 0 ? 2.5 : 1.5;
    context.beginPath();
    context.moveTo(cx, cy);
    context.lineTo(cx + 0.74 * (x - cx), cy + 0.74 * (y - cy));
    context.stroke();
    context.fillStyle = end.colour;
    context.fillText(end.letter, x, y + 1);
  }
  context.globalAlpha = 1;

  const bar_m = scaleBar_m(orbit, sceneHeight, width - 48);
  const bar = bar_m / metresPerPixel(orbit, sceneHeight);
  const y = height - 12.5;
  const right = width - 24;
  context.strokeStyle = "#aab6c2";
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(right - bar, y - 5);
  context.lineTo(right - bar, y);
  context.lineTo(right, y);
  context.lineTo(right, y - 5);
  context.stroke();
  context.fillStyle = "#aab6c2";
  context.font = "11px system-ui, sans-serif";
  context.fillText(`${Number((1000 * bar_m).toPrecision(3))} mm`, right - bar / 2, y - 9);
}
