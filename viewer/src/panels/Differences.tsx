// Differences from the plan to which this one is compared. A click moves to a difference.
import type { Difference } from "../mission";
import { choose } from "../state/choose";
import { seekAndShow } from "../state/moves";
import { useSession, type Session } from "../state/session";
import { Name } from "../text/Name";
import { clock } from "../text/time";
import { Limited } from "./Limited";

export function Differences() {
  const session = useSession();
  const { compared } = session.show.mission;
  if (!compared) return null;
  if (compared.differences.length === 0)
    return (
      <p>
        The same as <Name text={compared.with} />.
      </p>
    );
  return (
    <>
      <p>
        Compared with <Name text={compared.with} />, which the dashed curves and bars show. First what it has, then what this has.
      </p>
      <Limited items={compared.differences} name="differences">
        {(some) => (
          <table id="differences">
            <thead>
              <tr>
                <th>at</th>
                <th>what</th>
                <th>difference</th>
              </tr>
            </thead>
            <tbody>
              {some.map((difference, i) => (
                <tr key={i}>
                  <td>{place(session, difference)}</td>
                  <th scope="row">
                    <Name text={difference.subject} />
                  </th>
                  <td>
                    <Name text={difference.text} />
                  </td>
                </tr>
              ))}
            </tbody>
          </table>
        )}
      </Limited>
    </>
  );
}

function place(session: Session, difference: Difference) {
  const at = timeOf(session, difference);
  if (at === null) return "";
  return (
    <button type="button" class="link" onClick={() => go(session, at, difference)}>
      {clock(at)}
    </button>
  );
}

/** Time of the difference in the first play of its act. */
function timeOf({ show }: Session, { plan, at }: Difference): number | null {
  const act = plan === null ? undefined : show.mission.acts.find((act) => act.plan === plan);
  return act === undefined || at === null ? null : act.start + at;
}

function go(session: Session, at: number, { robot, device, subject, plan }: Difference): void {
  seekAndShow(session, at);
  if (robot !== null && device !== null) {
    const track = session.show.track(robot, device);
    if (track !== undefined && !session.chosen.value.includes(track)) choose(session, track);
    return;
  }
  const cue = session.show.cues.find((placed) => placed.plan === plan && placed.cue.name === subject);
  if (cue !== undefined) session.cue.value = cue.index;
}
