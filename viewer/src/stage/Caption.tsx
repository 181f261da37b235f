// What plays now, over the picture of the stage: the act, its cues with their notes, and the cue that follows.
import { nameOfAct } from "../data/fate";
import type { PlacedCue, Show } from "../data/show";
import { useCell } from "../state/cell";
import { useSession } from "../state/session";
import { Name } from "../text/Name";
import { visible } from "../text/visible";

/** More names would not be read while the show plays. */
const NAMED = 3;

export function Caption() {
  const session = useSession();
  const at = useCell(session.playhead);
  const robot = useCell(session.robot);
  const { show } = session;
  const act = show.mission.acts[show.actAt(at)];
  const now = playing(show, at);
  const next = following(show, at);
  const several = show.mission.plans.length > 1;
  return (
    <div class="caption">
      {act !== undefined && several && (
        <div class="caption-act">
          <Name text={nameOfAct(act)} />
        </div>
      )}
      <div class="caption-cue">
        <bdi>{now.length === 0 ? "\u00a0" : now.slice(0, NAMED).map(({ cue }) => visible(cue.name)).join(" · ")}</bdi>
        {now.length > NAMED && <small> and {now.length - NAMED} more</small>}
      </div>
      {now.length === 0 && stopped(show, at) && <div class="caption-next">not played</div>}
      {now.map(({ index, cue }) => cue.note && <div key={index} class="caption-note"><Name text={cue.note} /></div>)}
      {next !== null && (
        <div class="caption-next">
          next: <Name text={next.cue.name} /> in {Math.ceil((next.start - at) / 1000)} s
        </div>
      )}
      {robot !== null && (
        <div class="caption-robot">
          <Name text={show.mission.robots[robot].id} />
        </div>
      )}
    </div>
  );
}

/** Whether something was planned for this time, but was not played. */
const stopped = (show: Show, ms: number) => show.cues.some(({ start, end, playedUntil }) => start <= ms && ms <= end && playedUntil < ms);

/** A cue without duration is shown for this time. */
const MOMENT_MS = 1500;

/** The cues that play at a time, the latest first. */
function playing(show: Show, ms: number): PlacedCue[] {
  const now = show.cues.filter(({ start, end, playedUntil }) => start <= ms && ms <= Math.min(playedUntil, Math.max(end, start + MOMENT_MS)));
  return now.sort((a, b) => b.start - a.start);
}

function following(show: Show, ms: number): PlacedCue | null {
  let next: PlacedCue | null = null;
  for (const placed of show.cues)
    if (placed.start > ms && placed.playedUntil >= placed.start && (next === null || placed.start < next.start)) next = placed;
  return next;
}
