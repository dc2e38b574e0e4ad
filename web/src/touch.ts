// Whether fingers are what points here: smaller screens, less memory, slower lines. Where there is no document, because a page is
// made on a server, the answer is no.
//
// SPDX-License-Identifier: Apache-2.0
export const TOUCH = typeof matchMedia === "function" && matchMedia("(pointer: coarse)").matches;
