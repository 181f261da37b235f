// Instants as RFC 3339 writes them, which are finer than a `Date`.

const INSTANT = /^(\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d)(?:\.(\d+))?([Zz]|[+-]\d\d:\d\d)$/;

/** How much later than `epoch` an instant is, in ms, to the nanosecond; `null` if one of them is no instant. */
export function millisSince(epoch: string, instant: string): number | null {
  const from = parsed(epoch);
  const to = parsed(instant);
  return from === null || to === null ? null : ((to.wholeMs - from.wholeMs) * 1e6 + to.nanos - from.nanos) / 1e6;
}

/** The whole seconds, and the rest: a `number` of nanoseconds since 1970 would have lost the last digits. */
function parsed(text: string): { wholeMs: number; nanos: number } | null {
  const parts = INSTANT.exec(text);
  if (parts === null) return null;
  const wholeMs = Date.parse(`${parts[1]}${parts[3]}`.toUpperCase());
  return Number.isNaN(wholeMs) ? null : { wholeMs, nanos: Number((parts[2] ?? "").slice(0, 9).padEnd(9, "0")) };
}
