// Each act over all trials.
import { time } from "../text/amount";
import { Limited } from "../panels/Limited";
import { Name } from "../text/Name";
import type { Trials } from "../trials";
import { percent } from "./percent";
import { QuantileCells } from "./Robots";
import { Wide } from "./Wide";

export function Acts({ acts }: Pick<Trials, "acts">) {
  return (
    <section class="wide" aria-labelledby="acts-title">
      <h2 id="acts-title">Acts</h2>
      {acts.length === 0 ? (
        <p>No act was sent in any of them.</p>
      ) : (
        <Limited items={acts} name="acts">
          {(some) => (
            <Wide label="acts">
              <table id="acts">
                <thead>
                  <tr>
                    <th>act</th>
                    <th class="number">starts</th>
                    <th class="number">spread p50</th>
                    <th class="number">p99</th>
                    <th class="number">max</th>
                    <th class="number">tolerance</th>
                    <th class="number">beyond</th>
                  </tr>
                </thead>
                <tbody>
                  {some.map((act, i) => (
                    <tr key={i}>
                      <th scope="row">
                        <Name text={act.act} />
                      </th>
                      <td class="number">
                        {act.starts.count} of {act.starts.of} ({percent(act.starts)})
                      </td>
                      <QuantileCells quantiles={act.spread} />
                      <td class="number">{time(act.tolerance_ms)}</td>
                      <td class="number">{percent(act.beyond_tolerance)}</td>
                    </tr>
                  ))}
                </tbody>
              </table>
            </Wide>
          )}
        </Limited>
      )}
    </section>
  );
}
