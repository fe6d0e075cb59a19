/** The scene in a headset, where the browser has one (WebXR): at its true size, half a metre before the eyes, as the view from outside looks at it. */
import { Group, Matrix4, PerspectiveCamera, Vector3 } from "three";
import { text } from "../language";
import { viewAxes } from "../orbit";
import type { Messages } from "../overlays";
import type { Scene3d } from "../scene3d";

/** From the eyes to the scene's middle [m]. */
const AWAY_M = 0.5;

export interface HeadsetEvents {
  /** The headset wants a picture. */
  frame(now_ms: number): void;
  /** There is one. */
  found(): void;
}

export class Headset {
  private readonly rig = new Group();
  private readonly camera = new PerspectiveCamera(70, 1, 0.01, 10);

  constructor(
    private readonly scene: Scene3d,
    private readonly messages: Pick<Messages, "notice">,
    private readonly events: HeadsetEvents,
  ) {
    this.rig.add(this.camera);
    void navigator.xr?.isSessionSupported("immersive-vr").then((is) => is && events.found(), () => undefined);
  }

  /** Shows the scene in the headset until it is taken off. */
  async enter(): Promise<void> {
    const { renderer } = this.scene;
    try {
      if (navigator.xr === undefined) throw new Error(text("no_headset_here"));
      const session = await navigator.xr.requestSession("immersive-vr");
      const { target_m } = this.scene.orbit;
      const { right, up, forward } = viewAxes(this.scene.orbit);
      this.rig.matrix.copy(new Matrix4().makeBasis(right, up, forward.clone().negate()).setPosition(new Vector3().copy(target_m).addScaledVector(forward, -AWAY_M)));
      this.rig.matrix.decompose(this.rig.position, this.rig.quaternion, this.rig.scale);
      this.rig.updateMatrixWorld();
      session.addEventListener("end", () => {
        renderer.setAnimationLoop(null);
        renderer.xr.enabled = false;
        this.scene.inHeadset = null;
      });
      renderer.xr.enabled = true;
      renderer.xr.setReferenceSpaceType("local");
      await renderer.xr.setSession(session);
      this.scene.inHeadset = this.camera;
      renderer.setAnimationLoop((now_ms) => this.events.frame(now_ms));
    } catch (error) {
      renderer.xr.enabled = false;
      this.messages.notice(text("no_headset", { why: error instanceof Error ? error.message : String(error) }));
    }
  }
}
