// A list that shows its first hundreds of rows, and more on request: a document of 100,000 rows would block the page.
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";

const AT_ONCE = 300;

interface LimitedProps<T> {
  items: readonly T[];
  name: string;
  children: (some: readonly T[]) => ComponentChildren;
}

export function Limited<T>({ items, name, children }: LimitedProps<T>) {
  const [limit, setLimit] = useState(AT_ONCE);
  return (
    <>
      {children(items.slice(0, limit))}
      {items.length > limit && (
        <button type="button" class="tool" onClick={() => setLimit(limit + AT_ONCE)}>
          {limit} of {items.length} {name}: show more
        </button>
      )}
    </>
  );
}
