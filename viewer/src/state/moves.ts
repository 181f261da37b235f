// Moving the playhead and the visible range.
import type { View } from "../data/envelope";
import type { Session } from "./session";

/** Smallest visible range, in milliseconds over the whole width. */
const NARROWEST = 0.5;

export function seek(session: Session, ms: number): void {
  const { from, to } = session.show.mission;
  session.playhead.value = Math.min(to, Math.max(from, ms));
}

/** As `seek`, and brings the playhead into view. */
export function seekAndShow(session: Session, ms: number): void {
  seek(session, ms);
  const { from, to } = session.view.value;
  const at = session.playhead.value;
  if (at < from || at > to) show(session, { from: at - (to - from) / 2, to: at + (to - from) / 2 });
}

/** A `factor` above 1 zooms in. The position of `ms` on the screen does not change. */
export function zoom(session: Session, factor: number, ms: number): void {
  const { from, to } = session.view.value;
  show(session, { from: ms - (ms - from) / factor, to: ms + (to - ms) / factor });
}

export function pan(session: Session, ms: number): void {
  const { from, to } = session.view.value;
  show(session, { from: from + ms, to: to + ms });
}

export function fit(session: Session): void {
  session.view.value = session.whole;
}

export function showRange(session: Session, range: View): void {
  const room = Math.max((range.to - range.from) * 0.05, NARROWEST / 4);
  show(session, { from: range.from - room, to: range.to + room });
}

export function zoomToSelection(session: Session): void {
  const { range } = session;
  if (range.value !== null) {
    showRange(session, range.value);
    return;
  }
  const cue = session.cue.value;
  if (cue !== null) showRange(session, { from: session.show.cues[cue].start, to: session.show.cues[cue].end });
}

export function clearSelection(session: Session): void {
  session.range.value = null;
  session.cue.value = null;
}

/** Shows a part of the mission, no narrower than `NARROWEST`, so that numbers can still be distinguished. */
export function show(session: Session, view: View): void {
  const whole = session.whole;
  const width = Math.min(Math.max(view.to - view.from, NARROWEST), whole.to - whole.from);
  const middle = (view.from + view.to) / 2;
  const from = Math.min(Math.max(middle - width / 2, whole.from), whole.to - width);
  session.view.value = { from, to: from + width };
}

export function selectCue(session: Session, index: number): void {
  session.cue.value = index;
  session.tab.value = "source";
}
