// Colours of the canvases, read from the style sheet once per theme.
import type { Theme } from "../state/session";

const NAMES = {
  ground: "--ground",
  raised: "--raised",
  sunken: "--sunken",
  line: "--line",
  faint: "--faint",
  text: "--text",
  dim: "--dim",
  control: "--control",
  accent: "--accent",
  planned: "--planned",
  band: "--band",
  set: "--set",
  read: "--read",
  cue: "--cue",
  cueTone: "--cue-tone",
  cueText: "--cue-text",
  critical: "--critical",
  slack: "--slack",
  bad: "--bad",
  warn: "--warn",
  good: "--good",
  playhead: "--playhead",
  range: "--range",
} as const;

export type Palette = Record<keyof typeof NAMES, string>;

const known = new Map<string, Palette>();

/** The colours at an element: the stage is dark in both themes. */
export function palette(theme: Theme, element: Element): Palette {
  const own = element.closest(".stage") === null ? theme : "stage";
  let found = known.get(own);
  if (found === undefined) {
    const style = getComputedStyle(element);
    const colours = Object.entries(NAMES).map(([name, variable]) => [name, style.getPropertyValue(variable).trim()]);
    found = Object.fromEntries(colours) as Palette;
    known.set(own, found);
  }
  return found;
}

export const FONT = "11px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
export const MONO = "11px ui-monospace, 'SF Mono', Menlo, Consolas, 'DejaVu Sans Mono', monospace";
