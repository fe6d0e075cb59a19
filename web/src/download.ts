/** How long the browser has to begin saving [ms]: it may ask where to. */
const KEPT_MS = 60_000;

/** Offers `content` as a file to save. */
export function download(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), KEPT_MS);
}
