// A tour of saved views with captions, and notes at places: made, changed, played, carried by the link. Without a link they are
// kept in this browser, for each scene. A link's are shown instead, and do not touch what is kept.
//
// SPDX-License-Identifier: Apache-2.0
import { formatView, parseView } from "./address";
import { download, element, setText, toast } from "./dom";
import type { Place } from "./geo";
import { formatStory, isEmpty, makeNote, makeStop, packStory, parseStory, TEXT_MAX, unpackStory, type Note, type Stop, type Story } from "./story";
import { storyKey } from "./storylink";
import { text, type TextKey } from "./strings";
import type { Viewer } from "./viewer";

const STAY_MS = 1500;
const STAY_CHARACTER_MS = 45; // a caption is read
const NOTE_M = 70; // from a note, when it is visited
const M_PER_DEG = 111_200;
const NOTE_COLOR = "#ff9f43";

// What the page does for it.
export interface StoryHost {
  changed(link: string): void; // what the address carries
  placing(on: boolean): void; // the next click is a note's place, and nothing else
  clear(): void; // the picture is to be seen: on a phone the panel goes
}

const wait = (ms: number) => new Promise<void>((done) => setTimeout(done, ms));

export class StoryBox {
  private story: Story = { views: [], notes: [] };
  private foreign = false; // of a link: what this browser keeps is another
  private shapes: number[] = [];
  private at = 0; // the stop that is shown, or is next
  private playing = false;
  private run = 0; // counts, so that a pause ends the run that it belongs to
  private packing = 0;
  private placing = false;
  private place: Place | null = null; // of the note that is written
  private edited: Stop | Note | null = null;

  // link: what the address carries; null where it carries nothing.
  constructor(
    private readonly viewer: Viewer,
    private readonly host: StoryHost,
    link: string | null,
  ) {
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    const file = element<HTMLInputElement>("tour-file");
    click("tour-play", () => this.toggle());
    click("tour-export", () => download("tour.json", "application/json", formatStory(this.story)));
    click("tour-import", () => file.click());
    click("tour-pause", () => this.toggle());
    click("tour-back", () => void this.step(-1));
    click("tour-next", () => void this.step(1));
    click("tour-close", () => this.closeTour());
    click("note-middle", () => this.putMiddle());
    click("note-close", () => this.endNote());
    element("note-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.save();
    });
    element("note").addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.endNote();
    });
    element<HTMLInputElement>("note-text").maxLength = TEXT_MAX;
    file.addEventListener("change", () => void this.read(file));
    viewer.on("click", ({ place }) => this.put(place));
    viewer.on("touch", () => this.pause());
    let scene = viewer.scene?.id; // another light of it is the same scene
    viewer.on("scene", ({ id }) => {
      if (id !== scene) void this.open(scene === undefined ? link : null);
      scene = id;
    });
    if (scene !== undefined) void this.open(link);
  }

  translate() {
    this.list();
    this.showTour();
  }

  // The tour of the page, by a key: from where it is, or a pause.
  toggle() {
    if (this.playing) this.pause();
    else void this.play();
  }

  // What a link carries, or what this browser keeps of the scene.
  async open(link: string | null) {
    this.closeTour();
    this.endNote();
    let kept: Story = { views: [], notes: [] };
    try {
      kept = parseStory(localStorage.getItem(storyKey(this.viewer)) ?? "");
    } catch {
      // nothing is kept, or nothing can be
    }
    let given: Story | null = null;
    try {
      given = link ? await unpackStory(link) : null;
    } catch {
      toast(text("story.bad"));
    }
    this.foreign = given !== null && (await packStory(kept)) !== link;
    this.story = given ?? kept;
    this.at = 0;
    this.list();
    this.tell();
    if (this.foreign && this.story.views.length) element("tour-card").hidden = false;
    this.showTour();
  }

  private change() {
    if (!this.foreign)
      try {
        localStorage.setItem(storyKey(this.viewer), formatStory(this.story));
      } catch {
        // no storage: it lives as long as the page
      }
    this.at = Math.min(this.at, Math.max(0, this.story.views.length - 1));
    this.list();
    this.tell();
    this.showTour();
  }

  // The link follows.
  private tell() {
    const ticket = ++this.packing;
    void packStory(this.story).then((link) => {
      if (ticket !== this.packing) return;
      element("story-long").hidden = link !== null;
      this.host.changed(link ?? "");
    });
  }

  // ---- lists ----

  private list() {
    const { views, notes } = this.story;
    const { overlay } = this.viewer;
    for (const shape of this.shapes) overlay.remove(shape);
    this.shapes = notes.map(({ place, text: label }) => overlay.add({ kind: "point", places: [place], label, color: NOTE_COLOR, note: true }));
    const button = (key: TextKey, sign: string, name: string, run: () => void) => {
      const one = document.createElement("button");
      one.textContent = sign;
      one.className = "small";
      one.title = text(key, { name });
      one.setAttribute("aria-label", one.title);
      one.onclick = run;
      return one;
    };
    const row = (name: string, go: () => void, ...more: HTMLElement[]) => {
      const item = document.createElement("li");
      const visit = document.createElement("button");
      visit.textContent = name;
      visit.onclick = go;
      item.append(visit, ...more);
      return item;
    };
    element("tour").replaceChildren(
      ...views.map((stop, i) => {
        const up = button("tour.up", "↑", stop.name, () => {
          views.splice(i - 1, 2, stop, views[i - 1]!);
          this.change();
        });
        (up as HTMLButtonElement).disabled = i === 0;
        const edit = button("tour.edit", "✎", stop.name, () => this.edit(stop, stop.name));
        const drop = button("tour.remove", "×", stop.name, () => {
          views.splice(i, 1);
          this.change();
        });
        const item = row(stop.name, () => void this.visit(i), edit, up, drop);
        if (i === this.at && !element("tour-card").hidden) item.setAttribute("aria-current", "step");
        return item;
      }),
    );
    element("notes").replaceChildren(
      ...notes.map((note, i) => {
        const edit = button("tour.edit", "✎", note.text, () => this.edit(note, note.text));
        const drop = button("tour.remove", "×", note.text, () => {
          notes.splice(i, 1);
          this.change();
        });
        return row(note.text, () => this.visitNote(note), edit, drop);
      }),
    );
    element<HTMLButtonElement>("tour-play").disabled = views.length === 0;
    element<HTMLButtonElement>("tour-export").disabled = isEmpty(this.story);
  }

  addView() {
    const { pose, state } = this.viewer;
    const name = text("tour.name", { number: this.story.views.length + 1 });
    this.story.views.push(makeStop(name, formatView({ pose, appearance: state.wanted })));
    this.change();
  }

  // ---- the tour ----

  private goTo(stop: Stop): Promise<void> {
    const view = parseView(stop.view)!;
    void this.viewer.setAppearance(view.appearance);
    return this.viewer.flyTo(view.pose, stop.seconds);
  }

  private async play() {
    const { views } = this.story;
    if (!views.length) return;
    const run = ++this.run;
    this.playing = true;
    this.host.clear();
    for (let i = this.at; i < views.length; i++) {
      this.show(i);
      await this.goTo(views[i]!);
      if (run !== this.run) return;
      await wait(STAY_MS + STAY_CHARACTER_MS * views[i]!.name.length);
      if (run !== this.run) return;
    }
    this.pause();
    this.at = 0; // next time from the beginning
  }

  private pause() {
    if (!this.playing) return;
    this.run++;
    this.playing = false;
    this.showTour();
  }

  private async visit(i: number) {
    this.pause();
    this.host.clear();
    this.show(i);
    await this.goTo(this.story.views[i]!);
  }

  private async step(by: number) {
    const i = this.at + by;
    if (this.story.views[i]) await this.visit(i);
  }

  private show(i: number) {
    this.at = i;
    element("tour-card").hidden = false;
    this.showTour();
    this.list();
  }

  private closeTour() {
    this.pause();
    element("tour-card").hidden = true;
  }

  private showTour() {
    const { views } = this.story;
    const stop = views[this.at];
    if (!stop) element("tour-card").hidden = true;
    setText("tour-caption", stop?.name ?? "");
    setText("tour-at", stop ? text("tour.at", { number: this.at + 1, count: views.length }) : "");
    element<HTMLButtonElement>("tour-back").disabled = this.at === 0;
    element<HTMLButtonElement>("tour-next").disabled = this.at >= views.length - 1;
    for (const id of ["tour-play", "tour-pause"]) setText(id, text(this.playing ? "tour.stop" : "tour.play"));
  }

  // ---- notes ----

  beginNote() {
    this.endNote();
    this.pause();
    this.host.clear();
    this.placing = true;
    this.host.placing(true);
    element("note").hidden = false;
    element("note-where").hidden = false;
    element("note-form").hidden = true;
    element("note-middle").focus();
  }

  private putMiddle() {
    const { clientWidth, clientHeight } = this.viewer.surface;
    this.put(this.viewer.pick(clientWidth / 2, clientHeight / 2));
  }

  private put(place: Place | null) {
    if (!this.placing) return;
    if (!place) return toast(text("place.none"));
    this.placing = false;
    this.place = place;
    this.write("");
  }

  private edit(what: Stop | Note, words: string) {
    this.endNote();
    this.edited = what;
    this.host.clear();
    this.write(words);
  }

  private write(words: string) {
    const input = element<HTMLInputElement>("note-text");
    element("note").hidden = false;
    element("note-where").hidden = true;
    element("note-form").hidden = false;
    input.value = words;
    input.focus();
    input.select();
  }

  private save() {
    const words = element<HTMLInputElement>("note-text").value;
    const { edited, place } = this;
    if (!words.trim()) return this.endNote();
    if (place) this.story.notes.push(makeNote(place.lon, place.lat, place.h, words));
    else if (edited && "view" in edited) edited.name = makeStop(words, edited.view).name;
    else if (edited) edited.text = makeNote(edited.place.lon, edited.place.lat, edited.place.h, words).text;
    this.endNote();
    this.change();
  }

  private endNote() {
    this.placing = false;
    this.place = this.edited = null;
    this.host.placing(false);
    element("note").hidden = true;
    if (element("note").contains(document.activeElement)) (document.activeElement as HTMLElement).blur();
  }

  // From aside and above, as it is looked at now.
  private visitNote({ place }: Note) {
    this.pause();
    this.host.clear();
    const { heading, fov } = this.viewer.pose;
    const turn = (heading * Math.PI) / 180;
    const back = NOTE_M / M_PER_DEG;
    const lat = place.lat - back * Math.cos(turn);
    const lon = place.lon - (back * Math.sin(turn)) / Math.cos((place.lat * Math.PI) / 180);
    void this.viewer.flyTo({ lon, lat, h: place.h + NOTE_M * Math.tan(Math.PI / 6), heading, pitch: -30, fov });
  }

  // ---- files ----

  private async read(input: HTMLInputElement) {
    const file = input.files?.[0];
    input.value = "";
    if (!file) return;
    try {
      this.story = parseStory(await file.text());
      this.foreign = false;
      this.change();
    } catch {
      toast(text("tour.bad", { file: file.name }));
    }
  }
}
