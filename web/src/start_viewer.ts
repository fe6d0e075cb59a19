/** Starts the viewer on the page, or says on the page why it cannot. */
import "./style.css";
import "./hand.css";
import "./lists.css";
import "./task.css";
import "./layout.css";
import type { Carrier } from "./connection";
import { viewerHook } from "./hook";
import { text, translatePage } from "./language";
import { findPage } from "./page";
import { Viewer } from "./viewer";
import { reasonOf } from "./reason";

/** What is said in the page. */
export interface Says {
  /** Why nothing can be shown, or the simulation ended. */
  failed(words: string): void;
  /** What is good to know. */
  notice(words: string): void;
}

/** `carrierOf` may throw, as anything here: what it says stands in the page then. */
export function startViewer(carrierOf: (says: Says) => Carrier): void {
  translatePage();
  try {
    const notice = (words: string): void => viewer.parts().messages.notice(words);
    const viewer: Viewer = new Viewer(findPage(), carrierOf({ failed: say, notice }));
    Object.defineProperty(window, "glisson", { value: viewerHook(() => viewer.parts()) });
  } catch (error) {
    console.error(error);
    say(text("cannot_start", { reason: reasonOf(error) }));
  }
}

function say(words: string): void {
  const banner = document.getElementById("banner");
  if (banner === null) return;
  banner.hidden = false;
  banner.textContent = words;
}
