// The stage as text: the closest robots now, the closest in the act, the allowed distance, and robots whose position is unknown.
import { playedUntil } from "../data/fate";
import type { Show } from "../data/show";
import { useCell } from "../state/cell";
import { seekAndShow } from "../state/moves";
import { useSession } from "../state/session";
import { digits } from "../text/digits";
import { Name } from "../text/Name";
import { clock } from "../text/time";
import { closestPair } from "./closest";
import { poses } from "./pose";

export function StageFacts() {
  const session = useSession();
  const at = useCell(session.playhead);
  const { show } = session;
  const found = poses(show, at);
  const now = closestPair(found);
  const unsure = found.filter(({ doubt }) => doubt !== null);
  const name = (robot: number) => nameOf(show, robot);
  return (
    <div class="stage-facts">
      {now !== null && (
        <span id="closest-now" class={isTooClose(show, now.distance) ? "error-text" : ""}>
          closest now: <Name text={`${name(now.robots[0])} – ${name(now.robots[1])}`} /> {now.distance.toFixed(3)} m
          {allowed(show)}
        </span>
      )}
      <ClosestOfAct at={at} />
      {unsure.length > 0 && (
        <span title={unsure.map(({ robot, doubt }) => `${name(robot)}: ${doubt}`).join("\n")}>
          ◌ hollow: <Name text={`${name(unsure[0].robot)}: ${unsure[0].doubt}`} />
          {unsure.length > 1 && ` and ${unsure.length - 1} more`}
        </span>
      )}
    </div>
  );
}

/** The last place is rounded. */
const ROUNDING = 5e-4;
const isTooClose = ({ mission }: Show, distance: number) => distance < (mission.space?.distance ?? 0) - ROUNDING;

function allowed({ mission }: Show): string {
  const least = mission.space?.distance ?? null;
  return least === null ? "" : `, at least ${digits(least)} m allowed`;
}

function ClosestOfAct({ at }: { at: number }) {
  const session = useSession();
  const { show } = session;
  const played = show.mission.acts[show.actAt(at)];
  const closest = played === undefined ? null : show.planOf(played)?.closest;
  if (closest === null || closest === undefined) return null;
  const names = closest.robots.map((robot) => nameOf(show, robot)).join(" – ");
  return (
    <button
      type="button"
      class="link"
      id="closest-of-act"
      title={`To this instant (C). Exactly: ${digits(closest.distance)} m`}
      onClick={() => seekAndShow(session, played.start + closest.at)}
    >
      closest in this act: <Name text={names} /> {closest.distance.toFixed(3)} m at {clock(played.start + closest.at)}
      {played.start + closest.at > playedUntil(played) && " (planned, not played)"}
    </button>
  );
}

const nameOf = (show: Show, robot: number) => show.mission.robots[robot]?.id ?? `robot ${robot}`;
