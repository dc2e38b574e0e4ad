// The server's picture of the first view, over the canvas until the viewer's own picture is whole: a better picture is not
// replaced by a worse one.
//
// SPDX-License-Identifier: Apache-2.0
import { parsePose, type Pose } from "./pose";
import { posterSize } from "./postersize";
import { pictureUrl, type SceneEntry } from "./source";

const LEAVES_MS = 250;

// Null where nobody draws it.
export function posterUrl(entry: SceneEntry, appearance: string, pose: Pose, aspect: number): string | null {
  const [width, height] = posterSize(aspect).split("x").map(Number);
  return entry.preview && pictureUrl(entry, appearance, pose, width!, height!, true).href;
}

// What a picture of the server shows, by its address; null where that does not tell.
export function poseOfPoster(url: string): Pose | null {
  const pose = /\/static\/([^/]+)\/\d+x\d+\.jpg/.exec(url)?.[1];
  return pose === undefined ? null : parsePose(pose);
}

// On a canvas: a page's policy need not allow images.
export class Poster {
  private canvas: HTMLCanvasElement | null = document.createElement("canvas");
  private readonly asking = new AbortController();
  private timer = 0;
  onGone: (shown: boolean) => void = () => {};

  constructor(surface: HTMLElement, url: string) {
    const canvas = this.canvas!;
    canvas.className = "citysplat-poster";
    canvas.hidden = true;
    Object.assign(canvas.style, { position: "absolute", inset: "0", width: "100%", height: "100%", objectFit: "cover", pointerEvents: "none", transition: `opacity ${LEAVES_MS}ms` });
    surface.insertBefore(canvas, surface.querySelector(".citysplat-credit"));
    // The server may be busy, or draw nothing.
    this.show(canvas, url).catch(() => this.leave(true));
  }

  private async show(canvas: HTMLCanvasElement, url: string) {
    const answer = await fetch(url, { signal: this.asking.signal });
    if (!answer.ok) return this.leave(true);
    const image = await createImageBitmap(await answer.blob());
    [canvas.width, canvas.height] = [image.width, image.height];
    canvas.getContext("2d")!.drawImage(image, 0, 0);
    canvas.hidden = false;
    image.close();
  }

  // It is to be seen, or may come.
  get there(): boolean {
    return this.canvas !== null;
  }

  // Gives way to the picture below it.
  leave(atOnce: boolean) {
    if (!this.canvas || (this.timer && !atOnce)) return;
    this.asking.abort();
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (atOnce || calm || this.canvas.hidden) return this.end();
    this.canvas.style.opacity = "0";
    this.timer = window.setTimeout(() => this.end(), LEAVES_MS);
  }

  private end() {
    const shown = this.canvas?.hidden === false;
    clearTimeout(this.timer);
    this.canvas?.remove();
    this.canvas = null;
    this.onGone(shown);
  }
}
