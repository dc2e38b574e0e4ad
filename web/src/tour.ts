// A tour that is played, and notes that are shown: for the page, the element and other pages alike.
//
// SPDX-License-Identifier: Apache-2.0
import { parseView } from "./address";
import { isEmpty, parseStory, unpackStory, type Note, type Stop, type Story } from "./story";
import type { Viewer } from "./viewer";

export type { Note, Stop, Story };

const STAY_MS = 1500;
const STAY_CHARACTER_MS = 45; // a caption is read
const NOTE_M = 70; // from a note, when it is visited
const M_PER_DEG = 111_200;
const NOTE_COLOR = "#ff9f43";
const FILE_MAX = 1_000_000; // bytes of a tour's file

const wait = (ms: number) => new Promise<void>((done) => setTimeout(done, ms));

// Where a tour is.
export interface TourState {
  at: number; // the view that is shown, or is next
  count: number; // of views
  name: string; // what is said there; "" without views
  // It flies on by itself.
  playing: boolean;
}

// Plays the views of a story in a viewer.
export class Tour {
  onChange: () => void = () => {}; // another view, a pause
  private own: Story = { views: [], notes: [] };
  private at = 0;
  private playing = false;
  private run = 0; // counts, so that a pause ends the run that it belongs to
  private shapes: number[] = [];
  private readonly ends: (() => void)[];

  constructor(
    private readonly viewer: Viewer,
    // What is played.
    story: Story = { views: [], notes: [] },
  ) {
    this.ends = [viewer.on("touch", () => this.pause())];
    this.show(story);
  }

  // What is played.
  get story(): Story {
    return this.own;
  }

  // Where it is now.
  get state(): TourState {
    const { at, playing, own: { views } } = this;
    return { at, count: views.length, name: views[at]?.name ?? "", playing };
  }

  // Another one, from its beginning.
  show(story: Story) {
    this.pause();
    this.own = story;
    this.at = 0;
    this.refresh();
  }

  // After changes of its views and notes.
  refresh() {
    const { overlay } = this.viewer;
    const { views, notes } = this.own;
    this.at = Math.min(this.at, Math.max(0, views.length - 1));
    for (const shape of this.shapes) overlay.remove(shape);
    this.shapes = notes.map(({ place, text: label }) => overlay.add({ kind: "point", places: [place], label, color: NOTE_COLOR, note: true }));
    this.onChange();
  }

  // From where it is to its end, which it resolves at; earlier after a pause.
  async play(): Promise<void> {
    const { views } = this.own;
    if (!views.length) return;
    const run = ++this.run;
    this.playing = true;
    for (let i = this.at; i < views.length; i++) {
      this.go(i);
      await this.flyTo(views[i]!);
      if (run !== this.run) return;
      await wait(STAY_MS + STAY_CHARACTER_MS * views[i]!.name.length);
      if (run !== this.run) return;
    }
    this.pause();
    this.at = 0; // next time from the beginning
  }

  // Stays where it is; play() goes on from there.
  pause() {
    if (!this.playing) return;
    this.run++;
    this.playing = false;
    this.onChange();
  }

  // One view; nothing where there is none of that number.
  async visit(i: number): Promise<void> {
    const stop = this.own.views[i];
    if (!stop) return;
    this.pause();
    this.go(i);
    await this.flyTo(stop);
  }

  // To a view before or behind this one.
  step(by: number): Promise<void> {
    return this.visit(this.at + by);
  }

  // From aside and above, as it is looked at now.
  async visitNote({ place }: Note): Promise<void> {
    this.pause();
    const { heading, fov } = this.viewer.pose;
    const turn = (heading * Math.PI) / 180;
    const back = NOTE_M / M_PER_DEG;
    const lat = place.lat - back * Math.cos(turn);
    const lon = place.lon - (back * Math.sin(turn)) / Math.cos((place.lat * Math.PI) / 180);
    await this.viewer.flyTo({ lon, lat, h: place.h + NOTE_M * Math.tan(Math.PI / 6), heading, pitch: -30, fov });
  }

  // Leaves the viewer without its notes.
  dispose() {
    this.onChange = () => {};
    this.pause();
    for (const end of this.ends) end();
    for (const shape of this.shapes) this.viewer.overlay.remove(shape);
  }

  private go(i: number) {
    this.at = i;
    this.onChange();
  }

  private flyTo(stop: Stop): Promise<void> {
    const view = parseView(stop.view)!;
    void this.viewer.setAppearance(view.appearance);
    return this.viewer.flyTo(view.pose, stop.seconds);
  }
}

// What a link carries behind "&story=", or the address of a file as the viewer exports it. Rejects with why not.
export async function loadStory(source: string): Promise<Story> {
  if (/^[\w-]*$/.test(source)) return source ? unpackStory(source) : { views: [], notes: [] };
  const answer = await fetch(new URL(source, document.baseURI));
  if (!answer.ok) throw new Error(`${answer.status} ${answer.statusText}`);
  const bytes = await answer.blob();
  if (bytes.size > FILE_MAX) throw new Error("a tour of too many bytes");
  const story = parseStory(await bytes.text());
  if (isEmpty(story)) throw new Error("no tour");
  return story;
}

// Notes are shown at once, the tour when it is played.
export function createTour(viewer: Viewer, story: Story): Tour {
  return new Tour(viewer, story);
}
