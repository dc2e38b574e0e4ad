// The dialog with the two lines that show this view in a page of one's own.
//
// SPDX-License-Identifier: Apache-2.0
import { formatView } from "./address";
import { copy, element } from "./dom";
import { text } from "./strings";
import type { Viewer } from "./viewer";

const escaped = (value: string) =>
  value.replace(/[&"<>]/g, (sign) => ({ "&": "&amp;", '"': "&quot;", "<": "&lt;", ">": "&gt;" })[sign]!);

// Of a scene that a server lists: the module lies beside its page.
export function embedCode(viewer: Viewer): string {
  const { scene, scenes, pose, state } = viewer;
  const attributes = {
    src: scene?.catalogue?.href ?? "",
    scene: scenes.length > 1 ? (scene?.id ?? "") : "",
    view: formatView({ pose, appearance: state.wanted }),
  };
  const given = Object.entries(attributes).filter(([, value]) => value);
  const words = given.map(([name, value]) => ` ${name}="${escaped(value)}"`).join("");
  const module = new URL("viewer.js", document.baseURI).href;
  return `<script type="module" src="${escaped(module)}"></script>\n<city-splat${words}></city-splat>\n`;
}

export class EmbedDialog {
  private readonly dialog = element<HTMLDialogElement>("embed");
  private readonly code = element<HTMLTextAreaElement>("embed-code");

  constructor(private readonly viewer: Viewer) {
    element("embed-copy").addEventListener("click", () => void this.take());
    element("embed-close").addEventListener("click", () => this.dialog.close());
  }

  open() {
    this.code.value = embedCode(this.viewer);
    const { scene } = this.viewer;
    element<HTMLAnchorElement>("embed-use").href = new URL(`d/${scene!.id}/use`, scene!.catalogue!).href;
    this.dialog.showModal();
  }

  private async take() {
    await copy(this.code.value, text("embed.done"));
    this.dialog.close(); // or the notice would lie behind it
  }
}
