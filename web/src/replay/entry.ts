/** Parts of the lists at the right: elements, and a button that jumps to a time. */

/** What is of the one and of the other of two recordings. */
export const COLOURS = ["#ffb45e", "#58d0ff"] as const;
export const LETTERS = ["A", "B"] as const;

export function element(name: string, className: string, words = ""): HTMLElement {
  const node = document.createElement(name);
  node.className = className;
  node.textContent = words;
  return node;
}

export function entryButton(time: string, title: string, jump: () => void, detail = ""): HTMLButtonElement {
  const button = document.createElement("button");
  button.type = "button";
  const words = element("span", "story-words", title);
  if (detail !== "") words.append(element("span", "story-detail", detail));
  button.append(element("span", "story-time", time), words);
  button.addEventListener("click", (event) => {
    jump();
    // After a mouse click the space bar should play, not press this button.
    if (event.detail > 0) button.blur();
  });
  return button;
}
