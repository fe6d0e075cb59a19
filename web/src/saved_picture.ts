/** A picture of what the canvas shows, to be saved. */

/** Behind the organ: the page's background. */
const BACKGROUND = { centre: "#1d2832", edge: "#080b0f" };

/** As PNG: background, the canvas that is `width` CSS pixels wide on the page, and `overlay` in its lower right corner. */
export async function savedPicture(canvas: HTMLCanvasElement, canvasWidth: number, overlay: HTMLCanvasElement): Promise<Blob> {
  const copy = document.createElement("canvas");
  copy.width = canvas.width;
  copy.height = canvas.height;
  const context = copy.getContext("2d");
  if (context === null) throw new Error("the browser gives no canvas to draw the picture on");
  const { width, height } = copy;
  const back = context.createRadialGradient(width / 2, 0.45 * height, 0, width / 2, 0.45 * height, 0.75 * width);
  back.addColorStop(0, BACKGROUND.centre);
  back.addColorStop(1, BACKGROUND.edge);
  context.fillStyle = back;
  context.fillRect(0, 0, width, height);
  context.drawImage(canvas, 0, 0);
  const scale = width / canvasWidth;
  const [w, h] = [overlay.clientWidth * scale, overlay.clientHeight * scale];
  context.drawImage(overlay, width - w, height - h, w, h);
  return new Promise((resolve, reject) =>
    copy.toBlob((blob) => (blob === null ? reject(new Error("the picture could not be written")) : resolve(blob)), "image/png"),
  );
}
