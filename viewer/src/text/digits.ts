// Numbers as the document states them.

/** The shortest digits that represent this number, as in the JSON. */
export function digits(value: number | null | undefined): string {
  return value === null || value === undefined || Number.isNaN(value) ? "–" : String(value);
}

/** A value that was calculated here and has no digits in the document, rounded for display. */
export function rounded(value: number, places = 4): string {
  return Number.isFinite(value) ? String(Number(value.toFixed(places))) : "–";
}

export function withUnit(text: string, unit: string): string {
  return unit === "" ? text : `${text} ${unit}`;
}
