// Before anything is painted: the page's colours, and the server's picture of the view that is to be seen first. A small
// script of its own, which the page waits for. The server tells the picture's address where it draws any.
//
// SPDX-License-Identifier: Apache-2.0
import { parseView } from "./address";
import { theme } from "./choices";
import { formatPose } from "./pose";
import { posterSize } from "./postersize";

const root = document.documentElement;
root.dataset["theme"] = theme();

const { still, wide, tall } = (document.currentScript as HTMLScriptElement).dataset; // a folder; two poses of the whole scene
const query = new URLSearchParams(location.search);
if (query.get("ui") === "off") root.dataset["ui"] = "off";
if (still && query.get("backdrop") !== "off") {
  const view = parseView(location.hash);
  const pose = view ? formatPose(view.pose) : innerHeight > innerWidth ? tall : wide;
  const appearance = view?.appearance || (query.get("appearance") ?? query.get("light") ?? "");
  const light = appearance && `&appearance=${encodeURIComponent(appearance)}`;
  const url = new URL(`${still}${pose}/${posterSize(innerWidth / Math.max(1, innerHeight))}.jpg?background=sky${light}`, location.href).href;
  root.dataset["poster"] = url;
  root.style.setProperty("--poster", `url("${url}")`);
}
