/** Small help with the page's elements. */

export function part<T extends HTMLElement>(id: string): T {
  const node = document.getElementById(id);
  if (node === null) throw new Error(`patient.html has no element "${id}"`);
  return node as T;
}

/** An item of a list with words and buttons. */
export function item(words: string, buttons: readonly { readonly text: string; readonly name: string; readonly press: () => void }[]): HTMLLIElement {
  const node = document.createElement("li");
  node.append(words, " ");
  for (const { text, name, press } of buttons) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = text;
    button.setAttribute("aria-label", name);
    button.addEventListener("click", press);
    node.append(button);
  }
  return node;
}

/** Terms and what they are. */
export function facts(list: HTMLElement, rows: readonly (readonly [string, string])[]): void {
  list.replaceChildren(
    ...rows.flatMap(([name, value]) => {
      const [term, text] = [document.createElement("dt"), document.createElement("dd")];
      [term.textContent, text.textContent] = [name, value];
      return [term, text];
    }),
  );
}

/** Fills a list to choose from, unless it is full. */
export function options(select: HTMLSelectElement, list: readonly { readonly value: string; readonly text: string }[], chosen?: string): void {
  if (select.options.length === list.length) return;
  select.replaceChildren(...list.map(({ value, text }) => new Option(text, value, false, value === chosen)));
}

export function named(names: readonly string[]): { value: string; text: string }[] {
  return names.map((name) => ({ value: name, text: name }));
}
