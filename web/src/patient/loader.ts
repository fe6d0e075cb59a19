/** A picture that is drawn elsewhere: of several that are asked for in a row the last one comes. */
export class Loader {
  readonly picture = new Image();
  /** What is shown, or under way. */
  private name = "";
  /** What is to be shown once the picture under way is there. */
  private next: string | null = null;
  private isLoading = false;

  /** `addressOf`: where the picture of a name is found. */
  constructor(private readonly addressOf: (name: string) => Promise<string>) {
    this.picture.alt = "";
    this.picture.draggable = false;
    this.picture.addEventListener("load", () => this.done());
    this.picture.addEventListener("error", () => this.none());
  }

  private done(): void {
    this.isLoading = false;
    if (this.next !== null) this.load(this.next);
  }

  /** Not the picture before in the place of this one. */
  private none(): void {
    URL.revokeObjectURL(this.picture.src);
    this.picture.removeAttribute("src");
    this.name = "";
    this.done();
  }

  load(name: string): void {
    if (this.isLoading) {
      this.next = name;
      return;
    }
    this.next = null;
    if (this.name === name) return;
    [this.isLoading, this.name] = [true, name];
    const before = this.picture.src;
    this.addressOf(name).then(
      (address) => {
        this.picture.src = address;
        URL.revokeObjectURL(before);
      },
      () => this.none(),
    );
  }
}
