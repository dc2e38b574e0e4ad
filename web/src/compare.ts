// The server's drawing of the view, laid over the browser's: wiped or faded. It shows the view at
// rest; while the camera moves it is hidden rather than wrong.
//
// SPDX-License-Identifier: Apache-2.0
import { element, setText } from "./dom";
import { Problem } from "./problem";
import type { Pictures } from "./pictures";
import { text } from "./strings";
import type { Viewer } from "./viewer";

export class Compare {
  open = false;
  private readonly canvas = document.createElement("canvas");
  private readonly divider = document.createElement("div");
  private readonly pictures: Pictures;

  constructor(private readonly viewer: Viewer) {
    this.canvas.id = "server-image";
    this.divider.id = "divider";
    this.divider.dataset["own"] = "";
    this.canvas.hidden = this.divider.hidden = true;
    viewer.surface.append(this.canvas, this.divider);
    this.pictures = viewer.comparison(this.canvas);
    this.pictures.onStart = () => setText("compare-text", text("compare.wait"));
    this.pictures.onPicture = ({ width, height, bytes, milliseconds }) => {
      const size = bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
      const seconds = (milliseconds / 1000).toFixed(2);
      setText("compare-text", text("compare.text", { width, height, size, seconds }));
      this.canvas.classList.add("fresh");
    };
    this.pictures.onProblem = (error) => {
      const known = error instanceof Problem;
      setText("compare-text", known ? `${error.title}. ${error.message}` : `Error: ${String(error)}`);
    };
    viewer.on("frame", () => this.follow());
    viewer.on("mode", (mode) => mode === "pictures" && this.show(false));
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
    element("server-button").addEventListener("click", () => this.show(!this.open));
    element("compare-close").addEventListener("click", () => this.show(false));
  }

  show(open: boolean) {
    this.open = open;
    this.canvas.hidden = !open;
    element("compare").hidden = !open;
    element("server-button").setAttribute("aria-pressed", String(open));
    this.canvas.classList.remove("fresh");
    if (!open) this.pictures.stop();
    this.layOut();
    if (open) this.follow();
  }

  private follow() {
    if (!this.open) return;
    const { entry, appearance, width, height } = this.viewer.wantedView;
    if (!entry) return;
    this.pictures.want(entry, appearance, this.viewer.pose, width, height);
    if (!this.pictures.settled) this.canvas.classList.remove("fresh");
  }

  private layOut() {
    const amount = Number(element<HTMLInputElement>("amount").value);
    const wipe =
      document.querySelector<HTMLInputElement>('input[name="mode"]:checked')!.value === "wipe";
    this.canvas.style.opacity = wipe ? "1" : String(amount / 100);
    this.canvas.style.clipPath = wipe ? `inset(0 0 0 ${100 - amount}%)` : "none";
    this.divider.hidden = !(this.open && wipe && amount > 0 && amount < 100);
    this.divider.style.left = `${100 - amount}%`;
  }
}
