// State of the page apart from the document: what the user has selected and is viewing.
import { createContext } from "preact";
import { useContext } from "preact/hooks";
import type { View } from "../data/envelope";
import type { Show } from "../data/show";
import type { Track } from "../data/track";
import { Cell } from "./cell";
import { firstPreset } from "../stage/whole";
import type { Preset } from "../stage/camera";
import { filteredRobots, foldOfGroup, groupsOfRows, NO_FILTER, rowsOf, type Filter, type Row } from "./rows";

export type Theme = "light" | "dark";
/** What the page is for: watching the show, checking it before or after it is played, or every detail. */
export type Mode = "show" | "check" | "engineer";
export const MODES: readonly Mode[] = ["show", "check", "engineer"];
export type Tab = "summary" | "values" | "cues" | "deviations" | "findings" | "events" | "source" | "differences";
export type Range = { from: number; to: number };
/** Effect of dragging over the timeline. */
export type Drag = "pan" | "select";

/** With more lanes than this, robots are initially folded. */
const LANES_UNFOLDED = 48;
/** Number of lanes whose curves are initially drawn. */
const CURVES_AT_FIRST = 3;

export class Session {
  readonly playhead = new Cell(0);
  readonly playing = new Cell(false);
  /** Negative: backwards. */
  readonly speed = new Cell(1);
  readonly view: Cell<View>;
  readonly range = new Cell<Range | null>(null);
  readonly drag = new Cell<Drag>("pan");
  readonly filter = new Cell<Filter>(NO_FILTER);
  readonly folded: Cell<ReadonlySet<number>>;
  readonly rows: Cell<readonly Row[]>;
  /** Lanes whose curves are drawn, in the order in which they were chosen. */
  readonly chosen: Cell<readonly Track[]>;
  /** Index into `rows`. */
  readonly focusedRow = new Cell(0);
  readonly cue = new Cell<number | null>(null);
  readonly relations = new Cell(true);
  readonly tab = new Cell<Tab>("summary");
  readonly help = new Cell(false);
  readonly theme: Cell<Theme>;
  readonly mode: Cell<Mode>;
  readonly preset: Cell<Preset>;
  /** The robot that is selected on the stage. */
  readonly robot = new Cell<number | null>(null);
  /** The robots that pass the filters; `null` for all. */
  readonly shownRobots = new Cell<ReadonlySet<number> | null>(null);
  readonly trails = new Cell(true);
  readonly labels = new Cell(true);
  /** Announced to screen readers, but never on every frame. */
  readonly spoken = new Cell("");

  constructor(readonly show: Show) {
    this.view = new Cell(wholeView(show));
    this.mode = new Cell<Mode>(hasStage(show) ? "show" : "check");
    this.preset = new Cell<Preset>(firstPreset(show));
    const folds = show.tracks.length > LANES_UNFOLDED;
    const groups = [...groupsOfRows(show).values()].map(foldOfGroup);
    this.folded = new Cell<ReadonlySet<number>>(new Set([...(folds ? show.mission.robots.map((_, index) => index) : []), ...groups]));
    this.chosen = new Cell<readonly Track[]>(show.tracks.filter((track) => track.segments.length > 0).slice(0, CURVES_AT_FIRST));
    this.rows = new Cell<readonly Row[]>(rowsOf(show, this.filter.value, this.folded.value));
    this.theme = new Cell(preferredTheme());
    if (show.mission.compared) {
      this.tab.value = "differences";
      this.mode.value = "engineer";
    }
    this.playhead.value = Math.max(show.mission.from, Math.min(0, show.mission.to));
    const relist = () => {
      this.shownRobots.value = filteredRobots(show, this.filter.value);
      this.rows.value = rowsOf(show, this.filter.value, this.folded.value);
      this.focusedRow.value = Math.min(this.focusedRow.value, Math.max(0, this.rows.value.length - 1));
    };
    this.filter.subscribe(relist);
    this.folded.subscribe(relist);
  }

  get whole(): View {
    return wholeView(this.show);
  }

  /** The lane with the keyboard focus. */
  get focusedTrack(): Track | null {
    const row = this.rows.value[this.focusedRow.value];
    return row?.kind === "lane" ? row.track : null;
  }
}

export const hasStage = ({ mission }: Show) => mission.robots.some(({ body }) => body !== null);

export function preferredTheme(): Theme {
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

function wholeView({ mission }: Show): View {
  const room = Math.max(1, mission.to - mission.from) * 0.02;
  return { from: mission.from - room, to: mission.to + room };
}

export const SessionContext = createContext<Session | null>(null);

export function useSession(): Session {
  const session = useContext(SessionContext);
  if (session === null) throw new Error("no session around this component");
  return session;
}
