// Each robot over all trials: how often it failed first, and how long its acceptance took.
import { Limited } from "../panels/Limited";
import { exactly, time } from "../text/amount";
import { Name } from "../text/Name";
import type { Quantiles, Trials, TriedRobot } from "../trials";
import { RangeBar } from "./bars";
import { percent } from "./percent";
import { Wide } from "./Wide";

export function Robots({ trials }: { trials: Trials }) {
  const { robots, weakest_robot, weakest_link } = trials;
  const end = Math.max(0, ...robots.map(({ accepts_within }) => accepts_within?.max_ms ?? 0));
  return (
    <section class="wide" aria-labelledby="robots-title">
      <h2 id="robots-title">Robots</h2>
      <p class="hint">
        Accepts within: from the sending of an act until the robot had accepted its scripts. The bar is thick up to the time of a
        half, thin up to that of 99 %, with a mark at the largest; it ends at {time(end)}.
      </p>
      <Limited items={robots} name="robots">
        {(some) => (
          <Wide label="robots">
            <table id="robots">
              <thead>
                <tr>
                  <th>robot</th>
                  <th class="number">fails first</th>
                  <th class="range-column">accepts within</th>
                  <th class="number">p50</th>
                  <th class="number">p99</th>
                  <th class="number">max</th>
                  <th class="number">accepts last</th>
                  <th class="number">reconnects</th>
                </tr>
              </thead>
              <tbody>
                {some.map((robot) => (
                  <Row
                    key={robot.robot}
                    robot={robot}
                    end={end}
                    weakest={robot.robot === weakest_robot}
                    slowest={robot.robot === weakest_link}
                  />
                ))}
              </tbody>
            </table>
          </Wide>
        )}
      </Limited>
    </section>
  );
}

function Row({ robot, end, weakest, slowest }: { robot: TriedRobot; end: number; weakest: boolean; slowest: boolean }) {
  const { accepts_within } = robot;
  return (
    <tr class={weakest || slowest ? "weak" : ""}>
      <th scope="row">
        <Name text={robot.robot} />
        {weakest && <span class="badge bad">weakest robot</span>}
        {slowest && <span class="badge bad">weakest link</span>}
      </th>
      <td class="number">
        {robot.fails_first.count} ({percent(robot.fails_first)})
      </td>
      <td class="range-column">{accepts_within !== null && <RangeBar range={accepts_within} end={end} />}</td>
      <QuantileCells quantiles={accepts_within} />
      <td class="number">{percent(robot.accepts_last)}</td>
      <td class="number">{percent(robot.reconnects)}</td>
    </tr>
  );
}

export function QuantileCells({ quantiles }: { quantiles: Quantiles | null }) {
  const values = quantiles === null ? [null, null, null] : [quantiles.p50_ms, quantiles.p99_ms, quantiles.max_ms];
  return (
    <>
      {values.map((ms, i) => (
        <td key={i} class="number" title={exactly(ms)}>
          {ms === null ? "–" : time(ms)}
        </td>
      ))}
    </>
  );
}
