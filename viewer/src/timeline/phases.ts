// The instants of an act's agreement: requests sent, leases, decision, commitment, point of no return, start.
import { FONT } from "../canvas/palette";
import { widthOf } from "../canvas/text";
import type { Sheet } from "../canvas/useCanvas";
import type { Show } from "../data/show";
import type { Played } from "../mission";
import type { Scale } from "./scale";

export interface Phase {
  act: number;
  at: number;
  letter: string;
  name: string;
}

const NAMES: { key: keyof Played; letter: string; name: string }[] = [
  { key: "sent", letter: "S", name: "requests sent" },
  { key: "decided", letter: "D", name: "decision" },
  { key: "lease", letter: "L", name: "pending leases end" },
  { key: "committed", letter: "C", name: "commitment" },
  { key: "no_return", letter: "N", name: "point of no return" },
  { key: "start", letter: "▶", name: "start" },
];

export function phasesOf(show: Show): Phase[] {
  return show.mission.acts
    .flatMap((act, index) => NAMES.map(({ key, letter, name }) => ({
        act: index,
        at: act[key],
        letter,
        name: key === "start" && act.fate === "withdrawn" ? "planned start" : name,
      })))
    .filter((phase): phase is Phase => typeof phase.at === "number")
    .sort((a, b) => a.at - b.at);
}

export function drawPhases(sheet: Sheet, scale: Scale, show: Show, top: number, height: number): void {
  const { context, palette, width } = sheet;
  const phases = phasesOf(show).filter(({ at }) => scale.x(at) > -200 && scale.x(at) < width + 20);
  context.font = FONT;
  context.textBaseline = "middle";
  phases.forEach((phase, i) => {
    const x = scale.x(phase.at);
    const room = (i + 1 < phases.length ? scale.x(phases[i + 1].at) : width) - x;
    flag(sheet, x, top, height, phase.letter === "▶");
    context.fillStyle = palette.text;
    if (room > widthOf(context, phase.name) + 12) context.fillText(phase.name, x + 5, top + 9);
  });
}

function flag({ context, palette }: Sheet, x: number, top: number, height: number, start: boolean): void {
  context.fillStyle = start ? palette.good : palette.accent;
  context.fillRect(Math.round(x), top + 2, start ? 2 : 1, height - 4);
  context.beginPath();
  context.moveTo(x, top + height - 3);
  context.lineTo(x + 4, top + height - 6);
  context.lineTo(x, top + height - 9);
  context.fill();
}
