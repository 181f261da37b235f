// Instants in RFC 3339, which have a higher resolution than a `Date`.

const INSTANT = /^(\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d)(?:\.(\d+))?([Zz]|[+-]\d\d:\d\d)$/;

/** How much later than `epoch` an instant is, in ms, exact to the nanosecond; `null` if one of them is invalid. */
export function millisSince(epoch: string, instant: string): number | null {
  const from = parsed(epoch);
  const to = parsed(instant);
  return from === null || to === null ? null : ((to.wholeMs - from.wholeMs) * 1e6 + to.nanos - from.nanos) / 1e6;
}

/** Whole seconds and the rest: a `number` of nanoseconds since 1970 would lose the last digits. */
function parsed(text: string): { wholeMs: number; nanos: number } | null {
  const parts = INSTANT.exec(text);
  if (parts === null) return null;
  const wholeMs = Date.parse(`${parts[1]}${parts[3]}`.toUpperCase());
  return Number.isNaN(wholeMs) ? null : { wholeMs, nanos: Number((parts[2] ?? "").slice(0, 9).padEnd(9, "0")) };
}
