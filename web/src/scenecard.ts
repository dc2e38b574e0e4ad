// A scene to choose: its picture by the server, and its title.
//
// SPDX-License-Identifier: Apache-2.0
import type { SceneEntry } from "./source";

export function sceneCard({ title, preview }: SceneEntry, open: () => void): HTMLElement {
  const button = document.createElement("button");
  button.textContent = title;
  if (preview) {
    const picture = document.createElement("img");
    picture.alt = "";
    picture.loading = "lazy";
    picture.onerror = () => picture.remove(); // of a server that draws nothing
    picture.src = preview.href;
    button.prepend(picture);
  }
  button.onclick = open;
  const item = document.createElement("li");
  item.append(button);
  return item;
}
