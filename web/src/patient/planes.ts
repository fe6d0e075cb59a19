/** Geometry of the three planes: which patient position a place in a picture is. */
import type { PlaneName, Point } from "./state";

interface Axis {
  /** Of the patient frame, LPS. */
  readonly axis: 0 | 1 | 2;
  /** Whether it grows to the right, or down. */
  readonly grows: boolean;
}

/** To the right and down in the picture, as in picture/slice.rs. */
export const AXES: Readonly<Record<PlaneName, readonly [Axis, Axis]>> = {
  axial: [
    { axis: 0, grows: true },
    { axis: 1, grows: true },
  ],
  coronal: [
    { axis: 0, grows: true },
    { axis: 2, grows: false },
  ],
  sagittal: [
    { axis: 1, grows: true },
    { axis: 2, grows: false },
  ],
};

/** The axis along which the plane moves. */
export function normalAxis(plane: PlaneName): 0 | 1 | 2 {
  return plane === "axial" ? 2 : plane === "coronal" ? 1 : 0;
}

export interface Box {
  readonly from_mm: Point;
  readonly to_mm: Point;
}

function withAxis(point: Point, axis: number, value: number): Point {
  return point.map((x, i) => (i === axis ? value : x)) as unknown as Point;
}

/** `point` kept in the box. */
export function clamped(box: Box, point: Point): Point {
  return point.map((x, i) => Math.min(Math.max(x, box.from_mm[i]!), box.to_mm[i]!)) as unknown as Point;
}

/** Where a point is in the picture of a plane: shares of its width and height. */
export function shareOf(plane: PlaneName, box: Box, point: Point): [number, number] {
  const share = ({ axis, grows }: Axis): number => {
    const size = box.to_mm[axis]! - box.from_mm[axis]!;
    const along = size > 0 ? (point[axis]! - box.from_mm[axis]!) / size : 0.5;
    return grows ? along : 1 - along;
  };
  return [share(AXES[plane][0]), share(AXES[plane][1])];
}

/** The point at shares of the picture's width and height, at the depth of `cross`. */
export function pointAt(plane: PlaneName, box: Box, cross: Point, shares: readonly [number, number]): Point {
  let point = cross;
  for (const [i, { axis, grows }] of AXES[plane].entries()) {
    const along = grows ? shares[i]! : 1 - shares[i]!;
    point = withAxis(point, axis, box.from_mm[axis]! + along * (box.to_mm[axis]! - box.from_mm[axis]!));
  }
  return clamped(box, point);
}

/** `cross` moved by voxels to the right, down, and along the normal; `steps_mm` are their sizes along the patient's axes. */
export function moved(plane: PlaneName, box: Box, cross: Point, steps_mm: Point, by: readonly [number, number, number]): Point {
  const [right, down] = AXES[plane];
  const along: readonly Axis[] = [right, down, { axis: normalAxis(plane), grows: true }];
  let point = cross;
  for (const [i, { axis, grows }] of along.entries()) {
    point = withAxis(point, axis, point[axis]! + (grows ? by[i]! : -by[i]!) * steps_mm[axis]!);
  }
  return clamped(box, point);
}

/** Width over height of a plane's picture. */
export function aspect(plane: PlaneName, box: Box): number {
  const [right, down] = AXES[plane];
  const size = ({ axis }: Axis): number => Math.max(box.to_mm[axis]! - box.from_mm[axis]!, 1e-3);
  return size(right) / size(down);
}

/** The middle of the image, in the middle of a voxel: there the cross is in one slice alone. */
export function middleVoxel(box: Box, steps_mm: Point): Point {
  return box.from_mm.map((from, axis) => {
    const last = Math.round((box.to_mm[axis]! - from) / steps_mm[axis]!);
    return from + Math.round(0.5 * last) * steps_mm[axis]!;
  }) as unknown as Point;
}

/** Whether two points are in one slice of the image, where its slices are parallel to the plane. */
export function isOneSlice(plane: PlaneName, image: { readonly box: Box; readonly steps_mm: Point; readonly at_mm: Point }, other_mm: Point): boolean {
  const axis = normalAxis(plane);
  // The box goes from the middles of the first voxels to those of the last.
  const sliceOf = (point: Point): number => Math.round((point[axis]! - image.box.from_mm[axis]!) / image.steps_mm[axis]!);
  return sliceOf(image.at_mm) === sliceOf(other_mm);
}
