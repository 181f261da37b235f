// Why missions did not end as planned, each with an example trial.
import { useState } from "preact/hooks";
import { Limited } from "../panels/Limited";
import { Name } from "../text/Name";
import { visible } from "../text/visible";
import type { Reason, Trials } from "../trials";
import { replayOf } from "./command";
import { percent } from "./percent";
import { Wide } from "./Wide";

export function Reasons({ trials: { reasons, replay } }: { trials: Trials }) {
  const [trial, choose] = useState(reasons[0]?.example ?? 0);
  return (
    <section class="wide" aria-labelledby="reasons-title">
      <h2 id="reasons-title">Why missions did not end as planned</h2>
      {reasons.length === 0 ? (
        <p>All of them ended as planned.</p>
      ) : (
        <>
          <Replay command={replayOf(replay, trial)} trial={trial} />
          <Limited items={reasons} name="reasons">
            {(some) => (
              <Wide label="reasons">
                <table id="reasons">
                  <thead>
                    <tr>
                      <th>robot</th>
                      <th>kind</th>
                      <th class="number">missions</th>
                      <th class="number">share</th>
                      <th>example</th>
                      <th>what was said there</th>
                    </tr>
                  </thead>
                  <tbody>
                    {some.map((reason, i) => (
                      <Row key={i} reason={reason} chosen={reason.example === trial} choose={choose} />
                    ))}
                  </tbody>
                </table>
              </Wide>
            )}
          </Limited>
        </>
      )}
    </section>
  );
}

function Row({ reason, chosen, choose }: { reason: Reason; chosen: boolean; choose: (trial: number) => void }) {
  const { robot, kind, share, example, text } = reason;
  return (
    <tr>
      <th scope="row">{robot === null ? "–" : <Name text={robot} />}</th>
      <td>
        <Name text={kind.replaceAll("_", " ")} />
      </td>
      <td class="number">{share.count}</td>
      <td class="number">{percent(share)}</td>
      <td>
        <button type="button" class="tool" aria-pressed={chosen} onClick={() => choose(example)}>
          trial {example}
        </button>
      </td>
      <td class="said">
        <Name text={text} />
      </td>
    </tr>
  );
}

function Replay({ command, trial }: { command: string; trial: number }) {
  const [said, say] = useState("");
  const copy = () => {
    const copied = navigator.clipboard?.writeText(command) ?? Promise.reject(new Error("no clipboard"));
    copied.then(
      () => say(`copied, trial ${trial}`),
      () => say("this browser does not let the page copy; select the text"),
    );
  };
  return (
    <div class="replay">
      <span>To play trial {trial} again:</span>
      <code id="replay" role="status">
        {visible(command)}
      </code>
      <button type="button" class="tool" onClick={copy}>
        Copy
      </button>
      <small role="status">{said}</small>
    </div>
  );
}
