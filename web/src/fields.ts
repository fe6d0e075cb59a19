/** Fields of a JSON message, each checked: what was wrong, where, and what is allowed. */

export type Vec3 = readonly [number, number, number];

/** A message that does not follow the protocol: what was wrong, where, and what is allowed. */
export class ProtocolError extends Error {
  override readonly name = "ProtocolError";
}

export type Fields = Readonly<Record<string, unknown>>;

export function fail(message: string): never {
  throw new ProtocolError(message);
}

export function fieldsOf(value: unknown, place: string): Fields {
  if (typeof value !== "object" || value === null || Array.isArray(value)) fail(`${place} must be an object`);
  return value as Fields;
}

export function numberAt(fields: Fields, name: string, place: string, min = -Infinity): number {
  const value = fields[name];
  if (typeof value !== "number" || !Number.isFinite(value)) fail(`${place}.${name} must be a finite number`);
  if (value < min) fail(`${place}.${name} is ${value}; it must be at least ${min}`);
  return value;
}

export function stringAt(fields: Fields, name: string, place: string): string {
  const value = fields[name];
  if (typeof value !== "string") fail(`${place}.${name} must be a string`);
  return value;
}

export function vec3At(fields: Fields, name: string, place: string): Vec3 {
  const value = fields[name];
  if (!Array.isArray(value) || value.length !== 3 || !value.every((x) => typeof x === "number" && Number.isFinite(x))) {
    fail(`${place}.${name} must be three finite numbers`);
  }
  return [value[0] as number, value[1] as number, value[2] as number];
}

export function pointsAt(fields: Fields, name: string, place: string): Vec3[] {
  const value = fields[name];
  if (!Array.isArray(value)) fail(`${place}.${name} must be an array of points`);
  return value.map((point, i) => vec3At({ point: point as unknown }, "point", `${place}.${name}[${i}]`));
}

export function nodeIdsAt(fields: Fields, name: string, place: string): number[] {
  const value = fields[name];
  if (!Array.isArray(value) || !value.every((x) => Number.isInteger(x) && x >= 0)) {
    fail(`${place}.${name} must be an array of node ids (whole numbers, 0 or more)`);
  }
  return value as number[];
}

export function stringsAt(fields: Fields, name: string, place: string): string[] {
  const value = fields[name];
  if (!Array.isArray(value) || !value.every((x) => typeof x === "string")) {
    fail(`${place}.${name} must be an array of texts`);
  }
  return value as string[];
}
