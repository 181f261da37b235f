// Numbers as the document states them.

/** The shortest digits that mean this number: what the JSON says. */
export function digits(value: number | null | undefined): string {
  return value === null || value === undefined || Number.isNaN(value) ? "–" : String(value);
}

/** A value that was calculated here, and has no digits in the document: rounded for people. */
export function rounded(value: number, places = 4): string {
  return Number.isFinite(value) ? String(Number(value.toFixed(places))) : "–";
}

export function withUnit(text: string, unit: string): string {
  return unit === "" ? text : `${text} ${unit}`;
}
