/** The bodies of a scene, as the hello message tells them (docs/protocol.md). */
import { fail, fieldsOf, numberAt, stringAt, type Fields } from "./fields";

/** One of several bodies. */
export interface BodyInfo {
  readonly name: string;
  /** "#rrggbb"; null for the usual look. */
  readonly color: string | null;
  readonly is_rigid: boolean;
  readonly n_tetrahedra: number;
}

export function bodiesAt(fields: Fields): BodyInfo[] {
  const list = fields.bodies;
  if (!Array.isArray(list)) return fail("hello: bodies is not a list");
  return list.map((item, i) => {
    const body = fieldsOf(item, `bodies[${i}]`);
    const { color } = body;
    if (color !== null && (typeof color !== "string" || !/^#[0-9a-f]{6}$/.test(color))) {
      return fail(`bodies[${i}]: color is no "#rrggbb"`);
    }
    return {
      name: stringAt(body, "name", `bodies[${i}]`),
      color,
      is_rigid: body.is_rigid === true,
      n_tetrahedra: numberAt(body, "n_tetrahedra", `bodies[${i}]`, 0),
    };
  });
}
