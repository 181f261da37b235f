// A table that may be wider than the window. It scrolls separately, also by keys.
import type { ComponentChildren } from "preact";

export function Wide({ label, children }: { label: string; children: ComponentChildren }) {
  return (
    <div class="scrolls" tabIndex={0} role="region" aria-label={`Table: ${label}`}>
      {children}
    </div>
  );
}
