/**
 * What stands in the light of an endoscope's lamp: the depth of organs and instruments as the lamp sees them, which the shaders
 * compare with (L. Williams, "Casting curved shadows on curved surfaces", SIGGRAPH 1978, doi 10.1145/800248.807402). The lamp is
 * beside the lens, so that shadows are narrow, as they are in an abdomen. In full detail alone.
 */
import { DepthTexture, Matrix4, MeshBasicMaterial, PerspectiveCamera, UnsignedIntType, WebGLRenderTarget, type Object3D } from "three";
import type { Scene3d } from "../scene3d";
import { LAMP_AT_M, shadows } from "./lamp";

const SIDE = 1024;
const NEAR_M = 0.002;
const FAR_M = 0.6;

export class LampShadow {
  private readonly target = new WebGLRenderTarget(SIDE, SIDE, { depthTexture: new DepthTexture(SIDE, SIDE, UnsignedIntType) });
  private readonly camera = new PerspectiveCamera(90, 1, NEAR_M, FAR_M);
  private readonly depthOnly = new MeshBasicMaterial({ colorWrite: false });

  constructor() {
    shadows.range.value.set(NEAR_M, FAR_M);
  }

  /** Takes the picture of depth for an eye that looks as `eye` does; `others` cast no shadows. */
  draw({ renderer, scene, inside }: Pick<Scene3d, "renderer" | "scene" | "inside">, eye: PerspectiveCamera, others: readonly Object3D[]): void {
    const { camera, target } = this;
    camera.position.copy(eye.position).add(LAMP_AT_M.clone().applyQuaternion(eye.quaternion));
    camera.quaternion.copy(eye.quaternion);
    // The lamp sees somewhat more than the lens, beside which it is.
    camera.fov = Math.min(eye.fov + 12, 140);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    shadows.fromView.value.copy(camera.projectionMatrix).multiply(new Matrix4().makeTranslation(LAMP_AT_M.clone().negate()));
    const shown = others.filter(({ visible }) => visible);
    for (const other of shown) other.visible = false;
    this.depthOnly.clippingPlanes = inside.planes;
    scene.overrideMaterial = this.depthOnly;
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(scene, camera);
    scene.overrideMaterial = null;
    for (const other of shown) other.visible = true;
    shadows.depth.value = target.depthTexture;
  }

  dispose(): void {
    this.target.dispose();
    this.depthOnly.dispose();
  }
}
