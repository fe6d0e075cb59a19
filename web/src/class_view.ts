/** Joins who watches together, what is drawn, and the pointer that draws. */
import { Classroom, type ClassNews, type MarksNews } from "./classroom";
import { Drawing } from "./drawing";
import type { Action } from "./keys";
import type { Page } from "./page";
import type { ClientMessage } from "./protocol";
import type { Scene3d } from "./scene3d";

export class ClassView {
  readonly room: Classroom;
  private readonly drawing: Drawing;

  constructor(
    page: Page,
    private readonly scene: Scene3d,
    send: (message: ClientMessage) => void,
    private readonly redraw: () => void,
  ) {
    this.drawing = new Drawing(scene, send);
    this.room = new Classroom(page.classroom, { send, draws: (on) => this.drawing.turn(on) });
  }

  /** What the connection tells. */
  readonly events = {
    classroom: (news: ClassNews): void => {
      this.room.show(news);
      if (this.scene.classMarks.showPointers(this.room.pointing)) this.redraw();
    },
    marks: ({ marks }: MarksNews): void => {
      this.scene.classMarks.showMarks(marks);
      this.redraw();
    },
  };

  /** Does what a key asks for, where it is of the class. */
  run(action: Action, tool: number): void {
    if (action === "take_over") this.room.take();
    else if (action === "draw") this.room.draw();
    else if (action === "erase") this.room.erase();
    else if (action === "mark_tip" && this.room.teaches) {
      const tip_m = this.scene.pose(tool)?.tip_m;
      if (tip_m !== undefined) this.drawing.markTip([tip_m.x, tip_m.y, tip_m.z]);
    }
  }
}
