import { describe, expect, it, vi } from "vitest";
import type { Files } from "../src/local/calling";
import { WorkerDesk } from "../src/local/patient_desk";
import type { FromPatientWorker, PatientAsk } from "../src/local/patient_worker";
import { withStep } from "../src/local/steps_done";
import type { Step } from "../src/patient/state";

/** A Worker that remembers steps: "slow" ones are not done until they are let go, "fragile" ones break every Worker but the first. */
class FakeWorker {
  onmessage: ((event: { data: FromPatientWorker }) => void) | null = null;
  onerror: unknown = null;
  onmessageerror: unknown = null;
  readonly asked: PatientAsk[] = [];
  readonly folders = new Set<string>();
  isOver = false;
  private changes = 0;
  private held: (() => void) | null = null;

  /** What came while a step went on. */
  private readonly backlog: PatientAsk[] = [];

  constructor(private readonly series: readonly string[], private readonly isFirst: boolean) {}

  private answer(data: FromPatientWorker): void {
    queueMicrotask(() => {
      if (!this.isOver) this.onmessage?.({ data });
    });
  }

  postMessage(asked: PatientAsk): void {
    if (this.held !== null) {
      this.backlog.push(asked);
      return;
    }
    this.asked.push(asked);
    if (asked.ask === "files") for (const path of asked.files.keys()) this.folders.add(path.split("/")[0]!);
    if (asked.ask === "forget") this.folders.delete(asked.folder);
    if (asked.ask === "state") this.answer({ answer: JSON.stringify({ version: this.changes, image_number: 1, series: this.series }) });
    else if (asked.ask === "picture") this.answer({ answer: new Uint8Array([1]) });
    else if (asked.ask === "write") this.answer({ answer: new Map([["scene.toml", new Uint8Array()]]) });
    else if (asked.ask !== "step") this.answer({ answer: null });
    else if (asked.choice.includes("bad")) this.answer({ error: "it is bad", broke: false });
    else if (asked.choice.includes("broken") || (asked.choice.includes("fragile") && !this.isFirst)) this.answer({ error: "no memory", broke: true });
    else {
      this.answer({ what: asked.name });
      const done = (): void => {
        this.changes += 1;
        this.answer({ answer: null });
      };
      if (asked.choice.includes("slow")) this.held = done;
      else done();
    }
  }

  letGo(): void {
    const { held } = this;
    this.held = null;
    held?.();
    for (const asked of this.backlog.splice(0)) this.postMessage(asked);
  }

  terminate(): void {
    this.isOver = true;
  }

  get steps(): string[] {
    return this.asked.flatMap((asked) => (asked.ask === "step" ? [`${asked.name} ${asked.choice}`] : []));
  }
}

function deskWith(simulatorWith: (files: Files) => Promise<string> = async () => "page", series: readonly string[] = []) {
  const workers: FakeWorker[] = [];
  const newWorker = (): Worker => {
    workers.push(new FakeWorker(series, workers.length === 0));
    return workers.at(-1) as unknown as Worker;
  };
  const desk = new WorkerDesk(newWorker, Promise.resolve({} as WebAssembly.Module), simulatorWith);
  const settled = () => vi.waitFor(async () => expect((await desk.state()).job).toBeNull());
  const done = async (step: Step, choice: object) => {
    await desk.post(step, choice);
    await settled();
    return desk.state();
  };
  const opened = async (name = "a.dcm") => done("open", await desk.send([new File(["x"], name)], () => {}));
  return { desk, workers, settled, done, opened };
}

describe("the steps of the page's own Worker", () => {
  it("reads files, forgets them, and tells what is wrong", async () => {
    const { desk, workers, done, opened } = deskWith();
    const state = await opened();
    expect([state.error, state.image_number, state.version]).toEqual([null, 1, 1]);
    expect(workers[0]!.folders.size).toBe(0);
    expect((await done("organ", { name: "bad" })).error).toBe("it is bad");
    expect((await done("organ", { name: "liver" })).error).toBeNull();
    expect((await desk.state()).version).toBe(2);
  });

  it("keeps files of which another series may be chosen, until another image is read", async () => {
    const { workers, done, opened } = deskWith(undefined, ["one", "two"]);
    await opened();
    await done("open", { series: 2 });
    expect(workers[0]!.steps.at(-1)).toBe('open {"folder":"/incoming-1","series":2}');
    expect([...workers[0]!.folders]).toEqual(["incoming-1"]);
    await opened("b.dcm");
    expect([...workers[0]!.folders]).toEqual(["incoming-2"]);
  });

  it("never reads files whose reading was refused in the place of others", async () => {
    const { desk, workers, done, settled, opened } = deskWith(undefined, ["one", "two"]);
    await opened();
    await desk.post("organ", { name: "slow" });
    const refused = await desk.send([new File(["y"], "b.dcm")], () => {});
    await expect(desk.post("open", refused)).rejects.toThrow();
    workers[0]!.letGo();
    await settled();
    await done("open", { series: 2 });
    expect(workers[0]!.steps.at(-1)).toContain("incoming-1");
  });

  it("cancels: another Worker does again what was done, and nothing that was asked is left waiting", async () => {
    const { desk, workers, settled, done, opened } = deskWith();
    await opened();
    await opened("b.dcm");
    await done("organ", { name: "liver", n: 1 });
    const before = await desk.state();
    await desk.post("mesh", { tetrahedra: "slow" });
    await vi.waitFor(async () => expect((await desk.state()).job?.what).toBe("mesh"));
    const picture = desk.picture("slice/axial");
    await new Promise((resolve) => setTimeout(resolve));
    await desk.post("cancel", {});
    expect((await desk.state()).job?.is_cancelled).toBe(true);
    await expect(picture).rejects.toThrow();
    const later = desk.picture("slice/axial");
    await settled();
    expect(await later).toMatch(/^blob:/);
    const after = await desk.state();
    expect(workers).toHaveLength(2);
    expect(workers[0]!.isOver).toBe(true);
    expect(workers[1]!.steps).toEqual(['open {"folder":"/incoming-2"}', 'organ {"name":"liver","n":1}']);
    // The same image, and pictures of the new Worker's.
    expect([after.error, after.image_number, after.version > before.version]).toEqual([null, before.image_number, true]);
  });

  it("gives no file of a cancelled image to the next Worker", async () => {
    const { desk, workers, settled } = deskWith();
    let arrive = (): void => {};
    const slow = { name: "slow.dcm", arrayBuffer: () => new Promise<ArrayBuffer>((resolve) => (arrive = () => resolve(new ArrayBuffer(1)))) };
    await desk.post("open", await desk.send([slow as File], () => {}));
    await vi.waitFor(async () => expect((await desk.state()).job?.what).toContain("1"));
    await desk.post("cancel", {});
    arrive();
    await settled();
    expect(workers[1]!.asked.map(({ ask }) => ask)).not.toContain("files");
    expect([(await desk.state()).error, desk.hasImage]).toEqual([null, false]);
  });

  it("goes on after a step that breaks the Worker, and says what broke it", async () => {
    const { workers, done, opened } = deskWith();
    await opened();
    const state = await done("mesh", { tetrahedra: "broken" });
    expect([state.error, workers.length, workers[1]!.steps.length]).toEqual(["no memory", 2, 1]);
    expect((await done("organ", { name: "liver" })).error).toBeNull();
  });

  it("does not for ever do again what breaks every Worker", async () => {
    const { desk, workers, done, opened } = deskWith();
    await opened();
    expect((await done("organ", { name: "fragile" })).error).toBeNull();
    const state = await done("mesh", { tetrahedra: "broken" });
    expect([state.error, desk.hasImage, workers.length]).toEqual(["no memory", false, 3]);
  });

  it("says why the program does not begin", async () => {
    const desk = new WorkerDesk(() => new FakeWorker([], true) as unknown as Worker, Promise.reject(new Error("no SIMD")), async () => "");
    const reason = await desk.state().catch((error: unknown) => desk.silence(error));
    expect(reason).toBe("no SIMD");
  });

  it("goes back to the page where the simulation cannot be made", async () => {
    const { desk, done } = deskWith(async () => Promise.reject(new Error("too large")));
    expect((await done("start", {})).started).toBe(true);
    await expect(desk.post("mesh", {})).rejects.toThrow();
    await desk.goOn();
    expect([(await desk.state()).started, (await desk.state()).error]).toEqual([false, "too large"]);
  });
});

describe("steps that were done", () => {
  const names = (steps: readonly [Step, object][]) => steps.reduce((done, [name, choice]) => withStep(done, { name, choice }), [] as ReturnType<typeof withStep>).map(({ name, choice }) => `${name} ${Object.values(choice).join(" ")}`);

  it("are without those that later ones made needless", () => {
    const liver = (n: number): [Step, object] => ["organ", { name: "liver", n }];
    const tumour: [Step, object] = ["organ", { name: "tumour" }];
    const mesh = (n: number): [Step, object] => ["mesh", { n }];
    expect(names([["open", { a: 1 }], liver(1), mesh(1), ["open", { a: 2 }]])).toEqual(["open 2"]);
    expect(names([["open", {}], liver(1), tumour, liver(2), mesh(1), mesh(2)])).toEqual(["open ", "organ liver 2", "organ tumour", "mesh 2"]);
    expect(names([["open", {}], liver(1), tumour, ["remove", { name: "liver" }], liver(2)])).toEqual(["open ", "organ liver 1", "organ tumour", "remove liver", "organ liver 2"]);
    expect(names([["open", {}], ["values", {}], mesh(1), liver(1)])).toEqual(["open ", "values ", "organ liver 1"]);
  });
});
