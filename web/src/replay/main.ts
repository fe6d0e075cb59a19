/** Starts the player on the recording in its page, or says on the page why it cannot. */
import "../style.css";
import "../lists.css";
import "./replay.css";
import { text, translatePage } from "../language";
import { nameOfRecording } from "./bookmarks";
import { findReplayPage, recordingsInPage, simulatorInPage } from "./page";
import { Player, type PlayerReport } from "./player";
import { Recording } from "./recording";
import { reasonOf } from "../reason";

declare global {
  interface Window {
    /** What the page shows, for tests and for the curious; read only. */
    readonly glissonReplay?: PlayerReport;
  }
}

async function start(): Promise<void> {
  translatePage();
  const page = findReplayPage();
  const all = recordingsInPage();
  if (all.length === 0) throw new Error(text("replay_no_recording"));
  const recordings = await Promise.all(all.map((bytes) => Recording.read(bytes)));
  const player = new Player(page, recordings, all.map(nameOfRecording).join("+"), simulatorInPage());
  Object.defineProperty(window, "glissonReplay", { get: () => player.report(), configurable: true });
}

start().catch((error: unknown) => {
  console.error(error);
  const banner = document.getElementById("banner");
  if (banner === null) return;
  banner.hidden = false;
  banner.textContent = text("replay_cannot_start", { reason: reasonOf(error) });
});
