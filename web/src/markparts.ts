// Parts at full size of a photograph that is shown as a smaller picture. Only what is looked at closely is asked for,
// once the view rests, and what was looked at last is kept: 4 MB each.
//
// SPDX-License-Identifier: Apache-2.0
const KEPT_PARTS = 16;
const REST_MS = 80;

type Part = { bitmap: ImageBitmap | null; asked: boolean };

export class Parts {
  private readonly parts = new Map<string, Part>(); // the newest last
  private wanted = new Set<string>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private closed = false;

  constructor(
    readonly size: number, // pixels of an edge
    private readonly ask: (column: number, row: number) => Promise<ImageBitmap>,
    private readonly came: () => void,
    private readonly failed: (error: Error) => void,
  ) {}

  // Before a picture is drawn: what it needs is what is wanted from now.
  begin() {
    this.wanted = new Set();
  }

  // Null: it is not here yet; it is wanted.
  get(column: number, row: number): ImageBitmap | null {
    const key = `${column} ${row}`;
    const part = this.parts.get(key);
    this.wanted.add(key);
    if (part) {
      this.parts.delete(key);
      this.parts.set(key, part);
    }
    if (!part?.asked) this.wait();
    return part?.bitmap ?? null;
  }

  // All that the last picture needed is there.
  get complete(): boolean {
    return [...this.wanted].every((key) => this.parts.get(key)?.bitmap);
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    for (const part of this.parts.values()) part.bitmap?.close();
    this.parts.clear();
    this.wanted.clear();
  }

  private wait() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      for (const key of this.wanted) if (!this.parts.get(key)?.asked) void this.load(key);
      this.drop();
    }, REST_MS);
  }

  private async load(key: string) {
    const [column, row] = key.split(" ").map(Number) as [number, number];
    const part: Part = { bitmap: null, asked: true };
    this.parts.set(key, part);
    try {
      const bitmap = await this.ask(column, row);
      if (this.closed || this.parts.get(key) !== part) return bitmap.close();
      part.bitmap = bitmap;
      this.came();
    } catch (error) {
      if (!this.closed) this.failed(error as Error); // it stays asked for: no second try by itself
    }
  }

  private drop() {
    for (const [key, part] of this.parts) {
      if (this.parts.size <= KEPT_PARTS) break;
      if (this.wanted.has(key)) continue;
      part.bitmap?.close();
      this.parts.delete(key);
    }
  }
}
