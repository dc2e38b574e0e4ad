// When a frame is worth drawing, and with how many of its pixels: only after something changed; fewer
// while the camera moves and frames take long.
//
// SPDX-License-Identifier: Apache-2.0
const AWAKE_MS = 200; // tiles are chosen for this long after the last event
const MIXING_MS = 150;
const ROUGH_FROM_MS = 80; // frames that take longer are announced by a rough one
const ROUGH_MS = 250; // and follow it when nothing changes for so long, or for half a frame
const ROUGH_MOST_MS = 700;
const SLOW_FPS = 10;
const SLOW_FRAMES = 8;
const BRISK_MS = 60; // a frame of a moving camera that takes longer is drawn with fewer pixels
const SHARPNESS_LEAST = 0.4;
const RESTS_MS = 1000; // without a frame: a picture at rest has no frames a second
const STALL_MS = 10_000; // a page that was hidden, not a slow frame

// What to do in this turn of the page's loop.
export interface Turn {
  draw: boolean;
  held: boolean; // something is to be drawn, and the card is not done with the last frame
  look: boolean; // tiles may have to be chosen
  sharpness: number; // the part of the pixels to draw, a side
  quick: boolean; // the picture changes from frame to frame
}

export class Pace {
  frameMs = 0; // that frames took lately, until the card was done
  private awakeUntil = 0;
  private stale = true; // something happened since the last turn
  private dirty = true; // and the picture is another one
  private blurred = false; // the last frame has not all of its pixels
  private roughUntil = 0; // a rough picture of the new appearance is on the screen
  private mixingUntil = 0; // the appearance is being changed: quick frames before sharp ones
  private sharpness = 1;
  private drewBefore = false;
  private lastAt = 0;
  private average = 0; // milliseconds from frame to frame
  private slow = 0;

  // Something happened; `draw`: which shows.
  wake(draw = true) {
    this.awakeUntil = performance.now() + AWAKE_MS;
    this.stale = true;
    if (draw) this.dirty = true;
  }

  get awake(): boolean {
    return performance.now() < this.awakeUntil;
  }

  // Something is still to be drawn.
  get restless(): boolean {
    return this.stale || this.dirty || this.blurred;
  }

  get framesPerSecond(): number {
    return this.average && performance.now() - this.lastAt < RESTS_MS ? 1000 / this.average : 0;
  }

  // Frames take so long that changes of light are shown roughly first.
  get takesLong(): boolean {
    return this.frameMs > ROUGH_FROM_MS;
  }

  // The appearance changes, and will perhaps change again soon.
  mix() {
    this.mixingUntil = performance.now() + MIXING_MS;
    this.wake();
  }

  // A rough picture is on the screen.
  showedRough() {
    const rest = Math.min(ROUGH_MOST_MS, Math.max(ROUGH_MS, this.frameMs / 2));
    this.roughUntil = performance.now() + rest;
    this.wake();
  }

  // Whether a rough picture stays for now.
  waits(now: number, moved: boolean): boolean {
    if (moved) this.roughUntil = 0;
    if (now >= this.roughUntil) return false;
    this.wake();
    return true;
  }

  // busy: the card is not done with the last frame, and no other is to be drawn now.
  turn(now: number, moved: boolean, busy = false): Turn {
    const quick = moved || now < this.mixingUntil;
    const wanted = this.dirty || moved;
    const due = wanted || (this.blurred && !quick);
    const draw = due && !busy;
    const look = this.stale || now < this.awakeUntil;
    const sharpness = quick ? this.sharpness : 1;
    this.stale = false;
    this.dirty = wanted && !draw;
    if (draw) this.blurred = sharpness < 1;
    return { draw, held: due && busy, look, sharpness, quick };
  }

  forgive() {
    this.slow = 0;
  }

  // How long the card took for a frame.
  took(ms: number) {
    if (ms < STALL_MS) this.frameMs += 0.4 * (ms - this.frameMs);
  }

  // After every turn. The frames a second where they have been few for a while, once; else null.
  measure(now: number, { draw: drew, held, quick }: Turn): number | null {
    if (held) return null; // two frames about it are on end
    const gap = now - this.lastAt;
    const next = drew && this.drewBefore; // two frames on end
    if (next && gap < 3000) this.average = this.average ? this.average * 0.8 + gap * 0.2 : gap;
    else if (gap > RESTS_MS) this.average = 0;
    this.drewBefore = drew;
    if (drew) this.lastAt = now;
    // Only frames of a moving camera tell: while tiles come, decoding and uploading are the cost.
    if (!quick || !next || document.hidden) return null;
    if (gap > BRISK_MS) this.sharpness = Math.max(SHARPNESS_LEAST, this.sharpness * 0.8);
    else if (gap < BRISK_MS / 3) this.sharpness = Math.min(1, this.sharpness * 1.1);
    this.slow = gap > 1000 / SLOW_FPS && gap < STALL_MS ? this.slow + 1 : Math.max(0, this.slow - 1);
    return this.slow === SLOW_FRAMES ? this.framesPerSecond : null;
  }
}

const DONE_MS = 1500; // after a lost context: a frame that is not done by then is not told of

// When the card has drawn a frame: scripts return long before.
export class CardClock {
  private fence: WebGLSync | null = null;
  private begunAt = 0;
  private doubtful = false; // a context that came back may have fences that are never done
  private blind = false; // it has

  constructor(private readonly gl: WebGL2RenderingContext) {}

  // Right after a frame was drawn that was begun then. One frame at a time is watched.
  start(begunAt: number) {
    if (this.fence || this.blind || this.gl.isContextLost()) return;
    this.begunAt = begunAt;
    this.fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  }

  // The context was lost, and is there again.
  restore() {
    this.fence = null;
    this.doubtful = true;
  }

  // The card is not done with the watched frame.
  get busy(): boolean {
    return this.fence !== null;
  }

  // Milliseconds that the watched frame took, once; else null.
  poll(): number | null {
    const { gl, fence } = this;
    if (!fence) return null;
    const lost = gl.isContextLost();
    if (!lost && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) {
      this.blind = this.doubtful && performance.now() - this.begunAt > DONE_MS;
      if (this.blind) this.fence = null;
      return null;
    }
    this.doubtful = false;
    gl.deleteSync(fence);
    this.fence = null;
    return lost ? null : performance.now() - this.begunAt;
  }
}
