// Events by name, of a type that says what comes with each.
//
// SPDX-License-Identifier: Apache-2.0
export type Handler<All, Name extends keyof All> = (value: All[Name]) => void;

export class Events<All> {
  private readonly handlers = new Map<keyof All, Set<(value: never) => void>>();

  // Returns a function that ends it.
  on<Name extends keyof All>(name: Name, handler: Handler<All, Name>): () => void {
    const set = this.handlers.get(name) ?? new Set();
    this.handlers.set(name, set);
    set.add(handler as (value: never) => void);
    return () => set.delete(handler as (value: never) => void);
  }

  emit<Name extends keyof All>(name: Name, value: All[Name]) {
    for (const handler of this.handlers.get(name) ?? []) (handler as Handler<All, Name>)(value);
  }

  clear() {
    this.handlers.clear();
  }
}
