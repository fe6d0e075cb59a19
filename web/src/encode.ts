/** Encoding of the server's frames: for tests and for the test server. */
import { BLOOD_BYTES, bloodNumbers } from "./blood";
import { encodeClips } from "./clips";
import { encodeContactPoints } from "./contact_points";
import {
  FLAG_CLIPS,
  FLAG_ODD_RESETS,
  FLAG_CONTACT,
  FLAG_CONTACT_POINTS,
  FLAG_GRASP,
  FLAG_PAUSED,
  FLAG_STRANDS,
  FLAG_THREADS,
  KIND_SNAPSHOT,
  KIND_TOPOLOGY,
  MAGIC,
  SNAPSHOT_HEADER_BYTES,
  TOOL_BYTES,
  TOPOLOGY_HEADER_BYTES,
  type Snapshot,
  type Topology,
} from "./protocol";
import { encodeStrands } from "./strands";
import { encodeThreads } from "./threads";

export function encodeTopology(topology: Omit<Topology, "kind">): ArrayBuffer {
  const n = topology.nodeIds.length;
  const flags = TOPOLOGY_HEADER_BYTES + 16 * n + 4 * topology.triangles.length;
  const bodies = flags + 4 * Math.ceil(topology.isCut.length / 32);
  const buffer = new ArrayBuffer(bodies + 4 * Math.ceil(n / 4));
  const view = new DataView(buffer);
  [MAGIC, KIND_TOPOLOGY, topology.version, topology.organ, n, topology.triangles.length / 3].forEach((word, i) =>
    view.setUint32(4 * i, word, true),
  );
  topology.nodeIds.forEach((id, i) => view.setUint32(TOPOLOGY_HEADER_BYTES + 4 * i, id, true));
  topology.rest_m.forEach((x, i) => view.setFloat32(TOPOLOGY_HEADER_BYTES + 4 * n + 4 * i, x, true));
  topology.isCut.forEach((isCut, i) => {
    const at = flags + 4 * Math.floor(i / 32);
    view.setUint32(at, view.getUint32(at, true) | (isCut << (i % 32)), true);
  });
  new Uint8Array(buffer, bodies, n).set(topology.bodyOf);
  topology.triangles.forEach((v, i) => view.setUint32(TOPOLOGY_HEADER_BYTES + 16 * n + 4 * i, v, true));
  return buffer;
}

export function encodeSnapshot(snapshot: Omit<Snapshot, "kind">): ArrayBuffer {
  const { header, positions_m } = snapshot;
  const first = SNAPSHOT_HEADER_BYTES + TOOL_BYTES * header.tools.length;
  const blood = first + 4 * positions_m.length;
  const bloodRecords = bloodNumbers(header.bleeding);
  const contacts = encodeContactPoints(header.contactPoints);
  // In this order behind the blood.
  const parts = [contacts, encodeThreads(header.threads), encodeClips(header.clips), encodeStrands(header.strands_m)];
  const buffer = new ArrayBuffer(parts.reduce((sum, { length }) => sum + length, blood + 4 * bloodRecords.length));
  const view = new DataView(buffer);
  [MAGIC, KIND_SNAPSHOT, header.version, header.organ].forEach((word, i) => view.setUint32(4 * i, word, true));
  view.setBigUint64(16, BigInt(header.step), true);
  const scalars = [header.time_s, header.rate_steps_per_s, header.realTimeFactor];
  scalars.forEach((x, i) => view.setFloat64(24 + 8 * i, x, true));
  const flags = (header.paused ? FLAG_PAUSED : 0) | (header.oddResets ? FLAG_ODD_RESETS : 0) | (header.contactPoints === null ? 0 : FLAG_CONTACT_POINTS) | (header.threads.length === 0 ? 0 : FLAG_THREADS) | (header.clips.length === 0 ? 0 : FLAG_CLIPS) | (header.strands_m.length === 0 ? 0 : FLAG_STRANDS);
  const words = [flags, header.tools.length, positions_m.length / 3, (4 * bloodRecords.length) / BLOOD_BYTES];
  words.forEach((word, i) => view.setUint32(48 + 4 * i, word, true));
  header.tools.forEach((tool, n) => {
    const at = SNAPSHOT_HEADER_BYTES + TOOL_BYTES * n;
    const shares = [tool.roll_rad, tool.jaw, tool.trigger];
    const numbers = [...tool.tip_m, ...tool.shaft, ...shares, ...tool.forceOnTool_n, ...tool.contactPoint_m];
    numbers.forEach((x, i) => view.setFloat64(at + 8 * i, x, true));
    view.setUint32(at + 120, (tool.contact ? FLAG_CONTACT : 0) | (tool.grasps ? FLAG_GRASP : 0), true);
    view.setUint32(at + 124, tool.heldNodes, true);
    tool.shownFurtherOut_m.forEach((x, i) => view.setFloat64(at + 128 + 8 * i, x, true));
  });
  positions_m.forEach((x, i) => view.setFloat32(first + 4 * i, x, true));
  bloodRecords.forEach((x, i) => view.setFloat32(blood + 4 * i, x, true));
  let at = blood + 4 * bloodRecords.length;
  for (const part of parts) {
    new Uint8Array(buffer).set(part, at);
    at += part.length;
  }
  return buffer;
}
