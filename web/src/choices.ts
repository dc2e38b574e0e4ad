// What a person has chosen in the pages' settings, kept in the browser.
//
// SPDX-License-Identifier: Apache-2.0
export function stored(key: string): string | null {
  try {
    return localStorage.getItem(`citysplat.${key}`);
  } catch {
    return null;
  }
}

export function store(key: string, value: string) {
  try {
    localStorage.setItem(`citysplat.${key}`, value);
  } catch {
    // no storage: the choice lives as long as the page
  }
}

export function theme(): "dark" | "light" {
  const chosen = stored("theme");
  if (chosen === "dark" || chosen === "light") return chosen;
  return matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
}

export function language(): string {
  return stored("language") ?? navigator.language;
}
