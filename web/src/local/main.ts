/** The viewer of a simulation that the page has in itself: one file, opened from disk. */
import { text } from "../language";
import { startViewer } from "../start_viewer";
import "./local.css";
import { WorkerCarrier } from "./carrier";
import { Kept } from "./kept";
import { compiled, programLetters, sceneInPage, stepInPage } from "./parts";
import { SessionList } from "./session_list";
import type { Start } from "./worker";
import Beside from "./worker?worker&inline";

/** A page with this behind its address shows what instruments do by themselves, where its scene says that. */
const DEMONSTRATE = "#demonstrate";

async function begin(): Promise<Start> {
  const step = stepInPage();
  const [module, { scene, files }] = await Promise.all([compiled(programLetters()), sceneInPage()]);
  const begins = step === null ? { scene, demonstrates: window.location.hash === DEMONSTRATE } : { session: scene, step };
  return { module, files, begins, hidden: document.hidden };
}

const kept = await Kept.open().catch(() => null);
startViewer(({ failed, notice }) => {
  const carrier: WorkerCarrier = new WorkerCarrier(new Beside(), begin, {
    failed: (reason) => failed(text("local_ended", { reason })),
    making: (share) => {
      document.getElementById("link")!.textContent = text("local_made", { percent: (100 * share).toFixed(0) });
    },
    opened: () => sessions.opened(),
    recorded: (session, from) => sessions.recorded(session, from),
  });
  const sessions = new SessionList(document.querySelector(".upper-right")!, kept, {
    keep: () => carrier.keep(),
    name: () => window.glisson?.hello?.scene.name ?? "Glisson",
    notice,
  });
  document.addEventListener("visibilitychange", () => {
    carrier.hide(document.hidden);
    if (!document.hidden) notice(text("local_hidden"));
  });
  return carrier;
});
