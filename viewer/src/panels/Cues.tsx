// The bars of the timeline as a table, with their relations as written.
import { useCell } from "../state/cell";
import { seekAndShow, selectCue } from "../state/moves";
import { useSession } from "../state/session";
import { notPlayed } from "../text/fate";
import { Name } from "../text/Name";
import { clock, duration } from "../text/time";
import { Limited } from "./Limited";

export function Cues() {
  const session = useSession();
  const selected = useCell(session.cue);
  const { cues, mission } = session.show;
  const { acts } = mission;
  if (cues.length === 0) return <p>No cues are known.</p>;
  return (
    <Limited items={cues} name="cues">
      {(some) => (
        <table id="cues">
          <thead>
            <tr>
              <th>cue</th>
              <th class="number">start</th>
              <th class="number">lasts</th>
              <th class="number">slack</th>
              <th>relations</th>
            </tr>
          </thead>
          <tbody>
            {some.map(({ index, act, cue, start, end }) => (
              <tr key={index} aria-current={index === selected ? "true" : undefined}>
                <th scope="row">
                  <button
                    type="button"
                    class="link"
                    onClick={() => {
                      selectCue(session, index);
                      seekAndShow(session, start);
                    }}
                  >
                    <Name text={cue.name} />
                  </button>
                  {cue.note && (
                    <div class="note">
                      <Name text={cue.note} />
                    </div>
                  )}
                  <Unplayed text={notPlayed(acts[act], start, end)} />
                </th>
                <td class="number">{clock(start)}</td>
                <td class="number">{duration(end - start)}</td>
                <td class="number">{cue.critical ? "◆ critical" : duration(cue.slack)}</td>
                <td>
                  {cue.relations.map((relation, i) => (
                    <div key={i}>
                      <Name text={relation.text} />
                    </div>
                  ))}
                </td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
    </Limited>
  );
}

function Unplayed({ text }: { text: string }) {
  return text === "" ? null : <small class="warn-text">⊘ {text}</small>;
}
