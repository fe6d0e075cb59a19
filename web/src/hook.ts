/**
 * `window.glisson`: what the page shows, for tests and for the curious. Read only: every value is a copy, nothing can
 * be changed through it. Lengths in metres, pixels are CSS pixels of the page.
 */
import type { ConnectionState } from "./connection";
import { Vector3 } from "three";
import type { Help, Messages } from "./overlays";
import { insideOf, SURFACE_STYLES } from "./organ";
import type { Panel, PanelValues } from "./panel";
import type { Profile } from "./profiler";
import type { Hello, HandHeader } from "./protocol";
import type { Scene3d } from "./scene3d";
import type { TheatreReport } from "./theatre/view";
import type { ToolDriver } from "./tool_driver";

/** Counts of what came and went. */
export const newCounters = () => ({
  topologyFrames: 0,
  snapshotFrames: 0,
  ignoredSnapshots: 0,
  drawnFrames: 0,
  sentToolMessages: 0,
  connections: 0,
  screenshots: 0,
});

export interface ViewerHook {
  readonly hello: Hello | null;
  /** Header of the snapshot in the last drawn frame; null before the first. */
  readonly header: HandHeader | null;
  /** Displayed positions of organ 0, xyz of each vertex [m]: a copy of the array that fills the GPU buffer. */
  readonly positions: Float32Array | null;
  /** Rest positions of organ 0 from its TOPOLOGY frame [m]. */
  readonly restPositions: Float32Array | null;
  /** Node id of each displayed vertex of organ 0. */
  readonly nodeIds: Uint32Array | null;
  readonly triangles: Uint32Array | null;
  /** Displayed vertices of organ 0 that lie in cuts alone. */
  readonly verticesInCuts: number;
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
    readonly panel: boolean;
    readonly plot: boolean;
    readonly sound: boolean;
    readonly azimuth_rad: number;
    readonly elevation_rad: number;
    readonly distance_m: number;
    readonly target_m: readonly [number, number, number];
  };
  readonly theatre: TheatreReport;
  /** Dots of what is drawn on the tissue, and of those who point. */
  readonly drawn: { readonly dots: number; readonly pointers: number };
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

/** What of the viewer the hook reads. */
export interface ViewerParts {
  readonly scene: Scene3d;
  readonly panel: Panel;
  readonly messages: Messages;
  readonly help: Help;
  readonly tool: ToolDriver;
  readonly profile: Profile;
  readonly hello: Hello | null;
  readonly header: HandHeader | null;
  readonly pickedVertex: number | null;
  readonly theatre: { report(): TheatreReport };
  readonly state: ConnectionState;
  readonly shown: Omit<ViewerHook["view"], "style" | "help" | "azimuth_rad" | "elevation_rad" | "distance_m" | "target_m"> & {
    readonly style: number;
  };
  readonly counters: ViewerHook["counters"];
}

const triple = (v: Vector3): readonly [number, number, number] => [v.x, v.y, v.z];

/** The hook of a viewer whose parts `parts` gives, read anew at every access. */
export function viewerHook(parts: () => ViewerParts): ViewerHook {
  const organ = () => parts().scene.organs.get(0) ?? null;
  const box = () => parts().scene.canvas.getBoundingClientRect();
  return Object.freeze({
    get hello() {
      return structuredClone(parts().hello);
    },
    get header() {
      return structuredClone(parts().header);
    },
    get positions() {
      return organ()?.positions_m.slice() ?? null;
    },
    get restPositions() {
      return organ()?.topology.rest_m.slice() ?? null;
    },
    get nodeIds() {
      return organ()?.topology.nodeIds.slice() ?? null;
    },
    get triangles() {
      return organ()?.topology.triangles.slice() ?? null;
    },
    get verticesInCuts() {
      const shown = organ();
      return shown === null ? 0 : insideOf(shown.topology).reduce((sum, x) => sum + x, 0);
    },
    get pickedVertex() {
      return parts().pickedVertex;
    },
    get tool() {
      const { active, pushing, settled, pose } = parts().tool;
      return { active, pushing, settled, sentTip: pose === null ? null : triple(pose.tip_m) };
    },
    get panel() {
      return parts().panel.values();
    },
    get view() {
      const { shown, help, scene } = parts();
      const { azimuth_rad, elevation_rad, distance_m, target_m } = scene.orbit;
      const camera = { azimuth_rad, elevation_rad, distance_m, target_m: triple(target_m) };
      return { ...shown, ...camera, style: SURFACE_STYLES[shown.style], help: help.open };
    },
    get drawn() {
      return parts().scene.classMarks.shown;
    },
    get theatre() {
      return parts().theatre.report();
    },
    get connection() {
      return parts().state;
    },
    get messages() {
      return parts().messages.texts();
    },
    get counters() {
      return { ...parts().counters };
    },
    get frameWork_ms() {
      return parts().profile.summary(performance.now()).work_ms;
    },
    project(vertex: number): [number, number] | null {
      const positions = organ()?.positions_m;
      if (positions === undefined || !(vertex >= 0 && 3 * vertex + 2 < positions.length)) return null;
      const [x, y] = parts().scene.project(new Vector3().fromArray(positions, 3 * vertex));
      return [x + box().left, y + box().top];
    },
    vertexAt(x: number, y: number): number | null {
      const pick = parts().scene.pick(x - box().left, y - box().top);
      return pick === null || pick.organ !== 0 ? null : pick.vertex;
    },
  });
}
