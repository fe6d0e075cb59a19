/** Whether the parts over the picture leave each other and the page's edges free. */
import type { Page } from "playwright-core";

/** A telephone, a small tablet, a laptop [CSS pixels]. */
export const SIZES = [
  { width: 420, height: 800 },
  { width: 800, height: 600 },
  { width: 1280, height: 800 },
] as const;

const PARTS = [
  "#panel", "#task", "#contacts", "#messages .message", "#bodies", "#turning", "#inside", "#profiler", "#outside", "#orientation", "#hint", "#banner", "#toolbar .button-group",
];

/** What is wrong with the layout, in words: parts that lie over each other, that reach out of the page, or whose words are cut off. */
export async function faultsOfLayout(page: Page): Promise<string[]> {
  return page.evaluate((parts) => {
    /** The box of a part as far as it is seen: what a scrolling part around it hides does not count. */
    const seen = (node: HTMLElement): DOMRect => {
      let { left, top, right, bottom } = node.getBoundingClientRect();
      for (let outer = node.parentElement; outer !== null && outer !== document.body; outer = outer.parentElement) {
        if (getComputedStyle(outer).overflowY === "visible") continue;
        const around = outer.getBoundingClientRect();
        [left, top, right, bottom] = [Math.max(left, around.left), Math.max(top, around.top), Math.min(right, around.right), Math.min(bottom, around.bottom)];
      }
      return new DOMRect(left, top, Math.max(0, right - left), Math.max(0, bottom - top));
    };
    const shown = parts.flatMap((part) => [...document.querySelectorAll<HTMLElement>(part)].map((node, i) => ({ part: `${part} ${i + 1}`, node })));
    const boxes = shown
      .map(({ part, node }) => ({ part, node, box: seen(node) }))
      .filter(({ node, box }) => node.checkVisibility() && box.width > 0 && box.height > 0);
    const faults: string[] = [];
    const text = ({ left, top, right, bottom }: DOMRect): string => [left, top, right, bottom].map((x) => x.toFixed(0)).join(" ");
    boxes.forEach(({ part, node, box }, i) => {
      // Half a pixel is rounding.
      const isOut = box.left < -0.5 || box.top < -0.5 || box.right > innerWidth + 0.5 || box.bottom > innerHeight + 0.5;
      // Of what scrolls enough has to be seen.
      if ((part.startsWith("#panel") || part.startsWith("#task")) && box.height < 60) faults.push(`${part} is hardly seen: ${text(box)}`);
      if (isOut) faults.push(`${part} reaches out of the page: ${text(box)}`);
      // What scrolls may be longer than it is high.
      if (node.scrollWidth > node.clientWidth + 1 && getComputedStyle(node).overflowX !== "auto") faults.push(`${part} is cut off: ${node.scrollWidth} of ${node.clientWidth}`);
      for (const other of boxes.slice(i + 1)) {
        const [width, height] = [
          Math.min(box.right, other.box.right) - Math.max(box.left, other.box.left),
          Math.min(box.bottom, other.box.bottom) - Math.max(box.top, other.box.top),
        ];
        if (width > 0.5 && height > 0.5) faults.push(`${part} and ${other.part} lie over each other: ${text(box)} and ${text(other.box)}`);
      }
    });
    for (const button of document.querySelectorAll<HTMLElement>("#toolbar button")) {
      if (button.checkVisibility() && button.scrollWidth > button.clientWidth + 1) faults.push(`the button "${button.textContent}" is cut off`);
    }
    return faults;
  }, PARTS);
}
