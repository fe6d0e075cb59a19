/** Starts the viewer on the page, or says on the page why it cannot. */
import "./style.css";
import "./hand.css";
import "./lists.css";
import "./task.css";
import "./layout.css";
import { viewerHook } from "./hook";
import { text, translatePage } from "./language";
import { findPage } from "./page";
import { Viewer } from "./viewer";

translatePage();
try {
  const viewer = new Viewer(findPage());
  Object.defineProperty(window, "glisson", { value: viewerHook(() => viewer.parts()) });
} catch (error) {
  console.error(error);
  const reason = error instanceof Error ? error.message : String(error);
  const banner = document.getElementById("banner");
  if (banner !== null) {
    banner.hidden = false;
    banner.textContent = text("cannot_start", { reason });
  }
}
