// Events in order of time.
import { nameOfAct } from "../data/fate";
import { seekAndShow } from "../state/moves";
import { useSession } from "../state/session";
import { Name } from "../text/Name";
import { clock } from "../text/time";
import { describeEvent, isFailure } from "../timeline/events";
import { phasesOf } from "../timeline/phases";
import { Limited } from "./Limited";

interface Entry {
  at: number;
  text: string;
  failure: boolean;
}

export function Events() {
  const session = useSession();
  const { events, acts } = session.show.mission;
  const entries: Entry[] = [
    ...phasesOf(session.show).map(({ at, act, name }) => ({ at, text: `${nameOfAct(acts[act])}: ${name}`, failure: false })),
    ...events.map((event) => ({ at: event.at, text: describeEvent(session.show, event), failure: isFailure(event) })),
  ].sort((a, b) => a.at - b.at);
  if (entries.length === 0) return <p>No events are known.</p>;
  return (
    <Limited items={entries} name="events">
      {(some) => (
        <table id="events">
          <thead>
            <tr>
              <th>at</th>
              <th>event</th>
            </tr>
          </thead>
          <tbody>
            {some.map(({ at, text, failure }, i) => (
              <tr key={i}>
                <td>
                  <button type="button" class="link" onClick={() => seekAndShow(session, at)}>
                    {clock(at)}
                  </button>
                </td>
                <td class={failure ? "error-text" : ""}>
                  {failure && "✕ "}
                  <Name text={text} />
                </td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
    </Limited>
  );
}
