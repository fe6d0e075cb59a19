/** Starts the viewer on the page, or says on the page why it cannot. */
import "./hook";
import "./style.css";
import { Viewer, type Page } from "./viewer";

function part<T extends HTMLElement>(id: string): T {
  const node = document.getElementById(id);
  if (node === null) throw new Error(`index.html has no element "${id}"`);
  return node as T;
}

try {
  const page: Page = {
    scene: part("scene"),
    orientation: part("orientation"),
    panel: part("panel"),
    link: part("link"),
    banner: part("banner"),
    messages: part("messages"),
    profiler: part("profiler"),
    toolbar: part("toolbar"),
    hint: part("hint"),
  };
  const viewer = new Viewer(page);
  Object.defineProperty(window, "glisson", { value: viewer.hook(), writable: false, configurable: false });
} catch (error) {
  console.error(error);
  const reason = error instanceof Error ? error.message : String(error);
  const banner = document.getElementById("banner");
  if (banner !== null) {
    banner.hidden = false;
    banner.textContent = `The viewer cannot start: ${reason} (it needs a browser with WebGL 2; a GPU is not needed).`;
  }
}
