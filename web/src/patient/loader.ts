/** A picture of the server's: of several that are asked for in a row the last one comes. */
export class Loader {
  readonly picture = new Image();
  /** What is to be shown once the picture under way is there. */
  private next: string | null = null;
  private isLoading = false;

  constructor(alt: string) {
    this.picture.alt = alt;
    this.picture.draggable = false;
    const done = (): void => {
      this.isLoading = false;
      if (this.next !== null) this.load(this.next);
    };
    this.picture.addEventListener("load", done);
    this.picture.addEventListener("error", () => {
      // Not the picture before in the place of this one.
      this.picture.removeAttribute("src");
      done();
    });
  }

  load(address: string): void {
    if (this.isLoading) {
      this.next = address;
      return;
    }
    this.next = null;
    if (this.picture.src.endsWith(address)) return;
    this.isLoading = true;
    this.picture.src = address;
  }
}
