/**
 * `window.glisson`: what the page shows, for tests and for the curious. Read only: every value is a copy, nothing can
 * be changed through it. Lengths in metres, pixels are CSS pixels of the page.
 */
import type { ConnectionState } from "./connection";
import type { PanelValues } from "./panel";
import type { Hello, SnapshotHeader } from "./protocol";

export interface ViewerHook {
  readonly hello: Hello | null;
  /** Header of the snapshot in the last drawn frame; null before the first. */
  readonly header: SnapshotHeader | null;
  /** Displayed positions of organ 0, xyz of each vertex [m]: a copy of the array that fills the GPU buffer. */
  readonly positions: Float32Array | null;
  /** Rest positions of organ 0 from its TOPOLOGY frame [m]. */
  readonly restPositions: Float32Array | null;
  /** Node id of each displayed vertex of organ 0. */
  readonly nodeIds: Uint32Array | null;
  readonly triangles: Uint32Array | null;
  /** Vertex nearest to the picked point of the last push; null before the first. */
  readonly pickedVertex: number | null;
  readonly tool: {
    /** This page holds the instrument. */
    readonly active: boolean;
    readonly pushing: boolean;
    /** The tip that was last sent is where the hand wants it. */
    readonly settled: boolean;
    readonly sentTip: readonly [number, number, number] | null;
  };
  readonly panel: PanelValues;
  readonly view: {
    readonly style: string;
    readonly contacts: boolean;
    readonly forces: boolean;
    readonly fixedNodes: boolean;
    readonly help: boolean;
    readonly profiler: boolean;
    readonly azimuth_rad: number;
    readonly elevation_rad: number;
    readonly distance_m: number;
    readonly target_m: readonly [number, number, number];
  };
  readonly connection: ConnectionState;
  readonly messages: readonly string[];
  readonly counters: {
    readonly topologyFrames: number;
    readonly snapshotFrames: number;
    /** Snapshots of another topology than the one shown. */
    readonly ignoredSnapshots: number;
    readonly drawnFrames: number;
    readonly sentToolMessages: number;
    readonly connections: number;
    readonly screenshots: number;
  };
  /** Mean processor time of a frame's work over the last two seconds [ms]. */
  readonly frameWork_ms: number;
  /** Where displayed vertex `vertex` of organ 0 is on the page [CSS pixels]; null if there is no such vertex. */
  project(vertex: number): [number, number] | null;
  /** Vertex of organ 0 nearest to what a press at this place of the page would touch; null for the background. */
  vertexAt(x: number, y: number): number | null;
}

declare global {
  interface Window {
    readonly glisson?: ViewerHook;
  }
}
