// Findings of `check`, each with its code and its place.
import type { Finding } from "../mission";
import { seekAndShow, selectCue } from "../state/moves";
import { useSession } from "../state/session";
import { Name } from "../text/Name";
import { Limited } from "./Limited";

export function Findings() {
  const session = useSession();
  const { findings } = session.show.mission;
  if (findings.length === 0) return <p>No findings.</p>;
  return (
    <Limited items={findings} name="findings">
      {(some) => (
        <ul class="finding">
          {some.map((finding, i) => (
            <Item key={i} finding={finding} cues={session.show.cuesOfFinding[i]} />
          ))}
        </ul>
      )}
    </Limited>
  );
}

function Item({ finding, cues }: { finding: Finding; cues: number[] }) {
  const session = useSession();
  const { code, severity, message, hint, source, line, column } = finding;
  const file = source === null ? null : session.show.mission.sources[source];
  return (
    <li class="finding">
      <strong class={severity === "error" ? "error-text" : "warn-text"}>
        {severity === "error" ? "✕ error" : "⚠ warning"} <Name text={code} />
      </strong>{" "}
      <Name text={message} />
      {hint !== null && (
        <div class="hint">
          help: <Name text={hint} />
        </div>
      )}
      <div>
        {file && <Name text={`${file.name}:${line}:${column} `} />}
        {cues.map((cue) => (
          <button
            key={cue}
            type="button"
            class="link"
            onClick={() => {
              selectCue(session, cue);
              seekAndShow(session, session.show.cues[cue].start);
            }}
          >
            cue <Name text={session.show.cues[cue].cue.name} />
          </button>
        ))}
      </div>
    </li>
  );
}
