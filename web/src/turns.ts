// The loop of a page. A page at rest has none: it goes on while something moves, is to be drawn or has just happened, and
// looks now and then at what is on its way. Everything else wakes it.
//
// SPDX-License-Identifier: Apache-2.0
const LONGEST_S = 0.25; // between two turns, for what moves

export class Turns {
  private running = 0; // the next turn; 0: it rests
  private timer = 0; // that ends the rest
  private previous = 0; // when the last turn was; 0: before the rest
  private ended = false;

  // turn: what is done in one, and when the next is to be: 0 at once, else after so many milliseconds; null: it rests.
  constructor(private readonly turn: (now: number, seconds: number) => number | null) {}

  // There is something to do.
  run() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (!this.ended) this.running ||= requestAnimationFrame((now) => this.take(now));
  }

  private take(now: number) {
    this.running = 0;
    const seconds = Math.min((now - (this.previous || now)) / 1000, LONGEST_S);
    this.previous = now;
    const wait = this.turn(now, seconds);
    if (wait === 0) return this.run();
    this.previous = 0;
    if (wait && !this.timer && !this.ended) this.timer = window.setTimeout(() => this.run(), wait);
  }

  end() {
    this.ended = true;
    cancelAnimationFrame(this.running);
    clearTimeout(this.timer);
  }
}
