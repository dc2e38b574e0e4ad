// What lies over the picture, to be compared with it: the server's drawing of the view, or another scene
// of the server, say the same place of another date. Wiped or faded, and the two can be swapped.
//
// The server draws the view at rest: while the camera moves its drawing is hidden rather than wrong.
// Another scene is drawn by a viewer of its own, which follows this one's camera.
//
// SPDX-License-Identifier: Apache-2.0
import type { Comparison } from "./address";
import { element, setText, toast } from "./dom";
import type { Pictures } from "./pictures";
import { Problem } from "./problem";
import { text } from "./strings";
import type { Viewer } from "./viewer";

const SERVER = ""; // of the list of what to compare with

function wordsOf(error: unknown): string {
  return error instanceof Problem ? `${error.title}. ${error.message}` : `Error: ${String(error)}`;
}

export class Compare {
  open = false;
  developer = false; // the server's drawing is offered too
  onChange: () => void = () => {}; // what a link to it says is another thing now
  private swapped = false; // it lies on the left
  private other: Viewer | null = null; // draws another scene
  private followed = ""; // the pose that it has
  private readonly box = document.createElement("div"); // of the other viewer
  private readonly canvas = document.createElement("canvas"); // of the server's drawing
  private readonly divider = document.createElement("div");
  private readonly pictures: Pictures;
  private readonly list = element<HTMLSelectElement>("compare-with");

  // wish: what the link compares, to be opened with the first scene.
  constructor(
    private readonly viewer: Viewer,
    private wish: Comparison | null,
  ) {
    this.canvas.id = "server-image";
    this.box.id = "other-scene";
    this.box.inert = true;
    this.divider.id = "divider";
    this.divider.dataset["own"] = "";
    this.canvas.hidden = this.box.hidden = this.divider.hidden = true;
    viewer.surface.append(this.canvas, this.box, this.divider);
    this.pictures = viewer.comparison(this.canvas);
    this.pictures.onStart = () => setText("compare-text", text("compare.wait"));
    this.pictures.onPicture = ({ width, height, bytes, milliseconds }) => {
      const size = bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
      const seconds = (milliseconds / 1000).toFixed(2);
      setText("compare-text", text("compare.text", { width, height, size, seconds }));
      this.canvas.classList.add("fresh");
    };
    this.pictures.onProblem = (error) => setText("compare-text", wordsOf(error));
    viewer.on("frame", () => this.follow());
    viewer.on("mode", (mode) => mode === "pictures" && this.show(false));
    viewer.on("scene", () => this.fill());
    this.wire();
  }

  private wire() {
    const { divider } = this;
    divider.addEventListener("pointerdown", (event) => {
      event.stopPropagation();
      divider.setPointerCapture(event.pointerId);
    });
    divider.addEventListener("pointermove", (event) => {
      if (!divider.hasPointerCapture(event.pointerId)) return;
      const amount = 100 * (1 - event.clientX / this.viewer.surface.clientWidth);
      element<HTMLInputElement>("amount").value = String(Math.min(100, Math.max(0, amount)));
      this.layOut();
    });
    element("amount").addEventListener("input", () => this.layOut());
    for (const radio of document.querySelectorAll('input[name="mode"]'))
      radio.addEventListener("change", () => this.layOut());
    this.list.addEventListener("change", () => this.begin());
    element("server-button").addEventListener("click", () => this.show(!this.open));
    element("compare-swap").addEventListener("click", () => this.swap());
    element("compare-close").addEventListener("click", () => this.show(false));
  }

  // What there is to compare with, in the language of now; what was chosen stays where it can.
  fill() {
    const { viewer, list } = this;
    const { scene, scenes } = viewer;
    const others = scenes.filter((one) => one.id !== scene?.id);
    const before = list.value;
    // A matter of those who work on the programs, and of their links.
    const drawing = this.developer || this.wish?.scene === SERVER || (this.open && before === SERVER);
    list.replaceChildren(
      ...(scene?.pictures && drawing ? [new Option(text("compare.drawing"), SERVER)] : []),
      ...others.map((one) => new Option(one.title, one.id)),
    );
    if ([...list.options].some((one) => one.value === before)) list.value = before;
    element("compare-with-field").hidden = list.options.length < 2 && list.value === SERVER;
    element("server-button").hidden = !list.options.length;
    if (this.wish && scene) this.grant(this.wish);
    if (!this.open) return;
    if (!list.options.length) this.show(false);
    else if (list.value !== before || this.other?.scene?.id === scene?.id) this.begin();
    else this.label();
  }

  // What a link has to say of it; null: nothing is compared.
  get link(): Comparison | null {
    if (this.wish || !this.open) return this.wish;
    const amount = Number(element<HTMLInputElement>("amount").value);
    const { swapped, wipes } = this;
    return {
      ...{ scene: this.list.value, swapped },
      ...(wipes ? { by: "wipe", percent: 100 - amount } : { by: "fade", percent: amount }),
    };
  }

  // As the link says, or not at all: another scene in its place would be a lie.
  private grant({ scene, by, percent, swapped }: Comparison) {
    this.wish = null;
    const { list, viewer } = this;
    if (viewer.mode === "pictures" || ![...list.options].some(({ value }) => value === scene)) {
      toast(text("compare.none", { id: scene || text("compare.drawing") }));
      return;
    }
    list.value = scene;
    this.swapped = swapped;
    element<HTMLInputElement>("amount").value = String(by === "wipe" ? 100 - percent : percent);
    document.querySelector<HTMLInputElement>(`input[name="mode"][value="${by}"]`)!.checked = true;
    this.show(true);
  }

  private get wipes(): boolean {
    return document.querySelector<HTMLInputElement>('input[name="mode"]:checked')!.value === "wipe";
  }

  show(open: boolean) {
    if (open && !this.list.options.length) return;
    this.open = open;
    element("compare").hidden = !open;
    element("server-button").setAttribute("aria-pressed", String(open));
    if (open) this.begin();
    else this.end();
    this.onChange();
  }

  swap() {
    if (!this.open) return;
    this.swapped = !this.swapped;
    this.layOut();
  }

  private begin() {
    this.end();
    const { viewer, box, canvas, list } = this;
    const id = list.value;
    if (id === SERVER) canvas.hidden = false;
    else {
      box.hidden = false;
      viewer.shareMemory(true);
      const other = viewer.beside(box, id);
      this.other = other;
      other.on("turn", () => this.tell(other));
      other.on("problem", (error) => setText("compare-text", wordsOf(error)));
    }
    this.layOut();
    this.follow();
  }

  private end() {
    this.pictures.stop();
    this.canvas.hidden = this.box.hidden = this.divider.hidden = true;
    this.canvas.classList.remove("fresh");
    this.box.classList.remove("fresh");
    setText("compare-text", "");
    if (!this.other) return;
    this.other.dispose();
    this.other = null;
    this.followed = "";
    this.viewer.shareMemory(false);
  }

  private follow() {
    if (!this.open) return;
    const { other, viewer } = this;
    if (other) {
      const now = JSON.stringify(viewer.pose);
      if (now !== this.followed) other.lookAt(viewer.pose);
      this.followed = now;
      return;
    }
    const { entry, appearance, width, height } = viewer.wantedView;
    if (!entry) return;
    this.pictures.sky = viewer.backdrop; // like with like
    this.pictures.want(entry, appearance, viewer.pose, width, height);
    if (!this.pictures.settled) this.canvas.classList.remove("fresh");
  }

  // How far the other scene is. One that lies elsewhere has nothing to show here, and that is shown.
  private tell({ state, hasPicture }: Viewer) {
    if (hasPicture || state.settled) this.box.classList.add("fresh");
    const now = !state.settled ? text("compare.coming") : hasPicture ? "" : text("compare.elsewhere");
    if (!state.error) setText("compare-text", now);
  }

  private layOut() {
    const amount = Number(element<HTMLInputElement>("amount").value); // that the right one has
    const { swapped, wipes: wipe } = this;
    for (const { style } of [this.canvas, this.box]) {
      style.opacity = wipe ? "1" : String((swapped ? 100 - amount : amount) / 100);
      style.clipPath = !wipe
        ? "none"
        : swapped
          ? `inset(0 ${amount}% 0 0)`
          : `inset(0 0 0 ${100 - amount}%)`;
    }
    this.divider.hidden = !(this.open && wipe && amount > 0 && amount < 100);
    this.divider.style.left = `${100 - amount}%`;
    this.label();
    this.onChange();
  }

  private label() {
    const { viewer, list } = this;
    const names = [
      this.other ? (viewer.scene?.title ?? "") : text("compare.client"),
      this.other ? (list.selectedOptions[0]?.text ?? "") : text("compare.server"),
    ];
    if (this.swapped) names.reverse();
    setText("compare-left", names[0]!);
    setText("compare-right", names[1]!);
  }
}
