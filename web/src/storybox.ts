// A tour of saved views with captions, and notes at places: made, changed, played, carried by the link. Without a link they are
// kept in this browser, for each scene. A link's are shown instead, and do not touch what is kept.
//
// SPDX-License-Identifier: Apache-2.0
import { formatView } from "./address";
import { download, element, setText, toast } from "./dom";
import type { Place } from "./geo";
import { formatStory, isEmpty, makeNote, makeStop, packStory, parseStory, TEXT_MAX, unpackStory, type Note, type Stop, type Story } from "./story";
import { storyKey } from "./storylink";
import { text, type TextKey } from "./strings";
import { Tour } from "./tour";
import type { Viewer } from "./viewer";

// What the page does for it.
export interface StoryHost {
  changed(link: string): void; // what the address carries
  placing(on: boolean): void; // the next click is a note's place, and nothing else
  clear(): void; // the picture is to be seen: on a phone the panel goes
}

export class StoryBox {
  private readonly tour: Tour;
  private foreign = false; // of a link: what this browser keeps is another
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
    this.tour = new Tour(viewer);
    this.tour.onChange = () => this.list();
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    const file = element<HTMLInputElement>("tour-file");
    click("tour-play", () => this.toggle());
    click("tour-export", () => download("tour.json", "application/json", formatStory(this.story)));
    click("tour-import", () => file.click());
    click("tour-pause", () => this.toggle());
    click("tour-back", () => this.visit(this.tour.state.at - 1));
    click("tour-next", () => this.visit(this.tour.state.at + 1));
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
    let scene = viewer.scene?.id; // another light of it is the same scene
    viewer.on("scene", ({ id }) => {
      if (id !== scene) void this.open(scene === undefined ? link : null);
      scene = id;
    });
    if (scene !== undefined) void this.open(link);
  }

  private get story(): Story {
    return this.tour.story;
  }

  translate() {
    this.list();
  }

  // The tour of the page, by a key: from where it is, or a pause.
  toggle() {
    if (this.tour.state.playing) return this.tour.pause();
    if (!this.story.views.length) return toast(text("tour.none"));
    this.host.clear();
    element("tour-card").hidden = false;
    void this.tour.play();
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
    const story = given ?? kept;
    if (this.foreign && story.views.length) element("tour-card").hidden = false;
    this.tour.show(story);
    this.tell();
  }

  private change() {
    if (!this.foreign)
      try {
        localStorage.setItem(storyKey(this.viewer), formatStory(this.story));
      } catch {
        // no storage: it lives as long as the page
      }
    this.tour.refresh();
    this.tell();
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
    const { at } = this.tour.state;
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
        const item = row(stop.name, () => this.visit(i), edit, up, drop);
        if (i === at && !element("tour-card").hidden) item.setAttribute("aria-current", "step");
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
        const visit = () => {
          this.host.clear();
          void this.tour.visitNote(note);
        };
        return row(note.text, visit, edit, drop);
      }),
    );
    element<HTMLButtonElement>("tour-play").disabled = views.length === 0;
    element<HTMLButtonElement>("tour-export").disabled = isEmpty(this.story);
    this.showTour();
  }

  addView() {
    const { pose, state } = this.viewer;
    const name = text("tour.name", { number: this.story.views.length + 1 });
    this.story.views.push(makeStop(name, formatView({ pose, appearance: state.wanted })));
    this.change();
  }

  // ---- the tour ----

  private visit(i: number) {
    this.host.clear();
    element("tour-card").hidden = false;
    void this.tour.visit(i);
  }

  private closeTour() {
    this.tour.pause();
    element("tour-card").hidden = true;
    this.list();
  }

  private showTour() {
    const { at, count, name, playing } = this.tour.state;
    if (!count) element("tour-card").hidden = true;
    setText("tour-caption", name);
    setText("tour-at", count ? text("tour.at", { number: at + 1, count }) : "");
    element<HTMLButtonElement>("tour-back").disabled = at === 0;
    element<HTMLButtonElement>("tour-next").disabled = at >= count - 1;
    for (const id of ["tour-play", "tour-pause"]) setText(id, text(playing ? "tour.stop" : "tour.play"));
  }

  // ---- notes ----

  beginNote() {
    this.endNote();
    this.tour.pause();
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

  // ---- files ----

  private async read(input: HTMLInputElement) {
    const file = input.files?.[0];
    input.value = "";
    if (!file) return;
    try {
      this.tour.show(parseStory(await file.text()));
      this.foreign = false;
      this.change();
    } catch {
      toast(text("tour.bad", { file: file.name }));
    }
  }
}
