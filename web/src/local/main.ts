/** The viewer of a simulation that the page has in itself: one file, opened from disk. */
import { text } from "../language";
import { startViewer } from "../start_viewer";
import "./local.css";
import { WorkerCarrier } from "./carrier";
import { Kept } from "./kept";
import { programInPage, sceneInPage } from "./parts";
import { SessionList } from "./session_list";
import type { Start } from "./worker";
import Beside from "./worker?worker&inline";

/** A page with this behind its address shows what instruments do by themselves, where its scene says that. */
const DEMONSTRATE = "#demonstrate";

async function begin(): Promise<Start> {
  const [module, { scene, files }] = await Promise.all([programInPage(), sceneInPage()]);
  return { module, files, scene, demonstrates: window.location.hash === DEMONSTRATE, hidden: document.hidden };
}

const kept = await Kept.open().catch(() => null);
startViewer(({ failed, notice }) => {
  const carrier: WorkerCarrier = new WorkerCarrier(new Beside(), begin, {
    failed: (reason) => failed(text("local_ended", { reason })),
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
