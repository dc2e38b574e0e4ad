// SPDX-License-Identifier: Apache-2.0
throw new Error(
  'citysplat-viewer is an ES module, and require() does not load it: write import ... from "citysplat-viewer", or await import("citysplat-viewer")',
);
