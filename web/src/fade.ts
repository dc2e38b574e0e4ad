// Cross-fade between levels: what is drawn while some tiles take the place of others. What comes rises as what goes
// falls. One fade at a time: what is wanted meanwhile waits for its end, except tiles that nothing stands for.
//
// The curve and the rule are those of lab/eval/fade.c; tests/vectors/fade.json holds both to them.
//
// SPDX-License-Identifier: Apache-2.0
import type { Block, Piece } from "./block";

export const FADE_MS = 280;
export const FADE_STEP_MOST = 1 / 18; // of a frame: no pixel changes by more than 16 of 255
export const FADE_FRAMES_LEAST = 4; // in its time; where frames take longer there is none: it would take seconds

// The time of a fade: it stands while no frame is drawn, and a slow frame takes it no further than a step.
export class FadeClock {
  spent = 0; // of the fade, from 0 to 1
  private at = 0; // of the last frame

  // A frame is drawn now.
  tick(now: number, fadeMs: number) {
    const step = this.at ? (now - this.at) / Math.max(1, fadeMs) : 0;
    this.spent = Math.min(1, this.spent + Math.min(step, FADE_STEP_MOST));
    this.at = now;
  }
}

// The share of its opacity that what comes has after the part t of a fade; what goes has the rest.
export function fadeShare(t: number): number {
  return Math.max(0, Math.min(1, t));
}

// Neighbours may share a little of their rectangles, which are of centres; a single Gaussian's has no size.
function overlap(a0: number, a1: number, b0: number, b1: number): boolean {
  return Math.min(a1, b1) - Math.max(a0, b0) >= 0.1 * Math.min(a1 - a0, b1 - b0);
}

// Whether one stands where the other does.
function meet(p: Piece, q: Piece): boolean {
  if (p.block === q.block) return true;
  const [a, b] = [p.block.area, q.block.area];
  const both = overlap(a[0], a[1], b[0], b[1]) && overlap(a[2], a[3], b[2], b[3]);
  return both && !p.without.includes(q.block) && !q.without.includes(p.block);
}

function same(p: Piece, q: Piece | undefined): boolean {
  return (
    p.block === q?.block && p.without.length === q.without.length && p.without.every((b, k) => b === q.without[k])
  );
}

const byBlock = (pieces: readonly Piece[]) => new Map(pieces.map((piece) => [piece.block, piece]));

export class Fade {
  from: readonly Piece[] | null = null; // while a fade is under way: what was there; else null
  to: readonly Piece[] = []; // what is to be

  // may: a fade may begin. True where other pieces are to be drawn than before.
  want(wanted: readonly Piece[], may: boolean): boolean {
    const { from, to } = this;
    const had = byBlock(to);
    if (from) {
      const more = wanted.filter((p) => !had.has(p.block) && !to.some((q) => meet(p, q)));
      if (more.length) [this.from, this.to] = [[...from, ...more], [...to, ...more]];
      return more.length > 0;
    }
    if (wanted.length === to.length && wanted.every((p, i) => same(p, to[i]))) return false;
    this.to = wanted;
    if (!may) return true;
    const has = byBlock(wanted);
    const stays = (p: Piece) => same(p, has.get(p.block));
    const stood = to.filter((p) => stays(p) || wanted.some((q) => meet(p, q)));
    const isNew = (p: Piece) => !same(p, had.get(p.block)) && !stood.some((q) => meet(p, q));
    if (!stood.every(stays)) this.from = [...stood, ...wanted.filter(isNew)];
    return true;
  }

  // A block is not there any more: then what it fades from or to is, at once. True where that changes the picture.
  drop(block: Block): boolean {
    const other = (p: Piece) => p.block !== block;
    const cuts = this.from !== null && !(this.from.every(other) && this.to.every(other));
    this.to = this.to.filter(other);
    if (cuts) this.from = null;
    return cuts;
  }
}
