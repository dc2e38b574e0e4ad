// What the page of `citysplat mark` asks the command for, and the changes that can be undone. Changes are sent one after
// the other: each names the revision that it was made of, so that two pages cannot undo each other unseen.
//
// SPDX-License-Identifier: Apache-2.0
export type Place = [number, number]; // pixels of the photograph, column and row

export interface Photograph {
  name: string;
  width: number;
  height: number;
}
export interface Point {
  name: string;
  marks: number;
  suspects: number;
  source: "nowhere" | "frame" | "one" | "marks";
  worst: number | null; // pixels
  offPlan: number | null; // metres
  offHeight: number | null;
}
export interface Spot {
  photo: number;
  expected: Place | null;
  mark: Place | null;
  residual: number | null;
  out: number | null;
  suspect: boolean;
  lost: boolean;
}
interface Survey {
  output: string;
  revision: number;
  strays: number;
  part: number;
  photographs: Photograph[];
  points: Point[];
}
interface State {
  revision: number;
  points: Point[];
  point: number;
  spots: Spot[];
}
interface Change {
  point: number;
  photo: number;
  before: Place | null;
  after: Place | null;
}

export class Refused extends Error {
  constructor(
    readonly status: number,
    message: string,
  ) {
    super(message);
  }
}

export class Desk {
  output = "";
  strays = 0;
  part = 0;
  photographs: Photograph[] = [];
  points: Point[] = [];
  point = 0;
  spots: Spot[] = [];
  private revision = 0;
  private done: Change[] = [];
  private undone: Change[] = [];
  private last: Promise<unknown> = Promise.resolve();

  constructor(private readonly token: string) {}

  async open() {
    Object.assign(this, (await (await this.ask("survey")).json()) as Survey);
    this.done = [];
    this.undone = [];
  }

  async choose(point: number) {
    await this.last; // its answer is older
    this.take((await (await this.ask(`points/${point}`)).json()) as State, true);
  }

  spot(photo: number): Spot | undefined {
    return this.spots.find((one) => one.photo === photo);
  }

  // Of a large photograph a smaller picture.
  async photograph(index: number): Promise<ImageBitmap> {
    return createImageBitmap(await (await this.ask(`photographs/${index}`)).blob());
  }

  // At full size: a square of `part` pixels.
  async photographPart(index: number, column: number, row: number): Promise<ImageBitmap> {
    return createImageBitmap(await (await this.ask(`photographs/${index}/${column}/${row}`)).blob());
  }

  // Sets or removes (null) a mark of the point of now.
  set(photo: number, after: Place | null): Promise<void> {
    const change = { point: this.point, photo, before: this.spot(photo)?.mark ?? null, after };
    return this.send(change, change.after).then(() => {
      this.done.push(change);
      this.undone = [];
    });
  }

  get canUndo() {
    return this.done.length > 0;
  }

  get canRedo() {
    return this.undone.length > 0;
  }

  // The change that was taken back, or made again; null: there is none.
  undo(): Promise<Change | null> {
    return this.step(this.done, this.undone, "before");
  }

  redo(): Promise<Change | null> {
    return this.step(this.undone, this.done, "after");
  }

  private async step(from: Change[], to: Change[], side: "before" | "after"): Promise<Change | null> {
    const change = from.at(-1);
    if (!change) return null;
    await this.send(change, change[side]);
    from.pop();
    to.push(change);
    return change;
  }

  private send(change: Change, at: Place | null): Promise<void> {
    const sent = this.last.then(async () => {
      const body = JSON.stringify({ revision: this.revision, point: change.point, photo: change.photo, at });
      const response = await this.ask("marks", { method: "PUT", body, headers: { "Content-Type": "application/json" } });
      this.take((await response.json()) as State, change.point !== this.point);
    });
    this.last = sent.catch(() => undefined);
    return sent;
  }

  // The photographs of a point stay in the order that they had when it was chosen.
  private take(state: State, anew: boolean) {
    this.revision = state.revision;
    this.points = state.points;
    if (!anew) {
      const rank = new Map(this.spots.map((one, k) => [one.photo, k]));
      const of = (one: Spot) => rank.get(one.photo) ?? Infinity;
      state.spots.sort((a, b) => (of(a) === of(b) ? 0 : of(a) - of(b)));
    }
    this.point = state.point;
    this.spots = state.spots;
  }

  private async ask(path: string, init: RequestInit = {}): Promise<Response> {
    const headers = { ...init.headers, Authorization: `Bearer ${this.token}` };
    const response = await fetch(`./mark/${path}`, { ...init, headers, cache: "no-store" });
    if (response.ok) return response;
    const problem = (await response.json().catch(() => ({}))) as { detail?: string };
    throw new Refused(response.status, problem.detail ?? response.statusText);
  }
}
