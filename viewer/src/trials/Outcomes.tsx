// Outcomes of missions, as one bar and its legend.
import { Name } from "../text/Name";
import type { Trials } from "../trials";
import { percent } from "./percent";

/** Classes of the style sheet; unknown outcomes use `other`. */
const COLOURS: Record<string, string> = {
  done: "done",
  done_without: "partly",
  done_skipping: "partly",
  out_of_tolerance: "late",
  steps_late: "late",
  not_started: "idle",
  failed: "failed",
  stopped: "halted",
};

export function Outcomes({ outcomes }: Pick<Trials, "outcomes">) {
  let from = 0;
  const parts = outcomes.map(([name, share]) => {
    const part = { name, share, from, wide: (share.share ?? 0) * 100, colour: `outcome-${COLOURS[name] ?? "other"}` };
    from += part.wide;
    return part;
  });
  return (
    <section aria-labelledby="outcomes-title">
      <h2 id="outcomes-title">Outcomes</h2>
      <svg class="outcome-bar" width="100%" height="28" aria-hidden="true">
        {parts.map(({ name, from, wide, colour }) => (
          <rect key={name} class={colour} x={`${from}%`} width={`${wide}%`} y="0" height="28" />
        ))}
      </svg>
      <table id="outcomes">
        <thead>
          <tr>
            <th>outcome</th>
            <th class="number">missions</th>
            <th class="number">share</th>
          </tr>
        </thead>
        <tbody>
          {parts.map(({ name, share, colour }) => (
            <tr key={name}>
              <th scope="row">
                <svg class="swatch" width="12" height="12" aria-hidden="true">
                  <rect class={colour} width="12" height="12" />
                </svg>
                <Name text={name.replaceAll("_", " ")} />
              </th>
              <td class="number">{share.count}</td>
              <td class="number">{percent(share)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </section>
  );
}
