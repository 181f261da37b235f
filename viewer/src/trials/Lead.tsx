// How much time acts had to be decided, and how much would have been sufficient.
import type { Trials } from "../trials";
import { time } from "../text/amount";
import { RangeBar } from "./bars";
import { counted } from "./percent";
import { QuantileCells } from "./Robots";
import { Wide } from "./Wide";

export function Lead({ lead }: Pick<Trials, "lead">) {
  return (
    <section aria-labelledby="lead-title">
      <h2 id="lead-title">Lead</h2>
      {lead === null ? (
        <p>No act was decided, so no lead is known to be enough.</p>
      ) : (
        <>
          <p>
            A lead of {time(lead.enough.p99_ms)} would have been sufficient for 99 % of the {counted(lead.enough.count, "act")} that
            were decided, and one of {time(lead.enough.max_ms)} for all of them.
          </p>
          <Wide label="lead">
            <table id="lead">
              <thead>
                <tr>
                  <th>lead</th>
                  <th class="range-column">from 0</th>
                  <th class="number">p50</th>
                  <th class="number">p99</th>
                  <th class="number">max</th>
                </tr>
              </thead>
              <tbody>
                {(["had", "enough"] as const).map((which) => (
                  <tr key={which}>
                    <th scope="row">{which}</th>
                    <td class="range-column">
                      <RangeBar range={lead[which]} end={Math.max(lead.had.max_ms, lead.enough.max_ms)} />
                    </td>
                    <QuantileCells quantiles={lead[which]} />
                  </tr>
                ))}
              </tbody>
            </table>
          </Wide>
          {lead.undecided > 0 && (
            <p id="undecided">
              {counted(lead.undecided, "act")} sent but not decided: a robot refused, failed or said nothing in time.
            </p>
          )}
        </>
      )}
    </section>
  );
}
