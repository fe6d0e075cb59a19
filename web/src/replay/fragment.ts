/** The time that the page's address asks for: `session.html#t=12.3`, in seconds as the page's clock shows them. */

/** The time in a fragment, with or without its `#`; null where it asks for none, or for what is no time. */
export function timeInFragment(fragment: string): number | null {
  const value = new URLSearchParams(fragment.replace(/^#/, "")).get("t");
  // Only digits: Number() also takes "", "0x10" and "Infinity".
  return value !== null && /^\d+(\.\d+)?$/.test(value) ? Number(value) : null;
}
