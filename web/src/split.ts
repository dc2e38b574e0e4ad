// Two appearances side by side: the second one right of a line that is dragged, or moved by arrow
// keys. Both are computed in this browser.
//
// SPDX-License-Identifier: Apache-2.0
import { text } from "./strings";
import type { Viewer } from "./viewer";

const STEP = 0.02;

export class Split {
  private readonly divider = document.createElement("div");
  share = 0.5; // of the width that the first one has
  onChange: () => void = () => {}; // the line was moved

  constructor(private readonly viewer: Viewer) {
    const { divider } = this;
    divider.id = "appearance-divider";
    divider.className = "divider";
    divider.dataset["own"] = "";
    divider.tabIndex = 0;
    divider.hidden = true;
    divider.dataset["tLabel"] = "appearance.divider";
    for (const [name, value] of [["role", "slider"], ["aria-valuemin", "0"], ["aria-valuemax", "100"]])
      divider.setAttribute(name!, value!);
    viewer.container.append(divider);
    divider.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      divider.focus();
      divider.setPointerCapture(event.pointerId);
    });
    divider.addEventListener("pointermove", (event) => {
      if (!divider.hasPointerCapture(event.pointerId)) return;
      const box = viewer.container.getBoundingClientRect();
      this.move((event.clientX - box.left) / box.width);
    });
    divider.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -STEP, ArrowRight: STEP, Home: -1, End: 1 }[event.key];
      if (by === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      this.move(this.share + by);
    });
  }

  get open(): boolean {
    return !this.divider.hidden;
  }

  // second: the appearance on the right; null: one alone.
  async show(second: string | null) {
    await this.viewer.setSecondAppearance(second, this.share);
    this.update();
    this.divider.setAttribute("aria-label", text("appearance.divider"));
    if (this.open) this.move(this.share);
  }

  // The line is where a second appearance is: the viewer has none where that was refused or another
  // scene was opened.
  update() {
    this.divider.hidden = this.viewer.secondAppearance === null;
  }

  private move(share: number) {
    this.share = Math.min(0.98, Math.max(0.02, share));
    this.divider.style.left = `${100 * this.share}%`;
    this.divider.setAttribute("aria-valuenow", String(Math.round(100 * this.share)));
    this.viewer.splitAt(this.share);
    this.onChange();
  }
}
