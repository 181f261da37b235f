// Every key of the page. The help dialog is made from the same table.
import { PRESETS, type Preset } from "../stage/camera";
import { choose, fold, foldAll, moveFocus } from "./choose";
import { clearSelection, fit, pan, seek, seekAndShow, selectCue, zoom, zoomToSelection } from "./moves";
import { pause, setSpeed, shuttle, step, toggle } from "./playback";
import type { Session, Tab } from "./session";

interface Key {
  keys: string[];
  does: string;
  /** `null`: the browser handles the key, and the help only lists it. */ run: ((session: Session, key: string) => void) | null;
}

const TABS: Tab[] = ["summary", "values", "cues", "deviations", "findings", "events", "source"];

export const KEYS: Key[] = [
  { keys: [" "], does: "play or pause", run: toggle },
  { keys: ["J"], does: "play backwards; again: twice as fast", run: (session) => shuttle(session, -1) },
  { keys: ["K"], does: "pause", run: pause },
  { keys: ["L"], does: "play; again: twice as fast", run: (session) => shuttle(session, 1) },
  {
    keys: ["<", ">"],
    does: "half or twice the speed",
    run: (session, key) => setSpeed(session, Math.abs(session.speed.value) * (key === "<" ? 0.5 : 2)),
  },
  {
    keys: ["ArrowLeft", "ArrowRight"],
    does: "move the playhead by a twentieth of what is in view",
    run: (session, key) => seekAndShow(session, session.playhead.value + (sideways(key) * width(session)) / 20),
  },
  {
    keys: [",", "."],
    does: "to the step before or after, of the focused lane",
    run: (session, key) => step(session, key === "," ? -1 : 1),
  },
  {
    keys: ["Home", "End"],
    does: "to the start or the end",
    run: (session, key) => seekAndShow(session, key === "Home" ? session.show.mission.from : session.show.mission.to),
  },
  {
    keys: ["Shift+ArrowLeft", "Shift+ArrowRight"],
    does: "pan",
    run: (session, key) => pan(session, (sideways(key) * width(session)) / 8),
  },
  {
    keys: ["+", "-"],
    does: "zoom in or out at the playhead",
    run: (session, key) => zoom(session, key === "+" ? 1.5 : 1 / 1.5, anchor(session)),
  },
  { keys: ["F", "0", "Shift+Home"], does: "fit the whole mission", run: fit },
  { keys: ["Z"], does: "zoom to the selected range, or to the selected cue", run: zoomToSelection },
  { keys: ["[", "]"], does: "begin or end the selected range at the playhead", run: (session, key) => edge(session, key) },
  {
    keys: ["X"],
    does: "let dragging select a range, or pan again",
    run: (session) => (session.drag.value = session.drag.value === "pan" ? "select" : "pan"),
  },
  { keys: ["Escape"], does: "clear the selected range and cue", run: clearSelection },
  {
    keys: ["ArrowUp", "ArrowDown"],
    does: "to the row above or below",
    run: (session, key) => moveFocus(session, key === "ArrowUp" ? -1 : 1),
  },
  { keys: ["Enter"], does: "draw the curve of the focused lane, or fold the focused robot", run: enter },
  { keys: ["PageUp", "PageDown"], does: "scroll the rows (while the timeline has the focus)", run: null },
  { keys: ["U"], does: "fold or unfold all groups and robots", run: foldAll },
  {
    keys: ["N", "P"],
    does: "select the next or the previous cue",
    run: (session, key) => nextCue(session, key === "n" ? 1 : -1),
  },
  { keys: ["R"], does: "show relations of cues", run: (session) => (session.relations.value = !session.relations.value) },
  { keys: ["V"], does: "stage from the next side: audience, front, side, 3D, top", run: nextPreset },
  {
    keys: ["S", "G", "E"],
    does: "show, check, or engineer: what the page is for",
    run: (session, key) => (session.mode.value = key === "s" ? "show" : key === "g" ? "check" : "engineer"),
  },
  { keys: ["C"], does: "to the instant at which two robots are closest", run: closest },
  { keys: ["/"], does: "search", run: () => document.getElementById("search")?.focus() },
  {
    keys: ["1", "2", "3", "4", "5", "6", "7"],
    does: "show a panel: summary, values, cues, deviations, findings, events, source",
    run: (session, key) => (session.tab.value = TABS[Number(key) - 1]),
  },
  {
    keys: ["8"],
    does: "show what differs, on a page that compares two plans",
    run: (session) => {
      if (session.show.mission.compared) session.tab.value = "differences";
    },
  },
  {
    keys: ["T"],
    does: "light or dark",
    run: (session) => (session.theme.value = session.theme.value === "dark" ? "light" : "dark"),
  },
  { keys: ["?"], does: "show this help", run: (session) => (session.help.value = true) },
];

const runs = new Map(KEYS.flatMap((entry) => entry.keys.map((key) => [key.length === 1 ? key.toLowerCase() : key, entry])));

export function listenToKeys(session: Session): () => void {
  const press = (event: KeyboardEvent) => {
    if (event.ctrlKey || event.altKey || event.metaKey || session.help.value || takesKeys(event)) return;
    const name = event.key.length === 1 ? event.key.toLowerCase() : `${event.shiftKey ? "Shift+" : ""}${event.key}`;
    const entry = runs.get(name === "=" ? "+" : name);
    if (entry === undefined || entry.run === null) return;
    event.preventDefault();
    entry.run(session, name === "=" ? "+" : name);
  };
  document.addEventListener("keydown", press);
  return () => document.removeEventListener("keydown", press);
}

/** Text fields handle typed keys; buttons Space and Enter; sliders the arrow keys; panels the keys that scroll. */
function takesKeys({ target, key }: KeyboardEvent): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement && target.type === "range") return /^(Arrow|Page|Home|End)/.test(key);
  if (target instanceof HTMLInputElement || target instanceof HTMLSelectElement) return key !== "Escape";
  if (target.getAttribute("role") === "tabpanel") return /^(ArrowUp|ArrowDown|Page|Home|End)/.test(key);
  if (target instanceof HTMLButtonElement) return key === " " || key === "Enter";
  return false;
}

function nextPreset(session: Session): void {
  const names = Object.keys(PRESETS) as Preset[];
  session.preset.value = names[(names.indexOf(session.preset.value) + 1) % names.length];
}

const sideways = (key: string) => (key.endsWith("Left") ? -1 : 1);
const width = (session: Session) => session.view.value.to - session.view.value.from;

function anchor(session: Session): number {
  const { from, to } = session.view.value;
  const at = session.playhead.value;
  return at >= from && at <= to ? at : (from + to) / 2;
}

function edge(session: Session, key: string): void {
  const at = session.playhead.value;
  const range = session.range.value ?? { from: at, to: at };
  const next = key === "[" ? { from: at, to: Math.max(at, range.to) } : { from: Math.min(at, range.from), to: at };
  session.range.value = next;
}

function enter(session: Session): void {
  const row = session.rows.value[session.focusedRow.value];
  if (row?.kind === "lane") choose(session, row.track);
  if (row?.kind === "robot" || row?.kind === "group") fold(session, row);
}

function nextCue(session: Session, by: 1 | -1): void {
  const { cues } = session.show;
  if (cues.length === 0) return;
  const now = session.cue.value;
  const next = now === null ? (by > 0 ? 0 : cues.length - 1) : Math.min(cues.length - 1, Math.max(0, now + by));
  selectCue(session, next);
  seekAndShow(session, cues[next].start);
}

function closest(session: Session): void {
  const act = session.show.actAt(session.playhead.value);
  const found = act < 0 ? null : session.show.planOf(session.show.mission.acts[act])?.closest;
  if (found === null || found === undefined) return;
  seek(session, session.show.mission.acts[act].start + found.at);
}
