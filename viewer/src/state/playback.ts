// Playback: the playhead follows the clock of the page, at any speed, forwards and backwards.
import { seek, seekAndShow, show } from "./moves";
import type { Session } from "./session";

const FASTEST = 10;
const SLOWEST = 0.1;

/** The show begins by itself, unless the user prefers less motion. */
export function playAtFirst(session: Session): void {
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(session);
}

export function play(session: Session): void {
  const { from, to } = session.show.mission;
  const forwards = session.speed.value > 0;
  if (forwards && session.playhead.value >= to) session.playhead.value = from;
  if (!forwards && session.playhead.value <= from) session.playhead.value = to;
  session.playing.value = true;
}

export function pause(session: Session): void {
  session.playing.value = false;
}

export function toggle(session: Session): void {
  if (session.playing.value) pause(session);
  else play(session);
}

/** The keys J and L: the first press plays in this direction, further presses double the speed. */
export function shuttle(session: Session, direction: 1 | -1): void {
  const runs = session.playing.value && Math.sign(session.speed.value) === direction;
  const size = Math.abs(session.speed.value);
  session.speed.value = direction * (runs ? Math.min(FASTEST, size * 2) : Math.min(1, size));
  play(session);
}

export function setSpeed(session: Session, size: number): void {
  session.speed.value = Math.sign(session.speed.value) * Math.min(FASTEST, Math.max(SLOWEST, size));
}

/** Moves to the next or previous step of the focused lane, or else of the first curve. */
export function step(session: Session, direction: 1 | -1): void {
  const track = session.focusedTrack ?? session.chosen.value[0];
  pause(session);
  const next = track?.neighbour(session.playhead.value, direction) ?? null;
  if (next !== null) seekAndShow(session, next);
}

/** Runs until the page is closed. */
export function runPlayback(session: Session): void {
  let before: number | null = null;
  const frame = (now: number) => {
    if (!session.playing.value) {
      before = null;
      return;
    }
    advance(session, before === null ? 0 : now - before);
    before = now;
    requestAnimationFrame(frame);
  };
  session.playing.subscribe(() => {
    if (session.playing.value) requestAnimationFrame(frame);
  });
}

function advance(session: Session, elapsed: number): void {
  seek(session, session.playhead.value + elapsed * session.speed.value);
  const { from, to } = session.show.mission;
  const at = session.playhead.value;
  if (session.speed.value > 0 ? at >= to : at <= from) pause(session);
  follow(session, at);
}

function follow(session: Session, at: number): void {
  const view = session.view.value;
  if (at >= view.from && at <= view.to) return;
  const width = view.to - view.from;
  const from = session.speed.value > 0 ? at - width * 0.1 : at - width * 0.9;
  show(session, { from, to: from + width });
}
